"""Tables of the cases: computation time, outcomes, fallbacks, diagnostics of the data, provenance."""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ddpc_cosim import OK, CaseResult, Outcome, StudyResults, judge_prediction
from ddpc_cosim.metrics import metric_name, metric_of
from ddpc_reports.comparison import (
    STEP_TIMES,
    Condition,
    ControllerResults,
    Spread,
    indices,
    labels,
    metric_keys,
    metric_words,
    outcome_words,
    response_metrics,
    shown_as,
    spread,
)
from ddpc_reports.numbers import MISSING, as_given, integer, significant, time_scale, with_unit
from ddpc_reports.tables.settings import compact_seeds, facts_table
from ddpc_reports.tables.table import (
    Cell,
    Column,
    Heading,
    Row,
    Table,
    controller_table,
    number_cells,
    text_headings,
)

_READ, _READ_IN_ALL = 20, 200
"""Cases of a controller, and of all, whose samples are read: the first ones tell the reasons."""
_MOST_CASES = 1500
"""Cases that have a row each, of 650 bytes."""
_MOST_FAILED = 50
"""Cases that did not complete of which each has a row."""
_REASONS_SHOWN = 6
"""Reasons shown of a controller."""
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def step_time_table(condition: Condition, prefix: str) -> Table:
    """Return the times of a step per controller, and deadline misses."""
    everyone = condition.controllers
    eligible = [one.holds_all and not one.is_point for one in everyone]
    columns: list[Column] = []
    for key in STEP_TIMES:
        seconds = [one.summed(key) for one in everyone]
        unit, factor = time_scale(seconds)
        alike = condition.alike(key, everyone)
        shown = [value * factor for value in seconds]
        cells = number_cells(shown, eligible=eligible, digits=3, alike=alike)
        columns.append((Heading(metric_name(key), unit), cells))
    sampling_time = condition.results.study.loop.sampling_time
    share = [100 * one.summed("solve_time_max [s]") / sampling_time for one in everyone]
    columns.append(
        (Heading(metric_name("solve_time_max"), "% of the sampling time"), number_cells(share, digits=2))
    )
    misses = [one.total("deadline_misses [1]") for one in everyone]
    columns.append((Heading("deadline misses", "steps"), [Cell(integer(n), int(n)) for n in misses]))
    return controller_table(
        f"{prefix}step-times",
        "Computation time of one controller step",
        everyone,
        columns,
        (
            "Wall-clock times: median, 95th and 99th percentile of a run, in medians over the completed "
            "cases, and the longest of all of them.",
        ),
        "step-times.csv",
    )


def cases_table(results: StudyResults, condition_of_all: Sequence[Condition], prefix: str) -> Table:
    """Return the cases with outcomes and main metrics, in the study's order: all that there is room for."""
    keys, cases = _case_keys(condition_of_all), _shown_cases(results)
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
            Cell(outcome, outcome, failed=not case.holds),
            *(cells[i] for cells in columns),
        ]
        rows.append(Row(names[case.controller], tuple(shown), case.controller, numbers[case.controller]))
    headings = [
        Heading("Controller", numeric=False),
        *([Heading("scenario", numeric=False)] if several else []),
        Heading("seed"),
        Heading("outcome", numeric=False),
        *(Heading(metric_words(key), unit) for key, (unit, _) in zip(keys, scales, strict=True)),
    ]
    total = len(results.cases)
    caption, which = f"Every case ({total})", ""
    if len(cases) < total:
        caption = f"{len(cases)} of {total} cases"
        which = (
            "Up to half of the rows: cases that do not stay near their reference; the others: first seeds. "
        )
    return Table(
        f"{prefix}cases",
        caption,
        tuple(headings),
        tuple(rows),
        (
            f"{which}All metrics of every case are in the file metrics.csv next to the results. "
            "Values of cases that did not complete cover their samples up to where they ended. "
            "Of a run that does not stay near its reference, figures of the response would say nothing.",
        ),
        sortable=True,
        kind="cases",
        download="cases.csv",
    )


def _shown_cases(results: StudyResults) -> Sequence[CaseResult]:
    """Return all cases; of too many the first that are lost, and those of the first seeds."""
    if len(results.cases) <= _MOST_CASES:
        return results.cases
    lost = [case for case in results.cases if not case.holds][: _MOST_CASES // 2]
    place = {seed: i for i, seed in enumerate(dict.fromkeys(case.seed for case in results.cases))}
    by_seed = sorted(results.cases, key=lambda case: place[case.seed])
    shown = {*[*dict.fromkeys(case.id for case in [*lost, *by_seed])][:_MOST_CASES]}
    return [case for case in results.cases if case.id in shown]


_CASE_STEP_TIMES = ("solve_time_median [s]", "solve_time_max [s]")


def _case_keys(conditions: Sequence[Condition]) -> list[str]:
    # What says neither good nor bad of a response would only make the page of many cases larger.
    shown = (name for name, metric in response_metrics().items() if metric.better or not metric.if_held)
    keys = [key for name in shown for key in metric_keys(conditions, name)]
    return [*keys, *_CASE_STEP_TIMES]


def _value(case: CaseResult, key: str) -> float:
    shown = case.holds or not metric_of(key).if_held
    return case.metrics.get(key, math.nan) if shown else math.nan


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
        for case in failed[:_MOST_FAILED]
    )
    more = len(failed) - len(rows)
    notes = (
        (f"And {more} more: their outcomes are in metrics.csv, their reasons in run.json.",) if more else ()
    )
    headings = (
        *text_headings("Controller", "scenario"),
        Heading("seed"),
        *text_headings("outcome", "reason"),
    )
    return Table(
        f"{prefix}failures",
        f"Cases that did not complete ({len(failed)})",
        headings,
        rows,
        notes,
        kind="failures",
    )


def warnings_table(results: StudyResults, prefix: str) -> Table | None:
    """Return what spoke against data and models before the loops were closed; None if nothing did."""
    names, numbers = labels(results), indices(results)
    rows = tuple(
        Row(
            names[key],
            (Cell(text), _count(len(cases)), Cell(str(cases[0].seed), cases[0].seed)),
            key,
            numbers[key],
        )
        for (key, text), cases in results.warnings().items()
    )
    if not rows:
        return None
    return Table(
        f"{prefix}warnings",
        "Warnings before the loop",
        (*text_headings("Controller", "warning"), Heading("cases"), Heading("first seed")),
        rows,
        ("Known of data and models before the loop was closed; the numbers are those of the first seed.",),
        kind="failures",
        download="warnings.csv",
    )


def provenance_table(results: StudyResults, prefix: str) -> Table:
    """Return where the results come from, as the run recorded it."""
    facts = [(_spelled(name), value) for name, value in results.provenance.items()]
    facts.append(("seeds", compact_seeds(results.study.seeds)))
    return facts_table(f"{prefix}provenance", "Provenance of the results", facts, "provenance.csv")


_ACRONYMS = {"fmu": "FMU", "fmi": "FMI", "sha256": "SHA-256", "guid": "GUID", "cpu": "CPU", "os": "OS"}


def _spelled(name: str) -> str:
    return " ".join(_ACRONYMS.get(word, word) for word in name.replace("_", " ").split(" "))


@dataclass
class _Reason:
    """One reason, its numbers aside: the words with their numbers, where it was given, and when first."""

    words: dict[str, None]
    samples: int
    cases: set[str]
    first: tuple[float, int]

    def __str__(self) -> str:
        """Return the words; of a number that is not always the same, smallest and largest."""
        numbers = zip(*(_NUMBER.findall(words) for words in self.words), strict=True)
        spans = iter([_span(sorted(set(given), key=float)) for given in numbers])
        return _NUMBER.sub(lambda _: next(spans), next(iter(self.words)))


def _span(given: list[str]) -> str:
    return given[0] if len(given) == 1 else f"{given[0]} … {given[-1]}"


def fallbacks_table(conditions: Sequence[Condition], prefix: str) -> Table | None:
    """Return what the controllers gave as reasons for fallbacks; None if there were none."""
    several = len(conditions) > 1
    failing = [(condition, one, _failing(one)) for condition in conditions for one in condition.controllers]
    count = sum(bool(cases) for *_, cases in failing)
    read = min(_READ, 1 + _READ_IN_ALL // max(count, 1))
    rows = tuple(
        Row(one.label, (*([Cell(condition.label)] if several else []), *cells), one.key, one.index)
        for condition, one, cases in failing
        for cells in _reason_cells(cases[:read])
    )
    if not rows:
        return None
    headings = (
        Heading("Controller", numeric=False),
        *([Heading("scenario", numeric=False)] if several else []),
        Heading("reason", numeric=False),
        Heading("samples"),
        Heading("cases"),
        Heading("first at", numeric=False),
    )
    notes = [
        "At these samples the controller had no answer of its own and returned a substitute, as it says."
    ]
    if any(len(cases) > read for *_, cases in failing):
        which = f"{read} cases" if read > 1 else "case"
        notes.append(f"Reasons are those of the first {which} with fallbacks of a controller.")
    return Table(
        f"{prefix}fallbacks",
        "Fallbacks",
        headings,
        rows,
        tuple(notes),
        kind="failures",
        download="fallbacks.csv",
    )


def _failing(one: ControllerResults) -> list[CaseResult]:
    return [case for case in one.cases if case.metrics.get("failures [1]", 0.0) > 0]


def _reason_cells(cases: Sequence[CaseResult]) -> Iterator[tuple[Cell, ...]]:
    """Yield the cells of each reason, the most frequent first."""
    order = sorted(_reasons(cases), key=lambda reason: -reason.samples)
    for reason in order[:_REASONS_SHOWN]:
        time, seed = reason.first
        when = f"{with_unit(as_given(time), 's')} (seed {seed})"
        yield Cell(str(reason)), _count(reason.samples), _count(len(reason.cases)), Cell(when)
    rest = order[_REASONS_SHOWN:]
    if rest:
        words = f"{len(rest)} other reasons"
        those = set().union(*(reason.cases for reason in rest))
        yield Cell(words), _count(sum(reason.samples for reason in rest)), _count(len(those)), Cell("")


def _count(number: int) -> Cell:
    return Cell(str(number), number)


def _reasons(cases: Sequence[CaseResult]) -> list[_Reason]:
    """Gather reasons; those that differ in numbers only are one."""
    found: dict[str, _Reason] = {}
    for case in cases:
        trace = case.trace()
        pairs = list(zip(trace.time.tolist(), trace.status, strict=True))
        # The fault that ended a case is not a fallback: it is listed with the cases that did not complete.
        for time, status in pairs[: trace.decided]:
            if status == OK:
                continue
            time = float(f"{time:.9g}")
            key = _NUMBER.sub("#", status)
            reason = found.setdefault(key, _Reason({}, 0, set(), (time, case.seed)))
            reason.words[status] = None
            reason.samples += 1
            reason.cases.add(case.id)
            reason.first = min(reason.first, (time, case.seed))
    return list(found.values())


_DIAGNOSTICS = {
    "pe_order": "PE order reached",
    "pe_order_needed": "PE order needed",
    "data_rows": "data rows",
    "data_columns": "data columns",
    "data_rank": "rank",
    "smallest_singular_value": "smallest singular value",
    "prediction_error": "prediction error, held out",
    "prediction_error_fitted": "prediction error, fitted",
}
_HELD_OUT = "prediction_error"


def diagnostics_table(condition: Condition, prefix: str) -> Table | None:
    """Return what the controllers say about their data, first seed and range; None if they say nothing."""
    reporting = [one for one in condition.controllers if any(case.diagnostics for case in one.cases)]
    if not reporting:
        return None
    several = len(condition.seeds) > 1
    headings = (
        Heading("Diagnostic", numeric=False),
        Heading(f"seed {condition.seeds[0]}"),
        *([Heading("range over the seeds")] if several else []),
    )
    return Table(
        f"{prefix}diagnostics",
        "What the controllers learned from, and what they start with",
        headings,
        tuple(row for one in reporting for row in _diagnostic_rows(one, several=several)),
        (
            "PE order: order of persistent excitation of the recorded inputs. "
            "Rank and singular value: of the stacked data. Prediction error: root mean square at the end of "
            "the horizon, in parts of the output's standard deviation, of the output predicted worst; held "
            "out: on the last quarter of the recording, by what was fitted to the rest.",
        ),
        kind="grouped facts",
        download="diagnostics.csv",
    )


def _diagnostic_rows(one: ControllerResults, *, several: bool) -> list[Row]:
    given = dict.fromkeys(name for case in one.cases for name in case.diagnostics)
    ordered = [name for name in _DIAGNOSTICS if name in given] + [
        name for name in given if name not in _DIAGNOSTICS
    ]
    rows = []
    for name in ordered:
        values = [case.diagnostics.get(name, math.nan) for case in one.cases]
        first = one.cases[0].diagnostics.get(name, math.nan)
        cells = [Cell(_written(first) + _judged(one.cases[0], name), first)]
        if several:
            cells.append(Cell(_range(spread(values))))
        part, _, last = name.rpartition(".")
        title = " ".join(filter(None, (part, _DIAGNOSTICS.get(last, last.replace("_", " ")))))
        rows.append(Row(title, tuple(cells), group=one.label))
    return rows


def _judged(case: CaseResult, name: str) -> str:
    """Return the judgement of a prediction that was tested on what was held out; empty for other figures."""
    if not name.endswith(_HELD_OUT) or name not in case.diagnostics:
        return ""
    return f": {judge_prediction(case.diagnostics[name], case.diagnostics.get(f'{name}_fitted', math.nan))}"


def _range(figure: Spread) -> str:
    return f"{_written(figure.low)} … {_written(figure.high)}" if figure.varies else MISSING


def _written(value: float) -> str:
    return integer(value) if value.is_integer() and abs(value) < 1e6 else significant(value)
