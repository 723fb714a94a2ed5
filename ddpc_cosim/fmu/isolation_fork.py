"""Isolated FMUs forked from a server that has imported everything already (POSIX).

The server is a child of this process and lives as long as there are isolated FMUs, or longer if asked to.
It is never forked from this process, whose threads would not survive that.
"""

import itertools
import json
import os
import select
import socket
import subprocess
import threading
from collections import deque
from contextlib import suppress
from io import FileIO
from typing import Any, ClassVar

from ddpc_cosim.errors import FMUImportError
from ddpc_cosim.fmu import isolation_launch
from ddpc_cosim.fmu.isolation_launch import CANNOT_START, Child, Ending, start_python
from ddpc_cosim.fmu.isolation_messages import END, FORK, REQUEST

_SERVE = """
import json, sys
sys.path[:] = json.loads(sys.argv[2])
from ddpc_cosim.fmu.isolation_server import main
main(int(sys.argv[1]))
"""
_START_SECONDS = 120.0


class ForkedChild(Child):
    """A process forked from the server."""

    def __init__(self) -> None:
        self._server = ForkServer.acquire()
        read_request, write_request = os.pipe()
        read_reply, write_reply = os.pipe()
        try:
            self._pid = self._server.fork(read_request, write_reply)
        except BaseException:
            os.close(write_request)
            os.close(read_reply)
            self._server.release()
            raise
        finally:
            os.close(read_request)
            os.close(write_reply)
        super().__init__(FileIO(read_reply), FileIO(write_request, "w"))
        poll = select.poll()
        poll.register(read_reply, select.POLLIN)
        self._poll = poll.poll

    def read_into(self, memory: memoryview, seconds: float) -> int:
        """Read what there is, as every child."""
        if not self._poll(seconds * 1e3):
            raise TimeoutError
        return self._reader.readinto(memory)

    def _end(self, *, at_leisure: bool) -> Ending:
        return self._server.end(self._pid, at_leisure=at_leisure)


class ForkServer:
    """The server's other end: one request at a time, each with a number that its answer repeats."""

    _current: ClassVar["ForkServer | None"] = None
    _lock: ClassVar[threading.Lock] = threading.Lock()

    def __init__(self) -> None:
        self._owner = os.getpid()
        self._users = 0
        self._to_end: deque[int] = deque()
        self._numbers = itertools.count()
        self._received = b""
        self._socket, other = socket.socketpair()
        with other:
            self._process = start_python(
                _SERVE, str(other.fileno()), stream=subprocess.DEVNULL, pass_fds=(other.fileno(),)
            )
        self._socket.settimeout(_START_SECONDS)
        try:
            self._line()
        except OSError as error:
            self._stop()
            raise FMUImportError(f"{CANNOT_START}: {error}") from error

    @classmethod
    def acquire(cls) -> "ForkServer":
        """Return the running server, started if there is none; it lives until it is released as often.

        Raises
        ------
        FMUImportError
            It cannot be started.
        """
        with cls._lock:
            server = cls._current
            if server is None or not server._is_usable():
                server = cls._current = ForkServer()
            server._users += 1
            return server

    def release(self) -> None:
        """Let go of the server, which ends with its last user."""
        with self._lock:
            self._release()

    def fork(self, reading: int, writing: int) -> int:
        """Fork a child with the far ends of two pipes, and return its process id.

        Raises
        ------
        FMUImportError
            The server has gone.
        """
        with self._lock:
            try:
                return int(self._ask(FORK, 0, reading, writing)["pid"])
            except OSError as error:
                raise FMUImportError(f"{CANNOT_START}: {error}") from error

    def end(self, pid: int, *, at_leisure: bool) -> Ending:
        """End a child and let go of the server; at leisure, not at once where that would have to wait.

        A finalizer may run in a thread that holds the lock.
        """
        if not self._lock.acquire(blocking=not at_leisure):
            self._to_end.append(pid)
            return Ending(None)
        try:
            self._to_end.append(pid)
            ending = Ending(None)
            while self._to_end:
                ending = self._end_one(self._to_end.popleft())
                self._release()
            return ending
        finally:
            self._lock.release()

    def _end_one(self, pid: int) -> Ending:
        try:
            answer = self._ask(END, pid)
        except OSError:  # the server has gone, and its children with it
            return Ending(None)
        return Ending(answer["code"], answer["output"])

    def _release(self) -> None:
        self._users -= 1
        if self._users == 0 and not isolation_launch.server_is_kept:
            self._stop()

    def _is_usable(self) -> bool:
        if self._owner != os.getpid():
            self._socket.close()  # a copy in a forked process; the server is its owner's
            return False
        return self._process.poll() is None

    def _stop(self) -> None:
        if ForkServer._current is self:
            ForkServer._current = None
        self._socket.close()  # which is what it waits for
        self._process.wait()

    def _ask(self, action: int, pid: int, *descriptors: int) -> dict[str, Any]:
        number = next(self._numbers)
        request = REQUEST.pack(action, number, pid)
        if descriptors:
            socket.send_fds(self._socket, [request], descriptors)
        else:
            self._socket.sendall(request)
        while True:  # an interrupt may have left the answer of an earlier request
            answer: dict[str, Any] = json.loads(self._line())
            if answer["number"] == number:
                break
        if "error" in answer:
            raise OSError(answer["error"])
        return answer

    def _line(self) -> bytes:
        while b"\n" not in self._received:
            chunk = self._socket.recv(1 << 16)
            if not chunk:
                raise ConnectionError(self._epitaph())
            self._received += chunk
        line, _, self._received = self._received.partition(b"\n")
        return line

    def _epitaph(self) -> str:
        with suppress(subprocess.TimeoutExpired):
            return f"it ended with exit code {self._process.wait(1.0)}"
        return "it has closed its connection"
