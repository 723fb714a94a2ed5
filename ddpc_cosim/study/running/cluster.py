"""The cases of a study on a cluster: one task of dask.distributed each, isolated there as it is here.

A task takes along by content what its case reads, and brings back the case's files, which are accepted as
those of a local worker are. Nothing of the other machine is taken for granted: no path, and not that it has
the same code: only workers that have been compared with this machine are given cases. What a machine fails is
tried on others. Dask starts elsewhere what a dead worker was running, and gives up on what several died of.
"""

import hashlib
import json
import logging
import pickle
import platform
import tempfile
import uuid
import warnings
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import urlsplit

from ddpc_cosim.controller import Recording
from ddpc_cosim.errors import (
    ConfigError,
    CosimError,
    CosimWarning,
    MissingLibraryError,
    is_of_the_machine,
)
from ddpc_cosim.loop.trace import Outcome
from ddpc_cosim.plugins import names_in, origin, own_files, own_folder, plugin_names, values_of
from ddpc_cosim.processes.sandbox import demanded
from ddpc_cosim.processes.scratch import ScratchFolder, remove
from ddpc_cosim.settings import hash_of_file
from ddpc_cosim.study.case_files import RUN_FILE, STAGING, accept_case, read_sealed, sealed_json, write_case
from ddpc_cosim.study.case_runs import no_samples
from ddpc_cosim.study.cases import Case, CaseContext, data_files, plants_in, plugins_in
from fmu_plants.files import cache_dir, cached

if TYPE_CHECKING:
    from distributed import Client, Future

_CONNECT_SECONDS, _WORKERS_SECONDS, _LOOK_SECONDS = 10, 60, 5
# With so many for each of its threads, a worker never waits, and a study of any length fits in memory.
_TASKS_PER_THREAD = 2
# Machines that a case is tried on before their failing it is its own fault; cases that one may fail.
_MOST_TRIES, _MOST_FAILED = 3, 3
# How often all workers that have a case may go.
_MOST_LOST = 4
_COMPARED = ("ddpc-cosim", "numpy", "scipy", "FMPy", "piqp")

RunCases = Callable[..., Iterator[Case]]


class _Reply(NamedTuple):
    """What has become of a case on a worker: its files, and what the machine may be at fault for."""

    worker: str
    files: dict[str, bytes]
    fault: str


class _Sent(NamedTuple):
    """A case on its way, and the workers that may run it."""

    case: Case
    workers: frozenset[str]


@dataclass(frozen=True, slots=True)
class _Task:
    """A case on its way.

    Parameters
    ----------
    case : Case
        The case, without its recording.
    values : bytes
        As of :class:`CaseContext`.
    modules : dict of str to bytes
        The study's own modules, by path in its folder.
    files : dict of str to str
        The hash of the content of each file that the case reads, by path on the machine of the study.
    sandboxed : bool
        Whether it runs in a sandbox.
    versions : dict of str to str
        What the machine of the study has of what results depend on, by name.
    plugins : tuple of (str, str)
        Kind and name of the installed plug-ins that are among them.
    packages : tuple of str
        The packages that are among them.
    """

    case: Case
    values: bytes
    modules: dict[str, bytes]
    files: dict[str, str]
    sandboxed: bool
    versions: dict[str, str]
    plugins: tuple[tuple[str, str], ...]
    packages: tuple[str, ...]


def run_on_cluster(
    cases: Sequence[Case], folder: Path, scheduler: str, run_cases: RunCases, *, sandboxed: bool = False
) -> Iterator[Case]:
    """Run cases on the workers of a dask scheduler and yield each one when its files are written.

    Parameters
    ----------
    cases : sequence of Case
        What to run.
    folder : Path
        Each case is written to ``folder / case.id``.
    scheduler : str
        Its address.
    run_cases : callable
        What runs a case on a worker: :func:`ddpc_cosim.study.runner.run_cases`.
    sandboxed : bool
        Whether each case runs in a sandbox.

    Raises
    ------
    ConfigError
        The scheduler cannot be reached, or all its workers have other code than this machine.
    CosimError
        There are no workers, none of those that have tried a case can write it, or it cannot be written here.

    Warns
    -----
    CosimWarning
        A worker is left out, and why.
    """
    with _connected(scheduler) as client, ScratchFolder(folder, STAGING) as staging:
        yield from _Run(client, cases, folder, staging, run_cases, sandboxed).finished()


@contextmanager
def _connected(scheduler: str) -> "Iterator[Client]":
    try:
        from distributed import Client, Security
        from distributed.versions import VersionMismatchWarning
    except ModuleNotFoundError as error:
        raise MissingLibraryError.of("--executor dask", "dask.distributed", "cluster") from error
    if scheduler.startswith("tls:") and not Security().get_connection_args("client")["ssl_context"]:
        remedy = "give distributed.comm.tls.client.cert, .client.key and .ca-file in dask's configuration"
        raise ConfigError(f"--scheduler {scheduler}: there are no certificates for it; {remedy}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", VersionMismatchWarning)  # what decides results is compared here
            client = Client(scheduler, timeout=_CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        remedy = "give the address that `dask scheduler` prints, such as tcp://host:8786"
        message = f"--scheduler {scheduler}: no dask scheduler answers ({type(error).__name__}: {error})"
        raise ConfigError(f"{message}; {remedy}") from error
    logger = logging.getLogger("distributed.client")  # which prints tracebacks of what is reported here
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield client
    finally:
        client.close()
        logger.setLevel(level)


class _Run:
    """Cases on their way; parameters as of :func:`run_on_cluster`."""

    def __init__(
        self,
        client: "Client",
        cases: Sequence[Case],
        folder: Path,
        staging: Path,
        run_cases: RunCases,
        sandboxed: bool,
    ) -> None:
        self._client, self._folder, self._staging = client, folder, staging
        self._run_cases, self._sandboxed = run_cases, sandboxed
        self._waiting, self._running = deque(cases), dict["Future", _Sent]()
        self._compared = dict[str, list[str]]()  # what workers have otherwise
        self._failed_on, self._lost = dict[str, list[str]](), Counter[str]()  # by the case's id
        self._failures = Counter[str]()  # of a worker, with cases that another one has run
        self._last_faults, self._left_out = dict[str, str](), set[str]()
        self._modules = dict[tuple[str, ...], dict[str, bytes]]()
        self._contents = dict[str, "Future"]()
        self._recordings = dict[int, tuple[Recording, "Future"]]()
        self._plugins = tuple(sorted({pair for case in cases for pair in _installed_in(case)}))
        stored = {"pyarrow" for case in cases if case.storage == "parquet"}
        self._packages = (*_COMPARED, *stored)
        self._versions = _versions(self._plugins, self._packages)

    def finished(self) -> Iterator[Case]:
        """Yield each case when its files are written."""
        from distributed import wait
        from distributed.comm import CommClosedError

        try:
            while self._waiting or self._running:
                workers = self._workers()
                yield from self._recall(workers)
                room = _TASKS_PER_THREAD * sum(workers.values()) - len(self._running)
                for _ in range(min(room, len(self._waiting))):
                    self._submit(self._waiting.popleft(), workers)
                if not (running := list(self._running)):
                    continue
                try:
                    with self._client.as_current():
                        done = wait(running, timeout=_LOOK_SECONDS, return_when="FIRST_COMPLETED").done
                except TimeoutError:  # there may be more workers by now, or none
                    continue
                for future in done:
                    case = self._running.pop(future).case
                    if self._is_finished(case, future, workers):
                        yield case
        except (CancelledError, CommClosedError) as error:
            remedy = "finished cases are kept; start one, and the same command goes on from there"
            raise CosimError(f"the dask scheduler has gone; {remedy}") from error
        finally:
            with suppress(CommClosedError):
                self._client.cancel(list(self._running), force=True)

    def _workers(self) -> dict[str, int]:
        """Return the threads of each worker that has what is here, of which there is one at least."""
        while True:
            threads = self._threads()
            for gone in self._compared.keys() - threads.keys():  # another one may have its address later
                del self._compared[gone]
            if new := [worker for worker in threads if worker not in self._compared]:
                asked = (self._plugins, self._packages)
                there = self._client.run(_versions, *asked, workers=new, on_error="return")
                for worker, versions in there.items():
                    if not isinstance(versions, OSError):  # it has gone meanwhile
                        self._compared[worker] = _faults(worker, versions, self._versions)
            fit = {worker: n for worker, n in threads.items() if self._compared.get(worker) == []}
            faults = {worker: compared for worker in threads if (compared := self._compared.get(worker))}
            if len(faults) == len(threads):
                raise ConfigError([fault for worker_faults in faults.values() for fault in worker_faults])
            for worker in faults.keys() - self._left_out:
                self._leave_out(worker, faults[worker])
            if fit:
                return fit

    def _threads(self) -> dict[str, int]:
        """Return how many threads each worker has, of which there is one at least."""
        if not (threads := self._client.nthreads()):
            try:
                self._client.wait_for_workers(1, timeout=_WORKERS_SECONDS)
            except TimeoutError as error:
                address = self._client.scheduler.address
                where = f"scheduler {address} has had no workers for {_WORKERS_SECONDS} s"
                remedy = f"start some with `dask worker {address}`; finished cases are kept"
                raise CosimError(f"{where}; {remedy}") from error
            threads = self._client.nthreads()
        return dict(threads)

    def _leave_out(self, worker: str, faults: Sequence[str]) -> None:
        """Name a worker that gets no more cases."""
        self._left_out.add(worker)
        for fault in faults:
            warnings.warn(f"{fault}; its cases are run on others", CosimWarning, stacklevel=2)

    def _recall(self, workers: Collection[str]) -> Iterator[Case]:
        """Have cases whose workers have all gone wait again, and yield those that are given up."""
        for future, (case, those) in list(self._running.items()):
            if not those.isdisjoint(workers):
                continue
            del self._running[future]
            self._client.cancel([future], force=True)
            self._lost[case.id] += 1
            if self._lost[case.id] < _MOST_LOST:
                self._waiting.appendleft(case)
            else:
                self._give_up(case, f"{_MOST_LOST} times all dask workers that had it have gone")
                yield case

    def _places(self, case: Case, workers: Collection[str]) -> frozenset[str]:
        """Return the workers to try a case on: none that failed it, of another machine where there is one."""
        failed_on = self._failed_on.get(case.id, [])
        untried = frozenset(workers).difference(failed_on)
        hosts = {urlsplit(worker).hostname for worker in failed_on}
        elsewhere = frozenset(worker for worker in untried if urlsplit(worker).hostname not in hosts)
        trusted = (elsewhere - self._distrusted(), untried - self._distrusted())
        return next(filter(None, trusted), untried)

    def _distrusted(self) -> set[str]:
        """Return the workers that may have failed too many cases; some may be their own fault yet."""
        count = Counter(worker for failed_on in self._failed_on.values() for worker in failed_on)
        return {worker for worker, cases in (count + self._failures).items() if cases >= _MOST_FAILED}

    def _submit(self, case: Case, workers: Collection[str]) -> None:
        """Send a case; what several have in common is sent once."""
        places = self._places(case, workers)
        names = tuple(plugins_in(case))
        if names not in self._modules:
            self._modules[names] = {name: path.read_bytes() for name, path in own_files(names).items()}
        files = {path: content for path in data_files(case) if (content := hash_of_file(path))}
        for path, content in files.items():
            if content not in self._contents:
                self._contents[content] = self._send(Path(path).read_bytes())
        recording = None
        if case.recording is not None:
            if id(case.recording) not in self._recordings:
                sent = self._send(pickle.dumps(case.recording))
                self._recordings[id(case.recording)] = (case.recording, sent)
            recording = self._recordings[id(case.recording)][1]
        bare = _moved(case, names_in(own_folder(), names), None)  # where its modules will be
        values = CaseContext.of(case).values
        carried = (values, self._modules[names], files)
        task = _Task(bare, *carried, self._sandboxed, self._versions, self._plugins, self._packages)
        needed = {file: self._contents[file] for file in files.values()}
        key = f"{case.id}-{uuid.uuid4().hex}"
        task_and_data = (task, recording, needed, self._run_cases)
        future = self._client.submit(_run_there, *task_and_data, key=key, workers=[*places])
        self._running[future] = _Sent(case, places)

    def _send(self, content: bytes) -> "Future":
        """Send what workers pass on to each other; as a task, so that it outlives a worker that has it.

        Any worker may have it, left out or not: it needs nothing of this project for that.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # it is large
            return self._client.submit(bytes, content, key=f"ddpc-cosim-{uuid.uuid4().hex}")

    def _is_finished(self, case: Case, future: "Future", workers: Collection[str]) -> bool:
        """Whether a case is over, and then all that is known of it written; else it is tried elsewhere."""
        from distributed import KilledWorker

        error = future.exception()
        if error is None:
            reply: _Reply = future.result()
            if reply.fault and self._is_tried_again(case, reply, workers):
                return False
            if not reply.files:
                raise CosimError(f"worker {reply.worker}: {reply.fault}")
            self._accept(case, reply.files)
            self._hold_against(self._failed_on.pop(case.id, []))
        elif isinstance(error, KilledWorker):
            died, last = error.allowed_failures + 1, error.last_worker.address
            self._give_up(case, f"{died} dask workers died while they ran it, the last of them {last}")
        elif isinstance(error, CosimError):
            raise error
        else:
            raise CosimError(f"{case.name}: on a dask worker: {type(error).__name__}: {error}") from error
        return True

    def _is_tried_again(self, case: Case, reply: _Reply, workers: Collection[str]) -> bool:
        """Whether a case that a machine has failed waits for another one."""
        failed_on = self._failed_on.setdefault(case.id, [])
        failed_on.append(reply.worker)
        if len(failed_on) >= _MOST_TRIES or not self._places(case, workers):
            del self._failed_on[case.id]  # it is its own fault
            return False
        self._waiting.appendleft(case)
        self._last_faults[reply.worker] = reply.fault
        return True

    def _hold_against(self, workers: Iterable[str]) -> None:
        """Count a case that has been run against the workers that have failed it before."""
        for worker in workers:
            self._failures[worker] += 1
            if self._failures[worker] >= _MOST_FAILED and worker not in self._left_out:
                failed = f"worker {worker}: {_MOST_FAILED} cases have failed there that others have run"
                self._leave_out(worker, [f"{failed}, the last of them: {self._last_faults[worker]}"])

    def _accept(self, case: Case, files: Mapping[str, bytes]) -> None:
        staged = Path(tempfile.mkdtemp(dir=self._staging))
        try:
            for name, content in files.items():
                (staged / Path(name).name).write_bytes(content)
            # It says itself in which sandbox it was, which depends on the worker's system.
            head = {key: value for key, value in case.head().items() if key != "sandbox"}
            accept_case(staged, self._folder / case.id, head, "", max(map(len, files.values())))
        except ConfigError as error:
            self._give_up(case, f"its dask worker has sent no results: {error}")
        except OSError as error:
            raise CosimError(f"{staged}: cannot be written: {error}; finished cases are kept") from error
        finally:
            remove(staged)

    def _give_up(self, case: Case, reason: str) -> None:
        trace = no_samples(case, Outcome.CRASHED, f"before the first sample: {reason}")
        write_case(self._folder / case.id, trace, case.head(), self._staging, case.metrics)


def _installed_in(case: Case) -> Iterator[tuple[str, str]]:
    """Yield kind and name of the installed plug-ins of a case: the others, and FMUs, travel with it."""
    plants = [*plants_in(case)]
    pairs = [("controllers", name) for name in [*plugins_in(case)][len(plants) :] if name]
    pairs += [("plants", name) for name in plants]
    for kind, name in pairs:
        if not values_of([name]) and not own_files([name]):
            yield kind, name


@cache
def _versions(plugins: tuple[tuple[str, str], ...], packages: tuple[str, ...]) -> dict[str, str]:
    """Return what a machine has of what results depend on, by name."""
    versions = {"Python": ".".join(platform.python_version_tuple()[:2])}
    for name in packages:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "missing"
    metrics = tuple(("metrics", name) for name in plugin_names("metrics"))
    versions["names of metrics"] = ", ".join(name for _, name in metrics) or "none"
    return versions | {f"{kind} {name}": origin(kind, name) for kind, name in (*plugins, *metrics)}


def _faults(worker: str, there: Any, here: Mapping[str, str]) -> list[str]:
    """Return in words what a worker has otherwise."""
    if not isinstance(there, dict):
        return [f"worker {worker}: ddpc-cosim cannot be asked for its version there: {there}"]
    return [
        f"worker {worker}: {name}: {version} there, {expected} here; install the same there"
        for name, expected in here.items()
        if (version := there.get(name, "missing")) != expected
    ]


def _run_there(
    task: _Task, recording: bytes | None, contents: Mapping[str, bytes], run_cases: RunCases
) -> _Reply:
    """Run a case, on a dask worker, in a process of its own; return its files by name."""
    from distributed import get_worker

    worker = get_worker()
    if faults := _faults(worker.address, _versions(task.plugins, task.packages), task.versions):
        return _Reply(worker.address, {}, "; ".join(faults))
    try:
        with demanded(task.sandboxed):
            places = {path: _placed(path, contents[content], content) for path, content in task.files.items()}
        with ScratchFolder() as scratch:
            modules = _modules(task.modules) if task.modules else scratch
            context = CaseContext(str(modules), task.values, (*map(Path, places.values()), modules))
            case = _moved(task.case, places, None if recording is None else pickle.loads(recording))
            threads = worker.state.nthreads
            for _ in run_cases([case], scratch, threads, sandboxed=task.sandboxed, context=context):
                pass
            return _reply(worker.address, scratch / case.id, places)
    except (CosimError, OSError, MemoryError) as error:
        if is_of_the_machine(error):
            return _Reply(worker.address, {}, str(error))
        raise CosimError(f"worker {worker.address}: {error}") from error


def _placed(path: str, content: bytes, expected: str) -> str:
    """Return where a file stands on this machine, which has its name, and no other path's."""
    if hashlib.sha256(content).hexdigest() != expected:
        raise CosimError(f"{path} has not come through as it was sent")
    place = hashlib.sha256(f"{path} {expected}".encode()).hexdigest()
    placed = cached(f"cluster/{place}/{Path(path).name}", lambda: content)
    if placed.suffix.lower() == ".fmu":
        from ddpc_cosim.fmu.library import compile_ahead  # with all that runs FMUs

        compile_ahead(placed)
    return str(placed)


def _modules(code: Mapping[str, bytes]) -> Path:
    """Return the folder on this machine that holds a study's own modules."""
    place = f"cluster/{hashlib.sha256(repr(sorted(code.items())).encode()).hexdigest()}"
    for name, content in code.items():
        cached(f"{place}/{name}", lambda: content)  # noqa: B023 - called at once
    return cache_dir() / place


def _moved(case: Case, places: Mapping[str, str], recording: Recording | None) -> Case:
    """Return a case with the paths and the recording that it has on this machine."""

    def moved(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: moved(item) for key, item in value.items()}
        if isinstance(value, list):
            return [moved(item) for item in value]
        return places.get(value, value) if isinstance(value, str) else value

    sections = {"section": moved(case.section), "stabiliser": moved(case.stabiliser)}
    return replace(case, plant=case.plant.moved(moved), recording=recording, **sections)


def _reply(worker: str, folder: Path, places: Mapping[str, str]) -> _Reply:
    """Return the files of a case with the paths that they have where its study is."""
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    run = read_sealed(folder / RUN_FILE)
    text = json.dumps(run)
    for path, place in places.items():
        text = text.replace(json.dumps(place)[1:-1], json.dumps(path)[1:-1])
    fault = run["reason"] if run["transient"] else ""
    return _Reply(worker, files | {RUN_FILE: sealed_json(json.loads(text))}, fault)
