"""What an environment adds to its plant: a step of it against a step of the plant, in turns of one run."""

import platform
from time import perf_counter_ns

import numpy as np

from benchmarks.step import Row
from ddpc_cosim import FMUPlant
from ddpc_cosim.gymnasium import make
from fmu_plants import build_fmu
from fmu_plants.pendulum import MODEL

TURNS = 61
_PIECES, _STEPS = 9, 10
_SHARE, _ADDED = 1.3, 15.0
"""What a step may take: so much of the plant's own, and so many microseconds."""


def main() -> bool:
    """Print the table; return whether the bound was held."""
    env = make("benchmark", problem="pendulum")
    h, action = 0.1, np.array([0.5])
    times = np.empty((2, TURNS, _PIECES))
    with FMUPlant(build_fmu(MODEL), inputs=["torque"], outputs=["angle"]) as plant:
        for turn in range(TURNS):
            plant.reset()
            env.reset(seed=turn)
            for piece in range(_PIECES):  # all but the last steps, of which one makes a trace of the episode
                begin = perf_counter_ns()
                for _ in range(_STEPS):
                    plant.step(action, h)
                middle = perf_counter_ns()
                for _ in range(_STEPS):
                    env.step(action)
                times[:, turn, piece] = middle - begin, perf_counter_ns() - middle
    env.close()
    alone, whole = np.median(times, axis=(1, 2)) / _STEPS / 1e3
    allowed = _SHARE * alone + _ADDED
    print(f"{'medians in microseconds per step':<80}{'step':>9} {'allowed':>11} {'ratio':>8}   bound")
    row = Row(f"pendulum, of which the plant takes {alone:.1f}", whole, allowed, whole / allowed, 1.0, True)
    print(row)
    print(f"Python {platform.python_version()}, {platform.machine()}")
    return row.held
