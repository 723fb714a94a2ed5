"""From a parsed study to a resolved one: plant, controllers, units and limits looked up and checked once."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar, cast

from ddpc_cosim.conditions import Conditions, delay_error
from ddpc_cosim.controller import Controller, Recording
from ddpc_cosim.errors import ConfigError, ControllerError, CosimError, DataError, Place
from ddpc_cosim.excitations import Excitation, MixedExcitation
from ddpc_cosim.loop_setup import excitation_table, late_error, limits_error
from ddpc_cosim.metrics import MetricSettings, installed_versions
from ddpc_cosim.plant import ParameterValue
from ddpc_cosim.safe_calls import CallsInTime, recording_length
from ddpc_cosim.settings import PLANT, files_of
from ddpc_cosim.signals import Reference
from ddpc_cosim.study.controllers import (
    StudyController,
    late_call,
    resolve_controllers,
    resolve_stabiliser,
    time_limit,
)
from ddpc_cosim.study.plants import PlantSpec, PlantVariables
from ddpc_cosim.study.sections import (
    BoundsSection,
    DriftSection,
    EventSection,
    RecordingSection,
    ScenarioSection,
    Study,
)
from ddpc_cosim.study.signal_sections import Excited, Experiment, RampReference, StepsReference
from ddpc_cosim.study.validation_errors import InvalidFieldError, Section, ValidationErrors, independent
from ddpc_cosim.variables import Variable, converter

_MOST_LISTED = 8
Limits = dict[str, tuple[float, float]]
K = TypeVar("K", str, int)

_PLANT, _INPUTS, _OUTPUTS, _MEASUREMENTS = (
    ("plant", *key) for key in ((), ("inputs",), ("outputs",), ("measurements",))
)
_RECORDING: Place = ("recording",)


@dataclass(frozen=True, slots=True)
class ResolvedStudy:
    """A study that fits its plant and its controllers, ready to become cases.

    Parameters
    ----------
    study : Study
        The file's content with every default filled in, every sweep written out and every path absolute.
    plant : PlantSpec
        The plant.
    inputs, outputs, measurements : tuple of Variable
        The signals that take part.
    reference : dict of str to Reference
        Of each controlled output, in its own unit.
    bounds : dict of str to dict of str to (float, float)
        For each controller the limits of inputs and controlled outputs, in their own units.
    excitations : dict of str to (Excitation or None)
        The experiment of each scenario; each case draws it with its own seed.
    conditions : dict of str to Conditions
        Of each scenario, in the variables' own units.
    undriven : dict of str to tuple of Variable
        The inputs that have a signal in each scenario.
    metrics : MetricSettings
        What all runs are judged by alike.
    recording : Recording or None
        What was recorded before, in place of an experiment.
    late : dict of str to str
        Why a controller cannot be run: one of its calls has not returned within the time limit.
    """

    study: Study
    plant: PlantSpec
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    measurements: tuple[Variable, ...]
    reference: dict[str, Reference]
    bounds: dict[str, Limits]
    excitations: dict[str, Excitation | None]
    conditions: dict[str, Conditions]
    undriven: dict[str, tuple[Variable, ...]]
    metrics: MetricSettings
    recording: Recording | None
    late: dict[str, str]


def resolve(study: Study, folder: Path, errors: ValidationErrors) -> ResolvedStudy | None:
    """Look up everything that a study names, and check that it fits together.

    Parameters
    ----------
    study : Study
        Its sections; what was invalid is left out.
    folder : Path
        Folder of the file: paths in it are relative to this.
    errors : ValidationErrors
        What was found before; what is found here is added.

    Returns
    -------
    resolved : ResolvedStudy or None
        None if there are errors.
    """
    with CallsInTime(time_limit(study)) as in_time:
        return _Resolution(study, folder, errors, in_time).result()


def _dotted_names(settings: Mapping[str, Any], before: str = "") -> Iterator[str]:
    """Yield the names of settings and of the entries of those that are tables: ``inner.kp``."""
    for name, value in settings.items():
        yield before + name
        if isinstance(value, Mapping):
            yield from _dotted_names(value, f"{before}{name}.")


class _Selection(NamedTuple):
    """The signals of one kind that take part.

    Where it is not known which, they are all that could, and ``size`` is the number of names given (0: none).
    """

    variables: tuple[Variable, ...]
    is_known: bool
    size: int

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(variable.name for variable in self.variables)


class _Resolution:
    """The way of one study; what does not fit is reported, and what depends on it is left out."""

    def __init__(self, study: Study, folder: Path, errors: ValidationErrors, in_time: CallsInTime) -> None:
        self.study, self.errors, self.in_time = study, errors, in_time
        self.controllers = resolve_controllers(study, folder, errors, in_time) or []
        self.stabiliser = resolve_stabiliser(study, folder, errors, in_time)
        self._check_report()
        for controller in self.controllers:
            self._check_tuned(controller)
        plant = self._plant(folder)
        self.is_complete = plant is not None
        if plant is None:
            return
        self.plant, self.variables = plant
        self._check_plant()
        self._select_signals()
        self._check_scenarios()
        self.recording = self._read_recording()
        self._check_recording()
        self._check_cost()
        self.references = self._references()
        self.bounds = self._bounds()
        self.excitation = self._excitation()
        self.excitations = {name: self._changed_excitation(name) for name in study.scenarios}
        self.conditions = {name: self._conditions(name) for name in study.scenarios}

    def result(self) -> ResolvedStudy | None:
        """Return the resolved study, None if there are errors."""
        if self.errors.found or not self.is_complete or self.references is None or self.bounds is None:
            return None
        return ResolvedStudy(
            study=self._written_out(),
            plant=self.plant,
            inputs=self.inputs.variables,
            outputs=self.outputs.variables,
            measurements=self.measurements.variables,
            reference=self.references,
            bounds={controller.name: self.bounds[controller.of] for controller in self.controllers},
            excitations=self.excitations,
            conditions={name: conditions or Conditions() for name, conditions in self.conditions.items()},
            undriven={
                name: tuple(self.variables.inputs[signal] for signal in scenario.inputs)
                for name, scenario in self.study.scenarios.items()
            },
            metrics=self._metrics(),
            recording=self.recording,
            late={
                one.name: late_call(self.study.controllers[one.of].type, one.late, self.in_time.seconds)
                for one in self.controllers
                if one.late
            },
        )

    def _metrics(self) -> MetricSettings:
        cost, loop = self.study.metrics.cost, self.study.loop
        limits = [
            loop.preview if one.preview is None else one.preview for one in self.study.scenarios.values()
        ]
        largest = max((one.horizon for one in self.controllers), default=0)
        preview = max(largest if limit == "horizon" else min(limit, largest) for limit in limits)
        return MetricSettings(preview, cost.model_dump() if cost else {}, installed_versions())

    def _written_out(self) -> Study:
        """Return the study with every default filled in, every sweep written out and every path absolute."""
        study, recording = self.study, self.study.recording
        plant = {
            "fmu": self.plant.fmu,
            "inputs": list(self.inputs.names),
            "outputs": list(self.outputs.names),
            "measurements": list(self.measurements.names),
        }
        if recording is not None and recording.controller is not None and self.stabiliser is not None:
            controller = recording.controller.model_copy(update={"settings": self.stabiliser.settings})
            recording = recording.model_copy(update={"controller": controller})
        return study.model_copy(
            update={
                "plant": study.plant.model_copy(update=plant),
                "controllers": {c.name: c.section(study.controllers[c.of]) for c in self.controllers},
                "recording": recording,
            }
        )

    @independent
    def _check_report(self) -> None:
        report = self.study.report
        for i, panel in enumerate(report.panels):
            self._require_controllers(("report", "panels", i), panel, "controllers")
        for i, method in enumerate(report.reproduction.methods if report.reproduction else ()):
            for key in ("printed", "published_code"):
                self._require_controllers(("report", "reproduction", "methods", i), method, key)

    @independent
    def _require_controllers(self, place: Place, section: Section, key: str) -> None:
        named = getattr(section, key)
        given = [named] if isinstance(named, str) else named
        known = [*self.study.controllers, *(controller.name for controller in self.controllers)]
        # A controller whose section has errors is there all the same.
        known += [name for name in given if self.errors.in_doubt(("controllers", name))]
        self.errors.require_known((*place, key), "controller", filter(None, given), known)

    @independent
    def _check_tuned(self, controller: StudyController) -> None:
        """Check that what was tuned is a setting, and on other seeds than those reported."""
        tuned = self.study.controllers[controller.name].tuned if not controller.varied else None
        if tuned is None:
            return
        place = ("controllers", controller.name, "tuned")
        if controller.controller is not None:
            known = list(_dotted_names(controller.settings))
            self.errors.require_known((*place, "settings"), "setting", tuned.settings, known)
        if shared := sorted(set(tuned.seeds) & set(self.study.seeds)):
            listed = ", ".join(map(str, shared[:_MOST_LISTED])) + (", ..." if shared[_MOST_LISTED:] else "")
            what = f"{listed}: a seed of the study; needed: seeds on which no result is reported"
            self.errors.add((*place, "seeds"), what, ("seeds",))

    @independent
    def _plant(self, folder: Path) -> tuple[PlantSpec, PlantVariables] | None:
        """Return the plant and its variables; None if there is none to check the study against."""
        section = self.study.plant
        doubtful = any(self.errors.in_doubt((*_PLANT, key)) for key in ("name", "fmu"))
        if doubtful or _PLANT in self.errors.found:
            return None
        try:
            spec = PlantSpec.of(section, folder)
            return spec, spec.variables()
        except CosimError as error:
            self.errors.add((*_PLANT, "fmu" if section.fmu else "name"), str(error))
            return None

    def _check_plant(self) -> None:
        section, errors = self.study.plant, self.errors
        known = (*self.variables.inputs, *self.variables.outputs)
        for key in ("display_units", "nominal"):
            errors.require_known((*_PLANT, key), "input or output", getattr(section, key), known)
        try:
            self.variables = self.variables.shown(section.display_units, section.nominal)
        except ConfigError as error:
            for fault in error.faults:
                errors.add((*_PLANT, "display_units"), fault)
        parameters = self.variables.parameters
        self._check_parameters((*_PLANT, "parameters"), "parameter", section.parameters, parameters)
        for controller in self.controllers if not self.plant.is_fmu else ():
            if PLANT in files_of(type(controller.controller), controller.settings):
                what = f'"{PLANT}" stands for the FMU of the plant, which is a Python class'
                errors.add(controller.place, what)

    def _select_signals(self) -> None:
        plant, known = self.study.plant, self.variables
        self.inputs = self._select(_INPUTS, "input", plant.inputs, known.inputs, known.default_inputs)
        self.outputs = self._select(_OUTPUTS, "output", plant.outputs, known.outputs, known.default_outputs)
        self.measurements = self._select(_MEASUREMENTS, "output", plant.measurements, known.outputs, ())
        if not plant.measurements and not self.errors.in_doubt(_MEASUREMENTS):
            self.measurements = self.outputs

    def _select(
        self,
        place: Place,
        what: str,
        given: list[str],
        known: Mapping[str, Variable],
        default: tuple[str, ...],
    ) -> _Selection:
        self.errors.require_known(place, what, given, known)
        for name in sorted({name for name in given if given.count(name) > 1}):
            self.errors.add(place, f'"{name}" is listed more than once')
        if self.errors.in_doubt(place):
            return _Selection(tuple(known.values()), False, len(given))
        chosen = tuple(known[name] for name in given or default or known)
        return _Selection(chosen, True, len(chosen))

    def _check_parameters(
        self, place: Place, what: str, values: Mapping[str, ParameterValue], known: Mapping[str, Variable]
    ) -> None:
        self.errors.require_known(place, what, values, known)
        for name, value in values.items():
            if not isinstance(value, str):  # a string, or the name of an enumeration's value: the plant knows
                self._check_value((*place, name), value, known.get(name))

    def _check_value(self, place: Place, value: float, parameter: Variable | None) -> None:
        if parameter is not None and not parameter.min <= value <= parameter.max:
            self.errors.add(place, f"{value:g} is outside [{parameter.min:g}, {parameter.max:g}]")

    def _check_scenarios(self) -> None:
        parameters = self.variables.parameters
        tunable = {name: v for name, v in parameters.items() if name in self.variables.tunable}
        for name, scenario in self.study.scenarios.items():
            place = ("scenarios", name)
            self._check_parameters((*place, "parameters"), "parameter", scenario.parameters, parameters)
            noisy = (*place, "noise")
            self.errors.require_known(noisy, "measurement", scenario.noise, self.measurements.names)
            for i, event in enumerate(scenario.events):
                self._check_in_run((*place, "events", i), event, "time")
                self._check_event((*place, "events", i), event, tunable)
            for i, drift in enumerate(scenario.drifts):
                self._check_in_run((*place, "drifts", i), drift, "from_time")
                for key in ("parameter", "from_value", "to_value", "to_time"):
                    self._check_drift((*place, "drifts", i), drift, key, tunable)

    @independent
    def _check_in_run(self, place: Place, change: Section, key: str) -> None:
        """Report a change that would never act on the plant; the scenario would not be what it says."""
        late = late_error(getattr(change, key), self.study.loop.start_time + self.study.loop.duration)
        if late:
            self.errors.add((*place, key), late, ("loop", "start_time"))

    @independent
    def _check_event(self, place: Place, event: EventSection, tunable: Mapping[str, Variable]) -> None:
        self._check_parameters((*place, "parameters"), "tunable parameter", event.parameters, tunable)

    @independent
    def _check_drift(
        self, place: Place, drift: DriftSection, key: str, tunable: Mapping[str, Variable]
    ) -> None:
        value, at = getattr(drift, key), (*place, key)
        if key == "parameter":
            self.errors.require_known(at, "tunable parameter", [value], tunable)
        elif key != "to_time":
            self._check_value(at, value, tunable.get(drift.parameter))
        elif value <= self.study.loop.start_time:
            start = f"t = {self.study.loop.start_time:g} s"
            over = f"it would be over when the run starts at {start}; use the scenario's parameters"
            self.errors.add(at, over, ("loop", "start_time"))

    @independent
    def _conditions(self, name: str) -> Conditions | None:
        """Return the conditions of a scenario; None if there are errors."""
        scenario, place, errors = self.study.scenarios[name], ("scenarios", name), self.errors
        driven, measured = self.inputs.names, self.measurements.names
        seen = dict.fromkeys((*self.outputs.names, *measured))
        undriven = {n: v for n, v in self.variables.inputs.items() if n not in driven}
        known = {
            "disturbances": ("input or output", (*driven, *seen)),
            "inputs": ("input that no controller drives", self.variables.inputs),
            "rate_limit": ("input that the controllers drive", driven),
            "delay": ("input or measurement", (*driven, *measured)),
            "quantum": ("measurement", measured),
            "loss": ("measurement", measured),
        }
        for key, (what, names) in known.items():
            errors.require_known((*place, key), what, getattr(scenario, key), names)
        for signal in scenario.inputs:
            self._check_undriven((*place, "inputs", signal), scenario, signal)
        for signal, delay in scenario.delay.items():
            self._check_delay((*place, "delay", signal), delay, scenario)
        variables, disturbances = {**self.variables.outputs, **self.variables.inputs}, {}
        for signal, parts in scenario.disturbances.items():
            at = (*place, "disturbances", signal)
            for i, part in enumerate(parts):
                self._check_disturbance((*at, i), part)
            if signal in variables:
                sections, same = dict(enumerate(parts)), dict.fromkeys(range(len(parts)), variables[signal])
                disturbances[signal] = tuple(self._signals(at, sections, same, difference=True).values())
        inputs = self._signals((*place, "inputs"), scenario.inputs, undriven)
        if errors.found:
            return None
        return Conditions(
            disturbances=disturbances,
            inputs=inputs,
            rate_limit=scenario.rate_limit,
            delay=scenario.delay,
            quantum=scenario.quantum,
            loss=scenario.loss,
        )

    def _check_undriven(self, place: Place, scenario: ScenarioSection, name: str) -> None:
        """Check that nothing else decides the value of an input that has a signal."""
        if self.inputs.is_known and name in self.inputs.names:
            remedy = "use disturbances to add to it, or leave it out of plant.inputs"
            self.errors.add(place, f"the controllers drive this input; {remedy}")
        others = {
            "the plant's parameters": name in self.study.plant.parameters,
            "the scenario's parameters": name in scenario.parameters,
            "an event": any(name in event.parameters for event in scenario.events),
            "a drift": any(name == drift.parameter for drift in scenario.drifts),
        }
        for what in (what for what, is_so in others.items() if is_so):
            self.errors.add(place, f"this input is set by {what} too; leave one of them out")

    @independent
    def _check_delay(self, place: Place, delay: float, scenario: ScenarioSection) -> None:
        loop, recording = self.study.loop, self.study.recording
        fault = delay_error(delay, loop.sampling_time, loop.steps)
        if recording is not None and scenario.recording is not None:
            recording = scenario.recording.of(recording)
        if not fault and recording is not None and recording.samples is not None:
            fault = delay_error(delay, loop.sampling_time, recording.samples, "experiment")
        if fault:
            self.errors.add(place, fault)

    @independent
    def _check_disturbance(self, place: Place, section: Section) -> None:
        """Report steps and ramps that begin when the run is over."""
        loop = self.study.loop
        begins = {"times": section.times} if isinstance(section, StepsReference) else {}
        begins |= {"from_time": [section.from_time]} if isinstance(section, RampReference) else {}
        for key, times in begins.items():
            for late in filter(None, (late_error(t, loop.start_time + loop.duration) for t in times)):
                self.errors.add((*place, key), late, ("loop", "start_time"))

    @independent
    def _check_recording(self) -> None:
        """Check that there is a recording, and a long one, where something learns from it."""
        recording = self.study.recording
        sizes = [selection.size for selection in (self.inputs, self.outputs, self.measurements)]
        for i, one in enumerate(self.controllers):
            if recording is None and one.uses_recording:
                lacking = "learns from a recording, and the study has no recording section"
                self.errors.add(("controllers", one.name), lacking, _RECORDING)
            elif recording is not None and one.controller is not None and all(sizes):
                needed = self._length_needed(i, one.controller, sizes)
                self._check_length(recording, one.name, needed)
                for scenario in self.study.scenarios:
                    self._check_changed_length(scenario, one.name, needed)
        if self.study.loop.start == "recording-end" and (recording is None or recording.file):
            lacking = "a recording section" if recording is None else "an experiment to go on from, not files"
            self.errors.add(("loop", "start"), f'"recording-end" needs {lacking}', _RECORDING)

    def _length_needed(self, i: int, controller: Controller, sizes: Sequence[int]) -> int:
        """Return how long a recording a controller needs; none where it does not tell, which is noted."""
        try:
            return self.in_time(partial(recording_length, controller, *sizes))
        except TimeoutError:
            self.controllers[i] = self.controllers[i]._replace(late="recording_length")
        except ControllerError as error:
            self.errors.add(("controllers", self.controllers[i].name), str(error))
        return 0

    @independent
    def _check_length(self, recording: RecordingSection, name: str, needed: int) -> None:
        key, samples = "samples", recording.samples
        if self.recording is not None:
            key, samples = "file", len(self.recording)
        if samples is not None and samples < needed:
            short = f"{samples} is too short for {name}, which needs {needed}"
            self.errors.add((*_RECORDING, key), short if key == "samples" else f"the number of rows, {short}")

    @independent
    def _check_changed_length(self, scenario: str, name: str, needed: int) -> None:
        changes, place = self.study.scenarios[scenario].recording, ("scenarios", scenario, "recording")
        if changes is not None and changes.samples is not None and changes.samples < needed:
            short = f"{changes.samples} is too short for {name}, which needs {needed}"
            self.errors.add((*place, "samples"), short)

    @independent
    def _read_recording(self) -> Recording | None:
        """Return what the study's files hold of the signals that take part."""
        section, chosen = self.study.recording, (self.inputs, self.outputs, self.measurements)
        if section is None or not section.file or not all(selection.is_known for selection in chosen):
            return None
        signals = list(dict.fromkeys(name for selection in chosen for name in selection.names))
        what = "input, output or measurement that takes part"
        self.errors.require_known((*_RECORDING, "columns"), what, section.columns, signals)
        inputs, outputs, measurements = (selection.variables for selection in chosen)
        try:
            return Recording.read_csv(
                *section.file,
                sampling_time=self.study.loop.sampling_time,
                inputs=inputs,
                outputs=outputs,
                measurements=measurements,
                columns={name: header for name, header in section.columns.items() if name in signals},
                time_column=section.time_column,
                time_tolerance=section.time_tolerance,
            )
        except DataError as error:
            for fault in error.faults:
                self.errors.add((*_RECORDING, "file"), fault)
            return None

    @independent
    def _check_cost(self) -> None:
        cost, place = self.study.metrics.cost, ("metrics", "cost")
        if cost is not None:
            self.errors.require_known(
                (*place, "outputs"), "controlled output", cost.outputs, self.outputs.names
            )
            for key in ("inputs", "changes"):
                self.errors.require_known((*place, key), "input", getattr(cost, key), self.inputs.names)

    @independent
    def _references(self) -> dict[str, Reference] | None:
        sections = self.study.reference
        self._require_each(("reference",), "controlled output", sections, self.outputs)
        references = self._signals(("reference",), sections, self.variables.outputs)
        return None if self.errors.found else references

    @independent
    def _bounds(self) -> dict[str, Limits]:
        """Return the limits of each controller section: its own, else the study's, else the plant's."""
        variables = (*self.inputs.variables, *self.outputs.variables)
        common = {v.name: (v.min, v.max) for v in variables} | self._limits(("bounds",), self.study.bounds)
        return {
            name: common | self._limits(("controllers", name, "bounds"), section.bounds)
            for name, section in self.study.controllers.items()
        }

    def _limits(self, place: Place, bounds: Mapping[str, BoundsSection]) -> Limits:
        """Return the limits of a table in the variables' own units; a side left out is the plant's."""
        known = (*self.inputs.names, *self.outputs.names)
        self.errors.require_known(place, "input or controlled output", bounds, known)
        variables = {**self.variables.outputs, **self.variables.inputs}
        limits = {}
        for name, convert in self._converters(place, bounds, variables).items():
            low, high = bounds[name].min, bounds[name].max
            low = variables[name].min if low is None else convert(low)
            high = variables[name].max if high is None else convert(high)
            if limits_error((low, high)) and (*place, name) not in self.errors.found:
                room = f"leaves no room: [{low:g}, {high:g}] with the plant's own limits"
                self.errors.add((*place, name), room, (*place, name))
            limits[name] = (low, high)
        return limits

    @independent
    def _excitation(self) -> Excitation | None:
        """Return the experiment on all inputs, in their units."""
        recording, place = self.study.recording, (*_RECORDING, "excitation")
        if recording is None or recording.file:
            return None
        self._require_each(place, "input", recording.excitation, self.inputs)
        return self._experiment(recording, place)

    def _experiment(self, recording: RecordingSection, place: Place) -> Excitation | None:
        """Return the excitation of all inputs, in their units; what is wrong with it is reported there."""
        sections, is_added = recording.excitation, recording.controller is not None
        converters = self._converters(place, sections, self.variables.inputs, difference=is_added)
        groups: dict[str, list[str]] = {}
        for name in (name for name in self.inputs.names if name in converters):
            groups.setdefault(sections[name].group(name), []).append(name)
        parts = [self._excitation_part(recording, place, group, converters) for group in groups.values()]
        if None in parts or not self.inputs.names or not converters.keys() >= set(self.inputs.names):
            return None
        numbers = [tuple(map(self.inputs.names.index, group)) for group in groups.values()]
        served = [(part, group) for part, group in zip(parts, numbers, strict=True) if part is not None]
        return served[0][0] if len(served) == 1 else MixedExcitation(tuple(served))

    @independent
    def _excitation_part(
        self,
        recording: RecordingSection,
        place: Place,
        group: Sequence[str],
        converters: Mapping[str, Callable[[float], float]],
    ) -> Excitation | None:
        """Return the excitation of inputs that are excited together."""
        place = (*place, group[0])
        if recording.samples is None or place in self.errors.found:
            return None
        is_added = recording.controller is not None
        experiment = Experiment(recording.samples, self.study.loop.sampling_time, is_added)
        inputs = [
            Excited(recording.excitation[name], self.variables.inputs[name], converters[name])
            for name in group
        ]
        try:
            excitation = inputs[0].section.build(inputs, experiment)
            excitation_table(excitation, len(inputs))
        except DataError as error:
            for fault in error.faults:
                self.errors.add((*place, "file"), fault)
        except ConfigError as error:
            for fault in error.faults:
                self.errors.add(place, fault)
        else:
            return cast("Excitation", excitation)
        return None

    @independent
    def _changed_excitation(self, scenario: str) -> Excitation | None:
        """Return the experiment of a scenario on all inputs, in their units."""
        changes = self.study.scenarios[scenario].recording
        place: Place = ("scenarios", scenario, "recording")
        if changes is None:
            return self.excitation
        if self.study.recording is None or self.study.recording.file:
            what = "changes an experiment, and the study has no recording section with one"
            self.errors.add(place, what, _RECORDING)
            return None
        place = (*place, "excitation")
        self.errors.require_known(place, "input", changes.excitation, self.inputs.names)
        recording = changes.of(self.study.recording)
        if self.excitation is None:  # its faults are told at the study's own keys, and only there
            recording = recording.model_copy(update={"excitation": changes.excitation})
        return self._experiment(recording, place)

    def _require_each(self, place: Place, what: str, given: Iterable[str], wanted: _Selection) -> None:
        """Check that a table has an entry for each signal, and no others."""
        self.errors.require_known(place, what, given, wanted.names)
        for name in wanted.names if wanted.is_known else ():
            if name not in given:
                self.errors.add(place, f"none for the {what} {name}", (*place, name))

    def _signals(
        self,
        place: Place,
        sections: Mapping[K, Any],
        variables: Mapping[K, Variable],
        *,
        difference: bool = False,
    ) -> dict[K, Reference]:
        """Return the signals of sections in their variables' units, where they can be built."""
        signals = {}
        for name, convert in self._converters(place, sections, variables, difference=difference).items():
            try:
                signals[name] = sections[name].build(variables[name], convert)
            except DataError as error:
                for fault in error.faults:
                    self.errors.add((*place, name, "file"), fault)
            except (InvalidFieldError, ConfigError):  # reported before
                continue
        return signals

    def _converters(
        self,
        place: Place,
        sections: Mapping[K, Any],
        variables: Mapping[K, Variable],
        *,
        difference: bool = False,
    ) -> dict[K, Callable[[float], float]]:
        """Return the conversion of each section's values to its variable's unit, where there is one."""
        converters = {}
        for name, section in sections.items():
            try:
                if name in variables:
                    converters[name] = converter(variables[name], section.unit, difference=difference)
            except ConfigError as error:
                self.errors.add((*place, name, "unit"), str(error))
        return converters
