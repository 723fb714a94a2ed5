"""Conditions of scenarios: from a study file to what the plant was given, and all that can be wrong."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fmus.builder import Fault
from studies import cases_in, run_file, write

from ddpc_cosim import CaseResult, Conditions, ConfigError, Constant, FMUPlant, Outcome, Trace
from ddpc_cosim.study.reading import read_study
from fmu_plants import build_fmu
from fmu_plants.quadruple_tank import MODEL

TANK = """
seeds = [3]
[plant]
name = "quadruple-tank"
inputs = ["pump_1"]
outputs = ["level_1"]
measurements = ["level_1", "level_2"]
[loop]
sampling_time = 5.0
duration = 100.0
[reference]
level_1 = { kind = "steps", times = [0.0, 20.0], values = [12.3, 13.3] }
[recording]
samples = 60
excitation.pump_1 = { low = 2.5, high = 3.5 }
[controllers.mfac]
type = "mfac"
[scenarios.calm]
"""
HARD = """
[scenarios.hard]
noise = { level_2 = 0.02 }
disturbances.pump_1 = { kind = "steps", times = [30.0], values = [500.0], unit = "mV" }
disturbances.level_1 = [{ kind = "constant", value = 0.5 }, { kind = "noise", standard_deviation = 0.1 }]
inputs.pump_2 = { kind = "file", file = "pump.csv", column = "p", interpolation = "linear" }
delay = { pump_1 = 10.0, level_1 = 5.0 }
rate_limit = { pump_1 = 0.01 }
quantum = { level_2 = 0.25 }
loss = { level_1 = 0.3 }
"""
TIME = 5.0 * np.arange(21)


def study_file(folder: Path, text: str) -> str:
    (folder / "pump.csv").write_text("time [min],p [mV]\n0,3000\n1,2400\n2,3400\n", encoding="utf-8")
    return str(write(folder, text))


def results_of(folder: Path, text: str) -> dict[str, CaseResult]:
    return {case.scenario: case for case in run_file(study_file(folder, text)).cases}


@pytest.fixture(scope="module")
def hard(tmp_path_factory: pytest.TempPathFactory) -> Trace:
    return results_of(tmp_path_factory.mktemp("hard"), TANK + HARD)["hard"].trace()


def test_a_case_keeps_what_the_plant_was_given(hard: Trace) -> None:
    assert [variable.name for variable in hard.changed_inputs] == ["pump_1", "pump_2"]
    assert [variable.name for variable in hard.inputs] == ["pump_1"]
    position, moved = 3.0, []
    for asked in hard.u[:, 0]:
        position += np.clip(asked - position, -0.05, 0.05)
        moved.append(position)
    late = np.array([3.0, 3.0, *moved[:-2]]) + np.where(TIME < 30.0, 0.0, 0.5)
    assert np.allclose(hard.applied[:, 0], late, atol=1e-12)
    assert np.allclose(hard.applied[:, 1], np.interp(TIME, [0.0, 60.0, 120.0], [3.0, 2.4, 3.4]))


def test_an_fmu_given_the_same_ends_where_the_case_did(hard: Trace) -> None:
    with FMUPlant(build_fmu(MODEL), inputs=["pump_1", "pump_2"], outputs=["level_1", "level_2"]) as plant:
        plant.plan(5.0, 100.0)
        levels = [plant.reset()]
        levels += [plant.step(applied, 5.0) for applied in hard.applied[:-1]]
    disturbance = hard.y[:, 0] - np.array(levels)[:, 0]
    assert disturbance.mean() == pytest.approx(0.5, abs=0.1)
    assert disturbance.std() == pytest.approx(0.1, rel=0.5)
    seen = hard.measured[:, 1]
    assert np.allclose(seen / 0.25, np.round(seen / 0.25), atol=1e-9)
    assert np.abs(seen - np.array(levels)[:, 1]).max() < 0.125 + 5 * 0.02
    arrived = ~np.isnan(hard.measured[:, 0])
    late = np.concatenate([hard.y[:1, 0], hard.y[:-1, 0]])
    assert np.array_equal(hard.measured[arrived, 0], late[arrived])
    assert 0 < np.count_nonzero(~arrived) == hard.failures


def test_a_case_without_conditions_has_no_further_columns(tmp_path: Path) -> None:
    calm = results_of(tmp_path, TANK)["calm"].trace()
    assert calm.changed_inputs == ()
    assert not [name for name in calm.columns() if name.startswith("applied")]
    assert calm.completed


def conditions_of(folder: Path, text: str) -> Conditions:
    resolved = read_study(study_file(folder, text)).problem
    return resolved.conditions[list(resolved.study.scenarios)[-1]]


REACTOR = """
plant = { name = "cstr", outputs = ["temperature"] }
loop = { sampling_time = 5.0, duration = 100.0 }
reference.temperature = { kind = "constant", value = 320.0 }
[controllers.mfac]
type = "mfac"
[scenarios.warm]
"""


@pytest.mark.parametrize(
    ("signal", "values"),
    [
        ('{ kind = "constant", value = 5.0, unit = "degC" }', [5.0, 5.0]),
        ('{ kind = "steps", times = [7.0], values = [5.0], unit = "degC" }', [5.0, 5.0]),
        (
            '{ kind = "ramp", from_value = 0, to_value = 9, from_time = 0, to_time = 5, unit = "degF" }',
            [0.0, 5.0],
        ),
        ('{ kind = "sine", amplitude = 5.0, frequency = 0.05, offset = 5.0, unit = "degC" }', [5.0, 10.0]),
        ('{ kind = "file", file = "air.csv", column = "air" }', [-5.0, 5.0]),
        ('{ kind = "noise", standard_deviation = 0.0, mean = 5.0, unit = "degC" }', [5.0, 5.0]),
    ],
)  # fmt: skip
def test_what_is_added_converts_without_the_offset_of_its_unit(
    tmp_path: Path, signal: str, values: list[float]
) -> None:
    """Five degrees Celsius more are five kelvin more, and not 278 K."""
    (tmp_path / "air.csv").write_text("time,air [degC]\n0,-5\n5,5\n", encoding="utf-8")
    conditions = conditions_of(tmp_path, f"{REACTOR}disturbances.coolant_temperature = {signal}")
    (part,) = conditions.disturbances["coolant_temperature"]  # type: ignore[misc]
    assert part.at(np.array([0.0, 5.0])) == pytest.approx(values, abs=1e-9)


def test_cases_of_scenarios_differ_by_their_conditions_alone(tmp_path: Path) -> None:
    calm, hard = cases_in(study_file(tmp_path, TANK + HARD))
    assert calm.conditions == Conditions()
    assert calm.id.split("_")[-1] != hard.id.split("_")[-1]
    text = (TANK + HARD).replace("loss = { level_1 = 0.3 }", "loss = { level_1 = 0.4 }")
    again = cases_in(study_file(tmp_path, text))
    assert [case.id == old.id for case, old in zip(again, (calm, hard), strict=True)] == [True, False]


def test_limits_of_a_scenario_come_before_all_others(tmp_path: Path) -> None:
    """A side left out is the plant's."""
    limits = "bounds.pump_1 = { min = 1.0, max = 9.0 }\n[scenarios.calm]"
    tight = "[scenarios.tight]\nbounds.pump_1 = { max = 2900, unit = 'mV' }\n"
    results = results_of(tmp_path, TANK.replace("[scenarios.calm]", limits) + tight)
    runs = [results[name].trace() for name in ("calm", "tight")]
    assert [(run.bounds.u_min.tolist(), run.bounds.u_max.tolist()) for run in runs] == [
        ([1.0], [9.0]),
        ([0.0], [2.9]),
    ]
    assert np.array_equal(runs[0].bounds.y_max, runs[1].bounds.y_max)
    assert runs[1].u.max() <= 2.9 < runs[0].u.max()


def faults_of(folder: Path, scenario: str, **changes: str) -> list[str]:
    text = TANK
    for old, new in changes.items():
        text = text.replace(old, new)
    with pytest.raises(ConfigError) as error:
        read_study(study_file(folder, f"{text}[scenarios.x]\n{scenario}"))
    return [fault.partition(": ")[2].removeprefix("scenarios.x.") for fault in error.value.faults]


@pytest.mark.parametrize(
    ("scenario", "fault"),
    [
        (
            'disturbances.pump_11 = { kind = "constant", value = 1.0 }',
            'disturbances: no input or output "pump_11"; did you mean "pump_1"?',
        ),
        (
            'disturbances.level_1 = { kind = "steps", times = [0.0, 100.0], values = [0.0, 1.0] }',
            "disturbances.level_1[0].times: at t = 100 s it would not happen: the run ends at t = 100 s; "
            "choose an earlier time or a longer duration",
        ),
        (
            'disturbances.level_1 = { kind = "ramp", from_value = 0.0, to_value = 1.0, from_time = 200.0, '
            "to_time = 300.0 }",
            "disturbances.level_1[0].from_time: at t = 200 s it would not happen: the run ends at t = 100 s; "
            "choose an earlier time or a longer duration",
        ),
        (
            'disturbances.level_1 = [{ kind = "noise", standard_deviation = -0.1 }]',
            "disturbances.level_1[0].standard_deviation: must be greater than or equal to 0, got -0.1",
        ),
        ("disturbances.level_1 = []", "disturbances.level_1: must not be empty"),
        (
            'disturbances.level_1 = { kind = "constant", value = nan }',
            "disturbances.level_1[0].value: must be a finite number, got nan",
        ),
        (
            'disturbances.level_1 = { kind = "constant", value = 1.0, unit = "K" }',
            'disturbances.level_1[0].unit: unit "K" does not fit level_1; allowed: cm',
        ),
        (
            'inputs.pump_3 = { kind = "constant", value = 1.0 }',
            'inputs: no input that no controller drives "pump_3"; did you mean "pump_2"?',
        ),
        (
            'inputs.pump_1 = { kind = "constant", value = 1.0 }',
            "inputs.pump_1: the controllers drive this input; use disturbances to add to it, or leave it out "
            "of plant.inputs",
        ),
        (
            'inputs.pump_2 = { kind = "file", file = "pomp.csv" }',
            "inputs.pump_2.file: FOLDER/pomp.csv: no such file",
        ),
        (
            'inputs.pump_2 = { kind = "sinus" }',
            "inputs.pump_2: must be one of 'constant', 'steps', 'interpolated', 'ramp', 'sine', 'file', "
            "'resource', 'noise', 'random', 'sum', 'product', got 'sinus'; did you mean \"sine\"?",
        ),
        (
            "delay = { level_1 = 6.0 }",
            "delay.level_1: 6 s is not an integer multiple of the sampling time of 5 s; nearest: 5 or 10 s",
        ),
        (
            "delay = { level_1 = 100.0 }",
            "delay.level_1: 100 s is too long: the run ends after 100 s; choose a shorter delay",
        ),
        ("delay = { pump_1 = -5.0 }", "delay.pump_1: must be greater than or equal to 0, got -5.0"),
        ("delay = { pump_2 = 5.0 }", 'delay: no input or measurement "pump_2"; did you mean "pump_1"?'),
        ("rate_limit = { pump_1 = 0.0 }", "rate_limit.pump_1: must be greater than 0, got 0.0"),
        ("rate_limit = { pump_1 = inf }", "rate_limit.pump_1: must be a finite number, got inf"),
        (
            "rate_limit = { level_1 = 1.0 }",
            'rate_limit: no input that the controllers drive "level_1"; there are: pump_1',
        ),
        ("quantum = { level_2 = -1 }", "quantum.level_2: must be greater than 0, got -1"),
        ("loss = { level_2 = 1.01 }", "loss.level_2: must be less than or equal to 1, got 1.01"),
        ("loss = { level_3 = 0.1 }", 'loss: no measurement "level_3"; did you mean "level_2"?'),
        ("quantun = { level_2 = 1.0 }", 'quantun: unknown key; did you mean "quantum"?'),
    ],
)  # fmt: skip
def test_a_fault_is_told_with_its_key(tmp_path: Path, scenario: str, fault: str) -> None:
    assert faults_of(tmp_path, scenario) == [fault.replace("FOLDER", str(tmp_path))]


def test_a_delay_leaves_something_to_record(tmp_path: Path) -> None:
    """Of 9 samples 5 s apart the last is at 40 s: what is late by as much is not in the recording."""
    for delay in (50, 40):
        (fault,) = faults_of(tmp_path, f"delay = {{ pump_1 = {delay}.0 }}", **{"samples = 60": "samples = 9"})
        assert fault == (
            f"delay.pump_1: {delay} s is too long: the experiment ends after 40 s; choose a shorter delay"
        )
    text = TANK.replace("samples = 60", "samples = 9")
    assert read_study(study_file(tmp_path, f"{text}[scenarios.x]\ndelay = {{ pump_1 = 35.0 }}")).problem


def test_a_delay_leaves_something_to_record_in_the_scenario_s_own_experiment(tmp_path: Path) -> None:
    (fault,) = faults_of(tmp_path, "recording.samples = 9\ndelay = { pump_1 = 50.0 }")
    assert fault == "delay.pump_1: 50 s is too long: the experiment ends after 40 s; choose a shorter delay"


def test_all_faults_are_told_at_once_each_with_its_line(tmp_path: Path) -> None:
    faults = faults_of(
        tmp_path,
        """
        delay = { level_1 = 7.0 }
        bounds.level_1 = { min = 3.0, max = 2.0 }
        bounds.valve = { min = 3.0 }
        loss = { level_2 = 2.0 }
        disturbances.pump_1 = { kind = "constant", value = 1.0, unit = "s" }
        inputs.pump_1 = { kind = "constant", value = 1.0 }
        rate_limit = { pump_3 = 1.0 }
        """,
    )
    assert [fault.partition(":")[0] for fault in faults] == [
        "delay.level_1",
        "bounds.level_1",
        "bounds",
        "loss.level_2",
        "disturbances.pump_1[0].unit",
        "inputs.pump_1",
        "rate_limit",
    ]


@pytest.mark.parametrize(
    ("elsewhere", "who"),
    [
        ("parameters = { pump_2 = 1.0 }", "the scenario's parameters"),
        ("events = [{ time = 1.0, parameters = { pump_2 = 1.0 } }]", "an event"),
        (
            'drifts = [{ parameter = "pump_2", from_value = 0.0, to_value = 1.0, '
            "from_time = 0.0, to_time = 5.0 }]",
            "a drift",
        ),
    ],
)  # fmt: skip
def test_an_input_has_its_value_from_one_place(tmp_path: Path, elsewhere: str, who: str) -> None:
    fault = f"inputs.pump_2: this input is set by {who} too; leave one of them out"
    tank = {'name = "quadruple-tank"': f"fmu = {str(build_fmu(MODEL))!r}"}
    signal = 'inputs.pump_2 = { kind = "constant", value = 2.0 }'
    assert faults_of(tmp_path, f"{elsewhere}\n{signal}", **tank) == [fault]


def test_a_supplied_fmu_too_has_inputs_with_signals_of_their_own(tmp_path: Path) -> None:
    """A constant does the same as a parameter; in a scenario without either the input rests at its start."""
    text = (
        TANK.replace('name = "quadruple-tank"', f"fmu = {str(build_fmu(MODEL))!r}")
        + """
    [scenarios.signal]
    inputs.pump_2 = { kind = "constant", value = 2.4 }
    [scenarios.parameter]
    parameters = { pump_2 = 2.4 }
    """
    )
    traces = {name: case.trace() for name, case in results_of(tmp_path, text).items()}
    assert traces["signal"].completed
    assert np.allclose(traces["signal"].y, traces["parameter"].y, atol=1e-9)
    assert np.all(traces["signal"].applied == 2.4)
    assert np.abs(traces["signal"].y - traces["calm"].y).max() > 0.1


def test_what_was_given_to_an_fmu_before_it_crashed_is_kept(write_study: Callable[..., Path]) -> None:
    gust = {"disturbances": {"u": {"kind": "constant", "value": 0.25}}}
    path = write_study("mfac", fault=Fault.SEGMENTATION_FAULT, scenarios={"gust": gust})
    (case,) = run_file(path).cases
    trace = case.trace()
    assert trace.outcome is Outcome.CRASHED
    assert len(trace) > 3
    assert np.array_equal(trace.applied, trace.u + 0.25)


def test_a_plant_in_python_has_inputs_with_signals_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the order of its inputs."""
    plant = """
import numpy as np
from ddpc_cosim import Plant, Variable

class Room(Plant):
    def __init__(self):
        self.inputs = (Variable("outside", unit="degC", start=9.0), Variable("heating"))
        self.outputs = (Variable("inside"),)
    def reset(self, parameters=None, t0=0.0):
        self.inside = np.array([20.0])
        return self.inside.copy()
    def step(self, u, h):
        self.inside = 0.9 * self.inside + 0.1 * u[0] + u[1]
        return self.inside.copy()
"""
    (tmp_path / "room_of_scenarios.py").write_text(plant, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    trace = results_of(
        tmp_path,
        """
        plant = { name = "room_of_scenarios:Room", inputs = ["heating"] }
        loop = { sampling_time = 1.0, duration = 10.0 }
        reference.inside = { kind = "constant", value = 21.0 }
        controllers.mfac = { type = "mfac" }
        scenarios.frost.inputs.outside = { kind = "steps", times = [0.0, 5.0], values = [5.0, -5.0] }
        """,
    )["frost"].trace()
    outside = np.where(np.arange(11) < 5, 5.0, -5.0)
    assert trace.completed
    inside = 0.9 * trace.y[:-1, 0] + 0.1 * outside[:-1] + trace.u[:-1, 0]
    assert np.allclose(trace.y[1:, 0], inside)


RECORDED = "excitation.pump_1 = { low = 2.5, high = 3.5 }\n"


def test_an_input_that_no_controller_drives_has_its_own_signal_in_the_recording(tmp_path: Path) -> None:
    """The study's, in place of each scenario's; a scenario's own comes before it; without one it rests."""
    recorded = 'inputs.pump_2 = { kind = "constant", value = 2000.0, unit = "mV" }\n'
    text = (
        TANK.replace(RECORDED, RECORDED + recorded)
        + """
[scenarios.load]
inputs.pump_2 = { kind = "constant", value = 3.5 }
[scenarios.other]
recording.inputs.pump_2 = { kind = "constant", value = 2.5 }
"""
    )
    problem = read_study(study_file(tmp_path, text)).problem
    resting, own_signal = {"pump_2": Constant(3.0)}, {"pump_2": Constant(2.0)}
    assert problem.conditions["calm"] == Conditions(inputs=resting, recorded_inputs=own_signal)
    assert problem.conditions["load"].inputs == {"pump_2": Constant(3.5)}
    assert problem.conditions["other"].recorded_inputs == {"pump_2": Constant(2.5)}
    assert [variable.name for variable in problem.undriven["calm"]] == ["pump_2"]
    given = {name: case.trace().applied[:, 0] for name, case in results_of(tmp_path, text).items()}
    assert {name: set(values) for name, values in given.items()} == {
        "calm": {3.0}, "load": {3.5}, "other": {3.0}
    }  # fmt: skip


@pytest.mark.parametrize(
    ("recorded", "fault"),
    [
        ('inputs.pump_1 = { kind = "constant", value = 2.0 }', 'no input that no controller drives "pump_1"'),
        ('inputs.pump_3 = { kind = "constant", value = 2.0 }', 'no input that no controller drives "pump_3"'),
        ('inputs.pump_2 = { kind = "constant", value = 2.0, unit = "K" }', "pump_2.unit"),
    ],
)
def test_signals_of_the_recording_are_checked(tmp_path: Path, recorded: str, fault: str) -> None:
    text = TANK.replace(RECORDED, f"{RECORDED}{recorded}\n")
    with pytest.raises(ConfigError, match=rf"(?s)recording\.inputs.*{fault}"):
        read_study(study_file(tmp_path, text))


YEAR = """
plant = { name = "building", inputs = ["heating_power"], outputs = ["indoor_temperature"] }
loop = { sampling_time = "1 h", duration = "6 h", start_time = "day 3", warm_up = "2 h" }
reference.indoor_temperature = { kind = "constant", value = 20.0, unit = "degC" }
recording = { samples = 48, excitation.heating_power = { low = 1000.0, high = 6000.0 } }
controllers.mfapc.type = "mfapc"
controllers.deepc = { type = "deepc", settings = { initial_length = 2, horizon = 4 } }

[disturbances.outdoor_temperature]
known = "perfect"
signal = { kind = "steps", times = [0.0, 864000.0], values = [5.0, -5.0], unit = "degC" }

[disturbances.solar_irradiance]
signal = { kind = "constant", value = 0.0 }

[scenarios.mild]
[scenarios.cold]
start_time = "day 23"
"""


def test_a_scenario_begins_at_another_time_with_its_experiment_and_its_weather(tmp_path: Path) -> None:
    cases = {case.name: case for case in cases_in(write(tmp_path, YEAR))}
    mild, cold = cases["mfapc_mild_seed0"], cases["mfapc_cold_seed0"]
    assert (mild.start_time, cold.start_time) == (2 * 86_400.0, 22 * 86_400.0)
    assert (mild.recording_start, cold.recording_start) == (0.0, 20 * 86_400.0)
    frame = run_file(tmp_path / "study.toml").frame()
    assert set(frame["outcome"]) == {"completed"}
    results = run_file(tmp_path / "study.toml")
    for scenario, begin, outdoors in (("mild", 2, 278.15), ("cold", 22, 268.15)):
        trace = results.trace("mfapc", scenario=scenario)
        np.testing.assert_array_equal(trace.time, begin * 86_400.0 + np.arange(7) * 3600.0)
        np.testing.assert_allclose(trace.d[:, 0], outdoors)


def test_ids_know_of_a_start_only_where_it_differs(tmp_path: Path) -> None:
    said = YEAR.replace("[scenarios.mild]", '[scenarios.mild]\nstart_time = "day 3"')
    ids = [{case.name: case.id for case in cases_in(write(tmp_path, text))} for text in (YEAR, said)]
    assert ids[0] == ids[1]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('start_time = "day 23"', "start_time = inf", "scenarios.cold.start_time: must be a finite number"),
        ('start_time = "day 23"', "start_time = 1e18", "samples 3600 s apart coincide there"),
        ('start_time = "day 3", warm_up = "2 h"', 'start = "recording-end"', "leave one of them out"),
        ('start_time = "day 23"', 'start_time = "day 23"\nevents = [{ time = 100.0, parameters = {} }]', ""),
        (
            'start_time = "day 23"',
            'start_time = "day 23"\nevents = [{ time = "30 d", parameters = { window_area = 5.0 } }]',
            "scenarios.cold.events[0].time",
        ),
    ],
)
def test_what_does_not_go_with_a_start_is_told(tmp_path: Path, old: str, new: str, told: str) -> None:
    path = write(tmp_path, YEAR.replace(old, new))
    if not told:
        read_study(str(path))
        return
    with pytest.raises(ConfigError) as error:
        read_study(str(path))
    assert any(told in fault for fault in error.value.faults), error.value.faults
