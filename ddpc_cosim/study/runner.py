"""Running a study: prepare the plant, run what is not there yet, write what is known of all cases.

Each case runs in a worker of its own: a crash or a hang costs that case and nothing else, and what a plug-in
leaves behind in its process (floating-point errors, random numbers, modules) changes no other case. Where
starting a worker takes longer than most cases, as it is started anew and not forked, or their loops are
compiled, the next case may have it too, if nothing of the one before can be left in it.
"""

import gc
import math
import os
import pickle
import re
import sys
import tempfile
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import islice
from multiprocessing.connection import wait
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol, Self, get_args

from ddpc_cosim.errors import ConfigError, CosimError, MissingLibraryError
from ddpc_cosim.files.csv_files import load_pyarrow
from ddpc_cosim.files.path_lengths import ALLOW_MORE, are_limited, longest_excess
from ddpc_cosim.loop.master import OUTCOME_OF
from ddpc_cosim.loop.safe_calls import announce_calls
from ddpc_cosim.loop.setup import EngineName
from ddpc_cosim.loop.trace import Outcome, Trace
from ddpc_cosim.plugins import (
    FOLDER_VARIABLE,
    find_modules_in,
    is_own,
    keep_values,
    load_plugin,
    study_folder,
    types_in,
)
from ddpc_cosim.processes import spawning
from ddpc_cosim.processes.fork_server import ForkServer
from ddpc_cosim.processes.limits import default_memory
from ddpc_cosim.processes.rows import Call, RowStore
from ddpc_cosim.processes.sandbox import Sandbox, demanded, require as require_sandbox
from ddpc_cosim.processes.scratch import ScratchFolder, remove, remove_left_behind
from ddpc_cosim.processes.worker import (
    LONGEST_REPLY,
    LostWorkerError,
    UnexpectedError,
    Worker,
    ask,
    keep_temporary_files_in,
    lost,
    result_of,
    serve_calls,
)
from ddpc_cosim.study.batches import Batched, stage_batch
from ddpc_cosim.study.case_files import (
    STAGING,
    CaseResult,
    accept_case,
    described,
    keep_left,
    left_in,
    load_case,
    longest_files,
    recompute_metrics,
    stage_case,
    write_case,
)
from ddpc_cosim.study.case_runs import no_samples, partial_trace, row_store, run_alike, run_case
from ddpc_cosim.study.cases import (
    Case,
    CaseContext,
    Cases,
    CaseSeries,
    cases_of_problems,
    doing_nothing,
    files_read,
    leaves_nothing_behind,
    patterns_of,
    problems_with_cases,
)
from ddpc_cosim.study.plants import PlantSpec
from ddpc_cosim.study.results import (
    CASES_FOLDER,
    CASES_RUN,
    Loaded,
    StudyResults,
    claim_folder,
    keep_logo,
    load_cases,
    provenance_of,
    write_results,
)
from ddpc_cosim.study.running.provenance import facts_of_problem, facts_of_run, seed_ranges, versions

if TYPE_CHECKING:
    from ddpc_cosim.study.problems import WholeStudy
    from ddpc_cosim.study.resolve import ResolvedProblems, ResolvedStudy

_POLL_SECONDS = 0.1
_REPLY_SECONDS = 5.0
# Opening a plant, computing metrics and writing take no longer. Without a limit, a process that a dead worker
# has forked could hold its channel open for ever.
_BETWEEN_CALLS_SECONDS = 600.0
_LONGEST_ANSWER_SECONDS = 3600.0
# Where a controller has more seeds in a scenario, files of single cases take longer than the cases do.
_MANY_SEEDS, _FIRST_SEEDS, _BATCH = 500, 20, 200
_DESCRIBED_AT_ONCE = 10
# A column's name and unit; a row's status and info; a number.
_HEADER_BYTES, _ROW_BYTES, _NUMBER_BYTES = 100_000, 10_000, 32
_AT_THE_END = ("diagnostics", "provenance", "close")
# What most controllers compute with is not loaded by reading a study.
_PRELOAD = (
    __name__,
    "ddpc_cosim.fmu.plant",
    "ddpc_cosim.plugins:look_up",
    "ddpc_cosim.study.running.provenance:versions",
    "scipy.linalg",
    "scipy.special",
    "encodings.cp437",  # of zip files
)


class Update(NamedTuple):
    """How far a running case is, and its rows, which outlive it."""

    case: str
    samples: int
    planned: int
    rows: RowStore


Watcher = Callable[[Update], None]


class Progress(Protocol):
    """What follows a run of cases."""

    def prepare(self, what: str) -> None:
        """Take note of what is done before the cases are known, and may take a while."""

    def start(self, total: int, kept: int) -> None:
        """``total`` cases are to be run; ``kept`` more are there from before."""

    def update(self, update: Update) -> None:
        """Take note of a running case."""

    def finished(self, case: Case, result: CaseResult) -> None:
        """Take note of a case that is done."""


@dataclass(frozen=True, slots=True)
class Selection:
    """Which cases to run, and how.

    Parameters
    ----------
    jobs : int
        Number of worker processes.
    seeds : list of int
        In place of the study's; empty: the study's.
    only : str or sequence of str
        Glob patterns of names or labels, of which a case must match one; empty: all cases.
    fresh : bool
        Run cases again that already exist.
    sandboxed : bool
        Run each case in a sandbox; those that already exist are kept, and say whether they were.
    executor : {"local", "dask"}
        Where cases run: in workers on this machine, or on those of a dask scheduler.
    scheduler : str
        The address of the dask scheduler.
    shard : str
        ``I/N``: of the selected cases every N-th only, from the I-th on; a later run without it, over the
        same folder, puts the parts together.
    storage : {"csv", "parquet"}
        The file of the samples of each case that is run; those that already exist are kept as they are.
    keep_files : bool
        Keep what each case that is run leaves in its working directory, in ``left`` of its folder; on this
        machine only.
    engine : {"", "python", "compiled"}
        What computes the samples of cases that are run, which is no part of what they are; empty: what each
        problem says.

    Raises
    ------
    ConfigError
        An executor or a storage without what it needs, or a shard that there is not.
    """

    jobs: int = 1
    seeds: list[int] = field(default_factory=list)
    only: str | Sequence[str] = ()
    fresh: bool = False
    sandboxed: bool = False
    executor: str = "local"
    scheduler: str = ""
    shard: str = "1/1"
    storage: str = "csv"
    keep_files: bool = False
    engine: EngineName | Literal[""] = ""

    def __post_init__(self) -> None:
        faults = []
        if self.executor not in ("local", "dask"):
            faults.append(f"--executor {self.executor}: must be local or dask")
        if self.executor == "dask" and "://" not in self.scheduler:
            given = f"--scheduler {self.scheduler}: is not an address" if self.scheduler else "no --scheduler"
            faults.append(f"--executor dask: {given}; give one such as --scheduler tcp://host:8786")
        if self.executor == "local" and self.scheduler:
            faults.append(f"--scheduler {self.scheduler}: needs --executor dask")
        shard = re.fullmatch(r"(\d+)/(\d+)", self.shard, re.ASCII)
        if shard is None or not 1 <= int(shard[1]) <= int(shard[2]):
            faults.append(f"--shard {self.shard}: must be I/N, I from 1 to N, such as 1/2 and 2/2")
        if self.keep_files and self.executor != "local":
            faults.append(f"--keep-files: not with --executor {self.executor}: what cases leave stays there")
        if self.engine not in ("", *get_args(EngineName)):
            faults.append(f"--engine {self.engine}: must be {' or '.join(get_args(EngineName))}")
        if self.storage not in ("csv", "parquet"):
            faults.append(f"--storage {self.storage}: must be csv or parquet")
        if self.storage == "parquet":
            try:
                load_pyarrow()
            except ConfigError as error:
                faults.append(f"--storage parquet: {error}")
        if faults:
            raise ConfigError(faults)

    @property
    def is_part(self) -> bool:
        """Whether a shard is not the whole."""
        return int(self.shard.split("/")[1]) > 1

    def options(self) -> list[str]:
        """Return the options of ``run`` that decide which cases there are, and whether they are sandboxed."""
        seeds = ["--seeds", seed_ranges(self.seeds)] if self.seeds else []
        only = [word for pattern in patterns_of(self.only) for word in ("--only", pattern)]
        return [*seeds, *only, *(["--sandbox"] if self.sandboxed else [])]

    def part_of(self, cases: Sequence[Case]) -> Sequence[Case]:
        """Return the cases of the shard: neighbours, which take about as long, are in different ones."""
        first, count = map(int, self.shard.split("/"))
        return cases[first - 1 :: count]


def run_study(
    resolved: "ResolvedProblems",
    folder: Path,
    selection: Selection,
    progress: Progress,
    facts: Mapping[str, str] | None = None,
) -> StudyResults:
    """Run a study's cases into a folder and return the results.

    Cases that are there from an earlier run and whose settings, FMU, seed and code are the same are kept. If
    the run is interrupted, the cases that were finished stay; the same call goes on from there. ``facts`` are
    what else there is to say of where the results come from.

    Raises
    ------
    ConfigError
        No case is selected, or the folder holds the results of another study or cannot be written to.
    """
    if selection.sandboxed and selection.executor == "local":
        require_sandbox()  # before anything is built
    plants, every = selected_cases(resolved, selection, progress)
    study = resolved.whole.with_seeds(selection.seeds)
    every = Cases([*every.series, *doing_nothing(every).series])
    cases = Cases.of(selection.part_of(every))
    claim_folder(folder, study)
    keep_logo(folder, study)
    loaded, ran, took = _run_and_loaded(cases, folder, study, selection, progress)
    results = loaded.cases
    provenance, of_problem = dict[str, str](), dict[str, list[CaseResult]]()
    for result in results:
        of_problem.setdefault(result.problem, []).append(result)
    several = len(resolved.problems) > 1
    for name, plant in plants.items():
        of_plant = facts_of_problem(of_problem.get(name, []), plant, resolved.problems[name].metrics.preview)
        provenance |= {provenance_of(name, key) if several else key: fact for key, fact in of_plant.items()}
    workers = str(selection.jobs) if selection.executor == "local" else selection.executor
    how = f"{took:.3g} s for {ran} cases, {len(cases) - ran} kept from an earlier run"
    run = facts_of_run(results, resolved.file, selection.options(), workers, how) | dict(facts or {})
    whole = [*every.ids()] if selection.is_part else None
    written = loaded.of(folder, study, provenance | run)
    return write_results(replace(written, runs=(run | {CASES_RUN: str(ran)},)), whole)


def _run_and_loaded(
    cases: Cases, folder: Path, study: "WholeStudy", selection: Selection, progress: Progress
) -> tuple[Loaded, int, float]:
    """Run the cases that are not there; return all, how many were run, and how long that took [s]."""
    began, batched = monotonic(), Batched(folder / CASES_FOLDER)
    ran = run_missing(cases, folder, selection, progress, begin=True, batched=batched)
    took = monotonic() - began
    loaded = load_cases(folder, study, cases.ids(), batched)
    if extremes := _extremes_without_samples(study, loaded.cases):
        again = [cases[place] for place, case_id in enumerate(cases.ids()) if case_id in extremes]
        run_missing(again, folder, selection, progress, begin=True, batched=batched)
    return loaded, ran, took


def _extremes_without_samples(study: "WholeStudy", results: Sequence[CaseResult]) -> set[str]:
    """Return the ids of the worst, middle and best cases of which only figures are kept."""
    if not any(case.batched for case in results):
        return set()
    from ddpc_cosim.study.verdicts.reliability import extreme_runs  # with all that reads studies

    by_problem: dict[str, list[CaseResult]] = {}
    for result in results:
        by_problem.setdefault(result.problem, []).append(result)
    return {
        case.id
        for problem, of_problem in by_problem.items()
        for case in extreme_runs(study.problems[problem], of_problem)
        if not case.has_samples
    }


def _done(
    cases: Sequence[Case],
    folder: Path,
    selection: Selection,
    progress: Progress,
    workers: "Workers | None" = None,
) -> Iterator[Case]:
    """Run cases where they are to run, and yield each one when its files are written."""
    sandboxed = selection.sandboxed
    if not cases:
        return iter(())
    if selection.executor == "local":
        how: dict[str, Any] = {"sandboxed": sandboxed, "keep_files": selection.keep_files}
        return run_cases(cases, folder, selection.jobs, progress.update, workers=workers, **how)
    from ddpc_cosim.study.running.cluster import run_on_cluster  # which few runs need

    return run_on_cluster(cases, folder, selection.scheduler, run_cases, sandboxed=sandboxed)


def selected_cases(
    resolved: "ResolvedProblems", selection: Selection, progress: Progress
) -> tuple[dict[str, PlantSpec], Cases]:
    """Return the cases that are selected, and the plants of their problems, by name, ready to run.

    Raises
    ------
    ConfigError
        No case is selected.
    MissingLibraryError
        None that is selected can run without a package that is not installed.
    """
    # The only problem, whose name is the study's, is in no case's name.
    names = {problem.study.variant_of or name for name, problem in resolved.problems.items()}
    is_only = names == {resolved.head.name}
    in_cases = {
        name: "" if is_only and not problem.study.variant_of else name
        for name, problem in resolved.problems.items()
    }
    studies = {in_cases[name]: problem for name, problem in resolved.problems.items()}
    selected = problems_with_cases(studies, selection.seeds, selection.only)
    chosen = {name: problem for name, problem in resolved.problems.items() if in_cases[name] in selected}
    with demanded(selection.sandboxed):
        plants = built_plants(chosen, progress)
    problems = {in_cases[name]: (problem, plants[name]) for name, problem in chosen.items()}
    cases = cases_of_problems(problems, selection.seeds, selection.only)
    each = [series.case for series in cases.series]
    lacking = [problems[case.problem][0].lacking.get(case.controller, "") for case in each]
    if all(lacking):
        raise MissingLibraryError(list(dict.fromkeys(lacking)))
    return plants, cases


def run_missing(
    cases: Sequence[Case],
    folder: Path,
    selection: Selection,
    progress: Progress,
    *,
    begin: bool = False,
    workers: "Workers | None" = None,
    batched: Batched | None = None,
) -> int:
    """Run the cases that are not there, and judge the others again where what they are judged by has changed.

    Returns how many were run.

    Parameters
    ----------
    cases : sequence of Case
        The cases.
    folder : Path
        The folder of results.
    selection : Selection
        How they are run.
    progress : Progress
        Follows the run.
    begin : bool
        Whether these are all cases; otherwise each counts as one of those that the progress knows of.
    workers : Workers, optional
        Whoever runs some cases after the other keeps them in between.
    batched : Batched, optional
        The folder's batches, for whoever has read them; those of these cases are added.
    """
    cases_folder, cases = folder / CASES_FOLDER, Cases.of(cases)
    _require_short_paths(folder, cases.ids())
    try:
        cases_folder.mkdir(parents=True, exist_ok=True)
        remove_left_behind(cases_folder, STAGING)
    except OSError as error:
        raise ConfigError(f"{folder}: results cannot be written there: {error.strerror}") from error
    how: dict[str, Any] = {"storage": selection.storage}
    if selection.engine:
        how["engine"] = selection.engine
    batched = Batched(cases_folder) if batched is None else batched
    alone, together = _apart(cases.with_all(**how), selection)
    by_themselves = batched.alone()

    def has_files(case_id: str) -> bool:
        return not selection.fresh and case_id in by_themselves and _is_there(cases_folder / case_id)

    def has_figures(series: CaseSeries) -> Callable[[str], bool]:
        settings = asdict(series.case.metrics)
        return lambda case_id: (
            not selection.fresh and case_id not in by_themselves and batched.is_valid(case_id, settings)
        )

    kept, alone = alone.parted(lambda _: has_files)
    figures, together = together.parted(has_figures)
    more_kept, together = together.parted(lambda _: has_files)
    kept = Cases([*kept.series, *more_kept.series])
    missing = Cases([*alone.series, *together.series])
    if selection.executor == "local":
        with demanded(selection.sandboxed):
            read = (path for series in missing.series for path in files_read(series.case))
            _compile_ahead(dict.fromkeys(read), progress)
    if begin:
        progress.start(len(missing), len(cases) - len(missing))
    for case in kept:
        recompute_metrics(cases_folder / case.id, case.metrics)
    if not begin:
        for case in kept:
            progress.finished(case, load_case(cases_folder / case.id))
        for case in figures:
            progress.finished(case, batched[case.id])
    for case in _done(alone, cases_folder, selection, progress, workers):
        progress.finished(case, load_case(cases_folder / case.id))
    lost = list[Case]()
    for case, result in run_batches(together, batched, selection.jobs, lost):
        progress.finished(case, result)
    for case in _done(lost, cases_folder, selection, progress, workers):
        progress.finished(case, load_case(cases_folder / case.id))
    return len(missing)


def _apart(cases: Cases, selection: Selection) -> tuple[Cases, Cases]:
    """Return the cases with files of their own, and those of which only figures are kept.

    These are those of many seeds, but for the first.
    """
    if selection.executor != "local" or selection.keep_files or selection.sandboxed:
        return cases, Cases([])
    groups: dict[tuple[str, str, str], list[CaseSeries]] = {}
    for series in cases.series:
        groups.setdefault(_kind(series.case), []).append(series)
    alone, together = list[CaseSeries](), list[CaseSeries]()
    for group in groups.values():
        first, of_group = group[0].case, Cases(group)
        is_many = len(of_group) > _MANY_SEEDS and first.engine == "compiled"
        if is_many and leaves_nothing_behind(first) and not first.late:
            alone += of_group[:_FIRST_SEEDS].series
            together += of_group[_FIRST_SEEDS:].series
        else:
            alone += group
    return Cases(alone), Cases(together)


def _require_short_paths(folder: Path, case_ids: Iterable[str]) -> None:
    """Check, before the first case, that the files of cases can have their places in a folder of results."""
    files = longest_files(folder.absolute() / CASES_FOLDER, case_ids)
    if are_limited() and (excess := longest_excess(files)):
        raise ConfigError(
            f"{folder}: results cannot be written there: paths of files would be {excess.characters} "
            f"characters longer than Windows allows; give a folder whose path is that much shorter (--out), "
            f"or {ALLOW_MORE}"
        )


def built_plants(problems: Mapping[str, "ResolvedStudy"], progress: Progress) -> dict[str, PlantSpec]:
    """Return each problem's plant, by name, ready to run; one that several problems have is built once."""
    _compile_ahead((Path(path) for problem in problems.values() for path in problem.plant.files), progress)
    built = list[tuple[PlantSpec, PlantSpec]]()
    plants = {}
    for name, problem in problems.items():
        ready = next((ready for spec, ready in built if spec == problem.plant), None)
        if ready is None:
            ready = problem.plant.built()
            built.append((problem.plant, ready))
        if ready.coupled:
            ready.coupled.check(problem.study.loop.sampling_time)
        plants[name] = ready
    return plants


def _compile_ahead(paths: Iterable[Path], progress: Progress) -> None:
    """Compile FMUs of C sources, which is part of no call's time, and keep the libraries for the workers."""
    for path in paths:
        _compiled(path, progress.prepare)


def _compiled(path: Path, tell: Callable[[str], object]) -> list[Path]:
    """Return where the libraries are that an FMU has as C sources only; there are none of other files."""
    if path.suffix.lower() != ".fmu":
        return []
    from ddpc_cosim.fmu.library import compile_ahead  # with all that runs FMUs

    return compile_ahead(path, tell)


def _sandboxed_read(context: CaseContext, known: dict[Path, list[Path]]) -> tuple[Path, ...]:
    """Return what a case reads in a sandbox: files, and the compiled libraries of those that are FMUs."""
    with demanded(wanted=True):
        for path in context.read:
            if path not in known:
                known[path] = _compiled(path, lambda _: None)
    return (*context.read, *(folder for path in context.read for folder in known[path]))


def _is_there(folder: Path) -> bool:
    """Whether a case need not be run: one that is damaged or may end otherwise is run again."""
    try:
        return not load_case(folder).transient
    except ConfigError:
        return False


def run_cases(
    cases: Sequence[Case],
    folder: Path,
    jobs: int,
    watch: Watcher | None = None,
    *,
    sandboxed: bool = False,
    context: CaseContext | None = None,
    keep_files: bool = False,
    workers: "Workers | None" = None,
) -> Iterator[Case]:
    """Run cases in ``jobs`` worker processes and yield each one when its files are written.

    Parameters
    ----------
    cases : sequence of Case
        What to run.
    folder : Path
        Each case is written to ``folder / case.id``.
    jobs : int
        Number of workers.
    watch : callable, optional
        Called with the progress of running cases.
    sandboxed : bool
        Whether each case runs in a sandbox, in which it writes nothing but its own files.
    context : CaseContext, optional
        What cases find around them; default: what is around this process.
    keep_files : bool
        Whether to keep what each case leaves in its working directory, which is a temporary one of its own.
    workers : Workers, optional
        Those of the cases before, which stay for those after; default: they end with these cases.

    Raises
    ------
    ConfigError
        This system has no sandbox.
    CosimError
        A case cannot be written.
    """
    cases = [*cases]
    if sandboxed:
        words = require_sandbox()
        cases = [replace(case, sandbox=words) for case in cases]
    with ExitStack() as ending:
        workers = workers or ending.enter_context(Workers())
        temporary, staging = workers.temporary, ending.enter_context(_scratch(folder, STAGING))
        tables = {"pyarrow.parquet" for case in cases if case.storage == "parquet"}
        engines = {"ddpc_cosim.compiled.engine" for case in cases if case.engine == "compiled"}
        preload = [*_PRELOAD, *tables, *engines, *_plugin_modules(cases)]
        waiting, running, crashes = deque(cases), list[_Run](), Counter[str]()
        compiled = dict[Path, list[Path]]()
        try:
            while waiting or running:
                while waiting and len(running) < jobs:
                    # What ends the process that starts its own takes others along: one at a time it cannot.
                    alone = crashes[waiting[0].id] > 1
                    if alone and any(run.alone for run in running):
                        break
                    case = waiting.popleft()
                    if case.late:
                        trace = no_samples(case, Outcome.TIMED_OUT, f"before the first sample: {case.late}")
                        write_case(folder / case.id, trace, case.head(), staging, case.metrics)
                        yield case
                        continue
                    case_context = context or CaseContext.of(case)
                    if case.sandbox:
                        case_context = replace(case_context, read=_sandboxed_read(case_context, compiled))
                    with _writable():
                        places = (folder / case.id, staging, temporary)
                        make = workers.maker_for(case, jobs, preload)
                        run = _Run(
                            case,
                            make,
                            *places,
                            case_context,
                            alone=alone,
                            keep_files=keep_files,
                            may_go_on=workers.may_go_on(case),
                        )
                        running.append(run)
                        run.begin()  # once it is among those that are ended, whatever happens
                    if watch is not None:
                        watch(running[-1].progress)
                ready = wait([run.worker.channel.socket for run in running], _POLL_SECONDS)
                ForkServer.wake()
                for run in list(running):
                    ended = run.has_ended(run.worker.channel.socket in ready)
                    if ended:
                        running.remove(run)
                        workers.take_back(run)
                    if ended and run.may_be_a_bystander:
                        crashes[run.case.id] += 1
                        waiting.appendleft(run.case)
                    elif ended:
                        yield run.case
                    elif watch is not None:
                        watch(run.progress)
        finally:
            for run in running:
                run.worker.end()
                run.close()


def run_batches(
    cases: Cases, batched: Batched, jobs: int, lost: list[Case]
) -> Iterator[tuple[Case, CaseResult]]:
    """Run cases some at a time in ``jobs`` worker processes, and yield each one when its figures are written.

    Parameters
    ----------
    cases : Cases
        What to run: own controllers on own plants, so that processes are as good as new after each.
    batched : Batched
        Where they are kept.
    jobs : int
        Number of workers.
    lost : list of Case
        Is given the cases of which nothing is known, as one of their batch has ended its process or takes
        too long: each of them can be run by itself.
    """
    if not cases:
        return
    plugins = _plugin_modules([series.case for series in cases.series])
    preload, waiting = [*_PRELOAD, "ddpc_cosim.compiled.engine", *plugins], _chunks(cases)
    with _scratch() as temporary, _scratch(batched.folder, STAGING) as staging, _writable():
        work = _working_directory(temporary)
        running, idle = list[_Batch](), list[Worker]()
        try:
            while True:
                for chosen in islice(waiting, jobs - len(running)):
                    first = chosen[0]
                    if not idle:
                        memory = _memory(first, jobs)
                        idle.append(Worker(serve_calls, folder=temporary, preload=preload, memory=memory))
                    running.append(_Batch(idle.pop(), chosen, monotonic()))
                    context = CaseContext.of(first)
                    environment = (context.modules, context.values, work)
                    with suppress(OSError):  # it has died, which is seen below
                        ask(running[-1].worker.channel, run_batch, chosen, staging, *environment)
                if not running:
                    break
                ready = wait([batch.worker.channel.socket for batch in running], _POLL_SECONDS)
                ForkServer.wake()
                for ended in [batch for batch in running if batch.has_ended(ready)]:
                    running.remove(ended)
                    try:
                        results = ended.results(staging, batched)
                    except (CosimError, UnexpectedError, OSError, EOFError, ValueError):
                        ended.worker.end()
                        lost += ended.cases
                    else:
                        idle.append(ended.worker)
                        yield from results
        finally:
            for worker in (*idle, *(batch.worker for batch in running)):
                worker.end()


class _Batch(NamedTuple):
    """Cases that a worker runs one after the other, since a time."""

    worker: Worker
    cases: list[Case]
    since: float

    def has_ended(self, ready: Sequence[Any]) -> bool:
        """Whether there is something to hear of it, or nothing for too long."""
        return self.is_late or self.worker.channel.socket in ready

    @property
    def is_late(self) -> bool:
        """Whether its cases are to be run by themselves, where each call has a limit of time."""
        first = self.cases[0]
        each = first.step_timeout if first.case_timeout is None else first.case_timeout
        return monotonic() - self.since > max(len(self.cases) * each, _BETWEEN_CALLS_SECONDS)

    def results(self, staging: Path, batched: Batched) -> list[tuple[Case, CaseResult]]:
        """Return its cases, whose files have been put in their places; raises what keeps one from that."""
        seconds = 0.0 if self.is_late else _REPLY_SECONDS
        files = result_of(self.worker.channel.receive(LONGEST_REPLY, seconds=seconds))
        results = list[tuple[Case, CaseResult]]()
        for controller in dict.fromkeys(case.controller for case in self.cases):
            cases = [case for case in self.cases if case.controller == controller]
            path = staging / Path(files[controller]).name
            results += zip(cases, batched.accept(path, [case.head() for case in cases]), strict=True)
        return results


def _kind(case: Case) -> tuple[str, str, str]:
    """Return what is equal of cases that differ by their seeds alone."""
    return case.problem, case.controller, case.scenario


def _chunks(cases: Cases) -> Iterator[list[Case]]:
    """Yield what a worker is sent at once: cases of a problem and scenario, those of a seed together."""
    groups: dict[tuple[str, str], dict[str, list[CaseSeries]]] = {}
    for series in cases.series:
        problem, controller, scenario = _kind(series.case)
        groups.setdefault((problem, scenario), {}).setdefault(controller, []).append(series)
    for controllers in groups.values():
        wholes = [alike[0] if len(alike) == 1 else [*Cases(alike)] for alike in controllers.values()]
        size = max(1, _BATCH // len(wholes))
        for first in range(0, max(map(len, wholes)), size):
            some = (case for whole in wholes for case in whole[first : first + size])
            yield sorted(some, key=lambda case: case.seed)


def run_batch(
    cases: Sequence[Case], staging: Path, modules: str, values: bytes, work: Path
) -> dict[str, str]:
    """Run cases in a worker, and stage what there is to say of them; return the file of each controller."""
    _settle(modules, values, work)
    runs: dict[str, list[dict[str, Any]]] = {}
    ran = _timed(cases)
    # One after the other they take half the time: a run in between leaves nothing of it in the CPU's caches.
    while some := [*islice(ran, _DESCRIBED_AT_ONCE)]:
        for case, trace, wall_time in some:
            head = case.head() | {"versions": versions(), "wall_time": wall_time}
            run = described(trace, head, case.metrics) | {"signals": {"rows": len(trace)}}
            runs.setdefault(case.controller, []).append(run)
    return {
        controller: stage_batch(staging, of_controller).name for controller, of_controller in runs.items()
    }


def _timed(cases: Sequence[Case]) -> Iterator[tuple[Case, Trace, float]]:
    """Run cases, and yield each with its trace and the time that it took [s]."""
    began = monotonic()
    for case, trace in zip(cases, run_alike(cases), strict=True):
        yield case, trace, monotonic() - began
        began = monotonic()


def answer_of(case: Case, function: Callable[[Case], Any]) -> Any:
    """Return what a function, which returns what JSON can say, makes of a case in a worker of its own.

    Raises
    ------
    CosimError
        What the function raises, or that its process crashed or was not done in time.
    """
    context = CaseContext.of(case)
    seconds = case.case_timeout or _LONGEST_ANSWER_SECONDS
    with _scratch() as folder:
        sandbox = Sandbox((folder,), _sandboxed_read(context, {})) if case.sandbox else None
        preload = [*_PRELOAD, *_plugin_modules([case])]
        memory = _memory(case, 1)
        worker = Worker(serve_calls, folder=folder, preload=preload, memory=memory, sandbox=sandbox)
        try:
            work = _working_directory(folder)
            environment = context.modules, context.values, work
            return worker.call(_answer, function, case, *environment, seconds=seconds)
        except LostWorkerError as error:
            reason = f"its process crashed: {error}"
            if error.exit_status is None:
                reason = f"not done within {seconds:g} s; raise loop.case_timeout if it needs longer"
            raise CosimError(f"{case.name}: {reason}") from error
        except UnexpectedError as error:
            raise CosimError(f"{case.name}: {error}") from error
        finally:
            worker.end()


def _answer(function: Callable[[Case], Any], case: Case, modules: str, values: bytes, work: Path) -> Any:
    _settle(modules, values, work)
    return function(case)


def _working_directory(place: Path) -> Path:
    """Make an empty folder for a case to run in."""
    work = place / "work"
    work.mkdir()
    return work


def _settle(modules: str, values: bytes, work: Path) -> None:
    """Let a worker find what is around the process that it works for, and go where it may leave files."""
    find_modules_in(modules)
    keep_values(pickle.loads(values))
    os.environ[FOLDER_VARIABLE] = str(study_folder())
    _go_to(work, temporary=work.parent)


def _go_to(folder: Path, *, temporary: Path) -> None:
    """Have this process be in a folder, and make its temporary files in another one."""
    os.chdir(folder)
    keep_temporary_files_in(str(temporary))


def _memory(case: Case, workers: int) -> int:
    """Return how many bytes the worker of a case may have."""
    return default_memory(workers) if case.memory_limit is None else int(1e9 * case.memory_limit)


def _scratch(within: Path | None = None, prefix: str = "ddpc-cosim-") -> ScratchFolder:
    """Make a folder of this run, for temporary files or for the cases that are not complete."""
    with _writable():
        return ScratchFolder(within, prefix)


@contextmanager
def _writable() -> Iterator[None]:
    """Say what is wrong where files cannot be made or written."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        place = f"{error.filename}: " if error.filename else ""
        raise CosimError(f"{place}cannot be written: {reason}; finished cases are kept") from error


def _plugin_modules(cases: Sequence[Case]) -> list[str]:
    """Return the modules of controllers, and of what is in their settings; with ``preload`` if they have one.

    Controllers that are installed, and what is of this project: modules beside a study may change between
    two runs.
    """
    sections = {id(case.section): case.section for case in cases}.values()  # seeds share theirs
    named = {name for section in sections for name in types_in(section) if name}
    lasting = [name for name in named if ":" not in name or is_own("controllers", name)]
    modules = sorted({load_plugin("controllers", name).__module__ for name in lasting})
    return [f"{name}:preload" if hasattr(sys.modules[name], "preload") else name for name in modules]


class Workers:
    """Makes the workers of cases; one that is as good as new is used again where that pays.

    As a context it ends those that are left.

    Attributes
    ----------
    temporary : Path
        Where temporary files of cases lie meanwhile.
    """

    def __init__(self) -> None:
        self._reuse = not spawning.forks()
        self._idle: list[Worker] = []

    def __enter__(self) -> Self:
        self._scratch = _scratch()
        self.temporary = self._scratch.__enter__()
        return self

    def __exit__(self, *how: Any) -> None:
        while self._idle:
            self._idle.pop().end()
        self._scratch.__exit__(*how)

    def maker_for(self, case: Case, jobs: int, preload: Sequence[str]) -> Callable[..., Worker]:
        """Return what makes, or has, the worker of a case; ``preload`` is imported before one is forked."""
        make = partial(Worker, serve_calls, preload=preload, memory=_memory(case, jobs))
        if not self.may_go_on(case):
            return make

        def make_or_take(*, folder: Path, **how: Any) -> Worker:
            while self._idle:
                worker = self._idle.pop()
                if not wait([worker.channel.socket], 0):  # else it has died: it has nothing to say
                    return worker
                worker.end()
            return make(folder=self.temporary, **how)

        return make_or_take

    def take_back(self, run: "_Run") -> None:
        """Keep the worker of a run that has ended for another one, unless it has ended too."""
        if run.worker_goes_on:
            self._idle.append(run.worker)

    def may_go_on(self, case: Case) -> bool:
        """Whether the worker of a case that completes may have another one."""
        # Beside a compiled loop, the start of a worker takes as long as all else.
        reuse = self._reuse or case.engine == "compiled"
        return reuse and not case.sandbox and leaves_nothing_behind(case)


class _Run:
    """A case in a worker, which runs it once it is told to :meth:`begin`.

    Parameters
    ----------
    case : Case
        The case.
    make : callable
        Makes the worker.
    folder, staging : Path
        The case's folder, and where it is to stand until it is complete.
    temporary : Path
        Where temporary files lie.
    context : CaseContext
        What it finds around it.
    alone : bool
        Whether it is to take no other run along, whatever it does.
    keep_files : bool
        Whether to keep what it leaves in its working directory.
    may_go_on : bool
        Whether its worker need not end if it completes.

    Attributes
    ----------
    worker_goes_on : bool
        Whether its worker has not ended with it.
    may_be_a_bystander : bool
        Whether it ended with others, of which another one may be at fault: nothing is written of it.
    """

    def __init__(
        self,
        case: Case,
        make: Callable[..., Worker],
        folder: Path,
        staging: Path,
        temporary: Path,
        context: CaseContext,
        *,
        alone: bool,
        keep_files: bool,
        may_go_on: bool,
    ) -> None:
        self._began = monotonic()
        self.case, self._folder, self._staging, self._context = case, folder, staging, context
        self.alone, self.may_be_a_bystander = alone, False
        self._may_go_on, self.worker_goes_on = may_go_on, False
        self._staged, self._place = (Path(tempfile.mkdtemp(dir=within)) for within in (staging, temporary))
        self._work, self._keep_files = _working_directory(self._place), keep_files
        sandbox = None
        if case.sandbox:
            traced = [Path(case.plant.trace_calls)] if case.plant.trace_calls else []
            sandbox = Sandbox((self._place, self._staged, *traced), context.read)
        self.worker = make(folder=self._place, sandbox=sandbox, alone=alone)
        self._store = row_store(case, self._place / "rows", follow=True)
        self._call, self._since = 0, monotonic()

    def begin(self) -> None:
        """Have the worker run the case."""
        with suppress(OSError):  # it has died meanwhile, which the next look at it will show
            environment = (self._context.modules, self._context.values, self._work)
            run = run_and_leave if self._may_go_on else run_and_stage
            rows = self._place / "rows"
            ask(self.worker.channel, run, self.case, rows, self._staged, *environment, self._began)

    @property
    def progress(self) -> Update:
        """How far it is."""
        return Update(self.case.name, self._store.count, len(self._store.y), self._store)

    def has_ended(self, has_replied: bool) -> bool:
        """Whether the run is over; then all that is known is written, unless another one may have ended it.

        Raises
        ------
        CosimError
            The case cannot be written.
        """
        self._store.look()
        if has_replied:
            try:
                outcome = result_of(self.worker.channel.receive(LONGEST_REPLY, seconds=_REPLY_SECONDS))
            except (CosimError, UnexpectedError) as error:  # what fails in the run itself is in its files
                self._give_up(Outcome.CRASHED, str(error), of_the_machine=True)
            except (OSError, EOFError, ValueError):
                self._end_worker()
            else:
                self._accept(goes_on=self._may_go_on and outcome == Outcome.COMPLETED)
        elif self._hangs():
            self._end_worker(self._limit(self._store.call))
        elif (most := self.case.case_timeout) is not None and monotonic() - self._began > most:
            reason = f"the run: not done within {most:g} s; its process was ended"
            self._give_up(Outcome.TIMED_OUT, f"{reason}; raise loop.case_timeout if it needs longer")
        else:
            return False
        if self._keep_files and not self.may_be_a_bystander:
            keep_left(self._work, self._folder)
        self.close()
        return True

    def close(self) -> None:
        """Remove what the run has left besides its case."""
        remove(self._place)
        remove(self._staged)

    def _accept(self, *, goes_on: bool) -> None:
        """Put what the worker has staged in its place: what it ran has no more to say in that by now."""
        try:
            printed, longest = "" if goes_on else self.worker.end().output, self._longest_samples()
            left = left_in(self._work)
            head, keeps_state = self.case.head(), self.case.keeps_state
            accept_case(self._staged, self._folder, head, printed, longest, left, keeps_state=keeps_state)
            self.worker_goes_on = goes_on
        except ConfigError as error:
            self._give_up(Outcome.CRASHED, f"its process has left no results: {error}")

    def _longest_samples(self) -> int:
        """Return how many bytes the samples of the case can take as text, header included."""
        store = self._store
        tables = (store.reference, store.y, store.measured, store.u, store.applied)
        columns = sum(table.shape[1] for table in tables)
        return (columns + 1) * _HEADER_BYTES + len(store.y) * (_ROW_BYTES + _NUMBER_BYTES * columns)

    def _hangs(self) -> bool:
        """Whether the run has been waiting for too long, mostly for the plant or the controller."""
        call, now = self._store.call, monotonic()
        if call.number != self._call:
            self._call, self._since = call.number, now
        return now - self._since > self._limit(call)

    def _limit(self, call: Call) -> float:
        longest = self.case.step_timeout
        return longest if call.name else max(longest, _BETWEEN_CALLS_SECONDS)

    def _end_worker(self, seconds: float | None = None) -> None:
        """End a worker that has died or is to die, and write what it has left."""
        call, case, count = self._store.call, self.case, self._store.count
        exit_status = self.worker.end()
        if seconds is None and exit_status.is_one_of_several:
            self.may_be_a_bystander = True
            return
        who, time = "the run", math.nan
        if call.who == "plant":
            who, time = case.plant.label, call.time
        elif call.who == "controller":
            who = f"controller {case.section['type']}"
            time = float(case.times(count)[-1]) if count else math.nan
        error = lost(who, call.name or "between two calls", time, exit_status, seconds)
        when = "" if count else "before the first sample: "
        if call.name.partition(" ")[0] in _AT_THE_END:
            when = "after the last sample: "
        self._give_up(OUTCOME_OF[error.status], f"{when}{error}")

    def _give_up(self, outcome: Outcome, reason: str, *, of_the_machine: bool = False) -> None:
        """Write a case that its worker has not written, with the rows that it has left."""
        head = self.case.head() | {"printed": self.worker.end().output, "left": left_in(self._work)}
        trace = partial_trace(self.case, self._store, outcome, reason)
        trace = replace(trace, transient=of_the_machine)
        write_case(self._folder, trace, head, self._staging, self.case.metrics)


def run_and_stage(
    case: Case, rows: Path, staged: Path, modules: str, values: bytes, work: Path, began: float
) -> str:
    """Run a case, in a worker, write its files where they do not count yet, and return its outcome.

    ``began`` is when its worker was asked for, which is part of what it takes.
    """
    _settle(modules, values, work)
    trace = run_case(case, row_store(case, rows))
    head = case.head() | {"versions": versions(), "wall_time": monotonic() - began}
    stage_case(staged, trace, head, case.metrics)
    return trace.outcome


def run_and_leave(
    case: Case, rows: Path, staged: Path, modules: str, values: bytes, work: Path, began: float
) -> str:
    """Do the same in a worker that may have another case: nothing of the places of this one is held."""
    outcome = run_and_stage(case, rows, staged, modules, values, work, began)
    announce_calls()
    gc.collect()  # mapped rows, in cycles of what was called
    _go_to(work.parent.parent, temporary=work.parent.parent)
    return outcome
