"""From a study file to a resolved study: every error of the file at once, each with its line."""

import warnings
from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path

import numpy as np

from ddpc_cosim.codec import ValidationErrors, declared_fields, read_in
from ddpc_cosim.errors import ConfigError, CosimWarning
from ddpc_cosim.loop.data_quality import CANNOT_FOLLOW, references_beyond_limits
from ddpc_cosim.plugins import find_modules_in
from ddpc_cosim.processes.limits import limits_warning
from ddpc_cosim.signals.signals import Band, Reference, values_at
from ddpc_cosim.study.file_format.replacing import PROBLEMS, SWEEP
from ddpc_cosim.study.file_format.sections import Study, StudyHead
from ddpc_cosim.study.file_format.study_files import Fault, StudyFile, find_study
from ddpc_cosim.study.problems import FlatStudy, flat_studies, has_key
from ddpc_cosim.study.resolve import Limits, ResolvedProblems, ResolvedStudy, StudyCache, resolve
from ddpc_cosim.study.variants import with_variants
from ddpc_cosim.variables import FloatArray
from fmu_plants.spelling import did_you_mean

_MOST_LISTED = 4


def read_study(name: str, problem: str | None = None) -> ResolvedProblems:
    """Read a study file, or a built-in or plug-in study by name, and resolve it.

    Parameters
    ----------
    name : str
        The file or the name.
    problem : str or None
        The only one of its problems that is wanted; default: all.

    Raises
    ------
    ConfigError
        There is no such study, or it has errors: all of them, each with file, line, key and what to do.
    """
    return resolve_file(read_file(name), problem)


def read_file(name: str) -> StudyFile:
    """Read a study file, or that of a built-in or plug-in study; controllers may be in modules beside it.

    Raises
    ------
    ConfigError
        There is no such study, or it is not TOML.
    """
    path = find_study(name)
    if path == Path(name):
        find_modules_in(path.parent)
    file = StudyFile.read(path)
    file.source = str(path.absolute()) if path == Path(name) else name
    return file


def resolve_file(file: StudyFile, problem: str | None = None) -> ResolvedProblems:
    """Resolve each problem of a study, or the one that is named.

    Raises
    ------
    ConfigError
        It has errors: all of them, each with file, line, key and what to do.
    """
    tables, common = file.tables, ValidationErrors()
    flat = {key: value for key, value in tables.items() if key != SWEEP}
    parts = [FlatStudy(tables["name"], flat, lambda place: place)]
    head = None
    if PROBLEMS in tables:
        parts = list(flat_studies(tables, common))
        head_tables = {key: tables[key] for key in declared_fields(StudyHead) if key in tables}
        head = read_in(StudyHead, head_tables, file.folder, common)
    if SWEEP in tables:
        parts = list(with_variants(parts, tables[SWEEP], common))
    if problem is not None:
        known = [str(part.tables["name"]) for part in parts]
        if problem not in known:
            raise ConfigError(f'the study has no problem "{problem}"; {did_you_mean(problem, known)}')
        parts = [part for part in parts if part.tables["name"] == problem]
    # Where each error stands, and in which problems: one in what they share is reported once.
    faults: dict[Fault, list[str]] = {fault: [] for fault in file.faults}
    problems = dict[str, ResolvedStudy]()
    cache = StudyCache()
    try:
        for part in parts:
            errors = ValidationErrors()
            resolved = resolve(read_in(Study, part.tables, file.folder, errors), file.folder, errors, cache)
            for place, messages in errors.found.items():
                for message in messages:
                    within = faults.setdefault((*file.origin(part.origin(place)), message), [])
                    within += [str(part.tables["name"])] if part.problem not in within else []
            if resolved is not None:
                problems[resolved.study.name] = resolved
    finally:
        cache.forget()
    for place, messages in common.found.items():
        faults |= {(*file.origin(place), message): [] for message in messages}
    if faults:
        raise ConfigError(_in_order(faults, parts, file))
    first = next(iter(problems.values())).study
    if head is None and len(problems) > 1:  # a flat file with variants
        head = StudyHead(**{key: getattr(first, key) for key in declared_fields(StudyHead)})
    if type(count := tables.get("seeds")) is int and count > 1:
        several = f'for {count} seeds write "0:{count}"'
        warnings.warn(
            f"seeds = {count} is the one seed number {count}; {several}", CosimWarning, stacklevel=2
        )
    _warn_of_references(problems)
    _warn_of_missing_libraries(problems)
    limits = (problem.study.loop.memory_limit for problem in problems.values())
    if warning := limits_warning(limit for limit in limits if limit is not None):
        warnings.warn(warning, CosimWarning, stacklevel=2)
    return ResolvedProblems(head or first, problems, file)


def _warn_of_references(problems: Mapping[str, ResolvedStudy]) -> None:
    """Say which references go beyond the limits of their outputs, and for whom, where not for all."""
    controlled = {name: problem for name, problem in problems.items() if problem.outputs}
    for name, problem in controlled.items():
        loop = problem.study.loop
        samples = np.arange(loop.steps + 1, dtype=np.float64) * loop.sampling_time
        by_text: dict[str, list[tuple[str, str]]] = {}
        pairs = [
            (controller, scenario) for controller in problem.bounds for scenario in problem.scenario_bounds
        ]
        for controller, scenario in pairs:
            limits = problem.bounds[controller] | problem.scenario_bounds[scenario]
            time = loop.of(problem.study.scenarios[scenario]).start_time + samples
            y_min, y_max = _tables(problem, limits, time)
            table = _wanted(problem, y_min, y_max, time)
            for text in references_beyond_limits(problem.outputs, table, y_min, y_max):
                by_text.setdefault(text, []).append((controller, scenario))
        for text, held in by_text.items():
            where = [f"problem {name}"] if len(problems) > 1 else []
            if len(held) < len(pairs):
                where += [", ".join(dict.fromkeys(word for pair in held for word in pair))]
            whose = f" ({': '.join(where)})" if where else ""
            warnings.warn(f"{text}{whose}; {CANNOT_FOLLOW}", CosimWarning, stacklevel=3)


def _tables(problem: ResolvedStudy, limits: Limits, time: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the lower and upper limits of the outputs at each time, shapes (len(time), p)."""
    low, high = (
        np.column_stack(
            [
                limit.at(time) if isinstance(limit, Reference) else np.full(len(time), limit)
                for limit in (limits[v.name][side] for v in problem.outputs)
            ]
        )
        for side in (0, 1)
    )
    return low, high


def _wanted(problem: ResolvedStudy, y_min: FloatArray, y_max: FloatArray, time: FloatArray) -> FloatArray:
    """Return what is wanted of the outputs, of bands the points nearest to what the limits allow."""
    columns = list[FloatArray]()
    for i, variable in enumerate(problem.outputs):
        wanted, what = problem.reference[variable.name], f"reference of {variable.name}"
        if isinstance(wanted, Band):
            lower, upper = (values_at(edge, what, time) for edge in wanted.edges(variable))
            columns.append(np.clip(np.clip(lower, y_min[:, i], y_max[:, i]), lower, upper))
        else:
            columns.append(values_at(wanted, what, time))
    return np.column_stack(columns)


def _warn_of_missing_libraries(problems: Mapping[str, ResolvedStudy]) -> None:
    """Say what is not installed, and of which controllers no case can be run without."""
    needed: dict[str, dict[str, None]] = {}
    for problem in problems.values():
        for controller, what in problem.lacking.items():
            needed.setdefault(what, {})[controller] = None
    for what, controllers in needed.items():
        noun = "controller" if len(controllers) == 1 else "controllers"
        whose = f"all cases of the {noun} {', '.join(controllers)} will fail, the others are run"
        warnings.warn(f"{what}; without, {whose}", CosimWarning, stacklevel=3)


def _in_order(faults: Mapping[Fault, list[str]], parts: Sequence[FlatStudy], file: StudyFile) -> list[str]:
    """Return the errors in the order of their lines, those of the file itself first.

    An error in what several problems share names those that have it, unless it is in all that share it.
    """
    located = []
    for (of, place, message), within in faults.items():
        shared = {
            part.problem for part in parts if place[0] != "controllers" or has_key(part.tables, place[:2])
        }
        is_of_some = place[0] not in (PROBLEMS, SWEEP) and PROBLEMS not in place[2:3]
        named = ", ".join(within[:_MOST_LISTED]) + (", ..." if within[_MOST_LISTED:] else "")
        which = f" (problem {named})" if within and is_of_some and not shared <= set(within) else ""
        located.append(((of is not file, of.label, of.line(place)), of.message(place, message + which)))
    return [text for _, text in sorted(located, key=itemgetter(0))]
