"""Key figures of a building as BOPTEST defines them, in studies of an FMU that measures what it uses."""

import csv
import re
from pathlib import Path
from typing import Any

import pytest

from ddpc_controllers import PID, Idle
from ddpc_cosim import (
    Band,
    ConfigError,
    Constant,
    KnownDisturbance,
    Price,
    Problem,
    Scenario,
    Sine,
    Steps,
    Study,
    StudyResults,
)
from ddpc_cosim.description import KeyFigureTags, PlantDescription
from ddpc_cosim.study.cases import cases_of
from ddpc_cosim.study.plants import PlantSpec
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.results import write_report

from .recomputed import key_figures_of

OFFICE = '''
"""The building with meters: a heat pump with its pump, a boiler, district heating, tap water and CO2."""

from dataclasses import replace

from fmu_plants import Equations, Variable, building

METERS = {
    "heat_pump": ("W", lambda v: v.heating_power / (1 + (v.heater_temperature - 290) / 10)),
    "pump": ("kW", lambda v: 0.02 + v.heating_power / 1e5),
    "boiler": ("W", lambda v: 100 + 30 * (295 - v.indoor_temperature)),
    "substation": ("W", lambda v: 50 * (320 - v.heater_temperature)),
    "tap": ("m3/s", lambda v: 1e-6 * (v.indoor_temperature - 280)),
    "co2": ("ppm", lambda v: 800 + 40 * (v.envelope_temperature - 291)),
}


def equations(v):
    rest = building.equations(v)
    return Equations(rest.derivatives, {name: meter(v) for name, (_, meter) in METERS.items()})


MODEL = replace(
    building.MODEL,
    name="metered_building",
    outputs=(*building.MODEL.states, *(Variable(name, unit) for name, (unit, _) in METERS.items())),
    equations=equations,
)
'''
AREA = 120.0
SOURCES = {
    "ElectricPower": ["heat_pump", "pump"],
    "GasPower": ["boiler"],
    "DistrictHeatingPower": ["substation"],
    "FreshWaterFlowRate": ["tap"],
    "AirZoneTemperature[air]": ["indoor_temperature"],
    "OperativeZoneTemperature[walls]": ["envelope_temperature", "heater_temperature"],
    "CO2Concentration[air]": ["co2"],
    "RelativeHumidity[air]": ["co2"],
}
BANDS = {
    "envelope_temperature": {"band": {"lower": 19.6, "upper": 20.0}, "unit": "degC"},
    "heater_temperature": {"band": {"lower": 21.0, "upper": 23.0}, "unit": "degC"},
    "co2": {
        "band": {"lower": 0.0, "upper": {"kind": "steps", "times": [0.0, 3e4], "values": [840.0, 845.0]}}
    },
}
TABLE = {"set": "boptest", "area": AREA, "sources": SOURCES, "bands": BANDS}
TARIFF = Steps([0.0, 7 * 3600.0, 21 * 3600.0], [0.1, 0.3, 0.1])
KWH = {"unit": "EUR/kWh"}
PRICES = {
    "pump": Price(signal="pump", price=TARIFF, emissions=0.2, **KWH),
    "heat pump": Price(signal="heat_pump", price=TARIFF, emissions=0.2, **KWH),
    "gas": Price(signal="boiler", price=0.08, emissions=Constant(200.0), emissions_unit="g/kWh", **KWH),
    "heat": Price(signal="substation", price=70.0, unit="EUR/MWh"),
    "water": Price(signal="tap", price=4.0, unit="EUR/m3"),
}
OTHER_PRICES = Scenario(prices={"pump": Constant(0.2), "heat pump": Constant(0.2)})
EVERY = {"tdis", "idis", "ener", "cost", "emis", "pele", "pgas", "pdih", "atvl"}


def office(folder: Path, **changes: Any) -> Problem:
    """Return half a day of the office, in which some of its meters are paid for and some are not measured."""
    (folder / "office.py").write_text(OFFICE, encoding="utf-8")
    settings: dict[str, Any] = {
        "sampling_time": "10 min",
        "duration": "12 h",
        "warm_up": "1 h",
        "start_time": 3600.0,
        "inputs": ["heating_power"],
        "outputs": ["indoor_temperature"],
        "measurements": ["indoor_temperature", *(price.signal for price in PRICES.values())],
        "reference": Band(20.0, Steps([0.0, 2e4], [20.5, 22.0]), "degC"),
        "disturbances": {
            "outdoor_temperature": KnownDisturbance(signal=Sine(6.0, 1 / 86400.0, offset=-2.0, unit="degC"))
        },
        "prices": PRICES,
        "scenarios": {"tariff": Scenario(), "constant": OTHER_PRICES},
        "key_figures": TABLE,
    }
    return Problem(plant=f"{folder / 'office.py'}:MODEL", **settings | changes)


CONTROLLERS = {"pid": PID(proportional=1500.0, integral=0.15), "idle": Idle()}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("office")


@pytest.fixture(scope="module")
def results(folder: Path) -> StudyResults:
    return Study(office(folder), CONTROLLERS).run(folder / "out", progress=False)


def figures_in(metrics: dict[str, float]) -> dict[str, float]:
    return {key: value for key, value in metrics.items() if re.match(r"\w+_(tot|rat) ", key)}


def test_key_figures_are_those_of_the_paper_s_formulas(results: StudyResults) -> None:
    assert len(results.cases) == 4
    for case in results.cases:
        expected = key_figures_of(case.folder, AREA, SOURCES)
        assert figures_in(case.metrics) == pytest.approx(expected, rel=1e-9, abs=1e-12)
        assert all(value > 0 for key, value in expected.items() if case.controller == "pid")
    cost = {case.scenario: case.metrics["cost_tot [EUR/m2]"] for case in results.cases}
    assert cost["tariff"] != cost["constant"]


def test_they_stand_in_tables_terminal_and_page(results: StudyResults, folder: Path) -> None:
    with (results.folder / "metrics.csv").open(encoding="utf-8", newline="") as file:
        header = next(csv.reader(file))
    assert {key.partition("_tot")[0] for key in header if "_tot [" in key} == EVERY
    report = results.report(folder / "report.html").read_text(encoding="utf-8")
    for label in ("Thermal discomfort", "Air quality discomfort", "Peak gas power per area", "EUR/m2"):
        assert label in report
    data = write_report([results], folder / "report.json", "json").read_text(encoding="utf-8")
    assert "tdis_tot" in data
