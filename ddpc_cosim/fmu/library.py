"""Loading an FMU's shared library through FMPy, with what FMPy does not do.

FMPy refuses a library in which any function is missing, also one that is never needed; leaves the working
directory changed when loading fails; declares the status of some FMI 1.0 functions to be a string; and looks
for the library under one name only. The classes here are FMPy's, with another loading.
"""

import ctypes
import inspect
import os
import sys
import threading
import types
import typing
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import fmpy
import fmpy.fmi1
import fmpy.fmi2
import fmpy.fmi3

from ddpc_cosim.errors import CosimError, FMUImportError
from ddpc_cosim.fmu.archive import is_file_name, unpack
from ddpc_cosim.fmu.build import compile_sources, has_sources
from ddpc_cosim.fmu.call_trace import TracedFunction
from ddpc_cosim.fmu.companions import (
    Companions,
    LoadedCompanions,
    find_companions,
    names_old_one,
    say_nothing,
)
from ddpc_cosim.fmu.description import FMUDescription, Interface
from ddpc_cosim.fmu.description.reader import read_description
from ddpc_cosim.fmu.status import missing_function
from ddpc_cosim.processes.scratch import ScratchFolder

CFunction = Callable[..., int]

_FMPY_CLASSES: Mapping[tuple[int, str], Any] = {
    (1, "co-simulation"): fmpy.fmi1.FMU1Slave,
    (1, "model-exchange"): fmpy.fmi1.FMU1Model,
    (2, "co-simulation"): fmpy.fmi2.FMU2Slave,
    (2, "model-exchange"): fmpy.fmi2.FMU2Model,
    (3, "co-simulation"): fmpy.fmi3.FMU3Slave,
    (3, "model-exchange"): fmpy.fmi3.FMU3Model,
}
_TEXT_RESULTS = ("GetVersion", "GetTypesPlatform", "GetModelTypesPlatform")
_loading = threading.Lock()


class _MissingFunction:
    """Stands in the function table for a function that the library does not have."""

    restype = None

    def __init__(self, name: str) -> None:
        self.name = name

    def __call__(self, *_: Any) -> int:
        raise missing_function(self.name)


def is_missing(function: CFunction) -> bool:
    """Whether the library does not have a function of the table."""
    return isinstance(function, _MissingFunction)


class _TolerantLoading:
    """Replaces how FMPy's classes find and load their library."""

    def __init__(self, **settings: Any) -> None:
        # FMI 3.0's class would put the library's path together itself, from the platform's usual folder.
        fmpy.fmi1._FMU.__init__(self, **settings)

    def _loadFunctions(self) -> None:  # noqa: N802 - FMPy's name
        fmu: Any = self
        # FMI 1.0 wants a prefix; later versions know it from static linking only, and some leave it in.
        prefixes = [f"{fmu.modelIdentifier}_", f"{fmu.library_stem}_", ""]
        for name, (arguments, result) in _PROTOTYPES[type(self).__bases__[1]].items():
            is_fmi1 = name.startswith("fmi1")
            plain = name.replace("fmi1", "fmi") if is_fmi1 else name
            ordered = prefixes if is_fmi1 else reversed(prefixes)
            function = _find(fmu.dll, [prefix + plain for prefix in ordered])
            if not isinstance(function, _MissingFunction):
                function.argtypes, function.restype = arguments, result
                if fmu.trace_calls is not None:
                    names = _argument_names(type(self).__bases__[1], name)
                    function = TracedFunction(plain, names, function, fmu.trace_calls)
            fmu._functions[name] = function

    def another(self, name: str) -> Any:
        """Return an object for another instance, which is called by a name, in the same library."""
        other: Any = object.__new__(type(self))
        vars(other).update(vars(self), instanceName=name)
        other.users.append(name)
        return other

    def freeLibrary(self) -> None:  # noqa: N802 - FMPy's name
        """Unload the library, unless there is another user of it."""
        fmu: Any = self
        fmu.users.remove(fmu.instanceName)
        if not fmu.users:
            fmpy.freeLibrary(fmu.dll._handle)


_kept: dict[str, dict[Any, Any]] = {}
"""FMPy's objects for libraries that are kept loaded, by path and class, once they have been loaded."""


def _find(library: ctypes.CDLL, symbols: list[str]) -> Any:
    for symbol in symbols:
        try:
            return getattr(library, symbol)
        except AttributeError:
            continue
    return _MissingFunction(symbols[0])


def _prototypes(fmpy_class: Any) -> Mapping[str, tuple[list[Any], Any]]:
    """Return argument types and result type of every FMI function that FMPy's class declares."""
    table = {}
    members = {name: member for base in fmpy_class.__mro__[::-1] for name, member in vars(base).items()}
    for name, method in members.items():
        if name[:4] in ("fmi1", "fmi2", "fmi3") and inspect.isfunction(method):
            *arguments, result = method.__annotations__.values()
            table[name] = [_c_type(argument) for argument in arguments], _result_type(name, result)
    return table


def _argument_names(fmpy_class: Any, function: str) -> list[str]:
    """Return what FMPy's class calls the arguments of an FMI function."""
    return [name for name in inspect.signature(getattr(fmpy_class, function)).parameters if name != "self"]


def _c_type(annotation: Any) -> Any:
    return typing.get_args(annotation)[0] if isinstance(annotation, types.UnionType) else annotation


def _result_type(name: str, annotation: Any) -> Any:
    if name[4:] in _TEXT_RESULTS:
        return ctypes.c_char_p
    if annotation is int or annotation is ctypes.c_char_p:
        return ctypes.c_int
    return annotation


# Made here, so that they are there before workers are forked.
_PROTOTYPES = {base: _prototypes(base) for base in _FMPY_CLASSES.values()}
_TOLERANT_CLASSES: Mapping[tuple[int, str], Any] = {
    key: type(base.__name__, (_TolerantLoading, base), {}) for key, base in _FMPY_CLASSES.items()
}


def load_library(
    major: int,
    kind: str,
    *,
    library: Path,
    folder: Path,
    model_identifier: str,
    guid: str,
    name: str,
    trace_calls: Path | None = None,
    given: Sequence[Path] = (),
) -> Any:
    """Load a library and return FMPy's object for it, not yet instantiated.

    Parameters
    ----------
    major : int
        FMI version: 1, 2 or 3.
    kind : str
        ``"co-simulation"`` or ``"model-exchange"``.
    library, folder : Path
        The shared library, and the unpacked FMU.
    model_identifier, guid, name : str
        From the model description, and the instance's name.
    trace_calls : Path, optional
        File that all calls are written to.
    given : sequence of Path
        Libraries that are loaded before it.

    Raises
    ------
    Exception
        Whatever the loader says.
    """
    tolerant = _TOLERANT_CLASSES[major, kind]
    kept = _kept.get(str(library)) if trace_calls is None else None
    if kept and tolerant in kept:
        return kept[tolerant].another(name)
    fmu = tolerant.__new__(tolerant)
    fmu.library_stem, fmu.trace_calls, fmu.users = library.stem, trace_calls, [name]
    with _kept_working_directory(), LoadedCompanions(library, folder / "resources", given) as companions:
        while True:
            try:
                fmu.__init__(
                    guid=guid,
                    modelIdentifier=model_identifier,
                    unzipDirectory=str(folder),
                    instanceName=name,
                    libraryPath=str(library),
                )
                break
            except Exception as error:  # FMPy's own, for whatever the loader says
                if not companions.supply(error):
                    raise
    if kept is None:
        return fmu
    kept[tolerant] = fmu
    return fmu.another(name)


@contextmanager
def kept_loaded(library: Path) -> Iterator[None]:
    """Keep a library loaded for all of its instances, each of which would take longer than it does itself.

    It is loaded with the first of them. What it has in static variables stays.
    """
    kept = _kept[str(library)] = {}
    try:
        yield
    finally:
        del _kept[str(library)]
        for fmu in kept.values():
            fmu.freeLibrary()


@contextmanager
def _kept_working_directory() -> Iterator[None]:
    """Let one thread at a time change the working directory, and change it back whatever happens."""
    with _loading:
        before = Path.cwd()
        try:
            yield
        finally:
            os.chdir(before)


_BINARIES = "binaries"
_LARGEST_LIBRARY = 1 << 28


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
    folder: Path,
    description: FMUDescription,
    interface: Interface,
    label: str,
    tell: Callable[[str], object] = say_nothing,
    keep: Callable[[Path], object] = say_nothing,
) -> tuple[Path, tuple[str, ...]]:
    """Return the library to load, and warnings where it is not where the standard wants it.

    Parameters
    ----------
    folder : Path
        The unpacked FMU.
    description : FMUDescription
        What it says about itself.
    interface : Interface
        What the library is for.
    label : str
        The FMU's file name, for errors.
    tell : callable, optional
        Called with a line before C sources are compiled, which may take a while.
    keep : callable, optional
        Called with the folder of the cache that has what was compiled.

    Raises
    ------
    FMUImportError
        There is none for this platform.
    """
    name = interface.model_identifier
    if not is_file_name(name):
        reason = f"the modelIdentifier {name[:100]!r} is not a file name"
        raise FMUImportError(f"{label}: modelDescription.xml: {reason}")
    folders = platform_folders(description.major)
    proper = f"{_BINARIES}/{folders[0]}/{name}{library_extension()}"
    for candidate in folders:
        library = library_in(folder / _BINARIES / candidate, name, description.major)
        if library is not None:
            place = f"{_BINARIES}/{candidate}/{library.name}"
            return library, () if place == proper else (f"the library is {place} instead of {proper}",)
    if has_sources(folder):
        keep(compile_sources(folder, description, name, folder / proper, label, tell))
        return folder / proper, ("no binary for this platform: compiled from the FMU's C sources",)
    raise FMUImportError(
        f"{label}: no binary for this platform ({proper}); it has {listed(folder)}. "
        f"Export the FMU for {folders[0]}."
    )


def compile_ahead(path: Path, tell: Callable[[str], object] = say_nothing) -> list[Path]:
    """Compile what an FMU has as C sources only, and stand-ins, before anything is timed, into the cache.

    Returns the folders of the cache that have them. What is wrong with the FMU is told where it is opened.

    Parameters
    ----------
    path : Path
        The FMU.
    tell : callable, optional
        Called with a line before each is compiled.
    """
    cached_folders = list[Path]()
    with suppress(CosimError, OSError, zipfile.BadZipFile):
        with zipfile.ZipFile(path) as archive:
            folders = {name.rpartition("/")[0] for name in archive.namelist()}
            ready = any(f"{_BINARIES}/{platform}" in folders for platform in platform_folders(2))
            if ready and not _may_need_stand_in(archive):
                return cached_folders
        if not ready and not any(folder.split("/")[0] == "sources" for folder in folders):
            return cached_folders
        for _ in _companions(path, tell, cached_folders.append):
            pass
    return cached_folders


def stand_ins_of(path: Path) -> dict[str, str]:
    """Return the stand-ins that are loaded with an FMU, by library: what decides what they do.

    There are none of other files, and of an FMU that cannot be opened, which is told where it is.
    """
    with suppress(CosimError, OSError, zipfile.BadZipFile):
        with zipfile.ZipFile(path) as archive:
            if not _may_need_stand_in(archive):
                return {}
        every = _companions(path, say_nothing, say_nothing)
        return {name: what for companions in every for name, what in companions.identity.items()}
    return {}


def _companions(
    path: Path, tell: Callable[[str], object], keep: Callable[[Path], object]
) -> Iterator[Companions]:
    """Yield what is loaded with the library of each interface of an FMU; what it needs is compiled."""
    with ScratchFolder() as folder:
        unpack(path, folder)
        description = read_description(folder, path.name)
        for interface in description.interfaces.values():
            with suppress(FMUImportError):  # another one may do
                library, _ = find_library(folder, description, interface, path.name, tell, keep)
                yield find_companions(library, folder / "resources", (), tell, keep)


def _may_need_stand_in(archive: zipfile.ZipFile) -> bool:
    """Whether a library for this platform names one that there are stand-ins for."""
    if not sys.platform.startswith("linux"):
        return False
    libraries = (
        entry
        for entry in archive.infolist()
        if ".so" in entry.filename and entry.file_size <= _LARGEST_LIBRARY
    )
    return any(names_old_one(archive.read(entry)) for entry in libraries)


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
    if is_file_name(name) and library.is_file():
        return library
    others = sorted(p for p in folder.glob(f"*{library_extension()}") if p.is_file())
    if len(others) > 1:
        others = [path for path in others if _has_functions(path, major)]
    return others[0] if len(others) == 1 else None


def _has_functions(library: Path, major: int) -> bool:
    """Whether a library exports the functions that an FMU's must have, whatever the prefix."""
    from fmu_plants.export.binaries import exported_symbols

    name = "fmiInstantiate" if major == 1 else f"fmi{major}Instantiate"
    try:
        return any(name in symbol for symbol in exported_symbols(library.read_bytes()))
    except ValueError:
        return False
