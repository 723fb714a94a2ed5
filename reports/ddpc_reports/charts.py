"""Vega-Lite specifications of the figures, through Altair.

Colours are CSS variables of the page (``var(--c0)``), so that one specification serves light, dark and print.
Five parameters are driven by the script of the page: ``span`` (the time shown), ``extent`` (the range of the
values), ``band`` (the time being chosen), ``at`` (the sample under the pointer) and ``hidden`` (the
controllers that the reader hid).
"""

from collections.abc import Sequence
from typing import Any

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


def colour(index: int) -> str:
    """Return the colour of a competitor as a CSS variable."""
    return f"var(--c{index % COLOURS})"


def time_chart(
    signal: Signal, names: Sequence[str], dashes: dict[str, int], sampling_time: float, last: bool
) -> Any:
    """Return the chart of one signal over time, for the competitors of one panel.

    Parameters
    ----------
    signal : Signal
        What is drawn.
    names : sequence of str
        Columns of the competitors in this panel, the one drawn first at the back.
    dashes : dict
        Number of the dash pattern of every column.
    sampling_time : float
        Time between samples [s].
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
