"""The figures over time of a condition: which panels, which lines, what their captions say."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, Literal, NamedTuple

from ddpc_cosim.files.texts import clipped
from ddpc_reports.comparison import Condition, ControllerResults
from ddpc_reports.embedding import brought_to_life
from ddpc_reports.figures.figure import Figure, Key, View, entry, in_its_place
from ddpc_reports.figures.outside import (
    FORECAST,
    MEASURED,
    charged_signals,
    disturbance_signals,
    price_signals,
)
from ddpc_reports.figures.samples import InfoSignals, Over, column_name, info_signals, seen
from ddpc_reports.figures.signal import BAND, LOWER, UPPER, Column, Signal, known
from ddpc_reports.figures.small import MOST_IN_PANEL, small_panels, small_words
from ddpc_reports.figures.still import still
from ddpc_reports.figures.time_charts import NARROW, WIDE, Mark, time_chart
from ddpc_reports.numbers import as_given, significant, with_unit
from ddpc_reports.tables.settings import known_words, own_units, scenario_effects

Kind = Literal["responses", "errors", "inputs"]

_INFO = "What controllers said of their steps"
_HEIGHTS = {"Responses": (236, 188), "Errors": (176, 134), "Control signals": (164, 124)}
"""Of a chart that has the page to itself, and of one beside others [px]."""
_FOLDED = (130, 130)
_SMALL = ("Responses", "Control signals")
_LEADERS, _MOST_OF_REST = 5, 9
_OUTSIDE = (130, 110)


class TimeFigures(NamedTuple):
    """The figures over time of a condition by section, and the samples that they draw.

    Parameters
    ----------
    figures : dict
        ``responses``: outputs with their reference or band, and below them known disturbances, prices and
        what is paid for; ``errors``: reference minus output; ``inputs``: these, and folded their changes and
        what controllers reported. A sentence stands for what cannot be shown.
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

    @property
    def is_crowded(self) -> bool:
        """Whether there are panels with so many lines, or would be, that each needs one of its own."""
        asked = any(panel.controllers for panel in self.condition.results.study.report.panels)
        most = max((len(panel.members) for panel in self.panels), default=0)
        return most > MOST_IN_PANEL or (len(self.panels) > 1 and not asked)


def time_figures(condition: Condition, prefix: str, *, sketched: bool = False) -> TimeFigures:
    """Return responses, errors and control signals: the first seed, and bands over the seeds.

    Where there is no room for all of it, it is ``sketched``: the responses of the first seed alone.
    """
    drawn = seen(condition, prefix, bands=not sketched)
    marks, words = scenario_marks(condition)
    scene = _Scene(condition, _panels(condition), marks, drawn.over, prefix)
    sent = f"control signal{_commanded(condition)}, drawn as it is held from sample to sample"
    change = "change of the control signal from one sample to the next; each panel has its own scale"

    def figure(title: str, signals: Sequence[Signal], what: str, more: str = "") -> list[Figure | str]:
        make = partial(_time_figure, scene, signals, title, what, more)
        return [in_its_place(title, make)] if signals else []

    responses = figure("Responses", drawn.outputs, f"controlled output and {_wanted(drawn.outputs)}", words)
    if sketched:
        samples = {signal.id: signal.columns for signal in drawn.outputs}
        return TimeFigures({"responses": responses, "errors": [], "inputs": []}, samples)
    outside = {
        "Disturbances": (disturbance_signals(condition, prefix), _disturbance_words),
        "Prices": (price_signals(condition, prefix), _price_words),
    }
    responses += [
        in_its_place(title, partial(_outside_figure, scene, signals, title, caption))
        for title, (signals, caption) in outside.items()
        if signals
    ]
    charged = charged_signals(condition, prefix)
    responses += figure("Paid for", charged, "signals that are paid for")
    what = "reference minus output"
    if any(signal.has_band for signal in drawn.outputs):
        what += ", of a band the distance to its nearer edge, 0 within it"
    errors = figure("Errors", drawn.errors, f"{what}; each panel has its own scale")
    inputs = figure("Control signals", drawn.inputs, sent)
    inputs += figure("Change of control signals", drawn.changes, change)
    if (info := info_signals(condition, prefix)).signals:
        inputs.append(in_its_place(_INFO, partial(_info_figure, scene, info)))
    shown = [*drawn.outputs, *drawn.errors, *drawn.inputs, *drawn.changes, *info.signals, *charged]
    shown += [signal for signals, _ in outside.values() for signal in signals]
    samples = {signal.id: signal.columns for signal in shown}
    if not scene.is_crowded:
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
    return _time_figure(replace(scene, panels=_ranked_panels(those)), info.signals, _INFO, what, every + rest)


def scenario_marks(condition: Condition) -> tuple[list[Mark], str]:
    """Return what a scenario does during the run, briefly, and in words this and all the rest."""
    results, traces = condition.results, condition.first_traces.values()
    section = results.study.scenarios.get(condition.scenario)
    start = results.study.loop.of(section).start_time if section else results.study.loop.start_time
    end = start + results.study.loop.duration
    marks, marked, rest = list[Mark](), list[str](), list[str]()
    if section:  # known disturbances have figures of their own
        drawn = results.study.disturbances
        section = replace(section, inputs={k: v for k, v in section.inputs.items() if k not in drawn})
    effects = scenario_effects(section, own_units(traces), results.study.prices) if section else []
    for effect in effects:
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
    return [panel for panel in panels if panel.members] or _ranked_panels(condition.controllers)


def _ranked_panels(controllers: tuple[ControllerResults, ...]) -> list[_Panel]:
    """Return one panel of few controllers; of many those that lead, and the rest."""
    if len(controllers) <= MOST_IN_PANEL:
        return [_Panel("", controllers)]
    first = min(_LEADERS, -(-len(controllers) // 2))
    rest = controllers[first:]
    count = -(-len(rest) // _MOST_OF_REST)
    ends = [round(len(rest) * n / count) for n in range(count + 1)]
    titles = [f"The rest, {n + 1} of {count}" if count > 1 else "The rest" for n in range(count)]
    parts = (_Panel(title, rest[a:b]) for title, (a, b) in zip(titles, pairwise(ends), strict=True))
    return [_Panel(f"Leaders: the first {first}", controllers[:first]), *parts]


def _time_figure(scene: _Scene, signals: Sequence[Signal], title: str, what: str, more: str) -> Figure:
    """Return the figure of some signals, a chart for each of them in each panel; folded if it is minor."""
    condition, identifier = scene.condition, f"{scene.prefix}{title.lower().replace(' ', '-')}"
    small = small_panels(condition, signals) if title in _SMALL and scene.is_crowded else ()
    # Bands on each other hide each other: of many controllers the small panels have them.
    bare = [replace(signal, band={}) if scene.is_crowded else signal for signal in signals]
    if not small:
        signals = bare
    places = [
        (panel, signal)
        for panel in scene.panels
        for signal in bare
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
        keys=_keys(signals),
        small=small,
        small_words=small_words(condition, signals) if small else "",
    )


def _keys(signals: Sequence[Signal]) -> tuple[Key, ...]:
    """Return what a legend says of bands, of limits that change and of what acts from outside."""
    band = [Key("band", "var(--ink)", is_area=True)] if any(signal.has_band for signal in signals) else []
    if any(signal.band for signal in signals):
        band.append(Key("over the seeds: median and band", "var(--ink-soft)", is_area=True))
    looks = [
        Key(given.label or "expected", given.colour, " ".join(f"{length:g}" for length in given.dashes))
        for signal in signals
        for given in signal.given
    ]
    return tuple(dict.fromkeys((*band, *looks)))


def _wanted(signals: Sequence[Signal]) -> str:
    """Say how what is wanted is drawn."""
    line, band = "reference (thin solid line)", "the band in which it is wanted (grey)"
    bands = [signal.has_band for signal in signals]
    return f"{line} or {band}" if any(bands) and not all(bands) else band if any(bands) else line


def _outside_figure(
    scene: _Scene, signals: Sequence[Signal], title: str, caption: Callable[[_Scene, Sequence[Signal]], str]
) -> Figure:
    """Return the figure of what acts from outside, which is the same for all controllers."""
    identifier = f"{scene.prefix}{title.lower()}"
    alone = len(signals) == 1
    size = (WIDE if alone else NARROW, _OUTSIDE[0 if alone else 1])
    views = tuple(
        _outside_view(scene, signal, size, f"{identifier}-{number}")
        for number, signal in enumerate(signals, 1)
    )
    keys = _keys(signals)
    return Figure(identifier, title, caption(scene, signals), views, keys=keys if len(keys) > 1 else ())


def _outside_view(scene: _Scene, signal: Signal, size: tuple[int, int], identifier: str) -> View:
    spec = time_chart(signal, [], scene.condition.results.study.loop.sampling_time, (), size)
    ranges = [
        f"{given.label} {_range_of(signal.columns[given.columns[0]])}"
        for given in signal.given
        if given.label
    ]
    description = f"{signal.title} {_over_time(signal)}: {'; '.join(ranges)}"
    picture = brought_to_life(partial(still, signal, [], (), size, description), spec, description)
    return View(identifier, "", description, spec, picture, signal.id, unit=signal.unit, **_read_out(signal))


def _read_out(signal: Signal) -> dict[str, Any]:
    """Return what a view has of a signal besides the controllers' lines."""
    given = {
        column: (given.label, given.colour)
        for given in signal.given
        for column in given.columns
        if given.label
    }
    edges = {LOWER: ("lower edge", "var(--ink)"), UPPER: ("upper edge", "var(--ink)")}
    return {
        "time": signal.clock.unit,
        "given": (edges if signal.has_band else {}) | given,
        "also_scaling": tuple(name for name in signal.also_scaling if name != "r"),
    }


def _disturbance_words(scene: _Scene, signals: Sequence[Signal]) -> str:
    """Say what is drawn of disturbances, and what controllers are told of each."""
    condition = scene.condition
    what = "what acts on the plant besides its inputs"
    if any(MEASURED in signal.columns for signal in signals):
        what += ", and as it is measured where that differs"
    if any(f"{FORECAST}0" in signal.columns for signal in signals):
        what += (
            ", with what controllers expect at a few moments of the run, as far ahead as any of them looks"
        )
    known = "; ".join(known_words(condition.results.study, condition.scenario))
    return f"Disturbances at seed {condition.seeds[0]}: {what}. Known: {known}."


def _price_words(scene: _Scene, signals: Sequence[Signal]) -> str:
    """Say what prices are of, and whether they are known ahead."""
    charges = next(iter(scene.condition.first_traces.values())).charges
    paid = [
        f"{_plain_name(charge.name)} for {_plain_name(charge.signal)}, "
        f"{'' if charge.known else 'not '}known ahead"
        for charge in charges
    ]
    return f"Prices over time, drawn as they hold from sample to sample: {'; '.join(paid)}."


def _plain_name(name: str) -> str:
    return clipped(name.replace("_", " "))


def _band_words(scene: _Scene, signals: Sequence[Signal]) -> str:
    """Say what the bands are of, and which runs are not in them."""
    if not any(signal.band for signal in signals):
        return ""
    over = scene.over
    from_to = (
        "from the least to the most" if over.is_range else "from the 10\u00a0% to the 90\u00a0% quantile"
    )
    first = "the first " if over.left_out else ""
    coloured = "Coloured bands" if any(signal.has_band for signal in signals) else "Bands"
    words = f" {coloured}: {from_to} over {first}{over.seeds} seeds, with the median as a thin line"
    failed = [
        f"{clipped(controller.label)} {over.failed[column_name(controller)]}"
        for controller in scene.condition.controllers
        if over.failed.get(column_name(controller))
    ]
    if failed:
        words += f"; without the runs that failed ({', '.join(failed)})"
    where = ", in the small panels" if scene.is_crowded else ""
    return f"{words}{where}; none where the seeds hardly differ."


def _limits_words(signals: Sequence[Signal]) -> str:
    """Say which limits are not in the picture."""
    kinds = {
        "Limits outside the picture": [(signal, signal.far_limits) for signal in signals],
        "Not drawn, as no run reaches them: limits of": [(s, s.unreached_limits) for s in signals],
    }
    words = ""
    for kind, limits_of in kinds.items():
        named = [
            f"{signal.title.partition(' / ')[0]} at "
            + " and ".join(with_unit(as_given(limit), signal.unit) for limit in limits)
            for signal, limits in limits_of
            if limits
        ]
        words += f" {kind}{'' if kind.endswith('of') else ':'} {', '.join(named)}." if named else ""
    return words


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
    return View(
        identifier,
        clipped(panel.title, 120),
        description,
        spec,
        brought_to_life(partial(still, signal, order, scene.marks, size, description), spec, description),
        signal.id,
        tuple(names),
        signal.unit,
        signal.scaling(names),
        (*signal.limits, *signal.reach),
        fixed=signal.is_fixed,
        **_read_out(signal),
    )


def _description(signal: Signal, members: Sequence[ControllerResults]) -> str:
    """Say what a chart shows to those who do not see it: whose lines, their range and their last value."""
    ranges = [
        f"{clipped(member.label)} {_range_of(signal.columns[column_name(member)])}" for member in members
    ]
    return f"{signal.title} {_over_time(signal)}: {'; '.join(ranges)}"


def _range_of(column: Column) -> str:
    values = known(column) or [math.nan]
    low, high, last = (significant(value, 3) for value in (min(values), max(values), values[-1]))
    return f"from {low} to {high}, at the end {last}"


def _over_time(signal: Signal) -> str:
    first, end = (as_given(time) for time in signal.end)
    return f"over time, {first} to {end} {signal.clock.unit}"


def _travel(column: Column) -> float:
    return sum(abs(after - before) for before, after in pairwise(known(column)))
