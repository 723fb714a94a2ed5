"""The problems (8) and (10)-(11) as printed, over all entries of g, solved by PIQP's sparse backend.

Slow, and written without a thought for the condensed form: the reference that it is checked against.
"""

from typing import NamedTuple

import numpy as np
import piqp
import scipy.sparse as sp

from ddpc_controllers.deepc import DeePC
from ddpc_controllers.wkpc import WKPC
from ddpc_cosim import Bounds, FloatArray, Recording, weight_matrix

TOLERANCE = 1e-10


class FullSolution(NamedTuple):
    """The optimum of a full problem.

    Parameters
    ----------
    u : array, shape (N, m)
        Inputs, time along axis 0.
    y : array, shape (N, p)
        Predicted outputs.
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
        hankel_u, hankel_y = _hankel(u, past + n), _hankel(y, past + n)
        columns = hankel_u.shape[1]
        self._shape = (columns, n, m, p)
        q = weight_matrix(settings.output_weight, p, "output_weight")
        r = weight_matrix(settings.input_weight, m, "input_weight")
        self._s = weight_matrix(settings.setpoint_weight, p, "setpoint_weight")
        ones = np.ones((n, 1))

        # Half the Hessian, block by block: g, u, y, sigma_y, u_s, y_s.
        each_r, each_q = np.kron(np.eye(n), r), np.kron(np.eye(n), q)
        tie_r, tie_q = -np.kron(ones, r), -np.kron(ones, q)
        hessian = sp.bmat(
            [
                [settings.lambda_g * sp.eye(columns), None, None, None, None, None],
                [None, each_r, None, None, tie_r, None],
                [None, None, each_q, None, None, tie_q],
                [None, None, None, settings.lambda_sigma * sp.eye(past * p), None, None],
                [None, tie_r.T, None, None, n * r, None],
                [None, None, tie_q.T, None, None, n * (q + self._s)],
            ]
        )
        rows = [
            [hankel_u[: past * m], None, None, None, None, None],
            [hankel_y[: past * p], None, None, -sp.eye(past * p), None, None],
            [hankel_u[past * m :], -sp.eye(n * m), None, None, None, None],
            [hankel_y[past * p :], None, -sp.eye(n * p), None, None, None],
            [None, _last(past, n, m), None, None, -np.kron(np.ones((past, 1)), np.eye(m)), None],
            [None, None, _last(past, n, p), None, None, -np.kron(np.ones((past, 1)), np.eye(p))],
        ]
        if settings.affine_sum != "none":
            summed = columns if settings.affine_sum == "all" else n
            rows.append([(np.arange(columns) < summed)[np.newaxis], None, None, None, None, None])
        equality = sp.bmat(rows)

        free = np.full(past * p, np.inf)
        us_min, us_max = _shrink(bounds.u_min, bounds.u_max, settings.setpoint_margin)
        ys_min, ys_max = _shrink(bounds.y_min, bounds.y_max, settings.setpoint_margin)
        endless = np.full(columns, np.inf)
        lower = [-endless, np.tile(bounds.u_min, n), np.tile(bounds.y_min, n), -free, us_min, ys_min]
        upper = [endless, np.tile(bounds.u_max, n), np.tile(bounds.y_max, n), free, us_max, ys_max]

        self._linear = np.zeros(hessian.shape[0])
        self._right = np.zeros(equality.shape[0])
        if settings.affine_sum != "none":
            self._right[-1] = 1.0
        self._past = past * (m + p)
        self._solver = _set_up(
            2.0 * hessian, equality, np.concatenate(lower), np.concatenate(upper), tolerance
        )

    def solve(self, u_ini: FloatArray, y_ini: FloatArray, reference: FloatArray) -> FullSolution:
        """Return the optimum for one past and one reference; time along axis 0 of each."""
        p = reference.shape[1]
        self._right[: self._past] = np.concatenate([u_ini.ravel(), y_ini.ravel()])
        self._linear[-p:] = -2.0 * self._s @ reference.sum(axis=0)
        return _solve(self._solver, self._linear, self._right, self._shape)


class FullWKPC:
    """Problem (10)-(11) in x = (g, u, y, u_s) for given lifted data.

    Parameters
    ----------
    settings : WKPC
        Where the settings come from.
    lifted : array, shape (T, n_z)
        Lifted states z of the recording, time along axis 0.
    recording : Recording
        The open-loop experiment, padded already where it is to be.
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
        m, p = recording.u.shape[1], recording.y.shape[1]
        hankel_z = _hankel(lifted[:-n], past)
        hankel_u, hankel_y = _hankel(recording.u, past + n), _hankel(recording.y, past + n)
        columns = hankel_u.shape[1]
        self._shape = (columns, n, m, p)
        r = weight_matrix(settings.input_weight, m, "input_weight")
        self._q = weight_matrix(settings.output_weight, p, "output_weight")
        each_r, each_q, tie_r = (
            np.kron(np.eye(n), r),
            np.kron(np.eye(n), self._q),
            -np.kron(np.ones((n, 1)), r),
        )
        hessian = sp.bmat(
            [
                [settings.lambda_g * sp.eye(columns), None, None, None],
                [None, each_r, None, tie_r],
                [None, None, each_q, None],
                [None, tie_r.T, None, n * r],
            ]
        )
        nothing = sp.coo_matrix((len(hankel_z), m))
        equality = sp.bmat(
            [
                [hankel_z, None, None, nothing],
                [hankel_u[: past * m], None, None, None],
                [hankel_y[: past * p], None, None, None],
                [hankel_u[past * m :], -sp.eye(n * m), None, None],
                [hankel_y[past * p :], None, -sp.eye(n * p), None],
            ]
        )
        us_min, us_max = _shrink(bounds.u_min, bounds.u_max, settings.setpoint_margin)
        endless = np.full(columns, np.inf)
        lower = [-endless, np.tile(bounds.u_min, n), np.tile(bounds.y_min, n), us_min]
        upper = [endless, np.tile(bounds.u_max, n), np.tile(bounds.y_max, n), us_max]
        self._linear = np.zeros(hessian.shape[0])
        self._right = np.zeros(equality.shape[0])
        self._solver = _set_up(
            2.0 * hessian, equality, np.concatenate(lower), np.concatenate(upper), tolerance
        )

    def solve(
        self, z_ini: FloatArray, u_ini: FloatArray, y_ini: FloatArray, reference: FloatArray
    ) -> FullSolution:
        """Return the optimum for one past and one reference; time along axis 0 of each."""
        columns, n, m, p = self._shape
        past = np.concatenate([z_ini.ravel(), u_ini.ravel(), y_ini.ravel()])
        self._right[: len(past)] = past
        outputs = slice(columns + n * m, columns + n * (m + p))
        self._linear[outputs] = -2.0 * (reference @ self._q).ravel()
        return _solve(self._solver, self._linear, self._right, self._shape)


def _set_up(
    hessian: sp.sparray, equality: sp.sparray, lower: FloatArray, upper: FloatArray, tolerance: float
) -> piqp.SparseSolver:
    solver = piqp.SparseSolver()
    for name in ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"):
        setattr(solver.settings, name, tolerance)
    zero = np.zeros(hessian.shape[0])
    right = np.zeros(equality.shape[0])
    solver.setup(sp.csc_matrix(hessian), zero, sp.csc_matrix(equality), right, x_l=lower, x_u=upper)
    return solver


def _solve(
    solver: piqp.SparseSolver, linear: FloatArray, right: FloatArray, shape: tuple[int, int, int, int]
) -> FullSolution:
    columns, n, m, p = shape
    solver.update(c=linear, b=right)
    solved = solver.solve() == piqp.PIQP_SOLVED
    x = solver.result.x
    u, y = x[columns : columns + n * m], x[columns + n * m : columns + n * (m + p)]
    return FullSolution(u.reshape(n, m), y.reshape(n, p), x[:columns], solved)


def _hankel(w: FloatArray, depth: int) -> FloatArray:
    return np.vstack([w[row : len(w) - depth + row + 1].T for row in range(depth)])


def _pad(w: FloatArray, samples: int) -> FloatArray:
    return np.concatenate([w[samples:], np.zeros((samples, w.shape[1]))])


def _last(past: int, horizon: int, width: int) -> FloatArray:
    """Select the last ``past`` of ``horizon`` samples."""
    return np.eye(horizon * width)[(horizon - past) * width :]


def _shrink(low: FloatArray, high: FloatArray, margin: float) -> tuple[FloatArray, FloatArray]:
    """Shrink two-sided limits about their middle."""
    two_sided = np.isfinite(low) & np.isfinite(high)
    inset = np.zeros_like(low)
    inset[two_sided] = (1.0 - margin) * (high - low)[two_sided] / 2.0
    return low + inset, high - inset
