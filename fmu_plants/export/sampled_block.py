"""A sampled block: a controller in C, or a sampled plant, and the signals that its FMU has.

Its C code declares in `controller.h` its state, `ControllerState`, and the functions `controller_start` and
`controller_step`, and `controller_follow` where it follows a plant that somebody else drives;
`runtime/sampled_block.c` calls them at the sampling instants. That of a plant declares `controller_outputs`
besides, which says the outputs in a state; its step is to the next instant.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf

from fmu_plants.export.description import Contents, Kind, Scalar, c_number, c_text, variable_table
from fmu_plants.model import TIME, Variable

ACTIVE = "active"
APPLIED = "applied"
STATUS = "status"
ITERATIONS = "iterations"
ACTIVE_BOUNDS = "active_bounds"
_NUMBERS = (
    Variable(STATUS, "1", description="0, or a sum of bits that say why the outputs are a fallback"),
    Variable(ITERATIONS, "1", description="Iterations of the optimisation in this sample"),
    Variable(ACTIVE_BOUNDS, "1", description="Bounds that the optimum lies at"),
)
_ACTIVE = Variable(ACTIVE, "1", start=1.0, description="0: it follows what drives the plant in its place")
_SHOWN_SAMPLES = 100  # of the default experiment: some importers lengthen the steps where there are many


@dataclass(frozen=True, slots=True)
class SampledBlock:
    """A controller in C, ready to become an FMU.

    A name that two signals have belongs to the first of them, in the order of the fields below, and `time` to
    the time; before the name of the other one stands its kind: ``measurement.``, ``reference.``, ``input.``
    or ``controller.``.

    Parameters
    ----------
    name : str
        The model identifier.
    description : str
        A line for people.
    sampling_time : float
        Time between its instants [s].
    measurements, references, controls : sequence of Variable
        What ``controller_step`` is given and what it answers, in the order of its arguments y, r and u.
    sources : mapping of str to str
        ``controller.h`` and C files by name.
    resources : mapping of str to str
        Files that go along, by name.
    follows : bool
        Whether it can follow the plant: then it has further inputs, `active` and for each control
        ``applied.NAME``, what drives the plant where `active` is 0.
    is_plant : bool
        Whether it is a plant: `measurements` drive it, and `controls` are what it gives, which follow from
        its state at an instant, not from what drives it there.
    """

    name: str
    description: str
    sampling_time: float
    measurements: Sequence[Variable]
    references: Sequence[Variable]
    controls: Sequence[Variable]
    sources: Mapping[str, str]
    resources: Mapping[str, str] = field(default_factory=dict)
    follows: bool = False
    is_plant: bool = False

    def layout(self) -> tuple[Scalar, ...]:
        """Return all variables of the FMU, in the order of their value references."""
        groups = (
            ("", Kind.TIME, (Variable(TIME, "s", description="Simulated time"),)),
            ("input" if self.is_plant else "measurement", Kind.SAMPLE, self.measurements),
            ("reference", Kind.SAMPLE, self.references),
            ("controller", Kind.SAMPLE, self._hand_over_inputs()),
            ("output" if self.is_plant else "input", Kind.HELD, self.controls),
            ("controller", Kind.HELD, self._numbers()),
        )
        return tuple(_named_apart(groups))

    def hand_over(self) -> list[str]:
        """Return the names of the inputs by which it follows the plant: `active` and what is applied."""
        first = 1 + len(self.measurements) + len(self.references)
        inputs = self.layout()[first : first + len(self._hand_over_inputs())]
        return [scalar.variable.name for scalar in inputs]

    def _numbers(self) -> Sequence[Variable]:
        """Return what a controller says of its answer."""
        return () if self.is_plant else _NUMBERS

    def _hand_over_inputs(self) -> Sequence[Variable]:
        """Return the inputs by which another controller hands the plant over."""
        if not self.follows:
            return ()
        applied = [
            replace(
                control,
                name=f"{APPLIED}.{control.name}",
                description=f"What is applied as {control.name} where it is not active",
                min=-inf,
                max=inf,
            )
            for control in self.controls
        ]
        return _ACTIVE, *applied

    def contents(self) -> Contents:
        """Return what the FMU is: every output of a controller depends on every input, without delay."""
        layout = self.layout()
        samples, held = (
            tuple(scalar.variable.name for scalar in layout if scalar.kind is kind)
            for kind in (Kind.SAMPLE, Kind.HELD)
        )
        return Contents(
            self.name,
            self.description,
            layout,
            held,
            dict.fromkeys(held, frozenset[str]() if self.is_plant else frozenset(samples)),
            {"stopTime": _SHOWN_SAMPLES * self.sampling_time, "stepSize": self.sampling_time},
            self.sampling_time,
        )

    def code(self) -> str:
        """Return the text of `model.c`, with an empty GUID."""
        layout = self.layout()
        return f"""/* {self.name}: the signals of a {"plant" if self.is_plant else "controller"}. */
#include "model.h"
#include "sampled_block.h"

#include <math.h>

{variable_table(layout)}

const Model model = {{
    .identifier = {c_text(self.name)},
    .guid = "",
    .n_variables = {len(layout)},
    .n_inputs = {len(self.measurements) + len(self.references) + len(self._hand_over_inputs())},
    .n_outputs = {len(self.controls) + len(self._numbers())},
    .variables = variables,
}};

const SampledBlock block = {{
    .sampling_time = {c_number(self.sampling_time)},
    .n_measurements = {len(self.measurements)},
    .n_references = {len(self.references)},
    .n_controls = {len(self.controls)},
    .follow = {"controller_follow" if self.follows else "NULL"},
    .outputs = {"controller_outputs" if self.is_plant else "NULL"},
}};
"""


def _named_apart(groups: Sequence[tuple[str, Kind, Sequence[Variable]]]) -> Iterator[Scalar]:
    taken = set[str]()
    for prefix, kind, variables in groups:
        for variable in variables:
            name = variable.name
            while name in taken:
                name = f"{prefix}.{name}"
            taken.add(name)
            yield Scalar(kind, replace(variable, name=name))
