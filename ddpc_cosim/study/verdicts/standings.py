"""The standings of one problem: who is ahead, who differs significantly, and whose runs failed."""

import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from statistics import fmean, median
from typing import NamedTuple, cast

from ddpc_cosim.loop.trace import Outcome
from ddpc_cosim.metrics import discomfort, headline, metric_of, split_key
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.verdicts.judgement import all_failed, set_aside
from ddpc_cosim.study.verdicts.statistics import (
    Comparisons,
    Difference,
    Interaction,
    Runs,
    Sample,
    compare_all,
    describe,
    interactions,
)

_ERRORS = ("cost", "mean_abs_error", "rmse", "money", "band_violation")
"""What is ranked by, and its companion: those of a run that failed say nothing of those that did not."""
_BAND = 0.1
"""Of a band's width, over the whole run: what a percentage of discomfort is at least taken of."""
_HOUR = 3600.0  # s
_MONEY = "money"
_PERCENT = 1.0
_DIGITS = 3
"""Significant digits that tables print of a median: who is equal in them is equal in rank."""
_MOST_KEPT = 100


class Standing(NamedTuple):
    """Where a controller stands.

    Parameters
    ----------
    controller : str
        Its name in the study.
    rank : int
        One more than the number of controllers that are better: the best rank that the data allow. By money
        and discomfort both the number of its front.
    failed, runs : int
        Runs that failed, and all runs.
    worst : int
        The worst rank that they allow: the number of all less that of those that are worse.
    shown : bool
        Whether there is such a rank: not of a single controller, nor where scenarios disagree.
    """

    controller: str
    rank: int
    failed: int
    runs: int
    worst: int
    shown: bool

    @property
    def text(self) -> str:
        """The ranks that the data allow: ``2``, or two with a dash; empty where there is none."""
        if not self.shown:
            return ""
        return f"{self.rank}" if self.worst == self.rank else f"{self.rank}\N{EN DASH}{self.worst}"


@dataclass(frozen=True)
class Relevant:
    """The smallest difference of what is ranked by that matters: the larger of both, where both are given.

    Parameters
    ----------
    absolute : float or mapping of str to float, optional
        The difference, in the unit in which the figure is shown; by controlled output if there are several,
        and ``money``.
    percent : float, optional
        In percent of the best controller's figure or of the size of the task, the larger of these; default:
        1, and of what has an absolute one 0.
    """

    absolute: float | Mapping[str, float] | None = None
    percent: float | None = None

    def difference(self, key: str, best: float, task: float = math.nan) -> float:
        """Return the smallest relevant difference of a metric.

        Parameters
        ----------
        key : str
            The metric.
        best, task : float
            The best controller's figure, and the size of the task; NaN: not known.
        """
        given, (name, signal, _) = self.absolute, split_key(key)
        absolute = given.get(signal or name) if isinstance(given, Mapping) else given
        percent = (_PERCENT if absolute is None else 0.0) if self.percent is None else self.percent
        size = max((abs(value) for value in (best, task) if math.isfinite(value)), default=0.0)
        return max(absolute or 0.0, percent / 100 * size)


@dataclass(frozen=True, eq=False)
class Standings:
    """The controllers of one problem, ranked by what its study ranks by.

    A controller with a failed run comes after all without one, and after those with fewer. Of two without
    one, one is better if the seeds tell it to be so in some of the keys and the other in none; where
    the seeds are too few for any test, the medians decide, over the runs that both have. Of a difference that
    does not matter neither is better, nor of medians that are equal in the digits that are printed.

    Where scenarios disagree on who is ahead, there is no overall rank: see :attr:`disagreements`.

    By money and discomfort both, ranks are Pareto fronts: of the first are those that no other dominates,
    which is to be better in the sense above; of the second those that none but they dominate; and so on.

    Parameters
    ----------
    keys : tuple of str
        The metrics that are ranked by: one, or one for each controlled output; or money, and the discomfort
        of each output.
    runs : dict of str to dict of str to Runs
        By key and controller, the runs in the scenarios that count, NaN of those that failed; also of metrics
        that are shown beside what is ranked by.
    left_out : tuple of str
        Scenarios in which every controller fails: they do not count.
    relevant : Relevant
        The smallest difference that matters.
    tasks : mapping of str to mapping of str to float
        By scenario and key, the size of the task in the unit of the key, where it is known.
    """

    keys: tuple[str, ...]
    runs: dict[str, dict[str, Runs]]
    left_out: tuple[str, ...]
    relevant: Relevant = Relevant()
    tasks: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def is_pareto(self) -> bool:
        """Whether it is ranked by money and discomfort both."""
        return self.is_of_money and len(self.keys) > 1

    @property
    def is_of_money(self) -> bool:
        """Whether it is ranked by money, alone or not."""
        return bool(self.keys) and split_key(self.keys[0])[0] == _MONEY

    @property
    def discomforts(self) -> tuple[str, ...]:
        """The keys that stand beside money, whether it is ranked by them too or not."""
        return tuple(key for key in self.runs if split_key(key)[0] != _MONEY) if self.is_of_money else ()

    @cached_property
    def fronts(self) -> tuple[tuple[str, ...], ...]:
        """The controllers without a failed run in fronts: see :func:`pareto_fronts`."""
        return pareto_fronts(self._sound, lambda a, b: self._worse(a, b) == b)

    @cached_property
    def failed(self) -> dict[str, int]:
        """By controller, the runs that failed."""
        return {name: sum(map(math.isnan, runs.values())) for name, runs in self._by_controller.items()}

    @cached_property
    def compared(self) -> dict[str, Comparisons]:
        """By key, the controllers of which no run failed, compared each with each."""
        return {
            key: compare_all(
                {name: values for name, values in runs.items() if not self.failed[name]},
                metric_of(key).better,
            )
            for key, runs in self.runs.items()
        }

    @cached_property
    def samples(self) -> dict[str, dict[str, Sample]]:
        """By key and controller, what the runs come to."""
        return {
            key: {name: describe(values) for name, values in runs.items()} for key, runs in self.runs.items()
        }

    @cached_property
    def seeds(self) -> int:
        """How many seeds there are."""
        return len({seed for runs in self._by_controller.values() for _, seed in runs})

    @cached_property
    def tested(self) -> bool:
        """Whether the seeds can tell controllers apart; if not, the medians decide."""
        return self.seeds > 1 and not any(comparisons.too_few_seeds for comparisons in self.compared.values())

    @property
    def is_uneven(self) -> bool:
        """Whether not all controllers have the same runs."""
        return len({frozenset(runs) for runs in self._by_controller.values()}) > 1

    @cached_property
    def relevant_differences(self) -> dict[str, float]:
        """By key, the smallest difference that matters, in its unit."""
        best = {
            key: min((self.samples[key][name].median for name in self._sound), key=metric_of(key).rank)
            for key in (self.runs if self._sound else ())
        }
        return {
            key: self.relevant.difference(key, best.get(key, math.nan), self._task(key)) for key in self.runs
        }

    @cached_property
    def order(self) -> tuple[Standing, ...]:
        """The controllers, the best first; those of one rank in the order of their medians."""
        if self.is_pareto:
            return self._order_of_fronts
        sound, total = self._sound, len(self.failed)
        failing = sorted(failed for failed in self.failed.values() if failed)
        count = {name: len(values) for name, values in self._by_controller.items()}
        behind = self._behind
        shown = total > 1 and self.failed != count and not self.disagreements
        ahead = dict.fromkeys(sound, 0)
        for controller in sound:
            for other in sound:
                ahead[controller] += self._worse(controller, other) == other if controller != other else 0
        ranked = []
        for name, failed in self.failed.items():
            if failed:
                rank = 1 + len(sound) + failing.index(failed)
                worst = len(sound) + len(failing) - failing[::-1].index(failed)
            else:
                rank, worst = 1 + behind[name], total - len(failing) - ahead[name]
            ranked.append(Standing(name, rank, failed, count[name], worst, shown))
        return tuple(sorted(ranked, key=lambda standing: (standing.rank, self._place(standing.controller))))

    @property
    def _order_of_fronts(self) -> tuple[Standing, ...]:
        """Return the controllers front by front, the cheapest of each first, then those with failed runs."""
        front = {name: place for place, names in enumerate(self.fronts, start=1) for name in names}
        failing = sorted({failed for failed in self.failed.values() if failed})
        count = {name: len(values) for name, values in self._by_controller.items()}
        shown = len(self.failed) > 1 and self.failed != count and not self.disagreements
        ranked = []
        for name, failed in self.failed.items():
            rank = len(self.fronts) + 1 + failing.index(failed) if failed else front[name]
            ranked.append(Standing(name, rank, failed, count[name], rank, shown))
        return tuple(sorted(ranked, key=lambda standing: (standing.rank, self._place(standing.controller))))

    @property
    def is_ranked(self) -> bool:
        """Whether there are ranks: not of one controller, where all runs failed, or scenarios disagree."""
        return any(standing.shown for standing in self.order)

    @property
    def leaders(self) -> tuple[str, ...]:
        """The controllers of the first rank; none if runs of each of them failed, or scenarios disagree."""
        return () if self.disagreements else self._first

    @cached_property
    def by_scenario(self) -> dict[str, "Standings"]:
        """The standings of each scenario that counts; none where there is but one."""
        runs_of_each = self._by_controller.values()
        names = dict.fromkeys(cast("str", scenario) for runs in runs_of_each for scenario, _ in runs)
        return {name: self._within(name) for name in names} if len(names) > 1 else {}

    @property
    def leaders_by_scenario(self) -> dict[str, tuple[str, ...]]:
        """By scenario, its leaders."""
        return {name: ranking.leaders for name, ranking in self.by_scenario.items()}

    @cached_property
    def disagreements(self) -> tuple[Interaction, ...]:
        """Why there is no overall rank: differences of leaders that depend on the scenario; else none.

        They are of two controllers without a failed run, each of which leads over all scenarios or in one.
        Their difference changes between two scenarios by more than chance explains and by enough to matter,
        and one of them is significantly better in the one scenario, and not so in the other. A lead that is
        larger in one scenario than in another is still a lead.
        """
        if not self.tested or not self.by_scenario:
            return ()
        leading = {*self._first, *(name for names in self.leaders_by_scenario.values() for name in names)}
        leading &= {*self._sound}
        return tuple(
            interaction
            for key in self.keys
            if any(
                self._changes(key, pair, *of)
                for pair in combinations(leading, 2)
                for of in combinations(self.by_scenario, 2)
            )
            for interaction in interactions({name: self.runs[key][name] for name in self._sound})
            if interaction.is_significant
            and leading >= {*interaction.pair}
            and abs(interaction.median) >= self.relevant_differences[key]
            and self._changes(key, interaction.pair, *cast("tuple[str, str]", interaction.conditions))
        )

    def is_surely_small(self, a: str, b: str) -> bool:
        """Whether no difference of two controllers matters wherever in its 95 % interval it lies."""
        differences = {key: self.difference(key, a, b) for key in self.keys}
        return all(
            difference is not None
            and max(abs(difference.low), abs(difference.high)) < self.relevant_differences[key]
            for key, difference in differences.items()
        )

    def difference(self, key: str, a: str, b: str) -> Difference | None:
        """Return the difference of two controllers, whichever of them comes first; None if there is none."""
        return self.compared[key].between(a, b)

    def above(self, key: str, first: str, other: str) -> Difference:
        """Return by how much another is above the first, in pairs of the same scenario and seed."""
        return self.compared[key].above(first, other, self.runs[key], metric_of(key).better)

    def ratio(self, key: str, first: str, other: str) -> float:
        """Return one plus that difference over the first's median of these runs; NaN if it is not above 0."""
        runs = self.runs[key]
        shared = {run: value for run, value in runs[first].items() if run in runs[other]}
        median_of_first = describe(shared).median
        if not median_of_first > 0:
            return math.nan
        ratio = 1 + self.above(key, first, other).median / median_of_first
        return ratio if ratio >= 0 else math.nan

    @property
    def _by_controller(self) -> dict[str, Runs]:
        """Return the runs of each controller by the first key; of the others they are the same runs."""
        return next(iter(self.runs.values()), {})

    @cached_property
    def _sound(self) -> list[str]:
        """Return the controllers of which no run failed."""
        return [name for name, failed in self.failed.items() if not failed]

    @cached_property
    def _behind(self) -> dict[str, int]:
        """Return of each controller of which no run failed how many, or how many fronts, are better."""
        if self.is_pareto:
            return {name: place for place, names in enumerate(self.fronts) for name in names}
        behind = dict.fromkeys(self._sound, 0)
        for a, b in combinations(self._sound, 2):
            if worse := self._worse(a, b):
                behind[worse] += 1
        fewest = min(behind.values(), default=0)  # above 0 where they beat each other in a circle
        return behind | {name: 0 for name, count in behind.items() if count == fewest}

    @property
    def _first(self) -> tuple[str, ...]:
        """Return who is of the first rank, if scenarios do not disagree."""
        first = [name for name, count in self._behind.items() if not count]
        return tuple(sorted(first, key=self._place))

    def _within(self, scenario: str) -> "Standings":
        runs: dict[str, dict[str, Runs]] = {
            key: {
                name: selected
                for name, all_runs in of_key.items()
                if (selected := {run: value for run, value in all_runs.items() if run[0] == scenario})
            }
            for key, of_key in self.runs.items()
        }
        return replace(self, runs=runs, left_out=(), tasks={scenario: self.tasks.get(scenario, {})})

    def _task(self, key: str) -> float:
        """Return the size of the task of a key's output: of several scenarios the median."""
        sizes = [by_key[key] for by_key in self.tasks.values() if key in by_key]
        return median(sizes) if sizes else math.nan

    def _changes(self, key: str, pair: tuple[str, str], scenario: str, other: str) -> bool:
        """Return whether one of two is significantly better in one scenario, and not in another."""
        here = [self.by_scenario[name] for name in (scenario, other)]
        ran = all({*pair} <= ranking.failed.keys() for ranking in here)
        if not ran or self.is_pareto:  # who is cheaper by more in one of them is still not dominated
            return ran and len({ranking._worse(*pair) for ranking in here}) > 1
        return len({ranking.worse_in(key, *pair) for ranking in here}) > 1

    def _worse(self, a: str, b: str) -> str:
        """Return the worse of two controllers of which no run failed; nothing where neither is."""
        worse = {self.worse_in(key, a, b) for key in self.keys} - {""}
        return worse.pop() if len(worse) == 1 else ""

    def worse_in(self, key: str, a: str, b: str) -> str:
        """Return the worse of two controllers without failed runs in a metric; nothing where neither is."""
        if self.is_too_small(key, a, b):
            return ""
        if self.tested:
            differences = self.compared[key].differences
            pair = (a, b) if (a, b) in differences else (b, a)
            difference = differences.get(pair)
            return pair[not difference.told_worse] if difference and difference.told_apart else ""
        values = [*map(metric_of(key).rank, self._medians(key, a, b))]
        if any(map(math.isnan, values)) or math.isclose(*values, rel_tol=1e-9):
            return ""
        return a if values[0] > values[1] else b

    def is_too_small(self, key: str, a: str, b: str) -> bool:
        """Return whether a difference is below what matters, or below what is printed of the medians."""
        medians = self._medians(key, a, b)
        if any(map(math.isnan, medians)):  # without a run that both have, nothing is known of a difference
            return False
        if len({f"{value:.{_DIGITS}g}" for value in medians}) == 1:
            return True
        of_seeds = self.difference(key, a, b)
        difference = of_seeds.median if self.tested and of_seeds else medians[0] - medians[1]
        return abs(difference) < self.relevant_differences[key]

    def _medians(self, key: str, a: str, b: str) -> list[float]:
        """Return the medians of two controllers over the runs that both have.

        Who ran in the easier scenarios alone is not better for it.
        """
        runs = self.runs[key]
        if runs[a].keys() == runs[b].keys():
            return [self.samples[key][name].median for name in (a, b)]
        both = runs[a].keys() & runs[b].keys()
        return [describe({run: runs[name][run] for run in both}).median for name in (a, b)]

    def _place(self, name: str) -> float:
        """Return the mean place of a controller's medians among those of all; of fronts that of its money."""
        places = []
        for key in self.keys[:1] if self.is_pareto else self.keys:
            values = {
                other: metric_of(key).rank(sample.median) for other, sample in self.samples[key].items()
            }
            known = sorted(value for value in values.values() if not math.isnan(value))
            places.append(known.index(values[name]) if values[name] in known else math.inf)
        return fmean(places) if places else 0.0


_KEPT: dict[str, Standings] = {}
"""The standings of late, by what decides them."""


def pareto_fronts(names: Iterable[str], dominates: Callable[[str, str], bool]) -> tuple[tuple[str, ...], ...]:
    """Return who is dominated by none of the others, then who is by none but those, and so on.

    Parameters
    ----------
    names : iterable of str
        Who is compared.
    dominates : callable
        Whether the first of two dominates the other. Statistics can have some dominate each other in a
        circle: of them, who is dominated by the fewest comes first.
    """
    left, fronts = [*names], list[tuple[str, ...]]()
    while left:
        above = {name: sum(dominates(other, name) for other in left if other != name) for name in left}
        fewest = min(above.values())
        fronts.append(tuple(name for name in left if above[name] == fewest))
        left = [name for name in left if above[name] > fewest]
    return tuple(fronts)


def counted(cases: Iterable[CaseResult], key: str) -> list[CaseResult]:
    """Return those of a controller's cases whose values of a metric are summed up.

    Of figures of the step response, and of what is ranked by, they are the cases that did not fail;
    where all did, what is ranked by is that of the completed cases, as all else is.
    """
    everything = [*cases]
    sound = [case for case in everything if not case.failed]
    if metric_of(key).if_held or (sound and split_key(key)[0] in _ERRORS):
        return sound
    return [case for case in everything if case.outcome is Outcome.COMPLETED]


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
        values = [case.metrics.get(key, math.nan) for case in cases]
        counted = [value for value in values if not math.isnan(value)]
        return math.fsum(counted) if counted else math.nan
    how = max if metric.over_seeds == "largest" else median
    return how(known) if known else math.nan


def standings(study: Study, cases: Iterable[CaseResult]) -> Standings:
    """Return the standings of a study's controllers over cases of one problem.

    Reference points and the variants of sweeps do not compete.

    Parameters
    ----------
    study : Study
        The study, of one problem.
    cases : iterable of CaseResult
        Its cases, or some of them.
    """
    aside = set_aside(study)
    by_scenario: dict[str, list[CaseResult]] = {}
    for case in cases:
        by_scenario.setdefault(case.scenario, []).append(case)
    left_out = tuple(
        name
        for name, group in by_scenario.items()
        if all_failed(case for case in group if case.controller not in aside)
    )
    counting = [case for name, group in by_scenario.items() if name not in left_out for case in group]
    every = dict.fromkeys(key for case in counting for key in case.metrics)
    keys = headline(every, study.metrics.ranking)
    beside = discomfort(every) if any(split_key(key)[0] == _MONEY for key in keys) else ()
    runs: dict[str, dict[str, dict[tuple[Hashable, int], float]]] = {
        key: {} for key in dict.fromkeys((*keys, *beside))
    }
    for case in counting:
        if case.controller not in aside:
            run, metrics, failed = (case.scenario, case.seed), case.metrics, case.failed
            for key in runs:
                value = metrics.get(key, math.nan) if not failed else math.nan
                runs[key].setdefault(case.controller, {})[run] = value
    given = study.metrics.relevant
    relevant = Relevant(given.absolute, given.percent) if given else Relevant()
    tasks = {name: _tasks(runs, group) for name, group in by_scenario.items() if name not in left_out}
    by_key: dict[str, dict[str, Runs]] = {key: dict(by_controller) for key, by_controller in runs.items()}
    return _of_same_runs(Standings(keys, by_key, left_out, relevant, tasks))


def _of_same_runs(made: Standings) -> Standings:
    """Return earlier standings of the same runs, if there are any: the tests of all pairs take a second."""
    same = repr((made.keys, made.runs, made.left_out, made.relevant, made.tasks))
    kept = _KEPT.setdefault(same, made)
    while len(_KEPT) > _MOST_KEPT:
        del _KEPT[next(iter(_KEPT))]
    return kept


def _tasks(keys: Iterable[str], cases: Sequence[CaseResult]) -> dict[str, float]:
    """Return by key of an output's error the size of its task, the median over the runs; of a cost none.

    Of what is integrated outside a band it is a part of the band's width, over the whole run.
    """
    return {key: median(sizes) for key in keys if (sizes := [*_sizes(key, cases)])}


def _sizes(key: str, cases: Iterable[CaseResult]) -> Iterator[float]:
    name, signal, _ = split_key(key)
    for case in cases:
        if name == "band_violation":
            of_bands = (output for output in case.tracking if output.output == signal)
            for output in of_bands:
                yield _BAND * (output.width or 0.0) * output.factor * case.simulated_time / _HOUR
        elif signal in case.tasks:
            yield case.tasks[signal]
