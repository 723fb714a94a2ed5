"""The condensed problem online: an affine law, the laws of remembered active sets, and a solver for new ones.

With e the normalised excess over every bound and S = L L', the optimality conditions of a
:class:`~ddpc_controllers.condensing.CondensedProblem` read

    e = e_0 - S mu,   e <= 0,   mu >= 0,   e' mu = 0.

For a given active set they are linear in e_0: one small product and one comparison prove its law optimal.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ddpc_controllers.backends import ActiveSet, Backend, PIQPBackend, contradiction
from ddpc_controllers.condensing import CondensedProblem
from ddpc_cosim import FloatArray

NOT_FINITE = "a measurement or a reference is not finite: inputs at zero, or at the limit nearest to it"
"""The fault of a problem that cannot be posed."""

_FEASIBLE = 1e-11
_NO_CONFLICT = 1e-6
_LARGEST_CONDITION = 1e12
_REMEMBERED = 256


class Move(NamedTuple):
    """What to apply now.

    Parameters
    ----------
    u : array, shape (m,)
        The inputs, within their bounds; a new array. After them whatever else the problem was asked for.
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
    backend : Backend, optional
        The solver for active sets not seen before; default: PIQP.
    """

    def __init__(
        self,
        problem: CondensedProblem,
        u_min: FloatArray,
        u_max: FloatArray,
        backend: Backend | None = None,
    ) -> None:
        self._u_min, self._u_max = u_min, u_max
        self._backend = backend or PIQPBackend()
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
        self._backend.load(problem.excess_gain)

    def solve(self, parameters: FloatArray) -> Move:
        """Return the optimal move, or the documented fallback with its reason.

        Parameters
        ----------
        parameters : array, shape (parameters,)
            The parameter vector p; its last entry is 1.
        """
        answer = np.dot(self._law, parameters)
        excess, u = answer[: self._bounds], answer[self._bounds :]
        fault = find_conflict(self._problem.conflict_law, parameters) if self._watches_conflict else ""
        if not self._bounds:
            fault = zero_unless_finite(u) or fault
        elif not max(excess.tolist()) <= 0.0:
            fault = self._respect_bounds(excess, u) or fault
        clip_inputs(u, self._u_min, self._u_max)
        return Move(u, fault)

    def _respect_bounds(self, excess: FloatArray, u: FloatArray) -> str:
        """Correct the unconstrained optimum ``u`` in place."""
        if self._active and self._apply(self._active, excess, u):
            return ""
        pattern = tuple(np.flatnonzero(excess > 0.0).tolist())
        guess = self._active_sets.get(pattern, pattern)
        if guess and self._apply(guess, excess, u):
            self._active = guess
            return ""
        return self._ask_solver(excess, u, pattern)

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

    def _ask_solver(self, excess: FloatArray, u: FloatArray, pattern: ActiveSet) -> str:
        """Solve, read off the active set, and prefer its exact law to the solver's digits."""
        if fault := zero_unless_finite(u, excess):
            return fault
        t, active, failure = self._backend.solve(excess)
        # Whatever the solver says of itself: a law that satisfies the optimality conditions is the optimum.
        if active and self._apply(active, excess, u):
            self._active = active
            _make_room(self._active_sets)
            self._active_sets[pattern] = active
            return ""
        if failure:
            return infeasible(failure, self._problem.excess_gain, excess, self._problem.labels)
        u += self._problem.move_gain @ t
        return ""


def find_conflict(conflict_law: FloatArray, parameters: FloatArray) -> str:
    """Say how far a past is from what the recorded windows can combine to; empty if it is not."""
    size = float(np.abs(conflict_law @ parameters).max())
    if size <= _NO_CONFLICT * float(np.abs(parameters).max()):
        return ""
    return f"no combination of the recorded windows has this past (off by {size:.1e}); the nearest is used"


def zero_unless_finite(u: FloatArray, excess: FloatArray | None = None) -> str:
    """Set the move to zero, in place, and say so, if the problem's numbers are not finite."""
    if np.isfinite(u if excess is None else excess).all():
        return ""
    u[...] = 0.0
    return NOT_FINITE


def infeasible(failure: str, gain: FloatArray, excess: FloatArray, labels: Sequence[str]) -> str:
    """Say that a solver failed, and which bounds contradict each other."""
    conflicting = sorted({labels[row] for row in contradiction(gain, excess)}) if labels else []
    which = f": {', '.join(conflicting)}" if conflicting else ""
    return f"no way to meet all bounds ({failure}{which}): unconstrained optimum, clipped at the input limits"


def clip_inputs(u: FloatArray, u_min: FloatArray, u_max: FloatArray) -> None:
    """Hold the inputs, which stand first in ``u``, exactly within their limits, in place."""
    inputs = u if len(u) == len(u_min) else u[: len(u_min)]
    np.maximum(inputs, u_min, out=inputs)
    np.minimum(inputs, u_max, out=inputs)


def _make_room(store: dict[ActiveSet, Any]) -> None:
    if len(store) >= _REMEMBERED:
        del store[next(iter(store))]
