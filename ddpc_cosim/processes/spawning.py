"""Workers that are started anew, where they are not forked: each imports what it needs.

On macOS libraries of the system, Accelerate below NumPy among them, need not work in a process that was
forked: CPython itself starts its processes anew there. Windows has no fork.
"""

import io
import os
import signal
import socket
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from typing import NoReturn

from ddpc_cosim.processes.fork_server import LEFT_BEHIND, OUTPUT_KEPT, ExitStatus, start_python, undisturbed

_TESTED_TO_FORK = ("linux",)
_CHUNK = 1 << 16
_REST_SECONDS = 1.0


def forks(system: str = sys.platform) -> bool:
    """Whether workers are forked from a process in which what they need is imported already."""
    return system in _TESTED_TO_FORK


class Spawned:
    """A process of its own with the far end of a channel. It ends with this one; its last output is kept."""

    def __init__(self, connection: socket.socket) -> None:
        self._printed = b""
        is_windows, descriptor = sys.platform == "win32", connection.fileno()
        self._process = start_python(
            f"spawning.become_worker({-1 if is_windows else descriptor}, worker.run)",
            subprocess.PIPE,
            () if is_windows else (descriptor,),
            output=subprocess.PIPE,
        )
        self._reader = threading.Thread(target=self._collect, daemon=True)
        self._reader.start()
        assert self._process.stdin is not None
        if sys.platform == "win32":
            with self._process.stdin as pipe:
                pipe.write(connection.share(self._process.pid))

    def _collect(self) -> None:
        """Read what is printed, because a full pipe would block the process, and keep the end of it."""
        assert self._process.stdout is not None
        with self._process.stdout as pipe:
            while chunk := pipe.read(_CHUNK):
                self._printed = (self._printed + chunk)[-OUTPUT_KEPT:]

    def end(self) -> ExitStatus:
        """End it and, but on Windows, what has stayed in its process group; return how it ended."""
        if sys.platform != "win32":
            with suppress(OSError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()
        code = self._process.wait()
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._reader.join(_REST_SECONDS)  # what has left the group may hold its output open
        return ExitStatus(code, self._printed.decode("utf-8", "replace"))


def become_worker(descriptor: int, run: Callable[[socket.socket], None]) -> NoReturn:
    """Run as the process at the far end, whose socket has a number; on Windows stdin tells which it is."""
    try:
        if isinstance(sys.stdout, io.TextIOWrapper):  # what is not written out dies with the process
            sys.stdout.reconfigure(encoding="utf-8", errors="backslashreplace", line_buffering=True)
        if sys.platform == "win32":
            connection = socket.fromshare(sys.stdin.buffer.read())
            threading.Thread(target=_leave_with_parent, daemon=True).start()
        else:
            undisturbed()
            connection = socket.socket(fileno=descriptor)
            connection.set_inheritable(False)
            alive, nowhere = os.dup(0), os.open(os.devnull, os.O_RDONLY)
            os.dup2(nowhere, 0)
            os.close(nowhere)
            threading.Thread(target=_leave_at_the_end_of, args=(alive,), daemon=True).start()
        run(connection)
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
    finally:
        os._exit(LEFT_BEHIND)


def _leave_at_the_end_of(alive: int) -> None:
    """Wait for the parent's end, which a closed socket does not tell while an FMU is busy (POSIX)."""
    if sys.platform != "win32":
        os.read(alive, 1)
        os.killpg(0, signal.SIGKILL)


def _leave_with_parent() -> None:
    """Do the same on Windows."""
    if sys.platform == "win32":
        import _winapi

        synchronize = 0x00100000
        parent = _winapi.OpenProcess(synchronize, False, os.getppid())
        _winapi.WaitForSingleObject(parent, _winapi.INFINITE)
        os._exit(LEFT_BEHIND)
