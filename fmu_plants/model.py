"""A plant written once: its variables, the right-hand side of its differential equations, their checks.

A plant may read tables over time, weather for one, and have a sampled control of its own, which whoever
drives the plant overrides.

Nothing here needs SymPy, so that a plant's variables can be read without the cost of its import; the
equations are a function that is called with symbols when the plant is exported.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import inf, isfinite, isnan
from typing import TYPE_CHECKING, Any, Literal, Protocol

from fmu_plants.spelling import did_you_mean
from fmu_plants.texts import encodable, printable
from fmu_plants.units import DisplayUnit, parse_unit

if TYPE_CHECKING:
    # NumPy takes long to import, and only tables need it.
    import numpy as np
    from numpy.typing import NDArray

TIME = "time"
DEFAULT_TOLERANCE = 1e-10
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_FILE_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
_HEAD = re.compile(r"[^\s,\"](?:[^,\"\r\n]*[^\s,\"])?")


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
class InputTable:
    """Values over time that a plant reads from a file in its FMU's resources: weather, occupancy, prices.

    Whoever has the FMU may exchange the file: a CSV file with the time in s in its first column, called
    ``time``, and at least the columns here. It is read at instantiation.

    Parameters
    ----------
    file : str
        Its name below ``resources``.
    variables : tuple of Variable
        The columns that the plant reads; the equations and the control have a symbol for each.
    headers : mapping of str to str
        Heads of columns that are not called like their variables, by variable.
    values : callable
        Returns times, shape (n,) [s], strictly increasing, and values, shape (n, columns), in the order and
        the units of the variables. Called when they are needed, at export for one.
    interpolation : {"linear", "hold"}
        Between two rows: in a straight line, or as in the row before.
    period : float, optional
        Time [s] after which the rows come again, at least as long as they last; where it is longer, the last
        row is followed by the first. None: before and after the rows, the first and the last one are held.
    """

    file: str
    variables: tuple[Variable, ...]
    values: "Callable[[], tuple[NDArray[np.float64], NDArray[np.float64]]]"
    headers: Mapping[str, str] = field(default_factory=dict, hash=False)
    interpolation: Literal["linear", "hold"] = "linear"
    period: float | None = None

    @property
    def heads(self) -> tuple[str, ...]:
        """The head of each column in the file."""
        return tuple(self.headers.get(variable.name, variable.name) for variable in self.variables)

    def text(self) -> str:
        """Return the text of the file.

        Raises
        ------
        ModelError
            The values are not a table: all errors at once.
        """
        times, rows = self.values()
        if errors := list(_table_errors(self, times, rows)):
            raise ModelError.listing(self.file, errors)
        lines = [",".join((TIME, *self.heads))]
        lines += [
            ",".join(map(repr, (time, *row))) for time, row in zip(times.tolist(), rows.tolist(), strict=True)
        ]
        return "\n".join([*lines, ""])

    def at(self, times: "NDArray[np.float64]") -> "NDArray[np.float64]":
        """Return the columns at times [s], shape (samples, columns), as the FMU has them."""
        # Here and not above: plants without tables do not need it.
        import numpy as np

        given, rows = self.values()
        if self.period is not None:
            times = times - np.floor((times - given[0]) / self.period) * self.period
            if given[-1] - given[0] < self.period:
                given, rows = np.append(given, given[0] + self.period), np.vstack([rows, rows[:1]])
        if self.interpolation == "hold":
            return rows[np.maximum(np.searchsorted(given, times, "right") - 1, 0)]
        return np.column_stack([np.interp(times, given, column) for column in rows.T])


@dataclass(frozen=True, slots=True)
class Rules:
    """What an embedded control decides at one instant, in SymPy expressions.

    Parameters
    ----------
    actuators : mapping of str to expression
        What it commands until its next instant, by actuator.
    memory : mapping of str to expression
        What it remembers until then, by variable of its memory.
    """

    actuators: Mapping[str, Any]
    memory: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class EmbeddedControl:
    """A sampled control inside a plant: it commands actuators at instants, wherever these are not overridden.

    Its first instant is the start of a run, the others follow at equal distances. At an instant it sees the
    plant as it is then: outputs that actuators act on without delay, with what acted until then. Nothing is
    saturated: the rules keep to the limits of the actuators.

    Each actuator ``A`` gives the FMU two inputs, as in BOPTEST: ``oveA_u``, and ``oveA_activate``, where
    ``oveA_u`` acts instead of the control if that is 1.

    Parameters
    ----------
    sampling_time : float
        Between two instants, s.
    actuators : tuple of Variable
        What it commands, with limits; the plant's equations have a symbol for each. `start` is what the
        first instant takes to have acted before.
    rules : callable
        Gets the symbols of the memory, the states, all outputs, inputs, columns of tables and parameters,
        and `time`; returns `Rules`. Called at export only.
    memory : tuple of Variable
        What it remembers from instant to instant, with start values: hysteresis, integrators.
    """

    sampling_time: float
    actuators: tuple[Variable, ...]
    rules: Callable[[Symbols], Rules]
    memory: tuple[Variable, ...] = ()

    @property
    def overrides(self) -> tuple[Variable, ...]:
        """The inputs of the FMU that act instead of it: for each actuator its override, then its switch."""
        return tuple(
            variable
            for actuator in self.actuators
            for variable in (
                replace(
                    actuator,
                    name=override_name(actuator.name),
                    description=f"Override of {actuator.name}: {actuator.description or actuator.name}",
                ),
                Variable(
                    switch_name(actuator.name),
                    "1",
                    0.0,
                    1.0,
                    description=f"1: {override_name(actuator.name)} acts instead of the embedded control",
                ),
            )
        )


def override_name(actuator: str) -> str:
    """Return the name of the input that overrides an actuator of an embedded control."""
    return f"ove{actuator}_u"


def switch_name(actuator: str) -> str:
    """Return the name of the input that switches the override of an actuator on."""
    return f"ove{actuator}_activate"


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
    tables : tuple of InputTable
        What the plant reads over time.
    control : EmbeddedControl, optional
        Its own control.
    resources : mapping of str to str or callable
        Further text files of the FMU's resources by name; a callable returns the text at export.
    relative_tolerance, absolute_tolerance : float
        Of the integrator, where no others are asked for; the absolute one is in units of the nominal value
        of each state.

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
    tables: tuple[InputTable, ...] = ()
    control: EmbeddedControl | None = None
    resources: Mapping[str, str | Callable[[], str]] = field(default_factory=dict, hash=False)
    relative_tolerance: float = DEFAULT_TOLERANCE
    absolute_tolerance: float = DEFAULT_TOLERANCE

    def __post_init__(self) -> None:
        """Refuse a model that contradicts itself."""
        errors = [*_structure_errors(self), *_name_errors(self), *_variable_errors(self)]
        errors += [*_resource_errors(self), *_control_errors(self)]
        if errors:
            raise ModelError.listing(self.name, errors)

    @property
    def computed_outputs(self) -> tuple[Variable, ...]:
        """The outputs that are not themselves states."""
        states = {state.name for state in self.states}
        return tuple(output for output in self.outputs if output.name not in states)

    @property
    def actuators(self) -> tuple[Variable, ...]:
        """What the embedded control commands."""
        return self.control.actuators if self.control else ()

    @property
    def overrides(self) -> dict[str, str]:
        """The actuators of the embedded control by the inputs that act instead of it."""
        return {override_name(actuator.name): actuator.name for actuator in self.actuators}

    @property
    def memory(self) -> tuple[Variable, ...]:
        """What the embedded control remembers."""
        return self.control.memory if self.control else ()

    @property
    def columns(self) -> tuple[Variable, ...]:
        """The columns of all tables."""
        return tuple(variable for table in self.tables for variable in table.variables)

    @property
    def all_inputs(self) -> tuple[Variable, ...]:
        """The inputs of the FMU: those of the equations, then the overrides of the embedded control."""
        return (*self.inputs, *(self.control.overrides if self.control else ()))

    @property
    def has_events(self) -> bool:
        """Whether something happens at given times: the rows of tables, or the instants of a control."""
        return bool(self.tables) or self.control is not None

    def resource_files(self) -> dict[str, str]:
        """Return the texts of all files in the FMU's resources, by name.

        Raises
        ------
        ModelError
            The values of a table are none.
        """
        texts = {table.file: table.text() for table in self.tables}
        return texts | {
            name: text if isinstance(text, str) else text() for name, text in self.resources.items()
        }


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
    for name in ("step_size", "stop_time", "relative_tolerance", "absolute_tolerance"):
        if not _is_positive(value := getattr(model, name)):
            yield f"{name} must be positive and finite, not {value}"


def _name_errors(model: PlantModel) -> Iterator[str]:
    states = {state.name: state for state in model.states}
    groups = {
        "state": model.states,
        "input": model.inputs,
        "output": model.outputs,
        "parameter": model.parameters,
        "column": model.columns,
        "memory": model.memory,
        "actuator": model.actuators,
        "override": model.control.overrides if model.control else (),
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
    known = (*model.states, *model.inputs, *model.outputs, *model.parameters)
    variables = dict.fromkeys((*known, *model.columns, *model.memory, *model.actuators))
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


def _resource_errors(model: PlantModel) -> Iterator[str]:
    files = [*(table.file for table in model.tables), *model.resources]
    for name in dict.fromkeys(files):
        if not _FILE_NAME.fullmatch(name):
            yield f"resource {name!r}: the file name may have letters, digits, '_', '-' and '.' only"
        if files.count(name) > 1:
            yield f"resource {name!r}: there are {files.count(name)} files of this name"
    for table in model.tables:
        for message in _column_errors(table):
            yield f"table {table.file!r}: {message}"


def _column_errors(table: InputTable) -> Iterator[str]:
    names = [variable.name for variable in table.variables]
    if not names:
        yield "it has no columns"
    if not callable(table.values):
        yield "values must be a function that returns times and rows"
    if table.interpolation not in ("linear", "hold"):
        yield f"interpolation must be 'linear' or 'hold', not {table.interpolation!r}"
    if table.period is not None and not _is_positive(table.period):
        yield f"period must be positive and finite, not {table.period}"
    for name in table.headers:
        if name not in names:
            yield f"headers: it has no column {name!r}; {did_you_mean(name, names)}"
    for head in dict.fromkeys((TIME, *table.heads)):
        if not _HEAD.fullmatch(head):
            yield f"head {head!r}: quotation marks, commas, line breaks and blanks at its ends are refused"
        if (TIME, *table.heads).count(head) > 1:
            yield f"head {head!r} stands over more than one column"


def _table_errors(table: InputTable, times: Any, rows: Any) -> Iterator[str]:
    # Here and not above: plants without tables do not need it.
    import numpy as np

    shapes = np.shape(times), np.shape(rows)
    if len(shapes[0]) != 1 or not shapes[0][0] or shapes[1] != (shapes[0][0], len(table.variables)):
        columns = len(table.variables)
        wanted = f"times, shape (n,), and rows, shape (n, {columns})"
        yield f"values must be {wanted}, not {shapes[0]} and {shapes[1]}"
        return
    if not (np.isfinite(times).all() and np.isfinite(rows).all()):
        yield "times and values must be finite"
    elif not (np.diff(times) > 0).all():
        yield "times must increase strictly"
    elif table.period is not None and times[-1] - times[0] > table.period:
        yield f"its rows last {times[-1] - times[0]:g} s, longer than its period of {table.period:g} s"


def _control_errors(model: PlantModel) -> Iterator[str]:
    if (control := model.control) is None:
        return
    if not _is_positive(control.sampling_time):
        yield f"control: sampling_time must be positive and finite, not {control.sampling_time}"
    if not callable(control.rules):
        yield "control: rules must be a function of the symbols"
    if not control.actuators:
        yield "control: it has no actuators"
    for actuator in control.actuators:
        if not (isfinite(actuator.min) and isfinite(actuator.max)):
            yield f"control: actuator {actuator.name!r} needs finite min and max"


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
