"""How long paths may be: on Windows 259 characters, of folders 247, where the system does not allow more."""

import sys
from collections.abc import Iterable
from functools import cache
from pathlib import PurePath
from typing import NamedTuple

LONGEST_FILE, LONGEST_FOLDER = 259, 247
RANDOM = 8 * "x"
"""As long as what ``tempfile`` makes up for a name."""
ALLOW_MORE = "allow long paths (set LongPathsEnabled to 1 in the registry, as Microsoft describes it)"


class Excess(NamedTuple):
    """A path that is too long, and by how many characters."""

    path: PurePath
    characters: int


@cache
def are_limited() -> bool:
    """Whether this process has short paths only."""
    if sys.platform == "win32":
        import ctypes

        try:
            return not ctypes.WinDLL("ntdll").RtlAreLongPathsEnabled() & 0xFF
        except AttributeError:  # before there was a setting
            return True
    return False


def longest_excess(files: Iterable[PurePath]) -> Excess | None:
    """Return the one of some files whose path, or that of its folder, is too long by most; None: all fit."""
    excesses = (
        Excess(path, max(_beyond(path, LONGEST_FILE), _beyond(path.parent, LONGEST_FOLDER))) for path in files
    )
    longest = max(excesses, key=lambda excess: excess.characters, default=None)
    return longest if longest and longest.characters > 0 else None


def _beyond(path: PurePath, most: int) -> int:
    """Return by how many characters, as Windows counts them, a path is too long."""
    return len(str(path).encode("utf-16-le", "surrogatepass")) // 2 - most
