"""The problems (8) and (10)-(11) as printed, over all entries of g, solved by PIQP's sparse backend.

Slow, and written without a thought for the condensed form: the reference that it is checked against.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from ddpc_controllers import WKPC, DeePC
from ddpc_controllers.optimisation.backends import SparseQP
from ddpc_controllers.published import PublishedDeePC, PublishedWKPC
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
    failure : str
        PIQP's word for why it did not reach its tolerances; empty if it did.
    """

    u: FloatArray
    y: FloatArray
    g: FloatArray
    failure: str

    @property
    def solved(self) -> bool:
        """Whether PIQP reached its tolerances."""
        return not self.failure


class FullDeePC:
    """Problem (8) in g, u, y, sigma_y, u_s, y_s and the excess of soft bounds, as far as the settings ask.

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
    rest : array, shape (m,), optional
        Inputs at rest, which the regulation form weighs inputs from; default: zero.
    column_scale : array, shape (columns,), optional
        Factor of every recorded window.
    relaxed : float, optional
        Tolerance of a second attempt where the first fails; default: there is none.
    """

    def __init__(
        self,
        settings: DeePC,
        recording: Recording,
        bounds: Bounds,
        tolerance: float = TOLERANCE,
        rest: FloatArray | None = None,
        column_scale: FloatArray | None = None,
        relaxed: float | None = None,
    ) -> None:
        self._settings, self._bounds = settings, bounds
        m, p = recording.u.shape[1], recording.y.shape[1]
        self._shape = settings.horizon, m, p
        self._q = weight_matrix(settings.output_weight, p, "output_weight")
        self._r = weight_matrix(settings.input_weight, m, "input_weight")
        self._s = weight_matrix(settings.setpoint_weight, p, "setpoint_weight")
        windows = self._windows(recording)
        scale = np.ones(windows["u"].shape[1]) if column_scale is None else column_scale
        self._data = {name: rows * scale for name, rows in windows.items()}
        self._l1 = settings.regulariser == "l1"
        sizes = self._sizes(len(scale))
        if self._l1:  # g is the difference of two parts that are not negative
            self._data = {name: np.hstack([rows, -rows]) for name, rows in self._data.items()}
        limits = {name: limit for name, limit in self._limits(sizes).items() if name in sizes}
        self._qp = SparseQP(
            sizes, self._half_hessian(sizes), self._equalities(sizes), limits, tolerance, relaxed
        )
        self._set_constants(np.zeros(m) if rest is None else rest)

    def solve(
        self,
        u_ini: FloatArray,
        y_ini: FloatArray,
        reference: FloatArray,
    ) -> FullSolution:
        """Return the optimum for one past and one reference, time along axis 0 of each."""
        qp, (n, m, p) = self._qp, self._shape
        qp.right["u_ini"][:], qp.right["y_ini"][:] = u_ini.ravel(), y_ini.ravel()
        if "rate" in qp.right:
            qp.right["rate"][:m] = u_ini[-1]
        if self._settings.artificial_setpoint:
            qp.linear["y_s"][:] = self._linear_y_s - 2.0 * self._s @ reference.sum(axis=0)
        else:
            qp.linear["y"][:] = -2.0 * (reference @ self._q).ravel()
        x, failure = qp.solve()
        g = x["g"][: len(x["g"]) // 2] - x["g"][len(x["g"]) // 2 :] if self._l1 else x["g"]
        return FullSolution(x["u"].reshape(n, m), x["y"].reshape(n, p), g, failure)

    def _windows(self, recording: Recording) -> dict[str, FloatArray]:
        """Return the blocks of the Hankel matrices (8), and the row that sums g."""
        settings = self._settings
        past, n, m, p = settings.initial_length, *self._shape
        known = past + settings.use_current_output
        u, y = recording.u, recording.y
        published = isinstance(settings, PublishedDeePC)
        if published:
            u, y = _pad(u, past), _pad(y, past)
        hankel_u = _hankel(u[: len(u) - settings.use_current_output], past + n)
        hankel_y = _hankel(y, known + n)
        windows: dict[str, FloatArray] = {
            "u_ini": hankel_u[: past * m],
            "y_ini": hankel_y[: known * p],
            "u": hankel_u[past * m :],
            "y": hankel_y[known * p :],
        }
        columns = hankel_u.shape[1]
        if settings.affine_sum != "none":
            summed = n if published else columns
            windows["sum_g"] = (np.arange(columns) < summed).astype(np.float64)[np.newaxis]
        return windows

    def _sizes(self, columns: int) -> dict[str, int]:
        settings, (n, m, p) = self._settings, self._shape
        sizes = {"g": (1 + self._l1) * columns, "u": n * m, "y": n * p}
        if settings.slack:
            sizes["sigma"] = len(self._data["y_ini"])
        if settings.future_slack:
            sizes["sigma_future"] = n * p
        if settings.artificial_setpoint:
            sizes |= {"u_s": m, "y_s": p}
        if settings.soft_output_bounds:
            sizes |= {"y_held": n * p} | ({"y_s_held": p} if settings.artificial_setpoint else {})
        if np.size(settings.rate_bounds):
            sizes["rate"] = n * m
        return sizes

    def _half_hessian(self, sizes: Mapping[str, int]) -> dict[tuple[str, str], Any]:
        settings, (n, _, _) = self._settings, self._shape
        every, held = np.eye(n), np.ones((n, 1))
        q, r = self._q, self._r
        blocks: dict[tuple[str, str], Any] = {("u", "u"): np.kron(every, r), ("y", "y"): np.kron(every, q)}
        if not self._l1:
            blocks["g", "g"] = settings.lambda_g * self._weight_of_g(sizes["g"])
        if settings.slack:
            blocks["sigma", "sigma"] = settings.lambda_sigma * sp.eye_array(sizes["sigma"])
        if settings.future_slack:
            weight = settings.lambda_sigma * sp.eye_array(sizes["sigma_future"])
            blocks["sigma_future", "sigma_future"] = weight
        if settings.artificial_setpoint:
            tie_u, tie_y = -np.kron(held, r), -np.kron(held, q)
            blocks |= {("u", "u_s"): tie_u, ("u_s", "u"): tie_u.T, ("u_s", "u_s"): n * r}
            blocks |= {("y", "y_s"): tie_y, ("y_s", "y"): tie_y.T, ("y_s", "y_s"): n * (q + self._s)}
        if settings.regulariser == "equilibrium":
            at_rest, weight = self._at_rest()[0], self._weight_of_g_s()
            for i, of_i in at_rest.items():
                blocks["g", i] = -settings.lambda_g * of_i
                blocks[i, "g"] = blocks["g", i].T
                for j, of_j in at_rest.items():
                    blocks[i, j] = blocks.get((i, j), 0.0) + of_i.T @ weight @ of_j
        for soft, exact in (("y_held", "y"), ("y_s_held", "y_s")):
            if soft in sizes:  # what of y goes beyond the bounds: the distance to what is held within them
                weight = settings.soft_output_bounds * np.eye(sizes[soft])
                blocks |= {(soft, soft): weight, (soft, exact): -weight, (exact, soft): -weight}
                blocks[exact, exact] = blocks[exact, exact] + weight
        return blocks

    def _at_rest(self) -> tuple[dict[str, FloatArray], FloatArray]:
        """Return g_s as a function of u_s and y_s, and its constant part."""
        stacked = np.vstack(list(self._data.values()))
        inverse = np.linalg.pinv(stacked)
        (_, m, p), rows = self._shape, {name: len(block) for name, block in self._data.items()}
        of_u_s = np.vstack(
            [
                np.tile(np.eye(m), (k // m, 1)) if name in ("u_ini", "u") else np.zeros((k, m))
                for name, k in rows.items()
            ]
        )
        of_y_s = np.vstack(
            [
                np.tile(np.eye(p), (k // p, 1)) if name in ("y_ini", "y") else np.zeros((k, p))
                for name, k in rows.items()
            ]
        )
        constant = np.concatenate([np.full(k, float(name == "sum_g")) for name, k in rows.items()])
        return {"u_s": inverse @ of_u_s, "y_s": inverse @ of_y_s}, inverse @ constant

    def _weight_of_g_s(self) -> FloatArray:
        """Return lambda_g (I + 0.3 (I - Pi)), Pi projecting on what the outputs are predicted from."""
        known = np.vstack([rows for name, rows in self._data.items() if name != "y"])
        identity = np.eye(known.shape[1])
        return self._settings.lambda_g * (identity + 0.3 * (identity - np.linalg.pinv(known) @ known))

    def _weight_of_g(self, columns: int) -> Any:
        if self._settings.regulariser != "projection":
            return sp.eye_array(columns)
        known = np.vstack([rows for name, rows in self._data.items() if name != "y"])
        return np.eye(columns) - np.linalg.pinv(known) @ known

    def _equalities(self, sizes: Mapping[str, int]) -> dict[str, dict[str, Any]]:
        settings, (n, m, p), past = self._settings, self._shape, self._settings.initial_length
        every_u, every_y = np.eye(n * m), np.eye(n * p)
        rows: dict[str, dict[str, Any]] = {name: {"g": block} for name, block in self._data.items()}
        rows["u"]["u"], rows["y"]["y"] = -every_u, -every_y
        if settings.future_slack:
            rows["y"]["sigma_future"] = -every_y
        if settings.slack:
            rows["y_ini"]["sigma"] = -np.eye(sizes["sigma"])
        if settings.terminal_equality:
            held_u, held_y = np.kron(np.ones((past, 1)), np.eye(m)), np.kron(np.ones((past, 1)), np.eye(p))
            rows["end_u"] = {"u": every_u[-past * m :], "u_s": -held_u}
            rows["end_y"] = {"y": every_y[-past * p :], "y_s": -held_y}
        if "rate" in sizes:
            rows["rate"] = {"u": every_u - np.eye(n * m, k=-m), "rate": -every_u}
        return rows

    def _limits(self, sizes: Mapping[str, int]) -> dict[str, _Limits]:
        settings, bounds, (n, m, _) = self._settings, self._bounds, self._shape
        within_y = np.tile(bounds.y_min, n), np.tile(bounds.y_max, n)
        within_y_s = _shrink(bounds.y_min, bounds.y_max, settings.setpoint_margin)
        soft = bool(settings.soft_output_bounds)
        limits = {
            "u": (np.tile(bounds.u_min, n), np.tile(bounds.u_max, n)),
            "u_s": _shrink(bounds.u_min, bounds.u_max, settings.setpoint_margin),
            "y_held" if soft else "y": within_y,
            "y_s_held" if soft else "y_s": within_y_s,
        }
        if self._l1:
            limits["g"] = np.zeros(sizes["g"]), np.full(sizes["g"], np.inf)
        if "rate" in sizes:
            rate = np.tile(np.broadcast_to(np.asarray(settings.rate_bounds, dtype=float), m), n)
            limits["rate"] = -rate, rate
        return limits

    def _set_constants(self, rest: FloatArray) -> None:
        qp, (n, _, _) = self._qp, self._shape
        if "sum_g" in qp.right:
            qp.right["sum_g"][:] = 1.0
        self._linear_y_s = np.zeros(self._shape[2])
        if (
            self._settings.regulariser == "equilibrium"
        ):  # of |g - P s - c|^2 and what the data leave of P s + c
            at_rest, constant = self._at_rest()
            qp.linear["g"][:] = -2.0 * self._settings.lambda_g * constant
            weight = self._weight_of_g_s()
            qp.linear["u_s"][:] = 2.0 * at_rest["u_s"].T @ weight @ constant
            self._linear_y_s = 2.0 * at_rest["y_s"].T @ weight @ constant
        if self._l1:
            qp.linear["g"][:] = self._settings.lambda_g
        if not self._settings.artificial_setpoint:
            qp.linear["u"][:] = np.tile(-2.0 * self._r @ rest, n)


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
        if isinstance(settings, PublishedWKPC):
            u, y = _pad(u, past), _pad(y, past)
        m, p = u.shape[1], y.shape[1]
        hankel_z = _hankel(lifted[:-n], past)
        hankel_u, hankel_y = _hankel(u, past + n), _hankel(y, past + n)
        columns = hankel_u.shape[1]
        r = weight_matrix(settings.input_weight, m, "input_weight")
        self._q = weight_matrix(settings.output_weight, p, "output_weight")
        tie_r = -np.kron(np.ones((n, 1)), r)
        sizes = {"g": columns, "u": n * m, "y": n * p, "u_s": m}
        half_hessian = {
            ("g", "g"): settings.lambda_g * sp.eye_array(columns),
            ("u", "u"): np.kron(np.eye(n), r),
            ("y", "y"): np.kron(np.eye(n), self._q),
            ("u", "u_s"): tie_r,
            ("u_s", "u"): tie_r.T,
            ("u_s", "u_s"): n * r,
        }
        equalities: dict[str, dict[str, Any]] = {
            "z_ini": {"g": hankel_z},
            "u_ini": {"g": hankel_u[: past * m]},
            "y_ini": {"g": hankel_y[: past * p]},
            "u": {"g": hankel_u[past * m :], "u": -np.eye(n * m)},
            "y": {"g": hankel_y[past * p :], "y": -np.eye(n * p)},
        }
        limits = {
            "u": (np.tile(bounds.u_min, n), np.tile(bounds.u_max, n)),
            "y": (np.tile(bounds.y_min, n), np.tile(bounds.y_max, n)),
            "u_s": _shrink(bounds.u_min, bounds.u_max, settings.setpoint_margin),
        }
        self._shape = n, m, p
        self._qp = SparseQP(sizes, half_hessian, equalities, limits, tolerance)

    def solve(
        self, z_ini: FloatArray, u_ini: FloatArray, y_ini: FloatArray, reference: FloatArray
    ) -> FullSolution:
        """Return the optimum for one past and one reference; time along axis 0 of each."""
        qp, (n, m, p) = self._qp, self._shape
        for name, past in (("z_ini", z_ini), ("u_ini", u_ini), ("y_ini", y_ini)):
            qp.right[name][:] = past.ravel()
        qp.linear["y"][:] = -2.0 * (reference @ self._q).ravel()
        x, failure = qp.solve()
        return FullSolution(x["u"].reshape(n, m), x["y"].reshape(n, p), x["g"], failure)


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
