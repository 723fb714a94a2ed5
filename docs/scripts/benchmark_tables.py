"""Write the tables of benchmark.md and of methods/gpc.md from the results of the benchmark.

What methods take of a target's memory is measured anew, with the settings of that run.

Run ``python docs/scripts/benchmark_tables.py RESULTS [TRIALS ...] [--many FOLDER ...]``: the folder that
``ddpc-cosim run benchmark`` wrote and, where problems were tuned with another seed of the sampler too,
``trials.csv`` of the tuning (if parts were tuned apart, several, joined by commas) and those of the others;
``--many``: folders of the same with many seeds, each of one scenario. A table stands between
``<!-- table: NAME -->`` and ``<!-- end -->``; what nothing is given for stays as it is.
"""

import csv
import math
import re
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from statistics import fmean, median
from typing import NamedTuple

import numpy as np
from scipy.stats import kendalltau

from ddpc_cosim import ConfigError, Footprint, StudyResults, load_results
from ddpc_cosim.cli.progress import shown
from ddpc_cosim.loop.safe_calls import controller_code
from ddpc_cosim.metrics import headline
from ddpc_cosim.study.case_runs import started
from ddpc_cosim.study.cases import Case, cases_of
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.resolve import ResolvedProblems
from ddpc_cosim.study.runner import built_plants
from ddpc_cosim.study.verdicts.reliability import FailureRate, failure_rate
from ddpc_cosim.study.verdicts.standings import Standings, standings
from ddpc_cosim.study.verdicts.statistics import median_interval
from ddpc_reports.across_problems import Overall, overall
from ddpc_reports.shares import interval_words, share_words

DOCS = Path(__file__).parents[1]
PAGES = (DOCS / "benchmark.md", DOCS / "methods" / "gpc.md")
_TABLE = re.compile(r"(<!-- table: (\S+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)
_OBJECTIVES, _MOST = ("mean_abs_error", "money"), 10.0  # the best may be within its band
_NO_CODE = "no C"
_FEW = 20  # seeds that the benchmark has
_PAIRS = ("told apart", "too little to matter", "not told apart")
ADAPTATION = ("gpc", "mfapc", "deepc", "spc", "mpc", "pid")
LEARNING = ("gpc", "mfapc", "deepc", "mpc")
"""Whom the tables of the page on GPC show: in the last problems, and in the first ten."""
EXACT = ("noise", "disturbance", "tight", "no-preview")
"""Scenarios in which the plant of the first ten problems is the one recorded, but for nominal."""
HARD = {
    "unstable": ("van-der-pol", "cart-pendulum"),
    "gain that varies": ("cstr", "ph-neutralisation"),
    "friction": ("servo",),
    "resonance": ("pendulum", "two-mass-drive"),
    "dead time": ("distillation-column", "late-reflux"),
    "right half-plane zero": ("non-minimum-phase-tanks",),
    "two or three inputs": (
        "distillation-column",
        "quadruple-tank",
        "boiler-turbine",
        "from-a-log",
        "two-zone-house",
    ),
    "weather nobody forecasts": ("building",),
    "weather that is forecast": ("weather-forecast", "two-zone-house"),
    "a limit that pays": ("limit-that-pays",),
}
"""What is hard about a problem; some are in two rows."""
Footprints = Mapping[str, Mapping[str, Footprint | None]]
"""What controllers take in C, by their name and that of a problem; None: there is no C code."""


def rows(*cells: Sequence[str]) -> str:
    """Return a table in Markdown; the first row is its head."""
    head, *body = ["| " + " | ".join(row) + " |" for row in cells]
    return "\n".join([head, "|---" * len(cells[0]) + "|", *body]) + "\n"


def regrets(results: StudyResults, keys: Iterable[str]) -> dict[str, str]:
    """Return by how much each method is worse than the best of the same problem, scenario, seed and output.

    Medians over the runs of a problem, of which a failed one is infinitely worse, then over the problems.
    """
    shares = results.shares()
    shares = shares[shares["metric"].str.startswith(_OBJECTIVES)]
    where = ["problem", "metric", "scenario", "seed"]
    # A reactor that ignites, as it does at rest, wastes nothing: there is no way to go.
    shares = shares[shares.groupby(where)["share"].transform("count") > 0]
    best = shares[~shares["failed"]].groupby(where)["value"].min().rename("best")
    runs = shares.join(best, on=where)
    runs["regret"] = (runs["value"] / runs["best"] - 1.0).where(~runs["failed"], math.inf)
    by_problem = runs.groupby(["controller", "problem"])["regret"].median()
    words = {}
    for key in keys:
        values = np.minimum(by_problem[key].to_numpy(dtype=np.float64), _MOST)
        low, high = median_interval(values)
        words[key] = f"{100 * median(values):.0f} % [{100 * low:.0f} … {_most(high)}]"
    return words


def _most(regret: float) -> str:
    return f"> {100 * _MOST:.0f}" if regret >= _MOST else f"{100 * regret:.0f}"


def footprints(study: ResolvedProblems, keys: Collection[str]) -> Footprints:
    """Return what controllers take in C where their case of the first scenario and seed starts them."""
    with shown("building plants") as progress:
        plants = built_plants(study.problems, progress)
    taken: dict[str, dict[str, Footprint | None]] = {key: {} for key in keys}
    for name, problem in study.problems.items():
        scenario = next(iter(problem.study.scenarios))
        for case in cases_of(problem, plants[name], problem.study.seeds[:1]):
            if case.scenario == scenario and case.controller in taken:
                taken[case.controller][name] = _footprint(case)
    return taken


def _footprint(case: Case) -> Footprint | None:
    controller, loop = started(case)
    try:
        return controller_code(controller, loop).footprint
    except ConfigError:
        return None


def _kilobytes(count: float) -> str:
    thousands = count / 1e3
    return f"{thousands:.1f}" if thousands < 10 else f"{thousands:.0f}"


def footprint_words(footprint: Footprint | None) -> str:
    """Return constants and state in kB."""
    return " + ".join(map(_kilobytes, footprint)) if footprint else _NO_CODE


def _memory_words(of_problems: Mapping[str, Footprint | None]) -> str:
    """Return how much memory a method takes in the median over the problems where it has C code."""
    sums = [sum(footprint) for footprint in of_problems.values() if footprint]
    if not sums:
        return _NO_CODE
    return f"{_kilobytes(median(sums))} kB [{_kilobytes(min(sums))} … {_kilobytes(max(sums))}]"


def memory(results: Overall, taken: Footprints) -> str:
    """Return constants and state of each method in C in each problem."""
    table = [["method", *next(iter(taken.values()))]]
    for key, controller in results.controllers.items():
        table.append([controller.label, *map(footprint_words, taken[key].values())])
    return rows(*table)


def methods(results: Overall, regret: Mapping[str, str], taken: Footprints) -> str:
    """Return ranks, shares, regret, failed runs and cost of each method, the best rank first."""
    far = results.distances
    assert far is not None
    table = [
        [
            "method",
            "average rank",
            "share of the way [95 % interval]",
            "regret [95 % interval]",
            "failed runs",
            "step",
            "memory in C [range]",
            "needs data",
        ]
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
                regret[key],
                f"{failed} of {runs}",
                f"{step:.0f} us",
                _memory_words(taken[key]),
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


def hard(results: Overall) -> str:
    """Return the median share of each method in the problems that are hard in the same way."""
    far = results.distances
    assert far is not None
    table = [["what is hard", *(controller.label for controller in results.controllers.values())]]
    for what, names in HARD.items():
        of_problems = {key: [far.problems[name][key].median for name in names] for key in results.controllers}
        table.append(
            [f"{what} ({len(names)})", *(f"{100 * median(of):.0f} %" for of in of_problems.values())]
        )
    return rows(*table)


def kinds(results: Overall) -> str:
    """Return which kinds tuning chose for each method, and in how many problems."""
    shown = [
        [controller.label, results.chosen[key]]
        for key, controller in results.controllers.items()
        if key in results.chosen
    ]
    return rows(["method", "chosen, and in how many of the problems"], *shown)


def scenarios(results: Overall) -> str:
    """Return the share of each method in each scenario, over the problems that have it."""
    far = results.distances
    assert far is not None
    table = [["method", *far.scenarios]]
    for key, controller in results.controllers.items():
        table.append([controller.label, *(share_words(of[key]) for of in far.scenarios.values())])
    return rows(*table)


def ends(results: Overall, studies: Mapping[str, Study]) -> str:
    """Return which settings were found at an end of where was looked."""
    table = [["method", "settings within 3 % of an end (problem)"]]
    for key, controller in results.controllers.items():
        tuned = {name: study.controllers[key].tuned for name, study in studies.items()}
        hit = [f"{', '.join(how.at_ends)} ({name})" for name, how in tuned.items() if how and how.at_ends]
        if hit:
            table.append([controller.label, "; ".join(hit)])
    return rows(*table)


def errors(
    results: StudyResults,
    labels: Mapping[str, str],
    only: Sequence[str],
    wanted: Sequence[str],
    leave_out: Collection[str] = (),
) -> str:
    """Return medians of the first figure that a problem is ranked by, for some methods, problems, scenarios.

    Failed runs are counted; where half of a method's runs failed it has no figure.
    """
    table = [["problem", "scenario", *(labels[key] for key in wanted)]]
    for part in results.problems():
        name, cases = part.study.name, part.cases
        if name not in only:
            continue
        figure = headline(
            dict.fromkeys(key for case in cases for key in case.metrics), part.study.metrics.ranking
        )[0]
        title = f"{name}: {figure.partition('.')[2] or figure}"
        for scenario in part.study.scenarios:
            if scenario in leave_out:
                continue
            cells = []
            for key in wanted:
                runs = [case for case in cases if (case.controller, case.scenario) == (key, scenario)]
                values = [case.metrics[figure] for case in runs if not case.failed]
                missed = len(runs) - len(values)
                some = f", {missed} of {len(runs)} failed" if missed else ""
                cells.append("failed" if 2 * missed >= len(runs) else f"{median(values):.3g}{some}")
            table.append([title, scenario, *cells])
            title = ""
    return rows(*table)


def chosen(paths: Iterable[Path]) -> dict[tuple[str, str], dict[str, str]]:
    """Return the trial that was chosen, by problem and controller."""
    settings = {}
    for path in paths:
        with path.open(encoding="utf-8", newline="") as file:
            for row in csv.DictReader(file):
                if row["chosen"] == "true":
                    settings[row["problem"], row["controller"]] = row
    return settings


def order(trials: dict[tuple[str, str], dict[str, str]], problem: str) -> dict[str, tuple[float, float]]:
    """Return the failed runs and the error of each controller's chosen trial in a problem, the best first."""
    failures_and_errors = {}
    for (where, controller), row in trials.items():
        if where == problem:
            error = next(value for key, value in row.items() if key.startswith(_OBJECTIVES))
            failed = row["runs failed"] if "runs failed" in row else row["runs lost"]
            failures_and_errors[controller] = (float(failed), float(error))
    return dict(sorted(failures_and_errors.items(), key=lambda item: item[1]))


def again(first: dict[tuple[str, str], dict[str, str]], others: Iterable[Iterable[Path]]) -> str:
    """Return how the order of the methods moves where a problem is tuned with another seed of the sampler."""
    table = [
        ["problem", "Kendall's tau-b", "error of the first, then of the second tuning: places that change"]
    ]
    for paths in others:
        second = chosen(paths)
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


class ManySeeds(NamedTuple):
    """What many seeds of a scenario show, and the first ones.

    Parameters
    ----------
    scenario : str
        Its name.
    seeds : int
        How many seeds there are.
    problems : int
        How many problems have it.
    unseen : dict of str to list of (FailureRate, str)
        By method: how often it fails, and in which problem, where no run of the first seeds failed.
    ranks : dict of str to list of (int, int)
        By method, for each problem: how many ranks the first seeds allow it, and all.
    pairs : (Counter of str, Counter of str)
        Of the first seeds, and of all: how many pairs of methods without failed runs are told apart, and not.
    """

    scenario: str
    seeds: int
    problems: int
    unseen: dict[str, list[tuple[FailureRate, str]]]
    ranks: dict[str, list[tuple[int, int]]]
    pairs: tuple[Counter[str], Counter[str]]


def many_seeds(results: StudyResults, methods: Collection[str]) -> ManySeeds:
    """Return what results of many seeds of one scenario show."""
    (scenario,) = {case.scenario for case in results.cases}
    unseen: dict[str, list[tuple[FailureRate, str]]] = {key: [] for key in methods}
    ranks: dict[str, list[tuple[int, int]]] = {key: [] for key in methods}
    pairs = Counter[str](), Counter[str]()
    parts = results.problems()
    for part in parts:
        first = sorted({case.seed for case in part.cases})[:_FEW]
        by_count = [case for case in part.cases if case.seed in first], part.cases
        where = [standings(part.study, cases) for cases in by_count]
        allowed = [{s.controller: 1 + s.worst - s.rank for s in of.order} for of in where]
        for counts, of in zip(pairs, where, strict=True):
            sound = [name for name, failed in of.failed.items() if not failed]
            counts.update(_told(of, a, b) for a, b in combinations(sound, 2))
        for key in methods:
            ranks[key].append((allowed[0][key], allowed[1][key]))
            seen, rate = (failure_rate(c for c in cases if c.controller == key) for cases in by_count)
            if rate.failed and not seen.failed:
                unseen[key].append((rate, part.study.name))
    return ManySeeds(scenario, len({case.seed for case in results.cases}), len(parts), unseen, ranks, pairs)


def _told(where: Standings, a: str, b: str) -> str:
    """Return whether it can be told who of two is ahead, in the words of the table."""
    if any(where.worse_in(key, a, b) for key in where.keys):
        return _PAIRS[0]
    differences = [where.compared[key].differences for key in where.keys]
    is_told = any((of.get((a, b)) or of[b, a]).told_apart for of in differences)
    return _PAIRS[1] if is_told else _PAIRS[2]


def many(scenarios: Sequence[ManySeeds], labels: Mapping[str, str]) -> str:
    """Return who fails so rarely that the first seeds do not show it, and what ranks they allow."""
    count = scenarios[0].seeds
    head = ["method", *(f"`{of.scenario}`" for of in scenarios), "most often"]
    table = [[*head, f"ranks that {_FEW} seeds allow", f"that {count} do"]]
    for key, label in labels.items():
        rare = [(rate, f"{name} under `{of.scenario}`") for of in scenarios for rate, name in of.unseen[key]]
        most = "none"
        if rare:
            rate, name = max(rare, key=lambda one: one[0].failed)
            interval = f"[{100 * rate.low:.2g} … {100 * rate.high:.2g} %]"
            most = f"{name} {rate.failed} of {rate.seeds} {interval}"
        allowed = zip(*(ranks for of in scenarios for ranks in of.ranks[key]), strict=True)
        numbers = (str(len(of.unseen[key])) for of in scenarios)
        table.append([label, *numbers, most, *(f"{fmean(ranks):.1f}" for ranks in allowed)])
    return rows(*table)


def pairs(scenarios: Sequence[ManySeeds]) -> str:
    """Return of how many pairs of methods the first seeds, and all, tell who is ahead."""
    table = [["scenario", "problems", "seeds", "pairs", *_PAIRS]]
    for of in scenarios:
        for seeds, counts in zip((_FEW, of.seeds), of.pairs, strict=True):
            numbers = of.problems, seeds, counts.total(), *(counts[words] for words in _PAIRS)
            table.append([f"`{of.scenario}`", *map(str, numbers)])
    return rows(*table)


def main() -> None:
    """Write the tables anew."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("results", type=Path)
    parser.add_argument("trials", nargs="*", default=[])
    parser.add_argument("--many", type=Path, nargs="*", default=[])
    given = parser.parse_args()
    results = load_results(given.results)
    across = overall(results.problems())
    assert across is not None
    studies = {part.study.name: part.study for part in results.problems()}
    labels = {key: controller.label for key, controller in across.controllers.items()}
    taken = footprints(read_study(str(given.results / "study.toml")), labels)
    tables = {
        "methods": methods(across, regrets(results, labels), taken),
        "memory": memory(across, taken),
        "problems": problems(across),
        "scenarios": scenarios(across),
        "hard": hard(across),
        "kinds": kinds(across),
        "ends": ends(across, studies),
        "adaptation": errors(results, labels, [*studies][10:], ADAPTATION),
        "learning": errors(results, labels, [*studies][:10], LEARNING, EXACT),
    }
    if given.trials:
        first, *others = ([Path(path) for path in paths.split(",")] for paths in given.trials)
        tables["again"] = again(chosen(first), others)
    if given.many:
        of_many = [many_seeds(load_results(folder), labels) for folder in given.many]
        tables |= {"many": many(of_many, labels), "pairs": pairs(of_many)}
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        text = _TABLE.sub(lambda match: match[1] + tables.get(match[2], match[3]) + match[4], text)
        page.write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
