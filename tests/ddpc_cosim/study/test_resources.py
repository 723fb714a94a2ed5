"""Signals of kind "resource": a study takes weather, comfort and prices from the plant that it is about."""

from pathlib import Path

import numpy as np
import pytest
from resources import BY_DAY, HOURS, OUTDOORS, SUN, files_of_a_house, with_resources
from studies import cases_in, run_file, write

from ddpc_cosim import ConfigError, KnownDisturbance, Price, Product, SignalFromResource
from ddpc_cosim.study.plants import PlantSpec
from ddpc_cosim.study.reading import read_study
from fmu_plants import build_fmu
from fmu_plants.building import MODEL

STUDY = """
plant = { fmu = "stranger.fmu", inputs = ["heating_power"], outputs = ["indoor_temperature"] }
loop = { sampling_time = "1 h", duration = "1 d", start_time = "day 16", warm_up = "12 h" }
controllers.mfapc.type = "mfapc"

[disturbances.outdoor_temperature]
known = "medium"
signal = { kind = "resource", file = "weather.csv", column = "TDryBul", unit = "K", interpolation = "linear" }

[disturbances.solar_irradiance]
signal.kind = "product"
signal.parts = [
    { kind = "resource", file = "weather.csv", column = "HGloHor", interpolation = "linear" },
    { kind = "constant", value = 0.5 },
]

[reference.indoor_temperature]
band.lower = { kind = "resource", file = "setpoints.csv", column = "LowerSetp[1]", unit = "K" }
band.upper = { kind = "resource", file = "setpoints.csv", column = "UpperSetp[1]" }

[bounds.heating_power]
max = { kind = "steps", times = [0.0], values = [8000.0] }

[prices.electricity]
signal = "heating_power"
price = { kind = "resource", file = "prices.csv", column = "PriceElectricPowerConstant" }
emissions = { kind = "resource", file = "emissions.csv", column = "EmissionsElectricPower" }
unit = "EUR/kWh"

[scenarios.constant]
[scenarios.dynamic]
prices.electricity = { kind = "resource", file = "prices.csv", column = "PriceElectricPowerDynamic" }
"""


@pytest.fixture(scope="module")
def folder(own_cache_folder: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("house")
    with_resources(build_fmu(MODEL), folder, files_of_a_house())
    return folder


def test_every_signal_is_the_column_of_the_table_in_the_plants_unit(folder: Path) -> None:
    case = next(case for case in cases_in(write(folder, STUDY)) if case.scenario == "dynamic")
    time = 15 * 86_400 + np.arange(25) * 3600.0
    rows = slice(360, 385)
    np.testing.assert_array_equal(HOURS[rows], time)
    inputs = case.conditions.inputs
    np.testing.assert_allclose(
        inputs["outdoor_temperature"].at(time + 1800)[:-1], (OUTDOORS[rows][1:] + OUTDOORS[rows][:-1]) / 2
    )
    np.testing.assert_allclose(inputs["solar_irradiance"].at(time), SUN[rows] / 2)
    band = case.reference["indoor_temperature"]
    np.testing.assert_array_equal(band.lower.at(time + 1800), np.where(BY_DAY[rows], 294.15, 290.15))
    price = case.prices["electricity"]
    np.testing.assert_array_equal(price.price.at(time + 1800), np.where(BY_DAY[rows], 0.3, 0.2))
    np.testing.assert_array_equal(price.emissions.at(time), np.full(25, 0.167))


def test_a_run_reads_them_and_is_written_as_it_was_said(folder: Path) -> None:
    results = run_file(write(folder, STUDY))
    frame = results.frame()
    assert set(frame["outcome"]) == {"completed"}
    written = (folder / "out" / "study.toml").read_text(encoding="utf-8")
    assert 'column = "TDryBul"' in written
    assert len(written) < 10_000  # not the rows of the tables
    again = read_study(str(folder / "out" / "study.toml")).problem
    assert again.disturbances["constant"].keys() == {"outdoor_temperature", "solar_irradiance"}


def test_the_id_goes_by_the_plants_bytes_and_by_what_is_said(folder: Path, tmp_path: Path) -> None:
    ids = {case.name: case.id for case in cases_in(write(folder, STUDY))}
    assert {case.name: case.id for case in cases_in(write(folder, STUDY))} == ids
    others = [STUDY.replace('"TDryBul", unit = "K", interpolation = "linear"', '"TDryBul", unit = "K"')]
    others.append(STUDY.replace('"TDryBul", unit = "K"', '"HGloHor", unit = "K"'))
    others.append(STUDY.replace('"TDryBul", unit = "K"', '"TDryBul", unit = "degC"'))
    for other in others:
        changed = {case.name: case.id for case in cases_in(write(folder, other, "other.toml"))}
        assert not set(changed.values()) & set(ids.values())
    files = files_of_a_house()
    files["weather.csv"] = files["weather.csv"].replace(",278.0,", ",278.5,", 1)
    with_resources(build_fmu(MODEL), tmp_path, files)
    changed = {case.name: case.id for case in cases_in(write(tmp_path, STUDY))}
    assert not set(changed.values()) & set(ids.values())


def test_all_faults_are_told_at_once_with_their_places(folder: Path) -> None:
    text = STUDY.replace('"weather.csv", column = "TDryBul"', '"weathr.csv", column = "TDryBul"')
    text = text.replace('"HGloHor"', '"HGloHr"').replace(
        '"LowerSetp[1]", unit = "K"', '"LowerSetp[1]", unit = "W"'
    )
    text = text.replace('"PriceElectricPowerDynamic"', '"PriceDynamic"')
    with pytest.raises(ConfigError) as error:
        read_study(str(write(folder, text, "bad.toml")))
    told = "\n".join(error.value.faults)
    assert 'disturbances.outdoor_temperature.signal.file: the plant has no "weathr.csv"' in told
    assert 'did you mean "weather.csv"?' in told
    assert 'solar_irradiance.signal.parts[0].column: weather.csv has no column "HGloHr"; did you mean' in told
    assert 'reference.indoor_temperature.band.lower.unit: unit "W" does not fit' in told
    assert 'scenarios.dynamic.prices.electricity.column: prices.csv has no column "PriceDynamic"' in told
    assert len(error.value.faults) == 4


def test_a_table_shorter_than_a_year_has_to_reach_over_the_run(tmp_path: Path) -> None:
    files = files_of_a_house()
    files["weather.csv"] = "\n".join(files["weather.csv"].splitlines()[:370]) + "\n"
    with_resources(build_fmu(MODEL), tmp_path, files)
    with pytest.raises(ConfigError) as error:
        read_study(str(write(tmp_path, STUDY)))
    assert any(
        "weather.csv tells it from t = 0 s to 15 d 8 h; needed" in fault for fault in error.value.faults
    )


def test_a_plant_without_tables_says_that_it_has_none(tmp_path: Path) -> None:
    text = STUDY.replace('fmu = "stranger.fmu"', 'name = "building"')
    with pytest.raises(ConfigError, match="in its resources; there are none"):
        read_study(str(write(tmp_path, text)))


def test_python_says_the_same() -> None:
    signal = SignalFromResource("weather.csv", "TDryBul", unit="K", interpolation="linear")
    known = KnownDisturbance(signal=Product([signal, SignalFromResource("o.csv", "x")]), known="low")
    assert (
        "SignalFromResource(unit='K', file='weather.csv', column='TDryBul', interpolation='linear')"
        in repr(known)
    )
    price = Price(signal="p", price=signal, unit="EUR/kWh")
    with pytest.raises(ConfigError, match="needed: a plant in a study"):
        price.over("electricity", np.zeros(1))


def test_a_csv_file_that_a_plant_of_equations_adds_is_a_table_too(tmp_path: Path) -> None:
    """Prices that no equation reads lie among its further files, as text or as what returns it."""
    (tmp_path / "house.py").write_text(
        "from dataclasses import replace\n"
        "from fmu_plants.building import MODEL as BUILDING\n"
        'TEXT = "time,Price\\n0,0.25\\n3600,0.5\\n"\n'
        'MODEL = replace(BUILDING, resources={"a.csv": TEXT, "b.csv": lambda: TEXT, "read.me": TEXT})\n',
        encoding="utf-8",
    )
    tables = PlantSpec(f"{tmp_path / 'house.py'}:MODEL", "").tables()
    assert tables.names == ("a.csv", "b.csv")
    for name in tables.names:
        times, prices = tables.table(name).column("Price")
        assert times.tolist() == [0.0, 3600.0]
        assert prices.tolist() == [0.25, 0.5]
