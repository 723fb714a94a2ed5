"""What a plant model must satisfy before anything is made of it."""

import re
from collections.abc import Iterator
from itertools import chain
from math import isfinite, isnan
from typing import TYPE_CHECKING

from fmu_plants.errors import ModelError
from fmu_plants.units import parse_unit

if TYPE_CHECKING:
    from fmu_plants.model import PlantModel, Variable

_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
TIME = "time"


def check_model(model: "PlantModel") -> None:
    """Raise a `ModelError` with every fault of the model."""
    faults = list(chain(_structure_faults(model), _name_faults(model), _variable_faults(model)))
    if faults:
        raise ModelError.from_faults(model.name, faults)


def _structure_faults(model: "PlantModel") -> Iterator[str]:
    if not _IDENTIFIER.fullmatch(model.name):
        yield f"its name {model.name!r} is not an identifier (letters, digits and _, no digit first)"
    if not model.outputs:
        yield "it has no outputs"
    if not callable(model.equations):
        yield "equations must be a function of the symbols"
    if not (isfinite(model.step_size) and model.step_size > 0):
        yield f"step_size must be positive and finite, not {model.step_size}"
    if not (isfinite(model.stop_time) and model.stop_time > 0):
        yield f"stop_time must be positive and finite, not {model.stop_time}"


def _name_faults(model: "PlantModel") -> Iterator[str]:
    seen: dict[str, str] = {}
    groups = {
        "state": model.states,
        "input": model.inputs,
        "output": model.outputs,
        "parameter": model.parameters,
    }
    states = {state.name: state for state in model.states}
    for group, variables in groups.items():
        for variable in variables:
            name = variable.name
            if group == "output" and seen.get(name) == "state":
                if variable != states[name]:
                    yield f"output {name!r} differs from the state of that name; use one Variable for both"
                seen[name] = "output"
            elif name in seen:
                yield f"{group} {name!r}: the name is already taken by the {seen[name]} {name!r}"
            else:
                seen[name] = group


def _variable_faults(model: "PlantModel") -> Iterator[str]:
    computed = set(model.computed_outputs)
    variables = dict.fromkeys((*model.states, *model.inputs, *model.outputs, *model.parameters))
    display_units: dict[tuple[str, str], tuple[float, float]] = {}
    for variable in variables:
        where = f"variable {variable.name!r}"
        if not _IDENTIFIER.fullmatch(variable.name):
            yield f"{where}: the name is not an identifier (letters, digits and _, no digit first)"
        if variable.name == TIME:
            yield f"{where}: the name is reserved for the simulated time"
        try:
            parse_unit(variable.unit)
        except ValueError as error:
            yield f"{where}: {error}"
        for fault in _value_faults(variable, has_start=variable not in computed):
            yield f"{where}: {fault}"
        variability = getattr(variable, "variability", "fixed")
        if variability not in ("fixed", "tunable"):
            yield f"{where}: variability must be 'fixed' or 'tunable', not {variability!r}"
        if (display := variable.display_unit) is not None:
            conversion = (display.factor, display.offset)
            if display_units.setdefault((variable.unit, display.name), conversion) != conversion:
                yield f"{where}: display unit {display.name!r} is converted differently elsewhere"


def _value_faults(variable: "Variable", *, has_start: bool) -> Iterator[str]:
    if isnan(variable.min) or isnan(variable.max) or variable.min > variable.max:
        yield f"min {variable.min} and max {variable.max} are no range"
    elif has_start and not variable.min <= variable.start <= variable.max:
        yield f"start {variable.start} is outside the range {variable.min} .. {variable.max}"
    if has_start and not isfinite(variable.start):
        yield f"start must be finite, not {variable.start}"
    if not (isfinite(variable.nominal) and variable.nominal > 0):
        yield f"nominal must be positive and finite, not {variable.nominal}"
    display = variable.display_unit
    if display is not None and not (
        isfinite(display.factor) and display.factor != 0 and isfinite(display.offset)
    ):
        yield f"display unit {display.name!r} has no usable conversion"
    if display is not None and (not display.name or not variable.unit):
        yield "a display unit needs a name, and a unit that it is converted from"
