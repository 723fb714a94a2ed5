"""A signal as one row of a figure draws it: its columns, and the range of its axis."""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median_low
from typing import NamedTuple

from ddpc_cosim import FloatArray
from ddpc_reports.figures.clock import SECONDS, Clock

DIGITS = 6
"""Significant digits of the samples in the page."""
_TIME_DIGITS = 10
"""Of times: a run may begin late in a year."""
LOWER, UPPER = "lower", "upper"
"""Columns of the edges between which an output is wanted."""
BAND = "-band"
"""What follows the name of a signal's data in that of the data of its band."""
_LEAST_OF_STEP, _USUAL_OF_STEP = 0.02, 0.1
"""Of the largest step: how far the axis of errors goes at least, and how far to show all that is settled."""

Column = list[float | None]


class Given(NamedTuple):
    """What is drawn of a signal besides the controllers' lines: limits that change, weather, prices.

    Parameters
    ----------
    columns : tuple of str
        Its columns: one, or several that look alike.
    label : str
        What it is; empty: it is not read out.
    colour : str
        As in the page.
    dashes : tuple of float
        Of its lines; empty: solid.
    width : float
        Of its lines [px].
    held : bool
        Values hold until the next sample.
    scales : bool
        Whether its values set the range of the axis.
    """

    columns: tuple[str, ...]
    label: str
    colour: str = "var(--ink)"
    dashes: tuple[float, ...] = ()
    width: float = 1.0
    held: bool = True
    scales: bool = True


@dataclass(frozen=True)
class Signal:
    """One output, input, or change of an input, for all controllers: what one row of a figure draws.

    Parameters
    ----------
    id : str
        Name of the data set in the page.
    title : str
        Signal and unit, for the axis.
    unit : str
        Unit symbol.
    columns : dict
        ``t`` (in the clock's unit), ``r`` (the reference, if there is one) or ``lower`` and ``upper`` (the
        edges of the band that is wanted), one column ``c<index>`` for each controller, and those of what is
        given.
    scaled_by : tuple of str
        Columns of controllers that set the range of the axis.
    limits : dict of float to str
        Limits that the samples reach, which the axis shows, and whose they are.
    far_limits, unreached_limits : tuple of float
        Limits that are reached only by runs that leave the picture, and those that no run reaches.
    held : bool
        Values hold until the next sample.
    own_range : bool
        Every panel has its own range; otherwise all panels share one, so that they compare.
    band : dict
        ``t`` [s] and, of each controller whose runs differ over the seeds, the median ``c<index>`` and the
        ends ``c<index>l`` and ``c<index>h``; empty without a band.
    settled : dict, optional
        Of errors: how large those outside the transients are, by column; it sets the range of the axis.
    step : float
        Of errors: the largest step of the reference.
    clock : Clock
        The unit of time.
    given : tuple of Given
        What is drawn besides the controllers' lines.
    reach : tuple of float
        Values of limits that change which the axis should show.
    """

    id: str
    title: str
    unit: str
    columns: dict[str, Column]
    scaled_by: tuple[str, ...]
    limits: dict[float, str] = field(default_factory=dict)
    far_limits: tuple[float, ...] = ()
    unreached_limits: tuple[float, ...] = ()
    held: bool = False
    own_range: bool = False
    band: dict[str, Column] = field(default_factory=dict)
    settled: dict[str, float] | None = None
    step: float = 0.0
    clock: Clock = SECONDS
    given: tuple[Given, ...] = ()
    reach: tuple[float, ...] = ()

    @property
    def has_reference(self) -> bool:
        """Whether there is a reference to draw."""
        return "r" in self.columns

    @property
    def has_band(self) -> bool:
        """Whether it is wanted within a band, which is drawn."""
        return LOWER in self.columns

    @property
    def wanted(self) -> tuple[str, ...]:
        """The columns of the reference, or of the band's edges."""
        return (LOWER, UPPER) if self.has_band else ("r",) if self.has_reference else ()

    @property
    def also_scaling(self) -> tuple[str, ...]:
        """The columns besides those of controllers that set the range of the axis."""
        return (*self.wanted, *(name for given in self.given if given.scales for name in given.columns))

    @property
    def end(self) -> tuple[float, float]:
        """First and last time, in the clock's unit."""
        times = [value for value in self.columns["t"] if value is not None]
        if not times:
            return (0.0, 1.0)
        return (times[0], times[-1]) if len(times) > 1 else (times[0] - 0.5, times[0] + 0.5)

    def scaling(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the columns that set the range of the axis of a panel with these controllers."""
        asked = names if self.own_range else [name for name in self.columns if name.startswith("c")]
        return tuple(name for name in asked if name in self.scaled_by) or tuple(asked)

    def extent(self, names: Sequence[str]) -> tuple[float, float]:
        """Return the range of the axis of a panel with these controllers, with a margin."""
        scaling = self.scaling(names)
        if self.settled is not None:
            return self._extent_of_errors([self.settled[name] for name in scaling if name in self.scaled_by])
        if self.is_fixed:
            return self._extent_of_reference(scaling)
        columns = [*scaling, *self.also_scaling]
        shown = [
            *self.limits,
            *self.reach,
            *(value for name in columns for value in known(self.columns[name])),
        ]
        shown += [value for name in scaling for end in "lh" for value in known(self.band.get(name + end, []))]
        low, high = min(shown, default=0.0), max(shown, default=1.0)
        room = 0.1 if self.limits or self.reach else 0.05  # their words stand outside
        margin = room * (high - low) or 0.1 * abs(high) or 1.0
        return (low - margin, high + margin)

    @property
    def is_fixed(self) -> bool:
        """Whether the range is not that of its values: of errors, and where none of the runs can set it."""
        return self.settled is not None or (bool(self.wanted) and not self.scaled_by)

    def _extent_of_errors(self, sizes: Sequence[float]) -> tuple[float, float]:
        """Show what is settled, but for those that are far worse: a hundredth of a step stays visible."""
        usual = max(_USUAL_OF_STEP * self.step, 1.5 * median_low(sizes or [0.0]))
        half = max(min(1.25 * max(sizes, default=self.step), usual), _LEAST_OF_STEP * self.step) or 1.0
        half = min(half, sys.float_info.max)
        return (-half, half)

    def _extent_of_reference(self, names: Sequence[str]) -> tuple[float, float]:
        """Show the reference, whence the runs begin, and as much again on both sides."""
        wanted = [
            *(value for name in self.wanted for value in known(self.columns[name])),
            *(value for name in names for value in known(self.columns[name])[:1]),
        ]
        low, high = min(wanted, default=0.0), max(wanted, default=1.0)
        reach = (high - low) or 1.0
        return (low - reach, high + reach)


def known(column: Sequence[float | None]) -> list[float]:
    """Return the values of a column that exist."""
    return [value for value in column if value is not None]


def times(time: FloatArray, clock: Clock) -> Column:
    """Return times [s], shape (K,), in a unit of time, as the page holds them."""
    return rounded(time / clock.seconds, _TIME_DIGITS)


def rounded(values: FloatArray, digits: int = DIGITS) -> Column:
    """Return values as the page holds them: so many digits, None for what is not finite."""
    return [float(f"{value:.{digits}g}") if math.isfinite(value) else None for value in values.tolist()]
