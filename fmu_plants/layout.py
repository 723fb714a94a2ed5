"""Which scalar variables the FMU has, and in which order: one layout for the C code and for the description.

The blocks follow one another as `runtime/model.h` has them: time, states, derivatives, inputs, computed
outputs, parameters. The value reference of a variable is its position.
"""

import re
from dataclasses import dataclass
from enum import Enum

from fmu_plants.model import Parameter, PlantModel, Variable
from fmu_plants.units import parse_unit
from fmu_plants.validation import TIME

_PER_SECOND = re.compile(r"(?P<rest>.+)/s(?P<power>\d*)")


class Kind(Enum):
    """The role of a scalar variable; the values are the names in `runtime/model.h`."""

    TIME = "VARIABLE_TIME"
    STATE = "VARIABLE_STATE"
    DERIVATIVE = "VARIABLE_DERIVATIVE"
    INPUT = "VARIABLE_INPUT"
    OUTPUT = "VARIABLE_OUTPUT"
    FIXED_PARAMETER = "VARIABLE_FIXED_PARAMETER"
    TUNABLE_PARAMETER = "VARIABLE_TUNABLE_PARAMETER"


@dataclass(frozen=True, slots=True)
class Scalar:
    """A scalar variable of the FMU: its role and its attributes."""

    kind: Kind
    variable: Variable


def derivative_name(state: str) -> str:
    """Return the name of a state's derivative, as FMI's structured naming convention has it."""
    return f"der({state})"


def _derivative_unit(unit: str) -> str:
    """Return the unit of a derivative by time: rad -> rad/s, m/s -> m/s2, degC -> K/s."""
    if parse_unit(unit).offset:
        return "K/s"
    if match := _PER_SECOND.fullmatch(unit):
        return f"{match['rest']}/s{int(match['power'] or 1) + 1}"
    return f"{unit or '1'}/s"


def _parameter_kind(parameter: Parameter) -> Kind:
    return Kind.TUNABLE_PARAMETER if parameter.variability == "tunable" else Kind.FIXED_PARAMETER


def scalars(model: PlantModel) -> tuple[Scalar, ...]:
    """Return all scalar variables of the model's FMU, in the order of their value references."""
    derivatives = [
        Variable(
            derivative_name(state.name),
            _derivative_unit(state.unit),
            nominal=state.nominal,
            description=f"Time derivative of {state.name}",
        )
        for state in model.states
    ]
    return (
        Scalar(Kind.TIME, Variable(TIME, "s", description="Simulated time")),
        *(Scalar(Kind.STATE, variable) for variable in model.states),
        *(Scalar(Kind.DERIVATIVE, variable) for variable in derivatives),
        *(Scalar(Kind.INPUT, variable) for variable in model.inputs),
        *(Scalar(Kind.OUTPUT, variable) for variable in model.computed_outputs),
        *(Scalar(_parameter_kind(parameter), parameter) for parameter in model.parameters),
    )
