"""Logs of plants as loggers write them: read as told, or refused with what to write instead."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.errors import DataError
from ddpc_cosim.files.csv_files import Column
from ddpc_cosim.files.log_cells import LogTable, read_cells
from ddpc_cosim.files.log_dates import NO_TIME, date_of
from ddpc_cosim.files.log_format import Faults, LogFormat as LogFormat
from ddpc_cosim.variables import FloatArray
from fmu_plants.units import display_unit

_INSTANTS = 1e-6  # what rounding leaves of a time, in parts of the sampling time
_HOUR = 3600.0
_CHANGES = (3, 4, 9, 10, 11)  # months in which clocks are put forward or back
_MEDIAN_OF = 11  # cells of a running median
_SCALE = 1.4826  # of a median absolute deviation, to a normal distribution's standard deviation
_RARE = 0.01
_LONGEST_INTERPOLATED = 10  # that a message proposes
_Indices = NDArray[np.int64]
_Mask = NDArray[np.bool_]


class Treatment(NamedTuple):
    """Something that was done to a log.

    Parameters
    ----------
    kind : str
        ``"interpolated"``, ``"duplicates"``, ``"split"``, ``"left out"``, ``"resampled"``, ``"outliers"``,
        ``"codes"``, ``"part"`` or ``"sorted"``.
    number : int
        To how many cells, rows or places.
    words : str
        The same for people: ``"3 cells interpolated"``.
    """

    kind: str
    number: int
    words: str


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """What files of logged data hold.

    Parameters
    ----------
    files : tuple of str
        The files, in the order of the rows.
    names, units : tuple of str
        Headers of the n columns without units, and these; empty where a column has none. Of columns that
        were asked for as variables the variables' names and units.
    time : array, shape (T,)
        Times [s], from the first row of all files on; NaN where the files have none.
    values : array, shape (T, n)
        The columns, time along axis 0; NaN where a cell is missing, which it is only if read leniently.
    seams : tuple of int
        The first row of every piece but the first.
    sampling_time : float
        Time between rows [s]; where none was given, the median of what it is.
    treatments : tuple of Treatment
        What was done to the cells and rows.
    faults : tuple of str
        What is wrong with the files, a line for each kind; only if read leniently.
    begin : datetime or None
        The date of the first row, in universal time if an offset or a zone is known; None: no dates.
    texts : tuple of str
        Headers of columns that are not numbers, which are left out.
    """

    files: tuple[str, ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    time: FloatArray
    values: FloatArray
    seams: tuple[int, ...] = ()
    sampling_time: float = np.nan
    treatments: tuple[Treatment, ...] = ()
    faults: tuple[str, ...] = ()
    begin: datetime | None = None
    texts: tuple[str, ...] = ()


STRICT = LogFormat()
"""Whatever is wrong with a log is refused."""


def read_log(
    files: str | Path | Sequence[str | Path],
    *,
    sampling_time: float | None = None,
    format: LogFormat = STRICT,
    columns: Sequence[Column] | None = None,
    held: Collection[str] = (),
    lenient: bool = False,
) -> Log:
    """Read files of logged data.

    Parameters
    ----------
    files : path, or sequence of paths
        CSV or Parquet files.
    sampling_time : float, optional
        Time between rows [s]; default: the median of what it is.
    format : LogFormat
        How they are read.
    columns : sequence of Column, optional
        The columns to read, in the units of their signals; default: all that are numbers, as they stand.
    held : collection of str
        Names of the columns that hold from a sample to the next, as inputs do: a mean of theirs is that after
        the sample.
    lenient : bool
        Whether what is wrong is told in ``faults`` in place of an error, as far as files can be read at all.

    Raises
    ------
    DataError
        All that is wrong with the files, a line for each kind of fault.
    """
    paths = [files] if isinstance(files, str | Path) else files
    faults, unreadable, tables = Faults(), list[str](), list[LogTable]()
    for path in map(Path, paths):
        try:
            tables.append(read_cells(path, format, columns, faults, lenient=lenient))
        except DataError as error:
            unreadable += error.faults
    if not tables:
        raise DataError(unreadable or "a log has at least one file")
    tables = _alike(tables, faults)
    treating = _Treatments(format, sampling_time, faults, held, lenient=lenient)
    log = treating.log(tables)
    lines = (*faults.lines, *unreadable)
    if lines and not lenient:
        raise DataError(lines)
    return replace(log, faults=lines)


def _alike(tables: Sequence[LogTable], faults: Faults) -> list[LogTable]:
    """Return tables with the columns of the first one, in its units."""
    first, alike = tables[0], [tables[0]]
    for table in tables[1:]:
        absent = [name for name in first.names if name not in table.names]
        faults.add(f"columns of {table.file}", table.file, [("", f'no column "{name}"') for name in absent])
        if absent:
            continue
        order = [table.names.index(name) for name in first.names]
        table.values, table.headers = table.values[:, order], tuple(table.headers[i] for i in order)
        places = {i: n for n, i in enumerate(order)}
        table.words = {(row, places[i]): word for (row, i), word in table.words.items() if i in places}
        table.reported = {(row, places[i]) for row, i in table.reported if i in places}
        for n, (wanted, i) in enumerate(zip(first.units, order, strict=True)):
            if table.units[i] != wanted:
                try:
                    table.values[:, n] = display_unit(wanted, table.units[i]).to_unit(table.values[:, n])
                except ValueError as error:
                    faults.add("units", table.file, [(f'column "{table.headers[n]}"', str(error))])
        alike.append(table)
    return alike


@dataclass(slots=True, eq=False)
class _Rows:
    """Rows that follow each other: times, values, and the file and the row in it that each comes from."""

    time: FloatArray
    values: FloatArray
    file: _Indices
    row: _Indices

    def of(self, which: Any) -> "_Rows":
        return _Rows(self.time[which], self.values[which], self.file[which], self.row[which])


class _Treatments:
    """What is done to the rows of a log, counted, and what of it is refused."""

    def __init__(
        self,
        format: LogFormat,
        sampling_time: float | None,
        faults: Faults,
        held: Collection[str],
        *,
        lenient: bool,
    ) -> None:
        self._format, self._wanted_time, self._faults, self._held = format, sampling_time, faults, held
        self._lenient, self._period = lenient, np.nan
        self._tables: Sequence[LogTable] = ()
        self._origin = 0
        self._counts: dict[tuple[str, str, str], int] = {}
        self._longest_gap, self._longest_run = 0.0, 0

    def log(self, tables: Sequence[LogTable]) -> Log:
        """Return the log that the tables of its files are."""
        self._tables = tables
        known = [table.instants[table.instants > NO_TIME] for table in tables if table.instants is not None]
        with_dates = len(known) == len(tables)
        self._origin = next((int(instants[0]) for instants in known if instants.size), 0)
        pieces = [self._timed(i, table) for i, table in enumerate(tables)]
        if self._format.gaps == "split" and with_dates and len(pieces) > 1:
            pieces.sort(key=lambda rows: rows.time[0] if rows.time.size else np.inf)
            pieces = [_joined(pieces)]
        kind = ("cell that holds a missing value's number", "cells that hold a missing value's number")
        self._count("codes", *kind, sum(table.codes for table in tables))
        pieces = [self._in_order(rows) for rows in pieces]
        self._period = self._wanted_time or _usual([np.diff(rows.time) for rows in pieces])
        parts = list[_Rows]()
        for rows in pieces:
            self._take_out(rows)
            if not (self._format.resample != "no" and np.isfinite(rows.time).all()):
                parts += self._sampled(rows)
            else:
                parts += self._resampled(rows)
        parts = self._taken([part for rows in parts for part in self._bridged(rows) if part.time.size])
        whole = _joined(parts)
        if not len(whole.time) and not self._faults.lines:
            files = ", ".join(table.file for table in tables)
            self._faults.add("nothing", files, [("", "no sample is left of which all columns are known")])
        begins = np.cumsum([len(part.time) for part in parts])[:-1].tolist()
        first = tables[0]
        order = dict.fromkeys(int(i) for part in parts for i in np.unique(part.file))
        texts = dict.fromkeys(text for table in tables for text in table.texts)
        return Log(
            tuple(tables[i].file for i in order) or tuple(table.file for table in tables),
            first.names,
            first.units,
            whole.time,
            whole.values,
            tuple(begins),
            self._period,
            tuple(
                Treatment(kind, number, f"{number} {one if number == 1 else many}")
                for (kind, one, many), number in self._counts.items()
            ),
            begin=date_of(self._origin) if with_dates and self._origin else None,
            texts=tuple(texts),
        )

    def _taken(self, parts: Sequence[_Rows]) -> list[_Rows]:
        """Return what the format takes of the samples, from one share of all of them to another."""
        begins = np.cumsum([0, *(len(part.time) for part in parts)])
        first, last = (round(share * int(begins[-1])) for share in self._format.part)
        taken = [
            part.of(slice(max(first - begin, 0), max(last - begin, 0)))
            for part, begin in zip(parts, begins[:-1].tolist(), strict=True)
        ]
        left = int(begins[-1]) - (last - first)
        self._count("part", "sample outside the part left out", "samples outside the part left out", left)
        if first == last and left:
            what = f"part = {self._format.part} holds none of the {left} samples"
            files = ", ".join(table.file for table in self._tables)
            self._faults.add("part", files, [("", what)], "write one that is larger")
        return [part for part in taken if part.time.size]

    def _count(self, kind: str, one: str, many: str, number: int) -> None:
        if number:
            key = (kind, one, many)
            self._counts[key] = self._counts.get(key, 0) + number

    def _timed(self, i: int, table: LogTable) -> _Rows:
        """Return the rows of a file, without those that have no time."""
        row = np.arange(len(table.lines), dtype=np.int64)
        rows = _Rows(table.seconds, table.values, np.full_like(row, i), row)
        if table.instants is not None:
            rows.time = np.where(table.instants > NO_TIME, (table.instants - self._origin) / 1e6, np.nan)
        if not table.time_header:
            return rows
        bears = self._format.missing or self._format.gaps == "split"
        empty = (
            {n for n, what in table.untimed.items() if what == "the cell is empty"} if bears else set[int]()
        )
        untimed = [
            (f'line {table.lines[n]}, column "{table.time_header}"', what)
            for n, what in sorted(table.untimed.items())
            if n not in empty
        ]
        self._faults.add("time", table.file, untimed, table.time_remedy)
        lost = ~np.isfinite(rows.time)
        self._count("left out", "row without a time left out", "rows without a time left out", len(empty))
        return rows.of(~lost)

    def _in_order(self, rows: _Rows) -> _Rows:
        """Return rows whose times increase, each of them once."""
        steps = np.diff(rows.time)
        back = np.flatnonzero(steps < 0.0)
        usual = self._wanted_time or _usual([steps])
        clocks = [i for i in back.tolist() if self._is_change_of_clocks(rows, i, usual)]
        if clocks:
            self._tell_change_of_clocks(rows, clocks)
        elif back.size and self._format.duplicates != "refuse":
            late = rows.time < np.maximum.accumulate(rows.time)
            words = "put in the order of time"
            self._count("sorted", f"row {words}", f"rows {words}", int(np.count_nonzero(late)))
            rows = rows.of(np.argsort(rows.time, kind="stable"))
        elif back.size:
            remedy = (
                'sort its rows, or write duplicates = "first", by which they are put in the order of time'
            )
            out_of_order = [(self._where(rows, i + 1), self._after(rows, i)) for i in back.tolist()]
            self._add("order", rows, back + 1, out_of_order, f"times must increase; {remedy}")
        return self._once(rows)

    def _once(self, rows: _Rows) -> _Rows:
        """Return rows of which no two have the same time."""
        again = np.flatnonzero(np.diff(rows.time) == 0.0) + 1
        if not again.size:
            return rows
        how = self._format.duplicates
        first = np.setdiff1d(np.arange(len(rows.time)), again)
        if how == "refuse":
            duplicates = [
                (self._where(rows, i), "the row has the time of the one before") for i in again.tolist()
            ]
            remedy = 'write duplicates = "first", "last" or "mean", or give the rows their own times'
            self._add("duplicates", rows, again, duplicates, remedy)
            return rows.of(first)
        words = "averaged with another of the same time" if how == "mean" else "dropped"
        kind = ("duplicate row ", "duplicate rows ")
        self._count("duplicates", kind[0] + words, kind[1] + words, len(again))
        ends = np.append(first[1:], len(rows.time))
        kept = rows.of(first)
        if how == "last":
            return rows.of(ends - 1)
        if how == "mean":
            for n in np.flatnonzero(ends - first > 1).tolist():
                group = rows.values[first[n] : ends[n]]
                numbers = np.isfinite(group).sum(axis=0)
                total = np.where(np.isfinite(group), group, 0.0).sum(axis=0)
                kept.values[n] = np.where(numbers > 0, total / np.maximum(numbers, 1), np.nan)
        return kept

    def _take_out(self, rows: _Rows) -> None:
        """Make outliers missing."""
        if not self._format.outliers:
            return
        total = 0
        for column in rows.values.T:
            known = np.flatnonzero(np.isfinite(column))
            far = known[_outliers(column[known], self._format.outliers)]
            column[far] = np.nan
            total += len(far)
        self._count("outliers", "outlier taken out", "outliers taken out", total)

    def _sampled(self, rows: _Rows) -> list[_Rows]:
        """Return pieces of rows that are one sampling time apart, missing ones put in."""
        if not np.isfinite(rows.time).all() or len(rows.time) < 2 or not np.isfinite(self._period):
            return [rows]
        period, steps = self._period, np.diff(rows.time)
        allowed = (self._format.time_tolerance + _INSTANTS) * period
        needed = f"needed: the sampling time {period:g} s, within {100 * self._format.time_tolerance:g} %"
        usual = _usual([steps])
        if abs(usual - period) > allowed:
            how = "mean" if usual < period else "linear"
            what = f"rows are {usual:g} s apart, in the median; {needed}"
            wrong_rate = [(f'column "{self._tables[rows.file[0]].time_header}"', what)]
            self._faults.add(
                "rate", self._tables[rows.file[0]].file, wrong_rate, f'or write resample = "{how}"'
            )
            return [rows]
        numbers = np.maximum(np.rint(steps / period).astype(np.int64), 1)
        is_even = np.abs(steps - numbers * period) <= allowed
        is_gap = steps > period + allowed
        uneven = np.flatnonzero((steps > 0) & ~is_even & (steps < 2 * period - allowed))
        filled = is_gap & is_even & (numbers - 1 <= self._format.missing)
        gaps = np.flatnonzero(is_gap & ~filled)
        if self._format.gaps == "split":
            uneven = uneven[steps[uneven] < period]
        uneven_steps = [(self._where(rows, i + 1), self._after(rows, i)) for i in uneven.tolist()]
        self._add(
            "uneven",
            rows,
            uneven + 1,
            uneven_steps,
            f'{needed}, or a larger time_tolerance, or resample = "linear"',
        )
        self._tell_gaps(rows, np.setdiff1d(gaps, uneven), needed)
        inserted = np.where(filled, numbers, 1)
        ends = np.concatenate([[0], np.cumsum(inserted)])
        seams = np.union1d(gaps, np.flatnonzero(steps < 0.0)) + 1
        if not filled.any():
            return _cut(rows, seams)
        whole = _Rows(
            np.interp(np.arange(ends[-1] + 1), ends, rows.time),
            np.full((ends[-1] + 1, rows.values.shape[1]), np.nan),
            np.repeat(rows.file, np.append(inserted, 1)),
            np.repeat(rows.row, np.append(inserted, 1)),
        )
        whole.values[ends] = rows.values
        return _cut(whole, ends[seams])

    def _resampled(self, rows: _Rows) -> list[_Rows]:
        """Return pieces of samples one sampling time apart, made of rows at any times."""
        if not rows.time.size or not np.isfinite(self._period):
            return [rows]
        steps = np.diff(rows.time)
        step = np.nanmax([self._period, _usual([steps])])
        allowed = (self._format.time_tolerance + _INSTANTS) * step
        gaps = np.flatnonzero(steps >= (self._format.missing + 2) * step - allowed)
        self._tell_gaps(rows, gaps, f"rows are {step:g} s apart otherwise")
        made = list[_Rows]()
        for part in _cut(rows, gaps + 1):
            count = int(np.floor((part.time[-1] - part.time[0]) / self._period + _INSTANTS)) + 1
            time = part.time[0] + np.arange(count) * self._period
            before = np.searchsorted(part.time, time + _INSTANTS * self._period, side="right") - 1
            values = np.full((count, part.values.shape[1]), np.nan)
            for n, column in enumerate(part.values.T):
                values[:, n] = self._at(
                    time, part.time, column, is_held=self._tables[0].names[n] in self._held
                )
            made.append(_Rows(time, values, part.file[before], part.row[before]))
        samples, how = sum(len(part.time) for part in made), self._format.resample
        words = f"resampled to {samples} samples ({how})"
        self._count("resampled", f"row {words}", f"rows {words}", len(rows.time))
        return made

    def _at(self, time: FloatArray, given: FloatArray, column: FloatArray, *, is_held: bool) -> FloatArray:
        """Return the samples of one column; NaN where it says nothing."""
        known = np.isfinite(column)
        given, column = given[known], column[known]
        values, rounding = np.full(len(time), np.nan), _INSTANTS * self._period
        if not given.size:
            return values
        if self._format.resample == "mean":
            begin = time - (0.0 if is_held else self._period) - (rounding if is_held else -rounding)
            first = np.searchsorted(given, begin, side="left")
            ends = np.searchsorted(given, begin + self._period, side="left")
            some = ends > first
            bounds = np.column_stack([first[some], ends[some]]).ravel()
            sums = np.add.reduceat(np.append(column, 0.0), bounds)[::2]
            values[some] = sums / (ends - first)[some]
            return values
        before = np.searchsorted(given, time + rounding, side="right") - 1
        inside = before >= 0
        if self._format.resample == "hold":
            values[inside] = column[before[inside]]
            return values
        inside &= time <= given[-1] + rounding
        values[inside] = np.interp(time[inside], given, column)
        steps = np.diff(given)
        limit = (self._format.missing + 2) * max(self._period, _usual([steps])) * (1 - _INSTANTS)
        for i in np.flatnonzero(steps >= limit).tolist():
            values[(time > given[i] + rounding) & (time < given[i + 1] - rounding)] = np.nan
        return values

    def _bridged(self, rows: _Rows) -> list[_Rows]:
        """Return pieces without missing values: short runs of them interpolated, the others left out."""
        missing = ~np.isfinite(rows.values)
        missing &= np.isfinite(rows.values).any(axis=0)  # of what is not there, more has been told
        if not missing.any():
            return [rows]
        remaining, at = np.zeros_like(missing), np.arange(len(rows.time))
        for n in np.flatnonzero(missing.any(axis=0)).tolist():
            edges = np.flatnonzero(np.diff(np.concatenate([[0], missing[:, n], [0]])))
            begins, ends = edges[::2], edges[1::2]
            is_short = (ends - begins <= self._format.missing) & (begins > 0) & (ends < len(at))
            for begin, end in zip(begins[~is_short], ends[~is_short], strict=True):
                remaining[begin:end, n] = True
                self._longest_run = max(self._longest_run, int(end - begin))
            filled = missing[:, n] & ~remaining[:, n]
            known = ~missing[:, n]
            rows.values[filled, n] = np.interp(at[filled], at[known], rows.values[known, n])
            self._count("interpolated", "cell interpolated", "cells interpolated", int(filled.sum()))
        if self._format.gaps != "split":
            self._tell_missing(rows, remaining)
            return [rows]
        kept = np.flatnonzero(~remaining.any(axis=1))
        seams = np.flatnonzero(np.diff(kept) > 1) + 1
        left_out = len(rows.time) - len(kept)
        self._count("left out", "sample left out", "samples left out", left_out)
        self._count("split", "gap at which it is split", "gaps at which it is split", len(seams))
        return _cut(rows.of(kept), seams) if kept.size else []

    def _tell_missing(self, rows: _Rows, missing: _Mask) -> None:
        cells, places = list[tuple[str, str]](), list[int]()
        for i, n in np.argwhere(missing).tolist():
            table, row = self._tables[rows.file[i]], int(rows.row[i])
            if (row, n) in table.reported:
                continue
            word = table.words.get((row, n))
            what = "the cell is empty" if word is None else f'"{word}" is not a finite number'
            cells.append((f'line {table.lines[row]}, column "{table.headers[n]}"', what))
            places.append(i)
        split = 'gaps = "split" to leave out such samples'
        remedy = f"write {split}"
        if (longest := self._longest_run) <= _LONGEST_INTERPOLATED:
            remedy = f"write missing = {longest} to interpolate up to {longest} in a row, or {split}"
        self._add("missing", rows, np.array(places, dtype=np.int64), cells, remedy)

    def _tell_gaps(self, rows: _Rows, gaps: _Indices, needed: str) -> None:
        """Count gaps at which the log is split, or report them."""
        steps = np.diff(rows.time)
        if self._format.gaps == "split":
            self._count("split", "gap at which it is split", "gaps at which it is split", len(gaps))
            return
        clocks = [i for i in gaps.tolist() if self._is_change_of_clocks(rows, i, self._period)]
        if clocks:
            self._tell_change_of_clocks(rows, clocks)
        others = np.setdiff1d(gaps, clocks).astype(np.int64)
        jumps = [(self._where(rows, i + 1), self._after(rows, i)) for i in others.tolist()]
        samples = steps[others] / self._period
        is_even = np.abs(samples - np.rint(samples)) <= self._format.time_tolerance
        longest = (
            int(np.rint(samples).max()) - 1 if others.size and is_even.all() else _LONGEST_INTERPOLATED + 1
        )
        self._longest_gap = max(self._longest_gap, longest) if others.size else self._longest_gap
        remedy = 'write gaps = "split" to make pieces of it'
        if self._longest_gap <= _LONGEST_INTERPOLATED:
            remedy += f", or missing = {self._longest_gap:g} to interpolate"
        self._add("gaps", rows, others + 1, jumps, f"{needed}; {remedy}")

    def _is_change_of_clocks(self, rows: _Rows, i: int, period: float) -> bool:
        """Whether local times go on from a row as if clocks had been put forward or back."""
        if not self._tables[rows.file[i]].are_local or rows.file[i] != rows.file[i + 1]:
            return False
        step = float(rows.time[i + 1] - rows.time[i])
        by_an_hour = min(abs(step - period - _HOUR), abs(step - period + _HOUR)) <= 0.5 * period
        return by_an_hour and self._date(rows, i).month in _CHANGES

    def _tell_change_of_clocks(self, rows: _Rows, places: Sequence[int]) -> None:
        changes = [
            (self._where(rows, i + 1), f"{self._date(rows, i)} is followed by {self._date(rows, i + 1)}")
            for i in places
        ]
        remedy = 'that is probably daylight saving: write time_zone = "Europe/Berlin", or where the plant is'
        self._add("clocks", rows, np.array(places) + 1, changes, remedy)

    def _add(
        self, kind: str, rows: _Rows, at: _Indices, found: Sequence[tuple[str, str]], remedy: str
    ) -> None:
        for file in dict.fromkeys(rows.file[at].tolist()):
            of_file = [entry for entry, i in zip(found, at.tolist(), strict=True) if rows.file[i] == file]
            self._faults.add(kind, self._tables[file].file, of_file, remedy)

    def _where(self, rows: _Rows, i: int) -> str:
        table = self._tables[rows.file[i]]
        return f'line {table.lines[rows.row[i]]}, column "{table.time_header}"'

    def _after(self, rows: _Rows, i: int) -> str:
        """Return how far a row is from the one before it."""
        step, later = rows.time[i + 1] - rows.time[i], rows.time[i + 1]
        is_date = self._tables[rows.file[i]].instants is not None
        return (
            f"{self._date(rows, i + 1) if is_date else f'{later:.12g} s'} is {step:g} s after the row before"
        )

    def _date(self, rows: _Rows, i: int) -> datetime:
        return date_of(self._origin + round(rows.time[i] * 1e6))


def _joined(parts: Sequence[_Rows]) -> _Rows:
    if not parts:
        nothing = np.empty(0, dtype=np.int64)
        return _Rows(np.empty(0), np.empty((0, 0)), nothing, nothing)
    if len(parts) == 1:
        return parts[0]
    return _Rows(
        np.concatenate([part.time for part in parts]),
        np.concatenate([part.values for part in parts]),
        np.concatenate([part.file for part in parts]),
        np.concatenate([part.row for part in parts]),
    )


def _cut(rows: _Rows, seams: Any) -> list[_Rows]:
    """Return the pieces between the seams."""
    return [rows.of(slice(i, j)) for i, j in pairwise([0, *map(int, seams), len(rows.time)])]


def _usual(steps: Sequence[FloatArray]) -> float:
    """Return the median of the steps of time that go forward [s]; NaN if there are none."""
    forward = np.concatenate([some[some > 0.0] for some in steps] or [np.empty(0)])
    return float(np.median(forward)) if forward.size else np.nan


def _outliers(values: FloatArray, limit: float) -> _Mask:
    """Return which values are far from a running median.

    The scale is 1.4826 times the median absolute deviation of those that deviate at all: an input that is
    switched between levels deviates by what it is switched by (Hampel, J. Am. Stat. Assoc. 69, 1974).
    Where hardly any value deviates, as of one that rests, all of those are.
    """
    from scipy.ndimage import median_filter

    if values.size < _MEDIAN_OF:
        return np.zeros(len(values), dtype=bool)
    off = np.abs(values - median_filter(values, _MEDIAN_OF, mode="nearest"))
    deviating = off[off > 0.0]
    scale = _SCALE * np.median(deviating) if deviating.size > _RARE * values.size else 0.0
    return np.asarray(off > limit * scale, dtype=bool)
