"""The known disturbances of a loop: what acts, how it is measured, and what is expected of it."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ddpc_cosim.conditions import Actuators, Conditions
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.files.durations import shown
from ddpc_cosim.loop.outlook import Expected
from ddpc_cosim.plant import Plant
from ddpc_cosim.signals.disturbances import Forecasts, KnownDisturbance, RunTimes, is_foretelling
from ddpc_cosim.signals.signals import Reference, in_unit_of, values_at
from ddpc_cosim.variables import FloatArray, names, unknown_names

# Which stream of a seed errors of forecasts have: the others are those of loop.setup and of conditions.
_FORECAST_STREAM = 10
_MOST_ISSUES = 5
"""Moments of a run whose forecasts are kept with its samples."""


class ActingDisturbances:
    """What acts on a plant besides the inputs that are driven, and is measured.

    Parameters
    ----------
    declared : mapping of str to KnownDisturbance
        Inputs that no controller drives, or outputs, by name.
    recorded : mapping of str to Reference
        Signals of some of these inputs in the experiment, in place of their own course.
    plant : Plant
        The plant.
    conditions : Conditions
        Of the loop.
    sampling_time : float
        Time between samples [s].
    forecast_horizon : int or None
        The longest horizon of all controllers that are compared; none: that of the one in the loop.

    Attributes
    ----------
    conditions : Conditions
        Those given, in which the disturbances that are inputs of the plant have their signals.
    inputs : tuple of Variable
        The disturbances that are inputs, which are measured after all outputs of the plant.
    sensed : tuple of Variable
        All outputs, and these inputs.
    places : array of int, shape (n,)
        Where among these each disturbance is measured.
    lags : list of int
        By how many samples each is measured late.
    told_places : array of int, shape (n_d,)
        Which of them controllers are told of.
    told : tuple of Variable
        These.
    courses : array, shape (K, inputs)
        What the disturbances that are inputs are at the samples of the run that has been started.

    Raises
    ------
    ConfigError
        A name that the plant does not have, or a disturbance whose course is not known.
    """

    def __init__(
        self,
        declared: Mapping[str, KnownDisturbance],
        recorded: Mapping[str, Reference],
        plant: Plant,
        conditions: Conditions,
        sampling_time: float,
        forecast_horizon: int | None,
    ) -> None:
        self.declared, self._sampling_time = declared, sampling_time
        self._forecast_horizon = forecast_horizon
        self.conditions = self._given_signals(plant, conditions, recorded)
        inputs = {variable.name: variable for variable in plant.inputs}
        self.inputs = tuple(inputs[name] for name in declared if name in inputs)
        self.sensed = (*plant.outputs, *self.inputs)
        places = {variable.name: i for i, variable in reversed(list(enumerate(self.sensed)))}
        places |= {variable.name: len(plant.outputs) + i for i, variable in enumerate(self.inputs)}
        self.places = np.array([places[name] for name in declared], dtype=np.intp)
        self.lags = [disturbance.lag for disturbance in declared.values()]
        self._longest_lag = max(self.lags, default=0)
        self.courses = np.empty((0, 0))
        self.told_places = np.flatnonzero([disturbance.is_known for disturbance in declared.values()])
        self.told = tuple(self.sensed[place] for place in self.places[self.told_places])

    def draw_from(self, seed: int) -> None:
        """Have errors of forecasts of the next runs from a seed."""
        self._seed = seed

    def _given_signals(
        self, plant: Plant, conditions: Conditions, recorded: Mapping[str, Reference]
    ) -> Conditions:
        """Return conditions in which the disturbances that are inputs of the plant have their signals."""
        inputs, declared = names(plant.inputs), self.declared
        faults = unknown_names("disturbances", declared, (*inputs, *names(plant.outputs)))
        faults += unknown_names("recorded_disturbances", recorded, inputs)
        signals = {
            name: disturbance.signal
            for name, disturbance in declared.items()
            if name in inputs and disturbance.signal is not None
        }
        faults += [
            f"disturbances: {name} has no signal; needed: its course, as no controller drives this input"
            for name in declared
            if name in inputs and name not in signals and name not in conditions.inputs
        ]
        faults += [
            f"disturbances: {name} is an output; what it will be is needed for its forecasts: give it a "
            'signal, a file of forecasts, or known = "measured"'
            for name, disturbance in declared.items()
            if name not in inputs and disturbance.is_foretold and disturbance.signal is None
        ]
        faults += [
            f"recorded_disturbances: {name} is not among the disturbances"
            for name in recorded
            if name not in declared
        ]
        if faults:
            raise ConfigError(faults)
        if not declared:
            return conditions
        return replace(
            conditions,
            inputs={**conditions.inputs, **signals},
            recorded_inputs={**conditions.recorded_inputs, **recorded},
        )

    @property
    def looks_ahead(self) -> bool:
        """Whether what comes after the run is needed for forecasts."""
        return any(disturbance.is_foretold for disturbance in self.declared.values())

    def signals(self, *, in_experiment: bool, foretold: bool) -> dict[str, Reference]:
        """Return the courses of the inputs with forecasts from them, or without, by what errors call them."""
        if not self.inputs:
            return {}
        courses = dict(self.conditions.inputs)
        if in_experiment:
            courses |= self.conditions.recorded_inputs
        chosen = [name for name in names(self.inputs) if self.declared[name].is_foretold == foretold]
        return {f"disturbances: {name}": courses[name] for name in chosen}

    def check_unseen(self, experiment: tuple[float, float], run: tuple[float, float]) -> None:
        """Raise ConfigError for disturbances of which an experiment has what is to come in the run.

        Parameters
        ----------
        experiment, run : (float, float)
            Begin and end of both [s].
        """
        overlap = min(experiment[1], run[1]) - max(experiment[0], run[0])
        if overlap <= 1e-6 * self._sampling_time:
            return
        conditions = self.conditions
        seen = [
            name
            for name in names(self.inputs)
            if name not in conditions.recorded_inputs and is_foretelling(conditions.inputs[name])
        ]
        if seen:
            when = f"from t = {shown(experiment[0])} to {shown(experiment[1])}, the run from {shown(run[0])}"
            remedy = "let it end before, by recording_start, or give recorded_disturbances"
            what = f"the experiment has the run's own course: it is {when}; {remedy}"
            raise ConfigError([f"disturbances: {name}: {what}" for name in seen])

    def start(self, actuators: Actuators, *, continues: bool) -> None:
        """Prepare for a run for which the actuators have been started; it may go on from the one before."""
        if self.inputs:
            self.courses = np.column_stack([actuators.course(variable.name) for variable in self.inputs])
            # What is known before the run of a row of all that is sensed: a sample only adds the outputs.
            self._sensed = np.empty((len(self.courses), len(self.sensed)))
            self._sensed[:, -len(self.inputs) :] = self.courses
        if not continues:
            self._past = list[FloatArray]()

    def with_inputs(self, k: int, y_plant: FloatArray) -> FloatArray:
        """Return the plant's outputs at sample k, and after them the disturbances that are inputs."""
        row: FloatArray = self._sensed[k]
        row[: len(y_plant)] = y_plant
        return row

    def measured(self, y: FloatArray, seen: FloatArray) -> FloatArray:
        """Return them as measured, the last value in place of one that is missing, or late, shape (n,).

        Parameters
        ----------
        y, seen : array
            The outputs and these inputs, as they are and as sensors tell them.
        """
        now, past = seen[self.places], self._past
        if math.isnan(sum(now.tolist())):
            now = np.where(np.isnan(now), past[-1] if past else y[self.places], now)
        if not self._longest_lag:
            self._past = [now]
            return now
        past.append(now)
        del past[: -1 - self._longest_lag]
        return np.array([past[max(-1 - lag, -len(past))][i] for i, lag in enumerate(self.lags)])

    def issues(self, horizon: int, samples: int) -> range:
        """Return at which samples of a run the forecast is kept: a few, so far apart that none overlap."""
        longest = horizon if self._forecast_horizon is None else self._forecast_horizon
        return range(0, samples, max(longest + 1, -(-samples // _MOST_ISSUES)))

    def expected(self, time: FloatArray, first: int, samples: int, *, is_before: bool) -> Expected:
        """Return what is expected of them at the samples of a run that has been started.

        Parameters
        ----------
        time : array, shape (N,)
            From the first sample that controllers see on [s], horizon included.
        first : int
            Its number among those of the run.
        samples : int
            Number of samples of the run from there on.
        is_before : bool
            It is an experiment or a warm-up, which files of forecasts need not tell: there they are not used.
        """
        if not self.told:
            return Expected((), (), np.empty((first + len(time), 0)), first, samples)
        times = RunTimes(float(time[0]), self._sampling_time, samples)
        ahead = len(time) - samples
        longest = ahead if self._forecast_horizon is None else self._forecast_horizon
        whole = np.concatenate([time[0] + np.arange(-first, 0) * self._sampling_time, time])
        truth = np.full((len(whole), len(self.told)), np.nan)
        forecasts, lags = list[Forecasts | None](), list[int]()
        for i, variable in enumerate(self.told):
            disturbance = self.declared[variable.name]
            if variable in self.inputs:
                course = self.courses[: len(truth), self.inputs.index(variable)]
                truth[: len(course), i] = course
            elif disturbance.signal is not None:
                signal, what = in_unit_of(variable, disturbance.signal), f"disturbances of {variable.name}"
                truth[:, i] = values_at(signal, what, whole)
            lags.append(disturbance.lag)
            if is_before and disturbance.forecast is not None:
                forecasts.append(None)
                continue
            seed = [self._seed, _FORECAST_STREAM, *variable.name.encode()]
            rng = np.random.default_rng(seed)
            forecasts.append(disturbance.forecasts(variable, truth[first:, i], times, longest, rng))
        return Expected(forecasts, lags, truth, first, samples)
