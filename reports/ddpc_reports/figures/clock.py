"""The unit of a time axis: that which suits the length of a run."""

from typing import NamedTuple

from ddpc_reports.numbers import as_given, computed, with_unit

_FAR = 100
"""Units from the beginning of time on from which the next larger unit is chosen, if the run has one of it."""


class Clock(NamedTuple):
    """A unit of time.

    Parameters
    ----------
    unit : str
        Its symbol.
    seconds : float
        What it has of them.
    longest : float
        Of a run for which it is chosen [s].
    ticks : tuple of float
        The steps that suit its axis, rising; none: decimal ones.
    """

    unit: str = "s"
    seconds: float = 1.0
    longest: float = 600.0
    ticks: tuple[float, ...] = ()

    def of(self, seconds: float) -> float:
        """Return a time [s] in this unit."""
        return computed(seconds / self.seconds)

    def words(self, seconds: float) -> str:
        """Write a time [s] in this unit."""
        return with_unit(as_given(self.of(seconds)), self.unit)


SECONDS = Clock()
_CLOCKS = (
    SECONDS,
    Clock("min", 60.0, 5400.0),
    Clock("h", 3600.0, 2 * 86400.0, (0.1, 0.25, 0.5, 1, 2, 3, 6, 12)),
    Clock("d", 86400.0, float("inf"), (0.01, 0.05, 0.125, 0.25, 0.5, 1, 2, 5, 10, 20, 50, 100, 200)),
)


def clock_for(start: float, length: float) -> Clock:
    """Return the unit that suits a run of a length that begins at a time [s]."""
    place = next(i for i, clock in enumerate(_CLOCKS) if length <= clock.longest)
    coarser = _CLOCKS[min(place + 1, len(_CLOCKS) - 1)]
    is_far = abs(start) > _FAR * _CLOCKS[place].seconds and length >= coarser.seconds
    return coarser if is_far else _CLOCKS[place]
