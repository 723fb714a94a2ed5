"""A chart over time as it stands in the page at first: what the live chart shows, drawn here.

Vega draws the same picture from the chart's specification; for a picture that takes a process and fifty
milliseconds. What is drawn, and where, follows :func:`ddpc_reports.figures.time_charts.time_chart`.
"""

from collections.abc import Sequence

from markupsafe import Markup

from ddpc_reports.embedding import FONT
from ddpc_reports.figures.charts import LABEL_ROOM, colour, dashes
from ddpc_reports.figures.signal import LOWER, UPPER, Signal
from ddpc_reports.figures.svg import (
    Frame,
    Line,
    Ticks,
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
from ddpc_reports.figures.time_charts import LABELS_FROM, MARK_ROW, NARROW, Label, Mark, label_rows
from ddpc_reports.numbers import as_given

_LEFT, _RIGHT, _TOP, _BOTTOM = LABEL_ROOM + 5.0, 6.0, 22.0, 20.0
_LETTER = 5.6
"""Width of a letter of a mark's label, about [px]."""
_FEWEST_LETTERS = 3


def still(
    signal: Signal, names: Sequence[str], marks: Sequence[Mark], size: tuple[int, int], label: str
) -> tuple[Markup, float]:
    """Return the picture of a chart over time, and its height [px].

    Parameters
    ----------
    signal : Signal
        What is drawn.
    names : sequence of str
        Columns of the controllers, the one drawn first at the back.
    marks : sequence of Mark
        What happens, in seconds.
    size : tuple of int
        Width and height of the chart, as of its specification [px].
    label : str
        What it shows.
    """
    clock = signal.clock
    marks = [mark._replace(begin=clock.of(mark.begin), end=clock.of(mark.end)) for mark in marks]
    labels, marks = label_rows(marks, signal.end, size[0])
    rows = max((placed.row + 1 for placed in labels), default=0)
    top = _TOP + (13.0 + MARK_ROW * (rows - 1) if rows else 0.0)
    width = float(size[0])
    frame = Frame(width - _LEFT - _RIGHT, float(size[1]), signal.end, signal.extent(names), _LEFT, top)
    lines = [
        *_wanted_band(signal, frame),
        *_limits(signal, frame),
        *_shades(marks, frame),
        *_spread(signal, names, frame),
        *_reference(signal, frame),
        *_given(signal, frame),
        *_controllers(signal, names, frame),
    ]
    parts = [
        *_axes(signal, frame, 8 if size[0] > NARROW else 6),
        outline(frame),
        cut_off(frame, lines),
        *_limit_words(signal, frame),
    ]
    parts.append(f'<g fill="var(--ink-soft)">{"".join(_labels(labels, frame))}</g>' if labels else "")
    height = top + frame.height + _BOTTOM
    parts = [f"<g{FONT}>", *parts, "</g>"]
    return picture(parts, (width, height), label, "static over-time"), height


def _labels(labels: Sequence[Label], frame: Frame) -> list[str]:
    """Return the labels of marks, clipped to the room that each has."""
    parts = []
    for placed in labels:
        most = int((frame.across(placed.end) - frame.across(placed.begin)) / _LETTER)
        words = placed.label if len(placed.label) <= most else f"{placed.label[: most - 1].rstrip()}…"
        if most > _FEWEST_LETTERS or words == placed.label:
            x, y = frame.left + frame.across(placed.t), frame.top - LABELS_FROM - MARK_ROW * placed.row
            parts.append(text(words, x, y, "end" if placed.leftwards else "start"))
    return parts


def _axes(signal: Signal, frame: Frame, count: int) -> list[str]:
    """Return grid, ticks and their words, and the title above the axis."""
    left, top, right, bottom = frame.left, frame.top, frame.left + frame.width, frame.top + frame.height
    grid, marks, words = list[Line](), list[Line](), list[str]()
    for value, label in zip(*ticks(*frame.values, 5), strict=True):
        y = top + frame.down(value)
        grid.append((left - 4, y, right, y))
        words.append(text(label, left - 8, y + 3.5, "end"))
    for time, label in zip(*_times(signal, count), strict=True):
        x = left + frame.across(time)
        marks.append((x, bottom, x, bottom + 4))
        side = "start" if x < left + 8 else "end" if x > right - 8 else "middle"
        words.append(text(f"{label}\u202f{signal.clock.unit}", x, bottom + 16, side))
    return [
        rules(grid, "var(--grid)"),
        rules(marks, "var(--rule)"),
        f'<g fill="var(--ink-soft)">{"".join(words)}</g>',
        f'<g font-size="12" fill="var(--ink)">{text(signal.title, 5, top - 7)}</g>',
    ]


def _times(signal: Signal, count: int) -> Ticks:
    """Return the ticks of time: of hours and days steps that suit them."""
    first, last = signal.end
    if not signal.clock.ticks:
        return ticks(first, last, count)
    step = next((step for step in signal.clock.ticks if last - first <= count * step), signal.clock.ticks[-1])
    begin = -int(-first // step)
    values = [float(f"{n * step:.12g}") for n in range(begin, int(last / step + 1e-9) + 1)]
    return Ticks(values, [as_given(value) for value in values])


def _wanted_band(signal: Signal, frame: Frame) -> list[str]:
    if not signal.has_band:
        return []
    lower, upper, times = signal.columns[LOWER], signal.columns[UPPER], signal.columns["t"]
    fill = area(area_path(frame, times, lower, upper, held=True), "var(--ink)", 0.09)
    edges = (line_path(frame, times, edge, held=True) for edge in (lower, upper))
    return [fill, *(stroke(edge, "var(--ink)", 0.8) for edge in edges)]


def _limits(signal: Signal, frame: Frame) -> list[str]:
    ends = [*signal.end]
    levels = [0.0] if signal.settled is not None else []
    zero = (
        stroke(line_path(frame, ends, [level, level]), "var(--ink)", 1.0, opacity=0.75) for level in levels
    )
    limits = (
        stroke(line_path(frame, ends, [limit, limit]), "var(--limit)", 1.0, "3 3") for limit in signal.limits
    )
    return [*limits, *zero]


def _limit_words(signal: Signal, frame: Frame) -> list[str]:
    right, (low, high) = frame.left + frame.width, frame.values
    parts = []
    for limit, words in signal.limits.items():
        if low <= limit <= high:
            y = frame.top + frame.down(limit) + (-2 if limit > (low + high) / 2 else 10)
            parts.append(f'<g font-size="10" fill="var(--limit)">{text(words, right, y, "end")}</g>')
    return parts


def _shades(marks: Sequence[Mark], frame: Frame) -> list[str]:
    """Shade spans and rule instants."""
    low, high = frame.values
    parts = []
    for mark in marks:
        if mark.end > mark.begin:
            span = [mark.begin, mark.end]
            parts.append(area(area_path(frame, span, [low, low], [high, high]), "var(--ink)", 0.06))
        instant = line_path(frame, [mark.begin, mark.begin], [low, high])
        parts.append(stroke(instant, "var(--ink-soft)", 0.8, "1 2"))
    return parts


def _spread(signal: Signal, names: Sequence[str], frame: Frame) -> list[str]:
    """Fill between the ends of the bands over the seeds, and draw the medians."""
    parts = []
    for name in (name for name in names if name in signal.band):
        times, hue = signal.band["t"], colour(int(name[1:]))
        ends = (signal.band[name + end] for end in "lh")
        parts.append(area(area_path(frame, times, *ends, held=signal.held), hue, 0.16))
        parts.append(
            stroke(line_path(frame, times, signal.band[name], held=signal.held), hue, 0.8, opacity=0.9)
        )
    return parts


def _reference(signal: Signal, frame: Frame) -> list[str]:
    if not signal.has_reference:
        return []
    path = line_path(frame, signal.columns["t"], signal.columns["r"], held=True)
    return [stroke(path, "var(--ink)", 1.0, opacity=0.75)]


def _given(signal: Signal, frame: Frame) -> list[str]:
    return [
        stroke(
            line_path(frame, signal.columns["t"], signal.columns[column], held=given.held),
            given.colour,
            given.width,
            " ".join(f"{length:g}" for length in given.dashes),
        )
        for given in signal.given
        for column in given.columns
    ]


def _controllers(signal: Signal, names: Sequence[str], frame: Frame) -> list[str]:
    times, columns = signal.columns["t"], signal.columns
    return [
        stroke(
            line_path(frame, times, columns[name], held=signal.held),
            colour(int(name[1:])),
            1.6,
            dashes(int(name[1:])),
        )
        for name in names
    ]
