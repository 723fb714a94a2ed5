"""The paper's pendulum, experiment and reference, stepped fast enough to stay out of the measurements."""

import math
from typing import Any

import numpy as np

from ddpc_cosim import Bounds, FloatArray, Loop, Recording, Sample, Variable

SAMPLING_TIME = 0.1
STEPS = 400
PRINTED: dict[str, Any] = {"regulariser": "ridge", "terminal_equality": True}
"""DeePC's settings for the printed problem (8)."""
_SUBSTEPS = 20
_DEGREE = math.pi / 180.0


def advance(angle: float, velocity: float, torque: float) -> tuple[float, float]:
    """Hold the torque over one sample of (22); classical Runge-Kutta."""

    def slope(angle: float, velocity: float) -> tuple[float, float]:
        return velocity, -9.81 / 0.2 * math.sin(angle) - 0.4 / 0.2 * velocity + torque / 0.2

    h = SAMPLING_TIME / _SUBSTEPS
    for _ in range(_SUBSTEPS):
        a1, v1 = slope(angle, velocity)
        a2, v2 = slope(angle + h / 2 * a1, velocity + h / 2 * v1)
        a3, v3 = slope(angle + h / 2 * a2, velocity + h / 2 * v2)
        a4, v4 = slope(angle + h * a3, velocity + h * v3)
        angle += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        velocity += h / 6 * (v1 + 2 * v2 + 2 * v3 + v4)
    return angle, velocity


def experiment(samples: int, seed: int = 5489) -> Recording:
    """Record the pendulum under uniform torque in +-3.5 N m, from rest."""
    torque = 3.5 * (2.0 * np.random.RandomState(seed).random_sample(samples) - 1.0)
    angle, velocity = 0.0, 0.0
    angles = np.empty((samples, 1))
    for k in range(samples):
        angles[k] = angle
        angle, velocity = advance(angle, velocity, float(torque[k]))
    return Recording(torque[:, np.newaxis], angles, angles, SAMPLING_TIME)


def loop(recording: Recording, torque_limit: float) -> Loop:
    """Return the loop of the paper's comparison with a torque limit of one's own."""
    limit, angle_limit = np.array([torque_limit]), np.array([70.0 * _DEGREE])
    angle = (Variable("angle", "rad"),)
    bounds = Bounds(-limit, limit, -angle_limit, angle_limit)
    inputs = (Variable("torque", "N.m"),)
    return Loop(SAMPLING_TIME, inputs, angle, angle, bounds, recording, np.random.default_rng(0))


class Pendulum:
    """The closed loop's plant: gives samples, takes torques."""

    def __init__(self, horizon: int) -> None:
        steps = np.repeat(np.array([20.0, -10.0, 10.0, -20.0]) * _DEGREE, STEPS // 4)
        self._reference = np.concatenate([steps, np.full(horizon + 1, steps[-1])])[:, np.newaxis]
        self._horizon = horizon
        self._state = (0.0, 0.0)
        self._k = 0

    def sample(self) -> Sample:
        """Return what a controller sees now."""
        k, y = self._k, np.array([self._state[0]])
        return Sample(
            k, k * SAMPLING_TIME, y, y, self._reference[k + 1 : k + 1 + self._horizon], self._reference[k]
        )

    def apply(self, torque: FloatArray) -> None:
        """Hold the torque until the next sample."""
        self._state = advance(*self._state, float(torque[0]))
        self._k += 1
