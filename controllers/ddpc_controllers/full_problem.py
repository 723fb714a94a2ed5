"""The problems (8) and (10)-(11) as printed, over all entries of g, solved by PIQP's sparse backend.

Slow, and written without a thought for the condensed form: the reference that it is checked against.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import piqp
import scipy.sparse as sp

from ddpc_controllers.deepc import DeePC
from ddpc_controllers.wkpc import WKPC
from ddpc_cosim import Bounds, FloatArray, Recording, weight_matrix

TOLERANCE = 1e-13

_Limits = tuple[FloatArray, FloatArray]


class FullSolution(NamedTuple):
    """The optimum of a full problem.

    Parameters
    ----------
    u, y : array, shape (N, m) and (N, p)
        Inputs and predicted outputs, time along axis 0.
    g : array, shape (columns,)
        Combination of the recorded windows.
    solved : bool
        Whether PIQP reached its tolerances.
    """

    u: FloatArray
    y: FloatArray
    g: FloatArray
    solved: bool


class FullDeePC:
    """Problem (8) in x = (g, u, y, sigma_y, u_s, y_s).

    Parameters
    ----------
    settings : DeePC
        Where the settings come from.
    recording : Recording
        The open-loop experiment.
    bounds : Bounds
        Limits of inputs and outputs.
    tolerance : float
        Tolerance of PIQP, absolute and relative, on residuals and duality gap.
    """

    def __init__(
        self, settings: DeePC, recording: Recording, bounds: Bounds, tolerance: float = TOLERANCE
    ) -> None:
        past, n = settings.initial_length, settings.horizon
        u, y = recording.u, recording.y
        if settings.zero_padding:
            u, y = _pad(u, past), _pad(y, past)
        m, p = u.shape[1], y.shape[1]
        self._past = past * (m + p)
        hankel_u, hankel_y = _hankel(u, past + n), _hankel(y, past + n)
        columns = hankel_u.shape[1]
        q = weight_matrix(settings.output_weight, p, "output_weight")
        r = weight_matrix(settings.input_weight, m, "input_weight")
        self._s = weight_matrix(settings.setpoint_weight, p, "setpoint_weight")

        held = np.ones((n, 1))
        tie_r, tie_q = -np.kron(held, r), -np.kron(held, q)
        half_hessian = _blocks(
            [
                [settings.lambda_g * sp.eye_array(columns), None, None, None, None, None],
                [None, np.kron(np.eye(n), r), None, None, tie_r, None],
                [None, None, np.kron(np.eye(n), q), None, None, tie_q],
                [None, None, None, settings.lambda_sigma * sp.eye_array(past * p), None, None],
                [None, tie_r.T, None, None, n * r, None],
                [None, None, tie_q.T, None, None, n * (q + self._s)],
            ]
        )
        held_u, held_y = np.kron(held[:past], np.eye(m)), np.kron(held[:past], np.eye(p))
        equalities: list[list[Any]] = [
            [hankel_u[: past * m], None, None, None, None, None],
            [hankel_y[: past * p], None, None, -np.eye(past * p), None, None],
            [hankel_u[past * m :], -np.eye(n * m), None, None, None, None],
            [hankel_y[past * p :], None, -np.eye(n * p), None, None, None],
            [None, np.eye(n * m)[-past * m :], None, None, -held_u, None],
            [None, None, np.eye(n * p)[-past * p :], None, None, -held_y],
        ]
        if settings.affine_sum != "none":
            summed = columns if settings.affine_sum == "all" else n
            equalities.append([1.0 * (np.arange(columns) < summed)[np.newaxis], None, None, None, None, None])

        us_min, us_max = _shrink(bounds.u_min, bounds.u_max, settings.setpoint_margin)
        ys_min, ys_max = _shrink(bounds.y_min, bounds.y_max, settings.setpoint_margin)
        sigma = np.full(past * p, np.inf)
        lower = np.concatenate([np.tile(bounds.u_min, n), np.tile(bounds.y_min, n), -sigma, us_min, ys_min])
        upper = np.concatenate([np.tile(bounds.u_max, n), np.tile(bounds.y_max, n), sigma, us_max, ys_max])
        self._qp = _SparseQP(half_hessian, _blocks(equalities), (lower, upper), (columns, n, m, p), tolerance)
        if settings.affine_sum != "none":
            self._qp.right[-1] = 1.0

    def solve(self, u_ini: FloatArray, y_ini: FloatArray, reference: FloatArray) -> FullSolution:
        """Return the optimum for one past and one reference; time along axis 0 of each."""
        self._qp.right[: self._past] = np.concatenate([u_ini.ravel(), y_ini.ravel()])
        self._qp.linear[-len(self._s) :] = -2.0 * self._s @ reference.sum(axis=0)
        return self._qp.solve()


class FullWKPC:
    """Problem (10)-(11) in x = (g, u, y, u_s) for given lifted data.

    Parameters
    ----------
    settings : WKPC
        Where the settings come from.
    lifted : array, shape (T, n_z)
        Lifted states z of the recording, time along axis 0.
    recording : Recording
        The open-loop experiment.
    bounds : Bounds
        Limits of inputs and outputs.
    tolerance : float
        See :class:`FullDeePC`.
    """

    def __init__(
        self,
        settings: WKPC,
        lifted: FloatArray,
        recording: Recording,
        bounds: Bounds,
        tolerance: float = TOLERANCE,
    ) -> None:
        past, n = settings.initial_length, settings.horizon
        u, y = recording.u, recording.y
        if settings.zero_padding:
            u, y = _pad(u, past), _pad(y, past)
        m, p = u.shape[1], y.shape[1]
        hankel_z = _hankel(lifted[:-n], past)
        hankel_u, hankel_y = _hankel(u, past + n), _hankel(y, past + n)
        columns = hankel_u.shape[1]
        r = weight_matrix(settings.input_weight, m, "input_weight")
        self._q = weight_matrix(settings.output_weight, p, "output_weight")
        tie_r = -np.kron(np.ones((n, 1)), r)
        half_hessian = _blocks(
            [
                [settings.lambda_g * sp.eye_array(columns), None, None, None],
                [None, np.kron(np.eye(n), r), None, tie_r],
                [None, None, np.kron(np.eye(n), self._q), None],
                [None, tie_r.T, None, n * r],
            ]
        )
        equality = _blocks(
            [
                [hankel_z, None, None, np.zeros((len(hankel_z), m))],
                [hankel_u[: past * m], None, None, None],
                [hankel_y[: past * p], None, None, None],
                [hankel_u[past * m :], -np.eye(n * m), None, None],
                [hankel_y[past * p :], None, -np.eye(n * p), None],
            ]
        )
        us_min, us_max = _shrink(bounds.u_min, bounds.u_max, settings.setpoint_margin)
        lower = np.concatenate([np.tile(bounds.u_min, n), np.tile(bounds.y_min, n), us_min])
        upper = np.concatenate([np.tile(bounds.u_max, n), np.tile(bounds.y_max, n), us_max])
        self._outputs = slice(columns + n * m, columns + n * (m + p))
        self._qp = _SparseQP(half_hessian, equality, (lower, upper), (columns, n, m, p), tolerance)

    def solve(
        self, z_ini: FloatArray, u_ini: FloatArray, y_ini: FloatArray, reference: FloatArray
    ) -> FullSolution:
        """Return the optimum for one past and one reference; time along axis 0 of each."""
        past = np.concatenate([z_ini.ravel(), u_ini.ravel(), y_ini.ravel()])
        self._qp.right[: len(past)] = past
        self._qp.linear[self._outputs] = -2.0 * (reference @ self._q).ravel()
        return self._qp.solve()


class _SparseQP:
    """A sparse problem whose linear cost and right-hand side change from one solution to the next.

    ``limits`` are those of everything but g, which has none; ``shape`` is (columns, N, m, p).
    """

    def __init__(
        self,
        half_hessian: Any,
        equality: Any,
        limits: _Limits,
        shape: tuple[int, int, int, int],
        tolerance: float,
    ) -> None:
        self.linear, self.right = np.zeros(half_hessian.shape[0]), np.zeros(equality.shape[0])
        self._shape = shape
        self._solver = piqp.SparseSolver()
        for name in ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"):
            setattr(self._solver.settings, name, tolerance)
        endless = np.full(shape[0], np.inf)
        lower, upper = np.concatenate([-endless, limits[0]]), np.concatenate([endless, limits[1]])
        self._solver.setup(2.0 * half_hessian, self.linear, equality, self.right, x_l=lower, x_u=upper)

    def solve(self) -> FullSolution:
        self._solver.update(c=self.linear, b=self.right)
        solved = self._solver.solve() == piqp.PIQP_SOLVED
        columns, n, m, p = self._shape
        g, u, y, _ = np.split(self._solver.result.x, np.cumsum([columns, n * m, n * p]))
        return FullSolution(u.reshape(n, m), y.reshape(n, p), g, solved)


def _blocks(rows: Sequence[Sequence[Any]]) -> Any:
    """Return a sparse matrix from its blocks; None is a block of zeros."""
    sparse = [[None if block is None else sp.csc_array(block) for block in row] for row in rows]
    return sp.csc_matrix(sp.block_array(sparse))


def _hankel(w: FloatArray, depth: int) -> FloatArray:
    return np.vstack([w[row : len(w) - depth + row + 1].T for row in range(depth)])


def _pad(w: FloatArray, samples: int) -> FloatArray:
    return np.concatenate([w[samples:], np.zeros((samples, w.shape[1]))])


def _shrink(low: FloatArray, high: FloatArray, margin: float) -> _Limits:
    """Shrink two-sided limits about their middle."""
    two_sided = np.isfinite(low) & np.isfinite(high)
    inset = np.zeros_like(low)
    inset[two_sided] = (1.0 - margin) * (high - low)[two_sided] / 2.0
    return low + inset, high - inset
