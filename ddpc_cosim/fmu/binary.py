"""Which shared library of an unpacked FMU to load here."""

from pathlib import Path

import fmpy

from ddpc_cosim.errors import FMUImportError
from ddpc_cosim.fmu.archive import is_file_name
from ddpc_cosim.fmu.compilation import compile_sources, has_sources
from ddpc_cosim.fmu.model_description import FMUDescription, Interface

_BINARIES = "binaries"


def platform_folders(major: int) -> tuple[str, ...]:
    """Return the folders below ``binaries`` for this machine, the standard's own first.

    FMI 1.0 and 2.0 know only ``linux64`` and the like; FMI 3.0 knows ``x86_64-linux``. Tools mix them up, and
    for processors that FMI 2.0 does not name they use FMI 3.0's names.
    """
    old, new = str(fmpy.platform), str(fmpy.platform_tuple)
    return (new, old) if major >= 3 else (old, new)


def library_extension() -> str:
    """Return the file extension of shared libraries here, with the dot."""
    return str(fmpy.sharedLibraryExtension)


def find_library(
    folder: Path, description: FMUDescription, interface: Interface, label: str
) -> tuple[Path, tuple[str, ...]]:
    """Return the library to load, and warnings where it is not where the standard wants it.

    Raises
    ------
    FMUImportError
        There is none for this platform.
    """
    name = interface.model_identifier
    if not is_file_name(name):
        reason = f"the modelIdentifier {name!r} is not a file name"
        raise FMUImportError(f"{label}: modelDescription.xml: {reason}")
    folders = platform_folders(description.major)
    proper = f"{_BINARIES}/{folders[0]}/{name}{library_extension()}"
    for candidate in folders:
        found = library_in(folder / _BINARIES / candidate, name, description.major)
        if found is not None:
            place = f"{_BINARIES}/{candidate}/{found.name}"
            return found, () if place == proper else (f"the library is {place} instead of {proper}",)
    if has_sources(folder):
        compile_sources(folder, name, folder / proper, label)
        return folder / proper, ("no binary for this platform: compiled from the FMU's C sources",)
    raise FMUImportError(
        f"{label}: no binary for this platform ({proper}); it has {listed(folder)}. "
        f"Export the FMU for {folders[0]}."
    )


def platforms(folder: Path) -> list[str]:
    """Return the platforms for which an unpacked FMU has binaries."""
    binaries = folder / _BINARIES
    return sorted(p.name for p in binaries.iterdir() if p.is_dir()) if binaries.is_dir() else []


def listed(folder: Path) -> str:
    """Return in words for which platforms an unpacked FMU has binaries, and for this one, which."""
    known = {*platform_folders(2)}
    here = [path.name for p in sorted(known) for path in sorted((folder / _BINARIES / p).glob("*"))]
    names = f" ({', '.join(here)}, none of which is the FMU's library for sure)" if here else ""
    return f"binaries for: {', '.join(platforms(folder)) or 'none'}{names}"


def library_in(folder: Path, name: str, major: int) -> Path | None:
    """Return the library of a name; else the only one there is, or the only one with functions of FMI."""
    library = folder / f"{name}{library_extension()}"
    if library.is_file():
        return library
    others = sorted(p for p in folder.glob(f"*{library_extension()}") if p.is_file())
    if len(others) > 1:
        others = [path for path in others if _has_functions(path, major)]
    return others[0] if len(others) == 1 else None


def _has_functions(library: Path, major: int) -> bool:
    """Whether a library exports what an FMU's has to, whatever the prefix."""
    from fmu_plants.binaries import exported_symbols

    name = "fmiInstantiate" if major == 1 else f"fmi{major}Instantiate"
    try:
        return any(name in symbol for symbol in exported_symbols(library.read_bytes()))
    except ValueError:
        return False
