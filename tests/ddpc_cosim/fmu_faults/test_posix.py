"""What holds where there are permissions, forks and signals."""

import os
import stat
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from fmus.builder import library_name

from ddpc_cosim import FMUStepError
from ddpc_cosim.fmu.archive import unpack
from ddpc_cosim.fmu.isolation import IsolatedSession
from ddpc_cosim.fmu.isolation_fork import ForkServer
from ddpc_cosim.fmu.scratch import ScratchFolder

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
    found = {
        name: (tmp_path / name).stat().st_mode & 0o7111
        for name in (tool.filename, library_name("2.0"), "resources/table.txt")
    }
    assert found == {tool.filename: 0o111, library_name("2.0"): 0o111, "resources/table.txt": 0}


class TestTheServer:
    def test_it_lives_as_long_as_its_fmus(self, faulty_fmus: dict[int, Path], scratch: Path) -> None:
        """All isolated FMUs of a process come from one server; after the last one no process is left."""
        before = set(descendants(os.getpid()))
        first = IsolatedSession(faulty_fmus[2])
        server = ForkServer.acquire()
        second = IsolatedSession(faulty_fmus[2])
        first.close()
        second.reset()
        np.testing.assert_allclose(second.step(U, H), [H])
        second.close()
        third = IsolatedSession(faulty_fmus[2])
        third.close()
        server.release()
        assert set(descendants(os.getpid())) == before

    def test_one_that_was_killed(self, faulty_fmus: dict[int, Path], scratch: Path) -> None:
        """Its FMUs crash with it, and the next one gets another server."""
        session = IsolatedSession(faulty_fmus[2])
        session.reset()
        server = ForkServer.acquire()
        server._process.kill()
        server._process.wait()
        with pytest.raises(FMUStepError, match="crashed in step at t = 0 s: its process has gone"):
            session.step(U, H)
        np.testing.assert_allclose(session.reset(), [0.0])
        session.close()
        server.release()


FORKED = """
import os, sys
import numpy as np
from pathlib import Path
from ddpc_cosim.fmu.isolation import IsolatedSession

session = IsolatedSession(Path(sys.argv[1]))
session.reset()
if os.fork() == 0:
    del session
    other = IsolatedSession(Path(sys.argv[1]))
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


class TestScratchFolders:
    SCRIPT = """
import os, signal
from ddpc_cosim.fmu.scratch import ScratchFolder
folder = ScratchFolder()
(folder.path / "file").touch()
print(folder.path, flush=True)
input()
"""

    @pytest.mark.parametrize("how", ["killed", "at its end"])
    def test_the_process_ends(self, how: str, scratch: Path) -> None:
        command = [sys.executable, "-c", self.SCRIPT]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
            assert process.stdout is not None
            folder = Path(process.stdout.readline().rstrip("\n"))
            assert (folder / "file").exists()
            keeper = Watch(descendants(process.pid))
            if how == "killed":
                process.kill()
            process.communicate("\n")
        assert keeper.wait(60.0) == []
        assert list(scratch.iterdir()) == []

    def test_removed_once(self, scratch: Path) -> None:
        before = descendants(os.getpid())
        folder = ScratchFolder()
        folder.remove()
        folder.path.mkdir()
        folder.remove()
        assert folder.path.is_dir()
        assert descendants(os.getpid()) == before
