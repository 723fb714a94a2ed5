"""Published figures beside those of this study."""

import math
from typing import TYPE_CHECKING, NamedTuple

from ddpc_reports.comparison import Competitor, Condition, Spread, metric_unit
from ddpc_reports.numbers import MISSING, as_given, like, percent, significant, time_scale, unit_symbol
from ddpc_reports.table import Cell, Heading, Row, Table

if TYPE_CHECKING:
    from ddpc_cosim.study.sections import PublishedMethod, Reproduction

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
