"""The linearised quadruple tank of K. H. Johansson (doi:10.1109/87.845876), minimum phase, with noise."""

import numpy as np

from benchmarks.step import STEPS
from ddpc_cosim import Bounds, FloatArray, Loop, Recording, Sample, Variable

SAMPLING_TIME = 4.0
_TIME_CONSTANTS = np.array([62.0, 90.0, 23.0, 30.0])
_NOISE = 2e-3


def discrete_model() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return A, B, C over one sample; levels in cm, pumps in V, about the operating point."""
    t1, t2, t3, t4 = _TIME_CONSTANTS
    a = np.diag(-1.0 / _TIME_CONSTANTS)
    a[0, 2], a[1, 3] = 1.0 / t3, 1.0 / t4
    b = np.array([[2.6 / t1, 0.0], [0.0, 2.8 / t2], [0.0, 1.5 / t3], [1.4 / t4, 0.0]])
    # Sampled with a hold: the exponential of both at once, by its series in small pieces.
    generator = np.zeros((6, 6))
    generator[:4, :4], generator[:4, 4:] = a, b
    transition = np.linalg.matrix_power(np.eye(6) + generator * SAMPLING_TIME / 2**16, 2**16)
    return transition[:4, :4], transition[:4, 4:], 0.5 * np.eye(2, 4)


class Tanks:
    """The closed loop's plant."""

    def __init__(self, horizon: int) -> None:
        self._a, self._b, self._c = discrete_model()
        levels = np.array([[1.0, 0.5], [-0.5, 1.0], [0.8, -0.8], [0.0, 0.0]])
        self._reference = np.repeat(np.vstack([levels, levels[-1:]]), STEPS // 4, axis=0)
        self._horizon, self._k, self._state = horizon, 0, np.zeros(4)
        self._rng = np.random.default_rng(1)

    def sample(self) -> Sample:
        """Return what a controller sees now."""
        k = self._k
        y = self._c @ self._state + _NOISE * self._rng.standard_normal(2)
        return Sample(
            k, k * SAMPLING_TIME, y, y, self._reference[k + 1 : k + 1 + self._horizon], self._reference[k]
        )

    def apply(self, volts: FloatArray) -> None:
        """Hold the pumps until the next sample."""
        self._state = self._a @ self._state + self._b @ volts
        self._k += 1


def loop(samples: int) -> Loop:
    """Return the loop with a recording of random pump voltages."""
    rng = np.random.default_rng(0)
    a, b, c = discrete_model()
    u, state = rng.uniform(-1.0, 1.0, (samples, 2)), np.zeros(4)
    y = np.empty((samples, 2))
    for k in range(samples):
        y[k] = c @ state + _NOISE * rng.standard_normal(2)
        state = a @ state + b @ u[k]
    inputs, outputs = (Variable("v1", "V"), Variable("v2", "V")), (Variable("h1", "cm"), Variable("h2", "cm"))
    bounds = Bounds(np.full(2, -1.0), np.full(2, 1.0), np.full(2, -np.inf), np.full(2, np.inf))
    recording = Recording(u, y, y, SAMPLING_TIME)
    return Loop(SAMPLING_TIME, inputs, outputs, outputs, bounds, recording, np.random.default_rng(0))
