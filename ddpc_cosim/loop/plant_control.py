"""The plant's own control as a competitor: what is there before anyone's controller comes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ddpc_cosim.controller import Controller, Loop, Sample
from ddpc_cosim.variables import FloatArray


@dataclass(kw_only=True)
class PlantControl(Controller):
    """The control that a plant has built in: overrides are switched off, and other inputs rest.

    It needs a plant with a switch for an input that is driven (:attr:`Plant.switches`). What it commands of
    such an input is NaN in a trace: nobody commands it, and what acts instead is inside the plant.
    """

    accepts_missing: ClassVar[bool] = True

    def start(self, loop: Loop) -> None:
        """Take the inputs' start values, within their limits."""
        start = [variable.start for variable in loop.inputs]
        self._u = np.clip(start, loop.bounds.u_min, loop.bounds.u_max)

    def step(self, sample: Sample) -> FloatArray:
        """Return the inputs at rest, shape (m,), which those with a switch do not follow."""
        return self._u.copy()

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return that nothing is told of what the plant's control measures."""
        return {"plant": "it is the plant's own control"}
