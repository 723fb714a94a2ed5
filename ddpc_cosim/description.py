"""What a plant says about itself: an FMU, an SSP archive, equations, a Python class, or several coupled."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, product
from typing import Literal, Self

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.variables import (
    DisplayUnit,
    Variable,
    not_names,
    with_display_units,
    with_nominal,
    with_start,
)
from fmu_plants.spelling import did_you_mean

Values = Literal["real", "integer", "boolean", "text", "none"]
"""What the values of a variable are; ``none``: they cannot be exchanged."""

_ELEMENT = re.compile(r"(?P<array>.+)\[(?P<indices>\d+(?:,\d+)*)\]")


@dataclass(frozen=True, slots=True)
class DescribedVariable:
    """A variable of a plant in the terms of FMI: a number, a text, or an array of them.

    Parameters
    ----------
    variable : Variable
        Name, unit, range, start value.
    reference : int
        Value reference in an FMU.
    type : str
        The name of its type, for example ``Real``, ``Float64``, ``Boolean`` or ``String``.
    causality, variability, initial : str
        As in a model description, with the standard's defaults filled in.
    shape : tuple of int
        Sizes of an array at the start values of structural parameters; empty for a scalar.
    dimensions : tuple of int or str
        The same; a name stands for the structural parameter that the size follows.
    start_text : str or None
        Start value as written.
    items : mapping of str to int
        Names of an enumeration's values.
    derivative_of : str
        Name of the state that this is the derivative of; empty for none.
    alias_of : str
        The variable that this is another name of (FMI 3.0); empty for none.
    negated : bool
        Whether its value is the opposite of what the FMU has under the value reference (FMI 1.0).
    values : str
        What its values are: real, integer, boolean, text, or none that can be exchanged.
    """

    variable: Variable
    reference: int = 0
    type: str = "Real"
    causality: str = "local"
    variability: str = "continuous"
    initial: str = ""
    shape: tuple[int, ...] = ()
    dimensions: tuple[int | str, ...] = ()
    start_text: str | None = None
    items: Mapping[str, int] = field(default_factory=dict)
    derivative_of: str = ""
    alias_of: str = ""
    negated: bool = False
    values: Values = "real"

    @property
    def name(self) -> str:
        """The variable's name."""
        return self.variable.name

    @property
    def is_numeric(self) -> bool:
        """Whether its values are numbers, so that it can be an input or output of a plant."""
        return self.values in ("real", "integer", "boolean")

    @property
    def is_structural(self) -> bool:
        """Whether it sets the sizes of arrays."""
        return self.causality == "structuralParameter"

    @property
    def is_tunable(self) -> bool:
        """Whether the value may change during a run from outside."""
        return self.causality == "parameter" and self.variability == "tunable"

    @property
    def is_settable(self) -> bool:
        """Whether a value may be given before the run: parameters, inputs and start values."""
        if self.values == "none" or self.variability == "constant":
            return False
        return self.causality in ("parameter", "structuralParameter", "input") or (
            self.causality in ("output", "local") and self.initial in ("exact", "approx")
        )


@dataclass(frozen=True, slots=True)
class PlantSignal:
    """One number of a plant: a scalar variable, or an element of an array.

    Parameters
    ----------
    variable : Variable
        Name (``x`` or ``x[2]``), unit, range, start value.
    source : DescribedVariable
        The variable that it belongs to.
    indices : tuple of int
        Place in the array, counted from 1; empty for a scalar.
    """

    variable: Variable
    source: DescribedVariable
    indices: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class DefaultExperiment:
    """The experiment that a plant's author had in mind; None where nothing is said."""

    start_time: float | None = None
    stop_time: float | None = None
    tolerance: float | None = None
    step_size: float | None = None


@dataclass(frozen=True, slots=True)
class KeyFigureTags:
    """What the key figures of a building are of, as its files say it (BOPTEST's convention).

    Parameters
    ----------
    area : float
        Floor area [m2].
    sources : mapping of str to sequence of str
        The outputs of each source: ``{"ElectricPower": ["reaPHeaPum_y"], "AirZoneTemperature[1]": [...]}``.
    """

    area: float
    sources: Mapping[str, Sequence[str]]


class Declarations:
    """Something that declares variables, which are looked up here."""

    __slots__ = ()
    variables: Mapping[str, DescribedVariable]

    def signals(self, *causalities: str) -> Iterator[PlantSignal]:
        """Yield the numbers among the variables of some causalities; arrays element by element."""
        for variable in self.variables.values():
            if variable.causality in causalities and variable.is_numeric:
                starts = (variable.start_text or "").split() if variable.shape else ()
                for indices in product(*(range(1, size + 1) for size in variable.shape)):
                    yield element(variable, indices, starts)

    def signal(self, name: str) -> PlantSignal | None:
        """Return the number of a name, ``x`` or ``x[2]`` or ``x[2,1]``; None if there is none.

        An index is checked against sizes that are fixed; one that follows a structural parameter is checked
        at the start of a run.
        """
        variable = self.variables.get(name)
        if variable is not None:
            return PlantSignal(variable.variable, variable) if not variable.shape else None
        match = _ELEMENT.fullmatch(name)
        variable = self.variables.get(match["array"]) if match else None
        if match is None or variable is None:
            return None
        indices = tuple(map(int, match["indices"].split(",")))
        fits = len(indices) == len(variable.shape) and all(
            i >= 1 and (isinstance(size, str) or i <= size)
            for i, size in zip(indices, variable.dimensions, strict=True)
        )
        return element(variable, indices) if fits else None

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the continuous states, where the description gives them."""
        return tuple(dict.fromkeys(v.derivative_of for v in self.variables.values() if v.derivative_of))

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The sizes of arrays of numbers by name."""
        return {v.name: v.shape for v in self.variables.values() if v.shape and v.is_numeric}


@dataclass(frozen=True, slots=True)
class PlantDescription(Declarations):
    """What a plant says about itself, with what a study may use of it.

    Parameters
    ----------
    inputs, outputs, parameters : mapping of str to Variable
        What can be driven, read and set; some may be several of these.
    tunable : frozenset of str
        The parameters that can change during a run.
    default_inputs, default_outputs : tuple of str
        What takes part if a study names none; empty: all.
    switches : mapping of str to str
        For each input that the plant has a control of its own for, the input that is 1 where what is driven
        acts and 0 where that control does: ``oveHeat_u`` -> ``oveHeat_activate``.
    display_units : mapping of str to tuple of DisplayUnit
        The display units that the plant defines for each unit.
    variables : mapping of str to DescribedVariable
        All that it declares, in its order; of a system of several those of its parts as ``part.variable``.
    default_experiment : DefaultExperiment
        What its author had in mind.
    variable_step : bool
        Whether the communication step size may change.
    fixed_step : float or None
        Step size of which communication steps should be multiples [s].
    warnings : tuple of str
        What is wrong with what it says but was understood.
    key_figures : KeyFigureTags or None
        What the key figures of a building are of; None: it does not say.
    """

    inputs: Mapping[str, Variable]
    outputs: Mapping[str, Variable]
    parameters: Mapping[str, Variable]
    tunable: frozenset[str] = field(default_factory=frozenset)
    default_inputs: tuple[str, ...] = ()
    default_outputs: tuple[str, ...] = ()
    display_units: Mapping[str, tuple[DisplayUnit, ...]] = field(default_factory=dict)
    variables: Mapping[str, DescribedVariable] = field(default_factory=dict)
    default_experiment: DefaultExperiment = field(default_factory=DefaultExperiment)
    variable_step: bool = True
    fixed_step: float | None = None
    warnings: tuple[str, ...] = ()
    switches: Mapping[str, str] = field(default_factory=dict)
    key_figures: KeyFigureTags | None = None

    def switched_by(self, given: Mapping[str, str]) -> Self:
        """Return the description with other switches of inputs, by name; an empty one: it has none.

        Switches do not take part if a study names no inputs; one that is none any more does, if it is real.
        """
        if not given:
            return self
        switches = {name: switch for name, switch in {**self.switches, **given}.items() if switch}
        freed = {
            signal.variable.name
            for name in set(self.switches.values()).difference(switches.values())
            if (signal := self.signal(name)) is not None and signal.source.values == "real"
        }
        before = {*(self.default_inputs or self.inputs), *freed}
        inputs = tuple(name for name in self.inputs if name in before.difference(switches.values()))
        return replace(self, switches=switches, default_inputs=inputs)

    def shown(
        self, display_units: Mapping[str, str], nominal: Mapping[str, float], start: Mapping[str, float]
    ) -> Self:
        """Return the variables with a study's display units, nominal values and start values of inputs.

        Raises
        ------
        ConfigError
            There is no conversion to such a display unit; all of them at once.
        """
        inputs, outputs = (
            with_display_units(group.values(), display_units, self.display_units)
            for group in (self.inputs, self.outputs)
        )
        return replace(
            self,
            inputs={v.name: v for v in with_start(with_nominal(inputs, nominal), start)},
            outputs={v.name: v for v in with_nominal(outputs, nominal)},
        )


def describe(
    inputs: Iterable[Variable],
    outputs: Iterable[Variable],
    parameters: Iterable[Variable] = (),
    tunable: frozenset[str] = frozenset(),
    experiment: DefaultExperiment | None = None,
) -> PlantDescription:
    """Return what a plant is whose variables are scalars: one of equations, or a Python class."""
    driven, read, given = ({v.name: v for v in variables} for variables in (inputs, outputs, parameters))
    kinds = {name: ("parameter", "tunable" if name in tunable else "fixed") for name in given}
    kinds |= dict.fromkeys(read, ("output", "continuous")) | dict.fromkeys(driven, ("input", "continuous"))
    variables = {
        name: DescribedVariable(variable, causality=kinds[name][0], variability=kinds[name][1])
        for name, variable in {**given, **read, **driven}.items()
    }
    description = PlantDescription(
        driven,
        read,
        given,
        tunable,
        variables=variables,
        default_experiment=experiment or DefaultExperiment(),
    )
    return description.switched_by(switches_of(description))


def element(
    variable: DescribedVariable, indices: tuple[int, ...], starts: Sequence[str] | None = None
) -> PlantSignal:
    """Return an element of an array variable, or the scalar itself for no indices.

    Whoever takes many has the array's start values split once.
    """
    if not indices:
        return PlantSignal(variable.variable, variable)
    name = f"{variable.name}[{','.join(map(str, indices))}]"
    start = variable.variable.start
    if starts is None:
        starts = (variable.start_text or "").split()
    position = flat_index(indices, variable.shape)
    if len(starts) > 1 and position < len(starts):
        start = number(starts[position], start)
    return PlantSignal(replace(variable.variable, name=name, start=start), variable, indices)


def flat_index(indices: tuple[int, ...], shape: tuple[int, ...]) -> int:
    """Return the position of an element in an array's memory (row-major, FMI 3.0 section 2.2.6.1)."""
    position = 0
    for index, size in zip(indices, shape, strict=True):
        position = position * size + index - 1
    return position


def number(text: str | None, default: float) -> float:
    """Return the number that an attribute's text stands for, the default for none or for other text."""
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        return {"true": 1.0, "false": 0.0}.get(text.strip().lower(), default)
    return default if math.isnan(value) else value


_MOST_ELEMENTS_NAMED = 12


def elements_of(variable: DescribedVariable) -> str:
    """Return the names of an array's elements, those of a large one up to some."""
    indices = product(*(range(1, size + 1) for size in variable.shape))
    named = [element(variable, place).variable.name for place in islice(indices, _MOST_ELEMENTS_NAMED)]
    hidden = math.prod(variable.shape) - len(named)
    return ", ".join(named) + (f" and {hidden} more" if hidden > 0 else "")


_ACTUATOR, _SWITCH, _APPLIED = "_u", "_activate", "_y"
_SWITCHES = re.compile(r"activat|overrid|overwrit", re.IGNORECASE)


def switches_of(description: Declarations) -> dict[str, str]:
    """Return the inputs ``NAME_u`` that ``NAME_activate`` switches, each with that input, by name.

    The former is a real number, the latter a boolean, or a number that is 0 or 1: by its limits, or as its
    description speaks of an activation (BOPTEST's convention). A name alone makes no actuator.
    """
    inputs = {signal.variable.name: signal.source for signal in description.signals("input")}
    pairs = {
        name: name.removesuffix(_ACTUATOR) + _SWITCH
        for name, source in inputs.items()
        if name.endswith(_ACTUATOR) and source.values == "real"
    }
    return {name: switch for name, switch in pairs.items() if switch in inputs and _is_switch(inputs[switch])}


def applied_output(actuator: str) -> str:
    """Return the name of the output that tells what acts as an actuator, whoever drives it; empty: none does.

    By BOPTEST's convention it is ``NAME_y``: the output of the block that ``NAME_u`` overrides.
    """
    return actuator.removesuffix(_ACTUATOR) + _APPLIED if actuator.endswith(_ACTUATOR) else ""


def switch_faults(given: Mapping[str, str], inputs: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Yield names of inputs whose switches, said by name, are not possible, and why."""
    known = set(inputs)
    for name, switch in given.items():
        if name not in known:
            yield name, f'no input "{name}"; {did_you_mean(name, known)}'
        elif switch and switch not in known:
            yield name, f'an override without its switch: no input "{switch}"; {did_you_mean(switch, known)}'
        elif switch and (switch == name or given.get(switch)):
            yield name, f'"{switch}" is switched itself; needed: an input that is 0 or 1'


def switches_in(
    description: Declarations, label: str, driven: Sequence[Variable], given: Mapping[str, str] | None
) -> dict[str, str]:
    """Return the switches of a plant's inputs that are driven, but for those that are driven themselves.

    Parameters
    ----------
    description : Declarations
        The plant.
    label : str
        What it is called, for errors.
    driven : sequence of Variable
        The inputs that are driven.
    given : mapping of str to str or None
        What is said of some inputs in place of what the description says.

    Raises
    ------
    ConfigError
        There are no such inputs; all faults at once.
    """
    given = given or {}
    known = [signal.variable.name for signal in description.signals("input")]
    if faults := [f"{label}: switches: {name}: {fault}" for name, fault in switch_faults(given, known)]:
        raise ConfigError(faults)
    taken = {variable.name for variable in driven}
    switches = {**switches_of(description), **given}
    return {u: switch for u, switch in switches.items() if u in taken and switch and switch not in taken}


def _is_switch(source: DescribedVariable) -> bool:
    """Return whether an input is 0 or 1, by its type, its limits or its description."""
    variable = source.variable
    is_named = variable.min == -math.inf and variable.max == math.inf and variable.description
    return (
        source.values == "boolean"
        or (variable.min, variable.max) == (0.0, 1.0)
        or bool(is_named and _SWITCHES.search(variable.description))
    )


_READABLE = ("output", "local", "parameter", "calculatedParameter", "input")


def default_signals(description: Declarations, causality: str) -> list[PlantSignal]:
    """Return the inputs or outputs that take part if none are named: the real numbers, or all if none are.

    Other names of the same variable are left out, and so are switches.
    """
    switches = set(switches_of(description).values())
    numbers = [
        signal
        for signal in description.signals(causality)
        if not signal.source.alias_of and signal.variable.name not in switches
    ]
    return [signal for signal in numbers if signal.source.values == "real"] or numbers


def choose_signals(
    description: Declarations, label: str, inputs: Sequence[str] | None, outputs: Sequence[str] | None
) -> tuple[tuple[PlantSignal, ...], tuple[PlantSignal, ...]]:
    """Return the numbers to drive and to read.

    Parameters
    ----------
    description : Declarations
        The plant.
    label : str
        What it is called, for errors.
    inputs, outputs : sequence of str or None
        Their names; None for the default.

    Raises
    ------
    ConfigError
        A name does not fit; all faults at once.
    """
    faults: list[str] = []
    chosen = []
    for what, allowed, names in (("input", ("input",), inputs), ("output", _READABLE, outputs)):
        if names is None:
            chosen.append(tuple(default_signals(description, what)))
            continue
        if fault := not_names(f"{what}s", names):
            faults.append(f"{label}: {fault}")
            continue
        chosen_names = []
        for name in names:
            fault = _fault(description, name, what, allowed)
            if fault:
                faults.append(f"{label}: {fault}")
                continue
            chosen_names.append(name)
        faults += [f'{label}: {what} "{name}" is chosen twice' for name in _repeated(chosen_names)]
        signals = (description.signal(name) for name in chosen_names)
        chosen.append(tuple(signal for signal in signals if signal is not None))
        if what == "input":
            faults += [f"{label}: {fault}" for fault in _driven_twice(chosen[-1])]
    if faults:
        raise ConfigError(faults)
    return chosen[0], chosen[1]


def _fault(description: Declarations, name: str, what: str, allowed: Sequence[str]) -> str:
    """Return why a name is not one of a number that can be an input, or an output; empty if it is."""
    signal, variable = description.signal(name), description.variables.get(name)
    if signal is not None and signal.source.is_numeric and signal.source.causality in allowed:
        return ""
    if variable is not None and variable.causality in allowed:
        if not variable.is_numeric:
            return f'"{name}" is a {variable.type} and cannot be an {what}; only numbers can'
        sizes = ",".join(map(str, variable.shape))
        return f'"{name}" is an array of size [{sizes}]; name its elements: {elements_of(variable)}'
    known = [s.variable.name for s in description.signals(*allowed)]
    return f'no {what} "{name}"; {did_you_mean(name, known)}'


def _driven_twice(inputs: Iterable[PlantSignal]) -> Iterator[str]:
    """Yield the inputs that are another name of one before them."""
    known: dict[tuple[str, tuple[int, ...]], str] = {}
    for signal in inputs:
        base = signal.source.alias_of or signal.source.name
        first = known.setdefault((base, signal.indices), signal.variable.name)
        if first != signal.variable.name:
            yield f'the input "{signal.variable.name}" is another name of "{first}"; drive one of them'


def _repeated(names: Sequence[str]) -> Iterable[str]:
    return sorted({name for name in names if names.count(name) > 1})
