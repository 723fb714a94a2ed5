"""Libraries that an FMU's library needs: those that the FMU brings along, and those that are not here.

The loader of Linux looks for them in the system's folders only, unless the FMU's library says otherwise,
which not all tools see to. Those that are found in the FMU are loaded first: then it has them by name.
"""

import ctypes
import re
from glob import escape
from pathlib import Path
from types import TracebackType
from typing import Self

import fmpy

_NOT_FOUND = re.compile(r"(?P<name>[^\s/:]+): cannot open shared object file")


class MissingLibraryError(RuntimeError):
    """A library that the FMU needs is neither in the FMU nor in the system."""


class Companions:
    """Loads libraries of an FMU that its main library needs; the main library keeps them loaded from then on.

    Parameters
    ----------
    folders : Path
        Where they may be: the main library's folder, and any below the FMU's resources.
    """

    def __init__(self, *folders: Path) -> None:
        self._folders = folders
        self._loaded: dict[str, ctypes.CDLL] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
        found = next((path for folder in self._folders for path in sorted(folder.rglob(escape(name)))), None)
        if found is None:
            raise MissingLibraryError(
                f"its library needs {name}, which is neither in the FMU nor on this machine; install it, "
                "or add its folder to LD_LIBRARY_PATH"
            ) from error
        while True:
            try:
                self._loaded[name] = ctypes.CDLL(str(found))
                return True
            except OSError as fault:  # it may need others in turn
                if not self.supply(fault):
                    raise
