"""Conditions of a run: disturbances, inputs that no controller drives, and what actuators and sensors do.

The order of effects, at sample k:

1. The controller's inputs, clipped at their bounds: ``u`` of the trace.
2. The actuator: its rate limit, then its delay.
3. The input disturbance is added. This, and the signals of the inputs that no controller drives, is what the
   plant holds over [t_k, t_k+1): ``applied`` of the trace.
4. The plant; the output disturbance is added to its outputs: ``y`` of the trace, of which metrics are taken.
5. The sensor: its delay, then noise, quantisation and loss: ``measured`` of the trace, and all that the
   controller sees.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.signals import Reference, Steps, values_at
from ddpc_cosim.variables import FloatArray, Variable, names

Disturbance = Reference | Sequence[Reference]
"""One signal, or several that are added up."""

HELD = "a measurement is missing, its last value stands in"
"""Status of a sample at which a controller that needs all measurements was handed an older one."""

# Which stream of a seed serves whom, from 3 on: lower ones are those of loop_setup.
_DISTURBANCES, _SIGNALS, _EXPERIMENT_SIGNALS, _LOSSES = 3, 4, 5, 6
# By how much a delay may miss a whole number of samples, in parts of it.
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
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
    rate_limit : mapping of str to float
        Largest rate of change of an input, per second, from its value at rest on.
    delay : mapping of str to float
        By how much an input acts, or a measurement arrives, late [s]: a whole number of samples. Until then
        the input is at rest, the measurement as at the first sample.
    quantum : mapping of str to float
        Measurements are rounded to whole multiples of it.
    loss : mapping of str to float
        Probability that a measurement is lost at a sample; at the first one it never is. A controller that
        accepts missing measurements sees NaN, any other the last value that arrived, with a status that
        counts as a fallback.

    Raises
    ------
    ConfigError
        Impossible values; all faults at once.
    """

    disturbances: Mapping[str, Disturbance] = field(default_factory=dict)
    inputs: Mapping[str, Reference] = field(default_factory=dict)
    recorded_inputs: Mapping[str, Reference] = field(default_factory=dict)
    rate_limit: Mapping[str, float] = field(default_factory=dict)
    delay: Mapping[str, float] = field(default_factory=dict)
    quantum: Mapping[str, float] = field(default_factory=dict)
    loss: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        given = {item.name: getattr(self, item.name) for item in fields(self)}
        unnamed = [
            f"{key}: needed: a mapping from names of signals, got {value!r}"
            for key, value in given.items()
            if not isinstance(value, Mapping)
        ]
        if unnamed:
            raise ConfigError(unnamed)
        finite, least, most = "a finite number", math.ulp(0.0), math.nextafter(math.inf, 0.0)
        allowed = {
            "rate_limit": (least, most, f"{finite} > 0"),
            "delay": (0.0, most, f"{finite} >= 0"),
            "quantum": (least, most, f"{finite} > 0"),
            "loss": (0.0, 1.0, "a probability from 0 to 1"),
        }
        faults = [
            f"{key} of {name} = {value!r} is not possible; allowed: {words}"
            for key, (low, high, words) in allowed.items()
            for name, value in given[key].items()
            if not (isinstance(value, Real) and low <= float(value) <= high)
        ]
        faults += [
            f"{key} of {name}: needed: a signal of time, of a class derived from Reference, got {signal!r}"
            for key in ("disturbances", "inputs", "recorded_inputs")
            for name, signals in given[key].items()
            for signal in (_parts(signals) if key == "disturbances" else (signals,))
            if not isinstance(signal, Reference)
        ]
        faults += [
            f"recorded_inputs of {name}: it has no signal in inputs, by which no controller drives it"
            for name in self.recorded_inputs
            if name not in self.inputs
        ]
        if faults:
            raise ConfigError(faults)


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
    return {
        "disturbances": ("input or output", (*driven, *outputs, *measurements)),
        "inputs": ("input that no controller drives", tuple(inputs)),
        "rate_limit": ("input that the controllers drive", tuple(driven)),
        "delay": ("input or measurement", (*driven, *measurements)),
        "quantum": ("measurement", tuple(measurements)),
        "loss": ("measurement", tuple(measurements)),
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
    late = {name for name, delay in conditions.delay.items() if delay}
    changed = late.union(conditions.disturbances, conditions.inputs, conditions.rate_limit)
    return tuple(variable for variable in inputs if variable.name in changed)


def delay_error(delay: float, sampling_time: float, steps: float = math.inf, run: str = "run") -> str:
    """Return why a delay [s] is not possible in a run of so many sampling intervals; empty if it is."""
    late = delay / sampling_time
    if late > steps * (1.0 - _ROUNDING):
        length = f"the {run} ends after {steps * sampling_time:g} s"
        return f"{delay:g} s is too long: {length}; choose a shorter delay"
    if abs(round(late) - late) > _ROUNDING * max(late, 1.0):
        nearest = " or ".join(f"{whole * sampling_time:g}" for whole in (math.floor(late), math.ceil(late)))
        return f"{delay:g} s is not a whole number of samples of {sampling_time:g} s; nearest: {nearest} s"
    return ""


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
    seed : int
        Seed of random signals.
    """

    def __init__(
        self,
        inputs: Sequence[Variable],
        rest: FloatArray,
        conditions: Conditions,
        sampling_time: float,
        seed: int,
    ) -> None:
        self._conditions, self._seed, self._rest = conditions, seed, rest
        all_names = names(inputs)
        self._is_driven = np.array([name not in conditions.inputs for name in all_names], dtype=bool)
        self._driven = [name for name in all_names if name not in conditions.inputs]
        self._others = [name for name in all_names if name in conditions.inputs]
        limits = [conditions.rate_limit.get(name, np.inf) for name in self._driven]
        self._reach = np.array(limits) * sampling_time
        self._delay = _Delay(self._driven, conditions, sampling_time)
        changed = names(changed_inputs(conditions, inputs))
        self._changed = np.array([all_names.index(name) for name in changed], dtype=np.intp)

    def start(self, time: FloatArray, *, in_experiment: bool, continues: bool) -> None:
        """Draw the signals of a run at its times [s], shape (K,), which starts from rest or continues one."""
        conditions, seed = self._conditions, self._seed
        if not continues:
            self._position = self._rest
            self._delay.fill(self._rest)
        stream, signals = _SIGNALS, conditions.inputs
        if in_experiment:
            stream, signals = _EXPERIMENT_SIGNALS, {**signals, **conditions.recorded_inputs}
        self._own = _sums("inputs", signals, self._others, time, (seed, stream))
        self._added = None if in_experiment else _disturbances(conditions, self._driven, time, seed)

    def apply(self, k: int, u: FloatArray) -> FloatArray:
        """Return what the plant holds from sample k on, shape (all inputs,), where u is commanded."""
        if not self._changed.size:
            return u.copy()  # a plant may use its inputs up
        u = self._position = np.clip(u, self._position - self._reach, self._position + self._reach)
        u = self._delay(u)
        if self._added is not None:
            u = u + self._added[k]
        applied = np.empty(len(self._is_driven))
        applied[self._is_driven], applied[~self._is_driven] = u, self._own[k]
        return applied

    def changed(self, applied: FloatArray) -> FloatArray:
        """Return the columns of :func:`changed_inputs` among all inputs."""
        return applied[self._changed]


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
    seed : int
        Seed of random signals.
    rng : numpy.random.Generator
        Draws the noise.
    """

    def __init__(
        self,
        outputs: Sequence[Variable],
        deviation: FloatArray,
        conditions: Conditions,
        sampling_time: float,
        seed: int,
        rng: np.random.Generator,
    ) -> None:
        self._conditions, self._seed, self._rng = conditions, seed, rng
        self._names = names(outputs)
        self._deviation, self._is_noisy = deviation, bool(deviation.any())
        self._delay = _Delay(self._names, conditions, sampling_time)
        quantum = np.array([conditions.quantum.get(name, 0.0) for name in self._names])
        self._rounded = np.flatnonzero(quantum)
        self._quantum = quantum[self._rounded]

    def start(self, time: FloatArray, *, in_experiment: bool, continues: bool, holds: bool) -> None:
        """Draw disturbances and losses of a run at its times [s], shape (K,), as for actuators.

        If it ``holds``, the last value that arrived stands in for one that is lost.
        """
        conditions, seed = self._conditions, self._seed
        if not continues:
            self._delay.empty()
            self._seen = np.empty(0)
        self._added = None if in_experiment else _disturbances(conditions, self._names, time, seed)
        self._lost: NDArray[np.bool_] | None = None
        self._holds = holds
        if conditions.loss and not in_experiment:
            self._lost = np.zeros((len(time), len(self._names)), dtype=bool)
            for column, name in enumerate(self._names):
                drawn = np.random.default_rng([seed, _LOSSES, *name.encode()]).random(len(time))
                self._lost[1:, column] = drawn[1:] < conditions.loss.get(name, 0.0)

    def disturb(self, k: int, y: FloatArray) -> FloatArray:
        """Return the plant's outputs at sample k, shape (all outputs,), with their disturbances."""
        return y if self._added is None else y + self._added[k]

    def measure(self, k: int, y: FloatArray) -> tuple[FloatArray, str]:
        """Return the outputs as a controller sees them at sample k, and ``HELD`` if one of them is older."""
        y = self._delay(y)
        if self._is_noisy:
            n = len(self._deviation)
            y = y.copy()
            y[:n] += self._deviation * self._rng.standard_normal(n)
        if self._rounded.size:
            y = y.copy()
            y[self._rounded] = np.round(y[self._rounded] / self._quantum) * self._quantum
        if self._lost is None:
            return y, ""
        lost = self._lost[k]
        self._seen = y = np.where(lost, self._seen if self._holds and lost.any() else np.nan, y)
        return y, HELD if self._holds and lost.any() else ""


class _Delay:
    """Gives values back later, each signal's by its own number of samples.

    Until then it gives back what it is filled with, or the first values if it is empty.
    """

    def __init__(self, signals: Sequence[str], conditions: Conditions, sampling_time: float) -> None:
        samples = [round(conditions.delay.get(name, 0.0) / sampling_time) for name in signals]
        self._samples, self._columns = np.array(samples, dtype=np.intp), np.arange(len(samples))
        self._is_late = any(samples)
        self._count = 0
        self.empty()

    def empty(self) -> None:
        self._past = np.empty((0, len(self._samples)))

    def fill(self, values: FloatArray) -> None:
        self._past = np.tile(values, (int(self._samples.max(initial=0)) + 1, 1))

    def __call__(self, values: FloatArray) -> FloatArray:
        if not self._is_late:
            return values
        if not len(self._past):
            self.fill(values)
        length = len(self._past)
        self._past[self._count % length] = values
        delayed: FloatArray = self._past[(self._count - self._samples) % length, self._columns]
        self._count += 1
        return delayed


def _parts(signal: Disturbance) -> Sequence[Reference]:
    return signal if isinstance(signal, Sequence) and not isinstance(signal, str) else (signal,)


def _disturbances(
    conditions: Conditions, signals: Sequence[str], time: FloatArray, seed: int
) -> FloatArray | None:
    """Return what is added to each signal at each time, shape (K, len(signals)); None if nothing is."""
    given = conditions.disturbances
    if given.keys().isdisjoint(signals):
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
    signals: Sequence[str],
    time: FloatArray,
    seed: tuple[int, int],
) -> FloatArray:
    """Return the sum of what is given for each signal at each time, shape (K, len(signals)).

    What is random has a seed of its own: what else there is does not change it.
    """
    table = np.zeros((len(time), len(signals)))
    for column, name in enumerate(signals):
        for number, part in enumerate(_parts(given.get(name, ()))):
            own = np.random.SeedSequence([*seed, number, *name.encode()]).generate_state(1, np.uint64)
            values = values_at(part.with_seed(int(own[0])), f"{what} of {name}", time)
            table[:, column] += values * _begun(part, time) if what == "disturbances" else values
    return table
