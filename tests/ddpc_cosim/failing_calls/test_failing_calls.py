"""Every system call of the process that runs a study fails once: it says so or carries on; nothing is lost.

As SQLite is tested: a library that is loaded before C's counts the calls that concern the folders of results
and of temporary files, and lets the n-th of them fail. Workers have no such library.
"""

import errno
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from studies import study_text, write

from fmu_plants.export.compiler import compile_library, find_compiler

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("failing calls")]
HERE = Path(__file__).parent
PLANT = """
import numpy as np
from ddpc_cosim import Plant, Variable

class Lag(Plant):
    inputs, outputs = (Variable("u"),), (Variable("y"),)
    def reset(self, parameters=None, t0=0.0):
        self.y = np.zeros(1)
        return self.y.copy()
    def step(self, u, h):
        self.y = self.y + h * (u - 2.0 * self.y)
        return self.y.copy()
"""
STUDY = study_text(
    plant={"name": "lag_that_is_run_often:Lag"},
    reference={"y": 1.0},
    controllers={"mfac": "mfac", "mfapc": "mfapc", "ipid": {"type": "ipid", "settings": {"alpha": 2.0}}},
)
OTHERS = ("EIO", "EMFILE", "EINTR", "ENOMEM")
"""Errors apart from ENOSPC, with which every call fails in turn."""
Answer = dict[str, Any]


class Command:
    """The command in a process of its own, which runs it as often as it is asked to."""

    def __init__(self, place: Path, *options: str) -> None:
        self._work = place / "work"
        (self._work / "scratch").mkdir(parents=True)
        source = {"failing_calls.c": (HERE / "failing_calls.c").read_text(encoding="utf-8")}
        library = place / "failing_calls.so"
        visible = ["-fvisibility=default"]
        library.write_bytes(compile_library(find_compiler(), source, ["failing_calls_begin"], visible))
        (place / "lag_that_is_run_often.py").write_text(PLANT)
        write(place, STUDY)
        environment = {"LD_PRELOAD": str(library), "TMPDIR": str(self._work / "scratch")}
        self._process = subprocess.Popen(
            [sys.executable, str(HERE / "run_with_failing_calls.py"), str(self._work), *options],
            cwd=place,
            env={**os.environ, **environment},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.run(0, "ENOSPC")  # what is done once in a process is done
        self.undisturbed = self.run(0, "ENOSPC")

    def run(self, number: int, error: str) -> Answer:
        """Run the command with one call failing, and then once more."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([number, getattr(errno, error)]) + "\n")
        self._process.stdin.flush()
        answer: Answer = json.loads(self._process.stdout.readline())
        return answer

    def end(self) -> None:
        self._process.communicate(timeout=60)


@pytest.fixture(scope="module")
def command(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Command]:
    command = Command(tmp_path_factory.mktemp("failing_calls"), "--no-report", "--jobs", "1")
    yield command
    command.end()


def faults(command: Command, number: int, error: str) -> list[str]:
    """Return what is wrong with how the command takes it that a call fails."""
    answer, undisturbed = command.run(number, error), command.undisturbed
    wrong = []
    if answer["code"] not in (0, 1, 2) or "Traceback" in answer["said"]:
        wrong.append(f"it ends with {answer['code']}: {answer['said']}")
    if answer["code"] and not {"error:", "crashed:", "damaged"} & {*answer["said"].split()}:
        wrong.append(f"it does not say what is wrong: {answer['said']}")
    if answer["again"]:
        wrong.append(f"the same command ends with {answer['again']}: {answer['told']}")
    if answer["content"] != undisturbed["content"]:
        names = {name for name, _ in answer["content"].items() ^ undisturbed["content"].items()}
        wrong.append(f"the same command leaves another folder: {sorted(names)}")
    if answer["left"]:
        wrong.append(f"temporary files are left: {answer['left']}")
    return [f"{answer['failed']}: {error}: {fault}" for fault in wrong]


def test_calls_are_counted_and_the_undisturbed_folder_is_complete(command: Command) -> None:
    answer = command.undisturbed
    assert (answer["code"], answer["again"], answer["failed"], answer["left"]) == (0, 0, "", [])
    assert answer["calls"] > 100
    assert len([name for name in answer["content"] if name.endswith("signals.csv")]) == 4


@pytest.mark.parametrize("error", ["EAGAIN", "ENOMEM"])
def test_a_process_cannot_be_forked(command: Command, error: str) -> None:
    assert faults(command, -1, error) == []
    assert "a worker process cannot be started: " in command.run(-1, error)["said"]


@pytest.mark.parametrize("part", range(8))
def test_any_call_may_fail(command: Command, part: int) -> None:
    """The parts are every eighth call, from another one on."""
    numbers = range(part + 1, command.undisturbed["calls"] + 1, 8)
    assert [fault for number in numbers for fault in faults(command, number, "ENOSPC")] == []


@pytest.mark.parametrize("error", OTHERS)
def test_a_call_may_fail_in_any_way(command: Command, error: str) -> None:
    """A fixed sample of them: one in nine."""
    numbers = range(3, command.undisturbed["calls"] + 1, 9)
    assert [fault for number in numbers for fault in faults(command, number, error)] == []
