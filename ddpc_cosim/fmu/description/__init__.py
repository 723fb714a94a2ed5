"""What an FMU says about itself, in the terms of the contracts."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice, product
from typing import Literal

from ddpc_cosim.errors import ConfigError, FMUImportError
from ddpc_cosim.fmu.description.variable_types import Values, values_of
from ddpc_cosim.variables import DisplayUnit, Variable
from fmu_plants.spelling import did_you_mean

InterfaceKind = Literal["co-simulation", "model-exchange"]

INTERFACES: Mapping[InterfaceKind, str] = {"co-simulation": "CoSimulation", "model-exchange": "ModelExchange"}
"""The kinds of interfaces, the preferred one first, and what model descriptions call them."""

_ELEMENT = re.compile(r"(?P<array>.+)\[(?P<indices>\d+(?:,\d+)*)\]")


@dataclass(frozen=True, slots=True)
class FMUVariable:
    """A variable of an FMU: a number, a text, or an array of them (FMI 3.0).

    Parameters
    ----------
    variable : Variable
        Name, unit, range, start value.
    reference : int
        Value reference.
    type : str
        The name of its FMI type, for example ``Real``, ``Float64``, ``Boolean`` or ``String``.
    causality, variability, initial : str
        As in the model description, with the standard's defaults filled in.
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
    """

    variable: Variable
    reference: int
    type: str
    causality: str
    variability: str
    initial: str = ""
    shape: tuple[int, ...] = ()
    dimensions: tuple[int | str, ...] = ()
    start_text: str | None = None
    items: Mapping[str, int] = field(default_factory=dict)
    derivative_of: str = ""
    alias_of: str = ""
    negated: bool = False

    @property
    def name(self) -> str:
        """The variable's name."""
        return self.variable.name

    @property
    def values(self) -> Values:
        """What its values are: real, integer, boolean, text, or none that can be exchanged."""
        return values_of(self.type)

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
class Signal:
    """One number of an FMU: a scalar variable, or an element of an array.

    Parameters
    ----------
    variable : Variable
        Name (``x`` or ``x[2]``), unit, range, start value.
    source : FMUVariable
        The variable that it belongs to.
    indices : tuple of int
        Place in the array, counted from 1; empty for a scalar.
    """

    variable: Variable
    source: FMUVariable
    indices: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Interface:
    """One of the ways in which an FMU can be run, and what it can do there.

    Parameters
    ----------
    kind : str
        ``"co-simulation"`` or ``"model-exchange"``.
    model_identifier : str
        Name of the library.
    variable_step : bool
        Whether the communication step size may change.
    fixed_step : float or None
        Step size of which communication steps must be multiples [s] (FMI 3.0).
    """

    kind: InterfaceKind
    model_identifier: str
    needs_execution_tool: bool = False
    only_one_instance: bool = False
    can_save_state: bool = False
    can_serialize_state: bool = False
    provides_directional_derivatives: bool = False
    variable_step: bool = True
    fixed_step: float | None = None
    has_event_mode: bool = False
    needs_completed_step: bool = True


@dataclass(frozen=True, slots=True)
class Clock:
    """A clock (FMI 3.0, section 2.2.8).

    Parameters
    ----------
    name : str
        Its name.
    reference : int
        Value reference.
    causality : str
        ``input``, ``output`` or ``local``: who lets it tick.
    variability : str
        What its interval is: ``constant``, ``fixed``, ``calculated``, ``tunable``, ``changing``,
        ``countdown`` or ``triggered``.
    interval, shift : float
        Time between two ticks, and from the start to the first one [s]; NaN and 0 where nothing is written.
    """

    name: str
    reference: int
    causality: str
    variability: str
    interval: float = math.nan
    shift: float = 0.0

    @property
    def is_periodic_input(self) -> bool:
        """Whether it ticks by what the description says, and from outside."""
        is_known = 0.0 < self.interval < math.inf and 0.0 <= self.shift < math.inf
        is_constant = self.variability in ("constant", "fixed", "tunable")  # nobody changes the latter here
        return self.causality == "input" and is_constant and is_known


@dataclass(frozen=True, slots=True)
class DefaultExperiment:
    """The experiment that the FMU's author had in mind; None where nothing is said."""

    start_time: float | None = None
    stop_time: float | None = None
    tolerance: float | None = None
    step_size: float | None = None


@dataclass(frozen=True)
class FMUDescription:
    """The part of a model description that co-simulation needs.

    Parameters
    ----------
    guid : str
        GUID (FMI 1.0, 2.0) or instantiation token (FMI 3.0).
    variables : dict of str to FMUVariable
        All variables by name, in the order of the description.
    interfaces : mapping of str to Interface
        What the FMU offers, by kind.
    display_units : mapping of str to tuple of DisplayUnit
        The display units that the FMU defines for each unit.
    derivatives : tuple of str
        Names of the continuous states' derivatives, in the order of the states' vector; arrays as a whole.
    direct_feedthrough : mapping of str to tuple of str or None
        The variables that each output depends on directly; None where the FMU does not say.
    source_files : mapping of str to tuple of str
        The C files to compile, by model identifier (FMI 2.0).
    clocks : tuple of Clock
        Its clocks (FMI 3.0).
    warnings : tuple of str
        What is wrong with the description but was understood.
    """

    fmi_version: str
    guid: str
    model_name: str
    variables: dict[str, FMUVariable]
    interfaces: Mapping[str, Interface]
    generation_tool: str = "unknown"
    generated_at: str = ""
    author: str = ""
    version: str = ""
    copyright: str = ""
    license: str = ""
    text: str = ""
    continuous_states: int = 0
    event_indicators: int = 0
    derivatives: tuple[str, ...] = ()
    default_experiment: DefaultExperiment = field(default_factory=DefaultExperiment)
    display_units: Mapping[str, tuple[DisplayUnit, ...]] = field(default_factory=dict)
    dependencies: Mapping[str, tuple[str, ...] | None] = field(default_factory=dict)
    source_files: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    clocks: tuple[Clock, ...] = ()
    warnings: tuple[str, ...] = ()

    def ticking_clocks(self, interface: Interface) -> tuple[Clock, ...]:
        """Return the clocks that tick where the FMU is run: periodic inputs, if there are events."""
        has_events = interface.kind == "model-exchange" or interface.has_event_mode
        return tuple(clock for clock in self.clocks if clock.is_periodic_input and has_events)

    @property
    def major(self) -> int:
        """The FMI version: 1, 2 or 3."""
        return int(self.fmi_version[0])

    @property
    def preferred(self) -> Interface | None:
        """The interface that is used unless another is asked for; None if there is none."""
        return next((self.interfaces[kind] for kind in INTERFACES if kind in self.interfaces), None)

    def signals(self, *causalities: str) -> Iterator[Signal]:
        """Yield the numbers among the variables of some causalities; arrays element by element."""
        for variable in self.variables.values():
            if variable.causality in causalities and variable.is_numeric:
                starts = (variable.start_text or "").split() if variable.shape else ()
                for indices in product(*(range(1, size + 1) for size in variable.shape)):
                    yield element(variable, indices, starts)

    def signal(self, name: str) -> Signal | None:
        """Return the number of a name, ``x`` or ``x[2]`` or ``x[2,1]``; None if there is none.

        An index is checked against sizes that are fixed; one that follows a structural parameter is checked
        at the start of a run.
        """
        variable = self.variables.get(name)
        if variable is not None:
            return Signal(variable.variable, variable) if not variable.shape else None
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
    def state_order(self) -> tuple[str, ...]:
        """Names of the continuous states in the order of their vector; empty where one has no name."""
        known = [self.variables[name].derivative_of for name in self.derivatives if name in self.variables]
        return tuple(known) if all(name in self.variables for name in known) else ()

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the continuous states, where the description gives them."""
        return tuple(dict.fromkeys(v.derivative_of for v in self.variables.values() if v.derivative_of))


def element(variable: FMUVariable, indices: tuple[int, ...], starts: Sequence[str] | None = None) -> Signal:
    """Return an element of an array variable, or the scalar itself for no indices.

    Whoever takes many has the array's start values split once.
    """
    if not indices:
        return Signal(variable.variable, variable)
    name = f"{variable.name}[{','.join(map(str, indices))}]"
    start = variable.variable.start
    if starts is None:
        starts = (variable.start_text or "").split()
    position = flat_index(indices, variable.shape)
    if len(starts) > 1 and position < len(starts):
        start = number(starts[position], start)
    return Signal(replace(variable.variable, name=name, start=start), variable, indices)


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


def elements_of(variable: FMUVariable) -> str:
    """Return the names of an array's elements, those of a large one up to some."""
    indices = product(*(range(1, size + 1) for size in variable.shape))
    named = [element(variable, place).variable.name for place in islice(indices, _MOST_ELEMENTS_NAMED)]
    hidden = math.prod(variable.shape) - len(named)
    return ", ".join(named) + (f" and {hidden} more" if hidden > 0 else "")


def direct_dependencies(
    description: FMUDescription, inputs: Sequence[Signal], outputs: Sequence[Signal]
) -> dict[str, frozenset[str]]:
    """Return for outputs the inputs that they depend on directly: all, where the FMU does not say."""
    found = {}
    for output in outputs:
        source = output.source
        known = description.dependencies.get(source.alias_of or source.name)
        on = [s for s in inputs if known is None or (s.source.alias_of or s.source.name) in known]
        found[output.variable.name] = frozenset(signal.variable.name for signal in on)
    return found


_READABLE = ("output", "local", "parameter", "calculatedParameter", "input")


def is_sampled(inputs: Sequence[Signal]) -> bool:
    """Return whether all inputs are discrete: those of a sampled block, such as an exported controller."""
    return bool(inputs) and all(signal.source.variability == "discrete" for signal in inputs)


def default_signals(description: FMUDescription, causality: str) -> list[Signal]:
    """Return the inputs or outputs that take part if none are named: the real numbers, or all if none are.

    Other names of the same variable are left out.
    """
    numbers = [signal for signal in description.signals(causality) if not signal.source.alias_of]
    return [signal for signal in numbers if signal.source.values == "real"] or numbers


def choose_interface(description: FMUDescription, fmi_type: str, label: str) -> Interface:
    """Return how the FMU is run.

    Raises
    ------
    ConfigError
        The type is none.
    FMUImportError
        The FMU does not have it.
    """
    kinds = ("co-simulation", "model-exchange")
    if fmi_type not in ("auto", *kinds):
        raise ConfigError(f'fmi_type = "{fmi_type}" is not possible; allowed: auto, {", ".join(kinds)}')
    for kind in kinds if fmi_type == "auto" else (fmi_type,):
        if kind in description.interfaces:
            return description.interfaces[kind]
    offered = ", ".join(description.interfaces) or "neither Co-Simulation nor Model Exchange"
    wanted = "" if fmi_type == "auto" else f"it cannot be run for {fmi_type}: "
    raise FMUImportError(f"{label}: {wanted}the FMU is for {offered} (FMI {description.fmi_version})")


def choose_signals(
    description: FMUDescription, label: str, inputs: Sequence[str] | None, outputs: Sequence[str] | None
) -> tuple[tuple[Signal, ...], tuple[Signal, ...]]:
    """Return the numbers to drive and to read.

    Parameters
    ----------
    description : FMUDescription
        The FMU.
    label : str
        The FMU's file name, for errors.
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
        found = []
        for name in names:
            fault = _fault(description, name, what, allowed)
            if fault:
                faults.append(f"{label}: {fault}")
                continue
            found.append(name)
        faults += [f'{label}: {what} "{name}" is chosen twice' for name in _repeated(found)]
        signals = (description.signal(name) for name in found)
        chosen.append(tuple(signal for signal in signals if signal is not None))
        if what == "input":
            faults += [f"{label}: {fault}" for fault in _driven_twice(chosen[-1])]
    if faults:
        raise ConfigError(faults)
    return chosen[0], chosen[1]


def _fault(description: FMUDescription, name: str, what: str, allowed: Sequence[str]) -> str:
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


def _driven_twice(inputs: Iterable[Signal]) -> Iterator[str]:
    """Yield the inputs that are another name of one before them."""
    known: dict[tuple[str, tuple[int, ...]], str] = {}
    for signal in inputs:
        base = signal.source.alias_of or signal.source.name
        first = known.setdefault((base, signal.indices), signal.variable.name)
        if first != signal.variable.name:
            yield f'the input "{signal.variable.name}" is another name of "{first}"; drive one of them'


def _repeated(names: Sequence[str]) -> Iterable[str]:
    return sorted({name for name in names if names.count(name) > 1})
