"""Running many cases in isolated local workers: a crash or a hang costs one case and nothing else."""

import os
import shutil
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from functools import cache
from multiprocessing import get_context, parent_process
from multiprocessing.context import BaseContext
from multiprocessing.util import Finalize, get_temp_dir
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

from pebble import ProcessExpired, ProcessPool

from ddpc_cosim.errors import CosimError
from ddpc_cosim.fmu import isolation_launch, scratch
from ddpc_cosim.study.cases import Case, no_samples, run_case
from ddpc_cosim.study.results import write_case
from ddpc_cosim.trace import Outcome

_POLL_SECONDS = 0.1
# Small matrices gain nothing from threaded linear algebra, and workers would fight for the processors.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

# Workers are asked for through a socket there: its path may have 107 bytes, 103 with some systems.
_LONGEST_SOCKET_FOLDER = 103 - len("/listener-12345678")

# It removes its folder at -100.
_AFTER_MULTIPROCESSING = -200


class Update(NamedTuple):
    """How far a running case is."""

    case: str
    samples: int
    planned: int


Watcher = Callable[[Update], None]


class _Channel(NamedTuple):
    """Where workers say how far they are."""

    sender: Any
    lock: Any

    def tell(self, update: Update) -> None:
        """Tell an update, unless another worker is at it; it may have died so, with the lock in its hands."""
        if self.lock.acquire(block=False):
            try:
                self.sender.send(update)
            finally:
                self.lock.release()


_channel: Any = None


def run_cases(cases: Sequence[Case], folder: Path, jobs: int, watch: Watcher | None = None) -> Iterator[Case]:
    """Run cases in ``jobs`` worker processes and yield each one when its files are written.

    Parameters
    ----------
    cases : sequence of Case
        What to run.
    folder : Path
        Each case is written to ``folder / case.id``.
    jobs : int
        Number of workers.
    watch : callable, optional
        Called with the progress of running cases.

    Raises
    ------
    CosimError
        A case cannot be written.
    """
    context = _context()
    updates, sender = context.Pipe(duplex=False)
    channel = _Channel(sender, context.Lock())
    done: SimpleQueue[Future[None]] = SimpleQueue()
    with (
        updates,
        sender,
        _single_threaded(),
        # Whatever a worker that was killed has left behind is removed with these folders.
        scratch.ScratchFolder() as temporary,
        _drafts(folder) as drafts,
        ProcessPool(
            jobs, context=context, initializer=_prepare_worker, initargs=[channel, temporary]
        ) as pool,
    ):
        running: dict[Future[None], Case] = {}
        try:
            for case in cases:
                # A worker may see other code than the master did, and so another id: it is told this one.
                arguments = [case, folder / case.id, case.head(), drafts]
                future: Future[None] = pool.schedule(_run_and_write, args=arguments)
                running[future] = case
                future.add_done_callback(done.put)
            while running:
                ended = _next(done)
                while updates.poll():
                    update = updates.recv()
                    if watch is not None:
                        watch(update)
                if ended is not None:
                    case = running.pop(ended)
                    _finish(ended, case, folder / case.id, drafts)
                    yield case
        except BaseException:
            pool.stop()  # type: ignore[no-untyped-call]
            raise


def _next(done: "SimpleQueue[Future[None]]") -> "Future[None] | None":
    """Return a run that has ended, None if there is none within a moment."""
    try:
        return done.get(timeout=_POLL_SECONDS)
    except Empty:
        return None


def _context() -> BaseContext:
    """Return the quickest way to start clean workers: a preloaded fork server where there is one."""
    if sys.platform == "win32" or sys.platform == "darwin":
        return get_context("spawn")
    _keep_sockets()
    if len(os.fsencode(get_temp_dir())) > _LONGEST_SOCKET_FOLDER:
        return get_context("spawn")
    context = get_context("forkserver")
    context.set_forkserver_preload([__name__])
    return context


@cache
def _keep_sockets() -> None:
    """Have multiprocessing's folder removed also if this process is killed."""
    keeper = scratch.Keeper(Path(get_temp_dir()))
    Finalize(None, keeper.dismiss, exitpriority=_AFTER_MULTIPROCESSING)


@contextmanager
def _single_threaded() -> Iterator[None]:
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update({name: value for name, value in _ONE_THREAD.items() if before[name] is None})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)


@contextmanager
def _drafts(folder: Path) -> Iterator[Path]:
    """Make a folder for the drafts of this run's cases, which goes with the run, however it ends."""
    try:
        drafts = Path(tempfile.mkdtemp(prefix=".drafts-", dir=folder)).resolve()
    except OSError as error:
        raise CosimError(f"{folder}: cannot be written to: {error.strerror}") from error
    keeper = scratch.Keeper(drafts)
    try:
        yield drafts
    finally:
        shutil.rmtree(drafts, ignore_errors=True)
        keeper.dismiss()


def _prepare_worker(channel: _Channel, temporary: Path) -> None:
    """Tell a worker where to report progress and to keep files; an interrupt is the master's to handle."""
    global _channel
    _channel = channel
    scratch.stay_within(temporary)
    isolation_launch.keep_server()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_leave_with_master, daemon=True).start()


def _leave_with_master() -> None:
    """End this worker when the master has gone, also in the middle of an FMU's step that hangs."""
    master = parent_process()
    if master is not None:
        master.join()
        os._exit(1)


def _run_and_write(case: Case, folder: Path, head: dict[str, Any], drafts: Path) -> None:
    from time import monotonic

    last = monotonic()

    def progress(samples: int, planned: int) -> None:
        nonlocal last
        if monotonic() - last > _POLL_SECONDS:
            last = monotonic()
            _channel.tell(Update(case.name, samples, planned))

    write_case(folder, run_case(case, progress), head, drafts)


def _finish(future: Future[None], case: Case, folder: Path, drafts: Path) -> None:
    """Write what is known of a case whose worker died.

    Raises
    ------
    CosimError
        The worker could not write the case, and so nobody can.
    """
    error = future.exception()
    if error is None:
        return
    if isinstance(error, CosimError):
        raise error
    # A fault of the master itself must not cost the other cases, nor an exit() in somebody's code.
    reason = f"{type(error).__name__}: {error}".removesuffix(": ")
    if isinstance(error, ProcessExpired):
        reason = f"the worker process died: {_cause_of_death(error.exitcode)}"
    write_case(folder, no_samples(case, Outcome.CRASHED, reason), case.head(), drafts)


def _cause_of_death(exit_code: int) -> str:
    if exit_code < 0:
        try:
            return signal.Signals(-exit_code).name
        except ValueError:
            return f"signal {-exit_code}"
    return f"exit code {exit_code}"
