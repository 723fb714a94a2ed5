"""How sure the differences are: intervals, differences to the best, and who is not told apart."""

import math
from collections.abc import Sequence

from ddpc_cosim.files.tables import Cell, Heading, Row, Table
from ddpc_cosim.metrics import metric_of
from ddpc_cosim.study.verdicts.statistics import FEWEST, Difference, Sample, describe
from ddpc_reports.comparison import (
    Condition,
    ControllerResults,
    metric_unit,
    metric_words,
    spread,
)
from ddpc_reports.numbers import MISSING, as_given, computed
from ddpc_reports.shares import SHARE, SHARE_NOTE, share_cells, share_interval
from ddpc_reports.tables.table import controller_row, interval_texts, number_cells
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

_MOST_ROWS = 15
"""Of a table that stands open."""


def certainty_tables(condition: Condition, prefix: str) -> list[Table]:
    """Return the medians and what sets them apart, a row per controller and metric; none for one seed.

    What controllers are ranked by has a table, folded if it is long; the other metrics one that is folded.
    """
    if len(condition.seeds) < 2:
        return []
    more = [key for name in RANKED_BY for key in condition.keys(name)]
    over = f"over {len(condition.seeds)} seeds, and what they tell apart"
    is_long = len(condition.headline) * len(condition.controllers) > _MOST_ROWS
    return [
        table
        for table in (
            _table(condition, condition.headline, f"Medians {over}", f"{prefix}sure", " folded" * is_long),
            _table(condition, more, f"Medians of other metrics {over}", f"{prefix}more", " folded"),
        )
        if table.rows
    ]


def _table(condition: Condition, keys: Sequence[str], caption: str, name: str, kind: str = "") -> Table:
    rows = [row for key in keys for row in _rows(condition, key)]
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
    notes = (*_NOTES, *((SHARE_NOTE,) if condition.points else ()))
    return Table(name, caption, headings, tuple(rows), notes, kind=f"grouped{kind}", download="how-sure.csv")


def _rows(condition: Condition, key: str) -> list[Row]:
    """Return a row per controller, in the order of the ranking."""
    compared, order = condition.compared(key), condition.controllers
    samples = [describe(controller.runs(key)) for controller in order]
    best = condition.by_key[compared.order[0]] if compared.order else None
    differences = [_to_best(condition, key, controller, best) for controller in order]
    letters = {} if compared.too_few_seeds else compared.letters
    unit = metric_unit(key)
    cells = [
        [Cell(f"{s.known} of {s.runs}", s.known, failed=s.known < s.runs) for s in samples],
        number_cells([s.median for s in samples]),
        _intervals(samples, [not spread(controller.runs(key).values()).varies for controller in order]),
        *_shares(condition, key, order),
        number_cells([difference.median if difference else math.nan for difference in differences]),
        _intervals(differences, [bool(difference and difference.constant) for difference in differences]),
        [_p(difference) for difference in differences],
        [_ahead(difference) for difference in differences],
        [Cell(letters.get(controller.key, MISSING)) for controller in order],
    ]
    group = " / ".join(filter(None, (metric_words(key, condition.every_key), unit)))
    return [
        controller_row(controller, tuple(column[i] for column in cells), group)
        for i, controller in enumerate(order)
    ]


def _to_best(
    condition: Condition, key: str, controller: ControllerResults, best: ControllerResults | None
) -> Difference | None:
    """Return the difference of a controller to the best; None of the best itself, or where there is none."""
    if best is None or controller is best or controller.is_point:
        return None
    runs = {best.key: best.runs(key), controller.key: controller.runs(key)}
    return condition.compared(key).above(best.key, controller.key, runs, metric_of(key).better)


def _shares(condition: Condition, key: str, order: Sequence[ControllerResults]) -> list[list[Cell]]:
    if not condition.points:
        return []
    shares = condition.shares(key)
    return [
        share_cells(condition, order, key),
        [share_interval(shares.get(controller.key)) for controller in order],
    ]


def _intervals(estimates: Sequence[Sample | Difference | None], exact: Sequence[bool]) -> list[Cell]:
    ends = [(estimate.low, estimate.high) if estimate else (math.nan, math.nan) for estimate in estimates]
    return [
        Cell(MISSING, MISSING) if math.isnan(low) else Cell(_SAME if same else text, f"{low!r} … {high!r}")
        for text, (low, high), same in zip(interval_texts(ends), ends, exact, strict=True)
    ]


def _p(difference: Difference | None) -> Cell:
    if difference and difference.constant:
        return Cell(_SAME)
    return Cell(p_words(difference.corrected), difference.corrected) if difference else Cell(MISSING)


def _ahead(difference: Difference | None) -> Cell:
    if not difference or math.isnan(difference.won):
        return Cell(MISSING)
    ahead = as_given(computed(difference.won * difference.seeds))
    return Cell(f"{ahead} of {difference.seeds}", difference.won)
