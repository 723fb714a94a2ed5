"""Whether two runs of a case, or two folders of results, say the same within tolerances."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ddpc_cosim.controller import OK
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.loop.trace import Trace
from ddpc_cosim.metrics import metric_of, split_key
from ddpc_cosim.responses import StepTimes
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.results import StudyResults, load_results
from ddpc_cosim.study.verdicts.changes import cases_by_key
from ddpc_cosim.variables import FloatArray

_SOLVE_TIME = "solve_time [s]"
# Of a controller's steps; all else of them is time, which is never the same twice.
_COUNTS = ("failures", "samples")


def loaded(folder: Path) -> StudyResults:
    """Return the results of a folder, of which no case may be damaged.

    Raises
    ------
    ConfigError
        Some are, or there are no results.
    """
    results = load_results(folder)
    if results.damaged:
        raise ConfigError(list(results.damaged.values()))
    return results


def compared(
    results: tuple[StudyResults, StudyResults], absolute: float, relative: float
) -> tuple[int, list[str]]:
    """Return how many cases two folders of results have, and of each that differs in words how."""
    first, second = map(cases_by_key, results)
    lines = [
        f"{case.id}: {difference}"
        for key, case in first.items()
        if key in second and (difference := difference_of(case, second[key], absolute, relative))
    ]
    for run, cases, others in ((results[0], first, second), (results[1], second, first)):
        lines += [f"{case.id}: only in {run.folder}" for key, case in cases.items() if key not in others]
    return len(first.keys() | second.keys()), lines


def difference_of(case: CaseResult, other: CaseResult, absolute: float, relative: float) -> str:
    """Return in words the worst difference of two cases, but for computation times; empty: they agree."""
    if case.outcome is not other.outcome:
        return f"{case.outcome}, other {other.outcome}"
    # In C a step tells whether it is a fallback in words of its own, and no more of itself.
    is_one_engine = case.engine == other.engine
    if case.has_samples and other.has_samples:
        first, second = case.trace(), other.trace()
        if len(first) != len(second):
            return f"{len(first)} samples, other {len(second)}"
        unequal = [
            k
            for k, (ours, theirs) in enumerate(zip(first.status, second.status, strict=True))
            if (ours != theirs if is_one_engine else (ours == OK) != (theirs == OK))
        ]
        if unequal:
            k = unequal[0]
            return f'status at t = {first.time[k]:g} s is "{first.status[k]}", other "{second.status[k]}"'
        signals = [samples_of(trace, infos=is_one_engine) for trace in (first, second)]
        if difference := worst_difference(signals, absolute, relative, first.time):
            return difference
    # What is computed from signals that differ says no more.
    return worst_difference([_metrics(case), _metrics(other)], absolute, relative)


def worst_difference(
    tables: Sequence[Mapping[str, FloatArray]],
    absolute: float,
    relative: float,
    time: FloatArray | None = None,
) -> str:
    """Return in words the worst difference of two tables, over time if that is given; empty: they agree."""
    ours, theirs = tables
    if single := sorted(ours.keys() ^ theirs.keys()):
        return f"{', '.join(single)}: only in one of them"
    parts = {name: _excess(values, theirs[name], absolute, relative) for name, values in ours.items()}
    name = max(parts, key=lambda name: parts[name][0], default="")
    if not name or parts[name][0] <= 1.0:
        return ""
    k = parts[name][1]
    where = "" if time is None else f" at t = {time[k]:g} s"
    return f"{name}{where} is {ours[name][k]:.9g}, other {theirs[name][k]:.9g}"


def samples_of(trace: Trace, *, infos: bool) -> dict[str, FloatArray]:
    """Return the samples but for times of computation; what a controller tells of itself only if asked."""
    return {
        name: values
        for name, values in trace.columns().items()
        if name != _SOLVE_TIME and (infos or not name.startswith("info."))
    }


def _metrics(case: CaseResult) -> dict[str, FloatArray]:
    """Return the metrics that are not of the times of computation."""
    return {
        f"metric {key}": np.array([value])
        for key, value in case.metrics.items()
        if metric_of(key).of is not StepTimes or split_key(key)[0] in _COUNTS
    }


def _excess(values: FloatArray, other: FloatArray, absolute: float, relative: float) -> tuple[float, int]:
    """Return the largest difference relative to the allowed one, and where; values that both lack agree."""
    with np.errstate(invalid="ignore", divide="ignore"):
        sizes = np.maximum(np.abs(values), np.abs(other))
        allowed = np.maximum(absolute, relative * np.where(np.isfinite(sizes), sizes, 0.0))
        parts = np.where(values == other, 0.0, np.abs(values - other) / allowed)
    parts[np.isnan(values) & np.isnan(other)] = 0.0
    parts = np.nan_to_num(parts, nan=np.inf, posinf=np.inf)
    k = int(np.argmax(parts)) if parts.size else 0
    return (float(parts[k]), k) if parts.size else (0.0, 0)
