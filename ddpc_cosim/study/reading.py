"""From a study file to a resolved study: every error of the file at once, each with its line."""

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple, Self

from ddpc_cosim.errors import ConfigError, Place, PluginError, dotted
from ddpc_cosim.plugins import find_modules_in, load_plugin
from ddpc_cosim.study.file_format.sections import Study, StudyHead
from ddpc_cosim.study.file_format.validation_errors import ValidationErrors, in_folder, parse
from ddpc_cosim.study.problems import PROBLEMS, FlatStudy, Taken, flat_studies, has_key
from ddpc_cosim.study.resolve import Known, ResolvedProblems, ResolvedStudy, resolve
from ddpc_cosim.study.variants import SWEEP, with_variants

_MOST_LISTED = 4
_MAY_END = re.compile(r"""[\]}]|"{3}|'{3}""")  # a value over several lines


class StudyFile(NamedTuple):
    """The tables of a study file, or of a study that was made otherwise.

    Parameters
    ----------
    label : str
        Its name in messages.
    folder : Path
        Paths in it are relative to this.
    tables : dict
        Its content.
    text : str
        From which the lines of errors are told; empty: they are not.
    """

    label: str
    folder: Path
    tables: dict[str, Any]
    text: str = ""

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a TOML file.

        Raises
        ------
        ConfigError
            It cannot be read, or is not TOML.
        """
        try:
            # Some editors put a byte order mark in front, which TOML does not know.
            text = path.read_text(encoding="utf-8-sig")
            tables = tomllib.loads(text)
        except (ValueError, RecursionError) as error:  # numbers or nesting beyond measure are no TOML errors
            raise ConfigError(f"{path.name}: not a TOML file: {error}") from error
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
        tables.setdefault("name", _as_name(path.stem))
        return cls(path.name, path.parent, tables, text)


def read_study(name: str) -> ResolvedProblems:
    """Read a study file, or a built-in or plug-in study by name, and resolve it.

    Raises
    ------
    ConfigError
        There is no such study, or it has errors: all of them, each with file, line, key and what to do.
    """
    path = find_study(name)
    if path == Path(name):
        find_modules_in(path.parent)
    return resolve_file(StudyFile.read(path))


def resolve_file(file: StudyFile) -> ResolvedProblems:
    """Resolve each problem of a study.

    Raises
    ------
    ConfigError
        It has errors: all of them, each with file, line, key and what to do.
    """
    tables, common, read_files = file.tables, ValidationErrors(), dict[str, StudyFile]()

    def read(named: str) -> Taken:
        beside = in_folder(file.folder, named)
        taken = StudyFile.read(beside if beside.is_file() else find_study(named))
        read_files[named] = taken._replace(label=named)
        return Taken(named, taken.folder, taken.tables)

    flat = {key: value for key, value in tables.items() if key != SWEEP}
    parts = [FlatStudy(tables["name"], flat, lambda place: ("", place))]
    head = None
    if PROBLEMS in tables:
        parts = list(flat_studies(tables, file.folder, read, common))
        own = {key: tables[key] for key in StudyHead.model_fields if key in tables}
        head = parse(StudyHead, own, file.folder, common)
    if SWEEP in tables:
        parts = list(with_variants(parts, tables[SWEEP], common))
    # Where each error stands, and in which problems: one in what they share is told once.
    found: dict[tuple[str, Place, str], list[str]] = {}
    problems = dict[str, ResolvedStudy]()
    known = Known()
    try:
        for part in parts:
            errors = ValidationErrors()
            resolved = resolve(parse(Study, part.tables, file.folder, errors), file.folder, errors, known)
            for place, messages in errors.found.items():
                for message in messages:
                    within = found.setdefault((*part.origin(place), message), [])
                    within += [str(part.tables["name"])] if part.problem not in within else []
            if resolved is not None:
                problems[resolved.study.name] = resolved
    finally:
        known.forget()
    for place, messages in common.found.items():
        found |= {("", place, message): [] for message in messages}
    if found:
        raise ConfigError(_with_lines(found, parts, {"": file, **read_files}))
    first = next(iter(problems.values())).study
    if head is None and len(problems) > 1:  # a flat file with variants
        head = StudyHead.model_validate({key: getattr(first, key) for key in StudyHead.model_fields})
    return ResolvedProblems(head or first, problems)


def _with_lines(
    found: Mapping[tuple[str, Place, str], list[str]],
    parts: Sequence[FlatStudy],
    files: Mapping[str, StudyFile],
) -> list[str]:
    """Return the errors in the order of their lines; what is missing has the line of its table.

    An error in what several problems share names those that have it, unless it is in all that share it.
    """
    lines = {label: key_lines(file.text) for label, file in files.items()}
    located = []
    for (label, place, message), within in found.items():
        known = lines[label]
        line = next((known[place[:n]] for n in range(len(place), 0, -1) if place[:n] in known), 0)
        where = f"{files[label].label}:{line}" if line else files[label].label
        shared = {
            part.problem for part in parts if place[0] != "controllers" or has_key(part.tables, place[:2])
        }
        is_of_some = place[0] not in (PROBLEMS, SWEEP) and PROBLEMS not in place[2:3]
        named = ", ".join(within[:_MOST_LISTED]) + (", ..." if within[_MOST_LISTED:] else "")
        which = f" (problem {named})" if within and is_of_some and not shared <= set(within) else ""
        located.append((label, line, f"{where}: {dotted(place)}: {message}{which}"))
    return [text for *_, text in sorted(located, key=itemgetter(0, 1))]


def find_study(name: str) -> Path:
    """Return the path of a study given as a file or by the name of a built-in or plug-in study."""
    path = Path(name)
    if path.is_file():
        return path
    if path.suffix == ".toml" or len(path.parts) > 1:
        raise ConfigError(f"{name}: no such study file")
    try:
        return Path(load_plugin("studies", name))
    except PluginError as error:
        raise ConfigError(f"{error}; or give the path of a study file") from error


def _as_name(stem: str) -> str:
    """Return the name of a study whose file gives none: the file's, as far as names may have its letters."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", stem).strip("._-")[:60] or "study"


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
