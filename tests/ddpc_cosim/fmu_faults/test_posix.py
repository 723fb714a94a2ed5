"""What holds where there are permissions, forks and signals."""

import importlib
import json
import os
import signal
import stat
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmus.builder import library_name

from ddpc_cosim import FMUPlant, FMUStepError
from ddpc_cosim.fmu.archive import unpack
from ddpc_cosim.processes.fork_server import ForkServer
from ddpc_cosim.processes.scratch import ScratchFolder, remove_left_behind
from ddpc_cosim.processes.worker import Worker, result_of

from .loop import H
from .processes import Watch, descendants

U = np.ones(1)


def test_permissions(tmp_path: Path) -> None:
    """Binaries and what was executable can be executed; nothing else, and never as somebody else."""
    tool = zipfile.ZipInfo("resources/tool")
    tool.create_system, tool.external_attr = 3, (stat.S_IFREG | 0o6755) << 16
    path = tmp_path / "x.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("modelDescription.xml", tool, library_name("2.0"), "resources/table.txt"):
            archive.writestr(name, b"<x/>")
    unpack(path, tmp_path)
    modes = {
        name: (tmp_path / name).stat().st_mode & 0o7111
        for name in (tool.filename, library_name("2.0"), "resources/table.txt")
    }
    assert modes == {tool.filename: 0o111, library_name("2.0"): 0o111, "resources/table.txt": 0}


class TestTheServer:
    def test_it_is_kept_for_the_next_worker(self, faulty_fmus: dict[int, Path], scratch: Path) -> None:
        """All workers of a process come from one server; they end with their FMUs."""
        FMUPlant(faulty_fmus[2], isolated=True).close()
        before = set(descendants(os.getpid()))
        first, second = (FMUPlant(faulty_fmus[2], isolated=True) for _ in range(2))
        first.close()
        second.reset()
        np.testing.assert_allclose(second.step(U, H), [H])
        second.close()
        assert set(descendants(os.getpid())) == before

    def test_one_that_was_killed(self, faulty_fmus: dict[int, Path], scratch: Path) -> None:
        """Its workers end with it, and the next one gets another server."""
        session = FMUPlant(faulty_fmus[2], isolated=True)
        session.reset()
        server = ForkServer.running()
        server._process.kill()
        server._process.wait()
        gone = "its process has gone, and the one that starts processes with it"
        with pytest.raises(FMUStepError, match=f"crashed in step at t = 0 s: {gone}"):
            session.step(U, H)
        np.testing.assert_allclose(session.reset(), [0.0])
        session.close()

    def test_one_whose_caller_ignores_what_becomes_of_children(
        self, worker_side: Any, tmp_path: Path
    ) -> None:
        """As a service manager may start it: a worker's exit code is told all the same."""
        ForkServer.running()._stop()
        before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
        try:
            worker = Worker(worker_side.leave_a_process, folder=tmp_path)
        finally:
            signal.signal(signal.SIGCHLD, before)
        assert worker.end().code == -signal.SIGKILL


WORKER_SIDE = """
import ctypes, json, os, signal, subprocess, sys
from ddpc_cosim.processes.worker import reply

def leave_a_process(channel):
    child = subprocess.Popen([sys.executable, "-c", "import signal; signal.pause()"])
    channel.send(str(child.pid).encode())
    channel.receive(1)

def leave_a_copy(channel, in_own_session, dies):
    child = os.fork()
    if child == 0:
        if in_own_session:
            os.setsid()
        channel.send(str(os.getpid()).encode())
        signal.pause()
    if dies:
        channel.receive(1)
        os._exit(3)
    signal.pause()

def hang_at_exit():
    libc = ctypes.CDLL(None)
    libc.on_exit(libc.pause, None)

def call_exit(channel):
    ctypes.CDLL(None).exit(3)

def tell_path(channel):
    reply(channel, lambda: [json.__file__, sys.path])
"""


@pytest.fixture
def worker_side(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Functions of a module that workers find too."""
    (tmp_path / "worker_side.py").write_text(WORKER_SIDE, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("worker_side")
    del sys.modules["worker_side"]


def test_what_libraries_do_at_the_end_does_not_keep_a_worker(worker_side: Any, tmp_path: Path) -> None:
    """Such as waiting for threads: those of the process that it was forked from are not there.

    Where the C library has no such hook, nothing hangs.
    """
    preload = ["worker_side:hang_at_exit"]
    worker = Worker(worker_side.call_exit, folder=tmp_path, preload=preload, alone=True)
    with pytest.raises(EOFError):
        worker.channel.receive(1, seconds=60.0)
    assert worker.end().code == 3


@pytest.mark.parametrize("how", ["ended", "died"])
def test_what_a_worker_forks_ends_with_it(how: str, worker_side: Any, tmp_path: Path) -> None:
    worker = Worker(worker_side.leave_a_process, folder=tmp_path)
    family = Watch([int(worker.channel.receive(20))])
    if how == "died":
        worker.channel.send(b"")
        with pytest.raises(EOFError):
            worker.channel.receive(1)
    assert worker.end().code == (70 if how == "died" else -signal.SIGKILL)
    assert family.wait(60.0) == []


# Only Linux tells a death at once, and hands over what has left its session.
LEAVES_OR_DIES = (False, True) if sys.platform == "linux" else (False,)


@pytest.mark.parametrize("dies", LEAVES_OR_DIES)
@pytest.mark.parametrize("in_own_session", LEAVES_OR_DIES)
def test_a_copy_that_holds_the_channel_open_ends_with_its_worker(
    in_own_session: bool, dies: bool, worker_side: Any, tmp_path: Path
) -> None:
    """Its death is told at once: the channel ends, whoever else had it open."""
    neighbour, worker = (
        Worker(worker_side.leave_a_copy, in_own_session, whether, folder=tmp_path)
        for whether in (False, dies)
    )
    other, copy = (Watch([int(process.channel.receive(20))]) for process in (neighbour, worker))
    if dies:
        worker.channel.send(b"")
        with pytest.raises(EOFError):
            worker.channel.receive(1, seconds=60.0)
    assert worker.end().code == (3 if dies else -signal.SIGKILL)
    assert copy.wait(60.0) == []
    assert other.wait(0.0) == other.pids
    neighbour.end()
    assert other.wait(60.0) == []


def test_nothing_beside_a_script_shadows_a_library(
    worker_side: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What this process finds there is still found, behind everything that is installed."""
    for name in ("json", "socket", "selectors", "numpy"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit(9)", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("")
    ForkServer.running()._stop()
    worker = Worker(worker_side.tell_path, folder=tmp_path)
    library, path = result_of(worker.channel.receive(10_000))
    worker.end()
    assert library == json.__file__
    installed = (sysconfig.get_paths()[kind] for kind in ("stdlib", "purelib"))
    assert path.index(str(tmp_path)) > max(path.index(folder) for folder in installed)


def test_a_working_directory_that_has_been_removed(
    faulty_fmus: dict[int, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An interactive session finds what is installed all the same."""
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    monkeypatch.syspath_prepend("")
    gone.rmdir()
    ForkServer.running()._stop()
    with FMUPlant(faulty_fmus[2], isolated=True) as plant:
        np.testing.assert_allclose(plant.reset(), [0.0])


FORKED = """
import os, sys
import numpy as np
from pathlib import Path
from ddpc_cosim import FMUPlant

session = FMUPlant(sys.argv[1], isolated=True)
session.reset()
if os.fork() == 0:
    del session
    other = FMUPlant(sys.argv[1], isolated=True)
    other.reset()
    print(other.step(np.ones(1), 0.5), flush=True)
    other.close()
    sys.exit()
os.wait()
print(session.step(np.ones(1), 0.25))
session.close()
"""


def test_a_forked_copy_of_the_master(faulty_fmus: dict[int, Path], scratch: Path) -> None:
    """It leaves its parent's FMU alone and can have its own."""
    command = [sys.executable, "-c", FORKED, str(faulty_fmus[2])]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "[0.5]\n[0.25]\n"), done.stderr
    assert list(scratch.iterdir()) == []


OUTLIVED = """
import os, signal, sys
from ddpc_cosim.processes.fork_server import ForkServer

print(ForkServer.running()._process.pid, flush=True)
sys.stdin.readline()
if os.fork() == 0:
    sys.stdin.read()
    os._exit(0)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_forked_copy_that_outlives_the_master() -> None:
    """The server does not wait for its end."""
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", OUTLIVED], stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        server = Watch([int(process.stdout.readline())])
        process.stdin.write("\n")
        process.stdin.flush()
        assert server.wait(60.0) == []


class TestScratchFolders:
    SCRIPT = """
import os, signal
from ddpc_cosim.processes.scratch import ScratchFolder
folder = ScratchFolder()
(folder.path / "file").touch()
print(folder.path, flush=True)
input()
"""

    @pytest.mark.parametrize("how", ["killed", "at its end"])
    def test_the_process_ends(self, how: str, scratch: Path) -> None:
        """What a process that was killed has left behind, the next one removes; not what is in use."""
        command = [sys.executable, "-c", self.SCRIPT]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
            assert process.stdout is not None
            folder = Path(process.stdout.readline().rstrip("\n"))
            remove_left_behind(scratch)
            assert (folder / "file").exists()
            if how == "killed":
                process.kill()
            process.communicate("\n")
        assert folder.exists() == (how == "killed")
        remove_left_behind(scratch)
        assert list(scratch.iterdir()) == []

    def test_the_lock_goes_last(self, scratch: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Whenever a removal is cut short, the next process can tell what is left to remove."""
        folder, locked, remove = ScratchFolder(), [], os.rmdir

        def note(path: Any, **place: Any) -> None:
            locked.append((folder.path / ".lock").exists())
            remove(path, **place)

        for number in range(20):
            (folder.path / str(number)).mkdir()
        monkeypatch.setattr(os, "rmdir", note)
        folder.remove()
        assert locked == [True] * 20 + [False]
        assert list(scratch.iterdir()) == []

    def test_folders_within_folders_beyond_what_python_can_go_through(self, scratch: Path) -> None:
        """Left behind by a process that was killed, they are removed by the next, and do not stop it."""
        folder, here = scratch / "ddpc-cosim-deep", Path.cwd()
        folder.mkdir()
        (folder / ".lock").touch()
        os.chdir(folder)
        try:
            for depth in range(3000):
                Path("d").mkdir()
                os.chdir("d")
                Path(f"file{depth}").touch()
        finally:
            os.chdir(here)
        remove_left_behind(scratch)
        assert list(scratch.iterdir()) == []

    def test_removed_once(self, scratch: Path) -> None:
        folder = ScratchFolder()
        folder.remove()
        folder.path.mkdir()
        folder.remove()
        assert folder.path.is_dir()
