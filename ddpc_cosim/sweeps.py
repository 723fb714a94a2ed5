"""Sweeps: a controller section with values to try becomes one section for each variant."""

import re
from collections.abc import Iterator, Mapping
from itertools import product
from typing import Any

from ddpc_cosim.config import ControllerSection, Study
from ddpc_cosim.faults import Faults

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
