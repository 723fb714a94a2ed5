"""The samples that the figures draw: first seed, display units, one table for each signal."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ddpc_cosim import FloatArray, Trace, Variable
from ddpc_reports.comparison import Competitor, Condition
from ddpc_reports.numbers import unit_symbol

_DIGITS = 6
Column = list[float | None]


@dataclass(frozen=True)
class Signal:
    """One output, input, or change of an input, for all competitors: what one row of a figure draws.

    Parameters
    ----------
    id : str
        Name of the data set in the page.
    title : str
        Signal and unit, for the axis.
    unit : str
        Unit symbol.
    columns : dict
        ``t`` [s], ``r`` (the reference, if there is one) and one column ``c<index>`` for each competitor.
    completed : tuple of str
        Columns of competitors that completed; only these set the range of the axis, if there are any.
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
    completed: tuple[str, ...]
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
        return (times[0], times[-1]) if times else (0.0, 1.0)


@dataclass(frozen=True)
class FirstSeed:
    """The signals of all competitors at the first seed of a condition."""

    outputs: list[Signal] = field(default_factory=list)
    inputs: list[Signal] = field(default_factory=list)
    changes: list[Signal] = field(default_factory=list)


def column_name(competitor: Competitor) -> str:
    """Return the name of a competitor's column, which is also the name of its colour."""
    return f"c{competitor.index}"


def first_seed(condition: Condition, prefix: str) -> FirstSeed:
    """Read the traces of the first seed and return their signals."""
    found = condition.first_traces
    traces = {column_name(one): found[one.key] for one in condition.competitors if one.key in found}
    if not traces:
        return FirstSeed()
    longest = max(traces.values(), key=len)
    return FirstSeed(
        [_output(traces, longest, i, f"{prefix}y{i}") for i in range(len(longest.outputs))],
        [_input(traces, longest, i, f"{prefix}u{i}") for i in range(len(longest.inputs))],
        [_change(traces, longest, i, f"{prefix}d{i}") for i in range(len(longest.inputs))],
    )


def _output(traces: dict[str, Trace], longest: Trace, i: int, name: str) -> Signal:
    variable = longest.outputs[i]
    columns = {"t": _listed(longest.time), "r": _shown(variable, longest.reference[:, i])}
    columns |= {key: _shown(variable, trace.y[:, i]) for key, trace in traces.items()}
    limits = (float(longest.bounds.y_min[i]), float(longest.bounds.y_max[i]))
    return _signal(name, variable, _title(variable), columns, traces, limits)


def _input(traces: dict[str, Trace], longest: Trace, i: int, name: str) -> Signal:
    variable = longest.inputs[i]
    columns = {"t": _listed(longest.time)} | {
        key: _shown(variable, trace.u[:, i]) for key, trace in traces.items()
    }
    limits = (float(longest.bounds.u_min[i]), float(longest.bounds.u_max[i]))
    return _signal(name, variable, _title(variable), columns, traces, limits, held=True)


def _change(traces: dict[str, Trace], longest: Trace, i: int, name: str) -> Signal:
    variable = longest.inputs[i]
    columns = {"t": _listed(longest.time)}
    for key, trace in traces.items():
        # Before the first sample the input stood at its value at rest, as far as the limits allow.
        rest = np.clip(variable.start, trace.bounds.u_min[i], trace.bounds.u_max[i])
        columns[key] = _listed(np.diff(trace.u[:, i], prepend=rest) * variable.shown_in.factor)
    signal = _signal(name, variable, _title(variable, "change of "), columns, traces, (), held=True)
    # One jump at the start would flatten every other panel.
    return replace(signal, own_range=True)


def _signal(
    name: str,
    variable: Variable,
    title: str,
    columns: dict[str, Column],
    traces: dict[str, Trace],
    limits: Sequence[float],
    held: bool = False,
) -> Signal:
    completed = tuple(key for key, trace in traces.items() if trace.completed)
    shown = [float(variable.shown_in.from_unit(np.array(limit))) for limit in limits if math.isfinite(limit)]
    drawn = [
        value for key in ("r", *(completed or traces)) for value in columns.get(key, []) if value is not None
    ]
    near = tuple(limit for limit in shown if drawn and _is_near(limit, drawn))
    return Signal(name, title, unit_symbol(variable.shown_in.name), columns, completed, near, held)


def _is_near(limit: float, drawn: Sequence[float]) -> bool:
    """Whether a limit lies so close to the samples that showing it does not squeeze them."""
    low, high = min(drawn), max(drawn)
    margin = 0.25 * (high - low)
    return low - margin <= limit <= high + margin


def _title(variable: Variable, what: str = "") -> str:
    unit = unit_symbol(variable.shown_in.name)
    name = what + variable.name.replace("_", " ")
    return f"{name} / {unit}" if unit else name


def _shown(variable: Variable, values: FloatArray) -> Column:
    return _listed(variable.shown_in.from_unit(values))


def _listed(values: FloatArray) -> Column:
    return [float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None for value in values.tolist()]
