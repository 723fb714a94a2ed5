"""Actuators that are not fast enough."""

import math

import numpy as np

from ddpc_cosim.conditions.condition import Condition, ConditionSetup
from ddpc_cosim.settings import SIGNAL, SettingInfo
from ddpc_cosim.variables import FloatArray


class RateLimit(Condition):
    """An input changes by at most so much per second, from its value at rest on."""

    places = ("actuator",)
    order = -20
    value = SettingInfo("largest change of each input per second", above=0, unit=SIGNAL)
    words = "rate limit of {name} {value} per second"
    neutral = math.inf
    c_code = """
memory[0] = fmin(fmax(value, memory[0] - given), memory[0] + given);
return memory[0];"""

    def __init__(self, setup: ConditionSetup) -> None:
        super().__init__(setup)
        self._reach = setup.values * setup.sampling_time

    def start(self, time: FloatArray, rest: FloatArray | None) -> None:
        """Begin at rest, or go on."""
        if rest is not None:
            self._position = rest

    def apply(self, k: int, values: FloatArray) -> FloatArray:
        """Return the inputs as near to what is commanded as they come."""
        self._position = np.clip(values, self._position - self._reach, self._position + self._reach)
        return self._position

    def in_c(self) -> tuple[FloatArray, FloatArray]:
        """Return the largest changes in a sampling interval, and where the inputs are."""
        return self._reach, self._position[:, np.newaxis].copy()
