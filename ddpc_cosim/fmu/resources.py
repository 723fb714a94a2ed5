"""What an FMU has in its folder ``resources``: tables over time, and what its author says of its use.

The files and their keys are BOPTEST's (D. Blum et al., J. Building Performance Simulation 14(5), 2021,
doi:10.1080/19401493.2021.1986574): ``config.json``, ``days.json``, ``kpis.json``, and CSV files with a column
``time`` in s from the start of the year. Nothing of the FMU is unpacked or run.
"""

import json
import math
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from numbers import Real
from pathlib import Path
from typing import Any, Protocol

from ddpc_cosim.description import KeyFigureTags
from ddpc_cosim.errors import DataError
from ddpc_cosim.files.texts import clipped, printable
from ddpc_cosim.files.time_tables import LARGEST, TimeTable, base_name, read_time_table
from ddpc_cosim.fmu.archive import DAMAGED
from ddpc_cosim.fmu.description.defects import Findings, Kind, Severity

UNREADABLE_RESOURCE = Kind(
    "unreadable-resource",
    Severity.WARNING,
    "files in resources/ that are not what their names say",
    "what is wrong is left out; the FMU itself may read them otherwise",
)
NO_TIME_TABLE = Kind(
    "no-time-table",
    Severity.NOTE,
    "CSV files in resources/ that are not tables over time",
    'a signal of kind "resource" needs a column "time"',
)

_FOLDER = "resources/"
_LARGEST_JSON = 1_000_000  # bytes
_MOST_TABLES = 50
_LONGEST_SHOWN = 60
_LAST_DAY = 366
_MONEY_PER_ENERGY, _MASS_PER_ENERGY = "EUR/kWh", "kg/kWh"
_UNITS = {
    "K": "TDryBul TDewPoi TWetBul TBlaSky LowerSetp UpperSetp",
    "W/m2": "HGloHor HDirNor HDifHor HHorIR",
    "W": "InternalGainsRad InternalGainsCon InternalGainsLat",
    "ppm": "UpperCO2",
    "Pa": "pAtm",
    "m/s": "winSpe",
    "m": "ceiHei",
    "s": "cloTim solTim",
    "rad": "winDir solAlt solZen solDec solHouAng lat lon",
    "1": "relHum nTot nOpa Occupancy",
}
_UNIT_OF = {name: unit for unit, names in _UNITS.items() for name in names.split()}
"""Units of columns where a file does not say them: those of BOPTEST's ``data/categories.json``."""


def usual_unit(column: str) -> str:
    """Return the unit that a column has by BOPTEST's convention; empty: there is none.

    Of prices it is not said in which money they are; here that is EUR.
    """
    name = base_name(column)
    if name.startswith("Price"):
        return _MONEY_PER_ENERGY
    return _MASS_PER_ENERGY if name.startswith("Emissions") else _UNIT_OF.get(name, "")


def unit_of(table: TimeTable, column: str) -> str:
    """Return the unit of a column: what its file says, else what it is by convention; empty: neither."""
    return table.units.get(column) or usual_unit(column)


class Files(Protocol):
    """Files by name, which are read when they are asked for."""

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""

    def content(self, name: str, most: int) -> bytes:
        """Return a file, of ``most`` bytes at most; DataError: it cannot be read, or is larger."""


class ResourceFiles:
    """The files in the folder ``resources`` of an FMU, which are read when they are asked for.

    Parameters
    ----------
    path : Path
        The FMU.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._entries: dict[str, zipfile.ZipInfo] = {}
        try:
            with zipfile.ZipFile(path) as archive:
                entries = archive.infolist()
        except (*DAMAGED, OSError):  # told by whoever unpacks it
            entries = []
        for entry in entries:
            name = entry.filename.replace("\\", "/")
            if name.startswith(_FOLDER) and not name.endswith("/"):
                self._entries.setdefault(name.removeprefix(_FOLDER), entry)

    @property
    def names(self) -> tuple[str, ...]:
        """Their names, in the order of the archive; of one in a folder with that."""
        return tuple(self._entries)

    @property
    def tables(self) -> tuple[str, ...]:
        """The names of those that may be tables over time."""
        return tuple(name for name in self._entries if name.lower().endswith(".csv"))

    def content(self, name: str, most: int) -> bytes:
        """Return a file, of ``most`` bytes at most.

        Raises
        ------
        DataError
            It is damaged, or larger.
        """
        try:
            with zipfile.ZipFile(self._path) as archive, archive.open(self._entries[name]) as file:
                content = file.read(most + 1)
        except (*DAMAGED, OSError) as error:
            raise DataError(f"{name}: cannot be read: {error}") from error
        if len(content) > most:
            raise _too_large(name, most)
        return content

    def table(self, name: str) -> TimeTable:
        """Return a file as a table over time; DataError: it is none, or cannot be read."""
        return read_time_table(name, self.content(name, LARGEST))


class ModelFiles:
    """The texts that a plant of equations has for the resources of its FMU, tables excepted.

    Parameters
    ----------
    texts : mapping of str to str or callable
        The texts, or what makes them, by name.
    """

    def __init__(self, texts: Mapping[str, str | Callable[[], str]]) -> None:
        self._texts = texts

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(self._texts)

    def content(self, name: str, most: int) -> bytes:
        """Return a file; DataError: it is larger than ``most`` bytes."""
        text = self._texts[name]
        content = (text if isinstance(text, str) else text()).encode()
        if len(content) > most:
            raise _too_large(name, most)
        return content


def _too_large(name: str, most: int) -> DataError:
    return DataError(f"{name}: is too large; allowed: {most / 1e6:g} MB")


def _ignore(_: str) -> None:
    """Let a fault go by, which `inspect` tells."""


def key_figure_tags(files: Files) -> KeyFigureTags | None:
    """Return what key figures are of by ``config.json`` and ``kpis.json``; None where these do not say it."""
    area = _number(_json(files, "config.json", _ignore), "area", _ignore, above=0.0)
    sources = dict(_key_figures(_json(files, "kpis.json", _ignore), _ignore))
    return None if area is None or not sources else KeyFigureTags(area, sources)


@dataclass(frozen=True, slots=True)
class Resources:
    """What the resources of an FMU say; what they do not say is None or empty.

    Parameters
    ----------
    files : tuple of str
        Names of all files.
    name : str
        What the case is called.
    area : float or None
        Floor area [m2].
    step : float or None
        The step of control that its author had in mind [s].
    warm_up : float or None
        How long it is to run before anything is judged [s].
    start_time : float or None
        When that begins, from the start of the year [s].
    days : mapping of str to int
        Days of the year, counted from 1, by name; each is the middle of 14 days.
    key_figures : mapping of str to tuple of str
        Outputs of the plant by what they are the source of, as ``OperativeZoneTemperature[1]``.
    tables : tuple of TimeTable
        Tables over the time from the start of the year.
    """

    files: tuple[str, ...] = ()
    name: str = ""
    area: float | None = None
    step: float | None = None
    warm_up: float | None = None
    start_time: float | None = None
    days: Mapping[str, int] = field(default_factory=dict)
    key_figures: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    tables: tuple[TimeTable, ...] = ()

    def find(self, column: str) -> tuple[TimeTable, str] | None:
        """Return the first table with a column, and its unit; None: there is none."""
        for table in self.tables:
            if column in table.columns:
                return table, unit_of(table, column)
        return None


def read_resources(path: Path, findings: Findings) -> Resources:
    """Return what the resources of an FMU say; what is wrong with them is added to the findings."""
    files = ResourceFiles(path)

    def tell(fault: str) -> None:
        findings.add(UNREADABLE_RESOURCE, printable(fault))

    config = _json(files, "config.json", tell)
    return Resources(
        files=files.names,
        name=_text(config.get("name")),
        area=_number(config, "area", tell, above=0.0),
        step=_number(config, "step", tell, above=0.0),
        warm_up=_number(config, "warmup_period", tell, low=0.0),
        start_time=_number(config, "start_time", tell),
        days=dict(_days(_json(files, "days.json", tell), tell)),
        key_figures=dict(_key_figures(_json(files, "kpis.json", tell), tell)),
        tables=tuple(_tables(files, findings, tell)),
    )


Tell = Callable[[str], None]


def _json(files: Files, name: str, tell: Tell) -> dict[str, Any]:
    """Return the object that a JSON file holds; an empty one where it is not there or is none."""
    if name not in files.names:
        return {}
    try:
        content = json.loads(files.content(name, _LARGEST_JSON).decode("utf-8-sig"), parse_constant=_refuse)
    except DataError as error:
        tell(str(error))
    except json.JSONDecodeError as error:
        tell(f"{name}, line {error.lineno}: not JSON: {error.msg}")
    except (ValueError, RecursionError) as error:  # not text, NaN, or brackets within brackets
        tell(f"{name}: not JSON: {error}")
    else:
        if isinstance(content, dict):
            return content
        tell(f"{name}: {_shown(content)}; needed: a JSON object")
    return {}


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is not a number of JSON")


def _number(
    config: Mapping[str, Any], key: str, tell: Tell, *, low: float = -math.inf, above: float = -math.inf
) -> float | None:
    """Return a number of config.json, or a text that is one; None where there is none that is possible."""
    value = config.get(key)
    if value is None:
        return None
    try:
        number = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if math.isfinite(number) and low <= number and above < number:
        return number
    allowed = f" > {above:g}" if math.isfinite(above) else f" >= {low:g}" if math.isfinite(low) else ""
    tell(f"config.json: {key} = {_shown(value)}; needed: a finite number{allowed}")
    return None


def _text(value: object) -> str:
    return clipped(printable(value), _LONGEST_SHOWN) if isinstance(value, str) else ""


def _days(content: Mapping[str, Any], tell: Tell) -> Iterator[tuple[str, int]]:
    for name, day in content.items():
        is_number = isinstance(day, Real) and not isinstance(day, bool)
        if is_number and 1 <= float(day) <= _LAST_DAY and float(day).is_integer():
            yield name, int(day)
        else:
            tell(f"days.json: {_shown(name)} = {_shown(day)}; needed: a day of the year, 1 to {_LAST_DAY}")


def _key_figures(content: Mapping[str, Any], tell: Tell) -> Iterator[tuple[str, tuple[str, ...]]]:
    for source, outputs in content.items():
        if isinstance(outputs, list) and all(isinstance(output, str) for output in outputs):
            yield source, tuple(outputs)
        else:
            tell(f"kpis.json: {_shown(source)}: {_shown(outputs)}; needed: a list of names of outputs")


def _tables(files: ResourceFiles, findings: Findings, tell: Tell) -> Iterator[TimeTable]:
    for name in files.tables[:_MOST_TABLES]:
        try:
            table = files.table(name)
        except DataError as error:
            findings.add(NO_TIME_TABLE, printable(str(error)))
            continue
        for fault in table.faults:
            tell(fault)
        yield table
    if len(files.tables) > _MOST_TABLES:
        tell(f"{len(files.tables)} CSV files; read are the first {_MOST_TABLES}")


def _shown(value: object) -> str:
    return clipped(printable(repr(value)), _LONGEST_SHOWN)
