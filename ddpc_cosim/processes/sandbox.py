"""A sandbox for what a stranger's FMU does in its process: Linux, opt-in, for good.

A process that has entered it, and all that it starts, writes nowhere but in the folders it is given, reads
what is installed but not the user's files, opens no sockets, and signals, traces or limits no process
outside. The system does this: Landlock (https://docs.kernel.org/userspace-api/landlock.html) for files and
signals; a seccomp filter that lets only those system calls through that an FMU needs; and, where it allows
them, namespaces, in which there are no other processes and no network. Root loses its capabilities.
"""

import ctypes
import errno
import os
import platform
import signal
import socket
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from typing import NamedTuple, NoReturn

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.processes.fork_server import LEFT_BEHIND, START_SECONDS, start_python
from ddpc_cosim.processes.system_calls import FIRST_NEW, Condition, allowed_calls

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
    *("/usr", "/lib", "/lib32", "/lib64", "/bin", "/sbin", "/opt", "/nix/store", "/gnu/store"),
    *("/sys/devices/system", "/etc/ld.so.cache", "/etc/ld.so.conf", "/etc/ld.so.conf.d", "/etc/alternatives"),
    *("/etc/localtime", "/etc/locale.alias", "/etc/passwd", "/etc/group", "/etc/nsswitch.conf", "/etc/fonts"),
)
_DEVICES = ("/dev/null", "/dev/zero", "/dev/full", "/dev/random", "/dev/urandom")


# Not the whole of it: the folder of each process, and of each of its threads, has one of the network.
_PROC = (
    *("cpuinfo", "meminfo", "stat", "loadavg", "uptime", "version", "filesystems", "sys/kernel", "sys/vm"),
    *(f"self/{name}" for name in ("maps", "smaps", "stat", "statm", "status", "cmdline", "comm", "environ")),
    *(f"self/{name}" for name in ("auxv", "exe", "fd", "limits", "cgroup", "mounts", "mountinfo")),
)
# Users, processes, network, shared memory, mounts, host name.
_NAMESPACES = 0x10000000 | 0x20000000 | 0x40000000 | 0x08000000 | 0x00020000 | 0x04000000
_PRIVATE = (1 << 14) | (1 << 18)  # mounts, all of them, that are seen here only
_HARMLESS = 0b1110  # no programs, devices, or other users' rights from there
_DIE_WITH_PARENT, _CLOSE_RANGE, _LAST_DESCRIPTOR = 1, 436, 0xFFFFFFFF


class _Processor(NamedTuple):
    """How a processor is called in filters, and the column of its numbers of system calls."""

    audit: int
    column: int


_PROCESSORS = {"x86_64": _Processor(0xC000003E, 0), "aarch64": _Processor(0xC00000B7, 1)}
_LOAD, _AND, _EQUAL, _AT_LEAST, _RETURN = 0x20, 0x54, 0x15, 0x35, 0x06
_NUMBER, _PROCESSOR, _ARGUMENTS = 0, 4, 16  # where a filter finds them; of arguments, the lower half
_ALLOW, _REFUSE, _KILL = 0x7FFF0000, 0x00050000 | errno.EACCES, 0x80000000
_NOT_THERE = 0x00050000 | errno.ENOSYS
_FOREIGN_CALLS = 0x40000000  # of 32-bit programs on x86_64, which have other numbers

_entered = ""
_demanded = ContextVar("_demanded", default=False)
_held: list[int] = []


def missing() -> str:
    """Return what this system lacks for the sandbox; empty: nothing."""
    if sys.platform != "linux":
        return f"{platform.system()} has neither Landlock nor seccomp, which Linux has"
    if platform.machine() not in _PROCESSORS:
        return f"the processor {platform.machine()}; known: {', '.join(_PROCESSORS)}"
    version = _landlock_version()
    if version < _LEAST_VERSION:
        present = f"version {version}" if version > 0 else "none"
        return f"Landlock version {_LEAST_VERSION} (Linux 6.2, and `landlock` among lsm=); there is {present}"
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
    return _words(separate=separable())


def _words(*, separate: bool) -> str:
    version = _landlock_version()
    signals = ", signals" if version >= _SCOPED_VERSION else ""
    calls = len(allowed_calls(_PROCESSORS[platform.machine()].column))
    apart = "; namespaces: users, processes, network, shared memory, mounts" if separate else ""
    return f"no_new_privs; Landlock {version}: files{signals}; seccomp: {calls} system calls{apart}"


@cache
def separable() -> bool:
    """Whether this system lets a process have namespaces of its own; they are tried out in one."""
    code = "from ddpc_cosim.processes import sandbox; sandbox.separate()"
    with start_python(code, subprocess.DEVNULL) as trial:
        try:
            return trial.wait(START_SECONDS) == 0
        except subprocess.TimeoutExpired:
            trial.kill()
            return False


@contextmanager
def demanded(wanted: bool) -> Iterator[None]:
    """Have C sources compiled in a sandbox in this block, if that is wanted there or around it."""
    before = _demanded.set(_demanded.get() or wanted)
    try:
        yield
    finally:
        _demanded.reset(before)


def is_demanded() -> bool:
    """Whether code of others must run in a sandbox."""
    return _demanded.get()


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


def enter(sandbox: Sandbox, *, apart: bool) -> None:
    """Put this process, of one thread, and all that it will start into a sandbox, for good.

    Parameters
    ----------
    sandbox : Sandbox
        What it may still do.
    apart : bool
        Whether it goes on in namespaces of its own, if this system has them: as another process, whose end
        this one waits for.

    Raises
    ------
    ConfigError
        This system has none, and what is missing.
    OSError
        The system refuses it.
    """
    global _entered
    if lacking := missing():
        raise ConfigError(f"the sandbox is not possible on this system: it needs {lacking}")
    if len([*Path("/proc/self/task").iterdir()]) > 1:
        raise RuntimeError("other threads of this process would stay outside of the sandbox")
    words = _words(separate=apart)
    if apart:
        separate()
    libc = _libc()
    _check(libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0), "no_new_privs")
    _restrict_files(libc, sandbox)
    # Capabilities: version 3, none of the 64.
    _check(libc.capset(struct.pack("=Ii", 0x20080522, 0), bytes(24)), "capabilities")
    _filter_calls(libc)
    try:
        socket.socket().close()
    except PermissionError:
        _entered = words
    else:
        raise RuntimeError("the sandbox does not hold: a socket could be opened")


def _readable(sandbox: Sandbox) -> list[Path]:
    """Return the readable folders: none that contains the home folder, or by import path temporary files."""
    home, temporary = Path.home().resolve(), Path(tempfile.gettempdir()).resolve()
    places = (Path(place).resolve() for place in (sys.prefix, sys.base_prefix, *sys.path) if place)
    installed = [place for place in places if not temporary.is_relative_to(place)]
    paths = [place for place in (*installed, *sandbox.readable) if not home.is_relative_to(place.resolve())]
    return [*map(Path, _INSTALLED), *(Path("/proc", name) for name in _PROC), *paths]


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
        if path.is_relative_to("/proc"):
            _held.append(place)  # the rule is of what has been found there, which may be made anew otherwise
        else:
            os.close(place)


def separate() -> None:
    """Go on as another process, in namespaces of its own; this one waits for its end, and ends alike.

    Raises
    ------
    OSError
        The system refuses it.
    """
    libc, user, group = _libc(), os.geteuid(), os.getegid()
    _check(libc.unshare(_NAMESPACES), "namespaces")
    itself = {"uid_map": f"{user} {user} 1", "gid_map": f"{group} {group} 1"}
    for name, line in ({"setgroups": "deny"} | itself).items():
        Path("/proc/self", name).write_text(line, encoding="ascii")
    read_end, write_end = os.pipe()
    first = os.fork()
    if first != 0:
        os.close(write_end)
        _end_like(first, read_end)
    os.close(read_end)
    libc.prctl(_DIE_WITH_PARENT, signal.SIGKILL, 0, 0, 0)
    _check(libc.mount(b"none", b"/", None, ctypes.c_ulong(_PRIVATE), None), "mounts")
    _check(libc.mount(b"proc", b"/proc", b"proc", ctypes.c_ulong(_HARMLESS), None), "/proc")
    # With the first process of a namespace all others there end; but it does not end by its own signals, so
    # that it cannot be the one that runs the FMU.
    if second := os.fork():
        _report_end(libc, second, write_end)
    os.close(write_end)


def _report_end(libc: ctypes.CDLL, pid: int, write_end: int) -> NoReturn:
    """Wait for the end of a process, as of all that are left to this one, and write how it ended."""
    try:
        libc.syscall(_CLOSE_RANGE, 0, write_end - 1, 0)
        libc.syscall(_CLOSE_RANGE, write_end + 1, ctypes.c_uint(_LAST_DESCRIPTOR), 0)
        ended = status = 0
        while ended != pid:
            ended, status = os.wait()
        os.write(write_end, struct.pack("=i", status))
    finally:
        os._exit(LEFT_BEHIND)


def _end_like(keeper: int, read_end: int) -> NoReturn:
    """Wait for the end of the process that tells of another one's, and end as that did.

    What this process has open stays open until then: whoever waits for its end can tell how it ended.
    """
    try:
        content = os.read(read_end, struct.calcsize("=i"))
        status = os.waitpid(keeper, 0)[1]
        code = os.waitstatus_to_exitcode(*(struct.unpack("=i", content) if content else (status,)))
        if code >= 0:
            os._exit(code)
        with suppress(OSError, ValueError):  # one that cannot be handled ends it anyway
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    finally:
        os._exit(LEFT_BEHIND)


def _filter_calls(libc: ctypes.CDLL) -> None:
    processor = _PROCESSORS[platform.machine()]
    program = [(_LOAD, 0, 0, _PROCESSOR), (_EQUAL, 1, 0, processor.audit), (_RETURN, 0, 0, _KILL)]
    program += [(_LOAD, 0, 0, _NUMBER), (_AT_LEAST, 0, 1, _FOREIGN_CALLS), (_RETURN, 0, 0, _REFUSE)]
    for number, conditions in allowed_calls(processor.column).items():
        decision = _decision(conditions)
        program += [(_EQUAL, 0, len(decision), number), *decision]
    program += [(_AT_LEAST, 0, 1, FIRST_NEW), (_RETURN, 0, 0, _NOT_THERE), (_RETURN, 0, 0, _REFUSE)]
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *line) for line in program))
    head = ctypes.create_string_buffer(struct.pack("@HP", len(program), ctypes.addressof(code)))
    _check(libc.prctl(_SECCOMP, _FILTER, head, 0, 0), "seccomp")


def _decision(conditions: tuple[Condition, ...]) -> list[tuple[int, int, int, int]]:
    """Return the part of a filter that allows a call if its arguments are as they have to be."""
    part = list[tuple[int, int, int, int]]()
    for argument, mask, values in conditions:
        part += [(_LOAD, 0, 0, _ARGUMENTS + 8 * argument), (_AND, 0, 0, mask)]
        part += [(_EQUAL, len(values) - i, 0, value) for i, value in enumerate(values)]
        part += [(_RETURN, 0, 0, _REFUSE)]
    return [*part, (_RETURN, 0, 0, _ALLOW)]


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
