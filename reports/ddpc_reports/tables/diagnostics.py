"""What controllers learned from, and whether it can serve: a row per controller and distinct data."""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from ddpc_cosim import judge_prediction
from ddpc_cosim.files.tables import Cell, Heading, Row, Table, text_headings
from ddpc_reports.comparison import Condition, ControllerResults, spread
from ddpc_reports.numbers import MISSING, integer, significant
from ddpc_reports.tables.table import Column, controller_row, number_cells

Values = Mapping[str, float]
"""What one run says of its data, by name."""
_SAMPLES = "samples"
_OF_DATA = (
    "pe_order",
    "pe_order_needed",
    "data_rows",
    "data_columns",
    "data_rank",
    "smallest_singular_value",
    "condition",
    "prediction_error",
    "prediction_error_fitted",
)
_LEVELS = ("good", "fair", "poor")
_PLACE = re.compile(r"(.*)\[(\d+)\]")


@dataclass(frozen=True)
class _Data:
    """What is said of the data, one after the other seed: by whom, of which part, in which scenarios."""

    owner: ControllerResults
    part: str
    scenarios: tuple[str, ...]
    runs: tuple[Values, ...]

    def worst(self, name: str, of: Callable[[list[float]], float]) -> float:
        """Return the smallest or largest value over the seeds; NaN if none has one."""
        known = [run[name] for run in self.runs if not math.isnan(run.get(name, math.nan))]
        return of(known) if known else math.nan


def diagnostics_tables(conditions: Sequence[Condition], prefix: str) -> list[Table]:
    """Return what controllers say about their recordings, and what else they start with."""
    data = [
        entry
        for entry in _distinct(conditions, of_data=True)
        if any(set(run) - {_SAMPLES} for run in entry.runs)
    ]
    others = [entry for entry in _distinct(conditions, of_data=False) if any(entry.runs)]
    tables = [_data_table(data, prefix)] if data else []
    return tables + ([_others_table(others, prefix)] if others else [])


def _distinct(conditions: Sequence[Condition], *, of_data: bool) -> list[_Data]:
    """Return what controllers say, once for the scenarios in which it is the same for all seeds."""
    by_controller: dict[str, list[_Data]] = {}
    for condition in conditions:
        for controller in condition.controllers:
            for part, runs in _by_part(controller, of_data=of_data).items():
                known = by_controller.setdefault(controller.key, [])
                new = _Data(controller, part, (condition.label,), runs)
                place = next((i for i, d in enumerate(known) if (d.part, d.runs) == (part, runs)), None)
                if place is None:
                    known.append(new)
                else:
                    known[place] = _Data(controller, part, (*known[place].scenarios, condition.label), runs)
    return [entry for entries in by_controller.values() for entry in entries]


def _by_part(controller: ControllerResults, *, of_data: bool) -> dict[str, tuple[Values, ...]]:
    """Return what is said by each part of a controller, such as one of several loops, in every run."""
    parts: dict[str, list[dict[str, float]]] = {}
    for i, case in enumerate(controller.cases):
        for full, value in case.diagnostics.items():
            part, _, name = full.rpartition(".")
            if (name in _OF_DATA) == of_data:
                if part not in parts:
                    parts[part] = [{} for _ in controller.cases]
                run = parts[part][i]
                run[name] = value
                if of_data:
                    run[_SAMPLES] = float(case.recorded_samples or math.nan)
    return {part: tuple(runs) for part, runs in parts.items()}


def _data_table(data: Sequence[_Data], prefix: str) -> Table:
    several = any(len(entry.runs) > 1 for entry in data)
    errors = [entry.worst("prediction_error", max) for entry in data]
    middle = [spread(run.get("prediction_error", math.nan) for run in entry.runs).median for entry in data]
    fitted = [
        spread(run.get("prediction_error_fitted", math.nan) for run in entry.runs).median for entry in data
    ]

    def column(heading: Heading, name: str, of: Callable[[list[float]], float]) -> Column:
        values = [entry.worst(name, of) for entry in data]
        return heading, [Cell(_written(value), value) for value in values]

    order, matrix, off = "PE order", "data matrix", "prediction error"
    columns = [
        column(Heading("samples"), _SAMPLES, min),
        column(Heading("reached", group=order), "pe_order", min),
        column(Heading("needed", group=order), "pe_order_needed", max),
        column(Heading("windows", group=matrix), "data_columns", min),
        (Heading("rank", group=matrix), [_rank(entry) for entry in data]),
        column(Heading("condition", group=matrix), "condition", max),
        (Heading("held out", "median" if several else "", group=off), number_cells(middle, digits=3)),
        *([(Heading("held out", "worst", group=off), number_cells(errors, digits=3))] if several else []),
        (Heading("fitted", "median" if several else "", group=off), number_cells(fitted, digits=3)),
        (Heading("judgement", numeric=False), [Cell(_judgement(entry.runs)) for entry in data]),
    ]
    shown = [(heading, cells) for heading, cells in columns if any(cell.text != MISSING for cell in cells)]
    worst = " Over the seeds the worst is shown, where nothing else is said." if several else ""
    return Table(
        f"{prefix}diagnostics",
        "What the controllers learned from",
        (Heading("Controller", numeric=False), *(heading for heading, _ in shown)),
        _with_cells(data, [cells for _, cells in shown]),
        (
            "PE order: order of persistent excitation of the recorded inputs. Prediction error: root mean "
            "square at the end of the horizon, in parts of the output's standard deviation, of the output "
            "predicted worst; held out: on the last quarter of the recording, by what was fitted to the rest."
            " Judgement: poor where the PE order is not reached or the error held out is 0.5 or more, good "
            f"below 0.2.{worst}",
        ),
        download="diagnostics.csv",
        kind="grouped wordy",
    )


def _with_cells(data: Sequence[_Data], columns: Sequence[Sequence[Cell]]) -> tuple[Row, ...]:
    """Return the rows, below their scenarios where not all of them are of all."""
    several = len({entry.scenarios for entry in data}) > 1
    return tuple(
        controller_row(
            entry.owner,
            tuple(cells[i] for cells in columns),
            "; ".join(entry.scenarios) if several else "",
            ": ".join(filter(None, (entry.owner.label, entry.part))),
        )
        for i, entry in enumerate(data)
    )


def _rank(entry: _Data) -> Cell:
    rank, rows = entry.worst("data_rank", min), entry.worst("data_rows", max)
    return Cell(MISSING if math.isnan(rank) else f"{integer(rank)} of {integer(rows)}", rank)


def _judgement(runs: Sequence[Values]) -> str:
    """Return the worst judgement of all runs, and of how many it is where it is not of all."""
    judged = [judgement for run in runs if (judgement := _judged(run))]
    if not judged:
        return "not judged: prediction not tested"
    level = max((text.partition(":")[0] for text in judged), key=_LEVELS.index)
    those = [text for text in judged if text.startswith(level)]
    _, colon, why = those[0].partition(":")
    share = f" in {len(those)} of {len(runs)} runs" if len(those) < len(runs) else ""
    return f"{level}{share}{colon}{why}"


def _judged(run: Values) -> str:
    """Return what is to be said of one run's data; empty if nothing can be."""
    reached, needed = run.get("pe_order", math.nan), run.get("pe_order_needed", math.nan)
    if reached < needed:
        return f"poor: the inputs excite {integer(reached)} orders of the {integer(needed)} that are needed"
    error = run.get("prediction_error", math.nan)
    return "" if math.isnan(error) else judge_prediction(error, run.get("prediction_error_fitted", math.nan))


def _others_table(others: Sequence[_Data], prefix: str) -> Table:
    values = [Cell("; ".join(_other_words(entry.runs))) for entry in others]
    several = any(len(entry.runs) > 1 for entry in others)
    return Table(
        f"{prefix}start",
        "What else the controllers say of themselves",
        text_headings("Controller", "values"),
        _with_cells(others, [values]),
        ("Medians over the seeds, and their range where they differ.",) if several else (),
        download="start.csv",
        kind="grouped",
    )


def _other_words(runs: Sequence[Values]) -> Iterator[str]:
    """Yield names and values; those of a vector together."""
    gathered: dict[str, list[str]] = {}
    for name in dict.fromkeys(name for run in runs for name in run):
        of_all = spread(run.get(name, math.nan) for run in runs)
        among = f" ({_written(of_all.low)} … {_written(of_all.high)})" if of_all.varies else ""
        place = _PLACE.fullmatch(name)
        gathered.setdefault(place[1] if place else name, []).append(_written(of_all.median) + among)
    return (f"{name.replace('_', ' ')} {', '.join(texts)}" for name, texts in gathered.items())


def _written(value: float) -> str:
    return integer(value) if float(value).is_integer() and abs(value) < 1e6 else significant(value, 3)
