"""Numbers and units as people read them in print."""

import math
from collections.abc import Iterable, Sequence
from statistics import median
from typing import NamedTuple

from ddpc_cosim.files.texts import clipped, in_words

MISSING = "\N{EN DASH}"
MINUS = "\N{MINUS SIGN}"
TIMES = "\N{MULTIPLICATION SIGN}"
_FIGURE_SPACE = "\u2007"
_PUNCTUATION_SPACE = "\u2008"
_NARROW_SPACE = "\u202f"
_SUPERSCRIPT = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")
_LARGEST_PLAIN, _SMALLEST_PLAIN = 1e6, 1e-3
_MOST_DIGITS, _MOST_DECIMALS = 7, 6

_UNIT_SYMBOLS = {"deg": "°", "degC": "°C", "Ohm": "Ω", "us": "µs", "1": "", "percent": "%"}

_DIFFERENCES = {"degC": "K", "degF": "°F"}


class Scale(NamedTuple):
    """A unit for a column of values, and the factor that brings the values to it."""

    unit: str
    factor: float


_TIME_SCALES = (Scale("ns", 1e9), Scale("µs", 1e6), Scale("ms", 1e3), Scale("s", 1.0))


def unit_symbol(unit: str) -> str:
    """Return a unit of an FMU in print: ``N.m`` becomes ``N·m``, ``deg`` ``°``, ``m/s2`` ``m/s²``."""
    numerator, slash, denominator = clipped(unit, 30).partition("/")
    return _factors(numerator) + slash + _factors(denominator)


def difference_symbol(unit: str) -> str:
    """Return the symbol for a difference of two values: of temperatures in degC, it is in K.

    So it is of a difference times a time.
    """
    difference, point, time = unit.rpartition(".")
    if point and difference in _DIFFERENCES and time in ("s", "h"):
        return f"{_DIFFERENCES[difference]}\u00b7{time}"
    return _DIFFERENCES.get(unit) or unit_symbol(unit)


def _factors(product: str) -> str:
    return "·".join(_factor(factor) for factor in product.split("."))


def _factor(factor: str) -> str:
    base = factor.rstrip("-0123456789")
    power = factor[len(base) :]
    return _UNIT_SYMBOLS.get(factor, _UNIT_SYMBOLS.get(base, base) + power.translate(_SUPERSCRIPT))


def with_unit(number: str, unit: str) -> str:
    """Join a number and a unit symbol: a narrow space between them, none before a degree sign alone."""
    if not unit or number == MISSING:
        return number
    return f"{number}°" if unit == "°" else f"{number}\u00a0{unit}"


def significant(value: float, digits: int = 4) -> str:
    """Write a number with a count of significant digits; very large and small ones with a power of ten."""
    if math.isnan(value):
        return MISSING
    if math.isinf(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    if value == 0:
        return "0"
    rounded = float(f"{value:.{digits - 1}e}")
    if not _SMALLEST_PLAIN <= abs(rounded) < _LARGEST_PLAIN:
        return _scientific(rounded, digits)
    return fixed(value, max(digits - 1 - _exponent(rounded), 0))


def apart(low: float, high: float, digits: int = 3) -> tuple[str, str]:
    """Write two ends with so many significant digits, and more where they would read the same."""
    texts = significant(low, digits), significant(high, digits)
    if texts[0] != texts[1] or digits >= _MOST_DIGITS:
        return texts
    return apart(low, high, digits + 1)


def fixed(value: float, decimals: int) -> str:
    """Write a finite number with a count of decimals, thousands apart, and a true minus sign."""
    text = f"{value:,.{decimals}f}".replace(",", _NARROW_SPACE)
    return text.replace("-", MINUS) if float(f"{value:.{decimals}f}") != 0 else text.lstrip("-")


def as_given(value: float) -> str:
    """Write a number with the digits it was given with, as a publication prints it."""
    text = significant(value, given_digits(value))
    # 10^7 says as much as 1 x 10^7.
    return text.removeprefix(f"1{_NARROW_SPACE}{TIMES}{_NARROW_SPACE}")


def computed(value: float) -> float:
    """Return a number without what rounding leaves of a product or a conversion: with twelve digits."""
    return float(f"{value:.12g}")


def given_digits(value: float) -> int:
    """Return the count of significant digits that a number was given with."""
    mantissa = repr(float(value)).partition("e")[0]
    return max(len(mantissa.replace(".", "").replace("-", "").strip("0")), 1)


def like(value: float, model: float) -> str:
    """Write a number with the decimals of another; a smaller one that would lose its digits with three."""
    text = as_given(model)
    decimals = len(text.partition(".")[2])
    if TIMES in text or not math.isfinite(value) or abs(value) < 10.0 ** (1 - decimals):
        return significant(value, given_digits(model) if TIMES in text else 3)
    return fixed(value, decimals)


def integer(value: float) -> str:
    """Write a count; a value that does not exist as a dash."""
    return MISSING if math.isnan(value) else fixed(value, 0)


def percent(ratio: float) -> str:
    """Write a deviation given as a ratio in percent, with its sign."""
    if not math.isfinite(ratio):
        return MISSING
    value = 100 * ratio
    text = fixed(abs(value), 1 if abs(value) < 99.95 else 0)
    sign = "" if float(text.replace(_NARROW_SPACE, "")) == 0 else MINUS if value < 0 else "+"
    return f"{sign}{text}\u00a0%"


def time_scale(seconds: Iterable[float]) -> Scale:
    """Choose the unit in which most of the given times [s] are between 1 and 1000."""
    known = [value for value in seconds if math.isfinite(value) and value > 0]
    typical = median(known) if known else 1.0
    return next((scale for scale in _TIME_SCALES if typical * scale.factor < 1000), _TIME_SCALES[-1])


def given_duration(seconds: float) -> str:
    """Write a time that was given, such as a sampling time, with its own digits: ``20 ms``, ``15 min``."""
    if seconds >= 60:
        return given_time(seconds)
    scale = time_scale([seconds])
    # Fifteen digits hide the rounding of the product.
    return with_unit(as_given(float(f"{seconds * scale.factor:.15g}")), scale.unit)


def given_time(seconds: float) -> str:
    """Write a time of a run that was given, with its own digits: ``0.1 s``, ``1 h 30 min``, ``14 d``."""
    return (
        with_unit(as_given(seconds), "s") if abs(seconds) < 60 else in_words(seconds).replace(" ", "\u00a0")
    )


def duration(seconds: float) -> str:
    """Write one time with the unit that suits it: ``65.5 µs``."""
    if math.isnan(seconds):
        return MISSING
    scale = time_scale([seconds])
    return with_unit(significant(seconds * scale.factor, 3), scale.unit)


def column(values: Sequence[float], digits: int = 4) -> list[str]:
    """Write a column of numbers with one number of decimals, their points in line.

    The typical value gets ``digits`` significant digits, and the least two where that takes no more than two
    decimals more; the largest has seven digits at most. Only what would read 0 and is not, and what takes
    more than six digits before the point, is written with a power of ten.
    """
    sizes = [abs(value) for value in values if math.isfinite(value) and value != 0]
    if all(float(size).is_integer() for size in sizes):
        return align([_in_column(value, 0) for value in values])
    typical, least = digits - 1 - _exponent(median(sizes)), 1 - _exponent(min(sizes))
    largest = max((size for size in sizes if size < _LARGEST_PLAIN), default=1.0)
    room = _MOST_DIGITS - 1 - max(_exponent(largest), 0)
    wanted = least if typical < least <= typical + 2 else typical
    decimals = min(max(wanted, 0), room, _MOST_DECIMALS)
    return align([_in_column(value, decimals) for value in values])


def _in_column(value: float, decimals: int) -> str:
    if not math.isfinite(value) or abs(value) >= _LARGEST_PLAIN:
        return significant(value)
    is_lost = value != 0 and not float(f"{value:.{decimals}f}")
    return _scientific(float(f"{value:.1e}"), 2) if is_lost else fixed(value, decimals)


def align(numbers: Sequence[str]) -> list[str]:
    """Pad numbers on the right so that their points are in line, flush right in tabular figures."""
    tails = ["" if _stands_alone(number) else number.partition(".")[2] for number in numbers]
    longest = max(map(len, tails), default=0)
    return [_pad(number, len(tail), longest) for number, tail in zip(numbers, tails, strict=True)]


def _pad(number: str, decimals: int, longest: int) -> str:
    if not longest or _stands_alone(number):
        return number
    point = "" if decimals else _PUNCTUATION_SPACE
    return number + point + _FIGURE_SPACE * (longest - decimals)


def _stands_alone(number: str) -> bool:
    """Whether a cell has no decimal point to line up with the others."""
    return TIMES in number or number == MISSING


def _exponent(value: float) -> int:
    return math.floor(math.log10(abs(value)))


def _scientific(value: float, digits: int) -> str:
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    power = str(int(exponent)).translate(_SUPERSCRIPT)
    return f"{mantissa}{_NARROW_SPACE}{TIMES}{_NARROW_SPACE}10{power}".replace("-", MINUS)
