"""Linear model predictive control without offset: a Kalman filter and the tracking problem of its model.

Cost, horizon and limits are those of the data-driven methods, so that what differs is the model alone: with
the true model of a linear plant it does what DeePC (8) does with its noise-free recording. A constant
disturbance, estimated beside the states, removes the offset (G. Pannocchia, J. B. Rawlings, AIChE J. 49(2),
2003, doi:10.1002/aic.690490213).

A model's trajectories over the horizon are all ``h = (x, u, y) = M (x, u)``: what the Hankel matrices are to
a recording, the matrix M is to a model. Costs, limits, condensing and the online solution are shared.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ddpc_controllers.checks import weight_matrices
from ddpc_controllers.data.windows import ParameterVector, resting_input
from ddpc_controllers.models.kalman import DISTURBANCES, Disturbance, ModelBased
from ddpc_controllers.optimisation.backends import BACKENDS, BackendName, make_backend
from ddpc_controllers.optimisation.limits import HELD, rate_limits
from ddpc_controllers.optimisation.problem import (
    Problem,
    bound_signals,
    end_at_setpoints,
    excess_variables,
    penalise_tracking,
    prefer_rest,
)
from ddpc_controllers.optimisation.qp import NOT_FINITE, Move, ParametricQP
from ddpc_cosim import Bounds, FloatArray, Loop, Sample, Weight, setting

Setpoint = Literal["input", "input-output", "none"]
SETPOINTS = ("input", "input-output", "none")


@dataclass(kw_only=True)
class TrackingSettings:
    """What a predictive controller minimises, in the terms of (8) and (11)."""

    horizon: int = setting(5, low=1, doc="prediction horizon N, samples")
    setpoint: Setpoint = setting(
        "input", choices=SETPOINTS, doc="artificial setpoints: u_s (11), u_s and y_s (8), or none"
    )
    output_weight: Weight = setting(1.0, low=0.0, doc="Q: predicted outputs off the reference, or off y_s")
    input_weight: Weight = setting(0.1, low=0.0, doc="R: inputs off u_s, or off their values at rest")
    setpoint_weight: Weight = setting(1.0, low=0.0, doc="S: y_s off the reference")
    change_weight: Weight = setting(0.0, low=0.0, doc="weight of the changes of the inputs")
    setpoint_margin: float = setting(
        0.99, above=0.0, high=1.0, doc="share of the limits open to the setpoints"
    )
    terminal_length: int = setting(0, low=0, doc="samples at the horizon's end that equal the setpoints")
    soft_output_bounds: float = setting(
        0.0, low=0.0, doc="weight of |excess|^2 beyond the output bounds; 0: they are hard"
    )
    rate_bounds: float | Sequence[float] = setting(
        default_factory=tuple, doc="largest change of each input per sample, in its unit; empty: none"
    )
    backend: BackendName = setting("piqp", choices=BACKENDS, doc="QP solver for active sets not seen before")

    def tracking_faults(self) -> list[str]:
        """Return how the settings contradict each other."""
        who, faults = type(self).__name__, []
        if self.terminal_length > self.horizon:
            faults.append(
                f"{who}: horizon = {self.horizon} is shorter than terminal_length = {self.terminal_length}"
            )
        if self.terminal_length and self.setpoint == "none":
            faults.append(
                f"{who}: terminal_length = {self.terminal_length} ties the horizon's end to the artificial "
                'setpoints: set it to 0, or setpoint to "input" or "input-output"'
            )
        if not np.all(np.asarray(self.rate_bounds, dtype=float) > 0.0):
            faults.append(f"{who}: rate_bounds = {self.rate_bounds!r} is not possible; allowed: above 0")
        return faults


def trajectories(a: FloatArray, b: FloatArray, c: FloatArray, horizon: int) -> FloatArray:
    """Return M of ``(x_0, u_-1, u_0 ... u_N-1, y_1 ... y_N) = M (x_0, u_-1, u_0 ... u_N-1)``.

    The first predicted output is that of the next sample: the output of this one is measured already.
    """
    n, m = b.shape
    size = n + m + horizon * m
    states = np.eye(n, size)
    outputs = []
    for k in range(horizon):
        states = a @ states
        states[:, n + (k + 1) * m : n + (k + 2) * m] += b
        outputs.append(c @ states)
    return np.vstack([np.eye(size), *outputs])


class Predictor:
    """A model's tracking problem, condensed: from a state and a reference to the next inputs.

    Parameters
    ----------
    a, b, c : array, shapes (n, n), (n, m), (p, n)
        The model, its inputs and outputs those of ``bounds``.
    settings : TrackingSettings
        What to minimise.
    bounds : Bounds
        Limits of inputs and outputs.
    input_scales : array, shape (m,)
        What one unit of each input of the model is, in the unit of its rate bound.
    rest : array, shape (m,)
        Inputs at rest: where they are weighed from without an artificial setpoint.

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
        settings: TrackingSettings,
        bounds: Bounds,
        input_scales: FloatArray,
        rest: FloatArray,
    ) -> None:
        n, m, p = len(a), b.shape[1], len(c)
        self._bounds = bounds
        self._rates = rate_limits(settings.rate_bounds, m) / input_scales
        self._parameters = ParameterVector({"x": (1, n), "u_last": (1, m), "r": (settings.horizon, p)})
        problem = _write_down(settings, bounds, self._rates, rest, self._parameters.sizes)
        condensed = problem.prepare("u", m).condense(trajectories(a, b, c, settings.horizon))
        self._qp = ParametricQP(condensed, bounds.u_min, bounds.u_max, make_backend(settings.backend))

    def solve(self, state: FloatArray, last_input: FloatArray, reference: FloatArray) -> Move:
        """Return the first optimal inputs.

        Parameters
        ----------
        state : array, shape (n,)
            State at this sample.
        last_input : array, shape (m,)
            Inputs applied at the last sample.
        reference : array, shape (N, p)
            References of the next samples, time along axis 0.
        """
        self._parameters.fill("x", state)
        self._parameters.fill("u_last", last_input)
        self._parameters.fill("r", reference)
        u, fault = self._qp.solve(self._parameters.array)
        if fault == NOT_FINITE:
            return Move(last_input.copy(), HELD)
        np.clip(u, last_input - self._rates, last_input + self._rates, out=u)
        np.clip(u, self._bounds.u_min, self._bounds.u_max, out=u)
        return Move(u, fault)


def _write_down(
    settings: TrackingSettings, bounds: Bounds, rates: FloatArray, rest: FloatArray, sizes: Mapping[str, int]
) -> Problem:
    n, m, horizon = sizes["x"], sizes["u_last"], settings.horizon
    p, soft = sizes["r"] // horizon, settings.soft_output_bounds
    setpoints = dict(
        {"none": {}, "input": {"u_s": m}, "input-output": {"u_s": m, "y_s": p}}[settings.setpoint]
    )
    free = setpoints | (excess_variables(setpoints, horizon, p) if soft > 0.0 else {})
    rows = {"x": n, "u_last": m, "u": horizon * m, "y": horizon * p}
    problem = Problem(rows=rows, free=free, parameters=sizes)
    for known in ("x", "u_last"):
        problem.equate({known: np.eye(sizes[known])}, {known: np.eye(sizes[known])})
    *_, change = weight_matrices(  # all faults at once
        output_weight=(settings.output_weight, p),
        input_weight=(settings.input_weight, m),
        setpoint_weight=(settings.setpoint_weight, p),
        change_weight=(settings.change_weight, m),
    )
    penalise_tracking(problem, settings, rest, p)
    prefer_rest(problem, settings.input_weight, rest, p)
    if change.any():
        before = _inputs_before(horizon, m)
        problem.penalise(change, {"u": np.eye(horizon * m) - before["u"], "u_last": -before["u_last"]}, {})
    if settings.terminal_length:
        end_at_setpoints(problem, settings.terminal_length, {"u": m, "y": p})
    bound_signals(problem, bounds, settings.setpoint_margin, soft)
    if np.isfinite(rates).any():
        problem.bound("u", -rates, rates, _inputs_before(horizon, m), name="change of u")
    return problem


def _inputs_before(horizon: int, m: int) -> dict[str, FloatArray]:
    """Return the blocks of the inputs of the sample before each of the horizon."""
    return {"u": np.eye(horizon * m, k=-m), "u_last": np.eye(horizon * m, m)}


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
        1.0, above=0.0, doc="filter: standard deviation of the disturbance's change per sample"
    )

    def _start(self, loop: Loop) -> None:
        """Set up the filter, and condense the model's tracking problem."""
        self._observe(loop, self.disturbance, self.disturbance_noise)
        model = self._observer
        self._predictor = Predictor(
            model.a, model.b, model.c, self, loop.bounds, self._scales.u, resting_input(loop)
        )

    def _decide(self, sample: Sample) -> tuple[FloatArray, str]:
        """Return the first optimal inputs of the horizon."""
        return self._predictor.solve(self._observer.state, self._u, sample.reference)

    def diagnostics(self) -> Mapping[str, float]:
        """Return the order of the model with its disturbances, its slowest or most unstable pole, its fit."""
        a = self._observer.a[:-1, :-1]
        poles = {"model_order": float(len(a)), "spectral_radius": float(np.abs(np.linalg.eigvals(a)).max())}
        return poles | self._model.fit

    def _faults_between_settings(self) -> list[str]:
        return super()._faults_between_settings() + self.tracking_faults()
