"""Input and rate limits: the box QP in dU against SciPy, and clipping."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import LinearConstraint, minimize

from ddpc_controllers.optimisation.limits import ChangeLimits, rate_limits
from ddpc_cosim import Bounds, ConfigError, FloatArray

FREE = np.array([np.inf])


def limits(u_max: FloatArray, rates: FloatArray, steps: int, optimise: bool = True) -> ChangeLimits:
    """Return symmetric limits."""
    return ChangeLimits(Bounds(-u_max, u_max, -FREE, FREE), rates, steps, optimise)


def oracle(
    u: FloatArray, hessian: FloatArray, slope: FloatArray, u_max: FloatArray, rates: FloatArray, steps: int
) -> FloatArray:
    """Return the best changes by SciPy's interior-point method."""
    sums, start = np.kron(np.tri(steps), np.eye(len(u))), np.zeros(len(slope))
    lower, upper = np.tile(-u_max - u, steps), np.tile(u_max - u, steps)
    constraints = [LinearConstraint(sums, lower, upper)]
    if np.isfinite(rates).all():
        constraints.append(
            LinearConstraint(np.eye(len(slope)), -np.tile(rates, steps), np.tile(rates, steps))
        )
    result = minimize(
        lambda x: 0.5 * x @ hessian @ x - slope @ x,
        start,
        jac=lambda x: hessian @ x - slope,
        method="SLSQP",
        constraints=constraints,
        options={"ftol": 1e-15, "maxiter": 500},
    )
    return np.asarray(result.x)


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 2), st.integers(1, 5), st.booleans(), st.integers(0, 2**32 - 1))
def test_the_first_change_is_that_of_the_constrained_optimum(
    m: int, steps: int, limited_rate: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((steps * m, steps * m))
    hessian, slope = a.T @ a + 0.5 * np.eye(steps * m), 5.0 * rng.standard_normal(steps * m)
    u_max, rates = np.ones(m), np.full(m, 0.4 if limited_rate else np.inf)
    u = rng.uniform(-1.0, 1.0, m)
    free = np.linalg.solve(hessian, slope)
    applied, fault = limits(u_max, rates, steps).apply(u.tolist(), free, hessian, slope)
    best = oracle(u, hessian, slope, u_max, rates, steps)
    assert fault == ""
    assert np.array(applied) - u == pytest.approx(best[:m], abs=2e-6)


@settings(deadline=None, max_examples=40)
@given(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.booleans(), st.integers(0, 2**32 - 1))
def test_the_units_of_inputs_and_cost_do_not_matter(
    input_decades: float, cost_decades: float, limited_rate: bool, seed: int
) -> None:
    rng, unit, cost = np.random.default_rng(seed), 10.0**input_decades, 10.0**cost_decades
    rates = np.array([0.4 if limited_rate else np.inf])
    plain, other = limits(np.ones(1), rates, 5), limits(np.full(1, unit), unit * rates, 5)
    for _ in range(4):
        a = rng.standard_normal((5, 5))
        hessian, slope = a.T @ a + 0.5 * np.eye(5), 5.0 * rng.standard_normal(5)
        free, u = np.linalg.solve(hessian, slope), rng.uniform(-1.0, 1.0, 1)
        expected, fault = plain.apply(u.tolist(), free, hessian, slope)
        applied, other_fault = other.apply(
            (unit * u).tolist(), unit * free, cost * hessian, unit * cost * slope
        )
        assert fault == other_fault == ""
        assert np.array(applied) / unit == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("excess", [1e-4, 1e-7, 1e-10])
def test_a_limit_that_is_only_just_active_is_met_to_rounding(excess: float) -> None:
    # The nearest point of a plane: half of what the sum of the changes exceeds comes off each.
    plan = np.array([0.5, 0.5 + excess])
    applied, fault = limits(np.ones(1), FREE, 2).apply([0.0], plan, np.eye(2), plan)
    assert (applied, fault) == (pytest.approx([0.5 - excess / 2.0], abs=1e-14), "")


def test_limits_that_depend_on_each_other_are_met_to_rounding() -> None:
    # The first input climbs to its limit at its largest rate: both limit its first change, and its level the
    # second, which is 0. The second input has room: what is best for it depends on that.
    rng = np.random.default_rng(986)
    a = rng.standard_normal((4, 4))
    hessian, plan = a @ a.T + 0.1 * np.eye(4), np.array([5.0, rng.normal(), 3.0, rng.normal()])
    slope, kept = hessian @ plan, np.array([0.4, 0.0])
    best = np.linalg.solve(hessian[1::2, 1::2], slope[1::2] - hessian[1::2, ::2] @ kept)
    tight = limits(np.array([0.8, 50.0]), np.array([0.4, 10.0]), 2)
    applied, fault = tight.apply([0.4, 0.0], plan, hessian, slope)
    assert (applied, fault) == (pytest.approx([0.8, best[0]], abs=1e-10), "")


def test_an_input_without_room_stays_and_leaves_the_other_its_optimum() -> None:
    bounds = Bounds(np.array([0.3, -1.0]), np.array([0.3, 1.0]), -FREE, FREE)
    plan = np.array([0.5, 0.2])
    hessian = np.array([[1.0, 0.5], [0.5, 1.0]])
    applied, fault = ChangeLimits(bounds, np.repeat(FREE, 2), 1, True).apply(
        [0.3, 0.0], plan, hessian, hessian @ plan
    )
    assert (applied, fault) == (pytest.approx([0.3, 0.2 + 0.5 * 0.5]), "")


def test_a_plan_within_its_limits_is_left_alone() -> None:
    applied = limits(np.ones(1), FREE, 2).apply(
        [0.2], np.array([0.3, -0.1]), np.eye(2), np.array([0.3, -0.1])
    )
    assert applied == ([0.5], "")


def test_clipping_looks_at_the_first_change_only() -> None:
    plan, slope = np.array([0.3, 9.0]), np.array([0.3, 9.0])
    clipped = limits(np.ones(1), FREE, 2, optimise=False)
    assert clipped.apply([0.5], plan, np.eye(2), slope) == ([0.8], "")
    assert clipped.apply([0.9], plan, np.eye(2), slope) == ([1.0], "")
    # The optimum makes room for the large change to come.
    applied, _ = limits(np.ones(1), FREE, 2).apply([0.5], plan, np.eye(2), slope)
    assert applied == pytest.approx([-1.0], abs=1e-6)


def test_rates_are_clipped_too() -> None:
    clipped = limits(np.ones(2), np.array([0.1, np.inf]), 1, optimise=False)
    assert clipped.apply([0.0, 0.0], np.array([-0.5, -0.5]), np.eye(2), np.ones(2)) == ([-0.1, -0.5], "")


def test_limits_that_no_change_can_keep_are_a_status() -> None:
    rates = np.array([0.1])
    applied, fault = limits(np.ones(1), rates, 2).apply([3.0], np.zeros(2), np.eye(2), np.zeros(2))
    assert applied == [1.0]
    assert "no way to meet change of u at its" in fault


def test_what_is_not_finite_holds_the_inputs() -> None:
    applied, fault = limits(np.ones(1), FREE, 1).apply([0.4], np.array([np.nan]), np.eye(1), np.ones(1))
    assert applied == [0.4]
    assert "not finite" in fault


def test_a_pickled_copy_answers_the_same() -> None:
    original = limits(np.ones(1), FREE, 2)
    problem = [0.5], np.array([2.0, 1.0]), np.eye(2), np.array([2.0, 1.0])
    first = original.apply(*problem)
    assert pickle.loads(pickle.dumps(original)).apply(*problem) == first


def test_rates_are_one_number_or_one_for_each_input() -> None:
    assert rate_limits(0.5, 2).tolist() == [0.5, 0.5]
    assert rate_limits((), 2).tolist() == [np.inf, np.inf]
    with pytest.raises(ConfigError, match=r"rate_bounds has shape \(3,\); needed: a number or 2 numbers"):
        rate_limits([1.0, 2.0, 3.0], 2)
