"""The one kind of process for code that may crash or hang: the cases of a study, isolated FMUs, checks.

A worker protects against faults; against malice only in a sandbox: else it has the user's rights.

What goes to a worker is pickled. What comes back never is: it is JSON and numbers of a bounded length, and
anything else is a crash of that worker.
"""

import contextlib
import json
import math
import os
import pickle
import socket
import struct
import sys
import tempfile
import uuid
from collections.abc import Callable, Sequence
from dataclasses import asdict, is_dataclass
from pathlib import Path
from time import monotonic
from typing import Any

from ddpc_cosim import errors
from ddpc_cosim.errors import ConfigError, CosimError, DataError, FMUStepError, StepStatus
from ddpc_cosim.files.durations import shown
from ddpc_cosim.files.texts import recorded
from ddpc_cosim.processes import spawning
from ddpc_cosim.processes.fork_server import (
    ONE_THREAD,
    START_SECONDS,
    ExitStatus,
    Forked,
    ForkServer,
    here,
    this_process,
)
from ddpc_cosim.processes.limits import default_memory
from ddpc_cosim.processes.requests import held
from ddpc_cosim.processes.sandbox import Sandbox, enter, separable
from ddpc_cosim.processes.scratch import list_shared_memory, remove_shared_memory

LONGEST_REPLY = 1 << 27
# JSON of a megabyte can take twenty in memory, numbers take no more than they have.
_LONGEST_JSON, _LONGEST_TEXT, _MOST_TEXTS = 1 << 22, 10_000, 100
_PHASES = {"reset": "initialisation", "close": "terminate"}
_LENGTH = struct.Struct("=q")


class UnexpectedError(Exception):
    """What was called in a worker raised an error that is not of this project's family."""


class LostWorkerError(Exception):
    """A worker has not returned what it was asked for, and was ended.

    Parameters
    ----------
    exit_status : ExitStatus or None
        How its process ended; None: it was not done in time.
    """

    def __init__(self, exit_status: ExitStatus | None) -> None:
        super().__init__("not done in time" if exit_status is None else str(exit_status))
        self.exit_status = exit_status


_ERRORS: dict[str, type[Any]] = {"": UnexpectedError} | {
    name: kind
    for name, kind in vars(errors).items()
    if isinstance(kind, type) and issubclass(kind, CosimError)
}


class Channel:
    """Messages behind their length, over a socket; strictly one request, one reply."""

    def __init__(self, connection: socket.socket) -> None:
        self.socket = connection

    def limit(self, seconds: float) -> None:
        """Limit the time for what is sent and received directly; beyond it ``BlockingIOError`` is raised."""
        if sys.platform == "win32":
            self.socket.settimeout(seconds)
            return
        # The system does it without further calls, which would be a tenth of an isolated step.
        interval = struct.pack("@ll", int(seconds), int(seconds % 1 * 1e6) or 1)
        for option in (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO):
            self.socket.setsockopt(socket.SOL_SOCKET, option, interval)

    def send(self, content: bytes) -> None:
        """Send a message."""
        self.socket.sendall(_LENGTH.pack(len(content)) + content)

    def receive(self, longest: int, beginning: bytes = b"", seconds: float | None = None) -> bytes:
        """Return the message of which the beginning has been received already.

        Raises
        ------
        EOFError, OSError
            The other side is gone; a ``TimeoutError``: the message is not complete in time.
        ValueError
            It is too long.
        """
        deadline = monotonic() + (math.inf if seconds is None else seconds)
        head = beginning + self.receive_bytes(_LENGTH.size - len(beginning), seconds)
        (length,) = _LENGTH.unpack_from(head)
        if not 0 <= length <= longest:
            raise ValueError(f"a message of {length} bytes; allowed: {longest}")
        content = head[_LENGTH.size :]
        left = None if seconds is None else deadline - monotonic()
        return content + self.receive_bytes(length - len(content), left)

    def receive_bytes(self, count: int, seconds: float | None = None) -> bytes:
        """Return so many bytes, all of which have to be there in time; errors as of :meth:`receive`."""
        deadline = monotonic() + (seconds or 0.0)
        before = self.socket.gettimeout()
        buffer = bytearray(max(count, 0))
        rest = memoryview(buffer)
        try:
            while rest:
                if seconds is not None:
                    self.socket.settimeout(max(deadline - monotonic(), 1e-3))
                received = self.socket.recv_into(rest)
                if not received:
                    raise EOFError
                rest = rest[received:]
        finally:
            self.socket.settimeout(before)
        return bytes(buffer)


def reply(channel: Channel, call: Callable[[], Any]) -> None:
    """Send from a worker what a call returns: what JSON can say, and arrays; or the error that it raises."""
    numbers: list[bytes] = []

    def plain(value: Any) -> Any:
        if is_dataclass(value) and not isinstance(value, type):
            return asdict(value)
        numbers.append(value.astype(float).tobytes())
        return {"shape": value.shape}

    try:
        content = json.dumps({"result": call()}, default=plain).encode()
        _flush()
    except BaseException as error:  # anyone's code can fail in any way, exit() included
        reply_error(channel, error)
    else:
        channel.send(b"\n".join((content, b"".join(numbers))))


def _flush() -> None:
    """Write out what has been printed, by libraries too: it belongs to what was called last."""
    sys.stdout.flush()
    if sys.platform != "win32":
        this_process().fflush(None)


def reply_error(channel: Channel, error: BaseException) -> None:
    """Send an error: by its class and arguments if it is of this project's family, else in words."""
    kind, arguments = "", [f"{type(error).__name__}: {recorded(error)}".removesuffix(": ")]
    if isinstance(error, CosimError):
        kind = next(base.__name__ for base in type(error).__mro__ if base.__module__ == errors.__name__)
        faults = getattr(error, "faults", None)
        arguments = [*(error.__reduce__()[1] if faults is None else faults)][:_MOST_TEXTS]
    texts = [a[:_LONGEST_TEXT] if isinstance(a, str) else a for a in arguments]
    channel.send(json.dumps({"error": kind, "arguments": texts}, default=str).encode())


def result_of(content: bytes) -> Any:
    """Return what :func:`reply` was given, or raise it.

    Raises
    ------
    ValueError
        It is not a reply.
    CosimError
        What was called raised it.
    UnexpectedError
        What was called raised something else.
    """
    text, _, numbers = content.partition(b"\n")
    begin = 0

    def array_or_dict(value: dict[str, Any]) -> Any:
        nonlocal begin
        if value.keys() != {"shape"}:
            return value
        import numpy as np

        count = math.prod(value["shape"])
        begin, start = begin + 8 * count, begin
        return np.frombuffer(numbers, np.float64, count, start).reshape(value["shape"]).copy()

    try:
        if len(text) > _LONGEST_JSON:
            raise ValueError(f"{len(text)} bytes of JSON")
        answer = json.loads(text, object_hook=array_or_dict)
        if "error" not in answer:
            return answer["result"]
        error = _error(answer["error"], answer["arguments"])
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as fault:
        raise ValueError("the reply cannot be read") from fault
    raise error


def _error(name: str, arguments: list[Any]) -> CosimError | UnexpectedError:
    """Return an error of this project's family, and of none else, with arguments of the types that it has."""
    kind = _ERRORS[name]
    if kind is FMUStepError:
        message, status, time = arguments
        return FMUStepError(str(message), StepStatus(status), float(time))
    texts = [*map(str, arguments)]
    return kind(texts) if issubclass(kind, ConfigError | DataError) else kind(*texts)


def lost(who: str, call: str, time: float, end: ExitStatus, seconds: float | None = None) -> FMUStepError:
    """Return the error for a call in a worker that crashed, or did not return within so many seconds."""
    place = f"in {_PHASES.get(call, call)}" + (f" at t = {shown(time)}" if math.isfinite(time) else "")
    if seconds is None:
        return FMUStepError(f"{who}: crashed {place}: {end}", StepStatus.CRASHED, time)
    return FMUStepError(
        f"{who}: no return within {seconds:g} s {place}; its process was ended; "
        "raise step_timeout if it needs longer",
        StepStatus.TIMED_OUT,
        time,
    )


class Worker:
    """A process that runs one function.

    Parameters
    ----------
    target : callable
        What it runs: any function of a module, with its :class:`Channel` as the first argument.
    arguments : Any
        The other arguments; pickled.
    folder : Path
        Where temporary files of the worker go.
    preload : sequence of str
        Modules to be imported, and functions (``module:function``) to be called, before workers are forked,
        where they are.
    sandbox : Sandbox, optional
        What it enters before it runs anything; default: none, it has the user's rights.
    memory : int, optional
        Bytes that it may have together with all that it starts, where the system tells them; 0: any; default:
        :func:`default_memory`.
    alone : bool
        Whether it shares with no other one the process that forks it, which it could end.

    Raises
    ------
    CosimError
        It cannot be started.
    """

    def __init__(
        self,
        target: Callable[..., None],
        *arguments: Any,
        folder: Path,
        preload: Sequence[str] = (),
        sandbox: Sandbox | None = None,
        memory: int | None = None,
        alone: bool = False,
    ) -> None:
        ours, theirs = socket.socketpair()
        self.channel = Channel(ours)
        self._owner, self._exit_status = os.getpid(), ExitStatus(None)
        # In a sandbox none can be made, and what a list there says is not to be believed.
        self._shared = None if sandbox else folder / f"shared-memory-{uuid.uuid4().hex}"
        self._process: Forked | spawning.Spawned | None = None
        try:
            with theirs:
                memory = default_memory() if memory is None else memory
                self._process = _start(theirs, preload, memory, alone)
            self.channel.limit(START_SECONDS)  # one that is stopped reads nothing
            # Two pickles: the import path has to be there before the target can be found.
            apart = sandbox is not None and separable()
            place = (sys.path, here(), dict(os.environ), str(folder), sandbox, apart, self._shared)
            with contextlib.suppress(ConnectionError):  # it has died: whoever waits for its reply learns that
                self.channel.send(pickle.dumps(place))
                self.channel.send(pickle.dumps((target, arguments)))
        except OSError as error:
            self.end()
            raise CosimError(f"a worker process cannot be started: {error}") from error
        except BaseException:
            self.end()
            raise

    def call(self, function: Callable[..., Any], *arguments: Any, seconds: float) -> Any:
        """Have a worker that serves calls call a function within so many seconds; return its result.

        Raises
        ------
        LostWorkerError
            It has crashed, or was not done in time, and was ended.
        CosimError, UnexpectedError
            What the function raised.
        """
        try:
            ask(self.channel, function, *arguments)
            return result_of(self.channel.receive(LONGEST_REPLY, seconds=seconds))
        except TimeoutError as error:
            self.end()
            raise LostWorkerError(None) from error
        except (OSError, EOFError, ValueError) as error:
            raise LostWorkerError(self.end()) from error

    def end(self) -> ExitStatus:
        """End the process and all that it has forked; return how it ended, if it had not been ended before.

        In a forked copy of this process, the worker is left alone.
        """
        with held():  # or it would go on, with no one left who ends it
            process, self._process = self._process, None
            if process is not None and os.getpid() == self._owner:
                self._exit_status = process.end()
                if self._shared is not None:
                    remove_shared_memory(self._shared)
            self.channel.socket.close()
        return self._exit_status


def _start(
    connection: socket.socket, preload: Sequence[str], memory: int, alone: bool
) -> Forked | spawning.Spawned:
    """Start a process with the far end of a channel."""
    if spawning.forks():
        return ForkServer.fork(connection, preload, memory, alone=alone)
    return spawning.Spawned(connection)


def run(connection: socket.socket) -> None:
    """Run what the other side says, in its working directory and environment, with its import path."""
    channel = Channel(connection)
    with contextlib.suppress(EOFError, ConnectionError):
        path, place, environment, folder, sandbox, apart, shared = pickle.loads(channel.receive(sys.maxsize))
        sys.path += [entry or place for entry in path if entry not in sys.path]
        os.environ.clear()
        os.environ.update(environment | ONE_THREAD)
        keep_temporary_files_in(folder)
        with contextlib.suppress(OSError):
            os.chdir(place or folder)
        if sandbox is not None:
            enter(sandbox, apart=apart)
        else:
            list_shared_memory(shared)
        target, arguments = pickle.loads(channel.receive(sys.maxsize))
        target(channel, *arguments)


def keep_temporary_files_in(folder: str) -> None:
    """Have temporary files of this process, and of what it starts, made in a folder."""
    os.environ.update(dict.fromkeys(("TMPDIR", "TEMP", "TMP"), folder))
    tempfile.tempdir = folder


def serve_calls(channel: Channel) -> None:
    """Call in a worker what it is asked for, one function after the other: the other side of :func:`ask`."""
    while True:
        function, arguments = pickle.loads(channel.receive(sys.maxsize))
        reply(channel, lambda: function(*arguments))  # noqa: B023 - called at once


def ask(channel: Channel, function: Callable[..., Any], *arguments: Any) -> None:
    """Have a worker that serves calls call a function; its reply is to be received."""
    import cloudpickle  # a class that the worker cannot import goes along by value

    channel.send(cloudpickle.dumps((function, arguments)))
