"""What isolation costs: a step of an FMU in a process of its own, and opening it there."""

import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter_ns

import numpy as np

from ddpc_cosim import FloatArray, FMUPlant
from fmu_plants import export_fmu
from fmu_plants.pendulum import MODEL

H = 0.01
STEPS = 1000
TURNS = 21
OPENINGS = 7
STEP_LIMIT = 3.0
"""What an isolated step may take more than one in this process, in bare round trips through pipes."""

OPENING_LIMIT = 2.0
"""What opening an isolated FMU may take, in starts of a process by multiprocessing's own fork server."""


@contextmanager
def one_core() -> Iterator[bool]:
    """Keep this process, and those that it starts, on one core where that is possible; say whether it is."""
    if sys.platform != "linux":
        yield False
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        yield True
    finally:
        os.sched_setaffinity(0, before)


def turn(plant: FMUPlant, u: FloatArray) -> float:
    """Step from rest; return the mean time of a step [us]."""
    plant.reset()
    step = plant.step
    start = perf_counter_ns()
    for _ in range(STEPS):
        step(u, H)
    return (perf_counter_ns() - start) / STEPS / 1e3


def bare_turn(request: int, answer: int) -> float:
    """Return the mean time of a round trip through two pipes to a process that only answers [us]."""
    there_read, here_write = os.pipe()
    here_read, there_write = os.pipe()
    child = os.fork()
    if child == 0:
        reply = bytes(answer)
        for _ in range(STEPS):
            os.read(there_read, request)
            os.write(there_write, reply)
        os._exit(0)
    message = bytes(request)
    start = perf_counter_ns()
    for _ in range(STEPS):
        os.write(here_write, message)
        os.read(here_read, answer)
    taken = (perf_counter_ns() - start) / STEPS / 1e3
    os.waitpid(child, 0)
    for descriptor in (there_read, here_write, here_read, there_write):
        os.close(descriptor)
    return taken


def measure(fmu: Path) -> FloatArray:
    """Let all take turns, so that a machine that slows down slows all: times of steps, shape (3, TURNS)."""
    u = np.ones(1)
    with FMUPlant(fmu) as here, FMUPlant(fmu, isolated=True) as there:
        sizes = 8 * (2 + len(here.inputs)), 8 * (2 + len(here.outputs))
        turns = [(turn(here, u), turn(there, u), bare_turn(*sizes)) for _ in range(TURNS)]
    return np.array(turns).T


OPENING = """
import multiprocessing, sys
from time import perf_counter
import ddpc_cosim.fmu.isolation
from ddpc_cosim import FMUPlant

def with_multiprocessing():
    process = context.Process(target=print)
    process.start()
    process.join()

def with_an_fmu():
    FMUPlant(sys.argv[2], isolated=True).reset()

context = multiprocessing.get_context("forkserver")
context.set_forkserver_preload(["ddpc_cosim.fmu.isolation"])
for _ in range(2):
    start = perf_counter()
    globals()[sys.argv[1]]()
    print(1e3 * (perf_counter() - start))
"""


def openings(fmu: Path) -> dict[str, FloatArray]:
    """Return the times to start a process and to open an FMU in one [ms]: the first, and one after it."""
    opened: dict[str, list[list[float]]] = {"with_multiprocessing": [], "with_an_fmu": []}
    for _ in range(OPENINGS):
        for way, times in opened.items():
            command = [sys.executable, "-c", OPENING, way, str(fmu)]
            done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
            times.append([float(line) for line in done.stdout.split()])
    return {way: np.array(times) for way, times in opened.items()}


def held(what: str, value: float, limit: float) -> bool:
    """Print a ratio beside its bound and return whether it is held."""
    print(f"{what:<66} {value:6.2f}   <= {limit:g} {'held' if value <= limit else 'MISSED'}")
    return value <= limit


def main() -> bool:
    """Print medians and ranges; return whether the bounds were held."""
    print(f"{platform.platform()}, {platform.machine()}, Python {platform.python_version()}")
    with tempfile.TemporaryDirectory() as folder:
        fmu = export_fmu(MODEL, Path(folder) / "pendulum.fmu")
        with one_core() as pinned:
            steps = measure(fmu)
        opened = openings(fmu)
    where = "on one core" if pinned else "on any core"
    for label, times in zip(("in this process", "isolated", "bare round trip"), steps, strict=True):
        print(f"step {label:<16} {np.median(times):6.2f} us  [{times.min():.2f}-{times.max():.2f}], {where}")
    with_fmu, against = opened["with_an_fmu"], opened["with_multiprocessing"]
    for when, ours, theirs in zip(
        ("first", "second"), np.median(with_fmu, 0), np.median(against, 0), strict=True
    ):
        print(f"{when:>6} FMU in a process {ours:6.1f} ms, process of multiprocessing {theirs:6.1f} ms")
    inside, isolated, bare = steps
    return all(
        [
            held(
                "(isolated - in process) / bare round trip",
                float(np.median((isolated - inside) / bare)),
                STEP_LIMIT,
            ),
            held(
                "first FMU / multiprocessing's first process",
                float(np.median(with_fmu[:, 0] / against[:, 0])),
                OPENING_LIMIT,
            ),
        ]
    )
