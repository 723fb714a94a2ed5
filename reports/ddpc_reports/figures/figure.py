"""The figures of a study: which panels, which lines, their legend and caption."""

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from string import ascii_lowercase
from typing import Any, TypeVar

from ddpc_cosim import CosimWarning
from ddpc_cosim.metrics import metric_name
from ddpc_cosim.texts import recorded
from ddpc_reports.comparison import (
    STEP_TIMES,
    Condition,
    ControllerResults,
    metric_unit,
    metric_words,
    outcome_words,
)
from ddpc_reports.embedding import Drawing, drawing
from ddpc_reports.figures.charts import (
    COLOURS,
    Mark,
    Spec,
    dash,
    ranges_widely,
    spread_chart,
    step_time_chart,
    time_chart,
)
from ddpc_reports.figures.samples import Column, FirstSeed, Said, Signal, column_name, first_seed, known, said
from ddpc_reports.numbers import duration, given_duration, significant, with_unit
from ddpc_reports.tables.settings import own_units, scenario_effects

_SAID = "What controllers said of their steps"
_MOST_DOTS = 60
"""Seeds of a controller that are drawn as dots of one row."""


@dataclass(frozen=True)
class Entry:
    """One line of a legend."""

    name: str
    label: str
    colour: int
    dashes: str
    note: str


@dataclass(frozen=True)
class View:
    """One chart of a figure: as Vega-Lite, drawn, and what its readout and its ranges are made of."""

    id: str
    title: str
    description: str
    spec: Spec
    drawing: Drawing
    data: str = ""
    names: tuple[str, ...] = ()
    unit: str = ""
    scaled_by: tuple[str, ...] = ()
    limits: tuple[float, ...] = ()


@dataclass(frozen=True)
class Figure:
    """A figure: charts below each other, a caption, a legend where the charts need one; open or folded."""

    id: str
    title: str
    caption: str
    views: tuple[View, ...]
    legend: tuple[Entry, ...] = ()
    reference: bool = False
    folded: bool = False


@dataclass(frozen=True)
class _Panel:
    title: str
    members: tuple[ControllerResults, ...]


T = TypeVar("T")


def in_its_place(what: str, make: Callable[[], T]) -> T | str:
    """Return what is made, or a sentence for its place: what fails must not cost the page more than itself.

    Warns
    -----
    CosimWarning
        It fails, and why.
    """
    try:
        return make()
    except Exception as error:
        sentence = f"{what}: cannot be shown: {type(error).__name__}: {recorded(error)}"
        warnings.warn(sentence, CosimWarning, stacklevel=2)
        return sentence


def time_figures(
    condition: Condition, prefix: str
) -> tuple[list[Figure | str], dict[str, dict[str, Column]]]:
    """Return responses, control signals and their changes at the first seed, and the data they draw."""
    seen = first_seed(condition, prefix)
    panels = _panels(condition)
    kinds = {
        "Responses": (seen.outputs, "controlled output and reference (thin solid line)"),
        "Control signals": (
            seen.inputs,
            f"control signal{_commanded(condition)}, drawn as it is held from sample to sample",
        ),
        "Change of control signals": (
            seen.changes,
            "change of the control signal from one sample to the next; each panel has its own scale",
        ),
    }
    marks, words = _scenario(condition)
    briefly = " Letters as with the responses." if marks else ""
    figures = [
        in_its_place(
            title,
            partial(
                _time_figure,
                condition,
                panels,
                signals,
                title,
                what,
                (marks, words if signals is seen.outputs else briefly),
                f"{prefix}{_slug(title)}",
            ),
        )
        for title, (signals, what) in kinds.items()
        if signals
    ]
    shown = _signals(seen)
    if (told := said(condition, prefix)).signals:
        drawn = partial(_said_figure, condition, told, (marks, briefly), prefix)
        figures.append(in_its_place(_SAID, drawn))
        shown += told.signals
    return figures, {signal.id: signal.columns for signal in shown}


def _said_figure(condition: Condition, told: Said, scenario: tuple[list[Mark], str], prefix: str) -> Figure:
    """Return the folded figure of what controllers said of their steps."""
    marks, words = scenario
    those = [one for one in condition.controllers if any(column_name(one) in s.columns for s in told.signals)]
    what = (
        "info of the controllers, in their own units; each panel has its own scale, a cost is of a "
        "controller's own problem: hide others to see one"
    )
    rest = f" {told.left_out} more in signals.csv." if told.left_out else ""
    every = f" One of {told.every} samples; all are in signals.csv." if told.every > 1 else ""
    figure = _time_figure(
        condition,
        _even_panels(tuple(those)),
        told.signals,
        _SAID,
        what,
        (marks, every + rest + words),
        f"{prefix}info",
    )
    return replace(figure, folded=True)


def _scenario(condition: Condition) -> tuple[list[Mark], str]:
    """Return what a scenario does during the run, each with a letter, and in words this and all the rest."""
    results, traces = condition.results, condition.first_traces.values()
    section = results.study.scenarios.get(condition.scenario)
    start = results.study.loop.start_time
    end = start + results.study.loop.duration
    marks, key, rest = list[Mark](), list[str](), list[str]()
    for effect in scenario_effects(section, own_units(traces)) if section else []:
        spans = [*((time, time) for time in effect.instants), *effect.spans]
        within = [(first, last) for first, last in spans if start < last and first < end]
        if within:
            letter = ascii_lowercase[len(key) % len(ascii_lowercase)] * (len(key) // len(ascii_lowercase) + 1)
            key.append(f"({letter}) {effect.text}")
            marks += [Mark(letter, max(first, start), last) for first, last in within]
        else:
            rest.append(effect.text)
    words = f" Marked, and shaded where it takes a while: {'; '.join(key)}." if key else ""
    return marks, words + (f" Throughout: {'; '.join(rest)}." if rest else "")


def _commanded(condition: Condition) -> str:
    """Say that the plant may have been given something else."""
    for trace in condition.first_traces.values():
        if set(trace.changed_inputs) & set(trace.inputs):
            return " as commanded, before the actuator and disturbances"
    return ""


def _signals(seen: FirstSeed) -> list[Signal]:
    return [*seen.outputs, *seen.inputs, *seen.changes]


def _panels(condition: Condition) -> list[_Panel]:
    """Return the study's panels that have controllers here; one with all of them where it names none."""
    by_key = {one.key: one for one in condition.controllers}
    asked = condition.results.study.report.panels
    panels = [
        _Panel(one.title, tuple(by_key[key] for key in one.controllers if key in by_key)) for one in asked
    ]
    return [panel for panel in panels if panel.members] or _even_panels(condition.controllers)


def _even_panels(controllers: tuple[ControllerResults, ...]) -> list[_Panel]:
    """Share many controllers out over panels, so that no two in a panel have the same colour."""
    count = -(-len(controllers) // COLOURS)
    if count < 2:
        return [_Panel("", controllers)]
    ends = [round(len(controllers) * n / count) for n in range(count + 1)]
    return [_Panel(f"Controllers {a + 1} to {b}", controllers[a:b]) for a, b in pairwise(ends)]


def _time_figure(
    condition: Condition,
    panels: Sequence[_Panel],
    signals: Sequence[Signal],
    title: str,
    what: str,
    scenario: tuple[list[Mark], str],
    identifier: str,
) -> Figure:
    marks, words = scenario
    places = [
        (panel, signal)
        for panel in panels
        for signal in signals
        if any(column_name(one) in signal.columns for one in panel.members)
    ]
    views = tuple(
        _time_view(condition, place, marks, f"{identifier}-{number}", last=number == len(places))
        for number, place in enumerate(places, start=1)
    )
    shown = {one for panel in panels for one in panel.members}
    legend = tuple(entry(one) for one in condition.controllers if one in shown)
    return Figure(
        identifier,
        title,
        f"{title} at seed {condition.seeds[0]}: {what}."
        + _limits_words(signals)
        + _beyond_words(condition, signals)
        + words,
        views,
        legend,
        reference=any(signal.has_reference for signal in signals),
    )


def _limits_words(signals: Sequence[Signal]) -> str:
    return " Faint dashed lines: limits." if any(signal.limits for signal in signals) else ""


def _beyond_words(condition: Condition, signals: Sequence[Signal]) -> str:
    """Say whose values are far outside the range of the axis."""
    ends = [
        f"{one.label} ({signal.title.partition(' / ')[0]} {significant(min(values), 3)} … "
        f"{with_unit(significant(max(values), 3), signal.unit)})"
        for signal in signals
        if not signal.own_range
        for one in condition.controllers
        if (values := known(signal.columns.get(column_name(one), [])))
        and _leaves(values, signal.extent(list(signal.columns)))
    ]
    return f" Beyond the axis: {', '.join(ends)}." if ends else ""


def _leaves(values: Sequence[float], extent: tuple[float, float]) -> bool:
    return min(values) < extent[0] or max(values) > extent[1]


def entry(one: ControllerResults, *, of_first: bool = True) -> Entry:
    """Return the line of a legend of a controller; ``of_first``: with how its first seed ended."""
    case = one.first_case
    note = "" if one.holds_first or not of_first else outcome_words(case) if case else "not run"
    pattern = " ".join(f"{length:g}" for length in dash(one.index))
    return Entry(column_name(one), one.label, one.index % COLOURS, pattern, note)


def _time_view(
    condition: Condition,
    place: tuple[_Panel, Signal],
    marks: Sequence[Mark],
    identifier: str,
    *,
    last: bool,
) -> View:
    panel, signal = place
    names = [column_name(one) for one in panel.members if column_name(one) in signal.columns]
    sampling_time = condition.results.study.loop.sampling_time
    # Restless lines at the back: they would hide the calm ones.
    order = sorted(names, key=lambda name: -_travel(signal.columns[name]))
    spec = time_chart(signal, order, sampling_time, marks, last)
    who = ", ".join(one.label for one in panel.members if column_name(one) in names)
    description = f"{signal.title} over time of {who}"
    picture = drawing(spec, identifier, description, {signal.id: signal.columns})
    scaled_by = signal.scaling(names)
    return View(
        identifier,
        panel.title,
        description,
        spec,
        picture,
        signal.id,
        tuple(names),
        signal.unit,
        scaled_by,
        signal.limits,
    )


def _travel(column: Column) -> float:
    return sum(abs(after - before) for before, after in pairwise(known(column)))


def spread_figures(condition: Condition, prefix: str) -> list[Figure]:
    """Return one strip plot over the seeds for each controlled output; none of one seed, or if none holds."""
    if len(condition.seeds) < 2:
        return []
    keys = enumerate(condition.headline)
    return [figure for i, key in keys if (figure := _spread_figure(condition, key, f"{prefix}spread-{i}"))]


def _spread_figure(condition: Condition, key: str, identifier: str) -> Figure | None:
    what = metric_words(key)
    axis = f"{what} / {metric_unit(key)}" if metric_unit(key) else what
    rows = [row for one in condition.controllers for row in _spread_rows(condition, one, key)]
    if not rows:
        return None
    dots = "one dot per seed"
    if len(condition.seeds) > _MOST_DOTS:
        dots = f"{_MOST_DOTS} dots at most, even in rank from the lowest value to the highest"
    caption = (
        f"Over {len(condition.seeds)} seeds, {what} in the cases that stay near their reference; "
        f"{dots}, upright line: median, diamond: seed {condition.seeds[0]}."
        + (" Logarithmic axis." if ranges_widely([row["value"] for row in rows]) else "")
    )
    return one_chart(identifier, "Spread over seeds", caption, spread_chart(rows, axis))


def _spread_rows(condition: Condition, one: ControllerResults, key: str) -> list[dict[str, Any]]:
    """Return a row for each dot of a controller, and one more for the first seed where it has no dot."""
    values = {case.seed: case.metrics.get(key, math.nan) for case in one.holding}
    ranked_seeds = sorted((seed for seed in values if math.isfinite(values[seed])), key=values.__getitem__)
    dots, first = set(_spread_out(ranked_seeds)), condition.seeds[0]
    return [
        {
            "label": one.label,
            "key": column_name(one),
            "value": _short(values[seed]),
            "first": seed == first,
            "text": f"{one.label}, seed {seed}: {with_unit(significant(values[seed]), metric_unit(key))}",
        }
        | ({} if seed in dots else {"extra": True})
        for seed in ranked_seeds
        if seed in dots or seed == first
    ]


def _spread_out(ranked_seeds: Sequence[int]) -> list[int]:
    """Return as many as can be told apart as dots, even in rank; both ends and the median stay."""
    if len(ranked_seeds) <= _MOST_DOTS:
        return [*ranked_seeds]
    last, steps = len(ranked_seeds) - 1, _MOST_DOTS // 2 - 1
    lower = [round(i * (last // 2) / steps) for i in range(steps + 1)]
    return [ranked_seeds[i] for place in lower for i in (place, last - place)]


def step_time_figure(condition: Condition, prefix: str) -> Figure | None:
    """Return the step times of all controllers on a logarithmic axis; None if nothing was timed."""
    rows = [
        _step_time_row(one, metric_name(key), one.summed(key))
        for one in condition.controllers
        for key in STEP_TIMES
    ]
    rows = [row for row in rows if math.isfinite(row["value"]) and row["value"] > 0]
    if not rows:
        return None
    sampling_time = condition.results.study.loop.sampling_time
    caption = (
        "Time of one controller step: median (circle), 95 % (triangle), 99 % (diamond) and longest (cross). "
        f"Dashed line: the sampling time, {given_duration(sampling_time)}. Logarithmic axis."
    )
    return one_chart(f"{prefix}step-time", "Step time", caption, step_time_chart(rows, sampling_time))


def _step_time_row(one: ControllerResults, words: str, seconds: float) -> dict[str, Any]:
    return {
        "label": one.label,
        "key": column_name(one),
        "figure": words,
        "value": _short(seconds),
        "text": f"{one.label}, {words}: {duration(seconds)}",
    }


def one_chart(identifier: str, title: str, caption: str, spec: Spec, panel: str = "") -> Figure:
    """Return a figure of one chart that needs no legend; the caption describes it."""
    name = f"{identifier}-1"
    view = View(name, panel, caption, spec, drawing(spec, name, caption))
    return Figure(identifier, title, caption, (view,))


def _short(value: float) -> float:
    return float(f"{value:.6g}")


def _slug(title: str) -> str:
    return title.lower().replace(" ", "-")
