"""Dictionaries: the observables that lift a measured state, equation (5)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from ddpc_cosim import ConfigError, FloatArray, check_settings, setting

Lift = Callable[[FloatArray], FloatArray]
"""From states, shape (..., q), to observables, shape (..., n_p)."""


@runtime_checkable
class Dictionary(Protocol):
    """Observables to lift a state of any size with."""

    def functions(self, size: int) -> int:
        """Return the number of observables n_p for states of one size."""

    def draw(self, size: int, rng: np.random.Generator) -> Lift:
        """Return the observables for states of one size.

        Parameters
        ----------
        size : int
            Number of measured signals q.
        rng : numpy.random.Generator
            Where random parameters come from.
        """


@dataclass(frozen=True, kw_only=True)
class ThinPlate:
    """Thin-plate radial functions, equation (12): psi_i(x) = |x - c_i| log10 |x - c_i|.

    The centres c_i are drawn uniformly from a box, once per run.
    """

    count: int = setting(10, low=1, doc="number of functions, n_p")
    low: float = setting(0.0, doc="lower end of every coordinate of a centre")
    high: float = setting(1.0, doc="upper end of every coordinate of a centre")

    def __post_init__(self) -> None:
        check_settings(self)
        if self.low > self.high:
            raise ConfigError(f"ThinPlate: low = {self.low:g} is above high = {self.high:g}")

    def functions(self, size: int) -> int:
        """Return n_p: it does not depend on the state's size."""
        return self.count

    def draw(self, size: int, rng: np.random.Generator) -> Lift:
        """Draw the centres and return the functions; see :class:`Dictionary`."""
        return ThinPlateFunctions(rng.uniform(self.low, self.high, (self.count, size)))


@dataclass(frozen=True, eq=False)
class ThinPlateFunctions:
    """Thin-plate functions about given centres.

    Parameters
    ----------
    centres : array, shape (n_p, q)
        The centres c_i.
    power : int
        Of the distance in front of the logarithm: 1 as printed in (12).
    """

    centres: FloatArray
    power: int = 1

    def __call__(self, states: FloatArray) -> FloatArray:
        """Return psi_1 ... psi_np for states of shape (..., q)."""
        return thin_plate(states[..., np.newaxis, :] - self.centres, self.power)


def thin_plate(difference: FloatArray, power: int) -> FloatArray:
    """Return ``d**power * log10(d)`` for the lengths d of differences, shape (..., q); 0 where d = 0."""
    distance = np.sqrt(np.square(difference).sum(axis=-1))
    logarithm = np.log10(distance, out=np.zeros_like(distance), where=distance > 0.0)
    values: FloatArray = distance**power * logarithm
    return values
