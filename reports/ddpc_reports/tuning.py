"""The section on tuning: what the trials of each controller came to, and the front of two objectives."""

import csv
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ddpc_cosim import StudyResults
from ddpc_cosim.study.results import TRIALS_FILE
from ddpc_reports.charts import front_chart
from ddpc_reports.figures import Figure, one_chart
from ddpc_reports.settings_tables import mapping_text
from ddpc_reports.table import Cell, Heading, Row, Table, number_cells
from ddpc_reports.verdict import counted

_BEFORE, _AFTER = 6, 3
"""Columns of the file before and after those of the objectives."""


@dataclass(frozen=True)
class _Trial:
    """A row of the file."""

    number: int
    runs: int
    pruned: bool
    lost: int
    values: tuple[float, ...]
    on_front: bool
    chosen: bool
    settings: dict[str, Any]


@dataclass(frozen=True)
class _Search:
    """The trials of a controller, of which the first is with the settings given, and the one chosen."""

    label: str
    trials: tuple[_Trial, ...]
    chosen: _Trial


def _read(results: StudyResults) -> tuple[list[str], list[_Search]]:
    """Return what the objectives are, and the trials of each controller; nothing where none was tuned."""
    file = results.folder / TRIALS_FILE
    if not file.is_file():
        return [], []
    with file.open(encoding="utf-8", newline="") as content:
        head, *rows = csv.reader(content)
    found: dict[str, list[_Trial]] = {}
    for problem, controller, number, runs, pruned, lost, *values, on_front, chosen, settings in rows:
        if problem == results.study.name:
            figures = tuple(float(value) if value else math.nan for value in values)
            of_runs = int(number), int(runs), pruned == "true", int(lost)
            of_all = on_front == "true", chosen == "true", json.loads(settings)
            found.setdefault(controller, []).append(_Trial(*of_runs, figures, *of_all))
    sections = results.study.controllers
    searches = [
        _Search(
            sections[key].label.removesuffix(", tuned") or key,
            tuple(trials),
            next(trial for trial in trials if trial.chosen),
        )
        for key, trials in found.items()
        if key in sections
    ]
    return head[_BEFORE:-_AFTER], searches


def trials_table(results: StudyResults, prefix: str) -> Table | None:
    """Return what the trials of each controller came to; None where none was tuned."""
    objectives, searches = _read(results)
    if not searches:
        return None
    both = [("as given", [one.trials[0] for one in searches]), ("tuned", [one.chosen for one in searches])]
    numbers: list[tuple[str, str, Sequence[float]]] = [
        ("Trials", "all", [len(one.trials) for one in searches]),
        ("Trials", "pruned", [sum(trial.pruned for trial in one.trials) for one in searches]),
        ("Trials", "runs", [sum(trial.runs for trial in one.trials) for one in searches]),
        *(("Runs lost", which, [trial.lost for trial in trials]) for which, trials in both),
        *(
            (name, which, [trial.values[number] for trial in trials])
            for number, name in enumerate(objectives)
            for which, trials in both
        ),
    ]
    columns = [
        (Heading(title, group=group), number_cells([*map(float, values)], better=""))
        for group, title, values in numbers
    ]
    found = [mapping_text(one.chosen.settings) if one.chosen.number else "as given" for one in searches]
    columns.append((Heading("Settings found", numeric=False), [Cell(text) for text in found]))
    rows = tuple(Row(one.label, tuple(cells[i] for _, cells in columns)) for i, one in enumerate(searches))
    headings = (Heading("Controller", numeric=False), *(heading for heading, _ in columns))
    notes = ["On the seeds of the trials; what the settings are worth shows on the seeds of this report."]
    notes += [f"Tuning: {told}." for told in [results.provenance.get("tuning")] if told]
    return Table(f"{prefix}trials", "Trials", headings, rows, tuple(notes), download="trials.csv")


def front_figures(results: StudyResults, prefix: str) -> list[Figure]:
    """Return for each controller its trials over two objectives, and their front; none of one objective."""
    objectives, searches = _read(results)
    if len(objectives) < 2:
        return []
    figures = []
    for number, one in enumerate(searches, start=1):
        if rows := _points(one):
            caption = _caption(objectives, one, len(rows))
            chart = front_chart(rows, objectives[:2], joined=len(objectives) == 2)
            name = f"{prefix}front-{number}"
            figures.append(one_chart(name, "Front of the objectives", caption, chart, one.label))
    return figures


def _points(one: _Search) -> list[dict[str, Any]]:
    """Return the trials that lose as few runs as the one chosen and have both figures."""
    return [
        {
            "x": trial.values[0],
            "y": trial.values[1],
            "front": trial.on_front,
            "chosen": trial.chosen,
            "given": trial.number == 0,
            "text": f"trial {trial.number}: {mapping_text(trial.settings)}",
        }
        for trial in one.trials
        if trial.lost == one.chosen.lost and all(map(math.isfinite, trial.values))
    ]


def _caption(objectives: Sequence[str], one: _Search, shown: int) -> str:
    left_out = len(one.trials) - shown
    rest = (
        f" Left out: {counted(left_out, 'trial')} that lost more runs or have no figures." if left_out else ""
    )
    line = "the line joins" if len(objectives) == 2 else "full ones are"
    return (
        f"{one.label}: one dot per trial; {line} those than which no other is better in one objective "
        f"and worse in none; diamond: the trial chosen, best in the first objective; square: as given.{rest}"
    )
