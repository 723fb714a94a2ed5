"""Reading modelDescription.xml of FMI 1.0, 2.0 and 3.0: once, and tolerantly.

What contradicts the standard but can be understood is read as it must be meant. Whatever is ignored, replaced
or assumed on the way is noted as a defect; FMPy's validator is an extra check of ``inspect --strict``.
"""

import gc
import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

from ddpc_cosim.description import DefaultExperiment, number
from ddpc_cosim.errors import FMUImportError
from ddpc_cosim.fmu.archive import MODEL_DESCRIPTION, RefusedError, XMLTree, read_xml
from ddpc_cosim.fmu.description import INTERFACES, Clock, FMUDescription, Interface, InterfaceKind, defects
from ddpc_cosim.fmu.description.defects import Findings, Severity
from ddpc_cosim.fmu.description.variables import (
    VariableReader,
    WrittenVariables,
    integer,
    is_number,
    is_true,
    noted_number,
)
from ddpc_cosim.variables import DisplayUnit

_MOST_ENTRIES = 2_500_000  # each takes up to half a kilobyte


def read_description(folder: Path, label: str) -> FMUDescription:
    """Read the model description of an unpacked FMU that is to run.

    Parameters
    ----------
    folder : Path
        The unpacked FMU.
    label : str
        The FMU's file name, for errors.

    Raises
    ------
    FMUImportError
        It cannot run; all errors of the description at once.
    """
    findings = Findings()
    description = read_tolerantly(folder, label, findings)
    errors = [str(defect) for defect in findings if defect.severity is Severity.ERROR]
    if description is None or errors:
        raise FMUImportError(f"{label}: {MODEL_DESCRIPTION}: {'; '.join(errors)}")
    warnings = [str(defect) for defect in findings if defect.severity is Severity.WARNING]
    return replace(description, warnings=tuple(f"{MODEL_DESCRIPTION}: {warning}" for warning in warnings))


@contextmanager
def _collecting_later() -> Iterator[None]:
    """Pause the garbage collector while a description grows: none of it can be freed."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


@_collecting_later()
def read_tolerantly(folder: Path, label: str, findings: Findings) -> FMUDescription | None:
    """Read the model description of an unpacked FMU as far as it can be understood.

    Parameters
    ----------
    folder : Path
        The unpacked FMU.
    label : str
        The FMU's file name, for errors.
    findings : Findings
        Where the defects that are met are noted; with one that is an error, the FMU cannot run.

    Returns
    -------
    FMUDescription or None
        None for an unknown FMI version.

    Raises
    ------
    FMUImportError
        There is no model description, it is not XML, or it may do harm.
    """
    if not (folder / MODEL_DESCRIPTION).is_file():
        raise FMUImportError(f"{label}: not an FMU: the archive has no {MODEL_DESCRIPTION}")
    document = read_xml(folder / MODEL_DESCRIPTION, f"{label}: {MODEL_DESCRIPTION}", _Document)
    for what in document.overlooked:
        findings.add(defects.REPAIRED, what)
    if document.has_namespaces:  # FMI knows none, some tools do
        findings.add(defects.REPAIRED, "XML namespaces were left out")
    root = document.root
    if "fmiVersion" not in root.attrib:
        raise FMUImportError(
            f"{label}: {MODEL_DESCRIPTION} cannot be read: <{root.tag[:100]}> has no fmiVersion"
        )
    version = _version(root.attrib["fmiVersion"], findings)
    return _Reading(document, version, findings).description() if version else None


def _version(text: str, findings: Findings) -> str:
    """Return the FMI version; empty if it is unknown."""
    if text.startswith("3."):
        return text
    version = {"1": "1.0", "2": "2.0", "3": "3.0"}.get(text.strip()[:1], "")
    if not version:
        findings.add(defects.UNKNOWN_VERSION, f'fmiVersion = "{text}"')
    elif version != text:
        findings.add(defects.REPAIRED, f'fmiVersion "{text}" was read as {version}')
    return version


class _Unknown(NamedTuple):
    """An entry of the model structure as written."""

    list: str
    variable: str
    dependencies: str | None


class _Document(XMLTree):
    """A description as written, its long lists in a form that takes little memory."""

    def __init__(self) -> None:
        super().__init__()
        self.variables = WrittenVariables()
        self.unknowns: list[_Unknown] = []
        self.entries = 0

    def end(self, tag: str) -> None:
        """Close an element; those of the long lists go there, and not into the tree."""
        depth = len(self.open)
        section = self.open[1].tag if depth > 2 else ""
        if section == "ModelVariables":
            if depth > 3:
                super().end(tag)  # becomes part of the variable
                return
            element = self.open.pop()
            if element.tag == "Clock":  # of which more is read
                self.open[1].append(element)
            self.variables.add(element, self.major)
        elif section == "ModelStructure" and depth == (3 if self.major == 3 else 4):
            element, around = self.open.pop(), self.open[-1]
            where, which = (element, "valueReference") if self.major == 3 else (around, "index")
            written = _Unknown(where.tag, element.get(which, ""), element.get("dependencies"))
            self.unknowns.append(written)
        else:
            super().end(tag)
        self.entries += 1
        if self.entries > _MOST_ENTRIES:
            what = "variables, entries of the model structure and other elements"
            raise RefusedError(f"has more than {_MOST_ENTRIES} {what}")

    @cached_property
    def major(self) -> int:
        """The FMI version; 2 for one that is not known."""
        first = self.open[0].get("fmiVersion", "").strip()[:1]
        return int(first) if first in ("1", "3") else 2


class _Structure(NamedTuple):
    """The model structure, by names of variables."""

    dependencies: dict[str, tuple[str, ...] | None]
    derivatives: list[str]
    event_indicators: list[str]


class _Reading:
    """The reading of one description, whose parts refer to each other."""

    def __init__(self, document: _Document, version: str, findings: Findings) -> None:
        self.root, self.version, self.note = document.root, version, findings.add
        self.major = int(version[0])
        self.units = dict(self._units())
        reader = VariableReader(self.root, self.major, document.variables, self.units, self.note)
        self.variables = reader.variables()
        self.targets = reader.targets
        self.unknowns = document.unknowns

    def description(self) -> FMUDescription:
        """Return what has been read."""
        root, structure = self.root, self._structure()
        states = self._size(structure.derivatives) if self.major > 1 else self._fmi1_states()
        indicators = self._integer("numberOfEventIndicators") + self._size(structure.event_indicators)
        description = FMUDescription(
            fmi_version=self.version,
            guid=root.get("instantiationToken" if self.major == 3 else "guid", ""),
            model_name=root.get("modelName", ""),
            variables=self.variables,
            interfaces=self._interfaces(),
            generation_tool=root.get("generationTool") or "unknown",
            generated_at=root.get("generationDateAndTime", ""),
            author=root.get("author", ""),
            version=root.get("version", ""),
            copyright=root.get("copyright", ""),
            license=root.get("license", ""),
            text=root.get("description", ""),
            continuous_states=states,
            event_indicators=indicators,
            derivatives=tuple(structure.derivatives),
            default_experiment=self._experiment(),
            display_units=self.units,
            dependencies=structure.dependencies,
            source_files=self._source_files(),
            clocks=tuple(self._clocks()) if self.major == 3 else (),
        )
        ticking = description.ticking_clocks(description.preferred) if description.preferred else ()
        for clock in description.clocks:
            if clock.causality == "input" and clock not in ticking:
                self.note(defects.UNTICKED_CLOCK, f"{clock.name} ({clock.variability})")
        return description

    def _clocks(self) -> Iterator[Clock]:
        for element in self.root.iterfind("ModelVariables/Clock"):
            name = element.get("name", "")
            if name not in self.variables:  # it has no value reference, which has been noted
                continue
            variable = self.variables[name]
            yield Clock(
                name,
                variable.reference,
                variable.causality,
                element.get("intervalVariability", ""),
                self._interval(element, "interval", math.nan),
                self._interval(element, "shift", 0.0),
            )

    def _interval(self, element: Element, what: str, default: float) -> float:
        """Return a time of a clock [s]: written as a decimal, or as a fraction of two integers."""

        def value(attribute: str, default: float) -> float:
            return noted_number(
                self.note, element.get("name", ""), attribute, element.get(attribute), default
            )

        if f"{what}Counter" in element.attrib:
            resolution = value("resolution", math.nan)
            return value(f"{what}Counter", default) / resolution if resolution else math.nan
        return value(f"{what}Decimal", default)

    def _interfaces(self) -> dict[str, Interface]:
        if self.major == 1:  # which has one of them, and other words for what it can do
            is_slave = self.root.find("Implementation") is not None
            kind: InterfaceKind = "co-simulation" if is_slave else "model-exchange"
            identifier = self.root.get("modelIdentifier", "")
            return {kind: Interface(kind, identifier, needs_completed_step=False)}
        interfaces: dict[str, Interface] = {
            k: self._interface(k, e) for k, tag in INTERFACES.items() for e in self.root.findall(tag)
        }
        if not interfaces:
            offered = self.root.find("ScheduledExecution")
            self.note(defects.NO_INTERFACE, "no interface at all" if offered is None else offered.tag)
        return interfaces

    def _interface(self, kind: InterfaceKind, element: Element) -> Interface:
        is_fmi3, is_slave = self.major == 3, kind == "co-simulation"

        def can(fmi2: str, fmi3: str = "") -> bool:
            return is_true(element.get(fmi3 if fmi3 and is_fmi3 else fmi2))

        fixed_step = element.get("fixedInternalStepSize") if is_slave and is_fmi3 else None
        tells_steps = can("needsCompletedIntegratorStep")
        if not is_fmi3:
            tells_steps = not can("completedIntegratorStepNotNeeded")
        return Interface(
            kind=kind,
            model_identifier=element.get("modelIdentifier", ""),
            needs_execution_tool=can("needsExecutionTool"),
            only_one_instance=can("canBeInstantiatedOnlyOncePerProcess"),
            can_save_state=can("canGetAndSetFMUstate", "canGetAndSetFMUState"),
            can_serialize_state=can("canSerializeFMUstate", "canSerializeFMUState"),
            provides_directional_derivatives=can(
                "providesDirectionalDerivative", "providesDirectionalDerivatives"
            ),
            variable_step=not is_slave or can("canHandleVariableCommunicationStepSize"),
            fixed_step=noted_number(self.note, kind, "fixedInternalStepSize", fixed_step, 0.0) or None,
            has_event_mode=is_slave and is_fmi3 and can("hasEventMode"),
            needs_completed_step=tells_steps and not is_slave,
        )

    def _source_files(self) -> dict[str, tuple[str, ...]]:
        """Return the source files by model identifier; FMI 3.0 has a file of its own for them."""
        sources: dict[str, tuple[str, ...]] = {}
        for tag in ("ModelExchange", "CoSimulation"):
            for interface in self.root.findall(tag):
                names = tuple(file.get("name", "") for file in interface.iterfind("SourceFiles/File"))
                if names:
                    sources.setdefault(interface.get("modelIdentifier", ""), names)
        return sources

    def _fmi1_states(self) -> int:
        if self.root.get("numberOfContinuousStates") is None:
            self.note(defects.REPAIRED, "numberOfContinuousStates is missing, read as 0")
        return self._integer("numberOfContinuousStates")

    def _size(self, names: Iterable[str]) -> int:
        """Return the number of scalars in some variables."""
        return sum(math.prod(self.variables[name].shape) for name in names)

    def _experiment(self) -> DefaultExperiment:
        experiments = self.root.findall("DefaultExperiment")
        attributes = experiments[-1].attrib if experiments else {}

        def value(name: str) -> float | None:
            text = attributes.get(name)
            if text is not None and not is_number(text):
                self.note(defects.BAD_EXPERIMENT, f'{name} = "{text}"')
            given = number(text, math.nan)
            return given if math.isfinite(given) else None

        return DefaultExperiment(value("startTime"), value("stopTime"), value("tolerance"), value("stepSize"))

    def _units(self) -> Iterator[tuple[str, tuple[DisplayUnit, ...]]]:
        """Yield the units that are defined, each with its display units."""
        tag, shown, factor = "DisplayUnit", "name", "factor"
        if self.major == 1:
            tag, shown, factor = "DisplayUnitDefinition", "displayUnit", "gain"
        for unit in self.root.iterfind("UnitDefinitions/*"):
            display_units = [
                DisplayUnit(
                    name := element.get(shown, ""),
                    noted_number(self.note, name, factor, element.get(factor), 1.0),
                    noted_number(self.note, name, "offset", element.get("offset"), 0.0),
                )
                for element in unit.iterfind(tag)
                if not is_true(element.get("inverse"))  # of the reciprocal value (FMI 3.0): not known here
            ]
            yield unit.get("unit" if self.major == 1 else "name", ""), tuple(display_units)

    def _structure(self) -> _Structure:
        structure = _Structure({}, [], [])
        for unknown in self.unknowns:
            name = self._name(unknown.variable)
            if name is None:
                self.note(defects.BAD_STRUCTURE, f'{unknown.list}: "{unknown.variable}"')
                continue
            dependencies = self._dependencies(unknown)
            if unknown.list in ("Outputs", "Output"):
                structure.dependencies[name] = dependencies
            elif unknown.list in ("Derivatives", "ContinuousStateDerivative"):
                structure.derivatives.append(name)
            elif unknown.list == "EventIndicator":
                structure.event_indicators.append(name)
        return structure

    def _name(self, written: str) -> str | None:
        """Return the name of a variable by its identifier in the model structure."""
        name = self.targets.get(integer(written))
        return name if name in self.variables else None

    def _dependencies(self, unknown: _Unknown) -> tuple[str, ...] | None:
        """Return the variables that one depends on; None where that is not known."""
        if unknown.dependencies is None:
            return None
        known = {text: self._name(text) for text in unknown.dependencies.split()}
        names = tuple(name for name in known.values() if name is not None)
        if len(names) < len(known):
            wrong = ", ".join(text for text, name in known.items() if name is None)
            self.note(defects.BAD_DEPENDENCY, f"{unknown.list} {unknown.variable}: {wrong}")
            return None
        return names

    def _integer(self, attribute: str) -> int:
        """Return a number of the root element, 0 for none."""
        written = self.root.get(attribute)
        value = integer(written)
        if written is not None and value is None:
            self.note(defects.NOT_A_NUMBER, f'{attribute} = "{written}"')
        return max(value or 0, 0)
