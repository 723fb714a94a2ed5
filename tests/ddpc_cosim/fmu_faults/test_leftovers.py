"""Nothing outlives a run: no process and no temporary file, however the master ends."""

import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fmus.builder import Fault
from studies import study_text, write

from ddpc_cosim.processes.scratch import remove_left_behind

from .processes import Watch, descendants, heed_interrupts

PIPE = "pipe"
LONG = 60.0
"""The limit of what would otherwise hang, longer than anything takes [s]."""

SCRIPT = """
import sys
import numpy as np
from ddpc_cosim import FMUPlant

path, mode, fault = sys.argv[1:]
plant = FMUPlant(path, isolated=mode == "isolated")
plant.reset({"fault": int(fault), "fault_time": 0.1})
while True:
    plant.step(np.ones(1), 0.1)
    print("stepped", flush=True)
    sys.stdin.readline()
"""

Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def pipe(tmp_path: Path) -> Iterator[select.poll]:
    """What becomes ready when an FMU is about to hang."""
    os.mkfifo(tmp_path / PIPE)
    descriptor = os.open(tmp_path / PIPE, os.O_RDONLY | os.O_NONBLOCK)
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    yield poll
    os.close(descriptor)


@pytest.fixture
def start(tmp_path: Path, scratch: Path, pipe: select.poll) -> Start:
    """Start a command in a session of its own."""

    def start_command(*command: str) -> "subprocess.Popen[str]":
        return subprocess.Popen(
            command,
            cwd=tmp_path,
            env={**os.environ, "FAULT_PIPE": str(tmp_path / PIPE)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            start_new_session=True,
            preexec_fn=heed_interrupts,
        )

    return start_command


def run_script(start: Start, fmu: Path, mode: str, fault: Fault) -> "subprocess.Popen[str]":
    """Start the script and wait for its first step; the second one has the fault."""
    process = start(sys.executable, "-c", SCRIPT, str(fmu), mode, str(int(fault)))
    assert process.stdout is not None
    assert process.stdout.readline() == "stepped\n"
    return process


def go_on(process: "subprocess.Popen[str]") -> None:
    assert process.stdin is not None
    process.stdin.write("\n")
    process.stdin.flush()


def wait_until_it_hangs(pipe: select.poll) -> None:
    """Wait for the other end of the pipe to be opened and closed."""
    assert pipe.poll(LONG * 1e3), "the FMU has not reached its fault"


def check_nothing_is_left(process: "subprocess.Popen[str]", family: Watch, scratch: Path) -> str:
    """Wait for the end of a process and of all that it has started; return what it wrote on stderr."""
    errors = process.communicate(timeout=LONG)[1]
    assert family.wait(LONG) == []
    remove_left_behind(scratch)  # as the next run does
    assert list(scratch.iterdir()) == []
    return errors


class TestAScriptThatIsKilled:
    @pytest.mark.parametrize("mode", ["in-process", "isolated"])
    def test_between_steps(
        self, mode: str, start: Start, faulty_fmus: dict[int, Path], scratch: Path
    ) -> None:
        process = run_script(start, faulty_fmus[2], mode, Fault.NO_FAULT)
        assert len(list(scratch.iterdir())) == 1
        family = Watch(descendants(process.pid))
        process.kill()
        check_nothing_is_left(process, family, scratch)

    @pytest.mark.parametrize("mode", ["in-process", "isolated"])
    def test_in_a_step_that_hangs(
        self, mode: str, start: Start, faulty_fmus: dict[int, Path], scratch: Path, pipe: select.poll
    ) -> None:
        process = run_script(start, faulty_fmus[2], mode, Fault.HANG_IN_STEP)
        go_on(process)
        wait_until_it_hangs(pipe)
        family = Watch(descendants(process.pid))
        process.kill()
        check_nothing_is_left(process, family, scratch)

    def test_by_the_fmu(self, start: Start, faulty_fmus: dict[int, Path], scratch: Path) -> None:
        """In this process a crash is the process's; its files go nevertheless."""
        process = run_script(start, faulty_fmus[2], "in-process", Fault.SEGMENTATION_FAULT)
        family = Watch(descendants(process.pid))
        go_on(process)
        check_nothing_is_left(process, family, scratch)
        assert process.returncode == -signal.SIGSEGV


class TestCtrlC:
    def test_in_a_step_that_hangs(
        self, start: Start, faulty_fmus: dict[int, Path], scratch: Path, pipe: select.poll
    ) -> None:
        """The call is interrupted; the only traceback is the script's own."""
        process = run_script(start, faulty_fmus[2], "isolated", Fault.HANG_IN_STEP)
        go_on(process)
        wait_until_it_hangs(pipe)
        family = Watch(descendants(process.pid))
        os.killpg(process.pid, signal.SIGINT)
        errors = check_nothing_is_left(process, family, scratch)
        assert errors.count("Traceback") == 1
        assert errors.endswith("KeyboardInterrupt\n")


class TestAStudy:
    @pytest.fixture
    def run(self, start: Start, faulty_fmus: dict[int, Path], tmp_path: Path) -> "subprocess.Popen[str]":
        """``ddpc-cosim run`` of an isolated FMU that hangs in its first step."""
        plant = {"fmu": str(faulty_fmus[2]), "parameters": {"fault": int(Fault.HANG_IN_STEP)}}
        write(tmp_path, study_text(plant=plant | {"isolated": "auto"}, reference={"y": 1.0}))
        program = Path(sys.executable).with_name("ddpc-cosim")
        return start(str(program), "run", "study.toml", "--jobs", "1", "--no-report", "--out", "out")

    @pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
    def test_that_is_ended(
        self, how: signal.Signals, run: "subprocess.Popen[str]", pipe: select.poll, scratch: Path
    ) -> None:
        wait_until_it_hangs(pipe)
        family = Watch(descendants(run.pid))
        run.send_signal(how)
        errors = check_nothing_is_left(run, family, scratch)
        assert "Traceback" not in errors


@pytest.mark.parametrize("request_to_end", [signal.SIGKILL, signal.SIGTERM])
def test_a_folder_that_is_not_to_outlive_its_process(
    start: Start, request_to_end: int, scratch: Path
) -> None:
    process = start(
        sys.executable,
        "-c",
        "from ddpc_cosim.processes.scratch import ScratchFolder; folder = ScratchFolder();"
        "folder.remove_after_death();"
        "(folder.path / 'file').touch(); print(folder.path, flush=True); input()",
    )
    assert process.stdout is not None
    folder = Path(process.stdout.readline().strip())
    assert (folder / "file").exists()
    process.send_signal(request_to_end)
    process.communicate()  # to the end of whatever holds its output
    assert not folder.exists()


def test_what_a_link_leads_to_is_not_left_behind(tmp_path: Path) -> None:
    """Anyone may put one among temporary files."""
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / ".lock").touch()
    (tmp_path / "ddpc-cosim-x").symlink_to(precious)
    remove_left_behind(tmp_path)
    assert (precious / ".lock").exists()
