"""Statistics within one problem: what its seeds show of each controller, and of two compared.

The seed is what is drawn at random, so each seed gives one value: where it has several runs (scenarios,
variants), their median. Scenarios do not multiply the seeds. A run that failed has no value: it is counted,
and never averaged away.
"""

import math
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import combinations
from statistics import median
from string import ascii_lowercase
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
import scipy  # whose parts are imported when they are first used

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.metrics import metric_of
from ddpc_cosim.variables import FloatArray
from fmu_plants.spelling import did_you_mean

if TYPE_CHECKING:
    import pandas as pd

LEVEL = 0.05
"""Level of tests, and 1 - level that of intervals: 95 %."""
FEWEST = 6
"""Of fewer values there is no interval: even the range of five covers the median with 93.75 % only."""

Runs = Mapping[tuple[Hashable, int], float]
"""A metric by condition (what may differ but the controller) and seed; NaN of a run that failed."""
Better = Literal["low", "high", ""]
"""Which values of a metric are better, as its registry says."""

_Places = np.ndarray[tuple[int], np.dtype[np.intp]]
_EXACT = 50  # pairs up to which all signs are counted; 2**50 is exact in floating point
_SAME = 1e-9  # relative difference from which on two values are two


class Sample(NamedTuple):
    """A metric of one controller.

    Parameters
    ----------
    runs, known : int
        How many runs there are, and how many of them have a value: they did not fail.
    seeds : int
        Seeds with a value: all that follows is over them.
    median, lower, upper : float
        Median and quartiles (linear interpolation); NaN without values.
    low, high : float
        95 % bootstrap interval of the median; NaN with fewer than six seeds.
    """

    runs: int
    known: int
    seeds: int
    median: float
    lower: float
    upper: float
    low: float
    high: float


class Difference(NamedTuple):
    """A controller less another, in pairs of runs of the same condition and seed.

    Parameters
    ----------
    pairs, seeds : int
        Pairs in which neither run failed, and the seeds that they are of.
    only_own, only_other : int
        Pairs of runs of which the other one alone failed: in no figure below.
    median, low, high : float
        Median of the differences over the seeds, and its 95 % bootstrap interval; NaN where there is none.
    won : float
        Share of the seeds with the better value, a tie counting half; NaN where no value is better.
    p : float
        Of the Wilcoxon signed-rank test, two-sided; NaN without pairs, and of a difference that is constant.
    constant : bool
        Whether the seed changes neither of the two: the difference is known, there is nothing to test.
    corrected : float
        ``p`` after Holm's correction for the other comparisons of its family.
    """

    pairs: int
    seeds: int
    only_own: int
    only_other: int
    median: float
    low: float
    high: float
    won: float
    p: float
    constant: bool
    corrected: float = math.nan

    @property
    def told_apart(self) -> bool:
        """Whether the two differ by more than chance explains."""
        return (self.constant and self.median != 0) or self.corrected <= LEVEL

    @property
    def told_worse(self) -> bool:
        """Whether the pairs tell that the other is better, whichever has the better median of its own."""
        return self.told_apart and self.won < 0.5


@dataclass(frozen=True, eq=False)
class Comparisons:
    """Controllers compared, each with each.

    Parameters
    ----------
    order : tuple of str
        The controllers that have values, the best median first.
    differences : dict of (str, str) to Difference
        The first less the second, where the first stands before the second in the order; corrected for all of
        them.
    """

    order: tuple[str, ...]
    differences: dict[tuple[str, str], Difference]

    @cached_property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """The largest groups that the data do not tell apart: two share one if and only if they are not."""
        return groups(self.order, {pair for pair, one in self.differences.items() if one.told_apart})

    @cached_property
    def letters(self) -> dict[str, str]:
        """The groups of each controller as letters: two that are not told apart share one."""
        return letters(self.groups)

    @property
    def tests(self) -> int:
        """How many comparisons were tested: Holm's correction is for so many."""
        return sum(not math.isnan(one.p) for one in self.differences.values())

    @property
    def seeds_needed(self) -> int:
        """Seeds from which on a controller that is ahead on each is told apart, whatever the others do."""
        return 1 + math.ceil(math.log2(max(self.tests, 1) / LEVEL))

    @property
    def seeds(self) -> int:
        """The most seeds that any two share."""
        return max((one.seeds for one in self.differences.values()), default=0)

    @property
    def too_few_seeds(self) -> bool:
        """Whether no test can tell any two apart, even if one of them is ahead on every seed."""
        return self.tests > 0 and self.seeds < self.seeds_needed


def describe(runs: Runs) -> Sample:
    """Sum up the runs of one controller."""
    values = np.array([*_by_seed(runs).values()])
    lower, middle, upper = np.percentile(values, [25, 50, 75]).tolist() if values.size else [math.nan] * 3
    known = sum(map(math.isfinite, runs.values()))
    return Sample(len(runs), known, values.size, middle, lower, upper, *median_interval(values))


def compare(own: Runs, other: Runs, better: Better = "low") -> Difference:
    """Compare two controllers, run by run of the same condition and seed."""
    both = {key: (value, other[key]) for key, value in own.items() if key in other}
    have = [(math.isfinite(a), math.isfinite(b)) for a, b in both.values()]
    pairs = {key: ab for key, ab in both.items() if all(map(math.isfinite, ab))}
    differences = np.array([*_by_seed({key: _difference(*ab) for key, ab in pairs.items()}).values()])
    constant = all(_constant({key: ab[i] for key, ab in pairs.items()}) for i in (0, 1))
    ahead = (np.sign(differences) * (1 if better == "high" else -1) + 1) / 2
    return Difference(
        len(pairs),
        len(differences),
        have.count((True, False)),
        have.count((False, True)),
        float(np.median(differences)) if differences.size else math.nan,
        *median_interval(differences),
        float(ahead.mean()) if better and differences.size else math.nan,
        math.nan if constant else signed_rank(differences),
        constant,
    )


def compare_all(runs: Mapping[str, Runs], better: Better = "low") -> Comparisons:
    """Compare controllers, each with each, Holm's correction being for all pairs of them."""
    medians = {name: describe(own).median for name, own in runs.items()}
    sign = -1 if better == "high" else 1
    order = sorted((name for name in runs if medians[name] == medians[name]), key=lambda n: sign * medians[n])
    table = {(a, b): compare(runs[a], runs[b], better) for a, b in combinations(order, 2)}
    return Comparisons(tuple(order), dict(zip(table, corrected(table.values()), strict=True)))


def corrected(family: Iterable[Difference]) -> list[Difference]:
    """Correct the p of a family of comparisons as Holm does."""
    members = [*family]
    return [
        one._replace(corrected=p) for one, p in zip(members, holm([one.p for one in members]), strict=True)
    ]


def holm(p: Sequence[float]) -> list[float]:
    """Return p-values corrected for their number as Holm (1979) does; a NaN is not a test, and stays."""
    order = sorted((i for i, value in enumerate(p) if not math.isnan(value)), key=lambda i: p[i])
    out, largest = [math.nan] * len(p), 0.0
    for rank, i in enumerate(order):
        out[i] = largest = max(largest, min(1.0, (len(order) - rank) * p[i]))
    return out


def signed_rank(differences: FloatArray) -> float:
    """Return the two-sided p of Wilcoxon's signed-rank test; NaN without differences.

    Zeros take part in the ranks and in nothing else (Pratt 1959), ties share their rank. Up to 50 differences
    all assignments of signs are counted, with ties and zeros too; of more, the normal approximation is taken.
    """
    if not differences.any():
        return 1.0 if differences.size else math.nan
    # Nine digits: 0.3 and 0.1 + 0.2 are a tie.
    differences = np.array([float(f"{one:.9g}") for one in differences.tolist()])
    if differences.size > _EXACT:
        return float(scipy.stats.wilcoxon(differences.tolist(), zero_method="pratt").pvalue)
    _, place, counts = np.unique(abs(differences), return_inverse=True, return_counts=True)
    twice = (2 * np.cumsum(counts) - counts + 1)[place]  # twice the shared ranks: whole numbers
    ways = _ways(tuple(sorted(twice[differences != 0].tolist())))
    positive = int(twice[differences > 0].sum())
    return min(1.0, 2 * float(min(ways[: positive + 1].sum(), ways[positive:].sum()) / ways.sum()))


@lru_cache
def _ways(ranks: tuple[int, ...]) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return in how many ways signs give each sum of positive ranks, from 0 on."""
    ways = np.ones(1, dtype=np.int64)
    for rank in ranks:
        ways = np.pad(ways, (0, rank)) + np.pad(ways, (rank, 0))
    return ways


def median_interval(values: FloatArray) -> tuple[float, float]:
    """Return the 95 % percentile interval of the bootstrapped median; NaN of fewer than six values.

    The distribution of the median of resamples is computed and not sampled (Efron 1979, section 3; for an
    even number from the two middle values), so that it is the same everywhere.
    """
    if values.size < FEWEST:
        return math.nan, math.nan
    values = np.sort(values)
    weights, lower, upper = _resampled_medians(values.size)
    medians = (values[lower] + values[upper]) / 2
    order = np.argsort(medians, kind="stable")
    reached, tail = np.cumsum(weights[order]), LEVEL / 2
    # The two ends mirror each other, whatever rounding does to a probability that meets the level.
    low = np.searchsorted(reached, tail - 1e-9)
    high = np.searchsorted(reached, 1 - tail + 1e-9, side="right")
    return float(medians[order[low]]), float(medians[order[high]])


@lru_cache(maxsize=8)
def _resampled_medians(n: int) -> tuple[FloatArray, _Places, _Places]:
    """Return the probability of each pair of places between whose values a resample's median can lie."""
    half, place = (n - 1) // 2, np.arange(1, n + 1)
    # Probability that the middle value of a resample, of an even number the lower one, is the i-th of all.
    weights = np.diff(1 - scipy.special.bdtr(half, n, np.arange(n + 1) / n))
    if n % 2:
        return weights, place - 1, place - 1
    likely = np.flatnonzero(np.maximum(weights, weights[::-1]) > 1e-12)
    half = n // 2
    # Half of the draws are at most the i-th, one of them is it; the others, mirrored, at least the j-th.
    below = half * np.log(place / n) + np.log1p(-(((place - 1) / place) ** half))
    table = np.add.outer(below, below[::-1])[np.ix_(likely, likely)]
    table = np.triu(np.exp(table + scipy.special.gammaln(n + 1) - 2 * scipy.special.gammaln(half + 1)), 1)
    np.fill_diagonal(table, weights[likely] - table.sum(axis=1))
    lower, upper = np.meshgrid(likely, likely, indexing="ij")
    return table.ravel(), lower.ravel(), upper.ravel()


def groups(order: Sequence[str], told_apart: Collection[tuple[str, str]]) -> tuple[tuple[str, ...], ...]:
    """Return the largest groups without a pair that is told apart, the first of the order first.

    They are the letters of a compact letter display (Piepho 2004): two controllers share a group if and only
    if they are not told apart. One that differs from all others is a group of its own.
    """
    found = [frozenset(order)] if order else []
    for a, b in told_apart:
        parts = {part for one in found for part in ([one - {a}, one - {b}] if {a, b} <= one else [one])}
        found = [part for part in parts if not any(part < other for other in parts)]
    places = sorted(sorted(map(order.index, group)) for group in found)
    return tuple(tuple(order[i] for i in group) for group in places)


def letters(groups: Sequence[Sequence[str]]) -> dict[str, str]:
    """Return the groups that each member is in as letters, from a on, separated by spaces."""
    names = [*ascii_lowercase, *(str(number) for number in range(27, len(groups) + 1))]
    table: dict[str, list[str]] = {}
    for name, group in zip(names, groups, strict=False):
        for one in group:
            table.setdefault(one, []).append(name)
    return {one: " ".join(own) for one, own in table.items()}


def compare_frame(frame: "pd.DataFrame", metric: str, baseline: str) -> "pd.DataFrame":
    """Return a row for each controller and problem: the metric, and how it differs from a baseline's.

    Parameters
    ----------
    frame : pandas.DataFrame
        A row per run, with the columns ``problem``, ``controller``, ``scenario``, ``variant``, ``seed``,
        ``failed`` and the metric's.
    metric : str
        The metric's column; its registry says which values are better.
    baseline : str
        The controller that the others are compared with. Holm's correction is for the comparisons of one
        problem, so that no problem changes what is said of another.

    Returns
    -------
    table : pandas.DataFrame
        ``problem``, ``controller``, ``failed`` (how many runs), the fields of :class:`Sample`, and those of
        :class:`Difference` (missing in the baseline's own row) as ``paired_seeds``, ``difference``,
        ``difference_low``, ``difference_high``, the others by their names, and ``told_apart``.

    Raises
    ------
    ConfigError
        A problem lacks the baseline, the metric is unknown, or two rows are of the same run.
    """
    import pandas as pd

    check_frame(frame, metric)
    better = metric_of(metric).better
    rows = []
    for problem, part in frame.groupby("problem", sort=False):
        runs = runs_of(part, metric)
        if baseline not in runs:
            help_text = did_you_mean(baseline, runs)
            raise ConfigError(f'baseline = "{baseline}": not in problem "{problem}"; {help_text}')
        rest = {name: own for name, own in runs.items() if name != baseline}
        others = {name: compare(own, runs[baseline], better) for name, own in rest.items()}
        differences = dict(zip(others, corrected(others.values()), strict=True))
        failed = part.groupby("controller", sort=False)["failed"].sum()
        for name, own in runs.items():
            row = {"problem": problem, "controller": name, "failed": int(failed[name])}
            row |= describe(own)._asdict()
            if one := differences.get(name):
                names = {"seeds": "paired_seeds", "median": "difference"}
                names |= {"low": "difference_low", "high": "difference_high"}
                row |= {names.get(key, key): value for key, value in one._asdict().items()}
                row["told_apart"] = one.told_apart
            rows.append(row)
    return pd.DataFrame(rows)


def runs_of(part: "pd.DataFrame", metric: str) -> dict[str, Runs]:
    """Return the runs of each controller of one problem, in the order of the frame."""
    table: dict[str, dict[tuple[Hashable, int], float]] = {}
    columns = ["controller", "scenario", "variant", "seed", "failed", metric]
    for controller, scenario, variant, seed, failed, value in part[columns].itertuples(
        index=False, name=None
    ):
        table.setdefault(controller, {})[(scenario, variant), seed] = math.nan if failed else float(value)
    return dict(table)


def check_frame(frame: "pd.DataFrame", metric: str) -> None:
    """Check that a frame has the metric, and no run twice.

    Raises
    ------
    ConfigError
        It has not, or has.
    """
    run = ["problem", "controller", "scenario", "variant", "seed"]
    if metric not in frame:
        found = [str(column) for column in frame if column not in (*run, "failed")]
        raise ConfigError(f'metric "{metric}": there is no such column; {did_you_mean(metric, found)}')
    twice = frame[frame.duplicated(run)]
    if len(twice):
        which = ", ".join(f"{key} {value}" for key, value in twice.iloc[0][run].items())
        raise ConfigError(f"two rows are of the same run: {which}; give each run once")


def _by_seed(runs: Runs) -> dict[int, float]:
    """Return the median of the runs of each seed that have a value."""
    values: dict[int, list[float]] = {}
    for (_, seed), value in runs.items():
        if math.isfinite(value):
            values.setdefault(seed, []).append(value)
    return {seed: median(own) for seed, own in values.items()}


def _difference(a: float, b: float) -> float:
    return 0.0 if math.isclose(a, b, rel_tol=_SAME) else a - b


def _constant(runs: Runs) -> bool:
    """Whether every condition has several seeds and the same value with each of them."""
    ranges: dict[Hashable, list[float]] = {}
    for (condition, _), value in runs.items():
        ranges.setdefault(condition, []).append(value)
    same = (len(own) > 1 and math.isclose(min(own), max(own), rel_tol=_SAME) for own in ranges.values())
    return bool(ranges) and all(same)
