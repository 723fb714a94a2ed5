"""Tables of the cases: computation time, outcomes and main metrics."""

import math
from collections.abc import Sequence

from ddpc_cosim import CaseResult, StudyResults
from ddpc_cosim.files.tables import Cell, Heading, Row, Table
from ddpc_cosim.files.texts import printable, without_folders
from ddpc_cosim.metrics import metric_name, metric_of
from ddpc_reports.comparison import (
    STEP_TIMES,
    Condition,
    in_ranked_order,
    indices,
    labels,
    metric_keys,
    metric_words,
    outcome_words,
    response_metrics,
    shown_as,
)
from ddpc_reports.numbers import integer, time_scale
from ddpc_reports.tables.table import Column, controller_table, number_cells

_MOST_CASES = 1500
"""Cases that have a row each, of 650 bytes."""
_LONGEST_REASON = 80
"""Characters of a reason in a row."""


def step_time_table(condition: Condition, prefix: str) -> Table:
    """Return the times of a step per controller, deadline misses, and steps with a substitute."""
    everyone = condition.controllers
    eligible = [not controller.failed and not controller.is_point for controller in everyone]
    columns: list[Column] = []
    for key in STEP_TIMES:
        seconds = [controller.summed(key) for controller in everyone]
        unit, factor = time_scale(seconds)
        alike = condition.alike(key, everyone)
        shown = [value * factor for value in seconds]
        cells = number_cells(shown, eligible=eligible, digits=3, alike=alike)
        columns.append((Heading(metric_name(key), unit), cells))
    sampling_time = condition.results.study.loop.sampling_time
    share = [100 * controller.summed("solve_time_max [s]") / sampling_time for controller in everyone]
    columns.append(
        (Heading(metric_name("solve_time_max"), "% of the sampling time"), number_cells(share, digits=2))
    )
    for key in ("deadline_misses [1]", "failures [1]"):
        counts = [controller.total(key) for controller in everyone]
        columns.append((Heading(metric_name(key), "steps"), [Cell(integer(n), int(n)) for n in counts]))
    return controller_table(
        f"{prefix}step-times",
        "Computation time of one controller step",
        everyone,
        columns,
        (
            "Wall-clock times: median, 95th and 99th percentile of a run, in medians over the completed "
            "cases, and the longest of all of them. Deadline misses: steps longer than the sampling time; "
            "failures: steps at which the controller returned a substitute.",
        ),
        "step-times.csv",
    )


def cases_table(results: StudyResults, condition_of_all: Sequence[Condition], prefix: str) -> Table:
    """Return the cases with outcomes and metrics, as controllers are ranked: all that there is room for."""
    keys, order = _case_keys(condition_of_all), in_ranked_order(results, labels(results))
    cases = sorted(_shown_cases(results), key=lambda case: order.index(case.controller))
    values = {key: [_value(case, key) for case in cases] for key in keys}
    scales = [shown_as(key, values[key]) for key in keys]
    columns = [
        number_cells([value * factor for value in values[key]])
        for key, (_, factor) in zip(keys, scales, strict=True)
    ]
    several = len(condition_of_all) > 1
    names, numbers = labels(results), indices(results)
    rows = []
    for i, case in enumerate(cases):
        outcome = outcome_words(case)
        shown = [
            *([Cell(case.scenario, case.scenario)] if several else []),
            Cell(str(case.seed), case.seed),
            Cell(outcome, outcome, failed=case.failed, detail=_reason(case)),
            *(cells[i] for cells in columns),
        ]
        name = names[case.controller]
        rows.append(Row(name, tuple(shown), case.controller, numbers[case.controller]))
    headings = [
        Heading("Controller", numeric=False),
        *([Heading("scenario", numeric=False)] if several else []),
        Heading("seed"),
        Heading("outcome", numeric=False),
        *(Heading(metric_words(key, keys), unit) for key, (unit, _) in zip(keys, scales, strict=True)),
    ]
    total = len(results.cases)
    caption, which = f"Every case ({total})", ""
    if len(cases) < total:
        caption = f"{len(cases)} of {total} cases"
        which = "Up to half of the rows: cases that failed; the others: first seeds. "
    return Table(
        f"{prefix}cases",
        caption,
        tuple(headings),
        tuple(rows),
        (
            f"{which}All metrics of every case are in the file metrics.csv next to the results. "
            "Values of cases that did not complete cover their samples up to where they ended. "
            "Of a run that failed, figures of the response would say nothing.",
            "The rows stand as controllers are ranked. Those of metrics.csv keep the order of the study, "
            "whatever the figures are, so that the files of two runs can be compared line by line.",
        ),
        sortable=True,
        kind="cases",
        download="cases.csv",
    )


def _reason(case: CaseResult) -> str:
    """Return why a case ended or failed, as far as a cell has room for it."""
    return printable(without_folders(case.reason or case.failure), _LONGEST_REASON)


def _shown_cases(results: StudyResults) -> Sequence[CaseResult]:
    """Return all cases; of too many the first that failed, and those of the first seeds."""
    if len(results.cases) <= _MOST_CASES:
        return results.cases
    failed = [case for case in results.cases if case.failed][: _MOST_CASES // 2]
    place = {seed: i for i, seed in enumerate(dict.fromkeys(case.seed for case in results.cases))}
    by_seed = sorted(results.cases, key=lambda case: place[case.seed])
    shown = {*[*dict.fromkeys(case.id for case in [*failed, *by_seed])][:_MOST_CASES]}
    return [case for case in results.cases if case.id in shown]


_CASE_STEP_TIMES = ("solve_time_median [s]", "solve_time_max [s]")


def _case_keys(conditions: Sequence[Condition]) -> list[str]:
    # What says neither good nor bad of a response would only make the page of many cases larger.
    shown = (name for name, metric in response_metrics().items() if metric.better or not metric.if_held)
    keys = [key for name in shown for key in metric_keys(conditions, name)]
    return [*keys, *_CASE_STEP_TIMES]


def _value(case: CaseResult, key: str) -> float:
    shown = not case.failed or not metric_of(key).if_held
    return case.metrics.get(key, math.nan) if shown else math.nan
