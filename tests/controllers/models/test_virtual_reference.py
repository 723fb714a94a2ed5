"""Virtual references against controllers known by a formula, without noise and with it."""

import numpy as np
import pytest
from scipy.signal import lfilter

from ddpc_controllers.models.virtual_reference import (
    ReferenceModel,
    filtered,
    noise_free,
    virtual_reference_gains,
    wanted_loop,
    whitening,
)
from ddpc_cosim import DataError, FloatArray, Recording

H = 0.1
SAMPLES = 240


def ideal_loop(
    kp: float, ki: float, kd: float, filter_time: float, model: ReferenceModel
) -> tuple[FloatArray, FloatArray]:
    """Return the plant with which a controller makes a model, ``P = M / (1 - M) / C``, rising powers of q."""
    difference, filters = np.array([1.0, -1.0]), np.array([filter_time + H, -filter_time])
    # C = K_p + h K_i / (1 - q) + K_d (1 - q) / (T_f + h - T_f q)
    controller = kp * np.convolve(difference, filters) + np.append(H * ki * filters, 0.0)
    controller = controller + kd * np.convolve(difference, difference)
    divisor = np.convolve(difference, filters)
    late = np.append(np.zeros(model.delay), model.numerator)
    rest = np.append(model.denominator, np.zeros(max(len(late) - len(model.denominator), 0)))
    rest[: len(late)] -= late
    return np.convolve(late, divisor), np.convolve(rest, controller)


def recorded(
    plant: tuple[FloatArray, FloatArray], u: FloatArray, seams: tuple[int, ...] = (), noise: float = 0.0
) -> Recording:
    """Record a plant about an operating point, in the middle of a run; pieces are cut out of it."""
    before, gap = 30, 7
    starts = [0, *seams]
    rng = np.random.default_rng(9)
    run = np.append(rng.uniform(-1.0, 1.0, before), u)
    y = lfilter(*plant, run)[before:] + 4.0
    y = y + noise * rng.standard_normal(len(y))
    kept = np.ones(len(u), dtype=bool)
    for start in starts[1:]:
        kept[start - gap : start] = False
    moved = tuple(int(kept[:seam].sum()) for seam in seams)
    column = y[kept, np.newaxis]
    return Recording(u[kept, np.newaxis] + 2.0, column, column, H, moved)


@pytest.mark.parametrize("seams", [(), (100,)], ids=["one piece", "two pieces"])
@pytest.mark.parametrize("instruments", [False, True], ids=["least squares", "instruments"])
@pytest.mark.parametrize(
    ("gains", "filter_time", "parts"),
    [
        ((2.0, 1.5, 0.0), 0.0, "PI"),
        ((2.0, 1.5, 0.3), 0.05, "PID"),
        ((0.0, -0.8, 0.0), 0.0, "I"),
        ((2.0, 1.5, 0.0), 0.0, "PID"),
    ],
)
@pytest.mark.parametrize("recovers", [False, True], ids=["lag", "recovers"])
def test_without_noise_the_controller_that_makes_the_model_is_found(
    gains: tuple[float, float, float],
    filter_time: float,
    parts: str,
    recovers: bool,
    instruments: bool,
    seams: tuple[int, ...],
) -> None:
    delay = 2 if recovers else 0
    model = wanted_loop(0.6, delay, H, 5.0, 2.0 if recovers else 5.0)
    plant = ideal_loop(*gains, filter_time, model)
    u = np.random.default_rng(2).uniform(-1.0, 1.0, SAMPLES)
    recording = recorded(plant, u, seams)
    instrument = noise_free(recording, (0, 0)) if instruments else None
    assert not instruments or instrument is not None
    found = virtual_reference_gains(recording, (0, 0), model, parts, filter_time, instrument)
    assert found == pytest.approx(gains, rel=1e-8, abs=1e-8)


def in_closed_loop(plant: tuple[FloatArray, FloatArray], samples: int, noise: float) -> Recording:
    """Record a plant that a proportional controller moves too, so that the noise is in the input."""
    numerator, denominator = (part / plant[1][0] for part in plant)
    rng = np.random.default_rng(4)
    y, u, measured = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    excitation = rng.uniform(-1.0, 1.0, samples)
    for k in range(samples):
        y[k] = sum(b * u[k - i] for i, b in enumerate(numerator) if 0 < i <= k)
        y[k] -= sum(a * y[k - i] for i, a in enumerate(denominator) if 0 < i <= k)
        measured[k] = y[k] + noise * rng.standard_normal()
        u[k] = excitation[k] - 0.4 * measured[k]
    return Recording(u[:, np.newaxis], measured[:, np.newaxis], measured[:, np.newaxis], H)


@pytest.mark.parametrize("loop", ["open", "closed"])
def test_noise_biases_least_squares_and_not_instruments(loop: str) -> None:
    gains = (1.2, 1.0, 0.0)
    model = wanted_loop(0.6, 0, H, 5.0, 5.0)
    plant = ideal_loop(*gains, 0.0, model)

    u = np.random.default_rng(3).uniform(-1.0, 1.0, SAMPLES * 25)
    whole = recorded(plant, u, noise=0.05) if loop == "open" else in_closed_loop(plant, len(u), noise=0.05)

    def error(samples: int, instruments: bool) -> float:
        u, y = whole.u[:samples], whole.y[:samples]
        recording = Recording(u, y, y, H)
        instrument = noise_free(recording, (0, 0)) if instruments else None
        found = virtual_reference_gains(recording, (0, 0), model, "PI", 0.0, instrument)
        return float(np.abs(found - np.array(gains)).max())

    left = error(len(u), instruments=True)
    assert left < 0.06
    assert left < error(SAMPLES, instruments=True)
    assert error(len(u), instruments=False) > 5.0 * left


def test_the_reference_model_is_the_lag_with_delay_that_was_asked_for() -> None:
    model = wanted_loop(0.5, 3, H, 7.0, 7.0)
    response = lfilter(np.append(np.zeros(model.delay), model.numerator), model.denominator, np.ones(60))
    expected = 1.0 - np.exp(-H / 0.5 * np.maximum(np.arange(60) - 3, 0))
    assert response == pytest.approx(expected, abs=1e-12)


def test_the_loop_that_recovers_is_the_open_loop_that_was_asked_for() -> None:
    """M / (1 - M) against that of the lag: their ratio is the lead by which the integral time is shorter."""
    z = np.exp(1j * np.array([0.01, 0.1, 1.0]))

    def opened(model: ReferenceModel) -> FloatArray:
        late = np.append(np.zeros(model.delay), model.numerator)
        closed = np.polyval(late[::-1], 1.0 / z) / np.polyval(model.denominator[::-1], 1.0 / z)
        return closed / (1.0 - closed)

    ratio = opened(wanted_loop(0.5, 2, H, 9.0, 3.0)) / opened(wanted_loop(0.5, 2, H, 9.0, 9.0))
    assert ratio == pytest.approx((1.0 - np.exp(-H / 3.0) / z) / (1.0 - np.exp(-H / 9.0) / z), rel=1e-9)


def test_filtering_is_that_of_scipy() -> None:
    signals = np.random.default_rng(0).standard_normal((50, 2))
    numerator, denominator = np.array([0.3, -0.2, 0.1]), np.array([1.5, -0.9, 0.2, 0.1])
    expected = lfilter(numerator, denominator, signals, axis=0)
    assert filtered(numerator, denominator, signals) == pytest.approx(expected, abs=1e-12)


def test_whitening_undoes_the_colour_of_an_input() -> None:
    white = np.random.default_rng(0).standard_normal(20_000)
    coloured = lfilter([1.0], [1.0, -0.9, 0.2], white)
    assert whitening(coloured) == pytest.approx([1.0, -0.9, 0.2, 0.0, 0.0], abs=0.03)


def test_a_recording_shorter_than_the_model_is_late_is_refused() -> None:
    u = np.random.default_rng(0).uniform(-1.0, 1.0, (12, 1))
    with pytest.raises(DataError, match=r"no piece of the recording is longer than 21 samples"):
        virtual_reference_gains(Recording(u, u, u, H), (0, 0), wanted_loop(0.5, 8, H, 1.0, 1.0))
