"""The ridge is min-max DeePC: the best plan against the worst data within a distance of the recorded ones."""

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize

from ddpc_controllers import DeePC
from ddpc_controllers.data.hankel import hankel_matrix
from ddpc_cosim import Action, FloatArray, Recording, Sample

from .loops import LinearPlant, experiment, make_loop

PAST, HORIZON, Q, R = 2, 4, 10.0, 0.5
PLANT = LinearPlant(np.array([[0.8, 0.3], [-0.2, 0.6]]), np.array([[0.5], [1.0]]), np.array([[1.0, 0.2]]))
Y_NOW, REFERENCE = 0.3, 1.0


class MinMax:
    """``min_g max |(M + D) g - b - d|`` over ``|(D, d)|_F <= rho``, the past met exactly.

    M stacks the weighed predicted outputs and inputs of all windows, b is what they are to be.
    """

    def __init__(self, u: FloatArray, y: FloatArray) -> None:
        u_rows, y_rows = hankel_matrix(u, PAST + HORIZON), hankel_matrix(y, PAST + HORIZON)
        self.m = np.vstack([Q**0.5 * y_rows[PAST:], R**0.5 * u_rows[PAST:]])
        self.b = np.r_[np.full(HORIZON, Q**0.5 * REFERENCE), np.zeros(HORIZON)]
        past = np.vstack([u_rows[:PAST], y_rows[:PAST]])
        self.first_input = u_rows[PAST]
        self._one = np.linalg.pinv(past) @ np.r_[np.zeros(PAST), np.full(PAST, Y_NOW)]
        self._free = scipy.linalg.null_space(past)

    def worst(self, g: FloatArray, rho: float) -> float:
        """Return the maximum: L. El Ghaoui, H. Lebret, SIAM J. Matrix Anal. Appl. 18(4), 1997, section 3."""
        return float(np.linalg.norm(self.m @ g - self.b) + rho * np.sqrt(g @ g + 1.0))

    def solution(self, rho: float) -> FloatArray:
        """Return the best g, found without a thought for a ridge."""

        def slope(w: FloatArray) -> FloatArray:
            g = self._one + self._free @ w
            left = self.m @ g - self.b
            of_g = self.m.T @ left / np.linalg.norm(left) + rho * g / np.sqrt(g @ g + 1.0)
            return np.asarray(self._free.T @ of_g)

        found = scipy.optimize.minimize(
            lambda w: self.worst(self._one + self._free @ w, rho),
            np.zeros(self._free.shape[1]),
            jac=slope,
            method="BFGS",
            options={"gtol": 1e-9, "maxiter": 5000},
        )
        assert np.linalg.norm(slope(found.x)) < 1e-6
        return np.asarray(self._one + self._free @ found.x)


@pytest.fixture(scope="module")
def recorded() -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(5)
    clean = experiment(PLANT.advance, rng.uniform(-1.0, 1.0, (50, 1)), 2, PLANT.c)
    return clean.u, clean.y + 0.05 * rng.standard_normal(clean.y.shape)


@pytest.mark.parametrize("rho", [0.5, 1.0, 4.0])
def test_the_ridge_of_the_right_weight_does_what_is_best_against_the_worst_data(
    rho: float, recorded: tuple[FloatArray, FloatArray]
) -> None:
    problem = MinMax(*recorded)
    g = problem.solution(rho)
    weight = rho * np.linalg.norm(problem.m @ g - problem.b) / np.sqrt(g @ g + 1.0)
    controller = DeePC(
        regulariser="ridge",
        lambda_g=float(weight),
        slack=False,
        artificial_setpoint=False,
        initial_length=PAST,
        horizon=HORIZON,
        output_weight=Q,
        input_weight=R,
    )
    u, y = recorded
    controller.start(make_loop(Recording(u, y, y, 0.1), np.full(1, np.inf), np.full(1, np.inf)))
    reference, now = np.full((HORIZON, 1), REFERENCE), np.array([Y_NOW])
    answer = controller.step(Sample(0, 0.0, now, now, reference, reference[0]))
    applied = answer.u if isinstance(answer, Action) else answer
    assert applied[0] == pytest.approx(problem.first_input @ g, abs=1e-5)


def test_the_worst_data_are_data_and_no_others_are_worse(recorded: tuple[FloatArray, FloatArray]) -> None:
    problem, rho, rng = MinMax(*recorded), 0.7, np.random.default_rng(0)
    g = problem.solution(rho)
    extended, left = np.r_[g, -1.0], problem.m @ g - problem.b
    worst = rho * np.outer(left / np.linalg.norm(left), extended / np.linalg.norm(extended))
    reached = np.linalg.norm(np.column_stack([problem.m, problem.b]) @ extended + worst @ extended)
    assert reached == pytest.approx(problem.worst(g, rho), rel=1e-12)
    for _ in range(200):
        other = rng.standard_normal(worst.shape)
        other *= rho / np.linalg.norm(other)
        beside = np.linalg.norm(left + other @ extended)
        assert beside <= reached
