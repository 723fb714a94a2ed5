"""Linear-quadratic regulator with integral action and a Kalman filter.

    u = u_0 - K_x x^ - K_z z,   z+ = z + y - r,

K minimises the sum of ``|y - y_0|_Q^2 + |z|_Qi^2 + |u - u_0|_R^2`` for the sampled model (K. J. Astrom,
R. M. Murray, Feedback Systems, 2nd ed., sections 7.4 and 8.4). Where an input reaches its limit, the sums z
are set back to what the limited input agrees with, so that they do not wind up.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module

import numpy as np

from ddpc_controllers.checks import weight_matrices
from ddpc_controllers.export.code import Code
from ddpc_controllers.models.control_api import regulator_gain
from ddpc_controllers.models.kalman import ModelBased
from ddpc_controllers.optimisation.limits import SUM_HELD
from ddpc_cosim import (
    ConfigError,
    Factor,
    FloatArray,
    Loop,
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
        self._sums_of_inputs = np.linalg.pinv(self._sum_gain)
        self._bounds, self._u_0 = loop.bounds, model.u_0
        # The sums take up what does not change, so the filter estimates no disturbance.
        self._observe(loop, "none", 0.0)
        self._sum: FloatArray | None = None

    def _decide(self, sample: Sample) -> tuple[FloatArray, str]:
        """Return the inputs that the gain asks for, within their limits."""
        observer = self._observer
        y = np.where(np.isfinite(sample.y), sample.y, observer.c @ observer.state)
        feedback = self._u_0 - self._state_gain @ observer.state[:-1]
        if self._sum is None:  # the loop closes without a bump
            self._sum = self._sums_of_inputs @ (feedback - self._u)
        error = y - sample.reference[0]
        known = np.isfinite(error)
        total = self._sum + np.where(known, error, 0.0)
        wanted = feedback - self._sum_gain @ total
        u: FloatArray = np.clip(wanted, self._bounds.u_min, self._bounds.u_max)
        self._sum = total - self._sums_of_inputs @ (u - wanted)
        return u, "" if known.all() else SUM_HELD

    def _c_decide(self, code: Code, loop: Loop, observer: str) -> str:
        code.kernel("regulator")
        m, p = len(loop.inputs), len(loop.outputs)
        tables = {
            "u_0": self._u_0,
            "state_gain": np.hstack([self._state_gain, np.zeros((m, 1))]),
            "sum_gain": self._sum_gain,
            "sums_of_inputs": self._sums_of_inputs,
            "low": self._bounds.u_min,
            "high": self._bounds.u_max,
        }
        named = {name: code.doubles(table) for name, table in tables.items()}
        regulator = code.constant("Regulator", observer=f"&{observer}", **named)
        sums, scratch = code.memory(np.zeros(1 + p)), code.memory(np.zeros(m + p))
        return f"regulate(&{regulator}, &held, {sums}, {scratch}, sample, u, told);"

    def diagnostics(self) -> Mapping[str, float]:
        """Return the order of the model, and its fit."""
        return {"model_order": float(len(self._observer.state) - 1), **super().diagnostics()}
