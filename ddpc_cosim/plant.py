"""The plant contract: what an FMU becomes, and what a plant written in Python implements."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Literal, Self

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.variables import FloatArray, Variable

ParameterValue = float | int | bool | str
"""The value of a parameter: a number, a boolean, or a text where the plant has such parameters."""

FMIType = Literal["auto", "co-simulation", "model-exchange"]
"""How an FMU is run; ``"auto"``: for Co-Simulation if it can be."""


def library_path_faults(library_path: Iterable[str | Path]) -> list[str]:
    """Return what is wrong with the places of libraries that FMUs need."""
    return [
        f"library_path: {place}: no such library or folder"
        for place in library_path
        if not Path(place).exists()
    ]


class Plant(ABC):
    """A sampled plant with zero-order hold at its inputs.

    The co-simulation master calls, in this order:

    1. ``plan``, once per run, before ``reset``; may be set.
    2. ``reset``, once per run, at its start time; must be set. An experiment is a run of its own.
    3. ``set_parameters``, at a sample at which an event asks for it; may be set.
    4. ``step``, once per sampling interval: n times for the n + 1 samples of a run; must be set.
    5. ``provenance``, once, after the last sample, however the run ended; may be set.
    6. ``close``, once, after the last run, by whoever has opened the plant; may be set.

    The other methods are called where a plant is a part of a coupled one, as far as it has them: none need be
    set. ``inputs`` and ``outputs`` are read before the first run, and do not change.
    """

    # Set these in all subclasses: m variables and p variables.
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    # These may be set.
    dependencies: Mapping[str, frozenset[str]] = MappingProxyType({})
    """For each output the inputs that it depends on without delay; one that is left out depends on none.

    A plant that says so has :meth:`outputs_at` too: others take its outputs as ``step`` left them.
    """
    switches: Mapping[str, str] = MappingProxyType({})
    """For each input that it has a control of its own for, the input that switches that off.

    Such a switch is not among ``inputs``. Where something drives the input it is 1, else 0: the master gives
    it among the parameters of ``reset``, and of ``set_parameters`` where that changes during a run.
    """
    is_sampled: bool = False
    """Whether it answers to its inputs as they are when a step begins, and holds its outputs over it."""

    def plan(self, sampling_time: float, stop_time: float) -> None:  # noqa: B027 - most plants take any run
        """Announce sampling and stop time of the next runs, before ``reset``.

        Parameters
        ----------
        sampling_time : float
            Communication step size [s].
        stop_time : float
            Time of the last sample [s].

        Raises
        ------
        ConfigError
            The plant cannot run so.
        """

    @abstractmethod
    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        """Go to the initial state and return the outputs there.

        Parameters
        ----------
        parameters : mapping of str to float, int, bool or str, optional
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
            The plant did not reach t + h; with ``StepStatus.TERMINATED`` it ends the run itself.
        """

    def set_parameters(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Change tunable parameters from the next step on.

        Raises
        ------
        ConfigError
            The plant has no such tunable parameter.
        """
        if parameters:
            raise ConfigError(f"{type(self).__name__}: no tunable parameters ({', '.join(parameters)})")

    @property
    def can_give_outputs(self) -> bool:
        """Whether ``outputs_at`` works."""
        return type(self).outputs_at is not Plant.outputs_at

    def outputs_at(self, u: FloatArray) -> FloatArray:
        """Return the outputs now, at other inputs, without time passing.

        Parameters
        ----------
        u : array, shape (m,)
            Inputs, in their units.

        Returns
        -------
        y : array, shape (p,)
            Outputs at the present time, in their units; a new array at every call.

        Raises
        ------
        ConfigError
            The plant's outputs follow its steps only.
        FMUStepError
            The plant could not compute them.
        """
        raise ConfigError(f"{type(self).__name__}: the outputs cannot be computed without a step")

    def feedthrough(self, u: FloatArray) -> FloatArray | None:
        """Return the derivatives of the outputs by the inputs now, shape (p, m); None: not known.

        Parameters
        ----------
        u : array, shape (m,)
            Inputs, in their units.

        Raises
        ------
        FMUStepError
            The plant failed.
        """
        return None

    @property
    def can_save_state(self) -> bool:
        """Whether ``save_state`` and ``restore_state`` work."""
        return False

    def save_state(self) -> object:
        """Return a copy of the state, for ``restore_state`` until the next ``reset``.

        Raises
        ------
        ConfigError
            The plant cannot save its state.
        """
        raise ConfigError(f"{type(self).__name__}: the state cannot be saved")

    def restore_state(self, state: object) -> None:
        """Go back to a state that ``save_state`` returned in this run.

        Raises
        ------
        ConfigError
            The state is not one of this run, or the plant cannot.
        """
        raise ConfigError(f"{type(self).__name__}: the state cannot be restored")

    def close(self) -> None:  # noqa: B027 - most plants hold nothing
        """Release everything; the plant is not used afterwards. The end of a ``with`` block does it."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def provenance(self) -> Mapping[str, str]:
        """Return the identifiers of this plant in a report: file, hash, version."""
        return {"class": f"{type(self).__module__}:{type(self).__qualname__}"}
