"""What an FMU says about itself, in the terms of the contracts."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ddpc_cosim.errors import FMUImportError
from ddpc_cosim.fmu import fmpy_api
from ddpc_cosim.variables import DisplayUnit, Variable


@dataclass(frozen=True, slots=True)
class FMUVariable:
    """A scalar variable of an FMU.

    Parameters
    ----------
    variable : Variable
        Name, unit, range, start value.
    reference : int
        Value reference.
    type : str
        ``Real``, ``Integer``, ``Boolean``, ``Enumeration`` or ``String``.
    causality, variability : str
        As in the model description.
    """

    variable: Variable
    reference: int
    type: str
    causality: str
    variability: str

    @property
    def is_tunable(self) -> bool:
        """Whether the value may change during a run from outside."""
        return self.causality == "parameter" and self.variability == "tunable"


@dataclass(frozen=True, slots=True)
class FMUDescription:
    """The part of a model description that co-simulation needs."""

    fmi_version: str
    guid: str
    model_name: str
    model_identifier: str
    generation_tool: str
    variables: dict[str, FMUVariable]
    variable_step: bool

    def named(self, causality: str, type: str) -> list[str]:
        """Return the names of the variables of a causality and type, in the order of the description."""
        return [name for name, v in self.variables.items() if (v.causality, v.type) == (causality, type)]


def read_description(folder: Path, label: str) -> FMUDescription:
    """Read the model description of an unpacked FMU.

    Parameters
    ----------
    folder : Path
        The unpacked FMU.
    label : str
        The FMU's file name, for errors.

    Raises
    ------
    FMUImportError
        There is no readable description, or it describes another kind of FMU.
    """
    if not (folder / "modelDescription.xml").is_file():
        raise FMUImportError(f"{label}: not an FMU: the archive has no modelDescription.xml")
    try:
        model = fmpy_api.read_description(folder)
    except Exception as error:  # FMPy raises whatever the XML provokes
        raise FMUImportError(f"{label}: modelDescription.xml cannot be read: {_one_line(error)}") from error
    if not str(model.fmiVersion).startswith("2."):
        raise FMUImportError(
            f"{label}: FMI {model.fmiVersion} is not supported; supported: FMI 2.0 Co-Simulation"
        )
    if model.coSimulation is None:
        raise FMUImportError(
            f"{label}: no Co-Simulation interface; export the model for FMI 2.0 Co-Simulation"
        )
    return FMUDescription(
        fmi_version=str(model.fmiVersion),
        guid=str(model.guid),
        model_name=str(model.modelName),
        model_identifier=str(model.coSimulation.modelIdentifier),
        generation_tool=str(model.generationTool or "unknown"),
        variables={str(v.name): _variable(v, model) for v in model.modelVariables},
        variable_step=bool(model.coSimulation.canHandleVariableCommunicationStepSize),
    )


def _variable(variable: Any, model: Any) -> FMUVariable:
    declared = variable.declaredType

    def attribute(name: str) -> Any:
        """Return an attribute of the variable, or of its declared type where it has none."""
        own = getattr(variable, name)
        return own if own is not None else getattr(declared, name, None)

    unit = str(attribute("unit") or "")
    return FMUVariable(
        variable=Variable(
            name=str(variable.name),
            unit=unit,
            min=_number(attribute("min"), -math.inf),
            max=_number(attribute("max"), math.inf),
            nominal=_number(attribute("nominal"), 1.0),
            start=_number(variable.start, 0.0),
            description=str(variable.description or ""),
            display_unit=_display_unit(unit, str(attribute("displayUnit") or ""), model),
        ),
        reference=int(variable.valueReference),
        type=str(variable.type),
        causality=str(variable.causality or "local"),
        variability=str(variable.variability or "continuous"),
    )


def _display_unit(unit: str, display_unit: str, model: Any) -> DisplayUnit | None:
    for definition in model.unitDefinitions:
        if definition.name == unit:
            for candidate in definition.displayUnits:
                if candidate.name == display_unit:
                    return DisplayUnit(display_unit, float(candidate.factor), float(candidate.offset))
    return None


def _number(text: Any, default: float) -> float:
    """Return the number that an attribute's text stands for, the default for none or for other text."""
    boolean = {"true": 1.0, "false": 0.0}.get(str(text).strip().lower())
    if boolean is not None:
        return boolean
    try:
        return float(text)
    except (TypeError, ValueError):
        return default


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__
