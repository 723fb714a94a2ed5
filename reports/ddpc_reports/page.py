"""The page: what was gathered is set as HTML."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ddpc_cosim import StudyResults
from ddpc_cosim.files.texts import clipped, printable
from ddpc_reports.embedding import (
    Packed,
    Picture,
    chart_library,
    content_policy,
    deflated,
    drawable,
    json_of,
    page_script,
    stylesheet,
)
from ddpc_reports.figures.charts import COLOURS, DASHES
from ddpc_reports.figures.figure import Figure, View
from ddpc_reports.sections import Block, StudyPart, gather

_ROOM = 80_000
"""Letters of drawings from which on those are left to the script that are not seen first."""


def render_page(results: Sequence[StudyResults]) -> str:
    """Return the page as HTML.

    Raises
    ------
    ValueError
        There are no results at all.
    """
    gathered = gather(results)
    logo = next((single.logo for single in results if single.logo), "")
    return set_page(gathered.parts, gathered.data, gathered.title, logo)


def set_page(
    studies: Sequence[StudyPart], data: Mapping[str, dict[str, Packed]], title: str = "", logo: str = ""
) -> str:
    """Return the page of studies, or of what is set like one, with the samples that their figures draw."""
    script = page_script()
    parts = _names_of_parts(studies)
    pictures = _pictures(studies, next(iter(parts), ""))
    lively = [name for name, picture in pictures.items() if picture.vega]
    # What draws charts is the most of a small page: where there are none it is left out.
    library = chart_library() if pictures else ""
    embedded = {
        "chart-library": deflated(library),
        "report-data": deflated(json_of(_data(studies, data, pictures))),
    }
    environment = Environment(
        loader=PackageLoader("ddpc_reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=_shown,
    )
    environment.filters.update(cut=_cut, clipped=clipped, deflated=deflated)
    return environment.get_template("page.html.jinja").render(
        studies=studies,
        title=title or (studies[0].title if len(studies) == 1 else f"{len(studies)} studies compared"),
        logo=logo,
        style=Markup(stylesheet()),
        script=_Script(script),
        policy=content_policy([script, library] if pictures else [script]),
        embedded=embedded if pictures else {},
        colours=COLOURS,
        names=_names(studies),
        pictures=pictures,
        lively=lively,
        names_of_parts=parts,
        shown=next(iter(parts), ""),
        patterns=len(DASHES),
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


def _pictures(studies: Sequence[StudyPart], shown: str) -> dict[str, Picture]:
    """Return the charts by their names: drawn where they are seen without scripts and a click, and responses.

    What is folded, or of a scenario or a part that is not shown first, is left to the script: drawings are
    the most of a page. Of the others responses are drawn as long as there is room, so that without scripts
    there is something.
    """
    pictures = dict[str, Picture]()
    responses, rest = list[View](), list[View]()
    for study in studies:
        is_shown = study.id == shown or not shown
        for anchor, blocks in [("", study.first), *((s.anchor, s.blocks) for s in study.sections)]:
            for is_chosen, figure in _figures_of(blocks, study.chosen):
                if is_shown and is_chosen and not figure.folded:
                    pictures |= {view.id: view.drawing.still for view in figure.views}
                else:
                    (responses if anchor == "responses" else rest).extend(figure.views)
    taken = sum(len(picture.svg) for picture in pictures.values())
    for view in responses:
        pictures[view.id] = view.drawing.still if taken < _ROOM else view.drawing.live
        taken += len(pictures[view.id].svg)
    return pictures | {view.id: view.drawing.live for view in rest}


def _figures_of(blocks: Sequence[Block], chosen: str) -> Iterator[tuple[bool, Figure]]:
    """Yield figures, and whether they are of the scenario that is chosen, or of all."""
    for kind, content in blocks:
        if kind == "figure":
            yield True, content[0]
        elif kind == "scenario":
            for _, figure in _figures_of(content.blocks, chosen):
                yield content.name == chosen, figure


def _data(
    studies: Sequence[StudyPart], data: Mapping[str, dict[str, Packed]], pictures: Mapping[str, Picture]
) -> dict[str, Any]:
    """Return what the script draws from: samples once, and of each chart its specification and its names."""
    figures = [
        (study.id, figure)
        for study in studies
        for blocks in (study.first, *(section.blocks for section in study.sections))
        for _, figure in _figures_of(blocks, "")
    ]
    views = {}
    for part, figure in figures:
        labels = {entry.name: entry.label for entry in figure.legend}
        for view in filter(lambda view: pictures[view.id].vega, figure.views):
            views[view.id] = {
                "group": part,
                "figure": figure.id,
                "spec": pictures[view.id].vega,
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
