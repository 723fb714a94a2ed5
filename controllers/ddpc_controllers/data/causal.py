"""Predictors in which no output depends on a later input; what a recording leaves uncertain of a predictor.

Noise makes the least-squares predictor of a window depend on inputs that come after the predicted output: the
part of L_32 in the factor of the data (see :mod:`~ddpc_controllers.spc`) above its block diagonal is noise
alone. M. Sader, Y. Wang, D. Huang, C. Shang, B. Huang, *Causality-informed data-driven predictive control*,
arXiv:2311.09545, leave it out. As the coordinates gamma_2 of the inputs are orthogonal one after the other,
what is left is the least-squares prediction of every output from the past and the inputs before it.

The transient predictor (K. Moffat, F. Doerfler, A. Chiuso, *The transient predictor*, IEEE CDC 2024) predicts
every output one sample ahead from all before it, past, inputs and outputs, with coefficients of its own,

    y_i = Phi_p,i (past) + sum_j Phi_u,ij u_j + sum_j<i Phi_y,ij y_j + e_i,   u_j before y_i,

as the Kalman filter does from the begin of the window on. The outputs that are not measured yet are
eliminated: ``y = (I - Phi_y)^-1 (Phi_p past + Phi_u u)``. Regressors were there before the noise e_i,
in closed loop too.

Coefficients estimated from N windows are uncertain. V. Breschi, A. Chiuso, S. Formentin, Automatica 152,
2023, doi:10.1016/j.automatica.2023.110961, and A. Chiuso, M. Fabris, V. Breschi, S. Formentin, *Harnessing
uncertainty for a separation principle in direct data-driven predictive control*, Automatica 173, 2025
(arXiv:2312.14788), take the expected cost in place of that of the prediction. With z the past and inputs that
an output is predicted from, Z their recorded windows, E the recorded errors and w = Z^+ z,

    expected |y - r|_Q^2 = |y_predicted - r|_Q^2 + sum_jk w_j w_k tr(Q cov(E_j, E_k)) + constant.

For errors independent from window to window the sum is ``tr(Q cov E) |gamma|^2 / N``: a weight of gamma that
the recording gives. Windows that overlap share noise: as errors follow from the noise of one sample after the
other, ``E = L_33 e``, the covariances are products of the entries of L_33 that meet at the same sample. The
errors of the transient predictor are taken for those of the causal one, which are as large or larger.
"""

from collections.abc import Mapping

import numpy as np
import scipy  # whose parts are imported when they are first used
from numpy.typing import NDArray

from ddpc_controllers.data.hankel import ONE, WindowLayout
from ddpc_controllers.data.instruments import predict_all_at_once
from ddpc_cosim import FloatArray

_RANK = 1e-9


def predict_causally(
    data: FloatArray, layout: WindowLayout, widths: Mapping[str, int], *, transient: bool
) -> FloatArray:
    """Return a predictor, shape (horizon * p, rows above the predicted outputs), without later inputs.

    Parameters
    ----------
    data : array, shape (rows, windows)
        Stacked windows M, the predicted outputs in the last block.
    layout : WindowLayout
        How they are stacked.
    widths : mapping of str to int
        Number of signals "u", "y" and "d".
    transient : bool
        Predict every output from the outputs before it too.
    """
    before = _rows_before(layout, widths, transient)
    future, p = len(before), widths["y"]
    rows = len(data) - future
    # The triangular factor has all that least squares need, in a few columns.
    factor = np.asarray(np.linalg.qr(data.T, mode="r")).T
    coefficients = np.zeros((future, len(data)))
    for first in range(0, future, p):
        output, given = slice(rows + first, rows + first + p), before[first]
        coefficients[first : first + p, given] = predict_all_at_once(
            np.vstack([factor[given], factor[output]]), p
        )
    of_known, of_outputs = np.split(coefficients, [rows], axis=1)
    return np.asarray(
        scipy.linalg.solve_triangular(np.eye(future) - of_outputs, of_known, lower=True, unit_diagonal=True)
    )


def uncertainty_cost(
    data: FloatArray,
    predictor: FloatArray,
    weight: FloatArray,
    layout: WindowLayout,
    widths: Mapping[str, int],
    starts: NDArray[np.intp],
    *,
    causal: bool,
) -> FloatArray:
    """Return F, ``|F z|^2`` being what the expected cost of outputs has beside that of their prediction.

    Parameters
    ----------
    data : array, shape (rows, windows)
        Stacked windows M, the predicted outputs in the last block.
    predictor : array, shape (horizon * p, rows - horizon * p)
        What was fitted to them.
    weight : array, shape (p, p)
        Q.
    layout, widths
        See :func:`predict_causally`.
    starts : array of int, shape (windows,)
        The recorded sample at which each window begins.
    causal : bool
        Whether every output was predicted from the inputs before it alone.

    Returns
    -------
    F : array, shape (rows - horizon * p, rows - horizon * p)
        Over past, known disturbances and inputs, in the order of the layout.
    """
    future, p = len(predictor), len(weight)
    rows, windows = len(data) - future, data.shape[1]
    known = data[:rows]
    errors = data[rows:] - predictor @ known
    # L_33: what the noise of each sample of the horizon adds to the errors, signs as in a Cholesky factor.
    noise = np.asarray(np.linalg.qr(errors.T / np.sqrt(max(windows - rows, 1)), mode="r")).T
    noise = noise * np.where(np.diag(noise) < 0.0, -1.0, 1.0)
    size = np.maximum(np.sqrt(np.mean(np.square(known), axis=1)), np.finfo(float).tiny)
    before, square = _rows_before(layout, widths, transient=False)[:, :rows], np.zeros((rows, rows))
    together = range(0, future, p) if causal else [future - p]
    for last in together:
        given = before[last] if causal else np.ones(rows, dtype=bool)
        # Windows where the recording has them: those that overlap share samples of noise.
        shares = np.zeros((int(starts[-1]) + 1, int(given.sum())))
        shares[starts] = np.linalg.pinv(known[given] / size[given, np.newaxis], rcond=_RANK)
        added = np.zeros((shares.shape[1], shares.shape[1]))
        for first in [last] if causal else range(0, future, p):
            parts = noise[first : first + p, : first + p].reshape(p, -1, p)
            for lag in range(parts.shape[1]):
                shared = np.einsum(
                    "alb,ac,clb->", parts[:, : parts.shape[1] - lag], weight, parts[:, lag:], optimize=True
                )
                overlap = shares[: len(shares) - lag].T @ shares[lag:]
                added += shared * (overlap if lag == 0 else overlap + overlap.T)
        square[np.ix_(given, given)] += added
    values, vectors = np.linalg.eigh(square)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, np.newaxis] * vectors.T / size)


def _rows_before(layout: WindowLayout, widths: Mapping[str, int], transient: bool) -> NDArray[np.bool_]:
    """Return which rows of M come before each predicted output, shape (horizon * p, rows).

    A disturbance counts that acts while the output is awaited, as in a window that is predicted at once; of
    outputs only those that are known, but for the transient predictor.
    """
    widths = {ONE: 1, **widths}
    names = np.repeat(
        [name for name, _, _ in layout.blocks], [n * widths[name] for name, _, n in layout.blocks]
    )
    samples = np.concatenate(
        [np.repeat(np.arange(start, start + n), widths[name]) for name, start, n in layout.blocks]
    )
    *_, (_, first, horizon) = layout.blocks
    at = samples[len(samples) - horizon * widths["y"] :, np.newaxis]
    return np.asarray(
        (names == ONE)
        | ((names == "u") & (samples < at))
        | ((names == "d") & (samples <= at))
        | ((names == "y") & (samples < (at if transient else first)))
    )
