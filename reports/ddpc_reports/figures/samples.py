"""The samples that the figures draw: first seed, display units, one table for each signal."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median_low

import numpy as np

from ddpc_cosim import FloatArray, Trace, Variable
from ddpc_reports.comparison import Condition, ControllerResults
from ddpc_reports.numbers import difference_symbol, unit_symbol

_DIGITS = 6
_FAR = 5.0
_MOST_SAID, _MOST_DRAWN = 4, 200
Column = list[float | None]


@dataclass(frozen=True)
class Signal:
    """One output, input, or change of an input, for all controllers: what one row of a figure draws.

    Parameters
    ----------
    id : str
        Name of the data set in the page.
    title : str
        Signal and unit, for the axis.
    unit : str
        Unit symbol.
    columns : dict
        ``t`` [s], ``r`` (the reference, if there is one) and one column ``c<index>`` for each controller.
    scaled_by : tuple of str
        Columns of controllers that set the range of the axis.
    limits : tuple of float
        Limits that the axis should show because the samples come near them.
    held : bool
        Values hold until the next sample.
    own_range : bool
        Every panel has its own range; otherwise all panels share one, so that they compare.
    """

    id: str
    title: str
    unit: str
    columns: dict[str, Column]
    scaled_by: tuple[str, ...]
    limits: tuple[float, ...] = ()
    held: bool = False
    own_range: bool = False

    @property
    def has_reference(self) -> bool:
        """Whether there is a reference to draw."""
        return "r" in self.columns

    @property
    def end(self) -> tuple[float, float]:
        """First and last time [s]."""
        times = [value for value in self.columns["t"] if value is not None]
        if not times:
            return (0.0, 1.0)
        return (times[0], times[-1]) if len(times) > 1 else (times[0] - 0.5, times[0] + 0.5)

    def scaling(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the columns that set the range of the axis of a panel with these controllers."""
        asked = names if self.own_range else [name for name in self.columns if name.startswith("c")]
        return tuple(name for name in asked if name in self.scaled_by) or tuple(asked)

    def extent(self, names: Sequence[str]) -> tuple[float, float]:
        """Return the range of the axis of a panel with these controllers, with a margin."""
        columns = [*self.scaling(names), *(["r"] if self.has_reference else [])]
        shown = [*self.limits, *(value for name in columns for value in known(self.columns[name]))]
        low, high = min(shown, default=0.0), max(shown, default=1.0)
        margin = 0.05 * (high - low) or 0.1 * abs(high) or 1.0
        return (low - margin, high + margin)


@dataclass(frozen=True)
class FirstSeed:
    """The signals of all controllers at the first seed of a condition."""

    outputs: list[Signal] = field(default_factory=list)
    inputs: list[Signal] = field(default_factory=list)
    changes: list[Signal] = field(default_factory=list)


def column_name(controller: ControllerResults) -> str:
    """Return the name of a controller's column, which is also the name of its colour."""
    return f"c{controller.index}"


def first_seed(condition: Condition, prefix: str) -> FirstSeed:
    """Read the traces of the first seed and return their signals."""
    found = condition.first_traces
    traces = {column_name(one): found[one.key] for one in condition.controllers if one.key in found}
    if not traces:
        return FirstSeed()
    runs = _Runs(traces, max(traces.values(), key=len), trusted(traces))
    return FirstSeed(
        [_level(runs, i, f"{prefix}y{i}", is_input=False) for i in range(len(runs.longest.outputs))],
        [_level(runs, i, f"{prefix}u{i}", is_input=True) for i in range(len(runs.longest.inputs))],
        [_change(runs, i, f"{prefix}d{i}") for i in range(len(runs.longest.inputs))],
    )


@dataclass(frozen=True)
class Said:
    """What controllers said of their steps at the first seed of a condition.

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


def said(condition: Condition, prefix: str) -> Said:
    """Read ``Trace.info`` of the first seed and return it as signals; none where nothing was said."""
    found = condition.first_traces
    traces = {column_name(one): found[one.key] for one in condition.controllers if one.key in found}
    names = list(dict.fromkeys(name for trace in traces.values() for name in trace.info))
    if not names:
        return Said([], 1, 0)
    longest, scaled_by = max(traces.values(), key=len), trusted(traces)
    every = -(-len(longest) // _MOST_DRAWN)
    signals = []
    for i, name in enumerate(names[:_MOST_SAID]):
        columns = {"t": rounded(longest.time[::every])}
        told = {key: trace.info[name] for key, trace in traces.items() if name in trace.info}
        columns |= {key: rounded(values[::every]) for key, values in told.items()}
        signals.append(Signal(f"{prefix}i{i}", name, "", columns, scaled_by, own_range=True))
    return Said(signals, every, len(names) - len(signals))


@dataclass(frozen=True)
class _Runs:
    """The runs by column, the longest of them, and those that set the ranges of the axes."""

    traces: dict[str, Trace]
    longest: Trace
    trusted: tuple[str, ...]


def trusted(traces: Mapping[str, Trace]) -> tuple[str, ...]:
    """Return the runs that set the ranges of the axes: completed, if any, and not out of all proportion.

    One run that falls over, though it reaches its last sample, would flatten all others to a line.
    """
    completed = {key: trace for key, trace in traces.items() if trace.completed} or dict(traces)
    outputs = range(len(next(iter(completed.values())).outputs))
    lost = {key for i in outputs for key in _lost(completed, i)}
    return tuple(key for key in completed if key not in lost) or tuple(completed)


def _lost(traces: Mapping[str, Trace], i: int) -> list[str]:
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
    longest, bounds = runs.longest, runs.longest.bounds
    variable = (longest.inputs if is_input else longest.outputs)[i]
    ends = (bounds.u_min, bounds.u_max) if is_input else (bounds.y_min, bounds.y_max)
    columns = {"t": rounded(longest.time)}
    if not is_input:
        columns["r"] = _shown(variable, longest.reference[:, i])
    for key, trace in runs.traces.items():
        columns[key] = _shown(variable, (trace.u if is_input else trace.y)[:, i])
    limits = _near(runs, columns, variable, [end[i] for end in ends])
    unit = unit_symbol(variable.shown_in.name)
    title = level_title(variable, unit)
    return Signal(name, title, unit, columns, runs.trusted, limits, held=is_input)


def _change(runs: _Runs, i: int, name: str) -> Signal:
    variable = runs.longest.inputs[i]
    columns = {"t": rounded(runs.longest.time)}
    for key, trace in runs.traces.items():
        # Before the first sample the input stood at its value at rest, as far as the limits allow.
        rest = np.clip(variable.start, trace.bounds.u_min[i], trace.bounds.u_max[i])
        columns[key] = rounded(np.diff(trace.u[:, i], prepend=rest) * variable.shown_in.factor)
    unit = difference_symbol(variable.shown_in.name)
    title = _title(f"change of {_words(variable)}", unit)
    # One jump at the start would flatten every other panel.
    return Signal(name, title, unit, columns, runs.trusted, held=True, own_range=True)


def _near(
    runs: _Runs, columns: dict[str, Column], variable: Variable, limits: Sequence[float]
) -> tuple[float, ...]:
    """Return the limits that lie so close to the samples that showing them does not squeeze these."""
    shown = [float(variable.shown_in.from_unit(np.array(limit))) for limit in limits if math.isfinite(limit)]
    drawn = [value for key in ("r", *runs.trusted) for value in known(columns.get(key, []))]
    if not drawn:
        return ()
    low, high = min(drawn), max(drawn)
    margin = 0.25 * (high - low)
    return tuple(limit for limit in shown if low - margin <= limit <= high + margin)


def known(column: Sequence[float | None]) -> list[float]:
    """Return the values of a column that exist."""
    return [value for value in column if value is not None]


def level_title(variable: Variable, unit: str) -> str:
    """Return the title of the axis of a signal."""
    return _title(_words(variable), unit)


def _words(variable: Variable) -> str:
    return variable.name.replace("_", " ")


def _title(name: str, unit: str) -> str:
    return f"{name} / {unit}" if unit else name


def _shown(variable: Variable, values: FloatArray) -> Column:
    return rounded(variable.shown_in.from_unit(values))


def rounded(values: FloatArray) -> Column:
    """Return values as the page holds them: six digits, None for what is not finite."""
    return [float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None for value in values.tolist()]
