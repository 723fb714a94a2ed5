"""Measurements that do not arrive."""

import numpy as np

from ddpc_cosim.conditions.condition import Condition
from ddpc_cosim.settings import SettingInfo
from ddpc_cosim.variables import FloatArray

_STREAM = 6  # of the seed; lower ones are those of loop.setup and of conditions


class Loss(Condition):
    """A measurement is lost at a sample with a probability; at the first one it never is.

    What is lost of a signal depends on its name and the seed alone, whatever else is lost.
    """

    places = ("sensor",)
    order = 20
    value = SettingInfo("probability that a measurement is lost at a sample", low=0, high=1)
    words = "samples of {name} lost with a probability of {value}"
    in_experiments = False
    loses = True
    c_code = "return memory[k] != 0.0 ? NAN : value;"

    def start(self, time: FloatArray, rest: FloatArray | None) -> None:
        """Draw what is lost."""
        setup = self.setup
        self._lost = np.zeros((len(time), len(setup.signals)), dtype=bool)
        for column, name in enumerate(setup.signals):
            drawn = np.random.default_rng([setup.seed, _STREAM, *name.encode()]).random(len(time))
            self._lost[1:, column] = drawn[1:] < setup.values[column]

    def apply(self, k: int, values: FloatArray) -> FloatArray:
        """Return NaN for what is lost."""
        return np.where(self._lost[k], np.nan, values)

    def in_c(self) -> tuple[FloatArray, FloatArray]:
        """Return the probabilities, and what is lost."""
        return self.setup.values, self._lost.T.astype(np.float64)

    @classmethod
    def allowed(cls) -> str:
        """Return the range of its values in words."""
        return "a probability from 0 to 1"
