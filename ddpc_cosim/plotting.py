"""One run as a chart: outputs with their references, inputs below, limits as lines."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ddpc_cosim.texts import printable
from ddpc_cosim.variables import FloatArray, Variable

if TYPE_CHECKING:
    import altair

_WIDTH, _HEIGHT = 600, 160
_ZOOM = {"name": "zoom", "select": {"type": "interval", "encodings": ["x"]}, "bind": "scales"}
_HELD = {"interpolate": "step-after"}
_DASHED = {"strokeDash": [5, 3], "color": "gray"}


class Panel(NamedTuple):
    """One signal of a chart.

    Parameters
    ----------
    variable : Variable
        What it is.
    values : array, shape (K,)
        Its samples, in its unit.
    limits : (float, float)
        Lines below and above, where they are finite.
    reference : array, shape (K,), optional
        What it is to follow; none: the signal is held from one sample to the next.
    """

    variable: Variable
    values: FloatArray
    limits: tuple[float, float]
    reference: FloatArray | None = None


def time_chart(time: FloatArray, panels: Sequence[Panel], title: str) -> "altair.VConcatChart":
    """Return signals over time, a panel for each, in display units; ``time`` has shape (K,) [s]."""
    import altair as alt

    charts = [_panel(time, panel) for panel in panels]
    charts[0]["layer"][0]["params"] = [_ZOOM]
    for chart in charts[:-1]:
        chart["encoding"]["x"]["title"] = None
    spec: dict[str, Any] = {"vconcat": charts, "resolve": {"scale": {"x": "shared"}}}
    if title:
        spec["title"] = printable(title, 200)
    return alt.VConcatChart.from_dict(spec)


def _panel(time: FloatArray, panel: Panel) -> dict[str, Any]:
    unit, name = panel.variable.shown_in, panel.variable.name
    curves: list[tuple[str, FloatArray, dict[str, Any]]] = [(name, panel.values, {})]
    if panel.reference is None:
        curves = [(name, panel.values, _HELD)]
    else:
        curves.insert(0, ("reference", panel.reference, {**_HELD, **_DASHED}))
    title = printable(f"{name} [{unit.name or '1'}]", 60)
    layers = [
        {
            "data": {"values": list(_points(time, unit.from_unit(values), printable(name, 60)))},
            "mark": {"type": "line", "tooltip": {"content": "data"}, **marks},
            "encoding": {"x": {"field": "time", "type": "quantitative"}},
        }
        for name, values, marks in curves
    ]
    ends = unit.from_unit(np.array(panel.limits))
    if np.isfinite(ends).any():
        values = [{"value": float(end)} for end in ends[np.isfinite(ends)]]
        mark = {"type": "rule", "color": "firebrick", "strokeDash": [2, 2]}
        layers.append({"data": {"values": values}, "mark": mark})
    y = {"field": "value", "type": "quantitative", "title": title, "scale": {"zero": False}}
    encoding = {"x": {"title": "time [s]"}, "y": y}
    return {"layer": layers, "encoding": encoding, "width": _WIDTH, "height": _HEIGHT}


def _points(time: FloatArray, values: FloatArray, name: str) -> Iterator[dict[str, Any]]:
    for t, value in zip(time, values, strict=True):
        if np.isfinite(value):
            yield {"time": float(t), "value": float(value), "curve": name}
