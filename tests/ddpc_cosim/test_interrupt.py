"""An interrupt keeps what is done, leaves nothing half done, and the same command goes on from there."""

import os
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from ddpc_cosim.cli.main import Terminated, orderly_end

from .fmu_faults.processes import Watch, descendants

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
            print("blocked", file=sys.stderr, flush=True)
            threading.Event().wait()
        return np.ones(1)
"""


@pytest.mark.parametrize(
    ("request_to_end", "to_the_group", "exit_code", "told"),
    [
        (signal.SIGINT, True, 130, "interrupted"),
        (signal.SIGINT, False, 130, "interrupted"),
        (signal.SIGTERM, True, 143, "terminated"),
        (signal.SIGTERM, False, 143, "terminated"),
        (signal.SIGKILL, False, -9, None),
    ],
    ids=["Ctrl-C", "kill -INT", "service manager", "kill", "kill -9"],
)
def test_an_interrupted_run_goes_on(
    request_to_end: signal.Signals,
    to_the_group: bool,
    exit_code: int,
    told: str | None,
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
    environment = {**os.environ, "BLOCK": "1", "PYTHONPATH": os.pathsep.join(paths)}
    environment["TMPDIR"] = str(tmp_path / "scratch")
    process = subprocess.Popen(
        [program, *arguments],
        cwd=tmp_path,
        env=environment,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        encoding="utf-8",
        start_new_session=True,
    )
    assert process.stderr is not None
    said = []
    for line in process.stderr:
        said.append(line)
        if line == "blocked\n":
            break
    family = Watch(descendants(process.pid))
    (os.killpg if to_the_group else os.kill)(process.pid, request_to_end)
    # The pipe ends when the last process that holds it has ended: no worker is left behind.
    rest = process.communicate(timeout=60)[1]
    assert process.returncode == exit_code, said
    if told:
        assert f"{told}: finished cases are kept; the same command goes on from there" in rest
    assert "Traceback" not in rest
    assert family.wait(60.0) == []
    assert list((tmp_path / "scratch").iterdir()) == []

    kept = {path.name: (path / "run.json").stat().st_mtime_ns for path in (tmp_path / "out/cases").iterdir()}
    assert sorted(name.rpartition("_")[0] for name in kept) == ["mfapc_seed0", "mfapc_seed1"]

    done = run_program(*arguments)
    assert done.returncode == 0, done.stderr
    assert "2 cases to run, 2 there already" in done.stderr
    after = {path.name: (path / "run.json").stat().st_mtime_ns for path in (tmp_path / "out/cases").iterdir()}
    assert len(after) == 4
    assert kept.items() <= after.items()


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
