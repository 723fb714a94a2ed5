"""Linear one-step predictors: what every linear estimator finds.

The innovation form ``x+ = A x + B u + E d + K eps, y = C x + eps`` says at the same time how the plant goes
on and how its outputs are best predicted from the past:

    x+ = (A - K C) x + G z,   z = (u, d, y, 1)
    yhat = C x + y_0

(L. Ljung, System Identification, 2nd ed., section 4.3). The predictor is stable also where the plant is
not, its errors are white where the model is true, and with them it is consistent for data of a closed loop.
ARX and ARMAX models are special cases of it. Signals here are standardised, inputs are shifted by their
dead times, and every stretch of a mosaic has an initial state of its own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_discrete_are

from ddpc_cosim.controller import Recording
from ddpc_cosim.errors import DataError
from ddpc_cosim.identification.innovation import InnovationModel
from ddpc_cosim.variables import FloatArray

_AT_REST = 1e-8
_NEGLIGIBLE = 1e-9
_CONSTANT = 1e-12
_LITTLE_NOISE = 1e-6  # that every state has, so that a gain exists


@dataclass(frozen=True, slots=True)
class Samples:
    """A recording as estimators see it: standardised, its inputs shifted by their dead times.

    Parameters
    ----------
    z : array, shape (T, m + n_d + p + 1)
        Inputs, known disturbances, outputs and ones, time along axis 0.
    counts : tuple of int
        Numbers of inputs, known disturbances and outputs.
    means, sizes : array, shape (m + n_d + p,)
        What was taken off the signals, and what they were divided by.
    seams : tuple of int
        The first row of every stretch but the first.
    delays : tuple of int
        By how many rows each input is shifted.
    sampling_time : float
        Time between rows [s].
    """

    z: FloatArray
    counts: tuple[int, int, int]
    means: FloatArray
    sizes: FloatArray
    seams: tuple[int, ...]
    delays: tuple[int, ...]
    sampling_time: float

    @classmethod
    def of(cls, recording: Recording, delays: Sequence[int] = ()) -> "Samples":
        """Standardise a recording; rows for which a shifted input is not known are left out.

        Raises
        ------
        DataError
            None is left.
        """
        counts = (recording.u.shape[1], recording.d.shape[1], recording.y.shape[1])
        delays = tuple(delays) or (0,) * counts[0]
        lost, stretches = max(delays, default=0), list[FloatArray]()
        for piece in recording.pieces:
            if len(piece) > lost:
                shifted = [piece.u[lost - n : len(piece) - n, i] for i, n in enumerate(delays)]
                stretches.append(np.hstack([np.array(shifted).T, piece.d[lost:], piece.y[lost:]]))
        if not stretches:
            raise DataError(f"recording: no piece is longer than the dead time, {lost} samples")
        signals = np.vstack(stretches)
        means = signals.mean(axis=0)
        sizes = signals.std(axis=0)
        sizes = np.where(sizes > _CONSTANT * np.maximum(np.abs(means), 1.0), sizes, 1.0)
        z = np.hstack([(signals - means) / sizes, np.ones((len(signals), 1))])
        seams = np.cumsum([len(stretch) for stretch in stretches])[:-1]
        return cls(z, counts, means, sizes, tuple(seams.tolist()), delays, recording.sampling_time)

    @property
    def y(self) -> FloatArray:
        """Outputs, shape (T, p)."""
        return self.z[:, -1 - self.counts[2] : -1]

    @property
    def stretches(self) -> list[slice]:
        """The rows of every stretch."""
        return [slice(i, j) for i, j in pairwise((0, *self.seams, len(self.z)))]

    def rows(self, rows: slice) -> "Samples":
        """Return some of the rows, standardised as all of them."""
        first, last, _ = rows.indices(len(self.z))
        seams = tuple(seam - first for seam in self.seams if first < seam < last)
        return Samples(
            self.z[rows], self.counts, self.means, self.sizes, seams, self.delays, self.sampling_time
        )

    def with_outputs(self, y: FloatArray) -> "Samples":
        """Return the same with other outputs, standardised as these."""
        z = np.hstack([self.z[:, : -1 - y.shape[1]], y, np.ones((len(y), 1))])
        return Samples(z, self.counts, self.means, self.sizes, self.seams, self.delays, self.sampling_time)

    def __len__(self) -> int:
        return len(self.z)


@dataclass(frozen=True, slots=True)
class Predictor:
    """``x+ = a x + g z, yhat = c x + y_0`` for standardised signals.

    Parameters
    ----------
    a : array, shape (n, n)
        ``A - K C``.
    g : array, shape (n, m + n_d + p + 1)
        Effect of inputs, disturbances, outputs and the constant on the state.
    c : array, shape (p, n)
        Outputs of the state.
    y_0 : array, shape (p,)
        Outputs at state 0.
    """

    a: FloatArray
    g: FloatArray
    c: FloatArray
    y_0: FloatArray

    def gain(self) -> FloatArray:
        """Return K, the effect of a one-step error on the state, shape (n, p)."""
        return self.g[:, -1 - len(self.c) : -1]

    def plant(self) -> FloatArray:
        """Return A, how the state goes on, shape (n, n)."""
        return self.a + self.gain() @ self.c

    def stabilised(self, inputs: int) -> "Predictor":
        """Return a predictor of the same plant that is stable: with a Kalman gain, if its own is not.

        Parameters
        ----------
        inputs : int
            Number of inputs and disturbances, along which the state is taken to be disturbed.
        """
        if self.is_stable():
            return self
        a, b, c, p = self.plant(), self.g[:, :inputs], self.c, len(self.c)
        disturbed = b @ b.T + _LITTLE_NOISE * np.eye(len(b))
        spread = solve_discrete_are(a.T, c.T, disturbed, np.eye(p))
        k = a @ spread @ c.T @ np.linalg.inv(np.eye(p) + c @ spread @ c.T)
        g = self.g.copy()
        g[:, -1] += (self.gain() - k) @ self.y_0
        g[:, -1 - p : -1] = k
        return Predictor(a - k @ c, g, c, self.y_0)

    def is_stable(self) -> bool:
        """Return whether it forgets what was long ago, as the plant need not."""
        return bool(np.abs(np.linalg.eigvals(self.a)).max() < 1.0)

    def plant_is_stable(self) -> bool:
        """Return whether the plant's own dynamics are."""
        return bool(np.abs(np.linalg.eigvals(self.plant())).max() < 1.0)

    def states(self, samples: Samples) -> FloatArray:
        """Return the states of every row, from 0 at the beginning of every stretch, shape (T, n)."""
        return scan(self.a, samples.z @ self.g.T, samples.stretches)

    def errors(self, samples: Samples) -> FloatArray:
        """Return the one-step errors, with the initial states that explain the outputs best, shape (T, p)."""
        left = samples.y - self.y_0 - self.states(samples) @ self.c.T
        for rows in samples.stretches:
            effect = self.initial_effect(rows.stop - rows.start)
            start = np.linalg.lstsq(effect, left[rows].ravel(), rcond=_NEGLIGIBLE)[0]
            left[rows] -= (effect @ start).reshape(-1, len(self.c))
        return left

    def initial_effect(self, rows: int) -> FloatArray:
        """Return how an initial state shows in the outputs of so many rows, shape (rows p, n)."""
        return self.initial_response(rows).reshape(-1, len(self.a))

    def initial_response(self, rows: int) -> FloatArray:
        """Return ``c a^i`` for i = 0 ... rows - 1, shape (rows, p, n)."""
        p, n = self.c.shape
        zeros = np.broadcast_to(np.zeros((n, p)), (rows, n, p))
        return scan(self.a.T, zeros, [slice(0, rows)], self.c.T).transpose(0, 2, 1)

    def model(self, samples: Samples, method: str, spent: float) -> InnovationModel:
        """Return the innovation form in the recording's units, at an operating point where it rests.

        Parameters
        ----------
        samples : Samples
            What it was estimated from.
        method : str
            How.
        spent : float
            Rows of each output that the estimate has used up: as many errors fewer tell of the noise.
        """
        errors = self.errors(samples)
        covariance = errors.T @ errors / max(len(samples) - spent, 1.0)
        m, n_d, _ = samples.counts
        k, n = self.gain(), len(self.a)
        b, e, constant = self.g[:, :m], self.g[:, m : m + n_d], self.g[:, -1] + k @ self.y_0
        a, b, e, k, c = _with_dead_times(self.plant(), b, e, k, self.c, samples.delays)
        constant = np.concatenate([constant, np.zeros(len(a) - n)])
        # The states and inputs nearest to zero at which the model with its constant rests.
        rest = np.linalg.lstsq(np.hstack([np.eye(len(a)) - a, -b]), constant, rcond=_AT_REST)[0]
        x_0, u_0 = rest[: len(a)], rest[len(a) :]
        (mean_u, mean_d, mean_y), (size_u, size_d, size_y) = (
            np.split(scale, [m, m + n_d]) for scale in (samples.means, samples.sizes)
        )
        return InnovationModel(
            a=a,
            b=b / size_u,
            e=e / size_d,
            k=k / size_y,
            c=c * size_y[:, np.newaxis],
            u_0=mean_u + size_u * u_0,
            y_0=mean_y + size_y * (c @ x_0 + self.y_0),
            d_0=mean_d,
            covariance=covariance * np.outer(size_y, size_y),
            sampling_time=samples.sampling_time,
            method=method,
            rows=len(samples),
        )


Refit = Callable[[FloatArray], Predictor]
"""Makes the predictor that other one-step errors, shape (T, p), would have given."""


def scan(
    a: FloatArray, inputs: FloatArray, stretches: Sequence[slice], start: FloatArray | None = None
) -> FloatArray:
    """Return x_0, x_1, ... of ``x+ = a x + inputs`` for every stretch, shape of the inputs.

    Every stretch is cut into blocks, which are computed side by side as if each began at 0; what each
    hands on is added afterwards.

    Parameters
    ----------
    a : array, shape (n, n)
        How the state goes on.
    inputs : array, shape (T, n) or (T, n, columns)
        What is added, time along axis 0.
    stretches : sequence of slice
        The rows of every stretch.
    start : array, shape of an input, optional
        The state at the beginning of every stretch; default: 0.
    """
    n = len(a)
    columns = inputs.reshape(len(inputs), n, -1)
    states = np.empty(columns.shape)
    begin = np.zeros(columns.shape[1:]) if start is None else start.reshape(columns.shape[1:])
    for rows in stretches:
        states[rows] = _scan_stretch(a, columns[rows], begin)
    return states.reshape(inputs.shape)


def _scan_stretch(a: FloatArray, inputs: FloatArray, start: FloatArray) -> FloatArray:
    rows, n, width = inputs.shape
    length = max(1, int(np.sqrt(rows)))
    blocks = -(-rows // length)
    padded = np.zeros((blocks * length, n, width))
    padded[:rows] = inputs
    by_block = padded.reshape(blocks, length, n, width).transpose(1, 2, 0, 3).reshape(length, n, -1)
    local, powers = np.empty_like(by_block), np.empty((length + 1, n, n))
    state, powers[0] = np.zeros(by_block.shape[1:]), np.eye(n)
    for i in range(length):
        local[i] = state
        state = a @ state + by_block[i]
        powers[i + 1] = a @ powers[i]
    ends, begins = state.reshape(n, blocks, width), np.empty((n, blocks, width))
    begins[:, 0] = start
    for i in range(1, blocks):
        begins[:, i] = powers[-1] @ begins[:, i - 1] + ends[:, i - 1]
    states = local + (powers[:-1].reshape(-1, n) @ begins.reshape(n, -1)).reshape(local.shape)
    every: FloatArray = states.reshape(length, n, blocks, width).transpose(2, 0, 1, 3)
    return every.reshape(blocks * length, n, width)[:rows]


def _with_dead_times(
    a: FloatArray, b: FloatArray, e: FloatArray, k: FloatArray, c: FloatArray, delays: Sequence[int]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return a model whose inputs are delayed: one more state for every row of every delay."""
    for i, delay in enumerate(delays):
        if delay:
            n = len(a)
            chain = np.zeros((n + delay, n + delay))
            chain[:n, :n], chain[:n, -1] = a, b[:, i]
            chain[n + 1 :, n:-1] = np.eye(delay - 1)
            entry = np.zeros((n + delay, b.shape[1]))
            entry[:n] = b
            entry[:, i] = 0.0
            entry[n, i] = 1.0
            a, b = chain, entry
            e, k = (np.vstack([effect, np.zeros((delay, effect.shape[1]))]) for effect in (e, k))
            c = np.hstack([c, np.zeros((len(c), delay))])
    return a, b, e, k, c
