"""Figures taken from one trace, in display units.

Figures of the response are taken over the *held* samples: those whose inputs acted on the plant (the last
sample of a completed run, at which the run ends, is left out). Keys read ``name.signal [unit]``.
"""

import math
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from ddpc_cosim.trace import Trace
from ddpc_cosim.variables import FloatArray, Variable


class MetricInfo(NamedTuple):
    """What a metric means, and which direction is better (empty where neither is)."""

    label: str
    description: str
    better: Literal["low", "high", ""] = "low"


METRICS: dict[str, MetricInfo] = {
    "sum_abs_error": MetricInfo("Absolute integral error", "sum of |reference - output| over the samples"),
    "iae": MetricInfo("IAE", "integral of |reference - output| over time"),
    "rmse": MetricInfo("RMSE", "root mean square of reference - output"),
    "min_abs_error": MetricInfo("Minimum absolute error", "smallest |reference - output|"),
    "max_abs_error": MetricInfo("Maximum absolute error", "largest |reference - output|"),
    "settled_error": MetricInfo(
        "Settled error",
        "largest mean error over the last fifth of a stretch of constant reference, in magnitude",
    ),
    "overshoot": MetricInfo(
        "Overshoot", "largest excursion beyond the new reference after a step, of the step"
    ),
    "rise_time": MetricInfo(
        "Rise time", "median time from 10 % to 90 % of a step; NaN if one is not reached"
    ),
    "settling_time": MetricInfo(
        "Settling time",
        "longest time after a step until the output stays within 5 % of it; NaN if it does not",
    ),
    "bound_violation_max": MetricInfo("Largest bound violation", "how far the output went beyond its limits"),
    "bound_violation_time": MetricInfo(
        "Time beyond bounds", "time of samples with the output beyond its limits"
    ),
    "max_abs_input": MetricInfo("Maximum absolute input", "largest |input|", ""),
    "max_abs_change": MetricInfo(
        "Largest input change", "largest |change of the input| from sample to sample"
    ),
    "rms_change": MetricInfo(
        "RMS input change", "root mean square change of the input from sample to sample"
    ),
    "total_variation": MetricInfo("Actuator travel", "sum of |change of the input| over the samples"),
    "time_at_bounds": MetricInfo("Time at input limits", "time of samples with the input at a limit", ""),
    "solve_time_mean": MetricInfo("Mean step time", "mean wall-clock time of a controller step"),
    "solve_time_median": MetricInfo("Median step time", "median wall-clock time of a controller step"),
    "solve_time_p95": MetricInfo(
        "95 % step time", "95th percentile of the wall-clock time of a controller step"
    ),
    "solve_time_p99": MetricInfo(
        "99 % step time", "99th percentile of the wall-clock time of a controller step"
    ),
    "solve_time_max": MetricInfo("Longest step time", "longest wall-clock time of a controller step"),
    "deadline_misses": MetricInfo("Deadline misses", "controller steps longer than the sampling time"),
    "failures": MetricInfo("Fallbacks", "samples at which the controller reported a fallback"),
    "samples": MetricInfo("Samples", "rows of the trace", ""),
}

_SETTLED_FRACTION = 0.2
_SETTLING_BAND = 0.05


def split_key(key: str) -> tuple[str, str, str]:
    """Split a metric's key into name, signal and unit; the signal is empty for figures of the whole run."""
    head, _, unit = key.partition(" [")
    name, _, signal = head.partition(".")
    return name, signal, unit.removesuffix("]")


def metrics(trace: Trace) -> dict[str, float]:
    """Return the figures of a trace by key; NaN where a figure does not exist."""
    with np.errstate(over="ignore", invalid="ignore"):  # a run that diverged has values of any size
        return _metrics(trace)


def _metrics(trace: Trace) -> dict[str, float]:
    table: dict[str, float] = {}
    rows = slice(0, trace.held)
    for i, output in enumerate(trace.outputs):
        limits = (trace.bounds.y_min[i], trace.bounds.y_max[i])
        table.update(_output_metrics(output, trace, trace.reference[rows, i], trace.y[rows, i], limits))
    for i, variable in enumerate(trace.inputs):
        limits = (trace.bounds.u_min[i], trace.bounds.u_max[i])
        table.update(_input_metrics(variable, trace.u[rows, i], limits, trace.sampling_time))
    table.update(_time_metrics(trace))
    return table


def _output_metrics(
    output: Variable, trace: Trace, reference: FloatArray, y: FloatArray, limits: tuple[float, float]
) -> dict[str, float]:
    shown, h = output.shown_in, trace.sampling_time
    scale = abs(shown.factor)
    error = (reference - y) * shown.factor
    magnitude = np.abs(error)
    steps = list(_steps(reference, y))
    beyond = np.maximum(np.maximum(y - limits[1], limits[0] - y), 0.0) * scale
    values = {
        "sum_abs_error": (_or_nan(lambda e: float(e.sum()), magnitude), shown.name),
        "iae": (_or_nan(lambda e: float(e.sum()) * h, magnitude), f"{shown.name}.s".lstrip(".")),
        "rmse": (_or_nan(lambda e: math.sqrt(float(np.mean(e**2))), error), shown.name),
        "min_abs_error": (_or_nan(lambda e: float(e.min()), magnitude), shown.name),
        "max_abs_error": (_or_nan(lambda e: float(e.max()), magnitude), shown.name),
        "settled_error": (_settled_error(reference, error), shown.name),
        "overshoot": (100 * max((step.overshoot() for step in steps), default=math.nan), "%"),
        "rise_time": (h * _median([step.rise_samples() for step in steps]), "s"),
        "settling_time": (
            h * max((step.settling_samples() for step in steps), default=math.nan, key=_nan_last),
            "s",
        ),
        "bound_violation_max": (_or_nan(lambda e: float(e.max()), beyond), shown.name),
        "bound_violation_time": (float(np.count_nonzero(beyond)) * h, "s"),
    }
    return {f"{name}.{output.name} [{unit or '1'}]": value for name, (value, unit) in values.items()}


def _input_metrics(
    variable: Variable, u: FloatArray, limits: tuple[float, float], h: float
) -> dict[str, float]:
    shown = variable.shown_in
    values = shown.from_unit(u)
    change = np.abs(np.diff(u, prepend=np.clip(variable.start, *limits))) * abs(shown.factor)
    span = limits[1] - limits[0]
    tolerance = 1e-9 * span if math.isfinite(span) else 0.0
    at_limit = (u >= limits[1] - tolerance) | (u <= limits[0] + tolerance)
    table = {
        "max_abs_input": (_or_nan(lambda v: float(np.abs(v).max()), values), shown.name),
        "max_abs_change": (_or_nan(lambda v: float(v.max()), change), shown.name),
        "rms_change": (_or_nan(lambda v: math.sqrt(float(np.mean(v**2))), change), shown.name),
        "total_variation": (float(change.sum()), shown.name),
        "time_at_bounds": (float(np.count_nonzero(at_limit)) * h, "s"),
    }
    return {f"{name}.{variable.name} [{unit or '1'}]": value for name, (value, unit) in table.items()}


def _time_metrics(trace: Trace) -> dict[str, float]:
    times = trace.solve_time[np.isfinite(trace.solve_time)]
    mean, median, p95, p99, longest = (math.nan,) * 5
    if times.size:
        mean, longest = float(times.mean()), float(times.max())
        median, p95, p99 = (float(value) for value in np.percentile(times, (50, 95, 99)))
    return {
        "solve_time_mean [s]": mean,
        "solve_time_median [s]": median,
        "solve_time_p95 [s]": p95,
        "solve_time_p99 [s]": p99,
        "solve_time_max [s]": longest,
        "deadline_misses [1]": float(np.count_nonzero(times > trace.sampling_time)),
        "failures [1]": float(trace.failures),
        "samples [1]": float(len(trace)),
    }


class _Step(NamedTuple):
    """The response to one step of the reference, as a fraction of the step: 0 before, 1 at the new value."""

    response: FloatArray

    def overshoot(self) -> float:
        return max(float(self.response.max()) - 1.0, 0.0)

    def rise_samples(self) -> float:
        reached = [np.flatnonzero(self.response >= level) for level in (0.1, 0.9)]
        return float(reached[1][0] - reached[0][0]) if reached[1].size else math.nan

    def settling_samples(self) -> float:
        outside = np.flatnonzero(np.abs(self.response - 1.0) > _SETTLING_BAND)
        after = int(outside[-1]) + 1 if outside.size else 0
        return float(after) if after < len(self.response) else math.nan


def _stretches(reference: FloatArray) -> Iterator[tuple[int, int]]:
    """Yield first and end row of every stretch of constant reference."""
    edges = [0, *(np.flatnonzero(np.diff(reference)) + 1), len(reference)]
    for first, end in pairwise(edges):
        if end > first:
            yield int(first), int(end)


def _steps(reference: FloatArray, y: FloatArray) -> Iterator[_Step]:
    """Yield the steps of the reference; a stretch of one or two rows is a moving reference, not a step."""
    for first, end in _stretches(reference):
        size = reference[first] - y[first]
        if end - first > 2 and abs(size) > 1e-9 * max(1.0, abs(reference[first])):
            yield _Step((y[first:end] - y[first]) / size)


def _settled_error(reference: FloatArray, error: FloatArray) -> float:
    settled = [
        abs(float(error[end - max(1, round(_SETTLED_FRACTION * (end - first))) : end].mean()))
        for first, end in _stretches(reference)
        if end - first > 2
    ]
    return max(settled, default=math.nan)


def _or_nan(figure: Callable[[FloatArray], float], values: FloatArray) -> float:
    return figure(values) if values.size else math.nan


def _median(values: list[float]) -> float:
    return float(np.median(values)) if values else math.nan


def _nan_last(value: float) -> float:
    return math.inf if math.isnan(value) else value
