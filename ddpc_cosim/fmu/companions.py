"""The libraries that an FMU's library needs: in the FMU, of a study, and what stands in for others.

The loader of Linux looks for them in the system's folders only, unless the FMU's library says otherwise,
which not all tools see to. Those found elsewhere are loaded first: then it has them by name.
"""

import ctypes
import hashlib
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import fmpy

from ddpc_cosim.fmu.stand_ins import MARK, STAND_INS
from fmu_plants.model import ExportError

EVERYWHERE = frozenset(
    {
        "libc.so.6",
        "libm.so.6",
        "libpthread.so.0",
        "libdl.so.2",
        "librt.so.1",
        "ld-linux-x86-64.so.2",
    }
)
"""Libraries that Python itself would not run without."""
_NOT_FOUND = re.compile(r"(?P<name>[^\s/:]+): cannot open shared object file")
_Finder = Callable[[str], Path | None]


def say_nothing(_: object) -> None:
    """Let a line, or a folder, go by."""


class MissingLibraryError(RuntimeError):
    """A library that the FMU needs is neither in the FMU nor in the system."""


class Companions(NamedTuple):
    """What is loaded with an FMU's library besides what is in the FMU and in the system.

    Parameters
    ----------
    given : tuple of Path
        Libraries of the study, which are loaded before the FMU's, in this order.
    stand_ins : tuple of str
        Names of the libraries that stand-ins were compiled for.
    """

    given: tuple[Path, ...] = ()
    stand_ins: tuple[str, ...] = ()

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is to be said of them."""
        return tuple(
            f"its library needs {name}, which is neither in the FMU nor on this machine: a stand-in was "
            "compiled, which has the functions that the FMU takes from it"
            for name in self.stand_ins
        )

    @property
    def identity(self) -> Mapping[str, str]:
        """What decides what they do, by name: hashes of the files, and of the sources of stand-ins."""
        hashes = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in self.given}
        return hashes | {name: f"stand-in {STAND_INS[name].digest}" for name in self.stand_ins}


def find_companions(
    library: Path,
    resources: Path,
    library_path: Sequence[Path] = (),
    tell: Callable[[str], object] = say_nothing,
    keep: Callable[[Path], object] = say_nothing,
) -> Companions:
    """Return what is to be loaded with an FMU's library; stand-ins are compiled, and put beside it.

    Where one is missing that nothing can stand in for, the loader will tell.

    Parameters
    ----------
    library, resources : Path
        The FMU's library, and its folder of resources.
    library_path : sequence of Path
        Libraries, all of which are loaded, and folders, of whose libraries those are that are needed by name.
    tell : callable, optional
        Called with a line before a stand-in is compiled.
    keep : callable, optional
        Called with the folder of the cache that has it.
    """
    if not (library_path or _names_old_ones(library, resources)):  # as nearly all; without reading further
        return Companions()
    stand_ins = list[str]()
    for name, reason in missing_for_good(library, resources, library_path).items():
        if not reason:
            with suppress(ExportError, OSError):  # the loader will ask why
                compiled = STAND_INS[name].compiled(tell)
                keep(compiled.parent)
                (library.parent / name).write_bytes(compiled.read_bytes())
                stand_ins.append(name)
    in_fmu = _closure([library], _below(library.parent, resources))
    return Companions(_given(in_fmu, library_path), tuple(stand_ins))


def _names_old_ones(library: Path, resources: Path) -> bool:
    """Whether the name of a library that there are stand-ins for is in a library of an FMU."""
    if not sys.platform.startswith("linux"):
        return False
    others = (path for folder in (library.parent, resources) for path in folder.rglob("*.so*"))
    return any(names_old_one(path.read_bytes()) for path in (library, *others) if path.is_file())


def names_old_one(content: bytes) -> bool:
    """Whether the content of a library has the name of one that there are stand-ins for."""
    return any(name.encode() in content for name in STAND_INS)


def missing_for_good(library: Path, resources: Path, library_path: Sequence[Path] = ()) -> dict[str, str]:
    """Return the old libraries that an FMU needs and that are nowhere, each with why it has no stand-in.

    There is no reason for those that a stand-in can be compiled for; parameters as of
    :func:`find_companions`.
    """
    if not sys.platform.startswith("linux"):
        return {}
    libraries = _closure([library], _below(library.parent, resources))
    libraries = [*libraries, *_given(libraries, library_path)]
    needed = {name for path in libraries for name in _needed_by(path)} - {path.name for path in libraries}
    return {name: _why_not(name, libraries) for name in STAND_INS if name in needed and not _is_there(name)}


def _given(in_fmu: Sequence[Path], library_path: Sequence[Path]) -> tuple[Path, ...]:
    """Return the libraries of a study that are loaded: those it names, and of folders those needed."""
    named = [place for place in library_path if not place.is_dir()]
    folders = [place for place in library_path if place.is_dir()]

    def find(name: str) -> Path | None:
        return next((path for folder in folders if (path := folder / name).is_file()), None)

    every = [path for path in _closure([*named, *in_fmu], find) if path not in in_fmu]
    by_name = {path.name: path for path in reversed(every)}  # the loader knows one of a name
    return tuple(path for path in every if path is by_name[path.name])


def _closure(libraries: Sequence[Path], find: _Finder) -> list[Path]:
    """Return libraries, and those that they need, as far as they are found by their names."""
    closure, waiting = dict.fromkeys(libraries), list(libraries)
    while waiting:
        for path in filter(None, map(find, _needed_by(waiting.pop()))):
            if path not in closure:
                closure[path] = None
                waiting.append(path)
    return list(closure)


def _needed_by(library: Path) -> list[str]:
    """Return the names of the libraries that one needs, but for those that are everywhere, or called by path.

    What cannot be read needs none: the loader will tell.
    """
    from fmu_plants.export.binaries import needed_libraries

    with suppress(OSError, ValueError):
        needed = needed_libraries(library.read_bytes()).libraries
        return [name for name in needed if name not in EVERYWHERE and "/" not in name]
    return []


def _below(*folders: Path) -> _Finder:
    """Return what finds libraries by name anywhere in folders, the first ones first."""

    @cache
    def every() -> dict[str, Path]:
        paths = [path for folder in folders for path in sorted(folder.rglob("*.so*")) if path.is_file()]
        return {path.name: path for path in reversed(paths)}

    return lambda name: every().get(name)


def _is_there(name: str) -> bool:
    """Whether the loader finds an old library by its name; the stand-in of another FMU is not meant."""
    try:
        library = ctypes.CDLL(name)
    except OSError:
        return False
    try:
        return not hasattr(library, MARK)
    finally:
        fmpy.freeLibrary(library._handle)


def _why_not(name: str, libraries: Sequence[Path]) -> str:
    """Return why nothing can stand in for a library; empty if a stand-in can be compiled."""
    from fmu_plants.export.binaries import wanted_symbols
    from fmu_plants.export.compiler import find_compiler

    try:
        wanted = {symbol for path in libraries for symbol in wanted_symbols(path.read_bytes())}
    except (OSError, ValueError) as error:
        return f"what is taken from {name} cannot be read: {error}"
    if lacking := STAND_INS[name].lacks(wanted):
        return f"the stand-in for {name} does not have {', '.join(lacking)}"
    try:
        find_compiler()
    except ExportError as error:
        return f"a stand-in for {name} would do, but {error}"
    return ""


def _why_missing(name: str, library: Path, resources: Path) -> str:
    """Return why nothing stands in for a library that the loader has not found; empty if nothing could."""
    reason = missing_for_good(library, resources).get(name)
    if reason == "":
        try:
            STAND_INS[name].compiled(say_nothing)
        except (ExportError, OSError) as error:
            return f"a stand-in for {name} cannot be compiled: {error}"
    return reason or ""


class LoadedCompanions:
    """Loads libraries that an FMU's library needs; that one keeps them loaded from then on.

    Parameters
    ----------
    library, resources : Path
        The FMU's library, and its folder of resources: others may be beside it, and anywhere below this.
    given : sequence of Path
        Libraries of the study, which are loaded at once, for all that is loaded later to see.

    Raises
    ------
    Exception
        What the loader says against one of these, and MissingLibraryError.
    """

    def __init__(self, library: Path, resources: Path, given: Sequence[Path] = ()) -> None:
        self._library, self._resources = library, resources
        self._given = {path.name: path for path in given}
        self._find = _below(library.parent, resources)
        self._loaded: dict[str, ctypes.CDLL] = {}

    def __enter__(self) -> Self:
        try:
            for name, path in self._given.items():
                self._load(name, path)
        except BaseException:
            self._free()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._free()

    def _free(self) -> None:
        for library in self._loaded.values():
            fmpy.freeLibrary(library._handle)

    def supply(self, error: Exception) -> bool:
        """Load the library that an error names as missing; return whether it is worthwhile to try again.

        Raises
        ------
        MissingLibraryError
            There is no such library.
        """
        match = _NOT_FOUND.search(str(error))
        if match is None or match["name"] in self._loaded:
            return False
        name = match["name"]
        file = self._given.get(name) or self._find(name)
        if file is None:
            reason = _why_missing(name, self._library, self._resources)
            raise MissingLibraryError(
                f"its library needs {name}, which is neither in the FMU nor on this machine; install it, "
                f"or give its folder as library_path{reason and f' ({reason})'}"
            ) from error
        self._load(name, file)
        return True

    def _load(self, name: str, file: Path) -> None:
        while name not in self._loaded:
            try:
                mode = ctypes.RTLD_GLOBAL if name in self._given else ctypes.DEFAULT_MODE
                self._loaded[name] = ctypes.CDLL(str(file), mode)
            except OSError as fault:  # it may need others in turn
                if not self.supply(fault):
                    raise
