"""Willems-Koopman predictive control, equations (10)-(12)."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ddpc_controllers.checks import LastMeasurement, all_finite, check_settings_and, stand_in, weight_matrices
from ddpc_controllers.data.dictionaries import Dictionary, ThinPlate, embed, memory_of
from ddpc_controllers.data.hankel import diagnose, least_samples, require_excitation, require_length
from ddpc_controllers.data.online import Learner, OnlineLearning
from ddpc_controllers.data.windows import (
    Block,
    ParameterVector,
    StateWindow,
    WindowLayout,
    matching_recording,
    padded_with_zeros,
    resting_input,
    setpoint_bounds,
    without_first,
)
from ddpc_controllers.optimisation.backends import BACKENDS, BackendName, make_backend
from ddpc_controllers.optimisation.limits import HELD, PREDICTED
from ddpc_controllers.optimisation.problem import Problem
from ddpc_controllers.optimisation.qp import NOT_FINITE, AdaptiveQP, ParametricQP
from ddpc_controllers.published import DoubleShift, PublishedThinPlate
from ddpc_cosim import Action, FloatArray, Loop, Recording, Sample, Weight, setting


@dataclass(kw_only=True)
class WKPC(OnlineLearning):
    """Willems-Koopman predictive control, equations (10)-(12).

    The lifted state is ``z = (x, psi_1(x), ..., psi_np(x))`` with x all that is measured. Future lifted
    states are not known, so the lifted rows cover the past window only. The defaults are those of Table 1.
    ``zero_padding``, ``redraw_centre``, ``squared_distance`` and ``double_shift`` do what the paper's
    published program does and (10)-(12) do not. ``online_data`` lets the data follow the plant: see
    :class:`~ddpc_controllers.data.online.OnlineLearning`.
    """

    uses_recording: ClassVar[bool] = True
    accepts_missing: ClassVar[bool] = True

    initial_length: int = setting(2, low=1, doc="samples of the past that fix the initial condition, Tini")
    horizon: int = setting(5, low=1, doc="prediction horizon N, samples")
    output_weight: Weight = setting(1.0, low=0.0, doc="Q: predicted outputs off the reference")
    input_weight: Weight = setting(0.1, above=0.0, doc="R: inputs off the artificial setpoint")
    lambda_g: float = setting(0.1, above=0.0, doc="weight of |g|^2")
    setpoint_margin: float = setting(
        0.99, above=0.0, high=1.0, doc="share of the limits open to the setpoint"
    )
    dictionary: Dictionary = setting(default_factory=ThinPlate, doc="observables that lift the state")
    backend: BackendName = setting("piqp", choices=BACKENDS, doc="QP solver for active sets not seen before")
    zero_padding: bool = setting(False, doc="append initial_length samples of zero to the recorded u and y")
    redraw_centre: bool = setting(False, doc="one centre for all functions, drawn at every evaluation")
    squared_distance: bool = setting(False, doc="square the distance in front of the logarithm of (12)")
    double_shift: bool = setting(False, doc="append two lifted samples a step to the lifted data")

    def __post_init__(self) -> None:
        check_settings_and(self, self._faults_between_settings)

    def _start(self, loop: Loop) -> None:
        """Lift the loop's recording and condense the problem on it."""
        recording = matching_recording(loop, "WKPC")
        # A copy of the stream: another start draws the same centres.
        rng = copy.deepcopy(loop.rng)
        memory = memory_of(self.dictionary)
        self._memory = memory
        self._last = LastMeasurement(recording.measured, recording.y)
        self._states = StateWindow(recording.measured[-1 - memory :])
        states = embed(recording.measured, memory)
        recording = without_first(recording, memory)
        self._observables = self._dictionary().draw(states, rng)
        lifted = self._lift(states)
        m, p, past = len(loop.inputs), len(loop.outputs), self.initial_length
        self._parameters = ParameterVector(
            {
                "z_ini": (past, lifted.shape[1]),
                "u_ini": (past, m),
                "y_ini": (past, p),
                "r": (self.horizon, p),
            }
        )
        self._data = self._stack(recording, lifted)
        self._problem = self._write_down(loop).prepare("u", m, p)
        condensed = self._problem.condense(self._data)
        limits = loop.bounds.u_min, loop.bounds.u_max
        self._bounds = loop.bounds
        backend = make_backend(self.backend)
        self._qp: ParametricQP | AdaptiveQP = ParametricQP(condensed, *limits, backend)
        self._learner: Learner | None = None
        self._unlearned = 0
        if self.online_data != "frozen":
            signals = {"z": lifted, "u": recording.u, "y": recording.y}
            continues = loop.continues_recording
            self._learner = self._make_learner(
                self._problem, self._data, self._layout, signals, continues, rng
            )
            self._qp = AdaptiveQP(self._problem, self._learner.data, *limits, backend)
        self._begin(loop, recording, lifted)

    def _step(self, sample: Sample) -> FloatArray | Action:
        """Return the first optimal input of the horizon."""
        parameters, y, measured = self._parameters, sample.y, sample.measured
        lost = "" if all_finite(y) and all_finite(measured) else PREDICTED
        if self._resting:
            if lost:
                return Action(parameters.window("u_ini")[-1].copy(), lost)
            self._rest(sample)
        if self._double_shift is not None:
            state = self._last.complete(measured) if lost else self._last.take(measured)
            self._shift_lifted_data(self._double_shift, state)
        parameters.fill("r", sample.reference)
        u, forecast, fault = self._solve()
        if lost:
            y = stand_in(y, forecast)
            measured = self._last.complete(measured, y)
        parameters.append("u_ini", u)
        parameters.append("y_ini", y)
        if self._double_shift is None:
            z = self._lift(self._states.append(self._last.take(measured)))
            parameters.append("z_ini", z)
            if self._learner:
                self._learn(self._learner, z, u, y, bool(lost))
        fault = fault or lost
        return Action(u, fault) if fault else u

    def _solve(self) -> tuple[FloatArray, FloatArray, str]:
        """Return the inputs to apply now, the outputs predicted of now, and what is not as it should be."""
        parameters, m = self._parameters, len(self._bounds.u_min)
        answer, fault = self._qp.solve(parameters.array)
        if fault == NOT_FINITE:
            return parameters.window("u_ini")[-1].copy(), parameters.window("y_ini")[-1].copy(), HELD
        u, forecast = answer[:m], answer[m:]
        if self._learner:
            self._learner.add_dither(u)
            np.clip(u, self._bounds.u_min, self._bounds.u_max, out=u)
        return u, forecast, fault

    def _learn(self, learner: Learner, z: FloatArray, u: FloatArray, y: FloatArray, lost: bool) -> None:
        """Learn a sample, unless what it holds stands in for a measurement, also as the past of its state."""
        self._unlearned = self._memory + 1 if lost else max(self._unlearned - 1, 0)
        learner.learn(z=z, u=u, y=np.full(len(y), np.nan) if self._unlearned else y)

    def recording_length(self, inputs: int, outputs: int, measurements: int) -> int:
        """Return the fewest samples that can excite the inputs up to the order needed."""
        order = measurements + self.dictionary.functions(measurements)
        return memory_of(self.dictionary) + least_samples(self.initial_length + self.horizon + order, inputs)

    def diagnostics(self) -> Mapping[str, float]:
        """Return order of excitation, rank and smallest singular value of the recording."""
        online = self._learner.data.figures() if self._learner else {}
        return {**self._diagnostics.as_dict(), **online}

    def _faults_between_settings(self) -> list[str]:
        faults = []
        if not isinstance(self.dictionary, Dictionary):
            faults.append(
                f"WKPC: dictionary = {self.dictionary!r} lacks draw(states, rng) or functions(size); "
                "an example is ThinPlate()"
            )
        elif (self.redraw_centre or self.squared_distance) and not isinstance(self.dictionary, ThinPlate):
            faults.append(
                "WKPC: redraw_centre and squared_distance change ThinPlate; the dictionary is another"
            )
        elif self.double_shift and memory_of(self.dictionary):
            faults.append("WKPC: double_shift lifts single samples; the dictionary looks back")
        if self.horizon == 1:
            faults.append(
                "WKPC: horizon = 1 predicts the present output alone, which no input changes any more: "
                "at least 2"
            )
        if self.online_data != "frozen" and (self.double_shift or self.redraw_centre):
            faults.append("WKPC: double_shift and redraw_centre leave no data that online_data could update")
        return faults + self._online_faults("WKPC")

    def _dictionary(self) -> Dictionary:
        if isinstance(self.dictionary, ThinPlate) and (self.redraw_centre or self.squared_distance):
            return PublishedThinPlate(
                printed=self.dictionary,
                redraw_centre=self.redraw_centre,
                squared_distance=self.squared_distance,
            )
        return self.dictionary

    def _lift(self, states: FloatArray) -> FloatArray:
        """Return z = (x, psi(x)) for states of shape (..., q), with their past where psi looks back."""
        newest = states[..., : self._states.size]
        return np.concatenate([newest, self._observables(states)], axis=-1)

    @property
    def _layout(self) -> WindowLayout:
        """Return how windows are stacked: lifted past, and past and future of inputs and outputs."""
        past, horizon = self.initial_length, self.horizon
        pasts = [Block(name, 0, past) for name in ("z", "u", "y")]
        return WindowLayout([*pasts, Block("u", past, horizon), Block("y", past, horizon)])

    def _stack(self, recording: Recording, lifted: FloatArray) -> FloatArray:
        """Return M."""
        u, y = recording.u, recording.y
        depth, order = self.initial_length + self.horizon, lifted.shape[1]
        require_length(len(u), depth + order, u.shape[1], "WKPC")
        if self.zero_padding:
            u, y = padded_with_zeros(u, self.initial_length), padded_with_zeros(y, self.initial_length)
        stacked = self._layout.stack({"z": lifted, "u": u, "y": y})
        self._diagnostics = diagnose(stacked, u, depth + order)
        require_excitation(self._diagnostics, f"depth {depth} + lifted order {order}", "WKPC")
        return stacked

    def _write_down(self, loop: Loop) -> Problem:
        """Write down (10) and (11)."""
        m, p, horizon = len(loop.inputs), len(loop.outputs), self.horizon
        past = {name: size for name, size in self._parameters.sizes.items() if name.endswith("_ini")}
        problem = Problem(
            rows={**past, "u": horizon * m, "y": horizon * p},
            free={"u_s": m},
            parameters=self._parameters.sizes,
        )
        every_u, every_y, held_u = np.eye(horizon * m), np.eye(horizon * p), np.tile(np.eye(m), (horizon, 1))
        q, r = weight_matrices(output_weight=(self.output_weight, p), input_weight=(self.input_weight, m))
        problem.penalise(q, {"y": every_y}, {"r": every_y})  # |y_k - r_t+k|_Q^2
        problem.penalise(r, {"u": every_u, "u_s": -held_u}, {})  # |u_k - u_s|_R^2
        problem.regularise(self.lambda_g)

        for name, size in past.items():
            problem.equate({name: np.eye(size)}, {name: np.eye(size)})  # (10)

        setpoint = setpoint_bounds(loop.bounds, self.setpoint_margin)
        problem.bound("u", loop.bounds.u_min, loop.bounds.u_max)
        problem.bound("y", loop.bounds.y_min, loop.bounds.y_max)
        problem.bound("u_s", setpoint.u_min, setpoint.u_max)
        return problem

    def _begin(self, loop: Loop, recording: Recording, lifted: FloatArray) -> None:
        """Fill the past: with the recording's tail, or with rest as far as it is known yet."""
        self._resting = not loop.continues_recording
        past = slice(-self.initial_length, None)
        self._parameters.fill("z_ini", lifted[past])
        self._parameters.fill("u_ini", resting_input(loop) if self._resting else recording.u[past])
        self._parameters.fill("y_ini", recording.y[past])
        self._double_shift: DoubleShift | None = None
        if self.double_shift:
            self._double_shift = DoubleShift(self._lift, lifted, self.initial_length, self.horizon)

    def _rest(self, sample: Sample) -> None:
        """Start as if the plant had always been where it is; the double shift starts from the recording."""
        self._resting = False
        self._parameters.fill("y_ini", sample.y)
        if self._double_shift is None:
            self._parameters.fill("z_ini", self._lift(self._states.fill(sample.measured)))

    def _shift_lifted_data(self, double_shift: DoubleShift, state: FloatArray) -> None:
        hankel = double_shift.move(state)
        self._parameters.fill("z_ini", double_shift.past)
        if hankel is not None and isinstance(self._qp, ParametricQP):
            self._data[: len(hankel)] = hankel
            self._qp.replace(self._problem.condense(self._data))
