"""What a plant model refuses, at once and by name; what the equations are checked for."""

import math
from dataclasses import replace

import pytest

from fmu_plants import DisplayUnit, Equations, ModelError, Parameter, PlantModel, Variable, export_fmu
from fmu_plants.pendulum import MODEL


def no_equations(v):
    return Equations({})


def errors(**changes):
    """Name every error of a small model with these changes."""
    sound = {
        "name": "plant",
        "equations": no_equations,
        "states": (Variable("x"),),
        "inputs": (Variable("u"),),
        "outputs": (Variable("x"),),
        "parameters": (Parameter("a"),),
    }
    with pytest.raises(ModelError) as error:
        PlantModel(**(sound | changes))
    return str(error.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "my plant"}, "name 'my plant' is not an identifier"),
        ({"outputs": ()}, "no outputs"),
        ({"equations": None}, "equations must be a function"),
        ({"step_size": 0.0}, "step_size must be positive"),
        ({"stop_time": math.inf}, "stop_time must be positive and finite"),
        ({"inputs": (Variable("1u"),)}, "variable '1u': the name is not an identifier"),
        ({"inputs": (Variable("time"),)}, "variable 'time': the name is reserved"),
        ({"inputs": (Variable("x"),)}, "input 'x': the name is already taken by the state 'x'"),
        ({"parameters": (Parameter("u"),)}, "parameter 'u': the name is already taken by the input 'u'"),
        ({"outputs": (Variable("u"),)}, "output 'u': the name is already taken by the input 'u'"),
        ({"outputs": (Variable("x"), Variable("x"))}, "output 'x': the name is already taken"),
        ({"outputs": (Variable("x", "m"),)}, "output 'x' differs from the state of that name"),
        ({"inputs": (Variable("u", "parsec"),)}, "variable 'u': unknown unit symbol 'parsec'; known: "),
        ({"inputs": (Variable("u", min=1.0, max=2.0),)}, "start 0.0 is outside the range 1.0 .. 2.0"),
        ({"inputs": (Variable("u", min=2.0, max=1.0),)}, "min 2.0 and max 1.0 are not a range"),
        ({"inputs": (Variable("u", min=math.nan),)}, "are not a range"),
        ({"inputs": (Variable("u", start=math.inf),)}, "start must be finite"),
        ({"inputs": (Variable("u", nominal=0.0),)}, "nominal must be positive"),
        ({"parameters": (Parameter("a", variability="free"),)}, "must be 'fixed' or 'tunable', not 'free'"),
        ({"inputs": (Variable("u", "m", display_unit=DisplayUnit("mm", 0.0)),)}, "'mm' has no usable conv"),
        ({"inputs": (Variable("u", display_unit=DisplayUnit("mm")),)}, "a unit that it is converted from"),
        (
            {
                "inputs": (Variable("u", "m", display_unit=DisplayUnit("mm", 1e3)),),
                "parameters": (Parameter("a", "m", display_unit=DisplayUnit("mm", 1e6)),),
            },
            "variable 'a': display unit 'mm' is converted differently elsewhere",
        ),
    ],
)
def test_a_model_that_contradicts_itself_is_refused(changes, message):
    assert message in errors(**changes)


def test_all_errors_are_named_at_once():
    text = errors(name="1", outputs=(), inputs=(Variable("u", "parsec", nominal=-1.0),), step_size=-1.0)
    assert "5 error(s)" in text
    for word in ("not an identifier", "no outputs", "parsec", "nominal", "step_size"):
        assert word in text


def test_a_computed_output_needs_no_start_value_in_its_range():
    model = PlantModel(name="p", equations=no_equations, outputs=(Variable("y", min=1.0, max=2.0),))
    assert [output.name for output in model.computed_outputs] == ["y"]


def test_states_are_not_computed_outputs():
    assert [output.name for output in MODEL.outputs] == ["angle", "angular_velocity"]
    assert MODEL.computed_outputs == ()


def sympy_free_symbol():
    from sympy import Symbol

    return Symbol("stranger")


def sympy_infinity():
    from sympy import zoo

    return zoo


@pytest.mark.parametrize(
    ("equations", "messages"),
    [
        (
            lambda v: Equations({"angle": v.angular_velocity}),
            ["do not give the derivative of state 'angular_velo"],
        ),
        (
            lambda v: Equations({"angel": 0}, {"power": 1}),
            [
                "give an unknown derivative of state 'angel'; expected: angle, angular_velocity",
                "do not give the derivative of state 'angle'",
                "give an unknown output 'power'; expected: none",
            ],
        ),
        (lambda v: Equations({"angle": v.angel}), ["use an unknown 'angel'; did you mean \"angle\"?"]),
        (
            lambda v: Equations({"angle": v["x y"]}),
            ["use an unknown 'x y'; there are: angle, ", "gravity, mass"],
        ),
        (
            lambda v: Equations({"angle": sympy_free_symbol(), "angular_velocity": sympy_infinity()}),
            ["symbols that the model does not declare: stranger", "not a finite real expression: zoo"],
        ),
        (
            lambda v: Equations({"angle": "mass", "angular_velocity": v.angle > 0}),
            ["state 'angle' is not a SymPy expression: 'mass'", "not a scalar expression: angle > 0"],
        ),
        (lambda v: {"angle": 0}, ["must return Equations"]),
    ],
)
def test_equations_that_do_not_fit_the_variables_are_refused(equations, messages, tmp_path):
    with pytest.raises(ModelError) as error:
        export_fmu(replace(MODEL, equations=equations), tmp_path / "pendulum.fmu")
    for message in messages:
        assert message in str(error.value)
    assert list(tmp_path.iterdir()) == []
