"""Whether a recording serves a predictor: its error on samples held out, dead times, sizes of signals."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import null_space

from ddpc_controllers import (
    LQR,
    MFAC,
    MFAPC,
    MPC,
    SPC,
    WKPC,
    DeePC,
    GammaDDPC,
    Identified,
    Identity,
    KoopmanMPC,
)
from ddpc_controllers.data.quality import dead_times, fit_by_windows
from ddpc_controllers.models.identification import _observed, fit_arx
from ddpc_cosim import Bounds, ConfigError, Controller, Loop, Recording

from ..loops import LinearPlant, experiment, make_loop, pendulum_experiment, pendulum_loop

PREDICTIVE = [DeePC, SPC, GammaDDPC, WKPC, KoopmanMPC, MPC, LQR]
Make = Callable[..., Controller]


def recording_of(
    seed: int, noise: float = 0.0, delay: int = 0, samples: int = 300, outputs: int = 1
) -> Recording:
    """Record a random plant of second order; ``delay`` samples of dead time more than a sampled plant has."""
    rng = np.random.default_rng(seed)
    plant = LinearPlant.random(rng, 2, outputs, outputs)
    u = rng.uniform(-1.0, 1.0, (samples, outputs))
    late = np.vstack([np.zeros((delay, outputs)), u])[:samples]
    y = experiment(plant.advance, late, 2, plant.c).y
    y = y + noise * y.std(axis=0) * rng.standard_normal(y.shape)
    return Recording(u, y, y, 0.1)


def loop_with(recording: Recording) -> Loop:
    return make_loop(recording, np.ones(recording.u.shape[1]), np.full(recording.y.shape[1], np.inf))


def started(controller: Controller, loop: Loop) -> Controller:
    controller.start(loop)
    return controller


@pytest.mark.parametrize("method", PREDICTIVE)
@pytest.mark.parametrize(("seed", "noise"), [(0, 0.0), (1, 0.01), (2, 0.1), (3, 0.01)])
def test_sound_data_raise_no_warning(method: Make, seed: int, noise: float) -> None:
    controller = started(method(), loop_with(recording_of(seed, noise)))
    assert list(controller.warnings()) == []
    figures = controller.diagnostics()
    assert figures["prediction_error"] < 0.5


@pytest.mark.parametrize("method", PREDICTIVE)
def test_the_pendulum_of_the_paper_is_predicted_to_a_few_percent(method: Make) -> None:
    controller = started(method(), pendulum_loop(pendulum_experiment(5489)))
    assert list(controller.warnings()) == []
    assert 0.0 < controller.diagnostics()["prediction_error"] < 0.05


@pytest.mark.parametrize("method", PREDICTIVE)
def test_a_prediction_is_tested_on_what_it_was_not_fitted_to(method: Make) -> None:
    """The plant changes its sign for the last quarter: what is fitted to the rest is wrong twice over."""
    recording = recording_of(4)
    y = recording.y.copy()
    y[225:] *= -1.0
    controller = started(method(), loop_with(replace(recording, y=y, measured=y)))
    assert controller.diagnostics()["prediction_error"] > 1.0
    (warning,) = controller.warnings()
    assert "poor: what it was fitted to is predicted far better" in warning


@pytest.mark.parametrize("method", [DeePC, SPC, GammaDDPC, MPC])
def test_outputs_that_are_noise_are_told(method: Make) -> None:
    rng = np.random.default_rng(0)
    y = rng.standard_normal((300, 1))
    recording = Recording(rng.uniform(-1.0, 1.0, (300, 1)), y, y, 0.1)
    warnings = list(started(method(), loop_with(recording)).warnings())
    assert any("poor: what it was fitted to is not predicted either" in text for text in warnings)


def test_the_error_is_that_of_a_least_squares_prediction_by_hand() -> None:
    """SPC: least squares of the last predicted output on past and inputs, window by window."""
    recording, past, horizon = recording_of(5, noise=0.1), 3, 5
    u, y = recording.u[:, 0], recording.y[:, 0]
    first = range(len(u) - past - 1 - horizon + 1)
    known = np.array(
        [[*u[i : i + past], *y[i : i + past + 1], *u[i + past : i + past + horizon]] for i in first]
    )
    last = np.array([y[i + past + horizon] for i in first])
    tail = len(known) - round(len(known) / 4)
    head = tail - (past + horizon + 1) + 1  # no sample in common
    solution = np.linalg.lstsq(known[:head], last[:head])[0]
    expected = np.sqrt(np.mean((last[tail:] - known[tail:] @ solution) ** 2)) / last.std()
    assert started(SPC(), loop_with(recording)).diagnostics()["prediction_error"] == pytest.approx(expected)


def test_the_error_of_a_model_is_that_of_its_simulation_from_every_sample() -> None:
    """MPC: the autoregressive model of the first three quarters, from the past of every later sample."""
    recording, horizon, lags = recording_of(6, noise=0.05), 4, 2
    u, y, head = recording.u[:, 0], recording.y[:, 0], 225
    rows = np.array([[y[k - 1], u[k - 1], y[k - 2], u[k - 2], 1.0] for k in range(lags, head)])
    a1, b1, a2, b2, c = np.linalg.lstsq(rows, y[lags:head])[0]
    errors = []
    for k in range(head, len(u) - horizon + 1):
        seen = list(y[:k])
        for step in range(k, k + horizon):
            seen.append(a1 * seen[-1] + b1 * u[step - 1] + a2 * seen[-2] + b2 * u[step - 2] + c)
        if k + horizon - 1 < len(u):
            errors.append(y[k + horizon - 1] - seen[-1])
    tested = Identified(lags=lags).test(loop_with(recording), horizon)
    assert tested is not None
    assert tested.error == pytest.approx(np.sqrt(np.mean(np.square(errors))) / y.std(), rel=0.02)


def test_states_in_observer_form_continue_each_other() -> None:
    recording = recording_of(7, outputs=2)
    model = fit_arx(recording, 3)
    u, y = recording.u - model.u_0, recording.y - model.y_0
    x = _observed(model, recording, 3)
    np.testing.assert_allclose(x[1:], x[:-1] @ model.a.T + u[3:-1] @ model.b.T, atol=1e-9)
    np.testing.assert_allclose(x @ model.c.T, y[3:], atol=1e-9)


@pytest.mark.parametrize("delay", [0, 1, 4, 9])
@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_dead_times_are_found(delay: int, noise: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    u = rng.uniform(-1.0, 1.0, (400, 1))
    late = np.vstack([np.zeros((delay, 1)), u])[:400]
    y = experiment(LinearPlant.lag(0.7, 0.3).advance, late, 1, np.eye(1)).y
    y = y + noise * y.std() * rng.standard_normal(y.shape)
    assert dead_times(Recording(u, y, y, 0.1), 15) == [delay + 1]


@pytest.mark.parametrize(
    ("controller", "spanned"),
    [
        (DeePC(), 3),
        (SPC(), 4),
        (WKPC(), 2),
        (KoopmanMPC(state="measured"), 1),
        (DeePC(horizon=6, terminal_equality=True), 3),
        (KoopmanMPC(state="delays", delays=2, dictionary=Identity()), 3),
        (MPC(horizon=4, setpoint="none", model=Identified(lags=8)), 4),
        (MPC(horizon=10, model=Identified(lags=3)), 3),
        (MFAPC(horizon=3), 3),
        (MFAC(), 1),
    ],
    ids=repr,
)
def test_a_dead_time_beyond_horizon_or_memory_is_told(controller: Controller, spanned: int) -> None:
    def warns(samples: int) -> bool:
        recording = recording_of(8, delay=samples - 1)
        return any("does not answer" in text for text in started(controller, loop_with(recording)).warnings())

    assert [warns(spanned), warns(spanned + 1)] == [False, True]


@pytest.mark.parametrize(
    ("controller", "remedy"),
    [
        (
            DeePC(),
            "horizon covers 4 and initial_length covers 3: lengthen horizon and initial_length, or sample",
        ),
        (LQR(model=Identified(lags=3)), "and lags covers 3: lengthen lags, or sample"),
        (KoopmanMPC(state="measured", horizon=30), '"measured" covers 1: set state = "delays", or sample'),
        (MFAC(), "and the one-step law covers 1: choose MFAPC, which looks further ahead, or sample"),
    ],
    ids=repr,
)
def test_the_remedy_names_settings_that_the_method_has(controller: Controller, remedy: str) -> None:
    (warning,) = (
        text
        for text in started(controller, loop_with(recording_of(8, delay=8))).warnings()
        if "does not answer" in text
    )
    assert f"{remedy} more slowly" in warning


def error_of_combinations(recording: Recording, ridge: float) -> float:
    """Return the error of Y_f g with g = argmin ridge |g|^2 + |Y_p g - y_ini|^2, the inputs met."""
    signals = recording.u[:, 0], recording.y[:, 0]
    u, y = (np.lib.stride_tricks.sliding_window_view(signal, 8).T for signal in signals)
    windows = u.shape[1]
    tail = windows - round(windows / 4)
    head = tail - 7
    met, past, last = u[:, :head], y[:3, :head], y[7, :head]
    smallest, free = np.linalg.pinv(met), null_space(met)
    errors = []
    for window in range(tail, windows):
        g = smallest @ u[:, window]
        part = np.sqrt(ridge * head / windows)  # of the recording's windows the head has so many
        left = np.vstack([part * free, past @ free])
        g = g + free @ np.linalg.lstsq(left, np.concatenate([-part * g, y[:3, window] - past @ g]))[0]
        errors.append(y[7, window] - last @ g)
    return float(np.sqrt(np.mean(np.square(errors))) / y[7].std())


@pytest.mark.parametrize("lambda_g", [1e-3, 1e3, 1e5])
def test_the_ridge_of_deepc_is_part_of_its_prediction(lambda_g: float) -> None:
    recording = recording_of(3)
    ridge = DeePC(regulariser="ridge", lambda_g=lambda_g, lambda_sigma=1e3, scaling="none")
    error = started(ridge, loop_with(recording)).diagnostics()["prediction_error"]
    assert error == pytest.approx(error_of_combinations(recording, lambda_g / 1e3), rel=1e-6)


def test_what_goes_beyond_the_least_squares_prediction_is_no_part_of_it() -> None:
    loop, errors = loop_with(recording_of(3)), []
    for controller in (
        DeePC(lambda_g=1e-2),
        DeePC(lambda_g=1e4),
        DeePC(regulariser="ridge", lambda_g=1e4, slack=False),
    ):
        errors.append(started(controller, loop).diagnostics()["prediction_error"])
    assert errors == [errors[0]] * 3


def test_an_output_that_is_constant_but_for_rounding_is_not_predicted_poorly() -> None:
    u, y = recording_of(0).u, np.full((300, 1), 0.3)
    y[::2] = 0.1 + 0.2
    assert 0.0 < y.std() < 1e-15
    tested = fit_by_windows(np.hstack([u, y, np.roll(y, 1)]).T, future=1, outputs=1, depth=1)
    assert tested is not None
    assert tested.error < 1e-9


@pytest.mark.parametrize("method", [*PREDICTIVE, MFAC, MFAPC])
@pytest.mark.parametrize(("torque", "angle"), [(1e6, 1e-6), (1e6, 1.0), (1.0, 1e-6)])
def test_signals_far_from_their_nominal_values_are_told(method: Make, torque: float, angle: float) -> None:
    """The pendulum in units of a millionth, its nominal values left at 1."""
    recording = pendulum_experiment(1)
    moved = Recording(recording.u * torque, recording.y * angle, recording.measured * angle, 0.1)
    loop = pendulum_loop(moved)
    limits = loop.bounds
    bounds = Bounds(limits.u_min * torque, limits.u_max * torque, limits.y_min * angle, limits.y_max * angle)
    loop = replace(loop, bounds=bounds, recording=moved if method in PREDICTIVE else None)
    warnings: Sequence[str]
    try:
        warnings = started(method(), loop).warnings()
    except ConfigError as error:  # so far that nothing can be computed
        warnings = error.faults
    assert sum("nominal value" in text for text in warnings) == (torque != 1.0) + (angle != 1.0)
    # By its range nothing is far from its size.
    assert not [text for text in started(method(scaling="range"), loop).warnings() if "nominal" in text]


def test_tests_are_left_out_where_the_recording_is_too_short_for_them() -> None:
    controller = started(WKPC(), loop_with(recording_of(9, samples=50)))
    assert "prediction_error" not in controller.diagnostics()
    assert list(controller.warnings()) == []
