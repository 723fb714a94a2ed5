"""The study file: its sections, keys and ranges. Read and checked by :mod:`ddpc_cosim.study.reading`."""

import math
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from ddpc_cosim.signals import Constant, Ramp, Reference, Sine, Steps

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=60)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Value = bool | int | Finite | str


_MOST_STEPS = 1e8
_MOST_VARIANTS = 1000


class Section(BaseModel):
    """A section of a study file: unknown keys are faults, values do not change after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    def contradictions(self) -> list[str]:
        """Return how the values here contradict each other, each of them being possible by itself."""
        return []


class PlantSection(Section):
    """Which plant, and which of its variables take part; exactly one of ``name`` and ``fmu``."""

    name: str = Field("", description="a plant of `ddpc-cosim list plants`, or module:PLANT")
    fmu: str = Field("", description="path of an FMU, relative to the study file")
    inputs: list[str] = Field([], description="inputs that the controller drives; empty: all")
    outputs: list[str] = Field([], description="controlled outputs; empty: all")
    measurements: list[str] = Field(
        [], description="what the controller may measure; empty: the controlled outputs"
    )
    parameters: dict[str, Value] = Field({}, description="parameters that differ from the plant's defaults")
    display_units: dict[str, str] = Field(
        {}, description="units to show variables in; empty: those of the plant's description"
    )
    nominal: dict[str, Positive] = Field(
        {},
        description="sizes that controllers scale variables by, in their units; empty: the plant's own",
    )
    fmi_type: Literal["auto", "co-simulation", "model-exchange"] = Field(
        "auto", description="how the FMU is run; auto: Co-Simulation if it has it"
    )
    isolated: Literal["auto"] | bool = Field(
        "auto", description="run the FMU in a process of its own; auto: if it is a supplied file"
    )
    step_timeout: Positive = Field(60.0, description="longest time for any call of an isolated FMU [s]")

    def contradictions(self) -> list[str]:
        """Return what is wrong with the choice of the plant."""
        return ["needs exactly one of the keys name and fmu"] if bool(self.name) == bool(self.fmu) else []


class LoopSection(Section):
    """Timing of the closed loop."""

    sampling_time: Positive = Field(description="time between samples [s]")
    duration: Positive = Field(description="simulated time of the closed loop [s]")
    start_time: Finite = Field(0.0, description="time of the first sample [s]")
    start: Literal["rest", "recording-end"] = Field(
        "rest", description="start from the plant's initial state, or where the recording ended"
    )

    def contradictions(self) -> list[str]:
        """Return why the duration is not made of samples."""
        steps = self.duration / self.sampling_time
        if not 0.5 < steps <= _MOST_STEPS:
            return [f"duration / sampling_time = {steps:g} samples; allowed: 1 to {_MOST_STEPS:.0e}"]
        if not math.isclose(steps, round(steps), rel_tol=1e-9):
            whole = f"a whole multiple of sampling_time ({self.sampling_time:g})"
            return [f"duration ({self.duration:g}) must be {whole}"]
        if (
            math.ulp(max(abs(self.start_time), abs(self.start_time + self.duration)))
            > 1e-3 * self.sampling_time
        ):
            where = f"start_time ({self.start_time:g}) is too large"
            return [f"{where}: samples {self.sampling_time:g} s apart coincide there"]
        return []

    @property
    def steps(self) -> int:
        """Number of sampling intervals."""
        return round(self.duration / self.sampling_time)


class _Signal(Section):
    unit: str = Field("", description="unit of the values here; empty: the variable's own")


class ConstantReference(_Signal):
    """One value for all time."""

    kind: Literal["constant"]
    value: Finite

    def build(self, convert: Any) -> Reference:
        """Return the signal in the variable's own unit."""
        return Constant(float(convert(self.value)))


class StepsReference(_Signal):
    """Piecewise constant."""

    kind: Literal["steps"]
    times: Annotated[list[Finite], Field(min_length=1)]
    values: Annotated[list[Finite], Field(min_length=1)]

    def contradictions(self) -> list[str]:
        """Return how times and values do not fit."""
        faults = []
        if len(self.times) != len(self.values):
            lengths = f"times ({len(self.times)}) and values ({len(self.values)})"
            faults.append(f"{lengths} need the same length")
        if any(later <= earlier for earlier, later in pairwise(self.times)):
            faults.append("times must increase")
        return faults

    def build(self, convert: Any) -> Reference:
        """Return the signal in the variable's own unit."""
        return Steps(tuple(self.times), tuple(float(convert(value)) for value in self.values))


class RampReference(_Signal):
    """Linear between two instants."""

    kind: Literal["ramp"]
    from_value: Finite
    to_value: Finite
    from_time: Finite
    to_time: Finite

    def contradictions(self) -> list[str]:
        """Return what is wrong with the order of the instants."""
        return ["to_time must be after from_time"] if self.to_time <= self.from_time else []

    def build(self, convert: Any) -> Reference:
        """Return the signal in the variable's own unit."""
        return Ramp(
            float(convert(self.from_value)), float(convert(self.to_value)), self.from_time, self.to_time
        )


class SineReference(_Signal):
    """A sine about an offset; frequency in Hz, phase in rad."""

    kind: Literal["sine"]
    amplitude: Finite
    frequency: Positive
    offset: Finite = 0.0
    phase: Finite = 0.0

    def build(self, convert: Any) -> Reference:
        """Return the signal in the variable's own unit."""
        offset = float(convert(self.offset))
        amplitude = float(convert(self.offset + self.amplitude)) - offset
        return Sine(amplitude, self.frequency, offset, self.phase)


ReferenceSection = Annotated[
    ConstantReference | StepsReference | RampReference | SineReference, Field(discriminator="kind")
]


class BoundsSection(Section):
    """Limits of one input or controlled output; a side left out is the plant's own."""

    min: Finite | None = None
    max: Finite | None = None
    unit: str = Field("", description="unit of min and max; empty: the variable's own")

    def contradictions(self) -> list[str]:
        """Return what is wrong with the order of the limits."""
        if self.min is None or self.max is None or self.min < self.max:
            return []
        return [f"min ({self.min:g}) must be below max ({self.max:g})"]


class ExcitationSection(Section):
    """Uniform random excitation of one input."""

    kind: Literal["uniform"] = "uniform"
    low: Finite
    high: Finite
    unit: str = Field("", description="unit of low and high; empty: the input's own")

    def contradictions(self) -> list[str]:
        """Return what is wrong with the order of the limits."""
        return [f"low ({self.low:g}) must be below high ({self.high:g})"] if self.low >= self.high else []


class StabiliserSection(Section):
    """The controller that keeps the plant while it is recorded; the excitation is added to its inputs."""

    type: str = Field(description="a controller of `ddpc-cosim list controllers`, or module:Class")
    settings: dict[str, Any] = Field({}, description="settings that differ from the controller's defaults")


class RecordingSection(Section):
    """The experiment that data-driven controllers learn from."""

    samples: Annotated[int, Field(ge=1)] = Field(description="number of samples T")
    excitation: dict[str, ExcitationSection] = Field(description="one for each input")
    controller: StabiliserSection | None = Field(
        None, description="stabilises the plant meanwhile, on the study's references; none: open loop"
    )


class EventSection(Section):
    """Tunable parameters that change during the run."""

    time: Finite
    parameters: dict[str, Value]


class DriftSection(Section):
    """A tunable parameter that moves linearly from one value to another, in steps of one sample."""

    parameter: str
    from_value: Finite
    to_value: Finite
    from_time: Finite
    to_time: Finite

    def contradictions(self) -> list[str]:
        """Return what is wrong with the order of the instants."""
        return ["to_time must be after from_time"] if self.to_time <= self.from_time else []


class ScenarioSection(Section):
    """One condition under which every controller is run."""

    label: str = ""
    parameters: dict[str, Value] = Field({}, description="plant parameters in this scenario")
    noise: dict[str, Annotated[float, Field(ge=0, allow_inf_nan=False)]] = Field(
        {}, description="standard deviation of the noise of each measurement, in its unit"
    )
    events: list[EventSection] = []
    drifts: list[DriftSection] = []


def _as_list(tables: Any) -> Any:
    return [tables] if isinstance(tables, dict) else tables


class ControllerSection(Section):
    """One competitor."""

    type: str = Field(description="a controller of `ddpc-cosim list controllers`, or module:Class")
    label: str = Field("", description="name in reports; empty: the key of the section")
    note: str = Field("", description="one line about this competitor for the report")
    settings: dict[str, Any] = Field({}, description="settings that differ from the controller's defaults")
    bounds: dict[str, BoundsSection] = Field(
        {}, description="limits that replace the study's for this controller"
    )
    sweep: Annotated[list[dict[str, list[Any]]], BeforeValidator(_as_list)] = Field(
        [], description="tables of settings and values to try; of each table, all combinations are run"
    )
    variant_of: str = Field("", description="the controller whose sweep this one is part of")
    varied: list[str] = Field([], description="settings in which it differs from that controller")

    def contradictions(self) -> list[str]:
        """Return what is wrong with the sweep."""
        faults = [
            f"sweep.{name}: no values" for table in self.sweep for name, values in table.items() if not values
        ]
        variants = sum(math.prod(map(len, table.values())) for table in self.sweep)
        if variants > _MOST_VARIANTS:
            faults.append(f"sweep: {variants} variants; allowed: {_MOST_VARIANTS}")
        return faults


class PublishedMethod(Section):
    """Published figures of one method, and the controllers here that stand for it."""

    label: str
    printed: str = Field(description="the controller that follows the publication")
    published_code: str = Field(
        "", description="the controller that follows the authors' program, if one does"
    )
    values: dict[str, Finite] = Field(description="published value of each metric, by its key")


class Reproduction(Section):
    """Published results that the report compares with."""

    source: str
    metrics: dict[str, str] = Field(description="title of each metric compared, by its key")
    methods: list[PublishedMethod]
    notes: list[str] = []
    parameters: str = Field("Parameters as run", description="title over the tables of settings")


class Panel(Section):
    """One panel of the report's figures."""

    title: str
    controllers: list[str]


class ReportSection(Section):
    """What the report shows beside what every report shows."""

    panels: list[Panel] = Field([], description="panels of the figures; empty: one with all controllers")
    limitations: list[str] = Field([], description="what a reader must know to judge the figures fairly")
    reproduction: Reproduction | None = None


def expand_seeds(seeds: Any) -> Any:
    """Return a list of seeds in which ranges such as ``"0:30"`` are written out, without repetitions."""
    listed: list[Any] = []
    for seed in seeds if isinstance(seeds, list) else [seeds]:
        if isinstance(seed, str) and seed.count(":") == 1:
            first, last = seed.split(":")
            if not (
                first.isdecimal() and last.isdecimal() and int(first) < int(last) <= int(first) + 1_000_000
            ):
                raise ValueError(
                    f"{seed!r} is not a range; write it as first:last with first < last, e.g. 0:30"
                )
            listed.extend(range(int(first), int(last)))
        elif isinstance(seed, str) and seed.isdecimal():
            listed.append(int(seed))
        else:
            listed.append(seed)
    return list(dict.fromkeys(listed)) if all(type(seed) is int for seed in listed) else listed


Seeds = Annotated[list[Annotated[int, Field(ge=0, lt=2**32)]], BeforeValidator(expand_seeds)]


class Study(Section):
    """A study file: one plant, competitors, conditions and seeds."""

    name: Name = Field("study", description="short name; the folder of results is called after it")
    title: str = ""
    summary: str = ""
    source: str = Field("", description="publication that the study follows")
    seeds: Annotated[Seeds, Field(min_length=1)] = [0]
    plant: PlantSection
    loop: LoopSection
    reference: Annotated[dict[str, ReferenceSection], Field(min_length=1)]
    bounds: dict[str, BoundsSection] = {}
    recording: RecordingSection | None = None
    controllers: Annotated[dict[Name, ControllerSection], Field(min_length=1)]
    scenarios: Annotated[dict[Name, ScenarioSection], Field(min_length=1)] = {"nominal": ScenarioSection()}
    report: ReportSection = ReportSection()
