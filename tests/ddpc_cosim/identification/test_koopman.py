"""Koopman models against the difference equations that made the data, and against their FMU."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from ddpc_cosim import FloatArray, FMUPlant, IdentifiedPlant, Monomials, Recording, Variable
from ddpc_cosim.identification.bootstrap import ensemble, gains
from ddpc_cosim.identification.candidates import candidates
from ddpc_cosim.identification.export import export_identified
from ddpc_cosim.identification.koopman import KoopmanFit, koopman_models

H = 0.5


def bilinear(rows: int, noise: float, seed: int = 0, *, mixing: float = 0.3, delay: int = 0) -> Recording:
    """Return data of y_k = 0.8 y_k-1 + (0.5 + mixing y_k-1) u_k-1-delay + 0.2 d_k-1 + eps_k + 1."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-0.5, 0.5, (rows // 4 + 1, 1)), 4, axis=0)[:rows]
    d, y = rng.uniform(-0.5, 0.5, (rows, 1)), np.full((rows, 1), 5.0)
    for k in range(1, rows):
        driven = u[k - 1 - delay] if k > delay else u[0]
        y[k] = 0.8 * y[k - 1] + (0.5 + mixing * y[k - 1]) * driven + 0.2 * d[k - 1] + 1.0
        y[k] += noise * rng.standard_normal()
    return Recording(u, y, y, H, d=d)


@pytest.mark.parametrize("delay", [0, 2])
def test_without_noise_it_is_the_plant(delay: int) -> None:
    data = bilinear(300, 0.0, delay=delay)
    (_, model), *_ = koopman_models(data, (delay,), 1, wanted=True)
    other = bilinear(200, 0.0, 1, delay=delay)
    simulated = model.simulate(other.u, other.d, x=model.first_state(other))
    np.testing.assert_allclose(simulated[5:], other.y[5:], atol=1e-6)
    rest = model.output(model.rest(np.array([0.2]), np.array([0.1])))
    np.testing.assert_allclose(rest, (0.5 * 0.2 + 0.2 * 0.1 + 1.0) / (1.0 - 0.8 - 0.3 * 0.2))


def test_what_is_linear_about_rest_is_the_slope_there() -> None:
    (_, model), *_ = koopman_models(bilinear(300, 0.0, delay=2), (2,), 1, wanted=True)
    a, b, c = model.linear_part()
    x = model.rest(model.u_0, model.d_0)
    np.testing.assert_allclose(c[0], approx_fprime(x, lambda x: model.output(x)[0]), atol=1e-6)
    u, d = model.u_0[0], model.d_0[0]
    y = (0.5 * u + 0.2 * d + 1.0) / (0.2 - 0.3 * u)
    np.testing.assert_allclose(gains(model), (0.5 + 0.3 * y) / (0.2 - 0.3 * u), rtol=1e-6)
    step = np.array([1e-5])
    onward = [model.onward(x, model.driven(model.u_0 + sign * step, model.d_0)) for sign in (1.0, -1.0)]
    np.testing.assert_allclose(b[:, 0], (onward[0] - onward[1]) / 2e-5, atol=1e-6)
    slopes = [
        (
            model.onward(x + e, model.driven(model.u_0, model.d_0))
            - model.onward(x, model.driven(model.u_0, model.d_0))
        )
        / 1e-6
        for e in 1e-6 * np.eye(model.order)
    ]
    np.testing.assert_allclose(a, np.transpose(slopes), atol=1e-4)


def test_it_is_chosen_where_signals_multiply_and_not_where_the_plant_is_linear() -> None:
    best, second = candidates(bilinear(600, 0.05))[:2]
    assert best.method == "koopman"
    assert best.held_out[0] > 85.0 > second.held_out[0]
    tried = candidates(bilinear(600, 0.05, mixing=0.0))
    assert tried[0].method != "koopman"
    assert not tried[0].is_nonlinear


def test_whatever_drives_it_it_stays_bounded() -> None:
    model = KoopmanFit(1, (0,), Monomials.between(3, 0, 3))(bilinear(300, 0.05))
    wild = 1e3 * np.random.default_rng(0).standard_normal((400, 1))
    reach = np.abs(model.simulate(wild, wild)).max()
    assert reach < 100.0
    np.testing.assert_array_less(np.abs(model.simulate(1e3 * wild, wild)).max(), 100.0)


def test_a_model_that_runs_away_is_out() -> None:
    """A pole outside the unit circle: recorded under feedback, and simulated without."""
    rng = np.random.default_rng(0)
    u, y = np.zeros((400, 1)), np.zeros((400, 1))
    for k in range(1, 400):
        u[k - 1] = rng.uniform(-1.0, 1.0) - 0.9 * y[k - 1]
        y[k] = 1.5 * y[k - 1] + u[k - 1] + 0.05 * rng.standard_normal()
    data = Recording(u, y, y, 1.0)
    assert KoopmanFit(1, (0,), Monomials.between(2, 0, 1))(data).runs_away(data)
    assert not any(fit.believed == 1.0 for fit, _ in koopman_models(data, (0,), 1, wanted=True))


def test_members_of_an_ensemble_spread_about_the_model_and_have_its_dictionary() -> None:
    data = bilinear(400, 0.05)
    (best,) = candidates(data, "koopman", 1)
    members = ensemble(data, best, 8, np.random.default_rng(0))
    spread = np.array([gains(member)[0, 0] for member in members])
    assert abs(spread.mean() - gains(best.model)[0, 0]) < 3.0 * spread.std()
    assert 0.0 < spread.std() < 0.2 * spread.mean()


def test_a_measurement_is_believed_as_far_as_it_was_told() -> None:
    data = bilinear(300, 0.05)
    lift = Monomials.between(3, 0, 2)
    model = KoopmanFit(1, (0,), lift, 0.5)(data)
    x, error = model.first_state(data), np.array([0.4])
    u, d = data.u[0], data.d[0]
    difference = model.next_state(x, u, d, error) - model.next_state(x, u, d, 0.0 * error)
    np.testing.assert_allclose(difference, 0.5 * 0.4 * np.eye(model.order)[0], atol=1e-12)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_the_fmu_is_the_plant(version: str, tmp_path: Path) -> None:
    (_, model), *_ = koopman_models(bilinear(300, 0.02, delay=2), (2,), 2, wanted=True)
    inputs = Variable("u", "V", start=0.1), Variable("d", "W", start=0.2)
    outputs = (Variable("y", "cm"),)
    driven = np.random.default_rng(2).uniform(-0.7, 0.7, size=(40, 2))

    def run(plant: IdentifiedPlant | FMUPlant) -> FloatArray:
        plant.plan(H, 20.0)
        return np.array([plant.reset(), *(plant.step(row, H) for row in driven)])

    expected = run(IdentifiedPlant(model, inputs, outputs))
    with FMUPlant(export_identified(model, inputs, outputs, tmp_path / "plant.fmu", version)) as plant:
        np.testing.assert_allclose(run(plant), expected, atol=1e-9)


def test_other_units_are_other_units() -> None:
    data = bilinear(300, 0.05)
    lift, y = Monomials.between(3, 0, 2), 1e3 * data.y - 5.0
    models = [KoopmanFit(1, (0,), lift)(data), KoopmanFit(1, (0,), lift)(replace(data, y=y, measured=y))]
    runs = [model.simulate(data.u, data.d) for model in models]
    np.testing.assert_allclose(runs[1], 1e3 * runs[0] - 5.0, rtol=1e-7)
