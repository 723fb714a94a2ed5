"""Which number goes where in a coupled plant: names, units and sizes, checked once; indices and factors."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.settings import setting
from ddpc_cosim.variables import FloatArray, Variable, names, not_names, unit_shown
from fmu_plants.spelling import did_you_mean

_ELEMENT = re.compile(r"(?P<array>.+)(?P<place>\[\d+(?:,\d+)*\])")


@dataclass(frozen=True, slots=True)
class Connection:
    """A signal that follows another one: target = factor * source + offset.

    The source is converted to the unit of the target first, where both have one. An array is connected as a
    whole by its name, or element by element (``x[2]``).

    Parameters
    ----------
    source : str
        An output, ``"part.variable"``, or an input connector of the system, by its name.
    target : str
        An input, ``"part.variable"``, or an output connector of the system, by its name.
    factor, offset : float
        Applied after the conversion of the unit.
    convert_units : bool
        Whether units are converted and checked at all.
    """

    source: str = setting(doc="an output, PART.variable, or an input of the system as a whole", key="from")
    target: str = setting(doc="an input, PART.variable, or an output of the system as a whole", key="to")
    factor: float = setting(1.0, doc="applied after the conversion of the unit")
    offset: float = setting(0.0, doc="added then, in the unit there")
    convert_units: bool = setting(True, doc="convert units, and require that they fit")

    def __str__(self) -> str:
        return f'connection from "{self.source}" to "{self.target}"'


class PartInterface(Protocol):
    """What is known of a part without running it; a plant has it too."""

    @property
    def inputs(self) -> tuple[Variable, ...]:
        """The inputs."""

    @property
    def outputs(self) -> tuple[Variable, ...]:
        """The outputs."""

    @property
    def dependencies(self) -> Mapping[str, frozenset[str]]:
        """For each output the inputs that it depends on without delay."""

    @property
    def is_sampled(self) -> bool:
        """Whether it answers to its inputs as they are when a step begins."""


class AffineMap(NamedTuple):
    """How a vector of numbers follows from all values: factor * values[sources] + offset."""

    sources: NDArray[np.intp]
    factor: FloatArray
    offset: FloatArray

    @property
    def is_scaled(self) -> bool:
        """Whether values are scaled or shifted, not only selected."""
        return bool((self.factor != 1.0).any() or self.offset.any())


class _Link(NamedTuple):
    """One number that follows another: both by full name."""

    source: str
    factor: float = 1.0
    offset: float = 0.0


class Wiring:
    """The signals of coupled parts, and how they follow from each other.

    All values lie in one vector: driven inputs of the system, inputs that rest, outputs of the parts.

    Parameters
    ----------
    parts : mapping of str to PartInterface
        The parts by name.
    connections : sequence of Connection
        What they exchange.
    inputs, outputs : sequence of str, optional
        Signals of the system, ``"part.variable"`` or names of connectors; default: its connectors, then all
        inputs that no connection feeds, and all outputs.
    connectors : sequence of Variable
        What is known of the system's own connectors; one that is not named here is as the other end of its
        connection.

    Attributes
    ----------
    inputs, outputs : tuple of Variable
        Signals of the system, by full name.
    values : tuple of str
        Full names of all values.
    input_maps : dict of str to AffineMap
        By part: how its inputs follow from the values.
    output_map : AffineMap
        How the outputs of the system follow from the values.
    slices : dict of str to slice
        By part: where its outputs are among the values.
    start : array
        All values at rest; zero for outputs.
    scale : array
        Nominal magnitudes of all values.

    Raises
    ------
    ConfigError
        All faults at once, with both ends of a connection.
    """

    def __init__(
        self,
        parts: Mapping[str, PartInterface],
        connections: Sequence[Connection],
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
        connectors: Sequence[Variable] = (),
    ) -> None:
        self._faults: list[str] = []
        for name in parts:
            if not name or "." in name:
                self._faults.append(f'part "{name}": a name must be a text without dots')
        for name, part in parts.items():
            for what, variables, declared in (
                ("input", part.inputs, set().union(*part.dependencies.values())),
                ("output", part.outputs, part.dependencies),
            ):
                known = names(variables)
                for other in sorted(set(declared).difference(known)):
                    fault = f'dependencies: no {what} "{other}"; {did_you_mean(other, known)}'
                    self._faults.append(f'part "{name}": {fault}')
        self._parts = parts
        self._connectors = {variable.name: variable for variable in connectors}
        self._in = {f"{part}.{v.name}": v for part, signals in parts.items() for v in signals.inputs}
        self._out = {f"{part}.{v.name}": v for part, signals in parts.items() for v in signals.outputs}
        self._arrays = {
            "input": _by_array(self._in),
            "output": _by_array(self._out),
            "connector": _by_array(self._connectors),
        }
        self._links: dict[str, _Link] = {}
        self._system_inputs: dict[str, Variable] = {}
        self._system_outputs: dict[str, Variable] = {}
        for connection in connections:
            self._connect(connection)
        if self._faults:
            raise ConfigError(self._faults)
        self._number(inputs, outputs)
        if self._faults:
            raise ConfigError(self._faults)

    def _connect(self, connection: Connection) -> None:
        """Take in the links that a connection consists of."""
        sources = self._ends(connection, connection.source, "output")
        targets = self._ends(connection, connection.target, "input")
        if sources is None and targets is None:  # two connectors that nothing is known of
            sources, targets = {"": Variable(connection.source)}, {"": Variable(connection.target)}
        elif {} in (sources, targets):
            return
        sources = self._as_other_end(connection.source, targets) if sources is None else sources
        targets = self._as_other_end(connection.target, sources) if targets is None else targets
        if sources.keys() != targets.keys():
            sizes = f"{_size(sources)} and {_size(targets)}"
            self._faults.append(f"{connection}: the ends have different sizes: {sizes}")
            return
        if not (np.isfinite(connection.factor) and np.isfinite(connection.offset)):
            self._faults.append(f"{connection}: factor and offset must be finite numbers")
            return
        for place, source in sources.items():
            self._link(
                connection, connection.source + place, source, connection.target + place, targets[place]
            )

    def _ends(self, connection: Connection, end: str, what: str) -> Mapping[str, Variable] | None:
        """Return the numbers at an end by place; {}: a fault; None: a connector that is not declared."""
        numbers = self._arrays[what].get(end) or self._arrays["connector"].get(end)
        if numbers:
            return numbers
        part, dot, name = end.partition(".")
        if not dot:
            return None
        if part not in self._parts:
            self._faults.append(f'{connection}: no part "{part}"; {did_you_mean(part, self._parts)}')
            return {}
        other = "input" if what == "output" else "output"
        signals = self._parts[part].outputs if what == "output" else self._parts[part].inputs
        options = did_you_mean(name, names(signals))
        if end in self._arrays[other]:
            self._faults.append(f'{connection}: "{end}" is an {other}, not an {what}; {options}')
        else:
            self._faults.append(f'{connection}: {part} has no {what} "{name}"; {options}')
        return {}

    @staticmethod
    def _as_other_end(end: str, other: Mapping[str, Variable] | None) -> dict[str, Variable]:
        """Return a connector that is not declared, with the properties of the other end."""
        return {place: replace(v, name=end + place) for place, v in (other or {}).items()}

    def _link(self, connection: Connection, source: str, known: Variable, target: str, fed: Variable) -> None:
        if target in self._links:
            other = self._links[target].source
            self._faults.append(f'{connection}: "{target}" already follows "{other}"')
            return
        gain, bias = 1.0, 0.0
        if connection.convert_units and known.unit and fed.unit:
            try:
                shown = unit_shown(fed, known.unit)
            except ConfigError as error:
                ends = f'"{source}" is in {known.unit}, "{target}" in {fed.unit}'
                self._faults.append(
                    f"{connection}: {ends}, units of different quantities or not known: {error}"
                )
                return
            gain, bias = 1.0 / shown.factor, -shown.offset / shown.factor
        factor, offset = connection.factor * gain, connection.factor * bias + connection.offset
        self._links[target] = _Link(source, factor, offset)
        if source not in self._out:
            self._system_inputs.setdefault(source, known)
        if target not in self._in:
            self._system_outputs[target] = fed
        for name in (source, target):
            if name in self._system_inputs and name in self._system_outputs:
                self._faults.append(f'{connection}: the connector "{name}" is an input and an output at once')

    def _number(self, inputs: Sequence[str] | None, outputs: Sequence[str] | None) -> None:
        """Lay out the vector of all values, and how everything follows from it."""
        free = {name: replace(v, name=name) for name, v in self._in.items() if name not in self._links}
        for name in free.keys() & self._out.keys():
            self._faults.append(f'"{name}" is an input that no connection feeds, and an output: rename one')
        available = {**self._system_inputs, **free}
        readable = {**self._system_outputs, **{n: replace(v, name=n) for n, v in self._out.items()}}
        driven = self._chosen(inputs, available, "input")
        read = self._chosen(outputs, readable, "output")
        resting = [name for name in available if name not in driven]
        self.inputs = tuple(available[name] for name in driven)
        self.outputs = tuple(readable[name] for name in read)
        self.values = (*driven, *resting, *self._out)
        self.resting = {name: len(driven) + i for i, name in enumerate(resting)}
        variables = [*(available[name] for name in (*driven, *resting)), *self._out.values()]
        self._place = {name: i for i, name in enumerate(self.values)}
        self.scale = np.array([_magnitude(variable) for variable in variables])
        self.start = np.array(
            [0.0 if name in self._out else v.start for name, v in zip(self.values, variables, strict=True)]
        )
        self.input_maps = {
            part: self._map([self._links.get(name, _Link(name)) for name in _full(part, signals.inputs)])
            for part, signals in self._parts.items()
        }
        system = self._system_outputs
        self.output_map = self._map([self._links[name] if name in system else _Link(name) for name in read])
        self.slices, begin = {}, len(driven) + len(resting)
        for part, signals in self._parts.items():
            self.slices[part] = slice(begin, begin + len(signals.outputs))
            begin += len(signals.outputs)

    def _chosen(
        self, wanted: Sequence[str] | None, known: Mapping[str, Variable], what: str
    ) -> tuple[str, ...]:
        """Return the names of the system's inputs or outputs."""
        if wanted is None:
            return tuple(known)
        if fault := not_names(f"{what}s", wanted):
            self._faults.append(fault)
            return ()
        chosen: dict[str, None] = {}
        arrays = _by_array(known)
        for name in wanted:
            elements = arrays.get(name, {})
            if not elements:
                fed = self._links.get(name)
                why = f"is no {what} of the system"
                if fed and what == "input":
                    why = f'follows "{fed.source}"'
                self._faults.append(f'{what} "{name}" {why}; {did_you_mean(name, known)}')
            for place in elements:
                if name + place in chosen:
                    self._faults.append(f'{what} "{name + place}" is named twice')
                chosen[name + place] = None
        return tuple(chosen)

    def _map(self, links: Sequence[_Link]) -> AffineMap:
        return AffineMap(
            np.array([self._place[link.source] for link in links], dtype=np.intp),
            np.array([link.factor for link in links], dtype=np.float64),
            np.array([link.offset for link in links], dtype=np.float64),
        )


def _full(part: str, variables: Iterable[Variable]) -> list[str]:
    return [f"{part}.{variable.name}" for variable in variables]


def _by_array(known: Mapping[str, Variable]) -> dict[str, dict[str, Variable]]:
    """Return what each name stands for, by place in the array: one number, or all elements of an array."""
    arrays: dict[str, dict[str, Variable]] = {}
    for name, variable in known.items():
        arrays[name] = {"": variable}
        if match := _ELEMENT.fullmatch(name):
            arrays.setdefault(match["array"], {})[match["place"]] = variable
    return arrays


def _size(numbers: Mapping[str, Variable]) -> str:
    if "" in numbers:
        return "a number"
    return f"an array up to {list(numbers)[-1]}"


def _magnitude(variable: Variable) -> float:
    """Return a nominal value that one can divide by."""
    nominal = abs(variable.nominal)
    return nominal if 0.0 < nominal < np.inf else 1.0
