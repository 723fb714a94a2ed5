"""Data that follow the plant: the updated factor against the windows, and what a quiet loop keeps."""

import pickle
from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from ddpc_controllers import WKPC, DeePC
from ddpc_controllers.data.online import Learner, OnlineData
from ddpc_controllers.published import PublishedDeePC, PublishedWKPC
from ddpc_cosim import Action, ConfigError, Controller, FloatArray, Loop, Recording, Sample

from ..full_problem import FullDeePC
from ..loops import (
    ANGLE,
    DEGREE,
    REGULATION,
    LinearPlant,
    Run,
    before,
    close_loop,
    experiment,
    make_loop,
    paper_reference,
    pendulum_experiment,
    pendulum_loop,
    printed_deepc,
    printed_wkpc,
    quick_pendulum,
)


def inputs(answer: FloatArray | Action) -> FloatArray:
    """Return the inputs of an answer in either form."""
    return answer.u if isinstance(answer, Action) else answer


def learner_of(controller: Any) -> Learner:
    """Return what learns in a started controller."""
    learner: Learner = controller._learner
    return learner


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**16),
    rank=st.integers(2, 7),
    keep=st.sampled_from([1.0, 0.9]),
    blocks=st.booleans(),
    grows=st.booleans(),
)
def test_the_factor_is_that_of_the_windows(
    seed: int, rank: int, keep: float, blocks: bool, grows: bool
) -> None:
    rng = np.random.default_rng(seed)
    rows, columns, learned = 7, 25, 60
    span = rng.standard_normal((rows, rank))
    windows = deque((span @ rng.standard_normal(rank) for _ in range(columns)), columns)
    weights = ((4, 0.0), (3, 2.0)) if blocks else ((rows, 2.0),)
    online = OnlineData(np.array(windows).T, weights, np.array([0, 1]), keep, floor=0.0)
    everything = list(windows)
    for k in range(learned):
        if grows and k == 20:  # the plant changes: windows that no combination of the old ones has
            span = rng.standard_normal((rows, rank))
        window = span @ rng.standard_normal(rank)
        windows.append(window)
        everything.append(window)
        assert online.learn(window)
    if keep == 1.0:
        expected = np.array(windows)
    else:
        ages = np.minimum(np.arange(len(everything))[::-1], learned)  # the recording counts as one age
        expected = np.array(everything) * np.sqrt(keep**ages)[:, np.newaxis]
    basis = online.factor.basis
    gram = expected.T @ expected
    assert basis @ online.gram @ basis.T == pytest.approx(gram, abs=1e-7 * np.abs(gram).max())
    if blocks:
        first = online.factor.weights == 0.0
        assert np.abs(basis[:4][:, ~first]).max(initial=0.0) < 1e-12


def past_of(run: Run, recording: Recording, k: int, length: int) -> tuple[FloatArray, FloatArray]:
    """Return the last samples of a loop that continues its recording."""
    u, y = np.vstack([recording.u, run.u[:k]]), np.vstack([recording.y, run.y[:k]])
    return u[-length:], y[-length:]


CASES: dict[str, dict[str, Any]] = {
    "printed": {},
    "regulation": {**REGULATION, "output_weight": 1e3, "input_weight": 0.5},
    "projection": {"regulariser": "projection"},
    "affine": {"affine_sum": "all"},
    "equilibrium": {"regulariser": "equilibrium"},
    "equilibrium, slack on all outputs": {
        "regulariser": "equilibrium",
        "affine_sum": "all",
        "future_slack": True,
        "lambda_sigma": 1e4,
    },
    "soft, rates": {"soft_output_bounds": 1e3, "rate_bounds": 1.0},
}


@pytest.mark.parametrize("mode", ["sliding-window", "forgetting"])
@pytest.mark.parametrize("options", CASES.values(), ids=CASES)
def test_every_step_is_the_optimum_on_the_data_of_that_sample(
    paper_recording: Recording, options: dict[str, Any], mode: str
) -> None:
    controller = printed_deepc(online_data=mode, excitation_floor=0.0, forgetting_factor=0.97, **options)
    loop = replace(pendulum_loop(paper_recording, 2.5), continues_recording=True)
    run = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), 45)
    for k in range(0, 45, 3):
        u, y = np.vstack([paper_recording.u, run.u[:k]]), np.vstack([paper_recording.y, run.y[:k]])
        scale = None
        if mode == "sliding-window":
            u, y = u[k:], y[k:]
        else:
            ages = np.minimum(np.arange(193 + k)[::-1], k)  # the recording counts as one age
            scale = np.sqrt(0.97**ages)
        full = FullDeePC(controller, Recording(u, y, y, 0.1), loop.bounds, column_scale=scale)
        solution = full.solve(*past_of(run, paper_recording, k, 3), run.samples[k].reference)
        assert np.abs(solution.u[0] - run.u[k]).max() < 1e-6
    assert set(run.status) == {"ok"}


def test_400_steps_equal_the_full_problem(paper_recording: Recording) -> None:
    controller = printed_deepc(online_data="sliding-window", excitation_floor=0.0)
    loop = replace(pendulum_loop(paper_recording, 2.5), continues_recording=True)
    # A reference that never rests excites the loop to the end.
    reference = paper_reference() + np.random.default_rng(6).uniform(-0.1, 0.1, (420, 1))
    run = close_loop(controller, loop, quick_pendulum, ANGLE, reference, 400)
    active = 0
    for k in range(0, 400, 8):
        u, y = np.vstack([paper_recording.u, run.u[:k]])[k:], np.vstack([paper_recording.y, run.y[:k]])[k:]
        full = FullDeePC(controller, Recording(u, y, y, 0.1), loop.bounds)
        solution = full.solve(u[-3:], y[-3:], run.samples[k].reference)
        assert np.abs(solution.u[0] - run.u[k]).max() < 1e-6
        active += bool((np.abs(solution.u) > 0.99 * 2.5 - 1e-6).any())
    assert active > 5


def test_400_steps_equal_the_problem_factorised_anew_from_the_windows(paper_recording: Recording) -> None:
    controller = printed_deepc(online_data="sliding-window", excitation_floor=1e-3, dither=0.2)
    controller.start(pendulum_loop(paper_recording, 2.5))
    state, reference, active = np.zeros(2), paper_reference(), 0
    for k in range(400):
        sample = Sample(k, 0.1 * k, state[:1], state[:1], reference[k + 1 : k + 6], reference[k])
        twin = pickle.loads(pickle.dumps(controller))
        learner_of(twin).data.renew()
        u, anew = inputs(controller.step(sample)), inputs(twin.step(sample))
        assert np.abs(u - anew).max() < 1e-6
        active += bool(abs(u[0]) == 2.5)
        state = quick_pendulum(state, u)
    assert active > 20


def test_weights_far_apart_are_factorised_by_their_roots(paper_recording: Recording) -> None:
    weights: dict[str, Any] = {
        "lambda_g": 1e-9,
        "lambda_sigma": 1e11,
        "setpoint_weight": 1e6,
        "input_weight": 1e-9,
    }
    loop = pendulum_loop(paper_recording, 1e9, 1e9)
    reference = paper_reference()[1:6]
    for k in range(1, 4):
        moves = []
        for mode in ("frozen", "sliding-window"):
            controller = printed_deepc(online_data=mode, **weights)
            controller.start(loop)
            sample = Sample(0, 0.0, np.array([0.1 * k]), np.zeros(1), reference, reference[0])
            moves.append(inputs(controller.step(sample)))
        assert moves[0] == pytest.approx(moves[1], rel=1e-5)


def test_two_inputs_two_outputs_and_rank_deficient_data() -> None:
    rng = np.random.default_rng(4)
    plant = LinearPlant.random(rng, 3, 2, 2)
    recording = experiment(plant.advance, rng.uniform(-1.0, 1.0, (120, 2)), 3, plant.c)
    controller = printed_deepc(
        online_data="sliding-window", excitation_floor=0.0, lambda_g=0.1, output_weight=2.0, input_weight=0.1
    )
    loop = replace(make_loop(recording, 0.5 * np.ones(2), np.full(2, np.inf)), continues_recording=True)
    reference = np.repeat(rng.uniform(-1.0, 1.0, (8, 2)), 10, axis=0)
    changed = LinearPlant(plant.a, -plant.b, plant.c)

    def advance(state: FloatArray, u: FloatArray) -> FloatArray:
        return (plant if len(moves) < 20 else changed).advance(state, u)

    controller.start(loop)
    state, moves, outputs = recording.measured[-1], [], []
    state = plant.advance(state, recording.u[-1])
    for k in range(40):
        y = plant.c @ state
        sample = Sample(k, 0.1 * k, y, state, reference[k + 1 : k + 6], reference[k])
        u = inputs(controller.step(sample))
        past_u = np.vstack([recording.u, *moves]) if moves else recording.u
        past_y = np.vstack([recording.y, *outputs]) if outputs else recording.y
        if k % 4 == 0:
            window = Recording(past_u[k:], past_y[k:], past_y[k:], 0.1)
            solution = FullDeePC(controller, window, loop.bounds).solve(
                past_u[-3:], past_y[-3:], sample.reference
            )
            assert np.abs(solution.u[0] - u).max() < 1e-6
        state = advance(state, u)
        moves.append(u)
        outputs.append(y)
    assert controller.diagnostics()["online_factorisations"] > 1  # the change added directions to the data


@pytest.mark.parametrize("mode", ["sliding-window", "forgetting"])
@pytest.mark.parametrize("kind", [DeePC, WKPC])
def test_a_quiet_loop_keeps_the_data_that_it_has(state_recording: Recording, kind: Any, mode: str) -> None:
    still = np.full((1020, 1), 10.0 * DEGREE)
    controller = kind(online_data=mode, excitation_floor=0.1)
    close_loop(controller, pendulum_loop(state_recording), quick_pendulum, ANGLE, still, 1000)
    figures = controller.diagnostics()
    assert figures["online_excitation"] >= 0.1
    assert figures["online_windows_refused"] > 500.0
    assert figures["online_windows_refused"] + figures["online_windows_taken"] > 990.0


def test_without_the_guard_a_quiet_loop_destroys_its_data(paper_recording: Recording) -> None:
    still = np.full((520, 1), 10.0 * DEGREE)
    controller = printed_deepc(online_data="sliding-window", excitation_floor=0.0)
    close_loop(controller, pendulum_loop(paper_recording), quick_pendulum, ANGLE, still, 500)
    assert controller.diagnostics()["online_excitation"] < 1e-6


def errors_after_the_flip(controller: Controller, recording: Recording) -> FloatArray:
    """Turn the control direction at sample 200; return the mean error of each following 100 samples [deg]."""
    count = 0

    def flipping(state: FloatArray, torque: FloatArray) -> FloatArray:
        nonlocal count
        count += 1
        return quick_pendulum(state, torque if count <= 200 else -torque)

    reference = np.vstack([paper_reference(0), paper_reference()])
    run = close_loop(controller, pendulum_loop(recording), flipping, ANGLE, reference, 800)
    error = np.abs(run.y - reference[:800])[200:, 0] / DEGREE
    return error.reshape(6, 100).mean(axis=1)


@pytest.mark.parametrize("seed", [5489, 1, 2])
@pytest.mark.parametrize(
    "options",
    [{"online_data": "sliding-window", "dither": 0.5}, {"online_data": "forgetting"}],
    ids=["sliding-window", "forgetting"],
)
def test_online_data_recover_from_a_change_of_direction_about_a_recordings_length_later(
    seed: int, options: dict[str, Any]
) -> None:
    recording = pendulum_experiment(seed)
    frozen = errors_after_the_flip(printed_deepc(), recording)
    online = errors_after_the_flip(printed_deepc(**options), recording)
    assert frozen.min() > 10.0
    assert online[0] > 10.0
    assert online[2:].max() < 4.0


def test_wkpc_recovers_too(state_recording: Recording) -> None:
    frozen = errors_after_the_flip(printed_wkpc(), state_recording)
    online = errors_after_the_flip(printed_wkpc(online_data="sliding-window", dither=0.5), state_recording)
    assert frozen[2:].mean() > 10.0
    assert online[3:].mean() < 4.0


def test_wkpc_on_learned_data_equals_wkpc_on_them_recorded(state_recording: Recording) -> None:
    """Windows learned in a loop that continues its recording are those of the longer recording."""
    loop = replace(pendulum_loop(state_recording, degrees=170.0), continues_recording=True)
    controller = printed_wkpc(online_data="sliding-window", excitation_floor=0.0)
    run = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), 60)
    states = np.array([sample.measured for sample in run.samples])
    history = [
        np.vstack(pair)
        for pair in zip(
            (state_recording.u, state_recording.y, state_recording.measured),
            (run.u[:59], run.y[:59], states[:59]),
            strict=True,
        )
    ]
    newest = Recording(*(signal[-200:] for signal in history), 0.1)
    frozen = printed_wkpc()
    frozen.start(replace(loop, recording=newest))
    answer = frozen.step(run.samples[59])
    assert inputs(answer) == pytest.approx(run.u[59], abs=1e-6)


@pytest.mark.parametrize("kind", [DeePC, WKPC])
@pytest.mark.parametrize("mode", ["sliding-window", "forgetting"])
def test_runs_repeat_and_pickle_and_hold_their_bounds(
    state_recording: Recording, kind: Any, mode: str
) -> None:
    loop = pendulum_loop(state_recording, 2.5, 170.0)
    controller = kind(online_data=mode, dither=0.4)
    first = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), 60)
    assert np.array_equal(
        first.u, close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), 60).u
    )
    assert np.abs(first.u).max() <= 2.5
    twin = pickle.loads(pickle.dumps(controller))
    state = first.samples[-1].measured
    sample = Sample(60, 6.0, state[:1], state, np.full((5, 1), 0.1), np.full(1, 0.1))
    assert np.array_equal(inputs(controller.step(sample)), inputs(twin.step(sample)))


def test_a_measurement_that_is_not_finite_is_not_learned(paper_recording: Recording) -> None:
    controller = printed_deepc(online_data="sliding-window")
    loop: Loop = pendulum_loop(paper_recording)
    controller.start(loop)
    reference = np.full((5, 1), 0.1)
    statuses = []
    for k in range(40):
        y = np.array([np.nan if k == 15 else 0.01 * np.sin(k)])
        answer = controller.step(Sample(k, 0.1 * k, y, y, reference, reference[0]))
        statuses.append(answer.status if isinstance(answer, Action) else "ok")
    assert "not finite" in statuses[15]
    assert set(statuses[:15] + statuses[16:]) == {"ok"}
    assert controller.diagnostics()["online_windows_refused"] == 8.0
    assert np.isfinite(learner_of(controller).data.gram).all()


def test_dither_needs_one_number_per_input(paper_recording: Recording) -> None:
    controller = printed_deepc(online_data="sliding-window", dither=[0.1, 0.1])
    with pytest.raises(ConfigError, match=r"dither has shape \(2,\)"):
        controller.start(pendulum_loop(paper_recording))


@pytest.mark.parametrize("kind", [PublishedDeePC, PublishedWKPC])
def test_the_published_programs_have_no_data_to_update(kind: type[Controller]) -> None:
    with pytest.raises(ConfigError, match="online_data"):
        kind(online_data="forgetting")


def test_windows_start_with_the_loop(paper_recording: Recording) -> None:
    """From rest, the first window is complete after Tini + N samples of the loop."""
    controller = printed_deepc(online_data="sliding-window", excitation_floor=0.0)
    loop = pendulum_loop(paper_recording)
    run = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), 20)
    assert controller.diagnostics()["online_windows_taken"] == 13.0
    windows = learner_of(controller).data._windows
    expected = np.concatenate([run.u[:3], run.y[:3], run.u[3:8], run.y[3:8]])[:, 0]
    assert np.array_equal(windows[0], expected)
    assert before(run.u, np.zeros(1), 3, 3) == pytest.approx(run.u[:3])
