"""Whether a submission is what its controller does on the benchmark: nothing in it is taken on trust.

The benchmark is that of whoever verifies; a submission says which of its problems it took. All of its figures
are computed again from its samples; all of its samples are compared with those of the benchmark's own plants
under the inputs that it recorded; and of a random part of its runs the controller is run again. What is not
verified are times of computation, which are a machine's, and, of runs that are not run again, that it was
this controller which chose their inputs.
"""

import math
import random
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ddpc_cosim.benchmarking.submission import RESULTS_FOLDER, SUBMISSION_FILE, Entry, files_of, sealed_files
from ddpc_cosim.controller import Controller, Loop, Sample
from ddpc_cosim.errors import ConfigError, CosimError
from ddpc_cosim.files.tables import own_rows, table_text
from ddpc_cosim.files.texts import toml_tables
from ddpc_cosim.loop.trace import Outcome
from ddpc_cosim.processes.scratch import ScratchFolder
from ddpc_cosim.settings import setting
from ddpc_cosim.study.agreement import difference_of, samples_of, worst_difference
from ddpc_cosim.study.case_files import DOING_NOTHING, CaseResult, checksum, evaluated, load_case, read_run
from ddpc_cosim.study.cases import Case, doing_nothing
from ddpc_cosim.study.problems import WholeStudy
from ddpc_cosim.study.reading import read_file
from ddpc_cosim.study.resolve import ResolvedProblems
from ddpc_cosim.study.results import METRICS_FILE, STUDY_FILE, StudyResults, load_results, metrics_table
from ddpc_cosim.study.runner import Progress, Selection, run_cases, selected_cases
from ddpc_cosim.study.verdicts.changes import settings_between
from ddpc_cosim.variables import FloatArray

ABSOLUTE, RELATIVE = 1e-9, 1e-6
"""What the same run may differ by on another machine."""
Key = tuple[str, str, str, int]
"""Problem, controller, scenario, seed."""


class RefusedError(CosimError):
    """Something that a submission says is not so: what it says, and what is so."""


@dataclass(frozen=True)
class Verified:
    """What was verified of a submission that is what it says.

    Parameters
    ----------
    files, cases, again : int
        Files whose checksums are right; cases whose samples and figures are; those that were run again.
    seed : int
        Of the choice of these.
    """

    files: int
    cases: int
    again: int
    seed: int


@dataclass(kw_only=True)
class Playback(Controller):
    """A recording of inputs in a controller's place."""

    inputs: list[list[float]] = setting(doc="of each sample, in the plant's units")

    accepts_missing = True

    def start(self, loop: Loop) -> None:
        """Begin with the first."""

    def step(self, sample: Sample) -> FloatArray:
        """Return the inputs that were recorded, shape (m,)."""
        return np.array(self.inputs[sample.k])


def verify(
    folder: Path, study: str, share: float, seed: int, selection: Selection, progress: Progress
) -> Verified:
    """Verify a submission.

    The plug-in in it is imported, and its controller run: who wrote it is trusted as whoever's code one runs.

    Parameters
    ----------
    folder : Path
        The submission.
    study : str
        The benchmark.
    share : float
        Of each controller's runs of a problem, what share is run again, at least one.
    seed : int
        Of the choice of these.
    selection : Selection
        How they are run.
    progress : Progress
        Follows them.

    Raises
    ------
    RefusedError
        The first thing that is not as the submission says.
    ConfigError
        It is no submission, or no such study.
    """
    progress.prepare("checksums")
    hashes = sealed_files(folder)
    _check_files(folder, hashes)
    entry = Entry.read(folder)
    resolved = entry.resolved(read_file(study), folder)
    results = _results(folder)
    _check_study(resolved, results)
    runs = list(_runs(resolved, results, selection, progress))
    for run in runs:
        _check_figures(run)
    _check_table(results)
    chosen = _chosen(runs, share, seed)
    progress.start(len(runs), 0)
    with ScratchFolder() as work:
        _check_runs([_played(run) for run in runs if run not in chosen], work / "played", selection, progress)
        _check_runs(chosen, work / "again", selection, progress)
    return Verified(len(hashes), len(runs), len(chosen), seed)


class _Run(NamedTuple):
    """A case as the benchmark asks for it, and as it is in the submission."""

    case: Case
    result: CaseResult

    @property
    def is_played(self) -> bool:
        return bool(self.case.section["type"] == _PLAYBACK)

    @property
    def not_compared(self) -> Collection[str]:
        """What ``run.json`` says that need not be the same."""
        return _OF_A_RUN | _OF_SAMPLES | (_OF_A_CONTROLLER if self.is_played else set())


# What is of the machine and the day, what is compared with tolerances or computed from samples elsewhere, and
# what a recording of inputs does not say.
_OF_A_RUN = {
    "id",
    "wall_time",
    "provenance",
    "versions",
    "printed",
    "left",
    "sandbox",
    "storage",
    "transient",
}
_OF_SAMPLES = {
    "signals",
    "metrics",
    "tracking",
    "metric_warnings",
    "diagnostics",
    "warnings",
    "state",
    "engine",
}
_OF_A_CONTROLLER = {"settings", "info", "knowledge", "recorded_samples", "outcome", "reason", "beyond_log"}
_PLAYBACK = f"{__name__}:{Playback.__name__}"


def _check_files(folder: Path, hashes: dict[str, str]) -> None:
    there = files_of(folder)
    for name in hashes:
        if name not in there:
            raise RefusedError(f"{folder / name}: missing; {SUBMISSION_FILE} names it")
        if (digest := checksum((folder / name).read_bytes())) != hashes[name]:
            raise RefusedError(
                f"{folder / name}: its checksum is {digest}, in {SUBMISSION_FILE} {hashes[name]}"
            )
    if others := [name for name in there if name not in hashes]:
        raise RefusedError(f"{folder / others[0]}: {SUBMISSION_FILE} does not name it")


def _results(folder: Path) -> StudyResults:
    try:
        results = load_results(folder / RESULTS_FOLDER)
    except ConfigError as error:
        raise RefusedError(str(error)) from error
    for why in results.damaged.values():
        raise RefusedError(why)
    return results


def _check_study(resolved: ResolvedProblems, results: StudyResults) -> None:
    """Refuse results of another study: other plants, seeds, scenarios, limits, settings, ..."""
    asked = WholeStudy.of_tables(toml_tables(resolved.whole.toml().decode()))
    for path, (theirs, ours) in settings_between(results.whole, asked).items():
        said, wanted = ("not said" if text is None else text for text in (theirs, ours))
        raise RefusedError(
            f"{results.folder / STUDY_FILE}: {path} is {said}; the benchmark asks for {wanted}"
        )


def _runs(
    resolved: ResolvedProblems, results: StudyResults, selection: Selection, progress: Progress
) -> Iterator[_Run]:
    """Yield every case that the benchmark asks for with the submission's; refuse others, and what lacks."""
    _, asked = selected_cases(resolved, selection, progress)
    problems = {name: "" if results.whole.is_flat else name for name in results.whole.problems}
    there: dict[Key, CaseResult] = {}
    for result in (*results.cases, *results.resting):
        key = (problems[result.problem], result.controller, result.scenario, result.seed)
        if key in there:
            raise RefusedError(f"{result.folder}: of the same run as {there[key].folder}")
        there[key] = result
    for case in (*asked, *doing_nothing(asked)):
        result_of_case = there.pop((case.problem, case.controller, case.scenario, case.seed), None)
        if result_of_case is None:
            raise RefusedError(f"{results.folder}: no run {case.name}")
        yield _Run(case, result_of_case)
    for result in there.values():
        raise RefusedError(f"{result.folder}: the benchmark asks for no such run")


def _check_figures(run: _Run) -> None:
    """Refuse what is not so of a run's samples, computed again, or of what it was."""
    case, result = run
    said, where = read_run(result.folder), f"{result.folder.name}: "
    trace = result.trace()
    wanted = {key: value for key, value in case.head().items() if key not in ("id", "sandbox", "storage")}
    recomputed = evaluated(trace, case.metrics)
    # What is written as text in JSON is compared as it is written.
    for key, value in (wanted | {"rows": len(trace)}).items():
        theirs = said["signals"]["rows"] if key == "rows" else said.get(key, {} if key == "drawn" else None)
        if difference := _different(key, theirs, value):
            raise RefusedError(where + difference)
    for key, value in recomputed.items():
        if difference := _different(key, said[key], value):
            raise RefusedError(f"{where}{difference}, computed from its samples")


def _different(name: str, said: Any, value: Any) -> str:
    """Return in words where a value of a file is another than it has to be; empty: nowhere."""
    theirs, ours = (dict(_leaves(item, name)) for item in (said, value))
    if other := sorted(theirs.keys() ^ ours.keys()):
        return f"{other[0]} is {theirs.get(other[0], 'not there')}; it is {ours.get(other[0], 'not there')}"
    for path, leaf in ours.items():
        if isinstance(leaf, float) and isinstance(theirs[path], float):
            pair = [{path: np.array([number])} for number in (theirs[path], leaf)]
            if worst_difference(pair, ABSOLUTE, RELATIVE):
                return f"{path} is {theirs[path]!r}; it is {leaf!r}"
        elif leaf != theirs[path]:
            return f"{path} is {theirs[path]!r}; it is {leaf!r}"
    return ""


def _leaves(value: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield numbers, as far as texts are some, and texts by their place."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _leaves(item, f"{path}.{key}" if path else key)
    elif isinstance(value, list | tuple):
        for i, item in enumerate(value):
            yield from _leaves(item, f"{path}[{i}]")
    else:
        try:
            yield path, float(value)
        except (TypeError, ValueError):
            yield path, str(value)


def _check_table(results: StudyResults) -> None:
    """Refuse a table of metrics that says something else than the cases."""
    path = results.folder / METRICS_FILE
    try:
        header, rows = own_rows(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise RefusedError(f"{path}: {error}") from error
    columns, cells = own_rows(table_text(*metrics_table(results)))
    if header != columns or len(rows) != len(cells):
        raise RefusedError(f"{path}: {len(rows)} rows; the cases have {len(cells)}, or other columns")
    for row, of_case in zip(rows, cells, strict=True):
        for name, theirs, ours in zip(columns, row, of_case, strict=True):
            if theirs != ours:
                which = ", ".join(of_case[columns.index(key)] for key in ("controller", "scenario", "seed"))
                raise RefusedError(f"{path}: {name} of {which} is {theirs}; its case says {ours}")


def _chosen(runs: Sequence[_Run], share: float, seed: int) -> list[_Run]:
    """Return the runs that are run again: of each controller a random part, and those that ended early.

    What a plant does under recorded inputs does not tell whether a controller has failed to give the next.
    """
    groups: dict[tuple[str, str], list[_Run]] = {}
    for run in runs:
        groups.setdefault((run.case.problem, run.case.controller), []).append(run)
    choice = random.Random(seed)
    chosen = list[_Run]()
    for (_, controller), members in groups.items():
        count = len(members) if controller == DOING_NOTHING else max(math.ceil(share * len(members)), 1)
        drawn = choice.sample(range(len(members)), count)
        ended_early = (i for i, run in enumerate(members) if run.result.outcome is not Outcome.COMPLETED)
        chosen += [members[i] for i in sorted({*drawn, *ended_early})]
    return chosen


def _played(run: _Run) -> _Run:
    """Return a run with the inputs that it recorded in the controller's place."""
    # The experiment stays: it draws noise too.
    inputs = run.result.trace().u.tolist()
    section = {"type": _PLAYBACK, "settings": {"inputs": inputs}}
    return run._replace(case=replace(run.case, section=section))


def _check_runs(runs: Sequence[_Run], folder: Path, selection: Selection, progress: Progress) -> None:
    """Run cases, and refuse the first whose samples are not those of the submission."""
    folder.mkdir()
    of_case = {run.case.id: run for run in runs}
    cases = run_cases(
        [run.case for run in runs], folder, selection.jobs, progress.update, sandboxed=selection.sandboxed
    )
    for case in cases:
        done = load_case(folder / case.id)
        progress.finished(case, done)
        run = of_case[case.id]
        difference = (
            _difference_while_played(run.result, done)
            if run.is_played
            else difference_of(run.result, done, ABSOLUTE, RELATIVE)
        )
        said, so = (
            {key: value for key, value in read_run(result.folder).items() if key not in run.not_compared}
            for result in (run.result, done)
        )
        difference = difference or _different("", said, so)
        if difference:
            how = "under the inputs recorded" if run.is_played else "run again"
            raise RefusedError(f"{run.result.folder.name}: {difference}, {how}")


def _difference_while_played(said: CaseResult, played: CaseResult) -> str:
    """Return in words where a run's samples are others than those of the plant under its inputs."""
    theirs, ours = said.trace(), played.trace()
    if len(ours) != len(theirs) or played.outcome is not Outcome.COMPLETED:
        ended = f"{played.outcome} after {len(ours)} samples: {played.reason}"
        return f"{said.outcome} after {len(theirs)} samples, other {ended}"
    tables = [samples_of(trace, infos=False) for trace in (theirs, ours)]
    return worst_difference(tables, ABSOLUTE, RELATIVE, theirs.time)
