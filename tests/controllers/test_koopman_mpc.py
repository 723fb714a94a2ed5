"""EDMD models and the predictive controller on them: exact where the lift is, and bounded least squares."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from ddpc_controllers.data.dictionaries import (
    Combined,
    Delays,
    Gaussian,
    Identity,
    OwnFunction,
    Polynomials,
    ThinPlate,
)
from ddpc_controllers.koopman_mpc import KoopmanMPC, LiftedState, fit_lifted_model
from ddpc_controllers.models.linear import StateSpace
from ddpc_controllers.mpc import MPC
from ddpc_cosim import Action, ConfigError, DataError, FloatArray, Recording, Sample

from .loops import (
    ANGLE,
    DEGREE,
    LinearPlant,
    close_loop,
    experiment,
    make_loop,
    paper_reference,
    pendulum_experiment,
    pendulum_loop,
    printed_wkpc,
    quick_pendulum,
)


def slow_manifold(state: FloatArray, u: FloatArray) -> FloatArray:
    """A nonlinear plant that (x_1, x_2, x_1^2) lifts to a linear one."""
    first, second = state
    return np.array([0.9 * first, 0.5 * second + 0.4 * first**2 + u[0]])


def first_squared(states: FloatArray) -> FloatArray:
    """The observable that closes it."""
    return states[..., :1] ** 2


def exact_experiment(samples: int) -> Recording:
    """An experiment with the plant that has an exact lift, the second state the output."""
    u = np.random.default_rng(6).uniform(-1.0, 1.0, (samples, 1))
    states = np.zeros((samples, 2))
    states[0] = [1.5, 0.0]
    for k in range(1, samples):
        states[k] = slow_manifold(states[k - 1], u[k - 1])
    return Recording(u, states[:, 1:], states, 0.1)


def test_the_model_of_a_plant_with_an_exact_lift_is_exact() -> None:
    data = exact_experiment(40)
    model = fit_lifted_model(np.hstack([data.measured, first_squared(data.measured)]), data.u, data.y)
    expected = np.array([[0.9, 0.0, 0.0], [0.0, 0.5, 0.4], [0.0, 0.0, 0.81]])
    assert model.a == pytest.approx(expected, abs=1e-9)
    assert model.b[:, 0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-9)
    assert model.c[0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-9)


def test_without_observables_it_is_dynamic_mode_decomposition() -> None:
    rng = np.random.default_rng(1)
    plant = LinearPlant.random(rng, 3, 2, 2)
    data = experiment(plant.advance, rng.uniform(-1.0, 1.0, (80, 2)), 3, plant.c)
    model = fit_lifted_model(data.measured, data.u, data.y)
    pseudo_inverse = data.measured[1:].T @ np.linalg.pinv(np.hstack([data.measured, data.u])[:-1].T)
    assert np.hstack([model.a, model.b]) == pytest.approx(pseudo_inverse, abs=1e-9)
    assert model.a == pytest.approx(plant.a, abs=1e-9)
    assert model.c == pytest.approx(plant.c, abs=1e-9)
    assert model.fit["one_step_error"] < 1e-12


def test_the_ridge_is_that_of_the_normal_equations() -> None:
    rng = np.random.default_rng(2)
    z, u, y = rng.standard_normal((60, 3)), rng.standard_normal((60, 1)), rng.standard_normal((60, 1))
    size = np.sqrt(np.square(np.hstack([z, u])).mean(axis=0))
    w = np.hstack([z, u])[:-1] / size
    scaled = np.linalg.solve(w.T @ w + 0.7 * np.eye(4), w.T @ (z[1:] / size[:3])).T
    normal = scaled * size[:3, np.newaxis] / size
    model = fit_lifted_model(z, u, y, ridge=0.7)
    assert np.hstack([model.a, model.b]) == pytest.approx(normal, abs=1e-12)


@pytest.mark.parametrize("kind", ["measured", "delays"])
def test_the_lifted_state_online_is_that_of_the_recording(kind: Any) -> None:
    whole = pendulum_experiment(7)
    cut = 150
    first = Recording(whole.u[:cut], whole.y[:cut], whole.measured[:cut], 0.1)
    dictionary = Combined(dictionaries=[Polynomials(), Delays(samples=2)])
    rng = np.random.default_rng(0)
    every = LiftedState(kind, 3, dictionary, whole, rng)
    online = LiftedState(kind, 3, dictionary, first, rng)
    for k in range(cut, 160):
        z = online.follow(whole.y[k], whole.measured[k], whole.u[k - 1])
        assert np.array_equal(z, every.recorded[k - every.skipped])


def test_on_a_linear_plant_it_is_linear_mpc_with_the_true_model() -> None:
    rng = np.random.default_rng(5)
    plant = LinearPlant.random(rng, 3, 2, 2)
    data = experiment(plant.advance, rng.uniform(-1.0, 1.0, (120, 2)), 3, plant.c)
    loop = make_loop(data, np.full(2, 0.4), np.full(2, np.inf))
    reference = np.repeat(rng.uniform(-1.0, 1.0, (22, 2)), 20, axis=0)
    koopman = KoopmanMPC(dictionary=Identity(), ridge=0.0)
    model = StateSpace(a=plant.a.tolist(), b=plant.b.tolist(), c=plant.c.tolist(), sampling_time=0.1)
    ours = close_loop(koopman, loop, plant.advance, plant.c, reference)
    theirs = close_loop(MPC(model=model, disturbance="none"), loop, plant.advance, plant.c, reference)
    assert np.abs(ours.u - theirs.u).max() < 1e-6
    assert 0.0 < (np.abs(ours.u) == 0.4).mean() < 0.9


def test_with_an_exact_lift_it_is_wkpc_with_the_same_dictionary() -> None:
    output, data = np.array([[0.0, 1.0]]), exact_experiment(60)
    loop = make_loop(data, np.full(1, 0.4), np.full(1, np.inf))
    dictionary = OwnFunction(function=f"{__name__}:first_squared")
    reference = np.repeat(np.random.default_rng(7).uniform(-1.0, 1.0, (6, 1)), 20, axis=0)
    wkpc = printed_wkpc(dictionary=dictionary, lambda_g=1e-9, horizon=6)
    # The first sample that WKPC predicts is the present one: its last input reaches none.
    koopman = KoopmanMPC(dictionary=dictionary, ridge=0.0, horizon=5)
    theirs = close_loop(wkpc, loop, slow_manifold, output, reference, 100)
    ours = close_loop(koopman, loop, slow_manifold, output, reference[1:], 100)
    assert np.abs(ours.u - theirs.u).max() < 1e-6
    assert 0.0 < (np.abs(ours.u) == 0.4).mean() < 0.9


def test_every_input_of_400_steps_is_that_of_bounded_least_squares(state_recording: Recording) -> None:
    controller, n = KoopmanMPC(state="measured", setpoint="none", disturbance_gain=0.0), 5
    loop = pendulum_loop(state_recording, torque=2.5, degrees=1e6)
    run = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference())
    centres = np.random.default_rng(0).uniform(0.0, 1.0, (10, 2))

    def lifted(x: FloatArray) -> FloatArray:
        distances = [float(np.linalg.norm(x - c)) for c in centres]
        return np.array([*x, *(d * np.log10(d) if d > 0 else 0.0 for d in distances)])

    z = np.array([lifted(x) for x in state_recording.measured])
    model = fit_lifted_model(z, state_recording.u, state_recording.y, controller.ridge)
    power = np.linalg.matrix_power
    free = np.vstack([model.c @ power(model.a, k) for k in range(1, n + 1)])
    forced = np.array(
        [
            [(model.c @ power(model.a, k - i) @ model.b).item() if i <= k else 0.0 for i in range(n)]
            for k in range(n)
        ]
    )
    system = np.vstack([forced, np.sqrt(0.1) * np.eye(n)])
    for sample, u in zip(run.samples, run.u, strict=True):
        wanted = sample.reference.ravel() - free @ lifted(sample.measured)
        target = np.concatenate([wanted, np.zeros(n)])
        best = lsq_linear(system, target, (-2.5, 2.5), method="bvls", tol=1e-14).x[0]
        assert abs(best - u[0]) < 1e-6


@pytest.mark.parametrize(
    "controller",
    [
        KoopmanMPC(),
        KoopmanMPC(dictionary=Gaussian(centres="k-means", width=2.0)),
        KoopmanMPC(state="delays"),
        KoopmanMPC(state="delays", dictionary=Identity()),
    ],
    ids=["thin-plate", "gaussian", "delays", "dmd-with-delays"],
)
def test_it_ends_every_reference_step_of_the_pendulum_without_offset(
    controller: KoopmanMPC, state_recording: Recording
) -> None:
    recording = state_recording
    if controller.state == "delays":
        recording = Recording(recording.u, recording.y, recording.y, 0.1)
    run = close_loop(controller, pendulum_loop(recording), quick_pendulum, ANGLE, paper_reference())
    before_the_next = np.array([100, 200, 300, 400]) - controller.horizon - 1
    assert np.abs((run.y - run.reference[:400])[before_the_next]).max() / DEGREE < 0.1
    assert np.abs(run.u).max() <= 3.5


def test_a_loop_can_go_on_where_the_recording_ended(state_recording: Recording) -> None:
    loop = replace(pendulum_loop(state_recording, degrees=500.0), continues_recording=True)
    controller = KoopmanMPC(state="measured", dictionary=Identity())
    controller.start(loop)
    arrived = quick_pendulum(state_recording.measured[-1], state_recording.u[-1])
    assert controller._predicted == pytest.approx(arrived, abs=0.05)


@pytest.mark.parametrize("kind", ["measured", "delays"])
def test_a_lost_measurement_is_bridged_by_the_model(kind: Any, state_recording: Recording) -> None:
    controller = KoopmanMPC(state=kind)
    controller.start(pendulum_loop(state_recording))
    for k, angle in enumerate([np.nan, 0.0, np.nan, 0.01, 0.02]):
        measured = np.array([angle, 0.0])
        answer = controller.step(
            Sample(k, 0.1 * k, measured[:1], measured, np.full((5, 1), 0.2), np.full(1, 0.2))
        )
        assert isinstance(answer, Action)
        assert (answer.status != "ok") == np.isnan(angle)
        assert np.isfinite(answer.u).all()


def test_the_length_it_asks_for_is_the_shortest_it_starts_with() -> None:
    controller = KoopmanMPC(state="delays", dictionary=Delays(samples=2, dictionary=ThinPlate(count=3)))
    needed = controller.recording_length(1, 1, 2)
    whole = pendulum_experiment(1)
    long, short = (Recording(whole.u[:n], whole.y[:n], whole.measured[:n], 0.1) for n in (needed, needed - 1))
    controller.start(pendulum_loop(long))
    with pytest.raises(DataError, match="record longer, or take fewer observables"):
        controller.start(pendulum_loop(short))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dictionary": None}, "dictionary = None lacks draw"),
        ({"state": "some"}, "state = 'some' is not possible"),
        ({"terminal_length": 6}, "shorter than terminal_length = 6"),
    ],
)
def test_impossible_settings_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        KoopmanMPC(**changes)


FIRST_ORDER = LinearPlant(np.array([[0.9]]), np.array([[0.1]]), np.eye(1))


@pytest.mark.parametrize("state", ["delays", "measured"])
def test_outputs_among_the_lifted_states_are_read_off(state: Any) -> None:
    u = np.random.default_rng(0).uniform(-1.0, 1.0, (200, 1))
    recording = experiment(FIRST_ORDER.advance, u, 1, FIRST_ORDER.c)
    loop = make_loop(recording, np.full(1, 2.0), np.full(1, np.inf))
    controller = KoopmanMPC(state=state, horizon=15, dictionary=Identity())

    def pushed(x: FloatArray, u: FloatArray) -> FloatArray:
        return FIRST_ORDER.advance(x, u + 0.1)

    run = close_loop(controller, loop, pushed, FIRST_ORDER.c, np.full((420, 1), 0.5))
    assert run.y[-1] == pytest.approx([0.5], abs=1e-9)


def test_with_more_inputs_than_outputs_it_works_as_it_is() -> None:
    plant = LinearPlant(np.array([[0.9]]), np.array([[0.1, 0.05]]), np.eye(1))
    u = np.random.default_rng(0).uniform(-1.0, 1.0, (300, 2))
    loop = make_loop(experiment(plant.advance, u, 1, plant.c), np.ones(2), np.full(1, np.inf))
    run = close_loop(KoopmanMPC(), loop, plant.advance, plant.c, np.full((120, 1), 0.5), 100)
    assert set(run.status) == {"ok"}
    assert run.u[-1] == pytest.approx([0.4, 0.2], abs=1e-5)
    assert run.y[-1] == pytest.approx([0.5], abs=1e-6)


@pytest.mark.parametrize(("state", "lost"), [("delays", 1), ("measured", 0)])
def test_what_is_not_lifted_may_be_lost(state: Any, lost: int, state_recording: Recording) -> None:
    controller = KoopmanMPC(state=state, dictionary=Identity())
    controller.start(pendulum_loop(state_recording))
    for k in range(3):
        y, measured = np.array([0.01 * k]), np.array([0.01 * k, 0.1])
        (measured if lost else y)[...] = [0.01 * k, np.nan] if lost else np.nan
        answer = controller.step(Sample(k, 0.1 * k, y, measured, np.full((5, 1), 0.2), np.full(1, 0.2)))
        assert isinstance(answer, Action)
        assert answer.status == "ok"


def test_inputs_that_stand_still_are_refused() -> None:
    still = experiment(FIRST_ORDER.advance, np.ones((200, 1)), 1, FIRST_ORDER.c)
    with pytest.raises(DataError, match=r"EDMD: the recorded inputs .*rank 0 of 1, .*richer input"):
        KoopmanMPC().start(make_loop(still, np.ones(1), np.ones(1)))
