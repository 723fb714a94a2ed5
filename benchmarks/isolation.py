"""What isolation costs: a step of an FMU in a process of its own against the same step in this process."""

import os
import platform
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
LIMIT = 20.0
"""What an isolated step may take more than one in this process, on one core [us]."""


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


def measure(fmu: Path) -> tuple[FloatArray, FloatArray, float]:
    """Let both take turns, so that a machine that slows down slows both; times of steps, and of opening."""
    u = np.ones(1)
    start = perf_counter_ns()
    with FMUPlant(fmu) as here, FMUPlant(fmu, isolated=True) as there:
        opening = (perf_counter_ns() - start) / 1e6
        turns = [(turn(here, u), turn(there, u)) for _ in range(TURNS)]
    inside, isolated = np.array(turns).T
    return inside, isolated, opening


def main() -> bool:
    """Print medians and ranges; return whether the bound was held."""
    print(f"{platform.platform()}, {platform.machine()}, Python {platform.python_version()}")
    with tempfile.TemporaryDirectory() as folder, one_core() as pinned:
        inside, isolated, opening = measure(export_fmu(MODEL, Path(folder) / "pendulum.fmu"))
    where = "on one core" if pinned else "on any core"
    for label, times in (("in this process", inside), ("isolated", isolated)):
        print(f"step {label:<16} {np.median(times):6.2f} us  [{times.min():.2f}-{times.max():.2f}], {where}")
    difference = float(np.median(isolated - inside))
    held = difference <= LIMIT
    print(f"isolated - in process {difference:6.2f} us   <= {LIMIT:g} {'held' if held else 'MISSED'}")
    print(f"opening the first isolated plant: {opening:.0f} ms")
    return held
