"""Limits promised and kept: in which share of the samples outputs were within limits, and were to be."""

import math
from statistics import fmean
from typing import Any

from ddpc_cosim.files.tables import Heading, Table
from ddpc_cosim.files.texts import clipped
from ddpc_reports.comparison import Condition, ControllerResults, metric_signal
from ddpc_reports.figures.charts import promise_chart
from ddpc_reports.figures.figure import Figure, Key, one_chart
from ddpc_reports.figures.samples import column_name
from ddpc_reports.numbers import significant
from ddpc_reports.tables.controllers import metric_column
from ddpc_reports.tables.table import controller_table, number_cells

PROMISE = "promised_satisfaction"
"""The diagnostic by which a controller says what share of the samples it promises, of each limited output."""


def promised(controller: ControllerResults) -> float:
    """Return what a controller promises [%], NaN if nothing; of several within it the least."""
    shares = [
        share
        for case in controller.cases
        for name, share in case.diagnostics.items()
        if name.rpartition(".")[2] == PROMISE
    ]
    return 100.0 * min(shares, default=math.nan)


def promise_figures(condition: Condition, prefix: str) -> list[Figure]:
    """Return a figure for each output with limits; none where no controller promises anything."""
    return [
        _figure(condition, key, f"{prefix}promised-{i}") for i, key in enumerate(_limited(condition), start=1)
    ]


def promise_table(condition: Condition, prefix: str) -> Table | None:
    """Return what is promised and kept, and the errors beside it; None where nothing is promised."""
    limited, members = _limited(condition), condition.controllers
    if not limited:
        return None
    columns = [(Heading("Promised", "%"), number_cells([promised(member) for member in members], better=""))]
    for key in limited:
        group = f"Limits of {metric_signal(key)} kept"
        shares = [[*member.by_seed(key).values()] for member in members]
        for title, of_seeds in (("all seeds", fmean), ("worst seed", min)):
            values = [of_seeds(kept) if kept else math.nan for kept in shares]
            columns.append((Heading(title, "%", group=group), number_cells(values, better="")))
    columns += [metric_column(condition, key) for key in condition.headline]
    note = (
        "Share of the samples with the output within its limits. What keeping them costs shows in the errors "
        "of the same method with and without a promise."
    )
    caption = "Limits promised and kept, per controller"
    return controller_table(f"{prefix}promised", caption, members, columns, (note,), "promised.csv")


def _limited(condition: Condition) -> list[str]:
    """Return the metrics of outputs with limits, where a controller promises to keep them."""
    if all(math.isnan(promised(controller)) for controller in condition.controllers):
        return []
    return [
        key
        for key in condition.keys("limits_kept")
        if any(controller.by_seed(key) for controller in condition.controllers)
    ]


def _figure(condition: Condition, key: str, identifier: str) -> Figure:
    signal, rows = metric_signal(key), list[dict[str, Any]]()
    for controller in condition.controllers:
        label, kept, share = clipped(controller.label), controller.by_seed(key), promised(controller)
        common = {"label": label, "key": column_name(controller)}
        rows += [
            common
            | {
                "value": value,
                "promise": False,
                "text": f"{label}, seed {seed}: {significant(value, 3)} % kept",
            }
            for seed, value in kept.items()
        ]
        if kept and not math.isnan(share):
            words = (
                f"{label}: {significant(share, 3)} % promised, {significant(fmean(kept.values()), 3)} % kept"
            )
            rows.append(common | {"value": share, "promise": True, "text": words})
    caption = f"Share of the samples in which {signal} keeps its limits, promised and measured."
    keys = (
        Key("one seed", "var(--ink-soft)", shape="dot"),
        Key("all seeds", "var(--ink)", shape="tick"),
        Key("promised", "var(--limit)", shape="triangle"),
    )
    return one_chart(
        identifier, "Limits promised and kept", caption, promise_chart(rows, "limits kept / %"), keys=keys
    )
