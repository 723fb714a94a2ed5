"""Logs of plants as loggers write them: read as told, or refused with what to write instead."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np

from ddpc_cosim.codec import Prepared, Section
from ddpc_cosim.files.csv_files import TIME_TOLERANCE, Column, CSVFile, read_table, split_unit
from ddpc_cosim.settings import setting
from ddpc_cosim.variables import FloatArray


def _samples(value: Any) -> Any:
    return value["interpolate"] if isinstance(value, dict) and [*value] == ["interpolate"] else value


@dataclass(frozen=True, slots=True, kw_only=True)
class LogFormat(Section):
    """How files of logged data are read, and what is done about what is wrong with them."""

    time_column: str | list[str] = setting(
        "time", doc="header of the time in the files, or of date and time; empty: they have none"
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
    time_zone: str = setting(
        "", doc='where dates are local times, such as "Europe/Berlin"; empty: they have no daylight saving'
    )
    encoding: Literal["utf-8", "cp1252", "latin-1"] = setting("utf-8", doc="how the files are coded")
    gaps: Literal["refuse", "split"] = setting(
        "refuse", doc="where rows are missing; split: what is before and after are pieces of a mosaic"
    )
    missing: Annotated[int, Prepared(_samples, {"type": "object"})] = setting(
        0, low=0, doc="samples in a row that may be missing, and are interpolated; longer runs are gaps"
    )
    duplicates: Literal["refuse", "first", "last", "mean"] = setting(
        "refuse", doc="which of several rows of the same time counts, or their mean"
    )
    resample: Literal["no", "hold", "linear", "mean"] = setting(
        "no", doc="how rows at other times, or columns at several rates, become samples"
    )
    outliers: float = setting(
        0.0,
        low=0,
        doc="cells further than this many scaled median absolute deviations from a running median are "
        "missing; 0: none are",
    )


class Treatment(NamedTuple):
    """Something that was done to a log.

    Parameters
    ----------
    kind : str
        ``"interpolated"``, ``"duplicates"``, ``"split"``, ``"resampled"``, ``"outliers"`` or ``"sorted"``.
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
        Headers of the n columns without units, and these; empty where a column has none.
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
        The date of the first row, where the files have dates.
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
    lenient : bool
        Whether what is wrong is told in ``faults`` in place of an error, as far as files can be read at all.

    Raises
    ------
    DataError
        All that is wrong with the files, a line for each kind of fault.
    """
    path = Path(files[0] if isinstance(files, Sequence) and not isinstance(files, str) else files)
    file = CSVFile(path)
    header = [split_unit(name) for name in file.header if name != format.time_column]
    wanted = [Column(None, name) for name, _ in header] if columns is None else columns
    time, values = read_table(file, wanted, str(format.time_column), sampling_time, format.time_tolerance)
    period = float(np.median(np.diff(time))) if sampling_time is None else sampling_time
    names = tuple(column.header for column in wanted)
    return Log((str(path),), names, tuple(unit for _, unit in header), time, values, (), period)
