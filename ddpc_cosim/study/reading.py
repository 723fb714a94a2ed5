"""From a study file to a resolved study: every error of the file at once, each with its line."""

import re
import tomllib
from collections.abc import Iterator, Mapping
from operator import itemgetter
from pathlib import Path
from typing import Any

from ddpc_cosim.errors import ConfigError, Place, PluginError, dotted
from ddpc_cosim.plugins import find_modules_in, load_plugin
from ddpc_cosim.study.resolve import ResolvedStudy, resolve
from ddpc_cosim.study.sections import Study
from ddpc_cosim.study.validation_errors import ValidationErrors, parse

_MAY_END = re.compile(r"""[\]}]|"{3}|'{3}""")  # a value over several lines


def read_study(name: str) -> ResolvedStudy:
    """Read a study file, or a built-in or plug-in study by name, and resolve it.

    Raises
    ------
    ConfigError
        There is no such study, or it has errors: all of them, each with file, line, key and what to do.
    """
    path = find_study(name)
    if path == Path(name):
        find_modules_in(path.parent)
    try:
        # Some editors put a byte order mark in front, which TOML does not know.
        text = path.read_text(encoding="utf-8-sig")
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # numbers or nesting beyond measure are no TOML errors
        raise ConfigError(f"{path.name}: not a TOML file: {error}") from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    data.setdefault("name", _as_name(path.stem))
    errors = ValidationErrors()
    study = parse(Study, data, path.parent, errors)
    resolved = resolve(study, path.parent, errors)
    if resolved is None:
        raise ConfigError(_with_lines(path.name, errors, key_lines(text)))
    return resolved


def _with_lines(file: str, errors: ValidationErrors, lines: Mapping[Place, int]) -> list[str]:
    """Return the errors in the order of their lines; what is missing has the line of its table."""
    located = []
    for place, messages in errors.found.items():
        line = next((lines[place[:n]] for n in range(len(place), 0, -1) if place[:n] in lines), 0)
        where = f"{file}:{line}" if line else file
        located += [(line, f"{where}: {dotted(place)}: {message}") for message in messages]
    return [text for _, text in sorted(located, key=itemgetter(0))]


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
