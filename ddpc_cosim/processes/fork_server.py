"""Where workers come from: a process without threads, in which what they need is imported already.

It collects what workers print, ends what has too much memory or too many processes, and all that a worker
leaves behind; and ends them all when the process that it serves is gone. Where that was not tested, processes
are started anew: see ``spawning``.
"""

import atexit
import contextlib
import ctypes
import gc
import importlib
import io
import itertools
import json
import os
import selectors
import signal
import socket
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from time import monotonic
from typing import Any, ClassVar, NamedTuple, NoReturn

from ddpc_cosim.processes.limits import children, excess_of, limit_tasks

if sys.platform != "win32":
    import resource

START_SECONDS = 120.0
_LOOK_SECONDS, _LIMIT_SECONDS = 1.0, 0.1
OUTPUT_KEPT, _OUTPUT_SHOWN = 4000, 300
_CHUNK, _CHUNKS = 1 << 16, 16
LEFT_BEHIND = 70
_FIRST_WINDOWS_FAULT = 0xC0000000
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
# Whatever the surroundings say: small matrices gain nothing from threaded linear algebra, threads do not
# survive a fork, and the last digits of a result depend on how many there are.
ONE_THREAD = dict.fromkeys((f"{library}_NUM_THREADS" for library in ("OMP", "OPENBLAS", "MKL")), "1") | {
    "VECLIB_MAXIMUM_THREADS": "1"
}


class ExitStatus(NamedTuple):
    """How a worker ended: exit code, negative for a signal, None if unknown; what it printed last.

    And what it had too much of, if it was ended for that; and whether it has gone with its server and other
    workers, any of which may be at fault.
    """

    code: int | None
    output: str = ""
    excess: str = ""
    is_one_of_several: bool = False

    def __str__(self) -> str:
        code, printed = self.code, " ".join(self.output.split())[-_OUTPUT_SHOWN:]
        words = f"; it printed: {printed}" if printed else ""
        if self.excess:
            remedy = "; raise memory_limit if it needs more" if "memory" in self.excess else ""
            return f"{self.excess}, so it was ended{remedy}{words}"
        if code is None:
            return f"its process has gone, and the one that starts processes with it{words}"
        if code >= _FIRST_WINDOWS_FAULT:
            return f"its process ended with exception {code:#x}{words}"
        if code >= 0:
            return f"its process ended with exit code {code}{words}"
        try:
            number = signal.Signals(-code)
        except ValueError:
            return f"signal {-code}{words}"
        return f"{number.name} ({signal.strsignal(number) or 'unknown'}){words}"


def start_python(
    code: str, stdin: int, pass_fds: Sequence[int] = (), *, output: int = subprocess.DEVNULL
) -> "subprocess.Popen[bytes]":
    """Start this Python away from the terminal and its Ctrl-C; all that it prints goes one way.

    Nothing beside a study or a script shadows a library: what this process finds beyond what is installed
    comes last.
    """
    command = [sys.executable, "-P", "-c"]
    flags = 0
    if sys.platform == "win32":
        # In a virtual environment, python.exe only launches this one, and would be ended in its place.
        command[0] = sys._base_executable
        flags = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW
    find = "import sys; sys.path += [p for p in sys.argv[1:] if p not in sys.path]"
    command += [
        f"{find}; from ddpc_cosim.processes import fork_server, spawning, worker; {code}",
        *(entry or here() for entry in sys.path),
    ]
    return subprocess.Popen(
        command,
        bufsize=0,
        stdin=stdin,
        stdout=output,
        stderr=subprocess.STDOUT,
        env=os.environ | ONE_THREAD,
        start_new_session=True,
        creationflags=flags,
        pass_fds=pass_fds,
    )


def here() -> str:
    """Return the working directory; empty: it has been removed."""
    try:
        return str(Path.cwd())
    except OSError:
        return ""


class ForkServer:
    """The server's other end. Each request has a number that its answer repeats.

    A finalizer may ask in the middle of another request, and an interrupt may leave an answer unread.
    """

    _current: ClassVar["ForkServer | None"] = None
    _lock: ClassVar[threading.RLock] = threading.RLock()

    def __init__(self) -> None:
        self._owner = os.getpid()
        self._numbers = itertools.count(1)
        self._received = b""
        self._answers: dict[int, dict[str, Any]] = {}
        self.workers: set[int] = set()
        self._socket, other = socket.socketpair()
        with other:
            descriptor = other.fileno()
            code = f"fork_server.Server({descriptor}, worker.run).serve()"
            self._process = start_python(code, subprocess.DEVNULL, (descriptor,))
        self._socket.settimeout(_LOOK_SECONDS)
        # Its end is what the server waits for, and a copy of this process may outlive it.
        os.register_at_fork(after_in_child=self._socket.close)
        atexit.register(self._stop)

    @classmethod
    def running(cls) -> "ForkServer":
        """Return the server of this process, started if there is none; it is kept from then on."""
        with cls._lock:
            server = cls._current
            if server is None or server._owner != os.getpid() or server._process.poll() is not None:
                server = cls._current = ForkServer()
            return server

    @classmethod
    def fork(cls, connection: socket.socket, preload: Sequence[str], memory: int, *, alone: bool) -> "Forked":
        """Fork a worker from the server of this process, or from one that has no other; raises OSError."""
        request = {"preload": [*preload], "memory": memory}
        for is_last in (False, False, True):
            server = ForkServer() if alone else cls.running()
            try:
                pid = server.ask(request, connection.fileno())["pid"]
            except ConnectionError:  # one of its workers has just ended it
                with contextlib.suppress(subprocess.TimeoutExpired):
                    server._process.wait(_LOOK_SECONDS)  # so that another one is started
                if is_last:
                    raise
            else:
                server.workers.add(pid)
                break
        return Forked(server, pid, alone)

    @classmethod
    def wake(cls) -> None:
        """Have the server of this process go on, whose workers wait for it to read what they print."""
        if cls._current is not None and cls._current._owner == os.getpid():
            cls._current._wake()

    def _wake(self) -> None:
        self._process.send_signal(signal.SIGCONT)  # one of its workers may have stopped it

    def ask(self, request: dict[str, Any], *descriptors: int) -> dict[str, Any]:
        """Have the server answer a request; raises OSError."""
        with self._lock:
            number = next(self._numbers)
            line = json.dumps({"number": number, **request}).encode() + b"\n"
            socket.send_fds(self._socket, [line], descriptors)
            deadline = monotonic() + START_SECONDS
            while number not in self._answers:
                self._wake()
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
        atexit.unregister(self._stop)
        if os.getpid() == self._owner:
            self._socket.close()  # which is what it waits for
            self._wake()
            try:
                self._process.wait(START_SECONDS)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()


class Forked(NamedTuple):
    """A process that a server has forked, which may have been started for it alone."""

    server: ForkServer
    pid: int
    is_alone: bool

    def end(self) -> ExitStatus:
        """End it and all that it has started; return how it ended."""
        try:
            answer = self.server.ask({"end": self.pid})
        except OSError:  # the server has gone, and its workers with it
            return ExitStatus(None, is_one_of_several=len(self.server.workers) > 1)
        finally:
            if self.is_alone:
                self.server._stop()
        self.server.workers.discard(self.pid)
        return ExitStatus(answer["code"], answer["output"], answer["excess"])


@dataclass(slots=True)
class _Child:
    """A worker as its server sees it: where its output is read and its end told, and why it was ended."""

    output: int
    memory: int
    death: int = -1
    printed: bytes = b""
    excess: str = ""


class Server:
    """The process from which workers are forked."""

    def __init__(self, descriptor: int, run: Callable[[socket.socket], None]) -> None:
        self._control, self._run = socket.socket(fileno=descriptor), run
        self._workers: dict[int, _Child] = {}
        self._looked = 0.0
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # one that is ignored leaves no exit code to collect
        _adopt_orphans()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._control, selectors.EVENT_READ)

    def serve(self) -> NoReturn:
        """Answer requests until the client is gone; then end what is left."""
        try:
            while True:
                limited = any(child.memory for child in self._workers.values())
                ready = [key.data for key, _ in self._selector.select(_LIMIT_SECONDS if limited else None)]
                if limited and monotonic() - self._looked > _LIMIT_SECONDS:
                    self._enforce_limits()
                for pid in ready:
                    if pid is not None and pid > 0:
                        self._collect(pid)
                    elif pid is not None:
                        self._kill_leftovers(-pid)
                if None in ready:
                    lines, descriptors, _, _ = socket.recv_fds(self._control, _CHUNK, 8)
                    if not lines:
                        raise EOFError
                    for line in lines.splitlines():  # a finalizer may have asked meanwhile
                        self._answer(json.loads(line), descriptors)
        except (EOFError, ConnectionError):
            for pid in list(self._workers):
                self._end(pid)
        finally:
            os._exit(0)

    def _answer(self, request: dict[str, Any], descriptors: list[int]) -> None:
        answer: dict[str, Any]
        try:
            if "end" in request:
                answer = self._end(request["end"])
            else:
                answer = {"pid": self._fork(request["preload"], request["memory"], descriptors.pop(0))}
        except OSError as error:  # no more processes or descriptors
            answer = {"error": str(error)}
        self._control.sendall(json.dumps({"number": request["number"], **answer}).encode() + b"\n")

    def _fork(self, preload: Sequence[str], memory: int, connection: int) -> int:
        for entry in preload:
            module, _, function = entry.partition(":")
            with contextlib.suppress(Exception):  # the worker will say what is wrong with it
                imported = importlib.import_module(module)
                if function:
                    getattr(imported, function)()
        gc.freeze()  # what is shared with the workers stays shared
        output, printing = os.pipe()
        server, pid = os.getpid(), os.fork()
        if pid == 0:
            os.close(output)
            self._become_worker(connection, printing, server)
        for descriptor in (connection, printing):
            os.close(descriptor)
        os.set_blocking(output, False)
        child = self._workers[pid] = _Child(output, memory)
        self._selector.register(output, selectors.EVENT_READ, pid)
        if sys.platform == "linux":
            with contextlib.suppress(OSError):  # then the time limit tells
                child.death = os.pidfd_open(pid)
                self._selector.register(child.death, selectors.EVENT_READ, -pid)
        return pid

    def _become_worker(self, connection: int, printing: int, server: int) -> NoReturn:
        try:
            os.setsid()
            _die_with(server)
            _leave_at_once()
            _adopt_orphans()  # while it lives; then they are the server's
            self._selector.close()
            self._control.close()
            for child in self._workers.values():
                os.close(child.output)
                if child.death >= 0:
                    os.close(child.death)
            nowhere = os.open(os.devnull, os.O_RDONLY)
            for source, target in ((nowhere, 0), (printing, 1), (printing, 2)):
                os.dup2(source, target)
            os.close(nowhere)
            os.close(printing)
            if isinstance(sys.stdout, io.TextIOWrapper):
                sys.stdout.reconfigure(line_buffering=True)  # what is not written out dies with the process
            held = socket.socket(fileno=connection)  # not closed before the process ends
            self._run(held)
        except BaseException:
            traceback.print_exc()
            sys.stderr.flush()
        finally:
            os._exit(LEFT_BEHIND)

    def _collect(self, pid: int) -> None:
        """Read of what a worker has printed, some at a time; the end is kept."""
        child = self._workers[pid]
        with contextlib.suppress(BlockingIOError, KeyError):  # for now, or its output has ended before
            for _ in range(_CHUNKS):
                if not (chunk := os.read(child.output, _CHUNK)):
                    self._selector.unregister(child.output)
                    break
                child.printed = (child.printed + chunk)[-OUTPUT_KEPT:]

    def _end(self, pid: int) -> dict[str, Any]:
        _kill(pid)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        self._kill_leftovers(pid)
        self._collect(pid)
        child = self._workers.pop(pid)
        with contextlib.suppress(KeyError):
            self._selector.unregister(child.output)
        os.close(child.output)
        output = child.printed.decode("utf-8", "replace")
        return {"code": code, "output": output, "excess": child.excess}

    def _kill_leftovers(self, pid: int) -> None:
        """End what a worker that died has left: its group, and what has left that, may hold its channel."""
        _send(-pid, signal.SIGKILL)
        child = self._workers[pid]
        if child.death >= 0:
            self._selector.unregister(child.death)
            os.close(child.death)
            child.death = -1
        self._end_orphans()

    def _end_orphans(self) -> None:
        """End what is left of workers that died: a living one keeps its own. What forks is stopped first."""
        others, stopped = set(self._workers), set[int]()
        while orphans := children(os.getpid()) - others:
            reached, known = [*orphans], len(stopped)
            for pid in reached:  # which grows
                if pid not in stopped:
                    _send(pid, signal.SIGSTOP)
                    stopped.add(pid)
                reached += children(pid)
            if len(stopped) > known:  # until nothing new has been found
                continue
            for pid in reached:
                _send(pid, signal.SIGKILL)
            for pid in orphans:
                if _send(pid, signal.SIGKILL):
                    os.waitpid(pid, 0)
                else:  # another user's by now
                    others.add(pid)

    def _enforce_limits(self) -> None:
        """End the workers that have more than they may."""
        for pid, child in self._workers.items():
            if child.memory and not child.excess and (excess := excess_of(pid, child.memory)):
                child.excess = excess
                _kill(pid)  # its death will be told
        self._looked = monotonic()


def _kill(pid: int) -> None:
    """Kill a worker and its group, which it may not have made yet."""
    _send(-pid, signal.SIGKILL)
    _send(pid, signal.SIGKILL)


def _send(pid: int, number: int) -> bool:
    """Send a signal to a process, or to a group by its negative number; return whether that is possible."""
    try:
        os.kill(pid, number)
    except OSError:
        return False
    return True


@cache
def this_process() -> ctypes.CDLL:
    """Return the functions of this process, those of the C library among them (POSIX)."""
    return ctypes.CDLL(None)


def _adopt_orphans() -> None:
    """Become the parent of what descendants leave behind, in whatever session (Linux)."""
    if sys.platform == "linux":
        this_process().prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def undisturbed() -> None:
    """Dump no core, heed no Ctrl-C (POSIX)."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _die_with(server: int) -> None:
    """End with the server and be limited, as far as the kernel does it."""
    undisturbed()
    if sys.platform == "linux":
        limit_tasks()
        this_process().prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != server:
            os._exit(LEFT_BEHIND)


def _leave_at_once() -> None:
    """Have C's ``exit``, which an FMU may call, end this process without what libraries do then (glibc).

    They may wait for threads of theirs, which were not forked along.
    """
    with contextlib.suppress(AttributeError):
        this_process().on_exit(this_process()._exit, None)
