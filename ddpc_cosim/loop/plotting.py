"""One run as a chart: outputs with references or bands, inputs, disturbances, prices; limits as lines."""

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ddpc_cosim.files.texts import printable
from ddpc_cosim.variables import FloatArray, Variable

if TYPE_CHECKING:
    import altair

_WIDTH, _HEIGHT = 600, 160
_ZOOM = {"name": "zoom", "select": {"type": "interval", "encodings": ["x"]}, "bind": "scales"}
_HELD = {"interpolate": "step-after"}
_DASHED = {"strokeDash": [5, 3], "color": "gray"}
_LIMIT = {"color": "firebrick", "strokeDash": [2, 2]}
_TIMES = (("d", 86400.0, 4 * 86400.0), ("h", 3600.0, 4 * 3600.0), ("s", 1.0, 0.0))
"""Units of time, their size and the shortest run that is drawn in them [s]."""


class Panel(NamedTuple):
    """One signal of a chart.

    Parameters
    ----------
    variable : Variable
        What it is.
    values : array, shape (K,)
        Its samples, in its unit.
    limits : (float, float) or array, shape (K, 2)
        Lines below and above, where they are finite; an array where they change with time.
    reference : array, shape (K,), optional
        What it is to follow.
    band : array, shape (K, 2), optional
        Between what it is wanted, which is shaded.
    held : bool
        Whether the signal is held from one sample to the next.
    """

    variable: Variable
    values: FloatArray
    limits: tuple[float, float] | FloatArray = (-math.inf, math.inf)
    reference: FloatArray | None = None
    band: FloatArray | None = None
    held: bool = False


def time_chart(time: FloatArray, panels: Sequence[Panel], title: str) -> "altair.VConcatChart":
    """Return signals over time, a panel for each, in display units; ``time`` has shape (K,) [s]."""
    import altair as alt

    span = float(np.ptp(time)) if len(time) else 0.0
    unit, seconds = next((name, size) for name, size, least in _TIMES if span >= least)
    charts = [_panel(time / seconds, panel) for panel in panels]
    for chart in charts:
        chart["encoding"]["x"]["title"] = f"time [{unit}]"
    charts[0]["layer"][0]["params"] = [_ZOOM]
    for chart in charts[:-1]:
        chart["encoding"]["x"]["title"] = None
    spec: dict[str, Any] = {"vconcat": charts, "resolve": {"scale": {"x": "shared"}}}
    if title:
        spec["title"] = printable(title, 200)
    return alt.VConcatChart.from_dict(spec)


def _panel(time: FloatArray, panel: Panel) -> dict[str, Any]:
    unit, name = panel.variable.shown_in, panel.variable.name
    curves: list[tuple[str, FloatArray, dict[str, Any]]] = []
    if panel.reference is not None:
        curves.append(("reference", panel.reference, {**_HELD, **_DASHED}))
    curves.append((name, panel.values, _HELD if panel.held else {}))
    if isinstance(panel.limits, np.ndarray):
        curves += [(which, panel.limits[:, i], {**_HELD, **_LIMIT}) for i, which in enumerate(("min", "max"))]
    title = printable(f"{name} [{unit.name or '1'}]", 60)
    layers = [
        {
            "data": {"values": list(_points(time, unit.from_unit(values), printable(name, 60)))},
            "mark": {"type": "line", "tooltip": {"content": "data"}, **marks},
            "encoding": {"x": {"field": "time", "type": "quantitative"}},
        }
        for name, values, marks in curves
    ]
    if panel.band is not None:
        layers.insert(0, _shaded(time, unit.from_unit(panel.band)))
    ends = np.empty(0) if isinstance(panel.limits, np.ndarray) else unit.from_unit(np.array(panel.limits))
    if np.isfinite(ends).any():
        values = [{"value": float(end)} for end in ends[np.isfinite(ends)]]
        layers.append({"data": {"values": values}, "mark": {"type": "rule", **_LIMIT}})
    y = {"field": "value", "type": "quantitative", "title": title, "scale": {"zero": False}}
    encoding: dict[str, Any] = {"x": {}, "y": y}
    return {"layer": layers, "encoding": encoding, "width": _WIDTH, "height": _HEIGHT}


def _shaded(time: FloatArray, band: FloatArray) -> dict[str, Any]:
    """Return the layer of a band, shape (K, 2)."""
    rows = [
        {"time": float(t), "value": float(low), "upper": float(high)}
        for t, (low, high) in zip(time, band, strict=True)
    ]
    return {
        "data": {"values": rows},
        "mark": {"type": "area", "color": "gray", "opacity": 0.2, **_HELD},
        "encoding": {"x": {"field": "time", "type": "quantitative"}, "y2": {"field": "upper"}},
    }


def _points(time: FloatArray, values: FloatArray, name: str) -> Iterator[dict[str, Any]]:
    for t, value in zip(time, values, strict=True):
        if np.isfinite(value):
            yield {"time": float(t), "value": float(value), "curve": name}
