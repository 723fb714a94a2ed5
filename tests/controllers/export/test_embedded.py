"""The C code as embedded code: analysed, without a heap, without data of its own that change."""

import re
import shutil
import subprocess
from dataclasses import replace
from functools import cache
from importlib.resources import files as package_files
from pathlib import Path
from typing import Any

import pytest

from controllers.export.compiled import STRICT
from controllers.export.loops import COUPLED, PENDULUM, Bench
from controllers.test_foresight import PLANTS, make
from ddpc_controllers import (
    GPC,
    IPID,
    LQR,
    MFAPC,
    MPC,
    PID,
    WKPC,
    BandEdge,
    Cascade,
    Decentralised,
    DeePC,
    Group,
    KoopmanMPC,
    OffsetFree,
    SafetyFilter,
    Scaled,
)
from ddpc_cosim import Controller, ControllerCode, Loop

LOOPS = [
    Group(inputs=["u0"], outputs=["x0"], controller=IPID(alpha=4.0)),
    Group(inputs=["u1"], outputs=["x1"], controller=PID(proportional=0.2)),
]


class Regulated:
    """A loop with disturbances, a band, limits that move and prices."""

    def loop(self) -> tuple[Loop, None]:
        return replace(make(PLANTS["two inputs, two outputs"], 160), preview=5), None


CONTROLLERS: dict[str, tuple[Bench | Regulated, Controller]] = {
    "band-edge": (Regulated(), BandEdge(margin=0.1, controller=PID(proportional=0.2, integral=0.1))),
    "band-edge-both": (Regulated(), BandEdge(edge="both", margin=0.1, controller=MPC(horizon=6))),
    "cascade": (PENDULUM, Cascade(inner=PID(proportional=2.0), outer=IPID(alpha=2.0), outer_period=3)),
    "decentralised": (COUPLED, Scaled(controller=Decentralised(groups=LOOPS))),
    "deepc": (PENDULUM, DeePC()),
    "deepc-regulated": (Regulated(), DeePC(horizon=6)),
    "gpc": (COUPLED, GPC(rate_bounds=0.3)),
    "koopman-mpc": (PENDULUM, KoopmanMPC()),
    "mfapc": (PENDULUM, MFAPC(form="ffdl", rate_bounds=0.3)),
    "mpc": (COUPLED, MPC()),
    "offset-free": (PENDULUM, OffsetFree(controller=LQR())),
    "safety-filter": (Regulated(), SafetyFilter(controller=LQR(), steps_ahead=6)),
    "wkpc": (PENDULUM, WKPC()),
}
# What the code may take from a C library: no heap, no files, nothing that ends a process.
ALLOWED = {"memcpy", "memset", "memmove", "_GLOBAL_OFFSET_TABLE_"}
ALLOWED |= {"exp", "fabs", "floor", "fmax", "fmin", "hypot", "log", "log10", "pow", "sqrt"}
_PROBE = """#include <stdio.h>
#include "controller.h"
int main(void) { printf("%u", (unsigned)sizeof(ControllerState)); return 0; }
"""
_DOUBLE = r"= -?(?:\d+\.\d*(?:e[-+]\d+)?|\d+e[-+]\d+|INFINITY|NAN)(?=[,}])"
"""A member of a structure that is a number, and no count."""


@cache
def code_of(name: str) -> ControllerCode:
    bench, controller = CONTROLLERS[name]
    loop, _ = bench.loop()
    controller.start(loop)
    return controller.c_code(loop)


def tool(name: str, *arguments: Any) -> str:
    """Return what a program prints; it must be there and succeed."""
    path = shutil.which(name)
    assert path, f"{name} is not installed"
    done = subprocess.run([path, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def written(name: str, folder: Path) -> list[Path]:
    for file, text in code_of(name).sources.items():
        (folder / file).write_text(text, encoding="utf-8")
    return sorted(folder.glob("*.c"))


def symbols(objects: list[Path], *options: str) -> dict[str, set[str]]:
    """Return the names in object files by their kind, a letter of nm."""
    by_kind: dict[str, set[str]] = {}
    for line in tool("nm", "-P", *options, *objects).splitlines():
        words = line.split()
        if len(words) >= 2 and len(words[1]) == 1:
            by_kind.setdefault(words[1], set()).add(words[0])
    return by_kind


@pytest.mark.parametrize("name", CONTROLLERS)
def test_it_takes_nothing_from_the_c_library_but_mathematics(name: str, tmp_path: Path) -> None:
    sources = written(name, tmp_path)
    objects = []
    for source in sources:
        objects.append(source.with_suffix(".o"))
        tool("cc", *STRICT, "-fno-pic", "-fno-pie", "-c", "-o", objects[-1], source)
    kinds = symbols(objects)
    defined = set().union(*(names for kind, names in kinds.items() if kind != "U"))
    assert kinds["U"] - defined <= ALLOWED
    # Data that can change, of a file's own or common: several controllers run side by side.
    assert not {kind: names for kind, names in kinds.items() if kind in "bBcCdDgGsS"}
    assert {"controller_start", "controller_step"} <= kinds["T"]


@pytest.mark.parametrize("name", CONTROLLERS)
def test_its_footprint_is_what_the_compiler_makes_of_it(name: str, tmp_path: Path) -> None:
    written(name, tmp_path)
    code = code_of(name)
    assert code.footprint
    probe = tmp_path / "probe.c"
    probe.write_text(_PROBE, encoding="utf-8")
    tool("cc", *STRICT, "-o", tmp_path / "probe", probe)
    assert int(tool(str(tmp_path / "probe"))) == code.footprint.state

    text, compiled = code.sources["controller.c"], tmp_path / "controller.o"
    tool("cc", "-std=c99", "-O0", "-fno-pic", "-fno-pie", "-c", "-o", compiled, tmp_path / "controller.c")
    lines = [line.split() for line in tool("nm", "-P", "-t", "d", compiled).splitlines()]
    sizes = {words[0]: int(words[3]) for words in lines if words[1] == "r"}
    tables = sum(sizes[table] for table in re.findall(r"^static const double (\w+)\[", text, re.MULTILINE))
    structures = re.findall(r"^static const \w+ \w+ = .*", text, re.MULTILINE)
    members = sum(len(re.findall(_DOUBLE, structure)) for structure in structures)
    assert tables + 8 * members == code.footprint.constants


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_static_analyser_finds_nothing(name: str, tmp_path: Path) -> None:
    checks = "--enable=warning,style,performance,portability"
    quiet = ["--quiet", "--std=c99", "--error-exitcode=1", "--suppress=missingIncludeSystem"]
    tool("cppcheck", checks, *quiet, "-I", tmp_path, *written(name, tmp_path))


def test_all_kernels_are_among_those_that_are_tried() -> None:
    folder = Path(str(package_files("ddpc_controllers") / "export" / "runtime"))
    used = set().union(*(code_of(name).sources for name in CONTROLLERS))
    assert {file.name for file in folder.rglob("*.c")} <= used
