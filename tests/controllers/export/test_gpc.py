"""Adaptive GPC in C: it learns, forgets and plans as in Python, with whatever it knows and does not know."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from controllers.export.compiled import Beside
from controllers.export.loops import COUPLED, PENDULUM, Bench, ask_at_random, limited_loop
from controllers.export.test_ahead import side_by_side
from controllers.test_foresight import PLANTS
from ddpc_controllers import GPC
from ddpc_controllers.models.recursive import RecursiveLeastSquares
from ddpc_cosim import Bounds, FloatArray, Sample

BOUND = 1e-10
HELD, CLIPPED = 1, 8


@pytest.fixture
def kept(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The weight that each sample leaves to those before, of the controller in Python."""
    weights, update = list[float](), RecursiveLeastSquares.update

    def noted(self: RecursiveLeastSquares, regressor: FloatArray, target: FloatArray) -> float:
        weights.append(update(self, regressor, target))
        return weights[-1]

    monkeypatch.setattr(RecursiveLeastSquares, "update", noted)
    return weights


def check(beside: Beside) -> None:
    assert beside.difference < BOUND
    assert not beside.disagreements


@pytest.mark.parametrize(
    ("bench", "controller"),
    [
        (PENDULUM, GPC(forgetting_factor=0.9, covariance_limit=20.0, initial_covariance=1.0)),
        (COUPLED, GPC(forgetting_factor=0.95, covariance_limit=100.0, initial_covariance=1.0)),
    ],
    ids=["one input", "two inputs"],
)
def test_a_sample_that_would_make_the_covariance_too_large_is_learned_without_forgetting(
    bench: Bench, controller: GPC, kept: list[float]
) -> None:
    check(bench.close(controller))
    assert {*kept} == {controller.forgetting_factor, 1.0}
    assert 20 < kept.count(1.0) < len(kept) - 20


@pytest.mark.parametrize(("initial_model", "dead_zone"), [("recording", 2e-3), ("gradient", 0.02)])
def test_within_the_dead_zone_nothing_is_learned(
    initial_model: str, dead_zone: float, kept: list[float]
) -> None:
    controller = GPC(initial_model=initial_model, dead_zone=dead_zone, forgetting_factor=0.95)  # type: ignore[arg-type]
    check(PENDULUM.close(controller))
    assert 10 < kept.count(1.0) < len(kept) - 10


@pytest.mark.parametrize("steps", [0, 1, 3, 8])
@pytest.mark.parametrize("optimum", ["free", "limited", "limited in its rates"])
def test_the_inputs_move_at_as_many_samples_as_the_control_horizon_has(steps: int, optimum: str) -> None:
    rates: float | tuple[()] = 0.4 if optimum == "limited in its rates" else ()
    bench = replace(COUPLED, limits=COUPLED.limits + np.array([-1e3, 1e3])) if optimum == "free" else COUPLED
    controller = GPC(horizon=8, control_horizon=steps, rate_bounds=rates, change_weight=[0.3, 0.05])
    beside = bench.close(controller)
    check(beside)
    assert (beside.active > 0) == (optimum != "free")


@given(lost=st.sets(st.integers(0, 39), max_size=12), unknown=st.sets(st.integers(0, 39), max_size=4))
@settings(max_examples=25, deadline=None)
def test_what_is_not_known_is_held_and_teaches_nothing_until_there_is_a_past_again(
    lost: set[int], unknown: set[int]
) -> None:
    controller = GPC(horizon=4, output_length=3, input_length=2)
    beside = COUPLED.close(controller, steps=40, lost=sorted(lost), unknown=sorted(unknown))
    check(beside)
    assert beside.statuses == (HELD if beside.fallbacks else 0)


def test_an_unknown_reference_holds_the_inputs_but_not_the_estimates(kept: list[float]) -> None:
    check(PENDULUM.close(GPC(), lost=(), unknown=range(40, 60)))
    assert len(kept) == 150 - 1  # the first sample has none before it


@pytest.mark.parametrize("seed", range(8))
def test_random_settings_and_samples_of_which_most_have_active_limits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    m, horizon = int(rng.integers(1, 4)), int(rng.integers(2, 7))
    loop = limited_loop(rng, m, horizon)
    controller = GPC(
        initial_model="gradient",
        initial_gradient=rng.normal(size=(2, m)).tolist(),
        horizon=horizon,
        control_horizon=int(rng.integers(0, horizon + 1)),
        output_length=int(rng.integers(1, 4)),
        input_length=int(rng.integers(1, 4)),
        output_weight=(10.0 ** rng.uniform(-1.0, 1.0, 2)).tolist(),
        change_weight=(10.0 ** rng.uniform(-2.0, 1.0, m)).tolist(),
        observer_pole=float(rng.choice([0.0, 0.5, 0.9])),
        forgetting_factor=float(rng.uniform(0.7, 1.0)),
        covariance_limit=float(10.0 ** rng.uniform(0.0, 4.0)),
        initial_covariance=float(10.0 ** rng.uniform(-2.0, 2.0)),
        dead_zone=float(rng.choice([0.0, 0.5])),
        rate_bounds=rng.uniform(0.1, 1.0, m).tolist() if seed % 2 else (),
        scaling="none",
    )
    beside, active = Beside(controller=controller), 0
    for limited in ask_at_random(beside, loop, rng):
        check(beside)
        active += limited
    assert active > 40


@pytest.mark.parametrize("name", ["pendulum", "two inputs, two outputs"])
@pytest.mark.parametrize("use_forecast", [True, False])
def test_known_disturbances_act_in_the_model_now_and_ahead(name: str, use_forecast: bool) -> None:
    controller = GPC(horizon=6, input_length=2, control_horizon=4, use_forecast=use_forecast)
    beside = side_by_side(controller, PLANTS[name], preview=50)
    check(beside)
    assert 0 < beside.limited < beside.steps
    assert np.abs(controller._model.coefficients[controller._model_terms :]).max() > 1e-2


def test_a_weight_that_is_lost_in_rounding_leaves_the_least_change() -> None:
    loop, _ = COUPLED.loop(recording=None)
    loop = replace(loop, outputs=loop.outputs[:1])
    controller = GPC(
        horizon=1,
        initial_model="gradient",
        initial_gradient=[[3e8, 4e8]],
        change_weight=[0.1, 0.2],
        scaling="none",
    )
    beside = Beside(controller=controller)
    beside.start(loop)
    beside.step(Sample(0, 0.0, np.zeros(1), np.zeros(3), np.full((1, 1), 1e7), np.zeros(1)))
    assert beside.difference < 1e-12


def test_limits_that_no_change_can_keep_are_told_and_clipped() -> None:
    loop, _ = PENDULUM.loop(continues_recording=True)
    high = float(loop.recording.u[-1, 0]) - 1.0  # type: ignore[union-attr]
    free = np.full(1, np.inf)
    loop = replace(loop, bounds=Bounds(np.array([high - 5.0]), np.array([high]), -free, free))
    beside = Beside(controller=GPC(rate_bounds=0.1, scaling="none"))
    beside.start(loop)
    statuses = []
    for k, y in enumerate(np.array([[0.0], [0.1], [0.2]])):
        beside.step(Sample(k, 0.1 * k, y, np.append(0.0, y), np.full((10, 1), 1e3), np.zeros(1)))
        statuses.append(beside.c.status)
    assert statuses == [CLIPPED, 0, 0]
    check(beside)
