"""The known disturbances of a study: which they are, their signals, and whether files reach far enough."""

from collections.abc import Iterator, Mapping
from dataclasses import replace

from ddpc_cosim.codec import independent
from ddpc_cosim.disturbances import KnownDisturbance
from ddpc_cosim.durations import in_words
from ddpc_cosim.errors import Place
from ddpc_cosim.signals import Constant, Reference, SignalFromFile, Steps, WhiteNoise
from ddpc_cosim.study.selection import SelectedSignals
from ddpc_cosim.variables import Variable

_DISTURBANCES: Place = ("disturbances",)
_RECORDED: Place = ("recording", "disturbances")
_FORECAST_BY_SIGNAL = ("low", "medium", "high", "perfect")
_TIMES = 1e-9  # what rounding leaves of a time, in parts of the sampling time


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
                if known.forecast is None and known.known in _FORECAST_BY_SIGNAL:
                    what = f'needs a signal, of which forecasts with known = "{known.known}" are made'
                    self.errors.add((*_DISTURBANCES, name), what, (*_DISTURBANCES, name, "signal"))

    def of(self, scenario: str) -> dict[str, KnownDisturbance]:
        """Return what is known in a scenario; the signals of inputs are among its conditions."""
        known = dict[str, KnownDisturbance]()
        for name, section in self._sections.items():
            signal = None if name in self.of_inputs else self.signals.get(name)
            disturbance = replace(section, signal=signal)
            if (level := self.study.scenarios[scenario].known.get(name)) is not None:
                disturbance = replace(disturbance, known=level, forecast=None)
            known[name] = disturbance
        return known

    def of_inputs_in(self, scenario_inputs: Mapping[str, Reference]) -> dict[str, Reference]:
        """Return the signals of inputs in a scenario, given those that it says itself."""
        signals = {name: signal for name, signal in self.signals.items() if name in self.of_inputs}
        return signals | {name: s for name, s in scenario_inputs.items() if name in self.of_inputs}

    def _said(self) -> Iterator[tuple[Place, object, Variable, str]]:
        """Yield each signal that is said: where, what, its variable, and when it acts."""
        for name, variable in self.variables.items():
            signal = self._sections[name].signal
            in_experiment = name in self.of_inputs and name not in (self.recorded or {})
            yield (*_DISTURBANCES, name, "signal"), signal, variable, "both" if in_experiment else "run"
            for scenario, section in self.study.scenarios.items():
                place = ("scenarios", scenario, "inputs", name)
                yield place, section.inputs.get(name), variable, "both" if in_experiment else "run"
            if self.study.recording is not None:
                recorded = self.study.recording.disturbances.get(name)
                yield (*_RECORDED, name), recorded, variable, "experiment"

    @independent
    def _check_reach(self) -> None:
        """Report files that end before the run and its forecasts do, or begin after the experiment."""
        for place, signal, variable, when in self._said():
            if isinstance(signal, SignalFromFile):
                built = self._selected.level(place, signal, variable)
                if built is not None:
                    self._check_covered(place, built, when)

    @independent
    def _check_covered(self, place: Place, signal: Reference, when: str) -> None:
        """Report a signal of a file that does not cover what it is for."""
        loop, experiment = self.study.loop, self._experiment()
        begin, end = loop.start_time - loop.warm_up, loop.end + self._horizon * loop.sampling_time
        words = "the run and the longest horizon"
        if experiment is not None and when != "run":
            words = "the experiment" if when == "experiment" else f"the experiment, {words}"
            begin = min(begin, experiment[0]) if when == "both" else experiment[0]
            end = end if when == "both" else experiment[1] - loop.sampling_time
        check_covers(self._selected, place, signal, (begin, end), words)

    def _experiment(self) -> tuple[float, float] | None:
        """Return when the experiments of all scenarios begin and end [s]; None without one."""
        loop, recording = self.study.loop, self.study.recording
        if recording is None:
            return None
        times = list[tuple[float, float]]()
        for scenario in self.study.scenarios.values():
            changed = scenario.recording.of(recording) if scenario.recording is not None else recording
            begin = changed.begins(loop, is_disturbed=bool(self._sections))
            if begin is not None and changed.samples is not None:
                times.append((begin, begin + changed.samples * loop.sampling_time))
        return (min(begin for begin, _ in times), max(end for _, end in times)) if times else None

    @independent
    def _check_times(self) -> None:
        """Report a disturbance that acts in the run as it did in the experiment, which data would tell."""
        loop, experiment = self.study.loop, self._experiment()
        if experiment is None:
            return
        begin, end = experiment
        rounding = _TIMES * loop.sampling_time
        if end <= loop.start_time + rounding or begin > loop.end + rounding:
            return
        place, recorded = ("recording", "start_time"), self.recorded or {}
        times = f"{in_words(begin)} to {in_words(end)}"
        run = f"{in_words(loop.start_time)} to {in_words(loop.end)}"
        for name in self.of_inputs:
            signal = self.signals.get(name)
            in_experiment = recorded.get(name, signal)
            is_same = signal is not None and in_experiment == signal
            if is_same and not isinstance(signal, Constant | WhiteNoise):
                remedy = f"begin it at {in_words(loop.start_time - (end - begin))} or before, or give "
                remedy += f"recording.disturbances.{name}"
                what = f"the experiment, {times}, would show the {name} of the run, {run}; {remedy}"
                self.errors.add(place, what, ("loop", "start_time"))


def check_covers(
    selected: SelectedSignals, place: Place, signal: Reference, needed: tuple[float, float], words: str
) -> None:
    """Report a signal from a file, built, whose rows do not reach from one time to another [s]."""
    loop = selected.study.loop
    if not isinstance(signal, Steps):
        return
    first, last = float(signal.times[0]), float(signal.times[-1])
    begin, end = needed
    rounding = _TIMES * loop.sampling_time
    if first > begin + rounding or last < end - rounding:
        rows = f"its rows are from {in_words(first)} to {in_words(last)}"
        times = f"{in_words(begin)} to {in_words(end)}"
        selected.errors.add((*place, "file"), f"{rows}; needed: {times}, {words}", ("loop", "start_time"))
