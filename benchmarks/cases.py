"""What a case of a study costs besides its loop, and what a second worker is good for (Linux)."""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import monotonic, process_time

import numpy as np

from benchmarks.isolation import held
from ddpc_cosim.processes.fork_server import ForkServer
from ddpc_cosim.processes.worker import LONGEST_REPLY, Worker, ask, result_of, serve_calls
from ddpc_cosim.study.case_runs import run_case
from ddpc_cosim.study.cases import Case, cases_of
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.runner import run_cases

TURNS = 5
CASE_LIMIT = 10.0
"""What a case may take besides its loop, in forks of this process that end at once."""

WORKERS_LIMIT = 1 / 1.7
"""How long two workers may take, in times of one."""

STUDY = """
name = "cases"
seeds = ["0:20"]
plant = { name = "pendulum", outputs = ["angle"] }
loop = { sampling_time = 0.1, duration = 40.0 }
reference.angle = { kind = "steps", times = [0.0, 20.0], values = [20.0, -10.0], unit = "deg" }
bounds.torque = { min = -3.5, max = 3.5 }
recording = { samples = 200, excitation.torque = { kind = "uniform", low = -3.5, high = 3.5 } }
controllers.mfapc.type = "mfapc"
controllers.deepc.type = "deepc"
"""


def everyones_time() -> float:
    """Return the processor time of this process, of the fork server, and of its workers that ended [s]."""
    server = Path(f"/proc/{ForkServer.running()._process.pid}/stat").read_text()
    ticks = sum(map(int, server.rpartition(")")[2].split()[11:15]))
    return process_time() + ticks / os.sysconf("SC_CLK_TCK")


def run(cases: Sequence[Case], jobs: int) -> tuple[float, float]:
    """Return the processor time of running cases, and how long it takes [s]."""
    with tempfile.TemporaryDirectory() as folder:
        used, began = everyones_time(), monotonic()
        for _ in run_cases(cases, Path(folder), jobs):
            pass
        return everyones_time() - used, monotonic() - began


def loops_alone(cases: Sequence[Case]) -> float:
    """Return the processor time of the loops of cases in a process that has run them before [s]."""
    with tempfile.TemporaryDirectory() as folder:
        worker = Worker(serve_calls, folder=Path(folder))
        for _ in range(2):
            ask(worker.channel, time_of_loops, cases)
            taken = result_of(worker.channel.receive(LONGEST_REPLY))
        worker.end()
    return float(taken)


def time_of_loops(cases: Sequence[Case]) -> float:
    began = process_time()
    for case in cases:
        run_case(case)
    return process_time() - began


def forks(count: int) -> float:
    """Return the processor time of processes forked from this one that end at once [s]."""
    before = sum(os.times()[:4])
    for _ in range(count):
        child = os.fork()
        if child == 0:
            os._exit(0)
        os.waitpid(child, 0)
    return sum(os.times()[:4]) - before


def main() -> bool:
    """Print a case's cost and the times of one and two workers; return whether the bounds were held."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cases.toml"
        path.write_text(STUDY, encoding="utf-8")
        resolved = read_study(str(path)).problem
    cases = cases_of(resolved, resolved.plant.built())
    run(cases[:2], 1)  # from now on all is imported
    turns = [(*run(cases, 1), run(cases, 2)[1], loops_alone(cases), forks(len(cases))) for _ in range(TURNS)]
    used, single, two, loops, forked = np.array(turns).T
    beside = 1e3 * np.median(used - loops) / len(cases)
    print(f"a case: {1e3 * np.median(loops) / len(cases):.1f} ms its loop, {beside:.1f} ms besides")
    print(f"{len(cases)} cases: {np.median(single):.2f} s with one worker, {np.median(two):.2f} s with two")
    return all(
        [
            held("a case besides its loop / a fork", float(np.median((used - loops) / forked)), CASE_LIMIT),
            held("two workers / one worker", float(np.median(two / single)), WORKERS_LIMIT),
        ]
    )
