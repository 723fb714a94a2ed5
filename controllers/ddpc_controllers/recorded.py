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
