"""What the controllers say about the data or the model that they work with."""

import math

from ddpc_reports.comparison import Competitor, Condition, Spread, spread
from ddpc_reports.numbers import MISSING, integer, significant
from ddpc_reports.table import Cell, Heading, Row, Table

_TITLES = {
    "pe_order": "PE order reached",
    "pe_order_needed": "PE order needed",
    "data_rows": "data rows",
    "data_columns": "data columns",
    "data_rank": "rank",
    "smallest_singular_value": "smallest singular value",
}


def diagnostics_table(condition: Condition, prefix: str) -> Table | None:
    """Return what the controllers say about their data, first seed and range; None if they say nothing."""
    talkers = [one for one in condition.competitors if any(case.diagnostics for case in one.cases)]
    if not talkers:
        return None
    several = len(condition.seeds) > 1
    headings = (
        Heading("Diagnostic", numeric=False),
        Heading(f"seed {condition.seeds[0]}"),
        *([Heading("range over the seeds")] if several else []),
    )
    return Table(
        f"{prefix}diagnostics",
        "Data that the controllers learned from",
        headings,
        tuple(row for one in talkers for row in _rows(one, several=several)),
        (
            "PE order: order of persistent excitation of the recorded inputs. "
            "Rank and singular value: of the stacked data.",
        ),
        kind="grouped facts",
        download="diagnostics.csv",
    )


def _rows(one: Competitor, *, several: bool) -> list[Row]:
    given = dict.fromkeys(name for case in one.cases for name in case.diagnostics)
    ordered = [name for name in _TITLES if name in given] + [name for name in given if name not in _TITLES]
    rows = []
    for name in ordered:
        values = [case.diagnostics.get(name, math.nan) for case in one.cases]
        first = one.cases[0].diagnostics.get(name, math.nan)
        cells = [Cell(_written(first), first)]
        if several:
            cells.append(Cell(_range(spread(values))))
        rows.append(Row(_TITLES.get(name, name.replace("_", " ")), tuple(cells), group=one.label))
    return rows


def _range(figure: Spread) -> str:
    return f"{_written(figure.low)} … {_written(figure.high)}" if figure.varies else MISSING


def _written(value: float) -> str:
    return integer(value) if value.is_integer() and abs(value) < 1e6 else significant(value)
