"""The verdict in figures: one row per competitor, the best of each column marked."""

from collections.abc import Callable

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
        *_beyond_bounds(condition),
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
    """Return first seed, median and range; of several outputs the medians only, or nothing else has room."""
    if len(condition.keys(TRACKING)) > 1:
        return _medians(condition, TRACKING, "tracking cost", digits=4)
    columns = []
    for key in condition.keys(TRACKING):
        group = " / ".join(filter(None, ("tracking cost", metric_unit(key))))
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


def _medians(condition: Condition, name: str, title: str, digits: int = 3) -> list[_Column]:
    return _summed(condition, name, title, lambda s: s.median, digits)


def _beyond_bounds(condition: Condition) -> list[_Column]:
    """Return the largest violations; of several outputs only if there are any, to keep the table narrow."""
    name = "bound_violation_max"
    keys = condition.keys(name)
    if len(keys) > 1 and not any(
        one.over_seeds(key).high > 0 for one in condition.competitors for key in keys
    ):
        return []
    return _summed(condition, name, "beyond bounds", lambda s: s.high, 3)


def _summed(
    condition: Condition, name: str, title: str, figure: Callable[[Spread], float], digits: int
) -> list[_Column]:
    """Return one column for each signal, under a common head where there are several."""
    columns = []
    for key in condition.keys(name):
        values = [figure(one.over_seeds(key)) for one in condition.competitors]
        cells = number_cells(values, eligible=_all_done(condition), digits=digits)
        several = len(condition.keys(name)) > 1
        heading = (
            Heading(metric_signal(key), metric_unit(key), group=title)
            if several
            else Heading(title, metric_unit(key))
        )
        columns.append((heading, cells))
    return columns


def _times(condition: Condition) -> list[_Column]:
    columns = []
    for words in ("median", "99\u00a0%", "longest"):
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
    fallbacks = [one.fallbacks for one in everybody]
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


def _notes(condition: Condition) -> tuple[str, ...]:
    best = "Bold and tinted: the smallest of the column"
    if not all(_all_done(condition)):
        best += ", among controllers that completed every case (for the first seed: that completed it)"
    meaning = (
        f"Tracking cost: sum of |reference {MINUS} output| over the samples. Settled error: largest mean "
        "error over the last fifth of a stretch of constant reference; who looks ahead and moves before a "
        "step pays for it here. Actuator travel: sum of |change of the input|. Missed: steps longer than the "
        "sampling time. Fallback: steps with a substitute for the input."
    )
    several = len(condition.keys(TRACKING)) > 1
    over = (
        f" Over {len(condition.seeds)} seeds, {'tracking cost, ' if several else ''}settled error, actuator "
        "travel, median and 99\u00a0% step time are medians, beyond bounds and longest step time are the "
        "largest, steps are summed."
    )
    return (
        f"{best}; where most are equal, nobody is marked.",
        meaning + (over if len(condition.seeds) > 1 else ""),
    )
