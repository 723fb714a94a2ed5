"""Static drawings of the charts: for print, and for readers without JavaScript."""

import html
import re
from collections.abc import Mapping
from typing import Any

import vl_convert

from ddpc_reports.charts import CONFIG
from ddpc_reports.samples import Column

_WIDTH = 800
_LONG_NUMBER = re.compile(r"-?\d+\.\d{2,}")
_PATH = re.compile(r' d="[^"]*"')
_NOISE = re.compile(
    r' (?:aria-[a-z]+|role|pointer-events|class|xmlns:xlink|version|stroke-miterlimit)="[^"]*"|'
    r'<path aria-hidden="true" d="M0,0h0v0h0Z" pointer-events="none"/>'
)


def static_svg(
    spec: Mapping[str, Any],
    identifier: str,
    description: str,
    data: Mapping[str, dict[str, Column]] | None = None,
) -> str:
    """Return a chart as an SVG element that scales with its box.

    Parameters
    ----------
    spec : mapping
        Vega-Lite specification; named data sets come from ``data``.
    identifier : str
        Unique in the page; ids inside the drawing start with it.
    description : str
        What the chart shows, for those who do not see it.
    data : mapping of str to columns, optional
        The data sets by name.
    """
    datasets = {name: rows_of(columns) for name, columns in (data or {}).items()}
    full = {**spec, "config": CONFIG, "width": _WIDTH, "datasets": {**spec.get("datasets", {}), **datasets}}
    return _finish(vl_convert.vegalite_to_svg(full), identifier, description)


def rows_of(columns: Mapping[str, Column]) -> list[dict[str, float | None]]:
    """Turn columns into rows; a run that ended early has no value in the rows after its end."""
    length = len(columns["t"])
    padded = {name: [*values, *[None] * (length - len(values))] for name, values in columns.items()}
    return [dict(zip(padded, row, strict=True)) for row in zip(*padded.values(), strict=True)]


def _finish(svg: str, identifier: str, description: str) -> str:
    """Make ids unique in the page, name the drawing, and drop what costs bytes and says nothing."""
    svg = _NOISE.sub("", svg)
    svg = _PATH.sub(lambda path: _LONG_NUMBER.sub(lambda number: f"{float(number[0]):.1f}", path[0]), svg)
    svg = re.sub(r'\bid="', f'id="{identifier}-', svg)
    svg = re.sub(r"url\(#", f"url(#{identifier}-", svg)
    size = re.search(r' width="[\d.]+" height="[\d.]+"', svg)
    head = f' class="static" role="img" aria-label="{html.escape(description)}"'
    return svg.replace(size[0], head, 1) if size else svg
