"""The recording that a controller predicts with, and the windows of signals it keeps."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ddpc_controllers.data.hankel import hankel_matrix
from ddpc_cosim import DataError, FloatArray, Loop, Recording

ONE = "one"
"""The signal that is 1 at all times: its row sums the entries of g."""

_ONE_SAMPLE = np.ones(1)


class WindowLayout:
    """How windows of several signals are stacked to columns of M.

    Parameters
    ----------
    blocks : sequence of (str, int, int)
        From the top: a signal's name, the first of its samples, counted from the window's first, and how
        many of them.
    """

    def __init__(self, *blocks: tuple[str, int, int]) -> None:
        self.blocks = blocks
        self.depth = max(start + length for _, start, length in blocks)

    def stack(self, signals: Mapping[str, FloatArray]) -> FloatArray:
        """Return M of recorded signals, shape (T, width) each, time along axis 0."""
        samples = len(next(iter(signals.values())))
        columns = samples - self.depth + 1
        signals = {ONE: np.ones((samples, 1)), **signals}
        return np.vstack(
            [
                hankel_matrix(signals[name][start : start + length + columns - 1], length)
                for name, start, length in self.blocks
            ]
        )

    def rows_of(self, signal: str, widths: Mapping[str, int]) -> NDArray[np.intp]:
        """Return which rows of M hold a signal, given the width of each."""
        heights = [length * {ONE: 1, **widths}[name] for name, _, length in self.blocks]
        names = np.repeat([name for name, _, _ in self.blocks], heights)
        return np.flatnonzero(names == signal)


class WindowBuffer:
    """The newest window of every signal.

    Parameters
    ----------
    layout : WindowLayout
        What it holds.
    signals : mapping of str to array, shape (T, width)
        What came before, time along axis 0.
    filled : bool
        Whether that counts; if not, a column has to be filled with newer samples first.
    """

    def __init__(self, layout: WindowLayout, signals: Mapping[str, FloatArray], filled: bool) -> None:
        self._buffers = {name: values[-layout.depth :].copy() for name, values in signals.items()}
        self._missing = 0 if filled else layout.depth
        self._layout = layout

    def append(self, samples: Mapping[str, FloatArray]) -> None:
        """Append the next sample of every signal, shape (width,) each."""
        for name, sample in samples.items():
            buffer = self._buffers[name]
            buffer[:-1] = buffer[1:]
            buffer[-1] = sample
        if self._missing:
            self._missing -= 1

    def column(self) -> FloatArray | None:
        """Return the newest column of M, None while samples are missing."""
        if self._missing:
            return None
        buffers = self._buffers
        parts = [
            _ONE_SAMPLE if name == ONE else buffers[name][start : start + length].ravel()
            for name, start, length in self._layout.blocks
        ]
        return np.concatenate(parts)


def matching_recording(loop: Loop, who: str) -> Recording:
    """Return the loop's recording.

    Raises
    ------
    DataError
        There is none, or it was made with other signals or at another sampling time.
    """
    recording = loop.recording
    if recording is None:
        raise DataError(
            f"{who} predicts with an open-loop recording: give the loop an excitation or a recording"
        )
    found = (recording.u.shape[1], recording.y.shape[1], recording.measured.shape[1])
    wanted = (len(loop.inputs), len(loop.outputs), len(loop.measurements))
    if found != wanted:
        raise DataError(
            f"{who}: the recording has (inputs, outputs, measurements) = {found}, the loop has {wanted}"
        )
    if not np.isclose(recording.sampling_time, loop.sampling_time, rtol=1e-9):
        raise DataError(
            f"{who}: the recording was sampled every {recording.sampling_time:g} s, the loop runs every "
            f"{loop.sampling_time:g} s: record at the loop's sampling time"
        )
    return recording


def resting_input(loop: Loop) -> FloatArray:
    """Return the inputs before the first sample of a loop that starts from rest, shape (m,)."""
    start = np.array([variable.start for variable in loop.inputs])
    return np.asarray(np.clip(start, loop.bounds.u_min, loop.bounds.u_max))


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
