"""FMUs under strangers' names: what is driven, what acts from outside, what has to be switched on."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from ddpc_cosim.suggestion import suggest_study, write_study
from fmu_plants import Equations, PlantModel, Variable, build_fmu


def model(name: str, states: str, inputs: tuple[Variable, ...], rates: Any, **more: Any) -> PlantModel:
    """Return a model whose states, ``name [unit] = start``, are its outputs."""
    variables = []
    for text in states.split(", "):
        head, _, start = text.partition(" = ")
        called, _, unit = head.partition(" [")
        variables.append(Variable(called, unit.rstrip("]"), start=float(start or 0.0)))
    return PlantModel(
        name=name,
        equations=lambda v: Equations(rates(v)),
        states=tuple(variables),
        inputs=inputs,
        outputs=tuple(variables),
        **{"stop_time": 3600.0, **more},
    )


OUTDOOR = Variable("TDryBul", "K", start=278.15)
SUN = Variable("HGloHor", "W/m2")
POWER = Variable("PHea", "W", min=0.0, max=5000.0, start=1000.0)

COTTAGE = model(
    "Cottage",
    "TRooAir [K] = 293.15",
    (OUTDOOR, POWER, SUN),
    lambda v: {"TRooAir": (v.TDryBul - v.TRooAir) / 600 + v.PHea / 4e4 + v.HGloHor / 1e5},
)
MOTOR = model(
    "servo",
    "omega [rad/s]",
    (Variable("u_a", "V", min=-24.0, max=24.0), Variable("tau_load", "N.m")),
    lambda v: {"omega": (2 * v.u_a - v.omega - v.tau_load) / 0.5},
    stop_time=5.0,
)
FERMENTER = model(
    "fermenter",
    "biomass [kg/m3] = 1",
    (Variable("feedRate", "kg/s", min=0.0, max=2.0, start=1.0),),
    lambda v: {"biomass": (v.feedRate - v.biomass) / 100},
)
# The feed alone decides the biomass, the coolant the temperature.
COOLED = model(
    "cooled",
    "biomass [kg/m3] = 1, T [K] = 300",
    (
        Variable("coolant_flow", "kg/s", min=0.0, max=2.0, start=1.0),
        Variable("feed", "kg/s", min=0.0, max=2.0, start=1.0),
        Variable("T_amb", "K", start=290.0),
    ),
    lambda v: {
        "biomass": (v.feed - v.biomass) / 100,
        "T": (310 - 10 * v.coolant_flow + 0.1 * (v.T_amb - 290) - v.T) / 100,
    },
)
OVEN = model(
    "oven",
    "T [K] = 300",
    (
        Variable("heaterTemperature", "K", min=300.0, max=600.0, start=300.0),
        Variable("T_room", "K", start=300.0),
    ),
    lambda v: {"T": (v.heaterTemperature - v.T) / 100 + (v.T_room - v.T) / 500},
)
COLD = model(
    "cold", "T [K] = 280", (Variable("ambient", "K", start=280.0),), lambda v: {"T": (v.ambient - v.T) / 50}
)


def study_of(plant: PlantModel, folder: Path, **wanted: Any) -> tuple[dict[str, Any], str]:
    """Return the study as plain TOML, and its text in one line."""
    fmu = build_fmu(plant)
    path = write_study(
        suggest_study(fmu, **{"trial": False, "budget": 600.0, **wanted}), fmu, folder / "study.toml"
    )
    text = path.read_text(encoding="utf-8")
    return tomllib.loads(text), text.replace("\n# ", " ")


@pytest.mark.parametrize(
    ("plant", "driven", "disturbances"),
    [
        (COTTAGE, ["PHea"], {"TDryBul", "HGloHor"}),
        (MOTOR, ["u_a"], {"tau_load"}),
        (FERMENTER, ["feedRate"], set()),
        (COOLED, ["coolant_flow", "feed"], {"T_amb"}),
        (OVEN, ["heaterTemperature"], {"T_room"}),
        (COLD, ["ambient"], set()),
    ],
    ids=lambda value: value.name if isinstance(value, PlantModel) else "",
)
def test_what_is_driven_and_what_acts(
    plant: PlantModel, driven: list[str], disturbances: set[str], own_cache_folder: None, tmp_path: Path
) -> None:
    study, _ = study_of(plant, tmp_path)
    assert study["plant"]["inputs"] == driven
    assert set(study.get("disturbances", {})) == disturbances


def test_the_weather_is_in_the_study_with_its_reasons_and_every_controller_runs(
    own_cache_folder: None, tmp_path: Path
) -> None:
    study, text = study_of(COTTAGE, tmp_path, trial=True)
    assert study["disturbances"]["TDryBul"]["signal"] == {"kind": "constant", "value": 278.15}
    assert study["recording"]["disturbances"]["HGloHor"]["high"] > 100.0  # the sun, not 0.3 W/m2
    assert 'TDryBul looks like a disturbance: its name says "drybul" and its unit is K.' in text
    assert study["title"] == "Control of Cottage"
    assert text.startswith("# Tried once; best:")


def test_what_is_asked_for_is_driven(own_cache_folder: None, tmp_path: Path) -> None:
    study, _ = study_of(COTTAGE, tmp_path, inputs=["TDryBul"])
    assert study["plant"]["inputs"] == ["TDryBul"]
    assert set(study["disturbances"]) == {"HGloHor"}
    study, _ = study_of(COTTAGE, tmp_path / "range", ranges={"TDryBul": (270.0, 290.0)})
    assert study["plant"]["inputs"] == ["TDryBul", "PHea"]


def test_what_moves_no_output_rests(own_cache_folder: None, tmp_path: Path) -> None:
    deaf = model(
        "deaf", "x", (Variable("u", "V"), Variable("wind", "m/s")), lambda v: {"x": v.u - v.x + 0 * v.wind}
    )
    study, text = study_of(deaf, tmp_path)
    assert "disturbances" not in study
    assert 'wind looks like a disturbance (its name says "wind"), and moves no output here: it rests' in text


def switched(switch: str) -> PlantModel:
    """Return a lag that answers to its input while a switch is 1, which starts at 0."""
    return model(
        "switched",
        "x",
        (Variable("u", "V", min=-1.0, max=1.0), Variable(switch, min=0.0, max=1.0)),
        lambda v: {"x": v.u * v[switch] - v.x},
        stop_time=10.0,
    )


def test_what_has_to_be_switched_on_is_tried_at_1(own_cache_folder: None, tmp_path: Path) -> None:
    study, text = study_of(switched("enable"), tmp_path)
    assert study["plant"]["inputs"] == ["u"]
    assert study["plant"]["start"] == {"enable": 1.0}
    assert "enable = 1: switched on, as more of the inputs do something then; --at enable=0 if not" in text


def test_what_works_without_is_left_off(own_cache_folder: None, tmp_path: Path) -> None:
    boosted = model(
        "boosted",
        "x",
        (Variable("u", "V", min=-1.0, max=1.0), Variable("boost_on", min=0.0, max=1.0)),
        lambda v: {"x": v.u * (1 + v.boost_on) - v.x},
        stop_time=10.0,
    )
    study, _ = study_of(boosted, tmp_path)
    assert (study["plant"]["inputs"], study["plant"].get("start")) == (["u"], None)


def pi_controller(wanted: str, measured: str, command: str) -> PlantModel:
    """Return i' = 0.1 e, u = 2 e + i with e the difference of two inputs."""
    return PlantModel(
        name="pi",
        equations=lambda v: Equations(
            {"i": 0.1 * (v[wanted] - v[measured])}, {command: 2 * (v[wanted] - v[measured]) + v.i}
        ),
        states=(Variable("i"),),
        inputs=(Variable(wanted, "K", start=293.15), Variable(measured, "K", start=293.15)),
        outputs=(Variable(command),),
        stop_time=100.0,
    )


def limited_controller() -> PlantModel:
    """Return the same from -1 to 1, with an error of 5 at the start."""
    from sympy import Max, Min

    return PlantModel(
        name="limited",
        equations=lambda v: Equations({"i": 0.1 * (v.r - v.y)}, {"u": Max(-1, Min(1, v.r - v.y + v.i))}),
        states=(Variable("i"),),
        inputs=(Variable("r", start=5.0), Variable("y")),
        outputs=(Variable("u"),),
        stop_time=100.0,
    )


@pytest.mark.parametrize(
    ("plant", "words"),
    [
        (pi_controller("T_set", "T_meas", "u"), "This looks like a controller (T_set, T_meas -> u)"),
        # At its limit nothing is opposite any more.
        (limited_controller(), "This looks like a controller (r, y -> u)"),
        (
            model(
                "gain",
                "y",
                (Variable("error", "K"),),
                lambda v: {"y": v.error},
            ),
            "This looks like a controller (error -> y)",
        ),
        (
            model(
                "TankController", "valve", (Variable("level", "m"),), lambda v: {"valve": v.level - v.valve}
            ),
            "This looks like a controller (TankController)",
        ),
    ],
    ids=["pi", "at its limit", "of a difference", "by its name"],
)
def test_a_controller_is_called_one(
    plant: PlantModel, words: str, own_cache_folder: None, tmp_path: Path
) -> None:
    _, text = study_of(plant, tmp_path)
    assert words in text
    assert "ddpc-cosim init plant.fmu controller.fmu" in text


@pytest.mark.parametrize(
    "plant",
    [
        # A tank is emptied by as much as it is filled.
        model(
            "tank",
            "level [m] = 1",
            (Variable("q_a", "m3/s", start=1.0), Variable("q_b", "m3/s", start=1.0)),
            lambda v: {"level": v.q_a - v.q_b - 0.01 * (v.level - 1)},
        ),
        # A bond graph's effort is not an error, nor its limit a command.
        model(
            "bond",
            "Act_Limits [m] = 1",
            (Variable("p_e"), Variable("q")),
            lambda v: {"Act_Limits": v.p_e + v.q - v.Act_Limits},
        ),
        # A room with a control of its own answers to its setpoint.
        model(
            "room",
            "T [K] = 293.15",
            (Variable("T_set", "K", start=293.15), Variable("T_out", "K", start=293.15)),
            lambda v: {"T": (v.T_set - v.T) / 60 + (v.T_out - v.T) / 600},
        ),
    ],
    ids=lambda plant: plant.name,
)
def test_a_plant_is_not_called_a_controller(
    plant: PlantModel, own_cache_folder: None, tmp_path: Path
) -> None:
    assert "looks like a controller" not in study_of(plant, tmp_path)[1]


def overridden(told: bool) -> PlantModel:
    """Return a room at 5 degC outside whose own control holds 21 degC: (21 - T) 10 kW, at 16 K / 600 s."""
    room = Variable("reaTRoo_y", "K", start=294.15, description="Room air temperature")
    acts = Variable("oveHea_y", "W")

    def equations(v: Any) -> Equations:
        embedded = 4000 + 1000 * (294.15 - v.reaTRoo_y)
        heat = v.oveHea_activate * v.oveHea_u + (1 - v.oveHea_activate) * embedded
        rates = {"reaTRoo_y": (278.15 - v.reaTRoo_y) / 600 + heat / 1.5e5}
        return Equations(rates, {"oveHea_y": heat} if told else {})

    return PlantModel(
        name="told" if told else "untold",
        equations=equations,
        states=(room,),
        inputs=(
            Variable("oveHea_u", "W", min=0.0, max=10000.0),
            Variable("oveHea_activate", "1", min=0.0, max=1.0, description="Activation for Hea"),
        ),
        outputs=(room, acts) if told else (room,),
        stop_time=6000.0,
    )


@pytest.mark.parametrize("told", [True, False])
def test_an_override_rests_where_the_plants_own_control_holds_it(
    told: bool, own_cache_folder: None, tmp_path: Path
) -> None:
    """16 K / 600 s = P / 1.5e5: 4000 W hold 294.15 K."""
    study, text = study_of(overridden(told), tmp_path)
    assert study["plant"]["inputs"] == ["oveHea_u"]
    assert study["plant"]["start"]["oveHea_u"] == pytest.approx(4000.0, rel=0.02)
    assert study["reference"]["reaTRoo_y"]["values"][0] > 294.0
    assert "oveHea_u starts at 0 and rests at" in text


@pytest.mark.parametrize(
    ("setpoint", "power", "share"), [("oveSet_y", "oveAct_y", 1.0), ("reaTSet_y", "reaHea_y", 0.99)]
)
def test_what_tells_an_override_is_not_controlled(
    own_cache_folder: None, tmp_path: Path, setpoint: str, power: str, share: float
) -> None:
    """Of setpoint and power of a room's own control the room is controlled, by what moves it alone."""
    room = Variable("TZone_y", "K", start=294.15)

    def equations(v: Any) -> Equations:
        wanted = v.oveSet_activate * v.oveSet_u + (1 - v.oveSet_activate) * 294.15
        embedded = 4000 + 1000 * (wanted - v.TZone_y)
        heat = v.oveAct_activate * v.oveAct_u + (1 - v.oveAct_activate) * embedded
        rates = {"TZone_y": (278.15 - v.TZone_y) / 600 + heat / 1.5e5}
        return Equations(rates, {setpoint: wanted, power: heat / share})

    described = "Activation for its override"
    plant = PlantModel(
        name="cascaded",
        equations=equations,
        states=(room,),
        inputs=(
            Variable("oveAct_u", "W", min=0.0, max=10000.0),
            Variable("oveAct_activate", "1", min=0.0, max=1.0, description=described),
            Variable("oveSet_u", "K", min=278.15, max=308.15, start=294.15),
            Variable("oveSet_activate", "1", min=0.0, max=1.0, description=described),
        ),
        outputs=(Variable(power, "W"), Variable(setpoint, "K"), room),
        stop_time=6000.0,
    )
    study, _ = study_of(plant, tmp_path)
    assert study["plant"]["outputs"] == ["TZone_y"]
    assert study["plant"]["inputs"] == ["oveAct_u"]


def test_an_unnamed_switch_is_a_switch_where_the_others_need_it(
    own_cache_folder: None, tmp_path: Path
) -> None:
    study, text = study_of(switched("s7"), tmp_path)
    assert study["plant"]["inputs"] == ["u"]
    assert study["plant"]["start"] == {"s7": 1.0}
    assert "s7 = 1: switched on" in text


def test_where_a_product_vanishes_the_weather_stays(own_cache_folder: None, tmp_path: Path) -> None:
    """Half of the flow, and the supply as its maker has it."""
    coil = model(
        "coil",
        "T [K] = 293.15",
        (
            Variable("opening", "1", min=0.0, max=1.0),
            Variable("flow", "kg/s", min=0.0, max=1.0),
            Variable("T_ambient", "K", start=320.0),
        ),
        lambda v: {"T": v.opening * v.flow * (v.T_ambient - v.T) / 100},
    )
    study, _ = study_of(coil, tmp_path)
    assert study["plant"]["start"] == {"opening": 0.5, "flow": 0.5}


def test_the_weather_that_a_plant_has_inside_is_measured(own_cache_folder: None, tmp_path: Path) -> None:
    """A room whose FMU tells the outdoor temperature, a day's sine, and the power that is used."""
    from sympy import sin

    room = Variable("TRoo", "K", start=288.15)

    def equations(v: Any) -> Equations:
        outdoor = 278.15 + 5 * sin(2 * 3.141592653589793 / 86400 * v.time)
        rate = (outdoor - v.TRoo) / 7200 + v.PHea / 7.2e5
        return Equations({"TRoo": rate}, {"weaTDryBul": outdoor, "PEle": v.PHea / 3})

    house = PlantModel(
        name="Bungalow",
        equations=equations,
        states=(room,),
        inputs=(Variable("PHea", "W", min=0.0, max=3000.0, start=1000.0),),
        outputs=(Variable("PEle", "W"), Variable("weaTDryBul", "K"), room),
        stop_time=7 * 86400.0,
    )
    study, text = study_of(house, tmp_path, trial=True)
    assert study["plant"]["outputs"] == ["TRoo"]
    assert study["disturbances"] == {"weaTDryBul": {"known": "unknown"}}
    assert "weaTDryBul: the weather, which the plant has inside" in text
    assert len(study["controllers"]) == 4
