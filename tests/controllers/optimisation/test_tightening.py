"""Limits drawn in by held-out residuals: what share of exchangeable data they hold, and who keeps to them."""

from dataclasses import replace
from functools import partial
from typing import Any

import daqp
import numpy as np
import pytest
from hypothesis import assume, given, strategies as st

from ddpc_controllers import MPC, SPC, WKPC, DeePC, GammaDDPC, KoopmanMPC, SelectDPC
from ddpc_controllers.optimisation.tightening import OnlineMargins, margins_of, tightened
from ddpc_cosim import Bounds, ConfigError, Controller, DataError, FloatArray, Loop, Recording, Sample
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


def weighted_quantile(values: FloatArray, weights: FloatArray, share: float) -> float:
    """Return the quantile of values with weights, and of one at infinity that weighs 1 (Barber et al.)."""
    order = np.argsort(values)
    reached = np.cumsum(weights[order]) >= share * (weights.sum() + 1.0) * (1.0 - 1e-12)
    return float(values[order][reached.argmax()]) if reached.any() else np.inf


def online(satisfaction: float, held_out: float = 0.0, n: int = 1, first: int = 1) -> OnlineMargins:
    return OnlineMargins(np.full((n, 1, 2), held_out), first, satisfaction, np.full(1, np.inf))


def followed(margins: OnlineMargins, errors: FloatArray) -> FloatArray:
    """Return the upper margin of one sample ahead before each of the errors, and after the last."""
    upper = [margins.values[1, 0]]
    for error in errors:
        margins.predicted(np.zeros(1))
        margins.measured(np.array([error]))
        upper.append(margins.values[1, 0])
    return np.array(upper)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=120), st.sampled_from([0.5, 0.8, 0.9, 0.95]))
def test_the_margin_in_the_loop_is_the_weighted_quantile_of_the_last_errors(
    values: list[float], satisfaction: float
) -> None:
    errors = np.array(values)
    # The fewest with a weight of 1 each, of which a quantile is finite although the largest is left out.
    window = 1
    while not weighted_quantile(np.arange(window), np.ones(window), satisfaction) < window - 1:
        window += 1
    upper = followed(online(satisfaction), errors)
    for k in range(1, len(errors) + 1):
        recent = errors[max(k - window, 0) : k]
        expected = min(weighted_quantile(recent, np.ones(len(recent)), satisfaction), recent.max())
        assert upper[k] == max(expected, 0.0)


@pytest.mark.parametrize("satisfaction", [0.8, 0.9, 0.95])
def test_of_errors_as_those_held_out_as_many_as_promised_are_within_the_online_margins(
    satisfaction: float,
) -> None:
    rng, within = np.random.default_rng(5), []
    for _ in range(150):
        errors = rng.standard_t(3, 160)
        held_out = float(margins_of(errors[:40, np.newaxis, np.newaxis], satisfaction)[0, 0, 1])
        upper = followed(online(satisfaction, held_out), errors[40:])
        within.append((errors[40:] <= upper[:-1]).mean())
    assert np.mean(within) >= satisfaction


@given(st.floats(0.5, 100.0), st.sampled_from([0.8, 0.9, 0.95]))
def test_errors_that_shift_are_within_after_two_of_them(shift: float, satisfaction: float) -> None:
    rng = np.random.default_rng(7)
    before, after = rng.uniform(-0.1, 0.0, 300), np.full(60, shift)
    upper = followed(online(satisfaction, 0.2), np.r_[before, after])
    assert (upper[:302] == 0.2).all()
    assert (upper[302:-1] >= after[2:]).all()


def test_one_error_alone_draws_nothing_in_once_there_are_enough() -> None:
    errors = np.r_[np.zeros(45), 5.0, np.zeros(60)]
    assert (followed(online(0.95, 0.1), errors) == 0.1).all()
    assert followed(online(0.95, 0.1), errors[40:]).max() == 5.0


def test_each_sample_ahead_learns_from_its_own_predictions_of_plans_that_were_made() -> None:
    rng = np.random.default_rng(8)
    n, first, samples = 4, 0, 30
    plans = {k: rng.standard_normal(n) for k in range(samples) if k % 3 != 1}
    y = rng.standard_normal(samples)
    y[[11, 12]] = np.nan
    margins = online(0.5, 0.0, n, first)
    for k in range(samples):
        margins.measured(y[k : k + 1])
        for i in range(n):
            errors = [y[k_] - plans[k_ - i][i] for k_ in range(k + 1) if i and k_ - i in plans]
            recent = np.array([error for error in errors if np.isfinite(error)][-3:])
            place = min(int(np.ceil((len(recent) + 1) * 0.5)), len(recent)) - 1
            expected = [max(np.sort(side * recent)[place], 0.0) if len(recent) else 0.0 for side in (-1, 1)]
            np.testing.assert_array_equal(margins.values[:, i], expected)
        if k in plans:
            margins.predicted(plans[k])
    margins.begin()
    assert not margins.values.any()


def test_online_margins_that_would_cross_leave_a_point() -> None:
    margins = OnlineMargins(np.ones((1, 1, 2)), 1, 0.95, np.full(1, 4.0))
    margins.predicted(np.zeros(1))
    margins.measured(np.full(1, 9.0))
    np.testing.assert_allclose(margins.values.ravel(), [0.4, 3.6])


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


@pytest.mark.parametrize("online_margins", [False, True])
@pytest.mark.parametrize("method", [DeePC, SPC, GammaDDPC, WKPC, KoopmanMPC, MPC])
def test_every_predictive_method_keeps_the_limits_as_often_as_promised(
    method: Any, online_margins: bool
) -> None:
    bare, promised = method(), method(satisfaction=0.95, online_margins=online_margins)
    assert share_within(bare) < 0.85
    assert share_within(promised) >= 0.93
    assert promised.diagnostics()["promised_satisfaction"] == 0.95
    assert "promised_satisfaction" not in bare.diagnostics()


WIDE = 30.0


class Printed:
    """SPC without a setpoint, each sample drawn in by its own quantiles, those of the loop among them."""

    past, n, satisfaction = 3, 5, 0.9

    def __init__(self, recording: Recording) -> None:
        past, n = self.past, self.n
        u, y = recording.u[:, 0], recording.y[:, 0]
        windows = len(u) - past - n
        known = np.array(
            [np.r_[u[i : i + past], y[i : i + past + 1], u[i + past : i + past + n]] for i in range(windows)]
        )
        ahead = np.array([y[i + past + 1 : i + past + n + 1] for i in range(windows)])
        tail = windows - round(windows / 4)
        head = tail - (past + n + 1) + 1
        errors = ahead[tail:] - known[tail:] @ np.linalg.lstsq(known[:head], ahead[:head], rcond=None)[0]
        self._held_out = [self._quantile(errors[:, i]) for i in range(n)]
        self._predictor = np.linalg.lstsq(known, ahead, rcond=None)[0].T
        self._plans: list[FloatArray] = []
        self._y: list[float] = []
        self._u = [0.0] * past

    def _quantile(self, errors: FloatArray) -> float:
        place = min(int(np.ceil((len(errors) + 1) * self.satisfaction)), len(errors)) - 1
        return max(float(np.sort(errors)[place]), 0.0)

    def step(self, y: float) -> tuple[float, bool]:
        """Return the input, and whether a predicted output is at its limit."""
        n, k = self.n, len(self._y)
        self._y.append(y)
        margins = list(self._held_out)
        for i in range(n):
            errors = [self._y[j + 1 + i] - self._plans[j][i] for j in range(k - i)]
            if errors:  # of 19, the first number of which the second largest is the quantile
                margins[i] = max(margins[i], self._quantile(np.array(errors[-19:])))
        upper = LIMIT - np.array(margins)
        outputs = np.r_[np.full(self.past + 1, self._y[0]), self._y[1:]][-self.past - 1 :]
        gain = self._predictor[:, -n:]
        free = self._predictor[:, :-n] @ np.r_[self._u[-self.past :], outputs]
        x, _, flag, _ = daqp.solve(
            gain.T @ gain + 0.01 * np.eye(n),
            gain.T @ (free - REFERENCE),
            np.vstack([np.eye(n), gain]),
            np.r_[np.full(n, WIDE), upper - free],
            np.r_[np.full(n, -WIDE), np.full(n, -1e30)],
            np.zeros(2 * n, dtype=np.int32),
        )
        assert flag == 1
        self._plans.append(free + gain @ x)
        self._u.append(float(x[0]))
        return self._u[-1], bool((np.abs(self._plans[-1] - upper) < 1e-9).any())


def test_every_input_is_that_of_the_problem_with_each_sample_drawn_in_by_its_own_quantiles() -> None:
    recording, rng, x, at_limit, margins = recorded(), np.random.default_rng(3), np.zeros(2), 0, set[float]()
    printed = Printed(recording)
    controller = SPC(
        initial_length=printed.past,
        horizon=printed.n,
        artificial_setpoint=False,
        output_weight=1.0,
        input_weight=0.01,
        satisfaction=printed.satisfaction,
    )
    loop, wide = loop_of(recording), np.full(1, WIDE)
    controller.start(replace(loop, bounds=replace(loop.bounds, u_min=-wide, u_max=wide)))
    reference = np.full((printed.n, 1), REFERENCE)
    for k in range(80):
        # A disturbance that the recording does not have, and noise.
        y = PLANT.c @ x + 0.1 * (k > 40) + 0.03 * rng.standard_normal(1)
        u = inputs(controller.step(Sample(k, 0.1 * k, y, y, reference, reference[0])))
        expected, active = printed.step(float(y[0]))
        assert u[0] == pytest.approx(expected, abs=1e-6)
        at_limit += active
        assert controller._following
        margins.add(controller._following.values[1, 0])
        x = PLANT.advance(x, u)
    assert at_limit > 60
    assert len(margins) > 5


def test_it_is_the_least_squares_prediction_that_is_limited_and_not_what_a_regulariser_leaves_open() -> None:
    recording, beta = recorded(), 0.3
    printed, n, past = Printed(recording), Printed.n, Printed.past
    controller = GammaDDPC(
        initial_length=past,
        horizon=n,
        artificial_setpoint=False,
        output_weight=1.0,
        input_weight=0.01,
        beta_3=beta,
        satisfaction=printed.satisfaction,
    )
    loop, wide = loop_of(recording), np.full(1, WIDE)
    controller.start(replace(loop, bounds=replace(loop.bounds, u_min=-wide, u_max=wide)))
    u, y = recording.u[:, 0], recording.y[:, 0]
    depth = past + n
    windows = [
        np.r_[u[i : i + past], y[i : i + past + 1], u[i + past : i + depth], y[i + past + 1 : i + depth + 1]]
        for i in range(len(u) - depth)
    ]
    factor = np.linalg.qr(np.array(windows) / np.sqrt(len(windows)), mode="r").T
    predictor, unexplained = printed._predictor, factor[-n:, -n:]
    gain, free = predictor[:, -n:], predictor[:, :-n] @ np.r_[np.zeros(past), np.full(past + 1, 0.45)]
    both, upper = np.hstack([gain, unexplained]), LIMIT - np.array(printed._held_out)
    # Over u and gamma_3.
    x, _, flag, _ = daqp.solve(
        both.T @ both + np.diag(np.r_[np.full(n, 0.01), np.full(n, beta)]),
        both.T @ (free - REFERENCE),
        np.hstack([gain, np.zeros((n, n))]),
        upper - free,
        np.full(n, -1e30),
        np.zeros(n, dtype=np.int32),
    )
    assert flag == 1
    assert (np.abs(free + gain @ x[:n] - upper) < 1e-9).any()
    assert (free + both @ x > upper + 1e-3).any()
    now, reference = np.array([0.45]), np.full((n, 1), REFERENCE)
    answer = controller.step(Sample(0, 0.0, now, now, reference, reference[0]))
    assert inputs(answer)[0] == pytest.approx(x[0], abs=1e-6)


def share_at_a_new_place(controller: Controller, off: float = 0.12, samples: int = 150) -> float:
    """Return in which share of the samples the output keeps its limit, where another load acts on it."""
    controller.start(loop_of(recorded()))
    rng, x, kept = np.random.default_rng(9), np.zeros(2), 0
    reference = np.full((controller.horizon, 1), REFERENCE)
    for k in range(samples):
        true = PLANT.c @ x
        y = true + 0.02 * rng.standard_normal(1)
        kept += bool(true[0] <= LIMIT)
        u = inputs(controller.step(Sample(k, 0.1 * k, y, y, reference, reference[0])))
        x = PLANT.advance(x, u) + np.array([off, 0.0])
    return kept / samples


@pytest.mark.parametrize(
    "method",
    [
        DeePC,
        SPC,
        GammaDDPC,
        WKPC,
        SelectDPC,
        partial(DeePC, online_data="forgetting"),
        partial(DeePC, apply_steps=2),
        partial(DeePC, regulariser="ridge"),
    ],
)
def test_a_load_that_the_recording_does_not_have_is_in_the_online_margins(method: Any) -> None:
    promised = partial(method, satisfaction=0.95)
    assert share_at_a_new_place(promised(online_margins=False)) < 0.8
    assert share_at_a_new_place(promised()) >= 0.93


@pytest.mark.parametrize("method", [DeePC, SPC, WKPC, KoopmanMPC, MPC])
def test_who_begins_anew_has_forgotten_the_loop(method: Any) -> None:
    controller = method(satisfaction=0.95, online_margins=True)
    loop = loop_of(recorded())

    def run() -> list[float]:
        rng, x, applied = np.random.default_rng(9), np.zeros(2), []
        reference = np.full((controller.horizon, 1), REFERENCE)
        for k in range(30):
            y = PLANT.c @ x + 0.05 * rng.standard_normal(1)
            u = inputs(controller.step(Sample(k, 0.1 * k, y, y, reference, reference[0])))
            applied.append(float(u[0]))
            x = PLANT.advance(x, u)
        return applied

    controller.start(loop)
    first = run()
    controller.restart(loop)
    np.testing.assert_allclose(run(), first, atol=1e-9)


def test_limits_that_move_are_drawn_in_by_what_predictions_were_off() -> None:
    loop = replace(loop_of(recorded()), moving_limits=("y0",))
    moving, standing = (SPC(satisfaction=0.95) for _ in range(2))
    moving.start(loop)
    standing.start(loop_of(recorded()))
    rng, x, at_limit = np.random.default_rng(2), np.zeros(2), 0
    reference = np.full((moving.horizon, 1), REFERENCE)
    limits = np.tile([-np.inf, LIMIT], (moving.horizon, 1, 1))
    for k in range(60):
        y = PLANT.c @ x + 0.1 + 0.02 * rng.standard_normal(1)
        sample = Sample(k, 0.1 * k, y, y, reference, reference[0])
        u = inputs(moving.step(sample._replace(output_limits=limits)))
        np.testing.assert_allclose(u, inputs(standing.step(sample)), atol=1e-8)
        x = PLANT.advance(x, u)
        at_limit += standing._info["active_bounds"] > 0
    assert at_limit > 30


@pytest.mark.parametrize("method", [DeePC, SPC, WKPC, KoopmanMPC, MPC])
def test_code_in_c_has_limits_that_are_drawn_in_once_and_for_all(method: Any) -> None:
    loop = loop_of(recorded())
    following, fixed = (method(satisfaction=0.95, online_margins=online) for online in (True, False))
    following.start(loop)
    with pytest.raises(ConfigError, match=r"online_margins cannot be exported: .*online_margins = false"):
        following.c_code(loop)
    fixed.start(loop)
    assert fixed.c_code(loop)


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
