"""The standings of one problem: who is ahead, whom its seeds tell apart, and whose runs failed."""

import math
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from statistics import fmean, median
from typing import NamedTuple

from ddpc_cosim.metrics import headline, metric_of, split_key
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.judgement import all_failed
from ddpc_cosim.study.statistics import Comparisons, Runs, Sample, compare_all, describe
from ddpc_cosim.trace import Outcome

_ERRORS = ("cost", "mean_abs_error", "rmse")
"""What is ranked by, and its companion: errors of a run that failed say nothing of those that did not."""


class Standing(NamedTuple):
    """Where a controller stands.

    Parameters
    ----------
    controller : str
        Its name in the study.
    rank : int
        One more than the number of controllers that are better.
    failed, runs : int
        Runs that failed, and all runs.
    """

    controller: str
    rank: int
    failed: int
    runs: int


@dataclass(frozen=True, eq=False)
class Standings:
    """The controllers of one problem, ranked by what its study ranks by.

    A controller with a failed run comes after all without, and after those with fewer. Of two without any,
    one is better if the seeds tell it to be so in some of the keys and the other in none; where the seeds
    are too few for any test, the medians decide, over the runs that both have.

    Parameters
    ----------
    keys : tuple of str
        The metrics that are ranked by: one, or one for each controlled output.
    runs : dict of str to dict of str to Runs
        By key and controller, the runs in the scenarios that count, NaN of those that failed.
    left_out : tuple of str
        Scenarios in which every run of every controller failed: they do not count.
    """

    keys: tuple[str, ...]
    runs: dict[str, dict[str, Runs]]
    left_out: tuple[str, ...]

    @cached_property
    def failed(self) -> dict[str, int]:
        """By controller, the runs that failed."""
        own = next(iter(self.runs.values()), {})
        return {name: sum(map(math.isnan, runs.values())) for name, runs in own.items()}

    @cached_property
    def compared(self) -> dict[str, Comparisons]:
        """By key, the controllers of which no run failed, compared each with each."""
        return {
            key: compare_all(
                {name: own for name, own in runs.items() if not self.failed[name]}, metric_of(key).better
            )
            for key, runs in self.runs.items()
        }

    @cached_property
    def samples(self) -> dict[str, dict[str, Sample]]:
        """By key and controller, what the runs come to."""
        return {key: {name: describe(own) for name, own in runs.items()} for key, runs in self.runs.items()}

    @cached_property
    def seeds(self) -> int:
        """How many seeds there are."""
        own = next(iter(self.runs.values()), {})
        return len({seed for runs in own.values() for _, seed in runs})

    @cached_property
    def tested(self) -> bool:
        """Whether the seeds can tell controllers apart; if not, the medians decide."""
        return self.seeds > 1 and not any(one.too_few_seeds for one in self.compared.values())

    @property
    def seeds_compared(self) -> int:
        """How many seeds two controllers share, of those that share most."""
        return max((one.seeds for one in self.compared.values()), default=0)

    @property
    def seeds_needed(self) -> int:
        """Seeds from which on a controller that is ahead on each is told apart."""
        return max((one.seeds_needed for one in self.compared.values()), default=0)

    @cached_property
    def order(self) -> tuple[Standing, ...]:
        """The controllers, the best first; those of one rank in the order of their medians."""
        sound = [name for name, failed in self.failed.items() if not failed]
        behind = dict.fromkeys(sound, 0)
        for a, b in combinations(sound, 2):
            if worse := self._worse(a, b):
                behind[worse] += 1
        fewest = min(behind.values(), default=0)  # above 0 where they beat each other in a circle
        behind |= {name: 0 for name in sound if behind[name] == fewest}
        failing = sorted(failed for failed in self.failed.values() if failed)
        ranks = {
            name: 1 + (len(sound) + failing.index(failed) if failed else behind[name])
            for name, failed in self.failed.items()
        }
        count = {name: len(own) for name, own in next(iter(self.runs.values()), {}).items()}
        found = [Standing(name, rank, self.failed[name], count[name]) for name, rank in ranks.items()]
        return tuple(sorted(found, key=lambda one: (one.rank, self._place(one.controller))))

    @cached_property
    def ranks(self) -> dict[str, int]:
        """By controller, its rank; empty where nothing is ranked: there is one only, or every run failed."""
        if len(self.order) < 2 or all(one.failed == one.runs for one in self.order):
            return {}
        return {one.controller: one.rank for one in self.order}

    @property
    def leaders(self) -> tuple[str, ...]:
        """The controllers of the first rank; none if runs of each of them failed."""
        return tuple(one.controller for one in self.order if one.rank == 1 and not one.failed)

    def _worse(self, a: str, b: str) -> str:
        """Return the worse of two controllers of which no run failed; nothing where neither is."""
        worse = {self._worse_in(key, a, b) for key in self.keys} - {""}
        return worse.pop() if len(worse) == 1 else ""

    def _worse_in(self, key: str, a: str, b: str) -> str:
        if self.tested:
            differences = self.compared[key].differences
            pair = (a, b) if (a, b) in differences else (b, a)
            found = differences.get(pair)
            return pair[not found.told_worse] if found and found.told_apart else ""
        runs = self.runs[key]
        medians = [self.samples[key][name].median for name in (a, b)]
        if runs[a].keys() != runs[b].keys():  # who ran in the easier scenarios alone is not better for it
            both = runs[a].keys() & runs[b].keys()
            medians = [describe({run: runs[name][run] for run in both}).median for name in (a, b)]
        values = [*map(metric_of(key).rank, medians)]
        if any(map(math.isnan, values)) or math.isclose(*values, rel_tol=1e-9):
            return ""
        return a if values[0] > values[1] else b

    def _place(self, name: str) -> float:
        """Return the mean place of a controller's medians among those of all, key by key."""
        places = []
        for key in self.keys:
            values = {one: metric_of(key).rank(own.median) for one, own in self.samples[key].items()}
            known = sorted(value for value in values.values() if not math.isnan(value))
            places.append(known.index(values[name]) if values[name] in known else math.inf)
        return fmean(places) if places else 0.0


def counted(cases: Iterable[CaseResult], key: str) -> list[CaseResult]:
    """Return those of a controller's cases whose values of a metric are summed up.

    Of figures of the step response, and of what is ranked by, they are the cases that did not fail;
    where all did, what is ranked by is that of the completed cases, as all else is.
    """
    own = [*cases]
    sound = [case for case in own if not case.failed]
    if metric_of(key).if_held or (sound and split_key(key)[0] in _ERRORS):
        return sound
    return [case for case in own if case.outcome is Outcome.COMPLETED]


def known_values(cases: Iterable[CaseResult], key: str) -> list[float]:
    """Return a metric of the cases that count and have it."""
    values = (case.metrics.get(key, math.nan) for case in counted(cases, key))
    return [value for value in values if not math.isnan(value)]


def summed(cases: Sequence[CaseResult], key: str) -> float:
    """Return a metric of one controller in one value over its cases, in the way that suits it.

    Medians and largest values are those of the cases that count, totals those of all. Of figures of the step
    response it is the median of all cases: what a case lacks is worse than any value, and where half of them
    lack it, it is NaN.
    """
    metric, known = metric_of(key), known_values(cases, key)
    if metric.if_held:
        lacking = len(cases) - len(known)
        worse = [math.inf] * lacking if metric.better else []
        return median([*known, *worse]) if len(known) > lacking else math.nan
    if metric.over_seeds == "total":
        values = (case.metrics.get(key, math.nan) for case in cases)
        return sum(value for value in values if not math.isnan(value))
    how = max if metric.over_seeds == "largest" else median
    return how(known) if known else math.nan


def standings(study: Study, cases: Iterable[CaseResult]) -> Standings:
    """Return the standings of a study's controllers over cases of one problem.

    Reference points and the variants of sweeps do not compete.
    """
    points = study.report.reference_points
    aside = {name for name, section in study.controllers.items() if section.variant_of}
    aside |= {points.zero, points.full} if points else set()
    by_scenario: dict[str, list[CaseResult]] = {}
    for case in cases:
        by_scenario.setdefault(case.scenario, []).append(case)
    left_out = tuple(name for name, own in by_scenario.items() if all_failed(own))
    counting = [case for name, own in by_scenario.items() if name not in left_out for case in own]
    keys = headline(dict.fromkeys(key for case in counting for key in case.metrics))
    runs: dict[str, dict[str, dict[tuple[Hashable, int], float]]] = {key: {} for key in keys}
    for case in counting:
        if case.controller not in aside:
            for key in keys:
                value = case.metrics.get(key, math.nan) if not case.failed else math.nan
                runs[key].setdefault(case.controller, {})[case.scenario, case.seed] = value
    return Standings(keys, {key: dict(own) for key, own in runs.items()}, left_out)
