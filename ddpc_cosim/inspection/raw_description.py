"""A model description as it is written, faults included: what the checks look at.

:mod:`ddpc_cosim.fmu.reader` gives what an FMU means; here nothing is repaired, resolved or refused.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from lxml import etree  # type: ignore[import-untyped]

from ddpc_cosim.fmu.reader import parse

Attributes = Mapping[str, str]
_INTERFACES = ("CoSimulation", "ModelExchange", "ScheduledExecution")
_FMI1_INTERFACES = {
    "CoSimulation_StandAlone": "CoSimulation",
    "CoSimulation_Tool": "CoSimulation",
}


@dataclass(frozen=True, slots=True)
class DeclaredVariable:
    """A variable as written.

    Parameters
    ----------
    type : str
        ``Real``, ``Float64``, ``Boolean``, ...; empty if there is none.
    own : mapping of str to str
        Its attributes and those of its type element.
    inherited : mapping of str to str
        Attributes of the type definition that it names.
    """

    type: str
    own: Attributes
    inherited: Attributes = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The variable's name."""
        return self.own.get("name", "")

    @property
    def reference(self) -> str:
        """The value reference, as written."""
        return self.own.get("valueReference", "")

    @property
    def causality(self) -> str:
        """The causality, ``local`` where there is none."""
        return self.own.get("causality", "local")

    def get(self, attribute: str) -> str | None:
        """Return an attribute of the variable, or of its type definition."""
        return self.own.get(attribute, self.inherited.get(attribute))


@dataclass(frozen=True, slots=True)
class StructureEntry:
    """An entry of the model structure: an element's name and the variable that it refers to, as written."""

    element: str
    target: str
    dependencies: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Declared:
    """A model description as written.

    Parameters
    ----------
    root : mapping of str to str
        Attributes of the root element.
    interfaces : mapping of str to attributes
        By element name; FMI 1.0 under the names of FMI 2.0.
    units : mapping of str to set of str
        The display units of every unit that is defined.
    types : mapping of str to attributes
        The type definitions by name.
    structure : tuple of StructureEntry
        The model structure (FMI 2.0, 3.0).
    source_files : tuple of str
        Names in the source file lists (FMI 2.0).
    """

    root: Attributes
    interfaces: Mapping[str, Attributes]
    variables: tuple[DeclaredVariable, ...]
    units: Mapping[str, frozenset[str]]
    types: Mapping[str, Attributes]
    structure: tuple[StructureEntry, ...]
    experiment: Attributes
    source_files: tuple[str, ...]

    @property
    def major(self) -> int:
        """The FMI version: 1, 2, 3; 0 for any other."""
        first = self.root.get("fmiVersion", "")[:1]
        return int(first) if first in ("1", "2", "3") else 0

    @property
    def preferred(self) -> str:
        """The interface that is used unless another is asked for; empty if there is none that can be."""
        return next((name for name in ("CoSimulation", "ModelExchange") if name in self.interfaces), "")


def read_declared(path: Path) -> Declared:
    """Read a model description file.

    Raises
    ------
    ValueError
        It is not well-formed XML.
    """
    root = _root(path)
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]  # FMI knows no namespaces, some tools do
    types = dict(_types(root))
    return Declared(
        root=root.attrib,
        interfaces=dict(_interfaces(root)),
        variables=tuple(_variables(root, types)),
        units=dict(_units(root)),
        types=types,
        structure=tuple(_structure(root)),
        experiment=_attributes(root.find("DefaultExperiment")),
        source_files=tuple(f.get("name", "") for f in root.iterfind("./*/SourceFiles/File")),
    )


def _root(path: Path) -> ElementTree.Element:
    try:
        return ElementTree.parse(path).getroot()
    except (ElementTree.ParseError, LookupError, UnicodeError) as error:
        fault = error
    try:  # as it is read for use
        return ElementTree.fromstring(etree.tostring(parse(path), encoding="UTF-8"))
    except (etree.LxmlError, ElementTree.ParseError, LookupError, ValueError):
        raise ValueError(f"{path.name} is not well-formed XML: {fault}") from fault


def _attributes(element: ElementTree.Element | None) -> Attributes:
    return {} if element is None else element.attrib


def _interfaces(root: ElementTree.Element) -> Iterator[tuple[str, Attributes]]:
    if root.get("fmiVersion", "").startswith("1"):
        implementation = root.find("Implementation")
        found = [e.tag for e in implementation] if implementation is not None else []
        yield _FMI1_INTERFACES.get(next(iter(found), ""), "ModelExchange"), root.attrib
        return
    for name in _INTERFACES:
        element = root.find(name)
        if element is not None:
            yield name, element.attrib


def _types(root: ElementTree.Element) -> Iterator[tuple[str, Attributes]]:
    for definition in root.iterfind("./TypeDefinitions/*"):
        inner = definition[0].attrib if len(definition) else {}
        yield definition.get("name", ""), {**inner, **definition.attrib}


def _units(root: ElementTree.Element) -> Iterator[tuple[str, frozenset[str]]]:
    for unit in root.iterfind("./UnitDefinitions/*"):
        shown = (d.get("name", d.get("displayUnit", "")) for d in unit.iter() if "DisplayUnit" in d.tag)
        yield unit.get("name", unit.get("unit", "")), frozenset(shown)


def _variables(root: ElementTree.Element, types: Mapping[str, Attributes]) -> Iterator[DeclaredVariable]:
    for element in root.iterfind("./ModelVariables/*"):
        # FMI 1.0 and 2.0 have a type element inside; in FMI 3.0 the element is the type.
        inner: ElementTree.Element | None = element
        if element.tag == "ScalarVariable":
            inner = next((e for e in element if e.tag not in ("Annotations", "DirectDependency")), None)
        own = {**element.attrib, **_attributes(inner)}
        if element.find("Start") is not None:
            own.setdefault("start", "")
        declared_type = types.get(own.get("declaredType", ""), {})
        type_name = "" if inner is None else inner.tag
        yield DeclaredVariable(type_name, own, declared_type)


def _structure(root: ElementTree.Element) -> Iterator[StructureEntry]:
    structure = root.find("ModelStructure")
    for element in structure if structure is not None else ():
        entries = element.findall("Unknown") if "valueReference" not in element.attrib else [element]
        for entry in entries:
            target = entry.get("index", entry.get("valueReference", ""))
            yield StructureEntry(element.tag, target, tuple(entry.get("dependencies", "").split()))
