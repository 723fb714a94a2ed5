"""Values that a user gives in a unit, ``20 degC`` or ``20:24 degC``, and operating points in files."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from ddpc_cosim.description import Declarations, PlantSignal
from ddpc_cosim.errors import ConfigError, DataError
from ddpc_cosim.files.csv_files import CSVFile, split_unit
from ddpc_cosim.plant import ParameterValue
from ddpc_cosim.variables import converter

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_VALUE = re.compile(rf"\s*({_NUMBER})\s*(\S.*?)\s*")
_RANGE = re.compile(rf"\s*({_NUMBER})\s*:\s*({_NUMBER})\s*(\S.*?)?\s*")
_NAME, _OF_VALUE, _OF_UNIT = "name", "value", "unit"

AskedRange = tuple[float, float] | str
"""Two numbers in the signal's own unit, or a text such as ``20:24 degC``."""


OperatingPoint = (
    Mapping[str, ParameterValue] | str | Path | Sequence["Mapping[str, ParameterValue] | str | Path"]
)
"""Values by name, a file of them, or several: the later ones count."""


def operating_point(given: OperatingPoint) -> dict[str, ParameterValue]:
    """Return what is given, files read; ConfigError or DataError if one cannot be read."""
    parts = [given] if isinstance(given, Mapping | str | Path) else given
    tables = [part if isinstance(part, Mapping) else operating_point_of(Path(part)) for part in parts]
    return {name: value for table in tables for name, value in table.items()}


def with_own_units(
    description: Declarations, at: Mapping[str, ParameterValue], ranges: Mapping[str, AskedRange]
) -> tuple[dict[str, ParameterValue], dict[str, tuple[float, float]], list[str]]:
    """Return an operating point and ranges in the units of the plant, and what is wrong with theirs.

    Parameters
    ----------
    description : Declarations
        What the plant says about itself.
    at, ranges : mapping
        Values and ranges by name, with or without a unit. What is no number with a unit stays as it is.
    """
    levels, spans, faults = dict(at), dict[str, tuple[float, float]](), list[str]()
    for name, value in at.items():
        signal = description.signal(name)
        match = _VALUE.fullmatch(value) if isinstance(value, str) else None
        if match and signal is not None and signal.source.values == "real":
            try:
                levels[name] = _convert(signal, match[2])(float(match[1]))
            except ConfigError as error:
                faults += [f"operating point: {fault}" for fault in error.faults]
                del levels[name]
    for name, span in ranges.items():
        match = _RANGE.fullmatch(span) if isinstance(span, str) else None
        if match is None:
            spans[name] = span  # type: ignore[assignment]  # what is not a range is refused with the rest
            continue
        signal, low, high = description.signal(name), float(match[1]), float(match[2])
        try:
            convert = _convert(signal, match[3] or "") if signal is not None else float
            spans[name] = convert(low), convert(high)
        except ConfigError as error:
            faults += [f"range of {name}: {fault}" for fault in error.faults]
    return levels, spans, faults


def _convert(signal: PlantSignal, unit: str) -> Callable[[float], float]:
    """Return the conversion from a unit; the rounding of its last digits is left out."""
    convert = converter(signal.variable, unit)
    return lambda value: float(f"{convert(value):.14g}")


def operating_point_of(path: Path) -> dict[str, ParameterValue]:
    """Read an operating point from a file.

    Parameters
    ----------
    path : Path
        Lines of ``NAME=VALUE``; or a CSV file: one row of values under names as heads (``room [degC]``), or
        a row for each name under the heads ``name``, ``value`` and, if one likes, ``unit``. A value may have
        its unit behind it, or the name has it in brackets.

    Returns
    -------
    values : dict of str to number or str
        By name; those with a unit as a text: ``20 degC``.

    Raises
    ------
    DataError
        The file cannot be read, or is none of these; all faults at once.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read: {error}") from error
    first = next((line for line in text.splitlines() if line.strip() and line[0] != "#"), "")
    faults, assigned = list[str](), "=" in first
    triples = _assigned(path, text, faults) if assigned else _tabulated(CSVFile(path, text), faults)
    values: dict[str, ParameterValue] = {}
    for line, head, cell, unit_beside in triples:
        name, unit_of_head = split_unit(head.strip())
        value, unit = cell.strip(), unit_beside.strip() or unit_of_head
        if name in values:
            faults.append(f"{path}, line {line}: {name} is given more than once")
        elif name and not value:
            faults.append(f"{path}, line {line}: {name} has no value")
        elif name:
            values[name] = f"{value} {unit}" if unit else number_or_text(value)
    if faults:
        raise DataError(faults)
    return values


def _assigned(path: Path, text: str, faults: list[str]) -> Iterator[tuple[int, str, str, str]]:
    """Yield line, name, value and no unit of lines of NAME=VALUE."""
    for number, line in enumerate(text.splitlines(), start=1):
        name, equals, value = line.rpartition("=")
        if equals:
            yield number, name, value, ""
        elif line.strip() and not line.startswith("#"):
            faults.append(f'{path}, line {number}: "{line.strip()}" is not possible; needed: NAME=VALUE')


def _tabulated(file: CSVFile, faults: list[str]) -> Iterator[tuple[int, str, str, str]]:
    """Yield line, name, value and unit of a CSV file."""
    faults += file.faults
    heads = [head.lower() for head in file.header]
    if _NAME in heads and _OF_VALUE in heads:
        columns = [heads.index(head) if head in heads else None for head in (_NAME, _OF_VALUE, _OF_UNIT)]
        for line, row in zip(file.lines, file.rows, strict=True):
            name, value, unit = ("" if i is None else row[i] for i in columns)
            yield line, name, value, unit
    elif len(file.rows) == 1:
        for name, value in zip(file.header, file.rows[0], strict=True):
            yield file.lines[0], name, value, ""
    else:
        faults.append(
            f"{file.path}: {len(file.rows)} rows under names; needed: one row of values, or lines of "
            "NAME=VALUE, or the columns name and value"
        )


def number_or_text(text: str) -> float | str:
    """Return a text as a number if it is one."""
    try:
        return float(text)
    except ValueError:
        return text
