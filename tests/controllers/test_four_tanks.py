"""DeePC on the linear four tanks of Berberich et al. with noise: what its regularisers leave at rest.

The plant is that of J. Berberich, J. Koehler, M. A. Mueller, F. Allgoewer, Data-driven model predictive
control with stability and robustness guarantees, IEEE TAC 66(4), 2021, arXiv:1906.04679, section V, and of
the package direct-data-driven-mpc: setpoint (0.65, 0.77), inputs of the experiment in [-1, 1], noise in
[-0.002, 0.002].
"""

from typing import Any

import numpy as np
import pytest

from ddpc_controllers import DeePC
from ddpc_cosim import Action, FloatArray, Recording, Sample

from .loops import LinearPlant, make_loop, printed_deepc

PLANT = LinearPlant(
    np.array([[0.921, 0, 0.041, 0], [0, 0.918, 0, 0.033], [0, 0, 0.924, 0], [0, 0, 0, 0.937]]),
    np.array([[0.017, 0.001], [0.001, 0.023], [0, 0.061], [0.072, 0]]),
    np.eye(2, 4),
)
SETPOINT = np.array([0.65, 0.77])
NOISE = 0.002
SETTINGS: dict[str, Any] = {
    "initial_length": 4,
    "horizon": 30,
    "output_weight": 3.0,
    "input_weight": 1e-4,
    "setpoint_weight": 20.0,
    "lambda_sigma": 1e3,
    "lambda_g": 10.0,
}


def noisy_experiment(samples: int, seed: int) -> Recording:
    """Record the plant from rest, its outputs with noise."""
    rng = np.random.default_rng(seed)
    u, y, state = rng.uniform(-1.0, 1.0, (samples, 2)), np.zeros((samples, 2)), np.zeros(4)
    for k in range(samples):
        y[k] = PLANT.c @ state + NOISE * rng.uniform(-1.0, 1.0, 2)
        state = PLANT.advance(state, u[k])
    return Recording(u, y, y, 0.1)


def errors(controller: DeePC, recorded: int, seed: int, steps: int) -> FloatArray:
    """Return what the outputs, without their noise, are off the setpoint: shape (steps, 2)."""
    loop = make_loop(noisy_experiment(recorded, seed), np.full(2, 4.0), np.full(2, np.inf))
    controller.start(loop)
    rng, state = np.random.default_rng(seed + 1000), np.zeros(4)
    reference, off = np.tile(SETPOINT, (controller.horizon, 1)), np.zeros((steps, 2))
    for k in range(steps):
        off[k] = PLANT.c @ state - SETPOINT
        y = PLANT.c @ state + NOISE * rng.uniform(-1.0, 1.0, 2)
        answer = controller.step(Sample(k, 0.1 * k, y, y, reference, SETPOINT))
        assert isinstance(answer, Action)
        assert answer.status == "ok"
        state = PLANT.advance(state, answer.u)
    return off


def settled(off: FloatArray, first: int, end: int) -> float:
    """Return the larger magnitude of both outputs' mean error over a stretch."""
    return float(np.abs(off[first:end].mean(axis=0)).max())


@pytest.mark.parametrize(("recorded", "seed"), [(150, 0), (200, 1), (600, 2)])
def test_about_the_equilibrium_less_error_is_left_than_with_the_ridge(recorded: int, seed: int) -> None:
    left = {
        name: settled(errors(printed_deepc(regulariser=name, **SETTINGS), recorded, seed, 150), 100, 150)
        for name in ("ridge", "equilibrium")
    }
    assert left["equilibrium"] < 0.5 * left["ridge"]


def test_about_the_equilibrium_nothing_drifts_in_2000_samples() -> None:
    settings = SETTINGS | {"horizon": 20}
    off = errors(printed_deepc(regulariser="equilibrium", **settings), 400, 0, 2000)
    ends = np.array([settled(off, last - 100, last) for last in range(300, 2001, 100)])
    assert ends.max() < 0.002
    assert abs(ends[-1] - ends[0]) < 1e-3
    assert np.abs(off[200:]).max() < 0.01


def test_without_noise_the_equilibrium_leaves_no_error_at_all() -> None:
    rng = np.random.default_rng(3)
    states = np.zeros((400, 4))
    u = rng.uniform(-1.0, 1.0, (400, 2))
    for k in range(1, 400):
        states[k] = PLANT.advance(states[k - 1], u[k - 1])
    y = states @ PLANT.c.T
    loop = make_loop(Recording(u, y, y, 0.1), np.full(2, 4.0), np.full(2, np.inf))
    controller = printed_deepc(regulariser="equilibrium", **SETTINGS | {"horizon": 20})
    controller.start(loop)
    state = np.zeros(4)
    for k in range(300):
        now = PLANT.c @ state
        answer = controller.step(Sample(k, 0.1 * k, now, now, np.tile(SETPOINT, (20, 1)), SETPOINT))
        assert isinstance(answer, Action)
        assert answer.status == "ok"
        state = PLANT.advance(state, answer.u)
    assert PLANT.c @ state == pytest.approx(SETPOINT, abs=1e-6)
