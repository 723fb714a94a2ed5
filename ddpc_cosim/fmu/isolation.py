"""An FMU in a process of its own, for interactive use: a crash or a hang ends that process and not this one.

A step is one message of a fixed size each way, numbers only: a mark, step size or time, inputs or outputs.
"""

import itertools
import pickle
import sys
import warnings
import weakref
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from threading import TIMEOUT_MAX
from typing import Any, TypeVar, TypeVarTuple

import numpy as np

from ddpc_cosim.errors import ConfigError, CosimError, CosimWarning, FMUStepError, StepStatus
from ddpc_cosim.files.texts import recorded
from ddpc_cosim.fmu.linearisation import LinearModel
from ddpc_cosim.fmu.session import FMUSession, UnpackedFMU
from ddpc_cosim.processes.fork_server import ExitStatus
from ddpc_cosim.processes.sandbox import Sandbox
from ddpc_cosim.processes.worker import (
    LONGEST_REPLY,
    Channel,
    UnexpectedError,
    Worker,
    lost,
    reply,
    reply_error,
    result_of,
)
from ddpc_cosim.variables import FloatArray

T = TypeVar("T")
Arguments = TypeVarTuple("Arguments")
_STEP = -1  # where a message has its length
_LONGEST_REMARK = 300
_LARGEST_STATE = LONGEST_REPLY - (1 << 12)  # what else is in a reply is far shorter
# NumPy and zipfile would import these when they are first used there.
_PRELOAD = (__name__, "encodings.cp437", "numpy.ctypeslib")


class Frame:
    """Preallocated memory of a step's request or reply: seen as bytes, and as numbers.

    Parameters
    ----------
    count : int
        Number of inputs or outputs.
    """

    def __init__(self, count: int) -> None:
        self.size = 8 * (2 + count)
        self.memory = memoryview(bytearray(self.size))
        self.mark = self.memory.cast("q")
        self.scalars = self.memory.cast("d")
        self.values: FloatArray = np.frombuffer(self.memory, dtype=np.float64)[2:]

    def receive(self, channel: Channel, seconds: float | None = None) -> int:
        """Receive a step, or the beginning of another message; return how many bytes."""
        received = channel.socket.recv_into(self.memory)
        if 8 <= received < self.size and self.mark[0] == _STEP:
            self.memory[received:] = channel.receive_bytes(self.size - received, seconds)
            received = self.size
        return received


class IsolatedSession:
    """An :class:`FMUSession` in a worker, in which its methods are called.

    A crash, or a call that does not return in time, ends the worker and raises :class:`FMUStepError`; the
    next ``reset`` starts another.

    Parameters
    ----------
    fmu : UnpackedFMU
        The FMU.
    folder : Path
        Where its temporary files go.
    step_timeout : float
        Longest time for any call [s].
    memory_limit : float or None
        Memory that the process may have [GB]; None: half of the machine's.
    sandboxed : bool
        Whether the process is in a sandbox, in which it writes into that folder only.
    """

    def __init__(
        self,
        fmu: UnpackedFMU,
        folder: Path,
        step_timeout: float,
        memory_limit: float | None,
        *,
        sandboxed: bool,
    ) -> None:
        self.fmu = fmu
        self._folder, self._timeout = folder, min(step_timeout, TIMEOUT_MAX)
        self._memory = None if memory_limit is None else int(1e9 * memory_limit)
        traced = fmu.source.trace_calls
        if sandboxed and traced:
            traced.touch()  # it can be written there, and not be made
        written = (folder, *([traced] if traced else []))
        self._sandbox = Sandbox(written, fmu.companions.given) if sandboxed else None
        self._request, self._reply = Frame(len(fmu.inputs)), Frame(len(fmu.outputs))
        self._freed_states: list[int] = []
        self.time, self.remark = 0.0, ""
        self._worker: Worker | None = self._start()

    def call(self, method: Callable[[FMUSession, *Arguments], T], *arguments: *Arguments) -> T:
        """Call a method of the session; ``reset`` in another process if it has brought down the last one."""
        name, sent = method.__name__, list[Any](arguments)
        if name == "reset" and self._worker is None:
            self._worker = self._start()
        if name == "save_state":
            sent = [[self._freed_states.pop() for _ in range(len(self._freed_states))]]
        if name == "restore_state":
            sent = [self._number_of(*sent)]
        worker = self._worker
        if worker is None:
            raise ConfigError(f"{self.fmu.label}: {name} before reset")
        try:
            worker.channel.send(pickle.dumps((name, sent)))
            result: T = self._received(name, worker, b"")
        except BaseException as error:
            self._end_if_lost(name, error)
            raise
        return result

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold the inputs u, shape (m,), over h [s] and return the outputs at its end, shape (p,)."""
        worker, request, answer = self._worker, self._request, self._reply
        if worker is None:
            raise ConfigError(f"{self.fmu.label}: step before reset")
        request.mark[0] = _STEP
        request.scalars[1] = h
        request.values[:] = u
        try:
            worker.channel.socket.sendall(request.memory)
            received = answer.receive(worker.channel, self._timeout)
            if received == answer.size and answer.mark[0] == _STEP:
                self.time = answer.scalars[1]
                return answer.values.copy()
            outputs: FloatArray = self._received("step", worker, bytes(answer.memory[:received]))
        except BaseException as error:
            self._end_if_lost("step", error)
            raise
        return outputs

    def end(self) -> None:
        """Terminate and free the FMU, and end its process, also if the FMU crashes or does not return."""
        if self._worker is not None:
            try:
                self.call(FMUSession.close)
            finally:
                self._end()

    def _start(self) -> Worker:
        worker = Worker(
            serve_session,
            self.fmu,
            folder=self._folder,
            preload=_PRELOAD,
            sandbox=self._sandbox,
            memory=self._memory,
        )
        worker.channel.limit(self._timeout)
        weakref.finalize(self, worker.end)
        self._freed_states = []  # those of an earlier worker went with it
        return worker

    def _received(self, method: str, worker: Worker, beginning: bytes) -> Any:
        """Return what a call returned, or raise what it raised; ValueError: it cannot be read."""
        content = worker.channel.receive(LONGEST_REPLY, beginning, self._timeout)
        try:
            answer, time, remark = result_of(content)
            result, self.time = self._read(method, answer), float(time)
        except UnexpectedError as error:
            raise FMUStepError(f"{self.fmu.label}: {error}", StepStatus.ERROR, self.time) from error
        except FMUStepError as error:
            self.time = error.time
            raise
        except (ArithmeticError, LookupError, TypeError) as error:
            raise ValueError("the reply cannot be read") from error
        if remark and not self.remark:
            self.remark = recorded(str(remark))[:_LONGEST_REMARK]
            warnings.warn(f"{self.fmu.label}: {self.remark}", CosimWarning, stacklevel=4)
        return result

    def _read(self, method: str, answer: Any) -> Any:
        """Return the result of a method, checked for type and shape; ValueError: it does not fit."""
        if method == "linearise":
            texts = {name: tuple(map(str, answer[name])) for name in ("states", "warnings")}
            return LinearModel(**{**answer, **texts})
        if method == "save_state":
            return _SavedState(int(answer), self._worker, self._freed_states)
        if method == "drive":
            if answer is not None and not (isinstance(answer, np.ndarray) and answer.ndim == 1):
                raise ValueError("it is not a vector")
            return answer
        outputs = (len(self.fmu.outputs),)
        if method == "serialise_state":
            return _unpacked(answer)
        shapes = dict.fromkeys(("reset", "step", "outputs_at", "deserialise_state"), outputs)
        shape = (shapes | {"feedthrough": (*outputs, len(self.fmu.inputs))}).get(method)
        if shape is None or (answer is None and method == "feedthrough"):
            return None
        if not isinstance(answer, np.ndarray) or answer.shape != shape:
            raise ValueError("it has other outputs")
        return answer

    def _number_of(self, state: object) -> int:
        """Return the number of a state in the worker."""
        if not isinstance(state, _SavedState) or state.worker is not self._worker:
            raise ConfigError(f"{self.fmu.label}: the state to restore was not saved in this run")
        return state.number

    def _end_if_lost(self, method: str, error: BaseException) -> None:
        """End a worker that cannot be talked to any more; raise FMUStepError if that is its own fault."""
        if isinstance(error, CosimError):
            return
        exit_status = self._end()
        if isinstance(error, OSError | EOFError | ValueError):
            seconds = self._timeout if isinstance(error, TimeoutError | BlockingIOError) else None
            raise lost(self.fmu.label, method, self.time, exit_status, seconds) from error

    def _end(self) -> ExitStatus:
        worker, self._worker = self._worker, None
        return worker.end() if worker is not None else ExitStatus(None)


class _SavedState:
    """A state that is kept in the worker under a number, and freed there some time after this object."""

    def __init__(self, number: int, worker: Worker | None, freed: list[int]) -> None:
        self.number, self.worker = number, worker
        weakref.finalize(self, freed.append, number)


_WORD = 8


def _packed(content: bytes) -> FloatArray:
    """Return bytes, and how many they are, as the numbers that a reply can have."""
    padded = len(content).to_bytes(_WORD, "little") + content + bytes(-len(content) % _WORD)
    return np.frombuffer(padded, dtype=np.float64)


def _unpacked(numbers: Any) -> bytes:
    """Return the bytes that :func:`_packed` was given; ValueError: these are not such numbers."""
    if not isinstance(numbers, np.ndarray):
        raise ValueError("it is not a state")
    raw = numbers.tobytes()
    end = _WORD + int.from_bytes(raw[:_WORD], "little")
    if not len(raw) - _WORD < end <= len(raw):
        raise ValueError("it is not a state")
    return raw[_WORD:end]


def serve_session(channel: Channel, fmu: UnpackedFMU) -> None:
    """Serve the requests of an :class:`IsolatedSession` in a worker, until that is gone."""
    session = _Service(fmu)
    request, answer = Frame(len(fmu.inputs)), Frame(len(fmu.outputs))
    answer.mark[0] = _STEP
    while True:
        received = request.receive(channel)
        if received < request.size or request.mark[0] != _STEP:
            method, arguments = pickle.loads(channel.receive(sys.maxsize, bytes(request.memory[:received])))
            called = partial(session.call, getattr(_Service, method), *arguments)
            reply(channel, lambda: session.reply_content(called()))  # noqa: B023 - called at once
            continue
        try:
            answer.values[:] = session.step(request.values, request.scalars[1])
        except Exception as error:
            reply_error(channel, error)
            continue
        if session.remark and not session.remark_is_sent:
            reply(channel, lambda: session.reply_content(answer.values))
        else:
            answer.scalars[1] = session.time
            channel.socket.sendall(answer.memory)


class _Service(FMUSession):
    """A session of which only numbers and texts leave the worker."""

    def __init__(self, fmu: UnpackedFMU) -> None:
        super().__init__(fmu)
        self._states: dict[int, object] = {}
        self._numbers = itertools.count()
        self.remark_is_sent = False

    def reply_content(self, result: object) -> list[object]:
        """Return the reply to a call: its result, the time of the run, and a remark."""
        self.remark_is_sent = bool(self.remark)
        return [result, self.time, self.remark]

    def _warn(self) -> None:
        """Whoever asks does."""

    def save_state(self, freed: Sequence[int] = ()) -> int:
        """Keep a copy of the state, free others, and return its number."""
        for number in freed:
            self._states.pop(number, None)
        number = next(self._numbers)
        self._states[number] = super().save_state()
        return number

    def serialise_state(self) -> Any:
        """Return the state as numbers; ConfigError: there are more of them than a reply can have."""
        content = super().serialise_state()
        if len(content) > _LARGEST_STATE:
            raise ConfigError(
                f"{self.fmu.label}: its state has {len(content) / 1e6:.0f} MB as bytes; a process of its own "
                f"can return {_LARGEST_STATE / 1e6:.0f} MB: open the FMU with isolated = False"
            )
        return _packed(content)

    def restore_state(self, state: object) -> None:
        """Go back to the state of a number."""
        super().restore_state(self._states.get(state) if isinstance(state, int) else None)
