"""What a process in the sandbox may and may not do, asked of it."""

import csv
import fcntl
import os
import platform
import shutil
import socket
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ddpc_cosim.processes.sandbox import Sandbox, entered, require, separable
from ddpc_cosim.processes.worker import LONGEST_REPLY, UnexpectedError, Worker, ask, result_of, serve_calls

REFUSED = "PermissionError: .Errno 13"  # by the filter, whatever rights there are
Ask = Callable[..., Any]


@pytest.fixture(params=["apart", "beside others"])
def apart(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether the process has namespaces of its own; where the system has none, it has none twice."""
    apart = request.param == "apart" and separable()
    for module in ("sandbox", "worker"):
        monkeypatch.setattr(f"ddpc_cosim.processes.{module}.separable", lambda: apart)
    return apart


@pytest.fixture
def writable(tmp_path: Path) -> Path:
    """The folder that the process may write to."""
    folder = tmp_path / "own"
    folder.mkdir()
    return folder


@pytest.fixture
def readable(tmp_path: Path) -> Path:
    """A file that it may read, alone in its folder, which it may read too."""
    folder = tmp_path / "study"
    folder.mkdir(mode=0o755)
    path = folder / "file"
    path.write_text("content", encoding="utf-8")
    return path


@pytest.fixture
def called(writable: Path, readable: Path, apart: bool) -> Iterator[Ask]:
    """Calls of functions in a process in the sandbox."""

    def call(function: Callable[..., Any], *arguments: Any) -> Any:
        ask(worker.channel, function, *arguments)
        return result_of(worker.channel.receive(LONGEST_REPLY))

    worker = Worker(serve_calls, folder=writable, sandbox=Sandbox((writable,), (readable.parent,)))
    try:
        yield call
    finally:
        worker.end()


# What comes of each call, asked in copies of the process: one that ends a copy has been let through.
ASKING = """
import ctypes, errno, os, signal

libc = ctypes.PyDLL(None, use_errno=True)
libc.syscall.restype = ctypes.c_long
WORDS = {errno.EACCES: "refused", errno.ENOSYS: "unknown"}

def answer(number, arguments, waits):
    itself = os.getpid()
    if waits:
        signal.setitimer(signal.ITIMER_REAL, 0.01)
    ctypes.set_errno(0)
    returned = libc.syscall(*(ctypes.c_long(value) for value in (number, *arguments)))
    if os.getpid() != itself:
        os._exit(0)
    return WORDS.get(ctypes.get_errno(), "allowed") if returned == -1 else "allowed"

def answers(calls):
    found = []
    while len(found) < len(calls):
        reading, writing = os.pipe()
        copy = os.fork()
        if copy == 0:
            for call in calls[len(found):]:
                os.write(writing, (answer(*call) + " ").encode())
            os._exit(0)
        os.close(writing)
        with os.fdopen(reading) as told:
            found += told.read().split()
        code = os.waitstatus_to_exitcode(os.waitpid(copy, 0)[1])
        if len(found) < len(calls):
            found.append("killed" if code == -signal.SIGSYS else "allowed")
    return found
"""
# What is harmless as any argument is not allowed as any; and some have another answer for it than a refusal.
POSSIBLE = {
    "fcntl": (-1, 1),
    "ioctl": (-1, 0x5401),
    "prctl": (3,),
    "clone": (0x10000,),  # threads have to share what is not shared here
    "socketpair": (1, 1, 0, -1),
    "getsockopt": (-1, 1, 3),
    "setsockopt": (-1, 1, 20),
    "prlimit64": (0, -1),
    **dict.fromkeys(("sched_setaffinity", "sched_setparam", "sched_setscheduler", "sched_setattr"), (0, -1)),
}
HARMLESS = {"futex": (0, 0, 0, 0)}
WAITING = {"pause", "vfork"}
FIRST_NEW, NUMBERS, FOREIGN = 435, range(520), 0x40000000


def _answers(called: Ask, writable: Path, calls: list[tuple[int, tuple[int, ...], bool]]) -> list[str]:
    (writable / "asking.py").write_text(ASKING, encoding="utf-8")
    answers = f"__import__('runpy').run_path({str(writable / 'asking.py')!r})['answers']"
    return list(called(eval, f"{answers}({calls!r})"))


@pytest.mark.parametrize("apart", ["apart"], indirect=True)
def test_every_system_call_of_the_kernel(called: Ask, writable: Path) -> None:
    """What is not in the list of allowed calls is refused, of this kernel and of later ones."""
    with Path(__file__).with_name("system_calls.csv").open(encoding="utf-8", newline="") as file:
        listed = {
            int(row[platform.machine()]): (row["name"], row["in_the_sandbox"])
            for row in csv.DictReader(file)
            if row[platform.machine()]
        }
    every = {number: (str(number), "unknown" if number >= FIRST_NEW else "refused") for number in NUMBERS}
    every |= listed
    # The kernel lets those of its own probes pass by any filter; older ones do not know them.
    asked = {
        number: name_and_answer for number, name_and_answer in every.items() if name_and_answer[1] != "probe"
    }
    calls = [(n, HARMLESS.get(name, (-1,) * 6), name in WAITING) for n, (name, _) in asked.items()]
    answers = _answers(called, writable, calls)
    names = [name for name, _ in asked.values()]
    expected = ["refused" if word == "sometimes" else word for _, word in asked.values()]
    assert dict(zip(names, answers, strict=True)) == dict(zip(names, expected, strict=True))
    sometimes = {name: number for number, (name, word) in listed.items() if word == "sometimes"}
    assert sometimes.keys() == POSSIBLE.keys()
    possible = [(number, POSSIBLE[name], False) for name, number in sometimes.items()]
    assert _answers(called, writable, possible) == ["allowed"] * len(possible)
    foreign = [(FOREIGN + number, (-1,) * 6, False) for number in (0, 1, 39, 520)]
    assert {*_answers(called, writable, foreign)} == {"refused"}


def test_what_is_open_for_reading_stays_as_it_is(called: Ask, readable: Path) -> None:
    """Its mode, owner, attributes and flags; and writing to it is not blocked for others."""
    before = [path.stat() for path in (readable, readable.parent)]
    opened = f"(os := __import__('os')).open({str(readable)!r}, os.O_RDONLY)"
    folder = f"(os := __import__('os')).open({str(readable.parent)!r}, os.O_RDONLY)"
    call = "__import__('fcntl')"
    for attempt in (
        f"os.fchmod({folder}, 0o777)",
        f"os.fchown({opened}, {os.geteuid()}, {os.getegid()})",
        f"os.setxattr({opened}, 'user.name', b'')",
        f"os.getxattr({str(readable)!r}, 'user.name')",
        f"{call}.ioctl({opened}, 0x40086602, bytes(8))",  # FS_IOC_SETFLAGS
        f"{call}.fcntl({opened}, {call}.F_SETLEASE, {call}.F_RDLCK)",
        f"{call}.fcntl({folder}, {call}.F_NOTIFY, {call}.DN_MULTISHOT)",
        f"{call}.fcntl({opened}, {call}.F_SETOWN, 1)",
    ):
        with pytest.raises(UnexpectedError, match=REFUSED):
            called(eval, f"[(os := __import__('os')), {attempt}]")
    after = [path.stat() for path in (readable, readable.parent)]
    assert [(s.st_mode, s.st_uid, s.st_ctime_ns) for s in after] == [
        (s.st_mode, s.st_uid, s.st_ctime_ns) for s in before
    ]
    assert called(eval, f"__import__('pathlib').Path({str(readable)!r}).read_text()") == "content"


def test_no_names_and_no_namespaces(called: Ask) -> None:
    """A pair of sockets has no name; nor does what is started have rights of its own."""
    with pytest.raises(UnexpectedError, match=REFUSED):
        called(eval, "__import__('socket').socketpair()[0].bind('\\0name')")
    code = (
        "[(c := __import__('ctypes')), (libc := c.CDLL(None, use_errno=True)).unshare({}), c.get_errno()][1:]"
    )
    for namespace in (
        0x10000000,
        0x20000000,
        0x40000000,
        0x08000000,
        0x04000000,
        0x02000000,
        0x00020000,
        0x80,
    ):
        assert called(eval, code.format(namespace)) == [-1, 13]


def test_nothing_of_the_network_in_proc(called: Ask) -> None:
    """There is a folder of it for each process and each thread."""
    for path in ("/proc/net/unix", "/proc/self/net/tcp", "/proc/thread-self/net/dev", "/proc/1/net/route"):
        with pytest.raises(UnexpectedError, match=r"PermissionError: .Errno 13|FileNotFoundError"):
            called(eval, f"open({path!r}).read()")
    for path in ("/proc/self/maps", "/proc/cpuinfo", "/proc/meminfo", "/proc/sys/vm/overcommit_memory"):
        assert called(eval, f"open({path!r}).read(1)")


def test_it_says_what_it_is_in(called: Ask, apart: bool) -> None:
    """Other processes are not there where it has namespaces of its own, nor is a network."""
    words = called(entered)
    assert words == require()
    assert ("namespaces: users, processes, network" in words) == apart
    assert (called(os.getppid) == 1) == apart
    assert called(os.geteuid) == os.geteuid()
    with pytest.raises(UnexpectedError, match=REFUSED):
        called(os.listdir, "/proc")
    # As where a system does not have them.
    assert called(eval, "__import__('ddpc_cosim.processes.sandbox', fromlist='_').separable()") is False


@pytest.mark.parametrize(
    ("call", "words"),
    [("abort()", "SIGABRT"), ("_exit(3)", "exit code 3"), ("kill(os.getpid(), 9)", "SIGKILL")],
)
def test_its_end_is_told_as_it_was(call: str, words: str, writable: Path, apart: bool) -> None:
    """Also where it is not the process that was started; and what it has left ends with it."""
    worker = Worker(serve_calls, folder=writable, sandbox=Sandbox((writable,)))
    leave = "os.fork() or [os.setsid(), __import__('signal').pause()]"
    file = f"os.open({str(writable / 'lock')!r}, os.O_CREAT)"
    lock = f"(fcntl := __import__('fcntl')).flock({file}, fcntl.LOCK_EX)"
    try:
        ask(worker.channel, eval, f"[(os := __import__('os')), {lock}, {leave}, os.{call}]")
        with pytest.raises(EOFError):
            worker.channel.receive(LONGEST_REPLY)
    finally:
        ending = worker.end()
    assert words in str(ending)
    with (writable / "lock").open() as file:  # which whoever is left would have
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_limits_of_another_process_are_its_own(called: Ask) -> None:
    """One of CPU time would end it, which is a signal by another name; others slow it down."""
    import resource

    limits, processors = resource.getrlimit(resource.RLIMIT_CPU), os.sched_getaffinity(0)
    for function, *arguments in (
        (resource.prlimit, os.getpid(), resource.RLIMIT_CPU, limits),
        (os.sched_setaffinity, os.getpid(), processors),
        (eval, f"(os := __import__('os')).sched_setscheduler({os.getpid()}, 0, os.sched_param(0))"),
        (os.setpriority, os.PRIO_PROCESS, os.getpid(), os.getpriority(os.PRIO_PROCESS, 0)),
    ):
        with pytest.raises(UnexpectedError, match=REFUSED):
            called(function, *arguments)
    called(os.sched_setaffinity, 0, processors)
    called(resource.setrlimit, resource.RLIMIT_CPU, (600, limits[1]))
    assert called(resource.getrlimit, resource.RLIMIT_CPU) == [600, limits[1]]


def test_no_datagrams_to_services(called: Ask) -> None:
    """A pair of sockets needs no address; but one end of a pair of datagrams can send to any."""
    with pytest.raises(UnexpectedError, match=REFUSED):
        called(socket.socketpair, socket.AF_UNIX, socket.SOCK_DGRAM)
    assert called(eval, "__import__('socket').socketpair()[0].type") == socket.SOCK_STREAM


def test_what_landlock_leaves_alone(called: Ask, tmp_path: Path) -> None:
    """The times of a file, and who looks at a folder."""
    path = tmp_path / "file"
    path.touch()
    with pytest.raises(UnexpectedError, match=REFUSED):
        called(os.utime, str(path), (1.0, 1.0))
    watch = "(c := __import__('ctypes').CDLL(None)).inotify_add_watch(c.inotify_init(), {!r}, 0xFFF)"
    assert called(eval, watch.format(os.fsencode(tmp_path))) == -1


@pytest.mark.parametrize("holds_temporary_files", [True, False])
def test_the_import_path_opens_no_temporary_files(
    holds_temporary_files: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where a script lies beside them, whose folder is on the import path."""
    module, writable = tmp_path / "module.py", tmp_path / "own"
    module.write_text("", encoding="utf-8")
    writable.mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    if not holds_temporary_files:
        writable = Path(tempfile.mkdtemp())
    worker = Worker(serve_calls, folder=writable, sandbox=Sandbox((writable,)))
    try:
        ask(worker.channel, os.listdir, str(tmp_path))
        answer = worker.channel.receive(LONGEST_REPLY)
        if not holds_temporary_files:
            assert "module.py" in result_of(answer)
        else:
            with pytest.raises(UnexpectedError, match="PermissionError"):
                result_of(answer)
    finally:
        worker.end()
        shutil.rmtree(writable)
