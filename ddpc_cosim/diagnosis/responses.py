"""What kind of response an output has to a step of an input, from samples at growing intervals.

The samples lie in blocks, each twice as long as the one before: the last block is the last half of the time.
Within a block the intervals vary, lest an oscillation be sampled in step with its period.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.variables import FloatArray

BLOCK = 24
"""Samples of a block."""
_GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0  # its multiples spread evenly over the unit interval

_BAND = 0.05  # of the peak: what counts as settled, the control field's usual 5 %
_STRAIGHT = 0.05  # of its rise: how far a straight line may be missed
_ACCELERATING = 3.0  # a line doubles while time doubles, a parabola quadruples
_HIGHEST_POWER = 4.5  # of time: chains of integrators up to four, nothing else, rise so
_DOUBLINGS = 3.0  # after which an unstable plant is still where one would want to catch it
_ESCAPE = (0.003, 0.3)  # of the peak: between them an unstable mode grows undisturbed
_FLOOR = 1e-5  # of the output's level: below it a response is an integrator's rounding
_RISEN = 1.0 - np.exp(-1.0)  # where a first-order lag is after its time constant


class Nature(StrEnum):
    """How an output goes on after a step."""

    INSENSITIVE = "insensitive"
    SETTLED = "settles"
    INTEGRATING = "integrates"
    ACCELERATING = "accelerates"
    OSCILLATING = "does not settle"


@dataclass(frozen=True, slots=True)
class Response:
    """The response of one output to a step of one input.

    Parameters
    ----------
    nature : Nature
        How it goes on.
    effect : float
        Where it ends, in the output's unit: the final value of one that settles, the mean of one that
        oscillates; what one that integrates has reached in the end, and one that accelerates when it has
        doubled a few times.
    slope : float
        Change per second of one that integrates.
    rise_time : float
        When it has first covered 63 % of its way [s]; of one that integrates its lag, of one that
        accelerates the time in which it doubles, infinite if it rises like a power of time.
    settling_time : float
        When it is within 5 % of its peak for good [s]; infinite if it never is.
    peak : float
        Its largest magnitude.
    """

    nature: Nature
    effect: float = 0.0
    slope: float = 0.0
    rise_time: float = np.inf
    settling_time: float = np.inf
    peak: float = 0.0

    @property
    def is_transient(self) -> bool:
        """Whether it returns to where it was: nothing that a constant input could hold."""
        return self.nature is Nature.SETTLED and abs(self.effect) <= _BAND * self.peak


def sample_counts(blocks: int) -> NDArray[np.int64]:
    """Return the lengths of all sampling intervals, shape (blocks * BLOCK,), in units of the first ones."""
    spread = 0.5 + np.arange(BLOCK) * _GOLDEN % 1.0
    counts = np.rint(np.outer(2.0 ** np.arange(blocks), spread)).ravel()
    return np.maximum(counts, 1).astype(np.int64)


def classify(time: FloatArray, deviation: FloatArray, level: float) -> Response:
    """Classify a response.

    Parameters
    ----------
    time : array, shape (n,)
        Times after the step [s], in blocks.
    deviation : array, shape (n,)
        Output with the step minus output without it.
    level : float
        Magnitude of the output itself: small deviations count in relation to it.
    """
    peak = float(np.max(np.abs(deviation), initial=0.0))
    if not peak > _FLOOR * level:
        return Response(Nature.INSENSITIVE)
    last = deviation[-BLOCK:]
    final = float(np.mean(last))
    if np.all(np.abs(last - final) <= _BAND * peak):
        moving = np.flatnonzero(np.abs(deviation - final) > _BAND * peak)
        settled = float(time[moving[-1] + 1]) if moving.size else float(time[0])
        rise = _first_reached(time, deviation, final if abs(final) > _BAND * peak else peak)
        return Response(Nature.SETTLED, final, 0.0, rise, settled, peak)
    slope = _common_slope(time, deviation)
    if slope:
        lag = max(float(time[-1] - deviation[-1] / slope), 0.0)
        return Response(Nature.INTEGRATING, float(deviation[-1]), slope, lag, np.inf, peak)
    before = float(np.max(np.abs(deviation[-2 * BLOCK : -BLOCK]), initial=0.0))
    if len(deviation) > BLOCK and peak > _ACCELERATING * before and np.argmax(np.abs(last)) == BLOCK - 1:
        doubling = _doubling_time(time, deviation)
        early = float(deviation[np.argmax(time >= min(_DOUBLINGS * doubling, time[-1]))])
        return Response(Nature.ACCELERATING, early, 0.0, doubling, np.inf, peak)
    return Response(Nature.OSCILLATING, final, 0.0, _first_reached(time, deviation, peak), np.inf, peak)


def escaping(time: FloatArray, deviation: FloatArray, peak: float) -> Response:
    """Return the response of an output that leaves its equilibrium by itself, and ends somewhere else.

    Parameters
    ----------
    time, deviation : array, shape (n,)
        As for :func:`classify`, after a small step and scaled up to a large one.
    peak : float
        Largest magnitude that the deviation has had before it was scaled.
    """
    size = np.abs(deviation) / np.max(np.abs(deviation))
    begin, end = (float(time[np.argmax(size >= share)]) for share in _ESCAPE)
    doubling = max(end - begin, float(time[0])) / np.log2(_ESCAPE[1] / _ESCAPE[0])
    early = float(deviation[np.argmax(time >= _DOUBLINGS * doubling)])
    return Response(Nature.ACCELERATING, early, 0.0, float(doubling), np.inf, peak)


def _first_reached(time: FloatArray, deviation: FloatArray, way: float) -> float:
    """Return when 63 % of the way are covered first."""
    return float(time[np.argmax(np.abs(deviation) >= _RISEN * abs(way))])


def _common_slope(time: FloatArray, deviation: FloatArray) -> float:
    """Return the slope if the last two blocks are one straight line; 0 if they are not."""
    if len(deviation) <= 2 * BLOCK:
        return 0.0
    t, d = time[-2 * BLOCK :], deviation[-2 * BLOCK :]
    slope, offset = np.polyfit(t, d, 1)
    rise = abs(slope) * (t[-1] - t[0])
    straight = np.max(np.abs(slope * t + offset - d)) <= _STRAIGHT * rise
    return float(slope) if straight and rise > 0.0 else 0.0


def _doubling_time(time: FloatArray, deviation: FloatArray) -> float:
    """Return how long an exponential takes to double [s]; infinite for what is rather a power of time."""
    late, early = abs(deviation[-1]), abs(deviation[-BLOCK])
    growth = np.log(late / early) if early > 0.0 else 0.0
    doublings_of_time = np.log(time[-1] / time[-BLOCK])
    if growth <= _HIGHEST_POWER * doublings_of_time:
        return np.inf
    return float(np.log(2.0) * (time[-1] - time[-BLOCK]) / growth)
