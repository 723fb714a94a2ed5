"""Faults of a study file in the user's words: where, what, and what to do instead."""

import copy
from collections.abc import Iterator, Sequence
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError

from ddpc_cosim.suggest import did_you_mean

Location = tuple[int | str, ...]
M = TypeVar("M", bound=BaseModel)

_EXPECTED = {
    "bool": "true or false",
    "dict": "a table",
    "float": "a number",
    "int": "a whole number",
    "list": "a list",
    "model": "a table",
    "string": "a text",
}
_MAX_ROUNDS = 20


def validate_all(model: type[M], data: dict[str, Any]) -> tuple[M | None, list[str]]:
    """Validate data and find all faults.

    A fault hides others: what is at fault is taken out and the rest validated again, so that later checks
    can still be made on what is sound.

    Parameters
    ----------
    model : type of BaseModel
        What the data must be.
    data : dict
        What the file holds.

    Returns
    -------
    value : instance of model or None
        The sound part of the data, if it still makes a whole.
    faults : list of str
        ``key: what is wrong``, in the order of the file's sections.
    """
    data = copy.deepcopy(data)
    faults: list[str] = []
    repaired: list[Location] = []
    for round_number in range(_MAX_ROUNDS):
        try:
            return model.model_validate(data), faults
        except ValidationError as error:
            found = error.errors(include_url=False)
        for fault in found:
            location = _in_data(data, fault["loc"])
            caused_by_repair = any(place[: len(location)] == location for place in repaired)
            if round_number == 0 or (fault["type"] == "value_error" and not caused_by_repair):
                faults.append(f"{_dotted(location, fault)}: {_in_words(model, fault)}")
        if not _take_out(data, found, repaired):
            break
    return None, faults


def _in_data(data: Any, location: Location) -> Location:
    """Drop from a location what is no key of the data: the tags of a choice between sections."""
    place: list[int | str] = []
    for key in location:
        in_list = isinstance(data, list) and isinstance(key, int) and key < len(data)
        if in_list or (isinstance(data, dict) and key in data):
            place.append(key)
            data = data[key]
    return tuple(place)


def _dotted(location: Location, fault: Any) -> str:
    parts = [*location, fault["loc"][-1]] if fault["type"] == "missing" else list(location)
    text = ""
    for part in parts:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text or "file"


def _in_words(model: type[BaseModel], fault: Any) -> str:
    kind, value, context = fault["type"], fault["input"], fault.get("ctx", {})
    if kind == "extra_forbidden":
        return f"unknown key; {did_you_mean(str(fault['loc'][-1]), _keys_at(model, fault['loc'][:-1]))}"
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
    expected = _EXPECTED.get(kind.split("_")[0])
    if expected and kind.endswith(("_type", "_parsing", "_from_float")):
        return f"must be {expected}, got {value!r}"
    message = fault["msg"].removeprefix("Input should be ").removeprefix("String should ")
    return f"must be {message}, got {value!r}"


def _got(value: Any, context: dict[str, Any]) -> str:
    return repr(context["tag"]) if "tag" in context else repr(value)


def _keys_at(model: type[BaseModel], location: Sequence[int | str]) -> list[str]:
    """Return the keys that a section knows, following a location through sections, tables and choices."""
    annotations: list[Any] = [model]
    for key in location:
        annotations = [below for annotation in annotations for below in _below(annotation, key)]
    sections = [v for annotation in annotations for v in _variants(annotation) if _is_section(v)]
    return [name for section in sections for name in section.model_fields]


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


def _take_out(data: dict[str, Any], found: Sequence[Any], repaired: list[Location]) -> bool:
    """Remove what is at fault from the data; return whether anything could be removed."""
    changed = False
    places = {_in_data(data, fault["loc"]): fault["type"] for fault in found}
    # From the back, so that the positions in lists stay valid.
    for place in sorted(places, key=lambda p: tuple(map(str, p)), reverse=True):
        container: Any = data
        for key in place[:-1]:
            container = container[key]
        if place:
            del container[place[-1]]
            changed = True
            if places[place] != "extra_forbidden":
                repaired.append(place)
    return changed
