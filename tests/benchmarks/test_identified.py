"""Kendall's tau-b between two orders of controllers, against SciPy's."""

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.stats import kendalltau, somersd

from benchmarks.identified import tau_b


def signs(first: list[int], second: list[int]) -> list[tuple[int, int]]:
    """Return how every pair is ordered in both."""
    return [
        (int(np.sign(first[j] - first[i])), int(np.sign(second[j] - second[i])))
        for i, j in combinations(range(len(first)), 2)
    ]


@given(first=st.permutations(range(8)), second=st.lists(st.integers(0, 5), min_size=8, max_size=8))
def test_where_the_first_has_no_ties_it_is_the_tau_b_of_scipy(first: list[int], second: list[int]) -> None:
    expected = kendalltau(first, second).statistic
    assert tau_b(signs(first, second)) == pytest.approx(expected, nan_ok=True)


@given(first=st.lists(st.integers(0, 5), min_size=8, max_size=8), second=st.permutations(range(8)))
def test_ties_of_the_first_do_not_count(first: list[int], second: list[int]) -> None:
    """Somers' D is of the pairs that are not tied in its first argument."""
    if len({*first}) > 1:
        assert tau_b(signs(first, second)) == pytest.approx(somersd(first, second).statistic)
    else:
        assert math.isnan(tau_b(signs(first, second)))
