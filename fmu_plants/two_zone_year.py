"""What acts on the two-zone house in its year: weather, presence, gains, comfort, tariffs, emissions.

Tables have hourly times from the start of the year, s, of shape (n,), and values of shape (n, columns); of
where the figures come from see :mod:`fmu_plants.two_zone_house`.
"""

from collections.abc import Iterable, Mapping
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmu_plants.units import DAY, HOUR, KELVIN, YEAR
from fmu_plants.weather import (
    HOURS,
    FloatArray,
    Wall,
    WeatherYear,
    fading_noise,
    synthetic_year,
    year_times,
)

WEATHER_SEED, PRICE_SEED = 5, 5

# The household: four persons, at home before 7 and after 20 o'clock on weekdays, and at weekends. The year
# begins on a Monday.
PERSONS = 4
AT_NIGHT = (22, 7)


class Presence(NamedTuple):
    """Who is where in each hour of the year, and the next; each of shape (8761,)."""

    home: NDArray[np.bool_]
    asleep: NDArray[np.bool_]


def presence() -> Presence:
    """Return when the household is at home, and when it sleeps."""
    hours = np.arange(HOURS + 1) % HOURS
    hour = hours % 24
    weekday = hours // 24 % 7 < 5
    home = ~weekday | (hour < 7) | (hour >= 20)
    start, end = AT_NIGHT
    return Presence(home, (hour >= start) | (hour < end))


@cache
def weather() -> WeatherYear:
    """Return the weather of the house."""
    return synthetic_year(WEATHER_SEED)


def weather_table(walls: Iterable[Wall]) -> tuple[FloatArray, FloatArray]:
    """Return air temperature, three irradiances of the ground, and those of the walls."""
    year = weather()
    columns = (
        year.temperature,
        year.global_horizontal,
        year.direct_normal,
        year.diffuse_horizontal,
        *(year.walls[wall] for wall in walls),
    )
    return year.times, np.column_stack(columns)


def occupancy_table() -> tuple[FloatArray, FloatArray]:
    """Return how many persons are in each zone."""
    home, asleep = presence()
    return year_times(), PERSONS * np.column_stack([home & ~asleep, home & asleep]).astype(float)


def _gains() -> dict[int, FloatArray]:
    """Return what persons and devices give to each zone, W: half by convection, half by radiation."""
    home, asleep = presence()
    awake = home & ~asleep
    return {
        1: np.where(awake, 350.0 + PERSONS * 75.0, 100.0),
        2: np.where(home & asleep, 30.0 + PERSONS * 60.0, 30.0),
    }


def gains_table() -> tuple[FloatArray, FloatArray]:
    """Return what is given to each zone by convection and by radiation, W."""
    gains = _gains()
    return year_times(), np.column_stack([gain / 2 for gain in gains.values() for _ in ("Con", "Rad")])


def setpoints_table(at_home: tuple[float, float], away: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Return both edges of the comfort band, K, of each zone; those at home and away are given in degC."""
    home = presence().home
    band = [np.where(home, *edges) + KELVIN for edges in zip(at_home, away, strict=True)]
    return year_times(), np.column_stack(band * len(_gains()))


def schedule_table() -> tuple[FloatArray, FloatArray]:
    """Return how long it takes until somebody comes home, and until all leave; 0 where it is so."""
    home = presence().home
    return year_times(), np.column_stack([_until(home), _until(~home)])


def _until(state: NDArray[np.bool_]) -> FloatArray:
    """Return in how many s, at each hour of a year that repeats, the state holds."""
    twice = np.flatnonzero(np.append(state[:-1], state[:-1]))
    hours = np.arange(HOURS + 1) % HOURS
    return HOUR * (twice[np.searchsorted(twice, hours)] - hours).astype(float)


def prices_table() -> tuple[FloatArray, FloatArray]:
    """Return three tariffs: what networks and taxes take, 0.20 EUR/kWh, and the energy."""
    hour = np.arange(HOURS + 1) % 24
    day = (hour >= 7) & (hour < 22)
    energy = (np.full(HOURS + 1, 0.0535), np.where(day, 0.0666, 0.0383), _day_ahead())
    return year_times(), 0.20 + np.column_stack(energy)


def _day_ahead() -> FloatArray:
    """Return hourly prices as of a day-ahead market, EUR/kWh: dear in mornings and evenings."""
    hour = np.arange(HOURS) % 24
    wave = 0.6 * np.cos(2 * np.pi * (hour - 8) / 12) + 0.4 * np.cos(2 * np.pi * (hour - 18) / 24)
    market = fading_noise(np.random.default_rng(PRICE_SEED), DAY)
    prices = 0.097 + 0.04 * wave + 0.025 * market
    return np.append(prices, prices[0])


def emissions_table() -> tuple[FloatArray, FloatArray]:
    """Return what electricity emits, kg/kWh: the same all year."""
    return np.array([0.0, YEAR]), np.full((2, 1), 0.167)


def heating_load(inside: float, outdoors: float, ground: float, windows: Mapping[Wall, float]) -> FloatArray:
    """Return the heat that holds a temperature, each day if it lasted for ever, W, shape (365,).

    Parameters
    ----------
    inside : float
        The temperature, K.
    outdoors : float
        Heat to the air outdoors, W/K.
    ground : float
        Heat to the ground, W.
    windows : mapping of wall to float
        Area through which all that shines on the wall gets in, m2.
    """
    year = weather()
    sun = sum(area * year.walls[wall] for wall, area in windows.items())
    load = outdoors * (inside - year.temperature) + ground - sun - sum(_gains().values())
    return np.asarray(load[:-1].reshape(365, 24).mean(axis=1))
