"""Linear models: from numbers, from recordings, from plants, each against another way to compute it."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.linalg import expm

from ddpc_controllers.models.control_api import estimator_covariance
from ddpc_controllers.models.from_fmu import pulse_model
from ddpc_controllers.models.identification import (
    Identified,
    choose_lags,
    fit_arx,
    markov_parameters,
    one_step_errors,
)
from ddpc_controllers.models.linear import ModelFunction, SampledModel, StateSpace
from ddpc_cosim import (
    ConfigError,
    DataError,
    FloatArray,
    FMUPlant,
    Loop,
    Plant,
    PluginError,
    Recording,
    Variable,
)
from fmu_plants.linear import linearise
from fmu_plants.pendulum import MODEL as PENDULUM_MODEL

from ..loops import ANGLE, LinearPlant, experiment, make_loop, pendulum_experiment, quick_pendulum

H = 0.1
PENDULUM = StateSpace(a=[[0.0, 1.0], [-9.81 / 0.2, -2.0]], b=[[0.0], [5.0]], c=[[1.0, 0.0]])


def loop_of(inputs: int, outputs: int, recording: Recording | None = None) -> Loop:
    """A loop with so many signals."""
    return make_loop(recording, np.ones(inputs), np.ones(outputs))


def own_model(loop: Loop) -> StateSpace:
    """A model that a user's function makes."""
    return replace(PENDULUM, u_0=[0.5 * len(loop.inputs)])


def no_model(loop: Loop) -> str:
    """What a user's function must not return."""
    return "pendulum"


class Pendulum(Plant):
    """The pendulum without an FMU."""

    inputs = (Variable("torque"),)
    outputs = (Variable("angle"),)

    def reset(self, parameters: Mapping[str, Any] | None = None, t0: float = 0.0) -> FloatArray:
        self._state = np.zeros(2)
        return self._state[:1].copy()

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self._state = quick_pendulum(self._state, u)
        return self._state[:1].copy()


def test_a_continuous_model_is_sampled_with_held_inputs() -> None:
    model = PENDULUM.model(loop_of(1, 1))
    both = np.zeros((3, 3))
    both[:2, :2], both[:2, 2:] = PENDULUM.a, PENDULUM.b
    held = expm(both * H)
    assert model.a == pytest.approx(held[:2, :2], abs=1e-12)
    assert model.b == pytest.approx(held[:2, 2:], abs=1e-12)


def test_a_feedthrough_shows_the_input_of_the_sample_before() -> None:
    source = StateSpace(a=[[0.5]], b=[[1.0]], c=[[2.0]], d=[[3.0]], sampling_time=H)
    model = source.model(loop_of(1, 1))
    assert markov_parameters(model, 3)[:, 0, 0].tolist() == [2.0 + 3.0, 1.0, 0.5]


def test_every_matrix_that_does_not_fit_is_named() -> None:
    with pytest.raises(ConfigError) as caught:
        StateSpace(a=[[1.0, 0.0]], b=[[1.0]], c=[[1.0]], d=[[1.0, 1.0]], u_0=[1.0, 2.0])
    assert [fault.split()[1] for fault in caught.value.faults] == ["a", "d", "u_0"]
    with pytest.raises(ConfigError, match=r"b = \[\['x'\]\] is not a matrix of numbers"):
        StateSpace(a=[[1.0]], b=[["x"]], c=[[1.0]])  # type: ignore[list-item]
    with pytest.raises(ConfigError, match="a holds a number that is not finite"):
        StateSpace(a=[[np.nan]], b=[[1.0]], c=[[1.0]])


def test_a_model_of_another_loop_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"\(outputs, inputs\) = \(1, 1\), the loop has \(2, 1\)"):
        PENDULUM.model(loop_of(1, 2))
    with pytest.raises(ConfigError, match=r"sampled every 0.2 s, the loop every 0.1 s"):
        replace(PENDULUM, sampling_time=0.2).model(loop_of(1, 1))


def test_a_function_of_the_users_own_makes_the_model() -> None:
    model = ModelFunction(function=f"{__name__}:own_model").model(loop_of(1, 1))
    assert model.u_0.tolist() == [0.5]
    with pytest.raises(ConfigError, match="returned str; needed: StateSpace"):
        ModelFunction(function=f"{__name__}:no_model").model(loop_of(1, 1))
    with pytest.raises(PluginError, match="no_such"):
        ModelFunction(function=f"{__name__}:no_such")


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 3), st.integers(1, 2), st.integers(1, 2), st.booleans(), st.integers(0, 2**32 - 1))
def test_noise_free_data_of_a_linear_plant_give_its_impulse_response(
    order: int, inputs: int, outputs: int, reduced: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    plant = LinearPlant.random(rng, order, inputs, outputs)
    recording = experiment(plant.advance, rng.uniform(-1.0, 1.0, (120, inputs)), order, plant.c)
    source = Identified(lags=order, order=order if reduced else 0)
    model = source.model(loop_of(inputs, outputs, recording))
    true = SampledModel(plant.a, plant.b, plant.c, np.zeros(inputs), np.zeros(outputs))
    expected = markov_parameters(true, 12)
    assert np.abs(markov_parameters(model, 12) - expected).max() < 1e-6 * max(1.0, np.abs(expected).max())


def test_the_constant_of_data_off_the_origin_is_an_operating_point() -> None:
    rng = np.random.default_rng(3)
    plant = LinearPlant.random(rng, 2, 1, 1)
    centred = experiment(plant.advance, rng.uniform(-1.0, 1.0, (80, 1)), 2, plant.c)
    shifted = Recording(centred.u + 4.0, centred.y - 7.0, centred.measured, H)
    model = Identified(lags=2).model(loop_of(1, 1, shifted))
    gain = model.c @ np.linalg.solve(np.eye(2) - model.a, model.b)
    at_four = model.y_0 + gain @ (4.0 - model.u_0)
    assert at_four == pytest.approx([-7.0], abs=1e-9)


def test_a_ridge_shrinks_the_coefficients() -> None:
    recording = pendulum_experiment(1)
    free, held = fit_arx(recording, 2), fit_arx(recording, 2, ridge=1e3)
    assert np.abs(held.a[:, 0]).sum() < np.abs(free.a[:, 0]).sum()
    assert held.fit["one_step_error"] > free.fit["one_step_error"]


@pytest.mark.parametrize("seams", [(), (70,)])
def test_models_with_other_inputs_at_once_leave_what_each_of_them_leaves(seams: tuple[int, ...]) -> None:
    recording, rng = replace(pendulum_experiment(1), seams=seams), np.random.default_rng(0)
    inputs = np.stack([recording.u, np.roll(recording.u, 3, axis=0), rng.normal(size=(len(recording), 1))], 1)
    each = [fit_arx(replace(recording, u=inputs[:, n]), 2).fit["one_step_error"] for n in range(3)]
    np.testing.assert_allclose(one_step_errors(recording, inputs, 2), each, rtol=1e-9)


def test_models_with_other_inputs_may_have_some_outputs_only() -> None:
    rng = np.random.default_rng(0)
    plant = LinearPlant.random(rng, 2, 1, 2)
    recording = experiment(plant.advance, rng.uniform(-1.0, 1.0, (80, 1)), 2, plant.c)
    y = recording.y[:, [1]] + 0.01 * rng.normal(size=(80, 1))
    both = replace(recording, y=np.hstack([recording.y[:, [0]], y]))
    late = np.stack([recording.u, np.roll(recording.u, 1, axis=0)], 1)
    alone = one_step_errors(replace(recording, y=y), late, 2)
    np.testing.assert_array_equal(one_step_errors(both, late, 2, [1]), alone)


def test_a_recording_too_short_for_the_lags_is_refused() -> None:
    source = Identified(lags=4)
    short = experiment(quick_pendulum, np.ones((12, 1)), 2, ANGLE)
    with pytest.raises(DataError, match="has 12 samples; 4 lags take at least 13"):
        source.model(make_loop(short, np.ones(1), np.ones(1)))


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 4), st.integers(1, 2), st.integers(0, 2**32 - 1))
def test_the_lags_chosen_explain_noise_free_data_of_a_linear_plant(
    order: int, outputs: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    plant = LinearPlant.random(rng, order, 2, outputs)
    recording = experiment(plant.advance, rng.uniform(-1.0, 1.0, (150, 2)), order, plant.c)
    assert choose_lags(recording) <= order
    model = Identified().model(loop_of(2, outputs, recording))
    true = SampledModel(plant.a, plant.b, plant.c, np.zeros(2), np.zeros(outputs))
    expected = markov_parameters(true, 12)
    assert np.abs(markov_parameters(model, 12) - expected).max() < 1e-5 * max(1.0, np.abs(expected).max())


def test_the_lags_chosen_are_those_of_schwarz() -> None:
    recording = pendulum_experiment(3)
    most, rows = 20, len(recording) - 20
    criteria = []
    for lags in range(1, most + 1):
        # The same samples for every number of lags, the fit by its own least squares.
        cut = Recording(recording.u[most - lags :], recording.y[most - lags :], recording.y[most - lags :], H)
        variance = (fit_arx(cut, lags).fit["one_step_error"] / recording.y.std(axis=0)) ** 2 + 1e-16
        criteria.append(rows * np.log(variance[0]) + np.log(rows) * 2 * lags)
    assert choose_lags(recording) == 1 + int(np.argmin(criteria))


@pytest.mark.parametrize(
    ("kind", "rank"), [("zero", 0), ("constant", 0), ("sine", 0), ("bare feedback", 0), ("twins", 1)]
)
def test_a_recording_whose_inputs_tell_nothing_is_refused(kind: str, rank: int) -> None:
    rng, times = np.random.default_rng(0), np.arange(200.0)[:, np.newaxis]
    y = np.cumsum(rng.standard_normal((200, 1)), axis=0)
    inputs = {
        "zero": np.zeros((200, 1)),
        "constant": np.full((200, 1), 0.3),
        "sine": np.sin(times),
        "bare feedback": 2.0 - 0.5 * y,
        "twins": np.repeat(rng.uniform(-1.0, 1.0, (200, 1)), 2, axis=1),
    }
    u = inputs[kind]
    loop = loop_of(u.shape[1], 1, Recording(u, y, y, H))
    with pytest.raises(
        DataError, match=rf"rank {rank} of {u.shape[1]}, smallest .* order \d+\): record with"
    ):
        Identified(lags=4).model(loop)


def test_a_recording_in_closed_loop_with_an_excitation_is_accepted() -> None:
    rng = np.random.default_rng(0)
    plant = LinearPlant(np.array([[1.1]]), np.array([[0.5]]), np.eye(1))
    u, y, state = np.zeros((200, 1)), np.zeros((200, 1)), np.zeros(1)
    for k in range(200):
        y[k] = state
        u[k] = -1.2 * y[k] + 1e-3 * rng.uniform(-1.0, 1.0, 1)
        state = plant.advance(state, u[k])
    model = Identified().model(loop_of(1, 1, Recording(u, y, y, H)))
    assert markov_parameters(model, 3)[:, 0, 0] == pytest.approx([0.5, 0.55, 0.605], abs=1e-6)


def test_pulses_at_a_plant_give_its_derivative_at_the_operating_point() -> None:
    angle = np.arcsin(1.5 / 9.81)
    model = pulse_model(Pendulum(), H, operating_input=[1.5], settling_samples=300)
    stiffness = 9.81 / 0.2 * np.cos(angle)
    by_hand = StateSpace(a=[[0.0, 1.0], [-stiffness, -2.0]], b=[[0.0], [5.0]], c=[[1.0, 0.0]])
    response = markov_parameters(model.model(loop_of(1, 1)), 30)
    expected = markov_parameters(by_hand.model(loop_of(1, 1)), 30)
    assert len(model.a) == 2
    assert np.abs(response - expected).max() < 1e-6
    assert model.y_0 == pytest.approx([angle], abs=1e-8)
    assert tuple(model.u_0) == (1.5,)


def test_pulses_at_an_fmu_give_the_derivatives_of_its_equations(pendulum_fmu: Path) -> None:
    angle = np.arcsin(1.5 / 9.81)
    exact = StateSpace.about(linearise(PENDULUM_MODEL, [angle, 0.0], [1.5]), u_0=[1.5], y_0=[angle, 0.0])
    with FMUPlant(pendulum_fmu, inputs=["torque"], outputs=["angle", "angular_velocity"]) as plant:
        pulsed = pulse_model(plant, H, operating_input=[1.5], settling_samples=300)
    loop = loop_of(1, 2)
    expected, identified = (markov_parameters(m.model(loop), 30) for m in (exact, pulsed))
    assert np.abs(identified - expected).max() < 1e-5
    assert pulsed.y_0 == pytest.approx([angle, 0.0], abs=1e-7)


def test_a_response_that_does_not_show_the_order_is_refused() -> None:
    with pytest.raises(ConfigError, match="shows 2 states, 5 are wanted"):
        pulse_model(Pendulum(), H, order=5)
    with pytest.raises(ConfigError, match="operating_input has shape"):
        pulse_model(Pendulum(), H, operating_input=[1.0, 2.0])


@pytest.mark.parametrize("states", [1, 4, 12])
def test_the_steady_filter_is_that_of_python_control(states: int) -> None:
    rng = np.random.default_rng(states)
    plant = LinearPlant.random(rng, states, 1, 2)
    drive = plant.b @ plant.b.T + np.eye(states)
    noise = np.diag([0.1, 2.0])
    _, expected, _ = control.dlqe(plant.a, np.eye(states), plant.c, drive, noise)
    assert estimator_covariance(plant.a, plant.c, drive, noise) == pytest.approx(
        expected, rel=1e-9, abs=1e-12
    )
