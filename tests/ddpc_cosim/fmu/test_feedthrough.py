"""Outputs and their derivatives at other inputs, without a step: what coupled plants exchange."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ddpc_cosim import ConfigError, FMUPlant, FMUStepError, Plant
from ddpc_cosim.study.plants import PythonPlant
from ddpc_cosim.variables import FloatArray, Variable
from fmu_plants import Equations, PlantModel, Variable as PlantVariable, export_fmu

MIXER = PlantModel(
    name="mixer",
    states=(PlantVariable("x"),),
    inputs=(PlantVariable("a"), PlantVariable("b")),
    outputs=(PlantVariable("x"), PlantVariable("from_a"), PlantVariable("from_both")),
    equations=lambda v: Equations({"x": v.a - v.x}, {"from_a": v.x + v.a**2, "from_both": v.a * v.b}),
)
WAYS = [(version, kind) for version in ("2.0", "3.0") for kind in ("co-simulation", "model-exchange")]


@pytest.fixture(scope="module")
def mixers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("mixers")
    return {v: export_fmu(MIXER, folder / f"mixer{v[0]}.fmu", v) for v in ("2.0", "3.0")}


@pytest.mark.parametrize("isolated", [False, True])
@pytest.mark.parametrize(("version", "kind"), WAYS)
def test_outputs_and_derivatives_follow_inputs_while_time_stands_still(
    mixers: dict[str, Path], version: str, kind: Any, isolated: bool
) -> None:
    with FMUPlant(mixers[version], fmi_type=kind, isolated=isolated) as plant:
        assert plant.dependencies == {
            "x": frozenset(),
            "from_a": frozenset({"a"}),
            "from_both": frozenset({"a", "b"}),
        }
        plant.reset()
        x = plant.step(np.array([1.0, 2.0]), 0.5)[0]
        assert plant.outputs_at(np.array([3.0, 4.0])) == pytest.approx([x, x + 9.0, 12.0])
        derivatives = plant.feedthrough(np.array([3.0, 4.0]))
        assert derivatives == pytest.approx(np.array([[0.0, 0.0], [6.0, 0.0], [4.0, 3.0]]))
        assert plant.time == 0.5


@pytest.mark.parametrize(("version", "kind"), WAYS)
def test_a_run_does_not_notice_that_outputs_were_asked_for(
    mixers: dict[str, Path], version: str, kind: Any
) -> None:
    runs = []
    for asks in (False, True):
        with FMUPlant(mixers[version], fmi_type=kind) as plant:
            plant.reset()
            rows = []
            for k in range(6):
                u = np.array([float(k // 3), 1.0])
                if asks:
                    plant.outputs_at(u + 5.0)
                    plant.feedthrough(u - 5.0)
                rows.append(plant.step(u, 0.2))
            runs.append(np.array(rows))
    assert np.array_equal(*runs)


def test_derivatives_of_what_is_no_declared_output_are_not_known(mixers: dict[str, Path]) -> None:
    with FMUPlant(mixers["2.0"], outputs=["x", "der(x)"]) as plant:
        assert plant.dependencies["der(x)"] == {"a", "b"}  # of which the FMU says nothing
        plant.reset()
        assert plant.feedthrough(np.array([0.0, 0.0])) is None
        assert plant.outputs_at(np.array([2.0, 0.0])) == pytest.approx([0.0, 2.0])


@pytest.mark.parametrize("isolated", [False, True])
def test_outputs_are_asked_for_during_a_run_only(mixers: dict[str, Path], isolated: bool) -> None:
    with (
        FMUPlant(mixers["2.0"], isolated=isolated) as plant,
        pytest.raises(ConfigError, match="before reset"),
    ):
        plant.outputs_at(np.array([0.0, 0.0]))


class Sum(Plant):
    """An output that is the sum of two inputs, wrongly given where they are large."""

    inputs = (Variable("a", start=5.0), Variable("b"))
    outputs = (Variable("sum"),)
    dependencies = {"sum": frozenset({"a", "b"})}  # noqa: RUF012 - what a user writes

    def reset(self, parameters: Any = None, t0: float = 0.0) -> FloatArray:
        return np.zeros(1)

    def step(self, u: FloatArray, h: float) -> FloatArray:
        return self.outputs_at(u)

    def outputs_at(self, u: FloatArray) -> FloatArray:
        return np.array([u.sum()]) if u.max() < 100.0 else np.zeros(3)

    def feedthrough(self, u: FloatArray) -> FloatArray:
        return np.ones((1, 2)) if u.max() < 100.0 else np.ones(2)


def test_a_plant_that_drives_some_inputs_passes_on_what_depends_on_them() -> None:
    plant = PythonPlant(Sum, ["b"])
    plant.reset()
    assert plant.can_give_outputs
    assert plant.dependencies == {"sum": {"b"}}
    assert plant.outputs_at(np.array([2.0])) == [7.0]
    assert plant.feedthrough(np.array([2.0])) == [[1.0]]
    for call in (plant.outputs_at, plant.feedthrough):
        with pytest.raises(FMUStepError, match=rf"Sum.{call.__name__} returned .*; needed: .*shape"):
            call(np.array([200.0]))
