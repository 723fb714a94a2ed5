"""How a study file says signals, experiments and controllers that are objects: the inverse of reading it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass, replace
from typing import Any

import numpy as np

from ddpc_cosim.codec import write, write_in_short
from ddpc_cosim.controller import Controller
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.plugins import name_of
from ddpc_cosim.settings import Choice, Linear, is_plain, to_plain
from ddpc_cosim.signals.excitations import EXCITATIONS, Excitation, MixedExcitation, SignalExcitation
from ddpc_cosim.signals.signals import INPUTS, Band, GaussianNoise, Reference
from ddpc_cosim.study.file_format.sections import BandSection, search_table

Table = dict[str, Any]
"""A table of a study file."""


def signal_table(what: str, signal: Reference) -> Table:
    """Return a signal as a study file says it.

    Raises
    ------
    ConfigError
        It is of a class that study files do not know.
    """
    if type(signal) not in INPUTS.values():
        names = ", ".join(kind.__name__ for kind in INPUTS.values())
        raise ConfigError(f"{what}: a study cannot write {signal!r}; it can: {names}")
    return write_in_short(signal)


def plain(value: Any, what: str = "") -> Any:
    """Return anything that a study says in Python as its file says it.

    Parameters
    ----------
    value : object
        A number, text, signal, search space or declared object, and lists and tables of these.
    what : str
        Whose signals a table has, with ``{}`` for their names.

    Raises
    ------
    ConfigError
        A signal of a class that study files do not know.
    """
    if isinstance(value, Reference):
        return signal_table(what, value)
    if isinstance(value, GaussianNoise):
        return plain(value.standard_deviation)
    if isinstance(value, Linear | Choice):
        return search_table(value)
    if is_dataclass(value) and not isinstance(value, type):
        for signal in (getattr(value, held.name) for held in fields(value)):
            if isinstance(signal, Reference):
                signal_table(what, signal)  # which reports what it cannot write
        if isinstance(value, Band):
            value = BandSection(band=value, unit=value.unit)
        return write_in_short(value)
    if isinstance(value, Mapping):
        return {key: plain(item, what.format(key)) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item, what) for item in value]
    return write(value)


def experiment_table(excitation: Excitation, inputs: Sequence[str]) -> Table:
    """Return an experiment on inputs as a study file says it.

    Raises
    ------
    ConfigError
        It is of a class that study files do not know, or for another number of inputs.
    """
    entries = dict(_entries(excitation, inputs))
    samples = {int(samples) for samples, _ in entries.values()}
    if list(entries) != list(inputs) and sorted(entries) != sorted(inputs):
        raise ConfigError(f"excitation: of {', '.join(entries)}; needed: one for each of {', '.join(inputs)}")
    if len(samples) != 1:
        raise ConfigError(
            f"excitation: parts of {', '.join(map(str, sorted(samples)))} samples; needed: one length"
        )
    return {
        "samples": samples.pop(),
        "excitation": {name: write_in_short(entries[name][1]) for name in inputs},
    }


def _entries(excitation: Any, inputs: Sequence[str]) -> Iterator[tuple[str, tuple[int, Any]]]:
    """Yield what excites each input, and how long it does."""
    if type(excitation) in EXCITATIONS.values():
        limits = np.broadcast_arrays(excitation.low, excitation.high, np.empty(len(inputs)))[:2]
        for name, low, high in zip(inputs, *limits, strict=True):
            yield name, (excitation.samples, replace(excitation, low=float(low), high=float(high)))
    elif isinstance(excitation, MixedExcitation):
        for part, served in excitation.parts:
            yield from _entries(part, [inputs[i] for i in served])
    elif isinstance(excitation, SignalExcitation) and all(
        type(signal) in EXCITATIONS.values() for signal in excitation.signals
    ):
        for name, signal in zip(inputs, excitation.signals, strict=True):
            yield name, (excitation.samples, signal)
    else:
        known = ", ".join(kind.__name__ for kind in EXCITATIONS.values() if not issubclass(kind, Reference))
        raise ConfigError(
            f"excitation: a study cannot write {excitation!r}; it can: {known}, SignalExcitation of Steps, "
            "and MixedExcitation of these"
        )


def controller_table(controller: Controller) -> Table:
    """Return type and settings of a controller as a study file says them.

    Raises
    ------
    ConfigError
        Settings that no study file can say, all of them.
    """
    settings, kind = controller.settings(), type(controller)
    changed = {name: value for name, value in settings.items() if value != _default(kind, name)}
    faults = [
        f"{kind.__name__}: {name} = {value!r}: a study can hold numbers, texts, lists, and objects that are "
        "dataclasses"
        for name, value in changed.items()
        if not is_plain(value)
    ]
    if faults:
        raise ConfigError(faults)
    for used_class in _classes_in(controller):
        name_of("controllers", used_class)  # which keeps what a worker cannot import
    return {"type": name_of("controllers", kind), "settings": changed}


def _default(kind: type[Any], setting: str) -> Any:
    """Return a setting's default in plain values; a value that equals nothing where it has none."""
    declared = (
        next((field for field in fields(kind) if field.name == setting), None) if is_dataclass(kind) else None
    )
    if declared is not None and declared.default_factory is not MISSING:
        return to_plain(declared.default_factory())
    return object() if declared is None or declared.default is MISSING else to_plain(declared.default)


def _classes_in(value: Any) -> Iterator[type]:
    """Yield the classes of all objects that settings hold."""
    if isinstance(value, list | tuple):
        for item in value:
            yield from _classes_in(item)
    elif isinstance(value, Mapping):
        yield from _classes_in(list(value.values()))
    elif hasattr(value, "__dataclass_fields__") and not isinstance(value, type):
        yield type(value)
        yield from _classes_in([getattr(value, f.name) for f in fields(value) if f.init])
