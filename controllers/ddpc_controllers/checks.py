"""Checks of settings, reported together, and of measurements; what a controller goes by, in words."""

from collections.abc import Callable, Sequence
from math import isfinite

import numpy as np

from ddpc_cosim import (
    ConfigError,
    Controller,
    FloatArray,
    Loop,
    Variable,
    Weight,
    check_settings,
    weight_matrix,
)


def check_settings_and(controller: Controller, faults_between: Callable[[], Sequence[str]]) -> None:
    """Check every setting of a controller, and then how they fit each other.

    Raises
    ------
    ConfigError
        Every fault. How settings fit each other is only asked where each of them is possible.
    """
    check_settings(controller)
    faults = faults_between()
    if faults:
        raise ConfigError(faults)


def prior_info(plant: str, *signals: Sequence[Variable]) -> dict[str, str]:
    """Return the facts of :meth:`ddpc_cosim.Controller.knowledge`.

    Parameters
    ----------
    plant : str
        The prior information of a controller about the plant.
    *signals : sequence of Variable
        What it uses of outputs and measurements; one that is both is named once.
    """
    named = dict.fromkeys(variable.name for some in signals for variable in some)
    return {"measures": ", ".join(named), "plant": plant}


def without_forecast(facts: dict[str, str], loop: Loop) -> dict[str, str]:
    """Return the facts of a controller that makes nothing of what is known ahead of disturbances."""
    return facts | ({"forecast": "not used"} if loop.disturbances else {})


def weight_matrices(**weights: tuple[Weight, int]) -> list[FloatArray]:
    """Return weights as matrices, in the order given.

    Parameters
    ----------
    **weights : (weight, int)
        Each weight under its setting's name, with the number of signals it weighs.

    Raises
    ------
    ConfigError
        Every weight that does not fit its signals.
    """
    matrices: list[FloatArray] = []
    faults: list[str] = []
    for name, (weight, size) in weights.items():
        try:
            matrices.append(weight_matrix(weight, size, name))
        except ConfigError as error:
            faults.extend(error.faults)
    if faults:
        raise ConfigError(faults)
    return matrices


def per_signal(name: str, value: Weight, size: int) -> FloatArray:
    """Return a number, or one number for each signal, as an array of shape (size,).

    Raises
    ------
    ConfigError
        There are more or fewer numbers than signals.
    """
    array = np.asarray(value, dtype=float)
    if array.ndim > 1 or (array.ndim == 1 and len(array) != size):
        raise ConfigError(f"{name} has shape {array.shape}; needed: a number or {size} numbers")
    return np.full(size, array)


def all_finite(values: FloatArray) -> bool:
    """Return whether all of a few values are finite."""
    return isfinite(sum(values.tolist()))


def fill_missing(values: FloatArray, expected: FloatArray) -> FloatArray:
    """Return values, shape (n,), with those expected in place of missing measurements."""
    return np.asarray(np.where(np.isfinite(values), values, expected))


class LastMeasurement:
    """The last finite value of every measured signal, and which of the signals are outputs.

    Parameters
    ----------
    measured : array, shape (T, q)
        What was recorded, time along axis 0.
    y : array, shape (T, p)
        The outputs recorded at the same time.

    Attributes
    ----------
    newest : array, shape (q,)
        The last finite value of every signal; changed in place.
    shared : (array, array)
        The numbers of the signals that are outputs, and of these outputs.
    """

    def __init__(self, measured: FloatArray, y: FloatArray) -> None:
        self.newest: FloatArray = measured[-1].copy()
        same = (measured[:, :, np.newaxis] == y[:, np.newaxis, :]).all(axis=0)
        self.shared = np.nonzero(same)

    def take(self, measured: FloatArray) -> FloatArray:
        """Take the signals, shape (q,), all of them finite."""
        self.newest[...] = measured
        return measured

    def complete(self, measured: FloatArray, y: FloatArray | None = None) -> FloatArray:
        """Return the signals, shape (q,), missing ones as the outputs y, shape (p,), or as they were."""
        if y is not None:
            signals, outputs = self.shared
            self.newest[signals] = y[outputs]
        self.newest[...] = fill_missing(measured, self.newest)
        return self.newest
