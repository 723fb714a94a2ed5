"""Linear-quadratic regulator with integral action and a Kalman filter.

    u = u_0 - K_x x^ - K_z z,   z+ = z + y - r,

K minimises the sum of ``|y - y_0|_Q^2 + |z|_Qi^2 + |u - u_0|_R^2`` for the sampled model (K. J. Astrom,
R. M. Murray, Feedback Systems, 2nd ed., sections 7.4 and 8.4). Where an input reaches its limit, the sums z
are set back to what the limited input agrees with, so that they do not wind up.

Known disturbances d are fed forward as the same cost asks for. With ``(x, z)+ = A (x, z) + B u + E d`` and
``y = C (x, z) + F d``, P of the Riccati equation and ``K = (K_x, K_z)``,

    u = ... - (R + B'PB)^-1 B' (P E d_k + v_k+1),   v_k = C'Q F d_k + (A - B K)' (P E d_k + v_k+1),

where d_k is measured, those after it are forecast as far as the horizon reaches, and from there on the last
one lasts (B. D. O. Anderson, J. B. Moore, Optimal Control: Linear Quadratic Methods, 1990, section 4.4).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module

import numpy as np
import scipy  # whose parts are imported when they are first used

from ddpc_controllers.checks import weight_matrices
from ddpc_controllers.export.code import Code
from ddpc_controllers.models.control_api import regulator_gain
from ddpc_controllers.models.kalman import NO_DISTURBANCE, ModelBased
from ddpc_controllers.optimisation.limits import SUM_HELD
from ddpc_cosim import (
    ConfigError,
    Factor,
    FloatArray,
    Loop,
    Recording,
    Sample,
    Weight,
    setting,
)


def preload() -> None:
    """Import what takes a second, once for all workers of a study."""
    import_module("control")


@dataclass(kw_only=True)
class LQR(ModelBased):
    """Linear-quadratic regulator with integral action and a Kalman filter.

    A measurement that is not finite is replaced by the model's prediction; before the first finite one the
    inputs stay at rest. Without a finite reference the sum of its error is held. Each is a status.
    """

    output_weight: Weight = setting(1.0, low=0.0, doc="Q: outputs off the operating point")
    integral_weight: Weight = setting(
        1.0, above=0.0, doc="Qi: sums of the control errors", search=Factor(1e-4, 1e2)
    )
    input_weight: Weight = setting(
        0.1, above=0.0, doc="R: inputs off the operating point", search=Factor(1e-4, 1e2)
    )
    horizon: int = setting(1, low=1, doc="samples of the disturbances' forecast that are fed forward")
    use_forecast: bool = setting(
        True, doc="feed the disturbances' forecast forward; otherwise what is measured is taken to last"
    )

    def _start(self, loop: Loop) -> None:
        """Solve the two Riccati equations."""
        model = self._model
        n, m, p = len(model.a), len(loop.inputs), len(loop.outputs)
        if p > m:
            raise ConfigError(
                f"LQR: {m} input(s) cannot hold {p} outputs at their references: control fewer outputs"
            )
        q, qi, r = weight_matrices(
            output_weight=(self.output_weight, p),
            integral_weight=(self.integral_weight, p),
            input_weight=(self.input_weight, m),
        )
        weight = np.block([[model.c.T @ q @ model.c, np.zeros((n, p))], [np.zeros((p, n)), qi]])
        gain = regulator_gain(model.a, model.b, weight, r, model.c)
        self._state_gain, self._sum_gain = gain[:, :n], gain[:, n:]
        if loop.disturbances:
            self._feedforward = self._preview_gain(gain, weight, q, r)
        self._sums_of_inputs = np.linalg.pinv(self._sum_gain)
        self._bounds, self._u_0 = loop.bounds, model.u_0
        self._moving = bool({variable.name for variable in loop.inputs} & {*loop.moving_limits})
        self._continues = loop.continues_recording
        # The sums take up what does not change, so the filter estimates no disturbance.
        self._observe(loop, "none", 0.0)

    def _begin(self, loop: Loop) -> None:
        self._sum: FloatArray | None = None
        super()._begin(loop)

    def _take_over(self, past: Recording) -> None:
        """Set the sums as if the inputs before had been its own; an experiment's are not."""
        if not self._continues:
            before = self._without_sums(past.d[-1], np.repeat(past.d[-1:], self.horizon, axis=0))
            self._sum = self._sums_of_inputs @ (before - self._u)

    def _without_sums(self, d: FloatArray, forecast: FloatArray) -> FloatArray:
        """Return the inputs of the present estimate and the disturbances now and later, sums aside."""
        inputs = self._u_0 - self._state_gain @ self._observer.state[:-1]
        if not self._disturbed:
            return inputs
        off = self._now_and_later(d, forecast) - self._model.d_0
        return np.asarray(inputs + self._feedforward @ off.ravel())

    def _now_and_later(self, d: FloatArray, forecast: FloatArray) -> FloatArray:
        """Return the disturbances that are fed forward, shape (horizon + 1, n_d)."""
        later = forecast[: self.horizon] if self.use_forecast else np.repeat(d[np.newaxis], self.horizon, 0)
        return np.vstack([d, later])

    def _preview_gain(self, gain: FloatArray, weight: FloatArray, q: FloatArray, r: FloatArray) -> FloatArray:
        """Return what inputs answer disturbances now and later off theirs, shape (m, (horizon + 1) n_d)."""
        model, p = self._model, len(q)
        n, (m, n_d) = len(model.a), (len(r), len(model.d_0))
        a = np.block([[model.a, np.zeros((n, p))], [model.c, np.eye(p)]])
        b, e = np.vstack([model.b, np.zeros((p, m))]), np.vstack([model.e, model.f])
        closed = a - b @ gain
        value = scipy.linalg.solve_discrete_lyapunov(closed.T, weight + gain.T @ r @ gain)
        of_output = np.vstack([model.c.T @ q @ model.f, np.zeros((p, n_d))])
        now = of_output + closed.T @ value @ e
        later = np.linalg.solve(np.eye(n + p) - closed.T, now)  # v where d stays as it is
        answer = -np.linalg.solve(r + b.T @ value @ b, b.T)
        # After the horizon v is (I - (A - B K)')^-1 of the last d.
        rows = [np.linalg.matrix_power(closed.T, k) for k in range(self.horizon + 1)]
        shown = [value @ e, *(rows[k] @ now for k in range(self.horizon - 1)), rows[self.horizon - 1] @ later]
        return np.asarray(np.hstack([answer @ part for part in shown]))

    def _decide(self, sample: Sample) -> tuple[FloatArray, str]:
        """Return the inputs that the gain asks for, within their limits."""
        observer = self._observer
        expected = observer.expected(sample.disturbance if self._disturbed else NO_DISTURBANCE)
        y = np.where(np.isfinite(sample.y), sample.y, expected)
        feedback = self._without_sums(sample.disturbance, sample.forecast)
        if self._sum is None:  # the loop closes without a bump
            self._sum = self._sums_of_inputs @ (feedback - self._u)
        error = y - sample.reference[0]
        known = np.isfinite(error)
        total = self._sum + np.where(known, error, 0.0)
        wanted = feedback - self._sum_gain @ total
        low, high = sample.input_limits[0].T if self._moving else (self._bounds.u_min, self._bounds.u_max)
        u: FloatArray = np.clip(wanted, low, high)
        self._sum = total - self._sums_of_inputs @ (u - wanted)
        return u, "" if known.all() else SUM_HELD

    def _c_decide(self, code: Code, loop: Loop, observer: str) -> str:
        code.kernel("regulator")
        m, p = len(loop.inputs), len(loop.outputs)
        operating_point, ahead = self._u_0, 0
        if self._disturbed:  # where the disturbances are off theirs
            ahead = self._feedforward.shape[1]
            operating_point = self._u_0 - self._feedforward @ np.tile(self._model.d_0, self.horizon + 1)
        tables = {
            "u_0": operating_point,
            "state_gain": np.hstack([self._state_gain, np.zeros((m, 1))]),
            "sum_gain": self._sum_gain,
            "sums_of_inputs": self._sums_of_inputs,
        }
        if not self._moving:
            tables |= {"low": self._bounds.u_min, "high": self._bounds.u_max}
        if ahead:
            tables["feedforward"] = self._feedforward
        named: dict[str, object] = {name: code.doubles(table) for name, table in tables.items()}
        if ahead:
            named["ahead"] = ahead
        if self._moving:
            named["moves"] = True
        regulator = code.constant("Regulator", observer=f"&{observer}", **named)
        sums = code.memory([self._sum is not None, *(np.zeros(p) if self._sum is None else self._sum)])
        scratch = code.memory(np.zeros(m + p + ahead + 2 * m * self._moving))
        look = ""
        if ahead and code.ahead:
            look += code.ahead.chosen(
                code, lambda s: self._now_and_later(s.disturbance, s.forecast), f"{scratch} + {m + p}"
            )
        if self._moving and code.ahead:
            look += code.ahead.limits(code, 1, f"{scratch} + {m + p + ahead}")
        return f"{look}regulate(&{regulator}, &held, {sums}, {scratch}, sample, u, told);"

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return the signals it uses, and its prior information about the plant."""
        known = ", ".join(variable.name for variable in loop.disturbances)
        ahead = {"forecast": known if self.use_forecast else "measured only"} if known else {}
        return {**super().knowledge(loop), **ahead}

    def diagnostics(self) -> Mapping[str, float]:
        """Return the order of the model, and its fit."""
        return {"model_order": float(len(self._observer.state) - 1), **super().diagnostics()}
