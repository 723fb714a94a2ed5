"""Faults of single settings and faults between settings, told together."""

from collections.abc import Callable, Sequence

from ddpc_cosim import ConfigError, Controller, check_settings


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
