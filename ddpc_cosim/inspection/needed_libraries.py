"""Libraries without which an FMU's library cannot be loaded, and which of them are not here (Linux)."""

import struct
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

_ELF_64 = b"\x7fELF\x02\x01"
_LOADED, _DYNAMIC = 1, 2
_END, _NEEDED, _NAMES = 0, 1, 5
_RUN_PATHS = (15, 29)
_LONGEST = 30.0
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


def missing_libraries(library: Path, resources: Path) -> list[str]:
    """Return the libraries that an FMU's library needs and that are neither in the FMU nor in the system.

    Parameters
    ----------
    library : Path
        The FMU's library.
    resources : Path
        Folder with the FMU's resources.
    """
    if not sys.platform.startswith("linux"):
        return []
    try:
        needed, run_path = needs(library.read_bytes())
    except (struct.error, ValueError):  # damaged: the loader will tell
        return []
    own = {path.name for folder in (library.parent, resources) for path in folder.rglob("*.so*")}
    origin = str(library.parent)
    folders = [Path(p.replace("${ORIGIN}", origin).replace("$ORIGIN", origin)) for p in run_path]
    # A path would have this very file loaded, wherever it leads: looking at an FMU must not do that.
    foreign = [name for name in needed if name not in own | _EVERYWHERE and "/" not in name]
    elsewhere = [name for name in foreign if not any((folder / name).is_file() for folder in folders)]
    return _not_in_system(elsewhere) if elsewhere else []


class Needs(NamedTuple):
    """What the dynamic section of a library asks the loader for."""

    libraries: list[str]
    folders: list[str]


def needs(content: bytes) -> Needs:
    """Return the names of the libraries that a library needs, and the folders where it has them looked for.

    Source: System V ABI, dynamic section.

    Raises
    ------
    struct.error, ValueError
        The file is damaged.
    """
    if not content.startswith(_ELF_64):
        return Needs([], [])
    (table,) = struct.unpack_from("<Q", content, 0x20)
    size, count = struct.unpack_from("<2H", content, 0x36)
    # type, flags, offset, virtual address, physical address, size in the file, size in memory
    segments = [struct.unpack_from("<2I5Q", content, table + index * size) for index in range(count)]
    entries = [
        entry for segment in segments if segment[0] == _DYNAMIC for entry in _entries(content, segment)
    ]
    (address,) = [value for tag, value in entries if tag == _NAMES] or [0]
    names = [address - s[3] + s[2] for s in segments if s[0] == _LOADED and 0 <= address - s[3] < s[5]]

    def texts(*tags: int) -> list[str]:
        starts = [names[0] + value for tag, value in entries if tag in tags]
        return [content[s : content.index(b"\0", s)].decode("utf-8", errors="replace") for s in starts]

    if not names:
        return Needs([], [])
    return Needs(texts(_NEEDED), [folder for path in texts(*_RUN_PATHS) for folder in path.split(":")])


def _entries(content: bytes, segment: Sequence[int]) -> Iterator[tuple[int, int]]:
    for tag, value in struct.iter_unpack("<qQ", content[segment[2] : segment[2] + segment[5]]):
        if tag == _END:
            return
        yield tag, value


def _not_in_system(names: Sequence[str]) -> list[str]:
    try:
        done = subprocess.run(
            [sys.executable, "-I", "-c", _TRIAL, *names],
            capture_output=True,
            text=True,
            encoding="utf-8",
            errors="replace",
            timeout=_LONGEST,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):  # nothing is known then
        return []
    return [name for name in names if name in done.stdout.splitlines()]
