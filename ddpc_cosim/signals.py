"""References, noise and events."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from numbers import Integral, Real
from typing import Any

import numpy as np

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.plant import ParameterValue
from ddpc_cosim.variables import FloatArray

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
    return [
        f"{one.name} = {getattr(signal, one.name)!r} is not possible; needed: {words}"
        for one in fields(signal)
        if one.type in (kinds or _NEEDED)
        for words, fits in (_NEEDED[one.type],)
        if not fits(getattr(signal, one.name))
    ]


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
        raise ConfigError(f"{what}: {values[first]} at t = {time[first]:g} s; needed: finite")
    return values


@dataclass(frozen=True, slots=True)
class Constant(Reference):
    """One value for all time."""

    value: float = 0.0

    def __post_init__(self) -> None:
        _check_types(self)

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""
        return np.full(time.shape, self.value)


@dataclass(frozen=True, slots=True)
class Steps(Reference):
    """Piecewise constant: ``values[i]`` from ``times[i]`` on; the first value also before.

    Parameters
    ----------
    times : sequence of float
        Increasing instants [s].
    values : sequence of float
        One value for each instant.

    Raises
    ------
    ConfigError
        Different lengths, nothing at all, or times that do not increase.
    """

    times: Sequence[float]
    values: Sequence[float]

    def __post_init__(self) -> None:
        _check_types(self)
        faults = []
        if len(self.times) != len(self.values) or not len(self.times):
            lengths = f"times ({len(self.times)}) and values ({len(self.values)})"
            faults.append(f"steps: {lengths} must have the same length, at least 1")
        if not np.all(np.diff(self.times) > 0):
            faults.append(f"steps: times must increase, got {list(self.times)}")
        if faults:
            raise ConfigError(faults)

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""
        late = time + _RELATIVE_TIME_TOLERANCE * np.maximum(1.0, np.abs(time))
        index = np.searchsorted(self.times, late, side="right") - 1
        return np.asarray(self.values, dtype=float)[np.maximum(index, 0)]


@dataclass(frozen=True, slots=True)
class Interpolated(Steps):
    """Linear between ``values[i]`` at ``times[i]`` and the next; the first value also before, the last after.

    Parameters and errors as of :class:`Steps`.
    """

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""
        return np.interp(time, self.times, self.values)


@dataclass(frozen=True, slots=True)
class Ramp(Reference):
    """Linear from ``start`` to ``stop`` between two instants, constant outside them."""

    start: float
    stop: float
    start_time: float
    stop_time: float

    def __post_init__(self) -> None:
        _check_types(self)
        if not self.start_time < self.stop_time:
            raise ConfigError(
                f"ramp: it must end after it starts, got {self.start_time:g} s to {self.stop_time:g} s"
            )

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""
        return np.interp(time, (self.start_time, self.stop_time), (self.start, self.stop))


@dataclass(frozen=True, slots=True)
class Sine(Reference):
    """``offset + amplitude * sin(2 pi frequency t + phase)``; frequency in Hz, phase in rad."""

    amplitude: float
    frequency: float
    offset: float = 0.0
    phase: float = 0.0

    def __post_init__(self) -> None:
        _check_types(self)

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""
        return self.offset + self.amplitude * np.sin(2 * np.pi * self.frequency * time + self.phase)


@dataclass(frozen=True, slots=True)
class WhiteNoise(Reference):
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

    standard_deviation: float
    mean: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        _check_types(self)
        if not 0 <= self.standard_deviation < math.inf:
            what = f"standard deviation = {self.standard_deviation}"
            raise ConfigError(f"noise: {what} is not possible; allowed: a finite number >= 0")

    def with_seed(self, seed: int) -> "WhiteNoise":
        """Return noise of another seed."""
        return replace(self, seed=seed)

    def at(self, time: FloatArray) -> FloatArray:
        """Return the values at the given times [s]; same shape as ``time``."""
        drawn = np.random.default_rng(self.seed).standard_normal(time.shape)
        return self.mean + self.standard_deviation * drawn


@dataclass(frozen=True, slots=True)
class GaussianNoise:
    """Measurement noise: independent, normal, zero mean.

    Parameters
    ----------
    standard_deviation : mapping of str to float
        For each noisy measurement by name, in its unit.
    """

    standard_deviation: Mapping[str, float]

    def __post_init__(self) -> None:
        faults = [
            f"noise: standard deviation of {name} = {value} is not possible; allowed: >= 0"
            for name, value in self.standard_deviation.items()
            if not (isinstance(value, Real) and 0 <= float(value) < math.inf)
        ]
        if faults:
            raise ConfigError(faults)


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """An event: tunable parameters that take new values at the first sample at or after ``time`` [s]."""

    time: float
    parameters: Mapping[str, ParameterValue] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _check_types(self)
