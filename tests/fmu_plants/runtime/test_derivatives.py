"""Directional and adjoint derivatives of the FMUs: against formulas, differences and each other."""

import ctypes

import numpy as np
import pytest
from fmpy.fmi2 import fmi2Error, fmi2OK
from hypothesis import HealthCheck, given, settings, strategies as st

from fmu_plants import Equations, PlantModel, Variable, build_fmu

UNKNOWNS = ["der(angle)", "der(angular_velocity)", "angle", "angular_velocity"]
KNOWNS = [
    *("time", "angle", "angular_velocity", "torque"),
    *("mass", "radius", "damping", "torque_gain", "gravity"),
]


def array(kind, values):
    return (kind * len(values))(*values)


def derivative(instance, version, name, unknowns, knowns, seed):
    """Return the status and the sensitivities."""
    references = instance.library.references
    n = len(knowns if "Directional" in name else unknowns)
    size = ctypes.c_size_t
    result = (ctypes.c_double * (len(unknowns) + len(knowns) - n))()
    lists = [
        array(ctypes.c_uint, [references[name] for name in unknowns]),
        size(len(unknowns)),
        array(ctypes.c_uint, [references[name] for name in knowns]),
        size(len(knowns)),
    ]
    values = array(ctypes.c_double, seed)
    if version == 2:
        status = instance.call(f"fmi2{name}", *lists, values, result)
    else:
        status = instance.call(f"fmi3{name}", *lists, values, size(n), result, size(len(result)))
    return status, np.array(result)


@pytest.fixture(params=[2, 3], ids=["FMI 2.0", "FMI 3.0"])
def directional(request, pendulum, pendulum3):
    """A function that opens a pendulum with values, which gives its derivatives in a direction."""

    def open_instance(values):
        instance = (pendulum if request.param == 2 else pendulum3)().start(values)

        def evaluate(unknowns, knowns, seed):
            status, result = derivative(
                instance, request.param, "GetDirectionalDerivative", unknowns, knowns, seed
            )
            assert status == fmi2OK, instance.messages
            return result

        return evaluate

    return open_instance


def exact_jacobian(x, v, u, m, r, k, a, g):
    """Derivatives of (22), by hand, with respect to KNOWNS."""
    i = m * r
    rest = -k * v + a * u
    slope = [
        0.0,
        -g / r * np.cos(x),
        -k / i,
        a / i,
        -rest / (m * i),
        g / r**2 * np.sin(x) - rest / (r * i),
        -v / i,
        u / i,
        -np.sin(x) / r,
    ]
    rows = np.zeros((4, 9))
    rows[0, 2] = rows[2, 1] = rows[3, 2] = 1.0
    rows[1] = slope
    return rows


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    point=st.tuples(st.floats(-3, 3), st.floats(-10, 10), st.floats(-4, 4), *[st.floats(0.1, 5.0)] * 5),
    seed=st.lists(st.floats(-2.0, 2.0), min_size=9, max_size=9),
)
def test_derivatives_of_the_pendulum_are_those_of_the_formula(directional, point, seed):
    x, v, u, *parameters = point
    names = ["mass", "radius", "damping", "torque_gain", "gravity"]
    values = {"angle": x, "angular_velocity": v, "torque": u} | dict(zip(names, parameters, strict=True))
    exact = exact_jacobian(*point)
    computed = directional(values)(UNKNOWNS, KNOWNS, seed)
    assert computed == pytest.approx(exact @ np.array(seed), rel=1e-12, abs=1e-9)


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    angle=st.floats(-3.0, 3.0),
    direction=st.lists(st.floats(-2.0, 2.0), min_size=9, max_size=9),
    weights=st.lists(st.floats(-2.0, 2.0), min_size=4, max_size=4),
)
def test_the_adjoint_is_the_transpose(pendulum3, angle, direction, weights):
    """w . (J v) = (J' w) . v."""
    instance = pendulum3().start({"angle": angle, "torque": 1.0})
    arguments = (instance, 3)
    _, forward = derivative(*arguments, "GetDirectionalDerivative", UNKNOWNS, KNOWNS, direction)
    status, backward = derivative(*arguments, "GetAdjointDerivative", UNKNOWNS, KNOWNS, weights)
    assert status == fmi2OK
    assert np.dot(weights, forward) == pytest.approx(np.dot(backward, direction), rel=1e-12, abs=1e-9)


def test_any_selection_in_any_order_may_be_asked_for(directional):
    evaluate = directional({"angle": 0.5})
    assert evaluate(["der(angular_velocity)"], ["torque", "angular_velocity"], [2.0, 1.0]) == pytest.approx(
        [2.0 / 0.2 - 0.4 / 0.2]
    )
    assert evaluate(["der(angle)"], [], []) == pytest.approx([0.0])
    assert evaluate([], ["torque"], [1.0]).size == 0
    assert evaluate(["der(angle)"], ["angular_velocity"] * 2, [1.0, 2.0]) == pytest.approx([3.0])


def test_what_has_no_derivative_is_refused(pendulum):
    instance = pendulum().start()
    for unknowns, knowns, word in [
        (["torque"], ["angle"], "torque is not computed"),
        (["der(angle)"], ["der(angle)"], "der(angle) is computed"),
    ]:
        status, _ = derivative(instance, 2, "GetDirectionalDerivative", unknowns, knowns, [1.0])
        assert status == fmi2Error
        assert word in instance.messages[-1][2]
    assert derivative(pendulum(), 2, "GetDirectionalDerivative", [], [], [])[0] == fmi2Error


def test_unknown_references_and_missing_arrays_are_refused(pendulum, pendulum3):
    instance = pendulum().start()
    count, wrong, value = ctypes.c_size_t(1), (ctypes.c_uint * 1)(999), (ctypes.c_double * 1)()
    status = instance.call("fmi2GetDirectionalDerivative", wrong, count, wrong, count, value, value)
    assert status == fmi2Error
    assert "999" in instance.messages[-1][2]
    assert instance.call("fmi2GetDirectionalDerivative", None, count, wrong, count, value, value) == fmi2Error
    other = pendulum3().start()
    known = (ctypes.c_uint * 1)(1)
    for name in ("Directional", "Adjoint"):
        status = other.call(
            f"fmi3Get{name}Derivative", known, count, known, count, value, ctypes.c_size_t(2), value, count
        )
        assert status == fmi2Error
        assert "2 values for 1 variables" in other.messages[-1][2]


def jumping_equations(v):
    import sympy as sp

    return Equations(
        {},
        {
            "bounded": sp.Max(v.a, v.b) * sp.Min(v.a, 2.0),
            "size": sp.Abs(v.a * v.b - 1),
            "stairs": v.b * sp.floor(v.a) + sp.ceiling(v.b * v.a) + v.a * sp.sign(v.b),
            "remainder": sp.Mod(v.a, v.b) + sp.Mod(v.a**2, 3),
            "choice": sp.Piecewise((v.a**2, v.a > v.b), (sp.exp(v.b), True)),
            "root": sp.sqrt(v.b + 2) * sp.atan2(v.a, v.b) + v.time * v.a,
        },
    )


JUMPING = PlantModel(
    name="jumping",
    inputs=(Variable("a"), Variable("b")),
    outputs=tuple(Variable(name) for name in ("bounded", "size", "stairs", "remainder", "choice", "root")),
    equations=jumping_equations,
)


@pytest.mark.parametrize("point", [(1.3, 0.7), (-0.4, 1.6), (2.7, -1.2), (0.2, 0.45)])
def test_functions_with_corners_and_jumps(point, open_fmu):
    """Away from the jumps, differences of the FMU's own outputs converge to its derivatives."""
    outputs = [output.name for output in JUMPING.outputs]
    instance = open_fmu(build_fmu(JUMPING)).start(start=2.0)
    names, step = ("a", "b"), 1e-6

    def values(a, b):
        assert instance.set({"a": a, "b": b}) == fmi2OK
        return instance.get(*outputs)

    for index, name in enumerate(names):
        shift = step * np.eye(2)[index]
        difference = (values(*(point + shift)) - values(*(point - shift))) / (2 * step)
        values(*point)
        status, exact = derivative(instance, 2, "GetDirectionalDerivative", outputs, [name], [1.0])
        assert status == fmi2OK
        assert exact == pytest.approx(difference, rel=1e-7, abs=1e-7)


def test_a_derivative_that_is_infinite_is_an_error_only_where_it_counts(escape):
    """The slope of the root is infinite at 0."""
    escape.start({"x": 0.0})
    status, _ = derivative(escape, 2, "GetDirectionalDerivative", ["root"], ["x"], [1.0])
    assert status == fmi2Error
    assert "root" in escape.messages[-1][2]
    assert "not finite" in escape.messages[-1][2]
    status, values = derivative(escape, 2, "GetDirectionalDerivative", ["root", "held"], ["push"], [1.0])
    assert status == fmi2OK
    assert list(values) == [0.0, 1.0]
