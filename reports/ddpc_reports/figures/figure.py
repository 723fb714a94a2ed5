"""What a figure of the page is; those over the seeds and of step times."""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple, TypeVar

from markupsafe import Markup

from ddpc_cosim import CosimWarning
from ddpc_cosim.files.texts import clipped, recorded, without_folders
from ddpc_cosim.metrics import metric_name
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
    Spec,
    dashes,
    ranges_widely,
    spread_chart,
    step_time_chart,
)
from ddpc_reports.figures.samples import column_name
from ddpc_reports.numbers import duration, given_duration, significant, with_unit

_LONGEST_TITLE, _MOST_TEXTS = 120, 40
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


SHAPES = {
    "dot": "M10,4a3,3 0 1 0 6,0a3,3 0 1 0 -6,0Z",
    "small-dot": "M11.5,4a1.5,1.5 0 1 0 3,0a1.5,1.5 0 1 0 -3,0Z",
    "tick": "M12,-1h2v10h-2Z",
    "triangle": "M13,0l4.5,8h-9Z",
    "diamond": "M13,-1l4,5l-4,5l-4,-5Z",
    "ring": "M13,-1l4,5l-4,5l-4,-5Zm0,2l-2.4,3l2.4,3l2.4,-3Z",
    "square": "M9.5,.5h7v7h-7Zm1.4,1.4v4.2h4.2v-4.2Z",
    "cross": "M11.5,-.5h3v3h3v3h-3v3h-3v-3h-3v-3h3Z",
}
"""Marks in a legend, as paths in a box of 26 by 8."""


class Key(NamedTuple):
    """A line of a legend that is not a controller's: what it is and how it is drawn.

    Parameters
    ----------
    label : str
        What it is.
    colour : str
        As in the page.
    dashes : str
        Of a line.
    is_area : bool
        Whether it is an area, which is drawn as wide.
    shape : str
        Of a mark, one of ``SHAPES``; empty: it is a line or an area.
    """

    label: str
    colour: str
    dashes: str = ""
    is_area: bool = False
    shape: str = ""

    @property
    def path(self) -> str:
        """The path of a mark; empty of lines and areas."""
        return SHAPES.get(self.shape, "")


class Small(NamedTuple):
    """The small panel of one controller.

    Parameters
    ----------
    label : str
        Of the controller.
    colour : int
        Its number, from which it has colour and dashes.
    note : str
        Its figure, or how its run ended.
    pictures : tuple of Markup
        One for each signal.
    """

    label: str
    colour: int
    note: str
    pictures: tuple[Markup, ...]


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
    fixed: bool = False
    """Whether its range is not that of its values, as long as the whole time is shown."""
    time: str = "s"
    """The unit of its time axis."""
    given: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """By column what is read out besides the controllers' values: its name and its colour."""
    also_scaling: tuple[str, ...] = ()
    """Columns besides those of controllers that set its range."""


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
    keys: tuple[Key, ...] = ()
    small: tuple[Small, ...] = ()
    """Panels of one controller each, and what they show."""
    small_words: str = ""

    @property
    def panels(self) -> list[tuple[str, list[View]]]:
        """The charts by panel, with its title: panels beside each other, their charts below each other."""
        return [(title, [*views]) for title, views in groupby(self.views, key=attrgetter("title"))]


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
        sentence = f"{what}: cannot be shown: {type(error).__name__}: {without_folders(recorded(error))}"
        warnings.warn(sentence, CosimWarning, stacklevel=2)
        return sentence


def entry(controller: ControllerResults, *, of_first: bool = True) -> Entry:
    """Return the line of a legend of a controller; ``of_first``: with how its first seed ended."""
    case = controller.first_case
    note = "" if controller.succeeded_first or not of_first else outcome_words(case) if case else "not run"
    return Entry(
        column_name(controller),
        controller.label,
        controller.index % COLOURS,
        dashes(controller.index),
        note,
    )


def spread_figures(condition: Condition, prefix: str) -> list[Figure]:
    """Return one strip plot over the seeds for each controlled output; none of one seed, or if all failed."""
    if len(condition.seeds) < 2:
        return []
    keys = enumerate(condition.headline)
    return [figure for i, key in keys if (figure := spread_figure(condition, key, f"{prefix}spread-{i}"))]


def spread_figure(condition: Condition, key: str, identifier: str) -> Figure | None:
    """Return the strip plot of a metric over the seeds; None if no run that did not fail has it."""
    what = metric_words(key, condition.every_key)
    axis = f"{what} / {metric_unit(key)}" if metric_unit(key) else what
    rows = [row for controller in condition.controllers for row in _spread_rows(condition, controller, key)]
    if not rows:
        return None
    dots = ""
    if len(condition.seeds) > _MOST_DOTS:
        dots = f"; {_MOST_DOTS} dots at most, even in rank from the lowest value to the highest"
    caption = f"Over {len(condition.seeds)} seeds, {what} in the cases that did not fail{dots}." + (
        " Logarithmic axis." if ranges_widely([row["value"] for row in rows]) else ""
    )
    keys = (
        Key("one seed", "var(--ink-soft)", shape="dot"),
        Key("median", "var(--ink)", shape="tick"),
        Key(f"seed {condition.seeds[0]}", "var(--ink)", shape="ring"),
    )
    return one_chart(identifier, "Spread over seeds", caption, spread_chart(rows, axis), keys=keys)


def _spread_rows(condition: Condition, controller: ControllerResults, key: str) -> list[dict[str, Any]]:
    """Return a row for each dot of a controller, and one more for the first seed where it has no dot."""
    values = {case.seed: case.metrics.get(key, math.nan) for case in controller.succeeded}
    ranked_seeds = sorted((seed for seed in values if math.isfinite(values[seed])), key=values.__getitem__)
    dots, first, label = set(_spread_out(ranked_seeds)), condition.seeds[0], clipped(controller.label)
    return [
        {
            "label": label,
            "key": column_name(controller),
            "value": _short(values[seed]),
            "first": seed == first,
            "text": f"{label}, seed {seed}: {with_unit(significant(values[seed]), metric_unit(key))}",
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
        _step_time_row(controller, metric_name(key), controller.summed(key))
        for controller in condition.controllers
        for key in STEP_TIMES
    ]
    rows = [row for row in rows if math.isfinite(row["value"]) and row["value"] > 0]
    if not rows:
        return None
    sampling_time = condition.results.study.loop.sampling_time
    figures, shapes = dict.fromkeys(row["figure"] for row in rows), ("dot", "triangle", "diamond", "cross")
    keys = (
        *(Key(words, "var(--ink-soft)", shape=shape) for words, shape in zip(figures, shapes, strict=False)),
        Key(f"sampling time, {given_duration(sampling_time)}", "var(--limit)", "4 3"),
    )
    caption = "Time of one controller step. Logarithmic axis."
    chart = step_time_chart(rows, sampling_time)
    return one_chart(f"{prefix}step-time", "Step time", caption, chart, keys=keys)


def _step_time_row(controller: ControllerResults, words: str, seconds: float) -> dict[str, Any]:
    return {
        "label": clipped(controller.label),
        "key": column_name(controller),
        "figure": words,
        "value": _short(seconds),
        "text": f"{clipped(controller.label)}, {words}: {duration(seconds)}",
    }


def one_chart(
    identifier: str, title: str, caption: str, spec: Spec, panel: str = "", keys: tuple[Key, ...] = ()
) -> Figure:
    """Return a figure of one chart; the caption describes it, and what its marks say."""
    name = f"{identifier}-1"
    words = "; ".join(_texts_of_marks(spec["data"]["values"]))
    description = f"{caption} {words}." if words else caption
    view = View(name, clipped(panel, _LONGEST_TITLE), description, spec, drawing(spec, name, description))
    return Figure(identifier, title, caption, (view,), keys=keys)


def _texts_of_marks(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the words of marks; of many in a row those of the least, the middle and the largest."""
    by_row: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        by_row.setdefault(row.get("label", ""), []).append(row)
    chosen: list[Mapping[str, Any]] = []
    for label, marks in by_row.items():
        ranked = sorted(marks, key=itemgetter("value")) if label else marks
        chosen += [ranked[0], ranked[len(ranked) // 2], ranked[-1]] if label else ranked[:_MOST_TEXTS]
    return list(dict.fromkeys(row["text"] for row in chosen if "text" in row))


def _short(value: float) -> float:
    return float(f"{value:.6g}")
