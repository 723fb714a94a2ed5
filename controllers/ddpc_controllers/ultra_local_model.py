"""The ultra-local model ``y^(nu) = F + alpha u``: F and the derivatives of y from a window of samples.

M. Fliess and C. Join, Model-free control, International Journal of Control 86(12), 2013,
doi:10.1080/00207179.2013.810345, estimate F over a short window in which it is taken as constant. Here the
solutions of the model under the inputs held between the samples,

    y(t) - alpha w(t) = y_k + y'_k t + ... + F t^nu / nu!,   w^(nu) = u,   w = w' = ... = 0 now,

are fitted to the window by least squares: exact where F is constant, and linear in the samples, so that the
estimates are a few inner products with weights known in advance.
"""

from math import factorial

import numpy as np

from ddpc_cosim import FloatArray


class UltraLocalModel:
    """One such model for each of p outputs, sharing order and window.

    Parameters
    ----------
    order : int
        nu, 1 or 2.
    samples : int
        Sampling intervals in the window, at least nu.
    sampling_time : float
        Time between samples [s].
    alpha : array, shape (p, m)
        How the inputs act.
    """

    def __init__(self, order: int, samples: int, sampling_time: float, alpha: FloatArray) -> None:
        self._order, self._h, self._alpha = order, sampling_time, alpha
        # Times in samples, oldest first, 0 is now: powers of seconds can be too unlike for one matrix.
        times = -np.arange(samples, -1.0, -1.0)
        powers = np.array([times**i / factorial(i) for i in range(order + 1)]).T
        derivatives = sampling_time ** np.arange(order + 1)[:, np.newaxis]
        self._of_outputs = np.linalg.pinv(powers) / derivatives
        self._of_inputs = self._of_outputs @ _response(order, samples, sampling_time)
        self._y = np.zeros((samples + 1, len(alpha)))
        self._u = np.zeros((samples, alpha.shape[1]))

    def start(self, y: FloatArray, u: FloatArray) -> None:
        """Fill the window with a plant at rest: outputs of shape (p,), inputs of shape (m,)."""
        self._y[...] = y
        self._u[...] = u

    def append(self, u: FloatArray, y: FloatArray) -> None:
        """Take the inputs held since the last sample and the outputs now."""
        self._u[:-1] = self._u[1:]
        self._u[-1] = u
        self._y[:-1] = self._y[1:]
        self._y[-1] = y

    def estimates(self) -> FloatArray:
        """Return y, its derivatives and, in the last row, F; shape (nu + 1, p)."""
        answer: FloatArray = self._of_outputs @ self._y - self._of_inputs @ self._u @ self._alpha.T
        return answer

    def ahead(self, u: FloatArray) -> FloatArray:
        """Return the outputs that the model expects one sample later under inputs u, shape (p,)."""
        state = self.estimates()
        state[-1] += self._alpha @ u
        expected: FloatArray = sum(row * self._h**i / factorial(i) for i, row in enumerate(state))
        return expected


def _response(order: int, samples: int, h: float) -> FloatArray:
    """Return w at the times of the window for a unit input held over each interval; oldest first.

    Backwards from now, w(-tau) is the integral of -u(s) over s from -tau to 0; for order 2 of (s + tau) u(s).
    """
    response = np.zeros((samples + 1, samples))
    for back in range(1, samples + 1):
        for interval in range(back):  # from -(interval + 1) h to -interval h
            weight = -h if order == 1 else h * h * (back - interval - 0.5)
            response[samples - back, samples - 1 - interval] = weight
    return response
