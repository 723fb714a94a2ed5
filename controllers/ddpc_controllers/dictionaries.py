"""Dictionaries: the observables that lift a measured state, equation (5)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from ddpc_cosim import FloatArray, check_settings, setting

Lift = Callable[[FloatArray], FloatArray]
"""From states, shape (..., q), to observables, shape (..., n_p)."""


@runtime_checkable
class Dictionary(Protocol):
    """Observables to lift a state of any size with."""

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

    def draw(self, size: int, rng: np.random.Generator) -> Lift:
        """Draw the centres and return the functions; see :class:`Dictionary`."""
        centres = rng.uniform(self.low, self.high, (self.count, size))

        def lift(states: FloatArray) -> FloatArray:
            return thin_plate(np.linalg.norm(states[..., np.newaxis, :] - centres, axis=-1))

        return lift


def thin_plate(distance: FloatArray, power: int = 1) -> FloatArray:
    """Return ``distance**power * log10(distance)``, continued by its limit 0 at distance 0.

    Parameters
    ----------
    distance : array
        Distances from a centre.
    power : int
        1 as printed in (12).
    """
    logarithm = np.log10(distance, out=np.zeros_like(distance), where=distance > 0.0)
    return distance**power * logarithm
