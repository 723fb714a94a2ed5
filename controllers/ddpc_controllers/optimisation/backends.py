"""Solvers of ``minimise |t|^2 subject to excess + gain t <= 0``, and what contradicts what where none can.

They are asked for the active set first: its exact law has more digits than any solver's answer.
"""

from importlib import import_module
from typing import Any, Literal, NamedTuple, Protocol, get_args

import numpy as np
import piqp

from ddpc_cosim import ConfigError, FloatArray

BackendName = Literal["piqp", "daqp"]
BACKENDS: tuple[str, ...] = get_args(BackendName)

ActiveSet = tuple[int, ...]
"""Numbers of the bounds that hold with equality."""

PIQP_TOLERANCE = 1e-12
"""Tolerances of PIQP, all of them: its defaults leave errors of 3e-4 in the input."""

_DAQP_TOLERANCE = 1e-10
_DAQP_INFEASIBLE = -1
_EXCEEDED = 1e-8
_CONTRADICTION = 1e-6
_INSIGNIFICANT = 1e-9


class Answer(NamedTuple):
    """What a solver found.

    Parameters
    ----------
    t : array, shape (k,)
        The optimum, or where the solver stopped.
    active : tuple of int
        Which bounds it holds to be active.
    failure : str
        The solver's word for why ``t`` is not the optimum; empty if it is.
    """

    t: FloatArray
    active: ActiveSet
    failure: str


class Backend(Protocol):
    """A solver for one gain and many excesses."""

    def load(self, gain: FloatArray) -> None:
        """Take the gain of the problems to come, shape (n, k)."""

    def solve(self, excess: FloatArray) -> Answer:
        """Solve for one excess, shape (n,)."""


class _ScaledProblems:
    """Bounds in units of their own gain, t in units of the excess: solvers have absolute tolerances."""

    def __init__(self, gain: FloatArray) -> None:
        norms = np.linalg.norm(gain, axis=1)
        largest = float(norms.max()) or 1.0
        # What hardly depends on t is rounding: it stays small.
        norms[norms <= _INSIGNIFICANT * largest] = largest
        self.gain, self._norms = gain / norms[:, np.newaxis], norms

    def scale(self, excess: FloatArray) -> tuple[FloatArray, float]:
        """Return the excess in these units, and the unit of t."""
        distance = excess / self._norms
        unit = float(distance.max())
        unit = unit if unit > 0.0 else 1.0
        return distance / unit, unit


class PIQPBackend:
    """PIQP's dense interior-point method."""

    def __init__(self) -> None:
        self._solver: Any = None

    def load(self, gain: FloatArray) -> None:
        """See :class:`Backend`."""
        self._problems = _ScaledProblems(gain)
        self._set_up()

    def solve(self, excess: FloatArray) -> Answer:
        """See :class:`Backend`."""
        if self._solver is None:
            self._set_up()
        excess, unit = self._problems.scale(excess)
        solver = self._solver
        solver.update(h_u=-excess)
        status = solver.solve()
        result = solver.result
        active = tuple(np.flatnonzero(result.z_u > result.s_u).tolist())
        t = unit * (self._directions @ result.x)
        return Answer(t, active, "" if status == piqp.PIQP_SOLVED else status.name)

    def _set_up(self) -> None:
        """Set the solver up over the independent directions of t."""
        gain = self._problems.gain
        _, values, right = np.linalg.svd(gain, full_matrices=False)
        self._directions = right[values > np.finfo(float).eps * len(right) * values[0]].T
        bounds, size = len(gain), self._directions.shape[1]
        solver = piqp.DenseSolver()
        for name in ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"):
            setattr(solver.settings, name, PIQP_TOLERANCE)
        gain = np.asfortranarray(gain @ self._directions)
        solver.setup(np.eye(size), np.zeros(size), G=gain, h_u=np.zeros(bounds))
        self._solver = solver

    def __getstate__(self) -> dict[str, Any]:
        """Leave PIQP's workspace behind: it is set up again when it is needed."""
        return {**self.__dict__, "_solver": None}


class DAQPBackend:
    """DAQP's dual active-set method, an optional dependency.

    Raises
    ------
    ConfigError
        It is not installed.
    """

    def __init__(self) -> None:
        try:
            import_module("daqp")
        except ImportError as error:
            raise ConfigError(
                "backend = 'daqp' needs the package daqp: install ddpc-cosim[daqp], or use backend = 'piqp'"
            ) from error
        self._model: Any = None

    def load(self, gain: FloatArray) -> None:
        """See :class:`Backend`."""
        self._problems = _ScaledProblems(gain)
        self._set_up()

    def solve(self, excess: FloatArray) -> Answer:
        """See :class:`Backend`."""
        if self._model is None:
            self._set_up()
        excess, unit = self._problems.scale(excess)
        self._model.update(bupper=-excess)
        t, _, flag, info = self._model.solve()
        active = tuple(np.flatnonzero(info["lam"] > 0.0).tolist())
        # It passes over bounds that no t moves.
        if flag > 0 and not (excess + self._problems.gain @ t).max() <= _EXCEEDED:
            flag = _DAQP_INFEASIBLE
        return Answer(unit * t, active, "" if flag > 0 else f"DAQP_EXIT_{flag}")

    def _set_up(self) -> None:
        """Set the solver up at no excess: it refuses to be set up with bounds that no t meets."""
        gain = np.ascontiguousarray(self._problems.gain)
        bounds, size = gain.shape
        self._model = import_module("daqp").Model()
        self._model.settings = {"primal_tol": _DAQP_TOLERANCE}
        self._model.setup(np.eye(size), np.zeros(size), gain, np.zeros(bounds))

    def __getstate__(self) -> dict[str, Any]:
        """Leave DAQP's workspace behind: it is set up again when it is needed."""
        return {**self.__dict__, "_model": None}


def make_backend(name: str) -> Backend:
    """Return a solver by name.

    Raises
    ------
    ConfigError
        The solver is not installed.
    """
    return DAQPBackend() if name == "daqp" else PIQPBackend()


def contradiction(gain: FloatArray, excess: FloatArray) -> ActiveSet:
    """Return bounds that no t meets together; empty if there are none.

    By Farkas' lemma they are those with a positive multiplier in ``gain' y = 0, excess' y = 1, y >= 0``.
    """
    from scipy.optimize import nnls

    system = np.vstack([gain.T / (np.abs(gain).max(initial=0.0) or 1.0), excess])
    system /= np.maximum(np.linalg.norm(system, axis=0), np.finfo(float).tiny)
    target = np.append(np.zeros(gain.shape[1]), 1.0)
    multipliers, distance = nnls(system, target)
    if distance > _CONTRADICTION:
        return ()
    return tuple(np.flatnonzero(multipliers > _CONTRADICTION * multipliers.max()).tolist())
