"""Over all problems: how far controllers come between the reference points, where, and what they need."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import cast

from markupsafe import Markup

from ddpc_cosim import StudyResults
from ddpc_cosim.files.tables import Heading, Table
from ddpc_cosim.metrics import headline, metric_name, split_key
from ddpc_cosim.study.file_format.sections import ReferencePoints
from ddpc_cosim.study.verdicts.sentences import italic, join_words, some_of
from ddpc_cosim.study.verdicts.shares import describe_shares, floored, run_once, share_runs, shares_of
from ddpc_cosim.study.verdicts.statistics import Runs, Sample, compare_all, describe
from ddpc_reports.comparison import ControllerResults
from ddpc_reports.numbers import duration, significant, time_scale
from ddpc_reports.shares import (
    SHARE,
    SHARE_NOTE,
    failed_mostly,
    interval_words,
    point_cell,
    share_cell,
    share_interval,
    share_words,
)
from ddpc_reports.tables.table import Column, controller_table, number_cells
from ddpc_reports.verdict import Statement, by_signal, counted, names

_NAMED = 3
_STEP, _TRAVEL = "solve_time_median [s]", "total_variation"


@dataclass(frozen=True)
class Distances:
    """How far controllers come on the way between the reference points, and what they need for it.

    Parameters
    ----------
    controllers : list of ControllerResults
        Those that compete, the best rank first, and the reference points.
    overall : dict of str to Sample
        By controller, over the medians of the problems; of those with shares wherever there is a way to go.
    problems, scenarios : dict of str to dict
        By name the same of one problem, over its seeds, and of one scenario, over the problems.
    ahead : dict of str to list of str
        By problem the controller with the largest median, and those that the seeds do not show to be behind.
    without : list of str
        Problems in which there is no way to go.
    step, recorded, travel : dict of str to float
        By controller, in medians over the problems: the median step [s], the samples that it learned from,
        and the actuators' travel in that of the controller at 100 %.
    metrics : list of str
        The names of the metrics whose shares these are.
    """

    controllers: list[ControllerResults]
    overall: dict[str, Sample]
    problems: dict[str, dict[str, Sample]]
    scenarios: dict[str, dict[str, Sample]]
    ahead: dict[str, list[str]]
    without: list[str]
    step: dict[str, float]
    recorded: dict[str, float]
    travel: dict[str, float]
    metrics: list[str]


def distances(problems: Sequence[StudyResults], controllers: list[ControllerResults]) -> Distances | None:
    """Return how far controllers come in each problem and over all; None without reference points."""
    runs: dict[str, dict[str, Runs]] = {}
    metrics: dict[str, None] = {}
    needs: dict[str, list[dict[str, float]]] = {"step": [], "recorded": [], "travel": []}
    for results in problems:
        if points := results.study.report.reference_points:
            keys = dict.fromkeys(key for case in results.cases for key in case.metrics)
            ranked = headline(keys, results.study.metrics.ranking)
            metrics |= dict.fromkeys(metric_name(key, keys) for key in ranked)
            runs[results.study.name] = shares_of(results.cases, points, ranked, run_once(results.study))
            for kind, medians in _needs(results, points, keys).items():
                needs[kind].append(medians)
    if not runs:
        return None
    by_problem = {name: _described(of_problem) for name, of_problem in runs.items()}
    names = dict.fromkeys(scenario for results in problems for scenario in results.study.scenarios)
    scenarios = {name: _over([_part(of_problem, name) for of_problem in runs.values()]) for name in names}
    return Distances(
        controllers,
        _over(by_problem.values()),
        by_problem,
        {name: samples for name, samples in scenarios.items() if samples},
        {name: _ahead(of_problem) for name, of_problem in runs.items() if of_problem},
        [name for name, of_problem in runs.items() if not of_problem],
        **{kind: _medians(of_problems) for kind, of_problems in needs.items()},
        metrics=[*metrics],
    )


def _part(runs: Mapping[str, Runs], scenario: str) -> dict[str, Sample]:
    """Sum up the runs of one scenario of a problem."""
    parts = {
        name: {run: share for run, share in shares.items() if cast("tuple[str, str]", run[0])[0] == scenario}
        for name, shares in runs.items()
    }
    return _described({name: shares for name, shares in parts.items() if shares})


def _described(runs: Mapping[str, Runs]) -> dict[str, Sample]:
    return {name: describe_shares(shares) for name, shares in runs.items()}


def _over(problems: Iterable[Mapping[str, Sample]]) -> dict[str, Sample]:
    """Sum up the medians of problems, each as one value, of the controllers that are in all with any."""
    tables = [table for table in problems if table]
    names = [name for name in (tables[0] if tables else ()) if all(name in table for table in tables)]
    samples_by_name = {name: [table[name] for table in tables] for name in names}
    return {
        name: describe({("", number): sample.median for number, sample in enumerate(samples)})._replace(
            known=sum(not failed_mostly(sample) for sample in samples)
        )
        for name, samples in samples_by_name.items()
    }


def _ahead(runs: Mapping[str, Runs]) -> list[str]:
    compared = compare_all({name: floored(shares) for name, shares in runs.items()}, "high")
    first, pairs = compared.order[0], compared.differences.items()
    others = [(b, difference) for (a, b), difference in pairs if a == first]
    return [first, *(b for b, behind in others if behind.told_worse or not behind.told_apart)]


def _needs(
    results: StudyResults, points: ReferencePoints, keys: Iterable[str]
) -> dict[str, dict[str, float]]:
    """Return what each controller needs in one problem, in medians over its runs."""
    figures: dict[str, dict[str, list[float]]] = {"step": {}, "recorded": {}, "travel": {}}
    for case in results.cases:
        figures["recorded"].setdefault(case.controller, []).append(case.recorded_samples)
        if not math.isnan(step := case.metrics.get(_STEP, math.nan)):
            figures["step"].setdefault(case.controller, []).append(step)
    travels = [key for key in keys if split_key(key)[0] == _TRAVEL]
    for run in share_runs(results.cases, points, travels, run_once(results.study)):
        if run.full > 0 and not run.case.failed:
            ratio = run.case.metrics[run.metric] / run.full
            figures["travel"].setdefault(run.case.controller, []).append(ratio)
    return {kind: {name: median(values) for name, values in of.items()} for kind, of in figures.items()}


def _medians(tables: Sequence[Mapping[str, float]]) -> dict[str, float]:
    names = dict.fromkeys(name for table in tables for name in table)
    return {name: median(table[name] for table in tables if name in table) for name in names}


def distance_statements(far: Distances, first: Iterable[str]) -> list[Statement]:
    """Say how far the controllers come, which is ahead in which problem, and what the first ones need.

    Parameters
    ----------
    far : Distances
        What is said.
    first : iterable of str
        The controller with the best rank, and those that the problems do not tell apart from it.
    """
    known = [controller for controller in far.controllers if controller.key in far.overall]
    if not far.ahead:
        none = Markup("There is no way to go between the reference points in any problem: no shares.")
        return [Statement("Distance", none)]
    order = sorted(known, key=lambda controller: -far.overall[controller.key].median)
    parts = [italic(controller.label) + " " + _reach(far, controller.key) for controller in order[:_NAMED]]
    if more := order[_NAMED:]:
        words = share_words(far.overall[more[-1].key])
        parts.append(Markup("{} more, the last, <i>{}</i>, {}").format(len(more), more[-1].label, words))
    points = [controller for controller in far.controllers if controller.is_point]
    text = Markup("Of the way between {}, which do not compete, in the median of {}: {}.").format(
        join_words(names(points)),
        counted(len(far.ahead), "problem"),
        Markup("; ").join(parts or ["no controller ran in each"]),
    )
    if far.without:
        text += Markup(" In {} there is no way to go.").format(join_words(far.without))
    by_key = {controller.key: controller for controller in far.controllers}
    where = [(name, _ahead_words(far, name, by_key)) for name in far.ahead]
    each = [italic(by_key[key].label) + f" {_needs_words(far, key)}" for key in first]
    needs = Markup("; ").join(
        [*each[:_NAMED], *([f"{len(each) - _NAMED} more below"] if each[_NAMED:] else [])]
    )
    return [
        Statement("Distance", text),
        Statement("Which where", by_signal(where)),
        Statement("Needs", needs + "."),
    ]


def _reach(far: Distances, key: str) -> Markup:
    """Write a share over the problems, with its interval, and the least and the most of a problem."""
    samples = {name: of_problem[key] for name, of_problem in far.problems.items() if key in of_problem}
    least, most = (end(samples, key=lambda name: samples[name].median) for end in (min, max))
    sample, low, high = far.overall[key], share_words(samples[least]), share_words(samples[most])
    ends = f" (from {low} in {least} to {high} in {most})" if low != high else ""
    return Markup("{}{}{}").format(share_words(sample), interval_words(sample), ends)


def _ahead_words(far: Distances, problem: str, by_key: Mapping[str, ControllerResults]) -> Markup:
    first, *alike = [by_key[key] for key in far.ahead[problem] if key in by_key]
    if failed_mostly(far.problems[problem][first.key]):
        return Markup("at least half of the runs of every controller failed.")
    text = italic(first.label) + f" {share_words(far.problems[problem][first.key])}"
    if alike:
        text += Markup(", which the seeds do not show to be ahead of {}").format(some_of(names(alike)))
    return text + "."


def _needs_words(far: Distances, key: str) -> str:
    recorded = far.recorded.get(key, 0)
    words = [
        f"a {metric_name(_STEP)} of {duration(far.step.get(key, math.nan))}",
        f"a recording of {counted(recorded, 'sample')}" if recorded else "no recording",
    ]
    if key in far.travel:
        words.append(f"{significant(far.travel[key], 2)} times the {metric_name(_TRAVEL)} at 100\u00a0%")
    return ", ".join(words)


def distance_columns(far: Distances, rows: Sequence[ControllerResults]) -> list[Column]:
    """Return shares over the problems and what they need; the reference points have their ends."""
    samples = [far.overall.get(controller.key) for controller in rows]
    by_controller = [
        [of_problem[controller.key] for of_problem in far.problems.values() if controller.key in of_problem]
        for controller in rows
    ]
    ends = [sorted(shares, key=lambda sample: sample.median) for shares in by_controller]
    step, recorded, travel = (
        [figures.get(controller.key, math.nan) for controller in rows]
        for figures in (far.step, far.recorded, far.travel)
    )
    unit, factor = time_scale(step)
    medians = [
        point_cell(controller) or share_cell(sample) for controller, sample in zip(rows, samples, strict=True)
    ]
    return [
        (Heading("median", "%", group=SHARE), medians),
        (Heading("interval", "%", group=SHARE), [share_interval(sample) for sample in samples]),
        (Heading("least", "%", group=SHARE), [share_cell(shares[0] if shares else None) for shares in ends]),
        (Heading("most", "%", group=SHARE), [share_cell(shares[-1] if shares else None) for shares in ends]),
        (
            Heading(metric_name(_STEP), unit, group="needs"),
            number_cells([t * factor for t in step], digits=3),
        ),
        (Heading("recording", "samples", group="needs"), number_cells(recorded)),
        (
            Heading(metric_name(_TRAVEL), "of that at 100\u00a0%", group="needs"),
            number_cells(travel, digits=2),
        ),
    ]


def distance_maps(far: Distances, prefix: str) -> list[Table]:
    """Return which controller comes how far in which problem, and in which scenario."""
    marked = {
        problem: [] if 2 * len(keys) > len(far.problems[problem]) else keys
        for problem, keys in far.ahead.items()
    }
    bold = (
        "Bold: the largest median of a problem, and those that the seeds do not show to be behind it "
        "(one step-down sign-flip max-T test of all pairs); none, where that is most."
        " A star: some runs failed."
    )
    over = (
        "Medians of the problems' medians, of those with a way to go. A star: in some problems at least "
        "half of the runs failed."
    )
    maps = [
        _map(f"{prefix}by-problem", "Which method where", far.controllers, far.problems, marked, bold),
        _map(f"{prefix}by-scenario", "Which method when", far.controllers, far.scenarios, {}, over),
    ]
    return [table for table in maps if len(table.headings) > 2]


def _map(
    identifier: str,
    caption: str,
    controllers: Sequence[ControllerResults],
    columns: Mapping[str, Mapping[str, Sample]],
    marked: Mapping[str, Sequence[str]],
    note: str,
) -> Table:
    known = {key for of_column in columns.values() for key in of_column}
    rows = [controller for controller in controllers if controller.key in known]
    keys = [controller.key for controller in rows]
    shown = [
        (
            Heading(title),
            [share_cell(of_column.get(key), key in marked.get(title, ()), star=True) for key in keys],
        )
        for title, of_column in columns.items()
        if of_column
    ]
    what = f"{caption}: share of the way, %"
    return controller_table(
        identifier, what, rows, shown, (note, SHARE_NOTE), f"{caption.lower().replace(' ', '-')}.csv"
    )
