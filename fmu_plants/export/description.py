"""The description files of an FMU, for FMI 2.0 and FMI 3.0, and the order of a plant's variables.

The C code follows the same order, block by block as in `runtime/model.h`: time, states, derivatives, inputs,
computed outputs, parameters, and what an embedded control holds. The value reference of a variable is its
position.
"""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from importlib.metadata import version
from math import inf, isinf, isnan
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
    SAMPLE = "VARIABLE_SAMPLE"
    HELD = "VARIABLE_HELD"


# causality, variability, initial (FMI 2.0, section 2.2.7; FMI 3.0, section 2.4.7)
_ROLES = {
    Kind.TIME: ("independent", "continuous", None),
    Kind.STATE: ("local", "continuous", "exact"),
    Kind.DERIVATIVE: ("local", "continuous", "calculated"),
    Kind.INPUT: ("input", "continuous", None),
    Kind.OUTPUT: ("output", "continuous", "calculated"),
    Kind.FIXED_PARAMETER: ("parameter", "fixed", "exact"),
    Kind.TUNABLE_PARAMETER: ("parameter", "tunable", "exact"),
    Kind.SAMPLE: ("input", "discrete", None),
    Kind.HELD: ("local", "discrete", "calculated"),
}
_WITH_START = {Kind.STATE, Kind.INPUT, Kind.SAMPLE, Kind.FIXED_PARAMETER, Kind.TUNABLE_PARAMETER}
_LOG_CATEGORIES = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logAll")
_CAPABILITIES = {
    "2.0": {
        "canBeInstantiatedOnlyOncePerProcess": "false",
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
    },
    "3.0": {
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
    },
}
_DERIVATIVES = {
    "2.0": {"providesDirectionalDerivative": "true"},
    "3.0": {"providesDirectionalDerivatives": "true", "providesAdjointDerivatives": "true"},
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
        *(Scalar(Kind.INPUT, variable) for variable in model.all_inputs),
        *(Scalar(Kind.OUTPUT, variable) for variable in model.computed_outputs),
        *(Scalar(_parameter_kind(parameter), parameter) for parameter in model.parameters),
        *(Scalar(Kind.HELD, variable) for variable in (*model.memory, *model.actuators)),
    )


def variable_table(layout: Sequence[Scalar]) -> str:
    """Return the variables as the constant table of the C code; what is sampled has no range there."""

    def row(scalar: Scalar) -> str:
        v = scalar.variable
        limits = (-inf, inf) if scalar.kind is Kind.SAMPLE else (v.min, v.max)
        numbers = ", ".join(map(c_number, (v.start, *limits, v.nominal)))
        return f"    {{{c_text(v.name)}, {scalar.kind.value}, {numbers}}},"

    return "\n".join(["static const Variable variables[] = {", *map(row, layout), "};"])


def c_number(value: float) -> str:
    """Return a number as C spells it."""
    if value in (inf, -inf):
        return "INFINITY" if value > 0 else "-INFINITY"
    if isnan(value):
        return "NAN"
    return repr(float(value))


def c_text(text: str) -> str:
    """Return a text as C spells it, in UTF-8 whatever the compiler takes its sources for."""
    plain = "".join(
        chr(byte) if 32 <= byte < 127 and chr(byte) not in '"\\?' else f"\\{byte:03o}"
        for byte in text.encode("utf-8", errors="replace")
    )
    return f'"{plain}"'


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
class Contents:
    """What an FMU is, whatever it is made from.

    Parameters
    ----------
    name : str
        The model identifier.
    description : str
        A line for people.
    layout : tuple of Scalar
        The variables, in the order of their value references.
    outputs : tuple of str
        Names of those that are outputs.
    dependencies : mapping of str to frozenset of str
        Names of the variables that each derivative and each computed output is a function of.
    experiment : mapping of str to float
        The attributes of the default experiment.
    sampling_time : float
        Of a sampled block [s], which is for Co-Simulation only; 0: it is integrated.
    has_events : bool
        Whether it meets events of its own while it integrates, which it does in Co-Simulation only.
    """

    name: str
    description: str
    layout: tuple[Scalar, ...]
    outputs: tuple[str, ...]
    dependencies: Mapping[str, frozenset[str]]
    experiment: Mapping[str, float]
    sampling_time: float = 0.0
    has_events: bool = False


def plant_contents(
    model: PlantModel, dependencies: Mapping[str, frozenset[str]], relative_tolerance: float
) -> Contents:
    """Return what the FMU of a plant is; the tolerance is the default of its integrator."""
    return Contents(
        model.name,
        f"{model.description} ({model.source})" if model.source else model.description,
        scalars(model),
        tuple(output.name for output in model.outputs),
        {state.name: frozenset([state.name]) for state in model.states} | dict(dependencies),
        {"stopTime": model.stop_time, "tolerance": relative_tolerance, "stepSize": model.step_size},
        has_events=model.has_events,
    )


@dataclass(frozen=True, slots=True)
class Description:
    """What the description files of an FMU are written from.

    Parameters
    ----------
    fmi_version : str
        ``"2.0"`` or ``"3.0"``.
    contents : Contents
    guid : str
        What the library checks at instantiation.
    sources : sequence of str
        Names of the C files below ``sources``; none if the FMU does not contain them.
    """

    fmi_version: str
    contents: Contents
    guid: str
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
    contents = description.contents
    root = ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": description.fmi_version,
            "modelName": contents.name,
            "guid" if description.is_fmi2 else "instantiationToken": description.guid,
            "description": contents.description,
            "generationTool": f"ddpc-cosim {version('ddpc-cosim')}",
            "variableNamingConvention": "flat" if contents.sampling_time else "structured",
        },
    )
    _add_interfaces(root, description)
    _add_units(root, contents.layout)
    categories = ET.SubElement(root, "LogCategories")
    for name in _LOG_CATEGORIES:
        ET.SubElement(categories, "Category", name=name)
    experiment = {"startTime": 0.0, **contents.experiment}
    ET.SubElement(root, "DefaultExperiment", {name: repr(float(v)) for name, v in experiment.items()})
    _add_variables(root, description)
    _add_structure(root, description)
    return root


def _build_description(description: Description) -> ET.Element:
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=description.contents.name)
    files = ET.SubElement(configuration, "SourceFileSet", language="C11")
    for name in sorted(description.sources):
        ET.SubElement(files, "SourceFile", name=name)
    return root


def _add_interfaces(root: ET.Element, description: Description) -> None:
    """Add Co-Simulation, and Model Exchange of what importers can integrate; FMI 2.0 lists sources there."""
    contents, version = description.contents, description.fmi_version
    common = {"modelIdentifier": contents.name} | _CAPABILITIES[version]
    steps = {"canHandleVariableCommunicationStepSize": "true"}
    if contents.sampling_time:
        steps["canHandleVariableCommunicationStepSize"] = "false"
    else:
        common |= _DERIVATIVES[version]
    interfaces = []
    if description.is_fmi2:
        root.set("numberOfEventIndicators", "0")
        steps |= {"canInterpolateInputs": "false", "maxOutputDerivativeOrder": "0"}
        steps["canRunAsynchronuously"] = "false"
        exchange = {"completedIntegratorStepNotNeeded": "true"}
    else:
        exchange = {"providesEvaluateDiscreteStates": "true"}
        if contents.sampling_time:
            steps["fixedInternalStepSize"] = repr(float(contents.sampling_time))
    if not (contents.sampling_time or contents.has_events):
        interfaces.append(ET.SubElement(root, "ModelExchange", common | exchange))
    interfaces.append(ET.SubElement(root, "CoSimulation", common | steps))
    for element in interfaces if description.is_fmi2 and description.sources else ():
        files = ET.SubElement(element, "SourceFiles")
        for name in sorted(description.sources):
            ET.SubElement(files, "File", name=name)


def _add_units(root: ET.Element, layout: Sequence[Scalar]) -> None:
    """Add every unit once, with the display units of all variables that have it."""
    definitions = ET.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys(scalar.variable.unit for scalar in layout if scalar.variable.unit):
        element = ET.SubElement(definitions, "Unit", name=unit)
        with suppress(ValueError):  # the signals of a controller may have anyone's units
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


def _add_variables(root: ET.Element, description: Description) -> None:
    """Add the variables; a derivative refers to its state as the model structure does."""
    variables, contents = ET.SubElement(root, "ModelVariables"), description.contents
    states = [scalar.variable.name for scalar in contents.layout if scalar.kind is Kind.STATE]
    state_of = {derivative_name(state): state for state in states}
    number_of = _numbers(description)
    for reference, scalar in enumerate(contents.layout):
        role = _role(contents, scalar, reference)
        values = _values(scalar)
        if scalar.kind is Kind.DERIVATIVE:
            values["derivative"] = str(number_of[state_of[scalar.variable.name]])
        if description.is_fmi2:
            ET.SubElement(ET.SubElement(variables, "ScalarVariable", role), "Real", values)
        else:
            ET.SubElement(variables, "Float64", role | values)


def _role(contents: Contents, scalar: Scalar, reference: int) -> dict[str, str]:
    """Return name, value reference, causality, variability and initial of a variable."""
    causality, variability, initial = _ROLES[scalar.kind]
    attributes = {"name": scalar.variable.name, "valueReference": str(reference)}
    if scalar.variable.description:
        attributes["description"] = scalar.variable.description
    attributes["causality"] = "output" if scalar.variable.name in contents.outputs else causality
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
        attributes["start"] = "NaN" if isnan(variable.start) else repr(float(variable.start))
    return attributes


def _numbers(description: Description) -> dict[str, int]:
    """Return how variables refer to each other: by value reference, in FMI 2.0 by an index from 1 on."""
    first = 1 if description.is_fmi2 else 0
    return {scalar.variable.name: n for n, scalar in enumerate(description.contents.layout, first)}


def _add_structure(root: ET.Element, description: Description) -> None:
    """Add what depends on what: on time, states and inputs; at initialization also on start values."""
    contents, number_of = description.contents, _numbers(description)

    def named(*kinds: Kind) -> list[str]:
        return [scalar.variable.name for scalar in contents.layout if scalar.kind in kinds]

    running = {*named(Kind.TIME, Kind.STATE, Kind.INPUT, Kind.SAMPLE)}
    starting = {*named(*_WITH_START), *running}
    structure = ET.SubElement(root, "ModelStructure")

    def add(group: str, element: str, names: Sequence[str], knowns: set[str]) -> None:
        parent, tag, number = structure, element, "valueReference"
        if description.is_fmi2:
            if not names:
                return  # the schema knows no empty group
            parent, tag, number = ET.SubElement(structure, group), "Unknown", "index"
        for name in sorted(names, key=number_of.__getitem__):
            dependencies = sorted(number_of[known] for known in contents.dependencies[name] & knowns)
            attributes = {number: str(number_of[name]), "dependencies": " ".join(map(str, dependencies))}
            ET.SubElement(parent, tag, attributes)

    add("Outputs", "Output", contents.outputs, running)
    add("Derivatives", "ContinuousStateDerivative", named(Kind.DERIVATIVE), running)
    unknowns = dict.fromkeys((*named(Kind.DERIVATIVE), *contents.outputs))
    states = {*named(Kind.STATE)}
    add("InitialUnknowns", "InitialUnknown", [name for name in unknowns if name not in states], starting)
