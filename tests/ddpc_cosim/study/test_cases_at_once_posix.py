"""A case that several runs read and write at once: only POSIX can lock its folder."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from studies import run_file

from ddpc_cosim.metrics import MetricSettings
from ddpc_cosim.study.case_files import load_case, recompute_metrics

WRITES_FOR_EVER = """
import sys
from dataclasses import replace
from itertools import count
from pathlib import Path

from ddpc_cosim.study.case_files import read_run, read_trace, write_case

case = Path(sys.argv[1])
trace, run = read_trace(case), read_run(case)
head = {key: run[key] for key in ("id", "controller", "label", "scenario", "seed", "storage")}
for n in count():
    write_case(case, replace(trace, solve_time=trace.solve_time + n), head)
    if n == 1:
        print("begun", flush=True)
"""


def test_a_case_is_read_whole_while_another_run_writes_it_again(write_study: Callable[..., Path]) -> None:
    """Between two moves there is no case, and the samples of one do not belong to the figures of another."""
    case = run_file(write_study("mfapc")).cases[0].folder
    rows = len(load_case(case).trace())
    command = [sys.executable, "-c", WRITES_FOR_EVER, str(case)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as writer:
        try:
            assert writer.stdout
            assert writer.stdout.readline() == b"begun\n"
            for preview in range(1, 301):
                assert len(load_case(case).trace()) == rows
                recompute_metrics(case, MetricSettings(preview))
            assert writer.poll() is None
        finally:
            writer.kill()
