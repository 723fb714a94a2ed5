"""Studies on a dask cluster: a scheduler and workers as processes on this machine."""

import csv
import os
import re
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path
from typing import Any

import dask
import pytest
from studies import run_file

from ddpc_cosim import ConfigError, CosimError, CosimWarning
from ddpc_cosim.cli.progress import LineProgress
from ddpc_cosim.study.case_files import read_run
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.results import StudyResults
from ddpc_cosim.study.runner import Selection, run_study
from ddpc_cosim.study.running import cluster as executor
from ddpc_cosim.tuning import Request, tune_study

pytestmark = pytest.mark.xdist_group("cluster")
WriteStudy = Callable[..., Path]

SCHEDULER = """
import asyncio, os
from distributed import Scheduler
async def serve():
    protocol = os.environ.get("PROTOCOL", "tcp")
    async with Scheduler(host="127.0.0.1", port=0, protocol=protocol, dashboard=False) as scheduler:
        print(scheduler.address, flush=True)
        await scheduler.finished()
asyncio.run(serve())
"""
WORKER = """
import asyncio, os, resource, sys
from distributed import Worker
if largest := int(os.environ.get("LARGEST_FILE", 0)):  # as if the disk were full
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, largest))
async def serve():
    async with Worker(sys.argv[1], nthreads=1, dashboard=False) as worker:
        print(worker.address, flush=True)
        await worker.finished()
asyncio.run(serve())
"""
OWN = """
import ctypes, os, signal
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from beside import GAIN
from ddpc_cosim import Controller, setting

@dataclass(kw_only=True)
class Own(Controller):
    offsets: str = setting("", doc="file of an offset", file=True)
    def start(self, loop):
        self.offset = float(Path(self.offsets).read_text())
    def step(self, sample):
        return GAIN * (sample.setpoint - sample.y) + self.offset

class Lacks(Own):
    def start(self, loop):
        import a_library_of_nowhere

class Segfaults(Own):
    def step(self, sample):
        return ctypes.string_at(0) if sample.k == 3 else super().step(sample)

class Kills(Own):
    def step(self, sample):
        if sample.k == 3:  # the dask worker, whose child is the server that forks processes for cases
            server = Path(f"/proc/{os.getppid()}/stat").read_text()
            os.kill(int(server.rpartition(")")[2].split()[1]), signal.SIGKILL)
        return super().step(sample)

class Waits(Own):
    def step(self, sample):
        if sample.k == 3:
            try:
                Path("FOLDER/was-here").mkdir()
            except FileExistsError:
                pass
            else:
                Path("FOLDER/told").write_text(f"{os.environ['WORKER_NAME']} {os.getpid()}")
                Path("FOLDER/never").read_text()
        return super().step(sample)
"""


class Cluster:
    """A scheduler and its workers, each with a cache and a working directory of its own."""

    def __init__(self, folder: Path, environment: Mapping[str, str] | None = None) -> None:
        self.folder, self._environment = folder, environment or {}
        self.processes: dict[str, subprocess.Popen[str]] = {}
        often = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}
        self.address = self._start("scheduler", SCHEDULER, often)

    def start_worker(self, name: str, environment: Mapping[str, str] | None = None) -> str:
        return self._start(name, WORKER, {"WORKER_NAME": name, **(environment or {})}, self.address)

    def _start(self, name: str, code: str, environment: Mapping[str, str], *arguments: str) -> str:
        (place := self.folder / name).mkdir()
        env = {**os.environ, "DDPC_COSIM_CACHE": str(place / "cache"), **self._environment, **environment}
        command = [sys.executable, "-P", "-c", code, *arguments]
        process = self.processes[name] = subprocess.Popen(
            command, cwd=place, env=env, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert process.stdout is not None
        return process.stdout.readline().strip()

    def stop_all(self) -> None:
        for name in reversed(self.processes.copy()):
            self.stop(name)

    def stop(self, name: str, number: int = signal.SIGTERM) -> None:
        process = self.processes.pop(name)
        process.send_signal(number)
        process.communicate(timeout=60)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    cluster = Cluster(tmp_path_factory.mktemp("cluster"))
    try:
        for name in ("one", "two"):
            cluster.start_worker(name)
        yield cluster
    finally:
        cluster.stop_all()


@pytest.fixture
def own_study(write_study: WriteStudy, tmp_path: Path) -> Callable[..., Path]:
    """Write a study with controllers of a module beside it, which reads a file and imports another."""

    def write(*controllers: str, seeds: str) -> Path:
        study = write_study(*controllers, seeds=seeds)
        classes = [name.partition(":")[2].lower() for name in controllers if ":" in name]
        settings = [f'[controllers.{name}.settings]\noffsets = "offset.txt"\n' for name in classes]
        study.write_text(study.read_text() + "".join(settings))
        (tmp_path / "own.py").write_text(OWN.replace("FOLDER", str(tmp_path)))
        (tmp_path / "beside.py").write_text("GAIN = 0.5\n")
        (tmp_path / "offset.txt").write_text("0.25")
        return study

    return write


def run(study: Path, out: str, **selection: Any) -> StudyResults:
    with (study.parent / "log").open("w") as log:
        return run_file(study, out, progress=LineProgress(log), **selection)


def read_from(pipe: Path) -> str:
    """Return what is written into a named pipe within a minute."""
    end = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    assert select.select([end], [], [], 60)[0], f"nothing has been written to {pipe.name}"
    return os.read(end, 1000).decode()


def on(cluster: Cluster) -> dict[str, str]:
    return {"executor": "dask", "scheduler": cluster.address}


def content_of(results: StudyResults) -> dict[str, Any]:
    """Return what the files of each case say, bar how long things took."""
    content = {}
    for case in results.cases:
        rows = [line.split(",") for line in (case.folder / "signals.csv").read_text().splitlines()]
        timing = rows[0].index("solve_time [s]")
        run = read_run(case.folder)
        for key in ("wall_time", "signals"):
            del run[key]
        run["metrics"] = {key: value for key, value in run["metrics"].items() if "solve_time" not in key}
        content[case.id] = [[row[:timing] + row[timing + 1 :] for row in rows], repr(run)]
    return content


def table_and_statistics(results: StudyResults) -> list[Any]:
    """Return metrics.csv and the statistics of each metric, bar how long things took."""
    header, *rows = csv.reader((results.folder / "metrics.csv").read_text().splitlines())
    kept = [number for number, name in enumerate(header) if "solve_time" not in name]
    compared = [
        results.compare(header[number], baseline="mfapc").to_csv() for number in kept if "[" in header[number]
    ]
    return [[[row[number] for number in kept] for row in (header, *rows)], compared]


def test_a_cluster_gives_what_this_machine_gives_on_any_number_of_workers(
    cluster: Cluster, own_study: Callable[..., Path], tmp_path: Path
) -> None:
    """And what crashes there costs its own case."""
    study = own_study("mfapc", "own:Own", "own:Segfaults", seeds="[0, 1]")
    there = run(study, "there", **on(cluster))
    for jobs in (1, 2, 4):
        here = run(study, f"here-{jobs}", jobs=jobs)
        assert content_of(there) == content_of(here)
        assert table_and_statistics(there) == table_and_statistics(here)
    assert [case.outcome for case in there.cases] == ["completed"] * 4 + ["crashed"] * 2
    assert "SIGSEGV" in there.cases[-1].reason
    assert [*(tmp_path / "there").iterdir()] != []
    assert not [path.name for path in (tmp_path / "there" / "cases").iterdir() if path.name.startswith(".")]


PLANT_IN_A_FILE = """
import numpy as np
from ddpc_cosim import Plant, Variable
from pole_of_a_file import POLE

class Lag(Plant):
    inputs, outputs = (Variable("u"),), (Variable("y"),)
    def reset(self, parameters=None, t0=0.0):
        self.y = np.zeros(1)
        return self.y.copy()
    def step(self, u, h):
        self.y = self.y + h * (u - POLE * self.y)
        return self.y.copy()
"""


def with_plant_in_a_file(study: Path) -> Path:
    (study.parent / "lag_of_a_file.py").write_text(PLANT_IN_A_FILE)
    (study.parent / "pole_of_a_file.py").write_text("POLE = 2.0")
    fmu = next(line for line in study.read_text().splitlines() if line.startswith("fmu = "))
    study.write_text(study.read_text().replace(fmu, 'name = "lag_of_a_file.py:Lag"'))
    return study


def test_a_plant_in_a_file_travels_with_what_it_imports(cluster: Cluster, write_study: WriteStudy) -> None:
    study = with_plant_in_a_file(write_study("mfapc"))
    there, here = run(study, "there", **on(cluster)), run(study, "here", jobs=1)
    assert [case.reason for case in there.cases if case.outcome != "completed"] == []
    assert content_of(there) == content_of(here)


def test_a_tuning_on_a_cluster_finds_what_it_finds_here(
    cluster: Cluster, own_study: Callable[..., Path], tmp_path: Path
) -> None:
    study = read_study(str(own_study("mfapc", "own:Own", seeds="[0]")))
    request = Request(trials=3, seeds=[7])
    for out, selection in (("there", Selection(**on(cluster))), ("here", Selection())):
        with (tmp_path / "log").open("w") as log:
            tune_study(study, tmp_path / out, request, selection, LineProgress(log))
    for name in ("trials.csv", "tuned.toml"):
        assert (tmp_path / "there" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()


def test_a_worker_that_is_killed_costs_no_case(
    cluster: Cluster, own_study: Callable[..., Path], tmp_path: Path
) -> None:
    cluster.start_worker("third")
    study = own_study("own:Own", "own:Waits", seeds="[0, 1, 2]")
    for name in ("told", "never"):
        os.mkfifo(tmp_path / name)
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(run, study, "out", storage="parquet", **on(cluster))
        worker, process = read_from(tmp_path / "told").split()
        case = os.pidfd_open(int(process))
        cluster.stop(worker, signal.SIGKILL)
        results = running.result(timeout=120)
    assert [case.outcome for case in results.cases] == ["completed"] * 6
    assert len([*results.folder.glob("cases/*/signals.parquet")]) == 9
    assert select.select([case], [], [], 60)[0], "the case's process has outlived its worker"
    os.close(case)


def test_a_worker_whose_disk_is_full_costs_no_case_and_is_left_out(
    cluster: Cluster, write_study: WriteStudy, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It fails its cases at once, and so would get the most of them."""
    full = cluster.start_worker("full", {"LARGEST_FILE": "70000"})
    # All workers have started what they run cases in.
    warm = run(write_study("mfapc", seeds="[0, 1, 2, 3, 4, 5]"), "warm", **on(cluster))
    assert [case.outcome for case in warm.cases] == ["completed"] * 6
    failed, tried = [], executor._Run._is_tried_again

    def counting(self: Any, case: Any, reply: Any, workers: Any) -> bool:
        failed.append(reply.worker)
        return tried(self, case, reply, workers)

    monkeypatch.setattr(executor._Run, "_is_tried_again", counting)
    study = with_plant_in_a_file(write_study("mfapc", seeds='["0:36"]', loop={"duration": 20.0}))
    message = (
        f"worker {full}: 3 cases have failed there that others have run, .*cannot be written: File too large"
    )
    try:
        with pytest.warns(CosimWarning, match=message) as caught:
            results = run(study, "out", **on(cluster))
    finally:
        cluster.stop("full")
    assert len(caught) == 1
    assert [case.outcome for case in results.cases] == ["completed"] * 36
    at_a_time = 2 * (len(cluster.processes) - 1) + 2
    assert set(failed) == {full}
    assert 3 <= len(failed) < 3 + at_a_time


def test_what_fails_on_every_machine_is_held_against_none(
    cluster: Cluster, own_study: Callable[..., Path]
) -> None:
    results = run(own_study("own:Own", "own:Lacks", seeds="[0, 1, 2, 3]"), "out", **on(cluster))
    assert [case.outcome for case in results.cases] == ["completed"] * 4 + ["controller-error"] * 4
    assert "No module named 'a_library_of_nowhere'" in results.cases[-1].reason


def test_an_fmu_that_has_gone_here_is_named(
    cluster: Cluster, write_study: WriteStudy, tmp_path: Path
) -> None:
    resolved = read_study(str(write_study("mfapc")))
    (fmu,) = tmp_path.glob("*.fmu")
    fmu.unlink()
    with (tmp_path / "log").open("w") as log, pytest.raises(CosimError, match=rf"{fmu.name}: no such file"):
        run_study(resolved, tmp_path / "out", Selection(**on(cluster)), LineProgress(log))


def test_an_fmu_that_has_gone_from_the_caches_of_the_workers_is_placed_there_again(
    cluster: Cluster, write_study: WriteStudy
) -> None:
    study = write_study("mfapc")
    run(study, "out", **on(cluster))
    placed = [*cluster.folder.glob("*/cache/cluster/**/*.fmu")]
    assert placed
    for path in placed:
        path.unlink()
    results = run(study, "out", fresh=True, **on(cluster))
    assert [case.outcome for case in results.cases] == ["completed"]


def test_a_worker_that_joins_late_with_another_numpy_is_left_out(
    cluster: Cluster, own_study: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    leave_out = executor._Run._leave_out

    def leave_out_and_go_on(self: Any, worker: str, faults: list[str]) -> None:
        leave_out(self, worker, faults)
        (tmp_path / "never").write_text("now")  # the case that waited goes on

    monkeypatch.setattr(executor._Run, "_leave_out", leave_out_and_go_on)
    monkeypatch.setattr(executor, "_LOOK_SECONDS", 0.2)
    info = tmp_path / "installed" / "numpy-9.9.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: numpy\nVersion: 9.9\n")
    study = own_study("own:Own", "own:Waits", seeds="[0, 1, 2]")
    for name in ("told", "never"):
        os.mkfifo(tmp_path / name)

    def run_while_one_joins() -> tuple[StudyResults, str]:
        with ThreadPoolExecutor(1) as pool:
            running = pool.submit(run, study, "out", **on(cluster))
            read_from(tmp_path / "told")
            late = cluster.start_worker("late", {"PYTHONPATH": str(tmp_path / "installed")})
            try:
                return running.result(timeout=120), late
            finally:
                cluster.stop("late")

    with pytest.warns(CosimWarning) as caught:
        results, late = run_while_one_joins()
    message = (
        f"worker {late}: numpy: 9.9 there, {metadata.version('numpy')} here; install the same there; its "
    )
    assert [str(warning.message).startswith(message) for warning in caught] == [True]
    assert [case.outcome for case in results.cases] == ["completed"] * 6


def test_a_case_that_kills_one_worker_after_the_other_has_failed_and_the_others_complete(
    cluster: Cluster, own_study: Callable[..., Path]
) -> None:
    """The scheduler here gives up on it with the second one."""
    for name in ("fourth", "fifth"):
        cluster.start_worker(name)
    results = run(own_study("own:Own", "own:Kills", seeds="[0]"), "out", **on(cluster))
    assert [case.outcome for case in results.cases] == ["completed", "crashed"]
    assert re.search("first sample: 2 dask workers died while they ran it", results.cases[1].reason)
    dead = [name for name, process in cluster.processes.items() if process.poll() is not None]
    assert len(dead) == 2
    for name in dead:
        cluster.stop(name)


def test_a_scheduler_that_gets_no_workers_or_goes_is_an_error(
    own_study: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(executor, "_WORKERS_SECONDS", 0.1)
    (tmp_path / "another").mkdir()
    another = Cluster(tmp_path / "another")
    study = own_study("own:Own", "own:Waits", seeds="[0]")
    for name in ("told", "never"):
        os.mkfifo(tmp_path / name)
    try:
        with pytest.raises(
            CosimError, match=r"has had no workers for 0\.1 s; start some with `dask worker tcp:"
        ):
            run(study, "out", **on(another))
        another.start_worker("only")
        with ThreadPoolExecutor(1) as pool:
            running = pool.submit(run, study, "out", **on(another))
            read_from(tmp_path / "told")
            another.stop("scheduler", signal.SIGKILL)
            with pytest.raises(
                CosimError, match="the dask scheduler has gone; finished cases are kept; start"
            ):
                running.result(timeout=60)
    finally:
        for name in list(another.processes):
            another.stop(name, signal.SIGKILL)


def test_without_the_extra_the_remedy_is_told(
    write_study: WriteStudy, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r'needs dask\.distributed: `pip install "\.\[cluster\]"`'):
        run(write_study("mfapc"), "out", executor="dask", scheduler="tcp://127.0.0.1:1")


def write_plug_in(folder: Path, *versions: str) -> None:
    """Write versions of an installed package with a controller."""
    for version in versions:
        info = folder / version / "demo_control.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: demo-control\nVersion: {version}\n")
        (info / "entry_points.txt").write_text("[ddpc_cosim.controllers]\ndemo = demo_control:Demo\n")
        (folder / version / "demo_control.py").write_text(
            "from ddpc_cosim import Controller\n"
            "class Demo(Controller):\n"
            "    def start(self, loop): pass\n"
            "    def step(self, sample): return sample.setpoint\n"
        )


def test_a_worker_without_the_plug_in_or_with_another_version_is_named(
    cluster: Cluster, write_study: WriteStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_plug_in(tmp_path, "1.0", "2.0")
    monkeypatch.syspath_prepend(str(tmp_path / "1.0"))
    other = cluster.start_worker("other", {"PYTHONPATH": str(tmp_path / "2.0")})
    try:
        with pytest.raises(ConfigError) as caught:
            run(write_study("demo"), "out", **on(cluster))
    finally:
        cluster.stop("other")
    (versions,) = [fault for fault in caught.value.faults if other in fault]
    assert "controllers demo: demo-control 2.0, code " in versions
    assert "there, demo-control 1.0, code " in versions
    without = [fault for fault in caught.value.faults if 'missing (no controller "demo"' in fault]
    assert len(without) == len(caught.value.faults) - 1 >= 1


def test_workers_without_a_plug_in_are_left_out_where_others_have_it(
    cluster: Cluster, write_study: WriteStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_plug_in(tmp_path, "1.0")
    monkeypatch.syspath_prepend(str(tmp_path / "1.0"))
    has_it = cluster.start_worker("has-it", {"PYTHONPATH": str(tmp_path / "1.0")})
    try:
        with pytest.warns(CosimWarning, match='missing .no controller "demo"') as caught:
            results = run(write_study("demo", seeds="[0, 1]"), "out", **on(cluster))
    finally:
        cluster.stop("has-it")
    assert len(caught) == len(cluster.processes) - 1  # the scheduler
    assert not [warning for warning in caught if has_it in str(warning.message)]
    assert [case.outcome for case in results.cases] == ["completed"] * 2


def test_over_tls(write_study: WriteStudy, tmp_path: Path) -> None:
    """The certificates are those of dask's configuration, and who has none is told so."""
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    make = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=cluster"]
    files = ["-keyout", str(key), "-out", str(certificate)]
    subprocess.run([*make, *files], check=True, capture_output=True)
    settings = {"require-encryption": "True", "tls.ca-file": str(certificate)}
    for role in ("scheduler", "worker", "client"):
        settings |= {f"tls.{role}.cert": str(certificate), f"tls.{role}.key": str(key)}
    environment = {
        "DASK_DISTRIBUTED__COMM__" + name.replace("-", "_").replace(".", "__").upper(): value
        for name, value in settings.items()
    }
    (tmp_path / "cluster").mkdir()
    cluster = Cluster(tmp_path / "cluster", {"PROTOCOL": "tls", **environment})
    study = write_study("mfapc")
    try:
        assert cluster.address.startswith("tls://127.0.0.1:")
        assert cluster.start_worker("one").startswith("tls://")
        with dask.config.set({f"distributed.comm.{name}": value for name, value in settings.items()}):
            there = run(study, "there", **on(cluster))
        assert content_of(there) == content_of(run(study, "here"))
        with pytest.raises(ConfigError, match=f"--scheduler {cluster.address}: there are no certificates"):
            run(study, "without", **on(cluster))
    finally:
        cluster.stop_all()


def test_a_scheduler_that_does_not_answer_is_an_error(
    write_study: WriteStudy, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(executor, "_CONNECT_SECONDS", 0.3)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        with pytest.raises(ConfigError, match=f"--scheduler {address}: no dask scheduler answers"):
            run(write_study("mfapc"), "out", executor="dask", scheduler=address)
