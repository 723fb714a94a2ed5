"""Settings of plug-ins: declared once, then checked, listed and documented from the declaration."""

import dataclasses
import hashlib
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, datetime, time
from functools import lru_cache, wraps
from inspect import signature
from numbers import Integral, Real
from pathlib import Path
from typing import Any, ClassVar, ParamSpec, TypeGuard, TypeVar

import numpy as np

from ddpc_cosim.errors import ConfigError, MissingLibraryError, Place, PluginError, dotted
from ddpc_cosim.files.durations import EXPECTED as DURATION, seconds_of
from ddpc_cosim.plugins import load_plugin, load_target
from ddpc_cosim.variables import FloatArray
from fmu_plants.spelling import did_you_mean

Weight = float | Sequence[float] | Sequence[Sequence[float]]
"""A weight: a scalar, one number per signal, or a symmetric matrix."""


class SettingsError(ConfigError):
    """Settings that are unknown or impossible.

    Parameters
    ----------
    found : sequence of (Place, str)
        Each invalid setting, by the keys that lead to it, and what is wrong with its value.
    faults : sequence of str, optional
        The same for readers who do not see the keys.
    """

    def __init__(self, found: Sequence[tuple[Place, str]], faults: Sequence[str] = ()) -> None:
        self.found = tuple(found)
        super().__init__(
            faults or [f"{dotted(place)}: {fault}" if place else fault for place, fault in found]
        )

    def __reduce__(self) -> Any:
        return type(self), (self.found, self.faults)


@dataclass(frozen=True, slots=True)
class Linear:
    """A search space: the numbers from low to high."""

    low: float
    high: float
    above: ClassVar[float] = -math.inf

    def __post_init__(self) -> None:
        if not self.above < self.low < self.high < math.inf:
            positive = "" if self.above else ", both above 0"
            what = f"from {self.low:g} to {self.high:g} is not a range; needed: two numbers, the lower first"
            raise ConfigError(f"{what}{positive}")


@dataclass(frozen=True, slots=True)
class Log(Linear):
    """A search space: the numbers from low to high, each power of ten as likely as the next."""

    above: ClassVar[float] = 0.0


@dataclass(frozen=True, slots=True)
class Factor(Log):
    """A search space: what the study says, times a number from low to high as in :class:`Log`.

    For settings whose size depends on the plant's units. Of a list every entry is multiplied.
    """


@dataclass(frozen=True, slots=True)
class Integer(Linear):
    """A search space: the integers from low to high, both included."""

    low: int
    high: int


@dataclass(frozen=True, slots=True)
class Choice:
    """A search space: a few values, in plain values as a study file writes them."""

    values: Sequence[Any]


Search = Linear | Choice


SIGNAL = "signal"
"""The unit of what is in the unit of the signal that it is about."""


@dataclass(frozen=True, slots=True)
class SettingInfo:
    """What a setting is and which values it takes.

    Parameters
    ----------
    doc : str
        One line for people.
    low, high : float
        Range of a number, of each entry where the value is a sequence.
    above : float
        The number must be greater than this.
    choices : tuple
        The values allowed, if they can be listed.
    unit : str
        Unit, where there is one; ``"signal"`` is that of the signal that it is about.
    kind : type or None
        Class that a table in a study file makes an object of, where it does not name one.
    file : bool
        Whether the value is the path of a file: in a study, it is relative to the study, ``"{plant}"`` is the
        FMU of the plant, and the file's content is part of what decides a result.
    plant : bool
        Whether the value is the name of a plant: in a study, an empty one stands for that of the study's own
        plant where it has one, ``file.py:MODEL`` is relative to the study, and what the plant consists of is
        part of what decides a result.
    search : Linear, Log, Factor, Integer, Choice or None
        Where ``ddpc-cosim tune`` looks for a better value; None: it does not.
    predicts : bool or mapping of str to Any
        Whether it is searched by the prediction error as well, which it has to change without changing how
        far ahead is predicted; a mapping: where other settings have these values.
    below : float
        The number must be less than this.
    infinite : bool
        Whether a number need not be finite.
    key : str or None
        Its name in a file; empty: that in Python; None: no file says it.
    required : bool
        Whether a file has to say it, though Python has a default.
    written : type or None
        Its type in a file, where that differs.
    """

    doc: str
    low: float = -math.inf
    high: float = math.inf
    above: float = -math.inf
    choices: tuple[Any, ...] = ()
    unit: str = ""
    kind: type[Any] | None = None
    file: bool = False
    plant: bool = False
    search: Search | None = None
    predicts: bool | Mapping[str, Any] = False
    below: float = math.inf
    infinite: bool = False
    key: str | None = ""
    required: bool = False
    written: Any = None

    @property
    def meaning(self) -> str:
        """What it is, with its unit, in words."""
        if self.unit == SIGNAL:
            return f"{self.doc}, in the unit of the signal"
        what, mark, more = self.doc.partition(";")
        return f"{what} [{self.unit}]{mark}{more}" if self.unit else self.doc

    @property
    def allowed(self) -> str:
        """The allowed values in words."""
        if self.choices:
            words = (str(c).lower() if isinstance(c, bool) else repr(c) for c in self.choices)
            return "one of " + ", ".join(words)
        limits = ((">", self.above), (">=", self.low), ("<=", self.high), ("<", self.below))
        return " and ".join(f"{sign} {limit:g}" for sign, limit in limits if math.isfinite(limit)) or "any"

    def admits(self, number: float) -> bool:
        """Whether a number is finite and in range."""
        # An integer of any length is finite, but some are beyond what can be computed with.
        return not self.needed_of(number)

    def needed_of(self, number: float) -> str:
        """Return what a number would have to be, if it is not possible: ``greater than 0``."""
        if not (abs(number) <= sys.float_info.max or self.infinite):
            return "a finite number"
        limits = (
            (number <= self.above > -math.inf, "greater than", self.above),
            (number < self.low, "greater than or equal to", self.low),
            (number > self.high, "less than or equal to", self.high),
            (number >= self.below < math.inf, "less than", self.below),
        )
        return next((f"{words} {limit}" for is_beyond, words, limit in limits if is_beyond), "")


P = ParamSpec("P")
T = TypeVar("T")
_MEANT = {
    "low": ("at_least", "ge", "lower", "min", "minimum"),
    "high": ("at_most", "le", "max", "maximum", "upper"),
    "above": ("greater_than", "gt", "more_than"),
    "choices": ("allowed", "one_of", "options", "values"),
    "doc": ("description", "help"),
}
"""Other words for keywords of :func:`setting`, which are not alike."""


def _naming_keywords(function: Callable[P, T]) -> Callable[P, T]:
    """Report an unknown keyword with the one that may be meant."""
    allowed = signature(function).parameters
    meant = {word: keyword for keyword, words in _MEANT.items() for word in words}

    @wraps(function)
    def named(*arguments: P.args, **keywords: P.kwargs) -> T:
        for word in keywords:
            if word not in allowed:
                hint = did_you_mean(meant.get(word, word), allowed)
                raise TypeError(f"{function.__name__}() has no keyword {word}; {hint}")
        return function(*arguments, **keywords)

    return named


@_naming_keywords
def setting(
    default: Any = dataclasses.MISSING,
    *,
    doc: str,
    low: float = -math.inf,
    high: float = math.inf,
    above: float = -math.inf,
    choices: Sequence[Any] = (),
    unit: str = "",
    kind: type[Any] | None = None,
    file: bool = False,
    plant: bool = False,
    search: Search | None = None,
    predicts: bool | Mapping[str, Any] = False,
    below: float = math.inf,
    infinite: bool = False,
    key: str | None = "",
    required: bool = False,
    written: Any = None,
    default_factory: Any = dataclasses.MISSING,
) -> Any:
    """Declare a setting of a plug-in: a dataclass field that knows its range and its meaning.

    Parameters
    ----------
    default, default_factory
        As in :func:`dataclasses.field`, but that a list or a dict is one for each object; without either the
        setting is required.
    doc, low, high, above, choices, unit, kind, file, plant, search, predicts
        See :class:`SettingInfo`.
    below, infinite, key, required, written
        The same.
    """
    given = (doc, low, high, above, tuple(choices), unit, kind, file, plant, search, predicts)
    info = SettingInfo(*given, below, infinite, key, required, written)
    if isinstance(default, list | dict):
        default, default_factory = dataclasses.MISSING, default.copy
    return dataclasses.field(
        default=default,
        default_factory=default_factory,
        metadata={"setting": info},
    )


def setting_of(field: "dataclasses.Field[Any]") -> SettingInfo | None:
    """Return what a dataclass field declares with :func:`setting`; None where it does not."""
    info: SettingInfo | None = field.metadata.get("setting")
    return info


def declared_settings(plugin: type[Any]) -> dict[str, SettingInfo]:
    """Return the settings that a plug-in class declares with :func:`setting`, by name."""
    if not dataclasses.is_dataclass(plugin):
        return {}
    return {f.name: f.metadata["setting"] for f in dataclasses.fields(plugin) if "setting" in f.metadata}


def instead_of(plugin: type[Any], setting: str) -> str:
    """Return what to use instead of a setting that a plug-in does not have any more; empty if it had none.

    ``setting`` is a name, or ``name = value``. The plug-in says so in ``former_settings``, a class attribute:
    a mapping from these to a clause, such as ``"that is what deepc-published does"``.
    """
    return str(getattr(plugin, "former_settings", {}).get(setting, ""))


def check_settings(plugin: Any) -> None:
    """Check every declared setting of a plug-in object against its type and range.

    Raises
    ------
    SettingsError
        Every setting that has an impossible value: its name, the value and what is allowed.
    """
    faults: list[tuple[Place, str]] = []
    for field in dataclasses.fields(plugin):
        info = field.metadata.get("setting")
        value = getattr(plugin, field.name)
        if info is not None and not _is_possible(value, field.type, info):
            allowed = ", ".join(filter(None, (_type_words(field.type), info.allowed)))
            hint = instead_of(type(plugin), f"{field.name} = {value}")
            faults.append(((field.name,), f"{value!r} is not possible; {hint or f'allowed: {allowed}'}"))
    if faults:
        who = type(plugin).__name__
        raise SettingsError(faults, [f"{who}: {name} = {fault}" for (name,), fault in faults])


def to_plain(value: Any) -> Any:
    """Return a setting's value as a study file writes it: an object becomes a table of its own settings."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        kind = f"{type(value).__module__}:{type(value).__qualname__}"
        settings = {f.name: to_plain(getattr(value, f.name)) for f in dataclasses.fields(value) if f.init}
        # A study file cannot say None: what is left out is the default.
        return {"type": kind} | {name: plain for name, plain in settings.items() if plain is not None}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if not isinstance(value, str | int | float | None) and isinstance(value, Mapping):
        return {key: to_plain(item) for key, item in value.items()}
    return value


def is_plain(value: Any) -> bool:
    """Whether a study file can say a value: not so None, functions, and objects without settings."""
    if isinstance(value, dict):
        return all(isinstance(key, str) and is_plain(item) for key, item in value.items())
    if isinstance(value, list):
        return all(map(is_plain, value))
    return type(value) in (str, bool, int, float, datetime, date, time)


def from_plain(plugin: type[Any], name: str, value: Any) -> Any:
    """Return the value of a plug-in's setting from what a study file says.

    Parameters
    ----------
    plugin : type
        The plug-in class that declares the setting.
    name : str
        Name of the setting.
    value : object
        What the file says; a table makes an object of the class named by its key ``type`` (``module:Class``,
        or a controller's name), or else of the setting's ``kind``, or of the class of its default. A list
        makes a list of such objects. A text may say a time, where that is in seconds.

    Raises
    ------
    SettingsError
        The object cannot be made, and why.
    """
    if isinstance(value, str):
        return _seconds_in(plugin, name, value)
    if not isinstance(value, dict | list) or not dataclasses.is_dataclass(plugin):
        return value
    kind = _kind_of_tables(plugin, name)
    if isinstance(value, list):
        return [_from_table((name, i), item, kind) for i, item in enumerate(value)]
    return _from_table((name,), value, kind)


def _seconds_in(plugin: type[Any], name: str, text: str) -> Any:
    """Return a setting's text as it is, or in seconds if that is its unit."""
    info = declared_settings(plugin).get(name)
    if info is None or info.unit != "s":
        return text
    try:
        return seconds_of(text)
    except ValueError as error:
        raise SettingsError([((name,), f"must be {DURATION}, got {text[:100]!r}")]) from error


def _kind_of_tables(plugin: type[Any], name: str) -> Any:
    """Return the class that a setting's tables make objects of without naming one, if there is any."""
    field = next((f for f in dataclasses.fields(plugin) if f.name == name), None)
    info = field.metadata.get("setting") if field else None
    if info is not None and info.kind is not None:
        return info.kind
    factory = field.default_factory if field else dataclasses.MISSING
    return None if factory is dataclasses.MISSING else type(factory())


def _from_table(place: Place, value: Any, kind: Any) -> Any:
    """Return the object that a table describes; anything else as it is."""
    if not isinstance(value, dict):
        return value
    entries = dict(value)
    if "type" in entries:
        try:
            kind = _load_class(str(entries.pop("type")))
        except PluginError as error:
            raise SettingsError([((*place, "type"), str(error))]) from error
    if not (isinstance(kind, type) and dataclasses.is_dataclass(kind)):
        return value
    known = [f.name for f in dataclasses.fields(kind) if f.init]
    unknown = [key for key in entries if key not in known]
    if unknown:
        what = f"unknown setting of {kind.__name__}"
        hints = {key: instead_of(kind, key) or did_you_mean(key, known) for key in unknown}
        raise SettingsError([((*place, key), f"{what}; {hint}") for key, hint in hints.items()])
    if missing := [name for name in known if name not in entries and is_required(kind, name)]:
        raise SettingsError([(place, f"a {kind.__name__} needs {', '.join(missing)} too")])
    try:
        return kind(**{key: from_plain(kind, key, entry) for key, entry in entries.items()})
    except MissingLibraryError:
        raise
    except SettingsError as error:
        raise SettingsError([((*place, *below), fault) for below, fault in error.found]) from error
    except ConfigError as error:
        raise SettingsError([(place, fault) for fault in error.faults]) from error
    except Exception as error:  # a third party's constructor can fail in any way
        raise SettingsError([(place, str(error))]) from error


def is_required(kind: Any, name: str) -> bool:
    """Whether an object of a plug-in class cannot be made without a setting."""
    field = kind.__dataclass_fields__[name]
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def weight_matrix(weight: Weight, size: int, name: str) -> FloatArray:
    """Return a weight as a matrix.

    Parameters
    ----------
    weight : float, sequence or matrix
        A scalar, one number per signal, or a symmetric positive semidefinite matrix.
    size : int
        Number of signals.
    name : str
        Name of the setting, for the error.

    Returns
    -------
    matrix : array, shape (size, size)

    Raises
    ------
    ConfigError
        The shape does not fit, or the matrix is not symmetric positive semidefinite.
    """
    try:
        array = np.asarray(weight, dtype=float)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{name} = {weight!r} is not a number, a list or a matrix of numbers") from error
    matrix = array * np.eye(size) if array.ndim == 0 else np.diag(array) if array.ndim == 1 else array
    if matrix.shape != (size, size):
        raise ConfigError(
            f"{name} has shape {array.shape}; needed: a number, {size} numbers, or {size} x {size}"
        )
    symmetric = array.ndim < 2 or np.allclose(matrix, matrix.T)
    least = array.min() if array.ndim < 2 else np.linalg.eigvalsh(matrix)[0]
    if not (symmetric and least >= -1e-12 * np.abs(matrix).max()):
        raise ConfigError(f"{name} is not symmetric positive semidefinite: {matrix.tolist()}")
    return matrix


def _load_class(target: str) -> Any:
    """Return the class that the key ``type`` of a setting's table names."""
    return load_target(target, "class") if ":" in target else load_plugin("controllers", target)


def _is_possible(value: Any, kind: Any, info: SettingInfo) -> bool:
    if info.choices:  # 1 is not true
        return value in [
            choice for choice in info.choices if isinstance(choice, bool) == isinstance(value, bool)
        ]
    if kind in (bool, "bool"):
        return isinstance(value, bool)
    if kind in (int, "int"):
        return isinstance(value, Integral) and _is_number(value) and info.admits(value)
    if kind in (float, "float"):
        return _is_number(value) and info.admits(value)
    if kind in (Weight, "Weight"):
        return _is_possible_weight(value, info)
    return True


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, Real) and not isinstance(value, bool)


def _is_possible_weight(value: Any, info: SettingInfo) -> bool:
    try:
        array = np.asarray(value)
    except ValueError:  # lists of different lengths
        return False
    if array.dtype.kind not in "iuf":
        return False
    entries = array.ravel() if array.ndim < 2 else np.diag(array)
    return array.ndim <= 2 and all(info.admits(float(entry)) for entry in entries)


def _type_words(kind: Any) -> str:
    words = {"bool": "true or false", "int": "an integer", "float": "a number"}
    if kind in (Weight, "Weight"):
        return "a number, list or matrix"
    return words.get(kind if isinstance(kind, str) else getattr(kind, "__name__", ""), "")


PLANT = "{plant}"
"""Stands for the FMU of the study's plant."""


def map_files(plugin: type[Any], settings: Mapping[str, Any], change: Callable[[str], str]) -> dict[str, Any]:
    """Return the plain settings of a plug-in class with every path changed, those of objects inside included.

    Parameters
    ----------
    plugin : type
        The class that declares the settings.
    settings : mapping
        Settings as :func:`to_plain` gives them.
    change : callable
        Called with each path, or ``PLANT``; returns what takes its place.
    """
    return _mapped(plugin, settings, change, lambda info: info.file)


def map_plants(
    plugin: type[Any], settings: Mapping[str, Any], change: Callable[[str], str]
) -> dict[str, Any]:
    """Return the same with every name of a plant changed; ``change`` is called with empty ones too."""
    return _mapped(plugin, settings, change, lambda info: info.plant)


_Which = Callable[[SettingInfo], bool]


def _mapped(
    plugin: type[Any], settings: Mapping[str, Any], change: Callable[[str], str], which: _Which
) -> dict[str, Any]:
    declared = declared_settings(plugin)
    return {
        name: _entry(value, change, which, is_meant=name in declared and which(declared[name]))
        if isinstance(value, str | list | dict)
        else value
        for name, value in settings.items()
    }


def files_of(plugin: type[Any], settings: Mapping[str, Any]) -> list[str]:
    """Return the paths that the plain settings of a plug-in class name, ``PLANT`` among them."""
    paths: list[str] = []

    def note(path: str) -> str:
        paths.append(path)
        return path

    map_files(plugin, settings, note)
    return paths


def plants_of(plugin: type[Any], settings: Mapping[str, Any]) -> list[str]:
    """Return the plants that the plain settings of a plug-in class name; an empty one is the study's own."""
    plants: list[str] = []

    def note(name: str) -> str:
        plants.append(name)
        return name

    map_plants(plugin, settings, note)
    return plants


def hash_of_file(path: str) -> str:
    """Return a hash of a file's content; empty if it is not there."""
    if not Path(path).is_file():
        return ""
    status = Path(path).stat()
    return _hash(path, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=64)
def _hash(path: str, size: int, changed: int) -> str:
    """Return a hash of a file of this size that was last changed then: one reading serves all cases."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def _entry(value: Any, change: Callable[[str], str], which: _Which, *, is_meant: bool) -> Any:
    if isinstance(value, str):
        return change(value) if is_meant else value
    if isinstance(value, list):
        return [_entry(item, change, which, is_meant=is_meant) for item in value]
    if isinstance(value, dict) and "type" in value:
        entries = {name: entry for name, entry in value.items() if name != "type"}
        return {"type": value["type"], **_mapped(_load_class(value["type"]), entries, change, which)}
    return value
