"""The figures over time of a condition: which panels, which lines, what their captions say."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Literal, NamedTuple

from ddpc_cosim.texts import clipped
from ddpc_reports.comparison import Condition, ControllerResults
from ddpc_reports.embedding import drawing
from ddpc_reports.figures.charts import COLOURS
from ddpc_reports.figures.figure import Figure, View, entry, in_its_place
from ddpc_reports.figures.samples import InfoSignals, Over, column_name, info_signals, seen
from ddpc_reports.figures.signal import BAND, Column, Signal, known
from ddpc_reports.figures.time_charts import NARROW, WIDE, Mark, time_chart
from ddpc_reports.numbers import as_given, significant, with_unit
from ddpc_reports.tables.settings import own_units, scenario_effects

Kind = Literal["responses", "errors", "inputs"]

_INFO = "What controllers said of their steps"
_HEIGHTS = {"Responses": (236, 188), "Errors": (176, 134), "Control signals": (164, 124)}
"""Of a chart that has the page to itself, and of one beside others [px]."""
_FOLDED = (130, 130)


class TimeFigures(NamedTuple):
    """The figures over time of a condition by section, and the samples that they draw.

    Parameters
    ----------
    figures : dict
        ``responses``: outputs with their reference; ``errors``: reference minus output; ``inputs``: these,
        and folded their changes and what controllers reported. A sentence stands for what cannot be shown.
    samples : dict
        By name the columns of what the figures draw.
    """

    figures: dict[Kind, list[Figure | str]]
    samples: dict[str, dict[str, Column]]


@dataclass(frozen=True)
class _Panel:
    title: str
    members: tuple[ControllerResults, ...]


@dataclass(frozen=True)
class _Scene:
    """What all figures over time of a condition share."""

    condition: Condition
    panels: list[_Panel]
    marks: list[Mark]
    over: Over
    prefix: str


def time_figures(condition: Condition, prefix: str, *, sketched: bool = False) -> TimeFigures:
    """Return responses, errors and control signals: the first seed, and bands over the seeds.

    Where there is no room for all of it, it is ``sketched``: the responses of the first seed alone.
    """
    drawn = seen(condition, prefix, bands=not sketched)
    marks, words = _scenario(condition)
    scene = _Scene(condition, _panels(condition), marks, drawn.over, prefix)
    sent = f"control signal{_commanded(condition)}, drawn as it is held from sample to sample"
    change = "change of the control signal from one sample to the next; each panel has its own scale"

    def figure(title: str, signals: Sequence[Signal], what: str, more: str = "") -> list[Figure | str]:
        make = partial(_time_figure, scene, signals, title, what, more)
        return [in_its_place(title, make)] if signals else []

    responses = figure("Responses", drawn.outputs, "controlled output and reference (thin solid line)", words)
    if sketched:
        samples = {signal.id: signal.columns for signal in drawn.outputs}
        return TimeFigures({"responses": responses, "errors": [], "inputs": []}, samples)
    errors = figure("Errors", drawn.errors, "reference minus output; each panel has its own scale")
    inputs = figure("Control signals", drawn.inputs, sent)
    inputs += figure("Change of control signals", drawn.changes, change)
    if (info := info_signals(condition, prefix)).signals:
        inputs.append(in_its_place(_INFO, partial(_info_figure, scene, info)))
    shown = [*drawn.outputs, *drawn.errors, *drawn.inputs, *drawn.changes, *info.signals]
    samples = {signal.id: signal.columns for signal in shown}
    samples |= {f"{signal.id}{BAND}": signal.band for signal in shown if signal.band}
    return TimeFigures({"responses": responses, "errors": errors, "inputs": inputs}, samples)


def _info_figure(scene: _Scene, info: InfoSignals) -> Figure:
    """Return the folded figure of what controllers reported of their steps."""
    columns = {name for signal in info.signals for name in signal.columns}
    those = tuple(
        controller for controller in scene.condition.controllers if column_name(controller) in columns
    )
    what = (
        "info of the controllers, in their own units; each panel has its own scale, a cost is of a "
        "controller's own problem: hide others to see one"
    )
    rest = f" {info.left_out} more in signals.csv." if info.left_out else ""
    every = f" One of {info.every} samples; all are in signals.csv." if info.every > 1 else ""
    return _time_figure(replace(scene, panels=_even_panels(those)), info.signals, _INFO, what, every + rest)


def _scenario(condition: Condition) -> tuple[list[Mark], str]:
    """Return what a scenario does during the run, briefly, and in words this and all the rest."""
    results, traces = condition.results, condition.first_traces.values()
    section = results.study.scenarios.get(condition.scenario)
    start = results.study.loop.start_time
    end = start + results.study.loop.duration
    marks, marked, rest = list[Mark](), list[str](), list[str]()
    for effect in scenario_effects(section, own_units(traces)) if section else []:
        within = [mark for mark in effect.marks if start < mark.end and mark.begin < end]
        within = [mark for mark in within if mark.end > mark.begin or mark.begin > start]
        (marked if within else rest).append(effect.text)
        marks += [Mark(clipped(mark.label), max(mark.begin, start), mark.end) for mark in within]
    words = f" Marked, and shaded where it takes a while: {'; '.join(marked)}." if marked else ""
    return marks, words + (f" Throughout: {'; '.join(rest)}." if rest else "")


def _commanded(condition: Condition) -> str:
    """Say that the plant may have been given something else."""
    for trace in condition.first_traces.values():
        if set(trace.changed_inputs) & set(trace.inputs):
            return " as commanded, before the actuator and disturbances"
    return ""


def _panels(condition: Condition) -> list[_Panel]:
    """Return the study's panels that have controllers here; one with all of them where it names none."""
    by_key = condition.by_key
    asked = condition.results.study.report.panels
    panels = [
        _Panel(panel.title, tuple(by_key[key] for key in panel.controllers if key in by_key))
        for panel in asked
    ]
    return [panel for panel in panels if panel.members] or _even_panels(condition.controllers)


def _even_panels(controllers: tuple[ControllerResults, ...]) -> list[_Panel]:
    """Share many controllers out over panels, so that no two in a panel have the same colour."""
    count = -(-len(controllers) // COLOURS)
    if count < 2:
        return [_Panel("", controllers)]
    ends = [round(len(controllers) * n / count) for n in range(count + 1)]
    return [_Panel(f"Controllers {a + 1} to {b}", controllers[a:b]) for a, b in pairwise(ends)]


def _time_figure(scene: _Scene, signals: Sequence[Signal], title: str, what: str, more: str) -> Figure:
    """Return the figure of some signals, a chart for each of them in each panel; folded if it is minor."""
    condition, identifier = scene.condition, f"{scene.prefix}{title.lower().replace(' ', '-')}"
    places = [
        (panel, signal)
        for panel in scene.panels
        for signal in signals
        if any(column_name(member) in signal.columns for member in panel.members)
    ]
    alone = len(places) == 1
    size = (WIDE if alone else NARROW, _HEIGHTS.get(title, _FOLDED)[0 if alone else 1])
    views = tuple(
        _time_view(scene, place, size, f"{identifier}-{number}") for number, place in enumerate(places, 1)
    )
    shown = {member for panel in scene.panels for member in panel.members}
    return Figure(
        identifier,
        title,
        f"{title} at seed {condition.seeds[0]}: {what}."
        + _band_words(scene, signals)
        + _limits_words(signals)
        + _beyond_words(scene, signals)
        + more,
        views,
        tuple(entry(controller) for controller in condition.controllers if controller in shown),
        reference=any(signal.has_reference for signal in signals),
        folded=title not in _HEIGHTS,
    )


def _band_words(scene: _Scene, signals: Sequence[Signal]) -> str:
    """Say what the bands are of, and which runs are not in them."""
    if not any(signal.band for signal in signals):
        return ""
    over = scene.over
    from_to = (
        "from the least to the most" if over.is_range else "from the 10\u00a0% to the 90\u00a0% quantile"
    )
    first = "the first " if over.left_out else ""
    words = f" Bands: {from_to} over {first}{over.seeds} seeds, with the median as a thin line"
    failed = [
        f"{clipped(controller.label)} {over.failed[column_name(controller)]}"
        for controller in scene.condition.controllers
        if over.failed.get(column_name(controller))
    ]
    if failed:
        words += f"; without the runs that failed ({', '.join(failed)})"
    return f"{words}; none where the seeds hardly differ."


def _limits_words(signals: Sequence[Signal]) -> str:
    """Say which limits are not in the picture."""
    far = [
        f"{signal.title.partition(' / ')[0]} at "
        + " and ".join(with_unit(as_given(limit), signal.unit) for limit in signal.far_limits)
        for signal in signals
        if signal.far_limits
    ]
    return f" Limits outside the picture: {', '.join(far)}." if far else ""


def _beyond_words(scene: _Scene, signals: Sequence[Signal]) -> str:
    """Say whose values are far outside the range of the axis; of errors, outside the transients."""
    ends: list[str] = []
    transients = 0.0
    for signal in signals:
        for panel in scene.panels:
            names = [name for member in panel.members if (name := column_name(member)) in signal.columns]
            extent = signal.extent(names) if names else (0.0, 0.0)
            for member in panel.members:
                values = known(signal.columns.get(column_name(member), []))
                if signal.settled is not None and values:
                    transients = max(transients, *map(abs, values)) if _leaves(values, extent) else transients
                    values = [signal.settled[column_name(member)]]
                elif signal.own_range:
                    continue
                if values and _leaves(values, extent):
                    ends.append(_range_words(member, signal, values))
    unit = signals[0].unit if len(signals) == 1 else ""
    words = ""
    if transients:
        most = f" (up to {with_unit(significant(transients, 3), unit)})" if unit else ""
        words = f" The axis is that of the errors outside the transients, which go beyond it{most}."
    named = ", ".join(dict.fromkeys(ends))
    also = "Beyond it outside the transients too" if transients else "Beyond the axis"
    return words + (f" {also}: {named}." if named else "")


def _range_words(controller: ControllerResults, signal: Signal, values: Sequence[float]) -> str:
    name = signal.title.partition(" / ")[0]
    high = with_unit(significant(max(values), 3), signal.unit)
    low = f"{significant(min(values), 3)} …" if len(values) > 1 else "up to"
    return f"{clipped(controller.label)} ({name} {low} {high})"


def _leaves(values: Sequence[float], extent: tuple[float, float]) -> bool:
    return min(values) < extent[0] or max(values) > extent[1]


def _time_view(scene: _Scene, place: tuple[_Panel, Signal], size: tuple[int, int], identifier: str) -> View:
    panel, signal = place
    members = [member for member in panel.members if column_name(member) in signal.columns]
    names = [column_name(member) for member in members]
    sampling_time = scene.condition.results.study.loop.sampling_time
    # Restless lines at the back: they would hide the calm ones.
    order = sorted(names, key=lambda name: -_travel(signal.columns[name]))
    spec = time_chart(signal, order, sampling_time, scene.marks, size)
    description = _description(signal, members)
    # What is not drawn costs time.
    of_panel = {"t", "r", *(name + end for name in names for end in ("", "l", "h"))}
    samples = {
        name: {key: columns[key] for key in columns if key in of_panel}
        for name, columns in ((signal.id, signal.columns), (f"{signal.id}{BAND}", signal.band))
    }
    return View(
        identifier,
        clipped(panel.title, 120),
        description,
        spec,
        drawing(spec, identifier, description, samples),
        signal.id,
        tuple(names),
        signal.unit,
        signal.scaling(names),
        tuple(signal.limits),
        fixed=signal.is_fixed,
    )


def _description(signal: Signal, members: Sequence[ControllerResults]) -> str:
    """Say what a chart shows to those who do not see it: whose lines, their range and their last value."""
    ranges = []
    for member in members:
        values = known(signal.columns[column_name(member)]) or [math.nan]
        low, high, last = (significant(value, 3) for value in (min(values), max(values), values[-1]))
        ranges.append(f"{clipped(member.label)} from {low} to {high}, at the end {last}")
    first, end = (as_given(time) for time in signal.end)
    return f"{signal.title} over time, {first} to {end} s: {'; '.join(ranges)}"


def _travel(column: Column) -> float:
    return sum(abs(after - before) for before, after in pairwise(known(column)))
