"""The C code of one controller, put together from constants, memory and step functions."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import replace
from functools import cache
from importlib.resources import files as package_files
from itertools import accumulate, pairwise
from math import inf, prod
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ddpc_controllers.data.hankel import resting_input
from ddpc_cosim import (
    ConfigError,
    Controller,
    ControllerCode,
    FloatArray,
    Footprint,
    Loop,
    Sample,
    further_arguments,
)
from ddpc_cosim.files.texts import printable

STATUSES: Mapping[int, str] = {
    1: "a value is not finite: inputs held, or at rest",
    2: "a missing measurement: the model's expectation stands in for it",
    4: "bounds that cannot be met gave way",
    8: "the unconstrained optimum, clipped at the input limits",
    16: "no combination of the recorded windows has this past: the nearest is used",
    32: "the optimisation reached the bound on its iterations",
    64: "what was learned online was not plausible and is not used",
    128: "a missing measurement while it follows: the last one stands in for it",
}
"""The bits of a status, as ``runtime/sample.h`` has them."""

_ROWS = {
    "forecast": ("disturbance", 0),
    "band": ("band_now", 0),
    "price": ("", 1),
    "input_limits": ("", 1),
    "output_limits": ("", 0),
}
"""Fields of a sample with time along axis 0: the field of its present row, and rows beyond the horizon's."""
_WIDTH = 8
_DOUBLE = 8
_COUNTS = 16  # of a state: three unsigned, filled up to where a double may stand
_PACKAGE = __name__.partition(".")[0]


class Exportable(Controller):
    """Base of the controllers that can be exported: each writes its step function; wrappers use others'."""

    _known_in_c: ClassVar[Collection[str]] = ("disturbances", "bands", "prices")
    """What a loop may have: a class that makes nothing of these need not know them; nor, here, of limits."""
    _follows_in_c: ClassVar[bool] = False
    """Whether its step function follows the plant where ``sample->applied`` has inputs of somebody else."""

    def c_code(self, loop: Loop) -> ControllerCode:
        """Return the started controller as C code.

        Raises
        ------
        ConfigError
            With these settings it cannot be exported, and why.
        """
        return self._whole_code(loop)

    def loadable_c_code(self, loop: Loop) -> ControllerCode:
        """Return the same code with its numbers apart; errors as of :meth:`c_code`."""
        return self._whole_code(loop, apart=True)

    def _whole_code(self, loop: Loop, *, apart: bool = False) -> ControllerCode:
        code, step = _parts_of(self, loop)
        rest = None
        if loop.past or loop.continues_recording:  # who is switched off and on again begins without this past
            fresh, at_rest = deepcopy(self), replace(loop, past=None, continues_recording=False)
            fresh.start(replace(at_rest, rng=deepcopy(loop.rng)))
            rest = _parts_of(fresh, at_rest)[0].start
        return code.controller(step, self.horizon, loop, rest, apart=apart)

    def c_step(self, code: "Code", loop: Loop) -> str:
        """Add the started controller to the code; return the name of its step function.

        Raises
        ------
        ConfigError
            With these settings it cannot be exported, and why.
        """
        raise ConfigError(f"{type(self).__name__} cannot be exported: the method has no code in C")


def _parts_of(controller: Exportable, loop: Loop) -> tuple["Code", str]:
    """Return the parts of the code of a started controller, and the name of its step function."""
    code = Code()
    code.look_ahead(loop, controller.horizon)
    return code, inner_step(controller, code, loop)


def inner_step(controller: Controller, code: "Code", loop: Loop) -> str:
    """Add a controller, such as one that another one holds; return the name of its step function.

    Raises
    ------
    ConfigError
        It cannot be exported.
    """
    kind = type(controller)
    if not isinstance(controller, Exportable):
        raise ConfigError(
            f"{kind.__name__} cannot be exported within another controller: it is not of ddpc_controllers"
        )
    of_the_house = kind.__module__.startswith(f"{_PACKAGE}.")
    if not (of_the_house or "c_step" in vars(kind)):
        # The base class's code does not know what a subclass changes.
        raise ConfigError(f"{kind.__name__} cannot be exported: the class has no c_step() of its own")
    if not (controller._follows_in_c and (of_the_house or "_follows_in_c" in vars(kind))):
        code.follows = False
    there = {
        "disturbances": loop.disturbances,
        "bands": loop.bands,
        "moving limits": loop.moving_limits,
        "prices": loop.charges,
    }
    unknown = [name for name, things in there.items() if things and name not in controller._known_in_c]
    if unknown:
        named = " and ".join(unknown)
        raise ConfigError(
            f"{kind.__name__} cannot be exported with {named}: its code in C does not know them"
        )
    return controller.c_step(code, loop)


ALL_AHEAD = ("disturbances", "bands", "moving limits", "prices")
"""What a sample may say besides measurements and references."""


class Ahead(NamedTuple):
    """What a sample says besides measurements and references, as numbers that the code remembers.

    Parameters
    ----------
    places : Sample
        Where each value of a sample stands in the memory.
    factors : Sample
        What it is multiplied by.
    """

    places: Sample
    factors: Sample

    def through(self, change: Callable[[Sample], Sample]) -> "Ahead":
        """Return what is left of it for a method that sees samples changed."""
        return self._replace(places=change(self.places), factors=change(self.factors))

    def scaled(self, scales: Iterable[tuple[str, FloatArray]]) -> "Ahead":
        """Return it in scaled signals, given the scales of fields of a sample."""
        parts = {name: getattr(self.factors, name) / scale for name, scale in scales}
        return self._replace(factors=self.factors._replace(**parts))

    def chosen(
        self, code: "Code", choose: Callable[[Sample], FloatArray], target: str, far: float = inf
    ) -> str:
        """Return a statement in C that brings what ``choose`` makes of a sample to the place ``target``.

        ``far`` stands for what is infinite.
        """
        places, factors = (np.ravel(choose(sample)) for sample in (self.places, self.factors))
        code.kernel("ahead")
        values = {"places": code.sizes(places), "factors": code.doubles(factors)}
        chosen = code.constant("Chosen", n=len(places), **values, far=far)
        return f"choose_ahead(&{chosen}, memory, {target});\n"

    def limits(self, code: "Code", samples: int, target: str) -> str:
        """Return one for the limits of the inputs over samples: all lower ones, and then the upper ones."""
        return self.chosen(code, lambda sample: sample.input_limits[:samples].transpose(2, 0, 1), target)


def moved_inputs(loop: Loop) -> bool:
    """Return whether limits of inputs move."""
    return any(variable.name in loop.moving_limits for variable in loop.inputs)


def qp_memory(unknowns: int) -> int:
    """Return how many numbers the QP kernel needs: QP_MEMORY in C."""
    return 2 + 6 * unknowns + unknowns**2 + unknowns * (unknowns + 1) // 2


class Table(NamedTuple):
    """A constant table of numbers, which has a name in C."""

    name: str
    numbers: FloatArray

    def written(self) -> str:
        """Return it as a constant."""
        values = [_double(number) for number in self.numbers.tolist()]
        return f"static const double {self.name}[{len(values)}] = {{\n    {_in_rows(values)}}};"

    def declared(self) -> str:
        """Return it as memory that is yet to be filled."""
        return f"static double {self.name}[{len(self.numbers)}];"

    def loading(self) -> list[str]:
        """Return statements that fill it from ``numbers``."""
        count = len(self.numbers)
        return [f"memcpy({self.name}, numbers, {count} * sizeof(double));", f"numbers += {count};"]


class Structure(NamedTuple):
    """A constant structure of a kernel's type: names of others, counts, and numbers."""

    kind: str
    name: str
    members: Mapping[str, object]

    @property
    def numbers(self) -> FloatArray:
        """Its members that are numbers and no counts."""
        return np.array([value for value in self.members.values() if isinstance(value, float)])

    def written(self) -> str:
        """Return it as a constant."""
        return f"static const {self._with(self.members)}"

    def declared(self) -> str:
        """Return it with its numbers yet to be filled in."""
        others = {name: value for name, value in self.members.items() if not isinstance(value, float)}
        return f"static {self._with(others)}" if len(others) < len(self.members) else self.written()

    def loading(self) -> list[str]:
        """Return statements that fill its numbers in from ``numbers``."""
        of_numbers = (field for field, value in self.members.items() if isinstance(value, float))
        return [f"{self.name}.{field} = *numbers++;" for field in of_numbers]

    def _with(self, members: Mapping[str, object]) -> str:
        texts = ", ".join(f".{field} = {_member(value)}" for field, value in members.items())
        return f"{self.kind} {self.name} = {{{texts}}};"


class Code:
    """The parts of a controller's C code, in the order in which they were added.

    Attributes
    ----------
    parts : list of str, Table or Structure
        Constants and step functions.
    remembered : int
        How many numbers the memory has so far.
    ahead : Ahead or None
        What is known of disturbances, bands, prices and moving limits, as the method that is being added
        sees it; None: there is nothing of the kind.
    follows : bool
        Whether all step functions follow the plant where somebody else applies the inputs.
    """

    def __init__(self) -> None:
        self.parts: list[str | Table | Structure] = []
        self.remembered = 0
        self.ahead: Ahead | None = None
        self.follows = True
        self._starts: list[FloatArray] = []
        self._kernels: list[str] = []
        self._tables: dict[tuple[str, str | bytes], str] = {}
        self._count = 0

    def look_ahead(self, loop: Loop, horizon: int) -> None:
        """Begin the memory with what a loop has besides measurements and references, from ``r`` of a step.

        Parameters
        ----------
        loop : Loop
            The loop.
        horizon : int
            How far the controller looks.
        """
        shapes = further_arguments(loop, horizon)
        sizes = [prod(shape) for shape in shapes.values()]
        if not shapes:
            return
        starts, parts = np.full(sum(sizes), np.nan), np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])
        places = {
            name: part.reshape(shape) for (name, shape), part in zip(shapes.items(), parts, strict=True)
        }
        before, taken = np.arange(len(starts)), np.ones(len(starts), dtype=bool)
        held = dict[str, NDArray[np.intp]]()
        for name, (now, length) in _ROWS.items():
            if name in places:
                rows = [*([places[now]] if now else []), *places[name]]
                for last, later in pairwise(rows):
                    before[later] = last
                ahead = np.minimum(np.arange(horizon + length) + bool(now), len(rows) - 1)
                held[name] = np.array(rows)[ahead]
        if loop.disturbances:
            starts[places["disturbance"]] = [variable.start for variable in loop.disturbances]
        if loop.moving_limits:  # sides that stand are what they are, and may be infinite
            bounds, moving = loop.bounds, loop.moving_limits
            for name, variables, low, high in (
                ("input_limits", loop.inputs, bounds.u_min, bounds.u_max),
                ("output_limits", loop.outputs, bounds.y_min, bounds.y_max),
            ):
                limits = np.stack([low, high], axis=1)
                moves = np.array([variable.name in moving for variable in variables])[:, np.newaxis]
                starts[places[name]], taken[places[name]] = limits, moves & np.isfinite(limits)
        numbers = np.flatnonzero(taken)
        known = {"places": self.sizes(numbers), "before": self.sizes(before[numbers])}
        self.kernel("ahead")
        self._known = self.constant("Known", n=len(numbers), **known)
        self.memory(starts)
        seen: dict[str, Any] = {name: values.astype(np.float64) for name, values in (places | held).items()}
        p, q = len(loop.outputs), len(loop.measurements)
        empty = Sample(0, 0.0, np.zeros(p), np.zeros(q), np.zeros((horizon, p)), np.zeros(p))
        factors: dict[str, Any] = {name: np.ones(values.shape) for name, values in seen.items()}
        self.ahead = Ahead(empty._replace(**seen), empty._replace(**factors))

    @property
    def start(self) -> FloatArray:
        """What the memory begins with."""
        return np.concatenate([np.empty(0), *self._starts])

    @contextmanager
    def seeing(self, ahead: Ahead | None) -> Iterator[None]:
        """Let what is added meanwhile see this of the time ahead."""
        self.ahead, before = ahead, self.ahead
        yield
        self.ahead = before

    def doubles(self, values: ArrayLike) -> str:
        """Return the name of a constant table of numbers, row after row; NULL for none."""
        flat = np.array(values, dtype=np.float64).ravel()
        return self._once("double", flat.tobytes(), lambda name: Table(name, flat)) if flat.size else "NULL"

    def sizes(self, values: Iterable[int]) -> str:
        """Return the name of a constant table of sizes or indices (``size_t``); NULL for none."""
        return self.table("size_t", [str(int(value)) for value in values])

    def memory(self, start: ArrayLike) -> str:
        """Return the place of numbers that the controller remembers, as an expression within a step function.

        Parameters
        ----------
        start : array
            Their values before the first step, row after row.
        """
        place, values = self.remembered, np.array(start, dtype=np.float64).ravel()
        self._starts.append(values)
        self.remembered += values.size
        return f"(memory + {place})"

    def scratch(self, *sizes: int) -> list[str]:
        """Return places for so many numbers each, which a step works in: zero before the first one."""
        *places, end = accumulate(sizes, initial=self.remembered)
        self.memory(np.zeros(end - self.remembered))
        return [f"(memory + {place})" for place in places]

    def constant(self, kind: str, /, **fields: object) -> str:
        """Return the name of a constant structure of a kernel's type.

        Parameters
        ----------
        kind : str
            The type.
        **fields : object
            Its members: numbers, and names that other calls returned.
        """
        name = self._name(kind.lower())
        self.parts.append(Structure(kind, name, fields))
        return name

    def held(self, kind: str, *starts: ArrayLike) -> str:
        """Return the declaration of ``held``, a structure of a kernel, for a step function.

        Parameters
        ----------
        kind : str
            The type.
        *starts : array or str
            Its members in their order: what each begins with, or a name or initialiser.
        """
        members = (start if isinstance(start, str) else self.memory(start) for start in starts)
        return f"const {kind} held = {{{', '.join(members)}}};\n"

    def kernel(self, name: str) -> None:
        """Use the kernel NAME.h with NAME.c, of ``runtime`` or a folder in it, and what it includes."""
        if name not in self._kernels:
            self._kernels.append(name)

    def step(self, body: str) -> str:
        """Return the name of a step function.

        Parameters
        ----------
        body : str
            Statements in C that set ``u`` and ``told``, given ``memory`` and ``sample``.
        """
        name = self._name("step")
        unused = [word for word in ("memory", "sample", "told") if word not in body]
        lines = [f"(void){word};" for word in unused] + body.strip().splitlines()
        text = "\n".join(f"    {line}".rstrip() for line in lines)
        head = f"static void {name}(double memory[], const Sample *sample, double u[], Told *told)"
        self.parts.append(f"{head}\n{{\n{text}\n}}")
        return name

    def controller(
        self,
        step: str,
        horizon: int,
        loop: Loop,
        rest: FloatArray | None = None,
        *,
        apart: bool = False,
    ) -> ControllerCode:
        """Return the whole code, given the step function of the outermost controller.

        Parameters
        ----------
        step : str
            Its name.
        horizon : int
            How many future references it takes; those beyond the loop's preview repeat the last one.
        loop : Loop
            The loop it was started with.
        rest : array, optional
            What the memory has so far where the controller was started at rest; default: it was.
        apart : bool
            Whether its numbers stand apart from the code.
        """
        controller_size = self.remembered
        p, q, m = len(loop.outputs), len(loop.measurements), len(loop.inputs)
        outputs = [variable.name for variable in loop.outputs]
        others = [v.name for v in loop.measurements if v.name not in outputs]
        places = self.sizes([[*outputs, *others].index(v.name) for v in loop.measurements])
        preview = min(loop.preview, horizon)
        seen, applied, follows = "", "", ""
        if self.follows:
            seen = self.memory(np.full(p + len(others), np.nan))
            applied, follows = self.memory(resting_input(loop)), self.memory(0.0)
        measured, reference = self.scratch(q, horizon * p)
        last = self.memory(resting_input(loop))
        looks = list[str]()
        if self.ahead:
            looks.append(f"take_known(&{self._known}, r + {(1 + preview) * p}, memory);")
        if self.ahead and moved_inputs(loop):
            low = self.memory(np.zeros(2 * m))
            high = f"{low} + {m}"
            looks.append(self.ahead.limits(self, 1, low).rstrip())
        else:
            low, high = self.doubles(loop.bounds.u_min), self.doubles(loop.bounds.u_max)
        begun = self.start
        start = resting = self._filling(begun, apart=apart)
        if self.follows and rest is not None:
            resting = self._filling(np.append(rest, begun[controller_size:]), apart=apart)
        further = further_arguments(loop, horizon)
        sizes = {
            "MEASUREMENTS": p + len(others),
            "REFERENCES": (1 + preview) * p + sum(map(prod, further.values())),
            "INPUTS": m,
            "MEMORY": self.remembered,
        }

        def body(y: str, inputs: str) -> list[str]:
            return [
                f"const Sample sample = {{{y}, {measured}, {reference}, r, {inputs}}};",
                f"choose({y}, {places}, {q}, {measured});",
                f"repeat_last(r, {preview}, {horizon}, {p}, {reference});",
                *looks,
                f"{step}(memory, &sample, u, &told);",
            ]

        begin = ["Told told = {0, 0, 0};", "double *const memory = state->memory;"]
        end = [
            f"hold_bounds(u, {low}, {high}, {m}, {last}, &told);",
            "state->status = told.status;",
            "state->iterations = told.iterations;",
            "state->active_bounds = told.active_bounds;",
            "return told.status;",
        ]
        functions = {_STEP: [*begin, *body("y", "NULL"), *end]}
        if self.follows:
            functions[_STEP].insert(2, f"{follows}[0] = 0.0;")
            functions[_FOLLOW] = [
                *begin,
                f"if ({follows}[0] == 0.0) {{",
                *(f"    {line}" for line in resting),
                "}",
                f"{follows}[0] = 1.0;",
                f"if (take_applied(y, {seen}, {p + len(others)}, u, {applied}, {m}, &told)) {{",
                *(f"    {line}" for line in body(seen, applied)),
                "}",
                f"memcpy(u, {applied}, {m} * sizeof(double));",
                *end,
            ]
        self.kernel("sample")
        numeric = [part for part in self.parts if not isinstance(part, str)]
        numbers = np.concatenate([np.empty(0), *(part.numbers for part in numeric)])
        footprint = Footprint(_DOUBLE * numbers.size, _DOUBLE * self.remembered + _COUNTS)
        if apart:
            functions[_LOAD] = [line for part in numeric for line in part.loading()]
        includes = ["controller.h", *(f"{name}.h" for name in self._kernels)]
        parts = [
            "\n".join(f'#include "{name}"' for name in includes)
            + "\n\n#include <math.h>\n#include <stddef.h>\n#include <string.h>",
            *self.texts(apart=apart),
            _START.format(filling="\n    ".join(start)),
            *(
                f"{head}\n{{\n" + "\n".join(f"    {line}" for line in lines) + "\n}"
                for head, lines in functions.items()
            ),
        ]
        return ControllerCode(
            {
                "controller.h": _HEADER.format(
                    sizes="\n".join(f"#define CONTROLLER_{name} {size}" for name, size in sizes.items()),
                    statuses="\n".join(f" *   {bit}: {text}" for bit, text in STATUSES.items()),
                    y=_in_comment([*outputs, *others]),
                    r=_in_comment(outputs),
                    further="".join(
                        f"\n *      then {name}, {' x '.join(map(str, shape))} (see further_arguments)"
                        for name, shape in further.items()
                    ),
                    u=_in_comment([variable.name for variable in loop.inputs]),
                    sampling_time=f"{loop.sampling_time!r} s",
                    preview=preview,
                    constants=footprint.constants,
                    state=footprint.state,
                    follow=(_FOLLOWS if self.follows else "") + (_LOADS if apart else ""),
                ),
                "controller.c": "\n\n".join(parts) + "\n",
                **_runtime(tuple(self._kernels)),
            },
            STATUSES,
            self.follows,
            numbers if apart else np.empty(0),
            footprint,
        )

    def _filling(self, values: FloatArray, *, apart: bool) -> list[str]:
        """Return statements that give the memory its first values.

        What a step works in begins with zeros, of which a target needs no copy among its constants. Where
        numbers stand apart, the statements are the same whichever they are.
        """
        size = f"{len(values)} * sizeof(double)"
        if apart:
            name = self._name("table")
            self.parts.append(Table(name, values))
            return [f"memcpy(memory, {name}, {size});"]
        filled = np.flatnonzero(values.view(np.int64))  # -0.0 is none of the zeros
        lines = [f"memset(memory, 0, {size});"]
        for part in np.split(filled, np.flatnonzero(np.diff(filled) > _FEW_ZEROS) + 1):
            if part.size:
                first, end = int(part[0]), int(part[-1]) + 1
                table = self.doubles(values[first:end])
                lines.append(f"memcpy(memory + {first}, {table}, {end - first} * sizeof(double));")
        return lines

    def texts(self, *, apart: bool = False) -> list[str]:
        """Return the parts as C has them; apart: numbers are yet to be filled in."""
        return [
            part if isinstance(part, str) else part.declared() if apart else part.written()
            for part in self.parts
        ]

    def table(self, kind: str, values: Sequence[str]) -> str:
        """Return the name of a constant table of values of one type, as C has them; NULL for none.

        Tables of the same values are one.
        """
        if not values:
            return "NULL"
        text = _in_rows(values)
        head = f"static const {kind}"
        return self._once(kind, text, lambda name: f"{head} {name}[{len(values)}] = {{\n    {text}}};")

    def _once(self, kind: str, content: str | bytes, make: Callable[[str], str | Table]) -> str:
        """Return the name of a table, which is made of its name where there is none of the same values."""
        if (kind, content) not in self._tables:
            name = self._tables[kind, content] = self._name("table")
            self.parts.append(make(name))
        return self._tables[kind, content]

    def _name(self, kind: str) -> str:
        self._count += 1
        return f"{kind}_{self._count}"


_HEADER = """/* A sampled controller: call controller_step once in every sampling time of {sampling_time}.
 *
 *   y: {y}; NaN where one is missing
 *   r: {r} now (the setpoint), then {preview} future samples, one after another{further}
 *   u: {u}, within their bounds
 *
 * Its constants take {constants} bytes, each ControllerState {state}, with doubles of 8.
 *
 * A step returns 0, or why u is a fallback, a sum of
{statuses}
 *
 * No heap, no static data that changes, no unbounded loop: several states can run side by side. */
#ifndef CONTROLLER_H
#define CONTROLLER_H

{sizes}

typedef struct {{
    double memory[CONTROLLER_MEMORY];
    unsigned status;
    unsigned iterations;
    unsigned active_bounds;
}} ControllerState;

void controller_start(ControllerState *state);
unsigned controller_step(ControllerState *state, const double y[], const double r[], double u[]);
{follow}
#endif
"""

_FOLLOWS = """
/* In place of controller_step while something else drives the plant: u is what it applies at this
 * sample, and comes back finite and within the bounds. The next controller_step goes on from there
 * without a bump. The first call after a step, or after the start, begins a new past. */
unsigned controller_follow(ControllerState *state, const double y[], const double r[], double u[]);
"""

_LOADS = """
#define CONTROLLER_LOADS 1
/* Fills in the numbers that stand apart from the code, of all states, before any is started. */
void controller_load(const double numbers[]);
"""

_FEW_ZEROS = 8  # between other numbers: a statement to leave them out takes as much
_START = """void controller_start(ControllerState *state)
{{
    double *const memory = state->memory;
    {filling}
    state->status = state->iterations = state->active_bounds = 0;
}}"""

_STEP = "unsigned controller_step(ControllerState *state, const double y[], const double r[], double u[])"
_FOLLOW = _STEP.replace("_step", "_follow")
_LOAD = "void controller_load(const double numbers[])"


@cache
def _kernel_files() -> Mapping[str, str]:
    """Return the texts of all kernels, by the name of their file."""
    entries = (package_files(_PACKAGE) / "export" / "runtime").iterdir()
    files = (file for entry in entries for file in (entry.iterdir() if entry.is_dir() else [entry]))
    return {file.name: file.read_text(encoding="utf-8") for file in files}


@cache
def _runtime(kernels: tuple[str, ...]) -> Mapping[str, str]:
    """Return the files of the kernels and of those that they include, by name."""
    files = _kernel_files()
    texts = dict[str, str]()
    open_ones = list(kernels)
    while open_ones:
        name = open_ones.pop()
        for file in (f"{name}.h", f"{name}.c"):
            text = texts[file] = files[file]
            includes = [line.split('"')[1] for line in text.splitlines() if line.startswith('#include "')]
            open_ones += [include.removesuffix(".h") for include in includes if include not in texts]
    return texts


def _in_comment(names: Sequence[str]) -> str:
    """Return names as a comment in C may hold them."""
    return printable(", ".join(names)).replace("*/", "* /").replace("/*", "/ *")


def _in_rows(values: Sequence[str]) -> str:
    return ",\n    ".join(", ".join(values[i : i + _WIDTH]) for i in range(0, len(values), _WIDTH))


def _member(value: object) -> str:
    return (
        _double(value)
        if isinstance(value, float)
        else str(int(value))
        if isinstance(value, bool)
        else str(value)
    )


def _double(value: Any) -> str:
    """Return a number as a constant in C, every digit kept."""
    if np.isnan(value):
        return "NAN"
    return ("-" if value < 0 else "") + "INFINITY" if np.isinf(value) else repr(float(value))
