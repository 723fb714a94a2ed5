"""How a study file says signals, experiments and controllers that are objects: the inverse of reading it."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ddpc_cosim.controller import Controller
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.excitations import (
    PRBS,
    Chirp,
    Excitation,
    MixedExcitation,
    Multisine,
    SignalExcitation,
    UniformRandom,
)
from ddpc_cosim.plugins import name_in_file, name_of
from ddpc_cosim.settings import PLANT, is_plain, map_files, map_plants, to_plain
from ddpc_cosim.signals import Constant, Interpolated, Ramp, Reference, Sine, Steps, WhiteNoise

Table = dict[str, Any]
"""A table of a study file."""

_SIGNALS: dict[type[Reference], Callable[[Any], Table]] = {
    Constant: lambda one: {"kind": "constant", "value": one.value},
    Steps: lambda one: {"kind": "steps", "times": _numbers(one.times), "values": _numbers(one.values)},
    Interpolated: lambda one: {
        "kind": "interpolated",
        "times": _numbers(one.times),
        "values": _numbers(one.values),
    },
    Ramp: lambda one: {
        "kind": "ramp",
        "from_value": one.start,
        "to_value": one.stop,
        "from_time": one.start_time,
        "to_time": one.stop_time,
    },
    Sine: lambda one: {"kind": "sine"} | {f.name: getattr(one, f.name) for f in fields(one)},
    WhiteNoise: lambda one: {
        "kind": "noise",
        "standard_deviation": one.standard_deviation,
        "mean": one.mean,
    },
}


def signal_table(what: str, signal: Reference) -> Table:
    """Return a signal as a study file says it.

    Raises
    ------
    ConfigError
        It is of a class that study files do not know.
    """
    if type(signal) not in _SIGNALS:
        known = ", ".join(kind.__name__ for kind in _SIGNALS)
        raise ConfigError(f"{what}: a study cannot write {signal!r}; it can: {known}")
    table = _SIGNALS[type(signal)](signal)
    return {
        key: float(value) if np.ndim(value) == 0 and key != "kind" else value for key, value in table.items()
    }


def _numbers(values: Sequence[float]) -> list[float]:
    return [float(value) for value in values]


_RANGED: dict[type[Excitation], tuple[str, tuple[str, ...]]] = {
    UniformRandom: ("uniform", ()),
    PRBS: ("prbs", ("clock_period",)),
    Multisine: ("multisine", ("min_frequency", "max_frequency", "phases")),
    Chirp: ("chirp", ("from_frequency", "to_frequency", "sweep")),
}


def experiment_table(excitation: Excitation, inputs: Sequence[str]) -> Table:
    """Return an experiment on inputs as a study file says it.

    Raises
    ------
    ConfigError
        It is of a class that study files do not know, or for another number of inputs.
    """
    tables = dict(_excitation_tables(excitation, inputs))
    samples = {int(samples) for samples, _ in tables.values()}
    if list(tables) != list(inputs) and sorted(tables) != sorted(inputs):
        raise ConfigError(f"excitation: of {', '.join(tables)}; needed: one for each of {', '.join(inputs)}")
    if len(samples) != 1:
        raise ConfigError(
            f"excitation: parts of {', '.join(map(str, sorted(samples)))} samples; needed: one length"
        )
    return {"samples": samples.pop(), "excitation": {name: tables[name][1] for name in inputs}}


def _excitation_tables(excitation: Any, inputs: Sequence[str]) -> Iterator[tuple[str, tuple[int, Table]]]:
    """Yield the excitation of each input, and how long it is."""
    if type(excitation) in _RANGED:
        kind, keys = _RANGED[type(excitation)]
        more = {key: getattr(excitation, key) for key in keys}
        more = {key: value for key, value in more.items() if value != np.inf}
        ends = (
            np.broadcast_to(np.asarray(end, float), len(inputs)) for end in (excitation.low, excitation.high)
        )
        for name, low, high in zip(inputs, *ends, strict=True):
            yield name, (excitation.samples, {"kind": kind, "low": float(low), "high": float(high), **more})
    elif isinstance(excitation, MixedExcitation):
        for part, served in excitation.parts:
            yield from _excitation_tables(part, [inputs[i] for i in served])
    elif isinstance(excitation, SignalExcitation) and all(type(one) is Steps for one in excitation.signals):
        for name, signal in zip(inputs, excitation.signals, strict=True):
            yield name, (excitation.samples, signal_table(f"excitation of {name}", signal))
    else:
        known = ", ".join(one.__name__ for one in _RANGED)
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
    for own in _classes_in(controller):
        name_of("controllers", own)  # which keeps what a worker cannot import
    plain = map_files(kind, changed, lambda path: path if path == PLANT else str(Path(path).resolve()))
    plain = map_plants(kind, plain, lambda name: name_in_file(name, lambda file: Path(file).resolve()))
    return {"type": name_of("controllers", kind), "settings": plain}


def _default(kind: type[Any], setting: str) -> Any:
    """Return a setting's default in plain values; a value that equals nothing where it has none."""
    one = next((one for one in fields(kind) if one.name == setting), None) if is_dataclass(kind) else None
    if one is not None and one.default_factory is not MISSING:
        return to_plain(one.default_factory())
    return object() if one is None or one.default is MISSING else to_plain(one.default)


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
