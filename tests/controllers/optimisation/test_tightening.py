"""Limits drawn in by held-out residuals: what share of exchangeable data they hold, and who keeps to them."""

from dataclasses import replace
from typing import Any

import daqp
import numpy as np
import pytest
from hypothesis import assume, given, strategies as st

from ddpc_controllers import MPC, SPC, WKPC, DeePC, GammaDDPC, KoopmanMPC
from ddpc_controllers.optimisation.tightening import margins_of, tightened
from ddpc_cosim import Bounds, Controller, DataError, FloatArray, Loop, Recording, Sample
from ddpc_cosim.controller import Action

from ..loops import LinearPlant, make_loop

ERRORS = st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=60)


@given(ERRORS, st.floats(0.05, 0.98))
def test_of_exchangeable_errors_as_many_as_promised_are_within_the_margins_of_the_others(
    values: list[float], satisfaction: float
) -> None:
    n = len(values) - 1
    assume(np.ceil((n + 1) * satisfaction) <= n)
    errors = np.array(values)[:, np.newaxis, np.newaxis]
    within = np.zeros(2)
    for i in range(n + 1):
        margins = margins_of(np.delete(errors, i, axis=0), satisfaction)[0, 0]
        assert (margins >= 0.0).all()
        within += [-values[i] <= margins[0], values[i] <= margins[1]]
    assert (within >= satisfaction * (n + 1) * (1 - 1e-12)).all()


@given(ERRORS, st.floats(0.05, 0.5), st.floats(0.0, 0.48))
def test_who_promises_more_draws_in_further(values: list[float], satisfaction: float, more: float) -> None:
    errors = np.array(values)[:, np.newaxis, np.newaxis]
    assert (margins_of(errors, satisfaction + more) >= margins_of(errors, satisfaction)).all()


def test_a_promise_beyond_what_so_few_errors_say_takes_the_largest() -> None:
    errors = np.array([-3.0, 1.0, 2.0])[:, np.newaxis, np.newaxis]
    np.testing.assert_array_equal(margins_of(errors, 0.99), [[[3.0, 2.0]]])


def test_margins_that_would_cross_leave_a_point() -> None:
    margins = np.array([[[1.0, 2.0]], [[4.0, 2.0]], [[-np.inf, -np.inf]]])
    lower, upper, moving = tightened(np.array([-2.0]), np.array([2.0]), margins)
    np.testing.assert_allclose(lower, [-1.0, 2.0 / 3.0, -np.inf])
    np.testing.assert_allclose(upper, [0.0, 2.0 / 3.0, np.inf])
    assert moving is None
    assert tightened(np.array([-2.0]), np.array([2.0]), None)[1] == [2.0]


LIMIT, REFERENCE = 0.5, 0.6
PLANT = LinearPlant(np.array([[0.7, 0.2], [0.0, 0.6]]), np.array([[0.0], [0.5]]), np.array([[1.0, 0.0]]))


def recorded(noise: float = 0.03, samples: int = 240) -> Recording:
    rng = np.random.default_rng(4)
    u, x, y = rng.uniform(-1.0, 1.0, (samples, 1)), np.zeros(2), np.zeros((samples, 1))
    for k in range(samples):
        y[k] = PLANT.c @ x + noise * rng.standard_normal(1)
        x = PLANT.advance(x, u[k]) + noise * np.array([rng.standard_normal(), 0.0])
    return Recording(u, y, y, 0.1)


def loop_of(recording: Recording) -> Loop:
    loop = make_loop(recording, np.full(1, 3.0), np.full(1, LIMIT))
    return replace(
        loop, bounds=Bounds(np.full(1, -3.0), np.full(1, 3.0), np.full(1, -np.inf), np.full(1, LIMIT))
    )


def inputs(answer: Any) -> FloatArray:
    return np.asarray(answer.u if isinstance(answer, Action) else answer)


def share_within(controller: Controller, noise: float = 0.03, samples: int = 200) -> float:
    """Return in which share of the samples the measured output is below its limit, the reference above."""
    controller.start(loop_of(recorded()))
    rng, x, kept = np.random.default_rng(9), np.zeros(2), 0
    reference = np.full((controller.horizon, 1), REFERENCE)
    for k in range(samples):
        y = PLANT.c @ x + noise * rng.standard_normal(1)
        kept += bool(y[0] <= LIMIT)
        u = inputs(controller.step(Sample(k, 0.1 * k, y, y, reference, reference[0])))
        x = PLANT.advance(x, u) + noise * np.array([rng.standard_normal(), 0.0])
    return kept / samples


@pytest.mark.parametrize("method", [DeePC, SPC, GammaDDPC, WKPC, KoopmanMPC, MPC])
def test_every_predictive_method_keeps_the_limits_as_often_as_promised(method: Any) -> None:
    bare, promised = method(), method(satisfaction=0.95)
    assert share_within(bare) < 0.85
    assert share_within(promised) >= 0.93
    assert promised.diagnostics()["promised_satisfaction"] == 0.95
    assert "promised_satisfaction" not in bare.diagnostics()


def test_the_first_input_is_that_of_the_problem_with_each_sample_drawn_in_by_its_own_quantile() -> None:
    past, n, satisfaction, recording = 3, 5, 0.9, recorded()
    controller = SPC(
        initial_length=past,
        horizon=n,
        artificial_setpoint=False,
        output_weight=1.0,
        input_weight=0.01,
        satisfaction=satisfaction,
    )
    controller.start(loop_of(recording))
    u, y = recording.u[:, 0], recording.y[:, 0]
    windows = len(u) - past - n
    known = np.array(
        [np.r_[u[i : i + past], y[i : i + past + 1], u[i + past : i + past + n]] for i in range(windows)]
    )
    ahead = np.array([y[i + past + 1 : i + past + n + 1] for i in range(windows)])
    tail = windows - round(windows / 4)
    head = tail - (past + n + 1) + 1
    errors = ahead[tail:] - known[tail:] @ np.linalg.lstsq(known[:head], ahead[:head], rcond=None)[0]
    place = int(np.ceil((len(errors) + 1) * satisfaction)) - 1
    upper = LIMIT - np.maximum(np.sort(errors, axis=0)[place], 0.0)
    predictor = np.linalg.lstsq(known, ahead, rcond=None)[0].T
    gain = predictor[:, -n:]
    free = predictor[:, :-n] @ np.r_[np.zeros(past), np.full(past + 1, 0.45)]
    hessian = gain.T @ gain + 0.01 * np.eye(n)
    x, _, flag, _ = daqp.solve(
        hessian,
        gain.T @ (free - REFERENCE),
        np.vstack([np.eye(n), gain]),
        np.r_[np.full(n, 3.0), upper - free],
        np.r_[np.full(n, -3.0), np.full(n, -1e30)],
        np.zeros(2 * n, dtype=np.int32),
    )
    assert flag == 1
    assert (np.abs(free + gain @ x - upper) < 1e-9).any()
    now, reference = np.array([0.45]), np.full((n, 1), REFERENCE)
    answer = controller.step(Sample(0, 0.0, now, now, reference, reference[0]))
    assert inputs(answer)[0] == pytest.approx(x[0], abs=1e-7)


def test_predictions_too_far_off_for_the_limits_are_a_warning() -> None:
    loop = loop_of(recorded())
    narrow = replace(loop, bounds=replace(loop.bounds, y_min=np.full(1, LIMIT - 0.05)))
    controller = SPC(satisfaction=0.95)
    controller.start(narrow)
    assert [text for text in controller.warnings() if 'no room between the limits of "y0"' in text]
    controller.start(loop)
    assert not controller.warnings()


def test_a_recording_that_leaves_nothing_to_hold_out_cannot_promise() -> None:
    short = recorded(samples=30)
    SPC().start(loop_of(short))
    with pytest.raises(DataError, match=r"satisfaction = 0\.9 .*record more"):
        SPC(satisfaction=0.9).start(loop_of(short))
