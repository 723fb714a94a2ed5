"""Sections that third parties add to the report, in kinds of blocks that every format can show."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ddpc_cosim.study.results import StudyResults


@dataclass(frozen=True)
class ReportTable:
    """A table of a section.

    Parameters
    ----------
    caption : str
        What it shows.
    header : sequence of str
        A heading for each column.
    rows : sequence of sequences of str or float
        The cells, as many in each row as there are headings; the first says what the row is of. A column of
        numbers is set with its decimal points in line; NaN is shown as a dash.
    """

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str | float]]


ReportBlock = str | ReportTable | Mapping[str, Any]
"""A paragraph; a table; or a chart as a Vega-Lite specification, whose ``description`` is its caption."""


@dataclass(frozen=True)
class ReportSection:
    """A section of the report: an entry point of ``ddpc_cosim.reports``.

    Parameters
    ----------
    title : str
        Its title.
    make : callable
        Takes the results of one problem, a :class:`ddpc_cosim.StudyResults`, and returns what the section
        shows: paragraphs (``str``), tables (:class:`ReportTable`), and charts as specifications of Vega-Lite
        (``dict``), which may load nothing: their data are in them. Of nothing to show, an empty list. If it
        raises, a sentence in the section's place says why, and nothing else is lost.
    after : str
        Title of the section of the page that it follows; empty: it stands before fairness and limitations.
    """

    title: str
    make: Callable[["StudyResults"], Iterable[ReportBlock]]
    after: str = ""

    @property
    def description(self) -> str:
        """What ``ddpc-cosim list`` says of it."""
        return f"section of the report: {self.title}"
