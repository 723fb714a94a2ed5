"""Figures of the response, computed from the files of a case alone: by definition, row by row."""

import csv
import json
import math
import re
import tomllib
from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
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
        if n == 0 and (not size or abs(size) < 0.01 * (max(r) - min(r))):
            size = NAN
        if n and first - begins[n - 1] < 3:
            size = NAN
        tail = range(last - round((last - first) / 5), last)
        settled = abs(math.fsum(r[k] - y[k] for k in tail) / len(tail))
        share = {k: (y[k] - before) / size for k in range(first, last)}
        there = [k for k in share if share[k] >= 0.9]
        outside = [k for k in range(first, last) if abs(share[k] - 1) > 0.05]
        arrived = outside[-1] + 1 if outside else first
        stretches.append(
            Step(
                first,
                end,
                size,
                settled,
                max(0.0, *(share[k] - 1 for k in range(first, last))) * 100,
                (there[0] - first) * h if there else NAN,
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
        steps = [] if band_of(folder, output) else steps_of(r, y, preview, run["sampling_time"])
        outputs[output["name"]] = (output, steps, errors)
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
            f"limits_kept.{name} [%]": kept_share(folder, output),
        }
        if edges := band_of(folder, output):
            hours = read_case(folder)[0]["sampling_time"] / 3600
            away = [distance(y, *ends) for y, ends in zip(response_of(folder, output), edges, strict=True)]
            assert away == list(map(abs, errors))
            table |= {
                f"band_violation.{name} [{unit}.h]": factor * hours * math.fsum(away),
                f"band_violation_time.{name} [h]": hours * sum(far > 0 for far in away),
                f"band_violation_max.{name} [{unit}]": factor * max(away),
            }
            continue
        table |= {
            f"settled_error.{name} [{unit}]": factor * worst([stretch.settled for stretch in stretches]),
            f"settled_share.{name} [%]": worst([100 * step.settled / abs(step.size) for step in steps]),
            f"overshoot.{name} [%]": worst([step.overshoot for step in steps]),
            f"rise_time.{name} [s]": middle([step.rise for step in steps]),
            f"settling_time.{name} [s]": worst([step.settling for step in steps]),
        }
    return table | paid_for(folder)


def response_of(folder: Path, output: dict[str, Any]) -> list[float]:
    """Return an output over the samples that were held, in its own unit."""
    _, columns = read_case(folder)
    return columns[f"{output['name']} [{output['unit'] or '1'}]"][:-1]


def kept_share(folder: Path, output: dict[str, Any]) -> float:
    """Return in which share of these samples an output is within its limits [%]; NaN without limits."""
    run, columns = read_case(folder)
    header, values = f"{output['name']} [{output['unit'] or '1'}]", response_of(folder, output)
    place = [variable["name"] for variable in run["outputs"]].index(output["name"])
    sides = [
        columns.get(f"{side} {header}", [float(run["bounds"][f"y_{side}"][place])] * len(values))
        for side in ("min", "max")
    ]
    if not any(math.isfinite(limit) for limits in sides for limit in limits):
        return NAN
    kept = [low <= y <= high for low, y, high in zip(sides[0], values, sides[1], strict=False)]
    return 100.0 * sum(kept) / len(kept)


def band_of(folder: Path, output: dict[str, Any]) -> list[tuple[float, float]]:
    """Return the edges of an output's band over the same samples; nothing without a band."""
    _, columns = read_case(folder)
    header = f"{output['name']} [{output['unit'] or '1'}]"
    if f"lower {header}" not in columns:
        return []
    return [*zip(*(columns[f"{edge} {header}"][:-1] for edge in ("lower", "upper")), strict=True)]


def distance(y: float, lower: float, upper: float) -> float:
    return lower - y if y < lower else y - upper if y > upper else 0.0


def paid_for(folder: Path) -> dict[str, float]:
    """Return what prices come to, of amounts in kWh alone, minute by minute for the peak."""
    run, columns = read_case(folder)
    charges, h = run.get("charges", []), run["sampling_time"]
    if not charges:
        return {}
    driven = {variable["name"] for variable in (*run["inputs"], *run["changed_inputs"])}
    money, emissions, power = 0.0, 0.0, [0.0] * (len(columns["time [s]"]) - 1)
    for charge in charges:
        column = {
            kind: next(
                values for key, values in columns.items() if key.startswith(f"{kind} {charge['name']} [")
            )
            for kind in ("price", "emission", "charged")
        }
        for k in range(len(power)):
            x, after = column["charged"][k : k + 2]
            amount = charge["rate"] * h * (x if charge["signal"] in driven else 0.5 * (x + after))
            money += column["price"][k] * amount
            emissions += column["emission"][k] * amount
            power[k] += amount * 3600 / h
    minutes = [power[int(60 * minute / h)] for minute in range(round(len(power) * h / 60))]
    quarters = [fmean(minutes[i : i + 15]) for i in range(0, len(minutes) - 14, 15)]
    table = {f"money [{charges[0]['unit']}]": money, "energy [kWh]": math.fsum(power) * h / 3600}
    return table | {"peak [kW]": max(quarters)} | ({"emissions [kg]": emissions} if emissions else {})


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
    tail: range


def verdict(folder: Path, preview: int) -> Verdict:
    """Return whether a run failed and whether it settles, from its samples and those of doing nothing."""
    run, driven = _judged_by(folder)
    if run["outcome"] != "completed":
        return Verdict(True, False)
    resting, rest = _judged_by(resting_folder(folder))
    rests = resting["outcome"] == "completed"
    study = tomllib.loads((folder.parents[1] / "study.toml").read_text(encoding="utf-8"))
    study = study.get("problems", {}).get(run["problem"], study)
    scenario = study["scenarios"][run["scenario"]]
    far, left, worse, alone = False, list[float](), list[float](), list[float]()
    for i, output in enumerate(run["outputs"]):
        r, y = driven[output["name"]]
        r_at_rest, nothing = rest[output["name"]]
        edges = band_of(folder, output)
        travel = span([*r, y[0]])
        if min(r) == max(r) and at_rest(travel, [*r, *y]):
            travel = 0.0
        goes = max(abs(error - nothing[0]) for error in nothing) if rests else 0.0
        goes = 0.0 if at_rest(goes, [*r, *nothing]) else goes
        moves = max(travel, goes if min(r) == max(r) else min(goes, 3 * travel))
        width = float(run["bounds"]["y_max"][i]) - float(run["bounds"]["y_min"][i])
        size = moves or (width if math.isfinite(width) else max(output["nominal"], *map(abs, r)))
        if edges:
            gone = max(abs(a - b) for a, b in zip(r_at_rest, nothing, strict=True)) if rests else 0.0
            travel, moves, size = _task_of_band(edges, y, 0.0 if at_rest(gone, nothing) else gone)
        acted_on = study.get("disturbances") or scenario.get("disturbances") or scenario.get("inputs")
        scattered = min(scatter(y), scatter(nothing)) if acted_on else 0.0
        s = math.hypot(scenario.get("noise", {}).get(output["name"], 0.0), scattered)
        half = 0.5 * scenario.get("quantum", {}).get(output["name"], 0.0)
        ends = ends_in_band(edges, y, preview) if edges else ends_of(r, y, preview, run["sampling_time"])
        for end in ends:
            far |= end.magnitude - mean_magnitude(s, end.rows) - half >= 0.5 * size
            moving = not edges and moves_within(folder, study.get("disturbances", {}), end.tail)
            if end.settling and not moving:
                offset = max(end.offset - 4 * s / math.sqrt(end.rows) - half, 0.0)
                left.append(100 * offset / (abs(end.step) if abs(end.step) > 0.01 * travel else size))
        if rests:
            more = mean_magnitude(s, sum(end.rows for end in ends)) + half
            worse.append((mean_error(r, y) - mean_error(r_at_rest, nothing) - more) / size)
            alone += worse[-1:] if moves else []
    is_idle = rests and resting["label"] == "doing-nothing"  # and not the plant's own control, a competitor
    failed = far or (is_idle and max([fmean(worse), *alone]) > 0.01)
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
    return Ends(fmean(map(abs, errors)), abs(fmean(errors)), len(tail), step, settling, tail)


Edges = list[tuple[float, float]]


def _task_of_band(edges: Edges, y: list[float], gone: float) -> tuple[float, float, float]:
    """Return how far a band makes an output travel, what moves while nothing is done, and the task's size."""
    travel = max(y[0], *(lower for lower, _ in edges)) - min(y[0], *(upper for _, upper in edges))
    travel = 0.0 if at_rest(travel, y) else travel
    width = fmean(upper - lower for lower, upper in edges)
    moves = max(travel, min(gone, 3 * max(travel, width)))
    return travel, moves, max(moves, width)


def ends_in_band(edges: Edges, y: list[float], preview: int) -> list[Ends]:
    """Return the ends of the stretches of constant edges; steps are widths, or how far the band jumps."""
    begins = [0, *(k for k in range(1, len(y)) if edges[k] != edges[k - 1]), len(y)]
    ends = []
    for first, end in pairwise(begins):
        last = end - preview
        if end - first < 3 or last - first < 5:
            continue
        (lower, upper), (low, high) = edges[first], edges[max(first - 1, 0)]
        ends.append(
            _end_in_band(edges, y, range(last - round((last - first) / 5), last), settling=True)._replace(
                step=max(upper - lower, lower - high, low - upper)
            )
        )
    tail = range(len(y) - max(round(len(y) / 5), 1), len(y))
    return ends or [_end_in_band(edges, y, tail, settling=False)]


def _end_in_band(edges: Edges, y: list[float], tail: range, *, settling: bool) -> Ends:
    mean = fmean(distance(y[k], *edges[k]) for k in tail)
    return Ends(mean, mean, len(tail), 0.0, settling, tail)


def moves_within(folder: Path, disturbances: Any, tail: range) -> bool:
    """Return whether a declared disturbance is another one at a sample than at the one before."""
    _, columns = read_case(folder)
    for name in disturbances:
        acted = (f"applied {name} [", f"disturbance {name} [")  # inputs, and what is measured alone
        values = next(columns[key] for begin in acted for key in columns if key.startswith(begin))[:-1]
        if any(k and abs(values[k] - values[k - 1]) > 1e-9 * span(values) for k in tail):
            return True
    return False


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
    return _resting(folder.parent)[run["problem"], run["scenario"], run["seed"]]


@lru_cache(maxsize=4)
def _resting(cases: Path) -> dict[tuple[str, str, int], Path]:
    folders = {}
    for folder in cases.glob("*doing-nothing_*"):
        run = json.loads((folder / "run.json").read_text(encoding="utf-8"))
        folders[run["problem"], run["scenario"], run["seed"]] = folder
    return folders


def worst(values: list[float]) -> float:
    return NAN if not values or any(map(math.isnan, values)) else max(values)


def middle(values: list[float]) -> float:
    return NAN if not values or any(map(math.isnan, values)) else median(values)


TEMPERATURES = ("AirZoneTemperature", "OperativeZoneTemperature")


def key_figures_of(folder: Path, area: float, sources: dict[str, list[str]]) -> dict[str, float]:
    """Return BOPTEST's key figures of a completed case, by the formulas of its paper (section "KPIs").

    Signals that are inputs are held, so that their integral is a sum; the others are lines. Where they were
    read between samples, limits and prices are held from sample to sample. Of a source that is absent there
    is no figure.
    """
    run, columns = read_case(folder)
    h, driven = run["sampling_time"], {variable["name"] for variable in run["inputs"]}
    time = np.array(columns["time [s]"])

    def column(*prefixes: str, name: str) -> Any:
        headers = [f"{prefix}{name} [" for prefix in prefixes]
        return next(
            (np.array(v) for start in headers for key, v in columns.items() if key.startswith(start)), None
        )

    def in_watts(name: str) -> float:
        return 1e3 if any(f"{name} [kW]" in key for key in columns) else 1.0

    after = sorted({float(found[1]) for key in columns if (found := re.match(r"after (\S+) s ", key))})
    step = h / (len(after) + 1)

    def course(name: str) -> Any:
        """Return a signal from each sample to the next, a row each."""
        values = column("monitored ", "", name=name)
        if name in driven:
            return np.repeat(values[:-1, np.newaxis], len(after) + 2, axis=1)
        between = [column(f"after {seconds:.12g} s ", name=name)[:-1] for seconds in after]
        return np.column_stack([values[:-1], *between, values[1:]])

    def integral(name: str, weight: Any) -> float:
        if after:
            each = np.trapezoid(course(name), dx=step, axis=1)
            return float((each * np.broadcast_to(weight, time.shape)[:-1]).sum())
        values = column("monitored ", "", name=name) * weight
        return float(values[:-1].sum() * h) if name in driven else float(np.trapezoid(values, time))

    def outside(name: str, *, below: bool) -> float:
        y = column("monitored ", "", name=name)
        lower, upper = (column(f"monitored {side} ", f"{side} ", name=name) for side in ("lower", "upper"))
        if after:
            y, lower, upper = course(name), lower[:-1, np.newaxis], upper[:-1, np.newaxis]
            away = np.clip(y - upper, 0, None) + (np.clip(lower - y, 0, None) if below else 0.0)
            return float(np.trapezoid(away, dx=step, axis=1).sum()) / 3600
        under = np.trapezoid(np.clip(lower - y, 0, None), time) if below else 0.0
        return float(under + np.trapezoid(np.clip(y - upper, 0, None), time)) / 3600

    def per_zone(start: tuple[str, ...], *, below: bool) -> float:
        zones = [names for source, names in sources.items() if source.startswith(start)]
        return fmean(math.fsum(outside(name, below=below) for name in names) for names in zones)

    def peak(source: str) -> float:
        power = 0.0
        for name in sources[source]:
            values = in_watts(name) * course(name)
            power = power + ((values[:, :-1] + values[:, 1:]) / 2).ravel()
        minutes = np.repeat(power, round(step / 60))
        return max(fmean(minutes[i : i + 15]) for i in range(0, len(minutes) - 14, 15)) / area / 1000

    used = {name: source for source, names in sources.items() if "[" not in source for name in names}
    powers = [name for name, source in used.items() if source.endswith("Power")]
    priced = {charge["signal"]: charge for charge in run["charges"]}

    def per_amount(kind: str, names: list[str]) -> float:
        return sum(
            integral(name, column(f"{kind} ", name=priced[name]["name"]) * priced[name]["rate"])
            for name in names
        )

    steps = [seconds for seconds in columns["solve_time [s]"] if math.isfinite(seconds)]
    moves = [abs(np.diff(column("", name=name)[:-1])).sum() for name in sorted(driven)]
    figures = {
        "ener_tot [kWh/m2]": sum(integral(name, in_watts(name)) for name in powers) / 3.6e6 / area,
        f"cost_tot [{run['charges'][0]['unit']}/m2]": per_amount("price", list(used)) / area,
        "emis_tot [kg/m2]": per_amount("emission", powers) / area,
        "time_rat [1]": fmean(steps) / h,
        "atvl_tot [1]": fmean(moves),
    }
    if any(source.startswith(TEMPERATURES) for source in sources):
        figures["tdis_tot [K.h]"] = per_zone(TEMPERATURES, below=True)
    if any(source.startswith("CO2Concentration") for source in sources):
        figures["idis_tot [ppm.h]"] = per_zone(("CO2Concentration",), below=False)
    peaks = {"pele_tot": "ElectricPower", "pgas_tot": "GasPower", "pdih_tot": "DistrictHeatingPower"}
    return figures | {f"{name} [kW/m2]": peak(source) for name, source in peaks.items() if source in sources}


def key_figures_in(metrics: dict[str, float]) -> dict[str, float]:
    return {key: value for key, value in metrics.items() if re.match(r"\w+_(tot|rat) ", key)}


def failure_interval(failed: int, runs: int) -> tuple[float, float]:
    """Return the exact 95 % interval of a probability, by halving where sums of binomial terms are 1/40."""

    def at_most(count: int, share: float) -> float:
        return math.fsum(math.comb(runs, k) * share**k * (1 - share) ** (runs - k) for k in range(count + 1))

    def where(falling: Callable[[float], float], goal: float) -> float:
        low, high = 0.0, 1.0
        for _ in range(100):
            middle = (low + high) / 2
            low, high = (middle, high) if falling(middle) > goal else (low, middle)
        return low

    lower = where(lambda share: at_most(failed - 1, share), 39 / 40) if failed else 0.0
    upper = where(lambda share: at_most(failed, share), 1 / 40) if failed < runs else 1.0
    return lower, upper


def quantile_places(runs: int, share: float) -> tuple[int, int] | None:
    """Return between which two runs in order, counted from 1, a quantile lies with 95 %; None: none does."""
    terms = [math.comb(runs, k) * share**k * (1 - share) ** (runs - k) for k in range(runs + 1)]
    sums = [math.fsum(terms[: k + 1]) for k in range(runs + 1)]
    low = next(k for k, total in enumerate(sums) if total >= 1 / 40)
    high = next(k for k, total in enumerate(sums) if total >= 39 / 40) + 1
    return (low, high) if low >= 1 and high <= runs else None


def rank_correlation(one: list[float], other: list[float]) -> float:
    """Return Spearman's correlation of values without ties, by the sum of squared rank differences."""
    ranks = [[sorted(values).index(value) for value in values] for values in (one, other)]
    count = len(one)
    return 1 - 6 * sum((a - b) ** 2 for a, b in zip(*ranks, strict=True)) / (count * (count**2 - 1))
