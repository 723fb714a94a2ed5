"""One part of a coupled plant: its calls, whose faults carry its name."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ddpc_cosim.coupling.wiring import Intake
from ddpc_cosim.errors import ConfigError, CosimError, FMUImportError, FMUStepError
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.safe_calls import announce_call_of_plant, feedthrough_of_plant, plant_fault, plant_outputs
from ddpc_cosim.variables import FloatArray

_FLOAT = np.dtype(np.float64)


class Part:
    """A plant among others.

    Parameters
    ----------
    name : str
        Its name.
    plant : Plant
        The plant.
    intake : Intake
        How its inputs follow from all values.
    span : slice
        Where its outputs are among all values.
    """

    def __init__(self, name: str, plant: Plant, intake: Intake, span: slice) -> None:
        self.name, self.plant, self.span = name, plant, span
        self.sources, self.factor, self.offset = intake
        self._step = f'step of part "{name}"'
        self._is_scaled = intake.is_scaled
        self._shape = (len(plant.outputs),)
        self.every, self.substeps = 1, 1
        """How many communication intervals its step is long, and how many steps it does meanwhile."""

    def inputs_from(self, values: FloatArray) -> FloatArray:
        """Return the part's inputs, a new array of shape (m,)."""
        u = values[self.sources]
        if self._is_scaled:
            u *= self.factor
            u += self.offset
        return u

    def reset(self, parameters: Mapping[str, ParameterValue], t0: float) -> FloatArray:
        """Go to the initial state and return the outputs there, shape (p,)."""
        return self._outputs("reset", self.call("reset", t0, parameters, t0), t0)

    def step(self, u: FloatArray, h: float, time: float) -> FloatArray:
        """Hold the inputs over h [s] from ``time`` [s] on and return the outputs, shape (p,)."""
        announce_call_of_plant(self._step, time)
        try:
            y = self.plant.step(u, h)
        except (Exception, SystemExit) as error:
            raise self.failure("step", error, time) from error
        return (
            y
            if type(y) is np.ndarray and y.shape == self._shape and y.dtype is _FLOAT
            else self._outputs("step", y, time)
        )

    def outputs_at(self, u: FloatArray, time: float) -> FloatArray:
        """Return the outputs, shape (p,), at other inputs, without time passing."""
        return self._outputs("outputs_at", self.call("outputs_at", time, u), time)

    def feedthrough(self, u: FloatArray, time: float) -> FloatArray | None:
        """Return the derivatives of the outputs by the inputs, shape (p, m); None: not known."""
        try:
            return feedthrough_of_plant(self.plant, u, time)
        except CosimError as error:
            raise self.failure("feedthrough", error, time) from error

    def call(self, method: str, time: float, *arguments: Any) -> Any:
        """Call a method of the plant at a time [s]."""
        announce_call_of_plant(f'{method} of part "{self.name}"', time)
        try:
            return getattr(self.plant, method)(*arguments)
        except (Exception, SystemExit) as error:
            raise self.failure(method, error, time) from error

    def failure(self, method: str, error: BaseException, time: float) -> CosimError:
        """Return an error as one of the part."""
        whose = f'part "{self.name}": '
        if isinstance(error, ConfigError):
            return ConfigError([whose + fault for fault in error.faults])
        if isinstance(error, FMUImportError):
            return FMUImportError(f"{whose}{error}")
        if not isinstance(error, FMUStepError):
            error = plant_fault(f"{type(self.plant).__name__}.{method}", error, time)
        return FMUStepError(whose + error.message, error.status, error.time)

    def _outputs(self, call: str, y: Any, time: float) -> FloatArray:
        try:
            return plant_outputs(self.plant, call, np.asarray(y), time)
        except FMUStepError as error:
            raise self.failure(call, error, time) from error
