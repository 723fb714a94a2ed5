"""Data-enabled predictive control, equation (8), with the regularisers and the data updates of its family.

Sources besides the paper's [8] and [9]: the projection regulariser is that of F. Doerfler, J. Coulson and
I. Markovsky, *Bridging direct and indirect data-driven control formulations via regularizations and
relaxations*, IEEE TAC 68(2), 2023, doi:10.1109/TAC.2022.3148374 (arXiv:2101.01273). The slack on the whole
window is that of the robust scheme of J. Berberich, J. Koehler, M. A. Mueller, F. Allgoewer, *Data-driven
model predictive control with stability and robustness guarantees*, IEEE TAC 66(4), 2021 (arXiv:1906.04679).
The regulariser about the combination of an equilibrium is theirs too: *Linear tracking MPC for nonlinear
systems, part II: the data-driven case*, IEEE TAC 67(9), 2022 (arXiv:2105.08567). They draw to an equilibrium
that is known to be reachable. Here it is optimised, and noisy data can be combined to any (u_s, y_s): without
a price on what the least-squares prediction does not explain of it, the loop drifts. Free and forced response
apart, the one from least squares and the other from the data, are those of M. Lazar, P. C. N. Verheijen,
*Generalized data-driven predictive control: merging subspace and Hankel predictors*, Mathematics 11(9), 2023,
2216, doi:10.3390/math11092216 (arXiv:2304.01418).
"""

import copy
from abc import abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ddpc_controllers.checks import all_finite, check_settings_and, fill_missing
from ddpc_controllers.data.hankel import (
    ONE,
    WindowLayout,
    informative_windows,
    least_samples,
    matching_recording,
    resting_input,
    samples_before,
    signals_of,
)
from ddpc_controllers.data.instruments import (
    Instruments,
    predict_all_at_once,
    predict_from_head,
)
from ddpc_controllers.data.online import Learner, OnlineSettings
from ddpc_controllers.data.quality import PredictionTest, Span, fit_by_predictor, fit_by_windows, judge
from ddpc_controllers.export.code import ALL_AHEAD, Code
from ddpc_controllers.export.law import add_law
from ddpc_controllers.optimisation.backends import BACKENDS, BackendName, make_backend, require_backend
from ddpc_controllers.optimisation.limits import PREDICTED, InputLimits, rate_limits
from ddpc_controllers.optimisation.outlook import D, Foresight, Outlook
from ddpc_controllers.optimisation.problem import Blocks, ParameterVector, Problem
from ddpc_controllers.optimisation.qp import NO_INFO, Law, action, make_law, predicted_ends
from ddpc_controllers.optimisation.tightening import MARGINS, OnlinePromise
from ddpc_controllers.optimisation.tracking import LIMITED, TrackingSettings, tracking_problem
from ddpc_controllers.optimisation.uncondensed import UncondensedLaw
from ddpc_controllers.scaling import ScaleAhead, ScaledSignals
from ddpc_cosim import (
    Action,
    Choice,
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

Regulariser = Literal["ridge", "equilibrium", "free-response", "projection", "l1"]

_UNEXPLAINED = 0.3
"""Weight of |(I - Pi) g_s|^2 in parts of lambda_g: with less than 0.1 loops drift, more than 1 is a bias."""


@dataclass(kw_only=True)
class BehavioralTracking(OnlinePromise, Foresight, ScaledSignals):
    """Predict with recorded windows, track the reference; a subclass says how windows are combined.

    What a subclass sets, in the order of the calls:

    1. ``_faults_between_settings``, once at construction; may be extended.
    2. ``_stack``, once per start: the data, in the blocks of ``_layout``; may be set.
    3. ``_sums_g``, wherever data are laid out: whether they have a row of ones; may be set.
    4. ``_past_ridge``, once per start, for the test of the prediction; may be set.
    5. ``_write_down``, once per start: the problem; must be set. ``_tracking_problem`` begins it.
    6. ``_make_learner``, once per start: what lets the data follow the plant; may be set.
    7. ``_make_law``, once per start: what solves the problem online; may be extended.

    A step evaluates the law, and calls none of them.
    """

    _known_in_c: ClassVar[Collection[str]] = ALL_AHEAD

    uses_recording: ClassVar[bool] = True
    accepts_missing: ClassVar[bool] = True
    _scales_ahead: ClassVar[ScaleAhead] = "none"

    initial_length: int = setting(
        3,
        low=1,
        doc="samples of the past that fix the initial condition, Tini",
        search=Integer(1, 8),
        predicts=True,
    )
    horizon: int = setting(
        5,
        low=1,
        doc="prediction horizon N, samples; with terminal_equality longer than initial_length",
        search=Integer(3, 20),
    )
    output_weight: Weight = setting(
        100.0, low=0.0, doc="Q: predicted outputs off the artificial setpoint, or off the reference"
    )
    setpoint_weight: Weight = setting(300.0, low=0.0, doc="S: artificial setpoint off the reference")
    input_weight: Weight = setting(
        10.0,
        low=0.0,
        doc="R: inputs off the artificial setpoint, or off their values at rest",
        search=Factor(1e-4, 1e2),
    )
    artificial_setpoint: bool = setting(
        True,
        doc="optimise a setpoint (u_s, y_s) online, (8); otherwise track the reference itself",
        search=Choice((False, True)),
    )
    terminal_equality: bool = setting(
        False, doc="the last initial_length predicted samples equal the artificial setpoint"
    )
    setpoint_margin: float = setting(
        0.99, above=0.0, high=1.0, doc="share of the limits open to the setpoint"
    )
    soft_output_bounds: float = setting(
        0.0, low=0.0, doc="weight of |excess|^2 beyond the output bounds; 0: they are hard"
    )
    rate_bounds: Weight = setting(
        (), above=0.0, doc="largest change of each input per sample, in its unit; empty: none"
    )
    apply_steps: int = setting(1, low=1, doc="inputs of each plan that are applied before the next is made")
    use_current_output: bool = setting(
        False, doc="the output measured now ends the past window; otherwise the sample before does"
    )
    assumed_order: int = setting(0, low=0, doc="bound on the plant's order; 0: initial_length x outputs")
    instruments: Instruments = setting(
        "none",
        choices=get_args(Instruments),
        doc="what averages the noise out of the data: nothing; pasts and inputs, for a recording made in "
        "open loop; the same, one sample ahead at a time, for one made in closed loop; what "
        "excited that loop from outside, likewise, where the recording knows it",
    )
    backend: BackendName = setting("piqp", choices=BACKENDS, doc="QP solver for active sets not seen before")

    def __post_init__(self) -> None:
        check_settings_and(self, self._faults_between_settings)
        require_backend(self.backend)

    def _start(self, loop: Loop) -> None:
        """Condense the problem on the loop's recording."""
        recording = matching_recording(loop, type(self).__name__)
        m, p, steps = len(loop.inputs), len(loop.outputs), self.apply_steps
        self._inputs, self._outputs = m, p
        # Where the inputs of a plan and its predicted outputs end in the law's answer.
        self._planned = steps * m, steps * (m + p)
        self._rates = rate_limits(self.rate_bounds, m) / self._scales.u
        self._limits = InputLimits(loop.bounds.u_min, loop.bounds.u_max, self._rates, steps)
        data = self._stack(recording)
        test = self._test(data, recording)
        self._judgement = judge(
            type(self).__name__, recording, loop.outputs, self._spans, (test, self.horizon)
        )
        if self._has_predictor:
            predictor, known = self._predictor(data, recording), data[: len(data) - self.horizon * p]
            data = np.vstack([known, predictor @ known])
        self._outlook = Outlook(
            loop,
            self,
            self.horizon,
            past=self.initial_length,
            first=int(self.use_current_output),
            controlled=self._method_loop.controlled,
            units=(self._scales.u, self._scales.y, self._scales.d),
        )
        margins = self._margins = self._drawn_in_by(loop, self.horizon, int(self.use_current_output))
        self._following = margins.online if margins else None
        opens = self._following and self._leaves_outputs_open
        self._limited_by = predict_all_at_once(data, self.horizon * p) if opens else None
        windows = {
            "u_ini": (self.initial_length, m),
            "y_ini": (self._past_outputs, p),
            "r": (self.horizon, p),
            **(margins.windows if margins else {}),
        }
        self._parameters = ParameterVector(windows | self._outlook.windows)
        problem = self._write_down(loop)
        problem.ask(u=steps * m, y=steps * p)
        if self._following:
            problem.ask(**{"y" if self._limited_by is None else LIMITED: self.horizon * p})
        problem.ask(y=-p)
        self._ends = predicted_ends(loop.outputs)
        self._learner = self._make_learner(problem, data, loop, recording)
        self._law = self._make_law(problem, data)
        changes_answer = np.isfinite(self._rates).any() or self._learner is not None
        self._applies_answer: bool = steps == 1 and not changes_answer
        self._begin(loop, recording)

    def restart(self, loop: Loop) -> None:
        """Begin anew with another past: what was learned stays, unless it follows the plant."""
        if self._learner is not None:
            self.start(loop)
            return
        again = self._again(loop)
        self._begin(again, matching_recording(again, type(self).__name__))

    def _begin(self, loop: Loop, recording: Recording) -> None:
        """Forget what was decided, and fill the past."""
        self._forecast, self._info = recording.y[-1], NO_INFO
        self._resting: bool = samples_before(loop, 1) is None
        self._pending: list[FloatArray] = []
        if self._following:
            self._following.begin()
        self._fill_past(loop, recording)

    def _step(self, sample: Sample) -> FloatArray | Action:
        """Return the optimal input for this sample, of the present plan or of a new one."""
        parameters, learner, y = self._parameters, self._learner, sample.y
        missing = "" if all_finite(y) else PREDICTED
        if self._resting:
            if missing:
                return Action(parameters.window("u_ini")[-1].copy(), missing)
            parameters.fill("y_ini", y)
            self._outlook.begin(parameters, sample.disturbance / self._scales.d)
            self._resting = False
        elif self.use_current_output:
            parameters.append("y_ini", self._known(y) if missing else y)
        if self._following:
            self._following.measured(y)
        u, fault = self._continue_plan(sample) if self._pending else self._plan(sample)
        parameters.append("u_ini", u)
        if not self.use_current_output:
            parameters.append("y_ini", self._known(y) if missing else y)
        if learner:
            learner.learn(u=u, y=y, d=self._outlook.now(parameters))
        self._outlook.advance(parameters)
        return action(u, fault or missing, self._info)

    def _c_step(self, code: Code, loop: Loop) -> str:
        """Add the window and the law."""
        if self._margins:
            self._margins.require_fixed()
        code.kernel("window")
        steps, limits, outlook = self.apply_steps, self._limits.tables(), self._outlook
        law = add_law(code, self._law, self._planned[1], outlook.moves_inputs)
        window = code.constant(
            "Window",
            m=self._inputs,
            p=self._outputs,
            past_u=self.initial_length,
            past_y=self._past_outputs,
            horizon=self.horizon,
            steps=steps,
            current=self.use_current_output,
            low=code.doubles(limits["low"]),
            high=code.doubles(limits["high"]),
            rates=code.doubles(self._rates),
            law=law.pointer,
            **outlook.members(code, self._limits),
        )
        forecast = np.zeros(steps * self._outputs)
        forecast[: self._outputs] = self._forecast[: self._outputs]
        rest = np.zeros(self._planned[1] + law.memory)
        parameters, sizes = self._parameters.array, self._parameters.sizes
        limited = np.zeros(2 * steps * self._inputs * outlook.moves_inputs)
        memory = code.memory(np.concatenate([parameters, limited, [self._resting, 0.0], forecast, rest]))
        look = outlook.in_c(code, f"{memory} + {sizes['u_ini'] + sizes['y_ini'] + sizes['r']}", steps)
        return code.step(f"{look}step_window(&{window}, {memory}, sample, u, told);")

    def recording_length(self, inputs: int, outputs: int, measurements: int, disturbances: int = 0) -> int:
        """Return the fewest samples with which all that moves the plant can excite it enough."""
        moving = inputs + disturbances
        return max(least_samples(self._order_needed(outputs), moving), self._layout.depth)

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return the signals it uses, and its prior information about the plant and the time ahead."""
        return self._facts("nothing", loop.outputs)

    def diagnostics(self) -> Mapping[str, float]:
        """Return order of excitation, rank and smallest singular value of the recording."""
        online = self._learner.data.counts() if self._learner else {}
        return {**self._diagnostics.as_dict(), **self._judgement.diagnostics, **online, **self.promised()}

    @abstractmethod
    def _write_down(self, loop: Loop) -> Problem:
        """Return the tracking problem."""

    def _make_learner(
        self, problem: Problem, data: FloatArray, loop: Loop, recording: Recording
    ) -> Learner | None:
        """Return the online data that follow the plant, if any."""
        return None

    def _make_law(self, problem: Problem, data: FloatArray) -> Law:
        """Return the law that solves the problem online."""
        online = self._learner.data if self._learner else None
        return make_law(problem, data, self._limits, make_backend(self.backend), online)

    @property
    def _leaves_outputs_open(self) -> bool:
        """Whether planned outputs may be others than the least-squares prediction, at a cost."""
        return False

    @property
    def _has_predictor(self) -> bool:
        """Whether outputs are those of a predictor of its own, which leaves nothing of them open."""
        return self.instruments != "none"

    @property
    def _past_ridge(self) -> float:
        """The ridge on the past outputs in the prediction for given inputs."""
        return 0.0

    @property
    def _sums_g(self) -> bool:
        """Whether entries of g sum to 1."""
        return False

    @property
    def past_length(self) -> int:
        """How many samples of a running plant fill the past window."""
        return self._past_outputs

    @property
    def _past_outputs(self) -> int:
        return self.initial_length + self.use_current_output

    @property
    def _layout(self) -> WindowLayout:
        """Return how windows are stacked: what the outputs are predicted from first."""
        past, known, horizon = self.initial_length, self._past_outputs, self.horizon
        sum_of_g = [(ONE, 0, 1)] if self._sums_g else []
        return WindowLayout(
            ("u", 0, past),
            ("y", 0, known),
            *sum_of_g,
            ("d", 0, past + horizon),
            ("u", past, horizon),
            ("y", known, horizon),
        )

    def _faults_between_settings(self) -> list[str]:
        name, faults = type(self).__name__, []
        if self.terminal_equality and not self.artificial_setpoint:
            faults.append(
                f"{name}: terminal_equality ties the horizon's end to the artificial setpoint: switch it off "
                "too, or artificial_setpoint on"
            )
        if self.terminal_equality and self.horizon <= self.initial_length:
            faults.append(
                f"{name}: horizon = {self.horizon} is not longer than initial_length = "
                f"{self.initial_length}; the terminal condition holds over the last initial_length samples "
                "of the horizon, and leaves no input free to get there"
            )
        if self.horizon == 1 and not self.use_current_output:
            faults.append(
                f"{name}: horizon = 1 predicts the present output alone, which no input changes any more: "
                "at least 2, or use_current_output on"
            )
        if self.apply_steps > self.horizon:
            faults.append(f"{name}: apply_steps = {self.apply_steps} is more than horizon = {self.horizon}")
        return faults

    def _order_needed(self, outputs: int) -> int:
        """Return the order of excitation of Assumption 2: depth of the data and order of the plant."""
        return self.initial_length + self.horizon + (self.assumed_order or self.initial_length * outputs)

    def _stack(self, recording: Recording) -> FloatArray:
        """Return M: the past and future Hankel blocks, and the row that sums g where one is asked for."""
        order, depth = self._order_needed(self._method_loop.controlled), self.initial_length + self.horizon
        data, self._diagnostics = informative_windows(
            self._layout, recording, order, depth, type(self).__name__
        )
        return data

    def _predictor(self, data: FloatArray, recording: Recording, windows: int | None = None) -> FloatArray:
        """Return the instrumented predictor, shape (N p, rows above those of y), of the first windows."""
        if self.instruments == "open-loop":
            return predict_all_at_once(data[:, :windows], self.horizon * recording.y.shape[1])
        return predict_from_head(
            recording,
            self._layout,
            self._past_outputs,
            type(self).__name__,
            windows,
            by_excitation=self.instruments == "excitation",
        )

    def _test(self, data: FloatArray, recording: Recording) -> PredictionTest | None:
        """Return how well the outputs at the end of the horizon are predicted."""
        p, depth = recording.y.shape[1], self._layout.depth
        future = self.horizon * p
        if self._has_predictor:
            return fit_by_predictor(
                lambda windows: self._predictor(data, recording, windows), data, future, p, depth
            )
        ridge = np.zeros(len(data) - future)
        ridge[self._rows_of("y", recording)[: self._past_outputs * p]] = self._past_ridge
        return fit_by_windows(data, future, p, depth, ridge)

    @property
    def _spans(self) -> Sequence[Span]:
        """How long a dead time the windows cover."""
        # The first predicted output is the present one, which no input changes, or the next.
        seen = self.horizon - 1 + self.use_current_output
        if self.terminal_equality:  # at its end the outputs have to be there already
            seen -= self.initial_length - 1
        return Span(seen, "horizon"), Span(self._past_outputs, "initial_length")

    def _rows_of(self, signal: str, recording: Recording) -> NDArray[np.intp]:
        """Return which rows of M hold a signal."""
        widths = {name: values.shape[1] for name, values in signals_of(recording).items()}
        return self._layout.rows_of(signal, widths)

    def _tracking_problem(
        self, loop: Loop, *, prefer_rest: bool = False, future_slack: float = 0.0
    ) -> Problem:
        """Write down the cost, the terminal condition and the bounds; the past outputs are the subclass's."""
        settings = TrackingSettings(
            horizon=self.horizon,
            setpoint="input-output" if self.artificial_setpoint else "none",
            output_weight=self.output_weight,
            input_weight=self.input_weight,
            setpoint_weight=self.setpoint_weight,
            setpoint_margin=self.setpoint_margin,
            terminal_length=self.initial_length if self.terminal_equality else 0,
            soft_output_bounds=self.soft_output_bounds,
        )
        sizes = self._parameters.sizes
        past = {"u_ini": sizes["u_ini"], "y_ini": sizes["y_ini"]} | ({"sum_g": 1} if self._sums_g else {})
        disturbed = {D: sizes[D]} if D in sizes else {}
        return tracking_problem(
            settings,
            loop.bounds,
            resting_input(loop),
            self._rates,
            past | disturbed,
            sizes,
            known={"u_ini": "u_ini"}
            | ({"sum_g": "one"} if self._sums_g else {})
            | dict.fromkeys(disturbed, self._outlook.course),
            prefer_rest=prefer_rest,
            future_slack=future_slack,
            outlook=self._outlook,
            margins=self._margins,
            predictor=self._limited_by,
        )

    def _plan(self, sample: Sample) -> tuple[FloatArray, str]:
        """Solve; return the input to apply now, keep those to apply next."""
        parameters = self._parameters
        parameters.fill("r", sample.reference)
        self._outlook.fill(parameters, sample)
        if self._outlook.moves_inputs:
            self._limits.move(sample.input_limits / self._scales.u[:, np.newaxis])
        following = self._following
        if following:
            parameters.fill(MARGINS, following.values)
        answer, fault = self._law.solve(parameters.array)
        if answer is None:
            self._info = NO_INFO
            return parameters.window("u_ini")[-1].copy(), fault
        planned, forecast = self._planned
        if following:
            following.predicted(answer[forecast : forecast + following.values.shape[1]])
        self._forecast = answer[planned:forecast]
        self._info = self._law.info(self._ends, answer, self._scales.y)
        if self._applies_answer:
            return answer[:planned], fault
        plan = answer[:planned].reshape(-1, self._inputs)
        if self._learner:
            self._learner.add_dither(plan)
        self._limits.hold_changes(plan, parameters.window("u_ini")[-1])
        if not fault:
            self._pending = list(plan[1:])
        return plan[0].copy(), fault

    def _continue_plan(self, sample: Sample) -> tuple[FloatArray, str]:
        """Return the next input of the present plan."""
        self._outlook.fill(self._parameters, sample)
        self._forecast, self._info = self._forecast[self._outputs :], NO_INFO
        return self._pending.pop(0), ""

    def _known(self, y: FloatArray) -> FloatArray:
        """Return outputs, shape (p,), with what the plan predicted in place of missing measurements."""
        return fill_missing(y, self._forecast[: self._outputs])

    def _fill_past(self, loop: Loop, recording: Recording) -> None:
        """Fill the past: with the samples before the first, or with rest as far as it is known yet."""
        before = samples_before(loop, self._past_outputs)
        past = slice(-self.initial_length, None)
        self._parameters.fill("u_ini", resting_input(loop) if before is None else before.u[past])
        known = recording if before is None else before
        self._parameters.fill("y_ini", known.y[-self._past_outputs :])
        self._outlook.begin(self._parameters, known.d[past])


@dataclass(kw_only=True)
class DeePC(OnlineSettings, BehavioralTracking):
    """Data-enabled predictive control, equation (8).

    The weights are those of Table 1 by default. The problem is the printed one with ``regulariser = "ridge"``
    and ``terminal_equality`` on; by default both are milder, for the ridge pulls every output to zero, and a
    plant slower than the horizon cannot rest at its end. ``artificial_setpoint`` off gives the regulation
    form of [8].

    ``regulariser`` is what ``lambda_g`` weighs: ``"ridge"`` ``|g|^2``; ``"equilibrium"``
    ``|g - g_s|^2 + 0.3 |(I - Pi) g_s|^2``, g_s(u_s, y_s) being the smallest combination that is at the
    artificial setpoint all along, past and future: being there costs nothing, as far as the data say that the
    plant rests there; ``"free-response"`` ``|g - g_f|^2``, g_f being the smallest combination with the past
    that goes on as the least-squares prediction does with the last input held: what the plan adds to it is
    forced by the data; ``"projection"`` ``|(I - Pi) g|^2``, only what goes beyond the least-squares
    prediction; ``"l1"`` ``|g|_1``, for which no condensed form is known: the full problem is solved by PIQP's
    sparse backend at every sample, at a cost that grows with the recording, and where that fails the last
    input is held.

    ``future_slack`` lets predicted outputs differ from the data rows by sigma_y too, in the cost, the
    terminal condition and the bounds, as in the robust scheme of Berberich et al.

    ``online_data`` lets the data follow the plant: see
    :class:`~ddpc_controllers.data.online.OnlineSettings`.
    """

    former_settings: ClassVar[Mapping[str, str]] = {
        "regulariser = shifted-ridge": 'use "equilibrium", which leaves no bias at rest with noise either',
        "zero_padding": "that is what deepc-published does",
        "affine_sum = first-horizon": "that is what deepc-published does",
    }

    regulariser: Regulariser = setting(
        "projection", choices=get_args(Regulariser), doc="what lambda_g weighs of g: see the class"
    )
    lambda_g: float = setting(
        50.0, above=0.0, doc="weight of the regulariser, of |g|^2 with the ridge", search=Log(1e-2, 1e4)
    )
    slack: bool = setting(True, doc="past outputs may be missed by sigma_y; otherwise they are met exactly")
    lambda_sigma: float = setting(
        1e7,
        above=0.0,
        doc="weight of |sigma_y|^2, the misfit of the past outputs",
        search=Log(1e2, 1e8),
        predicts={"regulariser": "ridge", "slack": True},
    )
    future_slack: bool = setting(
        False, doc="sigma_y on the predicted outputs too, as in the robust scheme; needs slack"
    )
    affine_sum: str = setting("none", choices=("none", "all"), doc="which entries of g sum to 1")

    def _faults_between_settings(self) -> list[str]:
        faults = super()._faults_between_settings()
        if self.regulariser == "equilibrium" and not self.artificial_setpoint:
            faults.append(
                "DeePC: regulariser = 'equilibrium' draws g to the artificial setpoint: switch "
                "artificial_setpoint on, or use another regulariser"
            )
        if self.future_slack and not self.slack:
            faults.append("DeePC: future_slack is for outputs missed by sigma_y: switch slack on, or it off")
        if self.online_data != "frozen" and self.regulariser == "l1":
            faults.append(
                "DeePC: regulariser = 'l1' has no condensed form to update; use another regulariser or "
                "online_data = 'frozen'"
            )
        if self.online_data != "frozen" and self.regulariser == "free-response":
            faults.append(
                "DeePC: regulariser = 'free-response' predicts from the recording, which online_data would "
                "not update: use another regulariser or online_data = 'frozen'"
            )
        if self.online_data != "frozen" and self.instruments != "none":
            faults.append(
                f"DeePC: instruments = {self.instruments!r} make a predictor of the recording, which "
                "online_data would not update: use online_data = 'frozen', or instruments = 'none'"
            )
        return faults + self.online_faults()

    @property
    def _past_ridge(self) -> float:
        # min lambda_g |g|^2 + lambda_sigma |Y_p g - y_ini|^2 with the inputs met exactly. With the projection
        # and about the free response the past is met without loss; the equilibrium depends on the setpoint,
        # and |g|_1 has no such form.
        return self.lambda_g / self.lambda_sigma if self.regulariser == "ridge" and self.slack else 0.0

    @property
    def _sums_g(self) -> bool:
        return self.affine_sum != "none"

    @property
    def _leaves_outputs_open(self) -> bool:
        return not self._has_predictor

    def _write_down(self, loop: Loop) -> Problem:
        """Write down (8), the slack sigma_y = Y_p g - y_ini eliminated."""
        problem = self._tracking_problem(loop, future_slack=self.lambda_sigma * self.future_slack)
        past_y = np.eye(self._parameters.sizes["y_ini"])
        if self.slack:
            weight = self.lambda_sigma * np.eye(len(loop.outputs))
            problem.penalise(weight, {"y_ini": past_y}, {"y_ini": past_y})
        else:
            problem.equate({"y_ini": past_y}, {"y_ini": past_y})
        if self.regulariser == "projection":
            problem.regularise({"y": self.lambda_g})
        elif self.regulariser == "equilibrium":
            weights = {"y": _UNEXPLAINED * self.lambda_g}
            problem.regularise_about(self._rows_at_rest(loop), self.lambda_g, weights)
        elif self.regulariser == "free-response":
            problem.regularise_about(self._free_response(loop, problem), self.lambda_g, {})
        elif self.regulariser == "ridge":
            problem.regularise(self.lambda_g)
        return problem

    def _free_response(self, loop: Loop, problem: Problem) -> Mapping[str, Blocks]:
        """Return the data rows of the past as it goes on with its last input held, by least squares."""
        recording = matching_recording(loop, type(self).__name__)
        data, future = self._stack(recording), problem.rows["y"]
        predictor = (
            self._predictor(data, recording) if self._has_predictor else predict_all_at_once(data, future)
        )
        past, m = problem.rows["u_ini"], len(loop.inputs)
        known: dict[str, Blocks] = {
            "u_ini": {"u_ini": np.eye(past)},
            "y_ini": {"y_ini": np.eye(problem.rows["y_ini"])},
            "sum_g": {"one": np.eye(1)},
            D: self._outlook.course,
            "u": {"u_ini": np.tile(np.eye(m, past, past - m), (self.horizon, 1))},
        }
        known = {name: blocks for name, blocks in known.items() if name in problem.rows}
        y: dict[str, FloatArray] = {}
        ends = np.cumsum([problem.rows[name] for name in known])[:-1]
        for coefficients, blocks in zip(np.split(predictor, ends, axis=1), known.values(), strict=True):
            for name, block in blocks.items():
                y[name] = y.get(name, 0.0) + coefficients @ block
        return {**known, "y": y}

    def _rows_at_rest(self, loop: Loop) -> Mapping[str, Blocks]:
        """Return the data rows of a plant that rests at the artificial setpoint (u_s, y_s)."""
        u_s, y_s, past, n = (
            np.eye(len(loop.inputs)),
            np.eye(len(loop.outputs)),
            self.initial_length,
            self.horizon,
        )
        return {
            "u_ini": {"u_s": np.tile(u_s, (past, 1))},
            "y_ini": {"y_s": np.tile(y_s, (self._past_outputs, 1))},
            "u": {"u_s": np.tile(u_s, (n, 1))},
            "y": {"y_s": np.tile(y_s, (n, 1))},
            **self._outlook.at_rest(),
        } | ({"sum_g": {"one": np.eye(1)}} if self._sums_g else {})

    def _make_learner(
        self, problem: Problem, data: FloatArray, loop: Loop, recording: Recording
    ) -> Learner | None:
        if self.online_data == "frozen":
            return None
        return Learner(
            self,
            problem,
            data,
            self._layout,
            signals_of(recording),
            self._scales.u,
            loop.continues_recording,
            copy.deepcopy(loop.rng),
        )

    def _make_law(self, problem: Problem, data: FloatArray) -> Law:
        if self.regulariser == "l1":
            return UncondensedLaw(problem, self.lambda_g, data, self._limits)
        return super()._make_law(problem, data)
