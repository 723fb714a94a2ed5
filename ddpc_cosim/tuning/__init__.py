"""Tuning: every controller of a study is tried with as many settings, on seeds that no result is reported on.

A trial's runs are cases in the folder of results, which no trial of the same settings runs again, and what is
tried next follows from the trials before alone. A tuning that was interrupted goes on by going through its
trials once more; no other record of it exists that could contradict the cases.
"""

import json
from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import fsum, isfinite
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self

from ddpc_cosim.controller import Controller
from ddpc_cosim.errors import ConfigError, MissingLibraryError
from ddpc_cosim.files.tables import table_text
from ddpc_cosim.files.texts import encodable
from ddpc_cosim.loop.safe_calls import settings_of_other
from ddpc_cosim.processes.sandbox import demanded
from ddpc_cosim.study.batches import Batched
from ddpc_cosim.study.case_files import CaseResult, load_case, read_run
from ddpc_cosim.study.cases import (
    Case,
    Cases,
    cases_of_problems,
    doing_nothing,
    patterns_of,
    series_of_problem,
)
from ddpc_cosim.study.controller_plugins import controller_class, make_controller
from ddpc_cosim.study.file_format.sections import ControllerSection, Panel, ReportSection, Study, TunedSection
from ddpc_cosim.study.file_format.study_files import StudyFile
from ddpc_cosim.study.plants import PlantSpec
from ddpc_cosim.study.problems import WholeStudy
from ddpc_cosim.study.reading import resolve_file
from ddpc_cosim.study.resolve import ResolvedProblems, ResolvedStudy
from ddpc_cosim.study.results import CASES_FOLDER, TRIALS_FILE, StudyResults, claim_folder
from ddpc_cosim.study.runner import Progress, Selection, Workers, built_plants, run_missing, run_study
from ddpc_cosim.study.verdicts.judgement import judged, run_of
from ddpc_cosim.tuning.objectives import PREDICTION, Objective, Run, reference_spans
from ddpc_cosim.tuning.search import (
    Figures,
    SettingsSearch,
    Trial,
    best,
    dominates,
    figures_of,
    search_spaces,
    settings_faults,
    space_faults,
    trial_of,
    with_settings,
)
from fmu_plants.files import write_atomically

TUNED_FILE, HELD_OUT_FOLDER = "tuned.toml", "held-out"
_FIRST_SEED, _SEEDS = 10_000, 3
_GIVEN = "-as-given"
_LONGEST_NAME = 60
_NO_SWEEPS = "a study is tuned without sweeps; remove it, or say under `search` where to look instead"


@dataclass(frozen=True, slots=True)
class Request:
    """How to tune.

    Parameters
    ----------
    objectives : tuple of Objective
        What trials are compared by; the first chooses among the trials that are not dominated.
    trials : int
        How many settings each controller is tried with, those of the study included.
    seeds : list of int
        Of the trials; empty: three that the study does not have.
    command : str
        How it can be repeated.
    sampler_seed : int
        Another one has other settings tried.
    compares : bool
        Whether the settings as given and those found are compared on the seeds of the study.

    Raises
    ------
    ConfigError
        Objectives that cannot stand beside each other.
    """

    objectives: tuple[Objective, ...] = (Objective(),)
    trials: int = 50
    seeds: list[int] = field(default_factory=list)
    command: str = ""
    sampler_seed: int = 0
    compares: bool = True

    def __post_init__(self) -> None:
        faults = [
            f"--objective {objective.metric}: given twice"
            for number, objective in enumerate(self.objectives)
            if objective in self.objectives[:number]
        ]
        others = ", ".join(
            objective.metric for objective in self.objectives if objective.metric != PREDICTION
        )
        if self.by_prediction and others:
            faults.append(f"--objective {PREDICTION}: closes no loop, which {others} is of; give one of them")
        if faults:
            raise ConfigError(faults)

    @property
    def by_prediction(self) -> bool:
        """Whether no loop is closed."""
        return any(objective.metric == PREDICTION for objective in self.objectives)

    @property
    def by(self) -> str:
        """What trials are compared by, in words."""
        return "; ".join(map(str, self.objectives)) + ", of those with the fewest runs failed"

    def summary(self, controllers: Sequence[str]) -> str:
        """Say of these controllers what has been done, in a sentence."""
        who, seeds = _listed(controllers), _listed(self.seeds)
        sampler = f", sampler seed {self.sampler_seed}" if self.sampler_seed else ""
        return f"Tuned with {self.trials} trials each on the seeds {seeds}{sampler}, by {self.by}: {who}."

    def on_seeds_of_its_own(self, reported: Sequence[int]) -> Self:
        """Return the request with seeds that a study does not report.

        Raises
        ------
        ConfigError
            It has given some that the study reports.
        """
        free = (seed for seed in range(_FIRST_SEED, 2**32) if seed not in reported)
        unreported = [next(free) for _ in range(_SEEDS)]
        if shared := [seed for seed in self.seeds if seed in reported]:
            what = "seeds of the study, on which default and tuned settings are compared"
            what = f"--seeds: {_listed(shared)}: {what}"
            raise ConfigError(f"{what}; needed: others, such as {unreported[0]}:{unreported[-1] + 1}")
        return replace(self, seeds=self.seeds or unreported)


def _listed(values: Sequence[object]) -> str:
    return ", ".join(map(str, values[:8])) + (", ..." if values[8:] else "")


class TuningProgress(Progress, Protocol):
    """What follows a tuning."""

    def drop(self, cases: int) -> None:
        """So many, of those that were to be run, are not run."""


class Tuned(NamedTuple):
    """What has been found.

    Parameters
    ----------
    trials : dict
        The trials in their order, by problem and controller.
    held_out : dict
        The settings as given and those found, on the seeds of the study, by problem and controller.
    at_ends : dict
        The settings found that lie at an end of where was looked, by problem and controller: see
        :meth:`SettingsSearch.at_ends`.
    kept : list of (str, str)
        Problem and controller of those that have no search space and are left as they are.
    results : StudyResults or None
        As given against tuned, on the study's own seeds; None where they are not compared.
    """

    trials: dict[tuple[str, str], list[Trial]]
    held_out: dict[tuple[str, str], tuple[Trial, Trial]]
    at_ends: dict[tuple[str, str], list[str]]
    kept: list[tuple[str, str]]
    results: StudyResults | None


def tune_study(
    resolved: ResolvedProblems, folder: Path, request: Request, selection: Selection, progress: TuningProgress
) -> Tuned:
    """Tune the controllers of a study, each problem for itself, and compare as given with tuned.

    Written are the cases of all trials, ``trials.csv``, ``tuned.toml``, which is the study with the settings
    found, and in ``held-out`` the results of both on the seeds of the study.

    The last trials of a method are for what has been found for methods that it contains, as these say it by
    :meth:`ddpc_cosim.Controller.settings_as`.

    Parameters
    ----------
    resolved : ResolvedProblems
        The study.
    folder : Path
        For all that is written.
    request : Request
        How to tune.
    selection : Selection
        Which cases, and how to run them; the seeds of the trials are those of the request.
    progress : TuningProgress
        Follows them.

    Raises
    ------
    ConfigError
        Nothing can be tuned, or not so: all reasons; or the folder is that of another study.
    """
    request = request.on_seeds_of_its_own(resolved.head.seeds)
    searches, kept = _searches(resolved, request, selection.engine)
    with demanded(selection.sandboxed):
        plants = built_plants(resolved.problems, progress)
    if request.compares:
        claim_folder(folder / HELD_OUT_FOLDER, resolved.whole)
    patterns = patterns_of(selection.only)
    planned = {name: (problem, plants[name]) for name, problem in resolved.problems.items()}
    all_cases = cases_of_problems(planned, request.seeds, patterns)
    in_full = Counter((case.problem, case.controller) for case in all_cases)
    searches = [search for search in searches if (search.problem, search.name) in in_full]
    lacking = [planned[search.problem][0].lacking.get(search.name, "") for search in searches]
    if any(lacking):
        raise MissingLibraryError(list(dict.fromkeys(filter(None, lacking))))
    at_rest = doing_nothing([] if request.by_prediction else all_cases)
    runs_of_trials = request.trials * sum(in_full[search.problem, search.name] for search in searches)
    progress.start(runs_of_trials + len(at_rest), 0)
    batched = Batched(folder / CASES_FOLDER)  # of very many seeds
    run_missing(at_rest, folder, selection, progress, batched=batched)
    alone = batched.alone()
    runs_at_rest = (batched.take(case.id, alone) for case in at_rest)
    resting = {run_of(case): case for case in runs_at_rest}

    def judge(cases: Sequence[Case], places: Sequence[Path]) -> list[CaseResult]:
        scenarios = resolved.problems[cases[0].problem].study.scenarios
        return list(judged(scenarios, map(load_case, places), resting))

    tunings = [_Tuning(search, *planned[search.problem], request, patterns, progress) for search in searches]
    others = [tuning.others_in(tunings) for tuning in tunings]
    last = [min(len(some), request.trials - 1) for some in others]
    first = [tuning.go_on(request.trials - n) for tuning, n in zip(tunings, last, strict=True)]
    with Workers() as workers:
        how = selection, progress, judge, workers
        times = _run_all(first, folder, *how)
        for tuning, some in zip(tunings, others, strict=True):
            tuning.propose_found(some)
        rest = [tuning.go_on(n) for tuning, n in zip(tunings, last, strict=True) if n]
        times += _run_all(rest, folder, *how)
    trials = {(search.problem, search.name): search.trials for search in searches}
    chosen = {key: tried[best(tried)].settings for key, tried in trials.items()}
    at_ends = {
        (search.problem, search.name): search.at_ends(chosen[search.problem, search.name])
        for search in searches
    }
    tuned = _tuned_study(resolved, trials, at_ends, request)
    write_atomically(folder / TUNED_FILE, tuned.toml())
    kept = [] if patterns else kept
    folders, held_out, results = [folder], dict[tuple[str, str], tuple[Trial, Trial]](), None
    if request.compares:
        both = StudyFile(TUNED_FILE, folder, _with_given(tuned, resolved, trials, kept).tables())
        progress.prepare("comparing on the seeds of the study")
        count = len(trials) * request.trials
        runs = sum(trial.runs for tried in trials.values() for trial in tried)
        seconds = fsum(filter(isfinite, times))
        facts = {"tuning": f"{count} trials, {runs} runs, which took {seconds:.0f} s one after another"}
        on_all = replace(selection, only=())
        results = run_study(resolve_file(both), folder / HELD_OUT_FOLDER, on_all, progress, facts)
        for who, tried in trials.items():
            spans = reference_spans(resolved.problems[who[0]])
            held_out[who] = _held_out(who, tried, results, spans, request.objectives)
        folders.append(folder / HELD_OUT_FOLDER)  # where the report finds it
    table = encodable(_trials_table(trials, held_out, at_ends, request)).encode()
    for place in folders:
        write_atomically(place / TRIALS_FILE, table)
    return Tuned(trials, held_out, at_ends, kept, results)


def _searches(
    resolved: ResolvedProblems, request: Request, engine: str
) -> tuple[list[SettingsSearch], list[tuple[str, str]]]:
    """Return what to search, and what is left as it is; all errors at once."""
    searches, kept, faults = [], list[tuple[str, str]](), list[str]()
    for problem, resolved_study in resolved.problems.items():
        within = "" if resolved.whole.is_flat else f" (problem {problem})"
        if resolved_study.study.variant_of:
            faults.append(f"sweep: {_NO_SWEEPS}")
        for objective in request.objectives:
            try:
                objective.check(resolved_study, engine or resolved_study.study.loop.engine)
            except ConfigError as error:
                faults += error.faults
        for name, section in resolved_study.study.controllers.items():
            if section.variant_of:
                faults.append(f"controllers.{section.variant_of}.sweep: {_NO_SWEEPS}")
                continue
            spaces = dict(search_spaces(section, by_prediction=request.by_prediction))
            faults += [
                f"controllers.{name}.search.{fault}{within}" for fault in space_faults(section, spaces)
            ]
            faults += [
                f"controllers.{name}.first_trials[{i}].{fault}{within}"
                for i, settings in enumerate(section.first_trials)
                for fault in settings_faults(section, settings)
            ]
            if spaces and not faults:
                search = SettingsSearch(
                    *(problem, name, section.settings, spaces, request.objectives),
                    first=[] if request.by_prediction else section.first_trials,
                    sampler_seed=request.sampler_seed,
                )
                searches.append(search)
            elif not spaces:
                kept.append((problem, name))
    if not faults and not searches:
        which = " that the prediction depends on" if request.by_prediction else ""
        example = "search = { lambda_g = { log = [1.0, 1e3] } }"
        faults = [f"no controller has settings to search{which}; say so in the study, such as {example}"]
    if faults:
        raise ConfigError(list(dict.fromkeys(faults)))
    return searches, kept


class _Tuning:
    """The trials of one controller: what is to be run next follows from its own runs alone."""

    def __init__(
        self,
        search: SettingsSearch,
        resolved: ResolvedStudy,
        plant: PlantSpec,
        request: Request,
        patterns: Sequence[str],
        progress: TuningProgress,
    ) -> None:
        self.search = search
        self._resolved, self._plant, self._request, self._patterns = resolved, plant, request, patterns
        self._spans, self._progress = reference_spans(resolved), progress

    def go_on(self, trials: int) -> Generator[list[Case], list[CaseResult], None]:
        """Go through so many trials: yield what is to be run next, and be sent its results.

        A trial is pruned between its runs, with the runs first that trials failed most often.
        """
        search, objectives = self.search, self._request.objectives
        for _ in range(trials):
            settings = search.next_settings()
            cases = search.hardest_first(self._cases(settings))
            runs = dict[Run, Figures]()
            pruned = False
            for case in cases:
                runs |= figures_of((yield [case]), objectives, self._spans)
                if pruned := len(runs) < len(cases) and search.is_hopeless(runs):
                    break
            self._progress.drop(len(cases) - len(runs))
            search.tell(settings, runs, pruned=pruned)

    def others_in(self, tunings: Sequence["_Tuning"]) -> list["_Tuning"]:
        """Return who, of the same problem, may be a method that this one contains."""
        if self._request.by_prediction:  # which two methods share only as far as they look equally far ahead
            return []
        return [
            other
            for other in tunings
            if other is not self
            and other.search.problem == self.search.problem
            and controller_class(other._section.type).settings_as is not Controller.settings_as
        ]

    def propose_found(self, others: Sequence["_Tuning"]) -> None:
        """Have what has been found for methods that this one contains tried next."""
        study, logged = self._resolved.study, self._resolved.recording
        samples = len(logged) if logged else study.recording.samples if study.recording else 0
        kind = controller_class(self._section.type)
        sizes = len(self._resolved.inputs), len(self._resolved.outputs)
        for other in others:
            chosen = other.search.trials[best(other.search.trials)].settings
            section = other._section
            controller = make_controller(section.type, with_settings(section.settings, chosen))
            settings = settings_of_other(controller, kind, *sizes, samples or 0)
            if faults := [*settings_faults(self._section, settings)]:
                who = f"{type(controller).__name__}.settings_as({kind.__name__})"
                raise ConfigError([f"{who}: {fault}" for fault in faults])
            if settings:
                self.search.propose(settings, f"as found for {other.search.name}")

    @property
    def _section(self) -> ControllerSection:
        return self._resolved.study.controllers[self.search.name]

    def _cases(self, settings: dict[str, Any]) -> list[Case]:
        """Return the runs of a trial."""
        study, section = self._resolved.study, self._section
        section = replace(section, settings=with_settings(section.settings, settings))
        changes: dict[str, Any] = {"controllers": {self.search.name: section}}
        if self._request.by_prediction:  # which is known before the first sample
            changes["loop"] = replace(study.loop, duration=study.loop.sampling_time)
        changed = replace(self._resolved, study=replace(study, **changes))
        seeds = self._request.seeds
        return [*Cases(series_of_problem(changed, self._plant, self.search.problem, seeds, self._patterns))]


def _run_all(
    tunings: Sequence[Generator[list[Case], list[CaseResult], None]],
    folder: Path,
    selection: Selection,
    progress: TuningProgress,
    judge: Callable[[Sequence[Case], Sequence[Path]], list[CaseResult]],
    workers: Workers,
) -> list[float]:
    """Run what all tunings want next until all are done; return how long the runs took."""
    times = list[float]()
    due = {tuning: next(tuning) for tuning in tunings}
    while due:
        wanted = [case for cases in due.values() for case in cases]
        run_missing(wanted, folder, selection, progress, workers=workers)
        for tuning, cases in [*due.items()]:
            folders = [folder / CASES_FOLDER / case.id for case in cases]
            times += [read_run(place)["wall_time"] for place in folders]
            try:
                due[tuning] = tuning.send(judge(cases, folders))
            except StopIteration:
                del due[tuning]
    return times


def _held_out(
    who: tuple[str, str],
    tried: Sequence[Trial],
    results: StudyResults,
    spans: Mapping[str, float],
    objectives: Sequence[Objective],
) -> tuple[Trial, Trial]:
    """Return a controller's settings as given and those found as trials on the seeds of the study."""
    problem, name = who
    given, tuned = (
        [case for case in results.cases if case.problem == problem and case.controller == key]
        for key in (_as_given(name), name)
    )
    return (
        trial_of(tried[0].settings, figures_of(given, objectives, spans), objectives),
        trial_of(tried[best(tried)].settings, figures_of(tuned, objectives, spans), objectives),
    )


def _trials_table(
    trials: Mapping[tuple[str, str], Sequence[Trial]],
    held_out: Mapping[tuple[str, str], tuple[Trial, Trial]],
    at_ends: Mapping[tuple[str, str], Sequence[str]],
    request: Request,
) -> str:
    figures = ["runs failed", *map(str, request.objectives)]
    header = ["problem", "controller", "trial", "origin", "runs", "pruned", *figures]
    header += ["not dominated", "chosen", *(f"held out: {figure}" for figure in figures)]
    header += ["at ends", "settings"]
    rows = []
    for (problem, controller), tried in trials.items():
        whole, chosen = [trial for trial in tried if not trial.pruned], best(tried)
        given, tuned = held_out.get((problem, controller), (None, None))
        for number, trial in enumerate(tried):
            again = tuned if number == chosen else given if not number else None
            on_front = not trial.pruned and not any(dominates(other, trial) for other in whole)
            row = [problem, controller, number, trial.origin, trial.runs, trial.pruned, trial.failed]
            row += ["" if trial.pruned else value for value in trial.values]
            row += [on_front, number == chosen]
            row += [again.failed, *again.values] if again else [""] * len(figures)
            ends = ", ".join(at_ends[problem, controller]) if number == chosen else ""
            rows.append([*row, ends, json.dumps(trial.settings)])
    return table_text(header, rows)


def _tuned_study(
    resolved: ResolvedProblems,
    trials: Mapping[tuple[str, str], Sequence[Trial]],
    at_ends: Mapping[tuple[str, str], list[str]],
    request: Request,
) -> WholeStudy:
    """Return the study with the best settings, which says how they came about."""
    problems = {}
    for problem, resolved_study in resolved.problems.items():
        controllers = dict(resolved_study.study.controllers)
        for (of, name), tried in trials.items():
            if of == problem:
                chosen, section = tried[best(tried)].settings, controllers[name]
                how = TunedSection(
                    settings=list(chosen),
                    trials=request.trials,
                    seeds=section.seeds_of(request.seeds),
                    by=request.by,
                    source=request.command,
                    sampler_seed=request.sampler_seed,
                    at_ends=at_ends[of, name],
                )
                settings = with_settings(section.settings, chosen)
                controllers[name] = replace(section, settings=settings, tuned=how)
        problems[problem] = replace(resolved_study.study, controllers=controllers)
    return _whole(resolved, problems, request.summary(list(dict.fromkeys(name for _, name in trials))))


def _whole(resolved: ResolvedProblems, problems: dict[str, Study], summary: str) -> WholeStudy:
    """Return a study whose summary says what it is now: what it said was of other settings."""
    head = resolved.head
    if resolved.whole.is_flat:
        return WholeStudy.of(replace(problems[head.name], summary=summary))
    return WholeStudy(replace(head, summary=summary), problems)


def _as_given(name: str) -> str:
    return name[: _LONGEST_NAME - len(_GIVEN)] + _GIVEN


def _with_given(
    tuned: WholeStudy,
    resolved: ResolvedProblems,
    trials: Mapping[tuple[str, str], Sequence[Trial]],
    kept: Sequence[tuple[str, str]],
) -> WholeStudy:
    """Return a study of the tuned controllers, each beside its self as given, and of those that were kept."""
    problems = {}
    for problem, study in tuned.problems.items():
        controllers: dict[str, ControllerSection] = {}
        panels = []
        for name, section in study.controllers.items():
            label = section.label or name
            if (problem, name) in trials:
                given = resolved.problems[problem].study.controllers[name]
                key = _as_given(name)
                controllers[key] = replace(given, label=f"{label}, as given")
                controllers[name] = replace(section, label=f"{label}, tuned")
                panels.append(Panel(title=label, controllers=[key, name]))
            elif (problem, name) in kept:
                controllers[name] = section
                panels.append(Panel(title=label, controllers=[name]))
        if not controllers:
            continue
        points = study.report.reference_points
        report = ReportSection(
            panels=panels,
            limitations=study.report.limitations,
            reference_points=points if points and {points.zero, points.full} <= controllers.keys() else None,
        )
        # Given and found settings are compared in pairs of seeds.
        paired = {name: replace(section, seeds="all") for name, section in controllers.items()}
        problems[problem] = replace(study, controllers=paired, requirements=None, report=report)
    summary = (
        f"Settings as given against tuned ones, on seeds that played no part in it. {tuned.head.summary}"
    )
    return _whole(resolved, problems, summary)
