"""Feedforward of measured disturbances beside a feedback controller, identified from a recording.

What is fed forward is a sum of lags of every disturbance,

    u_ff = sum_j G_j f_j,   f_j,k = a_j f_j,k-1 + (1 - a_j) (d_k - d_0),   a_j = exp(-1 / tau_j),

so that it can be slower than the disturbance, is stable whatever the gains, and is zero where the loop
closes. The gains minimise what the recorded disturbances leave at the outputs of the loop closed with an
identified model: that is linear in them (a least-squares filter after N. Wiener, for the loop as it is). With
one lag of no length it would be about the ratio of the plant's gains, which a plant that answers disturbances
later than inputs does not want (K. J. Astrom, T. Hagglund, Advanced PID Control, ISA 2006, chapter 5).
"""

from collections.abc import Callable, Sequence

import numpy as np

from ddpc_controllers.models.identification import choose_lags, fit_arx
from ddpc_cosim import FloatArray, Recording

TIME_CONSTANTS = (0.0, 3.0, 10.0, 30.0, 100.0)
"""Of the lags, in samples."""
_RIDGE = 1e-3
"""Weight of the squared gains, each in parts of what it does to the outputs."""
_DIVERGED = 1e6

Feedback = Callable[[FloatArray], FloatArray]
"""A started linear controller: from outputs off the reference, (p, runs), to inputs, (m, runs)."""


class Feedforward:
    """Feedforward with given gains.

    Parameters
    ----------
    gains : array, shape (m, lags, n_d)
        How much of each lag of each disturbance is added to each input.

    Attributes
    ----------
    poles : array, shape (lags,)
        The poles a_j of the lags.
    """

    def __init__(self, gains: FloatArray) -> None:
        self.gains = gains
        self.poles = _poles()
        self._first: FloatArray | None = None
        self._lags = np.zeros(gains.shape[1:])

    @property
    def memory(self) -> FloatArray:
        """What it remembers, for code in C: the first disturbances and their lags, ((1 + lags) n_d,)."""
        first = np.zeros(self.gains.shape[2]) if self._first is None else self._first
        return np.append(first, self._lags)

    def step(self, d: FloatArray) -> FloatArray:
        """Return what to add to the inputs, shape (m,), for disturbances d, shape (n_d,)."""
        if self._first is None:
            self._first = d.copy()
        poles = self.poles[:, np.newaxis]
        self._lags = poles * self._lags + (1.0 - poles) * (d - self._first)
        return np.asarray(np.einsum("mjd,jd->m", self.gains, self._lags))


def identify_feedforward(
    recording: Recording, inputs: Sequence[int], start: Callable[[int], Feedback]
) -> FloatArray:
    """Return the gains for a loop.

    Parameters
    ----------
    recording : Recording
        The experiment, with what disturbed it.
    inputs : sequence of int
        The inputs that the feedback moves.
    start : callable
        Returns the feedback from the outputs to these inputs, for so many runs side by side.

    Returns
    -------
    gains : array, shape (len(inputs), lags, n_d)
        Zero where the feedback does not stabilise the model.
    """
    model = fit_arx(recording, choose_lags(recording))
    b, d = model.b[:, inputs], recording.d - recording.d[0]
    lags, n_d, m = len(TIME_CONSTANTS), d.shape[1], len(inputs)
    # Run 0 has the disturbances alone, each other one a lag of one disturbance at one input alone.
    injected = np.zeros((m, 1 + m * lags * n_d))
    injected[:, 1:] = np.repeat(np.eye(m), lags * n_d, axis=1)
    runs = injected.shape[1]
    alone, poles = np.eye(1, runs)[0], _poles()[:, np.newaxis]
    x, filtered, feedback = np.zeros((len(model.a), runs)), np.zeros((lags, n_d)), start(runs)
    size = np.where(recording.y.std(axis=0) > 0.0, recording.y.std(axis=0), 1.0)
    outputs = np.empty((len(d), len(size), runs))
    for k, acting in enumerate(d):
        filtered = poles * filtered + (1.0 - poles) * acting
        y = model.c @ x + np.outer(model.f @ acting, alone)
        u = feedback(y) + injected * np.append(0.0, np.tile(filtered.ravel(), m))
        x = model.a @ x + b @ u + np.outer(model.e @ acting, alone)
        outputs[k] = y / size[:, np.newaxis]
        if not np.abs(outputs[k]).max() < _DIVERGED:
            return np.zeros((m, lags, n_d))
    left, shown = np.split(outputs.reshape(-1, runs), [1], axis=1)
    scale = np.linalg.norm(shown, axis=0)
    scale[scale == 0.0] = 1.0
    system = np.vstack([shown / scale, np.sqrt(_RIDGE) * np.eye(runs - 1)])
    target = np.append(-left[:, 0], np.zeros(runs - 1))
    gains = np.linalg.lstsq(system, target)[0] / scale
    return np.asarray(gains.reshape(m, lags, n_d))


def _poles() -> FloatArray:
    """Return a_j of the lags, 0 where there is none."""
    return np.array([np.exp(-1.0 / samples) if samples else 0.0 for samples in TIME_CONSTANTS])
