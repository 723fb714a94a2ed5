"""Limits promised and kept on ten problems of the benchmark: the share of samples within, and what it costs.

The outputs of each problem get limits at the extremes of their references, where those ask them to be; at the
end from which a run begins there is room for once the travel. There is measurement noise, and a recording of
300 samples. Methods are as the benchmark has tuned them, without a promise and with one.

    python -m benchmarks.promises deepc spc --seeds 6
"""

import argparse
import tempfile
import tomllib
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from statistics import fmean
from typing import Any

import tomli_w

from ddpc_cosim import Study, StudyResults
from ddpc_cosim.metrics import split_key

BENCHMARK = Path(__file__).parents[1] / "ddpc_cosim" / "studies" / "benchmark.toml"
PROBLEMS = 10
"""So many of the first; in the others limits, weather or a log stand in the way."""
PROMISED, ENOUGH = 0.95, 93.0
"""What is promised, and how many percent kept count as that."""


def with_limits(problem: Mapping[str, Any]) -> dict[str, Any]:
    """Return a problem of the benchmark, with noise alone, whose outputs have limits at their references."""
    bounds = dict(problem["bounds"])
    for output, reference in problem["reference"].items():
        low, high = min(reference["values"]), max(reference["values"])
        first, unit = (
            reference["values"][0],
            {name: reference[name] for name in ("unit",) if name in reference},
        )
        room = high - low
        limits = {"min": low - room * (first == low), "max": high + room * (first == high)}
        bounds[output] = limits | unit
    return {
        **{table: problem[table] for table in ("plant", "loop", "reference")},
        "recording": problem["recording"] | {"samples": 300},
        "bounds": bounds,
        "scenarios": {"noise": problem["scenarios"]["noise"]},
    }


def study_of(methods: Sequence[str], seeds: int) -> dict[str, Any]:
    """Return the study: every method as it is tuned, and with a promise."""
    benchmark = tomllib.loads(BENCHMARK.read_text(encoding="utf-8"))
    controllers: dict[str, Any] = {}
    for method in methods:
        tuned = benchmark["controllers"][method]
        for name, satisfaction in ((method, 0.0), (f"{method}-promised", PROMISED)):
            problems = {
                problem: {"settings": entry.get("settings", {}) | {"satisfaction": satisfaction}}
                for problem, entry in islice(tuned["problems"].items(), PROBLEMS)
            }
            settings = tuned.get("settings", {}) | {"satisfaction": satisfaction}
            controllers[name] = {"type": tuned["type"], "settings": settings, "problems": problems}
    return {
        "title": "Limits promised and kept",
        "seeds": [f"0:{seeds}"],
        "problems": {
            name: with_limits(problem) for name, problem in islice(benchmark["problems"].items(), PROBLEMS)
        },
        "controllers": controllers,
    }


def print_table(results: StudyResults, method: str) -> None:
    """Print what a method keeps without and with a promise, and its errors: means over the seeds."""
    figures: dict[tuple[str, str], dict[str, list[float]]] = {}
    for case in results.cases:
        if case.controller.removesuffix("-promised") != method:
            continue
        for key, value in case.metrics.items():
            metric, output, _ = split_key(key)
            if metric in ("limits_kept", "mean_abs_error"):
                of_output = figures.setdefault((case.problem, output), {})
                of_output.setdefault(f"{case.controller} {metric}", []).append(value)
    kept: dict[str, float] = {}
    print(f"{method:36}{'kept':>8}{'promised':>10}{'error':>12}{'promised':>10}")
    for (problem, output), values in figures.items():
        bare, promised = (fmean(values[f"{name} limits_kept"]) for name in (method, f"{method}-promised"))
        error, with_it = (fmean(values[f"{name} mean_abs_error"]) for name in (method, f"{method}-promised"))
        kept[problem] = min(kept.get(problem, 100.0), promised)
        print(f"{problem + ' ' + output:36}{bare:7.1f}%{promised:9.1f}%{error:12.4g}{with_it:10.4g}")
    reached = sum(share >= ENOUGH for share in kept.values())
    print(f"{100 * PROMISED:g} % promised: at least {ENOUGH:g} % kept on {reached} of {len(kept)} problems\n")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("methods", nargs="+")
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--jobs", type=int, default=2)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "promises.toml"
        file.write_text(tomli_w.dumps(study_of(chosen.methods, chosen.seeds)), encoding="utf-8")
        results = Study.read(str(file)).run(Path(folder) / "runs", jobs=chosen.jobs)
        for method in chosen.methods:
            print_table(results, method)


if __name__ == "__main__":
    main()
