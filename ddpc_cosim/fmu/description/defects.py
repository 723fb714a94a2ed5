"""Defects of an FMU: what was found, how much it matters, where, and what to do about it.

The kinds at the end are those that reading a model description meets; those that only ``inspect`` looks for
stand with its checks.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

_PLACES_SHOWN = 3
_LETTERS_SHOWN = 500  # a description may hold names and texts of any length


class Severity(StrEnum):
    """How much a defect matters."""

    ERROR = "error"
    """The FMU cannot run here."""
    WARNING = "warning"
    """It runs, but something is not as it says, or other tools will refuse it."""
    NOTE = "note"
    """Something is missing that would help."""


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of defect.

    Parameters
    ----------
    name : str
        Short name, for programs and for searching.
    severity : Severity
        How much it matters.
    message : str
        What is wrong.
    remedy : str
        What to do; empty where the message says it.
    """

    name: str
    severity: Severity
    message: str
    remedy: str = ""


@dataclass(frozen=True, slots=True)
class Defect:
    """All occurrences of one kind of defect in an FMU.

    Parameters
    ----------
    kind : Kind
        What is wrong and what to do.
    places : tuple of str
        Where: variables, files or attributes, with what stands there.
    """

    kind: Kind
    places: tuple[str, ...]

    @property
    def severity(self) -> Severity:
        """How much it matters."""
        return self.kind.severity

    def where(self, most: int = _PLACES_SHOWN) -> str:
        """Return the first places on one line, and how many more there are."""
        hidden = len(self.places) - most
        shown = "; ".join(self.places[:most])
        if len(shown) > _LETTERS_SHOWN:
            shown = f"{shown[:_LETTERS_SHOWN]} ..."
        return f"{shown}; and {hidden} more" if hidden > 0 else shown

    def __str__(self) -> str:
        remedy = f" ({self.kind.remedy})" if self.kind.remedy else ""
        where = f": {self.where()}" if self.places else ""
        return f"{self.kind.message}{where}{remedy}"


class Findings:
    """Defects as they are found; several of one kind become one."""

    def __init__(self) -> None:
        self._places: dict[Kind, list[str]] = {}

    def add(self, kind: Kind, place: str = "") -> None:
        """Note a defect, and where it is."""
        places = self._places.setdefault(kind, [])
        if place:
            places.append(place)

    def defects(self) -> tuple[Defect, ...]:
        """Return the defects, the worst first."""
        return tuple(sorted(self, key=lambda defect: list(Severity).index(defect.severity)))

    def __iter__(self) -> Iterator[Defect]:
        for kind, places in self._places.items():
            yield Defect(kind, tuple(places))


_ERROR, _WARNING, _NOTE = Severity.ERROR, Severity.WARNING, Severity.NOTE

REPAIRED = Kind("repaired", _WARNING, "the description departs from the standard but was understood")
UNKNOWN_VERSION = Kind(
    "unknown-version", _ERROR, "the FMI version is not one that can run here", "1.0, 2.0 and 3.0 can"
)
NO_INTERFACE = Kind(
    "no-interface",
    _ERROR,
    "neither Co-Simulation nor Model Exchange",
    "export the FMU again with one of them",
)
BAD_EXPERIMENT = Kind("bad-experiment", _NOTE, "a default experiment that cannot be", "it is ignored")
NO_VARIABLES = Kind("no-variables", _ERROR, "none of the variables can be understood")
NO_NAME = Kind("no-name", _WARNING, "variables without a name", "they cannot be used")
DUPLICATE_NAME = Kind(
    "duplicate-name", _WARNING, "several variables of one name", "only the last of each is used"
)
NO_TYPE = Kind(
    "no-type", _WARNING, "variables without a type that the FMI version has", "they cannot be used"
)
BAD_REFERENCE = Kind(
    "bad-reference", _WARNING, "value references that are not integers", "these variables cannot be used"
)
BAD_DIMENSION = Kind("bad-dimension", _WARNING, "arrays without a usable size", "they cannot be used")
HUGE_ARRAY = Kind("huge-array", _ERROR, "an array that would not fit into memory")
UNKNOWN_CAUSALITY = Kind(
    "unknown-causality", _WARNING, "causalities that the standard does not know", "they are read as local"
)
UNKNOWN_VARIABILITY = Kind(
    "unknown-variability", _WARNING, "variabilities that the standard does not know", "they are ignored"
)
BAD_COMBINATION = Kind(
    "bad-combination", _WARNING, "causality and variability that do not go together (FMI 2.0, section 2.2.7)"
)
UNKNOWN_TYPE = Kind("unknown-type", _WARNING, "declared types that are not defined", "they are ignored")
UNKNOWN_DISPLAY_UNIT = Kind(
    "unknown-display-unit", _NOTE, "display units that the FMU does not define for the unit", "not used"
)
NOT_A_NUMBER = Kind("not-a-number", _WARNING, "attributes that should be numbers", "they are ignored")
NO_START = Kind(
    "no-start",
    _WARNING,
    "inputs or parameters without a start value",
    "0 is shown; the FMU's own value holds",
)
BAD_STRUCTURE = Kind(
    "bad-structure", _WARNING, "the model structure refers to variables that do not exist", "that is ignored"
)
BAD_DEPENDENCY = Kind(
    "bad-dependency",
    _WARNING,
    "dependencies in the model structure on variables that do not exist",
    "the dependent variable may follow any input",
)
UNTICKED_CLOCK = Kind(
    "unticked-clock",
    _WARNING,
    "input clocks that do not tick here",
    "only clocks with a constant interval do, and in Co-Simulation only those of FMUs with an event mode",
)
BAD_DERIVATIVE = Kind(
    "bad-derivative", _WARNING, "derivatives of variables that do not exist", "the states are not known"
)
