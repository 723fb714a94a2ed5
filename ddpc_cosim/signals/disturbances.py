"""Known disturbances: what acts on a plant besides its inputs and is measured, and what is known ahead.

Forecasts have errors of three sizes. Those of temperatures and of the sun are BOPTEST's (D. Blum et al.,
J. Building Performance Simulation 14(5), 2021, doi:10.1080/19401493.2021.1986574; its package ``forecast``):
autoregressive over the hours of lead time, drawn anew at every full hour, normal for a temperature, and
Laplacian for the sun, smoothed over three hours; a forecast of the sun stays within 0.2 and 2 times of what
it will be. Those of other signals are ``e_i+1 = phi e_i + w_i`` over the samples of lead time, drawn anew at
every sample, with ``phi = exp(-1 / N)`` and a standard deviation of 10, 25 or 50 % of that of the signal
after N samples, N being the longest horizon of the study's controllers.
"""

import math
import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, get_args

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ddpc_cosim.codec import Section, Size
from ddpc_cosim.errors import ConfigError, DataError
from ddpc_cosim.files.csv_files import Column, CSVFile, read_table
from ddpc_cosim.files.durations import shown
from ddpc_cosim.settings import setting
from ddpc_cosim.signals.signals import Constant, InputSignal, Reference
from ddpc_cosim.variables import FloatArray, Variable, converter
from fmu_plants.units import parse_unit

HOUR = 3600.0
Knowledge = Literal["unknown", "measured", "low", "medium", "high", "perfect"]
"""What is known: nothing; what is measured now; a forecast with low, medium or high errors; all."""

_LEAD_TIME = re.compile(r"(?P<number>\d+(?:\.\d+)?)\s*\[?(?P<unit>[a-z]*)\]?")
_SHARE = {"low": 0.1, "medium": 0.25, "high": 0.5}
_SUN_WITHIN = 0.2, 2.0
_ROUNDED = 1e-6
"""In parts of the sampling time: by how much times that are equal may differ."""


class _TemperatureErrors(NamedTuple):
    """e_0 is normal with mean f_0 and deviation k_0, e_i+1 with mean f e_i + mu and deviation k [K]."""

    f_0: float
    k_0: float
    f: float
    k: float
    mu: float


class _SunErrors(NamedTuple):
    """e_0 is Laplacian about a_0 with scale b_0, e_i about phi e_i-1 + a with scale b [W/m2]."""

    a_0: float
    b_0: float
    phi: float
    a: float
    b: float


_TEMPERATURE = {
    "low": _TemperatureErrors(0.0, 0.6, 0.92, 0.4, 0.0),
    "medium": _TemperatureErrors(0.15, 1.2, 0.93, 0.6, 0.0),
    "high": _TemperatureErrors(-0.58, 1.5, 0.95, 0.7, -0.015),
}
_SUN = {
    "low": _SunErrors(4.44, 57.42, 0.62, 1.86, 45.64),
    "medium": _SunErrors(15.02, 122.6, 0.63, 4.44, 91.97),
    "high": _SunErrors(32.09, 119.94, 0.67, 10.63, 87.44),
}


class RunTimes(NamedTuple):
    """The times of a run: ``samples`` of them from ``start`` on, ``step`` apart [s]."""

    start: float
    step: float
    samples: int


class Forecasts(ABC):
    """What is expected of one disturbance, over the samples of a run."""

    @abstractmethod
    def from_sample(self, k: int, count: int, samples: int) -> FloatArray:
        """Return what is expected at samples from k on of those after each, shape (count, samples)."""


@dataclass(frozen=True, slots=True)
class ForecastFile(Section):
    """Forecasts as they were issued: a CSV file with a row for each time of issue.

    Parameters
    ----------
    file : str
        Its path. Each column but that of the time is a lead time, told by its header in s or with its unit:
        ``0 h``, ``1 h``, ``2 h``. Between lead times values are interpolated.
    time_column : str
        Header of the time of issue, in s or the unit it has.
    unit : str
        Unit of the values; empty: that of the disturbance.
    """

    file: str = setting(doc="path of a CSV file, relative to the study file", file=True)
    time_column: Annotated[str, Size(1)] = setting("time", doc="header of the time of issue")
    unit: str = setting("", doc="unit of the values; empty: that of the disturbance")

    def read(self, variable: Variable, times: RunTimes, longest: int) -> Forecasts:
        """Return the forecasts in a variable's unit, for a run whose controllers look so many samples ahead.

        Raises
        ------
        DataError
            All that is wrong with the file: lead times that are not times or do not increase, times of issue
            that do not increase, none before the run or at its start, an end before that of the run and the
            longest horizon.
        """
        path = Path(self.file)
        file = CSVFile(path)
        lead, columns, faults = list[float](), list[Column](), list[str]()
        for header in file.header:
            if header.partition(" [")[0] == self.time_column:
                continue
            columns.append(Column(None, header))
            lead.append(_lead_time(header))
            if math.isnan(lead[-1]):
                what = 'is not a lead time; needed: a number of seconds, or with its unit, as "1 h"'
                faults.append(f'{path}: column "{header}" {what}')
            elif len(lead) > 1 and not lead[-1] > lead[-2]:
                faults.append(f'{path}: column "{header}": lead times must increase from column to column')
        if not columns:
            faults.append(f"{path}: no column with a lead time besides the time of issue")
        if faults:
            raise DataError(faults)
        issued, values = read_table(file, columns, self.time_column)
        convert = converter(variable, self.unit)
        forecasts = _Issued(issued, np.array(lead), convert(values), times)
        if fault := forecasts.fault(longest):
            raise DataError(f"{path}: {fault}")
        return forecasts


def _lead_time(header: str) -> float:
    """Return a lead time [s]; NaN if the header is none."""
    match = _LEAD_TIME.fullmatch(header.strip())
    if match is None:
        return math.nan
    try:
        unit = parse_unit(match["unit"] or "s")
    except ValueError:
        return math.nan
    return float(match["number"]) * unit.factor if unit.exponents == {"s": 1} else math.nan


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownDisturbance(Section):
    """An input of the plant that no controller drives, or a measured output, of which controllers know.

    Parameters
    ----------
    signal : Reference, optional
        The input over time; default: that among the inputs of the conditions. Of a measured output what it
        will be, which forecasts are made from.
    known : {"unknown", "measured", "low", "medium", "high", "perfect"}
        What controllers know: nothing; what is measured now, which a forecast holds; forecasts with errors of
        a size; or forecasts without.
    lag : int
        By how many samples it is measured late: 1 is the value of the interval before.
    forecast : ForecastFile, optional
        Forecasts as they were issued, in place of what ``known`` says of them.
    """

    signal: InputSignal | None = setting(None, doc="its course; none: that of the scenario's inputs")
    known: Knowledge = setting(
        "measured", doc="what controllers know of it: what is measured, or forecasts with errors of that size"
    )
    lag: int = setting(0, low=0, doc="samples by which it is measured late")
    forecast: ForecastFile | None = setting(None, doc="forecasts as they were issued")

    def __post_init__(self) -> None:
        faults = []
        if not (self.signal is None or isinstance(self.signal, Reference)):
            faults.append(f"disturbance: signal = {self.signal!r}; needed: a signal of time")
        if self.known not in get_args(Knowledge):
            faults.append(f"disturbance: known = {self.known!r}; needed: one of {get_args(Knowledge)}")
        if not isinstance(self.lag, int) or self.lag < 0:
            faults.append(f"disturbance: lag = {self.lag!r}; needed: a number of samples, 0 or more")
        if self.forecast is not None and self.known in ("unknown", "perfect"):
            faults.append(f'disturbance: a file of forecasts does not go with known = "{self.known}"')
        if faults:
            raise ConfigError(faults)

    @property
    def is_known(self) -> bool:
        """Whether controllers are told anything of it."""
        return self.known != "unknown"

    @property
    def is_foretold(self) -> bool:
        """Whether forecasts are made from what it will be."""
        return self.forecast is None and self.known in (*_SHARE, "perfect")

    @property
    def has_forecast(self) -> bool:
        """Whether controllers are told of what will be more than what is measured now."""
        return self.forecast is not None or self.is_foretold

    def forecasts(
        self,
        variable: Variable,
        truth: FloatArray,
        times: RunTimes,
        longest: int,
        rng: np.random.Generator,
    ) -> Forecasts | None:
        """Return what is expected of it; None: what is measured is held.

        Parameters
        ----------
        variable : Variable
            The disturbance.
        truth : array, shape (K + N,)
            What it will be, in its unit, over the K samples of the run and as many after them as any
            controller of this run looks ahead; empty where it is not foretold.
        times : RunTimes
            Of the run.
        longest : int
            The longest horizon of the study's controllers, in samples.
        rng : numpy.random.Generator
            Draws the errors.
        """
        if self.forecast is not None:
            return self.forecast.read(variable, times, longest)
        if not self.is_foretold:
            return None
        ahead = len(truth) - times.samples
        kind = quantity(variable.unit)
        if self.known == "perfect":
            return _Foretold(truth)
        if kind == "other":
            size = _SHARE[self.known] * float(np.std(truth[: times.samples]))
            return _Foretold(truth, _errors_by_sample(size, max(longest, 1), times.samples, ahead, rng))
        table = _errors_by_hour(kind, self.known, times, ahead, rng) / parse_unit(variable.unit).factor
        return _ForetoldByHour(truth, table, times, _SUN_WITHIN if kind == "sun" else None)


def is_foretelling(signal: Reference) -> bool:
    """Whether a signal in an experiment tells what it is in the run: it is neither random nor constant."""
    return signal.with_seed(0) == signal.with_seed(1) and not isinstance(signal, Constant)


def quantity(unit: str) -> Literal["temperature", "sun", "other"]:
    """Return whether a unit is that of a temperature or of irradiance: their forecasts have other errors."""
    try:
        exponents = parse_unit(unit).exponents
    except ValueError:
        return "other"
    return "temperature" if exponents == {"K": 1} else "sun" if exponents == {"kg": 1, "s": -3} else "other"


class _Foretold(Forecasts):
    """What it will be, less errors by sample and lead time, shapes (K + N,) and (N, K)."""

    def __init__(self, truth: FloatArray, errors: FloatArray | None = None) -> None:
        self._truth, self._errors = truth, errors

    def from_sample(self, k: int, count: int, samples: int) -> FloatArray:
        truth = _windows(self._truth, k, count, samples)
        return truth if self._errors is None else truth - self._errors[:samples, k : k + count].T


class _ForetoldByHour(Forecasts):
    """What it will be, less errors by lead time in hours and hour of issue, shape (L, J).

    ``within``: between which parts of what it will be the forecasts are.
    """

    def __init__(
        self, truth: FloatArray, errors: FloatArray, times: RunTimes, within: tuple[float, float] | None
    ) -> None:
        self._truth, self._errors, self._within = truth, errors.T, within
        self._hours: FloatArray = np.arange(len(truth), dtype=np.float64) * (times.step / HOUR)

    def from_sample(self, k: int, count: int, samples: int) -> FloatArray:
        issued = np.array([[_whole_hours(hours)] for hours in self._hours[k : k + count].tolist()])
        lead = _windows(self._hours, k, count, samples) - issued
        hour = lead.astype(np.intp)
        before, after = self._errors[issued, hour], self._errors[issued, hour + 1]
        truth = _windows(self._truth, k, count, samples)
        expected: FloatArray = truth - ((after - before) * (lead - hour) + before)
        if self._within is None:
            return expected
        low, high = self._within
        return np.asarray(np.clip(expected, low * truth, high * truth))


class _Issued(Forecasts):
    """Forecasts by time of issue and lead time [s], shapes (I,), (L,) and (I, L)."""

    def __init__(self, issued: FloatArray, lead: FloatArray, values: FloatArray, times: RunTimes) -> None:
        self._issued, self._lead, self._values, self._times = issued, lead, values, times

    def from_sample(self, k: int, count: int, samples: int) -> FloatArray:
        times, expected = self._times, np.empty((count, samples))
        for i in range(count):
            now = times.start + (k + i) * times.step
            row = self._latest(now)
            lead = now - self._issued[row] + np.arange(1, samples + 1) * times.step
            expected[i] = np.interp(lead, self._lead, self._values[row])
        return expected

    def fault(self, samples: int) -> str:
        """Return what is wrong with them for a run whose controllers look so many samples ahead."""
        times, early = self._times, _ROUNDED * self._times.step
        if (first := self._issued[0]) > times.start + early:
            return (
                f"the first forecast is issued at t = {shown(first)}, the run begins at {shown(times.start)}"
            )
        for k in range(times.samples):
            now = times.start + k * times.step
            row = self._latest(now)
            until = self._issued[row] + self._lead[-1]
            if until < now + samples * times.step - early:
                issued, needed = self._issued[row], now + samples * times.step
                return (
                    f"the forecast issued at t = {shown(issued)} ends at t = {shown(until)}; needed at "
                    f"t = {shown(now)}: {samples} samples ahead, up to t = {shown(needed)}"
                )
        return ""

    def _latest(self, now: float) -> int:
        return int(np.searchsorted(self._issued, now + _ROUNDED * self._times.step, side="right")) - 1


def _windows(values: FloatArray, k: int, count: int, samples: int) -> FloatArray:
    """Return the values of so many samples after each of those from k on, shape (count, samples)."""
    return sliding_window_view(values[k + 1 : k + count + samples], samples)


def _whole_hours(hours: float) -> int:
    return math.floor(hours * (1 + 1e-12) + 1e-9)


def _errors_by_hour(
    kind: str, known: str, times: RunTimes, ahead: int, rng: np.random.Generator
) -> FloatArray:
    """Return errors by lead time and hour of issue, shape (L, J), in SI units; more lead times add rows."""
    issues = _whole_hours((times.samples - 1) * times.step / HOUR) + 1
    rows = math.ceil(ahead * times.step / HOUR) + 3  # the last but one is smoothed with the last
    table = np.empty((rows, issues))
    if kind == "temperature":
        of_temperature = _TEMPERATURE[known]
        table[0] = rng.normal(of_temperature.f_0, of_temperature.k_0, issues)
        for i in range(1, rows):
            table[i] = rng.normal(of_temperature.f * table[i - 1] + of_temperature.mu, of_temperature.k)
        return table
    of_sun = _SUN[known]
    table[0] = rng.laplace(of_sun.a_0, of_sun.b_0, issues)
    for i in range(1, rows):
        table[i] = rng.laplace(of_sun.phi * table[i - 1] + of_sun.a, of_sun.b)
    table[1:-1] = (table[:-2] + table[1:-1] + table[2:]) / 3
    return table


def _errors_by_sample(
    size: float, longest: int, samples: int, ahead: int, rng: np.random.Generator
) -> FloatArray:
    """Return errors by lead time and sample of issue, shape (ahead, samples); more lead times add rows."""
    phi = math.exp(-1.0 / longest)
    drive = size * math.sqrt((1 - phi**2) / (1 - phi ** (2 * longest)))
    table, error = np.empty((ahead, samples)), np.zeros(samples)
    for row in table:
        error = phi * error + drive * rng.standard_normal(samples)
        row[:] = error
    return table
