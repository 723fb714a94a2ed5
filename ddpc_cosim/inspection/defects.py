"""Defects of an FMU: what was found, how much it matters, where, and what to do about it."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

_PLACES_SHOWN = 3


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
