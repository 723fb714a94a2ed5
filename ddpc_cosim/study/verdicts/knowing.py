"""What knowing a disturbance is worth: scenarios that differ in what is known alone, side by side."""

import math
from collections.abc import Mapping
from dataclasses import replace
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

from ddpc_cosim.metrics import metric_of
from ddpc_cosim.study.verdicts.standings import Standings
from ddpc_cosim.study.verdicts.statistics import Difference, Runs, compare_pairs

if TYPE_CHECKING:
    from ddpc_cosim.study.file_format.sections import Study

# From nothing to everything; a forecast with smaller errors is more.
_ORDER = {
    known: rank for rank, known in enumerate(("unknown", "measured", "high", "medium", "low", "perfect"))
}
_LEAST_GAIN = 0.99


class Worth(NamedTuple):
    """What knowing more is worth to one controller.

    Parameters
    ----------
    controller : str
        Its name in the study.
    left : dict of str to float
        By scenario, the median over the seeds of its figure in parts of that where the least is known, of
        several figures the geometric mean of these.
    """

    controller: str
    left: dict[str, float]

    @property
    def most(self) -> float:
        """What is left where it gains most."""
        return min(self.left.values())


class Knowing(NamedTuple):
    """What knowing the disturbances is worth in a study of one problem.

    Parameters
    ----------
    keys : tuple of str
        The metrics that it is told by.
    least : str
        The scenario in which the least is known.
    more : tuple of str
        The others, from little to much.
    gaining : tuple of Worth
        The controllers to which it is worth something, the one that gains most first.
    others : tuple of str
        Those to which it is not.
    """

    keys: tuple[str, ...]
    least: str
    more: tuple[str, ...]
    gaining: tuple[Worth, ...]
    others: tuple[str, ...]

    def typical(self, scenario: str) -> float:
        """Return what is left in a scenario, the median over the controllers that gain."""
        return median(worth.left[scenario] for worth in self.gaining)


def knowing(study: "Study", ranking: Standings) -> Knowing | None:
    """Return what knowing is worth; None where no scenarios differ in it alone, or it is worth nothing.

    Compared are runs of the same seed; a controller of which one failed is left out. All controllers in all
    scenarios are one family of tests in each figure.
    """
    scenarios = _scenarios(study)
    if len(scenarios) < 2 or not ranking.keys or ranking.is_of_money:
        return None
    least, *more = scenarios
    compared = [_compared(key, least, more, ranking) for key in ranking.keys]
    gaining, others = list[Worth](), list[str]()
    for controller in ranking.runs[ranking.keys[0]]:
        figures = {key: ranking.runs[key][controller] for key in ranking.keys}
        left = {scenario: _left(figures, least, scenario) for scenario in more}
        differences = [of_key[scenario, controller] for of_key in compared for scenario in more]
        if not all(map(_is_known, differences)) or any(map(math.isnan, left.values())):
            continue
        is_better = any(difference.told_apart and difference.won > 0.5 for difference in differences)
        if is_better and min(left.values()) < _LEAST_GAIN:
            gaining.append(Worth(controller, left))
        else:
            others.append(controller)
    if not gaining:
        return None
    gaining.sort(key=lambda worth: worth.most)
    return Knowing(ranking.keys, least, tuple(more), tuple(gaining), tuple(others))


def _scenarios(study: "Study") -> list[str]:
    """Return the largest group of scenarios that differ in what is known alone, from little to much."""
    known = {
        name: {d: section.known.get(d, of_study.known) for d, of_study in study.disturbances.items()}
        for name, section in study.scenarios.items()
    }
    groups: list[list[str]] = []
    for name, section in study.scenarios.items():
        for group in groups:
            other = study.scenarios[group[0]]
            if replace(section, label=other.label, known=other.known) == other:
                group.append(name)
                break
        else:
            groups.append([name])
    largest = max(groups, key=len, default=[])
    amount = {name: sum(_ORDER[level] for level in known[name].values()) for name in largest}
    distinct = {amount[name]: name for name in reversed(largest)}
    return [distinct[size] for size in sorted(distinct)]


def _compared(key: str, least: str, more: list[str], ranking: Standings) -> dict[tuple[str, str], Difference]:
    """Return what each controller's runs in a scenario differ by from those where the least is known."""
    runs = ranking.runs[key]
    table = {
        f"{scenario} {name}": _within(scenario, of_controller)
        for name, of_controller in runs.items()
        for scenario in (least, *more)
    }
    pairs = {
        (scenario, name): (f"{scenario} {name}", f"{least} {name}") for name in runs for scenario in more
    }
    differences = compare_pairs(table, pairs.values(), metric_of(key).better)
    return {which: differences[pair] for which, pair in pairs.items()}


def _is_known(difference: Difference) -> bool:
    """Whether all runs are in pairs, so that the seeds can tell, or nothing depends on them."""
    return difference.tested or difference.constant


def _within(scenario: str, runs: Runs) -> Runs:
    return {("", seed): value for (where, seed), value in runs.items() if where == scenario}


def _left(runs: Mapping[str, Runs], least: str, scenario: str) -> float:
    """Return what is left in a scenario: the geometric mean of the figures' median ratios over the seeds."""
    logarithms = []
    for of_key in runs.values():
        here, there = _within(scenario, of_key), _within(least, of_key)
        ratios = [here[seed] / there[seed] for seed in here.keys() & there.keys() if there[seed] > 0.0]
        if not ratios or median(ratios) <= 0.0:
            return math.nan
        logarithms.append(math.log(median(ratios)))
    return math.exp(sum(logarithms) / len(logarithms))
