"""The tracking problems (8) and (11), with or without each of their parts, for every predictive method."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ddpc_controllers.checks import weight_matrices
from ddpc_controllers.optimisation.backends import BACKENDS, BackendName
from ddpc_controllers.optimisation.outlook import BAND, PRICE, Foresight, Outlook
from ddpc_controllers.optimisation.problem import BAND_OF_Y, Blocks, Problem, sample_by_sample
from ddpc_controllers.optimisation.tightening import Margins, OnlinePromise
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
_DRAWN_TO_REST = 1e-3
"""Weight of u_s off rest where little else determines it: less loses digits where bounds give way."""
_ADVICE = (
    "; outputs within a band and what is paid have no curvature: make input_weight positive, or "
    "change_weight where there is one"
)
_BESIDE = ("y_above", "y_below")
LIMITED = "y_limited"
"""Predicted outputs that are limited, where those of the data rows are not what is promised of."""
_TERMINAL, _OUTPUTS = 1e2, 1e4
"""Weights of what gives way where nothing else helps, in parts of the largest weight."""


@dataclass(kw_only=True)
class TrackingSettings(OnlinePromise, Foresight):
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
    online_margins: bool = setting(
        False,
        doc="with satisfaction, draw limits in by the errors of the last predictions in the loop too, where "
        "these are larger; otherwise held-out samples alone tell, and the disturbance that is estimated",
    )

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
    known: Mapping[str, str | Blocks],
    prefer_rest: bool = False,
    future_slack: float = 0.0,
    outlook: Outlook | None = None,
    margins: Margins | None = None,
    predictor: FloatArray | None = None,
) -> Problem:
    """Write down cost, terminal condition and bounds.

    With u_s and y_s the cost is that of (8), with u_s that of (11), with none that of the regulation form
    [8], the inputs weighed from rest.

    An output b in a band [l, h] is not drawn to a reference, nor to y_s, but costs what it is outside:

        sum_k q_b (max(0, y_b,k - h_k)^2 + max(0, l_k - y_b,k)^2),

    q_b being its element of Q's diagonal; where the band is a line that is q_b (y_b,k - r_k)^2. Its y_s is
    where it is at the end of the horizon, so that a terminal condition lets the plant rest anywhere in the
    band. What is paid adds

        price_weight sum_k sum_i price_i,k rate_i signal_i,k sampling_time.

    Neither has curvature within the band. The squares |u - u_s|_R^2 or |u - u_rest|_R^2, the changes of the
    inputs, the outputs that follow a reference and a regulariser of g keep the optimum determined. With
    artificial setpoints, where fewer outputs follow a reference than there are inputs, 1e-3
    |u_s - u_rest|_R^2 is added for it.

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
    known : mapping of str to str or Blocks
        Which of the rows in ``past`` equal which parameter, or blocks of parameters; the others are the
        caller's.
    prefer_rest : bool
        Where inputs outnumber outputs, choose among setpoints u_s alike in cost the one nearest to rest.
    future_slack : float
        Weight of ``|sigma|^2``, by which predicted outputs may miss those of the data rows; 0: they may not.
    outlook : Outlook, optional
        Bands, moving limits and prices, whose windows are among the parameters. Disturbances are rows of
        ``past`` and equal a parameter, which ``known`` says. Default: there are none.
    margins : Margins, optional
        By what the limits of predicted outputs are drawn in, and those of the artificial setpoint by that of
        the horizon's end; its windows are among the parameters. Default: not at all.
    predictor : array, shape (N p, rows above those of y), optional
        What the limited outputs are predicted by of the rows above, where a regulariser leaves those of the
        data rows open: drawn in further, their limits would move these and not the inputs. Default: it is
        those of the data rows that are limited.

    Raises
    ------
    ConfigError
        Every weight that does not fit the number of signals.
    """
    m, p, n = len(bounds.u_min), len(bounds.y_min), settings.horizon
    followed = outlook.followed if outlook else np.arange(p)
    weighed = outlook.controlled if outlook else p
    q, r, s, change = weight_matrices(
        output_weight=(settings.output_weight, weighed),
        input_weight=(settings.input_weight, m),
        setpoint_weight=(settings.setpoint_weight, weighed),
        change_weight=(settings.change_weight, m),
    )
    of_followed, in_bands = (followed[:, np.newaxis], followed), _in_bands(outlook, q)
    names = {"none": (), "input": ("u_s",), "input-output": ("u_s", "y_s")}[settings.setpoint]
    free = {name: {"u_s": m, "y_s": p}[name] for name in names}
    if settings.soft_output_bounds > 0.0:
        free |= {"y_excess": n * p} | ({"y_s_excess": p} if "y_s" in free else {})
    free |= dict.fromkeys(_BESIDE if in_bands.size else (), n * in_bands.size)
    future_y = "y_slackened" if future_slack else "y"
    if future_slack:
        free[future_y] = n * p
    if predictor is not None:
        free[LIMITED] = n * p
    problem = Problem({**past, "u": n * m, "y": n * p}, free, parameters)
    if predictor is not None:
        ends = np.cumsum([*past.values()])
        above = zip([*past, "u"], np.split(-predictor, ends, axis=1), strict=True)
        problem.equate({LIMITED: np.eye(n * p), **dict(above)}, {})
    for row, value in known.items():
        rows = np.eye(past[row])
        problem.equate({row: rows}, {value: rows} if isinstance(value, str) else value)

    every_u, every_y = np.eye(n * m), np.eye(n * p)
    held_u, held_y = np.concatenate([np.eye(m)] * n), np.concatenate([np.eye(p)] * n)
    if future_slack:
        problem.penalise(future_slack * np.eye(p), {"y": every_y, future_y: -every_y}, {})
    if len(followed):
        following = sample_by_sample(np.eye(n), np.eye(p)[followed])
        if "y_s" in free:
            at_y_s = following @ held_y
            problem.penalise(q[of_followed], {future_y: following, "y_s": -at_y_s}, {})  # |y_k - y_s|_Q^2
            problem.penalise(s[of_followed], {"y_s": at_y_s}, {"r": following})  # |r_t+k - y_s|_S^2
        else:
            problem.penalise(q[of_followed], {future_y: following}, {"r": following})  # |y_k - r_t+k|_Q^2
    if "y_s" in free and len(followed) < p:
        others = np.delete(np.eye(p), followed, axis=0)
        problem.equate(
            {"y_s": others, future_y: -sample_by_sample(np.eye(n)[-1:], others)}, {}
        )  # y_s = y_N-1
    if "u_s" in free:
        problem.penalise(r, {"u": every_u, "u_s": -held_u}, {})  # |u_k - u_s|_R^2
        if m > len(followed) and (prefer_rest or len(followed) < p):
            drawn = _PREFERENCE if len(followed) == p else _DRAWN_TO_REST
            problem.penalise(drawn * r, {"u_s": np.eye(m)}, {"one": rest[:, np.newaxis]})
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
    limited = future_y if predictor is None else LIMITED
    _bound_signals(problem, settings, bounds, limited, _OUTPUTS * largest, outlook, margins)
    if outlook:
        _hold_in_bands(problem, outlook, in_bands, np.diag(q), future_y)
        _pay(problem, outlook, {"u": m, "y": p}, future_y)
        if in_bands.size or outlook.paid:
            problem.advice = _ADVICE
    if np.isfinite(rates).any():
        problem.bound("u", -rates, rates, _inputs_before(problem, m), name="change of u")
    return problem


def _bound_signals(
    problem: Problem,
    settings: TrackingSettings,
    bounds: Bounds,
    limited: str,
    relaxed: float,
    outlook: Outlook | None,
    margins: Margins | None,
) -> None:
    """Bound inputs, outputs and artificial setpoints; soft output bounds give way at a quadratic cost.

    The setpoint's output bounds give way with them: the terminal condition would make them hard again.
    """
    margin = settings.setpoint_margin
    limits = {"u": (bounds.u_min, bounds.u_max), "y": (bounds.y_min, bounds.y_max)}
    setpoints = [name for name in limits if f"{name}_s" in problem.free]
    limits |= {f"{name}_s": _drawn_in(*limits[name], margin) for name in setpoints}
    for name, (lower, upper) in limits.items():
        excess: dict[str, FloatArray] = {}
        if f"{name}_excess" in problem.free:
            excess[f"{name}_excess"] = np.eye(problem.free[f"{name}_excess"])
            problem.penalise(settings.soft_output_bounds * np.eye(len(lower)), excess, {})
        gives_way = relaxed if name in ("y", "y_s") and not excess else 0.0
        variable = limited if name == "y" else name
        moving = outlook.moving(name, bounds) if outlook else None
        if moving and name.endswith("_s"):
            moving = _mixed(moving, lower, upper, margin)
        if margins is not None and name[0] == "y":
            samples = slice(None) if name == "y" else slice(-1, None)
            lower, upper, moving = margins.draw_in(lower, upper, samples, moving)
        problem.bound(variable, lower, upper, excess, name, gives_way, moving)


def _in_bands(outlook: Outlook | None, weight: FloatArray) -> NDArray[np.intp]:
    """Return which of the outputs in a band it costs to be outside of it."""
    bands = outlook.bands if outlook else np.empty(0, dtype=np.intp)
    return bands[np.diag(weight)[bands] > 0.0]


def _hold_in_bands(
    problem: Problem, outlook: Outlook, in_bands: NDArray[np.intp], weights: FloatArray, future_y: str
) -> None:
    """Weigh what outputs are outside their bands, above and below apart: a band may be a line."""
    if not in_bands.size:
        return
    n, p = outlook.horizon, problem.rows["y"] // outlook.horizon
    every, limit, none = np.eye(n * in_bands.size), np.zeros(in_bands.size), np.full(in_bands.size, np.inf)
    kept = sample_by_sample(np.eye(n), np.eye(p)[in_bands])
    edges = sample_by_sample(np.eye(n), np.eye(len(outlook.bands))[np.isin(outlook.bands, in_bands)])
    below, above = ({BAND: edges @ outlook.edges(side)} for side in (0, 1))
    for excess in _BESIDE:
        problem.penalise(np.diag(weights[in_bands]), {excess: every}, {})
    problem.bound(future_y, -none, limit, {"y_above": every}, BAND_OF_Y, moving=({}, above), rows=kept)
    problem.bound(future_y, limit, none, {"y_below": -every}, BAND_OF_Y, moving=(below, {}), rows=kept)


def _pay(problem: Problem, outlook: Outlook, widths: Mapping[str, int], future_y: str) -> None:
    """Add what inputs and predicted outputs cost."""
    for signal, width in widths.items():
        if any(paid.signal == signal for paid in outlook.paid):
            variable = future_y if signal == "y" else signal
            problem.charge(PRICE, variable, outlook.amounts(signal, width))


def _mixed(
    moving: tuple[Blocks, Blocks], lower: FloatArray, upper: FloatArray, margin: float
) -> tuple[Blocks, Blocks]:
    """Draw moving limits together about their middle as :func:`_drawn_in` does those that stand."""
    bounded = (np.isfinite(lower) & np.isfinite(upper))[:, np.newaxis]
    near, far = np.where(bounded, (1.0 + margin) / 2.0, 1.0), np.where(bounded, (1.0 - margin) / 2.0, 0.0)
    low, high = moving
    return (
        {name: near * block + far * high[name] for name, block in low.items()},
        {name: near * block + far * low[name] for name, block in high.items()},
    )


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
