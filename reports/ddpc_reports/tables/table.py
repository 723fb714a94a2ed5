"""A table of the page: its cells, which of them are best, and the same as CSV."""

import csv
import io
import math
from base64 import b64encode
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from ddpc_cosim.texts import csv_text, encodable
from ddpc_reports.comparison import ControllerResults
from ddpc_reports.numbers import MISSING, apart, column

Raw = float | int | str


@dataclass(frozen=True)
class Heading:
    """The head of a column.

    Parameters
    ----------
    title : str
        What the column shows.
    detail : str
        A second line in small print.
    numeric : bool
        Whether the column shows numbers.
    group : str
        Title above this column and its neighbours of the same group.
    href, group_href : str
        Where on the page the title and the group's title lead.
    """

    title: str
    detail: str = ""
    numeric: bool = True
    group: str = ""
    href: str = ""
    group_href: str = ""

    @property
    def words(self) -> str:
        """All of it in one line."""
        return " ".join(filter(None, (self.group, self.title, self.detail and f"({self.detail})")))


def text_headings(*titles: str) -> tuple[Heading, ...]:
    """Return the heads of columns of text."""
    return tuple(Heading(title, numeric=False) for title in titles)


@dataclass(frozen=True)
class Cell:
    """One cell.

    Parameters
    ----------
    text : str
        What is shown.
    raw : float, int or str
        The value behind it, to sort by and to save.
    best, failed, differs : bool
        Marks: the best of its column, a failure, another value than in the first column.
    tone : str
        A class of the page, for a colour behind the number.
    href : str
        Where on the page the text leads.
    title : str
        What is told to who points at it.
    detail, failures : str
        A second and a third line in small print; the last in red, behind a mark.
    """

    text: str
    raw: Raw = ""
    best: bool = False
    failed: bool = False
    differs: bool = False
    tone: str = ""
    href: str = ""
    title: str = ""
    detail: str = ""
    failures: str = ""


@dataclass(frozen=True)
class Row:
    """One row: its header, the controller whose colour it carries, and its cells."""

    header: str
    cells: tuple[Cell, ...]
    key: str = ""
    colour: int | None = None
    group: str = ""


@dataclass(frozen=True)
class Table:
    """A table with its caption, ready to be set."""

    id: str
    caption: str
    headings: tuple[Heading, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()
    sortable: bool = False
    kind: str = ""
    download: str = field(default="")

    @property
    def head(self) -> list[tuple[str, list[Heading]]]:
        """Headings, neighbours of the same group together; those without a group one by one."""
        spans: list[tuple[str, list[Heading]]] = []
        for heading in self.headings:
            if heading.group and spans and spans[-1][0] == heading.group:
                spans[-1][1].append(heading)
            else:
                spans.append((heading.group, [heading]))
        return spans

    @property
    def groups(self) -> dict[str, list[Row]]:
        """Rows by group, in the order in which the groups first occur."""
        groups: dict[str, list[Row]] = {}
        for row in self.rows:
            groups.setdefault(row.group, []).append(row)
        return groups

    @property
    def csv_name(self) -> str:
        """Name of the file that a reader saves."""
        return self.download or f"{self.id}.csv"

    @property
    def csv_uri(self) -> str:
        """The table as CSV in a data URI: values in full, no links to anything outside the page."""
        buffer = io.StringIO(newline="")
        writer = csv.writer(buffer, lineterminator="\n")
        grouped = any(row.group for row in self.rows)
        heads = [csv_text(heading.words) for heading in self.headings]
        writer.writerow(["group", *heads] if grouped else heads)
        for row in self.rows:
            texts = [row.group] * grouped + [row.header]
            writer.writerow([*map(csv_text, texts), *(_csv_value(cell) for cell in row.cells)])
        content = encodable(buffer.getvalue()).encode()
        return "data:text/csv;charset=utf-8;base64," + b64encode(content).decode("ascii")


def _csv_value(cell: Cell) -> str:
    if isinstance(cell.raw, float):
        return "" if math.isnan(cell.raw) else repr(cell.raw)
    return csv_text(str(cell.raw) if cell.raw != "" else cell.text)


Alike = Callable[[int], Collection[int]]
"""Of the place of a controller in a column, the places of those that the seeds do not tell apart from it."""
Column = tuple[Heading, list[Cell]]
"""A heading and a cell for each row."""


def controller_table(
    identifier: str,
    caption: str,
    controllers: Sequence[ControllerResults],
    columns: Sequence[Column],
    notes: tuple[str, ...],
    download: str,
    **more: Any,
) -> Table:
    """Return a table with a row per controller; ``more`` are further fields of it."""
    rows = tuple(
        Row(one.label, tuple(cells[i] for _, cells in columns), one.key, one.index)
        for i, one in enumerate(controllers)
    )
    headings = (Heading("Controller", numeric=False), *(heading for heading, _ in columns))
    return Table(identifier, caption, headings, rows, notes, download=download, **more)


def number_cells(
    values: Sequence[float],
    *,
    eligible: Iterable[bool] = (),
    better: Literal["low", "high", ""] = "low",
    digits: int = 4,
    alike: Alike | None = None,
) -> list[Cell]:
    """Return a column of cells with decimal points in line; the lowest or highest eligible value is the best.

    Those that are ``alike``, else values that read alike, share the mark; where more than half do, none is
    best.
    """
    texts = column(values, digits)
    able = list(eligible) or [False] * len(values)
    best = _best(values, texts, able, better, alike) if better else set()
    return [
        Cell(text, value, best=i in best) for i, (text, value) in enumerate(zip(texts, values, strict=True))
    ]


def interval_texts(ends: Sequence[tuple[float, float]]) -> list[str]:
    """Write the intervals of a column with common decimals, more where they would have no width."""
    lows, highs = (column([one[i] for one in ends]) for i in (0, 1))
    return [
        MISSING
        if math.isnan(one[0])
        else " … ".join(apart(*one) if low == high and one[0] < one[1] else (low.strip(), high.strip()))
        for one, low, high in zip(ends, lows, highs, strict=True)
    ]


def _best(
    values: Sequence[float],
    texts: Sequence[str],
    able: Sequence[bool],
    better: Literal["low", "high"],
    alike: Alike | None,
) -> set[int]:
    known = [i for i, value in enumerate(values) if able[i] and not math.isnan(value)]
    if len(known) < 2:
        return set()
    first = (min if better == "low" else max)(known, key=lambda i: values[i])
    others = alike(first) if alike else [i for i in known if texts[i] == texts[first]]
    best = {first, *others} & {*known}
    # What most of them reach distinguishes none of them.
    return best if 2 * len(best) <= len(known) else set()
