"""Integrators for Model Exchange: one internal step at a time, with the detection of state events."""

from functools import cache
from typing import Protocol

import numpy as np

from ddpc_cosim.fmu.instance import Model
from ddpc_cosim.variables import FloatArray


class Integrator(Protocol):
    """Integrates the continuous states of a model."""

    def restart(self, t: float, *, nominals_changed: bool = False) -> None:
        """Start anew at a time [s], from the states that the model has there."""

    def advance(self, target: float) -> tuple[float, bool]:
        """Do one internal step, not beyond ``target`` [s].

        Returns
        -------
        t : float
            Where it ended; the model has this time and the states there.
        state_event : bool
            Whether an event indicator has changed its sign.

        Raises
        ------
        CallError
            The model failed, or the integrator did.
        """

    def close(self) -> object:
        """Free what the integrator holds."""


def make_integrator(model: Model, states: int, event_indicators: int, tolerance: float) -> Integrator:
    """Return CVode where FMPy ships it, else SciPy's BDF; nothing is integrated if nothing is continuous."""
    if states == 0 and event_indicators == 0:
        return NoIntegrator(model)
    if has_cvode():
        from ddpc_cosim.fmu.cvode import CVodeIntegrator

        return CVodeIntegrator(model, states, event_indicators, tolerance)
    from ddpc_cosim.fmu.scipy_integrator import ScipyIntegrator

    return ScipyIntegrator(model, states, event_indicators, tolerance)


@cache
def has_cvode() -> bool:
    """Whether FMPy ships CVode for this platform."""
    try:
        import fmpy.sundials  # noqa: F401
    except (OSError, AttributeError, ImportError):
        return False
    return True


class NoIntegrator:
    """For models without continuous states and event indicators: time jumps from event to event."""

    def __init__(self, model: Model) -> None:
        self._model = model

    def restart(self, t: float, *, nominals_changed: bool = False) -> None:
        """Nothing is to be done."""

    def close(self) -> None:
        """Nothing is held."""

    def advance(self, target: float) -> tuple[float, bool]:
        """Jump to ``target``."""
        self._model.set_time(target)
        return target, False


def absolute_tolerances(nominals: FloatArray, tolerance: float) -> FloatArray:
    """Return the absolute tolerance of each state; a nominal value that is none counts as 1."""
    usable = np.isfinite(nominals) & (nominals != 0.0)
    return tolerance * np.abs(np.where(usable, nominals, 1.0))


def too_close(t: float, target: float) -> bool:
    """Whether two times [s] are too close for an integrator to step from one to the other."""
    return target - t <= 1e-14 * max(abs(t), abs(target))
