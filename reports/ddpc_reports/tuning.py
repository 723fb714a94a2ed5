"""The section on tuning: what the trials of each controller came to, and the front of two objectives."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ddpc_cosim import StudyResults
from ddpc_cosim.files.tables import Cell, Heading, Row, Table, own_rows
from ddpc_reports.comparison import metric_words
from ddpc_reports.figures.charts import front_chart
from ddpc_reports.figures.figure import Figure, Key, one_chart
from ddpc_reports.tables.settings import mapping_text
from ddpc_reports.tables.table import Column, number_cells
from ddpc_reports.verdict import counted

_FIGURES = "pruned", "not dominated"
"""Columns of the file between which runs failed and objectives stand; held out they come again later."""
_HELD_OUT = "held out: "


@dataclass(frozen=True)
class _Trial:
    """A row of the file; figures are failed runs and objectives, NaN where there are none."""

    number: int
    origin: str
    runs: int
    pruned: bool
    figures: tuple[float, ...]
    on_front: bool
    chosen: bool
    held_out: tuple[float, ...]
    at_ends: str
    settings: dict[str, Any]


@dataclass(frozen=True)
class _Search:
    """The trials of a controller, of which the first is with the settings given, and the one chosen."""

    label: str
    trials: tuple[_Trial, ...]
    chosen: _Trial


def _read(results: StudyResults) -> tuple[list[str], list[_Search]]:
    """Return what the figures are, and the trials of each controller; nothing where none was tuned."""
    if not results.trials_file.is_file():
        return [], []
    head, rows = own_rows(results.trials_file.read_text(encoding="utf-8"))
    first, last = (head.index(name) for name in _FIGURES)
    figures = head[first + 1 : last]
    by_controller: dict[str, list[_Trial]] = {}
    for row in (dict(zip(head, values, strict=True)) for values in rows):
        if row["problem"] == results.study.name:
            trial = _Trial(
                number=int(row["trial"]),
                origin=row.get("origin", ""),
                runs=int(row["runs"]),
                pruned=row["pruned"] == "true",
                figures=_numbers([row[name] for name in figures]),
                on_front=row["not dominated"] == "true",
                chosen=row["chosen"] == "true",
                held_out=_numbers([row[_HELD_OUT + name] for name in figures]),
                at_ends=row.get("at ends", ""),
                settings=json.loads(row["settings"]),
            )
            by_controller.setdefault(row["controller"], []).append(trial)
    sections = results.study.controllers
    searches = [
        _Search(
            sections[key].label.removesuffix(", tuned") or key,
            tuple(trials),
            next(trial for trial in trials if trial.chosen),
        )
        for key, trials in by_controller.items()
        if key in sections
    ]
    parts = (name.partition(",") for name in figures)
    return [f"{metric_words(what)}{comma}{how}" for what, comma, how in parts], searches


def _numbers(words: Sequence[str]) -> tuple[float, ...]:
    return tuple(float(word) if word else math.nan for word in words)


def trials_tables(results: StudyResults, prefix: str) -> list[Table]:
    """Return what the settings found are worth, and what the trials came to; none where none was tuned."""
    names, searches = _read(results)
    if not searches:
        return []
    given, chosen = [search.trials[0] for search in searches], [search.chosen for search in searches]
    worth = [
        column
        for number, name in enumerate(names)
        for column in _pair(
            name, [[trial.held_out[number] for trial in trials] for trials in (given, chosen)]
        )
    ]
    texts = [mapping_text(trial.settings) if trial.number else "as given" for trial in chosen]
    worth.append((Heading("settings found", numeric=False), [Cell(text) for text in texts]))
    at_ends = any(trial.at_ends for trial in chosen)
    if at_ends:
        cells = [Cell(trial.at_ends) for trial in chosen]
        worth.append((Heading("at an end of the search", numeric=False), cells))
    counts = {
        "all": [len(search.trials) for search in searches],
        "pruned": [sum(trial.pruned for trial in search.trials) for search in searches],
        "runs": [sum(trial.runs for trial in search.trials) for search in searches],
    }
    trials = [
        (Heading(title, group="trials"), number_cells([*map(float, values)], better=""))
        for title, values in counts.items()
    ]
    for number, name in enumerate(names):
        trials += _pair(name, [[trial.figures[number] for trial in trials] for trials in (given, chosen)])
    if any(trial.origin for trial in chosen):
        trials.append((Heading("chosen from", numeric=False), [Cell(trial.origin) for trial in chosen]))
    took = results.provenance.get("tuning")
    notes = (
        "On the seeds of the trials, by which the settings were chosen.",
        *([f"{took}."] if took else []),
    )
    labels = [search.label for search in searches]
    said = ("Settings within 3 % of an end of where was looked: a wider search may find better ones.",)
    ends = said if at_ends else ()
    title = "As given against tuned, on the seeds of this report"
    return [
        _table(f"{prefix}tuned", title, labels, worth, ends),
        _table(f"{prefix}trials", "Trials", labels, trials, notes),
    ]


def _pair(name: str, values: Sequence[Sequence[float]]) -> list[Column]:
    """Return the columns of a figure as given and as tuned; of each row the lower one is marked."""
    cells = [number_cells(column, better="") for column in values]
    marked = [
        [replace(a, best=a.raw < b.raw), replace(b, best=b.raw < a.raw)] for a, b in zip(*cells, strict=True)
    ]
    titles = enumerate(("as given", "tuned"))
    return [(Heading(title, group=name), [row[i] for row in marked]) for i, title in titles]


def _table(
    identifier: str,
    caption: str,
    labels: Sequence[str],
    columns: Sequence[Column],
    notes: tuple[str, ...] = (),
) -> Table:
    rows = tuple(Row(label, tuple(cells[i] for _, cells in columns)) for i, label in enumerate(labels))
    headings = (Heading("Controller", numeric=False), *(heading for heading, _ in columns))
    return Table(identifier, caption, headings, rows, notes, download=f"{identifier.rpartition('-')[2]}.csv")


def front_figures(results: StudyResults, prefix: str) -> list[Figure]:
    """Return for each controller its trials over two objectives, and their front; none of one objective."""
    names, searches = _read(results)
    if len(objectives := names[1:]) < 2:
        return []
    figures = []
    for number, search in enumerate(searches, start=1):
        if rows := _points(search):
            caption = _caption(search, len(rows))
            chart = front_chart(rows, objectives[:2], joined=len(objectives) == 2)
            name = f"{prefix}front-{number}"
            keys = _keys(rows, joined=len(objectives) == 2)
            figures.append(one_chart(name, "Front of the objectives", caption, chart, search.label, keys))
    return figures


def _points(search: _Search) -> list[dict[str, Any]]:
    """Return the trials with as few failed runs as the one chosen and have both figures."""
    return [
        {
            "x": trial.figures[1],
            "y": trial.figures[2],
            "front": trial.on_front,
            "chosen": trial.chosen,
            "given": trial.number == 0,
            "text": f"trial {trial.number}: {mapping_text(trial.settings)}",
        }
        for trial in search.trials
        if trial.figures[0] == search.chosen.figures[0] and all(map(math.isfinite, trial.figures))
    ]


def _caption(search: _Search, shown: int) -> str:
    left_out = len(search.trials) - shown
    rest = f" Left out: {counted(left_out, 'trial')} with more failed runs or no figures." if left_out else ""
    return (
        f"{search.label}: trials over two objectives, lower and further left is better. The one chosen is "
        f"within 1\u00a0% of the best in the first objective.{rest}"
    )


def _keys(rows: Sequence[Mapping[str, Any]], *, joined: bool) -> tuple[Key, ...]:
    """Return what the marks mean; a line joins the front of two objectives."""
    front = "no other is better in one and worse in none"
    return (
        Key("trial", "var(--accent)", shape="small-dot"),
        Key(front, "var(--accent)") if joined else Key(front, "var(--accent)", shape="dot"),
        Key("trial chosen", "var(--ink)", shape="ring"),
        *([Key("as given", "var(--ink)", shape="square")] if any(row["given"] for row in rows) else []),
    )
