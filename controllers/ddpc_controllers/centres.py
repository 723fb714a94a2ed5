"""Where radial functions have their centres: in a box, at recorded states, or at their clusters."""

import warnings
from typing import Literal

import numpy as np

from ddpc_cosim import DataError, FloatArray

Centres = Literal["box", "data", "k-means"]
CENTRES = ("box", "data", "k-means")

_ROUNDS = 50


def place_centres(
    rule: Centres,
    count: int,
    states: FloatArray,
    box: tuple[float, float],
    rng: np.random.Generator,
) -> FloatArray:
    """Return centres of radial functions.

    Parameters
    ----------
    rule : {"box", "data", "k-means"}
        Uniformly drawn from a box, drawn from the recorded states without repetition, or the means of their
        clusters (Lloyd's algorithm from k-means++ seeds).
    count : int
        Number of centres n_p.
    states : array, shape (T, q)
        The recorded states.
    box : (float, float)
        Ends of every coordinate, for "box".
    rng : numpy.random.Generator
        What decides draws and seeds.

    Returns
    -------
    centres : array, shape (count, q)

    Raises
    ------
    DataError
        Fewer different states were recorded than there are centres to place.
    """
    if rule == "box":
        return rng.uniform(*box, (count, states.shape[1]))
    different = np.unique(states, axis=0)
    if len(different) < count:
        raise DataError(
            f'centres = "{rule}": {count} centres need as many different states; the recording has '
            f"{len(different)}: lower count, or record longer"
        )
    if rule == "data":
        return np.asarray(rng.choice(different, count, replace=False))
    from scipy.cluster.vq import kmeans2  # most dictionaries do without its import

    with warnings.catch_warnings():
        # A cluster that loses all its states keeps its last centre: as good a centre as any.
        warnings.simplefilter("ignore", UserWarning)
        centres, _ = kmeans2(different, count, iter=_ROUNDS, minit="++", seed=int(rng.integers(2**31)))
    return np.asarray(centres, dtype=np.float64)
