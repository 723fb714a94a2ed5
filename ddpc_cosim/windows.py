"""Windows of signals over time: Hankel matrices, persistency of excitation, and when a prediction is good."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import scipy  # whose parts are imported when they are first used
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from ddpc_cosim.errors import DataError
from ddpc_cosim.variables import FloatArray

RANK_TOLERANCE = 1e-10
"""A singular value below this fraction of the largest counts as zero."""

_SURELY_REGULAR = 1e-10

GOOD, FAIR = 0.2, 0.5
"""Errors up to which a prediction is good, and fair, in parts of the output's standard deviation."""


def window_starts(samples: int, depth: int, seams: Sequence[int] = ()) -> NDArray[np.intp]:
    """Return the first samples of the windows of a recording, none of which crosses a seam.

    Parameters
    ----------
    samples : int
        Number of samples T.
    depth : int
        Number of samples of a window.
    seams : sequence of int
        The first sample of every piece but the first.

    Raises
    ------
    DataError
        No piece is as long as a window.
    """
    allowed = np.ones(max(samples - depth + 1, 0), dtype=bool)
    for seam in seams:
        allowed[max(seam - depth + 1, 0) : seam] = False
    starts = np.flatnonzero(allowed)
    if not starts.size:
        there = (
            f"the longest piece has {max(np.diff((0, *seams, samples)))}" if seams else f"there are {samples}"
        )
        raise DataError(f"a window of {depth} samples needs as many samples in a row; {there}: record longer")
    return starts


def count_windows(samples: int, depth: int, seams: Sequence[int] = ()) -> int:
    """Return how many windows of a depth a recording has; parameters as in :func:`window_starts`."""
    return sum(max(end - start - depth + 1, 0) for start, end in pairwise((0, *seams, samples)))


def hankel_matrix(w: FloatArray, depth: int, seams: Sequence[int] = ()) -> FloatArray:
    """Return the Hankel matrix of a recorded signal, equation (1); of a mosaic, those of its pieces abreast.

    Parameters
    ----------
    w : array, shape (T, d)
        The signal, time along axis 0.
    depth : int
        Number of block rows L.
    seams : sequence of int
        The first sample of every piece but the first.

    Returns
    -------
    matrix : array, shape (depth * d, T - depth + 1)
        Column j is the window ``w[j], ..., w[j + depth - 1]``; those that cross a seam are left out.

    Raises
    ------
    DataError
        No piece of the recording is as long as one window.
    """
    length, width = w.shape
    if not 1 <= depth <= length:
        raise DataError(
            f"a Hankel matrix of depth {depth} needs at least {max(depth, 1)} samples; there are {length}"
        )
    columns, (later, beside) = length - depth + 1, w.strides
    windows = as_strided(w, (depth, width, columns), (later, beside, later), writeable=False)
    matrix = windows.reshape(depth * width, columns)
    return matrix[:, window_starts(length, depth, seams)] if seams else matrix


def numerical_rank(matrix: FloatArray, tolerance: float = RANK_TOLERANCE) -> int:
    """Return the number of singular values above ``tolerance`` times the largest."""
    values = np.linalg.svd(matrix, compute_uv=False)
    return int(np.count_nonzero(values > tolerance * values.max(initial=0.0)))


def persistency_of_excitation(u: FloatArray, at_most: int | None = None, seams: Sequence[int] = ()) -> int:
    """Return the highest order L for which ``hankel_matrix(u, L, seams)`` has full row rank.

    Of several experiments together: H. J. van Waarde, C. De Persis, M. K. Camlibel, P. Tesi, Willems'
    fundamental lemma for state-space systems and its extension to multiple datasets, IEEE Control Systems
    Letters 4(3), 2020, doi:10.1109/LCSYS.2020.2986991.

    Parameters
    ----------
    u : array, shape (T, m)
        Inputs, time along axis 0.
    at_most : int, optional
        Look no further than this order.
    seams : sequence of int
        The first sample of every piece but the first.

    Returns
    -------
    order : int
        0 if the signal does not excite at all.
    """
    length, width = u.shape
    scale = np.abs(u).max(axis=0, initial=0.0)
    if not scale.all():
        return 0
    highest = (length + 1) // (width + 1)  # beyond it there are fewer columns than rows
    while count_windows(length, highest, seams) < highest * width:
        highest -= 1
    if at_most is not None:
        highest = min(highest, at_most)
    return _last_full_rank_depth(u / scale, highest, seams)


def judge_prediction(error: float, fitted: float) -> str:
    """Return ``"good"``, ``"fair"``, or ``"poor"`` and why, for a prediction tested on samples held out.

    Parameters
    ----------
    error : float
        Root mean square error at the end of the horizon over samples that were held out, in parts of the
        output's standard deviation.
    fitted : float
        The same over the samples that the predictor was fitted to.
    """
    if error < FAIR:
        return "good" if error < GOOD else "fair"
    if fitted < 0.5 * error:
        return (
            "poor: what it was fitted to is predicted far better, so that the recording is too short, "
            "the plant changed during it, or it is unstable"
        )
    return (
        "poor: what it was fitted to is not predicted either, for noise, for inputs or disturbances that it "
        "does not know, for a plant that is not linear over the recording, or for too short a past"
    )


def _last_full_rank_depth(u: FloatArray, highest: int, seams: Sequence[int]) -> int:
    """Bisect: a Hankel matrix with full row rank keeps it when it loses a block row."""
    full, lacking = 0, highest + 1
    depth = highest
    while lacking - full > 1:
        if _has_full_row_rank(hankel_matrix(u, depth, seams)):
            full = depth
        else:
            lacking = depth
        depth = (full + lacking) // 2
    return full


def _has_full_row_rank(matrix: FloatArray) -> bool:
    """Return whether :func:`numerical_rank` is the number of rows; singular values only tell close cases."""
    gram = matrix @ matrix.T
    size = np.abs(gram).sum(axis=0).max()
    factor, fails = scipy.linalg.lapack.dpotrf(gram.T, overwrite_a=True)
    # It has the square of the condition: where this is not small the matrix is far off the tolerance.
    if not fails and scipy.linalg.lapack.dpocon(factor, size)[0] > _SURELY_REGULAR:
        return True
    return numerical_rank(matrix) == len(matrix)
