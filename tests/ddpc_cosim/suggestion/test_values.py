"""Ranges and operating points in any unit of their quantity, and operating points from files."""

from pathlib import Path
from typing import Any

import pytest
from fmus.builder import CO_SIMULATION, V, describe, model_library, write_fmu

from ddpc_cosim import ConfigError, DataError
from ddpc_cosim.description import Declarations, DescribedVariable
from ddpc_cosim.suggestion import suggest_study
from ddpc_cosim.suggestion.values import operating_point, operating_point_of, with_own_units
from ddpc_cosim.variables import Variable

SIGNALS = (
    Variable("room", "K", start=293.15),
    Variable("supply", "Pa"),
    Variable("speed", "rad/s"),
    Variable("plain"),
)


class Declared(Declarations):
    """Four inputs."""

    def __init__(self) -> None:
        self.variables = {v.name: DescribedVariable(v, causality="input") for v in SIGNALS}


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("room", "20:24 degC", (293.15, 297.15)),
        ("room", "-10.5:24degC", (262.65, 297.15)),
        ("room", "293:295", (293.0, 295.0)),
        ("room", "293:295 K", (293.0, 295.0)),
        ("supply", "1:2.5 bar", (1e5, 2.5e5)),
        ("speed", "60:120 1/min", (6.28318530718, 12.56637061436)),
        ("plain", "10:20 %", (0.1, 0.2)),
    ],
)
def test_a_range_in_a_unit_is_one_of_the_plant(name: str, text: str, expected: tuple[float, float]) -> None:
    _, ranges, faults = with_own_units(Declared(), {}, {name: text})
    assert not faults
    assert ranges[name] == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("room", "20:24 bar", r'range of room: unit "bar" does not fit room; allowed: K, °C, degC, degF'),
        ("room", "20:24 degX", r'range of room: unit "degX" does not fit room; allowed: K'),
        ("plain", "20:24 degC", r'unit "degC" does not fit plain; allowed: 1, %'),
    ],
)
def test_a_wrong_unit_is_a_fault_that_says_which_are_right(name: str, text: str, words: str) -> None:
    _, _, (fault,) = with_own_units(Declared(), {}, {name: text})
    assert words in fault


def test_levels_may_have_units_too_and_texts_stay_texts() -> None:
    given: dict[str, Any] = {"room": "20 degC", "supply": "2 bar", "plain": "on", "speed": 3.0, "none": "2 m"}
    levels, _, faults = with_own_units(Declared(), given, {})
    assert not faults
    assert levels == {"room": 293.15, "supply": 2e5, "plain": "on", "speed": 3.0, "none": "2 m"}
    _, _, (fault,) = with_own_units(Declared(), {"room": "20 m"}, {})
    assert 'operating point: unit "m" does not fit room' in fault


@pytest.mark.parametrize(
    "text",
    [
        "room [degC]=20\nsupply=2 bar\n\n# from the log\nplain=0.5\nmode=eco\nx[1,2]=3\n",
        'room [degC],supply [bar],plain,mode,"x[1,2]"\n20,2,0.5,eco,3\n',
        'name,value,unit\nroom,20,degC\nsupply,2,bar\nplain,0.5,\nmode,eco,\n"x[1,2]",3,\n',
        "Name;Value\nroom [degC];20\nsupply;2 bar\nplain;0.5\nmode;eco\nx[1,2];3\n",
    ],
    ids=["assigned", "one row", "a row each", "semicolons"],
)
def test_an_operating_point_may_be_a_file(text: str, tmp_path: Path) -> None:
    path = tmp_path / "at.csv"
    path.write_text(text, encoding="utf-8")
    expected = {"room": "20 degC", "supply": "2 bar", "plain": 0.5, "mode": "eco", "x[1,2]": 3.0}
    assert operating_point_of(path) == expected
    assert operating_point([path, {"plain": 1.0}]) == {**expected, "plain": 1.0}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("room=20\nroom=21\n", "line 2: room is given more than once"),
        ("room=20\nsupply\n", 'line 2: "supply" is not possible; needed: NAME=VALUE'),
        ("room,supply\n1,2\n3,4\n", "2 rows under names; needed: one row of values, or lines of NAME=VALUE"),
        ("name,value\nroom,\n", "line 2: room has no value"),
        ("", "is empty"),
    ],
)
def test_what_is_no_operating_point_is_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "at.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=words):
        operating_point_of(path)
    with pytest.raises(DataError, match="cannot be read"):
        operating_point_of(tmp_path / "nowhere.csv")


def test_units_are_kept_to_in_the_study_and_all_faults_told_at_once(tmp_path: Path) -> None:
    heated = V("u", 0, causality="input", start="290", more={"unit": "K", "min": "200", "max": "400"})
    y = V("x", 1, causality="output", initial="exact", start="0")
    units = '<UnitDefinitions><Unit name="K"><BaseUnit K="1"/></Unit></UnitDefinitions>'
    text = describe("2.0", "lag", (heated, y), interfaces=CO_SIMULATION)
    if "<UnitDefinitions" not in text:
        text = text.replace("<ModelVariables>", f"{units}<ModelVariables>")
    fmu = write_fmu(tmp_path / "heated.fmu", text, model_library("2.0"))
    at = tmp_path / "at.csv"
    at.write_text("u [degC]\n22\n", encoding="utf-8")
    proposal = suggest_study(fmu, at=at, ranges={"u": "20:24 degC"}, trial=False)
    bounds = proposal.study.bounds["u"]
    assert (bounds.min, bounds.max) == (293.15, 297.15)
    assert proposal.study.plant.start == {"u": 295.15}
    with pytest.raises(ConfigError) as refused:
        suggest_study(fmu, at={"u": "22 m"}, ranges={"u": "20:24 bar", "x": "5:1"}, trial=False)
    assert len(refused.value.faults) == 3
