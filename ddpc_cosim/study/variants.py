"""Variants of problems: a study's sweep, which sets anything in it by its path."""

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from functools import partial
from typing import Any

from ddpc_cosim.codec import ValidationErrors
from ddpc_cosim.errors import Place
from ddpc_cosim.study.file_format.replacing import CONTROLLERS, PROBLEMS, SWEEP, Table, with_report
from ddpc_cosim.study.file_format.requirements import REQUIREMENTS
from ddpc_cosim.study.file_format.sweeps import (
    MOST_VARIANTS,
    ZIP,
    combinations,
    count,
    path_of,
    sweep_errors,
    swept_values,
    variant_label,
    variant_name,
)
from ddpc_cosim.study.problems import OF_HEAD, FlatStudy


def with_variants(parts: Sequence[FlatStudy], sweep: Any, errors: ValidationErrors) -> Iterator[FlatStudy]:
    """Yield each problem, and after it its variants by the study's sweep; what is wrong is reported.

    Parameters
    ----------
    parts : sequence of FlatStudy
        The problems.
    sweep : list of dict or dict
        Tables of values by path: ``{"loop.sampling_time": [0.1, 0.2]}``.
    errors : ValidationErrors
        What is found is added.
    """
    tables = _checked(parts, [sweep] if isinstance(sweep, dict) else sweep, errors)
    taken = {part.problem for part in parts}
    for part in parts:
        yield part
        number = 0
        for i, table in enumerate(tables):
            paths = {key: path for key, path in _paths_of(table).items() if _concerns(path, part.problem)}
            swept = {key: table[key] for key in (*paths, ZIP) if key in table}
            for varied in combinations(swept) if paths else ():
                number += 1
                name = variant_name(part.problem, varied, number)
                if name in taken:
                    errors.add((SWEEP, i), f'two variants are called "{name}"; change a value')
                taken.add(name)
                try:
                    yield _variant(part, name, varied, {key: (paths[key], i) for key in varied})
                except (TypeError, IndexError, AttributeError):
                    errors.add((SWEEP, i), "a path leads into a list or a value that has no such entry")


def _checked(parts: Sequence[FlatStudy], sweep: Any, errors: ValidationErrors) -> list[Table]:
    """Return the tables of a sweep with their values written out; none if there are errors."""
    if not (isinstance(sweep, list) and all(isinstance(table, dict) for table in sweep)):
        errors.add((SWEEP,), 'must be a table or tables of values by path: "loop.sampling_time" = [0.1, 0.2]')
        return []
    before, tables = len(errors.found), list[Table]()
    for i, table in enumerate(sweep):
        tables.append({})
        for key, value in table.items():
            try:
                tables[-1][key] = swept_values(value)
            except ValueError as error:
                errors.add((SWEEP, i, key), str(error))
            if key != ZIP and (fault := _path_error(parts, path_of(key))):
                errors.add((SWEEP, i, key), fault)
        for key, fault in sweep_errors(tables[-1]):
            errors.add((SWEEP, i, key) if key else (SWEEP, i), fault)
    if (variants := count(tables)) > MOST_VARIANTS:
        errors.add((SWEEP,), f"{variants} variants; allowed: {MOST_VARIANTS}")
    return tables if len(errors.found) == before else []


def _paths_of(table: Table) -> dict[str, Place]:
    return {key: path for key in table if key != ZIP and (path := path_of(key))}


def _concerns(path: Place, problem: str) -> bool:
    return path[0] != PROBLEMS or path[1] == problem


def _path_error(parts: Sequence[FlatStudy], path: Place | None) -> str:
    """Return what is wrong with where a path begins; what it leads to is checked with each variant."""
    if path is None:
        return 'not a path; needed: keys with dots between them, such as loop.sampling_time or plant."a.b"'
    if path[0] in (*OF_HEAD, "report", REQUIREMENTS, SWEEP) or len(path) < 2:
        return "not a setting of a problem or of a controller, such as loop.sampling_time"
    known = {
        PROBLEMS: [part.problem for part in parts],
        CONTROLLERS: [key for part in parts for key in _keys(part.tables.get(CONTROLLERS))],
    }
    if path[0] in known and (path[1] not in known[path[0]] or len(path) < 3):
        kind = path[0].removesuffix("s")
        return f"must name a key of a {kind}; there are: {', '.join(dict.fromkeys(known[path[0]]))}"
    return ""


def _keys(value: Any) -> Sequence[str]:
    return list(value) if isinstance(value, dict) else []


def _variant(
    part: FlatStudy, name: str, varied: dict[str, Any], paths: Mapping[str, tuple[Place, int]]
) -> FlatStudy:
    """Return a problem with other values at some paths."""
    tables = {key: table for key, table in part.tables.items() if key != REQUIREMENTS}
    places: dict[Place, Place] = {}
    for key, (path, table) in paths.items():
        inner = path[2:] if path[0] == PROBLEMS else path
        places[_set(tables, inner, varied[key])] = (SWEEP, table, key)
    # Of controllers that do not differ no run is repeated.
    if all(place[0] == CONTROLLERS for place in places):
        changed = {place[1] for place in places}
        left_out = tables[CONTROLLERS].keys() - changed
        tables = with_report(tables, left_out)
        tables[CONTROLLERS] = {key: section for key, section in tables[CONTROLLERS].items() if key in changed}
    changes = {"variant_of": part.problem, "varied": varied, "name": name}
    changes["title"] = variant_label(str(part.tables.get("title") or part.problem), varied)
    return FlatStudy(part.problem, tables | changes, partial(_origin, part, places))


def _set(tables: Any, path: Place, value: Any) -> Place:
    """Set what a path leads to, and return the path with the indices of lists as numbers.

    What is on the way to it is copied, the first tables excepted: others may have it too.
    """
    place: Place = ()
    for key in path[:-1]:
        index = _index(tables, key)
        if isinstance(tables, dict) and not isinstance(tables.get(index), dict | list):
            tables[index] = {}
        tables[index] = copy(tables[index])
        tables, place = tables[index], (*place, index)
    index = _index(tables, path[-1])
    tables[index] = value
    return (*place, index)


def _index(tables: Any, key: Any) -> Any:
    return int(key) if isinstance(tables, list) and key.isdecimal() and int(key) < len(tables) else key


def _origin(part: FlatStudy, places: Mapping[Place, Place], place: Place) -> Place:
    for path, of_sweep in places.items():
        if place[: len(path)] == path or (place == path[:-1]):
            return of_sweep
    return part.origin(place)
