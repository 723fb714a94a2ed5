"""Faults of a study file in the user's words: where, what, and what to do instead."""

import copy
import re
from collections.abc import Iterable, Iterator, Sequence
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from ddpc_cosim.errors import did_you_mean, nearest
from ddpc_cosim.study.sections import Section

Location = tuple[int | str, ...]

_HARMLESS: dict[Any, Any] = {float: 1.0, int: 1, str: "none", bool: False}


def keys_at(model: type[BaseModel], location: Sequence[int | str]) -> list[str]:
    """Return the keys that a section knows, following a location through sections, tables and choices."""
    return [name for section in _sections_at(model, location) for name in section.model_fields]


def stand_in(model: type[BaseModel], place: Location) -> tuple[bool, Any]:
    """Return whether something must stand in a place, and if so, something harmless of the right kind.

    Optional keys of a section and entries of a table can be left out; required keys cannot, nor items of a
    list, whose positions must not change.
    """
    key = place[-1]
    if isinstance(key, int):
        items = _annotations_at(model, place)
        return True, _harmless(items[0] if items else Any)
    for section in _sections_at(model, place[:-1]):
        field = section.model_fields.get(key)
        if field is not None and field.is_required():
            return True, _harmless(field.annotation)
    return False, None


def _sections_at(model: type[BaseModel], location: Sequence[int | str]) -> list[type[BaseModel]]:
    variants = [v for annotation in _annotations_at(model, location) for v in _variants(annotation)]
    return [variant for variant in variants if _is_section(variant)]


def _annotations_at(model: type[BaseModel], location: Sequence[int | str]) -> list[Any]:
    annotations: list[Any] = [model]
    for key in location:
        annotations = [below for annotation in annotations for below in _below(annotation, key)]
    return annotations


def _below(annotation: Any, key: int | str) -> Iterator[Any]:
    """Yield what an annotation holds under a key; the tag of a choice leads to the section it names."""
    for variant in _variants(annotation):
        if get_origin(variant) in (dict, list):
            yield get_args(variant)[-1]
        elif _is_section(variant) and key in variant.model_fields:
            yield variant.model_fields[str(key)].annotation
        elif _is_section(variant) and key == _tag(variant):
            yield variant


def _variants(annotation: Any) -> Iterator[Any]:
    """Yield the alternatives of an annotation, without its metadata."""
    if get_origin(annotation) is Annotated:
        yield from _variants(get_args(annotation)[0])
    elif get_origin(annotation) in (Union, UnionType):
        for argument in get_args(annotation):
            yield from _variants(argument)
    else:
        yield annotation


def _tag(section: Any) -> Any:
    field = section.model_fields.get("kind")
    return get_args(field.annotation)[0] if field else None


def _is_section(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _harmless(annotation: Any) -> Any:
    """Return the plainest value of a kind; lists and tables are not empty, because some must not be."""
    kind = next(_variants(annotation))
    if _is_section(kind):
        return {
            name: _harmless(field.annotation)
            for name, field in kind.model_fields.items()
            if field.is_required()
        }
    if get_origin(kind) is list:
        return [_harmless(get_args(kind)[0])]
    if get_origin(kind) is dict:
        return {"none": _harmless(get_args(kind)[1])}
    if get_origin(kind) is Literal:
        return get_args(kind)[0]
    return _HARMLESS.get(kind)


M = TypeVar("M", bound=Section)

_EXPECTED = {
    "bool": "true or false",
    "dict": "a table",
    "float": "a number",
    "int": "a whole number",
    "list": "a list",
    "model": "a table",
    "string": "a text",
}
_NAME_RULE = "be letters, digits, dots, hyphens and underscores, the first one a letter or digit"
_MAX_ROUNDS = 20
_LONGEST_VALUE = 100


class Faults:
    """The faults found so far, and the places of the file that nothing more can be said about.

    Attributes
    ----------
    listed : list of str
        ``key: what is wrong``.
    """

    def __init__(self) -> None:
        self.listed: list[str] = []
        self._doubtful: list[Location] = []

    def add(self, place: Location, fault: str, *follows_from: Location) -> None:
        """Report a fault, unless it only follows from another one.

        Parameters
        ----------
        place : tuple
            The keys that lead to it.
        fault : str
            What is wrong and what to do.
        *follows_from : tuple
            Other places it rests on: with a fault there, nothing is known here.
        """
        within = any(place[: len(doubt)] == doubt for doubt in self._doubtful)
        if not within and not any(map(self.touches, follows_from)):
            self.listed.append(f"{dotted(place) or 'file'}: {fault}")

    def doubt(self, place: Location) -> None:
        """Take note that a fault has been reported here."""
        self._doubtful.append(place)

    def is_doubtful(self, place: Location) -> bool:
        """Whether a fault has been reported at exactly this place."""
        return place in self._doubtful

    def touches(self, place: Location) -> bool:
        """Whether a fault has been reported here, above or below."""
        return any(place[: len(doubt)] == doubt[: len(place)] for doubt in self._doubtful)

    def require_known(
        self, place: Location, what: str, given: Iterable[str], known: Iterable[str], *follows_from: Location
    ) -> None:
        """Report each given name that is not known; the one it probably stands for is in doubt then."""
        known = list(known)
        for name in given:
            if name not in known:
                self.add(place, f'no {what} "{name}"; {did_you_mean(name, known)}', *follows_from)
                self.doubt((*place, nearest(name, known) or name))


def validate_all(model: type[M], data: dict[str, Any]) -> tuple[M | None, Faults]:
    """Validate data and find all faults.

    A fault hides others: something harmless takes the place of what is at fault, and all is validated again,
    so that later checks can still be made on what is sound.

    Parameters
    ----------
    model : type of Section
        What the data must be.
    data : dict
        What the file holds.

    Returns
    -------
    value : instance of model or None
        The data with its faults replaced, if that makes a whole.
    faults : Faults
        What was found, in the order of the file's sections, and which places were replaced.
    """
    data = copy.deepcopy(data)
    faults = Faults()
    for _ in range(_MAX_ROUNDS):
        try:
            value = model.model_validate(data)
            _find_contradictions((), value, faults)
            return value, faults
        except ValidationError as error:
            found = error.errors(include_url=False)
        places = [_place(data, fault) for fault in found]
        for place, fault in zip(places, found, strict=True):
            if not faults.touches(place) and not _is_misspelt(model, fault, found):
                faults.add(place, _in_words(model, fault))
        for place, fault in dict(zip(places, found, strict=True)).items():
            if not _repair(model, data, place, fault, faults):
                return None, faults
    return None, faults


def _find_contradictions(place: Location, value: Any, faults: Faults) -> None:
    """Report how the values of each section contradict each other, where none of them was replaced."""
    if isinstance(value, Section):
        for fault in value.contradictions():
            faults.add(place, fault, place)
        value = {name: getattr(value, name) for name in type(value).model_fields}
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            _find_contradictions((*place, key), item, faults)


def dotted(place: Location) -> str:
    """Return a place as a study file writes it: ``scenarios.windy.events[0].time``."""
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def _place(data: Any, fault: Any) -> Location:
    """Return where in the data a fault is: its location without what is no key of the data."""
    missing = fault["type"] == "missing"
    place: list[int | str] = []
    for key in fault["loc"][:-1] if missing else fault["loc"]:
        in_list = isinstance(data, list) and isinstance(key, int) and key < len(data)
        if in_list or (isinstance(data, dict) and key in data):
            place.append(key)
            data = data[key]
    return (*place, fault["loc"][-1]) if missing else tuple(place)


def _is_misspelt(model: type[BaseModel], fault: Any, found: Sequence[Any]) -> bool:
    """Whether a missing key is there under a name that will be reported as unknown."""
    *section, key = fault["loc"] or ("",)
    return fault["type"] == "missing" and any(
        other["type"] == "extra_forbidden"
        and list(other["loc"][:-1]) == section
        and nearest(str(other["loc"][-1]), keys_at(model, section)) == key
        for other in found
    )


def _repair(
    model: type[BaseModel], data: dict[str, Any], place: Location, fault: Any, faults: Faults
) -> bool:
    """Put something harmless in the place of what is at fault; return whether that is possible."""
    if fault["type"] == "extra_forbidden":
        _container(data, place).pop(place[-1], None)
        meant = nearest(str(place[-1]), keys_at(model, fault["loc"][:-1]))
        if meant:
            faults.doubt((*place[:-1], meant))
        return True
    while faults.is_doubtful(place):  # what was put there did not help
        place = place[:-1]
    if not place:
        return False
    faults.doubt(place)
    container, key = _container(data, place), place[-1]
    if container is None:  # a repair further up has replaced it in this round
        return True
    found, harmless = stand_in(model, place)
    if found:
        container[key] = harmless
    else:
        container.pop(key, None)
    return True


def _container(data: Any, place: Location) -> Any:
    """Return the table or list that holds a place, None if it is not there any more."""
    for key in place[:-1]:
        try:
            data = data[key]
        except (KeyError, IndexError, TypeError):
            return None
    return data if isinstance(data, dict | list) else None


def _in_words(model: type[BaseModel], fault: Any) -> str:
    kind, value, context = fault["type"], fault["input"], fault.get("ctx", {})
    if kind == "extra_forbidden":
        return f"unknown key; {did_you_mean(str(fault['loc'][-1]), keys_at(model, fault['loc'][:-1]))}"
    if kind == "missing":
        return "required key is missing"
    if kind == "value_error":
        return str(context["error"])
    if kind in ("literal_error", "union_tag_invalid"):
        allowed = context.get("expected") or context.get("expected_tags")
        return f"must be one of {allowed}, got {_got(value, context)}"
    if kind == "union_tag_not_found":
        return 'required key "kind" is missing'
    if kind == "too_short":
        return "must not be empty"
    if kind == "string_pattern_mismatch":
        return f"must {_NAME_RULE}, got {_shown(value)}"
    expected = _EXPECTED.get(kind.split("_")[0])
    if expected and kind.endswith(("_type", "_parsing", "_from_float")):
        return f"must be {expected}, got {_shown(value)}"
    return f"must {re.sub(r'^[A-Z][a-z]+ should ', '', fault['msg'])}, got {_shown(value)}"


def _got(value: Any, context: dict[str, Any]) -> str:
    return _shown(context.get("tag", value))


def _shown(value: Any) -> str:
    """Return a value as a message can show it."""
    text = repr(value)
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."
