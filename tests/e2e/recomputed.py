"""Figures of the response, computed from the files of a case alone: by definition, row by row."""

import csv
import json
import math
import tomllib
from functools import lru_cache
from pathlib import Path
from statistics import fmean, median
from typing import Any, NamedTuple

import numpy as np

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


@lru_cache(maxsize=2)
def read_case(folder: Path) -> tuple[dict[str, Any], dict[str, list[float]]]:
    """Return run.json, and the numeric columns of signals.csv by header."""
    run = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    with (folder / "signals.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return run, {key: [float(row[key]) for row in rows] for key in rows[0] if key != "status"}


def steps_of(r: list[float], y: list[float], preview: int, h: float) -> list[Step]:
    """Return the stretches whose windows [first, end - preview) hold five samples or more."""
    begins = [0, *(k for k in range(1, len(r)) if r[k] != r[k - 1])]
    stretches = []
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
        stretches.append(
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
    return stretches


@lru_cache(maxsize=1)
def outputs_of(folder: Path, preview: int) -> dict[str, tuple[dict[str, Any], list[Step], list[float]]]:
    """Return each controlled output with its steps and its errors, all in its own unit."""
    run, columns = read_case(folder)
    outputs = {}
    for output in run["outputs"]:
        header = f"{output['name']} [{output['unit'] or '1'}]"
        r, y = columns[f"reference {header}"][:-1], columns[header][:-1]
        errors = [a - b for a, b in zip(r, y, strict=True)]
        outputs[output["name"]] = (output, steps_of(r, y, preview, run["sampling_time"]), errors)
    return outputs


def figures_of(folder: Path, preview: int) -> dict[str, float]:
    """Return the figures of a completed case by the keys of metrics.csv."""
    table: dict[str, float] = {}
    for name, (output, stretches, errors) in outputs_of(folder, preview).items():
        shown = output["display_unit"] or {"name": output["unit"], "factor": 1.0}
        unit, factor = shown["name"] or "1", abs(shown["factor"])
        steps = [stretch for stretch in stretches if not math.isnan(stretch.size)]
        table |= {
            f"mean_abs_error.{name} [{unit}]": factor * math.fsum(map(abs, errors)) / len(errors),
            f"rmse.{name} [{unit}]": factor * math.sqrt(math.fsum(e * e for e in errors) / len(errors)),
            f"settled_error.{name} [{unit}]": factor * worst([stretch.settled for stretch in stretches]),
            f"settled_share.{name} [%]": worst([100 * step.settled / abs(step.size) for step in steps]),
            f"overshoot.{name} [%]": worst([step.overshoot for step in steps]),
            f"rise_time.{name} [s]": middle([step.rise for step in steps]),
            f"settling_time.{name} [s]": worst([step.settling for step in steps]),
        }
    return table


class Verdict(NamedTuple):
    """What docs/metrics.md concludes of a run."""

    failed: bool
    settles: bool | None


class Ends(NamedTuple):
    """Means over the last fifth of a stretch: the error's magnitude, that of its mean, rows, and the step."""

    magnitude: float
    offset: float
    rows: int
    step: float
    settling: bool


def verdict(folder: Path, preview: int) -> Verdict:
    """Return whether a run failed and whether it settles, from its samples and those of doing nothing."""
    run, driven = _judged_by(folder)
    if run["outcome"] != "completed":
        return Verdict(True, False)
    resting, rest = _judged_by(resting_folder(folder))
    rests = resting["outcome"] == "completed"
    study = tomllib.loads((folder.parents[1] / "study.toml").read_text(encoding="utf-8"))
    scenario = study["scenarios"][run["scenario"]]
    far, left, worse, alone = False, list[float](), list[float](), list[float]()
    for i, output in enumerate(run["outputs"]):
        r, y = driven[output["name"]]
        _, nothing = rest[output["name"]]
        travel = span([*r, y[0]])
        if min(r) == max(r) and at_rest(travel, [*r, *y]):
            travel = 0.0
        goes = max(abs(error - nothing[0]) for error in nothing) if rests else 0.0
        goes = 0.0 if at_rest(goes, [*r, *nothing]) else goes
        moves = max(travel, goes if min(r) == max(r) else min(goes, 3 * travel))
        width = float(run["bounds"]["y_max"][i]) - float(run["bounds"]["y_min"][i])
        size = moves or (width if math.isfinite(width) else max(output["nominal"], *map(abs, r)))
        acted_on = scenario.get("disturbances") or scenario.get("inputs")
        scattered = min(scatter(y), scatter(nothing)) if acted_on else 0.0
        s = math.hypot(scenario.get("noise", {}).get(output["name"], 0.0), scattered)
        half = 0.5 * scenario.get("quantum", {}).get(output["name"], 0.0)
        ends = ends_of(r, y, preview, run["sampling_time"])
        for end in ends:
            far |= end.magnitude - mean_magnitude(s, end.rows) - half >= 0.5 * size
            if end.settling:
                offset = max(end.offset - 4 * s / math.sqrt(end.rows) - half, 0.0)
                left.append(100 * offset / (abs(end.step) if abs(end.step) > 0.01 * travel else size))
        if rests:
            more = mean_magnitude(s, sum(end.rows for end in ends)) + half
            worse.append((mean_error(r, y) - mean_error(r, nothing) - more) / size)
            alone += worse[-1:] if moves else []
    failed = far or (rests and max(fmean(worse), *alone) > 0.01)
    return Verdict(failed, max(left) <= 5.0 if left else None)


def span(values: list[float]) -> float:
    return max(values) - min(values)


def at_rest(moved: float, values: list[float]) -> bool:
    """Return whether what moved by so much rests, rounded as its values may be."""
    return moved <= 1e-4 * max(map(abs, values))


def mean_magnitude(s: float, rows: int) -> float:
    """Return the mean magnitude of Gaussian noise, and four standard errors of it."""
    return math.sqrt(2 / math.pi) * s + 4 * math.sqrt(1 - 2 / math.pi) * s / math.sqrt(rows)


def scatter(y: list[float]) -> float:
    """Return the standard deviation of what the last value and the last change do not tell of the next."""
    if len(y) < 10 or not span(y):
        return 0.0
    x = np.array(y) - fmean(y)
    regressors = np.column_stack([np.ones(len(x) - 2), x[1:-1], np.diff(x)[:-1]])
    # A prediction that is exact up to rounding misses by next to nothing, whatever the columns' rank.
    coefficients, *_ = np.linalg.lstsq(regressors / span(y), x[2:])
    missed = sorted(map(abs, (x[2:] - regressors @ coefficients / span(y)).tolist()))
    kept = missed[: len(missed) - math.ceil(0.05 * len(missed))]
    return 1.148 * math.sqrt(math.fsum(error**2 for error in kept) / (len(kept) - 3))


def ends_of(r: list[float], y: list[float], preview: int, h: float) -> list[Ends]:
    """Return the ends of the stretches of constant reference, else that of the run."""
    stretches = steps_of(r, y, preview, h)
    if not stretches:
        return [_end(r, y, range(len(r) - max(round(len(r) / 5), 1), len(r)), 0.0, settling=False)]
    steps_nowhere = all(math.isnan(stretch.size) for stretch in stretches)
    ends = []
    for stretch in stretches:
        last = stretch.end - preview
        # A run may begin away from its reference: that is no step of it.
        step = 0.0 if stretch.first == 0 or math.isnan(stretch.size) else stretch.size
        tail = range(last - round((last - stretch.first) / 5), last)
        ends.append(_end(r, y, tail, step, settling=steps_nowhere or not math.isnan(stretch.size)))
    return ends


def _end(r: list[float], y: list[float], tail: range, step: float, *, settling: bool) -> Ends:
    errors = [r[k] - y[k] for k in tail]
    return Ends(fmean(map(abs, errors)), abs(fmean(errors)), len(tail), step, settling)


def mean_error(r: list[float], y: list[float]) -> float:
    return fmean(abs(a - b) for a, b in zip(r, y, strict=True))


@lru_cache(maxsize=2)
def _judged_by(folder: Path) -> tuple[dict[str, Any], dict[str, tuple[list[float], list[float]]]]:
    """Return run.json, and reference and output by name over the samples that were held."""
    run, columns = read_case(folder)
    headers = {output["name"]: f"{output['name']} [{output['unit'] or '1'}]" for output in run["outputs"]}
    held = -1 if run["outcome"] == "completed" else None
    return run, {
        name: (columns[f"reference {header}"][:held], columns[header][:held])
        for name, header in headers.items()
    }


def resting_folder(folder: Path) -> Path:
    """Return the folder of the run with inputs at rest of the same scenario and seed."""
    run, _ = read_case(folder)
    return _resting(folder.parent)[run["scenario"], run["seed"]]


@lru_cache(maxsize=4)
def _resting(cases: Path) -> dict[tuple[str, int], Path]:
    folders = {}
    for folder in cases.glob("*doing-nothing_*"):
        run = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        folders[run["scenario"], run["seed"]] = folder
    return folders


def worst(values: list[float]) -> float:
    return NAN if not values or any(map(math.isnan, values)) else max(values)


def middle(values: list[float]) -> float:
    return NAN if not values or any(map(math.isnan, values)) else median(values)
