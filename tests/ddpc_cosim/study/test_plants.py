"""Plants in Python as a study runs them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pytest
from studies import cases_in, study_text, write

from ddpc_cosim import (
    ConfigError,
    Controller,
    FloatArray,
    FMUStepError,
    Loop,
    Plant,
    Sample,
    StepStatus,
    Variable,
    load_results,
)
from ddpc_cosim.study.case_runs import run_case
from ddpc_cosim.study.cases import Case
from ddpc_cosim.study.plants import PythonPlant

Run = Callable[..., CompletedProcess[str]]

MODULE = '''
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from ddpc_cosim import Controller, Plant, Variable

@dataclass(kw_only=True)
class Half(Controller):
    def start(self, loop):
        self.inputs = len(loop.inputs)
    def step(self, sample):
        return np.full(self.inputs, 0.5)

class Lags(Plant):
    """Two lags, of which each has an input."""
    inputs = (Variable("a", start=2.0), Variable("b"))
    outputs = (Variable("y"), Variable("z", unit="rad"))
    def reset(self, parameters=None, t0=0.0):
        self.y = np.zeros(2)
        return self.y
    def step(self, u, h):
        self.y = self.y + h * (u - self.y)
        return self.y

class Fixed(Lags):
    """Its signals are not to be replaced."""
    inputs = property(lambda self: Lags.inputs)
    outputs = property(lambda self: Lags.outputs)

class Odd(Exception):
    """Cannot be sent to another process."""
    def __init__(self, one, two):
        super().__init__(one)

class Second(Lags):
    """Knows whether it is the first: a study makes one to read its variables, and one to run it."""
    def __init__(self):
        first = Path(__file__).with_name("first")
        self.is_first = not first.exists()
        first.touch()

class Refusing(Second):
    def __init__(self):
        super().__init__()
        if not self.is_first:
            raise Odd("no licence", 2)

class Failing(Lags):
    def step(self, u, h):
        if self.y[0] > 0.2:
            raise Odd("out of range", 2)
        return super().step(u, h)

class Clinging(Second):
    def close(self):
        if not self.is_first:
            raise OSError("busy")
'''


def run(run_program: Run, folder: Path, plant: str, *inputs: str) -> Any:
    """Run the study of a plant and return its only case."""
    (folder / "lags.py").write_text(MODULE, encoding="utf-8")
    signals = {"inputs": inputs, "outputs": ["z"], "display_units": {"z": "deg"}}
    text = study_text(
        plant={"name": f"lags:{plant}"} | signals,
        reference={"z": 1.0},
        controllers=["lags:Half"],
        loop={"sampling_time": 0.5},
    )
    write(folder, text)
    done = run_program("run", "study.toml", "--no-report", "--jobs", "1", "--out", "out")
    assert "Traceback" not in done.stderr
    (case,) = load_results(folder / "out").cases
    return case


@pytest.mark.parametrize("plant", ["Lags", "Fixed"])
def test_inputs_that_a_study_does_not_drive_rest_at_their_start_values(
    plant: str, run_program: Run, tmp_path: Path
) -> None:
    trace = run(run_program, tmp_path, plant, "b").trace()
    assert [v.name for v in trace.inputs] == ["b"]
    assert np.array_equal(trace.u[:, 0], [0.5, 0.5, 0.5])
    assert np.array_equal(trace.y[:, 0], [0.0, 0.25, 0.375])
    assert trace.outputs[0].shown_in.name == "deg"
    assert trace.provenance["class"] == f"lags:{plant}"


@pytest.mark.parametrize(
    ("plant", "samples", "reason"),
    [
        ("Refusing", 0, "before the first sample: Refusing() raised Odd: no licence"),
        ("Failing", 2, "Failing.step raised Odd: out of range at t = 0.5 s"),
        ("Clinging", 3, "after the last sample: Clinging.close raised OSError: busy"),
    ],
)
def test_a_plant_that_fails_costs_its_case_a_result_and_no_samples(
    plant: str, samples: int, reason: str, run_program: Run, tmp_path: Path
) -> None:
    case = run(run_program, tmp_path, plant, "b", "a")
    assert (case.outcome, case.reason) == ("crashed", reason)
    assert len(case.trace()) == samples


class Adder(Plant):
    """Sums what it is driven by; fails when it is asked for a change."""

    inputs = (Variable("a", start=1.0), Variable("b", start=10.0), Variable("c", start=100.0))
    outputs = (Variable("sum"),)

    def reset(self, parameters: Mapping[str, Any] | None = None, t0: float = 0.0) -> FloatArray:
        return np.zeros(1)

    def step(self, u: FloatArray, h: float) -> FloatArray:
        return np.array([u @ [1.0, 2.0, 3.0]])

    def set_parameters(self, parameters: Mapping[str, Any]) -> None:
        raise KeyError("gain")


def test_inputs_are_driven_in_the_order_of_the_study() -> None:
    plant = PythonPlant(Adder, ["c", "a"])
    plant.reset()
    assert plant.step(np.array([1000.0, 2000.0]), 0.5) == [2000.0 + 20.0 + 3000.0]


def test_inputs_rest_where_the_study_says() -> None:
    plant = PythonPlant(Adder, ["c"], {"a": 5.0, "c": 7.0})
    plant.reset()
    assert plant.inputs[0].start == 7.0
    assert plant.step(np.array([0.0]), 0.5) == [5.0 + 20.0]


def test_faults_bear_the_name_of_the_plant_and_its_time() -> None:
    plant = PythonPlant(Adder, ["a"])
    plant.reset(t0=3.0)
    plant.step(np.zeros(1), 0.5)
    with pytest.raises(
        FMUStepError, match=r"Adder\.set_parameters raised KeyError: 'gain' at t = 3\.5 s"
    ) as e:
        plant.set_parameters({"gain": 1.0})
    assert e.value.status is StepStatus.CRASHED


NOMINAL_STUDY = """
[plant]
name = "quadruple-tank"
inputs = ["pump_1"]
outputs = ["level_1"]
{plant}
[loop]
sampling_time = 5.0
duration = 20.0
[reference]
level_1 = {{ kind = "constant", value = 14.0 }}
[controllers.probe]
type = "tests.ddpc_cosim.study.test_plants:Probe"
"""


class Probe(Controller):
    """Ask for the nominal values of the loop, as if they were inputs."""

    def start(self, loop: Loop) -> None:
        self._answer = np.array([loop.inputs[0].nominal + loop.outputs[0].nominal / 100.0])

    def step(self, sample: Sample) -> np.ndarray:
        return self._answer


def case_of(folder: Path, plant: str = "") -> Case:
    (case,) = cases_in(write(folder, NOMINAL_STUDY.format(plant=plant)))
    return case


def test_controllers_see_the_nominal_values_of_the_plant(tmp_path: Path) -> None:
    trace = run_case(case_of(tmp_path))
    assert trace.u[0] == pytest.approx([3.0 + 10.0 / 100.0])


def test_those_that_a_study_gives_take_their_place(tmp_path: Path) -> None:
    case = case_of(tmp_path, "nominal = { pump_1 = 1.5, level_1 = 4 }")
    assert run_case(case).u[0] == pytest.approx([1.5 + 4.0 / 100.0])
    assert case.inputs[0].nominal == 1.5


@pytest.mark.parametrize("key", ["nominal", "start"])
def test_they_decide_the_result(key: str, tmp_path: Path) -> None:
    ids = {case_of(tmp_path, plant).id for plant in ("", f"{key} = {{ pump_1 = 2.0 }}", f"{key} = {{}}")}
    assert len(ids) == 2


def test_a_study_says_where_inputs_start(tmp_path: Path) -> None:
    case = case_of(tmp_path, "start = { pump_1 = 1.5 }")
    assert case.inputs[0].start == 1.5
    assert case.plant.open(["pump_1"], ["level_1"]).inputs[0].start == 1.5
    with pytest.raises(ConfigError) as caught:
        case_of(tmp_path, "start = { pmp_1 = 1.0, pump_2 = -9.0 }")
    unknown, outside = caught.value.faults
    assert 'no input "pmp_1"; did you mean "pump_1"' in unknown
    assert "plant.start.pump_2: -9 is outside [0, " in outside


def test_impossible_ones_are_faults(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        case_of(tmp_path, "nominal = { pump_1 = 0.0, level_1 = -2.0 }")
    assert list(caught.value.faults) == [
        "study.toml:6: plant.nominal.pump_1: must be greater than 0, got 0.0",
        "study.toml:6: plant.nominal.level_1: must be greater than 0, got -2.0",
    ]
    with pytest.raises(ConfigError, match=r'plant\.nominal.*"pmp_1".*did you mean "pump_1"'):
        case_of(tmp_path, "nominal = { pmp_1 = 1.0 }")
