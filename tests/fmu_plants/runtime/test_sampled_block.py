"""A sampled block as an FMU: its answers belong to sampling instants, whoever asks when and how often."""

import ctypes
import math
import subprocess
import zipfile
from dataclasses import replace

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import fmi2Error, fmi2ModelExchange, fmi2OK
from fmpy.validation import validate_fmu
from fmus.blocks import block_files

from fmu_plants import ExportError, Variable
from fmu_plants.export import FMI_VERSIONS, export_block, fmi_functions, fmi_headers
from fmu_plants.export.compiler import compile_library, find_compiler
from fmu_plants.export.platforms import PLATFORMS
from fmu_plants.export.sampled_block import SampledBlock
from tests.fmu_plants.conftest import Instance, Instance3, Library

# A PI controller. For a missing measurement: the last answer, with a status; for r = 1e9, an infinite one.
STEP = """
state->status = isnan(y[0]) ? 4 : 0;
if (!state->status) {
    state->memory[0] += 0.1 * (r[0] - y[0]);
    state->memory[1] = 2.0 * (r[0] - y[0]) + state->memory[0];
}
state->iterations += 1;
u[0] = r[0] < 1e9 ? state->memory[1] : INFINITY;
u[1] = r[1] + y[1];
"""
BLOCK = SampledBlock(
    "pi",
    "A PI controller",
    0.1,
    (Variable("angle", "rad", -1.0, 1.0), Variable("status", "furlong")),
    (Variable("setpoint.angle", "rad"), Variable("reference.angle[1]", "rad", start=0.5)),
    (Variable("torque", "N.m", -10.0, 10.0), Variable("angle")),
    block_files(STEP, memory=2),
    {"controller.json": "{}"},
)


def answers(errors):
    """Return what the PI controller answers to a sequence of control errors."""
    return [2.0 * e + 0.1 * total for e, total in zip(errors, np.cumsum(errors), strict=True)]


@pytest.fixture(scope="session", params=FMI_VERSIONS)
def block_fmu(request, own_cache_folder, tmp_path_factory):
    return export_block(BLOCK, tmp_path_factory.mktemp("block") / "pi.fmu", request.param)


@pytest.fixture
def block(block_fmu, tmp_path):
    """Open an instance of either FMI version, freed after the test."""
    library = Library(block_fmu, tmp_path / "block")
    is_fmi2 = library.description.fmiVersion == "2.0"
    instance = Instance(library) if is_fmi2 else Instance3(library)
    yield instance
    instance.free()


def c_files(fmu, folder):
    """Return the C code in an FMU, with the headers of the standard, whose faults are not its own."""
    Library(fmu, folder)
    version = fmpy.read_model_description(str(fmu)).fmiVersion
    headers = {name: f"#pragma GCC system_header\n{text}" for name, text in fmi_headers(version).items()}
    files = {file.name: file.read_text() for file in (folder / "sources").glob("*.[ch]")}
    return {**files, **headers}, fmi_functions(fmi_headers(version))


def controlled(instance):
    return instance.get("torque")[0]


def test_the_fmu_is_valid_and_says_what_it_is(block_fmu):
    description = fmpy.read_model_description(str(block_fmu))
    assert validate_fmu(str(block_fmu)) == []
    assert description.modelExchange is None
    assert not description.coSimulation.canHandleVariableCommunicationStepSize
    assert float(description.defaultExperiment.stepSize) == 0.1
    inputs = [v.name for v in description.modelVariables if v.causality == "input"]
    outputs = [v.name for v in description.modelVariables if v.causality == "output"]
    assert inputs == ["angle", "status", "setpoint.angle", "reference.angle[1]"]
    assert outputs == ["torque", "input.angle", "controller.status", "iterations", "active_bounds"]
    for unknowns in (description.outputs, description.initialUnknowns):
        assert [unknown.variable.name for unknown in unknowns] == outputs
        assert all([known.name for known in unknown.dependencies] == inputs for unknown in unknowns)
    if description.fmiVersion == "3.0":
        assert float(description.coSimulation.fixedInternalStepSize) == 0.1


def test_outputs_are_those_of_the_inputs_that_were_set_and_the_step_commits_them(block):
    """The order of a sequential master: set, read, and step from there."""
    block.start({"setpoint.angle": 1.0})
    for k, (y, u) in enumerate(zip([0.0, 0.25, 0.5], answers([1.0, 0.75, 0.5]), strict=True)):
        for tried in (y + 3.0, y - 1.0, y):
            assert block.set({"angle": tried}) == fmi2OK
            controlled(block)  # nothing of this is kept but the last
        assert controlled(block) == pytest.approx(u, abs=1e-15)
        assert block.step(k * 0.1, 0.1) == fmi2OK
        assert controlled(block) == pytest.approx(u, abs=1e-15)
        assert block.get("iterations")[0] == k + 1


def test_outputs_read_after_the_step_belong_to_its_beginning(block):
    """The order of a parallel master: set, step, read."""
    block.start({"setpoint.angle": 1.0})
    for k, (y, u) in enumerate(zip([0.0, 0.25, 0.5], answers([1.0, 0.75, 0.5]), strict=True)):
        assert block.set({"angle": y}) == fmi2OK
        assert block.step(k * 0.1, 0.1) == fmi2OK
        assert controlled(block) == pytest.approx(u, abs=1e-15)


def test_between_instants_the_answer_is_held(block):
    block.start({"setpoint.angle": 1.0, "angle": 0.25})
    first, second = answers([0.75, 0.0])
    for part in range(4):
        assert block.step(part * 0.025, 0.025) == fmi2OK
        assert controlled(block) == pytest.approx(first, abs=1e-15)
        assert block.set({"angle": 7.0}) == fmi2OK
        if part < 3:
            assert controlled(block) == pytest.approx(first, abs=1e-15)
    assert block.set({"angle": 1.0}) == fmi2OK
    assert controlled(block) == pytest.approx(second, abs=1e-15)
    assert block.step(0.1, 0.1) == fmi2OK
    assert controlled(block) == pytest.approx(second, abs=1e-15)


def test_instants_are_counted_from_the_start_time(block):
    """Times that an importer adds up are accepted, and none is taken for another instant."""
    block.start({"setpoint.angle": 1.0}, start=3.0)
    time = 3.0
    for _ in range(3000):
        assert block.step(time, 0.1 / 3) == fmi2OK, block.messages
        time += 0.1 / 3
    assert block.get("iterations")[0] == 1000
    assert block.get("time")[0] == 3.0 + 1000 * 0.1


@pytest.mark.parametrize(
    ("done", "size", "times"),
    [
        (0.0, 0.2, ("from 0 to 0.2", "instant, 0.1", "sampling time, 0.1")),
        (0.08, 0.04, ("from 0.08 to 0.12", "instant, 0.1")),
        (0.05, 0.1, ("from 0.05 to 0.15", "instant, 0.1")),
    ],
)
def test_a_step_past_an_instant_is_refused_and_changes_nothing(block, done, size, times):
    block.start({"setpoint.angle": 1.0})
    if done:
        assert block.step(0.0, done) == fmi2OK
    assert block.step(done, size) == fmi2Error
    for words in times:
        assert words in block.messages[-1][2]
    assert block.step(done, 0.1 - done) == fmi2OK
    assert block.get("iterations")[0] == 1


@pytest.mark.parametrize("size", [1e-14, 1e-7, 0.07])
def test_a_last_step_of_any_length_takes_its_sample(block, size):
    """Importers that add up times have a rounding error left before the stop time, others cut it short."""
    block.start({"setpoint.angle": 1.0})
    assert block.step(0.0, 0.1) == fmi2OK
    assert block.step(0.1, size) == fmi2OK, block.messages
    assert block.get("iterations")[0] == 2
    assert controlled(block) == pytest.approx(answers([1.0] * 2)[-1], abs=1e-15)


def test_a_missing_measurement_reaches_the_controller(block):
    block.start({"setpoint.angle": 1.0})
    assert block.step(0.0, 0.1) == fmi2OK
    assert block.set({"angle": math.nan}) == fmi2OK
    assert np.isnan(block.get("angle"))
    assert controlled(block) == pytest.approx(answers([1.0])[0], abs=1e-15)
    assert block.get("controller.status")[0] == 4
    assert block.step(0.1, 0.1) == fmi2OK
    assert block.set({"angle": math.inf}) == fmi2Error
    assert "not finite" in block.messages[-1][2]
    assert block.set({"angle": 5.0}) == fmi2OK  # beyond its range, as what is measured can be


def test_an_answer_that_is_not_finite_ends_it_until_a_reset(block):
    block.start({"setpoint.angle": 1e9})
    assert block.step(0.0, 0.1) == fmi2Error
    assert "torque is not finite at time 0" in block.messages[-1][2]
    assert block.step(0.0, 0.1) == fmi2Error
    assert "after a failed step" in block.messages[-1][2]
    version = block.library.description.fmiVersion[0]
    assert block.call(f"fmi{version}Reset") == fmi2OK
    block.start({"setpoint.angle": 1.0})
    assert block.step(0.0, 0.1) == fmi2OK
    assert controlled(block) == pytest.approx(answers([1.0])[0], abs=1e-15)


@pytest.mark.parametrize("read_before", [False, True])
@pytest.mark.parametrize("part", [0.05, 0.1])
def test_a_restored_state_goes_on_bit_for_bit(block, read_before, part):
    """Also from between two instants, and after outputs were read, by way of its bytes."""
    version = block.library.description.fmiVersion[0]
    named = "FMUstate" if version == "2" else "FMUState"
    block.start({"setpoint.angle": 1.0})
    assert block.step(0.0, part) == fmi2OK
    assert block.set({"angle": 0.5}) == fmi2OK
    if read_before:
        controlled(block)
    state, size, copy = ctypes.c_void_p(), ctypes.c_size_t(), ctypes.c_void_p()
    assert block.call(f"fmi{version}Get{named}", ctypes.byref(state)) == fmi2OK
    assert block.call(f"fmi{version}Serialized{named}Size", state, ctypes.byref(size)) == fmi2OK
    content = ctypes.create_string_buffer(size.value)
    assert block.call(f"fmi{version}Serialize{named}", state, content, size) == fmi2OK
    de = "DeSerialize" if version == "2" else "Deserialize"
    assert block.call(f"fmi{version}{de}{named}", content, size, ctypes.byref(copy)) == fmi2OK

    def onwards():
        rows = [block.get("torque", "controller.status", "iterations")]
        for k in range(round(part / 0.05), 6):
            assert block.step(k * 0.05, 0.05) == fmi2OK
            assert block.set({"angle": 0.1 * k}) == fmi2OK
            rows.append(block.get("torque", "controller.status", "iterations"))
        return np.array(rows)

    first = onwards()
    for saved in (state, copy):
        assert block.call(f"fmi{version}Set{named}", saved) == fmi2OK
        np.testing.assert_array_equal(onwards(), first)
        assert block.call(f"fmi{version}Free{named}", ctypes.byref(saved)) == fmi2OK


def test_instances_do_not_share_a_state(block):
    other = type(block)(block.library)
    for instance, setpoint in ((block, 1.0), (other, -1.0)):
        instance.start({"setpoint.angle": setpoint})
    for k in range(3):
        assert block.step(k * 0.1, 0.1) == fmi2OK
        assert other.step(k * 0.1, 0.1) == fmi2OK
    assert controlled(block) == pytest.approx(answers([1.0] * 3)[-1], abs=1e-15)
    assert controlled(other) == pytest.approx(answers([-1.0] * 3)[-1], abs=1e-15)
    other.free()


def test_there_is_no_model_exchange_and_no_derivative(block):
    library, version = block.library, block.library.description.fmiVersion[0]
    other = Instance(library, kind=fmi2ModelExchange) if version == "2" else Instance3(library, exchange=True)
    assert other.component is None
    assert "Co-Simulation only" in other.messages[-1][2]
    block.start()
    reference, n = (ctypes.c_uint * 1)(1), ctypes.c_size_t(1)
    value = (ctypes.c_double * 1)()
    sizes = (
        (reference, n, reference, n, value, value)
        if version == "2"
        else (reference, n, reference, n, value, n, value, n)
    )
    assert block.call(f"fmi{version}GetDirectionalDerivative", *sizes) == fmi2Error
    for call in ("EnterContinuousTimeMode", "EnterEventMode"):
        assert block.call(f"fmi{version}{call}") == fmi2Error
    for call in ("GetContinuousStates", "SetContinuousStates", "GetNominalsOfContinuousStates"):
        assert block.call(f"fmi{version}{call}", value, n) == fmi2Error
    assert block.step(0.0, 0.1) == fmi2OK


def test_calls_out_of_order_are_refused_and_change_nothing(block):
    version = block.library.description.fmiVersion[0]
    assert block.step(0.0, 0.1) == fmi2Error
    assert block.get_with_status("torque")[0] == fmi2Error
    assert block.call(f"fmi{version}ExitInitializationMode") == fmi2Error
    block.start({"setpoint.angle": 1.0})
    assert block.set({"torque": 1.0}) == fmi2Error
    assert "torque is computed" in block.messages[-1][2]
    assert block.step(0.1, 0.1) == fmi2Error
    assert block.step(0.0, math.nan) == fmi2Error
    assert block.step(0.0, 0.1) == fmi2OK
    assert controlled(block) == pytest.approx(answers([1.0])[0], abs=1e-15)
    assert block.call(f"fmi{version}Terminate") == fmi2OK
    assert block.step(0.1, 0.1) == fmi2Error
    assert block.set({"angle": 1.0}) == fmi2Error
    assert controlled(block) == pytest.approx(answers([1.0])[0], abs=1e-15)


def test_signals_can_have_any_name(tmp_path):
    """Those of foreign FMUs do: quotes, signs of formats, letters of every language; one name twice."""
    named = ['a "b"\\', "Größe %s%n", "??/ */ <&>", "time", "der(x)[1,2]"]
    block = replace(
        BLOCK,
        measurements=tuple(Variable(name) for name in named[:2]),
        references=(Variable(named[2]), Variable(named[3])),
        controls=(Variable(named[4]), Variable(named[0])),
    )
    fmu = export_block(block, tmp_path / "pi.fmu")
    library = Library(fmu, tmp_path / "named")
    assert {*named[:3], "reference.time", named[4], f"input.{named[0]}"} <= set(library.references)
    instance = Instance(library).start()
    assert instance.set({named[1]: math.inf}) == fmi2Error
    assert f"for {named[1]} is not finite" in instance.messages[-1][2]
    instance.free()


def test_no_call_without_an_instance_crashes(block_fmu, tmp_path):
    library = Library(block_fmu, tmp_path / "null")
    version = library.description.fmiVersion[0]
    call = library.functions
    null, time = ctypes.c_void_p(), ctypes.c_double(0.1)
    zeros = [ctypes.c_void_p()] * 6
    for name in ("EnterInitializationMode", "ExitInitializationMode", "Terminate", "Reset", "DoStep"):
        assert getattr(call, f"fmi{version}{name}")(null, time, time, *zeros) == fmi2Error
    reference, value, n = (ctypes.c_uint * 1)(3), (ctypes.c_double * 1)(), ctypes.c_size_t(1)
    kind = "Real" if version == "2" else "Float64"
    for access in ("Get", "Set"):
        assert getattr(call, f"fmi{version}{access}{kind}")(null, reference, n, value, n) == fmi2Error


def test_importers_can_compile_its_sources_as_c99(block_fmu, tmp_path):
    strict = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Werror")
    assert compile_library(find_compiler(), *c_files(block_fmu, tmp_path / "fmu"), strict)


def test_a_static_analyser_finds_nothing_in_them(block_fmu, tmp_path):
    for name, text in c_files(block_fmu, tmp_path / "fmu")[0].items():
        (tmp_path / name).write_text(text)
    checks = "--enable=warning,style,performance,portability"
    quiet = ["--quiet", "--std=c99", "--error-exitcode=1", "--suppress=missingIncludeSystem"]
    command = ["cppcheck", checks, *quiet, "-I.", *(path.name for path in tmp_path.glob("*.c"))]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("platform", PLATFORMS, ids=lambda platform: platform.name)
def test_each_of_its_files_may_use_names_of_the_others(platform, tmp_path):
    """What is compiled for several platforms is small, and no file's own names get into another one."""
    helper = "#include <math.h>\nstatic double check_step(double x) { return isnan(x) ? 0.0 : sin(x); }\n"
    steps = [
        f"double step_{i}(double x);\ndouble step_{i}(double x) {{ return check_step(x); }}\n" for i in "12"
    ]
    sources = {f"part{i}.c": helper + step for i, step in enumerate(steps)}
    block = replace(BLOCK, sources=BLOCK.sources | sources)
    path = export_block(block, tmp_path / "pi.fmu", platforms=[platform.name])
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    assert {"sources/controller.h", "sources/controller.c", "sources/part0.c"} <= set(names)
    assert not [name for name in names if "instance" in name]
    assert validate_fmu(str(path)) == []


def test_an_importer_of_others_runs_it(block_fmu):
    """FMPy's loop sets inputs and steps; the setpoint changes at t = 0.2."""
    time = np.arange(6) * 0.1
    signals = np.array(
        [(t, 0.0 if t < 0.15 else 1.0) for t in time], dtype=[("time", float), ("setpoint.angle", float)]
    )
    result = fmpy.simulate_fmu(str(block_fmu), stop_time=0.5, input=signals, output=["torque"])
    expected = answers([0.0, 0.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(result["torque"][1:], expected, atol=1e-14)


def test_an_fmi_version_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ExportError, match=r'"?1\.0.*available: 2\.0, 3\.0'):
        export_block(BLOCK, tmp_path / "pi.fmu", "1.0")
