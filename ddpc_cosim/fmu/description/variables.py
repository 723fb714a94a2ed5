"""Reading the variables of a model description: as written, and what they mean."""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar
from xml.etree.ElementTree import Element

from ddpc_cosim.description import DescribedVariable, number
from ddpc_cosim.fmu.description import defects
from ddpc_cosim.fmu.description.variable_types import TYPES, VariableType
from ddpc_cosim.variables import DisplayUnit, Variable

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
_NOT_NUMBERS = ("nan", "-nan", "+nan")
_MOST_DIGITS = 20  # more are not a reference or size, and take long
_INTEGER = re.compile(rf"\s*[+-]?\d{{1,{_MOST_DIGITS}}}\s*")
_AS_GOOD_AS_INFINITE = 1e30
_TEXTS_KEPT = 10_000
_Text = TypeVar("_Text", str, str | None)


class _Type(NamedTuple):
    """A type definition: what variables inherit from it."""

    attributes: Mapping[str, str]
    items: Mapping[str, int]


_UNDECLARED = _Type({}, {})


class _Traits(NamedTuple):
    """What many variables of a description have in common, as written."""

    type: str
    declared: str | None
    causality: str | None
    variability: str | None
    initial: str | None
    unit: str | None
    display_unit: str | None
    alias: str | None


class _Entry(NamedTuple):
    """A variable as written, in little memory."""

    name: str
    reference: int | str
    traits: _Traits
    start: str | None
    min: str | None
    max: str | None
    nominal: str | None
    derivative: str | None
    description: str
    parts: Sequence[Element]


class _Meaning(NamedTuple):
    """What the traits of variables mean, and what is wrong with them."""

    causality: str
    variability: str
    initial: str
    type: VariableType
    unit: str
    display_unit: DisplayUnit | None
    inherited: _Type
    needs_start: bool
    faults: tuple[tuple[defects.Kind, str], ...]


class WrittenVariables(list[_Entry | None]):
    """The variables of a description as written; equal texts are kept once."""

    def __init__(self) -> None:
        self._traits: dict[tuple[str | None, ...], _Traits] = {}
        self._texts: dict[Any, Any] = {}

    def add(self, element: Element, major: int) -> None:
        """Add a variable of a description for an FMI version."""
        types, attributes, inner = TYPES[major], element.attrib, None
        if major == 3:  # where the element is the type; in FMI 1.0 and 2.0 there is one inside
            inner = element
        else:
            for part in element:
                if part.tag in types:
                    inner, attributes = part, {**part.attrib, **attributes}
                    break
        get = attributes.get
        start = get("start")
        if major == 3 and element.tag in types and not types[element.tag].is_number:
            first = element.find("Start")  # texts and bytes have an element for it
            start = None if first is None else first.get("value", "")
        key = (
            "" if inner is None else inner.tag,
            get("declaredType"),
            get("causality"),
            get("variability"),
            get("initial"),
            get("unit"),
            get("displayUnit"),
            get("alias"),
        )
        traits = self._traits.get(key)
        if traits is None:
            traits = self._traits[key] = _Traits(*key)
        written = get("valueReference", "")
        reference = integer(written)
        self.append(
            _Entry(
                get("name", ""),
                written if reference is None or not 0 <= reference <= _LARGEST_REFERENCE else reference,
                traits,
                self._share(start),
                get("min"),
                get("max"),
                get("nominal"),
                get("derivative"),
                self._share(get("description", "")),
                tuple(element) if major == 3 else (),
            )
        )

    def _share(self, text: _Text) -> _Text:
        shared: _Text = self._texts.get(text, text)
        if len(self._texts) < _TEXTS_KEPT:
            self._texts[text] = shared
        return shared


class VariableReader:
    """Reads the variables of one description.

    Parameters
    ----------
    root : Element
        The description.
    major : int
        Its FMI version.
    written : WrittenVariables
        Its variables, which are used up.
    units : mapping of str to tuple of DisplayUnit
        The units that it defines, each with its display units.
    note : callable
        Takes a kind of defect, and where it is.
    """

    def __init__(
        self,
        root: Element,
        major: int,
        written: WrittenVariables,
        units: Mapping[str, tuple[DisplayUnit, ...]],
        note: Note,
    ) -> None:
        self.root, self.major, self.units, self.note = root, major, units, note
        self.display_units = {unit: {shown.name: shown for shown in known} for unit, known in units.items()}
        self.elements = 0  # of all arrays
        self.types = dict(self._types())
        self.meanings: dict[tuple[_Traits, bool], _Meaning] = {}
        self.entries = written
        self._drop_unusable()
        # What can be referred to: places in the list of variables (FMI 2.0), value references (FMI 3.0).
        self.targets: Mapping[int | str | None, str] = {}
        if major > 1:
            self.targets = {e.reference if major == 3 else i: e.name for i, e in enumerate(written, 1) if e}
        sizes = {integer(part.get("valueReference")) for e in written if e for part in e.parts}
        self.sizes = {e.reference: e for e in written if e and e.reference in sizes} if sizes else {}

    def variables(self) -> dict[str, DescribedVariable]:
        """Return the variables that can be used by name, other names of them at the end."""
        variables: dict[str, DescribedVariable] = {}
        aliases: dict[str, DescribedVariable] = {}
        self.entries.reverse()
        while self.entries:  # gives back their memory on the way
            entry = self.entries.pop()
            variable = self._variable(entry) if entry else None
            if entry and variable:
                variables[entry.name] = variable
                if entry.parts:
                    aliases.update(self._aliases(variable, entry.parts))
        variables.update(aliases)
        return variables

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

    def _drop_unusable(self) -> None:
        """Put None in the place of the variables that cannot be used."""
        if self.root.find("ModelVariables") is None:
            self.note(defects.REPAIRED, "there are no ModelVariables")
        entries = self.entries
        nameless = sum(not entry.name for entry in entries if entry)
        for i, entry in enumerate(entries):
            if entry and not self._is_usable(entry):
                entries[i] = None
        if entries and not any(entries):
            self.note(defects.NO_VARIABLES, f"in the terms of FMI {self.major}.0")
        if nameless:
            self.note(defects.NO_NAME, f"{nameless} of them")
        if len({entry.name for entry in entries if entry}) < len(entries) - entries.count(None):
            for name, times in Counter(entry.name for entry in entries if entry).items():
                if times > 1:
                    self.note(defects.DUPLICATE_NAME, f"{name} ({times} times)")

    def _is_usable(self, entry: _Entry) -> bool:
        name, declared = entry.name, entry.traits.declared
        if not name:
            return False
        if entry.traits.type not in TYPES[self.major]:
            self.note(defects.NO_TYPE, name)
            return False
        if isinstance(entry.reference, str):
            self.note(defects.BAD_REFERENCE, f'{name}: "{entry.reference}"')
            return False
        if declared is not None and declared not in self.types:
            self.note(defects.UNKNOWN_TYPE, f'{name}: "{declared}"')
        return True

    def _variable(self, entry: _Entry) -> DescribedVariable | None:
        """Return a variable with everything resolved; None for an array that cannot be used."""
        name, traits = entry.name, entry.traits
        dimensions, shape = self._sizes(entry) if entry.parts else ((), ())
        if shape is None:
            return None
        key = (traits, entry.start is not None)
        meaning = self.meanings.get(key) or self.meanings.setdefault(key, self._meaning(*key))
        for kind, what in meaning.faults:
            self.note(kind, f"{name}: {what}")
        inherited = meaning.inherited.attributes
        nominal = entry.nominal if entry.nominal is not None else inherited.get("nominal")
        return DescribedVariable(
            variable=Variable(
                name=name,
                unit=meaning.unit,
                min=self._bound(entry, "min", entry.min, meaning),
                max=self._bound(entry, "max", entry.max, meaning),
                nominal=1.0 if nominal is None else noted_number(self.note, name, "nominal", nominal, 1.0),
                start=self._start(entry, meaning),
                description=entry.description,
                display_unit=meaning.display_unit,
            ),
            reference=int(entry.reference),
            type=traits.type,
            causality=meaning.causality,
            variability=meaning.variability,
            initial=meaning.initial,
            shape=shape,
            dimensions=dimensions,
            start_text=entry.start,
            items=meaning.inherited.items,
            derivative_of=self._state(entry) if entry.derivative is not None else "",
            negated=self.major == 1 and traits.alias == "negatedAlias",
            values=meaning.type.values,
        )

    def _meaning(self, traits: _Traits, has_start: bool) -> _Meaning:
        """Return what is the same for all variables with some traits."""
        type_ = TYPES[self.major][traits.type]
        inherited = self.types.get(traits.declared or "", _UNDECLARED)
        faults: list[tuple[defects.Kind, str]] = []
        kind = self._kind(traits, has_start, faults, is_real=type_.values == "real")
        unit, shown = (
            inherited.attributes.get(attribute) if written is None else written
            for attribute, written in (("unit", traits.unit), ("displayUnit", traits.display_unit))
        )
        display_unit = self._display_unit(unit or "", shown, faults)
        needed = kind[0] in ("input", "parameter", "structuralParameter") and traits.initial != "calculated"
        needs_start = type_.values != "none" and (needed or traits.initial in ("exact", "approx"))
        return _Meaning(
            *kind, type_, unit or "", display_unit, inherited, needs_start and not has_start, tuple(faults)
        )

    def _kind(
        self, traits: _Traits, has_start: bool, faults: list[tuple[defects.Kind, str]], *, is_real: bool
    ) -> tuple[str, str, str]:
        """Return causality, variability and initial, made to fit each other: the causality counts."""
        causality, variability = traits.causality, traits.variability
        if causality is not None and causality not in _CAUSALITIES[self.major]:
            faults.append((defects.UNKNOWN_CAUSALITY, f'"{causality}"'))
            causality = None
        if variability is not None and variability not in self._known_variabilities():
            faults.append((defects.UNKNOWN_VARIABILITY, f'"{variability}"'))
            variability = None
        exact = "exact" if has_start else ""
        if self.major == 1:  # whose parameters have no causality of their own
            if variability == "parameter":
                return "parameter", "fixed", exact
            kept = causality if causality in ("input", "output") else "local"
            return kept, variability or "continuous", exact
        causality = causality or "local"
        allowed = _VARIABILITIES[causality]
        # FMI 2.0 has one default for all, FMI 3.0 has one that fits.
        assumed = "continuous" if is_real or self.major == 2 else "discrete"
        wanted = variability or assumed
        if wanted not in allowed:
            first = next(iter(allowed))
            if variability or self.major == 2:
                faults.append((defects.BAD_COMBINATION, f"{causality}, {wanted}; read as {first}"))
            wanted = first
        return causality, wanted, traits.initial or allowed[wanted] or exact

    def _known_variabilities(self) -> Iterable[str]:
        return _FMI1_VARIABILITIES if self.major == 1 else _VARIABILITIES["local"]

    def _sizes(self, entry: _Entry) -> tuple[tuple[int | str, ...], tuple[int, ...] | None]:
        """Return an array's dimensions, and its shape at the start; None where it cannot be used."""
        dimensions: list[int | str] = []
        shape: list[int] = []
        for dimension in (part for part in entry.parts if part.tag == "Dimension"):
            fixed = dimension.get("start")
            parameter = None
            if fixed is None:
                parameter = self.sizes.get(integer(dimension.get("valueReference")) or 0)
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

    def _start(self, entry: _Entry, meaning: _Meaning) -> float:
        """Return the start value; for an array that of its first element, for none 0."""
        if entry.start is None:
            if meaning.needs_start:
                self.note(defects.NO_START, entry.name)
            return 0.0
        values = entry.start.split()
        if len(values) == 1 and meaning.type.is_number:
            return noted_number(self.note, entry.name, "start", values[0], 0.0)
        if meaning.type.is_number and any(text.lower() in _NOT_NUMBERS for text in values):
            self.note(defects.NOT_A_NUMBER, f'{entry.name}: start has an element "NaN"')
        return number(values[0] if values else None, 0.0)

    def _bound(self, entry: _Entry, which: str, text: str | None, meaning: _Meaning) -> float:
        """Return a limit; many tools write the largest number that they know where there is none."""
        none: float = getattr(meaning.type, which)
        if text is None and not meaning.inherited.attributes:
            return none
        written = text if text is not None else meaning.inherited.attributes.get(which)
        # Some types have no limits to write.
        if written is None or meaning.type.values not in ("real", "integer"):
            return none
        bound = noted_number(self.note, entry.name, which, written, none)
        return none if abs(bound) >= _AS_GOOD_AS_INFINITE else bound

    def _display_unit(
        self, unit: str, wanted: str | None, faults: list[tuple[defects.Kind, str]]
    ) -> DisplayUnit | None:
        shown = self.display_units.get(unit, {}).get(wanted or "")
        if wanted and shown is None and wanted != unit and unit in self.units:
            faults.append((defects.UNKNOWN_DISPLAY_UNIT, f"{wanted} for {unit}"))
        return shown

    def _state(self, entry: _Entry) -> str:
        """Return the name of the state that a variable is the derivative of; empty for none."""
        if self.major == 1:
            return ""
        state = self.targets.get(integer(entry.derivative))
        if state is None:
            self.note(defects.BAD_DERIVATIVE, f'{entry.name}: "{entry.derivative}"')
        return state or ""

    def _aliases(
        self, variable: DescribedVariable, parts: Iterable[Element]
    ) -> Iterator[tuple[str, DescribedVariable]]:
        """Yield the other names of a variable (FMI 3.0)."""
        for alias in (part for part in parts if part.tag == "Alias"):
            name, target = alias.get("name"), variable.variable
            if not name:
                self.note(defects.NO_NAME, f"an alias of {variable.name}")
                continue
            faults: list[tuple[defects.Kind, str]] = []
            shown = self._display_unit(target.unit, alias.get("displayUnit"), faults) or target.display_unit
            for kind, what in faults:
                self.note(kind, f"{name}: {what}")
            text = alias.get("description") or target.description
            named = replace(target, name=name, description=text, display_unit=shown)
            yield name, replace(variable, variable=named, alias_of=variable.name)


def noted_number(note: Note, where: str, attribute: str, written: str | None, default: float) -> float:
    """Return the number that an attribute stands for; a text that is not one is a defect, and ignored."""
    if written is None:
        return default
    try:
        value = float(written)
    except ValueError:
        if is_number(written):  # a boolean
            return number(written, default)
        value = math.nan
    if not math.isnan(value):
        return value
    note(defects.NOT_A_NUMBER, f'{where}: {attribute} = "{written}"')
    return number(written, default)


def integer(text: str | None) -> int | None:
    """Return the integer that a text stands for; None if it does not stand for one."""
    if text is None:
        return None
    is_plain = text.isdecimal() and len(text) <= _MOST_DIGITS  # as nearly all are
    return int(text) if is_plain or _INTEGER.fullmatch(text) else None


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
