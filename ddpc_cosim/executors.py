"""Running many cases in isolated local workers: a crash or a hang costs one case and nothing else."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from functools import cache
from multiprocessing import get_context, parent_process
from multiprocessing.context import BaseContext
from multiprocessing.util import Finalize, get_temp_dir
from pathlib import Path
from typing import Any, NamedTuple

from pebble import ProcessExpired, ProcessPool

from ddpc_cosim.errors import CosimError
from ddpc_cosim.fmu import isolation_launch, scratch
from ddpc_cosim.storage import remove_drafts, write_case
from ddpc_cosim.study import Case, no_samples, run_case
from ddpc_cosim.trace import Outcome

_POLL_SECONDS = 0.1
# Small matrices gain nothing from threaded linear algebra, and workers would fight for the processors.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

# It removes its folder at -100.
_AFTER_MULTIPROCESSING = -200

_updates: Any = None


class Update(NamedTuple):
    """How far a running case is."""

    case: str
    samples: int
    planned: int


Watcher = Callable[[Update], None]


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
    """
    context = _context()
    updates = context.SimpleQueue()
    with (
        _single_threaded(),
        # Whatever a worker that was killed has left behind is removed with this folder.
        scratch.ScratchFolder() as temporary,
        _no_drafts(cases, folder),
        ProcessPool(
            jobs, context=context, initializer=_prepare_worker, initargs=[updates, temporary]
        ) as pool,
    ):
        running: dict[Future[None], Case] = {
            # The id goes with the case: a worker may see other code, and so another id, than the master did.
            pool.schedule(_run_and_write, args=[case, folder / case.id, case.head()]): case
            for case in cases
        }
        try:
            while running:
                done, _ = wait(running, timeout=_POLL_SECONDS, return_when=FIRST_COMPLETED)
                while not updates.empty():
                    update = updates.get()
                    if watch is not None:
                        watch(update)
                for future in done:
                    case = running.pop(future)
                    _finish(future, case, folder / case.id)
                    yield case
        except BaseException:
            pool.stop()  # type: ignore[no-untyped-call]
            raise


def _context() -> BaseContext:
    """Return the quickest way to start clean workers: a preloaded fork server where there is one."""
    if sys.platform == "win32" or sys.platform == "darwin":
        return get_context("spawn")
    _keep_sockets()
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
def _no_drafts(cases: Sequence[Case], folder: Path) -> Iterator[None]:
    """Remove the drafts of cases whose worker was killed while it wrote them."""
    try:
        yield
    finally:
        for case in cases:
            remove_drafts(folder / case.id)


def _prepare_worker(updates: Any, temporary: Path) -> None:
    """Tell a worker where to report progress and to keep files; an interrupt is the master's to handle."""
    global _updates
    _updates = updates
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


def _run_and_write(case: Case, folder: Path, head: dict[str, Any]) -> None:
    from time import monotonic

    last = monotonic()

    def progress(samples: int, planned: int) -> None:
        nonlocal last
        if monotonic() - last > _POLL_SECONDS:
            last = monotonic()
            _updates.put(Update(case.name, samples, planned))

    write_case(folder, run_case(case, progress), head)


def _finish(future: Future[None], case: Case, folder: Path) -> None:
    """Write what is known of a case whose worker died."""
    try:
        future.result()
    except ProcessExpired as error:
        trace = no_samples(
            case, Outcome.CRASHED, f"the worker process died: {_cause_of_death(error.exitcode)}"
        )
        write_case(folder, trace, case.head())
    except CosimError:
        raise
    except Exception as error:  # a fault of the master itself must not cost the other cases
        trace = no_samples(case, Outcome.CRASHED, f"{type(error).__name__}: {error}")
        write_case(folder, trace, case.head())


def _cause_of_death(exit_code: int) -> str:
    if exit_code < 0:
        try:
            return signal.Signals(-exit_code).name
        except ValueError:
            return f"signal {-exit_code}"
    return f"exit code {exit_code}"
