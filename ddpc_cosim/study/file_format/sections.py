"""The study file: its sections, keys and ranges. Read by :mod:`ddpc_cosim.study.reading`."""

import itertools
import math
import re
import reprlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from ddpc_cosim.codec import (
    ChangeName,
    DeclaredField,
    Kinds,
    Prepared,
    Rule,
    Section,
    Size,
    declared_fields,
    differing,
    shown,
)
from ddpc_cosim.conditions import all_conditions
from ddpc_cosim.coupling.wiring import Connection
from ddpc_cosim.distributions import ParameterDistribution, Sampling
from ddpc_cosim.errors import ConfigError, CosimError
from ddpc_cosim.files.durations import MOMENT_SCHEMA, in_words, moment_of
from ddpc_cosim.files.logs import LogFormat
from ddpc_cosim.files.texts import printable
from ddpc_cosim.identification.identification import Identification, identification_table
from ddpc_cosim.loop.safe_calls import DEFAULT_STEP_TIMEOUT
from ddpc_cosim.loop.setup import (
    MOST_STEPS,
    EngineName,
    communication_steps,
    end_time,
    limits_error,
    whole_steps,
)
from ddpc_cosim.metrics import Ranking
from ddpc_cosim.plugins import shown_name
from ddpc_cosim.settings import (
    Choice,
    Factor,
    Integer,
    Linear,
    Log,
    Search,
    SettingInfo,
    map_files,
    map_plants,
    setting,
)
from ddpc_cosim.signals.disturbances import Knowledge, KnownDisturbance
from ddpc_cosim.signals.excitations import InputExcitation
from ddpc_cosim.signals.prices import Price
from ddpc_cosim.signals.signals import (
    REFERENCES,
    Band,
    Drift,
    InputSignal,
    ParameterChange,
    Reference,
    ReferenceSignal,
)
from ddpc_cosim.study.case_files import DOING_NOTHING
from ddpc_cosim.study.controller_plugins import controller_class
from ddpc_cosim.study.file_format.replacing import PROBLEMS
from ddpc_cosim.study.file_format.requirements import RequirementsSection
from ddpc_cosim.study.file_format.sweeps import MOST_VARIANTS, count, sweep_errors, swept_values
from fmu_plants.spelling import did_you_mean


def faults_of(rule: Callable[[], object]) -> Iterator[tuple[str, str]]:
    """Yield what a rule of the loop says about values."""
    try:
        rule()
    except ConfigError as error:
        yield from (("", fault) for fault in error.faults)


def _without_dots(name: str) -> str:
    if not name or "." in name:
        raise ValueError(f'must be a name without dots, as signals are NAME.variable, got "{name}"')
    return name


def not_reserved(name: str) -> str:
    """Return the name of a controller; ValueError if it is that of the runs that the tool makes itself."""
    if name == DOING_NOTHING:
        raise ValueError(
            f'"{name}" is what the runs with inputs at rest are called, by which all runs are judged; '
            "give another name"
        )
    return name


def _name(text: str) -> str:
    if not re.fullmatch(_NAME, text):
        rule = "letters, digits, dots, hyphens and underscores, the first one a letter or digit"
        raise ValueError(f"must be {rule}, got {shown(text)}")
    if len(text) > _LONGEST_NAME:
        raise ValueError(f"must have at most {_LONGEST_NAME} characters, got {shown(text)}")
    return text


_NAME, _LONGEST_NAME = "[A-Za-z0-9][A-Za-z0-9._-]*", 60
Text = Annotated[str, Rule(partial(printable, keep="\n"))]
"""What people read: nothing in it acts on a terminal or a page."""
Name = Annotated[str, Rule(_name, {"pattern": f"^{_NAME}$", "maxLength": _LONGEST_NAME})]
ControllerName = Annotated[Name, Rule(not_reserved)]
PartName = Annotated[str, Rule(_without_dots, {"pattern": r"^[^.]+$"})]
FMIKind = Literal["auto", "co-simulation", "model-exchange"]
Preview = int | Literal["horizon"]
Value = bool | int | float | str
Moment = Annotated[float, Prepared(moment_of, MOMENT_SCHEMA)]
"""A time of the run, or a date or a day, which count from the start of their year."""


_SEEDS = 2**32
_MOST_SEEDS = 1_000_000
_LONGEST_SEED = 40


def expand_seeds(seeds: Any) -> list[int]:
    """Return a list of seeds in which ranges such as ``"0:30"`` are written out, without repetitions.

    Raises
    ------
    ValueError
        Something is neither a seed nor a range, or there are too many.
    """
    ranges, wrong = list[range](), []
    for seed in seeds if isinstance(seeds, list) else [seeds]:
        first, colon, last = seed.partition(":") if isinstance(seed, str) else ("", "", "")
        if type(seed) is int:
            ranges.append(range(seed, seed + 1))
        elif first.isdecimal() and (last.isdecimal() or not colon) and len(seed) <= _LONGEST_SEED:
            ranges.append(range(int(first), int(last) if colon else int(first) + 1))
        else:
            ranges.append(range(0))
        if not (0 <= ranges[-1].start < ranges[-1].stop <= _SEEDS):
            wrong.append(reprlib.repr(seed))
    if wrong:
        raise ValueError(
            f"{', '.join(wrong)} {'is not a seed' if len(wrong) == 1 else 'are not seeds'}; "
            f"allowed: integers from 0 to {_SEEDS - 1}, or ranges as first:last with first < last, e.g. 0:30"
        )
    if (total := sum(map(len, ranges))) > _MOST_SEEDS:
        raise ValueError(f"{total} seeds are too many; allowed: up to {_MOST_SEEDS}")
    return list(dict.fromkeys(itertools.chain(*ranges)))


_SEED = {"anyOf": [{"type": "integer", "minimum": 0}, {"type": "string", "pattern": r"^\d+(:\d+)?$"}]}
_LIST_OF_SEEDS = {"type": "array", "items": _SEED, "minItems": 1}
Seeds = Annotated[
    list[int], Prepared(expand_seeds, {"if": {"type": "array"}, "then": _LIST_OF_SEEDS, "else": _SEED})
]


@dataclass(frozen=True, slots=True, kw_only=True)
class PartSection(Section):
    """One part of a coupled plant; of an SSP archive, what differs for it."""

    name: PartName = setting(doc="its name; its signals are called NAME.variable")
    plant: str = setting(
        "", doc="a plant of `ddpc-cosim list plants`, module:PLANT or file.py:PLANT", plant=True
    )
    fmu: str = setting("", doc="path of an FMU, relative to the study file", file=True)
    parameters: dict[str, Value] = setting({}, doc="parameters that differ from its defaults")
    start: dict[str, float] = setting({}, doc="start values of its inputs; empty: its own")
    step: float | None = setting(
        None, doc="its own step, which divides the communication step; none: that step", unit="s", above=0
    )
    fmi_type: FMIKind = setting("auto", doc="how the FMU is run; auto: Co-Simulation if it has it")
    isolated: bool = setting(False, doc="run the FMU in a process of its own")

    @property
    def label(self) -> str:
        """What it is: a plug-in's name, or a file's."""
        return shown_name(self.plant) or Path(self.fmu).name


@dataclass(frozen=True, slots=True, kw_only=True)
class CouplingSection(Section):
    """How and when parts exchange their signals."""

    algorithm: Literal["sequential", "parallel", "monolithic"] = setting(
        "sequential",
        doc="parallel: all parts step on what was known; sequential: on what those before them gave; "
        "monolithic: FMUs that are all for Model Exchange are one differential equation",
    )
    communication_step: float | None = setting(
        None, doc="time between exchanges, which divides the sampling time; none: that", unit="s", above=0
    )
    extrapolation: Literal["hold", "linear"] = setting("hold", doc="inputs from other parts during a step")
    loop_tolerance: float | None = setting(
        None, doc="tolerance of algebraic loops, relative to nominal values", above=0
    )
    error_tolerance: float | None = setting(
        None,
        doc="error that a sample may add, for which steps are repeated; none: they are not; monolithic: "
        "tolerance of the integration, none: 1e-10",
        above=0,
    )

    @property
    def options(self) -> dict[str, Any]:
        """What differs from the defaults of a coupled plant."""
        return differing(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantSection(Section):
    """Which plant, and which of its variables take part; one of the keys that say what it is."""

    name: str = setting(
        "", doc="a plant of `ddpc-cosim list plants`, module:PLANT or file.py:PLANT", plant=True
    )
    fmu: str = setting("", doc="path of an FMU, relative to the study file", file=True)
    ssp: str = setting("", doc="path of an SSP archive, relative to the study file", file=True)
    identified: Annotated[
        Identification | None, Prepared(identification_table, {"type": ["string", "array"]})
    ] = setting(None, doc="logs that the plant is identified from: paths, or a table", file=True)
    parts: list[PartSection] = setting([], doc="the parts of a coupled plant")
    connections: list[Connection] = setting([], doc="what the parts exchange")
    coupling: CouplingSection | None = setting(None, doc="how the parts are coupled")
    inputs: list[str] = setting(
        [], doc="inputs that the controller drives; empty: all but the known disturbances"
    )
    outputs: list[str] = setting([], doc="controlled outputs; empty: all")
    measurements: list[str] = setting(
        [], doc="what the controller may measure; empty: the controlled outputs"
    )
    parameters: dict[str, Value | ParameterDistribution] = setting(
        {}, doc="parameters that differ from the plant's defaults; of a distribution each seed draws its own"
    )
    sampling: Sampling = setting(
        "independent",
        doc="how seeds draw parameters: each for itself; one in each n-th part of a distribution of n seeds; "
        "or the point of the Sobol sequence that has the seed as its number",
    )
    start: dict[str, float] = setting(
        {}, doc="values that inputs start from and rest at, in their units; empty: the plant's own"
    )
    switches: dict[str, str] = setting(
        {},
        doc="for inputs that override the plant's own control, the input that switches the override on; an "
        "empty one: none; left out: NAME_activate of NAME_u, where the plant's description says so",
    )
    display_units: dict[str, str] = setting(
        {}, doc="units to show variables in; empty: those of the plant's description"
    )
    nominal: dict[str, float] = setting(
        {},
        doc="nominal values, which controllers scale by, in the variables' units; empty: the plant's",
        above=0,
    )
    fmi_type: FMIKind = setting("auto", doc="how the FMU is run; auto: Co-Simulation if it has it")
    isolated: Literal["auto", True, False] = setting(
        "auto", doc="run each case in a process of its own; auto: if the FMU is a supplied file"
    )
    library_path: list[str] = setting(
        [],
        doc="libraries that are loaded before the FMU's, and folders that have those which it needs, on "
        "Linux; relative to the study file",
        file=True,
    )
    moved: ClassVar[Mapping[str, str]] = {"step_timeout": "loop.step_timeout"}

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong with the choice of the plant."""
        given = [key for key in ("name", "fmu", "ssp", "identified") if getattr(self, key)]
        if self.parts and given != ["ssp"]:
            given.append("parts")
        if len(given) != 1:
            yield "", "needs exactly one of the keys name, fmu, ssp, parts and identified"
        is_coupled = bool(self.parts or self.ssp)
        if self.connections and (self.ssp or not self.parts):
            yield "connections", "must not be given: the SSP has them" if self.ssp else "needs parts"
        if self.coupling is not None and not is_coupled:
            yield "coupling", "needs parts or ssp"
        if self.library_path and not (is_coupled or self.fmu):
            yield "library_path", "needs an FMU"
        if is_coupled and self.fmi_type != "auto":
            yield "fmi_type", "must be said for each part"
        names = [part.name for part in self.parts]
        for i, part in enumerate(self.parts):
            if part.name in names[:i]:
                yield "parts", f'there are two parts "{part.name}"'
            if bool(part.fmu) + bool(part.plant) != (0 if self.ssp else 1):
                needed = (
                    "the SSP says what it is" if self.ssp else "needs exactly one of the keys fmu and plant"
                )
                yield "parts", f'"{part.name}": {needed}'

    @property
    def label(self) -> str:
        """What it is called: a plug-in's name, a file's, or those of the parts."""
        return (
            shown_name(self.name)
            or Path(self.fmu or self.ssp).name
            or ", ".join(Path(path).name for path in (self.identified.file if self.identified else ()))
            or " + ".join(part.name for part in self.parts)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class StabiliserSection(Section):
    """A controller that keeps the plant while it is recorded or warms up, of which no result is reported."""

    type: str = setting(doc="a controller of `ddpc-cosim list controllers`, or module:Class")
    settings: dict[str, Any] = setting({}, doc="settings that differ from the controller's defaults")

    @classmethod
    def with_names(cls, table: dict[str, Any], change: ChangeName) -> dict[str, Any]:
        """Return it with the names of files and plants changed that its settings are."""
        return _with_names_in_settings(table, change)


def _with_names_in_settings(section: dict[str, Any], change: ChangeName, kind: Any = None) -> dict[str, Any]:
    """Return a controller's table, and what differs in problems, with the names in its settings changed."""
    kind = section.get("type", kind)

    def of_settings(settings: Any) -> Any:
        if isinstance(settings, list):
            return [of_settings(table) for table in settings]
        with suppress(TypeError, AttributeError, CosimError):  # its own check says what is wrong
            chosen = controller_class(kind)
            settings = map_files(chosen, settings, partial(change, SettingInfo("", file=True)))
            return map_plants(chosen, settings, partial(change, SettingInfo("", plant=True)))
        return settings

    tables = section | {key: of_settings(section[key]) for key in _OF_SETTINGS & section.keys()}
    if isinstance(problems := tables.get(PROBLEMS), dict):
        tables[PROBLEMS] = {
            name: _with_names_in_settings(changes, change, kind) if isinstance(changes, dict) else changes
            for name, changes in problems.items()
        }
    return tables


_OF_SETTINGS = {"settings", "sweep", "first_trials"}


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopSection(Section):
    """Timing of the closed loop."""

    sampling_time: float = setting(doc="time between samples", unit="s", above=0)
    duration: float = setting(doc="simulated time of the closed loop", unit="s", above=0)
    communication_step: float | None = setting(
        None,
        doc="how far the plant is advanced at once, for what is paid and key figures; none: sampling_time",
        unit="s",
        above=0,
    )
    start_time: Moment = setting(
        0.0, doc='time of the first sample; also a date or "day 23", counted from 1 January', unit="s"
    )
    start: Literal["rest", "recording-end"] = setting(
        "rest", doc="start from the plant's initial state, or where the recording ended"
    )
    warm_up: float = setting(
        0.0, doc="how long the plant runs before the first sample, which is not judged", unit="s", low=0
    )
    warm_up_controller: StabiliserSection | None = setting(
        None, doc="controls it meanwhile; none: the plant's own control, or inputs at rest"
    )
    step_timeout: float = setting(
        DEFAULT_STEP_TIMEOUT,
        doc="longest time for any call of the plant or of a controller",
        unit="s",
        above=0,
    )
    case_timeout: float | None = setting(
        None, doc="longest time for a whole case; none: any", unit="s", above=0
    )
    memory_limit: float | None = setting(
        None, doc="memory that a case may have [GB]; none: its share of the machine's (Linux)", above=0
    )
    preview: Preview = setting(
        "horizon", low=0, doc="future references that any controller may see; horizon: as many as it asks for"
    )
    engine: EngineName = setting(
        "python", doc="what computes the samples; compiled: C code where there is some, with the same figures"
    )

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield why the run is not made of samples."""
        yield from faults_of(self._check)
        warm_up, duration = self.warm_up, self.duration
        if warm_up > duration:
            longer = f"{in_words(warm_up)} is longer than the run of {in_words(duration)}"
            yield "warm_up", f"{longer}; choose a shorter one, or a longer duration"
        elif abs(round(warm_up / self.sampling_time) * self.sampling_time - warm_up) > 1e-9 * duration:
            multiple = f"an integer multiple of the sampling time, {in_words(self.sampling_time)}"
            yield "warm_up", f"{in_words(warm_up)} must be {multiple}"
        if warm_up and self.start == "recording-end":
            yield "warm_up", 'start = "recording-end" goes on from the recording; leave one of them out'
        if self.warm_up_controller is not None and not warm_up:
            yield "warm_up_controller", "needs warm_up, the time for which it controls"

    def _check(self) -> None:
        communication_steps(self.sampling_time, self.communication_step)
        end_time(self.start_time, whole_steps(self.duration, self.sampling_time), self.sampling_time)

    @property
    def steps(self) -> int:
        """Number of sampling intervals."""
        return round(self.duration / self.sampling_time)

    @property
    def end(self) -> float:
        """Time of the last sample [s]."""
        return self.start_time + self.steps * self.sampling_time

    def of(self, scenario: "ScenarioSection") -> Self:
        """Return the timing in a scenario, which may begin at another time."""
        return self if scenario.start_time is None else replace(self, start_time=scenario.start_time)

    def preview_of(self, scenario: "ScenarioSection") -> int | None:
        """Return how many future references anyone may see in a scenario; None: as many as are asked for."""
        preview = self.preview if scenario.preview is None else scenario.preview
        return None if preview == "horizon" else preview


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundsSection(Section):
    """Limits of one input or controlled output; one left out is the plant's, an infinite one is none."""

    min: float | ReferenceSignal | None = setting(
        None, infinite=True, doc="lower limit, a number or a signal; -inf: none, though the plant has one"
    )
    max: float | ReferenceSignal | None = setting(
        None, infinite=True, doc="upper limit, a number or a signal; inf: none, though the plant has one"
    )
    unit: str = setting("", doc="unit of min and max; empty: the variable's own")

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong with the order of limits that are numbers."""
        low, high = -math.inf if self.min is None else self.min, math.inf if self.max is None else self.max
        if not (isinstance(low, Reference) or isinstance(high, Reference)):
            yield from (("", error) for error in filter(None, [limits_error((low, high))]))


@dataclass(frozen=True, slots=True, kw_only=True)
class BandSection(Section):
    """Between what a controlled output is wanted, in place of a reference."""

    band: Band = setting(doc="its edges")
    unit: str = setting("", doc="unit of edges that have none of their own; empty: the variable's")


Wanted = Annotated[Any, Kinds(REFERENCES, marked={"band": BandSection})]
"""What is wanted of an output: a reference, or a band."""


def _one_or_more(value: Any) -> Any:
    return value if isinstance(value, list) else [value]


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingSection(LogFormat):
    """What data-driven controllers learn from: an experiment on the plant, or files of logged data."""

    samples: int | None = setting(None, low=1, high=MOST_STEPS, doc="number of samples T of the experiment")
    excitation: dict[str, InputExcitation] = setting({}, doc="one for each input")
    inputs: dict[str, InputSignal] = setting(
        {},
        doc="signals of inputs that no controller drives, in place of a scenario's: what acted while "
        "data were recorded",
    )
    disturbances: dict[str, InputSignal] = setting(
        {}, doc="known disturbances during the experiment, in place of their own course"
    )
    start_time: Moment | None = setting(
        None,
        doc="time of its first sample, which signals go by; also a date or a day; none: with known "
        "disturbances the experiment ends where the loop begins, else 0",
        unit="s",
    )
    controller: StabiliserSection | None = setting(
        None, doc="stabilises the plant meanwhile, on the study's references; none: open loop"
    )
    file: Annotated[list[str], Prepared(_one_or_more, {"type": "string"})] = setting(
        [], doc="CSV files of logged data, in place of an experiment; one or several", file=True
    )
    columns: dict[str, str] = setting(
        {}, doc="headers of the columns in the files that are not called as their signals"
    )
    excitation_columns: list[str] = setting(
        [],
        doc="headers of columns of what moved the inputs from outside while a controller ran: what was added "
        'to them, or its setpoints; for `instruments = "excitation"`',
    )

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is missing of an experiment, or does not go with files."""
        experiment = ("samples", "excitation", "inputs", "disturbances", "start_time", "controller")
        if self.file:
            for key in (key for key in experiment if getattr(self, key) not in (None, {})):
                yield key, "belongs to an experiment, and file to logged data; needed: one of them"
        else:
            if self.samples is None:
                yield "samples", "required key is missing; or give the key file, for logged data"
            for key in (key for key in ("columns", "excitation_columns") if getattr(self, key)):
                yield key, "names columns of the key file, which is missing"
            for key in differing(self).keys() & declared_fields(LogFormat).keys():
                yield key, "says how the files of the key file are read, which is missing"

    @property
    def format(self) -> dict[str, Any]:
        """How the files are read, by the keys that say it."""
        return {key: getattr(self, key) for key in declared_fields(LogFormat)}

    def begins(self, loop: LoopSection, *, is_disturbed: bool) -> float | None:
        """Return the time of the experiment's first sample [s]; None: 0, or there is no experiment.

        ``is_disturbed``: by known disturbances, whose data end where the loop begins unless one says more.
        """
        if self.start_time is not None or self.samples is None or not is_disturbed:
            return self.start_time
        return loop.start_time - self.samples * loop.sampling_time


def _as_list(tables: Any) -> Any:
    return [tables] if isinstance(tables, dict) else tables


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingChanges(Section):
    """In what a scenario's experiment differs from the study's."""

    samples: int | None = setting(None, low=1, high=MOST_STEPS, doc="number of samples T")
    excitation: dict[str, InputExcitation] = setting({}, doc="of inputs that are excited otherwise")
    inputs: dict[str, InputSignal] = setting(
        {}, doc="signals of inputs that no controller drives, in place of the recording's"
    )

    def of(self, recording: RecordingSection) -> RecordingSection:
        """Return the study's section with the changes."""
        changes: dict[str, Any] = {
            "samples": recording.samples if self.samples is None else self.samples,
            "excitation": recording.excitation | self.excitation,
            "inputs": recording.inputs | self.inputs,
        }
        return replace(recording, **changes)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenarioSection(Section):
    """What every controller is run under; without any there is one, ``nominal``, with nothing in it."""

    label: Text = setting("", doc="name in reports; empty: the key of the section")
    parameters: dict[str, Value | ParameterDistribution] = setting(
        {}, doc="plant parameters in this scenario, in place of those of the plant"
    )
    noise: dict[str, float] = setting(
        {}, doc="standard deviation of the noise of each measurement, in its unit", low=0
    )
    events: list[ParameterChange] = setting([], doc="tunable parameters that change during the run")
    drifts: list[Drift] = setting([], doc="tunable parameters that move linearly, in steps of one sample")
    disturbances: dict[str, Annotated[list[InputSignal], Prepared(_as_list, {"type": "object"}), Size(1)]] = (
        setting({}, doc="what is added to each input or output: a signal, or several that are added up")
    )
    inputs: dict[str, InputSignal] = setting({}, doc="signals of inputs that no controller drives")
    known: dict[str, Knowledge] = setting(
        {}, doc="what is known of disturbances, in place of what the study says of them"
    )
    prices: dict[str, float | ReferenceSignal] = setting(
        {}, doc="prices in place of the study's, in its unit"
    )
    bounds: dict[str, BoundsSection] = setting(
        {}, doc="limits in place of the study's, and of those that a controller has of its own"
    )
    effects: dict[str, dict[str, float]] = setting(
        {}, doc="what actuators and sensors do: a table of each kind that is installed", key=None
    )
    preview: Preview | None = setting(None, low=0, doc="in place of the loop's")
    start_time: Moment | None = setting(
        None, doc="time of the first sample, in place of the loop's; also a date or a day", unit="s"
    )
    recording: RecordingChanges | None = setting(
        None, doc="`samples`, `excitation` and `inputs` in place of the recording's"
    )

    @classmethod
    def more_fields(cls) -> Mapping[str, DeclaredField]:
        """Return a field for each kind of condition that is installed."""
        hint = dict[str, float]
        return {
            name: DeclaredField(name, hint, kind.value, False, dict, within="effects")
            for name, kind in all_conditions().items()
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class CostSection(Section):
    """The study's own quadratic cost: the sum over the samples of weighted squares, in the signals' units."""

    outputs: dict[str, float] = setting(
        {}, low=0, doc="weights of (reference - output)^2, by controlled output"
    )
    inputs: dict[str, float] = setting({}, low=0, doc="weights of (input - its value at rest)^2, by input")
    changes: dict[str, float] = setting(
        {}, low=0, doc="weights of (change of the input from the sample before)^2"
    )

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong where nothing is weighted."""
        weights = (*self.outputs.values(), *self.inputs.values(), *self.changes.values())
        if not self.has_faults and not any(weights):
            yield "", "needs a weight above 0 in outputs, inputs or changes"


@dataclass(frozen=True, slots=True, kw_only=True)
class RelevantSection(Section):
    """The smallest difference that matters, of what is ranked by; of both keys the larger counts."""

    absolute: float | dict[str, float] | None = setting(
        None, doc="in the unit that tables show it in; of several controlled outputs one for each", low=0
    )
    percent: float | None = setting(
        None,
        doc="of the best figure or of the task, the larger; none: 1, and 0 beside `absolute`",
        low=0,
        high=100,
    )

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield that nothing is said."""
        if self.absolute is None and self.percent is None and not self.has_faults:
            yield "", "needs absolute or percent"


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyFiguresSection(Section):
    """A set of key figures of a building, and what they are of; its name alone: `"boptest"`."""

    set: Literal["boptest"] = setting(doc="by whose definitions")
    area: float | None = setting(None, doc="floor area; none: what the plant says", unit="m2", above=0)
    sources: dict[str, list[str]] = setting(
        {},
        doc='outputs, or inputs, of each source: `ElectricPower`, `"AirZoneTemperature[1]"`; none: what the '
        "plant says",
    )
    bands: dict[str, BandSection] = setting(
        {}, doc="bands of zones' outputs that are not controlled, or are wanted on a reference"
    )


def _set_of(value: Any) -> Any:
    return {"set": value} if isinstance(value, str) else value


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricsSection(Section):
    """What runs are judged by besides the metrics that every study has, and what difference matters."""

    cost: CostSection | None = setting(None, doc="a quadratic cost, which controllers are ranked by")
    relevant: RelevantSection | None = setting(None, doc="the smallest difference that matters; none: 1 %")
    ranking: Ranking | None = setting(
        None,
        doc="what controllers are ranked by: errors or the cost, money, or money and discomfort both; none: "
        "the last where there are prices, else the first",
    )
    key_figures: Annotated[KeyFiguresSection | None, Prepared(_set_of, {"const": "boptest"})] = setting(
        None, doc="a set of key figures of a building, by name or with what it is of; none: no such figures"
    )

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield that there are two things to rank by."""
        if self.cost is not None and self.ranking in ("money", "pareto"):
            yield "ranking", f'"{self.ranking}" and cost both rank; leave one of them out'


@dataclass(frozen=True, slots=True, kw_only=True)
class TunedSection(Section):
    """How settings of a controller were found, which the report states: by trials, or a source alone."""

    settings: Annotated[list[str], Size(1)] | None = setting(
        None, doc="names of the settings that were found so; dotted where a setting is a table"
    )
    trials: int | None = setting(None, low=1, doc="number of settings tried")
    seeds: Annotated[Seeds, Size(1)] | None = setting(
        None, doc="seeds of the trials; none of them may be a seed of the study"
    )
    by: str | None = setting(None, doc="what was compared, e.g. median rmse over the scenarios")
    source: Text = setting(
        "", doc="where the trials can be repeated from; alone: where the settings are, e.g. a table"
    )
    sampler_seed: int = setting(0, low=0, doc="seed of the search, which decides what is tried")
    at_ends: list[str] = setting(
        [], doc="settings found at an end of where was looked: a wider search may find others"
    )

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is missing."""
        of_trials = {key: getattr(self, key) for key in ("settings", "trials", "seeds", "by")}
        missing = [key for key, value in of_trials.items() if value is None]
        if len(missing) < len(of_trials):
            yield from ((key, "required key is missing") for key in missing)
        elif not self.source:
            yield "source", f"required key is missing; or give {', '.join(missing)}"


_Ends = Annotated[list[float], Size(2, 2)]


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchSection(Section):
    """Where ``ddpc-cosim tune`` looks for a value of a setting; exactly one key."""

    linear: _Ends | None = setting(None, doc="lowest and highest number")
    log: _Ends | None = setting(None, doc="the same, each power of ten as likely as the next")
    factor: _Ends | None = setting(None, doc="the same, of what the setting's value is multiplied by")
    integer: Annotated[list[int], Size(2, 2)] | None = setting(None, doc="lowest and highest integer")
    choices: list[Any] | None = setting(None, doc="values; empty, or `false` for the table: it is kept")

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong with the range."""
        given = [key for key in declared_fields(type(self)) if getattr(self, key) is not None]
        if len(given) != 1 and not self.has_faults:
            yield "", "needs exactly one of the keys linear, log, factor, integer and choices"
        elif given:
            yield from ((given[0], fault) for _, fault in faults_of(lambda: self.space))

    @property
    def space(self) -> Search | None:
        """The search space; None if the setting is kept."""
        for key, kind in _RANGES.items():
            if (ends := getattr(self, key)) is not None:
                space: Linear = kind(*ends)
                return space
        return Choice(self.choices) if self.choices else None


_RANGES: dict[str, type[Any]] = {"linear": Linear, "log": Log, "factor": Factor, "integer": Integer}


def search_table(space: Search) -> dict[str, Any]:
    """Return a search space as the table of a :class:`SearchSection`."""
    if isinstance(space, Choice):
        return {"choices": list(space.values)}
    key = next(key for key, kind in _RANGES.items() if type(space) is kind)
    return {key: [space.low, space.high]}


def _none_for_false(table: Any) -> Any:
    return {"choices": []} if table is False else table


def _none_if_false(table: Any) -> Any:
    return None if table is False else table


@dataclass(frozen=True, slots=True, kw_only=True)
class ControllerSection(Section):
    """One controller of the study."""

    type: str = setting(doc="a controller of `ddpc-cosim list controllers`, or module:Class")
    label: Text = setting("", doc="name in reports; empty: the key of the section")
    note: Text = setting("", doc="one line about this controller for the report")
    settings: dict[str, Any] = setting({}, doc="settings that differ from the controller's defaults")
    bounds: dict[str, BoundsSection] = setting({}, doc="limits that replace the study's for this controller")
    sweep: Annotated[
        list[dict[str, Annotated[Any, Prepared(swept_values)]]], Prepared(_as_list, {"type": "object"})
    ] = setting([], doc="tables of settings and values to try; of each table, all combinations are run")
    search: dict[str, Annotated[SearchSection, Prepared(_none_for_false, {"const": False})]] = setting(
        {}, doc="for `ddpc-cosim tune`: where to look for settings, in place of what the type declares"
    )
    first_trials: list[dict[str, Any]] = setting(
        [], doc="for `ddpc-cosim tune`: settings that are tried next after those given"
    )
    tuned: Annotated[TunedSection | None, Prepared(_none_if_false, {"const": False})] = setting(
        None, doc="how settings were found; none, or `false`: that is not known"
    )
    seeds: Literal["all", "first"] = setting(
        "all",
        doc="first: the first of the study's seeds alone, as a reference point may that takes long; runs "
        "with all seeds are set beside that run",
    )
    variant_of: str = setting("", doc="the controller whose sweep this one is part of")
    varied: list[str] = setting([], doc="settings in which it differs from that controller")

    def seeds_of(self, seeds: Sequence[int]) -> list[int]:
        """Return the seeds that it is run with where these are asked for."""
        return list(seeds[: 1 if self.seeds == "first" else None])

    @classmethod
    def with_names(cls, table: dict[str, Any], change: ChangeName) -> dict[str, Any]:
        """Return it with the names of files and plants changed that its settings are."""
        return _with_names_in_settings(table, change)

    @classmethod
    def hint(cls, key: str) -> str:
        """Return what an unknown key probably stands for."""
        meant = did_you_mean(key, declared_fields(cls))
        return f"{meant}; if it is a setting of the controller, write settings.{key}"

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong with the sweep."""
        for table in self.sweep:
            yield from (("sweep", f"{key}: {fault}" if key else fault) for key, fault in sweep_errors(table))
        if (variants := count(self.sweep)) > MOST_VARIANTS:
            yield "sweep", f"{variants} variants; allowed: {MOST_VARIANTS}"


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedMethod(Section):
    """Published results of one method, and the controllers here that stand for it."""

    label: Text = setting(doc="name of the method")
    printed: str = setting(doc="the controller that follows the publication")
    published_code: str = setting("", doc="the controller that follows the authors' program, if one does")
    values: dict[str, float] = setting(doc="published value of each metric, by its key")
    rest_samples: int = setting(
        0, low=0, doc="samples at rest that the published sums of errors count before the first decision"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Reproduction(Section):
    """Published results that the report compares with."""

    source: Text = setting(doc="the publication")
    metrics: dict[str, str] = setting(doc="title of each metric compared, by its key")
    methods: list[PublishedMethod] = setting(doc="the methods that it compares")
    notes: list[str] = setting([], doc="what a reader of the comparison must know")
    parameters: str = setting("Parameters as run", doc="title over the tables of settings")


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel(Section):
    """One panel of the report's figures."""

    title: Text = setting(doc="title of the panel")
    controllers: list[str] = setting(doc="controllers in it")


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferencePoints(Section):
    """Two controllers that do not compete: every error is shown as a share of the way between theirs."""

    zero: str = setting(doc="the controller at 0 %, e.g. one that does nothing")
    full: str = setting(doc="the controller at 100 %, e.g. one that shows what is possible")

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong where both are one."""
        if self.zero == self.full:
            yield "full", f'"{self.full}" is also at 0 %; needed: two different controllers'


@dataclass(frozen=True, slots=True, kw_only=True)
class ClaimSection(Section):
    """What the study's source claims of a metric; the report says in how many runs it is so."""

    text: Annotated[Text, Size(1)] = setting(doc="the claim, in a sentence")
    metric: str = setting(doc="a metric and its signal, such as rms_change.torque")
    lowest: str = setting("", doc="the controller that is claimed to have the lowest value of all")
    highest: str = setting("", doc="the controller that is claimed to have the highest value of all")
    order: list[str] = setting([], doc="controllers, from the lowest value that is claimed on")
    alike: str = setting("", doc="a controller whose sweep is claimed to change nothing")
    within: float = setting(10.0, doc="how far apart values that are alike may be, in % of the lowest", low=0)

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong where not exactly one thing is claimed."""
        kinds = ("lowest", "highest", "order", "alike")
        given = [kind for kind in kinds if getattr(self, kind)]
        if len(given) != 1:
            what = f"{' and '.join(given)} are given" if given else "nothing is claimed"
            yield "", f"{what}; needed: one of {', '.join(kinds)}"
        if len(self.order) == 1:
            yield "order", "one controller is in no order; needed: two or more"


LOGOS = {".svg": "image/svg+xml", ".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}
"""What a logo may be, by the end of its file's name, and what a page calls it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportSection(Section):
    """What the report shows besides what every report shows."""

    panels: list[Panel] = setting([], doc="panels of the figures; empty: one with all controllers")
    limitations: list[str] = setting([], doc="what a reader must know to judge the results fairly")
    scenario: str = setting(
        "",
        doc="the scenario shown first; empty: that in which the most runs fail, or errors are largest",
    )
    claims: list[ClaimSection] = setting([], doc="what the source claims, checked run by run")
    baseline: str | None = setting(
        None, doc="the controller that others are told against, e.g. the one in use today; none: none"
    )
    reproduction: Reproduction | None = setting(None, doc="published results to compare with")
    reference_points: ReferencePoints | None = setting(
        None, doc="controllers at 0 % and at 100 % of a scale; they are shown, and not ranked"
    )
    author: Text = setting("", doc="who made the study")
    comment: Text = setting("", doc="what the author says of the results, in a few sentences")
    logo: str = setting("", doc="picture at the head of the page: SVG, PNG or JPEG, up to 300 kB", file=True)

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong with the logo's name."""
        if self.logo and Path(self.logo).suffix.lower() not in LOGOS:
            yield "logo", f'"{Path(self.logo).name}" must end in {", ".join(LOGOS)}'


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyHead(Section):
    """What a study says of itself, however many problems it has."""

    moved: ClassVar[Mapping[str, str]] = {"extend": "extends"}
    name: Name = setting("study", doc="short name; the folder of results is called after it")
    title: Text = setting("", doc="title of the report")
    summary: Text = setting("", doc="what the study is about, in a few sentences")
    source: Text = setting("", doc="publication that the study follows")
    based_on: list[str] = setting([], doc="names of the studies that it extends, where it is written out")
    seeds: Annotated[Seeds, Size(1)] = setting(
        [0], doc='each case is run with each of them; ranges as "0:30"'
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Study(StudyHead):
    """A study of one problem, as a flat file says it: one plant, controllers, conditions and seeds.

    Of a file with several problems each is such a study, which has the problem's name.
    """

    variant_of: str = setting("", doc="the problem whose variant this one is by the study's sweep")
    varied: dict[str, Any] = setting({}, doc="what differs from that problem, by its path")
    plant: PlantSection = setting(doc="what is controlled")
    loop: LoopSection = setting(doc="timing of the closed loop")
    reference: Annotated[dict[str, Wanted], Size(1)] | None = setting(
        None, doc='one signal or band for each controlled output; none where only type = "plant" competes'
    )
    bounds: dict[str, BoundsSection] = setting(
        {}, doc="limits of inputs and controlled outputs in place of the plant's"
    )
    disturbances: dict[str, KnownDisturbance] = setting(
        {}, doc="what acts on the plant and is known: inputs that no controller drives, or outputs"
    )
    prices: dict[str, Price] = setting({}, doc="what signals cost")
    recording: RecordingSection | None = setting(None, doc="what data-driven controllers learn from")
    controllers: Annotated[dict[ControllerName, ControllerSection], Size(1)] = setting(doc="what is compared")
    scenarios: Annotated[dict[Name, ScenarioSection], Size(1)] = setting(
        {"nominal": ScenarioSection()}, doc="what all controllers are run under"
    )
    metrics: MetricsSection = setting(
        MetricsSection(), doc="what runs are judged by besides the metrics of every study"
    )
    requirements: RequirementsSection | None = setting(
        None, doc="what controllers have to be; it decides no result"
    )
    report: ReportSection = setting(ReportSection(), doc="what the report shows besides")

    @property
    def loops(self) -> list[LoopSection]:
        """The timing of all scenarios, each that differs once."""
        return [*{loop.start_time: loop for loop in map(self.loop.of, self.scenarios.values())}.values()]

    @property
    def span(self) -> tuple[float, float]:
        """When the first run of any scenario begins, warm-up included, and when the last one ends [s]."""
        loops = self.loops
        return min(loop.start_time for loop in loops) - self.loop.warm_up, max(loop.end for loop in loops)
