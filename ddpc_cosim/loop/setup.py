"""What a loop is made of, checked before its first sample: times, signals, noise, limits, references."""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import compress
from numbers import Integral, Real
from types import NoneType
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.conditions import (
    Actuators,
    Conditions,
    MixedNormal,
    Sensors,
    SensorTables,
    changed_inputs,
    may_have,
)
from ddpc_cosim.controller import Controller, Loop, Recording
from ddpc_cosim.description import applied_output
from ddpc_cosim.errors import ConfigError, DataError
from ddpc_cosim.files.durations import shown
from ddpc_cosim.loop.disturbances import ActingDisturbances
from ddpc_cosim.loop.outlook import Limit, Limits, Outlook, Wanted, Wish, intersample_signals, table_widths
from ddpc_cosim.loop.plant_control import PlantControl
from ddpc_cosim.loop.prices import ChargedSignals
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.signals.disturbances import Knowledge, KnownDisturbance
from ddpc_cosim.signals.excitations import Excitation
from ddpc_cosim.signals.prices import Price
from ddpc_cosim.signals.signals import (
    Band,
    Constant,
    GaussianNoise,
    ParameterChange,
    Reference,
    SignalFromFile,
)
from ddpc_cosim.variables import FloatArray, Variable, names, not_names, unknown_names

MOST_STEPS = 100_000_000
_NOTHING: FloatArray = np.empty(0)
EngineName = Literal["python", "compiled"]
"""What computes the samples of a loop."""
# Which stream of a seed serves which purpose; a new one gets a new number. From 3 to 9: conditions; 10:
# forecasts of disturbances.
CONTROLLER_STREAM, NOISE_STREAM, STABILISER_STREAM, WARM_UP_STREAM = 0, 1, 2, 11
_NEVER_DRAWN = np.random.default_rng(0)


def check_sampling_time(sampling_time: float) -> None:
    """Raise ConfigError if this time between samples [s] is not possible."""
    if not (_is_finite(sampling_time) and sampling_time > 0):
        raise ConfigError(f"sampling_time = {sampling_time} is not possible; allowed: a number > 0")


def whole_steps(duration: float, sampling_time: float) -> int:
    """Return the number of sampling intervals in a duration.

    Raises
    ------
    ConfigError
        It is not an integer, or too large.
    """
    check_sampling_time(sampling_time)
    if not _is_finite(duration):
        raise ConfigError(f"duration = {duration} is not possible; allowed: a number > 0")
    steps = duration / sampling_time
    if not steps < MOST_STEPS:
        raise ConfigError(f"duration / sampling_time = {steps:g} samples; allowed: 1 to {MOST_STEPS:.0e}")
    if round(steps) < 1 or abs(round(steps) * sampling_time - duration) > 1e-9 * max(duration, sampling_time):
        raise ConfigError(
            f"duration = {duration:g} must be a whole multiple of sampling_time = {sampling_time:g}"
        )
    return round(steps)


def communication_steps(sampling_time: float, communication_step: float | None) -> int:
    """Return in how many steps the plant is advanced in a sampling interval; None: in one.

    Raises
    ------
    ConfigError
        They do not make up the interval.
    """
    if communication_step is None:
        return 1
    if not (_is_finite(communication_step) and communication_step > 0.0):
        raise ConfigError(f"communication_step = {communication_step} is not possible; allowed: a number > 0")
    steps = round(min(sampling_time / communication_step, MOST_STEPS))
    if (
        steps < 1
        or steps == MOST_STEPS
        or abs(steps * communication_step - sampling_time) > 1e-9 * sampling_time
    ):
        whole = f"sampling_time, {shown(sampling_time)}, must be an integer multiple of it"
        raise ConfigError(f"communication_step = {shown(communication_step)}: {whole}")
    return steps


def end_time(start_time: float, steps: int, sampling_time: float) -> float:
    """Return the time of the last sample [s].

    Raises
    ------
    ConfigError
        The start time is not a number, or so large that one sample cannot be told from the next.
    """
    if not _is_finite(start_time):
        raise ConfigError(f"start_time = {start_time} is not possible; allowed: a finite number")
    end = start_time + steps * sampling_time
    if np.spacing(max(abs(start_time), abs(end))) > 1e-3 * sampling_time:
        raise ConfigError(
            f"start_time = {start_time:g} is too large: samples {sampling_time:g} s apart coincide there"
        )
    return end


def check_seed(seed: int) -> None:
    """Raise ConfigError if this seed is not possible."""
    if not isinstance(seed, Integral) or seed < 0:
        raise ConfigError(f"seed = {seed!r} is not possible; allowed: an integer >= 0")


def check_preview(preview: int | None) -> None:
    """Raise ConfigError if this number of future references that anyone may see is not possible."""
    if preview is not None and not _is_count(preview):
        raise ConfigError(
            f"preview = {preview!r} is not possible; allowed: an integer >= 0, or None: no limit"
        )


_KINDS: dict[str, tuple[type, ...]] = {
    "excitation": (Excitation,),
    "recording": (Recording,),
    "noise": (GaussianNoise,),
    "conditions": (Conditions,),
    "stabiliser": (Controller,),
    "warm_up_controller": (Controller,),
}
_NAMED_KINDS: dict[str, tuple[type, ...]] = {
    "reference": (Reference, Band),
    "disturbances": (KnownDisturbance,),
    "recorded_disturbances": (Reference,),
    "prices": (Price,),
    "monitors": (Band, NoneType),
    "bounds": (object,),  # said where they are read
}


def check_kinds(**given: Any) -> None:
    """Raise ConfigError for all keywords of :func:`ddpc_cosim.cosimulate` whose value they cannot have.

    What is None is not given. What fits no name of the plant, or not together, is said where that is known.
    """
    faults = list[str]()
    for key, value in given.items():
        if value is None or (key == "reference" and isinstance(value, Reference | Band)):
            continue
        if key in _KINDS and not isinstance(value, _KINDS[key]):
            faults.append(f"{key} = {value!r}; needed: {_in_words(_KINDS[key])}")
        elif key in _NAMED_KINDS and not isinstance(value, Mapping):
            faults.append(f"{key} = {value!r}; needed: for each name {_in_words(_NAMED_KINDS[key])}")
        elif key in _NAMED_KINDS:
            faults += [
                f"{key}: {name} = {entry!r}; needed: {_in_words(_NAMED_KINDS[key])}{_such_as(key, entry)}"
                for name, entry in value.items()
                if not isinstance(entry, _NAMED_KINDS[key])
            ]
        elif key == "events":
            wrong = [event for event in value if not isinstance(event, ParameterChange)]
            faults += [f"events: {event!r}; needed: a ParameterChange" for event in wrong]
        elif key == "forecast_horizon" and not _is_count(value):
            needed = "allowed: an integer >= 0, or None: that of the controller"
            faults.append(f"{key} = {value!r} is not possible; {needed}")
        elif key == "recording_start" and not _is_finite(value):
            needed = "allowed: a finite number, or None: where the default begins it"
            faults.append(f"{key} = {value!r} is not possible; {needed}")
        elif key == "warm_up" and not (_is_finite(value) and value >= 0):
            faults.append(f"{key} = {value!r} is not possible; allowed: a number >= 0")
    if faults:
        raise ConfigError(faults)


def _in_words(kinds: tuple[type, ...]) -> str:
    if kinds == (object,):
        return "two limits"
    words = {Reference: "a signal of time", Excitation: "an Excitation", Conditions: "Conditions"}
    words[NoneType] = "None"
    return " or ".join(words.get(kind, f"a {kind.__name__}") for kind in kinds)


def _such_as(key: str, entry: Any) -> str:
    """Return what may be meant by an entry of another kind."""
    if key == "disturbances":
        known = entry if isinstance(entry, str) and entry in get_args(Knowledge) else "measured"
        said = "signal=..." if isinstance(entry, Reference) else f'known="{known}"'
        return f", such as KnownDisturbance({said})"
    if key == "prices":
        level = f"{entry:g}" if _is_finite(entry) else "..."
        return f', such as Price(signal="...", price={level}, unit="EUR/kWh")'
    return f", such as Constant({entry:g})" if _is_finite(entry) else ""


def check_events(events: Sequence[ParameterChange], end: float) -> None:
    """Raise ConfigError for every event that would never act on the plant, as the run ends before."""
    late = [fault for event in events if (fault := late_error(event.time, end))]
    if late:
        raise ConfigError([f"events: {fault}" for fault in late])


def late_error(time: float, end: float) -> str:
    """Return why a change at a time [s] would never act on the plant; empty if it would."""
    if time < end:
        return ""
    advice = "choose an earlier time or a longer duration"
    return f"at t = {shown(time)} it would not happen: the run ends at t = {shown(end)}; {advice}"


def check_names(what: str, given: Iterable[str], known: Sequence[Variable]) -> None:
    """Raise ConfigError for every given name that is not among the known variables."""
    if faults := unknown_names(what, given, names(known)):
        raise ConfigError(faults)


def excitation_table(excitation: Excitation, inputs: int) -> FloatArray:
    """Return an excitation, which may be of any class, shape (T, inputs)."""
    table = np.asarray(excitation.draw(inputs), dtype=np.float64)
    if table.ndim != 2 or not len(table) or table.shape[1] != inputs or not np.isfinite(table).all():
        needed = f"needed: finite values, shape (T, {inputs}) with T >= 1"
        raise ConfigError(f"excitation: {type(excitation).__name__}.draw: shape {table.shape}; {needed}")
    return table


class Measured(NamedTuple):
    """The plant at a sample.

    Parameters
    ----------
    y : array, shape (p,)
        Controlled outputs, as they are.
    seen, measured : array, shapes (p,) and (q,)
        Controlled outputs and measurements, as a controller sees them.
    status : str
        Empty, or why a controller sees something older.
    d, told : arrays, shapes (n,) and (n_d,)
        The disturbances as measured, all of them and those that controllers are told.
    all_outputs : array
        All outputs of the plant, as they are.
    """

    y: FloatArray
    seen: FloatArray
    measured: FloatArray
    status: str
    d: FloatArray
    told: FloatArray
    all_outputs: FloatArray


class LoopSetup:
    """A plant in a loop: what is driven, controlled and measured, with what limits and in what conditions.

    Parameters
    ----------
    plant : Plant
        The plant.
    sampling_time, outputs, measurements, bounds, noise, conditions, preview
        As in :func:`ddpc_cosim.cosimulate`.
    open_loop : bool
        Nothing is controlled: inputs without a signal rest at their start values.
    is_free : bool
        Nothing is controlled, and inputs are left to the plant.
    disturbances, recorded_disturbances, prices, forecast_horizon, monitors, communication_step
        As in :func:`ddpc_cosim.cosimulate`.

    Raises
    ------
    ConfigError
        Names that the plant does not have, impossible values, or nothing to drive or to read in a closed
        loop.
    """

    def __init__(
        self,
        plant: Plant,
        sampling_time: float,
        outputs: Sequence[str] | None,
        measurements: Sequence[str] | None,
        bounds: Mapping[str, tuple[Limit, Limit]] | None,
        noise: GaussianNoise | None,
        conditions: Conditions | None,
        preview: int | None,
        *,
        open_loop: bool = False,
        is_free: bool = False,
        disturbances: Mapping[str, KnownDisturbance] | None = None,
        recorded_disturbances: Mapping[str, Reference] | None = None,
        prices: Mapping[str, Price] | None = None,
        forecast_horizon: int | None = None,
        monitors: Mapping[str, Band | None] | None = None,
        communication_step: float | None = None,
    ) -> None:
        check_sampling_time(sampling_time)
        self.substeps = communication_steps(sampling_time, communication_step)
        check_preview(preview)
        missing = [what for what, has in (("inputs", plant.inputs), ("outputs", plant.outputs)) if not has]
        if missing and not open_loop:
            raise ConfigError([f"the plant has no {what}: there is nothing to control" for what in missing])
        available = names(plant.outputs)
        controlled = () if open_loop or is_free else _chosen("outputs", outputs) or available
        measured = _chosen("measurements", measurements) or available
        check_names("outputs and measurements", dict.fromkeys((*controlled, *measured)), plant.outputs)
        self._monitors = monitors or {}
        check_names("monitors", self._monitors, plant.outputs)
        self.plant, self.sampling_time, self._preview = plant, sampling_time, preview
        self._outputs = np.array([available.index(name) for name in controlled], dtype=np.intp)
        self._measured = np.array([available.index(name) for name in measured], dtype=np.intp)
        self.monitored = np.array([available.index(name) for name in self._monitors], dtype=np.intp)
        self.monitors = tuple(plant.outputs[i] for i in self.monitored)
        self.monitored_bands = tuple(name for name, band in self._monitors.items() if band is not None)
        self.outputs = tuple(plant.outputs[i] for i in self._outputs)
        self.measurements = tuple(plant.outputs[i] for i in self._measured)
        self.disturbances = ActingDisturbances(
            disturbances or {},
            recorded_disturbances or {},
            plant,
            conditions or Conditions(),
            sampling_time,
            forecast_horizon,
        )
        conditions = self.disturbances.conditions
        if open_loop:
            resting = {variable.name: Constant(variable.start) for variable in plant.inputs}
            conditions = replace(conditions, inputs={**resting, **conditions.inputs})
        self._conditions, self._open_loop = conditions, open_loop
        self.inputs = tuple(v for v in plant.inputs if v.name not in conditions.inputs)
        given = names(plant.inputs)
        # In open loop, a switch is an input like others; so is one that has a signal of its own.
        self._switches = {
            name: switch
            for name, switch in plant.switches.items()
            if name in given and switch not in given and not open_loop
        }
        self._is_driven = np.array([name not in conditions.inputs for name in given], dtype=bool)
        self._is_left = self._is_driven & np.array([name in self._switches for name in given], dtype=bool)
        self.changed_inputs = changed_inputs(conditions, plant.inputs)
        self._given_bounds = _checked_bounds(self.inputs, self.outputs, bounds or {})
        seen = (*self.inputs, *self.outputs, *self.measurements, *self.disturbances.inputs)
        self.charged = ChargedSignals(prices or {}, plant, seen, self._is_left)
        between = intersample_signals(self.substeps, controlled, prices or {}, self._monitors, given)
        self.intersample = np.array([available.index(name) for name in between], dtype=np.intp)
        self._check_conditions(conditions)
        self.rest = self._resting()
        self.actuators = Actuators(plant.inputs, self.rest, conditions, sampling_time)
        deviation = self._deviations(noise.standard_deviation if noise else {})
        self._sensors = Sensors(self.disturbances.sensed, deviation, conditions, sampling_time)

    def draw_from(self, seed: int, mixture: Sequence[tuple[int, float]] = ()) -> None:
        """Have all that is random in the next run from a seed, its noise from others if they are given.

        Raises
        ------
        ConfigError
            The seed is not possible.
        """
        check_seed(seed)
        self._seed = seed
        streams = [
            (np.random.default_rng([stream, NOISE_STREAM]), weight)
            for stream, weight in mixture or ((seed, 1.0),)
        ]
        self.disturbances.draw_from(seed)
        self.actuators.draw_from(seed)
        self._sensors.draw_from(seed, MixedNormal(streams))

    @property
    def communication_step(self) -> float:
        """How far the plant is advanced at once [s]."""
        return self.sampling_time / self.substeps

    def _resting(self) -> FloatArray:
        pairs = [self._given_bounds.get(v.name, (v.min, v.max)) for v in self.inputs]
        low = [-math.inf if isinstance(lower, Reference) else lower for lower, _ in pairs]
        high = [math.inf if isinstance(upper, Reference) else upper for _, upper in pairs]
        return np.minimum(np.maximum([v.start for v in self.inputs], low), high, dtype=np.float64)

    def limits(self, time: FloatArray) -> Limits:
        """Return the limits of inputs and controlled outputs at times [s], shape (K,)."""
        return Limits.over((*self.inputs, *self.outputs), len(self.inputs), self._given_bounds, time)

    def table_widths(self, wanted: Wanted) -> dict[str, int]:
        """Return how many columns the further tables of a run have."""
        sizes = len(self.inputs), len(self.outputs), (self.substeps - 1) * len(self.intersample)
        declared, prices = self.disturbances.declared, self.charged.prices
        return table_widths(declared, wanted, self._given_bounds, prices, self._monitors, *sizes)

    def monitored_band(self, time: FloatArray) -> FloatArray:
        """Return the bands of what is monitored at times [s], shape (len(time), bands, 2)."""
        bands = {name: band for name, band in self._monitors.items() if band is not None}
        return Wish.over([v for v in self.monitors if v.name in bands], bands, time).band

    def _stream(self, number: int) -> np.random.Generator:
        return np.random.default_rng([self._seed, number])

    def _deviations(self, given: Mapping[str, float]) -> FloatArray:
        """Return the noise of the plant's outputs up to the last that takes part, and of the disturbances."""
        check_names("noise", given, self._noisy)
        deviations = np.zeros(int(max((*self._outputs, *self._measured), default=-1)) + 1)
        places = dict(zip(names(self.measurements), self._measured.tolist(), strict=True))
        places |= dict(zip(self.disturbances.declared, self.disturbances.places.tolist(), strict=True))
        for name, deviation in given.items():
            if places[name] >= len(deviations):
                deviations = np.pad(deviations, (0, places[name] + 1 - len(deviations)))
            deviations[places[name]] = deviation
        return deviations

    @property
    def _noisy(self) -> tuple[Variable, ...]:
        """What is measured: outputs, and inputs that are known disturbances."""
        disturbances = self.disturbances
        measured = (disturbances.sensed[place] for place in disturbances.places)
        return tuple(dict.fromkeys((*self.measurements, *measured)))

    def _check_conditions(self, conditions: Conditions) -> None:
        faults = []
        if conditions.disturbances or conditions.inputs or conditions.effects:
            known = may_have(*map(names, (self.inputs, self.outputs, self._noisy, self.plant.inputs)))
            for key, (_, signals) in known.items():
                faults += unknown_names(key, getattr(conditions, key), signals)
        if not self.inputs and not self._open_loop:
            faults.append("inputs: every input of the plant has a signal; leave one to the controller")
        faults += [
            f"{key} of {name}: {fault}" for key, name, fault in conditions.faults_in(self.sampling_time)
        ]
        if faults:
            raise ConfigError([f"conditions: {fault}" for fault in faults])

    def start(
        self,
        time: FloatArray,
        *,
        ahead: int = 0,
        in_experiment: bool = False,
        continues: bool = False,
    ) -> None:
        """Prepare for a run with samples at these times [s], shape (K,).

        Parameters
        ----------
        ahead : int
            How many of the last times come after the run, for forecasts.
        in_experiment : bool
            It records data: without disturbances and losses.
        continues : bool
            Actuators and sensors go on from where they are; otherwise they start from rest.

        Raises
        ------
        ConfigError
            A delay is too long for the run, or a signal has values that are not possible.
        """
        run = "experiment" if in_experiment else "run"
        whole, time = time, time[: len(time) - ahead]
        faults = [
            f"conditions: {key} of {name}: {fault}"
            for key, name, fault in self._conditions.faults_in(self.sampling_time, len(time) - 1, run)
        ]
        prices = {} if in_experiment else self.charged.signals
        limits = [
            (f"bounds of {name}", limit)
            for name, pair in self._given_bounds.items()
            for limit in pair
            if not in_experiment
        ]
        of_run, ahead_of_run = (
            self.disturbances.signals(in_experiment=in_experiment, foretold=foretold)
            for foretold in (False, True)
        )
        until_end, ahead_too = [*of_run.items(), *limits], [*ahead_of_run.items(), *prices.items()]
        faults += _gaps(until_end, float(whole[0]), float(time[-1]))
        faults += _gaps(ahead_too, float(whole[0]), float(whole[-1]))
        if faults:
            raise ConfigError(faults)
        self.actuators.start(whole, ahead=ahead, in_experiment=in_experiment, continues=continues)
        self.disturbances.start(self.actuators, continues=continues)
        self._sensors.start(time, in_experiment=in_experiment, continues=continues)

    def pass_over(self, samples: int) -> None:
        """Go on behind an experiment of so many samples that is known: its noise is that of these samples."""
        self._sensors.pass_over(samples)

    def hand_over(self, *, accepts_missing: bool) -> None:
        """Go on with a controller that is shown NaN for a lost measurement, or the last one that arrived."""
        self._sensors.holds = not accepts_missing

    def sensor_tables(self, rows: int) -> SensorTables:
        """Return what sensors do at the next so many samples of the run that has been started."""
        return self._sensors.tables(rows)

    @property
    def effects(self) -> Collection[str]:
        """The kinds of conditions that actuators and sensors have."""
        return self._conditions.effects

    @property
    def places(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Where controlled outputs and measurements stand among the plant's outputs, shapes (p,) and (q,)."""
        return self._outputs, self._measured

    @property
    def has_switches(self) -> bool:
        """Whether the plant has a control of its own for an input that is driven."""
        return bool(self._is_left.any())

    def switched(self, controller: Controller) -> dict[str, ParameterValue]:
        """Return the plant's switches under a controller, as parameters: 1 where an input is driven.

        Raises
        ------
        ConfigError
            The plant is to control itself, and no input that is driven has a switch.
        """
        left = set[str]()
        if isinstance(controller, PlantControl):
            left = {v.name for v in self.inputs if v.name in self._switches}
            if not left:
                what = f"no input that is driven ({', '.join(names(self.inputs))}) has a switch"
                raise ConfigError(f"the plant has no control of its own: {what}")
        driven = {switch for name, switch in self._switches.items() if name not in left}
        return {switch: float(switch in driven) for switch in self._switches.values()}

    def commanded(self, u: FloatArray) -> FloatArray:
        """Return what is commanded where a plant controls itself, shape (m,): NaN of what is left to it."""
        return np.where(self._is_left[self._is_driven], np.nan, u)

    def taken_over(self, controller: Controller, past: Recording) -> tuple[Recording | None, tuple[str, ...]]:
        """Return what is known of the samples before a run, under this controller, and what is not known.

        Of inputs that were left to the plant its own control applied others than the recorded ones: what is
        measured of those stands in their place. Where nothing is measured of one, there is no past.
        """
        if not isinstance(controller, PlantControl):
            return past, ()
        measured = {variable.name: i for i, variable in enumerate(self.measurements)}
        u, unknown = past.u.copy(), list[str]()
        for i, variable in enumerate(self.inputs):
            if variable.name not in self._switches:
                continue
            place = measured.get(applied := applied_output(variable.name))
            if place is None or self.measurements[place].unit != variable.unit:
                remedy = f", as {applied} in {variable.unit} would" if applied else ""
                unknown.append(f"{variable.name} (no measurement tells{remedy})")
            else:
                u[:, i] = past.measured[:, place]
        if not unknown:
            return replace(past, u=u), ()
        what = "the warm-up is under the plant's own control, and it is not known what that applied of"
        return None, (f"{what} {', '.join(unknown)}: controllers start as from rest, without a past",)

    def measure(self, k: int, y_plant: FloatArray) -> Measured:
        """Return what is controlled and what is seen of the plant's outputs at sample k."""
        sensors, disturbances = self._sensors, self.disturbances
        y, d, known = y_plant, _NOTHING, _NOTHING
        if disturbances.inputs:
            y = disturbances.with_inputs(k, y)
        y = sensors.disturb(k, y)
        seen, status = sensors.measure(k, y)
        if disturbances.declared:
            d = disturbances.measured(y, seen)
            known = d[disturbances.told_places]
        controlled = y[self._outputs]
        as_seen = controlled if seen is y else seen[self._outputs]
        return Measured(controlled, as_seen, seen[self._measured], status, d, known, y)

    def no_wish(self, time: FloatArray) -> Wish:
        """Return that nothing is wanted: a reference of zero."""
        band = np.zeros((len(time), len(self.outputs), 2))
        band.setflags(write=False)
        return Wish(band[..., 0], band, np.zeros(len(self.outputs), dtype=bool))

    def no_limits(self, time: FloatArray) -> Limits:
        """Return that there are no limits."""
        variables = (*self.inputs, *self.outputs)
        none = dict.fromkeys(names(variables), (-math.inf, math.inf))
        return Limits.over(variables, len(self.inputs), none, time)

    def outlook(
        self,
        wish: Wish,
        limits: Limits,
        time: FloatArray,
        first: int,
        samples: int,
        horizon: int,
        preview: int,
        *,
        is_before: bool = False,
    ) -> Outlook:
        """Return what a controller may look at in a run that has been started; parameters as there."""
        price, _ = self.charged.prices_at(time)
        expected = self.disturbances.expected(time, first, samples, is_before=is_before)
        return Outlook(wish, limits, self.charged.charges, price, expected, horizon, preview)

    def wanted(self, reference: Reference | Band | Wanted) -> Wanted:
        """Return references by the names of the controlled outputs.

        Raises
        ------
        ConfigError
            They are not one for each.
        """
        if isinstance(reference, Reference | Band):
            if len(self.outputs) != 1:
                raise ConfigError(f"reference: give one for each output: {', '.join(names(self.outputs))}")
            reference = {self.outputs[0].name: reference}
        check_names("reference", reference, self.outputs)
        missing = [name for name in names(self.outputs) if name not in reference]
        if missing:
            raise ConfigError(f"reference: none for {', '.join(missing)}")
        return reference

    def wish(self, wanted: Wanted, time: FloatArray) -> Wish:
        """Return what is wanted of all outputs at all times [s]."""
        return Wish.over(self.outputs, wanted, time)

    def loop(
        self,
        stream: int | None,
        horizon: int,
        limits: Limits,
        recording: Recording | None = None,
        *,
        is_band: Iterable[bool] = (),
        continues: bool = False,
        past: Recording | None = None,
    ) -> Loop:
        """Return what a controller of a horizon learns; raise DataError for a recording of another loop.

        Without a stream it is one that draws no random numbers.
        """
        if recording is not None:
            self._check_recording(recording)
        return Loop(
            sampling_time=self.sampling_time,
            inputs=self.inputs,
            outputs=self.outputs,
            measurements=self.measurements,
            bounds=limits.bounds,
            recording=recording and self._protected(recording),
            rng=_NEVER_DRAWN if stream is None else self._stream(stream),
            preview=self.preview_of(horizon),
            continues_recording=continues,
            disturbances=self.disturbances.told,
            bands=tuple(compress(names(self.outputs), is_band)),
            moving_limits=limits.moving,
            charges=self.charged.charges,
            past=past and self._protected(past),
        )

    def preview_of(self, horizon: int) -> int:
        """Return how many future references a controller of a horizon sees."""
        return horizon if self._preview is None else min(horizon, int(self._preview))

    def _protected(self, recording: Recording) -> Recording:
        """Return a recording that a controller can only read, of the disturbances that it is told."""
        tables = {key: getattr(recording, key).view() for key in ("u", "y", "measured", "excitation")}
        tables["d"] = recording.d[:, self.disturbances.told_places]
        for table in tables.values():
            table.setflags(write=False)
        return replace(recording, **tables)

    def _check_recording(self, recording: Recording) -> None:
        columns = {
            "inputs": (recording.u.shape[1], len(self.inputs)),
            "controlled outputs": (recording.y.shape[1], len(self.outputs)),
            "measurements": (recording.measured.shape[1], len(self.measurements)),
            "disturbances": (recording.d.shape[1], len(self.disturbances.declared)),
        }
        faults = [f"{has} {what}, the loop {here}" for what, (has, here) in columns.items() if has != here]
        if not abs(recording.sampling_time - self.sampling_time) <= 1e-9 * self.sampling_time:
            faults.append(
                f"sampling time {shown(recording.sampling_time)}, the loop {shown(self.sampling_time)}"
            )
        if faults:
            raise DataError(f"recording: it does not fit the loop: it has {'; '.join(faults)}")


def _is_finite(value: Any) -> bool:
    return isinstance(value, Real) and math.isfinite(value)


def _is_count(value: Any) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= 0


def _chosen(what: str, chosen: Sequence[str] | None) -> tuple[str, ...]:
    if chosen is None:
        return ()
    if fault := not_names(what, chosen):
        raise ConfigError(fault)
    listed = tuple(chosen)
    twice = [name for name in dict.fromkeys(listed) if listed.count(name) > 1]
    if twice:
        raise ConfigError([f'{what}: "{name}" is listed more than once' for name in twice])
    return listed


def _checked_bounds(
    inputs: Sequence[Variable], outputs: Sequence[Variable], given: Mapping[str, tuple[Limit, Limit]]
) -> Mapping[str, tuple[Limit, Limit]]:
    """Return the limits that are given, if they are those of inputs and controlled outputs, and possible."""
    check_names("bounds", given, (*inputs, *outputs))
    faults = [
        f"bounds of {name}: {fault}"
        for name, pair in given.items()
        if not _is_moving(pair) and (fault := limits_error(pair))
    ]
    if faults:
        raise ConfigError(faults)
    return given


def _gaps(signals: Iterable[tuple[str, Limit]], first: float, last: float) -> Iterator[str]:
    """Yield which files do not tell signals from a first time to a last [s]."""
    for what, signal in signals:
        yield from _gaps([(what, part) for part in getattr(signal, "parts", ())], first, last)
        if isinstance(signal, SignalFromFile) and (gap := signal.gap(first, last)):
            yield f"{what}: {gap}"


def _is_moving(pair: Any) -> bool:
    return isinstance(pair, tuple | list) and len(pair) == 2 and any(isinstance(x, Reference) for x in pair)


def limits_error(limits: Any) -> str:
    """Return what is wrong with a pair of limits; empty if nothing is."""
    try:
        low, high = map(float, limits)
    except (TypeError, ValueError):
        return f"needed: two numbers, got {limits!r}"
    return "" if low < high else f"min ({low:g}) must be below max ({high:g})"
