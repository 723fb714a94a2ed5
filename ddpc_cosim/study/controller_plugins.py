"""Controllers as a study file names them: their class, and one of it made from plain settings.

A worker makes its controller with this, and imports nothing of what reads study files.
"""

from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from typing import Any

from ddpc_cosim.controller import Controller
from ddpc_cosim.errors import ConfigError, MissingLibraryError, Place, PluginError
from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.settings import SettingsError, declared_settings, from_plain, instead_of
from fmu_plants.spelling import did_you_mean


def controller_class(kind: str) -> type[Controller]:
    """Return the class that a study file names.

    Raises
    ------
    PluginError
        There is no such controller, or it cannot be loaded.
    """
    plugin = load_plugin("controllers", kind)
    if not (isinstance(plugin, type) and issubclass(plugin, Controller)):
        raise PluginError(f'controller "{kind}" is not a class derived from ddpc_cosim.Controller')
    return plugin


def make_controller(kind: str, settings: Mapping[str, Any]) -> Controller:
    """Construct a controller from what a study file says.

    Raises
    ------
    SettingsError
        Unknown or impossible settings, all of them.
    MissingLibraryError
        It needs a package that is not installed.
    PluginError
        There is no such controller, or it cannot be loaded.
    """
    plugin = controller_class(kind)
    faults: list[tuple[Place, str]] = []
    known = declared_settings(plugin)
    arguments = {}
    for key, value in settings.items():
        if known and key not in known:
            faults.append(
                ((key,), f"unknown setting of {kind}; {instead_of(plugin, key) or did_you_mean(key, known)}")
            )
            continue
        try:
            arguments[key] = from_plain(plugin, key, value)
        except SettingsError as error:
            faults += error.found
    missing = [name for name in _required(plugin) if name not in settings]
    if missing:
        raise SettingsError(faults + [((name,), "required setting is missing") for name in missing])
    try:
        controller = plugin(**arguments)
    except MissingLibraryError:
        raise
    except SettingsError as error:
        faults += error.found
    except ConfigError as error:
        faults += [((), fault) for fault in error.faults]
    except Exception as error:  # a third party's constructor can fail in any way
        if not faults:  # what was left out above may be all that it misses
            faults.append(((), str(error)))
    except SystemExit as error:
        faults.append(((), f"SystemExit: {error}"))
    if faults:
        raise SettingsError(faults)
    return controller


def _required(plugin: type[Controller]) -> list[str]:
    """Return the names of settings that have no default."""
    if not is_dataclass(plugin):
        return []
    without_default = [field for field in fields(plugin) if field.init and field.default is MISSING]
    return [field.name for field in without_default if field.default_factory is MISSING]
