"""Unit names in terms of the SI base units."""

import math

import pytest
from hypothesis import given, strategies as st

from fmu_plants.units import known_symbols, parse_unit, usual_display_units


@pytest.mark.parametrize(
    ("text", "exponents"),
    [
        ("", {}),
        ("1", {}),
        ("rad/s", {"rad": 1, "s": -1}),
        ("N.m", {"kg": 1, "m": 2, "s": -2}),
        ("N*m", {"kg": 1, "m": 2, "s": -2}),
        ("m/s2", {"m": 1, "s": -2}),
        ("kg.m2/s3", {"kg": 1, "m": 2, "s": -3}),
        ("J/(kg.K)", {"m": 2, "s": -2, "K": -1}),
        ("1/s", {"s": -1}),
        ("s-1", {"s": -1}),
        ("V.A", {"kg": 1, "m": 2, "s": -3}),
        ("Ohm.S", {}),
        ("C/s", {"A": 1}),
        ("F.Ohm", {"s": 1}),
        ("H/Ohm", {"s": 1}),
        ("mol/m3", {"mol": 1, "m": -3}),
    ],
)
def test_coherent_units(text, exponents):
    unit = parse_unit(text)
    assert dict(unit.exponents) == exponents
    assert (unit.factor, unit.offset) == (1.0, 0.0)


@pytest.mark.parametrize(
    ("text", "value", "in_si"),
    [
        ("mm", 5.0, 0.005),
        ("kW", 2.0, 2000.0),
        ("g/cm3", 1.0, 1000.0),
        ("deg", 180.0, math.pi),
        ("rpm", 30.0, math.pi),
        ("km/h", 36.0, 10.0),
        ("bar", 1.0, 1e5),
        ("mbar", 1.0, 100.0),
        ("l/min", 60.0, 1e-3),
        ("%", 50.0, 0.5),
        ("degC", 20.0, 293.15),
        ("degF", 212.0, 373.15),
    ],
)
def test_other_units_are_converted(text, value, in_si):
    unit = parse_unit(text)
    assert unit.factor * value + unit.offset == pytest.approx(in_si)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("parsec", "unknown unit symbol 'parsec'; known: "),
        ("m/", "ends where a unit symbol is missing"),
        ("(m/s", "lacks a closing parenthesis"),
        ("m s", "cannot be read from 's' on"),
        ("m!", "cannot be read from '!' on"),
        ("2.m", "cannot be read from '2.m' on"),
        ("degC/s", "offset"),
        ("./s", "unknown unit symbol '.'"),
    ],
)
def test_what_is_not_a_unit_is_refused(text, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011 (the message is what is tested)
        parse_unit(text)
    assert message in str(error.value)


@given(st.sampled_from(known_symbols()), st.integers(1, 4))
def test_powers_are_repeated_products(symbol, power):
    if parse_unit(symbol).offset:
        return
    once, product = parse_unit(f"{symbol}{power}"), parse_unit(".".join([symbol] * power))
    assert dict(once.exponents) == dict(product.exponents)
    assert once.factor == pytest.approx(product.factor)
    assert dict(parse_unit(f"{symbol}/{symbol}").exponents) == {}


@pytest.mark.parametrize(
    ("unit", "shown", "factor", "offset"),
    [
        ("rad", "deg", 180 / math.pi, 0.0),
        ("rad", "°", 180 / math.pi, 0.0),
        ("rad/s", "rpm", 30 / math.pi, 0.0),
        ("K", "degC", 1.0, -273.15),
        ("K", "degF", 1.8, -459.67),
        ("m/s", "km/h", 3.6, 0.0),
        ("m^3", "l", 1e3, 0.0),
        ("m3/s", "l/min", 6e4, 0.0),
        ("J", "kWh", 1 / 3.6e6, 0.0),
        ("", "%", 100.0, 0.0),
    ],
)
def test_display_units_have_the_factors_that_people_write(unit, shown, factor, offset):
    display = usual_display_units(unit)[shown]
    assert (display.name, display.factor, display.offset) == (shown, factor, offset)


def test_a_unit_that_is_not_usual_has_no_display_units():
    assert usual_display_units("furlong") == {}
