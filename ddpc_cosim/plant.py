"""The plant contract: what an FMU becomes, and what a plant written in Python implements."""

from abc import ABC, abstractmethod
from collections.abc import Mapping

from ddpc_cosim.variables import FloatArray, Variable


class Plant(ABC):
    """A sampled plant with zero-order hold at its inputs.

    The co-simulation master calls, in this order: ``reset`` once per run, then ``step`` (with
    ``set_parameters`` between two steps when an event asks for it), and ``close`` at the end.
    Subclasses set ``inputs`` (m variables) and ``outputs`` (p variables).
    """

    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]

    @abstractmethod
    def reset(self, parameters: Mapping[str, float] | None = None, t0: float = 0.0) -> FloatArray:
        """Go to the initial state and return the outputs there.

        Parameters
        ----------
        parameters : mapping of str to float, optional
            Values that differ from the plant's defaults during this run.
        t0 : float
            Start time [s].

        Returns
        -------
        y0 : array, shape (p,)
            Outputs at t0, in their units.

        Raises
        ------
        ConfigError
            A parameter is unknown or its value impossible.
        FMUStepError
            The plant could not be initialised.
        """

    @abstractmethod
    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold the inputs over one communication step.

        Parameters
        ----------
        u : array, shape (m,)
            Inputs held over [t, t + h), in their units.
        h : float
            Communication step size [s].

        Returns
        -------
        y : array, shape (p,)
            Outputs at t + h, in their units; a new array at every call.

        Raises
        ------
        FMUStepError
            The plant did not reach t + h.
        """

    def set_parameters(self, parameters: Mapping[str, float]) -> None:
        """Change tunable parameters from the next step on.

        Raises
        ------
        ConfigError
            The plant has no such tunable parameter.
        """
        if parameters:
            from ddpc_cosim.errors import ConfigError

            raise ConfigError(f"{type(self).__name__}: no tunable parameters ({', '.join(parameters)})")

    def close(self) -> None:  # noqa: B027 - most plants hold nothing
        """Release everything; the plant is not used afterwards."""

    def provenance(self) -> Mapping[str, str]:
        """Return what identifies this plant in a report: file, hash, version."""
        return {"class": f"{type(self).__module__}:{type(self).__qualname__}"}
