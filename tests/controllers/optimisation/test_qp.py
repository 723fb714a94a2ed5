"""The online solution: bounds hold, and the optimum is that of Lawson and Hanson's least distance method."""

import pickle

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from scipy.optimize import nnls
from sympy import Matrix, Rational

from ddpc_controllers.optimisation.condensing import CondensedProblem
from ddpc_controllers.optimisation.limits import HELD, InputLimits
from ddpc_controllers.optimisation.qp import ParametricQP
from ddpc_cosim import FloatArray

WIDE = InputLimits(np.array([-1e6]), np.array([1e6]))


def least_distance(gain: FloatArray, excess: FloatArray) -> FloatArray | None:
    """Minimise |t|^2 subject to excess + gain t <= 0 by non-negative least squares; None if infeasible."""
    system = np.vstack([-gain.T, excess])
    target = np.zeros(len(system))
    target[-1] = 1.0
    dual, distance = nnls(system, target)
    if distance < 1e-6:
        return None
    residual = system @ dual - target
    return np.asarray(-residual[:-1] / residual[-1])


def problem(gain: FloatArray, move_gain: FloatArray) -> CondensedProblem:
    """Return a problem whose parameters are the excess itself, and 1."""
    n = len(gain)
    return CondensedProblem(
        excess_law=np.eye(n, n + 1),
        excess_gain=gain,
        move_law=np.zeros((1, n + 1)),
        move_gain=move_gain,
        conflict_law=np.zeros((0, n + 1)),
    )


@settings(max_examples=150, deadline=None)
@given(st.integers(1, 8), st.integers(1, 5), st.booleans(), st.integers(0, 2**32 - 1))
def test_the_optimum_is_that_of_another_method(n: int, size: int, repeated: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    gain = rng.standard_normal((n, size))
    if repeated and n > 1:
        gain[-1] = 2.0 * gain[0]  # dependent bounds
    move_gain = rng.standard_normal((1, size))
    qp = ParametricQP(problem(gain, move_gain), WIDE)
    for _ in range(6):
        excess = rng.uniform(-1.0, 0.5, n)
        t = least_distance(gain, excess)
        assume(t is not None and np.abs(t).max() < 1e3)
        move = qp.solve(np.append(excess, 1.0))
        assert move.fault == ""
        assert move.u == pytest.approx(move_gain @ t, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_bounds_of_nearly_one_direction_leave_the_digits_of_the_optimum(seed: int) -> None:
    """The oracle is exact: rational numbers."""
    rng = np.random.default_rng(seed)
    gain = 1.0 + 1e-4 * rng.standard_normal((3, 3))
    excess, move_gain = gain @ gain.T @ rng.uniform(1.0, 2.0, 3), rng.standard_normal((1, 3))
    rows = Matrix(3, 3, [Rational(value) for value in gain.ravel().tolist()])
    multipliers = (rows * rows.T).LUsolve(Matrix([Rational(value) for value in excess.tolist()]))
    t = -np.array((rows.T * multipliers).T.tolist(), dtype=float)[0]
    move = ParametricQP(problem(gain, move_gain), WIDE).solve(np.append(excess, 1.0))
    assert move.u == pytest.approx(move_gain @ t, rel=1e-10)


def test_an_infeasible_problem_is_a_fault_and_the_move_stays_within_limits() -> None:
    law = CondensedProblem(
        excess_law=np.array([[0.0, 0.5], [0.0, 0.5]]),
        excess_gain=np.array([[1.0], [-1.0]]),
        move_law=np.array([[1.0, 0.0]]),
        move_gain=np.array([[1.0]]),
        conflict_law=np.zeros((0, 2)),
    )
    move = ParametricQP(law, InputLimits(np.array([-2.0]), np.array([2.0]))).solve(np.array([7.0, 1.0]))
    assert "no way to meet all bounds" in move.fault
    assert move.u == pytest.approx([2.0])


def test_a_measurement_that_is_not_a_number_is_a_fault() -> None:
    qp = ParametricQP(problem(np.ones((2, 1)), np.ones((1, 1))), WIDE)
    move = qp.solve(np.array([np.nan, np.nan, 1.0]))
    assert move == (None, HELD)


def test_a_past_that_the_data_exclude_is_a_fault() -> None:
    law = CondensedProblem(
        excess_law=np.zeros((0, 3)),
        excess_gain=np.zeros((0, 1)),
        move_law=np.array([[1.0, 0.0, 0.0]]),
        move_gain=np.zeros((1, 1)),
        conflict_law=np.array([[1.0, -1.0, 0.0]]),
    )
    qp = ParametricQP(law, WIDE)
    assert qp.solve(np.array([0.5, 0.5, 1.0])).fault == ""
    assert "no combination of the recorded windows" in qp.solve(np.array([0.5, 0.4, 1.0])).fault


@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e6])
def test_a_past_far_beyond_the_recorded_ones_is_judged_by_its_own_size(scale: float) -> None:
    law = CondensedProblem(
        excess_law=np.zeros((0, 3)),
        excess_gain=np.zeros((0, 1)),
        move_law=np.array([[1.0, 0.0, 0.0]]),
        move_gain=np.zeros((1, 1)),
        conflict_law=np.array([[1.0 / scale, -1.0, 0.0]]),  # the first signal is in other units
    )
    qp = ParametricQP(law, WIDE)
    assert qp.solve(np.array([1e6 * scale, 1e6 + 0.1, 1.0])).fault == ""
    assert qp.solve(np.array([1e6 * scale, 1e6 + 1e2, 1.0])).fault != ""
    assert qp.solve(np.array([1e-9 * scale, -1e-9, 1.0])).fault == ""
    assert qp.solve(np.array([1e-3 * scale, 0.0, 1.0])).fault != ""


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_an_input_at_its_limit_is_exactly_there(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low, high = np.sort(10.0 ** rng.uniform(-6.0, 6.0) * rng.standard_normal((2, 1)), axis=0)
    gain, span = rng.standard_normal(1), high - low
    law = CondensedProblem(
        excess_law=np.array([[1.0 / span[0], -high[0] / span[0]], [-1.0 / span[0], low[0] / span[0]]]),
        excess_gain=np.array([gain, -gain]) / span,
        move_law=np.array([[1.0, 0.0]]),
        move_gain=gain[np.newaxis],
        conflict_law=np.zeros((0, 2)),
    )
    qp = ParametricQP(law, InputLimits(low, high))
    for wanted, limit in ((high + 0.7 * span, high), (low - 0.3 * span, low), (high + span / 3.0, high)):
        move = qp.solve(np.array([wanted[0], 1.0]))
        assert move.fault == ""
        assert np.array_equal(move.u, limit)


def test_an_input_without_a_limit_that_is_not_finite_is_a_fault() -> None:
    law = CondensedProblem(
        excess_law=np.array([[1.0, -1.0]]),
        excess_gain=np.array([[1.0]]),
        move_law=np.array([[1.0, 0.0]]),
        move_gain=np.array([[1.0]]),
        conflict_law=np.zeros((0, 2)),
    )
    endless = InputLimits(np.array([-np.inf]), np.array([1.0]))
    assert ParametricQP(law, endless).solve(np.array([-np.inf, 1.0])) == (None, HELD)


def test_the_move_is_the_callers_to_keep() -> None:
    qp = ParametricQP(problem(-np.ones((1, 1)), np.ones((1, 1))), WIDE)
    first = qp.solve(np.array([0.5, 1.0])).u
    kept = first.copy()
    qp.solve(np.array([0.9, 1.0]))
    assert np.array_equal(first, kept)


def test_what_was_learned_does_not_change_the_answer() -> None:
    rng = np.random.default_rng(4)
    gain = rng.standard_normal((8, 4))
    law = problem(gain, rng.standard_normal((1, 4)))
    experienced = ParametricQP(law, WIDE)
    for _ in range(400):
        parameters = np.append(rng.uniform(-1.0, 0.3, 8), 1.0)
        fresh = ParametricQP(law, WIDE).solve(parameters)
        again = experienced.solve(parameters)
        assert again.fault == fresh.fault
        assert again.u == pytest.approx(fresh.u, abs=1e-7)


def test_a_solver_can_be_pickled_after_use() -> None:
    qp = ParametricQP(problem(-np.eye(2), np.ones((1, 2))), WIDE)
    parameters = np.array([0.3, 0.2, 1.0])
    before = qp.solve(parameters)
    assert np.array_equal(pickle.loads(pickle.dumps(qp)).solve(parameters).u, before.u)
