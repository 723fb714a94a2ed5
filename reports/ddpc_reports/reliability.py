"""How often controllers fail, how bad their worst runs are, and which plant parameters go with it."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from markupsafe import Markup

from ddpc_cosim.files.tables import Cell, Heading, Row, Table
from ddpc_cosim.files.texts import clipped
from ddpc_cosim.study.verdicts.reliability import (
    QUANTILES,
    WORST,
    Association,
    Quantile,
    Reliability,
    extreme_runs,
    seeds_needed,
)
from ddpc_cosim.study.verdicts.sentences import bold, italic, join_words, rate_words
from ddpc_reports.comparison import Condition, ControllerResults, metric_unit, metric_words
from ddpc_reports.figures.charts import ranges_widely, tail_chart
from ddpc_reports.figures.figure import Figure, entry, one_chart
from ddpc_reports.figures.samples import column_name
from ddpc_reports.numbers import MISSING, fixed, significant, with_unit
from ddpc_reports.tables.table import controller_row
from ddpc_reports.verdict import Statement

_NAMED = 6
_FAILURES = "failures"


def reliability_statements(condition: Condition, reliabilities: Sequence[Reliability]) -> list[Statement]:
    """Say how often each controller fails, and which parameters go with failures and large figures."""
    labels = condition.by_key
    rates = [
        Markup("{} on {}").format(bold(labels[item.controller].label), rate_words(item.rate))
        for item in reliabilities
    ]
    text = Markup("Failed: {}; in brackets the exact 95\u00a0% interval of the probability.").format(
        _first(rates)
    )
    if condition.results.study.plant.sampling != "independent":
        text += (
            " It is that of independent seeds: these are spread evenly over the plants, so that it is too "
            "wide as a rule, and not exact."
        )
    statements = [Statement("How often", text)]
    if any(item.associations for item in reliabilities):
        statements.append(Statement("Parameters", _parameter_words(condition, reliabilities)))
    if any(case.batched for case in condition.cases):
        statements.append(Statement("Samples", _samples_words(condition)))
    return statements


def _samples_words(condition: Condition) -> Markup:
    """Say of which runs there are samples, and which are the worst."""
    cases, worst = condition.cases, []
    for controller in condition.controllers:
        seeds = [case.seed for case in extreme_runs(condition.results.study, controller.cases)[:WORST]]
        worst.append(
            Markup("{} with seeds {}").format(italic(controller.label), join_words(list(map(str, seeds))))
        )
    return Markup(
        "They are kept of {} of {} runs: those of the first seeds, and of each controller the {} worst, "
        "the middle and the best one. The worst are {}. Any other is made again by its seed, to the last bit."
    ).format(sum(case.has_samples for case in cases), len(cases), WORST, _first(worst))


def _first(parts: Sequence[Markup]) -> Markup:
    """Join the first of some parts, and say how many more the table has."""
    more = len(parts) - _NAMED
    return join_words([*parts[:_NAMED], *([f"{more} more, in the table"] if more > 0 else [])])


def _parameter_words(condition: Condition, reliabilities: Sequence[Reliability]) -> Markup:
    """Say what stands out of all associations; what does not is not said to have no effect."""
    sentences = [
        Markup("In runs of {}, {}.").format(italic(condition.by_key[item.controller].label), _goes_with(item))
        for item in reliabilities
        if any(association.stands_out for association in item.associations)
    ]
    compared = sum(len(item.associations) for item in reliabilities)
    if not sentences:
        return Markup("Of the parameters that seeds draw, none stands out in {} comparisons.").format(
            compared
        )
    rest = len(sentences) - _NAMED
    text = Markup(" ").join(sentences[:_NAMED]) + (f" {rest} more are in the table." if rest > 0 else "")
    return text + (
        " Each interval allows for all comparisons of the problem. These are associations: a parameter may "
        "go with what is the cause without being it."
    )


def _goes_with(item: Reliability) -> Markup:
    """Say which parameters stand out, those that go with a figure most closely first."""
    parameters_of: dict[str, list[str]] = {}
    for association in sorted(item.associations, key=lambda association: -abs(association.size)):
        if association.stands_out:
            which = "larger" if association.size > 0 else "smaller"
            name = clipped(association.parameter.partition(" [")[0])
            parameters_of.setdefault(association.key, []).append(f"a {which} {name} ({_size(association)})")
    parts = [
        Markup("{} goes with {}").format(
            f"worse {metric_words(key)}" if key else "failure", join_words(parameters)
        )
        for key, parameters in parameters_of.items()
    ]
    return join_words(parts)


def _size(association: Association) -> str:
    size = f"{fixed(association.size, 2)} [{fixed(association.low, 2)} … {fixed(association.high, 2)}]"
    return f"rank correlation {size}" if association.key else f"{size} standard deviations"


def reliability_table(
    condition: Condition, reliabilities: Sequence[Reliability], prefix: str
) -> Table | None:
    """Return failures, their probability, and quantiles of what controllers are ranked by."""
    if not reliabilities:
        return None
    shown = dict.fromkeys(
        quantile.share
        for item in reliabilities
        for key in condition.headline
        for quantile in item.quantiles(key)
    )
    headings = (
        Heading("Controller", numeric=False),
        Heading("failed", "seeds"),
        Heading("share", "%", group="probability of failure"),
        Heading("interval", "%", group="probability of failure"),
        *(
            Heading(title, group=f"{100 * share:g}\u00a0% of the runs are not worse than")
            for share in shown
            for title in ("value", "interval")
        ),
    )
    rows = tuple(
        row
        for key in condition.headline
        for item in reliabilities
        for row in [_row(condition.by_key[item.controller], item, key, shown)]
    )
    seeds = min(item.rate.seeds for item in reliabilities)
    missing = [share for share in QUANTILES if share not in shown]
    takes = [f"that of {100 * share:g}\u00a0% takes {seeds_needed(share)}" for share in missing]
    notes = (
        "Intervals of 95\u00a0%: of the probability the exact one of Clopper and Pearson, of quantiles that "
        "between two runs in order. A run that failed is worse than any that did not, and stands as failed."
        + (f" {seeds} seeds tell no other quantile: {' and '.join(takes)}." if takes else ""),
    )
    caption = f"How often each fails over {seeds} seeds, and how bad its worst runs are"
    return Table(
        f"{prefix}reliability", caption, headings, rows, notes, kind="grouped", download="reliability.csv"
    )


def _row(controller: ControllerResults, item: Reliability, key: str, shown: dict[float, None]) -> Row:
    rate, quantiles = item.rate, {quantile.share: quantile for quantile in item.quantiles(key)}
    cells = [
        Cell(f"{rate.failed} of {rate.seeds}", rate.failed, failed=rate.failed > 0),
        Cell(significant(100 * rate.share, 2), 100 * rate.share),
        Cell(
            f"{significant(100 * rate.low, 2)} … {significant(100 * rate.high, 2)}",
            f"{100 * rate.low!r} … {100 * rate.high!r}",
        ),
    ]
    for share in shown:
        cells += _quantile_cells(quantiles.get(share))
    group = " / ".join(filter(None, (metric_words(key), metric_unit(key))))
    return controller_row(controller, tuple(cells), group)


def _quantile_cells(quantile: Quantile | None) -> list[Cell]:
    if quantile is None:
        return [Cell(MISSING), Cell(MISSING)]
    low, high = _value_words(quantile.low), _value_words(quantile.high)
    return [
        Cell(_value_words(quantile.value), quantile.value, failed=math.isinf(quantile.value)),
        Cell(f"{low} … {high}" if low != high else low, f"{quantile.low!r} … {quantile.high!r}"),
    ]


def _value_words(value: float) -> str:
    return "failed" if math.isinf(value) else significant(value)


def association_table(
    condition: Condition, reliabilities: Sequence[Reliability], prefix: str
) -> Table | None:
    """Return how each parameter that seeds draw goes with failures and figures; None without any."""
    rows = tuple(
        controller_row(condition.by_key[item.controller], _association_cells(association))
        for item in reliabilities
        for association in item.associations
    )
    if not rows:
        return None
    headings = (
        Heading("Controller", numeric=False),
        Heading("parameter", numeric=False),
        Heading("goes with", numeric=False),
        Heading("runs"),
        Heading("size"),
        Heading("interval"),
        Heading("stands out", numeric=False),
    )
    notes = (
        "With figures: rank correlation (Spearman) with how bad they are, of runs that did not fail; "
        "interval by Fisher's z. With failures, from five failed runs on: mean of the failed less that of "
        "the others, in standard deviations. All intervals of the problem hold together with 95\u00a0% "
        "(Bonferroni). What is bad at both ends of a parameter has no rank correlation.",
    )
    return Table(
        f"{prefix}associations",
        "Which parameters go with failures and with bad figures",
        headings,
        rows,
        notes,
        kind="grouped folded",
        download="associations.csv",
    )


def _association_cells(association: Association) -> tuple[Cell, ...]:
    low, high = association.low, association.high
    return (
        Cell(clipped(association.parameter)),
        Cell(metric_words(association.key) if association.key else _FAILURES),
        Cell(str(association.runs), association.runs),
        Cell(fixed(association.size, 2), association.size),
        Cell(f"{fixed(low, 2)} … {fixed(high, 2)}", f"{low!r} … {high!r}"),
        Cell("yes" if association.stands_out else "no"),
    )


def tail_figures(condition: Condition, reliabilities: Sequence[Reliability], prefix: str) -> list[Figure]:
    """Return for what controllers are ranked by which share of the runs is as bad or worse."""
    return [
        figure
        for number, key in enumerate(condition.headline, start=1)
        if (figure := _tail_figure(condition, reliabilities, key, f"{prefix}tail-{number}"))
    ]


def _tail_figure(
    condition: Condition, reliabilities: Sequence[Reliability], key: str, identifier: str
) -> Figure | None:
    drawn = [(condition.by_key[item.controller], item) for item in reliabilities if item.tail(key)]
    rows = [row for controller, item in drawn for row in _tail_rows(controller, item, key)]
    if not rows:
        return None
    what, unit = metric_words(key, condition.every_key), metric_unit(key)
    widely = (
        " Both axes are logarithmic."
        if ranges_widely([row["value"] for row in rows])
        else (" Logarithmic axis of shares.")
    )
    caption = (
        f"Share of all runs in which {what} is as bad or worse. Runs that failed count as worse than any: "
        f"where a line ends above one run, the rest failed.{widely}"
    )
    names = [column_name(controller) for controller, _ in drawn]
    spec = tail_chart(rows, names, f"{what} / {unit}" if unit else what)
    (view,) = one_chart(identifier, "", caption, spec).views
    legend = tuple(entry(controller, of_first=False) for controller, _ in drawn)
    return Figure(identifier, "Tail", caption, (replace(view, names=tuple(names)),), legend)


def _tail_rows(controller: ControllerResults, item: Reliability, key: str) -> Iterator[dict[str, Any]]:
    label, name = clipped(controller.label), column_name(controller)
    for value, share in item.tail(key):
        shown = with_unit(significant(value, 3), metric_unit(key))
        yield {
            "key": name,
            "label": label,
            "value": float(f"{value:.6g}"),
            "share": float(f"{share:.6g}"),
            "text": f"{label}: {shown} or worse in {significant(100 * share, 2)}\u00a0%",
        }
