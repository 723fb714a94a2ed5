"""The condensed problem online: an affine law, the laws of remembered active sets, and PIQP for new ones.

With e the normalised excess over every bound and S = L L', the optimality conditions of a
:class:`~ddpc_controllers.condensing.CondensedProblem` read

    e = e_0 - S mu,   e <= 0,   mu >= 0,   e' mu = 0.

For a given active set they are linear in e_0: one small product and one comparison prove its law optimal.
"""

from typing import Any, NamedTuple

import numpy as np
import piqp

from ddpc_controllers.condensing import CondensedProblem
from ddpc_cosim import FloatArray

SOLVER_TOLERANCE = 1e-12
"""Tolerances of PIQP, all of them: its defaults leave errors of 3e-4 in the input."""

_FEASIBLE = 1e-11
_NO_CONFLICT = 1e-6
_LARGEST_CONDITION = 1e12
_REMEMBERED = 256

ActiveSet = tuple[int, ...]
"""Numbers of the bounds that hold with equality."""


class Move(NamedTuple):
    """What to apply now.

    Parameters
    ----------
    u : array, shape (m,)
        The inputs, within their bounds; a new array.
    fault : str
        Why ``u`` is not the optimum of the problem as posed; empty if it is.
    """

    u: FloatArray
    fault: str


class ParametricQP:
    """A condensed problem, solved for one parameter vector after another.

    Parameters
    ----------
    problem : CondensedProblem
        What to solve.
    u_min, u_max : array, shape (m,)
        Input limits, held exactly.
    """

    def __init__(self, problem: CondensedProblem, u_min: FloatArray, u_max: FloatArray) -> None:
        self._u_min, self._u_max = u_min, u_max
        self._active: ActiveSet = ()
        self._active_sets: dict[ActiveSet, ActiveSet] = {}
        self.replace(problem)

    def replace(self, problem: CondensedProblem) -> None:
        """Take new matrices; active sets seen before stay the first guesses."""
        self._problem = problem
        self._watches_conflict = problem.conflict_law.size > 0
        self._bounds = len(problem.excess_law)
        self._law = np.vstack([problem.excess_law, problem.move_law])
        self._laws: dict[ActiveSet, FloatArray | None] = {}
        self._piqp: tuple[Any, FloatArray] | None = None

    def solve(self, parameters: FloatArray) -> Move:
        """Return the optimal move, or the documented fallback with its reason.

        Parameters
        ----------
        parameters : array, shape (parameters,)
            The parameter vector p; its last entry is 1.
        """
        answer = np.dot(self._law, parameters)
        excess, u = answer[: self._bounds], answer[self._bounds :]
        fault = self._find_conflict(parameters) if self._watches_conflict else ""
        if self._bounds and not max(excess.tolist()) <= 0.0:
            fault = self._respect_bounds(excess, u) or fault
        np.maximum(u, self._u_min, out=u)
        np.minimum(u, self._u_max, out=u)
        return Move(u, fault)

    def _find_conflict(self, parameters: FloatArray) -> str:
        size = float(np.abs(self._problem.conflict_law @ parameters).max())
        if size <= _NO_CONFLICT * float(np.abs(parameters).max()):
            return ""
        return (
            f"no combination of the recorded windows has this past (off by {size:.1e}); the nearest is used"
        )

    def _respect_bounds(self, excess: FloatArray, u: FloatArray) -> str:
        """Correct the unconstrained optimum ``u`` in place."""
        if self._active and self._apply(self._active, excess, u):
            return ""
        pattern = tuple(np.flatnonzero(excess > 0.0).tolist())
        guess = self._active_sets.get(pattern, pattern)
        if guess and self._apply(guess, excess, u):
            self._active = guess
            return ""
        return self._solve_with_piqp(excess, u, pattern)

    def _apply(self, active: ActiveSet, excess: FloatArray, u: FloatArray) -> bool:
        """Apply the law of an active set where it proves optimal."""
        if active not in self._laws:
            _make_room(self._laws)
            self._laws[active] = self._derive_law(active)
        law = self._laws[active]
        if law is None:
            return False
        answer = np.dot(law, excess)
        if not max(answer[: self._bounds].tolist()) <= _FEASIBLE:
            return False
        u += answer[self._bounds :]
        return True

    def _derive_law(self, active: ActiveSet) -> FloatArray | None:
        """Return the map from e_0 to (e inactive, -mu active; change of u), None if degenerate."""
        rows = list(active)
        gain = self._problem.excess_gain[rows]
        curvature = gain @ gain.T
        if np.linalg.cond(curvature) > _LARGEST_CONDITION:
            return None
        multipliers = np.zeros((len(rows), self._bounds))
        multipliers[:, rows] = np.linalg.inv(curvature)
        certificate = np.eye(self._bounds) - self._problem.excess_gain @ (gain.T @ multipliers)
        certificate[rows] = -multipliers / np.abs(multipliers).max()
        return np.vstack([certificate, -self._problem.move_gain @ (gain.T @ multipliers)])

    def _solve_with_piqp(self, excess: FloatArray, u: FloatArray, pattern: ActiveSet) -> str:
        """Solve, read off the active set, and prefer its exact law to the solver's digits."""
        if not np.isfinite(excess).all():
            u[...] = 0.0
            return "a measurement or a reference is not finite: inputs at zero, or at the limit nearest to it"
        self._piqp = self._piqp or self._set_up_piqp()
        solver, directions = self._piqp
        solver.update(h_u=-excess)
        status = solver.solve()
        result = solver.result
        active = tuple(np.flatnonzero(result.z_u > result.s_u).tolist())
        # Whatever the solver says of itself: a law that satisfies the optimality conditions is the optimum.
        if active and self._apply(active, excess, u):
            self._active = active
            _make_room(self._active_sets)
            self._active_sets[pattern] = active
            return ""
        if status == piqp.PIQP_SOLVED:
            u += self._problem.move_gain @ (directions @ result.x)
            return ""
        return (
            f"no way to meet all bounds ({status.name}): unconstrained optimum, clipped at the input limits"
        )

    def _set_up_piqp(self) -> tuple[Any, FloatArray]:
        """Return the solver over the independent directions of t, and these directions."""
        _, values, right = np.linalg.svd(self._problem.excess_gain, full_matrices=False)
        directions = right[values > np.finfo(float).eps * len(right) * values[0]].T
        gain = self._problem.excess_gain @ directions
        solver = piqp.DenseSolver()
        for name in ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"):
            setattr(solver.settings, name, SOLVER_TOLERANCE)
        size = directions.shape[1]
        solver.setup(np.eye(size), np.zeros(size), G=np.asfortranarray(gain), h_u=np.zeros(self._bounds))
        return solver, directions

    def __getstate__(self) -> dict[str, Any]:
        """Leave PIQP's workspace behind: it is set up again when it is needed."""
        return {**self.__dict__, "_piqp": None}


def _make_room(store: dict[ActiveSet, Any]) -> None:
    if len(store) >= _REMEMBERED:
        del store[next(iter(store))]
