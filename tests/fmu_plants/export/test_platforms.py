"""One FMU for every platform: compiled here, read everywhere."""

import re
import struct
import sys
import zipfile

import fmpy
import pytest
from fmpy.fmi2 import fmi2OK
from fmpy.validation import validate_fmu
from sympy.printing.c import known_functions_C99

from fmu_plants import ExportError, export_fmu
from fmu_plants.export import fmi_functions, fmi_headers
from fmu_plants.export.binaries import exported_symbols
from fmu_plants.export.compiler import compile_library, cross_compiler
from fmu_plants.export.platforms import (
    LINUX_ARM64,
    LINUX_X86_64,
    MACOS_ARM64,
    MACOS_X86_64,
    PLATFORMS,
    WINDOWS_X86_64,
    binary_files,
    host_platform,
    parse_platforms,
)
from fmu_plants.pendulum import MODEL

# What its fixtures run or build is run and built in one process.
pytestmark = pytest.mark.xdist_group("platforms")

FOLDERS = {
    "2.0": {
        "linux64/pendulum.so",
        "aarch64-linux/pendulum.so",
        "win64/pendulum.dll",
        "darwin64/pendulum.dylib",
    },
    "3.0": {
        "x86_64-linux/pendulum.so",
        "aarch64-linux/pendulum.so",
        "x86_64-windows/pendulum.dll",
        "x86_64-darwin/pendulum.dylib",
        "aarch64-darwin/pendulum.dylib",
    },
}
OF_THE_LINKER = {"__dso_handle", "_mh_dylib_header"}  # in libraries for macOS
X86_64, ARM64 = 0x01000007, 0x0100000C  # processor types in Mach-O


@pytest.fixture(scope="session", params=["2.0", "3.0"])
def everywhere(request, tmp_path_factory):
    """The pendulum for all platforms: FMI version, file, messages about progress."""
    messages = []
    path = tmp_path_factory.mktemp("everywhere") / "pendulum.fmu"
    export_fmu(MODEL, path, request.param, platforms="all", progress=messages.append)
    return request.param, path, messages


def members(path):
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def macho_processor(library):
    return struct.unpack_from("<I", library, 4)[0]


def universal_parts(library):
    """Read the table of a universal library, as Apple documents it."""
    magic, count = struct.unpack_from(">2I", library)
    assert magic == 0xCAFEBABE
    for index in range(count):
        processor, _, offset, size, alignment = struct.unpack_from(">5I", library, 8 + 20 * index)
        assert offset % (1 << alignment) == 0
        yield processor, library[offset : offset + size]


def test_the_fmu_holds_a_library_for_every_platform_and_nothing_else(everywhere):
    version, path, _ = everywhere
    assert validate_fmu(str(path)) == []
    names = set(members(path))
    assert names == {"modelDescription.xml", *(f"binaries/{name}" for name in FOLDERS[version])}
    assert {"linux64", "win64", "darwin64"} <= set(fmpy.supported_platforms(str(path)))


def test_the_fmu_is_small(everywhere):
    _, path, _ = everywhere
    assert path.stat().st_size < 60_000


def test_every_library_is_for_its_processor_and_exports_the_standard_s_functions(everywhere):
    version, path, _ = everywhere
    content = {name.rpartition("binaries/")[2]: data for name, data in members(path).items()}
    linux, windows = ("linux64", "win64") if version == "2.0" else ("x86_64-linux", "x86_64-windows")
    elf = {name: content[f"{name}/pendulum.so"] for name in (linux, "aarch64-linux")}
    assert [struct.unpack_from("<H", elf[name], 18)[0] for name in elf] == [0x3E, 0xB7]
    dll = content[f"{windows}/pendulum.dll"]
    assert struct.unpack_from("<H", dll, struct.unpack_from("<I", dll, 0x3C)[0] + 4)[0] == 0x8664
    if version == "2.0":
        macos = dict(universal_parts(content["darwin64/pendulum.dylib"]))
    else:
        thin = [content[f"{name}-darwin/pendulum.dylib"] for name in ("x86_64", "aarch64")]
        macos = {macho_processor(library): library for library in thin}
    assert list(macos) == [X86_64, ARM64]
    assert [macho_processor(library) for library in macos.values()] == [X86_64, ARM64]
    functions = set(fmi_functions(fmi_headers(version)))
    for library in (*elf.values(), dll, *macos.values()):
        assert exported_symbols(library) - OF_THE_LINKER == functions


def test_libraries_for_linux_need_no_recent_c_library(everywhere):
    _, path, _ = everywhere
    for name, library in members(path).items():
        if name.endswith(".so"):
            needed = {tuple(map(int, v.split(b"."))) for v in re.findall(rb"GLIBC_([\d.]+)", library)}
            assert needed
            assert max(needed) <= (2, 17)


def test_libraries_for_windows_take_mathematical_functions_from_the_system():
    """The compiler would give each library its own, with tables: one sine makes it larger by a quarter."""
    of_two_arguments, of_few_instructions = (
        {"atan2", "hypot", "pow"},
        {"fabs", "ceil", "floor", "fmax", "fmin", "fma"},
    )
    printed = {name for name in known_functions_C99.values() if isinstance(name, str)} | {"pow"}
    imported = printed - of_few_instructions
    calls = (f"{name}({'x, x' if name in of_two_arguments else 'x'})" for name in sorted(imported))
    code = f"__declspec(dllexport) double f(double x) {{ return {' + '.join(calls)}; }}"
    compiler = cross_compiler(WINDOWS_X86_64)
    library = compile_library(compiler, {"a.c": f"#include <math.h>\n{code}\n"}, ["f"], ["-Werror"])
    # Each name in the table follows a number of two bytes, 0 here (Microsoft, PE format, "Hint/Name Table").
    assert {name for name in imported if b"\0\0" + name.encode() + b"\0" not in library} == set()


def test_the_same_model_gives_the_same_bytes(everywhere, tmp_path):
    version, path, _ = everywhere
    again = export_fmu(MODEL, tmp_path / "again.fmu", version, platforms=[p.name for p in PLATFORMS])
    assert again.read_bytes() == path.read_bytes()


def test_progress_is_told_for_every_platform(everywhere):
    _, _, messages = everywhere
    assert messages == [
        f"compiling for {platform.name} ({count} of 5)" for count, platform in enumerate(PLATFORMS, 1)
    ]


def test_a_library_for_here_computes_what_the_usual_one_does(pendulum_fmu, open_fmu, tmp_path):
    cross = export_fmu(MODEL, tmp_path / "cross.fmu", platforms=host_platform().name)
    ends = []
    for fmu in (cross, pendulum_fmu):
        instance = open_fmu(fmu).start({"angle": 2.0, "torque": 1.0})
        assert instance.step(0.0, 5.0) == fmi2OK
        ends.append(instance.get("angle", "angular_velocity"))
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


@pytest.mark.parametrize("platform", PLATFORMS, ids=lambda platform: platform.name)
def test_a_foreign_library_that_lacks_a_function_is_refused(platform):
    code = '#include "fmi2Functions.h"\nint hidden(void) { return 1; }\nFMI2_Export int shown = 2;\n'
    files = {"a.c": code, **fmi_headers("2.0")}
    assert compile_library(cross_compiler(platform), files, ["shown"])
    with pytest.raises(ExportError, match=rf"library for {platform.name} .* does not export: hidden$"):
        compile_library(cross_compiler(platform), files, ["shown", "hidden"])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "neither ELF nor PE nor Mach-O"),
        (b"#!/bin/sh", "neither ELF nor PE nor Mach-O"),
        (b"\x7fELF\x02\x01", "damaged"),
        (b"MZ" + bytes(58) + b"\xff\xff\0\0", "damaged"),
        (b"\xcf\xfa\xed\xfe" + bytes(12) + b"\1\0\0\0" + bytes(12), "damaged"),
    ],
)
def test_files_that_are_not_libraries_are_refused(content, message):
    with pytest.raises(ValueError, match=message):
        exported_symbols(content)


def test_platforms_by_name():
    assert parse_platforms("all") == parse_platforms(["all"]) == PLATFORMS
    both = (LINUX_X86_64, WINDOWS_X86_64)
    assert parse_platforms("windows-x86_64, linux-x86_64") == parse_platforms([p.name for p in both]) == both


@pytest.mark.parametrize("names", ["amiga", ["linux-x64", "amiga"], [], ""])
def test_unknown_platforms_are_refused(names):
    with pytest.raises(ExportError, match="there are: all, linux-arm64, linux-x86_64, macos-arm64, macos-"):
        parse_platforms(names)


def test_a_misspelt_platform_is_recognised():
    with pytest.raises(ExportError, match=r'no platform "linux-x86-64"; did you mean "linux-x86_64"\?'):
        parse_platforms("linux-x86-64")


def test_folders_where_only_arm_is_asked_for():
    """FMI 2.0 importers on ARM look into the folders that are named for x86."""
    fmi2_files = binary_files("2.0", "p", {LINUX_ARM64: b"arm", MACOS_ARM64: b"mac"})
    assert fmi2_files == {
        "binaries/aarch64-linux/p.so": b"arm",
        "binaries/linux64/p.so": b"arm",
        "binaries/darwin64/p.dylib": b"mac",
    }
    fmi3_files = binary_files("3.0", "p", {LINUX_ARM64: b"arm", MACOS_ARM64: b"mac"})
    assert set(fmi3_files) == {"binaries/aarch64-linux/p.so", "binaries/aarch64-darwin/p.dylib"}


def test_names_of_this_platform_are_those_of_fmpy():
    for version, folder in (("2.0", fmpy.platform), ("3.0", fmpy.platform_tuple)):
        files = binary_files(version, "p", {host_platform(): b""})
        assert f"binaries/{folder}/p{fmpy.sharedLibraryExtension}" in files


@pytest.mark.parametrize(
    ("system", "machine", "expected"),
    [
        ("linux", "x86_64", LINUX_X86_64),
        ("linux", "aarch64", LINUX_ARM64),
        ("win32", "AMD64", WINDOWS_X86_64),
        ("darwin", "x86_64", MACOS_X86_64),
        ("darwin", "arm64", MACOS_ARM64),
    ],
)
def test_this_platform_is_recognised(monkeypatch, system, machine, expected):
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr("platform.machine", lambda: machine)
    assert host_platform() == expected


def test_a_machine_that_nothing_is_compiled_for_is_named(monkeypatch):
    monkeypatch.setattr("platform.machine", lambda: "riscv64")
    with pytest.raises(ExportError, match="riscv64"):
        host_platform()


def test_without_ziglang_it_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ExportError, match=r"pip install \"\.\[zig\]\""):
        export_fmu(MODEL, tmp_path / "pendulum.fmu", platforms="all")
