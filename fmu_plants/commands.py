"""Other programs, run for what they print: nothing of one that is late, or interrupted, goes on."""

import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path


def captured(
    command: Sequence[str], seconds: float, *, cwd: Path | None = None, env: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command for its output, which may be in any encoding; what it starts does not outlive it.

    Parameters
    ----------
    command : sequence of str
        The program and its arguments.
    seconds : float
        How long it may take [s].
    cwd : Path, optional
        The folder in which it runs.
    env : mapping of str to str, optional
        All of its environment; default: that of this process.

    Raises
    ------
    OSError
        It cannot be run.
    subprocess.TimeoutExpired
        It did not end in time, and was ended with all that it had started.
    """
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command,
        cwd=cwd,
        env=env,
        stdin=subprocess.DEVNULL,
        stdout=pipe,
        stderr=pipe,
        text=True,
        encoding="utf-8",
        errors="replace",
        start_new_session=True,
    ) as process:
        try:
            output = process.communicate(timeout=seconds)
        finally:
            if process.returncode is None:  # late, or interrupted
                _end(process)
    return subprocess.CompletedProcess(command, process.returncode, *output)


def _end(process: "subprocess.Popen[str]") -> None:
    """End a process and all that it has started."""
    if sys.platform == "win32":
        process.kill()
    else:
        os.killpg(process.pid, signal.SIGKILL)
