"""A study from what an FMU's resources say: weather, comfort, prices and days of the year."""

from pathlib import Path

import pytest
from resources import files_of_a_house, with_resources

from ddpc_cosim import Band, SignalFromResource
from ddpc_cosim.description import describe
from ddpc_cosim.files.time_tables import read_time_table
from ddpc_cosim.fmu.resources import Resources
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.suggestion import suggest_study, write_study
from ddpc_cosim.suggestion.buildings import Building, shortened
from ddpc_cosim.suggestion.writing import Proposal
from ddpc_cosim.variables import Variable
from fmu_plants import build_fmu
from fmu_plants.building import MODEL

# Its house is looked into once, in one process.
pytestmark = pytest.mark.xdist_group("house")

DAY = 86_400.0


@pytest.fixture(scope="module")
def fmu(own_cache_folder: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    files = files_of_a_house()
    named = files["weather.csv"].replace("TDryBul,HGloHor", "outdoor_temperature,solar_irradiance", 1)
    return with_resources(build_fmu(MODEL), tmp_path_factory.mktemp("house"), files | {"weather.csv": named})


@pytest.fixture(scope="module")
def proposal(fmu: Path) -> Proposal:
    return suggest_study(fmu, trial=False)


def test_the_study_is_what_the_resources_say(proposal: Proposal) -> None:
    study = proposal.study
    assert (study.plant.inputs, study.plant.outputs) == (["heating_power"], ["indoor_temperature"])
    assert (study.loop.sampling_time, study.loop.duration) == (1800.0, 14 * DAY)
    assert (study.loop.warm_up, study.loop.start_time) == (DAY, 16 * DAY)
    band = study.reference["indoor_temperature"].band if study.reference else None
    assert band == Band(
        SignalFromResource("setpoints.csv", "LowerSetp[1]"),
        SignalFromResource("setpoints.csv", "UpperSetp[1]"),
    )
    acting = {name: known.signal for name, known in study.disturbances.items()}
    assert acting["outdoor_temperature"] == SignalFromResource("weather.csv", "outdoor_temperature")
    price = study.prices["electricity"]
    assert (price.signal, price.unit) == ("heating_power", "EUR/kWh")
    assert price.price == SignalFromResource("prices.csv", "PriceElectricPowerConstant")
    assert price.emissions == SignalFromResource("emissions.csv", "EmissionsElectricPower")
    assert study.metrics.key_figures is not None
    assert study.metrics.key_figures.sources == {
        "AirZoneTemperature[1]": ["indoor_temperature"],
        "ElectricPower": ["heating_power"],
    }  # without the output that does not exist


def test_there_is_a_scenario_for_each_day_and_kind_of_price(proposal: Proposal) -> None:
    scenarios = proposal.study.scenarios
    assert {name: s.start_time for name, s in scenarios.items()} == {
        "peak-heat-day-constant": 16 * DAY,
        "peak-heat-day-dynamic": 16 * DAY,
        "typical-heat-day-constant": 108 * DAY,
        "typical-heat-day-dynamic": 108 * DAY,
    }
    assert scenarios["typical-heat-day-dynamic"].label == "typical heat day, dynamic price"
    assert scenarios["peak-heat-day-constant"].prices == {}
    dynamic = SignalFromResource("prices.csv", "PriceElectricPowerDynamic")
    assert scenarios["peak-heat-day-dynamic"].prices == {"electricity": dynamic}


def test_the_experiment_ends_where_each_run_begins_and_not_before_the_year(proposal: Proposal) -> None:
    recording, loop = proposal.study.recording, proposal.study.loop
    assert recording is not None
    assert recording.samples is not None
    assert recording.start_time is None
    assert 7 * DAY <= recording.samples * loop.sampling_time <= 16 * DAY


def test_the_file_can_be_read_and_run(proposal: Proposal, fmu: Path, tmp_path: Path) -> None:
    path = write_study(proposal, fmu, tmp_path / "study.toml")
    problem = read_study(str(path)).problem
    assert len(problem.study.scenarios) == 4
    assert "the comfort band of" in path.read_text(encoding="utf-8").lower()


def test_a_trial_is_of_two_days_of_the_first_scenario(proposal: Proposal) -> None:
    tried = shortened(proposal).study
    assert (tried.loop.duration, tried.loop.warm_up) == (2 * DAY, DAY)
    assert [*tried.scenarios] == ["peak-heat-day-constant"]


def test_what_is_asked_for_is_kept(fmu: Path) -> None:
    loop = suggest_study(fmu, trial=False, sampling_time=900.0, duration=DAY).study.loop
    assert (loop.sampling_time, loop.duration, loop.warm_up) == (900.0, DAY, DAY)


def building(*outputs: Variable, **tables: str) -> Building:
    """Return a building of these outputs, with tables of a few rows."""
    read = [read_time_table(f"{name}.csv", text.encode()) for name, text in tables.items()]
    figures = {"OperativeZoneTemperature[nor]": ("T",)}
    return Building(Resources(tables=tuple(read), key_figures=figures, step=3600.0), describe((), outputs))


def test_outputs_of_a_reader_are_matched_by_boptests_names() -> None:
    names = [
        "weaSta_reaWeaTDryBul_y",
        "weaSta_reaWeaHGloHor_y",
        "weaSta_reaWeaWinSpe_y",
        "reaOccZonnor_y",
        "T",
    ]
    units = ["K", "W/m2", "m/s", "1", "K"]
    outputs = [Variable(name, unit) for name, unit in zip(names, units, strict=True)]
    house = building(
        *outputs,
        weather="time,TDryBul,HGloHor,winSpe\n0,280,0,1\n10,280,0,1\n",
        occupancy="time,Occupancy[nor]\n0,1\n10,2\n",
    )
    known = house.disturbances([], ["T"])
    assert {name: (d.known, getattr(d.signal, "column", "")) for name, d in known.items()} == {
        "weaSta_reaWeaTDryBul_y": ("medium", "TDryBul"),
        "weaSta_reaWeaHGloHor_y": ("medium", "HGloHor"),
        "reaOccZonnor_y": ("perfect", "Occupancy[nor]"),
    }
    assert {getattr(d.signal, "interpolation", "") for d in known.values()} == {"linear", "hold"}


def test_a_column_in_another_unit_than_the_output_is_not_taken() -> None:
    house = building(Variable("weaSta_reaWeaTDryBul_y", "W"), weather="time,TDryBul\n0,280\n10,281\n")
    assert house.disturbances([], []) == {}


@pytest.mark.parametrize(
    ("tested", "expected"), [(3600.0, 3600.0), (20_000.0, 3600.0), (900.0, 3600.0), (40.0, 60.0)]
)
def test_the_step_is_that_of_the_author_unless_the_plant_is_far_faster(
    tested: float, expected: float
) -> None:
    sample, said = building(Variable("T", "K")).sampling_time(tested)
    assert sample == expected
    assert bool(said) == (expected != 3600.0)


def test_without_a_band_the_zones_that_key_figures_name_are_controlled(tmp_path: Path) -> None:
    key_figures = files_of_a_house()["kpis.json"].replace("indoor_temperature", "heater_temperature")
    study = suggest_study(
        with_resources(build_fmu(MODEL), tmp_path, {"kpis.json": key_figures}), trial=False
    ).study
    assert study.plant.outputs == ["heater_temperature"]


def test_how_large_a_power_is_comes_from_what_is_known() -> None:
    heater, valve = Variable("heater", "W", min=0.0, max=10_000.0), Variable("valve", "1", min=0.0, max=1.0)
    paid, rated = Variable("power", "W"), Variable("power", "W", nominal=4000.0)
    known, unknown = (Building(Resources(area=area), describe((), (paid,))) for area in (48.0, None))
    assert known.power(paid, (heater,)) == 20.0 * 48.0
    assert known.power(rated, (heater,)) == 4000.0
    assert unknown.power(paid, (heater, valve)) == 10_000.0
    assert unknown.power(paid, (valve,)) == 3000.0  # and not what one square metre takes


def test_without_a_floor_area_no_key_figures_are_proposed() -> None:
    sources = {"AirZoneTemperature[1]": ("TZon",)}
    for area, are_proposed in ((None, False), (48.0, True)):
        outputs = (Variable("TZon", "K"),)
        house = Building(Resources(area=area, key_figures=sources), describe((), outputs))
        assert (house.key_figures(["TZon"], []) is not None) is are_proposed


def test_an_fmu_without_a_comfort_band_is_not_taken_for_a_building() -> None:
    assert (
        Building.of(Resources(key_figures={"ElectricPower": ("P",)}), describe((), [Variable("P", "W")]))
        is None
    )
