"""Controllers compared: in one scenario, with published values, and with what a source claims of them."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from markupsafe import Markup

from ddpc_cosim import StudyResults
from ddpc_cosim.files.tables import Cell, Heading, Row, Table, text_headings
from ddpc_cosim.metrics import all_metrics, metric_name, metric_of, split_key
from ddpc_cosim.responses import StepTimes
from ddpc_cosim.study.file_format.sections import ClaimSection, PublishedMethod, Reproduction
from ddpc_cosim.study.verdicts.claims import check_claims
from ddpc_cosim.study.verdicts.sentences import italic
from ddpc_reports.comparison import (
    Condition,
    ControllerResults,
    Spread,
    labels,
    metric_signal,
    metric_unit,
    metric_words,
    shown_as,
    spread,
)
from ddpc_reports.numbers import (
    MINUS,
    MISSING,
    as_given,
    computed,
    like,
    percent,
    significant,
    time_scale,
    unit_symbol,
)
from ddpc_reports.tables.table import Column, controller_table, number_cells
from ddpc_reports.verdict import Statement

RESPONSE = ("rise_time", "settling_time", "overshoot", "anticipation", "settled_error", "rmse")
"""What the section on the step response shows."""
LIMITS = (
    "bound_violation_max",
    "bound_violation_time",
    "total_variation",
    "max_abs_change",
    "max_abs_input",
    "time_at_bounds",
)
"""What the section on limits and actuators shows."""
KEY_FIGURES = (
    "tdis_tot",
    "idis_tot",
    "ener_tot",
    "cost_tot",
    "emis_tot",
    "pele_tot",
    "pgas_tot",
    "pdih_tot",
    "time_rat",
    "atvl_tot",
)
"""What the section on key figures of buildings shows."""


def response_table(condition: Condition, prefix: str) -> Table | None:
    """Return the figures of the step response, a row per controller; None if the references have no steps."""
    columns = _columns(condition, RESPONSE)
    if not condition.keys("overshoot"):  # outputs with bands alone
        return None
    if all(math.isnan(float(cell.raw)) for _, cells in columns for cell in cells):
        return None
    preview = condition.results.provenance.get("largest preview", "as many samples as anyone looks ahead")
    notes = (
        f"From each step of the reference until {preview} before the next one: until then, every controller "
        "answers the same step. Of a run that failed there are none. "
        + meanings(RESPONSE)
        + " A dash: a time is not reached, an output was not at rest to leave, or its reference has no steps."
    )
    if len(condition.seeds) > 1:
        notes += " Medians over the seeds; a time that is not reached counts as longer than any."
    caption = "Step response, per controller"
    return controller_table(
        f"{prefix}response", caption, condition.controllers, columns, (notes,), "response.csv"
    )


def limits_table(condition: Condition, prefix: str) -> Table | None:
    """Return how far outputs went beyond their limits and how far actuators moved, a row per controller."""
    columns = _columns(condition, LIMITS)
    if not columns:
        return None
    notes = meanings(LIMITS)
    if len(condition.seeds) > 1:
        notes += " Over the seeds: the constraint violation is the largest, the others are medians."
    caption = "Limits and actuators, per controller"
    return controller_table(
        f"{prefix}limits", caption, condition.controllers, columns, (notes,), "limits.csv"
    )


def key_figures_table(condition: Condition, prefix: str) -> Table | None:
    """Return the key figures of a building, a row per controller; None where a study asks for none."""
    columns = _columns(condition, KEY_FIGURES)
    if not columns:
        return None
    notes = "As BOPTEST defines them. " + meanings([name for name in KEY_FIGURES if condition.keys(name)])
    if len(condition.seeds) > 1:
        notes += " Medians over the seeds."
    caption = "Key figures, per controller"
    return controller_table(
        f"{prefix}key-figures", caption, condition.controllers, columns, (notes,), "key-figures.csv"
    )


def _columns(condition: Condition, names: Sequence[str]) -> list[Column]:
    return [metric_column(condition, key) for name in names for key in condition.keys(name)]


def meanings(names: Sequence[str], keys: Sequence[str] = ()) -> str:
    """Say what the metrics of a table are, among the keys of which those of bands have names of their own."""
    metrics = all_metrics()
    called = {split_key(key)[0]: metric_name(key, keys) for key in keys}
    sentences = (f"{called.get(name, metric_name(name))}: {metrics[name].description}." for name in names)
    return " ".join(sentences).replace(" - ", f" {MINUS} ")


def metric_column(condition: Condition, key: str) -> Column:
    """Return a metric of every controller, under the head of the metric where several signals have it."""
    values = [controller.summed(key) for controller in condition.controllers]
    unit, factor = shown_as(key, values)
    shown = [value * factor for value in values]
    cells = _median_cells(condition, key, shown, 4 if key in condition.headline else 3)
    if len(condition.keys(split_key(key)[0])) > 1:
        return Heading(metric_signal(key), unit, group=condition.name_of(key)), cells
    return Heading(condition.name_of(key), unit), cells


def _median_cells(condition: Condition, key: str, values: Sequence[float], digits: int = 4) -> list[Cell]:
    """Return a column, in which the best are marked and those that the seeds do not tell apart from them.

    One of which cases failed has values of the easier seeds only: it is not marked.
    """
    members = condition.controllers
    eligible = [condition.may_win(member) for member in members]
    alike = condition.alike(key, members)
    return number_cells(values, eligible=eligible, better=metric_of(key).better, digits=digits, alike=alike)


_HEADINGS = (
    *text_headings("Method and metric", "unit"),
    Heading("published"),
    Heading("published-code variant", group="here, first seed"),
    Heading("as printed", group="here, first seed"),
    Heading("median", group="here, over the seeds"),
    Heading("range", group="here, over the seeds"),
    Heading("holds the published", numeric=False, group="here, over the seeds"),
    Heading("deviation", "from published"),
)


_SUMMED = "sum_abs_error"


class _Compared(NamedTuple):
    """One published value and what corresponds to it here."""

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
        if not self.seeds.varies or math.isnan(self.published):
            return MISSING
        return "yes" if self.seeds.low <= self.published <= self.seeds.high else "no"


def reproduction_table(condition: Condition, reproduction: Reproduction, prefix: str) -> Table:
    """Return published values, both variants of each method here, spread over seeds, and deviation."""
    controllers = condition.by_key
    rows = [
        row
        for method in reproduction.methods
        for key, title in reproduction.metrics.items()
        if key in method.values
        for row in _rows(f"{metric_name(key)} ({title})", key, method, controllers)
    ]
    return Table(
        f"{prefix}reproduction",
        f"{reproduction.source}: published and reproduced here (seed {condition.seeds[0]} and "
        f"{len(condition.seeds)} seeds in all)",
        _HEADINGS,
        tuple(rows),
        (
            "Median, range and deviation are those of the published-code variant where there is one, "
            "otherwise of the method as printed; the deviation is that of the first seed. "
            "Computation times of other machines are shown, not compared.",
        ),
        kind="grouped",
        download="reproduction.csv",
    )


def reproduction_statements(condition: Condition, reproduction: Reproduction) -> list[Statement]:
    """Return how the order of computation times here compares with the published one, where there is one."""
    controllers = condition.by_key
    statements = []
    for key, title in reproduction.metrics.items():
        measured = {
            method.label: controllers[method.printed].over_seeds(key).median
            for method in reproduction.methods
            if _is_step_time(key) and key in method.values and method.printed in controllers
        }
        here = sorted((value, label) for label, value in measured.items() if not math.isnan(value))
        if len(here) > 1:
            published = sorted(
                (method.values[key], method.label)
                for method in reproduction.methods
                if method.label in {label for _, label in here}
            )
            statements.append(Statement(f"{title}, order", _order(published, here)))
    return statements


def _order(published: list[tuple[float, str]], here: list[tuple[float, str]]) -> Markup:
    """Compare two orders in words; of times on different machines only ratios within one are stated."""
    there, mine = ([label for _, label in order] for order in (published, here))
    same = "the same" if there == mine else "reversed" if there == mine[::-1] else "another"
    return Markup("Published, shortest first: {}. In this run, {} order: {}.").format(
        _times_words(published), same, _times_words(here)
    )


def _times_words(order: list[tuple[float, str]]) -> Markup:
    least = order[0][0]
    rest = [
        italic(label) + (f" (about {significant(value / least, 2)} times as long)" if least > 0 else "")
        for value, label in order[1:]
    ]
    return Markup(", ").join([italic(order[0][1]), *rest])


def _is_step_time(key: str) -> bool:
    """Whether a metric is a wall-clock time, which says as much of the machine as of the method."""
    metric = metric_of(key)
    return metric.of is StepTimes and metric.unit == "s"


def _rows(
    title: str, key: str, method: PublishedMethod, controllers: dict[str, ControllerResults]
) -> list[Row]:
    """Return the row of a published value; two where it counts samples at rest that the loop here lacks."""
    if not method.rest_samples or split_key(key)[0] != _SUMMED:
        return [_row(title, key, method, controllers)]
    samples = f"{method.rest_samples} {'sample' if method.rest_samples == 1 else 'samples'} at rest"
    from_first_decision = replace(method, values={key: math.nan}, rest_samples=0)
    return [
        _row(f"{title}, from the first decision on", key, from_first_decision, controllers),
        _row(f"{title}, {samples} counted too, as published", key, method, controllers),
    ]


def _row(title: str, key: str, method: PublishedMethod, controllers: dict[str, ControllerResults]) -> Row:
    compared = _compare(key, method, controllers)
    scale, unit = 1.0, metric_unit(key)
    if unit == "s":
        unit, scale = time_scale([compared.published])
    # Scaling leaves rounding errors that are not digits of the publication.
    published = computed(compared.published * scale)
    comparable = not _is_step_time(key)
    cells = (
        Cell(unit or MISSING, unit_symbol(unit)),
        Cell(MISSING if math.isnan(published) else as_given(published), published),
        *(
            _value(value * scale, published)
            for value in (compared.code, compared.printed, compared.seeds.median)
        ),
        _range(compared.seeds, scale),
        Cell(compared.within, compared.within) if comparable else Cell(MISSING),
        Cell(percent(compared.deviation), compared.deviation) if comparable else Cell(MISSING, math.nan),
    )
    return Row(title, cells, group=method.label)


def _compare(key: str, method: PublishedMethod, controllers: dict[str, ControllerResults]) -> _Compared:
    code, printed = controllers.get(method.published_code), controllers.get(method.printed)
    both, rest = (code, printed), method.rest_samples
    by_seed = [_with_rest(controller, key, rest) if controller else {} for controller in both]
    first_code, first_printed = (
        values.get(controller.first_seed, math.nan) if controller else math.nan
        for controller, values in zip(both, by_seed, strict=True)
    )
    seeds = spread(by_seed[0 if code else 1].values())
    return _Compared(method.values[key], first_code, first_printed, seeds)


def _with_rest(controller: ControllerResults, key: str, samples: int) -> dict[int, float]:
    """Return a metric by seed; sums of errors with the error of so many samples at rest added."""
    values = controller.by_seed(key)
    if not samples or split_key(key)[0] != _SUMMED:
        return values
    for case in controller.completed:
        trace, signal = case.trace(), split_key(key)[1]
        i = [output.name for output in trace.outputs].index(signal)
        at_rest = abs(trace.reference[0, i] - trace.y[0, i]) * abs(trace.outputs[i].shown_in.factor)
        values[case.seed] += samples * float(at_rest)
    return values


def _value(value: float, published: float) -> Cell:
    return Cell(significant(value, 5) if math.isnan(published) else like(value, published), value)


def _range(seeds: Spread, scale: float) -> Cell:
    if not seeds.varies:
        return Cell(MISSING)
    return Cell(f"{significant(seeds.low * scale)} … {significant(seeds.high * scale)}")


def claims_table(results: StudyResults, prefix: str) -> Table | None:
    """Return a row per claim: whether it holds, and in how many runs of each scenario; None without any."""
    study = results.study
    checked = check_claims(study, results.cases)
    if not checked:
        return None
    ran = [name for name in study.scenarios if any(name in claim.runs for claim in checked)]
    rows = []
    for section, claim in zip(study.report.claims, checked, strict=True):
        counts = [claim.runs.get(name, (0, 0)) for name in ran]
        cells = [Cell(f"{true} of {judged}" if judged else MISSING, true) for true, judged in counts]
        verdict = Cell(claim.verdict, failed=claim.judged > 0 and not claim.true)
        rows.append(Row(claim.text, (verdict, Cell(_checked_by(section, results)), *cells)))
    titles = [study.scenarios[name].label or name for name in ran] if len(ran) > 1 else ["runs"]
    headings = (
        *text_headings("Claim", "here it", "checked by"),
        *(Heading(title, "runs" if len(ran) > 1 else "") for title in titles),
    )
    source = f"What is claimed in {study.source}" if study.source else "What is claimed"
    notes = (
        "A claim is checked on each seed of a scenario. It is not so where a controller that it is of "
        "failed, and cannot be judged where only another failed, or has no such figure.",
    )
    return Table(f"{prefix}claims", source, headings, tuple(rows), notes, download="claims.csv")


def _checked_by(claim: ClaimSection, results: StudyResults) -> str:
    """Say what has to be so for a claim to be so."""
    name = labels(results)
    what = metric_words(claim.metric)
    if claim.order:
        return f"{what}: {' < '.join(name.get(key, key) for key in claim.order)}"
    if claim.alike:
        who = name.get(claim.alike, claim.alike)
        return f"{what}: no more than {as_given(claim.within)} % apart over the sweep of {who}"
    kind, who = ("lowest", claim.lowest) if claim.lowest else ("highest", claim.highest)
    return f"{what}: {kind} with {name.get(who, who)}"
