"""Distributions of parameters: their quantiles are SciPy's, and what seeds draw follows them."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import stats

from ddpc_cosim import ConfigError, Distribution, LogNormal, Normal, Triangular, Uniform
from ddpc_cosim.codec import read, write
from ddpc_cosim.distributions import DISTRIBUTIONS, Sampling, shares

SHARES = np.array([1e-9, 0.001, 0.025, 0.3, 0.5, 0.84, 0.999, 1 - 1e-9])
SAMPLINGS: tuple[Sampling, ...] = ("independent", "latin-hypercube", "sobol")
SEEDS = tuple(range(1000))
LOG = math.log(1.5)
PAIRS: list[tuple[Distribution, Any]] = [
    (Normal(1.0, 0.1), stats.norm(1.0, 0.1)),
    (Normal(1.0, 0.1, low=0.9), stats.truncnorm(-1.0, np.inf, 1.0, 0.1)),
    (Normal(1.0, 0.1, low=1.2, high=1.3), stats.truncnorm(2.0, 3.0, 1.0, 0.1)),
    (LogNormal(0.4, 1.5), stats.lognorm(LOG, scale=0.4)),
    (Uniform(-2.0, 3.0), stats.uniform(-2.0, 5.0)),
    (Triangular(1.0, 1.5, 4.0), stats.triang(0.5 / 3.0, 1.0, 3.0)),
    (Triangular(1.0, 1.0, 4.0), stats.triang(0.0, 1.0, 3.0)),
    (Triangular(1.0, 4.0, 4.0), stats.triang(1.0, 1.0, 3.0)),
]


@pytest.mark.parametrize(("distribution", "known"), PAIRS, ids=lambda pair: repr(pair)[:40])
def test_quantiles_are_those_of_scipy(distribution: Distribution, known: Any) -> None:
    assert distribution.quantile(SHARES) == pytest.approx(known.ppf(SHARES), rel=1e-9)
    assert distribution.support == pytest.approx(known.support())


def test_a_log_normal_distribution_that_is_cut_off_is_drawn_in_proportion() -> None:
    cut, whole = LogNormal(0.4, 1.5, low=0.3, high=0.8), stats.lognorm(LOG, scale=0.4)
    below, above = whole.cdf([0.3, 0.8])
    assert whole.cdf(cut.quantile(SHARES)) == pytest.approx(below + SHARES * (above - below), abs=1e-12)


@pytest.mark.parametrize("sampling", SAMPLINGS)
@pytest.mark.parametrize(("distribution", "known"), PAIRS, ids=lambda pair: repr(pair)[:40])
def test_what_seeds_draw_follows_the_distribution(
    distribution: Distribution, known: Any, sampling: Sampling
) -> None:
    drawn = distribution.quantile(shares(("mass", "radius"), sampling, SEEDS)[:, 0])
    assert stats.kstest(drawn, known.cdf).pvalue > 0.01


def test_independent_draws_are_independent() -> None:
    drawn = shares(("mass", "radius"), "independent", SEEDS)
    assert abs(stats.spearmanr(*drawn.T).statistic) < 3 / math.sqrt(len(SEEDS))
    assert abs(stats.spearmanr(drawn[1:, 0], drawn[:-1, 0]).statistic) < 3 / math.sqrt(len(SEEDS))


@pytest.mark.parametrize("sampling", ["independent", "sobol"])
@given(seeds=st.lists(st.integers(0, 200), min_size=1, unique=True))
def test_a_draw_depends_on_no_other_seed(sampling: Sampling, seeds: list[int]) -> None:
    every = shares(("mass", "radius"), sampling, tuple(range(201)))
    assert np.array_equal(shares(("mass", "radius"), sampling, tuple(seeds)), every[seeds])


def test_an_independent_draw_depends_on_no_other_parameter() -> None:
    for sampling in ("independent", "latin-hypercube"):
        alone = shares(("mass",), sampling, SEEDS)[:, 0]
        assert np.array_equal(shares(("damping", "mass"), sampling, SEEDS)[:, 1], alone)


def test_of_a_latin_hypercube_each_part_has_one_seed() -> None:
    for column in shares(("mass", "radius"), "latin-hypercube", tuple(range(3, 40))).T:
        assert sorted(np.floor(column * 37)) == list(range(37))


def test_points_of_the_sobol_sequence_lie_evenly() -> None:
    """Of 2^m points each elementary interval of volume 2^-m has one, a (0, m, 2)-net in base 2."""
    points = shares(("mass", "radius"), "sobol", tuple(range(64)))
    for power in range(7):
        cells = np.floor(points * [2**power, 2 ** (6 - power)])
        assert len({tuple(cell) for cell in cells}) == 64
    assert points.min() > 0
    assert points.max() < 1


DRAWN: st.SearchStrategy[Distribution] = st.one_of(
    st.builds(Normal, st.floats(-1e3, 1e3), st.floats(1e-3, 1e3)),
    st.builds(
        lambda low, wide: Normal(low, wide, low=low, high=low + wide), st.floats(-9, 9), st.floats(0.1, 9)
    ),
    st.builds(LogNormal, st.floats(1e-3, 1e3), st.floats(1.01, 9)),
    st.builds(lambda low, wide: Uniform(low, low + wide), st.floats(-9, 9), st.floats(0.1, 9)),
    st.builds(
        lambda low, wide, share: Triangular(low, low + share * wide, low + wide),
        *(st.floats(-9, 9), st.floats(0.1, 9), st.floats(0, 0.9)),
    ),
)


@given(distribution=DRAWN, at=st.lists(st.floats(1e-12, 1 - 1e-12), min_size=2))
def test_quantiles_rise_within_the_support(distribution: Distribution, at: list[float]) -> None:
    values = distribution.quantile(np.sort(at))
    low, high = distribution.support
    wide = 1e-12 * (1 + abs(values).max())
    assert (np.diff(values) >= -wide).all()
    assert values[0] >= low - wide
    assert values[-1] <= high + wide


@given(distribution=DRAWN)
def test_a_distribution_is_written_and_read_as_itself(distribution: Distribution) -> None:
    table = write(distribution)
    assert DISTRIBUTIONS[table.pop("distribution")] is type(distribution)
    assert read(type(distribution), table) == distribution


@pytest.mark.parametrize(
    ("make", "fault"),
    [
        (lambda: Normal(1.0, -0.1), "deviation = -0.1 is not possible; allowed: a number, > 0"),
        (lambda: Normal(1.0, 0.1, low=2.0, high=1.0), "low = 2 must be less than high = 1"),
        (lambda: Normal(1.0, 0.1, low=5.0), "less than 1e-06 of it lies from 5 to inf"),
        (lambda: LogNormal(0.0, 1.5), "median = 0.0 is not possible"),
        (lambda: LogNormal(1.0, 1.0), "factor = 1.0 is not possible"),
        (lambda: LogNormal(1.0, 1.5, high=-1.0), "less than 1e-06 of it lies from 0 to -1"),
        (lambda: Uniform(1.0, 1.0), "low = 1 must be less than high = 1"),
        (lambda: Uniform("a", 1.0), "low = 'a' is not possible"),  # type: ignore[arg-type]
        (lambda: Normal(1.0, 0.1, high="b"), "high = 'b' is not possible"),  # type: ignore[arg-type]
        (lambda: Triangular(0.0, 2.0, 1.0), "mode = 2 must be from low = 0 to high = 1"),
    ],
)
def test_what_is_not_possible_is_said(make: Callable[[], Distribution], fault: str) -> None:
    with pytest.raises(ConfigError) as error:
        make()
    assert fault in str(error.value)
