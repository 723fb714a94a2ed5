"""Model-free adaptive predictive control, equations (14)-(21), on the three forms of the data model.

The paper prints the compact form (CFDL) and refers to Z. Hou and S. Jin, Model Free Adaptive Control: Theory
and Applications, CRC Press, 2013, chapter 5, for the partial (PFDL) and the full form (FFDL).
"""

from dataclasses import dataclass

import numpy as np

from ddpc_controllers.change_limits import ChangeLimits, rate_limits
from ddpc_controllers.data_model import Form
from ddpc_controllers.gradient_forecast import Forecast, GradientForecast
from ddpc_controllers.linearised_prediction import LinearisedPrediction
from ddpc_controllers.model_free_adaptive import ModelFreeAdaptive
from ddpc_cosim import ConfigError, Loop, Sample, setting


@dataclass(kw_only=True)
class MFAPC(ModelFreeAdaptive):
    """Model-free adaptive predictive control (14)-(21).

    The defaults are those of Table 2. Every coefficient of the data model is forecast by itself. With a
    diagonal structure it is one loop for each pair of signals; with the full one the loops share their
    estimation, and a channel that does not move leaves the others as if they were alone.
    """

    horizon: int = setting(5, low=1, doc="prediction horizon N, samples")
    control_horizon: int = setting(0, low=0, doc="control horizon Nu <= N, samples; 0: as the prediction")
    delta: float = setting(0.5, above=0.0, high=1.0, doc="damping of the forecast coefficients (18)")
    initial_forecast: float = setting(0.175, doc="theta_0, every forecast coefficient at the start (18)")
    forecast_order: int = setting(4, low=1, doc="order n_m of the forecast (18)")
    forecast_limit: float = setting(2.0, above=0.0, doc="M: forecast coefficients are reset at this length")
    limits: str = setting(
        "qp",
        choices=("qp", "clip"),
        doc="input and rate limits: over the control horizon in a QP, or the first change clipped",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.control_horizon > self.horizon:
            raise ConfigError(
                f"MFAPC: control_horizon = {self.control_horizon} is longer than horizon = {self.horizon}"
            )

    def _prepare(self, loop: Loop, form: Form) -> None:
        steps = self.control_horizon or self.horizon
        self._prediction = LinearisedPrediction(form.regressors(), form.inputs, self.horizon, steps)
        self._ridge = self.lambda_u * np.eye(steps * form.inputs)
        rates = rate_limits(self.rate_bounds, form.inputs) / self._scales.u
        self._limits = ChangeLimits(loop.bounds, rates, steps, self.limits == "qp")
        constants = Forecast(
            delta=self.delta,
            theta_0=self.initial_forecast,
            n_m=self.forecast_order,
            theta_limit=self.forecast_limit,
        )
        self._forecasts = [GradientForecast(gradient, constants) for gradient in self._model.gradients]

    def _decide(self, sample: Sample) -> tuple[list[float], str]:
        gradients: list[float] = []
        for forecast in self._forecasts:
            forecast.update()
            gradients += forecast.ahead(self.horizon)
        a, f = self._prediction(gradients, self._model.known)
        error = (sample.reference - sample.y).reshape(-1)  # Y* - E y_k - f
        error -= f
        # Products in place and by np.dot: on matrices this small the calls are what costs.
        hessian, slope = np.dot(a.T, a), np.dot(a.T, error)
        hessian += self._ridge
        changes = self._unlimited(a, error, hessian, slope)  # (20)
        return self._limits.apply(self._u, changes, hessian, slope)  # (21)
