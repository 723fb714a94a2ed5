"""The page: what was gathered is set as HTML."""

from collections.abc import Mapping, Sequence
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ddpc_cosim import StudyResults
from ddpc_cosim.files.texts import clipped, printable
from ddpc_reports.embedding import (
    Packed,
    chart_library,
    content_policy,
    deflated,
    drawable,
    json_of,
    page_script,
    stylesheet,
)
from ddpc_reports.figures.charts import COLOURS, DASHES
from ddpc_reports.sections import StudyPart, gather


def render_page(results: Sequence[StudyResults]) -> str:
    """Return the page as HTML.

    Raises
    ------
    ValueError
        There are no results at all.
    """
    gathered = gather(results)
    return set_page(gathered.parts, gathered.data, gathered.title)


def set_page(studies: Sequence[StudyPart], data: Mapping[str, dict[str, Packed]], title: str = "") -> str:
    """Return the page of studies, or of what is set like one, with the samples that their figures draw."""
    library, script = chart_library(), page_script()
    environment = Environment(
        loader=PackageLoader("ddpc_reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=_shown,
    )
    environment.filters.update(cut=_cut, clipped=clipped)
    return environment.get_template("page.html.jinja").render(
        studies=studies,
        title=title or (studies[0].title if len(studies) == 1 else f"{len(studies)} studies compared"),
        style=Markup(stylesheet()),
        script=_Script(script),
        policy=content_policy([script, library]),
        embedded={"chart-library": deflated(library), "report-data": deflated(json_of(_data(studies, data)))},
        colours=COLOURS,
        patterns=len(DASHES),
    )


class _Script(Markup):
    """A script: the page's policy has a hash of it, so that it must stay as it is."""


def _cut(text: str, longest: int = 300) -> str:
    """Return a text, or its beginning and end with all of it for who points at it."""
    short = text if isinstance(text, Markup) else clipped(text, longest)
    full = getattr(short, "full", None)
    return Markup('<span title="{}">{}</span>').format(full, short) if full else short


def _shown(value: Any) -> Any:
    """Return what the page has of a value: in texts, sentences and drawings nothing acts unseen."""
    return value if not isinstance(value, str) or isinstance(value, _Script) else printable(value, keep="\n")


def _data(studies: Sequence[StudyPart], data: Mapping[str, dict[str, Packed]]) -> dict[str, Any]:
    """Return what the script draws from: samples once, and of each chart its specification and its names."""
    parts = [
        blocks
        for study in studies
        for blocks in (study.first, *(section.blocks for section in study.sections))
    ]
    views = {}
    for figure, group in (content for blocks in parts for kind, content in blocks if kind == "figure"):
        labels = {entry.name: entry.label for entry in figure.legend}
        for view in filter(lambda view: view.drawing.vega, figure.views):
            views[view.id] = {
                "group": group,
                "figure": figure.id,
                "spec": view.drawing.vega,
                "data": view.data,
                "lines": drawable({name: labels[name] for name in view.names}),
                "unit": drawable(view.unit),
                "scaled": list(view.scaled_by),
                "limits": list(view.limits),
                "fixed": view.fixed,
                "time": view.time,
                "given": drawable(view.given),
                "also": list(view.also_scaling),
            }
    return {"colours": COLOURS, "data": data, "views": views}
