"""Reading modelDescription.xml of FMI 1.0, 2.0 and 3.0: once, and tolerantly.

What contradicts the standard but can be understood is read as it must be meant. Whatever is ignored, replaced
or assumed on the way is noted as a defect; FMPy's validator is an extra check of ``inspect --strict``.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from ddpc_cosim.errors import FMUImportError
from ddpc_cosim.fmu import defects
from ddpc_cosim.fmu.archive import MODEL_DESCRIPTION, read_xml
from ddpc_cosim.fmu.defects import Findings, Severity
from ddpc_cosim.fmu.description import (
    INTERFACES,
    DefaultExperiment,
    FMUDescription,
    FMUVariable,
    Interface,
    InterfaceKind,
    number,
)
from ddpc_cosim.fmu.variable_types import TYPES
from ddpc_cosim.variables import DisplayUnit, Variable

Element = Any
"""An element of lxml, which has no type information."""

# The variabilities that a causality admits, each with the value of initial that is assumed for it; the first
# one counts where a description says something else (FMI 2.0, section 2.2.7; FMI 3.0, section 2.4.7.4).
_VARIABILITIES: Mapping[str, Mapping[str, str]] = {
    "parameter": {"fixed": "exact", "tunable": "exact"},
    "calculatedParameter": {"fixed": "calculated", "tunable": "calculated"},
    "structuralParameter": {"fixed": "exact", "tunable": "exact"},
    "input": {"continuous": "exact", "discrete": "exact"},
    "output": {"continuous": "calculated", "discrete": "calculated", "constant": "exact"},
    "local": {
        "continuous": "calculated",
        "discrete": "calculated",
        "constant": "exact",
        "fixed": "calculated",
        "tunable": "calculated",
    },
    "independent": {"continuous": ""},
}
_CAUSALITIES = {
    1: frozenset({"input", "output", "internal", "none"}),
    2: frozenset(_VARIABILITIES) - {"structuralParameter"},
    3: frozenset(_VARIABILITIES),
}
_FMI1_VARIABILITIES = ("continuous", "discrete", "constant", "parameter")

_LARGEST_REFERENCE = 2**32 - 1
_MOST_ELEMENTS = 1_000_000
_MOST_DIGITS = 20
_AS_GOOD_AS_INFINITE = 1e30


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
    root, overlooked = read_xml(folder / MODEL_DESCRIPTION, f"{label}: {MODEL_DESCRIPTION}")
    for what in overlooked:
        findings.add(defects.REPAIRED, what)
    if root.tag.startswith("{"):  # FMI knows no namespaces, some tools do
        findings.add(defects.REPAIRED, "XML namespaces were left out")
        for element in root.iter():
            element.tag = element.tag.rpartition("}")[2]
    if "fmiVersion" not in root.attrib:
        raise FMUImportError(f"{label}: {MODEL_DESCRIPTION} cannot be read: <{root.tag}> has no fmiVersion")
    version = _version(root.get("fmiVersion"), findings)
    return _Reading(root, version, findings).description() if version else None


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


class _Type(NamedTuple):
    """A type definition: what variables inherit from it."""

    attributes: Mapping[str, str]
    items: Mapping[str, int]


_UNDECLARED = _Type({}, {})


class _Entry(NamedTuple):
    """A variable as written."""

    name: str
    reference: int
    type: str
    start: str | None
    own: Mapping[str, str]
    inherited: _Type
    element: Element

    def get(self, attribute: str) -> str | None:
        """Return an attribute of the variable, or of its declared type."""
        return self.own.get(attribute, self.inherited.attributes.get(attribute))


class _Structure(NamedTuple):
    """The model structure, by names of variables."""

    dependencies: dict[str, tuple[str, ...] | None]
    derivatives: list[str]
    event_indicators: list[str]


class _Reading:
    """The reading of one description, whose parts refer to each other."""

    def __init__(self, root: Element, version: str, findings: Findings) -> None:
        self.root, self.version, self.note = root, version, findings.add
        self.major = int(version[0])
        self.units = dict(self._units())
        self.types = dict(self._types())
        entries = self._entries()
        # What can be referred to: places in the list of variables (FMI 2.0), value references (FMI 3.0).
        self.targets: dict[int | None, _Entry] = {}
        if self.major > 1:
            self.targets = {e.reference if self.major == 3 else i: e for i, e in enumerate(entries, 1) if e}
        self.variables = self._variables([entry for entry in entries if entry])

    def description(self) -> FMUDescription:
        """Return what has been read."""
        root, structure = self.root, self._structure()
        states = self._size(structure.derivatives) if self.major > 1 else self._fmi1_states()
        indicators = self._integer("numberOfEventIndicators") + self._size(structure.event_indicators)
        return FMUDescription(
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
        )

    def _interfaces(self) -> dict[str, Interface]:
        if self.major == 1:  # which has one of them, and other words for what it can do
            is_slave = self.root.find("Implementation") is not None
            kind: InterfaceKind = "co-simulation" if is_slave else "model-exchange"
            identifier = self.root.get("modelIdentifier", "")
            return {kind: Interface(kind, identifier, needs_completed_step=False)}
        found: dict[str, Interface] = {
            k: self._interface(k, e) for k, tag in INTERFACES.items() for e in self.root.findall(tag)
        }
        if not found:
            offered = self.root.find("ScheduledExecution")
            self.note(defects.NO_INTERFACE, "no interface at all" if offered is None else offered.tag)
        return found

    def _interface(self, kind: InterfaceKind, element: Element) -> Interface:
        is_fmi3, is_slave = self.major == 3, kind == "co-simulation"

        def can(fmi2: str, fmi3: str = "") -> bool:
            return _is_true(element.get(fmi3 if fmi3 and is_fmi3 else fmi2))

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
            fixed_step=self._number(kind, "fixedInternalStepSize", fixed_step, 0.0) or None,
            has_event_mode=is_slave and is_fmi3 and can("hasEventMode"),
            needs_completed_step=tells_steps and not is_slave,
        )

    def _source_files(self) -> dict[str, tuple[str, ...]]:
        """Return the source files by model identifier; FMI 3.0 has a file of its own for them."""
        found: dict[str, tuple[str, ...]] = {}
        for tag in ("ModelExchange", "CoSimulation"):
            for interface in self.root.findall(tag):
                names = tuple(file.get("name", "") for file in interface.iterfind("SourceFiles/File"))
                if names:
                    found.setdefault(interface.get("modelIdentifier", ""), names)
        return found

    def _fmi1_states(self) -> int:
        if self.root.get("numberOfContinuousStates") is None:
            self.note(defects.REPAIRED, "numberOfContinuousStates is missing, read as 0")
        return self._integer("numberOfContinuousStates")

    def _size(self, names: Iterable[str]) -> int:
        """Return the number of scalars in some variables."""
        return sum(math.prod(self.variables[name].shape) for name in names)

    def _experiment(self) -> DefaultExperiment:
        found = self.root.findall("DefaultExperiment")
        attributes = found[-1].attrib if found else {}

        def value(name: str) -> float | None:
            text = attributes.get(name)
            if text is not None and not _is_number(text):
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
                    self._number(name, factor, element.get(factor), 1.0),
                    self._number(name, "offset", element.get("offset"), 0.0),
                )
                for element in unit.iterfind(tag)
                if not _is_true(element.get("inverse"))  # of the reciprocal value (FMI 3.0): not known here
            ]
            yield unit.get("unit" if self.major == 1 else "name", ""), tuple(display_units)

    def _types(self) -> Iterator[tuple[str, _Type]]:
        """Yield the type definitions by name."""
        for definition in self.root.iterfind("TypeDefinitions/*"):
            # FMI 1.0 and 2.0 have an element inside, whose name is the type's.
            described = definition if self.major == 3 else next(iter(definition), definition)
            items = {
                item.get("name", ""): (_integer(item.get("value")) or 0) if self.major > 1 else place
                for place, item in enumerate(described.iterfind("Item"), 1)
            }
            yield definition.get("name", ""), _Type(described.attrib, items)

    def _entries(self) -> list[_Entry | None]:
        """Return the variables as written, with None in the place of those that cannot be used."""
        elements = self.root.find("ModelVariables")
        if elements is None:
            self.note(defects.REPAIRED, "there are no ModelVariables")
            return []
        entries = [self._entry(element) for element in elements]
        if entries and not any(entries):
            self.note(defects.NO_VARIABLES, f"in the terms of FMI {self.version}")
        nameless = sum(not element.get("name") for element in elements)
        if nameless:
            self.note(defects.NO_NAME, f"{nameless} of them")
        for name, times in Counter(entry.name for entry in entries if entry).items():
            if times > 1:
                self.note(defects.DUPLICATE_NAME, f"{name} ({times} times)")
        return entries

    def _entry(self, element: Element) -> _Entry | None:
        name, types = element.get("name"), TYPES[self.major]
        # In FMI 3.0 the element is the type, in FMI 1.0 and 2.0 there is one inside.
        inner = element if self.major == 3 else next((e for e in element if e.tag in types), None)
        if not name:
            return None
        if inner is None or inner.tag not in types:
            self.note(defects.NO_TYPE, name)
            return None
        written = element.get("valueReference", "")
        reference = _integer(written)
        if reference is None or not 0 <= reference <= _LARGEST_REFERENCE:
            self.note(defects.BAD_REFERENCE, f'{name}: "{written}"')
            return None
        own = {**inner.attrib, **element.attrib}
        declared = own.get("declaredType", "")
        if "declaredType" in own and declared not in self.types:
            self.note(defects.UNKNOWN_TYPE, f'{name}: "{declared}"')
        start = own.get("start")
        if self.major == 3 and inner.tag in ("String", "Binary"):
            first = inner.find("Start")
            start = None if first is None else first.get("value", "")
        return _Entry(name, reference, inner.tag, start, own, self.types.get(declared, _UNDECLARED), element)

    def _variables(self, entries: Sequence[_Entry]) -> dict[str, FMUVariable]:
        variables: dict[str, FMUVariable] = {}
        aliases: dict[str, FMUVariable] = {}
        for entry in entries:
            variable = self._variable(entry)
            if variable is not None:
                variables[entry.name] = variable
                aliases.update(self._aliases(variable, entry.element))
        return variables | aliases

    def _variable(self, entry: _Entry) -> FMUVariable | None:
        """Return a variable with everything resolved; None for an array that cannot be used."""
        row = TYPES[self.major][entry.type]
        dimensions, shape = self._sizes(entry)
        if shape is None:
            return None
        causality, variability, initial = self._kind(entry, is_real=row.values == "real")
        unit = entry.get("unit") or ""
        return FMUVariable(
            variable=Variable(
                name=entry.name,
                unit=unit,
                min=self._bound(entry, "min", row.min),
                max=self._bound(entry, "max", row.max),
                nominal=self._number(entry.name, "nominal", entry.get("nominal"), 1.0),
                start=self._start(entry, causality),
                description=entry.own.get("description", ""),
                display_unit=self._display_unit(entry.name, unit, entry.get("displayUnit")),
            ),
            reference=entry.reference,
            type=entry.type,
            causality=causality,
            variability=variability,
            initial=initial,
            shape=shape,
            dimensions=dimensions,
            start_text=entry.start,
            items=entry.inherited.items,
            derivative_of=self._state(entry),
            negated=self.major == 1 and entry.own.get("alias") == "negatedAlias",
        )

    def _kind(self, entry: _Entry, *, is_real: bool) -> tuple[str, str, str]:
        """Return causality, variability and initial, made to fit each other: the causality counts."""
        name, causality, variability = entry.name, entry.own.get("causality"), entry.own.get("variability")
        if causality is not None and causality not in _CAUSALITIES[self.major]:
            self.note(defects.UNKNOWN_CAUSALITY, f'{name}: "{causality}"')
            causality = None
        if variability is not None and variability not in self._known_variabilities():
            self.note(defects.UNKNOWN_VARIABILITY, f'{name}: "{variability}"')
            variability = None
        has_start = "" if entry.start is None else "exact"
        if self.major == 1:  # whose parameters have no causality of their own
            if variability == "parameter":
                return "parameter", "fixed", has_start
            kept = causality if causality in ("input", "output") else "local"
            return kept, variability or "continuous", has_start
        causality = causality or "local"
        allowed = _VARIABILITIES[causality]
        # FMI 2.0 has one default for all, FMI 3.0 has one that fits.
        assumed = "continuous" if is_real or self.major == 2 else "discrete"
        wanted = variability or assumed
        if wanted not in allowed:
            first = next(iter(allowed))
            if variability or self.major == 2:
                self.note(defects.BAD_COMBINATION, f"{name}: {causality}, {wanted}; read as {first}")
            wanted = first
        return causality, wanted, entry.own.get("initial") or allowed[wanted] or has_start

    def _known_variabilities(self) -> Iterable[str]:
        return _FMI1_VARIABILITIES if self.major == 1 else _VARIABILITIES["local"]

    def _sizes(self, entry: _Entry) -> tuple[tuple[int | str, ...], tuple[int, ...] | None]:
        """Return an array's dimensions, and its shape at the start; None where it cannot be used."""
        dimensions: list[int | str] = []
        shape: list[int] = []
        for dimension in entry.element.iterfind("Dimension") if self.major == 3 else ():
            fixed = dimension.get("start")
            parameter = self.targets.get(_integer(dimension.get("valueReference")))
            size = _integer(fixed if fixed is not None or parameter is None else parameter.start)
            if size is None or size < 0:
                self.note(defects.BAD_DIMENSION, entry.name)
                return (), None
            dimensions.append(size if fixed is not None or parameter is None else parameter.name)
            shape.append(size)
        count = math.prod(shape)
        if count > _MOST_ELEMENTS:
            self.note(
                defects.HUGE_ARRAY, f"the array {entry.name} has {count} elements; allowed: {_MOST_ELEMENTS}"
            )
            return (), None
        return tuple(dimensions), tuple(shape)

    def _start(self, entry: _Entry, causality: str) -> float:
        """Return the start value; for an array that of its first element, for none 0."""
        row = TYPES[self.major][entry.type]
        if entry.start is None and row.values != "none":
            needed = causality in ("input", "parameter", "structuralParameter")
            initial = entry.own.get("initial")
            if initial in ("exact", "approx") or (needed and initial != "calculated"):
                self.note(defects.NO_START, entry.name)
        values = (entry.start or "").split()
        if len(values) == 1 and row.is_number:
            return self._number(entry.name, "start", values[0], 0.0)
        return number(values[0] if values else None, 0.0)

    def _bound(self, entry: _Entry, which: str, none: float) -> float:
        """Return a limit; many tools write the largest number that they know where there is none."""
        if TYPES[self.major][entry.type].values not in ("real", "integer"):
            return none
        bound = self._number(entry.name, which, entry.get(which), none)
        return none if abs(bound) >= _AS_GOOD_AS_INFINITE else bound

    def _display_unit(self, name: str, unit: str, wanted: str | None) -> DisplayUnit | None:
        known = self.units.get(unit, ())
        found = next((display_unit for display_unit in known if display_unit.name == wanted), None)
        if wanted and found is None and wanted != unit and unit in self.units:
            self.note(defects.UNKNOWN_DISPLAY_UNIT, f"{name}: {wanted} for {unit}")
        return found

    def _state(self, entry: _Entry) -> str:
        """Return the name of the state that a variable is the derivative of; empty for none."""
        written = entry.own.get("derivative")
        if written is None or self.major == 1:
            return ""
        state = self.targets.get(_integer(written))
        if state is None:
            self.note(defects.BAD_DERIVATIVE, f'{entry.name}: "{written}"')
        return state.name if state is not None else ""

    def _aliases(self, variable: FMUVariable, element: Element) -> Iterator[tuple[str, FMUVariable]]:
        """Yield the other names of a variable (FMI 3.0)."""
        for alias in element.iterfind("Alias") if self.major == 3 else ():
            name, own = alias.get("name"), variable.variable
            if not name:
                self.note(defects.NO_NAME, f"an alias of {variable.name}")
                continue
            shown = self._display_unit(name, own.unit, alias.get("displayUnit")) or own.display_unit
            text = alias.get("description") or own.description
            named = replace(own, name=name, description=text, display_unit=shown)
            yield name, replace(variable, variable=named, alias_of=variable.name)

    def _structure(self) -> _Structure:
        structure = _Structure({}, [], [])
        names = {target: e.name for target, e in self.targets.items() if e.name in self.variables}
        for part in self.root.iterfind("ModelStructure/*"):
            for unknown in [part] if self.major == 3 else part.iterfind("Unknown"):
                written = unknown.get("valueReference" if self.major == 3 else "index", "")
                name = names.get(_integer(written))
                if name is None:
                    self.note(defects.BAD_STRUCTURE, f'{part.tag}: "{written}"')
                    continue
                dependencies = self._dependencies(f"{part.tag} {written}", unknown, names)
                if part.tag in ("Outputs", "Output"):
                    structure.dependencies[name] = dependencies
                elif part.tag in ("Derivatives", "ContinuousStateDerivative"):
                    structure.derivatives.append(name)
                elif part.tag == "EventIndicator":
                    structure.event_indicators.append(name)
        return structure

    def _dependencies(
        self, where: str, unknown: Element, names: Mapping[int | None, str]
    ) -> tuple[str, ...] | None:
        """Return the variables that one depends on; None where that is not known."""
        written = unknown.get("dependencies")
        if written is None:
            return None
        found = {text: names.get(_integer(text)) for text in written.split()}
        wrong = [text for text, name in found.items() if name is None]
        if wrong:
            self.note(defects.BAD_DEPENDENCY, f"{where}: {', '.join(wrong)}")
            return None
        return tuple(name for name in found.values() if name is not None)

    def _integer(self, attribute: str) -> int:
        """Return a number of the root element, 0 for none."""
        written = self.root.get(attribute)
        found = _integer(written)
        if written is not None and found is None:
            self.note(defects.NOT_A_NUMBER, f'{attribute} = "{written}"')
        return max(found or 0, 0)

    def _number(self, where: str, attribute: str, written: str | None, default: float) -> float:
        if written is not None and not _is_number(written):
            self.note(defects.NOT_A_NUMBER, f'{where}: {attribute} = "{written}"')
        return number(written, default)


def _integer(text: str | None) -> int | None:
    """Return the integer that a text stands for; None if it does not stand for one."""
    digits = (text or "").strip().removeprefix("-")
    return int(text or "") if digits.isdecimal() and len(digits) <= _MOST_DIGITS else None


def _is_true(text: str | None) -> bool:
    return text in ("true", "1")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text.strip() in ("true", "false")
    return True


def one_line(error: BaseException) -> str:
    """Return an error's text on one line."""
    return " ".join(str(error).split())[:300] or type(error).__name__
