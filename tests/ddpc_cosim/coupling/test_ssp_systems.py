"""A quarter car and a double pendulum as SSP archives, against their monolithic equations."""

from collections.abc import Mapping, Sequence
from math import cos, exp, pi, radians, sin
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from studies import cases_in, study_text, write

from ddpc_cosim.codec import read
from ddpc_cosim.inspection.systems import inspect_ssp
from ddpc_cosim.study.case_runs import run_case
from ddpc_cosim.study.file_format.sections import PlantSection
from ddpc_cosim.study.plants import PlantSpec
from fmu_plants import Equations, PlantModel, Symbols, Variable, tunable

from .ssp_files import (
    GAIN,
    binding,
    component,
    connection,
    linear,
    ssd,
    ssm,
    ssv,
    system,
    unit,
    write_ssp,
)

Rows = np.ndarray[Any, Any]
FINE = {"communication_step": 5e-4, "extrapolation": "linear"}


def run(
    path: Path, outputs: Sequence[str], u: Mapping[str, float], sampling_time: float, samples: int, **how: Any
) -> Rows:
    """Return the outputs of an archive at the samples; its inputs are held."""
    section = read(PlantSection, {"ssp": str(path), "coupling": how or FINE})
    plant = PlantSpec.of(section, path.parent).built().open(list(u), outputs)
    try:
        plant.plan(sampling_time, samples * sampling_time)
        rows = [plant.reset()]
        rows += [plant.step(np.array([*u.values()]), sampling_time) for _ in range(samples)]
    finally:
        plant.close()
    return np.array(rows)


MASS, SPRING, DAMPING, WHEEL, TYRE = 3.0, 12.0, 1.5, 1.0, 40.0


def _wheel(v: Symbols) -> Equations:
    force = v.spring * (v.place - v.body_place) + v.damping * (v.speed - v.body_speed)
    acceleration = (v.tyre * (v.road - v.place) - force) / v.mass
    return Equations({"place": v.speed, "speed": acceleration}, {"force": force})


PLACE, SPEED, FORCE = Variable("place", "m"), Variable("speed", "m/s"), Variable("force", "N")
BODY_MODEL = PlantModel(
    name="body",
    states=(PLACE, SPEED),
    inputs=(FORCE,),
    outputs=(PLACE, SPEED),
    parameters=(tunable("mass", "kg", start=1.0),),
    equations=lambda v: Equations({"place": v.speed, "speed": v.force / v.mass}),
)
WHEEL_MODEL = PlantModel(
    name="wheel",
    states=(PLACE, SPEED),
    inputs=(Variable("body_place", "m"), Variable("body_speed", "m/s"), Variable("road", "m")),
    outputs=(PLACE, SPEED, FORCE),
    parameters=(
        tunable("mass", "kg", start=9.0),
        tunable("spring", "N/m", start=9.0),
        tunable("damping", "N.s/m", start=9.0),
        tunable("tyre", "N/m", start=9.0),
    ),
    equations=_wheel,
)


@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_a_quarter_car(version: str, tmp_path: Path) -> None:
    """Suspension and wheel are a system of their own, with values in other units and names."""
    corner = system(
        "corner",
        component(
            "wheel", "resources/wheel.fmu", "input road m, input body_place, input body_speed, output force"
        ),
        connections=connection("profile", "wheel/road")
        + connection("body", "wheel/body_place")
        + connection("body_v", "wheel/body_speed")
        + connection("wheel/force", "strut"),
        connectors="input profile cm, input body m, input body_v m/s, output strut kN",
        bindings=binding(ssv({"wheel.mass": WHEEL, "wheel.spring": 1.0, "wheel.damping": DAMPING})),
    )
    # Of a car of 0.012 t each corner carries a quarter; the stiffness is given in N/mm.
    values = ssv(
        {
            "car": '<ssv:Real value="0.012" unit="tonne"/>',
            "tyre": '<ssv:Real value="0.04" unit="N/mm"/>',
            "spring": SPRING,
            "not used": 5.0,
        },
        version,
        f"<ssv:Units>{unit('tonne', 1000.0, kg=1)}{unit('N/mm', 1000.0, kg=1, s=-2)}</ssv:Units>",
    )
    mapping = ssm(
        {
            "chassis.mass": f"car {linear(0.25)}",
            "corner.wheel.tyre": "tyre",
            "corner.wheel.spring": "spring",
        },
        version,
    )
    car = system(
        "car",
        component("chassis", "resources/body.fmu", "input force N, output place m, output speed m/s"),
        corner,
        connections=connection("road", "corner/profile")
        + connection("chassis/place", "corner/body")
        + connection("corner/body_v", "chassis/speed")
        + connection("corner/strut", "chassis/force")
        + connection("chassis/place", "height", linear(1.0, 100.0)),
        connectors="input road mm, output height mm",
        bindings=binding("parameters/car.ssv", "parameters/car.ssm"),
    )
    files = {"resources/body.fmu": BODY_MODEL, "resources/wheel.fmu": WHEEL_MODEL}
    files |= {"parameters/car.ssv": values, "parameters/car.ssm": mapping}  # type: ignore[dict-item]
    path = write_ssp(tmp_path / "car.ssp", ssd(car, version), files)
    outputs = run(path, ["height", "corner/wheel.place", "corner/wheel.speed"], {"road": 50.0}, 0.1, 10)
    matrix = np.array(
        [
            [0, 1, 0, 0, 0],
            [-SPRING / MASS, -DAMPING / MASS, SPRING / MASS, DAMPING / MASS, 0],
            [0, 0, 0, 1, 0],
            [SPRING / WHEEL, DAMPING / WHEEL, -(SPRING + TYRE) / WHEEL, -DAMPING / WHEEL, TYRE / WHEEL],
            [0, 0, 0, 0, 0],
        ]
    )
    whole = np.array([expm(0.1 * k * matrix) @ [0, 0, 0, 0, 0.05] for k in range(11)])
    np.testing.assert_allclose(outputs[:, 0], 1000.0 * whole[:, 0] + 100.0, atol=1e-3)  # in mm
    np.testing.assert_allclose(outputs[:, 1:], whole[:, 2:4], atol=1e-6)


M1, L1, M2, L2, G = 2.0, 1.0, 1.0, 0.7, 9.81


def _upper(v: Symbols) -> Equations:
    from sympy import sin as s

    acceleration = (v.pull - M1 * G * s(v.angle)) / (M1 * L1)
    return Equations({"angle": v.rate, "rate": acceleration}, {"acceleration": acceleration})


def _lower(v: Symbols) -> Equations:
    """Return a pendulum on a joint that moves; the angle of the rod above comes in degrees."""
    from sympy import cos as c, sin as s

    above = v.above * pi / 180
    between = above - v.angle
    acceleration = (
        -G * s(v.angle) - L1 * v.above_acceleration * c(between) + L1 * v.above_rate**2 * s(between)
    ) / L2
    pull = -M2 * (
        L1 * v.above_acceleration
        + L2 * acceleration * c(between)
        + L2 * v.rate**2 * s(between)
        + G * s(above)
    )
    return Equations({"angle": v.rate, "rate": acceleration}, {"pull": pull})


def _angle(start: float) -> Variable:
    return Variable("angle", "rad", start=start)


RATE, ACCELERATION, PULL = (
    Variable("rate", "rad/s"),
    Variable("acceleration", "rad/s2"),
    Variable("pull", "N"),
)
UPPER = PlantModel(
    name="upper",
    states=(_angle(0.0), RATE),
    inputs=(PULL,),
    outputs=(_angle(0.0), RATE, ACCELERATION),
    equations=_upper,
)
LOWER = PlantModel(
    name="lower",
    states=(_angle(0.0), RATE),
    inputs=(
        Variable("above", "deg"),
        Variable("above_rate", "rad/s"),
        Variable("above_acceleration", "rad/s2"),
    ),
    outputs=(_angle(0.0), RATE, PULL),
    equations=_lower,
)


def _both(_: float, x: Rows) -> list[float]:
    """Return the derivatives of both angles and rates, from Lagrange's equations."""
    a1, w1, a2, w2 = x
    d = a1 - a2
    mass = np.array([[(M1 + M2) * L1, M2 * L2 * cos(d)], [L1 * cos(d), L2]])
    right = [
        -(M1 + M2) * G * sin(a1) - M2 * L2 * w2**2 * sin(d),
        -G * sin(a2) + L1 * w1**2 * sin(d),
    ]
    b1, b2 = np.linalg.solve(mass, right)
    return [w1, float(b1), w2, float(b2)]


def test_a_double_pendulum(tmp_path: Path) -> None:
    """The force on the joint and its acceleration follow from each other without delay."""
    described = system(
        "pendulum",
        component(
            "upper", "resources/upper.fmu", "input pull N, output angle rad, output rate, output acceleration"
        ),
        component(
            "lower",
            "resources/lower.fmu",
            "input above deg, input above_rate, input above_acceleration, output pull N",
        ),
        connections=connection("upper/angle", "lower/above")
        + connection("upper/rate", "lower/above_rate")
        + connection("upper/acceleration", "lower/above_acceleration")
        + connection("lower/pull", "upper/pull"),
        bindings=binding(ssv({"upper.angle": radians(40.0), "lower.angle": radians(-25.0)})),
    )
    path = write_ssp(
        tmp_path / "double.ssp",
        ssd(described, "2.0"),
        {"resources/upper.fmu": UPPER, "resources/lower.fmu": LOWER},
    )
    fine = {"communication_step": 1.25e-4, "extrapolation": "linear"}
    outputs = run(path, ["upper.angle", "upper.rate", "lower.angle", "lower.rate"], {}, 0.05, 8, **fine)
    start, times = [radians(40.0), 0.0, radians(-25.0), 0.0], np.arange(9) * 0.05
    whole = solve_ivp(_both, (0.0, 0.4), start, "DOP853", times, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(outputs, whole.y.T, atol=1e-6)


def test_a_linear_transformation_on_a_connection(tmp_path: Path) -> None:
    """As in the test of libcosim: of two sets the later one counts, 1.3 * value + 50 arrives."""
    bindings = binding(ssv({"u": 3.0})) + binding(ssv({"u": 2.0}))
    identity = "resources/identity.fmu"
    described = system(
        "s",
        component("one", identity, "input u, output y", bindings),
        component("two", identity, "input u, output y"),
        connections=connection("one/y", "two/u", linear(1.3, 50.0)),
    )
    path = write_ssp(tmp_path / "two.ssp", ssd(described), {identity: GAIN})
    np.testing.assert_allclose(
        run(path, ["one.y", "two.y"], {}, 0.1, 1, algorithm="sequential"), [[2.0, 52.6]] * 2
    )


def _overridden(v: Symbols) -> Equations:
    return Equations({"T": v.on_activate * v.on_u + (1 - v.on_activate) * 5.0 - v.T})


OVERRIDDEN = PlantModel(
    name="overridden",
    states=(Variable("T"),),
    inputs=(Variable("on_u"), Variable("on_activate", "1", 0.0, 1.0)),
    outputs=(Variable("T"),),
    equations=_overridden,
)


def test_connectors_that_lead_to_an_override_and_its_switch_are_one_actuator(tmp_path: Path) -> None:
    text = ssd(
        system(
            "outer",
            component("a", "resources/a.fmu", "input on_u, input on_activate, output T"),
            connections=connection("heat", "a/on_u")
            + connection("on", "a/on_activate")
            + connection("a/T", "T"),
            connectors="input heat, input on, output T",
        )
    )
    path = write_ssp(tmp_path / "room.ssp", text, {"resources/a.fmu": OVERRIDDEN})
    assert inspect_ssp(path).switches == {"heat": "on"}
    file = write(
        tmp_path,
        study_text(
            plant={"ssp": str(path)},
            reference={"T": 1.0},
            controllers={"own": "plant", "p": {"type": "pid", "settings": {"proportional": 1.0}}},
            loop={"sampling_time": 0.5, "duration": 2.0},
        ),
    )
    own, driven = (run_case(case) for case in cases_in(file))
    assert [variable.name for variable in own.inputs] == ["heat"]
    np.testing.assert_allclose(own.y[:, 0], 5.0 * (1.0 - np.exp(-own.time)), rtol=1e-6)
    expected = [0.0]
    for _ in range(4):  # y' = u - y, u = 1 - y at the samples
        u = 1.0 - expected[-1]
        expected.append(u + (expected[-1] - u) * exp(-0.5))
    np.testing.assert_allclose(driven.y[:, 0], expected, rtol=1e-6)
