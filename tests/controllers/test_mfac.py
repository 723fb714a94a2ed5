"""MFAC in its three forms against the laws of the book, and in closed loops."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from ddpc_controllers.mfac import MFAC
from ddpc_cosim import FloatArray, Sample

from .loops import (
    ANGLE,
    DEGREE,
    LinearPlant,
    close_loop,
    make_loop,
    paper_reference,
    pendulum_loop,
    quick_pendulum,
    together_and_alone,
)

FREE = np.array([np.inf])


class Law:
    """Hou and Jin's law for one input and one output, all step factors equal; estimation (16)-(17)."""

    def __init__(self, ly: int, lu: int, rho: float, lambda_u: float) -> None:
        self.ly, self.lu, self.rho, self.lambda_u = ly, lu, rho, lambda_u
        self.phi_1 = np.zeros(ly + lu)
        self.phi_1[ly] = 0.1
        self.phi = self.phi_1
        self.y = self.u = 0.0
        self.dy, self.du = [0.0] * 9, [0.0] * 9  # newest last

    def step(self, y: float, target: float) -> float:
        h = np.array(self.dy[: -self.ly - 1 : -1] + self.du[: -self.lu - 1 : -1])
        change = y - self.y
        phi = self.phi + h / (1.0 + h @ h) * (change - self.phi @ h)
        direct = phi[self.ly]
        short = np.linalg.norm(phi[self.ly :]) < 1e-5
        self.phi = self.phi_1 if np.linalg.norm(h) <= 1e-5 or direct <= 0.0 or short else phi
        self.y = y
        self.dy.append(change)
        direct = self.phi[self.ly]
        outputs = sum(self.phi[i] * self.dy[-1 - i] for i in range(self.ly))
        inputs = sum(self.phi[self.ly + i] * self.du[-i] for i in range(1, self.lu))
        du = self.rho * direct * (target - y - outputs - inputs) / (self.lambda_u + direct**2)
        self.du.append(du)
        self.u += du
        return float(self.u)


@settings(deadline=None)
@given(
    st.sampled_from([("cfdl", 0, 1), ("pfdl", 0, 3), ("ffdl", 2, 3)]),
    st.floats(0.1, 1.0),
    st.lists(st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)), min_size=1, max_size=12),
)
def test_every_step_is_that_of_the_book(
    form: tuple[str, int, int], rho: float, samples: list[tuple[float, float]]
) -> None:
    name, ly, lu = form
    controller = MFAC(form=name, output_length=2, input_length=3, step_factor=rho)
    controller.start(make_loop(None, FREE, FREE))
    law = Law(ly, lu, rho, 0.37)
    # A first sample of 0: whatever comes before it was at rest.
    for k, (y, target) in enumerate([(0.0, 0.0), *samples]):
        measured = np.array([y])
        u = controller.step(Sample(k, 0.1 * k, measured, measured, np.array([[target]])))
        assert u == pytest.approx([law.step(y, target)], rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("form", ["cfdl", "pfdl", "ffdl"])
def test_it_ends_at_its_reference(form: str) -> None:
    controller = MFAC(form=form, lambda_u=0.1, step_factor=1.0)
    run = close_loop(controller, pendulum_loop(None), quick_pendulum, ANGLE, paper_reference())
    error = np.abs(run.y - run.reference[: len(run.y)])[[99, 199, 299, 399], 0] / DEGREE
    assert error.max() < 0.1


def test_two_inputs_minimise_the_cost_of_the_next_sample() -> None:
    gradient: FloatArray = np.array([[0.5, 0.2], [-0.1, 0.4]])
    controller = MFAC(initial_gradient=gradient.tolist(), lambda_u=0.3, step_factor=1.0)
    controller.start(make_loop(None, np.repeat(FREE, 2), np.repeat(FREE, 2)))
    error = np.array([1.0, -0.7])
    u = controller.step(Sample(0, 0.0, np.zeros(2), np.zeros(2), error[np.newaxis]))
    weights = np.vstack([gradient, np.sqrt(0.3) * np.eye(2)])
    assert u == pytest.approx(np.linalg.lstsq(weights, np.append(error, [0.0, 0.0]))[0])


def test_a_gradient_that_drowns_the_weight_of_the_inputs_still_gives_the_least_change() -> None:
    # lambda_u is below the rounding of |Phi|^2: as for lambda_u = 0, with the smallest of the optima.
    controller = MFAC(initial_gradient=[[3e8, 4e8]], step_factor=1.0)
    controller.start(make_loop(None, np.repeat(FREE, 2), FREE))
    u = controller.step(Sample(0, 0.0, np.zeros(1), np.zeros(1), np.ones((1, 1))))
    assert u == pytest.approx([3e8 / 25e16, 4e8 / 25e16], rel=1e-7)


def test_a_diagonal_structure_is_one_loop_for_each_pair() -> None:
    gains, plants = np.array([0.2, -0.5]), [LinearPlant.lag(0.9, 0.2), LinearPlant.lag(0.6, -0.5)]
    both, alone = together_and_alone(
        lambda chosen: MFAC(structure="diagonal", initial_gradient=gains[chosen].tolist()),
        plants,
        1.0,
        np.tile([[1.0, -0.5]], (61, 1)),
        60,
    )
    assert np.abs(both - alone).max() < 1e-12


def test_the_limits_of_input_and_rate_hold() -> None:
    controller = MFAC(lambda_u=0.01, step_factor=1.0, rate_bounds=0.2)
    run = close_loop(controller, pendulum_loop(None, 1.0), quick_pendulum, ANGLE, paper_reference())
    assert np.abs(run.u).max() == 1.0
    assert np.abs(np.diff(run.u, axis=0)).max() <= 0.2 + 1e-15
