"""What changed from one run of a study to another: figures, in pairs of the same seed, and the study."""

import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from ddpc_cosim.metrics import headline, metric_of, split_key
from ddpc_cosim.responses import StepTimes
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.verdicts.baselines import Verdict, percent_of
from ddpc_cosim.study.verdicts.standings import standings
from ddpc_cosim.study.verdicts.statistics import FEWEST, Difference, Runs, Sample, compare_pairs, describe

if TYPE_CHECKING:
    from ddpc_cosim.study.problems import WholeStudy
    from ddpc_cosim.study.results import StudyResults

CaseKey = tuple[str, str, str, int]
"""Problem, controller, scenario and seed; the problem of a flat study is empty, as its name may differ."""
_COUNTS = ("failures", "samples")
_OF_A_RUN = ("command", "date", "run again", "study file", "wall time", "time of all", "study sha", "workers")
"""How what the provenance says of each run anew begins."""


class Change(NamedTuple):
    """What changed of a controller in a metric, in one scenario.

    Parameters
    ----------
    problem, scenario, controller, label : str
        Of what; the label is that of the later run.
    key : str
        The metric.
    before, after : Sample
        The metric over the seeds that both have.
    difference : Difference
        After less before, in pairs of the same seed.
    percent : float
        Its median in % of the median before; NaN where that is next to nothing.
    verdict : Verdict
        What the seeds tell.
    tested : bool
        Whether they are enough for a test; else the median decides.
    failed : (int, int)
        Runs that failed, before and after.
    """

    problem: str
    scenario: str
    controller: str
    label: str
    key: str
    before: Sample
    after: Sample
    difference: Difference
    percent: float
    verdict: Verdict
    tested: bool
    failed: tuple[int, int]


@dataclass(frozen=True)
class Changes:
    """What changed from one run of a study to another.

    Parameters
    ----------
    changes : tuple of Change
        In the order of problems, metrics, scenarios and controllers.
    ranked_by : tuple of str
        The metrics that problems are ranked by.
    settings : dict of str to (str or None, str or None)
        What the studies say differently, by its path: before and after; None: it is not said.
    provenance : dict of str to (str or None, str or None)
        The same of what they ran with.
    only_before, only_after : tuple of str
        Ids of cases that only one of them has.
    """

    changes: tuple[Change, ...]
    ranked_by: tuple[str, ...]
    settings: dict[str, tuple[str | None, str | None]]
    provenance: dict[str, tuple[str | None, str | None]]
    only_before: tuple[str, ...]
    only_after: tuple[str, ...]

    @property
    def ranked(self) -> list[Change]:
        """The changes of what is ranked by."""
        return [change for change in self.changes if change.key in self.ranked_by]


def cases_by_key(results: "StudyResults") -> dict[CaseKey, CaseResult]:
    """Return the cases by what they are of, whatever settings or code they ran with."""
    problems = {name: "" if results.whole.is_flat else name for name in results.whole.problems}
    return {
        (problems[case.problem], case.controller, case.scenario, case.seed): case for case in results.cases
    }


def changes_between(before: "StudyResults", after: "StudyResults") -> Changes:
    """Return what changed from one run of a study to another."""
    first, second = cases_by_key(before), cases_by_key(after)
    shared = [key for key in second if key in first]
    ranked_by = dict[str, None]()
    changes = list[Change]()
    for problem in dict.fromkeys(key[0] for key in shared):
        pairs = [(first[key], second[key]) for key in shared if key[0] == problem]
        study = before.whole.problems[pairs[0][0].problem]
        ranking = standings(study, [case for case, _ in pairs])
        headline_keys = headline(_keys(pairs), study.metrics.ranking)
        ranked_by |= dict.fromkeys(headline_keys)
        for key in dict.fromkeys((*headline_keys, *_keys(pairs))):
            changes += _changes_of(problem, key, pairs, ranking.relevant_differences.get(key, 0.0))
    return Changes(
        tuple(changes),
        tuple(ranked_by),
        settings_between(before.whole, after.whole),
        _differing(_lasting(before.provenance), _lasting(after.provenance)),
        tuple(case.id for key, case in first.items() if key not in second),
        tuple(case.id for key, case in second.items() if key not in first),
    )


def settings_between(before: "WholeStudy", after: "WholeStudy") -> dict[str, tuple[str | None, str | None]]:
    """Return what two studies say differently, by its path; None: it is not said."""
    return _differing(_flat(before.tables()), _flat(after.tables()))


def _keys(pairs: Sequence[tuple[CaseResult, CaseResult]]) -> list[str]:
    """Return the metrics that both runs have; times of computation are never the same twice."""
    both = dict.fromkeys(key for case, _ in pairs for key in case.metrics)
    others = {key for _, case in pairs for key in case.metrics}
    return [
        key
        for key in both
        if key in others and (metric_of(key).of is not StepTimes or split_key(key)[0] in _COUNTS)
    ]


def _changes_of(
    problem: str, key: str, pairs: Sequence[tuple[CaseResult, CaseResult]], relevant: float
) -> Iterator[Change]:
    """Yield the changes of a metric: all controllers in all scenarios are one family of tests."""
    of_place: dict[tuple[str, str], list[tuple[CaseResult, CaseResult]]] = {}
    for pair in pairs:
        of_place.setdefault((pair[1].scenario, pair[1].controller), []).append(pair)
    table: dict[str, Runs] = {}
    for (scenario, controller), cases in of_place.items():
        for i, when in enumerate(("before", "after")):
            table[f"{when} {scenario} {controller}"] = _runs([pair[i] for pair in cases], key)
    names = {place: tuple(f"{when} {' '.join(place)}" for when in ("after", "before")) for place in of_place}
    better = metric_of(key).better
    differences = compare_pairs(table, [(a, b) for a, b in names.values()], better)
    for place, cases in of_place.items():
        now, then = names[place]
        difference = differences[now, then]
        both = [run for run in table[then] if all(math.isfinite(table[name][run]) for name in (now, then))]
        old, new = (describe({run: table[name][run] for run in both}) for name in (then, now))
        runs = table[then].keys()
        is_same = all(table[now][run] == table[then][run] for run in both) and not any(
            math.isnan(table[now][run]) != math.isnan(table[then][run]) for run in runs
        )
        failed = sum(case.failed for case, _ in cases), sum(case.failed for _, case in cases)
        verdict = Verdict.SAME if is_same else _verdict(difference, relevant, better)
        yield Change(
            *(problem, *place, cases[0][1].label, key, old, new, difference),
            percent_of(difference, old.median, relevant),
            verdict,
            difference.constant or difference.seeds >= FEWEST,
            failed,
        )


def _runs(cases: Sequence[CaseResult], key: str) -> dict[tuple[Hashable, int], float]:
    return {
        (case.scenario, case.seed): math.nan if case.failed else case.metrics.get(key, math.nan)
        for case in cases
    }


def _verdict(difference: Difference, relevant: float, better: str) -> Verdict:
    """Return what a difference tells, where the two are not the same."""
    if not difference.pairs:
        return Verdict.UNKNOWN
    if not (difference.constant or difference.tested):
        return Verdict.FAILED
    is_guess = not difference.constant and difference.seeds < FEWEST
    if not (difference.told_apart or is_guess):
        largest = max(abs(difference.low), abs(difference.high))
        return Verdict.SMALL if largest < relevant else Verdict.LEVEL
    if abs(difference.median) < relevant or difference.median == 0.0:
        return Verdict.SMALL
    if not better:
        return Verdict.OTHER
    return Verdict.BETTER if (difference.median < 0.0) == (better == "low") else Verdict.WORSE


def _flat(tables: Mapping[str, Any], before: str = "") -> dict[str, str]:
    """Return what tables say by its path, in words."""
    said = dict[str, str]()
    for key, value in tables.items():
        path = f"{before}{key}"
        if isinstance(value, Mapping):
            said |= _flat(value, f"{path}.")
        else:
            said[path] = value if isinstance(value, str) else repr(value)
    return said


def _lasting(provenance: Mapping[str, str]) -> dict[str, str]:
    return {
        key: fact for key, fact in provenance.items() if not key.rpartition(": ")[2].startswith(_OF_A_RUN)
    }


def _differing(
    before: Mapping[str, str], after: Mapping[str, str]
) -> dict[str, tuple[str | None, str | None]]:
    paths = dict.fromkeys((*before, *after))
    both = {path: (before.get(path), after.get(path)) for path in paths}
    return {path: (old, new) for path, (old, new) in both.items() if old != new}
