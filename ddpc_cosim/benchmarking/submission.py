"""A submission: a controller, tuned and run on problems of a study as that asks, in one folder.

``entry.toml``       what is entered: the study, its problems, and the controller as a study file says it
``mine.py``          the plug-in, where it is a file of its own
``trials.csv``       what its settings were chosen from
``results/``         what ``run`` writes
``submission.json``  the checksums of all of these
"""

import csv
import io
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple, Self

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.texts import toml_tables
from ddpc_cosim.plugins import find_modules_in
from ddpc_cosim.study.case_files import DAMAGED, checksum, read_sealed, sealed_json
from ddpc_cosim.study.file_format.replacing import CONTROLLERS, PROBLEMS, Table, extended
from ddpc_cosim.study.file_format.sections import BandSection, Study, expand_seeds
from ddpc_cosim.study.file_format.study_files import StudyFile, absolute_paths
from ddpc_cosim.study.problems import WholeStudy
from ddpc_cosim.study.reading import read_file, resolve_file
from ddpc_cosim.study.resolve import ResolvedProblems
from ddpc_cosim.study.results import TRIALS_FILE, StudyResults
from ddpc_cosim.study.runner import Selection, run_study
from ddpc_cosim.tuning import TUNED_FILE, Request, TuningProgress, tune_study
from ddpc_cosim.tuning.objectives import Objective
from ddpc_cosim.tuning.search import search_spaces
from fmu_plants.files import write_atomically
from fmu_plants.spelling import did_you_mean

ENTRY_FILE, SUBMISSION_FILE, RESULTS_FOLDER = "entry.toml", "submission.json", "results"
_FORMAT = 1
_ERRORS, _MONEY = ("mean_abs_error:mean",), ("money:mean", "band_violation:mean")
"""What settings are searched by, and, where there is a price and a band, what is paid within the band."""
# What a method may choose for itself. Limits, seeds and forecasts of its own would be other terms.
_OF_METHOD = ("type", "label", "note", "settings", "search", "first_trials", "tuned", PROBLEMS)


@dataclass(frozen=True)
class Entry:
    """What is entered.

    Parameters
    ----------
    study : str
        The benchmark, as it was asked for.
    problems : tuple of str
        The problems of it; empty: it has one.
    name : str
        The controller's name among others.
    controller : dict
        Its section, as a study file says it.
    """

    study: str
    problems: tuple[str, ...]
    name: str
    controller: Table

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Return what a submission enters.

        Raises
        ------
        ConfigError
            It cannot be read, or says of a controller what no method decides for itself.
        """
        path = folder / ENTRY_FILE
        try:
            tables = toml_tables(path.read_text(encoding="utf-8"))
            entry = cls(tables["study"], tuple(tables[PROBLEMS]), tables["name"], tables["controller"])
            said = dict(_sections(entry.controller))
        except DAMAGED as error:
            raise ConfigError(f"{path}: not what `ddpc-cosim benchmark enter` writes: {error}") from error
        faults = [
            f"{path}: controller.{place}{key}: not a method's to choose; allowed: {', '.join(_OF_METHOD)}"
            for place, section in said.items()
            for key in section
            if key not in _OF_METHOD
        ]
        if faults:
            raise ConfigError(faults)
        return entry

    def written(self) -> bytes:
        """Return the content of its file."""
        import tomli_w

        tables = {"study": self.study, PROBLEMS: [*self.problems], "name": self.name}
        return tomli_w.dumps(tables | {"controller": self.controller}).encode()

    def resolved(self, base: StudyFile, folder: Path) -> ResolvedProblems:
        """Return the study that is run: the benchmark's problems, its reference points, and this controller.

        Parameters
        ----------
        base : StudyFile
            The benchmark.
        folder : Path
            The submission, in which the plug-in may be.

        Raises
        ------
        ConfigError
            The benchmark has no such problem, or the controller does not fit it.
        """
        find_modules_in(folder)
        tables = absolute_paths(base.tables, base.folder)
        beside = reference_points(tables)
        if self.name in beside:
            raise ConfigError(f'"{self.name}" is a reference point of {base.label}, which does not compete')
        changes: Table = {
            "name": f"{tables['name']}-{self.name}",
            "title": f"{tables.get('title') or tables['name']}: {self.controller.get('label') or self.name}",
            CONTROLLERS: {name: False for name in tables[CONTROLLERS] if name not in beside},
        }
        if PROBLEMS in tables:
            changes[PROBLEMS] = {name: False for name in tables[PROBLEMS] if name not in self.problems}
        if unknown := [name for name in self.problems if name not in tables.get(PROBLEMS, {})]:
            known = ", ".join(tables.get(PROBLEMS, {})) or "one"
            raise ConfigError(
                f"{base.label}: no problem {', '.join(unknown)}; it has {known}; --study: another one"
            )
        left, faults = extended(tables, changes, base.label)
        left[CONTROLLERS] = left[CONTROLLERS] | {self.name: self.controller}
        left["based_on"] = [str(tables["name"]), *tables.get("based_on", ())]
        file = StudyFile(base.label, folder, left, source=base.source)
        file.faults += [(file, place, fault) for place, fault in faults]
        return resolve_file(file)


def _sections(controller: Table) -> Iterator[tuple[str, Table]]:
    yield "", controller
    for name, changes in controller.get(PROBLEMS, {}).items():
        yield f"{PROBLEMS}.{name}.", changes


def reference_points(tables: Table) -> list[str]:
    """Return the controllers of a study that do not compete."""
    points = tables.get("report", {}).get("reference_points") or {}
    return [points[end] for end in ("zero", "full") if end in points]


class Budget(NamedTuple):
    """What settings are searched with.

    Parameters
    ----------
    trials : int or None
        How many settings are tried; None: as many as for the method of the benchmark with the most.
    seeds : list of int
        Seeds of the trials; empty: that method's.
    """

    trials: int | None = None
    seeds: list[int] = []  # noqa: RUF012 - read alone

    def completed(self, tables: Table) -> Self:
        """Return it with what it leaves to the benchmark.

        Raises
        ------
        ConfigError
            That does not say it.
        """
        tuned = [section.get("tuned") for section in tables[CONTROLLERS].values()]
        known = [how for how in tuned if isinstance(how, dict) and {"trials", "seeds"} <= how.keys()]
        most: Table = max(known, key=lambda how: int(how["trials"]), default={})
        trials = self.trials or most.get("trials")
        if trials is None:
            raise ConfigError(f"{tables['name']}: no method says how it was tuned; say how many --trials")
        return self._replace(trials=trials, seeds=self.seeds or expand_seeds(most.get("seeds", [])))


def enter(
    target: str,
    study: str,
    problems: Sequence[str],
    folder: Path | None,
    budget: Budget,
    selection: Selection,
    progress: TuningProgress,
    command: str,
) -> StudyResults:
    """Tune a controller as a benchmark's own were, run it on their terms, and write its submission.

    What is there of an earlier call is not done again.

    Parameters
    ----------
    target : str
        ``FILE.py:CLASS``, the name of an installed plug-in, or that of a method in the benchmark, whose
        settings are taken from there.
    study : str
        The benchmark.
    problems : sequence of str
        Patterns of its problems; empty: all.
    folder : Path or None
        Of the submission, beside which the tuning stands; None: one of its name in ``runs``.
    budget : Budget
        What it is tuned with.
    selection : Selection
        How cases are run.
    progress : TuningProgress
        Follows them.
    command : str
        How this can be repeated.

    Raises
    ------
    CosimError
        There is no such controller or problem, or the folder is another submission's.
    """
    base = read_file(study)
    listed = tuple(base.tables.get(PROBLEMS, {}))
    if unknown := [pattern for pattern in problems if not any(fnmatch(name, pattern) for name in listed)]:
        known = "it has one alone" if not listed else did_you_mean(unknown[0], listed)
        raise ConfigError(
            [f"--problem {pattern}: {base.label} has no such one; {known}" for pattern in unknown]
        )
    chosen = tuple(
        name for name in listed if not problems or any(fnmatch(name, pattern) for pattern in problems)
    )
    name, section = _section_of(target, base.tables, chosen)
    folder = folder or Path("runs") / f"{base.tables['name']}-{name}"
    there = Entry.read(folder) if (folder / ENTRY_FILE).exists() else None
    if there and (Path(there.study).name, there.problems, there.name) != (Path(study).name, chosen, name):
        what = f"{there.name} on {', '.join(there.problems) or there.study}"
        raise ConfigError(f"{folder} is another submission, of {what}; choose another folder by --out")
    is_new = not folder.exists()
    _begin(target, folder)
    entry = Entry(study, chosen, name, section)
    try:
        resolved = entry.resolved(base, folder)
    except ConfigError:
        if is_new:
            shutil.rmtree(folder)
        raise
    if name not in base.tables[CONTROLLERS] and _has_search(resolved, name):
        trials, seeds = budget.completed(base.tables)
        request = Request(trials=trials or 0, seeds=seeds, command=command, compares=False)
        groups = _by_objectives(resolved)
        entry, tried = _tuned(entry, groups, base, folder, request, selection, progress)
        resolved = entry.resolved(base, folder)
        write_atomically(folder / TRIALS_FILE, tried)
    write_atomically(folder / ENTRY_FILE, entry.written())
    results = run_study(resolved, folder / RESULTS_FOLDER, selection, progress)
    seal(folder)
    return results


def _tuned(
    entry: Entry,
    groups: Mapping[tuple[str, ...], list[str]],
    base: StudyFile,
    folder: Path,
    request: Request,
    selection: Selection,
    progress: TuningProgress,
) -> tuple[Entry, bytes]:
    """Return what is entered with the settings found, and what was tried.

    Problems that are judged by the same figures are tuned together, in a folder beside the submission.
    """
    controller, tried = entry.controller, list[dict[str, str]]()
    for objectives, names in groups.items():
        part = replace(entry, problems=tuple(names)) if entry.problems else entry
        suffix = "-tuning" if objectives == _ERRORS else "-tuning-by-money"
        beside = folder.with_name(folder.name + suffix)
        asked = replace(request, objectives=tuple(map(Objective.parse, objectives)))
        tune_study(
            part.resolved(base, folder), beside, asked, replace(selection, only=(entry.name,)), progress
        )
        with (beside / TRIALS_FILE).open(encoding="utf-8", newline="") as file:
            tried += csv.DictReader(file)
        section = _tuned_section(beside / TUNED_FILE, entry.name)
        if len(groups) == 1:
            controller = section
        else:
            of_problems = section.pop(PROBLEMS, {})
            of_each = {name: {"settings": {}} | section | of_problems.get(name, {}) for name in names}
            controller = controller | {PROBLEMS: controller.get(PROBLEMS, {}) | of_each}
    text = io.StringIO()
    rows = csv.DictWriter(text, list(dict.fromkeys(key for row in tried for key in row)))
    rows.writeheader()
    rows.writerows(tried)
    return replace(entry, controller=controller), text.getvalue().encode()


def _by_objectives(resolved: ResolvedProblems) -> dict[tuple[str, ...], list[str]]:
    """Return the names of problems by what their settings are searched by."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for name, problem in resolved.problems.items():
        groups.setdefault(_objectives(problem.study), []).append(name)
    return groups


def _objectives(study: Study) -> tuple[str, ...]:
    bands = any(isinstance(wanted, BandSection) for wanted in (study.reference or {}).values())
    return _MONEY if study.prices and bands else _ERRORS


def _section_of(target: str, tables: Table, problems: Sequence[str]) -> tuple[str, Table]:
    """Return name and section of what is entered: a method of the study keeps the settings that it has."""
    if target in tables[CONTROLLERS]:
        section = tables[CONTROLLERS][target]
        if PROBLEMS in section:
            of_problems = {key: value for key, value in section[PROBLEMS].items() if key in problems}
            section = section | {PROBLEMS: of_problems}
        return target, section
    path, _, attribute = target.rpartition(":")
    if not path.endswith(".py"):
        return _name(attribute), {"type": target}
    module = Path(path).stem
    if not (module.isidentifier() and attribute.isidentifier()):
        raise ConfigError(f'"{target}" is not possible; needed: FILE.py:CLASS, both of them Python names')
    return _name(attribute), {"type": f"{module}:{attribute}", "label": attribute}


def _begin(target: str, folder: Path) -> None:
    """Make a submission's folder, and have the file of a plug-in that is not installed stand in it."""
    source = Path(target.rpartition(":")[0])
    try:
        content = source.read_bytes() if source.suffix == ".py" else None
        folder.mkdir(parents=True, exist_ok=True)
        if content is not None:
            write_atomically(folder / source.name, content)
    except OSError as error:
        raise ConfigError(f"{error.filename or source}: {error.strerror}") from error


def _name(attribute: str) -> str:
    """Return a class's name as studies write names: ``my-controller``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", attribute).replace("_", "-").lower()


def _has_search(resolved: ResolvedProblems, name: str) -> bool:
    sections = (problem.study.controllers[name] for problem in resolved.problems.values())
    return any(dict(search_spaces(section, by_prediction=False)) for section in sections)


def _tuned_section(path: Path, name: str) -> Table:
    """Return a controller's section from the study that a tuning has written, without what is empty."""
    tables = WholeStudy.of_tables(toml_tables(path.read_text(encoding="utf-8"))).tables()
    section = _without_defaults(tables[CONTROLLERS][name])
    if PROBLEMS in section:
        section[PROBLEMS] = {key: _without_defaults(value) for key, value in section[PROBLEMS].items()}
    return section


def _without_defaults(section: Table) -> Table:
    return {key: value for key, value in section.items() if value not in ("", {}, [], "all")}


def files_of(folder: Path) -> list[str]:
    """Return the files of a submission, but for what seals it and what is made from the others."""
    left_out = (SUBMISSION_FILE, f"{RESULTS_FOLDER}/report.html")
    paths = (path.relative_to(folder) for path in sorted(folder.rglob("*")) if path.is_file())
    names = (path.as_posix() for path in paths if "__pycache__" not in path.parts)
    return [name for name in names if name not in left_out]


def seal(folder: Path) -> None:
    """Write the checksums of a submission's files."""
    hashes = {name: checksum((folder / name).read_bytes()) for name in files_of(folder)}
    write_atomically(folder / SUBMISSION_FILE, sealed_json({"format": _FORMAT, "files": hashes}))


def sealed_files(folder: Path) -> dict[str, str]:
    """Return the checksums that a submission says of its files.

    Raises
    ------
    ConfigError
        It is none, or one of another format.
    """
    path = folder / SUBMISSION_FILE
    if not path.is_file():
        raise ConfigError(
            f"{folder}: no submission: {SUBMISSION_FILE} is missing; `benchmark enter` writes it"
        )
    try:
        said = read_sealed(path)
        if said["format"] != _FORMAT:
            raise ValueError(f"format {said['format']}; known here: {_FORMAT}")
        return {str(name): str(digest) for name, digest in said["files"].items()}
    except DAMAGED as error:
        raise ConfigError(f"{path}: damaged: {error}") from error
