"""The connections of an SSP: from every input of a component back to what it comes from.

The two ends of a connection tell no direction: the kinds of their connectors do (SSP 2.0, section 5.4.2). A
connector of a nested system is one node, which connections outside and inside meet at. On each connection
the unit is converted first, then the value transformed.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple
from xml.etree.ElementTree import Element

from ddpc_cosim.coupling.ssp.documents import Component, Path_, Reader, System, Transformation, Unit
from ddpc_cosim.description import DescribedVariable
from ddpc_cosim.fmu.description.variables import is_true
from ddpc_cosim.plant import ParameterValue
from fmu_plants.spelling import did_you_mean

_SINKS = ("input", "parameter", "structuralParameter")
_SOURCES = ("output", "calculatedParameter", "local", "constant", "independent")
_ANY = ("inout", "unspecified", "")
_FIXED = ("parameter", "structuralParameter")


class Node(NamedTuple):
    """A scalar connector: of which element, and its name, with indices where it is of an array."""

    element: Path_
    name: str

    def __str__(self) -> str:
        return f"{'/'.join(self.element)}.{self.name}" if self.element else self.name


class Edge(NamedTuple):
    """A connection of two scalars in the direction of the values."""

    source: Node
    target: Node
    how: Transformation
    converts: bool
    where: str


@dataclass(frozen=True, slots=True)
class End:
    """One end of a connection as written: its scalars, and whether values come from it (None: either)."""

    nodes: tuple[Node, ...]
    shape: tuple[int, ...] | None
    is_source: bool | None
    kind: str


@dataclass(frozen=True, slots=True)
class Link:
    """A way from where a value is calculated to where it is used, all connections on it in one.

    ``target value = factor * source value + offset``, or what ``table`` has for the source value.
    """

    source: Node
    target: Node
    source_unit: str = ""
    target_unit: str = ""
    factor: float = 1.0
    offset: float = 0.0
    table: "dict[ParameterValue, ParameterValue] | None" = None


class Connections:
    """All connections of a system and of those within it.

    Parameters
    ----------
    system : System
        The outermost one.
    reader : Reader
        What was found before; what is found here is added to its faults and warnings.
    """

    def __init__(self, system: System, reader: Reader) -> None:
        self.system, self._reader = system, reader
        self.components = {component.path: component for component in system.components()}
        self._systems = {within.path: within for within in system.systems()}
        self.into: dict[Node, Edge] = {}
        self.out_of: dict[Node, list[Edge]] = {}
        for component in self.components.values():
            self._check_units(component)
        for within in self._systems.values():
            for xml in within.connections:
                for edge in self._edges(xml, within):
                    self._add(edge)

    def unit(self, node: Node) -> Unit:
        """Return the unit of a connector: as written, else the FMU's; nameless for none."""
        connector = node.name.partition("[")[0] if node.name not in self._names(node.element) else node.name
        element = self.components.get(node.element) or self._systems[node.element]
        written = element.connectors.get(connector)
        usual = Unit()
        if isinstance(element, Component) and (variable := self._variable(element, node.name)) is not None:
            usual = element.document.unit(variable.variable.unit)
        return written.unit if written is not None and written.unit.name else usual

    def _check_units(self, component: Component) -> None:
        """Note connectors that are in other units than their variables in the FMU: either may be wrong."""
        for name, connector in component.connectors.items():
            variable = self._variable(component, name)
            unit = component.document.unit(variable.variable.unit if variable else "")
            if unit.si is None or connector.unit.si is None:
                continue
            try:
                fits = connector.unit.conversion_to(unit) == (1.0, 0.0)
            except ValueError:
                fits = False
            if not fits:
                where = f"{component.document.label}: connector {component.name}.{name}"
                units = f'is in "{connector.unit.name}", and its variable in the FMU in "{unit.name}"'
                self._reader.faults.append(f"{where} {units}; make them the same")

    def links(self) -> Iterator[Link]:
        """Yield the source of every connected input of a component, and of every outer output."""
        for node in self.into:
            component = self.components.get(node.element)
            variable = None if component is None else self._variable(component, node.name)
            if (node.element and variable is None) or (variable and variable.causality in _FIXED):
                continue  # a connector of a nested system, or a parameter, which is set at the start
            edges = list(self._way_to(node))
            if edges[0].source.element in self.components or not edges[0].source.element:
                yield self._link(edges)

    def _way_to(self, node: Node) -> Iterator[Edge]:
        edges: list[Edge] = []
        while node in self.into and (not edges or node.element not in self.components):
            edge = self.into[node]
            if edge in edges:
                self._reader.faults.append(f"{edge.where}: the connections of systems go round in a circle")
                break
            edges.insert(0, edge)
            node = edge.source
        return iter(edges)

    def _link(self, edges: list[Edge]) -> Link:
        first, last = edges[0].source, edges[-1].target
        unit = begins = self.unit(first) if self.unit(first).name else Unit()
        link = Link(first, last)
        for edge in edges:
            there = self.unit(edge.target)
            factor, offset = 1.0, 0.0
            if edge.converts:
                try:
                    factor, offset = unit.conversion_to(there)
                except ValueError as error:
                    self._reader.faults.append(f"{edge.where}: {error}")
            if not begins.name and not link.source_unit and not first.element:
                begins = there  # an outer connector that says none has that of what it leads to
            unit = there if there.name else unit if edge.converts else Unit()
            link = replace(
                link,
                factor=edge.how.factor * factor * link.factor,
                offset=edge.how.factor * (factor * link.offset + offset) + edge.how.offset,
            )
            if edge.how.table:
                if link.table is not None or (link.factor, link.offset) != (1.0, 0.0):
                    self._reader.faults.append(f"{edge.where}: a second transformation after a mapping")
                link = replace(link, table=dict(edge.how.table))
        return replace(link, source_unit=begins.name, target_unit=unit.name)

    def _add(self, edge: Edge) -> None:
        other = self.into.get(edge.target)
        if other is not None:
            self._reader.faults.append(
                f"{edge.where}: {edge.target} is connected to {other.source} already; "
                "an input has one source: remove one of the connections"
            )
            return
        self.into[edge.target] = edge
        self.out_of.setdefault(edge.source, []).append(edge)

    def _edges(self, xml: Element, system: System) -> Iterator[Edge]:
        """Yield the scalars that a connection joins; what is wrong with it is noted."""
        words = [f"{xml.get(f'{end}Element') or ''}.{xml.get(f'{end}Connector')}" for end in ("start", "end")]
        where = (
            f"{system.document.label}: {system.name}: connection {' - '.join(w.lstrip('.') for w in words)}"
        )
        ends = [self._end(xml, end, system, where) for end in ("start", "end")]
        start, end = ends
        if start is None or end is None:
            return
        flows = _direction(start, end)
        if flows is None:
            kinds = f"{start.kind or 'unspecified'} and {end.kind or 'unspecified'}"
            self._reader.faults.append(
                f"{where}: no value flows between these ({kinds}); an output leads to an input"
            )
            return
        source, target = (start, end) if flows else (end, start)
        if target.kind in _FIXED and source.nodes[0].element != system.path:
            self._reader.faults.append(
                f"{where}: a parameter that another element calculates is not supported; "
                "give its value in a parameter binding"
            )
            return
        if len(source.nodes) != len(target.nodes) or source.shape != target.shape:
            sizes = " and ".join(str(list(side.shape)) if side.shape else "a number" for side in (start, end))
            self._reader.faults.append(f"{where}: sizes differ: {sizes}")
            return
        how = self._reader.transformation(xml, where)
        converts = not is_true(xml.get("suppressUnitConversion"))
        for source_node, target_node in zip(source.nodes, target.nodes, strict=True):
            yield Edge(source_node, target_node, how, converts, where)

    def _end(self, xml: Element, which: str, system: System, where: str) -> End | None:
        element_name, name = xml.get(f"{which}Element"), xml.get(f"{which}Connector", "")
        indices = tuple((xml.get(f"{which}Indices") or "").replace(",", " ").split())
        element: System | Component | None = system
        if element_name:
            element = system.elements.get(element_name)
        if element is None and element_name in system.missing:  # which has been told
            return None
        if element is None:
            options = did_you_mean(element_name or "", system.elements)
            self._reader.faults.append(f'{where}: no element "{element_name}"; {options}')
            return None
        connector = element.connectors.get(name)
        kind = connector.kind if connector is not None else ""
        shape = connector.shape if connector is not None else ()
        if isinstance(element, Component):
            variable = self._variable(element, name)
            if variable is None:
                known = [*element.connectors, *element.description.variables]
                label = element.fmu.name
                self._reader.faults.append(
                    f'{where}: {element.name} ({label}) has no variable "{name}"; {did_you_mean(name, known)}'
                )
                return None
            if connector is None:
                self._reader.warnings.append(f"{where}: no connector {element.name}.{name}; the FMU has it")
            causality = variable.causality
            if kind not in (*_ANY, causality) and (kind in _SINKS) != (causality in _SINKS):
                self._reader.faults.append(
                    f"{where}: {element.name}.{name} is an {kind} here, and in the FMU {causality}"
                )
                return None
            kind, shape = causality, () if element.description.variables.get(name) is None else variable.shape
        elif connector is None:
            options = did_you_mean(name, element.connectors)
            self._reader.faults.append(f'{where}: {element.name} has no connector "{name}"; {options}')
            return None
        is_inside = element is not system
        is_source = None if kind in _ANY else (kind in _SOURCES) == is_inside
        nodes = tuple(Node(element.path, name + part) for part in _elements(shape or ()))
        if indices:
            chosen = Node(element.path, f"{name}[{','.join(indices)}]")
            if chosen not in nodes:
                sizes = str(list(shape or ()))
                self._reader.faults.append(f"{where}: {chosen} is not an element of an array of size {sizes}")
                return None
            nodes, shape = (chosen,), ()
        return End(nodes, shape, is_source, kind)

    def _names(self, path: Path_) -> dict[str, object]:
        element = self.components.get(path) or self._systems[path]
        return {**element.connectors}

    @staticmethod
    def _variable(component: Component, name: str) -> DescribedVariable | None:
        """Return the variable of an FMU that a connector stands for."""
        signal = component.description.signal(name)
        return signal.source if signal is not None else component.description.variables.get(name)


def _direction(start: End, end: End) -> bool | None:
    """Return whether values flow from start to end; None: they do not flow at all."""
    if start.is_source is None and end.is_source is None:
        return True
    flows = start.is_source if start.is_source is not None else not end.is_source
    return flows if end.is_source in (None, not flows) else None


def _elements(shape: tuple[int, ...]) -> Iterator[str]:
    """Yield the suffixes of the names of an array's elements; none for a scalar."""
    if not shape:
        yield ""
        return
    for indices in product(*(range(1, size + 1) for size in shape)):
        yield f"[{','.join(map(str, indices))}]"
