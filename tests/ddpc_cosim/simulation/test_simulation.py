"""Simulation in open loop, against formulas, another importer, and another solver."""

from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pandas as pd
import pytest
from fmus.builder import LAG, MODELS, Fault, V, describe, model_fmu, model_library, write_fmu
from scipy.integrate import solve_ivp

from ddpc_cosim import ConfigError, CosimWarning, Plant, Variable, simulate
from ddpc_cosim.errors import CosimError


def csv(folder: Path, text: str) -> Path:
    path = folder / "inputs.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("version", ["1.0", "2.0", "3.0"])
@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
def test_a_lag_follows_its_formula(tmp_path: Path, version: str, kind: str) -> None:
    """x' = 2 (u - x): a step from the initialisation on, and a start value."""
    only_model = {"interfaces": ""} if (version, kind) == ("1.0", "model-exchange") else {}
    path = model_fmu(tmp_path, version, "lag", **only_model)
    frame = simulate(
        path,
        inputs=pd.DataFrame({"time": [0.0, 2.0], "u": [1.5, 1.5]}),
        parameters={"x": 0.5, "rate": "2"},
        stop=2.0,
        step=0.1,
        fmi_type=kind,  # type: ignore[arg-type]
    )
    time = frame["time [s]"].to_numpy()
    assert time == pytest.approx(0.1 * np.arange(21), abs=1e-12)
    assert frame["x [1]"].to_numpy() == pytest.approx(1.5 - np.exp(-2 * time), abs=2e-4)
    assert (frame["u [1]"] == 1.5).all()
    assert frame.attrs["outcome"] == "completed"


def test_continuous_inputs_are_interpolated_and_held_from_sample_to_sample(tmp_path: Path) -> None:
    path = model_fmu(tmp_path, "2.0", "lag")
    inputs = csv(tmp_path, "time [ms];u\n0;0\n1000;2\n2000;2,5\n")
    frame = simulate(path, inputs=inputs, stop=2.0, step=0.25)
    u = np.interp(0.25 * np.arange(9), [0.0, 1.0, 2.0], [0.0, 2.0, 2.5])
    x, a = [0.0], np.exp(-0.25)
    for held in u[:-1]:
        x.append(a * x[-1] + (1 - a) * held)
    assert frame["u [1]"].to_numpy() == pytest.approx(u, abs=1e-15)
    assert frame["x [1]"].to_numpy() == pytest.approx(np.array(x), abs=1e-12)


def test_inputs_that_are_not_continuous_hold_their_last_value(tmp_path: Path) -> None:
    discrete = (V("u", 0, causality="input", variability="discrete", start="0"), *LAG[1:])
    path = write_fmu(tmp_path / "lag.fmu", describe("2.0", "lag", discrete), model_library("2.0"))
    frame = simulate(path, inputs=csv(tmp_path, "u,time\n1,0\n2,0.5\n2,1\n"), stop=1.0, step=0.25)
    assert frame["u [1]"].tolist() == [1.0, 1.0, 2.0, 2.0, 2.0]


def test_another_importer_finds_the_same_under_the_same_inputs(pendulum_fmu: Path) -> None:
    signal = np.array([(0.0, 0.0), (0.5, 2.0), (1.0, -1.0)], dtype=[("time", float), ("torque", float)])
    ours = simulate(pendulum_fmu, inputs=pd.DataFrame(signal), stop=1.0, step=0.05, fmi_type="co-simulation")
    theirs = fmpy.simulate_fmu(
        str(pendulum_fmu),
        stop_time=1.0,
        output_interval=0.05,
        step_size=0.05,
        input=signal,
        fmi_type="CoSimulation",
    )
    assert ours["time [s]"].to_numpy() == pytest.approx(theirs["time"], abs=1e-12)
    assert ours["angle [rad]"].to_numpy() == pytest.approx(theirs["angle"], abs=1e-9)


def test_another_importer_finds_the_same_events(tmp_path: Path) -> None:
    """A bouncing ball in Model Exchange."""
    text = describe("2.0", "ball", MODELS["ball"], indicators=1)
    path = write_fmu(tmp_path / "ball.fmu", text, model_library("2.0", complete=True))
    ours = simulate(path, stop=1.2, step=0.05, fmi_type="model-exchange")
    theirs = fmpy.simulate_fmu(
        str(path), stop_time=1.2, output_interval=0.05, fmi_type="ModelExchange", relative_tolerance=1e-9
    )
    interpolated = np.interp(ours["time [s]"], theirs["time"], theirs["h"])
    assert ours["h [1]"].to_numpy() == pytest.approx(interpolated, abs=1e-3)


def test_exported_equations_agree_with_another_solver(pendulum_fmu: Path, tmp_path: Path) -> None:
    """The pendulum under a step of its torque, from a start value in another unit, with another radius."""
    inputs = csv(tmp_path, "time,torque [N.m]\n0,0\n0.999999,0\n1,2\n2,2\n")
    values = {"angle": "30 [deg]", "angular_velocity": "0.5", "radius": "30 cm"}
    frame = simulate(pendulum_fmu, inputs=inputs, parameters=values, stop=2.0, step=0.01)

    def motion(t: float, x: np.ndarray, torque: float) -> list[float]:
        return [x[1], -9.81 / 0.3 * np.sin(x[0]) - 0.4 / 0.3 * x[1] + torque / 0.3]

    rows, precise = np.arange(201) * 0.01, {"rtol": 1e-10, "atol": 1e-12}
    first = solve_ivp(motion, (0, 1), [np.pi / 6, 0.5], t_eval=rows[:101], args=(0.0,), **precise)
    second = solve_ivp(motion, (1, 2), first.y[:, -1], t_eval=rows[100:], args=(2.0,), **precise)
    angle = np.concatenate((first.y[0], second.y[0][1:]))
    assert frame["torque [N.m]"].tolist() == [0.0] * 100 + [2.0] * 101
    assert frame["angle [rad]"].to_numpy() == pytest.approx(angle, abs=1e-4)


def test_an_initial_feedthrough_knows_the_inputs(tmp_path: Path) -> None:
    """What an FMU calculates in its initialisation depends on the signals' first values."""
    frame = simulate(
        model_fmu(tmp_path, "2.0", "lag"),
        inputs=csv(tmp_path, "time,u\n0,3\n1,3\n"),
        outputs=["u", "x"],
        stop=1.0,
        step=0.5,
    )
    assert frame["u [1]"].tolist() == [3.0, 3.0, 3.0]


def test_an_fmu_without_inputs_and_outputs_has_its_states_recorded(tmp_path: Path) -> None:
    states = [
        V(v.name, v.reference, derivative=v.derivative, start=v.start, initial=v.initial) for v in LAG[1:3]
    ]
    path = write_fmu(tmp_path / "lag.fmu", describe("2.0", "lag", states), model_library("2.0"))
    frame = simulate(path, parameters={"x": 1.0}, stop=1.0, step=0.5)
    assert list(frame.columns) == ["time [s]", "x [1]"]
    assert frame["x [1]"].to_numpy() == pytest.approx(np.exp([0.0, -0.5, -1.0]), abs=1e-12)
    assert any("its states are recorded" in note for note in frame.attrs["notes"])


def test_an_fmu_without_any_number_runs_too(tmp_path: Path) -> None:
    name = [V("name", 20, "String", causality="parameter", variability="fixed", start="a")]
    path = write_fmu(tmp_path / "lag.fmu", describe("2.0", "lag", name), model_library("2.0"))
    frame = simulate(path, stop=1.0, step=0.5)
    assert frame.to_dict("list") == {"time [s]": [0.0, 0.5, 1.0]}


def test_times_come_from_the_default_experiment(tmp_path: Path) -> None:
    experiment = '<DefaultExperiment startTime="1" stopTime="2" stepSize="0.3"/>'
    path = model_fmu(tmp_path, "2.0", "lag", head=experiment)
    frame = simulate(path)
    assert frame["time [s]"].to_numpy() == pytest.approx([1.0, 1.3, 1.6, 1.9])
    assert "the last sample is at 1.9 s" in frame.attrs["notes"][0]
    assert len(simulate(model_fmu(tmp_path, "2.0", "lag"))) == 501


class Tank(Plant):
    """A plant in Python: x' = u."""

    inputs = (Variable("u", unit="m3/s", max=5.0),)
    outputs = (Variable("level", unit="m"),)

    def reset(self, parameters: object = None, t0: float = 0.0) -> np.ndarray:
        if parameters:
            raise ConfigError("no parameter")
        self.level = np.zeros(1)
        return self.level.copy()

    def step(self, u: np.ndarray, h: float) -> np.ndarray:
        self.level = self.level + u * h
        return self.level.copy()


def test_a_plant_in_python_is_simulated_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parent)
    frame = simulate("test_simulation:Tank", inputs=csv(tmp_path, "time,u\n0,1\n1,3\n"), step=0.5)
    assert frame["level [m]"].tolist() == [0.0, 0.5, 1.5]


def faults_of(path: Path | str, **settings: object) -> str:
    with pytest.raises(ConfigError) as caught:
        simulate(path, **settings)  # type: ignore[arg-type]
    return "\n".join(caught.value.faults)


def test_everything_that_is_not_possible_is_told_at_once(tmp_path: Path) -> None:
    path = model_fmu(tmp_path, "2.0", "lag")
    faults = faults_of(
        path,
        inputs=csv(tmp_path, "time,v,uu [V]\n0,1,1\n"),
        parameters={"ratte": 1.0, "rate": "3 [kg]", "x": "fast", "name": None, "u": [1.0]},
        stop=-1.0,
        step=0.0,
        outputs=["y"],
        step_timeout=0.0,
    )
    for words in (
        'column "v" is not an input; ',
        'column "uu" is not an input; did you mean "u"?',
        'no parameter "ratte"; did you mean "rate"?',
        'unit "kg" does not fit rate',
        "parameter x = 'fast' must be a number",
        "name = None is not possible",
        "parameter u = [1.0] must be a number",
        "stop = -1 s is not possible",
        "step = 0 s is not possible",
        'no output "y"',
        "step_timeout = 0.0 is not possible",
    ):
        assert words in faults


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time,u\n0,1\n1,1\n", "its times, 0 s to 1 s, do not cover the run, 0 s to 2 s"),
        ("time,u\n0.5,1\n3,1\n", "its times, 0.5 s to 3 s, do not cover the run"),
        ("t,u\n0,1\n2,1\n", 'no column "time"'),
        ("time,u\n0,1\n0,2\n2,1\n", "it must increase"),
        ("time,u\n0,1\n2,nan\n", '"nan" is not a finite number'),
        ("time,u,u\n0,1,1\n2,1,1\n", "is there more than once"),
        ("time,u\n", "a header and no rows"),
    ],
)
def test_inputs_that_cannot_be_used_are_refused(tmp_path: Path, text: str, words: str) -> None:
    assert words in faults_of(model_fmu(tmp_path, "2.0", "lag"), inputs=csv(tmp_path, text), stop=2.0)


def test_inputs_outside_their_declared_range_are_refused(tmp_path: Path) -> None:
    whole = V("n", 5, "Integer", causality="input", variability="discrete", start="0")
    bounded = V("u", 0, causality="input", start="0", more={"min": "-1", "max": "1"})
    path = write_fmu(tmp_path / "lag.fmu", describe("2.0", "lag", (bounded, whole)), model_library("2.0"))
    faults = faults_of(path, inputs=csv(tmp_path, "time,u,n\n0,0,1\n1,1.5,2.5\n"), stop=1.0)
    assert "u = 1.5 at t = 1 s is not possible; allowed: [-1, 1]" in faults
    assert "n = 2.5 at t = 1 s is not possible; allowed: an integer" in faults


@pytest.mark.parametrize(
    ("fault", "outcome"),
    [
        (Fault.SEGMENTATION_FAULT, "crashed"),
        (Fault.RETURN_ERROR, "fmu-error"),
        (Fault.RETURN_NAN, "diverged"),
        (Fault.HANG_IN_STEP, "timed-out"),
    ],
)
def test_samples_up_to_a_fault_are_kept_and_say_so(tmp_path: Path, fault: Fault, outcome: str) -> None:
    path = model_fmu(tmp_path, "2.0", "lag", fault)
    with pytest.warns(CosimWarning, match=f"lag2.fmu: {outcome}: 6 of 11 samples, to t = 0.5 s: "):
        frame = simulate(path, parameters={"x": 1.0}, stop=1.0, step=0.1, step_timeout=3.0)
    assert frame["x [1]"].to_numpy() == pytest.approx(np.exp(-0.1 * np.arange(6)), abs=1e-9)
    assert frame["outcome"].tolist() == [outcome] * 6
    assert frame.attrs["outcome"] == outcome


def test_a_fault_before_the_first_sample_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = model_fmu(tmp_path, "2.0", "lag", Fault.ERROR_IN_INITIALIZATION)
    with pytest.raises(CosimError, match=r"lag2\.fmu: fmu-error: before the first sample: .*fmi2EnterInit"):
        simulate(path, stop=1.0)
    monkeypatch.syspath_prepend(Path(__file__).parent)
    with pytest.raises(CosimError, match="Tank: fmu-error: before the first sample: no parameter"):
        simulate("test_simulation:Tank", parameters={"area": 2.0})


def test_what_cannot_be_opened_is_told(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such file"):
        simulate(tmp_path / "none.fmu")
    (tmp_path / "broken.fmu").write_bytes(b"no archive")
    with pytest.raises(CosimError, match=r"broken\.fmu"):
        simulate(tmp_path / "broken.fmu")
    with pytest.raises(CosimError, match="did you mean"):
        simulate("pendulumm")


def test_arguments_of_wrong_types_are_named_all_at_once() -> None:
    wrong: dict[str, Any] = {
        "inputs": 3,
        "parameters": ["mass"],
        "start": [1],
        "stop": {3},
        "step": "x",
        "step_timeout": None,
        "trace_calls": 1,
        "outputs": "y",
    }
    with pytest.raises(ConfigError) as caught:
        simulate("pendulum", **wrong)
    expected = [f"{name} = {value!r} is not possible; needed: " for name, value in wrong.items()]
    assert [
        fault[: len(words)] for fault, words in zip(caught.value.faults, expected, strict=True)
    ] == expected
    with pytest.raises(ConfigError, match=r"outputs = \[1\] is not possible; needed: a list of names"):
        simulate("pendulum", outputs=[1])  # type: ignore[list-item]


YEAR = '<DefaultExperiment startTime="0" stopTime="31536000" stepSize="3600"/>'


def lag_of(folder: Path, version: str, experiment: str) -> Path:
    return model_fmu(folder, version, "lag", head=experiment)


@pytest.mark.parametrize("version", ["1.0", "2.0", "3.0"])
def test_a_run_starts_where_it_is_told_on_the_axis_of_its_inputs(tmp_path: Path, version: str) -> None:
    """Inputs of a year, of which a day in January is run: x' = rate (u - x), from rest at its start."""
    day = 22 * 86400.0
    table = csv(tmp_path, f"time [d];u\n0;0\n22;2\n{22 + 1 / 24};2\n365;0\n")
    traced = tmp_path / "calls.txt"
    frame = simulate(
        lag_of(tmp_path, version, YEAR),
        inputs=table,
        parameters={"rate": 1e-3},
        start="day 23",
        stop=day + 3600,
        step=600,
        trace_calls=traced,
    )
    time = frame["time [s]"].to_numpy()
    assert time == pytest.approx(day + 600.0 * np.arange(7), abs=1e-6)
    assert frame["u [1]"].tolist() == [2.0] * 7
    assert frame["x [1]"].to_numpy() == pytest.approx(2 * (1 - np.exp(-1e-3 * (time - day))), abs=1e-9)
    set_up = {"1": "fmiInitializeSlave", "2": "fmi2SetupExperiment", "3": "fmi3EnterInitializationMode"}
    (call,) = [line for line in traced.read_text().splitlines() if set_up[version[0]] in line]
    assert "1900800.0" in call


@pytest.mark.parametrize(
    ("experiment", "asked", "expected", "note"),
    [
        ('startTime="2" stopTime="4"', {"start": 3}, (3.0, 4.0), ""),
        ('startTime="2" stopTime="4"', {"start": 9}, (9.0, 11.0), "stop = 11 s: as long as the default"),
        ('startTime="2" stopTime="4"', {"start": -1, "stop": 1}, (-1.0, 1.0), "before the plant's default"),
        ('startTime="2"', {"start": 5}, (5.0, 15.0), "stop = 15 s, as the plant does not say"),
        ('startTime="2" stopTime="4"', {}, (2.0, 4.0), ""),
    ],
)
def test_what_is_chosen_with_another_start(
    tmp_path: Path, experiment: str, asked: dict[str, Any], expected: tuple[float, float], note: str
) -> None:
    frame = simulate(lag_of(tmp_path, "2.0", f"<DefaultExperiment {experiment}/>"), step=0.5, **asked)
    time = frame["time [s]"]
    assert (time.iloc[0], time.iloc[-1]) == expected
    assert note in "; ".join(frame.attrs["notes"])


@pytest.mark.parametrize(
    ("asked", "fault"),
    [
        ({"start": 2.0, "stop": 1.0}, "stop = 1 s is not possible; allowed: a number > 2, the start time"),
        ({"start": float("nan")}, "start = nan s is not possible; allowed: a finite number"),
        ({"start": "day 400"}, "start = 'day 400' is not possible: must be \"day 1\", which is 1 January"),
        ({"stop": "soon"}, "stop = 'soon' is not possible: must be a number of seconds"),
    ],
)
def test_impossible_moments_are_refused(tmp_path: Path, asked: dict[str, Any], fault: str) -> None:
    with pytest.raises(ConfigError, match=fault):
        simulate(lag_of(tmp_path, "2.0", YEAR), **asked)


def test_inputs_that_do_not_reach_the_start_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="do not cover the run, 5 s to 9 s; choose another start or stop"):
        simulate(
            lag_of(tmp_path, "2.0", ""), inputs=csv(tmp_path, "time,u\n6,0\n9,0\n"), start=5, stop=9, step=1
        )
