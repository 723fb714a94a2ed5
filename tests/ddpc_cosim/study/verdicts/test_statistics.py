"""Statistics within a problem, against enumeration, published examples and laws."""

import math
import runpy
from itertools import combinations, combinations_with_replacement, product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from ddpc_cosim import ConfigError
from ddpc_cosim.study.verdicts.statistics import (
    Comparisons,
    Runs,
    _turned,
    compare,
    compare_all,
    compare_frame,
    describe,
    groups,
    interactions,
    max_t,
    median_interval,
    step_down,
)

NAN = math.nan
DOCS = Path(__file__).parents[4] / "docs"
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
    described = describe(runs(4.0, NAN, 1.0, 2.0, 3.0))
    assert described[:6] == (5, 4, 4, 2.5, 1.75, 3.25)
    assert math.isnan(described.low)
    assert math.isnan(described.high)


def test_where_every_run_failed_there_are_no_figures() -> None:
    described = describe(runs(NAN, NAN))
    assert described[:3] == (2, 0, 0)
    assert all(map(math.isnan, described[3:]))


def test_scenarios_do_not_multiply_the_seeds() -> None:
    """Each seed counts once, with the median of its runs: 2 and 5."""
    three = {(scenario, 0): value for scenario, value in zip("abc", (1.0, 2.0, 9.0), strict=True)}
    described = describe({**three, ("a", 1): 4.0, ("b", 1): 6.0, ("c", 1): NAN})
    assert described[:4] == (6, 5, 2, 3.5)


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
    for n in (400, 401, 4000, 100_000):
        low, high = median_interval(np.arange(n) / (n - 1))
        assert low == pytest.approx(0.5 - 0.98 / math.sqrt(n), abs=2 / n)
        assert low + high == pytest.approx(1)


def test_signs_of_many_values_are_drawn_as_those_of_few_and_take_a_bit_each() -> None:
    drawn = np.random.default_rng(0).integers(0, 2, (1000, 29))
    turned = np.unpackbits(_turned(30, 999), axis=1, count=30)
    assert (turned[1:, 1:] == drawn[1:]).all()
    assert not turned[:, 0].any()
    assert not turned[0].any()
    assert _turned(100_000, 9).nbytes == 125_000


def test_of_a_hundred_thousand_values_a_shift_is_told_from_none() -> None:
    """The p of a mean is about that of the normal law, by 999 flips."""
    noise = np.random.default_rng(3).normal(size=100_000)
    noise -= noise.mean()
    for sigmas, p in ((2.0, 0.0455), (0.5, 0.617)):
        shifted = noise + sigmas / math.sqrt(noise.size)
        assert step_down(shifted[None], np.array([[0, 1]]))[0] == pytest.approx(p, abs=0.06)


def test_fewer_than_six_values_have_no_interval_and_equal_ones_have_none_to_either_side() -> None:
    assert all(map(math.isnan, median_interval(np.arange(5.0))))
    assert median_interval(np.full(6, 3.0)) == (3.0, 3.0)
    assert median_interval(np.full(7, 3.0)) == (3.0, 3.0)


def plain_step_down(rows: list[list[float]], pairs: list[tuple[int, int]]) -> list[float]:
    """Return the p-values of Westfall and Young, written out, over all flips of signs."""
    n = len(rows[0])

    def mean(values: list[float]) -> float:
        return math.fsum(values) / len(values)

    spread = [math.sqrt(max(mean([v * v for v in row]) - mean([*map(abs, row)]) ** 2, 0)) for row in rows]
    size = [math.sqrt(mean([v * v for v in row])) for row in rows]
    medians = {}
    for name in {controller for pair in pairs for controller in pair}:
        of_one = sorted(spread[i] for i, pair in enumerate(pairs) if name in pair)
        medians[name] = of_one[(len(of_one) - 1) // 2]
    scale = [
        max(min(math.hypot(medians[a], medians[b]), 0.7 * size[i]), 1e-9 * size[i]) or 1.0
        for i, (a, b) in enumerate(pairs)
    ]

    def statistics(signs: tuple[int, ...]) -> list[float]:
        return [
            abs(mean([sign * value for sign, value in zip(signs, row, strict=True)])) / scale[i]
            for i, row in enumerate(rows)
        ]

    flipped = [statistics(signs) for signs in product([1, -1], repeat=n)]
    seen = statistics((1,) * n)
    p, largest, left = [0.0] * len(rows), 0.0, set(range(len(rows)))
    for i in sorted(left, key=lambda i: -seen[i]):
        as_large = sum(max(flipped_row[j] for j in left) >= seen[i] - 1e-9 for flipped_row in flipped)
        p[i] = largest = max(largest, as_large / len(flipped))
        left.remove(i)
    return p


@given(
    st.integers(2, 4).flatmap(
        lambda k: st.integers(6, 7).flatmap(
            lambda n: st.lists(st.lists(st.integers(-6, 6), min_size=n, max_size=n), min_size=k, max_size=k)
        )
    ),
    st.sampled_from([1.0, 0.1, 1 / 3]),
)
@settings(max_examples=40, deadline=None)
def test_max_t_counts_all_flips_with_ties(values: list[list[int]], unit: float) -> None:
    """Whole numbers tie often; in units in which sums are rounded they are to tie all the same."""
    pairs = [*combinations(range(len(values)), 2)]
    rows = [[float(x - y) for x, y in zip(values[a], values[b], strict=True)] for a, b in pairs]
    scaled = [{seed: value * unit for seed, value in enumerate(row)} for row in rows]
    assert max_t(scaled, pairs) == pytest.approx(plain_step_down(rows, pairs), abs=1e-12)


def test_max_t_of_unequal_scales_recomputed() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(size=(5, 8)) * [[1], [1], [10], [100], [1]] + [[-3], [0], [0], [0], [2]]
    pairs = [*combinations(range(5), 2)]
    rows = [(values[a] - values[b]).tolist() for a, b in pairs]
    ps = max_t([dict(enumerate(row)) for row in rows], pairs)
    assert ps == pytest.approx(plain_step_down(rows, pairs), abs=1e-12)
    assert ps[pairs.index((0, 4))] == 2 / 256, "a controller that varies more robs the others of nothing"


def test_many_seeds_are_drawn_always_the_same_and_near_the_count() -> None:
    rng = np.random.default_rng(1)
    rows = rng.normal(0.35, 1.0, size=(3, 15))
    pairs = [(0, 1), (0, 2), (1, 2)]
    levels = [dict(enumerate(row)) for row in rows]
    exact = plain_step_down(rows.tolist(), pairs)
    drawn = max_t(levels, pairs)
    assert drawn == max_t(levels, pairs)
    assert drawn == pytest.approx(exact, abs=0.015)  # three standard errors of 9 999 draws


def test_five_seeds_have_no_p() -> None:
    assert all(map(math.isnan, max_t([dict.fromkeys(range(5), 1.0)], [("a", "b")])))
    assert max_t([dict.fromkeys(range(6), 1.0)], [("a", "b")]) == [2 / 64]
    assert max_t([], []) == []


def test_a_pair_of_few_seeds_is_not_tested_beside_one_of_many() -> None:
    few, many = dict.fromkeys(range(5), 1.0), {seed: 1.0 + seed for seed in range(8)}
    first, second = max_t([few, many], [("a", "b"), ("a", "c")])
    assert math.isnan(first)
    assert second == 2 / 256


def false_positives(seeds: int, levels: list[float], scales: list[float], studies: int) -> float:
    """Return the share of studies in which two of equal controllers are told apart, in percent."""
    rng = np.random.default_rng(7)
    pairs = np.array([*combinations(range(len(levels)), 2)])
    first, second = pairs.T
    equal = np.array(levels)[first] == np.array(levels)[second]
    noise = rng.normal(size=(studies, len(levels), seeds)) * np.array(scales)[:, None]
    values = noise + np.array(levels)[:, None]
    wrong = [(step_down(draw[first] - draw[second], pairs)[equal] <= 0.05).any() for draw in values]
    return 100 * float(np.mean(wrong))


@pytest.mark.parametrize("seeds", [6, 8, 20])
@pytest.mark.parametrize(
    ("levels", "scales"),
    [([0, 0, 0, 0], [1, 1, 30, 1000]), ([-2, 0, 0, 1.5], [1, 1, 10, 3])],
    ids=["none differs", "some differ"],
)
def test_equal_controllers_are_told_apart_in_no_more_than_6_percent_of_studies(
    monkeypatch: pytest.MonkeyPatch, seeds: int, levels: list[float], scales: list[float]
) -> None:
    monkeypatch.setattr("ddpc_cosim.study.verdicts.statistics._DRAWS", 999)
    assert false_positives(seeds, levels, scales, studies=2000) <= 6.0


def test_the_table_of_power_is_that_of_its_script() -> None:
    """The rows of 6 and 8 seeds of docs/statistics.md, of fewer studies than there."""
    script = runpy.run_path(str(DOCS / "scripts" / "simulate_power.py"))
    page = (DOCS / "statistics.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines()]
    table = {(row[0], row[1]): row[2:] for row in rows if len(row) == 6}
    for seeds in (6, 8):
        for scene in script["SCENES"]:
            powers = script["power"](scene, seeds, studies=60)
            stated = [float(cell) for cell in table[scene, str(seeds)]]
            # Of one study a share of 13 pairs that hang together: its standard deviation is 50 % at most.
            assert [*powers.values()] == pytest.approx(stated, abs=3 * 50 / math.sqrt(60))


def test_two_controllers_compared() -> None:
    """The own run failed on seed 5, the other's on seed 6; seed 7 the other has not run."""
    first = runs(1.0, 2.0, 3.0, 4.0, 5.0, NAN, 1.0, 1.0)
    other = runs(2.0, 1.0, 5.0, 4.0, 9.0, 1.0, NAN)
    comparison = compare(first, other)
    assert (comparison.pairs, comparison.seeds, comparison.only_own, comparison.only_other) == (5, 5, 1, 1)
    assert (comparison.median, comparison.won, comparison.constant) == (-1.0, 3.5 / 5, False)
    assert comparison.mean == pytest.approx(-6 / 5)
    assert math.isnan(comparison.p), "with failed runs it is in no family of tests"
    assert not comparison.tested
    assert compare(first, other, "high").won == pytest.approx(1.5 / 5)
    assert math.isnan(compare(first, other, "").won)


def test_a_difference_without_pairs_is_not_known() -> None:
    comparison = compare(runs(NAN, 1.0), runs(2.0, NAN))
    assert (comparison.pairs, comparison.only_own, comparison.only_other, comparison.constant) == (
        0,
        1,
        1,
        False,
    )
    assert all(map(math.isnan, (comparison.median, comparison.low, comparison.won, comparison.p)))
    assert not comparison.told_apart


def test_what_the_seed_does_not_change_is_known_and_not_tested() -> None:
    comparison = compare(runs(1.0, 1.0, 1.0), runs(2.0, 2.0, 2.0))
    assert comparison.constant
    assert math.isnan(comparison.p)
    assert comparison.told_apart
    assert not compare(runs(1.0, 1.0, 1.0), runs(1.0, 1.0, 1.0 + 1e-12)).told_apart
    assert not compare(runs(1.0), runs(2.0)).constant, "one seed does not show whether it changes anything"
    varied = {("a", 0): 1.0, ("b", 1): 1.0}
    assert not compare(varied, varied).constant, "no condition has two seeds"


def test_rounding_is_no_difference() -> None:
    values = [3.0 + i for i in range(10)]
    comparison = compare(runs(*values), runs(*(value * (1 + 1e-13) for value in values)))
    assert (comparison.median, comparison.won, comparison.p) == (0.0, 0.5, 1.0)


def test_a_mean_against_the_median_tells_nobody_apart() -> None:
    """Six seeds far below 0, and eight above it by little: most seeds say what the mean does not."""
    first = runs(*([1.0] * 6 + [5.0] * 8))
    (comparison,) = compare_all(
        {"a": first, "b": runs(*([9.0 + i / 9 for i in range(6)] + [4.9] * 8))}
    ).differences.values()
    assert comparison.corrected <= 0.05
    assert comparison.mean * comparison.median < 0
    assert not comparison.told_apart


@given(st.lists(st.tuples(VALUES, VALUES), min_size=2, max_size=8), st.randoms(use_true_random=False))
@settings(max_examples=50, deadline=None)
def test_laws_of_the_comparison(pairs: list[tuple[float, float]], random: object) -> None:
    """Swapping changes signs, scaling scales, the order of runs changes nothing."""
    first, other = (runs(*column) for column in zip(*pairs, strict=True))
    comparison, swapped = compare(first, other), compare(other, first)
    expected = (-comparison.median, -comparison.high, -comparison.low, 1 - comparison.won, comparison.p)
    swapped_figures = (swapped.median, swapped.low, swapped.high, swapped.won, swapped.p)
    assert swapped_figures == pytest.approx(expected, nan_ok=True)
    doubled = compare({key: 2 * v for key, v in first.items()}, {key: 2 * v for key, v in other.items()})
    assert doubled._replace(mean=0, median=0, low=0, high=0) == pytest.approx(
        comparison._replace(mean=0, median=0, low=0, high=0), nan_ok=True
    )
    assert (doubled.median, doubled.low) == pytest.approx(
        (2 * comparison.median, 2 * comparison.low), nan_ok=True
    )
    shuffled = list(first.items())
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    assert compare(dict(shuffled), other) == pytest.approx(comparison, nan_ok=True)


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
    alike = [subset for subset in sets if not any({a, b} <= subset for a, b in apart)]
    largest = [candidate for candidate in alike if not any(candidate < other for other in alike)]
    largest_groups = groups(names, apart)
    assert sorted(map(sorted, largest_groups)) == sorted(map(sorted, largest))
    assert list(largest_groups) == sorted(largest_groups)


def test_controllers_compared_each_with_each() -> None:
    noise = np.random.default_rng(0).normal(size=(3, 12))
    comparison = compare_all({
        "worst": runs(*(9.0 + noise[0])), "a": runs(*(1.0 + noise[1])), "b": runs(*(1.01 + noise[1] * 1.1)),
        "failing": runs(*[NAN] * 12),
    })  # fmt: skip
    assert set(comparison.order) == {"a", "b", "worst"}
    assert comparison.order[-1] == "worst"
    assert comparison.tests == 3
    assert [set(group) for group in comparison.groups] == [{"a", "b"}, {"worst"}]
    assert comparison.letters == {"a": "a", "b": "a", "worst": "b"}
    # All twelve signs alike are one of 4096 cases on either side, of however many pairs.
    assert comparison.differences["a", "worst"].corrected == 2 / 4096
    assert compare_all({"low": runs(1.0), "high": runs(2.0)}, "high").order == ("high", "low")
    assert Comparisons((), {}).groups == ()


def test_six_seeds_are_needed_of_however_many_controllers() -> None:
    """Ahead on each of n seeds, p is 2^(1-n): of five seeds above 5 %, of six below."""
    for seeds in (5, 6):
        levels = {
            f"c{i}": runs(*(100.0 * i + np.random.default_rng(i).normal(size=seeds))) for i in range(14)
        }
        comparison = compare_all(levels)
        assert comparison.tests == 91
        assert (comparison.seeds_needed, comparison.too_few_seeds) == (6, seeds < 6)
        assert all(difference.told_apart == (seeds == 6) for difference in comparison.differences.values())


def test_who_is_constant_or_fails_runs_is_in_no_family() -> None:
    rng = np.random.default_rng(2)
    levels = {"a": runs(*rng.normal(size=8)), "b": runs(*(9 + rng.normal(size=8)))}
    alone = compare_all(levels).differences["a", "b"]
    more = levels | {
        "flat": runs(*[5.0] * 8),
        "flat too": runs(*[6.0] * 8),
        "fails": runs(NAN, *rng.normal(size=7)),
    }
    comparison = compare_all(more)
    assert comparison.tests == 5
    assert comparison.differences["a", "b"].corrected == alone.corrected
    assert comparison.differences["flat", "flat too"].told_apart
    assert math.isnan(comparison.differences["flat", "flat too"].corrected)
    failing = [difference for pair, difference in comparison.differences.items() if "fails" in pair]
    assert all(math.isnan(difference.corrected) and not difference.tested for difference in failing)


def two_scenarios(first: float, second: float) -> dict[str, Runs]:
    """Return runs of two controllers that differ by so much in two scenarios."""
    rng = np.random.default_rng(4)
    return {
        name: {
            (scenario, seed): level + 0.1 * float(rng.normal())
            for scenario, level in (("x", 1 + first * place), ("y", 5 + second * place))
            for seed in range(8)
        }
        for place, name in enumerate("ab")
    }


def test_interactions_are_differences_of_differences() -> None:
    levels = two_scenarios(1.0, -1.0)
    (interaction,) = interactions(levels)
    values = [
        levels["a"]["x", seed] - levels["b"]["x", seed] - levels["a"]["y", seed] + levels["b"]["y", seed]
        for seed in range(8)
    ]
    assert (interaction.pair, interaction.conditions, interaction.constant) == (("a", "b"), ("x", "y"), False)
    assert interaction.median == pytest.approx(np.median(values))
    assert interaction.corrected == 2 / 256
    assert interaction.is_significant
    (alike,) = interactions(two_scenarios(1.0, 1.0))
    assert not alike.is_significant


def test_interactions_of_what_the_seed_does_not_change_are_known() -> None:
    levels = {
        name: {(scenario, seed): value for scenario, value in of.items() for seed in range(2)}
        for name, of in {"a": {"x": 1.0, "y": 2.0}, "b": {"x": 2.0, "y": 1.0}, "c": {"x": 1.0}}.items()
    }
    (interaction,) = interactions(levels)
    assert (interaction.median, interaction.constant, interaction.is_significant) == (-2.0, True, True)


def test_the_table_of_a_study() -> None:
    base = [float(i) for i in range(10)]
    gone = [NAN] * 10  # which is a row all the same
    frame = table(base=base, better=[v - 1 - v / 99 for v in base], failing=[*base[:4], *gone[4:]], gone=gone)
    second = frame[~frame.controller.isin(["failing", "gone"])].assign(problem="q")
    compared = compare_frame(pd.concat([frame, second]), "rmse.y [m]", "base").set_index(
        ["problem", "controller"]
    )
    of_p, of_q = ("base", "better", "failing", "gone"), ("base", "better")
    assert [*compared.index] == [*(("p", name) for name in of_p), *(("q", name) for name in of_q)]
    assert compared.loc[("p", "gone")][["runs", "known", "pairs", "only_other"]].tolist() == [10, 0, 0, 10]
    better, failing = compared.loc[("p", "better")], compared.loc[("p", "failing")]
    counts = [failing[key] for key in ("runs", "failed", "known", "only_other", "pairs")]
    assert counts == [10, 6, 4, 6, 4]
    assert (better.won, better.p, better.corrected) == (1.0, 2 / 1024, 2 / 1024)
    assert math.isnan(failing.corrected), "with failed runs it is in no family of tests"
    assert better.told_apart
    assert better.difference == pytest.approx(np.median([-1 - v / 99 for v in base]))
    assert better.difference_low <= better.difference <= better.difference_high < 0
    assert compared.loc[("q", "better")].corrected == 2 / 1024, "one problem changes nothing of another"
    assert compared.loc[("p", "base")][["median", "lower", "upper"]].tolist() == [4.5, 2.25, 6.75]
    assert math.isnan(compared.loc[("p", "base")].difference)


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
