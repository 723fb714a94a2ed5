"""The cells of one file of logged data as numbers, converted piece by piece as a large one needs."""

import codecs
import csv
import re
from array import array
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.errors import ConfigError, DataError
from ddpc_cosim.files.csv_files import (
    PARQUET,
    Column,
    delimiter_of,
    find_column,
    load_pyarrow,
    require_readable,
    split_unit,
)
from ddpc_cosim.files.log_dates import (
    NO_TIME,
    Dates,
    Instants,
    dates_at,
    epochs,
    excel_dates,
    is_clock,
    is_date,
    read_clocks,
    read_dates,
)
from ddpc_cosim.files.log_format import Faults, LogFormat
from ddpc_cosim.files.log_layouts import Scope, Union, aligned
from ddpc_cosim.variables import FloatArray, Variable, converter
from fmu_plants.units import display_unit, is_unit

_LARGEST = 4_000_000_000
_ROWS = 20_000  # that are converted at once
_BLOCK = 1 << 20
_HEAD = 60  # lines among which the header is
_TIME = Variable("time", unit="s")
_TIME_HINT = " (time_column says which column the time is)"
_SEPARATOR = re.compile(r"\s*\"?sep=(.)\"?\s*")
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:[.,' \u00a0\u202f]\d{3})+(?:[.,]\d+)?|[+-]?\d{1,3}(?:,\d{3})+\.\d+")
_LIKELY_TIME = re.compile(
    r"^(?:time|date|datum|zeit|x_value|t\b)|(?:^|[\s_])(?:time|date|datum|zeit)\b|time\s*stamp|zeitstempel|uhrzeit",
    re.IGNORECASE,
)
_IS_DATE = re.compile(r"^dat", re.IGNORECASE)
_LONGEST_UNIT = 24
_LARGEST_MEASURED = 1e150
"""Numbers beyond are no measurements, as infinite ones are not: their squares are infinite."""
_MEASURED = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?:\s+|(?=[%\u00b0]))([^\d\s]\S*)")
_GROUPED = "thousands are separated there: export numbers without that"
_TRUTHS = {"true": 1.0, "false": 0.0}
_SWITCHED = {"on": 1.0, "off": 0.0, "yes": 1.0, "no": 0.0, "ein": 1.0, "aus": 0.0, "ja": 1.0, "nein": 0.0}
_LONG = {
    "varname": ("varvalue",),
    "entity_id": ("state",),
    "_field": ("_value",),
    **dict.fromkeys(("tag", "tagname", "variable", "point", "signal", "name"), ("value", "wert")),
}
"""How tables with a row for each value of each signal call the column of names, and that of values."""
_END_OF_HEADER = "***End_of_Header***"


@dataclass(slots=True, eq=False)
class LogTable:
    """The numbers of one file.

    Parameters
    ----------
    file : str
        The file.
    names, units : tuple of str
        Of the n columns, without and with the units of their values.
    headers : tuple of str
        The same as the file has them.
    values : array, shape (T, n)
        NaN where a cell is empty or not a number.
    lines : array, shape (T,)
        The line of each row.
    seconds : array, shape (T,)
        The time [s]; NaN where it is not known.
    instants : array, shape (T,), or None
        The same in microseconds since 1970, of dates.
    time_header : str
        Header of the time.
    untimed : dict of int to str
        What is wrong with the time of rows that have none, by row.
    time_remedy : str
        What to do about it.
    are_local : bool
        Dates are local times of an unknown zone.
    words : dict of (int, int) to str
        What stands in the first cells that are not numbers, by row and column.
    reported : set of (int, int)
        Cells that are not numbers and have been reported, by row and column.
    texts : tuple of str
        Headers of the columns that are left out, as they are not numbers.
    codes : int
        How many cells hold a number that stands for a missing value.
    """

    file: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    headers: tuple[str, ...]
    values: FloatArray
    lines: NDArray[np.int64]
    seconds: FloatArray
    instants: Instants | None
    time_header: str
    untimed: dict[int, str]
    time_remedy: str
    are_local: bool
    words: dict[tuple[int, int], str]
    reported: set[tuple[int, int]]
    texts: tuple[str, ...]
    codes: int = 0


class _Numbers:
    """A column of numbers while its cells are read."""

    def __init__(self, *, with_comma: bool) -> None:
        self._with_comma, self._parts, self._rows = with_comma, list[FloatArray](), 0
        self.marks: dict[str, int] = {}
        self.odd: dict[int, str] = {}
        self.words: dict[int, str] = {}
        self.units: dict[str, array[int]] = {}
        self.foreign: dict[int, str] = {}
        self._filled = 0

    @property
    def texts(self) -> dict[int, str]:
        """What is not a number, by row."""
        return self.words | self.odd

    @property
    def are_texts(self) -> bool:
        """Whether most of its cells that are not empty are not numbers."""
        return self._filled > 1 and len(self.texts) > self._filled / 2

    @property
    def is_empty(self) -> bool:
        """Whether it has no cells but empty ones."""
        return not self._filled

    def take(self, cells: Sequence[str]) -> None:
        """Convert cells that follow those before."""
        joined = "\n".join(cells)
        for mark in ",.":
            if mark in joined and mark not in self.marks:
                self.marks[mark] = self._rows + next(i for i, cell in enumerate(cells) if mark in cell)
        said = cells
        if self._with_comma and "," in joined:
            cells = joined.replace(",", ".").split("\n")
            if len(cells) != len(said):  # some have several lines
                cells = [cell.replace(",", ".") for cell in said]
        self._parts.append(self._converted(cells, said, plain="_" not in joined))
        self._rows += len(cells)

    def take_plain(self, values: FloatArray, marks: Iterable[str] = ()) -> None:
        """Take numbers that follow those before, NaN for none, and the decimal marks of their text."""
        for mark in marks:
            self.marks.setdefault(mark, self._rows)
        for i in np.flatnonzero(np.abs(values) > _LARGEST_MEASURED).tolist():
            self.words[self._rows + i] = str(values[i])
            values[i] = np.nan
        self._filled += int(np.count_nonzero(~np.isnan(values)))
        self._parts.append(values)
        self._rows += len(values)

    def _converted(self, cells: Sequence[str], said: Sequence[str], *, plain: bool) -> FloatArray:
        values = None
        if plain:
            with suppress(ValueError):
                values = np.fromiter(map(float, cells), np.float64, len(cells))
            if values is None:
                with suppress(ValueError):
                    values = np.array([float(cell or "nan") for cell in cells])
        if values is None:
            values = np.array([number(cell) for cell in cells], dtype=np.float64)
        beyond = np.abs(values) > _LARGEST_MEASURED
        wrong = np.flatnonzero(beyond | np.isnan(values)).tolist()
        values[wrong] = np.nan
        self._filled += len(cells) - len(wrong)
        for i in wrong:
            if text := said[i].strip():
                self._filled += 1
                if (measured := _MEASURED.fullmatch(cells[i].strip())) and is_unit(measured[2]):
                    values[i] = float(measured[1])
                    self.units.setdefault(measured[2], array("q")).append(self._rows + i)
                    continue
                is_odd = any(letter.isdigit() for letter in text) and not beyond[i]
                kind = self.odd if is_odd else self.words
                kind[self._rows + i] = text[:40]
        return values

    def settle_unit(self, unit: str) -> str:
        """Return the unit of the column: its header's, or that of most cells; others are taken out."""
        if not self.units:
            return unit
        values = self.values
        usual = unit or max(self.units, key=lambda name: len(self.units[name]))
        plain = np.isfinite(values) & (not unit)  # a header says the unit of cells that have none
        for other, rows in self.units.items():
            plain[rows] = False
            if not _are_same(usual, other):
                self.foreign |= dict.fromkeys(rows, f"is in {other}, and the column in {usual}")
        bare = f"has no unit, and the column is in {usual}"
        self.foreign |= dict.fromkeys(np.flatnonzero(plain).tolist(), bare)
        values[[*self.foreign]] = np.nan
        self._parts = [values]
        return usual

    def read_switches(self) -> None:
        """Take ``ON`` and ``OFF`` for 1 and 0, where nothing else is in the column."""
        if not self.odd and self._filled == len(self.words):
            values, read = self.values, {i: _SWITCHED.get(word.lower()) for i, word in self.words.items()}
            if self.words and None not in read.values():
                values[[*read]] = [*read.values()]
                self._parts, self.words = [values], {}

    @property
    def values(self) -> FloatArray:
        """Return what has been read."""
        return np.concatenate([np.empty(0), *self._parts])


def _are_same(unit: str, other: str) -> bool:
    """Whether two names are those of one unit, such as degC and \u00b0C."""
    with suppress(ValueError):
        return replace(display_unit(unit, other), name="") == replace(display_unit(unit, unit), name="")
    return unit == other


def number(cell: str) -> float:
    """Return the number of a cell, 1 and 0 of a truth; NaN of anything else."""
    try:
        return np.nan if "_" in cell else float(cell)
    except ValueError:
        return _TRUTHS.get(cell.strip().lower(), np.nan)


class _Head(NamedTuple):
    """What stands before the rows; ``skipped``: lines up to the header's end."""

    delimiter: str
    header: tuple[str, ...]
    units: tuple[str, ...]
    skipped: int
    scope: Scope | None = None


def read_cells(
    path: Path, format: LogFormat, columns: Sequence[Column] | None, faults: Faults, *, lenient: bool
) -> LogTable:
    """Return the numbers of a file; what is wrong with it is added to the faults.

    Raises
    ------
    DataError
        It cannot be read at all.
    """
    try:
        require_readable(path, _LARGEST)
        if path.suffix == PARQUET:
            return _Reader(path, format, columns, faults, lenient=lenient).parquet()
        encoding = _marked(path) or format.encoding
        try:
            return _Reader(path, format, columns, faults, lenient=lenient).text(encoding)
        except UnicodeDecodeError as error:
            where, what = _not_text(path, encoding)
            if not (lenient and encoding.startswith("utf-8")):
                raise DataError(f"{path}{where}: {what}") from error
            faults.add("encoding", str(path), [(where.removeprefix(", "), what)])
            return _Reader(path, format, columns, faults, lenient=lenient).text("cp1252")
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read: {error}") from error


def headers_of(path: Path, format: LogFormat, names: Collection[str] = ()) -> tuple[str, ...]:
    """Return the headers of the columns of a file.

    Parameters
    ----------
    path : Path
        The file.
    format : LogFormat
        How it is read.
    names : collection of str
        Headers that may be in it, by which they are told from what stands above them.

    Raises
    ------
    DataError
        It cannot be read.
    """
    columns = [Column(None, name) for name in names] or None
    reader = _Reader(path, format, columns, Faults(), lenient=True)
    try:
        require_readable(path, _LARGEST)
        if path.suffix == PARQUET:
            return tuple(load_pyarrow().parquet.read_schema(path).names)
        return reader.head(_marked(path) or format.encoding).header
    except UnicodeDecodeError as error:
        where, what = _not_text(path, format.encoding)
        raise DataError(f"{path}{where}: {what}") from error
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read: {error}") from error


def likely_times(headers: Sequence[str]) -> list[int]:
    """Return which columns are likely to be the time: none, one, or those of date and time."""
    likely = [i for i, title in enumerate(headers) if _LIKELY_TIME.search(title) and _may_be_time(title)]
    if likely and not _IS_DATE.search(headers[likely[0]]):
        return likely[:1]
    return likely[:2]


def _may_be_time(header: str) -> bool:
    with suppress(ConfigError):
        converter(_TIME, split_unit(header)[1])
        return True
    return False


def encoding_of(*paths: Path) -> Literal["utf-8", "cp1252"]:
    """Return how files are likely to be coded that do not begin with a mark that says it."""
    return "utf-8" if all(_marked(path) or _is_utf_8(path) for path in paths) else "cp1252"


def _is_utf_8(path: Path) -> bool:
    decoder = codecs.getincrementaldecoder("utf-8")()
    with path.open("rb") as file, suppress(UnicodeDecodeError):
        while block := file.read(_BLOCK):
            decoder.decode(block)
        return True
    return False


_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


def _marked(path: Path) -> str:
    """Return the encoding that a file's first bytes say; empty if they say none."""
    with path.open("rb") as file:
        begin = file.read(3)
    marked = next((encoding for mark, encoding in _MARKS.items() if begin.startswith(mark)), "")
    without_mark = {b"\0": "utf-16-le"}.get(begin[1:2]) or {b"\0": "utf-16-be"}.get(begin[:1], "")
    return marked or without_mark  # of UTF-16, one of the two bytes of a letter is 0


def _not_text(path: Path, encoding: str) -> tuple[str, str]:
    """Return where a file is not text in an encoding, and what is wrong there."""
    remedy = 'save it as UTF-8, or write encoding = "cp1252" if a spreadsheet has saved it'
    if encoding.startswith("utf-8"):
        with path.open("rb") as file:
            for number, line in enumerate(file, 1):
                try:
                    line.decode()
                except UnicodeDecodeError as error:
                    byte = line[error.start]
                    return f", line {number}", f"not UTF-8 text (byte 0x{byte:02x}): {remedy}"
    return "", f"not {encoding} text; write the encoding that it has"


class _Wanted(NamedTuple):
    """A column of the result: its place in the file, None if it is not there, and how its values convert."""

    name: str
    unit: str
    place: int | None
    convert: Callable[[FloatArray], FloatArray]


class _Reader:
    """Reads one file."""

    def __init__(
        self,
        path: Path,
        format: LogFormat,
        columns: Sequence[Column] | None,
        faults: Faults,
        *,
        lenient: bool,
    ) -> None:
        self._path, self._format, self._columns, self._faults = path, format, columns, faults
        self._lenient, self._file = lenient, str(path)
        self._lines: list[int] = []
        self._instants: list[Instants] = []
        self._with_zone = False
        self._wrong: list[tuple[str, str]] = []
        self._has_more = self._is_aligned = False

    def text(self, encoding: str) -> LogTable:
        """Return the numbers of a CSV file."""
        head = self.head(encoding)
        self._begin(head)
        with self._lines_of(encoding) as lines:
            before = len(list(islice(lines, head.skipped)))
            while piece := list(islice(lines, _ROWS)):
                if any('"' in line for line in piece):  # a cell may go on in the next piece
                    self._take_rows(chain(piece, lines), head, before)
                    break
                if not self._take_plain(piece, head, before):
                    self._take_rows(piece, head, before)
                before += len(piece)
        hint = "" if self._has_more else "delete what is not a row of the table"
        if self._is_aligned:
            hint = "columns without a separator have no empty cells: export it with semicolons between them"
        elif self._has_more and head.delimiter == ",":
            hint = "a decimal comma needs columns separated by semicolons"
        self._faults.add("rows", self._file, self._wrong, hint)
        return self._table(head)

    def head(self, encoding: str) -> _Head:
        """Return what stands before the rows of a CSV file."""
        with self._lines_of(encoding) as lines:
            return self._head(list(islice(lines, _HEAD)))

    @contextmanager
    def _lines_of(self, encoding: str) -> Iterator[Iterator[str]]:
        """Open the file's lines, cells of aligned columns being separated by tabs."""
        with self._path.open(encoding=encoding, newline="") as file:
            first = list(islice(file, _HEAD))
            lines, cut = chain(first, file), aligned(first)
            self._is_aligned = cut is not None
            yield iter(lines) if cut is None else map(cut, lines)

    def parquet(self) -> LogTable:
        """Return the numbers of a Parquet file."""
        pyarrow = load_pyarrow()
        try:
            file = pyarrow.parquet.ParquetFile(self._path)
            header = tuple(file.schema_arrow.names)
            head = _Head(";", header, tuple(split_unit(name)[1] for name in header), 0)
            self._begin(head)
            for batch in file.iter_batches(_ROWS, use_threads=False):
                begun = len(self._lines)
                self._lines += range(begun + 1, begun + 1 + batch.num_rows)
                self._take_columns(pyarrow, batch.columns)
        except pyarrow.ArrowException as error:
            raise ValueError(f"not a Parquet file: {error}") from error
        return self._table(head)

    def _head(self, lines: list[str]) -> _Head:
        """Return the header: of the first lines the one that has most of the names that are known."""
        if scope := Scope.of(lines):
            return _Head(scope.delimiter, scope.header, scope.units, scope.skipped, scope)
        ends = [i for i, line in enumerate(lines, 1) if line.startswith(_END_OF_HEADER)]
        above = ends[-1] if ends else 0
        first = next((i for i, line in enumerate(lines) if i >= above and line.strip()), -1)
        if first < 0:
            raise DataError(f"{self._file}: is empty; needed: a header and one row per sample")
        said = _SEPARATOR.fullmatch(lines[first].strip("\r\n"))
        first += bool(said)
        rows = {i: _cells(line, said[1] if said else "") for i, line in enumerate(lines[first:], first)}
        known = {*self._format.time_columns, *(column.header for column in self._columns or ())}
        numbers_known = {
            i: len(known & {*cells, *(split_unit(cell)[0] for cell in cells)}) for i, cells in rows.items()
        }
        chosen = max(numbers_known, key=lambda i: numbers_known[i], default=first)
        if not numbers_known.get(chosen):
            filled = [i for i, cells in rows.items() if any(cells)]
            if not filled:
                raise DataError(f"{self._file}: has no header; needed: a header and one row per sample")
            alike = [i for i in filled if len(rows[i]) == len(rows[filled[-1]])]
            chosen = (filled if ends or self._columns else alike)[0]
        delimiter = said[1] if said else delimiter_of(lines[chosen])
        reader = csv.reader(lines[chosen:], delimiter=delimiter, skipinitialspace=True, strict=True)
        try:
            header = tuple(cell.strip() for cell in next(reader, []))
            if ends and header[-1:] == ("Comment",):  # of LabVIEW, whose rows leave it out
                header = header[:-1]
            end = chosen + reader.line_num
            below = [cell.strip() for cell in next(reader, [])]
        except csv.Error as error:
            where = f"line {chosen + max(reader.line_num, 1)}"
            raise DataError(f"{self._file}, {where}: not a CSV file: {error}") from error
        self._require_wide(header)
        units = [split_unit(name)[1] for name in header]
        if len(below) == len(header) and _are_units(below):
            end = chosen + reader.line_num
            units = [unit or cell.strip("[]() ") for unit, cell in zip(units, below, strict=True)]
        return _Head(delimiter, header, tuple(units), end)

    def _require_wide(self, header: Sequence[str]) -> None:
        """Refuse a table with a row for each value of each signal."""
        titles = {title.lower(): title for title in header}
        pairs = ((name, value) for name, values in _LONG.items() for value in values)
        name, value = next((pair for pair in pairs if titles.keys() >= {*pair}), ("", ""))
        if name and (self._columns is None or not {column.header for column in self._columns} <= {*header}):
            raise DataError(
                f'{self._file}: each row has one value of one signal ("{titles[name]}", "{titles[value]}"); '
                "needed: a row per sample and a column per signal: export it so, or in pandas "
                f'`table.pivot(index=the time, columns="{titles[name]}", values="{titles[value]}")`'
            )

    def _begin(self, head: _Head) -> None:
        """Note which columns are read."""
        self._of_time = [] if head.scope else self._time_indices(head)
        if self._columns is None:
            self._places: list[int | None] = [
                i for i, name in enumerate(head.header) if name and i not in self._of_time
            ]
        else:
            self._places = [self._place(head, column) for column in self._columns]
        indices = {i for i in self._places if i is not None} | {*(head.scope.times if head.scope else ())}
        self._numbers = {i: _Numbers(with_comma=head.delimiter != ",") for i in sorted(indices)}
        self._times: list[list[Sequence[str] | FloatArray]] = [[] for _ in self._of_time]

    def _time_indices(self, head: _Head) -> list[int]:
        """Return the columns of the time; of a log that is read leniently those that are likely to be it."""
        names, indices, absent = self._format.time_columns, list[int](), list[str]()
        for name in names:
            try:
                indices.append(find_column(self._file, head.header, name))
            except DataError as error:
                absent += error.faults
        likely = likely_times(head.header)
        titles = [f'"{split_unit(head.header[i])[0]}"' for i in likely]
        remedy = f"write time_column = {titles[0]}" if len(titles) == 1 else ""
        if len(titles) == 2:
            remedy = f"write time_column = [{', '.join(titles)}]"
        if absent:
            fault = f'{self._file}: no column "{names[0]}"' if remedy else absent[0] + _TIME_HINT
            self._faults.add("time column", "", [("", fault)], remedy)
        return likely if self._lenient and absent else indices

    def _place(self, head: _Head, column: Column) -> int | None:
        try:
            return find_column(self._file, head.header, column.header)
        except DataError as error:
            self._faults.add(f"column {column.header}", "", [("", fault) for fault in error.faults])
            return None

    def _wanted_of(self, units: Sequence[str], head: _Head) -> list[_Wanted]:
        """Return the columns of the result, those of the file being in these units."""
        if self._columns is None:
            places = [place for place in self._places if place is not None]
            return [
                _Wanted(
                    head.header[i] if head.scope else split_unit(head.header[i])[0],
                    units[i],
                    i,
                    _as_it_stands,
                )
                for i in places
                if not self._numbers[i].are_texts
            ]
        columns = zip(self._columns, self._places, strict=True)
        return [self._located(head, units, column, place) for column, place in columns]

    def _located(self, head: _Head, units: Sequence[str], column: Column, index: int | None) -> _Wanted:
        variable, header, unit, difference = column
        name, its_unit = (header, "") if variable is None else (variable.name, variable.unit)
        if index is None:
            return _Wanted(name, its_unit, None, _as_it_stands)
        given = units[index] or unit
        if given and unit and given != unit:
            where, what = f'column "{head.header[index]}"', f'unit = "{unit}" contradicts its header'
            self._faults.add(f"unit of {header}", self._file, [(where, what)])
        if variable is None:
            return _Wanted(name, given, index, _as_it_stands)
        try:
            return _Wanted(name, its_unit, index, converter(variable, given, difference=difference))
        except ConfigError as error:
            where = f'column "{head.header[index]}"'
            self._faults.add(f"unit of {header}", self._file, [(where, fault) for fault in error.faults])
            return _Wanted(name, its_unit, index, _as_it_stands)

    def _take_plain(self, lines: Sequence[str], head: _Head, before: int) -> bool:
        """Take lines all of whose cells are numbers but the times, which come first; False if they are not.

        It is what numpy does four times as fast as :meth:`_take_rows`, which knows where something is wrong.
        """
        times, width = len(self._of_time), len(head.header)
        if self._of_time != [*range(times)] or len(self._numbers) < width - times or width == times:
            return False
        # Times that are numbers are read with the others, which spares each line of them its own cut.
        apart = 0 if times == 1 and self._is_number(lines[0].partition(head.delimiter)[0]) else times
        parts = [line.split(head.delimiter, apart) for line in lines] if apart else []
        if any(len(part) <= apart for part in parts):
            return False
        text = "\n".join([part[-1].rstrip("\r\n") for part in parts]) if parts else "".join(lines)
        marks = [mark for mark in ",." if mark != head.delimiter and mark in text]
        if len(marks) > 1 or not text.strip():
            return False
        try:
            numbers = text.replace(",", ".") if "," in marks else text
            values = np.loadtxt(numbers.splitlines(), delimiter=head.delimiter, comments=None, ndmin=2)
        except ValueError:
            return False
        if values.shape != (len(lines), width - apart) or not np.isfinite(values).all():
            return False
        for index, column in self._numbers.items():
            column.take_plain(values[:, index - apart].copy(), marks)
        for n, pieces in enumerate(self._times):
            pieces.append([part[n] for part in parts] if apart else values[:, n].copy())
        self._lines += range(before + 1, before + len(lines) + 1)
        return True

    def _take_rows(self, lines: Iterable[str], head: _Head, before: int) -> None:
        """Take rows that have a cell for each column; the others are wrong."""
        reader = csv.reader(lines, delimiter=head.delimiter, skipinitialspace=True, strict=True)
        rows, width = list[list[str]](), len(head.header)
        try:
            for row in reader:
                if len(row) == width + 1 and not row[-1]:
                    row.pop()
                if head.scope and (len(row) < width or head.scope.is_end(row)):
                    row = [] if head.scope.is_end(row) else [*row, *[""] * (width - len(row))]
                if tuple(map(str.strip, row)) == head.header:  # a logger that was started again
                    continue
                if len(row) == width and any(row):
                    rows.append(row)
                    self._lines.append(before + reader.line_num)
                    if len(rows) == _ROWS:
                        self._take(list(zip(*rows, strict=True)))
                        rows = []
                elif any(row):
                    self._has_more |= len(row) > width
                    what = f"{len(row)} cells, and {width} columns in the header"
                    self._wrong.append((f"line {before + reader.line_num}", what))
        except csv.Error as error:
            line = before + reader.line_num
            raise DataError(f"{self._file}, line {line}: not a CSV file: {error}") from error
        if rows:
            self._take(list(zip(*rows, strict=True)))

    def _take(self, columns: Sequence[Sequence[str]]) -> None:
        for index, numbers in self._numbers.items():
            numbers.take(columns[index])
        for pieces, index in zip(self._times, self._of_time, strict=True):
            pieces.append(columns[index])

    def _take_columns(self, pyarrow: Any, columns: Sequence[Any]) -> None:
        """Take columns of a Parquet file, numbers and dates as what they are."""
        for index, numbers in self._numbers.items():
            values = _numbers_of(pyarrow, columns[index])
            if values is None:
                numbers.take(_cells_of(columns[index]))
            else:
                numbers.take_plain(values)
        of_time = [columns[index] for index in self._of_time]
        if len(of_time) == 1 and pyarrow.types.is_timestamp(of_time[0].type):
            self._with_zone = of_time[0].type.tz is not None
            self._instants.append(_instants_of(pyarrow, of_time[0]))
            return
        for pieces, column in zip(self._times, of_time, strict=True):
            values = _numbers_of(pyarrow, column)
            pieces.append(_cells_of(column) if values is None else values)

    def _table(self, head: _Head) -> LogTable:
        lines = np.array(self._lines, dtype=np.int64)
        if not lines.size:
            what = "a header and no rows; needed: one row per sample"
            self._faults.add("no rows", self._file, [("", what)])
        for numbers in self._numbers.values():
            numbers.read_switches()
        texts = [i for i, numbers in self._numbers.items() if numbers.are_texts]
        units = [
            self._numbers[i].settle_unit(unit) if i in self._numbers else unit
            for i, unit in enumerate(head.units)
        ]
        columns = self._wanted_of(units, head)
        self._check_numbers(head, texts, lines)
        values = np.full((len(lines), len(columns)), np.nan)
        words, reported, codes = dict[tuple[int, int], str](), set[tuple[int, int]](), 0
        for n, wanted in enumerate(columns):
            if wanted.place is not None and wanted.place not in texts:
                read = self._numbers[wanted.place].values
                coded = np.isin(read, self._format.missing_values)
                values[:, n] = wanted.convert(np.where(coded, np.nan, read))
                codes += int(coded.sum())
                words |= {(row, n): word for row, word in self._numbers[wanted.place].words.items()}
                numbers = self._numbers[wanted.place]
                reported |= {(row, n) for row in (*numbers.odd, *numbers.foreign)}
        seconds, instants, untimed, remedy, are_local = self._time(head, len(lines))
        table = LogTable(
            self._file,
            tuple(wanted.name for wanted in columns),
            tuple(wanted.unit for wanted in columns),
            tuple("" if wanted.place is None else head.header[wanted.place] for wanted in columns),
            values,
            lines,
            seconds,
            instants,
            self._time_header(head),
            untimed,
            remedy,
            are_local,
            words,
            reported,
            tuple(head.header[i] for i in texts) if self._columns is None else (),
            codes,
        )
        return table if head.scope is None else self._united(table, head.scope, columns)

    def _united(self, table: LogTable, scope: Scope, columns: Sequence[_Wanted]) -> LogTable:
        """Return the rows at all times of any channel, a cell where a channel has no sample then missing."""
        times = [scope.instants(self._numbers[i].values) for i in scope.times]
        union = Union.of(times)
        values, lines = table.values, table.lines
        groups = [0 if column.place is None else scope.group_of(column.place) for column in columns]
        table.values = np.full((len(union.instants), len(columns)), np.nan)
        table.lines = np.zeros(len(union.instants), dtype=np.int64)
        for rows, places in reversed(union.rows):
            table.lines[places] = lines[rows]
        words, reported = dict[tuple[int, int], str](), set[tuple[int, int]]()
        for n, group in enumerate(groups):
            rows, places = union.rows[group]
            table.values[places, n] = values[rows, n]
            at = dict(zip(rows.tolist(), places.tolist(), strict=True))
            words |= {(at[row], n): word for (row, i), word in table.words.items() if i == n and row in at}
            reported |= {(at[row], n) for row, i in table.reported if i == n and row in at}
            untimed = np.flatnonzero(np.isnan(times[group]) & np.isfinite(values[:, n]))
            # Scope repeats a value with its time where it fills the rows of slower channels.
            again = rows[
                ~np.isclose(table.values[places, n], values[rows, n], rtol=0, atol=0, equal_nan=True)
            ]
            for at_rows, what in (
                (untimed, "no time stands before it"),
                (again, "it has the time of another"),
            ):
                faults = [
                    (f'line {lines[row]}, column "{table.headers[n]}"', what) for row in at_rows.tolist()
                ]
                self._faults.add(what, self._file, faults, "export it with the time of each sample")
        table.words, table.reported = words, reported
        if scope.begin:
            table.instants = union.instants
        else:
            table.seconds = union.instants / 1e6
        return table

    def _check_numbers(self, head: _Head, texts: Sequence[int], lines: NDArray[np.int64]) -> None:
        """Report columns without numbers, cells that have digits and are none, and two decimal marks."""
        columns = {i: numbers for i, numbers in self._numbers.items() if i not in texts}
        if self._columns is not None and lines.size:
            without_numbers = [
                (f'column "{head.header[i]}"', f'"{cell}" and the other cells are not numbers')
                for i in texts
                for cell in [next(iter(self._numbers[i].texts.values()), "")]
            ]
            without_numbers += [
                (f'column "{head.header[i]}"', "all of its cells are empty")
                for i, numbers in columns.items()
                if numbers.is_empty
            ]
            self._faults.add("texts", self._file, without_numbers, "columns says which column a signal is in")
        odd = [
            (f'line {lines[row]}, column "{head.header[i]}"', f'"{cell}" is not a finite number')
            for i, numbers in columns.items()
            for row, cell in numbers.odd.items()
        ]
        foreign = [
            (f'line {lines[row]}, column "{head.header[i]}"', f"the cell {what}")
            for i, numbers in columns.items()
            for row, what in sorted(numbers.foreign.items())
        ]
        self._faults.add("units of cells", self._file, foreign, "export a column in one unit")
        cells = [cell for numbers in columns.values() for cell in numbers.odd.values()]
        if self._columns is None:
            grouped = [
                (f'line {lines[row]}, column "{head.header[i]}"', f'"{cell}" is not a finite number')
                for i in texts
                for row, cell in self._numbers[i].odd.items()
                if _THOUSANDS.fullmatch(cell)
            ]
            self._faults.add("thousands", self._file, grouped, _GROUPED)
        are_grouped = any(map(_THOUSANDS.fullmatch, cells))
        remedy = _GROUPED if are_grouped else ""
        self._faults.add("numbers", self._file, odd, remedy)
        first = {
            mark: [numbers.marks[mark] for numbers in columns.values() if mark in numbers.marks]
            for mark in ",."
        }
        if head.delimiter != "," and all(first.values()) and not are_grouped:
            at = {mark: lines[min(rows)] for mark, rows in first.items()}
            what = f'two decimal marks, "," in line {at[","]} and "." in line {at["."]}'
            self._faults.add("marks", self._file, [("", what)], "needed: one of them throughout")

    def _time_header(self, head: _Head) -> str:
        if head.scope:
            return "time"
        return " ".join(head.header[i] for i in self._of_time)

    def _time(self, head: _Head, rows: int) -> tuple[FloatArray, Instants | None, dict[int, str], str, bool]:
        """Return times [s] or instants, what is wrong with others, what to do, and if they are local."""
        seconds = np.full(rows, np.nan)
        if not self._of_time or not rows:
            return seconds, None, {}, "", False
        written = self._format.dates
        if self._instants:
            instants = np.concatenate(self._instants)
            return seconds, *dates_at(instants, self._format.time_zone, with_zone=self._with_zone)
        pieces = self._times[0]
        if len(self._times) > 1:
            columns = [chain(*map(_as_cells, column)) for column in self._times]
            pieces = [[" ".join(parts).strip() for parts in zip(*columns, strict=True)]]
        first = next(filter(str.strip, chain.from_iterable(map(_as_cells, pieces))), "")
        if not self._is_number(first) and (is_date(first) or written in ("dd/mm/yyyy", "mm/dd/yyyy")):
            cells = [*chain.from_iterable(map(_as_cells, pieces))]
            dates = read_dates(cells, written, self._format.time_zone)
            if self._lenient and dates.faults and written == "auto":
                dates = self._guessed(head, cells, dates)
            return seconds, *dates
        if is_clock(first):
            seconds, untimed = read_clocks([*chain.from_iterable(map(_as_cells, pieces))])
            return seconds, None, untimed, "", False
        numbers = _Numbers(with_comma=head.delimiter != ",")
        for piece in pieces:
            if isinstance(piece, np.ndarray):
                numbers.take_plain(piece)
            else:
                numbers.take(piece)
        unit = numbers.settle_unit(head.units[self._of_time[0]])
        seconds = numbers.values
        said = {row: f"the cell {what}" for row, what in numbers.foreign.items()}
        said |= {
            row: f'"{text}" is neither a number nor a date that is known'
            for row, text in numbers.texts.items()
        }
        wrong = {
            row: said.get(row, "the cell is empty") for row in np.flatnonzero(~np.isfinite(seconds)).tolist()
        }
        if written == "excel":
            return seconds, excel_dates(seconds), wrong, "", True
        if not unit and (since_1970 := epochs(seconds)) is not None:
            return np.full(rows, np.nan), since_1970, wrong, "", False
        try:
            convert = converter(_TIME, unit)
        except ConfigError as error:
            where = f'column "{self._time_header(head)}"'
            self._faults.add("time unit", self._file, [(where, fault) for fault in error.faults])
            return np.full(rows, np.nan), None, {}, "", False
        return convert(seconds), None, wrong, "", False

    def _is_number(self, cell: str) -> bool:
        return bool(np.isfinite(number(cell.replace(",", "."))))

    def _guessed(self, head: _Head, cells: Sequence[str], dates: Dates) -> Dates:
        """Return dates read with the day or the month first, whichever fits; what is wrong is reported."""
        for written in ("dd/mm/yyyy", "mm/dd/yyyy"):
            guessed = read_dates(cells, written, self._format.time_zone)
            if not guessed.faults:
                faults = [
                    (f'line {self._lines[row]}, column "{self._time_header(head)}"', what)
                    for row, what in dates.faults.items()
                ]
                self._faults.add("time", self._file, faults, dates.remedy)
                return guessed
        return dates


def _as_it_stands(values: FloatArray) -> FloatArray:
    return values


def _cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line that may be the header; none if it is not a row of a CSV file."""
    reader = csv.reader([line], delimiter=delimiter or delimiter_of(line), skipinitialspace=True)
    with suppress(csv.Error):
        return [cell.strip() for cell in next(reader, [])]
    return []


def _are_units(cells: Sequence[str]) -> bool:
    """Whether a row below the header has the units of the columns: no numbers, and units that are known."""
    filled = [cell.strip("[]() ") for cell in cells if cell]
    words = [cell for cell in filled if not np.isfinite(number(cell.replace(",", ".")))]
    if any(map(is_date, words)) or any(cell != "1" and cell not in words for cell in filled):
        return False
    return any(map(is_unit, words)) and all(is_unit(cell) or len(cell) < _LONGEST_UNIT for cell in words)


def _as_cells(piece: Sequence[str] | FloatArray) -> Sequence[str]:
    return [*map(str, piece.tolist())] if isinstance(piece, np.ndarray) else piece


def _cells_of(column: Any) -> Sequence[str]:
    """Return the cells of a Parquet column as a CSV file would have them."""
    return ["" if cell is None else str(cell) for cell in column.to_pylist()]


def _numbers_of(pyarrow: Any, column: Any) -> FloatArray | None:
    """Return the numbers of a Parquet column, NaN where there is none; None if it holds something else."""
    kinds, kind = pyarrow.types, column.type
    are_numbers = kinds.is_floating, kinds.is_integer, kinds.is_boolean, kinds.is_decimal, kinds.is_null
    if not any(is_kind(kind) for is_kind in are_numbers):
        return None
    return np.array(column.cast(pyarrow.float64(), safe=False).to_numpy(zero_copy_only=False))


def _instants_of(pyarrow: Any, column: Any) -> Instants:
    """Return the times of a Parquet column of dates; NO_TIME where there is none."""
    whole = column.cast(pyarrow.timestamp("us", column.type.tz), safe=False).cast(pyarrow.int64())
    values: Instants = np.array(whole.fill_null(NO_TIME).to_numpy(zero_copy_only=False))
    return values
