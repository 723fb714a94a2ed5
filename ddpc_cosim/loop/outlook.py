"""What is wanted, allowed, paid and expected over time, and how much of it controllers see at a sample."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ddpc_cosim.controller import Bounds, Charge, Sample
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.durations import shown
from ddpc_cosim.signals.disturbances import Forecasts, KnownDisturbance
from ddpc_cosim.signals.prices import Price
from ddpc_cosim.signals.signals import Band, Reference, in_unit_of, values_at
from ddpc_cosim.variables import FloatArray, Variable

_AT_ONCE = 64
"""Samples whose forecasts are computed together."""
Limit = float | Reference
"""A limit, or its course."""
Wanted = Mapping[str, Reference | Band]
"""A reference or a band for each controlled output, by name."""


def table_widths(
    disturbances: Mapping[str, KnownDisturbance],
    wanted: Wanted,
    limits: Mapping[str, tuple[Limit, Limit]],
    prices: Mapping[str, Price],
    monitors: Mapping[str, Band | None],
    inputs: int,
    outputs: int,
    intersample: int,
) -> dict[str, int]:
    """Return how many columns the tables of a run have besides those of every run, by name."""
    bands = any(isinstance(signal, Band) for signal in wanted.values())
    moving = any(isinstance(limit, Reference) for pair in limits.values() for limit in pair)
    known = sum(disturbance.is_known for disturbance in disturbances.values())
    widths = {
        "d": known,
        "forecast": known * any(disturbance.has_forecast for disturbance in disturbances.values()),
        "band": 2 * outputs * bands,
        "input_limits": 2 * inputs * moving,
        "output_limits": 2 * outputs * moving,
        **dict.fromkeys(("price", "emission", "charged"), len(prices)),
        "monitored": len(monitors),
        "monitored_band": 2 * sum(band is not None for band in monitors.values()),
        "intersample": intersample,
    }
    return {name: width for name, width in widths.items() if width}


def intersample_signals(
    substeps: int,
    outputs: Sequence[str],
    prices: Mapping[str, Price],
    monitors: Mapping[str, Band | None],
    inputs: Collection[str],
) -> tuple[str, ...]:
    """Return which outputs are read between samples: those that are controlled, charged or monitored.

    None are where the plant is advanced in one step.
    """
    if substeps == 1:
        return ()
    charged = (price.signal for price in prices.values() if price.signal not in inputs)
    return tuple(dict.fromkeys((*outputs, *charged, *monitors)))


class Wish(NamedTuple):
    """What is wanted of the controlled outputs over N times.

    Parameters
    ----------
    reference : array, shape (N, p)
        References; of a band the middle.
    band : array, shape (N, p, 2)
        Lower and upper edges; both are the reference where that is a line.
    is_band : array of bool, shape (p,)
        Where it is a band.
    """

    reference: FloatArray
    band: FloatArray
    is_band: NDArray[np.bool_]

    @classmethod
    def over(cls, outputs: Sequence[Variable], wanted: Wanted, time: FloatArray) -> "Wish":
        """Return what is wanted of outputs at times [s], shape (N,).

        Raises
        ------
        ConfigError
            A signal has values that are not possible, a unit that does not fit, or a lower edge is above the
            upper one; all faults at once.
        """
        band, faults = np.empty((len(time), len(outputs), 2)), list[str]()
        for i, variable in enumerate(outputs):
            signal = wanted[variable.name]
            try:
                if isinstance(signal, Band):
                    what = f"band of {variable.name}"
                    for side, edge in enumerate(signal.edges(variable)):
                        band[:, i, side] = values_at(edge, what, time)
                    faults += _crossed(what, band[:, i], time)
                else:
                    what = f"reference of {variable.name}"
                    values = values_at(in_unit_of(variable, signal), what, time)
                    band[:, i] = values[:, np.newaxis]
            except ConfigError as error:
                faults += error.faults
        if faults:
            raise ConfigError(faults)
        is_band = np.array([isinstance(wanted[variable.name], Band) for variable in outputs], dtype=bool)
        reference = band[..., 0].copy()
        if is_band.any():
            reference[:, is_band] = band[:, is_band].mean(axis=-1)
        for table in (band, reference):
            table.setflags(write=False)  # controllers are handed views of it
        return cls(reference, band, is_band)


def _crossed(what: str, edges: FloatArray, time: FloatArray) -> list[str]:
    """Return where lower is above upper, edges being of shape (N, 2)."""
    wrong = np.flatnonzero(edges[:, 0] > edges[:, 1])
    if not wrong.size:
        return []
    k = wrong[0]
    values = f"lower {edges[k, 0]:g} is above upper {edges[k, 1]:g}"
    return [f"{what}: {values} at t = {shown(time[k])}; needed: lower <= upper at all times"]


class Limits(NamedTuple):
    """Limits of inputs and controlled outputs over N times.

    Parameters
    ----------
    table : array, shape (N, m + p, 2)
        Lower and upper limits of the inputs and then of the outputs; infinite where there is none.
    bounds : Bounds
        The outermost of them.
    moving : tuple of str
        The signals whose limits change with time, or may.
    """

    table: FloatArray
    bounds: Bounds
    moving: tuple[str, ...]

    @classmethod
    def over(
        cls,
        variables: Sequence[Variable],
        inputs: int,
        given: Mapping[str, tuple[Limit, Limit]],
        time: FloatArray,
    ) -> "Limits":
        """Return the limits of variables, the first so many of them inputs, at times [s], shape (N,).

        What is not given is the variable's own. Errors as of :meth:`Wish.over`.
        """
        table, faults = np.empty((len(time), len(variables), 2)), list[str]()
        moving = []
        for i, variable in enumerate(variables):
            pair = given.get(variable.name, (variable.min, variable.max))
            if any(isinstance(limit, Reference) for limit in pair):
                moving.append(variable.name)
            try:
                for side, limit in enumerate(pair):
                    if isinstance(limit, Reference):
                        what = f"bounds of {variable.name}"
                        table[:, i, side] = values_at(in_unit_of(variable, limit), what, time)
                    else:
                        table[:, i, side] = limit
            except ConfigError as error:
                faults += error.faults
                continue
            if variable.name in moving:
                faults += _crossed(f"bounds of {variable.name}", table[:, i], time)
        if faults:
            raise ConfigError(faults)
        table.setflags(write=False)
        low, high = table[0, :, 0].copy(), table[0, :, 1].copy()
        if moving:
            low, high = table[..., 0].min(axis=0), table[..., 1].max(axis=0)
        for array in (low, high):
            array.setflags(write=False)  # the master clips at what controllers are shown
        return cls(table, Bounds(low[:inputs], high[:inputs], low[inputs:], high[inputs:]), tuple(moving))


class Expected:
    """What is expected of the disturbances in a run; see :class:`Outlook`.

    Parameters
    ----------
    forecasts : sequence of Forecasts or None
        Of each disturbance; None: what is measured is held.
    lags : sequence of int
        By how many samples each is measured late.
    truth : array, shape (B + N, n_d)
        What each was at the samples of a warm-up, and what it will be, NaN where that is not known.
    before : int
        B, the number of these samples before the first one of the run.
    samples : int
        K, those of the run.
    """

    def __init__(
        self,
        forecasts: Sequence[Forecasts | None],
        lags: Sequence[int],
        truth: FloatArray,
        before: int,
        samples: int,
    ) -> None:
        self._forecasts, self._truth, self._before, self._samples = forecasts, truth, before, samples
        self._held = [i for i, one in enumerate(forecasts) if one is None]
        self._late = [(i, lag) for i, lag in enumerate(lags) if lag and i not in self._held]
        self._first, self._foretold = 0, np.empty((0, 0, 0))

    def after(self, k: int, samples: int, measured: FloatArray) -> FloatArray:
        """Return what is expected to be measured at the samples after k, shape (samples, n_d), to be read."""
        row = k - self._first
        if not (0 <= row < len(self._foretold) and samples == self._foretold.shape[1]):
            self._first, self._foretold, row = k, self._from_sample(k, samples), 0
        foretold: FloatArray = self._foretold[row]
        if not (self._held or self._late):
            return foretold
        expected = foretold.copy()
        for i in self._held:
            expected[:, i] = measured[i]
        for i, lag in self._late:
            late, first = min(lag, samples), self._before + k + 1 - lag
            passed = self._truth[max(first, 0) : max(first + late, 0), i]
            expected[:late, i] = measured[i]
            if passed.size and np.isfinite(passed).all():
                expected[late - len(passed) : late, i] = passed
            expected[late:, i] = foretold[: samples - late, i]
        expected.setflags(write=False)
        return expected

    def _from_sample(self, k: int, samples: int) -> FloatArray:
        """Return what is foretold from k on, at some samples together, which costs less than one by one."""
        count = min(_AT_ONCE, self._samples - k)
        foretold = np.empty((count, samples, len(self._forecasts)))
        for i, forecasts in enumerate(self._forecasts):
            if forecasts is not None:
                foretold[:, :, i] = forecasts.from_sample(k, count, samples)
        foretold.setflags(write=False)  # controllers are handed views of it
        return foretold


def _narrowest(lower: FloatArray, upper: FloatArray, samples: int) -> list[list[list[float]]]:
    """Return what is within all bands of so many samples, by the first of them and output."""
    if len(lower) < samples:
        return []
    ends = (
        sliding_window_view(lower, samples, axis=0).max(axis=-1),
        sliding_window_view(upper, samples, axis=0).min(axis=-1),
    )
    within: list[list[list[float]]] = np.stack(ends, axis=-1).tolist()
    return within


class Outlook:
    """What controllers may look at from each sample of a run on.

    Parameters
    ----------
    wish : Wish
        Over the K samples and as many after them as the loop's preview.
    limits : Limits
        Over the same.
    charges : tuple of Charge
        What is paid for.
    price : array, shape (K + horizon, n_prices)
        Over the samples and the horizon after them.
    expected : Expected
        Of the disturbances.
    horizon, preview : int
        How many samples the controller wants to see, and how many of the references it does.

    Attributes
    ----------
    horizon : int
        As given.
    has_bands : bool
        Whether an output is wanted within a band.
    """

    def __init__(
        self,
        wish: Wish,
        limits: Limits,
        charges: tuple[Charge, ...],
        price: FloatArray,
        expected: Expected,
        horizon: int,
        preview: int,
    ) -> None:
        self.wish, self.limits, self.charges, self.price = wish, limits, charges, price
        self.horizon, self._sees_all = horizon, preview >= horizon
        self._known = np.minimum(np.arange(horizon + 1), preview)
        self._expected = expected
        self.has_bands = bool(wish.is_band.any())
        # What is read at every sample lies in one piece of memory each.
        edges = wish.band if self.has_bands else wish.band[:0]
        self._lower, self._upper = edges[..., 0].copy(), edges[..., 1].copy()
        self._within = _narrowest(self._lower, self._upper, 1 + min(horizon, preview))
        inputs = len(limits.bounds.u_min)
        self._input_limits, self._output_limits = limits.table[:, :inputs], limits.table[:, inputs:]
        if limits.moving:
            self._input_limits, self._output_limits = self._input_limits.copy(), self._output_limits.copy()
        self._inputs_move = bool(limits.moving and (self._input_limits != self._input_limits[0]).any())
        at_first = slice(0, 1 + horizon) if self._sees_all else self._known
        self._fixed_limits = None if limits.moving else self._limits(at_first)
        secret = np.array([not charge.known for charge in charges], dtype=bool)
        self._secret = secret if secret.any() else None
        self._no_forecast, self._no_price = np.empty((horizon, 0)), np.empty((horizon + 1, 0))
        for table in (price, self._input_limits, self._output_limits, self._no_forecast, self._no_price):
            table.setflags(write=False)

    def input_limits(self, k: int) -> tuple[FloatArray, FloatArray]:
        """Return the lower and upper limits of the inputs at sample k, both of shape (m,)."""
        if not self._inputs_move:
            return self.limits.bounds.u_min, self.limits.bounds.u_max
        now = self._input_limits[k]
        return now[:, 0], now[:, 1]

    def _ahead(self, k: int, rows: Any, y: FloatArray) -> FloatArray:
        """Return the nearest points in rows from k on: y itself where it is within all bands there.

        That it mostly is, and it is seen in less time than NumPy takes.
        """
        for value, (lower, upper) in zip(y.tolist(), self._within[k], strict=True):
            if not lower <= value <= upper:
                return self.nearest(rows, y)
        reference: FloatArray = np.empty((self.horizon + 1, len(y)))
        reference[:] = y
        return reference

    def nearest(self, rows: Any, y: FloatArray) -> FloatArray:
        """Return the reference at a sample or in rows, of a band its point nearest to the outputs y.

        Without a finite output it is the middle of the band.
        """
        if not math.isfinite(sum(y.tolist())):
            y = np.where(np.isfinite(y), y, self.wish.reference[rows])
        # A line is a band whose edges are the same.
        nearest: FloatArray = np.minimum(np.maximum(y, self._lower[rows]), self._upper[rows])
        return nearest

    def sample(
        self, k: int, time: float, y: FloatArray, measured: FloatArray, disturbance: FloatArray
    ) -> Sample:
        """Return what a controller sees at sample k of outputs, measurements and disturbances as measured."""
        rows: Any = slice(k, k + 1 + self.horizon) if self._sees_all else k + self._known
        band = self.wish.band[rows]
        reference = self._ahead(k, rows, y) if self.has_bands else self.wish.reference[rows]
        input_limits, output_limits = self._fixed_limits or self._limits(rows)
        forecast = self._no_forecast
        if disturbance.size:
            forecast = self._expected.after(k, self.horizon, disturbance)
        if self.has_bands:
            reference.setflags(write=False)
        if not self._sees_all:
            for array in (band, reference):
                array.setflags(write=False)
        return Sample(
            k,
            time,
            y,
            measured,
            reference[1:],
            reference[0],
            disturbance,
            forecast,
            band[0],
            band[1:],
            self._price(k) if self.charges else self._no_price,
            input_limits,
            output_limits,
        )

    def _limits(self, rows: Any) -> tuple[FloatArray, FloatArray]:
        """Return the limits of inputs in so many rows, and of outputs in all but the first."""
        inputs, outputs = self._input_limits[rows], self._output_limits[rows]
        if not self._sees_all:
            for array in (inputs, outputs):
                array.setflags(write=False)
        return inputs, outputs[1:]

    def _price(self, k: int) -> FloatArray:
        """Return the prices that are known at sample k, shape (horizon + 1, n_prices)."""
        price = self.price[k : k + 1 + self.horizon]
        if self._secret is not None:
            price = np.where(self._secret, price[0], price)
            price.setflags(write=False)
        return price
