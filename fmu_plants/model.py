"""A plant written once: its variables, the right-hand side of its differential equations, their checks.

Nothing here needs SymPy, so that a plant's variables can be read without the cost of its import; the
equations are a function that is called with symbols when the plant is exported.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import inf, isfinite, isnan
from typing import Any, Literal, Protocol

from fmu_plants.texts import encodable, printable
from fmu_plants.units import DisplayUnit, parse_unit

TIME = "time"
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def identifier(text: str) -> str:
    """Return the text as a name that a variable or model can have."""
    name = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_")
    return name if name and not name[0].isdigit() else f"_{name}"


class ModelError(ValueError):
    """A plant model contradicts itself; the message lists all errors that were found."""

    @classmethod
    def listing(cls, model: str, errors: Sequence[str]) -> "ModelError":
        """Put all errors of one model into one."""
        return cls("\n  - ".join([f"model {model!r} has {len(errors)} error(s):", *errors]))


class ExportError(RuntimeError):
    """The FMU could not be built; the message says what to do about it."""


class ExportUsageError(ExportError):
    """What was asked for is not possible: a platform, a version, or where the FMU is to be written."""


class Symbols(Protocol):
    """What the equations are written in: one SymPy symbol per variable, and ``time``.

    ``v.angle`` and ``v["angle"]`` are the symbol of the variable `angle`, ``v.time`` is the time in s.
    """

    def __getattr__(self, name: str) -> Any:
        """Return the symbol of a variable."""

    def __getitem__(self, name: str) -> Any:
        """Return the symbol of a variable whose name is not known beforehand, or is a Python keyword."""


@dataclass(frozen=True, slots=True)
class Equations:
    """The right-hand side at one instant, in SymPy expressions.

    Parameters
    ----------
    derivatives : mapping of str to expression
        Time derivative of every state, by name of the state.
    outputs : mapping of str to expression
        Every output that is not itself a state, by name.
    """

    derivatives: Mapping[str, Any]
    outputs: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Variable:
    """A state, input, output or parameter of a plant.

    Parameters
    ----------
    name : str
        Name in the plant; in a `PlantModel` an identifier, unique there.
    unit : str
        Unit of every value that is exchanged, for example ``"N.m"`` or ``"m/s2"``; empty if dimensionless or
        unknown.
    min, max : float
        Range that the plant declares, in which it is meant to work; infinite where it declares none. Nothing
        is saturated.
    nominal : float
        Typical magnitude, > 0; the absolute tolerance of a state of a `PlantModel` is in units of it.
    start : float
        Value before the first step; for an input its value at rest. An output that is computed has none,
        whatever stands here.
    description : str
        One line for people.
    display_unit : DisplayUnit or None
        Unit in which people are shown the variable; None shows ``unit``.
    """

    name: str
    unit: str = ""
    min: float = -inf
    max: float = inf
    nominal: float = 1.0
    start: float = 0.0
    description: str = ""
    display_unit: DisplayUnit | None = None

    @property
    def shown_in(self) -> DisplayUnit:
        """The unit for people: the display unit, or the variable's own."""
        return self.display_unit or DisplayUnit(self.unit)

    @property
    def header(self) -> str:
        """The variable's column header in files: name and unit."""
        return printable(encodable(f"{self.name} [{self.unit or '1'}]"))


@dataclass(frozen=True, slots=True)
class Parameter(Variable):
    """A constant of the equations; `start` is its default value.

    Parameters
    ----------
    variability : {"fixed", "tunable"}
        Whether it can be set before the simulation only, or between any two communication steps.
    """

    variability: Literal["fixed", "tunable"] = "fixed"


tunable = partial(Parameter, variability="tunable")
"""Return a parameter that can be set between any two communication steps; arguments as of `Parameter`."""


@dataclass(frozen=True, kw_only=True)
class PlantModel:
    """A plant: its variables, its equations, and where they come from.

    Parameters
    ----------
    name : str
        A C identifier; names the FMU and its library.
    description : str
        One line for people.
    source : str
        Where the equations and the nominal values are taken from.
    states, inputs, outputs : tuple of Variable
        An output that is a state is the same `Variable` in both; `equations` compute every other output.
    parameters : tuple of Parameter
        Constants that a user of the FMU can change.
    equations : callable
        Gets the symbols of all variables, returns `Equations`. Called at export only, so that SymPy functions
        can be imported inside.
    step_size, stop_time : float
        Suggested communication step size and duration, s.

    Raises
    ------
    ModelError
        Names are doubled or not identifiers, units are unknown, values out of range: all errors at once.
    """

    name: str
    equations: Callable[[Symbols], Equations]
    states: tuple[Variable, ...] = ()
    inputs: tuple[Variable, ...] = ()
    outputs: tuple[Variable, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    description: str = ""
    source: str = ""
    step_size: float = 0.1
    stop_time: float = 10.0

    def __post_init__(self) -> None:
        """Refuse a model that contradicts itself."""
        errors = [*_structure_errors(self), *_name_errors(self), *_variable_errors(self)]
        if errors:
            raise ModelError.listing(self.name, errors)

    @property
    def computed_outputs(self) -> tuple[Variable, ...]:
        """The outputs that are not themselves states."""
        states = {state.name for state in self.states}
        return tuple(output for output in self.outputs if output.name not in states)


def derivative_name(state: str) -> str:
    """Return the name of a state's derivative, as FMI's structured naming convention has it."""
    return f"der({state})"


def _structure_errors(model: PlantModel) -> Iterator[str]:
    if not _IDENTIFIER.fullmatch(model.name):
        yield f"its name {model.name!r} is not an identifier (letters, digits and _, no digit first)"
    if not model.outputs:
        yield "it has no outputs"
    if not callable(model.equations):
        yield "equations must be a function of the symbols"
    for name, value in {"step_size": model.step_size, "stop_time": model.stop_time}.items():
        if not _is_positive(value):
            yield f"{name} must be positive and finite, not {value}"


def _name_errors(model: PlantModel) -> Iterator[str]:
    states = {state.name: state for state in model.states}
    groups = {
        "state": model.states,
        "input": model.inputs,
        "output": model.outputs,
        "parameter": model.parameters,
    }
    seen: dict[str, str] = {}
    for group, variables in groups.items():
        for variable in variables:
            name = variable.name
            if group == "output" and seen.get(name) == "state":
                if variable != states[name]:
                    yield f"output {name!r} differs from the state of that name; use one Variable for both"
                seen[name] = "output"
            elif name in seen:
                yield f"{group} {name!r}: the name is already taken by the {seen[name]} {name!r}"
            else:
                seen[name] = group


def _variable_errors(model: PlantModel) -> Iterator[str]:
    computed = set(model.computed_outputs)
    variables = dict.fromkeys((*model.states, *model.inputs, *model.outputs, *model.parameters))
    display_units: dict[tuple[str, str], DisplayUnit] = {}
    for variable in variables:
        where = f"variable {variable.name!r}"
        if not _IDENTIFIER.fullmatch(variable.name):
            yield f"{where}: the name is not an identifier (letters, digits and _, no digit first)"
        if variable.name == TIME:
            yield f"{where}: the name is reserved for the simulated time"
        try:
            parse_unit(variable.unit)
        except ValueError as error:
            yield f"{where}: {error}"
        for message in _value_errors(variable, has_start=variable not in computed):
            yield f"{where}: {message}"
        if (display := variable.display_unit) is None:
            continue
        if display_units.setdefault((variable.unit, display.name), display) != display:
            yield f"{where}: display unit {display.name!r} is converted differently elsewhere"


def _value_errors(variable: Variable, *, has_start: bool) -> Iterator[str]:
    if isnan(variable.min) or isnan(variable.max) or variable.min > variable.max:
        yield f"min {variable.min} and max {variable.max} are not a range"
    elif has_start and not variable.min <= variable.start <= variable.max:
        yield f"start {variable.start} is outside the range {variable.min} .. {variable.max}"
    if has_start and not isfinite(variable.start):
        yield f"start must be finite, not {variable.start}"
    if not _is_positive(variable.nominal):
        yield f"nominal must be positive and finite, not {variable.nominal}"
    if isinstance(variable, Parameter) and variable.variability not in ("fixed", "tunable"):
        yield f"variability must be 'fixed' or 'tunable', not {variable.variability!r}"
    if (display := variable.display_unit) is not None:
        if not (isfinite(display.factor) and display.factor != 0 and isfinite(display.offset)):
            yield f"display unit {display.name!r} has no usable conversion"
        if not display.name or not variable.unit:
            yield "a display unit needs a name, and a unit that it is converted from"


def _is_positive(value: float) -> bool:
    return isfinite(value) and value > 0
