"""The process in which an isolated FMU lives: does what the master asks for, one request after the other."""

import contextlib
import itertools
import os
import sys
import threading
from io import FileIO
from typing import Any, NoReturn

from ddpc_cosim.errors import CosimError, FMUImportError, FMUStepError, StepStatus
from ddpc_cosim.fmu import output, scratch
from ddpc_cosim.fmu.isolation_frames import Frame, pack, unpack, write_all
from ddpc_cosim.fmu.isolation_messages import FREE_STATES, RESTORE_STATE, SAVE_STATE, Call, Job, Opened, Reply
from ddpc_cosim.fmu.session import FMUSession

LEFT_BEHIND = 70
"""Exit code of a child that has nothing to do any more."""


def run(reading: int, writing: int) -> NoReturn:
    """Serve the master at the other end of two pipes until it closes them."""
    output.leave_alone()
    _close_input()
    reader, writer = FileIO(reading), FileIO(writing, "w")
    with contextlib.suppress(EOFError, BrokenPipeError):
        job = unpack(b"", reader.readinto)
        _settle(job)
        try:
            session = FMUSession(job.path, **job.session)
        except Exception as error:
            fault = FMUImportError(f"{job.path.name}: {type(error).__name__}: {error}")
            told = error if isinstance(error, CosimError) else fault
            write_all(writer.write, memoryview(pack(Reply(None, told))))
        else:
            _Service(session, reader, writer).serve()
    os._exit(LEFT_BEHIND)


class _Service:
    """A session at the far end of the pipes."""

    def __init__(self, session: FMUSession, reader: FileIO, writer: FileIO) -> None:
        self._session = session
        self._reader, self._writer = reader, writer
        self._states: dict[int, object] = {}
        self._numbers = itertools.count()

    def serve(self) -> NoReturn:
        """Answer requests; leave when there is nobody to answer."""
        session = self._session
        self._send(Opened(session.description, session.interface, session.inputs, session.outputs))
        request, reply = Frame(len(session.inputs)), Frame(len(session.outputs))
        reply.mark()
        read_into, write, step = self._reader.readinto, self._writer.write, session.step
        while True:
            received = read_into(request.memory)
            if not received:
                raise EOFError
            if not request.is_step(received):
                self._answer(unpack(bytes(request.memory[:received]), read_into))
                continue
            try:
                reply.values[:] = step(request.values, request.scalar)
            except Exception as error:
                self._send(None, self._told(error))
            else:
                reply.scalar = session.time
                write_all(write, reply.memory)

    def _answer(self, call: Call) -> None:
        try:
            result = self._call(call)
        except Exception as error:
            self._send(None, self._told(error))
        else:
            self._send(result)

    def _call(self, call: Call) -> Any:
        """Call a method; saved states stay here, the master gets their numbers."""
        if call.method == FREE_STATES:
            for number in call.arguments:
                self._states.pop(number, None)
            return None
        if call.method == RESTORE_STATE:
            return self._session.restore_state(self._states.get(call.arguments[0]))
        result = getattr(self._session, call.method)(*call.arguments)
        if call.method == SAVE_STATE:
            number = next(self._numbers)
            self._states[number] = result
            return number
        return result

    def _told(self, error: Exception) -> CosimError:
        """Return an error that the master can be sent."""
        if isinstance(error, CosimError):
            return error
        message = f"{self._session.path.name}: {type(error).__name__}: {error}"
        return FMUStepError(message, StepStatus.ERROR, self._session.time)

    def _send(self, result: Any, error: CosimError | None = None) -> None:
        reply = Reply(result, error, self._session.time, self._session.warnings)
        write_all(self._writer.write, memoryview(pack(reply)))


def _settle(job: Job) -> None:
    """Take over the master's working directory and environment; temporary files go to its folder."""
    os.environ.clear()
    os.environ.update(job.environment)
    with contextlib.suppress(OSError):
        os.chdir(job.working_directory)
    scratch.stay_within(job.folder)


def _close_input() -> None:
    """Leave the FMU nothing to read."""
    nowhere = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nowhere, 0)
    os.close(nowhere)


def main() -> NoReturn:
    """Serve a master that is the parent process, and has the other ends of standard input and output."""
    reading, writing = os.dup(0), os.dup(1)
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in (1, 2):
        os.dup2(nowhere, descriptor)
    if sys.platform == "win32":
        threading.Thread(target=_leave_with_parent, daemon=True).start()
    run(reading, writing)


def _leave_with_parent() -> None:
    """Wait for the parent's end, which a closed pipe does not tell while the FMU is busy (Windows)."""
    if sys.platform == "win32":
        import _winapi

        synchronize = 0x00100000
        parent = _winapi.OpenProcess(synchronize, False, os.getppid())
        _winapi.WaitForSingleObject(parent, _winapi.INFINITE)
        os._exit(LEFT_BEHIND)
