"""Plants from state-space matrices, and linear models of plants."""

from dataclasses import dataclass, field, replace

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import fmi2OK
from fmpy.validation import validate_fmu
from scipy.linalg import expm

from fmu_plants import (
    DisplayUnit,
    EmbeddedControl,
    Equations,
    InputTable,
    ModelError,
    PlantModel,
    Rules,
    Variable,
    export_fmu,
)
from fmu_plants.linear import linearise, state_space_model
from fmu_plants.model import identifier
from fmu_plants.pendulum import MODEL

A = np.array([[-1.0, 2.0, 0.0], [-3.0, -0.5, 1.0], [0.0, 0.0, -0.2]])
B = np.array([[1.0, 0.2], [0.0, -1.5], [0.5, 0.0]])
C = np.array([[1.0, 1.0, 0.0], [0.5, 0.0, -2.0]])
D = np.array([[0.0, 0.3], [0.0, 0.0]])


@dataclass
class StateSpace:
    """What is used of control.StateSpace, with the labels that it gives by default."""

    A: np.ndarray = field(default_factory=lambda: A)
    B: np.ndarray = field(default_factory=lambda: B)
    C: np.ndarray = field(default_factory=lambda: C)
    D: np.ndarray = field(default_factory=lambda: D)
    dt: float | None = 0
    state_labels: tuple[str, ...] = ("x[0]", "x[1]", "x[2]")
    input_labels: tuple[str, ...] = ("u[0]", "u[1]")
    output_labels: tuple[str, ...] = ("y[0]", "y[1]")


def test_an_exported_state_space_model_equals_the_matrix_exponential(tmp_path, open_fmu):
    path = export_fmu(StateSpace(), tmp_path / "my plant.fmu")
    assert validate_fmu(str(path)) == []
    assert fmpy.read_model_description(str(path)).modelName == "my_plant"
    instance = open_fmu(path).start()
    size, x = 0.2, np.zeros(3)
    block = expm(size * np.block([[A, B], [np.zeros((2, 5))]]))
    for k, u in enumerate(np.random.default_rng(10).uniform(-5.0, 5.0, (50, 2))):
        assert instance.set({"u_0": u[0], "u_1": u[1]}) == fmi2OK
        assert instance.step(k * size, size) == fmi2OK
        x = block[:3, :3] @ x + block[:3, 3:] @ u
        assert instance.get("y_0", "y_1") == pytest.approx(C @ x + D @ u, abs=1e-8)


def test_linearising_gives_the_matrices_back():
    for matrices, original in zip(linearise(state_space_model(StateSpace(), "p")), (A, B, C, D), strict=True):
        np.testing.assert_array_equal(matrices, original)


def test_variables_may_be_given():
    speed = Variable("speed", "rad/s", -10.0, 10.0, display_unit=DisplayUnit("rpm", 9.55))
    model = state_space_model(
        StateSpace([[-1.0]], [[2.0]], [[3.0]], [[0.0]]),
        "motor",
        states=[Variable("flux", "V.s")],
        inputs=[Variable("voltage", "V")],
        outputs=[speed],
        source="data sheet",
    )
    assert (model.outputs, model.source) == ((speed,), "data sheet")
    assert [v.name for v in (*model.states, *model.inputs)] == ["flux", "voltage"]


def test_matrices_without_labels_are_enough():
    class Matrices:
        A, B, C, D = [[-1.0]], [[2.0]], [[3.0]], 0.5

    model = state_space_model(Matrices(), "gain")
    assert [v.name for v in (*model.states, *model.inputs, *model.outputs)] == ["x_0", "u_0", "y_0"]
    assert [float(matrix[0, 0]) for matrix in linearise(model)] == [-1.0, 2.0, 3.0, 0.5]


def test_a_static_gain_has_no_states(tmp_path, open_fmu):
    empty = np.zeros((0, 0))
    system = StateSpace(empty, np.zeros((0, 1)), np.zeros((1, 0)), [[4.0]], None, (), ("u",), ("y",))
    instance = open_fmu(export_fmu(system, tmp_path / "gain.fmu")).start({"u": 2.0})
    assert instance.step(0.0, 1.0) == fmi2OK
    assert instance.get("y")[0] == 8.0


def test_states_give_way_to_outputs_of_the_same_name():
    system = StateSpace(state_labels=("speed", "current", "u[1]"), output_labels=("speed", "torque"))
    model = state_space_model(system, "drive")
    assert [state.name for state in model.states] == ["state_speed", "current", "state_u_1"]
    assert [output.name for output in model.computed_outputs] == ["speed", "torque"]


@pytest.mark.parametrize(
    ("text", "name"), [("u[0]", "u_0"), ("my plant-2", "my_plant_2"), ("2nd", "_2nd"), ("", "_"), ("θ", "_")]
)
def test_any_text_becomes_an_identifier(text, name):
    assert identifier(text) == name


@pytest.mark.parametrize(
    ("changes", "messages"),
    [
        ({"dt": 0.1}, ["discrete time"]),
        ({"B": np.zeros((2, 2))}, ["B has the shape (2, 2), expected (3, 2)"]),
        (
            {"A": np.zeros((3, 2)), "C": np.full((2, 3), np.nan)},
            ["2 error(s)", "A has the shape (3, 2), expected (3, 3)", "C has elements that are not finite"],
        ),
    ],
)
def test_matrices_that_do_not_make_a_plant_are_refused(changes, messages):
    with pytest.raises(ModelError) as error:
        state_space_model(replace(StateSpace(), **changes), "p")
    for message in messages:
        assert message in str(error.value)


def test_variables_that_do_not_fit_the_matrices_are_refused():
    with pytest.raises(ModelError, match="1 inputs are given, the matrices have 2"):
        state_space_model(StateSpace(), "p", inputs=[Variable("u")])


def test_anything_but_a_plant_is_refused(tmp_path):
    with pytest.raises(ModelError, match="str is neither a PlantModel nor a state-space model"):
        export_fmu("pendulum", tmp_path / "pendulum.fmu")


def test_the_operating_point_may_be_anything():
    x, u, changed = [0.7, -2.0], [1.5], {"mass": 2.0, "gravity": 1.62}
    model = replace(MODEL, equations=lambda v: Equations(MODEL.equations(v).derivatives))
    a, b, c, d = linearise(model, x, u, changed)
    assert a == pytest.approx(np.array([[0.0, 1.0], [-1.62 / 0.2 * np.cos(0.7), -0.4 / (2.0 * 0.2)]]))
    assert b == pytest.approx(np.array([[0.0], [1.0 / (2.0 * 0.2)]]))
    np.testing.assert_array_equal(c, np.eye(2))
    np.testing.assert_array_equal(d, np.zeros((2, 1)))


def test_a_plant_that_changes_with_time_is_linearised_at_a_time():
    model = replace(
        MODEL,
        outputs=(Variable("force"),),
        equations=lambda v: Equations({"angle": 0, "angular_velocity": 0}, {"force": v.time * v.torque}),
    )
    assert pytest.approx(np.array([[3.0]])) == linearise(model, time=3.0).D


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"x": [1.0]}, r"states must have the shape \(2,\) \(angle, angular_velocity\), not \(1,\)"),
        ({"u": 1.0}, r"inputs must have the shape \(1,\)"),
        ({"parameters": {"weight": 1.0}}, "no parameters 'weight'; it has: mass, radius"),
        ({"parameters": {"mass": 0.0}}, "not finite at the operating point"),
    ],
)
def test_impossible_operating_points_are_refused(arguments, message):
    with pytest.raises(ModelError, match=message):
        linearise(MODEL, **arguments)


def test_of_a_plant_with_tables_and_a_control_the_point_is_at_a_time_and_by_overrides_that_are_on():
    table = InputTable(
        file="t.csv",
        variables=(Variable("w"),),
        values=lambda: (np.array([0.0, 10.0]), np.array([[1.0], [3.0]])),
    )
    control = EmbeddedControl(
        sampling_time=1.0,
        actuators=(Variable("A", min=0.0, max=9.0, start=5.0),),
        rules=lambda v: Rules({"A": 1}),
    )
    model = PlantModel(
        name="own",
        states=(Variable("x"),),
        outputs=(Variable("x"), Variable("y")),
        tables=(table,),
        control=control,
        equations=lambda v: Equations({"x": v.w * v.A**2 - v.A * v.x}, {"y": v.w * v.x}),
    )
    # Off, the actuator is a constant of 5; on at 2, x' changes by 2 w A with it.
    off = linearise(model, [0.0], [2.0, 0.0], time=5.0)
    on = linearise(model, [0.0], [2.0, 1.0], time=5.0)
    assert [off.A[0, 0], on.A[0, 0]] == [-5.0, -2.0]
    np.testing.assert_array_equal(off.B, [[0.0, 0.0]])
    np.testing.assert_array_equal(on.B, [[2 * 2.0 * 2.0, 0.0]])
    np.testing.assert_array_equal(on.C[:, 0], [1.0, 2.0])
