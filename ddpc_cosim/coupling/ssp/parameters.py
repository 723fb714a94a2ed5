"""The parameter values of an SSP: SSV sets and SSM mappings, applied to components and outer connectors.

Bindings further in count less than those further out, earlier ones less than later ones (SSP 2.0, section
5.3.3). Names are hierarchical, with dots; a value that fits several variables goes to all of them, one that
fits none is not applied. A value for a connector of a system goes where its connections lead. Units are
converted first, then values transformed.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

from ddpc_cosim.coupling.ssp.connections import Connections, Node
from ddpc_cosim.coupling.ssp.documents import (
    Binding,
    Component,
    Document,
    Path_,
    Reader,
    System,
    Transformation,
    Unit,
    number,
)
from ddpc_cosim.description import DescribedVariable, element
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.fmu.buffers import StartValues
from ddpc_cosim.fmu.description.variables import is_true
from ddpc_cosim.plant import ParameterValue

_SHOWN = 5
_SET, _MAPPING = "ParameterSet", "ParameterMapping"
_REALS = ("Real", "Float64", "Float32")


@dataclass(frozen=True, slots=True)
class Value:
    """The value of a parameter as written: one, or the elements of an array; and how it is used."""

    values: tuple[ParameterValue, ...]
    kind: str
    unit: Unit = field(default_factory=Unit)
    how: Transformation = field(default_factory=Transformation)
    converts: bool = True
    items: Mapping[str, str] = field(default_factory=dict)

    def arrived(self, unit: Unit) -> "Value":
        """Return the value where it is used, in the unit there.

        Raises
        ------
        ValueError
            Its unit cannot be converted, or it cannot be transformed so.
        """
        values = self.values
        if self.kind == "real" and self.converts:
            factor, offset = self.unit.conversion_to(unit)
            values = tuple(factor * _float(value) + offset for value in values)
        return replace(self, values=tuple(map(self._transformed, values)), how=Transformation(), unit=unit)

    def _transformed(self, value: ParameterValue) -> ParameterValue:
        how = self.how
        if how.kind == "Linear":
            if self.kind not in ("real", "integer"):
                raise ValueError(f"a linear transformation of a {self.kind}")
            return how.factor * _float(value) + how.offset
        if how.kind == "Integer" and self.kind == "enumeration":
            if value not in self.items:
                raise ValueError(f'an integer mapping of "{value}", whose number no enumeration tells')
            value = int(self.items[str(value)])
        elif how.kind and how.kind.lower() != self.kind:
            raise ValueError(f"a mapping of {how.kind} values, and it is a {self.kind}")
        return how.table.get(value, value)


class _Entry(NamedTuple):
    """An entry of a mapping."""

    source: str
    target: str
    how: Transformation
    converts: bool


class Parameters:
    """The values that the bindings of a system give.

    Parameters
    ----------
    connections : Connections
        The system's.
    reader : Reader
        What was found before; what is found here is added to its faults and warnings.

    Attributes
    ----------
    components : dict of path to dict of str to value
        For each component the values of its variables; those of arrays by element.
    connectors : dict of str to float
        Values of the outer connectors.
    """

    def __init__(self, connections: Connections, reader: Reader) -> None:
        self._connections, self._reader = connections, reader
        self.components: dict[Path_, dict[str, ParameterValue]] = {}
        self.connectors: dict[str, ParameterValue] = {}
        self._apply(connections.system)
        for component in connections.system.components():
            try:
                values = self.components.get(component.path, {})
                StartValues(component.description, component.name, values, ())
            except ConfigError as error:
                reader.faults += error.faults

    def _apply(self, target: System | Component) -> None:
        """Apply all bindings within an element, those further out after those further in."""
        if isinstance(target, System):
            for within in target.elements.values():
                self._apply(within)
        for binding in target.bindings:
            self._apply_binding(target, binding)

    def _apply_binding(self, target: System | Component, binding: Binding) -> None:
        label = f"{binding.document.label}: {target.name}"
        document = self._set_of(binding, label)
        if document is None:
            return
        prefix = binding.element.get("prefix") or ""
        written = {prefix + name: value for name, value in self._written(document)}
        entries = self._mapping(binding, label)
        if entries is None:
            given = list(written.items())
        else:
            missing = [entry.source for entry in entries if entry.source not in written]
            self._note_unused(label, "mapped parameters that the set does not have", missing)
            given = [
                (entry.target, replace(written[entry.source], how=entry.how, converts=entry.converts))
                for entry in entries
                if entry.source in written
            ]
        unused = [
            name for name, value in given if not self._give(target, name, value, f"{document.label}: {name}")
        ]
        self._note_unused(document.label, f"parameters that nothing in {target.name} has", unused)

    def _note_unused(self, label: str, what: str, names: Sequence[str]) -> None:
        if names:
            more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
            self._reader.warnings.append(
                f"{label}: {what}, which are left out: {', '.join(names[:_SHOWN])}{more}"
            )

    def _give(self, target: System | Component, name: str, value: Value, where: str) -> bool:
        """Give a value to all variables of a name; return whether there is one."""
        if isinstance(target, Component):
            return self._set(target, name, value, where)
        exists = name in target.connectors
        if exists:
            self._pass_on(Node(target.path, name), value, where)
        for inner, within in target.elements.items():
            if name.startswith(f"{inner}."):
                exists |= self._give(within, name[len(inner) + 1 :], value, where)
        return exists

    def _pass_on(self, node: Node, value: Value, where: str) -> None:
        """Give a value to a connector of a system, and to all that is connected to it."""
        unit = self._connections.unit(node)
        try:
            arrived = value.arrived(unit)
        except ValueError as error:
            self._reader.faults.append(f"{where}: {error}")
            return
        arrived = replace(arrived, unit=unit if unit.name else value.unit, converts=True)
        if not node.element:
            self.connectors[node.name] = arrived.values[0]
        for edge in self._connections.out_of.get(node, ()):
            component = self._connections.components.get(edge.target.element)
            there = replace(arrived, how=edge.how, converts=edge.converts)
            if component is not None:
                self._set(component, edge.target.name, there, where)
            else:
                self._pass_on(edge.target, there, where)

    def _set(self, component: Component, name: str, value: Value, where: str) -> bool:
        """Give a value to a variable of an FMU; return whether there is one."""
        signal = component.description.signal(name)
        variable = component.description.variables.get(name) if signal is None else signal.source
        if variable is None:
            return False
        if not variable.is_settable:
            self._reader.warnings.append(
                f"{where}: {component.name}.{name} cannot be set: it is {variable.causality}"
            )
            return True
        try:
            values = value.arrived(self._connections.unit(Node(component.path, name))).values
        except ValueError as error:
            self._reader.faults.append(f"{where}: {error}")
            return True
        names = [name] if signal is not None else list(_element_names(variable))
        if len(names) != len(values):
            self._reader.faults.append(
                f"{where}: {len(values)} values for {component.name}.{name}, which has {len(names)}"
            )
            return True
        self.components.setdefault(component.path, {}).update(zip(names, values, strict=True))
        return True

    def _set_of(self, binding: Binding, label: str) -> Document | None:
        """Return the parameter set of a binding: a file, or written in it."""
        kind = binding.element.get("type", "application/x-ssp-parameter-set")
        if kind != "application/x-ssp-parameter-set":
            self._reader.faults.append(
                f'{label}: parameters of type "{kind}" are not supported; write an SSV file'
            )
            return None
        return self._document(binding, binding.element, f"ParameterValues/{_SET}", _SET, label)

    def _document(
        self, binding: Binding, element: Element, inline: str, root: str, label: str
    ) -> Document | None:
        """Return the document that an element names as its source, or contains."""
        source, of = element.get("source"), binding.document
        if not source:
            written = element.find(inline)
            if written is None:
                self._reader.faults.append(f"{label}: a parameter binding without source and <{root}>")
                return None
            return self._reader.checked(Document(written, f"{label}: <{root}>", of.file, of.package), root)
        folder, package = of.file.parent, of.package
        if element.get("sourceBase") == "component" and binding.resource is not None:
            folder = package = binding.resource
        file: Path | None = self._reader.locate(source, folder, package, label)
        return None if file is None else self._reader.document(file, f"{label}: {source}", root, package)

    def _written(self, document: Document) -> Iterator[tuple[str, Value]]:
        """Yield the parameters of a set."""
        seen = set[str]()
        for parameter in document.root.iterfind("Parameters/Parameter"):
            name = parameter.get("name", "")
            typed = next((x for x in parameter if x.tag not in ("Dimension", "Annotations")), None)
            try:
                if name in seen:
                    self._reader.warnings.append(f"{document.label}: {name} is there twice; the last counts")
                if typed is None:
                    raise ValueError("has no value")
                yield name, _value(typed, document, parameter.find("Dimension") is not None)
            except ValueError as error:
                self._reader.faults.append(f"{document.label}: parameter {name}: {error}")
            seen.add(name)

    def _mapping(self, binding: Binding, label: str) -> list[_Entry] | None:
        """Return the mapping of a binding; None: it has none, and names count as they are."""
        element = binding.element.find(_MAPPING)
        if element is None:
            return None
        document = self._document(binding, element, _MAPPING, _MAPPING, label)
        if document is None:
            return []
        entries = list[_Entry]()
        for written in document.root.iterfind("MappingEntry"):
            source, target = written.get("source", ""), written.get("target", "")
            where = f"{document.label}: {source} to {target}"
            if target in (entry.target for entry in entries):
                self._reader.faults.append(f"{where}: two parameters are mapped to {target}")
            how = self._reader.transformation(written, where)
            entries.append(_Entry(source, target, how, not is_true(written.get("suppressUnitConversion"))))
        return entries


def _value(typed: Element, document: Document, is_array: bool) -> Value:
    """Return a value as written; ValueError: it cannot be read."""
    tag, text = typed.tag, typed.get("value")
    texts = [(value.text or "") for value in typed.iterfind("Value")]
    if text is not None:
        texts = text.split() if is_array and tag not in ("String", "Enumeration") else [text]
    if not texts and not is_array:
        raise ValueError("has no value")
    if tag in _REALS:
        return Value(tuple(map(number, texts)), "real", document.unit(typed.get("unit")))
    if tag == "Boolean":
        return Value(tuple(map(is_true, texts)), "boolean")
    if tag == "String":
        return Value(tuple(texts), "string")
    if tag == "Enumeration":
        items = document.enumerations.get(typed.get("name", ""), {})
        return Value(tuple(texts), "enumeration", items=items)
    if tag in _INTEGERS:
        return Value(tuple(map(int, texts)), "integer")
    raise ValueError(f"values of type {tag} are not supported")


_INTEGERS = ("Integer", *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)))


def _float(value: ParameterValue) -> float:
    return float(value)


def _element_names(variable: DescribedVariable) -> Iterator[str]:
    """Yield the names of an array's elements, in row-major order."""
    from itertools import product

    for indices in product(*(range(1, size + 1) for size in variable.shape)):
        yield element(variable, indices).variable.name
