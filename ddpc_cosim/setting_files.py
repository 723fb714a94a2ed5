"""Files that settings name: relative to the study that says so, and part of what decides a result."""

import hashlib
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.settings import declared_settings, load_class

PLANT = "{plant}"
"""Stands for the FMU of the study's plant."""


def placed(controller: str, settings: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return a controller's plain settings with absolute paths.

    Parameters
    ----------
    controller : str
        Type of the controller.
    settings : mapping
        Its settings as :func:`~ddpc_cosim.settings.to_plain` gives them.
    folder : Path
        What relative paths are relative to.
    """

    def absolute(path: str) -> str:
        return path if path == PLANT else str((folder / path).resolve())

    return _changed(load_plugin("controllers", controller), settings, absolute)


def with_plant(controller: str, settings: Mapping[str, Any], fmu: str) -> dict[str, Any]:
    """Return a controller's plain settings with the path of the plant's FMU where they ask for it."""
    plugin = load_plugin("controllers", controller)
    return _changed(plugin, settings, lambda path: fmu if path == PLANT else path)


def files_of(controller: str, settings: Mapping[str, Any]) -> list[str]:
    """Return the paths that a controller's plain settings name, the plant's placeholder among them."""
    found: list[str] = []

    def note(path: str) -> str:
        found.append(path)
        return path

    _changed(load_plugin("controllers", controller), settings, note)
    return found


def contents(controller: str, settings: Mapping[str, Any]) -> list[str]:
    """Return a hash of each file that a controller's plain settings name; empty for one that is not there."""
    paths = [Path(path) for path in files_of(controller, settings) if path != PLANT]
    return [_content(path, *_stamp(path)) if path.is_file() else "" for path in paths]


def _stamp(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_size, status.st_mtime_ns


@lru_cache(maxsize=64)
def _content(path: Path, size: int, changed: int) -> str:
    """Return a hash of a file of this size that was last changed then: one reading serves all cases."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _changed(plugin: type[Any], settings: Mapping[str, Any], change: Callable[[str], str]) -> dict[str, Any]:
    """Return settings with every path changed, those of objects inside included."""
    declared = declared_settings(plugin)
    return {
        name: _entry(value, change, is_file=name in declared and declared[name].file)
        for name, value in settings.items()
    }


def _entry(value: Any, change: Callable[[str], str], *, is_file: bool) -> Any:
    if isinstance(value, str):
        return change(value) if is_file else value
    if isinstance(value, list):
        return [_entry(item, change, is_file=is_file) for item in value]
    if isinstance(value, dict) and "type" in value:
        entries = {name: entry for name, entry in value.items() if name != "type"}
        return {"type": value["type"], **_changed(load_class("type", value["type"]), entries, change)}
    return value
