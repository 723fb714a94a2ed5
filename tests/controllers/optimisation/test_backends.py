"""The solvers behind the active sets: they agree, and say what they need and what cannot be met."""

import pickle
import sys
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from ddpc_controllers import MPC, DeePC, KoopmanMPC
from ddpc_controllers.optimisation.backends import (
    BACKENDS,
    Answer,
    Backend,
    contradiction,
    make_backend,
    nearest_feasible,
)
from ddpc_cosim import Action, ConfigError, Controller, FloatArray, Recording, Sample

from ..full_problem import FullDeePC
from ..loops import (
    ANGLE,
    Run,
    before,
    close_loop,
    paper_reference,
    pendulum_loop,
    printed_deepc,
    printed_wkpc,
    quick_pendulum,
)
from .test_qp import least_distance


@pytest.mark.parametrize("name", BACKENDS)
def test_each_finds_the_optimum_and_its_active_set(name: str) -> None:
    rng = np.random.default_rng(2)
    backend = make_backend(name)
    for size in (3, 9):
        gain = rng.standard_normal((6, size))
        backend.load(gain)
        for _ in range(5):
            excess = rng.uniform(-1.0, 0.5, 6)
            excess[0] = 0.3
            t, active, failure = backend.solve(excess)
            expected = least_distance(gain, excess)
            assert failure == ""
            assert t == pytest.approx(expected, abs=1e-6)
            assert set(active) == set(np.flatnonzero(excess + gain @ expected > -1e-7))


@given(seed=st.integers(0, 2**32 - 1), active=st.integers(1, 6), far=st.floats(0.0, 9.0))
@settings(max_examples=200, deadline=None)
def test_the_bounds_of_an_optimum_are_found_however_far_it_is(seed: int, active: int, far: float) -> None:
    """By its optimality conditions: multipliers are drawn, and the excess that they belong to."""
    rng = np.random.default_rng(seed)
    gain, slack = rng.standard_normal((14, 8)), rng.uniform(0.1, 1.0, 14)
    multipliers = np.zeros(14)
    multipliers[:active] = 10.0**far * rng.uniform(0.1, 1.0, active)
    slack[:active] = 0.0
    excess = gain @ gain.T @ multipliers - slack
    assume(np.linalg.cond(gain[:active]) < 1e3)
    scales = 10.0 ** rng.uniform(-2.0, 2.0, 14)
    assert nearest_feasible(scales[:, np.newaxis] * gain, scales * excess, 1e-11) == tuple(range(active))


def test_no_bounds_are_those_of_an_optimum_where_there_is_none() -> None:
    gain = np.array([[1.0, 0.0], [-1.0, 0.0], [0.5, 1.0]])
    assert nearest_feasible(gain, np.array([0.5, 0.5, -9.0]), 1e-11) == ()


@pytest.mark.parametrize("name", BACKENDS)
def test_each_says_where_there_is_no_optimum(name: str) -> None:
    backend = make_backend(name)
    backend.load(np.array([[1.0], [-1.0], [0.5]]))
    assert backend.solve(np.array([0.5, 0.5, -9.0])).failure


@pytest.mark.parametrize("name", BACKENDS)
def test_each_recovers_from_a_problem_without_a_solution(name: str) -> None:
    backend = make_backend(name)
    backend.load(np.array([[1.0], [-1.0], [0.0]]))
    for hopeless in ([0.5, 0.5, -1.0], [0.5, -9.0, 0.1]):  # contradictory; exceeded whatever t is
        assert backend.solve(np.array(hopeless)).failure
        answer = backend.solve(np.array([0.5, -9.0, -1.0]))
        assert answer.failure == ""
        assert answer.t == pytest.approx([-0.5], abs=1e-9)


@pytest.mark.parametrize("name", BACKENDS)
@settings(max_examples=60, deadline=None)
@given(st.integers(1, 8), st.integers(1, 5), st.floats(-9.0, 9.0), st.integers(0, 2**32 - 1))
def test_sizes_of_bounds_and_weights_do_not_matter(
    name: str, n: int, size: int, exponent: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    gain, rows, weight = rng.standard_normal((n, size)), 10.0 ** rng.uniform(-4.0, 4.0, n), 10.0**exponent
    excess = rng.uniform(-1.0, 0.5, n)
    expected = least_distance(gain, excess)
    assume(excess.max() > 0.0 and expected is not None and np.abs(expected).max() < 1e3)
    backend = make_backend(name)
    backend.load(weight * rows[:, np.newaxis] * gain)
    t, _, failure = backend.solve(rows * excess)
    assert failure == ""
    assert weight * t == pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("name", BACKENDS)
def test_each_can_be_pickled_after_use(name: str) -> None:
    backend = make_backend(name)
    backend.load(-np.eye(2))
    excess = np.array([0.3, -0.2])
    before_it = backend.solve(excess)
    assert np.array_equal(pickle.loads(pickle.dumps(backend)).solve(excess).t, before_it.t)


def test_a_contradiction_is_found_and_nothing_else() -> None:
    gain = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]])
    assert contradiction(gain, np.array([0.5, 0.2, 0.5])) == (0, 2)
    assert contradiction(gain, np.array([0.5, 0.2, -0.6])) == ()


@pytest.mark.parametrize("size", [1e-12, 1.0, 1e12])
def test_a_contradiction_does_not_depend_on_the_size_of_the_gain(size: float) -> None:
    gain = size * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [1e-20, 0.0]])
    assert contradiction(gain, np.array([0.5, 0.2, 0.5, -0.1])) == (0, 2)
    assert contradiction(gain, np.array([0.5, 0.2, -0.6, -0.1])) == ()
    assert contradiction(gain, np.array([0.5, 0.2, -0.6, 0.1])) == (3,)


@pytest.mark.parametrize("name", BACKENDS)
@pytest.mark.parametrize("kind", [DeePC, MPC])
def test_a_common_factor_of_all_weights_changes_nothing(
    paper_recording: Recording, name: str, kind: Callable[..., Controller]
) -> None:
    def weighed(factor: float) -> FloatArray:
        weights = {"output_weight": 100.0, "input_weight": 0.1, "setpoint_weight": 300.0}
        if kind is DeePC:
            weights |= {"lambda_g": 0.1, "lambda_sigma": 1e4}
        scaled = {name: factor * weight for name, weight in weights.items()}
        controller = kind(horizon=6, rate_bounds=0.4, backend=name, **scaled)
        loop = pendulum_loop(paper_recording, 1.5)
        run = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), 150)
        assert set(run.status) == {"ok"}
        return run.u

    expected = pytest.approx(weighed(1.0), abs=1e-8)
    for factor in (1e-8, 1e8, 1e12):
        assert weighed(factor) == expected


@pytest.mark.parametrize("name", BACKENDS)
def test_the_solver_stands_when_the_loop_starts(
    paper_recording: Recording, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller = printed_deepc(backend=name)
    loop = pendulum_loop(paper_recording, 1.0)
    controller.start(loop)
    monkeypatch.delattr("piqp.DenseSolver")
    monkeypatch.delattr("daqp.Model")
    reference = np.full((5, 1), 1.0)
    answer = controller.step(Sample(0, 0.0, np.zeros(1), np.zeros(1), reference, reference[0]))
    assert isinstance(answer, Action)
    assert np.array_equal(answer.u, [1.0])


class Pessimist:
    """A backend that finds the optimum and does not believe it."""

    def __init__(self, backend: Backend) -> None:
        self._backend, self.load = backend, backend.load

    def solve(self, excess: FloatArray) -> Answer:
        return self._backend.solve(excess)._replace(failure="GIVEN_UP")


@pytest.mark.parametrize("online_data", ["frozen", "sliding-window"])
def test_a_solver_that_gives_up_at_the_optimum_is_not_believed(
    paper_recording: Recording, online_data: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run() -> Run:
        controller = printed_deepc(horizon=12, online_data=online_data)
        loop = pendulum_loop(paper_recording, 1.5)
        return close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), 150)

    believed = run()

    def pessimist(name: str) -> Pessimist:
        return Pessimist(make_backend(name))

    monkeypatch.setattr("ddpc_controllers.deepc.make_backend", pessimist)
    again = run()
    assert set(again.status) == {"ok"}
    assert again.u == pytest.approx(believed.u, abs=1e-9)


@pytest.mark.parametrize("name", BACKENDS)
def test_400_steps_with_active_bounds_equal_the_full_problem(paper_recording: Recording, name: str) -> None:
    controller = printed_deepc(horizon=20, backend=name)
    loop = pendulum_loop(paper_recording, 2.0)
    run = close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), 400)
    full = FullDeePC(controller, paper_recording, loop.bounds)
    active = 0
    for k in range(0, 400, 4):
        past = before(run.u, np.zeros(1), k, 3), before(run.y, run.y[0], k, 3)
        solution = full.solve(*past, run.samples[k].reference)
        assert np.abs(solution.u[0] - run.u[k]).max() < 1e-6
        active += bool((np.abs(solution.u) > 0.99 * 2.0 - 1e-6).any())
    assert active > 20
    assert set(run.status) == {"ok"}


@pytest.mark.parametrize(
    "settings",
    [
        lambda name: printed_wkpc(backend=name),
        lambda name: MPC(backend=name),
        lambda name: KoopmanMPC(backend=name),
    ],
)
def test_the_other_methods_find_the_same_with_either(
    state_recording: Recording, settings: Callable[[str], Controller]
) -> None:
    loop = pendulum_loop(state_recording, 1.7)
    piqp, daqp = (
        close_loop(settings(name), loop, quick_pendulum, ANGLE, paper_reference(), 150) for name in BACKENDS
    )
    assert (np.abs(piqp.u) > 1.7 - 1e-9).sum() > 5
    assert daqp.u == pytest.approx(piqp.u, abs=1e-6)


def test_a_solver_that_is_not_installed_is_an_error_that_says_how_to_get_it(
    paper_recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "daqp", None)
    with pytest.raises(ConfigError, match=r"daqp.* or use backend = 'piqp'"):
        printed_deepc(backend="daqp").start(pendulum_loop(paper_recording))
    with pytest.raises(ConfigError, match="daqp"):
        printed_wkpc(backend="daqp").start(pendulum_loop(paper_recording))
