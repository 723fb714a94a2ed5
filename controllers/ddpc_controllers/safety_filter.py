"""A safety filter from data: inputs of any controller, changed only as far as the outputs' limits ask for.

At every sample the controller inside says which inputs w it wants. What the plant gets is the first of the
inputs that

    minimise   |u_0 - w|^2 + 1e-4 sum_k |u_k - u_k-1|^2
    such that  (u, y) goes on from the measured past, as the recording foretells it,
               u_min <= u_k <= u_max,   y_min + q_k <= y_k+1 <= y_max - q'_k,   k = 0 ... N - 1,
               the horizon ends in a plan that can be kept for good,

which is w itself wherever there is such a plan that begins with it. This is the predictive safety filter of
K. P. Wabersich, M. N. Zeilinger, *A predictive safety filter for learning-based control of constrained
nonlinear dynamical systems*, Automatica 129, 2021, doi:10.1016/j.automatica.2021.109597, with the predictor
of subspace predictive control in place of a model: the least-squares prediction from recorded windows, the
entries of g summing to 1, so that an operating point need not be the origin. q_k, q'_k are the margins of
:mod:`~ddpc_controllers.optimisation.tightening`, in place of the tubes about a model.

The terminal set is one that recorded data can tell. With ``terminal = "held"`` the inputs of the horizon's
second half are one value: the outputs of a stable plant that keep their limits until they have settled keep
them for good. With ``"rest"`` the outputs of the last ``initial_length + 1`` samples, and the inputs between
them, are one equilibrium (M. Bajelani, K. van Heusden, *Data-driven safety filter: an input-output
perspective*, arXiv:2309.00189), which a plant needs that does not come to rest by itself.

Where no inputs keep all of it, the terminal condition becomes a cost, and then the limits: ``excess_weight``
times the square of what is exceeded. The status says so.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, get_args

import numpy as np

from ddpc_controllers.checks import all_finite, fill_missing
from ddpc_controllers.data.hankel import (
    ONE,
    WindowLayout,
    informative_windows,
    least_samples,
    matching_recording,
    resting_input,
    samples_before,
)
from ddpc_controllers.data.instruments import predict_from_head
from ddpc_controllers.data.quality import Span, fit_by_predictor, judge
from ddpc_controllers.export.code import ALL_AHEAD, Code, inner_step
from ddpc_controllers.export.law import add_law
from ddpc_controllers.optimisation.backends import BACKENDS, BackendName, make_backend
from ddpc_controllers.optimisation.limits import PREDICTED, InputLimits
from ddpc_controllers.optimisation.outlook import D, Foresight, Outlook
from ddpc_controllers.optimisation.problem import ParameterVector, Problem, sample_by_sample
from ddpc_controllers.optimisation.qp import make_law
from ddpc_controllers.optimisation.tightening import Promise
from ddpc_controllers.scaling import SCALES, Predicted, ScaleBy, Scales
from ddpc_controllers.wrapper import SingleWrapper, joined
from ddpc_cosim import OK, Action, FloatArray, Integer, Loop, Sample, setting

Terminal = Literal["held", "rest", "none"]

_SMOOTH = 1e-4
"""Weight of the changes of a plan, beside that of its first inputs: it makes the plan unique."""
_TERMINAL = 1e2
_SAME = 1e-3
"""Of an input's scale: what differs by less from what is wanted is that."""
_NO_PRICES = Foresight(price_weight=0.0)
NOT_YET = "no finite measurement yet: inputs not filtered"


@dataclass(kw_only=True)
class SafetyFilter(Promise, SingleWrapper):
    """A controller whose inputs are changed where the outputs would leave their limits, and only there.

    ``intervention.INPUT`` in the trace is by how much, and the diagnostic ``intervention_rate`` is the share
    of the samples in which it was. The controller inside is not told; an integral of its own goes on. The
    filter sees as far ahead of disturbances and limits that move as the controller inside does, and holds the
    last value after that. Missing outputs are replaced by their prediction.
    """

    _known_in_c: ClassVar[Collection[str]] = ALL_AHEAD

    initial_length: int = setting(
        4, low=1, doc="samples of the past that fix the initial condition", search=Integer(1, 8)
    )
    steps_ahead: int = setting(
        20,
        low=2,
        doc="N: samples over which the predicted outputs are kept within their limits",
        search=Integer(5, 40),
    )
    terminal: Terminal = setting(
        "held",
        choices=get_args(Terminal),
        doc="how the plan ends: with inputs held over the second half; at rest over the last initial_length "
        "samples; or any way",
    )
    excess_weight: float = setting(
        1e4,
        above=0.0,
        doc="weight of |excess|^2 beyond the limits where they cannot be kept, beside |u - wanted|^2",
    )
    scaling: ScaleBy = setting(
        "range",
        choices=SCALES,
        doc="what weighs 1: half the signal's range (else its nominal value), its nominal value, or its unit",
    )
    backend: BackendName = setting("piqp", choices=BACKENDS, doc="QP solver for active sets not seen before")

    uses_recording: ClassVar[bool] = True

    def start(self, loop: Loop) -> None:
        """Start the controller, and condense the problem on the loop's recording.

        Raises
        ------
        DataError
            There is no recording, or one that does not say enough.
        CosimError
            What the controller says itself.
        """
        self._start_inside(loop)
        self._seen = Predicted(loop, _NO_PRICES, learns=True)
        self._scales = Scales(replace(self._seen.loop, bands=(), charges=()), self.scaling)
        self._inputs = tuple(f"intervention.{variable.name}" for variable in loop.inputs)
        self._steps = self._interventions = 0
        self._start_scaled(self._scales.loop)

    def _start_scaled(self, loop: Loop) -> None:
        """Condense the problem in scaled signals, and fill the past."""
        recording, who = matching_recording(loop, type(self).__name__), type(self).__name__
        m, p, past, n = len(loop.inputs), len(loop.outputs), self.initial_length, self.steps_ahead
        layout = WindowLayout(
            ("u", 0, past),
            ("y", 0, past + 1),
            (ONE, 0, 1),
            ("d", 0, past + n),
            ("u", past, n),
            ("y", past + 1, n),
        )
        data, self._diagnostics = informative_windows(layout, recording, self._order(p), past + n, who)
        known = data[: len(data) - n * p]

        def predictor(windows: int | None = None) -> FloatArray:
            return predict_from_head(recording, layout, past + 1, who, windows)

        test = fit_by_predictor(predictor, data, n * p, p, layout.depth)
        spans = Span(n, "steps_ahead"), Span(past + 1, "initial_length")
        self._judgement = judge(who, recording, loop.outputs, spans, (test, n))
        self._margins = self._drawn_in_by(loop, n)
        self._bounds = loop.bounds.u_min, loop.bounds.u_max
        self._limits = InputLimits(*self._bounds)
        self._outlook = Outlook(loop, _NO_PRICES, n, past=past)
        windows = {"u_ini": (past, m), "y_ini": (past + 1, p), "wanted": (1, m), **self._outlook.windows}
        self._parameters = ParameterVector(windows)
        problem = self._write_down(loop)
        problem.ask(u=m, y=p)
        data = np.vstack([known, predictor() @ known])
        self._law = make_law(problem, data, self._limits, make_backend(self.backend), None)
        before = samples_before(loop, past + 1)
        self._resting, newest = before is None, before or recording
        self._parameters.fill("u_ini", resting_input(loop) if before is None else before.u[1:])
        self._parameters.fill("y_ini", newest.y[-past - 1 :])
        self._outlook.begin(self._parameters, newest.d[-past:])
        self._forecast = newest.y[-1]

    def _write_down(self, loop: Loop) -> Problem:
        """Write down the problem of the module's text."""
        sizes, n, bounds = self._parameters.sizes, self.steps_ahead, loop.bounds
        m, p, every_u = len(loop.inputs), len(loop.outputs), np.eye(n * sizes["wanted"])
        past = {"u_ini": sizes["u_ini"], "y_ini": sizes["y_ini"], "sum_g": 1}
        past |= {D: sizes[D]} if D in sizes else {}
        problem = Problem({**past, "u": n * m, "y": n * p}, {}, sizes)
        problem.regularise({"u": 0.0, "y": np.inf})
        for row, size in past.items():
            known = {row: np.eye(size)} if row in sizes else {"one": np.eye(1)}
            problem.equate({row: np.eye(size)}, self._outlook.course if row == D else known)
        problem.penalise(np.eye(m), {"u": every_u[:m]}, {"wanted": np.eye(m)})
        problem.penalise(_SMOOTH * np.eye(m), {"u": _changes(n, n - 1, m)}, {})
        if self.terminal == "held":
            problem.equate({"u": _changes(n, n // 2, m)}, {}, _TERMINAL)
        elif self.terminal == "rest":
            if self.initial_length > 1:
                problem.equate({"u": _changes(n, self.initial_length - 1, m)}, {}, _TERMINAL)
            problem.equate({"y": _changes(n, self.initial_length, p)}, {}, _TERMINAL)
        problem.bound("u", bounds.u_min, bounds.u_max, name="u", moving=self._outlook.moving("u", bounds))
        moving = self._outlook.moving("y", bounds)
        lower, upper = bounds.y_min, bounds.y_max
        if self._margins:
            lower, upper, moving = self._margins.draw_in(lower, upper, slice(None), moving)
        problem.bound("y", lower, upper, name="y", relaxed=self.excess_weight, moving=moving)
        return problem

    def step(self, sample: Sample) -> Action:
        """Return the controller's inputs, or the nearest with which the outputs keep their limits."""
        action = self._inner.step(sample)
        if not all_finite(action.u):  # which is the loop's to report
            return action
        self._wanted = action.u / self._scales.u
        filtered = self._scales.step(self._filter, self._extended(self._seen.sample(sample)))
        assert isinstance(filtered, Action)
        u = filtered.u if self._intervenes else action.u
        self._steps, self._interventions = self._steps + 1, self._interventions + self._intervenes
        changes = dict(zip(self._inputs, (u - action.u).tolist(), strict=True))
        return joined(u, (action, filtered._replace(info=changes)))

    def _filter(self, sample: Sample) -> Action:
        """Return scaled inputs for a sample of scaled signals, and note whether they are not those wanted."""
        parameters, y, missing = self._parameters, sample.y, not all_finite(sample.y)
        low, high = sample.input_limits[0].T if self._outlook.moves_inputs else self._bounds
        wanted, self._intervenes = np.clip(self._wanted, low, high), False
        if self._resting:
            if missing:  # nothing is known of the plant yet
                return Action(wanted, NOT_YET)
            parameters.fill("y_ini", y)
            self._outlook.begin(parameters, sample.disturbance)
            self._resting = False
        else:
            parameters.append("y_ini", fill_missing(y, self._forecast) if missing else y)
        parameters.fill("wanted", wanted)
        self._outlook.fill(parameters, sample)
        if self._outlook.moves_inputs:
            self._limits.move(sample.input_limits)
        answer, fault = self._law.solve(parameters.array)
        u = wanted if answer is None else answer[: len(wanted)]
        if answer is not None:
            self._forecast = answer[len(wanted) :]
            self._intervenes = bool((np.abs(u - wanted) > _SAME).any())
        u = u if self._intervenes else wanted
        parameters.append("u_ini", u)
        self._outlook.advance(parameters)
        return Action(u, fault or (PREDICTED if missing else OK))

    def c_step(self, code: Code, loop: Loop) -> str:
        """Add the controller, and what changes its inputs."""
        wants = inner_step(self._inner.controller, code, loop)
        code.kernel("safety_filter")
        m, p, outlook, sizes = len(loop.inputs), len(loop.outputs), self._outlook, self._parameters.sizes
        law = add_law(code, self._law, m + p, outlook.moves_inputs)
        low, high = self._bounds
        name = code.constant(
            "SafetyFilter",
            m=m,
            p=p,
            past=self.initial_length,
            scale=code.doubles(self._scales.u),
            low=code.doubles(low),
            high=code.doubles(high),
            same=_SAME,
            law=law.pointer,
            **outlook.members(code, self._limits),
        )
        limited = np.zeros(2 * m * outlook.moves_inputs)
        parameters = code.memory(np.concatenate([self._parameters.array, limited]))
        rest = [self._resting], [0.0], np.zeros(m), self._forecast, np.zeros(m + p), np.zeros(law.memory)
        held = code.held("SafetyFilterMemory", parameters, *rest)

        def changes(code: Code, _: Loop) -> str:
            first = f"{parameters} + {sum(sizes[window] for window in ('u_ini', 'y_ini', 'wanted'))}"
            look = outlook.in_c(code, first, 1)
            return code.step(f"{held}{look}filter_inputs(&{name}, &held, sample, u, told);")

        ahead = code.ahead
        with code.seeing(ahead and ahead.through(lambda sample: self._extended(self._seen.sample(sample)))):
            filtered = self._scales.c_step(code, changes, 0)
        return code.step(
            f"{held}{wants}(memory, sample, u, told);\n"
            f"if (!take_wanted(&{name}, &held, sample, u)) return;\n"
            f"{filtered}(memory, sample, u, told);\n"
            f"give_wanted(&{name}, &held, u);"
        )

    def _extended(self, sample: Sample) -> Sample:
        """Return a sample with as many rows of what is known ahead as the filter looks ahead."""
        n, bounds = self.steps_ahead, self._seen.loop.bounds
        of_u, of_y = (
            np.stack(sides, axis=1) for sides in ((bounds.u_min, bounds.u_max), (bounds.y_min, bounds.y_max))
        )
        return sample._replace(
            forecast=_rows(sample.forecast, n, sample.disturbance),
            input_limits=_rows(sample.input_limits, n + 1, of_u),
            output_limits=_rows(sample.output_limits, n, of_y),
        )

    def diagnostics(self) -> Mapping[str, float]:
        """Return the controller's values, the share of interventions, and those of the filter's recording."""
        filter_diagnostics = {**self._diagnostics.as_dict(), **self._judgement.diagnostics}
        # The compiled engine makes no step here: nothing is known of how many inputs it changed.
        share = {"intervention_rate": self._interventions / self._steps} if self._steps else {}
        return {
            **super().diagnostics(),
            **share,
            **self.promised(),
            **{f"filter.{name}": value for name, value in filter_diagnostics.items()},
        }

    def warnings(self) -> Sequence[str]:
        """Return the controller's warnings, and what speaks against the filter's recording or limits."""
        bounds = self._seen.loop.bounds
        limited = np.isfinite(bounds.y_min).any() or np.isfinite(bounds.y_max).any()
        idle = [] if limited else ["SafetyFilter: no output has a limit, so it changes nothing: set bounds"]
        return [*super().warnings(), *idle, *self._seen.warnings, *self._judgement.warnings]

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return the signals both use, and the controller's prior information about the plant."""
        facts = dict(super().knowledge(loop))
        measured = [*filter(None, facts.get("measures", "").split(", ")), *(v.name for v in loop.outputs)]
        return facts | {"measures": ", ".join(dict.fromkeys(measured))}

    def recording_length(self, inputs: int, outputs: int, measurements: int, disturbances: int = 0) -> int:
        """Return the fewest samples that controller and filter need."""
        filter_length = max(least_samples(self._order(outputs), inputs + disturbances), self._depth)
        return max(filter_length, super().recording_length(inputs, outputs, measurements, disturbances))

    @property
    def past_length(self) -> int:
        """How many samples of a running plant controller and filter need."""
        return max(super().past_length, self.initial_length + 1)

    @property
    def _depth(self) -> int:
        return self.initial_length + 1 + self.steps_ahead

    def _order(self, outputs: int) -> int:
        """Return the order of excitation that is needed, the plant's order supposed to be the past's."""
        return self.initial_length + self.steps_ahead + self.initial_length * outputs

    def _faults_between_settings(self) -> list[str]:
        faults = super()._faults_between_settings()
        if self.terminal == "rest" and self.steps_ahead <= self.initial_length:
            faults.append(
                f"SafetyFilter: steps_ahead = {self.steps_ahead} is not longer than initial_length = "
                f"{self.initial_length}, over which the plan ends at rest: lengthen it, or choose another "
                "terminal"
            )
        return faults


def _changes(samples: int, count: int, width: int) -> FloatArray:
    """Return the block that takes the last changes, so many of them, from the samples of a horizon."""
    return sample_by_sample(np.diff(np.eye(samples), axis=0)[-count:], np.eye(width))


def _rows(values: FloatArray, count: int, otherwise: FloatArray) -> FloatArray:
    """Return so many rows, the last one held; where there is none yet, of what is so otherwise."""
    rows = values[:count] if len(values) else otherwise[np.newaxis]
    return np.concatenate([rows, np.repeat(rows[-1:], count - len(rows), axis=0)])
