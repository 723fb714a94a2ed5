"""Finding plug-ins: by entry point, for built-ins and third parties alike, or as ``module:attribute``."""

import importlib
import sys
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from ddpc_cosim.errors import PluginError
from ddpc_cosim.suggest import did_you_mean

KINDS = ("plants", "controllers", "studies", "reports")


@dataclass(frozen=True, slots=True)
class Plugin:
    """An installed plug-in.

    Parameters
    ----------
    name : str
        Name of the entry point.
    target : str
        ``module:attribute``.
    package : str
        Distribution that installed it, with its version.
    value : object
        What the entry point loads; None if it is broken.
    error : str
        Why it cannot be loaded; empty if it can.
    """

    name: str
    target: str
    package: str
    value: Any = None
    error: str = ""


def installed(kind: str) -> list[Plugin]:
    """Load all plug-ins of a kind (one of ``KINDS``), by name; a broken one carries its error."""
    entries = _entry_points(kind)
    plugins = [_load_entry_point(entry) for entry in sorted(entries, key=lambda entry: entry.name)]
    names = [plugin.name for plugin in plugins]
    return [
        plugin
        if plugin.error or names.count(plugin.name) == 1
        else replace(plugin, value=None, error=f"another package has a {plugin.name} too; uninstall one")
        for plugin in plugins
    ]


def plugin_names(kind: str) -> list[str]:
    """Return the names of the installed plug-ins of a kind, without loading them."""
    return sorted({entry.name for entry in _entry_points(kind)})


def load_plugin(kind: str, name: str) -> Any:
    """Load a plug-in of a kind by name, or anything as ``module:attribute``.

    Raises
    ------
    PluginError
        There is no such plug-in, or it cannot be loaded, and why.
    """
    singular = {"studies": "study"}.get(kind, kind.removesuffix("s"))
    if ":" in name:
        return load_target(name, singular)
    matches = [entry for entry in _entry_points(kind) if entry.name == name]
    if not matches:
        raise PluginError(f'no {singular} "{name}"; {did_you_mean(name, plugin_names(kind))}')
    if len(matches) > 1:
        origins = " and ".join(f"{_package(entry)} ({entry.value})" for entry in matches)
        raise PluginError(
            f'there are several {kind} called "{name}": of {origins}; '
            f"write {matches[0].value} for the first, or uninstall one"
        )
    plugin = _load_entry_point(matches[0])
    if plugin.error:
        raise PluginError(
            f'{singular} "{name}" ({plugin.target}, {plugin.package}) cannot be loaded: {plugin.error}'
        )
    return plugin.value


def _entry_points(kind: str) -> list[EntryPoint]:
    if kind not in KINDS:
        raise ValueError(f"kind must be one of {', '.join(KINDS)}, got {kind!r}")
    # An editable installation beside a wheel lists an entry point twice.
    found = entry_points(group=f"ddpc_cosim.{kind}")
    return list({(entry.name, entry.value): entry for entry in found}.values())


def _package(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "unknown package"


def _load_entry_point(entry: EntryPoint) -> Plugin:
    package = _package(entry)
    try:
        return Plugin(entry.name, entry.value, package, entry.load())
    except (Exception, SystemExit) as error:  # a third party's import can fail in any way
        return Plugin(entry.name, entry.value, package, error=f"{type(error).__name__}: {error}")


def load_target(target: str, kind: str) -> Any:
    """Load anything as ``module:attribute``; ``kind`` is what the error calls it.

    Modules in the current folder are found too, after everything that is installed.

    Raises
    ------
    PluginError
        It cannot be loaded, and why.
    """
    module_name, _, attribute = target.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)
    try:
        value: Any = importlib.import_module(module_name)
        for part in attribute.split("."):
            value = getattr(value, part)
    except (Exception, SystemExit) as error:  # a third party's import can fail in any way
        raise PluginError(f'{kind} "{target}" cannot be loaded: {type(error).__name__}: {error}') from error
    return value
