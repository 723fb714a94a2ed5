"""Simulate how many pairs each statistic of the sign-flip max-T tells apart: the table of statistics.md.

Of fourteen controllers the leader is 3 standard deviations of its seeds ahead of all others. Counted are its
pairs with those that vary as it does; where each level has its noise, with all.
"""

from collections.abc import Callable
from itertools import combinations

import numpy as np

from ddpc_cosim.study.verdicts.statistics import _turned, step_down

PAIRS = np.array([*combinations(range(14), 2)])
SCENES = ("all vary alike", "one controller varies 30 times as much", "each level has its noise")
Array = np.ndarray


def p_values(rows: Array, statistic: Callable[[Array], Array]) -> Array:
    """Return step-down max-T p-values by any statistic of flipped rows, shape (tests, flips, seeds)."""
    seeds = rows.shape[1]
    signs = 1 - 2 * np.unpackbits(_turned(seeds, 999), axis=1, count=seeds).astype(np.int8)
    statistics = np.concatenate(
        [statistic(rows[:, None] * part) for part in np.array_split(signs, 16)], axis=1
    )
    order = np.argsort(-statistics[:, 0], kind="stable")
    largest = np.maximum.accumulate(statistics[order][::-1], axis=0)[::-1]
    share = (largest >= statistics[order, :1] * (1 - 1e-9)).mean(axis=1)
    p = np.empty(len(rows))
    p[order] = np.maximum.accumulate(share)
    return p


def studentised(rows: Array) -> Array:
    """Return means over root mean squares, which have the order of t."""
    return np.asarray(abs(rows.mean(axis=2)) / np.sqrt((rows**2).mean(axis=2)))


TESTS: dict[str, Callable[[Array], Array]] = {
    "as here": lambda rows: step_down(rows, PAIRS),
    "mean": lambda rows: p_values(rows, lambda flipped: abs(flipped.mean(axis=2))),
    "studentised mean": lambda rows: p_values(rows, studentised),
    "median": lambda rows: p_values(rows, lambda flipped: abs(np.median(flipped, axis=2))),
}


def power(scene: str, seeds: int, studies: int) -> dict[str, float]:
    """Return by statistic the share of the leader's pairs that are told apart, in percent."""
    rng = np.random.default_rng(seeds)
    shares: dict[str, list[float]] = {name: [] for name in TESTS}
    counted = (PAIRS[:, 0] == 0) & ((PAIRS[:, 1] < 13) | (scene != SCENES[1]))
    for _ in range(studies):
        values = rng.normal(size=(14, seeds))
        if scene == SCENES[2]:
            values = np.exp(np.linspace(0, 3, 14))[:, None] * (1 + 0.1 * values)
        else:
            values[13] *= 30 if scene == SCENES[1] else 1
            values[0] -= 3
        rows = values[PAIRS[:, 0]] - values[PAIRS[:, 1]]
        for name, test in TESTS.items():
            shares[name].append(float((test(rows)[counted] <= 0.05).mean()))
    return {name: 100 * float(np.mean(of_test)) for name, of_test in shares.items()}


if __name__ == "__main__":
    for scene in SCENES:
        for seeds in (6, 8, 15, 20):
            powers = power(scene, seeds, 1000 if seeds < 10 else 50)
            print(
                f"| {scene} | {seeds} | {' | '.join(f'{percent:.0f}' for percent in powers.values())} |",
                flush=True,
            )
