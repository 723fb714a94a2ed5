"""The tracking problems (8) and (11), with or without each of their parts, for every predictive method."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ddpc_controllers.checks import weight_matrices
from ddpc_controllers.optimisation.backends import BACKENDS, BackendName
from ddpc_controllers.optimisation.problem import Problem
from ddpc_cosim import (
    Bounds,
    Factor,
    FloatArray,
    Integer,
    Weight,
    setting,
)

Setpoint = Literal["input", "input-output", "none"]
SETPOINTS = ("input", "input-output", "none")

_PREFERENCE = 1e-6
_TERMINAL, _OUTPUTS = 1e2, 1e4
"""Weights of what gives way where nothing else helps, in parts of the largest weight."""


@dataclass(kw_only=True)
class TrackingSettings:
    """What a predictive controller minimises, in the terms of (8) and (11)."""

    horizon: int = setting(5, low=1, doc="prediction horizon N, samples", search=Integer(3, 20))
    setpoint: Setpoint = setting(
        "input", choices=SETPOINTS, doc="artificial setpoints: u_s (11), u_s and y_s (8), or none"
    )
    output_weight: Weight = setting(1.0, low=0.0, doc="Q: predicted outputs off the reference, or off y_s")
    input_weight: Weight = setting(
        0.1, low=0.0, doc="R: inputs off u_s, or off their values at rest", search=Factor(1e-4, 1e2)
    )
    setpoint_weight: Weight = setting(1.0, low=0.0, doc="S: y_s off the reference")
    change_weight: Weight = setting(0.0, low=0.0, doc="weight of the changes of the inputs")
    setpoint_margin: float = setting(
        0.99, above=0.0, high=1.0, doc="share of the limits open to the setpoints"
    )
    terminal_length: int = setting(0, low=0, doc="samples at the horizon's end that equal the setpoints")
    soft_output_bounds: float = setting(
        0.0, low=0.0, doc="weight of |excess|^2 beyond the output bounds; 0: they are hard"
    )
    rate_bounds: Weight = setting(
        (), above=0.0, doc="largest change of each input per sample, in its unit; empty: none"
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
        return faults


def tracking_problem(
    settings: TrackingSettings,
    bounds: Bounds,
    rest: FloatArray,
    rates: FloatArray,
    past: Mapping[str, int],
    parameters: Mapping[str, int],
    *,
    known: Mapping[str, str],
    prefer_rest: bool = False,
    future_slack: float = 0.0,
) -> Problem:
    """Write down cost, terminal condition and bounds.

    With u_s and y_s the cost is that of (8), with u_s that of (11), with none that of the regulation form
    [8], the inputs weighed from rest.

    Parameters
    ----------
    settings : TrackingSettings
        Which parts the problem has, and their weights.
    bounds : Bounds
        Limits of inputs and outputs.
    rest : array, shape (m,)
        Inputs at rest.
    rates : array, shape (m,)
        Largest change of each input per sample, infinite where there is none.
    past : mapping of str to int
        Sizes of the data rows above those of u and y. The last input before the horizon ends ``u_ini``.
    parameters : mapping of str to int
        Sizes of the parameters, the reference ``r`` among them.
    known : mapping of str to str
        Which of the rows in ``past`` equal which parameter; the others are the caller's.
    prefer_rest : bool
        Where inputs outnumber outputs, choose among setpoints u_s alike in cost the one nearest to rest.
    future_slack : float
        Weight of ``|sigma|^2``, by which predicted outputs may miss those of the data rows; 0: they may not.

    Raises
    ------
    ConfigError
        Every weight that does not fit the number of signals.
    """
    m, p, n = len(bounds.u_min), len(bounds.y_min), settings.horizon
    q, r, s, change = weight_matrices(
        output_weight=(settings.output_weight, p),
        input_weight=(settings.input_weight, m),
        setpoint_weight=(settings.setpoint_weight, p),
        change_weight=(settings.change_weight, m),
    )
    names = {"none": (), "input": ("u_s",), "input-output": ("u_s", "y_s")}[settings.setpoint]
    free = {name: {"u_s": m, "y_s": p}[name] for name in names}
    if settings.soft_output_bounds > 0.0:
        free |= {"y_excess": n * p} | ({"y_s_excess": p} if "y_s" in free else {})
    future_y = "y_slackened" if future_slack else "y"
    if future_slack:
        free[future_y] = n * p
    problem = Problem({**past, "u": n * m, "y": n * p}, free, parameters)
    for row, parameter in known.items():
        problem.equate({row: np.eye(past[row])}, {parameter: np.eye(past[row])})

    every_u, every_y = np.eye(n * m), np.eye(n * p)
    held_u, held_y = np.tile(np.eye(m), (n, 1)), np.tile(np.eye(p), (n, 1))
    if future_slack:
        problem.penalise(future_slack * np.eye(p), {"y": every_y, future_y: -every_y}, {})
    if "y_s" in free:
        problem.penalise(q, {future_y: every_y, "y_s": -held_y}, {})  # |y_k - y_s|_Q^2
        problem.penalise(s, {"y_s": held_y}, {"r": every_y})  # |r_t+k - y_s|_S^2
    else:
        problem.penalise(q, {future_y: every_y}, {"r": every_y})  # |y_k - r_t+k|_Q^2
    if "u_s" in free:
        problem.penalise(r, {"u": every_u, "u_s": -held_u}, {})  # |u_k - u_s|_R^2
        if prefer_rest and m > p:
            problem.penalise(_PREFERENCE * r, {"u_s": np.eye(m)}, {"one": rest[:, np.newaxis]})
    else:
        problem.penalise(r, {"u": every_u}, {"one": held_u @ rest[:, np.newaxis]})  # |u_k|_R^2, off rest
    if change.any():
        before = _inputs_before(problem, m)
        problem.penalise(change, {"u": every_u - before["u"], "u_ini": -before["u_ini"]}, {})

    largest = max(float(np.abs(weight).max()) for weight in (q, r, s))
    for name, setpoint, held in (("u", "u_s", held_u), (future_y, "y_s", held_y)):
        if settings.terminal_length and setpoint in free:  # the horizon's end is at the setpoints
            last = slice(-settings.terminal_length * held.shape[1], None)
            problem.equate({name: np.eye(len(held))[last], setpoint: -held[last]}, {}, _TERMINAL * largest)
    _bound_signals(problem, settings, bounds, future_y, _OUTPUTS * largest)
    if np.isfinite(rates).any():
        problem.bound("u", -rates, rates, _inputs_before(problem, m), name="change of u")
    return problem


def _bound_signals(
    problem: Problem, settings: TrackingSettings, bounds: Bounds, future_y: str, relaxed: float
) -> None:
    """Bound inputs, outputs and artificial setpoints; soft output bounds give way at a quadratic cost.

    The setpoint's output bounds give way with them: the terminal condition would make them hard again.
    """
    margin = settings.setpoint_margin
    limits = {
        "u": (bounds.u_min, bounds.u_max),
        "y": (bounds.y_min, bounds.y_max),
        "u_s": _drawn_in(bounds.u_min, bounds.u_max, margin),
        "y_s": _drawn_in(bounds.y_min, bounds.y_max, margin),
    }
    for name, (lower, upper) in limits.items():
        excess: dict[str, FloatArray] = {}
        if f"{name}_excess" in problem.free:
            excess[f"{name}_excess"] = np.eye(problem.free[f"{name}_excess"])
            problem.penalise(settings.soft_output_bounds * np.eye(len(lower)), excess, {})
        if name in problem.rows or name in problem.free:
            gives_way = relaxed if name in ("y", "y_s") and not excess else 0.0
            problem.bound(future_y if name == "y" else name, lower, upper, excess, name, gives_way)


def _inputs_before(problem: Problem, m: int) -> dict[str, FloatArray]:
    """Return the blocks of the inputs of the sample before each of the horizon."""
    size = problem.rows["u"]
    return {"u": np.eye(size, k=-m), "u_ini": np.eye(size, problem.rows["u_ini"], problem.rows["u_ini"] - m)}


def _drawn_in(low: FloatArray, high: FloatArray, margin: float) -> tuple[FloatArray, FloatArray]:
    """Draw two-sided limits together about their middle: artificial setpoints stay off the limits."""
    bounded = np.isfinite(low) & np.isfinite(high)
    middle = np.zeros_like(low)
    np.add(low / 2, high / 2, out=middle, where=bounded)
    shrink = np.where(bounded, margin, 1.0)
    return middle + shrink * (low - middle), middle + shrink * (high - middle)
