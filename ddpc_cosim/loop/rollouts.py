"""Roll-outs: what a plant would do from one state on, for several courses of its inputs."""

from collections.abc import Sequence
from contextlib import suppress
from math import inf, nan

import numpy as np

from ddpc_cosim.errors import ConfigError, CosimError, FMUStepError
from ddpc_cosim.loop.safe_calls import step_plant
from ddpc_cosim.plant import Plant
from ddpc_cosim.variables import FloatArray


def rollout(
    plant: Plant,
    inputs: FloatArray | Sequence[FloatArray],
    *,
    sampling_time: float,
    state: object | None = None,
) -> FloatArray:
    """Roll a plant out from one state, once for each course of its inputs.

    The plant is one that can save its state, and that has been reset. Afterwards it is where it was before,
    so that its run goes on as if nothing had been tried; so it is where a roll-out failed, unless the plant
    cannot go back then.

    Parameters
    ----------
    plant : Plant
        The plant.
    inputs : array, shape (N, T, m), or sequence of N arrays, shape (T, m)
        Inputs in their units: ``inputs[i, k]`` are held over [t + k h, t + (k + 1) h) in roll-out i, where t
        is the time of the state and h the sampling time.
    sampling_time : float
        Time between samples [s].
    state : object, optional
        What ``plant.save_state()`` returned in this run; default: the state that the plant is in.

    Returns
    -------
    y : array, shape (N, T, p)
        Outputs in their units: ``y[i, k]`` at t + (k + 1) h, the end of the interval of ``inputs[i, k]``.

    Raises
    ------
    ConfigError
        The plant cannot save its state, or inputs or sampling time are not possible; all faults at once.
    FMUStepError
        The plant fails, and in which roll-out.

    Examples
    --------
    >>> with FMUPlant(pendulum_fmu, inputs=["torque"], outputs=["angle"]) as plant:
    ...     _ = plant.reset()
    ...     y = rollout(plant, [np.full((20, 1), torque) for torque in (-1.0, 0.0, 1.0)], sampling_time=0.1)
    >>> y.shape
    (3, 20, 1)
    """
    courses, faults = _courses(inputs, len(plant.inputs))
    if not plant.can_save_state:
        faults.append(f"{type(plant).__name__}: it cannot save its state (can_save_state is false)")
    if not 0.0 < sampling_time < inf:
        faults.append(f"sampling_time = {sampling_time} is not possible; allowed: a finite number > 0")
    if faults:
        raise ConfigError(faults)
    before = plant.save_state()
    beginning = before if state is None else state
    y = np.empty((*courses.shape[:2], len(plant.outputs)))
    try:
        for i, course in enumerate(courses):
            plant.restore_state(beginning)
            for k, u in enumerate(course):
                y[i, k] = step_plant(plant, u.copy(), sampling_time, getattr(plant, "time", nan))
    except FMUStepError as error:
        with suppress(CosimError):  # the first error counts
            plant.restore_state(before)
        place = f"in sample {k + 1} of roll-out {i + 1} of {len(courses)}"
        raise FMUStepError(f"{error.message}, {place}", error.status, error.time) from error
    plant.restore_state(before)
    return y


def _courses(inputs: FloatArray | Sequence[FloatArray], size: int) -> tuple[FloatArray, list[str]]:
    """Return the inputs as one array, shape (N, T, m), and what is wrong with them."""
    needed = f"needed: finite numbers, shape (N, T, {size})"
    try:
        courses = np.array(inputs, dtype=np.float64)
    except (TypeError, ValueError):
        return np.empty((0, 0, size)), [f"inputs are not numbers, or of different lengths; {needed}"]
    if courses.ndim != 3 or courses.shape[2] != size:
        return courses, [f"inputs have shape {courses.shape}; {needed}"]
    if not np.isfinite(courses).all():
        i, k, j = np.argwhere(~np.isfinite(courses))[0].tolist()
        return courses, [f"inputs[{i}, {k}, {j}] = {courses[i, k, j]} is not possible; {needed}"]
    return courses, []
