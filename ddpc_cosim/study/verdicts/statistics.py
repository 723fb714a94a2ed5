"""Statistics within one problem: what its seeds show of each controller, and of two compared.

The seed is what is drawn at random, so each seed gives one value: where it has several runs (scenarios,
variants), their median. Scenarios do not multiply the seeds. A run that failed has no value: it is counted,
and never averaged away.

Which controllers differ is one test of all pairs: the step-down max-T of Westfall and Young (1993) over flips
of signs. It assumes that a difference is as likely as its negative where two controllers are equal: all
differences of one seed may then change their signs together, which keeps their correlation.
"""

import math
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
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
"""Of fewer values there is no interval: even the range of five covers the median with 93.75 % only.
Nor is there a test: with all signs alike, p is 2 / 2**5."""

Runs = Mapping[tuple[Hashable, int], float]
"""A metric by condition (what may differ but the controller) and seed; NaN of a run that failed."""
Better = Literal["low", "high", ""]
"""Which values of a metric are better, as its registry says."""

_Places = np.ndarray[tuple[int], np.dtype[np.intp]]
_Places2 = np.ndarray[tuple[int, int], np.dtype[np.intp]]
_EXACT = 14  # seeds up to which all signs are counted: 2**13, as a sign and its opposite come to the same
_DRAWS = 9999  # signs that are drawn where there are more
_FEWEST_DRAWS = 999  # of families so large that ...
_MOST_VALUES = 10**8  # ... so many statistics would be too many, or ...
_MOST_SIGNS = 2 * 10**7  # ... so many signs
_AT_ONCE = 10**6  # statistics, or signs, that are held as numbers at a time
_LARGEST_SCALE = 0.7  # a pair's scale, in parts of the root mean square of its own differences
_NEVER = 1e-18  # probability of a pair of middle values that is left out
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
    mean : float
        Mean of the differences over the seeds, which the test is of.
    median, low, high : float
        Median of the differences over the seeds, and its 95 % bootstrap interval; NaN where there is none.
    won : float
        Share of the seeds with the better value, a tie counting half; NaN where no value is better.
    p : float
        Of flips of the seeds' signs, two-sided: of this comparison alone. NaN where it is not tested, and of
        fewer than six seeds, whose p could not fall below 5 %.
    constant : bool
        Whether the seed changes neither of the two: the difference is known, there is nothing to test.
    tested : bool
        Whether it belongs to a family of tests: it is not constant, and every run of both has a value.
    corrected : float
        ``p`` corrected for the other comparisons of its family by :func:`max_t`.
    """

    pairs: int
    seeds: int
    only_own: int
    only_other: int
    mean: float
    median: float
    low: float
    high: float
    won: float
    p: float
    constant: bool
    tested: bool
    corrected: float = math.nan

    @property
    def turned(self) -> "Difference":
        """The other controller less this one."""
        return self._replace(
            only_own=self.only_other,
            only_other=self.only_own,
            mean=0.0 - self.mean,  # and not -0
            median=0.0 - self.median,
            low=0.0 - self.high,
            high=0.0 - self.low,
            won=1.0 - self.won,
        )

    @property
    def told_apart(self) -> bool:
        """Whether the two differ by more than chance explains; mean, median and most seeds have to agree."""
        agreed = self.mean * self.median > 0 and self.won != 0.5
        return (self.constant and self.median != 0) or (self.corrected <= LEVEL and agreed)

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
        apart = {pair for pair, difference in self.differences.items() if difference.told_apart}
        return groups(self.order, apart)

    @cached_property
    def letters(self) -> dict[str, str]:
        """The groups of each controller as letters: two that are not told apart share one."""
        return letters(self.groups)

    @property
    def tests(self) -> int:
        """How many comparisons are in the family of tests."""
        return sum(difference.tested for difference in self.differences.values())

    @property
    def seeds_needed(self) -> int:
        """Seeds from which on a controller that is ahead on each can be told apart, of however many."""
        return FEWEST

    @property
    def seeds(self) -> int:
        """The most seeds that any two share."""
        return max((difference.seeds for difference in self.differences.values()), default=0)

    @property
    def tells_first(self) -> bool:
        """Whether the pairs tell that the first is better than each other one."""
        first = [difference for (name, _), difference in self.differences.items() if name == self.order[0]]
        return not self.too_few_seeds and all(
            difference.told_apart and not difference.told_worse for difference in first
        )

    @cached_property
    def level_with_first(self) -> frozenset[str]:
        """Those that the pairs do not tell apart from the first; none where the seeds are too few."""
        level = self._to_first(lambda difference: not difference.told_apart)
        return frozenset() if self.too_few_seeds else level

    @cached_property
    def ahead_of_first(self) -> frozenset[str]:
        """Those that the pairs tell to be better than the first, despite its median."""
        return self._to_first(lambda difference: difference.told_worse)

    def _to_first(self, chosen: Callable[[Difference], bool]) -> frozenset[str]:
        pairs = self.differences.items()
        return frozenset(
            other for (name, other), difference in pairs if name == self.order[0] and chosen(difference)
        )

    @cached_property
    def behind(self) -> frozenset[tuple[str, str]]:
        """Pairs that are told apart as their medians say, both ways round."""
        pairs = [
            pair
            for pair, difference in self.differences.items()
            if difference.told_apart and not difference.told_worse
        ]
        return frozenset([*pairs, *((b, a) for a, b in pairs)])

    def between(self, a: str, b: str) -> Difference | None:
        """Return the difference of two, whichever of them comes first; None if there is none."""
        return self.differences.get((a, b)) or self.differences.get((b, a))

    def above(self, first: str, other: str, runs: Mapping[str, Runs], better: Better) -> Difference:
        """Return another less the first, one with failed runs too; p is corrected where they were tested."""
        if (difference := self.differences.get((other, first))) is not None:
            return difference
        if (difference := self.differences.get((first, other))) is not None:
            return difference.turned
        return compare(runs[other], runs[first], better)

    @property
    def too_few_seeds(self) -> bool:
        """Whether no p could fall below 5 %, even if a controller is ahead on every seed."""
        return self.tests > 0 and self.seeds < self.seeds_needed


def describe(runs: Runs) -> Sample:
    """Sum up the runs of one controller."""
    values = np.array([*_by_seed(runs).values()])
    lower, middle, upper = np.percentile(values, [25, 50, 75]).tolist() if values.size else [math.nan] * 3
    known = sum(map(math.isfinite, runs.values()))
    return Sample(len(runs), known, values.size, middle, lower, upper, *median_interval(values))


class Interaction(NamedTuple):
    """How the difference of two controllers differs between two conditions.

    Parameters
    ----------
    pair : (str, str)
        The controllers: the first less the second.
    conditions : (hashable, hashable)
        That difference under the first less that under the second.
    median : float
        Median of it over the seeds.
    corrected : float
        Its p among those of all pairs and conditions, by :func:`max_t`; NaN where it is not tested.
    constant : bool
        Whether the seed changes none of the four runs.
    """

    pair: tuple[str, str]
    conditions: tuple[Hashable, Hashable]
    median: float
    corrected: float
    constant: bool

    @property
    def is_significant(self) -> bool:
        """Whether the difference depends on the condition by more than chance explains."""
        return (self.constant and self.median != 0) or self.corrected <= LEVEL


def compare(runs: Runs, other: Runs, better: Better = "low") -> Difference:
    """Compare two controllers, run by run of the same condition and seed."""
    both = {key: (value, other[key]) for key, value in runs.items() if key in other}
    have = [(math.isfinite(a), math.isfinite(b)) for a, b in both.values()]
    pairs = {key: ab for key, ab in both.items() if all(map(math.isfinite, ab))}
    by_seed = _differences(runs, other)
    differences = np.array([*by_seed.values()])
    constant = all(_constant({key: ab[i] for key, ab in pairs.items()}) for i in (0, 1))
    tested = 0 < len(pairs) == len(both) and not constant
    ahead = (np.sign(differences) * (1 if better == "high" else -1) + 1) / 2
    return Difference(
        len(pairs),
        len(differences),
        have.count((True, False)),
        have.count((False, True)),
        float(differences.mean()) if differences.size else math.nan,
        float(np.median(differences)) if differences.size else math.nan,
        *median_interval(differences),
        float(ahead.mean()) if better and differences.size else math.nan,
        max_t([by_seed], [("own", "other")])[0] if tested else math.nan,
        constant,
        tested,
    )


def compare_pairs(
    runs: Mapping[str, Runs], pairs: Iterable[tuple[str, str]], better: Better = "low"
) -> dict[tuple[str, str], Difference]:
    """Compare the controllers of each pair, the pairs being one family of tests."""
    table = {(a, b): compare(runs[a], runs[b], better) for a, b in pairs}
    family = [pair for pair, difference in table.items() if difference.tested]
    corrected = max_t([_differences(runs[a], runs[b]) for a, b in family], family)
    return table | {
        pair: table[pair]._replace(corrected=p) for pair, p in zip(family, corrected, strict=True)
    }


def compare_all(runs: Mapping[str, Runs], better: Better = "low") -> Comparisons:
    """Compare controllers, each with each, all pairs being one family of tests."""
    medians = {name: describe(controller_runs).median for name, controller_runs in runs.items()}
    sign = -1 if better == "high" else 1
    order = sorted((name for name in runs if medians[name] == medians[name]), key=lambda n: sign * medians[n])
    return Comparisons(tuple(order), compare_pairs(runs, combinations(order, 2), better))


def interactions(runs: Mapping[str, Runs]) -> list[Interaction]:
    """Compare the differences of each two controllers between each two conditions, as one family of tests.

    Only seeds count with which both ran under both conditions; without such seeds there is no interaction.
    """
    by_condition = {name: _by_condition(values) for name, values in runs.items()}
    compared, family, members = [], [], []
    for a, b in combinations(by_condition, 2):
        shared = [condition for condition in by_condition[a] if condition in by_condition[b]]
        for first, other in combinations(shared, 2):
            cells = [(a, first), (b, first), (a, other), (b, other)]
            four = [by_condition[name][condition] for name, condition in cells]
            seeds = sorted(set[int].intersection(*map(set, four)))
            values = {
                seed: _difference(four[0][seed], four[1][seed]) - _difference(four[2][seed], four[3][seed])
                for seed in seeds
            }
            constant = all(_constant({("", seed): cell[seed] for seed in seeds}) for cell in four)
            complete = all(map(math.isfinite, values.values()))
            if seeds and complete:
                middle = median(values.values())
                compared.append(Interaction((a, b), (first, other), middle, math.nan, constant))
            if seeds and complete and not constant:
                family.append(values)
                members.append(cells)
    corrected = iter(max_t(family, members))
    return [
        interaction if interaction.constant else interaction._replace(corrected=next(corrected))
        for interaction in compared
    ]


def max_t(differences: Sequence[Mapping[int, float]], members: Sequence[Sequence[Hashable]]) -> list[float]:
    """Return p-values of differences by seed, corrected for each other; NaN of fewer than six seeds.

    The signs of all differences of a seed are flipped together, for up to 14 seeds in all ways, of more in
    9 999 ways that are drawn, always the same. A p is the share of the flips in which the largest statistic
    of those differences that are no more significant than its own is at least as large as it (Westfall and
    Young 1993, algorithm 2.8). The chance that any true null hypothesis is rejected is at most the level if
    the differences for which it holds are, together, as likely as their negatives.

    The statistic is the mean over a scale: the root of the sum of the squared scales of the controllers, of
    each the median, over its differences, of the standard deviation of their sizes; but at most 0.7 of the
    difference's root mean square. A plain mean tells more where all controllers vary alike, and nothing as
    soon as one of them varies much more than the others; a studentised one tells little of few seeds.

    Parameters
    ----------
    differences : sequence of mapping of int to float
        By seed, each with a value.
    members : sequence of sequence of hashable
        Of each difference, which controllers it is of: equally many of each.
    """
    enough = [place for place, by_seed in enumerate(differences) if len(by_seed) >= FEWEST]
    p = [math.nan] * len(differences)
    if enough:
        seeds = sorted({seed for place in enough for seed in differences[place]})
        numbers: dict[Hashable, int] = {}
        rows = [[differences[place].get(seed, math.nan) for seed in seeds] for place in enough]
        of = [[numbers.setdefault(member, len(numbers)) for member in members[place]] for place in enough]
        for place, value in zip(enough, step_down(np.array(rows), np.array(of)).tolist(), strict=True):
            p[place] = value
    return p


def step_down(values: FloatArray, members: _Places2) -> FloatArray:
    """Return the p-values of :func:`max_t` of an array.

    Parameters
    ----------
    values : array, shape (tests, seeds)
        The differences; NaN where a seed has none.
    members : array of int, shape (tests, n)
        Numbers of the controllers that each difference is of.
    """
    known = np.isfinite(values)
    values = np.where(known, values, 0.0)
    weights = 1 / (known.sum(axis=1) * _scales(values, known.sum(axis=1), members))
    order = np.argsort(-abs(values.sum(axis=1) * weights), kind="stable")
    values = (values * weights[:, None])[order]
    # Sums of the same numbers differ by rounding: equal ones are to count as equal.
    least = abs(values.sum(axis=1)) - _SAME * abs(values).sum(axis=1)
    count = np.zeros(len(values), dtype=np.int64)
    tests, seeds = values.shape
    most = min(_MOST_VALUES // tests, _MOST_SIGNS // seeds)
    turned = _turned(seeds, min(_DRAWS, max(_FEWEST_DRAWS, most)))
    for part in np.array_split(turned, math.ceil(len(turned) * max(tests, seeds) / _AT_ONCE)):
        signs = 1.0 - 2.0 * np.unpackbits(part, axis=1, count=seeds)
        sizes = abs(values @ signs.T)[::-1]
        # The largest of those from each place on: of the differences that are no more significant.
        np.maximum.accumulate(sizes, axis=0, out=sizes)
        count += (sizes[::-1] >= least[:, None]).sum(axis=1)
    p = np.empty(len(values))
    p[order] = np.maximum.accumulate(count / len(turned))
    return p


def _scales(values: FloatArray, counts: _Places, members: _Places2) -> FloatArray:
    """Return scales of differences that no flip of signs changes."""
    square = (values**2).sum(axis=1) / counts
    spread = np.sqrt(np.maximum(square - (abs(values).sum(axis=1) / counts) ** 2, 0.0))
    # The lower median of the differences of each member.
    flat = members.ravel()
    order = np.lexsort((np.repeat(spread, members.shape[1]), flat))
    of_each = np.bincount(flat)
    middle = order[np.cumsum(of_each) - of_each + (of_each - 1) // 2]
    member_scales = spread[middle // members.shape[1]]
    size = np.sqrt(square)
    scales = np.sqrt((member_scales[members] ** 2).sum(axis=1)).clip(_SAME * size, _LARGEST_SCALE * size)
    return np.where(size > 0, scales, 1.0)


@lru_cache(maxsize=2)
def _turned(n: int, draws: int) -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    """Return ways to turn the signs of n values, none first, in bits; of those that mirror each other one."""
    if n <= _EXACT:
        bits = np.arange(2 ** (n - 1))[:, None] >> np.arange(n - 1) & 1
        return np.packbits(np.pad(bits, ((0, 0), (1, 0))), axis=1)
    turned = np.zeros((draws + 1, -(-n // 8)), np.uint8)
    rng = np.random.default_rng(0)
    for row in turned:  # one by one: what is drawn has 64 times their memory
        row[:] = np.packbits(np.concatenate([[0], rng.integers(0, 2, n - 1)]))
    turned[0] = 0
    return turned


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
    table = np.add.outer(below[likely], below[::-1][likely])
    table += scipy.special.gammaln(n + 1) - 2 * scipy.special.gammaln(half + 1)
    above = np.triu(np.ones(table.shape, bool), 1)
    np.exp(table, out=table, where=above)
    table[~above] = 0.0
    np.fill_diagonal(table, weights[likely] - table.sum(axis=1))
    lower, upper = np.nonzero(table > _NEVER)  # of many values the two middle ones are neighbours, or nearly
    return table[lower, upper], likely[lower], likely[upper]


def groups(order: Sequence[str], told_apart: Collection[tuple[str, str]]) -> tuple[tuple[str, ...], ...]:
    """Return the largest groups without a pair that is told apart, the first of the order first.

    They are the letters of a compact letter display (Piepho 2004): two controllers share a group if and only
    if they are not told apart. One that differs from all others is a group of its own.
    """
    largest = [frozenset(order)] if order else []
    for a, b in told_apart:
        parts = {
            part for group in largest for part in ([group - {a}, group - {b}] if {a, b} <= group else [group])
        }
        largest = [part for part in parts if not any(part < other for other in parts)]
    places = sorted(sorted(map(order.index, group)) for group in largest)
    return tuple(tuple(order[i] for i in group) for group in places)


def letters(groups: Sequence[Sequence[str]]) -> dict[str, str]:
    """Return the groups that each member is in as letters, from a on, separated by spaces."""
    names = [*ascii_lowercase, *(str(number) for number in range(27, len(groups) + 1))]
    table: dict[str, list[str]] = {}
    for name, group in zip(names, groups, strict=False):
        for member in group:
            table.setdefault(member, []).append(name)
    return {member: " ".join(member_names) for member, member_names in table.items()}


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
        The controller that the others are compared with. The comparisons of one problem are a family of
        tests, so that no problem changes what is said of another.

    Returns
    -------
    table : pandas.DataFrame
        ``problem``, ``controller``, ``failed`` (how many runs) and ``reason`` (of the first of them, where
        the frame has it), the fields of :class:`Sample`, and those of :class:`Difference`
        (missing in the baseline's own row) as ``paired_seeds``, ``difference_mean``, ``difference``,
        ``difference_low``, ``difference_high``, the others by their names, ``told_apart``, and ``verdict``:
        ``better``, ``worse`` or ``different`` where they are told apart, ``not told apart``, or why it is not
        tested; of the baseline ``baseline``.

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
        pairs = [(name, baseline) for name in runs if name != baseline]
        differences = {
            name: difference for (name, _), difference in compare_pairs(runs, pairs, better).items()
        }
        failed = part.groupby("controller", sort=False)["failed"].sum()
        reasons = dict[str, str]()
        if "reason" in part:
            of_failed = part[part["failed"].astype(bool)].groupby("controller")["reason"]
            reasons = {str(name): str(texts.iloc[0]) for name, texts in of_failed}
        for name, controller_runs in runs.items():
            row = {"problem": problem, "controller": name, "failed": int(failed[name])}
            all_failed = row["failed"] == len(controller_runs)
            reason = row["reason"] = reasons.get(name, "")
            failure = ": ".join(filter(None, ("failed", reason))) if all_failed else ""
            row["verdict"] = failure or _verdict(differences.get(name))
            row |= describe(controller_runs)._asdict()
            if difference := differences.get(name):
                names = {"seeds": "paired_seeds", "median": "difference", "mean": "difference_mean"}
                names |= {"low": "difference_low", "high": "difference_high"}
                row |= {names.get(key, key): value for key, value in difference._asdict().items()}
                row["told_apart"] = difference.told_apart
            rows.append(row)
    return pd.DataFrame(rows)


def _verdict(difference: Difference | None) -> str:
    """Say in a few words what the pairs tell of a controller against the baseline."""
    if difference is None:
        return "baseline"
    if difference.told_apart:
        return "different" if math.isnan(difference.won) else "worse" if difference.told_worse else "better"
    if difference.tested or difference.constant:
        few = difference.seeds < FEWEST and not difference.constant
        return f"not tested: {difference.seeds} seeds, needed {FEWEST}" if few else "not told apart"
    return f"not tested: {difference.only_own + difference.only_other or 'all'} pairs have a failed run"


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
        columns = [str(column) for column in frame if column not in (*run, "failed")]
        raise ConfigError(f'metric "{metric}": there is no such column; {did_you_mean(metric, columns)}')
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
    return {seed: median(seed_values) for seed, seed_values in values.items()}


def _by_condition(runs: Runs) -> dict[Hashable, dict[int, float]]:
    """Return the runs of each condition by seed."""
    values: dict[Hashable, dict[int, float]] = {}
    for (condition, seed), value in runs.items():
        values.setdefault(condition, {})[seed] = value
    return values


def _differences(runs: Runs, other: Runs) -> dict[int, float]:
    """Return of each seed the median difference of the runs that both have."""
    return _by_seed({key: _difference(a, other[key]) for key, a in runs.items() if key in other})


def _difference(a: float, b: float) -> float:
    return 0.0 if math.isclose(a, b, rel_tol=_SAME) else a - b


def _constant(runs: Runs) -> bool:
    """Whether every condition has several seeds and the same value with each of them."""
    ranges: dict[Hashable, list[float]] = {}
    for (condition, _), value in runs.items():
        ranges.setdefault(condition, []).append(value)
    same = (
        len(values) > 1 and math.isclose(min(values), max(values), rel_tol=_SAME)
        for values in ranges.values()
    )
    return bool(ranges) and all(same)
