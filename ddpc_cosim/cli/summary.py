"""The result table that ``run`` prints: who is ahead, told in the columns that fit; the others are named."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from rich.console import Console, Group, RenderableType
from rich.text import Text

from ddpc_cosim.cli.output import clipped, fitting, wrapped
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.tables import Cell, Heading, Row, Table
from ddpc_cosim.files.texts import printable
from ddpc_cosim.metrics import all_metrics, headline, metric_name, metric_of, split_key
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.results import METRICS_FILE, StudyResults
from ddpc_cosim.study.verdicts.baselines import against, with_baseline
from ddpc_cosim.study.verdicts.findings import Findings, Lead, findings_of, overall_findings
from ddpc_cosim.study.verdicts.judgement import set_aside
from ddpc_cosim.study.verdicts.reliability import failure_rate, is_asked
from ddpc_cosim.study.verdicts.sentences import (
    best_rank_clause,
    beyond_log_clause,
    knowing_clause,
    lead_clause,
    ranks_differ_clause,
    rate_words,
    too_few_seeds_clause,
)
from ddpc_cosim.study.verdicts.shares import marked
from ddpc_cosim.study.verdicts.standings import Standings, known_values, summed

_STEP = "solve_time_median [s]"
_RANGE = "range"
_VARIANTS_SHOWN = 2
_NAME_PART = 0.4
"""Part of the window that names may take."""
_SHORTEST_NAME = 10
_LONGEST_LABEL, _LONGEST_TITLE = 30, 200
_MISSING = "-"


@dataclass(frozen=True)
class _Row:
    """A controller, or a variant of one; without cases, a note on settings that are not listed.

    Without a rank, none is shown; it is empty where nothing is ranked.
    """

    name: str
    cases: Sequence[CaseResult] = ()
    rank: str | None = None
    leads: bool = False

    @property
    def failed(self) -> int:
        """How many of its runs failed."""
        return sum(case.failed for case in self.cases)


@dataclass(frozen=True)
class _Column:
    """A column: its heading, what is missing where it is left out, and what stands in a row."""

    heading: Heading
    words: str
    key: str
    cell: Callable[[Sequence[CaseResult]], Cell]


def summary_table(
    results: StudyResults, console: Console, findings: Findings | None = None
) -> RenderableType:
    """Return the controllers of one problem, the best first; of sweeps the best settings below their own.

    Of one scenario there is a column per metric, of several a column per scenario. Those that do not fit the
    console are named below. ``findings`` is what the results show, where the caller knows it.
    """
    findings = findings or findings_of(results.study, results.cases)
    keys = tuple(dict.fromkeys(key for case in results.cases for key in case.metrics))
    scenarios = tuple(dict.fromkeys(case.scenario for case in results.cases))
    rows = _rows(results, findings)
    columns = _metric_columns(results, keys) if len(scenarios) < 2 else _scenario_columns(results, keys)
    columns = [column for column in columns if column.words != _RANGE or _has_values(column, rows)]
    columns[len(_headline(results, keys)) :] = [
        *_baseline_columns(results, findings),
        *columns[len(_headline(results, keys)) :],
    ]
    lines = _lines(results, findings, rows)
    further: list[str] = []
    if len(scenarios) > 1:
        of_metrics, ranked = _metric_columns(results, keys), _headline(results, keys)
        further = [column.heading.title for column in of_metrics if column.key not in ranked]
    where = f": {results.folder / METRICS_FILE}"
    return _set(_title(results), rows, columns, lines, console, further=further, where=where)


def _set(
    title: str,
    rows: Sequence[_Row],
    columns: Sequence[_Column],
    lines: Sequence[str],
    console: Console,
    *,
    further: Sequence[str] = (),
    where: str = "",
) -> RenderableType:
    """Return a table below its title, and above lines in which no word is broken."""
    longest = max(int(_NAME_PART * console.width), _SHORTEST_NAME)
    table = _table(rows, columns, longest)
    given = len(table.headings) - len(columns)
    shown, others = fitting(console, table, longest, fewest=given + 1)
    left_out = dict.fromkeys([*(columns[i - given].words for i in others), *further])
    if left_out:
        lines = [*lines, f"not shown: {'; '.join(left_out)}{where}"]
    if any(not row.cases for row in rows):
        lines = [*lines, f"every setting{where}"]
    below = [line for text in lines for line in wrapped(printable(text), console.width)]
    return Group(Text(title, style="bold"), shown, *(Text(line, overflow="ignore") for line in below))


def overall_table(problems: Sequence[StudyResults], console: Console) -> RenderableType | None:
    """Return the controllers over all problems by average rank; None where fewer than two can be compared."""
    try:
        findings = overall_findings((problem.study, problem.cases) for problem in problems)
    except ConfigError:  # no run is shared by all
        return None
    if findings is None:
        return None
    ranks, cases = findings.ranks, findings.cases
    rows = [_Row(cases[name][0].label, cases[name]) for name in ranks.ranks]
    average = _Column(
        Heading("average rank"), "", "", lambda cases: Cell(f"{ranks.ranks[cases[0].controller]:.3g}")
    )
    of_problems = zip(problems, findings.standings, strict=True)
    columns = [
        average,
        *(_problem_column(problem.study.name, ranking) for problem, ranking in of_problems if ranking.order),
    ]
    labels = {name: results[0].label for name, results in cases.items()}
    differ = ranks_differ_clause(ranks, lambda rank: f"{rank:.2g}")
    lines = [
        f"ranks in {ranks.problems} problems, and their average: {differ}",
        best_rank_clause(ranks, labels).striptags(),
    ]
    return _set("All problems", rows, columns, lines, console)


def _problem_column(name: str, of_problem: Standings) -> _Column:
    ranks = {rank.controller: rank for rank in of_problem.order}

    def cell(cases: Sequence[CaseResult]) -> Cell:
        rank = ranks.get(cases[0].controller)
        return Cell(_rank_words(rank.text) or _MISSING, failed=rank.failed > 0) if rank else Cell(_MISSING)

    label = clipped(name, _LONGEST_LABEL)
    return _Column(Heading(label), label, "", cell)


def _rank_words(text: str) -> str:
    """Return ranks as every terminal can show them."""
    return text.replace("\N{EN DASH}", "-")


def _has_values(column: _Column, rows: Sequence[_Row]) -> bool:
    return any(column.cell(row.cases).text != _MISSING for row in rows)


def _table(rows: Sequence[_Row], columns: Sequence[_Column], longest: int) -> Table:
    headings = (Heading("rank"), Heading("controller", numeric=False), Heading("failed", "runs"))
    any_failed = any(row.failed for row in rows)
    return Table(
        "",
        "",
        (*headings, *(column.heading for column in columns)),
        tuple(
            Row(
                row.rank or "",
                (
                    Cell(clipped(row.name, longest), best=row.leads),
                    Cell(f"{row.failed}/{len(row.cases)}" * any_failed, failed=row.failed > 0),
                    *(column.cell(row.cases) for column in columns),
                ),
            )
            if row.cases
            else Row("", (Cell(row.name),))
            for row in rows
        ),
    )


def _metric_columns(results: StudyResults, keys: Sequence[str]) -> list[_Column]:
    """Return the columns of one scenario, the most informative first."""
    ranked = _headline(results, keys)
    names = [name for name, metric in all_metrics().items() if "terminal" in metric.shown]
    others = [key for name in names for key in keys if split_key(key)[0] == name and key not in ranked]
    several = len({case.seed for case in results.cases}) > 1
    spreads = [
        _Column(Heading(_RANGE, _detail(key)), _RANGE, "", partial(_range, key=key))
        for key in ranked
        if several
    ]
    columns, more = ([_metric_column(key, keys) for key in of_them] for of_them in (ranked, [*others, _STEP]))
    # With several outputs the ranges would leave no room for anything else.
    return [*columns, *spreads, *more] if len(ranked) == 1 else [*columns, *more, *spreads]


def _baseline_columns(results: StudyResults, findings: Findings) -> list[_Column]:
    """Return by how much each differs from the study's baseline, a column for each ranked metric."""
    baseline = results.study.report.baseline
    if not baseline:
        return []
    ranking = with_baseline(findings.standings, results.cases, baseline)
    labels = {case.controller: case.label for case in results.cases}
    label = clipped(labels.get(baseline, baseline), _LONGEST_LABEL)

    def cell(cases: Sequence[CaseResult], key: str) -> Cell:
        controller = cases[0].controller
        comparison = against(ranking, key, baseline, controller)
        if controller == baseline or comparison is None or math.isnan(comparison.difference.median):
            return Cell("baseline" if controller == baseline else _MISSING)
        size = f"{comparison.percent:+.3g} %"
        if math.isnan(comparison.percent):
            size = f"{comparison.difference.median:+.3g} {split_key(key)[2]}".removesuffix(" 1")
        return Cell(f"{size} {comparison.word}".replace("\u00a0", " "))

    words = f"against {label}"
    several = len(ranking.keys) > 1
    return [
        _Column(Heading(words, _detail(key) if several else ""), words, "", partial(cell, key=key))
        for key in ranking.keys
    ]


def _headline(results: StudyResults, keys: Sequence[str]) -> tuple[str, ...]:
    return headline(keys, results.study.metrics.ranking)


def _metric_column(key: str, keys: Sequence[str]) -> _Column:
    """Return the column of a metric, one of several."""

    def cell(cases: Sequence[CaseResult]) -> Cell:
        value = summed(cases, key)
        failed = any(case.failed for case in cases)
        return Cell(_micro(value) if key == _STEP else _number(value), failed=failed)

    heading = Heading(metric_name(key, keys), "" if key == _STEP else _detail(key))
    return _Column(heading, _words(key, keys), key, cell)


def _scenario_columns(results: StudyResults, keys: Sequence[str]) -> list[_Column]:
    """Return a column for each scenario, and for each output if there are several."""
    ranked = _headline(results, keys)
    return [
        _scenario_column(results, name, key, _detail(key) if len(ranked) > 1 else "")
        for name in dict.fromkeys(case.scenario for case in results.cases)
        for key in ranked
    ]


def _scenario_column(results: StudyResults, name: str, key: str, detail: str) -> _Column:
    def cell(cases: Sequence[CaseResult]) -> Cell:
        of_scenario = [case for case in cases if case.scenario == name]
        failed = sum(case.failed for case in of_scenario)
        if of_scenario and failed == len(of_scenario):
            return Cell("failed", failed=True)
        return Cell(_number(summed(of_scenario, key), 3) + "*" * (failed > 0), failed=failed > 0)

    label = _scenario_label(results, name)
    words = " ".join(filter(None, (label, detail.partition(" [")[0])))
    return _Column(Heading(label, detail), words, key, cell)


def _scenario_label(results: StudyResults, name: str) -> str:
    section = results.study.scenarios.get(name)
    return clipped((section.label if section else "") or name, _LONGEST_LABEL)


def _words(key: str, keys: Sequence[str]) -> str:
    return printable(" of ".join(filter(None, (metric_name(key, keys), split_key(key)[1]))))


def _detail(key: str) -> str:
    """Return signal and unit of a metric."""
    _, signal, unit = split_key(key)
    return printable(" ".join(filter(None, (signal, f"[{unit}]" if unit != "1" or signal else ""))))


def _title(results: StudyResults) -> str:
    seeds = list(dict.fromkeys(case.seed for case in results.cases))
    over = f"{len(seeds)} seeds" if len(seeds) > 1 else f"seed {seeds[0]}"
    return f"{clipped(results.study.title or results.study.name, _LONGEST_TITLE)} ({over})"


def _lines(results: StudyResults, findings: Findings, rows: Sequence[_Row]) -> list[str]:
    """Return the lines below the table."""
    lines, ranking = [], findings.standings
    every = tuple(dict.fromkeys(key for case in results.cases for key in case.metrics))
    keys = _headline(results, every)
    what = dict.fromkeys(
        f"{_words(key, every)} [{split_key(key)[2]}]" if len(keys) == 1 else metric_name(key, every)
        for key in keys
    )
    several = len({case.seed for case in results.cases}) > 1
    how = "what the seeds tell apart" if ranking.tested else "the medians" if several else "this value"
    values = ["medians"] * several + ([f"ranked by {how}"] if ranking.is_ranked else [])
    if what:
        lines.append(": ".join(filter(None, (", ".join(what), "; ".join(values)))))
    if findings.lead not in (Lead.NOBODY, Lead.ONLY_ONE):
        names = {row.cases[0].controller: _in_a_sentence(row.name) for row in rows if row.cases}
        scenarios = {case.scenario: _scenario_label(results, case.scenario) for case in results.cases}
        if worth := knowing_clause(findings.knowing, names, scenarios):
            lines.append(worth.striptags())
        lines.append(lead_clause(findings, names, scenarios).striptags())
    if ranking.seeds > 1 and (few := too_few_seeds_clause(ranking.compared.values())):
        lines.append(few)
    if line := _failures_line(results, rows):
        lines.append(line)
    if beyond := beyond_log_clause(results.cases):
        lines.append(beyond.striptags())
    if findings.requirements:
        lines += findings.requirements.lines
    if any(0 < row.failed < len(row.cases) for row in rows) and len({c.scenario for c in results.cases}) > 1:
        lines.append("* of the other runs: some failed")
    return lines


def _failures_line(results: StudyResults, rows: Sequence[_Row]) -> str:
    """Say how often each controller fails, by what so many seeds tell; empty where it is not asked."""
    aside = set_aside(results.study)
    who = [row for row in rows if row.cases and row.cases[0].controller not in aside]
    if not who or not is_asked(results.cases):
        return ""
    several = len({case.scenario for case in results.cases}) > 1
    within = " in a scenario" if several else ""
    rates = "; ".join(f"{_in_a_sentence(row.name)} on {rate_words(failure_rate(row.cases))}" for row in who)
    return f"fails{within}, with the 95 % interval of how often: {rates}".replace("\u00a0", " ")


def _in_a_sentence(label: str) -> str:
    """Return a label among others, in quotes where it holds a comma itself."""
    text = clipped(label.strip(), _LONGEST_LABEL)
    return f'"{text}"' if "," in text else text


def _rows(results: StudyResults, findings: Findings) -> list[_Row]:
    """Return the rows in the order of the standings, after each controller the best of its sweeps."""
    ranking = findings.standings
    groups: dict[str, list[CaseResult]] = {}
    for case in results.cases:
        groups.setdefault(case.controller, []).append(case)
    sections, points = results.study.controllers, results.study.report.reference_points
    key = next(iter(ranking.keys), "")
    base = {name: sections[name].variant_of or name for name in groups}
    labels = [cases[0].label for cases in groups.values()]
    standing = {place.controller: place for place in ranking.order}
    rows = []

    def rank(name: str) -> str | None:
        if not (ranking.order or ranking.left_out):  # none competes
            return None
        return _rank_words(standing[name].text) if name in standing else _MISSING if ranking.is_ranked else ""

    for family in dict.fromkeys([*(place.controller for place in ranking.order), *base.values()]):
        unvaried = groups.get(family, [])
        if unvaried:
            label = unvaried[0].label
            label += f" ({family})" if labels.count(label) > 1 else ""
            leads = findings.is_sure and family in findings.leaders
            rows.append(_Row(marked(label, family, points), unvaried, rank(family), leads))
        variants = [groups[name] for name in groups if base[name] == family != name]
        variants.sort(key=lambda cases: _place(cases, key))
        shown = variants[:_VARIANTS_SHOWN]
        rows += [_Row(_indented(cases, unvaried), cases, rank(cases[0].controller)) for cases in shown]
        rest = len(variants) - _VARIANTS_SHOWN
        if rest > 0:
            rows.append(_Row(f"  and {rest} {'setting' if rest == 1 else 'settings'} more"))
    return rows


def _indented(variant: Sequence[CaseResult], unvaried: Sequence[CaseResult]) -> str:
    """Return the label of a variant; below its controller, whose name it begins with, only what differs."""
    label = variant[0].label
    return "  " + label.removeprefix(f"{unvaried[0].label}, ") if unvaried else label


def _place(cases: Sequence[CaseResult], key: str) -> tuple[int, float]:
    """Order by failed runs, then by the value of a metric, the best first."""
    value = summed(cases, key) if key else math.nan
    return sum(case.failed for case in cases), math.inf if math.isnan(value) else metric_of(key).rank(value)


def _range(cases: Sequence[CaseResult], key: str) -> Cell:
    values = known_values(cases, key)
    if len(values) < 2 or math.isclose(min(values), max(values), rel_tol=1e-9):
        return Cell(_MISSING)
    return Cell(f"{_number(min(values))} .. {_number(max(values))}")


def _number(value: float, digits: int = 4) -> str:
    return _MISSING if math.isnan(value) else f"{value:.{digits}g}"


def _micro(seconds: float) -> str:
    return _MISSING if math.isnan(seconds) else f"{1e6 * seconds:.{0 if seconds >= 1e-6 else 2}f} us"
