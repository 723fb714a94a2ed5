"""SPSA: the steps of the algorithm, and gains that it makes stabilising."""

from dataclasses import replace

import numpy as np
import pytest

from ddpc_controllers.spsa import SPSA
from ddpc_cosim import ConfigError, FloatArray, Sample

from .loops import LinearPlant, close_loop, make_loop

FREE = np.array([np.inf])
# A mass pushed away from its equilibrium, y'' = 4 y + 4 u every 0.1 s: u = -k y holds it only for k > 1.
UNSTABLE = LinearPlant(
    np.array([[np.cosh(0.2), np.sinh(0.2) / 2], [2 * np.sinh(0.2), np.cosh(0.2)]]),
    np.array([[np.cosh(0.2) - 1.0], [2 * np.sinh(0.2)]]),
    np.array([[1.0, 0.0]]),
)
PULSE = np.concatenate([np.full((3, 1), 0.05), np.zeros((398, 1))])


def outputs(controller: SPSA, seed: int = 0) -> FloatArray:
    """Return the outputs after a short pulse of the reference."""
    loop = make_loop(None, 10.0 * np.ones(1), FREE, rng=np.random.default_rng(seed))
    return close_loop(controller, loop, UNSTABLE.advance, UNSTABLE.c, PULSE).y[:, 0]


@pytest.mark.parametrize("seed", range(5))
def test_gains_that_do_not_stabilise_are_made_to(seed: int) -> None:
    held = outputs(SPSA(kp=0.95, kd=0.3, step_size=0.0, perturbation=1e-9), seed)
    tuned = outputs(SPSA(kp=0.95, kd=0.3), seed)
    assert np.abs(held).max() > 1.0
    assert np.abs(tuned).max() < 1.0
    assert np.abs(tuned[-50:]).max() < 0.01


def test_one_iteration_is_that_of_the_algorithm() -> None:
    settings = {"kp": 2.0, "kd": 0.5, "window": 2, "step_size": 0.4, "stability": 3.0, "largest_step": 9.0}
    controller = SPSA(**settings)
    rng = np.random.default_rng(5)
    controller.start(make_loop(None, FREE, FREE, rng=np.random.default_rng(5)))
    signs = rng.spawn(1)[0].choice([-1.0, 1.0], 2)
    errors = np.array([1.0, 0.8, 0.7, 0.9, 1.1])
    rates = np.diff(errors, prepend=errors[0]) / 0.1
    for k, error in enumerate(errors):
        y = np.array([-error])
        answer = controller.step(Sample(k, 0.1 * k, y, y, np.zeros((1, 1)), np.zeros(1)))
        if k < 4:
            side = 1.0 if k < 2 else -1.0
            gains = np.array([2.0, 0.5]) * (1.0 + side * 0.2 * signs)
            assert answer.u == pytest.approx([gains @ (error, rates[k])])
    energy = errors**2 + (0.2 * rates) ** 2 + 1e-6
    slope = (np.log(energy[2] / energy[0]) - np.log(energy[4] / energy[2])) / (2 * 0.2) * signs
    expected = np.array([2.0, 0.5]) * (1.0 - 0.4 / 4.0**0.602 * slope)
    assert [answer.info["kp[0]"], answer.info["kd[0]"]] == pytest.approx(expected)


def test_a_gain_of_zero_stays_zero() -> None:
    controller = SPSA(kp=1.5)
    outputs(controller)
    answer = controller.step(Sample(400, 40.0, np.zeros(1), np.zeros(1), np.zeros((1, 1)), np.zeros(1)))
    assert answer.info["kd[0]"] == 0.0  # type: ignore[union-attr]


def test_another_seed_tries_other_gains_and_the_same_one_the_same() -> None:
    controller = SPSA(kp=1.2, kd=0.3)
    assert np.array_equal(outputs(controller, 1), outputs(controller, 1))
    assert not np.array_equal(outputs(controller, 1), outputs(controller, 2))


def test_two_pairs_are_two_loops() -> None:
    a, b = np.diag([1.02, 0.9]), np.diag([0.2, 0.3])
    reference = np.tile([[0.5, -1.0]], (201, 1))
    gains, limit = [1.0, 0.7], np.full(2, 5.0)
    both = close_loop(
        SPSA(kp=gains, integral_time=2.0),
        make_loop(None, limit, limit),
        LinearPlant(a, b, np.eye(2)).advance,
        np.eye(2),
        reference,
        200,
    )
    for i in range(2):
        rng = np.random.default_rng(0)
        rng.spawn(i)  # the streams of the pairs before it
        alone = close_loop(
            SPSA(kp=gains[i], integral_time=2.0),
            make_loop(None, limit[:1], limit[:1], rng=rng),
            LinearPlant(a[i : i + 1, i : i + 1], b[i : i + 1, i : i + 1], np.eye(1)).advance,
            np.eye(1),
            reference[:, i : i + 1],
            200,
        )
        assert np.abs(both.u[:, i] - alone.u[:, 0]).max() < 1e-12


def test_more_inputs_than_outputs_are_refused() -> None:
    loop = make_loop(None, np.ones(2), np.ones(1))
    with pytest.raises(ConfigError, match="there are 2 inputs and 1 outputs"):
        SPSA().start(replace(loop))


def test_gains_for_other_than_all_pairs_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"kp has shape \(3,\); needed: a number or 2 numbers"):
        SPSA(kp=[1.0, 2.0, 3.0]).start(make_loop(None, np.ones(2), np.ones(2)))
