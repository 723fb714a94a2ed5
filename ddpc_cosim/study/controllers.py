"""From the controller sections of a study to controllers."""

from pathlib import Path
from typing import Any

from ddpc_cosim.controller import Controller
from ddpc_cosim.errors import ConfigError, PluginError, did_you_mean
from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.safe_calls import controller_settings
from ddpc_cosim.settings import declared_settings, from_plain, is_plain, placed
from ddpc_cosim.study.sections import ControllerSection, StabiliserSection


def make_controller(section: ControllerSection | StabiliserSection) -> Controller:
    """Construct the controller of a section.

    Raises
    ------
    ConfigError
        Unknown or impossible settings, all of them.
    PluginError
        There is no such controller, or it cannot be loaded.
    """
    plugin = load_plugin("controllers", section.type)
    if not (isinstance(plugin, type) and issubclass(plugin, Controller)):
        raise PluginError(f'controller "{section.type}" is not a class derived from ddpc_cosim.Controller')
    faults: list[str] = []
    arguments = _arguments(plugin, section, faults)
    controller: Controller | None = None
    try:
        controller = plugin(**arguments)
    except ConfigError as error:
        faults.extend(f"settings: {fault}" for fault in error.faults)
    except Exception as error:  # a third party's constructor can fail in any way
        if not faults:  # what was left out above may be all that it misses
            faults.append(f"settings: {error}")
    if faults or controller is None:
        raise ConfigError(faults)
    return controller


def all_settings(section: ControllerSection | StabiliserSection, folder: Path) -> dict[str, Any]:
    """Return the settings of a section's controller in plain values, every default filled in.

    Paths become absolute; in the section they are relative to the folder.
    """
    settings = controller_settings(make_controller(section))
    # What a file cannot say is a default, or what the controller has made of what the file says.
    said = section.settings | {name: value for name, value in settings.items() if is_plain(value)}
    return placed(section.type, said, folder)


def _arguments(
    plugin: type[Controller], section: ControllerSection | StabiliserSection, faults: list[str]
) -> dict[str, Any]:
    """Return the settings that the class can be given; note what is wrong with the others."""
    known = declared_settings(plugin)
    arguments = {}
    for key, value in section.settings.items():
        if known and key not in known:
            faults.append(f"settings.{key}: unknown setting of {section.type}; {did_you_mean(key, known)}")
            continue
        try:
            arguments[key] = from_plain(plugin, key, value)
        except ConfigError as error:
            faults.extend(f"settings.{fault}" for fault in error.faults)
    return arguments
