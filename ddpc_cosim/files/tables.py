"""A table, once for all formats: page, terminal, Markdown, CSV, JSON and notebook set the same cells.

CSV and notebook are here, as they need nothing else; the terminal's is in ``ddpc_cosim.cli.output``, those of
the report's formats in ``ddpc_reports``.
"""

import csv
import html
import math
from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from io import StringIO
from itertools import chain, islice
from typing import TYPE_CHECKING, Any, TextIO

from ddpc_cosim.files.texts import csv_text, encodable, printable, recorded

if TYPE_CHECKING:
    import pandas as pd

Raw = float | int | str
_DASH = "\N{EN DASH}"
_ROWS_AT_ONCE = 1000


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
    wraps : bool
        Whether the column holds sentences, which the terminal may set in several lines.
    colour : int, optional
        Number in the page of the controller that the column is of.
    """

    title: str
    detail: str = ""
    numeric: bool = True
    group: str = ""
    href: str = ""
    group_href: str = ""
    wraps: bool = False
    colour: int | None = None

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
        A class of the page, for a colour behind the number; in the terminal a colour of the text.
    href : str
        Where on the page the text leads.
    title : str
        What is told to who points at it.
    detail, failures : str
        A second and a third line in small print; the last in red, behind a mark.
    drawing : str
        Of the page alone, a picture below the text: SVG.
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
    drawing: str = ""

    @property
    def value(self) -> Raw:
        """The value behind it, or what is shown where there is none."""
        return self.raw if self.raw != "" else self.text


@dataclass(frozen=True)
class Row:
    """One row.

    Parameters
    ----------
    header : str
        What it is of.
    cells : tuple of Cell
        The others.
    key : str
        The controller that it is of, by its name in the study.
    colour : int, optional
        Number of that controller, from which it has colour and dashes.
    group : str
        Title above this row and its neighbours of the same group.
    drawing : str
        Of the page alone, a picture of the row: SVG.
    """

    header: str
    cells: tuple[Cell, ...]
    key: str = ""
    colour: int | None = None
    group: str = ""
    drawing: str = ""


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
    drawn: str = ""
    """Of the page alone, the title of a column with the pictures of the rows."""

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
    def csv(self) -> str:
        """The table as CSV: values in full, no links."""
        grouped = any(row.group for row in self.rows)
        header = ["group"] * grouped + [heading.words for heading in self.headings]
        rows = (
            [*[row.group] * grouped, row.header, *(cell.value for cell in row.cells)] for row in self.rows
        )
        return encodable(table_text(header, rows))

    @property
    def csv_uri(self) -> str:
        """The CSV in a data URI."""
        return f"data:text/csv;charset=utf-8;base64,{b64encode(self.csv.encode()).decode('ascii')}"

    def frame(self) -> "pd.DataFrame":
        """Return the values behind the cells, a row each, as a DataFrame."""
        import pandas as pd

        rows = [[row.header, *(cell.value for cell in row.cells)] for row in self.rows]
        return pd.DataFrame(rows, columns=[heading.words for heading in self.headings])

    def __repr__(self) -> str:
        return self.text

    def _repr_html_(self) -> str:
        return self.html

    @property
    def text(self) -> str:
        """The table for a terminal: its caption, and columns as wide as they need to be."""
        cells = [[heading.words for heading in self.headings]]
        cells += [[row.header, *(cell.text for cell in row.cells)] for row in self.rows]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in cells]
        return "\n".join(map(printable, [*filter(None, [self.caption]), *lines]))

    @property
    def html(self) -> str:
        """The table for a notebook; nothing of its texts acts on the page."""

        def cells(texts: Iterable[str], tag: str) -> str:
            return "".join(f"<{tag}>{html.escape(recorded(text))}</{tag}>" for text in texts)

        body = "".join(
            f"<tr>{cells((row.header, *(cell.text for cell in row.cells)), 'td')}</tr>" for row in self.rows
        )
        head = f"<tr>{cells((heading.words for heading in self.headings), 'th')}</tr>"
        return f"<table><caption>{html.escape(recorded(self.caption))}</caption>{head}{body}</table>"


def plain_table(caption: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> Table:
    """Return a table of any values, numbers with four digits."""

    def text(value: object) -> str:
        if isinstance(value, float):
            return _DASH if math.isnan(value) else f"{value:.4g}"
        return recorded(value)

    texts = [[*map(text, row)] for row in rows]
    return Table(
        "",
        caption,
        text_headings(*header),
        tuple(Row(first, tuple(map(Cell, others))) for first, *others in texts),
    )


def write_rows(file: TextIO, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a header and rows as CSV, cells as they stand."""
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)


def table_text(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as CSV for people and their programs.

    A number is the shortest text that gives it again, NaN an empty cell, a truth ``true`` or ``false``; texts
    are such that a spreadsheet does not take them for formulas.
    """
    return "".join(table_parts(header, rows))


def table_parts(header: Sequence[str], rows: Iterable[Sequence[object]]) -> Iterator[str]:
    """Yield some rows of :func:`table_text` after the other, the header first."""
    cells = chain([[*map(csv_text, header)]], ([*map(_cell, row)] for row in rows))
    while part := [*islice(cells, _ROWS_AT_ONCE)]:
        file = StringIO(newline="")
        write_rows(file, part[0], part[1:])
        yield file.getvalue()


def _cell(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return "" if math.isnan(value) else repr(value)
    return csv_text(value) if isinstance(value, str) else str(value)


def csv_records(text: str, **dialect: Any) -> Iterator[tuple[int, list[str]]]:
    """Yield the line on which each row of a CSV file ends, and its cells.

    Raises
    ------
    ValueError
        It is not a CSV file, in words after the file's name.
    """
    reader = csv.reader(StringIO(text, newline=""), **dialect)
    try:
        for row in reader:
            yield reader.line_num, row
    except csv.Error as error:
        raise ValueError(f"line {reader.line_num}: not a CSV file: {error}") from error


def own_rows(text: str) -> tuple[list[str], list[list[str]]]:
    """Return the header and the rows of a file that this program has written, cells as they stand.

    Raises
    ------
    ValueError
        It is not a CSV file, or empty.
    """
    header, *rows = (row for _, row in csv_records(text))
    return header, rows
