"""What modelDescription.xml has in common in FMI 2.0 and FMI 3.0."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from math import isinf
from xml.etree import ElementTree as ET

from fmu_plants.layout import Kind, Scalar, derivative_name, scalars
from fmu_plants.model import PlantModel, Variable
from fmu_plants.units import parse_unit

_LOG_CATEGORIES = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logAll")
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


@dataclass(frozen=True, slots=True)
class Description:
    """What the model description of a plant is written from.

    Parameters
    ----------
    model : PlantModel
    uses : mapping of str to frozenset of str
        Names of the variables that each derivative and each computed output is a function of.
    guid : str
        What the library checks at instantiation.
    relative_tolerance : float
        Default of the integrator.
    """

    model: PlantModel
    uses: Mapping[str, frozenset[str]]
    guid: str
    relative_tolerance: float

    @property
    def layout(self) -> tuple[Scalar, ...]:
        """The scalar variables in the order of their value references."""
        return scalars(self.model)


@dataclass(frozen=True, slots=True)
class Unknown:
    """An entry of the model structure: a variable and what it depends on, as positions in the layout."""

    position: int
    dependencies: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Structure:
    """Which variables are computed from which, while running and at initialization."""

    outputs: tuple[Unknown, ...]
    derivatives: tuple[Unknown, ...]
    initial_unknowns: tuple[Unknown, ...]


def xml_text(root: ET.Element) -> str:
    """Return an indented document; the same tree gives the same text."""
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def root_element(description: Description, fmi_version: str, token: str) -> ET.Element:
    """Return the root; `token` is the attribute that holds the GUID."""
    model = description.model
    return ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": fmi_version,
            "modelName": model.name,
            token: description.guid,
            "description": f"{model.description} ({model.source})" if model.source else model.description,
            "generationTool": f"ddpc-cosim {version('ddpc-cosim')}",
            "variableNamingConvention": "structured",
        },
    )


def add_units(root: ET.Element, layout: Sequence[Scalar]) -> None:
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


def add_log_categories(root: ET.Element) -> None:
    """Add the categories that the library logs in."""
    categories = ET.SubElement(root, "LogCategories")
    for name in _LOG_CATEGORIES:
        ET.SubElement(categories, "Category", name=name)


def add_default_experiment(root: ET.Element, description: Description) -> None:
    """Add the times and the tolerance that the model suggests."""
    ET.SubElement(
        root,
        "DefaultExperiment",
        startTime="0.0",
        stopTime=repr(float(description.model.stop_time)),
        tolerance=repr(float(description.relative_tolerance)),
        stepSize=repr(float(description.model.step_size)),
    )


def role_attributes(description: Description, reference: int) -> dict[str, str]:
    """Return name, value reference, causality, variability and initial of a variable."""
    scalar = description.layout[reference]
    causality, variability, initial = _ROLES[scalar.kind]
    attributes = {"name": scalar.variable.name, "valueReference": str(reference)}
    if scalar.variable.description:
        attributes["description"] = scalar.variable.description
    is_output = scalar.variable.name in {output.name for output in description.model.outputs}
    attributes["causality"] = "output" if is_output else causality
    attributes["variability"] = variability
    if initial is not None:
        attributes["initial"] = initial
    return attributes


def number_attributes(scalar: Scalar) -> dict[str, str]:
    """Return unit, display unit, range, nominal and start value of a variable."""
    variable: Variable = scalar.variable
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
    if scalar.kind in _WITH_START:
        attributes["start"] = repr(float(variable.start))
    return attributes


def state_positions(layout: Sequence[Scalar]) -> dict[int, int]:
    """Return the position of the state for the position of each derivative."""
    positions = {scalar.variable.name: position for position, scalar in enumerate(layout)}
    return {
        positions[derivative_name(s.variable.name)]: position
        for position, s in enumerate(layout)
        if s.kind is Kind.STATE
    }


def model_structure(description: Description) -> Structure:
    """Return what depends on what: on time, states and inputs; at initialization also on start values."""
    model, layout = description.model, description.layout
    positions = {scalar.variable.name: position for position, scalar in enumerate(layout)}
    running = {s.variable.name for s in layout if s.kind in (Kind.TIME, Kind.STATE, Kind.INPUT)}
    starting = {s.variable.name for s in layout if s.kind in _WITH_START} | running
    uses = {state.name: frozenset([state.name]) for state in model.states} | dict(description.uses)
    derivatives = [derivative_name(state.name) for state in model.states]
    computed = [output.name for output in model.computed_outputs]

    def unknowns(names: Sequence[str], knowns: set[str]) -> Iterator[Unknown]:
        for name in sorted(names, key=positions.__getitem__):
            used = sorted(positions[known] for known in uses[name] & knowns)
            yield Unknown(positions[name], tuple(used))

    return Structure(
        outputs=tuple(unknowns([output.name for output in model.outputs], running)),
        derivatives=tuple(unknowns(derivatives, running)),
        initial_unknowns=tuple(unknowns([*derivatives, *computed], starting)),
    )
