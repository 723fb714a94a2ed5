"""From a data-driven tracking problem as printed to the few variables that matter online.

A problem is written in named variables: the rows ``h = M g`` of the data (u_ini, y_ini, u, y), the combination
``g`` itself and artificial setpoints; and in named parameters: whatever changes from sample to sample. With the
orthogonal factorisation ``M' = V B'`` and ``g = V v`` the rows are ``h = B v`` and ``|g| = |v|``: the recording's
length is gone, whatever the rank of M, and nothing is inverted. What remains is

    minimise |G z - T p|^2   subject to   E z = E_p p,   lower <= C z <= upper,   z = (v, setpoints),

p being the parameters. The equalities are eliminated through a null space that reveals their rank. A triangular
factor of what remains of G measures the distance t from the unconstrained optimum in units of the cost, so that

    minimise |t|^2   subject to   e_0(p) + L t <= 0

is left of the problem, ``e`` being by how much each bound is exceeded in parts of its range.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import qr, solve_triangular

from ddpc_cosim import ConfigError, FloatArray

EQUALITY_TOLERANCE = 1e-10
"""Equality rows that others repeat to within this fraction are redundant."""

_SAME_DIRECTION = 1e-14
_INSIGNIFICANT = 1e-12

Blocks = Mapping[str, FloatArray]
"""Coefficient blocks by the name of the variable or parameter that they multiply."""


@dataclass(frozen=True, slots=True)
class CondensedProblem:
    """Minimise |t|^2 subject to ``excess_law @ p + excess_gain @ t <= 0``; the control move is affine in p and t.

    Parameters
    ----------
    excess_law : array, shape (n, parameters)
        By how much each bound is exceeded at the unconstrained optimum, in parts of the bound's range.
    excess_gain : array, shape (n, k)
        How the deviation t changes that.
    move_law, move_gain : arrays, shapes (m, parameters) and (m, k)
        The inputs to apply now, likewise, in their units.
    conflict_law : array, shape (c, parameters)
        Must vanish: the part of the past that no combination of the recorded windows explains.
    """

    excess_law: FloatArray
    excess_gain: FloatArray
    move_law: FloatArray
    move_gain: FloatArray
    conflict_law: FloatArray


@dataclass
class Problem:
    """A quadratic problem in named variables, affine in named parameters.

    Parameters
    ----------
    rows : mapping of str to int
        Sizes of the data rows ``h = M g``, stacked in this order in M.
    free : mapping of str to int
        Sizes of the other variables, the combination ``g`` excepted.
    parameters : mapping of str to int
        Sizes of the parameters, stacked in this order in p.
    """

    rows: Mapping[str, int]
    free: Mapping[str, int]
    parameters: Mapping[str, int]
    _costs: list[tuple[FloatArray, Blocks, Blocks]] = field(default_factory=list, init=False, repr=False)
    _equalities: list[tuple[Blocks, Blocks]] = field(default_factory=list, init=False, repr=False)
    _bounds: list[tuple[str, FloatArray, FloatArray]] = field(default_factory=list, init=False, repr=False)
    _regularisation: float = field(default=0.0, init=False, repr=False)

    def regularise(self, weight: float) -> None:
        """Add ``weight |g|^2`` to the cost."""
        self._regularisation += weight

    def penalise(self, weight: FloatArray, variables: Blocks, target: Blocks) -> None:
        """Add ``|sum variables - sum target|^2_W`` to the cost; ``weight`` is W or one block of a repeated one."""
        repeats = _row_count(variables) // len(weight)
        self._costs.append((np.kron(np.eye(repeats), _square_root(weight)), variables, target))

    def equate(self, variables: Blocks, target: Blocks) -> None:
        """Require ``sum variables = sum target``."""
        self._equalities.append((variables, target))

    def bound(self, variable: str, lower: FloatArray, upper: FloatArray) -> None:
        """Keep a variable within bounds, repeated along the horizon; infinite where there is none."""
        repeats = {**self.rows, **self.free}[variable] // len(lower)
        self._bounds.append((variable, np.tile(lower, repeats), np.tile(upper, repeats)))

    def prepare(self, move: str, inputs: int) -> "PreparedProblem":
        """Assemble what does not depend on the data; the first ``inputs`` entries of ``move`` are applied."""
        variables = _offsets({**self.rows, **self.free})
        parameters = _offsets(self.parameters)

        def matrices(left: Blocks, right: Blocks) -> tuple[FloatArray, FloatArray]:
            rows = _row_count(left)
            return _assemble(left, variables, rows), _assemble(right, parameters, rows)

        costs = [tuple(root @ matrix for matrix in matrices(v, t)) for root, v, t in self._costs]
        equalities = [matrices(v, t) for v, t in self._equalities]
        bounds = [(_rows(name, variables), low, high) for name, low, high in self._bounds]
        return PreparedProblem(
            row_count=sum(self.rows.values()),
            regularisation=self._regularisation,
            residual=_stack([v for v, _ in costs], variables),
            target=_stack([t for _, t in costs], parameters),
            equality=_stack([v for v, _ in equalities], variables),
            equality_target=_stack([t for _, t in equalities], parameters),
            bounded=_stack([v for v, _, _ in bounds], variables),
            lower=np.concatenate([low for _, low, _ in bounds]),
            upper=np.concatenate([high for _, _, high in bounds]),
            move=_rows(move, variables)[:inputs],
        )


@dataclass(frozen=True, slots=True)
class PreparedProblem:
    """A :class:`Problem` as matrices over (h, free variables), ready to meet its data."""

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
        data : array, shape (rows, columns)
            The stacked Hankel matrices M.

        Raises
        ------
        ConfigError
            The weights leave the optimum undetermined.
        """
        basis = _row_space_factor(data)
        particular, null_space, conflict = _eliminate(self._in_z(self.equality, basis), self.equality_target)
        law, gain = self._unconstrained_optimum(basis, particular, null_space)

        bounded, move = self._in_z(self.bounded, basis), self._in_z(self.move, basis)
        excess_law, excess_gain = self._excess(bounded @ law, bounded @ gain)
        return CondensedProblem(excess_law, excess_gain, move @ law, move @ gain, conflict)

    def _in_z(self, matrix: FloatArray, basis: FloatArray) -> FloatArray:
        """Rewrite rows over (h, free variables) as rows over z = (v, free variables)."""
        return np.hstack([matrix[:, : self.row_count] @ basis, matrix[:, self.row_count :]])

    def _unconstrained_optimum(
        self, basis: FloatArray, particular: FloatArray, null_space: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return ``z = law p + gain t`` such that the cost is |t|^2 and a constant."""
        ridge = np.zeros((basis.shape[1], particular.shape[0]))
        np.fill_diagonal(ridge, np.sqrt(self.regularisation))
        residual = np.vstack([self._in_z(self.residual, basis), ridge])
        offset = residual @ particular
        offset[: len(self.target)] -= self.target

        size = null_space.shape[1]
        # Factorised together: R beside Q' offset, without Q.
        factor = np.linalg.qr(np.hstack([residual @ null_space, offset]), mode="r")[:size]
        triangular, projected = factor[:, :size], factor[:, size:]
        diagonal = np.abs(np.diag(triangular))
        if size and diagonal.min() <= _INSIGNIFICANT * diagonal.max():
            raise ConfigError("the weights leave the optimum undetermined: make them positive")
        gain = solve_triangular(triangular, null_space.T, trans=1, check_finite=False).T
        return particular - gain @ projected, gain

    def _excess(self, law: FloatArray, gain: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Turn ``lower <= law p + gain t <= upper`` into normalised rows that must not be positive."""
        span = self.upper - self.lower
        size = np.where(np.isfinite(span) & (span > 0.0), span, 1.0)
        above, below = np.isfinite(self.upper), np.isfinite(self.lower)
        law = np.vstack([law[above], -law[below]])
        law[:, -1] -= np.concatenate([self.upper[above], -self.lower[below]])
        size = np.concatenate([size[above], size[below]])[:, np.newaxis]
        return _tightest(law / size, np.vstack([gain[above], -gain[below]]) / size)


def _row_space_factor(data: FloatArray) -> FloatArray:
    """Return B of M = B V', V with as many orthonormal columns as M has independent rows."""
    factor, order = qr(data.T, mode="r", pivoting=True, check_finite=False)
    diagonal = np.abs(np.diag(factor))
    rank = int(np.count_nonzero(diagonal > np.finfo(float).eps * max(data.shape) * diagonal[0]))
    basis = np.empty((len(data), rank))
    basis[order] = factor[:rank].T
    return basis


def _eliminate(equality: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve ``E z = E_p p`` for ``z = particular p + null_space w``; return also what p must satisfy for it."""
    scale = np.linalg.norm(equality, axis=1, keepdims=True)
    scale[scale == 0.0] = 1.0
    left, values, right = np.linalg.svd(equality / scale)
    rank = int(np.count_nonzero(values > EQUALITY_TOLERANCE * values[:1]))
    in_rows = left.T @ (target / scale)
    particular = right[:rank].T @ (in_rows[:rank] / values[:rank, np.newaxis])
    conflict = in_rows[rank:]
    significant = np.linalg.norm(conflict, axis=1) > _INSIGNIFICANT * np.linalg.norm(in_rows)
    return particular, right[rank:].T, conflict[significant]


def _tightest(law: FloatArray, gain: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of rows that bound the same quantity, keep the tightest: the last parameter is the constant 1."""
    rows = np.hstack([law[:, :-1], gain])
    size = np.linalg.norm(rows, axis=1)
    size[size == 0.0] = 1.0
    rows /= size[:, np.newaxis]
    same = rows @ rows.T > 1.0 - _SAME_DIRECTION
    if np.count_nonzero(same) == len(rows):
        return law, gain
    limits = law[:, -1] / size
    # A row goes where another of the same direction is tighter, or as tight and earlier.
    tighter = limits[np.newaxis, :] > limits[:, np.newaxis]
    earlier = (limits[np.newaxis, :] == limits[:, np.newaxis]) & np.tri(len(rows), k=-1, dtype=bool)
    kept = ~np.any(same & (tighter | earlier), axis=1)
    return law[kept], gain[kept]


def _square_root(weight: FloatArray) -> FloatArray:
    """Return F with F'F = W."""
    values, vectors = np.linalg.eigh(weight)
    return np.sqrt(np.maximum(values, 0.0))[:, np.newaxis] * vectors.T


def _offsets(sizes: Mapping[str, int]) -> dict[str, slice]:
    """Return where each named block stands in the stacked vector."""
    ends = np.cumsum(list(sizes.values()))
    return {name: slice(int(end) - size, int(end)) for (name, size), end in zip(sizes.items(), ends, strict=True)}


def _width(places: Mapping[str, slice]) -> int:
    return max(place.stop for place in places.values())


def _row_count(blocks: Blocks) -> int:
    return next(iter(blocks.values())).shape[0]


def _assemble(blocks: Blocks, places: Mapping[str, slice], rows: int) -> FloatArray:
    """Write named blocks side by side, zero elsewhere."""
    matrix = np.zeros((rows, _width(places)))
    for name, block in blocks.items():
        matrix[:, places[name]] += block
    return matrix


def _stack(matrices: list[FloatArray], places: Mapping[str, slice]) -> FloatArray:
    return np.vstack([np.zeros((0, _width(places))), *matrices])


def _rows(name: str, places: Mapping[str, slice]) -> FloatArray:
    """Return the selection of one variable."""
    place = places[name]
    return np.eye(_width(places))[place]
