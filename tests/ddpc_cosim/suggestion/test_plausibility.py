"""No setpoint that physics forbids, or that a plant did not reach; inputs that cannot start at 0 do not."""

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy

from ddpc_cosim import CosimError
from ddpc_cosim.suggestion import suggest_study, write_study
from ddpc_cosim.suggestion.quantities import as_weather_goes, is_difference, plausible, usual_levels
from ddpc_cosim.suggestion.writing import Proposal, study_text
from fmu_plants import Equations, PlantModel, Variable, build_fmu


def plant(
    name: str, state: Variable, inputs: tuple[Variable, ...], rate: Any, stop: float = 3600.0, **more: Any
) -> PlantModel:
    return PlantModel(
        name=name,
        equations=lambda v: Equations({state.name: rate(v)}),
        states=(state,),
        inputs=inputs,
        outputs=(state,),
        stop_time=stop,
        **more,
    )


def setpoints(proposal: Proposal) -> tuple[float, float]:
    (steps,) = proposal.setpoints.values()
    return min(steps.values), max(steps.values)


def remarks(proposal: Proposal, section: str = "reference") -> str:
    return " ".join(proposal.comments[section])


HEAT = Variable("q", "W", min=-5000.0, max=5000.0)


def conditioned(name: str, start: float, unit: str = "K", description: str = "") -> PlantModel:
    """50 K for 5 kW, in an hour."""
    state = Variable(name, unit, start=start, description=description)
    return plant("thing", state, (HEAT,), lambda v: (start + 0.03 * v.q - v[name]) / 3600)


@pytest.mark.parametrize(
    ("model", "low", "high"),
    [
        (conditioned("tAirZone", 293.15), 283.15, 308.15),
        (conditioned("y", 20.0, "degC", "Temperature of the office"), 10.0, 35.0),
        (conditioned("y", 262.0), 250.0, 400.0),
        (conditioned("y", 390.0), 250.0, 400.0),
    ],
    ids=["zone", "office in degC", "cold store", "steam"],
)
def test_temperatures_stay_plausible(
    model: PlantModel, low: float, high: float, own_cache_folder: None
) -> None:
    """With a third of 5 kW either way the temperature goes 27 K up and down."""
    proposal = suggest_study(build_fmu(model), trial=False)
    least, most = setpoints(proposal)
    assert low < least < most < high
    assert "are plausible of" in remarks(proposal)


@pytest.mark.parametrize("start", [900.0, 200.0])
def test_what_rests_elsewhere_goes_where_it_can(start: float, own_cache_folder: None) -> None:
    """0.6 of 30 % of 5 kW and 5 kW: that is 54 K."""
    proposal = suggest_study(build_fmu(conditioned("tAirZone", start)), trial=False)
    assert setpoints(proposal) == (pytest.approx(start - 54.0, abs=1.0), pytest.approx(start + 54.0, abs=1.0))
    assert "plausible" not in remarks(proposal)


PULL = Variable("harvest", "1/d", min=-1.0, max=1.0)


@pytest.mark.parametrize(
    ("state", "least"),
    [
        (Variable("fish", start=0.2, description="Population of the pond"), 0.0),
        (Variable("substrate", "kg/m3", start=0.2), 0.0),
        (Variable("waterLevel", "m", start=0.2), 0.0),
        (Variable("waterLevel", "m", start=0.2, min=-5.0), -1.0),  # it may be below where it is counted from
        (Variable("carriage", "m", start=0.2, description="Position of the mass"), -1.0),
        (Variable("fish", start=-0.2), -1.0),
    ],
    ids=["population", "concentration", "level", "level with a minimum", "position", "negative"],
)
def test_amounts_are_not_negative(state: Variable, least: float, own_cache_folder: None) -> None:
    """It rests at its start value, and half of an input of 1 takes it 0.5 away."""
    model = plant("pond", state, (PULL,), lambda v: (state.start - 2 * v.harvest - v[state.name]) / 60)
    low, _ = setpoints(suggest_study(build_fmu(model), trial=False))
    assert (low >= 0.0) == (least == 0.0)


@pytest.mark.parametrize(
    ("rate", "highest", "saturates"),
    [
        (lambda v: sympy.tanh(10 * v.valve) - v.flow, 1.0, True),  # a tenth of the room moves it by 0.76
        (lambda v: 2 * v.valve - v.flow, 2.0, False),
    ],
    ids=["saturates", "linear"],
)
def test_setpoints_are_what_held_inputs_reach(
    rate: Any, highest: float, saturates: bool, own_cache_folder: None
) -> None:
    flow = Variable("flow", "m/s")
    valve = Variable("valve", "1", min=-1.0, max=1.0)
    proposal = suggest_study(build_fmu(plant("nozzle", flow, (valve,), rate)))
    low, high = setpoints(proposal)
    assert -highest <= low < 0.0 < high <= highest
    assert ("held inputs take it less far" in remarks(proposal)) == saturates
    if not saturates:
        assert high == pytest.approx(2 * 0.6 * 0.6, rel=0.02)  # all that a linear gain promises


def test_temperatures_and_pressures_are_lifted_in_their_own_units() -> None:
    inputs = [
        Variable("a", "K"),
        Variable("b", "degC", start=-273.15),
        Variable("c", "bar"),
        Variable("d", "kPa"),
        Variable("e", "degK"),
        Variable("f", "K", nominal=350.0),
        Variable("g", "K", max=280.0),
        Variable("oveTSetRooHea_u", "K", description="Heating setpoint"),
        Variable("oveTSetRooCoo_u", "degC", start=-273.15, description="Cooling setpoint"),
        Variable("oveTSupCoo_u", "K", description="Cooling water supply temperature setpoint"),
    ]
    assert usual_levels(inputs, (), {}) == {
        "a": 293.15,
        "b": 20.0,
        "c": 1.01325,
        "d": 101.325,
        "e": 293.15,
        "f": 350.0,
        "g": 280.0,
        "oveTSetRooHea_u": 293.15,
        "oveTSetRooCoo_u": 24.0,
        "oveTSupCoo_u": 293.15,
    }


@pytest.mark.parametrize(
    "variable",
    [
        Variable("x", "degC"),  # it freezes
        Variable("x", "K", start=280.0),
        Variable("x", "K", description="Temperature difference over the coil"),
        Variable("pGauge", "bar"),
        Variable("x", "Pa", min=-1e3),
        Variable("x", "W"),
        Variable("x"),
    ],
    ids=lambda v: f"{v.name} {v.unit} {v.description}",
)
def test_other_zeros_are_left_alone(variable: Variable) -> None:
    assert usual_levels([variable], (), {}) == {}


def test_a_negative_minimum_makes_a_difference_in_kelvin_only() -> None:
    assert is_difference(Variable("x", "K", min=-20.0))
    assert not is_difference(Variable("x", "degC", min=-20.0))
    assert plausible(Variable("room", "degC", min=-20.0), 20.0).low == pytest.approx(10.0)


def test_many_that_are_lifted_are_told_together(own_cache_folder: None, tmp_path: Path) -> None:
    around = tuple(Variable(f"t{i}", "K") for i in range(6))
    hall = Variable("y", "K", start=293.15)
    model = plant("hall", hall, around, lambda v: (sum(v[t.name] for t in around) / 6 - v.y) / 600)
    fmu = build_fmu(model)
    text = write_study(suggest_study(fmu, trial=False), fmu, tmp_path / "s.toml").read_text(encoding="utf-8")
    assert "t0, t1, t2, t3 and 2 more start at 0 K" in text.replace("\n# ", " ")
    assert tomllib.loads(text)["plant"]["start"] == {t.name: 293.15 for t in around}


def test_nothing_that_is_not_a_number_is_written(own_cache_folder: None, tmp_path: Path) -> None:
    proposal = suggest_study(build_fmu(conditioned("y", 300.0)), trial=False)
    sections = proposal.study.controllers
    spoilt = replace(
        sections["mfapc"], settings={**sections["mfapc"].settings, "initial_gradient": [[float(np.nan)]]}
    )
    with pytest.raises(
        CosimError, match=r"controllers.mfapc.*initial_gradient\[0\]\[0\] could not be identi"
    ):
        study_text(proposal.changed(controllers={**sections, "mfapc": spoilt}), "thing.fmu")


TAIR = Variable("tair", "degC", start=5.0, description="Room air temperature")
HEATER = Variable("heat", "W", min=0.0, max=5000.0)


@pytest.mark.parametrize(
    ("state", "start"),
    [(TAIR, True), (replace(TAIR, description="Brine", name="tbrine"), False)],
    ids=["room", "brine"],
)
def test_a_room_is_tried_where_it_is_as_rooms_are(
    state: Variable, start: bool, own_cache_folder: None
) -> None:
    """100 W/K against 0 degC: 21 degC are 2.1 kW, and 0.3 * 0.6 of 5 kW are 9 K."""
    model = plant("dwelling", state, (HEATER,), lambda v: (100 * (0 - v[state.name]) + v.heat) / 1e6)
    proposal = suggest_study(build_fmu(model), trial=False)
    assert ("heat" in proposal.study.plant.start) == start
    if start:
        assert proposal.study.plant.start["heat"] == pytest.approx(2100.0, rel=0.05)
        low, high = setpoints(proposal)
        assert 10.0 < low < 21.0 < high < 35.0
        assert "At rest it is not as a room should be" in remarks(proposal, "head")


def test_only_what_rests_at_0_is_moved_where_products_vanish(own_cache_folder: None) -> None:
    supply = Variable("tsup", "degC", start=45.0, min=0.0, max=90.0)
    valves = tuple(Variable(name, "1", min=0.0, max=1.0) for name in ("valve", "fan"))
    flow = Variable("y", "m3/s")
    duct = plant("duct", flow, (*valves, supply), lambda v: (v.valve * v.fan * v.tsup / 45 - v.y) / 5)
    proposal = suggest_study(build_fmu(duct), trial=False)
    assert proposal.study.plant.start == {"valve": 0.5, "fan": 0.5}


@pytest.mark.parametrize(
    ("unit", "level", "guessed", "expected"),
    [
        ("K", 273.15, (213.0, 333.0), (253.15, 293.15)),
        ("degC", 0.0, (-100.0, 100.0), (-20.0, 20.0)),
        ("degF", 50.0, (-100.0, 200.0), (14.0, 86.0)),
        ("K", 300.0, (295.0, 305.0), (295.0, 305.0)),
        ("W/m2", 0.0, (0.0, 450.0), (0.0, 450.0)),
        ("", 300.0, (0.0, 600.0), (0.0, 600.0)),
    ],
)
def test_what_is_outdoors_moves_no_further_than_weather_does(
    unit: str, level: float, guessed: tuple[float, float], expected: tuple[float, float]
) -> None:
    assert as_weather_goes(Variable("outdoor", unit), level, *guessed) == pytest.approx(expected)
