"""Sparse quadratic problems in named variables on PIQP, set up once; only vectors change from then on."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import piqp
import scipy.sparse as sp
from scipy.sparse.linalg import norm

from ddpc_cosim import FloatArray

TOLERANCE = 1e-13

SparseBlocks = Mapping[str, Any]
"""Coefficient blocks, dense or sparse, by the name of the variable that they multiply."""


class SparseQP:
    """Minimise ``x' H x + c' x`` subject to ``A x = b`` and limits of x.

    Parameters
    ----------
    sizes : mapping of str to int
        Sizes of the variables, in their order in x.
    half_hessian : mapping of (str, str) to array
        Blocks of H.
    equalities : mapping of str to blocks
        Rows of A by the name of their right-hand side, in order.
    limits : mapping of str to (array, array)
        Limits of the variables that have any.
    tolerance : float
        Tolerance of PIQP, absolute and relative, on residuals and duality gap.
    relaxed : float, optional
        Tolerance of a second attempt where the first fails; default: there is none.

    Attributes
    ----------
    linear, right : dict of str to array
        Blocks of c and b, zero at first: views, to be changed in place.
    """

    def __init__(
        self,
        sizes: Mapping[str, int],
        half_hessian: Mapping[tuple[str, str], Any],
        equalities: Mapping[str, SparseBlocks],
        limits: Mapping[str, tuple[FloatArray, FloatArray]],
        tolerance: float = TOLERANCE,
        relaxed: float | None = None,
    ) -> None:
        names = list(sizes)
        rows = {name: next(iter(blocks.values())).shape[0] for name, blocks in equalities.items()}
        hessian = [[_block(half_hessian.get((i, j)), sizes[i], sizes[j]) for j in names] for i in names]
        equality = [[_block(equalities[i].get(j), rows[i], sizes[j]) for j in names] for i in equalities]
        self._c, self.linear = _vector(sizes)
        self._b, self.right = _vector(rows)
        self._x, self._parts = _vector(sizes)
        endless = {name: np.full(size, np.inf) for name, size in sizes.items()}
        lower = np.concatenate([limits[n][0] if n in limits else -endless[n] for n in names])
        upper = np.concatenate([limits[n][1] if n in limits else endless[n] for n in names])
        self._tolerance, self._relaxed = tolerance, relaxed
        self._solver = piqp.SparseSolver()
        # Rows of size 1 need no other scaling, and shorter steps get through degenerate problems.
        self._solver.settings.preconditioner_iter = 0
        self._solver.settings.tau = 0.9
        quadratic, equations = _sparse(hessian), _sparse(equality)
        # PIQP's tolerances are absolute too: costs and rows of about size 1, whatever the units and weights.
        curvatures = quadratic.diagonal()
        self._cost = float(np.exp(-np.log(curvatures[curvatures > 0.0]).mean()))
        self._row_sizes = norm(equations, axis=1)
        self._row_sizes[self._row_sizes == 0.0] = 1.0
        equations = sp.csc_matrix(sp.diags_array(1.0 / self._row_sizes) @ equations)
        self._solver.setup(2.0 * self._cost * quadratic, self._c, equations, self._b, x_l=lower, x_u=upper)

    def solve(self) -> tuple[dict[str, FloatArray], str]:
        """Return the variables by name, and the solver's word for why they are not optimal, if so."""
        self._solver.update(c=self._cost * self._c, b=self._b / self._row_sizes)
        status = self._attempt(self._tolerance)
        if status != piqp.PIQP_SOLVED and self._relaxed is not None:
            status = self._attempt(self._relaxed)
        self._x[...] = self._solver.result.x
        solution = {name: part.copy() for name, part in self._parts.items()}
        return solution, "" if status == piqp.PIQP_SOLVED else str(status.name)

    def _attempt(self, tolerance: float) -> Any:
        for setting in ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"):
            setattr(self._solver.settings, setting, tolerance)
        return self._solver.solve()


def _block(block: Any, rows: int, columns: int) -> Any:
    """Return a sparse block, of zeros where there is none: every row and column needs a size."""
    return sp.csc_array((rows, columns)) if block is None else sp.csc_array(block)


def _sparse(rows: list[list[Any]]) -> Any:
    return sp.csc_matrix(sp.block_array(rows))


def _vector(sizes: Mapping[str, int]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return a vector of zeros, and views of its named parts."""
    vector = np.zeros(sum(sizes.values()))
    ends = np.cumsum(list(sizes.values()))[:-1]
    return vector, dict(zip(sizes, np.split(vector, ends), strict=True))
