"""Which type of response an output has to a step of an input, from samples at growing intervals.

The samples lie in blocks, each twice as long as the one before: the last block is the last half of the time.
Within a block the intervals vary, so that an oscillation is not sampled in step with its period.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.variables import FloatArray

BLOCK = 24
"""Samples of a block."""
FLOOR = 1e-5
"""Part of an output's level below which a response is an integrator's rounding."""
_GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0  # its multiples spread evenly over the unit interval

_BAND = 0.05  # of the peak: what counts as settled, the control field's usual 5 %
_STRAIGHT = 0.05  # of its rise: how far a straight line may be missed
_ACCELERATING = 3.0  # a line doubles while time doubles, a parabola quadruples
_HIGHEST_POWER = 4.5  # of time: chains of integrators up to four, nothing else, rise so
_DOUBLINGS = 3.0  # after which an unstable plant is still where one would want to catch it
_ESCAPE = (0.003, 0.3)  # of the peak: between them an unstable mode grows undisturbed
_RAMP = (0.03, 0.1, 0.3)  # of the peak: an integrator takes three times as long from one to the next
_RAMP_RATIO = 2.0  # of the second of these times to the first; of an exponential it is 1, of a parabola 1.7
_RISEN = 1.0 - np.exp(-1.0)  # where a first-order lag is after its time constant
_QUARTER = 0.25
_CREEP = 1e-3  # of the peak: what a response that seems settled may still move without being asked further
_GROWING = 1.5  # the ends of a slow mode, that it starts with a line: twice as much in twice the time
_PARALLEL = 0.02  # of its slope: how far a line behind a lag may still be from it
_LATE = 1.5  # of the time between two jumps
_LAGS_UNTIL_PARALLEL = 8.0  # at most, as blocks are twice as long as those before them
_SPIKE = 3  # samples
_MOSTLY_SWING = 2.5  # of where it ends: beyond twice that, as an undamped mass goes, a swing is not about it
_SAME, _JUMP = 1e-9, 1e-3  # of what there was before: an output that is held, and one that is set anew


class ResponseType(StrEnum):
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
    type : ResponseType
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
    dead_time : float
        When it first leaves 5 % of its peak [s].
    rings : bool
        Whether it goes through its final value more than once before it settles, or goes on doing so; of one
        that does not settle: whether it is not just on its way yet.
    creeps : bool
        Whether it has settled as far as one sees, but a slower mode seems to begin.
    half_time : float
        When it has first covered half of its largest magnitude [s].
    quarter_time, lag : float
        Of one that settles: when it has first covered a quarter, and 63 %, of what does not come at once [s].
    feedthrough : float
        The part of its way that it covers at once, of one that settles; below 0 if that is the other way.
    held : float
        For how long the output keeps its value between one jump and the next [s]; 0 if it does not.
    """

    type: ResponseType
    effect: float = 0.0
    slope: float = 0.0
    rise_time: float = np.inf
    settling_time: float = np.inf
    peak: float = 0.0
    dead_time: float = 0.0
    rings: bool = False
    creeps: bool = False
    half_time: float = np.inf
    quarter_time: float = np.inf
    lag: float = np.inf
    feedthrough: float = 0.0
    held: float = 0.0

    @property
    def is_transient(self) -> bool:
        """Whether it returns to where it was: nothing that a constant input could hold."""
        return self.type is ResponseType.SETTLED and abs(self.effect) <= _BAND * self.peak

    @property
    def is_unstable(self) -> bool:
        """Whether the output leaves its equilibrium exponentially."""
        return self.type is ResponseType.ACCELERATING and bool(np.isfinite(self.rise_time))


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
    deviation = without_spike(deviation)
    peak = float(np.max(np.abs(deviation), initial=0.0))
    if not peak > FLOOR * level:
        return Response(ResponseType.INSENSITIVE)
    held = held_time(time, deviation)
    half_time = float(time[np.argmax(np.abs(deviation) >= peak / 2)])
    return replace(_classify(time, deviation, peak, held), held=held, half_time=half_time)


def without_spike(values: FloatArray) -> FloatArray:
    """Return values whose first samples are those after them, where they stand out from all that follow.

    It is what an initialisation or a derivative leaves, and would hide what takes time.

    Parameters
    ----------
    values : array, shape (n,)
        As for :func:`classify`.
    """
    if len(values) < 2 * BLOCK:
        return values
    first, rest = values[:_SPIKE], values[_SPIKE:]
    middle = (rest.max() + rest.min()) / 2
    span = float(np.ptp(rest))
    if not span > _BAND * float(np.ptp(values)) / 10 or np.max(np.abs(first - middle)) <= span:
        return values
    clean = values.copy()
    clean[:_SPIKE] = rest[0]
    return clean


def _classify(time: FloatArray, deviation: FloatArray, peak: float, held: float) -> Response:
    last = deviation[-BLOCK:]
    final = float(np.mean(last))
    if np.all(np.abs(last - final) <= _BAND * peak):
        moving = np.flatnonzero(np.abs(deviation - final) > _BAND * peak)
        settled = float(time[moving[-1] + 1]) if moving.size else float(time[0])
        rise = _first_reached(time, deviation, final if abs(final) > _BAND * peak else peak)
        sides = np.sign(deviation[moving] - final)
        rings = bool(np.count_nonzero(np.diff(sides)) > 1)
        if rings and peak > _MOSTLY_SWING * abs(final):  # its way is the first swing, not where it ends
            rise = _first_reached(time, deviation, peak)
        creeps = _creeps(deviation, peak)
        dead = float(time[np.argmax(np.abs(deviation) > _BAND * peak)])
        response = Response(ResponseType.SETTLED, final, 0.0, rise, settled, peak, dead, rings, creeps)
        return _with_lag(response, time, deviation)
    slope = _common_slope(time, deviation)
    if slope:
        lag = _lag(time, deviation, slope, held)
        return Response(ResponseType.INTEGRATING, float(deviation[-1]), slope, lag, np.inf, peak)
    # What runs away at once leaves no more than one block, in which time doubles in its second half.
    half = deviation[-2 * BLOCK : -BLOCK] if len(deviation) > BLOCK else deviation[: BLOCK // 2]
    before = float(np.max(np.abs(half), initial=0.0))
    if len(deviation) >= BLOCK and peak > _ACCELERATING * before and np.argmax(np.abs(last)) == BLOCK - 1:
        doubling = _doubling_time(time, deviation)
        early = float(deviation[np.argmax(time >= min(_DOUBLINGS * doubling, time[-1]))])
        return Response(ResponseType.ACCELERATING, early, 0.0, doubling, np.inf, peak)
    rise = _first_reached(time, deviation, peak)
    turns = np.count_nonzero(np.diff(np.sign(deviation[-2 * BLOCK :] - final)))
    return Response(ResponseType.OSCILLATING, final, 0.0, rise, np.inf, peak, rings=bool(turns > 1))


def _with_lag(response: Response, time: FloatArray, deviation: FloatArray) -> Response:
    """Return a response that settles with the times of what it does not do at once: a jump has none."""
    jump, final = float(deviation[0]), response.effect
    way = (deviation - jump) * np.sign(final - jump)
    quarter, lag = (
        float(time[np.argmax(way >= share * abs(final - jump))] - time[0]) for share in (_QUARTER, _RISEN)
    )
    return replace(response, quarter_time=quarter, lag=lag, feedthrough=jump / final if final else 0.0)


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
    return Response(ResponseType.ACCELERATING, early, 0.0, float(doubling), np.inf, peak)


def limited_slope(time: FloatArray, deviation: FloatArray) -> float:
    """Return the slope of an output that integrates until it is at a limit of its own; 0 if it does not.

    Parameters
    ----------
    time, deviation : array, shape (n,)
        As for :func:`escaping`.
    """
    size = np.abs(deviation) / np.max(np.abs(deviation))
    begin, middle, end = (int(np.argmax(size >= share)) for share in _RAMP)
    if not time[end] - time[middle] > _RAMP_RATIO * (time[middle] - time[begin]):
        return 0.0
    return float((deviation[end] - deviation[begin]) / (time[end] - time[begin])) if end > begin else 0.0


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


def _lag(time: FloatArray, deviation: FloatArray, slope: float, held: float) -> float:
    """Return by how much a line is late, or how long it swings before it is one [s].

    Its lag is measured from where it is first parallel to what it becomes; a delay by a clock is not a lag.
    """
    t, d = time.reshape(-1, BLOCK), deviation.reshape(-1, BLOCK)
    slopes = (d[:, -1] - d[:, 0]) / (t[:, -1] - t[:, 0])
    bent = np.flatnonzero(np.abs(slopes - slope) > _PARALLEL * abs(slope))
    if not bent.size:
        return 0.0
    first = min(bent[-1] + 1, len(t) - 1)
    late = float(np.mean(t[first] - d[first] / slope))
    if held:
        return late if late > _LATE * held else 0.0
    return max(late, float(t[first, 0]) / _LAGS_UNTIL_PARALLEL)


def _creeps(deviation: FloatArray, peak: float) -> bool:
    """Return whether the means of the last blocks, each twice as long, drift apart like a line."""
    if len(deviation) < 3 * BLOCK:
        return False
    before, now = np.diff(deviation[-3 * BLOCK :].reshape(3, BLOCK).mean(axis=1))
    return bool(abs(now) > _CREEP * peak and now * np.sign(before) >= _GROWING * abs(before))


def held_time(time: FloatArray, deviation: FloatArray) -> float:
    """Return for how long an output keeps its value between two jumps, as under a clock of its own [s].

    Parameters
    ----------
    time, deviation : array, shape (n,)
        As for :func:`classify`.

    Returns
    -------
    held : float
        The median; 0 if the output moves between the samples.
    """
    change = np.abs(np.diff(deviation))
    so_far = np.maximum.accumulate(np.abs(deviation))[:-1]
    jumps = np.flatnonzero((change > _JUMP * so_far) & (change > 0.0))
    pairs = list(pairwise(jumps))
    long = [i for i, (before, after) in enumerate(pairs) if after - before > 2]
    if len(long) < 2 or len(long) <= long[-1] // 2:  # later jumps are those of samples that lie farther apart
        return 0.0
    within = [change[a + 1 : b] <= _SAME * so_far[a + 1 : b] for a, b in (pairs[i] for i in long)]
    held = [time[b] - time[a] for a, b in (pairs[i] for i in long)]
    return float(np.median(held)) if all(np.all(still) for still in within) else 0.0


def _doubling_time(time: FloatArray, deviation: FloatArray) -> float:
    """Return how long an exponential takes to double [s]; infinite for what is rather a power of time."""
    late, early = abs(deviation[-1]), abs(deviation[-BLOCK])
    growth = np.log(late / early) if early > 0.0 else 0.0
    doublings_of_time = np.log(time[-1] / time[-BLOCK])
    if growth <= _HIGHEST_POWER * doublings_of_time:
        return np.inf
    return float(np.log(2.0) * (time[-1] - time[-BLOCK]) / growth)
