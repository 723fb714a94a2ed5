"""Faults of settings, told together."""

from collections.abc import Callable, Sequence

import numpy as np

from ddpc_cosim import ConfigError, Controller, FloatArray, Weight, check_settings, weight_matrix


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


def all_positive(value: object) -> bool:
    """Whether a value is a number, or numbers, finite and above zero."""
    try:
        array = np.asarray(value)
    except ValueError:  # lists of different lengths
        return False
    return array.dtype.kind in "iuf" and bool(np.all(np.isfinite(array) & (array > 0.0)))
