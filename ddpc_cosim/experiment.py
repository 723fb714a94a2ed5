"""The experiment that data-driven controllers learn from: in open loop, or about a stabilising controller."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ddpc_cosim.controller import OK, Controller, Loop, Recording, Sample
from ddpc_cosim.errors import ControllerError, DivergenceError
from ddpc_cosim.finite import NotFiniteError, require_finite
from ddpc_cosim.guards import ask_controller, reset_plant, step_plant
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.signals import UniformRandom
from ddpc_cosim.variables import FloatArray
from ddpc_cosim.wiring import Sensors


class Experiment(NamedTuple):
    """What an experiment leaves behind.

    Parameters
    ----------
    recording : Recording
        Measurements, and the inputs as they were applied.
    y_plant : array, shape (p,)
        The plant's outputs at its end.
    fallbacks : int
        At how many samples the stabilising controller returned a fallback.
    """

    recording: Recording
    y_plant: FloatArray
    fallbacks: int


class Stabiliser:
    """A controller that keeps an unstable plant while an excitation is added to its inputs.

    Parameters
    ----------
    controller : Controller
        Started already.
    loop : Loop
        The loop that it was started with.
    reference : array, shape (T + horizon, p)
        References r_0, r_1, ... on the experiment's own time.
    """

    def __init__(self, controller: Controller, loop: Loop, reference: FloatArray) -> None:
        self._controller, self._loop, self._reference = controller, loop, reference
        self.fallbacks = 0

    def inputs(self, k: int, y: FloatArray, measured: FloatArray, excitation: FloatArray) -> FloatArray:
        """Return the excited inputs of sample k within their limits, shape (m,)."""
        time = k * self._loop.sampling_time
        reference = self._reference[k + 1 : k + 1 + self._controller.horizon]
        sample = Sample(k, time, y, measured, reference)
        try:
            decided, status, _ = ask_controller(self._controller, sample, len(excitation))
        except ControllerError as error:
            raise ControllerError(f"{error}, during the experiment, at t = {time:g} s") from error
        self.fallbacks += status != OK
        bounds = self._loop.bounds
        return np.asarray(np.clip(decided + excitation, bounds.u_min, bounds.u_max))


def run_experiment(
    plant: Plant,
    sensors: Sensors,
    excitation: UniformRandom,
    sampling_time: float,
    parameters: Mapping[str, ParameterValue] | None,
    *,
    stabiliser: Stabiliser | None = None,
    onwards: float = 0.0,
) -> Experiment:
    """Excite a plant from its initial state and record it.

    The plant is told that ``onwards`` [s] are to follow.

    Raises
    ------
    DivergenceError
        The plant diverged.
    ControllerError
        The stabilising controller failed.
    FMUStepError
        The plant failed.
    """
    inputs = excitation.draw(len(plant.inputs))
    plant.plan(sampling_time, len(inputs) * sampling_time + onwards)
    y_plant = reset_plant(plant, parameters, 0.0)
    rows = []
    for k, u in enumerate(inputs):
        seen = sensors.measure(y_plant)
        rows.append(seen)
        if stabiliser is not None:
            u[:] = stabiliser.inputs(k, *seen, excitation=u)  # a row of what is recorded
        y_plant = step_plant(plant, u.copy(), sampling_time, k * sampling_time)
        try:
            require_finite(y_plant, plant.outputs)
        except NotFiniteError as error:
            kind = "open-loop" if stabiliser is None else "closed-loop"
            time = (k + 1) * sampling_time
            raise DivergenceError(
                f"the plant diverged during the {kind} experiment, at t = {time:g} s: {error}"
            ) from error
    y, measured = (np.array(column) for column in zip(*rows, strict=True))
    fallbacks = stabiliser.fallbacks if stabiliser else 0
    return Experiment(Recording(inputs, y, measured, sampling_time), y_plant, fallbacks)
