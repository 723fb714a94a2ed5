"""Checks of the libraries and sources of an unpacked FMU: whether it can run on this machine."""

import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

from ddpc_cosim.fmu.build import has_sources
from ddpc_cosim.fmu.library import library_extension, library_in, listed, platform_folders, platforms
from ddpc_cosim.inspection.defects import Findings, Kind, Severity
from ddpc_cosim.inspection.raw_description import Declared

Route = Literal["binary", "sources", ""]
"""How an FMU can run here: its library, its sources compiled here, or not at all."""

_ERROR, _WARNING, _NOTE = Severity.ERROR, Severity.WARNING, Severity.NOTE
NO_BINARY = Kind("no-binary", _ERROR, "neither a binary for this platform nor sources")
NO_COMPILER = Kind(
    "no-compiler",
    _ERROR,
    "sources but no binary for this platform, and no C compiler here",
    'install one, or ziglang: pip install "ddpc-cosim[zig]"',
)
COMPILED = Kind(
    "compiled-here", _NOTE, "sources but no binary for this platform", "they are compiled at the first use"
)
UNNAMED_LIBRARY = Kind(
    "unnamed-library",
    _WARNING,
    "the library is not named after modelIdentifier",
    "the only one in the folder, or the only one with functions of FMI, is used",
)
FOREIGN_LIBRARY = Kind("foreign-library", _ERROR, "the library for this platform is one for another")
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
    "install them, or add their folder to LD_LIBRARY_PATH",
)
NO_SOURCE_FILE = Kind("no-source-file", _WARNING, "source files that are listed and not there")

_MAGIC = {"linux": b"\x7fELF", "win32": b"MZ", "darwin": b"\xcf\xfa\xed\xfe"}
_UNIVERSAL_MAGIC = b"\xca\xfe\xba\xbe"
_COMMON = {
    2: ("EnterInitializationMode", "ExitInitializationMode", "Instantiate"),
    3: ("EnterInitializationMode", "ExitInitializationMode"),
}
_NEEDED: Mapping[tuple[int, str], tuple[str, ...]] = {
    (1, "CoSimulation"): ("InstantiateSlave", "InitializeSlave", "DoStep"),
    (1, "ModelExchange"): ("InstantiateModel", "Initialize", "SetTime"),
    (2, "CoSimulation"): (*_COMMON[2], "DoStep"),
    (2, "ModelExchange"): (*_COMMON[2], "GetDerivatives", "SetContinuousStates", "SetTime"),
    (3, "CoSimulation"): (*_COMMON[3], "DoStep", "InstantiateCoSimulation"),
    (3, "ModelExchange"): (*_COMMON[3], "InstantiateModelExchange", "SetTime"),
}

_LONGEST_TRIAL = 30.0
# Python itself would not run without them; what is looked for takes a process.
_EVERYWHERE = {
    "libc.so.6",
    "libm.so.6",
    "libpthread.so.0",
    "libdl.so.2",
    "librt.so.1",
    "ld-linux-x86-64.so.2",
}
# In a process of its own: libraries may do anything when they are loaded.
_TRIAL = """
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


def check_binaries(folder: Path, declared: Declared, findings: Findings) -> Binaries:
    """Check the library for this platform and the sources; Co-Simulation is preferred, as when it runs."""
    sources = _check_sources(folder, declared, findings)
    route: Route = ""
    if declared.preferred:
        route = _check_library(folder, declared, declared.preferred, sources, findings)
    return Binaries(tuple(platforms(folder)), sources, route)


def _check_library(
    folder: Path, declared: Declared, interface: str, sources: bool, findings: Findings
) -> Route:
    attributes = declared.interfaces[interface]
    identifier = attributes.get("modelIdentifier", "")
    wanted = f"{identifier}{library_extension()}"
    folders = platform_folders(declared.major)
    for place in folders:
        library = library_in(folder / "binaries" / place, identifier, declared.major)
        if library is not None:
            if library.name != wanted:
                findings.add(UNNAMED_LIBRARY, f"{place}/{library.name} instead of {wanted}")
            if place != folders[0]:
                findings.add(MISPLACED_LIBRARY, f"{place} instead of {folders[0]}")
            return _check_content(library, declared, interface, folder / "resources", findings)
    if not sources:
        findings.add(NO_BINARY, f"binaries/{folders[0]}/{wanted}; there are {listed(folder)}")
        return ""
    if not _has_compiler():
        findings.add(NO_COMPILER, f"binaries/{folders[0]}/{wanted}")
        return ""
    findings.add(COMPILED, f"binaries/{folders[0]}/{wanted}")
    return "sources"


def _check_content(
    library: Path, declared: Declared, interface: str, resources: Path, findings: Findings
) -> Route:
    content = library.read_bytes()
    if not content.startswith((_MAGIC.get(sys.platform, b""), _UNIVERSAL_MAGIC)):
        findings.add(FOREIGN_LIBRARY, f"{library.parent.name}/{library.name}")
        return ""
    prefixes = [f"{name}_" for name in (declared.interfaces[interface].get("modelIdentifier"), library.stem)]
    missing = _missing_functions(content, declared.major, interface, prefixes)
    if missing:
        findings.add(NO_FUNCTIONS, ", ".join(missing))
        return ""
    absent = _missing_libraries(library, resources)
    if absent:
        findings.add(NO_LIBRARY, ", ".join(absent))
        return ""
    return "binary"


def _missing_libraries(library: Path, resources: Path) -> list[str]:
    """Return the libraries that an FMU's needs and that are neither in the FMU nor in the system (Linux)."""
    from fmu_plants.export.binaries import needed_libraries

    if not sys.platform.startswith("linux"):
        return []
    try:
        needed, run_path = needed_libraries(library.read_bytes())
    except ValueError:  # damaged: the loader will tell
        return []
    own = {path.name for folder in (library.parent, resources) for path in folder.rglob("*.so*")}
    origin = str(library.parent)
    folders = [Path(p.replace("${ORIGIN}", origin).replace("$ORIGIN", origin)) for p in run_path]
    # A path would have this very file loaded, wherever it leads: looking at an FMU must not do that.
    foreign = [name for name in needed if name not in own | _EVERYWHERE and "/" not in name]
    elsewhere = [name for name in foreign if not any((folder / name).is_file() for folder in folders)]
    return _not_in_system(elsewhere) if elsewhere else []


def _not_in_system(names: Sequence[str]) -> list[str]:
    try:
        done = subprocess.run(
            [sys.executable, "-I", "-c", _TRIAL, *names],
            capture_output=True,
            text=True,
            encoding="utf-8",
            errors="replace",
            timeout=_LONGEST_TRIAL,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):  # nothing is known then
        return []
    return [name for name in names if name in done.stdout.splitlines()]


def _missing_functions(content: bytes, major: int, interface: str, prefixes: Sequence[str]) -> list[str]:
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
        for name in _NEEDED.get((major, interface), ())
        if not any(prefix + plain + name in exported for prefix in (*prefixes, ""))
    ]


def _check_sources(folder: Path, declared: Declared, findings: Findings) -> bool:
    """Note source files that are missing, and return whether there are sources to compile."""
    sources = folder / "sources"
    for name in dict.fromkeys((*declared.source_files, *_build_description_files(sources))):
        if not (sources / name).is_file():
            findings.add(NO_SOURCE_FILE, f"sources/{name}")
    return has_sources(folder)


def _build_description_files(sources: Path) -> list[str]:
    path = sources / "buildDescription.xml"
    if not path.is_file():
        return []
    try:
        root = ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, LookupError, UnicodeError):
        return []
    return [file.get("name", "") for file in root.iter("SourceFile")]


def _has_compiler() -> bool:
    from fmu_plants import ExportError
    from fmu_plants.export.compiler import find_compiler

    try:
        find_compiler()
    except ExportError:
        return False
    return True
