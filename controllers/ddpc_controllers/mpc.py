"""Linear model predictive control without offset: a Kalman filter and the tracking problem of its model.

Cost, horizon and limits are those of the data-driven methods, so that what differs is the model alone: with
the true model of a linear plant it does what DeePC (8) does with its noise-free recording. A constant
disturbance, estimated with the states, removes the offset (G. Pannocchia, J. B. Rawlings, AIChE J. 49(2),
2003, doi:10.1002/aic.690490213).

A model's trajectories over the horizon are all ``h = (x, d, u, y) = M (x, d, u)``: what the Hankel matrices
are to a recording, the matrix M is to a model. Known disturbances d are those measured now and forecast, and
the filter knows them as it knows the inputs. Costs, limits, condensing and the online solution are shared.
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ddpc_controllers.data.hankel import resting_input
from ddpc_controllers.data.quality import Span
from ddpc_controllers.export.code import Code
from ddpc_controllers.export.law import add_law
from ddpc_controllers.models.kalman import DISTURBANCES, Disturbance, ModelBased
from ddpc_controllers.optimisation.backends import make_backend
from ddpc_controllers.optimisation.limits import InputLimits, rate_limits
from ddpc_controllers.optimisation.outlook import ENDLESS, D, Outlook, expected_course
from ddpc_controllers.optimisation.problem import ParameterVector
from ddpc_controllers.optimisation.qp import NO_INFO, make_law, predicted_ends
from ddpc_controllers.optimisation.tightening import MARGINS, Margins
from ddpc_controllers.optimisation.tracking import TrackingSettings, tracking_problem
from ddpc_controllers.scaling import Scales
from ddpc_cosim import (
    FloatArray,
    Log,
    Loop,
    Sample,
    setting,
)


def trajectories(
    a: FloatArray, b: FloatArray, c: FloatArray, horizon: int, e: FloatArray, f: FloatArray
) -> FloatArray:
    """Return M of ``(known, u_0 ... u_N-1, y_1 ... y_N) = M (known, u_0 ... u_N-1)``.

    Known are ``(x_0, u_-1, d_0 ... d_N)``. The first predicted output is that of the next sample: the output
    of this one is measured already.
    """
    (n, m), n_d = b.shape, e.shape[1]
    first = n + m + (horizon + 1) * n_d
    size = first + horizon * m
    states = np.eye(n, size)
    outputs = []
    for k in range(horizon):
        now = n + m + k * n_d
        states = a @ states
        states[:, first + k * m : first + (k + 1) * m] += b
        states[:, now : now + n_d] += e
        outputs.append(c @ states)
        outputs[-1][:, now + n_d : now + 2 * n_d] += f
    return np.vstack([np.eye(size), *outputs])


class Predictor:
    """A model's tracking problem, condensed: from a state and a reference to the next inputs.

    Parameters
    ----------
    a, b, c, e, f : array, shapes (n, n), (n, m), (p, n), (n, n_d), (p, n_d)
        The model, its inputs and outputs those of the loop, and how known disturbances act on both.
    settings : TrackingSettings
        What to minimise.
    loop : Loop
        The loop of the model's signals: limits, bands, prices, inputs at rest.
    scales : Scales
        What one unit of each input and output of the model is.
    controlled : int
        How many of the outputs are controlled; the others are paid for.
    margins : Margins, optional
        By what the limits of the outputs are drawn in.

    Attributes
    ----------
    info : mapping of str to float
        What there is to say of the last solution.

    Raises
    ------
    ConfigError
        A weight or a rate bound does not fit the number of signals, or the weights leave the optimum
        undetermined.
    """

    def __init__(
        self,
        a: FloatArray,
        b: FloatArray,
        c: FloatArray,
        e: FloatArray,
        f: FloatArray,
        settings: TrackingSettings,
        loop: Loop,
        scales: Scales,
        controlled: int,
        margins: Margins | None = None,
    ) -> None:
        n, m, p, n_d = len(a), b.shape[1], len(c), e.shape[1]
        self._rates = rates = rate_limits(settings.rate_bounds, m) / scales.u
        self._inputs, self._unit = m, scales.y
        self._ends, self.info = predicted_ends(loop.outputs), NO_INFO
        self._limits = InputLimits(loop.bounds.u_min, loop.bounds.u_max, rates)
        self._disturbed, self._uses_forecast = n_d > 0, settings.use_forecast is True
        # The disturbances are rows of the data up to the last output, which they can show in at once.
        self._outlook = Outlook(
            replace(loop, disturbances=()), settings, settings.horizon, controlled=controlled
        )
        known = {"x": (1, n), "u_ini": (1, m)}
        disturbed = {D: (settings.horizon + 1, n_d)} if n_d else {}
        self._margins = margins
        self._following = margins.online if margins else None
        of_margins = margins.windows if margins else {}
        windows = {**known, "r": (settings.horizon, p), **of_margins, **disturbed, **self._outlook.windows}
        self._parameters = ParameterVector(windows)
        self._known_size = n + m + self._parameters.sizes["r"]
        past = {name: self._parameters.sizes[name] for name in (*known, *disturbed)}
        course = {name: expected_course(settings, loop, 0, settings.horizon + 1) for name in disturbed}
        problem = tracking_problem(
            settings,
            loop.bounds,
            resting_input(loop),
            rates,
            past,
            self._parameters.sizes,
            known={**{name: name for name in known}, **course},
            prefer_rest=True,
            outlook=self._outlook,
            margins=margins,
        )
        problem.ask(u=m)
        if self._following:
            problem.ask(y=settings.horizon * p)
        problem.ask(y=-p)
        data = trajectories(a, b, c, settings.horizon, e, f)
        self._law = make_law(problem, data, self._limits, make_backend(settings.backend), None)

    def begin(self) -> None:
        """Begin anew with another past."""
        if self._following:
            self._following.begin()

    def solve(self, state: FloatArray, last_input: FloatArray, sample: Sample) -> tuple[FloatArray, str]:
        """Return the first optimal inputs, shape (m,), and why they are not the optimum, empty if they are.

        Parameters
        ----------
        state : array, shape (n,)
            State at this sample.
        last_input : array, shape (m,)
            Inputs applied at the last sample.
        sample : Sample
            What else is known now: references of the next samples, disturbances.
        """
        self._parameters.fill("x", state)
        self._parameters.fill("u_ini", last_input)
        self._parameters.fill("r", sample.reference)
        self._look_ahead(self._parameters, sample)
        if self._outlook.moves_inputs:
            self._limits.move(sample.input_limits)
        following = self._following
        if following:
            following.measured(sample.y)
            self._parameters.fill(MARGINS, following.values)
        answer, fault = self._law.solve(self._parameters.array)
        if answer is None:
            self.info = NO_INFO
            return last_input.copy(), fault
        u = answer[: self._inputs]
        if following:
            following.predicted(answer[self._inputs : self._inputs + following.values.shape[1]])
        self.info = self._law.info(self._ends, answer, self._unit)
        self._limits.hold_changes(u[np.newaxis], last_input)
        return u, fault

    def _look_ahead(self, parameters: ParameterVector, sample: Sample) -> None:
        """Fill what is known of the time ahead."""
        if self._disturbed:
            d, forecast = parameters.window(D), sample.forecast[: self._outlook.horizon]
            d[0], d[1:] = sample.disturbance, forecast if self._uses_forecast else sample.disturbance
        self._outlook.fill(parameters, sample)

    def constant(self, code: Code) -> tuple[str, int]:
        """Add it to code in C; return its name, and how many numbers ``solve_predictor`` remembers."""
        if self._margins:
            self._margins.require_fixed()
        code.kernel("predictor")
        moving = self._outlook.moves_inputs
        law = add_law(code, self._law, self._inputs, moving)
        sizes = self._parameters.sizes
        limits = self._limits.tables()
        ahead = sum(sizes.values()) - self._known_size - 1
        members: dict[str, object] = {"ahead": ahead} if ahead else {}
        if moving:
            members["near"] = code.doubles(self._limits.near)
        name = code.constant(
            "Predictor",
            n=sizes["x"],
            m=self._inputs,
            references=sizes["r"],
            low=code.doubles(limits["low"]),
            high=code.doubles(limits["high"]),
            rates=code.doubles(self._rates),
            law=law.pointer,
            **members,
        )
        return name, len(self._parameters.array) + 2 * self._inputs * moving + law.memory

    def look(self, code: Code, memory: str) -> str:
        """Return statements in C that fill what the memory of ``solve_predictor`` has of the time ahead."""
        first, size = self._known_size, len(self._parameters.array)
        if code.ahead is None or first == size - 1:
            return ""

        def filled(sample: Sample) -> FloatArray:
            parameters = copy.deepcopy(self._parameters)
            self._look_ahead(parameters, sample)
            return parameters.array[first:-1]

        look = code.ahead.chosen(code, filled, f"{memory} + {first}", ENDLESS)
        if self._outlook.moves_inputs:
            look += code.ahead.limits(code, 1, f"{memory} + {size}")
        return look


@dataclass(kw_only=True)
class MPC(TrackingSettings, ModelBased):
    """Linear model predictive control with an estimated disturbance.

    A measurement that is not finite is replaced by the model's prediction; before the first finite one the
    inputs stay at rest. Either is a status.
    """

    disturbance: Disturbance = setting(
        "auto",
        choices=DISTURBANCES,
        doc="what carries the constant disturbance estimated; auto: the outputs, the inputs of a plant "
        "that integrates, or is too slow to tell",
    )
    disturbance_noise: float = setting(
        1.0,
        above=0.0,
        doc="filter: standard deviation of the disturbance's change per sample",
        search=Log(1e-2, 1e2),
    )

    def _start(self, loop: Loop) -> None:
        """Set up the filter, and condense the model's tracking problem."""
        self._observe(loop, self.disturbance, self.disturbance_noise)
        model = self._observer
        self._predictor = Predictor(
            *(model.a, model.b, model.c, model.e, model.f),
            *(self, loop, self._scales, self._method_loop.controlled),
            self._drawn_in_by(loop, self.horizon),
        )

    def restart(self, loop: Loop) -> None:
        """Begin anew with another past: the model and all that follows from it stay."""
        super().restart(loop)
        self._predictor.begin()

    @property
    def _ahead(self) -> Sequence[Span]:
        return (Span(self.horizon, "horizon"),)

    def _decide(self, sample: Sample) -> tuple[FloatArray, str]:
        """Return the first optimal inputs of the horizon."""
        u, fault = self._predictor.solve(self._observer.state, self._u, sample)
        self._info = self._predictor.info
        return u, fault

    def _c_decide(self, code: Code, loop: Loop, observer: str) -> str:
        predictor, size = self._predictor.constant(code)
        memory = code.memory(np.zeros(size))
        look = self._predictor.look(code, memory)
        known = f"held.state, held.u, sample->reference, {memory}"
        size_of_u = f"{len(self._u)} * sizeof(double)"
        return (
            f"{look}if (sample->applied != NULL) memcpy(u, sample->applied, {size_of_u});\n"
            f"else solve_predictor(&{predictor}, {known}, u, told);"
        )

    def diagnostics(self) -> Mapping[str, float]:
        """Return the order of the model with its disturbances, its slowest or most unstable pole, its fit."""
        a = self._observer.a[:-1, :-1]
        poles = {"model_order": float(len(a)), "spectral_radius": float(np.abs(np.linalg.eigvals(a)).max())}
        return {**poles, **super().diagnostics(), **self.promised()}

    def _faults_between_settings(self) -> list[str]:
        return super()._faults_between_settings() + self.tracking_faults()
