"""Linear models from a recording: an autoregressive model by least squares, realised in state space.

    y_k = sum_i A_i y_k-i + B_i u_k-i + E_i d_k-i + E_0 d_k + c,   i = 1 ... lags

fits noise-free data of a linear plant exactly where ``lags`` reaches the plant's lag (L. Ljung, System
Identification, 2nd ed., section 7.3). Known disturbances d count as further inputs; that of the sample
itself may show too, since what is measured of it can be that of the interval before. The model can be reduced
to fewer states by a balanced realisation of its impulse response (J.-N. Juang, R. S. Pappa, J. Guidance 8(5),
1985, doi:10.2514/3.20031).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ddpc_controllers.data.hankel import (
    count_windows,
    matching_recording,
    require_informative,
    window_starts,
    without_first,
)
from ddpc_controllers.data.quality import PredictionTest, fit_by_model, head_of, standardised, stands_still
from ddpc_controllers.models.control_api import realise
from ddpc_controllers.models.linear import ModelSource, SampledModel
from ddpc_cosim import DataError, FloatArray, Loop, Recording, check_settings, setting

_AT_REST = 1e-8
_NEGLIGIBLE = 1e-10
_MOST_LAGS = 20
_EXACT = 1e-8


@dataclass(frozen=True, kw_only=True)
class Identified(ModelSource):
    """A model identified from the loop's recording."""

    lags: int = setting(
        0, low=0, doc="past samples that the outputs are explained by; 0: by the recording, up to 20"
    )
    order: int = setting(0, low=0, doc="states kept by balanced reduction; 0: all, lags x outputs")
    ridge: float = setting(0.0, low=0.0, doc="weight of the squared coefficients in the least squares")

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def uses_recording(self) -> bool:
        """Whether the loop needs a recording: it does."""
        return True

    def recording_length(self, inputs: int, outputs: int) -> int:
        """Return the samples with as many equations as coefficients, twice as many where lags are chosen."""
        if not self.lags:
            return _samples_to_choose(1, inputs + outputs)
        return self.lags + self.lags * (inputs + outputs) + 1

    def model(self, loop: Loop) -> SampledModel:
        """Identify the model; see :class:`~ddpc_controllers.models.linear.ModelSource`."""
        recording = matching_recording(loop, "Identified")
        m, p, n_d = recording.u.shape[1], recording.y.shape[1], recording.d.shape[1]
        needed = self.recording_length(m + n_d, p)
        depth = (self.lags or 1) + 1
        if count_windows(len(recording), depth, recording.seams) < needed - depth + 1:
            take = f"{self.lags} lags take" if self.lags else "choosing the lags takes"
            raise DataError(
                f"Identified: the recording has {len(recording)} samples; {take} at least {needed}: "
                "record longer, or lower lags"
            )
        lags = self.lags or choose_lags(recording)
        past, newest_u = _past(_standardised(recording)[0], lags, recording.seams), slice(p, p + m)
        require_informative(past[:, newest_u], np.delete(past, newest_u, axis=1), "Identified")
        model = reduced(fit_arx(recording, lags, self.ridge), self.order)
        return replace(model, warnings=never_moved(loop, recording))

    def test(self, loop: Loop, steps: int) -> PredictionTest | None:
        """Return how a model of the recording's first samples predicts its last ones so many steps ahead.

        None for a model that is reduced, whose state the samples before do not give, and where too few
        samples are left.
        """
        recording = matching_recording(loop, "Identified")
        m, p, n_d = recording.u.shape[1], recording.y.shape[1], recording.d.shape[1]
        first = head_of(recording)
        fewest, depth = self.recording_length(m + n_d, p), self.lags + 1
        if self.order or count_windows(len(first), depth, first.seams) < fewest - depth + 1:
            return None
        lags = self.lags or choose_lags(first)
        model = fit_arx(first, lags, self.ridge)
        used = without_first(recording, lags)
        moved = replace(used, u=used.u - model.u_0, y=used.y - model.y_0, d=used.d - model.d_0)
        known = window_starts(len(recording), lags + 1, recording.seams) + lags
        # What is known when an input is decided includes the output of that sample: the state after it.
        return fit_by_model(
            model,
            _observed(model, recording, lags),
            moved,
            max(steps - 1, 1),
            int(np.searchsorted(known, len(first))),
            first_step=0,
        )


def fit_arx(recording: Recording, lags: int, ridge: float = 0.0) -> SampledModel:
    """Fit an autoregressive model with inputs to a recording by regularised least squares.

    Parameters
    ----------
    recording : Recording
        The experiment.
    lags : int
        Number of past samples.
    ridge : float
        Weight of the squared coefficients, for signals scaled to unit size; the constant goes free.

    Returns
    -------
    model : SampledModel
        In observer form, about an operating point at which it rests: the first p columns of A hold A_1,
        A_2, ... below each other, B holds B_1, B_2, ...; ``one_step_error`` is the root mean square of
        the one-step prediction errors of the output predicted worst.
    """
    m, p, n_d = recording.u.shape[1], recording.y.shape[1], recording.d.shape[1]
    coefficients, at_once, constant, d_0, error = fit_coefficients(recording, lags, ridge)
    past_y, past_u, past_d = np.split(coefficients, [p, p + m], axis=2)
    a = np.zeros((lags * p, lags * p))
    a[:, :p] = past_y.reshape(lags * p, p)
    a[:-p, p:] = np.eye((lags - 1) * p)
    b = past_u.reshape(lags * p, m)
    e = (past_d + past_y @ at_once).reshape(lags * p, n_d)
    # The inputs and outputs nearest to zero at which the model with its constant rests.
    gain = np.hstack([-past_u.sum(axis=0), np.eye(p) - past_y.sum(axis=0)])
    rest, *_ = np.linalg.lstsq(gain, constant, rcond=_AT_REST)
    fit = {"lags": float(lags), "one_step_error": float(np.sqrt(np.square(error).mean(axis=0)).max())}
    operating_point = rest[:m], rest[m:]
    c = np.eye(p, lags * p)
    return SampledModel(a, b, c, *operating_point, len(recording), fit, e=e, f=at_once, d_0=d_0)


def fit_coefficients(recording: Recording, lags: int, ridge: float = 0.0) -> tuple[FloatArray, ...]:
    """Return what :func:`fit_arx` makes a model of: coefficients, and the errors of one step.

    Returns
    -------
    by_lag, at_once, constant : array, shapes (lags, p, p + m + n_d), (p, n_d), (p,)
        A_i, B_i and E_i side by side; E_0; c, with disturbances about their means.
    d_0 : array, shape (n_d,)
        These means.
    errors : array, shape (T, p)
        In the units of the outputs, a row per sample that has a past.
    """
    m, p, n_d = recording.u.shape[1], recording.y.shape[1], recording.d.shape[1]
    signals, means, size = _standardised(recording)
    past, now = _regression(signals, lags, recording.seams, p, n_d)
    penalty = np.sqrt(ridge) * np.eye(past.shape[1] - 1, past.shape[1])
    system = np.concatenate([past, penalty])
    target = np.concatenate([now, np.zeros((len(penalty), p))])
    # Least norm: data of a plant with fewer lags leave coefficients free.
    solution, *_ = np.linalg.lstsq(system, target, rcond=_NEGLIGIBLE)
    width, unit_y = p + m + n_d, size[:p, np.newaxis]
    by_lag = solution[: lags * width].reshape(lags, width, p).transpose(0, 2, 1) * unit_y / size
    at_once = solution[lags * width : -1].T * unit_y / size[p + m :]
    constant = means[:p] + solution[-1] * size[:p]
    constant = constant - (by_lag[..., : p + m] @ means[: p + m]).sum(axis=0)
    return by_lag, at_once, constant, means[p + m :], (past @ solution - now) * size[:p]


def one_step_errors(
    recording: Recording, inputs: FloatArray, lags: int, outputs: Sequence[int] | slice = slice(None)
) -> FloatArray:
    """Return the one-step errors of autoregressive models of a recording with other inputs, all at once.

    Parameters
    ----------
    recording : Recording
        The experiment.
    inputs : array, shape (T, n, m)
        The inputs of each model.
    lags : int
        Number of past samples.
    outputs : sequence of int, optional
        The outputs that the models have; default: all.

    Returns
    -------
    errors : array, shape (n,)
        Of each model, as ``one_step_error`` of :func:`fit_arx`.
    """
    measured, (samples, n, m) = recording.y[:, outputs], inputs.shape
    p, n_d = measured.shape[1], recording.d.shape[1]
    side_by_side = np.concatenate([measured, inputs.reshape(samples, -1), recording.d], axis=1)
    signals, _, size = standardised(side_by_side)
    now, width = window_starts(samples, lags + 1, recording.seams) + lags, p + m + n_d
    # The columns of :func:`_regression`, and the outputs, of each model.
    systems = np.ones((n, lags * width + n_d + 1 + p, len(now)))
    for lag in range(1, lags + 1):
        past, own = signals[now - lag].T, systems[:, (lag - 1) * width : lag * width]
        own[:, :p], own[:, p + m :] = past[:p], past[p + n * m :]
        own[:, p : p + m] = past[p : p + n * m].reshape(n, m, -1)
    systems[:, lags * width : -1 - p], systems[:, -p:] = signals[now, p + n * m :].T, signals[now, :p].T
    # The triangular factor shows what is left of the outputs.
    left = np.square(np.asarray(np.linalg.qr(systems.swapaxes(1, 2), mode="r"))[:, -p:, -p:])
    errors: FloatArray = (np.sqrt(left.sum(axis=1) / len(now)) * size[:p]).max(axis=1)
    return errors


def choose_lags(recording: Recording) -> int:
    """Return the number of past samples that explains a recording best for its size.

    Schwarz's criterion, each output with noise of its own (G. Schwarz, Estimating the dimension of a model,
    Annals of Statistics 6(2), 1978, doi:10.1214/aos/1176344136). All numbers are tried, not only until the
    next one is worse: of a dead time nothing shows before the last of its samples. What is explained to eight
    digits counts as explained.
    """
    samples, seams = len(recording), recording.seams
    p, n_d = recording.y.shape[1], recording.d.shape[1]
    signals, _, _ = _standardised(recording)
    width = signals.shape[1]
    enough = (
        n
        for n in range(2, _MOST_LAGS + 1)
        if _samples_to_choose(n, width) - n <= count_windows(samples, n + 1, seams)
    )
    most = max(enough, default=1)
    explained = window_starts(samples, most + 1, seams) + most
    rows = len(explained)
    # The newest first: a triangular factor shows what is left of the outputs after every number of lags.
    at_once = [np.ones((rows, 1)), signals[explained, width - n_d :]]
    known = [*at_once, _past(signals, most, seams), signals[explained, :p]]
    left = np.square(np.asarray(np.linalg.qr(np.hstack(known), mode="r"))[:, -p:])
    lags = np.arange(1, most + 1)
    variance = np.array([left[1 + n_d + n * width :].sum(axis=0) / rows for n in lags.tolist()])
    criterion = rows * np.log(variance + _EXACT**2).sum(axis=1) + np.log(rows) * lags * width * p
    return int(lags[np.argmin(criterion)])


def _samples_to_choose(lags: int, signals: int) -> int:
    """Return the samples that leave two equations for every coefficient of a model with so many lags."""
    return lags + 2 * (1 + lags * signals)


def _observed(model: SampledModel, recording: Recording, lags: int) -> FloatArray:
    """Return the states of a model in observer form given by the samples before, shape (T - lags, n)."""
    u, d = recording.u - model.u_0, recording.d - model.d_0
    y = recording.y - model.y_0 - d @ model.f.T
    p, width = y.shape[1], y.shape[1] + u.shape[1] + d.shape[1]
    by_lag = np.hstack([model.a[:, :p], model.b, model.e]).reshape(lags, p, width)
    past = _past(np.hstack([y, u, d]), lags, recording.seams).reshape(-1, lags, width)
    blocks = [np.einsum("tls,lps->tp", past[:, : lags - i], by_lag[i:]) for i in range(lags)]
    return np.hstack(blocks)


def _standardised(recording: Recording) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return y, u and d side by side, off their means and in parts of their size; means; sizes."""
    return standardised(np.concatenate([recording.y, recording.u, recording.d], axis=1))


def _regression(
    signals: FloatArray, lags: int, seams: Sequence[int], outputs: int, disturbances: int
) -> tuple[FloatArray, FloatArray]:
    """Return what explains the outputs at each sample that has a past, a constant last, and the outputs.

    ``signals``, shape (T, width), are y, u and d side by side.
    """
    now = signals[window_starts(len(signals), lags + 1, seams) + lags]
    known = now[:, now.shape[1] - disturbances :], np.ones((len(now), 1))
    return np.concatenate([_past(signals, lags, seams), *known], axis=1), now[:, :outputs]


def _past(signals: FloatArray, lags: int, seams: Sequence[int]) -> FloatArray:
    """Return the samples before each that has ``lags`` of them, the newest first, side by side."""
    now = window_starts(len(signals), lags + 1, seams) + lags
    return np.asarray(signals[now[:, np.newaxis] - np.arange(1, lags + 1)].reshape(len(now), -1))


def never_moved(loop: Loop, recording: Recording) -> tuple[str, ...]:
    """Return a warning for every known disturbance whose effect a recording does not show."""
    return tuple(
        f"{variable.name} never moved in the recording, so its effect is not in the data and counts as none: "
        f"let it move in the experiment (recording.disturbances.{variable.name})"
        for variable, still in zip(loop.disturbances, stands_still(recording.d), strict=True)
        if still
    )


def markov_parameters(model: SampledModel, count: int) -> FloatArray:
    """Return ``C A^i B`` for i = 0 ... count - 1, shape (count, p, m)."""
    response = np.empty((count, len(model.c), model.b.shape[1]))
    states = model.b
    for i in range(count):
        response[i] = model.c @ states
        states = model.a @ states
    return response


def reduced(model: SampledModel, order: int) -> SampledModel:
    """Return the balanced model of an impulse response with ``order`` states; 0: the model as it is.

    States that the inputs do not reach or the outputs do not show are the first to go.
    """
    if not 0 < order < len(model.a):
        return model
    m = model.b.shape[1]
    every = replace(model, b=np.hstack([model.b, model.e]))
    a, b, c = realise(markov_parameters(every, 2 * len(model.a) + 1), order)
    return replace(model, a=a, b=b[:, :m], c=c, e=b[:, m:])
