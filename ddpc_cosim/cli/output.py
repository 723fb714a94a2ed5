"""What commands print: no text controls a terminal or breaks a word; a reader that has gone is no error."""

import io
import os
import shutil
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import click

from ddpc_cosim.errors import CosimWarning
from ddpc_cosim.files.tables import Cell, Table
from ddpc_cosim.files.texts import printable

if TYPE_CHECKING:  # which takes a while to import
    from rich.console import Console
    from rich.table import Table as RichTable

_WIDE, _UNLIMITED = 1000, 10_000
_LONGEST, _SHORTEST_HEADING = 20_000, 5


class _WhileRead(io.FileIO):
    """A pipe whose reader may go, as ``head`` does when it has enough: what is written later goes nowhere."""

    def write(self, content: Any) -> int:
        try:
            return super().write(content) or 0
        except BrokenPipeError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.fileno())
            os.close(nowhere)
            return len(content)


def open_streams() -> None:
    """Let this process print any text to any encoding, also where its reader has gone."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by whoever started this process
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115 - to the end
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # for what its encoding does not have
            if stream is getattr(sys, f"__{name}__") and not stream.isatty():
                pipe = io.BufferedWriter(_WhileRead(stream.fileno(), "w", closefd=False))
                how = {"encoding": stream.encoding, "errors": stream.errors}
                setattr(sys, name, io.TextIOWrapper(pipe, **how, line_buffering=stream.line_buffering))


def say(text: str, *, err: bool = False, keep: str = "") -> None:
    """Print a text on stdout or stderr, written out but for what is kept, such as line breaks."""
    click.echo(harmless(text, err=err, keep=keep), err=err)


def harmless(text: str, *, err: bool = False, keep: str = "") -> str:
    """Return a text of any origin for stdout or stderr; on a terminal its lines end between words.

    They go on indented, so that none of them can be taken for one of this program's own.
    """
    text = printable(text, _LONGEST, keep=keep)
    if not (sys.stderr if err else sys.stdout).isatty():
        return text
    width = shutil.get_terminal_size().columns
    return "\n".join(part for line in text.split("\n") for part in wrapped(line, width, indent="  ") or [""])


@contextmanager
def warnings_in_one_line() -> Iterator[None]:
    """Print what is not quite right with a plant in one line each."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", CosimWarning)
        yield
    for message in dict.fromkeys(str(warning.message) for warning in caught):
        say(f"warning: {message}", err=True)


def wrapped(text: str, width: int, *, indent: str = "") -> list[str]:
    """Return a text in lines that end between words."""
    return wrap(text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def clipped(text: str, longest: int) -> str:
    """Return a text, written out; of a longer one the beginning, and an ellipsis."""
    text = printable(text[: longest + 1])
    return text if len(text) <= longest else f"{text[: longest - 1]}\u2026"


def screen() -> "Console":
    """Return a console for tables: as wide as they are where neither terminal nor $COLUMNS limits them."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() or "COLUMNS" in os.environ else _WIDE)


def terminal_table(
    table: Table,
    *,
    columns: Sequence[int] | None = None,
    ruled: bool = False,
    longest: int | None = None,
) -> "RichTable":
    """Return a table for the terminal.

    Parameters
    ----------
    table : Table
        Its caption stands above it; its notes are left out.
    columns : sequence of int, optional
        Those that are shown; default: in which anything stands.
    ruled : bool
        Whether there is a rule below the headings.
    longest : int, optional
        Letters of names where the window is narrow; sentences have half of them, and headings no more than
        what stands below them. Default: as many as there are.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table as RichTable
    from rich.text import Text

    shown = used_columns(table) if columns is None else columns
    rich = RichTable(
        title=Text(printable(table.caption), "bold") if table.caption else None,
        title_justify="left",
        box=SIMPLE_HEAD if ruled else None,
        pad_edge=False,
        show_header=any(heading.words for heading in table.headings),
    )
    cells = [[Cell(row.header, best=table.kind == "facts"), *row.cells] for row in table.rows]
    for i in shown:
        heading = table.headings[i]
        lines = [text for text in (printable(heading.title), printable(heading.detail)) if text]
        if longest and not heading.wraps:
            texts = [row[i].text for row in cells if i < len(row)]
            room = max([_SHORTEST_HEADING, *map(len, texts), *map(len, heading.detail.split())])
            lines = [part for line in lines for part in wrapped(line, room)]
        widest = longest // 2 if longest and heading.wraps else longest
        rich.add_column(
            Text("\n".join(lines)),
            justify="right" if heading.numeric else "left",
            vertical="top" if any(other.wraps for other in table.headings) else "bottom",
            no_wrap=not heading.wraps,
            overflow="fold" if heading.wraps else "ellipsis",
            max_width=None if heading.numeric else widest,
        )
    for row in cells:
        rich.add_row(*(Text(printable(row[i].text, _LONGEST), _style(row[i])) for i in shown if i < len(row)))
    return rich


def _style(cell: Cell) -> str:
    return " ".join(filter(None, ("bold" * cell.best, "red" if cell.failed else cell.tone)))


def used_columns(table: Table) -> list[int]:
    """Return the places of the columns in which anything stands: others only take room."""
    rows = [(row.header, *(cell.text for cell in row.cells)) for row in table.rows]
    return [i for i in range(len(table.headings)) if any(row[i] for row in rows if i < len(row))]


def fitting(
    console: "Console", table: Table, longest: int, *, fewest: int = 1
) -> tuple["RichTable", list[int]]:
    """Return a table with as many of the first columns as fit, and the places of those that are left out.

    Parameters
    ----------
    console : rich.console.Console
        Where it is printed.
    table : Table
        What tells most comes first.
    longest : int
        Letters of names where the window is too narrow for all of it.
    fewest : int
        Of so many first columns those that are not empty stay in any case.
    """
    unlimited = console.options.update(width=_UNLIMITED)
    used = used_columns(table)
    least = sum(i < fewest for i in used)
    tries = [(len(used), None), *((count, longest) for count in range(len(used), least - 1, -1))]
    for count, names in tries:
        rich = terminal_table(table, columns=used[:count], ruled=True, longest=names)
        if console.measure(rich, options=unlimited).maximum <= console.width:
            break
    return rich, used[count:]
