"""Reading the variables of a model description: as written, and what they mean."""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from ddpc_cosim.fmu.description import FMUVariable, defects, number
from ddpc_cosim.fmu.description.variable_types import TYPES
from ddpc_cosim.variables import DisplayUnit, Variable

Element = Any
"""An element of lxml, which has no type information."""

Note = Callable[[defects.Kind, str], None]
"""Notes a defect, and where it is."""

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
_INTEGER = re.compile(r"\s*[+-]?\d{1,20}\s*")  # more digits are no reference or size, and take long
_AS_GOOD_AS_INFINITE = 1e30


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


class VariableReader:
    """Reads the variables of one description.

    Parameters
    ----------
    root : lxml element
        The description.
    major : int
        Its FMI version.
    units : mapping of str to tuple of DisplayUnit
        The units that it defines, each with its display units.
    note : callable
        Takes a kind of defect, and where it is.
    """

    def __init__(
        self, root: Element, major: int, units: Mapping[str, tuple[DisplayUnit, ...]], note: Note
    ) -> None:
        self.root, self.major, self.units, self.note = root, major, units, note
        self.display_units = {unit: {one.name: one for one in known} for unit, known in units.items()}
        self.elements = 0  # of all arrays
        self.types = dict(self._types())
        self.entries = self._entries()
        # What can be referred to: places in the list of variables (FMI 2.0), value references (FMI 3.0).
        self.targets: dict[int | None, _Entry] = {}
        if major > 1:
            self.targets = {e.reference if major == 3 else i: e for i, e in enumerate(self.entries, 1) if e}

    def variables(self) -> dict[str, FMUVariable]:
        """Return the variables that can be used by name, other names of them at the end."""
        variables: dict[str, FMUVariable] = {}
        aliases: dict[str, FMUVariable] = {}
        for entry in self.entries:
            variable = self._variable(entry) if entry else None
            if entry and variable:
                variables[entry.name] = variable
                aliases.update(self._aliases(variable, entry.element))
        return variables | aliases

    def names(self, variables: Mapping[str, FMUVariable]) -> dict[int | None, str]:
        """Return the names of variables by what the model structure calls them."""
        return {target: e.name for target, e in self.targets.items() if e.name in variables}

    def _types(self) -> Iterator[tuple[str, _Type]]:
        """Yield the type definitions by name."""
        for definition in self.root.iterfind("TypeDefinitions/*"):
            # FMI 1.0 and 2.0 have an element inside, whose name is the type's.
            described = definition if self.major == 3 else next(iter(definition), definition)
            items = {
                item.get("name", ""): (integer(item.get("value")) or 0) if self.major > 1 else place
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
            self.note(defects.NO_VARIABLES, f"in the terms of FMI {self.major}.0")
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
        reference = integer(written)
        if reference is None or not 0 <= reference <= _LARGEST_REFERENCE:
            self.note(defects.BAD_REFERENCE, f'{name}: "{written}"')
            return None
        own = {**inner.attrib, **element.attrib}
        declared = own.get("declaredType", "")
        if "declaredType" in own and declared not in self.types:
            self.note(defects.UNKNOWN_TYPE, f'{name}: "{declared}"')
        start = own.get("start")
        if self.major == 3 and not types[inner.tag].is_number:  # texts and bytes have an element for it
            first = inner.find("Start")
            start = None if first is None else first.get("value", "")
        return _Entry(name, reference, inner.tag, start, own, self.types.get(declared, _UNDECLARED), element)

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
                nominal=noted_number(self.note, entry.name, "nominal", entry.get("nominal"), 1.0),
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
            parameter = None
            if fixed is None:
                parameter = self.targets.get(integer(dimension.get("valueReference")))
            size = integer(fixed if parameter is None else parameter.start)
            if size is None or size < 0:
                self.note(defects.BAD_DIMENSION, entry.name)
                return (), None
            dimensions.append(size if parameter is None else parameter.name)
            shape.append(size)
            count = math.prod(shape)
            if count > _MOST_ELEMENTS:  # at once: a product of many sizes takes long, and cannot be shown
                what = f"the array {entry.name} has {count} elements; allowed: {_MOST_ELEMENTS}"
                self.note(defects.HUGE_ARRAY, what)
                return (), None
        self.elements += math.prod(shape) if shape else 0
        if self.elements > _MOST_ELEMENTS:
            what = f"{self.elements} elements up to the array {entry.name}; allowed: {_MOST_ELEMENTS}"
            self.note(defects.HUGE_ARRAY, what)
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
            return noted_number(self.note, entry.name, "start", values[0], 0.0)
        return number(values[0] if values else None, 0.0)

    def _bound(self, entry: _Entry, which: str, none: float) -> float:
        """Return a limit; many tools write the largest number that they know where there is none."""
        if TYPES[self.major][entry.type].values not in ("real", "integer"):  # which have no limits to write
            return none
        bound = noted_number(self.note, entry.name, which, entry.get(which), none)
        return none if abs(bound) >= _AS_GOOD_AS_INFINITE else bound

    def _display_unit(self, name: str, unit: str, wanted: str | None) -> DisplayUnit | None:
        found = self.display_units.get(unit, {}).get(wanted or "")
        if wanted and found is None and wanted != unit and unit in self.units:
            self.note(defects.UNKNOWN_DISPLAY_UNIT, f"{name}: {wanted} for {unit}")
        return found

    def _state(self, entry: _Entry) -> str:
        """Return the name of the state that a variable is the derivative of; empty for none."""
        written = entry.own.get("derivative")
        if written is None or self.major == 1:
            return ""
        state = self.targets.get(integer(written))
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


def noted_number(note: Note, where: str, attribute: str, written: str | None, default: float) -> float:
    """Return the number that an attribute stands for; a text that is not one is a defect, and ignored."""
    if written is not None and not is_number(written):
        note(defects.NOT_A_NUMBER, f'{where}: {attribute} = "{written}"')
    return number(written, default)


def integer(text: str | None) -> int | None:
    """Return the integer that a text stands for; None if it does not stand for one."""
    return int(text) if text is not None and _INTEGER.fullmatch(text) else None


def is_true(text: str | None) -> bool:
    """Whether a text is a boolean that is true."""
    return text in ("true", "1")


def is_number(text: str) -> bool:
    """Whether a text is a number, or a boolean, which counts as one."""
    try:
        float(text)
    except ValueError:
        return text.strip() in ("true", "false")
    return True
