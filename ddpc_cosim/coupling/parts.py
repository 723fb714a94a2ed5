"""One part of a coupled plant: its calls, with the values that it takes; its faults carry its name."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ddpc_cosim.coupling.wiring import AffineMap
from ddpc_cosim.errors import ConfigError, CosimError, FMUImportError, FMUStepError
from ddpc_cosim.loop.safe_calls import (
    announce_call_of_plant,
    feedthrough_of_plant,
    plant_fault,
    plant_outputs,
)
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.variables import FloatArray


class Part:
    """A plant among others.

    Parameters
    ----------
    name : str
        Its name.
    plant : Plant
        The plant.
    input_map : AffineMap
        How its inputs follow from all values.
    output_slice : slice
        Where its outputs are among all values.

    Attributes
    ----------
    every, substeps : int
        How many communication intervals its step is long, and how many steps it does meanwhile.
    in_step : str
        What is announced of a step.
    is_scaled : bool
        Whether its inputs are other numbers than the values that it takes.
    is_within : bool
        Whether its calls are within one that may not take longer as a whole than a call may.
    """

    def __init__(self, name: str, plant: Plant, input_map: AffineMap, output_slice: slice) -> None:
        self.name, self.plant, self.output_slice = name, plant, output_slice
        self.places = range(output_slice.start, output_slice.stop)
        self.sources, self.factor, self.offset = input_map
        self.in_step = f'step of part "{name}"'
        self.size = len(plant.outputs)
        self.is_scaled = input_map.is_scaled
        self.every, self.substeps = 1, 1
        self.is_within = False

    def step(self, taken: FloatArray, h: float, time: float) -> FloatArray:
        """Hold the inputs over h [s] from ``time`` [s] on and return the outputs, shape (p,)."""
        announce_call_of_plant(self.in_step, time)
        try:
            y = self.plant.step(self.factor * taken + self.offset, h)
        except (Exception, SystemExit) as error:
            raise self.failure("step", error, time) from error
        return self._outputs("step", y, time + h)

    def reset(self, parameters: Mapping[str, ParameterValue], t0: float) -> FloatArray:
        """Go to the initial state and return the outputs there, shape (p,)."""
        return self._outputs("reset", self.call("reset", t0, parameters, t0), t0)

    def outputs_at(self, taken: FloatArray, time: float) -> FloatArray:
        """Return the outputs, shape (p,), at other inputs, without time passing."""
        return self._outputs("outputs_at", self.call("outputs_at", time, self.inputs_from(taken)), time)

    def inputs_from(self, taken: FloatArray) -> FloatArray:
        """Return the inputs, shape (m,), that follow from the values that are taken."""
        return self.factor * taken + self.offset if self.is_scaled else taken

    def derivatives(self, taken: FloatArray, time: float) -> FloatArray | None:
        """Return the derivatives of outputs by the values that are taken, shape (p, m); None: not known."""
        try:
            derivatives = feedthrough_of_plant(self.plant, self.factor * taken + self.offset, time)
        except CosimError as error:
            raise self.failure("feedthrough", error, time) from error
        return None if derivatives is None else derivatives * self.factor

    def may_take(self, taken: FloatArray) -> bool:
        """Whether the inputs are not above their limits."""
        high = [variable.max for variable in self.plant.inputs]
        return bool((self.factor * taken + self.offset <= high).all())

    def call(self, method: str, time: float, *arguments: Any) -> Any:
        """Call a method of the plant at a time [s]."""
        announce_call_of_plant(f'{method} of part "{self.name}"', time, is_within=self.is_within)
        try:
            return getattr(self.plant, method)(*arguments)
        except (Exception, SystemExit) as error:
            raise self.failure(method, error, time) from error

    def failure(self, method: str, error: BaseException, time: float, returned: Any = None) -> CosimError:
        """Return an error as one of the part, in a call or with what it returned."""
        if returned is not None:
            try:
                plant_outputs(self.plant, method, np.asarray(returned), time)
            except FMUStepError as fault:
                error = fault
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
