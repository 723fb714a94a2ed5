"""How often controllers fail: exact intervals by sums of binomial probabilities, tails by counting."""

import math
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.stats import binomtest, spearmanr

from ddpc_cosim import CaseResult, Outcome
from ddpc_cosim.study.case_files import DOING_NOTHING
from ddpc_cosim.study.file_format.sections import Study
from ddpc_cosim.study.problems import WholeStudy
from ddpc_cosim.study.verdicts.reliability import (
    QUANTILES,
    Reliability,
    failure_rate,
    rate_of,
    reliability,
    seeds_needed,
)
from ddpc_cosim.study.verdicts.sentences import rate_words

KEY = "mean_abs_error.y [1]"
MASS, LENGTH = "mass [kg]", "length [m]"


def study(**others: object) -> Study:
    tables = {
        "plant": {"name": "pendulum"},
        "loop": {"sampling_time": 0.1, "duration": 1.0},
        "reference": {"angle": {"kind": "constant", "value": 0.0}},
        "controllers": {"one": {"type": "pid"}, "two": {"type": "pid"}},
    }
    return next(iter(WholeStudy.of_tables(tables | others).problems.values()))


def case(
    seed: int, value: float = 1.0, *, controller: str = "one", scenario: str = "nominal", **more: object
) -> CaseResult:
    given: dict[str, object] = {"failed": False, "drawn": {}} | more
    return CaseResult(
        f"{controller}_{seed}",
        controller,
        controller,
        scenario,
        seed,
        Outcome.COMPLETED,
        "",
        (),
        {KEY: value},
        {},
        {},
        (),
        Path(),
        **given,  # type: ignore[arg-type]
    )


def at_most(count: int, of: int, share: Fraction) -> Fraction:
    """Return the probability of so many or fewer, exactly."""
    return sum((math.comb(of, k) * share**k * (1 - share) ** (of - k) for k in range(count + 1)), Fraction(0))


@given(counts=st.integers(1, 60).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_interval_ends_where_what_was_seen_has_a_probability_of_a_fortieth(
    counts: tuple[int, int],
) -> None:
    failed, seeds = counts
    rate, fortieth = rate_of(failed, seeds), Fraction(1, 40)
    if failed < seeds:
        assert float(at_most(failed, seeds, Fraction(rate.high))) == pytest.approx(float(fortieth), rel=1e-8)
    if failed:
        more = 1 - at_most(failed - 1, seeds, Fraction(rate.low))
        assert float(more) == pytest.approx(float(fortieth), rel=1e-8)
    assert (rate.low == 0.0, rate.high == 1.0) == (failed == 0, failed == seeds)
    assert rate.low <= rate.share <= rate.high


@pytest.mark.parametrize(("failed", "seeds"), [(0, 20), (3, 200), (200, 200), (17, 100_000)])
def test_the_interval_is_that_of_scipy(failed: int, seeds: int) -> None:
    known = binomtest(failed, seeds).proportion_ci(method="exact")
    assert rate_of(failed, seeds)[2:] == pytest.approx((known.low, known.high), rel=1e-9)


def test_of_no_failure_the_bound_has_a_formula_which_the_rule_of_three_is_near() -> None:
    for seeds in (20, 200, 100_000):
        assert rate_of(0, seeds).high == pytest.approx(1 - 0.025 ** (1 / seeds), rel=1e-9)
        assert 3 / seeds < rate_of(0, seeds).high < 3.7 / seeds


def test_a_seed_fails_in_several_scenarios_once() -> None:
    runs = [case(seed, scenario=name, failed=seed < 2) for seed in range(9) for name in ("a", "b")]
    runs += [case(8, scenario="c", failed=True)]
    assert failure_rate(runs)[:2] == (3, 9)


def test_words_say_what_none_and_all_tell() -> None:
    assert rate_words(rate_of(0, 20)) == "none of 20 seeds (up to 17\u00a0%)"
    assert rate_words(rate_of(20, 20)) == "each of 20 seeds (from 83\u00a0% on)"
    assert rate_words(rate_of(3, 200)) == "3 of 200 seeds (1.5\u00a0%, from 0.31 to 4.3\u00a0%)"


def test_it_is_asked_of_twenty_seeds_or_of_plants_that_are_drawn() -> None:
    assert reliability(study(), [case(seed) for seed in range(19)]) == []
    assert len(reliability(study(), [case(seed) for seed in range(20)])) == 1
    assert len(reliability(study(), [case(seed, drawn={MASS: 1.0}) for seed in range(2)])) == 1


def test_who_does_not_compete_is_left_out() -> None:
    points = {"reference_points": {"zero": "one", "full": "two"}}
    runs = [case(seed, controller=name) for seed in range(20) for name in ("one", "two", "three")]
    assert [item.controller for item in reliability(study(report=points), runs)] == ["three"]
    assert DOING_NOTHING not in [item.controller for item in reliability(study(), runs)]


def single(values: list[float], failed: int = 0) -> Reliability:
    runs = [case(seed, value) for seed, value in enumerate(values)]
    runs += [case(len(values) + i, 0.0, failed=True) for i in range(failed)]
    (item,) = reliability(study(), runs)
    return item


@pytest.mark.parametrize("count", [20, 35, 36, 200, 367, 368])
def test_a_quantile_lies_between_two_runs_with_95_percent(count: int) -> None:
    quantiles = {q.share: q for q in single([float(i) for i in range(1, count + 1)]).quantiles(KEY)}
    assert set(quantiles) == {share for share in QUANTILES if share == 0.5 or count >= seeds_needed(share)}
    for share, quantile in quantiles.items():
        exact = Fraction(share).limit_denominator(1000)
        # Of runs 1, 2, ... the interval is the places: below the quantile are from low to high - 1 runs.
        beyond = at_most(int(quantile.low) - 1, count, exact)
        not_reached = 1 - at_most(int(quantile.high) - 1, count, exact)
        assert max(beyond, not_reached) <= Fraction(1, 40)
        assert at_most(int(quantile.low), count, exact) >= Fraction(1, 40)
        assert quantile.value == math.ceil(share * count)


def test_how_many_seeds_a_quantile_takes() -> None:
    """The worst run must be beyond it but for a fortieth of the time: share^n <= 1/40."""
    for share in (0.9, 0.99):
        assert seeds_needed(share) == math.ceil(math.log(1 / 40) / math.log(share))


def test_failed_runs_are_worse_than_any_value() -> None:
    item = single([float(i) for i in range(90)], failed=10)
    last = item.quantiles(KEY)[-1]
    assert (last.share, last.value) == (0.9, 89.0)
    assert math.isinf(last.high)
    assert item.tail(KEY)[-1] == (89.0, 11 / 100)


def test_the_tail_counts_runs() -> None:
    values = np.random.default_rng(0).lognormal(size=500)
    tail = single(list(values), failed=3).tail(KEY)
    assert len(tail) < 200
    for value, share in tail:
        assert share == ((values >= value).sum() + 3) / 503
    assert tail[0][1] == 1.0
    assert [share for _, share in tail[-5:]] == [k / 503 for k in (8, 7, 6, 5, 4)]


def associations(failing: bool) -> dict[tuple[str, str], tuple[float, bool]]:
    """Return what goes with what where errors grow with the mass, and heavy plants fail if asked."""
    rng = np.random.default_rng(1)
    mass, length, noise = rng.normal(size=(3, 300))
    runs = [
        case(
            i,
            float(np.exp(m + 0.5 * e)),
            failed=failing and m > 1.5,
            drawn={MASS: float(m), LENGTH: float(long)},
        )
        for i, (m, long, e) in enumerate(zip(mass, length, noise, strict=True))
    ]
    (item,) = reliability(study(), runs)
    return {(a.parameter, a.key): (a.size, a.stands_out) for a in item.associations}


def test_what_goes_with_errors_stands_out_and_what_does_not_does_not() -> None:
    found = associations(failing=False)
    assert set(found) == {(MASS, KEY), (LENGTH, KEY)}
    rng = np.random.default_rng(1)
    mass, _, noise = rng.normal(size=(3, 300))
    assert found[MASS, KEY] == (pytest.approx(spearmanr(mass, mass + 0.5 * noise).statistic), True)
    assert not found[LENGTH, KEY][1]


def test_what_goes_with_failures_is_told_in_standard_deviations() -> None:
    found = associations(failing=True)
    mass = np.random.default_rng(1).normal(size=(3, 300))[0]
    bad, good = mass[mass > 1.5], mass[mass <= 1.5]
    pooled = ((bad.size - 1) * bad.var(ddof=1) + (good.size - 1) * good.var(ddof=1)) / (mass.size - 2)
    assert found[MASS, ""] == (pytest.approx((bad.mean() - good.mean()) / math.sqrt(pooled)), True)
    assert not found[LENGTH, ""][1]


def test_of_parameters_that_go_with_nothing_few_stand_out() -> None:
    """All intervals of a problem hold together with 95 %: of 100 problems about five have a false one."""
    rng, false = np.random.default_rng(2), 0
    for _ in range(100):
        mass, length, value = rng.normal(size=(3, 40))
        runs = [
            case(i, float(np.exp(v)), drawn={MASS: float(m), LENGTH: float(long)})
            for i, (m, long, v) in enumerate(zip(mass, length, value, strict=True))
        ]
        (item,) = reliability(study(), runs)
        false += any(association.stands_out for association in item.associations)
    assert false <= 11  # more has a probability of one in a hundred
