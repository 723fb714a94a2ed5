"""Sections of third parties: found by entry point, checked, and set like all others."""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from numbers import Real
from typing import Any

from ddpc_cosim import CosimWarning, PluginError, ReportSection, ReportTable, StudyResults
from ddpc_cosim.files.tables import Cell, Heading, Row, Table
from ddpc_cosim.files.texts import printable
from ddpc_cosim.plugins import installed
from ddpc_reports.embedding import Drawing
from ddpc_reports.figures.figure import Figure, one_chart
from ddpc_reports.tables.table import number_cells

_LOADING = ("url", "href", "usermeta")
"""Keys of a specification by which a chart would load or lead to something outside of the page."""
_DATA = ("values", "datasets")


def own_sections() -> dict[str, ReportSection]:
    """Return the sections that are installed, by the names of their entry points.

    Warns
    -----
    CosimWarning
        One cannot be loaded, or is neither a section nor a format.
    """
    sections = {}
    for plugin in installed("reports"):
        if isinstance(plugin.value, ReportSection):
            sections[plugin.name] = plugin.value
        elif not callable(plugin.value):
            what = f"it is a {type(plugin.value).__name__}; needed: a ddpc_cosim.ReportSection, or a function"
            said = f"report {plugin.name} ({plugin.package}): {plugin.error or what}"
            warnings.warn(printable(said), CosimWarning, stacklevel=2)
    return sections


def own_blocks(section: ReportSection, results: StudyResults, prefix: str) -> list[tuple[str, Any]]:
    """Return what a section shows, in the kinds of the page.

    Raises
    ------
    PluginError
        It returns something else, or a chart that would load something.
    """
    try:
        made = list(section.make(results))
    except SystemExit as error:
        raise PluginError(f"it has ended the program: SystemExit: {error}") from error
    return [_block(section, block, f"{prefix}{place}") for place, block in enumerate(made, start=1)]


def _block(section: ReportSection, block: Any, identifier: str) -> tuple[str, Any]:
    if isinstance(block, str):
        return "paragraph", str(block)
    if isinstance(block, ReportTable):
        return "table", _table(block, identifier)
    if isinstance(block, Mapping):
        return "figure", (_figure(section, block, identifier), identifier)
    needed = "a str, a ddpc_cosim.ReportTable, or a Vega-Lite specification as a dict"
    raise PluginError(f"block {identifier.rpartition('-')[2]} is a {type(block).__name__}; needed: {needed}")


def _table(given: ReportTable, identifier: str) -> Table:
    header, rows = [*map(str, given.header)], [[*row] for row in given.rows]
    for row in rows:
        if len(row) != len(header) or not header:
            raise PluginError(
                f'table "{given.caption}": a row has {len(row)} cells; needed: {len(header)}, one per heading'
            )
    columns = [[row[i] for row in rows] for i in range(1, len(header))]
    numeric = [all(_is_number(value) for value in column) for column in columns]
    cells = [
        _numbers(column) if is_numeric else [Cell(str(value), str(value)) for value in column]
        for column, is_numeric in zip(columns, numeric, strict=True)
    ]
    headings = [
        Heading(title, numeric=is_numeric) for title, is_numeric in zip(header[1:], numeric, strict=True)
    ]
    return Table(
        identifier,
        str(given.caption),
        (Heading(header[0], numeric=False), *headings),
        tuple(Row(str(row[0]), tuple(column[i] for column in cells)) for i, row in enumerate(rows)),
    )


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _numbers(values: Sequence[Any]) -> list[Cell]:
    return number_cells([float(value) for value in values], better="")


def _figure(section: ReportSection, spec: Mapping[str, Any], identifier: str) -> Figure:
    """Return a chart as a drawing that stays as it is."""
    _check_loads_nothing(spec)
    figure = one_chart(identifier, section.title, str(spec.get("description", section.title)), dict(spec))
    (view,) = figure.views
    return replace(figure, views=(replace(view, drawing=Drawing(view.drawing.svg, view.drawing.height)),))


def _check_loads_nothing(value: Any) -> None:
    if isinstance(value, Mapping):
        for key, entry in value.items():
            if key in _LOADING:
                raise PluginError(f'"{key}" in a chart: a report loads nothing; give data as "values"')
            if key not in _DATA:
                _check_loads_nothing(entry)
    elif isinstance(value, list | tuple):
        for entry in value:
            _check_loads_nothing(entry)
    elif isinstance(value, float) and not math.isfinite(value):
        raise PluginError(f"{value} in a chart: give null for what is missing")
