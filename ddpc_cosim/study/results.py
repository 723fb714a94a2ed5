"""The results of a study on disk, read back for reports and for people."""

import math
import os
import warnings
from base64 import b64encode
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ddpc_cosim.conditions import all_conditions
from ddpc_cosim.errors import ConfigError, CosimError, CosimWarning, MissingLibraryError
from ddpc_cosim.files.csv_files import load_pyarrow, write_parquet
from ddpc_cosim.files.tables import Table, plain_table, table_parts
from ddpc_cosim.files.texts import alike, encodable, printable, toml_tables
from ddpc_cosim.loop.plotting import Picture, drawn
from ddpc_cosim.loop.trace import Trace
from ddpc_cosim.metrics import keys_named
from ddpc_cosim.plugins import installed, load_plugin
from ddpc_cosim.processes.requests import held
from ddpc_cosim.processes.scratch import ScratchFolder, remove_left_behind
from ddpc_cosim.study.batches import Batched
from ddpc_cosim.study.case_columns import replaced
from ddpc_cosim.study.case_files import (
    DAMAGED,
    DOING_NOTHING,
    STAGING,
    CaseResult,
    checksum,
    damaged_files,
    read_sealed,
    sealed_parts,
)
from ddpc_cosim.study.file_format.sections import LOGOS
from ddpc_cosim.study.file_format.sweeps import variant_words
from ddpc_cosim.study.verdicts.judgement import judged, run_of
from ddpc_cosim.variables import FloatArray
from fmu_plants.files import write_atomically, write_through
from fmu_plants.spelling import did_you_mean

if TYPE_CHECKING:
    import pandas as pd

    from ddpc_cosim.study.file_format.sections import Study
    from ddpc_cosim.study.problems import WholeStudy
    from ddpc_cosim.study.verdicts.comparison import Comparison
    from ddpc_cosim.study.verdicts.findings import Findings

REPORT_FILE, TRIALS_FILE = "report.html", "trials.csv"
HTML = "html"
_NO_FORMATS = ("simulation", "pictures", "differences")
"""Plug-ins of reports that write none of a study."""
STUDY_FILE, PROVENANCE_FILE, METRICS_FILE, CASES_FOLDER = (
    "study.toml",
    "provenance.json",
    "metrics.csv",
    "cases",
)
METRICS_PARQUET = "metrics.parquet"
_TEXTS = ("study", "problem", "variant", "plant", "controller", "scenario", "outcome")
"""The columns of metrics that are no numbers."""
_ROWS_AT_ONCE = 1 << 14
"""Of the table of metrics as Parquet, whose groups of rows have so many."""
_OF_PROBLEM = ": "
_STUDY_CHECKSUM = "study sha256"
_RUNS, CASES_RUN = "runs", "cases run"
_MOST_LISTED = 8
_LOGO, _LARGEST_LOGO = "logo", 300_000
_PARAMETER = "parameter"
"""What the columns of plant parameters that seeds have drawn begin with."""


@dataclass(frozen=True, slots=True, repr=False)
class StudyResults:
    """The results of one study.

    Parameters
    ----------
    folder : Path
        The folder of results.
    whole : WholeStudy
        The resolved study, with all its problems.
    cases : tuple of CaseResult
        In the study's order: problems x controllers x scenarios x seeds.
    provenance : dict of str to str
        Versions, machine, plant, command, date of the last run; where there are several problems, what is of
        one begins with its name.
    resting : tuple of CaseResult
        The runs with inputs at rest, one per problem, scenario and seed, by which cases are judged.
    damaged : dict of str to str
        Cases whose files are not what the run wrote, by id, and what is wrong: they are not among the cases.
    peers : tuple of str
        The controllers that a page shows, those of other problems and studies too, in their order: each looks
        the same wherever it is drawn. Empty: its own.
    runs : tuple of dict of str to str
        What is to be said of each run over the folder, the first one first; the last may have run no case.
    """

    folder: Path
    whole: "WholeStudy"
    cases: tuple[CaseResult, ...]
    provenance: dict[str, str]
    resting: tuple[CaseResult, ...] = ()
    damaged: dict[str, str] = field(default_factory=dict)
    peers: tuple[str, ...] = ()
    runs: tuple[dict[str, str], ...] = ()

    @property
    def logo(self) -> str:
        """The logo of its report in a data URI; empty without one."""
        file = logo_of(self.folder)
        if file is None:
            return ""
        return f"data:{LOGOS[file.suffix]};base64,{b64encode(file.read_bytes()).decode('ascii')}"

    @property
    def _own_name(self) -> str:
        """Name of a flat study; of another one that of its first problem."""
        names = self.whole.problems
        return self.whole.head.name if self.whole.head.name in names else next(iter(names))

    @property
    def trials_file(self) -> Path:
        """Where ``tune`` leaves the trials that led to the settings of the study; else there is none."""
        return self.folder / TRIALS_FILE

    @property
    def study(self) -> "Study":
        """The study of the only problem.

        Raises
        ------
        ConfigError
            There are several problems.
        """
        if len(self.whole.problems) > 1:
            several = ", ".join(self.whole.problems)
            raise ConfigError(
                f"{self.folder}: several problems: {several}; use problems() to have each of them"
            )
        return next(iter(self.whole.problems.values()))

    def problems(self) -> tuple["StudyResults", ...]:
        """Return the results of each problem that has cases, each as those of a study of its own.

        Variants by the study's sweep are not among them, unless there is nothing else: see :meth:`variants`.
        """
        if len(self.whole.problems) == 1:
            return (self,)
        names = self.whole.problems
        views = self._views([name for name in names if not names[name].variant_of])
        return views or self._views(list(names))

    def variants(self, problem: str) -> tuple["StudyResults", ...]:
        """Return the results of each variant of a problem by the study's sweep, as those of a study."""
        return self._views(
            [name for name, study in self.whole.problems.items() if study.variant_of == problem]
        )

    def _views(self, names: Sequence[str]) -> tuple["StudyResults", ...]:
        cases: dict[str, list[CaseResult]] = {name: [] for name in self.whole.problems}
        resting: dict[str, list[CaseResult]] = {name: [] for name in self.whole.problems}
        for case in self.cases:
            cases[case.problem].append(case)
        for case in self.resting:
            resting[case.problem].append(case)
        damaged: dict[str, dict[str, str]] = {name: {} for name in self.whole.problems}
        longest_first = sorted(self.whole.problems, key=len, reverse=True)
        for id, why in self.damaged.items():
            matches = (name for name in longest_first if id.startswith(f"{name}_"))
            damaged[next(matches, self._own_name)][id] = why
        facts: dict[str, dict[str, str]] = {}
        for key, fact in self.provenance.items():
            problem, _, problem_key = key.partition(_OF_PROBLEM)
            owner = problem if problem_key and problem in self.whole.problems else ""
            facts.setdefault(owner, {})[problem_key if owner else key] = fact
        return tuple(
            StudyResults(
                self.folder,
                self.whole.of(self.whole.problems[name]),
                tuple(cases[name]),
                facts.get(name, {}) | facts.get("", {}),
                tuple(resting[name]),
                damaged[name],
                self.peers,
            )
            for name in names
            if cases[name] or damaged[name]
        )

    def __repr__(self) -> str:
        failed, damage = sum(case.failed for case in self.cases), len(self.damaged)
        controllers = ", ".join(dict.fromkeys(case.label for case in self.cases))
        damaged = f", {damage} damaged" if damage else ""
        words = f"{len(self.cases)} cases, {failed} failed{damaged}; {controllers}"
        return printable(f"StudyResults({self.folder}: {words})", 500)

    def _repr_html_(self) -> str:
        groups: dict[tuple[str, str, str], list[CaseResult]] = {}
        for case in self.cases:
            groups.setdefault((case.problem, case.label, case.scenario), []).append(case)
        rows = [(*key, len(cases), sum(case.failed for case in cases)) for key, cases in groups.items()]
        header = ("problem", "controller", "scenario", "cases", "failed")
        return plain_table(repr(self), header, rows).html

    def frame(self) -> "pd.DataFrame":
        """Return one row per case: what it was, how it ended, and its metrics, a column each, as metrics.csv.

        ``variant`` tells variants of a problem by the study's sweep apart; plant parameters that a seed has
        drawn are columns such as ``parameter mass [kg]``.
        """
        import pandas as pd

        rows = [
            {
                "study": self.whole.head.name,
                "problem": self.whole.problems[case.problem].variant_of or case.problem,
                "controller": case.controller,
                "label": case.label,
                "scenario": case.scenario,
                "variant": variant_words(self.whole.problems[case.problem].varied),
                "seed": case.seed,
                "outcome": str(case.outcome),
                "reason": case.reason or case.failure,
                "failed": case.failed,
                "settles": case.settles,
                **{f"{_PARAMETER} {name}": value for name, value in case.drawn.items()},
                **case.metrics,
            }
            for case in self.cases
        ]
        return pd.DataFrame(rows)

    def compare(self, metric: str, *, baseline: str) -> "Comparison":
        """Compare each controller with one, over the same seeds, scenarios and problems.

        Parameters
        ----------
        metric : str
            A column of :meth:`frame`, its unit may be left out: ``"rmse.angle"``.
        baseline : str
            The controller, by name or label.

        Returns
        -------
        table : Comparison
            A DataFrame, one row per problem and controller:
            see :func:`ddpc_cosim.study.verdicts.statistics.compare_frame`. It prints what is read first:
            difference, its interval, and whether the controller is better.

        Raises
        ------
        ConfigError
            There is no such metric or controller.
        """
        from ddpc_cosim.study.verdicts.comparison import Comparison
        from ddpc_cosim.study.verdicts.statistics import compare_frame

        chosen = keys_named(metric, dict.fromkeys(key for case in self.cases for key in case.metrics))
        names = {case.label: case.controller for case in self.cases}
        table = compare_frame(self.frame(), chosen[0], names.get(baseline, baseline))
        return Comparison.of(table, f"{chosen[0]}, less that of {baseline}: medians over the seeds")

    def findings(self) -> "dict[str, Findings]":
        """Return by problem who is ahead, how sure that is, whether it matters and who failed.

        Returns
        -------
        findings : dict of str to Findings
            See :class:`ddpc_cosim.study.verdicts.findings.Findings`: ``lead``, ``leaders``, ``is_sure``,
            ``failing``, ``remarks``, and ``standings`` with ranks and tests.
        """
        from ddpc_cosim.study.verdicts.findings import findings_of

        return {result.study.name: findings_of(result.study, result.cases) for result in self.problems()}

    def shares(self, metric: str = "") -> "pd.DataFrame":
        """Return how far each run comes on the way between the study's reference points.

        In pairs of the same problem, scenario, variant and seed, of a metric m::

            share = (m_zero - m) / (m_zero - m_full)

        with the controllers ``zero`` and ``full`` of the study's ``report.reference_points``: 0 is as good as
        the one, 1 as the other. It may be negative, or above 1.

        Parameters
        ----------
        metric : str
            The name of a metric, for all signals that have it: ``"rmse"``; or one signal's:
            ``"rmse.angle"``; a unit may follow. Empty: what each problem is ranked by, its own cost or mean
            absolute errors.

        Returns
        -------
        table : pandas.DataFrame
            One row per metric and case, without those of the reference points: what it was, ``metric``,
            its ``value``, those of the points, ``zero`` and ``full``, and the ``share``. A share is NaN of a
            run that ``failed``, and where there is no way to go: ``zero`` did not complete, ``full`` failed,
            or is not better by more than 1 % of ``zero``.

        Raises
        ------
        ConfigError
            The study names no reference points; there is no such metric, or no value of it is better.
        """
        from ddpc_cosim.study.verdicts.shares import share_frame

        return share_frame(self.whole, self.cases, metric)

    def requirements(self) -> "pd.DataFrame":
        """Return who meets what the study requires, and on how many of the seeds.

        Returns
        -------
        table : pandas.DataFrame
            One row per problem, controller, requirement and scenario: ``problem``, ``controller``, ``label``,
            ``metric`` (its key, as a column of :meth:`frame`), ``min`` and ``max`` in ``unit`` (infinite:
            none), ``scenario``, ``runs``, how many of them ``met`` it, ``share`` and what share is
            ``needed``, ``is_met``, and ``why`` others did not. Without requirements it has no rows.
        """
        from ddpc_cosim.study.verdicts.requirements import requirements_frame

        return requirements_frame(
            (result.study.name, result.study, result.cases) for result in self.problems()
        )

    def trace(
        self, controller: str, *, problem: str = "", scenario: str = "", seed: int | None = None
    ) -> Trace:
        """Read the samples of one run.

        Parameters
        ----------
        controller : str
            By name or label.
        problem, scenario : str
            Not needed where there is one.
        seed : int, optional
            Default: the first one.

        Raises
        ------
        ConfigError
            No run is such a one, or several are; or its files are damaged.
        """
        asked = {"problem": problem, "scenario": scenario, "seed": "" if seed is None else seed}
        of_controller = [case for case in self.cases if controller in (case.controller, case.label)]
        if not of_controller:
            known = dict.fromkeys(case.label for case in self.cases)
            raise ConfigError(f'no controller "{controller}"; {did_you_mean(controller, known)}')
        matches = [
            case
            for case in of_controller
            if all(value in ("", getattr(case, key)) for key, value in asked.items())
        ]
        words = ", ".join(f"{key} = {value}" for key, value in asked.items() if value != "")
        if not matches:
            there = ", ".join(case.id for case in of_controller[:_MOST_LISTED])
            raise ConfigError(f"{controller}: no run with {words}; there are {there}")
        for key in ("problem", "scenario"):
            several = dict.fromkeys(getattr(case, key) for case in matches)
            if len(several) > 1:
                raise ConfigError(f"{controller}: several {key}s: {', '.join(several)}; say which {key}")
        return matches[0].trace()

    def report(self, path: str | Path | None = None) -> Path:
        """Write the report, by default as ``report.html`` beside the results, and return its path.

        Raises
        ------
        ConfigError
            It cannot be written.
        """
        return write_report([self], self.folder / REPORT_FILE if path is None else Path(path))

    def plot(self, *controllers: str, problem: str = "", scenario: str = "") -> Picture:
        """Draw responses and control signals as the report does: the first seed, and bands over the seeds.

        Parameters
        ----------
        *controllers : str
            By names or labels; default: all.
        problem, scenario : str
            Not needed where there is one.

        Returns
        -------
        picture : Picture
            It shows itself in a notebook; ``save`` writes it as SVG, PDF or PNG.

        Raises
        ------
        ConfigError
            There is no such one, or several and none is said.
        """
        picture: Picture = drawn("of_results", self, controllers, problem=problem, scenario=scenario)
        return picture

    def plot_spread(
        self, metric: str = "", *controllers: str, problem: str = "", scenario: str = ""
    ) -> Picture:
        """Draw a metric over the seeds, a strip for each controller.

        Parameters
        ----------
        metric : str
            A column of :meth:`frame`, its unit may be left out; default: what the ranking is by.
        *controllers : str
            By names or labels; default: all.
        problem, scenario : str
            As in :meth:`plot`.

        Raises
        ------
        ConfigError
            There is no such one, or several and none is said; or no run has a value.
        """
        where = {"problem": problem, "scenario": scenario}
        picture: Picture = drawn("spread", self, metric, controllers, **where)
        return picture

    def ranking(self, *controllers: str, problem: str = "", scenario: str = "") -> Table:
        """Return the table of the report's first screen: ranks, what they are by, what else decides.

        It shows itself in a notebook; ``frame()`` makes a DataFrame of it. Parameters and errors are those of
        :meth:`plot`.
        """
        table: Table = drawn("ranking", self, controllers, problem=problem, scenario=scenario)
        return table

    def warnings(self) -> dict[tuple[str, str], tuple[CaseResult, ...]]:
        """Return the cases of every warning, by controller and text.

        Those of a controller that differ in numbers only are one, in the words of its first case.
        """
        words: dict[tuple[str, str], str] = {}
        grouped: dict[tuple[str, str], dict[str, CaseResult]] = {}
        for case in self.cases:
            for text in case.warnings:
                first = words.setdefault((case.controller, alike(text)), text)
                grouped.setdefault((case.controller, first), {})[case.id] = case
        return {key: tuple(cases.values()) for key, cases in grouped.items()}


def provenance_of(problem: str, key: str) -> str:
    """Return the key of what the provenance says of one problem among several."""
    return f"{problem}{_OF_PROBLEM}{key}"


def report_formats() -> list[str]:
    """Return the formats that reports are written in: the installed writers."""
    writers = (plugin.name for plugin in installed("reports") if callable(plugin.value))
    return [name for name in writers if name not in _NO_FORMATS]


def report_writer(form: str) -> Callable[[Sequence[StudyResults], Path], Path]:
    """Return the installed writer of a format.

    Raises
    ------
    ConfigError
        There is no such format.
    """
    if form != HTML and form not in (known := report_formats()):
        raise ConfigError(f'no report format "{form}"; {did_you_mean(form, known)}')
    writer: Callable[[Sequence[StudyResults], Path], Path] = load_plugin("reports", form)
    return writer


def write_report(results: Sequence[StudyResults], path: Path, form: str = HTML) -> Path:
    """Write a report on several studies in a format and return its path.

    Raises
    ------
    ConfigError
        There is no such format, or it cannot be written.
    """
    writer = report_writer(form)
    try:
        written = writer(results, path)
    except OSError as error:
        raise ConfigError(f"{path}: the report cannot be written: {error.strerror}") from error
    return written


def load_results(folder: str | Path) -> StudyResults:
    """Read a folder of results; cases that are damaged are left out, and named.

    Raises
    ------
    ConfigError
        The folder holds no results, or what all cases share cannot be read, and why.
    """
    folder = Path(folder)
    if not (folder / STUDY_FILE).is_file():
        raise ConfigError(f"{folder}: no results: {STUDY_FILE} is missing; give the folder that `run` wrote")
    if not (folder / PROVENANCE_FILE).exists() and not (folder / METRICS_FILE).exists():
        raise ConfigError(f"{folder}: no results yet: no run has ended; run the study again, which goes on")
    try:
        provenance = read_sealed(folder / PROVENANCE_FILE)
        case_ids = provenance.pop("cases")
        runs = tuple(map(dict, provenance.pop(_RUNS, ())))
        content = (folder / STUDY_FILE).read_bytes()
        if provenance[_STUDY_CHECKSUM] != checksum(content):
            raise ValueError(f"{STUDY_FILE} is not what was written: its checksum differs")
        study = _study(content)
    except DAMAGED as error:
        raise damaged_files(folder, error) from error
    _warn_of_conditions(study)
    return replace(load_cases(folder, study, case_ids).of(folder, study, provenance), runs=runs)


def _warn_of_conditions(study: "WholeStudy") -> None:
    """Say which conditions of a study are of packages that are not installed any more."""
    known = all_conditions()
    scenarios = [item for problem in study.problems.values() for item in problem.scenarios.items()]
    gone: dict[str, dict[str, None]] = {}
    for name, scenario in scenarios:
        for key in scenario.effects.keys() - known.keys():
            gone.setdefault(key, {})[name] = None
    for key, names in gone.items():
        whose = f"{'scenario' if len(names) == 1 else 'scenarios'} {', '.join(names)}"
        what = f"{whose}: the condition {key} is not installed here"
        warnings.warn(
            f"{what}; the runs are as they were, and what it did is shown by its name and values",
            CosimWarning,
            stacklevel=3,
        )


class Loaded(NamedTuple):
    """Cases that have been read: see :class:`StudyResults`."""

    cases: tuple[CaseResult, ...]
    resting: tuple[CaseResult, ...]
    damaged: dict[str, str]

    def of(self, folder: Path, study: "WholeStudy", provenance: dict[str, str]) -> StudyResults:
        """Return them as the results of a study."""
        return StudyResults(folder, study, self.cases, provenance, self.resting, self.damaged)


def load_cases(
    folder: Path, study: "WholeStudy", case_ids: Iterable[str], batched: Batched | None = None
) -> Loaded:
    """Return the cases of a study that are sound, judged, and by id what is wrong with the others.

    They are labelled as the study labels them now: a label does not decide a result. ``batched`` are the
    folder's batches, for whoever has read them; cases are taken out of them.
    """
    labels = {
        (problem, name): section.label or name
        for problem, flat in study.problems.items()
        for name, section in flat.controllers.items()
    }
    own = study.head.name  # the files of a flat study's cases do not name it
    cases, at_rest, damaged = dict[str, deque[CaseResult]](), deque[CaseResult](), {}
    batched = Batched(folder / CASES_FOLDER) if batched is None else batched
    alone = batched.alone()
    for case_id in case_ids:
        try:
            case = batched.take(case_id, alone)
        except ConfigError as error:
            damaged[case_id] = str(error)
            continue
        if case.controller == DOING_NOTHING:
            at_rest.append(case)
        else:
            cases.setdefault(case.problem or own, deque()).append(case)

    def label_of(case: CaseResult) -> str:
        return labels.get((case.problem or own, case.controller), case.label)

    def labelled(some: deque[CaseResult]) -> Iterator[CaseResult]:
        each = (some.popleft() for _ in range(len(some)))  # none is held twice
        return replaced((case, {"problem": case.problem or own, "label": label_of(case)}) for case in each)

    resting = {run_of(case): case for case in labelled(at_rest)}
    return Loaded(
        tuple(
            case
            for problem, problem_cases in cases.items()
            for case in judged(study.problems[problem].scenarios, labelled(problem_cases), resting)
        ),
        tuple(resting.values()),
        damaged,
    )


def claim_folder(folder: Path, study: "WholeStudy") -> None:
    """Have a folder hold the results of a study, from the beginning of its first run on.

    Of several processes that begin at the same time one is the first.

    Raises
    ------
    ConfigError
        It holds those of another study, which is one of another name that neither extends the other, nor both
        a third, or one with other plants only; or it cannot be written to.
    """
    path, study_tables = folder / STUDY_FILE, study.tables()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        remove_left_behind(folder, STAGING)
        if not path.exists():
            _write_first(path, study.toml())
        there = toml_tables(path.read_bytes().decode())
        others, names = _plants(there), {there.get("name", study_tables["name"]), *there.get("based_on", ())}
    except (ValueError, AttributeError, TypeError):  # damaged: whose it was is not known, and no case is lost
        return
    except OSError as error:
        raise ConfigError(f"{folder}: results cannot be written there: {error.strerror}") from error
    if names.isdisjoint({study_tables["name"], *study_tables["based_on"]}):
        other, this = (f'name = "{tables["name"]}"' for tables in (there, study_tables))
    elif others.isdisjoint(_plants(study_tables)) and any(others):
        other, this = (f"plant {', '.join(sorted(names))}" for names in (others, _plants(study_tables)))
    else:
        return
    raise ConfigError(
        f"{folder}: holds the results of another study ({other}; this one has {this}); "
        "give another folder (--out), or remove this one if it is not needed"
    )


def keep_logo(folder: Path, study: "WholeStudy") -> None:
    """Keep the logo of a study's report with its results, which may go elsewhere without it.

    Raises
    ------
    ConfigError
        There is no such file, it is too large, or the folder cannot be written to.
    """
    logo = next((problem.report.logo for problem in study.problems.values() if problem.report.logo), "")
    if not logo:
        return
    try:
        content = Path(logo).read_bytes()
    except OSError as error:
        if logo_of(folder):  # from an earlier run
            return
        raise ConfigError(f"report.logo: {logo}: cannot be read: {error.strerror}") from error
    if len(content) > _LARGEST_LOGO:
        size = f"{len(content) / 1000:.0f} kB; allowed: {_LARGEST_LOGO // 1000} kB"
        raise ConfigError(f"report.logo: {logo}: {size}, as it is in every page")
    try:
        write_atomically(folder / f"{_LOGO}{Path(logo).suffix.lower()}", content)
    except OSError as error:
        raise ConfigError(f"{folder}: results cannot be written there: {error.strerror}") from error


def logo_of(folder: Path) -> Path | None:
    """Return the logo that lies with results, if there is one."""
    return next((file for suffix in LOGOS if (file := folder / f"{_LOGO}{suffix}").is_file()), None)


def _write_first(path: Path, content: bytes) -> None:
    """Write a file unless another process is quicker."""
    with ScratchFolder(path.parent, STAGING) as staging:
        staged = staging / path.name
        staged.write_bytes(content)
        write_through(staged)
        try:
            os.link(staged, path)  # which fails where the file exists
        except FileExistsError:
            return
        except OSError:  # not every file system has links
            staged.replace(path)


def _plants(tables: dict[str, Any]) -> set[str]:
    """Return names of plants, and of the files of FMUs, which may have been moved."""
    problems = tables["problems"].values() if "problems" in tables else [tables]
    plants = [problem.get("plant", {}) for problem in problems]
    return {plant.get("name") or Path(plant.get("fmu", "")).name for plant in plants}


def _study(content: bytes) -> "WholeStudy":
    from ddpc_cosim.study.problems import WholeStudy  # a worker, which writes cases, does without

    return WholeStudy.of_tables(toml_tables(content.decode()))


def write_results(results: StudyResults, whole: Sequence[str] | None = None) -> StudyResults:
    """Write ``study.toml``, ``metrics.csv`` and ``provenance.json`` next to the cases.

    Parameters
    ----------
    results : StudyResults
        The results; their runs are those that the folder does not tell of yet.
    whole : sequence of str, optional
        The ids of all cases of the study, where the results are of some that were run apart from the others:
        then ``metrics.csv`` is left to who has them all.

    Returns
    -------
    results : StudyResults
        The results as they are read back.

    Raises
    ------
    CosimError
        They cannot be written, and why.
    """
    folder, content = results.folder, results.whole.toml()
    provenance = {**results.provenance, _STUDY_CHECKSUM: checksum(content)}
    runs = (*_earlier_runs(folder), *results.runs)
    results = replace(results, whole=_study(content), provenance=provenance, runs=runs)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with held():  # one has the other's checksum
            write_atomically(folder / STUDY_FILE, content)
            facts = {**provenance, _RUNS: runs, "cases": _ids(results) if whole is None else [*whole]}
            write_atomically(folder / PROVENANCE_FILE, sealed_parts(facts))
            del facts  # the ids, which may be many
        if whole is None:
            write_metrics(results)
    except OSError as error:
        reason = error.strerror or str(error)
        raise CosimError(f"{folder}: results cannot be written: {reason}; finished cases are kept") from error
    return results


def _ids(results: StudyResults) -> list[str]:
    """Return the ids of all cases, those included that are damaged."""
    return [*(case.id for case in chain(results.cases, results.resting)), *results.damaged]


def _earlier_runs(folder: Path) -> tuple[dict[str, str], ...]:
    """Return what a folder tells of its runs; nothing if that is not what was written."""
    try:
        return tuple(map(dict, read_sealed(folder / PROVENANCE_FILE).get(_RUNS, ())))
    except DAMAGED:
        return ()


def write_metrics(results: StudyResults) -> None:
    """Write ``metrics.csv`` from the cases, whatever it holds; of batches as Parquet too, if that is there.

    Raises
    ------
    OSError
        It cannot be written.
    """
    parts = table_parts(*metrics_table(results))
    write_atomically(results.folder / METRICS_FILE, (encodable(part).encode() for part in parts))
    if any(case.batched for case in results.cases):
        with suppress(MissingLibraryError):
            _write_parquet(results.folder / METRICS_PARQUET, *metrics_table(results))


def _write_parquet(path: Path, header: Sequence[str], rows: Iterator[Sequence[Any]]) -> None:
    """Write the table of metrics with columns of text and of numbers: what is not there is NaN."""

    def parts() -> Iterator[tuple[dict[str, FloatArray], dict[str, list[str]]]]:
        while part := [*islice(rows, _ROWS_AT_ONCE)]:
            columns = dict(zip(header, zip(*part, strict=True), strict=True))
            texts = {name: [*map(str, columns.pop(name))] for name in _TEXTS if name in columns}
            numbers = {
                name: np.array([math.nan if value == "" else value for value in column], dtype=np.float64)
                for name, column in columns.items()
            }
            yield numbers, texts

    load_pyarrow()
    with ScratchFolder(path.parent, STAGING) as staging:
        write_parquet(staging / path.name, parts())
        (staging / path.name).replace(path)


def metrics_table(results: StudyResults) -> tuple[list[str], Iterator[list[Any]]]:
    """Return header and rows of ``metrics.csv``."""
    study, cases = results.whole, results.cases
    keys = list(dict.fromkeys(key for case in cases for key in case.metrics))
    parameters = list(dict.fromkeys(name for case in cases for name in case.drawn))
    has_variants = any(problem.variant_of for problem in study.problems.values())
    header = ["study", "problem", *["variant"] * has_variants, "plant", "controller", "scenario"]
    header += ["seed", "outcome", "failed", "settles"]
    header += [printable(f"{_PARAMETER} {name}") for name in parameters]
    header += map(printable, keys)

    def rows() -> Iterator[list[Any]]:
        for case in cases:
            problem, metrics, drawn = study.problems[case.problem], case.metrics, case.drawn
            yield [
                study.head.name,
                problem.variant_of or case.problem,
                *[variant_words(problem.varied)] * has_variants,
                problem.plant.label,
                case.controller,
                case.scenario,
                case.seed,
                case.outcome,
                case.failed,
                "" if case.settles is None else case.settles,
                *(drawn.get(name, "") for name in parameters),
                *(metrics.get(key, math.nan) for key in keys),
            ]

    return header, rows()
