"""A plant that plays a model: its contract, its noise, and the same model as an FMU."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fmpy import simulate_fmu

from ddpc_cosim import ConfigError, FloatArray, FMUPlant, Variable
from ddpc_cosim.identification.export import export_identified
from ddpc_cosim.identification.innovation import InnovationModel, StaticMap
from ddpc_cosim.identification.plant import IdentifiedPlant

H = 0.5
INPUTS = (Variable("u", "V", start=1.0), Variable("heat", "W", start=2.0))
OUTPUTS = (Variable("y", "cm"), Variable("z", "K"))


def model(*, static: bool = False) -> InnovationModel:
    curve = StaticMap((np.array([0.0, 1.0, 3.0]),), (np.array([0.0, 2.0, 4.0]),))
    return InnovationModel(
        a=np.array([[0.9, 0.1], [-0.2, 0.7]]),
        b=np.array([[1.0], [0.5]]),
        e=np.array([[0.0], [0.3]]),
        k=np.array([[0.4, 0.0], [0.1, 0.2]]),
        c=np.array([[1.0, 0.0], [0.5, 2.0]]),
        u_0=np.array([0.5]),
        y_0=np.array([10.0, 20.0]),
        d_0=np.array([1.0]),
        covariance=np.array([[0.04, 0.01], [0.01, 0.09]]),
        sampling_time=H,
        method="arx",
        input_map=curve if static else None,
        output_map=StaticMap((np.array([0.0, 12.0, 13.0]),) * 2, (np.array([0.0, 12.0, 15.0]),) * 2)
        if static
        else None,
    )


def inputs(samples: int) -> FloatArray:
    return np.random.default_rng(2).normal([1.0, 2.0], size=(samples, 2))


def run(plant: IdentifiedPlant, u: FloatArray, h: float = H) -> FloatArray:
    return np.array([plant.reset(), *(plant.step(row, h) for row in u)])


def test_without_noise_it_is_the_simulation_of_its_model() -> None:
    u = inputs(30)
    y = run(IdentifiedPlant(model(), INPUTS, OUTPUTS), u)
    expected = model().simulate(u[:, :1], u[:, 1:], x=model().rest(np.array([1.0]), np.array([2.0])))
    np.testing.assert_allclose(y[:-1], expected, atol=1e-12)


def test_it_rests_at_the_start_values_of_its_inputs() -> None:
    y = run(IdentifiedPlant(model(), INPUTS, OUTPUTS), np.tile([1.0, 2.0], (20, 1)))
    np.testing.assert_allclose(y, np.broadcast_to(y[0], y.shape), atol=1e-12)


def test_its_noise_has_the_covariance_of_the_innovations_and_goes_through_the_model() -> None:
    samples = 4000
    u = np.tile([1.0, 2.0], (samples, 1))
    quiet, noisy = (run(IdentifiedPlant(model(), INPUTS, OUTPUTS, seed=seed), u) for seed in (None, 3))
    still = replace(model(), k=np.zeros((2, 2)))
    noise = run(IdentifiedPlant(still, INPUTS, OUTPUTS, seed=3), u) - quiet
    np.testing.assert_allclose(np.cov(noise.T), model().covariance, atol=0.01)
    x = model().rest(np.array([1.0]), np.array([2.0]))
    expected = model().simulate(np.vstack([u[:, :1], u[:1, :1]]), np.vstack([u[:, 1:], u[:1, 1:]]), noise, x)
    np.testing.assert_allclose(noisy, expected, atol=1e-9)


def test_noise_depends_on_seed_and_run_and_not_on_what_drives_it() -> None:
    u, other = inputs(10), inputs(10) + 1.0

    def noise(seed: int, driven: FloatArray, *, records: bool = False) -> FloatArray:
        still = replace(model(), k=np.zeros((2, 2)))
        plants = (IdentifiedPlant(still, INPUTS, OUTPUTS, seed=s, records=records) for s in (seed, None))
        loud, quiet = (run(plant, driven) for plant in plants)
        return loud - quiet

    np.testing.assert_allclose(noise(1, u), noise(1, other), atol=1e-12)
    assert not np.allclose(noise(1, u), noise(2, u))
    assert not np.allclose(noise(1, u), noise(1, u, records=True))


def test_the_loop_after_an_experiment_has_the_noise_of_a_loop_without_one() -> None:
    plain = IdentifiedPlant(model(), INPUTS, OUTPUTS, seed=1)
    recorded = IdentifiedPlant(model(), INPUTS, OUTPUTS, seed=1, records=True)
    first = run(recorded, inputs(5))
    np.testing.assert_array_equal(run(recorded, inputs(5)), run(plain, inputs(5)))
    assert not np.allclose(first, run(plain, inputs(5)))


def test_a_step_is_as_many_samples_of_the_model_as_it_is_long() -> None:
    u = inputs(10)
    fine = run(IdentifiedPlant(model(), INPUTS, OUTPUTS, seed=1), np.repeat(u, 4, axis=0))
    coarse = run(IdentifiedPlant(model(), INPUTS, OUTPUTS, seed=1), u, 4 * H)
    np.testing.assert_array_equal(coarse, fine[::4])


@pytest.mark.parametrize("h", [0.25, 0.7, 1.2])
def test_another_sampling_time_is_an_error_that_says_which_there_are(h: float) -> None:
    plant = IdentifiedPlant(model(), INPUTS, OUTPUTS)
    with pytest.raises(ConfigError, match=r"identified at 0.5 s; needed: 0.5 s or an integer multiple of it"):
        plant.plan(h, 10.0)


def test_it_goes_on_from_a_state_with_the_same_noise() -> None:
    plant = IdentifiedPlant(model(), INPUTS, OUTPUTS, seed=1)
    u = inputs(20)
    run(plant, u[:10])
    state = plant.save_state()
    first = [plant.step(row, H) for row in u[10:]]
    plant.restore_state(state)
    np.testing.assert_array_equal([plant.step(row, H) for row in u[10:]], first)


def test_it_has_no_parameters() -> None:
    with pytest.raises(ConfigError, match=r"has no parameters \(gain\)"):
        IdentifiedPlant(model(), INPUTS, OUTPUTS).reset({"gain": 2.0})


@pytest.fixture(scope="module", params=["2.0 linear", "3.0 static"])
def exported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bool]:
    version, kind = request.param.split()
    path = tmp_path_factory.mktemp("fmu") / "plant.fmu"
    is_static = kind == "static"
    return export_identified(model(static=is_static), INPUTS, OUTPUTS, path, version), is_static


def test_the_fmu_is_the_plant(exported: tuple[Path, bool]) -> None:
    path, is_static = exported
    u = inputs(40)
    expected = run(IdentifiedPlant(model(static=is_static), INPUTS, OUTPUTS), u)
    with FMUPlant(path) as plant:
        assert [variable.name for variable in plant.outputs] == ["y", "z"]
        plant.plan(H, 20.0)
        y = [plant.reset(), *(plant.step(row, H) for row in u)]
    np.testing.assert_allclose(y, expected, atol=1e-9)


def test_the_fmu_in_another_importer_is_the_plant(exported: tuple[Path, bool]) -> None:
    path, is_static = exported
    u = inputs(40)
    expected = run(IdentifiedPlant(model(static=is_static), INPUTS, OUTPUTS), u)
    driven = np.zeros(40, dtype=[("time", float), ("u", float), ("heat", float)])
    driven["time"], driven["u"], driven["heat"] = np.arange(40) * H, u[:, 0], u[:, 1]
    result = simulate_fmu(
        path, stop_time=19.5, step_size=H, output_interval=H, input=driven, output=["y", "z"]
    )
    y = np.column_stack([result["y"], result["z"]])
    np.testing.assert_allclose(y, expected[: len(y)], atol=1e-9)


def test_between_instants_the_outputs_of_the_fmu_are_held(exported: tuple[Path, bool]) -> None:
    path, _ = exported
    with FMUPlant(path) as plant:
        plant.plan(H / 5, 20.0)
        first = plant.reset()
        y = [plant.step(np.array([3.0, 2.0]), H / 5) for _ in range(5)]
    for held in y[:4]:
        np.testing.assert_array_equal(held, first)
    assert not np.allclose(y[4], first)
