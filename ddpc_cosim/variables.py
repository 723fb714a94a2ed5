"""Signals and parameters: their names, units, ranges and display units."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.errors import ConfigError
from fmu_plants.model import Variable as Variable
from fmu_plants.spelling import did_you_mean
from fmu_plants.units import DisplayUnit as DisplayUnit, display_unit, usual_display_units

FloatArray = NDArray[np.float64]


def names(variables: Sequence[Variable]) -> tuple[str, ...]:
    """Return the names of the variables, in order."""
    return tuple(variable.name for variable in variables)


def not_names(what: str, given: Any) -> str:
    """Return why something is not a list of names; empty if it is. A text is not a list of letters."""
    is_list = isinstance(given, Iterable) and not isinstance(given, str | Iterator)
    if is_list and all(isinstance(name, str) for name in given):
        return ""
    return f'{what} = {given!r} is not possible; needed: a list of names, such as ["y"]'


def unknown_names(what: str, given: Iterable[str], known: Sequence[str]) -> list[str]:
    """Return a fault for every given name that is not among the known ones."""
    return [f'{what}: no signal "{name}"; {did_you_mean(name, known)}' for name in given if name not in known]


def conversions(unit: str, defined: Iterable[DisplayUnit] = ()) -> dict[str, DisplayUnit]:
    """Return the units in which values in a unit can be shown, by name.

    Parameters
    ----------
    unit : str
        The variable's own unit.
    defined : iterable of DisplayUnit
        The display units that the FMU defines for it; they count before the usual ones.
    """
    return usual_display_units(unit) | {shown.name: shown for shown in defined} | {unit: DisplayUnit(unit)}


def unit_shown(variable: Variable, unit: str) -> DisplayUnit:
    """Return how a variable's values are shown in a unit.

    Raises
    ------
    ConfigError
        It is neither the variable's unit nor its display unit, and not a unit of the same quantity.
    """
    unit_of_variable = variable.unit
    if unit in ("", unit_of_variable) or {unit, unit_of_variable} == {"", "1"}:
        return DisplayUnit(unit_of_variable)
    declared = () if variable.display_unit is None else (variable.display_unit,)
    known = conversions(unit_of_variable, declared)
    try:
        return known[unit] if unit in known else display_unit(unit_of_variable, unit)
    except ValueError as error:
        allowed = dict.fromkeys((unit_of_variable or "1", *(shown.name for shown in declared), *known))
        units = ", ".join(name for name in allowed if name)
        raise ConfigError(f'unit "{unit}" does not fit {variable.name}; allowed: {units}') from error


def converter(variable: Variable, unit: str, *, difference: bool = False) -> Callable[[Any], Any]:
    """Return the conversion of values, numbers or arrays, from ``unit`` to the variable's own unit.

    Differences of values, such as what is added to a signal, convert without the offset of the unit: 5 degC
    more are 5 K more.

    Raises
    ------
    ConfigError
        It is neither the variable's unit nor its display unit, and not a unit of the same quantity.
    """
    shown = unit_shown(variable, unit)
    return (replace(shown, offset=0.0) if difference else shown).to_unit


def with_display_units(
    variables: Iterable[Variable],
    wanted: Mapping[str, str],
    defined: Mapping[str, tuple[DisplayUnit, ...]],
) -> tuple[Variable, ...]:
    """Return variables with other display units.

    Parameters
    ----------
    variables : iterable of Variable
        The variables.
    wanted : mapping of str to str
        Names of display units, by variable; others keep theirs.
    defined : mapping of str to tuple of DisplayUnit
        The display units that the FMU defines, by unit.

    Raises
    ------
    ConfigError
        There is no such conversion; all faults at once, with the conversions there are.
    """
    shown, faults = [], []
    for variable in variables:
        if variable.name in wanted:
            known = conversions(variable.unit, defined.get(variable.unit, ()))
            name = wanted[variable.name]
            with suppress(ValueError):  # of another quantity, or not known
                known.setdefault(name, display_unit(variable.unit, name))
            if name not in known:
                options = did_you_mean(name, known)
                faults.append(f'{variable.name}: no conversion from "{variable.unit}" to "{name}"; {options}')
                continue
            variable = replace(variable, display_unit=known[name])
        shown.append(variable)
    if faults:
        raise ConfigError(faults)
    return tuple(shown)


def with_nominal(variables: Iterable[Variable], nominal: Mapping[str, float]) -> tuple[Variable, ...]:
    """Return variables with other nominal values, by name."""
    return tuple(replace(v, nominal=nominal.get(v.name, v.nominal)) for v in variables)


def with_start(variables: Iterable[Variable], start: Mapping[str, float]) -> tuple[Variable, ...]:
    """Return variables with other start values, by name."""
    return tuple(replace(v, start=start.get(v.name, v.start)) for v in variables)
