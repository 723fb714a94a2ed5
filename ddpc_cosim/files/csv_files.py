"""CSV files: columns by name, their units, and sample times, with every fault of a file at once.

A file is UTF-8 text with a header and one row per sample. Columns are separated by commas, semicolons or
tabs, whichever the header shows; with semicolons and tabs the decimal mark can be a comma. A header may end
in the column's unit: ``level [cm]``, or ``level (cm)`` where that is a unit that is known.

A Parquet file has the same columns under the same headers, and may stand wherever a CSV file is read.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import lru_cache
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np

from ddpc_cosim.errors import ConfigError, DataError, MissingLibraryError
from ddpc_cosim.files.log_dates import date_in
from ddpc_cosim.files.tables import csv_records, write_rows
from ddpc_cosim.variables import FloatArray, Variable, converter
from fmu_plants.spelling import did_you_mean
from fmu_plants.units import is_unit

TIME_TOLERANCE = 0.01
"""How far rows may be from one sampling time apart, in parts of it, unless one says otherwise."""

PARQUET = ".parquet"
_LARGEST = 100_000_000
_MOST_LISTED = 8
_DELIMITERS = ";\t,|"
# A header with a unit; brackets that touch the name and hold numbers are an array's index.
_UNIT = re.compile(r"(?P<name>.*\S)(?:\s+|(?!\[[\d,\s]*\]))\[(?P<unit>[^\[\]]*)\]", re.DOTALL)
_UNIT_IN_PARENTHESES = re.compile(r"(?P<name>.*\S)\s+\((?P<unit>[^()]*)\)", re.DOTALL)
_TIME = Variable("time", unit="s")
_TIME_HINT = " (time_column says which column the time is)"
_INSTANTS = 1e-6  # what rounding leaves of a time, in parts of the sampling time


class Column(NamedTuple):
    """A column to read.

    Parameters
    ----------
    variable : Variable or None
        The signal in whose unit the values are returned; None: they are returned as they stand.
    header : str
        The column's name, with or without the unit.
    unit : str
        Unit of the values where the header has none; empty: the signal's own.
    difference : bool
        The values are added to the signal: they convert without an offset.
    """

    variable: Variable | None
    header: str
    unit: str = ""
    difference: bool = False


class CSVFile:
    """The cells of a CSV file.

    Parameters
    ----------
    path : Path
        The file.
    text : str, optional
        What it holds, where that is known; ``path`` is what it is called then.

    Attributes
    ----------
    header : tuple of str
        The column names.
    rows : list of list of str
        The cells of each row, as many as there are column names.
    lines : list of int
        The line of the file that each row ends on, counted from 1.
    faults : list of str
        What is wrong with rows that were left out.

    Raises
    ------
    DataError
        The file cannot be read, is not UTF-8 text, or is empty.
    """

    def __init__(self, path: Path, text: str | None = None) -> None:
        self.path, self.faults = path, list[str]()
        text = _text(path) if text is None else text
        first = next(filter(str.strip, re.split(r"[\r\n]", text)), "")
        if not first:
            raise DataError(f"{path}: is empty; needed: a header and one row per sample")
        self.delimiter = delimiter_of(first)
        self.header: tuple[str, ...] = ()
        self.rows, self.lines = list[list[str]](), list[int]()
        try:
            for line, row in csv_records(text, delimiter=self.delimiter, skipinitialspace=True, strict=True):
                self._take(row, line)
        except ValueError as error:
            raise DataError(f"{path}, {error}") from error

    def _take(self, row: list[str], line: int) -> None:
        if not self.header:
            self.header = tuple(cell.strip() for cell in row)
        elif len(row) == len(self.header):
            self.rows.append(row)
            self.lines.append(line)
        elif row:
            hint = "; a decimal comma needs columns separated by semicolons" if self.delimiter == "," else ""
            count = f"{len(row)} cells, and {len(self.header)} columns in the header"
            self.faults.append(f"{self.path}, line {line}: {count}{hint}")

    def find(self, header: str, hint: str = "") -> tuple[int, str]:
        """Return the index of a column and its unit, empty if the header has none.

        Parameters
        ----------
        header : str
            Its name, with or without the unit.
        hint : str
            What else to do where there is no such column.

        Raises
        ------
        DataError
            There is no such column, or more than one.
        """
        index = find_column(str(self.path), self.header, header, hint)
        return index, split_unit(self.header[index])[1]

    def cells(self, index: int) -> list[str]:
        """Return the cells of a column."""
        return [row[index] for row in self.rows]


def find_column(path: str, names: Sequence[str], header: str, hint: str = "") -> int:
    """Return the index of the column with a header, with or without the unit.

    Raises
    ------
    DataError
        There is no such column, or more than one.
    """
    matches = [i for i, name in enumerate(names) if name == header]
    matches = matches or [i for i, name in enumerate(names) if split_unit(name)[0] == header]
    if len(matches) > 1:
        listed = ", ".join(f'"{names[i]}" (column {i + 1})' for i in matches)
        raise DataError(f'{path}: column "{header}" is there more than once: {listed}')
    if not matches:
        known = filter(None, (split_unit(name)[0] for name in names))
        raise DataError(f'{path}: no column "{header}"; {did_you_mean(header, known)}{hint}')
    return matches[0]


def split_unit(header: str) -> tuple[str, str]:
    """Return the name and the unit of a column; the unit is empty if the header has none.

    In brackets anything is a unit, in parentheses what is known as one: ``level [cm]``, ``p (bar)``.
    """
    match = _UNIT.fullmatch(header) or _UNIT_IN_PARENTHESES.fullmatch(header)
    if match is None or (header.endswith(")") and not is_unit(match["unit"])):
        return header, ""
    return match["name"], match["unit"].strip()


def delimiter_of(line: str) -> str:
    """Return what separates the cells of a header."""
    unquoted = re.sub(r'"[^"]*"', "", line)
    return next((mark for mark in _DELIMITERS if mark in unquoted), ",")


def read_table(
    source: Path | CSVFile,
    columns: Sequence[Column],
    time_column: str,
    sampling_time: float | None = None,
    tolerance: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Read columns of a CSV file.

    Parameters
    ----------
    source : Path or CSVFile
        The file.
    columns : sequence of Column
        The n columns to read.
    time_column : str
        Header of the time, in seconds unless it has a unit, or dates in ISO 8601 or dd.mm.yyyy, which count
        from the first row; empty: the file has none, and times are NaN.
    sampling_time : float, optional
        What rows must be apart [s]; default: times only have to increase.
    tolerance : float
        How far they may be off, in parts of the sampling time.

    Returns
    -------
    time : array, shape (T,)
        Increasing times [s].
    values : array, shape (T, n)
        The columns in the units of their signals, time along axis 0.

    Raises
    ------
    DataError
        All that is wrong with the file, with line and column.
    """
    file = source if isinstance(source, CSVFile) else _parsed(source)
    path, faults = file.path, list[str]()
    if not file.rows and not file.faults:
        faults.append(f"{path}: a header and no rows; needed: one row per sample")
    time, values = np.full(len(file.rows), np.nan), np.full((len(file.rows), len(columns)), np.nan)
    located = dict(_locate(file, columns, faults))
    of_time = [Column(_TIME, time_column)] if time_column else []
    timed = dict(_locate(file, of_time, faults, _TIME_HINT)).get(0)
    faults += file.faults
    dates = _dates(file, timed[0], faults) if timed else None
    numeric = [index for index, _ in located.values()] + ([timed[0]] if timed and dates is None else [])
    comma = _decimal_comma(file, numeric, faults)
    for i, (index, convert) in located.items():
        values[:, i] = convert(_numbers(file, index, comma, faults))
    if timed:
        index, convert = timed
        time = convert(_numbers(file, index, comma, faults)) if dates is None else dates
        faults += _irregular(file, file.header[index], time, sampling_time, tolerance)
    if faults:
        more = len(faults) - _MOST_LISTED
        raise DataError([*faults[:_MOST_LISTED], *([f"{path}: and {more} more faults"] if more > 0 else [])])
    return time, values


def plain_cells(file: CSVFile, shapes: Mapping[str, tuple[int, ...]]) -> CSVFile:
    """Return a file, changed in place, in which booleans are 0 and 1, and arrays are their elements.

    Parameters
    ----------
    file : CSVFile
        Its arrays have their values in one cell, separated by blanks.
    shapes : mapping of str to tuple of int
        The sizes of the arrays by name; the elements of ``x`` become ``x[1,1]``, ``x[1,2]``, ...
    """
    columns, header = list(zip(*file.rows, strict=True)) or [()] * len(file.header), list[str]()
    cells = list[Sequence[str]]()
    booleans = {"true": "1", "false": "0"}
    for title, column in zip(file.header, columns, strict=True):
        name, unit = split_unit(title)
        if shape := shapes.get(name):
            indices = [",".join(str(1 + i) for i in index) for index in np.ndindex(*shape)]
            header += [f"{name}[{index}]" + (f" [{unit}]" if unit else "") for index in indices]
            parts = [[*cell.split(), *[""] * len(indices)][: len(indices)] for cell in column]
            cells += list(zip(*parts, strict=True)) or [()] * len(indices)
        else:
            header.append(title)
            cells.append([booleans.get(cell.strip().lower(), cell) for cell in column])
    file.header, file.rows = tuple(header), [list(row) for row in zip(*cells, strict=True)]
    return file


def write_table(path: Path, numbers: Mapping[str, FloatArray], texts: Mapping[str, Sequence[str]]) -> None:
    """Write columns of numbers and then columns of text: as Parquet if the file's name ends so, or as CSV.

    As text a number is the shortest that gives it again.
    """
    if path.suffix == PARQUET:
        write_parquet(path, [(numbers, texts)])
        return
    with path.open("w", encoding="utf-8", newline="") as file:
        _write_csv(file, numbers, texts)


def _write_csv(file: TextIO, numbers: Mapping[str, FloatArray], texts: Mapping[str, Sequence[str]]) -> None:
    cells: list[Iterable[str]] = [map(repr, column.tolist()) for column in numbers.values()]
    write_rows(file, [*numbers, *texts], zip(*cells, *texts.values(), strict=True))


def write_parquet(
    path: Path, parts: Iterable[tuple[Mapping[str, FloatArray], Mapping[str, Sequence[str]]]]
) -> None:
    """Write columns of numbers and then of text as Parquet: some rows after the other, each a group."""
    pyarrow, writer = load_pyarrow(), None
    with ExitStack() as ending:
        for numbers, texts in parts:
            table = _arrow_table(pyarrow, numbers, texts)
            if writer is None:
                # Neither statistics nor its own schema, which are larger than the samples of a short run.
                how: dict[str, Any] = {"write_statistics": False, "store_schema": False}
                how |= {
                    "compression": "zstd",
                    "use_byte_stream_split": [*numbers],
                    "use_dictionary": [*texts],
                }
                writer = ending.enter_context(pyarrow.parquet.ParquetWriter(path, table.schema, **how))
            writer.write_table(table)


def _arrow_table(pyarrow: Any, numbers: Mapping[str, FloatArray], texts: Mapping[str, Sequence[str]]) -> Any:
    # From buffers: where pyarrow is given arrays or lists it imports pandas, which a worker does without.
    columns = list[Any]()
    for numbers_of_one in map(np.ascontiguousarray, numbers.values()):
        buffers = [None, pyarrow.py_buffer(numbers_of_one)]
        columns.append(pyarrow.Array.from_buffers(pyarrow.float64(), len(numbers_of_one), buffers))
    for cells in ([cell.encode() for cell in column] for column in texts.values()):
        ends = np.cumsum([0, *map(len, cells)], dtype=np.int32)
        buffers = [pyarrow.py_buffer(ends), pyarrow.py_buffer(b"".join(cells))]
        columns.append(pyarrow.StringArray.from_buffers(len(cells), *buffers))
    return pyarrow.Table.from_arrays(columns, names=[*numbers, *texts])


def read_parquet(content: bytes) -> tuple[dict[str, FloatArray], dict[str, tuple[str, ...]]]:
    """Return the columns of numbers and, as text, all others of a Parquet file; what is missing is empty.

    Raises
    ------
    ConfigError
        pyarrow is not installed.
    ValueError
        It is not a Parquet file.
    """
    pyarrow = load_pyarrow()
    numbers, texts = dict[str, FloatArray](), dict[str, tuple[str, ...]]()
    try:
        table = pyarrow.parquet.ParquetFile(pyarrow.BufferReader(content)).read(use_threads=False)
        for name, column in zip(table.column_names, table.columns, strict=True):
            if column.type == pyarrow.float64() and not column.null_count:
                numbers[name] = np.concatenate([np.empty(0), *map(np.from_dlpack, column.chunks)])
            else:
                texts[name] = tuple("" if cell is None else str(cell) for cell in column.to_pylist())
    except pyarrow.ArrowException as error:
        raise ValueError(f"not a Parquet file: {error}") from error
    return numbers, texts


def load_pyarrow() -> Any:
    """Import what reads and writes Parquet files.

    Raises
    ------
    MissingLibraryError
        It is not installed.
    """
    try:
        import pyarrow.parquet
    except ImportError as error:
        raise MissingLibraryError.of("a Parquet file", "pyarrow", "parquet") from error
    return pyarrow


def require_readable(path: Path, largest: int) -> None:
    """Raise DataError if there is no file, or one of more bytes than ``largest``."""
    if not path.is_file():
        raise DataError(f"{path}: {'not a file' if path.exists() else 'no such file'}")
    if (size := path.stat().st_size) > largest:
        raise DataError(
            f"{path}: {size / 1e6:.0f} MB are too many; allowed: {largest / 1e6:.0f} MB: keep the "
            "columns and rows that are needed"
        )


def _text(path: Path) -> str:
    try:
        require_readable(path, _LARGEST)
        content = path.read_bytes()
        if path.suffix == PARQUET:
            text = StringIO()
            _write_csv(text, *read_parquet(content))
            return text.getvalue()
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: cannot be read: {error}") from error
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        byte = error.object[error.start]
        raise DataError(
            f"{path}, line {line}: not UTF-8 text (byte 0x{byte:02x}): save it as UTF-8"
        ) from error


def _parsed(path: Path) -> CSVFile:
    """Return the cells of a file; those of the last one are kept, as a study asks for column after column."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return CSVFile(path)  # which reports it
    return _last_parsed(path, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=1)
def _last_parsed(path: Path, size: int, changed: int) -> CSVFile:
    return CSVFile(path)


forget_cells = _last_parsed.cache_clear
"""Forget the cells of the file that was read last."""


def _locate(
    file: CSVFile, columns: Sequence[Column], faults: list[str], hint: str = ""
) -> Iterator[tuple[int, tuple[int, Callable[[FloatArray], FloatArray]]]]:
    """Yield the number of each column that is there, its index in the file, and how its values convert."""
    for i, (variable, header, unit, difference) in enumerate(columns):
        try:
            index, written = file.find(header, hint)
            if written and unit and written != unit:
                raise DataError(
                    f'{file.path}, column "{file.header[index]}": unit = "{unit}" contradicts its header'
                )
            try:
                unit = written or unit
                convert = converter(variable, unit, difference=difference) if variable else _as_it_stands
                yield i, (index, convert)
            except ConfigError as error:
                raise DataError(f'{file.path}, column "{file.header[index]}": {error}') from error
        except DataError as error:
            faults.extend(error.faults)


def _as_it_stands(values: FloatArray) -> FloatArray:
    return values


def _decimal_comma(file: CSVFile, columns: Sequence[int], faults: list[str]) -> bool:
    """Return whether the file's decimal mark is a comma."""
    if file.delimiter == ",":
        return False
    first: dict[str, int] = {}
    for row, line in zip(file.rows, file.lines, strict=True):
        for mark in ",.":
            if mark not in first and any(mark in row[index] for index in columns):
                first[mark] = line
    if len(first) == 2:
        where = f'"," in line {first[","]} and "." in line {first["."]}'
        faults.append(f"{file.path}: two decimal marks, {where}; needed: one of them throughout")
    return "," in first


def _numbers(file: CSVFile, index: int, comma: bool, faults: list[str]) -> FloatArray:
    """Return a column as numbers; NaN where a cell is not one, which is reported."""
    cells = file.cells(index)
    if comma:
        cells = [cell.replace(",", ".") for cell in cells]
    with suppress(ValueError):
        values = np.array(list(map(float, cells)), dtype=np.float64)
        if np.isfinite(values).all() and not any("_" in cell for cell in cells):
            return values
    values = np.array([_number(cell) for cell in cells])
    for i in np.flatnonzero(~np.isfinite(values)).tolist():
        cell = file.rows[i][index].strip()
        what = f'"{cell[:40]}" is not a finite number' if cell else "the cell is empty"
        faults.append(f'{file.path}, line {file.lines[i]}, column "{file.header[index]}": {what}')
    return values


def _number(cell: str) -> float:
    try:
        return np.nan if "_" in cell else float(cell)
    except ValueError:
        return np.nan


def _irregular(
    file: CSVFile, header: str, time: FloatArray, sampling_time: float | None, tolerance: float
) -> Iterator[str]:
    """Yield which times are not after the one before, or not one sampling time after it."""
    apart = np.diff(time)
    if sampling_time is None:
        wrong, needed = apart <= 0.0, "it must increase"
    else:
        allowed = (tolerance + _INSTANTS) * sampling_time
        wrong = np.abs(apart - sampling_time) > allowed
        needed = f"needed: the sampling time {sampling_time:g} s, within {100 * tolerance:g} %"
        known = apart[np.isfinite(apart)]
        usual = float(np.median(known)) if known.size else sampling_time
        if abs(usual - sampling_time) > allowed:
            yield f'{file.path}, column "{header}": rows are {usual:g} s apart, in the median; {needed}'
            return
    for i in np.flatnonzero(wrong).tolist():
        after = f"{time[i + 1]:.12g} s is {apart[i]:g} s after the row before"
        yield f'{file.path}, line {file.lines[i + 1]}, column "{header}": {after}; {needed}'


def _dates(file: CSVFile, index: int, faults: list[str]) -> FloatArray | None:
    """Return the seconds since the first of the dates; None if the column begins with something else."""
    cells = file.cells(index)
    first = date_in(cells[0]) if cells and not np.isfinite(_number(cells[0].replace(",", "."))) else None
    if first is None:
        return None
    time = np.full(len(cells), np.nan)
    for i, cell in enumerate(cells):
        date, fault = date_in(cell), ""
        if date is None:
            fault = "is not a date, as the first one is"
        elif (date.utcoffset() is None) != (first.utcoffset() is None):
            has = ("a", "none") if first.utcoffset() is None else ("no", "one")
            fault = f"has {has[0]} time zone, and the first date has {has[1]}"
        else:
            time[i] = (date - first).total_seconds()
        if fault:
            where = f'{file.path}, line {file.lines[i]}, column "{file.header[index]}"'
            faults.append(f'{where}: "{cell.strip()[:40]}" {fault}')
    return time
