"""Autoregressive predictors with inputs, by least squares, and what they say about order and dead times.

    y_k = sum_i A_i y_k-i + B_i u_k-i + E_i d_k-i + c + eps_k,   i = 1 ... lags

is linear in its coefficients, so that least squares finds the best without a search, and consistent for
data of a closed loop, since what is left is white (L. Ljung, System Identification, 2nd ed., sections 7.3
and 13.4). With enough lags it comes as close to any linear plant as one likes, at the price of more
coefficients.
"""

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.errors import DataError
from ddpc_cosim.identification.predictor import Predictor, Refit, Samples
from ddpc_cosim.variables import FloatArray

MOST_LAGS = 20
_MOST_DELAY = 40
_NEGLIGIBLE = 1e-10
_EXACT = 1e-8  # what is explained to so many parts of a signal's size counts as explained
_ROWS_PER_COEFFICIENT = 3
_ROWS_FOR_DELAYS = 20_000


def fit_arx(samples: Samples, lags: int) -> Predictor:
    """Fit an autoregressive predictor to samples by least squares; see the module.

    Parameters
    ----------
    samples : Samples
        The recording.
    lags : int
        Number of past samples.

    Returns
    -------
    predictor : Predictor
        In observer form: n = lags p states.

    Raises
    ------
    DataError
        There are fewer rows than coefficients.
    """
    past, now = lagged(samples, lags)
    if len(past) < past.shape[1]:
        raise DataError(
            f"{len(past)} samples have {lags} before them in their piece, and an ARX model with {lags} lags "
            f"of {samples.z.shape[1] - 1} signals has {past.shape[1]} coefficients for each output: log "
            "longer, or lower lags"
        )
    # Least norm: data of a plant with fewer lags leave coefficients free.
    coefficients = np.asarray(np.linalg.lstsq(past, now, rcond=_NEGLIGIBLE)[0], dtype=np.float64)
    return _in_observer_form(coefficients, lags)


def linearised_arx(predictor: Predictor, samples: Samples) -> Refit:
    """Return what an autoregressive predictor becomes where other errors had come to the same past."""
    p = len(predictor.c)
    lags = len(predictor.a) // p
    past, _ = lagged(samples, lags)
    by_lag = predictor.g[:, :-1].reshape(lags, p, -1).transpose(0, 2, 1).reshape(-1, p)
    coefficients = np.vstack([by_lag, predictor.y_0])
    rows = explained_rows(samples, lags)
    values, vectors = np.linalg.eigh(past.T @ past)
    seen = values > _NEGLIGIBLE * values[-1]
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T

    def refit(errors: FloatArray) -> Predictor:
        return _in_observer_form(coefficients + inverse @ (past.T @ errors[rows]), lags)

    return refit


def _in_observer_form(coefficients: FloatArray, lags: int) -> Predictor:
    """Return the predictor with coefficients in the order of :func:`lagged`, shape (coefficients, p)."""
    p = coefficients.shape[1]
    by_lag = coefficients[:-1].reshape(lags, -1, p).transpose(0, 2, 1).reshape(lags * p, -1)
    g = np.hstack([by_lag, np.zeros((lags * p, 1))])
    return Predictor(np.eye(lags * p, k=p), g, np.eye(p, lags * p), coefficients[-1])


def lagged(samples: Samples, lags: int) -> tuple[FloatArray, FloatArray]:
    """Return what precedes the rows that have ``lags`` samples before them, and their outputs.

    Returns
    -------
    past : array, shape (rows, lags (m + n_d + p) + 1)
        The samples before, the newest first, and 1.
    now : array, shape (rows, p)
        The row's outputs.
    """
    rows = explained_rows(samples, lags)
    signals = samples.z[:, :-1]
    past = [signals[rows - i] for i in range(1, lags + 1)]
    return np.hstack([*past, np.ones((len(rows), 1))]), samples.y[rows]


def most_lags(samples: Samples, most: int = MOST_LAGS) -> int:
    """Return how many lags leave enough rows for every coefficient; 1 at least, ``most`` at most."""
    lengths = np.array([rows.stop - rows.start for rows in samples.stretches])
    lags = np.arange(1, most + 1)
    rows = np.maximum(lengths - lags[:, np.newaxis], 0).sum(axis=1)
    enough = rows >= _ROWS_PER_COEFFICIENT * (lags * (samples.z.shape[1] - 1) + 1)
    return int(lags[enough].max(initial=1))


def choose_lags(samples: Samples) -> int:
    """Return the number of lags that explains the outputs best for its coefficients.

    Schwarz's criterion of the generalised variance (G. Schwarz, Annals of Statistics 6(2), 1978,
    doi:10.1214/aos/1176344136). All numbers are tried, not only until the next is worse.
    """
    most = most_lags(samples)
    past, now = lagged(samples, most)
    width = samples.z.shape[1] - 1
    factor = triangular(_by_lags(past, now))[:, -now.shape[1] :]
    lags = np.arange(1, most + 1)
    criterion = [schwarz(factor[1 + n * width :], len(past), n * width * now.shape[1]) for n in lags.tolist()]
    return int(lags[np.argmin(criterion)])


def choose_delays(samples: Samples) -> tuple[int, ...]:
    """Return the dead time of every input: rows beyond the first after which no output shows it.

    From autoregressive predictors without the newest samples of an input: Schwarz's criterion says how many
    of them are not missed, of predictors with the number of lags that it likes best. With all lags in each of
    them, leaving out those that say nothing would pay for leaving out those that say something. An input that
    shows nowhere has no dead time.
    """
    samples = samples.rows(slice(0, _ROWS_FOR_DELAYS))
    most = most_lags(samples, _MOST_DELAY)
    past, now = lagged(samples, most)
    width, (m, _, p) = samples.z.shape[1] - 1, samples.counts
    factor = triangular(_by_lags(past, now))
    delays = np.zeros(m, dtype=int)
    for i in range(m):
        without = np.ones(factor.shape[1], dtype=bool)
        criterion = np.full((most + 1, most), np.inf)
        for delay in range(most + 1):
            left = triangular(factor[:, without])[:, -p:]
            kept = np.cumsum(without[1:-p].reshape(most, width).sum(axis=1)).tolist()
            for lags in range(1 if delay == most else delay + 1, most + 1):
                count = kept[lags - 1]
                criterion[delay, lags - 1] = schwarz(left[1 + count :], len(past), count * p)
            if delay < most:
                without[1 + delay * width + i] = False
        best = int(np.argmin(criterion.min(axis=1)))
        delays[i] = best if best < most else 0
    return tuple(delays.tolist())


def _by_lags(past: FloatArray, now: FloatArray) -> FloatArray:
    """Return the constant, the samples before and the outputs, side by side.

    In its triangular factor the rows below those of so many lags are what these leave of the outputs.
    """
    return np.hstack([past[:, -1:], past[:, :-1], now])


def triangular(matrix: FloatArray) -> FloatArray:
    """Return the triangular factor of a matrix's QR decomposition."""
    return np.asarray(np.linalg.qr(matrix, mode="r"))


def schwarz(left: FloatArray, rows: int, coefficients: int) -> float:
    """Return Schwarz's criterion of what is left of the outputs, shape (any, p): the smaller the better."""
    covariance = left.T @ left / rows + _EXACT**2 * np.eye(left.shape[1])
    return float(rows * np.linalg.slogdet(covariance)[1] + np.log(rows) * coefficients)


def explained_rows(samples: Samples, lags: int) -> NDArray[np.intp]:
    """Return the rows that have so many before them in their stretch.

    Raises
    ------
    DataError
        There are none.
    """
    rows = np.concatenate([np.arange(rows.start + lags, rows.stop) for rows in samples.stretches])
    if not rows.size:
        longest = max(rows.stop - rows.start for rows in samples.stretches)
        raise DataError(f"{lags} lags need pieces of {lags + 1} samples; the longest has {longest}")
    return rows
