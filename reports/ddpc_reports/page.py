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
from ddpc_reports.figures.charts import COLOURS
from ddpc_reports.sections import StudyPart, gather, one_by_one


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
    parts = _names_of_parts(studies)
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
        names=_names(studies),
        names_of_parts=parts,
        shown=next(iter(parts), ""),
    )


def _names(studies: Sequence[StudyPart]) -> dict[int, str]:
    """Return the controllers by what gives them their colours, which is the same in the whole page."""
    return {int(entry.line.name[1:]): entry.key for study in studies for entry in study.legend}


def _names_of_parts(studies: Sequence[StudyPart]) -> dict[str, str]:
    """Return what the address calls the parts of which one is shown at a time; empty if there is only one."""
    if len(studies) < 2:
        return {}
    names = [study.name for study in studies]
    return {
        study.id: study.name if names.count(study.name) == 1 else f"{study.name}-{study.number}"
        for study in studies
    }


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
    figures = [
        (study.id, *content)
        for study in studies
        for blocks in (study.first, *(section.blocks for section in study.sections))
        for kind, content in one_by_one(blocks)
        if kind == "figure"
    ]
    views = {}
    for part, figure, _ in figures:
        labels = {entry.name: entry.label for entry in figure.legend}
        for view in filter(lambda view: view.drawing.vega, figure.views):
            views[view.id] = {
                "group": part,
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
    return {"data": data, "views": views}
