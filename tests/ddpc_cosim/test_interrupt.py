"""An interrupt keeps what is done, leaves nothing half done, and the same command goes on from there."""

import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from ddpc_cosim.processes.requests import Terminated, orderly_end
from ddpc_cosim.processes.scratch import remove_left_behind

from .fmu_faults.processes import Watch, descendants, heed_interrupts

Run = Callable[..., subprocess.CompletedProcess[str]]
WriteStudy = Callable[..., Path]

BLOCKED = """
import os, sys, threading
from dataclasses import dataclass
import numpy as np
from ddpc_cosim import Controller

@dataclass(kw_only=True)
class Blocked(Controller):
    def start(self, loop):
        pass
    def step(self, sample):
        if sample.k == 3 and "BLOCK" in os.environ:
            open(os.environ["BLOCK"], "w").close()
            threading.Event().wait()
        return np.ones(1)
"""


SPAWNING = """
from ddpc_cosim.processes import spawning
spawning.forks = lambda: False
from ddpc_cosim.cli.program import main
main()
"""


def start_and_wait(folder: Path, command: list[str], environment: dict[str, str]) -> "subprocess.Popen[str]":
    """Start a command in a session of its own and wait until a controller blocks it."""
    os.mkfifo(folder / "fifo")
    descriptor = os.open(folder / "fifo", os.O_RDONLY | os.O_NONBLOCK)
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    process = subprocess.Popen(
        command,
        cwd=folder,
        env={**os.environ, "BLOCK": str(folder / "fifo"), **environment},
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        encoding="utf-8",
        start_new_session=True,
        preexec_fn=heed_interrupts,
    )
    assert poll.poll(60_000), "the controller has not blocked"
    os.close(descriptor)
    return process


@pytest.mark.parametrize(
    ("request_to_end", "to_the_group", "exit_code", "ending", "spawns"),
    [
        (signal.SIGINT, True, 130, "interrupted", False),
        (signal.SIGINT, False, 130, "interrupted", False),
        (signal.SIGTERM, True, 143, "terminated", False),
        (signal.SIGTERM, False, 143, "terminated", False),
        (signal.SIGKILL, False, -9, None, False),
        (signal.SIGINT, True, 130, "interrupted", True),
        (signal.SIGKILL, False, -9, None, True),
    ],
    ids=["Ctrl-C", "kill -INT", "service manager", "kill", "kill -9", "Ctrl-C, spawned", "kill -9, spawned"],
)
def test_an_interrupted_run_goes_on(
    request_to_end: signal.Signals,
    to_the_group: bool,
    exit_code: int,
    ending: str | None,
    spawns: bool,
    write_study: WriteStudy,
    tmp_path: Path,
    program: str,
    run_program: Run,
) -> None:
    """A terminal sends the signal to all processes of the run, ``kill`` to the first one only."""
    (tmp_path / "blocked.py").write_text(BLOCKED, encoding="utf-8")
    (tmp_path / "scratch").mkdir()
    write_study("mfapc", "blocked:Blocked", seeds="[0, 1]")
    arguments = ["run", "study.toml", "--jobs", "1", "--no-report", "--out", "out"]
    paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {"PYTHONPATH": os.pathsep.join(paths), "TMPDIR": str(tmp_path / "scratch")}
    command = [sys.executable, "-c", SPAWNING] if spawns else [program]
    process = start_and_wait(tmp_path, [*command, *arguments], environment)
    family = Watch(descendants(process.pid))
    (os.killpg if to_the_group else os.kill)(process.pid, request_to_end)
    # The pipe ends when the last process that holds it has ended: no worker is left behind.
    rest = process.communicate(timeout=60)[1]
    assert process.returncode == exit_code, rest
    if ending:
        assert f"{ending}: finished cases are kept; the same command goes on from there" in rest
    assert "Traceback" not in rest
    assert family.wait(60.0) == []
    if not ending:  # as the next run does
        remove_left_behind(tmp_path / "scratch")
        remove_left_behind(tmp_path / "out/cases", ".staging-")
    assert list((tmp_path / "scratch").iterdir()) == []

    kept = {path.name: (path / "run.json").stat().st_mtime_ns for path in (tmp_path / "out/cases").iterdir()}
    assert sorted(name.rpartition("_")[0] for name in kept) == ["mfapc_seed0", "mfapc_seed1"]

    done = run_program(*arguments)
    assert done.returncode == 0, done.stderr
    assert "4 cases to run, 2 kept" in done.stderr
    after = {path.name: (path / "run.json").stat().st_mtime_ns for path in (tmp_path / "out/cases").iterdir()}
    assert len(after) == 6
    assert kept.items() <= after.items()


HALF_WAY = """
import os, threading
from pathlib import Path
from ddpc_controllers import MFAPC

class HalfWay(MFAPC):
    def start(self, loop):
        super().start(loop)
        if pipe := os.environ.get("BLOCK"):
            if len([*Path(pipe).parent.glob("killed/cases/*/run.json")]) == 7:
                open(pipe, "w").close()
                threading.Event().wait()
"""


def test_a_tuning_that_is_killed_ends_as_one_that_is_not(
    write_study: WriteStudy, tmp_path: Path, program: str, run_program: Run
) -> None:
    (tmp_path / "half_way.py").write_text(HALF_WAY, encoding="utf-8")
    write_study("half_way:HalfWay")
    arguments = ["tune", "study.toml", "--trials", "6", "--seeds", "7,8", "--jobs", "1", "--no-report"]
    process = start_and_wait(tmp_path, [program, *arguments, "--out", "killed"], {})
    process.kill()
    process.communicate(timeout=60)
    assert not (tmp_path / "killed/trials.csv").exists()
    for out in ("killed", "whole"):
        done = run_program(*arguments, "--out", out)
        assert done.returncode == 0, done.stderr
    files = [
        {name: (tmp_path / out / name).read_bytes() for name in ("trials.csv", "tuned.toml")}
        | {"cases": sorted(case.name for case in tmp_path.glob(f"{out}/cases/*_*"))}
        for out in ("killed", "whole")
    ]
    assert files[0] == files[1]


STARTING = """
import os, sys, threading
from ddpc_controllers import MFAPC

if "ddpc_cosim.cli.main" not in sys.modules:  # in a worker
    open(os.environ["BLOCK"], "w").close()
    threading.Event().wait()

class Starting(MFAPC):
    pass
"""


def test_an_interrupt_while_workers_start(write_study: WriteStudy, tmp_path: Path, program: str) -> None:
    """All processes of the run get it, as from a terminal; none of them prints a traceback."""
    (tmp_path / "starting.py").write_text(STARTING, encoding="utf-8")
    write_study("starting:Starting")
    command = [program, "run", "study.toml", "--jobs", "1", "--no-report"]
    process = start_and_wait(tmp_path, command, {"PYTHONPATH": str(tmp_path)})
    family = Watch(descendants(process.pid))
    os.killpg(process.pid, signal.SIGINT)
    rest = process.communicate(timeout=60)[1]
    assert process.returncode == 130, rest
    assert "interrupted: finished cases are kept" in rest
    assert "Traceback" not in rest
    assert family.wait(60.0) == []


SLOW_PLANT = """
import os
import signal

import numpy as np
from ddpc_cosim import Plant, Variable

class Slow(Plant):
    inputs, outputs = (), (Variable("y"),)
    def reset(self, parameters=None, t0=0.0):
        self.k = 0
        return np.zeros(1)
    def step(self, u, h):
        self.k += 1
        if self.k == 5:
            os.write(os.open(os.environ["READY"], os.O_WRONLY), b"x")
            signal.pause()
        return np.full(1, float(self.k))
"""


def test_simulate_keeps_what_was_simulated(tmp_path: Path, program: str) -> None:
    (tmp_path / "slow.py").write_text(SLOW_PLANT, encoding="utf-8")
    pipe = tmp_path / "ready"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    process = subprocess.Popen(
        [program, "simulate", "slow:Slow", "--stop", "1", "--step", "0.1", "--out", "part.csv"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path), "READY": str(pipe)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    os.set_blocking(reader, True)
    assert select.select([reader], [], [], 60.0)[0], "it has not begun"
    os.close(reader)
    process.send_signal(signal.SIGINT)
    _, output = process.communicate(timeout=60)
    assert process.returncode == 130, output
    assert "slow:Slow: interrupted: 5 of 11 samples, to t = 0.4 s" in output
    assert "Traceback" not in output
    lines = (tmp_path / "part.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "time [s],y [1],outcome"
    assert lines[-1] == "0.4,4.0,interrupted"


@pytest.fixture
def interruptible() -> Iterator[None]:
    """Handle Ctrl-C as in the foreground of a shell: a background job ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_second_request_ends_the_process_at_once(number: signal.Signals) -> None:
    requests = (signal.SIGINT, signal.SIGTERM)
    before = [signal.getsignal(request) for request in requests]
    with orderly_end():
        with pytest.raises(KeyboardInterrupt) as caught:
            signal.raise_signal(number)
        assert isinstance(caught.value, Terminated) == (number == signal.SIGTERM)
        assert [signal.getsignal(request) for request in requests] == [signal.SIG_DFL] * 2
    assert [signal.getsignal(request) for request in requests] == before


def test_what_a_background_job_ignores_stays_ignored() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with orderly_end():
            signal.raise_signal(signal.SIGINT)
            with pytest.raises(Terminated):
                signal.raise_signal(signal.SIGTERM)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
