"""Problems of the benchmark are what they are called."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigvals
from studies import run_file

from ddpc_cosim import Steps
from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.study.file_format.sections import BandSection
from ddpc_cosim.study.reading import read_study
from fmu_plants import cstr, quadruple_tank
from fmu_plants.linear import linearise

LEARNING = ("ph-neutralisation", "non-minimum-phase-tanks", "limit-that-pays")
DOCS = Path(__file__).parents[2] / "docs"


def test_who_can_use_the_weather_is_told_it_and_a_pid_is_not() -> None:
    problems = read_study("benchmark").problems
    for name in ("weather-forecast", "two-zone-house"):
        study = problems[name].study
        usual = {signal: section.known for signal, section in study.disturbances.items()}
        for scenario, section in study.scenarios.items():
            known = usual | dict(section.known)
            assert {*known.values()} == ({"unknown"} if scenario == "disturbance" else {"low"})
        for controller in study.controllers.values():
            assert controller.settings.get("use_forecast", True)
        assert not study.controllers["pid"].settings.get("feedforward", False)


def test_the_limit_that_pays_is_below_the_temperature_from_which_the_reactor_ignites() -> None:
    """The coolant that holds a temperature has its maximum where two equilibria meet."""
    problem = read_study("benchmark").problems["limit-that-pays"].study
    temperature = np.linspace(324.0, 345.0, 2101)
    rate = cstr.RATE * np.exp(-cstr.ACTIVATION / temperature)
    concentration = cstr.FLOW / (cstr.FLOW + cstr.VOLUME * rate)
    heat = cstr.FLOW * cstr.HEAT_CAPACITY * (cstr.FEED_TEMPERATURE - temperature)
    heat += cstr.REACTION_HEAT * cstr.VOLUME * rate * concentration
    ignition = temperature[np.argmax(temperature - heat / cstr.HEAT_TRANSFER)]
    limit = problem.bounds["temperature"].max
    assert isinstance(limit, Steps)
    assert max(limit.values) == 335.0 < ignition < 336.0
    wanted = problem.reference["temperature"]
    assert isinstance(wanted, BandSection)
    assert wanted.band.upper == limit
    assert np.all(np.diff(concentration) < 0.0)  # so the hottest that is allowed is the cheapest


def test_the_log_is_what_the_script_writes() -> None:
    spec = importlib.util.spec_from_file_location("log_tanks", DOCS / "scripts" / "log_tanks.py")
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    header, *rows = script.lines()
    there, *logged = (script.STUDIES / "tanks-log.csv").read_text(encoding="utf-8").splitlines()
    assert there == header
    values = [np.array([row.split(";") for row in each], dtype=np.float64) for each in (rows, logged)]
    assert np.abs(values[0] - values[1]).max() <= 0.011  # another machine may round to the next digit


def test_controllers_learn_from_another_half_of_the_log_than_the_plant_is_identified_from() -> None:
    problem = read_study("benchmark").problems["from-a-log"].study
    assert problem.plant.identified is not None
    assert problem.recording is not None
    assert problem.recording.file == problem.plant.identified.file
    assert problem.recording.part[1] == problem.plant.identified.part[0] == 0.5
    assert problem.plant.identified.members == len(problem.seeds)


def test_the_tanks_rest_where_they_start_and_have_a_zero_in_the_right_half_plane() -> None:
    plant = read_study("benchmark").problems["non-minimum-phase-tanks"].study.plant
    given = {name: value for name, value in plant.parameters.items() if isinstance(value, float)}
    values = {parameter.name: parameter.start for parameter in quadruple_tank.MODEL.parameters} | given
    h1, h2, h3, h4 = (
        values[f"outlet_{i}"] * np.sqrt(2 * 981.0 * level.start)
        for i, level in enumerate(quadruple_tank.LEVELS, 1)
    )
    pumped = [3.0 * values["pump_gain_1"], 3.0 * values["pump_gain_2"]]
    splits = values["split_1"], values["split_2"]
    assert h3 == pytest.approx((1 - splits[1]) * pumped[1], rel=1e-6)
    assert h4 == pytest.approx((1 - splits[0]) * pumped[0], rel=1e-6)
    assert h1 - h3 == pytest.approx(splits[0] * pumped[0], rel=1e-6)
    assert h2 - h4 == pytest.approx(splits[1] * pumped[1], rel=1e-6)
    a, b, c, d = linearise(quadruple_tank.MODEL, parameters=given)
    n, m = b.shape
    right = np.zeros((n + m, n + m))
    right[:n, :n] = np.eye(n)
    zeros = eigvals(np.block([[a, b], [c, d]]), right)
    assert max(zeros[np.isfinite(zeros) & (np.abs(zeros) < 1e3)].real) > 0.01


def test_no_method_looks_as_far_as_the_dead_time_unless_it_is_told() -> None:
    problem = read_study("benchmark").problems["late-reflux"]
    sampling_time = problem.study.loop.sampling_time
    late = {
        scenario.effects["delay"]["reflux"] / sampling_time for scenario in problem.study.scenarios.values()
    }
    (samples,) = late
    for section in problem.study.controllers.values():
        if section.type != "mpc":
            assert load_plugin("controllers", section.type)().horizon < samples, section.type


@pytest.mark.slow
def test_who_learns_on_follows_a_plant_that_drifts(tmp_path: Path) -> None:
    only = [f"{name}_*_drift_*" for name in LEARNING]
    frame = run_file("benchmark", tmp_path, jobs=2, seeds=[0], only=only).frame()
    for problem, error in (
        ("ph-neutralisation", "mean_abs_error.pH [1]"),
        ("non-minimum-phase-tanks", "mean_abs_error.level_1 [cm]"),
    ):
        of_problem = frame[frame["problem"] == problem].set_index("controller")[error]
        assert of_problem["gpc"] < 0.6 * of_problem[["deepc", "spc"]].min()
    at_the_limit = frame[frame["problem"] == "limit-that-pays"].set_index("controller")
    money = at_the_limit["money [EUR]"]
    assert money["nmpc"] < money["gpc"] < money[["mfapc", "deepc", "pid"]].min()
    violation = at_the_limit["band_violation.temperature [degC.h]"]
    assert violation["gpc"] < violation[["mfapc", "deepc", "mpc", "pid"]].min()
    assert {*violation[violation > 1.0].index} == {"idle", "koopman-mpc"}  # with these it ignites
