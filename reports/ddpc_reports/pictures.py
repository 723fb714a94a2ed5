"""Figures of the page as drawings of their own, in its light colours: for notebooks and papers."""

import html
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from ddpc_cosim import ConfigError, Picture, StudyResults, Trace
from ddpc_cosim.files.tables import Table
from ddpc_cosim.files.texts import clipped, printable
from ddpc_cosim.metrics import keys_named
from ddpc_cosim.plugins import did_you_mean
from ddpc_reports.comparison import Condition, conditions, on_one_page
from ddpc_reports.embedding import rows_of, stylesheet
from ddpc_reports.figures.charts import Spec, colour, dash
from ddpc_reports.figures.clock import clock_for
from ddpc_reports.figures.figure import Figure, spread_figure, spread_figures, step_time_figure
from ddpc_reports.figures.outside import disturbances_of, prices_of
from ddpc_reports.figures.over_time import time_figures
from ddpc_reports.figures.samples import levels
from ddpc_reports.figures.signal import BAND, Column
from ddpc_reports.figures.still import still
from ddpc_reports.figures.time_charts import WIDE, time_chart
from ddpc_reports.tables.ranking import ranking_table

_COLOUR = re.compile(r"var\((--[\w-]+)\)")
_LIGHT = re.compile(r"(--[\w-]+): light-dark\((#\w+), ")
_BOX = re.compile(r'viewBox="0 0 ([\d.]+) ([\d.]+)"')
_FONT = "font-family=\"Helvetica, Arial, 'Liberation Sans', sans-serif\""
_LEAST_WIDTH, _TITLE_HEIGHT, _MARGIN = 300.0, 34.0, 12.0
_LINE_LENGTH, _LETTER, _ROW = 30.0, 6.2, 20.0
"""Of a legend: a line's length, a letter's width, about, and a row's height."""
_HEIGHT = 200
_FILE_NAME = re.compile(r"[^\w.-]+")


class Line(NamedTuple):
    """A line of a legend."""

    label: str
    colour: str
    dashes: Sequence[float] = ()


def stacked(title: str, drawings: Iterable[tuple[str, str]], legend: Sequence[Line] = ()) -> str:
    """Return drawings as one, narrow ones beside each other, in the colours of the light page.

    Parameters
    ----------
    title : str
        What stands above.
    drawings : iterable of (str, str)
        What stands above each of them, which may be empty, and the drawing as the page has it.
    legend : sequence of Line
        What stands between title and drawings.

    Raises
    ------
    OSError
        One of them cannot be drawn.
    """
    titles, svgs = zip(*given, strict=True) if (given := [*drawings]) else ((), ())
    boxes = [_BOX.search(svg) for svg in svgs]
    if not all(boxes):  # the words that stand in the page for a drawing that failed
        raise OSError(f"{title} cannot be drawn")
    sizes = [(float(box[1]), float(box[2])) for box in boxes if box]
    width = max([_LEAST_WIDTH, WIDE * bool(sizes), *(wide for wide, _ in sizes)]) + 2 * _MARGIN
    parts = [_text(_MARGIN, 22, title, 15)]
    keys, height = _legend(legend, _TITLE_HEIGHT, width)
    left, row = _MARGIN, 0.0
    for above, svg, (wide, high) in zip(titles, svgs, sizes, strict=True):
        if above or left + wide > width:  # beside the one before as long as there is room
            left, height, row = _MARGIN, height + row, 0.0
        if above:
            height += _ROW
            parts.append(_text(_MARGIN, height - 4, above, 13))
        place = f'<svg x="{left:g}" y="{height:g}" width="{wide:g}" height="{high:g}"'
        parts.append(svg.replace("<svg", place, 1))
        left, row = left + wide + _MARGIN, max(row, high + _MARGIN)
    height += row
    return in_light(
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        f'width="{width:g}" height="{height:g}" viewBox="0 0 {width:g} {height:g}">'
        f'<rect width="100%" height="100%" fill="var(--paper)"/>{keys}{"".join(parts)}</svg>\n'
    )


def _text(x: float, y: float, text: str, size: int) -> str:
    words = html.escape(printable(text))
    return f'<text x="{x:g}" y="{y:g}" {_FONT} font-size="{size}" fill="var(--ink)">{words}</text>'


def in_light(text: str) -> str:
    """Return a text with the colours of the light page in place of their names."""
    colours = dict(_LIGHT.findall(stylesheet()))
    return _COLOUR.sub(lambda match: colours.get(match[1], "none"), text)


def _legend(lines: Sequence[Line], top: float, width: float) -> tuple[str, float]:
    """Return the lines of a legend in rows, and where they end."""
    parts, x, y = list[str](), _MARGIN, top + _ROW / 2
    for line in lines:
        room = _LINE_LENGTH + 8 + _LETTER * len(line.label) + 18
        if x > _MARGIN and x + room > width:
            x, y = _MARGIN, y + _ROW
        pattern = " ".join(f"{length:g}" for length in line.dashes)
        dashes = f' stroke-dasharray="{pattern}"' if any(line.dashes[1::2]) else ""
        parts.append(
            f'<line x1="{x:g}" x2="{x + _LINE_LENGTH:g}" y1="{y:g}" y2="{y:g}" stroke="{line.colour}" '
            f'stroke-width="2"{dashes}/>{_text(x + _LINE_LENGTH + 6, y + 4, line.label, 12)}'
        )
        x += room
    return "".join(parts), (y + _ROW if lines else top)


def of_traces(traces: Mapping[str, Trace]) -> Picture:
    """Draw runs over each other: outputs with what is wanted, inputs, disturbances and prices.

    Raises
    ------
    ConfigError
        They are not of the same loop.
    """
    first = next(iter(traces.values()))
    kind = _signals_of(first)
    other = next((label for label, trace in traces.items() if _signals_of(trace) != kind), "")
    if other:
        theirs = _signals_of(traces[other])
        raise ConfigError(f"{other}: other signals: {_listed(theirs)}; needed: {_listed(kind)}")
    ended = [
        f"{label}: {trace.outcome}: {trace.reason}".removeprefix(": ")
        for label, trace in traces.items()
        if not trace.completed
    ]
    what = ", ".join(filter(None, traces)) or f"{', '.join(kind[1])} over time"
    title = clipped(printable("; ".join(ended) or what), 160)
    columns = {f"c{i}": trace for i, trace in enumerate(traces.values()) if len(trace)}
    if not columns:
        return Picture(title, stacked(title, []))
    labels = {f"c{i}": clipped(label) or "the run" for i, label in enumerate(traces)}
    longest = max(columns.values(), key=len)
    clock = clock_for(float(longest.time[0]), float(longest.time[-1] - longest.time[0]))
    signals = levels(columns, labels, clock, "x")
    acting = dict.fromkeys(v.name for v in (*longest.disturbances, *longest.changed_inputs))
    signals += disturbances_of(columns, acting, clock, "x") + prices_of(columns, clock, "x")
    legend = [Line(labels[name], colour(int(name[1:])), dash(int(name[1:]))) for name in columns]
    drawings, charts = list[tuple[str, str]](), list[Mapping[str, Any]]()
    for signal in signals:
        names = [name for name in columns if name in signal.columns]
        drawings.append(("", str(still(signal, names, (), (WIDE, _HEIGHT), signal.title)[0])))
        spec = time_chart(signal, names, longest.sampling_time, (), (WIDE, _HEIGHT))
        charts.append(_with_data(spec, {signal.id: signal.columns}))
    return Picture(title, stacked(title, drawings, legend if len(columns) > 1 else []), tuple(charts))


def _signals_of(trace: Trace) -> tuple[tuple[str, ...], tuple[str, ...]]:
    return tuple(v.name for v in trace.inputs), tuple(v.name for v in trace.outputs)


def _listed(signals: tuple[tuple[str, ...], tuple[str, ...]]) -> str:
    return " -> ".join(map(", ".join, signals))


def _with_data(spec: Spec, data: Mapping[str, dict[str, Column]]) -> Mapping[str, Any]:
    """Return a specification that stands for itself: its data and its colours are in it."""
    sets = {name: rows_of(columns) for name, columns in data.items() if columns}
    schema = "https://vega.github.io/schema/vega-lite/v6.json"
    full = {"$schema": schema, **spec, **({"datasets": sets} if sets else {})}
    resolved: Mapping[str, Any] = json.loads(in_light(json.dumps(full)))
    return resolved


def of_results(
    results: StudyResults, controllers: Sequence[str] = (), *, problem: str = "", scenario: str = ""
) -> Picture:
    """Draw responses and control signals of a scenario as the page does: first seed, bands over the seeds.

    Raises
    ------
    ConfigError
        There is no such problem, scenario or controller, or several of them and none is said.
    """
    condition = condition_of(results, controllers, problem=problem, scenario=scenario)
    drawn = time_figures(condition, "p-")
    figures = [
        figure
        for kind in ("responses", "inputs")
        for figure in drawn.figures[kind]
        if isinstance(figure, Figure) and not figure.folded
    ]
    return of_figures(f"{_title(condition)}, seed {condition.seeds[0]}", figures, drawn.samples)


def spread_of_results(
    results: StudyResults,
    metric: str = "",
    controllers: Sequence[str] = (),
    *,
    problem: str = "",
    scenario: str = "",
) -> Picture:
    """Draw a metric over the seeds, a strip for each controller; by default what the ranking is by.

    Raises
    ------
    ConfigError
        There is no such metric, problem, scenario or controller, or no run with a value of it.
    """
    condition = condition_of(results, controllers, problem=problem, scenario=scenario)
    keys = condition.headline
    if metric:
        keys = tuple(keys_named(metric, condition.every_key))
    figures = [
        figure for i, key in enumerate(keys) if (figure := spread_figure(condition, key, f"p-spread-{i}"))
    ]
    if not figures:
        raise ConfigError(f"{_title(condition)}: no run that did not fail has a value of {', '.join(keys)}")
    return of_figures(f"{_title(condition)}, {len(condition.seeds)} seeds", figures, {})


def of_figures(title: str, figures: Sequence[Figure], samples: Mapping[str, dict[str, Column]]) -> Picture:
    """Return figures of the page below each other, with one legend for all.

    Parameters
    ----------
    title : str
        What they are of.
    figures : sequence of Figure
        The figures.
    samples : mapping of str to columns
        The data that their charts name.
    """
    lines = [
        Line(entry.label, f"var(--c{entry.colour})", [float(length) for length in entry.dashes.split()])
        for figure in figures
        for entry in figure.legend
    ]
    lines += [
        Line(key.label, key.colour, [float(length) for length in key.dashes.split()])
        for figure in figures
        for key in figure.keys
    ]
    if any(figure.reference for figure in figures):
        lines.append(Line("reference", "var(--ink)"))
    views = [view for figure in figures for view in figure.views]
    charts = [
        _with_data(
            view.spec,
            {name: samples[name] for name in (view.data, f"{view.data}{BAND}") if name in samples},
        )
        for view in views
    ]
    before = ["", *(view.title for view in views)]
    drawings = (
        (view.title if view.title != last else "", str(view.drawing.svg))
        for view, last in zip(views, before, strict=False)
    )
    return Picture(title, stacked(title, drawings, unique(lines)), tuple(charts))


def every_figure(results: StudyResults) -> Iterator[tuple[str, Picture]]:
    """Yield each figure of the page over time, over the seeds and of step times, and a name for its file."""
    problems = on_one_page([results])[0].problems()
    for problem in problems:
        seen = conditions(problem)
        for condition in seen:
            where = [problem.study.name] * (len(problems) > 1) + [condition.scenario] * (len(seen) > 1)
            over_time = time_figures(condition, "p-")
            figures = [figure for kind in over_time.figures.values() for figure in kind]
            figures += spread_figures(condition, "p-")
            if step_times := step_time_figure(condition, "p-"):
                figures.append(step_times)
            for figure in figures:
                if isinstance(figure, Figure):
                    name = "-".join((*where, figure.id.removeprefix("p-")))
                    title = f"{figure.title}: {_title(condition)}"
                    yield _FILE_NAME.sub("-", name), of_figures(title, [figure], over_time.samples)


def unique(lines: Iterable[Line]) -> list[Line]:
    """Return lines of a legend without those of labels that are there already."""
    return [*{line.label: line for line in reversed([*lines])}.values()][::-1]


def ranking_of(
    results: StudyResults, controllers: Sequence[str] = (), *, problem: str = "", scenario: str = ""
) -> Table:
    """Return the table of the first screen of a scenario.

    Raises
    ------
    ConfigError
        There is no such problem, scenario or controller, or several of them and none is said.
    """
    condition = condition_of(results, controllers, problem=problem, scenario=scenario)
    return ranking_table(condition, condition.standings, "")


def condition_of(
    results: StudyResults, controllers: Sequence[str] = (), *, problem: str = "", scenario: str = ""
) -> Condition:
    """Return a scenario of a problem, with some of its controllers, by names or labels, or all.

    Raises
    ------
    ConfigError
        There is no such one, or several and none is said.
    """
    problems = {of_one.study.name: of_one for of_one in on_one_page([results])[0].problems()}
    asked_problem = problems[_chosen("problem", problem, [*problems])]
    known = dict.fromkeys(name for case in asked_problem.cases for name in (case.controller, case.label))
    faults = [
        f'no controller "{name}"; {did_you_mean(name, known)}' for name in controllers if name not in known
    ]
    if faults:
        raise ConfigError(faults)
    if controllers:
        cases = tuple(
            case
            for case in asked_problem.cases
            if case.controller in controllers or case.label in controllers
        )
        asked_problem = replace(asked_problem, cases=cases)
    scenarios = {condition.scenario: condition for condition in conditions(asked_problem)}
    return scenarios[_chosen("scenario", scenario, [*scenarios])]


def _chosen(what: str, asked: str, known: Sequence[str]) -> str:
    """Return the name that is asked for, or the only one."""
    if not known:
        raise ConfigError(f"there is no {what}: no case has been run")
    if asked and asked not in known:
        raise ConfigError(f'no {what} "{asked}"; {did_you_mean(asked, known)}')
    if not asked and len(known) > 1:
        raise ConfigError(f"several {what}s: {', '.join(known)}; say which: {what} = ...")
    return asked or known[0]


def _title(condition: Condition) -> str:
    study = condition.results.study
    scenario = condition.label if len(study.scenarios) > 1 else ""
    return clipped(": ".join(filter(None, (study.title or study.name, scenario))), 160)
