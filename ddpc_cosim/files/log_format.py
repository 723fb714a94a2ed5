"""How files of logged data are read, said once for study files and Python, and what is wrong with them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from ddpc_cosim.codec import Prepared, Rule, Section
from ddpc_cosim.files.csv_files import TIME_TOLERANCE
from ddpc_cosim.settings import setting
from fmu_plants.spelling import did_you_mean

_MOST_PLACES = 4


def _samples(value: Any) -> Any:
    """Return ``3`` for the table ``{ interpolate = 3 }``."""
    return value["interpolate"] if isinstance(value, dict) and [*value] == ["interpolate"] else value


def _zone(name: str) -> str:
    import zoneinfo

    if not name:
        return name
    try:
        zoneinfo.ZoneInfo(name)
    except (OSError, ValueError, zoneinfo.ZoneInfoNotFoundError) as error:
        known = zoneinfo.available_timezones()
        hint = did_you_mean(name, known) if known else "this system knows none: `pip install tzdata`"
        raise ValueError(f'must be the name of a time zone, got "{name[:60]}"; {hint}') from error
    return name


WHOLE = [0.0, 1.0]
"""All samples."""


def _part(shares: list[float]) -> list[float]:
    if len(shares) != 2 or not 0.0 <= shares[0] < shares[1] <= 1.0:
        raise ValueError(f"must be two shares between 0 and 1, the smaller first, got {shares}")
    return shares


_INTERPOLATE = {"type": "object", "properties": {"interpolate": {"type": "integer", "minimum": 0}}}


@dataclass(frozen=True, slots=True, kw_only=True)
class LogFormat(Section):
    """How files of logged data are read, and what is done about what is wrong with them."""

    time_column: str | list[str] = setting(
        "time", doc="header of the time in the files, or those of date and time; empty: they have none"
    )
    time_tolerance: float = setting(
        TIME_TOLERANCE,
        low=0,
        below=0.5,
        doc="how far rows may be from one sampling time apart, in parts of it",
    )
    dates: Literal["auto", "dd/mm/yyyy", "mm/dd/yyyy", "excel"] = setting(
        "auto",
        doc="how dates in the files are written; auto: ISO 8601 or dd.mm.yyyy; excel: days since 1899-12-30",
    )
    time_zone: Annotated[str, Rule(_zone)] = setting(
        "", doc='where dates are local times, such as "Europe/Berlin"; empty: they have no daylight saving'
    )
    encoding: Literal["utf-8", "utf-16", "cp1252", "latin-1"] = setting(
        "utf-8", doc="how the files are coded, if they do not begin with a mark that says it"
    )
    gaps: Literal["refuse", "split"] = setting(
        "refuse",
        doc="where rows are missing; split: what is before and after are pieces of a mosaic, and files with "
        "dates are put in the order of time",
    )
    missing: Annotated[int, Prepared(_samples, _INTERPOLATE)] = setting(
        0,
        low=0,
        doc="how many samples in a row may be missing, and are interpolated; longer runs are gaps",
    )
    missing_values: list[float] = setting(
        [], doc="numbers that stand for a missing value, such as -999; a cell that holds one is missing"
    )
    duplicates: Literal["refuse", "first", "last", "mean"] = setting(
        "refuse",
        doc="which of several rows of one time counts, or their mean; rows are put in the order of time",
    )
    resample: Literal["no", "hold", "linear", "mean"] = setting(
        "no",
        doc="how rows at other times, or columns at several rates, become samples: the last value before, a "
        "line between two, or the mean over one sampling time, of inputs the one after the sample, of others "
        "the one before",
    )
    outliers: float = setting(
        0.0,
        low=0,
        doc="cells further than this many scaled median absolute deviations from a running median are "
        "missing; 0: none are",
    )

    part: Annotated[list[float], Rule(_part)] = setting(
        WHOLE,
        doc="which samples are taken, from one share of them to another: [0.5, 1.0] is the second half",
    )

    @property
    def time_columns(self) -> tuple[str, ...]:
        """The headers of the time: none, one, or those of date and time."""
        given = [self.time_column] if isinstance(self.time_column, str) else self.time_column
        return tuple(filter(None, given))


class Faults:
    """What is wrong with files: a line for each kind, with the first places and what to do."""

    def __init__(self) -> None:
        self._kinds: dict[str, list[tuple[str, str, str]]] = {}
        self._numbers: dict[str, int] = {}
        self._remedies: dict[str, str] = {}

    def add(
        self, kind: str, file: str, found: Sequence[tuple[str, str]], remedy: str = "", number: int = 0
    ) -> None:
        """Take note of faults of a kind in a file.

        Parameters
        ----------
        kind : str
            What they have in common.
        file : str
            The file.
        found : sequence of (str, str)
            Where the first of them are, such as ``line 3``, and what is wrong there.
        remedy : str
            What to do.
        number : int
            How many there are; 0: as many as are found.
        """
        if found:
            places = [(file, *place) for place in found[:_MOST_PLACES]]
            self._kinds.setdefault(kind, []).extend(places)
            self._numbers[kind] = self._numbers.get(kind, 0) + (number or len(found))
            self._remedies[kind] = remedy

    @property
    def lines(self) -> tuple[str, ...]:
        """Each kind of fault in one line."""
        return tuple(self._line(kind, places) for kind, places in self._kinds.items())

    def _line(self, kind: str, places: Sequence[tuple[str, str, str]]) -> str:
        (file, where, what), *others = places
        number, remedy = self._numbers[kind], self._remedies[kind]
        column = where.partition(", ")[2]
        named = [
            " of ".join(filter(None, (at.removesuffix(f", {column}"), other if other != file else "")))
            for other, at, _ in others
        ][: _MOST_PLACES - 1]
        more = ""
        if number > 1:
            also = f", then {', '.join(filter(None, named))}" if any(named) else ""
            also += ", ..." if also and number > 1 + len(named) else ""
            more = f" ({number} in all{also})"
        text = ": ".join(filter(None, (", ".join(filter(None, (file, where))), what))) + more
        return f"{text}; {remedy}" if remedy else text
