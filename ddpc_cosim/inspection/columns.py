"""What the columns of a log hold: missing, stuck, saturated and quantised values, and how its rows follow."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.variables import FloatArray

# A constant stretch counts as stuck from so many samples on, and from so many times as long as 99 % of the
# other stretches are: what is coarse or slow repeats itself, too.
_STUCK, _AS_LONG = 20, 5.0
# A limit is where a signal stays for so many samples in a row, and is so much more often than next to it.
_AT_LIMIT, _MORE_OFTEN, _SATURATED_SHARE = 3, 5.0, 0.005
_NEAR = 0.1  # of the range: a value farther from all others is none that a signal comes up against
_FEW_LEVELS = 12
# Values are multiples of a step where they are so near to them, and no more than so many steps apart.
_ON_GRID, _MOST_STEPS = 1e-4, 20_000
_COARSE = 0.05
"""Steps from this part of the standard deviation on hide what a plant does."""
# What a signal moves by less than this part of its range is noise.
_MOVE = 0.01
# In parts of the usual time between rows.
_GAP, _UNEVEN = 1.5, 1e-3


@dataclass(frozen=True, slots=True)
class Stretch:
    """Where a signal is constant.

    Parameters
    ----------
    value : float
        The value.
    first : int
        Its first row.
    samples : int
        How many rows.
    """

    value: float
    first: int
    samples: int


@dataclass(frozen=True, slots=True)
class ColumnFacts:
    """What one column holds.

    Parameters
    ----------
    name, unit, role : str
        The signal; its role is ``"input"``, ``"output"``, ``"disturbance"`` or empty.
    missing, first_missing : int
        How many cells are missing, and the row of the first; -1 where none is.
    minimum, maximum, mean, deviation : float
        Of the cells that are there; NaN where none is.
    constant : bool
        Whether all of them are the same.
    stuck : tuple of Stretch
        Where it stands still for much longer than it does elsewhere, the longest first; of inputs, which are
        held, none.
    low, high : float
        Shares of the samples at the smallest and the largest value, where these are limits at which it stays;
        otherwise 0.
    first_at_limit : int
        The first row at such a limit; -1 where there is none.
    step : float
        The step that all values are multiples of, off the first; 0 where there is none.
    levels : int
        How many different values there are.
    moves : int
        How often it changes by more than a hundredth of its range from one row to the next.
    """

    name: str
    unit: str
    role: str
    missing: int
    first_missing: int
    minimum: float
    maximum: float
    mean: float
    deviation: float
    constant: bool
    stuck: tuple[Stretch, ...]
    low: float
    high: float
    first_at_limit: int
    step: float
    levels: int
    moves: int

    @property
    def empty(self) -> bool:
        """Whether no cell is there."""
        return self.levels == 0

    @property
    def is_coarse(self) -> bool:
        """Whether its steps hide what the plant does."""
        return self.role != "input" and self.step > _COARSE * self.deviation and self.deviation > 0.0


@dataclass(frozen=True, slots=True)
class SamplingFacts:
    """How rows follow each other.

    Parameters
    ----------
    rows : int
        Number of rows.
    sampling_time, jitter : float
        Time between rows [s]: the median, and the root mean square deviation from it of all that is no gap.
    gaps, missing_rows : int
        How many times rows are missing, and how many in all.
    longest_gap : float
        Time between the rows before and after the longest of them [s].
    first_gap : int
        The row after the first; -1 where there is none.
    duplicates, first_duplicate : int
        How many rows have the time of the row before, and the first of them; -1 where there is none.
    backwards : int
        How many rows are earlier than the row before.
    """

    rows: int
    sampling_time: float
    jitter: float = 0.0
    gaps: int = 0
    missing_rows: int = 0
    longest_gap: float = 0.0
    first_gap: int = -1
    duplicates: int = 0
    first_duplicate: int = -1
    backwards: int = 0

    @property
    def is_even(self) -> bool:
        """Whether rows are equally far apart, but for gaps."""
        return self.jitter <= _UNEVEN * self.sampling_time


def column_facts(name: str, unit: str, role: str, values: FloatArray) -> ColumnFacts:
    """Return what a column holds; its values, shape (T,), are NaN where a cell is missing."""
    there = np.isfinite(values)
    known, rows = values[there], np.flatnonzero(there)
    missing = len(values) - len(known)
    first_missing = int(np.argmin(there)) if missing else -1
    if not len(known):
        nothing = (np.nan,) * 4
        return ColumnFacts(name, unit, role, missing, first_missing, *nothing, True, (), 0, 0, -1, 0, 0, 0)
    smallest, largest = float(known.min()), float(known.max())
    distinct = np.unique(known)
    low = high = 0.0
    first_at_limit, stuck = -1, tuple[Stretch, ...]()
    if len(distinct) > _FEW_LEVELS:  # otherwise it is switched, and stays where it is by intent
        stretches = _Stretches(known)
        low, high, first_at_limit = _limits(known, rows, distinct, stretches)
        at_limits = {value for value, share in ((smallest, low), (largest, high)) if share}
        if role != "input":
            stuck = tuple(stretches.stuck(rows, at_limits))
    moved = np.abs(np.diff(known)) > _MOVE * (largest - smallest)
    return ColumnFacts(
        name,
        unit,
        role,
        missing,
        first_missing,
        smallest,
        largest,
        float(known.mean()),
        float(known.std()),
        len(distinct) == 1,
        stuck,
        low,
        high,
        first_at_limit,
        _step(distinct),
        len(distinct),
        int(moved.sum()) if len(distinct) > 1 else 0,
    )


class _Stretches:
    """The stretches of a signal in which it is constant, shape (S,) each: first sample and length."""

    def __init__(self, known: FloatArray) -> None:
        self.first: NDArray[np.intp] = np.concatenate([[0], np.flatnonzero(np.diff(known)) + 1])
        self.length: NDArray[np.intp] = np.diff(np.append(self.first, len(known)))
        self.value = known[self.first]

    def stuck(self, rows: NDArray[np.intp], limits: set[float]) -> Iterator[Stretch]:
        """Yield those that are far longer than usual, the longest first, and not at a limit."""
        usual = float(np.quantile(self.length, 0.99, method="lower"))
        long = np.flatnonzero(self.length >= max(_STUCK, _AS_LONG * usual))
        for i in long[np.argsort(-self.length[long], kind="stable")].tolist():
            if float(self.value[i]) not in limits:
                yield Stretch(float(self.value[i]), int(rows[self.first[i]]), int(self.length[i]))


def _limits(
    known: FloatArray, rows: NDArray[np.intp], distinct: FloatArray, stretches: _Stretches
) -> tuple[float, float, int]:
    """Return the shares of samples at the smallest and largest value if it stays there; where first."""
    shares, firsts = [], []
    for extreme, beside in ((distinct[0], distinct[1]), (distinct[-1], distinct[-2])):
        there, longest = known == extreme, stretches.length[stretches.value == extreme].max()
        count = int(there.sum())
        stays = longest >= _AT_LIMIT and count > _MORE_OFTEN * int((known == beside).sum())
        stays = stays and abs(beside - extreme) < _NEAR * (distinct[-1] - distinct[0])
        share = count / len(known)
        shares.append(share if stays and share >= _SATURATED_SHARE else 0.0)
        firsts += [int(rows[np.argmax(there)])] if shares[-1] else []
    return shares[0], shares[1], min(firsts, default=-1)


def _step(distinct: FloatArray) -> float:
    """Return the step that sorted values are multiples of, off the first; 0 if there is none."""
    if len(distinct) < 3:
        return 0.0
    apart = np.diff(distinct)
    step = float(apart.min())
    # The smallest difference of rounded decimals is off by rounding; that of many steps tells it better.
    for _ in range(3):
        steps = np.rint((distinct - distinct[0]) / step)
        if not 0 < steps[-1] <= _MOST_STEPS:
            return 0.0
        step = float((distinct[-1] - distinct[0]) / steps[-1])
    off = np.abs((distinct - distinct[0]) / step - steps)
    return step if off.max() < _ON_GRID * max(1.0, steps[-1] * 1e-3) else 0.0


def sampling_facts(time: FloatArray) -> SamplingFacts:
    """Return how rows follow each other; times [s], shape (T,), are NaN where the log has none."""
    if len(time) < 2 or not np.isfinite(time).all():
        return SamplingFacts(len(time), np.nan)
    apart = np.diff(time)
    later = apart[apart > 0.0]
    usual = float(np.median(later)) if len(later) else np.nan
    gap, same = apart > _GAP * usual, apart == 0.0
    near = apart[(apart > 0.0) & ~gap]
    return SamplingFacts(
        len(time),
        usual,
        float(np.sqrt(np.mean(np.square(near - usual)))) if len(near) else np.nan,
        int(gap.sum()),
        int(np.rint(apart[gap] / usual - 1.0).sum()),
        float(apart[gap].max(initial=0.0)),
        int(np.argmax(gap)) + 1 if gap.any() else -1,
        int(same.sum()),
        int(np.argmax(same)) + 1 if same.any() else -1,
        int((apart < 0.0).sum()),
    )


def whole_pieces(time: FloatArray, values: FloatArray, seams: Sequence[int] = ()) -> list[slice]:
    """Return the stretches of rows in which no cell is missing and no row, in their order."""
    there: NDArray[np.bool_] = np.asarray(np.isfinite(values).all(axis=1))
    breaks = {*seams}
    if len(time) > 1 and np.isfinite(time).all():
        apart = np.diff(time)
        later = apart[apart > 0.0]
        usual = float(np.median(later)) if len(later) else np.inf
        breaks |= set((np.flatnonzero((apart > _GAP * usual) | (apart <= 0.0)) + 1).tolist())
    edges = np.flatnonzero(np.diff(there.astype(np.int8))) + 1
    ends = sorted(breaks | set(edges.tolist()) | {0, len(there)})
    return [slice(i, j) for i, j in pairwise(ends) if j > i and there[i]]
