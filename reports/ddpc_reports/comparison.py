"""The results of a study seen by controller: cases gathered, metrics summed up over seeds."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from statistics import median
from typing import Any, NamedTuple

from ddpc_cosim import CaseResult, Outcome, StudyResults, Trace
from ddpc_cosim.files.texts import clipped
from ddpc_cosim.metrics import Metric, all_metrics, headline, metric_name, metric_of, split_key
from ddpc_cosim.responses import StepTimes
from ddpc_cosim.study.file_format.sections import ReferencePoints
from ddpc_cosim.study.verdicts.findings import ScenarioFindings
from ddpc_cosim.study.verdicts.judgement import all_failed
from ddpc_cosim.study.verdicts.shares import describe_shares, end_of, marked, run_once, shares_of
from ddpc_cosim.study.verdicts.standings import Standings, counted, standings, summed
from ddpc_cosim.study.verdicts.statistics import Comparisons, Runs, Sample
from ddpc_reports.numbers import Scale, difference_symbol, time_scale, unit_symbol

_LONGEST = 100
"""Letters of a label: what sets a variant of a sweep apart takes some."""


class Spread(NamedTuple):
    """Median and range of a metric over the cases that have it; NaN if none has."""

    median: float
    low: float
    high: float
    known: int

    @property
    def varies(self) -> bool:
        """Whether the cases differ by more than rounding."""
        return self.known > 1 and not math.isclose(self.low, self.high, rel_tol=1e-9)


def spread(values: Iterable[float]) -> Spread:
    """Sum up a metric over cases; missing values are left out."""
    known = [value for value in values if not math.isnan(value)]
    if not known:
        return Spread(math.nan, math.nan, math.nan, 0)
    return Spread(median(known), min(known), max(known), len(known))


STEP_TIMES = tuple(f"solve_time_{name} [s]" for name in ("median", "p95", "p99", "max"))
"""The step times that the section on them shows."""


@dataclass(frozen=True, eq=False)
class ControllerResults:
    """One controller under one condition, with its cases in the order of the seeds."""

    key: str
    label: str
    index: int
    cases: tuple[CaseResult, ...]
    first_seed: int
    end: float | None = None
    """Of a reference point, where it is on the scale: 0 or 1."""

    @property
    def is_point(self) -> bool:
        """Whether it is a reference point, which does not compete."""
        return self.end is not None

    @cached_property
    def completed(self) -> tuple[CaseResult, ...]:
        """The cases that reached their last sample."""
        return tuple(case for case in self.cases if case.outcome is Outcome.COMPLETED)

    @cached_property
    def succeeded(self) -> tuple[CaseResult, ...]:
        """The cases that did not fail: only of these one can be the best."""
        return tuple(case for case in self.cases if not case.failed)

    @property
    def succeeded_first(self) -> bool:
        """Whether the case of the first seed is there and did not fail."""
        return self.first_case is not None and not self.first_case.failed

    @property
    def failed(self) -> int:
        """How many cases failed."""
        return len(self.cases) - len(self.succeeded)

    @property
    def completed_all(self) -> bool:
        """Whether every case reached its last sample."""
        return len(self.completed) == len(self.cases)

    @property
    def first_case(self) -> CaseResult | None:
        """The case of the first seed, if it is there."""
        return next((case for case in self.cases if case.seed == self.first_seed), None)

    def by_seed(self, key: str) -> dict[int, float]:
        """Return a metric by seed, of the cases that count and have it."""
        values = {case.seed: case.metrics.get(key, math.nan) for case in counted(self.cases, key)}
        return {seed: value for seed, value in values.items() if not math.isnan(value)}

    def at_first(self, key: str) -> float:
        """Return a metric of the first seed; NaN where that case does not count."""
        return self.by_seed(key).get(self.first_seed, math.nan)

    def over_seeds(self, key: str) -> Spread:
        """Sum up a metric over the cases that count."""
        return spread(self.by_seed(key).values())

    def summed(self, key: str) -> float:
        """Return a metric in one value over the seeds, in the way that suits it."""
        return summed(self.cases, key)

    def total(self, key: str) -> float:
        """Return the sum of a count over all cases."""
        return sum(value for case in self.cases if not math.isnan(value := case.metrics.get(key, math.nan)))

    def runs(self, key: str) -> Runs:
        """Return a metric of every run, NaN of those that failed."""
        return {
            (case.scenario, case.seed): case.metrics.get(key, math.nan) if not case.failed else math.nan
            for case in self.cases
        }


@dataclass(frozen=True, eq=False)
class Condition:
    """One scenario of a study: all controllers under the same conditions, and the variants of sweeps."""

    results: StudyResults
    scenario: str
    controllers: tuple[ControllerResults, ...]
    variants: tuple[ControllerResults, ...]
    findings: ScenarioFindings
    _shares: dict[str, dict[str, Sample]] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """The scenario's name for people."""
        section = self.results.study.scenarios.get(self.scenario)
        return clipped((section.label if section else "") or self.scenario, _LONGEST)

    @cached_property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of the cases here, in the study's order."""
        everyone = (*self.controllers, *self.variants)
        return tuple(dict.fromkeys(case.seed for controller in everyone for case in controller.cases))

    @property
    def points(self) -> ReferencePoints | None:
        """The reference points of the study, if it has any."""
        return self.results.study.report.reference_points

    @cached_property
    def contenders(self) -> tuple[ControllerResults, ...]:
        """The controllers that compete."""
        return tuple(controller for controller in self.controllers if not controller.is_point)

    def shares(self, key: str) -> dict[str, Sample]:
        """Return how far each controller comes between the reference points; empty without a way to go."""
        if key not in self._shares:
            runs: dict[str, Runs] = {}
            if self.points and metric_of(key).better:
                runs = shares_of(self.cases, self.points, [key], run_once(self.results.study))
            self._shares[key] = {name: describe_shares(shares) for name, shares in runs.items()}
        return self._shares[key]

    @cached_property
    def cases(self) -> tuple[CaseResult, ...]:
        """All cases of this condition."""
        return tuple(case for controller in self.controllers for case in controller.cases)

    @property
    def standings(self) -> Standings:
        """Where the controllers stand in this condition."""
        return self.findings.standings

    @cached_property
    def every_key(self) -> tuple[str, ...]:
        """The keys of all metrics of the cases."""
        everyone = (*self.controllers, *self.variants)
        cases = (case for controller in everyone for case in controller.cases)
        return tuple(dict.fromkeys(key for case in cases for key in case.metrics))

    @cached_property
    def first_traces(self) -> dict[str, Trace]:
        """Traces of the first seed, by controller; runs without a single sample are left out."""
        traces = {
            case.controller: case.trace()
            for case in self.cases
            if case.seed == self.seeds[0] and case.has_samples
        }
        return {key: trace for key, trace in traces.items() if len(trace)}

    @property
    def headline(self) -> tuple[str, ...]:
        """The keys that controllers are ranked by."""
        return headline(self.every_key, self.results.study.metrics.ranking)

    def name_of(self, key: str) -> str:
        """Return what a metric is called here: of an output with a band, errors are distances to it."""
        return metric_name(key, self.every_key)

    def keys(self, name: str) -> tuple[str, ...]:
        """Return the keys of a metric: one for each signal that has it."""
        return tuple(key for key in self.every_key if split_key(key)[0] == name)

    @cached_property
    def by_key(self) -> dict[str, ControllerResults]:
        """The controllers by their keys."""
        return {controller.key: controller for controller in self.controllers}

    @cached_property
    def all_failed(self) -> str:
        """Say that every run of those that compete failed; empty where one did not."""
        return all_failed(case for controller in self.contenders for case in controller.cases)

    def may_win(self, controller: ControllerResults) -> bool:
        """Whether a controller may be the best: it competes, and none of its runs failed."""
        return controller.key in self.findings.sound

    def ranking(self, key: str) -> list[tuple[float, ControllerResults]]:
        """Return the controllers that may be the best, with medians of a metric, best first."""
        return [(value, self.by_key[name]) for name, value in self.findings.medians(key).items()]

    def compared(self, key: str) -> Comparisons:
        """Return the controllers that may be the best, compared each with each over the seeds."""
        return self.findings.compared(key)

    def level_with_first(self, key: str) -> list[ControllerResults]:
        """Return those not significantly worse than the first of a ranking; none if the seeds are too few."""
        level = self.compared(key).level_with_first if len(self.seeds) > 1 else ()
        return [controller for _, controller in self.ranking(key) if controller.key in level]

    def ahead_in_pairs(self, key: str) -> list[ControllerResults]:
        """Return those that the pairs tell to be better than the first of a ranking, despite its median."""
        ahead = self.compared(key).ahead_of_first
        return [controller for controller in self.controllers if controller.key in ahead]

    def alike(
        self, key: str, members: Sequence[ControllerResults | None]
    ) -> Callable[[int], list[int]] | None:
        """Return what says which of some members the seeds do not tell apart from one; None for one seed."""
        if len(self.seeds) < 2:
            return None
        apart = self.compared(key).behind

        def of(place: int) -> list[int]:
            first = members[place]
            others = [(i, member) for i, member in enumerate(members) if member]
            return [i for i, member in others if first and (first.key, member.key) not in apart]

        return of

    @property
    def not_ranked(self) -> list[ControllerResults]:
        """The controllers that compete and have a failed case: they come after all others, in its order."""
        return [controller for controller in self.contenders if controller.failed]


def conditions(results: StudyResults) -> tuple[Condition, ...]:
    """Return one condition for each scenario that has cases, in the study's order.

    In all of them the controllers stand in the order of the ranking over all scenarios, reference points
    last.
    """
    scenarios = dict.fromkeys(case.scenario for case in results.cases)
    return tuple(_condition(results, scenario) for scenario in scenarios)


def ranked_keys(results: StudyResults) -> dict[str, int]:
    """Return the places of the controllers in the ranking over all scenarios of a problem, from 0."""
    return {s.controller: place for place, s in enumerate(standings(results.study, results.cases).order)}


def in_ranked_order(results: StudyResults, keys: Iterable[str]) -> list[str]:
    """Return controllers as they are ranked, the variants of sweeps behind theirs, reference points last."""
    bases, places = _bases(results), ranked_keys(results)
    return sorted(keys, key=lambda key: places.get(bases.get(key) or key, math.inf))


def _condition(results: StudyResults, scenario: str) -> Condition:
    everyone = _controllers_in(results, scenario)
    varied = {key for key, section in results.study.controllers.items() if section.variant_of}
    place = {key: i for i, key in enumerate(in_ranked_order(results, [c.key for c in everyone]))}
    unvaried = (controller for controller in everyone if controller.key not in varied)
    controllers = sorted(unvaried, key=lambda controller: place[controller.key])
    variants = tuple(controller for controller in everyone if controller.key in varied)
    cases = [case for controller in controllers for case in controller.cases]
    findings = ScenarioFindings(results.study, cases)
    return Condition(results, scenario, tuple(controllers), variants, findings)


def metric_keys(conditions: Iterable[Condition], name: str) -> tuple[str, ...]:
    """Return the keys of a metric in any of the conditions: one for each signal that has it."""
    return tuple(dict.fromkeys(key for condition in conditions for key in condition.keys(name)))


def labels(results: StudyResults) -> dict[str, str]:
    """Return a distinct label for every controller, in the study's order; of a reference point what it is."""
    given = {case.controller: clipped(case.label, _LONGEST) for case in results.cases}
    shared, points = list(given.values()), results.study.report.reference_points
    return {
        key: marked(f"{label} ({clipped(key)})" if shared.count(label) > 1 else label, key, points)
        for key, label in given.items()
    }


def on_one_page(studies: Sequence[StudyResults]) -> list[StudyResults]:
    """Return studies whose controllers of the same name look alike, as they do in all problems of a study."""
    shown = [problem for study in studies for problem in study.problems()]
    peers = dict.fromkeys(key for results in shown for key, base in _bases(results).items() if not base)
    return [replace(study, peers=tuple(peers)) for study in studies]


def indices(results: StudyResults) -> dict[str, int]:
    """Return a number for every controller, from which it gets its colour and its dashes.

    Variants of a sweep are not drawn in figures over time: they share the number of their controller, so that
    the colours are left to those who need them.
    """
    bases = _bases(results)
    peers = results.peers or tuple(key for key, base in bases.items() if not base)
    numbers = {key: number for number, key in enumerate(peers)}
    return {key: numbers.get(base or key, 0) for key, base in bases.items()}


def _bases(results: StudyResults) -> dict[str, str]:
    """Return for every controller of which one it is a variant; empty: of none."""
    sections = results.study.controllers
    return {key: sections[key].variant_of if key in sections else "" for key in labels(results)}


def _controllers_in(results: StudyResults, scenario: str) -> tuple[ControllerResults, ...]:
    cases = [case for case in results.cases if case.scenario == scenario]
    numbers, points = indices(results), results.study.report.reference_points
    return tuple(
        ControllerResults(key, label, numbers[key], own_cases, cases[0].seed, end_of(key, points))
        for key, label in labels(results).items()
        if (own_cases := tuple(case for case in cases if case.controller == key))
    )


def shown_metrics() -> dict[str, Metric[Any]]:
    """Return the metrics that tables show, by name."""
    return {name: metric for name, metric in all_metrics().items() if "report" in metric.shown}


def response_metrics() -> dict[str, Metric[Any]]:
    """Return the metrics of the response that tables show, by name; not those of the controller's steps."""
    return {name: metric for name, metric in shown_metrics().items() if metric.of is not StepTimes}


def outcome_words(case: CaseResult) -> str:
    """Say how a case ended; of one that completed, whether it failed."""
    failed = case.outcome is Outcome.COMPLETED and case.failed
    return f"{case.outcome}, failed" if failed else str(case.outcome)


def metric_unit(key: str) -> str:
    """Return the unit symbol of a metric; empty for counts and ratios."""
    unit = split_key(key)[2]
    return unit_symbol(unit) if metric_of(key).unit == "value" else difference_symbol(unit)


def shown_as(key: str, values: Iterable[float]) -> Scale:
    """Return the unit symbol and the factor with values of a metric are shown: step times scaled."""
    is_step_time = metric_unit(key) == "s" and not metric_signal(key)
    return time_scale(values) if is_step_time else Scale(metric_unit(key), 1.0)


def metric_signal(key: str) -> str:
    """Return the signal that a metric is about, in words; empty for metrics of the whole run."""
    return clipped(split_key(key)[1].replace("_", " "))


def metric_words(key: str, keys: Iterable[str] = ()) -> str:
    """Return the name of a metric, among the keys of its run, and of the signal that it is about."""
    return " of ".join(filter(None, (metric_name(key, keys), metric_signal(key))))


def ranked(
    key: str, controllers: Sequence[ControllerResults], values: Sequence[float]
) -> list[tuple[float, ControllerResults]]:
    """Return the controllers that have a value of a metric, the best first; equal ones as in the study."""
    metric = metric_of(key)
    pairs = zip(values, controllers, strict=True)
    known = [(value, controller) for value, controller in pairs if not math.isnan(value)]
    return sorted(known, key=lambda pair: metric.rank(pair[0]))
