"""The tracking problem of DeePC and SPC, equation (8), with or without each of its parts."""

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from ddpc_controllers.problem import Problem
from ddpc_controllers.recorded import resting_input, setpoint_bounds
from ddpc_controllers.validation import weight_matrices
from ddpc_cosim import FloatArray, Loop, Weight

SUM_G = "sum_g"
"""The data row that holds the sum of the entries of g."""


class TrackingSettings(Protocol):
    """The settings that decide the problem."""

    initial_length: int
    horizon: int
    output_weight: Weight
    setpoint_weight: Weight
    input_weight: Weight
    artificial_setpoint: bool
    terminal_equality: bool
    setpoint_margin: float
    soft_output_bounds: float


def write_tracking_problem(
    settings: TrackingSettings,
    loop: Loop,
    past: Mapping[str, int],
    parameters: Mapping[str, int],
    rates: FloatArray | None,
) -> Problem:
    """Write down cost, terminal condition and bounds.

    Parameters
    ----------
    settings : TrackingSettings
        Which parts the problem has, and their weights.
    loop : Loop
        Its signals and their limits.
    past : mapping of str to int
        Sizes of the data rows above those of u and y: the past, and the sum of g where it has a row. The
        past inputs and the sum are required here; the past outputs are the caller's.
    parameters : mapping of str to int
        Sizes of the parameters.
    rates : array, shape (m,), or None
        Largest change of each input per sample.

    Raises
    ------
    ConfigError
        Every weight that does not fit the number of signals.
    """
    m, p, horizon = len(loop.inputs), len(loop.outputs), settings.horizon
    free = {"u_s": m, "y_s": p} if settings.artificial_setpoint else {}
    soft = settings.soft_output_bounds > 0.0
    if soft:
        free |= {"y_excess": horizon * p} | ({"y_s_excess": p} if settings.artificial_setpoint else {})
    problem = Problem(rows={**past, "u": horizon * m, "y": horizon * p}, free=free, parameters=parameters)

    problem.equate({"u_ini": np.eye(past["u_ini"])}, {"u_ini": np.eye(past["u_ini"])})
    if SUM_G in past:
        problem.equate({SUM_G: np.eye(1)}, {"one": np.eye(1)})
    if settings.artificial_setpoint:
        _track_artificial_setpoint(problem, settings, loop)
    else:
        _track_reference(problem, settings, loop)
    _bound_signals(problem, settings, loop)
    if rates is not None:
        _bound_rates(problem, horizon, rates)
    return problem


def _track_artificial_setpoint(problem: Problem, settings: TrackingSettings, loop: Loop) -> None:
    """Add the cost of (8) and its terminal condition."""
    m, p, past, horizon = len(loop.inputs), len(loop.outputs), settings.initial_length, settings.horizon
    every_u, every_y = np.eye(horizon * m), np.eye(horizon * p)
    held_u, held_y = np.tile(np.eye(m), (horizon, 1)), np.tile(np.eye(p), (horizon, 1))
    q, s, r = weight_matrices(
        output_weight=(settings.output_weight, p),
        setpoint_weight=(settings.setpoint_weight, p),
        input_weight=(settings.input_weight, m),
    )
    problem.penalise(q, {"y": every_y, "y_s": -held_y}, {})  # |y_k - y_s|_Q^2
    problem.penalise(s, {"y_s": held_y}, {"r": every_y})  # |r_t+k - y_s|_S^2
    problem.penalise(r, {"u": every_u, "u_s": -held_u}, {})  # |u_k - u_s|_R^2
    if settings.terminal_equality:
        problem.equate({"u": every_u[-past * m :], "u_s": -held_u[-past * m :]}, {})
        problem.equate({"y": every_y[-past * p :], "y_s": -held_y[-past * p :]}, {})


def _track_reference(problem: Problem, settings: TrackingSettings, loop: Loop) -> None:
    """Add the cost of the regulation form [8]; inputs are weighed from where they rest."""
    m, p, horizon = len(loop.inputs), len(loop.outputs), settings.horizon
    q, r = weight_matrices(output_weight=(settings.output_weight, p), input_weight=(settings.input_weight, m))
    rest = np.tile(resting_input(loop), horizon)[:, np.newaxis]
    problem.penalise(q, {"y": np.eye(horizon * p)}, {"r": np.eye(horizon * p)})  # |y_k - r_t+k|_Q^2
    problem.penalise(r, {"u": np.eye(horizon * m)}, {"one": rest})  # |u_k|_R^2, off rest


def _bound_signals(problem: Problem, settings: TrackingSettings, loop: Loop) -> None:
    """Bound inputs, outputs and the artificial setpoint; soft output bounds give way at a quadratic cost.

    The setpoint's output bounds give way with them: the terminal condition would make them hard again.
    """
    bounds, horizon = loop.bounds, settings.horizon
    soft = settings.soft_output_bounds * np.eye(len(loop.outputs))
    y_less = y_s_less = None
    if settings.soft_output_bounds > 0.0:
        y_less = {"y_excess": np.eye(horizon * len(loop.outputs))}
        problem.penalise(soft, y_less, {})
    problem.bound("u", bounds.u_min, bounds.u_max)
    problem.bound("y", bounds.y_min, bounds.y_max, y_less)
    if not settings.artificial_setpoint:
        return
    if settings.soft_output_bounds > 0.0:
        y_s_less = {"y_s_excess": np.eye(len(loop.outputs))}
        problem.penalise(soft, y_s_less, {})
    setpoint = setpoint_bounds(bounds, settings.setpoint_margin)
    problem.bound("u_s", setpoint.u_min, setpoint.u_max)
    problem.bound("y_s", setpoint.y_min, setpoint.y_max, y_s_less)


def _bound_rates(problem: Problem, horizon: int, rates: FloatArray) -> None:
    """Bound the change of every input from the sample before; the first from the newest past input."""
    m = len(rates)
    before = np.eye(horizon * m, k=-m)
    newest = np.zeros((horizon * m, problem.rows["u_ini"]))
    newest[:m, -m:] = np.eye(m)
    problem.bound("u", -rates, rates, {"u": before, "u_ini": newest}, name="change of u")
