"""A sandbox for what a stranger's FMU does in its process: Linux, opt-in, for good.

A process that has entered it, and all that it starts, writes nowhere but in the folders it is given, reads
what is installed but not the user's files, opens no sockets, and signals, traces or limits no process
outside. The system does this: Landlock (https://docs.kernel.org/userspace-api/landlock.html) for files and
signals, a seccomp filter for sockets, key rings, shared memory, limits and priorities of other processes, and
for what Landlock leaves alone: permissions and times of files, and who looks at a folder. Root loses its
capabilities.
"""

import ctypes
import errno
import os
import platform
import socket
import struct
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from ddpc_cosim.errors import ConfigError

_NO_NEW_PRIVILEGES, _SECCOMP, _GET_SECCOMP, _FILTER = 38, 22, 21, 2
_CREATE_RULESET, _ADD_RULE, _RESTRICT = 444, 445, 446  # the same on every processor
_VERSION, _PATH_BENEATH = 1, 1
_LEAST_VERSION = 3  # before, files could be cut off anywhere
_SCOPED_VERSION, _DEVICES_VERSION = 6, 5
_ALL_SCOPES = 0b11  # abstract sockets, signals
_EXECUTE, _WRITE, _READ, _LIST = 1 << 0, 1 << 1, 1 << 2, 1 << 3
_REMOVE_FOLDER, _REMOVE_FILE, _MAKE_FOLDER, _MAKE_FILE, _MAKE_LINK = 1 << 4, 1 << 5, 1 << 7, 1 << 8, 1 << 12
_MOVE, _CUT, _CONTROL_DEVICE = 1 << 13, 1 << 14, 1 << 15
_EVERYTHING = (1 << 15) - 1  # what version 3 knows
_LOOK = _EXECUTE | _READ | _LIST
_CHANGE = _WRITE | _REMOVE_FOLDER | _REMOVE_FILE | _MAKE_FOLDER | _MAKE_FILE | _MAKE_LINK | _MOVE | _CUT
_OF_FILES = _EXECUTE | _WRITE | _READ | _CUT | _CONTROL_DEVICE

_INSTALLED = (
    *("/usr", "/lib", "/lib32", "/lib64", "/bin", "/sbin", "/opt", "/nix/store", "/gnu/store", "/proc"),
    *("/sys/devices/system", "/etc/ld.so.cache", "/etc/ld.so.conf", "/etc/ld.so.conf.d", "/etc/alternatives"),
    *("/etc/localtime", "/etc/locale.alias", "/etc/passwd", "/etc/group", "/etc/nsswitch.conf", "/etc/fonts"),
)
_DEVICES = ("/dev/null", "/dev/zero", "/dev/full", "/dev/random", "/dev/urandom")


class _Processor(NamedTuple):
    """How a processor is called in filters, and its numbers of the calls that are not free."""

    audit: int
    pair: int  # of sockets: only of streams, as one end of a pair of datagrams can send to any service
    own_only: tuple[int, ...]  # of a process: a limit on CPU time ends it, one processor slows it down
    refused: tuple[int, ...]


_EVERYWHERE = (425, 452, 463, 466)  # io_uring_setup, fchmodat2, setxattrat, removexattrat
_PROCESSORS = {
    "x86_64": _Processor(
        0xC000003E,
        53,
        # prlimit64; sched_setparam, sched_setscheduler, sched_setaffinity, sched_setattr
        (302, 142, 144, 203, 314),
        (
            *(41, 29, 30, 64, 68),  # socket; shmget, shmat, semget, msgget
            *(90, 92, 94, 260, 268),  # chmod, chown, lchown, fchownat, fchmodat
            *(188, 189, 197, 198),  # setxattr, lsetxattr, removexattr, lremovexattr
            *(248, 249, 250),  # add_key, request_key, keyctl
            *(132, 235, 261, 280),  # utime, utimes, futimesat, utimensat
            *(254, 141, 251),  # inotify_add_watch; setpriority, ioprio_set
            *_EVERYWHERE,
        ),
    ),
    "aarch64": _Processor(
        0xC00000B7,
        199,
        (261, 118, 119, 122, 274),
        (198, 194, 196, 190, 186, 54, 53, 5, 6, 14, 15, 217, 218, 219, 88, 27, 140, 30, *_EVERYWHERE),
    ),
}
_LOAD, _AND, _EQUAL, _AT_LEAST, _RETURN = 0x20, 0x54, 0x15, 0x35, 0x06
_NUMBER, _PROCESSOR, _FIRST_ARGUMENT, _SECOND_ARGUMENT = 0, 4, 16, 24  # where a filter finds them
_ALLOW, _REFUSE, _KILL = 0x7FFF0000, 0x00050000 | errno.EACCES, 0x80000000
_FOREIGN_CALLS = 0x40000000  # of 32-bit programs on x86_64, which have other numbers
_SOCKET_TYPE = 0xF  # without its flags

_entered = ""


def missing() -> str:
    """Return what this system lacks for the sandbox; empty: nothing."""
    if sys.platform != "linux":
        return f"{platform.system()} has neither Landlock nor seccomp, which Linux has"
    if platform.machine() not in _PROCESSORS:
        return f"the processor {platform.machine()}; known: {', '.join(_PROCESSORS)}"
    version = _landlock_version()
    if version < _LEAST_VERSION:
        found = f"version {version}" if version > 0 else "none"
        return f"Landlock version {_LEAST_VERSION} (Linux 6.2, and `landlock` among lsm=); there is {found}"
    if _libc().prctl(_GET_SECCOMP, 0, 0, 0, 0) < 0:
        return "seccomp (CONFIG_SECCOMP_FILTER)"
    return ""


def require() -> str:
    """Return in words what the sandbox is here.

    Raises
    ------
    ConfigError
        This system has none, and what is missing.
    """
    if lacking := missing():
        raise ConfigError(f"the sandbox is not possible on this system: it needs {lacking}")
    version = _landlock_version()
    signals = ", signals" if version >= _SCOPED_VERSION else ""
    refused = "sockets, keys, shared memory, chmod"
    return f"no_new_privs; Landlock {version}: files{signals}; seccomp: no {refused}"


def entered() -> str:
    """Return in words the sandbox that this process is in; empty: none."""
    return _entered


class Sandbox(NamedTuple):
    """What a process in the sandbox may write, and read besides what is installed and on its import path.

    Parameters
    ----------
    writable, readable : tuple of Path
        Folders, with all that is in them, or files.
    """

    writable: tuple[Path, ...]
    readable: tuple[Path, ...] = ()


def enter(sandbox: Sandbox) -> None:
    """Put this process, of one thread, and all that it will start into a sandbox, for good.

    Raises
    ------
    ConfigError
        This system has none, and what is missing.
    OSError
        The system refuses it.
    """
    global _entered
    words = require()
    if len([*Path("/proc/self/task").iterdir()]) > 1:
        raise RuntimeError("other threads of this process would stay outside of the sandbox")
    libc = _libc()
    _check(libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0), "no_new_privs")
    _restrict_files(libc, sandbox)
    _filter_calls(libc)
    # Capabilities: version 3, none of the 64.
    _check(libc.capset(struct.pack("=Ii", 0x20080522, 0), bytes(24)), "capabilities")
    try:
        socket.socket().close()
    except PermissionError:
        _entered = words
    else:
        raise RuntimeError("the sandbox does not hold: a socket could be opened")


def _readable(sandbox: Sandbox) -> list[Path]:
    """Return what may be read: nothing that holds the home folder, or by import path temporary files."""
    home, temporary = Path.home().resolve(), Path(tempfile.gettempdir()).resolve()
    places = (Path(place).resolve() for place in (sys.prefix, sys.base_prefix, *sys.path) if place)
    installed = [place for place in places if not temporary.is_relative_to(place)]
    own = [place for place in (*installed, *sandbox.readable) if not home.is_relative_to(place.resolve())]
    return [*map(Path, _INSTALLED), *own]


def _restrict_files(libc: ctypes.CDLL, sandbox: Sandbox) -> None:
    version = _landlock_version()
    handled = _EVERYTHING | (_CONTROL_DEVICE if version >= _DEVICES_VERSION else 0)
    scoped = _ALL_SCOPES if version >= _SCOPED_VERSION else 0
    attributes = struct.pack("=QQQ", handled, 0, scoped) if scoped else struct.pack("=Q", handled)
    rules = _check(libc.syscall(_CREATE_RULESET, attributes, len(attributes), 0), "Landlock")
    try:
        for paths, rights in (
            (_readable(sandbox), _LOOK),
            (sandbox.writable, _LOOK | _CHANGE),
            (map(Path, _DEVICES), _READ | _WRITE | _CUT),
        ):
            for path in paths:
                _allow(libc, rules, path, rights & handled)
        _check(libc.syscall(_RESTRICT, rules, 0), "Landlock")
    finally:
        os.close(rules)


def _allow(libc: ctypes.CDLL, rules: int, path: Path, rights: int) -> None:
    try:
        place = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:  # what is not there needs no rule
        return
    try:
        rule = struct.pack("=Qi", rights if path.is_dir() else rights & _OF_FILES, place)
        _check(libc.syscall(_ADD_RULE, rules, _PATH_BENEATH, rule, 0), f"Landlock: {path}")
    finally:
        os.close(place)


def _filter_calls(libc: ctypes.CDLL) -> None:
    processor = _PROCESSORS[platform.machine()]
    allow, refuse = (_RETURN, 0, 0, _ALLOW), (_RETURN, 0, 0, _REFUSE)
    program = [(_LOAD, 0, 0, _PROCESSOR), (_EQUAL, 1, 0, processor.audit), (_RETURN, 0, 0, _KILL)]
    program += [(_LOAD, 0, 0, _NUMBER), (_AT_LEAST, 0, 1, _FOREIGN_CALLS), refuse]
    for number in processor.refused:
        program += [(_EQUAL, 0, 1, number), refuse]
    for number in processor.own_only:
        program += [(_EQUAL, 0, 4, number), (_LOAD, 0, 0, _FIRST_ARGUMENT), (_EQUAL, 0, 1, 0), allow, refuse]
    program += [(_EQUAL, 0, 7, processor.pair), (_LOAD, 0, 0, _FIRST_ARGUMENT)]
    program += [(_EQUAL, 0, 4, socket.AF_UNIX), (_LOAD, 0, 0, _SECOND_ARGUMENT), (_AND, 0, 0, _SOCKET_TYPE)]
    program += [(_EQUAL, 0, 1, socket.SOCK_STREAM), allow, refuse, allow]
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *line) for line in program))
    head = ctypes.create_string_buffer(struct.pack("@HP", len(program), ctypes.addressof(code)))
    _check(libc.prctl(_SECCOMP, _FILTER, head, 0, 0), "seccomp")


def _landlock_version() -> int:
    return int(_libc().syscall(_CREATE_RULESET, None, 0, _VERSION))


def _libc() -> ctypes.CDLL:
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl.argtypes = [ctypes.c_int, *3 * [ctypes.c_void_p], ctypes.c_void_p]
    libc.syscall.restype = ctypes.c_long
    return libc


def _check(result: int, what: str) -> int:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, f"the sandbox cannot be entered: {what}: {os.strerror(number)}")
    return int(result)
