"""Layouts of logs that are not tables with a separator: aligned columns, and exports of TwinCAT Scope."""

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.files.csv_files import delimiter_of
from ddpc_cosim.files.log_dates import is_clock, is_date
from ddpc_cosim.variables import FloatArray
from fmu_plants.units import is_unit

_SEPARATORS = re.compile(r"[;,|\"]")
_GAP = re.compile(r"\s{2,}|\t")
_TITLE = re.compile(r"[^\s\[(]+(?:\s?\[[^\]]*\]|\s?\([^)]*\))?")  # with a unit that may follow
_COMMENT = "#%"  # how programs mark a header above columns of numbers

_NAME = "Name"
_OF_SCOPE = ("SampleTime[ms]", "Starttime of export", "StartRecord")
_BEGINS = ("Starttime of export", "StartRecord")
_END = "EOF"
_1601 = 116_444_736_000_000_000  # from 1601 to 1970 in 100 ns, as Windows counts
_FULL_STAMPS = 1e16  # from which on a time is not milliseconds since the export's start


def aligned(lines: Sequence[str]) -> Callable[[str], str] | None:
    """Return what separates the cells of a file by tabs whose columns are aligned; None if they are not.

    Parameters
    ----------
    lines : sequence of str
        The first lines of the file.
    """
    filled = [line for line in lines if line.strip()]
    if any(line.startswith(_OF_SCOPE) for line in filled):
        return None
    for i, line in enumerate(filled):
        if _SEPARATORS.search(line) or ("\t" in line and "\t\t" not in line.strip()):
            continue
        title = line.strip().lstrip(_COMMENT).strip()
        # Names may have blanks in them where columns are further apart.
        for header in ([*filter(None, map(str.strip, _GAP.split(title)))], _TITLE.findall(title)):
            below = [row for row in filled[i + 1 : i + 3] if not _are_units(row.split(), len(header))]
            row = below[0] if below and _is_row(below[0], len(header)) else ""
            if len(header) > 1 and row:
                return _Aligned(line.strip(), header, len(row.split()) > len(header))
    return None


def _is_row(line: str, width: int) -> bool:
    cells = line.split()
    has_numbers = any(map(_is_number, cells)) and not re.search(r"[;|]|,(?:\s|$)", line)
    return has_numbers and len(cells) in (width, width + _is_cut(cells))


def _are_units(cells: Sequence[str], width: int) -> bool:
    return len(cells) == width and all(is_unit(cell.strip("[]()")) for cell in cells)


def _is_number(cell: str) -> bool:
    with suppress(ValueError):
        float(cell.replace(",", "."))
        return True
    return False


def _is_cut(cells: Sequence[str]) -> bool:
    """Whether a row begins with a date and a time of the day."""
    return len(cells) > 1 and is_date(cells[0]) and is_clock(cells[1])


@dataclass(frozen=True, slots=True)
class _Aligned:
    """Separates cells by tabs; ``is_joined``: date and time of the day are one of them."""

    line: str
    header: list[str]
    is_joined: bool

    def __call__(self, line: str) -> str:
        cells = self.header if line.strip() == self.line else line.split()
        if self.is_joined and _is_cut(cells):
            cells = [" ".join(cells[:2]), *cells[2:]]
        return "\t".join(cells) + "\n"


class Scope(NamedTuple):
    """What stands above the rows of an export of TwinCAT Scope.

    Its columns are groups: times in ms since the export's start, or in 100 ns since 1601, and the channels
    that were recorded then. Rows end where no channel has a sample any more.

    Parameters
    ----------
    delimiter : str
        What separates cells.
    header, units : tuple of str
        Of the n columns; empty where a column has times.
    times : tuple of int
        The columns that have times, the first of each group.
    begin : int
        When the export starts, in microseconds since 1970; 0: not known.
    skipped : int
        Lines up to the first row.
    """

    delimiter: str
    header: tuple[str, ...]
    units: tuple[str, ...]
    times: tuple[int, ...]
    begin: int
    skipped: int

    @classmethod
    def of(cls, lines: Sequence[str]) -> "Scope | None":
        """Return what the first lines of a file say; None if they are not those of such an export.

        Raises
        ------
        ValueError
            It is one whose cells cannot be told from each other.
        """
        if not any(line.startswith(_OF_SCOPE) for line in lines):
            return None
        first = next((line for line in lines if line.strip()), "")
        delimiter = delimiter_of(first)
        rows = [[cell.strip().strip('"') for cell in line.split(delimiter)] for line in lines]
        titles = [i for i, row in enumerate(rows) if row[0] == _NAME]
        if not titles or not {*_OF_SCOPE} & {row[0] for row in rows}:
            raise ValueError(
                "an export of TwinCAT Scope whose separator may stand in names and times: export it with "
                "tabs or semicolons between its columns"
            )
        head = rows[titles[-1]]
        times = tuple(i for i, cell in enumerate(head) if cell == _NAME)
        said = {row[0]: row for row in rows[titles[-1] :] if row[0]}
        units = [*said.get("Unit", []), *[""] * len(head)][: len(head)]
        begin = next((row[1] for row in rows if row[0] in _BEGINS and len(row) > 1 and row[1].isdigit()), "")
        at = next((i for i in range(titles[-1] + 1, len(rows)) if _is_number(rows[i][0])), len(rows))
        return cls(
            delimiter,
            tuple("" if i in times else cell for i, cell in enumerate(head)),
            tuple("" if i in times else cell.partition("(")[0].strip() for i, cell in enumerate(units)),
            times,
            (int(begin) - _1601) // 10 if begin else 0,
            at,
        )

    def is_end(self, row: Sequence[str]) -> bool:
        """Whether a row says that nothing follows."""
        return [*filter(None, row)] == [_END]

    def group_of(self, column: int) -> int:
        """Return which of the columns of times a column belongs to."""
        return max(i for i, time in enumerate(self.times) if time <= column)

    def instants(self, time: FloatArray) -> FloatArray:
        """Return times as microseconds since 1970, or since the start of an export that does not say it."""
        if np.nanmin(time, initial=np.inf) >= _FULL_STAMPS:
            return (time - _1601) / 10
        return np.round(1e3 * time) + self.begin


class Union(NamedTuple):
    """Rows at all times at which any of several groups has one.

    Parameters
    ----------
    instants : array, shape (T,)
        The times, increasing.
    rows : list of (array, array)
        Of each group, its rows in the file and where they are among those of all.
    """

    instants: NDArray[np.int64]
    rows: list[tuple[NDArray[np.int64], NDArray[np.int64]]]

    @classmethod
    def of(cls, times: Sequence[FloatArray]) -> "Union":
        """Return the rows of groups with these times, NaN where a group has no row."""
        known = [np.flatnonzero(np.isfinite(time)) for time in times]
        stamps = [time[rows].astype(np.int64) for time, rows in zip(times, known, strict=True)]
        instants = np.unique(np.concatenate(stamps))
        return cls(
            instants,
            [(rows, np.searchsorted(instants, stamp)) for rows, stamp in zip(known, stamps, strict=True)],
        )
