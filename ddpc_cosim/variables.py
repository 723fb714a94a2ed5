"""Signals and parameters: their names, units, ranges and display units."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.errors import ConfigError, did_you_mean

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class DisplayUnit:
    """How a value is shown: ``shown = factor * value + offset``.

    Parameters
    ----------
    name : str
        Name of the display unit, for example ``"deg"``.
    factor, offset : float
        The conversion of FMI 2.0 (section 2.2.2), from the variable's own unit.
    """

    name: str
    factor: float = 1.0
    offset: float = 0.0

    def from_unit(self, value: FloatArray) -> FloatArray:
        """Convert values in the variable's own unit to this unit (any shape)."""
        return self.factor * value + self.offset


@dataclass(frozen=True, slots=True)
class Variable:
    """One input, output or parameter of a plant.

    Parameters
    ----------
    name : str
        Name in the plant.
    unit : str
        Unit of every value that is exchanged; empty if dimensionless or unknown.
    min, max : float
        Range that the plant declares; infinite where it declares none.
    nominal : float
        Typical magnitude.
    start : float
        Value before the first step; for an input its value at rest.
    description : str
        One line for people.
    display_unit : DisplayUnit or None
        Unit in which reports and metrics show the variable; None shows ``unit``.
    """

    name: str
    unit: str = ""
    min: float = -np.inf
    max: float = np.inf
    nominal: float = 1.0
    start: float = 0.0
    description: str = ""
    display_unit: DisplayUnit | None = None

    @property
    def shown_in(self) -> DisplayUnit:
        """The unit for people: the display unit, or the variable's own."""
        return self.display_unit or DisplayUnit(self.unit)

    @property
    def header(self) -> str:
        """The variable's column header in files: name and unit."""
        return f"{self.name} [{self.unit or '1'}]"


def names(variables: Sequence[Variable]) -> tuple[str, ...]:
    """Return the names of the variables, in order."""
    return tuple(variable.name for variable in variables)


# unit: {display unit: (factor, offset)}, shown = factor * value + offset
_USUAL: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "rad": {"deg": (180 / math.pi, 0.0), "rev": (0.5 / math.pi, 0.0)},
    "rad/s": {"deg/s": (180 / math.pi, 0.0), "rpm": (30 / math.pi, 0.0)},
    "K": {"degC": (1.0, -273.15), "degF": (1.8, -459.67)},
    "Pa": {"bar": (1e-5, 0.0), "mbar": (1e-2, 0.0), "kPa": (1e-3, 0.0), "MPa": (1e-6, 0.0)},
    "m": {"mm": (1e3, 0.0), "cm": (1e2, 0.0), "km": (1e-3, 0.0)},
    "m/s": {"km/h": (3.6, 0.0), "mm/s": (1e3, 0.0)},
    "m2": {"cm2": (1e4, 0.0), "mm2": (1e6, 0.0)},
    "m3": {"l": (1e3, 0.0)},
    "m3/s": {"l/s": (1e3, 0.0), "l/min": (6e4, 0.0), "m3/h": (3600.0, 0.0)},
    "kg": {"g": (1e3, 0.0), "t": (1e-3, 0.0)},
    "kg/s": {"g/s": (1e3, 0.0), "kg/h": (3600.0, 0.0)},
    "s": {"ms": (1e3, 0.0), "min": (1 / 60, 0.0), "h": (1 / 3600, 0.0), "d": (1 / 86400, 0.0)},
    "N": {"kN": (1e-3, 0.0)},
    "J": {"kJ": (1e-3, 0.0), "MJ": (1e-6, 0.0), "kWh": (1 / 3.6e6, 0.0)},
    "W": {"kW": (1e-3, 0.0), "MW": (1e-6, 0.0), "mW": (1e3, 0.0)},
    "V": {"mV": (1e3, 0.0), "kV": (1e-3, 0.0)},
    "A": {"mA": (1e3, 0.0), "kA": (1e-3, 0.0)},
    "1": {"%": (100.0, 0.0)},
}
_SPELLINGS = {"": "1", "°C": "degC", "°": "deg", "1/min": "rpm", "rev/min": "rpm", "m^2": "m2", "m^3": "m3"}


def conversions(unit: str, defined: Iterable[DisplayUnit] = ()) -> dict[str, DisplayUnit]:
    """Return the units in which values in a unit can be shown, by name.

    Parameters
    ----------
    unit : str
        The variable's own unit.
    defined : iterable of DisplayUnit
        The display units that the FMU defines for it; they count before the usual ones.
    """
    usual = _USUAL.get(_SPELLINGS.get(unit, unit), {})
    spelt = {other: usual[name] for other, name in _SPELLINGS.items() if name in usual}
    known = {name: DisplayUnit(name, *conversion) for name, conversion in (spelt | dict(usual)).items()}
    return known | {shown.name: shown for shown in defined} | {unit: DisplayUnit(unit)}


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
            if name not in known:
                options = did_you_mean(name, known)
                faults.append(f'{variable.name}: no conversion from "{variable.unit}" to "{name}"; {options}')
                continue
            variable = replace(variable, display_unit=known[name])
        shown.append(variable)
    if faults:
        raise ConfigError(faults)
    return tuple(shown)
