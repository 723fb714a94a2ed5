"""The numbers of a suggested study, from what the FMU declares and what the step test has shown."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.loop import safe_calls
from ddpc_cosim.loop.setup import whole_steps
from ddpc_cosim.plugins import plugin_names
from ddpc_cosim.signals.excitations import UniformRandom
from ddpc_cosim.signals.signals import Reference, Steps
from ddpc_cosim.study.file_format.sections import ControllerSection
from ddpc_cosim.suggestion.choice import Choice
from ddpc_cosim.suggestion.request import Request
from ddpc_cosim.suggestion.response_types import BLOCK, Response, ResponseType, without_spike
from ddpc_cosim.suggestion.step_test import StepTest
from ddpc_cosim.variables import FloatArray, Variable


@dataclass(frozen=True, slots=True)
class Bounds:
    """Limits of an input, in its unit, and where they come from."""

    low: float
    high: float
    origin: str


# Temperatures and absolute pressures do not go to zero.
_SWINGS_OF: dict[str, Callable[[float], float]] = {"K": lambda _: 20.0, "Pa": lambda start: 0.2 * start}
_EXCITED = 0.3  # share of an input's range that experiment and setpoints use, to either side of its rest
_SAMPLES_PER_SETTLING = 30  # a first-order lag gets ten samples per time constant
_SAMPLES_PER_TIME_CONSTANT, _TIME_CONSTANTS_PER_SETTLING = 10, 3
_SAMPLES_PER_RISE = 2
_QUARTER = 0.288  # of its time constant: when a quarter of a lag of first order is gone
_JUMPS = 0.05  # of its way: what a response does at once that has feedthrough
_FAR, _EARLY = 0.03, 0.4  # of the time constant of the rest
# Where something fast stands beside something slow: an end of the study must be in sight.
_MOST_SAMPLES_PER_SETTLING, _MOST_SAMPLES_PER_RINGING = 150, 500
_SAMPLES_PER_LAG = 5
_SETTLING_IN_DURATION = 0.1  # of the time that somebody thought of as long enough
_FEWEST_SAMPLES, _MOST_SAMPLES = 30, 2000  # of a default experiment whose steps are those of a loop
_SWINGS, _LAGS = ResponseType.OSCILLATING, ResponseType.INTEGRATING
_SETTLING_PER_SETPOINT = 1.5
_HORIZON, _INITIAL_LENGTH = 15, 5
_LEAST_SAMPLES_PER_SETPOINT = 4 * _HORIZON
_SMALL_STEP = 0.2  # of what an unstable output has done after a few doublings
_REACHED = 0.6  # share of what the inputs could hold that the setpoints ask for
_AS_FAR, _FREE = 0.95, 0.9  # of what gains promise: what is reached; of what was reached: what is asked for
_FADING = 0.7  # of the movement in the time before, which is half as long
_NEAR = 1.7  # times a sampling time: where parts of a period are as good
_ROUNDING = 1e-6
_MOST_IN_PERIODS = 2000  # samples
_DRIFT = 0.1  # of the largest response: how far an output at rest may still move
_MARGIN = 0.05  # of an output's range, kept from its limits
_ROOM = 0.5  # share of the way from rest to a limit that a setpoint takes: the rest is for overshoot


def input_bounds(
    inputs: Sequence[Variable],
    ranges: Mapping[str, tuple[float, float]] | None = None,
    parameters: Iterable[Variable] = (),
) -> dict[str, Bounds]:
    """Return limits of every input: those given, else declared, else a guess.

    A guess follows parameters of the plant that are named after the input, its nominal or its start value;
    ``parameters`` have their values as start values.
    """
    given = {
        name: Bounds(float(low), float(high), "as asked for") for name, (low, high) in (ranges or {}).items()
    }
    known = {_plain(p.name): p for p in parameters}
    return {v.name: given.get(v.name) or _bounds_by_name(v, known) or _input_bounds(v) for v in inputs}


def _plain(name: str) -> str:
    """Return a name as names of parameters are compared: u_max and uMax are the same."""
    return name.replace("_", "").lower()


def _bounds_by_name(variable: Variable, parameters: Mapping[str, Variable]) -> Bounds | None:
    """Return the limits that parameters named after an input may be, uMin and uMax of u; None for none."""
    path, dot, last = variable.name.rpartition(".")
    ends, used = [variable.min, variable.max], []
    for side, word in enumerate(("min", "max")):
        names = (_plain(f"{path}{dot}{name}") for name in (last + word, word + last))
        parameter = next((parameters[name] for name in names if name in parameters), None)
        if parameter and not math.isfinite(ends[side]) and parameter.unit in ("", variable.unit):
            ends[side] = parameter.start
            used.append(f"{parameter.name} = {parameter.start:g}")
    low, high = ends
    # Where one end is known, there may be as much room to the other side.
    low = low if math.isfinite(low) else 2 * variable.start - high
    high = high if math.isfinite(high) else 2 * variable.start - low
    if not used or not low < high or not low <= variable.start <= high:
        return None
    return Bounds(low, high, f"parameter {', '.join(used)}? the FMU declares no range: going by the name")


def _input_bounds(variable: Variable) -> Bounds:
    low, high = variable.min, variable.max
    if math.isfinite(low) and math.isfinite(high) and low < high:
        return Bounds(low, high, "declared by the FMU")
    if variable.nominal not in (0.0, 1.0) and math.isfinite(variable.nominal):
        size, origin = abs(variable.nominal), "guessed: start value +- nominal value"
    elif variable.start != 0.0 and variable.unit in _SWINGS_OF:
        size = _SWINGS_OF[variable.unit](abs(variable.start))
        origin = f"guessed: start value +- {size:g} {variable.unit}"
    elif variable.start != 0.0:
        size, origin = abs(variable.start), "guessed: start value +- its size"
    else:
        size, origin = 1.0, "guessed: the FMU declares neither range nor nominal value"
    guess = max(low, variable.start - size), min(high, variable.start + size)
    if not guess[0] < guess[1]:
        guess = (low, low + 2 * size) if math.isfinite(low) else (high - 2 * size, high)
    return Bounds(*guess, origin)


def rest_and_room(inputs: Sequence[Variable], bounds: Mapping[str, Bounds]) -> tuple[FloatArray, FloatArray]:
    """Return the inputs at rest and, signed, the room in the direction in which there is more of it."""
    low = np.array([bounds[v.name].low for v in inputs])
    high = np.array([bounds[v.name].high for v in inputs])
    rest = np.clip([v.start for v in inputs], low, high)
    return rest, np.where(high - rest >= rest - low, high - rest, low - rest)


@dataclass(frozen=True, slots=True)
class Range:
    """The part of the inputs' ranges that the study works in.

    Parameters
    ----------
    rest, low, high : array, shape (m,)
        Inputs at rest, and how far experiment and setpoints take them.
    """

    rest: FloatArray
    low: FloatArray
    high: FloatArray

    @property
    def size(self) -> FloatArray:
        """How far the inputs go at most, shape (m,)."""
        return np.maximum(self.high - self.rest, self.rest - self.low)

    def of(self, inputs: Sequence[int]) -> Self:
        """Return the ranges of some of the inputs."""
        chosen = list(inputs)
        return type(self)(self.rest[chosen], self.low[chosen], self.high[chosen])


def working_range(inputs: Sequence[Variable], bounds: Mapping[str, Bounds]) -> Range:
    """Return the range around rest in which experiment and setpoints keep the inputs."""
    rest, _ = rest_and_room(inputs, bounds)
    low = np.array([bounds[v.name].low for v in inputs])
    high = np.array([bounds[v.name].high for v in inputs])
    width = _EXCITED * (high - low)
    return Range(rest, np.maximum(low, rest - width), np.minimum(high, rest + width))


def guessed_time_scale(request: Request, stop_time: float, step_size: float | None) -> float | None:
    """Return how long a plant may take to get where it goes [s], from what is asked for or declared.

    Parameters
    ----------
    request : Request
        Its sampling time counts first, then its duration.
    stop_time, step_size : float
        Of the FMU's default experiment [s]; a stop time of 0 and None stand for none.
    """
    if request.sampling_time is not None:
        return request.sampling_time * _SAMPLES_PER_SETTLING
    if request.duration is not None:
        return request.duration * _SETTLING_IN_DURATION
    samples = stop_time / step_size if step_size else 0.0
    if step_size and (not stop_time > 0.0 or _FEWEST_SAMPLES <= samples <= _MOST_SAMPLES):
        return step_size * _SAMPLES_PER_SETTLING
    return stop_time * _SETTLING_IN_DURATION if stop_time > 0.0 else None


def sampling_time(
    tested: StepTest, choice: Choice, fixed_step: float | None, duration: float | None
) -> float:
    """Return a sampling time [s]: 1, 2 or 5 times a power of ten, or a multiple of fixed steps.

    A duration that is given is an integer multiple of the sampling time.

    Raises
    ------
    ConfigError
        It is not an integer multiple of the fixed step.
    """
    responses = [tested.responses[j][i] for j in choice.outputs for i in choice.inputs]
    slow = [r for r in responses if r.type is ResponseType.SETTLED and not (r.is_transient or r.rings)]
    slow = [r for r in slow if not tested.is_immediate(r)]
    constants = [max(r.dead_time, _time_constant(r)) for r in slow]
    at_once = [_time_constant(r) for r in slow if abs(r.feedthrough) > _JUMPS]
    wanted = max([choice.time_scale, *(_TIME_CONSTANTS_PER_SETTLING * constant for constant in at_once)])
    wanted /= _SAMPLES_PER_SETTLING
    if constants and not any(r.is_unstable for r in responses):  # horizons must reach beyond a dead time
        wanted = max(wanted, max(r.dead_time for r in slow) / _SAMPLES_PER_TIME_CONSTANT)
    rises = [r.rise_time for r in responses if (r.rings and not r.is_transient) or r.type is _SWINGS]
    rises += swings(tested, choice.outputs).values()
    limits = [part / _SAMPLES_PER_TIME_CONSTANT for r in slow if (part := _fast_part(r))]
    limits += [rise / _SAMPLES_PER_RISE for rise in (*constants, *rises)]
    limits += [r.rise_time / _SAMPLES_PER_LAG for r in responses if r.type is _LAGS and r.rise_time > 0.0]
    if not choice.guessed:
        most = _MOST_SAMPLES_PER_RINGING if rises else _MOST_SAMPLES_PER_SETTLING
        wanted = max(min((wanted, *limits)), choice.time_scale / most)
    clocks = (
        r.held for j in choice.outputs for r in tested.responses[j]
    )  # an output's own, whatever the input
    wanted = max(wanted, float(tested.time[0]), *clocks)
    multiple = 1 if fixed_step is None else max(1, round(wanted / fixed_step))
    sample = nearest_125(wanted) if fixed_step is None else multiple * fixed_step
    if fixed_step is None and duration is None and tested.period.seconds > 2 * sample:
        return _part_of(tested.period.seconds, sample)
    if duration is None or _divides(sample, duration):
        return sample
    if fixed_step is None:
        return duration / math.ceil(duration / sample)
    fitting = [m * fixed_step for m in range(multiple, 0, -1) if _divides(m * fixed_step, duration)]
    if not fitting:
        raise ConfigError(
            f"duration = {duration:g} must be a whole multiple of the fixed step {fixed_step:g} s"
        )
    return fitting[0]


def _time_constant(response: Response) -> float:
    """Return the time constant of a response that settles [s]: of what it does not do at once."""
    settling = response.settling_time / _TIME_CONSTANTS_PER_SETTLING
    return max(settling, response.lag) if abs(response.feedthrough) > _JUMPS else settling


def _fast_part(response: Response) -> float:
    """Return the time constant of a quarter of what takes time, where the rest takes longer [s].

    It is 0 of a lag of first order, and where what is fast is so fast that the rest is all that one can see.
    """
    fast = response.quarter_time / _QUARTER
    share = fast / _time_constant(response)
    return fast if _FAR < share < _EARLY else 0.0


def _part_of(period: float, sample: float) -> float:
    """Return a part of a period near a sampling time [s], with as few digits as possible."""
    fewest, most = math.ceil(period / sample / _NEAR), math.floor(period / sample * _NEAR)
    parts = [clean(period / count) for count in range(max(1, fewest), max(1, most) + 1)] or [sample]
    return min(parts, key=lambda part: (len(f"{part:.12g}".strip("0.")), abs(math.log(part / sample))))


def whole_periods(samples: int, sample: float, period: float) -> int:
    """Return so many samples, or more of them, that they are whole periods [s], if that is not for ever."""
    if not period > 0.0:
        return samples
    whole = round(math.ceil(samples * sample / period - _ROUNDING) * period / sample)
    return whole if whole <= max(_MOST_IN_PERIODS, samples) else samples


def _divides(sample: float, duration: float) -> bool:
    try:
        return whole_steps(duration, sample) > 0
    except ConfigError:
        return False


def _swing_time(time: FloatArray, y: FloatArray) -> float:
    """Return how long an output that moves at rest takes for half its range where it is fastest [s]."""
    y = without_spike(y)
    slopes = np.sort(np.abs(np.diff(y) / np.diff(time)))
    return float(np.ptp(y)) / 2 / float(slopes[-1])


def nearest_125(value: float) -> float:
    """Return the nearest of 1, 2, 5 times a power of ten; near in the ratio."""
    exponent = math.floor(math.log10(value))
    candidates = [float(f"{digit}e{exponent}") for digit in (1, 2, 5, 10)]
    return min(candidates, key=lambda candidate: abs(math.log(candidate / value)))


@dataclass(frozen=True, slots=True)
class Reach:
    """How far each chosen output goes from where it rests.

    Parameters
    ----------
    up, down : array, shape (p,)
        Where the inputs are as linear gains say they must be for the setpoints; infinite where that was not
        tried.
    """

    up: FloatArray
    down: FloatArray

    @classmethod
    def unknown(cls, outputs: int) -> "Reach":
        """Return what is known of outputs before anything is tried."""
        return cls(np.full(outputs, np.inf), np.full(outputs, np.inf))

    def less(self, ways: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Return how far setpoints may go, up and down, where gains promise more than was reached."""
        pairs = zip(ways, (self.up, self.down), strict=True)
        up, down = (np.where(reached < _AS_FAR * way, _FREE * reached, way) for way, reached in pairs)
        return up, down


def setpoints(
    tested: StepTest,
    choice: Choice,
    outputs: Sequence[Variable],
    working: Range,
    sample: float,
    request: Request,
    reach: Reach | None = None,
) -> tuple[dict[str, Reference], float]:
    """Return a reference in steps for each chosen output, and the duration of the loop [s].

    One after the other the outputs go up, then down: to the ends of a range that is asked for, else as far as
    the inputs can hold them (where that was tried, no further than they went), and half of the way to a limit
    of the output at most.

    Raises
    ------
    ConfigError
        The duration that is asked for has fewer samples than there are steps.
    """
    n, rest = len(choice.outputs), where_it_rests(tested)
    hold = max(_LEAST_SAMPLES_PER_SETPOINT, math.ceil(_SETTLING_PER_SETPOINT * choice.time_scale / sample))
    hold = whole_periods(hold, sample, tested.period.seconds)
    samples = 2 * n * hold if request.duration is None else whole_steps(request.duration, sample)
    if samples < 2 * n:
        short = f"duration = {request.duration:g} has {samples} samples of {sample:g} s"
        raise ConfigError(f"{short}; needed: at least {2 * n}, one for each step of a setpoint")
    ways = reachable(choice.gains, working)
    if reach is not None:
        ways = reach.less(ways)
    up, down = (np.minimum(way, limits(tested, choice)) for way in ways)
    references = dict[str, Reference]()
    for position, j in enumerate(choice.outputs):
        first, output = _inside(rest[j], outputs[j]), outputs[j]
        rise = min(up[position], _ROOM * (output.max - first))
        fall = min(down[position], _ROOM * (first - output.min))
        if output.name in request.ranges:
            low, high = request.ranges[output.name]
            first = min(max(first, low), high)
            rise, fall = high - first, first - low
        values = [first, first + rise, first - fall]
        steps = dict(zip((0, position, n + position), values, strict=True))  # the first output starts at once
        resolution = max(rise, fall) / 100
        references[outputs[j].name] = Steps(
            tuple(clean(k * samples // (2 * n) * sample) for k in steps),
            tuple(rounded(value, resolution) for value in steps.values()),
        )
    return references, clean(samples * sample)


def limits(tested: StepTest, choice: Choice) -> FloatArray:
    """Return how far each chosen output may go from rest in view of a limit of its own, shape (p,)."""
    return np.array([_ROOM * tested.own_limit(j) for j in choice.outputs])


def near_rest(
    tested: StepTest, choice: Choice, outputs: Sequence[Variable], duration: float
) -> dict[str, Reference]:
    """Return a reference for each chosen output that stays where it begins, and then makes a small step."""
    references = dict[str, Reference]()
    for j in choice.outputs:
        first = float(tested.rest[0, j])
        step = _SMALL_STEP * max(abs(response.effect) or response.peak for response in tested.responses[j])
        if not first + step <= outputs[j].max and first - step >= outputs[j].min:
            step = -step
        step = float(np.clip(first + step, outputs[j].min, outputs[j].max)) - first
        values = (clean(first), rounded(first + step, abs(step) / 10))
        references[outputs[j].name] = Steps((0.0, clean(duration / 2)), values)
    return references


def where_it_rests(tested: StepTest) -> FloatArray:
    """Return the outputs while the inputs rest: where they end, or where they begin if they drift.

    Of those that repeat themselves it is the mean over whole periods.
    """
    rest: FloatArray = np.where(drifting(tested), tested.rest[0], tested.rest[-1])
    for j, mean in tested.period.means.items():
        rest[j] = mean
    return rest


def drifting(tested: StepTest) -> NDArray[np.bool_]:
    """Return which outputs do not come to rest though the inputs do, and do not repeat themselves either.

    What fades away from block to block, each twice as long, is on its way to where it rests.
    """
    moving = unsteady(tested)
    moving[list(tested.period.means)] = False
    return moving


def unsteady(tested: StepTest) -> NDArray[np.bool_]:
    """Return which outputs do not come to rest though the inputs do."""
    last = np.ptp(tested.rest[-BLOCK:], axis=0)
    peaks = [max(response.peak for response in row) for row in tested.responses]
    moving: NDArray[np.bool_] = last > _DRIFT * np.array(peaks)
    if len(tested.rest) >= 2 * BLOCK:
        moving &= last > _FADING * np.ptp(tested.rest[-2 * BLOCK : -BLOCK], axis=0)
    return moving


def swings(tested: StepTest, outputs: Sequence[int]) -> dict[int, float]:
    """Return of the outputs that do not rest how long they take for half their range [s], by position."""
    moving = unsteady(tested)
    return {j: _swing_time(tested.time, tested.rest[:, j]) for j in outputs if moving[j]}


def reachable(gains: FloatArray, working: Range) -> tuple[FloatArray, FloatArray]:
    """Return how far all outputs can go up and down at the same time, each of shape (p,)."""
    needed = np.linalg.pinv(gains)  # change of inputs per change of output, shape (m, p)
    up_room, down_room = working.high - working.rest, working.rest - working.low
    directions = []
    for sign in (1.0, -1.0):
        use = sign * needed
        room = np.where(use > 0.0, up_room[:, np.newaxis], down_room[:, np.newaxis])
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(use != 0.0, room / np.abs(use), np.inf)
        directions.append(_REACHED * np.min(share, axis=0) / len(gains))
    return directions[0], directions[1]


def _inside(value: float, output: Variable) -> float:
    width = output.max - output.min
    margin = _MARGIN * width if math.isfinite(width) else 0.0
    return float(np.clip(value, output.min + margin, output.max - margin))


def rounded(value: float, resolution: float) -> float:
    """Return a value rounded to a power of ten that does not exceed the resolution."""
    if resolution <= 0.0 or not math.isfinite(resolution):
        return float(value)
    return clean(round(value, -math.floor(math.log10(resolution))))


def clean(value: float) -> float:
    """Return a value without the rounding error of its last digits."""
    return float(f"{value:.12g}")


def excitation(inputs: Sequence[Variable], working: Range, samples: int) -> dict[str, UniformRandom]:
    """Return the recording's random inputs, which go through the working range."""
    signals = {}
    for variable, low, high in zip(inputs, working.low.tolist(), working.high.tolist(), strict=True):
        resolution = (high - low) / 100
        signals[variable.name] = UniformRandom(rounded(low, resolution), rounded(high, resolution), samples)
    return signals


def first_gains(tested: StepTest, choice: Choice, sample: float) -> FloatArray:
    """Return the change of the chosen outputs one sample after unit steps of the chosen inputs, shape (p, m).

    Responses are taken for those of first-order lags and of integrators behind a lag.
    """
    gains = np.zeros((len(choice.outputs), len(choice.inputs)))
    for row, j in enumerate(choice.outputs):
        for column, i in enumerate(choice.inputs):
            response = tested.responses[j][i]
            lag = response.rise_time
            covered = 1.0 - math.exp(-sample / lag) if lag > 0.0 else 1.0
            if response.type is ResponseType.INTEGRATING:
                change = response.slope * (sample - lag * covered)
            else:
                change = (response.effect if not response.is_transient else response.peak) * covered
            gains[row, column] = change / tested.steps[i]
    return gains


_OUTPUT_WEIGHT, _SETPOINT_WEIGHT, _INPUT_WEIGHT = 10.0, 30.0, 0.1
_DAMPING = 5.0


@dataclass(frozen=True, slots=True)
class ScaledGains:
    """How the outputs follow the inputs, all signals in parts of their nominal values.

    Parameters
    ----------
    first : array, shape (p, m)
        Change of the outputs one sample after a step of one unit.
    lasting : array, shape (p, m)
        Change in the end.
    """

    first: FloatArray
    lasting: FloatArray


WHY_SETTINGS = {
    "deepc": 'affine_sum = "all" admits an operating point other than zero; '
    "lambda_g up: calmer with noise and nonlinear plants, down: faster",
    "mfapc": "initial_gradient: change of the outputs one sample after a unit step, in parts of nominal "
    "values; lambda_u up: calmer, down: faster",
    "mpc": "the model is identified from the recording; input_weight up: calmer, down: faster",
    "pid": "gains from a step test on the recording; pairing: number of the input for each output",
}
"""What the settings of a type of controller are good for."""


def suggested_controllers(gains: ScaledGains, *, may_record: bool) -> dict[str, ControllerSection]:
    """Return the installed controllers that settings are known for, by key.

    Parameters
    ----------
    gains : ScaledGains
        The plant's.
    may_record : bool
        Whether the plant can be recorded in open loop.
    """
    installed = plugin_names("controllers")
    suggested = [_mfapc(gains)]
    if may_record:
        suggested += [_deepc(), _mpc(), *_pid(gains)]
    return {controller.type: controller for controller in suggested if controller.type in installed}


def _deepc() -> ControllerSection:
    settings = {
        "initial_length": _INITIAL_LENGTH,
        "horizon": _HORIZON,
        "output_weight": _OUTPUT_WEIGHT,
        "setpoint_weight": _SETPOINT_WEIGHT,
        "input_weight": _INPUT_WEIGHT,
        "lambda_g": 1.0,
        "lambda_sigma": 1e5,
        "affine_sum": "all",
    }
    return ControllerSection(type="deepc", label="DeePC", settings=settings)


def _mfapc(gains: ScaledGains) -> ControllerSection:
    gradient = gains.first if gains.first.any() else gains.lasting
    strength = float(np.mean(np.sum(gradient**2, axis=0)))
    settings = {
        "horizon": _HORIZON,
        "lambda_u": _significant(_DAMPING * _HORIZON * strength),
        "mu": 0.25,
        "epsilon": _significant(1e-5 * min(1.0, _smallest(gradient))),
        "initial_gradient": [[_significant(float(entry)) for entry in row] for row in gradient],
    }
    return ControllerSection(type="mfapc", label="MFAPC-CFDL", settings=settings)


def _mpc() -> ControllerSection:
    settings = {"horizon": _HORIZON, "output_weight": _OUTPUT_WEIGHT, "input_weight": _INPUT_WEIGHT}
    return ControllerSection(type="mpc", label="MPC, model identified", settings=settings)


def _pid(gains: ScaledGains) -> list[ControllerSection]:
    """Return PID loops, each output with the input that moves it most; none if inputs are too few."""
    outputs, inputs = gains.lasting.shape
    if outputs > inputs:
        return []
    moved = np.abs(gains.lasting).tolist()
    # Signals are so few that all pairings can be tried.
    pairing = max(
        permutations(range(inputs), outputs),
        key=lambda order: sum(moved[j][i] for j, i in enumerate(order)),
    )
    settings = {"tuning": "step-test", "pairing": [*pairing]}
    return [ControllerSection(type="pid", label="PID, step test", settings=settings)]


def _smallest(gradient: FloatArray) -> float:
    magnitudes = np.abs(gradient[gradient != 0.0])
    return float(magnitudes.min()) if magnitudes.size else 1.0


def _significant(value: float) -> float:
    return float(f"{value:.3g}")


def recording_length(controller: ControllerSection, inputs: int, outputs: int, measurements: int) -> int:
    """Return the fewest samples of a recording that a controller can learn from."""
    from ddpc_cosim.study.controller_plugins import make_controller

    made = make_controller(controller.type, controller.settings)
    return safe_calls.recording_length(made, inputs, outputs, measurements)
