"""The one kind of process for whatever may crash or hang: the cases of a study, isolated FMUs, checks.

On POSIX, workers are forked from a server: a process without threads in which what they need is imported
already. It collects what they print, ends whole process groups, and ends them all when this process is gone.
A worker protects against faults; against malice only in a sandbox: else it has the user's rights.

What goes to a worker is pickled. What comes back never is: it is JSON and numbers of a bounded length, and
anything else is a crash of that worker.
"""

import atexit
import contextlib
import gc
import importlib
import io
import itertools
import json
import math
import os
import pickle
import selectors
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Sequence
from dataclasses import asdict, is_dataclass
from pathlib import Path
from time import monotonic
from typing import Any, ClassVar, NamedTuple, NoReturn

from ddpc_cosim import errors
from ddpc_cosim.errors import ConfigError, CosimError, DataError, FMUStepError, StepStatus
from ddpc_cosim.sandbox import Sandbox, enter
from ddpc_cosim.texts import recorded

LONGEST_REPLY = 1 << 27
# JSON of a megabyte can take twenty in memory, numbers take no more than they have.
_LONGEST_JSON, _LONGEST_TEXT, _MOST_TEXTS = 1 << 22, 10_000, 100
_PHASES = {"reset": "initialisation", "close": "terminate"}
_LENGTH = struct.Struct("=q")

_START_SECONDS, _LOOK_SECONDS = 120.0, 1.0
_OUTPUT_KEPT, _OUTPUT_SHOWN = 4000, 300
_CHUNK, _CHUNKS = 1 << 16, 16
_LEFT_BEHIND = 70
_FIRST_WINDOWS_FAULT = 0xC0000000
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
# Small matrices gain nothing from threaded linear algebra, and threads do not survive a fork.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class UnexpectedError(Exception):
    """What was called in a worker raised an error that is not of this project's family."""


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
        import ctypes

        ctypes.CDLL(None).fflush(None)


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


class Ending(NamedTuple):
    """How a worker ended: exit code, negative for a signal, None if unknown; and what it printed last."""

    code: int | None
    output: str = ""

    def __str__(self) -> str:
        code, printed = self.code, " ".join(self.output.split())[-_OUTPUT_SHOWN:]
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


def lost(who: str, call: str, time: float, ending: Ending, seconds: float | None = None) -> FMUStepError:
    """Return the error for a call in a worker that crashed, or did not return within so many seconds."""
    place = f"in {_PHASES.get(call, call)}" + (f" at t = {time:g} s" if math.isfinite(time) else "")
    if seconds is None:
        return FMUStepError(f"{who}: crashed {place}: {ending}", StepStatus.CRASHED, time)
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
        Modules to be imported before workers are forked, once for all.
    sandbox : Sandbox, optional
        What it enters before it runs anything; default: none, it has the user's rights.

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
    ) -> None:
        ours, theirs = socket.socketpair()
        self.channel = Channel(ours)
        self._owner, self._ending = os.getpid(), Ending(None)
        self._process: _Forked | _Shared | None = None
        try:
            with theirs:
                self._process = _start(theirs, preload)
            self.channel.limit(_START_SECONDS)  # one that is stopped reads nothing
            # Two pickles: the import path has to be there before the target can be found.
            place = (sys.path, _here(), dict(os.environ), str(folder), sandbox)
            self.channel.send(pickle.dumps(place))
            self.channel.send(pickle.dumps((target, arguments)))
        except OSError as error:
            self.end()
            raise CosimError(f"a worker process cannot be started: {error}") from error
        except BaseException:
            self.end()
            raise

    def end(self) -> Ending:
        """End the process and all that it has forked; return how it ended, if it had not been ended before.

        In a forked copy of this process, the worker is left alone.
        """
        process, self._process = self._process, None
        if process is not None and os.getpid() == self._owner:
            self._ending = process.end()
        self.channel.socket.close()
        return self._ending

    def printed(self) -> str:
        """Return the end of what it has printed since it was asked last, as far as the system tells."""
        return "" if self._process is None else self._process.printed()


def _start(connection: socket.socket, preload: Sequence[str]) -> "_Forked | _Shared":
    """Start a process with the far end of a channel."""
    if sys.platform != "win32":
        return _ForkServer.running().fork(connection, preload)
    return _Shared(connection)


class _Shared:
    """A process of its own with the far end of a channel (Windows)."""

    def __init__(self, connection: socket.socket) -> None:
        self._process = _python("ddpc_cosim.worker._run_shared()", stdin=subprocess.PIPE)
        assert self._process.stdin is not None
        if sys.platform == "win32":
            with self._process.stdin as pipe:
                pipe.write(connection.share(self._process.pid))

    def end(self) -> Ending:
        self._process.kill()
        return Ending(self._process.wait())

    def printed(self) -> str:
        return ""


def _python(code: str, stdin: int, pass_fds: Sequence[int] = ()) -> "subprocess.Popen[bytes]":
    """Start this Python away from the terminal and its Ctrl-C.

    Nothing beside a study or a script shadows a library: what this process finds beyond what is installed
    comes last.
    """
    command = [sys.executable, "-P", "-c"]
    flags = 0
    if sys.platform == "win32":
        # In a virtual environment, python.exe only launches this one, and would be ended in its place.
        command[0] = sys._base_executable
        flags = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW
    find = "import sys; sys.path += [p for p in sys.argv[1:] if p not in sys.path]; import ddpc_cosim.worker"
    command += [f"{find}; {code}", *(entry or _here() for entry in sys.path)]
    null = subprocess.DEVNULL
    return subprocess.Popen(
        command,
        bufsize=0,
        stdin=stdin,
        stdout=null,
        stderr=null,
        env=_ONE_THREAD | os.environ,
        start_new_session=True,
        creationflags=flags,
        pass_fds=pass_fds,
    )


def _here() -> str:
    """Return the working directory; empty: it has been removed."""
    try:
        return str(Path.cwd())
    except OSError:
        return ""


class _ForkServer:
    """The server's other end. Each request has a number that its answer repeats.

    A finalizer may ask in the middle of another request, and an interrupt may leave an answer unread.
    """

    _current: ClassVar["_ForkServer | None"] = None
    _lock: ClassVar[threading.RLock] = threading.RLock()

    def __init__(self) -> None:
        self._owner = os.getpid()
        self._numbers = itertools.count(1)
        self._received = b""
        self._answers: dict[int, dict[str, Any]] = {}
        self._socket, other = socket.socketpair()
        with other:
            descriptor = other.fileno()
            code = f"ddpc_cosim.worker._Server({descriptor}).serve()"
            self._process = _python(code, subprocess.DEVNULL, (descriptor,))
        self._socket.settimeout(_LOOK_SECONDS)
        atexit.register(self._stop)

    @classmethod
    def running(cls) -> "_ForkServer":
        """Return the server of this process, started if there is none; it is kept from then on."""
        with cls._lock:
            server = cls._current
            if server is None or server._owner != os.getpid() or server._process.poll() is not None:
                server = cls._current = _ForkServer()
            return server

    def fork(self, connection: socket.socket, preload: Sequence[str]) -> "_Forked":
        """Fork a worker; raises OSError."""
        return _Forked(self, self.ask({"preload": [*preload]}, connection.fileno())["pid"])

    def ask(self, request: dict[str, Any], *descriptors: int) -> dict[str, Any]:
        with self._lock:
            number = next(self._numbers)
            line = json.dumps({"number": number, **request}).encode() + b"\n"
            socket.send_fds(self._socket, [line], descriptors)
            deadline = monotonic() + _START_SECONDS
            while number not in self._answers:
                self._process.send_signal(signal.SIGCONT)  # someone may have stopped it
                try:
                    chunk = self._socket.recv(_CHUNK)
                except TimeoutError:
                    if monotonic() > deadline:
                        self._process.kill()  # and its workers with it
                        raise
                    continue
                if not chunk:
                    raise ConnectionError(f"the server ended with exit code {self._process.wait()}")
                self._received += chunk
                *lines, self._received = self._received.split(b"\n")
                self._answers |= {(answer := json.loads(line))["number"]: answer for line in lines}
            answer = self._answers.pop(number)
        if "error" in answer:
            raise OSError(answer["error"])
        return answer

    def _stop(self) -> None:
        if os.getpid() == self._owner:
            self._socket.close()  # which is what it waits for
            self._process.send_signal(signal.SIGCONT)
            try:
                self._process.wait(_START_SECONDS)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()


class _Forked(NamedTuple):
    """A process that a server has forked."""

    server: _ForkServer
    pid: int

    def end(self) -> Ending:
        try:
            answer = self.server.ask({"end": self.pid})
        except OSError:  # the server has gone, and its workers with it
            return Ending(None)
        return Ending(answer["code"], answer["output"])

    def printed(self) -> str:
        try:
            return str(self.server.ask({"printed": self.pid})["output"])
        except OSError:
            return ""


class _Server:
    """The process from which workers are forked."""

    def __init__(self, descriptor: int) -> None:
        self._control = socket.socket(fileno=descriptor)
        self._outputs: dict[int, int] = {}
        self._printed: dict[int, bytes] = {}
        self._deaths: dict[int, int] = {}
        _adopt_orphans()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._control, selectors.EVENT_READ)

    def serve(self) -> NoReturn:
        """Answer requests until whoever asks is gone; end what is left then."""
        try:
            while True:
                ready = [key.data for key, _ in self._selector.select()]
                for pid in ready:
                    if pid is not None and pid > 0:
                        self._collect(pid)
                    elif pid is not None:
                        self._bury(-pid)
                if None in ready:
                    lines, descriptors, _, _ = socket.recv_fds(self._control, _CHUNK, 8)
                    if not lines:
                        raise EOFError
                    for line in lines.splitlines():  # a finalizer may have asked meanwhile
                        self._answer(json.loads(line), descriptors)
        except (EOFError, ConnectionError):
            for pid in list(self._outputs):
                self._end(pid)
        finally:
            os._exit(0)

    def _answer(self, request: dict[str, Any], descriptors: list[int]) -> None:
        answer: dict[str, Any]
        try:
            if "end" in request:
                answer = self._end(request["end"])
            elif "printed" in request:
                self._collect(request["printed"])
                answer = {"output": self._output(request["printed"])}
            else:
                answer = {"pid": self._fork(request["preload"], descriptors.pop(0))}
        except OSError as error:  # no more processes or descriptors
            answer = {"error": str(error)}
        self._control.sendall(json.dumps({"number": request["number"], **answer}).encode() + b"\n")

    def _fork(self, preload: Sequence[str], connection: int) -> int:
        for module in preload:
            with contextlib.suppress(Exception):  # the worker will say what is wrong with it
                importlib.import_module(module)
        gc.freeze()  # what is shared with the workers stays shared
        output, printing = os.pipe()
        server, pid = os.getpid(), os.fork()
        if pid == 0:
            self._become_worker(connection, printing, server)
        for descriptor in (connection, printing):
            os.close(descriptor)
        os.set_blocking(output, False)
        self._outputs[pid], self._printed[pid] = output, b""
        self._selector.register(output, selectors.EVENT_READ, pid)
        if sys.platform == "linux":
            with contextlib.suppress(OSError):  # then the time limit tells
                self._deaths[pid] = os.pidfd_open(pid)
                self._selector.register(self._deaths[pid], selectors.EVENT_READ, -pid)
        return pid

    def _become_worker(self, connection: int, printing: int, server: int) -> NoReturn:
        try:
            os.setsid()
            _die_with(server)
            _adopt_orphans()  # while it lives; then they are the server's
            self._selector.close()
            self._control.close()
            for descriptor in (*self._outputs.values(), *self._deaths.values()):
                os.close(descriptor)
            nowhere = os.open(os.devnull, os.O_RDONLY)
            for source, target in ((nowhere, 0), (printing, 1), (printing, 2)):
                os.dup2(source, target)
            os.close(nowhere)
            os.close(printing)
            if isinstance(sys.stdout, io.TextIOWrapper):
                sys.stdout.reconfigure(line_buffering=True)  # what is not written out dies with the process
            channel = Channel(socket.socket(fileno=connection))  # not closed before the process ends
            _run(channel)
        except BaseException:
            traceback.print_exc()
            sys.stderr.flush()
        finally:
            os._exit(_LEFT_BEHIND)

    def _collect(self, pid: int) -> None:
        """Read of what a worker has printed, some at a time; the end is kept."""
        with contextlib.suppress(BlockingIOError, KeyError):  # for now, or its output has ended before
            for _ in range(_CHUNKS):
                if not (chunk := os.read(self._outputs[pid], _CHUNK)):
                    self._selector.unregister(self._outputs[pid])
                    break
                self._printed[pid] = (self._printed[pid] + chunk)[-_OUTPUT_KEPT:]

    def _end(self, pid: int) -> dict[str, Any]:
        for kill in (os.killpg, os.kill):  # it may not have made its group yet
            with contextlib.suppress(OSError):
                kill(pid, signal.SIGKILL)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        self._forget_death(pid)
        self._end_orphans()
        self._collect(pid)
        with contextlib.suppress(KeyError):
            self._selector.unregister(self._outputs[pid])
        os.close(self._outputs.pop(pid))
        return {"code": code, "output": self._output(pid)}

    def _output(self, pid: int) -> str:
        printed, self._printed[pid] = self._printed[pid], b""
        if pid not in self._outputs:
            del self._printed[pid]
        return printed.decode("utf-8", "replace")

    def _bury(self, pid: int) -> None:
        """End what a worker that died has left: its group, and what has left that, may hold its channel."""
        with contextlib.suppress(OSError):
            os.killpg(pid, signal.SIGKILL)
        self._forget_death(pid)
        self._end_orphans()

    def _forget_death(self, pid: int) -> None:
        if pid in self._deaths:
            self._selector.unregister(self._deaths[pid])
            os.close(self._deaths.pop(pid))

    def _end_orphans(self) -> None:
        """End what is left of workers that died: a living one keeps its own orphans."""
        tried = set(self._outputs)
        while orphans := _children() - tried:
            tried |= orphans
            for orphan in orphans:
                with contextlib.suppress(OSError):
                    os.kill(orphan, signal.SIGKILL)
                    os.waitpid(orphan, 0)


def _adopt_orphans() -> None:
    """Become the parent of what descendants leave behind, in whatever session (Linux)."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def _children() -> set[int]:
    """Return the children of this process of one thread, where the kernel tells them."""
    try:
        return set(map(int, Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()))
    except OSError:
        return set()


def _die_with(server: int) -> None:
    """End with the server, where the kernel can be asked for it; leave no core dump, and Ctrl-C to others."""
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != server:
            os._exit(_LEFT_BEHIND)


def _run(channel: Channel) -> None:
    """Run what the other side says, in its working directory and environment, with its import path."""
    with contextlib.suppress(EOFError, ConnectionError):
        path, here, environment, folder, sandbox = pickle.loads(channel.receive(sys.maxsize))
        sys.path += [entry or here for entry in path if entry not in sys.path]
        os.environ.clear()
        os.environ.update(_ONE_THREAD | environment | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), folder))
        tempfile.tempdir = folder
        with contextlib.suppress(OSError):
            os.chdir(here or folder)
        if sandbox is not None:
            enter(sandbox)
        target, arguments = pickle.loads(channel.receive(sys.maxsize))
        target(channel, *arguments)


def _run_shared() -> None:
    """Run as a process of its own (Windows), which ends with whoever started it."""
    if sys.platform == "win32":
        threading.Thread(target=_leave_with_parent, daemon=True).start()
        _run(Channel(socket.fromshare(sys.stdin.buffer.read())))


def _leave_with_parent() -> None:
    """Wait for the parent's end, which a closed socket does not tell while an FMU is busy (Windows)."""
    if sys.platform == "win32":
        import _winapi

        synchronize = 0x00100000
        parent = _winapi.OpenProcess(synchronize, False, os.getppid())
        _winapi.WaitForSingleObject(parent, _winapi.INFINITE)
        os._exit(_LEFT_BEHIND)


def serve_calls(channel: Channel) -> None:
    """Call in a worker what it is asked for, one function after the other: the other side of :func:`ask`."""
    while True:
        function, arguments = pickle.loads(channel.receive(sys.maxsize))
        reply(channel, lambda: function(*arguments))  # noqa: B023 - called at once


def ask(channel: Channel, function: Callable[..., Any], *arguments: Any) -> None:
    """Have a worker that serves calls call a function; its reply is to be received."""
    channel.send(pickle.dumps((function, arguments)))
