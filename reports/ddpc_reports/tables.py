"""The other tables of a study: computation time, every case, those that failed, provenance."""

import math

from ddpc_cosim import Outcome, StudyResults
from ddpc_reports.comparison import (
    STEP_TIMES,
    TRACKING,
    Condition,
    indices,
    labels,
    metric_signal,
    metric_unit,
)
from ddpc_reports.numbers import MISSING, integer, time_scale
from ddpc_reports.settings_tables import compact_seeds, facts_table
from ddpc_reports.table import Cell, Heading, Row, Table, number_cells


def step_time_table(condition: Condition, prefix: str) -> Table:
    """Return median, 95 %, 99 % and longest step time per controller, and deadline misses."""
    everybody = condition.competitors
    columns: list[tuple[Heading, list[Cell]]] = []
    for words, (key, figure) in STEP_TIMES.items():
        seconds = [figure(one.over_seeds(key)) for one in everybody]
        scale = time_scale(seconds)
        shown = [value * scale.factor for value in seconds]
        eligible = [one.completed_all for one in everybody]
        columns.append(
            (Heading(words, scale.unit, group="step time"), number_cells(shown, eligible=eligible, digits=3))
        )
    share = [_share(one.over_seeds("solve_time_max [s]").high, condition.results) for one in everybody]
    columns.append((Heading("longest", "% of the sampling time"), number_cells(share, digits=2)))
    misses = [one.total("deadline_misses [1]") for one in everybody]
    columns.append((Heading("deadline misses", "steps"), [Cell(integer(n), int(n)) for n in misses]))
    rows = (
        Row(one.label, tuple(cells[i] for _, cells in columns), one.key, one.index)
        for i, one in enumerate(everybody)
    )
    return Table(
        f"{prefix}step-times",
        "Computation time of one controller step",
        (Heading("Controller", numeric=False), *(heading for heading, _ in columns)),
        tuple(rows),
        (
            "Wall-clock times. Median, 95\u00a0% and 99\u00a0% are medians over the completed cases; "
            "longest is of all of them.",
        ),
        download="step-times.csv",
    )


def _share(seconds: float, results: StudyResults) -> float:
    return 100 * seconds / results.study.loop.sampling_time


def cases_table(results: StudyResults, condition_of_all: tuple[Condition, ...], prefix: str) -> Table:
    """Return every case with its outcome and main figures, in the study's order."""
    keys = _case_keys(condition_of_all)
    scales = [_shown_as(key, results) for key in keys]
    columns = [
        number_cells([case.metrics.get(key, math.nan) * factor for case in results.cases])
        for key, (_, factor) in zip(keys, scales, strict=True)
    ]
    several = len(condition_of_all) > 1
    names, numbers = labels(results), indices(results)
    rows = []
    for i, case in enumerate(results.cases):
        done = case.outcome is Outcome.COMPLETED
        shown = [
            *([Cell(case.scenario, case.scenario)] if several else []),
            Cell(str(case.seed), case.seed),
            Cell(str(case.outcome), str(case.outcome), failed=not done),
            *(cells[i] for cells in columns),
        ]
        rows.append(Row(names[case.controller], tuple(shown), case.controller, numbers[case.controller]))
    headings = [
        Heading("Controller", numeric=False),
        *([Heading("scenario", numeric=False)] if several else []),
        Heading("seed"),
        Heading("outcome", numeric=False),
        *(Heading(_case_title(key), unit) for key, (unit, _) in zip(keys, scales, strict=True)),
    ]
    return Table(
        f"{prefix}cases",
        f"Every case ({len(results.cases)})",
        tuple(headings),
        tuple(rows),
        (
            "All metrics of every case are in the file metrics.csv beside the results. "
            "Values of cases that did not complete cover their samples up to the fault.",
        ),
        sortable=True,
        kind="cases",
        download="cases.csv",
    )


def _case_keys(conditions: tuple[Condition, ...]) -> list[str]:
    names = (TRACKING, "settled_error", "bound_violation_max", "total_variation")
    keys = [key for name in names for one in conditions for key in one.keys(name)]
    return [*dict.fromkeys(keys), "solve_time_median [s]", "solve_time_max [s]"]


def _shown_as(key: str, results: StudyResults) -> tuple[str, float]:
    if metric_unit(key) != "s":
        return metric_unit(key), 1.0
    return time_scale(case.metrics.get(key, math.nan) for case in results.cases)


_CASE_TITLES = {
    TRACKING: "tracking cost",
    "settled_error": "settled error",
    "bound_violation_max": "beyond bounds",
    "total_variation": "actuator travel",
    "solve_time_median": "median step",
    "solve_time_max": "longest step",
}


def _case_title(key: str) -> str:
    title = _CASE_TITLES[key.partition(".")[0].partition(" ")[0]]
    return f"{title}, {metric_signal(key)}" if metric_signal(key) else title


def failures_table(results: StudyResults, prefix: str) -> Table | None:
    """Return the cases that did not complete, with their reasons; None if all did."""
    failed = [case for case in results.cases if case.outcome is not Outcome.COMPLETED]
    if not failed:
        return None
    names, numbers = labels(results), indices(results)
    rows = tuple(
        Row(
            names[case.controller],
            (
                Cell(case.scenario),
                Cell(str(case.seed), case.seed),
                Cell(str(case.outcome), failed=True),
                Cell(case.reason or MISSING),
            ),
            case.controller,
            numbers[case.controller],
        )
        for case in failed
    )
    headings = (
        Heading("Controller", numeric=False),
        Heading("scenario", numeric=False),
        Heading("seed"),
        Heading("outcome", numeric=False),
        Heading("reason", numeric=False),
    )
    return Table(
        f"{prefix}failures", f"Cases that did not complete ({len(failed)})", headings, rows, kind="failures"
    )


def provenance_table(results: StudyResults, prefix: str) -> Table:
    """Return where the results come from, as the run recorded it."""
    facts = {_spelled(name): value for name, value in results.provenance.items()}
    facts["seeds"] = compact_seeds(results.study.seeds)
    return facts_table(f"{prefix}provenance", "Provenance of the results", facts, "provenance.csv")


_ACRONYMS = {"fmu": "FMU", "fmi": "FMI", "sha256": "SHA-256", "guid": "GUID", "cpu": "CPU", "os": "OS"}


def _spelled(name: str) -> str:
    return " ".join(_ACRONYMS.get(word, word) for word in name.replace("_", " ").split(" "))
