"""The conformance kit passes sound plants and catches each way of breaking the contract."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from fmus.builder import CO_SIMULATION, Fault, integrator_description, model_fmu, write_fmu

from ddpc_cosim import ConfigError, FMUPlant, Plant, Variable
from ddpc_cosim.cli.main import main
from ddpc_cosim.plugins import installed
from ddpc_cosim.testing import PLANT_CHECKS, CheckStatus, PlantConformance, check_plant
from ddpc_cosim.testing.controllers import CONTROLLER_CHECKS
from fmu_plants import PlantModel, build_fmu

MODELS = {plugin.name: plugin.value for plugin in installed("plants") if isinstance(plugin.value, PlantModel)}


class Tank(Plant):
    """A plant as short as the contract admits: x' = u - x, integrated exactly."""

    inputs = (Variable("u", min=-1.0, max=1.0),)
    outputs = (Variable("x"),)

    def reset(self, parameters: Any = None, t0: float = 0.0) -> np.ndarray:
        if parameters:
            raise ConfigError(f"no parameters: {', '.join(parameters)}")
        self.x = np.zeros(1)
        return self.x.copy()

    def step(self, u: np.ndarray, h: float) -> np.ndarray:
        self.x = u + (self.x - u) * np.exp(-h)
        return self.x.copy()


class TestTank(PlantConformance):
    @pytest.fixture
    def make_plant(self) -> type[Plant]:
        return Tank


@cache
def built(name: str) -> Path:
    return build_fmu(MODELS[name])


@pytest.mark.parametrize("name", MODELS)
class TestBuiltInPlants(PlantConformance):
    sampling_time = 0.05

    @pytest.fixture
    def make_plant(self, name: str) -> Any:
        fmu = built(name)
        return lambda: FMUPlant(fmu)


class TestPendulumForFMI3(PlantConformance):
    @pytest.fixture
    def make_plant(self, pendulum_fmi3: Path) -> Any:
        return lambda: FMUPlant(pendulum_fmi3)


def test_every_check_is_a_test_of_the_class() -> None:
    tests = {
        name.removeprefix("test_").replace("_", " ") for name in dir(PlantConformance) if name[:5] == "test_"
    }
    assert tests == set(PLANT_CHECKS)


class Listed(Tank):
    def __init__(self) -> None:
        self.outputs = [Variable("x")]  # type: ignore[assignment]


class TwoOfOneName(Tank):
    inputs = (Variable("u"), Variable("u"))


class WrongShape(Tank):
    def step(self, u: np.ndarray, h: float) -> np.ndarray:
        return super().step(u, h)[np.newaxis]


class SingleNumbers(Tank):
    def reset(self, parameters: Any = None, t0: float = 0.0) -> Any:
        return float(super().reset(parameters, t0)[0])


class OneArray(Tank):
    def step(self, u: np.ndarray, h: float) -> np.ndarray:
        self.x[:] = u + (self.x - u) * np.exp(-h)
        return self.x


class Diverging(Tank):
    def step(self, u: np.ndarray, h: float) -> np.ndarray:
        y = super().step(u, h)
        return y if h < 0.01 else y * np.nan


class Forgetful(Tank):
    def __init__(self) -> None:
        self.age = 0.0

    def step(self, u: np.ndarray, h: float) -> np.ndarray:
        self.age += 1.0
        return super().step(u, h) + self.age


class Ramping(Tank):
    """Interpolates its inputs from one step to the next instead of holding them."""

    def reset(self, parameters: Any = None, t0: float = 0.0) -> np.ndarray:
        self.last = np.zeros(1)
        return super().reset(parameters, t0)

    def step(self, u: np.ndarray, h: float) -> np.ndarray:
        mean, self.last = (u + self.last) / 2, u.copy()
        return super().step(mean, h)


class Lazy(Tank):
    """Keeps a reference to the caller's array and reads it one step later."""

    def reset(self, parameters: Any = None, t0: float = 0.0) -> np.ndarray:
        self.waiting = np.zeros(1)
        return super().reset(parameters, t0)

    def step(self, u: np.ndarray, h: float) -> np.ndarray:
        y = super().step(self.waiting, h)
        self.waiting = u
        return y


class Greedy(Tank):
    def step(self, u: np.ndarray, h: float) -> np.ndarray:
        y = super().step(u, h)
        u *= 2.0
        return y


class Euler(Tank):
    def step(self, u: np.ndarray, h: float) -> np.ndarray:
        self.x = self.x + h * (u - self.x)
        return self.x.copy()


class Shared(Tank):
    state = np.zeros(1)

    def reset(self, parameters: Any = None, t0: float = 0.0) -> np.ndarray:
        super().reset(parameters, t0)
        Shared.state = np.zeros(1)
        return Shared.state.copy()

    def step(self, u: np.ndarray, h: float) -> np.ndarray:
        Shared.state = u + (Shared.state - u) * np.exp(-h)
        return Shared.state.copy()


class BadMemory(Tank):
    can_save_state = True

    def save_state(self) -> object:
        return self.x

    def restore_state(self, state: object) -> None:
        self.x = np.ones(1)


class GoodMemory(BadMemory):
    def restore_state(self, state: object) -> None:
        self.x = np.array(state)


class Permissive(Tank):
    def reset(self, parameters: Any = None, t0: float = 0.0) -> np.ndarray:
        return super().reset(None, t0)


class ClosedOnce(Tank):
    closed = False

    def close(self) -> None:
        if self.closed:
            raise RuntimeError("closed already")
        self.closed = True


class Secretive(Tank):
    def outputs_at(self, u: np.ndarray) -> np.ndarray:
        return self.x + u


class Late(Tank):
    dependencies = {"x": frozenset({"u"})}  # noqa: RUF012 - what a user writes

    def outputs_at(self, u: np.ndarray) -> np.ndarray:
        return self.x + 1.0


class Broken(Tank):
    def __init__(self) -> None:
        raise OSError("licence server not found")


@pytest.mark.parametrize(
    ("plant", "check", "reason"),
    [
        (Listed, "declares its signals", "needed: a tuple of Variable"),
        (TwoOfOneName, "declares its signals", "inputs has several of the name u"),
        (WrongShape, "returns arrays of the right shape", r"shape \(1, 1\); needed"),
        (SingleNumbers, "returns arrays of the right shape", "reset returned float"),
        (OneArray, "returns arrays of the right shape", "return a new one"),
        (Diverging, "returns finite numbers", "x is nan at t = 0.1 s"),
        (Forgetful, "resets to the same trajectory", "x differs after a reset"),
        (Ramping, "does not depend on the step size", "x differs with half the step size"),
        (Lazy, "holds its inputs", "when the caller reuses its array"),
        (Greedy, "holds its inputs", "step changed the array of inputs"),
        (Euler, "does not depend on the step size", "x differs with half the step size"),
        (Shared, "two instances are independent", "x differs beside another instance"),
        (BadMemory, "restores a saved state", "x differs after its state was restored"),
        (Secretive, "tells what depends on inputs at once", "x follows u at once, which is not declared"),
        (Late, "tells what depends on inputs at once", "x differs when it is asked for without a step"),
        (Permissive, "refuses unknown parameters", "reset accepts the parameter"),
        (ClosedOnce, "can be closed twice", "raised RuntimeError: closed already"),
        (Broken, "returns finite numbers", "raised OSError: licence server not found"),
    ],
)
def test_each_breach_is_caught_and_named(plant: type[Plant], check: str, reason: str) -> None:
    import re

    result = {result.name: result for result in check_plant(plant)}[check]
    assert result.status is CheckStatus.FAILED
    assert re.search(reason, result.reason), result.reason


def test_what_is_not_claimed_is_not_asked_for() -> None:
    results = {result.name: result for result in check_plant(Tank)}
    saved = results.pop("restores a saved state")
    now = results.pop("tells what depends on inputs at once")
    as_bytes = results.pop("goes on from its state as bytes")
    assert saved.status is now.status is as_bytes.status is CheckStatus.NOT_APPLICABLE
    assert {result.status for result in results.values()} == {CheckStatus.PASSED}
    remembers = {result.name: result.status for result in check_plant(GoodMemory)}
    assert remembers["restores a saved state"] is CheckStatus.PASSED


class Portable(GoodMemory):
    state_is_data = True


class Elsewhere(Portable):
    """Keeps its states itself, and hands out their numbers."""

    def __init__(self) -> None:
        self.kept: list[np.ndarray] = [np.full(1, 9.0)]

    def save_state(self) -> object:
        self.kept.append(self.x)
        return len(self.kept) - 1

    def restore_state(self, state: Any) -> None:
        self.x = self.kept[min(state, len(self.kept) - 1)]


def test_a_state_as_bytes_is_the_whole_state() -> None:
    name = "goes on from its state as bytes"
    for plant, expected in ((Portable, CheckStatus.PASSED), (Elsewhere, CheckStatus.FAILED)):
        results = {result.name: result for result in check_plant(plant)}
        assert results[name].status is expected, results[name].reason
        assert results["restores a saved state"].status is CheckStatus.PASSED
    assert results[name].reason.startswith("x differs in another instance, from its state as bytes")


def ddpc_check(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["check", *map(str, arguments)])


def test_the_command_checks_fmus_and_names(pendulum_fmu: Path) -> None:
    for subject in (pendulum_fmu, "pendulum"):
        result = ddpc_check(subject)
        assert result.exit_code == 0, result.output
        lines = [line.split("\t") for line in result.stdout.splitlines()]
        assert [line[1] for line in lines] == list(PLANT_CHECKS)
        assert {line[0] for line in lines} == {"passed"}


@pytest.mark.parametrize("fault", [Fault.NO_INSTANCE, Fault.CRASH_IN_INITIALIZATION, None])
def test_an_fmu_that_cannot_be_opened_is_told_once(tmp_path: Path, fault: Fault | None) -> None:
    """It refuses, it crashes, or it has no library."""
    if fault is None:
        path = write_fmu(tmp_path / "none.fmu", integrator_description("2.0"), None)
    else:
        path = model_fmu(tmp_path, "2.0", "integrator", fault, interfaces=CO_SIMULATION)
    result = ddpc_check(path)
    assert result.exit_code == 1
    assert [line.split("\t")[:2] for line in result.stdout.splitlines()] == [["failed", "can be opened"]]


PLANTS = """
import os, threading
import numpy as np
from ddpc_cosim import Plant, Variable

class Crashing(Plant):
    inputs, outputs = (Variable("u"),), (Variable("y"),)
    def reset(self, parameters=None, t0=0.0):
        return np.zeros(1)
    def step(self, u, h):
        os._exit(7)
    def set_parameters(self, parameters):
        threading.Event().wait()
"""


def test_crashes_and_hangs_fail_one_check_each(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bad_plants.py").write_text(PLANTS, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    result = ddpc_check("bad_plants:Crashing", "--timeout", "3")
    assert result.exit_code == 1
    lines = {line.split("\t")[1]: line.split("\t") for line in result.stdout.splitlines()}
    assert list(lines) == list(PLANT_CHECKS)
    assert lines["declares its signals"][0] == "passed"
    assert lines["returns finite numbers"][0::2] == ["failed", "crashed: its process ended with exit code 7"]
    assert lines["refuses unknown parameters"][0] == "failed"


CONTROLLERS = """
import threading
from ddpc_cosim import Controller

class Hanging(Controller):
    def start(self, loop):
        threading.Event().wait()
    def step(self, sample):
        raise AssertionError
"""


def test_a_controller_that_never_returns_ends_its_checks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bad_controllers.py").write_text(CONTROLLERS, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    result = ddpc_check("bad_controllers:Hanging", "--timeout", "0.3")
    assert result.exit_code == 1
    lines = {line.split("\t")[1]: line.split("\t") for line in result.stdout.splitlines()}
    assert list(lines) == list(CONTROLLER_CHECKS)
    late = ["failed", "did not end within 0.3 s"]
    assert lines["returns one input for one output"][0::2] == late


def test_an_unknown_plant_is_a_usage_error() -> None:
    assert ddpc_check("pendulm").exit_code != 0
    assert "pendulum" in ddpc_check("pendulm").stderr
    assert ddpc_check("missing.fmu").exit_code == 2
