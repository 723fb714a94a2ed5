"""Data-enabled predictive control with an artificial setpoint, equation (8)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from ddpc_controllers.behavioral import (
    diagnose,
    hankel_matrix,
    least_samples,
    require_excitation,
    require_length,
)
from ddpc_controllers.problem import Problem
from ddpc_controllers.qp import ParametricQP
from ddpc_controllers.recorded import (
    ParameterVector,
    matching_recording,
    padded_with_zeros,
    resting_input,
    setpoint_bounds,
)
from ddpc_controllers.validation import check_settings_and, weight_matrices
from ddpc_cosim import Action, Controller, FloatArray, Loop, Recording, Sample, Weight, setting

AffineSum = Literal["none", "all", "first-horizon"]


@dataclass(kw_only=True)
class DeePC(Controller):
    """Data-enabled predictive control, equation (8).

    The defaults are those of Table 1. ``affine_sum = "first-horizon"`` and ``zero_padding`` do what the
    paper's published program does and equation (8) does not.
    """

    uses_recording: ClassVar[bool] = True

    initial_length: int = setting(3, low=1, doc="samples of the past that fix the initial condition, Tini")
    horizon: int = setting(5, low=1, doc="prediction horizon N, samples; at least initial_length")
    output_weight: Weight = setting(100.0, low=0.0, doc="Q: predicted outputs off the artificial setpoint")
    setpoint_weight: Weight = setting(300.0, low=0.0, doc="S: artificial setpoint off the reference")
    input_weight: Weight = setting(10.0, low=0.0, doc="R: inputs off the artificial setpoint")
    lambda_g: float = setting(50.0, above=0.0, doc="weight of |g|^2")
    lambda_sigma: float = setting(1e7, above=0.0, doc="weight of |sigma_y|^2, the misfit of the past outputs")
    setpoint_margin: float = setting(
        0.99, above=0.0, high=1.0, doc="share of the limits open to the setpoint"
    )
    affine_sum: AffineSum = setting(
        "none", choices=("none", "all", "first-horizon"), doc="which entries of g sum to 1"
    )
    zero_padding: bool = setting(False, doc="append initial_length samples of zero to the recording")
    assumed_order: int = setting(0, low=0, doc="bound on the plant's order; 0: initial_length x outputs")

    def __post_init__(self) -> None:
        check_settings_and(self, self._faults_between_settings)

    def start(self, loop: Loop) -> None:
        """Condense the problem on the loop's recording.

        Raises
        ------
        DataError
            There is no recording, or it is too short or not persistently exciting enough.
        ConfigError
            A weight does not fit the number of signals.
        """
        recording = matching_recording(loop, "DeePC")
        self._resting: bool = not loop.continues_recording
        m, p = len(loop.inputs), len(loop.outputs)
        self._parameters = ParameterVector(
            {"u_ini": (self.initial_length, m), "y_ini": (self.initial_length, p), "r": (self.horizon, p)}
        )
        data = self._data(recording)
        problem = self._problem(loop).prepare("u", m)
        self._qp = ParametricQP(problem.condense(data), loop.bounds.u_min, loop.bounds.u_max)
        self._begin(loop, recording)

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the first optimal input of the horizon."""
        parameters = self._parameters
        if self._resting:
            parameters.fill("y_ini", sample.y)
            self._resting = False
        parameters.fill("r", sample.reference)
        u, fault = self._qp.solve(parameters.array)
        parameters.append("u_ini", u)
        parameters.append("y_ini", sample.y)
        return Action(u, fault) if fault else u

    def recording_length(self, inputs: int, outputs: int, measurements: int) -> int:
        """Return the fewest samples that can excite the inputs up to the order needed."""
        return least_samples(self._order_needed(outputs), inputs)

    def diagnostics(self) -> Mapping[str, float]:
        """Return order of excitation, rank and smallest singular value of the recording."""
        return self._diagnostics.as_dict()

    def _faults_between_settings(self) -> list[str]:
        if self.horizon >= self.initial_length:
            return []
        return [
            f"DeePC: horizon = {self.horizon} is shorter than initial_length = {self.initial_length}; "
            "the terminal condition holds over the last initial_length samples of the horizon"
        ]

    def _order_needed(self, outputs: int) -> int:
        """Return the order of excitation of Assumption 2: depth of the data and order of the plant."""
        return self.initial_length + self.horizon + (self.assumed_order or self.initial_length * outputs)

    def _data(self, recording: Recording) -> FloatArray:
        """Return M: the past and future Hankel blocks, and the row that sums g where one is asked for."""
        u, y = recording.u, recording.y
        if self.zero_padding:
            u, y = padded_with_zeros(u, self.initial_length), padded_with_zeros(y, self.initial_length)
        m, p, past, depth = u.shape[1], y.shape[1], self.initial_length, self.initial_length + self.horizon
        order = self._order_needed(p)
        require_length(len(u), order, m, "DeePC")
        u_rows, y_rows = hankel_matrix(u, depth), hankel_matrix(y, depth)
        stacked = np.vstack([u_rows[: past * m], y_rows[: past * p], u_rows[past * m :], y_rows[past * p :]])
        self._diagnostics = diagnose(stacked, u, order)
        require_excitation(self._diagnostics, f"depth {depth} + assumed order {order - depth}", "DeePC")
        if self.affine_sum == "none":
            return stacked
        summed = stacked.shape[1] if self.affine_sum == "all" else self.horizon
        return np.vstack([stacked, np.arange(stacked.shape[1]) < summed])

    def _problem(self, loop: Loop) -> Problem:
        """Write down (8), the slack sigma_y = Y_p g - y_ini eliminated."""
        m, p, past, horizon = len(loop.inputs), len(loop.outputs), self.initial_length, self.horizon
        rows = {"u_ini": past * m, "y_ini": past * p, "u": horizon * m, "y": horizon * p}
        if self.affine_sum != "none":
            rows["sum_g"] = 1
        problem = Problem(rows=rows, free={"u_s": m, "y_s": p}, parameters=self._parameters.sizes)

        every_u, every_y = np.eye(horizon * m), np.eye(horizon * p)
        held_u, held_y = np.tile(np.eye(m), (horizon, 1)), np.tile(np.eye(p), (horizon, 1))
        q, s, r = weight_matrices(
            output_weight=(self.output_weight, p),
            setpoint_weight=(self.setpoint_weight, p),
            input_weight=(self.input_weight, m),
        )
        past_y = np.eye(past * p)
        problem.penalise(q, {"y": every_y, "y_s": -held_y}, {})  # |y_k - y_s|_Q^2
        problem.penalise(s, {"y_s": held_y}, {"r": every_y})  # |r_t+k - y_s|_S^2
        problem.penalise(r, {"u": every_u, "u_s": -held_u}, {})  # |u_k - u_s|_R^2
        problem.penalise(self.lambda_sigma * np.eye(p), {"y_ini": past_y}, {"y_ini": past_y})
        problem.regularise(self.lambda_g)

        problem.equate({"u_ini": np.eye(past * m)}, {"u_ini": np.eye(past * m)})
        if self.affine_sum != "none":
            problem.equate({"sum_g": np.eye(1)}, {"one": np.eye(1)})
        problem.equate({"u": every_u[-past * m :], "u_s": -held_u[-past * m :]}, {})
        problem.equate({"y": every_y[-past * p :], "y_s": -held_y[-past * p :]}, {})

        setpoint = setpoint_bounds(loop.bounds, self.setpoint_margin)
        problem.bound("u", loop.bounds.u_min, loop.bounds.u_max)
        problem.bound("y", loop.bounds.y_min, loop.bounds.y_max)
        problem.bound("u_s", setpoint.u_min, setpoint.u_max)
        problem.bound("y_s", setpoint.y_min, setpoint.y_max)
        return problem

    def _begin(self, loop: Loop, recording: Recording) -> None:
        """Fill the past: with the recording's tail, or with rest as far as it is known yet."""
        past = slice(-self.initial_length, None)
        self._parameters.fill("u_ini", resting_input(loop) if self._resting else recording.u[past])
        self._parameters.fill("y_ini", recording.y[past])
