"""FMI 2.0: its C front end's files, what the library exports, and modelDescription.xml."""

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

HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
FRONT_END = ("fmi2_common.c", "fmi2_cosimulation.c", "fmi2_model_exchange.c")
_COMMON = """GetTypesPlatform GetVersion SetDebugLogging Instantiate FreeInstance SetupExperiment
EnterInitializationMode ExitInitializationMode Terminate Reset GetReal GetInteger GetBoolean GetString
SetReal SetInteger SetBoolean SetString GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize
SerializeFMUstate DeSerializeFMUstate GetDirectionalDerivative"""
_CO_SIMULATION = """SetRealInputDerivatives GetRealOutputDerivatives DoStep CancelStep GetStatus GetRealStatus
GetIntegerStatus GetBooleanStatus GetStringStatus"""
_MODEL_EXCHANGE = """EnterEventMode NewDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep SetTime
SetContinuousStates GetDerivatives GetEventIndicators GetContinuousStates GetNominalsOfContinuousStates"""
FUNCTIONS = tuple(f"fmi2{name}" for name in f"{_COMMON} {_CO_SIMULATION} {_MODEL_EXCHANGE}".split())

_CAPABILITIES = {
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canNotUseMemoryManagementFunctions": "true",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
    "providesDirectionalDerivative": "true",
}


def description_files(description: Description, sources: Sequence[str]) -> Mapping[str, str]:
    """Return the texts of modelDescription.xml, by name inside the FMU.

    Parameters
    ----------
    description : Description
    sources : sequence of str
        Names of the C files below ``sources``; none if the FMU does not contain them.
    """
    root = root_element(description, "2.0", "guid")
    root.set("numberOfEventIndicators", "0")
    _add_interface_types(root, description.model.name, sources)
    add_units(root, description.layout)
    add_log_categories(root)
    add_default_experiment(root, description)
    _add_variables(root, description)
    _add_structure(root, description)
    return {"modelDescription.xml": xml_text(root)}


def _add_interface_types(root: ET.Element, identifier: str, sources: Sequence[str]) -> None:
    common = {"modelIdentifier": identifier} | _CAPABILITIES
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
    for element in (exchange, simulation) if sources else ():
        files = ET.SubElement(element, "SourceFiles")
        for name in sorted(sources):
            ET.SubElement(files, "File", name=name)


def _add_variables(root: ET.Element, description: Description) -> None:
    variables = ET.SubElement(root, "ModelVariables")
    states = state_positions(description.layout)
    for reference, scalar in enumerate(description.layout):
        element = ET.SubElement(variables, "ScalarVariable", role_attributes(description, reference))
        real = number_attributes(scalar)
        if reference in states:
            real["derivative"] = str(states[reference] + 1)
        ET.SubElement(element, "Real", real)


def _add_structure(root: ET.Element, description: Description) -> None:
    """Add the model structure, whose indices begin with 1."""
    element = ET.SubElement(root, "ModelStructure")
    structure = model_structure(description)

    def add(group: str, unknowns: Sequence[Unknown]) -> None:
        if not unknowns:
            return  # the schema knows no empty group
        parent = ET.SubElement(element, group)
        for unknown in unknowns:
            dependencies = " ".join(str(position + 1) for position in unknown.dependencies)
            ET.SubElement(parent, "Unknown", index=str(unknown.position + 1), dependencies=dependencies)

    add("Outputs", structure.outputs)
    add("Derivatives", structure.derivatives)
    add("InitialUnknowns", structure.initial_unknowns)
