"""What went wrong, grouped by reason: runs that failed, fallbacks, warnings before the loop."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from ddpc_cosim import OK, CaseResult, Outcome, StudyResults
from ddpc_cosim.files.tables import Cell, Heading, Row, Table
from ddpc_cosim.files.texts import NUMBER, alike, without_folders
from ddpc_reports.comparison import labels
from ddpc_reports.numbers import MISSING, computed, given_time, integer

_READ = 200
"""Cases whose samples are read for the reasons of fallbacks: as many of each controller and scenario."""
_REASONS_SHOWN = 20
"""Reasons of a kind that have a row each."""
_NAMED = 4
"""Controllers that are named of one reason."""


class _Event(NamedTuple):
    """One reason given once: at which time [s], NaN where it is not of a time."""

    text: str
    case: CaseResult
    time: float = math.nan


@dataclass
class _Reason:
    """What was given as one reason, its numbers aside."""

    first: _Event
    texts: dict[str, None] = field(default_factory=dict)
    cases: dict[str, CaseResult] = field(default_factory=dict)
    events: int = 0

    def add(self, event: _Event) -> None:
        self.texts[event.text] = None
        self.cases[event.case.id] = event.case
        self.events += 1
        if event.time < self.first.time:
            self.first = event

    def __str__(self) -> str:
        """Return the words; of a number that is not always the same, smallest and largest."""
        numbers = zip(*(NUMBER.findall(text) for text in self.texts), strict=True)
        spans = iter([_span(sorted(set(given), key=float)) for given in numbers])
        return NUMBER.sub(lambda _: next(spans), next(iter(self.texts)))


def _span(given: list[str]) -> str:
    return given[0] if len(given) == 1 else f"{given[0]} … {given[-1]}"


def failures_table(results: StudyResults, prefix: str) -> Table | None:
    """Return what went wrong in a row per reason; None if nothing did."""
    failing, read = _failing(results.cases)
    ended_early = [case for case in results.cases if case.outcome is not Outcome.COMPLETED]
    failed = [case for case in results.cases if case.failed and case.outcome is Outcome.COMPLETED]
    early, late = f"{len(ended_early)} of {len(results.cases)}", f"{len(failed)} of {len(results.cases)}"
    kinds: dict[str, tuple[Iterable[_Event], bool]] = {
        f"Runs that did not complete: {early}": (_ends(results, ended_early), False),
        f"Runs that completed and failed: {late}": ((_Event(c.failure, c) for c in failed), False),
        "Fallbacks of controllers": (_fallbacks(case for cases in failing for case in cases[:read]), True),
        "Warnings before the loop": (_warnings(results.cases), False),
    }
    rows = tuple(
        row
        for kind, (events, sampled) in kinds.items()
        for row in _rows(_grouped(events), kind, results, sampled=sampled)
    )
    if not rows:
        return None
    headings = (
        Heading("Reason", numeric=False),
        Heading("controllers", numeric=False),
        Heading("cases"),
        Heading("samples"),
        Heading("first case", numeric=False),
        Heading("at", numeric=False),
    )
    notes = ["Reasons that differ in numbers only are one, with the smallest and the largest of them."]
    if failing:
        notes.append(
            "At the samples of a fallback the controller had no answer of its own and returned a substitute."
        )
    if any(len(cases) > read for cases in failing):
        which = f"{read} cases" if read > 1 else "case"
        notes.append(
            f"Counted are the fallbacks in the first {which} with any of each controller and scenario; "
            "metrics.csv has the number of every case."
        )
    return Table(
        f"{prefix}failures",
        "Failures, fallbacks and warnings by reason",
        headings,
        rows,
        tuple(notes),
        kind="grouped failures",
        download="failures.csv",
    )


def _ends(results: StudyResults, ended_early: Sequence[CaseResult]) -> Iterator[_Event]:
    """Yield how runs ended; at the time of their last sample, if they have any."""
    study = results.study
    for case in ended_early:
        rows, loop = case.metrics.get("samples [1]", 0.0), study.loop.of(study.scenarios[case.scenario])
        time = loop.start_time + (rows - 1) * loop.sampling_time if rows >= 1 else math.nan
        yield _Event(f"{case.outcome}: {case.reason}" if case.reason else str(case.outcome), case, time)


def _failing(cases: Sequence[CaseResult]) -> tuple[list[list[CaseResult]], int]:
    """Return the cases with fallbacks of each controller and scenario, and how many of them are read.

    Those whose samples are kept come first.
    """
    by_place: dict[tuple[str, str], list[CaseResult]] = {}
    for case in cases:
        if case.metrics.get("failures [1]", 0.0) > 0:
            by_place.setdefault((case.controller, case.scenario), []).append(case)
    for of_place in by_place.values():
        of_place.sort(key=lambda case: not case.has_samples)
    return [*by_place.values()], 1 + _READ // max(len(by_place), 1)


def _fallbacks(cases: Iterable[CaseResult]) -> Iterator[_Event]:
    for case in cases:
        if not case.has_samples:
            continue
        trace = case.trace()
        # The fault that ended a case is not a fallback: it is shown with the run.
        statuses = trace.status[: trace.decided]
        yield from (
            _Event(status, case, float(trace.time[k])) for k, status in enumerate(statuses) if status != OK
        )


def _warnings(cases: Sequence[CaseResult]) -> Iterator[_Event]:
    return (_Event(text, case) for case in cases for text in case.warnings)


def _grouped(events: Iterable[_Event]) -> list[_Reason]:
    """Return the reasons, the most frequent first."""
    by_text: dict[str, _Reason] = {}
    for event in events:
        event = event._replace(text=without_folders(event.text))
        by_text.setdefault(alike(event.text), _Reason(event)).add(event)
    return sorted(by_text.values(), key=lambda reason: -reason.events)


def _rows(reasons: Sequence[_Reason], kind: str, results: StudyResults, *, sampled: bool) -> Iterator[Row]:
    """Yield the rows of one kind; ``sampled`` says whether its events are samples."""
    names, sections = labels(results), results.study.scenarios
    scenarios = {case.scenario for case in results.cases}
    scenario_labels = {name: sections[name].label or name if name in sections else name for name in scenarios}

    def case_words(case: CaseResult) -> str:
        scenario = f", {scenario_labels[case.scenario]}" if len(scenario_labels) > 1 else ""
        return f"{names[case.controller]}{scenario}, seed {case.seed}"

    def row(words: str, cases: Mapping[str, CaseResult], events: int, first: _Event | None) -> Row:
        those = [*dict.fromkeys(names[case.controller] for case in cases.values())]
        cells = (
            Cell(_listed(those)),
            Cell(integer(len(cases)), len(cases)),
            Cell(integer(events), events) if sampled else Cell(MISSING),
            Cell(case_words(first.case) if first else MISSING),
            Cell(MISSING if not first or math.isnan(first.time) else given_time(computed(first.time))),
        )
        return Row(words, cells, group=kind)

    for reason in reasons[:_REASONS_SHOWN]:
        yield row(str(reason), reason.cases, reason.events, reason.first)
    if rest := reasons[_REASONS_SHOWN:]:
        those = {id: case for reason in rest for id, case in reason.cases.items()}
        yield row(f"{len(rest)} other reasons", those, sum(reason.events for reason in rest), None)


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _NAMED
    return ", ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")
