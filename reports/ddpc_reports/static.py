"""Static drawings of the charts: for print, and for readers without JavaScript."""

import html
import re
from collections.abc import Mapping
from typing import Any

import vl_convert
from markupsafe import Markup

from ddpc_reports.charts import CONFIG
from ddpc_reports.samples import Column

_WIDTH = 800
_LONG_NUMBER = re.compile(r"-?\d+\.\d{2,}")
_PATH = re.compile(r' d="[^"]*"')
_REPEATED_POINT = re.compile(r"(L[^LMZ\"]+)\1+")
_ID = re.compile(r' id="([^"]+)"')
_REFERENCE = re.compile(r"url\(#([^)]+)\)")
_NOISE = re.compile(
    r' (?:aria-[a-z]+|role|pointer-events|class|xmlns:xlink|version|stroke-miterlimit)="[^"]*"|'
    r'<path aria-hidden="true" d="M0,0h0v0h0Z" pointer-events="none"/>'
)


def static_svg(
    spec: Mapping[str, Any],
    identifier: str,
    description: str,
    data: Mapping[str, dict[str, Column]] | None = None,
) -> Markup:
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


def _finish(svg: str, identifier: str, description: str) -> Markup:
    """Make ids unique in the page, name the drawing, and drop what costs bytes and says nothing."""
    svg = _number_ids(_PATH.sub(_short_path, _NOISE.sub("", svg)), identifier)
    size = re.search(r' width="[\d.]+" height="[\d.]+"', svg)
    head = f' class="static" role="img" aria-label="{html.escape(description)}"'
    return Markup(svg.replace(size[0], head, 1) if size else svg)


def _short_path(path: re.Match[str]) -> str:
    """Round to a tenth of a pixel, and drop points that then fall on the one before."""
    rounded = _LONG_NUMBER.sub(lambda number: f"{float(number[0]):.1f}", path[0])
    return _REPEATED_POINT.sub(r"\1", rounded)


def _number_ids(svg: str, identifier: str) -> str:
    """Give every drawing ids of its own, counted from one: Vega counts on from drawing to drawing."""
    names = {name: f"{identifier}-{number}" for number, name in enumerate(_ID.findall(svg), start=1)}
    svg = _ID.sub(lambda found: f' id="{names[found[1]]}"', svg)
    return _REFERENCE.sub(lambda found: f"url(#{names[found[1]]})", svg)
