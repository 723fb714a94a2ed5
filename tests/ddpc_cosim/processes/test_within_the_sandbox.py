"""What a process in the sandbox may and may not do, asked of it."""

import os
import shutil
import socket
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ddpc_cosim.processes.sandbox import Sandbox
from ddpc_cosim.processes.worker import LONGEST_REPLY, UnexpectedError, Worker, ask, result_of, serve_calls

REFUSED = "PermissionError: .Errno 13"  # by the filter, whatever rights there are
Ask = Callable[..., Any]


@pytest.fixture
def called(tmp_path: Path) -> Iterator[Ask]:
    """Calls of functions in a process in the sandbox."""

    def call(function: Callable[..., Any], *arguments: Any) -> Any:
        ask(worker.channel, function, *arguments)
        return result_of(worker.channel.receive(LONGEST_REPLY))

    own = tmp_path / "own"
    own.mkdir()
    worker = Worker(serve_calls, folder=own, sandbox=Sandbox((own,)))
    try:
        yield call
    finally:
        worker.end()


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
    module, own = tmp_path / "module.py", tmp_path / "own"
    module.write_text("", encoding="utf-8")
    own.mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    if not holds_temporary_files:
        own = Path(tempfile.mkdtemp())
    worker = Worker(serve_calls, folder=own, sandbox=Sandbox((own,)))
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
        shutil.rmtree(own)
