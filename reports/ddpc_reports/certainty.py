"""How sure the differences are: intervals, differences to the best, and who is not told apart."""

import math
from collections.abc import Sequence

from ddpc_cosim.metrics import metric_of
from ddpc_cosim.study.verdicts.statistics import FEWEST, Difference, Sample, describe
from ddpc_cosim.tables import Cell, Heading, Row, Table
from ddpc_reports.comparison import (
    Condition,
    ControllerResults,
    metric_unit,
    metric_words,
    spread,
)
from ddpc_reports.numbers import MISSING, as_given
from ddpc_reports.shares import SHARE, SHARE_NOTE, share_cells, share_interval
from ddpc_reports.tables.table import interval_texts, number_cells
from ddpc_reports.verdict import RANKED_BY, p_words

_SAME = "the same on every seed"
_NOTES = (
    "Runs: those that did not fail and have a value; all that follows is of them. Interval: the "
    f"95\u00a0% bootstrap interval of the median, from {FEWEST} seeds on. Difference: to the best median, in "
    "pairs of the same seed. Seeds ahead: of these pairs, a tie counting half.",
    "p: one step-down sign-flip max-T test of all pairs of controllers that have no failed run"
    "; a dash: of fewer than six seeds no p could fall below "
    "5\u00a0%. Others come last whatever their figures, and are not tested. Group: controllers that are not "
    "told apart at 5\u00a0% share a letter.",
)


def certainty_table(condition: Condition, prefix: str) -> Table | None:
    """Return the medians and what sets them apart, a row per controller and metric; None for one seed."""
    if len(condition.seeds) < 2:
        return None
    rows = [row for key in _keys(condition) for row in _rows(condition, key)]
    headings = (
        Heading("Controller", numeric=False),
        Heading("runs"),
        Heading("median"),
        Heading("interval"),
        *([Heading(what, "%", group=SHARE) for what in ("median", "interval")] if condition.points else []),
        Heading("median", group="difference to the best"),
        Heading("interval", group="difference to the best"),
        Heading("p", group="difference to the best"),
        Heading("seeds ahead", group="difference to the best"),
        Heading("group"),
    )
    caption = f"Medians over {len(condition.seeds)} seeds, and what they tell apart"
    name = f"{prefix}sure"
    notes = (*_NOTES, *((SHARE_NOTE,) if condition.points else ()))
    return Table(name, caption, headings, tuple(rows), notes, kind="grouped", download="how-sure.csv")


def _keys(condition: Condition) -> list[str]:
    """Return the metrics by which the verdict names a first."""
    more = [key for name in RANKED_BY for key in condition.keys(name)]
    return [*condition.headline, *more]


def _rows(condition: Condition, key: str) -> list[Row]:
    """Return a row per controller: those that are ranked first, the best first, then the others."""
    compared = condition.compared(key)
    by_key = {one.key: one for one in condition.controllers}
    order = [by_key[name] for name in compared.order]
    order += [one for one in condition.controllers if one not in order]  # reference points are the last
    samples = [describe(one.runs(key)) for one in order]
    best = order[0] if compared.order else None
    found = [_to_best(condition, key, one, best) for one in order]
    letters = {} if compared.too_few_seeds else compared.letters
    unit = metric_unit(key)
    cells = [
        [Cell(f"{s.known} of {s.runs}", s.known, failed=s.known < s.runs) for s in samples],
        number_cells([s.median for s in samples]),
        _intervals(samples, [not spread(one.runs(key).values()).varies for one in order]),
        *_shares(condition, key, order),
        number_cells([one.median if one else math.nan for one in found]),
        _intervals(found, [one is not None and one.constant for one in found]),
        [_p(one) for one in found],
        [_ahead(one) for one in found],
        [Cell(letters.get(one.key, MISSING)) for one in order],
    ]
    group = " / ".join(filter(None, (metric_words(key), unit)))
    return [
        Row(one.label, tuple(of_one[i] for of_one in cells), one.key, one.index, group)
        for i, one in enumerate(order)
    ]


def _to_best(
    condition: Condition, key: str, one: ControllerResults, best: ControllerResults | None
) -> Difference | None:
    """Return the difference of a controller to the best; None of the best itself, or where there is none."""
    if best is None or one is best or one.is_point:
        return None
    runs = {best.key: best.runs(key), one.key: one.runs(key)}
    return condition.compared(key).above(best.key, one.key, runs, metric_of(key).better)


def _shares(condition: Condition, key: str, order: Sequence[ControllerResults]) -> list[list[Cell]]:
    if not condition.points:
        return []
    found = condition.shares(key)
    return [share_cells(condition, order, key), [share_interval(found.get(one.key)) for one in order]]


def _intervals(found: Sequence[Sample | Difference | None], exact: Sequence[bool]) -> list[Cell]:
    ends = [(one.low, one.high) if one else (math.nan, math.nan) for one in found]
    return [
        Cell(MISSING, MISSING) if math.isnan(low) else Cell(_SAME if same else text, f"{low!r} … {high!r}")
        for text, (low, high), same in zip(interval_texts(ends), ends, exact, strict=True)
    ]


def _p(one: Difference | None) -> Cell:
    if one and one.constant:
        return Cell(_SAME)
    return Cell(p_words(one.corrected), one.corrected) if one else Cell(MISSING)


def _ahead(one: Difference | None) -> Cell:
    if not one or math.isnan(one.won):
        return Cell(MISSING)
    return Cell(f"{as_given(one.won * one.seeds)} of {one.seeds}", one.won)
