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
doi:10.1137/15M1013857).
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from ddpc_controllers.checks import check_settings_and, prior_info
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
from ddpc_controllers.export.code import Code
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


def fit_lifted_model(
    z: FloatArray, u: FloatArray, y: FloatArray, ridge: float = 0.0, seams: Sequence[int] = ()
) -> SampledModel:
    """Fit ``z+ = A z + B u`` by regularised least squares, and ``y = C z``.

    C reads off the outputs that are among the lifted states, and is fitted to others.

    Parameters
    ----------
    z, u, y : array, shapes (T, n_z), (T, m), (T, p)
        Lifted states, inputs and outputs, time along axis 0.
    ridge : float
        Weight of the squared coefficients, for observables and inputs scaled to unit size.
    seams : sequence of int
        The first sample of every piece but the first; none is predicted from the one before a seam.

    Returns
    -------
    model : SampledModel
        ``one_step_error`` is the root mean square of the prediction errors of the state predicted worst.

    Raises
    ------
    DataError
        The inputs do not tell their own effect from that of the state.
    """
    now = window_starts(len(z), 2, seams)
    require_informative(u[now], z[now], "EDMD")
    size = _root_mean_square(np.hstack([z, u]))
    scaled = np.hstack([z, u]) / size
    n_z = z.shape[1]
    dynamics = _least_squares(scaled[now], z[now + 1] / size[:n_z], ridge)
    shown = _least_squares(scaled[:, :n_z], y, 0.0).T / size[:n_z]
    both = (dynamics.T / size) * size[:n_z, np.newaxis]
    a, b, c = both[:, :n_z], both[:, n_z:], _reading_off(shown, z, y)
    errors = z[now + 1] - np.hstack([z, u])[now] @ both.T
    fit = {"one_step_error": float(_root_mean_square(errors).max())}
    return SampledModel(a, b, c, np.zeros(u.shape[1]), np.zeros(y.shape[1]), len(z), fit)


class LiftedState:
    """The lifted state z of a loop: what is measured, or outputs and inputs with their past, and observables.

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
        embedded = embed(states, memory)[window_starts(len(recording), self.skipped + 1, recording.seams)]
        self._observables = dictionary.draw(embedded, rng)
        self.recorded = self._lift(embedded)

    def rest(self, y: FloatArray, measured: FloatArray, u: FloatArray) -> FloatArray:
        """Suppose that y, shape (p,), measured, (q,), and u, (m,), have always been so; return z."""
        if self._kind == "measured":
            return self._lift(self._states.fill(measured))
        return self._lift(self._states.fill(np.concatenate([self._y.fill(y), self._u.fill(u)])))

    def follow(self, y: FloatArray, measured: FloatArray, last_u: FloatArray) -> FloatArray:
        """Take the next sample and the inputs applied before it; return z, shape (n_z,)."""
        if self._kind == "measured":
            return self._lift(self._states.append(measured))
        return self._lift(self._states.append(np.concatenate([self._y.append(y), self._u.append(last_u)])))

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
        require_samples(count_windows(len(z), 2, seams), n_z + m, "KoopmanMPC")
        self._model = model = fit_lifted_model(z, recording.u, recording.y, self.ridge, seams)
        memory = Span(1, 'state = "measured"', 'set state = "delays"')
        if self.state == "delays":
            memory = Span(self.delays + 1, "delays")
        spans, tested = (Span(self.horizon, "horizon"), memory), (self._test(z, recording), self.horizon)
        self._judgement = judge("KoopmanMPC", recording, loop.outputs, spans, tested)
        # The state of the problem is (z, w).
        a = np.block([[model.a, np.eye(n_z)], [np.zeros((n_z, n_z)), np.eye(n_z)]])
        b, c = np.vstack([model.b, np.zeros((n_z, m))]), np.hstack([model.c, np.zeros_like(model.c)])
        self._disturbance = np.zeros(n_z)
        self._predicted: FloatArray | None = None
        self._u = resting_input(loop)
        self._predictor = Predictor(a, b, c, self, loop.bounds, self._scales, self._u)
        if loop.continues_recording:
            self._u = recording.u[-1].copy()
            self._predicted = model.a @ z[-1] + model.b @ self._u

    def _step(self, sample: Sample) -> FloatArray | Action:
        """Return the first optimal inputs of the horizon."""
        lifted = sample.y if self.state == "delays" else sample.measured
        missing = "" if np.isfinite(lifted).all() else PREDICTED
        if missing and self._predicted is None:
            return Action(self._u.copy(), missing)
        z = self._state(sample, bool(missing))
        u, fault = self._predictor.solve(np.concatenate([z, self._disturbance]), self._u, sample.reference)
        self._predicted = self._model.a @ z + self._model.b @ u + self._disturbance
        self._u = u.copy()
        return action(u, fault or missing, self._predictor.info)

    def _state(self, sample: Sample, missing: bool) -> FloatArray:
        """Return z, and learn from what was predicted of it."""
        predicted = self._predicted
        if predicted is None:
            return self._lifted.rest(sample.y, sample.measured, self._u)
        if missing:
            return self._lifted.follow(self._model.c @ predicted, predicted[: len(sample.measured)], self._u)
        z = self._lifted.follow(sample.y, sample.measured, self._u)
        self._disturbance += self.disturbance_gain * (z - predicted)
        return z

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
        )
        n, begun = len(model.a), self._predicted is not None
        predicted = np.zeros(n) if self._predicted is None else self._predicted
        z = code.memory([*np.zeros(n), *self._disturbance])
        windows = self._lifted.windows
        values = [begun], self._u, z, f"{z} + {n}", predicted, *windows, np.zeros(p), np.zeros(size)
        held = code.held("KoopmanMemory", *values)
        return code.step(f"{held}step_koopman(&{koopman}, &held, sample, u, told);")

    def recording_length(self, inputs: int, outputs: int, measurements: int) -> int:
        """Return the samples at which there are as many equations as coefficients."""
        size, skipped = measurements, 0
        if self.state == "delays":
            size, skipped = (self.delays + 1) * outputs + self.delays * inputs, self.delays
        lifted = size + self.dictionary.functions(size)
        return skipped + memory_of(self.dictionary) + lifted + inputs + 1

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return the signals it uses, and its prior information about the plant."""
        return prior_info("nothing", loop.outputs, loop.measurements if self.state == "measured" else ())

    def diagnostics(self) -> Mapping[str, float]:
        """Return the order of the model, its slowest or most unstable pole, and its worst one-step error."""
        return {
            "model_order": float(len(self._model.a)),
            "spectral_radius": float(np.abs(np.linalg.eigvals(self._model.a)).max()),
            **self._model.fit,
            **self._judgement.diagnostics,
        }

    def _test(self, z: FloatArray, recording: Recording) -> PredictionTest | None:
        """Return how well a model of the recording's first samples predicts the last ones."""
        first = head_of(recording)
        head = len(first)
        if count_windows(head, 2, first.seams) < z.shape[1] + recording.u.shape[1]:
            return None
        try:
            model = fit_lifted_model(z[:head], first.u, first.y, self.ridge, first.seams)
        except DataError:  # the inputs of the whole recording are informative, those of its head are not
            return None
        return fit_by_model(model, z, recording, self.horizon, head)
