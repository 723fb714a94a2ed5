"""What stands in for a measurement that is lost: not a number, or infinite."""

from math import isfinite

import numpy as np

from ddpc_cosim import FloatArray


def all_finite(values: FloatArray) -> bool:
    """Return whether all of a few values are finite."""
    return isfinite(sum(values.tolist()))


def stand_in(values: FloatArray, expected: FloatArray) -> FloatArray:
    """Return values, shape (n,), with those expected in the place of those that are lost."""
    return np.asarray(np.where(np.isfinite(values), values, expected))


class LastMeasurement:
    """The last finite value of every measured signal, and which of the signals are outputs.

    Parameters
    ----------
    measured : array, shape (T, q)
        What was recorded, time along axis 0.
    y : array, shape (T, p)
        The outputs recorded at the same time.
    """

    def __init__(self, measured: FloatArray, y: FloatArray) -> None:
        self._newest: FloatArray = measured[-1].copy()
        same = (measured[:, :, np.newaxis] == y[:, np.newaxis, :]).all(axis=0)
        self._signals, self._outputs = np.nonzero(same)

    def take(self, measured: FloatArray) -> FloatArray:
        """Take the signals, shape (q,), all of them finite."""
        self._newest[...] = measured
        return measured

    def complete(self, measured: FloatArray, y: FloatArray | None = None) -> FloatArray:
        """Return the signals, shape (q,), those lost as the outputs y, shape (p,), or as they were."""
        if y is not None:
            self._newest[self._signals] = y[self._outputs]
        self._newest[...] = stand_in(measured, self._newest)
        return self._newest
