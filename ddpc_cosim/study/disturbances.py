"""The known disturbances of a study: which they are, their signals, and whether files reach far enough."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

from ddpc_cosim.codec import InvalidFieldError, independent
from ddpc_cosim.errors import ConfigError, DataError, Place
from ddpc_cosim.files.durations import in_words
from ddpc_cosim.signals.disturbances import KnownDisturbance, RunTimes, is_foretelling
from ddpc_cosim.signals.signals import Reference, SignalFromFile, SignalFromResource
from ddpc_cosim.study.file_format.sections import LoopSection, ScenarioSection
from ddpc_cosim.study.selection import SelectedSignals
from ddpc_cosim.variables import Variable

_DISTURBANCES: Place = ("disturbances",)
_RECORDED: Place = ("recording", "disturbances")
_ROUNDED = 1e-6  # in parts of the sampling time


class Disturbances:
    """The known disturbances of a study, whose signals are selected; what does not fit is reported.

    Parameters
    ----------
    signals : SelectedSignals
        The study and its signals.
    horizon : int
        The longest horizon of its controllers, as far as forecasts reach.
    """

    def __init__(self, signals: SelectedSignals, horizon: int) -> None:
        self.study, self.errors, self._selected, self._horizon = (
            signals.study,
            signals.errors,
            signals,
            horizon,
        )
        self._sections = self.study.disturbances
        inputs, outputs = signals.variables.inputs, signals.variables.outputs
        known = {**outputs, **inputs}
        self.errors.require_known(_DISTURBANCES, "input or output", self._sections, known)
        self.variables = {name: known[name] for name in self._sections if name in known}
        self.of_inputs = {name: variable for name, variable in self.variables.items() if name in inputs}
        self._check_selection()
        self.signals = self._build()
        self.recorded = self._recorded()
        self._check_scenarios()
        self._check_reach()
        self._check_times()

    @independent
    def _check_selection(self) -> None:
        """Report disturbances that controllers drive or control."""
        inputs, outputs = self._selected.inputs, self._selected.outputs
        for name in self.variables:
            if name in self.of_inputs and inputs.is_known and name in inputs.names:
                what = "the controllers drive this input; leave it out of plant.inputs"
                self.errors.add((*_DISTURBANCES, name), what, ("plant", "inputs"))
            elif name not in self.of_inputs and outputs.is_known and name in outputs.names:
                what = "the controllers control this output; leave it out of plant.outputs"
                self.errors.add((*_DISTURBANCES, name), what, ("plant", "outputs"))
        if self.of_inputs and inputs.is_known and not inputs.names:
            self.errors.add(_DISTURBANCES, "every input of the plant is one; leave one to the controllers")

    def _build(self) -> dict[str, Reference]:
        """Return the signals of those that have one, in the variables' units."""
        signals = dict[str, Reference]()
        for name, variable in self.variables.items():
            signal = self._sections[name].signal
            if signal is not None:
                built = self._selected.level((*_DISTURBANCES, name, "signal"), signal, variable)
                signals |= {} if built is None else {name: built}
        return signals

    @independent
    def _recorded(self) -> dict[str, Reference] | None:
        """Return the signals that disturbances have in the experiment."""
        recording = self.study.recording
        if recording is None:
            return {}
        self.errors.require_known(_RECORDED, "known disturbance", recording.disturbances, self._sections)
        for name in recording.disturbances:
            if name in self.variables and name not in self.of_inputs:
                self.errors.add((*_RECORDED, name), "is an output: the plant says what it was")
        for name in recording.inputs:
            if name in self._sections:
                what = "is a known disturbance; use recording.disturbances"
                self.errors.add(("recording", "inputs", name), what)
        return self._selected.build(_RECORDED, recording.disturbances, self.of_inputs)

    @independent
    def _check_scenarios(self) -> None:
        """Report disturbances without a signal where one is needed, and what is known of others."""
        for scenario, section in self.study.scenarios.items():
            place = ("scenarios", scenario, "known")
            self.errors.require_known(place, "known disturbance", section.known, self._sections)
        for name in self.variables:
            given = self._sections[name]
            lacking = [key for key, section in self.study.scenarios.items() if name not in section.inputs]
            if given.signal is None and name in self.of_inputs and lacking:
                listed = ", ".join(lacking)
                what = f"needs a signal, or one in the inputs of each scenario; none in: {listed}"
                self.errors.add((*_DISTURBANCES, name), what, (*_DISTURBANCES, name, "signal"))
            for key in self.study.scenarios if given.signal is None and name not in self.of_inputs else ():
                known = self.of(key)[name]
                if known.is_foretold:
                    what = f'needs a signal, of which forecasts with known = "{known.known}" are made'
                    self.errors.add((*_DISTURBANCES, name), what, (*_DISTURBANCES, name, "signal"))

    def of(self, scenario: str) -> dict[str, KnownDisturbance]:
        """Return what is known in a scenario; the signals of inputs are among its conditions."""
        known = dict[str, KnownDisturbance]()
        for name, section in self._sections.items():
            signal = None if name in self.of_inputs else self.signals.get(name)
            level = self.study.scenarios[scenario].known.get(name)
            is_replaced = level is not None or (*_DISTURBANCES, name) in self.errors.found
            forecast = None if is_replaced else section.forecast
            known[name] = replace(section, signal=signal, known=level or section.known, forecast=forecast)
        return known

    def count(self, scenario: str) -> int:
        """Return of how many a scenario lets controllers know, but for those that are wrong."""
        wrong = {place[1] for place in self.errors.found if place[:1] == _DISTURBANCES and place[1:]}
        possible = self.variables.keys() - wrong
        return sum(known.is_known for name, known in self.of(scenario).items() if name in possible)

    def of_inputs_in(self, scenario_inputs: Mapping[str, Reference]) -> dict[str, Reference]:
        """Return the signals of inputs in a scenario, given those that it says itself."""
        signals = {name: signal for name, signal in self.signals.items() if name in self.of_inputs}
        return signals | {name: s for name, s in scenario_inputs.items() if name in self.of_inputs}

    def _said(self) -> Iterator[tuple[Place, Reference | None, str, bool]]:
        """Yield each signal that is said: where, what, in what it acts, and whether it is told ahead."""
        recorded = {} if self.study.recording is None else self.study.recording.disturbances
        scenarios = self.study.scenarios
        foretold = {
            scenario: {n for n, d in self.of(scenario).items() if d.is_foretold} for scenario in scenarios
        }
        for name in self.variables:
            acts_in = "both" if name in self.of_inputs and name not in recorded else "run"
            is_ahead = any(
                name in foretold[scenario] - {*scenarios[scenario].inputs} for scenario in scenarios
            )
            yield (*_DISTURBANCES, name, "signal"), self._sections[name].signal, acts_in, is_ahead
            for scenario, section in scenarios.items():
                place = ("scenarios", scenario, "inputs", name)
                yield place, section.inputs.get(name), acts_in, name in foretold[scenario]
            yield (*_RECORDED, name), recorded.get(name), "experiment", False

    @independent
    def _check_reach(self) -> None:
        """Report files that end before the run and its forecasts do, or begin after the experiment."""
        loop, study = self.study.loop, self.study
        ahead = self._horizon * loop.sampling_time
        experiments = [times for name in study.scenarios if (times := self._experiment(name)) is not None]
        experiment = (min(b for b, _ in experiments), max(e for _, e in experiments)) if experiments else None
        for place, signal, acts_in, is_ahead in self._said():
            begin, end = self._selected.span_at(place)
            first, last = begin, end + ahead * is_ahead
            if experiment is not None and acts_in == "experiment":
                first, last = experiment[0], experiment[1] - loop.sampling_time
            elif experiment is not None and acts_in == "both":
                first = min(begin, experiment[0])
            check_reach(self._selected, place, signal, first, last)
        for name, variable in self.variables.items():
            self._check_forecast(name, variable)
            if (lag := self._sections[name].lag) > loop.steps:
                what = f"{lag} samples are too many: the run has {loop.steps + 1}; choose a shorter lag"
                self.errors.add((*_DISTURBANCES, name, "lag"), what, ("loop",))

    @independent
    def _check_forecast(self, name: str, variable: Variable) -> None:
        """Report what is wrong with a file of forecasts, or where it ends too early."""
        forecast, loop = self._sections[name].forecast, self.study.loop
        if forecast is None:
            return
        place = (*_DISTURBANCES, name, "forecast")
        runs = [RunTimes(each.start_time, loop.sampling_time, loop.steps + 1) for each in self.study.loops]
        try:
            for times in runs:
                forecast.read(variable, times, self._horizon)
        except DataError as error:
            for fault in error.faults:
                self.errors.add((*place, "file"), fault, ("loop",))
        except ConfigError as error:
            for fault in error.faults:
                self.errors.add((*place, "unit"), fault)

    def _experiment(self, scenario: str) -> tuple[float, float] | None:
        """Return when the experiment of a scenario begins and ends [s]; None without one."""
        section, recording = self.study.scenarios[scenario], self.study.recording
        if recording is None:
            return None
        loop = self.study.loop.of(section)
        changed = section.recording.of(recording) if section.recording is not None else recording
        begin = changed.begins(loop, is_disturbed=bool(self._sections))
        if begin is None or changed.samples is None:
            return None
        return begin, begin + changed.samples * loop.sampling_time

    @independent
    def _check_times(self) -> None:
        """Report a disturbance that acts in the run as it did in the experiment, which data would tell."""
        for scenario, section in self.study.scenarios.items():
            loop, experiment = self.study.loop.of(section), self._experiment(scenario)
            if experiment is None:
                continue
            begin, end = experiment
            if min(end, loop.end) - max(begin, loop.start_time) > _ROUNDED * loop.sampling_time:
                self._check_repeated(section, loop, experiment)

    def _check_repeated(
        self, section: ScenarioSection, loop: LoopSection, experiment: tuple[float, float]
    ) -> None:
        """Report what an experiment at the time of a scenario's run would show of it."""
        begin, end = experiment
        times = f"{in_words(begin)} to {in_words(end)}"
        run = f"{in_words(loop.start_time)} to {in_words(loop.end)}"
        recorded = self.recorded or {}
        for name in self.of_inputs:
            signal = section.inputs.get(name, self.signals.get(name))
            is_same = signal is not None and signal == recorded.get(name, signal) and is_foretelling(signal)
            if is_same:
                remedy = f"begin it at {in_words(loop.start_time - (end - begin))} or before, or give "
                remedy += f"recording.disturbances.{name}"
                what = f"the experiment, {times}, would show the {name} of the run, {run}; {remedy}"
                self.errors.add(("recording", "start_time"), what, ("loop", "start_time"))


def check_reach(selected: SelectedSignals, place: Place, signal: object, first: float, last: float) -> None:
    """Report a signal from a file or a table, or with one, that does not tell it between two times [s]."""
    for i, part in enumerate(getattr(signal, "parts", ())):
        check_reach(selected, (*place, "parts", i), part, first, last)
    if not isinstance(signal, SignalFromFile | SignalFromResource):
        return
    if (*place, "file") in selected.errors.found:
        return
    try:
        tabled = selected.tabled(signal) if isinstance(signal, SignalFromResource) else signal
        gap = tabled.gap(first, last)
    except (InvalidFieldError, DataError):  # reported where it is read
        return
    if gap:
        selected.errors.add((*place, "file"), gap, ("loop",))
