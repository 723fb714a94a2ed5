"""Mending model descriptions that FMPy cannot read but that can be understood.

Every repair drops or replaces an attribute or an element that contradicts the standard, and says so.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from lxml import etree  # type: ignore[import-untyped]

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
