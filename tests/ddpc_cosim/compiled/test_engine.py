"""The compiled engine gives what the master in Python gives: the same samples, figures and faults."""

import json
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from ddpc_controllers import PID
from ddpc_cosim import (
    Bounds,
    ConfigError,
    Constant,
    GaussianNoise,
    Loop,
    Outcome,
    Recording,
    Trace,
    Variable,
    cosimulate,
)
from ddpc_cosim.cli.main import main
from ddpc_cosim.compiled.engine import CompiledEngine, CompiledRun
from ddpc_cosim.compiled.program import program_of
from ddpc_cosim.conditions import all_conditions
from ddpc_cosim.fmu.plant import FMUPlant
from ddpc_cosim.loop import master
from ddpc_cosim.study.case_runs import run_alike, run_case, started
from ddpc_cosim.study.cases import Case
from ddpc_cosim.study.runner import Selection
from fmu_plants import export_fmu
from fmu_plants.pendulum import MODEL
from tests.studies import cases_in, study_text, write

LOOP = {"sampling_time": 0.1, "duration": 4.0}
REFERENCE = {"angle": {"kind": "steps", "times": [0.0, 2.0], "values": [0.3, -0.2]}}
RECORDING = {"samples": 60, "excitation": {"torque": {"kind": "uniform", "low": -3.5, "high": 3.5}}}
PLANT = {"name": "pendulum", "inputs": ["torque"], "outputs": ["angle"]}
MEASURED = {"measurements": ["angle", "angular_velocity"]}
BOUNDS = {"torque": {"min": -3.5, "max": 3.5}}
CONTROLLERS: Mapping[str, Any] = {
    "deepc": {"type": "deepc", "settings": {"initial_length": 3, "horizon": 5}},
    "mfapc": {"type": "mfapc"},
    "pid": {"type": "pid", "settings": {"proportional": 4.0, "integral": 3.0, "derivative": 0.5}},
}
SCENARIOS: Mapping[str, Any] = {
    "plain": {},
    "noise": {"noise": {"angle": 0.01, "angular_velocity": 0.05}},
    "late-input": {"delay": {"torque": 0.2}, "rate_limit": {"torque": 8.0}},
    "late-sensor": {"delay": {"angle": 0.1}, "quantum": {"angle": 0.01}},
    "play": {"backlash": {"torque": 0.3}},
    "losses": {"loss": {"angle": 0.2}, "noise": {"angle": 0.01}},
    "pushed": {
        "disturbances": {
            "torque": {"kind": "steps", "times": [1.0], "values": [0.8]},
            "angle": {"kind": "noise", "standard_deviation": 0.01},
        }
    },
    "heavier": {"events": [{"time": 1.5, "parameters": {"mass": 1.4}}]},
    "wearing": {
        "drifts": [
            {"parameter": "damping", "from_value": 0.4, "to_value": 0.8, "from_time": 0.5, "to_time": 3}
        ]
    },
}


@pytest.fixture(scope="module")
def cases(own_cache_folder: None, tmp_path_factory: pytest.TempPathFactory) -> list[Case]:
    """The cases of a study of three methods under all conditions."""
    text = study_text(
        {**PLANT, **MEASURED},
        REFERENCE,
        CONTROLLERS,
        LOOP,
        name="compiled",
        seeds=[3],
        bounds=BOUNDS,
        recording=RECORDING,
        scenarios=SCENARIOS,
    )
    return cases_in(write(tmp_path_factory.mktemp("compiled"), text))


def both(case: Case) -> tuple[Trace, Trace]:
    """Return the trace of a case by each engine."""
    return run_case(case), run_case(replace(case, engine="compiled"))


def assert_the_same(python: Trace, compiled: Trace) -> None:
    """Check samples, counts of fallbacks and metrics."""
    assert compiled.engine == "compiled"
    assert (compiled.outcome, len(compiled)) == (python.outcome, len(python))
    for name in ("time", "reference", "y", "measured", "u", "applied"):
        expected = getattr(python, name)
        scale = float(np.nanmax(np.abs(expected), initial=0.0)) or 1.0
        np.testing.assert_allclose(
            getattr(compiled, name), expected, rtol=0.0, atol=1e-9 * scale, err_msg=name
        )
    assert [s == "ok" for s in compiled.status] == [s == "ok" for s in python.status]
    expected, found = python.metrics(), compiled.metrics()
    assert found.keys() == expected.keys()
    for key, value in expected.items():
        if not key.startswith(("solve_time", "deadline_misses")):
            scale = max(abs(value), 1.0)
            assert found[key] == pytest.approx(value, rel=1e-9, abs=1e-9 * scale, nan_ok=True), key


@pytest.mark.parametrize("controller", CONTROLLERS)
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_samples_and_figures_are_those_of_python(cases: list[Case], controller: str, scenario: str) -> None:
    (case,) = (c for c in cases if (c.controller, c.scenario) == (controller, scenario))
    assert_the_same(*both(case))


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_controllers_of_a_seed_learn_from_one_experiment(
    cases: list[Case], scenario: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    began: list[int] = []
    make = master._experiment
    monkeypatch.setattr(master, "_experiment", lambda *args: (began.append(1), make(*args))[1])
    of_seeds = [
        replace(case, engine="compiled", seed=seed)
        for seed in (3, 4)
        for case in cases
        if case.scenario == scenario
    ]
    for case, trace in zip(of_seeds, run_alike(of_seeds), strict=True):
        alone = run_case(case)
        assert (trace.outcome, trace.engine) == (Outcome.COMPLETED, "compiled")
        for name in ("y", "measured", "u", "applied"):
            np.testing.assert_array_equal(getattr(trace, name), getattr(alone, name), err_msg=name)
        assert trace.recorded_samples == alone.recorded_samples
    assert len(began) == 2 + len(of_seeds)


@pytest.mark.parametrize("other", ["parameters", "limits", "noise"])
def test_another_experiment_is_another_one(cases: list[Case], other: str) -> None:
    case, pid = (
        next(c for c in cases if (c.controller, c.scenario) == (controller, "noise"))
        for controller in ("deepc", "pid")
    )
    changed: dict[str, Any] = {
        "parameters": {"parameters": case.parameters | {"mass": 1.3}},
        "limits": {"bounds": case.bounds | {"torque": (0.5, 3.5)}},
        "noise": {"noise_mixture": ((5, 1.0),)},
    }[other]
    both_of_them = [replace(pid, engine="compiled"), replace(case, engine="compiled", **changed)]
    *_, trace = run_alike(both_of_them)
    np.testing.assert_array_equal(trace.u, run_case(both_of_them[1]).u)


def test_all_conditions_of_the_house_are_known_in_c() -> None:
    own = {name: kind for name, kind in all_conditions().items() if kind.__module__.startswith("ddpc_cosim.")}
    assert all(kind.c_code for kind in own.values())
    used = {key for scenario in SCENARIOS.values() for key in scenario}
    assert own.keys() <= used


def test_the_engine_is_no_part_of_a_case(cases: list[Case], tmp_path: Path) -> None:
    text = study_text(PLANT, REFERENCE, ["mfapc"], LOOP)
    compiled = text.replace("[loop]\n", '[loop]\nengine = "compiled"\n')
    assert compiled != text
    python, other = (cases_in(write(tmp_path, t, f"{n}.toml"))[0] for n, t in enumerate((text, compiled)))
    assert (other.id, other.engine) == (python.id, "compiled")


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_fmus_of_both_versions(version: str, own_cache_folder: None, tmp_path: Path) -> None:
    path = export_fmu(MODEL, tmp_path / "pendulum.fmu", version)

    def run(engine: CompiledEngine | None) -> Trace:
        with FMUPlant(path, inputs=["torque"], outputs=["angle"]) as plant:
            return cosimulate(
                plant,
                PID(proportional=4.0, integral=3.0),
                sampling_time=0.1,
                duration=3.0,
                reference=Constant(0.2),
                noise=GaussianNoise({"angle": 0.01}),
                engine=engine,
            )

    engine = CompiledEngine()
    python, compiled = run(None), run(engine)
    assert engine.used == "compiled"
    np.testing.assert_allclose(compiled.y, python.y, rtol=0.0, atol=1e-12)


class Counting(PID):
    """Counts how often it is started, and may look at its random numbers at that."""

    starts, looks = 0, False

    def start(self, loop: Loop) -> None:
        super().start(loop)
        self.starts += 1
        if self.looks:
            deepcopy(loop.rng).normal()


def a_loop(recording: Recording | None = None, seed: int = 0, preview: int = 1) -> Loop:
    torque, angle = Variable("torque"), Variable("angle")
    bounds = Bounds(np.array([-1.0]), np.array([1.0]), np.array([-2.0]), np.array([2.0]))
    rng = np.random.default_rng(seed)
    return Loop(0.1, (torque,), (angle,), (angle,), bounds, recording, rng, preview)


def a_recording(seed: int) -> Recording:
    table = np.random.default_rng(seed).normal(size=(5, 1))
    return Recording(table, table, table, 0.1)


def test_a_controller_is_started_again_where_its_loop_is_another_one() -> None:
    engine, controller = CompiledEngine(), Counting(proportional=4.0)
    starts = []
    for loop in (
        a_loop(),
        a_loop(seed=1),
        a_loop(a_recording(0)),
        a_loop(a_recording(0), seed=2),
        a_loop(a_recording(1)),
        a_loop(a_recording(1), preview=2),
    ):
        engine.start(controller, loop)
        starts.append(controller.starts)
    assert starts == [1, 1, 2, 2, 3, 4]


def test_one_that_looks_at_random_numbers_is_always_started_again() -> None:
    engine, controller = CompiledEngine(), Counting(proportional=4.0)
    controller.looks = True
    for seed in (0, 0, 1):
        engine.start(controller, a_loop(seed=seed))
    assert controller.starts == 3


BUILDING: Mapping[str, Any] = {
    "plant": {
        "name": "building",
        "inputs": ["heating_power"],
        "outputs": ["indoor_temperature"],
        "measurements": ["indoor_temperature"],
    },
    "loop": {
        "sampling_time": "15 min",
        "duration": "12 h",
        "start_time": "day 3",
        "communication_step": "5 min",
    },
    "reference": {
        "indoor_temperature": {
            "unit": "degC",
            "band": {
                "lower": {"kind": "steps", "times": ["0 h", "7 h"], "values": [17.0, 20.0], "period": "1 d"},
                "upper": 24.0,
            },
        }
    },
    "bounds": {
        "heating_power": {
            "min": 0.0,
            "max": {"kind": "steps", "times": ["0 h", "6 h"], "values": [8000.0, 6000.0], "period": "1 d"},
        }
    },
    "disturbances": {
        "outdoor_temperature": {
            "known": "high",
            "lag": 2,
            "signal": {"kind": "random", "low": -4.0, "high": 6.0, "hold": "1 h", "unit": "degC"},
        },
        "solar_irradiance": {
            "known": "measured",
            "signal": {"kind": "random", "low": 0.0, "high": 300.0, "hold": "45 min"},
        },
    },
    "prices": {
        "electricity": {
            "signal": "heating_power",
            "factor": 0.333,
            "unit": "EUR/kWh",
            "price": {
                "kind": "steps", "times": ["0 h", "7 h"], "values": [0.2, 0.4], "period": "1 d",
            },
            "emissions": 0.167,
        }
    },
    "recording": {"samples": 120, "excitation": {"heating_power": {"low": 500.0, "high": 7000.0}}},
    "controllers": {
        "deepc": {
            "type": "deepc",
            "settings": {
                "horizon": 8, "initial_length": 3, "artificial_setpoint": False, "price_weight": 3.0
            },
        },
        "edge": {
            "type": "band-edge",
            "settings": {"controller": {"type": "mpc", "horizon": 6}, "margin": 0.5},
        },
    },
    "scenarios": {
        "plain": {},
        "noise": {"noise": {"indoor_temperature": 0.05, "outdoor_temperature": 0.3}},
        "losses": {"loss": {"outdoor_temperature": 0.3, "solar_irradiance": 0.3}},
        "pushed": {
            "disturbances": {
                "indoor_temperature": {"kind": "noise", "standard_deviation": 0.1},
                "solar_irradiance": {"kind": "noise", "standard_deviation": 5.0},
            },
        },
        "no-preview": {"preview": 1},
    },
}  # fmt: skip
"""All that a loop can have besides a plant, a reference and conditions."""


@pytest.fixture(scope="module")
def building(own_cache_folder: None, tmp_path_factory: pytest.TempPathFactory) -> list[Case]:
    return cases_in(write(tmp_path_factory.mktemp("building"), study_text(**BUILDING)))


@pytest.mark.parametrize("controller", BUILDING["controllers"])
@pytest.mark.parametrize("scenario", BUILDING["scenarios"])
def test_bands_prices_forecasts_and_what_is_between_samples_are_those_of_python(
    building: list[Case], controller: str, scenario: str
) -> None:
    (case,) = (c for c in building if (c.controller, c.scenario) == (controller, scenario))
    python, compiled = both(case)
    assert_the_same(python, compiled)
    assert np.ptp(python.d, axis=0).all()
    for name in ("d", "forecast", "band", "input_limits", "price", "charged", "intersample"):
        expected, of_c = getattr(python, name), getattr(compiled, name)
        assert expected.size
        np.testing.assert_allclose(of_c, expected, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.parametrize(
    ("loop", "engine"),
    [
        ({"warm_up": "3 h"}, "compiled"),
        ({"start": "recording-end"}, "compiled"),
        ({"warm_up": "3 h", "delay": 900.0}, "python: delay: C does not know what was before the run"),
        ({"warm_up": "3 h", "lag": 1}, "python: disturbances that are measured late: C does not know what"),
    ],
    ids=["warm-up", "recording-end", "remembers", "late"],
)
def test_a_run_that_goes_on_from_another_one(
    loop: dict[str, Any], engine: str, tmp_path: Path, own_cache_folder: None
) -> None:
    study, loop = deepcopy(dict(BUILDING)), dict(loop)
    delay = {"heating_power": loop.pop("delay")} if "delay" in loop else {}
    study["scenarios"] = {"nominal": {"delay": delay}}
    study["disturbances"]["outdoor_temperature"]["lag"] = loop.pop("lag", 0)
    study["loop"] |= loop
    for case in cases_in(write(tmp_path, study_text(**study))):
        python, asked = both(case)
        assert asked.engine.startswith(engine)
        np.testing.assert_allclose(asked.u, python.u, rtol=0.0, atol=1e-9 * 8000.0)
        np.testing.assert_allclose(asked.y, python.y, rtol=1e-9)


@pytest.mark.parametrize(
    ("stabiliser", "calls"),
    [
        ({"type": "pid", "settings": {"proportional": 2.0, "integral": 1.0}}, 2),
        ({"type": "spsa", "settings": {"kp": 2.0}}, 1),
    ],
    ids=["in C", "in Python"],
)
def test_an_experiment_with_a_stabilising_controller(
    stabiliser: dict[str, Any],
    calls: int,
    tmp_path: Path,
    own_cache_folder: None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recording = RECORDING | {"controller": stabiliser}
    scenarios = {"noise": SCENARIOS["noise"]}
    controllers = {"deepc": CONTROLLERS["deepc"]}
    tables = {"bounds": BOUNDS, "recording": recording, "scenarios": scenarios}
    text = study_text({**PLANT, **MEASURED}, REFERENCE, controllers, LOOP, **tables)
    (case,) = cases_in(write(tmp_path, text))
    made, make = list[CompiledRun](), CompiledRun.__init__

    def note(run: CompiledRun, *args: Any) -> None:
        made.append(run)
        make(run, *args)

    monkeypatch.setattr(CompiledRun, "__init__", note)
    assert_the_same(*both(case))
    assert len(made) == calls


def test_a_method_without_code_in_c_is_run_in_python(tmp_path: Path, own_cache_folder: None) -> None:
    text = study_text(
        PLANT, {"angle": 0.1}, {"nmpc": {"type": "nmpc", "settings": {"horizon": 3}}}, {"duration": 0.3}
    )
    (case,) = cases_in(write(tmp_path, text))
    python, asked = both(case)
    assert asked.engine.startswith("python: NMPC cannot be exported")
    np.testing.assert_array_equal(asked.y, python.y)


def test_a_plant_that_diverges_ends_the_run_where_it_does_in_python(
    tmp_path: Path, own_cache_folder: None
) -> None:
    model = """
from fmu_plants import Equations, PlantModel, Variable
STATE, INPUT = Variable("x", start=1.0), Variable("u")
MODEL = PlantModel(
    name="explosion",
    description="A state that is infinite after half a second",
    states=(STATE,),
    inputs=(INPUT,),
    outputs=(STATE,),
    parameters=(),
    equations=lambda v: Equations(derivatives={"x": v.x**3 + v.u}),
    step_size=0.1,
    stop_time=1.0,
)
"""
    (tmp_path / "explosion.py").write_text(model, encoding="utf-8")
    text = study_text(
        {"name": "explosion.py:MODEL", "inputs": ["u"], "outputs": ["x"]},
        {"x": 0.0},
        {"mfapc": "mfapc"},
        bounds={"u": {"min": -0.01, "max": 0.01}},
    )
    (case,) = cases_in(write(tmp_path, text))
    python, compiled = both(case)
    assert (compiled.outcome, compiled.reason) == (python.outcome, python.reason)
    assert python.outcome is not Outcome.COMPLETED
    np.testing.assert_allclose(compiled.y, python.y, rtol=1e-12)


def test_code_with_its_numbers_apart_is_the_same_for_every_recording(cases: list[Case]) -> None:
    (case,) = (c for c in cases if (c.controller, c.scenario) == ("deepc", "noise"))
    first, second = (
        controller.loadable_c_code(loop)
        for controller, loop in (started(replace(case, seed=seed)) for seed in (3, 4))
    )
    assert first.sources == second.sources
    assert first.numbers.shape == second.numbers.shape
    assert (first.numbers != second.numbers).any()
    assert program_of(first) is program_of(second)


def test_a_controller_around_another_one(tmp_path: Path, own_cache_folder: None) -> None:
    inside = {"type": "pid", "proportional": 6.0, "integral": 8.0}
    filtered = {"type": "safety-filter", "controller": inside, "steps_ahead": 10}
    text = study_text(
        {**PLANT, **MEASURED},
        REFERENCE,
        {"offset-free": {"type": "offset-free", "settings": {"controller": filtered}}},
        LOOP,
        seeds=[3, 4],
        bounds={**BOUNDS, "angle": {"min": -0.3, "max": 0.31}},
        recording=RECORDING,
        scenarios={"noise": SCENARIOS["noise"]},
    )
    cases = cases_in(write(tmp_path, text))
    for case in cases:
        python, compiled = both(case)
        assert_the_same(python, compiled)
        assert python.diagnostics["intervention_rate"] > 0.0
        of_steps = python.diagnostics.keys() - compiled.diagnostics.keys()  # Python's alone
        assert of_steps == {"intervention_rate", "largest_disturbance[0]"}
    first, second = (controller.loadable_c_code(loop) for controller, loop in map(started, cases))
    assert first.sources == second.sources


def test_run_says_which_engine_each_case_had(
    tmp_path: Path, own_cache_folder: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path, study_text(PLANT, {"angle": 0.1}, ["mfapc"], name="two"))
    done = CliRunner().invoke(main, ["run", "study.toml", "--engine", "compiled", "--no-report"])
    assert done.exit_code == 0, done.output
    found = [json.loads(path.read_text()) for path in tmp_path.glob("runs/two/cases/*/run.json")]
    assert {run["engine"] for run in found} == {"compiled"}
    facts = json.loads((tmp_path / "runs/two/provenance.json").read_text())
    assert facts["engine"] == "1 of 1 cases: compiled"


def test_an_engine_that_there_is_not_is_refused() -> None:
    with pytest.raises(ConfigError, match="--engine rust: must be python or compiled"):
        Selection(engine="rust")  # type: ignore[arg-type]


def test_all_that_is_controlled_comes_in_its_order(cases: list[Case]) -> None:
    (case,) = (c for c in cases if (c.controller, c.scenario) == ("mfapc", "noise"))
    wanted = {variable.name: Constant(0.1) for variable in case.measurements}
    assert_the_same(*both(replace(case, outputs=case.measurements[::-1], reference=wanted)))
