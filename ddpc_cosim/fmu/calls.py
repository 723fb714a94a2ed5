"""What FMI functions return, and the error for what does not succeed."""

from ddpc_cosim.errors import StepStatus

STATUS_WORDS = ("ok", "warning", "discard", "error", "fatal", "pending")
WARNING, DISCARD, ERROR, FATAL = 1, 2, 3, 4

_STATUS = {DISCARD: StepStatus.DISCARD, FATAL: StepStatus.FATAL}


def status_word(status: int) -> str:
    """Return an FMI status in words."""
    return STATUS_WORDS[status] if 0 <= status < len(STATUS_WORDS) else f"illegal status {status}"


class CallError(Exception):
    """An FMI function did not succeed.

    Parameters
    ----------
    reason : str
        What happened.
    code : int
        FMI status that stands for it.
    asks_to_terminate : bool
        Whether the FMU wants the simulation to end.
    """

    def __init__(self, reason: str, code: int = ERROR, *, asks_to_terminate: bool = False) -> None:
        super().__init__(reason)
        self.code = code
        self.asks_to_terminate = asks_to_terminate

    @property
    def status(self) -> StepStatus:
        """The status in the terms of the contracts."""
        return _STATUS.get(self.code, StepStatus.ERROR)


def failed_call(function: str, status: int, *, asks_to_terminate: bool = False) -> CallError:
    """Return the error for a status that is neither ok nor warning."""
    reason = f"{function} returned {status_word(status)}"
    return CallError(reason, status, asks_to_terminate=asks_to_terminate)


def termination(function: str) -> CallError:
    """Return the error for a call that succeeded, but in which the FMU asks to terminate."""
    return CallError(f"{function} ended the simulation", DISCARD, asks_to_terminate=True)


def missing_function(name: str) -> CallError:
    """Return the error for a function that is needed and that the library does not have."""
    return CallError(f"the FMU's library has no function {name}, which is needed here")
