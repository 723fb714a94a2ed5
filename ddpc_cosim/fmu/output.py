"""Keeping what an FMU prints in this process out of the terminal.

Around rare calls, the process's standard output and error lead nowhere. That takes longer than a step of a
small FMU; so around steps only C's own streams are exchanged, which reaches what printf and its relatives
write, unless the FMU's library has other means of writing.
"""

import ctypes
import os
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from threading import RLock
from typing import NamedTuple, Protocol

_DESCRIPTORS = (1, 2)
_DYNAMIC_SYMBOLS, _UNDEFINED = 11, 0
# Functions that ask no C stream, and C++ streams, which remember where C's led at first.
_OTHER_MEANS = {
    b"write",
    b"writev",
    b"pwrite",
    b"sendfile",
    b"syscall",
    b"_ZSt4cout",
    b"_ZSt4cerr",
    b"_ZSt4clog",
}
# What compiled equations want of others: memory, texts, mathematics, and what every library wants.
_SILENT = frozenset(
    b"""
    calloc malloc realloc free memchr memcmp memcpy memmove memset qsort bsearch abs atof atoi strtod strtol
    strcat strchr strcmp strcpy strdup strlen strncat strncmp strncpy strrchr strstr
    snprintf sprintf vsnprintf vsprintf __snprintf_chk __vsnprintf_chk __memcpy_chk __memset_chk
    acos acosh asin asinh atan atan2 atanh cbrt ceil copysign cos cosh erf erfc exp exp2 expm1 fabs
    floor fma fmax fmin fmod hypot ldexp lgamma log log10 log1p log2 lround modf pow remainder rint
    round scalbn sin sincos sinh sqrt tan tanh tgamma trunc
    __cxa_finalize __gmon_start__ __stack_chk_fail __errno_location
    _ITM_deregisterTMCloneTable _ITM_registerTMCloneTable
    """.split()
)


class Mute(Protocol):
    """Keeps output back between ``on`` and ``off``."""

    def on(self) -> None:
        """Begin to keep output back."""

    def off(self) -> None:
        """Let output through again."""


class _MuteDescriptors:
    """The process's standard output and error, led nowhere; several threads may ask for it."""

    def __init__(self) -> None:
        self._flush: Callable[[None], int] = _c_library().fflush
        self._nowhere = os.open(os.devnull, os.O_WRONLY)
        self._kept: list[tuple[int, int]] = []
        self._users = 0
        self._lock = RLock()

    def on(self) -> None:
        """Begin to keep output back."""
        with self._lock:
            self._users += 1
            if self._users == 1:
                self._flush(None)
                self._kept = [(fd, copy) for fd in _DESCRIPTORS if (copy := _copy(fd)) is not None]
                for descriptor, _ in self._kept:
                    os.dup2(self._nowhere, descriptor)

    def off(self) -> None:
        """Let output through again."""
        with self._lock:
            self._users -= 1
            if self._users == 0:
                self._flush(None)  # what is left in C's buffers must not come out afterwards
                for descriptor, copy in self._kept:
                    os.dup2(copy, descriptor)
                    os.close(copy)


class _MuteStreams:
    """C's variables ``stdout`` and ``stderr``, pointed to a stream that leads nowhere."""

    def __init__(self, names: tuple[str, str]) -> None:
        library = _c_library()
        library.fopen.restype = ctypes.c_void_p
        self._nowhere: int = library.fopen(os.devnull.encode(), b"w")
        self._out, self._err = (ctypes.c_void_p.in_dll(library, name) for name in names)
        self._usual_out, self._usual_err = self._out.value, self._err.value

    def on(self) -> None:
        """Begin to keep output back."""
        self._out.value = self._err.value = self._nowhere

    def off(self) -> None:
        """Let output through again."""
        self._out.value, self._err.value = self._usual_out, self._usual_err


class _LetThrough:
    """Keeps nothing back."""

    def on(self) -> None:
        """Do nothing."""

    def off(self) -> None:
        """Do nothing."""


class _Mutes(NamedTuple):
    """What keeps output back around rare calls, and around steps."""

    thorough: Mute
    quick: Mute


_is_collected = False


@cache
def _mutes() -> _Mutes:
    if _is_collected:
        return _Mutes(_LetThrough(), _LetThrough())
    thorough = _MuteDescriptors()
    names = _stream_names()
    return _Mutes(thorough, _MuteStreams(names) if names else thorough)


def leave_alone() -> None:
    """Keep nothing back in this process: its output does not go to the terminal, and is wanted."""
    global _is_collected
    _is_collected = True
    _mutes.cache_clear()


def step_mute(folder: Path) -> Mute | None:
    """Return the cheapest mute that keeps back what a step of the libraries in a folder may print.

    Those that have no means of printing at all need none.
    """
    imported = [_imported_or_none(library.read_bytes()) for library in folder.iterdir() if library.is_file()]
    known = [symbols for symbols in imported if symbols is not None]
    if len(known) < len(imported):
        return _mutes().thorough
    if all(symbols <= _SILENT for symbols in known):
        return None
    return _mutes().quick if all(_OTHER_MEANS.isdisjoint(symbols) for symbols in known) else _mutes().thorough


@contextmanager
def quiet() -> Iterator[None]:
    """Keep back what is printed by anything in this process; for calls that are rare."""
    mute = _mutes().thorough
    mute.on()
    try:
        yield
    finally:
        mute.off()


def _imported_or_none(library: bytes) -> set[bytes] | None:
    """Return the names that a shared library wants from others; None for one that cannot be read."""
    try:
        return imported_symbols(library)
    except (struct.error, IndexError, ValueError):  # of another kind
        return None


def imported_symbols(library: bytes) -> set[bytes]:
    """Return the names that a shared library wants from others (ELF, 64 bits, little-endian).

    Raises
    ------
    struct.error, IndexError, ValueError
        It is no such library.
    """
    if library[:6] != b"\x7fELF\2\1":
        raise ValueError("not a little-endian ELF file of 64 bits")
    (table,) = struct.unpack_from("<Q", library, 40)
    size, count = struct.unpack_from("<HH", library, 58)
    # Of each section header: type, offset, size, and the section of its names.
    sections = [struct.unpack_from("<4xI16xQQI", library, table + i * size) for i in range(count)]
    names = set()
    for kind, offset, length, link in sections:
        if kind == _DYNAMIC_SYMBOLS:
            texts = sections[link][1]
            for name, section in struct.iter_unpack("<I2xH16x", library[offset : offset + length]):
                if section == _UNDEFINED and name:  # the first entry of a table is none
                    start = texts + name
                    names.add(library[start : library.index(b"\0", start)])
    return names


def _copy(descriptor: int) -> int | None:
    try:
        return os.dup(descriptor)
    except OSError:  # a process may have no standard output
        return None


def _stream_names() -> tuple[str, str] | None:
    """Return the names of C's stream variables, where they are variables that may be assigned to."""
    if sys.platform == "darwin":
        return "__stdoutp", "__stderrp"
    if sys.platform == "linux":
        with suppress(ValueError, OSError):  # constants in other C libraries than GNU's
            if os.confstr("CS_GNU_LIBC_VERSION"):
                return "stdout", "stderr"
    return None


def _c_library() -> ctypes.CDLL:
    return ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)
