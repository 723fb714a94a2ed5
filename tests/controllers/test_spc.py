"""SPC and gamma-DDPC against explicit formulas, and where DeePC, SPC and model predictive control are one."""

from collections.abc import Callable
from typing import Any

import numpy as np
import piqp
import pytest
from scipy.linalg import toeplitz

from ddpc_controllers import MFAC, MFAPC, SPC, DeePC, GammaDDPC, hankel_matrix
from ddpc_cosim import Action, ConfigError, Controller, FloatArray, Recording, Sample

from .loops import (
    ANGLE,
    LinearPlant,
    Run,
    before,
    close_loop,
    experiment,
    make_loop,
    paper_reference,
    pendulum_loop,
    printed_deepc,
    quick_pendulum,
    regulating_gamma_ddpc,
    regulating_spc,
)

REGULATION: dict[str, Any] = {"artificial_setpoint": False, "terminal_equality": False}


def tracked(response: FloatArray, free: FloatArray, q: float, r: float, limit: float) -> FloatArray:
    """Minimise ``q |free + response u|^2 + r |u|^2`` within limits: a box problem of PIQP's."""
    size = response.shape[1]
    solver = piqp.DenseSolver()
    for name in ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"):
        setattr(solver.settings, name, 1e-12)
    hessian = q * response.T @ response + r * np.eye(size)
    box = np.full(size, limit)
    solver.setup(hessian, q * response.T @ free, x_l=-box, x_u=box)
    assert solver.solve() == piqp.PIQP_SOLVED
    return np.asarray(solver.result.x)


def data_blocks(
    recording: Recording, past: int, horizon: int, current: bool
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (past, future inputs, future outputs) as they stand in the textbooks.

    With ``current``, the output measured before the first of the future inputs is of the past.
    """
    m, p, known = recording.u.shape[1], recording.y.shape[1], past + current
    u = hankel_matrix(recording.u[: len(recording) - current], past + horizon)
    y = hankel_matrix(recording.y, known + horizon)
    return np.vstack([u[: past * m], y[: known * p]]), u[past * m :], y[known * p :]


def past_of(run: Run, k: int, past: int, current: bool) -> FloatArray:
    """Return the past of sample k of a single loop that starts from rest."""
    known = before(run.y, run.y[0], k + current, past + current)
    return np.vstack([before(run.u, np.zeros(1), k, past), known])[:, 0]


@pytest.mark.parametrize("current", [True, False])
@pytest.mark.parametrize("torque", [10.0, 1.8])
def test_the_prediction_is_least_squares(paper_recording: Recording, torque: float, current: bool) -> None:
    controller = regulating_spc(horizon=8, output_weight=500.0, input_weight=0.5, use_current_output=current)
    run = close_loop(
        controller, pendulum_loop(paper_recording, torque), quick_pendulum, ANGLE, paper_reference(), 130
    )
    past, u, y = data_blocks(paper_recording, 3, 8, current)
    predictor = y @ np.linalg.pinv(np.vstack([past, u]))
    for k, sample in enumerate(run.samples):
        free = predictor[:, : len(past)] @ past_of(run, k, 3, current) - sample.reference[:, 0]
        optimum = tracked(predictor[:, len(past) :], free, 500.0, 0.5, torque)
        assert run.u[k, 0] == pytest.approx(optimum[0], abs=1e-6)
    assert (np.abs(run.u).max() == torque) == (torque < 3.0)


@pytest.mark.parametrize("current", [True, False])
def test_gamma_ddpc_is_the_factorised_problem(paper_recording: Recording, current: bool) -> None:
    controller = regulating_gamma_ddpc(
        beta_2=2e-3, beta_3=0.1, output_weight=50.0, input_weight=0.5, use_current_output=current
    )
    run = close_loop(
        controller, pendulum_loop(paper_recording, 1e3, 1e4), quick_pendulum, ANGLE, paper_reference(), 60
    )
    data = np.vstack(data_blocks(paper_recording, 3, 5, current))
    lower = np.linalg.qr(data.T / np.sqrt(data.shape[1]), mode="r").T
    known = 6 + current
    for k, sample in enumerate(run.samples):
        gamma_1 = np.linalg.solve(lower[:known, :known], past_of(run, k, 3, current))
        fixed = lower[known:, :known] @ gamma_1
        free = lower[known:, known:]
        weights = np.repeat([0.5, 50.0], 5)
        target = np.concatenate([np.zeros(5), sample.reference[:, 0]]) - fixed
        hessian = free.T @ (weights[:, np.newaxis] * free) + np.diag(np.repeat([2e-3, 0.1], 5))
        gamma = np.linalg.solve(hessian, free.T @ (weights * target))
        assert run.u[k, 0] == pytest.approx((fixed + free @ gamma)[0], abs=1e-7)


@pytest.mark.parametrize("current", [True, False])
@pytest.mark.parametrize("torque", [10.0, 1.8])
@pytest.mark.parametrize(
    ("predictor", "uncertainty"), [("causal", False), ("causal", True), ("transient", False)]
)
def test_predictors_without_later_inputs(
    paper_recording: Recording, predictor: str, uncertainty: bool, torque: float, current: bool
) -> None:
    """What is predicted and what of it is uncertain, both of one output after the other."""
    horizon, rng = 6, np.random.default_rng(5)
    noisy = paper_recording.y + 0.02 * rng.standard_normal(paper_recording.y.shape)
    recording = Recording(paper_recording.u, noisy, noisy, 0.1)
    controller = regulating_spc(
        horizon=horizon,
        output_weight=500.0,
        input_weight=0.5,
        use_current_output=current,
        predictor=predictor,
        uncertainty=uncertainty,
    )
    run = close_loop(
        controller,
        make_loop(recording, np.array([torque]), np.array([np.inf])),
        quick_pendulum,
        ANGLE,
        paper_reference(),
        60,
    )
    past, u, y = data_blocks(recording, 3, horizon, current)
    columns, known = past.shape[1], len(past)
    matrix, errors, givens = np.zeros((horizon, known + horizon)), np.zeros((horizon, columns)), []
    for step in range(horizon):
        inputs = step + current
        given = np.vstack([past, u[:inputs], y[:step]] if predictor == "transient" else [past, u[:inputs]])
        fitted = np.linalg.lstsq(given.T, y[step])[0]
        matrix[step, : known + inputs] = fitted[: known + inputs]
        matrix[step] += fitted[known + inputs :] @ matrix[: len(fitted) - known - inputs]
        errors[step] = y[step] - matrix[step] @ np.vstack([past, u])
        givens.append(np.linalg.pinv(np.vstack([past, u])[: known + inputs]))
    spread = np.zeros((known + horizon, known + horizon))
    l_33 = np.linalg.cholesky(errors @ errors.T / (columns - known - horizon))
    for step, inverse in enumerate(givens):
        shared = np.array([l_33[step, i : step + 1] @ l_33[step, : step + 1 - i] for i in range(step + 1)])
        covariance = toeplitz(np.pad(shared, (0, columns - step - 1)))
        size = inverse.shape[1]
        spread[:size, :size] += 500.0 * uncertainty * inverse.T @ covariance @ inverse
    root = np.linalg.cholesky(spread + 1e-14 * np.eye(len(spread))).T
    response = np.vstack([matrix[:, known:], root[:, known:] / 500.0**0.5])
    for k, sample in enumerate(run.samples):
        now = past_of(run, k, 3, current)
        free = np.concatenate(
            [matrix[:, :known] @ now - sample.reference[:, 0], root[:, :known] @ now / 500.0**0.5]
        )
        optimum = tracked(response, free, 500.0, 0.5, torque)
        assert run.u[k, 0] == pytest.approx(optimum[0], abs=1e-5)


def test_a_high_price_of_gamma_3_gives_spc_back(paper_recording: Recording) -> None:
    loop, reference = pendulum_loop(paper_recording), paper_reference()
    spc = close_loop(regulating_spc(), loop, quick_pendulum, ANGLE, reference, 60)
    gamma = close_loop(regulating_gamma_ddpc(beta_3=1e10), loop, quick_pendulum, ANGLE, reference, 60)
    assert np.abs(spc.u - gamma.u).max() < 1e-6


def test_a_high_price_of_the_projection_gives_spc_back(paper_recording: Recording) -> None:
    loop, reference = pendulum_loop(paper_recording), paper_reference()
    weights: dict[str, Any] = {**REGULATION, "output_weight": 500.0, "input_weight": 0.5}
    spc = close_loop(regulating_spc(**weights), loop, quick_pendulum, ANGLE, reference, 60)
    deepc = printed_deepc(
        regulariser="projection", lambda_g=1e9, slack=False, use_current_output=True, **weights
    )
    assert np.abs(spc.u - close_loop(deepc, loop, quick_pendulum, ANGLE, reference, 60).u).max() < 1e-6


@pytest.mark.parametrize("current", [True, False])
@pytest.mark.parametrize(("inputs", "outputs"), [(1, 1), (2, 2), (2, 1)])
@pytest.mark.parametrize("limit", [0.4, 50.0])
def test_on_a_linear_plant_deepc_spc_and_mpc_with_the_true_model_coincide(
    inputs: int, outputs: int, limit: float, current: bool
) -> None:
    rng = np.random.default_rng(10 * inputs + outputs)
    plant = LinearPlant.random(rng, 3, inputs, outputs)
    recording = experiment(plant.advance, rng.uniform(-1.0, 1.0, (150, inputs)), 3, plant.c)
    loop = make_loop(recording, np.full(inputs, limit), np.full(outputs, np.inf))
    reference = np.repeat(rng.uniform(-1.0, 1.0, (5, outputs)), 20, axis=0)
    horizon = 8
    # Outputs of the state and the inputs u_k ... u_k+N-1: the model, written out. The first is y_k, or y_k+1
    # where y_k is known.
    powers = [np.linalg.matrix_power(plant.a, i) for i in range(horizon + 1)]
    observability = np.vstack([plant.c @ power for power in powers[current : current + horizon]])
    response = np.zeros((horizon * outputs, horizon * inputs))
    for i in range(horizon):
        for j in range(i + current):
            rows, columns = slice(i * outputs, (i + 1) * outputs), slice(j * inputs, (j + 1) * inputs)
            response[rows, columns] = plant.c @ powers[i + current - j - 1] @ plant.b

    common: dict[str, Any] = {"horizon": horizon, "output_weight": 10.0, "input_weight": 0.1, **REGULATION}
    common["use_current_output"] = current
    controllers = [
        regulating_spc(**common),
        printed_deepc(lambda_g=1e-9, slack=False, **common),
        printed_deepc(lambda_g=1e-8, lambda_sigma=1e8, **common),
        printed_deepc(regulariser="projection", lambda_g=1.0, slack=False, **common),
    ]
    for controller in controllers:
        run = close_loop(controller, loop, plant.advance, plant.c, reference, 60)
        assert set(run.status) == {"ok"}
        state = np.zeros(3)
        for k, sample in enumerate(run.samples):
            free = observability @ state - sample.reference.ravel()
            optimum = tracked(response, free, 10.0, 0.1, limit)
            assert run.u[k] == pytest.approx(optimum[:inputs], abs=1e-6)
            state = plant.advance(state, run.u[k])


@pytest.mark.parametrize(
    "controller",
    [
        regulating_spc(output_weight=5.0, input_weight=0.1),
        printed_deepc(output_weight=5.0, input_weight=0.1, lambda_g=1e-9, slack=False, **REGULATION),
        printed_deepc(output_weight=5.0, input_weight=0.1, lambda_g=1e-9, slack=False, rate_bounds=0.3),
    ],
    ids=["spc", "deepc", "deepc, printed, with rates"],
)
def test_two_loops_on_a_decoupled_plant(controller: Any) -> None:
    rng = np.random.default_rng(3)
    first, other = (LinearPlant.random(rng, 2, 1, 1) for _ in range(2))
    zero = np.zeros((2, 2))
    both = LinearPlant(
        np.block([[first.a, zero], [zero, other.a]]),
        np.block([[first.b, np.zeros((2, 1))], [np.zeros((2, 1)), other.b]]),
        np.block([[first.c, np.zeros((1, 2))], [np.zeros((1, 2)), other.c]]),
    )
    u = rng.uniform(-1.0, 1.0, (150, 2))
    recording = experiment(both.advance, u, 4, both.c)
    reference = np.repeat(rng.uniform(-1.0, 1.0, (5, 2)), 20, axis=0)
    unlimited = np.full(2, np.inf)
    together = close_loop(
        controller,
        make_loop(recording, 0.8 * np.ones(2), unlimited),
        both.advance,
        both.c,
        reference,
        60,
    )
    for i, plant in enumerate((first, other)):
        alone = experiment(plant.advance, u[:, i : i + 1], 2, plant.c)
        loop = make_loop(alone, np.array([0.8]), np.array([np.inf]))
        run = close_loop(controller, loop, plant.advance, plant.c, reference[:, i : i + 1], 60)
        assert run.u[:, 0] == pytest.approx(together.u[:, i], abs=1e-6)


@pytest.mark.parametrize("online_data", ["frozen", "sliding-window"])
def test_a_plant_without_bounds(paper_recording: Recording, online_data: str) -> None:
    infinite = np.array([np.inf])
    controller = printed_deepc(online_data=online_data)
    loop = make_loop(paper_recording, infinite, infinite)
    run = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), 60)
    wide = close_loop(
        controller, pendulum_loop(paper_recording, 1e5, 1e5), quick_pendulum, ANGLE, paper_reference(), 60
    )
    assert run.u == pytest.approx(wide.u, abs=1e-9)
    missing, known = np.array([np.nan]), np.zeros(1)
    for y, reference in ((missing, np.zeros((5, 1))), (known, np.full((5, 1), np.nan))):
        answer = controller.step(Sample(60, 6.0, y, y, reference, reference[0]))
        assert isinstance(answer, Action)
        assert "not finite" in answer.status
        assert np.isfinite(answer.u).all()


def test_the_recording_is_diagnosed(paper_recording: Recording) -> None:
    controller = regulating_spc()
    controller.start(pendulum_loop(paper_recording))
    assert controller.diagnostics()["data_rank"] == 17


@pytest.mark.parametrize("kind", [regulating_spc, regulating_gamma_ddpc])
def test_a_moving_reference_is_met_in_its_own_sample(kind: Callable[..., SPC]) -> None:
    plant = LinearPlant(np.array([[0.9]]), np.array([[0.1]]), np.eye(1))
    recording = experiment(plant.advance, np.random.default_rng(0).uniform(-1.0, 1.0, (200, 1)), 1, plant.c)
    loop = make_loop(recording, np.full(1, 3.0), np.full(1, np.inf))
    ramp = np.minimum(0.02 * np.arange(80.0), 0.8)[:, np.newaxis]
    run = close_loop(kind(horizon=8, input_weight=0.01), loop, plant.advance, plant.c, ramp, 60)
    assert np.abs(run.y - ramp[:60]).max() < 1e-3  # a sample early would be 0.02


def test_the_prices_of_gamma_ddpc_mean_the_same_for_a_recording_of_any_length() -> None:
    plant = LinearPlant(np.array([[0.9]]), np.array([[0.1]]), np.eye(1))
    u = np.random.default_rng(0).uniform(-1.0, 1.0, (200, 1))
    noise = 1e-2 * np.random.default_rng(1).standard_normal((1600, 1))

    def first_input(times: int, beta_2: float) -> float:
        clean = experiment(plant.advance, np.tile(u, (times, 1)), 1, plant.c)
        recording = Recording(clean.u, clean.y + noise[: len(clean)], clean.measured, 0.1)
        controller = regulating_gamma_ddpc(beta_2=beta_2, beta_3=5.0, output_weight=1.0, input_weight=0.01)
        controller.start(make_loop(recording, np.full(1, 500.0), np.full(1, np.inf)))
        answer = controller.step(Sample(0, 0.0, np.zeros(1), np.zeros(1), np.ones((5, 1)), np.ones(1)))
        assert isinstance(answer, Action)
        return float(answer.u[0])

    priced = first_input(1, 0.05)
    assert priced < 0.5 * first_input(1, 0.0)
    assert [first_input(times, 0.05) for times in (2, 8)] == pytest.approx([priced] * 2, rel=0.02)


@pytest.mark.parametrize("terminal", [True, False])
@pytest.mark.parametrize("kind", [SPC, GammaDDPC])
def test_of_inputs_that_do_the_same_the_setpoint_nearest_to_rest_is_chosen(
    kind: type[SPC], terminal: bool
) -> None:
    plant = LinearPlant(np.array([[0.9]]), np.array([[0.1, 0.05]]), np.eye(1))
    u = np.random.default_rng(0).uniform(-1.0, 1.0, (300, 2))
    loop = make_loop(experiment(plant.advance, u, 1, plant.c), np.ones(2), np.full(1, np.inf))
    controller = kind(artificial_setpoint=True, terminal_equality=terminal)
    run = close_loop(controller, loop, plant.advance, plant.c, np.full((80, 1), 0.5), 60)
    # y = u_1 + u_2 / 2: the least inputs with y = 0.5.
    assert run.u[-1] == pytest.approx([0.4, 0.2], abs=1e-4)
    assert run.y[-1] == pytest.approx([0.5], abs=1e-5)


CONTAINED: list[tuple[SPC, type[Controller]]] = [
    (SPC(input_weight=0.01, predictor="transient", uncertainty=True, artificial_setpoint=False), GammaDDPC),
    (SPC(horizon=9, initial_length=4, input_weight=0.01, artificial_setpoint=False), GammaDDPC),
    (SPC(horizon=9, initial_length=4, input_weight=0.01, artificial_setpoint=False), DeePC),
    (SPC(horizon=7, input_weight=0.1, artificial_setpoint=True), GammaDDPC),
    (SPC(horizon=7, input_weight=0.1, artificial_setpoint=True), DeePC),
    (GammaDDPC(horizon=8, input_weight=0.1, beta_3=0.7, artificial_setpoint=False), DeePC),
    (GammaDDPC(horizon=8, input_weight=1.0, beta_3=30.0), DeePC),
]


@pytest.mark.parametrize("limit", [10.0, 1.8])
@pytest.mark.parametrize(("controller", "other"), CONTAINED)
def test_a_method_that_contains_another_decides_as_that_one_does(
    paper_recording: Recording, controller: SPC, other: type[Controller], limit: float
) -> None:
    settings = controller.settings_as(other, 1, 1, len(paper_recording))
    assert settings is not None
    runs = [
        close_loop(
            method, pendulum_loop(paper_recording, limit), quick_pendulum, ANGLE, paper_reference(), 130
        )
        for method in (controller, other(**settings))
    ]
    assert runs[1].u == pytest.approx(runs[0].u, abs=1e-6)
    assert np.ptp(runs[0].u) > 1.0


def test_what_no_settings_bring_about_is_not_told() -> None:
    spc, gamma = SPC(artificial_setpoint=True), GammaDDPC(beta_2=0.1)
    assert spc.settings_as(DeePC, 2, 1, 100) is None  # among many setpoints SPC has a preference
    assert gamma.settings_as(DeePC, 1, 1, 100) is None
    assert gamma.settings_as(SPC, 1, 1, 100) is None
    assert SPC(predictor="causal").settings_as(DeePC, 1, 1, 100) is None
    assert SPC(uncertainty=True).settings_as(DeePC, 1, 1, 100) is None


@pytest.mark.parametrize(("kind", "other"), [(SPC, GammaDDPC), (SPC, DeePC), (MFAC, MFAPC)])
def test_a_class_that_is_derived_may_do_something_else(
    kind: type[Controller], other: type[Controller]
) -> None:
    assert kind().settings_as(other, 1, 1, 100) is not None
    assert type("Derived", (kind,), {})().settings_as(other, 1, 1, 100) is None
    assert kind().settings_as(type("Derived", (other,), {}), 1, 1, 100) is None


def test_instruments_are_a_predictor_of_their_own() -> None:
    for settings in ({"predictor": "causal"}, {"uncertainty": True}):
        with pytest.raises(ConfigError, match=r"instruments = 'closed-loop' .* instruments = 'none'"):
            SPC(instruments="closed-loop", **settings)  # type: ignore[arg-type]
