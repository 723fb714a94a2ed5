"""Vega-Lite specifications (Altair): signals over time, strips over seeds, step times, maps.

Colours are CSS variables of the page (``var(--c0)``), so that one specification serves light, dark and print.
Five parameters are driven by the script of the page: ``span`` (the time shown), ``extent`` (the range of the
values), ``band`` (the time being chosen), ``at`` (the sample under the pointer) and ``hidden`` (the
controllers that the reader hid).
"""

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import altair as alt

from ddpc_reports.samples import Signal

DASHES: tuple[tuple[float, ...], ...] = (
    (1, 0),
    (7, 2.5),
    (2, 2),
    (8, 2, 2, 2),
    (12, 3),
    (4, 1.5),
    (8, 2, 2, 2, 2, 2),
    (3, 1.5, 1, 1.5),
)
"""One pattern more than colours, so that many lines run through all pairs of both before one occurs twice."""

COLOURS = 7

LABELS = "replace(datum.label, regexp(',', 'g'), '\u202f')"
"""Labels of an axis with thousands apart as everywhere in the page."""

_VALUE_LABELS = (
    "datum.value !== 0 && (abs(datum.value) >= 1e5 || abs(datum.value) < 1e-3)"
    " ? replace(format(datum.value, '~e'), 'e+', 'e') : " + LABELS
)
_LABEL_ROOM = 44

_MANTISSAS = {
    0.5: (1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9),
    1.2: (1, 2, 3, 5, 7),
    2.5: (1, 2, 5),
    4.5: (1, 3),
    math.inf: (1,),
}
"""First digits of the ticks of a logarithmic axis, by how many decades it spans at most."""
_CELL_WORDS = 38
_GROUPED = "replace(replace(format(datum.value, ',~g'), regexp(',', 'g'), '\u202f'), 'e+', 'e')"
_TIME_LABELS = (
    "datum.value < 1e-6 ? format(datum.value * 1e9, '~g') + ' ns' : "
    "datum.value < 1e-3 ? format(datum.value * 1e6, '~g') + ' µs' : "
    "datum.value < 1 ? format(datum.value * 1e3, '~g') + ' ms' : format(datum.value, '~g') + ' s'"
)


CONFIG: dict[str, Any] = {
    "background": None,
    "font": "-apple-system, 'Segoe UI', Roboto, 'Liberation Sans', Arial, sans-serif",
    "aria": False,
    "view": {"stroke": "var(--rule)", "fill": None},
    "axis": {
        "domain": False,
        "gridColor": "var(--grid)",
        "tickColor": "var(--rule)",
        "tickSize": 4,
        "labelColor": "var(--ink-soft)",
        "labelFontSize": 11,
        "labelPadding": 4,
        "titleColor": "var(--ink)",
        "titleFontSize": 12,
        "titleFontWeight": "normal",
        "titlePadding": 6,
    },
    # The title lies above the axis: upright it would be cut off where the name is longer than the chart high.
    "axisY": {
        "titleAngle": 0,
        "titleAlign": "left",
        "titleBaseline": "bottom",
        "titleX": -_LABEL_ROOM,
        "titleY": -7,
        "titleLimit": 700,
        "tickCount": 5,
    },
}


class Mark(NamedTuple):
    """Something that happens during a run: its label, and from when to when [s], which may be an instant."""

    label: str
    begin: float
    end: float


def colour(index: int) -> str:
    """Return the colour of a controller as a CSS variable."""
    return f"var(--c{index % COLOURS})"


def time_chart(
    signal: Signal,
    names: Sequence[str],
    dashes: dict[str, int],
    sampling_time: float,
    marks: Sequence[Mark],
    last: bool,
) -> Any:
    """Return the chart of one signal over time, for the controllers of one panel.

    Parameters
    ----------
    signal : Signal
        What is drawn.
    names : sequence of str
        Columns of the controllers in this panel, the one drawn first at the back.
    dashes : dict
        Number of the dash pattern of every column.
    sampling_time : float
        Time between samples [s].
    marks : sequence of Mark
        What happens at an instant or during a span of time.
    last : bool
        Whether this is the lowest chart of the figure, which carries the title of the time axis.
    """
    x = (
        alt.X("t:Q")
        .title("time / s" if last else None)
        .scale(domain=list(signal.end), domainRaw=alt.ExprRef("span"), nice=False)
        .axis(tickCount=8, grid=False, labelExpr=LABELS)
    )
    samples = alt.Chart(alt.NamedData(signal.id))
    layers = [
        *_limits(signal),
        *_marks(marks, x),
        _band(x),
        *([_reference(samples, signal, x, sampling_time)] if signal.has_reference else []),
        _lines(samples, signal, names, dashes, x, sampling_time),
        *_reading(samples, signal, names, x),
    ]
    parameters = [alt.param(name=name, value=None) for name in ("span", "band", "at")]
    parameters.append(alt.param(name="hidden", value=[]))
    parameters.append(alt.param(name="extent", value=list(signal.extent(names))))
    return alt.layer(*layers).add_params(*parameters)


def _y(signal: Signal, field: str = "value:Q") -> alt.Y:
    scale = alt.Scale(domainRaw=alt.ExprRef("extent"), zero=False, nice=False)
    axis = alt.Axis(minExtent=_LABEL_ROOM, maxExtent=_LABEL_ROOM, labelExpr=_VALUE_LABELS)
    return alt.Y(field).title(signal.title).scale(scale).axis(axis)


def _within(sampling_time: float) -> str:
    """Filter for the time shown, one sample more on both sides so that lines reach the edge."""
    margin = 1.01 * sampling_time
    return f"span == null || (datum.t >= span[0] - {margin:g} && datum.t <= span[1] + {margin:g})"


def _folded(samples: alt.Chart, names: Sequence[str]) -> Any:
    folded = samples.transform_fold(list(names), as_=["key", "value"])
    return folded.transform_filter("isValid(datum.value) && indexof(hidden, datum.key) < 0")


def _colours(names: Sequence[str]) -> alt.Color:
    return (
        alt.Color("key:N")
        .legend(None)
        .scale(domain=list(names), range=[colour(int(name[1:])) for name in names])
    )


def _lines(
    samples: alt.Chart,
    signal: Signal,
    names: Sequence[str],
    dashes: dict[str, int],
    x: alt.X,
    sampling_time: float,
) -> Any:
    dash = (
        alt.StrokeDash("key:N")
        .legend(None)
        .scale(domain=list(names), range=[list(DASHES[dashes[name] % len(DASHES)]) for name in names])
    )
    return (
        _folded(samples, names)
        .transform_filter(_within(sampling_time))
        .mark_line(clip=True, strokeWidth=1.6, interpolate="step-after" if signal.held else "linear")
        .encode(x=x, y=_y(signal), color=_colours(names), strokeDash=dash)
    )


def _reference(samples: alt.Chart, signal: Signal, x: alt.X, sampling_time: float) -> Any:
    return (
        samples.transform_filter(_within(sampling_time))
        .mark_line(clip=True, strokeWidth=1, interpolate="step-after", color="var(--ink)", opacity=0.75)
        .encode(x=x, y=_y(signal, "r:Q"))
    )


def _limits(signal: Signal) -> list[Any]:
    if not signal.limits:
        return []
    rows = alt.InlineData(values=[{"value": limit} for limit in signal.limits])
    return [alt.Chart(rows).mark_rule(color="var(--limit)", strokeDash=[3, 3]).encode(y=_y(signal))]


def _marks(marks: Sequence[Mark], x: alt.X) -> list[Any]:
    """Shade spans and rule instants, their labels at the upper edge: once for all that begin at one time."""
    labels: dict[float, str] = {}
    for mark in marks:
        labels[mark.begin] = ", ".join(filter(None, (labels.get(mark.begin), mark.label)))
    spans = [{"t": mark.begin, "to": mark.end} for mark in marks if mark.end > mark.begin]
    rules = [{"t": time, "label": label} for time, label in labels.items()]
    shade = alt.Chart(alt.InlineData(values=spans)).mark_rect(clip=True, color="var(--ink)", opacity=0.06)
    named = alt.Chart(alt.InlineData(values=rules))
    rule = named.mark_rule(clip=True, color="var(--ink-soft)", strokeWidth=0.8, strokeDash=[1, 2])
    words = named.mark_text(
        clip=True, align="left", baseline="top", dx=3, dy=3, fontSize=11, color="var(--ink-soft)"
    )
    return [
        *([shade.encode(x=x, x2=alt.X2("to:Q"))] if spans else []),
        *([rule.encode(x=x), words.encode(x=x, y=alt.value(0), text="label:N")] if rules else []),
    ]


def _band(x: alt.X) -> Any:
    chosen = alt.Chart(alt.InlineData(values=[{"chosen": 1}])).transform_filter("band != null")
    placed = chosen.transform_calculate(t="band[0]", to="band[1]")
    return placed.mark_rect(clip=True, color="var(--accent)", opacity=0.15).encode(x=x, x2=alt.X2("to:Q"))


def _reading(samples: alt.Chart, signal: Signal, names: Sequence[str], x: alt.X) -> list[Any]:
    rule = (
        samples.transform_filter("datum.t === at").mark_rule(clip=True, color="var(--ink-soft)").encode(x=x)
    )
    dots = (
        _folded(samples.transform_filter("datum.t === at"), names)
        .mark_point(clip=True, filled=True, size=36, opacity=1)
        .encode(x=x, y=_y(signal), color=_colours(names))
    )
    return [rule, dots]


def spread_chart(rows: list[dict[str, Any]], title: str, logarithmic: bool) -> Any:
    """Return a strip of one point per seed for each controller, its median and the first seed marked.

    Parameters
    ----------
    rows : list of dict
        ``label``, ``key``, ``seed``, ``value``, ``first`` (bool), in the order of the controllers.
    title : str
        Metric and unit.
    logarithmic : bool
        Whether the range asks for a logarithmic axis.
    """
    labels, colours = _labels_and_colours(rows)
    x = alt.X("value:Q").title(title)
    if logarithmic:
        x = _logarithmic(x, [row["value"] for row in rows], _GROUPED)
    else:
        x = x.scale(zero=False, nice=True).axis(tickCount=6, labelExpr=LABELS)
    y = alt.Y("label:N", sort=labels).title(None).axis(_row_axis())
    hue = alt.Color("label:N").legend(None).scale(domain=labels, range=colours)
    shown = alt.Chart(alt.InlineData(values=rows)).transform_filter("indexof(hidden, datum.key) < 0")
    seeds = shown.mark_circle(size=34, opacity=0.5).encode(x=x, y=y, color=hue)
    middle = (
        shown.transform_aggregate(value="median(value)", groupby=["label"])
        .mark_tick(thickness=2.5, size=18, color="var(--ink)")
        .encode(x=x, y=y)
    )
    first = (
        shown.transform_filter("datum.first")
        .mark_point(shape="diamond", size=90, filled=False, strokeWidth=1.8, color="var(--ink)")
        .encode(x=x, y=y)
    )
    return _rows_of(alt.layer(seeds, middle, first), len(labels))


def step_time_chart(rows: list[dict[str, Any]], sampling_time: float) -> Any:
    """Return median, 95 %, 99 % and longest step time of each controller, and the sampling time.

    Parameters
    ----------
    rows : list of dict
        ``label``, ``key``, ``figure`` (its name), ``value`` [s], in the order of the controllers.
    sampling_time : float
        Time between samples [s].
    """
    labels, colours = _labels_and_colours(rows)
    figures = list(dict.fromkeys(row["figure"] for row in rows))
    times = [*(row["value"] for row in rows), sampling_time]
    x = _logarithmic(alt.X("value:Q").title("time of one step"), times, _TIME_LABELS)
    y = alt.Y("label:N", sort=labels).title(None).axis(_row_axis())
    hue = alt.Color("label:N").legend(None).scale(domain=labels, range=colours)
    shape = (
        alt.Shape("figure:N")
        .legend(None)
        .scale(domain=figures, range=["circle", "triangle-up", "diamond", "cross"])
    )
    shown = alt.Chart(alt.InlineData(values=rows)).transform_filter("indexof(hidden, datum.key) < 0")
    line = (
        shown.transform_aggregate(low="min(value)", high="max(value)", groupby=["label"])
        .mark_rule(strokeWidth=1.2)
        .encode(x=alt.X("low:Q"), x2=alt.X2("high:Q"), y=y, color=hue)
    )
    points = shown.mark_point(filled=True, size=55, opacity=1).encode(x=x, y=y, color=hue, shape=shape)
    limit = alt.InlineData(values=[{"value": sampling_time}])
    deadline = (
        alt.Chart(limit).mark_rule(color="var(--limit)", strokeDash=[4, 3], strokeWidth=1.5).encode(x=x)
    )
    return _rows_of(alt.layer(deadline, line, points), len(labels))


def _logarithmic(x: alt.X, values: Sequence[float], labels: str) -> alt.X:
    """Give an axis decades, and steps between them where there are few: never a tick without label."""
    low, high = min(values) / 1.25, max(values) * 1.25
    ticks = log_ticks(low, high)
    return x.scale(type="log", domain=[low, high], nice=False).axis(values=ticks, labelExpr=labels)


def log_ticks(low: float, high: float) -> list[float]:
    """Return round numbers from low to high, some four to ten of them where the range allows."""
    decades = math.log10(high / low)
    mantissas = next(choice for most, choice in _MANTISSAS.items() if decades < most)
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks = [float(f"{m}e{k}") for k in exponents for m in mantissas]
    return [tick for tick in ticks if low <= tick <= high]


def heat_chart(rows: list[dict[str, Any]], titles: Sequence[str]) -> Any:
    """Return a map of a metric over one or two settings, the value written into each cell.

    Parameters
    ----------
    rows : list of dict
        ``x``, ``y`` (values of the settings in words), ``value`` (None where there is none), ``shown``
        (the value in words), ``own`` (bool, framed), in the order of the axes.
    titles : sequence of str
        Settings on the vertical and on the horizontal axis.
    """
    across, down = (list(dict.fromkeys(row[side] for row in rows)) for side in ("x", "y"))
    frame: dict[str, Any] = {
        "domain": False,
        "ticks": False,
        "grid": False,
        "labelAngle": 0,
        "labelLimit": 160,
    }
    x = alt.X("x:N", sort=across).title(titles[1]).axis(alt.Axis(**frame, labelOverlap="greedy"))
    y = alt.Y("y:N", sort=down).title(titles[0] or None).axis(alt.Axis(**frame, minExtent=44))
    known = [row["value"] for row in rows if row["value"] is not None]
    best, worst = min(known, default=1.0), max(known, default=1.0)
    kind: Literal["log", "linear"] = "log" if best > 0 else "linear"
    # Small differences stay pale: full shade is for three times the best at least.
    domain = [best, max(worst, 3 * best)]
    shade = alt.Opacity("value:Q").legend(None).scale(type=kind, domain=domain, range=[0.03, 0.5], nice=False)
    cells = alt.Chart(alt.InlineData(values=rows))
    filled = (
        cells.transform_filter("datum.value !== null").mark_rect(color="var(--accent)").encode(x, y, shade)
    )
    framed = (
        cells.transform_filter("datum.own")
        .mark_rect(fill=None, stroke="var(--ink)", strokeWidth=2)
        .encode(x, y)
    )
    # Where a cell is too narrow for its words, pointing at it tells them.
    room = alt.ExprRef(f"width > {_CELL_WORDS * len(across)} ? 1 : 0")
    paint = alt.condition("datum.value === null", alt.value("var(--bad)"), alt.value("var(--ink)"))
    words = cells.mark_text(fontSize=12, opacity=room).encode(x, y, alt.Text("shown:N"), color=paint)
    chart = alt.layer(filled, framed, words).add_params(alt.param(name="hidden", value=[]))
    return chart.properties(height=34 * len(down) + 8)


def _labels_and_colours(rows: list[dict[str, Any]]) -> tuple[list[str], list[str]]:
    indices = {row["label"]: int(row["key"][1:]) for row in rows}
    return list(indices), [colour(index) for index in indices.values()]


def _row_axis() -> alt.Axis:
    """Set the label of a row above its marks, so that long labels cost no width."""
    return alt.Axis(
        labelAlign="left",
        labelPadding=-4,
        labelOffset=-18,
        labelBaseline="middle",
        labelLimit=600,
        labelFontSize=12,
        labelColor="var(--ink)",
        ticks=False,
        grid=True,
        minExtent=0,
        maxExtent=0,
    )


def _rows_of(chart: Any, rows: int) -> Any:
    frameless = alt.ViewBackground(stroke=None)
    return chart.add_params(alt.param(name="hidden", value=[])).properties(
        height=46 * rows + 10, view=frameless
    )
