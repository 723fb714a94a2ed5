"""Model-free adaptive predictive control on the compact-form dynamic linearisation, equations (14)-(21)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.linalg.lapack import dposv

from ddpc_controllers.pseudo_jacobian import Estimation, PseudoJacobian
from ddpc_controllers.recorded import resting_input
from ddpc_cosim import ConfigError, Controller, FloatArray, Loop, Sample, Weight, setting


@dataclass(kw_only=True)
class MFAPC(Controller):
    """Model-free adaptive predictive control, compact form (CFDL), equations (14)-(21).

    Needs no recording: it estimates how the outputs follow the inputs while it controls. The defaults are
    those of Table 2. With several inputs or outputs every entry of the pseudo-Jacobian is reset and forecast
    by itself.
    """

    uses_recording: ClassVar[bool] = False

    horizon: int = setting(5, low=1, doc="prediction and control horizon N, samples")
    lambda_u: float = setting(0.37, above=0.0, doc="weight of the input changes, lambda in (19)")
    eta: float = setting(1.0, above=0.0, high=2.0, doc="step factor of the estimation (16)")
    mu: float = setting(1.0, above=0.0, doc="damping of the estimation (16)")
    epsilon: float = setting(1e-5, above=0.0, doc="smallest input change and gradient that are believed (17)")
    delta: float = setting(0.5, above=0.0, high=1.0, doc="damping of the forecast coefficients (18)")
    initial_gradient: Weight = setting(
        0.1, doc="phi_0 with the sign of the control direction: a number or a list for the diagonal, or p x m"
    )
    initial_forecast: float = setting(0.175, doc="theta_0, every forecast coefficient at the start (18)")
    forecast_order: int = setting(4, low=1, doc="order n_m of the forecast (18)")
    forecast_limit: float = setting(2.0, above=0.0, doc="M: forecast coefficients are reset at this length")

    def start(self, loop: Loop) -> None:
        """Forget what was learned.

        Raises
        ------
        ConfigError
            ``initial_gradient`` does not fit the number of signals.
        """
        m, p = len(loop.inputs), len(loop.outputs)
        self._bounds = loop.bounds
        self._jacobian = PseudoJacobian(self._gradient_matrix(p, m).tolist(), self._constants())
        self._causal = np.tri(self.horizon)[:, np.newaxis, :, np.newaxis]  # predicted, output, changed, input
        self._ridge = self.lambda_u * np.eye(self.horizon * m)
        self._u, self._du = resting_input(loop), np.zeros(m)
        self._y: FloatArray | None = None
        if loop.continues_recording and loop.recording is not None:
            u, y = loop.recording.u, loop.recording.y
            self._u, self._du, self._y = u[-1], u[-1] - u[-2], y[-1]

    def step(self, sample: Sample) -> FloatArray:
        """Return the last inputs plus the first of the optimal changes."""
        y = sample.y
        dy = y - (y if self._y is None else self._y)
        self._jacobian.update(dy.tolist(), self._du.tolist())
        a = self._prediction_matrix()
        error = (sample.reference - y).ravel()  # Y* - E y_k
        du = dposv(a.T @ a + self._ridge, a.T @ error)[1]  # (20)
        u: FloatArray = self._u + du[: len(self._u)]  # (21)
        np.maximum(u, self._bounds.u_min, out=u)
        np.minimum(u, self._bounds.u_max, out=u)
        self._du, self._u, self._y = u - self._u, u, y.copy()
        return u.copy()

    def _prediction_matrix(self) -> FloatArray:
        """Return A of ``Y = E y_k + A dU``, shape (N p, N m): column l holds Phi_k+l from row l down."""
        gradients = np.array(self._jacobian.forecast(self.horizon)).transpose(0, 2, 1)  # output, later, input
        a: FloatArray = self._causal * gradients
        return a.reshape(-1, len(self._ridge))

    def _constants(self) -> Estimation:
        return Estimation(
            eta=self.eta,
            mu=self.mu,
            epsilon=self.epsilon,
            delta=self.delta,
            theta_0=self.initial_forecast,
            n_m=self.forecast_order,
            theta_limit=self.forecast_limit,
        )

    def _gradient_matrix(self, p: int, m: int) -> FloatArray:
        """Return Phi_1, shape (p, m)."""
        given = np.asarray(self.initial_gradient, dtype=float)
        matrix = given
        if given.ndim < 2:
            matrix = np.zeros((p, m))
            np.fill_diagonal(matrix, given)
        if matrix.shape != (p, m) or (given.ndim == 1 and len(given) != min(p, m)):
            raise ConfigError(
                f"MFAPC: initial_gradient has shape {given.shape}; needed: a number, {min(p, m)} numbers, "
                f"or {p} x {m} (outputs x inputs)"
            )
        return matrix
