"""Sampling time and duration fit plants of every kind; the formulas are those of elementary systems."""

import math
import re
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import odeint
from scipy.linalg import expm
from scipy.optimize import linear_sum_assignment

from ddpc_cosim import FMUStepError, Plant, Variable
from ddpc_cosim.errors import StepStatus
from ddpc_cosim.suggestion import design
from ddpc_cosim.suggestion.choice import Choice, choose
from ddpc_cosim.suggestion.rates import with_rates
from ddpc_cosim.suggestion.request import Request
from ddpc_cosim.suggestion.response_types import ResponseType
from ddpc_cosim.suggestion.step_test import Resting, StepTest, Timing, step_test
from ddpc_cosim.suggestion.writing import Circumstances, hints
from ddpc_cosim.variables import FloatArray


class Linear(Plant):
    """x' = a x + b u(t - dead_time), y = c x + d u, exactly; under a clock, x changes at its ticks only."""

    def __init__(
        self,
        a: Any,
        b: Any,
        c: Any,
        d: float = 0.0,
        *,
        dead_time: float = 0.0,
        clock: float = 0.0,
        threshold: float = 0.0,
    ) -> None:
        self.a = np.atleast_2d(np.array(a, dtype=float))
        self.b = np.array(b, dtype=float).reshape(len(self.a), -1)
        self.c, self.d = np.array(c, dtype=float).reshape(-1, len(self.a)), d
        self.inputs = tuple(Variable(f"u{i}", min=-1.0, max=1.0) for i in range(self.b.shape[1]))
        self.outputs = tuple(Variable(f"y{j}") for j in range(len(self.c)))
        self.dead_time, self.clock, self.threshold = dead_time, clock, threshold
        self.transition = cache(self._transition)

    def _transition(self, h: float) -> FloatArray:
        n, m = self.b.shape
        return np.asarray(expm(h * np.block([[self.a, self.b], [np.zeros((m, n + m))]]))[:n])

    def reset(self, parameters: Mapping[str, Any] | None = None, t0: float = 0.0) -> FloatArray:
        self.t, self.x = 0.0, np.zeros(len(self.a))
        return self.c @ self.x

    def step(self, u: FloatArray, h: float) -> FloatArray:
        u = np.where(np.abs(u) > self.threshold, u, 0.0)
        begin, self.t = self.t, self.t + h
        if self.clock:
            ticks = int(self.t / self.clock + 1e-9) - int(begin / self.clock + 1e-9)
            durations = [self.clock] * ticks
        else:
            durations = [self.t - max(begin, self.dead_time)] if self.t > self.dead_time else []
        for duration in durations:
            self.x = self.transition(duration) @ np.concatenate((self.x, u))
        return self.c @ self.x + self.d * u[: len(self.c)]


def oscillator(frequency: float, damping: float) -> Linear:
    """w^2 / (s^2 + 2 damping w s + w^2)."""
    return Linear([[0, 1], [-(frequency**2), -2 * damping * frequency]], [0, frequency**2], [1, 0])


def proposed(plant: Linear, timing: Timing) -> tuple[StepTest, Choice, float, float]:
    """Return the step test, the choice, the sampling time and the duration."""
    rest, room = np.zeros(len(plant.inputs)), np.ones(len(plant.inputs))
    tested = step_test(plant, Resting(rest, room), timing)
    choice = choose(tested, room, timing.guess, all_outputs=False)
    sample = design.sampling_time(tested, choice, timing.step if timing.fixed else None, None)
    working = design.working_range(plant.inputs, design.input_bounds(plant.inputs)).of(choice.inputs)
    _, duration = design.setpoints(tested, choice, plant.outputs, working, sample, Request())
    return tested, choice, sample, duration


def obstacles(tested: StepTest, plant: Linear) -> list[str]:
    """Return what may keep any controller from settling."""
    room = np.ones(len(plant.inputs))
    choice = choose(tested, room, 10.0, all_outputs=False)
    return list(hints(Circumstances(plant.inputs, plant.outputs, tested, choice, 1.0, False), room))


OPEN = Timing(1e-4, longest=1e5)
"""An FMU that says nothing about time."""


def fixed(step: float) -> Timing:
    return Timing(step, longest=1e5, fixed=True, blocks=8)


# time constant that matters, and how long a response takes to settle
SETTLING: dict[str, tuple[Linear, Timing, float, float]] = {
    "lag": (Linear(-1, 1, 1), OPEN, 1.0, 3.0),
    "fast lag": (Linear(-1e3, 1e3, 1), OPEN, 1e-3, 3e-3),
    "thermal": (Linear(-1 / 600, 1 / 600, 1), OPEN, 600.0, 1800.0),
    # y = u + 0.2 x: 5 % of 1.2 are left when exp(-t / T) = 0.3
    "feedthrough": (Linear(-0.1, 0.1, 0.2, 1.0), OPEN, 10.0, 12.0),
    "feedthrough, thermal": (Linear(-1 / 600, 1 / 600, 0.2, 1.0), OPEN, 600.0, 600 * np.log(0.2 / 0.06)),
    "feedthrough, equal steps": (Linear(-0.1, 0.1, 0.2, 1.0), fixed(0.5), 10.0, 12.0),
    "1 ms beside 10 s": (Linear(np.diag([-1e3, -0.1]), [1e3, 0.1], [1, 0.5]), OPEN, 10.0, 19.0),
    "1 ms before 10 s": (Linear([[-1e3, 0], [0.1, -0.1]], [1e3, 0], [0, 1]), OPEN, 10.0, 30.0),
    "dead time": (Linear(-0.2, 0.2, 1, dead_time=1.0), OPEN, 5.0, 16.0),
    "mostly dead time": (Linear(-10, 10, 1, dead_time=1.0), OPEN, 1.0, 1.3),
    "non-minimum phase": (Linear([[0, 1], [-1, -2]], [0, 1], [1, -2]), OPEN, 1.0, 6.0),
    "a clock of its own": (Linear(-1, 1, 1, clock=0.1), OPEN, 1.0, 3.0),
}


@pytest.mark.parametrize("name", SETTLING)
def test_a_time_constant_has_five_to_thirty_samples_and_a_setpoint_time_to_settle(name: str) -> None:
    plant, timing, constant, settling = SETTLING[name]
    tested, choice, sample, duration = proposed(plant, timing)
    assert not choice.guessed
    assert not tested.static
    assert choice.time_scale == pytest.approx(settling, rel=0.15)
    assert 4.99 <= constant / sample <= 30.01
    assert duration >= 2 * settling


@pytest.mark.parametrize("share", [-0.5, 0.2, 0.8, 0.93])
@pytest.mark.parametrize(
    ("constant", "timing"),
    [(0.02, OPEN), (1800.0, OPEN), (10.0, fixed(0.5))],
    ids=["fast", "thermal", "equal steps"],
)
def test_what_comes_at_once_is_no_part_of_the_time_constant(
    share: float, constant: float, timing: Timing
) -> None:
    """y = s u + (1 - s) x: what takes its time is a lag of first order, whatever s is."""
    plant = Linear(-1 / constant, 1 / constant, 1 - share, share)
    _, choice, sample, duration = proposed(plant, timing)
    assert not choice.guessed
    assert 4.99 <= constant / sample <= 20.01
    assert duration >= 6 * constant


@pytest.mark.parametrize("fast", [0.2, 0.3, 0.35])
def test_what_is_not_at_once_but_five_to_thirty_times_as_fast_is_sampled(fast: float) -> None:
    """Half of the way by a lag of its own: no feedthrough."""
    plant = Linear(np.diag([-1 / fast, -0.1]), [1 / fast, 0.1], [0.5, 0.5])
    _, _, sample, _ = proposed(plant, OPEN)
    assert sample <= fast


@pytest.mark.parametrize(("frequency", "damping"), [(1.0, 0.1), (100.0, 0.05), (1.0, 0.01)])
def test_an_oscillation_has_ten_samples_per_period_and_time_to_settle(
    frequency: float, damping: float
) -> None:
    _, choice, sample, duration = proposed(oscillator(frequency, damping), OPEN)
    assert 2 * np.pi / frequency / sample >= 10
    assert duration >= 2 * choice.time_scale
    assert choice.time_scale == pytest.approx(np.log(20) / (damping * frequency), rel=0.3)


def test_what_swings_by_many_times_where_it_ends_is_sampled_by_its_swing() -> None:
    """A pressure that builds up at once and swings at 150 rad/s by ten times what is left of it."""
    plant = Linear([[0, 1], [-(150.0**2), -15.0]], [150.0, 0.1 * 150.0**2], [1, 0])
    _, _, sample, _ = proposed(plant, OPEN)
    assert 10 <= 2 * np.pi / 150.0 / sample <= 60


def test_a_slow_output_beside_a_fast_one_reaches_its_setpoints() -> None:
    """1 s and 100 s: the fast one is sampled, the slow one has time to settle."""
    _, _, sample, duration = proposed(Linear(np.diag([-1, -0.01]), np.diag([1, 0.01]), np.eye(2)), OPEN)
    assert sample <= 2.0
    assert duration >= 4 * 300


@pytest.mark.parametrize(
    ("plant", "timing", "doubling"),
    [
        (Linear(3, 1, 1), OPEN, np.log(2) / 3),
        (Linear(3, 1, 1), fixed(0.01), np.log(2) / 3),
        (Linear(0.01, 1, 1), OPEN, np.log(2) / 0.01),
    ],
)
def test_an_unstable_plant_is_sampled_five_times_per_time_constant(
    plant: Linear, timing: Timing, doubling: float
) -> None:
    tested, _, sample, _ = proposed(plant, timing)
    assert tested.responses[0][0].rise_time == pytest.approx(doubling, rel=0.02)
    assert 5 <= doubling / np.log(2) / sample <= 10


def test_an_input_that_moves_only_outputs_left_out_is_left_out() -> None:
    # y1 is y0, but for a little of the second input: not worth an output of its own.
    _, choice, _, _ = proposed(Linear(np.diag([-1, -1]), np.eye(2), [[1, 0], [1, 0.01]]), OPEN)
    assert (choice.inputs, choice.outputs) == ((0,), (0,))


def test_what_runs_away_within_one_block_of_equal_steps_is_unstable_not_insensitive() -> None:
    plant, timing = Linear(1, 1, 1), fixed(1.0)  # 10^30 after 69 steps, where intervals are 2 to 3 of them
    for begin in (0.9, 1.0, 1.1):  # one run may be an interval longer than the other: nine times as far
        tested = step_test(plant, Resting(np.array([begin]), np.array([begin])), timing)
        assert tested.fault
        assert tested.responses[0][0].rise_time == pytest.approx(np.log(2), rel=0.05)


@pytest.mark.parametrize(
    "plant",
    [
        Linear(0, 1, 1),
        Linear(0, 1, 1, clock=0.01),
        Linear([[0, 0], [1, 0]], [1, 0], [0, 1]),
        Linear(-1, 0, 1, 4.0),
    ],
    ids=["integrator", "clocked integrator", "two integrators", "static"],
)
def test_what_has_no_time_scale_gets_a_guess_that_no_small_error_decides(plant: Linear) -> None:
    _, choice, sample, _ = proposed(plant, Timing(1e-4, longest=50.0, guess=6.0))
    assert choice.guessed
    assert sample == pytest.approx(6.0 / 30)


def test_an_integrator_behind_a_lag_is_sampled_as_the_lag_needs_it() -> None:
    _, choice, sample, _ = proposed(Linear([[-2, 0], [1, 0]], [2, 0], [0, 1]), OPEN)
    assert choice.time_scale == pytest.approx(10 * 0.5, rel=0.02)
    assert 0.5 / sample == pytest.approx(5)


class Switched(Linear):
    """The same of a switch that any input closes."""

    def step(self, u: FloatArray, h: float) -> FloatArray:
        return super().step(np.sign(u), h)


@pytest.mark.parametrize("plant", [Switched(-1, 1, 1), Switched(-1, 0, 1, 1.0)], ids=["lag", "static"])
def test_a_switch_is_not_taken_for_an_instability(plant: Linear) -> None:
    """Neither shrinks with the step, but what leaves an equilibrium takes longer from nearer to it."""
    tested, _, _, _ = proposed(plant, OPEN)
    assert not tested.unstable
    assert tested.responses[0][0].type is ResponseType.SETTLED
    assert tested.responses[0][0].effect == pytest.approx(1.0, rel=0.01)
    assert obstacles(tested, plant) == ["u0 acts like a switch: a thousandth of the step does as much"]


class Altered(Linear):
    """The same with outputs between two limits, a second input that is held, and an end."""

    limit, held, end = np.inf, 0.0, np.inf

    def step(self, u: FloatArray, h: float) -> FloatArray:
        y = super().step(np.append(u, self.held)[: self.b.shape[1]], h)
        return np.clip(y, -self.limit, self.limit) if self.t < self.end else y * np.nan


def test_an_integrator_that_stops_at_a_limit_is_not_taken_for_an_instability() -> None:
    """After a step of 0.1 it is at 1 within 0.05 s, after a thousandth of that within 50 s."""
    plant = Altered(0, 200, 1)
    plant.limit = 1.0
    tested, choice, _, _ = proposed(plant, Timing(1e-3, longest=1e3))
    assert not tested.unstable
    assert tested.responses[0][0].type is ResponseType.INTEGRATING
    assert tested.responses[0][0].slope == pytest.approx(20.0, rel=0.01)
    assert design.limits(tested, choice) == pytest.approx([0.5])
    assert obstacles(tested, plant) == ["y0 integrates until it stops at 1, a limit of its own"]


def test_what_is_only_ever_used_up_is_not_controlled_if_something_can_be_held() -> None:
    """An energy grows by 1 + 0.5 u per second whatever u is; an angle integrates u."""
    plant = Altered(np.zeros((2, 2)), [[0.5, 1.0], [1.0, 0.0]], np.eye(2))
    plant.inputs, plant.held = plant.inputs[:1], 1.0
    assert proposed(plant, OPEN)[1].outputs == (1,)
    plant.c, plant.outputs = np.array([[1.0, 0.0]]), plant.outputs[:1]
    tested, choice, _, _ = proposed(plant, OPEN)
    assert choice.outputs == (0,)
    assert re.fullmatch(
        r"y0: the inputs move it by .* while they rest \(--range u0=LO:HI if it may go further\)",
        obstacles(tested, plant)[0],
    )


def test_a_plant_that_fails_by_itself_is_told_as_the_reason() -> None:
    plant = Altered(-1, 1, 1)
    plant.end = 5.0
    tested, *_ = proposed(plant, OPEN)
    assert re.match(
        r"with constant inputs the plant itself fails after 4\.\d+ s: ", obstacles(tested, plant)[0]
    )


def test_a_relay_that_needs_more_than_a_tenth_is_found() -> None:
    tested, _, _, _ = proposed(Linear(-1, 1, 1, threshold=0.7), OPEN)
    assert tested.steps == [1.0]
    text = "u0 has a threshold: a step of 0.1 does nothing, one of 1 does"
    assert obstacles(tested, Linear(-1, 1, 1)) == [text]
    assert tested.responses[0][0].type is ResponseType.SETTLED
    assert tested.responses[0][0].effect == pytest.approx(1.0, rel=0.01)


@pytest.mark.parametrize(
    ("request_", "stop", "step", "scale"),
    [
        (Request(sampling_time=0.5), 100.0, 1.0, 15.0),
        (Request(duration=50.0), 100.0, 1.0, 5.0),
        (Request(), 100.0, 1.0, 30.0),  # 100 steps of a loop
        (Request(), 100.0, 1e-4, 10.0),  # a million steps of an integrator
        (Request(), 0.0, 0.01, 0.3),
        (Request(), 100.0, None, 10.0),
        (Request(), 0.0, None, None),
    ],
)
def test_where_responses_tell_nothing_the_default_experiment_does(
    request_: Request, stop: float, step: float | None, scale: float | None
) -> None:
    assert design.guessed_time_scale(request_, stop, step) == (scale and pytest.approx(scale))


@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (2, 3), (4, 4), (4, 6)])
def test_every_output_has_the_input_that_moves_it_most(shape: tuple[int, int]) -> None:
    gains = np.random.default_rng(0).normal(size=shape)
    suggested = design.suggested_controllers(design.ScaledGains(gains, gains), may_record=True)
    _, pairing = linear_sum_assignment(np.abs(gains), maximize=True)
    assert suggested["pid"].settings["pairing"] == pairing.tolist()


class Valve(Linear):
    """Opens beyond half of its room, and fails there after a while."""

    def step(self, u: FloatArray, h: float) -> FloatArray:
        if abs(u[0]) > 0.4 and self.t > 0.5:
            raise FMUStepError("beyond its stroke", StepStatus.ERROR, self.t)
        return super().step(np.where([abs(u[0]) > 0.4, True], u, 0.0), h)


def test_a_larger_step_that_ends_early_is_told() -> None:
    """Also where another input has responded to a small one."""
    tested = step_test(Valve(-1, [[1, 1]], 1), Resting(np.zeros(2), np.ones(2)), OPEN)
    assert tested.fault == "beyond its stroke"
    assert tested.steps.tolist() == [0.5, 0.1]
    assert tested.responses[0][1].type is ResponseType.SETTLED


class Tolerant(Linear):
    """A solver's tolerance: the same error whatever the step is, later after a smaller one."""

    def __init__(self, level: float) -> None:
        super().__init__(-1, [[0.0]], 1)
        self.level = level

    def step(self, u: FloatArray, h: float) -> FloatArray:
        super().step(u, h)
        since = self.t / (1 + math.log(1 / abs(u[0]))) if u[0] else 0.0
        return np.array([self.level + 0.01 * (1 - math.exp(-((since / 5) ** 2)))])


def test_the_noise_of_a_solver_is_no_instability() -> None:
    """Of 300 K a hundredth is what tolerances leave; at 0 it is an equilibrium that the plant leaves."""
    resting = Resting(np.zeros(1), np.ones(1))
    noisy, unstable = (step_test(Tolerant(level), resting, OPEN) for level in (300.0, 0.0))
    assert noisy.responses[0][0].type is ResponseType.INSENSITIVE
    assert (noisy.unstable, unstable.unstable) == (frozenset(), {0})


class Kicked(Linear):
    """The same, with an output that is far away at the first samples: after a step, or at rest as well."""

    by, at_rest = 10.0, False

    def step(self, u: FloatArray, h: float) -> FloatArray:
        y = super().step(u, h)
        is_first = self.t < 2.5e-4
        return y + self.by * is_first * (1.0 if self.at_rest else u[: len(y)])


@pytest.mark.parametrize("at_rest", [False, True])
@pytest.mark.parametrize("constant", [1.0, 600.0])
def test_a_spike_at_the_first_samples_hides_nothing(constant: float, at_rest: bool) -> None:
    plant = Kicked(-1 / constant, 1 / constant, 1)
    plant.at_rest = at_rest
    _, choice, sample, _ = proposed(plant, OPEN)
    assert not choice.guessed
    assert 4.99 <= constant / sample <= 30.01


def test_what_takes_longer_than_a_tool_s_default_second_is_looked_at_for_days() -> None:
    """A house of 11 h in an experiment of 1 s is an integrator as far as one sees."""
    house = Linear(-1 / 4e4, 1 / 4e4, 1)
    timing = Timing(1e-5, longest=10.0, guess=0.06, beyond=1e6)
    _, choice, sample, _ = proposed(house, timing)
    assert not choice.guessed
    assert 5 <= 4e4 / sample <= 30


def test_an_integrator_is_one_for_days_and_keeps_its_guess() -> None:
    tested, choice, sample, _ = proposed(Linear(0, 1, 1), Timing(1e-5, longest=10.0, guess=6.0, beyond=1e6))
    assert choice.guessed
    assert sample == pytest.approx(0.2)
    assert tested.time[-1] < 1e4


def test_the_time_scale_is_that_of_what_is_controlled() -> None:
    """An output that the inputs hardly move beside others, and that is a hundred times as slow."""
    plant = Linear(np.diag([-1.0, -0.01]), [[1.0], [0.01]], np.eye(2))
    _, choice, sample, _ = proposed(plant, OPEN)
    assert choice.outputs == (0,)
    assert 1.0 / sample >= 5


def test_a_third_that_is_a_seventeenth_as_slow_is_sampled_too() -> None:
    """Air and walls of a house, 3.5 h and 60 h: a loop of a room does not wait for its walls."""
    fast, slow = 3.5 * 3600, 60 * 3600
    house = Linear(np.diag([-1 / fast, -1 / slow]), [1 / (3 * fast), 2 / (3 * slow)], [1.0, 1.0])
    _, choice, sample, _ = proposed(house, Timing(1e-4, longest=1e5, beyond=1e6))
    assert fast / 10 / 3 <= sample <= fast / 10 * 5
    assert choice.time_scale == pytest.approx(slow * np.log(2 / 3 / 0.05), rel=0.2)


def rates(plant: Linear) -> frozenset[int]:
    resting = Resting(np.zeros(1), np.ones(1))
    return with_rates(plant, resting, step_test(plant, resting, OPEN), None).rates


def test_of_what_falls_over_the_rate_is_told_from_the_angle() -> None:
    """omega' = 9 phi + u; in degrees per second and radians the units tell it."""
    assert rates(Linear([[0, 9], [1, 0]], [1, 0], np.eye(2))) == {0}
    assert rates(Linear([[0, 9], [1, 0]], [1, 0], [[0, 1], [1, 0]])) == {1}
    mixed = Linear([[0, 9], [1, 0]], [1, 0], np.diag([180 / np.pi, 1.0]))
    assert rates(mixed) == frozenset()
    mixed.outputs = Variable("a", "deg/s"), Variable("b", "rad")
    assert rates(mixed) == {0}


class Rod(Linear):
    """phi' = omega, omega' = 6 sin(phi) - 0.2 omega + u: it falls over, and a torque keeps it turning."""

    outputs: tuple[Variable, ...] = Variable("phi", "rad"), Variable("omega", "rad/s")

    def step(self, u: FloatArray, h: float) -> FloatArray:
        def slopes(x: FloatArray, t: float) -> list[float]:
            return [x[1], 6.0 * np.sin(x[0]) - 0.2 * x[1] + u[0]]

        self.x = odeint(slopes, self.x, [0.0, h], rtol=1e-8, atol=1e-12)[-1]
        return np.asarray(self.c @ self.x)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_angle_of_a_rod_that_turns_on_and_on_is_as_unstable_as_its_rate(order: tuple[int, int]) -> None:
    """Far from where it stood the angle integrates; lambda = -0.1 + sqrt(0.01 + 6) where it stood."""
    plant = Rod(np.zeros((2, 2)), np.zeros((2, 1)), np.eye(2)[list(order)])
    plant.outputs = tuple(Rod.outputs[k] for k in order)
    resting, timing = Resting(np.zeros(1), np.array([20.0])), Timing(2e-3, longest=20.0, blocks=9)
    before = step_test(plant, resting, timing)
    angle, rate = order.index(0), order.index(1)
    assert [any(r.is_unstable for r in before.responses[j]) for j in (angle, rate)] == [False, True]
    tested = with_rates(plant, resting, before, None)
    eigenvalue = np.sqrt(0.01 + 6.0) - 0.1
    assert tested.responses[angle][0].rise_time == pytest.approx(np.log(2) / eigenvalue, rel=0.1)
    effects = [tested.responses[j][0].effect for j in (angle, rate)]
    assert effects[0] == pytest.approx(effects[1] / eigenvalue, rel=0.1)
    assert choose(tested, resting.room, 10.0, all_outputs=False).outputs == (angle,)


def test_a_stable_output_beside_what_falls_over_is_not_its_integral() -> None:
    """Of x' = 3 x + u and z' = x - z, z is no integral of x."""
    plant = Linear([[3.0, 0.0], [1.0, -1.0]], [1, 0], np.eye(2))
    assert rates(plant) == frozenset()


def test_outputs_that_run_away_side_by_side_are_no_rates_of_each_other() -> None:
    assert rates(Linear(np.diag([3.0, 2.0]), [1, 1], np.eye(2))) == frozenset()
    assert rates(Linear(3.0, 1, [1.0, 2.0])) == frozenset()
