"""Checks of the libraries and sources of an unpacked FMU: whether it can run on this machine."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ddpc_cosim.errors import FMUImportError
from ddpc_cosim.fmu.archive import is_file_name
from ddpc_cosim.fmu.build import compile_sources, described_sources, has_sources, is_source
from ddpc_cosim.fmu.companions import EVERYWHERE, missing_for_good, say_nothing
from ddpc_cosim.fmu.description import FMUDescription, Interface, InterfaceKind
from ddpc_cosim.fmu.description.defects import Findings, Kind, Severity
from ddpc_cosim.fmu.library import library_extension, library_in, listed, platform_folders, platforms
from fmu_plants.commands import captured
from fmu_plants.installing import how_to_install

Route = Literal["binary", "sources", ""]
"""How an FMU can run here: its library, its sources compiled here, or not at all."""

_ERROR, _WARNING, _NOTE = Severity.ERROR, Severity.WARNING, Severity.NOTE
NO_BINARY = Kind("no-binary", _ERROR, "neither a binary for this platform nor sources")
NO_COMPILER = Kind(
    "no-compiler",
    _ERROR,
    "sources but no binary for this platform, and no C compiler here",
    f"install one, or ziglang: {how_to_install('zig')}",
)
COMPILED = Kind("compiled-here", _NOTE, "sources but no binary for this platform", "they are compiled here")
UNCOMPILED = Kind("uncompiled", _ERROR, "no binary for this platform, and C sources that cannot be compiled")
UNRESOLVED = Kind(
    "unresolved", _ERROR, "the C sources lack functions that they call", "export the FMU with a binary"
)
UNNAMED_LIBRARY = Kind(
    "unnamed-library",
    _WARNING,
    "the library is not named after modelIdentifier",
    "the only one in the folder, or the only one with functions of FMI, is used",
)
FOREIGN_LIBRARY = Kind("foreign-library", _ERROR, "the library for this platform is one for another")
CUT_OFF_LIBRARY = Kind("cut-off-library", _ERROR, "the library is cut off", "copy or export the FMU again")
NO_EXECUTION = Kind(
    "no-execution",
    _ERROR,
    "no library can be loaded from the folder of temporary files, which is mounted with noexec",
    "set TMPDIR to another folder",
)
MISPLACED_LIBRARY = Kind(
    "misplaced-library", _NOTE, "the library's folder is named as in another FMI version", "it is used"
)
NO_FUNCTIONS = Kind(
    "no-functions", _ERROR, "the library lacks functions without which it cannot run", "export it again"
)
NO_LIBRARY = Kind(
    "missing-library",
    _ERROR,
    "the FMU's library needs others that are neither in the FMU nor on this machine",
    "install them, or give their folder: plant.library_path of a study, --library-path",
)
STAND_IN = Kind(
    "stand-in",
    _WARNING,
    "the FMU's library needs others, of old compilers, that are neither in the FMU nor on this machine",
    "stand-ins are compiled, which have the functions that the FMU takes from them",
)
BAD_SOURCES = Kind(
    "bad-sources", _WARNING, "the description of the C sources cannot be used", "they are not compiled"
)
NO_SOURCE_FILE = Kind("no-source-file", _WARNING, "source files that are listed but missing")

_MAGIC = {"linux": b"\x7fELF", "win32": b"MZ", "darwin": b"\xcf\xfa\xed\xfe"}
_UNIVERSAL_MAGIC = b"\xca\xfe\xba\xbe"
_COMMON = {
    2: ("EnterInitializationMode", "ExitInitializationMode", "Instantiate"),
    3: ("EnterInitializationMode", "ExitInitializationMode"),
}
_NEEDED: Mapping[tuple[int, InterfaceKind], tuple[str, ...]] = {
    (1, "co-simulation"): ("InstantiateSlave", "InitializeSlave", "DoStep"),
    (1, "model-exchange"): ("InstantiateModel", "Initialize", "SetTime"),
    (2, "co-simulation"): (*_COMMON[2], "DoStep"),
    (2, "model-exchange"): (*_COMMON[2], "GetDerivatives", "SetContinuousStates", "SetTime"),
    (3, "co-simulation"): (*_COMMON[3], "DoStep", "InstantiateCoSimulation"),
    (3, "model-exchange"): (*_COMMON[3], "InstantiateModelExchange", "SetTime"),
}

_LONGEST_LOADING = 30.0
_LONGEST_HEADER = 4096
# In a process of its own: libraries may do anything when they are loaded.
_LOADING = """
import ctypes, sys
for name in sys.argv[1:]:
    try:
        ctypes.CDLL(name)
    except OSError:
        print(name)
"""


@dataclass(frozen=True, slots=True)
class Binaries:
    """What an FMU brings to run on.

    Parameters
    ----------
    platforms : tuple of str
        Folders of binaries.
    has_sources : bool
        Whether there are C files.
    route : str
        How it can run here.
    """

    platforms: tuple[str, ...]
    has_sources: bool
    route: Route


def check_binaries(
    folder: Path,
    description: FMUDescription | None,
    label: str,
    findings: Findings,
    library_path: Sequence[Path] = (),
    tell: Callable[[str], object] = say_nothing,
) -> Binaries:
    """Check the library for this platform, or compile the sources, for the interface that is preferred.

    ``library_path`` has further libraries, as of :class:`ddpc_cosim.FMUPlant`; ``tell`` is called with a line
    before anything is compiled.
    """
    sources = description is not None and _check_sources(folder, description, label, findings)
    route: Route = ""
    if description is not None and (interface := description.preferred) is not None:
        route, library = _find_library(folder, description, interface, label, sources, findings, tell)
        if library is not None and not _is_sound(
            library, description.major, interface, folder, route, findings, library_path
        ):
            route = ""
    if route and _forbids_execution(folder):
        findings.add(NO_EXECUTION, tempfile.gettempdir())
        route = ""
    return Binaries(tuple(platforms(folder)), has_sources(folder), route)


def _find_library(
    folder: Path,
    description: FMUDescription,
    interface: Interface,
    label: str,
    sources: bool,
    findings: Findings,
    tell: Callable[[str], object],
) -> tuple[Route, Path | None]:
    """Return how an FMU can run here, and its library, which is compiled if there are only sources."""
    major, identifier = description.major, interface.model_identifier
    wanted = f"{identifier}{library_extension()}"
    folders = platform_folders(major)
    for place in folders:
        library = library_in(folder / "binaries" / place, identifier, major)
        if library is not None:
            if library.name != wanted:
                findings.add(UNNAMED_LIBRARY, f"{place}/{library.name} instead of {wanted}")
            if place != folders[0]:
                findings.add(MISPLACED_LIBRARY, f"{place} instead of {folders[0]}")
            return "binary", library
    if not sources:
        findings.add(NO_BINARY, f"binaries/{folders[0]}/{wanted}; there are {listed(folder)}")
        return "", None
    if not _has_compiler():
        findings.add(NO_COMPILER, f"binaries/{folders[0]}/{wanted}")
        return "", None
    if not is_file_name(identifier):  # which is told elsewhere
        return "", None
    library = folder / "binaries" / folders[0] / wanted
    try:
        compile_sources(folder, description, identifier, library, label, tell, only_looking=True)
    except FMUImportError as error:
        findings.add(UNCOMPILED, str(error).removeprefix(f"{label}: "))
        return "", None
    findings.add(COMPILED, f"binaries/{folders[0]}/{wanted}")
    return "sources", library


def _is_sound(
    library: Path,
    major: int,
    interface: Interface,
    folder: Path,
    route: Route,
    findings: Findings,
    library_path: Sequence[Path],
) -> bool:
    """Whether a library can be loaded and has what it must, as far as its file says."""
    from fmu_plants.export.binaries import is_cut_off, processor

    content = library.read_bytes()
    if not content.startswith((_MAGIC.get(sys.platform, b""), _UNIVERSAL_MAGIC)):
        findings.add(FOREIGN_LIBRARY, f"{library.parent.name}/{library.name}")
        return False
    its, here = processor(content), _own_processor()
    if its and here and its != here:
        findings.add(FOREIGN_LIBRARY, f"{library.parent.name}/{library.name} is for {its}, not {here}")
        return False
    if is_cut_off(content):
        findings.add(CUT_OFF_LIBRARY, f"{library.parent.name}/{library.name}, {len(content)} bytes")
        return False
    prefixes = [f"{name}_" for name in (interface.model_identifier, library.stem)]
    missing = _missing_functions(content, major, interface.kind, prefixes)
    if missing:
        findings.add(NO_FUNCTIONS, ", ".join(missing))
        return False
    if route == "sources" and (unresolved := _unresolved(content)):
        findings.add(UNRESOLVED, ", ".join(unresolved))
        return False
    return _has_companions(library, folder / "resources", library_path, findings)


def _unresolved(content: bytes) -> list[str]:
    """Return what a library compiled here calls, and none that it is linked with has.

    What the linker has found has a version, where the system's libraries have any.
    """
    from fmu_plants.export.binaries import wanted_symbols

    wanted = wanted_symbols(content)
    if not any(symbol.version for symbol in wanted):
        return []
    return sorted(symbol.name for symbol in wanted if not symbol.version)


def _has_companions(library: Path, resources: Path, library_path: Sequence[Path], findings: Findings) -> bool:
    """Whether all libraries that an FMU's needs are there, or stand-ins for them can be compiled."""
    old = missing_for_good(library, resources, library_path)
    replaced = [name for name, reason in old.items() if not reason]
    if replaced:
        findings.add(STAND_IN, ", ".join(replaced))
    absent = [name for name in _missing_libraries(library, resources, library_path) if name not in old]
    absent += [f"{name} ({reason})" for name, reason in old.items() if reason]
    if absent:
        findings.add(NO_LIBRARY, ", ".join(absent))
    return not absent


def _own_processor() -> str:
    """Return the processor that this Python is for, in the words of the libraries."""
    from fmu_plants.export.binaries import processor

    with suppress(OSError), Path(sys.executable).open("rb") as program:
        return processor(program.read(_LONGEST_HEADER))
    return ""


def _forbids_execution(folder: Path) -> bool:
    if sys.platform == "win32":
        return False
    return bool(os.statvfs(folder).f_flag & getattr(os, "ST_NOEXEC", 0))


def _missing_libraries(library: Path, resources: Path, library_path: Sequence[Path]) -> list[str]:
    """Return the libraries that an FMU's needs and that are neither in the FMU nor in the system (Linux)."""
    from fmu_plants.export.binaries import needed_libraries

    if not sys.platform.startswith("linux"):
        return []
    try:
        needed, run_path = needed_libraries(library.read_bytes())
    except ValueError:  # damaged: the loader will tell
        return []
    bundled = {path.name for folder in (library.parent, resources) for path in folder.rglob("*.so*")}
    bundled |= {place.name for place in library_path if place.is_file()}
    bundled |= {name for name in needed for place in library_path if (place / name).is_file()}
    origin = str(library.parent)
    folders = [Path(p.replace("${ORIGIN}", origin).replace("$ORIGIN", origin)) for p in run_path]
    # A path would have this very file loaded, wherever it leads: looking at an FMU must not do that.
    foreign = [name for name in needed if name not in bundled | EVERYWHERE and "/" not in name]
    elsewhere = [name for name in foreign if not any((folder / name).is_file() for folder in folders)]
    return _not_in_system(elsewhere) if elsewhere else []


def _not_in_system(names: Sequence[str]) -> list[str]:
    try:
        done = captured([sys.executable, "-I", "-c", _LOADING, *names], _LONGEST_LOADING)
        done.check_returncode()
    except (OSError, subprocess.SubprocessError):  # nothing is known then
        return []
    return [name for name in names if name in done.stdout.splitlines()]


def _missing_functions(content: bytes, major: int, kind: InterfaceKind, prefixes: Sequence[str]) -> list[str]:
    """Return the functions that are missing; FMI 1.0 has a prefix, others have it from static linking."""
    from fmu_plants.export.binaries import exported_symbols

    plain = "fmi" if major == 1 else f"fmi{major}"
    try:
        exported = exported_symbols(content)
    except ValueError:  # 32 bit, or several processors in one file: the loader will tell
        return []
    if not exported:  # section headers may have been stripped: the loader will tell too
        return []
    shown = prefixes[0] + plain if major == 1 else plain
    return [
        shown + name
        for name in _NEEDED[major, kind]
        if not any(prefix + plain + name in exported for prefix in (*prefixes, ""))
    ]


def _check_sources(folder: Path, description: FMUDescription, label: str, findings: Findings) -> bool:
    """Note what is wrong with the sources, and return whether there are any to compile."""
    try:
        described = described_sources(folder, description, label)
    except FMUImportError as error:
        findings.add(BAD_SOURCES, str(error))
        return False
    for name in dict.fromkeys(name for source_set in described for name in source_set.files):
        if not is_source(folder / "sources", name):
            findings.add(NO_SOURCE_FILE, f"sources/{name}")
    return has_sources(folder)


def _has_compiler() -> bool:
    from fmu_plants import ExportError
    from fmu_plants.export.compiler import find_compiler

    try:
        find_compiler()
    except ExportError:
        return False
    return True
