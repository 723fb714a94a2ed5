"""Several recordings in one: no controller sees a window that crosses a seam."""

from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from ddpc_controllers import (
    GPC,
    IPID,
    LQR,
    MFAPC,
    MPC,
    PID,
    DeePC,
    Delays,
    Gaussian,
    KoopmanMPC,
    OffsetFree,
    Scaled,
    hankel_matrix,
    persistency_of_excitation,
)
from ddpc_controllers.data.dictionaries import embed
from ddpc_controllers.data.hankel import count_windows, window_starts, without_first
from ddpc_controllers.koopman_mpc import fit_lifted_model
from ddpc_controllers.models.identification import choose_lags, fit_arx, markov_parameters
from ddpc_controllers.offset_free import step_gain
from ddpc_controllers.pid import fit_second_order
from ddpc_controllers.published import PublishedDeePC, PublishedWKPC
from ddpc_cosim import Controller, DataError, FloatArray, Recording

from .loops import (
    ANGLE,
    PRINTED,
    SAMPLING_TIME,
    LinearPlant,
    close_loop,
    experiment,
    paper_reference,
    pendulum_experiment,
    pendulum_loop,
    printed_deepc,
    printed_wkpc,
    quick_pendulum,
    regulating_gamma_ddpc,
    regulating_spc,
)

LEARNING: dict[str, Controller] = {
    "deepc": printed_deepc(),
    "deepc-projection": printed_deepc(regulariser="projection", affine_sum="all"),
    "deepc-equilibrium": printed_deepc(regulariser="equilibrium"),
    "deepc-l1": printed_deepc(regulariser="l1", lambda_g=1e-3),
    "deepc-sliding": printed_deepc(online_data="sliding-window", dither=0.2),
    "deepc-forgetting": printed_deepc(online_data="forgetting", dither=0.2, use_current_output=True),
    "spc": regulating_spc(),
    "gamma-ddpc": regulating_gamma_ddpc(),
    "wkpc": printed_wkpc(),
    "wkpc-delays": printed_wkpc(dictionary=Delays(samples=2, dictionary=Gaussian(count=4))),
    "koopman": KoopmanMPC(),
    "koopman-clusters": KoopmanMPC(dictionary=Gaussian(count=4, centres="data")),
    "koopman-delays": KoopmanMPC(state="delays", dictionary=Delays(samples=2)),
    "gpc": GPC(),
    "mpc": MPC(),
    "lqr": LQR(),
    "pid": PID(tuning="step-test"),
    "pid-virtual-reference": PID(tuning="virtual-reference"),
    "scaled": Scaled(controller=printed_deepc()),
    "offset-free": OffsetFree(controller=printed_deepc()),
}
FIRST, SECOND = pendulum_experiment(1), pendulum_experiment(2)
STEPS = 60


def one_row(value: float) -> Recording:
    row = np.full((1, 1), value)
    return Recording(row, row, np.array([[value, 0.0]]), SAMPLING_TIME)


def trajectory(controller: Controller, recording: Recording) -> FloatArray:
    loop = pendulum_loop(recording, torque=2.5, degrees=170.0)
    return close_loop(deepcopy(controller), loop, quick_pendulum, ANGLE, paper_reference(), STEPS).u


# What a sliding window replaces first is what was recorded first.
@pytest.mark.parametrize("name", sorted(LEARNING.keys() - {"deepc-sliding"}))
def test_the_order_of_recordings_does_not_matter(name: str) -> None:
    one_way = trajectory(LEARNING[name], Recording.join([FIRST, SECOND]))
    assert trajectory(LEARNING[name], Recording.join([SECOND, FIRST])) == pytest.approx(one_way, abs=1e-9)
    assert not np.allclose(one_way, trajectory(LEARNING[name], FIRST), atol=1e-9)


@pytest.mark.parametrize("name", LEARNING)
def test_a_piece_of_one_sample_says_nothing(name: str) -> None:
    """It moves the sizes by which signals are scaled, and with them what a ridge is to a coefficient."""
    alone = trajectory(LEARNING[name], Recording.join([FIRST, SECOND]))
    with_it = trajectory(LEARNING[name], Recording.join([FIRST, one_row(0.01), SECOND]))
    assert with_it == pytest.approx(alone, abs=1e-3)


class HandStacked(DeePC):
    """DeePC on windows that are written down one by one."""

    parts: tuple[Recording, ...] = ()

    def _stack(self, recording: Recording) -> FloatArray:
        super()._stack(recording)
        past, depth = self.initial_length, self.initial_length + self.horizon
        columns = [
            np.concatenate(
                [
                    part.u[j : j + past].ravel(),
                    part.y[j : j + past].ravel(),
                    part.u[j + past : j + depth].ravel(),
                    part.y[j + past : j + depth].ravel(),
                ]
            )
            for part in self.parts
            for j in range(len(part) - depth + 1)
        ]
        return np.array(columns).T


def test_deepc_learns_from_the_windows_of_each_recording() -> None:
    by_hand = HandStacked(**PRINTED)
    by_hand.parts = (FIRST, SECOND)
    joined = Recording.join([FIRST, SECOND])
    assert trajectory(by_hand, joined) == pytest.approx(trajectory(printed_deepc(), joined), abs=1e-12)


@pytest.mark.parametrize("controller", [PublishedDeePC(), PublishedWKPC()], ids=["deepc", "wkpc"])
def test_the_published_programs_know_one_recording(controller: Controller) -> None:
    with pytest.raises(DataError, match="learn from one experiment; there are 2"):
        controller.start(pendulum_loop(Recording.join([FIRST, SECOND])))


@st.composite
def cuts(draw: Any) -> tuple[int, tuple[int, ...]]:
    samples = draw(st.integers(2, 40))
    return samples, tuple(sorted(draw(st.sets(st.integers(1, samples - 1), max_size=6))))


@given(cut=cuts(), depth=st.integers(1, 12), width=st.integers(1, 3))
def test_windows_of_a_mosaic_are_those_of_its_pieces(
    cut: tuple[int, tuple[int, ...]], depth: int, width: int
) -> None:
    samples, seams = cut
    w = np.random.default_rng(samples).standard_normal((samples, width))
    pieces = [piece for piece in np.split(w, seams) if len(piece) >= depth]
    assert count_windows(samples, depth, seams) == sum(len(piece) - depth + 1 for piece in pieces)
    if not pieces:
        with pytest.raises(DataError, match=f"a window of {depth} samples needs as many samples in a row"):
            window_starts(samples, depth, seams)
        return
    expected = np.hstack([hankel_matrix(piece, depth) for piece in pieces])
    assert np.array_equal(hankel_matrix(w, depth, seams), expected)
    states = np.vstack([embed(piece, depth - 1) for piece in pieces])
    assert np.array_equal(embed(w, depth - 1, seams), states)


@given(cut=cuts(), memory=st.integers(0, 5))
def test_what_has_a_past_keeps_its_seams(cut: tuple[int, tuple[int, ...]], memory: int) -> None:
    samples, seams = cut
    rows = np.arange(float(samples))[:, np.newaxis]
    pieces = [piece[memory:] for piece in np.split(rows, seams) if len(piece) > memory]
    if not pieces:
        return
    left = without_first(Recording(rows, rows, rows, 1.0, seams), memory)
    assert [piece.u.tolist() for piece in left.pieces] == [piece.tolist() for piece in pieces]


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 1000), lengths=st.lists(st.integers(1, 30), min_size=1, max_size=5))
def test_excitation_of_a_mosaic_is_the_rank_of_its_windows(seed: int, lengths: list[int]) -> None:
    """Orders are those of the definition, tried one by one."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((sum(lengths), 2))
    seams = tuple(np.cumsum(lengths)[:-1].tolist())
    pieces = np.split(u, seams)
    order = 0
    while True:
        windows = [hankel_matrix(piece, order + 1) for piece in pieces if len(piece) > order]
        if not windows or np.linalg.matrix_rank(np.hstack(windows)) < 2 * (order + 1):
            break
        order += 1
    assert persistency_of_excitation(u, seams=seams) == order


def linear_mosaic(
    rng: np.random.Generator, plant: LinearPlant, lengths: list[int], delay: int = 0
) -> Recording:
    """Record a plant from several states; the output of a delayed input cannot be joined across a seam."""
    parts = []
    for length in lengths:
        u = rng.standard_normal((length + delay, plant.b.shape[1]))
        state = 5.0 * rng.standard_normal(len(plant.a))
        states = np.empty((length, len(state)))
        for k in range(length):
            states[k] = state
            state = plant.advance(state, u[k])
        parts.append(Recording(u[delay:], states @ plant.c.T, states, SAMPLING_TIME))
    return Recording.join(parts)


def test_models_of_a_mosaic_without_noise_are_exact() -> None:
    """One equation across a seam would spoil them: each piece begins in a state of its own."""
    rng = np.random.default_rng(3)
    plant = LinearPlant.random(rng, order=2, inputs=2, outputs=1)
    recording = linear_mosaic(rng, plant, [40, 1, 2, 25, 3])
    impulse = np.array([plant.c @ np.linalg.matrix_power(plant.a, i) @ plant.b for i in range(30)])
    assert choose_lags(recording) == 2
    model = fit_arx(recording, 2)
    assert model.fit["one_step_error"] < 1e-10
    assert markov_parameters(model, 30) == pytest.approx(impulse, abs=1e-8)
    spread = recording.u.std(axis=0) / recording.y.std(axis=0)[:, np.newaxis]
    assert step_gain(recording, 30) == pytest.approx(impulse.sum(axis=0) * spread, rel=1e-6)
    lifted = fit_lifted_model(recording.measured, recording.u, recording.y, seams=recording.seams)
    assert lifted.fit["one_step_error"] < 1e-10
    assert lifted.a == pytest.approx(plant.a, abs=1e-9)
    assert lifted.b == pytest.approx(plant.b, abs=1e-9)


@pytest.mark.parametrize("delay", [0, 3])
def test_a_step_test_finds_the_dead_time_of_a_mosaic(delay: int) -> None:
    rng = np.random.default_rng(4)
    poles = 0.9, 0.7
    plant = LinearPlant(np.array([[0.9, 1.0], [0.0, 0.7]]), np.array([[1.0], [0.1]]), np.array([[1.0, 0.0]]))
    recording = linear_mosaic(rng, plant, [60, 1, 30, 50], delay)
    model, _ = fit_second_order(recording, 0, 0)
    assert model.delay == pytest.approx(delay * SAMPLING_TIME, abs=0.02)
    assert sorted(np.exp(np.array(model.poles).real * SAMPLING_TIME)) == pytest.approx(
        sorted(poles), abs=1e-6
    )
    assert model.gain == pytest.approx((1.0 * 0.3 + 0.1) / (0.1 * 0.3), rel=1e-6)


@pytest.mark.parametrize("controller", [MFAPC(), IPID(alpha=5.0)], ids=["mfapc", "ipid"])
def test_a_loop_goes_on_from_the_last_piece(controller: Controller) -> None:
    """What went before the seam is not the past of the loop."""
    runs = []
    for first in (FIRST, pendulum_experiment(3)):
        loop = replace(pendulum_loop(Recording.join([first, SECOND])), continues_recording=True)
        runs.append(close_loop(deepcopy(controller), loop, quick_pendulum, ANGLE, paper_reference(), 5))
    assert np.array_equal(runs[0].u, runs[1].u)


def test_seams_and_what_is_joined_are_checked() -> None:
    joined = Recording.join([FIRST, Recording.join([one_row(0.0), SECOND])])
    assert joined.seams == (200, 201)
    assert [len(piece) for piece in joined.pieces] == [200, 1, 200]
    assert all(
        np.array_equal(a.u, b.u) for a, b in zip(joined.pieces, [FIRST, one_row(0.0), SECOND], strict=True)
    )
    rows = np.zeros((3, 1))
    for seams in [(0,), (3,), (2, 1), (1, 1), (-1,)]:
        with pytest.raises(DataError, match="needed: rows from 1 to 2, in order"):
            Recording(rows, rows, rows, 0.1, seams)
    with pytest.raises(DataError, match=r"different sampling times: .*0\.1, 0\.2"):
        Recording.join([Recording(rows, rows, rows, 0.1), Recording(rows, rows, rows, 0.2)])
    with pytest.raises(DataError, match=r"\(1, 1, 1, 0, 0\), \(1, 1, 2, 0, 0\)"):
        Recording.join([Recording(rows, rows, rows, 0.1), FIRST])
    with pytest.raises(DataError, match="none to join"):
        Recording.join([])
    short = Recording.join([experiment(quick_pendulum, FIRST.u[:10], 2, ANGLE)] * 40)
    with pytest.raises(DataError, match="400 samples in 40 pieces, of which each needs more"):
        printed_deepc().start(pendulum_loop(short))
