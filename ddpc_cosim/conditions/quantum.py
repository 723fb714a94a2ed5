"""Sensors that round."""

import numpy as np

from ddpc_cosim.conditions.condition import Condition, ConditionSetup
from ddpc_cosim.settings import SIGNAL, SettingInfo
from ddpc_cosim.variables import FloatArray


class Quantum(Condition):
    """Measurements are rounded to integer multiples of it."""

    places = ("sensor",)
    order = 10
    value = SettingInfo("what each measurement is rounded to integer multiples of", above=0, unit=SIGNAL)
    words = "{name} rounded to multiples of {value}"
    c_code = "return rint(value / given) * given;"

    def __init__(self, setup: ConditionSetup) -> None:
        super().__init__(setup)
        self._rounded = np.flatnonzero(setup.values)
        self._quantum = setup.values[self._rounded]

    def apply(self, k: int, values: FloatArray) -> FloatArray:
        """Return rounded values."""
        values = values.copy()
        values[self._rounded] = np.round(values[self._rounded] / self._quantum) * self._quantum
        return values
