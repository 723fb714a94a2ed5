"""The only place that touches FMPy, which has no type information: archive, description, C interface."""

import ctypes
import os
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import fmpy
import fmpy.fmi2
import fmpy.model_description

Pointer = Any
CFunction = Callable[..., int]

STATUS_WORDS = ("ok", "warning", "discard", "error", "fatal", "pending")
DISCARD, FATAL = 2, 4
LAST_SUCCESSFUL_TIME, TERMINATED = 2, 3

_LOG_LINES_KEPT = 20
_LOG_LINE_LENGTH = 500


def platform() -> str:
    """Return the name of this machine's folder below ``binaries`` (FMI 2.0, section 2.3)."""
    return str(fmpy.platform)


def library_extension() -> str:
    """Return the file extension of shared libraries here, with the dot."""
    return str(fmpy.sharedLibraryExtension)


def version() -> str:
    """Return the version of FMPy."""
    return str(fmpy.__version__)


def extract(path: Path, folder: Path) -> None:
    """Unpack an FMU into a folder."""
    fmpy.extract(str(path), unzipdir=str(folder))


def read_description(folder: Path) -> Any:
    """Return FMPy's ``ModelDescription`` of an unpacked FMU, without its validation."""
    return fmpy.model_description.read_model_description(str(folder), validate=False)


class Fmi2Slave:
    """One instance of an FMI 2.0 Co-Simulation FMU: FMPy loads it, its functions are called directly.

    Parameters
    ----------
    guid, model_identifier : str
        From the model description.
    folder : Path
        The unpacked FMU.
    instance_name : str
        Name of the instance in log messages.
    """

    def __init__(self, guid: str, model_identifier: str, folder: Path, instance_name: str) -> None:
        self.log: deque[str] = deque(maxlen=_LOG_LINES_KEPT)
        here = Path.cwd()
        try:
            self._fmu = fmpy.fmi2.FMU2Slave(
                guid=guid,
                modelIdentifier=model_identifier,
                unzipDirectory=str(folder),
                instanceName=instance_name,
            )
        finally:
            os.chdir(here)  # FMPy changes to the library's folder and stays there if it cannot be loaded
        # The structure and its Python callback must live as long as the instance.
        self._callbacks = self._make_callbacks()
        try:
            self._fmu.instantiate(callbacks=self._callbacks, loggingOn=False)
        except Exception as error:
            self._fmu.freeLibrary()
            raise RuntimeError("; ".join([str(error), *self.log])) from error
        self.component: Pointer = self._fmu.component

    def function(self, name: str) -> CFunction:
        """Return a function of the shared library from FMPy's function table."""
        function: CFunction = self._fmu._functions[name]
        return function

    def free(self) -> None:
        """Free the instance and unload its library."""
        self._fmu.freeInstance()

    def _make_callbacks(self) -> Any:
        callbacks = fmpy.fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(self._on_message)
        callbacks.allocateMemory = fmpy.fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        callbacks.freeMemory = fmpy.fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
        proxy = getattr(fmpy.fmi2, "addLoggerProxy", None)
        if proxy is not None:  # formats printf-style messages in C; not built for every platform
            proxy(ctypes.byref(callbacks))
        return callbacks

    def _on_message(self, _: Any, __: bytes, status: int, category: bytes, message: bytes) -> None:
        text = (message or b"").decode("utf-8", "replace")[:_LOG_LINE_LENGTH].strip()
        self.log.append(f"[{status_word(status)}] {text}")


def status_word(status: int) -> str:
    """Return an FMI status in words."""
    return STATUS_WORDS[status] if 0 <= status < len(STATUS_WORDS) else f"illegal status {status}"
