"""Why controllers fell back on a substitute for the input: what they said, how often, and when first."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ddpc_cosim import CaseResult, Outcome
from ddpc_reports.comparison import Competitor, Condition
from ddpc_reports.numbers import as_given, with_unit
from ddpc_reports.table import Cell, Heading, Row, Table

_OK = "ok"
_READ = 20
"""Cases of a controller whose samples are read: the first ones tell the reasons."""
_LISTED = 6
"""Reasons listed for a controller."""
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


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
    rows = tuple(
        Row(one.label, (*([Cell(condition.label)] if several else []), *cells), one.key, one.index)
        for condition in conditions
        for one in condition.competitors
        for cells in _told(one)
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
    if any(len(_failing(one)) > _READ for condition in conditions for one in condition.competitors):
        notes.append(f"Reasons are those of the first {_READ} cases with fallbacks of a controller.")
    return Table(
        f"{prefix}fallbacks",
        "Fallbacks",
        headings,
        rows,
        tuple(notes),
        kind="failures",
        download="fallbacks.csv",
    )


def _failing(one: Competitor) -> list[CaseResult]:
    return [case for case in one.cases if case.metrics.get("failures [1]", 0.0) > 0]


def _told(one: Competitor) -> Iterator[tuple[Cell, ...]]:
    """Yield the cells of each reason, the most frequent first."""
    order = sorted(_reasons(_failing(one)[:_READ]), key=lambda reason: -reason.samples)
    for reason in order[:_LISTED]:
        time, seed = reason.first
        when = f"{with_unit(as_given(time), 's')} (seed {seed})"
        yield Cell(str(reason)), _count(reason.samples), _count(len(reason.cases)), Cell(when)
    rest = order[_LISTED:]
    if rest:
        words = f"{len(rest)} other reasons"
        cases = set().union(*(reason.cases for reason in rest))
        yield Cell(words), _count(sum(reason.samples for reason in rest)), _count(len(cases)), Cell("")


def _count(number: int) -> Cell:
    return Cell(str(number), number)


def _reasons(cases: Sequence[CaseResult]) -> list[_Reason]:
    """Gather reasons; those that differ in numbers only are one."""
    found: dict[str, _Reason] = {}
    for case in cases:
        trace = case.trace()
        pairs = list(zip(trace.time.tolist(), trace.status, strict=True))
        # The fault that ended a case is no fallback: it stands among the cases that did not complete.
        for time, status in pairs[:-1] if case.outcome is Outcome.CONTROLLER_ERROR else pairs:
            if status == _OK:
                continue
            time = float(f"{time:.9g}")
            key = _NUMBER.sub("#", status)
            reason = found.setdefault(key, _Reason({}, 0, set(), (time, case.seed)))
            reason.words[status] = None
            reason.samples += 1
            reason.cases.add(case.id)
            reason.first = min(reason.first, (time, case.seed))
    return list(found.values())
