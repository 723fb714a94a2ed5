"""Step responses are told apart by what they are; the formulas are those of elementary systems."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ddpc_cosim.suggestion.response_types import ResponseType, classify, sample_counts

FIRST, BLOCKS = 1e-3, 14
TIME = np.cumsum(sample_counts(BLOCKS)) * FIRST

lags = st.floats(FIRST * 20, TIME[-1] / 10)
gains = st.floats(1e-3, 1e6).flatmap(lambda size: st.sampled_from([size, -size]))


@given(gain=gains, lag=lags)
def test_a_first_order_lag_settles_after_three_time_constants(gain: float, lag: float) -> None:
    response = classify(TIME, gain * (1 - np.exp(-TIME / lag)), level=0.0)
    assert response.type is ResponseType.SETTLED
    assert response.effect == pytest.approx(gain, rel=1e-2)
    assert response.rise_time == pytest.approx(lag, rel=0.1)
    assert response.settling_time == pytest.approx(3 * lag, rel=0.1)
    assert not response.is_transient


@given(gain=gains, lag=lags)
def test_a_lagged_differentiator_is_a_transient(gain: float, lag: float) -> None:
    response = classify(TIME, gain * 2 * TIME / lag * np.exp(-2 * TIME / lag), level=0.0)
    assert response.type is ResponseType.SETTLED
    assert response.is_transient


@given(gain=gains, lag=lags)
def test_an_integrator_behind_a_lag(gain: float, lag: float) -> None:
    response = classify(TIME, gain * (TIME - lag * (1 - np.exp(-TIME / lag))), level=0.0)
    assert response.type is ResponseType.INTEGRATING
    assert response.slope == pytest.approx(gain, rel=0.05)
    assert response.rise_time == pytest.approx(lag, rel=0.2, abs=0.01 * TIME[-1])


@given(gain=gains)
def test_two_integrators_run_away_without_a_time_scale(gain: float) -> None:
    response = classify(TIME, gain * TIME**2, level=0.0)
    assert response.type is ResponseType.ACCELERATING
    assert response.rise_time == np.inf


@given(gain=gains, rate=st.floats(0.5, 1.5))
def test_an_unstable_mode_doubles_at_its_rate(gain: float, rate: float) -> None:
    response = classify(TIME, gain * np.expm1(rate * TIME), level=0.0)
    assert response.type is ResponseType.ACCELERATING
    assert response.rise_time == pytest.approx(np.log(2) / rate, rel=0.05)


@given(gain=gains, period=st.floats(0.5, 5.0))
def test_an_undamped_oscillation_does_not_settle(gain: float, period: float) -> None:
    response = classify(TIME, gain * (1 - np.cos(2 * np.pi * TIME / period)), level=0.0)
    assert response.type is ResponseType.OSCILLATING
    assert response.effect == pytest.approx(gain, rel=0.5)


@given(level=st.floats(1e-6, 1e9))
def test_rounding_of_the_integrator_is_no_response(level: float) -> None:
    noise = 1e-7 * level * np.random.default_rng(0).standard_normal(len(TIME))
    assert classify(TIME, noise, level).type is ResponseType.INSENSITIVE
    assert classify(TIME, np.zeros(len(TIME)), level).type is ResponseType.INSENSITIVE
