"""The solvers behind the active sets: they agree, and say what they need and what cannot be met."""

import pickle
import sys
from collections.abc import Callable

import numpy as np
import pytest

from ddpc_controllers import MPC, WKPC, DeePC, KoopmanMPC
from ddpc_controllers.backends import BACKENDS, contradiction, make_backend
from ddpc_controllers.full_problem import FullDeePC
from ddpc_cosim import ConfigError, Controller, Recording

from .loops import ANGLE, before, close_loop, paper_reference, pendulum_loop, quick_pendulum
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


@pytest.mark.parametrize("name", BACKENDS)
def test_each_says_where_there_is_no_optimum(name: str) -> None:
    backend = make_backend(name)
    backend.load(np.array([[1.0], [-1.0], [0.5]]))
    assert backend.solve(np.array([0.5, 0.5, -9.0])).failure


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


@pytest.mark.parametrize("name", BACKENDS)
def test_400_steps_with_active_bounds_equal_the_full_problem(paper_recording: Recording, name: str) -> None:
    controller = DeePC(horizon=20, backend=name)
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
    [lambda name: WKPC(backend=name), lambda name: MPC(backend=name), lambda name: KoopmanMPC(backend=name)],
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
    with pytest.raises(ConfigError, match=r"install ddpc-cosim\[daqp\], or use backend = 'piqp'"):
        DeePC(backend="daqp").start(pendulum_loop(paper_recording))
    with pytest.raises(ConfigError, match="daqp"):
        WKPC(backend="daqp").start(pendulum_loop(paper_recording))
