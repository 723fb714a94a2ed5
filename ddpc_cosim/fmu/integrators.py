"""Integrators for Model Exchange: one internal step at a time, with the detection of state events.

CVode is that of the SUNDIALS libraries that FMPy ships. FMPy's own solver class integrates past the sample
and interpolates, swallows errors of the FMU (exceptions do not cross C) and frees only part of its memory.
The one here stops at the sample, keeps the FMU's error, and lets a discarded evaluation be tried again with a
smaller step. SciPy's BDF serves platforms for which FMPy ships no CVode.
"""

import ctypes
import weakref
from ctypes import POINTER, byref, c_double, c_int, c_void_p
from typing import Any, Protocol

import numpy as np

from ddpc_cosim.errors import FMUStepError, StepStatus
from ddpc_cosim.fmu.instance import DoubleArray
from ddpc_cosim.fmu.status import CallError
from ddpc_cosim.variables import FloatArray

try:
    from fmpy import sundials
    from fmpy.sundials.libraries import sundials_core, sundials_cvode
except (OSError, AttributeError, ImportError):  # not for every platform
    sundials = None


class ContinuousModel(Protocol):
    """What is integrated: an FMU, or several as one. Vectors are ctypes arrays, or pointers to doubles."""

    def set_time(self, time: float) -> None:
        """Set the independent variable [s]."""

    def get_states(self, x: DoubleArray, n: int) -> None:
        """Read the continuous states."""

    def set_states(self, x: DoubleArray, n: int) -> None:
        """Write the continuous states."""

    def get_derivatives(self, dx: DoubleArray, n: int) -> None:
        """Read the derivatives of the continuous states."""

    def get_nominals(self, x: DoubleArray, n: int) -> None:
        """Read the nominal values of the continuous states; zeros where they are not known."""

    def get_event_indicators(self, z: DoubleArray, n: int) -> None:
        """Read the event indicators."""


class Integrator(Protocol):
    """Integrates the continuous states of a model."""

    def restart(self, t: float, *, nominals_changed: bool = False) -> None:
        """Start anew at a time [s], from the states that the model has there."""

    def advance(self, target: float) -> tuple[float, bool]:
        """Do one internal step, not beyond ``target`` [s].

        Returns
        -------
        t : float
            Where it ended; the model has this time and the states there.
        state_event : bool
            Whether an event indicator has changed its sign.

        Raises
        ------
        CallError
            The model failed, or the integrator did.
        FMUStepError
            One of several models that are one failed.
        """

    def close(self) -> object:
        """Free the memory of the integrator."""


# Between these limits an integrator meets its tolerance.
_TOLERANCES = (1e-12, 1e-2)


def make_integrator(
    model: ContinuousModel, states: int, event_indicators: int, tolerance: float
) -> Integrator:
    """Return CVode where FMPy ships it, else SciPy's BDF; nothing is integrated if nothing is continuous."""
    tolerance = min(max(tolerance, _TOLERANCES[0]), _TOLERANCES[1])
    if states == 0 and event_indicators == 0:
        return NoIntegrator(model)
    if has_cvode():
        return CVodeIntegrator(model, states, event_indicators, tolerance)
    return ScipyIntegrator(model, states, event_indicators, tolerance)


def has_cvode() -> bool:
    """Whether FMPy ships CVode for this platform."""
    return sundials is not None


class NoIntegrator:
    """For models without continuous states and event indicators: time jumps from event to event."""

    def __init__(self, model: ContinuousModel) -> None:
        self._model = model

    def restart(self, t: float, *, nominals_changed: bool = False) -> None:
        """Nothing is to be done."""

    def close(self) -> None:
        """Nothing is held."""

    def advance(self, target: float) -> tuple[float, bool]:
        """Jump to ``target``."""
        self._model.set_time(target)
        return target, False


def absolute_tolerances(nominals: FloatArray, tolerance: float) -> FloatArray:
    """Return the absolute tolerance of each state; a nominal value that is none counts as 1."""
    usable = np.isfinite(nominals) & (nominals != 0.0)
    return tolerance * np.abs(np.where(usable, nominals, 1.0))


def too_close(t: float, target: float) -> bool:
    """Whether two times [s] are too close for an integrator to step from one to the other."""
    return target - t <= 1e-14 * max(abs(t), abs(target))


_ONE_STEP, _ROOT_FOUND = 2, 2
_RECOVERABLE, _UNRECOVERABLE = 1, -1


def _prototype(library: Any, name: str, result: Any, *arguments: Any) -> Any:
    """Return a function that FMPy does not declare."""
    function = getattr(library, name)
    function.restype, function.argtypes = result, list(arguments)
    return function


if sundials is not None:
    _set_stop_time = _prototype(sundials_cvode, "CVodeSetStopTime", c_int, c_void_p, c_double)
    _clear_error_handlers = _prototype(sundials_core, "SUNContext_ClearErrHandlers", c_int, c_void_p)
    _free_context = _prototype(sundials_core, "SUNContext_Free", c_int, POINTER(c_void_p))
    _free_vector = _prototype(sundials_core, "N_VDestroy", None, sundials.N_Vector)
    _free_matrix = _prototype(sundials_core, "SUNMatDestroy", None, sundials.SUNMatrix)
    _free_solver = _prototype(sundials_core, "SUNLinSolFree", c_int, sundials.SUNLinearSolver)
    _data = _prototype(sundials_core, "N_VGetArrayPointer", POINTER(c_double), sundials.N_Vector)


class CVodeIntegrator:
    """CVode's variable-order BDF with dense Jacobians by differences.

    A model with event indicators but no continuous states gets a state that does not change.

    Parameters
    ----------
    model : ContinuousModel
        The model, in continuous-time mode.
    states, event_indicators : int
        Their numbers.
    tolerance : float
        Relative tolerance.
    """

    def __init__(self, model: ContinuousModel, states: int, event_indicators: int, tolerance: float) -> None:
        self._model, self._nx, self._nz, self._tolerance = model, states, event_indicators, tolerance
        self._failure: BaseException | None = None
        self._message = ""
        size = max(states, 1)
        context = c_void_p()
        _check(sundials.SUNContext_Create(sundials.SUN_COMM_NULL, byref(context)))
        self._x = sundials.N_VNew_Serial(size, context)
        self._tolerances = sundials.N_VNew_Serial(size, context)
        self._px = _data(self._x)
        self._px[0] = 1.0
        matrix = sundials.SUNDenseMatrix(size, size, context)
        solver = sundials.SUNLinSol_Dense(self._x, matrix, context)
        memory = c_void_p(sundials.CVodeCreate(sundials.CV_BDF, context))
        self._memory = memory
        vectors = (self._x, self._tolerances)
        self.close = weakref.finalize(self, _free, memory, solver, matrix, vectors, context)
        # C keeps the addresses of these.
        self._callbacks = (
            sundials.CVRhsFn(self._derivatives),
            sundials.CVRootFn(self._event_indicators),
            sundials.SUNErrHandlerFn(self._on_error),
        )
        _check(_clear_error_handlers(context))  # the usual one prints
        _check(sundials.SUNContext_PushErrHandler(context, self._callbacks[2], None))
        _check(sundials.CVodeInit(memory, self._callbacks[0], 0.0, self._x))
        self._set_tolerances()
        _check(sundials.CVodeRootInit(memory, event_indicators, self._callbacks[1]))
        _check(sundials.CVodeSetNoInactiveRootWarn(memory))
        _check(sundials.CVodeSetLinearSolver(memory, solver, matrix))
        self._t = 0.0

    def restart(self, t: float, *, nominals_changed: bool = False) -> None:
        """Start anew at a time [s], from the states that the model has there."""
        self._t = t
        if self._nx:
            self._model.get_states(self._px, self._nx)
        if nominals_changed:
            self._set_tolerances()
        _check(sundials.CVodeReInit(self._memory, t, self._x))

    def advance(self, target: float) -> tuple[float, bool]:
        """Do one internal step, not beyond ``target`` [s]."""
        if too_close(self._t, target):
            self._place(target)
            self.restart(target)
            return target, False
        self._failure, self._message = None, ""
        _check(_set_stop_time(self._memory, target))
        reached = c_double()
        flag = sundials.CVode(self._memory, target, self._x, byref(reached), _ONE_STEP)
        if flag < 0:
            raise self._failure or CallError(
                f"CVode cannot integrate the model (code {flag}): {self._message or 'no reason given'}"
            )
        self._place(reached.value)
        return reached.value, flag == _ROOT_FOUND

    def _place(self, t: float) -> None:
        """Give the model its time and states at the end of a step."""
        self._t = t
        self._model.set_time(t)
        if self._nx:
            self._model.set_states(self._px, self._nx)

    def _set_tolerances(self) -> None:
        size = max(self._nx, 1)
        nominals: FloatArray = np.ones(size)
        if self._nx:
            memory = (c_double * size)()
            self._model.get_nominals(memory, size)
            nominals = np.array(memory)
        tolerances = absolute_tolerances(nominals, self._tolerance)
        ctypes.memmove(_data(self._tolerances), tolerances.ctypes.data, tolerances.nbytes)
        _check(sundials.CVodeSVtolerances(self._memory, self._tolerance, self._tolerances))

    def _derivatives(self, t: float, x: Any, dx: Any, _: Any) -> int:
        try:
            self._model.set_time(t)
            if not self._nx:
                _data(dx)[0] = 0.0
                return 0
            self._model.set_states(_data(x), self._nx)
            self._model.get_derivatives(_data(dx), self._nx)
        except BaseException as error:
            return self._failed(error)
        return 0

    def _event_indicators(self, t: float, x: Any, z: Any, _: Any) -> int:
        try:
            self._model.set_time(t)
            if self._nx:
                self._model.set_states(_data(x), self._nx)
            self._model.get_event_indicators(z, self._nz)
        except BaseException as error:
            return self._failed(error)
        return 0

    def _failed(self, error: BaseException) -> int:
        """Keep an error, which does not cross C; what an FMU discards may succeed with a smaller step."""
        self._failure = error
        is_discarded = isinstance(error, CallError | FMUStepError) and error.status is StepStatus.DISCARD
        return _RECOVERABLE if is_discarded else _UNRECOVERABLE

    def _on_error(self, _line: int, _function: bytes, _file: bytes, message: bytes, *_: Any) -> None:
        self._message = (message or b"").decode("utf-8", "replace").strip()


def _free(memory: c_void_p, solver: Any, matrix: Any, vectors: tuple[Any, ...], context: c_void_p) -> None:
    sundials.CVodeFree(byref(memory))
    _free_solver(solver)
    _free_matrix(matrix)
    for vector in vectors:
        _free_vector(vector)
    _free_context(byref(context))


def _check(status: int) -> None:
    if status != sundials.CV_SUCCESS:
        raise CallError(f"CVode cannot be set up (code {status})")


_BISECTIONS = 60


class ScipyIntegrator:
    """SciPy's implicit multistep method with events located by bisection on its interpolant.

    Parameters
    ----------
    model : ContinuousModel
        The model, in continuous-time mode.
    states, event_indicators : int
        Their numbers.
    tolerance : float
        Relative tolerance.
    """

    def __init__(self, model: ContinuousModel, states: int, event_indicators: int, tolerance: float) -> None:
        self._model, self._nx, self._nz, self._tolerance = model, states, event_indicators, tolerance
        from scipy.integrate import BDF  # takes long to import, and is seldom needed

        self._bdf: Any = BDF  # its type information knows no absolute tolerance of each state
        self._x, self._dx = (c_double * states)(), (c_double * states)()
        self._z = (c_double * event_indicators)()
        self._absolute = self._absolute_tolerances()
        self._solver: Any = None
        self._t, self._signs = 0.0, np.empty(0, dtype=bool)

    def close(self) -> None:
        """Nothing is held."""

    def restart(self, t: float, *, nominals_changed: bool = False) -> None:
        """Start anew at a time [s], from the states that the model has there."""
        if nominals_changed:
            self._absolute = self._absolute_tolerances()
        self._model.get_states(self._x, self._nx)
        self._solver, self._t = None, t
        self._signs = self._signs_now()

    def advance(self, target: float) -> tuple[float, bool]:
        """Do one internal step, not beyond ``target`` [s]."""
        if too_close(self._t, target):
            self._place(target, np.array(self._x))
            return target, False
        solver = self._solver_to(target)
        message = solver.step()
        if solver.status == "failed":
            raise CallError(f"SciPy's BDF cannot integrate the model: {message}")
        before, interpolant = self._t, solver.dense_output()
        self._place(solver.t, solver.y)
        if not self._nz or np.array_equal(self._signs_now(), self._signs):
            return self._t, False
        self._locate(before, self._t, interpolant)
        return self._t, True

    def _solver_to(self, target: float) -> Any:
        """Return the solver, which goes on as long as its bound does not come nearer."""
        if self._solver is None or self._solver.t_bound != target or self._solver.status != "running":
            x = np.array(self._x) if self._nx else np.ones(1)
            self._solver = self._bdf(
                self._derivatives, self._t, x, target, rtol=self._tolerance, atol=self._absolute
            )
        return self._solver

    def _derivatives(self, t: float, x: FloatArray) -> FloatArray:
        self._model.set_time(t)
        if not self._nx:
            return np.zeros(1)
        self._x[:] = x.tolist()
        self._model.set_states(self._x, self._nx)
        self._model.get_derivatives(self._dx, self._nx)
        return np.array(self._dx)

    def _locate(self, low: float, high: float, interpolant: Any) -> None:
        """Leave the model just after the first sign change between two times."""
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            if not low < middle < high:
                break
            self._place(middle, interpolant(middle))
            if np.array_equal(self._signs_now(), self._signs):
                low = middle
            else:
                high = middle
        self._place(high, interpolant(high))

    def _place(self, t: float, x: FloatArray) -> None:
        """Give the model a time and states."""
        self._t = t
        self._model.set_time(t)
        if self._nx:
            self._x[:] = x.tolist()
            self._model.set_states(self._x, self._nx)

    def _signs_now(self) -> Any:
        if self._nz:
            self._model.get_event_indicators(self._z, self._nz)
        return np.array(self._z) > 0.0

    def _absolute_tolerances(self) -> FloatArray:
        if not self._nx:
            return np.ones(1)
        memory = (c_double * self._nx)()
        self._model.get_nominals(memory, self._nx)
        return absolute_tolerances(np.array(memory), self._tolerance)
