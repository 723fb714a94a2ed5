"""Sweeps: values to try, their combinations, and the names of what comes of them."""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from ddpc_cosim.errors import Place
from ddpc_cosim.files.texts import toml_tables

ZIP = "zip"
MOST_VARIANTS = 1000
_LONGEST_NAME = 60
_RANGES: dict[str, Callable[..., Any]] = {"linear": np.linspace, "log": np.geomspace}
_EXPECTED = "must be a list of values, { linear = [first, last, count] } or { log = [first, last, count] }"


def swept_values(value: Any) -> Any:
    """Return the values that a sweep gives as a list or a range; a boolean, as of ``zip``, as it is.

    Raises
    ------
    ValueError
        It is neither.
    """
    if isinstance(value, list | bool):
        return value
    if not (isinstance(value, dict) and len(value) == 1 and value.keys() <= _RANGES.keys()):
        raise ValueError(f"{_EXPECTED}, got {value!r}"[:300])
    ((kind, given),) = value.items()
    numbers = (
        isinstance(given, list) and len(given) == 3 and all(type(number) in (int, float) for number in given)
    )
    if not numbers or not all(map(math.isfinite, given)) or type(given[2]) is not int or given[2] < 1:
        raise ValueError(f"{_EXPECTED}, got {value!r}"[:300])
    first, last, count = given
    if count > MOST_VARIANTS:
        raise ValueError(f"{count} values are too many; allowed: {MOST_VARIANTS}")
    if kind == "log" and not first * last > 0:
        raise ValueError(f"first and last of log must have the same sign, got {first:g} and {last:g}")
    # So many digits that one reads what was meant: 0.3 and not 0.30000000000000004.
    values = [float(f"{number:.12g}") for number in _RANGES[kind](first, last, count)]
    integers = type(first) is type(last) is int and all(map(float.is_integer, values))
    return [int(number) for number in values] if integers else values


def path_of(key: str) -> Place | None:
    """Return the place that a path names: ``scenarios.windy.events[0].time``; None if it is not one."""
    try:
        tables: Any = toml_tables(re.sub(r"\[(\d+)\]", r".\1", key) + " = 0")
    except ValueError:
        return None
    path: Place = ()
    while isinstance(tables, dict):
        if len(tables) != 1:
            return None
        ((first, tables),) = tables.items()
        path = (*path, first)
    return path


def sweep_errors(table: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with a table of a sweep: the key (empty: the table), and what."""
    values = {key: value for key, value in table.items() if key != ZIP}
    if not isinstance(table.get(ZIP, False), bool):
        yield ZIP, "must be true or false"
    for key, value in values.items():
        if not isinstance(value, list):
            yield key, f"{_EXPECTED}, got {value!r}"
        elif not value:
            yield key, "no values"
    lengths = {key: len(value) for key, value in values.items() if isinstance(value, list)}
    if table.get(ZIP) is True and len(set(lengths.values())) > 1:
        listed = ", ".join(f"{key} {length}" for key, length in lengths.items())
        yield "", f"zip needs as many values of each, got {listed}"


def count(tables: Sequence[Mapping[str, Any]]) -> int:
    """Return how many combinations tables have."""
    lengths = [(table, [len(v) for v in table.values() if isinstance(v, list)]) for table in tables]
    return sum(
        min(counts, default=0) if table.get(ZIP) is True else math.prod(counts) for table, counts in lengths
    )


def combinations(table: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the combinations of a table's values: all, or the first of each, the second of each ..."""
    keys = [key for key in table if key != ZIP]
    together = zip if table.get(ZIP) is True else product
    for values in together(*(table[key] for key in keys)):
        yield dict(zip(keys, values, strict=True))


def variant_name(name: str, varied: Mapping[str, Any], number: int) -> str:
    """Return a readable name; a number where the values make it too long for a file's name."""
    words = {key: in_words(value) for key, value in varied.items()}
    parts = (re.sub(r"[^A-Za-z0-9._-]+", "", f"{key}-{value}") for key, value in words.items())
    readable = "-".join([name, *parts])
    return readable if len(readable) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 5]}-{number}"


def variant_label(label: str, varied: Mapping[str, Any]) -> str:
    """Return a label with what a variant differs in: ``DeePC, lambda_g = 5``."""
    return f"{label}, {variant_words(varied)}"


def variant_words(varied: Mapping[str, Any]) -> str:
    """Return what a variant differs in."""
    return ", ".join(f"{key} = {in_words(value)}" for key, value in varied.items())


def in_words(value: Any) -> str:
    """Return a value of a sweep as names and labels have it."""
    if isinstance(value, dict):
        return " ".join(f"{key} {in_words(entry)}" for key, entry in value.items())
    return f"{value:g}" if isinstance(value, float) else str(value)
