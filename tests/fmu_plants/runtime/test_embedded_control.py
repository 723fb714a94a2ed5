"""A sampled control inside a plant, against exact solutions between its instants."""

import ctypes
import subprocess
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from math import exp
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import fmi2OK
from fmpy.validation import validate_fmu
from hypothesis import given, settings, strategies as st

from fmu_plants import (
    EmbeddedControl,
    Equations,
    InputTable,
    ModelError,
    PlantModel,
    Rules,
    Symbols,
    Variable,
    build_fmu,
    export_fmu,
    tunable,
)
from fmu_plants.equations import resolve
from fmu_plants.export import fmi_functions, fmi_headers, fmu_source
from fmu_plants.export.compiler import compile_library, find_compiler
from fmu_plants.export.platforms import PLATFORMS
from tests.fmu_plants.conftest import Instance, Instance3, Library

TAU, GAIN, OUTDOORS = 4000.0, 30.0, 5.0  # s, K, degC
LOW, HIGH, START = 19.5, 20.5, 20.0
SAMPLING_TIME = 600.0
DAY = 86400.0
TEMPERATURE = Variable("T", "degC", start=START)
VALVE = Variable("Valve", "1", 0.0, 1.0, start=0.25, description="Valve of the radiator")
SEEN = Variable("reaValve_y", "1")


def room(v: Symbols) -> Equations:
    return Equations({"T": (OUTDOORS + v.gain * v.Valve - v.T) / TAU}, {"reaValve_y": v.Valve})


def thermostat(v: Symbols) -> Rules:
    from sympy import Piecewise

    on = Piecewise((1, v.T < LOW), (0, v.T > HIGH), (v.on, True))
    return Rules({"Valve": on}, memory={"on": on, "count": v.count + 1, "before": v.reaValve_y})


ROOM = PlantModel(
    name="thermostat",
    description="A room and its thermostat",
    states=(TEMPERATURE,),
    outputs=(TEMPERATURE, SEEN),
    parameters=(tunable("gain", "K", start=GAIN),),
    control=EmbeddedControl(
        sampling_time=SAMPLING_TIME,
        actuators=(VALVE,),
        memory=(Variable("on"), Variable("count"), Variable("before")),
        rules=thermostat,
    ),
    equations=room,
    step_size=600.0,
    stop_time=7200.0,
)


def decay(temperature: float, valve: float, duration: float) -> float:
    """Return the temperature that the room has after some time with the valve held."""
    rest = OUTDOORS + GAIN * valve
    return rest + (temperature - rest) * exp(-duration / TAU)


def exact(time: float) -> tuple[float, float]:
    """Return temperature and valve at a time after the start, from instant to instant."""
    temperature, on, k = START, 0.0, 0
    while True:
        on = 1.0 if temperature < LOW else 0.0 if temperature > HIGH else on
        rest = time - k * SAMPLING_TIME
        if rest < SAMPLING_TIME:
            return decay(temperature, on, rest), on
        temperature, k = decay(temperature, on, SAMPLING_TIME), k + 1


@pytest.fixture(scope="session")
def library(own_cache_folder: None, tmp_path_factory: pytest.TempPathFactory) -> Library:
    return Library(build_fmu(ROOM), tmp_path_factory.mktemp("room"))


@pytest.fixture(scope="session")
def library3(own_cache_folder: None, tmp_path_factory: pytest.TempPathFactory) -> Library:
    return Library(build_fmu(ROOM, "3.0"), tmp_path_factory.mktemp("room3"))


@pytest.fixture
def plant(library: Library) -> Iterator[Instance]:
    instance = Instance(library)
    yield instance
    instance.free()


def run(plant: Instance | Instance3, times: np.ndarray) -> np.ndarray:
    """Step from time to time; return temperature and valve at each but the first."""
    rows = []
    for begin, end in pairwise(times):
        assert plant.step(begin, end - begin) == fmi2OK, plant.messages
        rows.append(plant.get("T", "reaValve_y"))
    return np.array(rows)


@pytest.mark.parametrize("size", [50.0, 300.0, 600.0, 700.0, 1234.5, 6000.0])
@pytest.mark.parametrize("start", [0.0, 3.0e7 + 17.0])
def test_a_thermostat_switches_at_its_instants_whatever_the_step(plant, size, start):
    plant.start(start=start)
    times = size * np.arange(int(30000 // size) + 1)
    seen = run(plant, start + times)
    expected = np.array([exact(t) for t in times[1:]])
    assert np.abs(np.diff(expected[:, 1])).sum() >= (2 if size < 2000 else 1)
    np.testing.assert_allclose(seen, expected, atol=1e-8 if start == 0 else 1e-6)


def test_fmi3_does_the_same(library3):
    plant = Instance3(library3).start()
    times = 700.0 * np.arange(40)
    np.testing.assert_allclose(run(plant, times), [exact(t) for t in times[1:]], atol=1e-8)
    plant.free()


@settings(max_examples=30, deadline=None)
@given(steps=st.lists(st.floats(1.0, 3000.0), min_size=1, max_size=12))
def test_steps_of_any_lengths_give_the_same_trajectory(library, steps):
    plant = Instance(library).start()
    times = np.concatenate([[0.0], np.cumsum(steps)])
    seen = run(plant, times)
    np.testing.assert_allclose(seen[:, 0], [exact(t)[0] for t in times[1:]], atol=1e-8)
    plant.free()


def test_times_that_were_added_up_meet_the_instants(plant):
    plant.start()
    time, valves = 0.0, []
    for _ in range(3000):  # of 60.1 s added up, some lie just before an instant, others just after it
        assert plant.step(time, 60.1) == fmi2OK
        time += 60.1
        valves.append(plant.get("reaValve_y")[0])
    assert valves == [exact(round(60.1 * k, 6))[1] for k in range(1, 3001)]
    assert plant.get("count")[0] == 3000 * 601 // 6000 + 1


def test_the_first_instant_is_the_start_and_sees_what_acted_before(plant):
    plant.start()
    assert plant.get("on", "count", "before").tolist() == [0.0, 1.0, VALVE.start]
    plant.step(0.0, SAMPLING_TIME)
    assert plant.get("count", "before").tolist() == [2.0, 0.0]


def test_values_that_are_set_before_the_first_step_are_what_it_decides_by(plant):
    assert plant.setup() == fmi2OK
    assert plant.call("fmi2EnterInitializationMode") == fmi2OK
    assert plant.get("reaValve_y") == [0.0]
    assert plant.set({"T": 10.0}) == fmi2OK
    assert plant.get("reaValve_y", "count").tolist() == [1.0, 1.0]  # asked twice, it has decided once
    assert plant.call("fmi2ExitInitializationMode") == fmi2OK
    plant.step(0.0, 60.0)
    assert plant.get("T")[0] == pytest.approx(decay(10.0, 1.0, 60.0), abs=1e-8)


def test_an_override_acts_at_once_and_the_control_goes_on_behind_it(plant):
    plant.start()
    run(plant, np.array([0.0, 250.0]))
    before = plant.get("T")[0]
    assert plant.set({"oveValve_u": 0.5, "oveValve_activate": 1.0}) == fmi2OK
    assert plant.get("reaValve_y", "Valve").tolist() == [0.5, 0.5]
    ((after, valve),) = run(plant, np.array([250.0, 1450.0]))
    assert (after, valve) == (pytest.approx(decay(before, 0.5, 1200.0), abs=1e-8), 0.5)
    assert plant.get("count")[0] == 3.0
    assert plant.set({"oveValve_activate": 0.0}) == fmi2OK
    on = 1.0 if after < LOW else 0.0
    assert plant.get("reaValve_y")[0] == plant.get("on")[0]
    ((last, _),) = run(plant, np.array([1450.0, 1700.0]))
    assert last == pytest.approx(decay(after, on, 250.0), abs=1e-8)


def test_a_switch_at_or_below_one_half_is_off(plant):
    plant.start({"oveValve_u": 1.0, "oveValve_activate": 0.5})
    assert plant.get("reaValve_y") == [0.0]


def pointer() -> ctypes.c_void_p:
    return ctypes.c_void_p()


@pytest.mark.parametrize("pause", [1000.0, 4200.0, 4800.0, 5000.0])
def test_a_saved_state_goes_on_as_before(library, pause):
    rest = pause + 450.0 * np.arange(20)
    one, other = Instance(library).start(), Instance(library).start()
    run(one, np.array([0.0, pause]))
    state, size = pointer(), ctypes.c_size_t()
    assert one.call("fmi2GetFMUstate", ctypes.byref(state)) == fmi2OK
    assert one.call("fmi2SerializedFMUstateSize", state, ctypes.byref(size)) == fmi2OK
    content = (ctypes.c_byte * size.value)()
    assert one.call("fmi2SerializeFMUstate", state, content, size) == fmi2OK
    first = run(one, rest)
    assert one.call("fmi2SetFMUstate", state) == fmi2OK
    np.testing.assert_array_equal(run(one, rest), first)
    received = pointer()
    assert other.call("fmi2DeSerializeFMUstate", content, size, ctypes.byref(received)) == fmi2OK
    assert other.call("fmi2SetFMUstate", received) == fmi2OK
    np.testing.assert_array_equal(run(other, rest), first)
    for instance, saved in ((one, state), (other, received)):
        instance.call("fmi2FreeFMUstate", ctypes.byref(saved))
        instance.free()


def test_a_reset_begins_again(plant):
    times = 700.0 * np.arange(12)
    plant.start()
    first = run(plant, times)
    assert plant.call("fmi2Reset") == fmi2OK
    plant.start()
    np.testing.assert_array_equal(run(plant, times), first)


def test_derivatives_are_by_the_override_where_it_acts(plant):
    plant.start()
    unknown, known = (
        (ctypes.c_uint * 1)(plant.library.references[name]) for name in ("der(T)", "oveValve_u")
    )
    one = ctypes.c_size_t(1)
    for switch, expected in ((0.0, 0.0), (1.0, GAIN / TAU)):
        plant.set({"oveValve_activate": switch})
        seed, answer = (ctypes.c_double * 1)(1.0), (ctypes.c_double * 1)()
        arguments = (unknown, one, known, one, seed, answer)
        assert plant.call("fmi2GetDirectionalDerivative", *arguments) == fmi2OK
        assert answer[0] == pytest.approx(expected, rel=1e-13)


def test_what_is_described(library, library3):
    for description in (library.description, library3.description):
        variables = {
            v.name: (v.causality, v.variability, v.unit, v.min, v.max, v.start)
            for v in description.modelVariables
        }
        assert variables["oveValve_u"] == ("input", "continuous", "1", "0.0", "1.0", "0.25")
        assert variables["oveValve_activate"] == ("input", "continuous", "1", "0.0", "1.0", "0.0")
        assert variables["on"][:2] == variables["Valve"][:2] == ("local", "discrete")
        described = next(v for v in description.modelVariables if v.name == "oveValve_u").description
        assert described == "Override of Valve: Valve of the radiator"
        known = {u.variable.name: {k.name for k in u.dependencies} for u in description.outputs}
        assert known["reaValve_y"] == {"oveValve_u", "oveValve_activate"}
        assert description.modelExchange is None


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_another_importer_accepts_it_and_has_the_same_trajectory(own_cache_folder, version):
    path = str(build_fmu(ROOM, version))
    assert validate_fmu(path) == []
    rows = fmpy.simulate_fmu(path, stop_time=7000.0, output_interval=700.0, output=["T", "reaValve_y"])
    expected = np.array([exact(t) for t in rows["time"]])
    np.testing.assert_allclose(rows["T"], expected[:, 0], atol=1e-8)
    np.testing.assert_array_equal(rows["reaValve_y"], expected[:, 1])


def schedule(v: Symbols) -> Rules:
    from sympy import Mod, Piecewise

    hour = Mod(v.time, DAY) / 3600
    wanted = Piecewise((21, (hour >= 7) & (hour < 22)), (17, True))
    return Rules({"Valve": Piecewise((1, wanted + v.shift > v.T), (0, True))})


def test_a_schedule_follows_the_time_and_a_table(own_cache_folder, tmp_path):
    shift = InputTable(
        file="shift.csv",
        variables=(Variable("shift", "K"),),
        values=lambda: (np.array([0.0, 1.5 * DAY]), np.array([[0.0], [1.0]])),
        interpolation="hold",
    )
    control = EmbeddedControl(sampling_time=60.0, actuators=(VALVE,), rules=schedule)
    fmu = build_fmu(replace(ROOM, name="schedule", tables=(shift,), control=control))
    library = Library(fmu, tmp_path / "schedule")
    plant = Instance(library, location=(tmp_path / "schedule" / "resources").as_uri()).start()
    times = 3600.0 * np.arange(49)
    seen = np.concatenate([[[START, 0.0]], run(plant, times)])[:, 0]
    plant.free()
    for wanted, first, last in ((17, 4, 7), (21, 12, 22), (17, 28, 31), (21, 33, 36), (22, 40, 46)):
        held = seen[first:last]
        assert np.abs(held - wanted).max() < 0.5


FAULTS = {
    "sampling time": ({"sampling_time": 0.0}, "control: sampling_time must be positive"),
    "rules": ({"rules": 1}, "control: rules must be a function"),
    "no actuators": ({"actuators": ()}, "control: it has no actuators"),
    "no limits": ({"actuators": (Variable("Valve"),)}, "actuator 'Valve' needs finite min and max"),
    "a name twice": ({"memory": (Variable("T"),)}, "memory 'T': the name is already taken by the"),
    "an override's name": ({"memory": (Variable("oveValve_u"),)}, "override 'oveValve_u': the name is"),
}


@pytest.mark.parametrize(("changes", "message"), FAULTS.values(), ids=FAULTS)
def test_a_control_that_contradicts_itself_is_refused(changes, message):
    with pytest.raises(ModelError, match=message):
        replace(ROOM, control=replace(ROOM.control, **changes))


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        (lambda v: Rules({}), "rules do not give the actuator 'Valve'"),
        (lambda v: Rules({"Valve": 0, "valve": 0}), "rules give an unknown actuator 'valve'"),
        (lambda v: Rules({"Valve": v.on}), "rules do not give the memory 'on'"),
        (lambda v: Rules({"Valve": v.temperature}), "the rules of the control use an unknown 'temperature'"),
        (lambda v: {"Valve": 0}, "must return Rules"),
    ],
)
def test_rules_that_do_not_fit_the_model_are_refused(rules, message):
    with pytest.raises(ModelError, match=message):
        resolve(replace(ROOM, control=replace(ROOM.control, rules=rules)))


def test_equations_do_not_know_the_memory():
    with pytest.raises(ModelError, match="the equations use an unknown 'on'"):
        resolve(replace(ROOM, equations=lambda v: Equations({"T": v.on}, {"reaValve_y": v.Valve})))


def test_further_resources_are_files_of_the_fmu(own_cache_folder, tmp_path: Path):
    model = replace(ROOM, resources={"config.json": "{}", "kpis.json": lambda: '{"a": []}'})
    files = fmu_source(model, "2.0", None, None).descriptions
    assert (files["resources/config.json"], files["resources/kpis.json"]) == ("{}", '{"a": []}')


BLIND = InputTable(
    file="blind.csv",
    variables=(Variable("blind", "K"),),
    values=lambda: (np.array([0.0]), np.array([[0.0]])),
    period=DAY,
)
SHADED = replace(
    ROOM,
    name="shaded",
    tables=(BLIND,),
    equations=lambda v: Equations({"T": (v.gain * v.Valve - v.T - v.blind) / TAU}, {"reaValve_y": v.Valve}),
)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_importers_can_compile_its_sources_and_a_static_analyser_finds_nothing(version, tmp_path):
    headers = fmi_headers(version)
    files = {**fmu_source(SHADED, version, None, None).sources, **headers}
    strict = ("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Werror")
    assert compile_library(find_compiler(), files, fmi_functions(headers), strict)
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    checks = "--enable=warning,style,performance,portability"
    quiet = [
        "--quiet",
        "--std=c11",
        "--error-exitcode=1",
        "--suppress=missingIncludeSystem",
        "--inline-suppr",
    ]
    command = ["cppcheck", checks, *quiet, "-I.", *(path.name for path in tmp_path.glob("*.c"))]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_it_is_compiled_for_every_platform(version, tmp_path):
    path = export_fmu(SHADED, tmp_path / "shaded.fmu", version, platforms="all")
    assert validate_fmu(str(path)) == []
    with zipfile.ZipFile(path) as archive:
        libraries = [name for name in archive.namelist() if name.startswith("binaries/")]
        assert archive.read("resources/blind.csv") == b"time,blind\n0.0,0.0\n"
    shared = version == "2.0"  # one library for both processors of macOS
    assert len(libraries) == len(PLATFORMS) - shared
