"""Small pictures of one controller each: panels by rank, and the line in a row of the ranking.

Where many lines lie on each other, no colour tells them apart: then each controller has a panel of its own,
all on the same axes, with the reference in grey and the best one faint behind.
"""

import math
from collections.abc import Sequence

from markupsafe import Markup

from ddpc_cosim.files.texts import clipped
from ddpc_reports.comparison import Condition, ControllerResults, metric_unit, outcome_words
from ddpc_reports.figures.charts import colour, dashes
from ddpc_reports.figures.figure import Small
from ddpc_reports.figures.samples import column_name
from ddpc_reports.figures.signal import LOWER, UPPER, Column, Signal, known
from ddpc_reports.figures.svg import (
    Frame,
    Line,
    area,
    area_path,
    cut_off,
    line_path,
    outline,
    picture,
    rules,
    stroke,
    text,
    ticks,
)
from ddpc_reports.numbers import as_given, significant, with_unit

MOST_IN_PANEL = 6
"""Lines that one panel can show: of more controllers each has a small one too."""
_SIZE = (184.0, 104.0)
_LEFT, _TOP, _BOTTOM = 36.0, 4.0, 15.0
_TICKS, _LONGEST_TITLE, _MOST_FIGURES = 3, 16, 2
_LINE = (96.0, 22.0)
"""Of the line in a row of the ranking [px]."""


def small_panels(condition: Condition, signals: Sequence[Signal]) -> tuple[Small, ...]:
    """Return a panel for each controller in the order of the ranking."""
    shown, pictures = _shown(condition, signals), dict[ControllerResults, list[Markup]]()
    for signal in signals:
        members = [controller for controller in shown if column_name(controller) in signal.columns]
        title = signal.title.partition(" / ")[0][:_LONGEST_TITLE] if len(signals) > 1 else ""
        for controller, panel in _panels(signal, members, title).items():
            pictures.setdefault(controller, []).append(panel)
    return tuple(
        Small(
            clipped(controller.label),
            controller.index,
            _note(condition, controller),
            tuple(pictures[controller]),
        )
        for controller in shown
    )


def small_words(condition: Condition, signals: Sequence[Signal]) -> str:
    """Say what the small panels show."""
    best = _shown(condition, signals)[0]
    wanted = "the band" if any(signal.has_band for signal in signals) else "the reference"
    grey = f"{wanted} in grey, " if any(signal.wanted for signal in signals) else ""
    return f"One by one, in the order of the ranking: {grey}{clipped(best.label)} faint behind"


def _shown(condition: Condition, signals: Sequence[Signal]) -> list[ControllerResults]:
    columns = {name for signal in signals for name in signal.columns}
    return [controller for controller in condition.controllers if column_name(controller) in columns]


def _panels(
    signal: Signal, members: Sequence[ControllerResults], title: str
) -> dict[ControllerResults, Markup]:
    """Return the panels of a signal, all on the same axes."""
    names = [column_name(controller) for controller in members]
    width, height = _SIZE[0] - _LEFT - 2, _SIZE[1] - _TOP - _BOTTOM
    frame = Frame(width, height, signal.end, signal.extent(names), _LEFT, _TOP)
    behind = [*_axes(signal, frame, title), cut_off(frame, _behind(signal, frame, members[0]))]
    name, panels = f"{signal.id}-behind", dict[ControllerResults, Markup]()
    for number, controller in enumerate(members):
        # It is written once: the other panels refer to it.
        shared = f'<use href="#{name}"/>' if number else f'<g id="{name}">{"".join(behind)}</g>'
        column = known(signal.columns[column_name(controller)]) or [math.nan]
        low, high = (significant(end, 3) for end in (min(column), max(column)))
        label = f"{clipped(controller.label)}: {signal.title}, from {low} to {high}"
        inside = cut_off(frame, _own(signal, frame, controller))
        panels[controller] = picture([shared, inside], _SIZE, label, "small-picture")
    return panels


def _note(condition: Condition, controller: ControllerResults) -> str:
    """Return the figure that controllers are ranked by; of a run that failed how it ended."""
    case = controller.first_case
    if case is not None and not controller.succeeded_first:
        return outcome_words(case)
    figures = (
        with_unit(significant(controller.summed(key), 3), metric_unit(key))
        for key in condition.headline[:_MOST_FIGURES]
    )
    return "; ".join(figures)


def _axes(signal: Signal, frame: Frame, title: str) -> list[str]:
    """Return lines of the grid with their values, and the ends of the time."""
    left, right, bottom = frame.left, frame.left + frame.width, _SIZE[1] - 3
    grid, words = list[Line](), list[str]()
    for value, label in zip(*ticks(*frame.values, _TICKS), strict=True):
        y = frame.top + frame.down(value)
        grid.append((left, y, right, y))
        words.append(text(label, left - 3, y + 3.5, "end"))
    first, last = (as_given(float(f"{time:.3g}")) for time in signal.end)
    words += [text(first, left, bottom), text(f"{last}\u202f{signal.clock.unit}", right, bottom, "end")]
    if title:
        words.append(text(title, (left + right) / 2, bottom, "middle"))
    return [outline(frame), rules(grid, "var(--grid)"), f'<g fill="var(--ink-soft)">{"".join(words)}</g>']


def _behind(signal: Signal, frame: Frame, best: ControllerResults) -> list[str]:
    """Return what is the same in all panels: the reference or the band, and the best one, faint."""
    columns, times = signal.columns, signal.columns["t"]
    parts = []
    if signal.has_band:
        edges = (columns[LOWER], columns[UPPER])
        parts = [area(area_path(frame, times, *edges, held=True), "var(--ink)", 0.09)]
    elif signal.has_reference:
        path = line_path(frame, times, columns["r"], held=True)
        parts = [stroke(path, "var(--ink-soft)", 1.0, opacity=0.8)]
    path = line_path(frame, times, columns[column_name(best)], held=signal.held)
    return [*parts, stroke(path, colour(best.index), 1.2, opacity=0.35)]


def _own(signal: Signal, frame: Frame, controller: ControllerResults) -> list[str]:
    """Return the line of a controller, and its band over the seeds."""
    name, hue, parts = column_name(controller), colour(controller.index), list[str]()
    if name in signal.band:
        ends = (signal.band[name + end] for end in "lh")
        parts.append(area(area_path(frame, signal.band["t"], *ends, held=signal.held), hue, 0.2))
    path = line_path(frame, signal.columns["t"], signal.columns[name], held=signal.held)
    return [*parts, stroke(path, hue, 1.4, dashes(controller.index))]


def sparkline(
    times: Column, values: Column, wanted: Sequence[Column], ends: tuple[float, float], label: str, index: int
) -> Markup:
    """Return the line of a run on what it should follow, without axes.

    Parameters
    ----------
    times, values : list of float or None
        The samples.
    wanted : sequence of columns
        The reference, or the lower and the upper edge of a band; nothing.
    ends : tuple of float
        The least and the largest value that there is room for.
    label : str
        What it shows.
    index : int
        The controller's number, from which it has colour and dashes.
    """
    known_times = known(times) or [0.0, 1.0]
    frame = Frame(*_LINE, (known_times[0], known_times[-1]), ends)
    parts = []
    if len(wanted) == 2:
        parts.append(area(area_path(frame, times, *wanted, held=True), "var(--ink)", 0.12))
    elif wanted:
        parts.append(stroke(line_path(frame, times, wanted[0], held=True), "var(--ink-soft)", 0.8))
    parts.append(stroke(line_path(frame, times, values), colour(index), 1.2))
    return picture([cut_off(frame, parts)], _LINE, label, "spark")
