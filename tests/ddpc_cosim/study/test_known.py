"""What a study says of disturbances, bands, moving limits, prices and a warm-up, and what becomes of it."""

import copy
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from studies import cases_in, run_file, write

from ddpc_cosim import (
    Band,
    Constant,
    KnownDisturbance,
    Price,
    Problem,
    Recording,
    Steps,
    Study,
    UniformRandom,
)
from ddpc_cosim.loop.trace import Outcome
from ddpc_cosim.study.case_runs import no_samples, row_store
from ddpc_cosim.study.cases import Case, _hash_of, doing_nothing
from ddpc_cosim.study.reading import read_study

from .file_format.test_validation_errors import errors_of

HOUSE: dict[str, Any] = tomllib.loads("""
[plant]
name = "building"
outputs = ["indoor_temperature"]
[loop]
sampling_time = "15 min"
duration = "3 h"
start_time = "day 2"
warm_up = "1 h"
[disturbances.outdoor_temperature]
signal = { kind = "sine", amplitude = 5.0, offset = 5.0, frequency = 1e-5, unit = "degC" }
known = "perfect"
[disturbances.solar_irradiance]
signal = { kind = "constant", value = 100.0 }
[reference.indoor_temperature]
band = { lower = 20.0, upper = { kind = "steps", times = ["1 d", "1 d 1 h"], values = [22, 24] } }
unit = "degC"
[bounds.heating_power]
min = 0.0
max = { kind = "steps", times = ["1 d", "1 d 1 h"], values = [2.0, 1.0] }
unit = "kW"
[prices.heat]
signal = "heating_power"
price = 0.25
unit = "EUR/kWh"
factor = 0.33
emissions = 167
emissions_unit = "g/kWh"
[recording]
samples = 60
excitation.heating_power = { low = 0.0, high = 2000.0 }
[controllers.pid]
type = "pid"
settings = { proportional = 100.0 }
[controllers.deepc]
type = "deepc"
settings = { horizon = 8 }
[scenarios.nominal]
[scenarios.blind]
known = { outdoor_temperature = "unknown" }
prices.heat = { kind = "steps", times = [0.0, "1 d 1 h"], values = [0.2, 0.4] }
""")


def house(**changes: Any) -> dict[str, Any]:
    """Return the study with changes: ``loop__warm_up=3`` is ``loop.warm_up = 3``; None deletes."""
    study = copy.deepcopy(HOUSE)
    for key, value in changes.items():
        *sections, last = key.split("__")
        table = study
        for section in sections:
            table = table.setdefault(section, {})
        if value is None:
            del table[last]
        else:
            table[last] = value
    return study


def cases_of_house(folder: Path, **changes: Any) -> dict[str, Case]:
    path = write(folder, tomli_w.dumps(house(**changes)))
    return {f"{case.controller}, {case.scenario}": case for case in cases_in(path)}


@pytest.mark.parametrize(("known", "moving"), [("perfect", 3), ("unknown", 2)])
def test_a_recording_has_to_excite_what_controllers_know_of(tmp_path: Path, known: str, moving: int) -> None:
    """The heating and two disturbances, or one: for depth and order of windows, (m + n_d + 1) order - 1."""
    needed = (moving + 1) * (3 + 8 + 3) - 1
    windows = {"horizon": 8, "initial_length": 3}
    changes = {"controllers__deepc__settings": windows, "scenarios__blind": None}
    changes["disturbances__outdoor_temperature__known"] = known
    assert len(cases_of_house(tmp_path, recording__samples=needed, **changes)) == 2
    told = errors_of(house(recording__samples=needed - 1, **changes), tmp_path)
    assert told == [f"recording.samples: {needed - 1} is too short for deepc, which needs {needed}"]


def test_a_case_has_all_that_is_said(tmp_path: Path) -> None:
    cases = cases_of_house(tmp_path)
    case, blind = cases["pid, nominal"], cases["pid, blind"]
    assert [variable.name for variable in case.inputs] == ["heating_power"]
    assert [variable.name for variable in case.undriven] == ["outdoor_temperature", "solar_irradiance"]
    assert {name: known.known for name, known in case.disturbances.items()} == {
        "outdoor_temperature": "perfect",
        "solar_irradiance": "measured",
    }
    assert blind.disturbances["outdoor_temperature"].known == "unknown"
    assert case.conditions.inputs["solar_irradiance"] == Constant(100.0)
    assert case.conditions.inputs["outdoor_temperature"].at(np.zeros(1))[0] == pytest.approx(278.15)
    assert case.reference["indoor_temperature"] == Band(
        Constant(293.15), Steps((86400.0, 90000.0), (295.15, 297.15))
    )
    assert case.bounds["heating_power"] == (0.0, Steps((86400.0, 90000.0), (2000.0, 1000.0)))
    heat = case.prices["heat"]
    assert (heat.price, heat.emissions, heat.emissions_unit) == (Constant(0.25), Constant(0.167), "kg/kWh")
    assert blind.prices["heat"] == replace(heat, price=Steps((0.0, 90000.0), (0.2, 0.4)))
    assert (case.start_time, case.warm_up, case.forecast_horizon) == (86400.0, 3600.0, 8)
    assert case.recording_start == 86400.0 - 60 * 900.0


def test_what_is_said_runs_and_is_kept(tmp_path: Path) -> None:
    """Edges, limits, disturbances and prices stand in the files, and doing nothing has the same weather."""
    moving = {"outdoor_temperature": {"kind": "noise", "standard_deviation": 3.0, "mean": 280.0}}
    results = run_file(write(tmp_path, tomli_w.dumps(house(recording__disturbances=moving))))
    assert {str(case.outcome) for case in results.cases} == {"completed"}
    trace = results.trace("deepc", scenario="blind")
    assert [variable.name for variable in trace.disturbances] == ["solar_irradiance"]
    assert trace.d[:, 0].tolist() == [100.0] * 13
    assert trace.band[:, 0].tolist() == [[293.15, 295.15]] * 4 + [[293.15, 297.15]] * 9
    assert trace.input_limits[:, 0, 1].tolist() == [2000.0] * 4 + [1000.0] * 9
    assert trace.price[:, 0].tolist() == [0.2] * 4 + [0.4] * 9
    assert trace.emission[:, 0].tolist() == pytest.approx([0.167] * 13)
    sunny = results.trace("deepc", scenario="nominal")
    assert len(sunny.disturbances) == 2
    cases = cases_in(tmp_path / "study.toml")
    resting = doing_nothing(cases)
    assert {case.scenario: case.disturbances for case in resting} == {
        case.scenario: case.disturbances for case in cases
    }
    assert all(case.conditions.inputs == cases[0].conditions.inputs for case in resting)
    assert {case.warm_up for case in resting} == {3600.0}


def test_a_case_without_samples_has_the_same_columns(tmp_path: Path) -> None:
    case = cases_of_house(tmp_path)["deepc, nominal"]
    trace = no_samples(case, Outcome.CRASHED, "it crashed")
    assert {variable.name for variable in trace.disturbances} == set(case.disturbances)
    assert (trace.bands, trace.moving_limits) == (("indoor_temperature",), ("heating_power",))
    assert [charge.name for charge in trace.charges] == ["heat"]
    assert trace.bounds.u_max.tolist() == [2000.0]
    complete = results_columns(tmp_path)
    assert set(trace.frame().columns) <= complete
    assert {"price", "emission", "charged", "lower", "upper", "min", "max", "disturbance"} <= {
        column.partition(" ")[0] for column in trace.frame().columns
    }
    tables = ("d", "band", "input_limits", "output_limits", "price", "emission", "charged")
    assert row_store(case).more.keys() >= {*tables}


def results_columns(folder: Path) -> set[str]:
    return set(
        run_file(folder / "study.toml", only="deepc").trace("deepc", scenario="nominal").frame().columns
    )


def of_files(folder: Path, **tables: Mapping[str, Any]) -> None:
    """Write CSV files, each with columns by their headers."""
    for name, columns in tables.items():
        rows = zip(*columns.values(), strict=True)
        text = "\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)])
        (folder / f"{name}.csv").write_text(text, encoding="utf-8")


def outdoors(**more: Any) -> dict[str, Any]:
    return {"kind": "file", "file": "weather.csv", "column": "T", "unit": "degC", **more}


BEGIN, END = 86400.0 - 60 * 900.0, 86400.0 + 3 * 3600.0 + 8 * 900.0
"""Of the experiment, and of the run with the longest horizon."""


def test_a_weather_file_serves_experiment_run_and_horizon(tmp_path: Path) -> None:
    of_files(tmp_path, weather={"time": [BEGIN, END], "T": [1.0, 2.0]})
    cases = cases_of_house(tmp_path, disturbances__outdoor_temperature__signal=outdoors())
    assert cases["pid, nominal"].conditions.inputs["outdoor_temperature"] == Steps(
        (BEGIN, END), (274.15, 275.15)
    )


FILE = "disturbances.outdoor_temperature.signal.file"


@pytest.mark.parametrize(
    ("first", "last", "changes"),
    [
        (BEGIN + 1.0, END, {}),
        (BEGIN, END - 1.0, {}),
        # With another course in the experiment only the run and its warm-up count.
        (
            86400.0 - 3599.0,
            END,
            {"recording__disturbances": {"outdoor_temperature": {"kind": "constant", "value": 280.0}}},
        ),
    ],
)
def test_a_file_that_begins_late_or_ends_early(
    first: float, last: float, changes: dict[str, Any], tmp_path: Path
) -> None:
    of_files(tmp_path, weather={"time": [first, last], "T": [1.0, 2.0]})
    signal = outdoors(interpolation="linear")
    faults = errors_of(house(disturbances__outdoor_temperature__signal=signal, **changes), tmp_path)
    assert len(faults) == 1
    assert faults[0].startswith(f"{FILE}: {tmp_path / 'weather.csv'} ")
    assert "; needed: from " in faults[0]


@pytest.mark.parametrize(("known", "faults"), [("measured", 0), ("unknown", 0), ("perfect", 1), ("low", 1)])
def test_a_file_has_to_reach_beyond_the_run_for_forecasts_only(
    known: str, faults: int, tmp_path: Path
) -> None:
    of_files(tmp_path, weather={"time": [BEGIN, 86400.0 + 3 * 3600.0], "T": [1.0, 2.0]})
    signal = {"signal": outdoors(interpolation="linear"), "known": "measured"}
    study = house(
        disturbances__outdoor_temperature=signal, scenarios__blind__known__outdoor_temperature=known
    )
    assert len(errors_of(study, tmp_path)) == faults
    of_scenario = {"outdoor_temperature": outdoors(interpolation="linear")}
    study["disturbances"]["outdoor_temperature"]["signal"] = SINE
    study["scenarios"]["blind"]["inputs"] = of_scenario
    assert len(errors_of(study, tmp_path)) == faults


def test_a_price_from_a_file_covers_the_run_and_the_horizon(tmp_path: Path) -> None:
    price = {"kind": "file", "file": "tariff.csv", "column": "spot"}
    of_files(tmp_path, tariff={"time": [86400.0 - 3600.0, END], "spot": [0.1, 0.2]})
    assert errors_of(house(prices__heat__price=price), tmp_path) == []
    of_files(tmp_path, tariff={"time": [86400.0 - 3600.0, 86400.0], "spot": [0.1, 0.2]})
    (fault,) = errors_of(house(prices__heat__price=price), tmp_path)
    assert fault.startswith("prices.heat.price.file: ")
    assert fault.endswith("needed: from 23 h to 1 d 5 h")


@pytest.mark.parametrize("place", ["bounds", "scenarios.still.bounds", "controllers.pid.bounds"])
def test_a_bound_from_a_file_covers_the_run(place: str, tmp_path: Path) -> None:
    """Beyond the run, where only predictions go, its last value is held."""
    key = f"{place}.heating_power.max".replace(".", "__")
    limit = {"kind": "file", "file": "limits.csv", "column": "P", "unit": "kW"}
    begin, end = 86400.0 - 3600.0, 86400.0 + 3.0 * 3600.0
    of_files(tmp_path, limits={"time": [begin, end - 900.0, end], "P": [1.5, 1.2, 1.2]})
    assert errors_of(house(**{key: limit}), tmp_path) == []
    of_files(tmp_path, limits={"time": [begin, begin + 900.0], "P": [1.5, 1.2]})
    (fault,) = errors_of(house(**{key: limit}), tmp_path)
    assert fault.startswith(f"{place}.heating_power.max.file: ")
    assert fault.endswith("needed: from 23 h to 1 d 3 h")


FORECAST = {"forecast": {"file": "forecasts.csv", "unit": "degC"}, "known": "medium"}
ISSUED = [86400.0 + 900.0 * k for k in range(13)]


@pytest.mark.parametrize(
    ("columns", "fault"),
    [
        ({"time": ISSUED, "0 h": [1.0] * 13, "2 h": [2.0] * 13}, ""),
        (
            {"time": ISSUED, "0 h": [1.0] * 13, "1 h": [2.0] * 13},
            "the forecast issued at t = 1 d ends at t = 1 d 1 h; needed at t = 1 d: 8 samples ahead, up to "
            "t = 1 d 2 h",
        ),
        (
            {"time": ISSUED[:4], "0 h": [1.0] * 4, "2 h": [2.0] * 4},
            "the forecast issued at t = 1 d 45 min ends at t = 1 d 2 h 45 min; needed at t = 1 d 1 h: 8 "
            "samples ahead, up to t = 1 d 3 h",
        ),
        (
            {"time": ISSUED[1:], "0 h": [1.0] * 12, "2 h": [2.0] * 12},
            "the first forecast is issued at t = 1 d 15 min, the run begins at 1 d",
        ),
        ({"time": [ISSUED[0], ISSUED[0]], "0 h": [1, 1], "5 h": [2, 2]}, "it must increase"),
        ({"time": ISSUED, "2 h": [1.0] * 13, "2h": [2.0] * 13}, "lead times must increase"),
    ],
    ids=["sound", "short", "few", "late", "overlapping", "lead-times"],
)
def test_a_file_of_forecasts(columns: dict[str, Any], fault: str, tmp_path: Path) -> None:
    of_files(tmp_path, forecasts=columns)
    signal = HOUSE["disturbances"]["outdoor_temperature"]["signal"]
    study = house(disturbances__outdoor_temperature={"signal": signal, **FORECAST})
    faults = errors_of(study, tmp_path)
    assert len(faults) == bool(fault)
    for message in faults:
        assert message.startswith("disturbances.outdoor_temperature.forecast.file: ")
        assert fault in message


def test_what_was_forecast_decides_a_case_and_not_where_the_file_is(tmp_path: Path) -> None:
    signal = HOUSE["disturbances"]["outdoor_temperature"]["signal"]
    hashes = []
    for folder, value in (("a", 1.0), ("b", 1.0), ("c", 2.0)):
        (tmp_path / folder).mkdir()
        columns = {"time": ISSUED, "0 h": [value] * 13, "2 h": [2.0] * 13}
        of_files(tmp_path / folder, forecasts=columns)
        cases = cases_of_house(
            tmp_path / folder, disturbances__outdoor_temperature={"signal": signal, **FORECAST}
        )
        hashes.append(_hash_of(cases["pid, nominal"], {}).hexdigest())
        # What is known in a scenario stands in place of the file.
        assert cases["pid, blind"].disturbances["outdoor_temperature"].forecast is None
    assert hashes[0] == hashes[1] != hashes[2]


SINE = HOUSE["disturbances"]["outdoor_temperature"]["signal"]


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        (
            {"disturbances__outdor_temperature": {"signal": SINE}},
            'disturbances: no input or output "outdor_temperature"; did you mean "outdoor_temperature"?',
        ),
        (
            {
                "plant__inputs": ["heating_power", "solar_irradiance"],
                "recording__excitation__solar_irradiance": {"low": 0.0, "high": 1.0},
            },
            "disturbances.solar_irradiance: the controllers drive this input; leave it out of plant.inputs",
        ),
        (
            {"disturbances__indoor_temperature": {"signal": SINE}},
            "disturbances.indoor_temperature: the controllers control this output; leave it out of "
            "plant.outputs",
        ),
        (
            {"disturbances__solar_irradiance": {"known": "measured"}},
            "disturbances.solar_irradiance: needs a signal, or one in the inputs of each scenario; none in: "
            "nominal, blind",
        ),
        (
            {"disturbances__heater_temperature": {"known": "low"}},
            'disturbances.heater_temperature: needs a signal, of which forecasts with known = "low" are made',
        ),
        (
            {"disturbances__solar_irradiance__known": "guessed"},
            "disturbances.solar_irradiance.known: must be one of 'unknown', 'measured', 'low', 'medium', "
            "'high' or 'perfect', got 'guessed'",
        ),
        (
            {"disturbances__solar_irradiance__signal": {"kind": "constant", "value": 1.0, "unit": "degC"}},
            'disturbances.solar_irradiance.signal.unit: unit "degC" does not fit solar_irradiance',
        ),
        (
            {"disturbances__solar_irradiance__lag": 13},
            "disturbances.solar_irradiance.lag: 13 samples are too many: the run has 13; choose a ",
        ),
        (
            {"loop__start_time": "2026-02-30"},
            'loop.start_time: must be a date of the calendar, as "2026-01-23" or "2026-01-23T06:00", got ',
        ),
        (
            {"scenarios__blind__known": {"outdor_temperature": "unknown"}},
            'scenarios.blind.known: no known disturbance "outdor_temperature"; did you mean ',
        ),
        (
            {"recording__disturbances": {"wind": SINE}},
            'recording.disturbances: no known disturbance "wind"',
        ),
        (
            {"recording__inputs": {"solar_irradiance": {"kind": "constant", "value": 1.0}}},
            "recording.inputs.solar_irradiance: is a known disturbance; use recording.disturbances",
        ),
        (
            {"recording__start_time": "20 h"},
            "recording.start_time: the experiment, 20 h to 1 d 11 h, would show the outdoor_temperature of "
            "the run, 1 d to 1 d 3 h; begin it at 9 h or before, or give "
            "recording.disturbances.outdoor_temperature",
        ),
        (
            {"recording__start_time": "20 h", "recording__disturbances": {"outdoor_temperature": SINE}},
            "recording.start_time: the experiment, 20 h to 1 d 11 h, would show the outdoor_temperature",
        ),
        (
            {"reference__indoor_temperature__band__lower": 23.0},
            "reference.indoor_temperature.band: lower (23 degC) is above upper (22 degC) at t = 1 d; needed: "
            "lower up to upper at all times",
        ),
        (
            {"reference__indoor_temperature__unit": "W"},
            'reference.indoor_temperature.unit: unit "W" does not fit indoor_temperature; allowed: K, ',
        ),
        (
            {"reference__indoor_temperature__band__upper": {"kind": "constant", "value": 300, "unit": "m"}},
            'reference.indoor_temperature.band.upper.unit: unit "m" does not fit indoor_temperature',
        ),
        (
            {"reference__indoor_temperature": {"band": {"lower": 20.0}}},
            "reference.indoor_temperature.band.upper: required key is missing",
        ),
        (
            {"bounds__heating_power__min": 1.5},
            "bounds.heating_power: min (1.5 kW) is above max (1 kW) at t = 1 d 1 h; needed: min up to max at "
            "all times",
        ),
        (
            {"bounds__heating_power__max": {"kind": "constant", "value": 2.0, "unit": "K"}},
            'bounds.heating_power.max.unit: unit "K" does not fit heating_power',
        ),
        (
            {"prices__heat__signal": "power"},
            'prices.heat.signal: "power" is not measured; needed: an input, or one of plant.measurements',
        ),
        (
            {"prices__heat__signal": "heater_temperature"},
            'prices.heat.signal: "heater_temperature" is not measured; needed: an input, or one of',
        ),
        (
            {"prices__heat__unit": "EUR/m3"},
            'prices.heat.unit: a price in "EUR/m3" does not fit heating_power: W over time is not an amount',
        ),
        (
            {"prices__heat__unit": "EUR"},
            'prices.heat.unit: a price in "EUR" does not fit heating_power: W over time is not an amount',
        ),
        *(
            (
                {"prices__heat__unit": unit},
                f'prices.heat.unit: a price in "{unit}" is not one in money; needed: money per amount',
            )
            for unit in ("W/kWh", "kg/kWh", "/kWh", "")
        ),
        (
            {"prices__gas": {"signal": "heating_power", "price": 1.0, "unit": "CHF/kWh"}},
            "prices.gas.unit: is in CHF, and heat in EUR; needed: one money for all prices of a problem",
        ),
        (
            {"prices__heat__emissions_unit": "kg/m3"},
            'prices.heat.emissions_unit: unit "kg/m3" does not fit heat; allowed: kg/kWh',
        ),
        (
            {"scenarios__blind__prices": {"power": 1.0}},
            'scenarios.blind.prices: no price "power"; there are: heat',
        ),
        (
            {"loop__warm_up": "4 h"},
            "loop.warm_up: 4 h is longer than the run of 3 h; choose a shorter one, or a longer duration",
        ),
        (
            {"loop__warm_up": "10 min"},
            "loop.warm_up: 10 min must be an integer multiple of the sampling time, 15 min",
        ),
        (
            {"loop__start": "recording-end"},
            'loop.warm_up: start = "recording-end" goes on from the recording; leave one of them out',
        ),
        (
            {"loop__warm_up": 0.0, "loop__warm_up_controller": {"type": "pid"}},
            "loop.warm_up_controller: needs warm_up, the time for which it controls",
        ),
        (
            {"loop__warm_up_controller": {"type": "deepc"}},
            "loop.warm_up_controller: learns from a recording itself; needed: one that controls without",
        ),
        (
            {"loop__warm_up_controller": {"type": "pid", "settings": {"gain": 1.0}}},
            "loop.warm_up_controller.settings.gain: unknown setting of pid",
        ),
        (
            {"prices": {}, "scenarios__blind__prices": {}, "metrics": {"ranking": "money"}},
            'metrics.ranking: "money" needs prices',
        ),
        (
            {"metrics": {"ranking": "pareto", "cost": {"outputs": {"indoor_temperature": 1.0}}}},
            'metrics.ranking: "pareto" and cost both rank; leave one of them out',
        ),
    ],
)
def test_what_does_not_fit_is_said_at_its_place_and_once(
    changes: dict[str, Any], fault: str, tmp_path: Path
) -> None:
    faults = errors_of(house(**changes), tmp_path)
    assert len(faults) == 1, faults
    assert faults[0].startswith(fault)


def test_a_file_of_forecasts_that_contradicts_what_is_known_hides_no_other_fault(tmp_path: Path) -> None:
    changes = {"disturbances__outdoor_temperature__forecast": {"file": "none.csv"}}
    faults = errors_of(
        house(**changes, disturbances__outdoor_temperature__known="perfect", loop__warm_up="4 h"), tmp_path
    )
    too_long, contradicts, missing = sorted(faults, key=lambda fault: "disturbances" in fault)
    assert contradicts.startswith(
        "disturbances.outdoor_temperature: disturbance: a file of forecasts does not"
    )
    assert missing.startswith("disturbances.outdoor_temperature.forecast.file: ")
    assert too_long.startswith("loop.warm_up: ")


def test_all_faults_are_said_at_once(tmp_path: Path) -> None:
    study = house(
        reference__indoor_temperature__band__lower=23.0,
        prices__heat__signal="power",
        loop__warm_up="4 h",
        disturbances__solar_irradiance={"known": "measured"},
    )
    assert len(errors_of(study, tmp_path)) == 4


def test_a_signal_may_stand_in_each_scenario(tmp_path: Path) -> None:
    sun = {"kind": "constant", "value": 50.0}
    cases = cases_of_house(
        tmp_path,
        disturbances__solar_irradiance={"known": "measured"},
        scenarios__nominal__inputs={"solar_irradiance": sun},
        scenarios__blind__inputs={"solar_irradiance": sun | {"value": 60.0}},
    )
    values = {name: case.conditions.inputs["solar_irradiance"] for name, case in cases.items()}
    assert values["pid, nominal"] == Constant(50.0)
    assert values["pid, blind"] == Constant(60.0)


def test_limits_may_meet(tmp_path: Path) -> None:
    off = {"kind": "steps", "times": ["1 d", "1 d 1 h"], "values": [2.0, 0.0]}
    assert errors_of(house(bounds__heating_power__max=off), tmp_path) == []


def test_noise_may_act_on_what_is_measured_of_a_disturbance(tmp_path: Path) -> None:
    assert errors_of(house(scenarios__blind__noise={"outdoor_temperature": 0.5}), tmp_path) == []


def test_logged_data_have_the_disturbances(tmp_path: Path) -> None:
    columns = {"heating_power": np.arange(60) % 7, "indoor_temperature": 290.0 + np.arange(60) % 5}
    weather = {"outdoor_temperature": 280.0 + np.arange(60) % 3, "sun": np.arange(60)}
    recording = {"file": "log.csv", "time_column": "", "columns": {"solar_irradiance": "sun"}}
    of_files(tmp_path, log=columns | weather)
    case = cases_of_house(tmp_path, recording=recording)["deepc, nominal"]
    assert case.recording is not None
    assert case.recording.d.tolist() == np.column_stack([*weather.values()]).tolist()
    assert case.recording_start is None
    of_files(tmp_path, log=columns)
    faults = errors_of(house(recording=recording), tmp_path)
    assert [fault.partition(";")[0] for fault in faults] == [
        f'recording.file: {tmp_path / "log.csv"}: no column "outdoor_temperature"',
        f'recording.file: {tmp_path / "log.csv"}: no column "sun"',
    ]


def test_disturbances_and_prices_belong_to_a_problem(tmp_path: Path) -> None:
    """A study that extends another changes, leaves out or sweeps them as other tables."""
    write(tmp_path, tomli_w.dumps(house()), "base.toml")
    changes: dict[str, Any] = {
        "extends": "base.toml",
        "disturbances": {
            "solar_irradiance": HOUSE["disturbances"]["solar_irradiance"] | {"known": "perfect"}
        },
        "scenarios": {"blind": False},
        "prices": {"heat": HOUSE["prices"]["heat"] | {"price": 0.5}},
        "sweep": {"disturbances.outdoor_temperature.known": ["unknown", "medium"]},
    }
    problems = read_study(str(write(tmp_path, tomli_w.dumps(changes)))).problems
    of_each = [problem.disturbances["nominal"] for problem in problems.values()]
    assert [known["outdoor_temperature"].known for known in of_each] == ["perfect", "unknown", "medium"]
    assert {known["solar_irradiance"].known for known in of_each} == {"perfect"}
    assert {problem.prices["nominal"]["heat"].price for problem in problems.values()} == {Constant(0.5)}
    several = {
        "problems": {"house": {key: HOUSE[key] for key in HOUSE if key != "controllers"}},
        "controllers": HOUSE["controllers"],
    }
    assert errors_of(several, tmp_path) == []


def test_python_says_the_same(tmp_path: Path) -> None:
    problem = Problem(
        plant="building",
        outputs=["indoor_temperature"],
        sampling_time="15 min",
        duration="3 h",
        start_time="day 2",
        disturbances={
            "outdoor_temperature": KnownDisturbance(signal=Constant(5.0, unit="degC"), known="perfect"),
            "solar_irradiance": KnownDisturbance(signal=Constant(100.0)),
        },
        reference=Band(20.0, 24.0, "degC"),
        bounds={"heating_power": (0.0, Steps([0.0, 90000.0], [2000.0, 1000.0]))},
        prices={"heat": Price(signal="heating_power", price=0.25, unit="EUR/kWh")},
        excitation=UniformRandom(0.0, 2000.0, samples=40),
    )
    made = Study(problem, {"pid": "pid"})
    path = made.write(tmp_path / "study.toml")
    (case,) = cases_in(path)
    assert case.reference["indoor_temperature"] == Band(Constant(293.15), Constant(297.15))
    assert case.disturbances.keys() == {"outdoor_temperature", "solar_irradiance"}
    assert Study.read(path).write(tmp_path / "again" / "study.toml").read_text() == path.read_text()
    trace = made.run(tmp_path / "out", progress=False).trace("pid")
    assert trace.completed
    assert trace.bands == ("indoor_temperature",)


def test_a_recording_in_python_has_its_disturbances(tmp_path: Path) -> None:
    d = np.column_stack([np.arange(30.0), np.arange(30.0) % 4])
    recording = Recording(np.ones((30, 1)), np.ones((30, 1)), np.ones((30, 1)), 900.0, d=d)
    problem = Problem(
        plant="building",
        outputs=["indoor_temperature"],
        sampling_time=900.0,
        duration=3600.0,
        disturbances={
            "outdoor_temperature": KnownDisturbance(signal=Constant(280.0)),
            "solar_irradiance": KnownDisturbance(signal=Constant(100.0)),
        },
        reference=Constant(293.15),
        recording=recording,
    )
    (case,) = cases_in(Study(problem, {"pid": "pid"}).write(tmp_path / "study.toml"))
    assert case.recording is not None
    assert case.recording.d.tolist() == d.tolist()
