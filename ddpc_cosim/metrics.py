"""Metrics of one run: a registry that files, terminal and reports follow, so that one is added here alone.

Metrics of the response are taken over the *held* samples: those whose inputs acted on the plant (the last
sample of a completed run, at which the run ends, is left out). Keys read ``name.signal [unit]``; values are
in the variables' display units, and NaN where there is none.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.variables import FloatArray, Variable

_SETTLED_FRACTION = 0.2
_SETTLING_BAND = 0.05


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


@dataclass(frozen=True)
class _Signal:
    """A signal over the held samples.

    Parameters
    ----------
    variable : Variable
        The controlled output or the input.
    values : array, shape (K,)
        Its values, in its unit.
    limits : tuple of float
        Its bounds in the run, in its unit.
    sampling_time : float
        Time between samples [s].
    """

    variable: Variable
    values: FloatArray
    limits: tuple[float, float]
    sampling_time: float


@dataclass(frozen=True)
class Response(_Signal):
    """A controlled output over the held samples, and its reference, shape (K,)."""

    reference: FloatArray

    @cached_property
    def error(self) -> FloatArray:
        """Reference minus output, in the display unit."""
        return (self.reference - self.values) * self.variable.shown_in.factor

    @cached_property
    def magnitude(self) -> FloatArray:
        """The error without its sign."""
        return np.abs(self.error)

    @cached_property
    def beyond(self) -> FloatArray:
        """How far the output lies beyond its limits, in the display unit; zero within them."""
        excess = np.maximum(self.values - self.limits[1], self.limits[0] - self.values)
        return np.maximum(excess, 0.0) * abs(self.variable.shown_in.factor)

    @cached_property
    def steps(self) -> list[_Step]:
        """The steps of the reference; a stretch of one or two rows is a moving reference, not a step."""
        found, y = [], self.values
        for first, end in _stretches(self.reference):
            new = self.reference[first]
            size = new - y[first]
            if end - first > 2 and abs(size) > 1e-9 * max(1.0, abs(new)):
                found.append(_Step((y[first:end] - y[first]) / size))
        return found


@dataclass(frozen=True)
class Actuation(_Signal):
    """An input over the held samples."""

    @cached_property
    def magnitude(self) -> FloatArray:
        """The input without its sign, in the display unit."""
        return np.abs(self.variable.shown_in.from_unit(self.values))

    @cached_property
    def change(self) -> FloatArray:
        """Magnitude of the change at every sample, the first one from rest, in the display unit."""
        rest = np.clip(self.variable.start, *self.limits)
        return np.abs(np.diff(self.values, prepend=rest)) * abs(self.variable.shown_in.factor)

    @cached_property
    def at_limit(self) -> NDArray[np.bool_]:
        """Whether the input is at one of its limits, at every sample."""
        span = self.limits[1] - self.limits[0]
        tolerance = 1e-9 * span if math.isfinite(span) else 0.0
        return (self.values >= self.limits[1] - tolerance) | (self.values <= self.limits[0] + tolerance)


@dataclass(frozen=True)
class StepTimes:
    """The controller's steps: times [s], shape (K,), NaN without a step; fallbacks; rows of the trace."""

    solve_time: FloatArray
    sampling_time: float
    fallbacks: int
    rows: int

    @cached_property
    def times(self) -> FloatArray:
        """The times of the steps that were taken [s]."""
        return self.solve_time[np.isfinite(self.solve_time)]


Samples = TypeVar("Samples")


@dataclass(frozen=True)
class Metric(Generic[Samples]):
    """How a metric is computed, and how it is shown.

    Parameters
    ----------
    of : type
        What it is computed from: a controlled output, an input, or the controller's steps.
    label : str
        Its name in sentences.
    description : str
        What it is, in one line.
    compute : callable
        Takes the samples and returns the value.
    unit : {"difference", "value", "difference.s", "%", "s", "1"}
        Its unit: that of the signal, for a difference of two values or for a value; the same times seconds;
        or the one given.
    better : {"low", "high", ""}
        Which values are better; empty where neither are.
    over_seeds : {"median", "largest", "total"}
        How the cases of several seeds are summed up in one value.
    title, group : str
        Heading in the report's tables, and the heading above it; without a title the metric stands in
        ``metrics.csv`` alone.
    short : str
        Heading in the terminal's table; empty if it is not shown there.
    """

    of: type[Samples]
    label: str
    description: str
    compute: Callable[[Samples], float]
    unit: Literal["difference", "value", "difference.s", "%", "s", "1"] = "difference"
    better: Literal["low", "high", ""] = "low"
    over_seeds: Literal["median", "largest", "total"] = "median"
    title: str = ""
    group: str = ""
    short: str = ""

    def rank(self, value: float) -> float:
        """Return a number by which values are sorted, the best first."""
        return -value if self.better == "high" else value


def split_key(key: str) -> tuple[str, str, str]:
    """Split a metric's key into name, signal and unit; the signal is empty for metrics of the whole run."""
    head, _, unit = key.partition(" [")
    name, _, signal = head.partition(".")
    return name, signal, unit.removesuffix("]")


def compute_metrics(
    responses: Iterable[Response], actuations: Iterable[Actuation], step_times: StepTimes
) -> dict[str, float]:
    """Return the metrics of a run by key: those of every output, of every input, and of the steps."""
    table: dict[str, float] = {}
    registry: Mapping[str, Metric[Any]] = METRICS
    with np.errstate(over="ignore", invalid="ignore"):  # a run that diverged has values of any size
        for samples in (*responses, *actuations, step_times):
            for name, metric in registry.items():
                if isinstance(samples, metric.of):
                    table[_key(name, metric.unit, samples)] = metric.compute(samples)
    return table


def _key(name: str, unit: str, samples: Response | Actuation | StepTimes) -> str:
    if isinstance(samples, StepTimes):
        return f"{name} [{unit}]"
    shown = samples.variable.shown_in.name
    units = {"difference": shown, "value": shown, "difference.s": f"{shown}.s".lstrip(".")}
    return f"{name}.{samples.variable.name} [{units.get(unit, unit) or '1'}]"


def _largest(values: FloatArray) -> float:
    return float(values.max()) if values.size else math.nan


def _smallest(values: FloatArray) -> float:
    return float(values.min()) if values.size else math.nan


def _total(values: FloatArray) -> float:
    return float(values.sum()) if values.size else math.nan


def _mean(values: FloatArray) -> float:
    return float(values.mean()) if values.size else math.nan


def _rms(values: FloatArray) -> float:
    return math.sqrt(float(np.mean(values**2))) if values.size else math.nan


def _percentile(values: FloatArray, percent: float) -> float:
    return float(np.percentile(values, percent)) if values.size else math.nan


def _settled_error(response: Response) -> float:
    settled = [
        abs(float(response.error[end - max(1, round(_SETTLED_FRACTION * (end - first))) : end].mean()))
        for first, end in _stretches(response.reference)
        if end - first > 2
    ]
    return max(settled, default=math.nan)


def _overshoot(response: Response) -> float:
    return 100 * max((step.overshoot() for step in response.steps), default=math.nan)


def _rise_time(response: Response) -> float:
    samples = [step.rise_samples() for step in response.steps]
    return response.sampling_time * (float(np.median(samples)) if samples else math.nan)


def _settling_time(response: Response) -> float:
    samples = [step.settling_samples() for step in response.steps]
    longest = math.nan if any(map(math.isnan, samples)) else max(samples, default=math.nan)
    return response.sampling_time * longest


METRICS: dict[str, Metric[Response] | Metric[Actuation] | Metric[StepTimes]] = {
    "sum_abs_error": Metric(
        Response,
        "Absolute integral error",
        "sum of |reference - output| over the samples",
        lambda r: _total(r.magnitude),
        title="tracking cost",
        short="sum |error|",
    ),
    "iae": Metric(
        Response,
        "IAE",
        "integral of |reference - output| over time",
        lambda r: _total(r.magnitude) * r.sampling_time,
        "difference.s",
    ),
    "rmse": Metric(Response, "RMSE", "root mean square of reference - output", lambda r: _rms(r.error)),
    "min_abs_error": Metric(
        Response, "Minimum absolute error", "smallest |reference - output|", lambda r: _smallest(r.magnitude)
    ),
    "max_abs_error": Metric(
        Response, "Maximum absolute error", "largest |reference - output|", lambda r: _largest(r.magnitude)
    ),
    "settled_error": Metric(
        Response,
        "Settled error",
        "largest mean error over the last fifth of a stretch of constant reference; who looks ahead and "
        "moves before a step pays for it here",
        _settled_error,
        title="settled error",
        short="settled",
    ),
    "overshoot": Metric(
        Response,
        "Overshoot",
        "largest excursion beyond the new reference after a step, of the step",
        _overshoot,
        "%",
    ),
    "rise_time": Metric(
        Response,
        "Rise time",
        "median time from 10 % to 90 % of a step; NaN if one is not reached",
        _rise_time,
        "s",
    ),
    "settling_time": Metric(
        Response,
        "Settling time",
        "longest time after a step until the output stays within 5 % of it; NaN if it does not",
        _settling_time,
        "s",
    ),
    "bound_violation_max": Metric(
        Response,
        "Largest bound violation",
        "how far the output went beyond its limits",
        lambda r: _largest(r.beyond),
        over_seeds="largest",
        title="beyond bounds",
    ),
    "bound_violation_time": Metric(
        Response,
        "Time beyond bounds",
        "time of samples with the output beyond its limits",
        lambda r: float(np.count_nonzero(r.beyond)) * r.sampling_time,
        "s",
    ),
    "max_abs_input": Metric(
        Actuation,
        "Maximum absolute input",
        "largest |input|",
        lambda a: _largest(a.magnitude),
        "value",
        better="",
        short="max |input|",
    ),
    "max_abs_change": Metric(
        Actuation,
        "Largest input change",
        "largest |change of the input| from sample to sample",
        lambda a: _largest(a.change),
    ),
    "rms_change": Metric(
        Actuation,
        "RMS input change",
        "root mean square change of the input from sample to sample",
        lambda a: _rms(a.change),
    ),
    "total_variation": Metric(
        Actuation,
        "Actuator travel",
        "sum of |change of the input|",
        lambda a: float(a.change.sum()),
        title="actuator travel",
    ),
    "time_at_bounds": Metric(
        Actuation,
        "Time at input limits",
        "time of samples with the input at a limit",
        lambda a: float(np.count_nonzero(a.at_limit)) * a.sampling_time,
        "s",
        better="",
    ),
    "solve_time_mean": Metric(
        StepTimes,
        "Mean step time",
        "mean wall-clock time of a controller step",
        lambda s: _mean(s.times),
        "s",
    ),
    "solve_time_median": Metric(
        StepTimes,
        "Median step time",
        "median wall-clock time of a controller step",
        lambda s: _percentile(s.times, 50),
        "s",
        title="median",
        group="step time",
    ),
    "solve_time_p95": Metric(
        StepTimes,
        "95 % step time",
        "95th percentile of the wall-clock time of a controller step",
        lambda s: _percentile(s.times, 95),
        "s",
    ),
    "solve_time_p99": Metric(
        StepTimes,
        "99 % step time",
        "99th percentile of the wall-clock time of a controller step",
        lambda s: _percentile(s.times, 99),
        "s",
        title="99\u00a0%",
        group="step time",
    ),
    "solve_time_max": Metric(
        StepTimes,
        "Longest step time",
        "longest wall-clock time of a controller step",
        lambda s: _largest(s.times),
        "s",
        over_seeds="largest",
        title="longest",
        group="step time",
    ),
    "deadline_misses": Metric(
        StepTimes,
        "Deadline misses",
        "steps longer than the sampling time",
        lambda s: float(np.count_nonzero(s.times > s.sampling_time)),
        "1",
        over_seeds="total",
        title="missed",
        group="steps",
    ),
    "failures": Metric(
        StepTimes,
        "Fallbacks",
        "steps with a substitute for the input",
        lambda s: float(s.fallbacks),
        "1",
        over_seeds="total",
        title="fallback",
        group="steps",
    ),
    "samples": Metric(StepTimes, "Samples", "rows of the trace", lambda s: float(s.rows), "1", better=""),
}
"""All metrics, in the order of files and tables."""
