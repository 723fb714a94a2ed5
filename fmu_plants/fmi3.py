"""FMI 3.0: its C front end's files, what the library exports, and the description files."""

from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as ET

from fmu_plants.description import (
    Description,
    Unknown,
    add_default_experiment,
    add_log_categories,
    add_units,
    model_structure,
    number_attributes,
    role_attributes,
    root_element,
    state_positions,
    xml_text,
)

HEADERS = ("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h")
FRONT_END = (
    "fmi3_common.c",
    "fmi3_variables.c",
    "fmi3_clocks.c",
    "fmi3_cosimulation.c",
    "fmi3_model_exchange.c",
)
_COMMON = """GetVersion SetDebugLogging InstantiateModelExchange InstantiateCoSimulation
InstantiateScheduledExecution FreeInstance EnterInitializationMode ExitInitializationMode EnterEventMode
Terminate Reset GetNumberOfVariableDependencies GetVariableDependencies GetFMUState SetFMUState FreeFMUState
SerializedFMUStateSize SerializeFMUState DeserializeFMUState GetDirectionalDerivative GetAdjointDerivative
EnterConfigurationMode ExitConfigurationMode GetIntervalDecimal GetIntervalFraction GetShiftDecimal
GetShiftFraction SetIntervalDecimal SetIntervalFraction SetShiftDecimal SetShiftFraction
EvaluateDiscreteStates UpdateDiscreteStates"""
_TYPES = """Float32 Float64 Int8 UInt8 Int16 UInt16 Int32 UInt32 Int64 UInt64 Boolean String Binary Clock"""
_MODEL_EXCHANGE = """EnterContinuousTimeMode CompletedIntegratorStep SetTime SetContinuousStates
GetContinuousStateDerivatives GetEventIndicators GetContinuousStates GetNominalsOfContinuousStates
GetNumberOfEventIndicators GetNumberOfContinuousStates"""
_CO_SIMULATION = "EnterStepMode GetOutputDerivatives DoStep"
# Scheduled Execution is refused at instantiation; loaders look for its functions all the same.
_SCHEDULED_EXECUTION = "ActivateModelPartition"
FUNCTIONS = (
    *(
        f"fmi3{name}"
        for name in f"{_COMMON} {_MODEL_EXCHANGE} {_CO_SIMULATION} {_SCHEDULED_EXECUTION}".split()
    ),
    *(f"fmi3{access}{name}" for access in ("Get", "Set") for name in _TYPES.split()),
)

_CAPABILITIES = {
    "canGetAndSetFMUState": "true",
    "canSerializeFMUState": "true",
    "providesDirectionalDerivatives": "true",
    "providesAdjointDerivatives": "true",
}


def description_files(description: Description, sources: Sequence[str]) -> Mapping[str, str]:
    """Return the texts of modelDescription.xml and buildDescription.xml, by name inside the FMU.

    Parameters
    ----------
    description : Description
    sources : sequence of str
        Names of the C files below ``sources``; none if the FMU does not contain them.
    """
    files = {"modelDescription.xml": _model_description(description)}
    if sources:
        files["sources/buildDescription.xml"] = _build_description(description.model.name, sources)
    return files


def _model_description(description: Description) -> str:
    root = root_element(description, "3.0", "instantiationToken")
    common = {"modelIdentifier": description.model.name} | _CAPABILITIES
    ET.SubElement(root, "ModelExchange", common, providesEvaluateDiscreteStates="true")
    ET.SubElement(root, "CoSimulation", common, canHandleVariableCommunicationStepSize="true")
    add_units(root, description.layout)
    add_log_categories(root)
    add_default_experiment(root, description)
    _add_variables(root, description)
    _add_structure(root, description)
    return xml_text(root)


def _add_variables(root: ET.Element, description: Description) -> None:
    variables = ET.SubElement(root, "ModelVariables")
    states = state_positions(description.layout)
    for reference, scalar in enumerate(description.layout):
        attributes = role_attributes(description, reference) | number_attributes(scalar)
        if reference in states:
            attributes["derivative"] = str(states[reference])
        ET.SubElement(variables, "Float64", attributes)


def _add_structure(root: ET.Element, description: Description) -> None:
    """Add the model structure, by value references."""
    element = ET.SubElement(root, "ModelStructure")
    structure = model_structure(description)

    def add(group: str, unknowns: Sequence[Unknown]) -> None:
        for unknown in unknowns:
            dependencies = " ".join(map(str, unknown.dependencies))
            ET.SubElement(element, group, valueReference=str(unknown.position), dependencies=dependencies)

    add("Output", structure.outputs)
    add("ContinuousStateDerivative", structure.derivatives)
    add("InitialUnknown", structure.initial_unknowns)


def _build_description(identifier: str, sources: Sequence[str]) -> str:
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
    files = ET.SubElement(configuration, "SourceFileSet", language="C11")
    for name in sorted(sources):
        ET.SubElement(files, "SourceFile", name=name)
    return xml_text(root)
