"""Workers that meddle with what the master reads, stop, or print without end: it costs their own case."""

import os
import subprocess
import sys
from collections.abc import Callable
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path

import pytest
from studies import study_text, write

from ddpc_cosim import CosimError, load_results
from ddpc_cosim.processes.rows import RowStore, info_path
from ddpc_cosim.processes.worker import result_of
from ddpc_cosim.study.case_files import read_run

WriteStudy = Callable[..., Path]
Run = Callable[..., subprocess.CompletedProcess[str]]

MEDDLING = """
import os, signal, socket, stat, struct, tempfile
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from ddpc_cosim import Controller, CosimError
from ddpc_cosim.study.cases import (Case)
from ddpc_cosim.study import case_files

@dataclass(kw_only=True)
class Meddles(Controller):
    def start(self, loop):
        pass
    def step(self, sample):
        if sample.k == 3:
            self.meddle()
        return np.ones(1)

def say(content):
    channel = next(n for n in range(3, 99) if is_socket(n))
    with socket.socket(fileno=os.dup(channel)) as channel:
        channel.sendall(struct.pack("=q", len(content)) + content)
    while True:
        signal.pause()

def is_socket(number):
    try:
        return stat.S_ISSOCK(os.fstat(number).st_mode)
    except OSError:
        return False

class Done(Meddles):
    def meddle(self): say(b'{"result": null}')

class Error(Meddles):
    def meddle(self): say(b'{"error": "CosimError", "arguments": ["stop all of it"]}')

class Cut(Meddles):
    def meddle(self):
        for rows in Path(tempfile.gettempdir()).glob("rows"):
            os.truncate(rows, 0)
        os.kill(os.getpid(), signal.SIGKILL)

class Links(Meddles):
    def meddle(self):
        def link(path, *columns):
            path.symlink_to("/etc/hostname")
        case_files.write_table = link

class Stages(Meddles):
    def meddle(self):
        def staged(path, *columns):
            self.stage(path)
            say(b'{"result": null}')
        case_files.write_table = staged

class Removes(Stages):
    def stage(self, path): path.parent.rmdir()

class Moves(Stages):
    def stage(self, path):
        path.parent.rmdir()
        path.parent.symlink_to("/etc")

class Swells(Stages):
    def stage(self, path):
        path.touch()
        os.truncate(path, 1 << 40)

class Adds(Stages):
    def stage(self, path): path.with_name("page.html").touch()

class Forges(Meddles):
    def meddle(self):
        head = Case.head
        Case.head = lambda case: head(case) | {"controller": "mfapc"}

class Hangs(Exception):
    def __str__(self): signal.pause()

class Mute(Meddles):
    def meddle(self): raise Hangs

class MuteAtStart(Meddles):
    def start(self, loop): raise type("Hangs", (Hangs, CosimError), {})

class Blank(Meddles):
    def step(self, sample): return np.array([type("Hangs", (), {"__repr__": Hangs.__str__})()])

class Stops(Meddles):
    def meddle(self): os.kill(os.getpid(), signal.SIGSTOP)

class StopsServer(Meddles):
    def meddle(self): os.kill(os.getppid(), signal.SIGSTOP)

class Prints(Meddles):
    def __init__(self):
        print("made")
    def meddle(self):
        for _ in range(20_000):
            print(999 * "x")
        print("the end")

class Grows(Meddles):
    def meddle(self):
        grown = []
        while True:
            grown.append(bytearray(1 << 24))

class Multiplies(Meddles):
    def meddle(self):
        for _ in range(1000):
            if os.fork() == 0:
                os.setsid()
                while True:
                    signal.pause()
        while True:
            signal.pause()

class Detaches(Meddles):
    def meddle(self):
        if os.fork() == 0:
            os.setsid()
            if os.fork() == 0:
                os.setsid()
                while True:
                    signal.pause()
            os._exit(0)

class Says(Meddles):
    def meddle(self):
        print("no", "way out")
        os._exit(3)
"""

ENDINGS = {
    "Done": ("crashed", "its process has left no results: "),
    "Error": ("crashed", "stop all of it"),
    "Cut": ("crashed", "before the first sample: the run: crashed in between two calls: SIGKILL"),
    "Links": ("crashed", "its process has left no results: signals.csv is not a file of its own"),
    "Removes": ("crashed", "its process has left no results: "),
    "Moves": ("crashed", "its process has left no results: its folder is a link"),
    "Swells": ("crashed", "its process has left no results: signals.csv has 1099511627776 bytes; allowed: "),
    "Adds": ("crashed", "its process has left no results: page.html is not a file of its own"),
    "Forges": ("crashed", "its process has left no results: run.json is of controller mfapc"),
    "Stops": ("timed-out", "controller meddling:Stops: no return within 2 s in step at t = 0.3 s"),
    "Mute": (
        "timed-out",
        "controller meddling:Mute: no return within 2 s in step at t = 0.3 s",
    ),
    "MuteAtStart": (
        "timed-out",
        "before the first sample: controller meddling:MuteAtStart: no return within 2 s in start",
    ),
    "Blank": (
        "timed-out",
        "controller meddling:Blank: no return within 2 s in step at t = 0 s",
    ),
    "StopsServer": ("completed", ""),
    "Prints": ("completed", ""),
    "Says": (
        "crashed",
        "controller meddling:Says: crashed in step at t = 0.3 s: its process ended with exit code 3; "
        "it printed: no way out",
    ),
}


def test_a_worker_that_meddles_costs_its_case_and_no_other(
    write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    (tmp_path / "meddling.py").write_text(MEDDLING, encoding="utf-8")
    write_study(*(f"meddling:{name}" for name in ENDINGS), "mfapc", loop={"step_timeout": 2.0})
    done = run_program("run", "study.toml", "--jobs", "1", "--no-report", "--out", "out")
    assert done.returncode == 1
    assert len(done.stdout + done.stderr) < 20_000
    assert "made" not in done.stdout + done.stderr
    *cases, last = load_results(tmp_path / "out").cases
    assert last.outcome == "completed"
    for case, (outcome, reason) in zip(cases, ENDINGS.values(), strict=True):
        assert (case.outcome, case.reason[: len(reason)]) == (outcome, reason)
    printed = {case.controller: read_run(case.folder)["printed"] for case in cases}
    assert (
        printed["prints"] == (999 * "x" + "\n")[-(4000 - 8) % 1000 :] + 3 * (999 * "x" + "\n") + "the end\n"
    )
    assert printed["says"] == "no way out\n"
    assert printed["stopsserver"] == ""


SHARING = """
import os
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
import numpy as np
from ddpc_cosim import Controller

class Shares(Controller):
    def start(self, loop):
        self.own, self.other = SharedMemory(create=True, size=100), SharedMemory(os.environ["OTHER"])
        Path(os.environ["FOLDER"], self.own.name).touch()
        self.other.buf[0] += 1
    def step(self, sample):
        return np.ones(1)

class Dies(Shares):
    def step(self, sample):
        os._exit(0)
"""


def test_shared_memory_that_a_controller_has_made_goes_with_its_case(
    write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    """What it has only opened stays."""
    (tmp_path / "sharing.py").write_text(SHARING, encoding="utf-8")
    (tmp_path / "made").mkdir()
    write_study("sharing:Shares", "sharing:Dies")
    other = SharedMemory(create=True, size=100)
    try:
        where = {"OTHER": other.name, "FOLDER": str(tmp_path / "made")}
        run_program("run", "study.toml", "--jobs", "1", "--no-report", "--out", "out", **where)
        assert other.buf[0] == 2
    finally:
        other.close()
        other.unlink()
    outcomes = [case.outcome for case in load_results(tmp_path / "out").cases]
    assert outcomes == ["completed", "crashed"]
    made = [path.name for path in (tmp_path / "made").iterdir()]
    assert len(made) == 2
    for name in made:
        with pytest.raises(FileNotFoundError):
            SharedMemory(name)


KILLING = """
import os, signal
from pathlib import Path
import numpy as np
from ddpc_cosim import Controller

class Meets(Controller):
    def start(self, loop):
        self.attempt = len([*Path("FOLDER").glob(f"{type(self).__name__}-*")]) + 1
        Path("FOLDER", f"{type(self).__name__}-{self.attempt}").touch()
    def step(self, sample):
        if sample.k == 3:
            self.meet()
        return np.ones(1)

class Kills(Meets):
    def meet(self):
        if self.attempt < 3:
            Path("FOLDER/fifo").read_bytes()  # until the other one is there
        os.kill(os.getppid(), signal.SIGKILL)
        signal.pause()

class Suffers(Meets):
    def meet(self):
        if self.attempt < 3:
            Path("FOLDER/fifo").write_bytes(b"")
            signal.pause()
"""


@pytest.mark.slow
def test_what_ends_the_process_that_starts_it_takes_no_other_along(
    write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    """Twice it does; then each of those that it took along runs again alone, and it is found."""
    (tmp_path / "met").mkdir()
    os.mkfifo(tmp_path / "met/fifo")
    code = KILLING.replace("FOLDER", str(tmp_path / "met"))
    (tmp_path / "killing.py").write_text(code, encoding="utf-8")
    write_study("killing:Suffers", "killing:Kills")
    done = run_program("run", "study.toml", "--jobs", "2", "--no-report", "--out", "out")
    assert done.returncode == 1, done.stderr
    suffers, kills = load_results(tmp_path / "out").cases
    assert (suffers.outcome, kills.outcome) == ("completed", "crashed")
    assert suffers.trace().u.tolist() == [[1.0]] * 11
    assert kills.reason == (
        "controller killing:Kills: crashed in step at t = 0.3 s: "
        "its process has gone, and the one that starts processes with it"
    )
    attempts = sorted(path.name for path in (tmp_path / "met").iterdir() if path.name != "fifo")
    assert attempts == [f"{name}-{n}" for name in ("Kills", "Suffers") for n in (1, 2, 3)]


STOPPING = """
import os, signal
from pathlib import Path
import numpy as np
from ddpc_cosim import Controller

class Meets(Controller):
    def start(self, loop):
        pass
    def step(self, sample):
        if sample.k == 3:
            self.meet()
        return np.ones(1)

class Stops(Meets):
    def meet(self):
        os.kill(os.getppid(), signal.SIGSTOP)
        Path("FOLDER/stopped").write_bytes(b"")  # the other one is there
        Path("FOLDER/printed").read_bytes()

class Prints(Meets):
    def meet(self):
        Path("FOLDER/stopped").read_bytes()
        for _ in range(1000):
            print(999 * "x")
        Path("FOLDER/printed").write_bytes(b"")
"""


def test_what_stops_the_process_that_reads_what_is_printed_holds_no_other_up(
    write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    """Nor itself, which waits for that other one."""
    (tmp_path / "met").mkdir()
    for name in ("stopped", "printed"):
        os.mkfifo(tmp_path / "met" / name)
    (tmp_path / "stopping.py").write_text(STOPPING.replace("FOLDER", str(tmp_path / "met")), encoding="utf-8")
    write_study("stopping:Stops", "stopping:Prints")
    run_program("run", "study.toml", "--jobs", "2", "--no-report", "--out", "out")
    outcomes = [case.outcome for case in load_results(tmp_path / "out").cases]
    assert outcomes == ["completed", "completed"]


REMEMBERING = """
from dataclasses import dataclass
import numpy as np
from ddpc_cosim import Controller, Plant, Variable

runs = []

class Integrator(Plant):
    inputs, outputs = (Variable("u"),), (Variable("y"),)
    def reset(self, parameters=None, t0=0.0):
        self.y = np.zeros(1)
        return self.y
    def step(self, u, h):
        self.y = self.y + h * u
        return self.y

@dataclass(kw_only=True)
class Remembers(Controller):
    def start(self, loop):
        runs.append(loop)
    def step(self, sample):
        return np.array([len(runs)])
"""


def test_no_case_finds_what_another_one_has_left(tmp_path: Path, run_program: Run) -> None:
    """Its result is the same whichever ran before it, and how many at a time."""
    (tmp_path / "remembering.py").write_text(REMEMBERING, encoding="utf-8")
    text = study_text(
        seeds=[0, 1],
        plant={"name": "remembering:Integrator"},
        reference={"y": 1.0},
        controllers=["remembering:Remembers"],
        loop={"duration": 0.3},
    )
    write(tmp_path, text)
    run_program("run", "study.toml", "--jobs", "1", "--no-report", "--out", "out")
    first, second = load_results(tmp_path / "out").cases
    assert (first.outcome, second.outcome) == ("completed", "completed"), second.reason
    assert first.trace().u.tolist() == second.trace().u.tolist() == [[1.0]] * 4


LIMITED = {
    "Detaches": ("completed", ""),
    "Grows": (
        "crashed",
        "controller meddling:Grows: crashed in step at t = 0.3 s: more than 1 GB of memory, so it was ended; "
        "raise memory_limit if it needs more",
    ),
    "Multiplies": (
        "crashed",
        "controller meddling:Multiplies: crashed in step at t = 0.3 s: more than 500 processes and threads, "
        "so it was ended",
    ),
}
if sys.platform != "linux":  # what a process has is not told
    del LIMITED["Grows"], LIMITED["Multiplies"]


def test_a_worker_that_takes_too_much_is_ended_with_all_that_it_has_started(
    write_study: WriteStudy, tmp_path: Path, run_program: Run
) -> None:
    """Daemons included."""
    (tmp_path / "meddling.py").write_text(MEDDLING, encoding="utf-8")
    write_study(*(f"meddling:{name}" for name in LIMITED), "mfapc", loop={"memory_limit": 1.0})
    mark = str(tmp_path / "marked")
    done = run_program("run", "study.toml", "--jobs", "1", "--no-report", "--out", "out", MARK=mark)
    cases = load_results(tmp_path / "out").cases
    endings = [(case.outcome, case.reason) for case in cases]
    assert endings == [*LIMITED.values(), ("completed", "")], done.stderr
    assert not [path for path in Path("/proc").glob("[0-9]*/environ") if mark in environment(path)]


def environment(path: Path) -> str:
    """Return the environment that a process was started with, where it may be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


@pytest.mark.parametrize(
    "content",
    [
        b'{"error": "__setattr__", "arguments": ["ConfigError", 1]}',
        b'{"error": "StrEnum", "arguments": ["x", "y"]}',
        b'{"error": "FMUStepError", "arguments": ["x", "error", []]}',
        b'{"error": "FMUStepError", "arguments": []}',
        b'{"result": {"shape": [4]}}\n' + bytes(24),
        b'{"result": {"shape": ["x"]}}\n' + bytes(24),
        b'{"result": ' + 100_000 * b"[",
        b'{"result": "' + (1 << 23) * b"x" + b'"}',
        b"\x80\x04.",
    ],
    ids=lambda content: content[:40].decode("latin-1"),
)
def test_what_is_not_a_reply_is_refused(content: bytes) -> None:
    """Nothing of this process is called by a name from there, nor made in a size from there."""
    from ddpc_cosim import errors

    before = dict(vars(errors))
    with pytest.raises(ValueError, match="cannot be read"):
        result_of(content)
    assert vars(errors) == before


def test_errors_are_of_this_family_and_of_texts() -> None:
    with pytest.raises(CosimError, match=r"^\[1, 2\]$"):
        result_of(b'{"error": "ControllerError", "arguments": [[1, 2]]}')


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/etc/passwd"), Path.mkdir])
def test_a_file_of_values_that_is_none(make: Callable[[Path], None], tmp_path: Path) -> None:
    """It is neither waited for nor followed elsewhere."""
    store = RowStore(1, 1, 0, 1, tmp_path / "rows", follow=True)
    make(info_path(tmp_path / "rows"))
    assert "info" not in store.written()
