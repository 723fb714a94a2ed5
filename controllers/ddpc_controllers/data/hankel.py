"""Windows of a recording as a predictor stacks them, and whether the recording excites the plant enough."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim import (
    RANK_TOLERANCE,
    DataError,
    FloatArray,
    Loop,
    Recording,
    count_windows as count_windows,
    hankel_matrix as hankel_matrix,
    numerical_rank as numerical_rank,
    persistency_of_excitation as persistency_of_excitation,
    window_starts as window_starts,
)

_LARGEST_HANKEL = 200
"""Rows of the largest Hankel matrix decomposed to find how far beyond the need a recording excites."""


@dataclass(frozen=True, slots=True)
class DataDiagnostics:
    """How much a recording says about the plant.

    Parameters
    ----------
    pe_order : int
        Order of persistency of excitation of the inputs.
    pe_order_needed : int
        Order that the controller needs.
    data_rank : int
        Numerical rank of the stacked data matrix.
    data_rows, data_columns : int
        Its size.
    smallest_singular_value, condition : float
        The smallest singular value that counts towards the rank, and the ratio of the largest to it, of the
        matrix with rows of root mean square 1: the units of the signals do not matter.
    """

    pe_order: int
    pe_order_needed: int
    data_rank: int
    data_rows: int
    data_columns: int
    smallest_singular_value: float
    condition: float

    def as_dict(self) -> dict[str, float]:
        """Return the values by name."""
        return {name: float(value) for name, value in asdict(self).items()}


def least_samples(order: int, inputs: int) -> int:
    """Return the least number of samples with which ``inputs`` signals can excite up to an order."""
    return (inputs + 1) * order - 1


def diagnose(
    stacked: FloatArray, u: FloatArray, order_needed: int, seams: Sequence[int] = ()
) -> DataDiagnostics:
    """Return rank, smallest singular value and order of excitation of a recording, whatever its units.

    Parameters
    ----------
    stacked : array, shape (rows, columns)
        The stacked Hankel matrices that the controller predicts with.
    u : array, shape (T, m)
        The recorded inputs.
    order_needed : int
        Order of persistency of excitation that the controller needs.
    seams : sequence of int
        The first sample of every piece of the recording but the first.
    """
    size = np.sqrt(np.mean(np.square(stacked), axis=1, keepdims=True))
    size[size == 0.0] = 1.0
    values = np.linalg.svd(stacked / size, compute_uv=False).astype(np.float64)
    rank = int(np.count_nonzero(values > RANK_TOLERANCE * values.max(initial=0.0)))
    smallest = float(values[rank - 1]) if rank else 0.0
    look_up_to = max(order_needed, _LARGEST_HANKEL // u.shape[1])
    return DataDiagnostics(
        pe_order=persistency_of_excitation(u, look_up_to, seams=seams),
        pe_order_needed=order_needed,
        data_rank=rank,
        data_rows=stacked.shape[0],
        data_columns=stacked.shape[1],
        smallest_singular_value=smallest,
        condition=float(values[0]) / smallest if rank else np.inf,
    )


def require_length(
    samples: int,
    order_needed: int,
    signals: int,
    who: str,
    seams: Sequence[int] = (),
    disturbances: int = 0,
) -> None:
    """Check that a recording is long enough to be persistently exciting of an order at all.

    Parameters
    ----------
    samples, order_needed, signals : int
        Its length, the order, and the number of inputs and disturbances.
    who : str
        Who asks.
    seams : sequence of int
        The first sample of every piece but the first.
    disturbances : int
        How many of the signals are disturbances.

    Raises
    ------
    DataError
        The lengths there and needed.
    """
    needed = least_samples(order_needed, signals)
    if count_windows(samples, order_needed, seams) < signals * order_needed:
        besides = f" and {disturbances} known disturbance(s)" if disturbances else ""
        pieces = f" in {len(seams) + 1} pieces, of which each needs more" if seams else ""
        raise DataError(
            f"{who}: the recording has {samples} samples{pieces}; persistency of excitation of order "
            f"{order_needed} with {signals - disturbances} input(s){besides} takes at least {needed}: "
            "record longer, "
            "or shorten horizon or initial_length"
        )


def require_excitation(diagnostics: DataDiagnostics, why: str, who: str, disturbances: int = 0) -> None:
    """Check that the inputs, and so many disturbances, excite enough.

    Raises
    ------
    DataError
        The order reached and the order needed.
    """
    reached, needed = diagnostics.pe_order, diagnostics.pe_order_needed
    if reached < needed:
        what = "input and disturbances together are" if disturbances else "input is"
        remedy = (
            "a richer input, let the disturbances move more in the experiment (recording.disturbances), or "
            "take them for unknown"
            if disturbances
            else "a richer input"
        )
        raise DataError(
            f"{who}: the recorded {what} persistently exciting of order {reached}, needed {needed} "
            f"({why}); its windows have rank {diagnostics.data_rank} of {diagnostics.data_rows} rows, "
            f"smallest singular value {diagnostics.smallest_singular_value:.1e}: record more samples or use "
            f"{remedy}"
        )


def require_informative(u: FloatArray, known: FloatArray, who: str) -> None:
    """Check that every input does something that what went before it does not foretell.

    Inputs that stand still do not, nor do those of a bare feedback; with an excitation added to it they do.

    Parameters
    ----------
    u : array, shape (N, m)
        Inputs, time along axis 0.
    known : array, shape (N, k)
        What the model explains besides them: outputs measured before each of them, and the inputs before it.
    who : str
        Who asks.

    Raises
    ------
    DataError
        How many inputs do, and by how much the weakest does.
    """
    size, m = len(u), u.shape[1]
    moves = u - u.mean(axis=0)
    length = np.linalg.norm(moves, axis=0)
    still = length <= RANK_TOLERANCE * np.linalg.norm(u, axis=0)
    moves = np.where(still, 0.0, moves / np.where(still, 1.0, length))
    factor = np.asarray(np.linalg.qr(np.hstack([np.ones((size, 1)), known, moves]), mode="r"))
    singular_values = np.linalg.svd(factor[-m:, -m:], compute_uv=False)
    rank = int(np.count_nonzero(singular_values > RANK_TOLERANCE))
    if rank < m:
        order = persistency_of_excitation(np.where(still, 0.0, u - u.mean(axis=0)))
        raise DataError(
            f"{who}: the recorded inputs do not show what they do: they follow from the samples before them, "
            f"or from each other (rank {rank} of {m}, smallest singular value {singular_values[-1]:.1e}; "
            f"off their means they are persistently exciting of order {order}): record with a richer input; "
            "in closed loop, add an excitation to the controller's"
        )


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

    def stack(self, signals: Mapping[str, FloatArray], seams: Sequence[int] = ()) -> FloatArray:
        """Return M of recorded signals, shape (T, width) each, time along axis 0, its seams left out."""
        samples = len(next(iter(signals.values())))
        columns = samples - self.depth + 1
        signals = {ONE: np.ones((samples, 1)), **signals}
        stacked = np.concatenate(
            [
                hankel_matrix(signals[name][start : start + length + columns - 1], length)
                for name, start, length in self.blocks
            ]
        )
        return stacked[:, window_starts(samples, self.depth, seams)] if seams else stacked

    def rows_of(self, signal: str, widths: Mapping[str, int]) -> NDArray[np.intp]:
        """Return which rows of M hold a signal, given the width of each."""
        rows, end, widths = list[int](), 0, {ONE: 1, **widths}
        for name, _, length in self.blocks:
            start, end = end, end + length * widths[name]
            rows += range(start, end) if name == signal else ()
        return np.array(rows, dtype=np.intp)


def informative_windows(
    layout: WindowLayout, recording: Recording, order: int, depth: int, who: str
) -> tuple[FloatArray, DataDiagnostics]:
    """Return M of a recording that excites the plant up to an order, and what it says about the plant.

    Parameters
    ----------
    layout : WindowLayout
        How windows are stacked.
    recording : Recording
        The experiment.
    order : int
        Order of persistency of excitation that is needed.
    depth : int
        How much of it is samples of a window; the rest is the assumed order of the plant.
    who : str
        Who asks.

    Raises
    ------
    DataError
        It is too short, or does not excite that much.
    """
    moved, disturbances = signals_that_move(recording), recording.d.shape[1]
    require_length(len(moved), order, moved.shape[1], who, recording.seams, disturbances)
    data = layout.stack(signals_of(recording), recording.seams)
    widths = {name: values.shape[1] for name, values in signals_of(recording).items()}
    sums = layout.rows_of(ONE, widths)
    windows = np.delete(data, sums, axis=0) if sums.size else data
    diagnostics = diagnose(windows, moved, order, recording.seams)
    why = f"depth {depth} + assumed order {order - depth}"
    require_excitation(diagnostics, why, who, disturbances)
    return data, diagnostics


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
    sizes = (recording.u.shape[1], recording.y.shape[1], recording.measured.shape[1])
    wanted = (len(loop.inputs), len(loop.outputs), len(loop.measurements))
    if recording.d.shape[1] != len(loop.disturbances):
        names = ", ".join(variable.name for variable in loop.disturbances) or "none"
        raise DataError(
            f"{who}: the recording has {recording.d.shape[1]} known disturbance(s), the loop has "
            f"{len(loop.disturbances)} ({names}): record them too, or take them for unknown"
        )
    if sizes != wanted:
        raise DataError(
            f"{who}: the recording has (inputs, outputs, measurements) = {sizes}, the loop has {wanted}"
        )
    if not math.isclose(recording.sampling_time, loop.sampling_time, rel_tol=1e-9, abs_tol=1e-8):
        raise DataError(
            f"{who}: the recording was sampled every {recording.sampling_time:g} s, the loop runs every "
            f"{loop.sampling_time:g} s: record at the loop's sampling time"
        )
    return recording


def running_past(loop: Loop) -> Recording | None:
    """Return the samples before the first one, in one piece, where the plant is running; None: it rests."""
    if loop.continues_recording and loop.recording is not None:
        return loop.recording.pieces[-1]
    return loop.past


def signals_of(recording: Recording) -> dict[str, FloatArray]:
    """Return what windows are made of: inputs, outputs and disturbances, shape (T, width) each."""
    return {"u": recording.u, "y": recording.y, "d": recording.d}


def signals_that_move(recording: Recording) -> FloatArray:
    """Return what has to excite the plant: inputs and disturbances, shape (T, m + n_d)."""
    return np.hstack([recording.u, recording.d])


def samples_before(loop: Loop, length: int) -> Recording | None:
    """Return the samples before the first one of a loop, None where it starts from rest.

    Before a past that is shorter the plant is supposed to have been as in its first sample.
    """
    past = running_past(loop)
    if past is None or not len(past):
        return None
    rows = np.maximum(np.arange(len(past) - length, len(past)), 0)
    return Recording(past.u[rows], past.y[rows], past.measured[rows], past.sampling_time, d=past.d[rows])


def resting_input(loop: Loop) -> FloatArray:
    """Return the inputs before the first sample of a loop that starts from rest, shape (m,)."""
    start = np.array([variable.start for variable in loop.inputs])
    return np.asarray(np.minimum(np.maximum(start, loop.bounds.u_min), loop.bounds.u_max))


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

    @property
    def newest_first(self) -> FloatArray:
        """The samples, shape (memory + 1, q)."""
        return self._newest_first

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
    """Return a recording without the first samples of each of its pieces."""
    kept = window_starts(len(recording), samples + 1, recording.seams) + samples
    seams = np.searchsorted(kept, recording.seams)
    return Recording(
        recording.u[kept],
        recording.y[kept],
        recording.measured[kept],
        recording.sampling_time,
        tuple(seam for seam in sorted({*seams.tolist()}) if 0 < seam < len(kept)),
        recording.d[kept],
        excitation=recording.excitation[kept],
    )
