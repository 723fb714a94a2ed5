"""Figures of the response, computed from the files of a case alone: by definition, row by row."""

import csv
import json
import math
from functools import lru_cache
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

NAN = math.nan


class Step(NamedTuple):
    """A stretch of constant reference; ``size`` is NaN where no step leads to it."""

    first: int
    end: int
    size: float
    settled: float
    overshoot: float
    rise: float
    settling: float


@lru_cache(maxsize=1)
def read_case(folder: Path) -> tuple[dict[str, Any], dict[str, list[float]]]:
    """Return run.json, and the numeric columns of signals.csv by header."""
    run = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    with (folder / "signals.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return run, {key: [float(row[key]) for row in rows] for key in rows[0] if key != "status"}


def steps_of(r: list[float], y: list[float], preview: int, h: float) -> list[Step]:
    """Return the stretches whose windows [first, end - preview) hold five samples or more."""
    begins = [0, *(k for k in range(1, len(r)) if r[k] != r[k - 1])]
    found = []
    for n, (first, end) in enumerate(zip(begins, [*begins[1:], len(r)], strict=True)):
        last = end - preview
        if end - first < 3 or last - first < 5:
            continue
        before = r[first - 1] if n else y[0]
        size = r[first] - before
        if n == 0 and abs(size) < 0.01 * (max(r) - min(r)):
            size = NAN
        if n and first - begins[n - 1] < 3:
            size = NAN
        tail = range(last - round((last - first) / 5), last)
        settled = abs(math.fsum(r[k] - y[k] for k in tail) / len(tail))
        share = {k: (y[k] - before) / size for k in range(max(first - preview, 0), last)}
        there = [k for k in share if share[k] >= 0.9]
        below = [k for k in range(max(first - preview, 0), there[0]) if share[k] <= 0.1] if there else []
        outside = [k for k in range(first, last) if abs(share[k] - 1) > 0.05]
        arrived = outside[-1] + 1 if outside else first
        found.append(
            Step(
                first,
                end,
                size,
                settled,
                max(0.0, *(share[k] - 1 for k in range(first, last))) * 100,
                (there[0] - below[-1]) * h if below else NAN,
                (arrived - first) * h if arrived < last else NAN,
            )
        )
    return found


@lru_cache(maxsize=1)
def outputs_of(folder: Path, preview: int) -> dict[str, tuple[dict[str, Any], list[Step], list[float]]]:
    """Return each controlled output with its steps and its errors, all in its own unit."""
    run, columns = read_case(folder)
    found = {}
    for output in run["outputs"]:
        header = f"{output['name']} [{output['unit'] or '1'}]"
        r, y = columns[f"reference {header}"][:-1], columns[header][:-1]
        errors = [a - b for a, b in zip(r, y, strict=True)]
        found[output["name"]] = (output, steps_of(r, y, preview, run["sampling_time"]), errors)
    return found


def figures_of(folder: Path, preview: int) -> dict[str, float]:
    """Return the figures of a completed case by the keys of metrics.csv."""
    table = {}
    for name, (output, stretches, errors) in outputs_of(folder, preview).items():
        shown = output["display_unit"] or {"name": output["unit"], "factor": 1.0}
        unit, factor = shown["name"] or "1", abs(shown["factor"])
        steps = [stretch for stretch in stretches if not math.isnan(stretch.size)]
        table |= {
            f"mean_abs_error.{name} [{unit}]": factor * math.fsum(map(abs, errors)) / len(errors),
            f"rmse.{name} [{unit}]": factor * math.sqrt(math.fsum(e * e for e in errors) / len(errors)),
            f"settled_error.{name} [{unit}]": factor * worst([one.settled for one in stretches]),
            f"settled_share.{name} [%]": worst([100 * one.settled / abs(one.size) for one in steps]),
            f"overshoot.{name} [%]": worst([step.overshoot for step in steps]),
            f"rise_time.{name} [s]": middle([step.rise for step in steps]),
            f"settling_time.{name} [s]": worst([step.settling for step in steps]),
        }
    return table


def holds(folder: Path, preview: int) -> bool:
    """Return whether a case completed and stayed near its references."""
    run, columns = read_case(folder)
    kept = run["outcome"] == "completed"
    for i, (name, (output, stretches, _)) in enumerate(outputs_of(folder, preview).items()):
        header = f"{name} [{output['unit'] or '1'}]"
        r, y = columns[f"reference {header}"][:-1], columns[header][:-1]
        low, high = float(run["bounds"]["y_min"][i]), float(run["bounds"]["y_max"][i])
        kept &= max(0.0, max(y) - high, low - min(y)) <= (max(r) - min(r) or abs(r[0] - y[0]))
        kept &= all(one.settled <= abs(one.size) / 2 for one in stretches if not math.isnan(one.size))
    return kept


def worst(values: list[float]) -> float:
    return NAN if not values or any(map(math.isnan, values)) else max(values)


def middle(values: list[float]) -> float:
    return NAN if not values or any(map(math.isnan, values)) else median(values)
