"""PID control in parallel form, one loop for every pair of an output and an input.

    v = K_p (b r - y) + I + D,   u = v within its limits
    I = I + h K_i (r - y) + min(h / T_t, 1) (u - v)    (back-calculation), or
    I = I + h K_i (r - y) unless that drives v further beyond its limit (clamping)
    D = (T_f D - K_d (y - y_before)) / (T_f + t)        (backward difference of K_d s / (T_f s + 1))

after K. J. Astrom, T. Hagglund, Advanced PID Control, ISA 2006, sections 3.4, 3.5 and 13.2. The integral is
the backward difference too, so that v of a sample contains its error; without integral action, K_i = 0, it
is a constant. The time t since y_before is h, and longer after missing measurements. As r the loop takes
the reference of the next sample: the first that this input can reach.

Gains from a step test, or any other experiment, by the SIMC rules: a second-order model with delay, ``k
exp(-theta s) / (tau^2 s^2 + 2 zeta tau s + 1)``, is fitted to the recording; the gains make the closed loop
a first-order lag with delay (S. Skogestad, Simple analytic rules for model reduction and PID controller
tuning, J. Process Control 13, 2003, doi:10.1016/S0959-1524(02)00062-8). An inverse response counts as
delay. A lag that is long against the delay gets his shorter integral time; an oscillatory pair has none to
shorten. The rules know neither sampling nor zeros: the sampled loop with the fitted model is made slower
until it is stable and its maximum sensitivity ``M_s = max |1 / (1 + P C)|`` is 1.7 at most (Astrom and
Hagglund ask for 1.4 to 2), which is a gain margin of 2.4; a time that was asked for is kept, with a
warning. Loops are judged one by one.

What is known to disturb the plant can be fed forward, by an addition to v: see
:mod:`ddpc_controllers.models.feedforward`.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite, log, sqrt
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from ddpc_controllers.checks import prior_info, without_forecast
from ddpc_controllers.data.hankel import count_windows, matching_recording, resting_input, without_first
from ddpc_controllers.export.code import ALL_AHEAD, Code, Exportable
from ddpc_controllers.models.feedforward import Feedback, Feedforward, identify_feedforward
from ddpc_controllers.models.identification import fit_arx, never_moved
from ddpc_controllers.optimisation.limits import HELD_WITHOUT_MEASUREMENT, HELD_WITHOUT_REFERENCE
from ddpc_cosim import (
    Action,
    ConfigError,
    DataError,
    Factor,
    FloatArray,
    Linear,
    Loop,
    Recording,
    Sample,
    Weight,
    check_settings,
    setting,
)

_LAGS = 2
_LARGEST_DELAY = 20
_FASTEST_POLE = 1e-3
_FILTER = 0.1
_SAMPLES = 4
_LARGEST_SENSITIVITY = 1.7
_SLOWER, _SLOWEST = 1.02, 1e3
_FREQUENCIES, _NEAR = np.geomspace(1e-6, np.pi, 1000), np.linspace(-3.0, 3.0, 25)


class Gains(NamedTuple):
    """The gains of PID loops in parallel form, one entry per loop.

    Parameters
    ----------
    proportional, integral, derivative : array, shape (loops,)
        K_p, K_i [1/s] and K_d [s].
    filter_time : array, shape (loops,)
        T_f [s].
    """

    proportional: FloatArray
    integral: FloatArray
    derivative: FloatArray
    filter_time: FloatArray


class TunedLoops(NamedTuple):
    """Loops tuned on a recording, one entry of every array per loop.

    Parameters
    ----------
    gains : Gains
        Their gains.
    maximum_sensitivity : array, shape (loops,)
        M_s of the sampled loop with the fitted model; infinite if that is not stable.
    closed_loop_time : array, shape (loops,)
        Time constant of the closed loop that keeps the margin [s]: the loop's, unless one was asked for;
        infinite if none does.
    """

    gains: Gains
    maximum_sensitivity: FloatArray
    closed_loop_time: FloatArray


class PulseTransferFunction(NamedTuple):
    """``y = z^-delay (b_1 z + b_2) / (z^2 + a_1 z + a_2) u``.

    The name is that of K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, chapter 2.

    Parameters
    ----------
    numerator, denominator : array, shapes (2,) and (3,)
        Coefficients of falling powers of z.
    delay : int
        Samples.
    """

    numerator: FloatArray
    denominator: FloatArray
    delay: int


@dataclass(frozen=True, slots=True)
class SecondOrder:
    """A second-order model with delay.

    Parameters
    ----------
    gain : float
        k, steady output over input.
    poles : (complex, complex)
        The poles [1/s].
    delay : float
        theta [s], inverse response included.
    """

    gain: float
    poles: tuple[complex, complex]
    delay: float


def fewest_test_samples(inputs: int) -> int:
    """Return the fewest samples that a model can be fitted to, for so many inputs."""
    return _LAGS * (2 + inputs) + _LAGS + 1


def tune_from_recording(
    recording: Recording, pairs: Sequence[int], closed_loop_time: float = 0.0
) -> TunedLoops:
    """Tune one loop per output, the input of output i being ``pairs[i]``.

    Raises
    ------
    DataError
        The recording is too short, shows a loop that the rules do not cover, or, with no closed-loop time
        asked for, one without gains that keep the margin.
    """
    needed = fewest_test_samples(recording.u.shape[1])
    if count_windows(len(recording), _LAGS + 1, recording.seams) < needed - _LAGS:
        raise DataError(
            f"PID: the recording has {len(recording)} samples; a step test takes at least {needed}"
        )
    loops = [_tune_one(recording, output, chosen, closed_loop_time) for output, chosen in enumerate(pairs)]
    *gains, sensitivities, times = (np.array(values) for values in zip(*loops, strict=True))
    return TunedLoops(Gains(*gains), sensitivities, times)


def _tune_one(recording: Recording, output: int, chosen: int, wanted: float) -> tuple[float, ...]:
    """Return the gains of a loop, its maximum sensitivity, and the time constant that keeps the margin."""
    h, (model, sampled) = recording.sampling_time, fit_second_order(recording, output, chosen)
    first = time = wanted or _rule_of_thumb(model, h)
    gains = simc(model, h, time)
    reached = margin = sensitivity(sampled, gains, h)
    while margin > _LARGEST_SENSITIVITY:
        time *= _SLOWER
        if time > _SLOWEST * first:
            time = inf
            break
        slower = simc(model, h, time)
        margin = sensitivity(sampled, slower, h)
        if not wanted:
            gains, reached = slower, margin
    if wanted or isfinite(time):
        return *gains, reached, time
    raise DataError(
        f"PID: no closed_loop_time up to {_SLOWEST * first:.4g} s gives the loop of output {output} and "
        f"input {chosen} a maximum sensitivity of {_LARGEST_SENSITIVITY} on the model of the recording: "
        "tune by hand"
    )


def sensitivity(model: PulseTransferFunction, gains: Sequence[float], sampling_time: float) -> float:
    """Return the maximum sensitivity M_s of the sampled loop; infinite if that is not stable.

    Parameters
    ----------
    model : PulseTransferFunction
        The plant.
    gains : sequence of float
        K_p, K_i, K_d and T_f.
    sampling_time : float
        h [s].
    """
    kp, ki, kd, filter_time = gains
    integrates, filters = np.array([1.0, -1.0]), np.array([filter_time + sampling_time, -filter_time])
    # C = K_p + h K_i z / (z - 1) + K_d (z - 1) / ((T_f + h) z - T_f)
    denominator = np.convolve(integrates, filters)
    numerator = kp * denominator + np.convolve([sampling_time * ki, 0.0], filters)
    numerator = numerator + kd * np.convolve(integrates, integrates)
    open_loop = np.convolve(np.append(model.denominator, np.zeros(model.delay)), denominator)
    closed_loop = np.polyadd(open_loop, np.convolve(model.numerator, numerator))
    poles = np.roots(closed_loop)
    if np.abs(poles).max() >= 1.0:
        return float("inf")
    # Peaks are as narrow as the poles near them are close to the circle.
    near_poles = np.angle(poles) + np.outer(_NEAR, 1.0 - np.abs(poles))
    z = np.exp(1j * np.append(_FREQUENCIES, near_poles))
    return float(np.abs(np.polyval(open_loop, z) / np.polyval(closed_loop, z)).max())


def _rule_of_thumb(model: SecondOrder, sampling_time: float) -> float:
    """Return SIMC's closed-loop time, the delay, or the four samples that are the least [s]."""
    return max(model.delay + sampling_time / 2.0, _SAMPLES * sampling_time)


def fit_second_order(
    recording: Recording, output: int, chosen: int
) -> tuple[SecondOrder, PulseTransferFunction]:
    """Fit a second-order model with the delay, in whole samples, that explains an output best.

    Returns
    -------
    model : SecondOrder
        What the rules are for.
    sampled : PulseTransferFunction
        The model as it was fitted.

    Raises
    ------
    DataError
        The output grows without the input, or does not follow it.
    """
    h, samples = recording.sampling_time, len(recording)
    equations = fewest_test_samples(recording.u.shape[1]) - _LAGS
    delays = [
        d
        for d in range(_LARGEST_DELAY + 1)
        if count_windows(samples, d + _LAGS + 1, recording.seams) >= equations
    ]
    models = [fit_arx(_delayed(recording, output, d), _LAGS) for d in delays]
    delay = delays[int(np.argmin([model.fit["one_step_error"] for model in models]))]
    model = fit_arx(without_first(_delayed(recording, output, delay), delay), _LAGS)
    discrete = np.roots([1.0, *(-model.a[:, 0])])
    if np.abs(discrete).max() > 1.0 + 1.0 / samples:
        raise DataError(
            f"PID: output {output} of the recording grows by itself, by up to {np.abs(discrete).max():.4g} a "
            "sample: tune by hand"
        )
    # What is slower than the experiment counts as ten times as long, what is faster than sampling as instant.
    slowest = np.exp(-0.1 / samples)
    held = np.poly([pole * min(1.0, slowest / max(abs(pole), _FASTEST_POLE)) for pole in discrete])
    sampled = PulseTransferFunction(model.b[:, chosen], np.asarray(held.real, dtype=np.float64), delay)
    discrete = np.array([_within(pole, _FASTEST_POLE, slowest) for pole in discrete])
    gain = float(model.b[:, chosen].sum() / np.prod(1.0 - discrete).real)
    if gain == 0.0 or not np.isfinite(gain):
        raise DataError(f"PID: output {output} of the recording does not follow input {chosen}: tune by hand")
    first, second = np.log(discrete.astype(complex)) / h
    inverse = _inverse_response(model.b[:, chosen], h)
    return SecondOrder(gain, (complex(first), complex(second)), delay * h + inverse), sampled


def simc(model: SecondOrder, sampling_time: float, closed_loop_time: float = 0.0) -> tuple[float, ...]:
    """Return K_p, K_i, K_d and T_f by the SIMC rules.

    Parameters
    ----------
    model : SecondOrder
        The plant.
    sampling_time : float
        Half of it adds to the delay: what holding the input costs [s].
    closed_loop_time : float
        Time constant of the closed loop [s]; 0: the delay, but four samples at least, which gives the nine
        samples per rise time of K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, section 3.3.
    """
    delay = model.delay + sampling_time / 2.0
    rest = (closed_loop_time or _rule_of_thumb(model, sampling_time)) + delay
    if model.poles[0].imag == 0.0:
        long, short = sorted((-1.0 / model.poles[0].real, -1.0 / model.poles[1].real), reverse=True)
        series = long / (model.gain * rest)
        integral_time = min(long, 4.0 * rest)
        gains = series * (1.0 + short / integral_time), series / integral_time, series * short
    else:
        squared = 1.0 / abs(model.poles[0]) ** 2  # tau^2
        damping = -2.0 * model.poles[0].real * squared  # 2 zeta tau
        gains = damping / (model.gain * rest), 1.0 / (model.gain * rest), squared / (model.gain * rest)
    kp, ki, kd = gains
    # K_d / K_p alone is longer than the period of a lightly damped pair, which the filter would destabilise.
    return *gains, _FILTER * min(abs(kd / kp), sqrt(kd / ki))


def _delayed(recording: Recording, output: int, samples: int) -> Recording:
    """Return one output, and inputs that come later; before, they were as at the beginning of each piece."""
    u = [
        np.vstack([np.repeat(piece.u[:1], samples, axis=0), piece.u])[: len(piece)]
        for piece in recording.pieces
    ]
    y = recording.y[:, [output]]
    return replace(recording, u=np.vstack(u), y=y, measured=y)


def _inverse_response(past_u: FloatArray, h: float) -> float:
    """Return T_0 [s] of the factor ``1 - T_0 s`` that a sampled zero beyond 1 stands for; 0 if there is none.

    A negative zero is not an inverse response: sampling alone brings it about.
    """
    latest, older = past_u.tolist()
    if -older * latest <= latest**2:  # the zero, -older / latest, is not beyond 1
        return 0.0
    return h / log(-older / latest)


def _within(pole: complex, fastest: float, slowest: float) -> complex:
    if pole.imag:
        return pole * min(1.0, slowest / abs(pole))
    return complex(min(max(pole.real, fastest), slowest))


Tuning = Literal["manual", "step-test"]
AntiWindup = Literal["back-calculation", "clamping"]


@dataclass(kw_only=True)
class PID(Exportable):
    """PID control with anti-windup, derivative filter and setpoint weight.

    A gain is a number for all loops or one per loop. Output i is controlled by input ``pairing[i]``. While a
    measurement or a reference is not finite the inputs are held, which is a status.
    """

    _known_in_c: ClassVar[Collection[str]] = ALL_AHEAD
    _follows_in_c: ClassVar[bool] = True

    tuning: Tuning = setting(
        "manual", choices=("manual", "step-test"), doc="gains as given, or by SIMC from the recording"
    )
    proportional: Weight = setting(1.0, doc="K_p", search=Factor(0.1, 10.0))
    integral: Weight = setting(0.0, doc="K_i [1/s]", search=Factor(0.1, 10.0))
    derivative: Weight = setting(0.0, doc="K_d [s]", search=Factor(0.1, 10.0))
    filter_time: float = setting(0.0, low=0.0, unit="s", doc="T_f of the derivative filter; 0: none")
    setpoint_share: float = setting(
        1.0,
        low=0.0,
        high=1.0,
        doc="b: share of the reference in the proportional part",
        search=Linear(0.0, 1.0),
    )
    anti_windup: AntiWindup = setting(
        "back-calculation", choices=("back-calculation", "clamping"), doc="what holds the integral at a limit"
    )
    tracking_time: float = setting(
        0.0, low=0.0, unit="s", doc="T_t of the back-calculation; 0: one sample, the fastest"
    )
    closed_loop_time: float = setting(
        0.0,
        low=0.0,
        unit="s",
        doc="step-test: time constant asked of the closed loop; 0: SIMC's, or four samples, or what "
        "keeps a maximum sensitivity of 1.7",
        search=Factor(0.2, 5.0),
    )
    pairing: Sequence[int] = setting((), doc="number of the input for each output; empty: in their order")
    feedforward: bool = setting(
        False, doc="feed known disturbances forward, as a recording shows that they act; then it needs one"
    )

    def __post_init__(self) -> None:
        check_settings(self)

    accepts_missing: ClassVar[bool] = True

    @property
    def uses_recording(self) -> bool:
        """Whether ``start`` needs a recording."""
        return self.tuning == "step-test" or self.feedforward

    def start(self, loop: Loop) -> None:
        """Tune the loops, or take the gains as given.

        Raises
        ------
        DataError
            The recording cannot serve the tuning.
        ConfigError
            The pairing or a gain does not fit the number of signals.
        """
        self._pairs = self._checked_pairs(len(loop.inputs), len(loop.outputs))
        self._tuned = self._tune(loop) if self.tuning == "step-test" else None
        self._gains = self._tuned.gains if self._tuned else self._given()
        h = loop.sampling_time
        self._sampling_time = self._elapsed = h
        # A loop without integral action has nothing that winds up, and would not get its bias back.
        self._tracking = np.where(self._gains.integral != 0.0, h / max(self.tracking_time, h), 0.0)
        self._u = resting_input(loop)
        self._low, self._high = loop.bounds.u_min[self._pairs], loop.bounds.u_max[self._pairs]
        self._moving = bool({loop.inputs[i].name for i in self._pairs} & {*loop.moving_limits})
        self._derivative = np.zeros(len(self._pairs))
        self._integral: FloatArray | None = None
        self._y: FloatArray | None = None
        self._taken_over = False
        self._forward = self._fed_forward(loop)
        if loop.continues_recording and loop.recording is not None:
            self._u, self._y = loop.recording.u[-1].copy(), loop.recording.y[-1]
        elif loop.past:
            self._take_over(loop.past)

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the inputs of all loops, within their limits."""
        gains, h, y, r = self._gains, self._sampling_time, sample.y, sample.reference[0]
        if not np.isfinite(y).all():
            return self._hold(HELD_WITHOUT_MEASUREMENT)
        if not np.isfinite(r).all():
            return self._hold(HELD_WITHOUT_REFERENCE)
        before = y if self._y is None else self._y
        proportional = gains.proportional * (self.setpoint_share * r - y)
        if self._taken_over:  # the last inputs were its own, for the reference of this sample
            self._integral = self._u[self._pairs] - self._derivative - self._added
            setpoint = np.where(np.isfinite(sample.setpoint), sample.setpoint, r)
            self._integral -= gains.proportional * (self.setpoint_share * setpoint - before)
            self._taken_over = False
        self._differentiate(y - before)
        if self._integral is None:  # as if the loop had held the output where it is
            self._integral = self._u[self._pairs] + gains.proportional * (1.0 - self.setpoint_share) * y
        increment = h * gains.integral * (r - y)
        wanted = proportional + self._integral + increment + self._derivative
        if self._forward:
            wanted += self._forward.step(sample.disturbance)
        if self._moving:
            self._low, self._high = sample.input_limits[0, self._pairs].T
        limited = np.clip(wanted, self._low, self._high)
        self._integral = self._integral + self._kept(increment, limited - wanted)
        self._y, self._elapsed = y.copy(), h
        self._u[self._pairs] = limited
        return self._u.copy()

    def recording_length(self, inputs: int, outputs: int, measurements: int, disturbances: int = 0) -> int:
        """Return the fewest samples that a step test can be read from; 0 where none is needed."""
        return fewest_test_samples(inputs) if self.uses_recording else 0

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return the signals it uses, and its prior information about the plant."""
        prior = "nothing" if self.tuning == "step-test" else "gains, as they are set"
        fed_forward = loop.disturbances if self._forward else ()
        return without_forecast(prior_info(prior, loop.outputs, fed_forward), loop)

    def c_step(self, code: Code, loop: Loop) -> str:
        """Add the loops with the gains in use, given or tuned."""
        code.kernel("pid")
        p = len(self._pairs)
        forwarded = self._forward.gains.shape[1:] if self._forward else (0, 0)
        pid = code.constant(
            "PID",
            p=p,
            m=len(self._u),
            inputs=code.sizes(self._pairs),
            **{name: code.doubles(values) for name, values in self._gains._asdict().items()},
            tracking=code.doubles(self._tracking),
            **self._c_members(code),
            sampling_time=self._sampling_time,
            setpoint_share=self.setpoint_share,
            clamping=self.anti_windup == "clamping",
        )
        before = np.zeros(p) if self._y is None else self._y
        begun = [-1.0 if self._taken_over else 0.0, self._y is not None]
        fed_forward = self._forward.memory if self._forward else ()
        further = [*np.zeros(2 * p * self._moving + forwarded[1]), *fed_forward]
        starts = begun, self._elapsed, self._u, before, np.zeros(p), [*self._derivative, *further]
        *others, rate = [code.memory(start) for start in starts]
        look = ""
        if self._moving and code.ahead:
            look += code.ahead.chosen(
                code, lambda sample: sample.input_limits[0, self._pairs].T, f"{rate} + {p}"
            )
        if self._forward and code.ahead:
            place = f"{rate} + {p + 2 * p * self._moving}"
            look += code.ahead.chosen(code, lambda sample: sample.disturbance, place)
        held = code.held("PIDMemory", *others, rate)
        return code.step(f"{look}{held}pid_step(&{pid}, &held, sample, u, told);")

    def _c_members(self, code: Code) -> dict[str, object]:
        """Return the members of a structure in C about limits and feedforward."""
        members: dict[str, object] = {"moves": True}
        if not self._moving:
            members = {"low": code.doubles(self._low), "high": code.doubles(self._high)}
        if self._forward:
            _, lags, n_d = self._forward.gains.shape
            tables = {"poles": self._forward.poles, "forward": self._forward.gains}
            members |= {"disturbances": n_d, "lags": lags}
            members |= {name: code.doubles(table) for name, table in tables.items()}
        return members

    def diagnostics(self) -> Mapping[str, float]:
        """Return the gains in use; with tuned ones the maximum sensitivity, infinite if unstable."""
        shown = self._gains._asdict()
        if self._tuned:
            shown["maximum_sensitivity"] = self._tuned.maximum_sensitivity
        if self._forward:
            total = self._forward.gains.sum(axis=1)
            shown |= {f"feedforward_gain_{j}": gain for j, gain in enumerate(total.T)}
        return {
            f"{name}[{i}]": float(value)
            for name, values in shown.items()
            for i, value in enumerate(np.broadcast_to(values, len(self._pairs)))
        }

    def warnings(self) -> Sequence[str]:
        """Return which loops are faster, as asked for, than the model of the recording lets them."""
        if not self._tuned:
            return self._still
        _, sensitivities, times = self._tuned
        return [*self._still] + [
            f"PID: closed_loop_time = {self.closed_loop_time:g} s "
            + (
                f"gives loop {i} a maximum sensitivity of {sensitivity:.3g}"
                if isfinite(sensitivity)
                else f"makes loop {i} unstable"
            )
            + f" on the model of the recording; a maximum sensitivity of {_LARGEST_SENSITIVITY} takes "
            + (f"closed_loop_time = {time:.4g} s" if isfinite(time) else "gains tuned by hand")
            for i, (sensitivity, time) in enumerate(zip(sensitivities.tolist(), times.tolist(), strict=True))
            if float(f"{sensitivity:.3g}") > _LARGEST_SENSITIVITY
        ]

    def _differentiate(self, change: FloatArray) -> None:
        gains = self._gains
        self._derivative = (gains.filter_time * self._derivative - gains.derivative * change) / (
            gains.filter_time + self._elapsed
        )

    def _take_over(self, past: Recording) -> None:
        """Go on where a running plant is, as if the inputs till now had been its own."""
        for change in np.diff(past.y, axis=0):
            self._differentiate(change)
        self._added = np.zeros(len(self._pairs))
        if self._forward:
            self._added = [self._forward.step(d) for d in past.d][-1]
        self._u, self._y, self._taken_over = past.u[-1].copy(), past.y[-1], True

    def _fed_forward(self, loop: Loop) -> Feedforward | None:
        """Return what feeds disturbances forward, identified from the recording; None: nothing does."""
        self._still: tuple[str, ...] = ()
        if not (self.feedforward and loop.disturbances):
            return None
        recording = matching_recording(loop, "PID")
        self._still = never_moved(loop, recording)
        gains = identify_feedforward(recording, self._pairs, self._feedback)
        if not gains.any():
            self._still += (
                "PID: no disturbance is fed forward: these gains do not stabilise the model of the recording",
            )
        return Feedforward(gains)

    def _feedback(self, runs: int) -> Feedback:
        """Return the loops without limits and reference, for runs side by side."""
        h, (kp, ki, kd, filter_time) = self._sampling_time, (gain[:, np.newaxis] for gain in self._gains)
        integral, derivative, before = (np.zeros((len(self._pairs), runs)) for _ in range(3))

        def feedback(y: FloatArray) -> FloatArray:
            integral[:] -= h * ki * y
            derivative[:] = (filter_time * derivative - kd * (y - before)) / (filter_time + h)
            before[:] = y
            return integral + derivative - kp * y

        return feedback

    def _hold(self, why: str) -> Action:
        """Return the last inputs; the next change of the outputs spans a sample more."""
        self._elapsed += self._sampling_time
        return Action(self._u.copy(), why)

    def _kept(self, increment: FloatArray, excess: FloatArray) -> FloatArray:
        """Return by how much the integral changes, given by how much the limits changed the inputs."""
        if self.anti_windup == "clamping":
            return np.where(increment * excess < 0.0, 0.0, increment)
        return increment + self._tracking * excess

    def _checked_pairs(self, inputs: int, outputs: int) -> list[int]:
        pairs = list(self.pairing) or list(range(outputs))
        if len(pairs) != outputs or sorted({*pairs} & {*range(inputs)}) != sorted(pairs):
            raise ConfigError(
                f"PID: pairing = {pairs} does not give each of {outputs} output(s) an input of its own, "
                f"of 0 ... {inputs - 1}"
            )
        return pairs

    def _given(self) -> Gains:
        loops = len(self._pairs)
        faults, values = [], []
        for name in ("proportional", "integral", "derivative"):
            gain = np.asarray(getattr(self, name), dtype=np.float64)
            if gain.shape not in ((), (loops,)):
                faults.append(f"PID: {name} has shape {gain.shape}; needed: a number, or {loops} numbers")
            values.append(np.broadcast_to(gain, loops) if gain.ndim == 0 else gain)
        if faults:
            raise ConfigError(faults)
        proportional, integral, derivative = values
        return Gains(proportional, integral, derivative, np.full(loops, self.filter_time))

    def _tune(self, loop: Loop) -> TunedLoops:
        recording = matching_recording(loop, "PID")
        return tune_from_recording(recording, self._pairs, self.closed_loop_time)
