"""What a combination g of recorded windows costs, block by block of a triangular factor of the data.

With the stacked data ``M = B V'``, V with orthonormal columns and B block lower triangular, ``g = V v``
reproduces the data rows ``h = B v`` at the least length, ``|g| = |v|``. Each block of v belongs to a block of
rows: what of them the rows above do not determine.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from ddpc_cosim import FloatArray


@dataclass(frozen=True, slots=True)
class RowFactor:
    """Stacked data in as few coordinates as they have independent rows.

    Parameters
    ----------
    basis : array, shape (rows, rank)
        B, of full column rank.
    weights : array, shape (rank,)
        Weight of the square of each coordinate.
    """

    basis: FloatArray
    weights: FloatArray


@dataclass(frozen=True, slots=True)
class Regularisation:
    """Weights of |v|^2, one for each block of data rows.

    One block weighs ``|g|^2``. With the predicted outputs as a last block of their own and no weight on the
    rest it is ``|(I - Pi) g|^2``, Pi projecting on the rows that the outputs are predicted from (F. Doerfler,
    J. Coulson, I. Markovsky, doi:10.1109/TAC.2022.3148374, arXiv:2101.01273).

    Parameters
    ----------
    sizes : tuple of int
        Rows in each block, from the top.
    weights : tuple of float
        Weight of each block; an infinite one keeps its coordinates at zero.
    """

    sizes: tuple[int, ...]
    weights: tuple[float, ...]

    def factor(self, data: FloatArray) -> RowFactor:
        """Factorise the stacked data, shape (rows, columns)."""
        basis, ranks = _block_triangular(data, self.sizes)
        weights = np.repeat(self.weights, ranks)
        kept = np.isfinite(weights)
        return RowFactor(basis[:, kept], weights[kept])


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
        directions, factor, _ = qr(new, mode="economic", pivoting=True, check_finite=False)
        rank = int(np.count_nonzero(np.abs(np.diag(factor)) > significant))
        known = np.hstack([known, directions[:, :rank]])
        ranks.append(rank)
    return basis @ known, ranks


def _row_space_factor(data: FloatArray) -> tuple[FloatArray, float]:
    """Return B with as many columns as M has independent rows, and what counted as significant."""
    factor, order = qr(data.T, mode="r", pivoting=True, check_finite=False)
    diagonal = np.abs(np.diag(factor))
    significant = float(np.finfo(float).eps * max(data.shape) * diagonal[0])
    rank = int(np.count_nonzero(diagonal > significant))
    basis = np.empty((len(data), rank))
    basis[order] = factor[:rank].T
    return basis, significant
