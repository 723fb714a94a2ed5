"""Key figures of buildings as BOPTEST defines them, from the samples of a run.

D. Blum et al., "Building optimization testing framework (BOPTEST) for simulation-based benchmarking of
control strategies in buildings", Journal of Building Performance Simulation 14(5), 2021,
doi:10.1080/19401493.2021.1986574; where that leaves something open, as its program counts it
(``kpis/kpi_calculator.py``). Both integrate by the trapezoidal rule over the samples of the run without its
warm-up, and so does this.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ddpc_cosim.description import KeyFigureTags
from ddpc_cosim.responses import largest_quarter_hour
from ddpc_cosim.variables import FloatArray
from fmu_plants.units import display_unit

ELECTRIC, GAS, DISTRICT_HEATING = "ElectricPower", "GasPower", "DistrictHeatingPower"
POWERS = (ELECTRIC, DISTRICT_HEATING, GAS, "BiomassPower", "SolarThermalPower")
"""Sources whose signals are powers."""
WATER = "FreshWaterFlowRate"
TEMPERATURES = ("AirZoneTemperature", "OperativeZoneTemperature")
CO2, TRAVEL = "CO2Concentration", "ActuatorTravel"
"""Sources of one zone, or of one actuator, whose name follows in brackets."""
UNUSED = ("RadiativeZoneTemperature", "RelativeHumidity")
"""Sources that BOPTEST knows and has no key figure of."""
SOURCES = (*POWERS, WATER, *(f"{kind}[1]" for kind in (*TEMPERATURES, CO2, TRAVEL, *UNUSED)))
"""Names of all sources, of zones the first."""
UNITS = dict.fromkeys(POWERS, "W") | dict.fromkeys(TEMPERATURES, "K") | {CO2: "ppm", WATER: "m3/s"}
"""In which units key figures take the signals of a source."""
_KWH = 3.6e6  # J
_HOUR = 3600.0  # s


def kind_of(source: str) -> str:
    """Return what the signals of a source are: its name without the zone's in brackets."""
    return source.partition("[")[0]


def is_source(source: str) -> bool:
    """Whether BOPTEST knows a source of this name."""
    of_a_zone = (*TEMPERATURES, CO2, TRAVEL, *UNUSED)
    return source.endswith("]") if kind_of(source) in of_a_zone else source in (*POWERS, WATER)


def factor_of(source: str, unit: str) -> float:
    """Return what differences of a source's signal are multiplied by to be in W, K, ppm or m3/s.

    A signal without a unit is in that unit, as BOPTEST takes it to be.

    Raises
    ------
    ValueError
        It is not of that quantity.
    """
    needed = UNITS.get(kind_of(source), unit)
    return 1.0 if unit in ("", needed) else display_unit(unit, needed).factor


def tagged(tags: KeyFigureTags, *kinds: str) -> Iterator[tuple[str, str]]:
    """Yield the sources of some kinds with their signals, one after the other."""
    for source, signals in tags.sources.items():
        if kind_of(source) in kinds:
            yield from ((source, signal) for signal in signals)


@dataclass(frozen=True)
class TaggedSignal:
    """A signal that key figures are of, at the n samples of a run, that at its end included.

    Parameters
    ----------
    values : array, shape (n,)
        In W, K, ppm, m3/s, or, of an actuator, its own unit.
    sampling_time : float
        Time between samples [s].
    is_held : bool
        Whether it is a constant from sample to sample, as an input is; otherwise it is a straight line.
    limits : array, shape (n, 2), optional
        Lower and upper limit, in the same unit.
    price, emission : array, shape (n,), optional
        Money, and kg, for its unit over a second; None: it costs nothing that is known.
    holds : bool
        Whether limits, prices and emissions are held from sample to sample, as where samples lie closer than
        those at which they change; otherwise they too are straight lines between samples.
    """

    values: FloatArray
    sampling_time: float
    is_held: bool = False
    limits: FloatArray | None = None
    price: FloatArray | None = None
    emission: FloatArray | None = None
    holds: bool = False

    @property
    def means(self) -> FloatArray:
        """Means over the sampling intervals, shape (n - 1,)."""
        return self._means(self.values, self.values)

    @property
    def emits(self) -> bool:
        """Whether anything is emitted for it."""
        return self.emission is not None and bool(self.emission.any())

    def total(self, per_amount: FloatArray | float | None = 1.0) -> float:
        """Return the integral over time of the signal times something, such as its price, shape (n,)."""
        if per_amount is None:
            return math.nan
        each = np.broadcast_to(per_amount, self.values.shape)
        starts, ends = self.values * each, self.values * self._at_ends(each)
        return self.sampling_time * float(self._means(starts, ends).sum())

    def beyond(self, *, below: bool) -> float:
        """Return the integral of the distance to the upper limit where it is above, and to the lower one."""
        if self.limits is None:
            return math.nan
        starts, ends = (
            _distance(self.values, limits, below=below)
            for limits in (self.limits, self._at_ends(self.limits))
        )
        return self.sampling_time * float(self._means(starts, ends).sum())

    @property
    def travel(self) -> float:
        """Sum of the magnitudes of its changes from sample to sample."""
        values = self.values[:-1] if self.is_held else self.values
        return float(np.abs(np.diff(values)).sum())

    def _at_ends(self, values: FloatArray) -> FloatArray:
        """Return what holds just before each sample, shape (n, ...), of something at them."""
        return np.concatenate([values[:1], values[:-1]]) if self.holds else values

    def _means(self, starts: FloatArray, ends: FloatArray) -> FloatArray:
        """Return means over the intervals of something just after and just before the samples."""
        return starts[:-1] if self.is_held else (starts[:-1] + ends[1:]) / 2.0


def _distance(values: FloatArray, limits: FloatArray, *, below: bool) -> FloatArray:
    """Return how far values are above their limits, and perhaps below."""
    away: FloatArray = np.maximum(values - limits[:, 1], 0.0)
    return away + np.maximum(limits[:, 0] - values, 0.0) if below else away


@dataclass(frozen=True)
class KeyFigures:
    """What the key figures of a run are computed from.

    Parameters
    ----------
    tags : KeyFigureTags
        The floor area, and the signals of each source.
    money : str
        What is paid with; empty: nothing is paid for.
    has_emissions : bool
        Whether anything is emitted.
    sampling_time : float
        Time between samples [s].
    signals : mapping of str to TaggedSignal
        Those of the sources by name, as far as they are known.
    actuators : sequence of TaggedSignal
        The inputs, for a plant that names no actuators.
    is_complete : bool
        Whether the run reached its end: otherwise there are no figures, as they would be of less time.
    """

    tags: KeyFigureTags
    money: str = ""
    has_emissions: bool = False
    sampling_time: float = math.nan
    signals: Mapping[str, TaggedSignal] = field(default_factory=dict)
    actuators: Sequence[TaggedSignal] = ()
    is_complete: bool = False

    def has(self, *kinds: str) -> bool:
        """Whether there is a signal of such sources."""
        return any(tagged(self.tags, *kinds))

    def thermal_discomfort(self) -> float:
        """Return the mean over the sources of temperatures of the distances to their limits [K.h]."""
        return self._of_zones(TEMPERATURES, below=True)

    def air_discomfort(self) -> float:
        """Return the mean over the sources of CO2 of the distances above their limits [ppm.h]."""
        return self._of_zones((CO2,), below=False)

    def energy(self) -> float:
        """Return the energy per area of all powers [kWh/m2]."""
        return self._sum(POWERS, TaggedSignal.total) / _KWH / self.tags.area

    def cost(self) -> float:
        """Return the money per area for all powers and fresh water."""
        return self._sum((*POWERS, WATER), lambda signal: signal.total(signal.price)) / self.tags.area

    def emissions(self) -> float:
        """Return what all powers emit per area [kg/m2]."""
        return self._sum(POWERS, lambda signal: signal.total(signal.emission)) / self.tags.area

    def peak(self, source: str) -> float:
        """Return the largest mean over 15 minutes of the powers of a source, per area [kW/m2]."""
        powers = [self._signal(signal).means for _, signal in tagged(self.tags, source)]
        if not self.is_complete or any(len(power) != len(powers[0]) for power in powers):
            return math.nan
        joules = np.sum(powers, axis=0) * self.sampling_time
        return largest_quarter_hour(joules, self.sampling_time) / 1000.0 / self.tags.area

    def travel(self) -> float:
        """Return the mean over the actuators of how far they go."""
        named = [self._signal(signal) for _, signal in tagged(self.tags, TRAVEL)]
        ways = [actuator.travel for actuator in named or self.actuators]
        return math.fsum(ways) / len(ways) if ways and self.is_complete else math.nan

    def _of_zones(self, kinds: Iterable[str], *, below: bool) -> float:
        """Return the sum over all signals of some sources, over the number of the sources [unit.h]."""
        sources = {source for source, _ in tagged(self.tags, *kinds)}
        return self._sum(kinds, lambda signal: signal.beyond(below=below)) / _HOUR / len(sources)

    def _sum(self, kinds: Iterable[str], figure: Callable[[TaggedSignal], float]) -> float:
        """Return the sum of a figure over the signals of some sources; NaN of a run that did not complete."""
        if not self.is_complete:
            return math.nan
        return sum(figure(self._signal(signal)) for _, signal in tagged(self.tags, *kinds))

    def _signal(self, name: str) -> TaggedSignal:
        nothing = TaggedSignal(np.full(2, np.nan), self.sampling_time)
        return self.signals.get(name, nothing)
