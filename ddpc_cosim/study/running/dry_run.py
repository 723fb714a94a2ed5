"""What a run would take, told before it is begun: cases, time by what has been run or tried, bytes."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path
from statistics import fmean
from time import monotonic
from typing import TYPE_CHECKING

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.durations import about
from ddpc_cosim.processes.scratch import ScratchFolder
from ddpc_cosim.study.case_files import DAMAGED, DOING_NOTHING, RUN_FILE, CaseResult, read_run
from ddpc_cosim.study.results import CASES_FOLDER

if TYPE_CHECKING:
    from ddpc_cosim.study.cases import Case
    from ddpc_cosim.study.resolve import ResolvedProblems
    from ddpc_cosim.study.runner import Progress, Selection, Update

    Times = dict[tuple[str, str], list[float]]

# Of so many cases that have been run the times are read; reading a case takes a millisecond.
_MOST_READ = 300
# What has never been run is tried for so long at most; cases that take longer are extrapolated.
_TRIAL_SECONDS = 10.0
# Of a case's run.json; of a number of signals.csv; of a row's time, status and computation time.
_RUN_BYTES, _NUMBER_BYTES, _REST_OF_ROW = 3_500, 17, 30
# Of a column of signals.parquet; of a cell, which repeats in part what stands above it.
_COLUMN_BYTES, _CELL_BYTES = 200, 3


def expected(resolved: "ResolvedProblems", folder: Path, selection: "Selection", progress: "Progress") -> str:
    """Return how many cases a run would have, about how long they would take, and how many bytes they have.

    The time is that of cases of the same problem and controller that have been run into the folder, with
    whatever settings. Of each controller of a problem that has none there, a case is tried for some seconds,
    apart from the folder; where that does not come to its first samples, the time is that of the others of
    the problem. Nothing is tried where cases run on a cluster.

    Raises
    ------
    ConfigError
        No case is selected.
    """
    from ddpc_cosim.study.cases import doing_nothing
    from ddpc_cosim.study.runner import selected_cases

    chosen = selected_cases(resolved, selection, progress)[1]
    cases = selection.part_of([*chosen, *doing_nothing(chosen)])
    there = _names_in(folder / CASES_FOLDER)
    missing = [case for case in cases if selection.fresh or case.id not in there]
    kept = len(cases) - len(missing)
    resting = sum(case.controller == DOING_NOTHING for case in cases)
    lines = [
        f"{_counted(len(cases) - resting, 'case')} and {_counted(resting, 'run')} of doing nothing: "
        f"{len(missing)} to run, {kept} already there (a damaged one is run again)"
    ]
    if missing:
        base = {
            ("" if name == resolved.head.name else name, key): section.variant_of or key
            for name, problem in resolved.problems.items()
            for key, section in problem.study.controllers.items()
        }
        lines += [_time(missing, base, folder / CASES_FOLDER, there, selection, progress)]
        lines.append(_size(missing, selection.storage))
    return "\n".join(lines)


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun if number == 1 else f'{noun}s'}"


def _names_in(folder: Path) -> set[str]:
    try:
        return {path.name for path in folder.iterdir() if (path / RUN_FILE).is_file()}
    except OSError:
        return set()


def _time(
    missing: Sequence["Case"],
    base: dict[tuple[str, str], str],
    folder: Path,
    there: Iterable[str],
    selection: "Selection",
    progress: "Progress",
) -> str:
    """Say how long the cases that are missing would take."""
    times: Times = {}
    names = sorted(there)
    for name in islice(names, 0, None, 1 + len(names) // _MOST_READ):
        try:
            run = read_run(folder / name)
            problem, controller, seconds = run["problem"], run["controller"], float(run["wall_time"])
        except (ConfigError, *DAMAGED):
            continue
        if math.isfinite(seconds):
            times.setdefault((problem, base.get((problem, controller), controller)), []).append(seconds)
    kinds = [(case.problem, base.get((case.problem, case.controller), case.controller)) for case in missing]
    by = ["the cases already run"] * bool(times)
    untried = {kind: case for kind, case in zip(kinds, missing, strict=True) if kind not in times}
    if untried and selection.executor == "local":
        tried = _tried(untried, selection, progress)
        by += [f"a trial of {_counted(len(tried), 'case')}"] * bool(tried)
        times |= {kind: [seconds] for kind, seconds in tried.items()}
    of_problem: dict[str, list[float]] = {}
    for (problem, controller), of_kind in times.items():
        if controller != DOING_NOTHING:  # which takes less time than any other
            of_problem.setdefault(problem, []).extend(of_kind)
    total, unknown = 0.0, Counter[str]()
    for case, kind in zip(missing, kinds, strict=True):
        known = times.get(kind) or of_problem.get(case.problem)
        if known:
            total += fmean(known)
        else:
            unknown[case.problem] += 1
    if unknown.total() == len(missing):
        return "time: not known, as none of them has been run"
    which = f"; not known of {unknown.total()} cases, of which none like them has been run" if unknown else ""
    jobs = min(selection.jobs, len(missing))
    return f"time: about {about(total / jobs)} with {_counted(jobs, 'worker')}, by {' and '.join(by)}{which}"


class _TimeIsUpError(Exception):
    """Enough has been tried."""


class _Trial:
    """How long cases take, of which those that are not done are extrapolated from their samples."""

    def __init__(self, progress: "Progress") -> None:
        self.seconds: dict[str, float] = {}
        self._progress, self._began = progress, dict[str, float]()
        self._end = monotonic() + _TRIAL_SECONDS

    def prepare(self, what: str) -> None:
        """Show what is done before the cases, which is no part of the time."""
        self._progress.prepare(what)

    def start(self, total: int, kept: int) -> None:
        """Begin to count the time."""
        self._progress.prepare(f"trying {_counted(total + kept, 'case')}, to see how long a run takes")
        self._end = monotonic() + _TRIAL_SECONDS

    def update(self, update: "Update") -> None:
        """Take note of how far a case is.

        Raises
        ------
        _TimeIsUpError
            The time for trials is over.
        """
        now = monotonic()
        began = self._began.setdefault(update.case, now)
        if update.samples and now > began:
            self.seconds[update.case] = (now - began) * update.planned / update.samples
        if now > self._end:
            raise _TimeIsUpError

    def finished(self, case: "Case", result: CaseResult) -> None:
        """Take note of how long a case took."""
        self.seconds.pop(case.name, None)
        if math.isfinite(result.wall_time):
            self.seconds[case.name] = result.wall_time


def _tried(
    cases: dict[tuple[str, str], "Case"], selection: "Selection", progress: "Progress"
) -> dict[tuple[str, str], float]:
    """Run a case of each kind, apart from the results, and return how long each takes [s]."""
    from ddpc_cosim.study.runner import run_missing

    of_problem: dict[str, list[Case]] = {}
    for (problem, _), case in cases.items():
        of_problem.setdefault(problem, []).append(case)
    longest = max(map(len, of_problem.values()))
    # The first of each problem, then the second of each: whatever there is time for tells of all problems.
    order = [of[i] for i in range(longest) for of in of_problem.values() if i < len(of)]
    trial = _Trial(progress)
    alone = replace(selection, shard="1/1", storage="csv", keep_files=False)
    with ScratchFolder(None, "ddpc-cosim-") as folder, suppress(_TimeIsUpError):
        run_missing(order, folder, alone, trial, begin=True)
    return {kind: trial.seconds[case.name] for kind, case in cases.items() if case.name in trial.seconds}


def _size(missing: Sequence["Case"], storage: str) -> str:
    """Say how many bytes the cases that are missing would have."""
    size = 0.0
    for case in missing:
        signals = 2 * len(case.outputs) + len(case.measurements) + len(case.inputs) + len(case.changed_inputs)
        rows = round(case.duration / case.sampling_time) + 1
        if storage == "parquet":
            size += _RUN_BYTES + (signals + 3) * (_COLUMN_BYTES + rows * _CELL_BYTES)
        else:
            size += _RUN_BYTES + rows * (_REST_OF_ROW + signals * _NUMBER_BYTES)
    factor, unit = next(
        ((f, unit) for f, unit in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")) if size >= f), (1.0, "bytes")
    )
    return f"size: about {size / factor:.3g} {unit}"
