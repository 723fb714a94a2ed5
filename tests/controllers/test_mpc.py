"""Linear MPC: a bounded least-squares problem a sample, no offset, and DeePC and WKPC as its equals."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.optimize import lsq_linear

from ddpc_controllers.data.dictionaries import Identity
from ddpc_controllers.lqr import LQR
from ddpc_controllers.models.identification import Identified
from ddpc_controllers.models.linear import StateSpace
from ddpc_controllers.mpc import MPC
from ddpc_cosim import Action, ConfigError, DataError, FloatArray, Loop, Recording, Sample

from .loops import (
    ANGLE,
    DEGREE,
    LinearPlant,
    close_loop,
    experiment,
    make_loop,
    paper_reference,
    pendulum_loop,
    printed_deepc,
    printed_wkpc,
    quick_pendulum,
)

TRUE: dict[str, Any] = {"disturbance": "none"}


def true_model(plant: LinearPlant) -> StateSpace:
    """The plant itself as a controller's model."""
    return StateSpace(a=plant.a.tolist(), b=plant.b.tolist(), c=plant.c.tolist(), sampling_time=0.1)


def steps(rng: np.random.Generator, outputs: int, samples: int = 440) -> FloatArray:
    """A reference that steps every 20 samples."""
    return np.repeat(rng.uniform(-1.0, 1.0, (samples // 20, outputs)), 20, axis=0)


def noise_free(seed: int, u_limit: float) -> tuple[LinearPlant, Loop, FloatArray]:
    """A plant of order two, a loop with a noise-free recording of it, and a reference."""
    rng = np.random.default_rng(seed)
    plant = LinearPlant.random(rng, 2, 1, 1)
    recording = experiment(plant.advance, rng.uniform(-1.0, 1.0, (100, 1)), 2, plant.c)
    return plant, make_loop(recording, np.full(1, u_limit), np.full(1, np.inf)), steps(rng, 1)


def forced_response(plant: LinearPlant, horizon: int) -> tuple[FloatArray, FloatArray]:
    """Free and forced response over the horizon, written with powers of A."""
    power = np.linalg.matrix_power
    free = np.vstack([plant.c @ power(plant.a, k) for k in range(1, horizon + 1)])
    zero = np.zeros((len(plant.c), plant.b.shape[1]))
    rows = [
        [plant.c @ power(plant.a, k - i) @ plant.b if i <= k else zero for i in range(horizon)]
        for k in range(horizon)
    ]
    return free, np.block(rows)


@pytest.mark.parametrize(("inputs", "outputs"), [(1, 1), (2, 2)])
def test_every_input_of_400_steps_is_that_of_bounded_least_squares(inputs: int, outputs: int) -> None:
    rng = np.random.default_rng(11)
    plant, n = LinearPlant.random(rng, 3, inputs, outputs), 6
    loop = make_loop(None, np.full(inputs, 0.3), np.full(outputs, np.inf))
    controller = MPC(
        model=true_model(plant), horizon=n, setpoint="none", output_weight=2.0, input_weight=0.05, **TRUE
    )
    reference = steps(rng, outputs)
    run = close_loop(controller, loop, plant.advance, plant.c, reference)

    free, forced = forced_response(plant, n)
    system = np.vstack([np.sqrt(2.0) * forced, np.sqrt(0.05) * np.eye(n * inputs)])
    state, at_limit = np.zeros(3), 0
    for k, u in enumerate(run.u):
        wanted = np.sqrt(2.0) * (reference[k + 1 : k + 1 + n].ravel() - free @ state)
        target = np.concatenate([wanted, np.zeros(n * inputs)])
        best = lsq_linear(system, target, (-0.3, 0.3), method="bvls", tol=1e-14).x[:inputs]
        assert np.abs(best - u).max() < 1e-6
        at_limit += np.abs(u).max() == 0.3
        state = plant.advance(state, u)
    assert 20 < at_limit < 380
    assert set(run.status) == {"ok"}


def test_the_filter_is_the_steady_kalman_filter() -> None:
    rng = np.random.default_rng(2)
    plant = LinearPlant.random(rng, 2, 1, 1)
    controller = MPC(model=true_model(plant), process_noise=0.3, disturbance_noise=0.2, measurement_noise=0.1)
    controller.start(make_loop(None, np.ones(1), np.ones(1)))
    a = np.block([[plant.a, np.zeros((2, 1))], [np.zeros((1, 2)), np.eye(1)]])
    c = np.hstack([plant.c, np.eye(1)])
    drive = np.zeros((3, 3))
    drive[:2, :2], drive[2, 2] = 0.09 * plant.b @ plant.b.T, 0.04
    p = solve_discrete_are(a.T, c.T, drive, np.array([[0.01]]))
    gain = p @ c.T / (c @ p @ c.T + 0.01)
    assert controller._observer._gain == pytest.approx(gain, abs=1e-6)


def test_with_the_true_model_it_does_what_deepc_does_with_noise_free_data() -> None:
    plant, loop, reference = noise_free(8, u_limit=0.3)
    deepc = printed_deepc(lambda_g=1e-9, lambda_sigma=1e9, use_current_output=True, horizon=6)
    mpc = MPC(
        model=true_model(plant),
        setpoint="input-output",
        terminal_length=deepc.initial_length,
        horizon=6,
        output_weight=deepc.output_weight,
        setpoint_weight=deepc.setpoint_weight,
        input_weight=deepc.input_weight,
        **TRUE,
    )
    ours = close_loop(mpc, loop, plant.advance, plant.c, reference)
    theirs = close_loop(deepc, loop, plant.advance, plant.c, reference)
    assert np.abs(ours.u - theirs.u).max() < 1e-6
    assert 0.0 < (np.abs(ours.u) == 0.3).mean() < 0.9


@pytest.mark.parametrize("start", [0.0, 0.5])
def test_without_setpoints_it_is_deepc_in_regulation_form_weighed_from_rest(start: float) -> None:
    plant, loop, reference = noise_free(8, u_limit=1.0)
    loop = replace(loop, inputs=(replace(loop.inputs[0], start=start),))
    weights: dict[str, Any] = {"horizon": 6, "output_weight": 100.0, "input_weight": 10.0}
    deepc = printed_deepc(
        lambda_g=1e-9,
        lambda_sigma=1e9,
        use_current_output=True,
        artificial_setpoint=False,
        terminal_equality=False,
        **weights,
    )
    mpc = MPC(model=true_model(plant), setpoint="none", **weights, **TRUE)
    # Inputs of 0.5 and an output of 0 before the start are no rest, which either understands in its own way.
    ours = close_loop(mpc, loop, plant.advance, plant.c, reference, 100)
    theirs = close_loop(deepc, loop, plant.advance, plant.c, reference, 100)
    assert np.abs(ours.u - theirs.u)[30:].max() < 1e-5
    assert np.abs(ours.u).max() > 0.1


def test_soft_output_limits_give_way_as_those_of_deepc() -> None:
    plant, loop, reference = noise_free(8, u_limit=1.0)
    bounds = replace(loop.bounds, y_min=np.full(1, -0.1), y_max=np.full(1, 0.1))
    loop = replace(loop, bounds=bounds)
    deepc = printed_deepc(
        lambda_g=1e-9, lambda_sigma=1e9, use_current_output=True, horizon=6, soft_output_bounds=1e3
    )
    mpc = MPC(
        model=true_model(plant),
        setpoint="input-output",
        terminal_length=deepc.initial_length,
        horizon=6,
        output_weight=deepc.output_weight,
        setpoint_weight=deepc.setpoint_weight,
        input_weight=deepc.input_weight,
        soft_output_bounds=1e3,
        **TRUE,
    )
    ours = close_loop(mpc, loop, plant.advance, plant.c, reference, 200)
    theirs = close_loop(deepc, loop, plant.advance, plant.c, reference, 200)
    assert np.abs(ours.u - theirs.u).max() < 1e-5
    assert np.abs(ours.y).max() > 0.1


@pytest.mark.parametrize("setpoint", ["input", "input-output", "none"])
def test_with_more_inputs_than_outputs_it_works_as_it_is(setpoint: Any) -> None:
    plant = LinearPlant(np.array([[0.9]]), np.array([[0.1, 0.05]]), np.eye(1))
    loop = make_loop(None, np.ones(2), np.full(1, np.inf))
    controller = MPC(model=true_model(plant), setpoint=setpoint)
    run = close_loop(controller, loop, plant.advance, plant.c, np.full((150, 1), 0.5), 100)
    assert set(run.status) == {"ok"}
    if setpoint != "none":
        # y = u_1 + u_2 / 2: of the inputs with y = 0.5 those nearest to rest.
        assert run.u[-1] == pytest.approx([0.4, 0.2], abs=1e-5)
        assert run.y[-1] == pytest.approx([0.5], abs=1e-6)


def disturbed(controller: MPC, plant: LinearPlant, noise: float, **changes: Any) -> FloatArray:
    """The outputs of 400 noisy samples with 0.1 added to the inputs, reference 0.5."""
    rng = np.random.default_rng(0)
    clean = experiment(plant.advance, rng.uniform(-1.0, 1.0, (300, 1)), len(plant.a), plant.c)
    y = clean.y + noise * rng.standard_normal(clean.y.shape)
    loop = make_loop(Recording(clean.u, y, y, 0.1), np.full(1, 2.0), np.full(1, np.inf), **changes)
    controller.start(loop)
    state, outputs = np.zeros(len(plant.a)), []
    for k in range(400):
        outputs.append(plant.c @ state)
        measured = outputs[-1] + noise * rng.standard_normal(1)
        sample = Sample(
            k, 0.1 * k, measured, measured, np.full((controller.horizon, 1), 0.5), np.full(1, 0.5)
        )
        answer = controller.step(sample)
        u = answer.u if isinstance(answer, Action) else answer
        state = plant.advance(state, u + 0.1)
    return np.array(outputs)


def test_an_integrator_is_told_as_well_as_the_recording_tells_it() -> None:
    plant = LinearPlant(np.array([[1.0, 0.1], [0.0, 0.7]]), np.array([[0.0], [0.3]]), np.array([[1.0, 0.0]]))
    outputs = disturbed(MPC(horizon=15), plant, noise=5e-3)
    assert abs(outputs[-80:].mean() - 0.5) < 5e-3


@pytest.mark.parametrize("noise", [0.0, 5e-3])
def test_a_dead_time_is_found_in_the_recording(noise: float) -> None:
    a = np.diag(np.ones(5), -1)
    a[0, 0] = 0.8
    plant = LinearPlant(a, 0.2 * np.eye(6, 1), np.eye(6)[5:])
    controller = MPC(horizon=15)
    outputs = disturbed(controller, plant, noise)
    assert abs(outputs[-80:] - 0.5).max() < 1e-6 + 10.0 * noise
    diagnostics = controller.diagnostics()
    assert diagnostics["lags"] == 6.0 if noise == 0.0 else diagnostics["lags"] > 6.0
    assert 0.8 * noise <= diagnostics["one_step_error"] < 1.5 * noise + 1e-9


def test_units_do_not_decide_whether_a_disturbance_is_seen() -> None:
    for size in (1e-6, 1.0, 1e6):
        slow = StateSpace(a=[[-1e-5]], b=[[1e-5 / size]], c=[[size]])
        MPC(model=slow, scaling="none").start(make_loop(None, np.ones(1), np.ones(1)))


def test_with_the_true_model_it_does_what_wkpc_does_with_noise_free_data() -> None:
    plant, loop, reference = noise_free(9, u_limit=0.3)
    wkpc = printed_wkpc(dictionary=Identity(), lambda_g=1e-9, horizon=6)
    # The first sample that WKPC predicts is the present one: its last input reaches none.
    mpc = MPC(model=true_model(plant), horizon=5, **TRUE)
    theirs = close_loop(wkpc, loop, plant.advance, plant.c, reference)
    ours = close_loop(mpc, loop, plant.advance, plant.c, reference[1:])
    assert np.abs(ours.u - theirs.u).max() < 1e-6
    assert 0.0 < (np.abs(ours.u) == 0.3).mean() < 0.9


@pytest.mark.parametrize("disturbance", ["output", "input"])
def test_it_ends_every_reference_step_of_the_pendulum_without_offset(
    state_recording: Recording, disturbance: Any
) -> None:
    controller = MPC(disturbance=disturbance)
    run = close_loop(controller, pendulum_loop(state_recording), quick_pendulum, ANGLE, paper_reference())
    before_the_next = np.array([100, 200, 300, 400]) - controller.horizon - 1
    error = (run.y - run.reference[:400])[before_the_next] / DEGREE
    assert np.abs(error).max() < 0.1
    assert np.abs(run.u).max() <= 3.5


def test_rates_and_soft_output_limits_hold_as_far_as_they_should(state_recording: Recording) -> None:
    loop = pendulum_loop(state_recording, degrees=15.0)
    run = close_loop(
        MPC(rate_bounds=0.5, soft_output_bounds=1e3), loop, quick_pendulum, ANGLE, paper_reference()
    )
    changes = np.diff(run.u[:, 0], prepend=0.0)
    assert np.abs(changes).max() <= 0.5 + 1e-15
    assert np.abs(run.y).max() / DEGREE < 17.0
    assert set(run.status) == {"ok"}


def test_a_loop_can_go_on_where_the_recording_ended(state_recording: Recording) -> None:
    loop = replace(pendulum_loop(state_recording, degrees=500.0), continues_recording=True)
    controller = MPC()
    controller.start(loop)
    state = state_recording.measured[-1]
    predicted = controller._observer.c @ controller._observer.state
    arrived = quick_pendulum(state, state_recording.u[-1])
    assert abs(predicted[0] - arrived[0]) < 2.0 * DEGREE


def test_a_missing_measurement_is_bridged_by_the_model(state_recording: Recording) -> None:
    controller = MPC()
    controller.start(pendulum_loop(state_recording))
    reference, missing = np.full((5, 1), 0.2), np.array([np.nan])
    first = controller.step(Sample(0, 0.0, missing, np.full(2, np.nan), reference, reference[0]))
    assert isinstance(first, Action)
    assert first.u.tolist() == [0.0]
    controller.step(Sample(1, 0.1, np.zeros(1), np.zeros(2), reference, reference[0]))
    bridged = controller.step(Sample(2, 0.2, missing, np.full(2, np.nan), reference, reference[0]))
    assert isinstance(bridged, Action)
    assert "prediction stands in" in bridged.status
    assert np.isfinite(bridged.u).all()


@pytest.mark.parametrize("kind", [MPC, LQR])
def test_a_model_that_is_not_one_is_refused(kind: Any) -> None:
    with pytest.raises(ConfigError, match=f"{kind.__name__}: model = 3 is not a source of models"):
        kind(model=3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"terminal_length": 7}, "horizon = 5 is shorter than terminal_length = 7"),
        ({"terminal_length": 3, "setpoint": "none"}, "ties the horizon's end to the artificial setpoints"),
        ({"rate_bounds": [1.0, -1.0]}, "rate_bounds"),
        ({"disturbance": "state"}, "disturbance = 'state' is not possible"),
    ],
)
def test_impossible_settings_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        MPC(**changes)


def test_an_integrating_plant_cannot_carry_an_output_disturbance() -> None:
    integrator = StateSpace(a=[[1.0]], b=[[0.1]], c=[[1.0]], sampling_time=0.1)
    loop = make_loop(None, np.ones(1), np.ones(1))
    with pytest.raises(ConfigError, match=r'"output" cannot be distinguished .* 1 constant mode'):
        MPC(model=integrator, disturbance="output").start(loop)
    on_inputs, chosen = MPC(model=integrator, disturbance="input"), MPC(model=integrator)
    sample = Sample(0, 0.0, np.full(1, 0.2), np.zeros(1), np.ones((5, 1)), np.ones(1))
    for controller in (on_inputs, chosen):
        controller.start(loop)
    first, second = on_inputs.step(sample), chosen.step(sample)
    assert isinstance(first, Action)
    assert isinstance(second, Action)
    assert first.u == pytest.approx(second.u, abs=0.0)
    assert {**first.info} == {**second.info}


def test_a_disturbance_that_cannot_be_told_at_all_is_an_error() -> None:
    two_inputs = StateSpace(a=[[1.0]], b=[[0.1, 0.2]], c=[[1.0]], sampling_time=0.1)
    with pytest.raises(ConfigError, match=r'"output": 1 constant mode.*"input": 1 constant mode'):
        MPC(model=two_inputs).start(make_loop(None, np.ones(2), np.ones(1)))


def test_identification_needs_a_recording_and_numbers_do_not() -> None:
    assert MPC().uses_recording
    assert MPC().recording_length(1, 1, 1) == Identified().recording_length(1, 1)
    assert not MPC(model=StateSpace(a=[[0.5]], b=[[1.0]], c=[[1.0]])).uses_recording
    with pytest.raises(DataError, match="give the loop an excitation or a recording"):
        MPC().start(make_loop(None, np.ones(1), np.ones(1)))
