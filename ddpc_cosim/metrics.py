"""Metrics of one run: a registry that files, terminal and reports follow, so that one is added here alone.

Metrics of the response are taken over the *held* samples: those whose inputs acted on the plant (the last
sample of a completed run, at which the run ends, is left out). Keys read ``name.signal [unit]``; values are
in the variables' display units, and NaN where there is none.
"""

import math
import re
import warnings
from collections import ChainMap
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import Any, Generic, Literal, NamedTuple, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.errors import CosimWarning
from ddpc_cosim.plugins import Plugin, installed, source_hash
from ddpc_cosim.variables import FloatArray, Variable

_SETTLED_FRACTION = 0.2
_SETTLING_BAND = 0.05
_RISE = (0.1, 0.9)
_FEWEST_SAMPLES = 5
_CONSTANT_ROWS = 3
"""Fewest rows of a stretch of constant reference; shorter ones belong to a moving reference."""
_SMALLEST_FIRST_STEP = 0.01
_SMALLEST_LONE_STEP = 0.001
_LARGEST_SETTLED_ERROR = 0.5
_TRACE = "ddpc_cosim.trace.Trace"
"""The class that metrics of third parties are of; its module imports this one."""
_OF_A_SIGNAL = ("difference", "value", "difference.s")


@dataclass(frozen=True)
class MetricSettings:
    """What metrics depend on besides the samples of their run: it is the same for all runs of a study.

    Parameters
    ----------
    preview : int
        The largest number of future references that any controller of the study sees. The window of a step
        ends so many samples before the next one: until then, each of them answers the same question.
    cost : mapping of str to mapping of str to float
        Weights of the quadratic cost: ``outputs`` by controlled output, ``inputs`` and ``changes`` by input,
        in the reciprocal squares of their units; empty for no such cost.
    versions : mapping of str to str
        Of the installed metrics of third parties, a hash of their source.
    """

    preview: int = 0
    cost: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)


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
    """A controlled output over the held samples, and its reference, shape (K,).

    ``preview`` is that of :class:`MetricSettings`.
    """

    reference: FloatArray
    preview: int

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
    def stretches(self) -> list["_Stretch"]:
        """The stretches of constant reference whose windows are long enough."""
        edges = [0, *(np.flatnonzero(self._moves) + 1).tolist(), len(self.reference)]
        rows = [end - first for first, end in pairwise(edges)]
        return [
            _Stretch(self, first, end - self.preview, self._value_before(first, rows[n - 1] if n else 0))
            for n, (first, end) in enumerate(pairwise(edges))
            if end - first >= _CONSTANT_ROWS and end - self.preview - first >= _FEWEST_SAMPLES
        ]

    @cached_property
    def steps(self) -> list["_Stretch"]:
        """The stretches that begin with a step."""
        return [stretch for stretch in self.stretches if not math.isnan(stretch.before)]

    @cached_property
    def span(self) -> float:
        """How far the reference moves; of a constant one, how far the output has to."""
        return float(np.ptp(self.reference)) or abs(self._first_step)

    @property
    def _moves(self) -> NDArray[np.bool_]:
        """Whether the reference changes from row to row, by more than a rounding error."""
        r = self.reference
        smallest = 1e-9 * np.ptp(r) + 1e-12 * np.abs(r).max() if r.size else 0.0
        return np.abs(np.diff(r)) > smallest

    @property
    def _first_step(self) -> float:
        return float(self.reference[0] - self.values[0])

    def _value_before(self, first: int, rows_before: int) -> float:
        """Return from which value the reference steps at a row, NaN if it does not: it may have moved."""
        if first > 0:
            return float(self.reference[first - 1]) if rows_before >= _CONSTANT_ROWS else math.nan
        smallest = _SMALLEST_FIRST_STEP * float(np.ptp(self.reference))
        if smallest == 0.0:
            smallest = _SMALLEST_LONE_STEP * max(abs(float(self.reference[0])), self.variable.nominal)
        return float(self.values[0]) if abs(self._first_step) >= smallest else math.nan

    @property
    def holds(self) -> bool:
        """Whether the output comes to rest near its reference, and stays near its limits."""
        if not len(self.values):
            return False
        far = float(self.beyond.max()) / abs(self.variable.shown_in.factor)
        return far <= self.span and all(
            step.settled_error <= _LARGEST_SETTLED_ERROR * abs(step.size) for step in self.steps
        )


@dataclass(frozen=True)
class _Stretch:
    """A stretch of constant reference: its first row, and the end of its window.

    ``before`` is the value from which the reference stepped there; NaN if it did not.
    """

    response: Response
    first: int
    end: int
    before: float

    @property
    def size(self) -> float:
        """By how much the reference stepped, in the output's unit."""
        return float(self.response.reference[self.first]) - self.before

    @property
    def settled_error(self) -> float:
        """Magnitude of the mean error over the last fifth of the window, in the output's unit."""
        rows = round(_SETTLED_FRACTION * (self.end - self.first))
        settled = slice(self.end - rows, self.end)
        return abs(float((self.response.reference[settled] - self.response.values[settled]).mean()))

    @property
    def overshoot(self) -> float:
        """How far the output goes beyond the new value, as a fraction of the step."""
        return max(float(self._path(self.first).max()) - 1.0, 0.0)

    @property
    def rise_samples(self) -> float:
        """Samples from the last one within 10 % of the step, before it is at 90 %, to the first there."""
        path = self._path(max(self.first - self.response.preview, 0))
        there = np.flatnonzero(path >= _RISE[1])
        if not there.size:
            return math.nan
        before = np.flatnonzero(path[: there[0]] <= _RISE[0])
        return float(there[0] - before[-1]) if before.size else math.nan

    @property
    def settling_samples(self) -> float:
        """Samples from the step until the output is within 5 % of it for the rest of the window."""
        outside = np.flatnonzero(np.abs(self._path(self.first) - 1.0) > _SETTLING_BAND)
        after = int(outside[-1]) + 1 if outside.size else 0
        return float(after) if after < self.end - self.first else math.nan

    @property
    def anticipation_samples(self) -> float:
        """Samples by which the output left 5 % of the step before it; NaN if it had not come to rest."""
        start = max(self.first - self.response.preview, 0)
        path = self._path(start)[: self.first - start + 1]
        at_rest = np.flatnonzero(np.abs(path) <= _SETTLING_BAND)
        if self.first == 0 or not at_rest.size or at_rest[0] > 0:
            return math.nan
        return float(max(self.first - start - int(at_rest[-1]) - 1, 0))

    def _path(self, start: int) -> FloatArray:
        """Return the output up to the window's end as a fraction of the step: 0 before it, 1 after it."""
        return (self.response.values[start : self.end] - self.before) / self.size


@dataclass(frozen=True)
class Actuation(_Signal):
    """An input over the held samples."""

    @cached_property
    def magnitude(self) -> FloatArray:
        """The input without its sign, in the display unit."""
        return np.abs(self.variable.shown_in.from_unit(self.values))

    @property
    def rest(self) -> float:
        """Its value at rest, as far as the limits allow, in its unit."""
        return float(np.clip(self.variable.start, *self.limits))

    @cached_property
    def change(self) -> FloatArray:
        """Magnitude of the change at every sample, the first one from rest, in the display unit."""
        return np.abs(np.diff(self.values, prepend=self.rest)) * abs(self.variable.shown_in.factor)

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


@dataclass(frozen=True)
class WholeRun:
    """All controlled outputs and inputs of a run over the held samples, and the weights of its cost."""

    responses: Sequence[Response]
    actuations: Sequence[Actuation]
    weights: Mapping[str, Mapping[str, float]]

    def cost(self) -> float:
        """Return the sum over the samples of all weighted squares, each in the unit of its signal."""
        squares = {
            "outputs": {one.variable.name: (one.reference - one.values) ** 2 for one in self.responses},
            "inputs": {one.variable.name: (one.values - one.rest) ** 2 for one in self.actuations},
            "changes": {
                one.variable.name: np.diff(one.values, prepend=one.rest) ** 2 for one in self.actuations
            },
        }
        return sum(
            weight * _total(squares[kind][name])
            for kind, weights in self.weights.items()
            for name, weight in weights.items()
        )


Samples = TypeVar("Samples")


@dataclass(frozen=True)
class Metric(Generic[Samples]):
    """How a metric is computed, and how it is shown.

    Parameters
    ----------
    of : type
        What it is computed from: a controlled output, an input, the whole run, or the controller's steps; a
        metric of a third party from the :class:`ddpc_cosim.Trace`.
    label : str
        Its name in sentences.
    description : str
        What it is, in one line.
    compute : callable
        Takes the samples and returns the value.
    unit : str
        Its unit as FMUs write it, "1" for none; of a metric of one signal also ``"value"``, ``"difference"``
        and ``"difference.s"``: the unit of the signal, for a value or a difference, or that times seconds.
    better : {"low", "high", ""}
        Which values are better; empty where neither are.
    if_held : bool
        Whether it is a figure of the step response, which says something only of a run that holds its
        reference.
    over_seeds : {"median", "largest", "total"}
        How the cases of several seeds are summed up in one value.
    title, group : str
        Heading in the report's tables, and the heading above it; without a title the metric stands in
        ``metrics.csv`` alone. A third party's has its label.
    short : str
        Heading in the terminal's table; empty if it is not shown there. A third party's has its label.
    """

    of: type[Samples]
    label: str
    description: str
    compute: Callable[[Samples], float]
    unit: str = "difference"
    better: Literal["low", "high", ""] = "low"
    if_held: bool = False
    over_seeds: Literal["median", "largest", "total"] = "median"
    title: str = ""
    group: str = ""
    short: str = ""

    def __str__(self) -> str:
        """Return what it is, its unit and which values are better, in one line."""
        better = {"low": "lower is better", "high": "higher is better"}.get(self.better, "")
        of_signal = {"difference": "unit of the signal", "value": "unit of the signal", "1": ""}
        unit = of_signal.get(self.unit, self.unit.replace("difference.s", "unit of the signal times s"))
        return "; ".join(filter(None, (self.description, unit and f"[{unit}]", better)))

    def rank(self, value: float) -> float:
        """Return a number by which values are sorted, the best first."""
        return -value if self.better == "high" else value


def split_key(key: str) -> tuple[str, str, str]:
    """Split a metric's key into name, signal and unit; the signal is empty for metrics of the whole run."""
    head, _, unit = key.partition(" [")
    name, _, signal = head.partition(".")
    return name, signal, unit.removesuffix("]")


def headline(keys: Iterable[str]) -> tuple[str, ...]:
    """Return the keys that runs are ranked by: the study's own cost if it has one, else mean errors."""
    by_name = {
        name: [key for key in keys if split_key(key)[0] == name] for name in ("cost", "mean_abs_error")
    }
    return tuple(by_name["cost"] or by_name["mean_abs_error"])


def compute_metrics(
    responses: Sequence[Response],
    actuations: Sequence[Actuation],
    step_times: StepTimes,
    cost: Mapping[str, Mapping[str, float]],
) -> dict[str, float]:
    """Return the built-in metrics of a run: of every output, of every input, its cost, and of the steps."""
    table: dict[str, float] = {}
    registry: Mapping[str, Metric[Any]] = METRICS
    whole = [WholeRun(responses, actuations, cost)] if cost else []
    with np.errstate(over="ignore", invalid="ignore"):  # a run that diverged has values of any size
        for samples in (*responses, *actuations, *whole, step_times):
            for name, metric in registry.items():
                if isinstance(samples, metric.of):
                    table[_key(name, metric.unit, samples)] = metric.compute(samples)
    return table


def compute_installed_metrics(trace: Any) -> dict[str, float]:
    """Return the metrics of third parties of a trace by key.

    One that fails has no value, and neither costs others nor changes the trace; a warning tells why.
    """
    table = {}
    found, _, faults = _third_parties()
    for name, metric in found.items():
        value = math.nan
        try:
            value = float(metric.compute(deepcopy(trace)))
        except (Exception, SystemExit) as error:  # a third party's function can fail in any way
            faults = (*faults, f"metric {name}: {type(error).__name__}: {error}")
        table[_key(name, metric.unit, trace)] = value
    for fault in faults:
        warnings.warn(fault, CosimWarning, stacklevel=2)
    return table


def all_metrics() -> Mapping[str, Metric[Any]]:
    """Return all metrics by name, in the order of files and tables: built-in ones, then installed ones."""
    return ChainMap(_third_parties().metrics, cast("dict[str, Metric[Any]]", METRICS))


def metric_of(key: str) -> Metric[Any]:
    """Return the metric of a key; of one that is installed no more, what the key says of it."""
    name, _, unit = split_key(key)
    return all_metrics().get(name) or Metric(object, name, "", lambda _: math.nan, unit, "")


def installed_versions() -> dict[str, str]:
    """Return for each installed metric of a third party a hash of its source."""
    return {name: source_hash(module) for name, module in _third_parties().modules.items()}


class _ThirdParties(NamedTuple):
    """The metrics of third parties, the modules they come from, and why others are left out."""

    metrics: dict[str, Metric[Any]]
    modules: dict[str, str]
    faults: tuple[str, ...]


@cache
def _third_parties() -> _ThirdParties:
    found: dict[str, Metric[Any]] = {}
    modules, faults = {}, []
    for plugin in installed("metrics"):
        fault = plugin.error or _fault(plugin)
        if fault:
            faults.append(f"metric {plugin.name} ({plugin.package}): {fault}")
        else:
            metric = plugin.value
            titles = {key: getattr(metric, key) or metric.label for key in ("title", "short")}
            found[plugin.name] = replace(metric, **titles)
            modules[plugin.name] = plugin.target.partition(":")[0]
    return _ThirdParties(found, modules, tuple(faults))


def describe_metric(plugin: Plugin) -> tuple[str, bool]:
    """Return one line about a metric of a third party, or why it is broken; and whether it works."""
    fault = plugin.error or _fault(plugin)
    return (f"broken: {fault}", False) if fault else (str(plugin.value), True)


def _fault(plugin: Plugin) -> str:
    """Return why an installed object cannot be a metric; empty if it can."""
    metric = plugin.value
    if plugin.name in METRICS:
        return "there is a built-in metric of this name; choose another"
    if not re.fullmatch(r"[A-Za-z0-9_-]+", plugin.name):
        return "a name may have letters, digits, _ and - only"
    if not isinstance(metric, Metric):
        return f"a {type(metric).__name__} is not a ddpc_cosim.Metric"
    if f"{getattr(metric.of, '__module__', '')}.{getattr(metric.of, '__name__', '')}" != _TRACE:
        return f"it is of {metric.of!r}; needed: ddpc_cosim.Trace"
    if metric.better not in ("low", "high", ""):
        return f'better = {metric.better!r}; allowed: "low", "high" or ""'
    if not callable(metric.compute):
        return f"{metric.compute!r} cannot be called"
    if not metric.unit or metric.unit in _OF_A_SIGNAL or set(metric.unit) & set("[]"):
        return f'unit = {metric.unit!r}; needed: a unit such as "N.m.s", or "1"'
    return ""


def _key(name: str, unit: str, samples: Any) -> str:
    if not isinstance(samples, _Signal):
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
    factor = abs(response.variable.shown_in.factor)
    return factor * _largest(np.array([stretch.settled_error for stretch in response.stretches]))


def _overshoot(response: Response) -> float:
    return 100 * _largest(np.array([step.overshoot for step in response.steps]))


def _rise_time(response: Response) -> float:
    return response.sampling_time * _percentile(np.array([step.rise_samples for step in response.steps]), 50)


def _settling_time(response: Response) -> float:
    return response.sampling_time * _largest(np.array([step.settling_samples for step in response.steps]))


def _anticipation(response: Response) -> float:
    known = [n for step in response.steps if not math.isnan(n := step.anticipation_samples)]
    return response.sampling_time * _largest(np.array(known))


METRICS: dict[str, Metric[Response] | Metric[Actuation] | Metric[WholeRun] | Metric[StepTimes]] = {
    "mean_abs_error": Metric(
        Response,
        "Mean absolute error",
        "mean of |reference - output| over the samples",
        lambda r: _mean(r.magnitude),
        title="mean |error|",
        short="mean |error|",
    ),
    "rmse": Metric(
        Response,
        "RMSE",
        "root mean square of reference - output",
        lambda r: _rms(r.error),
        title="RMSE",
        short="RMSE",
    ),
    "sum_abs_error": Metric(
        Response,
        "Absolute integral error",
        "sum of |reference - output| over the samples, as in the paper",
        lambda r: _total(r.magnitude),
    ),
    "iae": Metric(
        Response,
        "IAE",
        "integral of |reference - output| over time",
        lambda r: _total(r.magnitude) * r.sampling_time,
        "difference.s",
    ),
    "min_abs_error": Metric(
        Response, "Minimum absolute error", "smallest |reference - output|", lambda r: _smallest(r.magnitude)
    ),
    "max_abs_error": Metric(
        Response, "Maximum absolute error", "largest |reference - output|", lambda r: _largest(r.magnitude)
    ),
    "settled_error": Metric(
        Response,
        "Settled error",
        "magnitude of the mean error over the last fifth of the window of a constant reference, the largest",
        _settled_error,
        if_held=True,
        title="settled error",
        short="settled",
    ),
    "overshoot": Metric(
        Response,
        "Overshoot",
        "largest excursion beyond the new reference in the window after a step, of the step",
        _overshoot,
        "%",
        if_held=True,
        title="overshoot",
    ),
    "rise_time": Metric(
        Response,
        "Rise time",
        "median time from the last sample within 10 % of a step to the first at 90 %; NaN if one is missing",
        _rise_time,
        "s",
        if_held=True,
        title="rise time",
    ),
    "settling_time": Metric(
        Response,
        "Settling time",
        "longest time after a step until the output stays within 5 % of it; NaN if it does not",
        _settling_time,
        "s",
        if_held=True,
        title="settling time",
    ),
    "anticipation": Metric(
        Response,
        "Anticipation",
        "longest time before a step at which the output has left 5 % of the step around its old value",
        _anticipation,
        "s",
        better="",
        if_held=True,
        title="anticipation",
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
    "cost": Metric(
        WholeRun,
        "Quadratic cost",
        "sum over the samples of the weighted squares of errors, inputs and input changes",
        WholeRun.cost,
        "1",
        title="cost",
        short="cost",
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
"""The built-in metrics, in the order of files and tables."""
