"""The progress display on a terminal, and a stdout that is closed or full."""

import os
import pty
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from fmus.builder import Fault

from .cli.test_progress import LOUD

WriteStudy = Callable[..., Path]


def run_on_a_terminal(arguments: list[str], folder: Path) -> tuple[int, str]:
    """Return exit code and everything that was drawn on a terminal."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "120"}
    process = subprocess.Popen(
        arguments, cwd=folder, env=environment, stdout=theirs, stderr=theirs, stdin=theirs
    )
    os.close(theirs)
    drawn = b""
    while True:
        try:
            piece = os.read(ours, 65536)
        except OSError:  # how Linux says that the other side has been closed
            break
        if not piece:
            break
        drawn += piece
    os.close(ours)
    return process.wait(timeout=60), drawn.decode("utf-8")


def test_progress_is_drawn_in_place_and_the_table_stays(
    program: str, write_study: WriteStudy, tmp_path: Path
) -> None:
    write_study("mfapc", seeds="[0, 1, 2]", loop={"duration": 100.0})
    exit_code, drawn = run_on_a_terminal(
        [program, "run", "study.toml", "--jobs", "1", "--no-report"], tmp_path
    )
    assert exit_code == 0, drawn
    assert "\x1b[" in drawn
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", drawn)
    assert "6/6 cases" in text  # three of the controller, three of doing nothing
    assert "s simulated" in text
    assert "cases to run" not in text
    assert "study (3 seeds)" in text
    table = text[text.index("study (3 seeds)") :]
    assert "mean absolute error of y [1]: medians" in table
    # How far away depends on the processor: three loops that fail amplify rounding.
    assert re.search(
        r"and 2 more: completed, failed: y ends \d+ % of its task away", table.splitlines()[-1]
    ), table


def test_a_case_that_failed_stays_in_sight(program: str, write_study: WriteStudy, tmp_path: Path) -> None:
    write_study("mfapc", fault=Fault.RETURN_ERROR)
    exit_code, drawn = run_on_a_terminal(
        [program, "run", "study.toml", "--jobs", "1", "--no-report"], tmp_path
    )
    assert exit_code == 1
    assert "mfapc_seed0: fmu-error: return_error.fmu: fmi2DoStep returned error" in drawn


def test_a_closed_stdout_costs_nothing_and_stays_closed(program: str, tmp_path: Path) -> None:
    (tmp_path / "loud.py").write_text(LOUD, encoding="utf-8")
    close = 'exec "$0" simulate loud:Tank --stop 1 --out out.csv >&-'
    done = subprocess.run(["sh", "-c", close, program], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    assert len((tmp_path / "out.csv").read_text(encoding="utf-8").splitlines()) == 502


def test_a_stdout_that_is_full_is_told_in_one_line(program: str) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([program, "list", "studies"], stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "error: stdout cannot be written: No space left on device"
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("streams", [["stdout"], ["stdout", "stderr"]], ids=["|", "2>&1 |"])
def test_what_nobody_reads_any_more_does_not_end_a_run(
    streams: list[str], program: str, write_study: WriteStudy, tmp_path: Path
) -> None:
    """As with `run | head -1`: the report is written all the same."""
    write_study("mfapc")
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [program, "run", "study.toml", "--jobs", "1", "--out", "out"],
        cwd=tmp_path,
        timeout=120,
        text=True,
        **({"stderr": subprocess.PIPE} | dict.fromkeys(streams, writer)),
    )
    os.close(writer)
    assert done.returncode == 0, done.stderr
    assert "</html>" in (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert "Error" not in (done.stderr or "")
