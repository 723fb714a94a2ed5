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

_AT_LIMIT = 1e-9
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
        self._limits = InputLimits(u_min, u_max)
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
        # Where nothing else would hold it back, an input that is not finite would pass.
        self._checks_inputs = self._limits.endless or not self._bounds
        if self._bounds:
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
        if self._bounds and not max(excess.tolist()) <= 0.0:
            fault = self._respect_bounds(excess, u) or fault
            self._limits.reach(u)
        elif self._checks_inputs:
            fault = zero_unless_finite(u) or fault
        self._limits.hold(u)
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
    if size <= _NO_CONFLICT:  # of what the recorded windows hold
        return ""
    if size <= _NO_CONFLICT * float((np.abs(conflict_law) @ np.abs(parameters)).max()):
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


class InputLimits:
    """The limits of the inputs, which stand first in a move.

    Parameters
    ----------
    u_min, u_max : array, shape (m,)
        The limits.

    Attributes
    ----------
    endless : bool
        Whether an input has none on a side.
    """

    def __init__(self, u_min: FloatArray, u_max: FloatArray) -> None:
        self._u_min, self._u_max, self._inputs = u_min, u_max, len(u_min)
        self._low, self._high = u_min.tolist(), u_max.tolist()
        self.endless = not (np.isfinite(u_min).all() and np.isfinite(u_max).all())
        span = np.zeros(len(u_min))
        np.subtract(u_max, u_min, out=span, where=np.isfinite(u_min) & np.isfinite(u_max))
        self._near_low = (u_min + _AT_LIMIT * span).tolist()
        self._near_high = (u_max - _AT_LIMIT * span).tolist()

    def reach(self, u: FloatArray) -> None:
        """Put inputs that are at a limit but for rounding exactly there, in place."""
        for i, value in enumerate(u[: self._inputs].tolist()):
            if value <= self._near_low[i]:
                u[i] = self._low[i]
            elif value >= self._near_high[i]:
                u[i] = self._high[i]

    def hold(self, u: FloatArray) -> None:
        """Keep the inputs exactly within their limits, in place."""
        inputs = u[: self._inputs]
        for low, value, high in zip(self._low, inputs.tolist(), self._high, strict=True):
            if not low <= value <= high:  # seldom: comparing a few numbers takes less time than a clip
                np.maximum(inputs, self._u_min, out=inputs)
                np.minimum(inputs, self._u_max, out=inputs)
                return


def _make_room(store: dict[ActiveSet, Any]) -> None:
    if len(store) >= _REMEMBERED:
        del store[next(iter(store))]
