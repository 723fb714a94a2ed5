"""What an SSP archive is: its parts, their connections, their order and loops, and what is wrong with it."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ddpc_cosim.coupling.graph import Graph
from ddpc_cosim.coupling.specification import PartSignals, switches_of_parts
from ddpc_cosim.coupling.ssp import SSPSystem, read_ssp
from ddpc_cosim.coupling.wiring import Wiring
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.fmu.companions import say_nothing
from ddpc_cosim.fmu.description import FMUDescription, direct_dependencies, is_sampled
from ddpc_cosim.fmu.description.defects import Defect, Findings, Kind, Severity
from ddpc_cosim.inspection import (
    FORMAT,
    Inspection,
    defects_as_data,
    inputs_as_data,
    inspect_fmu,
    variables_as_data,
)
from ddpc_cosim.inspection.checks import NO_INPUTS, NO_OUTPUTS
from ddpc_cosim.variables import Variable

INVALID_SYSTEM = Kind("invalid-system", Severity.ERROR, "the system cannot run")
UNDERSTOOD = Kind("understood", Severity.WARNING, "something is not as it should be but was understood")


@dataclass(frozen=True)
class SystemInspection:
    """What is known of an SSP archive before it runs.

    Parameters
    ----------
    path : Path
        The file.
    size : int
        Its bytes.
    sha256 : str
        Their hash.
    system : SSPSystem or None
        What it describes; None if it cannot be read.
    parts : mapping of str to Inspection
        Its FMUs, by part.
    inputs, outputs : tuple of Variable
        Signals of the whole: its own connectors, else the inputs that nothing feeds, and all outputs.
    switches : mapping of str to str
        For inputs of the whole that override a control of a part, the input that switches the override on.
    order : tuple of str
        The parts in the order in which they are stepped.
    loops : tuple of tuple of str
        The algebraic loops, as ``part.variable``.
    defects : tuple of Defect
        What is wrong, the worst first; of parts with their names.
    """

    path: Path
    size: int
    sha256: str
    system: SSPSystem | None
    parts: Mapping[str, Inspection]
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    switches: Mapping[str, str]
    order: tuple[str, ...]
    loops: tuple[tuple[str, ...], ...]
    defects: tuple[Defect, ...]

    @property
    def can_run(self) -> bool:
        """Whether it can run here, as far as is known."""
        return all(defect.severity is not Severity.ERROR for defect in self.defects)


def inspect_ssp(
    path: Path, library_path: Sequence[str | Path] = (), tell: Callable[[str], object] = say_nothing
) -> SystemInspection:
    """Look at an SSP archive; nothing of it is run. Everything that is wrong with it is a defect.

    ``library_path`` has further libraries of its FMUs, as of :class:`ddpc_cosim.FMUPlant`; ``tell`` is called
    with a line before anything is compiled.
    """
    content = path.read_bytes()
    findings, system = Findings(), None
    parts: dict[str, Inspection] = {}
    inputs: tuple[Variable, ...] = ()
    outputs, order, loops = inputs, tuple[str, ...](), tuple[tuple[str, ...], ...]()
    switches: Mapping[str, str] = {}
    try:
        system = read_ssp(path)
        for warning in system.warnings:
            findings.add(UNDERSTOOD, warning)
        parts = _inspected(system, findings, library_path, tell)
        signals, wiring, graph = _structure(system, parts)
        inputs, outputs, order, loops = wiring.inputs, wiring.outputs, graph.order, graph.loops
        own_inputs, own_outputs = (
            tuple(v for v in group if "." not in v.name) for group in (inputs, outputs)
        )
        inputs, outputs = own_inputs or inputs, own_outputs or outputs
        switches = switches_of_parts({name: part.switches for name, part in parts.items()}, signals, wiring)
        if not inputs:
            findings.add(NO_INPUTS)
        if not outputs:
            findings.add(NO_OUTPUTS)
    except ConfigError as error:
        for fault in error.faults:
            findings.add(INVALID_SYSTEM, fault)
    digest = hashlib.sha256(content).hexdigest()
    return SystemInspection(
        path, len(content), digest, system, parts, inputs, outputs, switches, order, loops, findings.defects()
    )


def _inspected(
    system: SSPSystem,
    findings: Findings,
    library_path: Sequence[str | Path],
    tell: Callable[[str], object],
) -> dict[str, Inspection]:
    """Return the description of each part; its faults are noted with its name."""
    known: dict[str, Inspection] = {}
    by_file: dict[str, Inspection] = {}
    for part in system.parts:
        if part.fmu not in by_file:
            by_file[part.fmu] = inspect_fmu(part.fmu, library_path=library_path, tell=tell)
        known[part.name] = by_file[part.fmu]
        for defect in known[part.name].defects:
            if defect.kind in (NO_INPUTS, NO_OUTPUTS):  # which matters of the whole alone
                continue
            for place in defect.places or ("",):
                findings.add(defect.kind, f"{part.name}: {place}" if place else part.name)
    return known


def _structure(
    system: SSPSystem, parts: Mapping[str, Inspection]
) -> tuple[dict[str, PartSignals], Wiring, Graph]:
    used = {end for connection in system.connections for end in (connection.source, connection.target)}
    signals = {name: _signals(name, p.description, used) for name, p in parts.items() if p.description}
    connections = [connection.connection for connection in system.connections]
    wiring = Wiring(signals, connections, connectors=(*system.inputs, *system.outputs))
    return signals, wiring, Graph(signals, wiring)


def _signals(part: str, description: FMUDescription, used: set[str]) -> PartSignals:
    """Return inputs and outputs of a part, and the other variables that something is connected to."""
    inputs = tuple(description.signals("input"))
    readable = description.signals("output", "local", "parameter", "calculatedParameter")
    outputs = tuple(
        s for s in readable if s.source.causality == "output" or f"{part}.{s.variable.name}" in used
    )
    return PartSignals(
        tuple(signal.variable for signal in inputs),
        tuple(signal.variable for signal in outputs),
        direct_dependencies(description, inputs, outputs),
        is_sampled(inputs),
    )


def as_data(inspection: SystemInspection) -> dict[str, Any]:
    """Return an inspection in plain values; ``format`` rises when a key changes its meaning."""
    system = inspection.system
    return {
        "format": FORMAT,
        "file": inspection.path.name,
        "size": inspection.size,
        "sha256": inspection.sha256,
        "can_run": inspection.can_run,
        "system": system.name if system else None,
        "ssp_version": system.version if system else None,
        "default_experiment": {
            key: getattr(system.default_experiment, key) if system else None
            for key in ("start_time", "stop_time", "step_size")
        },
        "parts": [
            {
                "name": part.name,
                "file": part.source,
                "sha256": inspection.parts[part.name].sha256,
                "can_run": inspection.parts[part.name].can_run,
                "fmi_type": part.fmi_type,
                "parameters": {**part.start, **part.parameters},
            }
            for part in (system.parts if system else ())
            if part.name in inspection.parts
        ],
        "connections": [
            {
                "from": connection.source,
                "to": connection.target,
                "from_unit": connection.source_unit,
                "to_unit": connection.target_unit,
                "factor": connection.factor,
                "offset": connection.offset,
            }
            for connection in (system.connections if system else ())
        ],
        "inputs": inputs_as_data(inspection.inputs, inspection.switches),
        "outputs": variables_as_data(inspection.outputs),
        "order": list(inspection.order),
        "algebraic_loops": [list(loop) for loop in inspection.loops],
        "defects": defects_as_data(inspection.defects),
    }
