"""Dates of loggers and spreadsheets as microseconds since 1970."""

import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.variables import FloatArray

Instants = NDArray[np.int64]
"""Times in microseconds since 1970."""
NO_TIME = np.iinfo(np.int64).min
_EPOCH = datetime(1970, 1, 1)
_MICROSECOND = timedelta(microseconds=1)
_QUARTER = 900 * 10**6  # within which no zone changes its offset
_MOST_KEPT = 100_000
_DAY = 86_400.0
_MILLISECONDS = 1e11  # from which on a number is not seconds since 1970, which would be of the year 5138
_CLOCK = re.compile(r"\d{1,2}:\d{2}(?::\d{2}(?:[.,]\d{1,9})?)?(?:\s*[AaPp]\.?[Mm]\.?)?")
_EXCEL = datetime(1899, 12, 30)
_DATE = re.compile(
    r"(?P<first>\d{1,4})(?P<mark>[./-])(?P<second>\d{1,2})(?P=mark)(?P<third>\d{4}|\d{1,2})"
    r"(?:[T,\s]\s*(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<seconds>\d{2})(?:[.,:](?P<fraction>\d{1,9}))?)?"
    r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<offset>Z|[+-]\d{2}:?\d{2})?)?"
)
_NAMED = re.compile(r"(\d{1,2})([-./])([^\W\d_]{3,9})\.?\2(\d{4}|\d{2})(?=[T,\s]|$)")
_MONTHS = (
    ("jan",),
    ("feb",),
    ("mar", "mrz", "mär"),
    ("apr",),
    ("may", "mai"),
    ("jun",),
    ("jul",),
    ("aug",),
    ("sep",),
    ("oct", "okt"),
    ("nov",),
    ("dec", "dez"),
)
_ORDERS = {"dd/mm/yyyy": "dmy", "mm/dd/yyyy": "mdy"}


class Dates(NamedTuple):
    """What a column of dates says.

    Parameters
    ----------
    instants : array, shape (T,)
        Their times; NO_TIME where a cell is not a date.
    faults : dict of int to str
        What is wrong with a cell, by its row.
    remedy : str
        What to do about it.
    are_local : bool
        They are local times of a zone that is not known.
    """

    instants: Instants
    faults: dict[int, str]
    remedy: str
    are_local: bool


def date_in(cell: str, order: str = "") -> datetime | None:
    """Return the date of a cell: ISO 8601, dd.mm.yyyy, or as ``dmy`` and ``mdy`` say; None if it is none."""
    return _iso(cell) or _from_parts(cell, order)


def is_date(cell: str) -> bool:
    """Whether a cell is a date, though perhaps an ambiguous one."""
    return _iso(cell) is not None or _DATE.fullmatch(_in_numbers(cell.strip())) is not None


def is_clock(cell: str) -> bool:
    """Whether a cell is a time of the day without a date."""
    return _CLOCK.fullmatch(cell.strip()) is not None


def read_clocks(cells: Sequence[str]) -> tuple[FloatArray, dict[int, str]]:
    """Return times of the day [s], a day more after each midnight, and what is wrong with others by row."""
    dates = read_dates([f"1970-01-01 {cell.strip()}" for cell in cells], "auto", "")
    known = dates.instants > NO_TIME
    seconds = np.where(known, dates.instants / 1e6, np.nan)
    days = np.cumsum(np.diff(seconds[known], prepend=seconds[known][:1]) < -_DAY / 2)
    seconds[known] += _DAY * days
    faults = {i: f'"{cells[i].strip()[:40]}" is not a time of the day' for i in dates.faults}
    return seconds, {i: what if cells[i].strip() else _EMPTY for i, what in faults.items()}


def epochs(numbers: FloatArray) -> Instants | None:
    """Return the times of numbers since 1970 in ms, us or ns, by their size; None if they are seconds."""
    known = np.isfinite(numbers)
    smallest = np.abs(numbers[known]).min(initial=np.inf)
    if not _MILLISECONDS <= smallest < np.inf:
        return None
    power = 3 - 3 * int(smallest >= _MILLISECONDS * 1e3) - 3 * int(smallest >= _MILLISECONDS * 1e6)
    instants = np.full(len(numbers), NO_TIME, dtype=np.int64)
    instants[known] = np.round(numbers[known] * 10.0**power).astype(np.int64)
    return instants


def _in_numbers(cell: str) -> str:
    """Return a date whose month is named, as dd.mm.yyyy."""
    match = _NAMED.match(cell)
    if match is None:
        return cell
    begin = match[3].lower()[:3]
    month = next((i for i, names in enumerate(_MONTHS, 1) if begin in names), 0)
    return f"{match[1]}.{month}.{match[4]}{cell[match.end() :]}"


def read_dates(cells: Sequence[str], written: str, time_zone: str) -> Dates:
    """Return the times that cells say.

    Parameters
    ----------
    cells : sequence of str
        Dates with the time of the day.
    written : {"auto", "dd/mm/yyyy", "mm/dd/yyyy"}
        How they are written; auto: in ISO 8601, or with dots and the day first.
    time_zone : str
        Where they are local times, unless they have an offset; empty: unknown.
    """
    order = _ORDERS.get(written, "")
    said = _Said(order)
    moments = [said.moment(cell) for cell in cells]
    wrong = [i for i, moment in enumerate(moments) if moment is None]
    empty = {i: _EMPTY for i in wrong if not cells[i].strip()}
    wrong = [i for i in wrong if i not in empty]
    faults, remedy = {i: f'"{cells[i].strip()[:40]}" is not a date' for i in wrong}, ""
    if wrong:
        faults, remedy = _ambiguous([cells[i] for i in wrong], wrong, order) or (faults, _KNOWN)
    faults |= empty
    instants = np.array([NO_TIME if moment is None else moment[0] for moment in moments], dtype=np.int64)
    has_offset = np.array([moment is not None and moment[1] for moment in moments], dtype=bool)
    local = ~has_offset & (instants > NO_TIME)
    if has_offset.any() and local.any() and not time_zone:
        usual = bool(has_offset[0])
        odd = {
            i: f'"{cells[i].strip()[:40]}" has {"no" if usual else "a"} time zone, and the first date has '
            f"{'one' if usual else 'none'}"
            for i in np.flatnonzero(local if usual else has_offset).tolist()
        }
        faults, remedy = faults | odd, 'time_zone = "Europe/Berlin", or where it was, says that of the others'
    return _placed(instants, local, time_zone, faults, remedy)


def dates_at(instants: Instants, time_zone: str, *, with_zone: bool) -> Dates:
    """Return the times that instants say, NO_TIME where there is none: universal ones, or local times."""
    faults = {int(i): _EMPTY for i in np.flatnonzero(instants == NO_TIME)}
    local: NDArray[np.bool_] = (instants > NO_TIME) & (not with_zone)
    return _placed(instants, local, time_zone, faults, "")


def _placed(
    instants: Instants, local: NDArray[np.bool_], time_zone: str, faults: dict[int, str], remedy: str
) -> Dates:
    """Make local times universal ones, if their zone is known."""
    if time_zone and local.any():
        said = instants.copy()
        for i in _to_universal(instants, local, time_zone):
            faults[i] = f'"{date_of(int(said[i]))}" does not exist in {time_zone}, where an hour was left out'
            remedy = "leave time_zone out if the logger does not know daylight saving"
    return Dates(instants, faults, remedy, bool(local.any()) and not time_zone)


_EMPTY = "the cell is empty"
_KNOWN = 'needed: ISO 8601 or dd.mm.yyyy, or what dates = "dd/mm/yyyy", "mm/dd/yyyy" or "excel" says'


def excel_dates(days: FloatArray) -> Instants:
    """Return the times of days since 1899-12-30, to a millisecond; NO_TIME of what is not finite."""
    instants = np.full(len(days), NO_TIME, dtype=np.int64)
    known = np.isfinite(days) & (np.abs(days) < 1e7)
    begin = (_EXCEL - _EPOCH) // _MICROSECOND
    instants[known] = begin + np.round(days[known] * 86_400_000).astype(np.int64) * 1000
    return instants


def date_of(instant: int) -> datetime:
    """Return a time as a date."""
    return _EPOCH + instant * _MICROSECOND


def _ambiguous(cells: Sequence[str], rows: Sequence[int], order: str) -> tuple[dict[int, str], str] | None:
    """Return what is to be told where it is not known whether the day or the month stands first."""
    matches = [_DATE.fullmatch(cell.strip()) for cell in cells]
    parts = [match for match in matches if match and match["mark"] in "/-"]
    if order or len(parts) < len(cells):
        return None
    faults = {
        row: f'"{cell.strip()[:40]}" has the day or the month first'
        for row, cell in zip(rows, cells, strict=True)
    }
    days = {"dd/mm/yyyy": parts[0]["first"], "mm/dd/yyyy": parts[0]["second"]}
    for match in parts:
        for written, key in (("dd/mm/yyyy", "first"), ("mm/dd/yyyy", "second")):
            if int(match[key]) > 12:
                return faults, f'write dates = "{written}", as there is a day {match[key]}'
    both = " or ".join(f'dates = "{written}" (a day {day})' for written, day in days.items())
    return faults, f"write {both}"


def _iso(cell: str) -> datetime | None:
    with suppress(ValueError):
        return datetime.fromisoformat(cell.strip())
    return None


class _Said:
    """What dates in one way of writing say, each day and each time of the day being read once."""

    def __init__(self, order: str) -> None:
        self._order = order
        self._days: dict[str, tuple[int, bool] | None] = {}
        self._clocks: dict[str, tuple[int, bool] | None] = {}

    def moment(self, cell: str) -> tuple[int, bool] | None:
        """Return the microseconds since 1970 that a cell says, and whether it has an offset."""
        day, mark, clock = cell.strip().partition(" ")
        if not mark:
            day, mark, clock = day.partition("T")
        if day not in self._days:
            self._days[day] = self._read(day)
        begin = self._days[day]
        if not mark or begin is None:
            return begin
        if clock not in self._clocks:
            if len(self._clocks) >= _MOST_KEPT:
                self._clocks.clear()
            self._clocks[clock] = self._read(f"1970-01-01 {clock}")
        since = self._clocks[clock]
        return None if since is None else (begin[0] + since[0], since[1])

    def _read(self, cell: str) -> tuple[int, bool] | None:
        moment = date_in(cell, self._order)
        if moment is None:
            return None
        has_offset = moment.tzinfo is not None
        universal = moment.astimezone(UTC).replace(tzinfo=None) if has_offset else moment
        return (universal - _EPOCH) // _MICROSECOND, has_offset


def _from_parts(cell: str, order: str) -> datetime | None:
    match = _DATE.fullmatch(_in_numbers(cell.strip()))
    if match is None:
        return None
    first, mark, second, third, hour, minute, seconds, fraction, half, offset = match.groups()
    if len(first) > 2:
        order = "ymd"
    elif mark == ".":
        order = "dmy"
    elif not order:
        return None
    parts = dict(zip(order, (first, second, third), strict=True))
    year = int(parts["y"]) + (2000 if len(parts["y"]) < 3 else 0)
    clock = int(hour or 0)
    if half:
        clock = clock % 12 + 12 * (half[0] in "Pp")
    clock_time = (clock, int(minute or 0), int(seconds or 0), int((fraction or "0").ljust(6, "0")[:6]))
    with suppress(ValueError):
        moment = datetime(year, int(parts["m"]), int(parts["d"]), *clock_time)
        if offset:
            return datetime.fromisoformat(moment.isoformat() + offset)
        return moment
    return None


def _to_universal(instants: Instants, local: NDArray[np.bool_], time_zone: str) -> list[int]:
    """Make local times universal ones, in place, and return those that do not exist.

    Of an hour that is repeated it is the second one where it would otherwise be before the time before.
    """
    from zoneinfo import ZoneInfo

    zone, rows = ZoneInfo(time_zone), np.flatnonzero(local)
    quarters, places = np.unique(instants[rows] // _QUARTER, return_inverse=True)
    offsets = np.empty((2, len(quarters)), dtype=np.int64)
    for i, quarter in enumerate(quarters.tolist()):
        moment = date_of(quarter * _QUARTER).replace(tzinfo=zone)
        for fold in (0, 1):
            offset = moment.replace(fold=fold).utcoffset() or timedelta()
            offsets[fold, i] = offset // _MICROSECOND
    earlier, later = offsets[0][places], offsets[1][places]
    universal = instants[rows] - earlier
    instants[rows] = universal
    for i in np.flatnonzero(earlier > later).tolist():
        row = rows[i]
        if row and instants[row - 1] > NO_TIME and instants[row] < instants[row - 1]:
            instants[row] = universal[i] + earlier[i] - later[i]
    return [int(row) for row in rows[earlier < later]]
