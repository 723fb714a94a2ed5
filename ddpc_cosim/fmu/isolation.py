"""An FMU in a process of its own: when it crashes or hangs, that process ends and the caller lives.

It protects against faults, not against malice: the FMU's code runs with the user's rights there as well.
"""

import math
import os
import signal
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import monotonic
from typing import Any

from ddpc_cosim.errors import ConfigError, FMUStepError, StepStatus
from ddpc_cosim.fmu.archive import UnpackLimits
from ddpc_cosim.fmu.isolation_frames import Frame, pack, unpack, write_all
from ddpc_cosim.fmu.isolation_launch import Child, Ending, launch
from ddpc_cosim.fmu.isolation_messages import FREE_STATES, RESTORE_STATE, SAVE_STATE, Call, Job, Opened, Reply
from ddpc_cosim.fmu.linearisation import Derivatives, LinearModel
from ddpc_cosim.fmu.scratch import ScratchFolder
from ddpc_cosim.plant import FMIType, ParameterValue
from ddpc_cosim.variables import FloatArray

_OUTPUT_SHOWN = 300
_FIRST_WINDOWS_FAULT = 0xC0000000
_PHASES = {"reset": "initialisation", "close": "terminate"}


class IsolatedSession:
    """One FMU in a child process, with the methods of :class:`FMUSession`.

    A crash, or a call that does not return in time, ends the child and raises :class:`FMUStepError`; the next
    ``reset`` starts another.

    Parameters
    ----------
    path, inputs, outputs, fmi_type, tolerance, unpack_limits
        As of :class:`FMUSession`.
    step_timeout : float
        Longest time for any call, loading and terminating included [s].

    Raises
    ------
    CosimError
        As :class:`FMUSession`; FMUStepError if the FMU crashes or does not return.
    """

    def __init__(
        self,
        path: Path,
        *,
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
        fmi_type: FMIType = "auto",
        tolerance: float | None = None,
        unpack_limits: UnpackLimits | None = None,
        step_timeout: float = 60.0,
    ) -> None:
        if not 0 < step_timeout < math.inf:
            raise ConfigError(f"step_timeout = {step_timeout} is not possible; allowed: a finite number > 0")
        self.path = Path(path).absolute()
        self._settings: dict[str, Any] = {
            "inputs": inputs,
            "outputs": outputs,
            "fmi_type": fmi_type,
            "tolerance": tolerance,
            "unpack_limits": unpack_limits,
        }
        self._timeout = step_timeout
        self._plan: tuple[float, float] | None = None
        self._freed_states: list[int] = []
        self._time = 0.0
        self.warnings: tuple[str, ...] = ()
        self._process: _Process | None = None
        opened = self._open()
        self.description, self.interface = opened.description, opened.interface
        self.inputs, self.outputs = opened.inputs, opened.outputs
        self._request, self._reply = Frame(len(self.inputs)), Frame(len(self.outputs))

    def plan(self, sampling_time: float, stop_time: float) -> None:
        """Say what the coming run will ask: as :meth:`FMUSession.plan`."""
        self._plan = sampling_time, stop_time
        if self._process is not None:
            self._call("plan", *self._plan)

    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        """Initialise the FMU anew, in another process if it has brought down the last one."""
        if self._process is None:
            self._open()
            if self._plan is not None:
                self._call("plan", *self._plan)
        y: FloatArray = self._call("reset", dict(parameters or {}), t0)
        return y

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold the inputs u, shape (m,), over h [s] and return the outputs at its end, shape (p,).

        Raises
        ------
        FMUStepError
            The FMU did not get there, crashed, or did not return in time.
        """
        process, request, reply = self._process, self._request, self._reply
        if process is None:
            raise self._not_there("step")
        request.mark()
        request.scalar = h
        request.values[:] = u
        try:
            process.write(request.memory)
            received = process.read_into(reply.memory, self._timeout)
        except OSError as error:
            raise self._lost("step", error) from error
        except BaseException:  # interrupted, with an answer still to come
            self._end()
            raise
        if reply.is_step(received):
            self._time = reply.scalar
            return reply.values.copy()
        y: FloatArray = self._received("step", process, bytes(reply.memory[:received]))
        return y

    def set_parameters(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Change tunable parameters from the next step on."""
        self._call("set_parameters", dict(parameters))

    def linearise(self, u: FloatArray | None = None, derivatives: Derivatives = "auto") -> LinearModel:
        """Return the linear model about where the run is: as :meth:`FMUSession.linearise`."""
        model: LinearModel = self._call("linearise", u, derivatives)
        return model

    @property
    def can_save_state(self) -> bool:
        """Whether the FMU says that its state can be saved."""
        return self.interface.can_save_state

    def save_state(self) -> object:
        """Return a handle to a copy of the FMU's state, which stays in the child process."""
        freed = self._freed_states
        if freed:
            self._call(FREE_STATES, *(freed.pop() for _ in range(len(freed))))
        number = self._call(SAVE_STATE)
        return _SavedState(number, self._process, freed)

    def restore_state(self, state: object) -> None:
        """Go back to a saved state of this run."""
        if not isinstance(state, _SavedState) or state.process is not self._process:
            raise ConfigError(f"{self.path.name}: the state to restore was not saved in this run")
        self._call(RESTORE_STATE, state.number)

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return self._time

    def close(self) -> None:
        """Terminate and free the FMU, and end its process.

        Raises
        ------
        FMUStepError
            The FMU crashes, or does not return; its process has been ended nevertheless.
        """
        if self._process is not None:
            self._call("close")
            self._end()

    def _open(self) -> Opened:
        self._process = process = _Process()
        self._freed_states = []  # those of an earlier process went with it
        job = Job(self.path, self._settings, process.folder.path, str(Path.cwd()), dict(os.environ))
        try:
            opened: Opened = self._exchange("loading", process, job)
        except BaseException:
            self._end()
            raise
        return opened

    def _call(self, method: str, *arguments: Any) -> Any:
        """Call a method of the session in the child."""
        if self._process is None:
            raise self._not_there(method)
        return self._exchange(method, self._process, Call(method, arguments))

    def _exchange(self, method: str, process: "_Process", message: object) -> Any:
        """Send a message and return what is replied to it."""
        try:
            write_all(process.write, memoryview(pack(message)))
        except OSError as error:
            raise self._lost(method, error) from error
        except BaseException:
            self._end()
            raise
        return self._received(method, process, b"")

    def _received(self, method: str, process: "_Process", beginning: bytes) -> Any:
        """Return what is replied, of which the beginning is there already, or raise what the call raised."""
        deadline = monotonic() + self._timeout

        def read_into(memory: memoryview) -> int:
            return process.read_into(memory, max(deadline - monotonic(), 0.0))

        try:
            reply: Reply = unpack(beginning, read_into)
        except (OSError, EOFError) as error:
            raise self._lost(method, error) from error
        except BaseException:
            self._end()
            raise
        self._time, self.warnings = reply.time, reply.warnings
        if reply.error is not None:
            raise reply.error
        return reply.result

    def _lost(self, method: str, error: Exception) -> FMUStepError:
        """End the process, which cannot be talked to any more, and return the error that says why."""
        ending = self._end()
        place = f"in {_PHASES.get(method, method)} at t = {self._time:g} s"
        if isinstance(error, TimeoutError):
            return FMUStepError(
                f"{self.path.name}: no return within {self._timeout:g} s {place}; its process was ended; "
                "raise step_timeout if the FMU needs longer",
                StepStatus.TIMED_OUT,
                self._time,
            )
        message = f"{self.path.name}: crashed {place}: {_in_words(ending)}"
        return FMUStepError(message, StepStatus.CRASHED, self._time)

    def _not_there(self, method: str) -> ConfigError:
        return ConfigError(f"{self.path.name}: {method} before reset")

    def _end(self) -> Ending:
        process, self._process = self._process, None
        return process.end() if process is not None else Ending(None)


class _Process:
    """The child process and the folder for its temporary files, which go together."""

    def __init__(self) -> None:
        self.folder = ScratchFolder()
        try:
            child = launch()
        except BaseException:
            self.folder.remove()
            raise
        self.write, self.read_into = child.write, child.read_into
        self._child = child
        self._finalizer = weakref.finalize(self, _end_at_leisure, child, self.folder)

    def end(self) -> Ending:
        """End the process and remove its folder."""
        ending = self._child.end()
        self._finalizer()
        return ending


def _end_at_leisure(child: Child, folder: ScratchFolder) -> None:
    child.end(at_leisure=True)
    folder.remove()


class _SavedState:
    """A state that is kept in the child under a number, and freed there some time after this object."""

    def __init__(self, number: int, process: "_Process | None", freed: list[int]) -> None:
        self.number, self.process = number, process
        weakref.finalize(self, freed.append, number)


def _in_words(ending: Ending) -> str:
    """Say how a process ended, and what it printed last."""
    code, printed = ending.code, " ".join(ending.output.split())[-_OUTPUT_SHOWN:]
    words = f"; it printed: {printed}" if printed else ""
    if code is None:
        return f"its process has gone{words}"
    if code >= _FIRST_WINDOWS_FAULT:
        return f"its process ended with exception {code:#x}{words}"
    if code >= 0:
        return f"its process ended with exit code {code}{words}"
    try:
        number = signal.Signals(-code)
    except ValueError:
        return f"signal {-code}{words}"
    return f"{number.name} ({signal.strsignal(number) or 'unknown'}){words}"
