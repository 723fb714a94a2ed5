"""Write the tables of benchmark.md from the results of the benchmark and the trials that led to its settings.

Run ``python docs/scripts/benchmark_tables.py RESULTS TRIALS [TRIALS ...]``: the folder that ``ddpc-cosim run
benchmark`` wrote, ``trials.csv`` of the tuning of all problems (if parts were tuned apart, several, joined by
commas), and those of the tunings with another seed of the sampler. A table stands between
``<!-- table: NAME -->`` and ``<!-- end -->``.
"""

import csv
import re
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from scipy.stats import kendalltau

from ddpc_cosim import load_results
from ddpc_reports.across_problems import Overall, overall
from ddpc_reports.shares import interval_words, share_words

PAGE = Path(__file__).parents[1] / "benchmark.md"
_TABLE = re.compile(r"(<!-- table: (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)
_OBJECTIVE = "mean_abs_error"


def rows(*cells: Sequence[str]) -> str:
    """Return a table in Markdown; the first row is its head."""
    head, *body = ["| " + " | ".join(row) + " |" for row in cells]
    return "\n".join([head, "|---" * len(cells[0]) + "|", *body]) + "\n"


def methods(results: Overall) -> str:
    """Return ranks, shares, failed runs and cost of each method, the best rank first."""
    far = results.distances
    assert far is not None
    table = [
        ["method", "average rank", "share of the way [95 % interval]", "failed runs", "step", "needs data"]
    ]
    for key, controller in results.controllers.items():
        failed, runs = results.findings.failed[key]
        step, samples = far.step[key] * 1e6, far.recorded[key]
        share = far.overall[key]
        table.append(
            [
                controller.label,
                f"{results.findings.ranks.ranks[key]:.1f}",
                f"{share_words(share)}{interval_words(share)}",
                f"{failed} of {runs}",
                f"{step:.0f} us",
                f"{samples:.0f} samples" if samples else "nothing",
            ]
        )
    return rows(*table)


def problems(results: Overall) -> str:
    """Return the share of each method in each problem."""
    far = results.distances
    assert far is not None
    table = [["method", *far.problems]]
    for key, controller in results.controllers.items():
        cells = [
            share_words(distances[key]) if key in distances else "" for distances in far.problems.values()
        ]
        table.append([controller.label, *cells])
    return rows(*table)


def kinds(results: Overall) -> str:
    """Return which kinds tuning chose for each method, and in how many problems."""
    shown = [
        [controller.label, results.chosen[key]]
        for key, controller in results.controllers.items()
        if key in results.chosen
    ]
    return rows(["method", "chosen, and in how many of the problems"], *shown)


def chosen(paths: Iterable[Path]) -> dict[tuple[str, str], dict[str, str]]:
    """Return the trial that was chosen, by problem and controller."""
    settings = {}
    for path in paths:
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                if row["chosen"] == "true":
                    settings[row["problem"], row["controller"]] = row
    return settings


def ends(trials: dict[tuple[str, str], dict[str, str]]) -> str:
    """Return which settings were found at an end of where was looked."""
    hit: dict[str, list[str]] = {}
    for (problem, controller), row in trials.items():
        if row["at ends"]:
            hit.setdefault(controller, []).append(f"{row['at ends']} ({problem})")
    table = [["method", "settings within 3 % of an end (problem)"]]
    return rows(*table, *([controller, "; ".join(settings)] for controller, settings in hit.items()))


def order(trials: dict[tuple[str, str], dict[str, str]], problem: str) -> dict[str, tuple[float, float]]:
    """Return the failed runs and the error of each controller's chosen trial in a problem, the best first."""
    failures_and_errors = {}
    for (where, controller), row in trials.items():
        if where == problem:
            error = next(value for key, value in row.items() if key.startswith(_OBJECTIVE))
            failed = row["runs failed"] if "runs failed" in row else row["runs lost"]
            failures_and_errors[controller] = (float(failed), float(error))
    return dict(sorted(failures_and_errors.items(), key=lambda item: item[1]))


def again(first: dict[tuple[str, str], dict[str, str]], others: Iterable[Path]) -> str:
    """Return how the order of the methods moves where a problem is tuned with another seed of the sampler."""
    table = [
        ["problem", "Kendall's tau-b", "error of the first, then of the second tuning: places that change"]
    ]
    for path in others:
        second = chosen([path])
        problem = next(iter(second))[0]
        earlier, later = order(first, problem), order(second, problem)
        # a reference point is tuned once
        earlier = {name: value for name, value in earlier.items() if name in later}
        ranks = [[[*sorted(of.values())].index(of[name]) for name in earlier] for of in (earlier, later)]
        moved = [
            f"{name} {earlier[name][1]:.3g}, {later[name][1]:.3g}"
            for name, a, b in zip(earlier, *ranks, strict=True)
            if a != b
        ]
        table.append([problem, f"{kendalltau(*ranks).statistic:.2f}", "; ".join(moved) or "none"])
    return rows(*table)


def main(results: Path, first: str, *others: str) -> None:
    """Write the tables anew."""
    across = overall(load_results(results).problems())
    assert across is not None
    trials = chosen(Path(path) for path in first.split(","))
    tables = {
        "methods": methods(across),
        "problems": problems(across),
        "kinds": kinds(across),
        "ends": ends(trials),
        "again": again(trials, map(Path, others)),
    }
    text = PAGE.read_text(encoding="utf-8")
    text = _TABLE.sub(lambda match: match[1] + tables[match[2]] + match[3], text)
    PAGE.write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
