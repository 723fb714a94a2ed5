"""The program of a closed loop: a controller's C code, the conditions' and the loop's own, compiled once."""

import ctypes
import hashlib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files as package_files
from pathlib import Path

from ddpc_cosim.conditions import all_conditions
from ddpc_cosim.controller import ControllerCode
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.variables import FloatArray
from fmu_plants.export.compiler import compile_library, find_compiler
from fmu_plants.files import cached
from fmu_plants.model import ExportError

_FUNCTIONS = ("loop_run", "loop_controller_size", "loop_start_controller")
_FLAGS = ("-O3",)  # a loop is run many times; that alone puts no operation before another
NO_CONTROLLER = ControllerCode(
    {
        "controller.h": """#ifndef CONTROLLER_H
#define CONTROLLER_H
typedef struct { double memory[1]; } ControllerState;
void controller_start(ControllerState *state);
unsigned controller_step(ControllerState *state, const double y[], const double r[], double u[]);
#endif
""",
        "controller.c": """#include "controller.h"
void controller_start(ControllerState *state) { state->memory[0] = 0.0; }
unsigned controller_step(ControllerState *state, const double y[], const double r[], double u[])
{
    (void)state; (void)y; (void)r; (void)u;
    return 0;
}
""",
    },
    {},
)
"""What stands in the place of a controller where inputs are given."""
_EFFECTS_HEAD = """/* What conditions do to a signal, from the classes that are installed. */
#include "loop.h"

#include <math.h>
"""
_EFFECT = """static double effect_{number}(double value, double given, double memory[], size_t k)
{{
    (void)value; (void)given; (void)memory; (void)k;
{body}
}}
"""
_CHOICE = """double condition_effect(int64_t kind, double value, double given, double memory[], size_t k)
{{
    switch (kind) {{
{cases}
    default: return value;
    }}
}}
"""


@cache
def effect_numbers() -> Mapping[str, int]:
    """Return by which number the compiled code knows each kind of condition that it has."""
    in_c = (name for name, kind in all_conditions().items() if kind.c_code)
    return {name: number for number, name in enumerate(in_c)}


@cache
def _own_sources() -> Mapping[str, str]:
    """Return the files of the loop itself, by name."""
    runtime = package_files(__name__.rpartition(".")[0]) / "runtime"
    files = {name: (runtime / name).read_text(encoding="utf-8") for name in ("loop.h", "loop.c")}
    return files | {"effects.c": _effects_source()}


def _effects_source() -> str:
    conditions, parts, cases = all_conditions(), [_EFFECTS_HEAD], []
    for name, number in effect_numbers().items():
        body = "\n".join(f"    {line}" for line in conditions[name].c_code.strip().splitlines())
        parts.append(_EFFECT.format(number=number, body=body))
        cases.append(f"    case {number}: return effect_{number}(value, given, memory, k);")
    return "\n".join([*parts, _CHOICE.format(cases="\n".join(cases))])


class Program:
    """A compiled loop with a controller, as this process calls it.

    Parameters
    ----------
    library : Path
        The shared library.
    """

    def __init__(self, library: Path) -> None:
        loaded = ctypes.CDLL(str(library))
        self.run, size, self._start = (getattr(loaded, name) for name in _FUNCTIONS)
        self.run.restype, size.restype = ctypes.c_int64, ctypes.c_size_t
        self.run.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
        self._start.restype, self._start.argtypes = None, [ctypes.c_void_p, ctypes.c_void_p]
        self._size = size()

    def started(self, numbers: FloatArray) -> "ctypes.Array[ctypes.c_char]":
        """Return the state of a controller that has been started, given the numbers of its code."""
        state = ctypes.create_string_buffer(self._size)
        self._start(state, numbers.ctypes.data)
        return state


_programs: dict[frozenset[tuple[str, str]], Program] = {}


def program_of(code: ControllerCode) -> Program:
    """Return the program of a controller's code, compiled where it is new.

    Raises
    ------
    ConfigError
        There is no C compiler, or it does not compile this.
    """
    key = frozenset(code.sources.items())
    if key not in _programs:
        sources = {**code.sources, **_own_sources()}
        digest = hashlib.sha256(repr(sorted(sources.items())).encode()).hexdigest()
        try:
            compiler = find_compiler()
            place = hashlib.sha256(
                " ".join([digest, compiler.identity, *compiler.flags, *_FLAGS]).encode()
            ).hexdigest()
            path = cached(
                f"loops/{place[:16]}/loop{compiler.platform.suffix}",
                lambda: compile_library(compiler, sources, _FUNCTIONS, _FLAGS, keep_objects=True),
            )
            _programs[key] = Program(path)
        except (ExportError, OSError) as error:  # in a sandbox the cache folder is not to be written to
            raise ConfigError(f"the loop cannot be compiled: {error}") from error
    return _programs[key]
