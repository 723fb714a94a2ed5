"""The condensed form against the full problem as printed, solved by another backend over all entries of g."""

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from ddpc_controllers import DeePC
from ddpc_controllers.optimisation.condensing import _tightest
from ddpc_controllers.published import PublishedDeePC
from ddpc_cosim import Action, FloatArray, Recording, Sample

from ..full_problem import FullDeePC
from ..loops import (
    ANGLE,
    Advance,
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
    regulating_spc,
)


def compare(controller: DeePC, recording: Recording, run: Run, loop: Any) -> tuple[float, int]:
    """Return the largest difference in u from the full problem, and how many samples had an active bound."""
    full = FullDeePC(controller, recording, loop.bounds)
    worst, active = 0.0, 0
    for k, sample in enumerate(run.samples):
        u_ini = before(run.u, np.zeros(run.u.shape[1]), k, controller.initial_length)
        y_ini = before(run.y, run.y[0], k, controller.initial_length)
        solution = full.solve(u_ini, y_ini, sample.reference)
        assert solution.solved
        assert run.status[k] == "ok"
        worst = max(worst, float(np.abs(solution.u[0] - run.u[k]).max()))
        limit = controller.setpoint_margin * loop.bounds.u_max
        active += bool((np.abs(solution.u) > limit - 1e-6).any())
    return worst, active


@pytest.mark.parametrize("affine_sum", ["none", "all", "first-horizon"])
@pytest.mark.parametrize(("torque", "bounds_active"), [(3.5, False), (2.5, True)])
def test_the_pendulum_with_and_without_active_bounds(
    paper_recording: Recording, affine_sum: str, torque: float, bounds_active: bool
) -> None:
    controller = PublishedDeePC() if affine_sum == "first-horizon" else printed_deepc(affine_sum=affine_sum)
    loop = pendulum_loop(paper_recording, torque)
    run = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), steps=130)
    worst, active = compare(controller, paper_recording, run, loop)
    assert worst < 1e-6
    assert (active > 10) == bounds_active


def linear_case(
    seed: int, order: int, inputs: int, outputs: int, noise: float
) -> tuple[LinearPlant, Advance, Recording]:
    """Return a stable plant and an experiment on it; without noise its data are rank-deficient."""
    rng = np.random.default_rng(seed)
    plant = LinearPlant.random(rng, order, inputs, outputs)
    recording = experiment(plant.advance, rng.uniform(-1.0, 1.0, (90, inputs)), order, plant.c)
    noisy = recording.y + noise * rng.standard_normal(recording.y.shape)
    return plant, plant.advance, Recording(recording.u, noisy, recording.measured, 0.1)


def steps_between(rng: np.random.Generator, outputs: int, size: float, samples: int = 60) -> FloatArray:
    """Return a reference that jumps every ten samples."""
    return np.repeat(size * rng.uniform(-1.0, 1.0, (samples // 10, outputs)), 10, axis=0)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("width", [1, 2])
@pytest.mark.parametrize("limit", [0.3, 100.0])
def test_linear_plants_with_and_without_noise(noise: float, width: int, limit: float) -> None:
    plant, advance, recording = linear_case(11 + width, 2, width, width, noise)
    controller = printed_deepc(
        lambda_g=0.1, output_weight=1.0, setpoint_weight=3.0, input_weight=0.1, lambda_sigma=1e4
    )
    loop = make_loop(recording, limit * np.ones(width), np.full(width, np.inf))
    reference = steps_between(np.random.default_rng(5), width, 2.0)
    run = close_loop(controller, loop, advance, plant.c, reference, steps=40)
    if noise == 0.0:
        assert controller.diagnostics()["data_rank"] == width * 8 + 2 < controller.diagnostics()["data_rows"]
    worst, active = compare(controller, recording, run, loop)
    assert worst < 1e-6
    assert (active > 5) == (limit < 1.0)


weights = st.floats(-1.0, 2.0).map(lambda exponent: 10.0**exponent)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**16),
    signals=st.sampled_from([(1, 1), (2, 2), (2, 1), (1, 2)]),
    initial_length=st.integers(1, 3),
    further=st.integers(1, 3),
    noise=st.sampled_from([0.0, 1e-2]),
    affine_sum=st.sampled_from(["none", "all"]),
    cost=st.tuples(weights, weights, weights),
    lambda_g=weights,
    u_limit=st.floats(0.2, 3.0),
)
def test_any_problem_has_the_same_optimum(
    seed: int,
    signals: tuple[int, int],
    initial_length: int,
    further: int,
    noise: float,
    affine_sum: str,
    cost: tuple[float, float, float],
    lambda_g: float,
    u_limit: float,
) -> None:
    inputs, outputs = signals
    plant, advance, recording = linear_case(seed, 2, inputs, outputs, noise)
    controller = printed_deepc(
        initial_length=initial_length,
        horizon=initial_length + further,
        output_weight=cost[0],
        setpoint_weight=cost[1],
        input_weight=cost[2],
        lambda_g=lambda_g,
        lambda_sigma=1e4,
        affine_sum=affine_sum,
    )
    loop = make_loop(recording, u_limit * np.ones(inputs), 50.0 * np.ones(outputs))
    reference = steps_between(np.random.default_rng(seed), outputs, 2.0)
    run = close_loop(controller, loop, advance, plant.c, reference, steps=8)
    assume(set(run.status) == {"ok"})
    worst, _ = compare(controller, recording, run, loop)
    assert worst < 1e-6


def test_weights_may_be_matrices() -> None:
    plant, advance, recording = linear_case(3, 2, 2, 2, 1e-3)
    controller = printed_deepc(
        output_weight=[[2.0, 0.5], [0.5, 1.0]], setpoint_weight=[1.0, 3.0], input_weight=0.1, lambda_g=0.1
    )
    loop = make_loop(recording, 0.5 * np.ones(2), np.full(2, np.inf))
    reference = steps_between(np.random.default_rng(1), 2, 1.0)
    run = close_loop(controller, loop, advance, plant.c, reference, steps=20)
    worst, active = compare(controller, recording, run, loop)
    assert worst < 1e-6
    assert active > 5


def test_output_bounds_hold_too(paper_recording: Recording) -> None:
    controller = printed_deepc()
    loop = pendulum_loop(paper_recording, degrees=15.0)
    run = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), steps=60)
    tight = close_loop(
        controller, pendulum_loop(paper_recording), quick_pendulum, ANGLE, paper_reference(), 60
    )
    assert run.y.max() < tight.y.max() - 0.02
    worst, _ = compare(controller, paper_recording, run, loop)
    assert worst < 1e-6


def test_one_sided_bounds_are_bounds(paper_recording: Recording) -> None:
    loop = pendulum_loop(paper_recording)
    loop.bounds.u_max[...], loop.bounds.u_min[...], loop.bounds.y_max[...] = 1.5, -np.inf, np.inf
    controller = printed_deepc()
    run = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), steps=120)
    worst, active = compare(controller, paper_recording, run, loop)
    assert run.u.max() <= 1.5 < -run.u.min()
    assert worst < 1e-6
    assert active > 10


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_what_counts_as_a_conflict_does_not_depend_on_units(noise: float) -> None:
    rng = np.random.default_rng(3)
    plant = LinearPlant.random(rng, 3, 1, 2)
    u = rng.uniform(-1.0, 1.0, (150, 1))
    recorded = experiment(plant.advance, u, 3, plant.c)

    def conflicts(of_u: float, of_y: FloatArray) -> list[bool]:
        stream = np.random.default_rng(4)
        recording = Recording(of_u * recorded.u, of_y * recorded.y, of_y * recorded.y, 0.1)
        weights = {"output_weight": (1.0 / of_y**2).tolist(), "input_weight": 0.1 / of_u**2}
        controller = regulating_spc(horizon=6, scaling="none", **weights)
        infinite = np.full(2, np.inf)
        controller.start(make_loop(recording, np.array([of_u]), infinite))
        state, said = np.zeros(3), []
        for k in range(40):
            y = of_y * (plant.c @ state + noise * stream.standard_normal(2))
            answer = controller.step(Sample(k, 0.1 * k, y, y, np.tile(0.3 * of_y, (6, 1)), 0.3 * of_y))
            action = answer if isinstance(answer, Action) else Action(answer)
            said.append("no combination of the recorded windows" in action.status)
            state = plant.advance(state, action.u / of_u)
        return said

    for units in (
        (1.0, np.ones(2)),
        (1e5, np.full(2, 1e-4)),
        (1e-4, np.full(2, 1e5)),
        (1e4, np.array([1e-4, 1e4])),
    ):
        assert conflicts(*units) == [bool(noise)] * 40


def test_of_bounds_that_are_one_but_for_rounding_one_stays() -> None:
    """The first and the last of them differ by more than what counts as rounding, neighbours by less."""
    limits = 1.0 + 8e-15 * np.arange(3)
    law = np.column_stack([np.zeros(4), np.append(limits, 0.5)])
    np.testing.assert_array_equal(_tightest(law, np.array([[1.0], [1.0], [1.0], [-1.0]])), [1, 3])
