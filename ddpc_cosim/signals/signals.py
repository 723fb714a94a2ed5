"""References, noise and events."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, fields, replace
from functools import cache
from numbers import Integral, Real
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_origin

import numpy as np

from ddpc_cosim.codec import Kinds, Section, Size, declared_fields
from ddpc_cosim.errors import ConfigError, DataError
from ddpc_cosim.files.csv_files import TIME_TOLERANCE, Column, read_table
from ddpc_cosim.files.durations import in_words, shown
from ddpc_cosim.files.time_tables import TimeTable
from ddpc_cosim.plant import ParameterValue
from ddpc_cosim.settings import SIGNAL, setting
from ddpc_cosim.variables import FloatArray, Variable, converter

# A sample time k*Ts can lie one rounding error before the instant it stands for.
_RELATIVE_TIME_TOLERANCE = 1e-12


def are_numbers(values: object) -> bool:
    """Whether something is a sequence of numbers."""
    try:
        array = np.asarray(values)
    except ValueError:  # of lists of different lengths
        return False
    return array.ndim == 1 and array.dtype.kind in "biuf"


# What fields of these types need.
_NEEDED: dict[object, tuple[str, Callable[[object], bool]]] = {
    float: ("a number", lambda value: isinstance(value, Real)),
    int: ("an integer", lambda value: isinstance(value, Integral)),
    Sequence[float]: ("a sequence of numbers", are_numbers),
}


def type_faults(signal: Any, *kinds: object) -> list[str]:
    """Return what is wrong with the types of a signal's numbers, perhaps of fields of some types only."""
    of: Any = type(signal)
    return [
        f"{name} = {getattr(signal, name)!r} is not possible; needed: {words}"
        for name, kind in _typed_fields(of)
        if not kinds or kind in kinds
        for words, fits in (_NEEDED[kind],)
        if not fits(getattr(signal, name))
    ]


@cache
def _typed_fields(of: type[Any]) -> tuple[tuple[str, object], ...]:
    """Return the fields of a class whose types are looked at, with these."""
    return tuple((field.name, kind) for field in fields(of) if (kind := _bare(field.type)) in _NEEDED)


def _bare(kind: Any) -> Any:
    return kind.__origin__ if get_origin(kind) is Annotated else kind


def _check_types(signal: Any) -> None:
    if faults := type_faults(signal):
        raise ConfigError([f"{type(signal).__name__}: {fault}" for fault in faults])


class Reference(ABC):
    """A signal of time: for a controlled output, for an input that no controller drives, or a disturbance."""

    @abstractmethod
    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""

    def with_seed(self, seed: int) -> "Reference":
        """Return the signal with the random numbers of another seed; itself where it has none."""
        return self


def values_at(signal: Reference, what: str, time: FloatArray) -> FloatArray:
    """Return the values of a signal, which may be of any class, shape (len(time),).

    Raises
    ------
    ConfigError
        It raises an error, or its values are not finite or not one for each time; ``what`` says whose.
    """
    try:
        values = np.asarray(signal.at(time.copy()), dtype=np.float64)
    except Exception as error:
        raise ConfigError(f"{what}: {type(error).__name__}: {error}") from error
    if values.shape != time.shape:
        raise ConfigError(f"{what}: has shape {values.shape}; needed: {time.shape}")
    if not np.isfinite(values).all():
        first = int(np.flatnonzero(~np.isfinite(values))[0])
        raise ConfigError(f"{what}: {values[first]} at t = {shown(time[first])}; needed: finite")
    return values


Numbers = Annotated[Sequence[float], Size(1)]
"""Numbers, at least one of them."""


@dataclass(frozen=True, slots=True, repr=False)
class Signal(Section, Reference):
    """A signal that a study file can say: its fields are the keys of its table.

    Parameters
    ----------
    unit : str
        Unit of its values; empty: that of the signal that it is for.
    """

    kind: ClassVar[str] = ""

    _: KW_ONLY
    unit: str = setting("", doc="unit of the values here; empty: the variable's own")

    def in_unit(self, variable: Variable, *, difference: bool = False) -> Reference:
        """Return the signal in a variable's own unit; a ``difference`` is added to it.

        Raises
        ------
        ConfigError
            It has a unit that does not fit.
        DataError
            All that is wrong with its file.
        """
        if not self.unit:
            return self
        convert = converter(variable, self.unit, difference=difference)
        return replace(self, unit="", **self._converted(convert))

    def _converted(self, convert: Callable[[Any], Any]) -> dict[str, Any]:
        """Return what is in the unit of the signal, in another one."""
        converted = dict[str, Any]()
        for declared in declared_fields(type(self)).values():
            if declared.info.unit == SIGNAL:
                value = getattr(self, declared.name)
                is_one = isinstance(value, Real)
                converted[declared.name] = (
                    float(convert(value)) if is_one else tuple(float(convert(v)) for v in value)
                )
        return converted

    def __repr__(self) -> str:
        return shown_without(self, () if self.unit else ("unit",))


def in_unit_of(variable: Variable, signal: Reference, *, difference: bool = False) -> Reference:
    """Return a signal of any class in a variable's own unit; errors as of :meth:`Signal.in_unit`."""
    return signal.in_unit(variable, difference=difference) if isinstance(signal, Signal) else signal


def level_in_unit(variable: Variable, level: float | Reference, unit: str) -> Reference:
    """Return a number or a signal as a signal in a variable's own unit.

    Parameters
    ----------
    variable : Variable
        What it is a level of.
    level : float or Reference
        The number or the signal.
    unit : str
        Its unit, where it has none of its own; empty: the variable's.

    Raises
    ------
    ConfigError, DataError
        As of :meth:`Signal.in_unit`.
    """
    signal = level if isinstance(level, Reference) else Constant(float(level))
    if unit and isinstance(signal, Signal) and not signal.unit:
        signal = replace(signal, unit=unit)
    return in_unit_of(variable, signal)


def shown_without(value: Any, names: Sequence[str]) -> str:
    """Return what ``repr`` shows of a dataclass object, without some of its fields."""
    shown = (
        f"{field.name}={getattr(value, field.name)!r}" for field in fields(value) if field.name not in names
    )
    return f"{type(value).__qualname__}({', '.join(shown)})"


@dataclass(frozen=True, slots=True, repr=False)
class Constant(Signal):
    """One value for all time."""

    kind: ClassVar[str] = "constant"

    value: float = setting(0.0, doc="the value", unit=SIGNAL, required=True)

    def __post_init__(self) -> None:
        _check_types(self)

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""
        return np.full(time.shape, self.value)


@dataclass(frozen=True, slots=True, repr=False)
class Steps(Signal):
    """Piecewise constant: ``values[i]`` from ``times[i]`` on; the first value also before.

    Parameters
    ----------
    times : sequence of float
        Increasing instants [s].
    values : sequence of float
        One value for each instant.
    period : float
        Time after which all of it comes again, as a day's course does [s]; 0: it does not.

    Raises
    ------
    ConfigError
        Different lengths, nothing at all, or times that do not increase.
    """

    kind: ClassVar[str] = "steps"

    times: Numbers = setting(
        doc="instants; those of an excitation count from the start of the experiment", unit="s"
    )
    values: Numbers = setting(doc="one value for each instant", unit=SIGNAL)
    _: KW_ONLY
    period: float = setting(0.0, low=0, doc="time after which it comes again; 0: it does not", unit="s")

    def __post_init__(self) -> None:
        _check_types(self)
        faults = []
        if len(self.times) != len(self.values) or not len(self.times):
            lengths = f"times ({len(self.times)}) and values ({len(self.values)})"
            faults.append(f"steps: {lengths} must have the same length, at least 1")
        if not np.all(np.diff(self.times) > 0):
            faults.append(f"steps: times must increase, got {list(self.times)}")
        elif self.period and len(self.times) and not 0 <= self.times[0] <= self.times[-1] < self.period:
            faults.append(f"steps: times must be from 0 to below period = {self.period:g}")
        if faults:
            raise ConfigError(faults)

    def __repr__(self) -> str:
        hidden = {"unit": self.unit, "period": self.period}
        return shown_without(self, [name for name, value in hidden.items() if not value])

    def _converted(self, convert: Callable[[Any], Any]) -> dict[str, Any]:
        return {"times": tuple(self.times), **super(Steps, self)._converted(convert)}

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""
        late = time + _RELATIVE_TIME_TOLERANCE * np.maximum(1.0, np.abs(time))
        if self.period:
            late = np.mod(late, self.period)
        index = np.searchsorted(self.times, late, side="right") - 1
        # Before its first instant a period is as the one before has ended.
        return np.asarray(self.values, dtype=float)[index if self.period else np.maximum(index, 0)]


@dataclass(frozen=True, slots=True, repr=False)
class Interpolated(Steps):
    """Linear between ``values[i]`` at ``times[i]`` and the next; the first value also before, the last after.

    Parameters and errors as of :class:`Steps`.
    """

    kind: ClassVar[str] = "interpolated"

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""
        return np.interp(time, self.times, self.values, period=self.period or None)


@dataclass(frozen=True, slots=True, repr=False)
class Ramp(Signal):
    """Linear from ``start`` to ``stop`` between two instants, constant outside them."""

    kind: ClassVar[str] = "ramp"

    start: float = setting(doc="value until from_time", unit=SIGNAL, key="from_value")
    stop: float = setting(doc="value from to_time on", unit=SIGNAL, key="to_value")
    start_time: float = setting(doc="where it begins", unit="s", key="from_time")
    stop_time: float = setting(doc="where it ends", unit="s", key="to_time")

    def __post_init__(self) -> None:
        _check_types(self)
        if not self.start_time < self.stop_time:
            raise ConfigError(
                f"ramp: it must end after it starts, got {self.start_time:g} s to {self.stop_time:g} s"
            )

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""
        return np.interp(time, (self.start_time, self.stop_time), (self.start, self.stop))


@dataclass(frozen=True, slots=True, repr=False)
class Sine(Signal):
    """``offset + amplitude * sin(2 pi frequency t + phase)``; frequency in Hz, phase in rad."""

    kind: ClassVar[str] = "sine"

    amplitude: float = setting(doc="largest distance from the offset", unit=SIGNAL)
    frequency: float = setting(doc="frequency", unit="Hz", above=0)
    offset: float = setting(0.0, doc="what it varies about", unit=SIGNAL)
    phase: float = setting(0.0, doc="phase at time 0", unit="rad")

    def __post_init__(self) -> None:
        _check_types(self)

    def _converted(self, convert: Callable[[Any], Any]) -> dict[str, Any]:
        offset = float(convert(self.offset))
        return {"offset": offset, "amplitude": float(convert(self.offset + self.amplitude)) - offset}

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""
        return self.offset + self.amplitude * np.sin(2 * np.pi * self.frequency * time + self.phase)


@dataclass(frozen=True, slots=True, repr=False)
class WhiteNoise(Signal):
    """Independent normal values, one for each sample, about a mean; the same at every call.

    Parameters
    ----------
    standard_deviation : float
        At least 0.
    mean : float
        What they vary about.
    seed : int
        Seed of the values; where it is one of the conditions of a loop, the loop gives it one of its own.
    """

    kind: ClassVar[str] = "noise"

    standard_deviation: float = setting(doc="standard deviation", unit=SIGNAL, low=0)
    mean: float = setting(0.0, doc="what the values vary about", unit=SIGNAL)
    seed: int = 0

    def __post_init__(self) -> None:
        _check_types(self)
        if not 0 <= self.standard_deviation < math.inf:
            what = f"standard deviation = {self.standard_deviation}"
            raise ConfigError(f"noise: {what} is not possible; allowed: a finite number >= 0")

    def _converted(self, convert: Callable[[Any], Any]) -> dict[str, Any]:
        mean = float(convert(self.mean))
        deviation = abs(float(convert(self.mean + self.standard_deviation)) - mean)
        return {"mean": mean, "standard_deviation": deviation}

    def with_seed(self, seed: int) -> "WhiteNoise":
        """Return noise of another seed."""
        return replace(self, seed=seed)

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""
        drawn = np.random.default_rng(self.seed).standard_normal(time.shape)
        return self.mean + self.standard_deviation * drawn


@dataclass(frozen=True, slots=True, repr=False)
class RandomLevels(Signal):
    """Levels drawn at random, uniformly and independently, one for each ``hold``: a load, a feed, clouds.

    It is a function of time: the same over any stretch of it.

    Parameters
    ----------
    low, high : float
        Between what the levels are.
    hold : float
        Time between one level and the next [s].
    interpolation : {"hold", "linear"}
        What the signal is between two levels: the last one, or a straight line.
    seed : int
        Seed of the levels; where it is one of the conditions of a loop, the loop gives it one of its own.
    """

    kind: ClassVar[str] = "random"

    low: float = setting(doc="lowest level", unit=SIGNAL)
    high: float = setting(doc="highest level", unit=SIGNAL)
    hold: float = setting(doc="time between one level and the next", unit="s", above=0)
    _: KW_ONLY
    interpolation: Literal["hold", "linear"] = setting(
        "hold", doc="what the signal is between two levels: the last one, or a straight line"
    )
    seed: int = 0

    def __post_init__(self) -> None:
        _check_types(self)
        faults = []
        if not self.low < self.high:
            faults.append(f"random: low ({self.low:g}) must be below high ({self.high:g})")
        if not 0 < self.hold < math.inf:
            faults.append(f"random: hold = {self.hold:g} is not possible; allowed: a finite number > 0")
        if faults:
            raise ConfigError(faults)

    def with_seed(self, seed: int) -> "RandomLevels":
        """Return levels of another seed."""
        return replace(self, seed=seed)

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""
        position = time / self.hold
        position = position + _RELATIVE_TIME_TOLERANCE * np.maximum(1.0, np.abs(position))
        cell = np.floor(position)
        first = self._levels(cell)
        if self.interpolation == "hold":
            return first
        return first + (position - cell) * (self._levels(cell + 1) - first)

    def _levels(self, cells: FloatArray) -> FloatArray:
        """Return the level of each cell, whose number is part of its seed."""
        numbers, where = np.unique(cells, return_inverse=True)
        drawn = [np.random.default_rng([self.seed, *_split(int(number))]).random() for number in numbers]
        levels: FloatArray = self.low + (self.high - self.low) * np.array(drawn)
        return levels[where]


def _split(number: int) -> tuple[int, int]:
    """Return an integer as its sign and size, as a seed has no sign."""
    return int(number < 0), abs(number)


@dataclass(frozen=True, slots=True, repr=False)
class _OfFile(Signal):
    """What the signals from a CSV file share."""

    file: str = setting(doc="path of a CSV file, relative to the study file", file=True)
    _: KW_ONLY
    column: str = setting("", doc="header of the column, with or without its unit; empty: the signal's name")

    def _column(self, variable: Variable, *, difference: bool) -> Column:
        return Column(variable, self.column or variable.name, self.unit, difference)

    def at(self, time: FloatArray) -> FloatArray:
        """Raise ConfigError: what a column holds depends on the signal that it is for."""
        raise ConfigError(f"{self.file}: needed: in_unit(variable), which reads the file")


@dataclass(frozen=True, slots=True, repr=False)
class SignalFromFile(_OfFile):
    """A column of a CSV file, over its time.

    Parameters
    ----------
    file : str
        Path of the file.
    column : str
        Header of the column, with or without its unit; empty: the signal's name.
    time_column : str
        Header of the time, in s or the unit it has.
    interpolation : {"hold", "linear"}
        What the signal is between two rows: the last value, or a straight line.
    """

    kind: ClassVar[str] = "file"

    _: KW_ONLY
    time_column: str = setting(
        "time", doc="header of the time, in s or the unit it has", written=Annotated[str, Size(1)]
    )
    interpolation: Literal["hold", "linear"] = setting(
        "hold", doc="what the signal is between two rows: the last value, or a straight line"
    )

    def in_unit(self, variable: Variable, *, difference: bool = False) -> Reference:
        """Read the signal, in a variable's own unit; parameters and errors as of :class:`Signal`."""
        column = self._column(variable, difference=difference)
        time, values = read_table(Path(self.file), [column], self.time_column)
        kind = Steps if self.interpolation == "hold" else Interpolated
        return kind(tuple(time.tolist()), tuple(values[:, 0].tolist()))

    def gap(self, first: float, last: float) -> str:
        """Return why the file does not tell the signal from one time to another [s]; empty if it does.

        A value that is held holds as long as that of the row before it. Errors as of :meth:`in_unit`.
        """
        time, _ = read_table(Path(self.file), [], self.time_column)
        held = float(time[-1] - time[-2]) if self.interpolation == "hold" and len(time) > 1 else 0.0
        return _gap(self.file, (float(time[0]), float(time[-1]) + held), first, last)


@dataclass(frozen=True, slots=True, repr=False)
class RecordedSignal(_OfFile):
    """A column of a CSV file, row by row, for an experiment; its times count from the first row.

    Parameters
    ----------
    file : str
        Path of the file.
    column : str
        Header of the column; empty: the input's name.
    time_column : str
        Header of the time; empty: the file has none.
    """

    kind: ClassVar[str] = "recorded"

    _: KW_ONLY
    time_column: str = setting("time", doc="header of the time; empty: the file has none")

    def rows(self, variable: Variable, samples: int, sampling_time: float, *, difference: bool) -> Steps:
        """Return the first rows, one for each sample; DataError: what is wrong with the file."""
        column = self._column(variable, difference=difference)
        _, values = read_table(Path(self.file), [column], self.time_column, sampling_time, TIME_TOLERANCE)
        if len(values) < samples:
            raise DataError(f"{self.file}: {len(values)} rows; needed: samples = {samples}")
        time = np.arange(samples, dtype=np.float64) * sampling_time
        return Steps(tuple(time.tolist()), tuple(values[:samples, 0].tolist()))


@dataclass(frozen=True, slots=True)
class TabulatedSignal(Reference):
    """A column of a table that a plant brings along, over the time from the start of the year.

    The plant decides what the table holds: ``repr`` and equality go by its name and the column's alone.

    Parameters
    ----------
    file, column : str
        The table, and its column.
    unit : str
        Unit of the values in the table; empty: that of the signal that it is for.
    interpolation : {"hold", "linear"}
        What the signal is between two rows.
    times : array, shape (n,)
        Increasing times [s].
    values : array, shape (n,)
        In the unit of the signal that it is for.
    period : float
        After which time all of it comes again [s]; 0: never, the first and the last value hold.
    """

    file: str
    column: str
    unit: str
    interpolation: str
    times: FloatArray = field(repr=False, compare=False)
    values: FloatArray = field(repr=False, compare=False)
    period: float = field(repr=False, compare=False)

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""
        if self.interpolation == "linear":
            return np.interp(time, self.times, self.values, period=self.period or None)
        late = time + _RELATIVE_TIME_TOLERANCE * np.maximum(1.0, np.abs(time))
        if self.period:
            late = self.times[0] + np.mod(late - self.times[0], self.period)
        index = np.searchsorted(self.times, late, side="right") - 1
        return self.values[np.maximum(index, 0)]


@dataclass(frozen=True, slots=True, repr=False)
class SignalFromResource(Signal):
    """A column of a table in the resources of the plant: its weather, occupancy, setpoints or prices.

    The table is a CSV file in the folder ``resources`` of an FMU, or of a plant of equations, with a column
    ``time`` from the start of the year. One over a year goes on periodically.

    Parameters
    ----------
    file : str
        Name of the table, as ``"weather.csv"``.
    column : str
        Header of the column, as ``"TDryBul"`` or ``"LowerSetp[1]"``.
    interpolation : {"hold", "linear"}
        What the signal is between two rows: the last value, or a straight line.
    """

    kind: ClassVar[str] = "resource"

    file: str = setting(doc="a table in the plant's resources")
    column: str = setting(doc="header of the column")
    _: KW_ONLY
    interpolation: Literal["hold", "linear"] = setting(
        "hold", doc="what the signal is between two rows: the last value, or a straight line"
    )
    table: TimeTable | None = setting(None, doc="what the plant has of that name", key=None)

    def __repr__(self) -> str:
        return shown_without(self, ("table",) if self.unit else ("table", "unit"))

    def in_unit(self, variable: Variable, *, difference: bool = False) -> Reference:
        """Return the signal in a variable's own unit.

        Raises
        ------
        DataError
            The plant has no such column, or not all of it is numbers.
        ConfigError
            The unit does not fit, or it is not known what the plant has.
        """
        times, values = self._table.column(self.column)
        written = self._table.units.get(self.column, "")
        if written and self.unit and written != self.unit:
            what = f'unit = "{self.unit}" contradicts what {self.file} says of {self.column}: {written}'
            raise ConfigError(what)
        unit = self.unit or written
        convert = converter(variable, unit, difference=difference)
        return TabulatedSignal(
            *(self.file, self.column, unit, self.interpolation, times, convert(values), self._table.period)
        )

    @property
    def _table(self) -> TimeTable:
        if self.table is None:
            raise ConfigError(f"{self.file}: needed: a plant in a study, whose resources have the table")
        return self.table

    def gap(self, first: float, last: float) -> str:
        """Return why the table does not tell the signal from one time to another [s]; empty if it does.

        Errors as of :meth:`in_unit`.
        """
        times, _ = self._table.column(self.column)
        if self._table.period or len(times) == 1:
            return ""
        held = float(times[-1] - times[-2]) if self.interpolation == "hold" else 0.0
        return _gap(self.file, (float(times[0]), float(times[-1]) + held), first, last)

    def at(self, time: FloatArray) -> FloatArray:
        """Raise ConfigError: what a column holds depends on the signal that it is for."""
        raise ConfigError(f"{self.file}: needed: in_unit(variable), which reads the table")


def _gap(file: str, known: tuple[float, float], first: float, last: float) -> str:
    """Return that what a file tells ends before it has to, or begins too late; empty if not [s]."""
    begin, end = known
    early = _RELATIVE_TIME_TOLERANCE * abs(last)
    if begin <= first + early and last <= end + early:
        return ""
    tells = f"{file} tells it from t = {in_words(begin)} to {in_words(end)}"
    return f"{tells}; needed: from {in_words(first)} to {in_words(last)}"


def by_kind(*classes: Any) -> dict[str, type[Any]]:
    """Return classes by their ``kind``."""
    return {class_.kind: class_ for class_ in classes}


REFERENCES = by_kind(Constant, Steps, Interpolated, Ramp, Sine, SignalFromFile, SignalFromResource)
"""The signals that a reference may be, by their kinds."""
ReferenceSignal = Annotated[Reference, Kinds(REFERENCES)]
_PARTS = REFERENCES | by_kind(WhiteNoise, RandomLevels)
_Parts = Annotated[Sequence[Annotated[Reference, Kinds(_PARTS)]], Size(1)]


@dataclass(frozen=True, slots=True, repr=False)
class _OfParts(Signal):
    """What signals that are made of others share."""

    parts: _Parts = setting(doc="the signals that it is made of")

    def __post_init__(self) -> None:
        wrong = [part for part in self.parts if not isinstance(part, Reference)]
        if wrong:
            raise ConfigError([f"{self.kind}: needed: signals of time, got {part!r}" for part in wrong])

    def in_unit(self, variable: Variable, *, difference: bool = False) -> Reference:
        """Return the signal in a variable's own unit; parameters and errors as of :class:`Signal`."""
        parts = [
            replace(part, unit=self.unit) if isinstance(part, Signal) and not part.unit else part
            for part in self.parts
        ]
        return replace(self, unit="", parts=tuple(self._parts_in_unit(parts, variable, difference)))

    @abstractmethod
    def _parts_in_unit(
        self, parts: Sequence[Reference], variable: Variable, difference: bool
    ) -> Iterator[Reference]:
        """Yield the parts in a variable's own unit."""

    def with_seed(self, seed: int) -> Reference:
        """Return the signal with the random numbers of another seed, other ones in each part."""
        seeds = np.random.SeedSequence(seed).generate_state(len(self.parts), np.uint64).tolist()
        return replace(
            self,
            parts=tuple(part.with_seed(part_seed) for part, part_seed in zip(self.parts, seeds, strict=True)),
        )


@dataclass(frozen=True, slots=True, repr=False)
class Sum(_OfParts):
    """Signals that are added up: the first one, and what is added to it."""

    kind: ClassVar[str] = "sum"

    def _parts_in_unit(
        self, parts: Sequence[Reference], variable: Variable, difference: bool
    ) -> Iterator[Reference]:
        for number, part in enumerate(parts):
            yield in_unit_of(variable, part, difference=difference or number > 0)

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""
        total: FloatArray = np.sum([part.at(time) for part in self.parts], axis=0)
        return total


@dataclass(frozen=True, slots=True, repr=False)
class Product(_OfParts):
    """Signals that are multiplied: the first one, and factors without a unit, as clouds are of the sun."""

    kind: ClassVar[str] = "product"

    def _parts_in_unit(
        self, parts: Sequence[Reference], variable: Variable, difference: bool
    ) -> Iterator[Reference]:
        factor = Variable(f"factor of {variable.name}", "1")
        for number, part in enumerate(parts):
            operand = replace(part, unit="") if number and isinstance(part, Signal) else part
            yield in_unit_of(factor if number else variable, operand, difference=difference and not number)

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""
        product: FloatArray = np.prod([part.at(time) for part in self.parts], axis=0)
        return product


INPUTS = _PARTS | by_kind(Sum, Product)
"""The signals that may act on a plant: these, random ones, and sums and products."""
InputSignal = Annotated[Reference, Kinds(INPUTS)]


@dataclass(frozen=True, slots=True, repr=False)
class Band(Section):
    """Between what an output is wanted, in place of a reference.

    Parameters
    ----------
    lower, upper : float or Reference
        The edges over time.
    unit : str
        Their unit, where they have none of their own; empty: that of the signal that it is for.
    """

    lower: float | ReferenceSignal = setting(doc="lower edge", unit=SIGNAL)
    upper: float | ReferenceSignal = setting(doc="upper edge", unit=SIGNAL)
    unit: str = setting("", doc="unit of the edges; empty: the variable's own", key=None)

    def edges(self, variable: Variable) -> tuple[Reference, Reference]:
        """Return both edges in a variable's own unit; errors as of :meth:`Signal.in_unit`."""
        return level_in_unit(variable, self.lower, self.unit), level_in_unit(variable, self.upper, self.unit)

    def __repr__(self) -> str:
        return shown_without(self, () if self.unit else ("unit",))


@dataclass(frozen=True, slots=True)
class GaussianNoise:
    """Measurement noise: independent, normal, zero mean.

    Parameters
    ----------
    standard_deviation : mapping of str to float
        For each noisy measurement by name, in its unit.
    mixture : sequence of (int, float)
        Seeds of streams in place of that of the loop's seed, each with its weight: their sum is as normal as
        one of them where the squares of the weights sum to 1.
    """

    standard_deviation: Mapping[str, float]
    mixture: Sequence[tuple[int, float]] = ()

    def __post_init__(self) -> None:
        faults = [
            f"noise: standard deviation of {name} = {value} is not possible; allowed: >= 0"
            for name, value in self.standard_deviation.items()
            if not (isinstance(value, Real) and 0 <= float(value) < math.inf)
        ]
        if faults:
            raise ConfigError(faults)


@dataclass(frozen=True, slots=True)
class ParameterChange(Section):
    """An event: tunable parameters that take new values at the first sample at or after ``time`` [s]."""

    time: float = setting(doc="when it happens", unit="s")
    parameters: Mapping[str, ParameterValue] = setting(
        {}, doc="values by name", written=dict[str, bool | int | float | str], required=True
    )

    def __post_init__(self) -> None:
        _check_types(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift(Section):
    """A tunable parameter that moves linearly from one value to another, in steps of one sample."""

    parameter: str = setting(doc="the tunable parameter")
    start: float = setting(doc="value until from_time", key="from_value")
    stop: float = setting(doc="value from to_time on", key="to_value")
    start_time: float = setting(doc="where it begins", unit="s", key="from_time")
    stop_time: float = setting(doc="where it ends", unit="s", key="to_time")

    def __post_init__(self) -> None:
        self.path()

    def path(self) -> Ramp:
        """Return the parameter over time."""
        return Ramp(self.start, self.stop, self.start_time, self.stop_time)
