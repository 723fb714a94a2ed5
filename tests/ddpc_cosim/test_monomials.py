"""Monomials of states, against products that are written out."""

from math import comb, prod

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ddpc_cosim import Monomials

STATES = st.lists(st.lists(st.floats(-10.0, 10.0), min_size=3, max_size=3), min_size=1, max_size=5)
FACTORS = st.lists(st.lists(st.integers(0, 2), max_size=4), max_size=6)


@given(STATES, FACTORS)
def test_each_is_the_product_of_its_factors(states: list[list[float]], factors: list[list[int]]) -> None:
    values = Monomials(factors)(np.array(states))
    expected = [[prod(state[i] for i in chosen) for chosen in factors] for state in states]
    assert values.shape == (len(states), len(factors))
    assert values == pytest.approx(np.array(expected).reshape(values.shape), rel=1e-12)


@given(st.integers(1, 5), st.integers(0, 3), st.integers(0, 3))
def test_all_of_some_degrees_are_there_once_and_in_order(size: int, lowest: int, more: int) -> None:
    factors = Monomials.between(size, lowest, lowest + more).factors
    degrees = [len(chosen) for chosen in factors]
    assert len({tuple(sorted(chosen)) for chosen in factors}) == len(factors)
    assert degrees == sorted(degrees)
    for degree in range(lowest, lowest + more + 1):
        assert degrees.count(degree) == comb(size + degree - 1, degree)
