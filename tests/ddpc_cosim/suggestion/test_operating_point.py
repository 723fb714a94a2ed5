"""A plant is tried where it can run: not at 0 K, nor where products vanish."""

import math
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmus.builder import CO_SIMULATION, V, describe, model_library, write_fmu

from ddpc_cosim import CosimError
from ddpc_cosim.suggestion import suggest_study, write_study
from ddpc_cosim.suggestion.design import input_bounds
from ddpc_cosim.suggestion.embedded import Embedded
from ddpc_cosim.variables import Variable as InputVariable
from fmu_plants import Equations, PlantModel, Variable, build_fmu

ROOM = Variable("room", "K", start=293.15)
HEAT, AMBIENT = Variable("heat", "kW", min=0.0, max=2.0, start=1.0), Variable("ambient", "K")
VALVE, FAN = Variable("valve", "1", min=0.0, max=1.0), Variable("fan", "1", min=0.0, max=1.0)
FLOW = Variable("flow", "m3/s")
U = V("u", 0, causality="input", start="0", more={"min": "-1", "max": "1"})
X = V("x", 1, causality="output", initial="exact", start="0")


def model(name: str, state: Variable, inputs: tuple[Variable, ...], rate: Any) -> PlantModel:
    return PlantModel(
        name=name,
        equations=lambda v: Equations({state.name: rate(v)}),
        states=(state,),
        inputs=inputs,
        outputs=(state,),
        stop_time=3600.0,
    )


def study_of(fmu: Path, folder: Path, **wanted: Any) -> tuple[dict[str, Any], str]:
    """Return the study as plain TOML, and its text."""
    path = write_study(suggest_study(fmu, trial=False, **wanted), fmu, folder / "study.toml")
    text = path.read_text(encoding="utf-8")
    return tomllib.loads(text), text.replace("\n# ", " ")


def test_an_ambient_that_would_start_at_0_kelvin_is_asked_about(
    own_cache_folder: None, tmp_path: Path
) -> None:
    house = model("house", ROOM, (HEAT, AMBIENT), lambda v: (v.ambient + 10 * v.heat - v.room) / 600)
    study, text = study_of(build_fmu(house), tmp_path)
    assert study["plant"]["start"] == {"ambient": 293.15}
    assert study["disturbances"]["ambient"]["signal"] == {"kind": "constant", "value": 293.15}
    assert "ambient starts at 0 K, which can hardly be meant: tried at 293.15 K" in text
    assert "--at ambient=293.15" in text
    given, text = study_of(build_fmu(house), tmp_path / "given", at={"ambient": 280.0})
    assert given["plant"]["start"] == {"ambient": 280.0}
    assert "hardly be meant" not in text


@pytest.mark.parametrize(
    ("parameters", "expected", "origin"),
    [
        ({"uMin": -2.0, "uMax": 5.0}, (-2.0, 5.0), "parameter uMin = -2, uMax = 5?"),
        ({"u_max": 5.0}, (-5.0, 5.0), "parameter u_max = 5?"),
        ({"max_u": 5.0, "umin": 0.0}, (0.0, 5.0), "parameter umin = 0, max_u = 5?"),
        ({"limiter.uMax": 5.0, "yMax": 3.0, "uMaximal": 2.0}, (-1.0, 1.0), "guessed: "),
        ({"uMin": 2.0, "uMax": 5.0}, (-1.0, 1.0), "guessed: "),  # the start value is outside
    ],
)
def test_a_parameter_named_after_an_input_may_limit_it_with_a_question_mark(
    parameters: dict[str, float], expected: tuple[float, float], origin: str
) -> None:
    named = [InputVariable(name, start=value) for name, value in parameters.items()]
    (bounds,) = input_bounds([InputVariable("u")], parameters=named).values()
    assert ((bounds.low, bounds.high), bounds.origin.startswith(origin)) == (expected, True)
    assert ("?" in bounds.origin) == (not origin.startswith("guessed"))
    asked = input_bounds([InputVariable("u")], {"u": (-3.0, 3.0)}, named)["u"]
    declared = input_bounds([InputVariable("u", min=-4.0, max=4.0)], parameters=named)["u"]
    assert [(b.low, b.high) for b in (asked, declared)] == [(-3.0, 3.0), (-4.0, 4.0)]


def test_such_a_limit_is_in_the_file_with_its_question_mark(own_cache_folder: None, tmp_path: Path) -> None:
    limit = V("uMax", 6, causality="parameter", variability="fixed", start="5")
    variables = [V("u", 0, causality="input", start="0"), X, limit]
    text = describe("2.0", "lag", variables, interfaces=CO_SIMULATION)
    study, text = study_of(write_fmu(tmp_path / "limited.fmu", text, model_library("2.0")), tmp_path)
    assert study["bounds"]["u"] == {"min": -5.0, "max": 5.0}
    assert "# parameter uMax = 5? the FMU declares no range" in text


@pytest.mark.parametrize(
    "variable",
    [Variable("dT", "K"), Variable("offset", "K", min=-5.0, max=5.0), Variable("pump_dp", "Pa")],
    ids=lambda variable: variable.name,
)
def test_differences_may_start_at_0(variable: Variable, own_cache_folder: None, tmp_path: Path) -> None:
    plant = model("difference", ROOM, (variable,), lambda v: getattr(v, variable.name) - v.room)
    study, _ = study_of(build_fmu(plant), tmp_path)
    assert "start" not in study["plant"]


def test_where_a_product_vanishes_the_plant_is_tried_elsewhere(
    own_cache_folder: None, tmp_path: Path
) -> None:
    """flow' = (valve fan - flow) / 5: at rest neither does anything without the other."""
    duct = model("duct", FLOW, (VALVE, FAN), lambda v: (v.valve * v.fan - v.flow) / 5)
    study, text = study_of(build_fmu(duct), tmp_path)
    assert study["plant"]["start"] == {"valve": 0.5, "fan": 0.5}
    assert study["plant"]["inputs"] == ["valve", "fan"]
    assert "Where the plant starts its inputs do next to nothing: tried at valve = 0.5, fan = 0.5" in text
    assert max(study["reference"]["flow"]["values"]) > 0.25  # where it rests: 0.5 * 0.5
    given, _ = study_of(build_fmu(duct), tmp_path / "given", at={"fan": 0.8})
    assert given["plant"]["start"] == {"fan": 0.8}


def test_a_mean_of_what_is_at_a_limit_is_at_that_limit() -> None:
    setpoint = InputVariable("oveMax_u", "K", min=288.15, max=303.15)
    level = float(np.mean([303.15] * 100))
    assert level > setpoint.max
    assert Embedded(levels={"oveMax_u": level}).within([setpoint]).levels == {"oveMax_u": 303.15}


def test_a_range_that_was_guessed_too_small_is_widened(own_cache_folder: None, tmp_path: Path) -> None:
    """flow' = max(signal - 40, 0) - flow, of an input that declares nothing: +-1 is the first guess."""
    from sympy import Max

    valve = model("threshold", FLOW, (Variable("signal"),), lambda v: Max(v.signal - 40, 0) - v.flow)
    study, text = study_of(build_fmu(valve), tmp_path)
    assert study["bounds"]["signal"]["max"] == pytest.approx(101.0)
    assert "the inputs do too little: tried signal -101:101; --range NAME=LO:HI if that is too far" in text


def house(name: str, description: str, gain: float = 1e-3) -> PlantModel:
    """room' = (20 degC + gain q - room) / 600, and a meter of q, which nothing limits."""
    room = Variable("TZone", "K", start=293.15, description="Zone air temperature")
    meter = Variable(name, "", description=description)
    return PlantModel(
        name="house",
        equations=lambda v: Equations({"TZone": (293.15 + gain * v.QHeat - v.TZone) / 600, name: v.QHeat}),
        states=(room, meter),
        inputs=(Variable("QHeat", description="Heating input to zone"),),
        outputs=(room, meter),
        stop_time=86400.0,
    )


def test_what_is_spent_is_no_setpoint_as_long_as_something_is_read(
    own_cache_folder: None, tmp_path: Path
) -> None:
    """One watt moves the meter and hardly the room: it is the guess of a watt that is wrong."""
    study, _ = study_of(build_fmu(house("EHeat", "Energy consumption of heater")), tmp_path)
    assert [*study["reference"]] == ["TZone"]
    assert study["bounds"]["QHeat"]["max"] >= 100.0
    assert max(study["reference"]["TZone"]["values"]) > 293.15 + 0.01


def test_what_is_stored_is_no_meter_and_a_meter_alone_is_controlled(
    own_cache_folder: None, tmp_path: Path
) -> None:
    stored = house("E", "Energy stored in the tank", gain=10.0)
    study, _ = study_of(build_fmu(stored), tmp_path, outputs=["E"])
    assert [*study["reference"]] == ["E"]
    alone = model(
        "bill", Variable("cost"), (Variable("use", min=0.0, max=2.0, start=1.0),), lambda v: v.use - 1
    )
    study, _ = study_of(build_fmu(alone), tmp_path / "alone")
    assert [*study["reference"]] == ["cost"]


def test_a_heater_of_one_watt_does_not_make_a_cold_room_comfortable(
    own_cache_folder: None, tmp_path: Path
) -> None:
    """room' = (0 degC + q / 50 - room) / 600 of a heater that declares nothing: +-1 W is the first guess."""
    cold = Variable("TRoom", "degC")
    heater = Variable("q", "W")
    study, text = study_of(
        build_fmu(model("hut", cold, (heater,), lambda v: (v.q / 50 - v.TRoom) / 600)), tmp_path
    )
    assert "not as a room should be" not in text
    assert study["bounds"]["q"]["max"] >= 10.0


@pytest.mark.parametrize(("declared", "highest"), [({}, 11.0), ({"min": -1.0, "max": 1.0}, 1.0)])
def test_a_guess_is_widened_where_the_plant_moves_further_by_itself(
    declared: dict[str, float], highest: float, own_cache_folder: None, tmp_path: Path
) -> None:
    """w' = u - 5: a brake takes it down while u rests at 0, and +-1 is the first guess."""
    brake = model("brake", Variable("w", "rad/s"), (Variable("u", "N.m", **declared),), lambda v: v.u - 5)
    study, text = study_of(build_fmu(brake), tmp_path)
    assert study["bounds"]["u"]["max"] == highest
    assert ("the inputs do too little: tried u -11:11" in text) == (highest > 1.0)


def test_a_guess_is_widened_where_days_move_a_room_further(own_cache_folder: None, tmp_path: Path) -> None:
    """room' = (outdoors + q / 100 - room) / 3 h: outdoors swings by 8 K a day, q declares nothing."""
    from sympy import sin

    room = Variable("TRoom", "K", start=293.15)
    day = 2 * math.pi / 86400.0
    hut = model(
        "shelter",
        room,
        (Variable("QHeat", "W"),),
        lambda v: (293.15 + 8 * sin(day * v.time) + v.QHeat / 100 - v.TRoom) / 10_800,
    )
    study, text = study_of(build_fmu(hut), tmp_path)
    assert study["bounds"]["QHeat"]["max"] >= 1000.0
    assert "the inputs do too little: tried QHeat" in text


def test_where_every_response_returns_no_setpoint_is_proposed(own_cache_folder: None, tmp_path: Path) -> None:
    """y = u - x with x' = u - x: whatever u is held at, y goes back to 0."""
    x, u = Variable("x"), Variable("u", min=-1.0, max=1.0)
    washout = PlantModel(
        name="washout",
        equations=lambda v: Equations({"x": v.u - v.x}, {"y": v.u - v.x}),
        states=(x,),
        inputs=(u,),
        outputs=(Variable("y"),),
        stop_time=20.0,
    )
    with pytest.raises(CosimError, match="held at other values, u took y nowhere else; --range or --at"):
        suggest_study(build_fmu(washout))


def test_a_result_that_depends_on_the_step_size_is_told(tmp_path: Path) -> None:
    """A lag of ten calls: twice as many steps in the same time, and it is twice as fast."""
    text = describe("2.0", "counter", (U, X), interfaces=CO_SIMULATION)
    fmu = write_fmu(tmp_path / "counter.fmu", text, model_library("2.0"))
    study, text = study_of(fmu, tmp_path, sampling_time=0.1)
    assert text.startswith(
        "# The FMU's result depends on the communication step size: with 0.1 s and with 0.05 s"
    )
    assert study["loop"]["sampling_time"] == 0.1
    settling = re.search(r"The plant takes about ([\d.]+) s to settle", text)
    assert settling is not None
    assert float(settling[1]) == pytest.approx(2.9, rel=0.1)  # 0.9^n = 5 % after 29 calls
    steady = describe("2.0", "lag", (U, X), interfaces=CO_SIMULATION)
    fmu = write_fmu(tmp_path / "lag.fmu", steady, model_library("2.0"))
    assert "depends on" not in study_of(fmu, tmp_path / "lag")[1]
