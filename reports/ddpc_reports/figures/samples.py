"""The samples that the figures draw: first seed and bands over the seeds, display units, a table a signal."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import median_low
from typing import NamedTuple

import numpy as np

from ddpc_cosim import FloatArray, Trace, Variable
from ddpc_cosim.files.texts import clipped
from ddpc_reports.comparison import Condition, ControllerResults
from ddpc_reports.figures.clock import Clock, clock_for
from ddpc_reports.figures.signal import LOWER, UPPER, Column, Given, Signal, known, rounded, times
from ddpc_reports.numbers import difference_symbol, unit_symbol

_BAND_DIGITS = 4
_FAR = 5.0
_MOST_NAMES, _MOST_DRAWN = 4, 200
_MOST_SEEDS, _MOST_ROWS = 20, 200_000
"""Of a band: seeds that are read, and samples of all controllers: these take a second."""
_BAND_POINTS = 150
_QUANTILES, _FEWEST_FOR_QUANTILES = (0.1, 0.9), 10
_THINNEST = 0.004
"""Of the height of a chart, narrower than a line: such a band is not drawn."""
_SETTLED_QUANTILE = 0.95
_FEWEST_CONSTANT = 4
_AT_LIMIT = 0.005
"""Of the range of the samples: from that near a limit counts as reached."""


@dataclass(frozen=True)
class Over:
    """Of which seeds the bands are.

    Parameters
    ----------
    seeds : int
        How many were read.
    left_out : int
        How many were not, to keep the report quick.
    failed : dict of str to int
        By column, how many of those runs failed: these are not in the band.
    is_range : bool
        Whether the bands go from the least to the most; otherwise from quantile to quantile.
    """

    seeds: int = 0
    left_out: int = 0
    failed: dict[str, int] = field(default_factory=dict)
    is_range: bool = False


@dataclass(frozen=True)
class Seen:
    """The signals of all controllers of a condition: first seed, and bands over the seeds."""

    outputs: list[Signal] = field(default_factory=list)
    errors: list[Signal] = field(default_factory=list)
    inputs: list[Signal] = field(default_factory=list)
    changes: list[Signal] = field(default_factory=list)
    over: Over = Over()


def column_name(controller: ControllerResults) -> str:
    """Return the name of a controller's column, which is also the name of its colour."""
    return f"c{controller.index}"


def seen(condition: Condition, prefix: str, *, bands: bool = True) -> Seen:
    """Read the traces of the first seed, and of others for bands, and return their signals."""
    traces = first_runs(condition)
    if not traces:
        return Seen()
    everyone, over = _over_seeds(condition, sum(map(len, traces.values()))) if bands else ({}, Over())
    labels = {column_name(controller): clipped(controller.label) for controller in condition.controllers}
    longest = max(traces.values(), key=len)
    runs = _Runs(traces, longest, trusted(traces), everyone, labels, clock_of(condition))
    outputs, inputs = range(len(runs.longest.outputs)), range(len(runs.longest.inputs))
    return Seen(
        [_level(runs, i, f"{prefix}y{i}", is_input=False) for i in outputs],
        [_error(runs, i, f"{prefix}e{i}") for i in outputs],
        [_level(runs, i, f"{prefix}u{i}", is_input=True) for i in inputs],
        [_change(runs, i, f"{prefix}d{i}") for i in inputs],
        over,
    )


def levels(traces: Mapping[str, Trace], labels: Mapping[str, str], clock: Clock, prefix: str) -> list[Signal]:
    """Return outputs and inputs of runs of one loop; traces and labels are by column."""
    longest = max(traces.values(), key=len)
    runs = _Runs(dict(traces), longest, trusted(traces), {}, dict(labels), clock)
    return [
        *(_level(runs, i, f"{prefix}y{i}", is_input=False) for i in range(len(longest.outputs))),
        *(_level(runs, i, f"{prefix}u{i}", is_input=True) for i in range(len(longest.inputs))),
    ]


def first_outputs(condition: Condition) -> Signal | None:
    """Return the first controlled output of the first seed; None without any."""
    traces = {name: trace for name, trace in first_runs(condition).items() if trace.outputs}
    if not traces:
        return None
    labels = {column_name(controller): clipped(controller.label) for controller in condition.controllers}
    runs = _Runs(traces, max(traces.values(), key=len), trusted(traces), {}, labels, clock_of(condition))
    return _level(runs, 0, "", is_input=False)


def clock_of(condition: Condition) -> Clock:
    """Return the unit of time of the figures of a condition."""
    study = condition.results.study
    section = study.scenarios.get(condition.scenario)
    loop = study.loop if section is None else study.loop.of(section)
    return clock_for(loop.start_time, loop.duration)


def first_runs(condition: Condition) -> dict[str, Trace]:
    """Return the runs of the first seed, by column."""
    traces = condition.first_traces
    return {
        column_name(controller): traces[controller.key]
        for controller in condition.controllers
        if controller.key in traces
    }


def _over_seeds(condition: Condition, rows: int) -> tuple[dict[str, list[Trace]], Over]:
    """Read the runs that did not fail, by column, of as many seeds as there is time for."""
    # Of so many seeds that only figures are kept, the first have samples.
    seeds = condition.seeds[: min(_MOST_SEEDS, _MOST_ROWS // rows)]
    without = {case.seed for case in condition.cases if case.seed in seeds and not case.has_samples}
    seeds = tuple(seed for seed in seeds if seed not in without)
    if len(seeds) < 2:
        return {}, Over()
    runs, failed, firsts = dict[str, list[Trace]](), dict[str, int](), condition.first_traces
    for controller in condition.controllers:
        asked = [case for case in controller.cases if case.seed in seeds]
        name, sound = column_name(controller), [case for case in asked if not case.failed]
        failed[name] = len(asked) - len(sound)
        # Runs whose errors are the same to the last bit are the same, and need not be read.
        if any(len({case.metrics.get(key) for case in sound}) > 1 for key in condition.headline):
            runs[name] = [
                firsts[controller.key] if case is controller.first_case else case.trace() for case in sound
            ]
    few = len(seeds) < _FEWEST_FOR_QUANTILES
    return runs, Over(len(seeds), len(condition.seeds) - len(seeds), failed, few)


@dataclass(frozen=True)
class InfoSignals:
    """What controllers reported of their steps at the first seed of a condition.

    Parameters
    ----------
    signals : list of Signal
        The first few names.
    every : int
        Of how many samples one is kept, so that the page stays small.
    left_out : int
        How many names there are beside these.
    """

    signals: list[Signal]
    every: int
    left_out: int


def info_signals(condition: Condition, prefix: str) -> InfoSignals:
    """Return ``Trace.info`` of the first seed as signals; none where no controller reported any."""
    traces = first_runs(condition)
    names = list(dict.fromkeys(name for trace in traces.values() for name in trace.info))
    if not names:
        return InfoSignals([], 1, 0)
    longest, scaled_by, clock = max(traces.values(), key=len), trusted(traces), clock_of(condition)
    every = -(-len(longest) // _MOST_DRAWN)
    signals = []
    for i, name in enumerate(names[:_MOST_NAMES]):
        columns = {"t": times(longest.time[::every], clock)}
        info = {key: trace.info[name] for key, trace in traces.items() if name in trace.info}
        columns |= {key: rounded(values[::every]) for key, values in info.items()}
        signals.append(Signal(f"{prefix}i{i}", name, "", columns, scaled_by, own_range=True, clock=clock))
    return InfoSignals(signals, every, len(names) - len(signals))


@dataclass(frozen=True)
class _Runs:
    """First runs by column, the longest of them, who sets the ranges of the axes, and runs of all seeds."""

    traces: dict[str, Trace]
    longest: Trace
    trusted: tuple[str, ...]
    everyone: dict[str, list[Trace]]
    labels: dict[str, str]
    clock: Clock

    def times(self) -> Column:
        """Return the times of the longest run."""
        return times(self.longest.time, self.clock)

    def band(
        self, columns: Mapping[str, Column], values_of: Callable[[Trace], FloatArray], *, held: bool
    ) -> dict[str, Column]:
        """Return median and ends of a signal over the seeds, thinned out to what a chart can show."""
        asked = ("r", LOWER, UPPER, *self.trusted)
        drawn = [value for name in asked for value in known(columns.get(name, []))]
        thinnest = _THINNEST * (max(drawn, default=0.0) - min(drawn, default=0.0))
        averaged: dict[str, Column] = {}
        for name, traces in self.everyone.items():
            if len(traces) < 2:
                continue
            values = np.stack([values_of(trace) for trace in traces])
            count = values.shape[1]  # the same of all, as they are complete
            every = -(-count // _BAND_POINTS)
            starts = np.arange(0, count, every)
            middles = starts if held else np.minimum(starts + every // 2, count - 1)
            low, high = band_ends(values)
            low, high = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
            if (high - low).max() > thinnest:
                middle = np.median(values, axis=0)[middles]
                averaged["t"] = times(traces[0].time[middles], self.clock)
                columns_of = zip(("", "l", "h"), (middle, low, high), strict=True)
                averaged |= {name + end: rounded(column, _BAND_DIGITS) for end, column in columns_of}
        return averaged


def band_ends(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the ends of a band over runs, shape (runs, samples): quantiles, or of few runs the range."""
    few = len(values) < _FEWEST_FOR_QUANTILES
    low, high = np.quantile(values, (0.0, 1.0) if few else _QUANTILES, axis=0)
    return low, high


def trusted(traces: Mapping[str, Trace]) -> tuple[str, ...]:
    """Return the runs that set the ranges of the axes: completed, if any, and not out of all proportion.

    One run that falls over, though it reaches its last sample, would flatten all others to a line; and those
    that do not reach it would flatten their reference.
    """
    completed = {key: trace for key, trace in traces.items() if trace.completed}
    asked = completed or dict(traces)
    outputs = range(len(next(iter(asked.values())).outputs))
    astray = {key for i in outputs for key in (_astray(asked, i) if completed else _far_off(asked, i))}
    return tuple(key for key in asked if key not in astray) or tuple(completed)


def _far_off(traces: Mapping[str, Trace], i: int) -> list[str]:
    """Return the runs that swing many times as far as the reference asks them to."""
    asked = {key: np.append(trace.reference[:, i], trace.y[0, i]) for key, trace in traces.items()}
    return [key for key, trace in traces.items() if not np.ptp(trace.y[:, i]) <= _FAR * np.ptp(asked[key])]


def _astray(traces: Mapping[str, Trace], i: int) -> list[str]:
    """Return the runs that swing many times as far as reference and others, and beyond their limits."""
    swings = {key: float(np.ptp(trace.y[:, i])) for key, trace in traces.items()}
    reference = max(float(np.ptp(trace.reference[:, i])) for trace in traces.values())
    usual = max(reference, median_low(swings.values()))
    far = [key for key, swing in swings.items() if not swing <= _FAR * usual]
    return [key for key in far if not _within_limits(traces[key], i)]


def _within_limits(trace: Trace, i: int) -> bool:
    low, high = trace.bounds.y_min[i], trace.bounds.y_max[i]
    bounded = math.isfinite(low) and math.isfinite(high)
    return bool(bounded and (trace.y[:, i] >= low).all() and (trace.y[:, i] <= high).all())


def _level(runs: _Runs, i: int, name: str, *, is_input: bool) -> Signal:
    """Return a controlled output with its reference, or an input."""
    longest = runs.longest
    variable = (longest.inputs if is_input else longest.outputs)[i]

    def shown(trace: Trace) -> FloatArray:
        return variable.shown_in.from_unit((trace.u if is_input else trace.y)[:, i])

    columns = {"t": runs.times()}
    if not is_input and variable.name in longest.bands:
        edges = variable.shown_in.from_unit(longest.band[:, i])
        columns |= {LOWER: rounded(edges[:, 0]), UPPER: rounded(edges[:, 1])}
    elif not is_input:
        columns["r"] = rounded(variable.shown_in.from_unit(longest.reference[:, i]))
    columns |= {key: rounded(shown(trace)) for key, trace in runs.traces.items()}
    limits = _limits(runs, columns, variable, i, is_input=is_input)
    unit = unit_symbol(variable.shown_in.name)
    band = runs.band(columns, shown, held=is_input)
    return Signal(
        name,
        level_title(variable, unit),
        unit,
        columns | limits.columns,
        runs.trusted,
        limits.near,
        limits.far,
        limits.unreached,
        held=is_input,
        band=band,
        clock=runs.clock,
        given=limits.given,
        reach=limits.reach,
    )


def _error(runs: _Runs, i: int, name: str) -> Signal:
    """Return reference minus output."""
    variable = runs.longest.outputs[i]

    def shown(trace: Trace) -> FloatArray:
        return (trace.reference[:, i] - trace.y[:, i]) * variable.shown_in.factor

    errors = {key: shown(trace) for key, trace in runs.traces.items()}
    columns = {"t": runs.times()} | {key: rounded(error) for key, error in errors.items()}
    longest, is_band = runs.longest, variable.name in runs.longest.bands
    if is_band:
        calm = np.logical_and(*(settled_samples(edge, longest.preview) for edge in longest.band[:, i].T))
        step = float(np.mean(np.diff(longest.band[:, i])))
    else:
        calm = settled_samples(longest.reference[:, i], longest.preview)
        reference = longest.reference[:, i]
        moves = np.abs(np.diff(reference, prepend=runs.traces[[*runs.trusted, *runs.traces][0]].y[0, i]))
        step = float(moves.max() if not calm.all() else np.ptp(reference))
    settled = {key: _size(error[calm[: len(error)]]) for key, error in errors.items()}
    unit = difference_symbol(variable.shown_in.name)
    words = _words(variable)
    return Signal(
        name,
        _title(f"distance of {words} to its band" if is_band else f"error of {words}", unit),
        unit,
        columns,
        runs.trusted,
        own_range=True,
        band=runs.band(columns, shown, held=False),
        settled=settled,
        step=step * abs(variable.shown_in.factor),
        clock=runs.clock,
    )


def _size(errors: FloatArray) -> float:
    """Return how large errors are, but for the largest few; 0 of none."""
    known_ones = np.abs(errors[np.isfinite(errors)])
    return float(np.quantile(known_ones, _SETTLED_QUANTILE)) if known_ones.size else 0.0


def settled_samples(reference: FloatArray, preview: int) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":
    """Return which samples lie outside the transients; of a reference that is hardly constant: all.

    They are the second half of each stretch of constant reference, up to where one may see its end coming.
    """
    count = len(reference)
    moves = np.flatnonzero(np.abs(np.diff(reference)) > 1e-9 * np.ptp(reference)) + 1
    edges = [0, *moves.tolist(), count]
    calm = np.zeros(count, dtype=np.bool_)
    for first, end in pairwise(edges):
        last = end if end == count else end - preview
        if last - first >= _FEWEST_CONSTANT:
            calm[(first + last) // 2 : last] = True
    return calm if 4 * calm.sum() >= count else np.ones(count, dtype=np.bool_)


def _change(runs: _Runs, i: int, name: str) -> Signal:
    variable = runs.longest.inputs[i]
    columns = {"t": runs.times()}
    for key, trace in runs.traces.items():
        # Before the first sample the input stood at its value at rest, as far as the limits allow.
        rest = np.clip(variable.start, trace.bounds.u_min[i], trace.bounds.u_max[i])
        columns[key] = rounded(np.diff(trace.u[:, i], prepend=rest) * variable.shown_in.factor)
    unit = difference_symbol(variable.shown_in.name)
    title = _title(f"change of {_words(variable)}", unit)
    # One jump at the start would flatten every other panel.
    return Signal(name, title, unit, columns, runs.trusted, held=True, own_range=True, clock=runs.clock)


class _Limits(NamedTuple):
    """The limits of a signal.

    Parameters
    ----------
    near : dict of float to str
        Constant ones that the samples reach, and whose they are.
    far, unreached : tuple of float
        Those that are reached only by runs that leave the picture, and those that no run reaches.
    columns : dict of str to Column
        Those that change with time and come near.
    given : tuple of Given
        How these are drawn.
    reach : tuple of float
        The least and the largest of their values that come near.
    """

    near: dict[float, str]
    far: tuple[float, ...]
    unreached: tuple[float, ...]
    columns: dict[str, Column]
    given: tuple[Given, ...]
    reach: tuple[float, ...]


def _limits(
    runs: _Runs, columns: dict[str, Column], variable: Variable, i: int, *, is_input: bool
) -> _Limits:
    """Return the limits of all controllers, those that are the same once."""
    constant: dict[float, list[str]] = {}
    moving: dict[tuple[float | None, ...], list[str]] = {}
    for key, trace in runs.traces.items():
        for side in _sides(trace, variable, i, is_input=is_input):
            shown = rounded(np.atleast_1d(variable.shown_in.from_unit(side)))
            if len({*shown}) > 1:
                moving.setdefault(tuple(shown), []).append(runs.labels[key])
            elif shown and shown[0] is not None:
                constant.setdefault(shown[0], []).append(runs.labels[key])
    drawn = [value for key in ("r", LOWER, UPPER, *runs.trusted) for value in known(columns.get(key, []))]
    low, high = min(drawn, default=math.nan), max(drawn, default=math.nan)
    margin = _AT_LIMIT * (high - low)
    everything = [value for key in ("r", *runs.traces) for value in known(columns.get(key, []))]
    least, most = min(everything, default=math.nan) - margin, max(everything, default=math.nan) + margin

    def words(labels: list[str]) -> str:
        return "limit" if len(labels) == len(runs.traces) else f"limit of {', '.join(labels)}"

    def comes_near(limit: float | None) -> bool:
        return limit is not None and low - margin <= limit <= high + margin

    near = {limit: words(labels) for limit, labels in constant.items() if comes_near(limit)}
    over_time = {f"limit{n}": [*course] for n, course in enumerate(moving) if any(map(comes_near, course))}
    beyond = [limit for course in moving if not any(map(comes_near, course)) for limit in known(course)]
    reached = [limit for course in over_time.values() for limit in known(course) if comes_near(limit)]
    outside = sorted({*constant.keys() - near.keys(), *beyond})
    return _Limits(
        near,
        tuple(limit for limit in outside if least <= limit <= most),
        tuple(limit for limit in outside if not least <= limit <= most),
        over_time,
        tuple(
            Given((f"limit{n}",), words(labels), "var(--limit)", (3, 3), scales=False)
            for n, labels in enumerate(moving.values())
            if f"limit{n}" in over_time
        ),
        (min(reached), max(reached)) if reached else (),
    )


def _sides(trace: Trace, variable: Variable, i: int, *, is_input: bool) -> tuple[FloatArray, FloatArray]:
    """Return the lower and the upper limit of a signal in a run, over time if they change."""
    if variable.name in trace.moving_limits:
        limits = (trace.input_limits if is_input else trace.output_limits)[:, i]
        return limits[:, 0], limits[:, 1]
    bounds = trace.bounds
    low, high = (bounds.u_min, bounds.u_max) if is_input else (bounds.y_min, bounds.y_max)
    return low[i : i + 1], high[i : i + 1]


def level_title(variable: Variable, unit: str) -> str:
    """Return the title of the axis of a signal."""
    return _title(_words(variable), unit)


def _words(variable: Variable) -> str:
    return clipped(variable.name.replace("_", " "))


def _title(name: str, unit: str) -> str:
    return f"{name} / {unit}" if unit else name
