"""Synthetic weather: laws of sun and sky that hold in every year, and the climate that it was made for."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fmu_plants.weather import (
    CENTRAL_EUROPE,
    DAY,
    HOUR,
    HOURS,
    KELVIN,
    clear_sky,
    fading_noise,
    on_walls,
    sun_direction,
    synthetic_year,
)

seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=8, deadline=None)


def sun_of(year):
    return sun_direction(year.times, CENTRAL_EUROPE.latitude)


@few
@given(seeds)
def test_there_is_no_sun_at_night(seed):
    year = synthetic_year(seed)
    night = sun_of(year).up <= 0
    for values in (year.global_horizontal, year.direct_normal, year.diffuse_horizontal, *year.walls.values()):
        assert np.abs(values[night]).max() == 0.0
        assert values.min() >= 0.0


@few
@given(seeds)
def test_what_falls_on_the_ground_is_beam_and_sky_and_no_more_than_below_a_clear_one(seed):
    year, sun = synthetic_year(seed), sun_of(synthetic_year(seed))
    beam = year.direct_normal * np.maximum(sun.up, 0.0)
    assert year.global_horizontal == pytest.approx(beam + year.diffuse_horizontal, abs=1e-9)
    assert (year.global_horizontal <= clear_sky(sun.up) + 1e-9).all()
    assert (year.direct_normal < 1361.0 * 0.7).all()  # through one atmosphere: Meinel (1976)


@few
@given(seeds)
def test_beams_on_walls_are_the_horizontal_part_of_the_beam(seed):
    year, sun = synthetic_year(seed), sun_of(synthetic_year(seed))
    scattered = year.diffuse_horizontal / 2 + 0.2 * year.global_horizontal / 2
    squares = sum((values - scattered) ** 2 for values in year.walls.values())
    horizontal = year.direct_normal * np.sqrt(1 - sun.up**2)
    assert np.sqrt(squares) == pytest.approx(horizontal, abs=1e-6)


@few
@given(seeds)
def test_temperatures_are_those_of_a_temperate_climate(seed):
    celsius = synthetic_year(seed).temperature - KELVIN
    assert -32.0 < celsius.min() < 0.0
    assert 22.0 < celsius.max() < 47.0
    daily = celsius[:-1].reshape(365, 24).mean(axis=1)
    assert daily[151:243].mean() - daily[[*range(334, 365), *range(59)]].mean() > 8.0


@few
@given(seeds)
def test_a_year_runs_on_into_itself_and_is_the_same_for_the_same_seed(seed):
    year, again = synthetic_year(seed), synthetic_year(seed)
    columns = np.column_stack([year.temperature, year.global_horizontal, *year.walls.values()])
    assert (columns[0] == columns[-1]).all()
    assert (np.diff(year.times) == HOUR).all()
    steps = np.abs(np.diff(year.temperature))
    assert steps[-1] < steps[:-1].max() + 1.0
    assert (year.temperature == again.temperature).all()


def test_the_climate_is_that_of_belgium():
    """Over years as Uccle has them: 10 to 11 degC, about 1050 kWh/m2, rather more than half diffuse."""
    years = [synthetic_year(seed) for seed in range(20)]
    assert np.mean([year.temperature for year in years]) - KELVIN == pytest.approx(10.3, abs=0.5)
    total = np.mean([year.global_horizontal[:-1].sum() for year in years]) / 1000
    assert total == pytest.approx(1050.0, abs=60.0)
    diffuse = np.mean([year.diffuse_horizontal[:-1].sum() for year in years]) / 1000
    assert 0.5 < diffuse / total < 0.6


@given(st.floats(-60.0, 60.0), st.integers(0, 364))
def test_the_sun_is_up_as_long_as_the_sunrise_equation_has_it(latitude, day):
    times = day * DAY + np.arange(0.0, DAY, 60.0)
    sun = sun_direction(times, latitude)
    assert sun.up**2 + sun.south**2 + sun.west**2 == pytest.approx(np.ones(len(times)))
    tilt = np.radians(23.45) * np.sin(2 * np.pi * (284 + day + 1) / 365)
    hours = 24 / np.pi * np.arccos(np.clip(-np.tan(np.radians(latitude)) * np.tan(tilt), -1, 1))
    assert (sun.up > 0).sum() / 60 == pytest.approx(hours, abs=0.05)
    noon = np.argmax(sun.up)
    assert times[noon] - day * DAY == 12 * HOUR
    assert (sun.west[:noon] <= 1e-12).all()  # it rises in the east


def test_the_sky_is_that_of_haurwitz():
    assert clear_sky(np.array([1.0, 0.5, 0.0, -0.3])) == pytest.approx(
        [1098 * np.exp(-0.057), 549 * np.exp(-0.114), 0.0, 0.0]
    )


def test_below_clouds_all_walls_are_alike():
    sun = sun_direction(np.array([12 * HOUR]), 50.0)
    walls = on_walls(sun, np.array([80.0]), np.array([0.0]), np.array([80.0]), 0.2)
    assert {wall: float(values[0]) for wall, values in walls.items()} == pytest.approx(
        dict.fromkeys(("south", "west", "north", "east"), 40.0 + 8.0)
    )


def test_noise_has_its_variance_and_fades_in_its_time():
    paths = np.array([fading_noise(np.random.default_rng(seed), 10 * HOUR) for seed in range(40)])
    assert paths.shape == (40, HOURS)
    assert paths.var() == pytest.approx(1.0, abs=0.05)
    later = np.roll(paths, -10, axis=1)  # the end runs on into the start
    assert (paths * later).mean() == pytest.approx(np.exp(-1.0), abs=0.03)
