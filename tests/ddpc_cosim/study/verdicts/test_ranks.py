"""Statistics over problems, against published examples and hand calculation."""

import math

import numpy as np
import pandas as pd
import pytest

from ddpc_cosim import ConfigError
from ddpc_cosim.study.verdicts.ranks import (
    average_ranks,
    performance_profile,
    profile_frame,
    ranks_frame,
    setting_effect,
)

NAN = math.nan
METRIC = "rmse.y [m]"
# Demsar, Statistical comparisons of classifiers over multiple data sets, JMLR 7 (2006), table 6: areas under
# the curve of C4.5, C4.5+m, C4.5+cf, C4.5+m+cf. The last two of "voting", both 0.975, have the ranks 2 and 3.
DEMSAR = np.array([
    [0.763, 0.768, 0.771, 0.798], [0.599, 0.591, 0.590, 0.569], [0.954, 0.971, 0.968, 0.967],
    [0.628, 0.661, 0.654, 0.657], [0.882, 0.888, 0.886, 0.898], [0.936, 0.931, 0.916, 0.931],
    [0.661, 0.668, 0.609, 0.685], [0.583, 0.583, 0.563, 0.625], [0.775, 0.838, 0.866, 0.875],
    [1.000, 1.000, 1.000, 1.000], [0.940, 0.962, 0.965, 0.962], [0.619, 0.666, 0.614, 0.669],
    [0.972, 0.981, 0.9751, 0.975], [0.957, 0.978, 0.946, 0.970],
])  # fmt: skip


def frame(table: dict[str, dict[str, list[float]]], metric: str = METRIC) -> pd.DataFrame:
    """Return a frame from values by problem and controller; NaN is a run that failed."""
    rows = [
        (problem, name, "nominal", "", seed, math.isnan(value), value)
        for problem, controllers in table.items()
        for name, values in controllers.items()
        for seed, value in enumerate(values)
    ]
    columns = ["problem", "controller", "scenario", "variant", "seed", "failed", metric]
    return pd.DataFrame(rows, columns=columns)


def test_the_example_of_demsar() -> None:
    averages = average_ranks(["C4.5", "+m", "+cf", "+m+cf"], -DEMSAR)
    expected = {"+m+cf": 1.964, "+m": 2.000, "+cf": 2.893, "C4.5": 3.143}
    assert averages.ranks == pytest.approx(expected, abs=5e-4)
    assert list(averages.ranks) == list(expected)
    assert averages.critical_difference == pytest.approx(1.25, abs=0.005)
    # The paper's 9.28 is without the correction for ties: three pairs, and all four of one data set.
    assert averages.statistic == pytest.approx(
        9.28 / (1 - (3 * (2**3 - 2) + 4**3 - 4) / (14 * (4**3 - 4))), abs=0.01
    )
    half = averages.statistic / 2  # of chi-square with three degrees of freedom
    tail = math.erfc(math.sqrt(half)) + math.sqrt(4 * half / math.pi) * math.exp(-half)
    assert averages.p == pytest.approx(tail)
    # The paper: no two of the four differ by 1.25; "the data is not sufficient".
    assert averages.groups == (("+m+cf", "+m", "+cf", "C4.5"),)


@pytest.mark.parametrize(("k", "q"), [(2, 1.960), (3, 2.343), (5, 2.728), (10, 3.164)])
def test_critical_values_of_nemenyi(k: int, q: float) -> None:
    """Demsar (2006), table 5 (a)."""
    averages = average_ranks([str(i) for i in range(k)], np.random.default_rng(0).random((9, k)))
    assert averages.critical_difference == pytest.approx(q * math.sqrt(k * (k + 1) / 54), abs=2e-3)


def test_ranks_that_differ_share_no_group() -> None:
    scores = np.array([[1.0, 2.0, 3.0]] * 8 + [[2.0, 1.0, 3.0]] * 8)
    averages = average_ranks(["a", "b", "worst"], scores)
    assert averages.ranks == {"a": 1.5, "b": 1.5, "worst": 3.0}
    assert averages.groups == (("a", "b"), ("worst",))


def test_nothing_is_told_apart_of_equal_ones_of_two_or_in_one_problem() -> None:
    assert average_ranks(["a", "b", "c"], np.ones((5, 3)))[2:4] == (0.0, 1.0)
    for scores in (np.array([[1.0, 2.0, 3.0]]), np.array([[1.0, 2.0]] * 30)):
        averages = average_ranks(["a", "b", "c"][: scores.shape[1]], scores)
        assert math.isnan(averages.p)
        assert len(averages.groups) == 1


def test_ranks_of_a_study() -> None:
    """p: a and c never fail; b has a failed run and comes after them, all of d's failed. q: a and b tie."""
    table = {
        "p": {"a": [3.0, 5.0], "b": [1.0, NAN], "c": [2.0, 2.0], "d": [NAN, NAN]},
        "q": {"a": [1.0], "b": [1.0 + 1e-12], "c": [NAN], "d": [NAN]},
    }
    averages = ranks_frame(frame(table), METRIC)
    assert averages.ranks == {"a": 1.75, "b": 2.25, "c": 2.25, "d": 3.75}
    assert averages.problems == 2


def test_medians_are_compared_within_a_condition_only() -> None:
    """b is the best in two of three scenarios; in the third all values are far larger, and a is."""
    values = {"calm": {"a": 2.0, "b": 1.0, "c": 3.0}, "noise": {"a": 2.0, "b": 1.0, "c": 3.0}}
    values["windy"] = {"a": 100.0, "b": 200.0, "c": 300.0}
    table = pd.concat(
        frame({"p": {name: [value] for name, value in of.items()}}).assign(scenario=scenario)
        for scenario, of in values.items()
    )
    assert ranks_frame(table, METRIC).ranks == {"b": 1.0, "a": 2.0, "c": 3.0}
    assert table.groupby("controller")[METRIC].mean().idxmin() == "a"


def test_who_did_not_run_in_every_problem_is_named_and_not_ranked() -> None:
    table = {"p": {"a": [1.0], "b": [2.0], "some": [0.1]}, "q": {"a": [1.0], "b": [2.0]}}
    assert ranks_frame(frame(table), METRIC).left_out == ("some",)
    profile = profile_frame(frame(table), METRIC)
    assert (list(profile.shares), profile.left_out) == (["a", "b"], ("some",))


def test_values_of_which_the_larger_are_better_rank_the_other_way() -> None:
    scores = np.array([[1.0, 2.0], [4.0, 2.0]])
    steps, shares = performance_profile(scores, "high")
    assert steps.tolist() == [1.0, 2.0]
    assert shares.tolist() == [[0.5, 0.5], [1.0, 1.0]]


def test_a_performance_profile_by_hand() -> None:
    """Ratios: a 1, 3, 1, inf; b 2, 1, inf, inf. The best of the third is 0; in the fourth all failed."""
    steps, shares = performance_profile(np.array([[1.0, 2.0], [6.0, 2.0], [0.0, 5.0], [NAN, NAN]]))
    assert steps.tolist() == [1.0, 2.0, 3.0]
    assert shares.T.tolist() == [[0.5, 0.5, 0.75], [0.25, 0.5, 0.5]]


def test_what_differs_by_rounding_is_as_good_as_the_best() -> None:
    steps, shares = performance_profile(np.array([[1.0, 1.0 + 1e-13], [3.0, 1.0]]))
    assert steps.tolist() == [1.0, 3.0]
    assert shares.tolist() == [[0.5, 1.0], [1.0, 1.0]]


def test_each_problem_has_the_same_weight() -> None:
    table = {"p": {"a": [1.0] * 4, "b": [2.0, 2.0, 2.0, NAN]}, "q": {"a": [3.0], "b": [1.0]}}
    profile = profile_frame(frame(table), METRIC)
    assert profile.ratios.tolist() == [1.0, 2.0, 3.0]
    assert profile.shares["a"] == pytest.approx([0.5, 0.5, 1.0])
    assert profile.shares["b"] == pytest.approx([0.5, 0.875, 0.875])


def test_what_cannot_be_profiled_or_ranked_is_refused() -> None:
    with pytest.raises(ConfigError, match="positive: it is -1 in a run; use average ranks"):
        performance_profile(np.array([[1.0, -1.0]]))
    nobody_better = "max_abs_input.u [N]"
    table = frame({"p": {"a": [1.0], "b": [2.0]}}, nobody_better)
    with pytest.raises(ConfigError, match="no value of it is better"):
        profile_frame(table, nobody_better)
    with pytest.raises(ConfigError, match="no value of it is better"):
        ranks_frame(table, nobody_better)
    with pytest.raises(ConfigError, match="no run that all controllers share"):
        ranks_frame(frame({"p": {"a": [1.0]}, "q": {"b": [1.0]}}), METRIC)


def test_a_setting_that_decides_a_metric() -> None:
    """Spearman: 1 - 6 sum d^2 / (n (n^2 - 1)), with d = 0, 1, 1, 0."""
    effect = setting_effect([0.1, 1, 10, 100], np.array([1.0, 3.0, 2.0, 4.0]))
    assert (effect.runs, effect.known, effect.levels) == (4, 4, 4)
    assert effect.correlation == pytest.approx(1 - 6 * 2 / 60)
    assert math.isnan(effect.share)


def test_a_setting_with_an_optimum_in_the_middle_has_no_correlation_but_a_share() -> None:
    """The share is of H by the formula of Kruskal and Wallis, the ranks being 3 + 5, 1 + 2 and 4 + 6."""
    effect = setting_effect([1, 1, 2, 2, 3, 3], np.array([3.0, 5.0, 1.0, 2.0, 4.0, 6.0]))
    statistic = 12 / (6 * 7) * (8**2 + 3**2 + 10**2) / 2 - 3 * 7
    assert effect.share == pytest.approx((statistic - 2) / 3)
    # Settings have the ranks 1.5, 3.5, 5.5: the sum of products of deviations is 4, of squares 16 and 17.5.
    assert effect.correlation == pytest.approx(4 / math.sqrt(16 * 17.5))


def test_runs_that_do_not_hold_are_the_worst_of_a_setting() -> None:
    values = np.array([1.0, 2.0, NAN, NAN])
    effect = setting_effect([1.0, 2.0, 3.0, 4.0], values)
    assert effect.known == 2
    assert effect.correlation == pytest.approx(4.5 / math.sqrt(5 * 4.5))
    higher = setting_effect([1.0, 2.0, 3.0, 4.0], values, "high")
    assert higher.correlation == pytest.approx(-3.5 / math.sqrt(5 * 4.5))
    assert setting_effect([1.0, 2.0, 3.0, 4.0], values, "").correlation == pytest.approx(1)


def test_a_setting_in_words_has_no_order() -> None:
    effect = setting_effect(["l1", "l2", "l1", "l2"], np.array([1.0, 4.0, 2.0, 3.0]))
    assert math.isnan(effect.correlation)
    assert effect.share == pytest.approx((2.4 - 1) / 2)
    assert math.isnan(setting_effect([True, False], np.array([1.0, 2.0])).correlation)


def test_where_nothing_varies_nothing_is_said() -> None:
    for settings, values in (([1, 1, 1], [1.0, 2.0, 3.0]), ([1, 2, 2], [5.0, 5.0, 5.0]), ([], [])):
        effect = setting_effect(settings, np.array(values))
        assert math.isnan(effect.correlation)
        assert math.isnan(effect.share)
