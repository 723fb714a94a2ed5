"""Inputs that override a plant's own control: found, switched on by who drives them, else left to it."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmus import builder
from fmus.builder import V
from studies import cases_in, run_file, study_text, write

from ddpc_cosim import (
    Conditions,
    ConfigError,
    Constant,
    Controller,
    FloatArray,
    FMUPlant,
    Loop,
    ParameterValue,
    Plant,
    PlantControl,
    Price,
    Problem,
    Sample,
    SignalExcitation,
    Study,
    Variable,
    cosimulate,
    record,
    simulate,
)
from ddpc_cosim.description import describe
from ddpc_cosim.inspection import as_data, inspect_fmu
from ddpc_cosim.study.case_runs import run_case
from ddpc_cosim.study.cases import doing_nothing
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.results import report_writer
from ddpc_cosim.suggestion import suggest_study
from fmu_plants import Equations, Parameter, PlantModel, Symbols, build_fmu

LOSS, GAIN, SETPOINT, OUTSIDE, CAPACITY = 100.0, 400.0, 294.15, 273.15, 4e5


def _room(v: Symbols) -> Equations:
    own = v.gain * (v.setpoint - v.reaTZon_y)
    heat = v.oveHeat_activate * v.oveHeat_u + (1 - v.oveHeat_activate) * own
    return Equations({"reaTZon_y": (LOSS * (v.TDryBul - v.reaTZon_y) + heat) / CAPACITY}, {"reaPHea_y": heat})


ZONE = Variable("reaTZon_y", "K", 250.0, 350.0, nominal=10.0, start=290.15, description="Zone temperature")
ROOM = PlantModel(
    name="room",
    equations=_room,
    states=(ZONE,),
    inputs=(
        Variable("oveHeat_u", "W", 0.0, 8000.0, nominal=1000.0, description="Heater power"),
        Variable("oveHeat_activate", "1", 0.0, 1.0, description="Activation for Heater power"),
        Variable("TDryBul", "K", 200.0, 400.0, start=OUTSIDE),
    ),
    outputs=(ZONE, Variable("reaPHea_y", "W", nominal=1000.0)),
    parameters=(Parameter("gain", "W/K", start=GAIN), Parameter("setpoint", "K", start=SETPOINT)),
    step_size=60.0,
    stop_time=3600.0,
)
H, SAMPLES = 600.0, 6


def controlled_by_itself(time: FloatArray) -> FloatArray:
    """Return the zone's temperature under the room's own control: the solution of its equation."""
    end = (LOSS * OUTSIDE + GAIN * SETPOINT) / (LOSS + GAIN)
    return end + (ZONE.start - end) * np.exp(-(LOSS + GAIN) / CAPACITY * time)


def heated(time: FloatArray, power: float) -> FloatArray:
    """Return the zone's temperature with a constant power of the heater."""
    end = OUTSIDE + power / LOSS
    return end + (ZONE.start - end) * np.exp(-LOSS / CAPACITY * time)


class Heats(Controller):
    """Drives 1 kW."""

    def start(self, loop: Loop) -> None:
        assert [variable.name for variable in loop.inputs] == ["oveHeat_u"]

    def step(self, sample: Sample) -> FloatArray:
        return np.array([1000.0])


@pytest.fixture(scope="module")
def room() -> Path:
    return build_fmu(ROOM)


def loop_of(plant: Plant, controller: Controller, **others: Any) -> Any:
    options = {"sampling_time": H, "duration": SAMPLES * H, "reference": Constant(SETPOINT)} | others
    return cosimulate(plant, controller, outputs=["reaTZon_y"], **options)


def test_who_drives_an_override_switches_it_on(room: Path) -> None:
    with FMUPlant(room, inputs=["oveHeat_u"], outputs=["reaTZon_y"]) as plant:
        trace = loop_of(plant, Heats())
    assert trace.completed
    np.testing.assert_allclose(trace.y[:, 0], heated(trace.time, 1000.0), rtol=1e-6)


def test_who_does_not_leaves_it_to_the_plant(room: Path) -> None:
    with FMUPlant(room, inputs=["oveHeat_u"], outputs=["reaTZon_y"]) as plant:
        trace = loop_of(plant, PlantControl())
        after = loop_of(plant, Heats())
    assert trace.completed
    np.testing.assert_allclose(trace.y[:, 0], controlled_by_itself(trace.time), rtol=1e-6)
    assert np.isnan(trace.u).all()
    assert (trace.held, trace.failures) == (SAMPLES, 0)
    np.testing.assert_allclose(after.y[:, 0], heated(after.time, 1000.0), rtol=1e-6)


def room_study(**others: Any) -> str:
    options: dict[str, Any] = {
        "plant": {"name": f"{__name__}:ROOM", "inputs": ["oveHeat_u"], "outputs": ["reaTZon_y"]},
        "reference": {"reaTZon_y": SETPOINT},
        "controllers": {"own": "plant", "pid": {"type": "pid", "settings": {"proportional": 400.0}}},
        "loop": {"sampling_time": H, "duration": SAMPLES * H},
    }
    return study_text(**{**options, **others})


def test_the_plants_own_control_competes_and_is_what_doing_nothing_means(tmp_path: Path) -> None:
    results = run_file(study := write(tmp_path, room_study()))
    own, pid = (case.trace() for case in results.cases)
    assert {case.outcome for case in results.cases} == {"completed"}
    np.testing.assert_allclose(own.y[:, 0], controlled_by_itself(own.time), rtol=1e-6)
    assert np.isnan(own.u).all()
    assert pid.u[0, 0] == pytest.approx(400.0 * (SETPOINT - ZONE.start))
    figures = results.cases[0].metrics
    of_input = {key: value for key, value in figures.items() if ".oveHeat_u" in key}
    assert of_input.keys() > {"total_variation.oveHeat_u [W]", "time_at_bounds.oveHeat_u [s]"}
    assert all(math.isnan(value) for value in of_input.values())
    (nothing,) = [case for case in doing_nothing(cases_in(study)) if case.seed == 0]
    assert nothing.section["type"] == "plant"
    assert results.resting[0].is_own_control
    results.report()


def test_to_be_worse_than_the_plants_own_control_is_no_failure(tmp_path: Path) -> None:
    """What ends a third of its task away where the own control ends at 1 %; what heats nothing fails."""
    plant = {"name": f"{__name__}:ROOM", "inputs": ["oveHeat_u"], "outputs": ["reaTZon_y"]}
    lazy = {"type": "pid", "settings": {"proportional": 1500.0}}
    controllers = {"lazy": lazy, "idle": "idle"}
    study = room_study(
        plant=plant | {"parameters": {"gain": 5e4}},
        controllers=controllers,
        bounds={"oveHeat_u": {"max": 8000.0}},
    )
    results = run_file(write(tmp_path, study))
    lazy_run, idle_run = results.cases
    (own,) = results.resting
    assert not lazy_run.failed
    assert idle_run.failure.endswith("its task away from its reference")
    errors = [case.tracking[0].mean_abs_error for case in (lazy_run, own)]
    assert errors[0] - errors[1] > 0.05 * lazy_run.tasks["reaTZon_y"]


VERSIONS = ("1.0", "2.0", "3.0")


def overridden_fmu(folder: Path, version: str) -> Path:
    """Write an FMU with the output 2 * oveHeat_u * oveHeat_activate, a boolean that starts as true."""
    variables = (
        V("oveHeat_u", 0, causality="input", start="0"),
        V("oveHeat_activate", 13, "Boolean", "input", "discrete", "true"),
        V("power", 12, causality="output"),
        V("gain", 6, causality="parameter", variability="tunable", start="1"),
        V("count", 5, "Integer", causality="parameter", variability="fixed", start="2"),
    )
    text = builder.describe(
        version, "integrator", builder.with_time(version, variables), interfaces=builder.CO_SIMULATION
    )
    return builder.write_fmu(folder / f"over{version[0]}.fmu", text, builder.model_library(version))


@pytest.mark.parametrize("version", VERSIONS)
def test_a_boolean_switch_of_any_fmi_version_is_switched(tmp_path: Path, version: str) -> None:
    fmu = overridden_fmu(tmp_path, version)
    assert inspect_fmu(fmu).switches == {"oveHeat_u": "oveHeat_activate"}
    loop: dict[str, Any] = {"sampling_time": 0.1, "duration": 0.5, "reference": Constant(0.0)}
    with FMUPlant(fmu, inputs=["oveHeat_u"], outputs=["power"]) as plant:
        driven, own = (cosimulate(plant, c, **loop) for c in (Heats(), PlantControl()))
        switched_off = FMUPlant(fmu, inputs=["oveHeat_u"], outputs=["power"], switches={"oveHeat_u": ""})
        with switched_off as without:
            unswitched = cosimulate(without, Heats(), **loop)
    assert driven.y[1:, 0].tolist() == [2000.0] * 5
    assert own.y[:, 0].tolist() == [0.0] * 6
    assert unswitched.y[:, 0].tolist() == driven.y[:, 0].tolist()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_switch_is_an_input_like_others_in_open_loop(tmp_path: Path, version: str) -> None:
    fmu = overridden_fmu(tmp_path, version)
    table = tmp_path / "inputs.csv"
    table.write_text("time,oveHeat_u,oveHeat_activate\n0,3,0\n0.2,3,1\n0.4,3,1\n")
    given = simulate(fmu, inputs=table, step=0.1, stop=0.4)
    assert given["power [1]"].tolist()[1:] == [0.0, 0.0, 6.0, 6.0]
    table.write_text("time,oveHeat_u\n0,3\n0.4,3\n")
    assert simulate(fmu, inputs=table, step=0.1, stop=0.4)["power [1]"].tolist() == [6.0] * 5


PAIRS: list[tuple[dict[str, Any], dict[str, Any], bool]] = [
    ({}, {"min": 0.0, "max": 1.0}, True),
    ({}, {"description": "Activation for the heater"}, True),
    ({}, {"description": "1: the input overrides the controller"}, True),
    ({}, {}, False),
    ({}, {"min": 0.0, "max": 100.0, "description": "Activation level"}, False),
    ({}, {"description": "Heater of the second zone"}, False),
]


@pytest.mark.parametrize(("driven", "switch", "expected"), PAIRS)
def test_a_name_alone_makes_no_actuator(
    driven: dict[str, Any], switch: dict[str, Any], expected: bool
) -> None:
    inputs = [Variable("a_u", **driven), Variable("a_activate", **switch), Variable("b_activate", max=1.0)]
    description = describe(inputs, [Variable("y")])
    assert description.switches == ({"a_u": "a_activate"} if expected else {})
    assert description.default_inputs == (("a_u", "b_activate") if expected else ())


def test_the_inputs_of_a_study_leave_switches_out_by_default(tmp_path: Path) -> None:
    text = room_study(
        plant={"name": f"{__name__}:ROOM", "outputs": ["reaTZon_y"]},
        controllers={"own": "plant"},
    )
    (case,) = cases_in(write(tmp_path, text))
    assert [variable.name for variable in case.inputs] == ["oveHeat_u", "TDryBul"]


FAULTY: list[tuple[dict[str, Any], str]] = [
    ({"inputs": ["oveHeat_activate"]}, "plant.inputs"),
    ({"inputs": ["oveHeat_u", "oveHeat_activate"]}, "plant.inputs"),
    ({"switches": {"oveHeat_u": "oveHeat_activat"}}, "plant.switches.oveHeat_u"),
    ({"switches": {"oveHeat": "oveHeat_activate"}}, "plant.switches.oveHeat"),
    ({"switches": {"oveHeat_u": "oveHeat_u"}}, "plant.switches.oveHeat_u"),
    ({"start": {"oveHeat_activate": 0.0}}, "plant.start.oveHeat_activate"),
    ({"parameters": {"oveHeat_activate": 0}}, "plant.parameters.oveHeat_activate"),
    ({"inputs": ["TDryBul"]}, "controllers.own.type"),
    ({"switches": {"oveHeat_u": ""}}, "controllers.own.type"),
]


@pytest.mark.parametrize(("plant", "place"), FAULTY)
def test_what_contradicts_a_switch_is_told_with_its_place(
    tmp_path: Path, room: Path, plant: dict[str, Any], place: str
) -> None:
    plant = {"fmu": str(room), "inputs": ["oveHeat_u"], "outputs": ["reaTZon_y"]} | plant
    with pytest.raises(ConfigError) as error:
        read_study(str(write(tmp_path, room_study(plant=plant))))
    assert [fault for fault in error.value.faults if place in fault], str(error.value)


def test_a_pair_may_be_said_and_may_be_denied(tmp_path: Path) -> None:
    switches = {"oveHeat_u": "TDryBul"}
    plant = {"name": f"{__name__}:ROOM", "outputs": ["reaTZon_y"], "switches": switches}
    said = cases_in(write(tmp_path, room_study(plant=plant, controllers={"own": "plant"})))[0]
    assert said.plant.switches == switches
    assert [variable.name for variable in said.inputs] == ["oveHeat_u", "oveHeat_activate"]
    denied = room_study(plant=plant | {"switches": {"oveHeat_u": ""}}, controllers={"idle": "idle"})
    case = cases_in(write(tmp_path, denied))[0]
    assert len(case.inputs) == 3
    assert doing_nothing([case])[0].section["type"] == "idle"


def test_the_experiment_drives_what_it_excites(room: Path) -> None:
    excitation = SignalExcitation([Constant(1000.0)], SAMPLES, H)
    with FMUPlant(room, inputs=["oveHeat_u"], outputs=["reaTZon_y"]) as plant:
        recording = record(plant, excitation, sampling_time=H)
        trace = loop_of(plant, PlantControl(), excitation=excitation, continue_recording=True)
    time = np.arange(SAMPLES) * H
    np.testing.assert_allclose(recording.y[:, 0], heated(time, 1000.0), rtol=1e-6)
    end = (LOSS * OUTSIDE + GAIN * SETPOINT) / (LOSS + GAIN)
    first = heated(np.array([SAMPLES * H]), 1000.0)[0]
    expected = end + (first - end) * np.exp(-(LOSS + GAIN) / CAPACITY * trace.time)
    np.testing.assert_allclose(trace.y[:, 0], expected, rtol=1e-6)


def test_a_warm_up_is_the_plants_own_unless_it_has_a_controller(room: Path) -> None:
    warm = 3 * H
    with FMUPlant(room, inputs=["oveHeat_u"], outputs=["reaTZon_y"]) as plant:
        trace = loop_of(plant, Heats(), warm_up=warm)
        own = loop_of(plant, PlantControl(), warm_up=warm, warm_up_controller=Heats())
    begin = controlled_by_itself(np.array([warm]))[0]
    end = OUTSIDE + 1000.0 / LOSS
    expected = end + (begin - end) * np.exp(-LOSS / CAPACITY * trace.time)
    np.testing.assert_allclose(trace.y[:, 0], expected, rtol=1e-6)
    begin, end = heated(np.array([warm]), 1000.0)[0], controlled_by_itself(np.array([1e9]))[0]
    expected = end + (begin - end) * np.exp(-(LOSS + GAIN) / CAPACITY * own.time)
    np.testing.assert_allclose(own.y[:, 0], expected, rtol=1e-6)


class TakesOver(Heats):
    """Keeps what it is told of the samples before."""

    def start(self, loop: Loop) -> None:
        super().start(loop)
        self.past = loop.past


@pytest.mark.parametrize("unit", ["W", "kW", None])
def test_a_past_under_the_plants_own_control_has_what_that_applied_or_is_none(unit: str | None) -> None:
    plant, warm = TellingRoom(unit), 4 * H
    controller = TakesOver()
    trace = loop_of(plant, controller, warm_up=warm)
    zone = euler(lambda y: GAIN * (SETPOINT - y))
    assert trace.y[0, 0] == pytest.approx(zone[4])
    if unit == "W":
        assert controller.past is not None
        assert controller.past.u[:, 0] == pytest.approx(GAIN * (SETPOINT - np.array(zone[:4])))
        assert controller.past.y[:, 0] == pytest.approx(zone[:4])
        assert trace.warnings == ()
    else:
        assert controller.past is None
        (warning,) = trace.warnings
        assert "not known what that applied of oveHeat_u (no measurement tells, as oveHeat_y in W" in warning
    # Who has driven it knows, and of the plant's own control that goes on no past is wanted.
    loop_of(plant, controller, warm_up=warm, warm_up_controller=Heats())
    assert controller.past is not None
    assert controller.past.u[:, 0].tolist() == [1000.0] * 4
    assert loop_of(plant, PlantControl(), warm_up=warm).warnings == ()


def test_of_what_is_lost_before_the_run_the_last_value_is_known(room: Path) -> None:
    controller, warm = TakesOver(), 30
    lossy = Conditions(loss={"reaTZon_y": 0.4})
    with FMUPlant(room, inputs=["oveHeat_u"], outputs=["reaTZon_y"]) as plant:
        trace = loop_of(
            plant,
            controller,
            warm_up=warm * H,
            duration=warm * H,
            warm_up_controller=Heats(),
            conditions=lossy,
        )
    assert trace.completed
    assert controller.past is not None
    there = heated(H * np.arange(warm), 1000.0)
    known = controller.past.y[:, 0]
    sources = np.abs(known[:, np.newaxis] - there).argmin(axis=1)
    assert known == pytest.approx(there[sources], rel=1e-6)
    arrived = sources == np.arange(warm)
    assert 0.2 < arrived.mean() < 0.9
    last = [max([j for j in range(k + 1) if arrived[j]], default=int(arrived.argmax())) for k in range(warm)]
    assert sources.tolist() == last
    np.testing.assert_array_equal(controller.past.measured, controller.past.y)


def test_what_a_plant_applies_is_only_known_where_it_is_measured() -> None:
    controller = TakesOver()
    loop_of(TellingRoom("W"), controller, warm_up=2 * H, measurements=["reaTZon_y"])
    assert controller.past is None


@pytest.mark.parametrize(("start", "early"), [(0.0, True), (12000.0, False)])
def test_a_supplied_fmu_that_begins_before_time_0_is_told(
    tmp_path: Path, room: Path, start: float, early: bool
) -> None:
    """What is inside it, such as weather, may not reach back so far; equations of one's own know no time."""
    plant = {"fmu": str(room), "inputs": ["oveHeat_u"], "outputs": ["reaTZon_y"]}
    options: dict[str, Any] = {
        "loop": {"sampling_time": H, "duration": SAMPLES * H, "warm_up": 3 * H, "start_time": start},
        "disturbances": {"TDryBul": {"signal": {"kind": "random", "low": 270.0, "high": 280.0, "hold": H}}},
        "recording": {"samples": 20, "excitation": {"oveHeat_u": {"low": 0.0, "high": 1000.0}}},
        "controllers": {
            "own": "plant",
            "spc": {"type": "spc", "settings": {"horizon": 2, "initial_length": 1}},
        },
    }
    for changes, by_itself in (({"plant": plant}, early), ({}, False)):
        own, spc = (run_case(case) for case in cases_in(write(tmp_path, room_study(**options, **changes))))
        of_times = [
            [text.partition(",")[0] for text in trace.warnings if "before 0" in text] for trace in (own, spc)
        ]
        warm, recorded = "the warm-up began at t = -30 min", "the experiment began at t = -3 h 20 min"
        assert of_times == ([[warm], [warm, recorded]] if by_itself else [[], []])
        if by_itself:
            assert spc.warnings[-1].endswith("set loop.start_time to 3 h 20 min or later")


def test_what_an_input_costs_is_not_known_of_the_plants_own_control(room: Path) -> None:
    prices = {
        "asked": Price(signal="oveHeat_u", price=0.25, unit="EUR/kWh"),
        "measured": Price(signal="reaPHea_y", price=0.25, unit="EUR/kWh"),
    }
    with FMUPlant(room, inputs=["oveHeat_u"], outputs=["reaTZon_y", "reaPHea_y"]) as plant:
        measurements = ["reaTZon_y", "reaPHea_y"]
        trace = loop_of(plant, PlantControl(), prices=prices, measurements=measurements)
    assert np.isnan(trace.charged[:, 0]).all()
    np.testing.assert_allclose(trace.charged[:, 1], GAIN * (SETPOINT - trace.y[:, 0]), rtol=1e-6)


def test_a_signal_of_an_override_acts_and_one_of_its_switch_decides(tmp_path: Path) -> None:
    constant = {"kind": "constant", "value": 1000.0}
    steps = {"kind": "steps", "times": [0.0, 3 * H], "values": [0.0, 1.0]}
    plant = {"name": f"{__name__}:ROOM", "inputs": ["TDryBul"], "outputs": ["reaTZon_y"]}
    scenarios = {
        "driven": {"inputs": {"oveHeat_u": constant}},
        "switched": {"inputs": {"oveHeat_u": constant, "oveHeat_activate": steps}},
        "left": {},
    }
    text = room_study(plant=plant, controllers={"idle": "idle"}, scenarios=scenarios)
    traces = {case.scenario: run_case(case) for case in cases_in(write(tmp_path, text))}
    time = traces["left"].time
    np.testing.assert_allclose(traces["driven"].y[:, 0], heated(time, 1000.0), rtol=1e-6)
    np.testing.assert_allclose(traces["left"].y[:, 0], controlled_by_itself(time), rtol=1e-6)
    np.testing.assert_allclose(traces["switched"].y[:4, 0], controlled_by_itself(time)[:4], rtol=1e-6)
    assert (traces["switched"].y[4:, 0] < controlled_by_itself(time)[4:] - 0.01).all()


class PythonRoom(Plant):
    """The room with an explicit Euler step."""

    inputs = ROOM.inputs
    outputs = (ZONE,)

    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        assert not parameters
        self.x = np.array([ZONE.start])
        return self.x.copy()

    def step(self, u: FloatArray, h: float) -> FloatArray:
        u_heat, activate, outside = u
        heat = activate * u_heat + (1.0 - activate) * GAIN * (SETPOINT - self.x[0])
        self.x = self.x + h * (LOSS * (outside - self.x) + heat) / CAPACITY
        return self.x.copy()


class TellingRoom(PythonRoom):
    """The same, and an output that tells the heat, in a unit; None: it does not."""

    def __init__(self, unit: str | None) -> None:
        self.switches = {"oveHeat_u": "oveHeat_activate"}
        self.inputs = ROOM.inputs[:1]
        self._tells = unit is not None
        self.outputs = (ZONE, *([Variable("oveHeat_y", unit)] if unit else []))

    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        self._activate = float((parameters or {})["oveHeat_activate"])
        super().reset()
        return self._seen(0.0)

    def set_parameters(self, parameters: Mapping[str, ParameterValue]) -> None:
        self._activate = float(parameters["oveHeat_activate"])

    def step(self, u: FloatArray, h: float) -> FloatArray:
        super().step(np.array([u[0], self._activate, OUTSIDE]), h)
        return self._seen(u[0])

    def _seen(self, u: float) -> FloatArray:
        own = GAIN * (SETPOINT - self.x[0])
        heat = u if self._activate else own
        return np.append(self.x, [heat] if self._tells else [])


def euler(step: Callable[[float], float]) -> list[float]:
    values = [ZONE.start]
    for _ in range(SAMPLES):
        values.append(values[-1] + H * (LOSS * (OUTSIDE - values[-1]) + step(values[-1])) / CAPACITY)
    return values


def test_a_python_class_has_overrides_too(tmp_path: Path) -> None:
    plant = {"name": f"{__name__}:PythonRoom", "inputs": ["oveHeat_u"], "outputs": ["reaTZon_y"]}
    controllers = {"own": "plant", "heats": f"{__name__}:Heats"}
    cases = cases_in(write(tmp_path, room_study(plant=plant, controllers=controllers)))
    own, heats = (run_case(case) for case in cases)
    assert own.y[:, 0] == pytest.approx(euler(lambda y: GAIN * (SETPOINT - y)))
    assert heats.y[:, 0] == pytest.approx(euler(lambda y: 1000.0))


@pytest.mark.parametrize("room", ["ROOM", "PythonRoom"])
def test_a_part_of_a_coupled_plant_has_overrides_too(tmp_path: Path, room: str) -> None:
    parts = [{"name": name, "plant": f"{__name__}:{room}"} for name in ("a", "b")]
    connections = [{"from": "a.reaTZon_y", "to": "b.TDryBul"}]
    plant = {
        "parts": parts,
        "connections": connections,
        "inputs": ["a.oveHeat_u", "b.oveHeat_u"],
        "outputs": ["a.reaTZon_y", "b.reaTZon_y"],
    }
    reference = {"a.reaTZon_y": SETPOINT, "b.reaTZon_y": SETPOINT}
    text = room_study(plant=plant, reference=reference, controllers={"own": "plant", "idle": "idle"})
    own, idle = (run_case(case) for case in cases_in(write(tmp_path, text)))
    assert own.completed
    if room == "ROOM":
        np.testing.assert_allclose(own.y[:, 0], controlled_by_itself(own.time), rtol=1e-6)
        np.testing.assert_allclose(idle.y[:, 0], heated(idle.time, 0.0), rtol=1e-6)
    else:
        assert own.y[:, 0] == pytest.approx(euler(lambda y: GAIN * (SETPOINT - y)))
        assert idle.y[:, 0] == pytest.approx(euler(lambda y: 0.0))
    assert (own.y[-1, 1] > idle.y[-1, 1]).all()


def test_without_a_switch_there_is_no_control_of_the_plants_own(room: Path) -> None:
    with (
        FMUPlant(room, inputs=["TDryBul"], outputs=["reaTZon_y"]) as plant,
        pytest.raises(ConfigError, match="has no control of its own"),
    ):
        loop_of(plant, PlantControl())
    with pytest.raises(ConfigError, match="override without its switch"):
        FMUPlant(room, inputs=["oveHeat_u"], switches={"oveHeat_u": "activate"})


def test_inspect_and_init_take_an_override_as_one_input(room: Path) -> None:
    inspected = as_data(inspect_fmu(room))["inputs"]
    assert {one["name"]: one["switch"] for one in inspected} == {
        "oveHeat_u": "oveHeat_activate",
        "oveHeat_activate": None,
        "TDryBul": None,
    }
    proposal = suggest_study(room, outputs=["reaTZon_y"], trial=False)
    assert proposal.study.plant.inputs == ["oveHeat_u"]
    assert {*(proposal.study.disturbances or {})} == {"TDryBul"}
    assert "oveHeat_activate" not in proposal.study.plant.start
    # The gain of what is driven, and not of what the room's own control leaves of it.
    assert proposal.gains[0, 0] == pytest.approx(1.0 / LOSS, rel=0.05)


def test_a_study_of_the_plants_own_control_alone_needs_no_reference(tmp_path: Path) -> None:
    """What there is to say of it is what it costs; nothing is tracked."""
    plant = {"name": f"{__name__}:ROOM", "inputs": ["oveHeat_u"], "outputs": ["reaTZon_y", "reaPHea_y"]}
    heat = {"signal": "reaPHea_y", "price": 0.25, "unit": "EUR/kWh"}
    options = {"plant": plant, "reference": {}, "controllers": {"own": "plant"}, "prices": {"heat": heat}}
    text = room_study(**options, seeds=[0, 1])
    assert "[reference" not in text
    results = run_file(write(tmp_path, text))
    trace, figures = results.cases[0].trace(), results.cases[0].metrics
    np.testing.assert_allclose(trace.measured[:, 0], controlled_by_itself(trace.time), rtol=1e-6)
    assert (trace.outputs, results.cases[0].failed, results.cases[0].settles) == ((), False, None)
    energy = GAIN * (SETPOINT - trace.measured[:-1, 0]).sum() * H / 3.6e6
    assert figures["energy [kWh]"] == pytest.approx(energy, rel=0.05)
    assert figures["money [EUR]"] == pytest.approx(0.25 * figures["energy [kWh]"])
    assert not [key for key in figures if "error" in key or "settling" in key or ".reaTZon_y" in key]
    # What it is written out as is read again, to the same cases.
    again = cases_in(results.folder / "study.toml")
    assert [case.id for case in again] == [case.id for case in cases_in(tmp_path / "study.toml")]
    report = report_writer("md")([results], tmp_path / "report.md").read_text(encoding="utf-8")
    assert f"money {figures['money [EUR]']:.3g}" in report
    assert "follows no reference" in report
    assert "| controlled outputs | none |" in report
    assert "nan" not in report


def test_a_study_of_any_other_controller_needs_a_reference(tmp_path: Path) -> None:
    controllers = {"own": "plant", "idle": "idle"}
    with pytest.raises(ConfigError) as error:
        read_study(str(write(tmp_path, room_study(reference={}, controllers=controllers))))
    assert [fault.split(": ", 1)[1] for fault in error.value.faults] == ["reference: required key is missing"]


def test_a_problem_of_the_plants_own_control_alone_needs_no_reference(tmp_path: Path) -> None:
    problem = Problem(
        plant=f"{__name__}:ROOM",
        inputs=["oveHeat_u"],
        outputs=["reaTZon_y"],
        sampling_time=H,
        duration=SAMPLES * H,
        reference={},
    )
    (case,) = Study(problem, {"own": PlantControl()}).run(tmp_path / "results").cases
    time = case.trace().time
    np.testing.assert_allclose(case.trace().measured[:, 0], controlled_by_itself(time), rtol=1e-6)


def test_the_plants_own_control_needs_no_reference(room: Path) -> None:
    with FMUPlant(room, inputs=["oveHeat_u"], outputs=["reaTZon_y"]) as plant:
        trace = cosimulate(plant, PlantControl(), sampling_time=H, duration=SAMPLES * H, reference={})
    assert trace.outputs == ()
    np.testing.assert_allclose(trace.measured[:, 0], controlled_by_itself(trace.time), rtol=1e-6)
