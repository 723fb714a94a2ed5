"""A plant written once: its variables and the right-hand side of its differential equations.

Nothing here needs SymPy, so that a plant's variables can be read without the cost of its import; the
equations are a function that is called with symbols when the plant is exported.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Any, Literal, Protocol

from fmu_plants.validation import check_model


class Symbols(Protocol):
    """What the equations are written in: one SymPy symbol per variable, and ``time``.

    ``v.angle`` and ``v["angle"]`` are the symbol of the variable `angle`, ``v.time`` is the time in s.
    """

    def __getattr__(self, name: str) -> Any:
        """Return the symbol of a variable."""

    def __getitem__(self, name: str) -> Any:
        """Return the symbol of a variable whose name is not known beforehand, or is a Python keyword."""


@dataclass(frozen=True, slots=True)
class Equations:
    """The right-hand side at one instant, in SymPy expressions.

    Parameters
    ----------
    derivatives : mapping of str to expression
        Time derivative of every state, by name of the state.
    outputs : mapping of str to expression
        Every output that is not itself a state, by name.
    """

    derivatives: Mapping[str, Any]
    outputs: Mapping[str, Any] = field(default_factory=dict)


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


@dataclass(frozen=True, slots=True)
class Variable:
    """A state, input or output.

    Parameters
    ----------
    name : str
        An identifier, unique in the model.
    unit : str
        Unit of every value, for example ``"N.m"`` or ``"m/s2"``; empty if dimensionless.
    min, max : float
        Range in which the plant is meant to work; infinite if there is no limit. Nothing is saturated.
    nominal : float
        Typical magnitude, > 0; the absolute tolerance of a state is in units of it.
    start : float
        Value before the first step. An output that is computed has none, whatever stands here.
    description : str
        One line for people.
    display_unit : DisplayUnit or None
        The unit people are shown; None shows `unit`.
    """

    name: str
    unit: str = ""
    min: float = -inf
    max: float = inf
    nominal: float = 1.0
    start: float = 0.0
    description: str = ""
    display_unit: DisplayUnit | None = None


@dataclass(frozen=True, slots=True)
class Parameter(Variable):
    """A constant of the equations; `start` is its default value.

    Parameters
    ----------
    variability : {"fixed", "tunable"}
        Whether it can be set before the simulation only, or between any two communication steps.
    """

    variability: Literal["fixed", "tunable"] = "fixed"


@dataclass(frozen=True, kw_only=True)
class PlantModel:
    """A plant: its variables, its equations, and where they come from.

    Parameters
    ----------
    name : str
        A C identifier; names the FMU and its library.
    description : str
        One line for people.
    source : str
        Where the equations and the nominal values are taken from.
    states, inputs, outputs : tuple of Variable
        An output that is a state is the same `Variable` in both; `equations` compute every other output.
    parameters : tuple of Parameter
        Constants that a user of the FMU can change.
    equations : callable
        Gets the symbols of all variables, returns `Equations`. Called at export only, so that SymPy functions
        can be imported inside.
    step_size, stop_time : float
        Suggested communication step size and duration, s.

    Raises
    ------
    ModelError
        Names are doubled or no identifiers, units are unknown, values out of range: all faults at once.
    """

    name: str
    equations: Callable[[Symbols], Equations]
    states: tuple[Variable, ...] = ()
    inputs: tuple[Variable, ...] = ()
    outputs: tuple[Variable, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    description: str = ""
    source: str = ""
    step_size: float = 0.1
    stop_time: float = 10.0

    def __post_init__(self) -> None:
        """Refuse a model that contradicts itself."""
        check_model(self)

    @property
    def computed_outputs(self) -> tuple[Variable, ...]:
        """The outputs that are not themselves states."""
        states = {state.name for state in self.states}
        return tuple(output for output in self.outputs if output.name not in states)
