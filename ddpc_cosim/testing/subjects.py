"""What ``ddpc-cosim check`` checks: a plant or a controller by its name, or an FMU.

Every check runs in a worker process, so that a subject that crashes or hangs fails one check and no more.
"""

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Protocol, Self

from ddpc_cosim.controller import Controller
from ddpc_cosim.errors import ConfigError, CosimWarning, PluginError
from ddpc_cosim.files.texts import DeepTablesError, toml_tables
from ddpc_cosim.loop.safe_calls import CallsInTime
from ddpc_cosim.plant import Plant
from ddpc_cosim.plugins import load_plugin, load_target, plugin_names
from ddpc_cosim.processes.fork_server import ExitStatus
from ddpc_cosim.processes.sandbox import Sandbox, demanded
from ddpc_cosim.processes.scratch import ScratchFolder
from ddpc_cosim.processes.worker import LostWorkerError, UnexpectedError, Worker, serve_calls
from ddpc_cosim.testing.check_results import CheckResult, CheckStatus, run_check
from ddpc_cosim.testing.controllers import CONTROLLER_CHECKS, ControllerUnderTest
from ddpc_cosim.testing.plants import PLANT_CHECKS, PlantUnderTest
from fmu_plants.spelling import did_you_mean

_PRELOAD = (__name__,)
_OPENS = "can be opened"


class Subject(Protocol):
    """What can be checked."""

    def check_names(self) -> Iterable[str]:
        """Return the names of its checks."""

    def check(self, name: str, sampling_time: float) -> None:
        """Run one check, at a step size in s."""


@dataclass(frozen=True, slots=True)
class FMUSubject:
    """An FMU as a plant: its path."""

    path: str

    def check_names(self) -> Iterable[str]:
        """Return the names of its checks."""
        return PLANT_CHECKS

    def check(self, name: str, sampling_time: float) -> None:
        """Run one check, at a step size in s."""
        from ddpc_cosim.fmu.plant import FMUPlant

        if name == _OPENS:
            with FMUPlant(self.path) as plant:
                plant.plan(sampling_time, sampling_time)
                plant.reset()
            return
        PLANT_CHECKS[name](PlantUnderTest(lambda: FMUPlant(self.path), sampling_time))


@dataclass(frozen=True, slots=True)
class PlantSubject:
    """A plant in Python: its name, or ``module:Class``."""

    plugin: str

    def check_names(self) -> Iterable[str]:
        """Return the names of its checks."""
        return PLANT_CHECKS

    def check(self, name: str, sampling_time: float) -> None:
        """Run one check, at a step size in s."""
        make_plant: Callable[[], Plant] = load_plugin("plants", self.plugin)
        PLANT_CHECKS[name](PlantUnderTest(make_plant, sampling_time))


@dataclass(frozen=True, slots=True)
class ControllerSubject:
    """A controller: its name or ``module:Class``, and its settings as a study file writes them."""

    plugin: str
    settings: dict[str, Any] = field(default_factory=dict)

    def check_names(self) -> Iterable[str]:
        """Return the names of its checks."""
        return CONTROLLER_CHECKS

    def check(self, name: str, sampling_time: float) -> None:
        """Run one check, at a step size in s."""
        CONTROLLER_CHECKS[name](ControllerUnderTest(self.make, sampling_time))

    def make(self) -> Controller:
        """Return a new controller."""
        from ddpc_cosim.study.controller_plugins import make_controller

        return make_controller(self.plugin, self.settings)


def find_subject(name: str, settings: Sequence[str], timeout: float) -> Subject:
    """Return what a command line names, with its settings, each of them a line of TOML.

    A controller is made once, for which it has ``timeout`` [s].

    Raises
    ------
    ConfigError
        There is no such thing, it cannot be made, or a setting is not TOML.
    """
    if name.lower().endswith(".fmu"):
        if not Path(name).is_file():
            raise ConfigError(f"{name}: no such file")
        return FMUSubject(name)
    if name.lower().endswith(".ssp"):
        raise ConfigError(f"{name}: is a system of several FMUs: check each of them; inspect shows the whole")
    if not _is_controller(name):
        return _plant(name)
    subject = ControllerSubject(name, _parse(settings))
    try:
        load_plugin("controllers", name)  # here: not every module can be imported in another thread
        with CallsInTime(timeout) as in_time:
            in_time(subject.make)
    except TimeoutError:
        late = f"{name}: timed out: no return within {timeout:g} s in constructor"
        raise ConfigError(f"{late}; raise --timeout if it needs longer") from None
    except PluginError as error:
        raise ConfigError(str(error)) from error
    except ConfigError as error:
        hint = "give what it needs with --setting 'NAME = VALUE'"
        raise ConfigError([f"{name}: {fault}; {hint}" for fault in error.faults]) from error
    return subject


def _is_controller(name: str) -> bool:
    if ":" in name:
        try:
            target = load_target(name, "plant or controller")
        except PluginError as error:
            raise ConfigError(str(error)) from error
        return isinstance(target, type) and issubclass(target, Controller)
    controllers, plants = plugin_names("controllers"), plugin_names("plants")
    if name not in controllers and name not in plants:
        hint = did_you_mean(name, [*controllers, *plants])
        raise ConfigError(f'no plant or controller "{name}"; {hint}; or give the path of an FMU')
    return name in controllers


def _plant(name: str) -> Subject:
    from ddpc_cosim.study.file_format.sections import PlantSection
    from ddpc_cosim.study.plants import PlantSpec

    plant = PlantSpec.of(PlantSection(name=name), Path()).built()
    return FMUSubject(plant.fmu) if plant.fmu else PlantSubject(name)


def _parse(settings: Sequence[str]) -> dict[str, Any]:
    try:
        return toml_tables("\n".join(settings))
    except DeepTablesError as error:
        raise ConfigError(f"--setting: {error}") from error
    except (ValueError, RecursionError) as error:  # too long numbers and too deep nesting are not TOML errors
        raise ConfigError(f"--setting: not TOML: {error}; write text in quotes: 'name = \"text\"'") from error


def run_checks(
    subject: Subject,
    sampling_time: float,
    timeout: float,
    prepare: Callable[[str], None],
    begin: Callable[[str], None],
    *,
    sandboxed: bool,
) -> list[CheckResult]:
    """Run all checks of a subject, each in a worker; an FMU that cannot be opened fails once.

    Parameters
    ----------
    subject : Subject
        What is checked.
    sampling_time, timeout : float
        Step size of the runs, and how long one check may take [s].
    prepare, begin : callable
        Are told in words what is compiled ahead, and of each check its name.
    sandboxed : bool
        Whether the checks run in a sandbox.
    """
    read: tuple[Path, ...] = ()
    if isinstance(subject, FMUSubject):
        from ddpc_cosim.fmu.library import compile_ahead

        with demanded(sandboxed):  # part of no check's time
            read = Path(subject.path), *compile_ahead(Path(subject.path), prepare)
    with ScratchFolder() as folder, _CheckWorker(folder, read if sandboxed else None) as worker:
        if isinstance(subject, FMUSubject):
            opened = worker.check(subject, _OPENS, sampling_time, timeout)
            if opened.status is not CheckStatus.PASSED:
                return [opened]
        results = []
        for name in subject.check_names():
            begin(name)
            results.append(worker.check(subject, name, sampling_time, timeout))
    return results


def natural_step(subject: Subject) -> float:
    """Return the step size that an FMU suggests; 0.1 s where nothing does."""
    if not isinstance(subject, FMUSubject):
        return 0.1
    from ddpc_cosim.inspection import inspect_fmu

    declared = inspect_fmu(subject.path).declared
    experiment = declared.default_experiment
    fixed = next((interface.fixed_step for interface in declared.interfaces.values()), None)
    return fixed or experiment.step_size or (experiment.stop_time or 50.0) / 500


class _CheckWorker:
    """A worker that runs checks, and another one after a check that it has not survived.

    Parameters
    ----------
    folder : Path
        Where temporary files go.
    read : tuple of Path or None
        What it may read in a sandbox; None: it runs in none.
    """

    def __init__(self, folder: Path, read: tuple[Path, ...] | None) -> None:
        self._folder, self._sandbox = folder, None if read is None else Sandbox((folder,), read)
        self._worker: Worker | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def check(self, subject: Subject, name: str, sampling_time: float, timeout: float) -> CheckResult:
        """Run one check."""
        if self._worker is None:
            self._worker = Worker(serve_calls, folder=self._folder, preload=_PRELOAD, sandbox=self._sandbox)
        try:
            status, reason = self._worker.call(_run, subject, name, sampling_time, seconds=timeout)
            return CheckResult(name, CheckStatus(status), reason)
        except LostWorkerError as error:
            self._end()
            reason = f"did not end within {timeout:g} s" if error.exit_status is None else f"crashed: {error}"
        except (ValueError, TypeError):
            reason = f"crashed: {self._end()}"
        except UnexpectedError as error:
            reason = f"the check cannot be run: {error}"
        return CheckResult(name, CheckStatus.FAILED, reason)

    def _end(self) -> ExitStatus:
        worker, self._worker = self._worker, None
        return worker.end() if worker is not None else ExitStatus(None)


def _run(subject: Subject, name: str, sampling_time: float) -> tuple[str, str]:
    """Run one check, in a worker, and return its status and reason."""
    warnings.simplefilter("ignore", CosimWarning)  # `inspect` shows them
    result = run_check(name, partial(subject.check, name, sampling_time))
    return result.status, result.reason
