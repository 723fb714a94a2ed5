"""The result table that ``run`` prints: short enough to be read at once, also after a sweep."""

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from statistics import median

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from ddpc_cosim.metrics import all_metrics, headline, metric_name, metric_of, split_key
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.following import none_follows
from ddpc_cosim.study.results import METRICS_FILE, StudyResults
from ddpc_cosim.study.shares import marked
from ddpc_cosim.texts import printable
from ddpc_cosim.trace import Outcome

_RANGE = "range"
_STEP = "solve_time_median [s]"
_VARIANTS_SHOWN = 2
_LONGEST_NAME = 60
_UNLIMITED = 10_000


@dataclass(frozen=True)
class _Row:
    """One controller under one scenario; or, without cases, a note on settings that are not listed."""

    name: str
    scenario: str
    cases: Sequence[CaseResult] = ()


def summary_table(results: StudyResults, console: Console) -> Table:
    """Return one row per controller and scenario, of a sweep the best settings, to fit the console.

    Each row has the values of the first seed, and median and range over all.
    """
    unlimited = console.options.update(width=_UNLIMITED)
    several_seeds = len({case.seed for case in results.cases}) > 1
    # What a narrow window leaves out, one after the other: all metrics but the first, then the range.
    metrics = [*reversed(_shown()[1:])]
    order = [*metrics, _RANGE] if several_seeds else [_RANGE, *metrics]
    for dropped in range(0 if several_seeds else 1, len(order) + 1):
        table = _table(results, left_out=order[:dropped])
        if console.measure(table, options=unlimited).maximum <= console.width:
            break
    return table


def _shown() -> list[str]:
    return [name for name, metric in all_metrics().items() if "terminal" in metric.shown]


def _table(results: StudyResults, left_out: Sequence[str]) -> Table:
    first = results.cases[0]
    ranked = headline(first.metrics)
    keys = [key for key in first.metrics if (name := split_key(key)[0]) in _shown() and name not in left_out]
    keys.sort(key=lambda key: key not in ranked)
    rows = _rows(results, keys[0] if keys else "")
    letters, seeds_line = _told_apart(results, keys[0]) if keys and _RANGE not in left_out else ({}, "")
    several = len({case.scenario for case in results.cases}) > 1
    table = Table(
        box=SIMPLE_HEAD, pad_edge=False, title=_title(results), title_justify="left", title_style="bold"
    )
    table.add_column("\ncontroller", max_width=_LONGEST_NAME)
    if several:
        table.add_column("\nscenario", max_width=_LONGEST_NAME)
    for key in keys:
        table.add_column(_heading(key), justify="right", no_wrap=True)
        if key == keys[0] and _RANGE not in left_out:
            table.add_column("over the seeds:\nmedian, range", justify="right", no_wrap=True)
            if letters:
                table.add_column("same letter:\nnot told apart", no_wrap=True)
    table.add_column(f"{metric_name(_STEP)}\n", justify="right", no_wrap=True)
    table.add_column("cases\ndone", justify="right", no_wrap=True)
    if not all(case.holds for case in results.cases):
        table.add_column("near their\nreference", justify="right", no_wrap=True)
    for row in rows:
        names = [Text(printable(name)) for name in (row.name, *([row.scenario] if several else []))]
        values = _values(row.cases, keys, left_out) if row.cases else []
        if letters and row.cases:
            values.insert(2, letters.get((row.cases[0].controller, row.cases[0].scenario), "-"))
        table.add_row(*names, *values[: len(table.columns) - len(names)])
    hidden = any(not row.cases for row in rows)
    where = f"every setting: {results.folder / METRICS_FILE}" if hidden else ""
    if where or seeds_line:
        table.caption = Text(printable("\n".join(filter(None, (seeds_line, where))), keep="\n"))
        table.caption_justify = "left"
    return table


def _told_apart(results: StudyResults, key: str) -> tuple[dict[tuple[str, str], str], str]:
    """Return the letters of controllers that the seeds do not tell apart, and a line if these are too few.

    They are of controllers and scenarios; who loses a run, reference points and variants of sweeps have none.
    """
    from ddpc_cosim.study.statistics import compare_all  # where there is one seed, it is not needed

    points = results.study.report.reference_points
    varied = {name for name, section in results.study.controllers.items() if section.variant_of}
    varied |= {points.zero, points.full} if points else set()
    found = {}
    for scenario in dict.fromkeys(case.scenario for case in results.cases):
        cases = [case for case in results.cases if case.scenario == scenario]
        left_out = varied | {case.controller for case in cases if not case.holds}
        runs: dict[str, dict[tuple[Hashable, int], float]] = {}
        for case in [] if none_follows(cases) else cases:
            if case.controller not in left_out:
                own = runs.setdefault(case.controller, {})
                own[scenario, case.seed] = case.metrics.get(key, math.nan)
        found[scenario] = compare_all(runs, metric_of(key).better)
    seeds, tested = len({case.seed for case in results.cases}), [one for one in found.values() if one.tests]
    needed = max((one.seeds_needed for one in tested if one.too_few_seeds), default=0)
    few = f"{seeds} seeds are too few to test so many controllers against each other: it takes {needed}"
    sure = {here: one for here, one in found.items() if not one.too_few_seeds}
    if any(len(one.groups) > 1 for one in sure.values()):
        letters = {(name, here): text for here, one in sure.items() for name, text in one.letters.items()}
        return letters, few if needed else ""
    return {}, few if needed else f"{seeds} seeds tell no two controllers apart" if tested else ""


def _rows(results: StudyResults, key: str) -> list[_Row]:
    """Return the rows in the study's order, after each controller the best of its sweeps."""
    groups: dict[tuple[str, str], list[CaseResult]] = {}
    for case in results.cases:
        groups.setdefault((case.controller, case.scenario), []).append(case)
    base = {(name, scenario): results.study.controllers[name].variant_of or name for name, scenario in groups}
    rows = []
    for family in dict.fromkeys((base[place], place[1]) for place in groups):
        members = [place for place in groups if (base[place], place[1]) == family]
        variants = [groups[place] for place in members if place[0] != family[0]]
        own = [groups[place] for place in members if place[0] == family[0]]
        variants.sort(key=lambda cases: _rank(cases, key))
        points = results.study.report.reference_points
        rows += [_Row(marked(cases[0].label, family[0], points), family[1], cases) for cases in own]
        rows += [_Row(_indented(cases, own), family[1], cases) for cases in variants[:_VARIANTS_SHOWN]]
        rest = len(variants) - _VARIANTS_SHOWN
        if rest > 0:
            rows.append(_Row(f"  and {rest} {'setting' if rest == 1 else 'settings'} more", family[1]))
    return rows


def _indented(variant: Sequence[CaseResult], own: Sequence[Sequence[CaseResult]]) -> str:
    """Return the label of a variant; below its controller, whose name it begins with, only what differs."""
    label = variant[0].label
    return "  " + label.removeprefix(f"{own[0][0].label}, ") if own else label


def _rank(cases: Sequence[CaseResult], key: str) -> tuple[int, float]:
    """Order by cases far from their reference, then by the median of a metric, the best first."""
    values = _completed_values(cases, key)
    lost = sum(not case.holds for case in cases)
    return lost, metric_of(key).rank(median(values)) if values else math.inf


def _completed_values(cases: Sequence[CaseResult], key: str) -> list[float]:
    values = [_value(case, key) for case in cases]
    return [value for value in values if not math.isnan(value)]


def _value(case: CaseResult, key: str) -> float:
    """Return a metric of a case, NaN where it would say nothing of such a run."""
    counts = case.holds if metric_of(key).if_held else case.outcome is Outcome.COMPLETED
    return case.metrics.get(key, math.nan) if counts else math.nan


def _values(cases: Sequence[CaseResult], keys: Sequence[str], left_out: Sequence[str]) -> list[str]:
    values = [_number(_value(cases[0], key)) for key in keys]
    if keys and _RANGE not in left_out:
        values.insert(1, _spread(cases, keys[0]))
    return [
        *values,
        _micro(_value(cases[0], _STEP)),
        _completed(cases),
        _holding(cases),
    ]


def _title(results: StudyResults) -> Text:
    return Text(printable(f"{results.study.title or results.study.name} (seed {results.cases[0].seed})"))


def _heading(key: str) -> Text:
    _, signal, unit = split_key(key)
    below = f"{signal} [{unit}]" if signal else f"[{unit}]" if unit != "1" else ""
    return Text(f"{metric_name(key)}\n{printable(below)}")


def _spread(cases: Sequence[CaseResult], key: str) -> str:
    values = _completed_values(cases, key)
    if not values:
        return "-"
    if len(values) == 1 or math.isclose(min(values), max(values), rel_tol=1e-9):
        return _number(median(values))
    return f"{_number(median(values))}, {_number(min(values))} .. {_number(max(values))}"


def _completed(cases: Sequence[CaseResult]) -> str:
    return f"{sum(case.outcome is Outcome.COMPLETED for case in cases)}/{len(cases)}"


def _holding(cases: Sequence[CaseResult]) -> str:
    return f"{sum(case.holds for case in cases)}/{len(cases)}"


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4g}"


def _micro(seconds: float) -> str:
    return "-" if math.isnan(seconds) else f"{1e6 * seconds:.{0 if seconds >= 1e-6 else 2}f} us"
