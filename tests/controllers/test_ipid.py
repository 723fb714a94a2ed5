"""Intelligent PID: the estimates of the ultra-local model, and the loop that they close."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.linalg import expm

from ddpc_controllers.ipid import IPID, UltraLocalModel
from ddpc_cosim import Action, ConfigError, FloatArray, Recording, Sample

from .loops import SAMPLING_TIME, LinearPlant, close_loop, make_loop, together_and_alone

FREE = np.array([np.inf])


def integrator_chain(order: int, h: float) -> LinearPlant:
    """Return y^(order) = u + F over one sample; the last state is the constant F."""
    continuous = np.zeros((order + 2, order + 2))  # derivatives of y, F, and the input held
    for i in range(order):
        continuous[i, i + 1] = 1.0
    continuous[order - 1, order + 1] = 1.0
    discrete = expm(h * continuous)
    return LinearPlant(discrete[:-1, :-1], discrete[:-1, -1:], np.eye(1, order + 1))


@settings(deadline=None, max_examples=60)
@given(
    st.integers(1, 2), st.integers(2, 8), st.floats(-3.0, 3.0), st.floats(0.1, 4.0), st.integers(0, 2**32 - 1)
)
def test_the_estimates_are_exact_where_f_is_constant(
    order: int, window: int, force: float, alpha: float, seed: int
) -> None:
    rng, h = np.random.default_rng(seed), 0.05
    plant = integrator_chain(order, h)
    state = np.append(rng.standard_normal(order), force)
    model = UltraLocalModel(order, window, h, np.array([[alpha]]))
    model.start(state[:1], np.zeros(1))
    for u in rng.uniform(-2.0, 2.0, (window + 3, 1)):
        state = plant.advance(state, alpha * u)
        model.append(u, state[:1])
    assert model.estimates()[:, 0] == pytest.approx(state, abs=1e-8)
    expected = plant.advance(state, np.array([alpha * 0.7]))[:1]
    assert model.ahead(np.array([0.7])) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("h", [1e-10, 1.0, 1e10])
def test_the_estimates_do_not_depend_on_the_unit_of_time(order: int, h: float) -> None:
    # In units of the sampling time the plant is always the same.
    plant, rng = integrator_chain(order, 1.0), np.random.default_rng(4)
    state = np.append(rng.standard_normal(order), -0.7)
    model = UltraLocalModel(order, 4, h, np.array([[2.0]]))
    model.start(state[:1], np.zeros(1))
    for u in rng.uniform(-2.0, 2.0, (6, 1)):
        state = plant.advance(state, u)
        model.append(u / (2.0 * h**order), state[:1])
    scaled = model.estimates()[:, 0] * h ** np.arange(order + 1)
    assert scaled == pytest.approx(state, abs=1e-10)


def test_the_first_order_law_is_the_published_one() -> None:
    # Two samples: F is the slope of the output less alpha times the input that was held.
    controller = IPID(alpha=2.0, kp=3.0, window=1)
    controller.start(make_loop(None, FREE, FREE))
    u = 0.0
    for k, (y, before) in enumerate([(0.0, 0.0), (0.1, 0.0), (0.15, 0.1), (-0.1, 0.15)]):
        disturbance = (y - before) / SAMPLING_TIME - 2.0 * u
        expected = (-disturbance + 3.0 * (1.0 - y)) / 2.0
        applied = controller.step(
            Sample(k, 0.1 * k, np.array([y]), np.array([y]), np.ones((1, 1)), np.ones(1))
        )
        assert applied == pytest.approx([expected])
        u = expected


def step_response(controller: IPID, plant: LinearPlant, target: float = 1.0) -> FloatArray:
    """Return the outputs of 200 samples."""
    loop, reference = make_loop(None, 5.0 * np.ones(1), FREE), np.full((201, 1), target)
    return close_loop(controller, loop, plant.advance, plant.c, reference, steps=200).y[:, 0]


def test_an_unknown_load_leaves_no_offset() -> None:
    # y' = -2 y + 3 u: with alpha = 3 everything else is F.
    plant = LinearPlant(np.array([[np.exp(-0.2)]]), np.array([[1.5 * (1.0 - np.exp(-0.2))]]), np.eye(1))
    assert step_response(IPID(alpha=3.0, kp=1.0), plant)[-1] == pytest.approx(1.0, abs=1e-5)


def test_an_integral_removes_what_a_wrong_alpha_leaves_of_a_ramp() -> None:
    plant = integrator_chain(1, SAMPLING_TIME)
    reference = np.arange(301)[:, np.newaxis] * 0.01
    errors = []
    for ki in (0.0, 0.5):
        loop = make_loop(None, FREE, FREE)
        run = close_loop(IPID(alpha=1.5, kp=1.0, ki=ki), loop, plant.advance, plant.c, reference, steps=300)
        errors.append(abs(run.y[-1, 0] - reference[300, 0]))
    assert errors[1] < 0.1 * errors[0]


def test_the_integral_stands_still_at_a_limit() -> None:
    controller = IPID(alpha=1.0, kp=1.0, ki=1.0)
    controller.start(make_loop(None, np.array([0.5]), FREE))
    y, far, near = np.zeros(1), np.full((1, 1), 100.0), np.full((1, 1), -0.2)
    for k in range(50):
        assert controller.step(Sample(k, 0.1 * k, y, y, far, far[0])) == pytest.approx([0.5])
    # The plant does not move under 0.5, so that F = -0.5; the error of -0.2 is all that was integrated.
    expected = 0.5 - 0.2 - 0.2 * SAMPLING_TIME
    assert controller.step(Sample(50, 5.0, y, y, near, near[0])) == pytest.approx([expected])


def test_two_pairs_are_two_loops() -> None:
    alpha, plants = np.array([1.0, -2.0]), [LinearPlant.lag(0.95, 0.1), LinearPlant.lag(0.8, -0.2)]
    reference = np.tile([[1.0, -0.5]], (61, 1))
    both, alone = together_and_alone(
        lambda chosen: IPID(alpha=alpha[chosen].tolist()), plants, 1.0, reference, 60
    )
    assert np.abs(both - alone).max() < 1e-12


def test_inputs_that_act_crosswise_change_nothing_but_their_order() -> None:
    # u1 drives y0, whose reference is out of reach, and u0 drives y1.
    plants = [LinearPlant.lag(0.9, 0.1), LinearPlant.lag(0.8, 0.2)]
    a, b = (np.diag([getattr(plant, name).item() for plant in plants]) for name in "ab")
    reference = np.vstack([np.tile([[5.0, 0.3]], (60, 1)), np.tile([[0.2, 0.3]], (61, 1))])
    straight, crossed = (
        close_loop(
            IPID(alpha=alpha.tolist(), ki=1.0),
            make_loop(None, np.ones(2), np.repeat(FREE, 2)),
            LinearPlant(a, b @ alpha, np.eye(2)).advance,
            np.eye(2),
            reference,
            steps=120,
        )
        for alpha in (np.eye(2), np.eye(2)[::-1])
    )
    assert np.abs(crossed.u[:, ::-1] - straight.u).max() < 1e-12


def test_a_missing_measurement_is_bridged_and_counted() -> None:
    plant, state = integrator_chain(2, SAMPLING_TIME), np.array([0.5, 0.0, 0.2])
    bridged, seeing = (IPID(order=2, kp=1.0, kd=2.0) for _ in range(2))
    for controller in (bridged, seeing):
        controller.start(make_loop(None, FREE, FREE))
    for k in range(30):
        y = state[:1].copy()
        seen = np.array([np.nan]) if k == 20 else y
        u = seeing.step(Sample(k, 0.1 * k, y, y, np.zeros((1, 1)), np.zeros(1)))
        answer = bridged.step(Sample(k, 0.1 * k, seen, seen, np.zeros((1, 1)), np.zeros(1)))
        if k == 20:
            assert isinstance(answer, Action)
            assert "replaced by what the model expects" in answer.status
            answer = answer.u
        assert answer == pytest.approx(u, abs=1e-9)
        state = plant.advance(state, u)


def test_without_any_measurement_the_input_rests() -> None:
    controller = IPID()
    controller.start(make_loop(None, FREE, FREE))
    answer = controller.step(Sample(0, 0.0, np.array([np.nan]), np.zeros(1), np.zeros((1, 1)), np.zeros(1)))
    assert isinstance(answer, Action)
    assert answer.u == [0.0]
    assert "no finite measurement yet" in answer.status


def test_it_goes_on_where_a_recording_ended() -> None:
    plant, rng = integrator_chain(2, SAMPLING_TIME), np.random.default_rng(2)
    u = rng.uniform(-1.0, 1.0, (8, 1))
    states = [np.array([0.5, 0.3, -0.4])]
    for held in u:
        states.append(plant.advance(states[-1], held))
    y = np.array(states)[:, :1]
    recording = Recording(u, y[:-1], y[:-1], SAMPLING_TIME)
    controller = IPID(order=2, kp=1.0, kd=2.0, window=3)
    controller.start(make_loop(recording, FREE, FREE, continues_recording=True))
    position, velocity, force = states[-1]
    expected = -force - position - 2.0 * velocity
    applied = controller.step(Sample(0, 0.0, y[-1], y[-1], np.zeros((1, 1)), np.zeros(1)))
    assert applied == pytest.approx([expected])


def test_settings_that_do_not_fit_each_other_are_named_together() -> None:
    with pytest.raises(ConfigError) as caught:
        IPID(order=1, kd=1.0, alpha=1.0, window=0)
    assert "window" in str(caught.value)
    with pytest.raises(ConfigError, match="window = 1 is shorter than order = 2"):
        IPID(order=2, window=1)
    with pytest.raises(ConfigError, match="kd = 1 needs order = 2"):
        IPID(kd=1.0)


@pytest.mark.parametrize(
    ("alpha", "inputs", "outputs", "message"),
    [
        (1.0, 2, 1, "as many inputs as outputs; there are 2 inputs, 1 outputs"),
        ([1.0, 2.0, 3.0], 2, 2, r"alpha has shape \(3,\); needed: a number or 2 numbers"),
        ([[1.0, 2.0]], 2, 2, r"alpha has shape \(1, 2\)"),
        ([[1.0, 2.0], [2.0, 4.0]], 2, 2, "has no inverse"),
        (0.0, 1, 1, "has no inverse"),
    ],
)
def test_an_alpha_that_does_not_fit_the_loop_is_refused(
    alpha: object, inputs: int, outputs: int, message: str
) -> None:
    controller = IPID(alpha=alpha)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=message):
        controller.start(make_loop(None, np.ones(inputs), np.ones(outputs)))
