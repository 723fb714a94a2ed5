"""PID gains from a step test, or any other experiment, by the SIMC rules.

A second-order model with delay, ``k exp(-theta s) / (tau^2 s^2 + 2 zeta tau s + 1)``, is fitted to the
recording; the gains make the closed loop a first-order lag with delay (S. Skogestad, Simple analytic rules
for model reduction and PID controller tuning, J. Process Control 13, 2003,
doi:10.1016/S0959-1524(02)00062-8). An inverse response counts as delay. A lag that is long against the delay
gets his shorter integral time; an oscillatory pair has none to shorten.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import log, sqrt
from typing import NamedTuple

import numpy as np

from ddpc_controllers.identification import fit_arx
from ddpc_cosim import DataError, FloatArray, Recording

_LAGS = 2
_LARGEST_DELAY = 20
_FASTEST_POLE = 1e-3
_FILTER = 0.1
_SAMPLES = 4


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


def least_test_samples(inputs: int) -> int:
    """Return the fewest samples that a model can be fitted to, for so many inputs."""
    return _LAGS * (2 + inputs) + _LAGS + 1


def tune_from_recording(recording: Recording, pairs: Sequence[int], closed_loop_time: float = 0.0) -> Gains:
    """Return the gains of one loop per output, the input of output i being ``pairs[i]``.

    Raises
    ------
    DataError
        The recording is too short, or shows a loop that the rules do not cover.
    """
    needed = least_test_samples(recording.u.shape[1])
    if len(recording) < needed:
        raise DataError(
            f"PID: the recording has {len(recording)} samples; a step test takes at least {needed}"
        )
    loops = [
        simc(fit_second_order(recording, output, chosen), recording.sampling_time, closed_loop_time)
        for output, chosen in enumerate(pairs)
    ]
    return Gains(*(np.array(values) for values in zip(*loops, strict=True)))


def fit_second_order(recording: Recording, output: int, chosen: int) -> SecondOrder:
    """Fit a second-order model with the delay, in whole samples, that explains an output best.

    Raises
    ------
    DataError
        The output grows without the input, or does not follow it.
    """
    h, samples = recording.sampling_time, len(recording)
    y = recording.y[:, [output]]
    longest = min(_LARGEST_DELAY, samples - least_test_samples(recording.u.shape[1]))
    fits = [fit_arx(Recording(_delayed(recording.u, d), y, y, h), _LAGS) for d in range(longest + 1)]
    delay = int(np.argmin([fit.error[0] for fit in fits]))
    u, y = recording.u[: samples - delay], y[delay:]
    fit = fit_arx(Recording(u, y, y, h), _LAGS)
    discrete = np.roots([1.0, *(-fit.past_y[:, 0, 0])])
    if np.abs(discrete).max() > 1.0 + 1.0 / samples:
        raise DataError(
            f"PID: output {output} of the recording grows by itself, by up to {np.abs(discrete).max():.4g} a "
            "sample: tune by hand"
        )
    # What is slower than the experiment counts as ten times as long, what is faster than sampling as instant.
    slowest = np.exp(-0.1 / samples)
    discrete = np.array([_within(pole, _FASTEST_POLE, slowest) for pole in discrete])
    gain = float(fit.past_u[:, 0, chosen].sum() / np.prod(1.0 - discrete).real)
    if gain == 0.0 or not np.isfinite(gain):
        raise DataError(f"PID: output {output} of the recording does not follow input {chosen}: tune by hand")
    first, second = np.log(discrete.astype(complex)) / h
    inverse = _inverse_response(fit.past_u[:, 0, chosen], h)
    return SecondOrder(gain, (complex(first), complex(second)), delay * h + inverse)


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
    rest = (closed_loop_time or max(delay, _SAMPLES * sampling_time)) + delay
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


def _delayed(u: FloatArray, samples: int) -> FloatArray:
    """Return inputs, time along axis 0, that come later; before, they were as at the beginning."""
    return np.vstack([np.repeat(u[:1], samples, axis=0), u[: len(u) - samples]])


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
