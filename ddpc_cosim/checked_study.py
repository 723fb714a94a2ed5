"""A study that fits its plant, and its values in the units of the plant's variables."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ddpc_cosim.config import BoundsSection, Study
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.fmu.units import conversions
from ddpc_cosim.plants import PlantSignals, PlantSource
from ddpc_cosim.variables import FloatArray, Variable


@dataclass(frozen=True, slots=True)
class CheckedStudy:
    """A study that fits its plant and its controllers.

    Parameters
    ----------
    study : Study
        The file's content.
    folder : Path
        The file's folder.
    plant : PlantSource
        The plant it names.
    signals : PlantSignals
        The plant's variables.
    inputs, outputs, measurements : tuple of str
        The signals that take part, with the defaults filled in.
    """

    study: Study
    folder: Path
    plant: PlantSource
    signals: PlantSignals
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    measurements: tuple[str, ...]


def converter(variable: Variable, unit: str) -> Callable[[float], float]:
    """Return the conversion of a study's values from ``unit`` to the variable's own unit.

    Raises
    ------
    ConfigError
        The unit is neither the variable's unit nor its display unit, and there is no usual conversion.
    """
    if unit in ("", variable.unit):
        return float
    declared = () if variable.display_unit is None else (variable.display_unit,)
    known = conversions(variable.unit, declared)
    if unit not in known:
        allowed = dict.fromkeys((variable.unit or "1", *(shown.name for shown in declared), *known))
        names = ", ".join(name for name in allowed if name)
        raise ConfigError(f'unit "{unit}" does not fit {variable.name}; allowed: {names}')
    shown = known[unit]
    return lambda value: (value - shown.offset) / shown.factor


def limits(
    bounds: Mapping[str, BoundsSection], variables: Mapping[str, Variable], names: Iterable[str]
) -> dict[str, tuple[float, float]]:
    """Return the limits of the named variables in their own units: the study's, else the plant's."""
    table = {}
    for name in names:
        variable, section = variables[name], bounds.get(name, BoundsSection())
        convert = converter(variable, section.unit)
        low = variable.min if section.min is None else convert(section.min)
        high = variable.max if section.max is None else convert(section.max)
        table[name] = (low, high)
    return table


def excitation_range(checked: CheckedStudy) -> tuple[FloatArray, FloatArray] | None:
    """Return low and high of the excitation of all inputs, each of shape (m,), in their units."""
    recording = checked.study.recording
    if recording is None:
        return None
    pairs = []
    for name in checked.inputs:
        section: Any = recording.excitation[name]
        convert = converter(checked.signals.inputs[name], section.unit)
        pairs.append((convert(section.low), convert(section.high)))
    low, high = np.array(pairs, dtype=float).T
    return low, high
