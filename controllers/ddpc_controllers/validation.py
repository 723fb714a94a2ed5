"""Faults of settings, told together."""

from collections.abc import Callable, Sequence

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
