"""Offset-free tracking: what holds the estimate, which outputs it concerns, and what dead time does to it."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ddpc_controllers.models.identification import Identified
from ddpc_controllers.mpc import MPC
from ddpc_controllers.offset_free import OffsetFree, projector, step_gain
from ddpc_cosim import Action, Bounds, Controller, FloatArray, Loop, Recording, Sample, setting

from .loops import LinearPlant, close_loop, experiment, make_loop, printed_deepc

DECOUPLED = LinearPlant(np.diag([0.9, 0.8]), np.diag([0.1, 0.2]), np.eye(2))
COUPLED = LinearPlant(np.diag([0.9, 0.8]), np.array([[0.1, 0.05], [0.08, 0.2]]), np.eye(2))
PUSH = np.array([0.05, 0.04])
"""A disturbance that the recording does not know."""


@dataclass(kw_only=True)
class Constant(Controller):
    """Answers with the same inputs, whatever happens."""

    u: float = setting(doc="every input")
    horizon: int = setting(1, low=1, doc="samples of reference")

    def start(self, loop: Loop) -> None:
        self.inputs = len(loop.inputs)

    def step(self, sample: Sample) -> FloatArray:
        return np.full(self.inputs, self.u)


def recorded(plant: LinearPlant, samples: int = 300) -> Recording:
    """An experiment with all inputs between -1 and 1."""
    u = np.random.default_rng(0).uniform(-1.0, 1.0, (samples, plant.b.shape[1]))
    return experiment(plant.advance, u, len(plant.a), plant.c)


def dead_time(samples: int) -> LinearPlant:
    """A first-order lag of gain one whose input comes late."""
    a = np.diag(np.ones(samples), -1)
    a[0, 0] = 0.0
    a[-1, -1], a[-1, -2] = 0.8, 0.2
    b = np.zeros((samples + 1, 1))
    b[0] = 1.0
    return LinearPlant(a, b, np.eye(1, samples + 1, samples))


def outputs(
    controller: Controller, loop: Loop, plant: LinearPlant, reference: FloatArray, push: FloatArray
) -> FloatArray:
    """Return what becomes of the outputs while the disturbance acts on the inputs."""
    return close_loop(
        controller, loop, lambda x, u: plant.advance(x, u + push), plant.c, reference, len(reference) - 40
    ).y


def limited_loop(plant: LinearPlant, low: list[float], high: list[float], known: bool = True) -> Loop:
    """A loop with input limits of its own, with or without a recording."""
    free = np.full(len(plant.c), np.inf)
    bounds = Bounds(np.array(low), np.array(high), -free, free)
    return make_loop(recorded(plant) if known else None, np.ones(len(low)), free, bounds=bounds)


def largest(controller: OffsetFree, outputs: int) -> list[float]:
    """Return the largest estimates so far."""
    return [controller.diagnostics()[f"largest_disturbance[{i}]"] for i in range(outputs)]


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize(
    ("low", "high", "u"),
    [
        (-1.0, 2.0, 2.0 - 1e-12),
        (-1.0, 2.0, -1.0 + 1e-12),
        (-np.inf, 2.0, 2.0 - 1e-12),
        (-1.0, np.inf, -1.0 + 1e-12),
    ],
)
def test_an_input_next_to_its_limit_is_at_its_limit(scale: float, low: float, high: float, u: float) -> None:
    controller = OffsetFree(controller=Constant(u=scale * u))
    controller.start(limited_loop(LinearPlant.lag(0.9, 0.1), [scale * low], [scale * high]))
    for k in range(20):
        controller.step(Sample(k, 0.1 * k, np.zeros(1), np.zeros(1), np.ones((1, 1)), np.ones(1)))
    assert largest(controller, 1) == [0.0]


def test_an_input_within_its_limits_is_not() -> None:
    controller = OffsetFree(controller=Constant(u=2.0 - 1e-6))
    controller.start(limited_loop(LinearPlant.lag(0.9, 0.1), [-1.0], [2.0]))
    for k in range(20):
        controller.step(Sample(k, 0.1 * k, np.zeros(1), np.zeros(1), np.ones((1, 1)), np.ones(1)))
    # d_k+1 = d_k + gain (y - y^ - d) with y = 0 for ever: the sum of what the lag expects, with gain 0.2.
    phi, expected, d = np.exp(-0.5), 0.0, 0.0
    for _ in range(19):
        expected = phi * expected + (1.0 - phi) * (1.0 - d)
        d += 0.2 * (-expected - d)
    assert largest(controller, 1) == pytest.approx([-d])


@pytest.mark.parametrize(
    ("horizon", "share"), [(1, 0.2), (5, 0.2), (20, 0.05)], ids=["one sample", "short", "long"]
)
def test_the_default_gain_is_one_over_the_horizon_but_a_fifth_at_most(horizon: int, share: float) -> None:
    for gain in (0.0, share):
        controller = OffsetFree(controller=Constant(u=0.0, horizon=horizon), gain=gain)
        controller.start(make_loop(None, np.ones(1), np.full(1, np.inf)))
        for k, y in enumerate([0.0, 0.3]):
            controller.step(
                Sample(k, 0.1 * k, np.array([y]), np.array([y]), np.zeros((horizon, 1)), np.zeros(1))
            )
        assert largest(controller, 1) == pytest.approx([0.3 * share])


@pytest.mark.parametrize("late", [3, 10, 18])
@pytest.mark.parametrize("spare", [2, 20])
def test_a_dead_time_within_the_horizon_leaves_the_loop_stable(late: int, spare: int) -> None:
    plant = dead_time(late)
    loop = make_loop(recorded(plant, 400), np.full(1, 2.0), np.full(1, np.inf))
    inner = MPC(model=Identified(lags=late + 2), horizon=late + spare, disturbance="none")
    reference, push = np.full((940, 1), 0.5), np.array([0.1])
    assert np.abs(outputs(inner, loop, plant, reference, push)[-100:] - 0.5).max() > 0.05
    controller = OffsetFree(controller=inner)
    assert np.abs(outputs(controller, loop, plant, reference, push)[-100:] - 0.5).max() < 1e-6
    assert largest(controller, 1)[0] < 1.0


@pytest.mark.parametrize("known", [True, False], ids=["recording", "no recording"])
def test_an_input_without_room_does_not_stop_the_correction_of_the_other(known: bool) -> None:
    loop = limited_loop(DECOUPLED, [-1.0, 0.1], [1.0, 0.1], known)
    inner: Controller = Proportional()
    reference = np.tile([0.5, 0.4], (340, 1))
    assert abs(outputs(inner, loop, DECOUPLED, reference, PUSH)[-1, 0] - 0.5) > 0.1
    controller = OffsetFree(controller=inner)
    assert abs(outputs(controller, loop, DECOUPLED, reference, PUSH)[-1, 0] - 0.5) < 1e-6
    if known:  # that no input is left for the other output
        assert largest(controller, 2)[1] < 1e-9


@dataclass(kw_only=True)
class Proportional(Controller):
    """Each input is three times the error of its output, within its limits: there is an offset."""

    def start(self, loop: Loop) -> None:
        self.bounds = loop.bounds

    def step(self, sample: Sample) -> FloatArray:
        wanted = 3.0 * (sample.reference[0] - sample.y)
        return np.asarray(np.clip(wanted, self.bounds.u_min, self.bounds.u_max))


def test_an_output_out_of_reach_neither_winds_up_nor_stops_the_correction_of_the_other() -> None:
    loop = limited_loop(DECOUPLED, [-1.0, -1.0], [1.0, 0.3])
    reference = np.vstack([np.tile([0.5, 0.9], (400, 1)), np.tile([0.5, 0.2], (140, 1))])
    controller = OffsetFree(controller=MPC(horizon=8, disturbance="none"))
    y = outputs(controller, loop, DECOUPLED, reference, PUSH)
    assert y[380] == pytest.approx([0.5, 0.34], abs=1e-3)
    assert abs(y[380, 0] - 0.5) < 1e-6
    assert np.abs(y[-1] - [0.5, 0.2]).max() < 1e-4
    assert max(largest(controller, 2)) < 0.5


def test_a_reference_out_of_reach_winds_the_estimate_up_to_the_output_limit_at_most() -> None:
    # DeePC's artificial setpoint keeps off the limits of the input, where it would be seen to be the cause.
    plant = LinearPlant.lag(0.8, 0.2)
    loop = make_loop(recorded(plant), np.full(1, 0.3), np.ones(1))
    reference = np.repeat([[0.9], [0.2]], [300, 100], axis=0)
    controller = OffsetFree(controller=printed_deepc(horizon=8, lambda_g=0.01))
    y = outputs(controller, loop, plant, reference, np.array([0.05]))
    assert y[250, 0] < 0.36
    assert largest(controller, 1)[0] < 0.2
    assert abs(y[-1, 0] - 0.2) < 1e-3


def test_without_a_recording_one_limited_input_holds_all_estimates() -> None:
    controller = OffsetFree(controller=Constant(u=1.0))
    controller.start(limited_loop(DECOUPLED, [-1.0, -1.0], [2.0, 1.0], known=False))
    for k in range(20):
        controller.step(Sample(k, 0.1 * k, np.zeros(2), np.zeros(2), np.ones((1, 2)), np.ones(2)))
    assert largest(controller, 2) == [0.0, 0.0]


def test_the_estimate_goes_on_after_a_reference_that_is_not_finite() -> None:
    controller = OffsetFree(controller=Constant(u=0.5), gain=0.5)
    controller.start(make_loop(None, np.ones(1), np.full(1, np.inf)))
    for r in (1.0, np.nan, 1.0, 1.0):
        controller.step(Sample(0, 0.0, np.zeros(1), np.zeros(1), np.full((1, 1), r), np.full(1, r)))
    # Nothing is known of the first sample, and of that after the gap; the lag has phi = exp(-1 / 2).
    first = 0.5 * (0.0 - (1.0 - np.exp(-0.5)))
    shifted = 1.0 - first
    expected = np.exp(-0.5) * (0.0 - first) + (1.0 - np.exp(-0.5)) * shifted
    assert largest(controller, 1)[0] == pytest.approx(abs(first + 0.5 * (0.0 - expected - first)), rel=1e-12)


def test_more_outputs_than_inputs_end_where_the_input_can_do_no_more() -> None:
    plant = LinearPlant(COUPLED.a, COUPLED.b[:, :1], COUPLED.c)
    loop = make_loop(recorded(plant), np.full(1, 9.0), np.full(2, np.inf))
    controller = OffsetFree(controller=printed_deepc(horizon=8, lambda_g=0.01))
    reference = np.tile([0.5, 0.1], (440, 1))
    y = outputs(controller, loop, plant, reference, PUSH[:1])
    recording = recorded(plant)
    error = (y[-1] - reference[0]) / recording.y.std(axis=0)
    direction = step_gain(recording, 8)[:, 0]
    assert np.linalg.norm(error) > 0.1
    assert abs(error @ direction) < 1e-6 * np.linalg.norm(error) * np.linalg.norm(direction)
    assert max(largest(controller, 2)) < 1.0


def test_the_step_gain_of_a_recording_is_that_of_the_plant() -> None:
    recording = recorded(COUPLED)
    answer, state = np.empty((2, 2)), np.zeros((2, 2))
    for j in range(2):
        for _ in range(25):
            state[j] = COUPLED.advance(state[j], np.eye(2)[j])
        answer[:, j] = COUPLED.c @ state[j]
    expected = answer * recording.u.std(axis=0) / recording.y.std(axis=0)[:, np.newaxis]
    assert step_gain(recording, 25) == pytest.approx(expected, rel=1e-6)


@given(st.integers(1, 3), st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_the_projector_leaves_what_free_inputs_do_and_takes_away_the_rest(p: int, m: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    gain, free = rng.uniform(0.5, 1.0, (p, m)) + 2.0 * np.eye(p, m), rng.random(m) < 0.5
    projection = projector(gain, free)
    assert projection == pytest.approx(gain[:, free] @ np.linalg.pinv(gain[:, free]), abs=1e-9)


def test_a_fallback_is_passed_on() -> None:
    class Failing(Constant):
        def step(self, sample: Sample) -> Action:  # type: ignore[override]
            return Action(np.full(1, self.u), "failed")

    controller = OffsetFree(controller=Failing(u=0.5))
    controller.start(make_loop(None, np.ones(1), np.ones(1)))
    answer = controller.step(Sample(0, 0.0, np.zeros(1), np.zeros(1), np.zeros((1, 1)), np.zeros(1)))
    assert isinstance(answer, Action)
    assert (answer.u.tolist(), answer.status) == ([0.5], "failed")
