"""Studies in Python: problems and controllers as objects, of which a study file is the written form."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any, Self

from ddpc_cosim.codec import read, write, write_in_short
from ddpc_cosim.conditions import Conditions
from ddpc_cosim.controller import Controller, Recording
from ddpc_cosim.coupling.wiring import Connection
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.excitations import Excitation, sampling_faults
from ddpc_cosim.plant import FMIType, ParameterValue
from ddpc_cosim.plugins import name_in_file, name_of
from ddpc_cosim.signals import Drift, GaussianNoise, ParameterChange, Reference
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.cases import Case
from ddpc_cosim.study.file_format.replacing import CONTROLLERS, PROBLEMS
from ddpc_cosim.study.file_format.sections import expand_seeds, not_reserved
from ddpc_cosim.study.file_format.study_files import StudyFile, absolute_paths
from ddpc_cosim.study.file_format.written import Table, controller_table, experiment_table, signal_table
from ddpc_cosim.study.reading import read_file, resolve_file
from ddpc_cosim.study.results import StudyResults
from ddpc_cosim.study.runner import Progress, Selection, Update, run_study
from ddpc_cosim.tables import plain_table
from ddpc_cosim.texts import printable
from fmu_plants.files import write_atomically
from fmu_plants.spelling import did_you_mean

Controllers = Mapping[str, Controller | str | Mapping[str, Controller | str]]
"""By label: a controller, the name of one with its defaults, or one for each problem."""


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """What every controller of a problem is run under.

    Parameters
    ----------
    label : str
        Its name for people; empty: that in the problem.
    parameters : mapping of str to float, int, bool or str
        Plant parameters in this scenario.
    noise : GaussianNoise or mapping of str to float
        Standard deviation of the noise of each measurement, in its unit.
    conditions : Conditions
        Disturbances, signals of inputs that the controller does not drive, what actuators and sensors do.
    events : sequence of ParameterChange
        Tunable parameters that change during the run.
    drifts : sequence of Drift
        Tunable parameters that move linearly.
    bounds : mapping of str to (float, float)
        Limits in place of the problem's; infinite: none.
    preview : int, optional
        How many future references a controller may see; default: the problem's.
    """

    label: str = ""
    parameters: Mapping[str, ParameterValue] = field(default_factory=dict)
    noise: GaussianNoise | Mapping[str, float] = field(default_factory=dict)
    conditions: Conditions = field(default_factory=Conditions)
    events: Sequence[ParameterChange] = ()
    drifts: Sequence[Drift] = ()
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    preview: int | None = None

    def table(self) -> Table:
        """Return the scenario as a study file says it.

        Raises
        ------
        ConfigError
            A signal that no study file can say.
        """
        noise = self.noise.standard_deviation if isinstance(self.noise, GaussianNoise) else self.noise
        conditions, disturbances = self.conditions, Table()
        for name, signals in conditions.disturbances.items():
            several = [signals] if isinstance(signals, Reference) else list(signals)
            disturbances[name] = [signal_table(f"disturbance of {name}", one) for one in several]
        recorded = {
            name: signal_table(f"recorded input {name}", one)
            for name, one in conditions.recorded_inputs.items()
        }
        plain = {
            "label": self.label,
            "parameters": dict(self.parameters),
            "noise": dict(noise),
            "events": [write(event) for event in self.events],
            "drifts": [write(drift) for drift in self.drifts],
            "bounds": {name: _limits(limits) for name, limits in self.bounds.items()},
            "disturbances": disturbances,
            "inputs": {name: signal_table(f"input {name}", one) for name, one in conditions.inputs.items()},
            "preview": self.preview,
            "recording": _given({"inputs": recorded}),
        }
        return _given(plain | {key: dict(values) for key, values in conditions.effects.items()})


@dataclass(frozen=True, kw_only=True)
class Problem:
    """What controllers are asked to do: a plant, the loop, references, limits, data, and scenarios.

    The keywords of :func:`ddpc_cosim.cosimulate` mean the same here.

    Parameters
    ----------
    plant : str, path, PlantModel or class, or mapping of str to these
        A plant of ``ddpc-cosim list plants``, an FMU or SSP file, equations, or a class derived from
        ``Plant``; of a coupled plant its parts by name.
    sampling_time, duration : float
        Time between samples and simulated time [s].
    reference : Reference or mapping of str to Reference
        Of the controlled output, or of each by name, in their units.
    inputs, outputs, measurements : sequence of str, optional
        What is driven, controlled and measured; default: all, and the controlled outputs.
    bounds : mapping of str to (float, float)
        Limits of inputs and controlled outputs in place of the plant's; infinite: none.
    excitation : Excitation, optional
        The experiment that data-driven controllers learn from, sampled as the loop; each case draws it with
        its own seed.
    stabiliser : Controller, optional
        Keeps the plant during the experiment.
    recording : Recording, optional
        Logged data, in place of an experiment.
    parameters : mapping of str to float, int, bool or str
        Plant parameters.
    noise, conditions, events
        Of the scenario ``nominal``, where ``scenarios`` has none: see :class:`Scenario`.
    scenarios : mapping of str to Scenario
        By name; empty: one, ``nominal``.
    preview : int, optional
        How many future references a controller may see; default: as many as it asks for.
    start_time : float
        Time of the first sample [s].
    continue_recording : bool
        Start where the experiment ended instead of from rest.
    cost : mapping of str to mapping of str to float
        Weights of the quadratic cost that controllers are ranked by: ``outputs``, ``inputs``, ``changes``.
    relevant : mapping of str to float, or to mapping of str to float
        The smallest difference of what is ranked by that matters: ``absolute``, of several outputs one for
        each, and ``percent`` of the best figure or of the task. Default: 1 %.
    start, nominal, display_units : mapping of str to float, float, str
        Start values of inputs, sizes that controllers scale by, and units to show, in place of the plant's.
    fmi_type : str
        How an FMU is run.
    step_timeout, case_timeout : float, optional
        Longest time for any call of the plant or of a controller, and for a whole case [s].
    memory_limit : float, optional
        Memory that a case may have [GB].
    connections : sequence of Connection
        What the parts of a coupled plant exchange.
    coupling : mapping of str to float or str
        How they do: ``algorithm``, ``communication_step``, ``steps`` (of parts, by name) and further
        arguments of :class:`ddpc_cosim.CoupledPlant`.

    Raises
    ------
    ConfigError
        Scenarios besides noise, conditions or events, both an excitation and a recording, or an excitation
        with another sampling time than the loop's.
    """

    plant: Any
    sampling_time: float
    duration: float
    reference: Reference | Mapping[str, Reference]
    inputs: Sequence[str] = ()
    outputs: Sequence[str] = ()
    measurements: Sequence[str] = ()
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    excitation: Excitation | None = None
    stabiliser: Controller | None = None
    recording: Recording | None = None
    parameters: Mapping[str, ParameterValue] = field(default_factory=dict)
    noise: GaussianNoise | Mapping[str, float] = field(default_factory=dict)
    conditions: Conditions = field(default_factory=Conditions)
    events: Sequence[ParameterChange] = ()
    scenarios: Mapping[str, Scenario] = field(default_factory=dict)
    preview: int | None = None
    start_time: float = 0.0
    continue_recording: bool = False
    cost: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    relevant: Mapping[str, float | Mapping[str, float]] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    nominal: Mapping[str, float] = field(default_factory=dict)
    display_units: Mapping[str, str] = field(default_factory=dict)
    fmi_type: FMIType = "auto"
    step_timeout: float | None = None
    case_timeout: float | None = None
    memory_limit: float | None = None
    connections: Sequence[Connection] = ()
    coupling: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        faults = []
        given = [key for key in ("noise", "conditions", "events") if getattr(self, key) not in _NOTHING]
        if self.scenarios and given:
            faults.append(f"problem: {', '.join(given)} belong to a scenario; needed: in one of scenarios")
        if self.excitation is not None and self.recording is not None:
            faults.append("problem: give an excitation or a recording, not both")
        if self.excitation is not None:
            faults += [f"problem: {one}" for one in sampling_faults(self.excitation, self.sampling_time)]
        elif self.stabiliser is not None:
            faults.append("problem: stabiliser needs an excitation, which is added to its inputs")
        if faults:
            raise ConfigError(faults)

    def tables(self, recording: str = "recording.csv") -> Table:
        """Return the problem as a study file says it.

        Parameters
        ----------
        recording : str
            Path of the file that logged data are in: :meth:`write_recording` writes it.

        Raises
        ------
        ConfigError
            A signal or an object that no study file can say.
        """
        loop = {
            "sampling_time": float(self.sampling_time),
            "duration": float(self.duration),
            "start_time": float(self.start_time) or None,
            "start": "recording-end" if self.continue_recording else None,
            "preview": self.preview,
            "step_timeout": self.step_timeout,
            "case_timeout": self.case_timeout,
            "memory_limit": self.memory_limit,
        }
        nominal = Scenario(noise=self.noise, conditions=self.conditions, events=self.events)
        scenarios = self.scenarios or {"nominal": nominal}
        references = self.reference
        if isinstance(references, Reference):
            references = {self._names("outputs")[0]: references}
        tables = {
            "plant": self._plant_table(),
            "loop": {key: value for key, value in loop.items() if value is not None},
            "reference": {
                name: signal_table(f"reference of {name}", one) for name, one in references.items()
            },
            "bounds": {name: _limits(limits) for name, limits in self.bounds.items()},
            "recording": self._recording_table(recording),
            "scenarios": {name: scenario.table() for name, scenario in scenarios.items()},
            "metrics": _given(
                {
                    key: {one: dict(v) if isinstance(v, Mapping) else v for one, v in given.items()}
                    for key, given in (("cost", self.cost), ("relevant", self.relevant))
                }
            ),
        }
        return {key: table for key, table in tables.items() if table}

    def write_recording(self, path: Path) -> None:
        """Write the logged data, if there are any, as the CSV file that :meth:`tables` names."""
        if self.recording is not None:
            outputs = self._names("outputs")
            measured = list(self.measurements) or outputs
            self.recording.write_csv(path, self._names("inputs"), outputs, measured)

    def _plant_table(self) -> Table:
        given = {
            "inputs": list(self.inputs),
            "outputs": list(self.outputs),
            "measurements": list(self.measurements),
            "parameters": dict(self.parameters),
            "start": dict(self.start),
            "nominal": dict(self.nominal),
            "display_units": dict(self.display_units),
        }
        how = {} if self.fmi_type == "auto" else {"fmi_type": self.fmi_type}
        return {**self._plant_name(), **_given(given), **how}

    def _plant_name(self) -> Table:
        coupling = dict(self.coupling)
        if not isinstance(self.plant, Mapping):
            return _plant(self.plant, "name") | ({"coupling": coupling} if coupling else {})
        steps = coupling.pop("steps", {})
        parts = [
            {"name": name, **_plant(part, "plant"), **({"step": steps[name]} if name in steps else {})}
            for name, part in self.plant.items()
        ]
        connections = [write_in_short(one) for one in self.connections]
        return {"parts": parts, "connections": connections, **({"coupling": coupling} if coupling else {})}

    def _recording_table(self, path: str) -> Table:
        if self.recording is not None:
            return {"file": path}
        if self.excitation is None:
            return {}
        table = experiment_table(self.excitation, self._names("inputs"))
        if self.stabiliser is not None:
            table["controller"] = controller_table(self.stabiliser)
        return table

    def _names(self, which: str) -> list[str]:
        """Return the inputs or outputs that take part, where none are named those of the plant."""
        if given := list(getattr(self, which)):
            return given
        from ddpc_cosim.study.file_format.sections import PlantSection
        from ddpc_cosim.study.plants import PlantSpec

        variables = PlantSpec.of(read(PlantSection, self._plant_name()), Path()).variables()
        return list(getattr(variables, f"default_{which}") or getattr(variables, which))


def _plant(plant: Any, key: str) -> Table:
    """Return a plant as a study file says it; ``key`` is that of plug-ins."""
    path = plant if isinstance(plant, PathLike) else Path(plant) if isinstance(plant, str) else None
    suffix = "" if path is None else Path(path).suffix.lower()
    if path is not None and (suffix in (".fmu", ".ssp") or isinstance(plant, PathLike)):
        return {"ssp" if suffix == ".ssp" else "fmu": str(Path(path).resolve())}
    if isinstance(plant, str):
        return {key: name_in_file(plant, lambda file: Path(file).resolve())}
    return {key: name_of("plants", plant, getattr(plant, "name", type(plant).__name__))}


_NOTHING: tuple[Any, ...] = ({}, (), [], Conditions(), GaussianNoise({}))


def _given(table: Table) -> Table:
    """Return a table without what is empty."""
    return {key: value for key, value in table.items() if value not in (None, "", {}, [])}


def _limits(limits: tuple[float, float]) -> Table:
    low, high = limits
    return {"min": float(low), "max": float(high)}


class Study:
    """Controllers on one or several problems, over scenarios and seeds.

    Parameters
    ----------
    problems : Problem or mapping of str to Problem
        What is asked of the controllers.
    controllers : mapping of str to Controller, str, or mapping of str to these
        By label; the name of a controller stands for its defaults. A mapping has one for each problem, and
        none for those that it leaves out.
    seeds : sequence of int
        Each case is run with each of them.
    name, title, summary, source : str
        As in a study file; the folder of results is called after the name.
    reference_points : (str, str), optional
        Labels of two controllers that do not compete: those at 0 % and at 100 % of the scale on which
        :meth:`StudyResults.shares` places all others.

    Raises
    ------
    ConfigError
        What no study file can say; all faults at once.

    Examples
    --------
    >>> from ddpc_controllers import MFAPC, PID
    >>> problem = Problem(
    ...     plant="pendulum",
    ...     inputs=["torque"],
    ...     outputs=["angle"],
    ...     sampling_time=0.1,
    ...     duration=2.0,
    ...     reference=Steps([0], [0.2]),
    ... )
    >>> Study(problem, {"MFAPC": MFAPC(), "PID": PID(proportional=10.0)}, seeds=range(3))
    Study(study: 1 problem, 2 controllers, 3 seeds)
    """

    def __init__(
        self,
        problems: Problem | Mapping[str, Problem],
        controllers: Controllers,
        *,
        seeds: Sequence[int] = (0,),
        name: str = "study",
        title: str = "",
        summary: str = "",
        source: str = "",
        reference_points: tuple[str, str] | None = None,
    ) -> None:
        faults = list[str]()
        told = {"title": title, "summary": summary, "source": source}
        if not isinstance(seeds, Iterable):
            faults.append(f"seeds = {seeds!r}: needed: a sequence, e.g. [{seeds!r}] or range({seeds!r})")
            seeds = ()
        tables: Table = {"name": name, **_given(told), "seeds": [int(seed) for seed in seeds]}
        self._recordings: dict[str, Problem] = {}
        if isinstance(problems, Problem):
            tables |= self._problem_tables("recording.csv", problems, faults)
        else:
            tables[PROBLEMS] = {
                key: self._problem_tables(f"recording-{key}.csv", one, faults)
                for key, one in problems.items()
            }
        tables["controllers"] = _controllers(controllers, list(tables.get(PROBLEMS, ())), faults)
        if reference_points:
            faults += [
                f'reference_points: no controller "{label}"; {did_you_mean(label, controllers)}'
                for label in reference_points
                if label not in controllers
            ]
            ends = dict(zip(("zero", "full"), map(_key, reference_points), strict=True))
            tables["report"] = {"reference_points": ends}
        if faults:
            raise ConfigError(faults)
        self._file = StudyFile(name, Path.cwd(), tables)

    def _problem_tables(self, recording: str, problem: Problem, faults: list[str]) -> Table:
        if problem.recording is not None:
            self._recordings[recording] = problem
        try:
            return problem.tables(recording)
        except ConfigError as error:
            faults += error.faults
            return {}

    @classmethod
    def read(cls, study: str | Path) -> Self:
        """Read a study file, or a built-in study by its name.

        Raises
        ------
        ConfigError
            There is none, it is not TOML, or does not fit what it takes from others; what else is in it is
            checked when it is run.
        """
        made = cls.__new__(cls)
        made._recordings, made._file = {}, read_file(str(study))
        if faults := made._file.told_faults():
            raise ConfigError(faults)
        return made

    @property
    def name(self) -> str:
        """Its name."""
        return str(self._file.tables["name"])

    @property
    def problems(self) -> tuple[str, ...]:
        """Names of its problems; that of the study where it has one, which has none."""
        tables = self._file.tables
        return tuple(_table(tables, PROBLEMS)) if PROBLEMS in tables else (self.name,)

    @property
    def controllers(self) -> tuple[str, ...]:
        """Names of its controllers."""
        return tuple(_table(self._file.tables, CONTROLLERS))

    def write(self, path: str | Path) -> Path:
        """Write the study as a file, logged data as CSV files beside it, and return its path.

        Raises
        ------
        ConfigError
            It cannot be written.
        """
        import tomli_w

        path = Path(path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._write_recordings(path.parent)
            is_moved = bool(self._file.text) and path.parent.resolve() != self._file.folder.resolve()
            tables = self._file.tables
            content = tomli_w.dumps(absolute_paths(tables, self._file.folder) if is_moved else tables)
            write_atomically(path, content.encode())
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
        return path

    def run(
        self,
        folder: str | Path | None = None,
        *,
        jobs: int = 1,
        progress: bool | Progress = True,
        only: str | Sequence[str] = (),
        seeds: Sequence[int] = (),
        fresh: bool = False,
        sandbox: bool = False,
        executor: str = "local",
        scheduler: str = "",
        shard: str = "1/1",
        storage: str = "csv",
        keep_files: bool = False,
    ) -> StudyResults:
        """Run all cases that are not there yet, and return the results.

        Parameters
        ----------
        folder : path, optional
            Folder of results; default: ``runs/NAME``.
        jobs : int
            Number of worker processes.
        progress : bool or Progress
            Whether to show how far it is, or what follows it instead.
        only, seeds, fresh, sandbox, executor, scheduler, shard, storage, keep_files
            As the options of ``ddpc-cosim run``.

        Raises
        ------
        ConfigError
            Everything in the study that does not fit, or the folder cannot be written to.
        """
        folder = Path("runs", self.name) if folder is None else Path(folder)
        file = self._file
        if self._recordings:
            try:
                folder.mkdir(parents=True, exist_ok=True)
                self._write_recordings(folder)
            except OSError as error:
                raise ConfigError(f"{folder}: cannot be written: {error.strerror}") from error
            file = replace(file, folder=folder.resolve())
        where = (executor, scheduler, shard, storage, keep_files)
        selection = Selection(jobs, list(seeds), only, fresh, sandbox, *where)
        if progress is not True:
            return run_study(resolve_file(file), folder, selection, progress or _Silent())
        from ddpc_cosim.cli.progress import display

        with display(f"reading {self.name}") as following:
            return run_study(resolve_file(file), folder, selection, following)

    def _write_recordings(self, folder: Path) -> None:
        for name, problem in self._recordings.items():
            problem.write_recording(folder / name)

    def __repr__(self) -> str:
        try:
            seeds = expand_seeds(self._file.tables.get("seeds", [0]))
        except ValueError:  # which is told when it is run
            seeds = []
        counts = ((self.problems, "problem"), (self.controllers, "controller"), (seeds, "seed"))
        words = (f"{len(some)} {word}{'' if len(some) == 1 else 's'}" for some, word in counts)
        return printable(f"Study({self.name}: {', '.join(words)})")

    def _repr_html_(self) -> str:
        sections = _table(self._file.tables, CONTROLLERS)
        rows = [
            (name, *(_table(sections, name).get(key, "") for key in ("type", "settings")))
            for name in sections
        ]
        return plain_table(repr(self), ("controller", "type", "settings"), rows).html


def _table(tables: Table, key: str) -> Table:
    """Return a table of a file, which is not checked yet: nothing if it is something else."""
    found = tables.get(key)
    return found if isinstance(found, dict) else {}


class _Silent:
    """Shows nothing."""

    def prepare(self, what: str) -> None:
        """Take note of what is done before the cases are known."""

    def start(self, total: int, kept: int) -> None:
        """Take note of how many cases there are."""

    def update(self, update: Update) -> None:
        """Take note of a running case."""

    def finished(self, case: Case, result: CaseResult) -> None:
        """Take note of a case that is done."""


def _controllers(controllers: Controllers, problems: Sequence[str], faults: list[str]) -> Table:
    """Return the controllers' sections; what no study file can say is added to the faults."""
    sections, keys = Table(), dict[str, str]()
    for label, given in controllers.items():
        key = _key(label)
        if not key or key in keys:
            other = f'; "{keys[key]}" is too much like it' if key else ": needed: letters or digits in it"
            faults.append(f'controllers: "{label}"{other}')
            continue
        try:
            keys[not_reserved(key)] = label
        except ValueError as error:
            faults.append(f'controllers: "{label}": {error}')
            continue
        by_problem = given if isinstance(given, Mapping) else dict.fromkeys(problems or [""], given)
        if not problems and isinstance(given, Mapping):
            faults.append(f'controllers: "{label}" has one for each problem, and the study has one problem')
            continue
        unknown = [name for name in by_problem if problems and name not in problems]
        faults += [
            f'controllers: "{label}": no problem "{name}"; {did_you_mean(name, problems)}' for name in unknown
        ]
        try:
            tables = {name: _controller(label, one) for name, one in by_problem.items()}
        except ConfigError as error:
            faults += error.faults
            continue
        sections[key] = {} if key == label else {"label": label}
        if isinstance(given, Mapping):
            sections[key][PROBLEMS] = {name: tables.get(name, False) for name in problems}
            first = next(iter(tables.values()), {})
            sections[key] |= {"type": first.get("type", "")}
        else:
            sections[key] |= next(iter(tables.values()))
    return sections


def _controller(label: str, given: Any) -> Table:
    if isinstance(given, Controller):
        return controller_table(given)
    if isinstance(given, str):
        return {"type": given}
    raise ConfigError(
        f'controllers: "{label}" is {given!r}; needed: a controller, the name of one, or one for each problem'
    )


def _key(label: str) -> str:
    """Return what stands for a label in a study file and in names of folders."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", label).strip("._-")[:60]
