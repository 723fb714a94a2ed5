"""Inputs that act late, and measurements that arrive late."""

import math

import numpy as np

from ddpc_cosim.conditions.condition import Condition, ConditionSetup
from ddpc_cosim.settings import SettingInfo
from ddpc_cosim.variables import FloatArray

# By how much a delay may miss an integer multiple of the sampling time, in parts of it.
_ROUNDING = 1e-9


class Delay(Condition):
    """An input acts, or a measurement arrives, late by an integer multiple of the sampling time.

    Until then the input is at rest, the measurement as at the first sample.
    """

    places = ("actuator", "sensor")
    order = -10
    value = SettingInfo("by how much an input acts, or a measurement arrives, late", low=0, unit="s")
    words = "delay of {name} {value}"
    c_code = """
const size_t length = (size_t)given + 1, count = (size_t)memory[0];
double *const past = memory + 1;
if (isnan(past[0])) {
    for (size_t i = 0; i < length; ++i) past[i] = value;
}
past[count % length] = value;
memory[0] = (double)(count + 1);
return past[(count + 1) % length];"""

    def __init__(self, setup: ConditionSetup) -> None:
        super().__init__(setup)
        self._samples = np.array(
            [round(delay / setup.sampling_time) for delay in setup.values], dtype=np.intp
        )
        length, columns = int(self._samples.max(initial=0)) + 1, np.arange(len(self._samples))
        # Where in the memory of a row for each of so many samples, by the row of now, the delayed values are.
        rows = (np.arange(length)[:, np.newaxis] - self._samples) % length
        self._places = rows * len(columns) + columns
        self._count = 0

    def start(self, time: FloatArray, rest: FloatArray | None) -> None:
        """Give back what is at rest first, or go on."""
        if rest is not None:
            self._is_empty = bool(np.isnan(rest).any())
            self._fill(rest)

    def _fill(self, values: FloatArray) -> None:
        self._past = np.tile(values, (len(self._places), 1))

    def apply(self, k: int, values: FloatArray) -> FloatArray:
        """Return the values of before, each signal's by its own number of samples."""
        if self._is_empty:
            self._fill(values)
            self._is_empty = False
        now = self._count % len(self._past)
        self._past[now] = values
        self._count += 1
        delayed: FloatArray = self._past.ravel()[self._places[now]]
        return delayed

    def in_c(self) -> tuple[FloatArray, FloatArray]:
        """Return by how many samples each is late, and a count of samples with the values at rest."""
        values = np.full(len(self._past[0]), np.nan) if self._is_empty else self._past[0]
        memory = np.repeat(values[:, np.newaxis], len(self._past) + 1, axis=1)
        memory[:, 0] = 0.0
        return self._samples.astype(np.float64), memory

    @classmethod
    def fault_of(cls, value: float, sampling_time: float, steps: float = math.inf, run: str = "run") -> str:
        """Return why it is too long, or no integer multiple of the sampling time; empty if it is possible."""
        late = value / sampling_time
        if late > steps * (1.0 - _ROUNDING):
            length = f"the {run} ends after {steps * sampling_time:g} s"
            return f"{value:g} s is too long: {length}; choose a shorter delay"
        if abs(round(late) - late) > _ROUNDING * max(late, 1.0):
            whole = (f"{n * sampling_time:g}" for n in (math.floor(late), math.ceil(late)))
            nearest = " or ".join(whole)
            multiple = f"an integer multiple of the sampling time of {sampling_time:g} s"
            return f"{value:g} s is not {multiple}; nearest: {nearest} s"
        return ""
