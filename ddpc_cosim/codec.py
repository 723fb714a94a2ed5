"""Tables of a file as objects and back, by what the fields of their classes declare with ``setting()``."""

import dataclasses
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, partial, wraps
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    ParamSpec,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from ddpc_cosim.errors import ConfigError, Place, dotted
from ddpc_cosim.files.durations import EXPECTED as DURATION, seconds_of
from ddpc_cosim.plugins import name_in_file
from ddpc_cosim.settings import SettingInfo, setting_of
from fmu_plants.spelling import did_you_mean, nearest

_EXPECTED: dict[Any, str] = {bool: "true or false", int: "an integer", float: "a number", str: "a string"}
_LONGEST_VALUE = 100
_MISSING = object()
KIND = "kind"
"""The key by which a table says which of several classes it is of, where these have no ``kind_key``."""


@dataclass(frozen=True, slots=True)
class Rule:
    """What a value of an ``Annotated`` type must be besides.

    Parameters
    ----------
    check : callable
        Returns what takes the place of a value; raises ValueError: what is wrong with it.
    schema : mapping
        The same as JSON Schema, as far as that can say it.
    """

    check: Callable[[Any], Any]
    schema: Mapping[str, Any] = field(default_factory=dict, hash=False)


@dataclass(frozen=True, slots=True)
class Prepared:
    """How a value of an ``Annotated`` type may be written otherwise.

    Parameters
    ----------
    prepare : callable
        Returns what is meant; raises ValueError: what is wrong with it.
    schema : mapping
        The other ways as JSON Schema.
    """

    prepare: Callable[[Any], Any]
    schema: Mapping[str, Any] = field(default_factory=dict, hash=False)


@dataclass(frozen=True, slots=True)
class Size:
    """How many entries a list or a table of an ``Annotated`` type has, or letters a text."""

    least: int = 0
    most: int | None = None

    def error(self, value: Any) -> str:
        """Return what is wrong with the number of a value's entries; empty if nothing is."""
        if self.most is not None and len(value) > self.most:
            return f"must have at most {self.most} items, got {shown(value)}"
        if len(value) >= self.least:
            return ""
        if isinstance(value, str):
            return f"must have at least {self.least} character, got {shown(value)}"
        return "must not be empty" if self.least == 1 else f"must have {self.least} items, got {shown(value)}"


@dataclass(frozen=True, slots=True)
class Kinds:
    """The classes that a table of an ``Annotated`` type may be of, by its key ``kind``, and the default.

    ``marked``: those that a table is of, whatever else it says, if it has a key.
    """

    classes: Mapping[str, type[Any]] = field(hash=False)
    default: str = ""
    marked: Mapping[str, type[Any]] = field(default_factory=dict, hash=False)

    @property
    def key(self) -> str:
        """The key by which a table says of which class it is."""
        return kind_key(next(iter(self.classes.values())))

    def meant_by(self, table: Any) -> Sequence[type[Any]]:
        """Return the class that a table names; all of them where it names none, as a part of a table does."""
        if (marked := self.marked_in(table)) is not None:
            return [marked]
        name = table.get(self.key) if isinstance(table, dict) else None
        return [kind for known, kind in self.classes.items() if name in (None, known)]

    def marked_in(self, table: Any) -> type[Any] | None:
        """Return the class of which a table has the key; None if it has no such key."""
        return next(
            (kind for key, kind in self.marked.items() if isinstance(table, dict) and key in table), None
        )


class InvalidFieldError(Exception):
    """A field of a section has no valid value, and that has been reported."""


class Section:
    """A table of a file as a dataclass: unknown keys are errors, values do not change after reading.

    Read with :class:`ValidationErrors` to add to, a section that has some holds what is sound. Reading a
    required field that is not raises InvalidFieldError, so that what depends on it can be skipped, and
    nothing else; an optional one has its default, and its place is in doubt.
    """

    moved: ClassVar[Mapping[str, str]] = {}
    """Keys that the section had once, and which ones stand for them now."""
    has_faults = False
    """Whether one of its fields is invalid."""

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield how values contradict each other: the key (empty: the section), and what is wrong."""
        yield from ()

    @classmethod
    def more_fields(cls) -> Mapping[str, "DeclaredField"]:
        """Return the fields that others declare, by their keys: they are held by a dict of the section."""
        return {}

    @classmethod
    def with_names(cls, table: dict[str, Any], change: "ChangeName") -> dict[str, Any]:
        """Return a table of a file with names of files and plants changed where no field declares them."""
        return table

    @classmethod
    def hint(cls, key: str) -> str:
        """Return what an unknown key probably stands for."""
        return f"use {cls.moved[key]}" if key in cls.moved else did_you_mean(key, known_keys(cls))

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            if name in getattr(type(self), "__dataclass_fields__", {}):
                raise InvalidFieldError(name)
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")


class DeclaredField(NamedTuple):
    """A field of a class that a file can say.

    Parameters
    ----------
    name : str
        Its name in Python.
    hint : object
        Its type.
    info : SettingInfo
        What :func:`ddpc_cosim.setting` declares.
    is_required : bool
        Whether a file has to say it.
    default : callable
        Makes its default.
    within : str
        The name of the dict that holds it, of a field that others declare; empty: it is an attribute.
    """

    name: str
    hint: Any
    info: SettingInfo
    is_required: bool
    default: Callable[[], Any]
    within: str = ""

    def of(self, section: Any) -> Any:
        """Return what an object holds."""
        if self.within:
            return getattr(section, self.within).get(self.name, self.default())
        return getattr(section, self.name)

    def put(self, section: Any, value: Any) -> None:
        """Make an object that is being read hold a value."""
        if self.within and value != self.default():
            getattr(section, self.within)[self.name] = value
        elif not self.within:
            object.__setattr__(section, self.name, value)


def declared_fields(kind: Any) -> Mapping[str, DeclaredField]:
    """Return the fields of a class that are declared with ``setting()``, by their keys in a file."""
    more = kind.more_fields() if hasattr(kind, "more_fields") else {}
    return {**_declared_fields(kind), **more}


@cache
def _declared_fields(kind: Any) -> Mapping[str, DeclaredField]:
    hints = get_type_hints(kind, include_extras=True)
    declared = {}
    for attribute in dataclasses.fields(kind):
        info = setting_of(attribute)
        if info is not None and info.key is not None:
            factory: Any = partial(_itself, attribute.default)
            if attribute.default_factory is not dataclasses.MISSING:
                factory = attribute.default_factory
            required = info.required or attribute.default is attribute.default_factory is dataclasses.MISSING
            hint = info.written or hints[attribute.name]
            declared[info.key or attribute.name] = DeclaredField(
                attribute.name, hint, info, required, factory
            )
    return declared


def known_keys(kind: Any) -> tuple[str, ...]:
    """Return the keys that a table of a class may have."""
    return (*filter(None, [kind_key(kind)]), *declared_fields(kind))


def kind_key(kind: Any) -> str:
    """Return the key by which a table says that it is of a class; empty: of that it says nothing."""
    return str(getattr(kind, "kind_key", KIND)) if hasattr(kind, KIND) else ""


def _itself(value: Any) -> Any:
    return value


P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


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
            Other places that it depends on: if one is in doubt, the error is not reported.
        """
        within_doubt = any(place[:n] in self._doubtful for n in range(len(place) + 1))
        if not within_doubt and not any(map(self.in_doubt, depends_on)):
            reported = self.found.setdefault(place, [])
            reported += [error] if error not in reported else []

    def listed(self) -> list[str]:
        """Return the errors with their places, as messages about what is not in a file say them."""
        every = ((place, error) for place, errors in self.found.items() for error in errors)
        return [f"{dotted(place)}: {error}" if place else error for place, error in every]

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


def in_folder(folder: Path, path: str) -> Path:
    """Return a path that a file in a folder gives, absolute and in the letters of this locale."""
    if sys.getfilesystemencoding() != "utf-8":
        path = os.fsdecode(path.encode("utf-8", "surrogateescape"))
    try:
        return (folder / path).resolve()
    except ValueError:  # a file cannot have this name: reported where the file is opened
        return folder / path


def plant_in_folder(folder: Path, name: str) -> str:
    """Return the name of a plant that a file in a folder gives: ``file.py:MODEL`` with an absolute path."""
    return name_in_file(name, lambda file: in_folder(folder, file))


def read(kind: type[T], table: Mapping[str, Any]) -> T:
    """Return the object that a table stands for, as it is: its paths, and how its values fit together.

    Raises
    ------
    ConfigError
        All that is wrong with its fields, each fault with its place.
    """
    errors = ValidationErrors()
    reader = _Reader(None, errors)
    value = reader.section(kind, dict(table), ())
    reader.complete()
    if errors.found:
        raise ConfigError(errors.listed())
    return cast("T", value)


def read_in(kind: type[T], table: Mapping[str, Any], folder: Path | None, errors: ValidationErrors) -> T:
    """Return the object that a table of a file in a folder stands for; what is invalid in it is reported."""
    reader = _Reader(folder, errors)
    value = reader.section(kind, dict(table), ())
    reader.finish()
    return cast("T", value)


def write(value: Any, *, in_short: bool = False) -> Any:
    """Return an object as the table that :func:`read` makes it of; what is None is left out.

    Parameters
    ----------
    value : object
        A section, a signal, or a value that these hold.
    in_short : bool
        Whether defaults are left out too, in all that it holds.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        entries = _entries(value, in_short=in_short)
        return _kind_in(value) | {key: write(held, in_short=in_short) for key, held in entries}
    if isinstance(value, Mapping):
        return {key: write(held, in_short=in_short) for key, held in value.items() if held is not None}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [write(item, in_short=in_short) for item in value]
    return value


def _entries(value: Any, *, in_short: bool) -> Iterator[tuple[str, Any]]:
    """Yield the values of an object by their keys, as far as a file can say them; in short: and has to."""
    for key, declared in declared_fields(type(value)).items():
        held = declared.of(value)
        if in_short and not declared.is_required and _equal(held, declared.default()):
            continue
        if declared.within and held == declared.default():
            continue  # what is not installed elsewhere is not named there
        is_unsaid = isinstance(held, float) and math.isinf(held) and not declared.info.infinite
        if held is not None and not is_unsaid:
            yield key, held


def differing(value: Any) -> dict[str, Any]:
    """Return the fields of an object that are not their defaults, by their keys, in plain values."""
    return {key: write(held) for key, held in _entries(value, in_short=True)}


def write_in_short(value: Any) -> dict[str, Any]:
    """Return an object as the shortest table that :func:`read` makes it of: without what are defaults."""
    table: dict[str, Any] = write(value, in_short=True)
    return table


def _kind_in(value: Any) -> dict[str, Any]:
    return {kind_key(value): value.kind} if hasattr(value, KIND) else {}


def _equal(value: Any, other: Any) -> bool:
    return bool(np.array_equal(value, other)) if isinstance(value, np.ndarray) else bool(value == other)


ChangeName = Callable[[SettingInfo, str], str]
"""Returns what takes the place of a name, of a file or plant, given what is declared of it."""
_NOTHING_DECLARED = SettingInfo("")


def with_names(hint: Any, value: Any, change: ChangeName, info: SettingInfo = _NOTHING_DECLARED) -> Any:
    """Return unchecked values of a type from a file, with each name of a file or plant changed.

    Parameters
    ----------
    hint : object
        The type.
    value : object
        What the file says; of a place in it perhaps a list of values that a sweep tries.
    change : ChangeName
        Called with each name.
    info : SettingInfo
        What is declared of the value.
    """
    origin, arguments = get_origin(hint), get_args(hint)
    if isinstance(value, str):
        return change(info, value) if info.file or info.plant else value
    if origin is Annotated:
        kinds = next((argument for argument in arguments if isinstance(argument, Kinds)), None)
        if kinds and isinstance(value, list):
            return [with_names(hint, item, change, info) for item in value]
        for kind in kinds.meant_by(value) if kinds else arguments[:1]:
            value = with_names(kind, value, change, info)
        return value
    if isinstance(value, list):
        entry = arguments[0] if origin in (list, Sequence) else hint
        return [with_names(entry, item, change, info) for item in value]
    if not isinstance(value, dict):
        return value
    if origin in (Union, UnionType):
        for argument in arguments:
            value = with_names(argument, value, change, info)
    elif origin in (list, Sequence):  # one table for several, or entries by their numbers
        if not all(map(str.isdecimal, value)):
            return with_names(arguments[0], value, change, info)
        return {key: with_names(arguments[0], item, change, info) for key, item in value.items()}
    elif origin in (dict, Mapping):
        return {key: with_names(arguments[1], item, change, info) for key, item in value.items()}
    elif isinstance(hint, type) and dataclasses.is_dataclass(hint):
        known = declared_fields(hint)
        value = {
            key: with_names(known[key].hint, item, change, known[key].info) if key in known else item
            for key, item in value.items()
        }
        return hint.with_names(value, change) if issubclass(hint, Section) else value
    return value


class _Fault(NamedTuple):
    """What is wrong with a place; ``expected``: what would have to be there, if it is the type."""

    place: Place
    error: str
    expected: str = ""


class _WrongValueError(Exception):
    """A value of a field is wrong."""

    def __init__(self, *faults: _Fault) -> None:
        super().__init__()
        self.faults = faults


def _wrong_type(place: Place, value: Any, *expected: str) -> _WrongValueError:
    words = " or ".join(expected)
    return _WrongValueError(_Fault(place, f"must be {words}, got {shown(value)}", words))


class _Reader:
    """Reads tables of a file in a folder; what is wrong is added to errors."""

    def __init__(self, folder: Path | None, errors: ValidationErrors) -> None:
        self._folder, self._errors = folder, errors
        self._read: list[tuple[Place, Any, bool]] = []  # sections, the outer ones first

    def section(self, kind: type[Any], table: dict[str, Any], place: Place) -> Any:
        """Return the object of a table, which holds what is sound."""
        fields = declared_fields(kind)
        known = known_keys(kind)
        unknown = [key for key in table if key not in known]
        missing = [key for key, declared in fields.items() if declared.is_required and key not in table]
        meant = [near for key in unknown if (near := nearest(key, known)) and near not in table]
        faults = {(*place, key): f"unknown key; {_hint(kind, key)}" for key in unknown}
        faults |= {(*place, key): "required key is missing" for key in missing if key not in meant}
        for at, error in faults.items():
            self._errors.add(at, error)
        doubtful = {*missing, *meant}
        for key in doubtful:
            self._errors.doubt((*place, key))
        section = object.__new__(kind)
        for other in dataclasses.fields(kind):  # what a file does not say
            info = setting_of(other)
            if info is not None and info.key is not None:
                continue
            if other.default is not dataclasses.MISSING:
                object.__setattr__(section, other.name, other.default)
            elif other.default_factory is not dataclasses.MISSING:
                object.__setattr__(section, other.name, other.default_factory())
        number = len(self._read)
        self._read.append((place, section, False))
        is_sound = not faults
        for key, declared in fields.items():
            if key in doubtful:
                continue
            if key not in table:
                declared.put(section, declared.default())
                continue
            value, is_valid = self._field(declared, table[key], (*place, key))
            is_sound = is_sound and is_valid
            if value is _MISSING:
                doubtful.add(key)
            else:
                declared.put(section, value)
        if not is_sound:
            object.__setattr__(section, "has_faults", True)
        self._read[number] = (place, section, bool(doubtful) or not is_sound)
        return section

    def finish(self) -> None:
        """Report how values of sections contradict each other, and fill in defaults for what is invalid."""
        for place, section, is_doubtful in self._read:
            with suppress(InvalidFieldError):
                for key, error in _contradictions(section):
                    self._errors.add((*place, key) if key else place, error)
            if is_doubtful:
                for entry in declared_fields(type(section)).values():
                    if not (entry.is_required or _is_set(partial(entry.of, section))):
                        entry.put(section, entry.default())
        self.complete()

    def complete(self) -> None:
        """Set fields without a value that files cannot say to None, such as an excitation's samples."""
        for _, section, _ in self._read:
            for declared in dataclasses.fields(section):
                info = setting_of(declared)
                is_said = info is None or info.key is not None
                if not (is_said or _is_set(partial(getattr, section, declared.name))):
                    object.__setattr__(section, declared.name, None)

    def _field(self, declared: DeclaredField, value: Any, place: Place) -> tuple[Any, bool]:
        """Return what is sound of a field's value, and whether all of it is; what is not is reported."""
        try:
            return self.value(declared.hint, declared.info, value, place), True
        except _WrongValueError as error:
            wrong = error.faults
        for at, message in _at_each_place(wrong).items():
            self._errors.add(at, message)
        sound = _without(value, wrong, place)
        with suppress(_WrongValueError):
            if sound is not _MISSING:
                for fault in wrong:
                    self._errors.doubt(fault.place[: len(place) + 1])
                return self.value(declared.hint, declared.info, sound, place), False
        self._errors.doubt(place)
        return _MISSING, False

    def value(self, hint: Any, info: SettingInfo, value: Any, place: Place) -> Any:
        """Return the value that a table's entry stands for."""
        origin, arguments = get_origin(hint), get_args(hint)
        if origin is Annotated:
            return self._annotated(arguments[0], arguments[1:], info, value, place)
        if origin in (Union, UnionType):
            return self._of_union(arguments, info, value, place)
        if origin is Literal:
            if not any(type(value) is type(allowed) and value == allowed for allowed in arguments):
                listed = _listed(arguments)
                fault = _Fault(place, f"must be one of {listed}, got {shown(value)}", listed)
                raise _WrongValueError(fault)
            return value
        if origin in (dict, Mapping):
            return self._table(arguments, info, value, place)
        if origin in (list, Sequence):
            if not isinstance(value, list | tuple):
                raise _wrong_type(place, value, "a list")
            entries = [(i, arguments[0], item) for i, item in enumerate(value)]
            return self._each(list if origin is list else tuple, entries, info, place)
        if dataclasses.is_dataclass(hint):
            if not isinstance(value, dict):
                raise _wrong_type(place, value, "a table")
            return self.section(cast("type[Any]", hint), value, place)
        return value if hint is Any else self._scalar(hint, info, value, place)

    def _annotated(
        self, hint: Any, metadata: Sequence[Any], info: SettingInfo, value: Any, place: Place
    ) -> Any:
        said = value
        for note in metadata:
            if isinstance(note, Prepared):
                value = _checked(note.prepare, value, place)
        try:
            return self._prepared(hint, metadata, info, value, place)
        except _WrongValueError as error:
            if isinstance(said, dict) and isinstance(value, list):  # the only one, which stands for a list
                depth = len(place)
                faults = [f._replace(place=(*f.place[:depth], *f.place[depth + 1 :])) for f in error.faults]
                raise _WrongValueError(*faults) from error
            raise

    def _prepared(
        self, hint: Any, metadata: Sequence[Any], info: SettingInfo, value: Any, place: Place
    ) -> Any:
        for note in metadata:
            if isinstance(note, Kinds):
                return self.section(_kind_of(note, value, place), value, place)
        value = self.value(hint, info, value, place)
        for note in metadata:
            if isinstance(note, Size) and (error := note.error(value)):
                raise _WrongValueError(_Fault(place, error))
            if isinstance(note, Rule):
                value = _checked(note.check, value, place)
        return value

    def _of_union(self, hints: Sequence[Any], info: SettingInfo, value: Any, place: Place) -> Any:
        """Return the value by the first type that it fits; what is wrong by the one whose type it has."""
        if value is None and NoneType in hints:
            return None
        wrong = list[Sequence[_Fault]]()
        for hint in hints:
            if hint is NoneType:
                continue
            try:
                return self.value(hint, info, value, place)
            except _WrongValueError as error:
                wrong.append(error.faults)
        of_type = [faults for faults in wrong if not (faults[0].place == place and faults[0].expected)]
        if of_type or len(wrong) == 1:
            raise _WrongValueError(*(of_type or wrong)[0])
        raise _wrong_type(place, value, *(faults[0].expected for faults in wrong))

    def _table(self, hints: Sequence[Any], info: SettingInfo, value: Any, place: Place) -> Any:
        if not isinstance(value, dict):
            raise _wrong_type(place, value, "a table")
        wrong = list[_Fault]()
        for key in value:
            try:
                self.value(hints[0], _ANY, key, (*place, key))
            except _WrongValueError as error:
                wrong += error.faults
        sound = [
            (key, hints[1], item)
            for key, item in value.items()
            if (*place, key) not in {f.place for f in wrong}
        ]
        try:
            read = self._each(dict, sound, info, place)
        except _WrongValueError as error:
            wrong += error.faults
        if wrong:
            raise _WrongValueError(*wrong)
        return read

    def _each(
        self, kind: Any, entries: Sequence[tuple[Any, Any, Any]], info: SettingInfo, place: Place
    ) -> Any:
        """Return the values of a list's or a table's entries, each of which has a key and a type."""
        values, wrong = dict[Any, Any](), list[_Fault]()
        for key, hint, item in entries:
            try:
                values[key] = self.value(hint, info, item, (*place, key))
            except _WrongValueError as error:
                wrong += error.faults
        if wrong:
            raise _WrongValueError(*wrong)
        return values if kind is dict else kind(values.values())

    def _scalar(self, hint: Any, info: SettingInfo, value: Any, place: Place) -> Any:
        expected = DURATION if hint is float and info.unit == "s" else _EXPECTED[hint]
        if expected == DURATION and isinstance(value, str):
            try:
                value = seconds_of(value)
            except ValueError as error:
                raise _wrong_type(place, value, expected) from error
        kind = int if hint is float and isinstance(value, int) else hint
        if not isinstance(value, kind) or (isinstance(value, bool) and hint is not bool):
            raise _wrong_type(place, value, expected)
        if hint in (int, float):
            try:
                needed = info.needed_of(hint(value))
            except OverflowError as error:
                raise _wrong_type(place, value, expected) from error
            if needed:
                raise _WrongValueError(_Fault(place, f"must be {needed}, got {shown(value)}"))
            return hint(value)
        if info.file and isinstance(value, str):
            if "\0" in value:
                needed = "must be the path of a file, which has no null character"
                raise _WrongValueError(_Fault(place, needed))
            return str(in_folder(self._folder, value)) if value and self._folder else value
        if info.plant and isinstance(value, str) and self._folder:
            return plant_in_folder(self._folder, value)
        return value


_ANY = SettingInfo("")


def _contradictions(section: Any) -> Iterator[tuple[str, str]]:
    """Yield how a section's values contradict each other: what it says itself, and why it cannot be made."""
    if isinstance(section, Section):
        yield from section.cross_field_errors()
    if hasattr(type(section), "__post_init__"):
        try:
            section.__post_init__()
        except ConfigError as error:
            yield from (("", fault) for fault in error.faults)


def _is_set(read: Callable[[], Any]) -> bool:
    try:
        read()
    except (AttributeError, InvalidFieldError):
        return False
    return True


def _hint(kind: type[Any], key: str) -> str:
    return kind.hint(key) if issubclass(kind, Section) else did_you_mean(key, known_keys(kind))


def _kind_of(kinds: Kinds, value: Any, place: Place) -> type[Any]:
    """Return the class that a table is of."""
    if not isinstance(value, dict):
        raise _wrong_type(place, value, "a table")
    if (marked := kinds.marked_in(value)) is not None:
        return marked
    name = value.get(kinds.key, kinds.default or None)
    if name is None:
        raise _WrongValueError(_Fault(place, f'required key "{kinds.key}" is missing'))
    if not isinstance(name, str) or name not in kinds.classes:
        listed, near = ", ".join(map(repr, kinds.classes)), nearest(str(name), kinds.classes)
        hint = f'; did you mean "{near}"?' if near else ""
        raise _WrongValueError(_Fault(place, f"must be one of {listed}, got {shown(name)}{hint}"))
    return kinds.classes[name]


def _checked(check: Callable[[Any], Any], value: Any, place: Place) -> Any:
    try:
        return check(value)
    except ValueError as error:
        raise _WrongValueError(_Fault(place, str(error))) from error


def _at_each_place(faults: Iterable[_Fault]) -> dict[Place, str]:
    """Return the first error of each place."""
    errors: dict[Place, str] = {}
    for fault in faults:
        errors.setdefault(fault.place, fault.error)
    return errors


def _without(value: Any, faults: Sequence[_Fault], place: Place) -> Any:
    """Return a table without its invalid entries, a list of tables with empty ones in their place."""
    depth = len(place)
    keys = {fault.place[depth] for fault in faults if len(fault.place) > depth}
    if isinstance(value, dict):
        return {key: item for key, item in value.items() if key not in keys} if keys else _MISSING
    if isinstance(value, list) and all(fault.expected == "a table" for fault in faults):
        return [{} if i in keys else item for i, item in enumerate(value)]
    return _MISSING


def _listed(values: Sequence[Any]) -> str:
    *before, last = map(repr, values)
    return f"{', '.join(before)} or {last}" if before else last


def shown(value: Any) -> str:
    """Return a value as a message can show it."""
    text = repr(value)
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."
