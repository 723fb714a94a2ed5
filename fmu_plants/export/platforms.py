"""The platforms that FMUs are compiled for, and where each one's library has its place inside the FMU."""

import platform as machine
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fmu_plants.export.binaries import universal_binary
from fmu_plants.model import ExportError, ExportUsageError
from fmu_plants.spelling import did_you_mean


@dataclass(frozen=True, slots=True)
class Platform:
    """An operating system on a processor.

    Parameters
    ----------
    name : str
        What users call it.
    system : str
        ``linux``, ``windows`` or ``darwin``, as in FMI 3.0's platform tuples.
    architecture : str
        ``x86_64`` or ``aarch64``, likewise.
    zig_target : str
        The same to the zig compiler, with the oldest C library that is to do.
    suffix : str
        File name extension of shared libraries.
    """

    name: str
    system: str
    architecture: str
    zig_target: str
    suffix: str

    @property
    def tuple(self) -> str:
        """Name of the folder below ``binaries`` in FMI 3.0, section 2.5.1.4.1."""
        return f"{self.architecture}-{self.system}"


LINUX_X86_64 = Platform("linux-x86_64", "linux", "x86_64", "x86_64-linux-gnu.2.17", ".so")
LINUX_ARM64 = Platform("linux-arm64", "linux", "aarch64", "aarch64-linux-gnu.2.17", ".so")
WINDOWS_X86_64 = Platform("windows-x86_64", "windows", "x86_64", "x86_64-windows-gnu", ".dll")
MACOS_X86_64 = Platform("macos-x86_64", "darwin", "x86_64", "x86_64-macos", ".dylib")
MACOS_ARM64 = Platform("macos-arm64", "darwin", "aarch64", "aarch64-macos", ".dylib")
PLATFORMS = (LINUX_X86_64, LINUX_ARM64, WINDOWS_X86_64, MACOS_X86_64, MACOS_ARM64)
ALL = "all"

_SYSTEMS = {"win32": "windows", "darwin": "darwin", "linux": "linux"}
_ARCHITECTURES = {"amd64": "x86_64", "x86_64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}


def host_platform() -> Platform:
    """Return the platform of this Python.

    Raises
    ------
    ExportError
        FMUs are not compiled for it.
    """
    system = _SYSTEMS.get(sys.platform, sys.platform)
    architecture = _ARCHITECTURES.get(machine.machine().lower(), machine.machine())
    for platform in PLATFORMS:
        if (platform.system, platform.architecture) == (system, architecture) and sys.maxsize > 2**32:
            return platform
    known = ", ".join(platform.name for platform in PLATFORMS)
    raise ExportError(
        f"FMUs cannot be compiled for this machine ({system}, {architecture}); "
        f'choose platforms to compile for: "{ALL}", or some of {known}'
    )


def parse_platforms(names: str | Sequence[str]) -> tuple[Platform, ...]:
    """Return platforms by name: ``"all"``, names separated by commas, or a sequence of names.

    Raises
    ------
    ExportError
        There are no such platforms, or none was named.
    """
    words = [word.strip() for word in names.split(",")] if isinstance(names, str) else list(names)
    by_name = {platform.name: platform for platform in PLATFORMS}
    if words == [ALL]:
        return PLATFORMS
    unknown = [word for word in words if word not in by_name] or ([] if words else [""])
    if unknown:
        known = (ALL, *by_name)
        faults = (f'no platform "{word}"; {did_you_mean(word, known)}' for word in unknown)
        raise ExportUsageError("\n".join(faults))
    return tuple(platform for platform in PLATFORMS if platform.name in words)


def binary_files(fmi_version: str, identifier: str, libraries: Mapping[Platform, bytes]) -> dict[str, bytes]:
    """Return the libraries by their names inside the FMU."""
    folders = _fmi2_folders(libraries) if fmi_version == "2.0" else _fmi3_folders(libraries)
    return {
        f"binaries/{folder}/{identifier}{platform.suffix}": content
        for folder, (platform, content) in folders.items()
    }


def _fmi3_folders(libraries: Mapping[Platform, bytes]) -> dict[str, tuple[Platform, bytes]]:
    return {platform.tuple: (platform, content) for platform, content in libraries.items()}


def _fmi2_folders(libraries: Mapping[Platform, bytes]) -> dict[str, tuple[Platform, bytes]]:
    """Place libraries by FMI 2.0.5, section 2.3.1, and where importers look that came before it.

    FMI 2.0 names folders for x86 only; for ARM, its fifth revision refers to FMI 3.0. Importers on ARM often
    look into the x86 folder of their system (FMPy 0.3, OpenModelica): a library for two processors serves
    both on macOS, and on Linux that of ARM stands there if there is none for x86.
    """
    folders: dict[str, tuple[Platform, bytes]] = {}
    if LINUX_ARM64 in libraries:
        arm = (LINUX_ARM64, libraries[LINUX_ARM64])
        folders |= {"aarch64-linux": arm, "linux64": arm}
    if LINUX_X86_64 in libraries:
        folders["linux64"] = (LINUX_X86_64, libraries[LINUX_X86_64])
    if WINDOWS_X86_64 in libraries:
        folders["win64"] = (WINDOWS_X86_64, libraries[WINDOWS_X86_64])
    macos = [libraries[platform] for platform in (MACOS_X86_64, MACOS_ARM64) if platform in libraries]
    if macos:
        library = universal_binary(macos) if len(macos) > 1 else macos[0]
        folders["darwin64"] = (MACOS_X86_64, library)
    return folders
