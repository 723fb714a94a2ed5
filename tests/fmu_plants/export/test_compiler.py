"""Which compiler is used, what it must accept, and what is said when it fails."""

import ctypes
import shlex
import shutil
import sys
from dataclasses import replace

import pytest
from fmpy.validation import validate_fmu

from fmu_plants import Equations, ExportError, export_fmu
from fmu_plants.export import FMI_VERSIONS, fmi_functions, fmi_headers, fmu_source
from fmu_plants.export.compiler import Compiler, compile_library, cross_compiler, find_compiler
from fmu_plants.export.platforms import PLATFORMS
from fmu_plants.pendulum import MODEL

STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Werror")
SHOWN = '__attribute__((visibility("default")))'
ZIG = Compiler((sys.executable, "-m", "ziglang", "cc"), "zig")


@pytest.fixture
def no_system_compiler(monkeypatch, tmp_path):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))


def c_files(model, fmi_version):
    source = fmu_source(model, fmi_version, 1e-10, 1e-10)
    # Whatever a compiler says about the headers of the standard is no fault of this code.
    headers = fmi_headers(fmi_version)
    own_business = {name: f"#pragma GCC system_header\n{text}" for name, text in headers.items()}
    return {**source.sources, **own_business}, fmi_functions(headers)


@pytest.mark.parametrize("fmi_version", FMI_VERSIONS)
@pytest.mark.parametrize(
    "compiler",
    [find_compiler(), ZIG, *map(cross_compiler, PLATFORMS)],
    ids=["system", "zig", *(platform.name for platform in PLATFORMS)],
)
def test_the_c_code_gives_no_warning(compiler, fmi_version):
    assert compile_library(compiler, *c_files(MODEL, fmi_version), STRICT)


def test_equations_that_leave_variables_unused_give_no_warning():
    for equations in ({"angle": 1, "angular_velocity": 0}, {"angle": 1}):
        model = replace(
            MODEL, equations=lambda v, given=equations: Equations({"angular_velocity": v.time} | given)
        )
        files, _ = c_files(model, "2.0")
        assert compile_library(find_compiler(), {n: files[n] for n in ("model.c", "model.h")}, [], STRICT)


def test_zig_is_used_when_there_is_no_other(no_system_compiler, tmp_path, pendulum_fmu, open_fmu):
    assert find_compiler().command == (sys.executable, "-P", "-m", "ziglang", "cc")
    path = export_fmu(MODEL, tmp_path / "pendulum.fmu")
    assert validate_fmu(str(path)) == []
    ends = []
    for fmu in (path, pendulum_fmu):
        instance = open_fmu(fmu).start({"angle": 2.0, "torque": 1.0})
        assert instance.step(0.0, 5.0) == 0
        ends.append(instance.get("angle", "angular_velocity"))
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


def test_without_any_compiler_it_says_what_to_install(no_system_compiler, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "ziglang", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ExportError, match="pip install ziglang") as error:
        export_fmu(MODEL, tmp_path / "pendulum.fmu")
    for word in ("$CC", "gcc", "xcode-select"):
        assert word in str(error.value)


def test_the_environment_chooses_the_compiler(monkeypatch):
    monkeypatch.setenv("CC", shlex.join([sys.executable, "-m", "ziglang", "cc"]))
    compiler = find_compiler()
    assert compiler.command[1:] == ("-m", "ziglang", "cc")
    monkeypatch.setenv("CC", sys.executable)
    assert find_compiler().identity != compiler.identity


def test_a_missing_compiler_is_named(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler -m64")
    with pytest.raises(ExportError, match="CC was not found: 'no-such-compiler -m64'"):
        find_compiler()


def test_a_program_that_cannot_run_is_named(tmp_path):
    with pytest.raises(ExportError, match="cannot be run"):
        compile_library(Compiler((str(tmp_path / "absent"),), ""), {"a.c": ""}, [])


def test_the_compiler_s_own_words_are_passed_on():
    with pytest.raises(ExportError, match=r"(?s)exit code 1.*a\.c.*nonsense"):
        compile_library(find_compiler(), {"a.c": "nonsense"}, [])


def test_of_sources_that_libraries_share_what_they_are_compiled_to_is_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path))
    files = {
        "value.h": "#define VALUE 1\n",
        "all.h": '#include "value.h"\nint twice(int);\n',
        "twice.c": "int twice(int x) { return 2 * x; }",
        "f.c": f'#include "all.h"\n{SHOWN} int f(void) {{ return twice(VALUE); }}',
    }

    def result_and_kept():
        library = tmp_path / f"{len(list(tmp_path.iterdir()))}{find_compiler().platform.suffix}"
        library.write_bytes(compile_library(find_compiler(), files, ["f"], keep_objects=True))
        return ctypes.CDLL(str(library)).f(), sorted(path.name for path in tmp_path.rglob("*.o"))

    assert result_and_kept() == (2, ["f.c.o", "twice.c.o"])
    files["value.h"] = "#define VALUE 21\n"
    assert result_and_kept() == (42, ["f.c.o", "f.c.o", "twice.c.o"])


def test_a_library_that_lacks_a_function_is_refused():
    with pytest.raises(ExportError, match="does not export: fmi2DoStep, hidden"):
        compile_library(find_compiler(), {"a.c": "int hidden(void) { return 1; }"}, ["fmi2DoStep", "hidden"])


def test_a_library_that_does_not_load_is_refused():
    missing = (
        'int elsewhere(void); __attribute__((visibility("default"))) int f(void) { return elsewhere(); }'
    )
    # Whether the linker or the loader finds out depends on the platform.
    with pytest.raises(ExportError, match="elsewhere"):
        compile_library(
            find_compiler(), {"a.c": missing}, ["f"], ["-Wl,-z,now"] if shutil.which("ld") else []
        )


@pytest.mark.parametrize(("fmi_version", "number"), [("2.0", 44), ("3.0", 75)])
def test_the_functions_of_the_standard_are_read_from_its_headers(fmi_version, number):
    functions = fmi_functions(fmi_headers(fmi_version))
    assert len(set(functions)) == len(functions) == number
    assert {f"fmi{fmi_version[0]}{name}" for name in ("GetVersion", "DoStep", "SetTime")} < set(functions)


def test_the_library_exports_the_standard_s_functions_and_nothing_else(pendulum_library):
    for name in fmi_functions(fmi_headers("2.0")):
        assert hasattr(pendulum_library.functions, name)
    for internal in ("simulation_create", "dopri54_integrate", "model", "allowed"):
        assert not hasattr(pendulum_library.functions, internal)
