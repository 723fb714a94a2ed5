"""What a simulation is asked for: checked, all faults at once, and completed by defaults."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np

from ddpc_cosim.codec import read
from ddpc_cosim.conditions import Conditions
from ddpc_cosim.description import DefaultExperiment, PlantDescription, choose_signals
from ddpc_cosim.errors import ConfigError, DataError
from ddpc_cosim.files.csv_files import Column, CSVFile, plain_cells, read_table, split_unit
from ddpc_cosim.files.durations import shown
from ddpc_cosim.fmu.library import platform_folders
from ddpc_cosim.loop.master import Resumption
from ddpc_cosim.loop.safe_calls import DEFAULT_STEP_TIMEOUT
from ddpc_cosim.loop.setup import end_time, whole_steps
from ddpc_cosim.plant import FMIType, ParameterValue
from ddpc_cosim.signals.signals import Interpolated, Steps, values_at
from ddpc_cosim.simulation.golden import TIME, Golden
from ddpc_cosim.simulation.state_file import PlantState
from ddpc_cosim.study.cases import Case
from ddpc_cosim.study.file_format.sections import PlantSection
from ddpc_cosim.study.plants import PlantSpec
from ddpc_cosim.variables import FloatArray, Variable, converter
from fmu_plants.spelling import did_you_mean

_INTERVALS, _DURATION, _MOST_SAMPLES = 500, 10.0, 1_000_000
_MOST_LOCALS = 50
_ROUNDING = 1e-9
_INTEGER = re.compile(r"\s*[+-]?\d{1,30}\s*")
# A number, and a unit behind it, in brackets or not.
_QUANTITY = re.compile(r"\s*(?P<number>[^\s\[]+)\s*(?P<bracket>\[)?(?P<unit>.*?)(?(bracket)\])\s*")


class SimulationRequest(NamedTuple):
    """What is asked for; parameters as of :func:`simulate`, inputs and golden file read but not looked at."""

    plant: str
    inputs: CSVFile | None = None
    values: Mapping[str, ParameterValue] = {}
    start: float | None = None
    stop: float | None = None
    step: float | None = None
    outputs: Sequence[str] | None = None
    fmi_type: FMIType = "auto"
    library_path: Sequence[str] = ()
    step_timeout: float = DEFAULT_STEP_TIMEOUT
    trace_calls: str = ""
    golden: CSVFile | None = None
    resumed: PlantState | None = None
    keeps_state: bool = False
    coupling: Mapping[str, Any] = {}


class Prepared(NamedTuple):
    """What is going to run: checked, with everything chosen; ``content`` decides the plant's behaviour."""

    label: str
    case: Case
    driven: Mapping[str, Steps]
    notes: tuple[str, ...]
    golden: Golden | None
    content: str
    platform: str
    resumed: PlantState | None = None


class _Faults(list[str]):
    """Faults of a request, collected so that all are reported at once."""

    def collect(self, check: Callable[..., Any], *arguments: Any) -> Any:
        """Return the result of a check; None where it finds faults, which are collected."""
        try:
            return check(*arguments)
        except (ConfigError, DataError) as error:
            self.extend(error.faults)


class _Subject:
    """A plant to simulate: what can be driven, set and recorded."""

    def __init__(self, label: str, spec: PlantSpec, description: PlantDescription) -> None:
        self.label, self.spec, self.description = label, spec, description

    def holds(self, name: str) -> bool:
        """Whether an input changes only at rows of a file: all but continuous real ones."""
        signal = self.description.signal(name)
        return self.is_whole(name) or (signal is not None and signal.source.variability != "continuous")

    def is_whole(self, name: str) -> bool:
        """Whether the values of an input are integers."""
        signal = self.description.signal(name)
        return signal is not None and signal.source.values != "real"

    def readable(
        self, wanted: Sequence[str] | None, golden: CSVFile | None
    ) -> tuple[list[Variable], list[str]]:
        """Return the recorded variables, and remarks on the choice.

        Raises
        ------
        ConfigError
            There are no such variables; all of them at once.
        """
        known = self.description.outputs
        unknown = [name for name in wanted or () if name not in known]
        if unknown:
            raise ConfigError([f'no output "{name}"; {did_you_mean(name, known)}' for name in unknown])
        usual = self.description.default_outputs or known
        return [known[name] for name in dict.fromkeys(wanted or usual)], []

    def reasons(self) -> dict[str, str]:
        """Return by variable why it is not recorded, if it is not chosen or cannot be."""
        return dict.fromkeys(self.description.outputs, "not recorded")

    def parameters(
        self,
        values: Mapping[str, ParameterValue],
        driven: Sequence[str],
        resumed: PlantState | None = None,
    ) -> dict[str, ParameterValue]:
        """Return parameters and start values in their units; of a run that goes on, tunable ones.

        Raises
        ------
        ConfigError
            There are no such ones, their units or values are not possible; all faults at once.
        """
        faults, converted = _Faults(), dict[str, ParameterValue]()
        for name, value in values.items():
            if (plain := faults.collect(self._value, name, value)) is not None:
                converted[name] = plain
        before = {} if resumed is None else resumed.values
        new = {name: value for name, value in converted.items() if before.get(name) != value}
        faults.collect(self._check_values, new, driven, resumed is not None)
        if faults:
            raise ConfigError(faults)
        return converted

    def _check_values(
        self, values: Mapping[str, ParameterValue], driven: Sequence[str], goes_on: bool
    ) -> None:
        """Raise ConfigError for values that are not possible, as far as that is known before the run."""

    def _parameter(self, name: str) -> Variable:
        """Return the variable that a value is given for; one without a unit if it is not known."""
        return self.description.parameters.get(name, Variable(name))

    def _value(self, name: str, value: ParameterValue) -> ParameterValue:
        """Return a value in the variable's own unit: a text may be a number with a unit."""
        if value is None:
            raise ConfigError(f"{self.label}: {name} = None is not possible; needed: a number or a text")
        signal = self.description.signal(name)
        if not isinstance(value, str) or (signal is not None and signal.source.values == "text"):
            return value
        match = _QUANTITY.fullmatch(value)
        try:
            number = float(match["number"]) if match else math.nan
        except ValueError:
            return value  # the name of an enumeration's value, or a boolean: what it can be, is checked later
        if self.is_whole(name) and _INTEGER.fullmatch(value):
            return int(value)  # to the last digit
        if match is None or math.isnan(number):
            raise ConfigError(f"{self.label}: {name} = {value!r} is not a number")
        try:
            return float(converter(self._parameter(name), match["unit"].strip())(number))
        except ConfigError as error:
            raise ConfigError(f"{self.label}: {name} = {value}: {error}") from error


class _FMUSubject(_Subject):
    """An FMU, of which more than outputs can be recorded, and whose values are checked before it runs."""

    def readable(
        self, wanted: Sequence[str] | None, golden: CSVFile | None
    ) -> tuple[list[Variable], list[str]]:
        """Return the recorded variables, and remarks on the choice; errors as of any plant."""
        notes = list[str]()
        if wanted is None:
            chosen, notes = self._default_outputs()
            compared = [split_unit(header)[0] for header in golden.header] if golden else []
            wanted = [*chosen, *(n for n in compared if n not in chosen and self._is_readable(n))]
        _, signals = choose_signals(self.description, self.label, [], wanted)
        return [signal.variable for signal in signals], notes

    def reasons(self) -> dict[str, str]:
        """Return by variable why it is not recorded, if it is not chosen or cannot be."""
        variables = self.description.variables.values()
        return {v.name: "not recorded" if v.is_numeric else f"{v.type} is not a number" for v in variables}

    def _is_readable(self, name: str) -> bool:
        """Whether a name is that of a number which the FMU calculates or has."""
        signal = self.description.signal(name)
        return signal is not None and signal.source.is_numeric and signal.source.causality != "independent"

    def _default_outputs(self) -> tuple[list[str], list[str]]:
        description = self.description
        declared = [signal.variable.name for signal in description.signals("output")]
        if declared:
            every = [v for v in description.variables.values() if v.causality == "output"]
            left = [v.name for v in every if not v.is_numeric]
            notes = [f"not recorded, as they are not numbers: {', '.join(left)}"] if left else []
            return declared, notes
        states = [name for name in description.states if description.signal(name) is not None]
        if states:
            return states, ["the FMU has no outputs: its states are recorded"]
        local = list(description.signals("local"))
        moving = [s for s in local if s.source.values == "real" and s.source.variability == "continuous"]
        locals_ = [signal.variable.name for signal in moving or local]
        if not locals_:
            return [], ["the FMU has neither outputs nor local variables: nothing is recorded"]
        some = f"the first {_MOST_LOCALS} of {len(locals_)}" if len(locals_) > _MOST_LOCALS else "all"
        return locals_[:_MOST_LOCALS], [f"the FMU has no outputs: local variables are recorded, {some}"]

    def _check_values(
        self, values: Mapping[str, ParameterValue], driven: Sequence[str], goes_on: bool
    ) -> None:
        from ddpc_cosim.fmu.buffers import StartValues

        signals = [s for s in map(self.description.signal, driven) if s is not None]
        StartValues(self.description, self.label, values, signals, tunable_only=goes_on)

    def _parameter(self, name: str) -> Variable:
        signal = self.description.signal(name)
        return super()._parameter(name) if signal is None else signal.variable


def _subject(request: SimulationRequest) -> _Subject:
    """Return the plant that a request names, ready to run."""
    path = Path(request.plant)
    is_file = path.suffix.lower() in (".fmu", ".ssp") or (bool(path.suffix) and path.is_file())
    if is_file and not path.is_file():
        raise ConfigError(f"{path}: no such file")
    if request.fmi_type not in (allowed := get_args(FMIType)):
        raise ConfigError(f"fmi_type = {request.fmi_type!r} is not possible; allowed: {', '.join(allowed)}")
    what = "name" if not is_file else "ssp" if path.suffix.lower() == ".ssp" else "fmu"
    of_fmus = {"trace_calls": request.trace_calls, "fmi_type": request.fmi_type != "auto"}
    if what == "ssp" and any(of_fmus.values()):
        given = next(key for key, value in of_fmus.items() if value)
        raise ConfigError(f"{path}: {given} is of one FMU, and this is a system of several")
    named: dict[str, Any] = {what: request.plant}
    if request.coupling:
        if what != "ssp":
            raise ConfigError(f"coupling: {request.plant} is one plant; it is for systems of several (SSP)")
        named["coupling"] = dict(request.coupling)
    named |= {"fmi_type": request.fmi_type, "library_path": list(request.library_path)}
    section = read(PlantSection, named)
    spec = PlantSpec.of(section, Path.cwd()).built()
    label = path.name if is_file else request.plant
    return (_FMUSubject if spec.fmu else _Subject)(label, spec, spec.variables())


def prepare(request: SimulationRequest) -> Prepared:
    """Check what is asked for, and choose the rest.

    Raises
    ------
    ConfigError
        It is not possible; all faults at once.
    CosimError
        The plant cannot be loaded.
    """
    subject, faults, resumed = _subject(request), _Faults(), request.resumed
    content, platform = subject.spec.content, platform_folders(3)[0] if subject.spec.files else ""
    if request.coupling:
        content += f" coupled by {dict(sorted(request.coupling.items()))}"
    if resumed is not None and (others := resumed.faults(subject.label, content, platform)):
        raise ConfigError(others)  # of another plant, nothing else can be said
    if resumed is not None or request.keeps_state:
        faults.collect(_check_can_serialise, subject)
    if not 0 < request.step_timeout < math.inf:
        faults.append(f"step_timeout = {request.step_timeout} is not possible; allowed: a finite number > 0")
    outputs, notes = faults.collect(subject.readable, request.outputs, request.golden) or ([], [])
    driven = faults.collect(_read_inputs, subject, request.inputs) or {} if request.inputs else {}
    values = faults.collect(subject.parameters, request.values, list(driven), resumed) or {}
    known = {v.name: v for v in (*outputs, *(subject.description.inputs[name] for name in driven))}
    golden = None
    if request.golden is not None:
        golden = faults.collect(Golden, request.golden, known, subject.description.shapes, subject.reasons())
    times = faults.collect(_times, subject, request, driven, golden)
    if times is not None:
        start, step, count, chosen = times
        notes += chosen
        end = start + count * step
        if resumed is not None:
            notes = [*_said_of_state(resumed, subject, [*driven, *values]), *notes]
        if request.inputs is not None:
            faults.collect(_check_covered, request.inputs, driven, start, end)
        if golden is not None:
            faults.collect(golden.check_times, start, step, count)
    if golden is not None:
        notes += golden.notes
    if request.trace_calls:
        faults.collect(_check_writable, request)
    if faults or times is None:
        raise ConfigError(faults)
    traced = Path(request.trace_calls).absolute() if request.trace_calls else None  # the case runs elsewhere
    if traced is not None:
        traced.write_bytes(b"")
    at_start = {name: float(values_at(s, name, np.array([start]))[0]) for name, s in driven.items()}
    resumption = None
    if resumed is not None:
        changed = {name: value for name, value in values.items() if resumed.values.get(name) != value}
        values = {name: value for name, value in resumed.parameters.items() if name not in driven}
        resumption = Resumption(resumed.state, resumed.reset_time, changed=changed)
        if step == resumed.sampling_time:  # on the samples of that run, to the last bit of their times
            start, resumption = resumed.start_time, resumption._replace(samples=resumed.samples)
    case = Case(
        controller=subject.label,
        scenario="nominal",
        seed=0,
        label=subject.label,
        section={"type": "", "settings": {}},
        plant=replace(subject.spec.starting_at(at_start), trace_calls=str(traced or "")),
        inputs=(),
        outputs=(),
        measurements=tuple(outputs),
        sampling_time=step,
        duration=count * step,
        start_time=start,
        continue_recording=False,
        reference={},
        bounds={},
        excitation=None,
        recording=None,
        stabiliser=None,
        parameters=values,
        noise={},
        conditions=Conditions(inputs=driven),
        undriven=tuple(subject.description.inputs[name] for name in driven),
        step_timeout=request.step_timeout,
        id="simulation",
        resumed=resumption,
        keeps_state=request.keeps_state,
    )
    return Prepared(subject.label, case, driven, tuple(notes), golden, content, platform, resumed)


def _check_can_serialise(subject: _Subject) -> None:
    """Raise ConfigError if the plant's state cannot be had as bytes, and why."""
    plant = subject.spec.open((), ())
    try:
        if not plant.can_serialise_state:
            plant.serialise_state()  # which says why
            raise ConfigError(f"{subject.label}: the state cannot be saved as bytes")
    finally:
        plant.close()


def _said_of_state(resumed: PlantState, subject: _Subject, given: Sequence[str]) -> list[str]:
    """Return what is to be said of a state, and of inputs that were driven and are not now."""
    known = subject.description.inputs
    held = [name for name in resumed.inputs if name in known and name not in given]
    values = [f"{name} = {resumed.inputs[name]:g} {known[name].unit}".strip() for name in held]
    texts = [f"not driven now, held as in the state: {', '.join(values)}"]
    return [f"goes on at t = {shown(resumed.time)} from a state", *(texts if held else [])]


def _read_inputs(subject: _Subject, file: CSVFile) -> dict[str, Steps]:
    """Return the signals of a file's inputs, in their units.

    Raises
    ------
    ConfigError, DataError
        All that is wrong with its columns, or with its cells.
    """
    known = subject.description.inputs
    file = plain_cells(file, subject.description.shapes)
    given = [name for header in file.header if (name := split_unit(header)[0]) != TIME]
    faults = [
        f'{file.path}: column "{name}" is not an input; {did_you_mean(name, known)}'
        if known
        else f'{file.path}: column "{name}" is not an input; {subject.label} has none'
        for name in given
        if name not in known
    ]
    if len(given) == len(file.header):
        faults.append(f'{file.path}: no column "{TIME}"; {did_you_mean(TIME, file.header)}')
    if faults:
        raise ConfigError(faults)
    time, values = read_table(file, [Column(known[name], name) for name in given], TIME)
    signals = {}
    for i, name in enumerate(given):
        faults += _impossible(f"{file.path}: {name}", known[name], time, values[:, i], subject.is_whole(name))
        kind = Steps if subject.holds(name) else Interpolated
        signals[name] = kind(tuple(time.tolist()), tuple(values[:, i].tolist()))
    if faults:
        raise ConfigError(faults)
    return signals


def _impossible(
    what: str, variable: Variable, time: FloatArray, values: FloatArray, is_whole: bool
) -> list[str]:
    """Return the first value of an input that its declaration does not allow."""
    outside = (values < variable.min) | (values > variable.max)
    wrong = np.flatnonzero(outside | (values != np.rint(values)) if is_whole else outside)
    if not wrong.size:
        return []
    i = int(wrong[0])
    needed = f"[{variable.min:g}, {variable.max:g}]" if outside[i] else "an integer"
    return [f"{what} = {values[i]:g} at t = {time[i]:g} s is not possible; allowed: {needed}"]


def _times(
    subject: _Subject, request: SimulationRequest, driven: Mapping[str, Steps], golden: Golden | None
) -> tuple[float, float, int, list[str]]:
    """Return start time, time between samples [s], number of intervals, and what was chosen."""
    experiment, faults = subject.description.default_experiment, list[str]()
    start, notes = _start(request, experiment, golden)
    stop, step = request.stop, request.step
    if step is None and request.resumed is not None:
        step = request.resumed.sampling_time
    if request.resumed is not None and request.start not in (None, start):
        faults.append(
            f"start = {request.start:g} s is not possible: the state is that at {start:g} s, where the run "
            "goes on; leave it out"
        )
    if stop is None and golden is not None and golden.time[-1] > start:
        stop = float(golden.time[-1])
        notes.append(f"stop = {stop:g} s, as in {golden.path.name}")
    if stop is None and experiment.stop_time is not None:
        stop, said = _default_stop(start, experiment.start_time or 0.0, experiment.stop_time)
        notes += said
    if stop is None:
        ends = [signal.times[-1] for signal in driven.values()]
        stop = ends[0] if ends and ends[0] > start else start + _DURATION
        notes.append(
            f"stop = {stop:g} s, as the plant does not say" + (": the end of the inputs" if ends else "")
        )
    if not math.isfinite(start):
        faults.append(f"start = {start:g} s is not possible; allowed: a finite number")
    elif not start < stop < math.inf:
        faults.append(f"stop = {stop:g} s is not possible; allowed: a number > {start:g}, the start time")
    if step is not None and not 0 < step < math.inf:
        faults.append(f"step = {step:g} s is not possible; allowed: a number > 0")
    if faults:
        raise ConfigError(faults)
    if step is None and golden is not None and golden.step is not None:
        step = golden.step
        notes.append(f"step = {step:g} s, as in {golden.path.name}")
    if step is None:
        step, said = _default_step(subject, experiment.step_size, stop - start)
        notes += said
    count = math.floor((stop - start) / step * (1 + _ROUNDING) + _ROUNDING)
    if count < 1:
        raise ConfigError(f"step = {step:g} s is longer than the run, from {start:g} s to {stop:g} s")
    end_time(start, whole_steps(count * step, step), step)
    end = start + count * step
    if abs(end - stop) > _ROUNDING * max(abs(stop), step):
        notes.append(f"the last sample is at {end:.9g} s: whole steps of {step:g} s do not meet {stop:g} s")
    return start, step, count, notes


def _start(
    request: SimulationRequest, experiment: DefaultExperiment, golden: Golden | None
) -> tuple[float, list[str]]:
    """Return the start time [s], and what is to be said of it."""
    begin, asked = experiment.start_time or 0.0, request.start
    if request.resumed is not None:
        return request.resumed.time, []
    if asked is None and golden is not None:
        first = float(golden.time[0])
        return first, [] if first == begin else [f"start = {first:g} s, as in {golden.path.name}"]
    if asked is None or not asked < begin:
        return begin if asked is None else asked, []
    early = f"start = {asked:g} s is before the plant's default experiment, which begins at {begin:g} s"
    return asked, [f"{early}: what it reads over time, such as weather, may not reach back so far"]


def _default_stop(start: float, begin: float, end: float) -> tuple[float | None, list[str]]:
    """Return the stop time of a run from its start on, by a default experiment [s]; None: it has none."""
    if end > start:
        return end, []
    if not end > begin:
        return None, []
    stop = start + (end - begin)
    return stop, [f"stop = {stop:g} s: as long as the default experiment, which ends at {end:g} s"]


def _default_step(subject: _Subject, preferred: float | None, duration: float) -> tuple[float, list[str]]:
    if preferred and 0 < preferred <= duration and duration / preferred <= _MOST_SAMPLES:
        return preferred, []
    step, fixed = duration / _INTERVALS, subject.description.fixed_step
    if fixed:
        step = fixed * max(1, round(step / fixed))
    return step, [f"step = {step:g} s, as the plant does not say"]


def _check_covered(file: CSVFile, driven: Mapping[str, Steps], start: float, end: float) -> None:
    """Raise ConfigError if a file of inputs begins after the run does, or ends before it."""
    for signal in driven.values():
        first, last = signal.times[0], signal.times[-1]
        slack = _ROUNDING * max(abs(start), abs(end))
        if first > start + slack or last < end - slack:
            raise ConfigError(
                f"{file.path}: its times, {first:g} s to {last:g} s, do not cover the run, {start:g} s to "
                f"{end:g} s; choose another start or stop, or add rows"
            )
        return


def _check_writable(request: SimulationRequest) -> None:
    """Raise ConfigError if calls cannot be written to the file for them, or if it is one that is read."""
    path = Path(request.trace_calls)
    files = [file.path for file in (request.inputs, request.golden) if file is not None]
    if fault := overwrites(path, [Path(request.plant), *files]):
        raise ConfigError(fault)
    try:
        path.open("ab").close()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from error


def overwrites(path: Path, read: Sequence[Path]) -> str:
    """Return why a file is not to be written, as it is one that is read; empty if it is not."""
    same = path.exists() and any(other.exists() and path.samefile(other) for other in read)
    return f"{path}: this file is read; choose another one to write to" if same else ""
