"""Finding C compilers, for this machine and for any platform, and making shared libraries with them."""

import hashlib
import importlib.metadata
import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files as package_files
from pathlib import Path

from fmu_plants.commands import captured
from fmu_plants.export.binaries import exported_symbols
from fmu_plants.export.platforms import Platform, host_platform
from fmu_plants.files import cache_dir, cached
from fmu_plants.installing import how_to_install
from fmu_plants.model import ExportError

# The largest FMUs take some minutes.
_LONGEST_SECONDS = 600.0
_SYSTEM_COMPILERS = ("cc", "gcc", "clang")
_NO_COMPILER = (
    "no C compiler was found (looked for $CC, {names} on PATH, and the Python package ziglang).\n"
    "Install one of them: `pip install ziglang` works everywhere; Debian/Ubuntu: `apt install gcc`; "
    "macOS: `xcode-select --install`; or set CC to the compiler's command."
)

# Results must be the same on every machine: no -ffast-math, no fused operations, nothing of the host's
# processor.
FLAGS = ("-std=c11", "-ffp-contract=off", "-fvisibility=hidden")
_FAST = ("-O2", "-shared")
_OF_LINKING = ("-shared", "-s")
_INCLUSION = re.compile(r'^[ \t]*#[ \t]*include[ \t]*"([^"]+)"', re.MULTILINE)
ZIG = (sys.executable, "-P", "-m", "ziglang", "cc")  # -P: nothing in the current folder is a module

_NO_ZIG = (
    "compiling for other platforms needs the Python package ziglang, which is not installed: "
    f"{how_to_install('zig')} (or `pip install ziglang`); without --platforms, the FMU is for this platform "
    "and any C compiler will do."
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
# errno are operations of the compiler, and call its own code instead of what windows_math.h imports.
_COMPILE = {
    "linux": ("-fPIC", "-flto", "-fno-plt", "-fno-math-errno"),
    "windows": ("-flto",),
    "darwin": ("-fPIC", "-fno-math-errno"),
}
_WINDOWS_PARTS = ("convert", "heap", "locale", "math", "stdio", "string")
_WINDOWS_LIBRARIES = tuple(f"-lapi-ms-win-crt-{part}-l1-1-0" for part in _WINDOWS_PARTS)
_LINK = {
    # The newer style of hash table has a filter of random bits, which does not compress.
    "linux": ("-flto", "-Wl,--hash-style=sysv", "-Wl,--build-id=none", "-lm"),
    # The startup code of MinGW is for C++ and for thread-local data; see windows.c.
    "windows": ("-flto", "-nostdlib", *_WINDOWS_LIBRARIES),
    "darwin": ("-Wl,-x", "-lm"),
}
_UNIT = "library.c"
_WINDOWS_SOURCE, _WINDOWS_HEADER = "windows.c", "windows_math.h"


@dataclass(frozen=True, slots=True)
class Compiler:
    """A C compiler.

    Parameters
    ----------
    command : tuple of str
        How it is called, up to its arguments.
    identity : str
        Differs between two compilers that may give different code.
    platform : Platform
        What it compiles for; this machine by default.
    """

    command: tuple[str, ...]
    identity: str
    platform: Platform = field(default_factory=host_platform)

    @property
    def flags(self) -> tuple[str, ...]:
        """The arguments for a shared library, without files."""
        system = self.platform.system
        if system == "windows":
            return (*FLAGS, *_FAST)  # code is always position independent there
        return (*FLAGS, *_FAST, "-fPIC", *(("-s",) if system == "linux" else ()))

    @property
    def libraries(self) -> tuple[str, ...]:
        """The arguments that come after the files."""
        return () if self.platform.system == "windows" else ("-lm",)

    def build(
        self,
        sources: Sequence[str],
        library: str,
        extra_flags: Sequence[str],
        folder: Path,
        apart: Collection[str] = (),
    ) -> None:
        """Make a shared library of the sources in a folder, with headers from there.

        ``apart`` are those whose names within a file may be those within another one.

        Raises
        ------
        ExportError
            See `run`.
        """
        self.run([*self.flags, *extra_flags, "-I.", "-o", library, *sources, *self.libraries], folder)

    def run(self, arguments: Sequence[str], folder: Path) -> None:
        """Call it in a folder.

        Raises
        ------
        ExportError
            It fails, cannot be run or does not end; the message has what the compiler says, and the call.
        """
        command = [*self.command, *arguments]
        environment = {**os.environ}
        if self.command[: len(ZIG)] == ZIG:
            try:
                zig_cache = str(cache_dir() / "zig")
            except OSError as error:
                raise ExportError(str(error)) from error
            environment = {"ZIG_GLOBAL_CACHE_DIR": zig_cache, "ZIG_LOCAL_CACHE_DIR": zig_cache} | environment
        try:
            done = _output_of(command, cwd=folder, env=environment)
        except OSError as error:
            reason = f"the C compiler {command[0]} cannot be run: {error}; set CC to another one"
            raise ExportError(reason) from error
        if done.returncode != 0:
            output = (done.stderr or done.stdout).strip()
            call = shlex.join(command)
            raise ExportError(
                f"the C compiler failed (exit code {done.returncode}):\n{output}\nThe call: {call}"
            )


@dataclass(frozen=True, slots=True)
class CrossCompiler(Compiler):
    """A compiler for several platforms in turn, and for size instead of speed.

    It sees all sources but those apart as one file: its linker for macOS does not optimise across several.
    """

    @property
    def flags(self) -> tuple[str, ...]:
        """The arguments for the object file, without files."""
        return (*FLAGS, *_SMALL, *_COMPILE[self.platform.system])

    @property
    def libraries(self) -> tuple[str, ...]:
        """The arguments that come after the object file."""
        return _LINK[self.platform.system]

    def build(
        self,
        sources: Sequence[str],
        library: str,
        extra_flags: Sequence[str],
        folder: Path,
        apart: Collection[str] = (),
    ) -> None:
        """Compile, where the system's headers are found, and link."""
        alone = [name for name in sources if name in apart]
        together = [name for name in sources if name not in apart]
        before = list[str]()
        if self.platform.system == "windows":
            for name in (_WINDOWS_SOURCE, _WINDOWS_HEADER):
                content = (package_files("fmu_plants") / "runtime" / name).read_bytes()
                (folder / name).write_bytes(content)
            together, before = [_WINDOWS_SOURCE, *together], [_WINDOWS_HEADER]
        units = {_UNIT: together} | {
            f"{number}_{_UNIT}": [*before, name] for number, name in enumerate(alone)
        }
        objects = []
        for unit, names in units.items():
            text = "".join(f'#include "{name}"\n' for name in names)
            (folder / unit).write_text(text, encoding="utf-8", newline="\n")
            objects.append(str(Path(unit).with_suffix(".o")))
            self.run([*self.flags, *extra_flags, "-I.", "-c", "-o", objects[-1], unit], folder)
        self.run(["-shared", "-s", _FOR_SIZE, "-o", library, *objects, *self.libraries], folder)


def find_compiler() -> Compiler:
    """Return ``$CC``, the system's compiler, or that of the ziglang package, whichever is there first.

    Raises
    ------
    ExportError
        There is none, or ``$CC`` cannot be run.
    """
    if command := os.environ.get("CC"):
        return _from_environment(command)
    for name in _SYSTEM_COMPILERS:
        if path := shutil.which(name):
            return Compiler((path,), _identity(path))
    if importlib.util.find_spec("ziglang"):
        return Compiler(ZIG, zig_identity())
    raise ExportError(_NO_COMPILER.format(names=", ".join(_SYSTEM_COMPILERS)))


def zig_identity() -> str:
    """Return name and version of the ziglang package."""
    return f"ziglang {importlib.metadata.version('ziglang')}"


def _from_environment(command: str) -> Compiler:
    """Read ``$CC``: a path, or a command with arguments."""
    if whole := shutil.which(command):  # a path with spaces is not to be split
        return Compiler((whole,), _identity(whole))
    program, *arguments = shlex.split(command, posix=os.name == "posix") or [""]
    path = shutil.which(program)
    if path is None:
        raise ExportError(f"the C compiler of the environment variable CC was not found: {command!r}")
    return Compiler((path, *arguments), " ".join([_identity(path), *arguments]))


def _identity(path: str) -> str:
    """Tell compilers apart without running them: an update changes size and date."""
    program = Path(path).resolve()
    status = program.stat()
    return f"{program} {status.st_size} {status.st_mtime_ns}"


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


def compile_library(
    compiler: Compiler,
    files: Mapping[str, str],
    required: Sequence[str],
    extra_flags: Sequence[str] = (),
    apart: Collection[str] = (),
    *,
    keep_objects: bool = False,
) -> bytes:
    """Compile and link C files to a shared library.

    Parameters
    ----------
    compiler : Compiler
    files : mapping of str to str
        Text of sources and headers by file name.
    required : sequence of str
        Names of the functions that the library must export.
    extra_flags : sequence of str
        Further arguments, for example stricter warnings.
    apart : collection of str
        Sources that may use the same names within a file as others.
    keep_objects : bool
        Whether to keep in the cache folder what each source is compiled to, for other libraries that have
        some of the same sources.

    Raises
    ------
    ExportError
        The compiler fails, or the library does not load or export what it must.
    OSError
        What is to be kept cannot be written to the cache folder.
    """
    with tempfile.TemporaryDirectory(prefix="fmu-plants-") as name:
        folder, platform = Path(name), compiler.platform
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8", newline="\n")
        # Everything is named relative to one folder: nothing depends on how its path is spelt.
        built = folder / f"library{platform.suffix}"
        sources = sorted(name for name in files if name.endswith(".c"))
        if keep_objects:
            sources = [_object(compiler, files, name, folder, extra_flags) for name in sources]
        compiler.build(sources, built.name, extra_flags, folder, apart)
        missing = (_unloadable if platform == host_platform() else _unlisted)(built, required)
        if missing:
            builder = f"the library for {platform.name} built by {compiler.command[0]}"
            raise ExportError(f"{builder} does not export: {', '.join(missing)}")
        return built.read_bytes()


def _object(
    compiler: Compiler, files: Mapping[str, str], source: str, folder: Path, extra_flags: Sequence[str]
) -> str:
    """Put into a folder that has all files what one of them is compiled to, and return its name there."""
    included, new = dict[str, str](), [source]
    while new:
        included |= {name: files[name] for name in new}
        inclusions = {name for text in included.values() for name in _INCLUSION.findall(text)}
        new = sorted(inclusions & files.keys() - included.keys())
    flags = [flag for flag in (*compiler.flags, *extra_flags) if flag not in _OF_LINKING]
    digest = hashlib.sha256(repr([compiler.identity, flags, sorted(included.items())]).encode()).hexdigest()
    built = folder / f"{source}.o"

    def compile_it() -> bytes:
        compiler.run([*flags, "-I.", "-c", "-o", built.name, source], folder)
        return built.read_bytes()

    built.write_bytes(cached(f"objects/{digest[:16]}/{built.name}", compile_it).read_bytes())
    return built.name


def _output_of(
    command: Sequence[str], cwd: Path | None = None, env: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    try:
        return captured(command, _LONGEST_SECONDS, cwd=cwd, env=env)
    except subprocess.TimeoutExpired as error:
        raise ExportError(
            f"{command[0]} did not end within {_LONGEST_SECONDS:g} s and was ended, with all that it had "
            f"started; if it hangs, set CC to another compiler\nThe call: {shlex.join(command)}"
        ) from error


_EXPORT_CHECK = """
import ctypes, sys
library = ctypes.CDLL(sys.argv[1])
print(*[name for name in sys.argv[2:] if not hasattr(library, name)])
"""


def _unloadable(library: Path, required: Sequence[str]) -> list[str]:
    """Ask a process of its own: a defective library may bring it down, and the file stays free to delete."""
    command = [sys.executable, "-I", "-S", "-c", _EXPORT_CHECK, str(library), *required]
    done = _output_of(command)
    if done.returncode != 0:
        reason = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise ExportError(f"the library that was built cannot be loaded: {reason}")
    return done.stdout.split()


def _unlisted(library: Path, required: Sequence[str]) -> list[str]:
    """Read the file: a library for another platform cannot be loaded."""
    try:
        exported = exported_symbols(library.read_bytes())
    except (OSError, ValueError) as error:
        raise ExportError(f"the library that was built cannot be read: {error}") from error
    return [name for name in required if name not in exported]
