"""Windows of recorded signals: how they are stacked, from a recording or sample by sample."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddpc_controllers.behavioral import hankel_matrix
from ddpc_cosim import FloatArray

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
