"""``inspect`` and ``init`` of SSP archives."""

import json
from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess

import numpy as np
import pandas as pd
import pytest

from ddpc_cosim import ConfigError, CoupledPlant, simulate
from ddpc_cosim.cli.commands.inspect import inspect
from ddpc_cosim.cli.commands.simulate import simulate as simulate_command
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.suggestion import suggest_study, write_study
from ddpc_cosim.variables import FloatArray

from .ssp_files import GAIN, binding, component, connection, linear, ssd, ssv, system, write_ssp
from .test_ssp_systems import BODY_MODEL, WHEEL_MODEL

Run = Callable[..., CompletedProcess[str]]


@pytest.fixture
def car(tmp_path: Path) -> Path:
    described = system(
        "car",
        component("body", "resources/body.fmu", "input force N, output place m, output speed m/s"),
        component(
            "wheel",
            "resources/wheel.fmu",
            "input road m, input body_place m, input body_speed m/s, output force N, output place m",
        ),
        connections=connection("road", "wheel/road")
        + connection("body/place", "wheel/body_place")
        + connection("body/speed", "wheel/body_speed")
        + connection("wheel/force", "body/force")
        + connection("body/place", "height", linear(1.0, 5.0)),
        connectors="input road mm, output height mm",
        bindings=binding(
            ssv(
                {
                    "body.mass": 3.0,
                    "wheel.mass": 1.0,
                    "wheel.spring": 12.0,
                    "wheel.damping": 6.0,
                    "wheel.tyre": 99,
                }
            )
        ),
    )
    files = {"resources/body.fmu": BODY_MODEL, "resources/wheel.fmu": WHEEL_MODEL}
    return write_ssp(tmp_path / "car.ssp", ssd(described, "2.0"), files)


def test_inspect_shows_parts_connections_order_and_values(
    car: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert inspect.main([str(car)], standalone_mode=False) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "system\ttest, SSP 2.0" in lines
    assert "order\tbody -> wheel" in lines
    assert "algebraic loop\tnone" in lines
    assert "part\tbody\tresources/body.fmu\tFMI 2.0\tco-simulation\tmass = 3.0" in lines
    assert "connection\troad\twheel.road\t[mm] -> [m]\t* 0.001" in lines
    assert "connection\tbody.place\theight\t[m] -> [mm]\t* 1000 +5" in lines
    assert any(line.startswith("input\troad\t[mm]\tstart 0") for line in lines)
    assert lines[-1].startswith("suggested study: ddpc-cosim init ")


def test_inspect_as_data_has_loops(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parts = (component(name, "resources/gain.fmu", "input u, output y") for name in "ab")
    wires = connection("a/y", "b/u") + connection("b/y", "a/u")
    path = write_ssp(
        tmp_path / "l.ssp", ssd(system("s", *parts, connections=wires)), {"resources/gain.fmu": GAIN}
    )
    assert inspect.main([str(path), "--json"], standalone_mode=False) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["algebraic_loops"] == [["a.u", "a.y", "b.u", "b.y"]]
    assert [part["name"] for part in data["parts"]] == ["a", "b"]
    assert {connection["from"]: connection["to"] for connection in data["connections"]} == {
        "a.y": "b.u",
        "b.y": "a.u",
    }


def test_inspect_of_what_cannot_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_ssp(tmp_path / "bad.ssp", ssd(system("s", component("a", "resources/a.fmu"))), {})
    assert inspect.main([str(path)], standalone_mode=False) == 1
    printed = capsys.readouterr().out
    assert "error\tinvalid-system\tthe system cannot run\tbad.ssp: " in printed
    assert 'SystemStructure.ssd: a: no file "resources/a.fmu" in the archive' in printed


def test_init_proposes_a_study_that_was_tried(car: Path, tmp_path: Path) -> None:
    proposal = suggest_study(car, budget=30.0)
    study = read_study(str(write_study(proposal, car, tmp_path / "study.toml"))).problem.study
    assert (study.plant.ssp, study.plant.inputs, study.plant.outputs) == (str(car), ["road"], ["height"])
    assert study.plant.coupling is not None
    assert study.plant.coupling.extrapolation == "linear"
    # On the road the car stands as high as that; both are in mm.
    np.testing.assert_allclose(proposal.gains, [[1.0]], atol=0.02)
    assert proposal.comments["head"][0].startswith("Tried once; best: ")


def test_an_archive_is_a_plant_in_python_too(car: Path) -> None:
    """With its connectors, or with signals of its parts; its values hold unless others are given."""
    with CoupledPlant.from_ssp(car, parameters={"wheel.tyre": 50.0}) as plant:
        assert [v.header for v in (*plant.inputs, *plant.outputs)] == ["road [mm]", "height [mm]"]
        np.testing.assert_allclose(plant.reset(), [5.0])
        # At rest on the road, whatever the tyre; the wheel's own damping would be 9.
        rows = [plant.step(np.array([10.0]), 0.01) for _ in range(1500)]
        np.testing.assert_allclose(rows[-1], [15.0], atol=0.01)
    with pytest.raises(ConfigError, match="communication_step = 0"):
        CoupledPlant.from_ssp(car, communication_step=0.0)
    with CoupledPlant.from_ssp(car, outputs=["body.speed"], isolated=True) as plant:
        assert [v.name for v in plant.outputs] == ["body.speed"]
        np.testing.assert_allclose(plant.reset(), [0.0])


def test_simulate_couples_an_archive_as_it_is_told(car: Path, tmp_path: Path) -> None:
    """As one equation the car, at rest, does what the shortest steps come near; what is wrong is told."""
    inputs = tmp_path / "road.csv"
    inputs.write_text("time,road\n0,10\n2,10\n", encoding="utf-8")

    def height(**coupling: float | str) -> FloatArray:
        frame = simulate(car, inputs=inputs, stop=2.0, step=0.1, coupling=coupling)
        return frame["height [mm]"].to_numpy()

    whole = height(algorithm="monolithic")
    errors = [
        np.abs(height(communication_step=h, extrapolation="linear") - whole).max() for h in (0.02, 0.01)
    ]
    assert errors[1] < 0.5 * errors[0] < 0.5
    with pytest.raises(ConfigError, match=r"coupling.algorithm: must be one of .* 'monolithic', got 'monol"):
        height(algorithm="monolitic")
    out = tmp_path / "car.csv"
    options = (
        "--inputs",
        inputs,
        "--stop",
        "2",
        "--step",
        "0.1",
        "--out",
        out,
        "--coupling",
        "algorithm=monolithic",
    )
    assert simulate_command.main([str(car), *map(str, options)], standalone_mode=False) == 0
    written = np.genfromtxt(out, delimiter=",", names=True)
    np.testing.assert_allclose(written["height_mm"], whole, rtol=1e-9)
    with pytest.raises(ConfigError, match="it is for systems of several"):
        simulate("pendulum", coupling={"algorithm": "parallel"})


def test_init_of_a_system_without_inputs(tmp_path: Path) -> None:
    parts = (component(name, "resources/gain.fmu", "input u, output y") for name in "ab")
    wires = connection("a/y", "b/u") + connection("b/y", "a/u", linear(0.5))
    path = write_ssp(
        tmp_path / "l.ssp", ssd(system("s", *parts, connections=wires)), {"resources/gain.fmu": GAIN}
    )
    with pytest.raises(ConfigError, match="the system has no input that is a number"):
        suggest_study(path)


@pytest.mark.parametrize(
    ("command", "words"),
    [("check", "is a system of several FMUs"), ("run", "is a plant and not a study; `ddpc-cosim init ")],
)
def test_commands_of_something_else_say_so(command: str, words: str, car: Path, run_program: Run) -> None:
    done = run_program(command, str(car))
    assert done.returncode == 2
    assert words in done.stderr


def test_a_coupled_plant_goes_on_from_a_state(car: Path, tmp_path: Path) -> None:
    """Divided runs are whole ones to the last bit, and another input may be driven from there on."""
    state = tmp_path / "mid.state"
    road = pd.DataFrame({"time": [0.0, 2.0], "road": [0.0, 50.0]})
    whole = simulate(car, inputs=road, stop=2, step=0.1)
    simulate(car, inputs=road, stop=0.7, step=0.1, save_state=state)
    rest = simulate(car, inputs=road, stop=2, load_state=state)
    pd.testing.assert_frame_equal(rest, whole.iloc[7:].reset_index(drop=True), check_exact=True)
    held = simulate(car, stop=4, load_state=state)
    assert held["height [mm]"].iloc[0] == rest["height [mm]"].iloc[0]
    assert held.attrs["notes"][1] == "not driven now, held as in the state: road = 15 mm"
    constant = pd.DataFrame({"time": [0.7, 4.0], "road": [15.0, 15.0]})
    driven = simulate(car, inputs=constant, stop=4, load_state=state)
    np.testing.assert_allclose(held["height [mm]"], driven["height [mm]"], rtol=1e-12)
