"""The study file: its sections, keys and ranges. Read by :mod:`ddpc_cosim.study.reading`."""

import itertools
import math
import reprlib
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, Field, create_model

from ddpc_cosim.coupling.wiring import Connection
from ddpc_cosim.csv_files import TIME_TOLERANCE
from ddpc_cosim.loop_setup import MOST_STEPS, end_time, limits_error, whole_steps
from ddpc_cosim.plugins import shown_name
from ddpc_cosim.safe_calls import DEFAULT_STEP_TIMEOUT
from ddpc_cosim.settings import Choice, Factor, Integer, Linear, Log, Search
from ddpc_cosim.study.case_files import DOING_NOTHING
from ddpc_cosim.study.file_format.signal_sections import (
    DisturbanceSection,
    ExcitationSection,
    Finite,
    InputSection,
    LinearSection,
    NotNegative,
    Positive,
    ReferenceSection,
    faults_of,
)
from ddpc_cosim.study.file_format.sweeps import MOST_VARIANTS, count, sweep_errors, swept_values
from ddpc_cosim.study.file_format.validation_errors import FilePath, PlantName, Section
from ddpc_cosim.texts import printable


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


Text = Annotated[str, AfterValidator(partial(printable, keep="\n"))]
"""What people read: nothing in it acts on a terminal or a page."""
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=60)]
ControllerName = Annotated[Name, AfterValidator(not_reserved)]
PartName = Annotated[str, AfterValidator(_without_dots)]
FMIKind = Literal["auto", "co-simulation", "model-exchange"]
Preview = Annotated[int, Field(ge=0)] | Literal["horizon"]
Value = bool | int | Finite | str


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


Seeds = Annotated[list[int], BeforeValidator(expand_seeds)]


class PartSection(Section):
    """One part of a coupled plant; of an SSP archive, what differs for it."""

    name: PartName = Field(description="its name; its signals are called NAME.variable")
    plant: PlantName = Field(
        "", description="a plant of `ddpc-cosim list plants`, module:PLANT or file.py:PLANT"
    )
    fmu: FilePath = Field("", description="path of an FMU, relative to the study file")
    parameters: dict[str, Value] = Field({}, description="parameters that differ from its defaults")
    start: dict[str, Finite] = Field({}, description="start values of its inputs; empty: its own")
    step: Positive | None = Field(
        None, description="its own step, which divides the communication step [s]; none: that step"
    )
    fmi_type: FMIKind = Field("auto", description="how the FMU is run; auto: Co-Simulation if it has it")
    isolated: bool = Field(False, description="run the FMU in a process of its own")

    @property
    def label(self) -> str:
        """What it is: a plug-in's name, or a file's."""
        return shown_name(self.plant) or Path(self.fmu).name


# "from" is a word of Python, which no class can spell.
_FROM: Any = {
    "from": (str, Field(description="an output, PART.variable, or an input of the system as a whole"))
}
_From: Any = create_model("_From", __base__=Section, **_FROM)


class ConnectionSection(_From):
    """A signal that follows another one, in the unit that it has there."""

    to: str = Field(description="an input, PART.variable, or an output of the system as a whole")
    factor: Finite = Field(1.0, description="applied after the conversion of the unit")
    offset: Finite = Field(0.0, description="added then, in the unit there")
    convert_units: bool = Field(True, description="convert units, and require that they fit")

    @property
    def connection(self) -> Connection:
        """The connection."""
        ends = getattr(self, "from"), self.to
        return Connection(*ends, self.factor, self.offset, self.convert_units)


class CouplingSection(Section):
    """How and when parts exchange their signals."""

    algorithm: Literal["sequential", "parallel"] = Field(
        "sequential",
        description="parallel: all parts step on what was known; sequential: on what those before them gave",
    )
    communication_step: Positive | None = Field(
        None, description="time between exchanges, which divides the sampling time [s]; none: that time"
    )
    extrapolation: Literal["hold", "linear"] = Field(
        "hold", description="inputs from other parts during a step"
    )
    loop_tolerance: Positive | None = Field(
        None, description="tolerance of algebraic loops, relative to nominal values"
    )
    error_tolerance: Positive | None = Field(
        None,
        description="error that a sample may add, for which steps are repeated; none: they are not",
    )

    @property
    def options(self) -> dict[str, Any]:
        """What differs from the defaults of a coupled plant."""
        return self.model_dump(exclude_defaults=True)


class PlantSection(Section):
    """Which plant, and which of its variables take part; one of ``name``, ``fmu``, ``ssp`` and ``parts``."""

    name: PlantName = Field(
        "", description="a plant of `ddpc-cosim list plants`, module:PLANT or file.py:PLANT"
    )
    fmu: str = Field("", description="path of an FMU, relative to the study file")
    ssp: FilePath = Field("", description="path of an SSP archive, relative to the study file")
    parts: list[PartSection] = Field([], description="the parts of a coupled plant")
    connections: list[ConnectionSection] = Field([], description="what the parts exchange")
    coupling: CouplingSection | None = Field(None, description="how the parts are coupled")
    inputs: list[str] = Field([], description="inputs that the controller drives; empty: all")
    outputs: list[str] = Field([], description="controlled outputs; empty: all")
    measurements: list[str] = Field(
        [], description="what the controller may measure; empty: the controlled outputs"
    )
    parameters: dict[str, Value] = Field({}, description="parameters that differ from the plant's defaults")
    start: dict[str, Finite] = Field(
        {},
        description="values that inputs start from and rest at, in their units; empty: the plant's own",
    )
    display_units: dict[str, str] = Field(
        {}, description="units to show variables in; empty: those of the plant's description"
    )
    nominal: dict[str, Positive] = Field(
        {},
        description="nominal values, which controllers scale by, in the variables' units; empty: the plant's",
    )
    fmi_type: FMIKind = Field("auto", description="how the FMU is run; auto: Co-Simulation if it has it")
    isolated: Literal["auto", True, False] = Field(
        "auto", description="run each case in a process of its own; auto: if the FMU is a supplied file"
    )
    moved: ClassVar[Mapping[str, str]] = {"step_timeout": "loop.step_timeout"}

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong with the choice of the plant."""
        given = [key for key in ("name", "fmu", "ssp") if getattr(self, key)]
        if self.parts and given != ["ssp"]:
            given.append("parts")
        if len(given) != 1:
            yield "", "needs exactly one of the keys name, fmu, ssp and parts"
        is_coupled = bool(self.parts or self.ssp)
        if self.connections and (self.ssp or not self.parts):
            yield "connections", "must not be given: the SSP has them" if self.ssp else "needs parts"
        if self.coupling is not None and not is_coupled:
            yield "coupling", "needs parts or ssp"
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
            or " + ".join(one.name for one in self.parts)
        )


class LoopSection(Section):
    """Timing of the closed loop."""

    sampling_time: Positive = Field(description="time between samples [s]")
    duration: Positive = Field(description="simulated time of the closed loop [s]")
    start_time: Finite = Field(0.0, description="time of the first sample [s]")
    start: Literal["rest", "recording-end"] = Field(
        "rest", description="start from the plant's initial state, or where the recording ended"
    )
    step_timeout: Positive = Field(
        DEFAULT_STEP_TIMEOUT, description="longest time for any call of the plant or of a controller [s]"
    )
    case_timeout: Positive | None = Field(None, description="longest time for a whole case [s]; none: any")
    memory_limit: Positive | None = Field(
        None, description="memory that a case may have [GB]; none: its share of the machine's (Linux)"
    )
    preview: Preview = Field(
        "horizon",
        description="future references that any controller may see; horizon: as many as it asks for",
    )

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield why the run is not made of samples."""
        yield from faults_of(self._check)

    def _check(self) -> None:
        end_time(self.start_time, whole_steps(self.duration, self.sampling_time), self.sampling_time)

    @property
    def steps(self) -> int:
        """Number of sampling intervals."""
        return round(self.duration / self.sampling_time)

    @property
    def end(self) -> float:
        """Time of the last sample [s]."""
        return self.start_time + self.steps * self.sampling_time

    def preview_of(self, scenario: "ScenarioSection") -> int | None:
        """Return how many future references anyone may see in a scenario; None: as many as are asked for."""
        preview = self.preview if scenario.preview is None else scenario.preview
        return None if preview == "horizon" else preview


class BoundsSection(Section):
    """Limits of one input or controlled output; one left out is the plant's, an infinite one is none."""

    min: float | None = Field(None, description="lower limit; -inf: none, though the plant has one")
    max: float | None = Field(None, description="upper limit; inf: none, though the plant has one")
    unit: str = Field("", description="unit of min and max; empty: the variable's own")

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong with the order of the limits."""
        low, high = -math.inf if self.min is None else self.min, math.inf if self.max is None else self.max
        if error := limits_error((low, high)):
            yield "", error


class StabiliserSection(Section):
    """The controller that keeps the plant while it is recorded; the excitation is added to its inputs."""

    type: str = Field(description="a controller of `ddpc-cosim list controllers`, or module:Class")
    settings: dict[str, Any] = Field({}, description="settings that differ from the controller's defaults")


def _one_or_more(value: Any) -> Any:
    return value if isinstance(value, list) else [value]


class RecordingSection(Section):
    """What data-driven controllers learn from: an experiment on the plant, or files of logged data."""

    samples: Annotated[int, Field(ge=1, le=MOST_STEPS)] | None = Field(
        None, description="number of samples T of the experiment"
    )
    excitation: dict[str, ExcitationSection] = Field({}, description="one for each input")
    inputs: dict[str, InputSection] = Field(
        {},
        description="signals of inputs that no controller drives, in place of a scenario's: what acted while "
        "data were recorded",
    )
    controller: StabiliserSection | None = Field(
        None, description="stabilises the plant meanwhile, on the study's references; none: open loop"
    )
    file: Annotated[list[FilePath], BeforeValidator(_one_or_more)] = Field(
        [], description="CSV files of logged data, in place of an experiment; one or several"
    )
    columns: dict[str, str] = Field(
        {}, description="headers of the columns in the files that are not called as their signals"
    )
    time_column: str = Field("time", description="header of the time in the files; empty: they have none")
    time_tolerance: Annotated[float, Field(ge=0, lt=0.5)] = Field(
        TIME_TOLERANCE, description="how far rows may be from one sampling time apart, in parts of it"
    )

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is missing of an experiment, or does not go with files."""
        experiment = ("samples", "excitation", "inputs", "controller")
        if self.file:
            for key in (key for key in experiment if getattr(self, key)):
                yield key, "belongs to an experiment, and file to logged data; needed: one of them"
        else:
            if self.samples is None:
                yield "samples", "required key is missing; or give the key file, for logged data"
            if self.columns:
                yield "columns", "names columns of the key file, which is missing"


class EventSection(Section):
    """Tunable parameters that change during the run."""

    time: Finite
    parameters: dict[str, Value]


class DriftSection(LinearSection):
    """A tunable parameter that moves linearly from one value to another, in steps of one sample."""

    parameter: str


def _as_list(tables: Any) -> Any:
    return [tables] if isinstance(tables, dict) else tables


class RecordingChanges(Section):
    """In what a scenario's experiment differs from the study's."""

    samples: Annotated[int, Field(ge=1, le=MOST_STEPS)] | None = Field(
        None, description="number of samples T"
    )
    excitation: dict[str, ExcitationSection] = Field({}, description="of inputs that are excited otherwise")
    inputs: dict[str, InputSection] = Field(
        {}, description="signals of inputs that no controller drives, in place of the recording's"
    )

    def of(self, recording: RecordingSection) -> RecordingSection:
        """Return the study's section with the changes."""
        changes = {
            "samples": recording.samples if self.samples is None else self.samples,
            "excitation": recording.excitation | self.excitation,
            "inputs": recording.inputs | self.inputs,
        }
        return recording.model_copy(update=changes)


class ScenarioSection(Section):
    """What every controller is run under: see :mod:`ddpc_cosim.conditions` for the order of effects."""

    label: Text = ""
    parameters: dict[str, Value] = Field({}, description="plant parameters in this scenario")
    noise: dict[str, NotNegative] = Field(
        {}, description="standard deviation of the noise of each measurement, in its unit"
    )
    events: list[EventSection] = Field([])
    drifts: list[DriftSection] = Field([])
    disturbances: dict[
        str, Annotated[list[DisturbanceSection], BeforeValidator(_as_list), Field(min_length=1)]
    ] = Field({}, description="what is added to each input or output: a signal, or several that are added up")
    inputs: dict[str, InputSection] = Field({}, description="signals of inputs that no controller drives")
    bounds: dict[str, BoundsSection] = Field(
        {}, description="limits in place of the study's, and of those that a controller has of its own"
    )
    rate_limit: dict[str, Positive] = Field(
        {}, description="largest rate of change of each input, in its unit per second"
    )
    delay: dict[str, NotNegative] = Field(
        {}, description="by how much an input acts, or a measurement arrives, late [s]"
    )
    quantum: dict[str, Positive] = Field(
        {}, description="what each measurement is rounded to whole multiples of, in its unit"
    )
    loss: dict[str, Annotated[float, Field(ge=0, le=1)]] = Field(
        {}, description="probability that a measurement is lost at a sample"
    )
    preview: Preview | None = Field(None, description="in place of the loop's")
    recording: RecordingChanges | None = Field(
        None, description="`samples`, `excitation` and `inputs` in place of the recording's"
    )


Weights = dict[str, Annotated[float, Field(ge=0, allow_inf_nan=False)]]


class CostSection(Section):
    """The study's own quadratic cost: the sum over the samples of weighted squares, in the signals' units."""

    outputs: Weights = Field({}, description="weights of (reference - output)^2, by controlled output")
    inputs: Weights = Field({}, description="weights of (input - its value at rest)^2, by input")
    changes: Weights = Field({}, description="weights of (change of the input from the sample before)^2")

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong where nothing is weighted."""
        weights = (*self.outputs.values(), *self.inputs.values(), *self.changes.values())
        if not self._errors and not any(weights):
            yield "", "needs a weight above 0 in outputs, inputs or changes"


class RelevantSection(Section):
    """The smallest difference that matters, of what is ranked by; of both keys the larger counts."""

    absolute: NotNegative | dict[str, NotNegative] | None = Field(
        None, description="in the unit that tables show it in; of several controlled outputs one for each"
    )
    percent: Annotated[float, Field(ge=0, le=100)] | None = Field(
        None, description="of the best figure or of the task, the larger; none: 1, and 0 beside `absolute`"
    )

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield that nothing is said."""
        if self.absolute is None and self.percent is None and not self._errors:
            yield "", "needs absolute or percent"


class MetricsSection(Section):
    """What runs are judged by besides the metrics that every study has, and what difference matters."""

    cost: CostSection | None = None
    relevant: RelevantSection | None = None


class TunedSection(Section):
    """How settings of a controller were found, which the report states: by trials, or a source alone."""

    settings: Annotated[list[str], Field(min_length=1)] | None = Field(
        None, description="names of the settings that were found so; dotted where a setting is a table"
    )
    trials: Annotated[int, Field(ge=1)] | None = Field(None, description="number of settings tried")
    seeds: Annotated[Seeds, Field(min_length=1)] | None = Field(
        None, description="seeds of the trials; none of them may be a seed of the study"
    )
    by: str | None = Field(None, description="what was compared, e.g. median rmse over the scenarios")
    source: Text = Field(
        "", description="where the trials can be repeated from; alone: where the settings are, e.g. a table"
    )
    sampler_seed: Annotated[int, Field(ge=0)] = Field(
        0, description="seed of the search, which decides what is tried"
    )
    at_ends: list[str] = Field(
        [],
        description="settings found at an end of where was looked: a wider search may find others",
    )

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is missing."""
        of_trials = {key: getattr(self, key) for key in ("settings", "trials", "seeds", "by")}
        missing = [key for key, value in of_trials.items() if value is None]
        if len(missing) < len(of_trials):
            yield from ((key, "required key is missing") for key in missing)
        elif not self.source:
            yield "source", f"required key is missing; or give {', '.join(missing)}"


_Ends = Annotated[list[Finite], Field(min_length=2, max_length=2)]


class SearchSection(Section):
    """Where ``ddpc-cosim tune`` looks for a value of a setting; exactly one key."""

    linear: _Ends | None = Field(None, description="lowest and highest number")
    log: _Ends | None = Field(None, description="the same, each power of ten as likely as the next")
    factor: _Ends | None = Field(None, description="the same, of what the setting's value is multiplied by")
    integer: Annotated[list[int], Field(min_length=2, max_length=2)] | None = Field(
        None, description="lowest and highest integer"
    )
    choices: list[Any] | None = Field(None, description="values; empty, or `false` for the table: it is kept")

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong with the range."""
        given = [key for key in type(self).model_fields if getattr(self, key) is not None]
        if len(given) != 1 and not self._errors:
            yield "", "needs exactly one of the keys linear, log, factor, integer and choices"
        elif given:
            yield from ((given[0], fault) for _, fault in faults_of(lambda: self.space))

    @property
    def space(self) -> Search | None:
        """The search space; None if the setting is kept."""
        ranges = {Linear: self.linear, Log: self.log, Factor: self.factor, Integer: self.integer}
        for kind, ends in ranges.items():
            if ends is not None:
                return kind(*ends)
        return Choice(self.choices) if self.choices else None


def _none_for_false(table: Any) -> Any:
    return {"choices": []} if table is False else table


def _none_if_false(table: Any) -> Any:
    return None if table is False else table


class ControllerSection(Section):
    """One controller of the study."""

    type: str = Field(description="a controller of `ddpc-cosim list controllers`, or module:Class")
    label: Text = Field("", description="name in reports; empty: the key of the section")
    note: Text = Field("", description="one line about this controller for the report")
    settings: dict[str, Any] = Field({}, description="settings that differ from the controller's defaults")
    bounds: dict[str, BoundsSection] = Field(
        {}, description="limits that replace the study's for this controller"
    )
    sweep: Annotated[
        list[dict[str, Annotated[Any, BeforeValidator(swept_values)]]], BeforeValidator(_as_list)
    ] = Field([], description="tables of settings and values to try; of each table, all combinations are run")
    search: dict[str, Annotated[SearchSection, BeforeValidator(_none_for_false)]] = Field(
        {},
        description="for `ddpc-cosim tune`: where to look for settings, in place of what the type declares",
    )
    first_trials: list[dict[str, Any]] = Field(
        [], description="for `ddpc-cosim tune`: settings that are tried next after those given"
    )
    tuned: Annotated[TunedSection | None, BeforeValidator(_none_if_false)] = Field(
        None, description="how settings were found; none, or `false`: that is not known"
    )
    variant_of: str = Field("", description="the controller whose sweep this one is part of")
    varied: list[str] = Field([], description="settings in which it differs from that controller")

    @classmethod
    def _hint(cls, key: str) -> str:
        return f"{super()._hint(key)}; if it is a setting of the controller, write settings.{key}"

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong with the sweep."""
        for table in self.sweep:
            yield from (("sweep", f"{key}: {fault}" if key else fault) for key, fault in sweep_errors(table))
        if (variants := count(self.sweep)) > MOST_VARIANTS:
            yield "sweep", f"{variants} variants; allowed: {MOST_VARIANTS}"


class PublishedMethod(Section):
    """Published results of one method, and the controllers here that stand for it."""

    label: Text
    printed: str = Field(description="the controller that follows the publication")
    published_code: str = Field(
        "", description="the controller that follows the authors' program, if one does"
    )
    values: dict[str, Finite] = Field(description="published value of each metric, by its key")
    rest_samples: Annotated[int, Field(ge=0)] = Field(
        0, description="samples at rest that the published sums of errors count before the first decision"
    )


class Reproduction(Section):
    """Published results that the report compares with."""

    source: Text
    metrics: dict[str, str] = Field(description="title of each metric compared, by its key")
    methods: list[PublishedMethod]
    notes: list[str] = Field([])
    parameters: str = Field("Parameters as run", description="title over the tables of settings")


class Panel(Section):
    """One panel of the report's figures."""

    title: Text
    controllers: list[str]


class ReferencePoints(Section):
    """Two controllers that do not compete: every error is shown as a share of the way between theirs."""

    zero: str = Field(description="the controller at 0 %, e.g. one that does nothing")
    full: str = Field(description="the controller at 100 %, e.g. one that shows what is possible")

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong where both are one."""
        if self.zero == self.full:
            yield "full", f'"{self.full}" is also at 0 %; needed: two different controllers'


class ClaimSection(Section):
    """What the study's source claims of a metric; the report says in how many runs it is so."""

    text: Annotated[Text, Field(min_length=1)] = Field(description="the claim, in a sentence")
    metric: str = Field(description="a metric and its signal, such as rms_change.torque")
    lowest: str = Field("", description="the controller that is claimed to have the lowest value of all")
    highest: str = Field("", description="the controller that is claimed to have the highest value of all")
    order: list[str] = Field([], description="controllers, from the lowest value that is claimed on")
    alike: str = Field("", description="a controller whose sweep is claimed to change nothing")
    within: NotNegative = Field(
        10.0, description="how far apart values that are alike may be, in % of the lowest"
    )

    def cross_field_errors(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong where not exactly one thing is claimed."""
        kinds = ("lowest", "highest", "order", "alike")
        given = [kind for kind in kinds if getattr(self, kind)]
        if len(given) != 1:
            what = f"{' and '.join(given)} are given" if given else "nothing is claimed"
            yield "", f"{what}; needed: one of {', '.join(kinds)}"
        if len(self.order) == 1:
            yield "order", "one controller is in no order; needed: two or more"


class ReportSection(Section):
    """What the report shows besides what every report shows."""

    panels: list[Panel] = Field([], description="panels of the figures; empty: one with all controllers")
    limitations: list[str] = Field([], description="what a reader must know to judge the results fairly")
    claims: list[ClaimSection] = Field([], description="what the source claims, checked run by run")
    reproduction: Reproduction | None = None
    reference_points: ReferencePoints | None = Field(
        None, description="controllers at 0 % and at 100 % of a scale; they are shown, and not ranked"
    )


class StudyHead(Section):
    """What a study says of itself, however many problems it has."""

    moved: ClassVar[Mapping[str, str]] = {"extend": "extends"}
    name: Name = Field("study", description="short name; the folder of results is called after it")
    title: Text = ""
    summary: Text = ""
    source: Text = Field("", description="publication that the study follows")
    based_on: list[str] = Field(
        [], description="names of the studies that it extends, where it is written out"
    )
    seeds: Annotated[Seeds, Field(min_length=1)] = Field([0])


class Study(StudyHead):
    """A study of one problem, as a flat file says it: one plant, controllers, conditions and seeds.

    Of a file with several problems each is such a study, which has the problem's name.
    """

    variant_of: str = Field("", description="the problem whose variant this one is by the study's sweep")
    varied: dict[str, Any] = Field({}, description="what differs from that problem, by its path")
    plant: PlantSection
    loop: LoopSection
    reference: Annotated[dict[str, ReferenceSection], Field(min_length=1)]
    bounds: dict[str, BoundsSection] = Field({})
    recording: RecordingSection | None = None
    controllers: Annotated[dict[ControllerName, ControllerSection], Field(min_length=1)]
    scenarios: dict[Name, ScenarioSection] = Field({"nominal": ScenarioSection()}, min_length=1)
    metrics: MetricsSection = MetricsSection()
    report: ReportSection = ReportSection()
