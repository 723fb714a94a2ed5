"""Koopman model predictive control: an EDMD model in place of WKPC's recording.

The lifted state is measured, so it needs no observer; what the model gets wrong about it is low-pass filtered
and taken for a constant disturbance, ``z+ = A z + B u + w``, which leaves no offset (U. Maeder, F. Borrelli,
M. Morari, Linear offset-free model predictive control, Automatica 45(10), 2009,
doi:10.1016/j.automatica.2009.06.005). Cost, horizon and limits are those of (11).

The model is that of extended dynamic mode decomposition with control,

    z+ = A z + B u,   y = C z,   z = (x, psi_1(x), ..., psi_np(x))

by regularised least squares over the recorded samples (M. Korda, I. Mezic, Linear predictors for nonlinear
dynamical systems: Koopman operator meets model predictive control, Automatica 93, 2018,
doi:10.1016/j.automatica.2018.03.046). Without observables z = x: dynamic mode decomposition with control
(J. L. Proctor, S. L. Brunton, J. N. Kutz, SIAM J. Applied Dynamical Systems 15(1), 2016,
doi:10.1137/15M1013857). Of known disturbances d there is ``E d + E_1 d+ + z_0`` in z+ too, where d+ is what
is measured of them at the next sample: that can be the value of the interval before.
"""

import copy
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np

from ddpc_controllers.checks import check_settings_and
from ddpc_controllers.data.dictionaries import (
    Dictionary,
    ThinPlate,
    c_lift,
    embed,
    memory_of,
    require_dictionary,
)
from ddpc_controllers.data.hankel import (
    StateWindow,
    count_windows,
    matching_recording,
    require_informative,
    resting_input,
    window_starts,
    without_first,
)
from ddpc_controllers.data.quality import PredictionTest, Span, fit_by_model, head_of, judge
from ddpc_controllers.export.code import ALL_AHEAD, Code
from ddpc_controllers.models.linear import SampledModel
from ddpc_controllers.mpc import Predictor
from ddpc_controllers.optimisation.limits import PREDICTED
from ddpc_controllers.optimisation.qp import action
from ddpc_controllers.optimisation.tracking import TrackingSettings
from ddpc_controllers.scaling import ScaledSignals
from ddpc_cosim import (
    Action,
    DataError,
    FloatArray,
    Integer,
    Linear,
    Log,
    Loop,
    Recording,
    Sample,
    setting,
)

StateKind = Literal["measured", "delays"]
STATE_KINDS = ("measured", "delays")

_NEGLIGIBLE = 1e-12
_NONE: FloatArray = np.empty(0)


@dataclass(frozen=True, slots=True, kw_only=True)
class LiftedModel(SampledModel):
    """An EDMD model, of the states ``z - at_once d``: what is measured at a sample does not move them.

    Parameters
    ----------
    at_once : array, shape (n_z, n_d)
        E_1.
    constant : array, shape (n_z,)
        z_0.
    """

    at_once: FloatArray
    constant: FloatArray


def fit_lifted_model(
    z: FloatArray,
    u: FloatArray,
    y: FloatArray,
    ridge: float = 0.0,
    seams: Sequence[int] = (),
    d: FloatArray | None = None,
) -> LiftedModel:
    """Fit ``z+ = A z + B u + E d + E_1 d+ + z_0`` by regularised least squares, and ``y = C z``.

    C reads off the outputs that are among the lifted states, and is fitted to others.

    Parameters
    ----------
    z, u, y : array, shapes (T, n_z), (T, m), (T, p)
        Lifted states, inputs and outputs, time along axis 0.
    ridge : float
        Weight of the squared coefficients, for observables and inputs scaled to unit size.
    seams : sequence of int
        The first sample of every piece but the first; none is predicted from the one before a seam.
    d : array, shape (T, n_d), optional
        Known disturbances; without, the model has neither E nor z_0.

    Returns
    -------
    model : LiftedModel
        ``one_step_error`` is the root mean square of the prediction errors of the state predicted worst.

    Raises
    ------
    DataError
        The inputs do not tell their own effect from that of the state.
    """
    now = window_starts(len(z), 2, seams)
    require_informative(u[now], z[now], "EDMD")
    n_z, m, n_d = z.shape[1], u.shape[1], 0 if d is None else d.shape[1]
    known, d_0 = np.hstack([z, u])[now], np.zeros(n_d)
    if d is not None:  # off its mean: what it is on average is told from what it does
        d_0 = d.mean(axis=0)
        known = np.hstack([known, d[now] - d_0, d[now + 1] - d_0, np.ones((len(now), 1))])
    every = np.hstack([z, u])
    size = np.append(_root_mean_square(every), _root_mean_square(known[:, n_z + m :]))
    dynamics = _least_squares(known / size, z[now + 1] / size[:n_z], ridge)
    shown = _least_squares(every[:, :n_z] / size[:n_z], y, 0.0).T / size[:n_z]
    whole = (dynamics.T / size) * size[:n_z, np.newaxis]
    a, b, e, at_once, constant = np.split(whole, np.cumsum([n_z, m, n_d, n_d]), axis=1)
    c = _reading_off(shown, z, y)
    errors = z[now + 1] - known @ whole.T
    fit = {"one_step_error": float(_root_mean_square(errors).max())}
    return LiftedModel(
        *(a, b, c, np.zeros(m), np.zeros(y.shape[1]), len(z), fit),
        e=e + a @ at_once,
        f=c @ at_once,
        d_0=np.zeros(n_d),
        at_once=at_once,
        constant=constant.sum(axis=1) - (e + at_once) @ d_0,
    )


class LiftedState:
    """The lifted state z of a loop: what is measured, or outputs and inputs with their past, and observables.

    Outputs and inputs with their past have that of known disturbances beside them, which is not lifted.

    Parameters
    ----------
    kind : {"measured", "delays"}
        The state x is all that is measured, or ``(y_k ... y_k-d, u_k-1 ... u_k-d)``.
    delays : int
        The d of the latter.
    dictionary : Dictionary
        Observables of x.
    recording : Recording
        The experiment; the window of past samples begins at its end.
    rng : numpy.random.Generator
        Where random parameters of the observables come from.

    Attributes
    ----------
    recorded : array, shape (T - skipped, n_z)
        The lifted recording, time along axis 0.
    skipped : int
        Number of first samples of each piece of the recording that have no past.
    """

    def __init__(
        self,
        kind: StateKind,
        delays: int,
        dictionary: Dictionary,
        recording: Recording,
        rng: np.random.Generator,
    ) -> None:
        self._kind = kind
        delays = delays if kind == "delays" else 0
        memory = memory_of(dictionary)
        states = recording.measured
        if kind == "delays":
            before = np.vstack([recording.u[:1], recording.u[:-1]])
            u_past = embed(before, delays - 1)[-(len(recording) - delays) :]
            states = np.hstack([embed(recording.y, delays), u_past])
            self._y = StateWindow(recording.y[-1 - delays :])
            self._u = StateWindow(before[-delays:])
        self._size = states.shape[1]
        self._states = StateWindow(states[-1 - memory :])
        self.skipped = delays + memory
        # Of a disturbance whose state is measured nothing is left to remember.
        kept = delays if recording.d.shape[1] else 0
        d_before = np.vstack([recording.d[:1], recording.d[:-1]])
        self._d = StateWindow(d_before[len(recording) - kept :])
        embedded = embed(states, memory)[window_starts(len(recording), self.skipped + 1, recording.seams)]
        self._observables = dictionary.draw(embedded, rng)
        self.recorded = self._lift(embedded)
        if kept:
            d_past = embed(d_before, kept - 1)
            later = window_starts(len(recording), self.skipped + 1, recording.seams) + self.skipped
            self.recorded = np.hstack([self.recorded, d_past[later - (kept - 1)]])

    def rest(self, y: FloatArray, measured: FloatArray, u: FloatArray, d: FloatArray = _NONE) -> FloatArray:
        """Suppose that y, (p,), measured, (q,), u, (m,), and d, (n_d,), have always been so; return z."""
        d_past = self._d.fill(d)
        if self._kind == "measured":
            return self._lift(self._states.fill(measured))
        past = np.concatenate([self._y.fill(y), self._u.fill(u)])
        return np.append(self._lift(self._states.fill(past)), d_past)

    def follow(
        self, y: FloatArray, measured: FloatArray, last_u: FloatArray, last_d: FloatArray = _NONE
    ) -> FloatArray:
        """Take the next sample, the inputs applied and the disturbances before it; return z, (n_z,)."""
        if self._kind == "measured":
            return self._lift(self._states.append(measured))
        d_past = self._d.append(last_d) if len(self._d.newest_first) else _NONE
        past = np.concatenate([self._y.append(y), self._u.append(last_u)])
        return np.append(self._lift(self._states.append(past)), d_past)

    def members(self, code: Code) -> dict[str, object]:
        """Add the lift to code in C; return the members of a structure that describe it."""
        delays = self._kind == "delays"
        return {
            "delays": len(self._u.newest_first) if delays else 0,
            "size": self._size,
            "depth": len(self._states.newest_first),
            "lifted": self.recorded.shape[1],
            **c_lift(code, self._observables, self._size),
        }

    @property
    def windows(self) -> tuple[FloatArray, FloatArray]:
        """All that it remembers, the newest first: what states are made of, unless measured, and states."""
        windows = [self._y, self._u] if self._kind == "delays" else []
        past = [value for window in windows for value in window.newest_first.ravel()]
        return np.array(past), self._states.newest_first

    @property
    def disturbances_before(self) -> FloatArray:
        """The past of the disturbances that it remembers, the newest first."""
        return self._d.newest_first.ravel()

    def _lift(self, states: FloatArray) -> FloatArray:
        newest = states[..., : self._size]
        return np.concatenate([newest, self._observables(states)], axis=-1)


def require_samples(samples: int, unknowns: int, who: str) -> None:
    """Check that a least-squares problem has as many equations as unknowns.

    Raises
    ------
    DataError
        The numbers there and needed.
    """
    if samples < unknowns:
        raise DataError(
            f"{who}: {samples} samples are left of the recording for a model of {unknowns} lifted states and "
            "inputs: record longer, or take fewer observables or delays"
        )


def _reading_off(c: FloatArray, z: FloatArray, y: FloatArray) -> FloatArray:
    """Return C with every output that is a lifted state itself read off it.

    Least squares over states that depend on each other, as those of delays do over the recording, would leave
    ``C z`` different from y as soon as a disturbance parts them: an offset.
    """
    for row, output in zip(c, y.T, strict=True):
        same = np.flatnonzero((output == z.T).all(axis=1))
        if same.size:
            row[:] = 0.0
            row[same[0]] = 1.0
    return c


def _least_squares(known: FloatArray, wanted: FloatArray, ridge: float) -> FloatArray:
    size = known.shape[1]
    system = np.vstack([known, np.sqrt(ridge) * np.eye(size)])
    target = np.vstack([wanted, np.zeros((size, wanted.shape[1]))])
    # Least norm: observables that others repeat leave coefficients free.
    solution: FloatArray = np.linalg.lstsq(system, target, rcond=_NEGLIGIBLE)[0]
    return solution


def _root_mean_square(values: FloatArray) -> FloatArray:
    size: FloatArray = np.sqrt(np.square(values).mean(axis=0))
    return np.where(size > 0.0, size, 1.0)


@dataclass(kw_only=True)
class KoopmanMPC(TrackingSettings, ScaledSignals):
    """Model predictive control with an EDMD model.

    Where what is lifted is not finite, the model's prediction replaces it; before the first finite sample the
    inputs stay at rest. Either is a status.
    """

    _known_in_c: ClassVar[Collection[str]] = ALL_AHEAD

    uses_recording: ClassVar[bool] = True
    accepts_missing: ClassVar[bool] = True

    state: StateKind = setting(
        "delays",
        choices=STATE_KINDS,
        doc="state that is lifted: all measured, or outputs and inputs with past",
    )
    delays: int = setting(
        2,
        low=1,
        doc='past samples in the state, with state = "delays"',
        search=Integer(1, 8),
        predicts={"state": "delays"},
    )
    dictionary: Dictionary = setting(
        default_factory=ThinPlate, doc="observables that lift the state; with Identity the model is DMD's"
    )
    ridge: float = setting(
        1e-8,
        low=0.0,
        doc="weight of the squared coefficients in the least squares",
        search=Log(1e-10, 1e-1),
        predicts=True,
    )
    disturbance_gain: float = setting(
        0.5,
        low=0.0,
        high=1.0,
        doc="share of a new one-step error that counts as a disturbance; 0: none",
        search=Linear(0.0, 1.0),
    )

    def __post_init__(self) -> None:
        check_settings_and(self, self.tracking_faults)
        require_dictionary(self.dictionary, "KoopmanMPC: dictionary")

    def _start(self, loop: Loop) -> None:
        """Lift the loop's recording, fit the model and condense its tracking problem."""
        recording = matching_recording(loop, "KoopmanMPC")
        # A copy of the stream: another start draws the same centres.
        rng = copy.deepcopy(loop.rng)
        self._lifted = LiftedState(self.state, self.delays, self.dictionary, recording, rng)
        z, recording = self._lifted.recorded, without_first(recording, self._lifted.skipped)
        n_z, m, seams = z.shape[1], len(loop.inputs), recording.seams
        require_samples(count_windows(len(z), 2, seams), n_z + m + 2 * len(loop.disturbances), "KoopmanMPC")
        self._disturbed = bool(loop.disturbances)
        self._model = model = self._fit(z, recording)
        memory = Span(1, 'state = "measured"', 'set state = "delays"')
        if self.state == "delays":
            memory = Span(self.delays + 1, "delays")
        spans, tested = (Span(self.horizon, "horizon"), memory), (self._test(z, recording), self.horizon)
        self._judgement = judge("KoopmanMPC", recording, loop.outputs, spans, tested)
        # The state of the problem is (z, w).
        a = np.block([[model.a, np.eye(n_z)], [np.zeros((n_z, n_z)), np.eye(n_z)]])
        b, c = np.vstack([model.b, np.zeros((n_z, m))]), np.hstack([model.c, np.zeros_like(model.c)])
        e = np.vstack([model.e, np.zeros_like(model.e)])
        self._predictor = Predictor(
            *(a, b, c, e, model.f),
            *(self, loop, self._scales, self._method_loop.controlled),
            self._drawn_in_by(loop, self.horizon),
        )
        self._begin(loop)
        if loop.continues_recording:
            self._u, self._last_d = recording.u[-1].copy(), recording.d[-1]
            self._predict(z[-1])

    def restart(self, loop: Loop) -> None:
        """Begin anew with another past: the model and all that follows from it stay."""
        if loop.continues_recording:
            self.start(loop)
        else:
            self._begin(self._again(loop))

    def _begin(self, loop: Loop) -> None:
        """Begin at rest, or where a running plant is."""
        self._disturbance, self._last_d = self._model.constant, np.zeros(len(loop.disturbances))
        self._predicted: FloatArray | None = None
        self._predictor.begin()
        self._u = resting_input(loop)
        if loop.past and not loop.continues_recording:
            self._take_over(loop.past)

    def _step(self, sample: Sample) -> FloatArray | Action:
        """Return the first optimal inputs of the horizon."""
        lifted = sample.y if self.state == "delays" else sample.measured
        missing = "" if np.isfinite(lifted).all() else PREDICTED
        if missing and self._predicted is None:
            return Action(self._u.copy(), missing)
        d = sample.disturbance if self._disturbed else _NONE
        z = self._state(sample.y, sample.measured, d, bool(missing))
        u, fault = self._predictor.solve(np.concatenate([z, self._disturbance]), self._u, sample)
        self._u, self._last_d = u.copy(), d
        self._predict(z)
        return action(u, fault or missing, self._predictor.info)

    def _predict(self, z: FloatArray) -> None:
        """Predict the next state but for what the next disturbances do to it at once."""
        model = self._model
        self._predicted = model.a @ z + model.b @ self._u + model.e @ self._last_d + self._disturbance

    @property
    def past_length(self) -> int:
        """How many samples of a running plant its state is made of."""
        return 1 + (self.delays if self.state == "delays" else 0) + memory_of(self.dictionary)

    def _take_over(self, past: Recording) -> None:
        """Follow a running plant to where the loop begins."""
        self._u = past.u[0]
        for u, y, measured, d in zip(past.u, past.y, past.measured, past.d, strict=True):
            z = self._state(y, measured, d, missing=False)
            self._u, self._last_d = u, d
            self._predict(z)

    def _state(self, y: FloatArray, measured: FloatArray, d: FloatArray, missing: bool) -> FloatArray:
        """Return z less what disturbances do to it at once, and learn from what was predicted of it."""
        predicted, now = self._predicted, self._model.at_once @ d
        if predicted is None:
            return self._lifted.rest(y, measured, self._u, d) - now
        if missing:
            z = predicted + now
            y, measured = self._model.c @ z, z[: len(measured)]
            return self._lifted.follow(y, measured, self._u, self._last_d) - now
        z = self._lifted.follow(y, measured, self._u, self._last_d) - now
        self._disturbance = self._disturbance + self.disturbance_gain * (z - predicted)
        return z

    def _fit(self, z: FloatArray, recording: Recording) -> LiftedModel:
        d = recording.d if self._disturbed else None
        return fit_lifted_model(z, recording.u, recording.y, self.ridge, recording.seams, d)

    def _c_step(self, code: Code, loop: Loop) -> str:
        code.kernel("koopman")
        model, p = self._model, len(loop.outputs)
        predictor, size = self._predictor.constant(code)
        koopman = code.constant(
            "Koopman",
            p=p,
            q=len(loop.measurements),
            m=len(loop.inputs),
            **self._lifted.members(code),
            **{name: code.doubles(getattr(model, name)) for name in ("a", "b", "c")},
            gain=self.disturbance_gain,
            predictor=f"&{predictor}",
            **self._c_disturbances(code),
        )
        n, begun = len(model.a), self._predicted is not None
        predicted = np.zeros(n) if self._predicted is None else self._predicted
        z = code.memory([*np.zeros(n), *self._disturbance])
        windows = self._lifted.windows
        now_and_before = [*self._last_d, *self._last_d, *self._lifted.disturbances_before]
        starts: list[Any] = [[begun], self._u, z, f"{z} + {n}", predicted, *windows]
        starts += [[*np.zeros(p), *now_and_before], np.zeros(size)]
        *others, y, memory = [s if isinstance(s, str) else code.memory(s) for s in starts]
        look = self._predictor.look(code, memory)
        if self._disturbed and code.ahead:
            look += code.ahead.chosen(code, lambda sample: sample.disturbance, f"{y} + {p}")
        held = code.held("KoopmanMemory", *others, y, memory)
        return code.step(f"{look}{held}step_koopman(&{koopman}, &held, sample, u, told);")

    def _c_disturbances(self, code: Code) -> dict[str, object]:
        """Return the members of a structure in C that know disturbances."""
        if not self._disturbed:
            return {}
        return {
            "disturbances": len(self._last_d),
            "remembered": self._lifted.disturbances_before.size // len(self._last_d),
            "e": code.doubles(self._model.e),
            "at_once": code.doubles(-self._model.at_once),
        }

    def recording_length(self, inputs: int, outputs: int, measurements: int, disturbances: int = 0) -> int:
        """Return the samples at which there are as many equations as coefficients."""
        size, skipped = measurements, 0
        if self.state == "delays":
            size, skipped = (self.delays + 1) * outputs + self.delays * inputs, self.delays
        # The lifted state remembers disturbances beside them, and the next one counts as much as this one.
        lifted = size + self.dictionary.functions(size) + skipped * disturbances
        return skipped + memory_of(self.dictionary) + lifted + inputs + 2 * disturbances + 1

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return the signals it uses, and its prior information about the plant."""
        return self._facts("nothing", loop.outputs, loop.measurements if self.state == "measured" else ())

    def diagnostics(self) -> Mapping[str, float]:
        """Return the order of the model, its slowest or most unstable pole, and its worst one-step error."""
        return {
            "model_order": float(len(self._model.a)),
            "spectral_radius": float(np.abs(np.linalg.eigvals(self._model.a)).max()),
            **self._model.fit,
            **self._judgement.diagnostics,
            **self.promised(),
        }

    def _test(self, z: FloatArray, recording: Recording) -> PredictionTest | None:
        """Return how well a model of the recording's first samples predicts the last ones."""
        first = head_of(recording)
        head = len(first)
        if count_windows(head, 2, first.seams) < z.shape[1] + recording.u.shape[1]:
            return None
        try:
            model = self._fit(z[:head], first)
        except DataError:  # the inputs of the whole recording are informative, those of its head are not
            return None
        # The constant as what a disturbance of 1 does.
        with_constant = replace(
            model, e=np.column_stack([model.e, model.constant]), f=np.pad(model.f, ((0, 0), (0, 1)))
        )
        moved = replace(recording, d=np.pad(recording.d, ((0, 0), (0, 1)), constant_values=1.0))
        past = z - recording.d @ model.at_once.T
        return fit_by_model(with_constant, past, moved, self.horizon, head)
