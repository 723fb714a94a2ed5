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
_CONTRADICTION = 1e-6


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


class PIQPBackend:
    """PIQP's dense interior-point method."""

    def __init__(self) -> None:
        self._solver: Any = None

    def load(self, gain: FloatArray) -> None:
        """See :class:`Backend`."""
        self._gain, self._solver = gain, None

    def solve(self, excess: FloatArray) -> Answer:
        """See :class:`Backend`."""
        if self._solver is None:
            self._set_up()
        solver = self._solver
        solver.update(h_u=-excess)
        status = solver.solve()
        result = solver.result
        active = tuple(np.flatnonzero(result.z_u > result.s_u).tolist())
        return Answer(self._directions @ result.x, active, "" if status == piqp.PIQP_SOLVED else status.name)

    def _set_up(self) -> None:
        """Set the solver up over the independent directions of t."""
        _, values, right = np.linalg.svd(self._gain, full_matrices=False)
        self._directions = right[values > np.finfo(float).eps * len(right) * values[0]].T
        bounds, size = len(self._gain), self._directions.shape[1]
        solver = piqp.DenseSolver()
        for name in ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"):
            setattr(solver.settings, name, PIQP_TOLERANCE)
        gain = np.asfortranarray(self._gain @ self._directions)
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
        self._gain, self._model = np.ascontiguousarray(gain), None

    def solve(self, excess: FloatArray) -> Answer:
        """See :class:`Backend`."""
        if self._model is None:
            self._set_up(excess)
        else:
            self._model.update(bupper=-excess)
        t, _, flag, info = self._model.solve()
        active = tuple(np.flatnonzero(info["lam"] > 0.0).tolist())
        return Answer(t, active, "" if flag > 0 else f"DAQP_EXIT_{flag}")

    def _set_up(self, excess: FloatArray) -> None:
        size = self._gain.shape[1]
        self._model = import_module("daqp").Model()
        self._model.settings = {"primal_tol": _DAQP_TOLERANCE}
        self._model.setup(np.eye(size), np.zeros(size), self._gain, -excess)

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

    system = np.vstack([gain.T, excess])
    target = np.append(np.zeros(gain.shape[1]), 1.0)
    multipliers, distance = nnls(system, target)
    if distance > _CONTRADICTION:
        return ()
    return tuple(np.flatnonzero(multipliers > _CONTRADICTION * multipliers.max()).tolist())
