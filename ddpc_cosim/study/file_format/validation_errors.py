"""Validation errors of a study file: found all at once, in the user's words, each with its place."""

import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple, ParamSpec, Self, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    ModelWrapValidatorHandler,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    field_validator,
    model_validator,
)

from ddpc_cosim.errors import Place
from ddpc_cosim.plugins import name_in_file
from fmu_plants.spelling import did_you_mean, nearest

_EXPECTED = {
    "bool": "true or false",
    "dict": "a table",
    "float": "a number",
    "int": "an integer",
    "list": "a list",
    "model": "a table",
    "string": "a string",
}
_NAME_RULE = "be letters, digits, dots, hyphens and underscores, the first one a letter or digit"
_LONGEST_VALUE = 100
_MISSING = object()


class InvalidFieldError(Exception):
    """A field of a section has no valid value, and that has been reported."""


def in_folder(folder: Path, path: str) -> Path:
    """Return a path that a file in a folder gives, absolute and in the letters of this locale."""
    if sys.getfilesystemencoding() != "utf-8":
        path = os.fsdecode(path.encode("utf-8", "surrogateescape"))
    try:
        return (folder / path).resolve()
    except ValueError:  # no file can be called so: it is told where it is looked for
        return folder / path


def _absolute(path: str, info: ValidationInfo) -> str:
    if "\0" in path:
        raise ValueError("must be the path of a file, which has no null character")
    return str(in_folder(info.context, path)) if path and isinstance(info.context, Path) else path


def plant_in_folder(folder: Path, name: str) -> str:
    """Return the name of a plant that a file in a folder gives: ``file.py:MODEL`` with an absolute path."""
    return name_in_file(name, lambda file: in_folder(folder, file))


def _absolute_in_file(name: str, info: ValidationInfo) -> str:
    return plant_in_folder(info.context, name) if isinstance(info.context, Path) else name


PlantName = Annotated[str, AfterValidator(_absolute_in_file)]
"""The name of a plant that a file gives; the path of ``file.py:MODEL`` is absolute when it has been read."""

FilePath = Annotated[str, AfterValidator(_absolute)]
"""A path that a file gives relative to its own folder; absolute when it has been read."""


class _Invalid(NamedTuple):
    """A field's value with errors: what is sound of it, and the errors."""

    sound_part: Any
    errors: dict[Place, str]
    doubtful: list[Place]


class Section(BaseModel):
    """A section of a study file: unknown keys are errors, values do not change after reading.

    Read by :func:`parse`, a section with errors holds what is sound. Reading a required field that is not
    raises InvalidFieldError, so that what depends on it can be skipped, and nothing else; an optional one has
    its default, and its place is in doubt.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)
    moved: ClassVar[Mapping[str, str]] = {}
    """Keys that the section had once, and which ones stand for them now."""
    _errors: dict[Place, str] = {}
    _doubtful: tuple[Place, ...] = ()

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield how values contradict each other: the key (empty: the section), and what is wrong."""
        yield from ()

    def fill_in_defaults(self) -> None:
        """Give each optional field that is invalid its default."""
        for key, field in type(self).model_fields.items():
            if key not in self.__dict__ and not field.is_required():
                self.__dict__[key] = field.get_default(call_default_factory=True)

    @model_validator(mode="wrap")
    @classmethod
    def _keep_what_is_sound(
        cls, data: Any, handler: ModelWrapValidatorHandler[Self], info: ValidationInfo
    ) -> Self:
        if not isinstance(info.context, Path) or not isinstance(data, dict):
            return handler(data)
        fields = cls.model_fields
        unknown = [key for key in data if key not in fields]
        missing = [key for key, field in fields.items() if field.is_required() and key not in data]
        meant = [near for key in unknown if (near := nearest(key, fields)) and near not in data]
        known = {key: value for key, value in data.items() if key in fields}
        section = handler(known | dict.fromkeys(missing, _MISSING))
        errors: dict[Place, str] = {(key,): f"unknown key; {cls._hint(key)}" for key in unknown}
        errors |= {(key,): "required key is missing" for key in missing if key not in meant}
        doubtful: set[Place] = {(key,) for key in (*missing, *meant)}
        for key, value in section.__dict__.items():
            if isinstance(value, _Invalid):
                section.__dict__[key] = value.sound_part
                errors |= {(key, *place): error for place, error in value.errors.items()}
                doubtful |= {(key, *place) for place in value.doubtful}
        for key in [key for key in section.__dict__ if (key,) in doubtful]:
            del section.__dict__[key]
        section._errors, section._doubtful = errors, tuple(doubtful)
        return section

    @classmethod
    def _hint(cls, key: str) -> str:
        return f"use {cls.moved[key]}" if key in cls.moved else did_you_mean(key, cls.model_fields)

    @field_validator("*", mode="wrap")
    @classmethod
    def _note_errors(cls, value: Any, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
        if not isinstance(info.context, Path):
            return handler(value)
        if value is _MISSING:
            return value
        try:
            return handler(value)
        except ValidationError as error:
            found = error.errors(include_url=False)
        errors = _in_words(value, found)
        sound_part = _without(value, found)
        with suppress(ValidationError):
            if sound_part is not _MISSING:
                return _Invalid(handler(sound_part), errors, [place[:1] for place in errors])
        return _Invalid(_MISSING, errors, [()])

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            if name in type(self).model_fields:
                raise InvalidFieldError(name)
            return super().__getattr__(name)


P = ParamSpec("P")
R = TypeVar("R")


def independent(check: Callable[P, R]) -> Callable[P, R | None]:
    """Make a check of a study end without a result where it comes upon an invalid field."""

    @wraps(check)
    def checked(*args: P.args, **kwargs: P.kwargs) -> R | None:
        try:
            return check(*args, **kwargs)
        except InvalidFieldError:
            return None

    return checked


class ValidationErrors:
    """The errors found so far, and the places of the file about which nothing more can be said.

    Attributes
    ----------
    found : dict of Place to list of str
        Where, and what is wrong.
    """

    def __init__(self) -> None:
        self.found: dict[Place, list[str]] = {}
        self._doubtful: set[Place] = set()

    def add(self, place: Place, error: str, *depends_on: Place) -> None:
        """Report an error, once, unless it only follows from another one.

        Parameters
        ----------
        place : tuple
            The keys that lead to it.
        error : str
            What is wrong and what to do.
        *depends_on : tuple
            Other places that it depends on: if one is in doubt, nothing is known here.
        """
        within_doubt = any(place[:n] in self._doubtful for n in range(len(place) + 1))
        if not within_doubt and not any(map(self.in_doubt, depends_on)):
            reported = self.found.setdefault(place, [])
            reported += [error] if error not in reported else []

    def doubt(self, place: Place) -> None:
        """Take note that a place has no value that can be relied on."""
        self._doubtful.add(place)

    def in_doubt(self, place: Place) -> bool:
        """Whether a place, one above it or one below it has no value that can be relied on."""
        return any(place[: len(doubt)] == doubt[: len(place)] for doubt in self._doubtful)

    def require_known(
        self, place: Place, what: str, given: Iterable[str], known: Iterable[str], *depends_on: Place
    ) -> None:
        """Report each given name that is not known; the one it probably stands for is in doubt then."""
        known = list(known)
        for name in given:
            if name not in known:
                self.add(place, f'no {what} "{name}"; {did_you_mean(name, known)}', *depends_on)
                self.doubt((*place, nearest(name, known) or name))


S = TypeVar("S", bound=Section)


def parse(model: type[S], data: dict[str, Any], folder: Path, errors: ValidationErrors) -> S:
    """Return the sections of a file in a folder, in which what is invalid is left out and reported."""
    value = model.model_validate(data, context=folder)
    _collect((), value, errors)
    return value


def _collect(place: Place, value: Any, errors: ValidationErrors) -> None:
    """Report the errors of all sections, and how their values contradict each other."""
    if isinstance(value, Section):
        for below, error in value._errors.items():
            errors.add((*place, *below), error)
        for below in value._doubtful:
            errors.doubt((*place, *below))
        with suppress(InvalidFieldError):
            for key, error in value.cross_field_errors():
                errors.add((*place, key) if key else place, error)
        if value._doubtful:
            value.fill_in_defaults()
        value = value.__dict__
    if isinstance(value, dict | list):
        entries: Iterable[Any] = value.items() if isinstance(value, dict) else enumerate(value)
        for key, item in entries:
            if isinstance(item, Section | dict | list):
                _collect((*place, key), item, errors)


def _without(value: Any, found: Sequence[Any]) -> Any:
    """Return a table without its invalid entries, a list of tables with empty ones in their place."""
    keys = {error["loc"][0] for error in found if error["loc"]}
    if isinstance(value, dict):
        return {key: item for key, item in value.items() if key not in keys}
    if isinstance(value, list) and all(error["type"] in ("model_type", "dict_type") for error in found):
        return [{} if i in keys else item for i, item in enumerate(value)]
    return _MISSING


def _in_words(value: Any, found: Sequence[Any]) -> dict[Place, str]:
    """Return what is wrong with each place of a value; of alternatives, all that would be possible."""
    at_place: dict[Place, list[Any]] = {}
    for error in found:
        at_place.setdefault(_place(value, error["loc"]), []).append(error)
    return {place: _message(errors) for place, errors in at_place.items()}


def _place(value: Any, location: Place) -> Place:
    """Return a location without what names alternatives of a type instead of keys of the file."""
    place: list[int | str] = []
    for key in location:
        in_list = isinstance(value, list) and isinstance(key, int) and key < len(value)
        if in_list or (isinstance(value, dict) and key in value):
            place.append(key)
            value = value[key]
    return tuple(place)


def _message(errors: Sequence[Any]) -> str:
    kind, value, context = errors[0]["type"], errors[0]["input"], errors[0].get("ctx", {})
    if kind == "value_error":
        return str(context["error"])
    if kind in ("literal_error", "union_tag_invalid"):
        allowed = context.get("expected") or context.get("expected_tags")
        return f"must be one of {allowed}, got {_shown(context.get('tag', value))}"
    if kind == "union_tag_not_found":
        missing = 'required key "kind" is missing'
        return missing if isinstance(value, dict) else f"must be a table, got {_shown(value)}"
    if kind == "too_short":
        return "must not be empty"
    if kind == "string_pattern_mismatch":
        return f"must {_NAME_RULE}, got {_shown(value)}"
    expected = [_expected(error) for error in errors]
    if all(expected) and kind.endswith(("_type", "_parsing", "_from_float")):
        return f"must be {' or '.join(expected)}, got {_shown(value)}"
    # Of alternatives, the one whose type fits and whose value does not: infinity is a number.
    message = next((error["msg"] for error, words in zip(errors, expected, strict=True) if not words), None)
    message = re.sub(r"^[A-Z][a-z]+ should ", "", message or errors[0]["msg"])
    return f"must {message}, got {_shown(value)}"


def _expected(error: Any) -> str:
    """Return what a value would have to be, if its type is wrong."""
    if error["type"] == "literal_error":
        return str(error["ctx"]["expected"])
    return _EXPECTED.get(error["type"].split("_")[0], "")


def _shown(value: Any) -> str:
    """Return a value as a message can show it."""
    text = repr(value)
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."
