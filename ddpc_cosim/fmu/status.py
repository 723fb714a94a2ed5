"""What FMI functions return and what FMUs say: statuses, the error for a failed call, the log of an instance.

Of each instance the last lines are kept; nothing is printed. FMPy's C proxy, which formats messages in the
manner of printf, remembers a single callback for the whole process. So there is a single one here that is
never released; it finds the instance by its environment pointer (FMI 2.0) or by its name (FMI 1.0).
"""

import ctypes
from collections import deque
from itertools import count
from typing import Any

import fmpy
import fmpy.fmi1
import fmpy.fmi2
import fmpy.fmi3

from ddpc_cosim.errors import StepStatus

STATUS_WORDS = ("ok", "warning", "discard", "error", "fatal", "pending")
OK, WARNING, DISCARD, ERROR, FATAL = range(5)
SUCCESS = frozenset((OK, WARNING))
"""The statuses of a call that has done what it should; any other number is a failure, also a negative one."""

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
    reached : float or None
        The time that a step has reached all the same [s], where the FMU tells.
    """

    def __init__(
        self,
        reason: str,
        code: int = ERROR,
        *,
        asks_to_terminate: bool = False,
        reached: float | None = None,
    ) -> None:
        super().__init__(reason)
        self.code = code
        self.asks_to_terminate = asks_to_terminate
        self.reached = reached

    @property
    def status(self) -> StepStatus:
        """The status in the terms of the contracts."""
        return StepStatus.TERMINATED if self.asks_to_terminate else _STATUS.get(self.code, StepStatus.ERROR)


def failed_call(function: str, status: int) -> CallError:
    """Return the error for a status that is not among :data:`SUCCESS`."""
    return CallError(f"{function} returned {status_word(status)}", status)


def termination(what: str, reached: float | None = None) -> CallError:
    """Return the error for a call or an event in which the FMU asks to terminate, at the time it reached."""
    return CallError(f"{what} ended the simulation", DISCARD, asks_to_terminate=True, reached=reached)


def missing_function(name: str) -> CallError:
    """Return the error for a function that is needed and that the library does not have."""
    return CallError(f"the FMU's library has no function {name}, which is needed here")


_LINES_KEPT = 20
_LINE_LENGTH = 500

_numbers = count(1)


class Log:
    """The last messages of one instance.

    Parameters
    ----------
    name : str
        What the instance is called in its own messages; made unique in this process.
    """

    def __init__(self, name: str) -> None:
        self.number = next(_numbers)
        self.instance_name = name if self.number == 1 else f"{name}-{self.number}"
        self.lines: deque[str] = deque(maxlen=_LINES_KEPT)
        _logs[self.number] = _logs[self.instance_name] = self

    def add(self, status: int, message: bytes | None) -> None:
        """Keep a message."""
        text = (message or b"")[: 4 * _LINE_LENGTH].decode("utf-8", "replace")[:_LINE_LENGTH].strip()
        self.lines.append(f"[{status_word(status)}] {text}")

    def close(self) -> None:
        """Forget the instance; what it says afterwards is dropped."""
        _logs.pop(self.number, None)
        _logs.pop(self.instance_name, None)


_logs: dict[int | str, Log] = {}


def _on_message(first: int | None, name: bytes | None, status: int, _: bytes, message: bytes) -> None:
    log = _logs.get(first or 0) or _logs.get((name or b"").decode("utf-8", "replace"))
    if log is not None:
        log.add(status, message)


def _callbacks(module: Any, version: str) -> Any:
    """Return the callback structure of FMI 1.0 or 2.0, with the process's one logger."""
    callbacks = getattr(module, f"{version}CallbackFunctions")()
    callbacks.logger = getattr(module, f"{version}CallbackLoggerTYPE")(_on_message)
    callbacks.allocateMemory = getattr(module, f"{version}CallbackAllocateMemoryTYPE")(fmpy.calloc)
    callbacks.freeMemory = getattr(module, f"{version}CallbackFreeMemoryTYPE")(fmpy.free)
    add_proxy = getattr(module, "addLoggerProxy", None)
    if add_proxy is not None:  # not built for every platform
        add_proxy(ctypes.byref(callbacks))
    return callbacks


# The logger is the first of these that the proxy sees; both have the same C signature.
FMI1_CALLBACKS = _callbacks(fmpy.fmi1, "fmi1")
_FMI2_TEMPLATE = _callbacks(fmpy.fmi2, "fmi2")


def fmi2_callbacks(log: Log) -> Any:
    """Return the callback structure of an FMI 2.0 instance; it must live as long as the instance."""
    callbacks = fmpy.fmi2.fmi2CallbackFunctions.from_buffer_copy(_FMI2_TEMPLATE)
    callbacks.componentEnvironment = log.number
    return callbacks


def fmi3_logger(log: Log) -> Any:
    """Return the message callback of an FMI 3.0 instance."""
    return lambda _, status, __, message: log.add(status, message)
