"""Select-DPC against a least-squares predictor of the windows that a few lines choose."""

from typing import Any

import numpy as np
import piqp
import pytest
from hypothesis import given, settings, strategies as st

from controllers.export.compiled import Beside
from ddpc_controllers import SPC, DeePC, SelectDPC, hankel_matrix
from ddpc_cosim import ConfigError, FloatArray, Recording

from .loops import LinearPlant, before, close_loop, experiment, make_loop

PAST, HORIZON, Q, R = 2, 4, 10.0, 0.1
FIXED: dict[str, Any] = {
    "initial_length": PAST,
    "horizon": HORIZON,
    "output_weight": Q,
    "input_weight": R,
    "artificial_setpoint": False,
}
OUTPUT = np.array([[1.0, 0.0]])


def bent(state: FloatArray, u: FloatArray) -> FloatArray:
    """A plant whose gain varies by more than ten."""
    return np.array([0.7 * state[0] + 0.3 * np.tanh(2.0 * state[1]), 0.5 * state[1] + u[0]])


def recorded(samples: int, noise: float = 0.01) -> Recording:
    rng = np.random.default_rng(0)
    clean = experiment(bent, rng.uniform(-1.0, 1.0, (samples, 1)), 2, OUTPUT)
    y = clean.y + noise * rng.standard_normal(clean.y.shape)
    return Recording(clean.u, y, y, 0.1)


def box_optimum(response: FloatArray, free: FloatArray, limit: float) -> FloatArray:
    """Minimise ``Q |free + response u|^2 + R |u|^2`` within limits."""
    solver = piqp.DenseSolver()
    for name in ("eps_abs", "eps_rel", "eps_duality_gap_abs", "eps_duality_gap_rel"):
        setattr(solver.settings, name, 1e-12)
    size = response.shape[1]
    box = np.full(size, limit)
    hessian = Q * response.T @ response + R * np.eye(size)
    solver.setup(hessian, Q * response.T @ free, x_l=-box, x_u=box)
    assert solver.solve() == piqp.PIQP_SOLVED
    return np.asarray(solver.result.x)


@pytest.mark.parametrize("current", [True, False])
@pytest.mark.parametrize("compared", ["all", "outputs"])
@pytest.mark.parametrize(("rounds", "steps"), [(1, 1), (3, 1), (1, 2)])
def test_the_nearest_windows_predict(compared: str, rounds: int, steps: int, current: bool) -> None:
    recording, known, limit = recorded(150), PAST + current, 0.8
    controller = SelectDPC(
        windows_per_row=3.0,
        compared=compared,  # type: ignore[arg-type]
        rounds=rounds,
        apply_steps=steps,
        use_current_output=current,
        **FIXED,
    )
    loop = make_loop(recording, np.array([limit]), np.array([np.inf]))
    run = close_loop(controller, loop, bent, OUTPUT, np.repeat([[0.0], [0.6], [-0.6]], 10, axis=0), 24)
    u = hankel_matrix(recording.u[: len(recording) - current], PAST + HORIZON)
    y = hankel_matrix(recording.y, known + HORIZON)
    windows = np.vstack([u[:PAST], y[:known], u[PAST:], y[known:]])
    spread = windows.std(axis=1)
    rows = np.ones(len(windows), dtype=bool)
    if compared == "outputs":
        rows[:PAST] = rows[PAST + known : PAST + known + HORIZON] = False
    plan, chosen = None, list[FloatArray]()
    for k, sample in enumerate(run.samples):
        if k % steps:
            assert plan is not None
            assert run.u[k, 0] == pytest.approx(plan[k % steps], abs=1e-6)
            continue
        past_u = before(run.u, np.zeros(1), k, PAST)[:, 0]
        past_y = before(run.y, run.y[0], k + current, known)[:, 0]
        if plan is None:
            plan = np.concatenate([np.repeat(past_u[-1], HORIZON), np.repeat(past_y[-1], HORIZON)])
        else:
            later = [*range(steps, HORIZON), *[HORIZON - 1] * steps]
            plan = np.concatenate([plan[:HORIZON][later], plan[HORIZON:][later]])
        for _ in range(rounds):
            expected = np.concatenate([past_u, past_y, plan])
            distances = np.linalg.norm(
                ((windows - expected[:, np.newaxis]) / spread[:, np.newaxis])[rows], axis=0
            )
            nearest = np.argsort(distances)[: 3 * (PAST + known + 1 + HORIZON)]
            given = np.vstack([windows[:-HORIZON], np.ones(windows.shape[1])])[:, nearest]
            predictor = windows[-HORIZON:, nearest] @ np.linalg.pinv(given)
            response = predictor[:, PAST + known : -1]
            free = predictor[:, : PAST + known] @ np.concatenate([past_u, past_y]) + predictor[:, -1]
            inputs = box_optimum(response, free - sample.reference[:, 0], limit)
            plan = np.concatenate([inputs, free + response @ inputs])
            chosen.append(nearest)
        assert run.u[k, 0] == pytest.approx(plan[0], abs=1e-6)
    assert len({tuple(sorted(nearest)) for nearest in chosen}) > 5
    assert np.abs(run.u).max() > limit - 1e-9


@pytest.mark.parametrize("limit", [0.4, 50.0])
def test_all_windows_are_spc_with_entries_that_sum_to_one(limit: float) -> None:
    """SPC of DeePC's kind: a large price of the projection, its past met."""
    loop = make_loop(recorded(120), np.array([limit]), np.array([np.inf]))
    reference = np.repeat([[0.0], [0.6], [-0.6]], 10, axis=0)
    run = close_loop(SelectDPC(windows_per_row=1e3, **FIXED), loop, bent, OUTPUT, reference, 24)
    deepc = DeePC(lambda_g=1e8, slack=False, affine_sum="all", use_current_output=True, **FIXED)
    assert run.u == pytest.approx(close_loop(deepc, loop, bent, OUTPUT, reference, 24).u, abs=1e-6)


@given(seed=st.integers(0, 2**32 - 1), compared=st.sampled_from(["all", "outputs"]))
@settings(max_examples=5, deadline=None)
def test_on_a_linear_plant_any_choice_is_the_plant(seed: int, compared: Any) -> None:
    rng = np.random.default_rng(seed)
    plant = LinearPlant.random(rng, 2, 1, 1)
    recording = experiment(plant.advance, rng.uniform(-1.0, 1.0, (120, 1)), 2, plant.c)
    loop = make_loop(recording, np.array([0.7]), np.array([np.inf]))
    reference = np.repeat(rng.uniform(-1.0, 1.0, (2, 1)), 10, axis=0)
    runs = [
        close_loop(controller, loop, plant.advance, plant.c, reference, 12)
        for controller in (SelectDPC(compared=compared, **FIXED), SPC(**FIXED))
    ]
    assert runs[0].u == pytest.approx(runs[1].u, abs=1e-5)


def test_a_start_anew_forgets_the_plan() -> None:
    loop = make_loop(recorded(120), np.array([0.8]), np.array([np.inf]))
    reference, controller = np.full((20, 1), 0.6), SelectDPC(**FIXED)
    first = close_loop(controller, loop, bent, OUTPUT, reference, 10)
    controller.restart(loop)
    again = [controller.step(sample) for sample in first.samples]
    assert [float(np.ravel(getattr(answer, "u", answer))[0]) for answer in again] == first.u[:, 0].tolist()


def test_it_has_no_code_in_c() -> None:
    beside = Beside(controller=SelectDPC(**FIXED))
    with pytest.raises(ConfigError, match=r"SelectDPC cannot be exported: .* use SPC"):
        beside.start(make_loop(recorded(120), np.array([0.8]), np.array([np.inf])))


def test_instruments_would_make_one_predictor() -> None:
    with pytest.raises(
        ConfigError, match=r"SelectDPC: instruments = 'open-loop' .* use instruments = 'none'"
    ):
        SelectDPC(instruments="open-loop")
