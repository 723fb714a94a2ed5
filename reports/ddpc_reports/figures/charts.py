"""Vega-Lite specifications: strips over seeds, step times, ranks, profiles, maps; what all charts share.

Colours are CSS variables of the page (``var(--c0)``), so that one specification serves light, dark and print.
Five parameters are driven by the script of the page: ``span`` (the time shown), ``extent`` (the range of the
values), ``band`` (the time being chosen), ``at`` (the sample under the pointer) and ``hidden`` (the
controllers that the reader hid). They are written as https://vega.github.io/vega-lite/docs describes them:
a layer of marks, each with its data, what is done to them (``transform``) and what they show (``encoding``).
"""

import math
from collections.abc import Sequence
from typing import Any

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
COLOURS = 7
"""One fewer than patterns, so that numbers run through all pairs of both before one occurs twice."""

LABELS = "replace(datum.label, regexp(',', 'g'), '\u202f')"
"""Labels of an axis with thousands apart as everywhere in the page."""

LABEL_ROOM = 44
_LOGARITHMIC_FROM = 8.0
_MOST_DECADES = 9
_ROW = 34
"""Height of a row with its label above its marks [px]."""

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
    "padding": {"left": 5, "top": 2, "right": 5, "bottom": 1},
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
        "titleX": -LABEL_ROOM,
        "titleY": -7,
        "titleLimit": 700,
        "tickCount": 5,
    },
}


Spec = dict[str, Any]

_NOT_HIDDEN = {"filter": "indexof(hidden, datum.key) < 0"}


def colour(index: int) -> str:
    """Return the colour of a controller, by its number in the page, as a CSS variable."""
    return f"var(--c{index % COLOURS})"


def dash(index: int) -> tuple[float, ...]:
    """Return the dash pattern of a controller's line, by its number in the page; the first is solid."""
    return DASHES[index % len(DASHES)]


def dashes(index: int) -> str:
    """Return that pattern as SVG has it; empty of a solid line."""
    return " ".join(f"{length:g}" for length in dash(index)) if index % len(DASHES) else ""


def field(name: str, title: str | None, kind: str = "quantitative") -> Spec:
    """Return the encoding of a field of the data."""
    return {"field": name, "type": kind, "title": title}


def layer(
    mark: Spec, encoding: Spec, data: str | list[dict[str, Any]] | None = None, *transform: Spec
) -> Spec:
    """Return marks of the data of a name, of rows, or of what the whole chart is of."""
    layer: Spec = {"mark": mark, "encoding": encoding}
    if data is not None:
        layer["data"] = {"name": data} if isinstance(data, str) else {"values": data}
    return layer | ({"transform": list(transform)} if transform else {})


def chosen_by(field: str, domain: Sequence[str], values: Sequence[Any]) -> Spec:
    """Return a channel with a value for each text of a field, and no legend."""
    scale = {"domain": list(domain), "range": list(values)}
    return {"field": field, "type": "nominal", "legend": None, "scale": scale}


def colours_of(names: Sequence[str]) -> Spec:
    """Return the channel of the colours of controllers, by column."""
    return chosen_by("key", names, [colour(int(name[1:])) for name in names])


def dashes_of(names: Sequence[str]) -> Spec:
    """Return the channel of the dash patterns of controllers, by column."""
    return chosen_by("key", names, [list(dash(int(name[1:]))) for name in names])


def spread_chart(rows: list[dict[str, Any]], title: str) -> Spec:
    """Return a strip of one point per seed for each controller, its median and the first seed marked.

    Parameters
    ----------
    rows : list of dict
        ``label``, ``key``, ``seed``, ``value``, ``first`` (bool), in the order of the controllers; ``extra``
        of one that is only drawn as the first.
    title : str
        Metric and unit.
    """
    labels, hue, y = _rows(rows)
    x = field("value", title) | _axis_of([row["value"] for row in rows], title)
    ink = {"color": "var(--ink)"}
    dots = {"filter": "!datum.extra"}
    median = {"aggregate": [{"op": "median", "field": "value", "as": "value"}], "groupby": ["label"]}
    seeds = {"type": "circle", "size": 34, "opacity": 0.5}
    middle = {"type": "tick", "thickness": 2.5, "size": 14} | ink
    first = {"type": "point", "shape": "diamond", "size": 90, "filled": False, "strokeWidth": 1.8} | ink
    layers = [
        _from_least_to_most(rows, y, hue),
        layer(seeds, {"x": x, "y": y, "color": hue}, None, _NOT_HIDDEN, dots),
        layer(middle, {"x": x, "y": y}, None, _NOT_HIDDEN, dots, median),
        layer(first, {"x": x, "y": y}, None, _NOT_HIDDEN, {"filter": "datum.first"}),
    ]
    return _chart_of_rows(rows, layers, _ROW * len(labels) + 10, view={"stroke": None})


def promise_chart(rows: list[dict[str, Any]], title: str) -> Spec:
    """Return a strip of one point per seed for each controller, their mean and what was promised marked.

    Parameters
    ----------
    rows : list of dict
        ``label``, ``key``, ``value``, ``promise`` (bool: it is what was promised), in the order of the
        controllers.
    title : str
        What the values are, and their unit.
    """
    labels, hue, y = _rows(rows)
    place = {"x": field("value", title) | {"scale": {"zero": False, "nice": True}}, "y": y}
    mean = {"aggregate": [{"op": "mean", "field": "value", "as": "value"}], "groupby": ["label"]}
    seeds, middle = (
        {"type": "circle", "size": 34, "opacity": 0.5},
        {"type": "tick", "thickness": 2.5, "size": 14},
    )
    promise = {"type": "point", "shape": "triangle-up", "filled": True, "size": 60, "color": "var(--limit)"}
    measured = {"filter": "!datum.promise"}
    layers = [
        layer(seeds, {**place, "color": hue}, None, _NOT_HIDDEN, measured),
        layer(middle | {"color": "var(--ink)"}, place, None, _NOT_HIDDEN, measured, mean),
        layer(promise, place, None, _NOT_HIDDEN, {"filter": "datum.promise"}),
    ]
    return _chart_of_rows(rows, layers, _ROW * len(labels) + 10, view={"stroke": None})


def step_time_chart(rows: list[dict[str, Any]], sampling_time: float) -> Spec:
    """Return median, 95 %, 99 % and longest step time of each controller, and the sampling time.

    Parameters
    ----------
    rows : list of dict
        ``label``, ``key``, ``figure`` (its name), ``value`` [s], in the order of the controllers.
    sampling_time : float
        Time between samples [s].
    """
    labels, hue, y = _rows(rows)
    figures = list(dict.fromkeys(row["figure"] for row in rows))
    times = [*(row["value"] for row in rows), sampling_time]
    x = field("value", None) | _logarithmic(times, _TIME_LABELS, "time of one step")
    shape = chosen_by("figure", figures, ["circle", "triangle-up", "diamond", "cross"])
    deadline = {"type": "rule", "color": "var(--limit)", "strokeDash": [4, 3], "strokeWidth": 1.5}
    points = {"type": "point", "filled": True, "size": 55, "opacity": 1}
    layers = [
        layer(deadline, {"x": x}, [{"value": sampling_time}]),
        _from_least_to_most(rows, y, hue),
        layer(points, {"x": x, "y": y, "color": hue, "shape": shape}, None, _NOT_HIDDEN),
    ]
    return _chart_of_rows(rows, layers, _ROW * len(labels) + 10, view={"stroke": None})


def rank_chart(rows: list[dict[str, Any]]) -> Spec:
    """Return the average rank of each controller, with a bar as long as the critical difference.

    Parameters
    ----------
    rows : list of dict
        ``label``, ``key``, ``value`` (average rank), ``low`` and ``high`` (ends of the bar), the best first.
    """
    labels, hue, y = _rows(rows)
    x = field("value", "average rank")
    x |= {"scale": {"zero": False, "nice": False}, "axis": {"tickCount": 8, "labelExpr": LABELS}}
    ends = {"x": x | {"field": "low"}, "x2": {"field": "high"}, "y": y, "color": hue}
    bar = {"type": "rule", "strokeWidth": 7, "opacity": 0.35}
    layers = [
        layer(bar, ends),
        layer({"type": "rule", "strokeWidth": 1.2}, ends | {"strokeDash": _dashes_of_rows(rows)}),
        layer({"type": "circle", "size": 70, "opacity": 1}, {"x": x, "y": y, "color": hue}),
    ]
    return _chart_of_rows(rows, layers, _ROW * len(labels) + 10, view={"stroke": None})


def profile_chart(rows: list[dict[str, Any]], names: Sequence[str], widest: float) -> Spec:
    """Return a step line for each controller: which share of the runs comes within a factor of the best.

    Parameters
    ----------
    rows : list of dict
        ``key``, ``ratio`` (from 1 on) and ``share`` (of 1), by controller and rising.
    names : sequence of str
        Columns of the controllers.
    widest : float
        The largest ratio that is drawn.
    """
    x = field("ratio", "ratio to the best, logarithmic")
    axis = {"values": log_ticks(1.0, widest), "labelExpr": LABELS}
    x |= {"scale": {"type": "log", "domain": [1.0, widest], "nice": False}, "axis": axis}
    y = field("share", "share of the runs") | {"scale": {"domain": [0, 1]}, "axis": {"format": "%"}}
    line = {"type": "line", "strokeWidth": 1.8, "interpolate": "step-after", "clip": True}
    encoding = {"x": x, "y": y, "color": colours_of(names), "strokeDash": dashes_of(names)}
    return _chart_of_rows(rows, [layer(line, encoding, None, _NOT_HIDDEN)], 300)


def tail_chart(rows: list[dict[str, Any]], names: Sequence[str], title: str) -> Spec:
    """Return a step line for each controller: which share of the runs is as bad as a value, or worse.

    Parameters
    ----------
    rows : list of dict
        ``key``, ``value`` and ``share`` (of 1, above 0), by controller, the share falling.
    names : sequence of str
        Columns of the controllers.
    title : str
        Metric and unit.
    """
    x = field("value", title) | _axis_of([row["value"] for row in rows], title)
    least = min(row["share"] for row in rows)
    low = 0.8 * least
    axis = {"values": log_ticks(low, 1.0), "format": "~%"}
    y = field("share", "share of the runs, logarithmic")
    y |= {"scale": {"type": "log", "domain": [low, 1.0], "nice": False}, "axis": axis}
    line = {"type": "line", "strokeWidth": 1.8, "interpolate": "step-before"}
    encoding = {"x": x, "y": y, "color": colours_of(names), "strokeDash": dashes_of(names)}
    encoding["order"] = {"value": None}  # that of the rows
    return _chart_of_rows(rows, [layer(line, encoding, None, _NOT_HIDDEN)], 300)


def _from_least_to_most(rows: list[dict[str, Any]], y: Spec, hue: Spec) -> Spec:
    """Return the line of each row from its least to its largest value, dashed as its controller."""
    ends = [{"op": op, "field": "value", "as": name} for op, name in (("min", "low"), ("max", "high"))]
    span = {"x": {"field": "low", "type": "quantitative"}, "x2": {"field": "high"}, "y": y, "color": hue}
    return layer(
        {"type": "rule", "strokeWidth": 1.2},
        span | {"strokeDash": _dashes_of_rows(rows)},
        None,
        _NOT_HIDDEN,
        {"aggregate": ends, "groupby": ["label"]},
    )


def _dashes_of_rows(rows: list[dict[str, Any]]) -> Spec:
    patterns = {row["label"]: list(dash(int(row["key"][1:]))) for row in rows}
    return chosen_by("label", [*patterns], [*patterns.values()])


def _logarithmic(values: Sequence[float], labels: str, title: str) -> Spec:
    """Give an axis decades, and steps between them where there are few: never a tick without label."""
    low, high = min(values) / 1.25, max(values) * 1.25
    return {
        "title": f"{title}, logarithmic",
        "scale": {"type": "log", "domain": [low, high], "nice": False},
        "axis": {"values": log_ticks(low, high), "labelExpr": labels},
    }


def log_ticks(low: float, high: float) -> list[float]:
    """Return round numbers from low to high, some four to ten of them where the range allows."""
    decades = math.log10(high) - math.log10(low)
    mantissas = next(choice for most, choice in _MANTISSAS.items() if decades < most)
    every = max(math.ceil(decades / _MOST_DECADES), 1)
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1, every)
    ticks = [float(f"{m}e{k}") for k in exponents for m in mantissas]
    return [tick for tick in ticks if low <= tick <= high]


def heat_chart(rows: list[dict[str, Any]], titles: Sequence[str]) -> Spec:
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
    bare = {"domain": False, "ticks": False, "grid": False, "labelAngle": 0, "labelLimit": 160}
    x = field("x", titles[1], "nominal") | {"sort": across, "axis": {**bare, "labelOverlap": "greedy"}}
    y = field("y", titles[0] or None, "nominal") | {"sort": down, "axis": {**bare, "minExtent": 44}}
    known = [row["value"] for row in rows if row["value"] is not None]
    best, worst = min(known, default=1.0), max(known, default=1.0)
    # Small differences stay pale: full shade is for three times the best at least.
    shades = {"domain": [best, max(worst, 3 * best)], "range": [0.03, 0.5], "nice": False}
    scale = {"type": "log" if best > 0 else "linear", **shades}
    opacity = {"field": "value", "type": "quantitative", "legend": None, "scale": scale}
    # Where a cell is too narrow for its words, pointing at it tells them.
    room = {"expr": f"width > {_CELL_WORDS * len(across)} ? 1 : 0"}
    paint = {"condition": {"test": "datum.value === null", "value": "var(--bad)"}, "value": "var(--ink)"}
    words = {"text": {"field": "shown", "type": "nominal"}, "color": paint}
    place = {"x": x, "y": y}
    layers = [
        layer(
            {"type": "rect", "color": "var(--accent)"},
            {**place, "opacity": opacity},
            None,
            {"filter": "datum.value !== null"},
        ),
        layer(
            {"type": "rect", "fill": None, "stroke": "var(--ink)", "strokeWidth": 2},
            place,
            None,
            {"filter": "datum.own"},
        ),
        layer({"type": "text", "fontSize": 12, "opacity": room}, {**place, **words}),
    ]
    return _chart_of_rows(rows, layers, 34 * len(down) + 8)


def front_chart(rows: list[dict[str, Any]], titles: Sequence[str], *, joined: bool) -> Spec:
    """Return trials over two objectives, those on the front full and perhaps joined by a line.

    Parameters
    ----------
    rows : list of dict
        ``x``, ``y``, ``front``, ``chosen``, ``given`` (bool).
    titles : sequence of str
        The two objectives.
    joined : bool
        Whether a line joins them: it means something where there are no more objectives.
    """
    x, y = (
        field(side, title) | _axis_of([row[side] for row in rows], title)
        for side, title in zip("xy", titles, strict=True)
    )
    place = {"x": x, "y": y}
    on_front = {"filter": "datum.front"}
    line = {"type": "line", "color": "var(--accent)", "strokeWidth": 1.6, "interpolate": "step-after"}
    dots = {"type": "circle", "size": 34, "color": "var(--accent)"}
    shown = {"condition": {"test": "datum.front", "value": 1}, "value": 0.3}
    framed = {"type": "point", "filled": False, "strokeWidth": 1.8, "color": "var(--ink)"}
    marks = {"chosen": {"shape": "diamond", "size": 150}, "given": {"shape": "square", "size": 110}}
    layers = [
        *([layer(line, place, None, on_front)] if joined else []),
        layer(dots, {**place, "opacity": shown}),
        *(layer(framed | mark, place, None, {"filter": f"datum.{what}"}) for what, mark in marks.items()),
    ]
    return _chart_of_rows(rows, layers, 260)


def trade_chart(
    rows: list[dict[str, Any]],
    titles: Sequence[str],
    values_of: Sequence[Sequence[float]],
    *,
    joined: bool,
    width: int,
) -> Spec:
    """Return controllers over what they cost and what they leave, their seeds faint behind them.

    Parameters
    ----------
    rows : list of dict
        ``x``, ``y``, ``key``, ``label``; ``median`` (bool: of all seeds, otherwise of one), ``front`` (bool:
        of the medians that no other is better than in one and at least as good in the other) and ``point``
        (bool: a reference point, which is labelled).
    titles : sequence of str
        What the axes are.
    values_of : sequence of sequence of float
        What both axes have room for: the values of all charts that are to be compared.
    joined : bool
        Whether a line joins the front.
    width : int
        Of the static drawing [px].
    """
    x, y = (
        field(side, title) | _axis_of(values, title, _with_margin(values))
        for side, title, values in zip("xy", titles, values_of, strict=True)
    )
    names = list(dict.fromkeys(row["key"] for row in rows))
    place, hue = {"x": x, "y": y}, colours_of(names)
    line = {"type": "line", "color": "var(--ink-soft)", "strokeWidth": 1.2, "interpolate": "step-after"}
    seeds, medians = {"filter": "!datum.median"}, {"filter": "datum.median"}
    point, words = {"filter": "datum.point"}, {"type": "text", "fontSize": 11, "color": "var(--ink)"}
    frame = {"type": "point", "shape": "diamond", "size": 170, "filled": False, "color": "var(--ink)"}
    layers = [
        *([layer(line, place, None, {"filter": "datum.front"})] if joined else []),
        layer(
            {"type": "circle", "size": 24, "opacity": 0.35}, {**place, "color": hue}, None, _NOT_HIDDEN, seeds
        ),
        layer(
            {"type": "circle", "size": 90, "opacity": 1}, {**place, "color": hue}, None, _NOT_HIDDEN, medians
        ),
        layer(frame, place, None, _NOT_HIDDEN, medians, point),
        layer(
            words | {"align": {"expr": f"datum.x > {_middle(rows)} ? 'right' : 'left'"}, "dy": -12},
            {**place, "text": field("label", None, "nominal")},
            None,
            _NOT_HIDDEN,
            medians,
            point,
        ),
    ]
    return _chart_of_rows(rows, layers, 240, width=width)


def plane_chart(rows: list[dict[str, Any]], titles: Sequence[str], width: int) -> Spec:
    """Return a line through two signals for each controller, its beginning as a dot.

    Parameters
    ----------
    rows : list of dict
        ``x``, ``y`` and ``key``, in the order of the line; ``begins`` of the first of a key.
    titles : sequence of str
        What the axes are.
    width : int
        Of the static drawing [px].
    """
    scaled = {"scale": {"zero": False, "nice": True}, "axis": {"tickCount": 6, "labelExpr": LABELS}}
    x, y = (field(side, title) | scaled for side, title in zip("xy", titles, strict=True))
    names = list(dict.fromkeys(row["key"] for row in rows))
    place = {"x": x, "y": y, "color": colours_of(names)}
    begins = {"filter": "datum.begins"}
    along = {"strokeDash": dashes_of(names), "order": {"value": None}}  # that of the rows
    layers = [
        layer({"type": "line", "strokeWidth": 1.3}, place | along, None, _NOT_HIDDEN),
        layer({"type": "circle", "size": 40, "opacity": 1}, place, None, _NOT_HIDDEN, begins),
    ]
    return _chart_of_rows(rows, layers, 240, width=width)


def _middle(rows: Sequence[dict[str, Any]]) -> float:
    values = [float(row["x"]) for row in rows]
    return (min(values) + max(values)) / 2


def ranges_widely(values: Sequence[float]) -> bool:
    """Whether values ask for a logarithmic axis."""
    return min(values) > 0 and max(values) > _LOGARITHMIC_FROM * min(values)


def _axis_of(values: Sequence[float], title: str, domain: Sequence[float] = ()) -> Spec:
    if ranges_widely(values):
        return _logarithmic(values, _GROUPED, title)
    scale = {"zero": False, "nice": True} | ({"domain": list(domain)} if domain else {})
    return {"scale": scale, "axis": {"tickCount": 6, "labelExpr": LABELS}}


def _with_margin(values: Sequence[float]) -> tuple[float, float]:
    """Return a range in which marks do not lie on its ends; of what is never negative it begins at 0."""
    low, high = min(values), max(values)
    margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return (low - margin if low < 0 or low > margin else 0.0, high + margin)


def _rows(rows: list[dict[str, Any]]) -> tuple[list[str], Spec, Spec]:
    """Return the labels of the rows, their colours, and the axis: labels above the marks cost no width."""
    indices = {row["label"]: int(row["key"][1:]) for row in rows}
    labels = list(indices)
    axis = {
        "labelAlign": "left",
        "labelPadding": -4,
        "labelOffset": -15,
        "labelBaseline": "middle",
        "labelLimit": 600,
        "labelFontSize": 12,
        "labelColor": "var(--ink)",
        "ticks": False,
        "grid": True,
        "minExtent": 0,
        "maxExtent": 0,
    }
    y = field("label", None, "nominal") | {"sort": labels, "axis": axis}
    return labels, chosen_by("label", labels, [colour(index) for index in indices.values()]), y


def _chart_of_rows(rows: list[dict[str, Any]], layers: list[Spec], height: int, **more: Any) -> Spec:
    """Return a chart of one table, which no time runs through."""
    hidden = [{"name": "hidden", "value": []}]
    return {"data": {"values": rows}, "layer": layers, "height": height, "params": hidden, **more}
