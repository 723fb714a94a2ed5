"""The safety filter: the problem as printed, inputs that are left alone, limits that are kept."""

from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any

import daqp
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from ddpc_controllers import PID, SafetyFilter
from ddpc_cosim import Action, Bounds, ConfigError, Controller, FloatArray, Loop, Recording, Sample

from .loops import ANGLE, LinearPlant, close_loop, make_loop, paper_reference, pendulum_loop, quick_pendulum

PAST, AHEAD, LIMIT = 3, 12, 0.6
PLANT = LinearPlant(np.array([[1.5, -0.7], [1.0, 0.0]]), np.array([[1.0], [0.0]]), np.array([[0.1, 0.06]]))
"""It overshoots by a third of a step."""
OFFSET = 2.0
"""What the output is where the plant rests."""


@dataclass(kw_only=True)
class Wants(Controller):
    """Wants one input after the other, the last one for ever."""

    inputs: list[float] = field(default_factory=lambda: [0.0])

    def start(self, loop: Loop) -> None:
        pass

    def step(self, sample: Sample) -> FloatArray:
        return np.array([self.inputs[min(sample.k, len(self.inputs) - 1)]])


def recorded(seed: int, noise: float = 0.01, samples: int = 200) -> Recording:
    """An experiment about the resting output."""
    rng = np.random.default_rng(seed)
    u, x, y = rng.uniform(-1.0, 1.0, (samples, 1)), np.zeros(2), np.zeros((samples, 1))
    for k in range(samples):
        y[k] = OFFSET + PLANT.c @ x + noise * rng.standard_normal(1)
        x = PLANT.advance(x, u[k])
    return Recording(u, y, y, 0.1)


def loop_of(recording: Recording) -> Loop:
    """Return the loop of the plant, its output limited above and below its resting value."""
    loop = make_loop(recording, np.ones(1), np.ones(1))
    limits = np.array([OFFSET - LIMIT]), np.array([OFFSET + LIMIT])
    return replace(loop, bounds=Bounds(-np.ones(1), np.ones(1), *limits))


def sample_at(k: int, y: float) -> Sample:
    value = np.array([y])
    return Sample(k, 0.1 * k, value, value, np.zeros((1, 1)), np.zeros(1))


class Printed:
    """The filter's problem in all its inputs, from a model fitted to the samples one by one."""

    def __init__(self, recording: Recording, satisfaction: float = 0.0) -> None:
        u, y = recording.u[:, 0], recording.y[:, 0]
        self._row = self._fit(u, y)
        self.upper = np.full(AHEAD, OFFSET + LIMIT)
        self.lower = np.full(AHEAD, OFFSET - LIMIT)
        if satisfaction:
            self._draw_in(u, y, satisfaction)

    @staticmethod
    def _fit(u: FloatArray, y: FloatArray) -> FloatArray:
        """Return coefficients of y_k-3 ... y_k, u_k-3 ... u_k and 1 in y_k+1."""
        rows = [np.r_[y[k - PAST : k + 1], u[k - PAST : k + 1], 1.0] for k in range(PAST, len(y) - 1)]
        return np.linalg.lstsq(np.array(rows), y[PAST + 1 :], rcond=None)[0]

    @classmethod
    def _roll_out(cls, row: FloatArray, y: FloatArray, u: FloatArray, plan: FloatArray) -> FloatArray:
        """Return the outputs after those of the past, y_k-3 ... y_k and u_k-3 ... u_k-1, with a plan."""
        y, u = [*y], [*u, *plan]
        for i in range(len(plan)):
            y.append(row @ np.r_[y[i : i + PAST + 1], u[i : i + PAST + 1], 1.0])
        return np.array(y[PAST + 1 :])

    def _draw_in(self, u: FloatArray, y: FloatArray, satisfaction: float) -> None:
        """Draw the limits in by the residuals of the last quarter of the windows."""
        depth = PAST + 1 + AHEAD
        windows = len(y) - depth + 1
        tail = windows - round(windows / 4)
        row = self._fit(u[: tail - depth + depth], y[: tail - depth + depth])
        errors = np.array(
            [
                y[i + PAST + 1 : i + depth]
                - self._roll_out(row, y[i : i + PAST + 1], u[i : i + PAST], u[i + PAST : i + depth - 1])
                for i in range(tail, windows)
            ]
        )
        k = min(int(np.ceil((len(errors) + 1) * satisfaction)), len(errors)) - 1
        self.upper = self.upper - np.maximum(np.sort(errors, axis=0)[k], 0.0)
        self.lower = self.lower + np.maximum(np.sort(-errors, axis=0)[k], 0.0)

    def held(self, y: FloatArray, u: FloatArray, wanted: float) -> FloatArray:
        """Return the outputs where an input is held."""
        return self._roll_out(self._row, y, u, np.full(AHEAD, wanted))

    def first_input(self, y: FloatArray, u: FloatArray, wanted: float) -> float:
        """Return the first input of the optimal plan."""
        free = self._roll_out(self._row, y, u, np.zeros(AHEAD))
        gain = np.column_stack([self._roll_out(self._row, y, u, column) - free for column in np.eye(AHEAD)])
        changes = 1e-2 * np.diff(np.eye(AHEAD), axis=0)
        cost = np.vstack([np.eye(AHEAD)[:1], changes])
        target = np.r_[wanted, np.zeros(len(changes))]
        equal = np.diff(np.eye(AHEAD), axis=0)[-(AHEAD // 2) :]
        sides = np.vstack([np.eye(AHEAD), gain, equal])
        upper = np.r_[np.ones(AHEAD), self.upper - free, np.zeros(len(equal))]
        lower = np.r_[-np.ones(AHEAD), self.lower - free, np.zeros(len(equal))]
        kinds = np.repeat([0, 0, 5], [AHEAD, AHEAD, len(equal)]).astype(np.int32)  # 5: equal
        x, _, flag, _ = daqp.solve(cost.T @ cost, -cost.T @ target, sides, upper, lower, kinds)
        assert flag == 1
        return float(x[0])


def filtered(inputs: list[float], recording: Recording, **changes: Any) -> SafetyFilter:
    controller = SafetyFilter(
        controller=Wants(inputs=inputs), initial_length=PAST, steps_ahead=AHEAD, **changes
    )
    controller.start(loop_of(recording))
    return controller


def acted(controller: SafetyFilter, sample: Sample) -> Action:
    answer = controller.step(sample)
    assert isinstance(answer, Action)
    return answer


@pytest.mark.parametrize("satisfaction", [0.0, 0.9])
def test_the_problem_is_the_printed_one(satisfaction: float) -> None:
    recording, rng = recorded(1), np.random.default_rng(2)
    wanted = rng.uniform(-1.0, 1.0, 60).round(3).tolist()
    wanted[20:40] = [1.0] * 20
    controller, printed = (
        filtered(wanted, recording, satisfaction=satisfaction),
        Printed(recording, satisfaction),
    )
    x, y, u, changed = np.zeros(2), np.full(PAST + 1, OFFSET), np.zeros(PAST), 0
    for k, want in enumerate(wanted):
        measured = OFFSET + float((PLANT.c @ x)[0])
        y = np.r_[y[1:], measured] if k else np.full(PAST + 1, measured)
        action = acted(controller, sample_at(k, measured))
        assert action.status == "ok"
        expected = printed.first_input(y, u, want)
        assert action.u[0] == pytest.approx(expected, abs=2e-3)  # what differs by less from w is w
        if abs(expected - want) > 2e-3:
            assert action.u[0] == pytest.approx(expected, abs=1e-7)
            changed += 1
        assert action.info["intervention.u0"] == pytest.approx(action.u[0] - want, abs=1e-12)
        x, u = PLANT.advance(x, action.u), np.r_[u[1:], action.u]
    assert 10 < changed < 50
    assert controller.diagnostics()["intervention_rate"] == pytest.approx(changed / 60, abs=0.05)


RECORDING = recorded(3)
STARTED, MODEL = filtered([0.0], RECORDING), Printed(RECORDING)


@settings(max_examples=20, deadline=None)
@given(st.floats(-1.0, 1.0), st.floats(-0.9 * LIMIT, 0.9 * LIMIT))
def test_where_the_prediction_stays_inside_the_input_is_the_wanted_one(wanted: float, off: float) -> None:
    predicted = MODEL.held(np.full(PAST + 1, OFFSET + off), np.zeros(PAST), wanted)
    controller = deepcopy(STARTED)
    inside = controller._inner.controller
    assert isinstance(inside, Wants)
    inside.inputs = [wanted]
    action = acted(controller, sample_at(0, OFFSET + off))
    if np.abs(predicted - OFFSET).max() <= LIMIT:
        assert action.u[0] == wanted
        assert action.info["intervention.u0"] == 0.0


def test_a_controller_that_keeps_the_limits_is_left_alone(state_recording: Recording) -> None:
    bare = PID(proportional=1.0, integral=2.0, derivative=0.2)
    around = SafetyFilter(controller=PID(proportional=1.0, integral=2.0, derivative=0.2))
    runs = [
        close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), 150)
        for controller in (bare, around)
        for loop in [pendulum_loop(state_recording, degrees=70.0)]
    ]
    np.testing.assert_array_equal(runs[0].u, runs[1].u)
    assert around.diagnostics()["intervention_rate"] == 0.0
    assert runs[1].status == runs[0].status


@pytest.mark.parametrize("terminal", ["held", "rest"])
def test_limits_are_kept_that_the_controller_would_not_keep(terminal: str) -> None:
    broken = []
    for seed in range(4):
        recording, rng = recorded(seed), np.random.default_rng(100 + seed)
        for around in (False, True):
            pid = PID(proportional=1.5, integral=6.0)
            controller: Controller = pid
            if around:
                controller = SafetyFilter(controller=pid, terminal=terminal, satisfaction=0.99)
            controller.start(loop_of(recording))
            x, worst, reference = np.zeros(2), 0.0, np.array([OFFSET + 0.9 * LIMIT])
            for k in range(60):
                true = OFFSET + PLANT.c @ x
                worst = max(worst, float(np.abs(true - OFFSET).max()) - LIMIT)
                y = true + 0.01 * rng.standard_normal(1)
                answer = controller.step(Sample(k, 0.1 * k, y, y, reference[np.newaxis], reference))
                x = PLANT.advance(x, answer.u if isinstance(answer, Action) else answer)
            broken.append(worst > 0.0)
    assert broken == [True, False] * 4


def test_what_cannot_be_kept_gives_way_and_the_status_says_so() -> None:
    controller = filtered([1.0], RECORDING)
    action = acted(controller, sample_at(0, OFFSET + 10.0 * LIMIT))
    assert "output bounds softened" in action.status
    assert -1.0 <= action.u[0] < 0.0


def test_limits_that_move_are_followed() -> None:
    standing = filtered([1.0], RECORDING)
    expected = [acted(standing, sample_at(k, OFFSET + 0.9 * LIMIT)).u[0] for k in range(3)]
    loop, last = loop_of(RECORDING), list[float]()
    wide = np.array([OFFSET - 2.0 * LIMIT]), np.array([OFFSET + 2.0 * LIMIT])
    loop = replace(loop, bounds=Bounds(-np.ones(1), np.ones(1), *wide), moving_limits=("y0",))
    for size in (LIMIT, 2.0 * LIMIT):
        controller = SafetyFilter(controller=Wants(inputs=[1.0]), initial_length=PAST, steps_ahead=AHEAD)
        controller.start(loop)
        known = {
            "output_limits": np.array([[[OFFSET - size, OFFSET + size]]]),
            "input_limits": np.array([[[-1.0, 1.0]]] * 2),
        }
        samples = [sample_at(k, OFFSET + 0.9 * LIMIT)._replace(**known) for k in range(3)]
        last.append([acted(controller, sample).u[0] for sample in samples][-1])
    assert last == pytest.approx([expected[-1], 1.0], abs=1e-8)
    assert expected[-1] < 0.9


def test_what_cannot_serve_is_said() -> None:
    with pytest.raises(ConfigError, match="steps_ahead = 3 is not longer"):
        SafetyFilter(controller=PID(), terminal="rest", steps_ahead=3)
    controller = SafetyFilter(controller=Wants(), initial_length=PAST, steps_ahead=AHEAD)
    controller.start(make_loop(RECORDING, np.ones(1), np.full(1, np.inf)))
    assert any("no output has a limit" in text for text in controller.warnings())
    assert acted(controller, sample_at(0, 50.0)).u[0] == 0.0
    assert controller.knowledge(make_loop(RECORDING, np.ones(1), np.ones(1)))["measures"] == "y0"
