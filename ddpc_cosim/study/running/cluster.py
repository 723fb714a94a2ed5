"""The cases of a study on a cluster: one task of dask.distributed each, isolated there as it is here.

A task takes along by content what its case reads, and brings back the case's files, which are accepted as
those of a local worker are. Nothing of the other machine is taken for granted: no path, and not that it has
the same code. Dask starts elsewhere what a dead worker was running, and gives up on what several died of.
"""

import hashlib
import json
import logging
import platform
import tempfile
import uuid
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ddpc_cosim.controller import Recording
from ddpc_cosim.errors import ConfigError, CosimError, MissingLibraryError
from ddpc_cosim.plugins import names_in, origin, own_files, own_folder, plugin_names, values_of
from ddpc_cosim.processes.sandbox import demanded
from ddpc_cosim.processes.scratch import ScratchFolder, remove
from ddpc_cosim.settings import hash_of_file
from ddpc_cosim.study.case_files import RUN_FILE, accept_case, read_sealed, sealed_json, write_case
from ddpc_cosim.study.cases import Case, Surroundings, data_files, no_samples, plants_in, plugins_in
from ddpc_cosim.trace import Outcome
from fmu_plants.files import cache_dir, cached

if TYPE_CHECKING:
    from distributed import Client, Future

_CONNECT_SECONDS, _WORKERS_SECONDS, _LOOK_SECONDS = 10, 60, 5
# With so many for each of its threads, a worker never waits, and a study of any length fits in memory.
_TASKS_PER_THREAD = 2
_COMPARED = ("ddpc-cosim", "numpy", "scipy", "FMPy", "piqp")

RunCases = Callable[..., Iterator[Case]]


@dataclass(frozen=True, slots=True)
class _Task:
    """A case on its way.

    Parameters
    ----------
    case : Case
        The case, without its recording.
    values : bytes
        As of :class:`Surroundings`.
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
        The scheduler cannot be reached, or workers have other code than this machine.
    CosimError
        There are no workers, or a case cannot be written.
    """
    with _connected(scheduler) as client, ScratchFolder(folder, ".staging-") as staging:
        yield from _Run(client, cases, folder, staging, run_cases, sandboxed).finished()


@contextmanager
def _connected(scheduler: str) -> "Iterator[Client]":
    try:
        from distributed import Client
    except ModuleNotFoundError as error:
        raise MissingLibraryError.of("--executor dask", "dask.distributed", "cluster") from error
    try:
        client = Client(scheduler, timeout=_CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        remedy = "give the address that `dask scheduler` prints, such as tcp://host:8786"
        message = f"--scheduler {scheduler}: no dask scheduler answers ({type(error).__name__}: {error})"
        raise ConfigError(f"{message}; {remedy}") from error
    logger = logging.getLogger("distributed.client")  # which prints tracebacks of what is told here
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
        self._waiting, self._running = deque(cases), dict["Future", Case]()
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
            self._check_workers()
            while self._waiting or self._running:
                room = _TASKS_PER_THREAD * self._threads() - len(self._running)
                for _ in range(min(room, len(self._waiting))):
                    self._submit(self._waiting.popleft())
                running = list(self._running)
                try:
                    with self._client.as_current():
                        done = wait(running, timeout=_LOOK_SECONDS, return_when="FIRST_COMPLETED").done
                except TimeoutError:  # there may be more workers by now, or none
                    continue
                for future in done:
                    case = self._running.pop(future)
                    self._finish(case, future)
                    yield case
        except (CancelledError, CommClosedError) as error:
            remedy = "finished cases are kept; start one, and the same command goes on from there"
            raise CosimError(f"the dask scheduler has gone; {remedy}") from error
        finally:
            with suppress(CommClosedError):
                self._client.cancel(list(self._running), force=True)

    def _threads(self) -> int:
        """Return how many threads the workers have, of which there is one at least."""
        if not (threads := self._client.nthreads()):
            try:
                self._client.wait_for_workers(1, timeout=_WORKERS_SECONDS)
            except TimeoutError as error:
                address = self._client.scheduler.address
                where = f"scheduler {address} has had no workers for {_WORKERS_SECONDS} s"
                remedy = f"start some with `dask worker {address}`; finished cases are kept"
                raise CosimError(f"{where}; {remedy}") from error
            threads = self._client.nthreads()
        return sum(threads.values())

    def _check_workers(self) -> None:
        """Compare what the workers have with what is here: whichever joins later is asked with its cases."""
        self._threads()
        there = self._client.run(_versions, self._plugins, self._packages, on_error="return")
        faults = [
            fault for worker, found in there.items() for fault in _faults(worker, found, self._versions)
        ]
        if faults:
            raise ConfigError(faults)

    def _submit(self, case: Case) -> None:
        """Send a case; what several have in common is sent once."""
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
                self._recordings[id(case.recording)] = (case.recording, self._send(case.recording))
            recording = self._recordings[id(case.recording)][1]
        bare = _moved(case, names_in(own_folder(), names), None)  # where its modules will be
        values = Surroundings.of(case).values
        carried = (values, self._modules[names], files)
        task = _Task(bare, *carried, self._sandboxed, self._versions, self._plugins, self._packages)
        needed = {file: self._contents[file] for file in files.values()}
        key = f"{case.id}-{uuid.uuid4().hex}"
        future = self._client.submit(_run_there, task, recording, needed, self._run_cases, key=key)
        self._running[future] = case

    def _send(self, content: Any) -> "Future":
        """Send what workers pass on to each other; as a task, so that it outlives a worker that has it."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # it is large
            return self._client.submit(_itself, content, key=f"ddpc-cosim-{uuid.uuid4().hex}")

    def _finish(self, case: Case, future: "Future") -> None:
        """Write what is known of a case that is over."""
        from distributed import KilledWorker

        error = future.exception()
        if error is None:
            self._accept(case, future.result())
        elif isinstance(error, KilledWorker):
            died, last = error.allowed_failures + 1, error.last_worker.address
            self._give_up(case, f"{died} dask workers died while they ran it, the last of them {last}")
        elif isinstance(error, CosimError):
            raise error
        else:
            raise CosimError(f"{case.name}: on a dask worker: {type(error).__name__}: {error}") from error

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
    found = {"Python": ".".join(platform.python_version_tuple()[:2])}
    for name in packages:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "missing"
    metrics = tuple(("metrics", name) for name in plugin_names("metrics"))
    found["names of metrics"] = ", ".join(name for _, name in metrics) or "none"
    return found | {f"{kind} {name}": origin(kind, name) for kind, name in (*plugins, *metrics)}


def _faults(worker: str, there: Any, here: Mapping[str, str]) -> list[str]:
    """Return in words what a worker has otherwise."""
    if isinstance(there, OSError):  # it has gone meanwhile
        return []
    if not isinstance(there, dict):
        return [f"worker {worker}: ddpc-cosim cannot be asked for its version there: {there}"]
    return [
        f"worker {worker}: {name}: {found} there, {expected} here; install the same there"
        for name, expected in here.items()
        if (found := there.get(name, "missing")) != expected
    ]


def _itself(content: Any) -> Any:
    return content


def _run_there(
    task: _Task, recording: Recording | None, contents: Mapping[str, bytes], run_cases: RunCases
) -> dict[str, bytes]:
    """Run a case, on a dask worker, in a process of its own; return its files by name."""
    from distributed import get_worker

    worker = get_worker()
    if faults := _faults(worker.address, _versions(task.plugins, task.packages), task.versions):
        raise ConfigError(faults)
    try:
        with demanded(task.sandboxed):
            places = {path: _placed(path, contents[content], content) for path, content in task.files.items()}
        with ScratchFolder() as scratch:
            modules = _modules(task.modules) if task.modules else scratch
            around = Surroundings(str(modules), task.values, (*map(Path, places.values()), modules))
            case = _moved(task.case, places, recording)
            threads = worker.state.nthreads
            for _ in run_cases([case], scratch, threads, sandboxed=task.sandboxed, surroundings=around):
                pass
            return _files(scratch / case.id, places)
    except (CosimError, OSError) as error:
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


def _files(folder: Path, places: Mapping[str, str]) -> dict[str, bytes]:
    """Return the files of a case with the paths that they have where its study is."""
    files = {path.name: path.read_bytes() for path in folder.iterdir()}
    run = read_sealed(folder / RUN_FILE)
    text = json.dumps(run)
    for path, place in places.items():
        text = text.replace(json.dumps(place)[1:-1], json.dumps(path)[1:-1])
    return files | {RUN_FILE: sealed_json(json.loads(text))}
