"""Eight systems with noise: what is identified predicts nearly as well as an estimate of the true structure.

The oracle knows each system's structure and starts at its true coefficients; scipy minimises the one-step
errors of difference equations. Both are judged on data that neither has seen.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter

from ddpc_cosim import FloatArray, Recording
from ddpc_cosim.identification.candidates import candidates, squares_ahead
from ddpc_cosim.identification.innovation import InnovationModel, StaticMap

ROWS = 1500
HORIZON = 20
SHARE = 0.95

Valve = Callable[[FloatArray, float], FloatArray]


def linear(u: FloatArray, _: float) -> FloatArray:
    return u


def equal_percentage(u: FloatArray, rangeability: float) -> FloatArray:
    return np.asarray(rangeability ** (u - 1.0))


@dataclass(frozen=True)
class System:
    """``A y = B valve(u) + C eps`` with polynomials in the delay; C = A is noise of the measurement."""

    b: tuple[float, ...]
    poles: tuple[float, ...]
    noise: float
    zeros_of_noise: tuple[float, ...] | None = None
    dead_time: int = 0
    hold: int = 6
    valve: Valve = linear
    shape: float = 0.0
    feedback: float = 0.0
    levels: tuple[float, float] = (-1.0, 1.0)

    @property
    def theta(self) -> FloatArray:
        """True coefficients: a, b, c where the noise has zeros of its own, the valve's where there is one."""
        c = () if self.zeros_of_noise is None else tuple(np.poly(self.zeros_of_noise)[1:])
        shape = (self.shape,) if self.shape else ()
        return np.array([*np.poly(self.poles)[1:], *self.b, *c, *shape])

    def polynomials(self, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """Return A, B, C and the valve's coefficient."""
        shape, theta = (theta[-1], theta[:-1]) if self.shape else (0.0, theta)
        n, m = len(self.poles), len(self.b)
        a = np.concatenate([[1.0], theta[:n]])
        c = a if self.zeros_of_noise is None else np.concatenate([[1.0], theta[n + m :]])
        return a, np.concatenate([np.zeros(1 + self.dead_time), theta[n : n + m]]), c, float(shape)

    def recorded(self, rng: np.random.Generator) -> Recording:
        """Return data, of a closed loop where there is feedback."""
        a, b, c, shape = self.polynomials(self.theta)
        low, high = self.levels
        excitation = np.repeat(rng.uniform(low, high, ROWS // self.hold + 1), self.hold)[:ROWS]
        eps = self.noise * rng.standard_normal(ROWS)
        if not self.feedback:
            u = excitation
            y = lfilter(b, a, self.valve(u, shape)) + lfilter(c, a, eps)
        else:
            u, y = np.zeros(ROWS), np.zeros(ROWS)
            for k in range(ROWS):
                past = range(1, min(k, len(b) - 1) + 1)
                y[k] = sum(b[i] * u[k - i] for i in past) - sum(a[i] * y[k - i] for i in past if i < len(a))
                y[k] += sum(c[i] * eps[k - i] for i in range(min(k, len(c) - 1) + 1))
                u[k] = 0.5 * excitation[k] - self.feedback * y[k]
        columns = u[:, np.newaxis], y[:, np.newaxis]
        return Recording(*columns, columns[1], 1.0)

    def estimate(self, data: Recording) -> InnovationModel:
        """Return the estimate of the true structure, in observer form."""
        u, y = data.u[:, 0], data.y[:, 0]

        def errors(theta: FloatArray) -> FloatArray:
            a, b, c, shape = self.polynomials(theta)
            return np.asarray(lfilter(a, c, y) - lfilter(b, c, self.valve(u, shape)))

        best = least_squares(errors, self.theta, x_scale="jac").x
        a, b, c, shape = self.polynomials(best)
        n = max(len(a), len(b), len(c)) - 1
        a, b, c = (np.pad(polynomial, (0, n + 1 - len(polynomial)))[1:] for polynomial in (a, b, c))
        shift = np.eye(n, k=1)
        shift[:, 0] = -a
        offsets = np.zeros(1), np.zeros(1), np.zeros(0)
        matrices = shift, b[:, np.newaxis], np.zeros((n, 0)), (c - a)[:, np.newaxis], np.eye(1, n)
        model = InnovationModel(*matrices, *offsets, np.eye(1), 1.0, "oracle")
        if not self.shape:
            return model
        points = np.linspace(*self.levels, 200)
        return replace(model, input_map=StaticMap((points,), (self.valve(points, shape),)))


class Tanks:
    """Four tanks, of which the upper two empty into the lower two: two inputs, two outputs.

    theta: how much stays in tanks 1 ... 4, and what comes into each; what leaves an upper one comes below.
    """

    theta = np.array([0.95, 0.93, 0.9, 0.88, 0.08, 0.07, 0.1, 0.09])
    noise = 0.05

    def outputs(self, u: FloatArray, theta: FloatArray) -> FloatArray:
        """Return the levels of the lower tanks without noise, shape (T, 2)."""
        stays, gains = theta[:4], theta[4:]
        inflows = (0, 1, 1, 0)
        first = [
            lfilter([0.0, gain], [1.0, -stay], u[:, i])
            for stay, gain, i in zip(stays, gains, inflows, strict=True)
        ]
        below = [lfilter([0.0, 1.0 - stays[2 + i]], [1.0, -stays[i]], first[2 + i]) for i in range(2)]
        return np.column_stack([first[0] + below[0], first[1] + below[1]])

    def recorded(self, rng: np.random.Generator) -> Recording:
        """Return data of independent steps of both inputs."""
        u = np.repeat(rng.uniform(-1.0, 1.0, (ROWS // 10 + 1, 2)), 10, axis=0)[:ROWS]
        y = self.outputs(u, self.theta) + self.noise * rng.standard_normal((ROWS, 2))
        return Recording(u, y, y, 1.0)

    def estimate(self, data: Recording) -> InnovationModel:
        """Return the estimate of the true structure."""
        best = least_squares(lambda theta: (self.outputs(data.u, theta) - data.y).ravel(), self.theta).x
        a = np.diag(best[:4])
        a[0, 2], a[1, 3] = 1.0 - best[2], 1.0 - best[3]
        b = np.zeros((4, 2))
        b[[0, 1, 2, 3], [0, 1, 1, 0]] = best[4:]
        offsets = np.zeros(2), np.zeros(2), np.zeros(0)
        return InnovationModel(
            a, b, np.zeros((4, 0)), np.zeros((4, 2)), np.eye(2, 4), *offsets, np.eye(2), 1.0, "oracle"
        )


SLOW, FAST = 0.9, 0.75
SYSTEMS = {
    "second order": System((0.03, 0.02), (SLOW, FAST), 0.05),
    "dead time": System((0.03, 0.02), (SLOW, FAST), 0.05, dead_time=12),
    "non-minimum phase": System((-0.04, 0.09), (SLOW, FAST), 0.05),
    "integrating": System((0.02, 0.015), (1.0, 0.7), 0.1, zeros_of_noise=(0.6, 0.5)),
    "coloured noise": System((0.03, 0.02), (SLOW, FAST), 0.05, zeros_of_noise=(0.5, -0.6)),
    "unstable in closed loop": System(
        (0.1, 0.05), (1.06, 0.6), 0.05, zeros_of_noise=(0.6, 0.3), feedback=1.2
    ),
    "valve": System((0.3, 0.2), (SLOW, FAST), 0.05, valve=equal_percentage, shape=20.0, levels=(0.0, 1.0)),
    "tanks": Tanks(),
}


def fit_of(model: InnovationModel, data: Recording) -> float:
    """Return 100 (1 - error / standard deviation) over the horizon, the mean of the outputs."""
    error = np.sqrt(squares_ahead(model, data, HORIZON).mean(axis=(0, 1)))
    return float(np.mean(100.0 * (1.0 - error / data.y.std(axis=0))))


@pytest.mark.slow
@pytest.mark.parametrize("name", SYSTEMS)
def test_a_system_is_found_as_well_as_its_true_structure_allows(name: str) -> None:
    system = SYSTEMS[name]
    data, unseen = system.recorded(np.random.default_rng(1)), system.recorded(np.random.default_rng(2))
    oracle = fit_of(system.estimate(data), unseen)
    assert fit_of(candidates(data)[0].model, unseen) >= SHARE * oracle > 0.0
