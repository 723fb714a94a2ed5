"""Conditions of a run: disturbances, inputs that no controller drives, and what actuators and sensors do.

The order of effects, at sample k:

1. The controller's inputs, clipped at their bounds: ``u`` of the trace.
2. The actuator: its rate limit, then its delay, then its backlash.
3. The input disturbance is added. This, and the signals of the inputs that no controller drives, is what the
   plant holds over [t_k, t_k+1): ``applied`` of the trace.
4. The plant; the output disturbance is added to its outputs: ``y`` of the trace, of which metrics are taken.
5. The sensor: its delay, then noise, quantisation and loss: ``measured`` of the trace, and all that the
   controller sees.

What actuators and sensors do are classes derived from :class:`Condition`, one in a file of this folder each;
third parties install theirs by the entry point ``ddpc_cosim.conditions``, with an ``order`` among them.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.conditions.condition import Condition, ConditionSetup, Place
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.plugins import Plugin, describe, installed, source_hash
from ddpc_cosim.signals.signals import Reference, Steps, in_unit_of, values_at
from ddpc_cosim.variables import FloatArray, Variable, names
from fmu_plants.spelling import did_you_mean

Disturbance = Reference | Sequence[Reference]
"""One signal, or several that are added up."""

HELD = "a measurement is missing, its last value stands in"
"""Status of a sample at which a controller that needs all measurements was handed an older one."""

# Which stream of a seed serves whom, from 3 on: lower ones are those of loop.setup.
_DISTURBANCES, _SIGNALS, _EXPERIMENT_SIGNALS = 3, 4, 5
_SIGNAL_KEYS = ("disturbances", "inputs", "recorded_inputs")
# What ``repr`` shows always: ids of cases depend on it.
_SHOWN = ("rate_limit", "delay", "quantum", "loss")
_NONE: FloatArray = np.empty(0)


@cache
def all_conditions() -> Mapping[str, type[Condition]]:
    """Return what actuators and sensors may do, by name, in the order of effects."""
    kinds = {plugin.name: plugin.value for plugin in installed("conditions") if not _fault(plugin)}
    return {name: kinds[name] for name in sorted(kinds, key=lambda name: (kinds[name].order, name))}


def describe_condition(plugin: Plugin) -> tuple[str, bool]:
    """Return one line about an installed kind of condition, or why it is broken; and whether it works."""
    fault = _fault(plugin)
    return (f"broken: {fault}", False) if fault else describe(plugin)


def _fault(plugin: Plugin) -> str:
    """Return why an installed object cannot be a kind of condition; empty if it can."""
    kind = plugin.value
    if plugin.error:
        return plugin.error
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", plugin.name):
        return "needed: a name of letters, digits and _, as it is a keyword in Python"
    if not (isinstance(kind, type) and issubclass(kind, Condition)):
        return f"needed: a class derived from ddpc_cosim.Condition, got {kind!r}"
    missing = [name for name in ("places", "order", "value", "words") if not hasattr(kind, name)]
    return f"{kind.__name__} does not set {', '.join(missing)}" if missing else ""


@dataclass(frozen=True, init=False, repr=False)
class Conditions:
    """What acts on a plant besides its controller, and what its actuators and sensors do.

    All is given by name of an input or output, in its unit. Actuators and sensors are the same in the
    experiment that records data, and so are the signals of inputs that no controller drives, but for those
    that have one of their own there; disturbances and losses belong to the closed loop alone.

    Parameters
    ----------
    disturbances : mapping of str to Reference or sequence of Reference
        Added to an input or an output; several signals are added up. Steps, and
        what is read from a file, are zero before their first instant.
    inputs : mapping of str to Reference
        Signals of the inputs that no controller drives.
    recorded_inputs : mapping of str to Reference
        Signals of some of these inputs in the experiment, over its time, which begins at 0.
    effects : mapping of str to mapping of str to float
        By each kind of condition that is installed, ``rate_limit``, ``delay``, ``backlash``, ``quantum``,
        ``loss`` and those of third parties, the number for each signal: see :class:`Condition` and
        ``ddpc-cosim list conditions``.
    **more : mapping of str to float
        These as keywords: ``delay={"torque": 0.2}``.

    Raises
    ------
    ConfigError
        Impossible values; all faults at once.
    """

    disturbances: Mapping[str, Disturbance]
    inputs: Mapping[str, Reference]
    recorded_inputs: Mapping[str, Reference]
    effects: Mapping[str, Mapping[str, float]]

    def __init__(
        self,
        disturbances: Mapping[str, Disturbance] | None = None,
        inputs: Mapping[str, Reference] | None = None,
        recorded_inputs: Mapping[str, Reference] | None = None,
        effects: Mapping[str, Mapping[str, float]] | None = None,
        **more: Mapping[str, float],
    ) -> None:
        signals = (disturbances, inputs, recorded_inputs)
        for key, value in zip(_SIGNAL_KEYS, signals, strict=True):
            object.__setattr__(self, key, {} if value is None else value)
        given = {**(effects or {}), **more}
        object.__setattr__(self, "effects", {key: value for key, value in given.items() if value != {}})
        if faults := self._faults():
            raise ConfigError(faults)

    def _faults(self) -> list[str]:
        known = all_conditions()
        given = {key: getattr(self, key) for key in _SIGNAL_KEYS} | dict(self.effects)
        unknown = [key for key in self.effects if key not in known]
        faults = [
            f"conditions: there is no condition {key}; {did_you_mean(key, (*_SIGNAL_KEYS, *known))}"
            for key in unknown
        ]
        faults += [
            f"{key}: needed: a mapping from names of signals, got {value!r}"
            for key, value in given.items()
            if not isinstance(value, Mapping)
        ]
        if faults:
            return faults
        faults = [
            f"{key} of {name} = {value!r} is not possible; allowed: {kind.allowed()}"
            for key, kind in known.items()
            for name, value in self.of(key).items()
            if not kind.is_possible(value)
        ]
        faults += [
            f"{key} of {name}: needed: a signal of time, of a class derived from Reference, got {signal!r}"
            for key in _SIGNAL_KEYS
            for name, signals in given[key].items()
            for signal in (_parts(signals) if key == "disturbances" else (signals,))
            if not isinstance(signal, Reference)
        ]
        return faults + [
            f"recorded_inputs of {name}: it has no signal in inputs, by which no controller drives it"
            for name in self.recorded_inputs
            if name not in self.inputs
        ]

    def of(self, kind: str) -> Mapping[str, float]:
        """Return the values of a kind of condition, by signal."""
        return self.effects.get(kind, {})

    def __getattr__(self, name: str) -> Mapping[str, float]:
        if name.startswith("__") or name not in all_conditions():
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        return self.of(name)

    def __repr__(self) -> str:
        effects = {key: self.of(key) for key in dict.fromkeys((*_SHOWN, *sorted(self.effects)))}
        given = {key: getattr(self, key) for key in _SIGNAL_KEYS} | effects
        return f"Conditions({', '.join(f'{key}={value!r}' for key, value in given.items())})"

    @property
    def loses(self) -> bool:
        """Whether measurements can be lost."""
        return any(all_conditions()[name].loses for name in self.effects)

    @property
    def versions(self) -> dict[str, str]:
        """For each kind that a third party has installed, a hash of its source."""
        modules = {name: all_conditions()[name].__module__ for name in self.effects}
        return {
            name: source_hash(module)
            for name, module in modules.items()
            if not module.startswith(f"{__name__}.")
        }

    def faults_in(
        self, sampling_time: float, steps: float = math.inf, run: str = "run"
    ) -> list[tuple[str, str, str]]:
        """Return kind, signal, and what is wrong with it in a run of so many sampling intervals."""
        return [
            (key, name, fault)
            for key, values in self.effects.items()
            for name, value in values.items()
            if (fault := all_conditions()[key].fault_of(value, sampling_time, steps, run))
        ]


def may_have(
    driven: Sequence[str], outputs: Sequence[str], measurements: Sequence[str], inputs: Iterable[str]
) -> dict[str, tuple[str, tuple[str, ...]]]:
    """Return for each kind of condition which signals may have it: in words, and by name.

    Parameters
    ----------
    driven, outputs, measurements : sequence of str
        The inputs that controllers drive, the controlled outputs and the measurements.
    inputs : iterable of str
        All inputs of the plant.
    """
    passing = {"actuator": driven, "sensor": measurements}
    return {
        "disturbances": ("input or output", (*driven, *outputs, *measurements)),
        "inputs": ("input that no controller drives", tuple(inputs)),
        **{
            name: (kind.whose(), tuple(signal for place in kind.places for signal in passing[place]))
            for name, kind in all_conditions().items()
        },
    }


def changed_inputs(conditions: Conditions, inputs: Sequence[Variable]) -> tuple[Variable, ...]:
    """Return the inputs that the plant may be given otherwise than a controller commands them.

    Parameters
    ----------
    conditions : Conditions
        The conditions.
    inputs : sequence of Variable
        All inputs of the plant.
    """
    changed = {*conditions.disturbances, *conditions.inputs}
    for key, values in conditions.effects.items():
        kind = all_conditions()[key]
        if "actuator" in kind.places:
            changed |= {name for name, value in values.items() if value != kind.neutral}
    return tuple(variable for variable in inputs if variable.name in changed)


def _effects(
    place: Place, signals: Sequence[str], conditions: Conditions, setup: tuple[float, int]
) -> list[Condition]:
    """Return what is done to signals in a place, in its order; ``setup``: the sampling time and the seed."""
    effects = []
    for key, kind in all_conditions().items():
        if not (given := conditions.of(key)) or place not in kind.places:
            continue
        values = np.array([float(given.get(name, kind.neutral)) for name in signals])
        if (values != kind.neutral).any():
            effects.append(kind(ConditionSetup(place, signals, values, *setup)))
    return effects


class ActuatorTables(NamedTuple):
    """What the actuators do in a run of K samples.

    Parameters
    ----------
    driven, others, changed : array of int
        Places among all inputs: of those that a controller drives, of the others, and of those that the plant
        may be given otherwise than they are commanded.
    effects : sequence of Condition
        What is done to the driven ones, in this order.
    added : array, shape (K, m), or None
        What is added to them after that.
    own : array, shape (K, len(others))
        The others.
    """

    driven: NDArray[np.intp]
    others: NDArray[np.intp]
    changed: NDArray[np.intp]
    effects: Sequence[Condition]
    added: FloatArray | None
    own: FloatArray


class SensorTables(NamedTuple):
    """What is added to the outputs in a run of K samples, and what the sensors make of them.

    Parameters
    ----------
    added : array, shape (K, all outputs), or None
        What is added to the outputs.
    before_noise, after_noise : sequence of Condition
        What is done to them, in this order.
    noise : array, shape (rows, n), or None
        What is added to the first n of them in between.
    loses : bool
        Whether one of them can be NaN then.
    holds : bool
        Whether the last value that arrived stands in for it.
    """

    added: FloatArray | None
    before_noise: Sequence[Condition]
    noise: FloatArray | None
    after_noise: Sequence[Condition]
    loses: bool
    holds: bool


class Actuators:
    """What the plant is given: commanded inputs after rate limit, delay and disturbance, and other signals.

    Parameters
    ----------
    inputs : sequence of Variable
        All inputs of the plant.
    rest : array, shape (m,)
        Where the m driven ones are before the run.
    conditions : Conditions
        Which inputs have signals of their own (the others are driven), and what the actuators do.
    sampling_time : float
        Time between samples [s].
    """

    def __init__(
        self, inputs: Sequence[Variable], rest: FloatArray, conditions: Conditions, sampling_time: float
    ) -> None:
        self._conditions, self._rest, self._sampling_time = conditions, rest, sampling_time
        all_names = names(inputs)
        is_driven = np.array([name not in conditions.inputs for name in all_names], dtype=bool)
        self._places = np.flatnonzero(is_driven), np.flatnonzero(~is_driven)
        self._driven = [variable for variable in inputs if variable.name not in conditions.inputs]
        self._others = [variable for variable in inputs if variable.name in conditions.inputs]
        changed = names(changed_inputs(conditions, inputs))
        self._changed = np.array([all_names.index(name) for name in changed], dtype=np.intp)

    def draw_from(self, seed: int) -> None:
        """Have all random signals of the next runs from a seed."""
        self._seed, setup = seed, (self._sampling_time, seed)
        self._effects = _effects("actuator", names(self._driven), self._conditions, setup)

    def start(self, time: FloatArray, *, ahead: int = 0, in_experiment: bool, continues: bool) -> None:
        """Draw the signals of a run at its times [s], shape (K,), which starts from rest or continues one.

        The last ``ahead`` of the times come after the run, for forecasts.
        """
        conditions, seed = self._conditions, self._seed
        self._acting = [effect for effect in self._effects if effect.in_experiments or not in_experiment]
        whole, time = time, time[: len(time) - ahead]
        for effect in self._acting:
            effect.start(time, None if continues and effect.in_experiments else self._rest)
        stream, signals = _SIGNALS, conditions.inputs
        if in_experiment:
            stream, signals = _EXPERIMENT_SIGNALS, {**signals, **conditions.recorded_inputs}
        self._own = _sums("inputs", signals, self._others, whole, (seed, stream))
        # What the plant is given at each time, but for what is driven.
        driven, others = self._places
        self._given = np.empty((len(time), len(driven) + len(others)))
        self._given[:, others] = self._own[: len(time)]
        self._added = None if in_experiment else _disturbances(conditions, self._driven, time, seed)

    def apply(self, k: int, u: FloatArray) -> FloatArray:
        """Return what the plant holds from sample k on, shape (all inputs,), where u is commanded."""
        if not self._changed.size:
            return u.copy()  # a plant may use its inputs up
        if self._acting:
            u = u.copy()  # what acts may keep it, while a controller fills the same memory again
        for effect in self._acting:
            u = effect.apply(k, u)
        if self._added is not None:
            u = u + self._added[k]
        applied: FloatArray = self._given[k].copy()
        applied[self._places[0]] = u
        return applied

    def course(self, name: str) -> FloatArray:
        """Return an input that no controller drives, at all times that it was started for, shape (K,)."""
        return self._own[:, names(self._others).index(name)]

    def changed(self, applied: FloatArray) -> FloatArray:
        """Return the columns of :func:`changed_inputs` among all inputs."""
        return applied[self._changed] if self._changed.size else _NONE

    def tables(self) -> "ActuatorTables":
        """Return what :meth:`apply` goes by in the run that has been started."""
        return ActuatorTables(*self._places, self._changed, self._acting, self._added, self._own)


@dataclass(frozen=True, slots=True)
class MixedNormal:
    """Standard normal numbers of several streams, each times a weight; the squares of these sum to 1.

    Parameters
    ----------
    streams : sequence of (numpy.random.Generator, float)
        The streams and their weights.
    """

    streams: Sequence[tuple[np.random.Generator, float]]

    def draw(self, size: int | tuple[int, int]) -> FloatArray:
        """Return the next so many numbers."""
        (first, weight), *others = self.streams
        drawn = first.standard_normal(size)
        if weight != 1.0:
            drawn *= weight
        for stream, its_weight in others:
            drawn += its_weight * stream.standard_normal(size)
        return drawn


class Sensors:
    """What is added to the plant's outputs, and what becomes of them until a controller sees them.

    Parameters
    ----------
    outputs : sequence of Variable
        All outputs of the plant.
    deviation : array, shape (n,)
        Standard deviation of the noise of the first n of them.
    conditions : Conditions
        What the sensors do.
    sampling_time : float
        Time between samples [s].

    Attributes
    ----------
    holds : bool
        Whether the last value that arrived stands in for one that is lost; no, when they start.
    """

    def __init__(
        self,
        outputs: Sequence[Variable],
        deviation: FloatArray,
        conditions: Conditions,
        sampling_time: float,
    ) -> None:
        self._conditions, self._sampling_time = conditions, sampling_time
        self._outputs, self._names = outputs, names(outputs)
        self._deviation, self._is_noisy = deviation, bool(deviation.any())

    def draw_from(self, seed: int, normal: MixedNormal) -> None:
        """Have all random signals of the next runs from a seed, and the noise from its own streams."""
        self._seed, self._normal = seed, normal
        self._effects = _effects("sensor", self._names, self._conditions, (self._sampling_time, seed))

    def start(self, time: FloatArray, *, in_experiment: bool, continues: bool) -> None:
        """Draw disturbances and losses of a run at its times [s], shape (K,), as for actuators."""
        conditions, seed = self._conditions, self._seed
        if not continues:
            self._seen = np.empty(0)
        acting = [effect for effect in self._effects if effect.in_experiments or not in_experiment]
        for effect in acting:
            unknown = np.full(len(self._names), np.nan)
            effect.start(time, None if continues and effect.in_experiments else unknown)
        self._before_noise = [effect for effect in acting if effect.order < 0]
        self._after_noise = [effect for effect in acting if effect.order >= 0]
        self._loses = any(effect.loses for effect in acting)
        self._added = None if in_experiment else _disturbances(conditions, self._outputs, time, seed)
        self.holds = False

    def disturb(self, k: int, y: FloatArray) -> FloatArray:
        """Return the plant's outputs at sample k, shape (all outputs,), with their disturbances."""
        return y if self._added is None else y + self._added[k]

    def measure(self, k: int, y: FloatArray) -> tuple[FloatArray, str]:
        """Return the outputs as a controller sees them at sample k, and ``HELD`` if one of them is older."""
        for effect in self._before_noise:
            y = effect.apply(k, y)
        if self._is_noisy:
            n = len(self._deviation)
            y = y.copy()
            y[:n] += self._deviation * self._normal.draw(n)
        for effect in self._after_noise:
            y = effect.apply(k, y)
        if not self._loses:
            return y, ""
        lost = np.isnan(y)
        self._seen = y = np.where(lost, self._seen if self.holds and lost.any() else np.nan, y)
        return y, HELD if self.holds and lost.any() else ""

    def pass_over(self, samples: int) -> None:
        """Draw the noise of the next so many samples, which nobody measures."""
        if self._is_noisy:
            self._normal.draw((samples, len(self._deviation)))

    def tables(self, rows: int) -> SensorTables:
        """Return what :meth:`disturb` and :meth:`measure` go by at the next so many samples, noise drawn."""
        noise = None
        if self._is_noisy:
            noise = self._deviation * self._normal.draw((rows, len(self._deviation)))
        return SensorTables(
            self._added, self._before_noise, noise, self._after_noise, self._loses, self.holds
        )


def _parts(signal: Disturbance) -> Sequence[Reference]:
    return signal if isinstance(signal, Sequence) and not isinstance(signal, str) else (signal,)


def _disturbances(
    conditions: Conditions, signals: Sequence[Variable], time: FloatArray, seed: int
) -> FloatArray | None:
    """Return what is added to each signal at each time, shape (K, len(signals)); None if nothing is."""
    given = conditions.disturbances
    if given.keys().isdisjoint(names(signals)):
        return None
    return _sums("disturbances", given, signals, time, (seed, _DISTURBANCES))


def _begun(disturbance: Reference, time: FloatArray) -> FloatArray | float:
    """Return 0 before the first instant that steps or a file say something about, and 1 from there on."""
    if not isinstance(disturbance, Steps):
        return 1.0
    return Steps((-math.inf, disturbance.times[0]), (0.0, 1.0)).at(time)


def _sums(
    what: str,
    given: Mapping[str, Disturbance],
    signals: Sequence[Variable],
    time: FloatArray,
    seed: tuple[int, int],
) -> FloatArray:
    """Return the sum of what is given for each signal at each time, shape (K, len(signals)).

    What is random has a seed of its own: what else there is does not change it.
    """
    table = np.zeros((len(time), len(signals)))
    for column, variable in enumerate(signals):
        name = variable.name
        for number, part in enumerate(_parts(given.get(name, ()))):
            part = in_unit_of(variable, part, difference=what == "disturbances")
            own_seed = np.random.SeedSequence([*seed, number, *name.encode()]).generate_state(1, np.uint64)
            values = values_at(part.with_seed(int(own_seed[0])), f"{what} of {name}", time)
            table[:, column] += values * _begun(part, time) if what == "disturbances" else values
    return table
