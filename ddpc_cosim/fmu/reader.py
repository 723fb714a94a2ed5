"""Mending model descriptions that FMPy cannot read but that can be understood.

Every repair drops or replaces an attribute or an element that contradicts the standard, and says so.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any

import fmpy.model_description
from lxml import etree  # type: ignore[import-untyped]

from ddpc_cosim.errors import FMUImportError
from ddpc_cosim.fmu.description import (
    CAUSALITIES,
    INTEGER_TYPES,
    NUMERIC_TYPES,
    DefaultExperiment,
    FMUDescription,
    FMUVariable,
    Interface,
    Kind,
    number,
)
from ddpc_cosim.variables import DisplayUnit, Variable

Element = Any
"""An element of lxml, which has no type information."""

_TYPES = ("Real", "Integer", "Boolean", "String", "Enumeration")
_CAUSALITIES: dict[str, tuple[str, ...]] = {
    "parameter": ("fixed", "tunable"),
    "calculatedParameter": ("fixed", "tunable"),
    "structuralParameter": ("fixed", "tunable"),
    "input": ("continuous", "discrete"),
    "output": ("continuous", "discrete", "constant"),
    "local": ("continuous", "discrete", "constant", "fixed", "tunable"),
    "independent": ("continuous",),
}
_CAUSALITIES_1 = ("input", "output", "internal", "none")
_VARIABILITIES_1 = ("constant", "parameter", "discrete", "continuous")
_TYPE_ATTRIBUTES = {
    "name",
    "description",
    "quantity",
    "unit",
    "displayUnit",
    "relativeQuantity",
    "min",
    "max",
    "nominal",
    "unbounded",
}
_ITEM_ATTRIBUTES = {"name", "value", "description"}
_WHOLE_NUMBERS = (
    "numberOfEventIndicators",
    "maxOutputDerivativeOrder",
    "recommendedIntermediateInputSmoothness",
)
_EXPONENTS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


def repair(path: Path) -> list[str]:
    """Mend a modelDescription.xml in place.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    list of str
        What was done, for the user.

    Raises
    ------
    Exception
        It is no model description at all.
    """
    root = parse(path)
    notes = [note for mend in _REPAIRS for note in mend(root)]
    path.write_bytes(etree.tostring(root, encoding="UTF-8", xml_declaration=True))
    return list(dict.fromkeys(notes))


def parse(path: Path) -> Element:
    """Parse an XML file, also one that is not in the encoding that it claims or begins with blanks.

    Raises
    ------
    Exception
        It is no XML.
    """
    content = path.read_bytes().lstrip()
    parser = etree.XMLParser(remove_comments=True, remove_pis=True, resolve_entities=False, no_network=True)
    try:
        return etree.fromstring(content, parser)
    except etree.XMLSyntaxError:
        # Tools that write the letters of their locale into a file that claims to be UTF-8.
        parser = etree.XMLParser(
            remove_comments=True, remove_pis=True, resolve_entities=False, no_network=True, encoding="cp1252"
        )
        return etree.fromstring(content, parser)


def _namespaces(root: Element) -> Iterator[str]:
    for element in root.iter():
        if "}" in element.tag:
            element.tag = element.tag.rpartition("}")[2]
            yield "XML namespaces were left out"
    etree.cleanup_namespaces(root)


def _version(root: Element) -> Iterator[str]:
    version = root.get("fmiVersion") or ""
    usual = {"1": "1.0", "2": "2.0"}.get(version.strip()[:1])
    if usual and version != usual:
        root.set("fmiVersion", usual)
        yield f'fmiVersion "{version}" was read as {usual}'


def _numbers(root: Element) -> Iterator[str]:
    for element in (root, *root.findall("CoSimulation"), *root.findall("ModelExchange")):
        for name in _WHOLE_NUMBERS:
            yield from _drop_unless(element, name, _is_whole)
    if root.get("fmiVersion") == "1.0" and not _is_whole(root.get("numberOfContinuousStates", "")):
        root.set("numberOfContinuousStates", "0")
        yield "numberOfContinuousStates is missing, read as 0"
    for definition in root.findall("UnitDefinitions/*/*"):
        for name in ("factor", "offset", "gain"):
            yield from _drop_unless(definition, name, _is_number)
        for name in _EXPONENTS:
            yield from _drop_unless(definition, name, _is_whole)


def _types(root: Element) -> Iterator[str]:
    for definition in root.findall("TypeDefinitions/*"):
        nested = root.get("fmiVersion", "")[:1] in ("1", "2")
        if nested and not len(definition):
            definition.getparent().remove(definition)
            yield f'the type "{definition.get("name")}" is empty and was left out'
            continue
        described = definition[0] if nested else definition
        for name in set(described.attrib) - _TYPE_ATTRIBUTES:
            del described.attrib[name]
            yield f'attribute {name} of the type "{definition.get("name")}" was left out'
        for item in described.findall("Item"):
            for name in set(item.attrib) - _ITEM_ATTRIBUTES:
                del item.attrib[name]


def _variables(root: Element) -> Iterator[str]:
    if root.find("ModelVariables") is None:
        etree.SubElement(root, "ModelVariables")
        yield "there are no ModelVariables"
    defined = {definition.get("name") for definition in root.findall("TypeDefinitions/*")}
    for variable in list(root.find("ModelVariables")):
        typed = _typed(root, variable)
        name = variable.get("name")
        if name is None or typed is None or not _is_whole(variable.get("valueReference", "")):
            # Kept in its place, as the model structure of FMI 2.0 counts variables.
            variable.attrib.pop("name", None)
            yield f'the variable "{name}" has no usable name, type or value reference and was left out'
            continue
        if typed.get("declaredType") is not None and typed.get("declaredType") not in defined:
            yield f'the type "{typed.attrib.pop("declaredType")}" of {name} is not defined'
        yield from _causality(root, variable)


def _typed(root: Element, variable: Element) -> Element | None:
    """Return the element that carries a variable's type; None if it has none."""
    if root.get("fmiVersion", "")[:1] == "3":
        return variable
    return next((child for child in variable if child.tag in _TYPES), None)


def _causality(root: Element, variable: Element) -> Iterator[str]:
    """Make causality and variability fit each other: the causality counts."""
    name = variable.get("name")
    if root.get("fmiVersion") == "1.0":
        for attribute, legal in (("causality", _CAUSALITIES_1), ("variability", _VARIABILITIES_1)):
            yield from _drop_unless(variable, attribute, legal.__contains__)
        return
    yield from _drop_unless(variable, "causality", _CAUSALITIES.__contains__)
    causality, variability = variable.get("causality", "local"), variable.get("variability")
    allowed = _CAUSALITIES[causality]
    # FMI 2.0 has one default for all; FMI 3.0's defaults follow the causality.
    assumed = "continuous" if root.get("fmiVersion", "")[:1] == "2" else allowed[0]
    if (variability or assumed) not in allowed:
        variable.set("variability", allowed[0])
        yield f"{name}: a {causality} cannot be {variability or assumed}; read as {allowed[0]}"


def _structure(root: Element) -> Iterator[str]:
    references = _references(root)
    key = "valueReference" if root.get("fmiVersion", "")[:1] == "3" else "index"
    for unknown in root.findall("ModelStructure//*"):
        if unknown.get(key) is None:
            continue
        if unknown.get(key) not in references:
            unknown.getparent().remove(unknown)
            yield f"ModelStructure names a variable {unknown.get(key)} that does not exist"
            continue
        dependencies = (unknown.get("dependencies") or "").split()
        if not set(dependencies) <= references:
            unknown.attrib.pop("dependencies")
            unknown.attrib.pop("dependenciesKind", None)
            yield f"the dependencies of the variable {unknown.get(key)} name variables that do not exist"
        elif "dependencies" in unknown.attrib:
            unknown.set("dependencies", " ".join(dependencies))
    for element in root.findall("ModelVariables//*[@derivative]"):
        yield from _drop_unless(element, "derivative", references.__contains__)


def _references(root: Element) -> set[str]:
    """Return what the model structure may use: value references in FMI 3.0, else places in the list."""
    variables = root.find("ModelVariables")
    if root.get("fmiVersion", "")[:1] == "3":
        return {variable.get("valueReference") for variable in variables if variable.get("name")}
    # FMPy counts the variables it has read: after one that was left out, places are not to be trusted.
    usable = [variable.get("name") is not None for variable in variables]
    count = usable.index(False) if False in usable else len(usable)
    return {str(i + 1) for i in range(count)}


def _clocks_and_dimensions(root: Element) -> Iterator[str]:
    references = _references(root)
    if root.get("fmiVersion", "")[:1] != "3":
        return
    for variable in root.find("ModelVariables"):
        if "clocks" in variable.attrib and not set(variable.get("clocks").split()) <= references:
            variable.attrib.pop("clocks")
            yield f"the clocks of {variable.get('name')} do not exist"
        for alias in variable.findall("Alias"):
            if alias.get("name") is None:
                variable.remove(alias)
                yield f"an alias of {variable.get('name')} has no name"


def _drop_unless(element: Element, name: str, fits: Callable[[str], bool]) -> Iterator[str]:
    value = element.get(name)
    if value is not None and not fits(value):
        del element.attrib[name]
        yield f'{name}="{value}" of {element.get("name") or element.tag} makes no sense and was left out'


def _is_whole(text: str) -> bool:
    return text.strip().removeprefix("-").isdecimal()


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


_REPAIRS: tuple[Callable[[Element], Iterator[str]], ...] = (
    _namespaces,
    _version,
    _numbers,
    _types,
    _variables,
    _structure,
    _clocks_and_dimensions,
)


_PROBLEMS_SHOWN = 3
_AS_GOOD_AS_INFINITE = 1e30
_MOST_ELEMENTS = 1_000_000
_TYPES_3 = {"Real": "Float64", "Integer": "Int32"}
_OLD_TYPES = frozenset({"Real", "Integer", "Boolean", "String", "Enumeration"})
_NEW_TYPES = (NUMERIC_TYPES - {"Real", "Integer"}) | {"String", "Binary", "Clock"}


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
        There is no description that can be understood.
    """
    if not (folder / "modelDescription.xml").is_file():
        raise FMUImportError(f"{label}: not an FMU: the archive has no modelDescription.xml")
    warnings: list[str] = []
    try:
        model = _read(folder, warnings)
        if model.coSimulation is None and model.modelExchange is None and model.scheduledExecution is None:
            raise FMUImportError(
                f"{label}: modelDescription.xml offers neither Co-Simulation nor Model Exchange"
            )
        _check_types(model, label)
        _check_sizes(model, label)
        if str(model.fmiVersion).startswith("3"):
            _add_directional_derivatives(folder / "modelDescription.xml", model)
        return _description(model, tuple(warnings), _negated(folder, model))
    except FMUImportError:
        raise
    except Exception as error:  # FMPy raises whatever the XML provokes
        raise FMUImportError(f"{label}: modelDescription.xml cannot be read: {one_line(error)}") from error


def _read(folder: Path, warnings: list[str]) -> Any:
    """Read with validation, without it, or after repairs, whichever succeeds first."""
    read = fmpy.model_description.read_model_description
    try:
        # Names and model structure are left out: checking them takes long, and nothing here needs them.
        return read(str(folder), validate=True, validate_variable_names=False, validate_model_structure=False)
    except Exception as error:
        problems = _problems(error).replace(str(folder / "modelDescription.xml"), "modelDescription.xml")
        warnings.append(f"modelDescription.xml fails validation: {problems}")
    try:
        return read(str(folder), validate=False)
    except Exception:
        warnings += repair(folder / "modelDescription.xml")
    return read(str(folder), validate=False)


def _add_directional_derivatives(path: Path, model: Any) -> None:
    """Add what FMPy leaves out of FMI 3.0's interfaces: it knows the attribute by FMI 2.0's name only."""
    interfaces = {"ModelExchange": model.modelExchange, "CoSimulation": model.coSimulation}
    with path.open("rb") as file:
        for _, element in etree.iterparse(file, events=("start",)):
            if element.tag == "ModelVariables":  # the interfaces come before
                return
            interface = interfaces.get(element.tag)
            if interface is not None:
                provided = element.get("providesDirectionalDerivatives") in ("true", "1")
                interface.providesDirectionalDerivative = provided


def _check_types(model: Any, label: str) -> None:
    """Refuse variables of types that the FMU's version has no functions for."""
    known = _OLD_TYPES if str(model.fmiVersion) < "3" else _NEW_TYPES
    foreign = [v for v in model.modelVariables if v.type not in known]
    if foreign:
        listed = ", ".join(f"{v.name} ({v.type})" for v in foreign[:_PROBLEMS_SHOWN])
        raise FMUImportError(f"{label}: FMI {model.fmiVersion} has no such type of variable: {listed}")


def _check_sizes(model: Any, label: str) -> None:
    """Refuse arrays whose elements, each a signal of its own, would not fit into memory."""
    for variable in model.modelVariables:
        count = math.prod(variable.shape or ())
        if count > _MOST_ELEMENTS:
            raise FMUImportError(
                f"{label}: the array {variable.name} has {count} elements; allowed: {_MOST_ELEMENTS}"
            )


def _problems(error: Exception) -> str:
    """Return the first problems that a validation found."""
    problems = [" ".join(str(problem).split()) for problem in getattr(error, "problems", [one_line(error)])]
    more = f"; and {len(problems) - _PROBLEMS_SHOWN} more" if len(problems) > _PROBLEMS_SHOWN else ""
    return "; ".join(problems[:_PROBLEMS_SHOWN])[:500] + more


def one_line(error: BaseException) -> str:
    """Return an error's text on one line."""
    return " ".join(str(error).split())[:300] or type(error).__name__


def _negated(folder: Path, model: Any) -> frozenset[str]:
    """Return the variables whose values have the opposite sign (FMI 1.0), of which FMPy knows nothing."""
    if not str(model.fmiVersion).startswith("1"):
        return frozenset()
    variables = parse(folder / "modelDescription.xml").iterfind("ModelVariables/ScalarVariable")
    return frozenset(v.get("name") for v in variables if v.get("alias") == "negatedAlias")


def _description(model: Any, warnings: tuple[str, ...], negated: frozenset[str]) -> FMUDescription:
    definitions = {
        str(unit.name): tuple(
            DisplayUnit(str(d.name), float(d.factor), float(d.offset)) for d in unit.displayUnits
        )
        for unit in model.unitDefinitions
    }
    return FMUDescription(
        fmi_version=str(model.fmiVersion),
        guid=str(model.guid or ""),
        model_name=str(model.modelName or ""),
        variables={
            str(v.name): _variable(v, definitions, int(str(model.fmiVersion)[0]), str(v.name) in negated)
            for v in model.modelVariables
        },
        interfaces=dict(_interfaces(model)),
        generation_tool=str(model.generationTool or "unknown"),
        generated_at=str(model.generationDateAndTime or ""),
        author=str(model.author or ""),
        version=str(model.version or ""),
        copyright=str(model.copyright or ""),
        license=str(model.license or ""),
        text=str(model.description or ""),
        continuous_states=int(model.numberOfContinuousStates or 0),
        event_indicators=int(model.numberOfEventIndicators or 0),
        derivatives=tuple(str(u.variable.name) for u in model.derivatives),
        default_experiment=_default_experiment(model.defaultExperiment),
        display_units=definitions,
        dependencies={str(u.variable.name): _dependencies(u) for u in model.outputs},
        warnings=warnings,
    )


def _interfaces(model: Any) -> Iterator[tuple[Kind, Interface]]:
    kinds: tuple[tuple[Kind, Any], ...] = (
        ("co-simulation", model.coSimulation),
        ("model-exchange", model.modelExchange),
    )
    for kind, interface in kinds:
        if interface is not None:
            yield kind, _interface(kind, interface, str(model.fmiVersion))


def _interface(kind: Kind, interface: Any, fmi_version: str) -> Interface:
    fixed_step = getattr(interface, "fixedInternalStepSize", None)
    is_fmi1 = fmi_version.startswith("1")
    return Interface(
        kind=kind,
        model_identifier=str(interface.modelIdentifier or ""),
        needs_execution_tool=bool(interface.needsExecutionTool),
        only_one_instance=bool(interface.canBeInstantiatedOnlyOncePerProcess),
        can_save_state=bool(interface.canGetAndSetFMUstate),
        can_serialize_state=bool(interface.canSerializeFMUstate),
        provides_directional_derivatives=bool(interface.providesDirectionalDerivative),
        variable_step=is_fmi1 or bool(getattr(interface, "canHandleVariableCommunicationStepSize", True)),
        fixed_step=number(fixed_step, 0.0) or None,
        has_event_mode=bool(getattr(interface, "hasEventMode", False)),
        needs_completed_step=bool(getattr(interface, "needsCompletedIntegratorStep", False)),
    )


def _default_experiment(experiment: Any) -> DefaultExperiment:
    def value(name: str) -> float | None:
        found = number(getattr(experiment, name, None), math.nan)
        return found if math.isfinite(found) else None

    return DefaultExperiment(value("startTime"), value("stopTime"), value("tolerance"), value("stepSize"))


def _dependencies(unknown: Any) -> tuple[str, ...] | None:
    return None if unknown.dependencies is None else tuple(str(v.name) for v in unknown.dependencies)


def _variable(
    variable: Any, definitions: Mapping[str, tuple[DisplayUnit, ...]], major: int, negated: bool
) -> FMUVariable:
    declared = variable.declaredType

    def attribute(name: str) -> Any:
        """Return an attribute of the variable, or of its declared type where it has none."""
        own = getattr(variable, name)
        return own if own is not None else getattr(declared, name, None)

    unit = str(attribute("unit") or "")
    # FMPy lets FMI 2.0's names of types pass in a description for FMI 3.0.
    fmi_type = _TYPES_3.get(str(variable.type), str(variable.type)) if major == 3 else str(variable.type)
    low, high = _range(fmi_type)
    return FMUVariable(
        variable=Variable(
            name=str(variable.name),
            unit=unit,
            min=_bound(attribute("min"), low),
            max=_bound(attribute("max"), high),
            nominal=number(attribute("nominal"), 1.0),
            start=_start(variable.start),
            description=str(variable.description or ""),
            display_unit=find_display_unit(definitions.get(unit, ()), str(attribute("displayUnit") or "")),
        ),
        reference=int(variable.valueReference),
        type=fmi_type,
        causality=variable.causality if variable.causality in CAUSALITIES else "local",
        variability=str(variable.variability or "continuous"),
        # FMI 1.0 has no such attribute: what has a start value can be given another one.
        initial=str(variable.initial or ("" if variable.start is None else "exact")),
        shape=tuple(variable.shape or ()),
        dimensions=tuple(
            d.start if d.variable is None else str(d.variable.name) for d in variable.dimensions
        ),
        start_text=variable.start,
        items={str(i.name): int(number(i.value, 0.0)) for i in getattr(declared, "items", ())},
        derivative_of=str(variable.derivative.name) if variable.derivative is not None else "",
        negated=negated,
    )


def find_display_unit(candidates: tuple[DisplayUnit, ...], name: str) -> DisplayUnit | None:
    """Return the display unit of a name."""
    return next((unit for unit in candidates if unit.name == name), None)


def _bound(text: object, none: float) -> float:
    """Return a limit; many tools write the largest number that they know where there is none."""
    bound = number(text, none)
    return none if abs(bound) >= _AS_GOOD_AS_INFINITE else bound


def _range(fmi_type: str) -> tuple[float, float]:
    """Return the smallest and largest value that the type can hold."""
    if fmi_type == "Boolean":
        return 0.0, 1.0
    if fmi_type in INTEGER_TYPES and fmi_type != "Integer":
        bits = int(fmi_type.lstrip("UInt"))
        return (
            (0.0, 2.0**bits - 1)
            if fmi_type.startswith("U")
            else (-(2.0 ** (bits - 1)), 2.0 ** (bits - 1) - 1)
        )
    return -math.inf, math.inf


def _start(text: Any) -> float:
    """Return a start value; for an array that of its first element."""
    first = next(chain(str(text or "").split(), [""]))
    return number(first, 0.0)
