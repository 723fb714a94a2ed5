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

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite, log, sqrt
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddpc_controllers.checks import prior_info, without_forecast
from ddpc_controllers.data.hankel import (
    count_windows,
    matching_recording,
    resting_input,
    window_starts,
    without_first,
)
from ddpc_controllers.export.code import ALL_AHEAD, Code, Exportable
from ddpc_controllers.models.feedforward import Feedback, Feedforward, identify_feedforward
from ddpc_controllers.models.identification import (
    choose_lags,
    fit_arx,
    fit_coefficients,
    never_moved,
    one_step_errors,
)
from ddpc_controllers.models.virtual_reference import (
    ReferenceModel,
    filtered,
    noise_free,
    virtual_reference_gains,
    wanted_loop,
)
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
_SLOWER, _COARSER, _SLOWEST = 1.02, 1.05, 1e3
_FILTER_PASSES = 2
_STEP = 3
_ROUNDING = 1e-6
_UNDECIDED = 3.0
_FREQUENCIES, _NEAR = np.geomspace(1e-6, np.pi, 1000), np.linspace(-3.0, 3.0, 25)
_CIRCLE = np.exp(1j * _FREQUENCIES)
_A_FEW = _CIRCLE[501::3]
_INTEGRATOR = _A_FEW / (_A_FEW - 1.0)
_AT_ONCE = 100


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
    by_virtual_reference : array, shape (loops,)
        1 where the gains are those of a virtual reference, 0 where they are SIMC's.
    remarks : tuple of str
        What a user has to know of it.
    """

    gains: Gains
    maximum_sensitivity: FloatArray
    closed_loop_time: FloatArray
    by_virtual_reference: FloatArray
    remarks: tuple[str, ...]


class PulseTransferFunction(NamedTuple):
    """``y = z^-delay (b_1 z^(n-1) + ... + b_n) / (z^n + a_1 z^(n-1) + ... + a_n) u``.

    The name is that of K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, chapter 2.

    Parameters
    ----------
    numerator, denominator : array, shapes (n,) and (n + 1,)
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
    growth : float
        By how much the fitted model grows by itself in a sample, where that is too little to be sure of it.
    """

    gain: float
    poles: tuple[complex, complex]
    delay: float
    growth: float = 0.0


def fewest_test_samples(inputs: int) -> int:
    """Return the fewest samples that a model can be fitted to, for so many inputs."""
    return _LAGS * (2 + inputs) + _LAGS + 1


def tune_from_recording(
    recording: Recording,
    pairs: Sequence[int],
    closed_loop_time: float = 0.0,
    reference: "VirtualReference | None" = None,
) -> TunedLoops:
    """Tune one loop per output, the input of output i being ``pairs[i]``.

    Parameters
    ----------
    recording : Recording
        The experiment.
    pairs : sequence of int
        The input of every output.
    closed_loop_time : float
        Time constant asked of the closed loops [s]; 0: by the recording.
    reference : VirtualReference, optional
        Tune by virtual references; default: by the SIMC rules.

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
    loops = [
        _tune_by_virtual_reference(recording, pair, closed_loop_time, reference)
        if reference
        else _tune_by_simc(recording, pair, closed_loop_time)
        for pair in enumerate(pairs)
    ]
    return TunedLoops(
        Gains(*np.array([loop.gains for loop in loops]).T),
        np.array([loop.maximum_sensitivity for loop in loops]),
        np.array([loop.closed_loop_time for loop in loops]),
        np.array([float(loop.by_virtual_reference) for loop in loops]),
        tuple(remark for loop in loops for remark in loop.remarks),
    )


@dataclass(frozen=True, slots=True)
class VirtualReference:
    """What a loop tuned by virtual references consists of.

    Parameters
    ----------
    parts : str
        Which of P, I and D.
    filter_time : float
        T_f [s]; 0: as the SIMC rules have it here.
    setpoint_share : float
        b of the loop.
    """

    parts: str
    filter_time: float
    setpoint_share: float

    def gains(
        self,
        recording: Recording,
        pair: tuple[int, int],
        model: ReferenceModel,
        instrument: FloatArray | None,
    ) -> tuple[float, ...]:
        """Return K_p, K_i, K_d and T_f; a derivative part that works against the others is left out."""
        time, parts = self.filter_time, self.parts
        kp, ki, kd = virtual_reference_gains(recording, pair, model, parts, time, instrument).tolist()
        for _ in range(_FILTER_PASSES):  # the filter is that of the gains, which depend on it a little
            if self.filter_time or not kp * ki * kd:
                break
            time = _FILTER * min(abs(kd / kp), sqrt(abs(kd / ki)))
            kp, ki, kd = virtual_reference_gains(recording, pair, model, parts, time, instrument).tolist()
        if kd * ki < 0.0:
            parts = parts.replace("D", "")
            kp, ki, kd = virtual_reference_gains(recording, pair, model, parts, 0.0, instrument).tolist()
        return kp, ki, kd, time


class _TunedLoop(NamedTuple):
    """One loop; the fields are those of :class:`TunedLoops`."""

    gains: tuple[float, ...]
    maximum_sensitivity: float
    closed_loop_time: float
    by_virtual_reference: bool = False
    remarks: tuple[str, ...] = ()


def _tune_by_simc(recording: Recording, pair: tuple[int, int], wanted: float) -> _TunedLoop:
    h, (output, chosen) = recording.sampling_time, pair
    model, sampled = fit_second_order(recording, output, chosen)
    first = wanted or _rule_of_thumb(model, h)
    loop = _with_margin(
        lambda times: simc(model, h, times), sampled, h, first, bool(wanted), _SLOWEST * first
    )
    if not (wanted or isfinite(loop.closed_loop_time)):
        raise DataError(
            f"PID: no closed_loop_time up to {_SLOWEST * first:.4g} s gives the loop of output {output} and "
            f"input {chosen} a maximum sensitivity of {_LARGEST_SENSITIVITY} on the model of the recording: "
            "tune by hand"
        )
    return loop._replace(remarks=_integrates(output, model))


def _tune_by_virtual_reference(
    recording: Recording, pair: tuple[int, int], wanted: float, reference: VirtualReference
) -> _TunedLoop:
    """Tune a loop by a virtual reference; by SIMC where that is the better one on a model of the recording.

    The reference model has the delay and the longest lag of the model that SIMC takes. The model by which
    loops are judged is autoregressive, with as many lags as explain the output best.
    """
    h, (output, chosen) = recording.sampling_time, pair
    model, _ = fit_second_order(recording, output, chosen)
    by_simc = _tune_by_simc(recording, pair, wanted)
    y = recording.y[:, [output]]
    alone = replace(recording, y=y, measured=y)
    fitted = fit_arx(alone, choose_lags(alone))
    plant = PulseTransferFunction(fitted.b[:, chosen], np.append(1.0, -fitted.a[:, 0]), 0)
    late = int(np.ceil(model.delay / h - _ROUNDING))
    lag = -1.0 / max(pole.real for pole in model.poles) if model.poles[0].imag == 0.0 else h
    instrument = noise_free(recording, pair)

    def gains(times: FloatArray) -> FloatArray:
        time = float(times[0])
        integral_time = min(lag, 4.0 * (time + model.delay + h / 2.0))
        loop = wanted_loop(time, late, h, lag, integral_time)
        return np.array(reference.gains(recording, pair, loop, instrument))[:, np.newaxis]

    def instead(why: str) -> _TunedLoop:
        remark = f"PID: loop {output} has the gains of tuning = 'step-test': {why}"
        return by_simc._replace(remarks=(*by_simc.remarks, remark))

    first = wanted or _rule_of_thumb(model, h)
    try:
        loop = _with_margin(gains, plant, h, first, bool(wanted), max(first, len(recording) * h), _COARSER, 1)
    except DataError as fault:
        return instead(str(fault).removeprefix("PID: "))
    if not isfinite(loop.maximum_sensitivity) or not (wanted or isfinite(loop.closed_loop_time)):
        return instead(
            "those of a virtual reference "
            + ("are unstable" if wanted else f"have no maximum sensitivity of {_LARGEST_SENSITIVITY}")
            + " on the model of the recording"
        )
    # Who asked for fewer parts gets them; of the same parts, the better gains.
    if reference.parts == "PID" and sensitivity(plant, by_simc.gains, h) <= _LARGEST_SENSITIVITY:
        samples, share = _STEP * len(recording), reference.setpoint_share
        error, of_simc = (
            _left_after_step(plant, candidate.gains, h, share, samples) for candidate in (loop, by_simc)
        )
        if of_simc < error:
            return instead(
                "on the model of the recording they follow a step better, with a summed error of "
                f"{of_simc:.3g} samples in place of {error:.3g}"
            )
    return loop._replace(by_virtual_reference=True, remarks=by_simc.remarks)


def _with_margin(
    gains_of: Callable[[FloatArray], FloatArray],
    plant: PulseTransferFunction,
    h: float,
    first: float,
    keeps_first: bool,
    last: float,
    slower: float = _SLOWER,
    at_once: int = _AT_ONCE,
) -> _TunedLoop:
    """Return the loop with the first closed-loop time that keeps the margin, or with ``first`` itself.

    Its time is infinite where none up to ``last`` keeps it. ``gains_of`` takes so many times ``at_once``.
    """
    gains = tuple(gains_of(np.array([first]))[:, 0].tolist())
    asked = _TunedLoop(gains, sensitivity(plant, gains, h), first)
    if asked.maximum_sensitivity <= _LARGEST_SENSITIVITY:
        return asked
    count = int(log(last / first) / log(slower)) + 1
    times = np.multiply.accumulate(np.append(first, np.full(count, slower)))[1:]
    times = times[times <= last]
    for begin in range(0, len(times), at_once):
        slowed = gains_of(times[begin : begin + at_once])
        for i in np.flatnonzero(~_are_beyond(plant, slowed, h)).tolist():
            time, gains = float(times[begin + i]), tuple(slowed[:, i].tolist())
            reached = sensitivity(plant, gains, h)
            if reached <= _LARGEST_SENSITIVITY:
                kept = asked if keeps_first else _TunedLoop(gains, reached, time)
                return kept._replace(closed_loop_time=time)
    return asked._replace(closed_loop_time=inf)


def _are_beyond(plant: PulseTransferFunction, gains: FloatArray, h: float) -> NDArray[np.bool_]:
    """Return which of many gains, shape (4, n), a few frequencies show to be beyond the margin."""
    kp, ki, kd, filter_time = gains
    n, d, w = np.polyval(plant.numerator, _A_FEW), np.polyval(plant.denominator, _A_FEW), h * _INTEGRATOR
    d *= _A_FEW**plant.delay
    # Open loop and closed loop, D and D + N C with C = K_p + K_i w + K_d / (T_f + w), times T_f + w.
    factors = np.array([filter_time, np.ones_like(kp), kp * filter_time + kd, kp + ki * filter_time, ki])
    terms = np.array([d, d * w, n, n * w, n * w**2]).view(np.float64)
    open_loop, closed_loop = (
        np.abs((factors[:number].T @ terms[:number]).view(np.complex128)) for number in (2, 5)
    )
    return np.asarray((_LARGEST_SENSITIVITY * closed_loop < open_loop).any(axis=1))


def _integrates(output: int, model: SecondOrder) -> tuple[str, ...]:
    """Return the warning that an output grows by itself, if so little that it counts as integrating."""
    if not model.growth:
        return ()
    return (
        f"PID: output {output} of the recording grows by itself, by {model.growth:.4g} a sample, which "
        "cannot be told from an integrating plant: it is tuned as one",
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
    open_loop, _, closed_loop = _closed(model, gains, sampling_time)
    poles = np.roots(closed_loop)
    if np.abs(poles).max() >= 1.0:
        return float("inf")
    # Peaks are as narrow as the poles near them are close to the circle.
    near_poles = np.angle(poles) + np.outer(_NEAR, 1.0 - np.abs(poles))
    z = np.append(_CIRCLE, np.exp(1j * near_poles))
    return float(np.abs(np.polyval(open_loop, z) / np.polyval(closed_loop, z)).max())


def _closed(
    model: PulseTransferFunction, gains: Sequence[float], h: float, share: float = 1.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the denominator of the open loop, and numerator and denominator of the one from r to y."""
    kp, ki, kd, filter_time = gains
    filters = filter_time + h
    # C = K_p + h K_i z / (z - 1) + K_d (z - 1) / ((T_f + h) z - T_f); from r a share of K_p, and no D
    denominator = np.array([filters, -filter_time - filters, filter_time])
    integral = h * ki * np.array([filters, -filter_time, 0.0])
    feedback = kp * denominator + integral + kd * np.array([1.0, -2.0, 1.0])
    open_loop = np.convolve(np.append(model.denominator, np.zeros(model.delay)), denominator)
    closed_loop = open_loop.copy()
    closed_loop[-len(model.numerator) - 2 :] += np.convolve(model.numerator, feedback)
    return open_loop, np.convolve(model.numerator, share * kp * denominator + integral), closed_loop


def _left_after_step(
    model: PulseTransferFunction, gains: Sequence[float], h: float, share: float, samples: int
) -> float:
    """Return the sum of the absolute error after a unit step of the reference, in samples."""
    _, numerator, denominator = _closed(model, gains, h, share)
    late = np.append(np.zeros(len(denominator) - len(numerator)), numerator)
    return float(np.abs(1.0 - filtered(late, denominator, np.ones((samples, 1)))).sum())


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
    longest = _LARGEST_DELAY
    while count_windows(samples, longest + _LAGS + 1, recording.seams) < equations:
        longest -= 1
    y = recording.y[:, [output]]
    late = _late(recording, longest + 1)
    delay = int(np.argmin(one_step_errors(recording, late, _LAGS, [output])))
    used = without_first(replace(recording, u=late[:, delay], y=y, measured=y), delay)
    coefficients = fit_coefficients(used, _LAGS)[0][:, 0]
    a, b = coefficients[:, 0], coefficients[:, 1 + chosen]
    discrete = np.roots(np.append(1.0, -a))
    growth = max(float(np.abs(discrete).max()), 1.0)
    if growth > 1.0 + 1.0 / samples:
        # A pole this near to the circle is not told from one on it, or not by this recording.
        error = _standard_error(used, a, complex(max(discrete, key=abs)))
        if growth > 1.0 + min(_UNDECIDED * error, _UNDECIDED / samples):
            raise DataError(
                f"PID: output {output} of the recording grows by itself, by up to {growth:.4g} a sample: "
                "tune by hand"
            )
    # What is slower than the experiment counts as ten times as long, what is faster than sampling as instant.
    slowest = np.exp(-0.1 / samples)
    held = discrete * [min(1.0, slowest / max(abs(pole), _FASTEST_POLE)) for pole in discrete.tolist()]
    denominator = np.convolve([1.0, -held[0]], [1.0, -held[1]]).real
    sampled = PulseTransferFunction(b, denominator, delay)
    discrete = np.array([_within(pole, _FASTEST_POLE, slowest) for pole in discrete])
    gain = float(b.sum() / np.prod(1.0 - discrete).real)
    if gain == 0.0 or not np.isfinite(gain):
        raise DataError(f"PID: output {output} of the recording does not follow input {chosen}: tune by hand")
    first, second = np.log(discrete.astype(complex)) / h
    inverse = _inverse_response(b, h)
    growth = growth if growth > 1.0 + 1.0 / samples else 0.0
    return SecondOrder(gain, (complex(first), complex(second)), delay * h + inverse, growth), sampled


def _standard_error(recording: Recording, a: FloatArray, pole: complex) -> float:
    """Return that of the size of the largest pole of ``z^2 - a_1 z - a_2``, fitted to an output.

    The covariance of the coefficients, propagated to first order (L. Ljung, System Identification, 2nd ed.,
    sections 9.4 and 9.5).
    """
    signals = np.hstack([recording.y, recording.u, recording.d])
    starts = window_starts(len(signals), _LAGS + 1, recording.seams)
    past = np.hstack([signals[starts + _LAGS - i] for i in range(1, _LAGS + 1)])
    past = np.hstack([past, recording.d[starts + _LAGS], np.ones((len(starts), 1))])
    size = np.abs(past).max(axis=0)
    size[size == 0.0] = 1.0
    past, now = past / size, recording.y[starts + _LAGS, 0]
    rest = now - past @ np.linalg.lstsq(past, now)[0]
    variance = rest @ rest / max(len(now) - past.shape[1], 1)
    lags = [i * signals.shape[1] for i in range(_LAGS)]
    covariance = (np.linalg.pinv(past.T @ past) * variance)[np.ix_(lags, lags)] / np.outer(
        size[lags], size[lags]
    )
    if pole * 2.0 == a[0]:  # a double pole moves infinitely fast
        return inf
    slope = np.array([pole, 1.0]) / (2.0 * pole - a[0])
    along = (np.conj(pole) / abs(pole) * slope).real
    return float(np.sqrt(max(along @ covariance @ along, 0.0)))


def simc(model: SecondOrder, sampling_time: float, closed_loop_time: float | FloatArray = 0.0) -> FloatArray:
    """Return K_p, K_i, K_d and T_f by the SIMC rules, shape (4,), or (4, n) for n closed-loop times.

    Parameters
    ----------
    model : SecondOrder
        The plant.
    sampling_time : float
        Half of it adds to the delay: what holding the input costs [s].
    closed_loop_time : float or array, shape (n,)
        Time constant of the closed loop [s]; 0: the delay, but four samples at least, which gives the nine
        samples per rise time of K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, section 3.3.
    """
    delay = model.delay + sampling_time / 2.0
    rest = np.where(closed_loop_time, closed_loop_time, _rule_of_thumb(model, sampling_time)) + delay
    if model.poles[0].imag == 0.0:
        long, short = sorted((-1.0 / model.poles[0].real, -1.0 / model.poles[1].real), reverse=True)
        series = long / (model.gain * rest)
        integral_time = np.minimum(long, 4.0 * rest)
        gains = series * (1.0 + short / integral_time), series / integral_time, series * short
    else:
        squared = 1.0 / abs(model.poles[0]) ** 2  # tau^2
        damping = -2.0 * model.poles[0].real * squared  # 2 zeta tau
        gains = damping / (model.gain * rest), 1.0 / (model.gain * rest), squared / (model.gain * rest)
    kp, ki, kd = gains
    # K_d / K_p alone is longer than the period of a lightly damped pair, which the filter would destabilise.
    return np.array([kp, ki, kd, _FILTER * np.minimum(np.abs(kd / kp), np.sqrt(kd / ki))])


def _late(recording: Recording, delays: int) -> FloatArray:
    """Return inputs that come 0 ... ``delays - 1`` samples later; before, as at the beginning of each piece.

    Their shape is (T, delays, m).
    """
    rows, begins = np.arange(len(recording)), np.array([0, *recording.seams])
    begin = begins[np.searchsorted(begins, rows, side="right") - 1]
    late = np.maximum(rows[:, np.newaxis] - np.arange(delays), begin[:, np.newaxis])
    return np.asarray(recording.u[late])


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


Tuning = Literal["manual", "step-test", "virtual-reference"]
Structure = Literal["pid", "pi", "i"]
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
        "manual",
        choices=("manual", "step-test", "virtual-reference"),
        doc="gains as given; from the recording by SIMC, or by a virtual reference",
    )
    structure: Structure = setting(
        "pid", choices=("pid", "pi", "i"), doc="virtual-reference: the parts of the controller"
    )
    proportional: Weight = setting(1.0, doc="K_p", search=Factor(0.1, 10.0))
    integral: Weight = setting(0.0, doc="K_i [1/s]", search=Factor(0.1, 10.0))
    derivative: Weight = setting(0.0, doc="K_d [s]", search=Factor(0.1, 10.0))
    filter_time: float = setting(
        0.0, low=0.0, unit="s", doc="T_f of the derivative filter; 0: none, or if tuned by a rule"
    )
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
        doc="if tuned: time constant asked of the closed loop; 0: SIMC's, or four samples, or what "
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
        return self.tuning != "manual" or self.feedforward

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
        self._tuned = self._tune(loop) if self.tuning != "manual" else None
        self._gains = self._tuned.gains if self._tuned else self._given()
        h = loop.sampling_time
        self._sampling_time = h
        # A loop without integral action has nothing that winds up, and would not get its bias back.
        self._tracking = np.where(self._gains.integral != 0.0, h / max(self.tracking_time, h), 0.0)
        self._low, self._high = loop.bounds.u_min[self._pairs], loop.bounds.u_max[self._pairs]
        self._moving = bool({loop.inputs[i].name for i in self._pairs} & {*loop.moving_limits})
        self._forward = self._fed_forward(loop)
        self._begin(loop)

    def restart(self, loop: Loop) -> None:
        """Begin anew with another past: the gains stay."""
        if self._forward:
            self.start(loop)
        else:
            self._begin(loop)

    def _begin(self, loop: Loop) -> None:
        """Begin at rest, or where a running plant is, or the recording ends if the loop goes on there."""
        self._elapsed = self._sampling_time
        self._u = resting_input(loop)
        self._derivative = np.zeros(len(self._pairs))
        self._integral: FloatArray | None = None
        self._y: FloatArray | None = None
        self._taken_over = False
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
        prior = "nothing" if self.tuning != "manual" else "gains, as they are set"
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
        if self.tuning == "virtual-reference" and self._tuned:
            shown["by_virtual_reference"] = self._tuned.by_virtual_reference
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
        _, sensitivities, times, _, remarks = self._tuned
        return [*self._still, *remarks] + [
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
        recording, reference = matching_recording(loop, "PID"), None
        if self.tuning == "virtual-reference":
            reference = VirtualReference(self.structure.upper(), self.filter_time, self.setpoint_share)
        return tune_from_recording(recording, self._pairs, self.closed_loop_time, reference)
