"""What a call of the master asks for, checked before anything is run."""

import math
from collections.abc import Sequence
from numbers import Integral, Real
from typing import Any

import numpy as np

from ddpc_cosim.controller import Loop, Recording
from ddpc_cosim.errors import ConfigError, DataError
from ddpc_cosim.signals import ParameterChange

MOST_STEPS = 100_000_000


def check_sampling_time(sampling_time: float) -> None:
    """Raise ConfigError if there cannot be so much time between samples [s]."""
    if not (_is_finite(sampling_time) and sampling_time > 0):
        raise ConfigError(f"sampling_time = {sampling_time} is not possible; allowed: a number > 0")


def whole_steps(duration: float, sampling_time: float) -> int:
    """Return the number of sampling intervals in a duration.

    Raises
    ------
    ConfigError
        There is no whole number of them, or too many.
    """
    check_sampling_time(sampling_time)
    if not _is_finite(duration):
        raise ConfigError(f"duration = {duration} is not possible; allowed: a number > 0")
    steps = duration / sampling_time
    if not steps < MOST_STEPS:
        raise ConfigError(f"duration / sampling_time = {steps:g} samples; allowed: 1 to {MOST_STEPS:.0e}")
    if round(steps) < 1 or abs(round(steps) * sampling_time - duration) > 1e-9 * max(duration, sampling_time):
        raise ConfigError(
            f"duration = {duration:g} must be a whole multiple of sampling_time = {sampling_time:g}"
        )
    return round(steps)


def end_time(start_time: float, steps: int, sampling_time: float) -> float:
    """Return the time of the last sample [s].

    Raises
    ------
    ConfigError
        The start time is no number, or so large that one sample cannot be told from the next.
    """
    if not _is_finite(start_time):
        raise ConfigError(f"start_time = {start_time} is not possible; allowed: a finite number")
    end = start_time + steps * sampling_time
    if np.spacing(max(abs(start_time), abs(end))) > 1e-3 * sampling_time:
        raise ConfigError(
            f"start_time = {start_time:g} is too large: samples {sampling_time:g} s apart coincide there"
        )
    return end


def check_seed(seed: int) -> None:
    """Raise ConfigError if this is no seed."""
    if not isinstance(seed, Integral) or seed < 0:
        raise ConfigError(f"seed = {seed!r} is not possible; allowed: a whole number >= 0")


def check_events(events: Sequence[ParameterChange], end: float) -> None:
    """Raise ConfigError for every event that would never act on the plant, as the run ends before."""
    late = [event.time for event in events if not event.time < end]
    if late:
        advice = f"the run ends at t = {end:g} s; choose an earlier time or a longer duration"
        raise ConfigError([f"events: the one at t = {time:g} s would not happen: {advice}" for time in late])


def check_recording(recording: Recording, loop: Loop) -> None:
    """Raise DataError if a recording was not made in a loop like this."""
    expected: dict[str, Any] = {
        "inputs": (recording.u.shape[1], len(loop.inputs)),
        "controlled outputs": (recording.y.shape[1], len(loop.outputs)),
        "measurements": (recording.measured.shape[1], len(loop.measurements)),
    }
    faults = [f"{there} {what}, the loop {here}" for what, (there, here) in expected.items() if there != here]
    if not np.isclose(recording.sampling_time, loop.sampling_time, rtol=1e-9, atol=0.0):
        faults.append(f"sampling time {recording.sampling_time:g} s, the loop {loop.sampling_time:g} s")
    if faults:
        raise DataError(f"recording: it does not fit the loop: it has {'; '.join(faults)}")


def _is_finite(value: Any) -> bool:
    return isinstance(value, Real) and math.isfinite(value)
