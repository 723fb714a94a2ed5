"""Tables of the page: a row per controller, columns of numbers in line, and which of them are best."""

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from typing import Any, Literal

from ddpc_cosim.files.tables import Cell, Heading, Row, Table
from ddpc_reports.comparison import ControllerResults
from ddpc_reports.numbers import MISSING, apart, column

Alike = Callable[[int], Collection[int]]
"""Of the place of a controller in a column, the places of those that the seeds do not tell apart from it."""
Column = tuple[Heading, list[Cell]]
"""A heading and a cell for each row."""


def controller_table(
    identifier: str,
    caption: str,
    controllers: Sequence[ControllerResults],
    columns: Sequence[Column],
    notes: tuple[str, ...],
    download: str,
    *,
    pictures: Sequence[str] = (),
    **more: Any,
) -> Table:
    """Return a table with a row per controller, perhaps with a picture; ``more`` are further fields of it."""
    drawn = pictures or [""] * len(controllers)
    rows = tuple(
        replace(controller_row(controller, tuple(cells[i] for _, cells in columns)), drawing=drawn[i])
        for i, controller in enumerate(controllers)
    )
    headings = (Heading("Controller", numeric=False), *(heading for heading, _ in columns))
    return Table(identifier, caption, headings, rows, notes, download=download, **more)


def controller_row(
    controller: ControllerResults, cells: tuple[Cell, ...], group: str = "", header: str = ""
) -> Row:
    """Return a row of a controller, under its label or a header that says more."""
    label = controller.label
    return Row(header or label, cells, controller.key, controller.index, group)


def number_cells(
    values: Sequence[float],
    *,
    eligible: Iterable[bool] = (),
    better: Literal["low", "high", ""] = "low",
    digits: int = 4,
    alike: Alike | None = None,
) -> list[Cell]:
    """Return a column of cells with decimal points in line; the lowest or highest eligible value is the best.

    Those that are ``alike``, else values that read alike, share the mark; where more than half do, none is
    best.
    """
    texts = column(values, digits)
    able = list(eligible) or [False] * len(values)
    best = _best(values, texts, able, better, alike) if better else set()
    return [
        Cell(text, value, best=i in best) for i, (text, value) in enumerate(zip(texts, values, strict=True))
    ]


def interval_texts(ends: Sequence[tuple[float, float]], digits: int = 4) -> list[str]:
    """Write the intervals of a column with one number of decimals, more where they would have no width."""
    texts = column([end for interval in ends for end in interval], digits)
    return [
        MISSING
        if math.isnan(interval[0])
        else " … ".join(
            apart(*interval) if low == high and interval[0] < interval[1] else (low.strip(), high.strip())
        )
        for interval, low, high in zip(ends, texts[::2], texts[1::2], strict=True)
    ]


def _best(
    values: Sequence[float],
    texts: Sequence[str],
    able: Sequence[bool],
    better: Literal["low", "high"],
    alike: Alike | None,
) -> set[int]:
    known = [i for i, value in enumerate(values) if able[i] and not math.isnan(value)]
    if len(known) < 2:
        return set()
    first = (min if better == "low" else max)(known, key=lambda i: values[i])
    others = alike(first) if alike else [i for i in known if texts[i] == texts[first]]
    best = {first, *others} & {*known}
    # What most of them reach distinguishes none of them.
    return best if 2 * len(best) <= len(known) else set()
