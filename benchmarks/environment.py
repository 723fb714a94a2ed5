"""What environments add to their plants: a step of each against a step of its plant, in turns of one run."""

import platform
from time import perf_counter_ns
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.step import Row
from ddpc_cosim import FloatArray, Plant, Study
from ddpc_cosim.gymnasium import make
from ddpc_cosim.loop import master
from ddpc_cosim.loop.safe_calls import reset_plant, step_plant

_TURNS, _PIECES, _STEPS = 15, 9, 10
"""All but the last steps of an episode, of which one makes its trace."""
_SEED = 0
_SHARE, _ADDED = 1.3, 15.0
"""What a step may take: so much of the plant's own, and so many microseconds."""


class _Watch:
    """Keeps what a loop asks of its plant, from the plant's last reset on."""

    def reset(self, plant: Plant, *arguments: Any) -> FloatArray:
        self.plant, self.begun = plant, arguments
        self.steps = list[tuple[FloatArray, float]]()
        return reset_plant(plant, *arguments)

    def step(self, plant: Plant, u: FloatArray, h: float, time: float) -> FloatArray:
        self.steps.append((u.copy(), h))
        return step_plant(plant, u, h, time)


def main() -> bool:
    """Print the table; return whether all bounds were held."""
    print(f"{'microseconds per step':<80}{'step':>9} {'allowed':>11} {'ratio':>8}   bound")
    rows = [_row(problem) for problem in Study.read("benchmark").problems]
    print(f"Python {platform.python_version()}, {platform.machine()}")
    return all(row.held for row in rows)


def _row(problem: str) -> Row:
    """Measure a problem of the benchmark, print its row and return it."""
    env, watch = make("benchmark", problem=problem), _Watch()
    action = (env.action_space.low + env.action_space.high) / 2.0
    with patch.object(master, "reset_plant", watch.reset):
        with patch.object(master, "step_plant", watch.step):
            env.reset(seed=_SEED)
            warm_up = [*watch.steps]
            for _ in range(_PIECES * _STEPS):
                env.step(action)
        pieces = np.array_split(np.arange(len(warm_up), len(watch.steps)), _PIECES)
        asked = [[watch.steps[i] for i in piece] for piece in pieces]
        times = np.empty((2, _TURNS, _PIECES))
        for turn in range(_TURNS):
            env.reset(seed=_SEED)
            for piece in range(_PIECES):
                begin = perf_counter_ns()
                for _ in range(_STEPS):
                    env.step(action)
                times[0, turn, piece] = perf_counter_ns() - begin
            watch.plant.reset(*watch.begun)
            for inputs, h in warm_up:
                watch.plant.step(inputs, h)
            for piece, steps in enumerate(asked):
                begin = perf_counter_ns()
                for inputs, h in steps:
                    watch.plant.step(inputs, h)
                times[1, turn, piece] = perf_counter_ns() - begin
    env.close()
    # Whatever else the machine does only adds to a piece; what is left differs as the plant's state does.
    whole, alone = np.median(times.min(axis=1), axis=1) / _STEPS / 1e3
    allowed = _SHARE * alone + _ADDED
    row = Row(f"{problem}, of which the plant takes {alone:.1f}", whole, allowed, whole / allowed, 1.0, True)
    print(row, flush=True)
    return row
