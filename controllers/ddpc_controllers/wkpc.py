"""Willems-Koopman predictive control, equations (10)-(12)."""

import copy
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Literal

import numpy as np

from ddpc_controllers.checks import LastMeasurement, all_finite, check_settings_and, fill_missing
from ddpc_controllers.data.dictionaries import Dictionary, Lift, ThinPlate, c_lift, embed, memory_of
from ddpc_controllers.data.hankel import (
    StateWindow,
    WindowLayout,
    diagnose,
    least_samples,
    matching_recording,
    require_excitation,
    require_length,
    resting_input,
    samples_before,
    signals_of,
    signals_that_move,
    without_first,
)
from ddpc_controllers.data.instruments import predict_all_at_once
from ddpc_controllers.data.online import Learner, OnlineSettings
from ddpc_controllers.data.quality import Span, fit_by_windows, judge
from ddpc_controllers.export.code import ALL_AHEAD, Code
from ddpc_controllers.export.law import add_law
from ddpc_controllers.optimisation.backends import BACKENDS, BackendName, make_backend, require_backend
from ddpc_controllers.optimisation.limits import PREDICTED, InputLimits
from ddpc_controllers.optimisation.outlook import D, Foresight, Outlook
from ddpc_controllers.optimisation.problem import ParameterVector, Problem
from ddpc_controllers.optimisation.qp import NO_INFO, action, make_law, predicted_ends
from ddpc_controllers.optimisation.tightening import MARGINS, OnlinePromise
from ddpc_controllers.optimisation.tracking import LIMITED, TrackingSettings, tracking_problem
from ddpc_controllers.scaling import ScaleAhead, ScaledSignals
from ddpc_cosim import (
    Action,
    Factor,
    FloatArray,
    Integer,
    Log,
    Loop,
    Recording,
    Sample,
    Weight,
    setting,
)

# Observables nearly repeat each other, and leave directions that the past hardly fixes: they cost this share.
_KEPT_SMALL = 1e-3


@dataclass(kw_only=True)
class WKPC(OnlineSettings, OnlinePromise, Foresight, ScaledSignals):
    """Willems-Koopman predictive control, equations (10)-(12).

    The lifted state is ``z = (x, psi_1(x), ..., psi_np(x))`` with x all that is measured. Future lifted
    states are not known, so the lifted rows cover the past window only. The weights are those of Table 1 by
    default; ``regulariser = "ridge"`` is that of (11), which pulls every output to zero.
    ``online_data`` lets the data follow the plant: see
    :class:`~ddpc_controllers.data.online.OnlineSettings`.
    """

    _known_in_c: ClassVar[Collection[str]] = ALL_AHEAD

    uses_recording: ClassVar[bool] = True
    accepts_missing: ClassVar[bool] = True
    _scales_ahead: ClassVar[ScaleAhead] = "none"
    former_settings: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("zero_padding", "double_shift"), "that is what wkpc-published does"
    )

    initial_length: int = setting(
        2,
        low=1,
        doc="samples of the past that fix the initial condition, Tini",
        search=Integer(1, 8),
        predicts=True,
    )
    horizon: int = setting(5, low=1, doc="prediction horizon N, samples", search=Integer(3, 20))
    output_weight: Weight = setting(1.0, low=0.0, doc="Q: predicted outputs off the reference")
    input_weight: Weight = setting(
        0.1, above=0.0, doc="R: inputs off the artificial setpoint", search=Factor(1e-4, 1e2)
    )
    regulariser: Literal["ridge", "projection"] = setting(
        "projection",
        choices=("ridge", "projection"),
        doc="what lambda_g weighs of g: all of it (11), or what goes beyond the least-squares prediction",
    )
    lambda_g: float = setting(
        0.1, above=0.0, doc="weight of the regulariser, of |g|^2 with the ridge", search=Log(1e-3, 1e3)
    )
    setpoint_margin: float = setting(
        0.99, above=0.0, high=1.0, doc="share of the limits open to the setpoint"
    )
    dictionary: Dictionary = setting(
        default_factory=partial(ThinPlate, centres="data"), doc="observables that lift the state"
    )
    backend: BackendName = setting("piqp", choices=BACKENDS, doc="QP solver for active sets not seen before")

    def __post_init__(self) -> None:
        check_settings_and(self, self._faults_between_settings)
        require_backend(self.backend)

    def _start(self, loop: Loop) -> None:
        """Lift the loop's recording and condense the problem on it."""
        recording = matching_recording(loop, "WKPC")
        # A copy of the stream: another start draws the same centres.
        rng = copy.deepcopy(loop.rng)
        memory = memory_of(self.dictionary)
        self._memory = memory
        self._recent = recording.measured[-1 - memory :]
        self._last = LastMeasurement(recording.measured, recording.y)
        self._states = StateWindow(self._recent)
        states = embed(recording.measured, memory, recording.seams)
        recording = without_first(recording, memory)
        self._observables = self._draw(states, rng)
        lifted = self._lift(states)
        m, p, past = len(loop.inputs), len(loop.outputs), self.initial_length
        self._inputs, self._outputs = m, p
        self._ends = predicted_ends(loop.outputs)
        controlled = self._method_loop.controlled
        units = self._scales.u, self._scales.y, self._scales.d
        self._outlook = Outlook(
            loop, self, self.horizon, past=past, first=0, controlled=controlled, units=units
        )
        self._data = self._stack(recording, lifted)
        spans = Span(self.horizon - 1, "horizon"), Span(past, "initial_length")
        test = fit_by_windows(self._data, self.horizon * p, p, self._layout.depth)
        self._judgement = judge("WKPC", recording, loop.outputs, spans, (test, self.horizon))
        margins = self._margins = self._drawn_in_by(loop, self.horizon, first=0)
        self._following = margins.online if margins else None
        self._limited_by = predict_all_at_once(self._data, self.horizon * p) if self._following else None
        windows = {
            "z_ini": (past, lifted.shape[1]),
            "u_ini": (past, m),
            "y_ini": (past, p),
            "r": (self.horizon, p),
            **(margins.windows if margins else {}),
        }
        self._parameters = ParameterVector(windows | self._outlook.windows)
        self._problem = self._write_down(loop)
        self._limits = InputLimits(loop.bounds.u_min, loop.bounds.u_max)
        self._learner: Learner | None = None
        self._unlearned = 0
        if self.online_data != "frozen":
            signals = {"z": lifted, **signals_of(recording)}
            self._learner = Learner(
                self,
                self._problem,
                self._data,
                self._layout,
                signals,
                self._scales.u,
                loop.continues_recording,
                rng,
            )
        online = self._learner.data if self._learner else None
        self._law = make_law(self._problem, self._data, self._limits, make_backend(self.backend), online)
        self._recorded = lifted
        self._begin(loop, recording)

    def restart(self, loop: Loop) -> None:
        """Begin anew with another past: what was learned stays, unless it follows the plant."""
        if self._learner is not None:
            self.start(loop)
        else:
            again = self._again(loop)
            self._begin(again, matching_recording(again, "WKPC"))

    def _step(self, sample: Sample) -> FloatArray | Action:
        """Return the first optimal input of the horizon."""
        parameters, y, measured = self._parameters, sample.y, sample.measured
        missing = "" if all_finite(y) and all_finite(measured) else PREDICTED
        if self._resting:
            if missing:
                return Action(parameters.window("u_ini")[-1].copy(), missing)
            self._rest(sample)
        parameters.fill("r", sample.reference)
        self._outlook.fill(parameters, sample)
        if self._outlook.moves_inputs:
            self._limits.move(sample.input_limits / self._scales.u[:, np.newaxis])
        if self._following:
            self._following.measured(y)
            parameters.fill(MARGINS, self._following.values)
        u, forecast, fault = self._solve()
        if missing:
            y = fill_missing(y, forecast)
            measured = self._last.complete(measured, y)
        parameters.append("u_ini", u)
        parameters.append("y_ini", y)
        self._append_state(self._last.take(measured))
        if self._learner:
            self._learn(self._learner, bool(missing), u=u, y=y, d=self._outlook.now(parameters))
        self._outlook.advance(parameters)
        return action(u, fault or missing, self._info)

    def _solve(self) -> tuple[FloatArray, FloatArray, str]:
        """Return the inputs to apply now, the outputs predicted of now, and what is not as it should be."""
        parameters = self._parameters
        answer, fault = self._law.solve(parameters.array)
        if answer is None:
            self._info = NO_INFO
            return parameters.window("u_ini")[-1].copy(), parameters.window("y_ini")[-1].copy(), fault
        m, p = self._inputs, self._outputs
        u, forecast = answer[:m], answer[m : m + p]
        if self._following:
            self._following.predicted(answer[m + p : m + (1 + self.horizon) * p])
        self._info = self._law.info(self._ends, answer, self._scales.y)
        if self._learner:
            self._learner.add_dither(u)
            self._limits.hold(u)
        return u, forecast, fault

    def _append_state(self, state: FloatArray) -> None:
        """Append the lifted state to the past window."""
        self._parameters.append("z_ini", self._lift(self._states.append(state)))

    def _learn(self, learner: Learner, missing: bool, **signals: FloatArray) -> None:
        """Learn a sample, unless it, or the past of its state, has substitutes for missing measurements."""
        self._unlearned = self._memory + 1 if missing else max(self._unlearned - 1, 0)
        z = self._parameters.window("z_ini")[-1]
        if self._unlearned:
            signals["y"] = np.full_like(signals["y"], np.nan)
        learner.learn(z=z, **signals)

    def _c_step(self, code: Code, loop: Loop) -> str:
        if self._margins:
            self._margins.require_fixed()
        code.kernel("wkpc")
        m, p, q, n = (
            self._inputs,
            self._outputs,
            len(loop.measurements),
            self._parameters.window("z_ini").shape[1],
        )
        outlook = self._outlook
        law = add_law(code, self._law, m + p, outlook.moves_inputs)
        measured, outputs = self._last.shared
        wkpc = code.constant(
            "Wkpc",
            p=p,
            q=q,
            m=m,
            past=self.initial_length,
            horizon=self.horizon,
            depth=self._memory + 1,
            lifted=n,
            **c_lift(code, self._observables, q),
            shared=len(measured),
            measured=code.sizes(measured),
            outputs=code.sizes(outputs),
            law=law.pointer,
            **outlook.members(code, self._limits),
        )
        limited = np.zeros(2 * m * outlook.moves_inputs)
        parameters, first = (
            code.memory(np.concatenate([self._parameters.array, limited])),
            np.cumsum([0, *self._parameters.sizes.values()]),
        )
        look = outlook.in_c(code, f"{parameters} + {first[4]}", 1)
        parts = [f"{parameters} + {place}" for place in first[:4]]
        of_now = [np.zeros(size) for size in (m + p, n, p, law.memory)]
        held = code.held(
            "WkpcMemory", *parts, [self._resting], self._states.newest_first, self._last.newest, *of_now
        )
        return code.step(f"{look}{held}step_wkpc(&{wkpc}, &held, sample, u, told);")

    def recording_length(self, inputs: int, outputs: int, measurements: int, disturbances: int = 0) -> int:
        """Return the fewest samples with which all that moves the plant can excite it enough."""
        order = measurements + self.dictionary.functions(measurements)
        depth, moving = self.initial_length + self.horizon, inputs + disturbances
        return memory_of(self.dictionary) + least_samples(depth + order, moving)

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return the signals it uses, and its prior information about the plant."""
        return self._facts("nothing", loop.outputs, loop.measurements)

    def diagnostics(self) -> Mapping[str, float]:
        """Return order of excitation, rank and smallest singular value of the recording."""
        online = self._learner.data.counts() if self._learner else {}
        return {**self._diagnostics.as_dict(), **self._judgement.diagnostics, **online, **self.promised()}

    def _faults_between_settings(self) -> list[str]:
        faults = []
        if not isinstance(self.dictionary, Dictionary):
            faults.append(
                f"WKPC: dictionary = {self.dictionary!r} lacks draw(states, rng) or functions(size); "
                "an example is ThinPlate()"
            )
        if self.horizon == 1:
            faults.append(
                "WKPC: horizon = 1 predicts the present output alone, which no input changes any more: "
                "at least 2"
            )
        return faults + self.online_faults()

    def _draw(self, states: FloatArray, rng: np.random.Generator) -> Lift:
        """Return the observables."""
        return self.dictionary.draw(states, rng)

    def _lift(self, states: FloatArray) -> FloatArray:
        """Return z = (x, psi(x)) for states of shape (..., q), with their past where psi looks back."""
        newest = states[..., : self._states.size]
        return np.concatenate([newest, self._observables(states)], axis=-1)

    @property
    def _layout(self) -> WindowLayout:
        """Return how windows are stacked: lifted past, and past and future of inputs and outputs."""
        past, horizon = self.initial_length, self.horizon
        pasts = [(name, 0, past) for name in ("z", "u", "y")]
        return WindowLayout(*pasts, ("d", 0, past + horizon), ("u", past, horizon), ("y", past, horizon))

    def _stack(self, recording: Recording, lifted: FloatArray) -> FloatArray:
        """Return M."""
        moved, disturbances = signals_that_move(recording), recording.d.shape[1]
        depth, order = self.initial_length + self.horizon, lifted.shape[1]
        require_length(len(moved), depth + order, moved.shape[1], "WKPC", recording.seams, disturbances)
        stacked = self._layout.stack({"z": lifted, **signals_of(recording)}, recording.seams)
        self._diagnostics = diagnose(stacked, moved, depth + order, recording.seams)
        require_excitation(self._diagnostics, f"depth {depth} + lifted order {order}", "WKPC", disturbances)
        return stacked

    def _write_down(self, loop: Loop) -> Problem:
        """Write down (10) and (11)."""
        sizes = self._parameters.sizes
        past = {name: sizes[name] for name in ("z_ini", "u_ini", "y_ini", D) if name in sizes}
        settings = TrackingSettings(
            horizon=self.horizon,
            setpoint="input",
            output_weight=self.output_weight,
            input_weight=self.input_weight,
            setpoint_margin=self.setpoint_margin,
        )
        problem = tracking_problem(
            settings,
            loop.bounds,
            resting_input(loop),
            np.full(len(loop.inputs), np.inf),
            past,
            sizes,
            known={name: self._outlook.course if name == D else name for name in past},  # (10)
            outlook=self._outlook,
            margins=self._margins,
            predictor=self._limited_by,
        )
        if self.regulariser == "ridge":
            problem.regularise(self.lambda_g)
        else:
            above = dict.fromkeys((*past, "u"), _KEPT_SMALL * self.lambda_g)
            problem.regularise({**above, "y": self.lambda_g})
        problem.ask(u=len(loop.inputs), y=len(loop.outputs))
        if self._following:
            problem.ask(**{LIMITED: sizes["r"]})
        problem.ask(y=-len(loop.outputs))
        return problem

    @property
    def past_length(self) -> int:
        """How many samples of a running plant fill the past window, and what is lifted of it."""
        return self.initial_length + memory_of(self.dictionary)

    def _begin(self, loop: Loop, recording: Recording) -> None:
        """Fill the past: with the samples before the first, or with rest as far as it is known yet."""
        lifted, self._info = self._recorded, NO_INFO
        if self._following:
            self._following.begin()
        self._last.take(self._recent[-1])
        self._states = StateWindow(self._recent)
        before, past = (
            samples_before(loop, self.initial_length + self._memory),
            slice(-self.initial_length, None),
        )
        self._resting: bool = before is None
        if before is not None and not loop.continues_recording:
            self._states = StateWindow(before.measured[-1 - self._memory :])
            self._last.take(before.measured[-1])
            lifted = self._lift(embed(before.measured, self._memory))
        known = recording if before is None else before
        self._parameters.fill("z_ini", lifted[past])
        self._parameters.fill("u_ini", resting_input(loop) if before is None else before.u[past])
        self._parameters.fill("y_ini", known.y[past])
        self._outlook.begin(self._parameters, known.d[past])

    def _rest(self, sample: Sample) -> None:
        """Start as if the plant had always been where it is."""
        self._resting = False
        self._parameters.fill("y_ini", sample.y)
        self._parameters.fill("z_ini", self._lift(self._states.fill(sample.measured)))
        self._outlook.begin(self._parameters, sample.disturbance / self._scales.d)
