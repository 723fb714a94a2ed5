"""A year of weather that nobody measured: hourly and seeded, the sun by geometry, clouds and cold by chance.

The sun stands where geometry puts it (declination: P. I. Cooper, Solar Energy 12 (1969) 333-346); clocks
have solar time. Below a clear sky the ground gets what B. Haurwitz, J. Meteorology 2 (1945) 154-166,
measured, below clouds a share of it. How much of that is diffuse is the correlation of D. G. Erbs, S. A.
Klein, J. A. Duffie, Solar Energy 28 (1982) 293-302; the beam is never brighter than the clear sky's of A.
B. and M. P. Meinel, "Applied Solar Energy" (1976). To walls the sky is equally bright everywhere, and the
ground reflects (B. Y. H. Liu, R. C. Jordan, Solar Energy 4 (1960) 1-19).

Clouds and temperatures vary about the harmonics of year and day as autoregressive processes of first order,
which J. Boland, Solar Energy 55 (1995) 377-388, finds in measured years: a slow one of weather fronts,
which clouds and the day's swing follow, a fast one of passing clouds, and one of air masses. A clear day is
colder than a dull one in winter, and warmer in summer. The year is periodic: its first hour follows its
last. The values of `CENTRAL_EUROPE` are chosen here so that its years have the means and sums of Belgium;
they are no measured ones.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fmu_plants.units import DAY, HOUR, KELVIN, YEAR

FloatArray = NDArray[np.float64]

HOURS = 365 * 24
SOLAR_CONSTANT = 1361.0  # W/m2


@dataclass(frozen=True, slots=True, kw_only=True)
class Climate:
    """What the weather of a place is like.

    Parameters
    ----------
    latitude : float
        Degrees north.
    mean_temperature, annual_swing : float
        Mean of the year, degC, and amplitude of its harmonic, K.
    coldest_day : float
        Day of the year on which the harmonic is lowest.
    daily_swing : tuple of float
        Amplitude of the day's harmonic under dull and under clear sky, K.
    clear_sky_effect : float
        How much colder a clear day is than a dull one in midwinter, and warmer in midsummer, K.
    spells, spells_time : float
        Standard deviation of warm and cold spells, K, and time in which they fade to 1/e, s.
    clearness : tuple of float
        How clear the sky commonly is in midwinter and midsummer: 0 is as often above half as below.
    fronts_time, clouds_time : float
        Time in which the memory of fronts and of passing clouds fades to 1/e, s.
    clouds_share : float
        Share of passing clouds in the variance, 0 .. 1; the rest is of fronts.
    ground_reflectance : float
        Share of the light that the ground reflects, 0 .. 1.
    """

    latitude: float
    mean_temperature: float
    annual_swing: float
    coldest_day: float
    daily_swing: tuple[float, float]
    clear_sky_effect: float
    spells: float
    spells_time: float
    clearness: tuple[float, float]
    fronts_time: float
    clouds_time: float
    clouds_share: float
    ground_reflectance: float


CENTRAL_EUROPE = Climate(
    latitude=50.8,
    mean_temperature=9.5,
    annual_swing=8.5,
    coldest_day=20.0,
    daily_swing=(1.0, 5.5),
    clear_sky_effect=5.0,
    spells=3.8,
    spells_time=3.0 * DAY,
    clearness=(-0.7, 0.5),
    fronts_time=1.5 * DAY,
    clouds_time=2.0 * HOUR,
    clouds_share=0.25,
    ground_reflectance=0.2,
)

Wall = Literal["south", "west", "north", "east"]


class WeatherYear(NamedTuple):
    """Hourly weather from the first hour of a year up to that of the next one, the same again.

    Parameters
    ----------
    times : ndarray, shape (8761,)
        Time from the start of the year, s.
    temperature : ndarray, shape (8761,)
        Of the air, K.
    global_horizontal, direct_normal, diffuse_horizontal : ndarray, shape (8761,)
        Irradiance on the ground, of the beam on a plane facing it, of the sky on the ground, W/m2.
    walls : dict of str to ndarray, shape (8761,)
        Irradiance on a vertical plane facing south, west, north and east, W/m2.
    """

    times: FloatArray
    temperature: FloatArray
    global_horizontal: FloatArray
    direct_normal: FloatArray
    diffuse_horizontal: FloatArray
    walls: dict[Wall, FloatArray]


class SunDirection(NamedTuple):
    """Components of the unit vector towards the sun; each of shape (n,)."""

    up: FloatArray
    south: FloatArray
    west: FloatArray


def year_times() -> FloatArray:
    """Return the hours of a year and the first of the next one, s, shape (8761,)."""
    return np.linspace(0.0, YEAR, HOURS + 1)


def sun_direction(times: FloatArray, latitude: float) -> SunDirection:
    """Return where the sun stands.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Solar time from the start of the year, s.
    latitude : float
        Degrees north.
    """
    day = np.floor(times / DAY) + 1.0
    declination = np.radians(23.45) * np.sin(2 * np.pi * (284.0 + day) / 365.0)
    hour_angle = 2 * np.pi * (times / DAY - 0.5)
    sin_latitude, cos_latitude = np.sin(np.radians(latitude)), np.cos(np.radians(latitude))
    return SunDirection(
        sin_latitude * np.sin(declination) + cos_latitude * np.cos(declination) * np.cos(hour_angle),
        sin_latitude * np.cos(declination) * np.cos(hour_angle) - cos_latitude * np.sin(declination),
        np.cos(declination) * np.sin(hour_angle),
    )


def clear_sky(up: FloatArray) -> FloatArray:
    """Return the irradiance on the ground below a clear sky, W/m2, shape (n,); Haurwitz (1945).

    Parameters
    ----------
    up : ndarray, shape (n,)
        Sine of the sun's elevation.
    """
    risen = np.maximum(up, 1e-3)
    return np.where(up > 0, 1098.0 * risen * np.exp(-0.057 / risen), 0.0)


def synthetic_year(seed: int, climate: Climate = CENTRAL_EUROPE) -> WeatherYear:
    """Return a year of weather that the climate may have; each seed is another one."""
    rng = np.random.default_rng(seed)
    times = year_times()[:-1]
    season = -np.cos(2 * np.pi * (times / DAY - climate.coldest_day) / 365.0)  # -1 midwinter, 1 midsummer
    fronts, clouds, spells = (
        fading_noise(rng, time) for time in (climate.fronts_time, climate.clouds_time, climate.spells_time)
    )
    winter, summer = climate.clearness
    usual = winter + (summer - winter) * (1 + season) / 2
    clear = _logistic(1.7 * (usual + fronts))
    sky = np.sqrt(1 - climate.clouds_share) * fronts + np.sqrt(climate.clouds_share) * clouds
    sun = sun_direction(times, climate.latitude)
    total = (0.12 + 0.88 * _logistic(1.7 * (usual + sky))) * clear_sky(sun.up)
    direct, diffuse = _beam_and_sky(sun.up, total, times)
    dull, swing = climate.daily_swing
    temperature = (
        climate.mean_temperature
        + climate.annual_swing * season
        + (dull + (swing - dull) * clear) * np.cos(2 * np.pi * (times / DAY - 15 / 24))
        + climate.clear_sky_effect * season * (clear - 0.5)
        + climate.spells * spells
    )
    walls = on_walls(sun, total, direct, diffuse, climate.ground_reflectance)
    return WeatherYear(
        year_times(),
        _closed(temperature + KELVIN),
        _closed(total),
        _closed(direct),
        _closed(diffuse),
        {wall: _closed(values) for wall, values in walls.items()},
    )


def on_walls(
    sun: SunDirection,
    global_horizontal: FloatArray,
    direct_normal: FloatArray,
    diffuse_horizontal: FloatArray,
    ground_reflectance: float,
) -> dict[Wall, FloatArray]:
    """Return the irradiance on walls, W/m2, shape (n,) each: of beam, half the sky, half the ground."""
    facing: dict[Wall, FloatArray] = {
        "south": sun.south,
        "west": sun.west,
        "north": -sun.south,
        "east": -sun.west,
    }
    scattered = (diffuse_horizontal + ground_reflectance * global_horizontal) / 2
    return {wall: direct_normal * np.maximum(cosine, 0.0) + scattered for wall, cosine in facing.items()}


def fading_noise(rng: np.random.Generator, memory: float) -> FloatArray:
    """Return an autoregressive process of variance 1, every hour of a year, whose end runs on into its start.

    Parameters
    ----------
    rng : Generator
        What draws it.
    memory : float
        Time in which its correlation falls to 1/e, s.
    """
    kept = np.exp(-HOUR / memory)
    draws = np.sqrt(1 - kept**2) * rng.standard_normal(HOURS)
    # The state before the first hour is that after the last one: a geometric series of all draws.
    value = float(draws @ kept ** np.arange(HOURS - 1, -1, -1)) / (1 - kept**HOURS)
    values = np.empty(HOURS)
    for hour, draw in enumerate(draws):
        value = kept * value + draw
        values[hour] = value
    return values


def _beam_and_sky(up: FloatArray, total: FloatArray, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return direct normal and diffuse irradiance; Erbs et al. (1982)."""
    outside = SOLAR_CONSTANT * (1 + 0.033 * np.cos(2 * np.pi * times / YEAR))
    risen = np.maximum(up, 1e-3)
    clearness = total / (outside * risen)
    middle = 0.9511 + clearness * (-0.1604 + clearness * (4.388 + clearness * (-16.638 + clearness * 12.336)))
    share = np.select([clearness <= 0.22, clearness <= 0.8], [1 - 0.09 * clearness, middle], 0.165)
    brightest = SOLAR_CONSTANT * 0.7 ** (risen**-0.678)
    direct = np.where(up > 0, np.minimum((1 - share) * total / risen, brightest), 0.0)
    return direct, total - direct * np.maximum(up, 0.0)


def _logistic(x: FloatArray) -> FloatArray:
    return 1 / (1 + np.exp(-x))


def _closed(values: FloatArray) -> FloatArray:
    return np.append(values, values[0])
