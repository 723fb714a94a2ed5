"""Planes of a run: outputs over each other, or an output and its rate, and inputs over outputs."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from ddpc_cosim import FloatArray, Trace, Variable
from ddpc_cosim.files.texts import clipped
from ddpc_reports.comparison import Condition
from ddpc_reports.embedding import drawing
from ddpc_reports.figures.charts import plane_chart
from ddpc_reports.figures.figure import Figure, View, entry
from ddpc_reports.figures.samples import column_name, first_runs, level_title, trusted
from ddpc_reports.figures.time_charts import NARROW
from ddpc_reports.numbers import significant, unit_symbol, with_unit

_MOST_POINTS = 200
"""Of a controller's line: more are not told apart."""


class _Axis(NamedTuple):
    """What an axis shows: its title, its unit symbol, and its values in a run."""

    title: str
    unit: str
    output: int = -1
    input: int = -1
    is_rate: bool = False

    def values(self, trace: Trace) -> FloatArray:
        """Return its samples in display units, shape (K,)."""
        if self.input >= 0:
            return trace.inputs[self.input].shown_in.from_unit(trace.u[:, self.input])
        variable, y = trace.outputs[self.output], trace.y[:, self.output]
        if not self.is_rate:
            return variable.shown_in.from_unit(y)
        rate = np.gradient(y, trace.sampling_time) if len(y) > 1 else np.zeros(len(y))
        return np.asarray(rate * variable.shown_in.factor)


def plane_figure(condition: Condition, prefix: str) -> Figure | None:
    """Return the first two outputs over each other, or one and its rate, and the input over the first.

    Rates are differences of samples: (y_k+1 - y_k-1) / (2 h).
    """
    runs = first_runs(condition).items()
    drawn = {name: run for name, run in runs if len(run) > 1 and run.outputs and run.inputs}
    if not drawn:
        return None
    longest = max(drawn.values(), key=len)
    shown = {*trusted(drawn)} or {*drawn}
    members = [controller for controller in condition.controllers if column_name(controller) in shown]
    views = []
    for number, (x, y) in enumerate(_pairs(longest), 1):
        rows = [
            row
            for controller in members
            for row in _rows(drawn[column_name(controller)], column_name(controller), controller.label, x, y)
        ]
        name = f"{prefix}plane-{number}"
        spec = plane_chart(rows, (x.title, y.title), NARROW)
        description = f"{y.title} over {x.title}: {'; '.join(clipped(member.label) for member in members)}"
        views.append(View(name, "", description, spec, drawing(spec, name, description)))
    away = drawn.keys() - shown
    left = ", ".join(clipped(c.label) for c in condition.controllers if column_name(c) in away)
    caption = (
        f"Phase plane, and input against output, at seed {condition.seeds[0]}; a dot is where a run begins."
        + (" A rate is that between the samples before and after." if len(longest.outputs) < 2 else "")
        + (f" Far away, and left out: {left}." if left else "")
    )
    legend = tuple(entry(member) for member in members)
    return Figure(f"{prefix}planes", "Phase plane", caption, tuple(views), legend, folded=True)


def _pairs(trace: Trace) -> Iterator[tuple[_Axis, _Axis]]:
    first = _level(trace.outputs[0], output=0)
    if len(trace.outputs) > 1:
        yield first, _level(trace.outputs[1], output=1)
    else:
        unit = f"{first.unit or '1'}/s"
        title = f"rate of {first.title.partition(' / ')[0]} / {unit}"
        yield first, _Axis(title, unit, output=0, is_rate=True)
    yield first, _level(trace.inputs[0], input=0)


def _level(variable: Variable, *, output: int = -1, input: int = -1) -> _Axis:
    unit = unit_symbol(variable.shown_in.name)
    return _Axis(level_title(variable, unit), unit, output, input)


def _rows(trace: Trace, key: str, label: str, x: _Axis, y: _Axis) -> Iterator[dict[str, Any]]:
    """Yield the points of a run, of many those that are even along its line: at rest they are one."""
    values = np.stack([x.values(trace), y.values(trace)], axis=1)
    values = values[np.isfinite(values).all(axis=1)]
    if not len(values):  # an input that is left to the plant is not known
        return
    extent = np.ptp(values, axis=0)
    moves = np.diff(values / np.where(extent > 0, extent, 1.0), axis=0)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*moves.T))])
    kept = np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], _MOST_POINTS)).clip(max=len(values) - 1))
    for i, (a, b) in enumerate(values[kept].tolist()):
        row: dict[str, Any] = {"key": key, "x": float(f"{a:.4g}"), "y": float(f"{b:.4g}")}
        if not i:
            start = f"{with_unit(significant(a, 3), x.unit)}, {with_unit(significant(b, 3), y.unit)}"
            row |= {"begins": True, "label": clipped(label), "text": f"{clipped(label)}, from {start}"}
        yield row
