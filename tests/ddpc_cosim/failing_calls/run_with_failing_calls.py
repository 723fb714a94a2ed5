"""Run a study's command again and again in this process, each time with one of its system calls failing.

Asked for on stdin, a line each: the number of the call, and the error. Answered on stdout: what has failed,
how the command ended, what it said, and what the same command makes of the folder afterwards.
"""

import contextlib
import csv
import ctypes
import hashlib
import io
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from ddpc_cosim.cli.main import main
from ddpc_cosim.processes.fork_server import ForkServer
from ddpc_cosim.processes.scratch import remove_left_behind
from ddpc_cosim.study.case_files import read_run

calls = ctypes.CDLL(None)
calls.failing_calls_failed.restype = ctypes.c_char_p
calls.failing_calls_end.restype = ctypes.c_long
calls.failing_calls_begin.argtypes = (ctypes.c_char_p, ctypes.c_long, ctypes.c_int)


def run(*arguments: str) -> tuple[int, str]:
    """Run a command; return its exit code and what it has said."""
    said = io.StringIO()
    sys.argv = ["ddpc-cosim", *arguments]
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            main()
            code = 0
        except SystemExit as ending:
            code = int(ending.code or 0)
    return code, said.getvalue()


def content(folder: Path) -> dict[str, str]:
    """Return the files of a folder, of each a hash of what it says, bar how long things took."""
    by_file = {str(path.relative_to(folder)): "" for path in sorted(folder.rglob("*"))}
    for signals in folder.glob("cases/*/signals.csv"):
        rows = [*csv.reader(signals.read_text().splitlines())]
        timing = rows[0].index("solve_time [s]")
        facts = read_run(signals.parent)
        for key in ("wall_time", "signals"):
            del facts[key]
        facts["metrics"] = {key: value for key, value in facts["metrics"].items() if "solve_time" not in key}
        said = repr([[row[:timing] + row[timing + 1 :] for row in rows], facts])
        by_file[str(signals.relative_to(folder))] = hashlib.sha256(said.encode()).hexdigest()
    rows = [*csv.reader((folder / "metrics.csv").read_text().splitlines())]
    kept = [number for number, name in enumerate(rows[0]) if "solve_time" not in name]
    by_file["metrics.csv"] = repr([[row[number] for number in kept] for row in rows])
    return by_file


work, *options = sys.argv[1:]
scratch, out = Path(work, "scratch"), Path(work, "out")
command = ("run", "study.toml", "--out", str(out), *options)
del os.environ["LD_PRELOAD"]  # workers have their own
subprocess._USE_VFORK = False
for line in sys.stdin:
    number, error = json.loads(line)
    if number < 0:  # what workers are forked from is started anew
        ForkServer.running()._stop()
    shutil.rmtree(out, ignore_errors=True)
    calls.failing_calls_begin(work.encode(), number, error)
    try:
        code, said = run(*command)
    except Exception as fault:
        code, said = -1, f"Traceback: {type(fault).__name__}: {fault}"
    counted, failed = calls.failing_calls_end(), calls.failing_calls_failed().decode()
    again, said_again = run(*command)
    remove_left_behind(scratch)  # as the next process that makes a temporary folder does
    left = sorted(path.name for path in scratch.iterdir())
    answer = {"calls": counted, "failed": failed, "code": code, "said": said, "left": left}
    sys.__stdout__.write(
        json.dumps(answer | {"again": again, "told": said_again, "content": content(out)}) + "\n"
    )
    sys.__stdout__.flush()
