"""From the controller sections of a study to controllers: sweeps written out, each one built once."""

import re
from collections.abc import Callable, Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from ddpc_cosim.controller import Controller
from ddpc_cosim.errors import ConfigError, Place, PluginError, did_you_mean
from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.safe_calls import controller_settings
from ddpc_cosim.settings import PLANT, SettingsError, declared_settings, from_plain, is_plain, map_files
from ddpc_cosim.study.sections import ControllerSection
from ddpc_cosim.study.validation_errors import ValidationErrors

_LONGEST_NAME = 60


class ResolvedController(NamedTuple):
    """A controller of a study that has been built.

    Parameters
    ----------
    controller : Controller
        To be asked what it needs; where it runs, another one is built.
    settings : dict
        Its settings in plain values, every default filled in, paths absolute.
    files : list of str
        The paths among them.
    """

    controller: Controller
    settings: dict[str, Any]
    files: list[str]


class Variant(NamedTuple):
    """A controller section, or one combination of its sweeps.

    Parameters
    ----------
    name : str
        Its name in the study.
    of : str
        Name of the section.
    settings : dict
        What the file says about its settings.
    varied : dict
        Those of them that are from a sweep; empty for the section itself.
    sweep : Place
        Where the sweep stands in the file.
    """

    name: str
    of: str
    settings: dict[str, Any]
    varied: dict[str, Any]
    sweep: Place

    def place(self, setting: Place) -> Place:
        """Return where the file says a setting of this variant."""
        in_sweep = bool(setting) and setting[0] in self.varied
        return (*(self.sweep if in_sweep else ("controllers", self.of, "settings")), *setting)

    def section(self, section: ControllerSection, settings: dict[str, Any]) -> ControllerSection:
        """Return the section of this variant in a study without sweeps, with all its settings."""
        label = section.label or self.of
        changes: dict[str, Any] = {"settings": settings, "label": label, "sweep": []}
        if self.varied:
            words = ", ".join(f"{setting} = {_words(value)}" for setting, value in self.varied.items())
            changes |= {"label": f"{label}, {words}", "variant_of": self.of, "varied": list(self.varied)}
        return section.model_copy(update=changes)


def variants_of(name: str, section: ControllerSection, *, with_sweeps: bool = True) -> Iterator[Variant]:
    """Yield a controller section, then every combination of each of its sweeps.

    Variants are called after what they vary (``deepc-lambda_g-5``).
    """
    yield Variant(name, name, section.settings, {}, ())
    combinations = (
        (("controllers", name, "sweep", i), dict(zip(table, values, strict=True)))
        for i, table in enumerate(section.sweep if with_sweeps else ())
        for values in product(*table.values())
    )
    for number, (place, varied) in enumerate(combinations, start=1):
        yield Variant(_name(name, varied, number), name, {**section.settings, **varied}, varied, place)


def resolve_controller(
    kind: str,
    settings: Mapping[str, Any],
    folder: Path,
    errors: ValidationErrors,
    place: Callable[[Place], Place],
) -> ResolvedController | None:
    """Build a controller and return it with all its settings; None if it has errors, which are reported.

    Parameters
    ----------
    kind : str
        Its type: a plug-in's name, or ``module:Class``.
    settings : mapping
        What the file says.
    folder : Path
        Paths among the settings are relative to it.
    errors : ValidationErrors
        What is found is added.
    place : callable
        Returns where the file says a setting.
    """
    try:
        controller = make_controller(kind, settings)
        # What a file cannot say is a default, or what the controller has made of what the file says.
        own = {name: value for name, value in controller_settings(controller).items() if is_plain(value)}
        return ResolvedController(controller, *_with_absolute_paths(kind, dict(settings) | own, folder))
    except SettingsError as error:
        for setting, fault in error.found:
            errors.add(place(setting), fault)
    except PluginError as error:
        errors.add((*place(())[:-1], "type"), str(error))
    return None


def _with_absolute_paths(
    kind: str, settings: Mapping[str, Any], folder: Path
) -> tuple[dict[str, Any], list[str]]:
    files: list[str] = []

    def absolute(path: str) -> str:
        files.append(path if path == PLANT else str((folder / path).resolve()))
        return files[-1]

    return map_files(kind, settings, absolute), files


def make_controller(kind: str, settings: Mapping[str, Any]) -> Controller:
    """Construct a controller from what a study file says.

    Raises
    ------
    SettingsError
        Unknown or impossible settings, all of them.
    PluginError
        There is no such controller, or it cannot be loaded.
    """
    plugin = load_plugin("controllers", kind)
    if not (isinstance(plugin, type) and issubclass(plugin, Controller)):
        raise PluginError(f'controller "{kind}" is not a class derived from ddpc_cosim.Controller')
    found: list[tuple[Place, str]] = []
    known = declared_settings(plugin)
    arguments = {}
    for key, value in settings.items():
        if known and key not in known:
            found.append(((key,), f"unknown setting of {kind}; {did_you_mean(key, known)}"))
            continue
        try:
            arguments[key] = from_plain(plugin, key, value)
        except SettingsError as error:
            found += error.found
    try:
        controller: Controller = plugin(**arguments)
    except SettingsError as error:
        found += error.found
    except ConfigError as error:
        found += [((), fault) for fault in error.faults]
    except Exception as error:  # a third party's constructor can fail in any way
        if not found:  # what was left out above may be all that it misses
            found.append(((), str(error)))
    if found:
        raise SettingsError(found)
    return controller


def _name(name: str, varied: Mapping[str, Any], number: int) -> str:
    """Return a readable name; a number where the values make it too long for a file's name."""
    values = {setting: re.sub(r"[^A-Za-z0-9._-]+", "", _words(value)) for setting, value in varied.items()}
    readable = "-".join([name, *(f"{setting}-{value}" for setting, value in values.items())])
    return readable if len(readable) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 5]}-{number}"


def _words(value: Any) -> str:
    if isinstance(value, dict):
        return " ".join(f"{key} {_words(entry)}" for key, entry in value.items())
    return f"{value:g}" if isinstance(value, float) else str(value)
