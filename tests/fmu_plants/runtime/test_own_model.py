"""A plant of the user's own: several inputs, computed outputs, every function that C has."""

import math

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import fmi2OK
from fmpy.validation import validate_fmu
from scipy.linalg import expm

from fmu_plants import Equations, Parameter, PlantModel, Variable, build_fmu

A = np.array([[-1.0, 2.0], [-3.0, -0.5]])
B = np.array([[1.0, 0.2], [0.0, -1.5]])
C = np.array([[1.0, 1.0], [0.5, -2.0]])
D = np.array([[0.0, 0.3], [0.0, 0.0]])


def linear_equations(v):
    x, u = (v.x1, v.x2), (v.u1, v.u2)

    def row(matrix, vector, i):
        return sum(float(matrix[i, j]) * vector[j] for j in range(2))

    return Equations(
        derivatives={f"x{i + 1}": row(A, x, i) + row(B, u, i) for i in range(2)},
        outputs={f"y{i + 1}": v.scale * (row(C, x, i) + row(D, u, i)) for i in range(2)},
    )


LINEAR = PlantModel(
    name="linear_2x2",
    states=(Variable("x1", "m"), Variable("x2", "m/s", nominal=2.0)),
    inputs=(Variable("u1", "N", -5.0, 5.0), Variable("u2", "degC", -300.0, 300.0, start=20.0)),
    outputs=(Variable("y2", "mm"), Variable("x1", "m"), Variable("y1", "")),
    parameters=(Parameter("scale", start=1.5, variability="tunable"),),
    equations=linear_equations,
)


@pytest.fixture
def instance(open_fmu):
    return open_fmu(build_fmu(LINEAR))


def exact_linear(inputs, size):
    """Sampled solution with held inputs, through the matrix exponential."""
    block = expm(size * np.block([[A, B], [np.zeros((2, 4))]]))
    x, rows = np.zeros(2), []
    for u in inputs:
        x = block[:2, :2] @ x + block[:2, 2:] @ u
        y = 1.5 * (C @ x + D @ u)
        rows.append([y[1], x[0], y[0]])
    return np.array(rows)


def test_linear_plant_equals_the_matrix_exponential(instance):
    inputs = np.random.default_rng(5).uniform(-5.0, 5.0, (100, 2))
    by_name = dict(zip(["y2", "x1", "y1"], exact_linear(inputs, 0.2).T, strict=True))
    exact = np.column_stack([by_name[name] for name in instance.outputs()])
    assert np.abs(instance.start().run(inputs, ["u1", "u2"], size=0.2) - exact).max() <= 1e-8


def test_feedthrough_acts_at_once(instance):
    instance.start({"x1": 1.0, "u2": 0.0})
    before = instance.get("y1", "y2")
    assert instance.set({"u2": 10.0}) == fmi2OK
    assert instance.get("y1", "y2") - before == pytest.approx([1.5 * 0.3 * 10.0, 0.0])


def test_description_of_the_linear_plant():
    path = build_fmu(LINEAR)
    assert validate_fmu(str(path)) == []
    description = fmpy.read_model_description(str(path))
    variables = {variable.name: variable for variable in description.modelVariables}
    assert (variables["u1"].min, variables["u1"].max) == ("-5.0", "5.0")
    assert [variables[name].causality for name in ("x1", "x2", "y1")] == ["output", "local", "output"]
    uses = {
        unknown.variable.name: {known.name for known in unknown.dependencies}
        for unknown in [*description.outputs, *description.derivatives]
    }
    assert uses == {
        "x1": {"x1"},
        "y1": {"x1", "x2", "u2"},
        "y2": {"x1", "x2"},
        "der(x1)": {"x1", "x2", "u1", "u2"},
        "der(x2)": {"x1", "x2", "u2"},
    }
    units = {unit.name: unit.baseUnit for unit in description.unitDefinitions}
    assert (units["degC"].K, units["degC"].offset) == (1, 273.15)
    assert (units["mm"].m, units["mm"].factor) == (1, 1e-3)
    assert (units["m/s2"].m, units["m/s2"].s) == (1, -2)


def test_functions_mean_in_c_what_they_mean_in_sympy(open_fmu):
    """Every output is computed by C at a = -1.7, b = 0.6 and compared with Python's own mathematics."""
    import sympy as sp

    a, b = -1.7, 0.6
    cases = {
        "rational": (lambda v: v.a / 3 + sp.Rational(1, 3), a / 3 + 1 / 3),
        "tenth": (lambda v: 0.1 * v.b, 0.1 * b),
        "powers": (lambda v: v.a**2 + v.a**3 + v.b**-2 + v.b**11, a**2 + a**3 + b**-2 + b**11),
        "root": (
            lambda v: sp.sqrt(v.b) + sp.cbrt(v.b) + v.b ** sp.Rational(5, 2),
            b**0.5 + b ** (1 / 3) + b**2.5,
        ),
        "constants": (
            lambda v: sp.pi * v.b + sp.E + sp.sqrt(2) * v.a,
            math.pi * b + math.e + math.sqrt(2) * a,
        ),
        "exponential": (lambda v: sp.exp(v.a) * sp.log(v.b), math.exp(a) * math.log(b)),
        "circle": (
            lambda v: sp.sin(v.a) + sp.cos(v.b) * sp.tan(v.a),
            math.sin(a) + math.cos(b) * math.tan(a),
        ),
        "arcs": (lambda v: sp.atan2(v.a, v.b) + sp.asin(v.b), math.atan2(a, b) + math.asin(b)),
        "hyperbola": (lambda v: sp.tanh(v.a) + sp.cosh(v.b), math.tanh(a) + math.cosh(b)),
        "bounds": (lambda v: sp.Max(v.a, 0.0) + sp.Min(v.b, 0.25), 0.25),
        "powers_in_bounds": (
            lambda v: sp.Max(v.a / (1 + sp.sqrt(v.a**2 + v.b)), -1),
            a / (1 + math.sqrt(a**2 + b)),
        ),
        "parts": (lambda v: sp.Abs(v.a) + sp.sign(v.a) + sp.floor(v.a), 1.7 - 1.0 - 2.0),
        "size_of_an_integer": (lambda v: sp.Abs(sp.floor(v.a)), 2.0),
        "remainder": (lambda v: sp.Mod(v.a, v.b), a % b),
        "choice": (lambda v: sp.Piecewise((v.b, v.a > 0), (2 * v.b, True)), 2 * b),
        "large": (lambda v: 10**20 * v.b, 1e20 * b),
        "clock": (lambda v: v.time + v.a, 3.0 + a),
        "names": (
            lambda v: v["int"] + v.t0 + (v.a + v.b) ** 2 * v.t0 + (v.a + v.b) * v.x,
            6.0 + (a + b) ** 2 + (a + b) * 2.0,
        ),
    }
    model = PlantModel(
        name="functions",
        outputs=tuple(Variable(name) for name in cases),
        # Names that are also words of C, of the generated code and of the runtime are names like any other.
        inputs=(Variable("a"), Variable("b"), Variable("int"), Variable("t0"), Variable("x")),
        equations=lambda v: Equations({}, {name: case(v) for name, (case, _) in cases.items()}),
    )
    path = build_fmu(model)
    assert validate_fmu(str(path)) == []
    instance = open_fmu(path).start({"a": a, "b": b, "int": 5.0, "t0": 1.0, "x": 2.0})
    assert instance.step(0.0, 3.0) == fmi2OK
    values = instance.get(*cases)
    assert dict(zip(cases, values, strict=True)) == pytest.approx(
        {name: value for name, (_, value) in cases.items()}, rel=1e-14, abs=1e-14
    )


def test_a_plant_that_changes_with_time(open_fmu):
    from sympy import cos

    model = PlantModel(
        name="clocked",
        states=(Variable("x"),),
        outputs=(Variable("x"),),
        equations=lambda v: Equations({"x": cos(v.time)}),
    )
    instance = open_fmu(build_fmu(model)).start(start=2.0)
    assert instance.step(2.0, 5.0) == fmi2OK
    assert instance.get("x")[0] == pytest.approx(math.sin(7.0) - math.sin(2.0), abs=1e-9)
