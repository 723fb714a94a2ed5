"""Vega-Lite specifications of signals over time: lines, bands over the seeds, limits, what happens when."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from ddpc_reports.figures.charts import LABEL_ROOM, LABELS, Spec, colours_of, dashes_of, field, layer
from ddpc_reports.figures.clock import Clock
from ddpc_reports.figures.signal import BAND, LOWER, UPPER, Given, Signal

WIDE, NARROW = 1000, 480
"""Widths of a drawing that has the page to itself, and of one beside others [px]."""
LABELS_FROM = 22
"""Above the chart, where the title of the axis ends [px]."""
_LETTER, MARK_ROW = 5.6, 14
"""Width of a letter of a mark's label, about, and height of a row of these [px]."""
_MOST_LABEL_ROWS, _LEAST_LABEL = 3, 18
_LONG_TIMES = "format(datum.value, '~f')"
_VALUE_LABELS = (
    "datum.value !== 0 && (abs(datum.value) >= 1e5 || abs(datum.value) < 1e-3)"
    " ? replace(format(datum.value, '~e'), 'e+', 'e') : " + LABELS
)


class Mark(NamedTuple):
    """Something that happens during a run: its label, and from when to when [s], which may be an instant."""

    label: str
    begin: float
    end: float


def time_chart(
    signal: Signal,
    names: Sequence[str],
    sampling_time: float,
    marks: Sequence[Mark] = (),
    size: tuple[int, int] = (WIDE, 200),
) -> Spec:
    """Return the chart of one signal over time, for the controllers of one panel.

    Parameters
    ----------
    signal : Signal
        What is drawn.
    names : sequence of str
        Columns of the controllers in this panel, the one drawn first at the back; there may be none.
    sampling_time : float
        Time between samples [s]; the chart is in the unit of the signal's clock.
    marks : sequence of Mark
        What happens at an instant or during a span of time.
    size : tuple of int
        Width of the static drawing and height [px].
    """
    clock = signal.clock
    within = _within(clock.of(sampling_time))
    marks = [mark._replace(begin=clock.of(mark.begin), end=clock.of(mark.end)) for mark in marks]
    ticks = 8 if size[0] > NARROW else 6
    x = {
        **field("t", None),
        "scale": {"domain": list(signal.end), "domainRaw": {"expr": "span"}, "nice": False},
        "axis": {
            **({"values": {"expr": _TICKS}} if clock.ticks else {"tickCount": ticks}),
            "grid": False,
            "labelExpr": f"{_LONG_TIMES if clock.ticks else LABELS} + '\u202f{clock.unit}'",
        },
    }
    layers = [
        *(_wanted_band(signal, x, within) if signal.has_band else []),
        *_limits(signal),
        *_zero(signal),
        *_marks(label_rows(marks, signal.end, size[0]), x),
        _band(x),
        *_spread(signal, names, x),
        *([_reference(signal, x, within)] if signal.has_reference else []),
        *(_given(signal, given, x, within) for given in signal.given),
        *([_lines(signal, names, x, within)] if names else []),
        *_reading(signal, names, x),
    ]
    parameters = {"span": None, "band": None, "at": None, "hidden": [], "extent": list(signal.extent(names))}
    return {
        "layer": layers,
        "width": size[0],
        "height": size[1],
        "params": [
            *({"name": name, "value": value} for name, value in parameters.items()),
            *(_tick_parameters(clock, signal.end, ticks) if clock.ticks else []),
        ],
    }


_TICKS = "sequence(ceil(shown[0] / tick) * tick, shown[1] + tick / 1000, tick)"


def _tick_parameters(clock: Clock, ends: tuple[float, float], most: int) -> list[Spec]:
    """Return the time shown and the step of its ticks: of hours and days, those of ten suit nobody."""
    shown = f"span || [{ends[0]:.10g}, {ends[1]:.10g}]"
    choices = [f"shown[1] - shown[0] <= {most * step:g} ? {step:g} : " for step in clock.ticks]
    tick = f"{''.join(choices)}{clock.ticks[-1]:g}"
    return [{"name": "shown", "expr": shown}, {"name": "tick", "expr": tick}]


def _within(spacing: float) -> Spec:
    """Keep what is in the time shown, and a sample more on both sides, so that lines reach the edge."""
    margin = f"{1.01 * spacing:g}"
    return {"filter": f"span == null || (datum.t >= span[0] - {margin} && datum.t <= span[1] + {margin})"}


def _y(signal: Signal, name: str = "value") -> Spec:
    return {
        **field(name, signal.title),
        "scale": {"domainRaw": {"expr": "extent"}, "zero": False, "nice": False},
        "axis": {"minExtent": LABEL_ROOM, "maxExtent": LABEL_ROOM, "labelExpr": _VALUE_LABELS},
    }


def _folded(names: Sequence[str]) -> list[Spec]:
    return [
        {"fold": list(names), "as": ["key", "value"]},
        {"filter": "isValid(datum.value) && indexof(hidden, datum.key) < 0"},
    ]


def _near(*names: str) -> list[Spec]:
    """Draw lines that leave the chart to a little beyond its edge: their boxes would cover texts around."""
    reach = "0.15 * (extent[1] - extent[0])"
    within = f"extent[0] - {reach}, extent[1] + {reach}"
    return [{"calculate": f"clamp(datum['{name}'], {within})", "as": name} for name in names]


def _in_span(*names: str) -> list[Spec]:
    """Draw spans of time to the edges of the time shown: beyond, their boxes would cover texts around."""
    return [
        {"calculate": f"span == null ? datum.{name} : clamp(datum.{name}, span[0], span[1])", "as": name}
        for name in names
    ]


def _lines(signal: Signal, names: Sequence[str], x: Spec, within: Spec) -> Spec:
    shape = "step-after" if signal.held else "linear"
    return layer(
        {"type": "line", "clip": True, "strokeWidth": 1.6, "interpolate": shape},
        {"x": x, "y": _y(signal), "color": colours_of(names), "strokeDash": dashes_of(names)},
        signal.id,
        *_folded(names),
        *_near("value"),
        within,
    )


def _reference(signal: Signal, x: Spec, within: Spec) -> Spec:
    line = {"type": "line", "clip": True, "strokeWidth": 1, "interpolate": "step-after", "opacity": 0.75}
    return layer(line | {"color": "var(--ink)"}, {"x": x, "y": _y(signal, "r")}, signal.id, within)


def _wanted_band(signal: Signal, x: Spec, within: Spec) -> list[Spec]:
    """Fill between the edges that an output is wanted between, and draw them as thin lines."""
    held = {"interpolate": "step-after", "clip": True, "color": "var(--ink)"}
    edges = Given((LOWER, UPPER), "", width=0.8)
    place = {"x": x, "y": _y(signal, LOWER), "y2": {"field": UPPER}}
    fill = {"type": "area", "opacity": 0.09, **held}
    return [layer(fill, place, signal.id, *_near(LOWER, UPPER), within), _given(signal, edges, x, within)]


def _given(signal: Signal, given: Given, x: Spec, within: Spec) -> Spec:
    """Draw the lines of what is not a controller's."""
    line = {
        "type": "line",
        "clip": True,
        "strokeWidth": given.width,
        "color": given.colour,
        "interpolate": "step-after" if given.held else "linear",
        **({"strokeDash": list(given.dashes)} if given.dashes else {}),
    }
    place = {"x": x, "y": _y(signal), "detail": field("key", None, "nominal")}
    columns = {"fold": list(given.columns), "as": ["key", "value"]}
    return layer(line, place, signal.id, columns, {"filter": "isValid(datum.value)"}, *_near("value"), within)


def _limits(signal: Signal) -> list[Spec]:
    """Rule the limits, each with its words at the right end, on the side away from the samples."""
    if not signal.limits:
        return []
    middle = sum(signal.extent([])) / 2
    rows = [
        {"value": limit, "label": words, "above": limit > middle} for limit, words in signal.limits.items()
    ]
    rule = {"type": "rule", "color": "var(--limit)", "strokeDash": [3, 3]}
    words = {
        "type": "text",
        "align": "right",
        "fontSize": 10,
        "color": "var(--limit)",
        "baseline": {"expr": "datum.above ? 'bottom' : 'top'"},
        "dy": {"expr": "datum.above ? -1 : 2"},
        "limit": {"expr": "width"},
    }
    named = {"x": {"value": "width"}, "y": _y(signal), "text": field("label", None, "nominal")}
    inside = {"filter": "datum.value >= extent[0] && datum.value <= extent[1]"}
    return [layer(rule, {"y": _y(signal)}, rows, inside), layer(words, named, rows, inside)]


def _zero(signal: Signal) -> list[Spec]:
    """Rule the line of no error."""
    rule = {"type": "rule", "color": "var(--ink)", "strokeWidth": 1, "opacity": 0.75}
    return [layer(rule, {"y": _y(signal)}, [{"value": 0}])] if signal.settled is not None else []


class Label(NamedTuple):
    """Where a label stands: its time, from where to where [s] it may reach, its row, the lowest being 0."""

    t: float
    label: str
    begin: float
    end: float
    row: int
    leftwards: bool


def label_rows(
    marks: Sequence[Mark], ends: tuple[float, float], width: float
) -> tuple[list[Label], list[Mark]]:
    """Return where the labels of marks stand, one for all that begin at one time, and the marks.

    Each gets the first row in which it fits, else the one with the most room; there it is clipped so that
    labels never overlap, however wide the chart is drawn.

    Parameters
    ----------
    marks : sequence of Mark
        What happens.
    ends : tuple of float
        First and last time of the chart [s].
    width : float
        Width of the chart [px].
    """
    first, last = ends
    texts: dict[float, str] = {}
    for mark in sorted(marks, key=lambda mark: mark.begin):
        texts[mark.begin] = ", ".join(filter(None, (texts.get(mark.begin), mark.label)))
    rows: list[list[Label]] = []
    reached: list[float] = []
    second = (last - first) / width
    for time, text in texts.items():
        long = _LETTER * second * (len(text) + 2)
        leftwards = time + long > last and time - first > last - time
        begin, end = (max(time - long, first), time) if leftwards else (time, min(time + long, last))
        fitting = [row for row, so_far in enumerate(reached) if so_far <= begin]
        if not fitting and len(rows) < _MOST_LABEL_ROWS:
            fitting, rows, reached = [len(rows)], [*rows, []], [*reached, first]
        row = fitting[0] if fitting else min(range(len(rows)), key=reached.__getitem__)
        rows[row].append(Label(time, text, begin, end, row, leftwards))
        reached[row] = end
    return [label for row in rows for label in _apart(row, first, last)], list(marks)


def _apart(row: Sequence[Label], first: float, last: float) -> list[Label]:
    """Give each label of a row all the time to the next one; two that face each other share it by length."""
    placed = list(row)
    ends = [first, *(_between(a, b) for a, b in pairwise(placed)), last]
    return [
        label._replace(
            begin=ends[i] if label.leftwards else label.t, end=label.t if label.leftwards else ends[i + 1]
        )
        for i, label in enumerate(placed)
    ]


def _between(a: Label, b: Label) -> float:
    if a.leftwards or not b.leftwards:
        return a.t if b.leftwards else b.t
    return a.t + (b.t - a.t) * (len(a.label) + 1) / (len(a.label) + len(b.label) + 2)


def _marks(placed: tuple[list[Label], list[Mark]], x: Spec) -> list[Spec]:
    """Shade spans and rule instants, their labels in rows above the chart."""
    labels, marks = placed
    spans = [{"t": mark.begin, "to": mark.end} for mark in marks if mark.end > mark.begin]
    kept = [{"filter": "span == null || (datum.to > span[0] && datum.t < span[1])"}, *_in_span("t", "to")]
    rules = [label._asdict() for label in labels]
    shade = {"type": "rect", "clip": True, "color": "var(--ink)", "opacity": 0.06}
    rule = {"type": "rule", "strokeWidth": 0.8, "strokeDash": [1, 2], "clip": True}
    soft = {"color": "var(--ink-soft)"}
    room = "(min(scale('x', datum.end), width) - max(scale('x', datum.begin), 0) - 6)"
    words = {
        "type": "text",
        "baseline": "bottom",
        "fontSize": 11,
        **soft,
        "align": {"expr": "datum.leftwards ? 'right' : 'left'"},
        "dx": {"expr": "datum.leftwards ? 1 : -1"},
        "y": {"expr": f"-{LABELS_FROM} - {MARK_ROW} * datum.row"},
        "limit": {"expr": f"max({room}, 1)"},
        "opacity": {"expr": f"{room} < {_LEAST_LABEL} ? 0 : 1"},
    }
    named = {"x": x, "text": {"field": "label", "type": "nominal"}}
    shown = {"filter": "span == null || (datum.t >= span[0] && datum.t <= span[1])"}
    return [
        *([layer(shade, {"x": x, "x2": {"field": "to"}}, spans, *kept)] if spans else []),
        *([layer(rule | soft, {"x": x}, rules, shown), layer(words, named, rules, shown)] if rules else []),
    ]


def _spread(signal: Signal, names: Sequence[str], x: Spec) -> list[Spec]:
    """Fill between the ends of the bands over the seeds, and draw the medians as thin lines."""
    those = [name for name in names if name in signal.band]
    if not those:
        return []
    times = signal.band["t"]
    spacing = (times[1] or 0.0) - (times[0] or 0.0) if len(times) > 1 else 1.0
    held = {"interpolate": "step-after" if signal.held else "linear", "clip": True}
    area = {"type": "area", "opacity": 0.16, **held}
    line = {"type": "line", "strokeWidth": 0.8, "opacity": 0.9, **held}
    ends = [{"calculate": f"datum[datum.key + '{name[0]}']", "as": name} for name in ("low", "high")]
    shared = {"x": x, "color": colours_of(names)}
    layers = [
        layer(area, {**shared, "y": _y(signal, "low"), "y2": {"field": "high"}}),
        layer(line, {**shared, "y": _y(signal)}),
    ]
    steps = [*_folded(those), _within(spacing), *ends, *_near("value", "low", "high")]
    return [{"data": {"name": f"{signal.id}{BAND}"}, "transform": steps, "layer": layers}]


def _band(x: Spec) -> Spec:
    return layer(
        {"type": "rect", "clip": True, "color": "var(--accent)", "opacity": 0.15},
        {"x": x, "x2": {"field": "to"}},
        [{"chosen": 1}],
        {"filter": "band != null"},
        {"calculate": "band[0]", "as": "t"},
        {"calculate": "band[1]", "as": "to"},
        *_in_span("t", "to"),
    )


def _reading(signal: Signal, names: Sequence[str], x: Spec) -> list[Spec]:
    here = {"filter": "datum.t === at"}
    rule = {"type": "rule", "clip": True, "color": "var(--ink-soft)"}
    dots = {"type": "point", "clip": True, "filled": True, "size": 36, "opacity": 1}
    values = {"x": x, "y": _y(signal), "color": colours_of(names)}
    return [
        layer(rule, {"x": x}, signal.id, here),
        *([layer(dots, values, signal.id, here, *_folded(names))] if names else []),
    ]
