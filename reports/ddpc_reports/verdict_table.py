"""The verdict in figures: one row per competitor, the best of each column marked."""

from collections.abc import Callable

from ddpc_cosim.metrics import split_key
from ddpc_reports.comparison import (
    STEP_TIMES,
    TRACKING,
    Condition,
    Spread,
    metric_signal,
    metric_unit,
)
from ddpc_reports.numbers import MINUS, time_scale
from ddpc_reports.table import Cell, Heading, Row, Table, number_cells, range_texts

_Column = tuple[Heading, list[Cell]]


def verdict_table(condition: Condition, prefix: str) -> Table:
    """Return the table of tracking, settling, constraints, actuator, time and failures."""
    columns = [
        *_tracking(condition),
        *_medians(condition, "settled_error", "settled error"),
        *_worst(condition, "bound_violation_max", "beyond bounds"),
        *_medians(condition, "total_variation", "actuator travel"),
        *_times(condition),
        *_counts(condition),
    ]
    rows = tuple(
        Row(one.label, tuple(cells[i] for _, cells in columns), one.key, one.index)
        for i, one in enumerate(condition.competitors)
    )
    return Table(
        f"{prefix}verdict",
        "Verdict in figures, per controller",
        (Heading("Controller", numeric=False), *(heading for heading, _ in columns)),
        rows,
        _notes(condition),
        download="verdict.csv",
    )


def _tracking(condition: Condition) -> list[_Column]:
    columns = []
    for key in condition.keys(TRACKING):
        group = _title(condition, key, "tracking cost")
        firsts = [one.at_first(key) for one in condition.competitors]
        eligible = [one.completed_first for one in condition.competitors]
        heading = Heading(f"seed {condition.seeds[0]}", group=group)
        columns.append((heading, number_cells(firsts, eligible=eligible)))
        if len(condition.seeds) > 1:
            columns += _over_seeds(condition, key, group)
    return columns


def _over_seeds(condition: Condition, key: str, group: str) -> list[_Column]:
    spreads = [one.over_seeds(key) for one in condition.competitors]
    medians = number_cells([s.median for s in spreads], eligible=_all_done(condition))
    return [
        (Heading("median", group=group), medians),
        (Heading("range", group=group), [Cell(text) for text in range_texts(spreads)]),
    ]


def _medians(condition: Condition, name: str, title: str) -> list[_Column]:
    return _summed(condition, name, title, lambda s: s.median)


def _worst(condition: Condition, name: str, title: str) -> list[_Column]:
    return _summed(condition, name, title, lambda s: s.high)


def _summed(condition: Condition, name: str, title: str, figure: Callable[[Spread], float]) -> list[_Column]:
    columns = []
    for key in condition.keys(name):
        values = [figure(one.over_seeds(key)) for one in condition.competitors]
        cells = number_cells(values, eligible=_all_done(condition), digits=3)
        columns.append((Heading(_title(condition, key, title)), cells))
    return columns


def _times(condition: Condition) -> list[_Column]:
    columns = []
    for words in ("median", "99 %", "longest"):
        key, figure = STEP_TIMES[words]
        seconds = [figure(one.over_seeds(key)) for one in condition.competitors]
        scale = time_scale(seconds)
        shown = [value * scale.factor for value in seconds]
        cells = number_cells(shown, eligible=_all_done(condition), digits=3)
        columns.append((Heading(words, scale.unit, group="step time"), cells))
    return columns


def _counts(condition: Condition) -> list[_Column]:
    everybody = condition.competitors
    misses = [one.total("deadline_misses [1]") for one in everybody]
    fallbacks = [one.total("failures [1]") for one in everybody]
    completed = [
        Cell(f"{len(one.completed)} of {len(one.cases)}", len(one.completed), failed=not one.completed_all)
        for one in everybody
    ]
    return [
        (Heading("missed", group="steps"), number_cells(misses, eligible=_all_done(condition))),
        (Heading("fallback", group="steps"), number_cells(fallbacks, eligible=_all_done(condition))),
        (Heading("cases completed"), completed),
    ]


def _all_done(condition: Condition) -> list[bool]:
    """Whether each competitor may be best: one that lost cases has figures of the easier seeds only."""
    return [one.completed_all for one in condition.competitors]


def _title(condition: Condition, key: str, words: str) -> str:
    """Return the title of a column: the signal where there are several, and the unit."""
    several = len(condition.keys(split_key(key)[0])) > 1
    named = f"{words}, {metric_signal(key)}" if several else words
    return " / ".join(filter(None, (named, metric_unit(key))))


def _notes(condition: Condition) -> tuple[str, ...]:
    best = "Bold and tinted: the smallest of the column"
    if not all(_all_done(condition)):
        best += ", among controllers that completed every case (for the first seed: that completed it)"
    meaning = (
        f"Tracking cost: sum of |reference {MINUS} output| over the samples. Actuator travel: sum of "
        "|change of the input|. Missed: steps longer than the sampling time. "
        "Fallback: steps with a substitute for the input."
    )
    over = (
        f" Over {len(condition.seeds)} seeds, settled error, actuator travel, median and 99\u00a0% step "
        "time are medians, beyond bounds and longest step time are the largest, steps are summed."
    )
    return (
        f"{best}; where most are equal, nobody is marked.",
        meaning + (over if len(condition.seeds) > 1 else ""),
    )
