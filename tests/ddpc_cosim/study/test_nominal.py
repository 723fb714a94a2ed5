"""Nominal values that a study gives in place of the plant's own."""

from pathlib import Path

import numpy as np
import pytest

from ddpc_cosim import ConfigError, Controller, Loop, Sample
from ddpc_cosim.study.cases import Case, cases_of, run_case
from ddpc_cosim.study.reading import read_study

STUDY = """
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
type = "tests.ddpc_cosim.study.test_nominal:Probe"
"""


class Probe(Controller):
    """Ask for the nominal values of the loop, as if they were inputs."""

    def start(self, loop: Loop) -> None:
        self._answer = np.array([loop.inputs[0].nominal + loop.outputs[0].nominal / 100.0])

    def step(self, sample: Sample) -> np.ndarray:
        return self._answer


def case_of(folder: Path, plant: str = "") -> Case:
    path = folder / "study.toml"
    path.write_text(STUDY.format(plant=plant), encoding="utf-8")
    resolved = read_study(str(path))
    (case,) = cases_of(resolved, resolved.plant.built())
    return case


def test_controllers_see_the_nominal_values_of_the_plant(tmp_path: Path) -> None:
    trace = run_case(case_of(tmp_path))
    assert trace.u[0] == pytest.approx([3.0 + 10.0 / 100.0])


def test_those_that_a_study_gives_take_their_place(tmp_path: Path) -> None:
    case = case_of(tmp_path, "nominal = { pump_1 = 1.5, level_1 = 4 }")
    assert run_case(case).u[0] == pytest.approx([1.5 + 4.0 / 100.0])
    assert case.inputs[0].nominal == 1.5


def test_they_decide_the_result(tmp_path: Path) -> None:
    ids = {case_of(tmp_path, plant).id for plant in ("", "nominal = { pump_1 = 2.0 }", "nominal = {}")}
    assert len(ids) == 2


def test_impossible_ones_are_faults(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        case_of(tmp_path, "nominal = { pump_1 = 0.0, level_1 = -2.0 }")
    assert list(caught.value.faults) == [
        "study.toml:6: plant.nominal.pump_1: must be greater than 0, got 0.0",
        "study.toml:6: plant.nominal.level_1: must be greater than 0, got -2.0",
    ]
    with pytest.raises(ConfigError, match=r'plant\.nominal.*"pmp_1".*did you mean "pump_1"'):
        case_of(tmp_path, "nominal = { pmp_1 = 1.0 }")
