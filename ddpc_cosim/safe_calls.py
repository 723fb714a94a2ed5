"""Calls of plants and controllers: whatever theirs raise or return becomes one of this project's errors."""

import math
import reprlib
from collections.abc import Callable, Mapping, Sequence
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.controller import OK, Action, Controller, Loop, Sample
from ddpc_cosim.errors import ConfigError, ControllerError, CosimError, FMUStepError, StepStatus
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.variables import FloatArray, Variable

# Somebody's code can fail in any way, exit() included; an interrupt is the user's.
_ANY_FAULT = (Exception, SystemExit)
_REAL_KINDS = "fiub"


class Decision(NamedTuple):
    """What a controller decided.

    Parameters
    ----------
    u : array, shape (m,)
        Inputs to hold until the next sample.
    status : str
        ``"ok"``, or why ``u`` is a fallback.
    seconds : float
        Wall-clock time of its ``step`` [s].
    """

    u: NDArray[Any]
    status: str
    seconds: float


def make_plant(make: Callable[[], Plant]) -> Plant:
    """Make a plant.

    Raises
    ------
    CosimError
        What its constructor says itself; an ``FMUStepError`` for anything else that it raises.
    """
    try:
        return make()
    except CosimError:
        raise
    except _ANY_FAULT as error:
        name = getattr(make, "__name__", repr(make))
        raise FMUStepError(f"{name}() {_raised(error)}", StepStatus.CRASHED, math.nan) from error


def close_plant(plant: Plant) -> None:
    """Close a plant.

    Raises
    ------
    FMUStepError
        The plant failed.
    """
    try:
        plant.close()
    except FMUStepError:
        raise
    except _ANY_FAULT as error:
        message = f"{type(plant).__name__}.close {_raised(error)}"
        raise FMUStepError(message, StepStatus.CRASHED, math.nan) from error


def reset_plant(plant: Plant, parameters: Mapping[str, ParameterValue] | None, t0: float) -> FloatArray:
    """Reset a plant and return its outputs, shape (p,).

    Raises
    ------
    CosimError
        What the plant says itself; an ``FMUStepError`` for anything else that it raises, and for outputs
        that are none.
    """
    try:
        y = np.asarray(plant.reset(parameters, t0))
    except CosimError:
        raise
    except _ANY_FAULT as error:
        raise _plant_fault(plant, "reset", _raised(error), t0) from error
    return _outputs(plant, "reset", y, t0)


def step_plant(plant: Plant, u: FloatArray, h: float, time: float) -> FloatArray:
    """Step a plant from ``time`` [s] on and return its outputs, shape (p,).

    Raises
    ------
    FMUStepError
        The plant failed, or returned what are no outputs.
    """
    try:
        y = np.asarray(plant.step(u, h))
    except FMUStepError:
        raise
    except _ANY_FAULT as error:
        raise _plant_fault(plant, "step", _raised(error), time) from error
    return _outputs(plant, "step", y, time + h)


def set_plant_parameters(plant: Plant, parameters: Mapping[str, ParameterValue], time: float) -> None:
    """Change a plant's tunable parameters at ``time`` [s].

    Raises
    ------
    ConfigError
        The plant refuses.
    FMUStepError
        The plant failed.
    """
    try:
        plant.set_parameters(parameters)
    except (ConfigError, FMUStepError):
        raise
    except _ANY_FAULT as error:
        raise _plant_fault(plant, "set_parameters", _raised(error), time) from error


def start_controller(controller: Controller, loop: Loop) -> None:
    """Start a controller.

    Raises
    ------
    CosimError
        What the controller says itself; a ``ControllerError`` for anything else that it raises, and for a
        horizon that is no number of samples.
    """
    try:
        controller.start(loop)
    except CosimError:
        raise
    except _ANY_FAULT as error:
        raise _controller_fault(controller, "start", _raised(error)) from error
    horizon = controller.horizon
    if not isinstance(horizon, int | np.integer) or isinstance(horizon, bool) or horizon < 0:
        what = f"{type(controller).__name__}.horizon = {horizon!r}"
        raise ControllerError(f"{what} is not possible; allowed: a whole number >= 0")


def ask_controller(controller: Controller, sample: Sample, inputs: int) -> Decision:
    """Let a controller decide on its inputs, shape (inputs,).

    Raises
    ------
    ControllerError
        The controller raised, or returned something else than finite real inputs.
    """
    status = OK
    try:
        started = perf_counter()
        answer = controller.step(sample)
        seconds = perf_counter() - started
        if isinstance(answer, Action):
            status, answer = str(answer.status), answer.u
        u = np.asarray(answer)
    except _ANY_FAULT as error:
        raise _controller_fault(controller, "step", _raised(error)) from error
    if u.shape != (inputs,) or u.dtype.kind not in _REAL_KINDS or not np.isfinite(u).all():
        needed = f"needed: finite values, shape ({inputs},)"
        raise _controller_fault(controller, "step", f"{_returned(u)}; {needed}")
    return Decision(u, status, seconds)


def _outputs(plant: Plant, call: str, y: NDArray[Any], time: float) -> FloatArray:
    """Return a plant's answer if it can be its outputs; whether they are finite is for others to say."""
    size = len(plant.outputs)
    if y.shape != (size,) or y.dtype.kind not in _REAL_KINDS:
        needed = f"needed: real numbers, shape ({size},)"
        raise _plant_fault(plant, call, f"{_returned(y)}; {needed}", time)
    return np.asarray(y, dtype=np.float64)


def _returned(answer: NDArray[Any]) -> str:
    return f"returned {reprlib.repr(answer.tolist())}, shape {answer.shape}"


def controller_settings(controller: Controller) -> dict[str, Any]:
    """Return the settings of a controller.

    Raises
    ------
    ControllerError
        It cannot tell them.
    """
    try:
        return dict(controller.settings())
    except _ANY_FAULT as error:
        raise _controller_fault(controller, "settings", _raised(error)) from error


def controller_diagnostics(controller: Controller) -> dict[str, float]:
    """Return what a controller says about its data or model.

    Raises
    ------
    ControllerError
        It raised, or told something else than numbers.
    """
    try:
        return {str(name): float(value) for name, value in controller.diagnostics().items()}
    except _ANY_FAULT as error:
        raise _controller_fault(controller, "diagnostics", _raised(error)) from error


def plant_provenance(plant: Plant) -> dict[str, str]:
    """Return what identifies a plant; what it cannot tell is no reason not to run it."""
    try:
        return {str(name): str(value) for name, value in plant.provenance().items()}
    except _ANY_FAULT as error:
        return {"class": type(plant).__qualname__, "provenance": _raised(error)}


def _raised(error: BaseException) -> str:
    return f"raised {type(error).__name__}: {error}".removesuffix(": ")


def _plant_fault(plant: Plant, call: str, what: str, time: float) -> FMUStepError:
    message = f"{type(plant).__name__}.{call} {what} at t = {time:g} s"
    return FMUStepError(message, StepStatus.CRASHED, time)


def _controller_fault(controller: Controller, call: str, what: str) -> ControllerError:
    return ControllerError(f"{type(controller).__name__}.{call} {what}")


class NotFiniteError(Exception):
    """The plant returned a value that is not finite."""


def require_finite(y_plant: FloatArray, outputs: Sequence[Variable]) -> None:
    """Raise NotFiniteError if an output is not finite."""
    if not np.isfinite(y_plant).all():
        bad = int(np.flatnonzero(~np.isfinite(y_plant))[0])
        raise NotFiniteError(f"output {outputs[bad].name} is {y_plant[bad]}")
