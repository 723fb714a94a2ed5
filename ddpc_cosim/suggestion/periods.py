"""A period in what outputs do while the inputs rest: the days of a house, the cycle of a machine."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ddpc_cosim.errors import CosimError
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.suggestion.pace import monotonic
from ddpc_cosim.variables import FloatArray

SAMPLES = 600
_SAMPLES_PER_SWING = 4
_SETTLED = 3  # the last two of three parts count: what is before them may be a transient
_DIFFERENT, _SAME = 0.5, 0.12  # of what values of that spread differ by on average if nothing repeats
_AS_GOOD = 1.5
_ROUNDING = 1e-9
_WANDERS = 0.2  # of a swing: how far means may be apart
_NICE = (3600.0, 43200.0, 86400.0, 604800.0)  # s
_NEAR = 0.02
_MOST_STEPS = 3000


@dataclass(frozen=True)
class Period:
    """A period of outputs at rest.

    Parameters
    ----------
    seconds : float
        How long it is [s]; 0: nothing repeats.
    means : mapping of int to float
        The means of the outputs that repeat, over whole periods, by position.
    """

    seconds: float = 0.0
    means: Mapping[int, float] = field(default_factory=dict)

    @property
    def words(self) -> str:
        """The period with a unit that suits it."""
        hours = self.seconds / 3600.0
        return f"{hours:.4g} h" if hours >= 1.0 else f"{self.seconds:.4g} s"


def period_of(values: FloatArray) -> float:
    """Return after how many samples values repeat themselves; 0 if they do not.

    The mean difference between values that far apart falls to nearly nothing, after it has been large.

    Parameters
    ----------
    values : array, shape (n,)
        Samples at equal intervals; a straight line in them does not count.
    """
    n = len(values)
    k = np.arange(n)
    flat = values - np.polyval(np.polyfit(k, values, 1), k)
    spread = float(np.std(flat))
    if not np.isfinite(spread) or not spread > _ROUNDING * float(np.max(np.abs(values))):
        return 0.0
    lags = np.arange(1, n // 2 + 1)
    # A line adds the same to all differences, and does not matter.
    away = np.array([np.std(values[lag:] - values[:-lag]) for lag in lags]) / (math.sqrt(2.0) * spread)
    different = np.flatnonzero(away > _DIFFERENT)
    if not different.size:
        return 0.0
    begin = int(different[0])
    inner = away[1:-1]
    lows = 1 + np.flatnonzero((inner <= away[:-2]) & (inner < away[2:]))
    minima = [_minimum(away, int(at)) for at in lows if at > begin]
    best = min((depth for _, depth in minima), default=math.inf)
    if best > _SAME:
        return 0.0
    lag = next(lag for lag, depth in minima if depth <= max(_SAME / 2, _AS_GOOD * best))
    coarse = lag
    for count in range(2, int(len(away) / coarse)):  # of several periods a sample is a smaller part
        near = round(count * lag) - 1
        low, high = max(near - 2, 0), min(near + 3, len(away))
        finer = _minimum(away, low + int(np.argmin(away[low:high])))[0] / count if low < high else lag
        lag = finer if abs(finer - coarse) <= _NEAR * coarse else lag
    return lag


def _minimum(away: FloatArray, at: int) -> tuple[float, float]:
    """Return lag and depth of a minimum between the samples, where squares of distances are a parabola."""
    if not 0 < at < len(away) - 1:
        return float(at + 1), float(away[at])
    left, middle, right = (float(distance) for distance in away[at - 1 : at + 2] ** 2)
    bend = left - 2 * middle + right
    if not bend > 0.0:
        return float(at + 1), math.sqrt(middle)
    depth = max(middle - (left - right) ** 2 / (8 * bend), 0.0)
    return at + 1 + (left - right) / (2 * bend), math.sqrt(depth)


def _stays(values: FloatArray, lag: float) -> bool:
    """Return whether values come back to where they were, and do not wander off while they swing."""
    count = max(2, round(lag))
    first, last = values[:count], values[-count:]
    return abs(float(last.mean() - first.mean())) <= _WANDERS * float(np.ptp(first))


def rounded_period(seconds: float) -> float:
    """Return a period as people have them: an hour, a day, a week; else with four digits."""
    near = [nice for nice in _NICE if abs(seconds / nice - 1.0) < _NEAR]
    return near[0] if near else float(f"{seconds:.4g}")


def found_at_rest(
    plant: Plant,
    u: FloatArray,
    parameters: Mapping[str, ParameterValue],
    swings: Mapping[int, float],
    fixed_step: float | None,
    budget: float,
) -> Period:
    """Run a plant at rest with equal steps, and look for a period of outputs.

    Parameters
    ----------
    plant : Plant
        The plant; it is reset.
    u : array, shape (m,)
        Inputs at rest.
    parameters : mapping
        What differs from its defaults.
    swings : mapping of int to float
        Of the outputs in question, by position: how long they take for half their range [s].
    fixed_step : float, optional
        The size of all steps [s].
    budget : float
        Seconds of computing; what takes longer has no period that is found.

    Returns
    -------
    period : Period
        That of the slowest output that repeats itself: where several do, its multiple fits them all, or none.
    """
    ends = monotonic() + budget
    longest = Period()
    for swing in sorted({float(f"{swing:.2g}") for swing in swings.values()})[:2]:
        step = swing / _SAMPLES_PER_SWING
        counts = 1 if fixed_step is None else max(1, round(step / fixed_step))
        step = step if fixed_step is None else counts * fixed_step
        if fixed_step is not None and counts * SAMPLES > _MOST_STEPS:
            continue
        rows: list[FloatArray] = []
        try:
            plant.plan(step / counts, SAMPLES * step)
            plant.reset(parameters)
            for _ in range(SAMPLES):
                for _ in range(counts):
                    y = plant.step(u, step / counts)
                rows.append(y)
                if monotonic() > ends:
                    return longest
        except CosimError:
            continue
        values = np.array(rows)[SAMPLES // _SETTLED :]
        if not np.isfinite(values).all():
            continue
        lags = {j: lag for j in swings if (lag := period_of(values[:, j])) and _stays(values[:, j], lag)}
        if lags and max(lags.values()) * step > longest.seconds:
            lag = max(lags.values())
            whole = values[-int(len(values) // lag * lag) :]
            means = {j: float(whole[:, j].mean()) for j in lags}
            longest = Period(rounded_period(lag * step), means)
    return longest
