"""Lines, bars and axes as SVG, without scripts: small pictures, and what stands in the page at first.

Colours are CSS variables of the page, as in its charts. Lines are written in halves of a pixel, which are
whole numbers, as less is not seen; what leaves a drawing is cut off by the inner ``svg`` with the lines.
"""

import html
import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

from markupsafe import Markup

from ddpc_cosim.files.texts import printable
from ddpc_reports.embedding import Point, simplified
from ddpc_reports.numbers import as_given, fixed

_PARTS = 2
"""Parts of a pixel in which lines are written."""
_UNSEEN = 1.0
"""Of these parts, by how much a line may pass by its samples."""
_BEYOND = 0.03
"""Of the height, how far lines are drawn beyond the edge that cuts them off."""
_LARGEST_PLAIN, _SMALLEST_PLAIN = 1e5, 1e-3


Samples = Sequence[float | None]
Line = tuple[float, float, float, float]
"""Both ends, across and down [px]."""


class Frame(NamedTuple):
    """Where values lie in a drawing.

    Parameters
    ----------
    width, height : float
        Of the drawing [px].
    times, values : tuple of float
        First and last time, least and largest value.
    left, top : float
        Where it begins in the picture [px].
    """

    width: float
    height: float
    times: tuple[float, float]
    values: tuple[float, float]
    left: float = 0.0
    top: float = 0.0

    def across(self, time: float) -> float:
        """Return how far to the right a time lies [px]."""
        first, last = self.times
        return self.width * (time - first) / ((last - first) or 1.0)

    def down(self, value: float) -> float:
        """Return how far down a value lies [px]; not much farther than the edge."""
        low, high = self.values
        share = (high - value) / ((high - low) or 1.0)
        return self.height * min(max(share, -_BEYOND), 1.0 + _BEYOND)

    def point(self, time: float, value: float) -> Point:
        """Return where a sample lies, in parts of a pixel."""
        return round(_PARTS * self.across(time)), round(_PARTS * self.down(value))


def line_path(frame: Frame, times: Samples, values: Samples, *, held: bool = False) -> str:
    """Return the path of a line through samples; it is interrupted where there is no value.

    Parameters
    ----------
    frame : Frame
        Where it lies.
    times, values : list of float or None
        The samples; a run that ended early has fewer values than there are times.
    held : bool
        Whether values hold until the next sample; else samples are joined.
    """
    return "".join(map(_path, _pieces(frame, times, values, held=held)))


def area_path(frame: Frame, times: Samples, low: Samples, high: Samples, *, held: bool = False) -> str:
    """Return the path of the area between two lines."""
    edges = (_pieces(frame, times, edge, held=held) for edge in (low, high))
    return "".join(
        f"{_path(simplified(below, _UNSEEN))}L{_path(above[::-1])[1:]}Z"
        for below, above in zip(*edges, strict=False)
    )


def _pieces(frame: Frame, times: Samples, values: Samples, *, held: bool) -> list[list[Point]]:
    """Return the points of a line in pieces without a gap."""
    pieces: list[list[Point]] = []
    before: Point | None = None
    for time, value in zip(times, values, strict=False):
        if time is None or value is None:
            before = None
            continue
        point = frame.point(time, value)
        if before is None:
            pieces.append([])
        elif held and point[1] != before[1]:
            pieces[-1].append((point[0], before[1]))
        if point != before:
            pieces[-1].append(point)
        before = point
    return pieces


def _path(points: Sequence[Point]) -> str:
    """Write points as a start and steps from it, in few letters."""
    kept = simplified(points, _UNSEEN)
    steps = ((b[0] - a[0], b[1] - a[1]) for a, b in pairwise(kept))
    letters = (
        f"h{dx}" if not dy else f"v{dy}" if not dx else f"l{dx}{'' if dy < 0 else ','}{dy}"
        for dx, dy in steps
    )
    return f"M{kept[0][0]},{kept[0][1]}{''.join(letters)}"


def stroke(path: str, colour: str, width: float = 1.6, dashes: str = "", opacity: float = 1.0) -> str:
    """Return a line of a path; empty without one."""
    if not path:
        return ""
    pattern = " ".join(f"{_PARTS * float(length):g}" for length in dashes.split())
    more = f' stroke-dasharray="{pattern}"' if pattern else ""
    more += f' opacity="{opacity:g}"' if opacity < 1 else ""
    return f'<path d="{path}" stroke="{colour}" stroke-width="{_PARTS * width:g}"{more}/>'


def area(path: str, colour: str, opacity: float) -> str:
    """Return a filled area; empty without one."""
    return f'<path d="{path}" fill="{colour}" opacity="{opacity:g}"/>' if path else ""


def cut_off(frame: Frame, lines: Iterable[str]) -> str:
    """Return lines that end at the edges of a frame."""
    place = f'x="{frame.left:g}" y="{frame.top:g}" width="{frame.width:g}" height="{frame.height:g}"'
    box = f'viewBox="0 0 {_PARTS * frame.width:g} {_PARTS * frame.height:g}"'
    return f'<svg {place} {box} preserveAspectRatio="none">{"".join(lines)}</svg>'


def picture(parts: Iterable[str], size: tuple[float, float], label: str, kind: str) -> Markup:
    """Return a drawing that is one thing to those who do not see it.

    Parameters
    ----------
    parts : iterable of str
        SVG.
    size : tuple of float
        Width and height [px].
    label : str
        What it shows.
    kind : str
        Its class in the page.
    """
    head = f'class="{kind}" role="img" aria-label="{html.escape(printable(label))}"'
    return Markup(
        f'<svg xmlns="http://www.w3.org/2000/svg" {head} viewBox="0 0 {size[0]:g} {size[1]:g}" fill="none">'
        f'<g inert="">{"".join(parts)}</g></svg>'
    )


def bar(share: float, label: str, colour: str) -> Markup:
    """Return a bar as long as a share of its room, from 0 to 1."""
    wide, high = 100.0, 5.0
    length = wide * min(max(share, 0.0), 1.0)
    parts = (
        f'<rect width="{width:.4g}" height="{high:g}" fill="{paint}"/>'
        for width, paint in ((wide, "var(--grid)"), (length, colour))
    )
    return picture(parts, (wide, high), label, "bar")


def bars(shares: Sequence[float], mark: float, label: str, colour: str) -> Markup:
    """Return upright bars as high as shares of their room, red without one, and a line at one height."""
    high = 22.0
    step = min(96.0 / max(len(shares), 1), 8.0)
    columns: dict[str, list[Line]] = {colour: [], "var(--bad)": []}
    for place, share in enumerate(shares):
        tall, paint = (1.5, "var(--bad)") if math.isnan(share) else (high * min(max(share, 0.0), 1.0), colour)
        middle = (place + 0.375) * step
        columns[paint].append((middle, high, middle, high - tall))
    parts = [rules(lines, paint, width=0.75 * step) for paint, lines in columns.items()]
    y = high * (1.0 - mark)
    parts.append(rules([(0.0, y, step * len(shares), y)], "var(--ink-soft)", "1 2"))
    return picture(parts, (round(step * len(shares), 1), high), label, "spark")


def text(words: str, x: float, y: float, anchor: str = "start") -> str:
    """Return a text at a place [px], in the colour of the group around it."""
    side = "" if anchor == "start" else f' text-anchor="{anchor}"'
    return f'<text x="{_short(x)}" y="{_short(y)}"{side}>{html.escape(printable(words))}</text>'


def rules(lines: Sequence[Line], colour: str, dashes: str = "", width: float = 1.0) -> str:
    """Return straight lines [px] as one path; empty without any."""
    paths = ("M{},{}L{},{}".format(*map(_short, line)) for line in lines)
    more = f' stroke-dasharray="{dashes}"' if dashes else ""
    more += f' stroke-width="{width:.3g}"' if width != 1.0 else ""
    return f'<path d="{"".join(paths)}" stroke="{colour}"{more}/>' if lines else ""


def outline(frame: Frame) -> str:
    """Return the edges of a frame."""
    place = f'x="{frame.left:g}" y="{frame.top:g}" width="{frame.width:g}" height="{frame.height:g}"'
    return f'<rect {place} stroke="var(--rule)"/>'


def _short(place: float) -> str:
    return f"{round(place, 1):g}"


class Ticks(NamedTuple):
    """Round numbers on an axis, and their words."""

    values: list[float]
    words: list[str]


def ticks(low: float, high: float, count: int) -> Ticks:
    """Return about so many multiples of 1, 2 or 5 from low to high, with the decimals of their distance."""
    step = _tick_step(low, high, count)
    if not step:
        return Ticks([low], [as_given(low)])
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    values = [float(f"{n * step:.12g}") for n in range(first, last + 1)]
    decimals = max(-math.floor(math.log10(step) + 1e-9), 0)
    return Ticks(values, [_tick_words(value, decimals) for value in values])


def _tick_step(low: float, high: float, count: int) -> float:
    """Return the distance of round numbers of which about so many lie between two values; 0: of none."""
    if not low < high or not math.isfinite(high - low):
        return 0.0
    rough = (high - low) / count
    power = 10.0 ** math.floor(math.log10(rough))
    factors = {10.0: 50.0, 5.0: 10.0, 2.0: 2.0}
    return power * next(
        (factor for factor, least in factors.items() if rough / power >= math.sqrt(least)), 1.0
    )


def _tick_words(value: float, decimals: int) -> str:
    is_plain = value == 0 or _SMALLEST_PLAIN <= abs(value) < _LARGEST_PLAIN
    return fixed(value, decimals) if is_plain else as_given(value)
