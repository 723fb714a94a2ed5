"""Adaptive GPC: its estimation against weighted least squares, its law against the paper's polynomials."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.polynomial import polynomial as poly
from scipy.optimize import lsq_linear
from scipy.signal import lfilter

from ddpc_controllers import GPC
from ddpc_controllers.models.recursive import Changes, Lengths, RecursiveLeastSquares, recorded_changes
from ddpc_cosim import Action, ConfigError, DataError, FloatArray, Loop, Recording, Sample, Variable

from .loops import LinearPlant, close_loop, experiment, make_loop

FREE = np.full(1, np.inf)
SEEDS = st.integers(0, 10_000)


def regression(
    seed: int, samples: int = 30, terms: int = 3, outputs: int = 2
) -> tuple[FloatArray, FloatArray]:
    """Regressors and targets of a random model with noise; the last third hardly excites."""
    rng = np.random.default_rng(seed)
    size = np.where(np.arange(samples) < samples * 2 / 3, 1.0, 1e-3)[:, np.newaxis]
    phi = size * rng.standard_normal((samples, terms))
    return phi, phi @ rng.standard_normal((terms, outputs)) + 0.1 * rng.standard_normal((samples, outputs))


@given(seed=SEEDS, forgetting=st.floats(0.8, 1.0), limit=st.floats(1.0, 1e4), prior=st.floats(0.1, 1e3))
@settings(max_examples=40, deadline=None)
def test_recursive_least_squares_are_those_of_all_samples_weighted_by_their_age(
    seed: int, forgetting: float, limit: float, prior: float
) -> None:
    phi, targets = regression(seed)
    first = np.random.default_rng(seed + 1).standard_normal((3, 2))
    model = RecursiveLeastSquares(first.copy(), np.sqrt(prior) * np.eye(3), forgetting, limit)
    information, right = np.eye(3) / prior, first / prior
    for regressor, target in zip(phi, targets, strict=True):
        kept = model.update(regressor, target)
        assert kept in (1.0, forgetting)
        information = kept * information + np.outer(regressor, regressor)
        right = kept * right + np.outer(regressor, target)
    assert model.coefficients == pytest.approx(np.linalg.solve(information, right), abs=1e-7)
    covariance = model.root @ model.root.T
    assert covariance == pytest.approx(np.linalg.inv(information), rel=1e-6, abs=1e-9 * prior)
    assert np.trace(covariance) <= max(limit, 3 * prior) * (1 + 1e-9)


def test_it_forgets_with_every_sample_while_the_loop_moves_and_not_for_ever_where_it_rests() -> None:
    model = RecursiveLeastSquares(np.zeros((3, 2)), np.eye(3), 0.9, 1e3)
    phi, targets = regression(3)
    assert {model.update(*pair) for pair in zip(phi[:20], targets[:20], strict=True)} == {0.9}
    kept = [model.update(1e-6 * np.ones(3), np.zeros(2)) for _ in range(300)]
    assert kept[0] == 0.9
    assert kept[-1] == 1.0
    assert 500.0 < np.trace(model.root @ model.root.T) <= 1e3


def test_what_is_predicted_within_the_dead_zone_teaches_nothing() -> None:
    phi, _ = regression(4)
    model = RecursiveLeastSquares(np.zeros((3, 2)), np.eye(3), 0.9, 1e3, dead_zone=0.2)
    root = model.root
    assert model.update(phi[0], np.array([0.2, -0.2])) == 1.0
    assert (model.coefficients == 0.0).all()
    assert model.root is root
    assert model.update(phi[0], np.array([0.1, -0.3])) == 0.9
    assert (model.coefficients != 0.0).any()


def recorded(plant: LinearPlant, samples: int = 60, seed: int = 5) -> Recording:
    u = np.random.default_rng(seed).uniform(-1.0, 1.0, (samples, plant.b.shape[1]))
    recording = experiment(plant.advance, u, len(plant.a), plant.c)
    return replace(recording, measured=recording.y)


def started(controller: GPC, recording: Recording | None, limit: float = np.inf, **changes: Any) -> Loop:
    m, p = (1, 1) if recording is None else (recording.u.shape[1], recording.y.shape[1])
    loop = make_loop(recording, np.full(m, limit), np.full(p, np.inf), **changes)
    controller.start(loop)
    return loop


def test_a_recording_is_learned_as_if_it_had_been_followed_without_forgetting() -> None:
    plant = LinearPlant.random(np.random.default_rng(1), 3, 2, 2)
    recording = Recording.join([recorded(plant), recorded(plant, 20, 6)])
    controller = GPC(initial_covariance=50.0)
    started(controller, recording)
    lengths = Lengths(2, 2, 0, controller.output_length, controller.input_length)
    pairs = recorded_changes(Changes(lengths, controller.observer_pole), recording.pieces)
    # Of a piece, phi is known from the sample on before which there are Lu + 1 changes.
    assert len(pairs[0]) == len(recording) - 2 * (controller.input_length + 1)
    model = RecursiveLeastSquares(np.zeros((10, 2)), np.sqrt(50.0) * np.eye(10), 1.0, np.inf)
    for pair in zip(*pairs, strict=True):
        model.update(*pair)
    assert controller._model.coefficients == pytest.approx(model.coefficients, abs=1e-9)
    root = controller._model.root
    assert root @ root.T == pytest.approx(model.root @ model.root.T, abs=1e-9)


def test_the_recording_of_a_plant_of_that_order_gives_its_coefficients() -> None:
    """y+ = 1.5 y - 0.7 y- + u + 0.5 u-, in changes."""
    plant = LinearPlant(np.array([[1.5, 1.0], [-0.7, 0.0]]), np.array([[1.0], [0.5]]), np.array([[1.0, 0.0]]))
    controller = GPC(input_length=2, initial_covariance=1e8)
    started(controller, recorded(plant))
    assert controller._model.coefficients[:, 0] == pytest.approx([1.5, -0.7, 1.0, 0.5], abs=1e-5)


def diophantine(a: FloatArray, t: FloatArray, j: int) -> tuple[FloatArray, FloatArray]:
    """Return E_j and F_j of ``T = E_j A (1 - z) + z^j F_j``, z being one sample back."""
    whole = poly.polymul(a, [1.0, -1.0])
    left, quotient = np.zeros(len(whole) + len(t) + j), np.zeros(j)
    left[: len(t)] = t
    for i in range(j):
        quotient[i] = left[i]
        left[i : i + len(whole)] -= quotient[i] * whole
    return quotient, left[j:]


def by_polynomials(controller: GPC, y: FloatArray, du: FloatArray, reference: FloatArray) -> float:
    """Return the next change of the input as Clarke, Mohtadi and Tuffs (1987) have it, from rest on.

    ``T = E_j A delta + z^j F_j`` and ``E_j B = G_j T + z^j Gamma_j``: the outputs to come are
    ``G_j du(t + j - 1) + Gamma_j du_f(t - 1) + F_j y_f(t)``, the filtered signals being divided by T.
    """
    n, ly = controller.horizon, controller.output_length
    nu = controller.control_horizon or n
    theta = controller._model.coefficients[:, 0]
    a, b, t = np.append(1.0, -theta[:ly]), theta[ly:], np.array([1.0, -controller.observer_pole])
    filtered_y, filtered_du = lfilter([1.0], t, y), lfilter([1.0], t, du)
    gain, free = np.zeros((n, nu)), np.zeros(n)
    for j in range(1, n + 1):
        e, f = diophantine(a, t, j)
        left = np.zeros(j + len(b) + len(t) + len(e))
        product = poly.polymul(e, b)
        left[: len(product)] = product
        g = np.zeros(j)
        for i in range(j):
            g[i] = left[i]
            left[i : i + len(t)] -= g[i] * t
        gamma = left[j:]
        for i in range(min(nu, j)):
            gain[j - 1, i] = g[j - 1 - i]
        past_y, past_du = filtered_y[::-1][: len(f)], filtered_du[::-1][: len(gamma)]
        free[j - 1] = f[: len(past_y)] @ past_y + gamma[: len(past_du)] @ past_du
    hessian: FloatArray = gain.T @ gain + np.asarray(controller.change_weight) * np.eye(nu)
    return float(np.linalg.solve(hessian, gain.T @ (reference - free))[0])


@given(
    seed=SEEDS,
    horizon=st.integers(1, 8),
    steps=st.integers(0, 3),
    output_length=st.integers(1, 3),
    input_length=st.integers(1, 3),
    pole=st.sampled_from([0.0, 0.5, 0.9]),
    forgetting=st.sampled_from([0.9, 1.0]),
)
@settings(max_examples=25, deadline=None)
def test_without_limits_it_is_the_law_of_the_paper_with_the_latest_estimate(
    seed: int, horizon: int, steps: int, output_length: int, input_length: int, pole: float, forgetting: float
) -> None:
    controller = GPC(
        horizon=horizon,
        control_horizon=min(steps, horizon),
        output_length=output_length,
        input_length=input_length,
        observer_pole=pole,
        forgetting_factor=forgetting,
        change_weight=0.3,
    )
    rng = np.random.default_rng(seed)
    plant = LinearPlant.random(rng, 2, 1, 1)
    started(controller, recorded(plant))
    state, y, du, last = np.zeros(2), np.zeros(0), np.zeros(0), 0.0
    wanted = np.cumsum(rng.standard_normal(40))
    for k in range(12):
        y = np.append(y, plant.c @ state)
        ahead = wanted[k + 1 : k + 1 + horizon, np.newaxis]
        action = controller.step(Sample(k, 0.1 * k, y[-1:], y[-1:], ahead, wanted[k : k + 1]))
        assert isinstance(action, Action)
        change = by_polynomials(controller, y, du, ahead[:, 0])
        assert action.u[0] - last == pytest.approx(change, rel=1e-7, abs=1e-8)
        du, last = np.append(du, action.u[0] - last), float(action.u[0])
        state = plant.advance(state, action.u)


class Disturbed:
    """Two inputs, two outputs and a disturbance, sampled; what is measured of it shows one sample later."""

    def __init__(self) -> None:
        rng = np.random.default_rng(8)
        self.plant = LinearPlant.random(rng, 3, 3, 2)
        self.d = np.cumsum(rng.standard_normal(90))[:, np.newaxis]

    def record(self) -> Recording:
        u = np.random.default_rng(9).uniform(-1.0, 1.0, (60, 2))
        whole = experiment(self.plant.advance, np.hstack([u, self.d[:60]]), 3, self.plant.c)
        return Recording(u, whole.y, whole.y, whole.sampling_time, d=self.d[:60])


def by_running_the_model(
    controller: GPC, y: FloatArray, u: FloatArray, d: FloatArray, du: FloatArray
) -> FloatArray:
    """Return the outputs to come of the model run on changes, sample by sample; T is 1.

    ``y``, ``u`` end with this sample and the last one, ``d`` reaches over the horizon.
    """
    theta, ly, lu = controller._model.coefficients, controller.output_length, controller.input_length
    k, y = len(y) - 1, y.copy()
    changes = np.vstack([np.diff(u, axis=0, prepend=0.0), du])
    for _ in range(controller.horizon):
        now = len(y) - 1
        of_y = [y[now - i] - y[now - i - 1] for i in range(ly)]
        of_u = [changes[now - i] if now - i < len(changes) else np.zeros(2) for i in range(lu)]
        of_d = [d[now + 1 - i] - d[now - i] for i in range(lu + 1)]
        y = np.vstack([y, y[now] + np.concatenate([*of_y, *of_u, *of_d]) @ theta])
    return y[k + 1 :].ravel()


@pytest.mark.parametrize("use_forecast", [True, False])
def test_with_limits_and_a_known_disturbance_it_is_the_optimum_of_the_model_run_ahead(
    use_forecast: bool,
) -> None:
    plant, n, limit = Disturbed(), 5, 4.0
    controller = GPC(
        horizon=n,
        observer_pole=0.0,
        output_weight=[1.0, 3.0],
        change_weight=[0.1, 0.4],
        use_forecast=use_forecast,
    )
    started(controller, plant.record(), limit, disturbances=(Variable("d"),))
    assert np.linalg.norm(controller._model.coefficients[10:]) > 0.1
    state, y, u, reached = np.zeros(3), np.zeros((0, 2)), np.zeros((0, 2)), 0
    for k in range(20):
        d = plant.d[60 + k : 62 + k + n] - plant.d[60]
        y = np.vstack([y, plant.plant.c @ state])
        ahead = np.tile([1.0, -1.0], (n, 1)) * np.sin(k)
        sample = Sample(k, 0.1 * k, y[-1], y[-1], ahead, ahead[0], disturbance=d[0], forecast=d[1 : n + 1])
        action = controller.step(sample)
        assert isinstance(action, Action)
        if k >= 8:  # there is a past of full length
            known = plant.d[60 : 61 + k + n] - plant.d[60]
            if not use_forecast:
                known = np.vstack([known[: k + 1], np.repeat(known[k : k + 1], n, axis=0)])
            free = by_running_the_model(controller, y, u, known, np.zeros((n, 2)))
            unit = np.eye(2 * n).reshape(-1, n, 2)
            gain = np.column_stack([by_running_the_model(controller, y, u, known, du) - free for du in unit])
            # In levels of the inputs the limits are a box.
            to_changes = np.kron(np.eye(n) - np.eye(n, k=-1), np.eye(2))
            first = np.append(u[-1], np.zeros(2 * n - 2))
            weights = np.sqrt(np.tile([1.0, 3.0], n)), np.sqrt(np.tile([0.1, 0.4], n))
            system = np.vstack([weights[0][:, np.newaxis] * gain, np.diag(weights[1])])
            right = np.append(weights[0] * (ahead.ravel() - free), np.zeros(2 * n))
            best = lsq_linear(system @ to_changes, right + system @ first, (-limit, limit), tol=1e-14)
            assert action.u == pytest.approx(best.x[:2], abs=1e-7)
            reached += int((np.abs(best.x[:2]) > limit - 1e-9).any())
            assert action.info["cost"] == pytest.approx(2 * best.cost, rel=1e-6)
        u = np.vstack([u, action.u])
        state = plant.plant.advance(state, np.append(action.u, d[0]))
    assert 0 < reached < 12


def test_a_gain_that_changes_is_learned_without_a_recording() -> None:
    lag = LinearPlant.lag(0.8, 0.2)
    controller = GPC(initial_model="gradient", observer_pole=0.0, forgetting_factor=0.9)
    gain = 1.0

    def changing(state: FloatArray, u: FloatArray) -> FloatArray:
        return 0.8 * state + 0.2 * gain * u

    reference = np.repeat([[1.0], [-1.0]] * 6, 20, axis=0)
    run = close_loop(controller, make_loop(None, FREE, FREE), changing, lag.c, reference, 119)
    assert np.abs(run.y[109] - run.reference[109]).max() < 1e-2
    assert controller._model.coefficients[2, 0] == pytest.approx(0.2, abs=1e-3)
    gain = 3.0
    state = run.y[-1]
    for k in range(120, 200):
        ahead = reference[k + 1 : k + 11]
        ahead = np.vstack([ahead, np.repeat(ahead[-1:], 10 - len(ahead), axis=0)])
        action = controller.step(Sample(k, 0.1 * k, state, state, ahead, reference[k]))
        assert isinstance(action, Action)
        state = changing(state, action.u)
    assert controller._model.coefficients[2, 0] == pytest.approx(0.6, abs=1e-2)


def test_a_constant_disturbance_leaves_no_offset() -> None:
    plant = LinearPlant.random(np.random.default_rng(2), 3, 2, 2)
    controller = GPC()

    def pushed(state: FloatArray, u: FloatArray) -> FloatArray:
        return plant.advance(state, u + np.array([0.5, -0.3]))

    loop = make_loop(recorded(plant), np.full(2, 50.0), np.full(2, np.inf))
    run = close_loop(controller, loop, pushed, plant.c, np.tile([0.3, -0.2], (260, 1)), 200)
    assert np.abs(run.y[-1] - run.reference[-1]).max() < 1e-6


def test_nothing_is_learned_of_samples_that_are_not_known() -> None:
    plant = LinearPlant.lag(0.8, 0.2)
    controller = GPC(scaling="none")
    started(controller, recorded(plant))
    estimates, state = [], np.zeros(1)
    for k in range(20):
        y = np.full(1, np.nan) if k == 8 else state
        action = controller.step(Sample(k, 0.1 * k, y, y, np.full((10, 1), np.sin(k)), np.zeros(1)))
        assert isinstance(action, Action)
        assert bool(action.info) == (k != 8)
        estimates.append(controller._model.coefficients)
        state = plant.advance(state, action.u) + 0.01 * np.cos(k)
    same = [estimates[k] is estimates[k - 1] for k in range(1, 20)]
    # One of a start at rest, and one with four changes after the gap.
    assert same == [k == 8 or 8 < k <= 8 + 4 for k in range(1, 20)]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"control_horizon": 11}, "control_horizon = 11 is longer than horizon = 10"),
        ({"forgetting_factor": 1.1}, "forgetting_factor"),
        ({"observer_pole": 1.0}, "observer_pole"),
        ({"initial_model": "none"}, "initial_model"),
    ],
)
def test_an_impossible_setting_is_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        GPC(**changes)


def test_a_recording_that_is_too_short_or_stands_still_is_refused() -> None:
    plant = LinearPlant.lag(0.8, 0.2)
    with pytest.raises(DataError, match=r"has 8 samples, of which 4 .* takes at least 9 in one piece"):
        started(GPC(), recorded(plant, 8))
    assert GPC().recording_length(1, 1, 1) == 9
    still = replace(recorded(plant), u=np.zeros((60, 1)))
    with pytest.raises(DataError, match="do not show what they do"):
        started(GPC(), still)


def test_a_dead_time_beyond_its_past_is_warned_of() -> None:
    late = LinearPlant(np.eye(6, k=-1) + np.diag([0, 0, 0, 0, 0, 0.5]), np.eye(6)[:, :1], np.eye(6)[-1:])
    short, long = GPC(), GPC(input_length=6)
    recording = recorded(late, 200)
    started(short, recording)
    started(long, recording)
    assert [text.partition(":")[2] for text in short.warnings()] == [
        " lengthen input_length, or sample more slowly"
    ]
    assert not long.warnings()
