"""An autoregressive model with inputs, by least squares.

    y_k = sum_i A_i y_k-i + B_i u_k-i + E_i d_k-i + c + eps_k,    i = 1 ... lags

(L. Ljung, System Identification, 2nd ed., sections 4.2 and 7.3), realised in observer form.
"""

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.controller import Recording
from ddpc_cosim.errors import DataError
from ddpc_cosim.identification.innovation import InnovationModel
from ddpc_cosim.variables import FloatArray

MOST_LAGS = 20
"""The most past samples that are tried."""
_NEGLIGIBLE = 1e-10
_EXACT = 1e-8


def fit_arx(recording: Recording, lags: int) -> InnovationModel:
    """Fit an autoregressive model to a recording.

    Parameters
    ----------
    recording : Recording
        The data.
    lags : int
        Number of past samples, 1 or more.

    Returns
    -------
    model : InnovationModel
        In observer form, about the inputs as they are on average, or near those where it cannot rest there.

    Raises
    ------
    DataError
        There are fewer equations than coefficients.
    """
    m, p = recording.u.shape[1], recording.y.shape[1]
    signals, means, sizes = _standardised(recording)
    width = signals.shape[1]
    rows = explained_rows(recording, lags)
    past = np.hstack([signals[rows - i] for i in range(1, lags + 1)])
    known = np.hstack([past, np.ones((len(rows), 1))])
    if len(rows) < known.shape[1]:
        raise DataError(
            f"{len(rows)} samples have {lags} before them, and an ARX model with {lags} lags of "
            f"{width} signals has {known.shape[1]} coefficients for each output: log longer, or lower lags"
        )
    # Least norm: data of a plant with fewer lags leave coefficients free.
    solution, *_ = np.linalg.lstsq(known, signals[rows, :p], rcond=_NEGLIGIBLE)
    errors = (signals[rows, :p] - known @ solution) * sizes[:p]
    covariance = errors.T @ errors / max(len(rows) - known.shape[1], 1)
    by_lag = solution[:-1].reshape(lags, width, p).transpose(0, 2, 1)  # lag, output, signal
    past_y, past_u, past_d = np.split(by_lag, [p, p + m], axis=2)
    # In parts of the signals' sizes about their means, where it rests nearest to the means.
    gain = np.hstack([np.eye(p) - past_y.sum(axis=0), -past_u.sum(axis=0), -past_d.sum(axis=0)])
    rest, *_ = np.linalg.lstsq(gain, solution[-1], rcond=_EXACT)
    y_0, u_0, d_0 = np.split(means + rest * sizes, [p, p + m])
    past_y, past_u, past_d = np.split(by_lag * sizes[:p, np.newaxis] / sizes, [p, p + m], axis=2)
    a = np.zeros((lags * p, lags * p))
    a[:, :p] = past_y.reshape(lags * p, p)
    a[:-p, p:] = np.eye((lags - 1) * p)
    return InnovationModel(
        a,
        b=past_u.reshape(lags * p, m),
        e=past_d.reshape(lags * p, -1) if past_d.size else np.zeros((lags * p, 0)),
        k=a[:, :p].copy(),
        c=np.eye(p, lags * p),
        u_0=u_0,
        y_0=y_0,
        d_0=d_0,
        covariance=covariance,
        sampling_time=recording.sampling_time,
        method="arx",
    )


def choose_lags(recording: Recording, most: int = MOST_LAGS) -> int:
    """Return the number of past samples that explains a recording best for its size.

    Schwarz's criterion, each output with noise of its own (G. Schwarz, Estimating the dimension of a model,
    Annals of Statistics 6(2), 1978, doi:10.1214/aos/1176344136). All numbers are tried, not only until the
    next one is worse: of a dead time nothing shows before the last of its samples. What is explained to eight
    digits counts as explained.
    """
    signals, _, _ = _standardised(recording)
    p, width = recording.y.shape[1], signals.shape[1]
    longest = max(len(piece) for piece in recording.pieces)
    most = max((n for n in range(1, most + 1) if n < longest and _is_enough(recording, n, width)), default=1)
    rows = explained_rows(recording, most)
    # The newest first: a triangular factor shows what is left of the outputs after every number of lags.
    known = [np.ones((len(rows), 1)), *(signals[rows - i] for i in range(1, most + 1)), signals[rows, :p]]
    left = np.square(np.asarray(np.linalg.qr(np.hstack(known), mode="r"))[:, -p:])
    lags = np.arange(1, most + 1)
    variance = np.array([left[1 + n * width :].sum(axis=0) / len(rows) for n in lags.tolist()])
    criterion = len(rows) * np.log(variance + _EXACT**2).sum(axis=1) + np.log(len(rows)) * lags * width * p
    return int(lags[np.argmin(criterion)])


def explained_rows(recording: Recording, lags: int) -> NDArray[np.intp]:
    """Return the rows that have so many before them in their piece.

    Raises
    ------
    DataError
        There are none.
    """
    first = np.array((0, *recording.seams))
    begin = first[np.searchsorted(first, np.arange(len(recording)), side="right") - 1]
    rows = np.flatnonzero(np.arange(len(recording)) - begin >= lags)
    if not rows.size:
        longest = max(len(piece) for piece in recording.pieces)
        raise DataError(f"{lags} lags need pieces of {lags + 1} samples; the longest has {longest}")
    return rows


def _is_enough(recording: Recording, lags: int, width: int) -> bool:
    """Whether there are two equations for every coefficient."""
    return len(explained_rows(recording, lags)) >= 2 * (1 + lags * width)


def _standardised(recording: Recording) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return y, u and d side by side, off their means and in parts of their size; means; sizes."""
    signals = np.hstack([recording.y, recording.u, recording.d])
    means = signals.mean(axis=0)
    sizes = signals.std(axis=0)
    still = sizes <= _EXACT * np.abs(signals).max(axis=0)
    return (signals - means) / np.where(still, 1.0, sizes), means, np.where(still, 1.0, sizes)
