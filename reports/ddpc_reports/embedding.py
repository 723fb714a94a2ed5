"""What is embedded in the page: style, scripts, data, static drawings, and the policy that forbids more."""

import html
import json
import math
import re
import zlib
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache
from hashlib import sha256
from importlib.metadata import version
from importlib.resources import files
from itertools import pairwise
from typing import Any

import vl_convert
from markupsafe import Markup

from ddpc_cosim.files.texts import printable
from ddpc_cosim.plugins import cached
from ddpc_reports.figures.charts import CONFIG, DASHES
from ddpc_reports.figures.drawing import DrawingError, cached_picture, rendered
from ddpc_reports.figures.signal import Column

_WIDTH = 900
_AXIS = 42
"""What an axis adds to the height of a chart, about [px]."""
_LEFT_OUT = Markup(
    '<div class="static left-out" role="img" aria-label="{}"><p class="note">A script of the page draws this '
    "chart. The samples are in the files of the cases.</p></div>"
)
_NOTHING_DRAWN = Markup("")
_MOST_DECIMALS = 300
# Charts come compiled from Vega-Lite, so that the page needs Vega alone, a third less to load and to run; its
# interpreter of expressions needs no eval, which the policy of the page forbids.
_MODULES = "https://cdn.jsdelivr.net/npm/"  # how the package names its modules; nothing is loaded from there
_SNIPPET = f"""\
import {{ View, parse }} from "{_MODULES}vega@{vl_convert.get_vega_version()}/+esm";
import {{ expressionInterpreter }} from "{_MODULES}vega-interpreter@2.0.0/+esm";
window.chartLibrary = {{ View, parse, expressionInterpreter }};"""
_LONG_NUMBER = re.compile(r"-?\d+\.\d{2,}")
_PATH = re.compile(r' d="([^"]*)"')
_LINES = re.compile(r"(?:[ML]-?[\d.]+(?:e-?\d+)?,-?[\d.]+(?:e-?\d+)?)+Z?")
_UNSEEN = 3
"""Tenths of a pixel by which the line of a drawing may pass by its points."""
Point = tuple[int, int]
"""In parts of a pixel: tenths in drawings of Vega."""
_ID = re.compile(r' id="([^"]+)"')
_REFERENCE = re.compile(r"url\(#([^)]+)\)")
_SOURCE = (files("ddpc_reports") / "embedding.py").read_bytes()
_BOX = re.compile(r' viewBox="0 0 [\d.]+ ([\d.]+)"')
_TRANSFORM = re.compile(r' transform="[^"]*"')
_FAMILY = f' font-family="{CONFIG["font"]}"'
FONT = f'{_FAMILY} font-size="{CONFIG["axis"]["labelFontSize"]}px"'
_NOISE = re.compile(
    r' (?:aria-[a-z]+|role|pointer-events|class|xmlns:xlink|version|stroke-miterlimit)="[^"]*"|'
    r' (?:(?:opacity|stroke-width)="1"|[xy]2="0"|transform="translate\(0,0\)"|font-weight="normal")|'
    rf"{FONT}|{_FAMILY}"
)
_NOTHING = re.compile(r'<path d="M0,0h0v0h0Z"/>|<path d="[^"]*" display="none"/>')


def stylesheet() -> str:
    """Return the style of the page; the patterns of dashes are those of the charts."""
    return f"{_template('style.css')}\n{''.join(map(_dashed, range(1, len(DASHES))))}"


def _dashed(number: int) -> str:
    """Return the style of a key with dashes, of which the next ones begin where these end."""
    stops, end = list[str](), 0.0
    for place, length in enumerate(DASHES[number]):
        colour = "#0000" if place % 2 else "var(--key)"
        stops.append(f"{colour} {end:g}px {end + length:g}px")
        end += length
    return f".dashed-{number} {{ background: repeating-linear-gradient(90deg, {', '.join(stops)}); }}\n"


def page_script() -> str:
    """Return the page's own script."""
    return _template("against.js") + _template("report.js")


def _bundle() -> bytes:
    bundle: str = vl_convert.javascript_bundle(_SNIPPET)
    return bundle.encode()


@cache
def chart_library() -> str:
    """Return Vega as one script, taken from the vl-convert package.

    It is kept in the cache: to bundle it takes longer than all the rest of a small report.
    """
    place = f"vega/{version('vl-convert-python')}-{sha256(_SNIPPET.encode()).hexdigest()[:8]}.js"
    try:
        bundle = cached(place, _bundle).read_text(encoding="utf-8")
    except OSError:  # the report can do without a cache
        bundle = _bundle().decode()
    return f"(function () {{\n{bundle}\n}})();"


@lru_cache(maxsize=2)  # of the library, which is the same in every page, and of one page's data
def deflated(text: str) -> str:
    """Return a text as the page embeds what its script inflates: deflated, base64."""
    return b64encode(zlib.compress(text.encode(), 9)).decode("ascii")


def content_policy(scripts: Sequence[str]) -> str:
    """Return a content security policy: these scripts and no others, nothing fetched from anywhere."""
    rules = (
        "default-src 'none'",
        "img-src data:",
        "style-src 'unsafe-inline'",
        "script-src " + " ".join(map(_hash_source, scripts)),
        "base-uri 'none'",
        "form-action 'none'",
    )
    return "; ".join(rules)


def _hash_source(script: str) -> str:
    return f"'sha256-{b64encode(sha256(script.encode()).digest()).decode('ascii')}'"


def json_of(data: Mapping[str, Any]) -> str:
    """Return JSON in the fewest letters."""
    return json.dumps(data, ensure_ascii=False, separators=(",", ":"), allow_nan=False)


Packed = list[int | None]


def pack(column: Sequence[float | None]) -> Packed:
    """Write a column as decimals, first value, and changes from value to value, all as whole numbers.

    Samples change little from one to the next, so this takes half the room. Six digits of the range are kept.
    """
    known = [value for value in column if value is not None]
    span = max(known, default=0.0) - min(known, default=0.0)
    largest = span if 0.0 < span < math.inf else max(map(abs, known), default=0.0)
    decimals = min(5 - math.floor(math.log10(largest)), _MOST_DECIMALS) if largest > 0 else 0
    packed: Packed = [decimals]
    last = 0
    for value in column:
        whole = None if value is None else round(value * 10.0**decimals)
        packed.append(None if whole is None else whole - last)
        last = last if whole is None else whole
    return packed


def _template(name: str) -> str:
    return (files("ddpc_reports") / "templates" / name).read_text(encoding="utf-8")


@dataclass(frozen=True)
class Picture:
    """A chart as the page has it: drawn, or a sentence where it is not, and what makes it live.

    Parameters
    ----------
    svg : Markup
        What stands in the page from the start.
    height : float
        Of the drawing; 0 of a chart that cannot be drawn.
    vega : dict
        Vega specification without the samples; empty of a chart that cannot be drawn.
    """

    svg: Markup
    height: float = 0.0
    vega: dict[str, Any] = field(default_factory=dict)


class Drawing:
    """A chart that is drawn when it is asked for: what no page shows costs nothing.

    Parameters
    ----------
    svg, height, vega
        As of :class:`Picture`, of a chart that is there.
    make : callable, optional
        Makes the picture otherwise; its argument says whether it is to be drawn.
    """

    def __init__(
        self,
        svg: Markup = _NOTHING_DRAWN,
        height: float = 0.0,
        vega: dict[str, Any] | None = None,
        make: Callable[[bool], Picture] | None = None,
    ) -> None:
        self._make = make or (lambda is_drawn: Picture(svg, height, vega or {}))

    @cached_property
    def still(self) -> Picture:
        """The chart, drawn."""
        return self._make(True)

    @cached_property
    def live(self) -> Picture:
        """The chart with a sentence in the place of its drawing, for where a script draws it."""
        return self._make(False)

    @property
    def svg(self) -> Markup:
        """The drawing, or a sentence where it cannot be drawn."""
        return self.still.svg

    @property
    def height(self) -> float:
        """Height of the drawing; 0 of a sentence."""
        return self.still.height

    @property
    def vega(self) -> dict[str, Any]:
        """Vega specification without the samples; empty of a sentence."""
        return self.still.vega


def drawing(
    spec: Mapping[str, Any],
    identifier: str,
    description: str,
    data: Mapping[str, dict[str, Column]] | None = None,
) -> Drawing:
    """Draw a chart that scales with its box.

    Parameters
    ----------
    spec : mapping
        Vega-Lite specification; named data sets come from ``data``.
    identifier : str
        Unique in the page; ids inside the drawing start with it.
    description : str
        What the chart shows, for those who do not see it.
    data : mapping of str to columns, optional
        The data sets by name.
    """
    full = _full(spec)
    samples = {name: columns for name, columns in (data or {}).items() if columns}

    def draw() -> dict[str, Any]:
        vega, svg = rendered(full, {name: rows_of(columns) for name, columns in samples.items()})
        height = _BOX.search(svg)
        svg = _finish(svg, identifier, description)
        return {"svg": svg, "height": float(height[1]) if height else 0.0, "vega": vega}

    def compile_alone() -> dict[str, Any]:
        height = float(full.get("height", 0)) + _AXIS
        return {"svg": _LEFT_OUT.format(description), "height": height, "vega": rendered(full, None)[0]}

    def make(is_drawn: bool) -> Picture:
        said = [identifier, description] if is_drawn else [description]
        key = json_of({"spec": full, "samples": samples if is_drawn else None, "of": said}).encode()
        try:
            picture = cached_picture(key + _SOURCE, draw if is_drawn else compile_alone)
        except DrawingError as error:
            words = f"This picture could not be drawn: {error}. The samples are in the files of the cases."
            return Picture(Markup('<p class="static note">{}</p>').format(words))
        return Picture(Markup(picture["svg"]), picture["height"], picture["vega"])

    return Drawing(make=make)


def _full(spec: Mapping[str, Any]) -> dict[str, Any]:
    autosize = {"type": "fit-x", "contains": "padding"}
    return {"width": _WIDTH, **drawable(spec), "autosize": autosize, "config": CONFIG}


def brought_to_life(
    draw: Callable[[], tuple[Markup, float]], spec: Mapping[str, Any], description: str
) -> Drawing:
    """Return a picture that is drawn here, with what makes it answer a pointer, or why it does not.

    Parameters
    ----------
    draw : callable
        Returns the picture, as SVG, and its height, in its own units.
    spec : mapping
        Vega-Lite specification of the same.
    description : str
        What it shows, for those who do not see it.
    """
    full = _full(spec)

    def make(is_drawn: bool) -> Picture:
        height = float(full.get("height", 0)) + _AXIS
        picture, height = draw() if is_drawn else (Markup(_LEFT_OUT.format(description)), height)
        try:
            vega = cached_picture(json_of(full).encode(), lambda: {"vega": rendered(full, None)[0]})["vega"]
        except DrawingError as error:
            words = f"This picture does not answer a pointer: {error}."
            picture = picture if is_drawn else draw()[0]
            return Picture(picture + Markup('<p class="note">{}</p>').format(words))
        return Picture(picture, height, vega)

    return Drawing(make=make)


def drawable(value: Any) -> Any:
    """Return a specification in whose texts nothing acts unseen: of some characters the renderer dies."""
    if isinstance(value, Mapping):
        return {drawable(key): drawable(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [drawable(entry) for entry in value]
    return printable(value, keep="\n") if isinstance(value, str) else value


def rows_of(columns: Mapping[str, Column]) -> list[dict[str, float | None]]:
    """Turn columns into rows; a run that ended early has no value in the rows after its end."""
    length = len(columns["t"])
    padded = {name: [*values, *[None] * (length - len(values))] for name, values in columns.items()}
    return [dict(zip(padded, row, strict=True)) for row in zip(*padded.values(), strict=True)]


def _finish(svg: str, identifier: str, description: str) -> str:
    """Make ids unique in the page, name the drawing, and drop what costs bytes and says nothing.

    What has a name as a whole is inert inside: checkers of contrast cannot tell what a part lies on.
    """
    svg = _NOTHING.sub("", _NOISE.sub("", _TRANSFORM.sub(_rounded, svg)))
    svg = _number_ids(_PATH.sub(_short_path, svg), identifier)
    size = re.search(r' width="[\d.]+" height="[\d.]+"', svg)
    head = f' class="static" role="img" aria-label="{html.escape(description)}"{FONT}'
    return svg.replace(size[0], head, 1).replace("<g", '<g inert=""', 1) if size else svg


def _rounded(numbers: re.Match[str]) -> str:
    return _LONG_NUMBER.sub(lambda number: f"{float(number[0]):.1f}", numbers[0])


def _short_path(path: re.Match[str]) -> str:
    """Round to a tenth of a pixel; write lines of many points by their steps, as these are short."""
    if not _LINES.fullmatch(path[1]):
        return _rounded(path)
    pieces = [_points(piece) for piece in path[1].removesuffix("Z").split("M") if piece]
    end = "Z" if path[1].endswith("Z") else ""
    return f' d="{"".join(_steps(simplified(piece, _UNSEEN)) for piece in pieces)}{end}"'


def _points(piece: str) -> list[Point]:
    """Read ``x,yLx,yL...`` as points in tenths of a pixel."""
    corners = (corner.partition(",") for corner in piece.split("L"))
    return [(round(10 * float(x)), round(10 * float(y))) for x, _, y in corners]


def simplified(points: Sequence[Point], unseen: float) -> list[Point]:
    """Return as few of the points as have no other one farther than is seen above or below their line.

    Along a line that runs in one direction of x, the next corner may be chosen as long as its slope, seen
    from the last one, is among those that pass close enough to all points between.
    """
    kept = [points[0]]
    lowest, highest, ahead = -math.inf, math.inf, 0
    for before, (x, y) in pairwise(points):
        dx, dy = x - kept[-1][0], y - kept[-1][1]
        if before != kept[-1] and not (
            dx * ahead > 0 and lowest * dx * ahead <= dy * ahead <= highest * dx * ahead
        ):
            kept.append(before)
            lowest, highest, dx, dy = -math.inf, math.inf, x - before[0], y - before[1]
        ahead = (dx > 0) - (dx < 0)
        if dx:
            ends = sorted(((dy - unseen) / dx, (dy + unseen) / dx))
            lowest, highest = max(lowest, ends[0]), min(highest, ends[1])
    return [*kept, points[-1]] if len(points) > 1 else kept


def _steps(points: Sequence[Point]) -> str:
    """Write points as a start and the steps from it, those that go straight on in one."""
    moves = [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(points)]
    merged: list[tuple[int, int]] = []
    for dx, dy in moves:
        before = merged[-1] if merged else (0, 0)
        if (dx == before[0] == 0 and dy * before[1] >= 0) or (dy == before[1] == 0 and dx * before[0] >= 0):
            merged[-1:] = [(before[0] + dx, before[1] + dy)]
        else:
            merged.append((dx, dy))
    return f"M{_tenths(points[0][0])},{_tenths(points[0][1])}" + "".join(_step(*move) for move in merged)


def _step(dx: int, dy: int) -> str:
    if dx == 0 or dy == 0:
        return "" if dx == dy else f"h{_tenths(dx)}" if dx else f"v{_tenths(dy)}"
    return f"l{_tenths(dx)}{'' if dy < 0 else ','}{_tenths(dy)}"


def _tenths(count: int) -> str:
    """Write tenths in the fewest letters: ``-.3``, ``12``."""
    return f"{count / 10:.10g}".replace("0.", ".", 1) if -10 < count < 10 and count else f"{count / 10:.10g}"


def _number_ids(svg: str, identifier: str) -> str:
    """Give every drawing ids of its own, counted from one: Vega counts on from drawing to drawing."""
    names = {name: f"{identifier}-{number}" for number, name in enumerate(_ID.findall(svg), start=1)}
    svg = _ID.sub(lambda match: f' id="{names[match[1]]}"', svg)
    return _REFERENCE.sub(lambda match: f"url(#{names[match[1]]})", svg)
