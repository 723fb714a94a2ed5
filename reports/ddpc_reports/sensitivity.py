"""The section on sweeps: a map of the tracking error over the settings that were varied."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from markupsafe import Markup

from ddpc_cosim import StudyResults
from ddpc_cosim.files.tables import Cell, Heading, Row, Table, text_headings
from ddpc_cosim.files.texts import clipped
from ddpc_cosim.metrics import metric_of
from ddpc_cosim.study.file_format.sweeps import variant_words
from ddpc_cosim.study.verdicts.ranks import setting_effect
from ddpc_reports.comparison import (
    Condition,
    ControllerResults,
    conditions,
    metric_signal,
    metric_unit,
    metric_words,
    spread as summed_up,
)
from ddpc_reports.figures.charts import heat_chart
from ddpc_reports.figures.figure import Figure, one_chart
from ddpc_reports.numbers import as_given, percent, significant, with_unit
from ddpc_reports.tables.table import number_cells
from ddpc_reports.verdict import Statement, by_signal, formatter

_FAILING_SHOWN = 3


@dataclass(frozen=True)
class Sweep:
    """The variants of one controller that differ from it in the same settings."""

    condition: Condition
    base: str
    settings: tuple[str, ...]
    variants: tuple[ControllerResults, ...]

    @property
    def label(self) -> str:
        """Label of the controller that is varied."""
        section = self.condition.results.study.controllers.get(self.base)
        return (section.label if section else "") or self.base

    @property
    def axes(self) -> tuple[str, ...]:
        """The one or two settings that are drawn."""
        return self.settings[:2]

    def words(self, controller: str, setting: str) -> str:
        """Return a controller's value of a setting; of an object, what distinguishes it in this sweep."""
        value = self.value(controller, setting)
        if value is None:
            return ""
        if not isinstance(value, dict):
            return as_given(value)
        telling = (key for key in value if len(self._entries(setting, key)) > 1)
        return ", ".join(f"{key} {as_given(value[key])}" for key in telling)

    def place(self, variant: ControllerResults) -> str:
        """Return the settings of a variant in words."""
        return ", ".join(f"{name} = {self.words(variant.key, name)}" for name in self.settings)

    def value(self, controller: str, setting: str) -> Any:
        """Return a controller's value of a setting; None where it has none of its own."""
        section = self.condition.results.study.controllers.get(controller)
        return section.settings.get(setting) if section else None

    def _entries(self, setting: str, key: str) -> set[str]:
        values = [self.value(variant.key, setting) for variant in self.variants]
        return {repr(value.get(key)) for value in values if isinstance(value, dict)}

    @cached_property
    def cells(self) -> dict[tuple[str, ...], list[ControllerResults]]:
        """The variants by the values that are drawn, in the study's order."""
        table: dict[tuple[str, ...], list[ControllerResults]] = {}
        for variant in self.variants:
            cell = tuple(self.words(variant.key, setting) for setting in self.axes)
            table.setdefault(cell, []).append(variant)
        return table


def sweeps(condition: Condition) -> list[Sweep]:
    """Return the sweeps of a condition: the controllers as they are ranked, of each in the study's order."""
    groups: dict[tuple[str, tuple[str, ...]], list[ControllerResults]] = {}
    for variant in condition.variants:
        section = condition.results.study.controllers[variant.key]
        groups.setdefault((section.variant_of, tuple(section.varied)), []).append(variant)
    place = {controller.key: i for i, controller in enumerate(condition.controllers)}
    ranked = sorted(groups, key=lambda group: place.get(group[0], len(place)))
    return [Sweep(condition, base, settings, tuple(groups[base, settings])) for base, settings in ranked]


def sweep_statements(condition: Condition) -> list[Statement]:
    """Return for each controller that was swept its best and worst settings and its own."""
    groups: dict[str, list[Sweep]] = {}
    for sweep in sweeps(condition):
        groups.setdefault(sweep.base, []).append(sweep)
    return [
        Statement("Sweep", by_signal([(metric_signal(key), _swept(condition, group, key)) for key in keys]))
        for group in groups.values()
        if (keys := condition.headline)
    ]


def _swept(condition: Condition, group: Sequence[Sweep], key: str) -> Markup:
    """Say what the best and the worst settings of all sweeps of one controller give."""
    members = [(sweep, variant) for sweep in group for variant in sweep.variants]
    failing = [sweep.place(variant) for sweep, variant in members if variant.failed]
    order = sorted(
        (
            (value, sweep, variant)
            for sweep, variant in members
            if not variant.failed and not math.isnan(value := _median([variant], key))
        ),
        key=lambda entry: metric_of(key).rank(entry[0]),
    )
    text = Markup("{} settings of <b>{}</b>").format(len(members), group[0].label)
    if condition.all_failed:
        return text + ": every run of each failed."
    if not order:
        return text + ": none of them is without a failed run."
    show = formatter(key)
    (low, best, winner), (high, worst, loser) = order[0], order[-1]
    worst_of = "worst of those without a failed run" if failing else "worst"
    text += Markup(": best {} with {}, {} {} with {}").format(
        show(low), best.place(winner), worst_of, show(high), worst.place(loser)
    )
    of_base = [
        controller.over_seeds(key).median
        for controller in condition.controllers
        if controller.key == group[0].base
    ]
    if of_base and not math.isnan(of_base[0]):
        text += Markup("; its own settings give {}").format(show(of_base[0]))
    if not failing:
        return text + "."
    more = f"; and {len(failing) - _FAILING_SHOWN} more" if failing[_FAILING_SHOWN:] else ""
    some = "; ".join(failing[:_FAILING_SHOWN]) + more
    return text + Markup(". With failed runs: {} of {}: {}.").format(len(failing), len(members), some)


def worth_table(condition: Condition, prefix: str) -> Table | None:
    """Return what tuning is worth: own and best settings of each controller that was swept; None without."""
    groups: dict[str, list[Sweep]] = {}
    for sweep in sweeps(condition):
        groups.setdefault(sweep.base, []).append(sweep)
    rows = [
        row
        for key in condition.headline
        for group in groups.values()
        if (row := _worth_row(condition, group, key))
    ]
    if not rows:
        return None
    headings = (
        Heading("Controller", numeric=False),
        Heading("its own", group="median"),
        Heading("best of the grid", group="median"),
        Heading("worst", group="median"),
        Heading("best to own", "%"),
        *text_headings("best settings", "at the edge of the grid"),
        Heading("failed", "settings"),
    )
    notes = (
        "Of the settings without a failed run; failed: those with one. Where the best "
        "lies at the edge of the grid, better settings may lie beyond it. The best of a grid is chosen from "
        "the runs that it is shown of, which flatters it.",
    )
    caption, name = "What tuning is worth", f"{prefix}worth"
    return Table(name, caption, headings, tuple(rows), notes, kind="grouped", download="worth.csv")


def _worth_row(condition: Condition, group: Sequence[Sweep], key: str) -> Row | None:
    members = [(sweep, variant) for sweep in group for variant in sweep.variants]
    sound = [(sweep, variant) for sweep, variant in members if not variant.failed and variant.by_seed(key)]
    if not sound:
        return None
    sound.sort(key=lambda entry: metric_of(key).rank(_median([entry[1]], key)))
    (best_sweep, best), (_, worst) = sound[0], sound[-1]
    base = [controller for controller in condition.controllers if controller.key == group[0].base]
    values = [_median(base, key), _median([best], key), _median([worst], key)]
    of_base, least, most = number_cells(values)
    change = 100 * (values[1] / values[0] - 1) if values[0] > 0 else math.nan
    edges = ", ".join(_edges(best_sweep, best, base)) or "no"
    cells = (
        of_base,
        replace(least, best=not values[0] <= values[1]),
        most,
        Cell(percent(change / 100), change),
        Cell(best_sweep.place(best)),
        Cell(edges, failed=edges != "no"),
        Cell(f"{len(members) - len(sound)} of {len(members)}", len(members) - len(sound)),
    )
    index = (base or [best])[0].index
    title = " / ".join(filter(None, (metric_words(key), metric_unit(key))))
    return Row(group[0].label, cells, group[0].base, index, title)


def _edges(sweep: Sweep, best: ControllerResults, base: Sequence[ControllerResults]) -> Iterator[str]:
    """Yield the settings of which the best value is the smallest or the largest that was tried."""
    for setting in sweep.settings:
        given = [sweep.value(controller.key, setting) for controller in (*sweep.variants, *base)]
        numbers = {value for value in given if isinstance(value, int | float) and not isinstance(value, bool)}
        value = sweep.value(best.key, setting)
        if len(numbers) > 1 and value in (min(numbers), max(numbers)):
            which = "smallest" if value == min(numbers) else "largest"
            yield f"{setting}: {which}"


def effects_table(condition: Condition, prefix: str) -> Table | None:
    """Return how much each swept setting decides the metrics of the ranking; None without sweeps."""
    rows = [
        Row(f"{sweep.label}: {name}", _effect_cells(sweep, name, key), group=metric_words(key))
        for key in condition.headline
        for sweep in sweeps(condition)
        for name in sweep.settings
    ]
    if not rows:
        return None
    headings = (
        Heading("Setting", numeric=False),
        Heading("values"),
        Heading("failed", "runs"),
        Heading("rank correlation"),
        Heading("share explained", "%"),
    )
    notes = (
        "Rank correlation (Spearman): 1 where the larger setting always gives the larger value, "
        "\N{MINUS SIGN}1 the reverse; of numbers only. Share explained: of the variance of the ranks, by the "
        "values of this setting (epsilon squared), also where the best lies between two worse ones; a dash "
        "where no value was run twice. Runs that failed rank last.",
    )
    caption = "Which settings matter"
    return Table(
        f"{prefix}effects", caption, headings, tuple(rows), notes, kind="grouped", download="effects.csv"
    )


def _effect_cells(sweep: Sweep, setting: str, key: str) -> tuple[Cell, ...]:
    runs = [(variant, value) for variant in sweep.variants for value in variant.runs(key).values()]
    settings = [sweep.value(variant.key, setting) for variant, _ in runs]
    effect = setting_effect(settings, np.array([value for _, value in runs]), metric_of(key).better)
    failed = effect.runs - effect.known
    return (
        Cell(str(effect.levels), effect.levels),
        Cell(f"{failed} of {effect.runs}", failed, failed=failed > 0),
        Cell(significant(effect.correlation, 2), effect.correlation),
        Cell(significant(100 * effect.share, 2), 100 * effect.share),
    )


def sensitivity_figures(condition: Condition, prefix: str) -> list[Figure]:
    """Return one map for each sweep and controlled output; none without sweeps."""
    pairs = [(sweep, key) for sweep in sweeps(condition) for key in condition.headline]
    return [
        _figure(sweep, key, f"{prefix}sensitivity-{number}") for number, (sweep, key) in enumerate(pairs, 1)
    ]


def _figure(sweep: Sweep, key: str, identifier: str) -> Figure:
    what = metric_words(key)
    unit = f" in {metric_unit(key)}" if metric_unit(key) else ""
    caption = (
        f"{sweep.label}: {what}{unit} over {' and '.join(sweep.axes)}; "
        "the stronger the tint, the worse. Framed: the controller's own settings." + _summed_words(sweep)
    )
    rows = list(_rows(sweep, key))
    if any(row["shown"].endswith("*") for row in rows):
        caption += " Starred: of the cases that did not fail; others of this setting did."
    # A map with one setting needs no second axis.
    titles = sweep.axes if len(sweep.axes) > 1 else ("", *sweep.axes)
    return one_chart(identifier, "Sensitivity", caption, heat_chart(rows, titles), sweep.label)


def _summed_words(sweep: Sweep) -> str:
    words = []
    if len(sweep.condition.seeds) > 1:
        words.append(f"{len(sweep.condition.seeds)} seeds")
    if len(sweep.settings) > 2:
        words.append(f"the values of {' and '.join(sweep.settings[2:])}")
    return f" Median over {' and '.join(words)}." if words else ""


def _rows(sweep: Sweep, key: str) -> Iterator[dict[str, Any]]:
    own_place = tuple(sweep.words(sweep.base, setting) for setting in sweep.axes)
    texts = list(dict.fromkeys(text for place in sweep.cells for text in place))
    short = {text: clipped(text) for text in texts}
    if len(set(short.values())) < len(short):  # cells have to stay apart
        short = {text: f"{clipped(text, 40)} ({number})" for number, text in enumerate(texts, start=1)}
    for place, members in sweep.cells.items():
        value = _median(members, key)
        shown = significant(value) if math.isfinite(value) else "failed"
        words = with_unit(shown, metric_unit(key)) if math.isfinite(value) else shown
        failed = _failed_words(members) if math.isfinite(value) else ""
        given = zip(sweep.axes, (short[text] for text in place), strict=True)
        where = ", ".join(f"{name} = {value}" for name, value in given)
        yield {
            "y": short[place[0]] if len(place) > 1 else "",
            "x": short[place[-1]],
            "value": value if math.isfinite(value) else None,
            "shown": f"{shown} *" if failed else shown,
            "own": place == own_place,
            "text": f"{where}: {words}{failed}",
        }


def _failed_words(members: Sequence[ControllerResults]) -> str:
    """Say how many cases of a cell failed; nothing if none did."""
    cases = sum(len(member.cases) for member in members)
    failed = sum(member.failed for member in members)
    return f"; {failed} of {cases} cases failed" if failed else ""


def _median(members: Sequence[ControllerResults], key: str) -> float:
    values = (case.metrics.get(key, math.nan) for member in members for case in member.succeeded)
    return summed_up(values).median


def variants_table(condition: Condition, variants: Sequence[StudyResults], prefix: str) -> Table | None:
    """Return what a study by its own sweep comes to: a row per variant, a column per controller."""
    key = next(iter(condition.headline), "")
    seen = [
        (results.study.varied, other.by_key)
        for results in variants
        for other in conditions(results)
        if other.scenario == condition.scenario
    ]
    if not seen or not key:
        return None
    rows = [("as it is", condition.by_key)]
    rows += [(variant_words(varied), members) for varied, members in seen]
    columns = [
        _variant_cells([members.get(controller.key) for _, members in rows], key)
        for controller in condition.controllers
    ]
    return Table(
        f"{prefix}sweep",
        f"Variants of the study: {metric_words(key)}",
        (
            Heading("Variant", numeric=False),
            *(
                Heading(controller.label, metric_unit(key), colour=controller.index)
                for controller in condition.controllers
            ),
        ),
        tuple(Row(words, tuple(column[i] for column in columns)) for i, (words, _) in enumerate(rows)),
        ("Medians over the seeds; in brackets how many runs failed, where any did.",),
        sortable=True,
        download="variants.csv",
    )


def _variant_cells(members: Sequence[ControllerResults | None], key: str) -> list[Cell]:
    cells = number_cells([member.summed(key) if member else math.nan for member in members])
    return [
        cell
        if member is None or not member.failed
        else replace(cell, text=f"{cell.text} ({member.failed} of {len(member.cases)} failed)")
        for cell, member in zip(cells, members, strict=True)
    ]
