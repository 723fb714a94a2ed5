"""Starting the processes in which isolated FMUs live, reading from them within time, and ending them."""

import json
import os
import subprocess
import sys
import threading
from abc import ABC, abstractmethod
from io import FileIO
from multiprocessing.spawn import get_executable
from time import monotonic
from typing import NamedTuple

from ddpc_cosim.errors import FMUImportError

CANNOT_START = "the process that isolates FMUs cannot be started"

_RUN = """
import json, sys
sys.path[:] = json.loads(sys.argv[1])
from ddpc_cosim.fmu.isolation_child import main
main()
"""
# Small matrices gain nothing from threaded linear algebra, and threads do not survive a fork.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_WATCH_SECONDS = 0.1

server_is_kept = False
"""Whether the process from which FMUs are forked stays when there is no FMU, for the next one."""


class Ending(NamedTuple):
    """How a process ended: exit code, negative for a signal, None if unknown; and what it printed last."""

    code: int | None
    output: str = ""


class Child(ABC):
    """A process that isolates one FMU.

    Parameters
    ----------
    reader, writer : FileIO
        The pipes from it and to it.
    """

    def __init__(self, reader: FileIO, writer: FileIO) -> None:
        self._reader, self._writer = reader, writer
        self.write = writer.write
        self._owner = os.getpid()
        self._has_ended = False

    @abstractmethod
    def read_into(self, memory: memoryview, seconds: float) -> int:
        """Read what there is; return the number of bytes, 0 if the process is gone.

        Raises
        ------
        TimeoutError
            There is nothing to read for so long.
        """

    @abstractmethod
    def _end(self, *, at_leisure: bool) -> Ending:
        """End and reap the process; at leisure, it may be reaped later."""

    def end(self, *, at_leisure: bool = False) -> Ending:
        """End the process, if it has not ended, and return how it did.

        Nothing is known the second time, nor in a forked copy of the process's owner.
        """
        if self._has_ended or os.getpid() != self._owner:
            return Ending(None)
        self._has_ended = True
        try:
            return self._end(at_leisure=at_leisure)
        finally:
            self._reader.close()
            self._writer.close()


def launch() -> Child:
    """Start a process for one FMU, the quickest way that is safe here.

    Raises
    ------
    FMUImportError
        It cannot be started.
    """
    if sys.platform == "win32":
        return SpawnedChild()
    from ddpc_cosim.fmu.isolation_fork import ForkedChild

    return ForkedChild()


def keep_server() -> None:
    """Keep the process from which FMUs are forked, once there is one, as long as this process lives."""
    global server_is_kept
    server_is_kept = True


def start_python(
    code: str, *arguments: str, stream: int, pass_fds: tuple[int, ...] = ()
) -> "subprocess.Popen[bytes]":
    """Start this Python with the same import path, away from the terminal and its Ctrl-C.

    Parameters
    ----------
    code : str
        What to run.
    arguments : str
        Its arguments; the import path comes last, as JSON.
    stream : int
        What standard input and output are, as for :class:`subprocess.Popen`.
    pass_fds : tuple of int
        Descriptors to pass on.

    Raises
    ------
    FMUImportError
        It cannot be started.
    """
    executable, flags = os.fsdecode(get_executable()), 0
    if sys.platform == "win32":
        # In a virtual environment, python.exe only launches this one, and would be ended in its place.
        executable = sys._base_executable
        flags = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW
    try:
        return subprocess.Popen(
            [executable, "-c", code, *arguments, json.dumps(sys.path)],
            bufsize=0,
            stdin=stream,
            stdout=stream,
            stderr=subprocess.DEVNULL,
            env=_ONE_THREAD | os.environ,
            start_new_session=True,
            creationflags=flags,
            pass_fds=pass_fds,
        )
    except OSError as error:
        raise FMUImportError(f"{CANNOT_START}: {error}") from error


class SpawnedChild(Child):
    """A process started from nothing and watched by a thread: slow to start, but works everywhere."""

    def __init__(self) -> None:
        self._process = start_python(_RUN, stream=subprocess.PIPE)
        reader, writer = self._process.stdout, self._process.stdin
        if not isinstance(reader, FileIO) or not isinstance(writer, FileIO):
            raise FMUImportError(CANNOT_START)
        super().__init__(reader, writer)
        self._reading_since: float | None = None
        self._limit = 0.0
        self._is_late = False
        self._ending = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    def read_into(self, memory: memoryview, seconds: float) -> int:
        """Read what there is, as every child; a late answer is one that never comes."""
        self._limit, self._reading_since = seconds, monotonic()
        received = self._reader.readinto(memory)
        self._reading_since = None
        if not received and self._is_late:
            raise TimeoutError
        return received

    def _watch(self) -> None:
        """End a process that keeps its reader waiting: reading cannot be limited otherwise everywhere."""
        while not self._ending.wait(_WATCH_SECONDS):
            since = self._reading_since
            if since is not None and monotonic() - since > self._limit:
                self._is_late = True
                self._process.kill()
                return

    def _end(self, *, at_leisure: bool) -> Ending:
        self._ending.set()
        self._process.kill()
        return Ending(self._process.wait())
