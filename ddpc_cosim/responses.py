"""What metrics are computed from: responses of outputs and inputs, what is paid for, step times.

The *held* samples are those whose inputs acted on the plant: the last sample of a completed run, at which the
run ends, is left out.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.controller import Charge
from ddpc_cosim.variables import FloatArray, Variable
from fmu_plants.units import display_unit

_SETTLED_FRACTION = 0.2
_SETTLING_BAND = 0.05
_RISEN = 0.9
_FEWEST_SAMPLES = 5
_CONSTANT_ROWS = 3
"""Fewest rows of a stretch of constant reference; shorter ones belong to a moving reference."""
_SMALLEST_FIRST_STEP = 0.01
_SMALLEST_LONE_STEP = 0.001
_AT_REST = 1e-4
"""Of its largest magnitude: an output that moves by less is at rest, as operating points are rounded."""
_FEWEST_FORETOLD = 10
"""Fewest samples from which it can be told what follows from the two samples before."""
_QUARTER_HOUR, _HOUR = 900.0, 3600.0  # s
_TRIMMED = 0.05
_OF_TRIMMED = 1.148
"""From the standard deviation of Gaussian noise without its largest 5 % to that with it."""


Limits = tuple[float, float] | tuple[FloatArray, FloatArray]
"""Lower and upper limit of a signal; arrays of shape (K,) where they change with time."""


@dataclass(frozen=True)
class SampledSignal:
    """A signal over the held samples.

    Parameters
    ----------
    variable : Variable
        The controlled output or the input.
    values : array, shape (K,)
        Its values, in its unit.
    limits : tuple of float or array, shape (K,)
        Its bounds in the run, in its unit; arrays where they change with time.
    sampling_time : float
        Time between samples [s].
    """

    variable: Variable
    values: FloatArray
    limits: Limits
    sampling_time: float


@dataclass(frozen=True)
class Response(SampledSignal):
    """A controlled output over the held samples, and its reference, shape (K,).

    ``preview`` is that of :class:`ddpc_cosim.MetricSettings`, ``ahead`` how much of that the run's own
    controller saw. ``disturbed``, shape (K,), says at which samples a declared disturbance has moved.
    """

    reference: FloatArray
    preview: int
    ahead: int
    disturbed: NDArray[np.bool_] | None = None

    @cached_property
    def difference(self) -> FloatArray:
        """Reference minus output, in its unit."""
        return self.reference - self.values

    @cached_property
    def distance(self) -> FloatArray:
        """The difference without its sign."""
        return np.abs(self.difference)

    @cached_property
    def error(self) -> FloatArray:
        """Reference minus output, in the display unit."""
        return self.difference * self.variable.shown_in.factor

    @cached_property
    def magnitude(self) -> FloatArray:
        """The error without its sign."""
        return np.abs(self.error)

    @cached_property
    def total(self) -> float:
        """The sum of the errors without their signs; NaN without samples."""
        return _total(self.magnitude)

    @cached_property
    def beyond(self) -> FloatArray:
        """How far the output lies beyond its limits, in the display unit; zero within them."""
        excess = np.maximum(self.values - self.limits[1], self.limits[0] - self.values)
        return np.maximum(excess, 0.0) * abs(self.variable.shown_in.factor)

    @cached_property
    def stretches(self) -> list["Stretch"]:
        """The stretches of constant reference whose windows are long enough."""
        edges = [0, *(self._moves.nonzero()[0] + 1).tolist(), len(self.reference)]
        rows = [end - first for first, end in pairwise(edges)]
        return [
            Stretch(self, first, end - self.preview, self._value_before(first, rows[n - 1] if n else 0))
            for n, (first, end) in enumerate(pairwise(edges))
            if end - first >= _CONSTANT_ROWS and end - self.preview - first >= _FEWEST_SAMPLES
        ]

    @cached_property
    def steps(self) -> list["Stretch"]:
        """The stretches that begin with a step."""
        return [stretch for stretch in self.stretches if not math.isnan(stretch.before)]

    @property
    def _moves(self) -> NDArray[np.bool_]:
        """Whether the reference changes from row to row, by more than a rounding error."""
        r = self.reference
        smallest = 1e-9 * (self._highest - self._lowest) + 1e-12 * self._farthest if r.size else 0.0
        return np.abs(r[1:] - r[:-1]) > smallest

    @cached_property
    def _lowest(self) -> float:
        """The smallest value of the reference."""
        return float(np.minimum.reduce(self.reference))

    @cached_property
    def _highest(self) -> float:
        """The largest one."""
        return float(np.maximum.reduce(self.reference))

    @property
    def _farthest(self) -> float:
        """The largest magnitude."""
        return max(abs(self._lowest), abs(self._highest))

    @property
    def _first_step(self) -> float:
        return float(self.reference[0] - self.values[0])

    def _value_before(self, first: int, rows_before: int) -> float:
        """Return from which value the reference steps at a row, NaN if it does not: it may have moved."""
        if first > 0:
            return float(self.reference[first - 1]) if rows_before >= _CONSTANT_ROWS else math.nan
        smallest = _SMALLEST_FIRST_STEP * (self._highest - self._lowest)
        if smallest == 0.0:
            smallest = _SMALLEST_LONE_STEP * max(abs(float(self.reference[0])), self.variable.nominal)
        return float(self.values[0]) if abs(self._first_step) >= smallest else math.nan

    @property
    def tracking(self) -> "Tracking":
        """What the run is judged by, as far as this output says."""
        y = self.values
        if not len(y):
            return Tracking(self.variable.name, math.nan, math.inf, self.variable.nominal, 0.0, 0.0, math.nan)
        lowest, highest = float(np.minimum.reduce(y)), float(np.maximum.reduce(y))
        at_rest = _AT_REST * max(self._farthest, -lowest, highest)
        deviation = self._deviation(lowest, highest)
        return Tracking(
            output=self.variable.name,
            travel=self._travel(at_rest),
            room=_mean(self.limits[1] - self.limits[0]),
            nominal=max(self.variable.nominal, self._farthest),
            deviation=deviation if deviation > at_rest else 0.0,
            scatter=_scatter(y, highest - lowest),
            mean_abs_error=_mean(self.distance),
            factor=abs(self.variable.shown_in.factor),
            ends=tuple(self._ends) or (self._end(self._last_fifth),),
            width=self._width,
            is_disturbed=self.disturbed is not None,
        )

    def _travel(self, at_rest: float) -> float:
        """Return how far the reference moves, where the output begins included."""
        first = float(self.values[0])
        travel = max(self._highest, first) - min(self._lowest, first)
        return travel if self._highest > self._lowest or travel > at_rest else 0.0

    def _deviation(self, lowest: float, highest: float) -> float:
        """Return how far the output, between its lowest and its highest value, goes from where it begins."""
        first = float(self.values[0])
        return max(highest - first, first - lowest)

    @property
    def _width(self) -> float | None:
        return None

    @property
    def _ends(self) -> list["EndWindow"]:
        """The ends of the stretches of constant reference; a step is what it does, not how a run begins."""
        return [
            self._end(
                stretch.last_fifth,
                abs(stretch.size) if stretch.first > 0 and not math.isnan(stretch.before) else 0.0,
                settling=not self.steps or not math.isnan(stretch.before),
            )
            for stretch in self.stretches
        ]

    @property
    def _last_fifth(self) -> slice:
        rows = len(self.values)
        return slice(rows - max(round(_SETTLED_FRACTION * rows), 1), rows)

    def _end(self, rows: slice, step: float = 0.0, *, settling: bool = False) -> "EndWindow":
        moves = self.disturbed is not None and bool(self.disturbed[rows].any())
        mean = abs(_mean(self.difference[rows]))
        return EndWindow(rows.stop - rows.start, mean, _mean(self.distance[rows]), step, settling, moves)


@dataclass(frozen=True)
class BandResponse(Response):
    """A controlled output that is wanted within a band.

    Its reference is the point of the band nearest to the output, so that errors are distances to the band.
    It has no steps, and no figures of the step response.

    Parameters
    ----------
    band : array, shape (K, 2)
        Lower and upper edge, in the output's unit.
    """

    band: FloatArray = field(kw_only=True)

    @property
    def _moves(self) -> NDArray[np.bool_]:
        smallest = 1e-9 * np.ptp(self.band) + 1e-12 * np.abs(self.band).max() if self.band.size else 0.0
        moves: NDArray[np.bool_] = np.any(np.abs(np.diff(self.band, axis=0)) > smallest, axis=1)
        return moves

    def _value_before(self, first: int, rows_before: int) -> float:
        return math.nan

    def _travel(self, at_rest: float) -> float:
        """Return how far the band makes the output move at least, from where it begins on."""
        highest = float(max(self.band[:, 0].max(), self.values[0]))
        travel = highest - float(min(self.band[:, 1].min(), self.values[0]))
        return travel if travel > at_rest else 0.0

    def _deviation(self, lowest: float, highest: float) -> float:
        return float(self.distance.max())

    @property
    def _width(self) -> float | None:
        return _mean(self.band[:, 1] - self.band[:, 0])

    @property
    def _ends(self) -> list["EndWindow"]:
        """The ends of the stretches of constant edges."""
        return [
            self._end(stretch.last_fifth, self._size(stretch.first), settling=True)
            for stretch in self.stretches
        ]

    def _size(self, first: int) -> float:
        """Return the width of the band at a row, or its distance to the band before, the larger."""
        (lower, upper), (lower_before, upper_before) = self.band[first], self.band[max(first - 1, 0)]
        return float(max(upper - lower, lower - upper_before, lower_before - upper))

    def _end(self, rows: slice, step: float = 0.0, *, settling: bool = False) -> "EndWindow":
        mean = _mean(self.distance[rows])
        return EndWindow(rows.stop - rows.start, mean, mean, step, settling)


def _scatter(y: FloatArray, size: float) -> float:
    """Return the standard deviation of what two samples do not tell of the next.

    Of a signal, shape (K,), and its largest less its smallest value.
    """
    if len(y) < _FEWEST_FORETOLD or not 0.0 < size < math.inf:
        return 0.0
    x = (y - y[0]) / size
    before = np.empty((len(x) - 2, 3))
    before[:, 0], before[:, 1], before[:, 2] = x[1:-1], x[:-2], 1.0
    missed = np.abs(x[2:] - before @ np.linalg.lstsq(before, x[2:])[0])
    missed.sort()
    # Steps of a reference or of a disturbance are among the largest: they do not scatter.
    kept = missed[: len(missed) - math.ceil(_TRIMMED * len(missed))]
    return size * _OF_TRIMMED * math.sqrt(float(kept @ kept) / (len(kept) - before.shape[1]))


@dataclass(frozen=True, slots=True)
class EndWindow:
    """The last fifth of a stretch of constant reference, or of a run whose reference has none.

    Parameters
    ----------
    rows : int
        Its samples.
    error, magnitude : float
        Magnitude of the mean error, and mean of the error's magnitude, in the output's unit.
    step : float
        By how much the reference stepped to this stretch, in the output's unit; 0 where it did not. Of a
        band its width, or its distance to the one before where that is larger.
    settling : bool
        Whether what is left there decides if the run settles: the reference steps to it, or is constant and
        steps nowhere.
    disturbed : bool
        Whether a declared disturbance moves there: then there is nothing to settle to.
    """

    rows: int
    error: float
    magnitude: float
    step: float = 0.0
    settling: bool = False
    disturbed: bool = False


@dataclass(frozen=True, slots=True)
class Tracking:
    """What one controlled output says of a run, in its own unit: what the run is judged by.

    Parameters
    ----------
    output : str
        Its name.
    travel : float
        How far the reference moves, where the output begins included: the largest less the smallest value.
        Of a band, how far the output has to move for it.
    room : float
        Width of its limits; infinite without.
    nominal : float
        Its nominal value, or the largest magnitude of its reference where that is larger.
    deviation : float
        How far it goes from where it begins, or gets from its band; 0 where that is less than 0.01 % of its
        largest magnitude.
    scatter : float
        Standard deviation of what cannot be told from the two samples before: of the residuals of a linear
        prediction from them, without the largest 5 %, which are steps. It is that of the noise that acts on
        the output, whoever controls it: feedback cannot change what cannot be told ahead.
    mean_abs_error : float
        Over all samples.
    factor : float
        What a difference is multiplied by where it is shown in the display unit.
    ends : tuple of EndWindow
        The ends of the stretches of constant reference; that of the run where there is none.
    width : float, optional
        Mean width of its band; None where it has a reference.
    is_disturbed : bool
        Whether the problem declares disturbances.
    """

    output: str
    travel: float
    room: float
    nominal: float
    deviation: float
    scatter: float
    mean_abs_error: float
    factor: float = 1.0
    ends: tuple[EndWindow, ...] = ()
    width: float | None = None
    is_disturbed: bool = False

    @property
    def is_regulation(self) -> bool:
        """Whether the reference is constant."""
        return all(end.settling and not end.step for end in self.ends)

    def written(self) -> dict[str, Any]:
        """Return what :meth:`read` reads: what only bands and declared disturbances have, where they are."""
        table = {key: getattr(self, key) for key in self.__slots__}
        for key in ("width", "is_disturbed"):
            if table[key] is None or table[key] is False:
                del table[key]
        table["ends"] = [
            {key: value for key in end.__slots__ if (value := getattr(end, key)) or key != "disturbed"}
            for end in self.ends
        ]
        return table

    @classmethod
    def read(cls, table: dict[str, Any]) -> Self:
        """Return what a file of a case says; KeyError, TypeError or ValueError if it says none of it."""
        numbers = {key: float(table[key]) for key in _NUMBERS}
        ends = tuple(
            EndWindow(
                int(end["rows"]),
                float(end["error"]),
                float(end["magnitude"]),
                float(end["step"]),
                bool(end["settling"]),
                bool(end.get("disturbed", False)),
            )
            for end in table["ends"]
        )
        width = float(table["width"]) if "width" in table else None
        is_disturbed = bool(table.get("is_disturbed", False))
        output = str(table["output"])
        return cls(output=output, ends=ends, width=width, is_disturbed=is_disturbed, **numbers)


_NUMBERS = ("travel", "room", "nominal", "deviation", "scatter", "mean_abs_error", "factor")


@dataclass(frozen=True)
class Stretch:
    """A stretch of constant reference: its first row, and the end of its window.

    ``before`` is the value from which the reference stepped there; NaN if it did not.
    """

    response: Response
    first: int
    end: int
    before: float

    @property
    def size(self) -> float:
        """By how much the reference stepped, in the output's unit."""
        return float(self.response.reference[self.first]) - self.before

    @property
    def last_fifth(self) -> slice:
        """The last fifth of the window."""
        return slice(self.end - round(_SETTLED_FRACTION * (self.end - self.first)), self.end)

    @cached_property
    def settled_error(self) -> float:
        """Magnitude of the mean error over the last fifth of the window, in the output's unit."""
        return abs(_mean(self.response.difference[self.last_fifth]))

    @property
    def overshoot(self) -> float:
        """How far the output goes beyond the new value, as a fraction of the step."""
        return max(float(np.maximum.reduce(self._after)) - 1.0, 0.0)

    @property
    def rise_samples(self) -> float:
        """Samples from the step until the output is first at 90 % of it, as those of the settling time."""
        there = (self._after >= _RISEN).nonzero()[0]
        return float(there[0]) if there.size else math.nan

    @property
    def settling_samples(self) -> float:
        """Samples from the step until the output is within 5 % of it for the rest of the window."""
        outside = (np.abs(self._after - 1.0) > _SETTLING_BAND).nonzero()[0]
        after = int(outside[-1]) + 1 if outside.size else 0
        return float(after) if after < self.end - self.first else math.nan

    @property
    def anticipation_samples(self) -> float:
        """Samples by which the output left 5 % of the step before it; NaN if it had not come to rest."""
        if self.first == 0:
            return math.nan
        # An output that leaves before its controller knew of the step drifts.
        start = max(self.first - max(self.response.ahead, 1), 0)
        at_rest = (np.abs(self._path(start, self.first + 1)) <= _SETTLING_BAND).nonzero()[0]
        if not at_rest.size or at_rest[0] > 0:
            return math.nan
        return float(max(self.first - start - int(at_rest[-1]) - 1, 0))

    @cached_property
    def _after(self) -> FloatArray:
        """The path from the step on."""
        return self._path(self.first, self.end)

    def _path(self, start: int, end: int) -> FloatArray:
        """Return the output at some samples as a fraction of the step: 0 before it, 1 after it."""
        return (self.response.values[start:end] - self.before) / self.size


@dataclass(frozen=True)
class Actuation(SampledSignal):
    """An input over the held samples."""

    @property
    def magnitude(self) -> FloatArray:
        """The input without its sign, in the display unit."""
        return np.abs(self.variable.shown_in.from_unit(self.values))

    @property
    def rest(self) -> float:
        """Its value at rest, as far as the limits of the first sample allow, in its unit."""
        lower, upper = (limit if isinstance(limit, float) else float(limit[0]) for limit in self.limits)
        return min(max(self.variable.start, lower), upper)

    @cached_property
    def moves(self) -> FloatArray:
        """The change at every sample, the first one from rest, in its unit."""
        before = np.empty_like(self.values)
        before[:1], before[1:] = self.rest, self.values[:-1]
        return self.values - before

    @cached_property
    def change(self) -> FloatArray:
        """Magnitude of the change at every sample, the first one from rest, in the display unit."""
        return np.abs(self.moves) * abs(self.variable.shown_in.factor)

    @property
    def at_limit(self) -> NDArray[np.bool_]:
        """Whether the input is at one of its limits, at every sample."""
        span = self.limits[1] - self.limits[0]
        tolerance = np.where(np.isfinite(span), 1e-9 * span, 0.0)
        return (self.values >= self.limits[1] - tolerance) | (self.values <= self.limits[0] + tolerance)


@dataclass(frozen=True)
class Charged:
    """What is paid for in a run, over the sampling intervals that its inputs were held for.

    Parameters
    ----------
    money : str
        What is paid with.
    amounts : array, shape (K, n)
        What is paid for in each interval, a column per price.
    price, emission : array, shape (K, n)
        Money, and kg emitted, per amount, in each interval.
    energy : array, shape (n,)
        kWh per amount; NaN of an amount that is not an energy, or the same one as of a price before it.
    sampling_time : float
        Length of an interval [s].
    """

    money: str
    amounts: FloatArray
    price: FloatArray
    emission: FloatArray
    energy: FloatArray
    sampling_time: float

    @classmethod
    def of(
        cls,
        charges: Sequence[Charge],
        charged: FloatArray,
        held: Collection[str],
        price: FloatArray,
        emission: FloatArray,
        sampling_time: float,
    ) -> Self:
        """Integrate signals over the intervals of a run.

        A signal that is held, as an input is, is a constant in each; of others it is a straight line from
        sample to sample, and a constant in an interval that a fault has ended.

        Parameters
        ----------
        charges : sequence of Charge
            What the n columns are.
        charged : array, shape (K or K + 1, n)
            The signals at the samples, that at the end of the last interval included where there is one.
        held : collection of str
            The signals that are held.
        price, emission : array, shape (K, n)
            As of this class.
        sampling_time : float
            Length of an interval [s].
        """
        rows = len(price)
        ends = np.vstack([charged, charged[-1:]])[1 : rows + 1]
        mean = (charged[:rows] + ends) / 2.0
        is_held = [charge.signal in held for charge in charges]
        mean[:, is_held] = charged[:rows, is_held]
        rates = np.array([charge.rate for charge in charges])
        energy = np.array([_in_kwh(charge.amount) for charge in charges])
        used = [(charge.signal, f"{rate:.9g}") for charge, rate in zip(charges, rates * energy, strict=True)]
        # A tariff and a tax on the same energy are both paid, and it is used once.
        energy[[i for i, energy_of in enumerate(used) if energy_of in used[:i]]] = np.nan
        money = " + ".join(dict.fromkeys(charge.unit for charge in charges))
        return cls(money, mean * rates * sampling_time, price, emission, energy, sampling_time)

    @property
    def _energies(self) -> FloatArray:
        """Return the sum of the amounts that are energies, in each interval [kWh], shape (K,)."""
        is_energy = np.isfinite(self.energy)
        return self.amounts[:, is_energy] @ self.energy[is_energy]

    @property
    def has_energy(self) -> bool:
        """Whether an amount is an energy."""
        return bool(np.isfinite(self.energy).any())

    @property
    def has_emissions(self) -> bool:
        """Whether anything is emitted per amount."""
        return bool(self.emission.any())

    def total(self, per_amount: FloatArray) -> float:
        """Return the sum over all intervals of something per amount, such as ``price``, shape (K, n)."""
        return _total((self.amounts * per_amount).ravel())

    def total_energy(self) -> float:
        """Return the amounts that are energies, together [kWh]."""
        return _total(self._energies)

    def peak(self) -> float:
        """Return the largest mean power of all energies over 15 minutes [kW].

        The quarters of an hour follow each other from the run's start; one that the run does not complete is
        left out, and of a shorter run it is the mean. Power is constant in each sampling interval, also where
        that is longer than a quarter of an hour.
        """
        return largest_quarter_hour(self._energies, self.sampling_time) * _HOUR


def largest_quarter_hour(amounts: FloatArray, sampling_time: float) -> float:
    """Return the largest mean per second over 15 minutes of what comes in each sampling interval, shape (K,).

    Quarters of an hour are counted as of :meth:`Charged.peak`; NaN without an interval.
    """
    if not len(amounts):
        return math.nan
    times = sampling_time * np.arange(len(amounts) + 1)
    quarters = math.floor(times[-1] / _QUARTER_HOUR * (1.0 + 1e-12))
    edges = _QUARTER_HOUR * np.arange(quarters + 1) if quarters else times[[0, -1]]
    come = np.interp(edges, times, np.append(0.0, np.cumsum(amounts)))
    return float((np.diff(come) / np.diff(edges)).max())


def _in_kwh(amount: str) -> float:
    """Return how many kWh a unit is; NaN if it is not one of energy."""
    try:
        return display_unit(amount, "kWh").factor
    except ValueError:
        return math.nan


@dataclass(frozen=True)
class StepTimes:
    """The controller's steps: times [s], shape (K,), NaN without a step; fallbacks; rows of the trace.

    ``has_key_figures``: whether the study asks for those of buildings, of which one is of these times.
    """

    solve_time: FloatArray
    sampling_time: float
    fallbacks: int
    rows: int
    has_key_figures: bool = False

    @cached_property
    def times(self) -> FloatArray:
        """The times of the steps that were taken [s]."""
        return self.solve_time[np.isfinite(self.solve_time)]

    @property
    def misses(self) -> float:
        """How many took longer than the sampling time; NaN where none was timed."""
        if self.rows and not self.times.size:
            return math.nan
        return float(np.count_nonzero(self.times > self.sampling_time))


@dataclass(frozen=True)
class WholeRun:
    """All controlled outputs and inputs of a run over the held samples, and the weights of its cost."""

    responses: Sequence[Response]
    actuations: Sequence[Actuation]
    weights: Mapping[str, Mapping[str, float]]

    def cost(self) -> float:
        """Return the sum over the samples of all weighted squares, each in the unit of its signal."""
        squares = {
            "outputs": {y.variable.name: (y.reference - y.values) ** 2 for y in self.responses},
            "inputs": {u.variable.name: (u.values - u.rest) ** 2 for u in self.actuations},
            "changes": {u.variable.name: u.moves**2 for u in self.actuations},
        }
        return sum(
            weight * _total(squares[kind][name])
            for kind, weights in self.weights.items()
            for name, weight in weights.items()
        )


def _total(values: FloatArray) -> float:
    return float(values.sum()) if values.size else math.nan


def _mean(values: FloatArray | float) -> float:
    return values if isinstance(values, float) else float(np.add.reduce(values) / len(values))
