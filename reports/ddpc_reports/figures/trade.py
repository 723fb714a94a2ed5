"""Comfort against money: what each controller costs and what it leaves, scenario by scenario."""

import math
from collections.abc import Sequence
from typing import Any

from ddpc_cosim.files.texts import clipped
from ddpc_cosim.metrics import discomfort, metric_name
from ddpc_reports.comparison import Condition, ControllerResults, metric_unit, metric_words
from ddpc_reports.embedding import drawing
from ddpc_reports.figures.charts import trade_chart
from ddpc_reports.figures.figure import Figure, Key, View, entry
from ddpc_reports.figures.samples import column_name
from ddpc_reports.figures.time_charts import NARROW, WIDE
from ddpc_reports.numbers import significant, with_unit


def trade_figure(conditions: Sequence[Condition], prefix: str) -> Figure | None:
    """Return a panel for each scenario, and output if there are several; None without prices.

    Parameters
    ----------
    conditions : sequence of Condition
        The scenarios of a problem.
    prefix : str
        What the figure's name in the page begins with.
    """
    places = [
        (condition, money, left)
        for condition in conditions
        for money in condition.keys("money")[:1]
        for left in discomfort(condition.every_key)
    ]
    charts = [(place, rows) for place in places if (rows := trade_rows(*place))]
    if not charts:
        return None
    width = WIDE if len(charts) == 1 else NARROW
    fronts = [sum(row["front"] for row in rows) for _, rows in charts]
    joined = len({left for _, _, left in places}) == 1 and max(fronts) > 1
    views, shown = [], dict[str, ControllerResults]()
    for number, ((condition, money, left), rows) in enumerate(charts, 1):
        titles = [_axis(money, metric_name(money)), _axis(left, metric_words(left, condition.every_key))]
        alike = [row for (_, *keys), others in charts if keys == [money, left] for row in others]
        values = [[row[side] for row in alike] for side in "xy"]
        spec = trade_chart(rows, titles, values, joined=joined, width=width)
        medians = "; ".join(row["text"] for row in rows if row["median"])
        description = f"{clipped(condition.label)}: {titles[1]} over {titles[0]}: {medians}"
        name = f"{prefix}trade-{number}"
        title = clipped(condition.label) if len(conditions) > 1 else ""
        views.append(View(name, title, description, spec, drawing(spec, name, description)))
        drawn = {row["key"] for row in rows}
        shown |= {c.key: c for c in condition.controllers if column_name(c) in drawn}
    legend = tuple(entry(controller, of_first=False) for controller in shown.values())
    every_row = [row for _, rows in charts for row in rows]
    has_seeds = not all(row["median"] for row in every_row)
    median = "median over the seeds" if has_seeds else "controller"
    keys = (
        Key(median, "var(--ink-soft)", shape="dot"),
        *([Key("one seed", "var(--ink-soft)", shape="small-dot")] if has_seeds else []),
        *([Key("reference point", "var(--ink)", shape="ring")] if any(r["point"] for r in every_row) else []),
        *([Key("no other is better in one and as good in the other", "var(--ink-soft)")] if joined else []),
    )
    caption = "Comfort against money, lower and further left is better. Runs that failed are left out."
    return Figure(f"{prefix}trade", "Comfort against money", caption, tuple(views), legend, keys=keys)


def trade_rows(condition: Condition, money: str, left: str) -> list[dict[str, Any]]:
    """Return the dots of a scenario: the medians of each controller, cheapest first, then its seeds."""
    medians, seeds = list[dict[str, Any]](), list[dict[str, Any]]()
    for controller in condition.controllers:
        cases = [
            (case.seed, case.metrics.get(money, math.nan), case.metrics.get(left, math.nan))
            for case in controller.succeeded
        ]
        of_seeds = [(seed, x, y) for seed, x, y in cases if math.isfinite(x) and math.isfinite(y)]
        if not of_seeds:
            continue
        middle = controller.over_seeds(money).median, controller.over_seeds(left).median
        medians.append(_row(controller, *middle, money, left, "median") | {"median": True})
        seeds += [_row(controller, x, y, money, left, f"seed {seed}") for seed, x, y in of_seeds]
    best = math.inf
    medians.sort(key=lambda row: (row["x"], row["y"]))
    for row in medians:
        row["front"] = row["y"] < best
        best = min(best, row["y"])
    return medians + (seeds if len(seeds) > len(medians) else [])


def _row(
    controller: ControllerResults, x: float, y: float, money: str, left: str, which: str
) -> dict[str, Any]:
    values = (with_unit(significant(value, 3), metric_unit(key)) for key, value in ((money, x), (left, y)))
    label = clipped(controller.label)
    return {
        "x": float(f"{x:.6g}"),
        "y": float(f"{y:.6g}"),
        "key": column_name(controller),
        "label": label,
        "median": False,
        "front": False,
        "point": controller.is_point,
        "text": f"{label}, {which}: {', '.join(values)}",
    }


def _axis(key: str, what: str) -> str:
    return f"{what} / {metric_unit(key)}" if metric_unit(key) else what
