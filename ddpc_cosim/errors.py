"""The one exception family: each error says what, where and what to do.

CosimError
├── ConfigError       a study, a setting or a call is wrong
│   └── MissingLibraryError   what is asked for needs an optional package that is not installed
├── DataError         a recording cannot serve the purpose
│   └── DivergenceError   the plant diverged while it was recorded
├── ControllerError   a controller raised, or returned something unusable
├── PluginError       a plug-in cannot be found or loaded
├── FMUImportError    an FMU cannot be loaded
└── FMUStepError      an FMU failed during a run
"""

from collections.abc import Sequence
from enum import StrEnum

from fmu_plants.installing import how_to_install


class CosimError(Exception):
    """Base of every error that ddpc-cosim raises on purpose."""


class CosimWarning(UserWarning):
    """Something is not as it should be but can be worked with: an FMU that is not quite valid."""


class _FaultsError(CosimError):
    """An error with one or more faults, which are in ``faults``."""

    def __init__(self, faults: str | Sequence[str]) -> None:
        self.faults = (faults,) if isinstance(faults, str) else tuple(faults)
        super().__init__("\n".join(self.faults))

    def __reduce__(self) -> tuple[type["_FaultsError"], tuple[tuple[str, ...]]]:
        return type(self), (self.faults,)


class ConfigError(_FaultsError):
    """A study, a setting or a call is wrong; all faults found are in ``faults``."""


class MissingLibraryError(ConfigError):
    """What is asked for needs an optional package that is not installed, and how it is.

    A controller that raises it when it is made is told of before the first case of a study is run, and does
    not keep the others from running.

    Examples
    --------
    >>> print(MissingLibraryError.of("NMPC", "CasADi", "nmpc"))
    NMPC needs CasADi: `pip install ".[nmpc]"` or `uv sync --extra nmpc`, in a checkout of ddpc-cosim
    """

    @classmethod
    def of(cls, what: str, library: str, extra: str) -> "MissingLibraryError":
        """Return the error that something needs a library, which an extra of this project installs."""
        return cls(f"{what} needs {library}: {how_to_install(extra)}")


class DataError(_FaultsError):
    """A recording or a file of data is malformed, too short or not persistently exciting enough."""


class DivergenceError(DataError):
    """The plant returned a value that is not finite during the experiment."""


class ControllerError(CosimError):
    """A controller raised an exception or returned an unusable action."""


class PluginError(CosimError):
    """A plug-in cannot be found or loaded."""


class FMUImportError(CosimError):
    """An FMU cannot be loaded, and why."""


def is_of_the_machine(error: BaseException) -> bool:
    """Return whether an error may not come again on another day, or on another machine.

    At its root is an FMU that cannot be loaded, what the system refuses, memory, or a module that is missing.
    """
    causes: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None and cause not in causes:
        causes.append(cause)
        cause = cause.__cause__ or cause.__context__
    return any(isinstance(cause, FMUImportError | OSError | MemoryError | ImportError) for cause in causes)


def is_of_usage(error: CosimError) -> bool:
    """Return whether an error is of what was asked for (names, settings, files): nothing failed in a run."""
    usage = (ConfigError, DataError, PluginError, FMUImportError)
    return isinstance(error, usage) and not isinstance(error, DivergenceError)


class StepStatus(StrEnum):
    """What a plant's call that did not succeed returned, why it did not return, or that it ended the run."""

    ERROR = "error"
    DISCARD = "discard"
    FATAL = "fatal"
    CRASHED = "crashed"
    TIMED_OUT = "timed-out"
    TERMINATED = "terminated"


class FMUStepError(CosimError):
    """An FMU call failed during a run, or a plant ends the run itself.

    Parameters
    ----------
    message : str
        The FMU, the call and the FMU's own words.
    status : StepStatus
        What the call returned; crashed or timed out if it did not (isolated FMUs); terminated: nothing has
        failed, but the plant has come to an end.
    time : float
        Simulation time of the call [s].
    """

    def __init__(self, message: str, status: StepStatus, time: float) -> None:
        super().__init__(message)
        self.message = message
        self.status = StepStatus(status)
        self.time = time

    def __reduce__(self) -> tuple[type["FMUStepError"], tuple[str, StepStatus, float]]:
        return type(self), (self.message, self.status, self.time)


Place = tuple[int | str, ...]
"""The keys that lead to a value of a study file; numbers count the entries of lists."""


def dotted(place: Place) -> str:
    """Return a place as a study file writes it: ``scenarios.windy.events[0].time``."""
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text
