"""From a data-driven tracking problem as printed to the few variables that matter online.

With a rank-revealing factorisation ``M = B V'`` of the stacked data and ``g = V v``, the data rows are
``h = B v`` and ``|g| = |v|``: the length of the recording is gone, nothing is inverted, and data without full
row rank (noise-free, lifted) are not a special case. What remains is, p being the parameters,

    minimise |G z - T p|^2 + |v - v_s|_W^2 + |v_s|_U^2   subject to   E z = E_p p,   lower <= C z <= upper,

with ``z = (v, other variables)`` and v_s, affine in the other variables and p, what g is drawn to, or zero.
The equalities are eliminated through a null space that reveals their rank,
``z = particular p + null_space w``. A triangular factor of what is left of the cost measures the distance t
from the unconstrained optimum in units of the cost, and so

    minimise |t|^2   subject to   e_0(p) + L t <= 0

is left of the problem, ``e`` being by how much each bound is exceeded in parts of its range. Limits that
move with time are parameters: they change ``e_0(p)`` alone. Bounds that give way at a cost of ``c s^2`` for
being exceeded by s do not move the optimum without bounds, where s = 0; t has ``sqrt(c) s`` besides.

Prices q, parameters too, of amounts ``a = A z`` add ``q' a`` to the cost. With ``t_0 = R w + P p`` the
distance without them, R triangular, it is completed to a square,

    |t_0|^2 + q' A N w = |t_0 + h|^2 - ...,   h = R^-T (A N)' q / 2,

and so prices move the unconstrained optimum, which stays affine in p, and nothing else. They have no
curvature: R, of the squares alone, must be regular.

The factor is block lower triangular where g costs differently block by block: each block of v belongs to a
block of rows, what of them the rows above do not determine.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy  # whose parts are imported when they are first used
from numpy.typing import NDArray

from ddpc_controllers.optimisation.problem import Limits, Problem
from ddpc_cosim import ConfigError, FloatArray

_EQUALITY_TOLERANCE = 1e-10
"""An equality that others repeat to within this fraction is redundant."""

_INSIGNIFICANT = 1e-12
_ROUNDING_COSTS = 1e-8
_SAME_DIRECTION = 1e-14


@dataclass(frozen=True, slots=True)
class RowFactor:
    """Stacked data in as few coordinates as they have independent rows.

    Parameters
    ----------
    basis : array, shape (rows, rank)
        B, of full column rank.
    weights : array, shape (rank,)
        Weight of the square of each coordinate.
    blocks : array of int, shape (rank,)
        Number of the block of rows that adds each coordinate to those of the blocks above.
    """

    basis: FloatArray
    weights: FloatArray
    blocks: NDArray[np.intp]


def factorise(data: FloatArray, weights: Sequence[tuple[int, float]]) -> RowFactor:
    """Factorise the stacked data, shape (rows, columns), block by block.

    One block weighs ``|g|^2``. With the predicted outputs as a last block of their own and no weight on the
    rest it is ``|(I - Pi) g|^2``, Pi projecting on the rows that the outputs are predicted from (F. Doerfler,
    J. Coulson, I. Markovsky, doi:10.1109/TAC.2022.3148374, arXiv:2101.01273).

    Parameters
    ----------
    data : array, shape (rows, columns)
        M.
    weights : sequence of (int, float)
        Rows in each block, from the top, and the weight of its coordinates; an infinite one keeps them at
        zero.
    """
    sizes, values = zip(*weights, strict=True)
    basis, ranks = _block_triangular(data, sizes)
    block = np.repeat(np.arange(len(ranks)), ranks)
    weight = np.array(values)[block]
    kept = np.isfinite(weight)
    return RowFactor(basis[:, kept], weight[kept], block[kept])


def _block_triangular(data: FloatArray, sizes: tuple[int, ...]) -> tuple[FloatArray, list[int]]:
    """Return B and the number of its columns that each block of rows adds."""
    basis, significant = _row_space_factor(data)
    if len(sizes) == 1:
        return basis, [basis.shape[1]]
    size = basis.shape[1]
    rows, known, ranks = basis, np.zeros((size, 0)), []
    for block in np.split(rows, np.cumsum(sizes)[:-1]):
        new = block.T - known @ (known.T @ block.T)
        new -= known @ (known.T @ new)  # once more: twice is enough for orthogonality to rounding
        directions, factor, _ = scipy.linalg.qr(new, mode="economic", pivoting=True, check_finite=False)
        rank = int(np.count_nonzero(np.abs(factor.diagonal()) > significant))
        known = np.hstack([known, directions[:, :rank]])
        ranks.append(rank)
    return basis @ known, ranks


def _row_space_factor(data: FloatArray) -> tuple[FloatArray, float]:
    """Return B with as many columns as M has independent rows, and what counted as significant."""
    factor, order = scipy.linalg.qr(data.T, mode="r", pivoting=True, check_finite=False)
    diagonal = np.abs(factor.diagonal())
    significant = float(np.finfo(float).eps * max(data.shape) * diagonal[0])
    rank = int(np.count_nonzero(diagonal > significant))
    basis = np.empty((len(data), rank))
    basis[order] = factor[:rank].T
    return basis, significant


@dataclass(frozen=True, slots=True)
class CondensedProblem:
    """Minimise ``|t|^2`` subject to ``excess_law @ p + excess_gain @ t <= 0``.

    Parameters
    ----------
    excess_law : array, shape (n, parameters)
        By how much each bound is exceeded at the unconstrained optimum, in parts of the bound's range.
    excess_gain : array, shape (n, k)
        How the deviation t changes that.
    move_law, move_gain : arrays, shapes (m, parameters) and (m, k)
        The inputs to apply now, likewise, in their units; after them whatever else is asked for.
    conflict_law : array, shape (c, parameters)
        What must vanish: the part of the past that no combination of the recorded windows has, in parts of
        what they hold.
    labels : tuple of str
        What each bound is called; empty where no message needs it.
    cost_law : array, shape (r, parameters), or None
        The cost of the problem as printed is ``|cost_law @ p|^2 + |t|^2``, and what is paid.
    paid : (array, array), shapes (c, parameters)
        Prices and the amounts of them at the unconstrained optimum: their products are paid.
    """

    excess_law: FloatArray
    excess_gain: FloatArray
    move_law: FloatArray
    move_gain: FloatArray
    conflict_law: FloatArray
    labels: tuple[str, ...] = ()
    cost_law: FloatArray | None = None
    paid: tuple[FloatArray, FloatArray] | None = None


class Coordinates(NamedTuple):
    """A cost of coordinates v of a combination: ``|gain w + law p|_weights^2``.

    Parameters
    ----------
    gain, law : arrays, shapes (rank, k) and (rank, parameters)
        The coordinates.
    weights : array, shape (rank,)
        Weight of the square of each.
    """

    gain: FloatArray
    law: FloatArray
    weights: FloatArray


class Optimum(NamedTuple):
    """The optimum without bounds and what is near it: ``w = law p + gain t``, t in units of the cost.

    Parameters
    ----------
    law, gain : arrays, shapes (k, parameters) and (k, k)
        The free variables.
    cost_law : array, shape (r, parameters)
        The cost there is ``|cost_law p|^2``, and what is paid.
    """

    law: FloatArray
    gain: FloatArray
    cost_law: FloatArray


class Bounds(NamedTuple):
    """All bounds of a problem without its equalities, those included that others make redundant.

    Parameters
    ----------
    law, gain : arrays, shapes (n, parameters) and (n, k)
        By how much each is exceeded, in parts of its range.
    relief, weights : arrays, shapes (n, s) and (s,)
        How that changes with what those that can give way are exceeded by, and the weights of its squares.
    labels : tuple of str
        What they are called.
    """

    law: FloatArray
    gain: FloatArray
    relief: FloatArray
    weights: FloatArray
    labels: tuple[str, ...]

    def tightest(self, *, softened: bool) -> dict[str, Any]:
        """Return what a :class:`ReducedProblem` has of them; softened: those that can give way do."""
        relief = self.relief if softened else self.relief[:, :0]
        kept = _tightest(self.law, np.concatenate([self.gain, relief], axis=1))
        return {
            "excess_law": self.law[kept],
            "excess_gain": self.gain[kept],
            "relief": relief[kept] / np.sqrt(self.weights[: relief.shape[1]]),
            "labels": tuple(self.labels[i] for i in kept.tolist()),
        }


@dataclass(frozen=True, slots=True)
class ReducedProblem:
    """A tracking problem without its equalities, in the free variables w.

    The cost is ``|residual w + offset p|^2`` and that of g; everything else is affine in (p, w) too.

    Parameters
    ----------
    residual, offset : arrays, shapes (r, k) and (r, parameters)
        The tracking cost.
    g_costs : tuple of Coordinates
        What g costs: the coordinates v, less where they are drawn to; and where there is such, that too.
    excess_gain, excess_law : arrays, shapes (n, k) and (n, parameters)
        By how much each bound is exceeded, in parts of its range.
    move_gain, move_law : arrays, shapes (m, k) and (m, parameters)
        The inputs to apply now.
    conflict_law, labels
        See :class:`CondensedProblem`.
    prices : array, shape (c, parameters)
        Which parameters are prices.
    amount_gain, amount_law : arrays, shapes (c, k) and (c, parameters)
        What is paid for at each of them.
    advice : str
        What keeps the optimum determined, where that is not plain.
    of_past : array of bool, shape (rank,)
        Coordinates v that only add to what is given, where that is a block of its own without a weight.
    bounds : Bounds
        All bounds, of which these are the tightest.
    relief : array, shape (n, s)
        How the excess changes where bounds give way, by so much that it costs 1.
    """

    residual: FloatArray
    offset: FloatArray
    g_costs: tuple[Coordinates, ...]
    excess_gain: FloatArray
    excess_law: FloatArray
    move_gain: FloatArray
    move_law: FloatArray
    conflict_law: FloatArray
    labels: tuple[str, ...]
    prices: FloatArray
    amount_gain: FloatArray
    amount_law: FloatArray
    advice: str
    of_past: NDArray[np.bool_]
    bounds: Bounds
    relief: FloatArray

    @property
    def slope(self) -> FloatArray:
        """Half of the slope of what is paid over w, shape (k, parameters)."""
        return np.asarray(self.amount_gain.T @ self.prices / 2.0)

    def softened(self) -> "ReducedProblem":
        """Return the same with bounds that give way at a cost, which leaves the optimum without bounds."""
        return replace(self, **self.bounds.tightest(softened=True))

    def condensed(self, optimum: Optimum) -> CondensedProblem:
        """Eliminate the optimum without bounds."""
        law, gain, cost_law = optimum
        no_relief = np.zeros((len(self.move_gain), self.relief.shape[1]))
        return CondensedProblem(
            self.excess_law + self.excess_gain @ law,
            np.concatenate([self.excess_gain @ gain, self.relief], axis=1),
            self.move_law + self.move_gain @ law,
            np.concatenate([self.move_gain @ gain, no_relief], axis=1),
            self.conflict_law,
            self.labels,
            cost_law,
            (self.prices, self.amount_law + self.amount_gain @ law) if len(self.prices) else None,
        )

    def optimum(self, least: float = 0.0) -> Optimum:
        """Return the optimum without bounds.

        ``least`` is the root of the weight of what only adds to the past.

        Raises
        ------
        ConfigError
            The weights leave it undetermined.
        """
        roots = [np.sqrt(cost.weights)[:, np.newaxis] for cost in self.g_costs]
        roots[0][self.of_past] = np.maximum(roots[0][self.of_past], least)
        size = self.residual.shape[1]
        # Factorised side by side: R and Q' offset, without Q.
        terms = [np.concatenate([self.residual, self.offset], axis=1)]
        for root, v in zip(roots, self.g_costs, strict=True):
            terms.append(root * np.concatenate([v.gain, v.law], axis=1))
        factor = np.asarray(np.linalg.qr(np.concatenate(terms), mode="r"))
        if size == 0:
            return Optimum(np.zeros((0, factor.shape[1])), np.zeros((0, 0)), factor)
        factor, left = factor[:size], factor[size:, size:]
        triangular, projected = factor[:, :size], factor[:, size:]
        diagonal = np.abs(triangular.diagonal())
        if len(triangular) < size or diagonal.min() <= _INSIGNIFICANT * diagonal.max():
            ratio = 0.0 if len(triangular) < size else diagonal.min() / diagonal.max()
            if not least and self.of_past.any():
                # Data without noise: some of their past is rounding alone, and no condition fixes it.
                return self.optimum(_ROUNDING_COSTS * float(diagonal.max()))
            raise ConfigError(
                f"the weights leave the optimum undetermined ({size} directions, the weakest with "
                f"{ratio:.1e} of the strongest's root of a curvature): make them positive and alike in "
                "size, or do without the artificial setpoint where several leave the outputs the same"
                + self.advice
            )
        # Not solve_triangular: its LAPACK routine starts threads even for a handful of rows.
        gain = scipy.linalg.blas.dtrsm(1.0, triangular, np.eye(size), side=1)
        if len(self.prices):
            drawn = gain.T @ self.slope
            projected, left = projected + drawn, np.vstack([left, drawn])
        return Optimum(-gain @ projected, gain, left)


def condense(problem: Problem, data: FloatArray) -> CondensedProblem:
    """Eliminate everything but the deviation t.

    Parameters
    ----------
    problem : Problem
        The problem as printed.
    data : array, shape (rows, columns)
        The stacked Hankel matrices M.

    Raises
    ------
    ConfigError
        The weights leave the optimum undetermined.
    """
    reduced = reduce(problem, factorise(data, problem.weights))
    return reduced.condensed(reduced.optimum())


def reduce(problem: Problem, factor: RowFactor) -> ReducedProblem:
    """Eliminate the equalities in the coordinates of a factor of the data."""
    basis, rows = factor.basis, problem.row_count
    (cost, target), (equality, equality_target) = problem.cost, problem.equality
    limits, prices = problem.bounded, np.flatnonzero(problem.paid.any(axis=1))
    # From rows over (h, other variables) to rows over z = (v, other variables).
    of_z = [
        np.concatenate([part[:, :rows] @ basis, part[:, rows:]], axis=1)
        for part in (equality, cost, limits.rows, problem.wanted, problem.paid[prices])
    ]
    particular, null_space, conflict = _eliminate(of_z[0], equality_target)
    (offset, residual), (law, gain), (move_law, move_gain), (amount_law, amount_gain) = (
        (part @ particular, part @ null_space) for part in of_z[1:]
    )
    rank = basis.shape[1]
    g_costs = [Coordinates(null_space[:rank], particular[:rank], factor.weights)]
    drawn_to_x, drawn_to_p = problem.origin
    if drawn_to_x.any() or drawn_to_p.any():  # v_s = B^+ h_s is the smallest combination with the rows h_s
        drawn_to = np.linalg.lstsq(basis, np.hstack([drawn_to_x[:, rows:], drawn_to_p]))[0]
        others, constant = np.split(drawn_to, [drawn_to_x.shape[1] - rows], axis=1)
        about, drawn = others @ null_space[rank:], others @ particular[rank:] + constant
        g_costs = [
            Coordinates(g_costs[0].gain - about, g_costs[0].law - drawn, factor.weights),
            Coordinates(about, drawn, np.array(problem.origin_weights)[factor.blocks]),
        ]
    given = rows - problem.rows["u"] - problem.rows["y"]
    weights = problem.excess_weights
    relief = -np.eye(len(weights))[:, weights > 0.0]
    law, changes = _excess(law, np.concatenate([gain, relief], axis=1), limits)
    size = gain.shape[1]
    bounds = Bounds(law, changes[:, :size], changes[:, size:], weights[weights > 0.0], problem.labels)
    return ReducedProblem(
        residual=residual,
        offset=offset - target,
        g_costs=tuple(g_costs),
        move_law=move_law,
        move_gain=move_gain,
        conflict_law=conflict,
        prices=np.eye(particular.shape[1])[prices],
        amount_gain=amount_gain,
        amount_law=amount_law,
        advice=problem.advice,
        of_past=(factor.blocks == 0) & (factor.weights == 0.0) & (problem.weights[0][0] == given),
        bounds=bounds,
        **bounds.tightest(softened=problem.softened),
    )


def _excess(law: FloatArray, gain: FloatArray, limits: Limits) -> tuple[FloatArray, FloatArray]:
    """Turn ``lower p <= law p + gain w <= upper p`` into normalised rows that must not be positive."""
    _, lower, upper, span = limits
    above, below = np.isfinite(upper[:, -1]), np.isfinite(lower[:, -1])  # the last parameter is 1
    size = np.where(np.isfinite(span) & (span > 0.0), span, 1.0)
    scale = np.concatenate([size[above], size[below]])[:, np.newaxis]
    law = np.concatenate([law[above] - upper[above], lower[below] - law[below]])
    return law / scale, np.concatenate([gain[above], -gain[below]]) / scale


def _eliminate(equality: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve ``E z = E_p p`` by ``z = particular p + null_space w``; return also what p must satisfy."""
    scale = np.linalg.norm(equality, axis=1, keepdims=True)
    scale[scale == 0.0] = 1.0
    left, values, right = np.linalg.svd(equality / scale)
    rank = int(np.count_nonzero(values > _EQUALITY_TOLERANCE * values[:1]))
    rotated = left.T @ (target / scale)
    particular = right[:rank].T @ (rotated[:rank] / values[:rank, np.newaxis])
    conflict = rotated[rank:]
    if not conflict.size:
        return particular, right[rank:].T, conflict
    # In parts of each parameter's column: parameters have units of their own.
    size = np.linalg.norm(rotated, axis=0)
    size[size == 0.0] = 1.0
    significant = np.linalg.norm(conflict / size, axis=1) > _INSIGNIFICANT
    return particular, right[rank:].T, conflict[significant]


def _tightest(law: FloatArray, gain: FloatArray) -> NDArray[np.intp]:
    """Of rows that bound the same quantity, keep the tightest; return the numbers of those kept."""
    rows = np.concatenate([law[:, :-1], gain], axis=1)
    size, number = np.linalg.norm(rows, axis=1), np.arange(len(rows))
    size[size == 0.0] = 1.0
    rows /= size[:, np.newaxis]
    same = rows @ rows.T > 1.0 - _SAME_DIRECTION
    if np.count_nonzero(same) == np.count_nonzero(same.diagonal()):
        return number
    limits = law[:, -1] / size
    # The terminal condition makes bounds equal but for rounding: the first of the tightest is kept. If each
    # were compared with each, all of them could have one that is tighter, or as tight and earlier.
    tightest = np.where(same, limits, -np.inf).max(axis=1, initial=-np.inf)
    as_tight = limits >= tightest - _SAME_DIRECTION * np.abs(tightest)
    earlier = number < number[:, np.newaxis]
    return np.flatnonzero(as_tight & ~np.any(same & as_tight & earlier, axis=1)).astype(np.intp)
