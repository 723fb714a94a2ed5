"""From a data-driven tracking problem as printed to the few variables that matter online.

With a rank-revealing orthogonal factorisation ``M = B V'`` of the stacked data and ``g = V v``, the data
rows are ``h = B v`` and ``|g| = |v|``: the length of the recording is gone, nothing is inverted, and data
without full row rank (noise-free, lifted) are no special case. What remains is, p being the parameters,

    minimise |G z - T p|^2   subject to   E z = E_p p,   lower <= C z <= upper,   z = (v, setpoints).

The equalities are eliminated through a null space that reveals their rank. A triangular factor of what is
left of G measures the distance t from the unconstrained optimum in units of the cost, and so

    minimise |t|^2   subject to   e_0(p) + L t <= 0

is left of the problem, ``e`` being by how much each bound is exceeded in parts of its range.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr
from scipy.linalg.blas import dtrsm

from ddpc_cosim import ConfigError, FloatArray

EQUALITY_TOLERANCE = 1e-10
"""An equality that others repeat to within this fraction is redundant."""

_INSIGNIFICANT = 1e-12
_SAME_DIRECTION = 1e-14


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
        The inputs to apply now, likewise, in their units.
    conflict_law : array, shape (c, parameters)
        What must vanish: the part of the past that no combination of the recorded windows has.
    """

    excess_law: FloatArray
    excess_gain: FloatArray
    move_law: FloatArray
    move_gain: FloatArray
    conflict_law: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Condenser:
    """A tracking problem over (h, setpoints), ready to meet its data.

    Parameters
    ----------
    row_count : int
        Number of data rows h.
    regularisation : float
        Weight of |g|^2.
    residual, target : arrays, shapes (r, variables) and (r, parameters)
        The cost ``|residual @ x - target @ p|^2``.
    equality, equality_target : arrays, shapes (e, variables) and (e, parameters)
        ``equality @ x = equality_target @ p``.
    bounded : array, shape (b, variables)
        The quantities with limits.
    lower, upper : array, shape (b,)
        The limits, infinite where there is none.
    move : array, shape (m, variables)
        The inputs to apply now.
    """

    row_count: int
    regularisation: float
    residual: FloatArray
    target: FloatArray
    equality: FloatArray
    equality_target: FloatArray
    bounded: FloatArray
    lower: FloatArray
    upper: FloatArray
    move: FloatArray

    def condense(self, data: FloatArray) -> CondensedProblem:
        """Eliminate everything but the deviation t.

        Parameters
        ----------
        data : array, shape (row_count, columns)
            The stacked Hankel matrices M.

        Raises
        ------
        ConfigError
            The weights leave the optimum undetermined.
        """
        basis = _row_space_factor(data)
        equality = self._in_z(self.equality, basis)
        particular, null_space, conflict = _eliminate(equality, self.equality_target)
        law, gain = self._unconstrained_optimum(basis, particular, null_space)

        bounded, move = self._in_z(self.bounded, basis), self._in_z(self.move, basis)
        excess_law, excess_gain = self._excess(bounded @ law, bounded @ gain)
        return CondensedProblem(excess_law, excess_gain, move @ law, move @ gain, conflict)

    def _in_z(self, matrix: FloatArray, basis: FloatArray) -> FloatArray:
        """Rewrite rows over (h, setpoints) as rows over z = (v, setpoints)."""
        return np.hstack([matrix[:, : self.row_count] @ basis, matrix[:, self.row_count :]])

    def _unconstrained_optimum(
        self, basis: FloatArray, particular: FloatArray, null_space: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return ``z = law p + gain t`` such that the cost is |t|^2 and a constant."""
        ridge = np.zeros((basis.shape[1], len(particular)))
        np.fill_diagonal(ridge, np.sqrt(self.regularisation))
        residual = np.vstack([self._in_z(self.residual, basis), ridge])
        offset = residual @ particular
        offset[: len(self.target)] -= self.target

        size = null_space.shape[1]
        if size == 0:
            return particular, null_space
        # Factorised side by side: R and Q' offset, without Q.
        factor = np.asarray(np.linalg.qr(np.hstack([residual @ null_space, offset]), mode="r"))[:size]
        triangular, projected = factor[:, :size], factor[:, size:]
        diagonal = np.abs(np.diag(triangular))
        if diagonal.min() <= _INSIGNIFICANT * diagonal.max():
            raise ConfigError("the weights leave the optimum undetermined: make them positive")
        # Not solve_triangular: its LAPACK routine starts threads even for a handful of rows.
        gain = dtrsm(1.0, triangular, null_space, side=1)  # null_space R^-1
        return particular - gain @ projected, gain

    def _excess(self, law: FloatArray, gain: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Turn ``lower <= law p + gain t <= upper`` into normalised rows that must not be positive."""
        above, below = np.isfinite(self.upper), np.isfinite(self.lower)
        span = self.upper - self.lower
        size = np.where(np.isfinite(span) & (span > 0.0), span, 1.0)
        scale = np.concatenate([size[above], size[below]])[:, np.newaxis]
        law = np.vstack([law[above], -law[below]])
        law[:, -1] -= np.concatenate([self.upper[above], -self.lower[below]])  # the last parameter is 1
        return _tightest(law / scale, np.vstack([gain[above], -gain[below]]) / scale)


def _row_space_factor(data: FloatArray) -> FloatArray:
    """Return B of M = B V', V with as many orthonormal columns as M has independent rows."""
    factor, order = qr(data.T, mode="r", pivoting=True, check_finite=False)
    diagonal = np.abs(np.diag(factor))
    rank = int(np.count_nonzero(diagonal > np.finfo(float).eps * max(data.shape) * diagonal[0]))
    basis = np.empty((len(data), rank))
    basis[order] = factor[:rank].T
    return basis


def _eliminate(equality: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve ``E z = E_p p`` by ``z = particular p + null_space w``; return also what p must satisfy."""
    scale = np.linalg.norm(equality, axis=1, keepdims=True)
    scale[scale == 0.0] = 1.0
    left, values, right = np.linalg.svd(equality / scale)
    rank = int(np.count_nonzero(values > EQUALITY_TOLERANCE * values[:1]))
    rotated = left.T @ (target / scale)
    particular = right[:rank].T @ (rotated[:rank] / values[:rank, np.newaxis])
    conflict = rotated[rank:]
    significant = np.linalg.norm(conflict, axis=1) > _INSIGNIFICANT * np.linalg.norm(rotated)
    return particular, right[rank:].T, conflict[significant]


def _tightest(law: FloatArray, gain: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of rows that bound the same quantity, keep the tightest."""
    rows = np.hstack([law[:, :-1], gain])
    size = np.linalg.norm(rows, axis=1)
    size[size == 0.0] = 1.0
    rows /= size[:, np.newaxis]
    same = rows @ rows.T > 1.0 - _SAME_DIRECTION
    if np.count_nonzero(same) == len(rows):
        return law, gain
    limits = law[:, -1] / size
    tighter = limits > limits[:, np.newaxis]
    as_tight_and_earlier = (limits == limits[:, np.newaxis]) & np.tri(len(rows), k=-1, dtype=bool)
    kept = ~np.any(same & (tighter | as_tight_and_earlier), axis=1)
    return law[kept], gain[kept]
