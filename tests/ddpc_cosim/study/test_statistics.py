"""Statistics within a problem, against enumeration, published examples and laws."""

import math
from itertools import combinations, combinations_with_replacement, product

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st
from scipy.stats import wilcoxon

from ddpc_cosim import ConfigError
from ddpc_cosim.study.statistics import (
    Comparisons,
    Runs,
    compare,
    compare_all,
    compare_frame,
    describe,
    groups,
    holm,
    median_interval,
    signed_rank,
)

NAN = math.nan
VALUES = st.floats(-100, 100).map(lambda value: round(value, 3))


def runs(*values: float, condition: str = "nominal") -> Runs:
    """Return the runs of one condition with the seeds 0, 1, ..."""
    return {(condition, seed): value for seed, value in enumerate(values)}


def table(**controllers: list[float]) -> pd.DataFrame:
    """Return a frame of one problem and scenario; a NaN is a run that failed."""
    rows = [
        ("p", name, "nominal", "", seed, math.isnan(value), 7.0 if math.isnan(value) else value)
        for name, values in controllers.items()
        for seed, value in enumerate(values)
    ]
    columns = ["problem", "controller", "scenario", "variant", "seed", "failed", "rmse.y [m]"]
    return pd.DataFrame(rows, columns=columns)


def test_what_is_said_of_a_controller() -> None:
    one = describe(runs(4.0, NAN, 1.0, 2.0, 3.0))
    assert one[:6] == (5, 4, 4, 2.5, 1.75, 3.25)
    assert math.isnan(one.low)
    assert math.isnan(one.high)


def test_where_every_run_failed_there_are_no_figures() -> None:
    one = describe(runs(NAN, NAN))
    assert one[:3] == (2, 0, 0)
    assert all(map(math.isnan, one[3:]))


def test_scenarios_do_not_multiply_the_seeds() -> None:
    """Each seed counts once, with the median of its runs: 2 and 5."""
    three = {(scenario, 0): value for scenario, value in zip("abc", (1.0, 2.0, 9.0), strict=True)}
    one = describe({**three, ("a", 1): 4.0, ("b", 1): 6.0, ("c", 1): NAN})
    assert one[:4] == (6, 5, 2, 3.5)


@pytest.mark.parametrize("n", [6, 7, 8])
def test_the_bootstrap_interval_is_that_of_all_resamples(n: int) -> None:
    values = np.array([1.0, 2.5, 3.0, 7.0, 11.0, 12.0, 20.0, 21.0])[:n]
    chance: dict[float, float] = {}
    for drawn in combinations_with_replacement(range(n), n):
        ways = math.factorial(n) / math.prod(math.factorial(drawn.count(i)) for i in set(drawn))
        median = float(np.median(values[list(drawn)]))
        chance[median] = chance.get(median, 0.0) + ways / n**n
    at_most = np.cumsum([chance[median] for median in sorted(chance)])
    expected = [sorted(chance)[int(np.argmax(at_most >= level))] for level in (0.025, 0.975)]
    assert median_interval(values[::-1]) == tuple(expected)


def test_the_bootstrap_interval_of_many_values_is_about_that_of_the_normal_law() -> None:
    """The 2.5 % quantile of the median of n uniform values is 1/2 - 1.96 / (2 sqrt n) of the way."""
    for n in (400, 401, 4000):
        low, high = median_interval(np.arange(n) / (n - 1))
        assert low == pytest.approx(0.5 - 0.98 / math.sqrt(n), abs=2 / n)
        assert low + high == pytest.approx(1)


def test_fewer_than_six_values_have_no_interval_and_equal_ones_have_none_to_either_side() -> None:
    assert all(map(math.isnan, median_interval(np.arange(5.0))))
    assert median_interval(np.full(6, 3.0)) == (3.0, 3.0)
    assert median_interval(np.full(7, 3.0)) == (3.0, 3.0)


def test_wilcoxon_published() -> None:
    """Depression scale, Hollander & Wolfe (1973), p. 29; Darwin's maize, Fisher (1935), section 17."""
    first = np.array([1.83, 0.50, 1.62, 2.48, 1.68, 1.88, 1.55, 3.06, 1.30])
    second = np.array([0.878, 0.647, 0.598, 2.05, 1.06, 1.29, 1.06, 3.14, 1.29])
    assert signed_rank(first - second) == pytest.approx(2 * 0.01953, abs=1e-5)
    maize = np.array([49.0, -67, 8, 16, 6, 23, 28, 41, 14, 29, 56, 24, 75, 60, -48])
    assert signed_rank(maize) == pytest.approx(0.04126, abs=1e-5)


@given(st.lists(st.integers(-4, 4), min_size=1, max_size=8))
@settings(max_examples=60, deadline=None)
def test_wilcoxon_counts_all_signs_with_ties_and_zeros(values: list[int]) -> None:
    sizes = [abs(value) for value in values]
    ranks = [sum(other < size for other in sizes) + (sizes.count(size) + 1) / 2 for size in sizes]
    kept = [rank for rank, size in zip(ranks, sizes, strict=True) if size]
    seen = sum(rank for rank, value in zip(ranks, values, strict=True) if value > 0)
    sums = [
        sum(rank for rank, up in zip(kept, signs, strict=True) if up)
        for signs in product([0, 1], repeat=len(kept))
    ]
    tails = sum(one <= seen for one in sums), sum(one >= seen for one in sums)
    expected = pytest.approx(min(1, 2 * min(tails) / len(sums)))
    assert signed_rank(np.array(values, dtype=float)) == expected
    rounded = [value / 10 * (1 + 1e-14 * place) for place, value in enumerate(values)]
    assert signed_rank(np.array(rounded)) == expected


def test_wilcoxon_of_many_values_is_near_the_count() -> None:
    values = np.array([(-1) ** (i % 3 == 0) * (1.0 + i) for i in range(51)])
    assert signed_rank(values) == pytest.approx(wilcoxon(values, method="exact").pvalue, abs=1e-3)
    assert signed_rank(np.zeros(51)) == 1.0
    assert signed_rank(values[1:]) == pytest.approx(wilcoxon(values[1:], method="exact").pvalue, rel=1e-12)


def test_holm_by_hand() -> None:
    assert holm([0.04, 0.01, NAN, 0.03, 0.02]) == pytest.approx([0.06, 0.04, NAN, 0.06, 0.06], nan_ok=True)
    assert holm([0.4, 0.5]) == [0.8, 0.8]
    assert holm([0.9, 0.9]) == [1.0, 1.0]
    assert holm([]) == []


@given(st.lists(st.floats(0, 1), max_size=8))
@settings(max_examples=50, deadline=None)
def test_holm_rejects_what_stepping_down_rejects(p: list[float]) -> None:
    rejected = set()
    for step, i in enumerate(sorted(range(len(p)), key=lambda i: p[i])):
        if p[i] * (len(p) - step) > 0.05:
            break
        rejected.add(i)
    assert {i for i, value in enumerate(holm(p)) if value <= 0.05} == rejected


def test_two_controllers_compared() -> None:
    """The own run failed on seed 5, the other's on seed 6; seed 7 the other has not run."""
    own = runs(1.0, 2.0, 3.0, 4.0, 5.0, NAN, 1.0, 1.0)
    other = runs(2.0, 1.0, 5.0, 4.0, 9.0, 1.0, NAN)
    one = compare(own, other)
    assert (one.pairs, one.seeds, one.only_own, one.only_other) == (5, 5, 1, 1)
    assert (one.median, one.won, one.constant) == (-1.0, 3.5 / 5, False)
    # The ranks of 0, 1, 1, 2, 4 are 1, 2.5, 2.5, 4, 5; of the 16 sums of the last four, 3 are at most 2.5.
    assert one.p == pytest.approx(2 * 3 / 16)
    assert compare(own, other, "high").won == pytest.approx(1.5 / 5)
    assert math.isnan(compare(own, other, "").won)


def test_a_difference_without_pairs_is_not_known() -> None:
    one = compare(runs(NAN, 1.0), runs(2.0, NAN))
    assert (one.pairs, one.only_own, one.only_other, one.constant) == (0, 1, 1, False)
    assert all(map(math.isnan, (one.median, one.low, one.won, one.p)))
    assert not one.told_apart


def test_what_the_seed_does_not_change_is_known_and_not_tested() -> None:
    one = compare(runs(1.0, 1.0, 1.0), runs(2.0, 2.0, 2.0))
    assert one.constant
    assert math.isnan(one.p)
    assert one.told_apart
    assert not compare(runs(1.0, 1.0, 1.0), runs(1.0, 1.0, 1.0 + 1e-12)).told_apart
    assert not compare(runs(1.0), runs(2.0)).constant, "one seed does not show whether it changes anything"
    varied = {("a", 0): 1.0, ("b", 1): 1.0}
    assert not compare(varied, varied).constant, "no condition has two seeds"


def test_rounding_is_no_difference() -> None:
    values = [3.0 + i for i in range(10)]
    one = compare(runs(*values), runs(*(value * (1 + 1e-13) for value in values)))
    assert (one.median, one.won, one.p) == (0.0, 0.5, 1.0)


@given(st.lists(st.tuples(VALUES, VALUES), min_size=2, max_size=9), st.randoms(use_true_random=False))
@settings(max_examples=50, deadline=None)
def test_laws_of_the_comparison(pairs: list[tuple[float, float]], random: object) -> None:
    """Swapping changes signs, scaling scales, the order of runs changes nothing."""
    own, other = (runs(*column) for column in zip(*pairs, strict=True))
    one, swapped = compare(own, other), compare(other, own)
    expected = (-one.median, -one.high, -one.low, 1 - one.won, one.p)
    swapped_figures = (swapped.median, swapped.low, swapped.high, swapped.won, swapped.p)
    assert swapped_figures == pytest.approx(expected, nan_ok=True)
    doubled = compare({key: 2 * v for key, v in own.items()}, {key: 2 * v for key, v in other.items()})
    assert doubled._replace(median=0, low=0, high=0) == pytest.approx(
        one._replace(median=0, low=0, high=0), nan_ok=True
    )
    assert (doubled.median, doubled.low) == pytest.approx((2 * one.median, 2 * one.low), nan_ok=True)
    shuffled = list(own.items())
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    assert compare(dict(shuffled), other) == pytest.approx(one, nan_ok=True)


@given(st.integers(1, 6).flatmap(lambda n: st.tuples(st.just(n), st.sets(st.sampled_from([
    (a, b) for a in range(n) for b in range(a + 1, n)] or [(0, 1)])))))  # fmt: skip
@settings(max_examples=80, deadline=None)
def test_groups_are_all_largest_sets_without_a_pair_that_is_told_apart(
    drawn: tuple[int, set[tuple[int, int]]],
) -> None:
    n, pairs = drawn
    names = "abcdef"[:n]
    apart = {(names[a], names[b]) for a, b in pairs if b < n}
    sets = [set(c) for size in range(1, n + 1) for c in combinations(names, size)]
    alike = [one for one in sets if not any({a, b} <= one for a, b in apart)]
    largest = [one for one in alike if not any(one < other for other in alike)]
    found = groups(names, apart)
    assert sorted(map(sorted, found)) == sorted(map(sorted, largest))
    assert list(found) == sorted(found)


def test_controllers_compared_each_with_each() -> None:
    noise = np.random.default_rng(0).normal(size=(3, 12))
    found = compare_all({
        "worst": runs(*(9.0 + noise[0])), "a": runs(*(1.0 + noise[1])), "b": runs(*(1.01 + noise[1] * 1.1)),
        "failing": runs(*[NAN] * 12),
    })  # fmt: skip
    assert set(found.order) == {"a", "b", "worst"}
    assert found.order[-1] == "worst"
    assert found.tests == 3
    assert [set(group) for group in found.groups] == [{"a", "b"}, {"worst"}]
    assert found.letters == {"a": "a", "b": "a", "worst": "b"}
    # All twelve signs alike are one of 2048 cases on either side.
    assert found.differences["a", "worst"].corrected == pytest.approx(3 / 2048)
    assert compare_all({"low": runs(1.0), "high": runs(2.0)}, "high").order == ("high", "low")
    assert Comparisons((), {}).groups == ()


def test_so_many_seeds_are_needed() -> None:
    """Ahead on each of n seeds, p is 2^(1-n), times the number of comparisons."""
    for count in range(2, 15):
        noise = np.random.default_rng(count).normal(size=(count, 4))
        found = compare_all({str(i): runs(*own) for i, own in enumerate(noise)})
        n, tests = found.seeds_needed, found.tests
        assert tests == count * (count - 1) / 2
        assert tests * 2.0 ** (1 - n) <= 0.05 < tests * 2.0 ** (2 - n)


def test_the_table_of_a_study() -> None:
    base = [float(i) for i in range(10)]
    gone = [NAN] * 10  # which is a row all the same
    frame = table(base=base, better=[v - 1 - v / 99 for v in base], failing=[*base[:4], *gone[4:]], gone=gone)
    second = frame[~frame.controller.isin(["failing", "gone"])].assign(problem="q")
    found = compare_frame(pd.concat([frame, second]), "rmse.y [m]", "base").set_index(
        ["problem", "controller"]
    )
    of_p, of_q = ("base", "better", "failing", "gone"), ("base", "better")
    assert [*found.index] == [*(("p", name) for name in of_p), *(("q", name) for name in of_q)]
    assert found.loc[("p", "gone")][["runs", "known", "pairs", "only_other"]].tolist() == [10, 0, 0, 10]
    better, failing = found.loc[("p", "better")], found.loc[("p", "failing")]
    counts = [failing[key] for key in ("runs", "failed", "known", "only_other", "pairs")]
    assert counts == [10, 6, 4, 6, 4]
    assert (better.won, better.p, better.corrected) == (1.0, 2 / 1024, 4 / 1024)
    assert better.told_apart
    assert better.difference == pytest.approx(np.median([-1 - v / 99 for v in base]))
    assert better.difference_low <= better.difference <= better.difference_high < 0
    assert found.loc[("q", "better")].corrected == 2 / 1024, "one problem changes nothing of another"
    assert found.loc[("p", "base")][["median", "lower", "upper"]].tolist() == [4.5, 2.25, 6.75]
    assert math.isnan(found.loc[("p", "base")].difference)


def test_the_order_of_the_rows_changes_nothing() -> None:
    rng = np.random.default_rng(1)
    frame = table(a=[*rng.normal(size=9)], b=[*rng.normal(size=9)])
    first = compare_frame(frame, "rmse.y [m]", "b")
    again = compare_frame(frame.iloc[::-1], "rmse.y [m]", "b").iloc[::-1].reset_index(drop=True)
    pd.testing.assert_frame_equal(first, again)


def test_a_frame_that_cannot_be_compared_is_refused() -> None:
    frame = table(deepc=[1.0], wkpc=[2.0])
    with pytest.raises(ConfigError, match=r'metric "rmse.y \[n\]": .* did you mean "rmse.y \[m\]"'):
        compare_frame(frame, "rmse.y [n]", "wkpc")
    with pytest.raises(ConfigError, match=r'"wkcp": not in problem "p"; did you mean "wkpc"'):
        compare_frame(frame, "rmse.y [m]", "wkcp")
    with pytest.raises(ConfigError, match=r"same run: problem p, controller deepc, .*seed 0"):
        compare_frame(pd.concat([frame, frame]), "rmse.y [m]", "wkpc")
