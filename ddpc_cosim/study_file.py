"""From a study file to a checked study: every fault of the file in one error."""

import re
import tomllib
from pathlib import Path

from ddpc_cosim.checked_study import CheckedStudy
from ddpc_cosim.config import Study
from ddpc_cosim.errors import ConfigError, PluginError
from ddpc_cosim.faults import validate_all
from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.study_checks import check_study
from ddpc_cosim.sweeps import expand_sweeps


def read_study(name: str) -> CheckedStudy:
    """Read a study file, or a built-in or plug-in study by name, and check it.

    Raises
    ------
    ConfigError
        There is no such study, or it has faults: all of them, each with file, key and what to do.
    """
    path = find_study(name)
    try:
        # Some editors put a byte order mark in front, which TOML does not know.
        data = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:  # numbers or nesting beyond measure are no TOML errors
        raise ConfigError(f"{path.name}: not a TOML file: {error}") from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    data.setdefault("name", _as_name(path.stem))
    study, faults = validate_all(Study, data)
    checked = check_study(expand_sweeps(study, faults), path.parent, faults) if study is not None else None
    if faults.listed or checked is None:
        raise ConfigError([f"{path.name}: {fault}" for fault in faults.listed])
    return checked


def find_study(name: str) -> Path:
    """Return the path of a study given as a file or by the name of a built-in or plug-in study."""
    path = Path(name)
    if path.is_file():
        return path
    if path.suffix == ".toml" or len(path.parts) > 1:
        raise ConfigError(f"{name}: no such study file")
    try:
        return Path(load_plugin("studies", name))
    except PluginError as error:
        raise ConfigError(f"{error}; or give the path of a study file") from error


def study_title(path: Path) -> str:
    """Return the title of a study file, for lists."""
    return str(tomllib.loads(path.read_text(encoding="utf-8-sig")).get("title", ""))


def _as_name(stem: str) -> str:
    """Return the name of a study whose file gives none: the file's, as far as names may have its letters."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", stem).strip("._-")[:60] or "study"
