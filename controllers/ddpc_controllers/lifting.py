"""A state with its past, as dictionaries that look back want it."""

from ddpc_cosim import FloatArray, Recording


class StateWindow:
    """The newest samples of a state.

    Parameters
    ----------
    samples : array, shape (memory + 1, q)
        Where to begin, time along axis 0.

    Attributes
    ----------
    size : int
        Number q of signals of one sample.
    """

    def __init__(self, samples: FloatArray) -> None:
        self._newest_first = samples[::-1].copy()
        self.size = samples.shape[1]

    def fill(self, sample: FloatArray) -> FloatArray:
        """Pretend that the state has always been this, shape (q,); return it with its past."""
        self._newest_first[:] = sample
        return self._newest_first.ravel()

    def append(self, sample: FloatArray) -> FloatArray:
        """Take the next sample, shape (q,); return it with its past, shape ((memory + 1) q,)."""
        self._newest_first[1:] = self._newest_first[:-1]
        self._newest_first[0] = sample
        return self._newest_first.ravel()


def without_first(recording: Recording, samples: int) -> Recording:
    """Return a recording without its first samples."""
    if samples == 0:
        return recording
    kept = slice(samples, None)
    return Recording(recording.u[kept], recording.y[kept], recording.measured[kept], recording.sampling_time)
