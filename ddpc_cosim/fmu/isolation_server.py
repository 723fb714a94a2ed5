"""The process from which isolated FMUs are forked (POSIX): everything they need is imported there already.

It is single-threaded, so that forking is safe whatever the master's threads do. It collects what the FMUs
print, tells how they ended, and when the master is gone it ends them all and itself.
"""

import contextlib
import gc
import json
import os
import resource
import selectors
import signal
import socket
import sys
import traceback
from dataclasses import dataclass, field
from typing import NoReturn

from ddpc_cosim.fmu import isolation_child
from ddpc_cosim.fmu.isolation_messages import FORK, REQUEST

_OUTPUT_KEPT = 4000
_CHUNK = 1 << 16
_PR_SET_PDEATHSIG = 1


@dataclass
class _Child:
    """A forked FMU: where its output can be read, and the end of what has been read."""

    output: int
    tail: bytearray = field(default_factory=bytearray)

    def collect(self) -> bool:
        """Read what is there; return whether there may be more later."""
        with contextlib.suppress(BlockingIOError):
            while chunk := os.read(self.output, _CHUNK):
                self.tail += chunk
                del self.tail[:-_OUTPUT_KEPT]
            return False
        return True


class _Server:
    def __init__(self, control: socket.socket) -> None:
        self._control = control
        self._children: dict[int, _Child] = {}
        self._selector = selectors.DefaultSelector()
        self._selector.register(control, selectors.EVENT_READ)

    def serve(self) -> None:
        """Answer requests until the master is gone."""
        self._control.sendall(b"\n")
        master_is_there = True
        while master_is_there:
            ready = [key for key, _ in self._selector.select()]
            # Requests come last: they may end a child whose output is ready as well.
            for key in sorted(ready, key=lambda key: key.data is None):
                if key.data is None:
                    master_is_there = self._answer()
                elif not key.data.collect():
                    self._selector.unregister(key.fd)

    def end_all(self) -> None:
        """End what is left."""
        for pid in list(self._children):
            self._end(pid)

    def _answer(self) -> bool:
        request, descriptors, _, _ = socket.recv_fds(self._control, REQUEST.size, 2)
        if len(request) < REQUEST.size:
            return False
        action, number, pid = REQUEST.unpack(request)
        answer: dict[str, object]
        try:
            answer = {"pid": self._fork(*descriptors)} if action == FORK else self._end(pid)
        except OSError as error:  # no more processes or descriptors
            answer = {"error": str(error)}
        self._control.sendall(json.dumps({"number": number, **answer}).encode() + b"\n")
        return True

    def _fork(self, reading: int, writing: int) -> int:
        output, printing = os.pipe()
        server = os.getpid()
        pid = os.fork()
        if pid == 0:
            self._become_child(reading, writing, printing, server)
        for descriptor in (reading, writing, printing):
            os.close(descriptor)
        with contextlib.suppress(OSError):  # the child does the same, whoever is first
            os.setpgid(pid, pid)
        os.set_blocking(output, False)
        self._children[pid] = child = _Child(output)
        self._selector.register(output, selectors.EVENT_READ, child)
        return pid

    def _become_child(self, reading: int, writing: int, printing: int, server: int) -> NoReturn:
        try:
            os.setpgid(0, 0)
            _die_with(server)
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            self._selector.close()
            self._control.close()
            for child in self._children.values():
                os.close(child.output)
            for descriptor in (1, 2):
                os.dup2(printing, descriptor)
            os.close(printing)
            isolation_child.run(reading, writing)
        except BaseException:
            traceback.print_exc()
            sys.stderr.flush()
        finally:
            os._exit(isolation_child.LEFT_BEHIND)

    def _end(self, pid: int) -> dict[str, object]:
        child = self._children.pop(pid, None)
        if child is None:
            return {"code": None, "output": ""}
        for kill in (os.killpg, os.kill):
            with contextlib.suppress(OSError):
                kill(pid, signal.SIGKILL)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        child.collect()
        with contextlib.suppress(KeyError):  # its output has ended before
            self._selector.unregister(child.output)
        os.close(child.output)
        return {"code": code, "output": child.tail.decode("utf-8", "replace")}


def _die_with(server: int) -> None:
    """Ask the kernel to end this process with the server; elsewhere the closed pipe has to do."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != server:
            os._exit(isolation_child.LEFT_BEHIND)


def main(descriptor: int) -> NoReturn:
    """Serve the master at the other end of a socket."""
    server = _Server(socket.socket(fileno=descriptor))
    gc.freeze()  # what is shared with the children stays shared
    try:
        with contextlib.suppress(ConnectionError):
            server.serve()
    finally:
        server.end_all()
        os._exit(0)
