"""Which output feeds which input: going by what FMUs declare, and one that is tried."""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest
from click.testing import CliRunner

from ddpc_cosim import ConfigError
from ddpc_cosim.cli.main import main
from ddpc_cosim.description import describe
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.suggestion import suggest_study, write_study
from ddpc_cosim.suggestion.joining import Joined, join, part_names
from fmu_plants import Equations, PlantModel, Variable, build_fmu

from .test_roles import signals


def joined(**parts: tuple[str, str]) -> Joined:
    """Join parts of such inputs and outputs."""
    paths = [Path(f"{name}.fmu") for name in parts]
    described = [
        describe(signals(inputs) if inputs else [], signals(outputs) if outputs else [])
        for inputs, outputs in parts.values()
    ]
    return join(paths, described, "all")


def connections(of: Joined) -> dict[str, str]:
    return {connection.target: connection.source for connection in of.section.connections}


def doubted(of: Joined) -> list[str]:
    pairs = zip(of.section.connections, of.reasons, strict=True)
    return [connection.target for connection, reason in pairs if reason.startswith("doubtful")]


@pytest.mark.parametrize(
    ("parts", "fed", "doubtful"),
    [
        # the same name, in units that can be converted
        ({"a": ("u [V]", "w [rad/s]"), "b": ("w [rpm]", "p [W]")}, {"b.w": "a.w"}, []),
        # the same name but for its direction; of two tanks the second does not fill the first
        (
            {"t1": ("q_in [m3/s]", "q_out [m3/s]"), "t2": ("q_in [m3/s]", "q_out [m3/s]")},
            {"t2.q_in": "t1.q_out"},
            [],
        ),
        # arrays by their elements
        ({"a": ("r", "e[1], e[2]"), "b": ("e[1], e[2]", "f")}, {"b.e[1]": "a.e[1]", "b.e[2]": "a.e[2]"}, []),
        # words in common, and the only ones in a unit, are doubted
        (
            {"a": ("u [V]", "motor_torque [N.m]"), "b": ("tau [N.m]", "x [m]")},
            {"b.tau": "a.motor_torque"},
            ["b.tau"],
        ),
        ({"a": ("u [V]", "x1 [W]"), "b": ("x2 [W]", "T [K]")}, {"b.x2": "a.x1"}, ["b.x2"]),
        # a controller and its plant: the setpoint stays free
        (
            {"ctl": ("setpoint, measurement", "command"), "tank": ("valve", "level")},
            {"ctl.measurement": "tank.level", "tank.valve": "ctl.command"},
            ["ctl.measurement", "tank.valve"],
        ),
        # blocks as Modelica has them
        ({"pi": ("u_s, u_m", "y"), "g": ("u", "y")}, {"pi.u_m": "g.y", "g.u": "pi.y"}, ["pi.u_m", "g.u"]),
        # several that fit as well: the first, doubted
        ({"a": ("u", "T_1 [K], T_2 [K]"), "b": ("T [K]", "x")}, {"b.T": "a.T_1"}, ["b.T"]),
        # the weather is fed by its name, never by its unit
        ({"a": ("u", "T [K]"), "b": ("TAmb [K], x", "x")}, {}, []),
        ({"a": ("u", "TAmb [K]"), "b": ("T_amb [K], x", "z")}, {"b.T_amb": "a.TAmb"}, []),
    ],
)
def test_inputs_follow_what_fits_best(
    parts: Mapping[str, tuple[str, str]], fed: dict[str, str], doubtful: Sequence[str]
) -> None:
    if not fed:
        with pytest.raises(ConfigError, match="nothing to connect"):
            joined(**parts)
        return
    plant = joined(**parts)
    assert connections(plant) == fed
    assert sorted(doubted(plant)) == sorted(doubtful)


def test_nothing_that_fits_is_told_with_what_there_is_and_a_remedy() -> None:
    with pytest.raises(ConfigError) as refused:
        joined(a=("u [V]", "w [rad/s]"), b=("q [m3/s]", "h [m]"))
    text = str(refused.value)
    assert "a.fmu, b.fmu: no output of one fits an input of another" in text
    assert "outputs: a.w [rad/s], b.h [m]; inputs: a.u [V], b.q [m3/s]" in text
    assert "plant.connections" in text


def test_something_is_left_to_drive() -> None:
    plant = joined(a=("x", "y"), b=("y", "x"))
    assert len(plant.section.connections) == 1
    assert plant.remarks[0].startswith("Every input could be fed, which leaves nothing to drive. Left out")


def test_parts_of_the_same_file_are_told_apart() -> None:
    assert part_names([Path("a.b.fmu"), Path("a.b.fmu"), Path("2.fmu")]) == ["a_b", "a_b_2", "_2"]


TANK, HEAT = Variable("temperature", "K", start=293.15), Variable("heat", "W", start=1000.0)
VALVE = Variable("valve", "1", min=0.0, max=1.0, start=0.25)
BOILER = PlantModel(
    name="boiler",
    equations=lambda v: Equations({"heat": (4000 * v.valve - v.heat) / 60}),
    states=(HEAT,),
    inputs=(VALVE,),
    outputs=(HEAT,),
    stop_time=600.0,
)
HOUSE = PlantModel(
    name="house",
    equations=lambda v: Equations(
        {"temperature": (293.15 - v.temperature) / 600 + (1000 * v.heat_in - 1000) / 6e4}
    ),
    states=(TANK,),
    inputs=(Variable("heat_in", "kW", start=1.0),),
    outputs=(TANK,),
    stop_time=6000.0,
)


def test_the_command_takes_several_files_and_says_what_it_connects(
    own_cache_folder: None, tmp_path: Path
) -> None:
    fmus = [str(build_fmu(HOUSE)), str(build_fmu(BOILER))]
    out, archive = tmp_path / "study.toml", tmp_path / "system.ssp"
    archive.write_bytes(b"")
    done = CliRunner().invoke(main, ["init", *fmus, "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "Connected by name and unit: boiler.heat -> house.heat_in." in done.stdout
    assert "Not fed by another part: boiler.valve." in done.stdout
    refused = CliRunner().invoke(main, ["init", fmus[0], str(archive), "--out", str(out), "--force"])
    assert refused.exit_code == 2
    assert "system.ssp: an SSP is a system by itself" in refused.stderr


def test_a_boiler_and_a_house_become_a_study_that_was_tried(own_cache_folder: None, tmp_path: Path) -> None:
    """4000 W per unit of the valve and 1 / 100 K per W: 40 K per unit; W become kW on the way."""
    fmus = [build_fmu(HOUSE), build_fmu(BOILER)]
    proposal = suggest_study(fmus)
    path = write_study(proposal, fmus, tmp_path / "study.toml")
    study = tomllib.loads(path.read_text(encoding="utf-8"))
    assert study["title"] == "Control of house and boiler"
    assert study["plant"]["connections"] == [{"from": "boiler.heat", "to": "house.heat_in"}]
    assert study["plant"]["inputs"] == ["boiler.valve"]
    assert study["plant"]["outputs"] == ["house.temperature"]
    assert proposal.gains == pytest.approx(40.0, rel=0.05)
    assert proposal.comments["head"][0].startswith("Tried once; best:")
    assert set(read_study(str(path)).problem.study.controllers) >= {"mpc"}
