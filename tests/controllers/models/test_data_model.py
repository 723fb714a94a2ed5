"""The data model's estimation (16), resets (17) and forecast (18) against the formulas."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from ddpc_controllers.models.data_model import DataModel, Estimation, Form, PseudoGradient, Regressor
from ddpc_controllers.models.data_model_prediction import Forecast, GradientForecast
from ddpc_cosim import ConfigError, FloatArray, Recording

TABLE_2 = Estimation(eta=1.0, mu=1.0, epsilon=1e-5)
FORECAST = Forecast(delta=0.5, theta_0=0.175, n_m=4, theta_limit=2.0)

changes = st.floats(-3.0, 3.0) | st.sampled_from([0.0, 1e-6, -1e-5])


class Formulas:
    """(16)-(18) for one output, as printed, with a vector of coefficients."""

    def __init__(self, phi_1: FloatArray, output_terms: int) -> None:
        self.phi_1, self.ly = phi_1, output_terms
        self.phi = [phi_1] * 5
        self.theta = np.full((len(phi_1), 4), 0.175)

    def is_reset(self, phi: FloatArray) -> bool:
        short = np.linalg.norm(phi[self.ly :]) < 1e-5
        return bool(short or np.sign(phi[self.ly]) != np.sign(self.phi_1[self.ly]))

    def update(self, dy: float, h: FloatArray) -> None:
        phi = self.phi[-1] + h / (1.0 + h @ h) * (dy - self.phi[-1] @ h)
        if np.linalg.norm(h) <= 1e-5 or self.is_reset(phi):
            phi = self.phi_1
        past = np.array(self.phi[: -4 - 1 : -1])
        for i, theta in enumerate(self.theta):
            theta += past[:, i] / (0.5 + past[:, i] @ past[:, i]) * (phi[i] - past[:, i] @ theta)
            if np.linalg.norm(theta) >= 2.0:
                theta[:] = 0.175
        self.phi.append(phi)

    def ahead(self, steps: int) -> FloatArray:
        phi = list(self.phi)
        for _ in range(steps - 1):
            past = np.array(phi[: -4 - 1 : -1])
            predicted = np.einsum("in,ni->i", self.theta, past)
            phi.append(self.phi_1 if self.is_reset(predicted) else predicted)
        return np.array(phi[-steps:])


@settings(deadline=None)
@given(
    st.sampled_from([(0, 1), (0, 3), (1, 2), (2, 1)]),
    st.sampled_from([0.1, -0.5, 2.0]),
    st.data(),
)
def test_estimate_and_forecast_are_those_of_the_formulas(
    lengths: tuple[int, int], direct: float, data: st.DataObject
) -> None:
    ly, lu = lengths
    phi_1 = np.zeros(ly + lu)
    phi_1[ly] = direct
    history = data.draw(st.lists(st.lists(changes, min_size=ly + lu + 1, max_size=ly + lu + 1), max_size=12))
    gradient = PseudoGradient(phi_1.tolist(), Regressor((0,), (0,), ly, lu), TABLE_2)
    forecast, formulas = GradientForecast(gradient, FORECAST), Formulas(phi_1, ly)
    for dy, *h in history:
        gradient.update(dy, h)
        forecast.update()
        formulas.update(dy, np.array(h))
    assert gradient.value == pytest.approx(formulas.phi[-1].tolist(), rel=1e-9, abs=1e-12)
    ahead = np.reshape(forecast.ahead(5), (5, ly + lu))
    assert ahead == pytest.approx(formulas.ahead(5), rel=1e-9, abs=1e-12)


@settings(deadline=None)
@given(st.lists(st.tuples(changes, changes), min_size=1, max_size=12))
def test_the_direction_of_control_never_changes(history: list[tuple[float, float]]) -> None:
    gradient = PseudoGradient([0.1], Regressor((0,), (0,), 0, 1), TABLE_2)
    forecast = GradientForecast(gradient, FORECAST)
    for dy, du in history:
        gradient.update(dy, [du])
        forecast.update()
        assert min(forecast.ahead(5)) >= 1e-5


def unassuming(initial: float) -> PseudoGradient:
    """Return a gradient that may change its sign."""
    constants = Estimation(eta=1.0, mu=0.01, epsilon=1e-5, assume_sign=False)
    return PseudoGradient([initial], Regressor((0,), (0,), 0, 1), constants)


def test_without_the_assumption_the_sign_follows_the_data() -> None:
    gradient = unassuming(0.1)
    for _ in range(20):
        gradient.update(-0.5, [1.0])
    assert gradient.value == pytest.approx([-0.5], rel=1e-6)


def test_without_the_assumption_a_quiet_loop_keeps_what_it_knows() -> None:
    gradient = unassuming(0.1)
    gradient.update(-0.5, [1.0])
    known = gradient.value
    gradient.update(0.3, [0.0])
    assert gradient.value == known


def test_without_the_assumption_a_vanishing_gradient_is_reset_with_its_own_sign() -> None:
    gradient = unassuming(0.1)
    assert gradient.plausible([-1e-7]) == [-0.1]
    assert gradient.plausible([1e-7]) == [0.1]


def test_an_input_of_unknown_direction_may_take_any_sign() -> None:
    gradient = PseudoGradient([0.5, 0.0], Regressor((0,), (0, 1), 0, 1), TABLE_2)
    gradient.update(-1.0, [0.0, 1.0])
    assert gradient.value == pytest.approx([0.5, -0.5])


def test_one_input_is_reset_without_the_other() -> None:
    gradient = PseudoGradient([0.5, 0.0, 0.4, 0.1], Regressor((0, 1), (0, 1), 1, 1), TABLE_2)
    # Coefficients: two outputs, two inputs; the second input has turned round.
    assert gradient.plausible([0.7, 0.2, 0.6, -0.2]) == [0.5, 0.0, 0.6, 0.1]


@pytest.mark.parametrize(
    ("given_gradient", "row"),
    [
        (0.1, [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]),
        ([0.1, 0.2], [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]),
        ([[0.1, 0.3], [0.0, 0.2]], [0.0, 0.0, 0.1, 0.3, 0.0, 0.0]),
        ([[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]] * 2, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
    ],
)
def test_the_initial_gradient_may_be_given_in_four_ways(given_gradient: object, row: list[float]) -> None:
    form = Form(2, 2, output_length=1, input_length=2)
    assert form.initial_gradients(given_gradient)[0].tolist() == row  # type: ignore[arg-type]


def test_an_initial_gradient_of_the_wrong_shape_is_told_the_right_ones() -> None:
    with pytest.raises(ConfigError, match=r"has shape \(1, 2\); .* 2 numbers, 2 x 2 .*, or 2 x 6"):
        Form(2, 2, output_length=1, input_length=2).initial_gradients([[0.1, 0.2]])


def test_a_diagonal_structure_needs_pairs() -> None:
    with pytest.raises(ConfigError, match="there are 2 outputs and 1 inputs"):
        Form(2, 1, 0, 1, diagonal=True)


def test_a_model_resumes_with_the_last_changes_of_a_recording_newest_first() -> None:
    form = Form(1, 1, output_length=2, input_length=3)
    model = DataModel(form, form.initial_gradients(0.1), TABLE_2)
    u, y = np.array([[0.0], [1.0], [3.0]]), np.array([[0.0], [10.0], [30.0]])
    model.resume(Recording(u, y, y, 0.1))
    assert model.known == [20.0, 10.0, 2.0, 1.0]  # dy_k-1, dy_k-2; du_k-1, du_k-2
    model.observe([60.0])
    assert model.known == [30.0, 20.0, 2.0, 1.0]
    model.apply([7.0])
    assert model.known == [30.0, 20.0, 7.0, 2.0]
