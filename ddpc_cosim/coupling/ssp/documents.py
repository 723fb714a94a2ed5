"""What an SSP archive says, as written: systems, components, connectors (SSP 1.0 and 2.0, chapters 3 to 5).

Nested systems, systems in other files of the archive and nested archives are all systems within systems here.
Everything that is wrong is noted, and the reading goes on.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from tempfile import mkdtemp
from typing import NamedTuple
from urllib.parse import unquote, urlsplit
from xml.etree.ElementTree import Element

from ddpc_cosim.errors import ConfigError, FMUImportError
from ddpc_cosim.fmu.archive import UnpackLimits, XMLTree, read_xml, unpack
from ddpc_cosim.fmu.description import FMUDescription
from ddpc_cosim.fmu.description.reader import read_description
from ddpc_cosim.fmu.description.variables import is_true
from ddpc_cosim.plant import FMIType, ParameterValue
from fmu_plants.spelling import did_you_mean
from fmu_plants.units import SIUnit, parse_unit

SSD = "SystemStructure.ssd"
VERSIONS = ("1.0", "2.0")
_BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_DEEPEST = 16
_MOST_ELEMENTS = 2_000
_FMU, _SSD_TYPE, _SSP_TYPE = (
    "application/x-fmu-sharedlibrary",
    "application/x-ssp-definition",
    "application/x-ssp-package",
)
_FMI_TYPES: Mapping[str, FMIType] = {
    "any": "auto",
    "CoSimulation": "co-simulation",
    "ModelExchange": "model-exchange",
}
_STEP_SIZES = ("stepSize", "baseStepSize")

Path_ = tuple[str, ...]
"""The names that lead from the outermost system to an element."""


class Unit(NamedTuple):
    """A unit: its name, and what it is in SI units; None where that is not known."""

    name: str = ""
    si: SIUnit | None = None

    def conversion_to(self, target: "Unit") -> tuple[float, float]:
        """Return factor and offset of values in this unit to another one; those without a unit stay.

        Raises
        ------
        ValueError
            There is no conversion.
        """
        source, other = self.si, target.si
        if self.name == target.name or not self.name or not target.name:
            return 1.0, 0.0
        if source is None or other is None:
            unknown = self.name if source is None else target.name
            raise ValueError(
                f'"{self.name}" cannot be converted to "{target.name}": "{unknown}" is not defined in Units'
            )
        if source.exponents != other.exponents:
            raise ValueError(f'"{self.name}" and "{target.name}" are units of different quantities')
        return source.factor / other.factor, (source.offset - other.offset) / other.factor


@dataclass(frozen=True, slots=True)
class Transformation:
    """What becomes of a value on its way: ``factor * value + offset``, or what a table has for it."""

    factor: float = 1.0
    offset: float = 0.0
    table: Mapping[ParameterValue, ParameterValue] = field(default_factory=dict)
    kind: str = ""


class Document:
    """An XML file of an archive.

    Parameters
    ----------
    root : Element
        Its root.
    label : str
        What it is called in errors.
    file : Path
        Where it is: relative paths in it are relative to its folder.
    package : Path
        The folder of the archive, which no path leaves.
    """

    def __init__(self, root: Element, label: str, file: Path, package: Path) -> None:
        self.root, self.label, self.file, self.package = root, label, file, package
        self.enumerations = {
            enumeration.get("name", ""): {
                item.get("name", ""): item.get("value", "") for item in enumeration.iterfind("Item")
            }
            for enumeration in root.iterfind("Enumerations/Enumeration")
        }

    @cached_property
    def _units(self) -> dict[str, SIUnit]:
        units = {}
        for unit in self.root.iterfind("Units/Unit"):
            base = unit.find("BaseUnit")
            written = {} if base is None else base.attrib
            numbers = {key: number(text) for key, text in written.items()}
            powers = {key: round(numbers[key]) for key in _BASE_UNITS if numbers.get(key)}
            factor, offset = numbers.get("factor", 1.0), numbers.get("offset", 0.0)
            units[unit.get("name", "")] = SIUnit(powers, factor, offset)
        return units

    def unit(self, name: str | None) -> Unit:
        """Return a unit by name: as this file defines it, else its usual meaning."""
        name = (name or "").strip(" []")  # some tools write [m]
        try:
            return Unit(name, self._units.get(name) or parse_unit(name))
        except ValueError:
            return Unit(name)


def number(text: str | None) -> float:
    """Return the number that a text stands for; ValueError if it is not one."""
    return float(text or "")


def children(element: Element, *path: str) -> Iterator[Element]:
    """Yield the elements below a path of tags."""
    return element.iterfind("/".join(path))


@dataclass(frozen=True, slots=True)
class Connector:
    """A connector of a system or a component, as written; ``shape`` is None where it says no size."""

    name: str
    kind: str
    unit: Unit
    shape: tuple[int, ...] | None
    is_real: bool


@dataclass(slots=True)
class Binding:
    """A parameter binding, the file it stands in, and the folder of the resource that it belongs to."""

    element: Element
    document: Document
    resource: Path | None


@dataclass(slots=True)
class Component:
    """An FMU in a system."""

    path: Path_
    document: Document
    connectors: dict[str, Connector]
    bindings: list[Binding]
    fmu: Path
    description: FMUDescription
    fmi_type: FMIType

    @property
    def name(self) -> str:
        """Its place among the systems, for people."""
        return "/".join(self.path)


@dataclass(slots=True)
class System:
    """A system: its elements by name, names of those that cannot be read, and connections as written."""

    path: Path_
    document: Document
    connectors: dict[str, Connector]
    bindings: list[Binding]
    elements: "dict[str, System | Component]" = field(default_factory=dict)
    missing: set[str] = field(default_factory=set)
    connections: list[Element] = field(default_factory=list)

    @property
    def name(self) -> str:
        """Its place among the systems, for people; of the outermost one what it is."""
        return "/".join(self.path) or "the system"

    def components(self) -> Iterator[Component]:
        """Yield the components of this system and of those within it."""
        for element in self.elements.values():
            if isinstance(element, System):
                yield from element.components()
            else:
                yield element

    def systems(self) -> Iterator["System"]:
        """Yield this system and those within it."""
        yield self
        for element in self.elements.values():
            if isinstance(element, System):
                yield from element.systems()


class Reader:
    """Reads an archive and all its content.

    Parameters
    ----------
    scratch : Path
        Folder that archives are unpacked into.

    Attributes
    ----------
    faults, warnings : list of str
        What is wrong, and what was understood all the same.
    """

    def __init__(self, scratch: Path) -> None:
        self.faults: list[str] = []
        self.warnings: list[str] = []
        self._scratch = scratch
        self._fmus: dict[Path, tuple[Path, FMUDescription]] = {}
        self._elements, self._room = 0, UnpackLimits().max_unpacked_size

    def archive(self, path: Path, label: str, ssd: str = SSD, at: Path_ = ()) -> System | None:
        """Return the outermost system of an archive."""
        try:
            folder = self._unpacked(path, needed=SSD, kind="SSP archive")
        except FMUImportError as error:
            self.faults.append(str(error))
            return None
        file = self.locate(ssd, folder, folder, label)
        return None if file is None else self._description(file, f"{label}: {ssd}", folder, at)

    def document(self, file: Path, label: str, root: str, package: Path) -> Document | None:
        """Return a file of an archive, whose root and version have to be the right ones."""
        try:
            return self.checked(Document(read_xml(file, label, XMLTree).root, label, file, package), root)
        except FMUImportError as error:
            self.faults.append(str(error))
        return None

    def checked(self, document: Document, root: str) -> Document | None:
        """Return a document if its root and its version are the right ones."""
        tag, version = document.root.tag, document.root.get("version", "")
        if tag != root:
            self.faults.append(f"{document.label}: its root is <{tag[:100]}>; needed: <{root}>")
        elif version not in VERSIONS:
            allowed = " and ".join(VERSIONS)
            self.faults.append(
                f'{document.label}: version "{version}" of SSP; {allowed} can be read: export it again as one'
            )
        else:
            return document
        return None

    def locate(self, uri: str, folder: Path, package: Path, where: str) -> Path | None:
        """Return the file of an archive that a URI means."""
        parts = urlsplit(uri)
        path = (folder / unquote(parts.path)).resolve()
        if parts.scheme or parts.netloc or not path.is_relative_to(package.resolve()):
            self.faults.append(f'{where}: "{uri}" is outside of the archive; put it into resources/')
        elif not path.is_file():
            there = [
                file.relative_to(package).as_posix()
                for file in package.rglob("*")
                if file.suffix.lower() == path.suffix.lower() and file.is_file()
            ]
            self.faults.append(f'{where}: no file "{uri}" in the archive; {did_you_mean(uri, there)}')
        else:
            return path
        return None

    def _description(self, file: Path, label: str, package: Path, at: Path_) -> System | None:
        document = self.document(file, label, "SystemStructureDescription", package)
        if document is None:
            return None
        system = document.root.find("System")
        if system is None:
            self.faults.append(f"{label}: there is no <System>")
            return None
        return self._system(system, document, at)

    def _system(self, xml: Element, document: Document, at: Path_) -> System | None:
        if len(at) > _DEEPEST:
            self.faults.append(f"{'/'.join(at[:3])}...: more than {_DEEPEST} systems within each other")
            return None
        system = System(at, document, {}, [Binding(binding, document, None) for binding in _bindings(xml)])
        system.connectors = self._connectors(xml, document, system.name)
        system.connections = list(children(xml, "Connections", "Connection"))
        for element in xml.iterfind("Elements/*"):
            name = element.get("name", "")
            self._elements += 1
            if self._elements > _MOST_ELEMENTS:
                raise ConfigError(f"{document.label}: more than {_MOST_ELEMENTS} systems and components")
            if not name or name in system.elements or name in system.missing:
                what = f'there are two elements "{name}"' if name else "an element has no name"
                self.faults.append(f"{document.label}: {system.name}: {what}")
            elif (read := self._element(element, document, (*at, name))) is None:
                system.missing.add(name)
            else:
                system.elements[name] = read
        return system

    def _element(self, xml: Element, document: Document, at: Path_) -> System | Component | None:
        """Return a system or a component within a system; None where it cannot be read."""
        where = f"{document.label}: {'/'.join(at)}"
        if xml.tag == "System":
            return self._system(xml, document, at)
        if xml.tag == "Component":
            return self._component(xml, document, at, where)
        self.faults.append(f"{where}: <{xml.tag}> is not supported; connect the elements directly")
        return None

    def _component(
        self, xml: Element, document: Document, at: Path_, where: str
    ) -> System | Component | None:
        kind, source = xml.get("type", _FMU).partition(";")[0].strip(), xml.get("source")
        if source is None:
            self.faults.append(f"{where}: the component has no source; give it an FMU")
            return None
        path, _, fragment = source.partition("#")
        folder = document.file.parent
        if kind in (_SSD_TYPE, _SSP_TYPE):
            inner = self._referenced(kind, path, fragment, document, at, where)
            if inner is not None:
                inner.bindings += [Binding(b, document, inner.document.package) for b in _bindings(xml)]
            return inner
        if kind != _FMU:
            self.faults.append(f'{where}: components of type "{kind}" are not supported; export an FMU of it')
            return None
        implementation = xml.get("implementation", "any")
        if implementation not in _FMI_TYPES:
            allowed = ", ".join(_FMI_TYPES)
            self.faults.append(f'{where}: implementation "{implementation}" cannot run; {allowed} can')
        file = self.locate(path, folder, document.package, where)
        if file is None or implementation not in _FMI_TYPES:
            return None
        try:
            resource, description = self._fmu(file)
        except FMUImportError as error:
            self.faults.append(f"{where}: {error}")
            return None
        bindings = [Binding(binding, document, resource) for binding in _bindings(xml)]
        connectors = self._connectors(xml, document, where)
        fmi_type = _FMI_TYPES[implementation]
        return Component(at, document, connectors, bindings, file, description, fmi_type)

    def _referenced(
        self, kind: str, path: str, fragment: str, document: Document, at: Path_, where: str
    ) -> System | None:
        """Return the system that a component stands for: of this file, of another one, or of an archive."""
        if not path:
            system = next((s for s in document.root.iter("System") if s.get("id") == fragment), None)
            if system is None:
                self.faults.append(f'{where}: no system has the id "{fragment}"')
            return None if system is None else self._system(system, document, at)
        file = self.locate(path, document.file.parent, document.package, where)
        if file is None:
            return None
        if kind == _SSP_TYPE:
            return self.archive(file, f"{where}: {file.name}", fragment or SSD, at)
        return self._description(file, f"{where}: {file.name}", document.package, at)

    def _fmu(self, file: Path) -> tuple[Path, FMUDescription]:
        """Return the folder and the description of an FMU, which several components may be."""
        if file not in self._fmus:
            folder = self._unpacked(file)
            self._fmus[file] = folder, read_description(folder, file.name)
        return self._fmus[file]

    def _unpacked(self, path: Path, **what: str) -> Path:
        """Return a folder with the files of an archive; all archives share the room that there is."""
        folder = Path(mkdtemp(dir=self._scratch))
        unpack(path, folder, UnpackLimits(max_unpacked_size=self._room), **what)
        self._room -= sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
        return folder

    def _connectors(self, xml: Element, document: Document, where: str) -> dict[str, Connector]:
        connectors = dict[str, Connector]()
        for connector in children(xml, "Connectors", "Connector"):
            name = connector.get("name", "")
            typed = next((x for x in connector if x.tag not in _NOT_TYPES), None)
            unit = document.unit(None if typed is None else typed.get("unit"))
            shape = self._shape(connector, f"{document.label}: {where}.{name}")
            if name in connectors:
                self.faults.append(f'{document.label}: {where}: there are two connectors "{name}"')
            is_real = typed is None or typed.tag in ("Real", "Float64", "Float32")
            connectors[name] = Connector(name, connector.get("kind", ""), unit, shape, is_real)
        return connectors

    def _shape(self, xml: Element, where: str) -> tuple[int, ...] | None:
        """Return the sizes of a connector; None where it leaves them to others."""
        sizes = [dimension.get("size") for dimension in xml.iterfind("Dimension")]
        wrong = [size for size in sizes if size is not None and not re.fullmatch(r"\d{1,6}", size)]
        if wrong:
            self.faults.append(f'{where}: size "{wrong[0]}" is not an integer >= 0')
        return None if None in sizes or wrong else tuple(int(size or 0) for size in sizes)

    def transformation(self, xml: Element, where: str) -> Transformation:
        """Return what a connection or the entry of a mapping does with values."""
        transformation = next((child for child in xml if child.tag.endswith("Transformation")), None)
        if transformation is None:
            return Transformation()
        kind = transformation.tag.removesuffix("Transformation").removesuffix("Mapping")
        try:
            if kind == "Linear":
                factor, offset = (number(transformation.get(k, default)) for k, default in _LINEAR)
                return Transformation(factor, offset, kind=kind)
            convert = _CONVERT[kind]
            entries = [(convert(e.get("source", "")), convert(e.get("target", ""))) for e in transformation]
        except (ValueError, KeyError) as error:
            self.faults.append(f"{where}: <{transformation.tag}> cannot be read: {error}")
            return Transformation()
        if len({source for source, _ in entries}) < len(entries):
            self.faults.append(f"{where}: <{transformation.tag}> has two entries for one value")
        return Transformation(table=dict(entries), kind=kind)


_LINEAR = (("factor", "1"), ("offset", "0"))
_CONVERT: Mapping[str, Callable[[str], ParameterValue]] = {
    "Boolean": is_true,
    "Integer": int,
    "Enumeration": str,
}
_NOT_TYPES = ("Dimension", "ConnectorGeometry", "Annotations", "MetaData", "Signature")


def _bindings(xml: Element) -> Iterable[Element]:
    return children(xml, "ParameterBindings", "ParameterBinding")


def step_size(document: Document) -> float | None:
    """Return the step size that an annotation of the maker's tool suggests; None for none.

    SSP has no place for it; OMSimulator and the Open Simulation Platform write it into annotations.
    """
    for element in document.root.iter():
        for key in _STEP_SIZES:
            try:
                if (step := number(element.get(key))) > 0.0:
                    return step
            except ValueError:
                continue
    return None
