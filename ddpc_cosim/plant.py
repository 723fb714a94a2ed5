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
    state_is_data: bool = False
    """Whether what ``save_state`` returns is the whole state, in numbers, texts, bytes, arrays of numbers,
    and tuples, lists and dicts of these.

    Then another run of the same plant, reset with the same parameters, can go on from it, also one in another
    process: ``ddpc-cosim simulate`` can save it to a file.
    """
    is_sampled: bool = False
    """Whether it answers to its inputs as they are when a step begins, and holds its outputs over it."""
    is_noisy: bool = False
    """Whether noise of its own acts on it: what that scatters the outputs is held against no controller."""

    def plan(self, sampling_time: float, stop_time: float) -> None:  # noqa: B027 - most plants take any run
        """Announce sampling and stop time of the next runs, before ``reset``.

        Parameters
        ----------
        sampling_time : float
            Communication step size [s].
        stop_time : float
            Time of the last sample [s]; infinite for a run that another one may go on from.

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

    @property
    def can_serialise_state(self) -> bool:
        """Whether ``serialise_state`` and ``deserialise_state`` work.

        A plant that is written in Python need not have them: for one whose ``state_is_data`` it is done.
        """
        return False

    def serialise_state(self) -> bytes:
        """Return the state as bytes, for ``deserialise_state`` in another run of the same plant.

        Raises
        ------
        ConfigError
            The plant cannot, and why: before ``reset`` too.
        FMUStepError
            The plant failed.
        """
        raise ConfigError(f"{type(self).__name__}: the state cannot be saved as bytes")

    def deserialise_state(self, content: bytes) -> FloatArray:
        """Go on from the state of another run, after a reset with the same parameters.

        The inputs that are driven may be others than in that run. A state that comes from others can make an
        FMU do what its library can be made to do by it.

        Parameters
        ----------
        content : bytes
            What ``serialise_state`` of the same plant returned.

        Returns
        -------
        y : array, shape (p,)
            Outputs there, in their units.

        Raises
        ------
        ConfigError
            It is not a state of this plant.
        FMUStepError
            The plant failed.
        """
        raise ConfigError(f"{type(self).__name__}: the state cannot be restored from bytes")

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
