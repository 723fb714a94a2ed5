"""Virtual reference feedback tuning: a controller of a fixed structure from a recording, without a model.

Given is how the closed loop should answer its reference, a model M. The virtual reference is the one that
would have made that loop answer with the recorded outputs, ``M^-1 y``; the controller that is looked for
makes the recorded inputs of the virtual error ``e = (M^-1 - 1) y``. With a structure that is linear in its
gains, ``C = sum_i K_i C_i``, that is a least-squares problem, and its solution is, but for noise, that of the
problem to follow M, if inputs and errors are filtered by

    L = M (1 - M) W Phi_u^(-1/2)

with W = 1 the weight of the frequencies and Phi_u the spectrum of the recorded inputs, here that of an
autoregressive model. Noise makes least squares biased: the errors of the right side are correlated with it.
The gains are those of instrumental variables, the errors made of outputs without noise (M. C. Campi,
A. Lecchini, S. M. Savaresi, Virtual reference feedback tuning: a direct method for the design of feedback
controllers, Automatica 38(8), 2002, doi:10.1016/S0005-1098(02)00032-8).

All of it is computed as polynomials in the delay operator q: both sides are multiplied by what M and C are
divided by, and filtered afterwards, each piece of the recording for itself. So neither what was before the
recording nor its operating point matters, and a controller of the structure that makes M exactly is found
exactly.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy  # whose parts are imported when they are first used
from numpy.polynomial.polynomial import polyadd, polymul, polysub

from ddpc_controllers.data.hankel import window_starts
from ddpc_controllers.models.identification import choose_lags, fit_arx
from ddpc_cosim import DataError, FloatArray, Recording

_WHITENING = 4
_SIGNIFICANT = 1e-3
_LARGEST_GROWTH = 100.0
_NEGLIGIBLE = 1e-12
_DIFFERENCE = np.array([1.0, -1.0])


class ReferenceModel(NamedTuple):
    """``M = q^delay numerator(q) / denominator(q)``, from the reference of the next sample to the output.

    Parameters
    ----------
    numerator, denominator : array, shapes (n,) and (d,)
        Coefficients of rising powers of the delay operator q; M is 1 at rest.
    delay : int
        Samples, the one that sampling takes included.
    """

    numerator: FloatArray
    denominator: FloatArray
    delay: int

    @property
    def error(self) -> FloatArray:
        """The numerator of ``1 - M``, rising powers of q."""
        return np.asarray(polysub(self.denominator, np.append(np.zeros(self.delay), self.numerator)))


def wanted_loop(
    time_constant: float, delay: int, sampling_time: float, lag: float, integral_time: float
) -> ReferenceModel:
    """Return the model of the loop with ``(s + 1 / integral_time) / (s + 1 / lag) / (time_constant s)`` open.

    With equal times that is a first-order lag when it is closed. A shorter integral time, as the SIMC rules
    have it for plants whose lag is long, recovers sooner from disturbances at the input.

    Parameters
    ----------
    time_constant, lag, integral_time : float
        All in s.
    delay : int
        Samples of delay, that of sampling not counted.
    sampling_time : float
        h [s].
    """
    decay, slow, fast = np.exp(-sampling_time / np.array([time_constant, lag, integral_time]))
    model = ReferenceModel(np.array([1.0 - decay]), np.array([1.0, -decay]), delay + 1)
    if slow == fast:
        return model
    numerator = polymul(model.numerator, [1.0, -fast])
    rest = polymul(model.error, [1.0, -slow])
    denominator = polyadd(rest, np.append(np.zeros(model.delay), numerator))
    return ReferenceModel(numerator, denominator, model.delay)


def virtual_reference_gains(
    recording: Recording,
    pair: tuple[int, int],
    model: ReferenceModel,
    parts: str = "PID",
    filter_time: float = 0.0,
    instrument: FloatArray | None = None,
) -> FloatArray:
    """Return K_p, K_i and K_d of the loop that makes the recorded inputs of the virtual error.

    Parameters
    ----------
    recording : Recording
        The experiment.
    pair : (int, int)
        The output, and the input that controls it.
    model : ReferenceModel
        How the output is to follow its reference.
    parts : str
        The structure: which of P, I and D there are. Gains of others are 0.
    filter_time : float
        T_f of the derivative filter [s].
    instrument : array, shape (T,), optional
        The outputs without noise, see :func:`noise_free`; by default those of the recording, which is plain
        least squares.

    Returns
    -------
    gains : array, shape (3,)

    Raises
    ------
    DataError
        No piece of the recording is as long as the model is late.
    """
    output, chosen = pair
    h = recording.sampling_time
    filters = np.array([filter_time + h, -filter_time]) if "D" in parts else np.ones(1)
    # C_i times (1 - q) filters; the D part only where there is one.
    structure = {"P": polymul(_DIFFERENCE, filters), "I": h * filters, "D": polymul(_DIFFERENCE, _DIFFERENCE)}
    u, y = recording.u[:, chosen], recording.y[:, output]
    colours = np.asarray(polymul(whitening(u, recording.seams), np.cumsum(model.error)[:-1]), np.float64)
    divisor = polymul(polymul(model.denominator, model.denominator), filters)

    def sides(outputs: FloatArray) -> FloatArray:
        """Return u and the parts of e, filtered by L, side by side: shape (rows, 1 + parts)."""
        left = polymul(model.numerator, structure["P"])
        right = [polymul(model.error, structure[part]) for part in parts]
        longest = max(map(len, (left, *right)))
        rows = []
        for piece in np.split(np.arange(len(recording)), recording.seams):
            ahead = len(piece) - model.delay
            if ahead < longest:
                continue
            columns = [np.convolve(u[piece], left)[longest - 1 : ahead]]
            columns += [
                np.convolve(outputs[piece], side)[longest - 1 + model.delay : len(piece)] for side in right
            ]
            rows.append(filtered(colours, divisor, np.column_stack(columns)))
        if not rows:
            raise DataError(
                f"PID: no piece of the recording is longer than {longest + model.delay} samples, which a "
                "virtual reference takes: record longer"
            )
        return np.vstack(rows)

    recorded = sides(y)
    errors = recorded[:, 1:]
    instruments = errors if instrument is None else sides(instrument)[:, 1:]
    size, scale = (np.abs(columns).max(axis=0) for columns in (errors, instruments))
    size[size == 0.0] = scale[scale == 0.0] = 1.0
    system = (instruments / scale).T @ (errors / size)
    solution, *_ = np.linalg.lstsq(system, (instruments / scale).T @ recorded[:, 0], rcond=_NEGLIGIBLE)
    gains = dict(zip(parts, solution / size, strict=True))
    return np.array([gains.get(part, 0.0) for part in "PID"])


def filtered(numerator: FloatArray, denominator: FloatArray, signals: FloatArray) -> FloatArray:
    """Return signals, filtered from rest.

    Parameters
    ----------
    numerator, denominator : array, shapes (n,) and (d,)
        Coefficients of rising powers of the delay operator q.
    signals : array, shape (T, signals)
        Time along axis 0.
    """
    rows = len(signals)
    moved = np.column_stack([np.convolve(signal, numerator)[:rows] for signal in signals.T])
    # The recursion is a triangular system with few diagonals; scipy.signal would take as long to be imported.
    diagonals = np.repeat(denominator[:rows, np.newaxis], rows, axis=1)
    return np.asarray(scipy.linalg.solve_banded((len(diagonals) - 1, 0), diagonals, moved))


def whitening(u: FloatArray, seams: Sequence[int] = ()) -> FloatArray:
    """Return ``Phi_u^(-1/2)`` but for a factor: the autoregressive model of an input, rising powers of q."""
    starts = window_starts(len(u), _WHITENING + 1, seams) + _WHITENING
    centred = u - u.mean()
    past = np.column_stack([centred[starts - i] for i in range(1, _WHITENING + 1)])
    coefficients, *_ = np.linalg.lstsq(past, centred[starts], rcond=_NEGLIGIBLE)
    return np.append(1.0, -coefficients)


def noise_free(recording: Recording, pair: tuple[int, int]) -> FloatArray | None:
    """Return an output as a model of the recording has it of its input alone, shape (T,): the instrument.

    In open loop the model is driven by the recorded input. Where the input answers the output, it is
    correlated with the noise; then a model of both is driven by what of the input the feedback does not
    explain, the excitation of the experiment. Other inputs rest: what they do to the output is noise.

    Parameters
    ----------
    recording : Recording
        The experiment.
    pair : (int, int)
        The output, and the input that controls it.

    Returns
    -------
    outputs : array, shape (T,), or None
        None where such a model grows without bound, so that it is no instrument.
    """
    output, chosen = pair
    y = recording.y[:, [output]]
    plant_recording = replace(recording, y=y, measured=y)
    plant = fit_arx(plant_recording, choose_lags(plant_recording))
    b, u = plant.b[:, chosen], recording.u[:, chosen] - recording.u[:, chosen].mean()
    feedback = _feedback(recording, pair)
    outputs = np.zeros(len(recording))
    for piece in np.split(np.arange(len(recording)), recording.seams):
        x, before = np.zeros(len(b)), np.zeros((_WHITENING, 2))
        for k in piece:
            outputs[k] = x[:1].item()
            moved = u[k]
            if feedback is not None:
                by_output, coefficients, excitation = feedback
                moved = excitation[k] + by_output * outputs[k] + (coefficients * before).sum()
                before = np.vstack([[moved, outputs[k]], before[:-1]])
            x = plant.a @ x + b * moved
    size = recording.y[:, output].std()
    bounded = bool(np.isfinite(outputs).all()) and outputs.std() <= _LARGEST_GROWTH * size
    return outputs if bounded and outputs.any() else None


def _feedback(recording: Recording, pair: tuple[int, int]) -> tuple[float, FloatArray, FloatArray] | None:
    """Return how an input answers its output, or None where the recording does not show that it does.

    Returns
    -------
    by_output : float
        What the output of the same sample does.
    coefficients : array, shape (lags, 2)
        What the input and the output of earlier samples do, the newest first.
    excitation : array, shape (T,)
        What neither of them explains; 0 in the first samples of a piece.
    """
    output, chosen = pair
    u, y = (w - w.mean() for w in (recording.u[:, chosen], recording.y[:, output]))
    starts = window_starts(len(u), _WHITENING + 1, recording.seams) + _WHITENING
    past_inputs = [u[starts - i] for i in range(1, _WHITENING + 1)]
    seen = [y[starts - i] for i in range(_WHITENING + 1)]
    left = []
    for columns in (past_inputs, past_inputs + seen):
        scaled = np.column_stack(columns)
        solution, *_ = np.linalg.lstsq(scaled, u[starts], rcond=_NEGLIGIBLE)
        left.append(u[starts] - scaled @ solution)
    alone, both = (float(np.square(rest).sum()) for rest in left)
    freedom = len(starts) - len(past_inputs) - len(seen)
    if freedom <= 0 or alone <= _NEGLIGIBLE * float(np.square(u).sum()):
        return None
    ratio = (alone - both) / len(seen) / max(both / freedom, np.finfo(float).tiny)
    if scipy.special.fdtrc(len(seen), freedom, ratio) > _SIGNIFICANT:
        return None
    excitation = np.zeros(len(u))
    excitation[starts] = left[1]
    by_inputs, now, by_seen = np.split(solution, [_WHITENING, _WHITENING + 1])
    return float(now[0]), np.column_stack([by_inputs, by_seen]), excitation
