"""Signals and parameters: their names, units, ranges and display units."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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

    def to_unit(self, value: FloatArray) -> FloatArray:
        """Convert values in this unit to the variable's own unit (any shape)."""
        return (value - self.offset) / self.factor


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
