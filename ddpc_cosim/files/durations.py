"""Times as people say them: ``"1 h 30 min"``, ``"14 d"``, and moments of a year such as ``"day 23"``."""

import re
from datetime import date, datetime, time
from decimal import Decimal
from typing import Any

from fmu_plants.spelling import did_you_mean

_SECONDS: dict[str, Decimal] = {"ms": Decimal("0.001"), "s": Decimal(1)}
_SECONDS |= {"min": Decimal(60), "h": Decimal(3600), "d": Decimal(86400)}
_SPELLINGS = {
    "sec": "s",
    "second": "s",
    "seconds": "s",
    "minute": "min",
    "minutes": "min",
    "hour": "h",
    "hours": "h",
    "day": "d",
    "days": "d",
}
_NUMBER = r"\d+(?:\.\d*)?(?:[eE][+-]?\d{1,3})?"
_PART = re.compile(rf"\s*({_NUMBER})\s*([A-Za-z]+)\s*")
_DAY = re.compile(r"day\s+(\d{1,3})")
_DATE = re.compile(r"\d{4}-\d")
_LARGEST = 1e15  # up to which every whole second is a number

EXPECTED = 'a number of seconds, or a duration such as "15 min", "1 h 30 min" or "14 d"'
"""What stands where a number in seconds is wanted, in words."""
EXPECTED_MOMENT = f'{EXPECTED}, or a date such as "2026-01-23" or "2026-01-23T06:00", or "day 23"'
"""The same of a moment."""
DURATION_SCHEMA = {"type": "string", "pattern": rf"^\s*-?(\s*{_NUMBER}\s*[A-Za-z]+\s*)+$"}
"""A duration as JSON Schema."""
MOMENT_SCHEMA = {"type": "string", "pattern": r"^(\d{4}-\d{2}-\d{2}([T ].*)?|day\s+\d{1,3})$"}
"""A date or a day as JSON Schema, in which TOML's own dates are texts too."""


def seconds_of(text: str) -> float:
    """Return a duration [s] that is said in words: parts such as ``1 h 30 min``, or ``0.5 h``.

    Raises
    ------
    ValueError
        It is not one, and what is wrong with it.
    """
    sign, rest = (-1, text.strip()[1:]) if text.strip().startswith("-") else (1, text.strip())
    total, units, end = Decimal(0), list[str](), 0
    while end < len(rest) and (part := _PART.match(rest, end)):
        unit = _SPELLINGS.get(part[2], part[2])
        if unit not in _SECONDS:
            raise ValueError(f'no unit of time "{part[2]}"; {did_you_mean(part[2], _SECONDS)}')
        if unit in units:
            raise ValueError(f'"{unit}" is there twice')
        units.append(unit)
        total += Decimal(part[1]) * _SECONDS[unit]
        end = part.end()
    if not units or end < len(rest):
        raise ValueError("it is not a duration")
    return float(sign * total)


def moment_of(value: Any) -> Any:
    """Return a date, or the day of a year, as seconds from the start of its year; anything else as it is.

    Parameters
    ----------
    value : date, datetime, str or object
        A text may be a date in the form of ISO 8601, ``day 23``, of which the first is 1 January, or a
        duration.

    Raises
    ------
    ValueError
        A text is none of these.
    """
    if isinstance(value, str):
        return _moment_in(value.strip())
    if isinstance(value, date):  # as a datetime is
        begin = datetime.combine(value, time()) if not isinstance(value, datetime) else value
        return (begin - datetime(begin.year, 1, 1, tzinfo=begin.tzinfo)).total_seconds()
    return value


def _moment_in(text: str) -> float:
    if day := _DAY.fullmatch(text):
        if not 1 <= int(day[1]) <= 366:
            raise ValueError(f'must be "day 1", which is 1 January, to "day 366", got {text!r}')
        return (int(day[1]) - 1) * 86400.0
    try:
        return float(moment_of(datetime.fromisoformat(text)))
    except ValueError as error:
        if _DATE.match(text):
            needed = 'must be a date of the calendar, as "2026-01-23" or "2026-01-23T06:00"'
            raise ValueError(f"{needed}, got {text[:100]!r}: {error}") from error
    try:
        return seconds_of(text)
    except ValueError as error:
        raise ValueError(f"must be {EXPECTED_MOMENT}, got {text[:100]!r}") from error


def in_words(seconds: float) -> str:
    """Return a time [s] with the units that suit it: ``0.1 s``, ``15 min``, ``1 h 30 min``, ``14 d``.

    :func:`seconds_of` gives it back. What is less than an hour and not whole minutes is in seconds.
    """
    if seconds < 0:
        return f"-{in_words(-seconds)}"
    is_whole = seconds < _LARGEST and float(seconds).is_integer()
    if not is_whole or seconds < 60 or (seconds < 3600 and seconds % 60):
        return f"{int(seconds) if is_whole else repr(float(seconds))} s"
    parts, left = list[str](), int(seconds)
    for unit in ("d", "h", "min", "s"):
        count, left = divmod(left, int(_SECONDS[unit]))
        parts += [f"{count} {unit}"] if count else []
    return " ".join(parts)


def shown(seconds: float) -> str:
    """Return a computed time [s] as :func:`in_words` does, without what rounding leaves of it."""
    return in_words(float(f"{seconds:.9g}"))


def about(seconds: float) -> str:
    """Return a time [s] roughly: ``9.6 s``, ``45 s``, ``12 min``, ``3.4 h``, ``14 d``."""
    if seconds < 90:
        return f"{seconds:.0f} s" if seconds >= 10 else f"{seconds:.1f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h" if seconds < 2 * 86400 else f"{seconds / 86400:.3g} d"
