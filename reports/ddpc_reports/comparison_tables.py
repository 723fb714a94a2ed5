"""Controllers compared: in one scenario, from scenario to scenario, and with published figures."""

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from ddpc_reports.comparison import (
    STEP_TIMES,
    TRACKING,
    Competitor,
    Condition,
    Spread,
    metric_keys,
    metric_signal,
    metric_unit,
)
from ddpc_reports.numbers import MINUS, MISSING, as_given, like, percent, significant, time_scale, unit_symbol
from ddpc_reports.table import Cell, Heading, Row, Table, number_cells, range_texts

if TYPE_CHECKING:
    from ddpc_cosim.study.sections import PublishedMethod, Reproduction

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


_COMPARED = {
    TRACKING: "tracking cost",
    "settled_error": "settled error",
    "total_variation": "actuator travel",
}


def across_table(conditions: Sequence[Condition], prefix: str) -> Table | None:
    """Return medians of the main figures, a row per controller and a column per scenario; None for one."""
    if len(conditions) < 2:
        return None
    rows = [
        row
        for name, title in _COMPARED.items()
        for key in metric_keys(conditions, name)
        for row in _rows(conditions, key, _title(key, title))
    ]
    headings = (Heading("Controller", numeric=False), *(Heading(one.label) for one in conditions))
    over = max(len(condition.seeds) for condition in conditions)
    notes = (
        "Bold and tinted: the smallest in a scenario, among controllers that completed every case.",
        *((f"Medians over {over} seeds.",) if over > 1 else ()),
    )
    return Table(
        f"{prefix}across",
        "Scenarios beside each other",
        headings,
        tuple(rows),
        notes,
        kind="grouped",
        download="scenarios.csv",
    )


def _rows(conditions: Sequence[Condition], key: str, group: str) -> list[Row]:
    by_key = [{one.key: one for one in condition.competitors} for condition in conditions]
    everybody = {one.key: one for members in by_key for one in members.values()}
    columns = [_column([members.get(name) for name in everybody], key) for members in by_key]
    return [
        Row(one.label, tuple(cells[i] for cells in columns), one.key, one.index, group)
        for i, one in enumerate(everybody.values())
    ]


def _column(members: Sequence[Competitor | None], key: str) -> list[Cell]:
    values = [one.over_seeds(key).median if one else float("nan") for one in members]
    return number_cells(values, eligible=[bool(one and one.completed_all) for one in members])


def _title(key: str, words: str) -> str:
    signal = metric_signal(key)
    return " / ".join(filter(None, (f"{words} of {signal}" if signal else words, metric_unit(key))))


_HEADINGS = (
    Heading("Method and metric", numeric=False),
    Heading("unit", numeric=False),
    Heading("published"),
    Heading("published-code variant", group="here, first seed"),
    Heading("as printed", group="here, first seed"),
    Heading("median", group="here, over the seeds"),
    Heading("range", group="here, over the seeds"),
    Heading("holds the published", numeric=False, group="here, over the seeds"),
    Heading("deviation", "from published"),
)


class _Compared(NamedTuple):
    """One published value and what stands for it here."""

    published: float
    code: float
    printed: float
    seeds: Spread

    @property
    def deviation(self) -> float:
        """Relative deviation of the published-code variant, else of the printed method."""
        here = self.printed if math.isnan(self.code) else self.code
        return (here - self.published) / abs(self.published) if self.published else math.nan

    @property
    def within(self) -> str:
        """Whether the published value lies in the range over the seeds, in words."""
        if not self.seeds.varies:
            return MISSING
        return "yes" if self.seeds.low <= self.published <= self.seeds.high else "no"


def reproduction_table(condition: Condition, reproduction: "Reproduction", prefix: str) -> Table:
    """Return published values, both variants of each method here, spread over seeds, and deviation."""
    competitors = {one.key: one for one in condition.competitors}
    rows = [
        _row(title, key, method, competitors)
        for method in reproduction.methods
        for key, title in reproduction.metrics.items()
        if key in method.values
    ]
    return Table(
        f"{prefix}reproduction",
        f"{reproduction.source}: published and reproduced here (seed {condition.seeds[0]} and "
        f"{len(condition.seeds)} seeds in all)",
        _HEADINGS,
        tuple(rows),
        (
            "Median, range and deviation are those of the published-code variant where there is one, "
            "otherwise of the method as printed; the deviation is that of the first seed.",
        ),
        kind="grouped",
        download="reproduction.csv",
    )


def _row(title: str, key: str, method: "PublishedMethod", competitors: dict[str, Competitor]) -> Row:
    compared = _compare(key, method, competitors)
    scale, unit = 1.0, metric_unit(key)
    if unit == "s":
        unit, scale = time_scale([compared.published])
    # Scaling leaves rounding errors that are no digits of the publication.
    published = float(f"{compared.published * scale:.12g}")
    cells = (
        Cell(unit or MISSING, unit_symbol(unit)),
        Cell(as_given(published), published),
        *(
            _value(value * scale, published)
            for value in (compared.code, compared.printed, compared.seeds.median)
        ),
        _range(compared.seeds, scale),
        Cell(compared.within, compared.within),
        Cell(percent(compared.deviation), compared.deviation),
    )
    return Row(title, cells, group=method.label)


def _compare(key: str, method: "PublishedMethod", competitors: dict[str, Competitor]) -> _Compared:
    code, printed = competitors.get(method.published_code), competitors.get(method.printed)
    stand_in = code or printed
    return _Compared(
        method.values[key],
        code.at_first(key) if code else math.nan,
        printed.at_first(key) if printed else math.nan,
        stand_in.over_seeds(key) if stand_in else Spread(math.nan, math.nan, math.nan, 0),
    )


def _value(value: float, published: float) -> Cell:
    return Cell(like(value, published), value)


def _range(seeds: Spread, scale: float) -> Cell:
    if not seeds.varies:
        return Cell(MISSING)
    return Cell(f"{significant(seeds.low * scale)} … {significant(seeds.high * scale)}")
