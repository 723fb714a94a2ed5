"""What a recording is worth to a predictor: its error on samples held out, the dead time it has to span."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy  # whose parts are imported when they are first used
from numpy.typing import NDArray

from ddpc_controllers.data.hankel import count_windows, window_starts
from ddpc_cosim import FloatArray, Recording, Variable, judge_prediction

if TYPE_CHECKING:
    from ddpc_controllers.models.linear import SampledModel

_HELD_OUT = 0.25
# For each unknown: with fewer, what the head fits says nothing of what the whole recording does.
_EQUATIONS = 1.5
_MOST_LAGS = 40
_SIGNIFICANT = 1e-4
# Of a standardised signal: what explains less is rounding.
_EXPLAINED = 1e-6
_RANK = 1e-9
_NO_DOUBT = 1e-4  # that the rank is full
# Of a signal's mean, or of its unit: what moves by less is constant but for rounding.
_NEGLIGIBLE = 1e-10
_TINY = np.finfo(float).tiny


class Judgement(NamedTuple):
    """What a method reports about its recording.

    Parameters
    ----------
    warnings : tuple of str
        What speaks against it.
    diagnostics : mapping of str to float
        How well it lets the method predict; empty where that was not tested.
    errors : array, shape (n, p), optional
        See :class:`PredictionTest`; None where that was not tested.
    residuals : array, shape (windows, n, p), optional
        Likewise.
    """

    warnings: tuple[str, ...] = ()
    diagnostics: Mapping[str, float] = {}
    errors: FloatArray | None = None
    residuals: FloatArray | None = None


class Span(NamedTuple):
    """How long a dead time a method covers.

    Parameters
    ----------
    samples : int
        The longest dead time whose inputs show in the prediction, or are remembered until they show.
    what : str
        What covers it, commonly a setting.
    remedy : str, optional
        How it covers more; default: by a longer setting.
    """

    samples: int
    what: str
    remedy: str | None = None


class PredictionTest(NamedTuple):
    """A predictor's errors, in parts of the standard deviations of the outputs.

    Parameters
    ----------
    error : float
        At the end of the horizon, of the output that is predicted worst: root mean square over the
        recording's tail, which the predictor was not fitted to.
    fitted : float
        The same over the rest, which it was fitted to.
    errors : array, shape (n, p)
        Over the tail, of every output, row i of predictions i + 1 samples after the last known output.
    residuals : array, shape (windows, n, p)
        Outputs less their predictions themselves, over the tail, in the units of the outputs.
    """

    error: float
    fitted: float
    errors: FloatArray
    residuals: FloatArray


def judge(
    who: str,
    recording: Recording,
    outputs: Sequence[Variable],
    spans: Sequence[Span],
    tested: tuple[PredictionTest | None, int] = (None, 0),
) -> Judgement:
    """Return what speaks for and against a recording: dead times, a poor prediction.

    Parameters
    ----------
    who : str
        The method.
    recording : Recording
        The experiment.
    outputs : sequence of Variable
        The controlled outputs.
    spans : sequence of Span
        What has to cover a dead time.
    tested : (PredictionTest or None, int)
        How well the method predicts, and how many samples ahead.
    """
    late = tuple(_dead_time_warnings(recording, [output.name for output in outputs], spans))
    test, horizon = tested
    if test is None:
        return Judgement(late)
    figures = {"prediction_error": test.error, "prediction_error_fitted": test.fitted}
    verdict = judge_prediction(test.error, test.fitted)
    if not verdict.startswith("poor"):
        return Judgement(late, figures, test.errors, test.residuals)
    poor = (
        f"{who}: {horizon} samples ahead it is off by {100 * test.error:.0f} % of the output's standard "
        f"deviation on the recording's last quarter, held out; {verdict}"
    )
    return Judgement((*late, poor), figures, test.errors, test.residuals)


def fit_by_windows(
    data: FloatArray, future: int, outputs: int, depth: int, ridge: FloatArray | None = None
) -> PredictionTest | None:
    """Test the least-squares prediction of recorded windows: fitted to the first, tested on the last quarter.

    Parameters
    ----------
    data : array, shape (rows, windows)
        Stacked windows in the order of time, the predicted outputs in the last rows.
    future : int
        Number of these rows.
    outputs : int
        Number of outputs: the last rows of all are those at the end of the horizon.
    depth : int
        Samples of one window: as many windows between head and tail share samples with both.
    ridge : array, shape (rows - future,), optional
        Weight of the square of the coefficient of each row that is predicted from, beside all windows.

    Returns
    -------
    test : PredictionTest or None
        None if the head has too few windows to fit a predictor at all.
    """

    def fit(head: int) -> FloatArray:
        known, ahead = data[: len(data) - future, :head].T, data[len(data) - future :, :head].T
        size = np.maximum(np.sqrt(np.mean(np.square(data[: len(data) - future]), axis=1)), _TINY)
        split = known.shape[1]
        weighed = np.zeros(split) if ridge is None else np.sqrt(ridge * head / data.shape[1])
        system = [
            np.concatenate([known / size, ahead], axis=1),
            np.concatenate([np.diag(weighed / size), np.zeros((split, future))], axis=1),
        ]
        # The triangular factor of the head has all that its least squares need, in a few rows.
        factor = np.asarray(np.linalg.qr(np.concatenate(system), mode="r"))
        triangular = factor[:split, :split]
        # A triangular matrix is its own factor: the reciprocal of its condition number.
        if scipy.linalg.lapack.dgecon(triangular, np.abs(triangular).sum(axis=0).max())[0] > _NO_DOUBT:
            solution = scipy.linalg.blas.dtrsm(1.0, triangular, factor[:split, split:])
        else:
            solution = np.linalg.lstsq(factor[:, :split], factor[:, split:], rcond=_RANK)[0]
        return np.asarray(solution.T / size)

    return fit_by_predictor(fit, data, future, outputs, depth)


def fit_by_predictor(
    fit: Callable[[int], FloatArray], data: FloatArray, future: int, outputs: int, depth: int
) -> PredictionTest | None:
    """Test a predictor of recorded windows as :func:`fit_by_windows` does.

    Parameters
    ----------
    fit : callable
        Returns coefficients, shape (future, rows - future), fitted to so many of the first windows.
    data, future, outputs, depth
        See :func:`fit_by_windows`.
    """
    rows, windows = data.shape
    known, ahead = data[: rows - future].T, data[rows - future :].T
    tail = windows - max(1, round(_HELD_OUT * windows))
    head = tail - depth + 1
    if head < _EQUATIONS * known.shape[1]:
        return None
    errors = (ahead - known @ fit(head).T).reshape(windows, -1, outputs)
    return _in_parts(errors[:head], errors[tail:], ahead[:, -outputs:])


def fit_by_model(
    model: "SampledModel",
    states: FloatArray,
    recording: Recording,
    steps: int,
    head: int,
    first_step: int = 1,
) -> PredictionTest | None:
    """Test a model that was fitted to the first samples of a recording.

    Parameters
    ----------
    model : SampledModel
        The model.
    states : array, shape (T, n)
        Its state at every sample: what is known before the input of the sample is decided.
    recording : Recording
        Inputs, outputs and disturbances at the same samples, off the operating point.
    steps : int
        Samples that are predicted.
    head : int
        Samples that the model was fitted to.
    first_step : int
        The first that counts: 1 where states hold the outputs measured at their samples, 0 where they do not.

    Returns
    -------
    test : PredictionTest or None
        None if no prediction fits into head or tail.
    """
    if count_windows(len(states), steps + 1, recording.seams) == 0:
        return None
    first = window_starts(len(states), steps + 1, recording.seams)
    x = states[first]
    errors = np.empty((len(first), steps + 1, recording.y.shape[1]))
    for step in range(steps + 1):
        now = first + step
        errors[:, step] = recording.y[now] - x @ model.c.T - recording.d[now] @ model.f.T
        x = x @ model.a.T + recording.u[now] @ model.b.T + recording.d[now] @ model.e.T
    errors = errors[:, first_step:]
    fitted, held_out = errors[first + steps < head], errors[first >= head]
    return _in_parts(fitted, held_out, recording.y) if len(fitted) and len(held_out) else None


def head_of(recording: Recording) -> Recording:
    """Return the first samples of a recording, to which a model is fitted that is tested on the rest."""
    head = len(recording) - max(1, round(_HELD_OUT * len(recording)))
    return replace(
        recording,
        u=recording.u[:head],
        y=recording.y[:head],
        measured=recording.measured[:head],
        d=recording.d[:head],
        excitation=recording.excitation[:head],
        seams=tuple(seam for seam in recording.seams if seam < head),
    )


def dead_times(recording: Recording, most: int) -> list[int]:
    """Return after how many samples the inputs begin to show in each output.

    An autoregressive model is fitted with as many past samples of all signals; the dead time ends with the
    first sample of the inputs that explains more of the output than chance would (F-test).

    Parameters
    ----------
    recording : Recording
        The experiment.
    most : int
        Look no further than so many samples, fewer where the recording is short.

    Returns
    -------
    samples : list of int
        For each output: at least 1; one more than was looked at if nothing shows.
    """
    from scipy.special import fdtrc  # takes long to import, and only recordings need it

    m, p, samples = recording.u.shape[1], recording.y.shape[1], len(recording)
    lags, seams = min(most, _MOST_LAGS, (samples // 3 - 1) // (m + p + 1)), recording.seams
    while lags > 0 and count_windows(samples, lags + 1, seams) < 2 * (1 + lags * (m + p)):
        lags -= 1
    if lags < 1:
        return [1] * p
    y, u = standardised(recording.y)[0], standardised(recording.u)[0]
    now = window_starts(samples, lags + 1, seams) + lags
    rows, before = len(now), np.arange(1, lags + 1)
    past_y = y[now[:, np.newaxis] - before].reshape(rows, -1)
    past_u = u[now[:, np.newaxis] - before[::-1]].reshape(rows, -1)
    # The newest inputs last: the rows of the factor show what they explain beyond all else.
    system = np.concatenate([np.ones((rows, 1)), past_y, past_u, y[now]], axis=1)
    factor = np.square(np.asarray(np.linalg.qr(system, mode="r"))[:, -p:])
    free = rows - (system.shape[1] - p)
    left = factor[-p:].sum(axis=0) / free
    newest = factor[-p - lags * m : -p][::-1].reshape(lags, m, p).sum(axis=1).cumsum(axis=0)
    number = m * np.arange(1, lags + 1)[:, np.newaxis]
    chance = fdtrc(number, free, newest / number / np.maximum(left, _TINY))
    shows = (chance < _SIGNIFICANT) & (newest > rows * _EXPLAINED**2)
    first: list[int] = np.where(shows.any(axis=0), shows.argmax(axis=0) + 1, lags + 1).tolist()
    return first


def standardised(signals: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return signals, time along axis 0, off their means and in parts of their deviations; means; deviations.

    The deviation is the standard deviation, and 1 of a signal that is constant but for rounding.
    """
    means, deviations, still = _moments(signals)
    deviations = np.where(still, 1.0, deviations)
    return (signals - means) / deviations, means, deviations


def stands_still(signals: FloatArray) -> NDArray[np.bool_]:
    """Return which signals, time along axis 0, are constant but for rounding, shape (width,)."""
    return _moments(signals)[2]


def _moments(signals: FloatArray) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return means and standard deviations, none of which is zero, and which signals stand still."""
    means = np.add.reduce(signals) / len(signals)
    deviations = np.maximum(np.sqrt(np.add.reduce(np.square(signals - means)) / len(signals)), _TINY)
    return means, deviations, deviations < _NEGLIGIBLE * np.maximum(np.abs(means), 1.0)


def _dead_time_warnings(recording: Recording, names: Sequence[str], spans: Sequence[Span]) -> list[str]:
    """Return a warning for every output whose dead time is not covered."""
    delays = dead_times(recording, max(span.samples for span in spans) + 1)
    texts = []
    for name, samples in zip(names, delays, strict=True):
        if short := [span for span in spans if span.samples < samples]:
            covered = " and ".join(f"{span.what} covers {span.samples}" for span in short)
            longer = " and ".join(span.what for span in short if span.remedy is None)
            remedies = [f"lengthen {longer}" if longer else "", *(span.remedy for span in short)]
            texts.append(
                f'in the recording "{name}" does not answer the inputs before {samples} samples have passed, '
                f"and {covered}: {', or '.join([*filter(None, remedies), 'sample more slowly'])}"
            )
    return texts


def _in_parts(head: FloatArray, tail: FloatArray, y: FloatArray) -> PredictionTest:
    """Return errors, shape (windows, n, p), in parts of the standard deviations of the outputs."""
    size = standardised(y)[2]
    errors, fitted = (np.sqrt(np.mean(np.square(part), axis=0)) / size for part in (tail, head))
    worst = int(np.argmax(errors[-1]))
    return PredictionTest(float(errors[-1, worst]), float(fitted[-1, worst]), errors, tail)
