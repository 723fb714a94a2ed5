"""Communication step sizes that an FMU allows, and what becomes of a sampling time."""

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.fmu.model_description import FMUDescription, Interface

# Beyond that, an FMU's preferred step is not meant for communication.
_MOST_SUBSTEPS = 10_000
_WHOLE = 1e-6


class StepSizes:
    """The step sizes of one FMU in one run.

    An FMU whose step size is fixed is stepped with the step size that its default experiment prefers if that
    divides the sampling time; inputs are held meanwhile.

    Parameters
    ----------
    description : FMUDescription
        The FMU.
    interface : Interface
        How it is run.
    label : str
        The FMU's file name, for errors.
    """

    def __init__(self, description: FMUDescription, interface: Interface, label: str) -> None:
        self._interface = interface
        self._preferred = description.default_experiment.step_size
        self._label = label
        self._current: float | None = None

    def substeps(self, h: float) -> int:
        """Return how many communication steps make a sample of length h [s].

        Raises
        ------
        ConfigError
            The FMU does not allow that sampling time.
        """
        if self._interface.kind == "model-exchange":
            return 1
        fixed = self._interface.fixed_step
        if fixed is not None and _whole(h, fixed) is None:
            raise ConfigError(
                f"{self._label}: a sampling time of {h:g} s is not possible: the FMU's internal step size is "
                f"fixed at {fixed:g} s; choose a whole multiple of it"
            )
        if self._interface.variable_step:
            return 1
        steps = _whole(h, self._preferred) if self._preferred and fixed is None else 1
        return steps if steps is not None and steps <= _MOST_SUBSTEPS else 1

    def change(self, h: float) -> int:
        """Return the same during a run, in which a fixed step size cannot change.

        Raises
        ------
        ConfigError
            It would.
        """
        if not self._interface.variable_step and self._current is not None:
            raise ConfigError(
                f"{self._label}: the step size cannot change from {self._current:g} s to {h:g} s: "
                "the FMU's is fixed during a run (canHandleVariableCommunicationStepSize is false)"
            )
        substeps = self.substeps(h)
        self._current = h
        return substeps


def _whole(h: float, step: float) -> int | None:
    """Return how many steps make h, None if that is no whole number."""
    ratio = h / step
    steps = round(ratio)
    return steps if steps >= 1 and abs(ratio - steps) <= _WHOLE * steps else None
