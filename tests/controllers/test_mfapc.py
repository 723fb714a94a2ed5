"""MFAPC-CFDL (14)-(21) against the authors' own program and the formulas."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ddpc_controllers import MFAPC
from ddpc_controllers.pseudo_jacobian import Estimation, PseudoJacobian
from ddpc_cosim import ConfigError, FloatArray, Sample

from .loops import (
    ANGLE,
    DATA,
    DEGREE,
    LinearPlant,
    close_loop,
    make_loop,
    paper_reference,
    pendulum,
    pendulum_loop,
)

TABLE_2 = Estimation(eta=1.0, mu=1.0, epsilon=1e-5, delta=0.5, theta_0=0.175, n_m=4, theta_limit=2.0)
FREE = np.array([np.inf, np.inf])


def test_the_published_program_is_reproduced_row_by_row() -> None:
    published = np.loadtxt(DATA / "mfapc_published_code.csv", delimiter=",", skiprows=1)
    here = close_loop(MFAPC(lambda_u=0.37), pendulum_loop(None), pendulum, ANGLE, paper_reference())
    # Row j of the file is sample j - 1: it has one rest sample more at its start.
    rows = len(published) - 1
    assert np.abs(here.y[:rows, 0] / DEGREE - published[1:, 2]).max() < 1e-5
    assert np.abs(here.u[:rows, 0] - published[1:, 3]).max() < 1e-5
    assert np.abs(here.u).max() == pytest.approx(3.3594, abs=0.0005)


def test_a_larger_lambda_is_smoother() -> None:
    def restlessness(lambda_u: float) -> float:
        run = close_loop(MFAPC(lambda_u=lambda_u), pendulum_loop(None), pendulum, ANGLE, paper_reference())
        return float(np.abs(np.diff(run.u, axis=0)).sum())

    assert restlessness(0.25) > restlessness(0.37) > restlessness(0.7)


def formulas(dy: FloatArray, du: FloatArray, phi_1: float) -> tuple[float, FloatArray]:
    """Return phi_k and the forecast phi_k ... phi_k+4 after a history, straight from (16)-(18)."""
    phi, theta = [phi_1] * 5, np.full(4, 0.175)
    for change, move in zip(dy, du, strict=True):
        estimate = phi[-1] + 1.0 * move / (1.0 + move**2) * (change - phi[-1] * move)
        if abs(estimate) < 1e-5 or abs(move) <= 1e-5 or np.sign(estimate) != np.sign(phi_1):
            estimate = phi_1
        past = np.array(phi[: -4 - 1 : -1])
        theta = theta + past / (0.5 + past @ past) * (estimate - past @ theta)
        if np.linalg.norm(theta) >= 2.0:
            theta = np.full(4, 0.175)
        phi.append(estimate)
    ahead = list(phi)
    for _ in range(4):
        predicted = float(theta @ np.array(ahead[: -4 - 1 : -1]))
        ahead.append(phi_1 if abs(predicted) < 1e-5 or np.sign(predicted) != np.sign(phi_1) else predicted)
    return phi[-1], np.array(ahead[-5:])


changes = st.floats(-3.0, 3.0) | st.sampled_from([0.0, 1e-6, -1e-5])


@settings(deadline=None)
@given(st.lists(st.tuples(changes, changes), min_size=1, max_size=12), st.sampled_from([0.1, -0.5, 2.0]))
def test_estimate_and_forecast_are_those_of_the_formulas(
    history: list[tuple[float, float]], phi_1: float
) -> None:
    jacobian = PseudoJacobian([[phi_1]], TABLE_2)
    for dy, du in history:
        jacobian.update([dy], [du])
    estimate, forecast = formulas(*np.array(history).T, phi_1)
    assert jacobian.forecast(5)[0][0] == pytest.approx(forecast.tolist(), rel=1e-9, abs=1e-12)
    assert jacobian.forecast(1)[0][0] == pytest.approx([estimate], rel=1e-9, abs=1e-12)


@settings(deadline=None)
@given(st.lists(st.tuples(changes, changes), min_size=1, max_size=12))
def test_the_direction_of_control_never_changes(history: list[tuple[float, float]]) -> None:
    jacobian = PseudoJacobian([[0.1]], TABLE_2)
    for dy, du in history:
        jacobian.update([dy], [du])
        assert min(jacobian.forecast(5)[0][0]) >= 1e-5


def test_an_entry_of_unknown_direction_may_take_any_sign() -> None:
    jacobian = PseudoJacobian([[0.5, 0.0]], TABLE_2)
    jacobian.update([-1.0], [0.0, 1.0])
    assert jacobian.forecast(1)[0][1][0] == pytest.approx(-0.5)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_the_channels_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    gradient = np.array([[0.5, 0.1], [-0.2, 0.4]])
    measurements, reference = rng.standard_normal((8, 2)), rng.standard_normal((5, 2))
    there, swapped = MFAPC(initial_gradient=gradient), MFAPC(initial_gradient=gradient[::-1, ::-1])
    there.start(make_loop(None, 3.0 * np.ones(2), FREE))
    swapped.start(make_loop(None, 3.0 * np.ones(2), FREE))
    for k, y in enumerate(measurements):
        u = there.step(Sample(k, 0.1 * k, y, y, reference))
        other = swapped.step(Sample(k, 0.1 * k, y[::-1], y[::-1], reference[:, ::-1]))
        assert other[::-1] == pytest.approx(u, abs=1e-9)


def test_a_channel_at_rest_leaves_the_other_as_if_it_were_alone() -> None:
    rng = np.random.default_rng(7)
    alone, beside = MFAPC(), MFAPC()
    alone.start(make_loop(None, np.array([3.0]), FREE[:1]))
    beside.start(make_loop(None, np.array([3.0, 3.0]), FREE))
    for k, y in enumerate(rng.standard_normal(30)):
        u = alone.step(Sample(k, 0.1 * k, np.array([y]), np.array([y]), np.ones((5, 1))))
        both = np.array([y, 0.0])
        u_both = beside.step(Sample(k, 0.1 * k, both, both, np.tile([1.0, 0.0], (5, 1))))
        assert u_both == pytest.approx([u[0], 0.0], abs=1e-9)


def test_two_outputs_follow_their_references_without_offset() -> None:
    plant = LinearPlant(
        np.array([[0.6, 0.1], [0.0, 0.5]]),
        np.array([[0.5, 0.1], [-0.1, 0.6]]),
        np.array([[1.0, 0.0], [0.0, 1.0]]),
    )
    reference = np.tile([1.0, -0.5], (220, 1))
    loop = make_loop(None, 5.0 * np.ones(2), FREE)
    run = close_loop(MFAPC(initial_gradient=0.5), loop, plant.advance, plant.c, reference, steps=200)
    assert run.y[-1] == pytest.approx(reference[0], abs=1e-4)


def test_more_outputs_than_inputs_are_controlled_in_the_least_squares_sense() -> None:
    controller = MFAPC(initial_gradient=[[0.5], [0.5]])
    controller.start(make_loop(None, np.array([5.0]), FREE))
    y = np.zeros(2)
    assert controller.step(Sample(0, 0.0, y, y, np.tile([1.0, -1.0], (5, 1)))) == pytest.approx([0.0])


def test_an_initial_gradient_of_the_wrong_shape_is_told_the_right_ones() -> None:
    with pytest.raises(ConfigError, match=r"initial_gradient has shape \(1, 2\); .* 2 numbers, or 2 x 2"):
        MFAPC(initial_gradient=[[0.1, 0.2]]).start(make_loop(None, np.ones(2), FREE))
