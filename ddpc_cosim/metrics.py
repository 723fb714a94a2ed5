"""Metrics of one run: a registry that files, terminal and reports follow, so that one is added here alone.

Keys read ``name.signal [unit]``; values are in the variables' display units, and NaN where there is none.
In print a metric has one name, its label: :func:`metric_name`.
"""

import math
import re
import warnings
from collections import ChainMap
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache, partial
from statistics import median
from typing import Any, Generic, Literal, NamedTuple, TypeVar, cast

import numpy as np

from ddpc_cosim.description import KeyFigureTags
from ddpc_cosim.errors import ConfigError, CosimWarning
from ddpc_cosim.key_figures import (
    CO2,
    DISTRICT_HEATING,
    ELECTRIC,
    GAS,
    POWERS,
    TEMPERATURES,
    WATER,
    KeyFigures,
)
from ddpc_cosim.plugins import Plugin, installed, source_hash
from ddpc_cosim.responses import (
    Actuation,
    BandResponse,
    Charged,
    Response,
    SampledSignal,
    StepTimes,
    WholeRun,
)
from ddpc_cosim.variables import DisplayUnit, FloatArray, Variable
from fmu_plants.spelling import did_you_mean
from fmu_plants.units import display_unit

_TRACE = "ddpc_cosim.loop.trace.Trace"
"""The class that metrics of third parties are of; its module imports this one."""
_OF_A_SIGNAL = ("difference", "value", "difference.s", "difference.h")
_HOUR = 3600.0  # s
_BAND = "band_violation"
"""What outputs with a band have, and no others."""
Ranking = Literal["error", "money", "pareto"]
"""By what controllers are ranked: the study's cost or errors, money, or money and discomfort both."""


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
    key_figures : KeyFigureTags, optional
        What the key figures of a building are of; default: there are none.
    """

    preview: int = 0
    cost: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    key_figures: KeyFigureTags | None = None


Samples = TypeVar("Samples")


@dataclass(frozen=True)
class Metric(Generic[Samples]):
    """How a metric is computed, and how it is shown.

    Parameters
    ----------
    of : type
        What it is computed from: a controlled output, an input, the whole run, what is paid for, or the
        controller's steps; a metric of a third party from the :class:`ddpc_cosim.Trace`.
    label : str
        What it is called in print.
    description : str
        What it is, in one line.
    compute : callable
        Takes the samples and returns the value.
    unit : str
        Its unit as FMUs write it, "1" for none; of a metric of one signal also ``"value"``, ``"difference"``,
        ``"difference.s"`` and ``"difference.h"``: the unit of the signal, for a value or a difference, or
        that times seconds or hours; of what is paid for also ``"money"``, and ``"money/m2"``.
    better : {"low", "high", ""}
        Which values are better; empty where neither are.
    if_held : bool
        Whether it is a figure of the step response, which says something only of a run that did not
        fail.
    over_seeds : {"median", "largest", "total"}
        How the cases of several seeds are summed up in one value.
    shown : sequence of {"report", "terminal"}
        Whose tables show it; without either it stands in ``metrics.csv`` alone.
    exists : callable
        Takes the samples and returns whether there is such a figure of them; default: always.
    of_band : str
        What it is called of an output with a band; empty: the same.
    """

    of: type[Samples]
    label: str
    description: str
    compute: Callable[[Samples], float]
    unit: str = "difference"
    better: Literal["low", "high", ""] = "low"
    if_held: bool = False
    over_seeds: Literal["median", "largest", "total"] = "median"
    shown: Sequence[Literal["report", "terminal"]] = ("report", "terminal")
    exists: Callable[[Samples], bool] = lambda _: True
    of_band: str = ""

    def __str__(self) -> str:
        """Return what its name stands for, what it is, its unit and which values are better, in one line."""
        better = {"low": "lower is better", "high": "higher is better"}.get(self.better, "")
        of_signal = {"difference": "unit of the signal", "value": "unit of the signal", "1": ""}
        unit = of_signal.get(self.unit, self.unit.replace("difference.", "unit of the signal times "))
        what = ": ".join(filter(None, (self.label, self.description)))
        return "; ".join(filter(None, (what, unit and f"[{unit}]", better)))

    def rank(self, value: float) -> float:
        """Return a number by which values are sorted, the best first."""
        return -value if self.better == "high" else value


@lru_cache(maxsize=4096)  # all cases of a study have the same keys
def split_key(key: str) -> tuple[str, str, str]:
    """Split a metric's key into name, signal and unit; the signal is empty for metrics of the whole run."""
    head, _, unit = key.partition(" [")
    name, _, signal = head.partition(".")
    return name, signal, unit.removesuffix("]")


def keys_named(metric: str, keys: Iterable[str]) -> list[str]:
    """Return the keys that a metric and its signal stand for, where the unit may be left out.

    Raises
    ------
    ConfigError
        There is none.
    """
    heads = {key: key.partition(" [")[0] for key in keys}
    chosen = [key for key, head in heads.items() if metric in (key, head)]
    if not chosen:
        raise ConfigError(f'no metric "{metric}"; {did_you_mean(metric, heads.values())}')
    return chosen


def metric_name(key: str, keys: Iterable[str] = ()) -> str:
    """Return what a metric is called in sentences and tables, from its key or name: its label.

    It begins with a small letter, but for an acronym. A metric that is installed no more has its own name.
    Among the ``keys`` of its run it is told whether its output has a band, of which errors are distances.
    """
    metric, signal = metric_of(key), split_key(key)[1]
    is_of_band = bool(metric.of_band) and any(split_key(other)[:2] == (_BAND, signal) for other in keys)
    label = metric.of_band if is_of_band else metric.label
    return label if label[1:2].isupper() else label[:1].lower() + label[1:]


def headline(keys: Iterable[str], ranking: Ranking | None = None) -> tuple[str, ...]:
    """Return the keys that runs are ranked by.

    Parameters
    ----------
    keys : iterable of str
        Those of the runs.
    ranking : {"error", "money", "pareto"}, optional
        By the study's own cost if it has one, else mean errors; by money; or by money and discomfort, both;
        default: the last where there are prices and no cost, else the first.
    """
    keys = [*keys]
    by_name = {
        name: [key for key in keys if split_key(key)[0] == name]
        for name in ("cost", "mean_abs_error", "money")
    }
    money = by_name["money"]
    if money and (ranking in ("money", "pareto") or (ranking is None and not by_name["cost"])):
        return (*money, *(() if ranking == "money" else discomfort(keys)))
    return tuple(by_name["cost"] or by_name["mean_abs_error"])


def discomfort(keys: Iterable[str]) -> tuple[str, ...]:
    """Return what each output's discomfort is: the violation of its band, or its mean error without one."""
    of_output: dict[str, str] = {}
    for key in keys:
        name, signal, _ = split_key(key)
        if name == _BAND or (name == "mean_abs_error" and signal not in of_output):
            of_output[signal] = key
    return tuple(of_output.values())


def compute_metrics(
    responses: Sequence[Response],
    actuations: Sequence[Actuation],
    charged: Charged | None,
    step_times: StepTimes,
    cost: Mapping[str, Mapping[str, float]],
    key_figures: KeyFigures | None = None,
) -> dict[str, float]:
    """Return the built-in metrics of a run: of outputs, inputs, cost, payments, key figures and steps."""
    table: dict[str, float] = {}
    whole = [WholeRun(responses, actuations, cost)] if cost else []
    of_run = [samples for samples in (charged, key_figures) if samples]
    replaced = _third_parties().metrics
    with np.errstate(over="ignore", invalid="ignore"):  # a run that diverged has values of any size
        for samples in (*responses, *actuations, *whole, *of_run, step_times):
            key = _keys_of(samples)
            for name, metric in METRICS.items():
                of_samples: Metric[Any] = metric
                if isinstance(samples, metric.of) and name not in replaced and of_samples.exists(samples):
                    table[key(name, metric.unit)] = of_samples.compute(samples)
    return table


def compute_installed_metrics(trace: Any) -> dict[str, float]:
    """Return the metrics of third parties of a trace by key.

    One that fails has no value, and neither costs others nor changes the trace; a warning tells why.
    """
    table = {}
    metrics, _, faults = _third_parties()
    for name, metric in metrics.items():
        value = math.nan
        try:
            value = float(metric.compute(deepcopy(trace)))
        except (Exception, SystemExit) as error:  # a third party's function can fail in any way
            faults = (*faults, f"metric {name}: {type(error).__name__}: {error}")
        table[_key(name, metric.unit)] = value
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
    metrics: dict[str, Metric[Any]] = {}
    modules, faults = {}, []
    for plugin in installed("metrics"):
        fault = plugin.error or _fault(plugin)
        if fault:
            faults.append(f"metric {plugin.name} ({plugin.package}): {fault}")
        else:
            metrics[plugin.name] = plugin.value
            modules[plugin.name] = plugin.target.partition(":")[0]
    return _ThirdParties(metrics, modules, tuple(faults))


def describe_metric(plugin: Plugin) -> tuple[str, bool]:
    """Return one line about a metric of a third party, or why it is broken; and whether it works."""
    fault = plugin.error or _fault(plugin)
    return (f"broken: {fault}", False) if fault else (str(plugin.value), True)


def _fault(plugin: Plugin) -> str:
    """Return why an installed object cannot be a metric; empty if it can."""
    metric = plugin.value
    # One that was called after an amount, or a key figure, before those were built in takes their place.
    if plugin.name in METRICS and METRICS[plugin.name].of not in (Charged, KeyFigures):
        return "there is a built-in metric of this name; choose another"
    if not re.fullmatch(r"[A-Za-z0-9_-]+", plugin.name):
        return "a name may have letters, digits, _ and - only"
    if not isinstance(metric, Metric):
        return f"needed: a ddpc_cosim.Metric, got an object of class {type(metric).__name__}"
    if f"{getattr(metric.of, '__module__', '')}.{getattr(metric.of, '__name__', '')}" != _TRACE:
        return f"it is of {metric.of!r}; needed: ddpc_cosim.Trace"
    if metric.better not in ("low", "high", ""):
        return f'better = {metric.better!r}; allowed: "low", "high" or ""'
    if not callable(metric.compute):
        return f"{metric.compute!r} cannot be called"
    if not metric.unit or metric.unit in _OF_A_SIGNAL or set(metric.unit) & set("[]"):
        return f'unit = {metric.unit!r}; needed: a unit such as "N.m.s", or "1"'
    return ""


def _keys_of(samples: Any) -> Callable[[str, str], str]:
    """Return what makes the keys of metrics of some samples from their names and units."""
    if isinstance(samples, SampledSignal):
        return _keys_of_signal(samples.variable)
    return partial(_key_in, samples.money) if isinstance(samples, Charged | KeyFigures) else _key


def _keys_of_signal(variable: Variable) -> Callable[[str, str], str]:
    return partial(_key_shown_in, variable.name, variable.shown_in.name)


def _key(name: str, unit: str) -> str:
    return f"{name} [{unit}]"


def _key_in(money: str, name: str, unit: str) -> str:
    return _key(name, unit.replace("money", money, 1) if unit.startswith("money") else unit)


@cache
def _key_shown_in(signal: str, shown: str, name: str, unit: str) -> str:
    units = {"difference": shown, "value": shown}
    units |= {f"difference.{time}": f"{shown}.{time}".lstrip(".") for time in ("s", "h")}
    return f"{name}.{signal} [{units.get(unit, unit) or '1'}]"


def expected_keys(
    outputs: Sequence[Variable],
    inputs: Sequence[Variable],
    banded: Collection[str],
    charged: Charged | None,
    *,
    has_cost: bool,
    key_figures: KeyFigures | None = None,
) -> tuple[str, ...]:
    """Return the keys of the metrics that the runs of a problem will have, before there are any.

    Parameters
    ----------
    outputs, inputs : sequence of Variable
        The controlled outputs, and the inputs.
    banded : collection of str
        The outputs that are wanted within a band.
    charged : Charged, optional
        What is paid for, over one interval; None: nothing is.
    has_cost : bool
        Whether the study has a quadratic cost.
    key_figures : KeyFigures, optional
        The key figures of a building, of no samples; None: there are none.
    """
    keys = list[str]()
    of_run: dict[type[Any], Any] = {Charged: charged, KeyFigures: key_figures}
    of_run[StepTimes] = StepTimes(np.empty(0), math.nan, 0, 0, has_key_figures=key_figures is not None)
    of_run[WholeRun] = has_cost or None
    for name, metric in all_metrics().items():
        of_kind: Metric[Any] = metric
        if issubclass(metric.of, Response):
            is_of_band = issubclass(metric.of, BandResponse)
            signals: Sequence[Variable] = [
                v
                for v in outputs
                if not (is_of_band and v.name not in banded)
                and not (metric.exists is _has_steps and v.name in banded)
            ]
            keys += [_keys_of_signal(v)(name, metric.unit) for v in signals]
        elif issubclass(metric.of, Actuation):
            keys += [_keys_of_signal(v)(name, metric.unit) for v in inputs]
        elif metric.of not in of_run:  # of a third party
            keys.append(_key(name, metric.unit))
        elif (samples := of_run[metric.of]) is not None and of_kind.exists(samples):
            keys.append(_keys_of(samples)(name, metric.unit))
    return tuple(keys)


def in_unit(key: str, unit: str) -> DisplayUnit:
    """Return how values of a metric, which have the unit of its key, are shown in another one.

    Differences convert without the offset of the unit: 5 degC more are 5 K more.

    Raises
    ------
    ConfigError
        It is not a unit of the same quantity.
    """
    key_unit = split_key(key)[2]
    if unit in ("", key_unit):
        return DisplayUnit(key_unit)
    is_level = metric_of(key).unit == "value"
    # A product has no unit with an offset in it: a difference times a time is in K h.
    units = (key_unit, unit) if is_level else (text.replace("degC", "K") for text in (key_unit, unit))
    try:
        shown = display_unit(*units)
    except ValueError as error:
        raise ConfigError(f'unit "{unit}" does not fit {key}; needed: one of the same quantity') from error
    return shown if is_level else replace(shown, offset=0.0)


def _or_nan(figure: Callable[[FloatArray], np.float64]) -> Callable[[FloatArray], float]:
    """Return a figure of values that is NaN where there are none."""
    return lambda values: float(figure(values)) if values.size else math.nan


# Of few values, what stands around a reduction in NumPy takes longer than it.
_largest, _smallest = _or_nan(np.maximum.reduce), _or_nan(np.minimum.reduce)
_mean = _or_nan(lambda values: np.add.reduce(values) / values.size)


def _rms(values: FloatArray) -> float:
    return math.sqrt(_mean(values**2))


def _percentile(values: FloatArray, percent: float) -> float:
    if not values.size or np.isnan(values).any():  # as of compiled runs: NumPy's way to it is long
        return math.nan
    return float(np.percentile(values, percent))


def _of_all(figure: Callable[[Sequence[float]], float], values: Sequence[float]) -> float:
    """Return a figure of a few values; NaN where there are none, or one is NaN."""
    return figure(values) if values and not any(map(math.isnan, values)) else math.nan


def _has_steps(response: Response) -> bool:
    return not isinstance(response, BandResponse)


def _settled_error(response: Response) -> float:
    factor = abs(response.variable.shown_in.factor)
    return factor * _of_all(max, [stretch.settled_error for stretch in response.stretches])


def _settled_share(response: Response) -> float:
    return 100 * _of_all(max, [step.settled_error / abs(step.size) for step in response.steps])


def _overshoot(response: Response) -> float:
    return 100 * _of_all(max, [step.overshoot for step in response.steps])


def _time_at_bounds(actuation: Actuation) -> float:
    """Return it in s; it is not known where one of the inputs is not."""
    known = np.isfinite(actuation.values).all()
    return float(np.count_nonzero(actuation.at_limit)) * actuation.sampling_time if known else math.nan


def _limits_kept(response: Response) -> float:
    limited = any(np.isfinite(limit).any() for limit in response.limits)
    beyond = response.beyond
    kept = beyond.size - int(np.count_nonzero(beyond))
    return 100.0 * (kept / beyond.size) if limited and beyond.size else math.nan


def _rise_time(response: Response) -> float:
    return response.sampling_time * _of_all(median, [step.rise_samples for step in response.steps])


def _settling_time(response: Response) -> float:
    return response.sampling_time * _of_all(max, [step.settling_samples for step in response.steps])


def _anticipation(response: Response) -> float:
    known = [n for step in response.steps if not math.isnan(n := step.anticipation_samples)]
    return response.sampling_time * _of_all(max, known)


_Any = (
    Metric[Response]
    | Metric[BandResponse]
    | Metric[Actuation]
    | Metric[WholeRun]
    | Metric[Charged]
    | Metric[KeyFigures]
    | Metric[StepTimes]
)
METRICS: dict[str, _Any] = {
    "mean_abs_error": Metric(
        Response,
        "Mean absolute error",
        "mean of |reference - output| over the samples",
        lambda r: r.total / max(r.magnitude.size, 1),
        of_band="Mean distance to the band",
    ),
    "rmse": Metric(
        Response,
        "RMSE",
        "root mean square of reference - output",
        lambda r: _rms(r.error),
        of_band="RMS distance to the band",
    ),
    "sum_abs_error": Metric(
        Response,
        "Sum of absolute errors",
        "sum of |reference - output| over the samples, as in the paper",
        lambda r: r.total,
        shown=(),
    ),
    "iae": Metric(
        Response,
        "IAE",
        "integral of |reference - output| over time",
        lambda r: r.total * r.sampling_time,
        "difference.s",
        shown=(),
    ),
    "min_abs_error": Metric(
        Response,
        "Minimum absolute error",
        "smallest |reference - output|",
        lambda r: _smallest(r.magnitude),
        shown=(),
    ),
    "max_abs_error": Metric(
        Response,
        "Maximum absolute error",
        "largest |reference - output|",
        lambda r: _largest(r.magnitude),
        shown=(),
    ),
    "settled_error": Metric(
        Response,
        "Settled error",
        "magnitude of the mean error over the last fifth of the window of a constant reference, the largest",
        _settled_error,
        if_held=True,
        exists=_has_steps,
    ),
    "settled_share": Metric(
        Response,
        "Settled error of the step",
        "settled error of a window over the step that leads to it, the largest",
        _settled_share,
        "%",
        if_held=True,
        exists=_has_steps,
        shown=(),
    ),
    "overshoot": Metric(
        Response,
        "Overshoot",
        "largest excursion beyond the new reference in the window after a step, of the step",
        _overshoot,
        "%",
        if_held=True,
        exists=_has_steps,
        shown=("report",),
    ),
    "rise_time": Metric(
        Response,
        "Rise time",
        "median time after a step until the output is first at 90 % of it; NaN if one is not reached",
        _rise_time,
        "s",
        if_held=True,
        exists=_has_steps,
        shown=("report",),
    ),
    "settling_time": Metric(
        Response,
        "Settling time",
        "longest time after a step until the output stays within 5 % of it; NaN if it does not",
        _settling_time,
        "s",
        if_held=True,
        exists=_has_steps,
        shown=("report",),
    ),
    "anticipation": Metric(
        Response,
        "Anticipation",
        "longest time before a step at which the output has left 5 % of the step around its old value",
        _anticipation,
        "s",
        better="",
        if_held=True,
        exists=_has_steps,
        shown=("report",),
    ),
    "band_violation": Metric(
        BandResponse,
        "Discomfort",
        "integral of the distance to the band over time",
        lambda r: r.total * r.sampling_time / _HOUR,
        "difference.h",
    ),
    "band_violation_time": Metric(
        BandResponse,
        "Time outside the band",
        "time of samples with the output outside its band",
        lambda r: float(np.count_nonzero(r.magnitude)) * r.sampling_time / _HOUR,
        "h",
        shown=("report",),
    ),
    "band_violation_max": Metric(
        BandResponse,
        "Largest distance to the band",
        "how far the output got out of its band",
        lambda r: _largest(r.magnitude),
        over_seeds="largest",
        shown=("report",),
    ),
    "bound_violation_max": Metric(
        Response,
        "Constraint violation",
        "how far the output went beyond its limits",
        lambda r: _largest(r.beyond),
        over_seeds="largest",
        shown=("report",),
    ),
    "bound_violation_time": Metric(
        Response,
        "Time of constraint violation",
        "time of samples with the output beyond its limits",
        lambda r: float(np.count_nonzero(r.beyond)) * r.sampling_time,
        "s",
        shown=(),
    ),
    "limits_kept": Metric(
        Response,
        "Limits kept",
        "share of the samples with the output within its limits; NaN without limits",
        _limits_kept,
        "%",
        better="high",
        shown=(),
    ),
    "max_abs_input": Metric(
        Actuation,
        "Peak input",
        "largest |input|",
        lambda a: _largest(a.magnitude),
        "value",
        better="",
        shown=("terminal",),
    ),
    "max_abs_change": Metric(
        Actuation,
        "Peak input change",
        "largest |change of the input| from sample to sample",
        lambda a: _largest(a.change),
        shown=(),
    ),
    "rms_change": Metric(
        Actuation,
        "RMS input change",
        "root mean square change of the input from sample to sample",
        lambda a: _rms(a.change),
        shown=(),
    ),
    "total_variation": Metric(
        Actuation,
        "Total variation",
        "sum of |change of the input|",
        lambda a: float(np.add.reduce(a.change)),
        shown=("report",),
    ),
    "time_at_bounds": Metric(
        Actuation,
        "Time in saturation",
        "time of samples with the input at a limit",
        _time_at_bounds,
        "s",
        better="",
        shown=(),
    ),
    "cost": Metric(
        WholeRun,
        "Cost",
        "sum over the samples of the weighted squares of errors, inputs and input changes",
        WholeRun.cost,
        "1",
    ),
    "money": Metric(
        Charged,
        "Money",
        "integral of the prices times what is paid for over time",
        lambda c: c.total(c.price),
        "money",
    ),
    "energy": Metric(
        Charged,
        "Energy",
        "integral over time of what is paid for, where that is energy",
        Charged.total_energy,
        "kWh",
        exists=lambda c: c.has_energy,
    ),
    "emissions": Metric(
        Charged,
        "Emissions",
        "integral over time of what is emitted by what is paid for",
        lambda c: c.total(c.emission),
        "kg",
        exists=lambda c: c.has_emissions,
    ),
    "peak": Metric(
        Charged,
        "Peak power",
        "largest mean power of all energy that is paid for over 15 minutes, counted from the run's start",
        Charged.peak,
        "kW",
        exists=lambda c: c.has_energy,
    ),
    "tdis_tot": Metric(
        KeyFigures,
        "Thermal discomfort",
        "integral of the temperatures' distance to their band over time, the mean of all zones",
        KeyFigures.thermal_discomfort,
        "K.h",
        exists=lambda f: f.has(*TEMPERATURES),
    ),
    "idis_tot": Metric(
        KeyFigures,
        "Air quality discomfort",
        "integral of CO2 above its upper limit over time, the mean of all zones",
        KeyFigures.air_discomfort,
        "ppm.h",
        exists=lambda f: f.has(CO2),
    ),
    "ener_tot": Metric(
        KeyFigures,
        "Energy per area",
        "integral of all powers over time, per floor area",
        KeyFigures.energy,
        "kWh/m2",
        exists=lambda f: f.has(*POWERS),
    ),
    "cost_tot": Metric(
        KeyFigures,
        "Cost per area",
        "integral of the prices times powers and fresh water over time, per floor area",
        KeyFigures.cost,
        "money/m2",
        exists=lambda f: bool(f.money) and f.has(*POWERS, WATER),
    ),
    "emis_tot": Metric(
        KeyFigures,
        "Emissions per area",
        "integral of what all powers emit over time, per floor area",
        KeyFigures.emissions,
        "kg/m2",
        exists=lambda f: f.has_emissions and f.has(*POWERS),
        shown=("report",),
    ),
    "pele_tot": Metric(
        KeyFigures,
        "Peak electric power per area",
        "largest mean of all electric power over 15 minutes, per floor area",
        lambda f: f.peak(ELECTRIC),
        "kW/m2",
        exists=lambda f: f.has(ELECTRIC),
        shown=("report",),
    ),
    "pgas_tot": Metric(
        KeyFigures,
        "Peak gas power per area",
        "largest mean of all gas power over 15 minutes, per floor area",
        lambda f: f.peak(GAS),
        "kW/m2",
        exists=lambda f: f.has(GAS),
        shown=("report",),
    ),
    "pdih_tot": Metric(
        KeyFigures,
        "Peak district heating per area",
        "largest mean of all district heating power over 15 minutes, per floor area",
        lambda f: f.peak(DISTRICT_HEATING),
        "kW/m2",
        exists=lambda f: f.has(DISTRICT_HEATING),
        shown=("report",),
    ),
    "time_rat": Metric(
        StepTimes,
        "Computational time ratio",
        "mean wall-clock time of a controller step over the sampling time",
        lambda s: _mean(s.times) / s.sampling_time,
        "1",
        exists=lambda s: s.has_key_figures,
        shown=("report",),
    ),
    "atvl_tot": Metric(
        KeyFigures,
        "Actuator travel",
        "sum of |change of an actuator|, the mean of all",
        KeyFigures.travel,
        "1",
        shown=("report",),
    ),
    "solve_time_mean": Metric(
        StepTimes,
        "Mean step time",
        "mean wall-clock time of a controller step",
        lambda s: _mean(s.times),
        "s",
        shown=(),
    ),
    "solve_time_median": Metric(
        StepTimes,
        "Median step time",
        "median wall-clock time of a controller step",
        lambda s: _percentile(s.times, 50),
        "s",
        shown=("report",),
    ),
    "solve_time_p95": Metric(
        StepTimes,
        "95th-percentile step time",
        "95th percentile of the wall-clock time of a controller step",
        lambda s: _percentile(s.times, 95),
        "s",
        shown=(),
    ),
    "solve_time_p99": Metric(
        StepTimes,
        "99th-percentile step time",
        "99th percentile of the wall-clock time of a controller step",
        lambda s: _percentile(s.times, 99),
        "s",
        shown=("report",),
    ),
    "solve_time_max": Metric(
        StepTimes,
        "Longest step time",
        "longest wall-clock time of a controller step",
        lambda s: _largest(s.times),
        "s",
        over_seeds="largest",
        shown=("report",),
    ),
    "deadline_misses": Metric(
        StepTimes,
        "Deadline misses",
        "steps longer than the sampling time",
        lambda s: s.misses,
        "1",
        over_seeds="total",
        shown=("report",),
    ),
    "failures": Metric(
        StepTimes,
        "Steps with a fallback",
        "steps with a substitute for the input",
        lambda s: float(s.fallbacks),
        "1",
        over_seeds="total",
        shown=("report",),
    ),
    "samples": Metric(
        StepTimes, "Samples", "rows of the trace", lambda s: float(s.rows), "1", better="", shown=()
    ),
}
"""The built-in metrics, in the order of files and tables."""
