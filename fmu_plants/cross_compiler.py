"""Compiling small libraries for any platform, with the compiler of the Python package ziglang."""

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files as package_files

from fmu_plants.compiler import FLAGS, ZIG, Compiler, zig_identity
from fmu_plants.errors import ExportError
from fmu_plants.platforms import Platform

_NO_ZIG = (
    "compiling for other platforms needs the Python package ziglang, which is not installed: "
    '`pip install "ddpc-cosim[zig]"` (or `pip install ziglang`); without --platforms, the FMU is for this '
    "platform and any C compiler will do."
)

_FOR_SIZE = "-Os"
# Libraries for several platforms are carried about in one file. No exception passes through C code, so that
# nothing unwinds its stack.
_SMALL = (
    _FOR_SIZE,
    "-fomit-frame-pointer",
    "-fno-unwind-tables",
    "-fno-asynchronous-unwind-tables",
    "-fno-ident",
)
# Errors of mathematical functions show in their results, not in errno. Windows is left out: functions without
# errno are operations of the compiler, and call its own code instead of what windows.c imports.
_COMPILE = {
    "linux": ("-fPIC", "-flto", "-fno-plt", "-fno-math-errno"),
    "windows": ("-flto",),
    "darwin": ("-fPIC", "-fno-math-errno"),
}
_WINDOWS_LIBRARIES = tuple(f"-lapi-ms-win-crt-{part}-l1-1-0" for part in ("heap", "math", "stdio", "string"))
_LINK = {
    # The newer style of hash table has a filter of random bits, which does not compress.
    "linux": ("-flto", "-Wl,--hash-style=sysv", "-Wl,--build-id=none", "-lm"),
    # The startup code of MinGW is for C++ and for thread-local data; see windows.c.
    "windows": ("-flto", "-nostdlib", *_WINDOWS_LIBRARIES),
    "darwin": ("-Wl,-x", "-lm"),
}
_UNIT, _OBJECT = "library.c", "library.o"
_WINDOWS_SOURCE = "windows.c"


@dataclass(frozen=True, slots=True)
class CrossCompiler(Compiler):
    """A compiler for several platforms in turn, and for size instead of speed.

    It sees all sources as one file: its linker for macOS does not optimise across several.
    """

    @property
    def flags(self) -> tuple[str, ...]:
        """The arguments for the object file, without files."""
        return (*FLAGS, *_SMALL, *_COMPILE[self.platform.system])

    @property
    def libraries(self) -> tuple[str, ...]:
        """The arguments that come after the object file."""
        return _LINK[self.platform.system]

    def own_files(self, sources: Sequence[str]) -> dict[str, str]:
        """Return the source that includes all others, by name, and what Windows needs."""
        if self.platform.system != "windows":
            return {_UNIT: _including(sources)}
        runtime = package_files("fmu_plants") / "runtime"
        windows = (runtime / _WINDOWS_SOURCE).read_text(encoding="utf-8")
        return {_UNIT: _including([_WINDOWS_SOURCE, *sources]), _WINDOWS_SOURCE: windows}

    def calls(self, sources: Sequence[str], library: str, extra_flags: Sequence[str]) -> list[list[str]]:
        """Return the arguments for compiling, where the system's headers are found, and for linking."""
        return [
            [*self.flags, *extra_flags, "-I.", "-c", "-o", _OBJECT, _UNIT],
            ["-shared", "-s", _FOR_SIZE, "-o", library, _OBJECT, *self.libraries],
        ]


def cross_compiler(platform: Platform) -> CrossCompiler:
    """Return the compiler of the ziglang package for any platform, this one included.

    Raises
    ------
    ExportError
        ziglang is not installed.
    """
    if not importlib.util.find_spec("ziglang"):
        raise ExportError(_NO_ZIG)
    target = ("-target", platform.zig_target)
    return CrossCompiler((*ZIG, *target), f"{zig_identity()} {platform.zig_target}", platform)


def _including(sources: Sequence[str]) -> str:
    return "".join(f'#include "{name}"\n' for name in sources)
