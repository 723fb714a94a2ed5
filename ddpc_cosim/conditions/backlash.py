"""Play between an actuator and the plant."""

import numpy as np

from ddpc_cosim.conditions.condition import Condition
from ddpc_cosim.settings import SIGNAL, SettingInfo
from ddpc_cosim.variables import FloatArray


class Backlash(Condition):
    """What the plant gets stays where it is until an input has crossed the play, and follows from there on.

    With u the input, w the width and v what the plant gets, from its value at rest on:
    ``v_k = min(max(v_k-1, u_k - w/2), u_k + w/2)`` (the play operator: A. Visintin, Differential Models of
    Hysteresis, Springer, 1994, section III.2).
    """

    places = ("actuator",)
    order = 10
    value = SettingInfo("width of the play between each input and the plant", low=0, unit=SIGNAL)
    words = "backlash of {name}, width {value}"
    c_code = """
memory[0] = fmin(fmax(memory[0], value - given / 2.0), value + given / 2.0);
return memory[0];"""

    def start(self, time: FloatArray, rest: FloatArray | None) -> None:
        """Begin at rest, in the middle of the play, or go on."""
        if rest is not None:
            self._position = rest

    def apply(self, k: int, values: FloatArray) -> FloatArray:
        """Return what the plant gets of the inputs."""
        half = self.setup.values / 2.0
        self._position = np.clip(self._position, values - half, values + half)
        return self._position

    def in_c(self) -> tuple[FloatArray, FloatArray]:
        """Return the widths, and where the plant's side is."""
        return self.setup.values, self._position[:, np.newaxis].copy()
