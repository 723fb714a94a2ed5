"""A Kalman filter for a linear model with a constant disturbance, and the controllers that rest on it.

    x^ <- x^ + K (y - C x^ - F d),   x^ <- A x^ + B u + E d,   K = P C' (C P C' + R)^-1

with P the covariance of the steady prediction error. Known disturbances are inputs d of the filter.

An unknown one is a state of its own, ``w+ = w``, that the outputs or the inputs carry; a regulator that
rejects its estimate has no offset (G. Pannocchia, J. B. Rawlings, Disturbance models for offset-free
model-predictive control, AIChE J. 49(2), 2003, doi:10.1002/aic.690490213).
"""

from abc import abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, NamedTuple, get_args

import numpy as np

from ddpc_controllers.checks import check_settings_and
from ddpc_controllers.data.hankel import numerical_rank, resting_input, running_past
from ddpc_controllers.data.quality import Judgement, Span, judge
from ddpc_controllers.export.code import ALL_AHEAD, Code
from ddpc_controllers.models.control_api import estimator_covariance
from ddpc_controllers.models.identification import Identified
from ddpc_controllers.models.linear import ModelSource, SampledModel
from ddpc_controllers.optimisation.limits import PREDICTED
from ddpc_controllers.optimisation.qp import NO_INFO, action
from ddpc_controllers.scaling import ScaledSignals, Scales
from ddpc_cosim import (
    Action,
    ConfigError,
    FloatArray,
    Log,
    Loop,
    Recording,
    Sample,
    setting,
)

Disturbance = Literal["auto", "output", "input", "none"]
DISTURBANCES: tuple[str, ...] = get_args(Disturbance)

NO_DISTURBANCE: FloatArray = np.empty(0)
_DETECTABLE = 1e-9
_EVERY_STATE = 1e-9
_FEWEST_STEPS = 5
"""Samples ahead that a model is tested at least: a regulator without a horizon needs its prediction too."""


class Observer:
    """The steady Kalman filter of a model with a constant disturbance.

    Parameters
    ----------
    model : SampledModel
        The plant.
    disturbance : {"auto", "output", "input", "none"}
        What carries the disturbance; ``"auto"``: the outputs if they tell it from the states, else the
        inputs. Of a model with a pole that may be an integrator's the inputs come first: a disturbance at its
        outputs would hardly show, and leave an offset for as long.
    process_noise, disturbance_noise, measurement_noise : float
        Standard deviations of what is added to the inputs, of the change of the disturbance per sample, and
        of the measured outputs.

    Attributes
    ----------
    a, b, c, e, f : array
        The model of ``(x, w, 1)``, the 1 carrying the operating point: all signals are in their units.
    state : array, shape (n + n_w + 1,)
        The estimate of ``(x, w, 1)``; changed in place.

    Raises
    ------
    ConfigError
        The outputs do not tell the disturbance from the states.
    """

    def __init__(
        self,
        model: SampledModel,
        disturbance: Disturbance,
        process_noise: float,
        disturbance_noise: float,
        measurement_noise: float,
    ) -> None:
        n, m, p = len(model.a), model.b.shape[1], len(model.c)
        a, c = _with_disturbance(model, disturbance)
        size = len(a) - n
        b = np.vstack([model.b, np.zeros((size, m))])

        drive = np.zeros((n + size, n + size))
        drive[:n, :n] = process_noise**2 * (model.b @ model.b.T)
        # A state that no input drives would make the Riccati equation singular.
        drive[:n, :n] += (
            _EVERY_STATE * max(float(np.trace(drive[:n, :n])) / n, np.finfo(float).tiny) * np.eye(n)
        )
        drive[n:, n:] = disturbance_noise**2 * np.eye(size)
        r = measurement_noise**2 * np.eye(p)
        covariance = estimator_covariance(a, c, drive, r)
        self._gain = np.linalg.solve(c @ covariance @ c.T + r, c @ covariance).T  # P C' (C P C' + R)^-1

        n_d = len(model.d_0)
        e = np.vstack([model.e, np.zeros((size, n_d))])
        constant = -b @ model.u_0[:, np.newaxis] - e @ model.d_0[:, np.newaxis]
        self.a = np.block([[a, constant], [np.zeros((1, n + size)), np.ones((1, 1))]])
        self.b = np.vstack([b, np.zeros((1, m))])
        self.c = np.hstack([c, (model.y_0 - model.f @ model.d_0)[:, np.newaxis]])
        self.e, self.f = np.vstack([e, np.zeros((1, n_d))]), model.f
        self.state = np.zeros(n + size + 1)
        self.state[-1] = 1.0
        self._followed = _Followed((np.empty((0, m)), np.empty((0, p)), np.empty((0, n_d))), self.state)

    def rest(self, u: FloatArray, y: FloatArray, d: FloatArray) -> None:
        """Suppose that the plant rests at u, y and d, shapes (m,), (p,), (n_d,), as nearly as it can."""
        self.state[:] = self.resting_law(u, d) @ np.append(y, 1.0)

    def resting_law(self, u: FloatArray, d: FloatArray) -> FloatArray:
        """Return the state at rest at u and d, given ``(y, 1)``: shape (n + n_w + 1, p + 1)."""
        free, p = slice(None, -1), len(self.c)
        steady = np.vstack([self.a[free, free] - np.eye(len(self.a) - 1), self.c[:, free]])
        drift = self.a[free, -1] + self.b[free] @ u + self.e[free] @ d
        constant = np.append(-drift, -self.c[:, -1] - self.f @ d)
        target = np.column_stack([np.eye(len(constant), p, k=p - len(constant)), constant])
        law = np.linalg.lstsq(steady, target, rcond=_DETECTABLE)[0]
        return np.vstack([law, np.eye(1, p + 1, k=p)])

    def expected(self, d: FloatArray) -> FloatArray:
        """Return the outputs that the estimate shows with disturbances d, shape (p,)."""
        return np.asarray(self.c @ self.state + self.f @ d)

    def correct(self, y: FloatArray, d: FloatArray) -> None:
        """Take measurements, shapes (p,) and (n_d,), the outputs as far as they are finite."""
        surprise = y - self.expected(d)
        self.state[:-1] += self._gain @ np.where(np.isfinite(surprise), surprise, 0.0)

    def predict(self, u: FloatArray, d: FloatArray) -> None:
        """Go on by one sample with inputs u, shape (m,), and disturbances d, shape (n_d,)."""
        self.state[:] = self.a @ self.state + self.b @ u + self.e @ d

    def constant(self, code: Code) -> str:
        """Add the filter to code in C; return its name."""
        code.kernel("observer")
        p, n = self.c.shape
        tables = {
            "a": self.a,
            "b": self.b,
            "c": self.c,
            "gain": np.vstack([self._gain, np.zeros((1, p))]),
            "rest_u": self._resting_gain("inputs"),
        }
        disturbances = self.e.shape[1]
        if disturbances:
            tables |= {"e": self.e, "f": self.f, "rest_d": self._resting_gain("disturbances")}
        named: dict[str, object] = {name: code.doubles(table) for name, table in tables.items()}
        if disturbances:
            named["disturbances"] = disturbances
        return code.constant("Observer", m=self.b.shape[1], p=p, n=n, **named)

    def _resting_gain(self, of: Literal["inputs", "disturbances"]) -> FloatArray:
        """Return what these do to the state at rest, shape (n + n_w + 1, m) or (n + n_w + 1, n_d)."""
        m, n_d = self.b.shape[1], self.e.shape[1]
        size, first = (m, 0) if of == "inputs" else (n_d, m)
        moved = np.eye(1 + size, m + n_d, k=first - 1) * (np.arange(1 + size) > 0)[:, np.newaxis]
        laws = [self.resting_law(signals[:m], signals[m:])[:, -1] for signals in moved]
        return np.array(laws[1:]).T - laws[0][:, np.newaxis]

    def follow(self, recording: Recording) -> None:
        """Run along a recording, in one piece, that begins at rest, up to its last measurement.

        Where it is a longer part of the log that was followed last, it goes on where that ended.
        """
        u, y, d = recording.u, recording.y, recording.d
        first = self._followed.samples_of(u, y, d)
        if first:
            self.state[:] = self._followed.state
        else:
            self.rest(u[0], y[0], d[0])
            self.correct(y[0], d[0])
        for k in range(max(first, 1), len(recording)):
            self.predict(u[k - 1], d[k - 1])
            self.correct(y[k], d[k])
        self._followed = _Followed((u, y, d), self.state.copy())


class _Followed(NamedTuple):
    """What an observer has followed, and its estimate then."""

    signals: tuple[FloatArray, ...]
    state: FloatArray

    def samples_of(self, *signals: FloatArray) -> int:
        """Return how many samples of other signals these are the first ones of; 0: they are others."""
        count = len(self.signals[0])
        alike = zip(self.signals, signals, strict=True)
        return count if all(np.array_equal(seen, given[:count]) for seen, given in alike) else 0


def _preferred(model: SampledModel) -> tuple[Disturbance, Disturbance]:
    """Return what may carry a disturbance, the better first."""
    nearest = np.abs(np.linalg.eigvals(model.a) - 1.0).min()
    return ("input", "output") if nearest < 1.0 / model.samples else ("output", "input")


def _size(matrix: FloatArray, axis: int) -> FloatArray:
    """Return the Euclidean length of a matrix's rows (axis 1) or columns (axis 0), 1 where it is zero."""
    length = np.linalg.norm(matrix, axis=axis, keepdims=True)
    return np.where(length > 0.0, length, 1.0)


def _with_disturbance(model: SampledModel, disturbance: Disturbance) -> tuple[FloatArray, FloatArray]:
    """Return A and C of the model with a constant disturbance that does not hide behind the states."""
    n, m, p = len(model.a), model.b.shape[1], len(model.c)
    carriers = {
        "output": (np.zeros((n, p)), np.eye(p)),
        "input": (model.b, np.zeros((p, m))),
        "none": (np.zeros((n, 0)), np.zeros((p, 0))),
    }
    hidden = {}
    # Units must not decide what is seen: every output, and every disturbance, counts in its own size.
    seen = model.c / _size(model.c, 1)
    for kind in _preferred(model) if disturbance == "auto" else (disturbance,):
        in_state, in_output = carriers[kind]
        size = in_state.shape[1]
        a = np.block([[model.a, in_state], [np.zeros((size, n)), np.eye(size)]])
        c = np.hstack([model.c, in_output])
        # What is constant is seen where (A - I; C) has full rank.
        constant = np.block([[model.a - np.eye(n), in_state / _size(in_state, 0)], [seen, in_output]])
        hidden[kind] = n + size - numerical_rank(constant, _DETECTABLE)
        if disturbance == "none" or not hidden[kind]:
            return a, c
    modes = "; ".join(
        f'"{kind}": {count} constant mode(s) hidden' for kind, count in sorted(hidden.items(), reverse=True)
    )
    raise ConfigError(
        f'disturbance = "{disturbance}" cannot be distinguished from the states at the outputs ({modes}): '
        'control more outputs, or choose another, "input" for a plant that integrates, or "none"'
    )


@dataclass(kw_only=True)
class ModelBased(ScaledSignals):
    """Base of the controllers on a linear model.

    A measurement that is not finite is replaced by the model's prediction; before the first finite one the
    inputs stay at rest. Either is a status.
    """

    _known_in_c: ClassVar[Collection[str]] = ALL_AHEAD

    accepts_missing: ClassVar[bool] = True

    model: ModelSource = setting(default_factory=Identified, doc="where the linear model comes from")
    process_noise: float = setting(
        1.0, above=0.0, doc="filter: standard deviation of what adds to the inputs"
    )
    measurement_noise: float = setting(
        0.1, above=0.0, doc="filter: standard deviation of the measurements", search=Log(1e-3, 1e2)
    )

    def __post_init__(self) -> None:
        check_settings_and(self, self._faults_between_settings)

    @property
    def uses_recording(self) -> bool:
        """Whether ``start`` needs a recording."""
        return self.model.uses_recording

    def recording_length(self, inputs: int, outputs: int, measurements: int, disturbances: int = 0) -> int:
        """Return the fewest samples that the model's identification can work with."""
        return self.model.recording_length(inputs + disturbances, outputs)

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return the signals it uses, and its prior information about the plant."""
        model = self.model
        if isinstance(model, Identified):
            return self._facts("nothing", loop.outputs)
        return self._facts(f"a linear model, by {type(model).__name__}", loop.outputs)

    def start(self, loop: Loop) -> None:
        """Get the model, and start on the loop in scaled signals.

        Raises
        ------
        DataError
            The recording cannot serve the model's identification.
        ConfigError
            The model or a setting does not fit the loop.
        """
        loop = self._see(loop)
        self._model = self._scaled_model(loop, self._scales)
        self._judgement = self._judge(self._scales.loop)
        self._start_scaled()

    def restart(self, loop: Loop) -> None:
        """Begin anew with another past: the model and all that follows from it stay."""
        self._begin(self._again(loop))

    def _judge(self, loop: Loop) -> Judgement:
        """Test the prediction of a model that is identified from the recording."""
        if not isinstance(self.model, Identified) or loop.recording is None:
            return Judgement()
        steps = max(self.horizon, _FEWEST_STEPS)
        spans = [*self._ahead, Span(int(self._model.fit["lags"]), "lags")]
        tested = self.model.test(loop, steps), steps
        return judge(type(self).__name__, loop.recording, loop.outputs, spans, tested)

    @property
    def _ahead(self) -> Sequence[Span]:
        """How far the method looks ahead; empty: for ever."""
        return ()

    def diagnostics(self) -> Mapping[str, float]:
        """Return the quality of the model's identification."""
        return {**self._model.fit, **self._judgement.diagnostics}

    def warnings(self) -> Sequence[str]:
        """Return warnings about the recording or the model."""
        return [*super().warnings(), *self._model.warnings]

    def _scaled_model(self, loop: Loop, scales: Scales) -> SampledModel:
        """Return the model of scaled signals: identified from them, or given for the signals themselves."""
        if self.model.uses_recording:
            return self.model.model(scales.loop)
        given = self.model.model(loop)
        return replace(
            given,
            b=given.b * scales.u,
            c=given.c / scales.y[:, None],
            u_0=given.u_0 / scales.u,
            y_0=given.y_0 / scales.y,
            e=given.e * scales.d,
            f=given.f * scales.d / scales.y[:, None],
            d_0=given.d_0 / scales.d,
        )

    def _observe(self, loop: Loop, disturbance: Disturbance, disturbance_noise: float) -> None:
        """Set up the filter, and begin."""
        self._observer = Observer(
            self._model, disturbance, self.process_noise, disturbance_noise, self.measurement_noise
        )
        self._disturbed = bool(loop.disturbances)
        self._begin(loop)

    def _begin(self, loop: Loop) -> None:
        """Begin at rest, or where a running plant is, or the recording ends if the loop goes on there."""
        self._u: FloatArray = resting_input(loop)
        self._resting = True
        self._info: Mapping[str, float] = NO_INFO
        if past := running_past(loop):
            self._observer.follow(past)
            self._u, self._resting = past.u[-1], False
            self._take_over(past)
            self._observer.predict(self._u, past.d[-1])

    def _take_over(self, past: Recording) -> None:
        """Go on from the last sample of a running plant, to which the estimate belongs."""

    def _step(self, sample: Sample) -> Action:
        """Correct the estimate, decide on the inputs, and predict what they do."""
        missing = "" if np.isfinite(sample.y).all() else PREDICTED
        d = sample.disturbance if self._disturbed else NO_DISTURBANCE
        if self._resting:
            if missing:
                return Action(self._u.copy(), missing)
            self._observer.rest(self._u, sample.y, d)
            self._resting = False
        self._observer.correct(sample.y, d)
        u, fallback = self._decide(sample)
        self._observer.predict(u, d)
        self._u = u.copy()
        return action(u, fallback or missing, self._info)

    def _c_step(self, code: Code, loop: Loop) -> str:
        """Add the filter and what decides to the code."""
        state = self._observer.state
        n_d = len(loop.disturbances)
        observer, rest = self._observer.constant(code), self._observer.resting_law(self._u, np.zeros(n_d))
        members = [self._resting], self._u, state, rest, np.zeros(len(state) + len(loop.outputs) + n_d)
        *others, scratch = [code.memory(start) for start in members]
        look = ""
        if self._disturbed and code.ahead:
            place = f"{scratch} + {len(state) + len(loop.outputs)}"
            look = code.ahead.chosen(code, lambda sample: sample.disturbance, place)
        return code.step(
            f"{look}{code.held('ObserverMemory', *others, scratch)}"
            f"if (!observe(&{observer}, &held, sample, u, told)) return;\n"
            f"{self._c_decide(code, loop, observer)}\n"
            f"predict(&{observer}, &held, u);"
        )

    def _c_decide(self, code: Code, loop: Loop, observer: str) -> str:
        """Return statements in C that decide on u, given what a named observer ``held``."""
        return super()._c_step(code, loop)  # which refuses

    @abstractmethod
    def _decide(self, sample: Sample) -> tuple[FloatArray, str]:
        """Return the inputs for the present estimate, and why they are a fallback; empty if they are not."""

    def _faults_between_settings(self) -> list[str]:
        if isinstance(self.model, ModelSource):
            return []
        who = type(self).__name__
        return [f"{who}: model = {self.model!r} is not a source of models; an example is Identified()"]
