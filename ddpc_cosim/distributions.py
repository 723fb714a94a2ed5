"""Distributions of plant parameters: each seed draws a plant of its own, the same for whoever controls it.

Draws are made by inversion: a number between 0 and 1 belongs to a seed and a parameter, and the distribution
says which value that is. A parameter that another scenario spreads otherwise is drawn with the same number.
"""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from functools import lru_cache, partial
from itertools import pairwise
from math import inf, isfinite, log
from numbers import Real
from typing import Annotated, ClassVar, Literal

import numpy as np

from ddpc_cosim.codec import Kinds, Section
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.settings import check_settings, setting
from ddpc_cosim.variables import FloatArray

Sampling = Literal["independent", "latin-hypercube", "sobol"]
"""How the numbers of several seeds and parameters are drawn together."""

_STREAM = 12  # of the seed; lower ones are those of loops, of conditions and of forecasts
CLOSEST = 2.0**-53  # to 0 and 1, where an unbounded distribution has no value
_SOBOL_BITS = 32  # of which there are as many points as there are seeds
_LEAST_LEFT = 1e-6


@dataclass(frozen=True, slots=True)
class Distribution(Section, ABC):
    """What a plant parameter is drawn from, in the parameter's unit."""

    kind_key: ClassVar[str] = "distribution"
    kind: ClassVar[str] = ""

    @property
    @abstractmethod
    def support(self) -> tuple[float, float]:
        """Lowest and highest value; infinite where there is none."""

    @abstractmethod
    def quantile(self, share: FloatArray) -> FloatArray:
        """Return the values below which shares of all draws lie.

        Parameters
        ----------
        share : array
            From 0 to 1, both excluded.

        Returns
        -------
        values : array
            In the parameter's unit; same shape.
        """


def _in_order(kind: str, **limits: float | None) -> None:
    """Report limits that are not numbers or do not increase; None: there is none."""
    given = [(name, value) for name, value in limits.items() if value is not None]
    faults = [
        f"{kind}: {name} = {value!r} is not possible; needed: a finite number"
        for name, value in given
        if not (isinstance(value, Real) and isfinite(value))
    ]
    faults = faults or [
        f"{kind}: {lower} = {value:g} must be less than {upper} = {above:g}"
        for (lower, value), (upper, above) in pairwise(given)
        if not value < above
    ]
    if faults:
        raise ConfigError(faults)


@dataclass(frozen=True, slots=True)
class _CutOff(Distribution):
    """What distributions with tails share: they may be cut off, and the rest is drawn in proportion."""

    _: KW_ONLY
    low: float | None = setting(None, doc="lowest value that is drawn; none: any")
    high: float | None = setting(None, doc="highest value that is drawn; none: any")

    def __post_init__(self) -> None:
        check_settings(self)
        _in_order(self.kind, low=self.low, high=self.high)
        below, above = self._shares_of_limits()
        if above - below < _LEAST_LEFT:
            low, high = self.support
            left = f"less than {_LEAST_LEFT:g} of it lies from {low:g} to {high:g}"
            raise ConfigError(f"{self.kind}: {left}; move low or high, or leave them out")

    @property
    def support(self) -> tuple[float, float]:
        """Lowest and highest value; infinite where there is none."""
        return -inf if self.low is None else self.low, inf if self.high is None else self.high

    def quantile(self, share: FloatArray) -> FloatArray:
        """Return the values below which shares of all draws lie; ``share`` in (0, 1), same shape."""
        from scipy.special import ndtri  # SciPy's part that few studies need

        below, above = self._shares_of_limits()
        return np.clip(self._value(ndtri(below + share * (above - below))), *self.support)

    def _shares_of_limits(self) -> tuple[float, float]:
        """Return which shares lie below the limits where nothing is cut off."""
        from scipy.special import ndtr

        low, high = self.support
        return float(ndtr(self._standard(low))), float(ndtr(self._standard(high)))

    @abstractmethod
    def _standard(self, value: float) -> float:
        """Return a value as one of the standard normal distribution."""

    @abstractmethod
    def _value(self, standard: FloatArray) -> FloatArray:
        """Return the inverse of that."""


@dataclass(frozen=True, slots=True)
class Normal(_CutOff):
    """Normal, with a mean and a standard deviation; cut off where there are limits.

    Parameters
    ----------
    mean : float
        The mean, where nothing is cut off.
    deviation : float
        The standard deviation, where nothing is cut off; above 0.
    low, high : float, optional
        Between what it is drawn.

    Raises
    ------
    ConfigError
        A value that is not possible, or nothing is left between the limits.
    """

    kind: ClassVar[str] = "normal"

    mean: float = setting(doc="mean, where nothing is cut off")
    deviation: float = setting(doc="standard deviation, where nothing is cut off", above=0)

    def _standard(self, value: float) -> float:
        return (value - self.mean) / self.deviation

    def _value(self, standard: FloatArray) -> FloatArray:
        return self.mean + self.deviation * standard


@dataclass(frozen=True, slots=True)
class LogNormal(_CutOff):
    """Its logarithm is normal: as likely to be a factor too large as that factor too small.

    Parameters
    ----------
    median : float
        The median, where nothing is cut off; above 0.
    factor : float
        Two thirds of the draws, 68.3 %, are from median / factor to median x factor; above 1.
    low, high : float, optional
        Between what it is drawn.

    Raises
    ------
    ConfigError
        A value that is not possible, or nothing is left between the limits.
    """

    kind: ClassVar[str] = "log-normal"

    median: float = setting(doc="median, where nothing is cut off", above=0)
    factor: float = setting(
        doc="68.3 % are from median / factor to median x factor, where nothing is cut off", above=1
    )

    @property
    def support(self) -> tuple[float, float]:
        """Lowest and highest value; infinite where there is none."""
        low, high = super(LogNormal, self).support
        return max(low, 0.0), high

    def _standard(self, value: float) -> float:
        return -inf if value <= 0 else log(value / self.median) / log(self.factor)

    def _value(self, standard: FloatArray) -> FloatArray:
        return self.median * self.factor**standard


@dataclass(frozen=True, slots=True)
class Uniform(Distribution):
    """Each value between two limits is as likely as another.

    Parameters
    ----------
    low, high : float
        The limits.

    Raises
    ------
    ConfigError
        A value that is not possible.
    """

    kind: ClassVar[str] = "uniform"

    low: float = setting(doc="lowest value")
    high: float = setting(doc="highest value")

    def __post_init__(self) -> None:
        check_settings(self)
        _in_order(self.kind, low=self.low, high=self.high)

    @property
    def support(self) -> tuple[float, float]:
        """Lowest and highest value."""
        return self.low, self.high

    def quantile(self, share: FloatArray) -> FloatArray:
        """Return the values below which shares of all draws lie; ``share`` in (0, 1), same shape."""
        return self.low + (self.high - self.low) * share


@dataclass(frozen=True, slots=True)
class Triangular(Distribution):
    """Its density rises linearly from the lowest value to the most likely one, and falls to the highest.

    Parameters
    ----------
    low, mode, high : float
        The lowest, the most likely and the highest value.

    Raises
    ------
    ConfigError
        A value that is not possible.
    """

    kind: ClassVar[str] = "triangular"

    low: float = setting(doc="lowest value")
    mode: float = setting(doc="most likely value")
    high: float = setting(doc="highest value")

    def __post_init__(self) -> None:
        check_settings(self)
        _in_order(self.kind, low=self.low, high=self.high)
        if not self.low <= self.mode <= self.high:
            between = f"from low = {self.low:g} to high = {self.high:g}"
            raise ConfigError(f"{self.kind}: mode = {self.mode:g} must be {between}")

    @property
    def support(self) -> tuple[float, float]:
        """Lowest and highest value."""
        return self.low, self.high

    def quantile(self, share: FloatArray) -> FloatArray:
        """Return the values below which shares of all draws lie; ``share`` in (0, 1), same shape."""
        width, rising, falling = self.high - self.low, self.mode - self.low, self.high - self.mode
        below = self.low + np.sqrt(share * width * rising)
        above = self.high - np.sqrt((1.0 - share) * width * falling)
        return np.where(share * width < rising, below, above)


DISTRIBUTIONS = {kind.kind: kind for kind in (Normal, LogNormal, Uniform, Triangular)}
"""The distributions that a parameter may have, by their kinds."""
ParameterDistribution = Annotated[Distribution, Kinds(DISTRIBUTIONS)]


@lru_cache(maxsize=8)
def shares(names: tuple[str, ...], sampling: Sampling, seeds: tuple[int, ...]) -> FloatArray:
    """Return the numbers by which seeds draw parameters: all are between 0 and 1.

    Parameters
    ----------
    names : tuple of str
        The parameters.
    sampling : {"independent", "latin-hypercube", "sobol"}
        "independent": a number depends on its seed and its parameter only. "latin-hypercube": of n seeds one
        lies in each n-th part, for every parameter; it depends on all seeds. "sobol": a seed is the number of
        a point of the Sobol sequence, in all parameters together; it does not depend on other seeds.
    seeds : tuple of int
        The seeds.

    Returns
    -------
    shares : array, shape (len(seeds), len(names))
        Read-only.
    """
    if sampling == "sobol":
        drawn = _in_runs(seeds, partial(_sobol_points, names))
    elif sampling == "latin-hypercube":
        drawn = np.column_stack([_stratified(name, len(seeds)) for name in names])
    else:
        drawn = _in_runs(seeds, partial(_independent, names))
    drawn = np.clip(drawn, CLOSEST, 1.0 - CLOSEST)
    drawn.setflags(write=False)
    return drawn


def _in_runs(seeds: Sequence[int], draw: Callable[[int, int], FloatArray]) -> FloatArray:
    """Return what seeds draw, shape (len(seeds), n), given what so many consecutive ones draw from one on."""
    order = np.argsort(seeds)
    ordered = np.asarray(seeds, dtype=np.int64)[order]
    runs = np.split(ordered, np.flatnonzero(np.diff(ordered) != 1) + 1)
    drawn = np.concatenate([draw(int(run[0]), len(run)) for run in runs])
    drawn[order] = drawn.copy()
    return drawn


def _stream(name: str) -> np.random.PCG64:
    """Return the random numbers of a parameter."""
    return np.random.PCG64(np.random.SeedSequence([_STREAM, *name.encode()]))


def _independent(names: Sequence[str], first: int, count: int) -> FloatArray:
    """Return the numbers of a parameter's stream that have the places of so many seeds from one on."""
    return np.column_stack(
        [np.random.Generator(_stream(name).advance(first)).random(count) for name in names]
    )


def _stratified(name: str, count: int) -> FloatArray:
    """Return numbers of which one lies in each of so many parts, shape (count,)."""
    rng = np.random.Generator(_stream(name))
    return (rng.permutation(count) + rng.random(count)) / count


def _sobol_points(names: Sequence[str], first: int, count: int) -> FloatArray:
    """Return so many points of the Sobol sequence from one on, of which no coordinate is 0.

    Each parameter's coordinates are shifted digit by digit by a number of its own, which keeps how evenly
    the points lie: without it, seed 0 would draw the lowest value of everything.
    """
    from scipy.stats.qmc import Sobol  # SciPy's part that few studies need

    sequence, levels = Sobol(len(names), scramble=False, bits=_SOBOL_BITS), 2**_SOBOL_BITS
    if first:
        sequence.fast_forward(first)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # that they lie evenly where they are 2**n only
        digits = (sequence.random(count) * levels).astype(np.int64)
    shift = [np.random.Generator(_stream(name)).integers(levels) for name in names]
    points: FloatArray = (np.bitwise_xor(digits, shift) + 0.5) / levels
    return points
