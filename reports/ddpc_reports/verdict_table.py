"""The verdict in figures: one row per competitor, the best of each column marked."""

import math
from collections.abc import Callable, Sequence

from ddpc_reports.comparison import (
    STEP_TIMES,
    TRACKING,
    Competitor,
    Condition,
    Spread,
    metric_signal,
    metric_unit,
)
from ddpc_reports.numbers import MINUS, integer, time_scale
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
        firsts = [one.at_first(key) for one in condition.competitors]
        eligible = [one.completed_first for one in condition.competitors]
        title = _title(condition, key, "tracking cost")
        columns.append(
            (
                Heading(title, _detail(key, f"seed {condition.seeds[0]}")),
                number_cells(firsts, eligible=eligible),
            )
        )
        if len(condition.seeds) > 1:
            columns.extend(_spread_columns(condition, key, title))
    return columns


def _spread_columns(condition: Condition, key: str, title: str) -> list[_Column]:
    spreads = [one.over_seeds(key) for one in condition.competitors]
    medians = number_cells([s.median for s in spreads], eligible=_all_done(condition))
    ranges = [Cell(text, text) for text in range_texts(spreads)]
    return [
        (Heading(title, _detail(key, "median of the seeds")), medians),
        (Heading("range", _detail(key, "over the seeds")), ranges),
    ]


def _medians(condition: Condition, name: str, title: str) -> list[_Column]:
    return _summed(condition, name, title, lambda s: s.median, "median of the seeds")


def _worst(condition: Condition, name: str, title: str) -> list[_Column]:
    return _summed(condition, name, title, lambda s: s.high, "largest of the seeds")


def _summed(
    condition: Condition, name: str, title: str, figure: Callable[[Spread], float], words: str
) -> list[_Column]:
    words = words if len(condition.seeds) > 1 else ""
    columns = []
    for key in condition.keys(name):
        values = [figure(one.over_seeds(key)) for one in condition.competitors]
        cells = number_cells(values, eligible=_all_done(condition), digits=3)
        columns.append((Heading(_title(condition, key, title), _detail(key, words)), cells))
    return columns


def _times(condition: Condition) -> list[_Column]:
    columns = []
    for words in ("median", "99 %", "longest"):
        key, figure = STEP_TIMES[words]
        seconds = [figure(one.over_seeds(key)) for one in condition.competitors]
        scale = time_scale(seconds)
        shown = [value * scale.factor for value in seconds]
        cells = number_cells(shown, eligible=_all_done(condition), digits=3)
        columns.append((Heading("step time", f"{words} / {scale.unit}"), cells))
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
        (Heading("deadline misses", "steps"), _count_cells(condition, misses)),
        (Heading("fallbacks", "samples"), _count_cells(condition, fallbacks)),
        (Heading("completed", "cases"), completed),
    ]


def _count_cells(condition: Condition, counts: Sequence[float]) -> list[Cell]:
    eligible = [value for value, able in zip(counts, _all_done(condition), strict=True) if able]
    least = min(eligible) if len(set(eligible)) > 1 else math.nan
    return [
        Cell(integer(value), int(value), best=able and value == least)
        for value, able in zip(counts, _all_done(condition), strict=True)
    ]


def _all_done(condition: Condition) -> list[bool]:
    """Whether each competitor may be best: one that lost cases has figures of the easier seeds only."""
    return [one.completed_all for one in condition.competitors]


def _title(condition: Condition, key: str, words: str) -> str:
    several = len(condition.keys(key.partition(".")[0])) > 1
    return f"{words}, {metric_signal(key)}" if several else words


def _detail(key: str, words: str) -> str:
    unit = metric_unit(key)
    return " / ".join(filter(None, (words, unit)))


def _notes(condition: Condition) -> tuple[str, ...]:
    best = "Bold and tinted: the smallest of the column"
    partly: list[Competitor] = [one for one in condition.competitors if not one.completed_all]
    if partly:
        best += ", among controllers that completed every case (for the first seed: that completed it)"
    seeds = len(condition.seeds)
    over = (
        f" Over {seeds} seeds: median step times are medians of the cases, the longest is of all."
        if seeds > 1
        else ""
    )
    return (
        f"{best}; where all are equal, nobody is marked. Tracking cost is the sum of "
        f"|reference {MINUS} output| over the samples, actuator travel the sum of |change of the input|.{over}",
    )
