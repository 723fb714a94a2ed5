"""The cases of a study, and what decides each of them."""

import hashlib
import json
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from fnmatch import fnmatch
from itertools import accumulate, chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self, overload

import numpy as np

from ddpc_cosim.conditions import Conditions, changed_inputs
from ddpc_cosim.controller import Recording
from ddpc_cosim.distributions import Distribution, shares
from ddpc_cosim.errors import (
    ConfigError,
)
from ddpc_cosim.loop import safe_calls
from ddpc_cosim.loop.logged import LoggedSignals
from ddpc_cosim.loop.master import (
    EARLY,
    Resumption,
)
from ddpc_cosim.loop.outlook import Limit
from ddpc_cosim.loop.setup import EngineName
from ddpc_cosim.metrics import MetricSettings
from ddpc_cosim.plant import ParameterValue
from ddpc_cosim.plugins import code_version, folders_of, is_own, own_folder, types_in, values_of
from ddpc_cosim.settings import PLANT, files_of, hash_of_file, plants_of
from ddpc_cosim.signals.disturbances import KnownDisturbance
from ddpc_cosim.signals.excitations import Excitation
from ddpc_cosim.signals.prices import Price
from ddpc_cosim.signals.signals import Band, ParameterChange, Reference
from ddpc_cosim.study.case_files import DOING_NOTHING, OWN_CONTROL
from ddpc_cosim.study.controller_plugins import controller_class
from ddpc_cosim.study.plants import PlantSpec, content_of_plant, stand_ins_of_file
from ddpc_cosim.variables import FloatArray, Variable, names
from fmu_plants.spelling import did_you_mean

if TYPE_CHECKING:  # a worker, which runs cases, does without what reads studies
    from ddpc_cosim.study.file_format.sections import (
        ControllerSection,
        LoopSection,
        ScenarioSection,
        StabiliserSection,
        Study,
    )
    from ddpc_cosim.study.resolve import ResolvedStudy

# What a case has besides all that decides its result.
_NAMES, _OF_EXECUTION = (
    ("label", "id", "problem"),
    ("step_timeout", "case_timeout", "memory_limit", "sandbox", "storage", "keeps_state", "engine"),
)
_NOT_DECISIVE = (*_NAMES, *_OF_EXECUTION, "late", "metrics", "seed", "shared_bounds")
# What is part of a case only where its study says something of it: ids of other cases do not know it.
_WHERE_SAID = (
    "disturbances",
    "recorded_disturbances",
    "recording_start",
    "prices",
    "monitors",
    "communication_step",
    "read",
    "forecast_horizon",
    "warm_up",
    "warm_up_controller",
    "resumed",
    "replayed",
    "spread",
    "noise_mixture",
)
_NOTHING_SAID: tuple[Any, ...] = ({}, (), None)
Bounded = dict[str, tuple[Limit, Limit]]
_LONGEST_NAME = 80
"""Of a case, in the name of its folder: on Windows a path has 259 characters."""
_HASHED = 10
"""Digits of its hash, at the end of its id."""
_RESTING, _PLANT_CONTROL = "idle", "plant"
"""The controllers, by entry point, that leave the inputs at rest, and to the plant's own control."""


class Replayed(NamedTuple):
    """A log that stands in for a case's plant.

    Parameters
    ----------
    signals : LoggedSignals
        What was logged.
    first : int
        Which of its samples is the first of the run.
    learned_in : Case
        The case on the plant itself, in which the controller learns.
    """

    signals: LoggedSignals
    first: int
    learned_in: "Case"


@dataclass(frozen=True, slots=True)
class Case:
    """One run of a study: everything that decides its result, ready to be sent to a worker.

    Parameters
    ----------
    controller, scenario : str
        Their names in the study.
    seed : int
        Seed of excitation, noise and the controller's random numbers.
    label : str
        Name of the controller in reports.
    section : dict
        The controller's type and settings, every default filled in; no type: the plant runs in open loop.
    plant : PlantSpec
        The plant.
    inputs, outputs, measurements : tuple of Variable
        The signals that take part.
    sampling_time, duration, start_time : float
        Timing [s].
    continue_recording : bool
        The loop starts where the recording ended.
    reference : dict of str to (Reference or Band)
        Of each controlled output, in its own unit.
    bounds, shared_bounds : dict of str to pairs of (float or Reference)
        Limits in the variables' own units, and those of a controller that has none of its own.
    excitation : Excitation or None
        The experiment, which is run with the case's seed.
    recording : Recording or None
        Logged data, in place of an experiment.
    stabiliser : dict or None
        Type and settings of the controller that keeps the plant during the experiment.
    parameters : dict of str to float
        Plant parameters, those included that its seed has drawn.
    noise : dict of str to float
        Standard deviations of measurement noise.
    events : tuple of ParameterChange
        Parameter changes during the run.
    preview : int or None
        How many future references any controller may see; None: as many as it asks for.
    case_timeout : float or None
        Longest time for the whole case [s]; None: any.
    memory_limit : float or None
        Memory that its process may have [GB]; None: its share of the machine's.
    step_timeout : float
        Longest time for any call of the plant or of the controller [s]; it does not decide the result.
    conditions : Conditions
        What else acts on the plant, and what its actuators and sensors do.
    undriven : tuple of Variable
        The inputs that have a signal.
    disturbances : dict of str to KnownDisturbance
        What acts on the plant and is known, in the variables' own units; of inputs the conditions have the
        signals.
    recorded_disturbances : dict of str to Reference
        Signals of some of them in the experiment.
    recording_start : float or None
        Time of the experiment's first sample [s]; None: 0.
    prices : dict of str to Price
        What signals cost.
    monitors : dict of str to (Band or None)
        Outputs that are kept besides, with the band that they are wanted within.
    communication_step : float or None
        How far the plant is advanced at once [s]; None: the sampling time.
    read : tuple of Variable
        Outputs that are neither controlled nor measured, and known disturbances, paid for or monitored.
    forecast_horizon : int or None
        The longest horizon of the study's controllers, as far as forecasts are made; None: there are none.
    warm_up : float
        How long the plant runs before the first sample [s].
    warm_up_controller : dict or None
        Type and settings of the controller that it has then; None: its own control.
    resumed : Resumption or None
        The state of another run that it goes on from.
    replayed : Replayed or None
        The log that stands in for the plant.
    keeps_state : bool
        Whether the plant's state at its end is kept, which does not decide the result.
    metrics : MetricSettings
        What its figures depend on besides its samples, which they do not decide.
    late : str
        Why it is not run: what the controller was asked before has not returned in time; empty: it is run.
    id : str
        Readable name and a hash of everything that decides the result, code version included.
    sandbox : str
        The sandbox that it is run in, in words, which does not decide the result; empty: none.
    problem : str
        The problem's name, where the study has several.
    storage : {"csv", "parquet"}
        The file of its samples, which does not decide the result.
    engine : {"python", "compiled"}
        What computes its samples, which does not decide the result.
    spread : tuple of Variable
        The parameters that its seed has drawn.
    noise_mixture : tuple of (int, float)
        Seeds and weights that its noise is mixed of, in place of its seed: see :class:`GaussianNoise`.
    """

    controller: str
    scenario: str
    seed: int
    label: str
    section: dict[str, Any]
    plant: PlantSpec
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    measurements: tuple[Variable, ...]
    sampling_time: float
    duration: float
    start_time: float
    continue_recording: bool
    reference: dict[str, Reference | Band]
    bounds: Bounded
    excitation: Excitation | None
    recording: Recording | None
    stabiliser: dict[str, Any] | None
    parameters: dict[str, ParameterValue]
    noise: dict[str, float]
    events: tuple[ParameterChange, ...] = ()
    preview: int | None = None
    conditions: Conditions = field(default_factory=Conditions)
    undriven: tuple[Variable, ...] = ()
    metrics: MetricSettings = field(default_factory=MetricSettings)
    step_timeout: float = safe_calls.DEFAULT_STEP_TIMEOUT
    case_timeout: float | None = None
    memory_limit: float | None = None
    late: str = ""
    id: str = ""
    sandbox: str = ""
    shared_bounds: Bounded = field(default_factory=dict)
    problem: str = ""
    storage: str = "csv"
    engine: EngineName = "python"
    disturbances: dict[str, KnownDisturbance] = field(default_factory=dict)
    recorded_disturbances: dict[str, Reference] = field(default_factory=dict)
    recording_start: float | None = None
    prices: dict[str, Price] = field(default_factory=dict)
    monitors: dict[str, Band | None] = field(default_factory=dict)
    communication_step: float | None = None
    read: tuple[Variable, ...] = ()
    forecast_horizon: int | None = None
    warm_up: float = 0.0
    warm_up_controller: dict[str, Any] | None = None
    resumed: Resumption | None = None
    keeps_state: bool = False
    replayed: Replayed | None = None
    spread: tuple[Variable, ...] = ()
    noise_mixture: tuple[tuple[int, float], ...] = ()

    @property
    def name(self) -> str:
        """Readable name: problem and scenario where there are several in play, controller, seed."""
        return self.name_with(self.seed)

    def name_with(self, seed: int) -> str:
        """Return the name of the same case with another seed."""
        problem = f"{self.problem}_" if self.problem else ""
        scenario = "" if self.scenario == "nominal" else f"_{self.scenario}"
        return f"{problem}{self.controller}{scenario}_seed{seed}"

    @property
    def drawn(self) -> dict[str, float]:
        """The values of the parameters that its seed has drawn, by name and unit: ``"mass [kg]"``."""
        return {variable.header: float(self.parameters[variable.name]) for variable in self.spread}

    @property
    def changed_inputs(self) -> tuple[Variable, ...]:
        """The inputs that the plant may be given otherwise than a controller commands them."""
        return changed_inputs(self.conditions, (*self.inputs, *self.undriven))

    def times(self, count: int) -> FloatArray:
        """Return the times of its first samples [s], shape (count,)."""
        begun = 0 if self.resumed is None else self.resumed.samples
        return self.start_time + (begun + np.arange(count, dtype=np.float64)) * self.sampling_time

    def variable(self, name: str) -> Variable:
        """Return a signal that takes part, by its name."""
        every = (*self.inputs, *self.undriven, *self.outputs, *self.measurements, *self.read)
        return next(variable for variable in every if variable.name == name)

    def head(self) -> dict[str, Any]:
        """Return the identifiers of the case for its ``run.json``."""
        keys = ("id", "problem", "controller", "label", "scenario", "seed", "sandbox", "storage")
        head = {key: getattr(self, key) for key in keys}
        return head | ({"drawn": self.drawn} if self.spread else {})


class CaseSeries(Sequence[Case]):
    """Cases that differ by their seeds and by what these draw; each is made when it is looked at.

    Parameters
    ----------
    case : Case
        What they have in common.
    seeds : sequence of int
        The seeds.
    parameters : mapping of int to dict
        Plant parameters by seed, of these seeds at least.
    ids : sequence of str
        The ids.
    """

    def __init__(
        self,
        case: Case,
        seeds: Sequence[int],
        parameters: Mapping[int, dict[str, ParameterValue]],
        ids: Sequence[str],
    ) -> None:
        self.case, self.seeds, self.parameters, self.ids = case, seeds, parameters, ids

    @overload
    def __getitem__(self, place: int) -> Case: ...

    @overload
    def __getitem__(self, place: slice) -> Self: ...

    def __getitem__(self, place: int | slice) -> Case | Self:
        if isinstance(place, slice):
            return self.at(range(len(self))[place])
        seed = self.seeds[place]
        return replace(self.case, seed=seed, parameters=self.parameters[seed], id=self.ids[place])

    def __len__(self) -> int:
        return len(self.seeds)

    def at(self, places: Sequence[int]) -> Self:
        """Return those in some places, in their order."""
        ids = self.ids.at(places) if isinstance(self.ids, _Ids) else [self.ids[place] for place in places]
        return type(self)(self.case, [self.seeds[place] for place in places], self.parameters, ids)


class Cases(Sequence[Case]):
    """Cases of several series, one after the other.

    Parameters
    ----------
    series : iterable of CaseSeries
        The series.
    """

    def __init__(self, series: Iterable[CaseSeries]) -> None:
        self.series = [*filter(None, series)]
        self._ends = [*accumulate(map(len, self.series))]

    @classmethod
    def of(cls, cases: Iterable[Case]) -> Self:
        """Return cases as such a sequence: those that are not yet, each as a series of its own."""
        if isinstance(cases, cls):
            return cases
        return cls(CaseSeries(case, [case.seed], {case.seed: case.parameters}, [case.id]) for case in cases)

    @overload
    def __getitem__(self, place: int) -> Case: ...

    @overload
    def __getitem__(self, place: slice) -> "Cases": ...

    def __getitem__(self, place: int | slice) -> "Case | Cases":
        places = range(len(self))[place]
        if isinstance(places, int):
            number = bisect_right(self._ends, places)
            return self.series[number][places - self._ends[number]]
        if places.step < 0:
            return Cases.of([*self][place])
        chosen, first = list[CaseSeries](), 0
        for series, end in zip(self.series, self._ends, strict=True):
            inside = places[bisect_left(places, first) : bisect_left(places, end)]
            chosen.append(series.at([i - first for i in inside]))
            first = end
        return Cases(chosen)

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __iter__(self) -> Iterator[Case]:
        return chain.from_iterable(self.series)

    def ids(self) -> Iterator[str]:
        """Yield their ids, for which no case is made."""
        return chain.from_iterable(series.ids for series in self.series)

    def parted(self, is_first: Callable[[CaseSeries], Callable[[str], bool]]) -> "tuple[Cases, Cases]":
        """Return those of whose ids it is true, by what is asked in each series, and the others."""
        both: tuple[list[CaseSeries], list[CaseSeries]] = ([], [])
        for series in self.series:
            asked = [*map(is_first(series), series.ids)]
            for part, wanted in zip(both, (True, False), strict=True):
                places = [place for place, answer in enumerate(asked) if answer is wanted]
                part.append(series.at(places))
        return Cases(both[0]), Cases(both[1])

    def with_all(self, **changes: Any) -> "Cases":
        """Return them with other values of some fields that their ids do not depend on."""
        return Cases(
            CaseSeries(replace(series.case, **changes), series.seeds, series.parameters, series.ids)
            for series in self.series
        )


class _Ids(Sequence[str]):
    """The ids of cases that differ by their seeds, of which only hashes are kept, one after the other."""

    def __init__(self, case: Case, seeds: Sequence[int], hashes: str) -> None:
        self._case, self._seeds, self._hashes = case, seeds, hashes

    @overload
    def __getitem__(self, place: int) -> str: ...

    @overload
    def __getitem__(self, place: slice) -> Self: ...

    def __getitem__(self, place: int | slice) -> str | Self:
        if isinstance(place, slice):
            return self.at(range(len(self))[place])
        return f"{_as_file_name(self._case.name_with(self._seeds[place]))}_{self._hash(place)}"

    def __len__(self) -> int:
        return len(self._seeds)

    def at(self, places: Sequence[int]) -> Self:
        """Return those in some places."""
        seeds = [self._seeds[place] for place in places]
        return type(self)(self._case, seeds, "".join(map(self._hash, places)))

    def _hash(self, place: int) -> str:
        first = range(len(self))[place] * _HASHED
        return self._hashes[first : first + _HASHED]


class _Drawn(Mapping[int, dict[str, ParameterValue]]):
    """Plant parameters by seed, of which some are drawn.

    Parameters
    ----------
    seeds : sequence of int
        The seeds.
    said : dict of str to float
        What is not drawn.
    columns : dict of str to array, shape (len(seeds),)
        What is.
    """

    def __init__(
        self, seeds: Sequence[int], said: dict[str, ParameterValue], columns: dict[str, FloatArray]
    ) -> None:
        self._rows = {seed: row for row, seed in enumerate(seeds)}
        self._said, self._columns = said, columns

    def __getitem__(self, seed: int) -> dict[str, ParameterValue]:
        row = self._rows[seed]
        return self._said | {name: float(column[row]) for name, column in self._columns.items()}

    def __iter__(self) -> Iterator[int]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)


def cases_of(
    resolved: "ResolvedStudy", plant: PlantSpec, seeds: Sequence[int] = (), only: str | Sequence[str] = ()
) -> Cases:
    """Return the cases of a study of one problem: controllers x scenarios x seeds.

    Parameters
    ----------
    resolved : ResolvedStudy
        The study.
    plant : PlantSpec
        Its plant, ready to run.
    seeds : sequence of int
        In place of the study's; empty: the study's.
    only : str or sequence of str
        Glob patterns, of which the name or the label of a case, its controller or its scenario must match
        one; empty: all cases.

    Raises
    ------
    ConfigError
        Patterns that no case matches, all of them.
    """
    return cases_of_problems({"": (resolved, plant)}, seeds, only)


def cases_of_problems(
    problems: Mapping[str, tuple["ResolvedStudy", PlantSpec]],
    seeds: Sequence[int] = (),
    only: str | Sequence[str] = (),
) -> Cases:
    """Return the cases of problems, by name; parameters and errors as of :func:`cases_of`."""
    selected = problems_with_cases({name: resolved for name, (resolved, _) in problems.items()}, seeds, only)
    patterns = patterns_of(only)
    return Cases(
        series
        for name, (resolved, plant) in problems.items()
        if name in selected
        for series in series_of_problem(resolved, plant, name, seeds, patterns)
    )


def problems_with_cases(
    problems: Mapping[str, "ResolvedStudy"], seeds: Sequence[int] = (), only: str | Sequence[str] = ()
) -> list[str]:
    """Return the problems that have selected cases; parameters and errors as of :func:`cases_of`."""

    def matching(pattern: str) -> set[str]:
        return {
            name
            for name, resolved in problems.items()
            if next(series_of_problem(resolved, resolved.plant, name, seeds, [pattern]), None)
        }

    matches = {pattern: matching(pattern) for pattern in patterns_of(only)}
    if unmatched := [pattern for pattern, names in matches.items() if not names]:
        known = {
            word
            for problem, resolved in problems.items()
            for controller in resolved.study.controllers
            for scenario in resolved.study.scenarios
            for word in _words(resolved.study, problem, controller, scenario)
            if word
        }
        raise ConfigError(
            [f"--only {pattern}: no case matches; {did_you_mean(pattern, known)}" for pattern in unmatched]
        )
    return [name for name in problems if not matches or any(name in names for names in matches.values())]


def patterns_of(only: str | Sequence[str]) -> tuple[str, ...]:
    """Return the patterns that select cases; none where all are selected."""
    given = (only,) if isinstance(only, str) else tuple(only)
    return () if "*" in given else given


def doing_nothing(cases: Iterable[Case]) -> Cases:
    """Return the runs that cases are judged by: one per problem, scenario and seed.

    Inputs are at rest, and the plant's own control acts where it has one.
    """
    groups: dict[tuple[str, str], list[CaseSeries]] = {}
    for series in Cases.of(cases).series:
        if series.case.section["type"]:
            groups.setdefault((series.case.problem, series.case.scenario), []).append(series)
    return Cases(map(_at_rest, groups.values()))


def _at_rest(driven: Sequence[CaseSeries]) -> CaseSeries:
    """Return the runs of one scenario with inputs at rest."""
    first = driven[0].case
    signals = names(first.undriven)
    is_controlled = any(
        name in first.plant.switches and first.plant.switches[name] not in signals
        for name in names(first.inputs)
    )
    section = {"type": _PLANT_CONTROL if is_controlled else _RESTING, "settings": {}}
    case = replace(
        first,
        controller=DOING_NOTHING,
        label=OWN_CONTROL if is_controlled else DOING_NOTHING,
        section=section,
        late="",
        bounds=first.shared_bounds,  # its own would be those of whichever controller comes first
    )
    if not case.continue_recording:
        case = without_experiment(case)
    digest = case.recording.digest if case.recording else None
    shared = _hash_of(case, _code_and_files(case) | {"recording": digest})
    seeds = [*dict.fromkeys(seed for series in driven for seed in series.seeds)]
    parameters = driven[0].parameters
    if any(series.parameters is not parameters for series in driven):
        parameters = {seed: series.parameters[seed] for series in driven[::-1] for seed in series.seeds}
    return _series(case, seeds, parameters, shared)


def without_experiment(case: Case) -> Case:
    """Return a case without an experiment and without logged data."""
    case = replace(case, excitation=None, recording=None, stabiliser=None)
    return replace(case, recorded_disturbances={}, recording_start=None)


def with_seed(case: Case, resolved: "ResolvedStudy", seed: int) -> Case:
    """Return a case of a study with another seed and the plant that it draws.

    A plant that is drawn as one of many is that of the study's own case, where the seed is one of its seeds.
    """
    seeds = resolved.study.seeds
    among = seeds if seed in seeds else [seed]
    parameters = _drawn(resolved, resolved.study.scenarios[case.scenario], among)[seed]
    return replace(case, seed=seed, parameters=parameters)


def _words(study: "Study", problem: str, controller: str, scenario: str) -> tuple[str, ...]:
    """Return names and labels by which a case can be selected."""
    words = (controller, study.controllers[controller].label, scenario, study.scenarios[scenario].label)
    return (*words, problem, study.title) if problem else words


def _code_and_files(case: Case) -> dict[str, Any]:
    """Return what decides the result of all cases of a controller besides its settings."""
    files = _files(case)
    decisive: dict[str, Any] = {
        "code": [code_version(kind) for kind in types_in(_sections(case))],
        "files": [[hash_of_file(path) for path in paths] for paths in files],
        "plants": [content_of_plant(name) for name in _plants(case) if name],
    }
    # Ids of other cases do not know of them.
    if stand_ins := [of_file for paths in files for path in paths if (of_file := stand_ins_of_file(path))]:
        decisive["stand_ins"] = stand_ins
    return decisive


def _sections(case: Case) -> list[dict[str, Any]]:
    return [case.section, *filter(None, (case.stabiliser, case.warm_up_controller))]


def _files(case: Case) -> list[list[str]]:
    """Return the files that the settings of a case's controllers name, without the plant's own."""
    named = [
        files_of(controller_class(section["type"]), section["settings"])
        for section in _sections(case)
        if section["type"]
    ]
    return [[path for path in paths if path != PLANT] for paths in named]


def _plants(case: Case) -> list[str]:
    """Return the plants that the settings of a case's controllers name; an empty one is the case's own."""
    return [
        name
        for section in _sections(case)
        if section["type"]
        for name in plants_of(controller_class(section["type"]), section["settings"])
    ]


def data_files(case: Case) -> list[str]:
    """Return the paths of the files that a case reads: FMUs and files that settings name."""
    return [path for paths in (case.plant.files, *_files(case), _forecast_files(case)) for path in paths]


def _forecast_files(case: Case) -> list[str]:
    return [known.forecast.file for known in case.disturbances.values() if known.forecast is not None]


def files_read(case: Case) -> list[Path]:
    """Return what a case reads besides what is installed: FMUs, files of settings, the study's modules."""
    return [Path(path) for path in (*data_files(case), *folders_of(plugins_in(case)))]


@dataclass(frozen=True, slots=True)
class CaseContext:
    """What a case finds around it where it is run.

    Parameters
    ----------
    modules : str
        The folder of the study's own modules.
    values : bytes
        What no other process can import, as :func:`ddpc_cosim.plugins.values_of` gives it, pickled.
    read : tuple of Path
        What it reads in a sandbox besides what is installed.
    """

    modules: str
    values: bytes
    read: tuple[Path, ...]

    @classmethod
    def of(cls, case: Case) -> Self:
        """Return the context of a case where its study has been read."""
        import cloudpickle  # a class that the worker cannot import goes along by value

        values = cloudpickle.dumps(values_of(plugins_in(case)))
        return cls(own_folder(), values, tuple(files_read(case)) if case.sandbox else ())


def plugins_in(case: Case) -> Iterator[str]:
    """Yield the names of the plug-ins that a case is made of."""
    yield from plants_in(case)
    yield from types_in(_sections(case))


def plants_in(case: Case) -> Iterator[str]:
    """Yield those of plants: of the case's own, and of those that its controllers look at."""
    yield from case.plant.plugins
    yield from filter(None, (name or case.plant.name for name in _plants(case)))


def leaves_nothing_behind(case: Case) -> bool:
    """Whether the process of a case is as good as new afterwards, unless something goes wrong.

    That is where it runs nothing that can crash, an FMU that was supplied, and no code of others, which may
    keep what it likes in its modules.
    """
    if case.plant.isolated or not all(
        is_own("controllers", name) for name in types_in(_sections(case)) if name
    ):
        return False
    return not any(_files(case)) and all(is_own("plants", name) for name in plants_in(case))


def _hash_of(case: Case, content: Mapping[str, Any]) -> "hashlib._Hash":
    """Return a hash of everything that decides a case's result, but for its seed and what that draws."""
    decisive = {case_field.name: getattr(case, case_field.name) for case_field in fields(case)}
    decisive |= {**content, "plant": case.plant.content}
    if versions := case.conditions.versions:  # each scenario has conditions of its own
        decisive["versions"] = versions
    drawn = names(case.spread)
    decisive["parameters"] = {name: v for name, v in case.parameters.items() if name not in drawn}
    signals = ("inputs", "outputs", "measurements", "undriven", "read", "spread")
    decisive |= {key: names(decisive[key]) for key in signals}
    decisive["warm_up"] = case.warm_up or None
    decisive["disturbances"] = {name: _by_content(known) for name, known in case.disturbances.items()}
    for key in (*_NOT_DECISIVE, *(key for key in _WHERE_SAID if decisive[key] in _NOTHING_SAID)):
        del decisive[key]
    return hashlib.sha256(json.dumps(decisive, sort_keys=True, default=repr).encode())


def _by_content(known: KnownDisturbance) -> KnownDisturbance:
    """Return a disturbance whose file of forecasts is called by a hash of its content."""
    if known.forecast is None:
        return known
    return replace(known, forecast=replace(known.forecast, file=hash_of_file(known.forecast.file)))


def series_of_problem(
    resolved: "ResolvedStudy",
    plant: PlantSpec,
    problem: str,
    seeds: Sequence[int],
    patterns: Sequence[str],
) -> Iterator[CaseSeries]:
    """Yield the cases that one of some patterns matches, by their name or what they are made of.

    Without patterns these are all. What those that differ by their seed alone have in common is made, and
    hashed, once.
    """
    study = resolved.study
    stabiliser = study.recording.controller if study.recording is not None else None
    events = {name: _events(scenario, study.loop.of(scenario)) for name, scenario in study.scenarios.items()}
    recording = {"recording": resolved.recording.digest if resolved.recording else None}
    warm_up = resolved.warm_up_controller
    warm_up_controller = None if warm_up is None else _type_and_settings(warm_up)
    run_seeds = list(seeds or study.seeds)
    plants = {name: _drawn(resolved, scenario, run_seeds) for name, scenario in study.scenarios.items()}
    for controller, section in study.controllers.items():
        content: dict[str, Any] = {}
        for name, scenario in study.scenarios.items():
            words = _words(study, problem, controller, name)
            # A label may have brackets, which mean something else in a pattern.
            matches = not patterns or any(
                pattern in words or any(fnmatch(word, pattern) for word in words) for pattern in patterns
            )
            case = Case(
                problem=problem,
                controller=controller,
                scenario=name,
                seed=0,
                label=section.label,
                section=_type_and_settings(section),
                plant=plant,
                inputs=resolved.inputs,
                outputs=resolved.outputs,
                measurements=resolved.measurements,
                sampling_time=study.loop.sampling_time,
                communication_step=study.loop.communication_step,
                duration=study.loop.duration,
                start_time=study.loop.of(scenario).start_time,
                continue_recording=study.loop.start == "recording-end",
                reference=resolved.reference,
                bounds=resolved.bounds[controller] | resolved.scenario_bounds[name],
                shared_bounds=resolved.shared_bounds | resolved.scenario_bounds[name],
                excitation=resolved.excitations[name],
                recording=resolved.recording,
                stabiliser=None if stabiliser is None else _type_and_settings(stabiliser),
                parameters=plants[name][run_seeds[0]],
                noise=dict(scenario.noise),
                events=events[name],
                preview=study.loop.preview_of(scenario),
                step_timeout=study.loop.step_timeout,
                case_timeout=study.loop.case_timeout,
                memory_limit=study.loop.memory_limit,
                engine=study.loop.engine,
                conditions=resolved.conditions[name],
                undriven=resolved.undriven[name],
                disturbances=resolved.disturbances[name],
                recorded_disturbances=resolved.recorded_disturbances,
                recording_start=_recording_start(study, scenario),
                prices=resolved.prices[name],
                monitors=resolved.monitors,
                read=resolved.read,
                forecast_horizon=resolved.forecast_horizon if study.disturbances else None,
                warm_up=study.loop.warm_up,
                warm_up_controller=warm_up_controller,
                metrics=resolved.metrics,
                late=resolved.late.get(controller, ""),
                spread=_spread(resolved, scenario),
            )
            chosen = [
                seed
                for seed in section.seeds_of(run_seeds)
                if matches or any(fnmatch(case.name_with(seed), pattern) for pattern in patterns)
            ]
            if not chosen:
                continue
            content = content or _code_and_files(case) | recording
            yield _series(case, chosen, plants[name], _hash_of(case, content))


def _spread(resolved: "ResolvedStudy", scenario: "ScenarioSection") -> tuple[Variable, ...]:
    """Return the parameters that seeds draw in a scenario."""
    said = {**resolved.study.plant.parameters, **scenario.parameters}
    return tuple(
        variable for variable in resolved.spread if isinstance(said.get(variable.name), Distribution)
    )


def _drawn(
    resolved: "ResolvedStudy", scenario: "ScenarioSection", seeds: Sequence[int]
) -> Mapping[int, dict[str, ParameterValue]]:
    """Return the plant parameters of a scenario by seed: all draw with the same numbers in every scenario."""
    plant = resolved.study.plant
    said: dict[str, Any] = {**plant.parameters, **scenario.parameters}
    if not resolved.spread:
        return dict.fromkeys(seeds, said)
    of_seeds = shares(names(resolved.spread), plant.sampling, tuple(seeds))
    columns = {
        variable.name: said[variable.name].quantile(of_seeds[:, column])
        for column, variable in enumerate(resolved.spread)
        if isinstance(said.get(variable.name), Distribution)
    }
    return _Drawn(seeds, said, columns)


def _recording_start(study: "Study", scenario: "ScenarioSection") -> float | None:
    """Return when the experiment of a scenario begins [s]; None where nothing says it."""
    recording = study.recording
    if recording is not None and scenario.recording is not None:
        recording = scenario.recording.of(recording)
    if recording is None:
        return None
    return recording.begins(study.loop.of(scenario), is_disturbed=bool(study.disturbances))


def _series(
    case: Case,
    seeds: Sequence[int],
    parameters: Mapping[int, dict[str, ParameterValue]],
    shared: "hashlib._Hash",
) -> CaseSeries:
    """Return the cases of some seeds, from a hash of what they have in common."""
    drawn, hashes = names(case.spread), list[str]()
    for seed in seeds:
        whole = shared.copy()
        whole.update(str(seed).encode())
        if drawn:  # ids of other cases do not know of it
            of_seed = parameters[seed]
            whole.update(repr([(name, of_seed[name]) for name in drawn]).encode())
        hashes.append(whole.hexdigest()[:_HASHED])
    return CaseSeries(case, seeds, parameters, _Ids(case, seeds, "".join(hashes)))


def _as_file_name(called: str) -> str:
    """Return a case's name; the beginning of one that is long, and a hash of all of it."""
    if len(called) <= _LONGEST_NAME:
        return called
    digest = hashlib.sha256(called.encode()).hexdigest()[:10]
    return f"{called[: _LONGEST_NAME - len(digest) - 1]}-{digest}"


def _type_and_settings(section: "ControllerSection | StabiliserSection") -> dict[str, Any]:
    return {"type": section.type, "settings": section.settings}


def _events(scenario: "ScenarioSection", loop: "LoopSection") -> tuple[ParameterChange, ...]:
    """Return the parameter changes of a scenario; a drift is a change at every sample."""
    changes = list(scenario.events)
    time = loop.start_time + np.arange(loop.steps + 1, dtype=np.float64) * loop.sampling_time
    early = EARLY * loop.sampling_time
    for drift in scenario.drifts:
        path = drift.path()
        moving = (time > drift.start_time - early) & (time < drift.stop_time + loop.sampling_time - early)
        changes += [
            ParameterChange(float(t), {drift.parameter: float(value)})
            for t, value in zip(time[moving], path.at(time[moving]), strict=True)
        ]
    return tuple(changes)
