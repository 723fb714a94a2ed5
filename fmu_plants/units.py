"""Units: names to exponents of the SI base units, as FMI wants them declared, and units for display.

A unit is a product of unit symbols with integer exponents: ``N.m``, ``kg.m2/s3``, ``J/(kg.K)``, ``1/s``.
A slash divides by the one factor behind it; parentheses group. SI prefixes are understood (``mm``, ``kW``).
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache
from math import pi
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

KELVIN = 273.15
"""0 degC [K]."""
HOUR, DAY, YEAR = 3600.0, 86400.0, 365 * 86400.0
"""Times [s]; of a year that is no leap year."""

_TOKEN = re.compile(r"\s*(?:(?P<symbol>[A-Za-z%°µ]+)(?P<power>[-+]?\d+)?|(?P<one>1)|(?P<mark>[./*()]))")


@dataclass(frozen=True, slots=True)
class SIUnit:
    """A unit in terms of the SI: ``value in SI = factor * value + offset``.

    Parameters
    ----------
    exponents : mapping of str to int
        Exponents of the base units kg, m, s, A, K, mol, cd and rad; those that are 0 are left out.
    factor, offset : float
        Conversion to the coherent SI unit.
    """

    exponents: Mapping[str, int] = field(default_factory=dict)
    factor: float = 1.0
    offset: float = 0.0

    def __mul__(self, other: "SIUnit") -> "SIUnit":
        """Return the product of two units."""
        names = [*self.exponents, *(name for name in other.exponents if name not in self.exponents)]
        total = {name: self.exponents.get(name, 0) + other.exponents.get(name, 0) for name in names}
        return SIUnit({name: power for name, power in total.items() if power}, self.factor * other.factor)

    def __pow__(self, power: int) -> "SIUnit":
        """Return an integer power of the unit."""
        exponents = {name: power * exponent for name, exponent in self.exponents.items() if power}
        return SIUnit(exponents, self.factor**power)


_PREFIXES = {"G": 1e9, "M": 1e6, "k": 1e3, "d": 1e-1, "c": 1e-2, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "n": 1e-9}

# Symbols that take a prefix. The gram is here for the kilogram's sake.
_PREFIXED = {
    "m": SIUnit({"m": 1}),
    "g": SIUnit({"kg": 1}, 1e-3),
    "s": SIUnit({"s": 1}),
    "A": SIUnit({"A": 1}),
    "K": SIUnit({"K": 1}),
    "mol": SIUnit({"mol": 1}),
    "cd": SIUnit({"cd": 1}),
    "rad": SIUnit({"rad": 1}),
    "N": SIUnit({"kg": 1, "m": 1, "s": -2}),
    "Pa": SIUnit({"kg": 1, "m": -1, "s": -2}),
    "J": SIUnit({"kg": 1, "m": 2, "s": -2}),
    "W": SIUnit({"kg": 1, "m": 2, "s": -3}),
    "V": SIUnit({"kg": 1, "m": 2, "s": -3, "A": -1}),
    "C": SIUnit({"A": 1, "s": 1}),
    "F": SIUnit({"kg": -1, "m": -2, "s": 4, "A": 2}),
    "Ohm": SIUnit({"kg": 1, "m": 2, "s": -3, "A": -2}),
    "S": SIUnit({"kg": -1, "m": -2, "s": 3, "A": 2}),
    "H": SIUnit({"kg": 1, "m": 2, "s": -2, "A": -2}),
    "Wb": SIUnit({"kg": 1, "m": 2, "s": -2, "A": -1}),
    "T": SIUnit({"kg": 1, "s": -2, "A": -1}),
    "Hz": SIUnit({"s": -1}),
    "bar": SIUnit({"kg": 1, "m": -1, "s": -2}, 1e5),
    "l": SIUnit({"m": 3}, 1e-3),
    "L": SIUnit({"m": 3}, 1e-3),
    "t": SIUnit({"kg": 1}, 1e3),
    "eV": SIUnit({"kg": 1, "m": 2, "s": -2}, 1.602176634e-19),
    "Wh": SIUnit({"kg": 1, "m": 2, "s": -2}, 3600.0),
}

_PLAIN = {
    "deg": SIUnit({"rad": 1}, pi / 180),
    "rev": SIUnit({"rad": 1}, 2 * pi),
    "rpm": SIUnit({"rad": 1, "s": -1}, 2 * pi / 60),
    "min": SIUnit({"s": 1}, 60.0),
    "h": SIUnit({"s": 1}, 3600.0),
    "d": SIUnit({"s": 1}, 86400.0),
    "degC": SIUnit({"K": 1}, 1.0, KELVIN),
    "degF": SIUnit({"K": 1}, 5 / 9, 45967 / 180),
    "lb": SIUnit({"kg": 1}, 0.45359237),
    "kgf": SIUnit({"kg": 1, "m": 1, "s": -2}, 9.80665),
    "%": SIUnit({}, 1e-2),
    "ppm": SIUnit({}, 1e-6),
}

# The display units that are usual for a unit.
_USUALLY_SHOWN_IN = {
    "rad": ("deg", "rev"),
    "rad/s": ("deg/s", "rpm"),
    "K": ("degC", "degF"),
    "Pa": ("bar", "mbar", "kPa", "MPa"),
    "m": ("mm", "cm", "km"),
    "m/s": ("km/h", "mm/s"),
    "m2": ("cm2", "mm2"),
    "m3": ("l",),
    "m3/s": ("l/s", "l/min", "m3/h"),
    "kg": ("g", "t"),
    "kg/s": ("g/s", "kg/h"),
    "s": ("ms", "min", "h", "d"),
    "N": ("kN",),
    "J": ("kJ", "MJ", "kWh"),
    "W": ("kW", "MW", "mW"),
    "V": ("mV", "kV"),
    "A": ("mA", "kA"),
    "1": ("%",),
}
_SUPERSCRIPTS = str.maketrans("²³", "23")
_SPELLINGS = {"": "1", "°C": "degC", "°": "deg", "1/min": "rpm", "rev/min": "rpm", "m^2": "m2", "m^3": "m3"}


@dataclass(frozen=True, slots=True)
class DisplayUnit:
    """How a value is shown to people: ``shown = factor * value + offset`` (FMI 2.0, section 2.2.2).

    Parameters
    ----------
    name : str
        Name of the display unit, for example ``"deg"``.
    factor, offset : float
        Conversion from the unit of the variable.
    """

    name: str
    factor: float = 1.0
    offset: float = 0.0

    def from_unit(self, value: "NDArray[np.float64]") -> "NDArray[np.float64]":
        """Convert values in the variable's own unit to this unit (any shape)."""
        return self.factor * value + self.offset

    def to_unit(self, value: Any) -> Any:
        """Convert values in this unit, a number or an array, to the variable's own unit."""
        return (value - self.offset) / self.factor


def usual_display_units(unit: str) -> dict[str, DisplayUnit]:
    """Return the display units that values in a unit usually have, by name."""
    spelling = _SPELLINGS.get(unit, unit)
    shown = {name: display_unit(spelling, name) for name in _USUALLY_SHOWN_IN.get(spelling, ())}
    spelt = {other: replace(shown[name], name=other) for other, name in _SPELLINGS.items() if name in shown}
    return spelt | shown


@cache
def display_unit(unit: str, shown_in: str) -> DisplayUnit:
    """Return how values in one unit are shown in another one.

    Raises
    ------
    ValueError
        One of them is not known, or they are units of different quantities.
    """
    given, shown = (parse_unit(_spelt(name)) for name in (unit, shown_in))
    if given.exponents != shown.exponents:
        raise ValueError(f"{unit!r} and {shown_in!r} are units of different quantities")
    scale = _as_written(shown.factor)
    offset = (_as_written(given.offset) - _as_written(shown.offset)) / scale
    return DisplayUnit(shown_in, float(_as_written(given.factor) / scale), float(offset))


def is_unit(text: str) -> bool:
    """Whether a text is a unit that is known, in whatever spelling."""
    try:
        parse_unit(_spelt(text.strip()))
    except ValueError:
        return False
    return bool(text.strip())


def _spelt(unit: str) -> str:
    return _SPELLINGS.get(unit, unit.translate(_SUPERSCRIPTS))


def _as_written(number: float) -> Fraction:
    """Return 1/3.6 for the float that is next to it, so that its inverse is 3.6 to the last digit."""
    simple = Fraction(number).limit_denominator(10**7)
    return simple if float(simple) == number else Fraction(number)


def known_symbols() -> tuple[str, ...]:
    """Return the unit symbols that `parse_unit` knows, without prefixes."""
    return tuple(sorted([*_PREFIXED, *_PLAIN], key=str.lower))


def parse_unit(text: str) -> SIUnit:
    """Return the unit as a combination of SI base units.

    Parameters
    ----------
    text : str
        For example ``"N.m"``; empty or ``"1"`` for a dimensionless variable.

    Raises
    ------
    ValueError
        The text is not a unit, or names a symbol that is not known.
    """
    if not text:
        return SIUnit()
    tokens = list(_tokens(text.strip()))
    unit = _product(text, tokens)
    if tokens:
        raise ValueError(f"unit {text!r} cannot be read from {tokens[0][0]!r} on")
    return unit


def _tokens(text: str) -> Iterator[tuple[str, int]]:
    """Split into symbols with their exponents and marks (exponent 0)."""
    position = 0
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            raise ValueError(f"unit {text!r} cannot be read from {text[position:]!r} on")
        position = match.end()
        if match["symbol"]:
            yield match["symbol"], int(match["power"] or 1)
        else:
            yield match["one"] or match["mark"], 0


def _product(text: str, tokens: list[tuple[str, int]]) -> SIUnit:
    """Read factors up to the end or a closing parenthesis."""
    unit = _factor(text, tokens)
    while tokens and tokens[0][0] in "./*":
        mark, _ = tokens.pop(0)
        factor = _factor(text, tokens)
        if unit.offset or factor.offset:
            raise ValueError(f"unit {text!r}: a unit with an offset has no products (use K for differences)")
        unit = unit * factor ** (-1 if mark == "/" else 1)
    return unit


def _factor(text: str, tokens: list[tuple[str, int]]) -> SIUnit:
    if not tokens:
        raise ValueError(f"unit {text!r} ends where a unit symbol is missing")
    symbol, power = tokens.pop(0)
    if symbol == "(":
        unit = _product(text, tokens)
        if not tokens or tokens.pop(0)[0] != ")":
            raise ValueError(f"unit {text!r} lacks a closing parenthesis")
        return unit
    if symbol == "1":
        return SIUnit()
    unit = _lookup(symbol)
    return unit if power == 1 else unit**power


def _lookup(symbol: str) -> SIUnit:
    known = _PREFIXED | _PLAIN
    if symbol in known:
        return known[symbol]
    prefix, rest = symbol[0], symbol[1:]
    if prefix in _PREFIXES and rest in _PREFIXED:
        return SIUnit({}, _PREFIXES[prefix]) * _PREFIXED[rest]
    listing = ", ".join(known_symbols())
    raise ValueError(f"unknown unit symbol {symbol!r}; known: {listing}, and SI prefixes of them")
