"""The scenarios of a study: what they change is checked, and becomes conditions and experiments."""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import replace

from ddpc_cosim.codec import Section, declared_fields, independent
from ddpc_cosim.conditions import Conditions, all_conditions, may_have
from ddpc_cosim.distributions import Distribution
from ddpc_cosim.errors import ConfigError, Place
from ddpc_cosim.files.durations import shown
from ddpc_cosim.loop.setup import end_time, late_error
from ddpc_cosim.signals.excitations import Excitation
from ddpc_cosim.signals.signals import Constant, Drift, ParameterChange, Ramp, Reference, Steps
from ddpc_cosim.study.disturbances import Disturbances
from ddpc_cosim.study.file_format.sections import ScenarioSection
from ddpc_cosim.study.selection import SelectedSignals, check_parameters, check_value
from ddpc_cosim.variables import Variable


class Scenarios:
    """The scenarios of a study, whose signals are selected; what does not fit is reported."""

    def __init__(self, signals: SelectedSignals, known: Disturbances) -> None:
        self._known = known
        self.study, self.signals, self.errors = signals.study, signals, signals.errors
        self.variables, self.inputs, self.outputs = signals.variables, signals.inputs, signals.outputs
        self._measured = tuple(dict.fromkeys((*signals.measurements.names, *known.variables)))

    def check(self) -> None:
        """Report parameters, noise, events and drifts that do not fit the plant or the run."""
        parameters = self.variables.parameters
        tunable = {name: v for name, v in parameters.items() if name in self.variables.tunable}
        for name, scenario in self.study.scenarios.items():
            place = ("scenarios", name)
            at, noisy = (*place, "parameters"), (*place, "noise")
            check_parameters(self.errors, at, "parameter", scenario.parameters, parameters)
            self.errors.require_known(noisy, "measurement", scenario.noise, self._measured)
            self._check_start((*place, "start_time"), scenario)
            for i, event in enumerate(scenario.events):
                self._check_in_run((*place, "events", i), event, "time", scenario)
                self._check_event((*place, "events", i, "parameters"), event, tunable, scenario)
            for i, drift in enumerate(scenario.drifts):
                self._check_in_run((*place, "drifts", i), drift, "from_time", scenario)
                for key in ("parameter", "from_value", "to_value"):
                    self._check_drift((*place, "drifts", i), drift, key, tunable, scenario)
                self._check_drift_begins((*place, "drifts", i, "to_time"), drift, scenario)

    @independent
    def conditions(self, name: str) -> Conditions | None:
        """Return the conditions of a scenario; None if there are errors."""
        scenario, place, errors = self.study.scenarios[name], ("scenarios", name), self.errors
        driven, measured = self.inputs.names, self._measured
        undriven = {n: v for n, v in self.variables.inputs.items() if n not in driven}
        known = may_have(driven, self.outputs.names, measured, self.variables.inputs)
        what_of_inputs, _ = known["inputs"]
        given: dict[str, Mapping[str, object]] = {
            "disturbances": scenario.disturbances,
            "inputs": scenario.inputs,
        }
        given |= scenario.effects
        for key, values in given.items():
            what, names = known[key]
            errors.require_known((*place, key), what, values, names)
        for signal in scenario.inputs:
            self._check_undriven((*place, "inputs", signal), scenario, signal)
        for signal in self._known.of_inputs:
            self._check_set_once(("disturbances", signal), scenario, signal)
        for key, values in scenario.effects.items():
            for signal, value in values.items():
                self._check_effect((*place, key, signal), key, value, scenario)
        variables, disturbances = {**self.variables.outputs, **self.variables.inputs}, {}
        for signal, parts in scenario.disturbances.items():
            at = (*place, "disturbances", signal)
            for i, part in enumerate(parts):
                self._check_disturbance((*at, i), part, scenario)
            if signal in variables:
                sections, same = dict(enumerate(parts)), dict.fromkeys(range(len(parts)), variables[signal])
                disturbances[signal] = tuple(self.signals.build(at, sections, same, difference=True).values())
        inputs = self.signals.build((*place, "inputs"), scenario.inputs, undriven)
        recorded = dict[str, Reference]()
        for where, in_experiment in self._recorded_inputs(scenario, place):
            errors.require_known(where, what_of_inputs, in_experiment, undriven)
            for name_of_input in in_experiment:
                self._check_set_once((*where, name_of_input), scenario, name_of_input)
            recorded |= self.signals.build(where, in_experiment, undriven)
        if errors.found:
            return None
        resting = {signal: Constant(undriven[signal].start) for signal in recorded}
        return Conditions(
            disturbances=disturbances,
            inputs=resting | self._known.of_inputs_in(inputs) | inputs,
            recorded_inputs=recorded,
            effects=scenario.effects,
        )

    @independent
    def excitation(self, scenario: str, of_study: Excitation | None) -> Excitation | None:
        """Return the experiment of a scenario, given that of the study, on all inputs, in their units."""
        changes = self.study.scenarios[scenario].recording
        place: Place = ("scenarios", scenario, "recording")
        if changes is None:
            return of_study
        if self.study.recording is None or self.study.recording.file:
            what = "changes an experiment, and the study has no recording section with one"
            self.errors.add(place, what, ("recording",))
            return None
        place = (*place, "excitation")
        self.errors.require_known(place, "input", changes.excitation, self.inputs.names)
        recording = changes.of(self.study.recording)
        if of_study is None:  # its faults are told at the study's own keys, and only there
            recording = replace(recording, excitation=changes.excitation)
        return self.signals.experiment(recording, place)

    @independent
    def _check_in_run(self, place: Place, change: Section, key: str, scenario: ScenarioSection) -> None:
        """Report a change that would never act on the plant; the scenario would not be what it says."""
        when = getattr(change, declared_fields(type(change))[key].name)
        late = late_error(when, self.study.loop.of(scenario).end)
        if late:
            self.errors.add((*place, key), late, *self._on_start(place))

    @independent
    def _check_event(
        self,
        place: Place,
        event: ParameterChange,
        tunable: Mapping[str, Variable],
        scenario: ScenarioSection,
    ) -> None:
        check_parameters(self.errors, place, "tunable parameter", event.parameters, tunable)
        for name in event.parameters:
            self._check_not_spread((*place, name), name, scenario)

    def _check_not_spread(self, place: Place, name: str, scenario: ScenarioSection) -> None:
        """Report the change of a parameter that seeds draw: after it all seeds have the same one."""
        if isinstance({**self.study.plant.parameters, **scenario.parameters}.get(name), Distribution):
            what = f"each seed draws its own {name}, and this puts the same number in place of all of them"
            self.errors.add(place, f"{what}; leave it out, or set parameters.{name} of the scenario")

    @independent
    def _check_drift(
        self,
        place: Place,
        drift: Drift,
        key: str,
        tunable: Mapping[str, Variable],
        scenario: ScenarioSection,
    ) -> None:
        value, at = getattr(drift, declared_fields(Drift)[key].name), (*place, key)
        if key == "parameter":
            self.errors.require_known(at, "tunable parameter", [value], tunable)
            self._check_not_spread(at, value, scenario)
        else:
            check_value(self.errors, at, value, tunable.get(drift.parameter))

    @independent
    def _check_drift_begins(self, place: Place, drift: Drift, scenario: ScenarioSection) -> None:
        begin = self.study.loop.of(scenario).start_time
        if drift.stop_time <= begin:
            start = f"t = {shown(begin)}"
            over = f"it would be over when the run starts at {start}; use the scenario's parameters"
            self.errors.add(place, over, *self._on_start(place))

    @staticmethod
    def _on_start(place: Place) -> tuple[Place, Place]:
        """Return where it is said when the run of a scenario begins, a place in which is given."""
        return ("loop", "start_time"), (*place[:2], "start_time")

    @independent
    def _check_start(self, place: Place, scenario: ScenarioSection) -> None:
        """Report a time of the first sample at which a run cannot begin."""
        loop = self.study.loop
        if scenario.start_time is None:
            return
        if loop.start == "recording-end":
            what = 'loop.start = "recording-end" goes on when the experiment ends; leave one of them out'
            self.errors.add(place, what, ("loop", "start"))
        try:
            end_time(scenario.start_time, loop.steps, loop.sampling_time)
        except ConfigError as error:
            for fault in error.faults:
                self.errors.add(place, fault, ("loop",))

    def _check_undriven(self, place: Place, scenario: ScenarioSection, name: str) -> None:
        """Check that nothing else decides the value of an input that has a signal."""
        if self.inputs.is_known and name in self.inputs.names:
            remedy = "use disturbances to add to it, or leave it out of plant.inputs"
            self.errors.add(place, f"the controllers drive this input; {remedy}")
        self._check_set_once(place, scenario, name)

    def _check_set_once(self, place: Place, scenario: ScenarioSection, name: str) -> None:
        others = {
            "the plant's parameters": name in self.study.plant.parameters,
            "the scenario's parameters": name in scenario.parameters,
            "an event": any(name in event.parameters for event in scenario.events),
            "a drift": any(name == drift.parameter for drift in scenario.drifts),
        }
        for what in (what for what, is_so in others.items() if is_so):
            self.errors.add(place, f"this input is set by {what} too; leave one of them out")

    @independent
    def _check_effect(self, place: Place, key: str, value: float, scenario: ScenarioSection) -> None:
        loop, recording, kind = self.study.loop, self.study.recording, all_conditions()[key]
        fault = kind.fault_of(value, loop.sampling_time, loop.steps)
        if recording is not None and scenario.recording is not None:
            recording = scenario.recording.of(recording)
        if not fault and recording is not None and recording.samples is not None:
            fault = kind.fault_of(value, loop.sampling_time, recording.samples - 1, "experiment")
        if fault:
            self.errors.add(place, fault)

    @independent
    def _check_disturbance(self, place: Place, signal: Reference, scenario: ScenarioSection) -> None:
        """Report steps and ramps that begin when the run is over."""
        loop = self.study.loop.of(scenario)
        begins = {"times": signal.times} if type(signal) is Steps else {}
        begins |= {"from_time": [signal.start_time]} if isinstance(signal, Ramp) else {}
        for key, times in begins.items():
            for late in filter(None, (late_error(t, loop.end) for t in times)):
                self.errors.add((*place, key), late, *self._on_start(place))

    def undriven(self, name: str) -> tuple[Variable, ...]:
        """Return the inputs that have a signal in a scenario, or while it is recorded."""
        scenario = self.study.scenarios[name]
        recorded = [sections for _, sections in self._recorded_inputs(scenario, ())]
        named = dict.fromkeys(itertools.chain(self._known.of_inputs, scenario.inputs, *recorded))
        return tuple(self.variables.inputs[signal] for signal in named)

    def _recorded_inputs(
        self, scenario: ScenarioSection, place: Place
    ) -> Iterator[tuple[Place, Mapping[str, Reference]]]:
        """Yield what the study and then the scenario say of inputs in the experiment, and where."""
        if self.study.recording is not None:
            yield ("recording", "inputs"), self.study.recording.inputs
        if scenario.recording is not None:
            yield (*place, "recording", "inputs"), scenario.recording.inputs
