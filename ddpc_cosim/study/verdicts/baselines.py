"""How controllers differ from one of them, such as the one in use today: paired, over the seeds."""

import math
from collections.abc import Hashable, Iterable
from dataclasses import replace
from enum import StrEnum
from typing import NamedTuple

from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.verdicts.standings import Standings
from ddpc_cosim.study.verdicts.statistics import Difference, describe

_MOST = 1000.0
"""From so many percent on a difference says more in its unit."""


class Verdict(StrEnum):
    """What is concluded of a difference."""

    BETTER = "better"
    WORSE = "worse"
    LEVEL = "not told apart"
    SMALL = "too small to matter"
    SAME = "the same"
    OTHER = "changed"
    FAILED = "not tested, as runs failed"
    UNKNOWN = "no runs to compare"


_SHORT = {Verdict.LEVEL: "n.\u00a0s.", Verdict.SMALL: "negligible", Verdict.FAILED: "untested"}


class Against(NamedTuple):
    """A controller against the baseline, in one metric.

    Parameters
    ----------
    difference : Difference
        The controller less the baseline, in pairs of the same scenario and seed.
    percent : float
        Its median in % of the baseline's median over these runs; NaN where that is next to nothing, as it is
        below what matters, or the percentage would say less than the difference in its unit.
    verdict : Verdict
        What the seeds tell; where runs of one of the two failed, nothing.
    tested : bool
        Whether the seeds are enough for a test; else the medians decide.
    """

    difference: Difference
    percent: float
    verdict: Verdict
    tested: bool

    @property
    def is_told(self) -> bool:
        """Whether the seeds tell that it is better or worse."""
        return self.tested and self.verdict in (Verdict.BETTER, Verdict.WORSE)

    @property
    def word(self) -> str:
        """What is told, in a word beside the difference."""
        if self.verdict in (Verdict.BETTER, Verdict.WORSE):
            return str(self.verdict) if self.tested else "untested"
        return _SHORT.get(self.verdict, str(self.verdict))


def with_baseline(ranking: Standings, cases: Iterable[CaseResult], baseline: str) -> Standings:
    """Return standings in which a controller is compared that does not compete, such as a reference point."""
    if not ranking.keys or baseline in ranking.runs[ranking.keys[0]]:
        return ranking
    baseline_cases = [
        case for case in cases if case.controller == baseline and case.scenario not in ranking.left_out
    ]
    runs = dict(ranking.runs)
    for key, of_key in runs.items():
        values: dict[tuple[Hashable, int], float] = {
            (case.scenario, case.seed): math.nan if case.failed else case.metrics.get(key, math.nan)
            for case in baseline_cases
        }
        runs[key] = {**of_key, **({baseline: values} if values else {})}
    return replace(ranking, runs=runs)


def against(ranking: Standings, key: str, baseline: str, controller: str) -> Against | None:
    """Return how a controller differs from the baseline in a metric; None where one of them has no runs."""
    runs = ranking.runs[key]
    if baseline not in runs or controller not in runs:
        return None
    difference = ranking.above(key, baseline, controller)
    if not difference.pairs:
        return Against(difference, math.nan, Verdict.UNKNOWN, tested=False)
    shared = {run: value for run, value in runs[baseline].items() if run in runs[controller]}
    percent = percent_of(difference, describe(shared).median, ranking.relevant_differences[key])
    verdict = _verdict(ranking, key, baseline, controller, difference)
    return Against(difference, percent, verdict, ranking.tested)


def percent_of(difference: Difference, base: float, relevant: float) -> float:
    """Return the median of a difference in % of what it is from; NaN where that says little.

    Parameters
    ----------
    difference : Difference
        The difference.
    base : float
        The median that it is from.
    relevant : float
        The smallest difference that matters: below it ``base`` is next to nothing.
    """
    if not base > max(relevant, 0.0):
        return math.nan
    percent = 100.0 * difference.median / base
    return percent if abs(percent) < _MOST else math.nan


def _verdict(ranking: Standings, key: str, baseline: str, controller: str, difference: Difference) -> Verdict:
    if ranking.failed[baseline] or ranking.failed[controller]:
        return Verdict.FAILED
    if worse := ranking.worse_in(key, baseline, controller):
        return Verdict.BETTER if worse == baseline else Verdict.WORSE
    # A difference is small where the seeds tell it, and not where they tell nothing.
    largest = max(abs(difference.low), abs(difference.high))
    is_small = difference.told_apart or largest < ranking.relevant_differences[key]
    return Verdict.SMALL if is_small else Verdict.LEVEL
