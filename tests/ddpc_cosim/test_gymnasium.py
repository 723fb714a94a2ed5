"""Problems as environments: the same runs as ``run`` makes, judged by the same figures."""

import pickle
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from fmus.builder import Fault
from gymnasium.utils.env_checker import check_env
from studies import cases_in, study_text, write

from ddpc_cosim import (
    Band,
    Conditions,
    ConfigError,
    FloatArray,
    GaussianNoise,
    KnownDisturbance,
    Normal,
    Plant,
    Price,
    Problem,
    Sine,
    Steps,
    Study,
    Trace,
    UniformRandom,
    Variable,
)
from ddpc_cosim.gymnasium import ProblemEnv, SavedState, make
from ddpc_cosim.study.case_runs import run_case
from ddpc_cosim.study.cases import cases_of

# What Gymnasium's own tests leave out too: advice on bounds and on actions from -1 to 1.
ADVICE = (".*A Box .* space m(in|ax)imum value is", ".*For Box action spaces, we recommend")
PROBLEMS = [name for name in gymnasium.registry if name.startswith("ddpc_cosim/")]
QUICK = ("ddpc_cosim/pendulum-v1",)
PENDULUM = {"plant": "pendulum", "inputs": ["torque"], "outputs": ["angle"], "sampling_time": 0.1}


@contextmanager
def without_advice() -> Iterator[None]:
    with warnings.catch_warnings():
        for message in ADVICE:
            warnings.filterwarnings("ignore", message)
        yield


def episode(env: ProblemEnv, actions: Any, **how: Any) -> tuple[list[FloatArray], list[float], bool, Any]:
    """Return observations, rewards, whether a fault has ended it, and what is said of the end."""
    seen, rewards = [env.reset(**how)[0]], []
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action)
        seen.append(observation)
        rewards.append(float(reward))
        if terminated or truncated:
            break
    return seen, rewards, terminated, info


class House(Plant):
    """A room that loses heat to the weather, and the power of its heater."""

    inputs = (
        Variable("heat", "W", 0.0, 3000.0, nominal=1000.0),
        Variable("weather", "K", nominal=280.0, start=275.0),
    )
    outputs = (Variable("room", "K", nominal=293.0), Variable("power", "W"))

    def reset(self, parameters: Any = None, t0: float = 0.0) -> FloatArray:
        self.room, self.time = 291.0, t0
        return np.array([self.room, 0.0])

    def step(self, u: FloatArray, h: float) -> FloatArray:
        loss = 100.0 * (self.room - u[1])
        self.room += h * (u[0] - loss) / 1e6
        self.time += h
        return np.array([self.room, 1.1 * u[0] + self.room - 290.0])


class Escapes(House):
    """It ends where an input is too large."""

    def step(self, u: FloatArray, h: float) -> FloatArray:
        y = super().step(u, h)
        return y * np.nan if u[0] > 2000.0 else y


class FailsWithinAnInterval(House):
    """It ends at 1600 s."""

    def step(self, u: FloatArray, h: float) -> FloatArray:
        y = super().step(u, h)
        return y * np.nan if self.time > 1500.0 else y


def house(plant: type[Plant] = House, **more: Any) -> Problem:
    weather = KnownDisturbance(signal=Sine(5.0, 1 / 86400.0, offset=275.0), known="perfect")
    tables: dict[str, Any] = {
        "plant": plant,
        "inputs": ["heat"],
        "outputs": ["room"],
        "measurements": ["room", "power"],
        "reference": Band(lower=Steps([0, 1800], [292.0, 294.0]), upper=296.0),
        "disturbances": {"weather": weather},
        "prices": {"electricity": Price(signal="power", price=Steps([0, 2400], [0.3, 0.1]), unit="EUR/kWh")},
        "sampling_time": 600.0,
        "duration": 6000.0,
    }
    return Problem(**tables | more)


def drawn(low: float, high: float, samples: int) -> FloatArray:
    return np.random.default_rng(0).uniform(low, high, (samples, 1))


def of(problem: Problem, **how: Any) -> ProblemEnv:
    return make(Study(problem, {"nothing": "idle"}), **how)


def test_the_problems_of_the_benchmark_are_registered() -> None:
    assert len(PROBLEMS) == 17
    env = gymnasium.make("ddpc_cosim/pendulum-v1", scenario="noise", horizon=2)
    own = env.unwrapped
    assert isinstance(own, ProblemEnv)
    assert own.observation_names == ("angle", "setpoint.angle", "reference.angle[1]", "reference.angle[2]")
    assert (own.observation_units, own.action_names, own.action_units) == (
        ("rad",) * 4,
        ("torque",),
        ("N.m",),
    )
    assert env.action_space == gymnasium.spaces.Box(-3.5, 3.5, (1,), np.float64)
    env.close()


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in PROBLEMS]
)
def test_gymnasium_accepts_them(name: str) -> None:
    env = gymnasium.make(name)
    with without_advice():
        check_env(env.unwrapped)
    env.close()


def disturbed() -> Problem:
    """A problem in which all is random that can be."""
    return Problem(
        **PENDULUM,
        duration=2.0,
        reference=Steps([0, 0.5], [0.0, 0.3]),
        bounds={"torque": (-3.5, 3.5)},
        excitation=UniformRandom(-1.0, 1.0, samples=30),
        parameters={"mass": Normal(1.0, 0.1, low=0.5)},
        noise=GaussianNoise({"angle": 0.01}),
        conditions=Conditions(
            disturbances={"torque": Steps([1.0], [0.4])}, delay={"torque": 0.1}, loss={"angle": 0.2}
        ),
        preview=3,
    )


@pytest.mark.parametrize("sampling", ["independent", "latin-hypercube"])
def test_a_seed_gives_the_run_that_it_gives_in_a_study(sampling: str) -> None:
    """What a controller has done there, done here, leads to the same signals to the last bit."""
    study = Study(replace(disturbed(), sampling=sampling), {"PID": "pid"}, seeds=[3, 4])
    problem = study.resolved().problem
    env = make(study, horizon=5)
    for case in cases_of(problem, problem.plant.built()):
        run = run_case(case)
        seen, _, terminated, info = episode(env, run.u, seed=case.seed)
        trace = env.trace
        assert (terminated, info["outcome"]) == (False, "completed")
        assert trace is not None
        assert len(trace) == len(run) == 21
        for table in ("time", "y", "reference", "applied"):
            np.testing.assert_array_equal(getattr(trace, table)[:-1], getattr(run, table)[:-1])
        lost = np.isnan(run.measured)  # what is seen in its place is the last value that has arrived
        assert lost.any()
        np.testing.assert_array_equal(trace.measured[~lost], run.measured[~lost])
        np.testing.assert_array_equal(trace.u[:-1], run.u[:-1])
        np.testing.assert_array_equal(trace.y, run.y)
        assert env.observation_names[2:] == tuple(f"reference.angle[{k}]" for k in (1, 2, 3))
        ahead = np.minimum(np.arange(20)[:, np.newaxis] + np.arange(4), 20)
        np.testing.assert_array_equal(np.array(seen)[:17, 1:], run.reference[:, 0][ahead][:17])
    env.close()


def test_without_a_seed_each_episode_has_another_one() -> None:
    env = of(disturbed())
    env.reset(seed=1)
    seeds = [env.reset()[1]["seed"] for _ in range(3)]
    env.reset(seed=1)
    assert len({*seeds}) == 3
    assert [env.reset()[1]["seed"] for _ in range(3)] == seeds
    env.close()


def figure(env: ProblemEnv, trace: Trace) -> float:
    """Return what the study ranks by, as metrics.csv has it, with the weights of the reward."""
    metrics = trace.metrics()
    return sum(weight * metrics[key] for key, weight in env.figures.items())


def test_rewards_sum_to_minus_the_mean_error() -> None:
    env = of(disturbed())
    _, rewards, _, _ = episode(env, drawn(-3.5, 3.5, 20), seed=0)
    assert env.trace is not None
    errors = np.rad2deg(np.abs(env.trace.reference - env.trace.y)[:20, 0])
    np.testing.assert_allclose(rewards, -errors / 20, rtol=1e-12)
    assert list(env.figures.items()) == [("mean_abs_error.angle [deg]", 1.0)]
    assert sum(rewards) == pytest.approx(-env.trace.metrics()["mean_abs_error.angle [deg]"], rel=1e-12)


@pytest.mark.parametrize("communication_step", [None, 200.0])
def test_rewards_sum_to_minus_money_and_discomfort(communication_step: float | None) -> None:
    env = of(house(communication_step=communication_step), weights={"money": 3.0})
    _, rewards, _, _ = episode(env, drawn(0.0, 3000.0, 10), seed=0)
    assert env.trace is not None
    assert {key.partition(" ")[0]: weight for key, weight in env.figures.items()} == {
        "money": 3.0,
        "band_violation.room": 1.0,
    }
    assert sum(rewards) == pytest.approx(-figure(env, env.trace), rel=1e-12)
    assert env.observation_names[:3] == ("room", "power", "setpoint.room")
    assert {"disturbance.weather", "lower.room", "upper.room", "price.electricity"} <= {
        *env.observation_names
    }


def test_rewards_sum_to_minus_the_quadratic_cost() -> None:
    cost = {"outputs": {"angle": 2.0}, "inputs": {"torque": 0.1}, "changes": {"torque": 0.3}}
    env = of(replace(disturbed(), cost=cost))
    _, rewards, _, _ = episode(env, drawn(-3.5, 3.5, 20), seed=0)
    assert env.trace is not None
    e, u = (env.trace.reference - env.trace.y)[:20, 0], env.trace.u[:20, 0]
    expected = 2.0 * e**2 + 0.1 * u**2 + 0.3 * np.diff(u, prepend=0.0) ** 2
    np.testing.assert_allclose(rewards, -expected, rtol=1e-12)


def test_a_saved_state_is_gone_on_from() -> None:
    """Without what is random, and with actuators at rest, the rest of an episode is the same."""
    problem = replace(
        disturbed(), noise={}, conditions=Conditions(), parameters={"mass": Normal(1.0, 0.1, low=0.5)}
    )
    env = of(problem)
    actions = drawn(-3.5, 3.5, 20)
    env.reset(seed=5)
    for action in actions[:8]:
        env.step(action)
    saved: SavedState = pickle.loads(pickle.dumps(env.save_state()))
    seen = [env.step(action)[0] for action in actions[8:]]
    assert env.trace is not None
    whole = env.trace
    _, info = env.reset(seed=6, options={"state": saved})
    again = [env.step(action)[0] for action in actions[8:]]
    np.testing.assert_array_equal(again, seen)
    assert info["time"] == pytest.approx(0.8)
    assert env.trace is not whole
    np.testing.assert_array_equal(env.trace.time, whole.time[8:])
    np.testing.assert_array_equal(env.trace.y, whole.y[8:])
    env.reset(options={"state": saved})
    env.step(actions[8])
    assert env.save_state().resumption.samples == 9
    shorter = of(replace(problem, duration=0.8))
    with pytest.raises(ConfigError, match=r"it is of sample 8; an episode of this problem ends at sample 8"):
        shorter.reset(options={"state": saved})
    shorter.close()
    env.close()


def test_no_one_gains_by_ending_a_run() -> None:
    """What is missing counts as the worst sample so far, at least as an error of the reference's span."""
    env = of(house(Escapes, prices={}))
    _, rewards, terminated, info = episode(env, [[0.0], [0.0], [2500.0]], seed=0)
    assert terminated
    assert info["outcome"] == "diverged"
    assert info["reason"].startswith("output room is nan at t = ")
    assert env.trace is not None
    assert len(env.trace) == 3
    distances = np.maximum(env.trace.band[:, 0, 0] - env.trace.y[:, 0], 0.0) / 10
    np.testing.assert_allclose(rewards[:2], -distances[:2])
    assert rewards[2] == pytest.approx(-distances[2] - 7 * max(distances.max(), 2.0 / 10))
    with pytest.raises(ConfigError, match="there is no episode"):
        env.step(np.zeros(1))
    assert episode(env, [[0.0]] * 10, seed=0)[3]["outcome"] == "completed"


@pytest.mark.parametrize("communication_step", [None, 200.0])
def test_an_interval_that_a_fault_ends_is_paid_as_in_the_trace(communication_step: float | None) -> None:
    weights = {"money": 3.0, "band_violation.room": 0.0}
    env = of(house(FailsWithinAnInterval, communication_step=communication_step), weights=weights)
    _, rewards, terminated, _ = episode(env, drawn(0.0, 3000.0, 10), seed=0)
    assert terminated
    assert env.trace is not None
    paid = env.trace.paid
    assert paid is not None
    costs = 3.0 * (paid.amounts * paid.price).reshape(3, -1).sum(axis=1)
    np.testing.assert_allclose(rewards, [-costs[0], -costs[1], -costs[2] - 7 * costs.max()], rtol=1e-12)
    assert costs.min() > 0.0
    env.close()


def test_an_action_that_is_no_number_ends_the_episode() -> None:
    env = of(disturbed())
    _, rewards, terminated, info = episode(env, [[0.0], [np.nan]], seed=0)
    assert terminated
    assert info["outcome"] == "controller-error"
    assert rewards[1] <= -19 / 20 * np.rad2deg(0.3) * (1 - 1e-9)
    env.close()


@pytest.mark.parametrize(
    ("fault", "outcome"), [(Fault.SEGMENTATION_FAULT, "crashed"), (Fault.RETURN_ERROR, "fmu-error")]
)
def test_an_fmu_that_crashes_ends_the_episode_and_nothing_else(
    make_fmu: Callable[..., Path], tmp_path: Path, fault: Fault, outcome: str
) -> None:
    plant = {"fmu": str(make_fmu(fault)), "outputs": ["y"]}
    text = study_text(plant, {"y": 1.0}, ["idle"], bounds={"u": {"min": -1.0, "max": 1.0}})
    env = make(write(tmp_path, text))
    for _ in range(2):
        _, _, terminated, info = episode(env, [[0.0]] * 10, seed=0)
        assert (terminated, info["outcome"]) == (True, outcome)
        assert env.trace is not None
        assert len(env.trace) > 3
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("context", ["spawn", "forkserver"])
def test_several_at_once(make_fmu: Callable[..., Path], tmp_path: Path, context: str) -> None:
    """In processes of their own, one of whose FMUs crashes again and again."""
    plant = {"fmu": str(make_fmu(Fault.SEGMENTATION_FAULT)), "outputs": ["y"]}
    text = study_text(plant, {"y": 1.0}, ["idle"], bounds={"u": {"min": -1.0, "max": 1.0}})
    crashing = str(write(tmp_path, text))
    plant["fmu"] = str(make_fmu())
    sound = str(write(tmp_path, text.replace("segmentation_fault", "no_fault"), "sound.toml"))
    envs = gymnasium.vector.AsyncVectorEnv(
        [lambda study=study: make(study) for study in (crashing, sound)], context=context
    )
    try:
        envs.reset(seed=[1, 2])
        ended = np.zeros(2)
        for _ in range(14):
            _, _, terminated, truncated, _ = envs.step(np.zeros((2, 1)))
            ended += terminated + 10 * truncated
        assert ended.tolist() == [2.0, 10.0]
    finally:
        envs.close()


def test_what_cannot_be_is_said() -> None:
    study = Study(replace(disturbed(), bounds={}), {"nothing": "idle"})
    with pytest.raises(ConfigError, match="bounds of torque: it has no finite limits"):
        make(study)
    with pytest.raises(ConfigError, match='the study has no problem "pendulun"; did you mean "pendulum"'):
        make("benchmark", problem="pendulun")
    with pytest.raises(ConfigError, match=r"weights: no metric \"mony\"; did you mean") as error:
        of(house(), weights={"mony": 1.0, "mean_abs_error.room": 2.0})
    assert len(error.value.faults) == 2
    for horizon in (-1, 21, 2.5, "3", True):
        with pytest.raises(ConfigError, match=r"horizon = .*; allowed: an integer from 0 to 20"):
            of(disturbed(), horizon=horizon)
    for weight in (np.nan, "x", None, True):
        with pytest.raises(ConfigError, match=r"weights: mean_abs_error = .*; allowed: a finite number"):
            of(disturbed(), weights={"mean_abs_error": weight})
    with pytest.raises(ConfigError, match=r"weights = \[1\]; needed: numbers by metric"):
        of(disturbed(), weights=[1])
    with pytest.raises(ConfigError, match="isolated = 'maybe' is not possible"):
        of(disturbed(), isolated="maybe")
    env = of(disturbed())
    with pytest.raises(ConfigError, match=r"options = \['state'\]; needed: a dict"):
        env.reset(options=["state"])  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="call reset"):
        env.step(np.zeros(1))
    with pytest.raises(ConfigError, match='options: "stat" is unknown'):
        env.reset(options={"stat": None})
    with pytest.raises(ConfigError, match="needed: what save_state"):
        env.reset(options={"state": 1})
    env.reset()
    with pytest.raises(ConfigError, match=r"action: shape \(2,\); needed: \(1,\): torque"):
        env.step(np.zeros(2))
    env.close()
    env = of(house())
    env.reset()
    with pytest.raises(ConfigError, match="its state can be saved"):
        env.save_state()


def test_without_gymnasium_it_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, "ddpc_cosim.gymnasium")
    with pytest.raises(ConfigError, match=r"needs Gymnasium: .*gym"):
        __import__("ddpc_cosim.gymnasium")


def test_a_case_is_not_run_with_the_limits_of_one_controller(tmp_path: Path) -> None:
    """Whoever acts has those that hold for all who have none of their own."""
    bounds = {"torque": {"min": -3.0, "max": 3.0}}
    own = {"type": "idle", "bounds": {"torque": {"min": -1.0, "max": 1.0}}}
    path = write(tmp_path, study_text(controllers={"own": own}, bounds=bounds))
    env = make(path)
    assert env.action_space.low.tolist() == [-3.0]
    assert cases_in(path)[0].bounds["torque"] == (-1.0, 1.0)
    env.close()
