"""A plant's model in innovation form: what it does on its inputs, and the noise that the data leave.

    x+ = f(x, u, d) + K eps,    y = h(x) + eps,    eps ~ N(0, covariance)

with u the inputs and d the known disturbances, both held over a sample (L. Ljung, System Identification, 2nd
ed., section 4.3). Most are linear between static g and h of each signal:

    x+ = A x + B (g(u) - u_0) + E (d - d_0) + K eps,    y = h(y_0 + C x) + eps
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ddpc_cosim.controller import Recording
from ddpc_cosim.variables import FloatArray

_LONGEST_LOOK = 200
"""Samples from which the state at the beginning of a piece is found."""
_NEGLIGIBLE = 1e-8
_STEPS, _SHARES = 4, (1.0, 0.5, 0.25, 0.1, 0.0)  # Gauss-Newton, and parts of a step


@dataclass(frozen=True, slots=True, eq=False)
class StaticMap:
    """A nonlinearity without memory of each of several signals: lines between points, and beyond them.

    Parameters
    ----------
    points, values : tuple of array, shape (n,)
        Of each signal what it maps and to what, the points rising; n is 2 or more.
    """

    points: tuple[FloatArray, ...]
    values: tuple[FloatArray, ...]

    def __call__(self, signals: FloatArray) -> FloatArray:
        """Return signals mapped, shape (..., signals)."""
        mapped = np.empty_like(signals)
        for i, (points, values) in enumerate(zip(self.points, self.values, strict=True)):
            left = np.clip(np.searchsorted(points, signals[..., i], side="right") - 1, 0, len(points) - 2)
            slope = np.diff(values)[left] / np.diff(points)[left]
            mapped[..., i] = values[left] + slope * (signals[..., i] - points[left])
        return mapped


class PlantModel(ABC):
    """A sampled model with its noise; see the module.

    Attributes
    ----------
    k : array, shape (n, p)
        The effect of an innovation on the state.
    u_0, d_0 : array, shapes (m,) and (n_d,)
        Inputs and disturbances at which its linear part is taken.
    covariance : array, shape (p, p)
        Of the innovations eps.
    sampling_time : float
        Time between samples [s].
    """

    __slots__ = ()
    k: FloatArray
    u_0: FloatArray
    d_0: FloatArray
    covariance: FloatArray
    sampling_time: float

    @property
    def order(self) -> int:
        """Number of states n."""
        return len(self.k)

    @property
    @abstractmethod
    def is_affine(self) -> bool:
        """Whether outputs are affine in the state, now and later."""

    @abstractmethod
    def driven(self, u: FloatArray, d: FloatArray) -> FloatArray:
        """Return what inputs and disturbances, shapes (..., m) and (..., n_d), are to the state."""

    @abstractmethod
    def onward(self, x: FloatArray, driven: FloatArray) -> FloatArray:
        """Return the states one sample later without noise; ``driven`` as :meth:`driven` returns it."""

    @abstractmethod
    def output(self, x: FloatArray) -> FloatArray:
        """Return the outputs without noise, shape (..., p), in states of shape (..., n)."""

    @abstractmethod
    def rest(self, u: FloatArray, d: FloatArray) -> FloatArray:
        """Return the state, shape (n,), in which it rests, or nearly does if it integrates, at inputs."""

    @abstractmethod
    def linear_part(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return A, B and C: how it goes on about a state of rest, as far as that is linear."""

    def next_state(self, x: FloatArray, u: FloatArray, d: FloatArray, noise: FloatArray) -> FloatArray:
        """Return the state one sample later, shape (n,), with the innovations, shape (p,), of this one."""
        return self.onward(x, self.driven(u, d)) + self.k @ noise

    def simulate(
        self,
        u: FloatArray,
        d: FloatArray | None = None,
        noise: FloatArray | None = None,
        x: FloatArray | None = None,
    ) -> FloatArray:
        """Return the outputs over a course of the inputs.

        Parameters
        ----------
        u, d : array, shapes (T, m) and (T, n_d)
            Inputs and disturbances; row i acts from sample i to the next.
        noise : array, shape (T, p), optional
            The innovations; default: none.
        x : array, shape (n,), optional
            The state at the first sample; default: it rests at the first inputs.

        Returns
        -------
        y : array, shape (T, p)
            Outputs at the samples.
        """
        d = np.zeros((len(u), 0)) if d is None else d
        driven = self.driven(u, d)
        added = np.zeros((len(u), self.order)) if noise is None else noise @ self.k.T
        state = self.rest(u[0], d[0]) if x is None else x
        states = np.empty((len(u), self.order))
        with np.errstate(over="ignore", invalid="ignore"):  # a model may be unstable: then it is far off
            for i, row in enumerate(driven):
                states[i] = state
                state = self.onward(state, row) + added[i]
        y = self.output(states)
        return y if noise is None else y + noise

    def predict(self, recording: Recording, steps: int) -> FloatArray:
        """Return the outputs predicted from what was measured so many samples before.

        Parameters
        ----------
        recording : Recording
            The data, at the model's sampling time.
        steps : int
            How many samples ahead: 1 or more. Row i rests on the outputs up to row ``i - steps``.

        Returns
        -------
        y : array, shape (T, p)
            NaN in the first ``steps - 1`` rows of every piece, of which nothing that is so old is known.
        """
        predicted = np.full(recording.y.shape, np.nan)
        for rows, piece in _pieces(recording):
            if len(piece) < steps:
                continue
            driven, states = self.driven(piece.u, piece.d), self.observed(piece)
            count = len(piece) - steps + 1
            states = states[:count]
            for i in range(steps - 1):
                states = self.onward(states, driven[i : i + count])
            predicted[rows][steps - 1 :] = self.output(states)
        return predicted

    def one_step_errors(self, recording: Recording) -> FloatArray:
        """Return what the outputs are beyond those predicted one sample ahead, shape (T, p)."""
        return recording.y - self.predict(recording, 1)

    def observed(self, piece: Recording) -> FloatArray:
        """Return the states at the samples of one piece, shape (T, n), each from the outputs before it."""
        return self._observed(piece, self.first_state(piece))[0]

    def last_state(self, piece: Recording) -> FloatArray:
        """Return the state one sample after the last of a piece, shape (n,)."""
        return self._observed(piece, self.first_state(piece))[1]

    def first_state(self, piece: Recording) -> FloatArray:
        """Return the state at the first sample, shape (n,), that explains the samples after it best."""
        head = rows_of(piece, slice(_LONGEST_LOOK))
        start = self.rest(head.u[0], head.d[0])

        def errors(states: FloatArray) -> FloatArray:
            """Return the errors from several states on, shape (states, rows p)."""
            every = list[FloatArray]()
            for row, y in zip(self.driven(head.u, head.d), head.y, strict=True):
                every.append(y - self.output(states))
                states = self.onward(states, row) + every[-1] @ self.k.T
            return np.stack(every, axis=1).reshape(len(states), -1)

        size, steps, shares = (1.0, 1, (1.0,)) if self.is_affine else (1e-3, _STEPS, _SHARES)
        for _ in range(steps):
            left, *changed = errors(start + size * np.eye(self.order + 1, self.order, -1))
            step, *_ = np.linalg.lstsq((np.array(changed) - left).T / size, -left, rcond=_NEGLIGIBLE)
            # Of a nonlinear model's errors that is the slope alone: as far along it as they become smaller.
            tried = start + np.outer(shares, step)
            start = np.asarray(tried[np.square(errors(tried)).sum(axis=1).argmin()])
        return start

    def _observed(self, piece: Recording, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the states at the samples, shape (T, n), and that after them."""
        driven = self.driven(piece.u, piece.d)
        states = np.empty((len(piece), self.order))
        for i, row in enumerate(driven):
            states[i] = state
            state = self.onward(state, row) + self.k @ (piece.y[i] - self.output(state))
        return states, state


@dataclass(frozen=True, slots=True, eq=False)
class InnovationModel(PlantModel):
    """A model that is linear between static nonlinearities.

    Parameters
    ----------
    a, b, e, k, c : array, shapes (n, n), (n, m), (n, n_d), (n, p), (p, n)
        The matrices.
    u_0, y_0, d_0 : array, shapes (m,), (p,), (n_d,)
        Where it rests at x = 0.
    covariance : array, shape (p, p)
        Of the innovations eps.
    sampling_time : float
        Time between samples [s].
    method : str
        How it was found, in words: ``"arx"``.
    input_map, output_map : StaticMap, optional
        The nonlinearities g and h; default: there are none.
    rows : int
        Samples that it was found from: what takes longer than those is not known to come to rest.
    """

    a: FloatArray
    b: FloatArray
    e: FloatArray
    k: FloatArray
    c: FloatArray
    u_0: FloatArray
    y_0: FloatArray
    d_0: FloatArray
    covariance: FloatArray
    sampling_time: float
    method: str
    input_map: StaticMap | None = None
    output_map: StaticMap | None = None
    rows: int = 10**8

    @property
    def is_affine(self) -> bool:
        """Whether outputs are affine in the state: unless there is an output map."""
        return self.output_map is None

    def driven(self, u: FloatArray, d: FloatArray) -> FloatArray:
        """Return what inputs and disturbances, shapes (..., m) and (..., n_d), add to the next state."""
        mapped = u if self.input_map is None else self.input_map(u)
        return (mapped - self.u_0) @ self.b.T + (d - self.d_0) @ self.e.T

    def onward(self, x: FloatArray, driven: FloatArray) -> FloatArray:
        """Return the states one sample later without noise, shape (n,) or (T, n)."""
        return np.asarray((self.a @ x.T).T + driven)

    def output(self, x: FloatArray) -> FloatArray:
        """Return the outputs without noise, shape (..., p), in states of shape (..., n)."""
        y = self.y_0 + x @ self.c.T
        return y if self.output_map is None else self.output_map(y)

    def rest(self, u: FloatArray, d: FloatArray) -> FloatArray:
        """Return the state, shape (n,), in which it rests at inputs.

        What integrates, or takes longer to settle than the data that it was found from, stays where it is at
        x = 0: where that would rest is anywhere, also far from all that was recorded.
        """
        driven = self.driven(u, d)
        if not any(map(self._lasts, np.linalg.eigvals(self.a))):
            return np.asarray(np.linalg.solve(np.eye(self.order) - self.a, driven))
        from scipy.linalg import schur, solve_sylvester

        # A = Q T Q', the lasting modes first; with X they and the others, w and v, go on independently.
        t, q, count = schur(self.a, sort=lambda real, imaginary: self._lasts(complex(real, imaginary)))
        x = solve_sylvester(t[:count, :count], -t[count:, count:], -t[:count, count:])
        v = np.linalg.solve(np.eye(self.order - count) - t[count:, count:], q[:, count:].T @ driven)
        return np.asarray(q @ np.concatenate([x @ v, v]))

    def _lasts(self, pole: complex) -> bool:
        return abs(pole - 1.0) * self.rows < 1.0

    def linear_part(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return A, B and C, of the model between its nonlinearities."""
        return self.a, self.b, self.c


def rows_of(recording: Recording, rows: slice) -> Recording:
    """Return some rows, one after another, of a recording."""
    first, last, _ = rows.indices(len(recording))
    return Recording(
        recording.u[rows],
        recording.y[rows],
        recording.measured[rows],
        recording.sampling_time,
        tuple(seam - first for seam in recording.seams if first < seam < last),
        recording.d[rows],
        excitation=recording.excitation[rows],
    )


def _pieces(recording: Recording) -> Iterator[tuple[slice, Recording]]:
    first = 0
    for piece in recording.pieces:
        yield slice(first, first + len(piece)), piece
        first += len(piece)
