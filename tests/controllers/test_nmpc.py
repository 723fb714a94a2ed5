"""Nonlinear MPC on the plant's equations: its optimum, its observer, its fallbacks; and idle."""

import math
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import sympy
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares, lsq_linear, root
from studies import run_file, study_text, write

from ddpc_controllers import NMPC, Idle
from ddpc_controllers.models.plant_equations import PlantEquations, find_model
from ddpc_cosim import (
    OK,
    Band,
    Bounds,
    Charge,
    ConfigError,
    FMUPlant,
    Loop,
    PluginError,
    Price,
    Recording,
    Sample,
    Steps,
    Variable,
    cosimulate,
)
from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.study.results import CaseResult
from fmu_plants import build_fmu, cstr
from fmu_plants.equations import resolve

from .loops import ANGLE, DEGREE, close_loop, pendulum, pendulum_loop, quick_pendulum
from .plant_models import DISTURBED, FUNCTIONS

PENDULUM = {
    "inputs": (Variable("torque"),),
    "outputs": (Variable("angle"),),
    "measurements": (Variable("angle"),),
}


def loop_of(**changes: Any) -> Loop:
    """Return the pendulum's loop, its angle measured."""
    return replace(pendulum_loop(None), **(PENDULUM | changes))


def step_of(angle: float = 0.0, reference: float = 0.3, horizon: int = 20, k: int = 0) -> Sample:
    y = np.array([angle])
    return Sample(k, 0.1 * k, y, y, np.full((horizon, 1), reference), np.array([reference]))


def test_its_inputs_are_those_of_the_best_plan_for_the_whole_run() -> None:
    """The oracle knows all 30 samples and solves the problem once, by another integrator and solver."""
    samples, weight = 30, 1e-2
    reference = np.repeat([0.0, 0.35, -0.17], 10)

    def residuals(torques: np.ndarray) -> np.ndarray:
        x, errors = np.zeros(2), []
        for torque, r in zip(torques, reference, strict=True):
            x = quick_pendulum(x, np.array([torque]))
            errors.append(x[0] - r)
        return np.append(errors, np.sqrt(weight) * np.diff(torques, prepend=0.0))

    best = least_squares(residuals, np.zeros(samples), bounds=(-2.5, 2.5), xtol=1e-10, ftol=1e-10)
    loop = loop_of(bounds=Bounds(np.array([-2.5]), np.array([2.5]), np.array([-9.0]), np.array([9.0])))
    future = np.concatenate([[0.0], reference, np.full(30, reference[-1])])[:, np.newaxis]
    run = close_loop(
        NMPC(model="pendulum", horizon=30, change_weight=weight), loop, pendulum, ANGLE, future, steps=samples
    )
    assert set(run.status) == {OK}
    assert np.abs(run.u).max() == pytest.approx(2.5, abs=1e-4)
    # Beyond the run the controller goes on caring, the oracle does not.
    assert np.abs(run.u[:20, 0] - best.x[:20]).max() <= 0.02
    assert 2.0 * best.cost <= np.square(residuals(run.u[:, 0])).sum() <= 1.01 * 2.0 * best.cost


TASKS: dict[str, tuple[dict[str, tuple[float, float]], dict[str, float], float, int]] = {
    "pendulum": ({"torque": (-3.5, 3.5)}, {"angle": 0.35}, 0.1, 30),
    "van-der-pol": ({"force": (-3.0, 3.0)}, {"position": 1.0}, 0.2, 30),
    "quadruple-tank": (
        {"pump_1": (0.0, 6.0), "pump_2": (0.0, 6.0)},
        {"level_1": 2.0, "level_2": -1.0},
        10.0,
        50,
    ),
    "cstr": ({"coolant_temperature": (285.0, 310.0)}, {"temperature": 10.0}, 10.0, 50),
    "two-mass-drive": ({"motor_torque": (-5.0, 5.0)}, {"load_speed": 10.0}, 0.02, 40),
    "cart-pendulum": ({"force": (-10.0, 10.0)}, {"angle": 0.05}, 0.02, 40),
    "distillation-column": (
        {"reflux": (1.6, 2.3), "steam": (1.4, 2.0)},
        {"distillate": 0.75, "bottoms": 0.5},
        120.0,
        50,
    ),
    "building": ({"heating_power": (0.0, 8000.0)}, {"indoor_temperature": 1.0}, 900.0, 40),
    "servo": ({"torque": (-3.0, 3.0)}, {"angle": 0.5}, 0.05, 40),
    "boiler-turbine": (
        dict.fromkeys(("fuel_valve", "steam_valve", "feedwater_valve"), (0.0, 1.0)),
        {"pressure": 4.0, "power": 5.0, "level": 0.0},
        10.0,
        50,
    ),
}


@pytest.mark.parametrize("name", TASKS)
def test_it_leaves_less_than_a_hundredth_of_a_step_on_every_plant(name: str) -> None:
    bounds, steps, sampling_time, samples = TASKS[name]
    model = load_plugin("plants", name)
    with FMUPlant(build_fmu(model), inputs=[*bounds], outputs=[*steps], isolated=False) as plant:
        at_rest = dict(zip(steps, plant.reset(), strict=True))
        trace = cosimulate(
            plant,
            NMPC(model=name, horizon=15),
            sampling_time=sampling_time,
            duration=samples * sampling_time,
            reference={
                output: Steps((0.0, 3 * sampling_time), (y, y + steps[output]))
                for output, y in at_rest.items()
            },
            bounds=bounds,
        )
    assert trace.outcome == "completed"
    assert set(trace.status) == {OK}
    left = np.abs(trace.y - trace.reference)[-5:]
    size = np.array([abs(step) or 0.1 for step in steps.values()])
    assert (left / size).max() <= 0.01


def test_what_is_cheapest_lies_at_the_limit_of_an_output_and_is_an_optimum_to_the_last_digit() -> None:
    """A hotter reactor leaves less reactant, which costs; two balances say what holds it at the limit."""
    limit, steps, h = 335.0, 30, 10.0
    rate = cstr.RATE * math.exp(-cstr.ACTIVATION / limit)
    concentration = cstr.FLOW / (cstr.FLOW + cstr.VOLUME * rate)
    heat = cstr.FLOW * cstr.HEAT_CAPACITY * (cstr.FEED_TEMPERATURE - limit)
    heat += cstr.REACTION_HEAT * cstr.VOLUME * rate * concentration
    outputs = ["temperature", "concentration"]
    per = "mol.min/L"
    reactant = Price(signal="concentration", price=5.0, unit=f"EUR/{per}")
    with FMUPlant(
        build_fmu(cstr.MODEL), inputs=["coolant_temperature"], outputs=outputs, isolated=False
    ) as plant:
        trace = cosimulate(
            plant,
            NMPC(model="cstr", horizon=8, change_weight=1e-3),
            sampling_time=h,
            duration=steps * h,
            outputs=["temperature"],
            reference={"temperature": Band(300.0, limit)},
            bounds={"coolant_temperature": (285.0, 310.0), "temperature": (200.0, limit)},
            prices={"reactant": reactant},
        )
    assert set(trace.status) == {OK}
    assert trace.y[:, 0].max() <= limit + 1e-2
    assert trace.y[-1, 0] == pytest.approx(limit, abs=1e-2)
    assert trace.u[-1, 0] == pytest.approx(limit - heat / cstr.HEAT_TRANSFER, abs=0.05)


@pytest.mark.parametrize(
    ("name", "points"),
    {
        "cart-pendulum": 3,
        "servo": 1,
        "distillation-column": 1,
        "quadruple-tank": 3,
        "building": 3,
    }.items(),
)
def test_its_prediction_is_that_of_the_equations(name: str, points: int) -> None:
    """One sample from the start, by another integrator: unstable, stiff with friction, and of 24 states."""
    model = load_plugin("plants", name)
    bounds, _, sampling_time, _ = TASKS[name]
    driven = tuple(v for v in model.inputs if v.name in bounds)
    plant = PlantEquations(
        model, loop_of(inputs=driven, outputs=model.outputs, measurements=(), sampling_time=sampling_time), {}
    )
    symbols = ["time", *(v.name for v in (*model.states, *model.inputs, *model.parameters))]
    slopes = sympy.lambdify(
        [sympy.Symbol(s, real=True) for s in symbols], [*resolve(model).derivatives.values()]
    )
    inputs = np.array([v.start for v in model.inputs])
    inputs[: len(driven)] += 0.5 * np.array([v.nominal for v in driven])
    constants = [parameter.start for parameter in model.parameters]
    x = np.array([v.start for v in model.states])
    exact = solve_ivp(
        lambda t, x: slopes(t, *x, *inputs, *constants),
        (0.0, sampling_time),
        x,
        "Radau",
        rtol=1e-9,
        atol=1e-11,
    ).y[:, -1]
    u, d = inputs[: len(driven)], np.zeros(plant.disturbances)
    ahead, expected = (plant.output(z, u, d, 0.0).full()[:, 0] for z in (plant.advance(x, u, d, 0.0), exact))
    assert ahead == pytest.approx(expected, rel=1e-4, abs=1e-6)

    def defects(z: np.ndarray) -> np.ndarray:
        left = plant.defects(z.reshape(-1, len(x)).T, x, u, d, 0.0).full().T
        return np.divide(left, plant.nominal).ravel()

    planned = root(defects, np.tile(x, plant.points))
    assert plant.points == points
    assert plant.output(planned.x[-len(x) :], u, d, 0.0).full()[:, 0] == pytest.approx(
        expected, rel=1e-4, abs=1e-6
    )


@pytest.mark.parametrize("point", [(0.3, -0.7), (0.9, 0.4), (-0.6, -0.1)])
def test_every_function_of_the_equations_is_converted(point: tuple[float, float]) -> None:
    loop = loop_of(inputs=FUNCTIONS.inputs, outputs=FUNCTIONS.outputs, measurements=(), sampling_time=1e-9)
    plant = PlantEquations(FUNCTIONS, loop, {})
    x, u = np.array([point[0], 0.0]), np.array([point[1], 0.0])
    slope = (plant.advance(x, u, np.zeros(2), 0.5).full()[:, 0] - x) / 1e-9
    values = {"y1": point[0], "y2": 0.0, "u1": point[1], "u2": 0.0, "time": 0.5}
    expected = [
        float(expression.subs({symbol: values[symbol.name] for symbol in expression.free_symbols}))
        for expression in resolve(FUNCTIONS).derivatives.values()
    ]
    assert slope == pytest.approx(expected, rel=1e-5, abs=1e-5)


def test_what_it_is_not_told_of_leaves_no_offset() -> None:
    """A torque that is not announced, and a pendulum that is heavier than its model."""

    def heavier(x: np.ndarray, torque: np.ndarray) -> np.ndarray:
        return quick_pendulum(x, torque / 1.3 + 0.4)

    reference = np.full((100, 1), 15.0 * DEGREE)
    run = close_loop(NMPC(model="pendulum"), loop_of(), heavier, ANGLE, reference, steps=60)
    assert np.abs(run.y - run.reference[:60])[-10:].max() <= 0.01 * 15.0 * DEGREE


def test_it_uses_every_measurement_that_it_says_it_uses() -> None:
    loop = loop_of(measurements=(Variable("angle"), Variable("angular_velocity")))
    answers = []
    for velocity in (-0.4, 0.6):
        controller = NMPC(model="pendulum", measurement_noise=1e-6)
        controller.start(loop)
        measured, nothing = np.array([0.2, velocity]), np.zeros((20, 1))
        answers.append(controller.step(Sample(0, 0.0, measured[:1], measured, nothing, nothing[0])).u[0])
    assert answers[0] > answers[1] + 0.01
    facts = controller.knowledge(loop)
    assert facts["measures"] == "angle, angular_velocity"
    assert "equations" in facts["plant"]


def test_where_no_optimum_is_found_the_last_plan_goes_on_or_the_inputs_are_held() -> None:
    hurried = NMPC(model="pendulum", iterations=1)
    hurried.start(loop_of())
    first = hurried.step(step_of())
    assert first.status == "Maximum_Iterations_Exceeded: the last input is held"
    assert np.array_equal(first.u, [0.0])

    planned = NMPC(model="pendulum")
    planned.start(loop_of())
    planned.step(step_of())
    plan = planned._guess[1][0]
    x = quick_pendulum(np.zeros(2), np.zeros(1))
    planned._solver = hurried._solver
    second = planned.step(step_of(float(x[0]), -0.3, k=1))
    assert second.status == "Maximum_Iterations_Exceeded: the next inputs of the last plan are applied"
    assert second.u == pytest.approx(plan[:1])


def test_a_missing_measurement_is_predicted_and_a_missing_reference_holds_the_inputs() -> None:
    controller = NMPC(model="pendulum")
    controller.start(loop_of())
    acted = controller.step(step_of())
    blind = controller.step(step_of(float("nan"), k=1))
    assert "prediction" in blind.status
    assert np.isfinite(blind.u).all()
    held = controller.step(step_of(reference=float("nan"), k=2))
    assert "reference" in held.status
    assert np.array_equal(held.u, blind.u)
    assert acted.info["iterations"] > 0


def test_without_casadi_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(ConfigError, match=r"NMPC needs CasADi: .*`uv sync --extra nmpc"):
        NMPC(model="pendulum")


def test_what_is_large_is_imported_once_for_all_workers_and_not_to_list_it() -> None:
    program = """
import sys
import zipfile
from ddpc_controllers.nmpc import NMPC, preload
assert not {"casadi", "sympy"} & set(sys.modules)
preload()
assert {"casadi", "sympy"} <= set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", program], check=True)


def test_the_plant_is_found_by_name_or_by_its_fmu(tmp_path: Any) -> None:
    pendulum_model = load_plugin("plants", "pendulum")
    assert find_model("pendulum", "{plant}") is pendulum_model
    assert find_model("fmu_plants.pendulum:MODEL", "{plant}") is pendulum_model
    assert find_model("", str(build_fmu(pendulum_model))) is pendulum_model
    with pytest.raises(ConfigError, match=r"which plant\? give model"):
        find_model("", "{plant}")
    with pytest.raises(PluginError, match='did you mean "pendulum"'):
        find_model("pendlum", "{plant}")
    (tmp_path / "no.fmu").write_text("")
    with pytest.raises(ConfigError, match="is not an FMU that can be read"):
        find_model("", str(tmp_path / "no.fmu"))
    with zipfile.ZipFile(tmp_path / "bomb.fmu", "w", zipfile.ZIP_BZIP2) as archive:
        archive.writestr("modelDescription.xml", bytes(10**7))
    with pytest.raises(ConfigError, match="it is compressed with bzip2"):
        find_model("", str(tmp_path / "bomb.fmu"))
    with pytest.raises(ConfigError, match="has no equations"):
        find_model("ddpc_cosim:Plant", "{plant}")


def test_every_name_that_the_model_does_not_have_is_told_at_once() -> None:
    loop = loop_of(inputs=(Variable("push"),), outputs=(Variable("height"),))
    with pytest.raises(ConfigError) as caught:
        NMPC(model="pendulum", parameters={"weight": 1.0}).start(loop)
    assert [fault.split('"')[1] for fault in caught.value.faults] == ["push", "height", "weight"]


def test_idle_rests_whatever_happens() -> None:
    start = Variable("torque", start=0.4)
    controller = Idle()
    controller.start(loop_of(inputs=(start,)))
    assert [float(controller.step(step_of(angle, k=k))[0]) for k, angle in enumerate((0.0, np.nan))] == [
        0.4,
        0.4,
    ]
    assert controller.knowledge(loop_of()) == {"measures": "", "plant": "nothing"}


LAG = """
from fmu_plants import Equations, PlantModel, Variable

X = Variable("x")
MODEL = PlantModel(
    name="{name}",
    states=(X,),
    inputs=(Variable("u"),),
    outputs=(X,),
    equations=lambda v: Equations({{"x": v.u - v.x}}),
)
"""


def run_lag(folder: Path, plant: str, **model: str) -> CaseResult:
    for name in ("lag_of_a_module", "lag_of_a_file"):
        (folder / f"{name}.py").write_text(LAG.format(name=name), encoding="utf-8")
    text = study_text(
        plant={"name": plant},
        reference={"x": 1.0},
        controllers={"nmpc": {"type": "nmpc", "settings": {"horizon": 5} | model}},
        bounds={"u": {"min": -5.0, "max": 5.0}},
    )
    (case,) = run_file(write(folder, text)).cases
    return case


@pytest.mark.parametrize(
    ("plant", "model"),
    [
        ("lag_of_a_module:MODEL", {}),
        ("lag_of_a_file.py:MODEL", {}),
        ("lag_of_a_file.py:MODEL", {"model": "lag_of_a_module:MODEL"}),
        ("lag_of_a_module:MODEL", {"model": "lag_of_a_file.py:MODEL"}),
    ],
)
def test_a_plant_that_the_study_names_is_found_installed_or_not(
    tmp_path: Path, plant: str, model: dict[str, str]
) -> None:
    case = run_lag(tmp_path, plant, **model)
    assert case.outcome == "completed", case.reason
    assert abs(case.trace().y[-1, 0] - 1.0) < 1e-2


def test_the_equations_that_it_is_given_decide_the_id_of_its_cases(tmp_path: Path) -> None:
    first = run_lag(tmp_path, "lag_of_a_file.py:MODEL", model="lag_of_a_module:MODEL")
    (tmp_path / "other.py").write_text(LAG.format(name="other").replace("- v.x", "- 2 * v.x"))
    other = run_lag(tmp_path, "lag_of_a_file.py:MODEL", model="other.py:MODEL")
    (tmp_path / "other.py").write_text(LAG.format(name="other").replace("- v.x", "- 3 * v.x"))
    changed = run_lag(tmp_path, "lag_of_a_file.py:MODEL", model="other.py:MODEL")
    assert len({case.id for case in (first, other, changed)}) == 3


def disturbed_loop(**changes: Any) -> Loop:
    """The loop of a linear plant whose second state is paid for, and not controlled."""
    u1, *disturbances = DISTURBED.inputs
    y1, y2 = DISTURBED.outputs
    bounds = Bounds(np.array([-0.9]), np.array([0.9]), np.array([-np.inf]), np.array([np.inf]))
    base = loop_of(inputs=(u1,), outputs=(y1,), measurements=(y1, y2), bounds=bounds)
    return replace(base, disturbances=tuple(disturbances), **changes)


class Slopes(NamedTuple):
    """A linear plant of :mod:`plant_models`: what its states do, what forces them, where y1 and y2 are."""

    model: str
    a: list[list[float]]
    forced: list[list[float]]
    seen: tuple[int, int]


SLOPES = {
    "two lags": Slopes("DISTURBED", [[-1.0, 0.5], [0.0, -1.5]], [[1.0, 0.6, 0.0], [0.4, 0.0, 1.0]], (0, 1)),
    "oscillator": Slopes(
        "OSCILLATING",
        [[0.0, 1.0, 0.0], [-4.0, -0.6, 0.0], [0.0, 0.5, -1.0]],
        [[0.0, 0.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        (0, 2),
    ),
    "integrator": Slopes(
        "INTEGRATING", [[0.0, 0.7], [0.0, -2.0]], [[0.0, 0.3, 0.0], [1.0, 0.0, 0.4]], (0, 1)
    ),
}


def sampled(slopes: Slopes, h: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B and E of the linear plant over h, by the Runge-Kutta steps that the filter takes."""
    plant = PlantEquations(
        load_plugin("plants", f"{__package__}.plant_models:{slopes.model}"), disturbed_loop(), {}
    )
    size, h = len(slopes.a), h / plant.steps
    a, forced = np.array(slopes.a), np.array(slopes.forced)
    powers = [np.linalg.matrix_power(h * a, i) / math.factorial(i) for i in range(5)]
    step = np.sum(powers, axis=0)
    driven = h * np.sum([power / (i + 1) for i, power in enumerate(powers[:4])], axis=0) @ forced
    whole, acted = np.eye(size), np.zeros_like(forced)
    for _ in range(plant.steps):
        whole, acted = step @ whole, step @ acted + driven
    return whole, acted[:, :1], acted[:, 1:]


def as_planned(slopes: Slopes, h: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B and E by the stability function of Radau IIA of three points, a Pade approximation of exp."""
    a, forced = np.array(slopes.a), np.array(slopes.forced)
    size = len(a)
    z = np.zeros((size + forced.shape[1],) * 2)
    z[:size] = h * np.hstack([a, forced])
    over, under = [1, 2 / 5, 1 / 20], [1, -3 / 5, 3 / 20, -1 / 60]
    whole = np.linalg.solve(
        *(sum(c * np.linalg.matrix_power(z, i) for i, c in enumerate(part)) for part in (under, over))
    )
    return whole[:size, :size], whole[:size, size : size + 1], whole[:size, size + 1 :]


@pytest.mark.parametrize(
    ("plant", "use_forecast"), [("two lags", False), *((plant, True) for plant in SLOPES)]
)
def test_with_everything_known_its_inputs_are_those_of_the_whole_problem(
    plant: str, use_forecast: bool
) -> None:
    """Disturbances, a band, input limits that move, prices of the input and of the second state.

    What a band costs, max(0, y - h)^2 + max(0, l - y)^2, is the least of (y - v)^2 over l <= v <= h, and what
    is paid completes the squares of the changes: all of it is bounded least squares.
    """
    n, r, weight, h = 8, 1e-2, 0.05, 0.1
    charges = (Charge("tariff", "u1", 2.0, "EUR", True), Charge("heat", "y2", 3.0, "EUR", True))
    loop = disturbed_loop(bands=("y1",), moving_limits=("u1",), charges=charges)
    controller = NMPC(
        model=f"{__package__}.plant_models:{SLOPES[plant].model}", horizon=n, change_weight=r,
        price_weight=weight, use_forecast=use_forecast,
    )  # fmt: skip
    controller.start(loop)
    a, b, e = sampled(SLOPES[plant], h)
    a_planned, b_planned, e_planned = as_planned(SLOPES[plant], h)
    first, second = SLOPES[plant].seen
    rng = np.random.default_rng(2)
    d = np.cumsum(0.1 * rng.standard_normal((60, 2)), axis=0)
    middle = np.repeat([0.0, 0.4, -0.3], 20)
    band = np.stack([middle - 0.1, middle + 0.1], axis=-1)[:, np.newaxis]
    high = np.repeat(rng.uniform(0.2, 0.9, 12), 5)
    limits = np.stack([np.full(60, -0.9), high], axis=-1)[:, np.newaxis]
    price = np.repeat(rng.uniform(0.0, 3.0, (10, 2)), 6, axis=0)
    x, last, bounded, off = np.zeros(len(a)), 0.0, 0, 0.0
    power = [np.linalg.matrix_power(a_planned, i) for i in range(n + 1)]
    changes = np.eye(n) - np.eye(n, k=-1)

    def response(column: np.ndarray) -> np.ndarray:
        rows = [[power[k - i] @ column if i <= k else 0.0 * column for i in range(n)] for k in range(n)]
        return np.array(rows).transpose(0, 2, 1)

    to_states = response(b_planned[:, 0])
    for k in range(40):
        measured = x[[first, second]]
        y = measured[:1]
        nearest, now = np.clip(y, *band[k + 1 : k + 1 + n].transpose(2, 0, 1)), np.clip(y, *band[k, 0])
        sample = Sample(
            k, 0.1 * k, y, measured, nearest, now,
            disturbance=d[k], forecast=d[k + 1 : k + 1 + n], band_now=band[k], band=band[k + 1 : k + 1 + n],
            price=price[k : k + 1 + n], input_limits=limits[k : k + 1 + n],
            output_limits=np.tile([-np.inf, np.inf], (n, 1, 1)),
        )  # fmt: skip
        u = controller.step(sample)
        assert u.status == OK
        acting = d[k : k + n] if use_forecast else np.tile(d[k], (n, 1))
        free = np.array([power[i + 1] @ x for i in range(n)])
        free += sum(response(e_planned[:, j]) @ acting[:, j] for j in range(2))
        slope = (
            weight
            * h
            * (2.0 * price[k : k + n, 0] + 3.0 * to_states[:, second].T @ price[k + 1 : k + 1 + n, 1])
        )
        root = np.sqrt(r)
        of_price = np.linalg.solve(changes.T, slope) / (2.0 * r)
        system = np.block([[to_states[:, first], -np.eye(n)], [root * changes, np.zeros((n, n))]])
        target = np.append(-free[:, first], root * (np.append(last, np.zeros(n - 1)) - of_price))
        low, up = (np.append(limits[k : k + n, 0, side], band[k + 1 : k + 1 + n, 0, side]) for side in (0, 1))
        best = lsq_linear(system, target, (low, up), method="bvls", tol=1e-15, max_iter=500).x[0]
        off = max(off, abs(float(u.u[0]) - best))
        bounded += u.u[0] >= high[k] - 1e-7
        last = float(u.u[0])
        x = a @ x + b @ u.u + e @ d[k]
    # An interior point stays off a limit that hardly matters by its complementarity over the multiplier.
    assert off <= (3e-8 if plant == "oscillator" else 1e-8)
    assert 3 < bounded < 37


@pytest.mark.parametrize("plant", SLOPES)
def test_switched_on_where_it_runs_already_it_changes_nothing(plant: str) -> None:
    """Its filter follows what was applied and measured, as if it had been there all along."""
    loop = disturbed_loop()
    a, b, e = sampled(SLOPES[plant], 0.1)
    rng = np.random.default_rng(4)
    d = np.cumsum(0.1 * rng.standard_normal((60, 2)), axis=0)
    reference = np.repeat([0.0, 0.4, -0.3], 20)[:, np.newaxis]
    settings: dict[str, Any] = {"horizon": 8, "change_weight": 1e-2}
    first, other = (
        NMPC(model=f"{__package__}.plant_models:{SLOPES[plant].model}", **settings) for _ in range(2)
    )
    first.start(loop)
    x, rows, later = np.zeros(len(a)), list[tuple[np.ndarray, ...]](), 25
    for k in range(40):
        measured = x[list(SLOPES[plant].seen)] + 0.01 * rng.standard_normal(2)
        sample = Sample(
            k, 0.1 * k, measured[:1], measured, reference[k + 1 : k + 9], reference[k],
            disturbance=d[k], forecast=d[k + 1 : k + 9],
        )  # fmt: skip
        u = first.step(sample).u
        if k == later:
            past = Recording(*map(np.array, zip(*((u, m[:1], m) for u, m, _ in rows), strict=True)), 0.1,
                d=np.array([row[2] for row in rows]))  # fmt: skip
            other.start(replace(loop, past=past))
        if k >= later:
            # From there on its samples begin with 0, and so does its time.
            since = sample._replace(k=k - later, time=0.1 * (k - later))
            assert np.abs(other.step(since).u - u).max() <= 1e-6
        rows.append((u, measured, d[k]))
        x = a @ x + b @ u + e @ d[k]


def test_a_disturbance_that_the_equations_do_not_know_is_refused() -> None:
    loop = disturbed_loop()
    loop = replace(loop, disturbances=(*loop.disturbances, Variable("rain")))
    with pytest.raises(ConfigError, match=r'no input that is not driven.* "rain"; it has: sun, wind'):
        NMPC(model=f"{__package__}.plant_models:DISTURBED").start(loop)
