"""Problems over all entries of g, for a regulariser that leaves no condensed form: the 1-norm.

Slow: the cost of a step grows with the length of the recording.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from ddpc_controllers.optimisation.backends import SparseQP
from ddpc_controllers.optimisation.condensing import ReducedProblem, factorise, reduce
from ddpc_controllers.optimisation.limits import HELD, LAST_HELD, InputLimits, bounds_not_met, unmet_bounds
from ddpc_controllers.optimisation.problem import Problem
from ddpc_controllers.optimisation.qp import Move, StepInfo, ends_info
from ddpc_cosim import FloatArray

_TOLERANCE, _RELAXED = 1e-9, 1e-7
"""Tolerances in a closed loop; the problem is too degenerate for the tightest one."""


class UncondensedLaw:
    """A problem with ``weight |g|_1`` in its cost, solved for one parameter vector after another.

    Parameters
    ----------
    problem : Problem
        The problem as printed; what it says of g is left aside.
    weight : float
        Weight of the 1-norm.
    data : array, shape (rows, columns)
        The stacked Hankel matrices M.
    limits : InputLimits
        Input limits, held exactly.
    """

    def __init__(self, problem: Problem, weight: float, data: FloatArray, limits: InputLimits) -> None:
        self._problem, self._weight, self._data, self._limits = problem, weight, data, limits
        self._qp: SparseQP | None = self._set_up()
        self._easier: UncondensedLaw | None = None
        self._unmet = ""

    def info(self, ends: Sequence[str], predicted: FloatArray, unit: FloatArray) -> StepInfo:
        """Return the predicted end of the horizon; cost and active bounds are not read off the solver."""
        return StepInfo(ends_info, (ends, predicted, unit))

    def solve(self, parameters: FloatArray) -> Move:
        """Return the optimal move, or why the last inputs are to be held.

        Parameters
        ----------
        parameters : array, shape (parameters,)
            The parameter vector p; its last entry is 1.
        """
        if not np.isfinite(parameters).all():
            return Move(None, HELD)
        qp = self._qp = self._qp or self._set_up()
        target = self._problem.cost[1] @ parameters
        qp.right["misfit"][:] = target[self._misfits] / self._sizes
        qp.linear["x"][:] = -2.0 * target[~self._misfits] @ self._residual
        qp.linear["x"][:] += parameters @ self._problem.paid[:, self._past :]
        if self._limits_move:
            for name, (lower, upper) in self._limits_at(parameters, len(qp.lower["x"])).items():
                qp.lower[name][:], qp.upper[name][:] = lower, upper
            qp.move_limits()
        qp.right["equality"][:] = self._problem.equality[1] @ parameters
        solution, failure = qp.solve()
        if failure:
            return self._relax(parameters)
        u = self._problem.wanted[:, self._past :] @ solution["x"]
        self._limits.hold(u)
        return Move(u, bounds_not_met(self._unmet, *self._problem.given_up) if self._unmet else "")

    def _relax(self, parameters: FloatArray) -> Move:
        """Return the move of the easier problem; where there is none hold the last inputs."""
        problem, easier = self._problem, self._easier
        unmet = self._unmet
        if not unmet:  # whatever g costs, what it can reach is the same
            reduced = self._reduced
            unmet = unmet_bounds(reduced.excess_gain, reduced.excess_law @ parameters, reduced.labels)
        relaxed = problem.relaxed() if easier is None else None
        if relaxed is not None:
            easier = UncondensedLaw(relaxed, self._weight, self._data, self._limits)
        if easier is None:
            return Move(None, bounds_not_met(unmet, LAST_HELD))
        self._easier, easier._unmet = easier, unmet
        return easier.solve(parameters)

    @cached_property
    def _reduced(self) -> ReducedProblem:
        return reduce(self._problem, factorise(self._data, [(self._problem.row_count, 1.0)]))

    def _set_up(self) -> SparseQP:
        """Write the problem in ``g = g+ - g-``, the variables x below the past, and differences of these.

        The past is M g itself. What it misses in the cost becomes a variable: its large weights in the
        linear cost of others would take the digits of the solver.
        """
        problem, data = self._problem, np.hstack([self._data, -self._data])
        past = self._past = problem.row_count - problem.rows["u"] - problem.rows["y"]
        (cost, _), (equality, _), bounds = problem.cost, problem.equality, problem.bounded
        bounded, self._lower, self._upper = bounds.rows, bounds.lower, bounds.upper
        self._limits_move = bool(self._lower[:, :-1].any() or self._upper[:, :-1].any())

        def split(rows: FloatArray) -> dict[str, FloatArray]:
            return {"g": rows[:, :past] @ data[:past], "x": rows[:, past:]}

        self._misfits = cost[:, :past].any(axis=1)
        misfit, self._residual = cost[self._misfits], cost[~self._misfits, past:]
        self._sizes = np.linalg.norm(misfit, axis=1)
        weights = problem.excess_weights if problem.softened else np.zeros(len(bounded))
        excess = np.eye(len(bounded))[:, weights > 0.0]
        alone = self._alone = (np.count_nonzero(bounded, axis=1) == 1) & (weights == 0.0)
        self._variables = bounded[alone].argmax(axis=1) - past
        sizes = {
            "g": data.shape[1],
            "x": cost.shape[1] - past,
            "excess": excess.shape[1],
            "misfit": len(misfit),
            "difference": np.count_nonzero(~alone),
        }
        equalities = {
            "data": {"g": data[past:], "x": -np.eye(len(data) - past, sizes["x"])},
            "misfit": split(misfit / self._sizes[:, np.newaxis]) | {"misfit": -np.eye(sizes["misfit"])},
            "equality": split(equality),
            "difference": split(bounded[~alone])
            | {"difference": -np.eye(sizes["difference"]), "excess": -excess[~alone]},
        }
        half_hessian = {
            ("x", "x"): self._residual.T @ self._residual,
            ("excess", "excess"): np.diag(weights[weights > 0.0]),
            ("misfit", "misfit"): np.diag(self._sizes**2),
        }
        one = np.zeros(self._lower.shape[1])
        one[-1] = 1.0
        limits = {
            "g": (np.zeros(sizes["g"]), np.full(sizes["g"], np.inf)),
            **self._limits_at(one, sizes["x"]),
        }
        qp = SparseQP(sizes, half_hessian, equalities, limits, _TOLERANCE, _RELAXED)
        qp.linear["g"][:] = self._weight
        return qp

    def _limits_at(self, parameters: FloatArray, variables: int) -> dict[str, tuple[FloatArray, FloatArray]]:
        """Return the limits of the variables x, and of differences of them."""
        lower, upper = self._lower @ parameters, self._upper @ parameters
        low, high = np.full(variables, -np.inf), np.full(variables, np.inf)
        np.maximum.at(low, self._variables, lower[self._alone])
        np.minimum.at(high, self._variables, upper[self._alone])
        return {"x": (low, high), "difference": (lower[~self._alone], upper[~self._alone])}

    def __getstate__(self) -> dict[str, Any]:
        """Leave the solver's workspace behind: it is set up again when it is needed."""
        return {**self.__dict__, "_qp": None}
