"""Models in innovation form, and autoregressive ones by least squares, against formulas."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.signal import dlsim

from ddpc_cosim import DataError, FloatArray, Recording
from ddpc_cosim.identification.arx import choose_lags
from ddpc_cosim.identification.bootstrap import ensemble, gains
from ddpc_cosim.identification.candidates import candidates
from ddpc_cosim.identification.fits import Fit
from ddpc_cosim.identification.innovation import InnovationModel, StaticMap
from ddpc_cosim.identification.predictor import Samples

H = 0.5


def recorded(
    u: FloatArray, y: FloatArray, seams: tuple[int, ...] = (), d: FloatArray | None = None
) -> Recording:
    d = np.empty((len(u), 0)) if d is None else d
    return Recording(u, y, y, H, d=d)


def second_order(samples: int, noise: float, seed: int = 1) -> Recording:
    """Return data of y_k = 1.5 y_k-1 - 0.7 y_k-2 + u_k-1 + 0.5 u_k-2 + 0.3 d_k-1 + 4 + eps_k."""
    rng = np.random.default_rng(seed)
    u, d = rng.standard_normal((samples, 1)) + 3.0, rng.standard_normal((samples, 1))
    eps = noise * rng.standard_normal(samples)
    y = np.full((samples, 1), 40.0)
    for k in range(2, samples):
        past = 1.5 * y[k - 1] - 0.7 * y[k - 2] + u[k - 1] + 0.5 * u[k - 2] + 0.3 * d[k - 1]
        y[k] = past + 4.0 + eps[k]
    return recorded(u, y, d=d)


def fit_arx(recording: Recording, lags: int) -> InnovationModel:
    return Fit("arx", lags)(recording)


def test_without_noise_the_coefficients_are_those_of_the_plant() -> None:
    model = fit_arx(second_order(200, 0.0), 2)
    np.testing.assert_allclose(model.a, [[1.5, 1.0], [-0.7, 0.0]], atol=1e-8)
    np.testing.assert_allclose(model.b * model.c[0, 0], [[1.0], [0.5]], atol=1e-8)
    np.testing.assert_allclose(model.e * model.c[0, 0], [[0.3], [0.0]], atol=1e-8)
    np.testing.assert_allclose(model.k * model.c[0, 0], model.a[:, :1])
    at_rest = (1.5 * model.u_0 + 0.3 * model.d_0 + 4.0) / (1.0 - 1.5 + 0.7)
    np.testing.assert_allclose(model.y_0, at_rest, atol=1e-6)


def test_the_innovations_are_the_errors_of_the_least_squares() -> None:
    recording = second_order(500, 0.1)
    model = fit_arx(recording, 2)
    y, u, d = recording.y[:, 0], recording.u[:, 0], recording.d[:, 0]
    known = np.column_stack([y[1:-1], y[:-2], u[1:-1], u[:-2], d[1:-1], d[:-2], np.ones(498)])
    theta, *_ = np.linalg.lstsq(known, y[2:], rcond=None)
    expected = y[2:] - known @ theta
    np.testing.assert_allclose(model.one_step_errors(recording)[2:, 0], expected, atol=1e-9)
    assert model.covariance[0, 0] == pytest.approx(expected @ expected / (498 - 7))


def test_a_held_out_stretch_that_cannot_be_parted_prefers_the_smaller_model() -> None:
    """A quarter of 75 samples is shorter than the horizon: there is one error of each, and no spread."""
    first, *others = candidates(second_order(75, 0.1), "arx")
    assert first.excess(first) == (0.0, np.inf)
    assert all(first.model.order <= other.model.order for other in others)


def test_schwarz_finds_the_lags_of_the_plant() -> None:
    assert choose_lags(Samples.of(second_order(1000, 0.1))) == 2


def test_a_window_never_crosses_a_seam() -> None:
    parts = [second_order(60, 0.0, seed) for seed in (1, 2, 3)]
    model = fit_arx(Recording.join(parts), 2)
    np.testing.assert_allclose(model.a, [[1.5, 1.0], [-0.7, 0.0]], atol=1e-8)
    assert np.abs(model.one_step_errors(Recording.join(parts))).max() < 1e-8


def test_too_few_samples_for_the_lags_are_an_error() -> None:
    with pytest.raises(DataError, match=r"13 coefficients for each output: log longer, or lower lags"):
        fit_arx(second_order(12, 0.1), 4)
    with pytest.raises(DataError, match="4 lags need pieces of 5 samples; the longest has 3"):
        fit_arx(second_order(3, 0.1), 4)


def test_a_simulation_is_that_of_the_difference_equation() -> None:
    model = fit_arx(second_order(300, 0.1), 3)
    u = np.random.default_rng(3).standard_normal((50, 1)) + 3.0
    d = np.random.default_rng(4).standard_normal((50, 1))
    x = np.array([1.0, -2.0, 0.5])
    system = (model.a, np.hstack([model.b, model.e]), model.c, np.zeros((1, 2)), H)
    _, y, _ = dlsim(system, np.hstack([u - model.u_0, d - model.d_0]), x0=x)
    np.testing.assert_allclose(model.simulate(u, d, x=x), model.y_0 + y, atol=1e-10)
    eps = np.random.default_rng(5).standard_normal((50, 1))
    noisy = (model.a, np.hstack([model.b, model.e, model.k]), model.c, np.zeros((1, 3)), H)
    _, y, _ = dlsim(noisy, np.hstack([u - model.u_0, d - model.d_0, eps]), x0=x)
    np.testing.assert_allclose(model.simulate(u, d, eps, x), model.y_0 + y + eps, atol=1e-10)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), steps=st.integers(1, 6))
def test_what_a_model_made_itself_without_noise_it_predicts_exactly(seed: int, steps: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((3, 3))
    a *= 0.8 / np.abs(np.linalg.eigvals(a)).max()
    b, e, c = rng.standard_normal((3, 2)), rng.standard_normal((3, 1)), rng.standard_normal((2, 3))
    k = rng.standard_normal((3, 2)) * 0.01
    offsets = rng.standard_normal(2), rng.standard_normal(2), rng.standard_normal(1)
    model = InnovationModel(a, b, e, k, c, *offsets, np.eye(2), H, "arx")
    u, d = rng.standard_normal((40, 2)), rng.standard_normal((40, 1))
    x = rng.standard_normal(3)
    data = recorded(u, model.simulate(u, d, x=x), d=d)
    predicted = model.predict(data, steps)
    assert np.isnan(predicted[: steps - 1]).all()
    np.testing.assert_allclose(predicted[steps - 1 :], data.y[steps - 1 :], atol=1e-6)
    np.testing.assert_allclose(
        model.output(model.last_state(data)),
        model.simulate(np.vstack([u, u[:1]]), np.vstack([d, d[:1]]), x=x)[-1],
        atol=1e-6,
    )


def test_a_static_map_goes_on_beyond_its_points_and_through_them() -> None:
    curve = StaticMap((np.array([0.0, 1.0, 3.0]),), (np.array([0.0, 2.0, 4.0]),))
    given_points = np.array([[-1.0], [0.5], [2.0], [5.0]])
    np.testing.assert_allclose(curve(given_points), [[-2.0], [1.0], [3.0], [6.0]])


def test_a_model_rests_where_nothing_changes_any_more() -> None:
    model = fit_arx(second_order(300, 0.1), 2)
    u, d = np.full((200, 1), 5.0), np.full((200, 1), -1.0)
    y = model.simulate(u, d)
    np.testing.assert_allclose(y, np.broadcast_to(y[0], y.shape), atol=1e-9)


@pytest.mark.parametrize("pole", [1.0, 0.9999, 1.0001])
def test_what_takes_longer_than_the_data_does_not_rest_far_from_them(pole: float) -> None:
    """Two modes in other coordinates: the fast one rests, the other stays where the model is at x = 0."""
    poles, b = np.array([0.5, pole]), np.array([[1.0], [0.2]])
    to = np.array([[1.0, 2.0], [0.5, -1.0]])
    a = to @ np.diag(poles) @ np.linalg.inv(to)
    nothing = np.zeros((2, 0)), np.zeros((2, 1)), np.zeros(1), np.zeros(1), np.zeros(0)
    e, k, u_0, y_0, d_0 = nothing
    model = InnovationModel(a, to @ b, e, k, np.eye(1, 2), u_0, y_0, d_0, np.eye(1), H, "arx", rows=1000)
    u = np.array([3.0])
    np.testing.assert_allclose(np.linalg.solve(to, model.rest(u, d_0)), [3.0 / (1.0 - 0.5), 0.0], atol=1e-12)
    if pole == 0.9999:
        known = replace(model, rows=100_000)
        far = [3.0 / (1.0 - 0.5), 0.6 / (1.0 - pole)]
        np.testing.assert_allclose(np.linalg.solve(to, known.rest(u, d_0)), far)


def test_the_ensemble_spreads_as_the_estimate_does_over_new_data() -> None:
    """Over 60 recordings of the same plant, and over 60 bootstraps of one of them."""
    spread = [_gain(fit_arx(second_order(400, 0.5, seed), 2)) for seed in range(100, 160)]
    recording = second_order(400, 0.5)
    (best,) = candidates(recording, "arx", order=2)
    members = ensemble(recording, best, 60, np.random.default_rng(0))
    assert 0.5 < np.std([_gain(model) for model in members]) / np.std(spread) < 2.0


def _gain(model: InnovationModel) -> float:
    return float(gains(model)[0, 0])
