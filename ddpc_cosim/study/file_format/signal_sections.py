"""The sections of a study file that say what a signal is: references, disturbances, inputs, excitations."""

import math
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Discriminator, Field, Tag

from ddpc_cosim.csv_files import TIME_TOLERANCE, Column, read_table
from ddpc_cosim.errors import ConfigError, DataError
from ddpc_cosim.excitations import PRBS, Chirp, Excitation, Multisine, SignalExcitation, UniformRandom
from ddpc_cosim.signals import Constant, Interpolated, Ramp, Reference, Sine, Steps, WhiteNoise
from ddpc_cosim.study.file_format.validation_errors import FilePath, Section
from ddpc_cosim.variables import Variable

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


def faults_of(rule: Callable[..., object], *arguments: object) -> Iterator[tuple[str, str]]:
    """Yield what a rule of the loop says about values."""
    try:
        rule(*arguments)
    except ConfigError as error:
        yield from (("", fault) for fault in error.faults)


class LinearSection(Section):
    """A value that moves linearly between two instants."""

    from_value: Finite
    to_value: Finite
    from_time: Finite
    to_time: Finite

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong with the order of the instants."""
        yield from faults_of(Ramp, self.from_value, self.to_value, self.from_time, self.to_time)


class _Signal(Section):
    unit: str = Field("", description="unit of the values here; empty: the variable's own")


class ConstantReference(_Signal):
    """One value for all time."""

    kind: Literal["constant"]
    value: Finite

    def build(self, variable: Variable, convert: Any) -> Reference:
        """Return the signal in the variable's own unit."""
        return Constant(float(convert(self.value)))


class StepsSection(_Signal):
    """Piecewise constant."""

    kind: Literal["steps"]
    times: Annotated[list[Finite], Field(min_length=1)] = Field(
        description="instants [s]; those of an excitation count from the start of the experiment"
    )
    values: Annotated[list[Finite], Field(min_length=1)]

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield how times and values do not fit."""
        yield from faults_of(Steps, self.times, self.values)

    def steps(self, convert: Any) -> Reference:
        """Return the signal with converted values."""
        return Steps(tuple(self.times), tuple(float(convert(value)) for value in self.values))


class StepsReference(StepsSection):
    """Piecewise constant, over the time of the run."""

    def build(self, variable: Variable, convert: Any) -> Reference:
        """Return the signal in the variable's own unit."""
        return self.steps(convert)


class InterpolatedReference(_Signal):
    """Linear between points, over the time of the run."""

    kind: Literal["interpolated"]
    times: Annotated[list[Finite], Field(min_length=1)] = Field(description="instants [s]")
    values: Annotated[list[Finite], Field(min_length=1)]

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield how times and values do not fit."""
        yield from faults_of(Interpolated, self.times, self.values)

    def build(self, variable: Variable, convert: Any) -> Reference:
        """Return the signal in the variable's own unit."""
        return Interpolated(tuple(self.times), tuple(float(convert(value)) for value in self.values))


class RampReference(_Signal, LinearSection):
    """Linear between two instants."""

    kind: Literal["ramp"]

    def build(self, variable: Variable, convert: Any) -> Reference:
        """Return the signal in the variable's own unit."""
        return Ramp(
            float(convert(self.from_value)), float(convert(self.to_value)), self.from_time, self.to_time
        )


class SineReference(_Signal):
    """A sine about an offset; frequency in Hz, phase in rad."""

    kind: Literal["sine"]
    amplitude: Finite
    frequency: Positive
    offset: Finite = 0.0
    phase: Finite = 0.0

    def build(self, variable: Variable, convert: Any) -> Reference:
        """Return the signal in the variable's own unit."""
        offset = float(convert(self.offset))
        amplitude = float(convert(self.offset + self.amplitude)) - offset
        return Sine(amplitude, self.frequency, offset, self.phase)


class FileReference(_Signal):
    """A column of a CSV file, over its time."""

    kind: Literal["file"]
    _is_difference: ClassVar[bool] = False
    file: FilePath = Field(description="path of a CSV file, relative to the study file")
    column: str = Field(
        "", description="header of the column, with or without its unit; empty: the signal's name"
    )
    time_column: str = Field("time", min_length=1, description="header of the time, in s or the unit it has")
    interpolation: Literal["hold", "linear"] = Field(
        "hold", description="what the signal is between two rows: the last value, or a straight line"
    )

    def build(self, variable: Variable, convert: Any) -> Reference:
        """Return the signal in the variable's own unit.

        Raises
        ------
        DataError
            All that is wrong with the file.
        """
        column = Column(variable, self.column or variable.name, self.unit, self._is_difference)
        time, values = read_table(Path(self.file), [column], self.time_column)
        kind = Steps if self.interpolation == "hold" else Interpolated
        return kind(tuple(time.tolist()), tuple(values[:, 0].tolist()))


class FileDisturbance(FileReference):
    """A column of a CSV file that is added to a signal."""

    _is_difference: ClassVar[bool] = True


class NoiseSignal(_Signal):
    """Independent normal values, one for each sample."""

    kind: Literal["noise"]
    standard_deviation: NotNegative
    mean: Finite = 0.0

    def build(self, variable: Variable, convert: Any) -> Reference:
        """Return the signal in the variable's own unit."""
        mean = float(convert(self.mean))
        return WhiteNoise(abs(float(convert(self.mean + self.standard_deviation)) - mean), mean)


def _kind(reference: Any) -> Any:
    return reference.get("kind") if isinstance(reference, dict) else getattr(reference, "kind", None)


_Formula = (
    Annotated[ConstantReference, Tag("constant")]
    | Annotated[StepsReference, Tag("steps")]
    | Annotated[InterpolatedReference, Tag("interpolated")]
    | Annotated[RampReference, Tag("ramp")]
    | Annotated[SineReference, Tag("sine")]
)
_File = Annotated[FileReference, Tag("file")]
_Noise = Annotated[NoiseSignal, Tag("noise")]
ReferenceSection = Annotated[_Formula | _File, Discriminator(_kind)]
InputSection = Annotated[_Formula | _File | _Noise, Discriminator(_kind)]
DisturbanceSection = Annotated[
    _Formula | Annotated[FileDisturbance, Tag("file")] | _Noise, Discriminator(_kind)
]


class Experiment(NamedTuple):
    """What the excitations of a study are made for.

    Parameters
    ----------
    samples : int
        Number of samples T.
    sampling_time : float
        Time between samples [s].
    is_added : bool
        The excitation is added to the inputs of a controller: its values are differences.
    """

    samples: int
    sampling_time: float
    is_added: bool = False


class Excited(NamedTuple):
    """An input, and the conversion of its excitation's values to its unit."""

    section: Any
    variable: Variable
    convert: Callable[[float], float]


Levels = float | tuple[float, ...]


class _RangeExcitation(_Signal):
    """An excitation between two limits; inputs that share all else are excited by one for all of them."""

    low: Finite
    high: Finite

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong with the limits, and with what the kind says besides."""
        yield from faults_of(self.between, self.low, self.high, Experiment(1, 1e-9))

    def group(self, name: str) -> str:
        """Return what inputs that are excited together share."""
        return self.model_dump_json(exclude={"low", "high", "unit"})

    def build(self, inputs: Sequence[Excited], experiment: Experiment) -> Excitation:
        """Return the excitation of a group of inputs, in their units."""
        low = tuple(float(one.convert(one.section.low)) for one in inputs)
        high = tuple(float(one.convert(one.section.high)) for one in inputs)
        return self.between(low, high, experiment)

    @abstractmethod
    def between(self, low: Levels, high: Levels, experiment: Experiment) -> Excitation:
        """Return the excitation of inputs with these limits."""


class UniformExcitation(_RangeExcitation):
    """Independent uniform samples."""

    kind: Literal["uniform"] = "uniform"

    def between(self, low: Levels, high: Levels, experiment: Experiment) -> Excitation:
        """Return the excitation of inputs with these limits."""
        return UniformRandom(low, high, experiment.samples)


class PRBSExcitation(_RangeExcitation):
    """A pseudo-random binary sequence."""

    kind: Literal["prbs"]
    clock_period: int = Field(1, ge=1, description="samples for which each value is held")

    def between(self, low: Levels, high: Levels, experiment: Experiment) -> Excitation:
        """Return the excitation of inputs with these limits."""
        return PRBS(low, high, experiment.samples, clock_period=self.clock_period)


class MultisineExcitation(_RangeExcitation):
    """A sum of sines."""

    kind: Literal["multisine"]
    min_frequency: NotNegative = Field(
        0.0, description="lowest frequency [Hz]; 0: one period in the experiment"
    )
    max_frequency: Positive | None = Field(
        None, description="highest frequency [Hz]; none: all below half the sampling frequency"
    )
    phases: Literal["schroeder", "random"] = Field("schroeder", description="low peaks, or drawn by the seed")

    def between(self, low: Levels, high: Levels, experiment: Experiment) -> Excitation:
        """Return the excitation of inputs with these limits."""
        return Multisine(
            low,
            high,
            experiment.samples,
            sampling_time=experiment.sampling_time,
            min_frequency=self.min_frequency,
            max_frequency=math.inf if self.max_frequency is None else self.max_frequency,
            phases=self.phases,
        )


class ChirpExcitation(_RangeExcitation):
    """A swept sine."""

    kind: Literal["chirp"]
    from_frequency: Positive = Field(description="frequency at the beginning [Hz]")
    to_frequency: Positive = Field(description="frequency at the end [Hz]")
    sweep: Literal["linear", "logarithmic"] = "linear"

    def between(self, low: Levels, high: Levels, experiment: Experiment) -> Excitation:
        """Return the excitation of inputs with these limits."""
        return Chirp(
            low,
            high,
            experiment.samples,
            sampling_time=experiment.sampling_time,
            from_frequency=self.from_frequency,
            to_frequency=self.to_frequency,
            sweep=self.sweep,
        )


class _SignalExcitation(_Signal):
    """An excitation that is a signal of time; each input has its own."""

    def group(self, name: str) -> str:
        """Return the input's name, which no other one shares."""
        return name

    def build(self, inputs: Sequence[Excited], experiment: Experiment) -> Excitation:
        """Return the excitation of an input, in its unit.

        Raises
        ------
        DataError
            All that is wrong with its file.
        """
        ((_, variable, convert),) = inputs
        signal = self.signal(variable, convert, experiment)
        return SignalExcitation((signal,), experiment.samples, experiment.sampling_time)

    @abstractmethod
    def signal(self, variable: Variable, convert: Any, experiment: Experiment) -> Reference:
        """Return the input over the time of the experiment, which begins at 0."""


class StepsExcitation(StepsSection, _SignalExcitation):
    """Piecewise constant, over the time of the experiment."""

    def signal(self, variable: Variable, convert: Any, experiment: Experiment) -> Reference:
        """Return the input over the time of the experiment, which begins at 0."""
        return self.steps(convert)


class RecordedExcitation(_SignalExcitation):
    """A column of a CSV file, row by row; its times count from the first row."""

    kind: Literal["recorded"]
    file: FilePath = Field(description="path of a CSV file, relative to the study file")
    column: str = Field("", description="header of the column; empty: the input's name")
    time_column: str = Field("time", description="header of the time; empty: the file has none")

    def signal(self, variable: Variable, convert: Any, experiment: Experiment) -> Reference:
        """Return the input over the time of the experiment, which begins at 0.

        Raises
        ------
        DataError
            All that is wrong with the file, and fewer rows than samples.
        """
        samples, sampling_time, is_added = experiment
        column = Column(variable, self.column or variable.name, self.unit, is_added)
        _, values = read_table(Path(self.file), [column], self.time_column, sampling_time, TIME_TOLERANCE)
        if len(values) < samples:
            raise DataError(f"{self.file}: {len(values)} rows; needed: samples = {samples}")
        time = np.arange(samples, dtype=np.float64) * sampling_time
        return Steps(tuple(time.tolist()), tuple(values[:samples, 0].tolist()))


def _excitation_kind(section: Any) -> Any:
    return (section.get("kind", "uniform") if isinstance(section, dict) else None) or _kind(section)


ExcitationSection = Annotated[
    Annotated[UniformExcitation, Tag("uniform")]
    | Annotated[PRBSExcitation, Tag("prbs")]
    | Annotated[MultisineExcitation, Tag("multisine")]
    | Annotated[ChirpExcitation, Tag("chirp")]
    | Annotated[StepsExcitation, Tag("steps")]
    | Annotated[RecordedExcitation, Tag("recorded")],
    Discriminator(_excitation_kind),
]
