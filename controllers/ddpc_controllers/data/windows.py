"""The recording that a controller predicts with, and the windows of signals it keeps."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddpc_controllers.data.hankel import hankel_matrix
from ddpc_cosim import Bounds, DataError, FloatArray, Loop, Recording

ONE = "one"
"""The signal that is 1 at all times: its row sums the entries of g."""

_ONE_SAMPLE = np.ones(1)


class Block(NamedTuple):
    """Consecutive samples of one signal in every window.

    Parameters
    ----------
    signal : str
        Its name.
    start : int
        First sample, counted from the window's first.
    length : int
        Number of samples.
    """

    signal: str
    start: int
    length: int


class WindowLayout:
    """How windows of several signals are stacked to columns of M.

    Parameters
    ----------
    blocks : sequence of Block
        From the top.
    """

    def __init__(self, blocks: Sequence[Block]) -> None:
        self.blocks = tuple(blocks)
        self.depth = max(block.start + block.length for block in self.blocks)

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


def padded_with_zeros(signal: FloatArray, samples: int) -> FloatArray:
    """Append samples of zero and drop as many in front, as the published programs do; time along axis 0."""
    return np.vstack([signal, np.zeros((samples, signal.shape[1]))])[samples:]


def resting_input(loop: Loop) -> FloatArray:
    """Return the inputs before the first sample of a loop that starts from rest, shape (m,)."""
    start = np.array([variable.start for variable in loop.inputs])
    return np.asarray(np.clip(start, loop.bounds.u_min, loop.bounds.u_max))


def setpoint_bounds(bounds: Bounds, margin: float) -> Bounds:
    """Draw two-sided limits together about their middle: artificial setpoints stay off the limits."""
    return Bounds(
        *_drawn_in(bounds.u_min, bounds.u_max, margin), *_drawn_in(bounds.y_min, bounds.y_max, margin)
    )


class ParameterVector:
    """The parameters of a condensed problem: named windows of signals in one array, then a constant 1.

    Parameters
    ----------
    windows : mapping of str to (int, int)
        Length and width of each window.
    array : array, shape (parameters,), optional
        Values to begin with.

    Attributes
    ----------
    array : array, shape (parameters,)
        All windows and the 1; changed in place.
    sizes : dict of str to int
        Number of entries by name, in the order of the array.
    """

    def __init__(self, windows: Mapping[str, tuple[int, int]], array: FloatArray | None = None) -> None:
        self._shapes = dict(windows)
        self.sizes = {name: length * width for name, (length, width) in windows.items()} | {"one": 1}
        self.array = np.zeros(sum(self.sizes.values())) if array is None else array
        self.array[-1] = 1.0
        self._windows: dict[str, FloatArray] = {}
        self._moves: dict[str, tuple[FloatArray, FloatArray, FloatArray]] = {}
        start = 0
        for name, shape in windows.items():
            window = self.array[start : start + self.sizes[name]].reshape(shape)
            self._windows[name] = window
            self._moves[name] = window[:-1], window[1:], window[-1]
            start += self.sizes[name]

    def fill(self, name: str, values: FloatArray) -> None:
        """Set a window, shape (length, width), time along axis 0; a single sample fills all of it."""
        self._windows[name][...] = values

    def window(self, name: str) -> FloatArray:
        """Return a window, shape (length, width), time along axis 0: a view of the array."""
        return self._windows[name]

    def append(self, name: str, sample: FloatArray) -> None:
        """Forget a window's oldest sample and append one, shape (width,)."""
        older, newer, newest = self._moves[name]
        older[...] = newer
        newest[...] = sample

    def __reduce__(self) -> tuple[type["ParameterVector"], tuple[Mapping[str, tuple[int, int]], FloatArray]]:
        """Copy the array once: its windows are views, which copies would part from it."""
        return type(self), (self._shapes, self.array)


def _drawn_in(low: FloatArray, high: FloatArray, margin: float) -> tuple[FloatArray, FloatArray]:
    bounded = np.isfinite(low) & np.isfinite(high)
    middle = np.zeros_like(low)
    np.add(low / 2, high / 2, out=middle, where=bounded)
    shrink = np.where(bounded, margin, 1.0)
    return middle + shrink * (low - middle), middle + shrink * (high - middle)


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
