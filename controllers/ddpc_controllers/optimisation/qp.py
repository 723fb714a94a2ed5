"""The condensed problem online: an affine law, the laws of remembered active sets, and a solver for new ones.

With e the normalised excess over every bound and S = L L', the optimality conditions of a
:class:`~ddpc_controllers.optimisation.condensing.CondensedProblem` read

    e = e_0 - S mu,   e <= 0,   mu >= 0,   e' mu = 0.

For a given active set they are linear in e_0: one small product and one comparison prove its law optimal.

On data that change at every sample no law is made that would be used once. What the condensing eliminates
before it meets the Gram matrix K of the data does not change with it: in the
coordinates of :class:`~ddpc_controllers.data.online.OnlineData`, with ``K = L L'``, the cost of the free
variables w at the parameters p is

    |residual w + offset p|^2 + |L^-1 (gain w + law p)|_weights^2,

and what is paid, ``prices' amounts``, is linear in w. One triangular solution, one product and one
factorisation give its optimum.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Protocol

import numpy as np
import scipy  # whose parts are imported when they are first used

from ddpc_controllers.checks import all_finite
from ddpc_controllers.data.online import OnlineData
from ddpc_controllers.optimisation.backends import (
    ActiveSet,
    Backend,
    PIQPBackend,
    least_distance,
    nearest_feasible,
)
from ddpc_controllers.optimisation.condensing import (
    CondensedProblem,
    Optimum,
    ReducedProblem,
    RowFactor,
    condense,
    factorise,
    reduce,
)
from ddpc_controllers.optimisation.limits import (
    CLIPPED,
    HELD,
    ChangeLimits,
    InputLimits,
    bounds_not_met,
    past_not_recorded,
    unmet_bounds,
)
from ddpc_controllers.optimisation.problem import BAND_OF_Y, Problem
from ddpc_cosim import OK, Action, ConfigError, FloatArray, Variable

FEASIBLE = 1e-11
"""By how much an optimum may exceed a bound, in parts of its range: rounding."""

_ROUNDED = 1e-14
_NO_CONFLICT = 1e-6
_LARGEST_CONDITION = 1e6
_SINGULAR = 1e-6
_ILL_CONDITIONED = 1e-5
_REMEMBERED = 256


COST, ACTIVE_BOUNDS = "cost", "active_bounds"


class Move(NamedTuple):
    """What to apply now.

    Parameters
    ----------
    u : array, shape (m,), or None
        The inputs, within their bounds; a new array. After them whatever else the problem was asked for. None
        where there is no answer at all: the last inputs are to be held.
    fault : str
        Why ``u`` is not the optimum of the problem as posed; empty if it is.
    """

    u: FloatArray | None
    fault: str


Correction = tuple[ActiveSet, FloatArray | None]
"""The active bounds of a constrained optimum, and t; None: that of the optimum on these bounds."""


class Solution(NamedTuple):
    """What a move comes from; t is the distance from the unconstrained optimum, in units of the cost.

    Parameters
    ----------
    answer : array
        Excess over the bounds at the unconstrained optimum, what was asked for, and, r being the rest of it,
        ``|r|^2``, the cost there; at its end prices and as many amounts, whose products are part of the
        cost too.
    active : tuple of int
        Numbers of the active bounds.
    t : array or None
        The distance; None: that of the optimum on the active bounds.
    parameters : array or None
        What the rest of the answer follows from; None: it is there.
    """

    answer: FloatArray
    active: ActiveSet
    t: FloatArray | None
    parameters: FloatArray | None

    def info(self, rest: int, paid: int, cost_law: FloatArray, gain: FloatArray) -> dict[str, float]:
        """Return cost and number of active bounds.

        Parameters
        ----------
        rest, paid : int
            Where r begins, and how many prices there are.
        cost_law, gain : array
            How the parameters make the rest of the answer, and how t changes the excess.
        """
        left = self.answer[rest:] if self.parameters is None else cost_law @ self.parameters
        end, t = len(left) - 2 * paid, self.t
        root, prices, amounts = left[:end], left[end : end + paid], left[end + paid :]
        if t is None and self.active:
            rows, excess = gain[list(self.active)], self.answer[list(self.active)]
            t = rows.T @ np.linalg.solve(rows @ rows.T, excess)
        cost = float(root @ root) + (0.0 if t is None else float(t @ t)) + float(prices @ amounts)
        return {COST: cost, ACTIVE_BOUNDS: float(len(self.active))}


class StepInfo(Mapping[str, float]):
    """What a predictive method says of a step; worked out when it is read, not while the step is timed.

    Parameters
    ----------
    work_out : callable
        Returns the values by name.
    given : tuple
        Its arguments, which are not changed any more.
    """

    __slots__ = ("_given", "_work_out")

    def __init__(self, work_out: Callable[..., dict[str, float]], given: tuple[Any, ...]) -> None:
        self._work_out, self._given = work_out, given

    def __iter__(self) -> Iterator[str]:
        return iter(self._read())

    def __len__(self) -> int:
        return len(self._read())

    def __getitem__(self, name: str) -> float:
        return self._read()[name]

    def _read(self) -> dict[str, float]:
        if self._work_out is not dict:
            self._work_out, self._given = dict, (self._work_out(*self._given),)
        values: dict[str, float] = self._given[0]
        return values


NO_INFO = StepInfo(dict, ({},))


def ends_info(ends: Sequence[str], predicted: FloatArray, unit: FloatArray) -> dict[str, float]:
    """Return the predicted outputs at the end of the horizon by name.

    Parameters
    ----------
    ends : sequence of str
        Their names.
    predicted, unit : arrays, shapes (..., p), (p,)
        These outputs, which end the array, and what one of them is in its own unit.
    """
    return dict(zip(ends, (predicted[-len(ends) :] * unit).tolist(), strict=True))


def changes_info(
    limits: ChangeLimits,
    ends: Sequence[str],
    unit: FloatArray,
    roots: float | FloatArray,
    ridge: float | FloatArray,
    a: FloatArray,
    error: FloatArray,
    reference: FloatArray,
    plan: Sequence[float],
    before: Sequence[float],
    u: Sequence[float],
) -> dict[str, float]:
    """Return cost, active bounds and predicted end of a plan of changes whose first ones are applied.

    Parameters
    ----------
    limits : ChangeLimits
        Those that the plan keeps.
    ends, unit : sequence of str, array, shape (p,)
        As in :func:`ends_info`.
    roots, ridge : float or array, shape (N p,) and (Nu m,)
        Roots of the weights of errors, and the weights of changes.
    a, error : array, shape (N p, Nu m) and (N p,)
        Predicted errors without changes, and what changes take from them.
    reference : array, shape (N, p)
        The reference over the horizon.
    plan, before, u : sequence of float, Nu m, m and m of them
        The planned changes, the inputs before, and those that are applied.
    """
    changes = np.array(plan)
    changes[: len(u)] = np.subtract(u, before)
    missed = error - a @ changes
    return {
        COST: float(np.square(roots * missed).sum() + (ridge * np.square(changes)).sum()),
        ACTIVE_BOUNDS: float(limits.reached(before, changes.reshape(-1, len(u)))),
        **ends_info(ends, reference.ravel() - missed, unit),
    }


def _solution_info(
    solution: Solution, how: tuple[int, int, FloatArray, FloatArray], *ends: Any
) -> dict[str, float]:
    return solution.info(*how) | ends_info(*ends)


def predicted_ends(outputs: Sequence[Variable]) -> tuple[str, ...]:
    """Return the names of the predicted outputs at the end of the horizon."""
    return tuple(f"predicted_end.{output.name}" for output in outputs)


def action(u: FloatArray, fault: str, info: Mapping[str, float]) -> Action:
    """Return an action that is a fallback where there is a fault."""
    return Action(u, fault or OK, info)


class Law(Protocol):
    """What answers a parameter vector with a move."""

    def solve(self, parameters: FloatArray) -> Move:
        """Return the optimal move, or the documented fallback with its reason."""

    def info(self, ends: Sequence[str], predicted: FloatArray, unit: FloatArray) -> StepInfo:
        """Return cost, active bounds and predicted outputs of the last solution; see :func:`ends_info`."""


@dataclass(frozen=True, slots=True)
class Relaxation:
    """What takes over where a problem has no solution: the same on the same data, made easier.

    Parameters
    ----------
    problem : Problem
        The problem that has no solution.
    data : RowFactor or OnlineData
        What it meets.
    before : (ReducedProblem, Optimum), optional
        What it was condensed through on data that stay.
    """

    problem: Problem
    data: RowFactor | OnlineData
    before: tuple[ReducedProblem, Optimum] | None = None

    def law(self, limits: InputLimits, backend: Backend) -> "_BoundedLaw | None":
        """Return the law of the easier problem, None if there is none."""
        easier = self.problem.relaxed()
        if easier is None:
            return None
        try:
            law = _law(easier, self.data, limits, type(backend)(), self.before)
        except ConfigError:  # weights so far apart that it is not determined to rounding
            return None
        law.given_up = easier.given_up
        law.hardly_matter = law.hardly_matter or easier.relaxed() is None
        return law


class _BoundedLaw(ABC):
    """What the laws share: how the unconstrained optimum is admitted, corrected or refused."""

    given_up: tuple[str, ...] = ()
    unmet = ""

    def __init__(self, limits: InputLimits, backend: Backend, relaxation: Relaxation | None) -> None:
        self.limits, self._backend, self._relaxation = limits, backend, relaxation
        self._active: ActiveSet = ()
        self._easier: _BoundedLaw | None = None
        self._rest, self._paid, self._gain = 0, 0, np.empty((0, 0))
        self._cost_law = np.empty((0, 0))
        self._solution: Solution | None = None

    def info(self, ends: Sequence[str], predicted: FloatArray, unit: FloatArray) -> StepInfo:
        """Return cost, active bounds and predicted outputs of the last solution; see :func:`ends_info`."""
        if self._solution:
            how = self._rest, self._paid, self._cost_law, self._gain
            return StepInfo(_solution_info, (self._solution, how, ends, predicted, unit))
        if self._easier is None:
            return StepInfo(ends_info, (ends, predicted, unit))
        return self._easier.info(ends, predicted, unit)

    def easier(self) -> "_BoundedLaw | None":
        """Return the law that takes over where there is no solution, None if there is none."""
        if self._easier is None and self._relaxation:
            self._easier = self._relaxation.law(self.limits, self._backend)
        return self._easier

    @abstractmethod
    def solve(self, parameters: FloatArray) -> Move:
        """Return the optimal move, or the documented fallback with its reason.

        Parameters
        ----------
        parameters : array, shape (parameters,)
            The parameter vector p; its last entry is 1.
        """

    def _take(self, problem: CondensedProblem | ReducedProblem) -> None:
        """Take the number of bounds, their names, and what must vanish, of new matrices."""
        self._bounds, self._labels = len(problem.excess_law), problem.labels
        self._conflict_law, self._watches_conflict = problem.conflict_law, problem.conflict_law.size > 0
        # Bands, prices and bounds that have given way put optima at bounds that hardly matter, or far away:
        # a solver leaves half of the digits there, or sees no solution.
        self.hardly_matter = any(label.startswith(BAND_OF_Y) for label in problem.labels)
        # Where nothing else would hold it back, an input that is not finite would pass.
        self._checks_inputs = self.limits.endless or not self._bounds

    def _tolerance(self, excess: FloatArray) -> float:
        """Return what an optimum may exceed a bound by; one without bounds that is far away is rounded."""
        return FEASIBLE + _ROUNDED * float(np.abs(excess).max()) if self.hardly_matter else FEASIBLE

    def _move(
        self,
        answer: FloatArray,
        parameters: FloatArray,
        correct: Callable[[FloatArray, FloatArray], Correction | None],
    ) -> Move:
        """Return the move, given the excess over the bounds and the inputs of the unconstrained optimum."""
        bounds = self._bounds
        u = answer[bounds : self._rest]
        given = parameters.copy() if len(self._cost_law) else None
        self._solution = Solution(answer, (), None, given)
        fault = find_conflict(self._conflict_law, parameters) if self._watches_conflict else ""
        if bounds and not max(answer[:bounds].tolist()) <= 0.0:
            excess = answer[:bounds]
            if not all_finite(excess):
                return Move(None, HELD)
            correction = correct(excess, u)
            self.limits.reach(u)
            if correction is None:
                unmet = self.unmet or unmet_bounds(self._gain, excess, self._labels)
                return self._relax(u, parameters, unmet)
            self._solution = Solution(answer, *correction, given)
        elif self._checks_inputs and not np.isfinite(u).all():
            return Move(None, HELD)
        self.limits.hold(u)
        return Move(u, bounds_not_met(self.unmet, *self.given_up) if self.given_up else fault)

    def _relax(self, u: FloatArray, parameters: FloatArray, unmet: str) -> Move:
        """Return the move of the easier problem; where there is none clip ``u``."""
        self._solution = None
        easier = self.easier()
        if easier is not None:
            easier.unmet = unmet
            return easier.solve(parameters)
        self.limits.hold(u)
        return Move(u, bounds_not_met(unmet, CLIPPED))


class ParametricQP(_BoundedLaw):
    """A condensed problem, solved for one parameter vector after another.

    Parameters
    ----------
    problem : CondensedProblem
        What to solve.
    limits : InputLimits
        Input limits, held exactly.
    backend : Backend, optional
        The solver for active sets not seen before; default: PIQP.
    relaxation : Relaxation, optional
        What takes over where there is no solution; default: the inputs are clipped.

    Attributes
    ----------
    problem : CondensedProblem
        What is solved now.
    limits : InputLimits
        See above.
    """

    def __init__(
        self,
        problem: CondensedProblem,
        limits: InputLimits,
        backend: Backend | None = None,
        relaxation: Relaxation | None = None,
    ) -> None:
        super().__init__(limits, backend or PIQPBackend(), relaxation)
        self._active_sets: dict[ActiveSet, ActiveSet] = {}
        self.replace(problem)

    def replace(self, problem: CondensedProblem) -> None:
        """Take new matrices; active sets seen before stay the first guesses."""
        self._easier, self.problem = None, problem
        self._take(problem)
        cost_law = np.empty((0, problem.move_law.shape[1])) if problem.cost_law is None else problem.cost_law
        self._law = np.concatenate([problem.excess_law, problem.move_law, cost_law])
        self._rest = len(self._law) - len(cost_law)
        if problem.paid:  # so many rows that they are left until they are asked for
            self._law, self._paid = self._law[: self._rest].copy(), len(problem.paid[0])
            self._cost_law = np.vstack([cost_law, *problem.paid])
        self.hardly_matter = self.hardly_matter or problem.paid is not None
        self._gain, self._move_gain = problem.excess_gain, problem.move_gain
        self._laws: dict[ActiveSet, FloatArray | None] = {}
        self._is_ready = False

    def make_ready(self) -> None:
        """Set the solver up: the first step that asks it takes no longer than others."""
        if self._bounds and not self._is_ready:
            self._backend.load(self._gain)
        self._is_ready = True

    def solve(self, parameters: FloatArray) -> Move:
        """Return the optimal move, or the documented fallback with its reason.

        Parameters
        ----------
        parameters : array, shape (parameters,)
            The parameter vector p; its last entry is 1.
        """
        return self._move(np.dot(self._law, parameters), parameters, self._respect_bounds)

    def _respect_bounds(self, excess: FloatArray, u: FloatArray) -> Correction | None:
        """Correct the unconstrained optimum ``u`` in place."""
        if self._active and self._apply(self._active, excess, u):
            return self._active, None
        pattern = tuple(np.flatnonzero(excess > 0.0).tolist())
        guess = self._active_sets.get(pattern, pattern)
        if guess and self._apply(guess, excess, u):
            self._active = guess
            return guess, None
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
        if not max(answer[: self._bounds].tolist()) <= self._tolerance(excess):
            return False
        u += answer[self._bounds :]
        return True

    def _derive_law(self, active: ActiveSet) -> FloatArray | None:
        """Return the map from e_0 to (e inactive, -mu active; change of u), None if degenerate."""
        rows = list(active)
        # By orthogonal directions: the product of the gain with itself has the square of its condition.
        directions, triangular = np.linalg.qr(self._gain[rows].T)
        if len(triangular) < len(rows) or np.linalg.cond(triangular) > _LARGEST_CONDITION:
            return None
        inverse = np.linalg.inv(triangular)
        multipliers, towards = np.zeros((len(rows), self._bounds)), np.zeros((len(directions), self._bounds))
        multipliers[:, rows], towards[:, rows] = inverse @ inverse.T, directions @ inverse.T
        certificate = np.eye(self._bounds) - self._gain @ towards
        certificate[rows] = -multipliers / np.abs(multipliers).max()
        return np.vstack([certificate, -self._move_gain @ towards])

    def _ask_solver(self, excess: FloatArray, u: FloatArray, pattern: ActiveSet) -> Correction | None:
        """Solve, read off the active set, and prefer its exact law to the solver's digits."""
        self.make_ready()
        t, active, failure = self._backend.solve(excess)
        # Whatever the solver reports: a law that satisfies the optimality conditions is the optimum.
        for candidate in self._candidates(excess, active, failure):
            if candidate and self._apply(candidate, excess, u):
                self._active = candidate
                _make_room(self._active_sets)
                self._active_sets[pattern] = candidate
                return candidate, None
        if failure:
            return None
        u += self._move_gain @ t
        return active, t

    def _candidates(self, excess: FloatArray, active: ActiveSet, failure: str) -> Iterator[ActiveSet]:
        """Yield which bounds may be the active ones, given what the solver says."""
        yield active
        if failure or self.hardly_matter:
            yield least_distance(self._gain, excess - FEASIBLE)
        if self.hardly_matter:
            yield nearest_feasible(self._gain, excess, FEASIBLE)


def make_law(
    problem: Problem, data: FloatArray, limits: InputLimits, backend: Backend, online: OnlineData | None
) -> Law:
    """Return the law that solves a problem on recorded data M, or on data that follow the plant.

    Raises
    ------
    ConfigError
        The weights leave the optimum undetermined.
    """
    if online:
        condense(problem, data)  # weights that leave the optimum undetermined are refused here, not in a step
    law = _law(problem, online or factorise(data, problem.weights), limits, backend)
    if isinstance(law, ParametricQP):
        law.make_ready()
    return law


def _law(
    problem: Problem,
    data: RowFactor | OnlineData,
    limits: InputLimits,
    backend: Backend,
    before: tuple[ReducedProblem, Optimum] | None = None,
) -> _BoundedLaw:
    if isinstance(data, OnlineData):
        return AdaptiveQP(problem, data, limits, backend, Relaxation(problem, data))
    if before and problem.softened:  # the optimum without bounds stays what it was before they gave way
        reduced, optimum = before[0].softened(), before[1]
    else:
        reduced = reduce(problem, data)
        optimum = reduced.optimum()
    relaxation = Relaxation(problem, data, (reduced, optimum))
    return ParametricQP(reduced.condensed(optimum), limits, backend, relaxation)


def find_conflict(conflict_law: FloatArray, parameters: FloatArray) -> str:
    """Say how far a past is from what the recorded windows can combine to; empty if it is not."""
    size = float(np.abs(conflict_law @ parameters).max())
    if size <= _NO_CONFLICT:  # of what the recorded windows hold
        return ""
    if size <= _NO_CONFLICT * float((np.abs(conflict_law) @ np.abs(parameters)).max()):
        return ""
    return past_not_recorded(size)


def _make_room(store: dict[ActiveSet, Any]) -> None:
    if len(store) >= _REMEMBERED:
        del store[next(iter(store))]


class AdaptiveQP(_BoundedLaw):
    """A tracking problem, solved on the present data for one parameter vector after another.

    Parameters
    ----------
    problem : Problem
        The problem as printed.
    data : OnlineData
        What it meets; changed by its owner between solutions.
    limits : InputLimits
        Input limits, held exactly.
    backend : Backend
        The solver for active sets that the last one does not lead to.
    relaxation : Relaxation
        What takes over where there is no solution.
    """

    def __init__(
        self,
        problem: Problem,
        data: OnlineData,
        limits: InputLimits,
        backend: Backend,
        relaxation: Relaxation,
    ) -> None:
        super().__init__(limits, backend, relaxation)
        self._problem, self._data = problem, data
        self._adopt_factor()

    def solve(self, parameters: FloatArray) -> Move:
        """Return the optimal move, or the documented fallback with its reason.

        Parameters
        ----------
        parameters : array, shape (parameters,)
            The parameter vector p; its last entry is 1.
        """
        gram_factor = self._gram_factor()
        affine = np.dot(self._laws, parameters)
        triangular, w, cost = self._unconstrained_optimum(gram_factor, affine[: self._split], parameters)
        answer = affine[self._split :] + np.dot(self._gains, w)
        answer[self._rest] = math.sqrt(max(cost, 0.0))
        if self._paid:  # what is paid can make it negative
            answer[self._rest + 1 :] = min(cost, 0.0), 1.0
        return self._move(answer, parameters, partial(self._respect_bounds, triangular))

    def _gram_factor(self) -> FloatArray:
        """Return L, in new coordinates where K has become singular in the old ones."""
        if self._factor is not self._data.factor:
            self._adopt_factor()
        factor, info = scipy.linalg.lapack.dpotrf(self._data.gram, lower=1)
        diagonal = factor.diagonal().tolist()
        if info or not min(diagonal) > _SINGULAR * max(diagonal):
            self._data.renew()
            self._adopt_factor()
            return self._data.gram  # the identity, its own factor
        return np.asarray(factor)

    def _adopt_factor(self) -> None:
        """Eliminate the equalities in the coordinates of the data's factor."""
        self._factor = self._data.factor
        reduced = self._reduced = reduce(self._problem, self._factor)
        rank, size = reduced.g_costs[0].gain.shape
        terms = len(reduced.g_costs)
        self._take(reduced)
        self._split = size + terms * rank
        linear = reduced.residual.T @ reduced.offset
        self._paid = int(len(reduced.prices) > 0)
        self.hardly_matter = self.hardly_matter or self._paid > 0
        if self._paid:
            linear = linear + reduced.slope
        self._offset = np.asarray(np.linalg.qr(reduced.offset, mode="r"))
        g_laws = [cost.law for cost in reduced.g_costs]
        cost_rows = 1 + 2 * self._paid
        no_law, no_gain = (np.zeros((cost_rows, width)) for width in (linear.shape[1], size))
        self._laws = np.vstack([linear, *g_laws, reduced.excess_law, reduced.move_law, no_law])
        self._gains = np.vstack([reduced.excess_gain, reduced.move_gain, no_gain])
        self._rest = len(self._gains) - cost_rows
        self._curvature = reduced.residual.T @ reduced.residual
        # The costs of g, side by side: one triangular solution serves them all.
        self._roots = np.sqrt(
            np.hstack([np.tile(cost.weights[:, np.newaxis], size + 1) for cost in reduced.g_costs])
        )
        self._weighted = np.zeros((rank, terms * (size + 1)), order="F")
        for place, cost in zip(self._places_of_costs(), reduced.g_costs, strict=True):
            self._weighted[:, place][:, :size] = cost.gain

    def _unconstrained_optimum(
        self, gram_factor: FloatArray, affine: FloatArray, parameters: FloatArray
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return R, ``R'R`` being the curvature of the cost, the optimum w, and the cost there."""
        size = len(self._curvature)
        weighted = self._weighted
        weighted[:, size :: size + 1] = affine[size:].reshape(-1, len(weighted)).T
        deviation = scipy.linalg.blas.dtrsm(1.0, gram_factor, weighted, lower=1)
        deviation *= self._roots
        if weighted.shape[1] > size + 1:
            deviation = np.vstack([deviation[:, place] for place in self._places_of_costs()])
        products = scipy.linalg.blas.dsyrk(1.0, deviation, trans=1)
        triangular, info = scipy.linalg.lapack.dpotrf(self._curvature + products[:size, :size])
        diagonal = triangular.diagonal().tolist()
        if info or (size and min(diagonal) < _ILL_CONDITIONED * max(diagonal)):
            return self._optimum_by_roots(deviation, parameters)
        slope = affine[:size] + products[:size, size]
        w = -scipy.linalg.lapack.dpotrs(triangular, slope)[0]
        offset = np.dot(self._offset, parameters)
        cost = float(offset @ offset + products[size, size] + slope @ w)
        return triangular, w, cost + self._paid_at_no_w(parameters)

    def _places_of_costs(self) -> list[slice]:
        """Return where each part of what g costs stands, its gain and its value."""
        width = len(self._curvature) + 1
        return [slice(start, start + width) for start in range(0, len(self._reduced.g_costs) * width, width)]

    def _optimum_by_roots(
        self, deviation: FloatArray, parameters: FloatArray
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return the same without squaring the condition: slower, for weights that are far apart."""
        size = len(self._curvature)
        offset = np.dot(self._reduced.offset, parameters)[:, np.newaxis]
        stacked = np.vstack([np.hstack([self._reduced.residual, offset]), deviation])
        factor = np.asarray(np.linalg.qr(stacked, mode="r"))
        triangular = np.asfortranarray(factor[:size, :size])
        root, left = factor[:size, size], factor[size:, size]
        cost = float(left @ left)
        if self._paid:  # the square is completed
            drawn = scipy.linalg.lapack.dtrtrs(triangular, self._reduced.slope @ parameters, trans=1)[0]
            cost += self._paid_at_no_w(parameters) - float(drawn @ (drawn + 2.0 * root))
            root = root + drawn
        return triangular, -scipy.linalg.lapack.dtrtrs(triangular, root)[0], cost

    def _paid_at_no_w(self, parameters: FloatArray) -> float:
        """Return what is paid besides for w."""
        reduced = self._reduced
        if not self._paid:
            return 0.0
        return float((reduced.prices @ parameters) @ (reduced.amount_law @ parameters))

    def _respect_bounds(self, triangular: FloatArray, excess: FloatArray, u: FloatArray) -> Correction | None:
        """Correct the unconstrained optimum ``u`` in place; t = R (w - optimum) is the deviation."""
        gains = scipy.linalg.blas.dtrsm(1.0, triangular, self._gains, side=1)
        gain = np.concatenate([gains[: self._bounds], self._reduced.relief], axis=1)
        move_gain = gains[self._bounds : self._rest]
        self._gain = gain
        t = self._deviation(gain, excess)
        if t is None:
            self._backend.load(gain)
            t, active, failure = self._backend.solve(excess)
            # Whatever the solver reports: a point that satisfies the optimality conditions is the optimum.
            exact = _certified(gain, excess, active, self._tolerance(excess))
            if exact is None and self.hardly_matter:
                active = nearest_feasible(gain, excess, FEASIBLE) or active
                exact = _certified(gain, excess, active, self._tolerance(excess))
            if failure and exact is None:
                return None
            t, self._active = (t if exact is None else exact), active
        u += move_gain @ t[: move_gain.shape[1]]
        return self._active, t

    def _deviation(self, gain: FloatArray, excess: FloatArray) -> FloatArray | None:
        """Try the last active set, and then the bounds that are exceeded."""
        for active in (self._active, tuple(np.flatnonzero(excess > 0.0).tolist())):
            t = _certified(gain, excess, active, self._tolerance(excess))
            if t is not None:
                self._active = active
                return t
        return None


def _certified(
    gain: FloatArray, excess: FloatArray, active: ActiveSet, tolerance: float
) -> FloatArray | None:
    """Return the optimum on an active set where it proves to be that of the problem, None otherwise."""
    if not active:
        return None
    rows = gain[list(active)]
    factor, info = scipy.linalg.lapack.dpotrf(rows @ rows.T)
    if info:
        return None
    multipliers = scipy.linalg.lapack.dpotrs(factor, excess[list(active)])[0]
    if not min(multipliers.tolist()) >= 0.0:
        return None
    t = -(multipliers @ rows)
    beyond = max((excess + gain @ t).tolist())
    return np.asarray(t) if beyond <= tolerance else None
