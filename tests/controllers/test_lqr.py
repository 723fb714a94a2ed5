"""LQR: the gain of the Riccati equation, no offset, no windup."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from ddpc_controllers.lqr import LQR
from ddpc_controllers.models.control_api import regulator_gain
from ddpc_controllers.models.linear import StateSpace
from ddpc_cosim import OK, Action, ConfigError, FloatArray, Recording, Sample

from .loops import (
    ANGLE,
    DEGREE,
    LinearPlant,
    close_loop,
    make_loop,
    paper_reference,
    pendulum_loop,
    quick_pendulum,
)


def true_model(plant: LinearPlant) -> StateSpace:
    """The plant itself as a controller's model."""
    return StateSpace(a=plant.a.tolist(), b=plant.b.tolist(), c=plant.c.tolist(), sampling_time=0.1)


def test_every_input_of_400_steps_is_that_of_the_riccati_equation() -> None:
    rng = np.random.default_rng(4)
    plant = LinearPlant.random(rng, 3, 2, 2)
    loop = make_loop(None, np.full(2, np.inf), np.full(2, np.inf))
    controller = LQR(model=true_model(plant), output_weight=2.0, integral_weight=0.3, input_weight=0.7)
    reference = np.repeat(rng.uniform(-1.0, 1.0, (21, 2)), 20, axis=0)
    run = close_loop(controller, loop, plant.advance, plant.c, reference)

    a = np.block([[plant.a, np.zeros((3, 2))], [plant.c, np.eye(2)]])
    b = np.vstack([plant.b, np.zeros((2, 2))])
    q = np.zeros((5, 5))
    q[:3, :3], q[3:, 3:] = 2.0 * plant.c.T @ plant.c, 0.3 * np.eye(2)
    p = solve_discrete_are(a, b, q, 0.7 * np.eye(2))
    gain = np.linalg.solve(0.7 * np.eye(2) + b.T @ p @ b, b.T @ p @ a)
    state, total = np.zeros(3), np.zeros(2)
    for k, u in enumerate(run.u):
        total = total + plant.c @ state - reference[k + 1]
        assert np.abs(u + gain @ np.concatenate([state, total])).max() < 1e-6
        state = plant.advance(state, u)


def test_it_ends_every_reference_step_of_the_pendulum_without_offset(state_recording: Recording) -> None:
    run = close_loop(LQR(), pendulum_loop(state_recording), quick_pendulum, ANGLE, paper_reference())
    error = (run.y - run.reference[:400])[[98, 198, 298, 398]] / DEGREE
    assert np.abs(error).max() < 0.1
    assert np.abs(run.u).max() <= 3.5


def test_a_reference_out_of_reach_does_not_wind_it_up(state_recording: Recording) -> None:
    reference = np.vstack([np.full((100, 1), 60.0 * DEGREE), np.zeros((60, 1))])
    loop = pendulum_loop(state_recording, torque=2.0)
    run = close_loop(LQR(), loop, quick_pendulum, ANGLE, reference, steps=140)
    assert (run.u[20:95] == 2.0).all()
    assert (run.u[99:103] < 2.0).all()


def test_the_loop_closes_without_a_bump(state_recording: Recording) -> None:
    run = close_loop(LQR(), pendulum_loop(state_recording), quick_pendulum, ANGLE, np.zeros((10, 1)), 5)
    assert np.abs(run.u).max() < 0.2


def test_a_missing_measurement_is_bridged_by_the_model(state_recording: Recording) -> None:
    controller = LQR()
    controller.start(pendulum_loop(state_recording))
    for k, angle in enumerate([np.nan, 0.0, np.nan, 0.01]):
        answer = controller.step(
            Sample(k, 0.1 * k, np.array([angle]), np.zeros(2), np.full((1, 1), 0.2), np.full(1, 0.2))
        )
        assert isinstance(answer, Action)
        assert (answer.status != OK) == np.isnan(angle)
        assert np.isfinite(answer.u).all()


def test_more_outputs_than_inputs_are_refused() -> None:
    model = StateSpace(a=[[0.5]], b=[[1.0]], c=[[1.0], [2.0]])
    with pytest.raises(ConfigError, match=r"1 input.* cannot hold 2 outputs"):
        LQR(model=model).start(make_loop(None, np.ones(1), np.ones(2)))


def test_a_plant_that_cannot_be_stabilised_is_refused() -> None:
    model = StateSpace(a=[[1.5, 0.0], [0.0, 0.5]], b=[[0.0], [1.0]], c=[[1.0, 1.0]], sampling_time=0.1)
    with pytest.raises(ConfigError, match="cannot be stabilised"):
        LQR(model=model).start(make_loop(None, np.ones(1), np.ones(1)))


@pytest.mark.parametrize(("inputs", "outputs"), [([1e5, 1e-4], [1e5, 1e-4]), ([1e-4, 1e5], [1e5, 1e-4])])
def test_mixed_units_are_no_obstacle(inputs: list[float], outputs: list[float]) -> None:
    plant = LinearPlant.random(np.random.default_rng(0), 3, 2, 2)

    def gains(u: FloatArray, y: FloatArray) -> FloatArray:
        """The gains of the same regulator, signals in these units, back in units of 1."""
        b, c = plant.b / u, plant.c * y[:, np.newaxis]
        q = np.zeros((5, 5))
        q[:3, :3], q[3:, 3:] = c.T @ np.diag(y**-2.0) @ c, np.diag(y**-2.0)
        gain = regulator_gain(plant.a, b, q, np.diag(0.1 * u**-2.0), c)
        return gain / u[:, np.newaxis] * np.concatenate([np.ones(3), y])

    expected = gains(np.ones(2), np.ones(2))
    assert gains(np.array(inputs), np.array(outputs)) == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_a_weight_that_rounding_leaves_askew_is_a_weight() -> None:
    a, b, c = np.array([[0.5]]), np.eye(1), np.eye(1)
    q = np.array([[1.0, 1e-4], [-1e-4, 1.0]])
    assert regulator_gain(a, b, q, np.eye(1), c) == pytest.approx(
        regulator_gain(a, b, np.eye(2), np.eye(1), c)
    )


def test_without_a_reference_the_sum_of_its_error_is_held() -> None:
    controller = LQR(model=StateSpace(a=[[0.5]], b=[[0.5]], c=[[1.0]], sampling_time=0.1))
    controller.start(make_loop(None, np.ones(1), np.ones(1)))
    total = None
    for k, wanted in enumerate([0.2, np.nan, np.nan, 0.2]):
        answer = controller.step(
            Sample(k, 0.1 * k, np.zeros(1), np.zeros(1), np.full((1, 1), wanted), np.full(1, wanted))
        )
        assert isinstance(answer, Action)
        assert ("a reference is not finite" in answer.status) == np.isnan(wanted)
        if np.isnan(wanted):
            assert controller._sum == pytest.approx(total)
            assert np.isfinite(answer.u).all()
        total = controller._sum
