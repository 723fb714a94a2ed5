"""What signals are by unit and name, and which values of them are plausible."""

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ddpc_cosim.inspection.words import is_cooling_setpoint, unit_of
from ddpc_cosim.variables import FloatArray, Variable
from fmu_plants.units import DisplayUnit, display_unit, parse_unit

_KELVIN = {"degK", "deg K", "kelvin", "Kelvin", "KELVIN"}
_CELSIUS = {"deg C", "degree C", "celsius", "Celsius", "degCelsius", "oC"}
_USUAL = {"K": 293.15, "Pa": 101325.0}
_COOLED_TO = 297.15  # K: at the setpoint of heating both would work against each other
_OF_DIFFERENCES = re.compile(r"d[A-Z]\w*|d[pPtT]|.*(?i:delta|diff|relative|gauge|error|deviation).*")
_SAID_OF_DIFFERENCES = re.compile(
    r"\b(difference|deviation|error|relative|gauge|drop|rise|increase|change|offset|correction|lift)\b", re.I
)
_NEGLIGIBLE = 1e-9
_PLAUSIBLE = (250.0, 400.0)  # K
_COMFORTABLE = (283.15, 308.15)  # K: of rooms, in which people live
_IN_A_ROOM = 294.15  # K
_WEATHER = 20.0  # K: what is outdoors goes so far from where it rests
_LIVEABLE = (230.0, 340.0)  # K: where a room is that may be as it should be
_ROOM = re.compile(
    r"\b(?:t?roo|zon)\b|room|zone|indoor|inside|interior|house|home|dwelling|office|building|flat|apartment"
)
# Amounts of something, in terms of the SI: there is never less than nothing.
_PRESSURE = {"kg": 1, "m": -1, "s": -2}
_AMOUNTS = (
    *({"kg": 1}, {"mol": 1}, {"m": 3}, {"m": -3}, {"mol": 1, "m": -3}, {"kg": 1, "m": -3}, _PRESSURE),
)
_OF_LEVELS = re.compile(r"levels?|fill|filling|holdup|depth|tank|reservoir")
_OF_AMOUNTS = re.compile(
    r"amounts?|populations?|concentrations?|conc|biomass|substrates?|density|number|volume|inventory|stock|"
    r"levels?|fill|filling|holdup|humidity|moisture|content|fraction|species|prey|predators?|infected|"
    r"susceptible|recovered|infectious|individuals|rabbits?|fox(?:es)?|cells|bacteria|dose|glucose|insulin"
)
_WORDS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")


@dataclass(frozen=True, slots=True)
class Plausible:
    """Which values of a signal are plausible, in its unit, and why no others."""

    low: float = -math.inf
    high: float = math.inf
    why: str = ""


def plausible(output: Variable, rest: float) -> Plausible:
    """Return which setpoints of an output are plausible, where it rests at a value.

    Parameters
    ----------
    output : Variable
        Its name, unit and description count.
    rest : float
        Where it rests: what it is by itself is plausible.
    """
    of_kelvin = _shown_in("K", unit_of(output))
    if of_kelvin and not is_difference(output):
        at_rest = float(of_kelvin.to_unit(rest))
        is_room = _is_room(output)
        for (low, high), what in ((_COMFORTABLE, "a room"), (_PLAUSIBLE, "a temperature")):
            if low <= at_rest <= high and (is_room or what != "a room"):
                ends = [float(f"{of_kelvin.factor * end + of_kelvin.offset:.12g}") for end in (low, high)]
                return Plausible(
                    ends[0], ends[1], f"{ends[0]:g} to {ends[1]:g} {unit_of(output)} are plausible of {what}"
                )
        zero = of_kelvin.offset
        return Plausible(zero, why="there is nothing below 0 K") if rest >= zero else Plausible()
    return Plausible(0.0, why="an amount is not negative") if _is_amount(output, rest) else Plausible()


def is_temperature(variable: Variable) -> bool:
    """Return whether a signal is a temperature, and not a difference of two."""
    return _shown_in("K", unit_of(variable)) is not None and not is_difference(variable)


def in_kelvin(variable: Variable, value: float) -> float:
    """Return a temperature above 0 K, in degrees of its unit; anything else as it is."""
    shown = _shown_in("K", unit_of(variable))
    return value - shown.offset if shown and not is_difference(variable) else value


def as_weather_goes(variable: Variable, level: float, low: float, high: float) -> tuple[float, float]:
    """Return limits of what acts from outside: a temperature goes no further from its level than weather."""
    shown = _shown_in("K", unit_of(variable))
    if shown is None or is_difference(variable):
        return low, high
    far = _WEATHER / (shown.to_unit(1.0) - shown.to_unit(0.0))
    return max(low, level - far), min(high, level + far)


def to_comfort(output: Variable, level: float) -> float:
    """Return how much a room at a level misses to be comfortable, in its unit; 0 of what is not a room."""
    if not is_temperature(output) or not _is_room(output):
        return 0.0
    (low, high), shown = _COMFORTABLE, _shown_in("K", unit_of(output))
    kelvin = float(shown.to_unit(level)) if shown else 0.0
    if shown is None or low <= kelvin <= high or not _LIVEABLE[0] <= kelvin <= _LIVEABLE[1]:
        return 0.0
    return (_IN_A_ROOM - kelvin) * shown.factor


def _is_room(output: Variable) -> bool:
    return bool(_ROOM.search(" ".join(words_of(output))))


def plausible_outputs(
    outputs: Sequence[Variable], rest: FloatArray, asked: Collection[str]
) -> tuple[tuple[Variable, ...], dict[str, str]]:
    """Return outputs whose limits are those of plausible setpoints, and what is to be said of such a limit.

    Parameters
    ----------
    outputs : sequence of Variable
        The outputs.
    rest : array, shape (p,)
        Where they rest.
    asked : collection of str
        Those whose setpoints are asked for: they keep their limits.
    """
    limited, whys = [], {}
    for output, level in zip(outputs, rest.tolist(), strict=True):
        limits = plausible(output, level)
        low, high = max(output.min, limits.low), min(output.max, limits.high)
        if limits.why and output.name not in asked and low < high:
            output, whys[output.name] = replace(output, min=low, max=high), limits.why
        limited.append(output)
    return tuple(limited), whys


def _is_amount(output: Variable, rest: float) -> bool:
    """Return whether a signal is an amount of something, going by its unit, or by its words."""
    if rest < 0.0 or -math.inf < output.min < 0.0 or is_difference(output):
        return False
    try:
        exponents = dict(parse_unit(unit_of(output)).exponents)
    except ValueError:
        exponents = {}
    if exponents in _AMOUNTS:
        return True
    said = _OF_LEVELS if exponents == {"m": 1} else _OF_AMOUNTS if not exponents else None
    return said is not None and any(said.fullmatch(word) for word in words_of(output))


def words_of(variable: Variable) -> list[str]:
    """Return the words of a signal's name and description: ``TRoomAir_y`` has T, room, air and y."""
    return [word.lower() for word in _WORDS.findall(f"{variable.name} {variable.description}")]


def is_difference(variable: Variable) -> bool:
    """Return whether a temperature or a pressure is one against another, which may well be 0."""
    return (
        -math.inf < variable.min < 0.0 == float(_shown_offset(variable))
        or any(_OF_DIFFERENCES.fullmatch(part) for part in re.split("[._]", variable.name))
        or bool(_SAID_OF_DIFFERENCES.search(variable.description))
    )


def _shown_offset(variable: Variable) -> float:
    shown = _shown_in("K", unit_of(variable))
    return shown.offset if shown else 0.0


def _shown_in(unit: str, other: str) -> DisplayUnit | None:
    """Return how values in an SI unit are shown in another one; None for one of another quantity."""
    other = "K" if other in _KELVIN else "degC" if other in _CELSIUS else other
    try:
        return display_unit(unit, other) if other not in ("", "1") else None
    except ValueError:
        return None


def usual_levels(
    inputs: Iterable[Variable], given: Collection[str], ranges: Mapping[str, tuple[float, float]]
) -> dict[str, float]:
    """Return levels of temperatures and absolute pressures that would start at 0 K or 0 Pa.

    Parameters
    ----------
    inputs : iterable of Variable
        All inputs.
    given : collection of str
        Those whose level is known.
    ranges : mapping of str to (float, float)
        Those that are asked for.

    Returns
    -------
    levels : dict of str to float
        The nominal value if there is one, else a usual one, in the unit of the input, by name.
    """
    levels = {}
    for variable in inputs:
        for unit, usual in _USUAL.items():
            shown = _shown_in(unit, unit_of(variable))
            if shown is None or variable.name in given or is_difference(variable):
                continue
            if abs(float(shown.to_unit(variable.start))) > _NEGLIGIBLE:
                continue
            if unit == "K" and is_cooling_setpoint(variable):
                usual = _COOLED_TO
            known = variable.nominal not in (0.0, 1.0) and math.isfinite(variable.nominal)
            level = variable.nominal if known else shown.factor * usual + shown.offset
            low, high = ranges.get(variable.name, (variable.min, variable.max))
            levels[variable.name] = float(f"{np.clip(level, low, high):.12g}")
    return levels


_LISTED = 4


def remarks_on(levels: Mapping[str, float], inputs: Iterable[Variable]) -> list[str]:
    """Return what is said of the inputs that start at such levels, those of a unit together."""
    units = {variable.name: unit_of(variable) for variable in inputs}
    groups: dict[tuple[str, float], list[str]] = {}
    for name, level in levels.items():
        groups.setdefault((units[name], level), []).append(name)
    return [_remark(names, unit, level) for (unit, level), names in groups.items()]


def _remark(names: list[str], unit: str, level: float) -> str:
    more = len(names) - _LISTED
    listed = ", ".join(names[:_LISTED]) + (f" and {more} more" if more > 0 else "")
    start, them = ("starts", "it") if len(names) == 1 else ("start", "them")
    zero = "0 " + next((si for si in _USUAL if _shown_in(si, unit)), unit)
    assigned = f"--at {names[0]}={level:g}" if len(names) == 1 else "--at NAME=VALUE or --at FILE.csv"
    return (
        f"{listed} {start} at {zero}, which can hardly be meant: tried at {level:g} {unit}; "
        f"give {assigned}, or what is right" + (f" for {them}" if len(names) > 1 else "")
    )
