"""Systems of System Structure and Parameterization, SSP 1.0 and 2.0, as parts and connections.

FMPy reads SSP 1.0 of one level with its own schema check, ignores start values and parameter precedence and
has no nested systems with parameters; so this reads the XML itself, leniently.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ddpc_cosim.coupling.ssp.connections import Connections, Link, Node
from ddpc_cosim.coupling.ssp.documents import Component, Path_, Reader, step_size
from ddpc_cosim.coupling.ssp.parameters import Parameters
from ddpc_cosim.coupling.wiring import Connection
from ddpc_cosim.description import DefaultExperiment
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.plant import FMIType, ParameterValue
from ddpc_cosim.processes.scratch import ScratchFolder
from ddpc_cosim.variables import Variable
from fmu_plants.files import cached, is_file


@dataclass(frozen=True, slots=True)
class SSPPart:
    """A component that is an FMU.

    Parameters
    ----------
    name : str
        The names of systems and component, joined by ``/``; dots in them are underscores here.
    fmu : str
        Path of a copy of the FMU.
    source : str
        Its path in the archive.
    fmi_type : str
        How it is run.
    parameters : mapping of str to float, int, bool or str
        Values of its variables.
    start : mapping of str to float
        Start values of its inputs.
    inputs, outputs : tuple of str
        The numbers that can be driven, and that are outputs or connected to something.
    """

    name: str
    fmu: str
    source: str
    fmi_type: FMIType
    parameters: Mapping[str, ParameterValue]
    start: Mapping[str, float]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SSPConnection:
    """A way from ``part.variable``, or an outer input, to ``part.variable`` or an outer output.

    ``value there = factor * value here + offset``, units included.
    """

    source: str
    target: str
    source_unit: str
    target_unit: str
    factor: float
    offset: float

    @property
    def connection(self) -> Connection:
        """The connection; its factor and offset convert units too."""
        return Connection(self.source, self.target, self.factor, self.offset, convert_units=False)


@dataclass(frozen=True, slots=True)
class SSPSystem:
    """What an archive describes.

    Parameters
    ----------
    name, version : str
        Of the description.
    parts : tuple of SSPPart
        Its FMUs.
    connections : tuple of SSPConnection
        From signal to signal.
    inputs, outputs : tuple of SSPConnector
        Connectors of the outermost system.
    default_experiment : DefaultExperiment
        Its default experiment; the step size is what an annotation suggests.
    warnings : tuple of str
        What is not as it should be but was understood.
    """

    name: str
    version: str
    parts: tuple[SSPPart, ...]
    connections: tuple[SSPConnection, ...]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    default_experiment: DefaultExperiment
    warnings: tuple[str, ...]


def read_ssp(path: Path) -> SSPSystem:
    """Return what an SSP archive describes; nothing of it is run.

    Copies of its FMUs are kept in the cache folder.

    Raises
    ------
    ConfigError
        It cannot be run; all faults at once.
    """
    if not is_file(path):
        raise ConfigError(f"{path}: no such file")
    with ScratchFolder() as scratch:
        return _Reading(path, scratch).system()


class _Reading:
    """The reading of one archive."""

    def __init__(self, path: Path, scratch: Path) -> None:
        self._reader = Reader(scratch)
        root = self._reader.archive(path, path.name)
        if root is None:
            raise ConfigError(self._reader.faults)
        self._root = root
        self._connections = Connections(root, self._reader)
        self._parameters = Parameters(self._connections, self._reader)
        self._names = self._part_names()

    def system(self) -> SSPSystem:
        """Return what has been read."""
        links = list(self._connections.links())
        self._sources = [link.source for link in links]
        faults = self._reader.faults
        if not self._names and not faults:
            faults.append(f"{self._root.document.label}: there is no component to run")
        for link in links:
            if link.table is not None:
                faults.append(f"{link.target}: a mapping of values on a connection is not supported")
        if faults:
            raise ConfigError(list(dict.fromkeys(faults)))
        document = self._root.document
        experiment = document.root.find("DefaultExperiment")
        times = {} if experiment is None else experiment.attrib
        return SSPSystem(
            name=document.root.get("name", ""),
            version=document.root.get("version", ""),
            parts=tuple(self._part(component) for component in self._root.components()),
            connections=tuple(map(self._connection, links)),
            inputs=tuple(self._inputs(links)),
            outputs=tuple(self._outputs(links)),
            default_experiment=DefaultExperiment(
                _time(times.get("startTime")), _time(times.get("stopTime")), None, step_size(document)
            ),
            warnings=tuple(dict.fromkeys(self._reader.warnings)),
        )

    def _part_names(self) -> dict[Path_, str]:
        """Return a name without dots for each component: it precedes the first dot of a signal."""
        names = dict[Path_, str]()
        for component in self._root.components():
            name = wanted = component.name.replace(".", "_")
            while name in names.values():
                name += "_"
            if name != component.name:
                self._reader.warnings.append(f'"{component.name}" is called "{name}"; parts have no dots')
            names[component.path] = name if name else wanted
        return names

    def _part(self, component: Component) -> SSPPart:
        content = component.fmu.read_bytes()
        place = f"ssp/{hashlib.sha256(content).hexdigest()[:16]}/{component.fmu.name}"
        package = component.document.package.resolve()
        given = self._parameters.components.get(component.path, {})
        description = component.description
        declared = [signal.variable.name for signal in description.signals("output")]
        connected = [node.name for node in self._sources if node.element == component.path]
        inputs = {signal.variable.name for signal in description.signals("input")}
        start = {name: _start(component, name, value) for name, value in given.items() if name in inputs}
        return SSPPart(
            self._names[component.path],
            str(cached(place, lambda: content)),
            component.fmu.relative_to(package).as_posix(),
            component.fmi_type,
            {name: value for name, value in given.items() if name not in start},
            start,
            tuple(signal.variable.name for signal in description.signals("input")),
            tuple(dict.fromkeys((*declared, *connected))),
        )

    def _signal(self, node: Node) -> str:
        return f"{self._names[node.element]}.{node.name}" if node.element else node.name.replace(".", "_")

    def _connection(self, link: Link) -> SSPConnection:
        source, target = self._signal(link.source), self._signal(link.target)
        return SSPConnection(source, target, link.source_unit, link.target_unit, link.factor, link.offset)

    def _inputs(self, links: Sequence[Link]) -> Iterator[Variable]:
        """Yield the outer inputs; what is not written is taken from the first variable that they lead to."""
        for node, link in {link.source: link for link in reversed(links)}.items():
            if not node.element:
                given = self._parameters.connectors.get(node.name)
                there = _linear(self._variable(link.target), 1.0 / link.factor, -link.offset / link.factor)
                start = there.start if given is None else float(given)
                yield replace(there, name=self._signal(node), unit=link.source_unit, start=start)

    def _outputs(self, links: Sequence[Link]) -> Iterator[Variable]:
        """Yield the outer outputs."""
        for link in links:
            if not link.target.element:
                here = _linear(self._variable(link.source), link.factor, link.offset)
                yield replace(here, name=self._signal(link.target), unit=link.target_unit)

    def _variable(self, node: Node) -> Variable:
        """Return the variable of an FMU; an empty one for an outer connector."""
        component = self._connections.components.get(node.element)
        signal = component.description.signal(node.name) if component else None
        if signal is None:
            return Variable(node.name)
        given = self._parameters.components.get(node.element, {}).get(node.name)
        return signal.variable if given is None else replace(signal.variable, start=float(given))


def _start(component: Component, name: str, value: ParameterValue) -> float:
    """Return the start value of an input as a number; of an enumeration by its item."""
    items = component.description.variables[name].items if name in component.description.variables else {}
    return float(items[value] if isinstance(value, str) and value in items else value)


def _linear(variable: Variable, factor: float, offset: float) -> Variable:
    """Return a variable as it is after a linear transformation."""
    ends = (factor * end + offset for end in (variable.min, variable.max))
    low, high = sorted(ends)
    nominal = abs(factor) * variable.nominal or variable.nominal
    start = factor * variable.start + offset
    return replace(variable, min=low, max=high, nominal=nominal, start=start, display_unit=None)


def _time(text: str | None) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError:
        return None
