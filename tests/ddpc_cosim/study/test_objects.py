"""Studies made in Python: they say what their file says, and run as it does."""

import math
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ddpc_controllers import MFAPC, PID, DeePC
from ddpc_cosim import (
    PRBS,
    Chirp,
    Conditions,
    ConfigError,
    Constant,
    Controller,
    Drift,
    FloatArray,
    GaussianNoise,
    Interpolated,
    Loop,
    MixedExcitation,
    Multisine,
    ParameterChange,
    ParameterValue,
    Plant,
    Problem,
    Ramp,
    Recording,
    Reference,
    Sample,
    Scenario,
    SignalExcitation,
    SignalFromFile,
    Sine,
    Steps,
    Study,
    StudyResults,
    UniformRandom,
    Variable,
    WhiteNoise,
    load_results,
    record,
    setting,
)
from ddpc_cosim.codec import read
from ddpc_cosim.signals.excitations import excitation_of, excited_together
from ddpc_cosim.study.case_runs import run_case
from ddpc_cosim.study.cases import cases_of
from ddpc_cosim.study.file_format.sections import RecordingSection, ScenarioSection
from ddpc_cosim.study.file_format.written import controller_table, experiment_table, signal_table
from ddpc_cosim.study.reading import read_study

NUMBERS = st.floats(-1e6, 1e6)
TIMES = st.lists(NUMBERS, min_size=1, max_size=5, unique=True).map(sorted)
POINTS = TIMES.flatmap(
    lambda times: st.tuples(st.just(times), st.lists(NUMBERS, min_size=len(times), max_size=len(times)))
)
SIGNALS = st.one_of(
    NUMBERS.map(Constant),
    POINTS.map(lambda points: Steps(tuple(points[0]), tuple(points[1]))),
    POINTS.map(lambda points: Interpolated(tuple(points[0]), tuple(points[1]))),
    st.builds(Ramp, NUMBERS, NUMBERS, st.just(0.0), st.floats(0.1, 9.0)),
    st.builds(Sine, NUMBERS, st.floats(1e-3, 1e3), NUMBERS, NUMBERS),
    st.builds(WhiteNoise, st.floats(0.0, 1e3), st.just(0.0)),
)


def vars_of(signal: Any) -> list[float]:
    return list(
        np.concatenate(
            [
                np.ravel(getattr(signal, declared.name))
                for declared in fields(signal)
                if declared.name != "unit"
            ]
        )
    )


def read_back(table: dict[str, Any]) -> Reference:
    signal: Any = read(ScenarioSection, {"inputs": {"x": table}}).inputs["x"]
    built: Reference = signal.in_unit(Variable("x"))
    return built


@given(SIGNALS)
def test_a_file_says_a_signal_as_it_is(signal: Reference) -> None:
    """Units are converted on the way, which rounds."""
    read = read_back(signal_table("x", signal))
    assert type(read) is type(signal)
    assert vars_of(read) == pytest.approx(vars_of(signal), rel=1e-12, abs=1e-9)


def test_a_signal_of_ones_own_has_no_written_form() -> None:
    class Own(Reference):
        def at(self, time: FloatArray) -> FloatArray:
            return time

    with pytest.raises(ConfigError, match=r"reference of x: a study cannot write .*; it can: Constant"):
        signal_table("reference of x", Own())


@pytest.mark.parametrize(
    "excitation",
    [
        UniformRandom(-1.0, [2.0, 3.0], 40),
        PRBS(-1.0, 1.0, 40, clock_period=3),
        Multisine(-1.0, 1.0, 64, sampling_time=0.1, max_frequency=2.0, phases="random"),
        Chirp(0.0, 1.0, 40, sampling_time=0.1, from_frequency=0.1, to_frequency=2.0),
        SignalExcitation((Steps((0.0, 1.0), (1.0, 2.0)), Steps((0.0,), (3.0,))), 40, 0.1),
        MixedExcitation(((UniformRandom(-1.0, 1.0, 40), (1,)), (PRBS(0.0, 2.0, 40), (0,)))),
    ],
    ids=lambda excitation: type(excitation).__name__,
)
def test_a_file_says_an_experiment_as_it_is(excitation: Any) -> None:
    """Each input's table builds what excites it; inputs of one kind are excited together."""
    table = experiment_table(excitation, ["a", "b"])
    entries = read(RecordingSection, table).excitation
    groups: dict[object, list[str]] = {}
    for name, entry in entries.items():
        groups.setdefault(excited_together(entry, name), []).append(name)
    drawn = np.empty((table["samples"], 2))
    for group in groups.values():
        members = [(entries[name], Variable(name)) for name in group]
        built = excitation_of(members, table["samples"], 0.1, is_added=False)
        drawn[:, [["a", "b"].index(name) for name in group]] = built.with_seed(7).draw(len(group))
    np.testing.assert_array_equal(drawn, excitation.with_seed(7).draw(2))


def problem(**changes: Any) -> Problem:
    settings: dict[str, Any] = {
        "plant": "pendulum",
        "inputs": ["torque"],
        "outputs": ["angle"],
        "sampling_time": 0.1,
        "duration": 1.0,
        "reference": Steps([0.0, 0.5], [0.2, -0.1]),
        "bounds": {"torque": (-3.5, 3.5)},
        "excitation": UniformRandom(-3.5, 3.5, samples=80),
    }
    return Problem(**settings | changes)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    folder = tmp_path_factory.mktemp("runs")
    noisy = Scenario(label="noise", noise=GaussianNoise({"angle": 0.001}))
    study = Study(
        problems={
            "steps": problem(scenarios={"nominal": Scenario(), "noisy": noisy}),
            "ramp": problem(reference={"angle": Ramp(0.0, 0.2, 0.0, 1.0)}),
        },
        controllers={
            "DeePC, short": DeePC(horizon=4),
            "MFAPC": MFAPC(),
            "PID": {"steps": PID(proportional=5.0), "ramp": PID(proportional=2.0, integral=1.0)},
        },
        seeds=range(2),
        name="mine",
        reference_points=("PID", "DeePC, short"),
    )
    assert repr(study) == "Study(mine: 2 problems, 3 controllers, 2 seeds)"
    study.write(folder / "mine.toml")
    return study.run(folder / "out", progress=False)


def test_it_runs_as_its_file_does(results: StudyResults) -> None:
    folder = results.folder.parent
    assert len(results.cases) == 3 * 2 * (2 + 1)
    assert {str(case.outcome) for case in results.cases} == {"completed"}
    again = Study.read(folder / "mine.toml")
    assert (again.problems, again.controllers) == (("steps", "ramp"), ("DeePC-short", "MFAPC", "PID"))
    moved = again.write(folder / "elsewhere" / "moved.toml")
    for file in (folder / "mine.toml", moved, results.folder / "study.toml"):
        read = Study.read(file).run(folder / "out", progress=False)
        assert [case.id for case in read.cases] == [case.id for case in results.cases], file
    assert load_results(results.folder).cases[0].label == "DeePC, short"
    settings = {case.problem: case.settings for case in results.cases if case.controller == "PID"}
    assert (settings["steps"]["proportional"], settings["ramp"]["integral"]) == (5.0, 1.0)


def test_results_as_tables(results: StudyResults) -> None:
    frame = results.frame()
    assert len(frame) == len(results.cases)
    rmse = "rmse.angle [deg]"
    assert frame[rmse].tolist() == [case.metrics[rmse] for case in results.cases]
    table = results.compare("rmse.angle", baseline="DeePC, short")
    assert table[["problem", "controller"]].values.tolist() == [
        [name, key] for name in ("steps", "ramp") for key in ("DeePC-short", "MFAPC", "PID")
    ]
    rows = frame[(frame["problem"] == "ramp") & (frame["controller"] == "MFAPC")][rmse]
    row = table[(table["problem"] == "ramp") & (table["controller"] == "MFAPC")].iloc[0]
    assert row["median"] == pytest.approx(np.median(rows))
    with pytest.raises(ConfigError, match=r'no metric "rsme\.angle"; did you mean "rmse\.angle"'):
        results.compare("rsme.angle", baseline="MFAPC")
    with pytest.raises(ConfigError, match="MFACP"):
        results.compare("rmse.angle", baseline="MFACP")
    shares = results.shares()  # of what competes
    assert shares[["controller", "problem"]].value_counts().to_dict() == {
        ("MFAPC", "steps"): 4,
        ("MFAPC", "ramp"): 2,
    }
    assert "18 cases" in repr(results)
    assert results._repr_html_().count("<tr>") == 1 + 9


def test_one_run_of_them(results: StudyResults) -> None:
    trace = results.trace("DeePC, short", problem="steps", scenario="noisy", seed=1)
    case = next(result for result in results.cases if result.id.startswith("steps_DeePC-short_noisy_seed1"))
    np.testing.assert_array_equal(trace.y, case.trace().y)
    with pytest.raises(ConfigError, match="several problems: steps, ramp; say which problem"):
        results.trace("MFAPC")
    with pytest.raises(ConfigError, match="several scenarios: nominal, noisy; say which scenario"):
        results.trace("MFAPC", problem="steps")
    with pytest.raises(ConfigError, match="MFAPC: no run with seed = 9; there are "):
        results.trace("MFAPC", seed=9)
    with pytest.raises(ConfigError, match='no controller "MFACP"; did you mean "MFAPC"'):
        results.trace("MFACP")


def test_logged_data_travel_with_the_study(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    u = rng.uniform(-3.5, 3.5, (90, 1))
    y = np.zeros((90, 1))
    for k in range(1, 90):
        y[k] = 0.9 * y[k - 1] + 0.02 * u[k - 1]
    logged = problem(excitation=None, recording=Recording(u, y, y, 0.1))
    study = Study(logged, {"deepc": DeePC()}, name="logged")
    first = study.run(tmp_path / "a", progress=False)
    assert (first.cases[0].outcome, first.cases[0].reason) == ("completed", "")
    again = Study.read(tmp_path / "a/study.toml").run(tmp_path / "b", progress=False)
    assert again.cases[0].id == first.cases[0].id
    written = study.write(tmp_path / "c/logged.toml")
    assert Study.read(written).run(tmp_path / "b", progress=False).cases[0].id == first.cases[0].id


def test_a_file_with_faults_is_shown_before_they_are_told(tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    for text in (
        "seeds = -1",
        "controllers = 3\nproblems = 3",
        "controllers.a = 3",
        "controllers.a.type = 3",
    ):
        path.write_text(text, encoding="utf-8")
        study = Study.read(path)
        assert repr(study).startswith("Study(wrong: ")
        assert "wrong" in study._repr_html_()


def test_conditions_events_and_cost_are_in_the_file(tmp_path: Path) -> None:
    conditions = Conditions(
        disturbances={"torque": [Steps((1.0,), (0.5,)), WhiteNoise(0.1)]},
        delay={"torque": 0.1},
        loss={"angle": 0.05},
    )
    made = problem(
        conditions=conditions,
        events=[ParameterChange(0.5, {"friction": 0.2})],
        noise={"angle": 0.01},
        cost={"outputs": {"angle": 2.0}},
        relevant={"absolute": 0.5, "percent": 2.0},
        preview=3,
        start_time=2.0,
        parameters={"mass": 1.1},
        bounds={"torque": (-math.inf, 2.0)},
    )
    file = tomllib.loads(Study(made, {"MFAPC": MFAPC()}).write(tmp_path / "s.toml").read_text())
    scenario = file["scenarios"]["nominal"]
    assert scenario["disturbances"]["torque"][0] == {"kind": "steps", "times": [1.0], "values": [0.5]}
    assert scenario["events"] == [{"time": 0.5, "parameters": {"friction": 0.2}}]
    assert (scenario["noise"], scenario["delay"], scenario["loss"]) == (
        {"angle": 0.01},
        {"torque": 0.1},
        {"angle": 0.05},
    )
    assert file["bounds"] == {"torque": {"min": -math.inf, "max": 2.0}}
    assert file["loop"] == {"sampling_time": 0.1, "duration": 1.0, "start_time": 2.0, "preview": 3}
    assert file["metrics"]["cost"]["outputs"] == {"angle": 2.0}
    assert file["metrics"]["relevant"] == {"absolute": 0.5, "percent": 2.0}
    assert file["controllers"]["MFAPC"] == {"type": "mfapc", "settings": {}}


class Bounded(Plant):
    """An integrator whose input has limits of its own."""

    inputs = (Variable("u", min=0.0, max=1.0),)
    outputs = (Variable("y"),)

    def reset(self, parameters: Mapping[str, ParameterValue], t0: float) -> FloatArray:
        self.y = np.zeros(1)
        return self.y

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.y = self.y + h * u
        return self.y


def test_infinite_bounds_lift_the_plants_own(tmp_path: Path) -> None:
    unbounded: dict[str, Any] = {"plant": Bounded, "inputs": (), "outputs": (), "excitation": None}
    for limits in ((-math.inf, math.inf), (-math.inf, 0.5)):
        made = problem(bounds={"u": limits}, reference=Constant(-5.0), **unbounded)
        study = Study(made, {"PID": PID(proportional=1.0)})
        resolved = read_study(str(study.write(tmp_path / "study.toml"))).problem
        trace = run_case(cases_of(resolved, resolved.plant.built())[0])
        assert (trace.bounds.u_min[0], trace.bounds.u_max[0]) == limits
        assert trace.u.min() < 0.0
    for wrong in ((math.inf, math.inf), (math.nan, 1.0), (2.0, -math.inf)):
        study = Study(problem(bounds={"u": wrong}, **unbounded), {"PID": PID(proportional=1.0)})
        with pytest.raises(ConfigError, match=r"bounds.u: min \(.*\) must be below max"):
            study.run(tmp_path / "wrong", progress=False)


@pytest.mark.parametrize(
    "excitation",
    [
        Multisine(-1.0, 1.0, 64, sampling_time=0.05),
        Chirp(0.0, 1.0, 40, sampling_time=0.05, from_frequency=0.1, to_frequency=2.0),
        SignalExcitation((Steps((0.0, 1.0), (1.0, 2.0)),), 40, 0.05),
        MixedExcitation(((PRBS(0.0, 2.0, 64), (0,)), (Multisine(-1.0, 1.0, 64, sampling_time=0.05), (1,)))),
    ],
    ids=lambda excitation: type(excitation).__name__,
)
def test_an_excitation_is_made_for_the_sampling_time_of_the_loop(excitation: Any) -> None:
    """Another one would have other frequencies than it says."""
    said = r"excitation: \w+ has sampling_time = 0.05 s, the loop 0.1 s"
    with pytest.raises(ConfigError, match=f"problem: {said}"):
        problem(excitation=excitation)
    with pytest.raises(ConfigError, match=said):
        record(Bounded(), excitation, sampling_time=0.1)


@dataclass(kw_only=True)
class Inner:
    factor: float = 1.0


@dataclass(kw_only=True)
class Own(Controller):
    gain: float = setting(1.0, doc="gain")
    inner: Inner = field(default_factory=Inner)
    shape: Any = None

    def start(self, loop: Loop) -> None:
        pass

    def step(self, sample: Sample) -> FloatArray:
        return self.gain * self.inner.factor * (sample.setpoint - sample.y)


def test_settings_that_differ_from_the_defaults_are_written() -> None:
    kind = f"{__name__}:Own"
    assert controller_table(Own()) == {"type": kind, "settings": {}}
    table = controller_table(Own(gain=2.0, inner=Inner(factor=3.0)))
    assert table["settings"] == {"gain": 2.0, "inner": {"type": f"{__name__}:Inner", "factor": 3.0}}
    with pytest.raises(ConfigError, match=r"Own: shape = <function .*: a study can hold numbers"):
        controller_table(Own(shape=lambda x: x))


def test_all_faults_at_once(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        Study(
            {"a": problem(excitation=SignalExcitation((Ramp(0, 1, 0, 1),), 80, 0.1))},
            {
                "?": MFAPC(),
                "doing nothing": MFAPC(),
                "x y": MFAPC(),
                "x-y": MFAPC(),
                "n": 3,
                "p": {"b": MFAPC()},
            },  # type: ignore[dict-item]
            reference_points=("n", "x_y"),
        )
    faults = "\n".join(caught.value.faults)
    for words in (
        "excitation: a study cannot write SignalExcitation",
        '"?": needed: letters or digits in it',
        '"doing nothing": "doing-nothing" is what the runs with inputs at rest are called',
        '"x-y"; "x y" is too much like it',
        '"n" is 3; needed: a controller, the name of one',
        '"p": no problem "b"; there are: a',
        'reference_points: no controller "x_y"; did you mean',
    ):
        assert words in faults
    with pytest.raises(ConfigError, match="noise belong to a scenario"):
        problem(noise={"angle": 0.1}, scenarios={"a": Scenario()})
    with pytest.raises(ConfigError, match=r"study: plant\.name: no plant"):
        Study(problem(plant="pendulun"), {"MFAPC": MFAPC()}).run(tmp_path / "out", progress=False)
    assert not (tmp_path / "out").exists()


SCRIPT = """
from dataclasses import replace
from ddpc_cosim import Plant, Problem, Steps, Study, Variable
from ddpc_controllers import PID
from fmu_plants.pendulum import MODEL
import numpy as np

class Lag(Plant):
    inputs, outputs = (Variable("u"),), (Variable("x"),)
    def reset(self, parameters=None, t0=0.0):
        self.x = np.zeros(1)
        return self.x.copy()
    def step(self, u, h):
        self.x = self.x + h * (u - self.x)
        return self.x.copy()

def study():
    loop = dict(sampling_time=0.1, duration=0.5, reference=Steps([0], [0.1]))
    own = replace(MODEL, name="own_pendulum")
    problems = {
        "lag": Problem(plant=Lag, **loop),
        "model": Problem(plant=own, inputs=["torque"], outputs=["angle"], **loop),
    }
    return Study(problems, {"PID": PID(proportional=2.0)})

if __name__ == "__main__":
    results = study().run("out", progress=False)
    print([(case.problem, str(case.outcome), case.reason) for case in results.cases])
    print(results.report("report.html"))
"""


def test_plants_of_a_script(tmp_path: Path) -> None:
    """A class, and equations that no entry point names."""
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "script.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0] == "[('lag', 'completed', ''), ('model', 'completed', '')]"
    assert (tmp_path / "report.html").stat().st_size > 100_000


def test_python_says_what_a_file_can_of_a_scenario_and_of_signals(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Units, a column of a CSV file, drifts, limits of a scenario, and limits of a case."""
    monkeypatch.chdir(tmp_path)
    Path("wanted.csv").write_text("time [s],angle [deg]\n0,0\n0.5,20\n", encoding="utf-8")
    drift = Drift(parameter="mass", start=1.0, stop=1.2, start_time=0.0, stop_time=0.5)
    conditions = Conditions(
        disturbances={"angle": Constant(2.0, unit="deg")}, backlash={"torque": 0.1}, quantum={"angle": 0.01}
    )
    scenario = Scenario(drifts=[drift], bounds={"torque": (-1.0, 1.0)}, conditions=conditions)
    made = Study(
        problem(
            reference=SignalFromFile("wanted.csv"),
            scenarios={"windy": scenario},
            case_timeout=60.0,
            memory_limit=1.0,
        ),
        {"PID": PID()},
    )
    reread = read_study(str(made.write(tmp_path / "elsewhere" / "study.toml"))).problem
    np.testing.assert_allclose(reread.reference["angle"].at(np.array([0.2, 0.5])), [0.0, np.deg2rad(20.0)])
    assert reread.study.scenarios["windy"].drifts == [drift]
    assert reread.scenario_bounds["windy"] == {"torque": (-1.0, 1.0)}
    assert reread.conditions["windy"].effects == conditions.effects
    (disturbance,) = reread.conditions["windy"].disturbances["angle"]
    np.testing.assert_allclose(disturbance.at(np.zeros(1)), np.deg2rad(2.0))
    assert (reread.study.loop.case_timeout, reread.study.loop.memory_limit) == (60.0, 1.0)
