"""Loading an FMU's shared library through FMPy, with what FMPy does not do.

FMPy refuses a library in which any function is missing, also one that is never needed; leaves the working
directory changed when loading fails; declares the status of some FMI 1.0 functions to be a string; and looks
for the library under one name only. The classes here are FMPy's, with another loading.
"""

import ctypes
import inspect
import os
import threading
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import fmpy
import fmpy.fmi1
import fmpy.fmi2
import fmpy.fmi3

from ddpc_cosim.fmu.calls import missing_function
from ddpc_cosim.fmu.companions import Companions

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


class _LenientLoading:
    """Replaces how FMPy's classes find and load their library."""

    def __init__(self, **settings: Any) -> None:
        # FMI 3.0's class would put the library's path together itself, from the platform's usual folder.
        fmpy.fmi1._FMU.__init__(self, **settings)

    def _loadFunctions(self) -> None:  # noqa: N802 - FMPy's name
        fmu: Any = self
        # FMI 1.0 wants a prefix; later versions know it from static linking only, and some leave it in.
        prefixes = [f"{fmu.modelIdentifier}_", f"{fmu.library_stem}_", ""]
        for name, (arguments, result) in _prototypes(type(self).__bases__[1]).items():
            is_fmi1 = name.startswith("fmi1")
            plain = name.replace("fmi1", "fmi") if is_fmi1 else name
            ordered = prefixes if is_fmi1 else reversed(prefixes)
            function = _find(fmu.dll, [prefix + plain for prefix in ordered])
            if not isinstance(function, _MissingFunction):
                function.argtypes, function.restype = arguments, result
            fmu._functions[name] = function


def _find(library: ctypes.CDLL, symbols: list[str]) -> Any:
    for symbol in symbols:
        try:
            return getattr(library, symbol)
        except AttributeError:
            continue
    return _MissingFunction(symbols[0])


@cache
def _prototypes(fmpy_class: Any) -> Mapping[str, tuple[list[Any], Any]]:
    """Return argument types and result type of every FMI function that FMPy's class declares."""
    table = {}
    for name, method in inspect.getmembers(fmpy_class, inspect.isfunction):
        if name[:4] in ("fmi1", "fmi2", "fmi3"):
            signature = inspect.signature(method)
            arguments = [p.annotation for p in signature.parameters.values() if p.name != "self"]
            table[name] = (
                [_c_type(argument) for argument in arguments],
                _result_type(name, signature.return_annotation),
            )
    return table


def _c_type(annotation: Any) -> Any:
    return typing.get_args(annotation)[0] if isinstance(annotation, types.UnionType) else annotation


def _result_type(name: str, annotation: Any) -> Any:
    if name[4:] in _TEXT_RESULTS:
        return ctypes.c_char_p
    if annotation is int or annotation is ctypes.c_char_p:
        return ctypes.c_int
    return annotation


@cache
def _lenient_class(major: int, kind: str) -> Any:
    base = _FMPY_CLASSES[major, kind]
    return type(base.__name__, (_LenientLoading, base), {})


def load_library(
    major: int, kind: str, *, library: Path, folder: Path, model_identifier: str, guid: str, name: str
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

    Raises
    ------
    Exception
        Whatever the loader says.
    """
    lenient = _lenient_class(major, kind)
    fmu = lenient.__new__(lenient)
    fmu.library_stem = library.stem
    with _kept_working_directory(), Companions(library.parent, folder / "resources") as companions:
        while True:
            try:
                fmu.__init__(
                    guid=guid,
                    modelIdentifier=model_identifier,
                    unzipDirectory=str(folder),
                    instanceName=name,
                    libraryPath=str(library),
                )
                return fmu
            except Exception as error:  # FMPy's own, for whatever the loader says
                if not companions.supply(error):
                    raise


@contextmanager
def _kept_working_directory() -> Iterator[None]:
    """Let one thread at a time change the working directory, and change it back whatever happens."""
    with _loading:
        before = Path.cwd()
        try:
            yield
        finally:
            os.chdir(before)
