"""What commands print: nothing acts on a terminal, where no word is broken; nobody has to read it."""

import io
import os
import shutil
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any, TypeVar

import click

from ddpc_cosim.errors import CosimWarning
from ddpc_cosim.texts import printable

if TYPE_CHECKING:  # which takes a while to import
    from rich.console import Console
    from rich.table import Table

_WIDE, _UNLIMITED = 1000, 10_000
_LONGEST = 20_000

Column = TypeVar("Column")


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
    """Let this process print whatever, wherever, and whether or not someone reads it."""
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
    """Return what prints tables: where neither a terminal nor $COLUMNS limits them, as wide as they are."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() or "COLUMNS" in os.environ else _WIDE)


def fitting(
    console: "Console", columns: Sequence[Column], table_of: Callable[[Sequence[Column], bool], "Table"]
) -> tuple["Table", Sequence[Column]]:
    """Return a table with as many of the first columns as fit, and the columns that are left out.

    Parameters
    ----------
    console : rich.console.Console
        Where it is printed.
    columns : sequence
        What tells most comes first; that stays in any case.
    table_of : callable
        Takes columns, and whether their headings are to be narrow, and returns a table.
    """
    unlimited = console.options.update(width=_UNLIMITED)
    for count, narrow in [(len(columns), False), *((n, True) for n in range(len(columns), 0, -1))]:
        table = table_of(columns[:count], narrow)
        if console.measure(table, options=unlimited).maximum <= console.width:
            break
    return table, columns[count:]
