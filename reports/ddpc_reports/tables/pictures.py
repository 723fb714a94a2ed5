"""Pictures in the rows of the ranking: a bar under a figure, a line of the response, bars place by place."""

import math
from collections.abc import Sequence
from dataclasses import replace
from statistics import median

from markupsafe import Markup

from ddpc_cosim.files.tables import Cell
from ddpc_cosim.files.texts import clipped
from ddpc_reports.comparison import Condition, ControllerResults
from ddpc_reports.figures.charts import colour
from ddpc_reports.figures.samples import column_name, first_outputs
from ddpc_reports.figures.signal import known
from ddpc_reports.figures.small import sparkline
from ddpc_reports.figures.svg import bar, bars
from ddpc_reports.numbers import significant

_LONGEST = 5.0
"""Times the median of a column: longer bars are cut off."""
_HIGHEST = 3.0
"""Times the best: higher bars are cut off."""


def with_bars(cells: Sequence[Cell], controllers: Sequence[ControllerResults]) -> list[Cell]:
    """Return the cells of a column with bars as long as their values; none where there is nothing to see.

    The longest is the largest value, or five times the median if that is less: one that is far off would
    leave the others without a length.
    """
    values = [float(cell.raw) if isinstance(cell.raw, int | float) else math.nan for cell in cells]
    finite = [value for value in values if math.isfinite(value)]
    if len(finite) < 2 or min(finite) < 0 or not max(finite) > 0:
        return [*cells]
    longest = min(max(finite), _LONGEST * median(finite)) or max(finite)
    return [
        replace(cell, drawing=bar(value / longest, _bar_words(value, longest), colour(controller.index)))
        if math.isfinite(value)
        else cell
        for cell, value, controller in zip(cells, values, controllers, strict=True)
    ]


def _bar_words(value: float, longest: float) -> str:
    if value > longest:
        return "bar: longer than there is room for"
    return f"bar: {100 * value / longest:.0f} % of the longest"


def responses_in_rows(condition: Condition, order: Sequence[ControllerResults]) -> list[Markup]:
    """Return the first output of the first seed of each controller; without a run nothing."""
    signal = first_outputs(condition)
    if signal is None:
        return [Markup("")] * len(order)
    names = [name for name in map(column_name, order) if name in signal.columns]
    ends, wanted = signal.extent(names), [signal.columns[name] for name in signal.wanted]
    pictures = []
    for controller in order:
        column = signal.columns.get(column_name(controller), [])
        if not (values := known(column)):
            pictures.append(Markup(""))
            continue
        low, high, last = (significant(value, 3) for value in (min(values), max(values), values[-1]))
        label = f"{clipped(controller.label)}: {signal.title}, from {low} to {high}, at the end {last}"
        pictures.append(sparkline(signal.columns["t"], column, wanted, ends, label, controller.index))
    return pictures


def ratio_to(best: float, value: float) -> float:
    """Return how many times the best a value is; NaN where either is not known."""
    if math.isnan(best) or math.isnan(value):
        return math.nan
    return value / best if best else math.inf if value else 1.0


def ratios_in_row(controller: ControllerResults, ratios: Sequence[float]) -> Markup:
    """Return a bar for each place as high as the ratio to the best there, up to three times."""
    finite = [ratio for ratio in ratios if not math.isnan(ratio)]
    if not finite:
        return Markup("")
    missing = len(ratios) - len(finite)
    low, high = (significant(end, 2) for end in (min(finite), max(finite)))
    label = f"{clipped(controller.label)}: {low} to {high} times the best of a place"
    label += f", none in {missing} of {len(ratios)}" if missing else ""
    return bars(
        [min(ratio / _HIGHEST, 1.0) for ratio in ratios], 1.0 / _HIGHEST, label, colour(controller.index)
    )
