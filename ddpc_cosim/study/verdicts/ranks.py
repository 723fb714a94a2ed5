"""Statistics over problems: performance profiles and average ranks; and which settings matter."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np
import scipy  # whose parts are imported when they are first used

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.metrics import metric_of
from ddpc_cosim.study.verdicts.standings import Standings
from ddpc_cosim.study.verdicts.statistics import LEVEL, Better, Runs, check_frame, groups
from ddpc_cosim.variables import FloatArray

if TYPE_CHECKING:
    import pandas as pd


class Profile(NamedTuple):
    """A performance profile (Dolan & More 2002).

    Parameters
    ----------
    ratios : array
        Ratios to the best of a run at which a share changes, rising from 1; shape (n,).
    shares : dict of str to array
        By controller, the share of the runs that come within that ratio of the best, each problem with the
        same weight; shape (n,). It ends at the share of the runs that did not fail.
    left_out : tuple of str
        Controllers that did not run in every problem.
    """

    ratios: FloatArray
    shares: dict[str, FloatArray]
    left_out: tuple[str, ...]


class AverageRanks(NamedTuple):
    """Average ranks over problems, and which of them are told apart (Demsar 2006).

    Parameters
    ----------
    ranks : dict of str to float
        Average rank of each controller, the best first; ties share their rank.
    problems : int
        How many problems there are.
    statistic, p : float
        Friedman's chi-square, corrected for ties, and its p; NaN with fewer than three controllers or two
        problems.
    critical_difference : float
        Of Nemenyi's test at 5 %: ranks that are as far apart or further differ.
    groups : tuple of tuple of str
        The largest groups that the ranks do not tell apart: all together where Friedman's p is above 5 %.
    left_out : tuple of str
        Controllers that did not run in every problem.
    """

    ranks: dict[str, float]
    problems: int
    statistic: float
    p: float
    critical_difference: float
    groups: tuple[tuple[str, ...], ...]
    left_out: tuple[str, ...] = ()

    @property
    def level_with_first(self) -> tuple[str, ...]:
        """Those that the problems do not tell apart from the one with the best average rank."""
        first = next(iter(self.ranks))
        level = {name for group in self.groups if first in group for name in group} - {first}
        return tuple(name for name in self.ranks if name in level)


class SettingEffect(NamedTuple):
    """How much a setting that was varied decides a metric.

    Parameters
    ----------
    runs, known, levels : int
        Runs, those of them that did not fail, and different values of the setting.
    correlation : float
        Spearman's rank correlation of setting and metric; NaN where the setting is not a number, or nothing
        varies. Positive: the larger the setting, the larger the metric.
    share : float
        Share of the variance of the metric's ranks that the setting's values explain, corrected for their
        number (epsilon squared of Kruskal and Wallis): also of a setting with an optimum in the middle, whose
        correlation may be 0. NaN where no value was run twice.
    """

    runs: int
    known: int
    levels: int
    correlation: float
    share: float


def performance_profile(
    values: FloatArray, better: Better = "low", weights: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return ratios, shape (n,), and the shares of the runs within them, shape (n, controllers).

    Parameters
    ----------
    values : array
        A metric, shape (runs, controllers), NaN where a run failed: its ratio is infinite. Where the
        best is 0, others with 0 have the ratio 1, and all others an infinite one.
    better : {"low", "high"}
        Which values are better.
    weights : array, optional
        Of the runs, shape (runs,), with the sum 1; all equal if not given.

    Raises
    ------
    ConfigError
        There are negative values, of which there are no ratios, or no value is better.
    """
    if not better or (values < 0).any():
        why = "no value of it is better" if not better else f"it is {np.nanmin(values):.4g} in a run"
        raise ConfigError(f"a performance profile needs a metric that is positive: {why}; use average ranks")
    weights = np.full(len(values), 1 / len(values)) if weights is None else weights
    known = np.isfinite(values)
    best = np.where(known, values, -math.inf if better == "high" else math.inf)
    best = best.max(axis=1, keepdims=True) if better == "high" else best.min(axis=1, keepdims=True)
    above, below = (best, values) if better == "high" else (values, best)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(known, np.where(above == below, 1.0, above / below), math.inf)
    ratios[ratios < 1 + 1e-9] = 1.0  # what differs by rounding alone is as good
    steps = np.unique(np.append(ratios[np.isfinite(ratios)], 1.0))
    shares = []
    for column in ratios.T:
        order = np.argsort(column)
        reached = np.append(0.0, np.cumsum(weights[order]))
        shares.append(reached[np.searchsorted(column[order], steps, side="right")])
    return steps, np.column_stack(shares)


def average_ranks(names: Sequence[str], scores: FloatArray) -> AverageRanks:
    """Rank controllers in each problem, and say which of their average ranks differ.

    Parameters
    ----------
    names : sequence of str
        The controllers.
    scores : array
        The lower the better, shape (problems, controllers); infinite of one that is behind all others.
    """
    n, k = scores.shape
    ranks = scipy.stats.rankdata(scores, axis=1).mean(axis=0)
    distance = (
        float(scipy.stats.studentized_range.ppf(1 - LEVEL, k, math.inf)) / math.sqrt(2) if k > 1 else math.nan
    )
    distance *= math.sqrt(k * (k + 1) / (6 * n))
    statistic, p = math.nan, math.nan
    if k > 2 and n > 1:
        alike = (scores == scores[:, :1]).all()
        statistic, p = (0.0, 1.0) if alike else map(float, scipy.stats.friedmanchisquare(*scores.T))
    order = sorted(range(k), key=lambda i: ranks[i])
    apart = {
        (names[i], names[j])
        for at, i in enumerate(order)
        for j in order[at + 1 :]
        if p <= LEVEL and ranks[j] - ranks[i] >= distance
    }
    table = {names[i]: float(ranks[i]) for i in order}
    return AverageRanks(table, n, statistic, p, distance, groups(tuple(table), apart))


def setting_effect(settings: Sequence[object], values: FloatArray, better: Better = "low") -> SettingEffect:
    """Say how much a setting decides a metric, run by run.

    Parameters
    ----------
    settings : sequence
        The setting's value in each run.
    values : array
        The metric of each run, shape (runs,); NaN where a run failed, which ranks as worse than
        any value. Where no value of the metric is better, such runs are left out.
    better : {"low", "high", ""}
        Which values are better.
    """
    runs, known = len(values), np.isfinite(values)
    if better:
        values = np.where(known, values, -math.inf if better == "high" else math.inf)
    else:
        settings = [setting for setting, is_known in zip(settings, known, strict=True) if is_known]
        values = values[known]
    levels = list(dict.fromkeys(map(repr, settings)))
    place = np.array([levels.index(repr(setting)) for setting in settings])
    ranks = scipy.stats.rankdata(values)
    correlation, share = math.nan, math.nan
    if len(levels) > 1 and np.ptp(ranks):
        if all(isinstance(setting, int | float) and not isinstance(setting, bool) for setting in settings):
            correlation = float(scipy.stats.spearmanr(np.array(settings, dtype=float), ranks).statistic)
        if len(ranks) > len(levels):
            statistic = float(scipy.stats.kruskal(*(ranks[place == i] for i in range(len(levels)))).statistic)
            share = max(0.0, (statistic - len(levels) + 1) / (len(ranks) - len(levels)))
    return SettingEffect(runs, int(known.sum()), len(levels), correlation, share)


RANKED = "mean_abs_error"
"""Stands for what a problem ranks by, its own cost or mean errors: of both, lower values are better."""


def problems_frame(rankings: Iterable[Standings]) -> "pd.DataFrame | None":
    """Return the runs of several problems by what each ranks by; None of fewer than two with any.

    A problem of a single controller ranks nobody, and has no runs here. Of several outputs each is a
    condition of its own. Of money, which may be earned too, and of fronts it is the rank in each scenario
    that counts.
    """
    import pandas as pd  # with one problem it is not needed

    runs = [
        (problem, key, controller, scenario, seed, value, math.isnan(value))
        for problem, ranking in enumerate(rankings)
        for key, by_controller in _ranked_runs(ranking)
        if len(by_controller) > 1  # who is alone is compared with nobody
        for controller, values in by_controller.items()
        for (scenario, seed), value in values.items()
    ]
    columns = ["problem", "variant", "controller", "scenario", "seed", RANKED, "failed"]
    return pd.DataFrame(runs, columns=columns) if len({run[0] for run in runs}) > 1 else None


def _ranked_runs(ranking: Standings) -> Iterator[tuple[str, Mapping[str, Runs]]]:
    """Yield the runs by what is ranked by, or the ranks in their place."""
    if not ranking.is_of_money:
        yield from ((key, ranking.runs[key]) for key in ranking.keys)
        return
    overall = {standing.controller: standing.rank for standing in ranking.order}
    of_scenario = {
        name: {standing.controller: standing.rank for standing in part.order}
        for name, part in ranking.by_scenario.items()
    }
    yield (
        "rank",
        {
            name: {
                (scenario, seed): math.nan
                if math.isnan(value)
                else float(of_scenario.get(cast("str", scenario), overall)[name])
                for (scenario, seed), value in values.items()
            }
            for name, values in ranking.runs[ranking.keys[0]].items()
        },
    )


def profile_frame(frame: "pd.DataFrame", metric: str) -> Profile:
    """Return the performance profile of a metric over all problems.

    Parameters
    ----------
    frame : pandas.DataFrame
        As :func:`ddpc_cosim.study.verdicts.statistics.compare_frame` takes it. A run of the profile is one
        problem, scenario, variant and seed that all controllers have run; each problem has the same weight.
    metric : str
        The metric's column.

    Raises
    ------
    ConfigError
        The metric is unknown or has negative values, or the controllers share no run.
    """
    table, left_out = _shared_runs(frame, metric)
    problems = table.index.get_level_values("problem")
    share = problems.value_counts()
    weights = np.array([1 / (len(share) * share[problem]) for problem in problems])
    steps, shares = performance_profile(table.to_numpy(dtype=float), metric_of(metric).better, weights)
    return Profile(steps, dict(zip(table.columns, shares.T, strict=True)), left_out)


def ranks_frame(frame: "pd.DataFrame", metric: str) -> AverageRanks:
    """Return the average ranks of the controllers over all problems.

    In a problem, the controller with fewer runs that failed comes first, of equal ones that with the better
    average rank over the problem's conditions (scenario and variant), in each of which the medians over the
    seeds are ranked: no median is over values of different size or unit.

    Parameters
    ----------
    frame : pandas.DataFrame
        As :func:`ddpc_cosim.study.verdicts.statistics.compare_frame` takes it; only runs count that
        all controllers have.
    metric : str
        The metric's column.

    Raises
    ------
    ConfigError
        The metric is unknown, no value of it is better, or the controllers share no run.
    """
    better = metric_of(metric).better
    if not better:
        raise ConfigError(f'metric "{metric}": no value of it is better, so nothing can be ranked by it')
    table, left_out = _shared_runs(frame, metric)
    rows = []
    for _, part in table.groupby(level="problem", sort=False):
        medians = part.groupby(level=["scenario", "variant"]).median() * (-1 if better == "high" else 1)
        # Nine digits: what differs by rounding alone is a tie.
        scores = medians.fillna(math.inf).map(lambda value: float(f"{value:.9g}"))
        ranks = scipy.stats.rankdata(scores.to_numpy(dtype=float), axis=1).sum(axis=0)
        keys = [*zip(part.isna().sum(), ranks, strict=True)]
        order = sorted(set(keys))
        rows.append([order.index(key) for key in keys])
    averages = average_ranks([*map(str, table.columns)], np.array(rows, dtype=float))
    return averages._replace(left_out=left_out)


def _shared_runs(frame: "pd.DataFrame", metric: str) -> tuple["pd.DataFrame", tuple[str, ...]]:
    """Return the metric, a row per run and a column per controller, NaN where a run failed.

    Beside it, who did not run in every problem.
    """
    check_frame(frame, metric)
    problems = frame["problem"].nunique()
    ran_in = frame.groupby("controller", sort=False)["problem"].nunique()
    kept = [str(name) for name, count in ran_in.items() if count == problems]
    counted = ~frame["failed"] & np.isfinite(frame[metric])
    rows = frame.assign(value=frame[metric].where(counted), ran=True).loc[frame["controller"].isin(kept)]
    index = ["problem", "scenario", "variant", "seed"]
    values, ran = (rows.pivot(index=index, columns="controller", values=key) for key in ("value", "ran"))
    table = values[kept].loc[ran.notna().all(axis="columns")]
    if not kept or table.index.get_level_values("problem").nunique() < problems:
        raise ConfigError("in a problem there is no run that all controllers share: nothing can be compared")
    return table, tuple(map(str, ran_in.index.difference(kept, sort=False)))
