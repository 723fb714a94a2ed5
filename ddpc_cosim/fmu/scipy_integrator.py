"""SciPy's BDF, for platforms for which FMPy ships no CVode."""

from ctypes import c_double
from typing import Any

import numpy as np
from scipy import integrate

from ddpc_cosim.fmu.calls import CallError
from ddpc_cosim.fmu.instance import Model
from ddpc_cosim.fmu.integrators import absolute_tolerances, too_close
from ddpc_cosim.variables import FloatArray

_BDF: Any = integrate.BDF  # its type information knows no absolute tolerance of each state
_BISECTIONS = 60


class ScipyIntegrator:
    """SciPy's implicit multistep method with events located by bisection on its interpolant.

    Parameters
    ----------
    model : Model
        The FMU, in continuous-time mode.
    states, event_indicators : int
        Their numbers.
    tolerance : float
        Relative tolerance.
    """

    def __init__(self, model: Model, states: int, event_indicators: int, tolerance: float) -> None:
        self._model, self._nx, self._nz, self._tolerance = model, states, event_indicators, tolerance
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
            self._solver = _BDF(
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
