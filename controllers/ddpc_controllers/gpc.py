"""Adaptive generalised predictive control: a model of changes, learned in the loop, and a plan of changes.

    min  sum_j=1..N |r_k+j - y_k+j|_Q^2 + sum_j=0..Nu-1 |du_k+j|_Lambda^2

within the limits of the inputs and of their rates, the inputs changing at the first Nu samples. With the
model of :mod:`~ddpc_controllers.models.recursive` the outputs to come are ``Y = E y_k + f + G dU``: f is what
happens without further changes, G has the step response. Where no limit is active

    dU = (G'QG + Lambda)^-1 G'Q (R - E y_k - f),   u_k = u_k-1 + (the first change of dU).

D. W. Clarke, C. Mohtadi, P. S. Tuffs, Generalized predictive control, parts I and II, Automatica 23(2), 1987,
doi:10.1016/0005-1098(87)90087-2 and 90088-4. There G and f come from a Diophantine equation; here the model
is run over the horizon, which gives the same.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import ClassVar, Literal

import numpy as np

from ddpc_controllers.checks import per_signal, prior_info
from ddpc_controllers.data.hankel import (
    matching_recording,
    require_informative,
    resting_input,
)
from ddpc_controllers.data.quality import Span, judge
from ddpc_controllers.export.code import ALL_AHEAD, Code
from ddpc_controllers.models.data_model import Form
from ddpc_controllers.models.data_model_prediction import LinearisedPrediction
from ddpc_controllers.models.recursive import Changes, Lengths, RecursiveLeastSquares, recorded_changes
from ddpc_controllers.optimisation.limits import HELD, ChangeLimits, least_changes, rate_limits
from ddpc_controllers.optimisation.qp import StepInfo, action, changes_info, predicted_ends
from ddpc_controllers.scaling import ScaledSignals
from ddpc_cosim import (
    Action,
    ConfigError,
    DataError,
    Factor,
    FloatArray,
    Integer,
    Linear,
    Loop,
    Recording,
    Sample,
    Weight,
    setting,
)

InitialModel = Literal["recording", "gradient"]


@dataclass(kw_only=True)
class GPC(ScaledSignals):
    """Adaptive generalised predictive control.

    It begins with the least squares of a recording, or with a gradient and no recording, and learns on. A
    measurement that is not finite is a fallback: the inputs are held, and nothing is learned before the
    model's past is known again; the estimates stay.
    """

    _known_in_c: ClassVar[Collection[str]] = ALL_AHEAD

    accepts_missing: ClassVar[bool] = True

    horizon: int = setting(10, low=1, doc="prediction horizon N, samples", search=Integer(3, 30))
    control_horizon: int = setting(0, low=0, doc="control horizon Nu <= N, samples; 0: as the prediction")
    output_weight: Weight = setting(1.0, low=0.0, doc="Q: predicted outputs off the reference")
    change_weight: Weight = setting(
        0.1, above=0.0, doc="Lambda: changes of the inputs", search=Factor(1e-4, 1e2)
    )
    output_length: int = setting(
        2, low=1, doc="Ly: output changes in the model, samples", search=Integer(1, 6)
    )
    input_length: int = setting(
        3, low=1, doc="Lu: input changes in the model, samples; covers a dead time", search=Integer(1, 8)
    )
    observer_pole: float = setting(
        0.8,
        low=0.0,
        high=0.99,
        doc="c of the observer polynomial T = 1 - c/q: near 1 where measurements are noisy",
        search=Linear(0.0, 0.95),
    )
    forgetting_factor: float = setting(
        0.99,
        above=0.0,
        high=1.0,
        doc="lambda: weight that each sample leaves to those before",
        search=Linear(0.9, 1.0),
    )
    covariance_limit: float = setting(
        1e3, above=0.0, doc="nothing is forgotten where the covariance's trace would exceed this"
    )
    dead_zone: float = setting(
        0.0, low=0.0, doc="nothing is learned where predictions are off by no more, in scaled outputs"
    )
    initial_model: InitialModel = setting(
        "recording",
        choices=("recording", "gradient"),
        doc="what it begins with: the recording's least squares, or initial_gradient and no recording",
    )
    initial_gradient: Weight = setting(
        0.1,
        doc="without a recording, with the sign of the control direction: a number or a list for the "
        "diagonal, p x m for the latest input changes, or p x (p Ly + m Lu) in the order of the model",
    )
    initial_covariance: float = setting(
        100.0, above=0.0, doc="diagonal of the covariance before the first sample, recorded ones included"
    )
    use_forecast: bool = setting(
        True, doc="predict with the forecasts of known disturbances; otherwise what is measured is held"
    )
    rate_bounds: Weight = setting(
        (), above=0.0, doc="largest change of each input per sample, in its unit; empty: none"
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.control_horizon > self.horizon:
            raise ConfigError(
                f"GPC: control_horizon = {self.control_horizon} is longer than horizon = {self.horizon}"
            )

    @property
    def uses_recording(self) -> bool:
        """Whether ``start`` needs a recording."""
        return self.initial_model == "recording"

    def recording_length(self, inputs: int, outputs: int, measurements: int, disturbances: int = 0) -> int:
        """Return the samples with as many equations as each output has coefficients."""
        lengths = self._lengths(outputs, inputs, disturbances)
        return lengths.terms + max(self.output_length, self.input_length) + 1

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return the signals it uses, and its prior information about the plant."""
        prior = "nothing" if self.uses_recording else "a first gain, by initial_gradient"
        facts = prior_info(prior, loop.outputs)
        if loop.disturbances:
            names = ", ".join(variable.name for variable in loop.disturbances)
            facts["forecast"] = names if self.use_forecast else "measured only"
        return facts

    def _start(self, loop: Loop) -> None:
        import scipy.linalg.lapack  # noqa: F401 - here, and not in the first step, whose time counts

        p, m, n_d = len(loop.outputs), len(loop.inputs), len(loop.disturbances)
        lengths = self._lengths(p, m, n_d)
        steps = self.control_horizon or self.horizon
        form = Form(p, m, self.output_length, self.input_length)
        self._prediction = LinearisedPrediction(form.regressors(), m, self.horizon, steps)
        self._roots = np.tile(np.sqrt(per_signal("output_weight", self.output_weight, p)), self.horizon)
        self._ridge = np.tile(per_signal("change_weight", self.change_weight, m), steps)
        rates = rate_limits(self.rate_bounds, m) / self._scales.u
        self._limits = ChangeLimits(loop.bounds, rates, steps, optimise=True)
        self._moving = bool({variable.name for variable in loop.inputs} & {*loop.moving_limits})
        self._ends, self._unit = predicted_ends(loop.outputs), self._scales.y
        self._model_terms = lengths.model_terms
        self._changes = Changes(lengths, self.observer_pole)
        self._u: FloatArray = resting_input(loop)
        self._model = self._first_model(loop, lengths, form)
        self._take_over(loop, lengths)

    def _lengths(self, outputs: int, inputs: int, disturbances: int) -> Lengths:
        return Lengths(outputs, inputs, disturbances, self.output_length, self.input_length)

    def _first_model(self, loop: Loop, lengths: Lengths, form: Form) -> RecursiveLeastSquares:
        """Return the estimates before the first sample."""
        coefficients = np.zeros((lengths.terms, lengths.outputs))
        root = np.sqrt(self.initial_covariance) * np.eye(lengths.terms)
        if self.uses_recording:
            coefficients, root = self._from_recording(matching_recording(loop, "GPC"), loop, lengths, root)
        else:
            coefficients[: lengths.model_terms] = form.initial_gradients(self.initial_gradient).T
        return RecursiveLeastSquares(
            coefficients, root, self.forgetting_factor, self.covariance_limit, self.dead_zone
        )

    def _from_recording(
        self, recording: Recording, loop: Loop, lengths: Lengths, root: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the least squares of a recording, and the root of their covariance.

        Recursive least squares that forget nothing, from zero and the initial covariance, lead there too.
        """
        regressors, targets = recorded_changes(Changes(lengths, self.observer_pole), recording.pieces)
        needed = self.recording_length(lengths.inputs, lengths.outputs, 0, lengths.disturbances)
        if len(regressors) < lengths.terms:
            raise DataError(
                f"GPC: the recording has {len(recording)} samples, of which {len(regressors)} can be learned "
                f"from; its model takes at least {needed} in one piece: record longer, or lower "
                "output_length or input_length"
            )
        newest = slice(first := lengths.outputs * lengths.output_length, first + lengths.inputs)
        require_informative(regressors[:, newest], np.delete(regressors, newest, axis=1), "GPC")
        spans = [Span(self.horizon, "horizon"), Span(self.input_length, "input_length")]
        self._judgement = judge("GPC", recording, loop.outputs, spans)
        prior = np.eye(lengths.terms) / root[0, 0]
        directions, triangular = np.linalg.qr(np.vstack([regressors, prior]))
        stacked = np.vstack([targets, np.zeros((lengths.terms, lengths.outputs))])
        inverse = np.linalg.inv(triangular)
        return inverse @ (directions.T @ stacked), inverse

    def _take_over(self, loop: Loop, lengths: Lengths) -> None:
        """Go on from the recording's last sample, or learn from the past of a running plant as if its own."""
        if loop.continues_recording and loop.recording is not None:
            last = loop.recording.pieces[-1]
            recorded_changes(self._changes, [last])
            self._u = last.u[-1].copy()
        elif loop.past:
            for u, y, d in zip(loop.past.u, loop.past.y, loop.past.d, strict=True):
                self._learn(y, d)
                self._changes.apply(u - self._u)
                self._u = u.copy()

    def _learn(self, y: FloatArray, d: FloatArray) -> None:
        pair = self._changes.observe(y, d)
        if pair is not None:
            self._model.update(*pair)
            self._changes.judge(self._model.coefficients)

    def _step(self, sample: Sample) -> Action:
        """Return the last inputs plus the first change of the plan."""
        y, d = sample.y, sample.disturbance
        if not isfinite(float(y.sum() + d.sum())):
            self._changes.forget()
            return Action(self._u.copy(), HELD)
        self._learn(y, d)
        a, error = self._predict(sample)
        weighted, missed = a * self._roots[:, np.newaxis], error * self._roots
        hessian, slope = weighted.T @ weighted, weighted.T @ missed
        hessian.flat[:: len(slope) + 1] += self._ridge
        changes = least_changes(weighted, missed, hessian, slope, self._ridge)
        if self._moving:
            self._limits.move(sample.input_limits[0])
        last = self._u.tolist()
        applied, fault = self._limits.apply(last, changes, hessian, slope)
        known = a, error, sample.reference, self._limits.plan, last, applied
        u = np.array(applied)
        self._changes.apply(u - self._u)
        self._u = u
        how = self._limits, self._ends, self._unit, self._roots, self._ridge
        return action(u.copy(), fault, StepInfo(changes_info, (*how, *known)))

    def _predict(self, sample: Sample) -> tuple[FloatArray, FloatArray]:
        """Return G, and R - E y_k - f."""
        changes, theta = self._changes, self._model.coefficients
        gradients = np.repeat(theta[: self._model_terms].T[:, np.newaxis], self.horizon, axis=1)
        known = np.concatenate([changes.dy, changes.du[: len(changes.du) - len(self._u)]])
        a, f = self._prediction(gradients.ravel().tolist(), known.tolist(), self._acting(sample))
        return a, (sample.reference - sample.y).ravel() - f

    def _acting(self, sample: Sample) -> FloatArray:
        """Return what else changes the outputs at each sample of the horizon, shape (N p,)."""
        changes, n_d = self._changes, sample.disturbance.size
        acting = np.zeros((self.horizon, len(self._unit)))
        acting[0] = -self.observer_pole * changes.residual
        if n_d:
            ahead = np.zeros((self.horizon, n_d))
            if self.use_forecast:
                course = np.vstack([sample.disturbance, sample.forecast[: self.horizon]])
                ahead[: len(course) - 1] = np.diff(course, axis=0)
            whole = np.vstack([changes.dd.reshape(-1, n_d)[::-1], ahead])
            of_disturbances = self._model.coefficients[self._model_terms :].reshape(-1, n_d, len(self._unit))
            for lag, block in enumerate(of_disturbances):
                first = self.input_length - lag
                acting += whole[first : first + self.horizon] @ block
        return acting.ravel()

    def _c_step(self, code: Code, loop: Loop) -> str:
        """Add the method, with what it has learned."""
        code.kernel("gpc")
        p, n_d, terms = len(loop.outputs), len(loop.disturbances), len(self._model.root)
        ahead = self.horizon if self.use_forecast and n_d else 0
        prediction, prediction_held = self._prediction.in_c(code)
        limits, limits_held, look = self._limits.in_c(code, moving=self._moving)
        gpc = code.constant(
            "GPC",
            prediction=f"&{prediction}",
            n_d=n_d,
            ahead=ahead,
            filtered=self.observer_pole,
            forgetting=self.forgetting_factor,
            largest_trace=self.covariance_limit,
            dead_zone=self.dead_zone,
            roots=code.doubles(self._roots[:p]),
            ridge=code.doubles(self._ridge),
            limits=f"&{limits}",
        )
        course = code.memory(np.zeros((1 + ahead) * n_d))
        held = code.held(
            "GPCMemory",
            *(self._u, *self._changes.signals, self._model.coefficients.T, self._model.root),
            *map(np.zeros, (terms, terms, terms**2)),
            course,
            np.zeros(self.horizon * p),
            prediction_held,
            limits_held,
        )
        if n_d and code.ahead:

            def known(sample: Sample) -> FloatArray:
                return np.vstack([sample.disturbance, sample.forecast[:ahead]])

            look += code.ahead.chosen(code, known, course)
        return code.step(f"{look}{held}gpc_step(&{gpc}, &held, sample, u, told);")
