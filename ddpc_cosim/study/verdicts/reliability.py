"""How often controllers fail, how bad their worst runs are, and which plant parameters go with it.

Seeds are independent of each other, so that the number of those with a failed run is binomial; where they are
spread evenly over the plants, by a Latin hypercube or a Sobol sequence, that number varies less, as a rule.
What parameters go with is an association: of what else a seed draws nothing is known here.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from ddpc_cosim.loop.trace import Outcome
from ddpc_cosim.metrics import headline, metric_of
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.verdicts.judgement import set_aside
from ddpc_cosim.study.verdicts.statistics import LEVEL
from ddpc_cosim.variables import FloatArray

FEWEST_SEEDS = 20
"""From so many seeds on a frequency says something; of spread parameters it is asked anyway."""
QUANTILES = (0.5, 0.9, 0.99)
_FEWEST_RUNS = 10  # of which a rank correlation is taken
_FEWEST_FAILED = 5  # and as many that did not fail, of which means are compared
_MOST_POINTS = 120
WORST = 3


class FailureRate(NamedTuple):
    """On how many seeds a controller fails.

    Parameters
    ----------
    failed, seeds : int
        Seeds with a failed run, and all of them.
    low, high : float
        Exact 95 % interval of the probability (Clopper and Pearson, 1934).
    """

    failed: int
    seeds: int
    low: float
    high: float

    @property
    def share(self) -> float:
        """The share of the seeds with a failed run."""
        return self.failed / self.seeds


class Quantile(NamedTuple):
    """A value that a share of all runs is not worse than; a failed run is worse than any value.

    Parameters
    ----------
    share : float
        The share.
    value, low, high : float
        The value, and its exact 95 % interval by order statistics (Conover, 1999); infinite where that is a
        failed run, NaN where so few seeds have none.
    """

    share: float
    value: float
    low: float
    high: float


class Association(NamedTuple):
    """How a plant parameter goes with failures, or with the figures of runs that did not fail.

    Parameters
    ----------
    parameter : str
        Its name and unit.
    key : str
        The metric; empty: failures.
    size : float
        Of a metric the rank correlation (Spearman) with how bad it is. Of failures the mean of the failed
        runs less that of the others, in their pooled standard deviations (Cohen's d).
    low, high : float
        Its interval; those of one report hold all together with 95 % (Bonferroni).
    runs : int
        Of how many runs.
    """

    parameter: str
    key: str
    size: float
    low: float
    high: float
    runs: int

    @property
    def stands_out(self) -> bool:
        """Whether chance does not explain it."""
        return self.low > 0 or self.high < 0


@dataclass(frozen=True)
class Reliability:
    """How one controller does over the seeds of one scenario.

    Parameters
    ----------
    controller, scenario : str
        Their names in the study.
    rate : FailureRate
        How often it fails.
    values : dict of str to array
        What it is ranked by, of all runs, the worst last; infinite of those that failed or have no value.
    associations : tuple of Association
        Of each spread parameter, as far as there are enough runs.
    """

    controller: str
    scenario: str
    rate: FailureRate
    values: dict[str, FloatArray]
    associations: tuple[Association, ...]

    def quantiles(self, key: str) -> tuple[Quantile, ...]:
        """Return the quantiles of a metric that so many seeds can tell: those that have an interval."""
        every = (_quantile(self.values[key], share) for share in QUANTILES)
        return tuple(quantile for quantile in every if not math.isnan(quantile.high))

    def tail(self, key: str) -> list[tuple[float, float]]:
        """Return values of a metric and the share of all runs that are as bad or worse, for a curve.

        Of many runs the worst have a point each, and the others fewer.
        """
        values = self.values[key]
        count, known = len(values), int(np.isfinite(values).sum())
        places = np.arange(known)
        if known > _MOST_POINTS:
            # Evenly spaced in the logarithm of the share, as the curve is drawn.
            ranks = np.geomspace(count - known + 1, count, _MOST_POINTS)
            places = np.unique(count - np.round(ranks).astype(int))
        return [(float(values[place]), (count - int(place)) / count) for place in places]


def failure_rate(cases: Iterable[CaseResult]) -> FailureRate:
    """Return how often a seed has a failed run; of several scenarios: in any of them."""
    failed: dict[int, bool] = {}
    for case in cases:
        failed[case.seed] = failed.get(case.seed, False) or case.failed
    return rate_of(sum(failed.values()), len(failed))


def rate_of(failed: int, seeds: int) -> FailureRate:
    """Return a share with its exact interval: of ``failed`` of ``seeds``."""
    from scipy.special import betaincinv  # SciPy's part that is imported when it is needed

    low = float(betaincinv(failed, seeds - failed + 1, LEVEL / 2)) if failed else 0.0
    high = float(betaincinv(failed + 1, seeds - failed, 1 - LEVEL / 2)) if failed < seeds else 1.0
    return FailureRate(failed, seeds, low, high)


def is_asked(cases: Sequence[CaseResult]) -> bool:
    """Whether so many seeds were run, or such plants, that it is asked how often controllers fail."""
    return len({case.seed for case in cases}) >= FEWEST_SEEDS or any(case.drawn for case in cases)


def reliability(study: Study, cases: Sequence[CaseResult]) -> list[Reliability]:
    """Return how each controller that competes does in each scenario; nothing where it is not asked."""
    if not is_asked(cases):
        return []
    aside = set_aside(study)
    keys = headline(dict.fromkeys(key for case in cases for key in case.metrics), study.metrics.ranking)
    groups: dict[tuple[str, str], list[CaseResult]] = {}
    for case in cases:
        if case.controller not in aside:
            groups.setdefault((case.controller, case.scenario), []).append(case)
    samples = {who: [*_samples(runs, keys)] for who, runs in groups.items()}
    level = LEVEL / max(sum(map(len, samples.values())), 1)
    return [
        Reliability(
            *who,
            failure_rate(runs),
            {key: _sorted(runs, key) for key in keys},
            tuple(_associated(sample, level) for sample in samples[who]),
        )
        for who, runs in groups.items()
    ]


def extreme_runs(study: Study, cases: Sequence[CaseResult]) -> list[CaseResult]:
    """Return of each controller in each scenario the runs that are worst, in the middle and best.

    Runs that failed are the worst, those that ended early before the others; else it is by what controllers
    are ranked by, of several figures by the sum of the ranks among the runs: these have no unit.
    """
    groups: dict[tuple[str, str], list[CaseResult]] = {}
    for case in cases:
        groups.setdefault((case.controller, case.scenario), []).append(case)
    keys = headline(dict.fromkeys(key for case in cases for key in case.metrics), study.metrics.ranking)

    chosen = []
    for runs in groups.values():
        figures = np.array([[run.metrics.get(key, math.nan) for key in keys] for run in runs])
        ranks = figures.argsort(axis=0, kind="stable").argsort(axis=0).sum(axis=1)  # NaN is the worst
        order = sorted(
            range(len(runs)),
            key=lambda i: (runs[i].outcome is Outcome.COMPLETED, not runs[i].failed, -ranks[i]),
        )
        chosen += [runs[order[place]] for place in (*range(min(WORST, len(runs))), len(runs) // 2, -1)]
    return chosen


class _Sample(NamedTuple):
    """A parameter and what may go with it: of a metric a value each, of failures whether the run failed."""

    parameter: str
    key: str
    values: FloatArray
    figures: FloatArray


def _samples(runs: Sequence[CaseResult], keys: Sequence[str]) -> Iterator[_Sample]:
    """Yield what can be compared, as far as there are enough runs."""
    failed = np.array([case.failed for case in runs], dtype=np.float64)
    for parameter in dict.fromkeys(name for case in runs for name in case.drawn):
        values = np.array([case.drawn.get(parameter, math.nan) for case in runs])
        if min(failed.sum(), (1 - failed).sum()) >= _FEWEST_FAILED:
            yield _Sample(parameter, "", values, failed)
        for key in keys:
            figures = np.array([metric_of(key).rank(case.metrics.get(key, math.nan)) for case in runs])
            is_known = np.isfinite(figures) & (failed == 0)
            known = figures[is_known]
            if known.size >= _FEWEST_RUNS and np.ptp(known) > 0:
                yield _Sample(parameter, key, values[is_known], known)


def _associated(sample: _Sample, level: float) -> Association:
    wide = NormalDist().inv_cdf(1 - level / 2)
    interval = _difference_interval if not sample.key else _correlation_interval
    size, low, high = interval(sample.values, sample.figures, wide)
    return Association(sample.parameter, sample.key, size, low, high, sample.values.size)


def _correlation_interval(values: FloatArray, figures: FloatArray, wide: float) -> tuple[float, float, float]:
    """Return the rank correlation, and its interval by Fisher's z (Bonett and Wright, 2000)."""
    from scipy.stats import spearmanr

    size = float(spearmanr(values, figures).statistic)
    if abs(size) >= 1.0:
        return size, size, size
    z, error = math.atanh(size), math.sqrt((1 + size**2 / 2) / (values.size - 3))
    return size, math.tanh(z - wide * error), math.tanh(z + wide * error)


def _difference_interval(values: FloatArray, failed: FloatArray, wide: float) -> tuple[float, float, float]:
    """Return the standardised difference of the means, and its interval (Hedges and Olkin, 1985)."""
    bad, good = values[failed == 1], values[failed == 0]
    squares = (bad.size - 1) * bad.var(ddof=1) + (good.size - 1) * good.var(ddof=1)
    size = float((bad.mean() - good.mean()) / math.sqrt(squares / (values.size - 2)))
    error = math.sqrt(values.size / (bad.size * good.size) + size**2 / (2 * values.size))
    return size, size - wide * error, size + wide * error


def _sorted(runs: Sequence[CaseResult], key: str) -> FloatArray:
    """Return a metric of all runs, the worst last: those that failed are worse than any."""
    rank, known = metric_of(key).rank, [case.metrics.get(key, math.nan) for case in runs if not case.failed]
    values = sorted((value for value in known if math.isfinite(value)), key=rank)
    return np.array([*values, *[math.inf] * (len(runs) - len(values))])


def _quantile(values: FloatArray, share: float) -> Quantile:
    """Return a quantile of values, the worst last, between two of which it lies with 95 %."""
    from scipy.stats import binom

    count = len(values)
    lower = int(binom.ppf(LEVEL / 2, count, share))
    upper = int(binom.ppf(1 - LEVEL / 2, count, share)) + 1
    has_both = lower >= 1 and upper <= count
    low, high = (values[lower - 1], values[upper - 1]) if has_both else (math.nan, math.nan)
    return Quantile(share, float(values[math.ceil(share * count) - 1]), float(low), float(high))


def seeds_needed(share: float) -> int:
    """Return from how many seeds on a quantile above the median has an interval."""
    from scipy.stats import binom

    count = FEWEST_SEEDS
    while int(binom.ppf(1 - LEVEL / 2, count, share)) + 1 > count:
        count += 1
    return count
