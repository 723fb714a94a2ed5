"""Roll-outs: each as if it were a run of its own, and the run goes on as if there had been none."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmus.builder import Fault, keeping_fmu

from ddpc_cosim import ConfigError, FMUPlant, FMUStepError, Plant, StepStatus, Variable, rollout

H = 0.25
COURSES = np.random.default_rng(3).uniform(-1.0, 1.0, (5, 7, 1))


class Lag(Plant):
    """x' = u - x, exact; y = x and 2 x."""

    inputs = (Variable("u"),)
    outputs = (Variable("y"), Variable("z"))
    can_save_state = True

    def reset(self, parameters: Any = None, t0: float = 0.0) -> np.ndarray:
        self.x = 0.5
        return np.array([self.x, 2 * self.x])

    def step(self, u: np.ndarray, h: float) -> np.ndarray:
        self.x = float(u[0] + (self.x - u[0]) * np.exp(-h))
        u[:] = np.nan  # it does as it likes with what it is given
        return np.array([self.x, 2 * self.x])

    def save_state(self) -> object:
        return self.x

    def restore_state(self, state: Any) -> None:
        self.x = state


def test_each_follows_the_formula() -> None:
    plant = Lag()
    plant.reset()
    y = rollout(plant, COURSES, sampling_time=H)
    decay, k = np.exp(-H), np.arange(7)
    free = 0.5 * decay ** (k + 1)
    forced = [
        [(1 - decay) * sum(decay ** (n - i) * course[i, 0] for i in range(n + 1)) for n in k]
        for course in COURSES
    ]
    assert y[:, :, 0] == pytest.approx(free + np.array(forced), abs=1e-12)
    assert y[:, :, 1] == pytest.approx(2 * y[:, :, 0], abs=0)
    assert plant.x == 0.5


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
@pytest.mark.parametrize("isolated", [False, True])
def test_a_run_goes_on_as_if_nothing_had_been_tried(
    tmp_path: Path, version: str, kind: Any, isolated: bool
) -> None:
    path = keeping_fmu(tmp_path, version, "lag", ["GetAndSet"])
    with FMUPlant(path, fmi_type=kind, isolated=isolated) as plant:
        plant.reset()
        alone = [plant.step(u, H) for u in COURSES[0]]
        runs = []
        for course in COURSES:
            plant.reset()
            runs.append([plant.step(u, H) for u in (*COURSES[0][:3], *course)][3:])
        plant.reset()
        for u in COURSES[0][:3]:
            plant.step(u, H)
        y = rollout(plant, list(COURSES), sampling_time=H)
        assert y == pytest.approx(np.array(runs), abs=0)
        assert plant.time == pytest.approx(3 * H)
        assert [plant.step(u, H) for u in COURSES[0][3:]] == alone[3:]


def test_it_begins_at_an_earlier_state_if_that_is_given() -> None:
    plant = Lag()
    plant.reset()
    state, early = plant.save_state(), rollout(plant, COURSES, sampling_time=H)
    plant.step(np.ones(1), H)
    x = plant.x
    np.testing.assert_array_equal(rollout(plant, COURSES, sampling_time=H, state=state), early)
    assert plant.x == x


def test_nothing_to_try_is_nothing() -> None:
    plant = Lag()
    plant.reset()
    assert rollout(plant, np.empty((0, 4, 1)), sampling_time=H).shape == (0, 4, 2)
    assert rollout(plant, np.empty((3, 0, 1)), sampling_time=H).shape == (3, 0, 2)


def test_a_failure_names_its_roll_out_and_the_run_goes_on(tmp_path: Path) -> None:
    """The FMU discards steps after t = 0.5 s."""
    how = {"fault": Fault.RETURN_DISCARD}
    with FMUPlant(keeping_fmu(tmp_path, "2.0", "lag", **how)) as plant:
        plant.reset()
        first = plant.step(np.ones(1), 0.1)
        with pytest.raises(FMUStepError, match="in sample 5 of roll-out 1 of 5") as caught:
            rollout(plant, COURSES, sampling_time=0.1)
        assert caught.value.status is StepStatus.DISCARD
        assert plant.time == pytest.approx(0.1)
        assert plant.step(np.ones(1), 0.1) > first


@pytest.mark.parametrize(
    ("inputs", "sampling_time", "faults"),
    [
        (COURSES[0], H, [r"inputs have shape \(7, 1\); needed: finite numbers, shape \(N, T, 1\)"]),
        ([[[1.0, 2.0]]], 0.0, [r"inputs have shape \(1, 1, 2\)", "sampling_time = 0.0 is not possible"]),
        ([np.ones((2, 1)), np.ones((3, 1))], H, ["inputs are not numbers, or of different lengths"]),
        ([[["a"]]], H, ["inputs are not numbers"]),
        ([[[1.0]], [[np.nan]]], H, [r"inputs\[1, 0, 0\] = nan is not possible"]),
        (COURSES, np.inf, ["sampling_time = inf is not possible"]),
    ],
)
def test_what_is_not_possible_is_told_at_once(inputs: Any, sampling_time: float, faults: list[str]) -> None:
    plant = Lag()
    plant.reset()
    with pytest.raises(ConfigError) as caught:
        rollout(plant, inputs, sampling_time=sampling_time)
    assert len(caught.value.faults) == len(faults)
    for fault in faults:
        assert caught.match(fault)


def test_a_plant_that_cannot_save_its_state_is_refused(tmp_path: Path) -> None:
    with FMUPlant(keeping_fmu(tmp_path, "2.0", "lag", [])) as plant:
        plant.reset()
        with pytest.raises(ConfigError, match=r"it cannot save its state \(can_save_state is false\)"):
            rollout(plant, COURSES, sampling_time=H)
