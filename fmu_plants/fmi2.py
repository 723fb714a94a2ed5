"""FMI 2.0 for Co-Simulation: its C front end's files, what the library exports, and modelDescription.xml."""

import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from math import isinf
from xml.etree import ElementTree as ET

from fmu_plants.layout import Kind, Scalar, derivative_name, scalars
from fmu_plants.model import PlantModel, Variable
from fmu_plants.units import parse_unit

HEADERS = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
FRONT_END = (
    "fmi2_instance.h",
    "fmi2_common.c",
    "fmi2_variables.c",
    "fmi2_fmu_state.c",
    "fmi2_cosimulation.c",
)
_COMMON = """GetTypesPlatform GetVersion SetDebugLogging Instantiate FreeInstance SetupExperiment
EnterInitializationMode ExitInitializationMode Terminate Reset GetReal GetInteger GetBoolean GetString
SetReal SetInteger SetBoolean SetString GetFMUstate SetFMUstate FreeFMUstate SerializedFMUstateSize
SerializeFMUstate DeSerializeFMUstate GetDirectionalDerivative"""
_CO_SIMULATION = """SetRealInputDerivatives GetRealOutputDerivatives DoStep CancelStep GetStatus GetRealStatus
GetIntegerStatus GetBooleanStatus GetStringStatus"""
FUNCTIONS = tuple(f"fmi2{name}" for name in f"{_COMMON} {_CO_SIMULATION}".split())

_LOG_CATEGORIES = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logAll")
# causality, variability, initial (FMI 2.0, section 2.2.7)
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


def platform() -> str:
    """Return the name of the folder below ``binaries`` for this machine."""
    system = {"win32": "win", "darwin": "darwin"}.get(sys.platform, "linux")
    return system + ("64" if sys.maxsize > 2**32 else "32")


def model_description(
    model: PlantModel,
    uses: Mapping[str, frozenset[str]],
    *,
    guid: str,
    relative_tolerance: float,
    sources: Iterable[str],
) -> str:
    """Return the text of modelDescription.xml.

    Parameters
    ----------
    model : PlantModel
    uses : mapping of str to frozenset of str
        Names of the variables that each derivative and each computed output is a function of.
    guid : str
        What the library checks at instantiation.
    relative_tolerance : float
        Default of the integrator.
    sources : iterable of str
        Names of the C files below ``sources``.
    """
    layout = scalars(model)
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=model.name,
        guid=guid,
        description=f"{model.description} ({model.source})" if model.source else model.description,
        generationTool=f"ddpc-cosim {version('ddpc-cosim')}",
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    co_simulation = ET.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=model.name,
        canHandleVariableCommunicationStepSize="true",
        canInterpolateInputs="false",
        maxOutputDerivativeOrder="0",
        canRunAsynchronuously="false",
        canBeInstantiatedOnlyOncePerProcess="false",
        canNotUseMemoryManagementFunctions="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
        providesDirectionalDerivative="false",
    )
    files = ET.SubElement(co_simulation, "SourceFiles")
    for name in sorted(sources):
        ET.SubElement(files, "File", name=name)
    _add_units(root, layout)
    categories = ET.SubElement(root, "LogCategories")
    for name in _LOG_CATEGORIES:
        ET.SubElement(categories, "Category", name=name)
    ET.SubElement(
        root,
        "DefaultExperiment",
        startTime="0.0",
        stopTime=repr(float(model.stop_time)),
        tolerance=repr(float(relative_tolerance)),
        stepSize=repr(float(model.step_size)),
    )
    _add_variables(root, model, layout)
    _add_structure(root, model, uses, layout)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _add_units(root: ET.Element, layout: Sequence[Scalar]) -> None:
    """Add every unit once, with the display units of all variables that have it."""
    definitions = ET.SubElement(root, "UnitDefinitions")
    units = dict.fromkeys(scalar.variable.unit for scalar in layout if scalar.variable.unit)
    for unit in units:
        element = ET.SubElement(definitions, "Unit", name=unit)
        si = parse_unit(unit)
        exponents = {name: str(power) for name, power in si.exponents.items()}
        ET.SubElement(element, "BaseUnit", exponents | _conversion(si.factor, si.offset))
        shown = dict.fromkeys(s.variable.display_unit for s in layout if s.variable.unit == unit)
        for display in shown:
            if display is not None:
                conversion = _conversion(display.factor, display.offset)
                ET.SubElement(element, "DisplayUnit", {"name": display.name} | conversion)


def _conversion(factor: float, offset: float) -> dict[str, str]:
    """Return the attributes of a conversion, without those at their default."""
    attributes = {"factor": (factor, 1.0), "offset": (offset, 0.0)}
    return {name: repr(float(value)) for name, (value, default) in attributes.items() if value != default}


def _add_variables(root: ET.Element, model: PlantModel, layout: Sequence[Scalar]) -> None:
    variables = ET.SubElement(root, "ModelVariables")
    outputs = {output.name for output in model.outputs}
    state_index = {s.variable.name: index for index, s in enumerate(layout, 1) if s.kind is Kind.STATE}
    state_of = {derivative_name(state): index for state, index in state_index.items()}
    for reference, scalar in enumerate(layout):
        variable = scalar.variable
        causality, variability, initial = _ROLES[scalar.kind]
        attributes = {"name": variable.name, "valueReference": str(reference)}
        if variable.description:
            attributes["description"] = variable.description
        attributes["causality"] = "output" if variable.name in outputs else causality
        attributes["variability"] = variability
        if initial is not None:
            attributes["initial"] = initial
        element = ET.SubElement(variables, "ScalarVariable", attributes)
        real = _real_attributes(variable)
        if scalar.kind in _WITH_START:
            real["start"] = repr(float(variable.start))
        if scalar.kind is Kind.DERIVATIVE:
            real["derivative"] = str(state_of[variable.name])
        ET.SubElement(element, "Real", real)


def _real_attributes(variable: Variable) -> dict[str, str]:
    attributes = {}
    if variable.unit:
        attributes["unit"] = variable.unit
    if variable.display_unit is not None:
        attributes["displayUnit"] = variable.display_unit.name
    for name in ("min", "max"):
        value = float(getattr(variable, name))
        if not isinf(value):
            attributes[name] = repr(value)
    if variable.nominal != 1.0:
        attributes["nominal"] = repr(float(variable.nominal))
    return attributes


def _add_structure(
    root: ET.Element, model: PlantModel, uses: Mapping[str, frozenset[str]], layout: Sequence[Scalar]
) -> None:
    """Add what depends on what: on time, states and inputs, at initialization also on start values."""
    structure = ET.SubElement(root, "ModelStructure")
    index = {scalar.variable.name: position for position, scalar in enumerate(layout, 1)}
    running = {s.variable.name for s in layout if s.kind in (Kind.TIME, Kind.STATE, Kind.INPUT)}
    starting = {s.variable.name for s in layout if s.kind in _WITH_START} | running
    all_uses = {state.name: frozenset([state.name]) for state in model.states} | dict(uses)
    derivatives = [derivative_name(state.name) for state in model.states]
    computed = [output.name for output in model.computed_outputs]

    def add(group: str, names: Iterable[str], knowns: set[str]) -> None:
        ordered = sorted(names, key=index.__getitem__)
        if not ordered:
            return  # the schema knows no empty group
        element = ET.SubElement(structure, group)
        for name in ordered:
            known = sorted(index[used] for used in all_uses[name] & knowns)
            ET.SubElement(element, "Unknown", index=str(index[name]), dependencies=" ".join(map(str, known)))

    add("Outputs", [output.name for output in model.outputs], running)
    add("Derivatives", derivatives, running)
    add("InitialUnknowns", [*derivatives, *computed], starting)
