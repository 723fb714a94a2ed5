"""Key figures of a building as BOPTEST defines them, in studies of an FMU that measures what it uses."""

import csv
import tomllib
from dataclasses import replace
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
from ddpc_cosim.codec import read
from ddpc_cosim.description import KeyFigureTags, PlantDescription
from ddpc_cosim.study.cases import cases_of
from ddpc_cosim.study.file_format.sections import KeyFiguresSection
from ddpc_cosim.study.plants import PlantSpec
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.results import write_report

from .recomputed import key_figures_in, key_figures_of

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
        "band": {"lower": 0.0, "upper": {"kind": "steps", "times": [0.0, 3e4], "values": [700.0, 705.0]}}
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


def test_key_figures_are_those_of_the_paper_s_formulas(results: StudyResults) -> None:
    assert len(results.cases) == 4
    for case in results.cases:
        expected = key_figures_of(case.folder, AREA, SOURCES)
        assert key_figures_in(case.metrics) == pytest.approx(expected, rel=1e-9, abs=1e-12)
        assert case.controller == "idle" or all(value > 0 for value in expected.values()), expected
    cost = {case.scenario: case.metrics["cost_tot [EUR/m2]"] for case in results.cases}
    assert cost["tariff"] != cost["constant"]


def test_they_stand_in_tables_terminal_and_page(results: StudyResults, folder: Path) -> None:
    with (results.folder / "metrics.csv").open(encoding="utf-8", newline="") as file:
        header = next(csv.reader(file))
    assert {key.partition("_tot")[0] for key in header if "_tot [" in key} == EVERY
    report = results.report(folder / "report.html").read_text(encoding="utf-8")
    for label in ("thermal discomfort", "air quality discomfort", "peak gas power per area", "EUR/m²"):
        assert label in report
    section = report.partition(">Key figures <a")[2].partition("</section>")[0]
    assert all(word in section for word in ("As BOPTEST defines them", "computational time ratio"))
    data = write_report([results], folder / "report.json", "json").read_text(encoding="utf-8")
    assert "tdis_tot" in data


def test_the_key_is_said_in_a_file_as_in_python_and_its_name_alone_stands_for_the_set(folder: Path) -> None:
    written = Study(office(folder), CONTROLLERS).write(folder / "study.toml")
    assert tomllib.loads(written.read_text(encoding="utf-8"))["metrics"]["key_figures"] == TABLE
    assert read_study(str(written)).problem.study.metrics.key_figures == read(KeyFiguresSection, TABLE)
    by_name = Study(office(folder, key_figures="boptest"), CONTROLLERS).write(folder / "name.toml")
    assert 'key_figures = "boptest"' in by_name.read_text(encoding="utf-8")


def told_by(problem: Problem, folder: Path) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        read_study(str(Study(problem, CONTROLLERS).write(folder / "wrong.toml")))
    return [fault.partition("key_figures")[2] for fault in caught.value.faults]


def test_what_does_not_fit_is_told_all_at_once(folder: Path) -> None:
    sources = {
        "ElectricPower": ["heat_pmp", "pump", "co2"],
        "GasPowr": ["boiler"],
        "AirZoneTemperature": ["indoor_temperature"],
        "OperativeZoneTemperature[walls]": ["envelope_temperature"],
        "CO2Concentration[air]": ["co2"],
    }
    bands = {"boilr": BANDS["co2"]}
    table = {"set": "boptest", "area": AREA, "sources": sources, "bands": bands}
    assert told_by(office(folder, key_figures=table, prices={}, scenarios={}), folder) == [
        '.sources: no source "GasPowr"; did you mean "GasPower"?',
        '.sources: no source "AirZoneTemperature"; did you mean "AirZoneTemperature[1]"?',
        '.sources.ElectricPower: no output, or input that is driven, "heat_pmp"; did you mean "heat_pump"?',
        ".sources.ElectricPower: co2 is in ppm; needed: one in W, or in another unit of the same",
        '.bands: no output "boilr"; did you mean "boiler"?',
    ]
    sound = {"area": AREA, "sources": SOURCES, "bands": BANDS}
    wrong = {".area": {"set": "boptest", **sound, "area": 0.0}, ".set": {"set": "boptst", **sound}}
    for place, said in wrong.items():
        (fault,) = told_by(office(folder, key_figures=said), folder)
        assert fault.startswith(f"{place}: must be ")


def test_limits_and_prices_that_are_missing_are_told_with_the_remedy(folder: Path) -> None:
    prices = {name: price for name, price in PRICES.items() if name != "gas"}
    table = {**TABLE, "bands": {}}
    assert told_by(office(folder, key_figures=table, prices=prices), folder) == [
        ": limits are missing of envelope_temperature, heater_temperature, co2; needed: "
        "bands.envelope_temperature = { band = { lower = ..., upper = ... } }, "
        "bands.heater_temperature = { band = { lower = ..., upper = ... } }, "
        "bands.co2 = { band = { lower = ..., upper = ... } }, a band as reference, or sources without them",
        ": boiler: no price, and others of its sources have one; needed: prices of all or of none",
    ]
    (fault,) = told_by(office(folder, key_figures="boptest"), folder)
    assert fault.startswith(": area and sources missing, and the plant does not say so")


def test_what_the_plant_says_of_itself_is_used(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By name alone; what the study says besides stands in its place."""
    asked = PlantSpec.variables

    def described(spec: PlantSpec) -> PlantDescription:
        return replace(asked(spec), key_figures=KeyFigureTags(80.0, {**SOURCES, "Unknown[1]": ["x"]}))

    monkeypatch.setattr(PlantSpec, "variables", described)
    for said, area in ((None, 80.0), (100.0, 100.0)):
        table = {"set": "boptest", "bands": BANDS} | ({} if said is None else {"area": said})
        problem = office(folder, key_figures=table)
        resolved = read_study(str(Study(problem, CONTROLLERS).write(folder / "told.toml"))).problem
        assert resolved.metrics.key_figures is not None
        assert resolved.metrics.key_figures.area == area
        assert resolved.metrics.key_figures.sources.keys() == SOURCES.keys() - {"RelativeHumidity[air]"}


def ids(problem: Problem, folder: Path) -> set[str]:
    resolved = read_study(str(Study(problem, CONTROLLERS).write(folder / "ids.toml"))).problem
    return {case.id for case in cases_of(resolved, resolved.plant.built())}


def test_cases_are_run_again_only_where_something_has_to_be_kept_besides(folder: Path) -> None:
    """What is paid for, or controlled, is kept without: other key figures of it are computed again."""
    kept = {key: names for key, names in SOURCES.items() if "[" not in key}
    kept["AirZoneTemperature[air]"] = ["indoor_temperature"]
    table = {"set": "boptest", "area": AREA, "sources": kept}
    without = office(folder, key_figures=None)
    asked = office(folder, key_figures=table)
    assert ids(without, folder) == ids(asked, folder)
    assert ids(without, folder) != ids(office(folder), folder)
    Study(without, CONTROLLERS).run(folder / "again", progress=False)
    again = Study(asked, CONTROLLERS).run(folder / "again", progress=False)
    for case in again.cases:
        figures = key_figures_in(case.metrics)
        assert figures["ener_tot [kWh/m2]"] > 0
        assert "idis_tot [ppm.h]" not in figures
        twice = Study(replace(asked, key_figures={**table, "area": 2 * AREA}), CONTROLLERS)
        (same,) = (c for c in twice.run(folder / "again", progress=False).cases if c.id == case.id)
        per_area = {key for key in figures if "/m2" in key}
        assert {key: 2 * same.metrics[key] for key in per_area} == pytest.approx(
            {key: figures[key] for key in per_area}
        )
        break


def test_requirements_may_be_of_key_figures(folder: Path) -> None:
    limits = {"tdis_tot": {"max": 5.0}, "cost_tot": {"max": 1.0, "unit": "EUR/m2"}, "time_rat": {"max": 1.0}}
    ids(office(folder, requirements=limits), folder)
    with pytest.raises(ConfigError, match="the study has no tdis_tot; it needs metrics"):
        ids(office(folder, requirements=limits, key_figures=None), folder)
    only = {"set": "boptest", "area": AREA, "sources": {"ElectricPower": ["heat_pump"]}}
    with pytest.raises(ConfigError, match="the study has no tdis_tot; it needs signals of its sources"):
        ids(office(folder, requirements=limits, key_figures=only), folder)
