"""From a study file to a checked study: every fault of the file in one error."""

import re
import tomllib
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Any

from ddpc_cosim.errors import ConfigError, PluginError
from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.study.checks import CheckedStudy, check_study
from ddpc_cosim.study.sections import ControllerSection, Study
from ddpc_cosim.study.validation_errors import Faults, validate_all


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


_LONGEST_NAME = 60


def expand_sweeps(study: Study, faults: Faults) -> Study:
    """Return a study in which every variant of a sweep is a controller beside the one that is varied.

    Variants are called after what they vary (``deepc-lambda_g-5``) and say of whom they are variants; the
    study that a run leaves behind lists them like this, and runs again as it is.
    """
    controllers: dict[str, ControllerSection] = {}
    for name, section in study.controllers.items():
        controllers[name] = section.model_copy(update={"sweep": []})
        for number, varied in enumerate(_combinations(section), start=1):
            variant = _name(name, varied, number)
            if variant in controllers or variant in study.controllers:
                faults.add(
                    ("controllers", name, "sweep"), f'two controllers are called "{variant}"; change a value'
                )
            controllers[variant] = _variant(name, section, varied)
    return study.model_copy(update={"controllers": controllers})


def _combinations(section: ControllerSection) -> Iterator[Mapping[str, Any]]:
    for table in section.sweep:
        for values in product(*table.values()):
            yield dict(zip(table, values, strict=True))


def _variant(name: str, section: ControllerSection, varied: Mapping[str, Any]) -> ControllerSection:
    words = ", ".join(f"{setting} = {_words(value)}" for setting, value in varied.items())
    return section.model_copy(
        update={
            "settings": {**section.settings, **varied},
            "label": f"{section.label or name}, {words}",
            "sweep": [],
            "variant_of": name,
            "varied": list(varied),
        }
    )


def _name(name: str, varied: Mapping[str, Any], number: int) -> str:
    """Return a readable name; a number where the values make it too long for a file's name."""
    values = {setting: re.sub(r"[^A-Za-z0-9._-]+", "", _words(value)) for setting, value in varied.items()}
    readable = "-".join([name, *(f"{setting}-{value}" for setting, value in values.items())])
    return readable if len(readable) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 5]}-{number}"


def _words(value: Any) -> str:
    if isinstance(value, dict):
        return " ".join(f"{key} {_words(entry)}" for key, entry in value.items())
    return f"{value:g}" if isinstance(value, float) else str(value)
