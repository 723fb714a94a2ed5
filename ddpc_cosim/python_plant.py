"""A plant written in Python as a study uses it: driven by some of its inputs, and failing like an FMU."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ddpc_cosim.guards import (
    close_plant,
    make_plant,
    plant_provenance,
    reset_plant,
    set_plant_parameters,
    step_plant,
)
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.variables import FloatArray, names


class PythonPlant(Plant):
    """A plant of any class, of which some inputs are driven; the others rest at their start values.

    Parameters
    ----------
    make : callable
        Makes the plant.
    inputs : sequence of str
        Names of the inputs to drive, in this order.

    Raises
    ------
    FMUStepError
        The plant cannot be made, and why.
    """

    def __init__(self, make: Callable[[], Plant], inputs: Sequence[str]) -> None:
        self._plant = make_plant(make)
        every = tuple(self._plant.inputs)
        self._driven = [names(every).index(name) for name in inputs]
        self._u = np.array([variable.start for variable in every], dtype=np.float64)
        self.inputs = tuple(every[index] for index in self._driven)
        self.outputs = tuple(self._plant.outputs)
        self._t0, self._steps, self._h = 0.0, 0, 0.0

    @property
    def _time(self) -> float:
        return self._t0 + self._steps * self._h

    def plan(self, sampling_time: float, stop_time: float) -> None:
        """Say what the coming runs will ask."""
        self._plant.plan(sampling_time, stop_time)

    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        """Go to the initial state and return the outputs there, shape (p,)."""
        self._t0, self._steps = t0, 0
        return reset_plant(self._plant, parameters, t0)

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold the driven inputs u, shape (m,), over h [s] and return the outputs at its end, shape (p,)."""
        every = self._u.copy()
        every[self._driven] = u
        y = step_plant(self._plant, every, h, self._time)
        self._steps, self._h = self._steps + 1, h
        return y

    def set_parameters(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Change tunable parameters from the next step on."""
        set_plant_parameters(self._plant, parameters, self._time)

    def close(self) -> None:
        """Release everything that the plant holds."""
        close_plant(self._plant)

    def provenance(self) -> Mapping[str, str]:
        """Return what identifies the plant."""
        return plant_provenance(self._plant)
