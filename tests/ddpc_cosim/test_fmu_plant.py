"""The paper's pendulum as an FMU behind the plant contract."""

import gc
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import fmpy
import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.integrate import solve_ivp

from ddpc_cosim import ConfigError, FMUPlant

H = 0.1
TORQUES = np.random.default_rng(7).uniform(-3.5, 3.5, 400)


@pytest.fixture
def plant(pendulum_fmu: Path) -> Iterator[FMUPlant]:
    with FMUPlant(pendulum_fmu) as plant:
        yield plant


def run(plant: FMUPlant, torques: np.ndarray = TORQUES, **parameters: float) -> np.ndarray:
    """Return the outputs at the start and after each held torque, shape (T + 1, p)."""
    rows = [plant.reset(parameters)]
    rows.extend(plant.step(np.array([torque]), H) for torque in torques)
    return np.array(rows)


def integrate(torques: np.ndarray, gain: float = 1.0, mass: float = 1.0) -> np.ndarray:
    """Integrate equation (22) with DOP853, step by step of the held torque."""
    r, g, k = 0.2, 9.81, 0.4
    rows = [np.zeros(2)]
    for torque in torques:

        def slope(_: float, x: np.ndarray, torque: float = torque) -> list[float]:
            return [x[1], -g / r * np.sin(x[0]) - k / (mass * r) * x[1] + gain * torque / (mass * r)]

        solution = solve_ivp(slope, (0.0, H), rows[-1], method="DOP853", rtol=1e-12, atol=1e-13)
        rows.append(solution.y[:, -1])
    return np.array(rows)


def test_variables_come_with_unit_range_and_display_unit(plant: FMUPlant) -> None:
    (torque,), (angle, velocity) = plant.inputs, plant.outputs
    assert (torque.name, torque.unit) == ("torque", "N.m")
    assert (angle.name, angle.unit, velocity.name, velocity.unit) == (
        "angle",
        "rad",
        "angular_velocity",
        "rad/s",
    )
    assert angle.display_unit is not None
    assert angle.display_unit.name == "deg"
    assert angle.display_unit.from_unit(np.array([np.pi])) == pytest.approx([180.0])


def test_trajectory_equals_dop853(plant: FMUPlant) -> None:
    assert np.abs(run(plant) - integrate(TORQUES)).max() < 1e-8


def test_trajectory_equals_the_one_of_fmpy(plant: FMUPlant, pendulum_fmu: Path) -> None:
    """FMPy sets the input before each step, so a table with one row per step is a zero-order hold."""
    time = np.arange(len(TORQUES)) * H
    table = np.array(list(zip(time, TORQUES, strict=True)), dtype=[("time", float), ("torque", float)])
    result = fmpy.simulate_fmu(
        str(pendulum_fmu),
        fmi_type="CoSimulation",
        input=table,
        output=["angle", "angular_velocity"],
        stop_time=len(TORQUES) * H,
        output_interval=H,
    )
    ours = run(plant)
    assert len(result) == len(ours)
    assert np.abs(result["angle"] - ours[:, 0]).max() < 1e-12
    assert np.abs(result["angular_velocity"] - ours[:, 1]).max() < 1e-11


def test_parameters_take_effect(plant: FMUPlant) -> None:
    torques = TORQUES[:50]
    assert np.abs(run(plant, torques, mass=1.5) - integrate(torques, mass=1.5)).max() < 1e-8


def test_parameters_hold_for_one_run_only(plant: FMUPlant) -> None:
    torques = TORQUES[:20]
    before = run(plant, torques)
    run(plant, torques, mass=1.5)
    assert np.array_equal(run(plant, torques), before)


def test_tunable_parameters_change_from_the_next_step_on(plant: FMUPlant) -> None:
    plant.reset()
    rows = [plant.step(np.array([t]), H) for t in TORQUES[:20]]
    plant.set_parameters({"torque_gain": -1.0})
    rows += [plant.step(np.array([t]), H) for t in TORQUES[20:40]]
    reversed_torques = np.concatenate([TORQUES[:20], -TORQUES[20:40]])
    assert np.abs(np.array(rows) - integrate(reversed_torques)[1:]).max() < 1e-8


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"mas": 1.0}, 'pendulum.fmu: no parameter "mas"; did you mean "mass"?'),
        ({"der(angle)": 1.0}, 'no parameter "der(angle)": the FMU calculates it'),
        ({"mass": -1.0}, "parameter mass = -1 is outside [0.001, inf]"),
        ({"mass": float("nan")}, "parameter mass = nan is outside"),
    ],
)
def test_impossible_parameters_are_refused(plant: FMUPlant, parameters: dict[str, float], words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        plant.reset(parameters)
    assert words in str(caught.value)


def test_all_impossible_parameters_are_named_at_once(plant: FMUPlant) -> None:
    plant.reset()
    with pytest.raises(ConfigError) as caught:
        plant.set_parameters({"mas": 1.0, "radius": -1.0, "gravity": 1.0})
    assert len(caught.value.faults) == 3
    assert 'parameter "gravity" cannot change during a run; tunable: mass, radius' in str(caught.value)


def test_all_unknown_signals_are_named_at_once(pendulum_fmu: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        FMUPlant(pendulum_fmu, inputs=["torqe", "wind"], outputs=["angel"])
    assert [fault.partition("; ")[::2] for fault in caught.value.faults] == [
        ('pendulum.fmu: no input "torqe"', 'did you mean "torque"?'),
        ('pendulum.fmu: no input "wind"', "there are: torque"),
        ('pendulum.fmu: no output "angel"', 'did you mean "angle"?'),
    ]


def test_signals_are_those_chosen_in_their_order(pendulum_fmu: Path) -> None:
    with (
        FMUPlant(pendulum_fmu) as all_signals,
        FMUPlant(pendulum_fmu, inputs=["torque"], outputs=["angular_velocity", "angle"]) as chosen,
    ):
        assert np.array_equal(run(chosen)[:, ::-1], run(all_signals))


def test_a_second_run_equals_the_first_to_the_last_bit(plant: FMUPlant) -> None:
    first = run(plant)
    assert np.array_equal(run(plant), first)


def test_two_plants_do_not_disturb_each_other(pendulum_fmu: Path) -> None:
    with FMUPlant(pendulum_fmu) as a, FMUPlant(pendulum_fmu) as b:
        alone = run(a, TORQUES[:50]), run(b, -TORQUES[:50])
        a.reset(), b.reset()
        together = [(a.step(np.array([t]), H), b.step(np.array([-t]), H)) for t in TORQUES[:50]]
    assert np.array_equal(np.array([row[0] for row in together]), alone[0][1:])
    assert np.array_equal(np.array([row[1] for row in together]), alone[1][1:])


def test_outputs_are_new_arrays(plant: FMUPlant) -> None:
    before = plant.reset()
    plant.step(np.array([1.0]), H)
    assert np.array_equal(before, [0.0, 0.0])


def test_time_is_counted_and_not_accumulated(make_fmu: Callable[..., Path]) -> None:
    """After 10^5 steps of 0.1 s a sum of steps would be off by 1e-8 s."""
    with FMUPlant(make_fmu()) as plant:
        plant.reset(t0=1.0)
        u = np.array([0.0])
        for _ in range(100_000):
            plant.step(u, H)
        assert plant.time == 1.0 + 100_000 * H


@given(st.lists(st.sampled_from([0.1, 0.05, 0.025]), max_size=30))
def test_time_is_the_sum_of_any_steps(pendulum_fmu: Path, sizes: list[float]) -> None:
    with FMUPlant(pendulum_fmu) as plant:
        plant.reset()
        for size in sizes:
            plant.step(np.array([0.0]), size)
        assert plant.time == pytest.approx(sum(sizes), abs=1e-12)


def test_a_step_before_reset_is_refused(plant: FMUPlant) -> None:
    with pytest.raises(ConfigError, match="step before reset"):
        plant.step(np.array([0.0]), H)


def test_nothing_is_left_behind(pendulum_fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    here = Path.cwd()

    closed = FMUPlant(pendulum_fmu)
    closed.reset()
    closed.close()
    assert list(tmp_path.iterdir()) == []

    forgotten = FMUPlant(pendulum_fmu)
    forgotten.reset()
    del forgotten
    gc.collect()
    assert list(tmp_path.iterdir()) == []

    with pytest.raises(ConfigError):
        FMUPlant(pendulum_fmu, inputs=["wind"])
    assert list(tmp_path.iterdir()) == []
    assert Path.cwd() == here


def test_closing_twice_does_no_harm(pendulum_fmu: Path) -> None:
    plant = FMUPlant(pendulum_fmu)
    plant.reset()
    plant.close()
    plant.close()


def test_provenance_names_the_file_and_its_content(plant: FMUPlant, pendulum_fmu: Path) -> None:
    import hashlib

    facts = plant.provenance()
    assert facts["fmu"] == "pendulum.fmu"
    assert facts["fmu_sha256"] == hashlib.sha256(pendulum_fmu.read_bytes()).hexdigest()
    assert facts["fmu_guid"] == fmpy.read_model_description(str(pendulum_fmu)).guid
    assert facts["fmi_version"] == "2.0 Co-Simulation"
