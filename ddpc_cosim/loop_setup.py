"""How a plant is wired into a loop: controlled outputs, measurements and their noise, limits, references."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.controller import Bounds
from ddpc_cosim.errors import ConfigError, did_you_mean
from ddpc_cosim.plant import Plant
from ddpc_cosim.signals import GaussianNoise, Reference
from ddpc_cosim.variables import FloatArray, Variable, names


@dataclass(frozen=True, slots=True)
class Wiring:
    """Which of the plant's outputs are controlled and which are measured.

    Parameters
    ----------
    outputs, measurements : tuple of Variable
        The p controlled outputs and the q measurements, in the controller's order.
    output_index, measured_index : array of int, shape (p,), (q,)
        Where they stand among the plant's outputs.
    """

    outputs: tuple[Variable, ...]
    measurements: tuple[Variable, ...]
    output_index: NDArray[np.intp]
    measured_index: NDArray[np.intp]


def wire(plant: Plant, outputs: Sequence[str] | None, measurements: Sequence[str] | None) -> Wiring:
    """Choose controlled outputs (default: all of the plant's) and measurements (default: all).

    Raises
    ------
    ConfigError
        Names that the plant does not have among its outputs, or nothing to drive or to read.
    """
    missing = [what for what, has in (("inputs", plant.inputs), ("outputs", plant.outputs)) if not has]
    if missing:
        raise ConfigError([f"the plant has no {what}: there is nothing to control" for what in missing])
    available = names(plant.outputs)
    controlled = _listed("outputs", outputs) or available
    measured = _listed("measurements", measurements) or available
    check_names("outputs and measurements", dict.fromkeys((*controlled, *measured)), plant.outputs)
    output_index = np.array([available.index(name) for name in controlled], dtype=np.intp)
    measured_index = np.array([available.index(name) for name in measured], dtype=np.intp)
    return Wiring(
        tuple(plant.outputs[i] for i in output_index),
        tuple(plant.outputs[i] for i in measured_index),
        output_index,
        measured_index,
    )


def _listed(what: str, chosen: Sequence[str] | None) -> tuple[str, ...]:
    if isinstance(chosen, str):
        raise ConfigError(f'{what}: needed: a list of names, got the text "{chosen}"')
    listed = tuple(chosen or ())
    twice = [name for name in dict.fromkeys(listed) if listed.count(name) > 1]
    if twice:
        raise ConfigError([f'{what}: "{name}" is listed more than once' for name in twice])
    return listed


class Sensors:
    """What the controller sees of the plant's outputs."""

    def __init__(self, wiring: Wiring, noise: GaussianNoise | None, rng: np.random.Generator) -> None:
        self._outputs, self._measured = wiring.output_index, wiring.measured_index
        self._rng = rng
        deviations = noise.standard_deviation if noise else {}
        plant_outputs = int(max(wiring.output_index.max(), wiring.measured_index.max())) + 1
        self._deviation = np.zeros(plant_outputs)
        for index, variable in zip(wiring.measured_index, wiring.measurements, strict=True):
            self._deviation[index] = deviations.get(variable.name, 0.0)
        self._noisy = bool(self._deviation.any())

    def controlled(self, y_plant: FloatArray) -> FloatArray:
        """Return the controlled outputs without noise, shape (p,)."""
        return y_plant[self._outputs]

    def measure(self, y_plant: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return controlled outputs and measurements with noise, shapes (p,) and (q,)."""
        if self._noisy:
            n = len(self._deviation)
            y_plant = y_plant.copy()
            y_plant[:n] += self._deviation * self._rng.standard_normal(n)
        return y_plant[self._outputs], y_plant[self._measured]


def loop_bounds(plant: Plant, wiring: Wiring, given: Mapping[str, tuple[float, float]]) -> Bounds:
    """Return the limits of inputs and controlled outputs: those given, else the plant's own."""
    check_names("bounds", given, (*plant.inputs, *wiring.outputs))
    faults = [fault for name, pair in given.items() if (fault := _bounds_fault(name, pair))]
    if faults:
        raise ConfigError(faults)
    limits = [
        np.array([given.get(v.name, (v.min, v.max)) for v in variables], dtype=float).reshape(-1, 2)
        for variables in (plant.inputs, wiring.outputs)
    ]
    for table in limits:
        table.setflags(write=False)  # the master saturates at what controllers are shown
    return Bounds(limits[0][:, 0], limits[0][:, 1], limits[1][:, 0], limits[1][:, 1])


def _bounds_fault(name: str, pair: Any) -> str:
    try:
        low, high = map(float, pair)
    except (TypeError, ValueError):
        return f"bounds of {name}: needed: two numbers, got {pair!r}"
    return "" if low < high else f"bounds of {name}: {low:g} must be below {high:g}"


def reference_table(
    reference: Reference | Mapping[str, Reference], outputs: Sequence[Variable], time: FloatArray
) -> FloatArray:
    """Return the references of all outputs at all times, shape (len(time), p)."""
    if isinstance(reference, Reference):
        if len(outputs) != 1:
            raise ConfigError(f"reference: give one for each output: {', '.join(names(outputs))}")
        reference = {outputs[0].name: reference}
    check_names("reference", reference, outputs)
    missing = [name for name in names(outputs) if name not in reference]
    if missing:
        raise ConfigError(f"reference: none for {', '.join(missing)}")
    return np.column_stack([_values(name, reference[name], time) for name in names(outputs)])


def _values(name: str, reference: Reference, time: FloatArray) -> FloatArray:
    """Return the values of one reference, which may be anybody's class, shape (len(time),)."""
    try:
        values = np.asarray(reference.at(time.copy()), dtype=np.float64)
    except Exception as error:
        raise ConfigError(f"reference of {name}: {type(error).__name__}: {error}") from error
    if values.shape != time.shape:
        raise ConfigError(f"reference of {name}: has shape {values.shape}; needed: {time.shape}")
    if not np.isfinite(values).all():
        first = int(np.flatnonzero(~np.isfinite(values))[0])
        raise ConfigError(f"reference of {name}: {values[first]} at t = {time[first]:g} s; needed: finite")
    return values


def check_names(what: str, given: Iterable[str], known: Sequence[Variable]) -> None:
    """Raise ConfigError for every given name that is not among the known variables."""
    unknown = [name for name in given if name not in names(known)]
    if unknown:
        raise ConfigError(
            [f'{what}: no signal "{name}"; {did_you_mean(name, names(known))}' for name in unknown]
        )
