"""The description files of a plant's FMU, for FMI 2.0 and FMI 3.0, and the order of its variables.

The C code follows the same order, block by block as in `runtime/model.h`: time, states, derivatives, inputs,
computed outputs, parameters. The value reference of a variable is its position.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from importlib.metadata import version
from math import isinf
from xml.etree import ElementTree as ET

from fmu_plants.model import TIME, Parameter, PlantModel, Variable, derivative_name
from fmu_plants.units import parse_unit

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


# causality, variability, initial (FMI 2.0, section 2.2.7; FMI 3.0, section 2.4.7)
_ROLES = {
    Kind.TIME: ("independent", "continuous", None),
    Kind.STATE: ("local", "continuous", "exact"),
    Kind.DERIVATIVE: ("local", "continuous", "calculated"),
    Kind.INPUT: ("input", "continuous", None),
    Kind.OUTPUT: ("output", "continuous", "calculated"),
    Kind.FIXED_PARAMETER: ("parameter", "fixed", "exact"),
    Kind.TUNABLE_PARAMETER: ("parameter", "tunable", "exact"),
}
_WITH_START = {Kind.STATE, Kind.INPUT, Kind.FIXED_PARAMETER, Kind.TUNABLE_PARAMETER}
_LOG_CATEGORIES = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logAll")
_CAPABILITIES = {
    "2.0": {
        "canBeInstantiatedOnlyOncePerProcess": "false",
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "true",
    },
    "3.0": {
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": "true",
        "providesAdjointDerivatives": "true",
    },
}


@dataclass(frozen=True, slots=True)
class Scalar:
    """A scalar variable of the FMU: its role and its attributes."""

    kind: Kind
    variable: Variable


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


def _derivative_unit(unit: str) -> str:
    """Return the unit of a derivative by time: rad -> rad/s, m/s -> m/s2, degC -> K/s."""
    if parse_unit(unit).offset:
        return "K/s"
    if match := _PER_SECOND.fullmatch(unit):
        return f"{match['rest']}/s{int(match['power'] or 1) + 1}"
    return f"{unit or '1'}/s"


def _parameter_kind(parameter: Parameter) -> Kind:
    return Kind.TUNABLE_PARAMETER if parameter.variability == "tunable" else Kind.FIXED_PARAMETER


@dataclass(frozen=True, slots=True)
class Description:
    """What the description files of a plant are written from.

    Parameters
    ----------
    fmi_version : str
        ``"2.0"`` or ``"3.0"``.
    model : PlantModel
    dependencies : mapping of str to frozenset of str
        Names of the variables that each derivative and each computed output is a function of.
    guid : str
        What the library checks at instantiation.
    relative_tolerance : float
        Default of the integrator.
    sources : sequence of str
        Names of the C files below ``sources``; none if the FMU does not contain them.
    """

    fmi_version: str
    model: PlantModel
    dependencies: Mapping[str, frozenset[str]]
    guid: str
    relative_tolerance: float
    sources: Sequence[str]

    @property
    def is_fmi2(self) -> bool:
        """Whether the version is 2.0."""
        return self.fmi_version == "2.0"

    def files(self) -> dict[str, str]:
        """Return the texts of the description files by name inside the FMU."""
        files = {"modelDescription.xml": _xml_text(_model_description(self))}
        if self.sources and not self.is_fmi2:
            files["sources/buildDescription.xml"] = _xml_text(_build_description(self))
        return files


def _xml_text(root: ET.Element) -> str:
    """Return an indented document; the same tree gives the same text."""
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _model_description(description: Description) -> ET.Element:
    model, layout = description.model, scalars(description.model)
    root = ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": description.fmi_version,
            "modelName": model.name,
            "guid" if description.is_fmi2 else "instantiationToken": description.guid,
            "description": f"{model.description} ({model.source})" if model.source else model.description,
            "generationTool": f"ddpc-cosim {version('ddpc-cosim')}",
            "variableNamingConvention": "structured",
        },
    )
    _add_interfaces(root, description)
    _add_units(root, layout)
    categories = ET.SubElement(root, "LogCategories")
    for name in _LOG_CATEGORIES:
        ET.SubElement(categories, "Category", name=name)
    ET.SubElement(
        root,
        "DefaultExperiment",
        startTime="0.0",
        stopTime=repr(float(model.stop_time)),
        tolerance=repr(float(description.relative_tolerance)),
        stepSize=repr(float(model.step_size)),
    )
    _add_variables(root, description, layout)
    _add_structure(root, description, layout)
    return root


def _build_description(description: Description) -> ET.Element:
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=description.model.name)
    files = ET.SubElement(configuration, "SourceFileSet", language="C11")
    for name in sorted(description.sources):
        ET.SubElement(files, "SourceFile", name=name)
    return root


def _add_interfaces(root: ET.Element, description: Description) -> None:
    """Add Model Exchange and Co-Simulation; FMI 2.0 has the list of source files there."""
    common = {"modelIdentifier": description.model.name} | _CAPABILITIES[description.fmi_version]
    if not description.is_fmi2:
        ET.SubElement(root, "ModelExchange", common, providesEvaluateDiscreteStates="true")
        ET.SubElement(root, "CoSimulation", common, canHandleVariableCommunicationStepSize="true")
        return
    root.set("numberOfEventIndicators", "0")
    exchange = ET.SubElement(root, "ModelExchange", common, completedIntegratorStepNotNeeded="true")
    simulation = ET.SubElement(
        root,
        "CoSimulation",
        common,
        canHandleVariableCommunicationStepSize="true",
        canInterpolateInputs="false",
        maxOutputDerivativeOrder="0",
        canRunAsynchronuously="false",
    )
    for element in (exchange, simulation) if description.sources else ():
        files = ET.SubElement(element, "SourceFiles")
        for name in sorted(description.sources):
            ET.SubElement(files, "File", name=name)


def _add_units(root: ET.Element, layout: Sequence[Scalar]) -> None:
    """Add every unit once, with the display units of all variables that have it."""
    definitions = ET.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys(scalar.variable.unit for scalar in layout if scalar.variable.unit):
        element = ET.SubElement(definitions, "Unit", name=unit)
        si = parse_unit(unit)
        exponents = {name: str(power) for name, power in si.exponents.items()}
        ET.SubElement(element, "BaseUnit", exponents | _conversion(si.factor, si.offset))
        for display in dict.fromkeys(s.variable.display_unit for s in layout if s.variable.unit == unit):
            if display is not None:
                conversion = _conversion(display.factor, display.offset)
                ET.SubElement(element, "DisplayUnit", {"name": display.name} | conversion)


def _conversion(factor: float, offset: float) -> dict[str, str]:
    """Return the attributes of a conversion, without those at their default."""
    attributes = {"factor": (factor, 1.0), "offset": (offset, 0.0)}
    return {name: repr(float(value)) for name, (value, default) in attributes.items() if value != default}


def _add_variables(root: ET.Element, description: Description, layout: Sequence[Scalar]) -> None:
    """Add the variables; a derivative refers to its state as the model structure does."""
    variables = ET.SubElement(root, "ModelVariables")
    state_of = {derivative_name(state.name): state.name for state in description.model.states}
    number_of = _numbers(description, layout)
    for reference, scalar in enumerate(layout):
        role = _role(description.model, scalar, reference)
        values = _values(scalar)
        if scalar.kind is Kind.DERIVATIVE:
            values["derivative"] = str(number_of[state_of[scalar.variable.name]])
        if description.is_fmi2:
            ET.SubElement(ET.SubElement(variables, "ScalarVariable", role), "Real", values)
        else:
            ET.SubElement(variables, "Float64", role | values)


def _role(model: PlantModel, scalar: Scalar, reference: int) -> dict[str, str]:
    """Return name, value reference, causality, variability and initial of a variable."""
    causality, variability, initial = _ROLES[scalar.kind]
    attributes = {"name": scalar.variable.name, "valueReference": str(reference)}
    if scalar.variable.description:
        attributes["description"] = scalar.variable.description
    is_output = scalar.variable.name in {output.name for output in model.outputs}
    attributes["causality"] = "output" if is_output else causality
    attributes["variability"] = variability
    if initial is not None:
        attributes["initial"] = initial
    return attributes


def _values(scalar: Scalar) -> dict[str, str]:
    """Return unit, display unit, range, nominal and start value of a variable."""
    variable = scalar.variable
    attributes = {}
    if variable.unit:
        attributes["unit"] = variable.unit
    if variable.display_unit is not None:
        attributes["displayUnit"] = variable.display_unit.name
    for name, value in {"min": variable.min, "max": variable.max}.items():
        if not isinf(value):
            attributes[name] = repr(float(value))
    if variable.nominal != 1.0:
        attributes["nominal"] = repr(float(variable.nominal))
    if scalar.kind in _WITH_START:
        attributes["start"] = repr(float(variable.start))
    return attributes


def _numbers(description: Description, layout: Sequence[Scalar]) -> dict[str, int]:
    """Return how variables refer to each other: by value reference, in FMI 2.0 by an index from 1 on."""
    return {scalar.variable.name: n for n, scalar in enumerate(layout, 1 if description.is_fmi2 else 0)}


def _add_structure(root: ET.Element, description: Description, layout: Sequence[Scalar]) -> None:
    """Add what depends on what: on time, states and inputs; at initialization also on start values."""
    model, number_of = description.model, _numbers(description, layout)
    running = {s.variable.name for s in layout if s.kind in (Kind.TIME, Kind.STATE, Kind.INPUT)}
    starting = {s.variable.name for s in layout if s.kind in _WITH_START} | running
    used = {state.name: frozenset([state.name]) for state in model.states} | dict(description.dependencies)
    outputs = [output.name for output in model.outputs]
    derivatives = [derivative_name(state.name) for state in model.states]
    computed = [*derivatives, *(output.name for output in model.computed_outputs)]
    structure = ET.SubElement(root, "ModelStructure")

    def add(group: str, element: str, names: Sequence[str], knowns: set[str]) -> None:
        parent, tag, number = structure, element, "valueReference"
        if description.is_fmi2:
            if not names:
                return  # the schema knows no empty group
            parent, tag, number = ET.SubElement(structure, group), "Unknown", "index"
        for name in sorted(names, key=number_of.__getitem__):
            dependencies = sorted(number_of[known] for known in used[name] & knowns)
            attributes = {number: str(number_of[name]), "dependencies": " ".join(map(str, dependencies))}
            ET.SubElement(parent, tag, attributes)

    add("Outputs", "Output", outputs, running)
    add("Derivatives", "ContinuousStateDerivative", derivatives, running)
    add("InitialUnknowns", "InitialUnknown", computed, starting)
