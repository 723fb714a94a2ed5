"""Study files: their tables, with those that they take from other files, and where each of them stands."""

import re
import reprlib
import tomllib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Self

from ddpc_cosim.codec import in_folder, plant_in_folder, with_names
from ddpc_cosim.errors import ConfigError, CosimError, Place, PluginError, dotted
from ddpc_cosim.files.texts import DeepTablesError, toml_tables
from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.settings import PLANT, SettingInfo
from ddpc_cosim.study.file_format.replacing import (
    CONTROLLERS,
    EXTENDS,
    OF_PROBLEM,
    PROBLEMS,
    STUDY,
    SWEEP,
    Table,
    extended,
    not_said,
    replaced,
)
from ddpc_cosim.study.file_format.requirements import REQUIREMENTS
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.file_format.sweeps import path_of
from fmu_plants.files import is_file

_MAY_END = re.compile(r"""[\]}]|"{3}|'{3}""")  # a value over several lines


@dataclass(eq=False)
class StudyFile:
    """The tables of a study file, or of a study that was made otherwise.

    Parameters
    ----------
    label : str
        Its name in messages.
    folder : Path
        Paths in it are relative to this.
    tables : dict
        Its content, with what it takes from other files, in which paths are absolute.
    text : str
        From which the lines of errors are told; empty: they are not.
    taken : dict of Place to (StudyFile, Place)
        The places that it takes from other files, and where they stand there.
    faults : list of (StudyFile, Place, str)
        What it cannot take, or does not fit what it takes: where, and what is wrong.
    source : str
        The path or the plug-in's name by which it was asked for; empty: it was not read from a file.
    """

    label: str
    folder: Path
    tables: Table
    text: str = ""
    taken: dict[Place, tuple["StudyFile", Place]] = field(default_factory=dict)
    faults: list["Fault"] = field(default_factory=list)
    source: str = ""

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a TOML file, and what it takes from others.

        Raises
        ------
        ConfigError
            It, or the study that it extends, cannot be read, or is not TOML.
        """
        file = cls._read(path, path.name, {}, {})
        if EXTENDS in file.tables:  # without it, no more can be said
            raise ConfigError(file.fault_messages())
        return file

    def origin(self, place: Place) -> tuple["StudyFile", Place]:
        """Return the file that says a place of the tables, and the place there."""
        for n in range(len(place), 0, -1):
            if place[:n] in self.taken:
                file, there = self.taken[place[:n]]
                return file.origin((*there, *place[n:]))
        return self, place

    def line(self, place: Place) -> int:
        """Return the line of a place of this file, of its table where it is missing; 0: it is not known."""
        beginnings = (place[:n] for n in range(len(place), 0, -1))
        return next((self._lines[beginning] for beginning in beginnings if beginning in self._lines), 0)

    def message(self, place: Place, fault: str) -> str:
        """Return what is wrong with a place of this file, as a message says it."""
        line = self.line(place)
        return f"{self.label}{f':{line}' if line else ''}: {dotted(place)}: {fault}"

    def fault_messages(self) -> list[str]:
        """Return the faults as messages say them."""
        return [file.message(place, fault) for file, place, fault in dict.fromkeys(self.faults)]

    @cached_property
    def _lines(self) -> dict[Place, int]:
        return key_lines(self.text)

    @classmethod
    def _read(cls, path: Path, label: str, above: dict[Path, str], known: dict[Path, Self]) -> Self:
        """Read a file for those above it; what has been read is known."""
        key = path.resolve()
        if key in above:
            raise ConfigError(f"takes from itself: {' -> '.join([*above.values(), label])}")
        if key not in known:
            file = cls._alone(path, label)
            file._take(above | {key: label}, known)
            known[key] = file
        return known[key]

    @classmethod
    def _alone(cls, path: Path, label: str) -> Self:
        """Read a file without what it takes from others."""
        try:
            # Some editors put a byte order mark in front, which TOML does not know.
            text = path.read_text(encoding="utf-8-sig")
            tables = toml_tables(text)
        except DeepTablesError as error:
            raise ConfigError(f"{label}: {error}") from error
        except (ValueError, RecursionError) as error:  # numbers or nesting beyond measure are not TOML errors
            raise ConfigError(f"{label}: not a TOML file: {error}") from error
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
        tables.setdefault("name", _as_name(path.stem))
        return cls(label, path.parent, tables, text)

    def _take(self, above: dict[Path, str], known: dict[Path, Self]) -> None:
        """Take the study that it extends, and those that its problems name; the key of what fails stays."""
        file_tables = self.tables
        base = self._other((EXTENDS,), file_tables[EXTENDS], above, known) if EXTENDS in file_tables else None
        if base is not None and EXTENDS not in base.tables:
            self.tables, faults = extended(self._tables_of(base), file_tables, base.label)
            self.faults += [(self, place, fault) for place, fault in faults]
            self.taken |= {place: (base, place) for place in not_said(self.tables, file_tables)}
            before = base.tables.get("based_on")
            names = [str(base.tables["name"]), *(before if isinstance(before, list) else ())]
            self.tables = self.tables | {"based_on": names}
        problems = self.tables.get(PROBLEMS)
        for name, problem in problems.items() if isinstance(problems, dict) else ():
            place = (PROBLEMS, name)
            if not (isinstance(problem, dict) and STUDY in problem):
                continue
            other = self._other((*place, STUDY), problem[STUDY], above, known)
            if other is None or EXTENDS in other.tables:
                continue
            if PROBLEMS in other.tables:
                what = f"{other.label} has problems itself; needed: a study with [plant], [loop], ..."
                self.faults.append((self, (*place, STUDY), what))
                continue
            theirs = {key: value for key, value in self._tables_of(other).items() if key in OF_PROBLEM}
            if isinstance(asked := theirs.get(REQUIREMENTS), dict):  # its controllers are not this study's
                theirs[REQUIREMENTS] = {key: value for key, value in asked.items() if key != CONTROLLERS}
            said = {key: value for key, value in problem.items() if key != STUDY}
            whole = replaced(theirs, said, leave_out=True)
            self.tables = self.tables | {PROBLEMS: self.tables[PROBLEMS] | {name: whole}}
            self.taken |= {(*place, *below): (other, below) for below in not_said(whole, said)}

    def _other(
        self, place: Place, named: Any, above: dict[Path, str], known: dict[Path, Self]
    ) -> Self | None:
        """Return the study that a place names; None if there is none, which is a fault."""
        try:
            if not isinstance(named, str):
                what = "must be a study file or the name of a built-in study"
                raise ConfigError(f"{what}, got {reprlib.repr(named)}")
            beside = in_folder(self.folder, named)
            is_there = is_file(beside)
            label = str(Path(self.label).parent / named) if is_there else named
            study = self._read(beside if is_there else _plugin_study(named), label, above, known)
        except CosimError as error:
            self.faults.append((self, place, str(error)))
            return None
        self.faults += study.faults
        return study

    def _tables_of(self, other: "StudyFile") -> Table:
        same = other.folder.resolve() == self.folder.resolve()
        return other.tables if same else absolute_paths(other.tables, other.folder)


Fault = tuple[StudyFile, Place, str]
"""A file, a place in it, and what is wrong there."""


def find_study(name: str) -> Path:
    """Return the path of a study given as a file or by the name of a built-in or plug-in study."""
    if name.lower().endswith((".fmu", ".ssp")):
        raise ConfigError(f"{name}: is a plant and not a study; `ddpc-cosim init {name}` proposes one")
    return Path(name) if is_file(Path(name)) else _plugin_study(name)


def _plugin_study(name: str) -> Path:
    if Path(name).suffix == ".toml" or len(Path(name).parts) > 1:
        raise ConfigError(f"{name}: no such study file")
    try:
        return Path(load_plugin("studies", name))
    except PluginError as error:
        raise ConfigError(f"{error}; or give the path of a study file") from error


def _as_name(stem: str) -> str:
    """Return the name of a study whose file gives none: the file's, as far as names may have its letters."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", stem).strip("._-")[:60] or "study"


def absolute_paths(tables: Table, folder: Path) -> Table:
    """Return the tables of a study, or of a problem, in which files are named by absolute paths."""

    def absolute(info: SettingInfo, name: str) -> str:
        if info.plant:
            return plant_in_folder(folder, name)
        return name if name in ("", PLANT) else str(in_folder(folder, name))

    def of_sweep(key: str, values: Any) -> Any:
        """Return values by a path: those of a study that says nothing else."""
        path = path_of(key) or ()
        path = path[2:] if path[:1] == (PROBLEMS,) else path
        table = values
        for name in reversed(path):
            table = {name: table}
        with suppress(LookupError, TypeError):
            table[CONTROLLERS][path[1]] |= {"type": tables[CONTROLLERS][path[1]]["type"]}
        table = with_names(Study, table, absolute) if path else table
        for name in path:
            table = table[name]
        return table

    resolved: Table = with_names(Study, tables, absolute)
    if isinstance(problems := resolved.get(PROBLEMS), dict):
        resolved[PROBLEMS] = {
            name: absolute_paths(problem, folder) if isinstance(problem, dict) else problem
            for name, problem in problems.items()
        }
    if isinstance(sweep := resolved.get(SWEEP), list | dict):
        resolved[SWEEP] = [
            {key: of_sweep(key, values) for key, values in table.items()}
            if isinstance(table, dict)
            else table
            for table in ([sweep] if isinstance(sweep, dict) else sweep)
        ]
    return resolved


def key_lines(text: str) -> dict[Place, int]:
    """Return the line, counted from 1, on which each key of a TOML file begins.

    What stands in a value that goes over several lines has the line on which the value begins.
    """
    lines: dict[Place, int] = {}
    lengths: dict[Place, int] = {}  # of the arrays of tables, so far
    table: Place = ()
    statement, begins = "", 1
    for number, line in enumerate(
        text.split("\n"), start=1
    ):  # other separators of lines may stand in a comment
        goes_on = bool(statement)
        statement, begins = (f"{statement}\n{line}", begins) if goes_on else (line, number)
        if goes_on and not _MAY_END.search(line):
            continue
        try:
            content = tomllib.loads(statement)
        except tomllib.TOMLDecodeError:  # a value that goes on
            continue
        if statement.lstrip().startswith("["):
            table = _header_place(content, lengths)
            for n in range(1, len(table) + 1):  # what a header implies above its table too
                lines.setdefault(table[:n], begins)
        else:
            for place in _places(content, table):
                lines.setdefault(place, begins)
        statement = ""
    return lines


def _header_place(content: dict[str, Any], lengths: dict[Place, int]) -> Place:
    """Return the place of a table from its header by itself; arrays of tables are counted."""
    place: Place = ()
    below: Any = content
    while below:
        ((key, below),) = below.items()
        place = (*place, key)
        if isinstance(below, list):
            lengths[place] = lengths.get(place, 0) + 1
            below = {}
        if place in lengths:
            place = (*place, lengths[place] - 1)
    return place


def _places(value: Any, place: Place) -> Iterator[Place]:
    """Yield the places of everything in a value."""
    for key, item in value.items() if isinstance(value, dict) else enumerate(value):
        yield (*place, key)
        if isinstance(item, dict | list):
            yield from _places(item, (*place, key))
