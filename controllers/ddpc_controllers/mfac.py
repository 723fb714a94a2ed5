"""Model-free adaptive control, one step ahead (MFAC) and predictive (MFAPC, equations (14)-(21)).

With the data model (14) at the samples k ... k+N-1 the outputs to come are ``Y = E y_k + f + A dU``, where f
is what past changes still do, and A and f are made of the (forecast) pseudo-gradients. The control law is

    min |Y* - Y|^2 + lambda |dU|^2                            (19)
    dU = (A'A + lambda I)^-1 A' (Y* - E y_k - f)              (20)
    u_k = u_k-1 + (the first change of dU)                    (21)

within the limits of the inputs and of their rates. MFAC looks at the next sample only, N = 1, and applies rho
times the change.

Both on the three forms of the data model. MFAC: Z. Hou and S. Jin, Model Free Adaptive Control: Theory and
Applications, CRC Press, 2013, chapter 4; Z. Hou and S. Jin, IEEE Transactions on Neural Networks 22(12),
2011, doi:10.1109/TNN.2011.2176141 (several inputs and outputs). MFAPC: the paper prints the compact form
(CFDL) and refers to chapter 5 of the former for the partial (PFDL) and the full form (FFDL).
"""

from abc import abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from math import isfinite
from operator import sub
from typing import Any, ClassVar

import numpy as np

from ddpc_controllers.checks import prior_info, without_forecast
from ddpc_controllers.data.hankel import resting_input
from ddpc_controllers.data.quality import Judgement, Span, judge
from ddpc_controllers.export.code import ALL_AHEAD, Code
from ddpc_controllers.models.data_model import DataModel, Estimation, Form
from ddpc_controllers.models.data_model_prediction import Forecast, GradientForecast, LinearisedPrediction
from ddpc_controllers.optimisation.limits import HELD, ChangeLimits, least_changes, rate_limits
from ddpc_controllers.optimisation.qp import (
    StepInfo,
    action,
    changes_info,
    predicted_ends,
)
from ddpc_controllers.scaling import ScaledSignals
from ddpc_cosim import (
    Action,
    Choice,
    ConfigError,
    Controller,
    Factor,
    FloatArray,
    Integer,
    Linear,
    Log,
    Loop,
    Sample,
    Weight,
    setting,
)


@dataclass(kw_only=True)
class ModelFreeAdaptive(ScaledSignals):
    """Base of the controllers on a data model (14); not a controller by itself.

    Needs no recording: it estimates how the outputs follow the inputs while it controls. A measurement that
    is not finite is a fallback: the inputs are held, nothing is learned, and the signals before it are
    forgotten, but not the estimates.
    """

    _known_in_c: ClassVar[Collection[str]] = ALL_AHEAD

    accepts_missing: ClassVar[bool] = True

    form: str = setting(
        "cfdl",
        choices=("cfdl", "pfdl", "ffdl"),
        doc="data model: compact, partial or full form",
        search=Choice(("cfdl", "pfdl", "ffdl")),
    )
    input_length: int = setting(3, low=1, doc="Lu: input changes in the partial and the full form, samples")
    output_length: int = setting(1, low=1, doc="Ly: output changes in the full form, samples")
    structure: str = setting(
        "full",
        choices=("full", "diagonal"),
        doc="whether each output follows all inputs, or only its own (and its own past)",
    )
    lambda_u: float = setting(
        0.37, above=0.0, doc="weight of the input changes, lambda in (19)", search=Log(1e-3, 1e2)
    )
    eta: float = setting(
        1.0, above=0.0, high=2.0, doc="step factor of the estimation (16)", search=Linear(0.01, 2.0)
    )
    mu: float = setting(1.0, above=0.0, doc="damping of the estimation (16)", search=Log(1e-3, 1e2))
    epsilon: float = setting(1e-5, above=0.0, doc="smallest change and gradient that are trusted (17)")
    assume_sign: bool = setting(
        True,
        doc="hold the direction of control against the estimates (17), Remark 1; otherwise they may change "
        "their sign, and a quiet loop keeps its last one",
    )
    initial_gradient: Weight = setting(
        0.1,
        doc="phi_1 with the sign of the control direction: a number or a list for the diagonal, p x m for "
        "the latest input changes, or p x (p Ly + m Lu) in the order of the data model",
        search=Factor(1e-1, 1e1),
    )
    rate_bounds: Weight = setting(
        (), above=0.0, doc="largest change of each input per sample, in its unit; empty: none"
    )

    def _begin(self, loop: Loop, steps: int, optimise: bool) -> None:
        """Forget what was learned; ``steps`` is the control horizon, over which a QP may keep the limits."""
        import scipy.linalg.lapack  # noqa: F401 - here, and not in the first step, whose time counts

        p, m = len(loop.outputs), len(loop.inputs)
        ly = self.output_length if self.form == "ffdl" else 0
        lu = self.input_length if self.form != "cfdl" else 1
        form = Form(p, m, ly, lu, self.structure == "diagonal")
        constants = Estimation(eta=self.eta, mu=self.mu, epsilon=self.epsilon, assume_sign=self.assume_sign)
        self._model = DataModel(form, form.initial_gradients(self.initial_gradient), constants)
        self._prediction = LinearisedPrediction(form.regressors(), m, self.horizon, steps)
        self._ridge = self.lambda_u * np.eye(steps * m)
        rates = rate_limits(self.rate_bounds, m) / self._scales.u
        self._limits = ChangeLimits(loop.bounds, rates, steps, optimise)
        self._ends, self._unit = predicted_ends(loop.outputs), self._scales.y
        self._u: list[float] = resting_input(loop).tolist()
        self._forecasts: list[GradientForecast] = []
        self._judgement = Judgement()
        if loop.recording:
            self._judgement = judge(type(self).__name__, loop.recording, loop.outputs, [self._ahead])
        self._moving = bool({variable.name for variable in loop.inputs} & {*loop.moving_limits})
        if loop.continues_recording and loop.recording is not None:
            self._u = loop.recording.u[-1].tolist()
            self._model.resume(loop.recording.pieces[-1])

    def _take_over(self, loop: Loop) -> None:
        """Learn from the past of a running plant as if it had controlled that."""
        if loop.continues_recording or not loop.past:
            return
        for u, y in zip(loop.past.u, loop.past.y, strict=True):
            self._model.observe(y.tolist())
            self._gradients()
            self._model.apply(list(map(sub, u.tolist(), self._u)))
            self._u = u.tolist()

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return the signals it uses, and its prior information about the plant."""
        if not isinstance(self.initial_gradient, float | int):
            prior = "its gradient to begin with"
        else:
            prior = "the sign of its gain" if self.assume_sign else "a first gain"
        return without_forecast(prior_info(f"{prior}, by initial_gradient", loop.outputs), loop)

    def _step(self, sample: Sample) -> FloatArray | Action:
        """Return the last inputs plus the change that the control law finds."""
        y: list[float] = sample.y.tolist()
        if not isfinite(sum(y)):
            self._model.pause()
            return Action(np.array(self._u), HELD)
        self._model.observe(y)
        a, f = self._prediction(self._gradients(), self._model.known)
        error = (sample.reference - sample.y).reshape(-1)  # Y* - E y_k - f
        error -= f
        # Products in place and by np.dot: on matrices this small the calls are what costs.
        hessian, slope = np.dot(a.T, a), np.dot(a.T, error)
        hessian += self._ridge
        changes = self._unlimited(a, error, hessian, slope)
        if self._moving:
            self._limits.move(sample.input_limits[0])
        u, fault = self._limits.apply(self._u, changes, hessian, slope)  # (21)
        known = a, error, sample.reference, self._limits.plan, self._u, u  # its cost is (19)
        info = StepInfo(changes_info, (self._limits, self._ends, self._unit, 1.0, self.lambda_u, *known))
        self._model.apply(list(map(sub, u, self._u)))
        self._u = u
        return action(np.array(u), fault, info)

    def _unlimited(
        self, a: FloatArray, error: FloatArray, hessian: FloatArray, slope: FloatArray
    ) -> FloatArray:
        """Return the changes that minimise (19), limits aside: (20)."""
        return least_changes(a, error, hessian, slope, self.lambda_u)

    def _c_step(self, code: Code, loop: Loop) -> str:
        """Add the method, with what it has learned."""
        code.kernel("adaptive")
        prediction, prediction_held = self._prediction.in_c(code)
        limits, limits_held, look = self._limits.in_c(code, moving=self._moving)
        adaptive = code.constant(
            "Adaptive",
            prediction=f"&{prediction}",
            assume_sign=self.assume_sign,
            eta=self.eta,
            mu=self.mu,
            epsilon=self.epsilon,
            ridge=code.doubles(np.diag(self._ridge)),
            **self._own_constants(),
            initial=code.doubles([row.initial for row in self._model.gradients]),
            limits=f"&{limits}",
        )
        gradients = np.array([row.value for row in self._model.gradients])
        known, y, changes = self._model.signals
        theta, past = (
            [getattr(forecast, name) for forecast in self._forecasts] for name in ("theta", "newest_first")
        )
        held = code.held(
            "AdaptiveMemory",
            *(known, y, changes, self._u, gradients, theta, past, np.zeros(gradients.shape[1])),
            prediction_held,
            limits_held,
        )
        return code.step(f"{look}{held}adaptive_step(&{adaptive}, &held, sample, u, told);")

    @abstractmethod
    def _own_constants(self) -> dict[str, float]:
        """Return the constants that the other methods do not have, for code in C."""

    @property
    def _ahead(self) -> Span:
        """How far the method looks ahead."""
        return Span(self.horizon, "horizon")

    @abstractmethod
    def _gradients(self) -> list[float]:
        """Return Phi_k, ..., Phi_k+N-1 of every output, one after another."""


@dataclass(kw_only=True)
class MFAC(ModelFreeAdaptive):
    """Model-free adaptive control: the change of the inputs that serves the next sample best.

    With one input and one output and all of the book's step factors rho_i equal to ``step_factor``, these
    are its laws. With several, the book divides by ``lambda + |Phi|^2``; here the one-step cost is minimised
    exactly, so that channels that do not act on each other do not slow each other down.
    """

    lambda_u: float = setting(
        0.1, above=0.0, doc="weight of the input changes, lambda in (19)", search=Log(1e-3, 1e2)
    )
    step_factor: float = setting(
        1.0, above=0.0, high=1.0, doc="step factor rho of the control law", search=Log(5e-3, 1.0)
    )

    def _start(self, loop: Loop) -> None:
        self._begin(loop, steps=1, optimise=False)
        self._take_over(loop)

    @property
    def _ahead(self) -> Span:
        return Span(1, "the one-step law", "choose MFAPC, which looks further ahead")

    def _gradients(self) -> list[float]:
        return [phi for gradient in self._model.gradients for phi in gradient.value]

    def _unlimited(
        self, a: FloatArray, error: FloatArray, hessian: FloatArray, slope: FloatArray
    ) -> FloatArray:
        return self.step_factor * super()._unlimited(a, error, hessian, slope)

    def settings_as(
        self, other: type[Controller], inputs: int, outputs: int, samples: int
    ) -> Mapping[str, Any] | None:
        """Return the settings with which MFAPC does the same: only whole steps are what it takes."""
        if type(self) is not MFAC or other is not MFAPC or self.step_factor < 1.0:
            return None
        shared = {field.name: getattr(self, field.name) for field in fields(ModelFreeAdaptive)}
        return shared | {"horizon": 1, "control_horizon": 0, "limits": "clip"}

    def _own_constants(self) -> dict[str, float]:
        return {"step_factor": self.step_factor}


@dataclass(kw_only=True)
class MFAPC(ModelFreeAdaptive):
    """Model-free adaptive predictive control (14)-(21).

    The defaults are those of Table 2. Every coefficient of the data model is forecast by itself. With a
    diagonal structure it is one loop for each pair of signals; with the full one the loops share their
    estimation, and a channel that does not move leaves the others as if they were alone.
    """

    horizon: int = setting(5, low=1, doc="prediction horizon N, samples", search=Integer(2, 20))
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

    def _start(self, loop: Loop) -> None:
        self._begin(loop, steps=self.control_horizon or self.horizon, optimise=self.limits == "qp")
        constants = Forecast(
            delta=self.delta,
            theta_0=self.initial_forecast,
            n_m=self.forecast_order,
            theta_limit=self.forecast_limit,
        )
        self._forecasts = [GradientForecast(gradient, constants) for gradient in self._model.gradients]
        self._take_over(loop)

    def _gradients(self) -> list[float]:
        gradients: list[float] = []
        for forecast in self._forecasts:
            forecast.update()
            gradients += forecast.ahead(self.horizon)
        return gradients

    def _own_constants(self) -> dict[str, float]:
        return {
            "step_factor": 1.0,
            "forecast_order": self.forecast_order,
            "delta": self.delta,
            "theta_0": self.initial_forecast,
            "theta_limit": self.forecast_limit,
        }
