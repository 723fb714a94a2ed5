"""Logs as loggers and spreadsheets write them, made from a recording of a plant of ours, and what is true.

The truth is ``docs/examples/tanks-monday.csv``: two pumps, two levels, a row every 5 s. Each log says the
same with something that the reader of logs has to be told, or with something wrong.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple
from zoneinfo import ZoneInfo

import numpy as np

from ddpc_cosim import FloatArray

SAMPLING_TIME = 5.0
NAMES = ("pump_1", "pump_2", "level_1", "level_2")
UNITS = ("V", "V", "mm", "mm")
_ROWS = 120
_MONDAY = Path(__file__).parents[1] / "docs" / "examples" / "tanks-monday.csv"
_BERLIN = ZoneInfo("Europe/Berlin")


class MessyLog(NamedTuple):
    """A log, by which keys of ``recording`` it is read, and what is in it then.

    Parameters
    ----------
    name : str
        What is special about it.
    files : dict of str to bytes
        Its files by name.
    keys : dict
        What has to be said for it to be read.
    values : array, shape (T, 4)
        What is read then, in V and mm.
    seams : tuple of int
        The first row of every piece but the first.
    columns : dict of str to str
        Headers that are not the signals' names.
    treatments : tuple of str
        What is said of what was done.
    """

    name: str
    files: Mapping[str, bytes]
    keys: Mapping[str, Any]
    values: FloatArray
    seams: tuple[int, ...] = ()
    columns: Mapping[str, str] = {}
    treatments: tuple[str, ...] = ()

    def write(self, folder: Path) -> list[Path]:
        """Write its files and return their paths."""
        for name, content in self.files.items():
            (folder / name).write_bytes(content)
        return [folder / name for name in self.files]


def truth(rows: int = _ROWS) -> FloatArray:
    """Return what was recorded: the four signals of the first rows, shape (rows, 4)."""
    lines = _MONDAY.read_text(encoding="utf-8").splitlines()[1 : rows + 1]
    return np.array([[float(cell.replace(",", ".")) for cell in line.split(";")[1:5]] for line in lines])


def messy_logs() -> Iterator[MessyLog]:
    """Yield the logs."""
    values = truth()
    yield MessyLog("dots and commas", _german(values), {"encoding": "cp1252"}, values)
    american = _log(values, "%m/%d/%Y %I:%M:%S %p", header=("time", *_headers("{} ({})")))
    yield MessyLog("month first", {"log.csv": american}, {"dates": "mm/dd/yyyy"}, values)
    yield MessyLog("offsets", {"log.csv": _log(values, _with_offset, begin=_SPRING)}, {}, values)
    clocks = {"log.csv": _log(values, _local, begin=_AUTUMN)}
    yield MessyLog("clocks put back", clocks, {"time_zone": "Europe/Berlin"}, values)
    yield MessyLog("two rows of headers", {"log.csv": _two_headers(values)}, {}, values)
    yield _with_gaps(values)
    yield _with_duplicates(values)
    yield _with_empty_cells(values)
    stuck = values.copy()
    stuck[40:, 2] = stuck[40, 2]
    yield MessyLog("stuck sensor", {"log.csv": _log(stuck)}, {}, stuck)
    yield _at_two_rates(values)
    yield _with_outliers(values)
    yield _with_codes(values)
    yield _with_tags(values)
    yield _of_scope(values)
    yield MessyLog("aligned columns", {"log.txt": _aligned(values)}, {}, values)
    yield MessyLog("units in cells", {"log.csv": _with_units(values)}, {}, values)


_BEGIN = datetime(2026, 3, 2, 8, tzinfo=UTC)
_SPRING = datetime(2026, 3, 29, 0, 58, tzinfo=UTC)
_AUTUMN = datetime(2026, 10, 25, 0, 55, tzinfo=UTC)


def _headers(how: str = "{} [{}]") -> list[str]:
    return [how.format(name, unit) for name, unit in zip(NAMES, UNITS, strict=True)]


def _with_offset(moment: datetime) -> str:
    return moment.astimezone(_BERLIN).isoformat()


def _local(moment: datetime) -> str:
    return moment.astimezone(_BERLIN).strftime("%Y-%m-%d %H:%M:%S")


def _rows(
    values: FloatArray, date: str | Callable[[datetime], str] = "%Y-%m-%d %H:%M:%S", begin: datetime = _BEGIN
) -> list[list[str]]:
    """Return the cells of the rows, a missing value empty."""
    moments = [begin + timedelta(seconds=SAMPLING_TIME * i) for i in range(len(values))]
    dates = [moment.strftime(date) if isinstance(date, str) else date(moment) for moment in moments]
    cells = [["" if np.isnan(value) else repr(value) for value in row] for row in values.tolist()]
    return [[date, *row] for date, row in zip(dates, cells, strict=True)]


def _text(header: Sequence[str], rows: Sequence[Sequence[str]], mark: str = ",") -> str:
    return "\n".join(mark.join(row) for row in (header, *rows)) + "\n"


def _log(
    values: FloatArray,
    date: str | Callable[[datetime], str] = "%Y-%m-%d %H:%M:%S",
    begin: datetime = _BEGIN,
    header: Sequence[str] = ("time", *_headers()),
) -> bytes:
    return _text(header, _rows(values, date, begin)).encode()


def _with_commas(rows: Sequence[Sequence[str]]) -> list[list[str]]:
    return [[date, *(cell.replace(".", ",") for cell in row)] for date, *row in rows]


def _german(values: FloatArray) -> dict[str, bytes]:
    rows = [
        [date, *(cell.replace(".", ",") for cell in row)] for date, *row in _rows(values, "%d.%m.%Y %H:%M:%S")
    ]
    rows = [[*row, "20,5"] for row in rows]
    return {"log.csv": _text(["time", *_headers(), "hall [\N{DEGREE SIGN}C]"], rows, ";").encode("cp1252")}


def _two_headers(values: FloatArray) -> bytes:
    rows = [["", *UNITS], *_rows(values, "%d.%m.%Y %H:%M:%S,000")]
    text = _text(
        ["time", *NAMES],
        [[cell.replace(".", ",") if i else cell for i, cell in enumerate(row)] for row in rows],
        ";",
    )
    return f"\ufeffsep=;\nlogger;TX-4\nserial number;0815\n{text}".encode()


def _with_gaps(values: FloatArray) -> MessyLog:
    """Rows 30 to 39 and 80 to 99 are missing; the two files are told in the wrong order."""
    rows, header = _rows(values), ["time", *_headers()]
    files = {"late.csv": rows[60:80] + rows[100:], "early.csv": rows[:30] + rows[40:60]}
    kept = [*range(30), *range(40, 80), *range(100, _ROWS)]
    texts = {name: _text(header, some).encode() for name, some in files.items()}
    said = ("2 gaps at which it is split",)
    return MessyLog("gaps", texts, {"gaps": "split"}, values[kept], (30, 70), treatments=said)


def _with_duplicates(values: FloatArray) -> MessyLog:
    rows = _rows(values)
    rows[20:20] = [rows[19]]
    rows[70:70] = [[rows[69][0], "0", "0", "0", "0"]] * 2
    content = {"log.csv": _text(["time", *_headers()], rows).encode()}
    return MessyLog(
        "duplicates", content, {"duplicates": "first"}, values, treatments=("3 duplicate rows dropped",)
    )


def _with_empty_cells(values: FloatArray) -> MessyLog:
    """Of level_1 two samples are missing in a row, and of level_2 one, which a logger says in words."""
    with_holes, at = values.copy(), np.arange(len(values))
    with_holes[50:52, 2] = with_holes[90, 3] = np.nan
    rows, expected = _rows(with_holes), values.copy()
    rows[90][4] = "Bad"
    for column in (2, 3):
        known = np.isfinite(with_holes[:, column])
        expected[:, column] = np.interp(at, at[known], values[known, column])
    content = {"log.csv": _text(["time", *_headers()], rows).encode()}
    return MessyLog("empty cells", content, {"missing": 2}, expected, treatments=("3 cells interpolated",))


def _at_two_rates(values: FloatArray) -> MessyLog:
    """level_2 is logged in every third row, and hence a line between two of these."""
    slow, at = values.copy(), np.arange(len(values))
    slow[at % 3 > 0, 3] = np.nan
    expected = values.copy()
    expected[:, 3] = np.interp(at, at[::3], values[::3, 3])
    expected = expected[: at[::3][-1] + 1]
    keys = {"resample": "linear", "gaps": "split"}
    left_out = (f"{len(values) - len(expected)} samples left out",)
    said = (f"{len(values)} rows resampled to {len(values)} samples (linear)", *left_out)
    return MessyLog("two rates", {"log.csv": _log(slow)}, keys, expected, treatments=said)


def _with_outliers(values: FloatArray) -> MessyLog:
    spiked, at = values.copy(), np.arange(len(values))
    spiked[[25, 75], 2] = 9999.0
    expected, known = values.copy(), np.isin(at, [25, 75], invert=True)
    expected[:, 2] = np.interp(at, at[known], values[known, 2])
    said = ("2 outliers taken out", "2 cells interpolated")
    keys = {"outliers": 20.0, "missing": 1}
    return MessyLog("outliers", {"log.csv": _log(spiked)}, keys, expected, treatments=said)


def _with_codes(values: FloatArray) -> MessyLog:
    """A number where the logger had none, close enough together that no median tells it."""
    coded, at = values.copy(), np.arange(len(values))
    coded[[25, 26], 2] = -999.0
    expected, known = values.copy(), np.isin(at, [25, 26], invert=True)
    expected[:, 2] = np.interp(at, at[known], values[known, 2])
    said = ("2 cells that hold a missing value's number", "2 cells interpolated")
    keys = {"missing_values": [-999.0], "missing": 2}
    return MessyLog("codes", {"log.csv": _log(coded)}, keys, expected, treatments=said)


def _with_tags(values: FloatArray) -> MessyLog:
    """Tag names, the date in one column and the time in another, and a line for the next row at the end."""
    tags = ("P101.OUT", "P102.OUT", "LIC101.PV", "LIC102.PV")
    header = ["Date", "Time", *(f"{tag} ({unit})" for tag, unit in zip(tags, UNITS, strict=True))]
    rows = [[*date.split(), *row] for date, *row in _rows(values, "%d/%m/%Y %H:%M:%S")]
    content = {"log.csv": (_text(header, rows, "\t") + "\t\t\t\t\t\n").encode()}
    keys = {"time_column": ["Date", "Time"], "dates": "dd/mm/yyyy"}
    return MessyLog("tags", content, keys, values, columns=dict(zip(NAMES, tags, strict=True)))


def _of_scope(values: FloatArray) -> MessyLog:
    """As TwinCAT Scope exports it: channels below each other, times in ms before those of one sampling time.

    Pumps were recorded every 5 s and levels every 10 s, whose rows hence end in the middle of the file.
    """
    groups, slow, at = [(NAMES[:2], 5000), (NAMES[2:], 10000)], values[::2, 2:], np.arange(len(values))
    units = dict(zip(NAMES, ("V (Voltage)", "V (Voltage)", "mm (Length)", "mm (Length)"), strict=True))
    said = {
        "Name": lambda name, _: name,
        "SymbolComment": lambda *_: "",
        "Data-Type": lambda *_: "REAL64",
        "SampleTime[ms]": lambda _, period: str(period),
        "SymbolName": lambda name, _: f"MAIN.{name}",
        "Unit": lambda name, _: units[name],
    }
    ticks = 10 * round(_BEGIN.timestamp() * 1e6) + 116_444_736_000_000_000
    rows = [
        ["Name", "tanks"],
        ["File", "C:\\scopes\\tanks.svdx"],
        ["Starttime of export", str(ticks), "Montag, 2. M\u00e4rz 2026", "09:00:00.000"],
        [],
        [],
        *(
            [cell for names, period in groups for cell in (key, *(text(name, period) for name in names))]
            for key, text in said.items()
        ),
        [],
        *(
            [
                f"{5000 * i}",
                *map(repr, values[i, :2].tolist()),
                *([f"{10000 * i}", *map(repr, slow[i].tolist())] if i < len(slow) else []),
            ]
            for i in range(len(values))
        ),
        ["EOF"],
    ]
    text = "\n".join("\t".join(row) for row in rows).replace(".", ",")
    expected = values[: at[::2][-1] + 1].copy()
    for n in (2, 3):
        expected[:, n] = np.interp(at[: len(expected)], at[::2], values[::2, n])
    return MessyLog(
        "TwinCAT Scope",
        {"log.csv": text.encode()},
        {"missing": 1, "gaps": "split"},
        expected,
        treatments=("118 cells interpolated", "1 sample left out"),
    )


def _aligned(values: FloatArray) -> bytes:
    """Columns that blanks align, as a report prints them; date and time of the day in one of them."""
    rows = [["time", *_headers()], *_rows(values)]
    return "\n".join("  ".join(cell.rjust(20) for cell in row) for row in rows).encode()


def _with_units(values: FloatArray) -> bytes:
    """The unit stands in each cell, and not in the header."""
    rows = [
        [date, *(f"{cell} {unit}" for cell, unit in zip(row, UNITS, strict=True))]
        for date, *row in _rows(values)
    ]
    return _text(["time", *NAMES], rows).encode()
