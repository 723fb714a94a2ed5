"""Finding one's way in the sections of a study file: which keys there are, and what may stand under them."""

from collections.abc import Iterator, Sequence
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

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
