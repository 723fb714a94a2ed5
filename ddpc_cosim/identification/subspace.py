"""A predictor in state space from an autoregressive one, by subspace identification.

PBSIDopt (A. Chiuso, Automatica 43(6), 2007, doi:10.1016/j.automatica.2006.12.012): what an autoregressive
model with many lags says of the outputs of the next samples as far as they follow from the past is the
extended observability matrix times the state. A singular value decomposition finds the state, least squares
the matrices. The autoregressive model is consistent for data of a closed loop, and so is what follows from
it.
"""

import numpy as np

from ddpc_cosim.identification.arx import fit_arx, lagged, triangular
from ddpc_cosim.identification.predictor import Predictor, Samples
from ddpc_cosim.variables import FloatArray

_NEGLIGIBLE = 1e-10


def state_sequence(samples: Samples, lags: int) -> tuple[FloatArray, FloatArray]:
    """Return the states that the past gives, the most important first, and their importance.

    Parameters
    ----------
    samples : Samples
        The recording.
    lags : int
        Past samples, and future ones, that are related.

    Returns
    -------
    states : array, shape (rows, lags p)
        Of every row with ``lags`` samples before it in its stretch; unit size, but for those of no
        importance.
    importance : array, shape (lags p,)
        Singular values, in parts of the largest.
    """
    arx = fit_arx(samples, lags)
    past, _ = lagged(samples, lags)
    p, width = len(arx.c), samples.z.shape[1] - 1
    by_lag = arx.g[:, :-1].reshape(lags, p, width)
    explains = np.zeros((lags, p, lags, width))
    for i in range(lags):
        explains[i, :, : lags - i] = by_lag[i:].transpose(1, 0, 2)
    future = past[:, : lags * width] @ explains.reshape(lags * p, lags * width).T
    centre = future.mean(axis=0)
    _, size, directions = np.linalg.svd(triangular(future - centre))
    states = (future - centre) @ directions.T
    scale = states.std(axis=0)
    return states / np.where(scale > _NEGLIGIBLE * scale.max(), scale, 1.0), size / max(size[0], 1e-300)


def fit_subspace(samples: Samples, lags: int, order: int) -> Predictor:
    """Return a predictor with ``order`` states; see the module, and :func:`state_sequence` for ``lags``."""
    states, _ = state_sequence(samples, lags)
    return from_states(samples, states[:, :order], lags)


def from_states(samples: Samples, states: FloatArray, lags: int) -> Predictor:
    """Return the predictor that explains outputs and next states of a sequence of states by least squares."""
    firsts = [0, *np.cumsum([max(rows.stop - rows.start - lags, 0) for rows in samples.stretches]).tolist()]
    kept = np.concatenate([np.arange(rows.start + lags, rows.stop) for rows in samples.stretches])
    followed = np.ones(len(kept), dtype=bool)
    followed[np.array(firsts[1:]) - 1] = False
    here = np.flatnonzero(followed)
    z, y = samples.z[kept], samples.y[kept]
    m, n_d, _ = samples.counts
    n, one = states.shape[1], np.ones((len(kept), 1))
    outputs = np.linalg.lstsq(np.hstack([states, one]), y, rcond=_NEGLIGIBLE)[0].T
    c, y_0 = outputs[:, :n], outputs[:, n]
    errors = y - states @ c.T - y_0
    known = np.hstack([states, z[:, : m + n_d], errors, one])
    onward = np.linalg.lstsq(known[here], states[here + 1], rcond=_NEGLIGIBLE)[0].T
    a, g = onward[:, :n], onward[:, n:]
    k = g[:, m + n_d : -1]
    g[:, -1] -= k @ y_0
    return Predictor(a - k @ c, g, c, y_0).stabilised(m + n_d)
