"""Studies in Python: problems and controllers as objects, of which a study file is the written form."""

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from datetime import date
from os import PathLike
from pathlib import Path
from typing import Any, Literal, Self

from ddpc_cosim.codec import declared_fields, read
from ddpc_cosim.conditions import Conditions
from ddpc_cosim.controller import Controller, Recording
from ddpc_cosim.coupling.wiring import Connection
from ddpc_cosim.distributions import Distribution, Sampling
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.durations import seconds_of
from ddpc_cosim.files.tables import plain_table
from ddpc_cosim.files.texts import printable
from ddpc_cosim.identification.identification import Identification
from ddpc_cosim.loop.outlook import Limit
from ddpc_cosim.loop.setup import EngineName
from ddpc_cosim.metrics import Ranking, metric_of
from ddpc_cosim.plant import FMIType, ParameterValue
from ddpc_cosim.plugins import name_of
from ddpc_cosim.processes.scratch import ScratchFolder
from ddpc_cosim.settings import Search
from ddpc_cosim.signals.disturbances import Knowledge, KnownDisturbance
from ddpc_cosim.signals.excitations import Excitation, sampling_faults
from ddpc_cosim.signals.prices import Price
from ddpc_cosim.signals.signals import Band, Drift, GaussianNoise, ParameterChange, Reference
from ddpc_cosim.study.case_files import CaseResult
from ddpc_cosim.study.cases import Case
from ddpc_cosim.study.file_format.replacing import CONTROLLERS, PROBLEMS, SWEEP
from ddpc_cosim.study.file_format.requirements import REQUIREMENTS, by_metric, with_requirements
from ddpc_cosim.study.file_format.sections import (
    ControllerSection,
    LoopSection,
    MetricsSection,
    PlantSection,
    ScenarioSection,
    expand_seeds,
    not_reserved,
)
from ddpc_cosim.study.file_format.study_files import StudyFile, absolute_paths
from ddpc_cosim.study.file_format.written import Table, controller_table, experiment_table, plain
from ddpc_cosim.study.rare_events import FiguresOfCases, RareEvent, rare_event
from ddpc_cosim.study.reading import read_file, resolve_file
from ddpc_cosim.study.resolve import ResolvedProblems
from ddpc_cosim.study.results import StudyResults
from ddpc_cosim.study.runner import Progress, Selection, Update, run_study
from ddpc_cosim.study.single import single_case
from fmu_plants.files import write_atomically
from fmu_plants.spelling import did_you_mean

Bounds = Mapping[str, tuple[Limit, Limit] | Mapping[str, Limit | str]]
"""Limits by signal: both, or a table of ``min``, ``max`` and ``unit``; one left out is the plant's own."""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A controller of a study, and what the study says of it besides its settings.

    Parameters
    ----------
    controller : Controller or str
        The controller, or the name of one with its defaults.
    note : str
        One line about it for the report.
    bounds : mapping of str to (limit, limit), or to mapping of str to limit or str
        Limits that replace the study's for it, as of :class:`Problem`.
    sweep : sequence of mapping of str to sequence, or one of them
        Settings and values to try: of each mapping all combinations are run, with ``zip=True`` the first of
        each, the second of each.
    search : mapping of str to Linear, Log, Factor, Integer or Choice, or to False
        Where ``ddpc-cosim tune`` looks for settings, in place of what its class declares; False: nowhere.
    first_trials : sequence of mapping of str to Any
        Settings that it tries next after those given.
    tuned : mapping of str to Any
        How its settings were found: the keys of the table ``tuned`` of a study file.
    seeds : {"all", "first"}
        With which of the study's seeds it is run; ``"first"``, the first alone, of a reference point only.
    """

    controller: Controller | str
    note: str = ""
    bounds: Bounds = field(default_factory=dict)
    sweep: Mapping[str, Any] | Sequence[Mapping[str, Any]] = ()
    search: Mapping[str, Search | Literal[False]] = field(default_factory=dict)
    first_trials: Sequence[Mapping[str, Any]] = ()
    tuned: Mapping[str, Any] = field(default_factory=dict)
    seeds: Literal["all", "first"] = "all"

    def table(self) -> Table:
        """Return the controller as a study file says it.

        Raises
        ------
        ConfigError
            Settings that no study file can say, all of them.
        """
        given = self.controller
        kind = {"type": given} if isinstance(given, str) else controller_table(given)
        return {**kind, **_of(ControllerSection, self)}


Given = Controller | str | Entry
Controllers = Mapping[str, Given | Mapping[str, Given]]
"""By label: a controller, the name of one with its defaults, or one for each problem."""


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """What every controller of a problem is run under.

    Parameters
    ----------
    label : str
        Its name for people; empty: that in the problem.
    parameters : mapping of str to float, int, bool, str or Distribution
        Plant parameters in this scenario, in place of the problem's.
    noise : GaussianNoise or mapping of str to float
        Standard deviation of the noise of each measurement, in its unit.
    conditions : Conditions
        Disturbances, signals of inputs that the controller does not drive, what actuators and sensors do.
    events : sequence of ParameterChange
        Tunable parameters that change during the run.
    drifts : sequence of Drift
        Tunable parameters that move linearly.
    known : mapping of str to str
        What is known of disturbances, in place of what the problem says of them.
    prices : mapping of str to float or Reference
        Prices in place of the problem's, in its units.
    bounds : mapping of str to (limit, limit), or to mapping of str to limit or str
        Limits in place of the problem's; infinite: none.
    preview : int or "horizon", optional
        How many future references a controller may see, or as many as it asks for; default: the problem's.
    excitation : Excitation, optional
        The experiment in place of the problem's.
    start_time : float, str or date, optional
        Time of the first sample in place of the problem's [s]; also a date or a day of the year.
    """

    label: str = ""
    parameters: Mapping[str, ParameterValue | Distribution] = field(default_factory=dict)
    noise: GaussianNoise | Mapping[str, float] = field(default_factory=dict)
    conditions: Conditions = field(default_factory=Conditions)
    events: Sequence[ParameterChange] = ()
    drifts: Sequence[Drift] = ()
    known: Mapping[str, Knowledge] = field(default_factory=dict)
    prices: Mapping[str, float | Reference] = field(default_factory=dict)
    bounds: Bounds = field(default_factory=dict)
    preview: int | Literal["horizon"] | None = None
    excitation: Excitation | None = None
    start_time: float | str | date | None = None

    def table(self, inputs: Sequence[str] = ()) -> Table:
        """Return the scenario as a study file says it.

        Parameters
        ----------
        inputs : sequence of str
            The inputs that an experiment of its own excites.

        Raises
        ------
        ConfigError
            A signal that no study file can say.
        """
        conditions = self.conditions
        disturbances = {
            name: [signals] if isinstance(signals, Reference) else signals
            for name, signals in conditions.disturbances.items()
        }
        experiment = {} if self.excitation is None else experiment_table(self.excitation, inputs)
        recorded = plain(conditions.recorded_inputs, "recorded input {}")
        return _of(ScenarioSection, self) | _given(
            {
                "disturbances": plain(disturbances, "disturbance of {}"),
                "inputs": plain(conditions.inputs, "input {}"),
                "recording": experiment | _given({"inputs": recorded}),
                **plain(conditions.effects),
            }
        )


@dataclass(frozen=True, kw_only=True)
class Problem:
    """What controllers are asked to do: a plant, the loop, references, limits, data, and scenarios.

    The keywords of :func:`ddpc_cosim.cosimulate` mean the same here.

    Parameters
    ----------
    plant : str, path, PlantModel, class or Identification, or mapping of str to these
        A plant of ``ddpc-cosim list plants``, an FMU or SSP file, equations, or a class derived from
        ``Plant``; what it is identified from, with ``inputs`` and ``outputs``; of a coupled plant its parts
        by name.
    sampling_time, duration : float or str
        Time between samples and simulated time [s], or as people say it: ``"15 min"``.
    reference : Reference or Band, or mapping of str to these
        What is wanted of the controlled output, or of each by name, in their units; none, ``{}``, where only
        :class:`PlantControl` competes.
    inputs, outputs, measurements : sequence of str, optional
        What is driven, controlled and measured; default: all, and the controlled outputs.
    bounds : mapping of str to (limit, limit), or to mapping of str to limit or str
        Limits of inputs and controlled outputs in place of the plant's, numbers or signals of time; infinite:
        none. A mapping may have ``min``, ``max`` and ``unit``; what it leaves out is the plant's own.
    disturbances : mapping of str to KnownDisturbance
        What acts on the plant and is known: inputs that no controller drives, or outputs, by name.
    prices : mapping of str to Price
        What signals cost.
    excitation : Excitation, optional
        The experiment that data-driven controllers learn from, sampled as the loop; each case draws it with
        its own seed.
    stabiliser : Controller, optional
        Keeps the plant during the experiment.
    recording : Recording or mapping of str to Any, optional
        Logged data, in place of an experiment; or ``file``, one or several, with ``columns``
        and how they are read, such as ``time_column`` and ``gaps``.
    recorded_inputs : mapping of str to Reference
        Signals of inputs that no controller drives during the experiment, in place of a scenario's.
    recorded_disturbances : mapping of str to Reference
        The same of known disturbances, in place of their own course.
    recording_start : float, str or date, optional
        Time of the experiment's first sample [s]; default: with known disturbances it ends where the loop
        begins, else 0.
    parameters : mapping of str to float, int, bool, str or Distribution
        Plant parameters; of a distribution each seed draws its own, the same for all controllers.
    sampling : {"independent", "latin-hypercube", "sobol"}
        How seeds draw parameters: each for itself; of n seeds one in each n-th part of a distribution; or
        as the point of the Sobol sequence that has the seed as its number.
    noise, conditions, events
        Of the scenario ``nominal``, where ``scenarios`` has none: see :class:`Scenario`.
    scenarios : mapping of str to Scenario
        By name; empty: one, ``nominal``.
    preview : int, optional
        How many future references a controller may see; default: as many as it asks for.
    start_time : float, str or date
        Time of the first sample [s], or ``"day 23"`` or a date: counted from the start of its year.
    communication_step : float or str, optional
        How far the plant is advanced at once [s], so that what is paid and key figures come from more than
        the samples; default: the sampling time.
    warm_up : float or str
        How long the plant runs before the first sample, which is not judged [s].
    warm_up_controller : Controller, optional
        Controls it meanwhile; default: its own control, or inputs at rest.
    continue_recording : bool
        Start where the experiment ended instead of from rest.
    cost : mapping of str to mapping of str to float
        Weights of the quadratic cost that controllers are ranked by: ``outputs``, ``inputs``, ``changes``.
    ranking : {"error", "money", "pareto"}, optional
        What controllers are ranked by: errors or the cost, money, or money and discomfort both; default: the
        last where there are prices, else the first.
    key_figures : str or mapping of str to Any, optional
        A set of key figures of a building: ``"boptest"``, or a table of ``set``, ``area`` [m2], ``sources``
        (signals by source) and ``bands`` of zones that are not controlled within one.
    relevant : mapping of str to float, or to mapping of str to float
        The smallest difference of what is ranked by that matters: ``absolute``, of several outputs one for
        each, and ``percent`` of the best figure or of the task. Default: 1 %.
    start, nominal, display_units : mapping of str to float, float, str
        Start values of inputs, sizes that controllers scale by, and units to show, in place of the plant's.
    switches : mapping of str to str
        For inputs that override the plant's own control, the input that switches the override on; an empty
        one: none. Default: ``NAME_activate`` of ``NAME_u``, where the plant's description says so.
    fmi_type : str
        How an FMU is run.
    isolated : bool or "auto"
        Whether each case runs its FMU in a process of its own; auto: if the FMU is a supplied file.
    library_path : sequence of str or Path
        Libraries that are loaded before the FMU's, and folders that have those which it needs.
    step_timeout, case_timeout : float, optional
        Longest time for any call of the plant or of a controller, and for a whole case [s].
    memory_limit : float, optional
        Memory that a case may have [GB].
    engine : {"python", "compiled"}
        What computes the samples: compiled, C code where there is some, with the same figures.
    connections : sequence of Connection
        What the parts of a coupled plant exchange.
    coupling : mapping of str to float or str
        How they do: ``algorithm``, ``communication_step``, ``steps`` (of parts, by name) and further
        arguments of :class:`ddpc_cosim.CoupledPlant`.
    parts : mapping of str to mapping of str to Any
        What is said of parts besides, those of an SSP archive too: ``parameters``, ``start``, ``step``,
        ``fmi_type``, ``isolated``.
    requirements : mapping of str to Any
        What controllers have to be, by metric and signal: ``{"overshoot.angle": {"max": 5.0}}``, with
        ``min``, ``max``, ``share`` of the seeds, ``unit`` and ``scenarios``; ``share`` of all of them, and
        ``controllers``, who has to meet it, by the names that :attr:`Study.controllers` lists. It decides no
        result.
    title, summary, source : str
        Of this problem, where a study has several.
    report : mapping of str to Any
        What the report shows of this problem besides: see :class:`Study`.

    Raises
    ------
    ConfigError
        Scenarios besides noise, conditions or events, both an excitation and a recording, or an excitation
        with another sampling time than the loop's.
    """

    plant: Any
    sampling_time: float | str
    duration: float | str
    reference: Reference | Band | Mapping[str, Reference | Band]
    inputs: Sequence[str] = ()
    outputs: Sequence[str] = ()
    measurements: Sequence[str] = ()
    bounds: Bounds = field(default_factory=dict)
    disturbances: Mapping[str, KnownDisturbance] = field(default_factory=dict)
    prices: Mapping[str, Price] = field(default_factory=dict)
    excitation: Excitation | None = None
    stabiliser: Controller | None = None
    recording: Recording | Mapping[str, Any] | None = None
    recorded_inputs: Mapping[str, Reference] = field(default_factory=dict)
    recorded_disturbances: Mapping[str, Reference] = field(default_factory=dict)
    recording_start: float | str | date | None = None
    parameters: Mapping[str, ParameterValue | Distribution] = field(default_factory=dict)
    sampling: Sampling = "independent"
    noise: GaussianNoise | Mapping[str, float] = field(default_factory=dict)
    conditions: Conditions = field(default_factory=Conditions)
    events: Sequence[ParameterChange] = ()
    scenarios: Mapping[str, Scenario] = field(default_factory=dict)
    preview: int | None = None
    start_time: float | str | date = 0.0
    communication_step: float | str | None = None
    warm_up: float | str = 0.0
    warm_up_controller: Controller | None = None
    continue_recording: bool = False
    cost: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    relevant: Mapping[str, float | Mapping[str, float]] = field(default_factory=dict)
    ranking: Ranking | None = None
    key_figures: str | Mapping[str, Any] | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    nominal: Mapping[str, float] = field(default_factory=dict)
    switches: Mapping[str, str] = field(default_factory=dict)
    display_units: Mapping[str, str] = field(default_factory=dict)
    fmi_type: FMIType = "auto"
    isolated: Literal["auto", True, False] = "auto"
    library_path: Sequence[str | Path] = ()
    step_timeout: float | None = None
    case_timeout: float | None = None
    memory_limit: float | None = None
    engine: EngineName = "python"
    connections: Sequence[Connection] = ()
    coupling: Mapping[str, Any] = field(default_factory=dict)
    parts: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    requirements: Mapping[str, Any] = field(default_factory=dict)
    title: str = ""
    summary: str = ""
    source: str = ""
    report: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        faults = []
        given = [key for key in ("noise", "conditions", "events") if getattr(self, key) not in _NOTHING]
        if self.scenarios and given:
            faults.append(f"problem: {', '.join(given)} belong to a scenario; needed: in one of scenarios")
        if self.excitation is not None and self.recording is not None:
            faults.append("problem: give an excitation or a recording, not both")
        experiments = [self.excitation, *(scenario.excitation for scenario in self.scenarios.values())]
        time = self.sampling_time
        with suppress(ValueError):  # which is reported when it is run
            seconds = seconds_of(time) if isinstance(time, str) else time
            for excitation in filter(None, experiments):
                faults += [f"problem: {fault}" for fault in sampling_faults(excitation, seconds)]
        if self.excitation is None and self.stabiliser is not None:
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
        nominal = Scenario(noise=self.noise, conditions=self.conditions, events=self.events)
        scenarios = self.scenarios or {"nominal": nominal}
        inputs = self._names("inputs") if any(scenario.excitation for scenario in scenarios.values()) else []
        references = self.reference
        if isinstance(references, Reference | Band):
            references = {self._names("outputs")[0]: references}
        tables = {
            "plant": self._plant_table(),
            "loop": _of(LoopSection, self, "start", "warm_up_controller"),
            **({"reference": plain(references, "reference of {}")} if references else {}),
            "bounds": _limits(self.bounds),
            "disturbances": plain(self.disturbances, "disturbance {}"),
            "prices": plain(self.prices, "price {}"),
            "recording": self._recording_table(),
            "scenarios": {name: scenario.table(inputs) for name, scenario in scenarios.items()},
            "metrics": _of(MetricsSection, self),
            REQUIREMENTS: by_metric(plain(self.requirements)),
        }
        if self.continue_recording:
            tables["loop"]["start"] = "recording-end"
        if self.warm_up_controller is not None:
            tables["loop"]["warm_up_controller"] = controller_table(self.warm_up_controller)
        words = {key: plain(getattr(self, key)) for key in ("title", "summary", "source", "report")}
        tables = absolute_paths(_given(tables | words), Path.cwd())
        if not isinstance(self.recording, Recording):
            return tables
        return tables | {
            "recording": {"file": recording} | _given({"excitation_columns": self._excitation()})
        }

    def write_recording(self, path: Path) -> None:
        """Write the logged data, if there are any, as the CSV file that :meth:`tables` names."""
        if isinstance(self.recording, Recording):
            outputs = self._names("outputs")
            measured = list(self.measurements) or outputs
            known = list(self.disturbances)
            inputs, excitation = self._names("inputs"), self._excitation()
            self.recording.write_csv(path, inputs, outputs, measured, known, excitation)

    def _excitation(self) -> list[str]:
        """Return headers for what moved the inputs of the logged data from outside, if that is known."""
        assert isinstance(self.recording, Recording)
        return [f"excitation {i + 1}" for i in range(self.recording.excitation.shape[1])]

    def _plant_table(self) -> Table:
        coupling = {key: value for key, value in self.coupling.items() if key != "steps"}
        table = {**_of(PlantSection, self, "coupling", "parts"), **self._plant_name()}
        return table | _given({"coupling": plain(coupling)})

    def _plant_name(self) -> Table:
        steps = {name: {"step": step} for name, step in self.coupling.get("steps", {}).items()}
        said = {name: {**steps.get(name, {}), **plain(part)} for name, part in self.parts.items()}
        if not isinstance(self.plant, Mapping):
            parts = [{"name": name, **part} for name, part in said.items()]
            return _plant(self.plant, "name") | _given({"parts": parts})
        said = steps | said
        parts = [
            {"name": name, **_plant(part, "plant"), **said.get(name, {})} for name, part in self.plant.items()
        ]
        parts += [{"name": name, **part} for name, part in said.items() if name not in self.plant]
        return {"parts": parts, "connections": plain(self.connections)}

    def _recording_table(self) -> Table:
        if isinstance(self.recording, Mapping):
            return dict(plain(self.recording))
        if self.excitation is None:
            return {}
        table = experiment_table(self.excitation, self._names("inputs"))
        if self.stabiliser is not None:
            table["controller"] = controller_table(self.stabiliser)
        inputs = plain(self.recorded_inputs, "recorded input {}")
        disturbances = plain(self.recorded_disturbances, "recorded disturbance {}")
        start = plain(self.recording_start)
        return table | _given({"inputs": inputs, "disturbances": disturbances, "start_time": start})

    def _names(self, which: str) -> list[str]:
        """Return the inputs or outputs that take part, where none are named those of the plant."""
        if given := list(getattr(self, which)):
            return given
        from ddpc_cosim.study.plants import PlantSpec

        table = absolute_paths({"plant": self._plant_name()}, Path.cwd())["plant"]
        variables = PlantSpec.of(read(PlantSection, table), Path()).variables()
        every = getattr(variables, f"default_{which}") or getattr(variables, which)
        return [name for name in every if which != "inputs" or name not in self.disturbances]


def _plant(plant: Any, key: str) -> Table:
    """Return a plant as a study file says it; ``key`` is that of plug-ins."""
    if isinstance(plant, Identification):
        return {"identified": plain(plant)}
    path = plant if isinstance(plant, PathLike) else Path(plant) if isinstance(plant, str) else None
    suffix = "" if path is None else Path(path).suffix.lower()
    if path is not None and (suffix in (".fmu", ".ssp") or isinstance(plant, PathLike)):
        return {"ssp" if suffix == ".ssp" else "fmu": str(path)}
    if isinstance(plant, str):
        return {key: plant}
    return {key: name_of("plants", plant, getattr(plant, "name", type(plant).__name__))}


_NOTHING: tuple[Any, ...] = ({}, (), [], Conditions(), GaussianNoise({}))


def _given(table: Table) -> Table:
    """Return a table without what is empty."""
    return {key: value for key, value in table.items() if value not in (None, "", {}, [])}


def _of(section: type[Any], given: Any, *others: str) -> Table:
    """Return what an object says of a section's keys by fields of the same names, without defaults."""
    names = {given_field.name for given_field in fields(given)}
    keys = {
        key: declared
        for key, declared in declared_fields(section).items()
        if key in names and key not in others
    }
    said = {key: plain(getattr(given, key)) for key in keys}
    if said.get("bounds"):
        said["bounds"] = _limits(given.bounds)
    return {
        key: value
        for key, value in _given(said).items()
        if keys[key].is_required or value != keys[key].default()
    }


def _limits(bounds: Bounds) -> Table:
    return {
        name: plain(limits)
        if isinstance(limits, Mapping)
        else {
            key: plain(limit, f"limit of {name}") for key, limit in zip(("min", "max"), limits, strict=True)
        }
        for name, limits in bounds.items()
    }


class Study:
    """Controllers on one or several problems, over scenarios and seeds.

    Parameters
    ----------
    problems : Problem or mapping of str to Problem
        What is asked of the controllers.
    controllers : mapping of str to Controller, str, Entry, or mapping of str to these
        By label; the name of a controller stands for its defaults, an :class:`Entry` says more of it. A
        mapping has one for each problem, and none for those that it leaves out.
    seeds : sequence of int
        Each case is run with each of them.
    name, title, summary, source : str
        As in a study file; the folder of results is called after the name.
    reference_points : (str, str), optional
        Labels of two controllers that do not compete: those at 0 % and at 100 % of the scale on which
        :meth:`StudyResults.shares` places all others.
    report : mapping of str to Any
        What the report shows besides: the keys of the table ``report`` of a study file, in which controllers
        have the names that :attr:`controllers` lists.
    requirements : mapping of str to Any
        What controllers have to be in all problems, as of :class:`Problem`, whose own stand in its place.
    sweep : sequence of mapping of str to sequence, or one of them
        Values to try of anything in the study, by its path in the file:
        ``{"loop.sampling_time": [0.1, 0.2]}``.

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
        report: Mapping[str, Any] | None = None,
        requirements: Mapping[str, Any] | None = None,
        sweep: Mapping[str, Any] | Sequence[Mapping[str, Any]] = (),
    ) -> None:
        faults = list[str]()
        words = {"title": title, "summary": summary, "source": source}
        said = _given({**words, "report": plain(report)})
        if not isinstance(seeds, Iterable):
            faults.append(f"seeds = {seeds!r}: needed: a sequence, e.g. [{seeds!r}] or range({seeds!r})")
            seeds = ()
        tables: Table = {"name": name, **said, "seeds": [int(seed) for seed in seeds]}
        self._recordings: dict[str, Problem] = {}
        asked = by_metric(plain(requirements or {}))
        if isinstance(problems, Problem):
            tables = self._problem_tables("recording.csv", problems, faults) | tables
            asked = with_requirements(asked, tables.get(REQUIREMENTS, {}))
        else:
            tables[PROBLEMS] = {
                key: self._problem_tables(f"recording-{key}.csv", problem, faults)
                for key, problem in problems.items()
            }
        tables |= _given({REQUIREMENTS: asked})
        sections = _controllers(controllers, list(tables.get(PROBLEMS, ())), faults)
        tables |= absolute_paths({CONTROLLERS: sections, **_given({SWEEP: plain(sweep)})}, Path.cwd())
        if reference_points:
            faults += [
                f'reference_points: no controller "{label}"; {did_you_mean(label, controllers)}'
                for label in reference_points
                if label not in controllers
            ]
            ends = dict(zip(("zero", "full"), map(_key, reference_points), strict=True))
            tables["report"] = {**tables.get("report", {}), "reference_points": ends}
        if faults:
            raise ConfigError(faults)
        self._file = StudyFile(name, Path.cwd(), tables)

    def _problem_tables(self, recording: str, problem: Problem, faults: list[str]) -> Table:
        if isinstance(problem.recording, Recording):
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
        if faults := made._file.fault_messages():
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
        engine: EngineName | Literal[""] = "",
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
        only, seeds, fresh, sandbox, executor, scheduler, shard, storage, keep_files, engine
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
        where = (executor, scheduler, shard, storage, keep_files, engine)
        selection = Selection(jobs, list(seeds), only, fresh, sandbox, *where)
        if progress is not True:
            return run_study(resolve_file(file), folder, selection, progress or Silent())
        from ddpc_cosim.cli.progress import display

        with display(f"reading {self.name}") as following:
            return run_study(resolve_file(file), folder, selection, following)

    def probability(
        self,
        metric: str,
        beyond: float,
        *,
        controller: str,
        problem: str | None = None,
        scenario: str | None = None,
        samples: int = 500,
        repetitions: int = 10,
        seed: int = 0,
        jobs: int = 1,
        progress: bool = True,
        engine: EngineName = "compiled",
    ) -> RareEvent:
        """Estimate how probable it is that a figure of a run is as bad as a level or worse.

        By subset simulation over the distributions of the plant's parameters and over seeds, for what is too
        rare to be counted: 1e-4 takes some 21 000 loops.

        Parameters
        ----------
        metric : str
            A metric, its unit may be left out: ``"max_abs_error.angle"``. A run that does not complete is
            beyond any level.
        beyond : float
            The level, in the metric's unit.
        controller : str
            The controller's name.
        problem, scenario : str or None
            Default: the only problem, the first scenario.
        samples : int
            Runs of each subset, a tenth as probable as the one before.
        repetitions : int
            How often it is done: from how much these differ comes the interval.
        seed : int
            Of what is drawn.
        jobs : int
            Number of worker processes.
        progress : bool
            Whether to show how far it is.
        engine : {"compiled", "python"}
            What computes the samples.

        Returns
        -------
        event : RareEvent
            ``probability``, its 95 % interval ``low`` to ``high``, and how many ``loops`` that took.

        Raises
        ------
        ConfigError
            There is no such metric, controller, problem or scenario, too few samples or repetitions, or
            neither a parameter with a distribution nor noise.
        """
        resolved = self.resolved()
        case, single = single_case(resolved, controller, Silent(), problem=problem, scenario=scenario)
        section = single.study.scenarios[case.scenario]
        said = {**single.study.plant.parameters, **section.parameters}
        spread = {name: value for name, value in said.items() if isinstance(value, Distribution)}
        if not (spread or case.noise):
            raise ConfigError(
                f"{case.name}: nothing leads to what is rare, as seeds draw neither parameters nor noise: "
                "give a parameter a distribution or a measurement noise"
            )
        figures = FiguresOfCases(replace(case, engine=engine), spread, metric, jobs)
        sign = -1.0 if metric_of(metric).better == "high" else 1.0
        how: dict[str, Any] = {"samples": samples, "repetitions": repetitions, "seed": seed}
        if not progress:
            return rare_event(figures, len(spread), sign * beyond, **how)
        from ddpc_cosim.cli.progress import display

        with display(f"starting {self.name}") as following:
            return rare_event(figures, len(spread), sign * beyond, **how, tell=following.prepare)

    def resolved(self, problem: str | None = None) -> ResolvedProblems:
        """Return the study, checked, as commands read it.

        Parameters
        ----------
        problem : str or None
            The only one of its problems that is wanted; default: all.

        Raises
        ------
        ConfigError
            Everything in the study that does not fit.
        """
        if not self._recordings:
            return resolve_file(self._file, problem)
        with ScratchFolder() as folder:  # what lies there has been read then
            self._write_recordings(folder)
            return resolve_file(replace(self._file, folder=folder), problem)

    def _write_recordings(self, folder: Path) -> None:
        for name, problem in self._recordings.items():
            problem.write_recording(folder / name)

    def __repr__(self) -> str:
        try:
            seeds = expand_seeds(self._file.tables.get("seeds", [0]))
        except ValueError:  # which is reported when it is run
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
    content = tables.get(key)
    return content if isinstance(content, dict) else {}


class Silent:
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
            tables = {name: _controller(label, entry) for name, entry in by_problem.items()}
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
    if isinstance(given, Controller | str):
        given = Entry(controller=given)
    if isinstance(given, Entry) and isinstance(given.controller, Controller | str):
        return given.table()
    raise ConfigError(
        f'controllers: "{label}" is {given!r}; needed: a controller, the name of one, or one for each problem'
    )


def _key(label: str) -> str:
    """Return what stands for a label in a study file and in names of folders."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", label).strip("._-")[:60]
