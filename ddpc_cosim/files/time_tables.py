"""Tables over time as they lie in resources of others: read as far as they can be, with all that is wrong.

A table is a CSV file with a column ``time``, in s unless its header has a unit. Lines before the header that
begin with ``#`` are comments; one such as ``# TDryBul: outdoor temperature [K]`` says the unit of a column,
and so does a header that ends in it after a blank, ``TDryBul [K]``. Brackets without the blank are part of a
name, as of the zones in ``LowerSetp[1]``.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ddpc_cosim.errors import ConfigError, DataError
from ddpc_cosim.files.csv_files import CSVFile
from ddpc_cosim.files.texts import clipped
from ddpc_cosim.variables import FloatArray, Variable, converter
from fmu_plants.spelling import did_you_mean

TIME = "time"
LARGEST = 100_000_000  # bytes
_DAY, _YEAR = 86_400.0, 365 * 86_400.0
_HEADER = re.compile(r"(?P<name>.*\S)\s+\[(?P<unit>[^\[\]]*)\]", re.DOTALL)
_SAID = re.compile(r"#+\s*(?P<name>[^\s:]+)\s*:[^\n]*\[(?P<unit>[^\[\]\n]*)\][\s,;]*")
_LONGEST_CELL = 40


class Statistics(NamedTuple):
    """Of the cells of a column that are numbers."""

    min: float
    mean: float
    max: float


@dataclass(frozen=True, slots=True, eq=False)
class TimeTable:
    """A table over time.

    Parameters
    ----------
    file : str
        What it is called.
    time : array, shape (n,)
        Increasing times [s].
    values : array, shape (n, columns)
        Its columns, time along axis 0; NaN where a cell is not a finite number.
    columns : tuple of str
        Their headers, without units.
    units : mapping of str to str
        The units that the file says, by column.
    faults : tuple of str
        What is wrong with it, with file and line; rows and cells that cannot be read are left out.
    """

    file: str
    time: FloatArray
    values: FloatArray
    columns: tuple[str, ...]
    units: Mapping[str, str] = field(default_factory=dict)
    faults: tuple[str, ...] = ()

    @property
    def period(self) -> float:
        """After which time all of it comes again [s]: whole days, of a table over a year; 0: never."""
        if len(self.time) < 2:
            return 0.0
        span = float(self.time[-1] - self.time[0])
        if span < _YEAR or span % _DAY:  # a last value holds as long as the one before it
            span += float(self.time[-1] - self.time[-2])
        return math.floor(span / _DAY) * _DAY if span >= _YEAR else 0.0

    def statistics(self, column: str) -> Statistics:
        """Return least value, mean and largest value of a column, NaN where none of its cells is a number."""
        values = self.values[:, self.columns.index(column)]
        values = values[np.isfinite(values)]
        if not values.size:
            return Statistics(math.nan, math.nan, math.nan)
        return Statistics(float(values.min()), float(values.mean()), float(values.max()))

    def column(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return times [s] and values of a column, both of shape (n,), of one period where it has one.

        Raises
        ------
        DataError
            There is no such column, or not all of its cells are numbers.
        """
        if name not in self.columns:
            raise DataError(f'{self.file}: no column "{name}"; {did_you_mean(name, self.columns)}')
        values = self.values[:, self.columns.index(name)]
        if wrong := int(np.count_nonzero(~np.isfinite(values))):
            raise DataError(f'{self.file}: column "{name}": {wrong} of {len(values)} cells are not numbers')
        within = self.time < self.time[0] + self.period if self.period else slice(None)
        return self.time[within], values[within]


def read_time_table(file: str, content: bytes) -> TimeTable:
    """Return the table that a file holds.

    Parameters
    ----------
    file : str
        What it is called.
    content : bytes
        What it holds.

    Raises
    ------
    DataError
        It is no table over time: not text, too large, without a column ``time``, or without rows.
    """
    if len(content) > LARGEST:
        size, most = len(content) / 1e6, LARGEST / 1e6
        raise DataError(f"{file}: {size:.0f} MB are too many; allowed: {most:.0f} MB")
    faults = list[str]()
    text = _text(file, content, faults)
    comments, begin = _comments(text)
    header, delimiter = _header(file, text, begin)
    names, units = _names(header, comments)
    rows = _fast(text, begin, delimiter, len(names))
    if rows is None:
        rows = _slow(file, text, faults)
    if TIME not in (known := [name.lower() for name in names]):
        shown = ", ".join(clipped(name, _LONGEST_CELL) for name in names[:3])
        raise DataError(f'{file}: no column "{TIME}" (it begins with {shown}): it is not a table over time')
    index = known.index(TIME)
    time = _in_seconds(file, rows[:, index], units.pop(names[index], ""), faults)
    kept = _increasing(time)
    if lost := int(np.count_nonzero(~kept)):
        faults.append(f"{file}: {lost} of {len(time)} rows are left out: times must be numbers that increase")
    if not kept.any():
        raise DataError(f"{file}: a header and no rows that can be read")
    usable = [i for i, name in enumerate(names) if i != index and name and name not in names[:i]]
    if twice := sorted({name for name in names if name and names.count(name) > 1}):
        faults.append(f"{file}: columns that are there more than once, of which the first counts: {twice}")
    values = np.where(np.isfinite(rows), rows, np.nan)[kept][:, usable]
    columns = tuple(names[i] for i in usable)
    return TimeTable(file, time[kept], values, columns, units, tuple(faults))


def _text(file: str, content: bytes, faults: list[str]) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        faults.append(f"{file}, line {line}: not UTF-8 text; Windows-1252 was assumed")
        return content.decode("cp1252", errors="replace")


def _comments(text: str) -> tuple[dict[str, str], int]:
    """Return the units that comments before the header say, and where the header begins."""
    units, begin = dict[str, str](), 0
    while begin < len(text):
        end = text.find("\n", begin)
        end = len(text) if end < 0 else end
        line = text[begin:end].strip().strip('"')
        if line and not line.startswith("#"):
            break
        if said := _SAID.fullmatch(line):
            units[said["name"]] = said["unit"].strip()
        begin = end + 1
    return units, begin


def _header(file: str, text: str, begin: int) -> tuple[tuple[str, ...], str]:
    """Return the cells of the header, and what separates them."""
    end = text.find("\n", begin)
    parsed = CSVFile(Path(file), text[begin : len(text) if end < 0 else end])
    return parsed.header, parsed.delimiter


def _names(header: tuple[str, ...], comments: Mapping[str, str]) -> tuple[list[str], dict[str, str]]:
    """Return names and units of columns; one of a zone has the unit of all zones."""
    names, units = list[str](), dict[str, str]()
    for cell in header:
        match = _HEADER.fullmatch(cell)
        name = match["name"] if match else cell
        unit = match["unit"].strip() if match else comments.get(name, comments.get(base_name(name), ""))
        names.append(name)
        if unit:
            units.setdefault(name, unit)
    return names, units


def base_name(column: str) -> str:
    """Return the name of a column without the zone that it is of: LowerSetp of LowerSetp[1]."""
    return column.partition("[")[0]


def _fast(text: str, begin: int, delimiter: str, columns: int) -> FloatArray | None:
    """Return the rows, shape (n, columns), of a file in which all cells are numbers; None of others."""
    start = text.find("\n", begin)
    if start < 0 or not text[start:].strip():
        return np.empty((0, columns))
    try:
        rows = np.loadtxt(StringIO(text[start:]), delimiter=delimiter, ndmin=2, comments=None)
    except ValueError:
        return None
    return rows if rows.shape[1] == columns and np.isfinite(rows).all() else None


def _slow(file: str, text: str, faults: list[str]) -> FloatArray:
    """Return the rows, NaN where a cell is not a number, and report the first of those of each column."""
    lines = "\n".join("" if line.lstrip('" \t').startswith("#") else line for line in text.split("\n"))
    parsed = CSVFile(Path(file), lines)
    faults += parsed.faults[:_MOST]
    rows = np.full((len(parsed.rows), len(parsed.header)), np.nan)
    for j, header in enumerate(parsed.header):
        cells = parsed.cells(j)
        if parsed.delimiter != ",":
            cells = [cell.replace(",", ".") for cell in cells]
        rows[:, j] = [*map(_number, cells)]
        wrong = np.flatnonzero(~np.isfinite(rows[:, j]))
        if wrong.size:
            cell = clipped(cells[wrong[0]].strip(), _LONGEST_CELL)
            where = f'{file}, line {parsed.lines[wrong[0]]}, column "{clipped(header, _LONGEST_CELL)}"'
            faults.append(f'{where}: "{cell}" is not a finite number ({wrong.size} such cells)')
    return rows


_MOST = 8


def _number(cell: str) -> float:
    try:
        return math.nan if "_" in cell else float(cell)
    except ValueError:
        return math.nan


def _in_seconds(file: str, time: FloatArray, unit: str, faults: list[str]) -> FloatArray:
    try:
        seconds: FloatArray = converter(Variable(TIME, "s"), unit)(time)
    except ConfigError as error:
        faults.append(f"{file}: {error}; s was assumed")
        return time
    return seconds


def _increasing(time: FloatArray) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":
    """Return which times are finite, and after all those before them."""
    finite = np.where(np.isfinite(time), time, -np.inf)
    before = np.concatenate([[-np.inf], np.maximum.accumulate(finite)[:-1]])
    return np.isfinite(time) & (finite > before)
