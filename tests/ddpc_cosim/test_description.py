"""What plants say about themselves: the same questions, whatever the plant is."""

from pathlib import Path

import pytest
from fmus.builder import LAG, V, describe, model_library, write_fmu

from ddpc_cosim import Variable
from ddpc_cosim.description import DefaultExperiment
from ddpc_cosim.study.plants import PlantSpec
from fmu_plants import Variable as VariableOfEquations

CLASS = """
from ddpc_cosim import Plant, Variable

class Lag(Plant):
    inputs, outputs = (Variable("u", "K"),), (Variable("x", "K"),)
    def reset(self, parameters=None, t0=0.0): ...
    def step(self, u, h): ...
"""
EXPERIMENT = '<DefaultExperiment startTime="1" stopTime="3" stepSize="0.5"/>'
FIXED = (
    '<CoSimulation modelIdentifier="models" canHandleVariableCommunicationStepSize="false" '
    'fixedInternalStepSize="0.25"/>'
)


def test_an_fmu(tmp_path: Path) -> None:
    text = describe(
        "3.0", "lag", [V("time", 15, causality="independent"), *LAG], interfaces=FIXED, head=EXPERIMENT
    )
    path = write_fmu(tmp_path / "lag.fmu", text, model_library("3.0"))
    plant = PlantSpec("", str(path)).variables()
    assert ([*plant.inputs], plant.default_outputs) == (["u"], ("x",))
    assert plant.default_experiment == DefaultExperiment(1.0, 3.0, None, 0.5)
    assert (plant.variable_step, plant.fixed_step) == (False, 0.25)
    assert plant.states == ("x",)
    assert plant.variables["name"].values == "text"
    assert plant.variables["rate"].is_tunable


def test_equations_and_a_class_have_the_variables_that_they_declare(tmp_path: Path) -> None:
    equations = PlantSpec("pendulum", "").variables()
    assert {name: variable.causality for name, variable in equations.variables.items()} == {
        **dict.fromkeys(equations.parameters, "parameter"),
        **dict.fromkeys(equations.outputs, "output"),
        **dict.fromkeys(equations.inputs, "input"),
    }
    assert {
        name for name, variable in equations.variables.items() if variable.is_tunable
    } == equations.tunable
    assert equations.default_experiment.stop_time is not None
    (tmp_path / "own.py").write_text(CLASS, encoding="utf-8")
    description = PlantSpec(f"{tmp_path / 'own.py'}:Lag", "").variables()
    assert {name: variable.causality for name, variable in description.variables.items()} == {
        "u": "input",
        "x": "output",
    }
    assert description.signal("u") is not None
    assert (description.parameters, description.default_experiment) == ({}, DefaultExperiment())


@pytest.mark.parametrize("unit", ["K", ""])
def test_equations_and_contracts_have_one_class_of_variables(unit: str) -> None:
    assert Variable is VariableOfEquations
    assert Variable("T\n", unit).header == f"T\\n [{unit or '1'}]"
