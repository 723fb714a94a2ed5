"""What DeePC and WKPC share: the recording they predict with, and the windows of signals they keep."""

from collections.abc import Mapping

import numpy as np

from ddpc_cosim import Bounds, DataError, FloatArray, Loop, Recording


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

    Attributes
    ----------
    array : array, shape (parameters,)
        All windows and the 1; changed in place.
    sizes : dict of str to int
        Number of entries by name, in the order of the array.
    """

    def __init__(self, windows: Mapping[str, tuple[int, int]]) -> None:
        self.sizes = {name: length * width for name, (length, width) in windows.items()} | {"one": 1}
        self.array = np.zeros(sum(self.sizes.values()))
        self.array[-1] = 1.0
        self._windows: dict[str, FloatArray] = {}
        start = 0
        for name, shape in windows.items():
            self._windows[name] = self.array[start : start + self.sizes[name]].reshape(shape)
            start += self.sizes[name]

    def __getitem__(self, name: str) -> FloatArray:
        """Return a window, shape (length, width), time along axis 0: a view, to be written to."""
        return self._windows[name]


class MovingWindow:
    """The last samples of a signal, kept in a window of a :class:`ParameterVector`.

    Parameters
    ----------
    window : array, shape (length, width)
        Where to keep them, the oldest first.
    """

    def __init__(self, window: FloatArray) -> None:
        self._kept, self._next, self._newest = window[1:], window[:-1], window[-1]

    def append(self, value: FloatArray) -> None:
        """Forget the oldest sample and append one, shape (width,)."""
        self._next[...] = self._kept
        self._newest[...] = value


def _drawn_in(low: FloatArray, high: FloatArray, margin: float) -> tuple[FloatArray, FloatArray]:
    bounded = np.isfinite(low) & np.isfinite(high)
    middle = np.zeros_like(low)
    np.add(low / 2, high / 2, out=middle, where=bounded)
    shrink = np.where(bounded, margin, 1.0)
    return middle + shrink * (low - middle), middle + shrink * (high - middle)
