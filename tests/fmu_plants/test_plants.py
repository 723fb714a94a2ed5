"""The plants: their FMUs of all four kinds against formulas written here, and what they are known for."""

import importlib
from functools import cache

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp
from scipy.linalg import eigvals, expm
from scipy.optimize import brentq

from ddpc_cosim import FMUPlant
from fmu_plants import build_fmu
from fmu_plants.linear import linearise

SAMPLES = 40


def pendulum(x, u):
    return [x[1], -9.81 / 0.2 * np.sin(x[0]) - 0.4 / 0.2 * x[1] + u[0] / 0.2]


def van_der_pol(x, u):
    return [x[1], (1.0 - x[0] ** 2) * x[1] - x[0] + u[0]]


def quadruple_tank(x, u):
    q = [a * np.sqrt(2 * 981.0 * h) for a, h in zip((0.071, 0.057, 0.071, 0.057), x, strict=True)]
    return [
        (-q[0] + q[2] + 0.7 * 3.33 * u[0]) / 28.0,
        (-q[1] + q[3] + 0.6 * 3.35 * u[1]) / 32.0,
        (-q[2] + 0.4 * 3.35 * u[1]) / 28.0,
        (-q[3] + 0.3 * 3.33 * u[0]) / 32.0,
    ]


def cstr(x, u):
    """In minutes, as published, divided by 60 s/min at the end."""
    reaction = 7.2e10 * np.exp(-8750.0 / x[1]) * x[0]
    heating = 5e4 / (1000.0 * 0.239) * reaction
    cooling = 5e4 / (100.0 * 1000.0 * 0.239) * (u[0] - x[1])
    return [(1.0 - x[0] - reaction) / 60.0, (350.0 - x[1] + heating + cooling) / 60.0]


def two_mass_drive(x, u):
    inertia = np.diag([0.02, 0.03, 1.0])
    forces = np.array([[-0.06, 0.05, -40.0], [0.05, -0.07, 40.0], [1.0, -1.0, 0.0]]) @ x
    return np.linalg.solve(inertia, forces + np.array([u[0], -u[1], 0.0]))


def cart_pendulum(x, u):
    _, velocity, angle, rate = x
    ml = 0.2 * 0.3
    masses = np.array([[0.7, -ml * np.cos(angle)], [-ml * np.cos(angle), 0.006 + ml * 0.3]])
    forces = [u[0] - 0.1 * velocity - ml * rate**2 * np.sin(angle), ml * 9.81 * np.sin(angle)]
    acceleration, angular_acceleration = np.linalg.solve(masses, forces)
    return [velocity, acceleration, rate, angular_acceleration]


def servo(x, u):
    stribeck = 0.25 * (np.tanh(100.0 * x[1]) - np.tanh(10.0 * x[1]))
    return [x[1], (u[0] - stribeck - 0.5 * np.tanh(100.0 * x[1]) - 0.3 * x[1]) / 0.05]


def building(x, u):
    """In kW, kWh and h, divided by 3600 s/h at the end."""
    heating, outdoors, sun = u[0] / 1e3, u[1], 6.0 * u[2] / 1e3
    in_heater, in_envelope = (x[1] - x[0]) / 0.4, (x[0] - x[2]) / 0.9
    lost = (x[2] - outdoors) / 4.4
    return (
        np.array(
            [(in_heater - in_envelope + sun) / 0.9, (heating - in_heater) / 0.3, (in_envelope - lost) / 3.2]
        )
        / 3600
    )


# Wood and Berry (1973): input, output, gain, time constant and dead time in minutes.
COLUMN = [
    (0, 0, 12.8, 16.7, 1.0),
    (1, 0, -18.9, 21.0, 3.0),
    (2, 0, 3.8, 14.9, 8.1),
    (0, 1, 6.6, 10.9, 7.0),
    (1, 1, -19.4, 14.4, 3.0),
    (2, 1, 4.9, 13.2, 3.4),
]


def distillation_column(x, u):
    """Of each path: its effect, and the delayed flow in controllable form."""
    flows, slopes = np.asarray(u) - [1.95, 1.71, 2.45], []
    for (flow, _, gain, lag, delay), (effect, *q) in zip(COLUMN, np.reshape(x, (6, 4)), strict=True):
        delayed = q[0] - 0.4 * q[1] + 0.05 * q[2]
        last = 60.0 * (flows[flow] - q[0]) - 36.0 * q[1] - 9.0 * q[2]
        slopes += [(gain * delayed - effect) / lag, q[1] / delay, q[2] / delay, last / delay]
    return np.array(slopes) / 60.0


def boiler_turbine(x, u):
    flow = x[0] ** 1.125
    return [
        -0.0018 * u[1] * flow + 0.9 * u[0] - 0.15 * u[2],
        (0.073 * u[1] - 0.016) * flow - 0.1 * x[1],
        (141.0 * u[2] - (1.1 * u[1] - 0.19) * x[0]) / 85.0,
    ]


def ph_neutralisation(x, u):
    """With concentrations in mol/L, and the buffer capacity of a diprotic acid (Van Slyke 1922)."""
    base, acid, buffer = u
    h, k1, k2 = 10.0 ** -x[3], 10.0**-6.35, 10.0**-10.25
    volume, charge, carbonate = 207.0 * x[2], 1e-3 * x[0], 1e-3 * x[1]
    charging = (acid * (3e-3 - charge) + buffer * (-3e-2 - charge) + base * (-3.05e-3 - charge)) / volume
    loading = (-acid * carbonate + buffer * (3e-2 - carbonate) + base * (5e-5 - carbonate)) / volume
    species = h**2 + k1 * h + k1 * k2
    mean = (k1 * h + 2 * k1 * k2) / species
    capacity = h + 1e-14 / h + carbonate * k1 * h * (h**2 + 4 * k2 * h + k1 * k2) / species**2
    unbalanced = charge + 1e-14 / h - h + carbonate * mean
    return [
        1e3 * charging,
        1e3 * loading,
        (base + acid + buffer - 8.75 * np.sqrt(x[2])) / 207.0,
        -(charging + mean * loading + unbalanced / 5.0) / (np.log(10.0) * capacity),
    ]


def level(x, u):
    steam = (1.0 - 0.001538 * x[2]) * (0.8 * x[0] - 25.6) / (x[2] * (1.0394 - 0.0012304 * x[0]))
    evaporation = (0.854 * u[1] - 0.147) * x[0] + 45.59 * u[0] - 2.514 * u[2] - 2.096
    return 0.05 * (0.13073 * x[2] + 100.0 * steam + evaporation / 9.0 - 67.975)


# What is put out where it is not states.
OUTPUTS = {
    distillation_column: lambda x, u: [96.25 + x[0] + x[4] + x[8], 0.5 + x[12] + x[16] + x[20]],
    boiler_turbine: lambda x, u: [x[0], x[1], level(x, u)],
    ph_neutralisation: lambda x, u: [x[3], x[2]],
}

# How far the inputs go from their start values.
AMPLITUDES = {
    pendulum: 3.5,
    van_der_pol: 1.0,
    quadruple_tank: 1.0,
    cstr: 5.0,
    two_mass_drive: 2.0,
    cart_pendulum: 0.2,
    servo: 2.0,
    building: np.array([2000.0, 5.0, 0.0]),
    distillation_column: 0.1,
    boiler_turbine: 0.02,
    ph_neutralisation: np.array([1.0, 0.5, 0.1]),
}
PLANTS = [pytest.param(formula, amplitude, id=formula.__name__) for formula, amplitude in AMPLITUDES.items()]


def model_of(formula):
    return importlib.import_module(f"fmu_plants.{formula.__name__}").MODEL


def starts(variables):
    return np.array([variable.start for variable in variables])


def excitation(model, amplitude):
    """Return inputs that are held, shape (SAMPLES, m)."""
    rng = np.random.default_rng(8)
    return starts(model.inputs) + rng.uniform(-amplitude, amplitude, (SAMPLES, len(model.inputs)))


@cache
def reference(formula):
    """Return the states at the end of every sample of the excitation, shape (SAMPLES, n)."""
    model = model_of(formula)
    x, rows = starts(model.states), []
    for u in excitation(model, AMPLITUDES[formula]):
        x = solve_ivp(
            lambda _, x, u=u: formula(x, u), (0.0, model.step_size), x, "DOP853", rtol=1e-12, atol=1e-13
        ).y[:, -1]
        rows.append(x)
    return np.array(rows)


def simulated(fmu, model, inputs, kind):
    times = model.step_size * np.arange(SAMPLES + 1)
    held = np.zeros(2 * SAMPLES, [("time", "f8"), *((v.name, "f8") for v in model.inputs)])
    held["time"] = np.repeat(times, 2)[1:-1]  # a doubled instant is a jump to FMPy
    for variable, column in zip(model.inputs, inputs.T, strict=True):
        held[variable.name] = np.repeat(column, 2)
    result = fmpy.simulate_fmu(
        str(fmu),
        stop_time=times[-1],
        output_interval=model.step_size,
        input=held,
        output=[state.name for state in model.states],
        fmi_type=kind,
        relative_tolerance=1e-10,
        record_events=False,
    )
    return np.column_stack([result[state.name][1:] for state in model.states])


@pytest.mark.parametrize("fmi_version", ["2.0", "3.0"])
@pytest.mark.parametrize(("formula", "amplitude"), PLANTS)
def test_co_simulation_and_model_exchange_agree_with_the_formula(formula, amplitude, fmi_version):
    model = model_of(formula)
    fmu = build_fmu(model, fmi_version)
    assert validate_fmu(str(fmu)) == []
    inputs = excitation(model, amplitude)
    exact = reference(formula)
    nominal = np.array([state.nominal for state in model.states])
    for kind in ("CoSimulation", "ModelExchange"):
        error = np.abs(simulated(fmu, model, inputs, kind) - exact) / nominal
        assert error.max() <= 1e-7, kind


@pytest.mark.parametrize("fmi_type", ["co-simulation", "model-exchange"])
@pytest.mark.parametrize("fmi_version", ["2.0", "3.0"])
@pytest.mark.parametrize(("formula", "amplitude"), PLANTS)
def test_they_agree_behind_the_plant_contract_as_well(formula, amplitude, fmi_version, fmi_type):
    model = model_of(formula)
    inputs = excitation(model, amplitude)[:10]
    names = [variable.name for variable in model.inputs]
    states = [state.name for state in model.states]
    fmu = build_fmu(model, fmi_version)
    with FMUPlant(fmu, inputs=names, outputs=states, fmi_type=fmi_type) as plant:
        plant.reset()
        rows = np.array([plant.step(u, model.step_size) for u in inputs])
    error = np.abs(rows - reference(formula)[:10]) / [state.nominal for state in model.states]
    assert error.max() <= 1e-7


@pytest.mark.parametrize(("formula", "amplitude"), PLANTS)
def test_plants_begin_at_rest(formula, amplitude):
    model = model_of(formula)
    slope = np.array(formula(starts(model.states), starts(model.inputs)))
    assert np.abs(slope / [state.nominal for state in model.states]).max() <= 1e-14


@pytest.mark.parametrize(("formula", "amplitude"), PLANTS)
def test_linear_models_are_the_differences_of_the_formula(formula, amplitude):
    model = model_of(formula)
    n = len(model.states)
    names = [state.name for state in model.states]
    selected = [names.index(output.name) for output in model.outputs if output.name in names]
    outputs = OUTPUTS.get(formula, lambda x, u: x[selected])
    rng = np.random.default_rng(9)
    nominal = np.array([v.nominal for v in (*model.states, *model.inputs)])
    point = starts((*model.states, *model.inputs)) + 0.05 * nominal * rng.uniform(-1, 1, len(nominal))
    a, b, c, d = linearise(model, point[:n], point[n:])
    for index, size in enumerate(1e-6 * nominal):
        shift = size * np.eye(len(point))[index]
        for matrix, function in ((np.hstack([a, b]), formula), (np.hstack([c, d]), outputs)):
            up, down = (np.array(function(z[:n], z[n:])) for z in (point + shift, point - shift))
            assert matrix[:, index] == pytest.approx((up - down) / (2 * size), rel=1e-6, abs=1e-6)


def zeros(a, b, c, d):
    """Return the finite transmission zeros, from the system matrix."""
    n, m = b.shape
    values = eigvals(
        np.block([[a, b], [c, d]]), np.block([[np.eye(n), np.zeros((n, m))], [np.zeros((m, n + m))]])
    )
    return values[np.isfinite(values) & (np.abs(values) < 1e3)].real


def test_a_zero_of_the_quadruple_tank_moves_with_the_valves():
    """Johansson (2000), section II.C: minimum phase if and only if gamma_1 + gamma_2 > 1."""
    model = model_of(quadruple_tank)
    assert zeros(*linearise(model)).max() < 0.0
    moved = {"split_1": 0.43, "split_2": 0.34, "pump_gain_1": 3.14, "pump_gain_2": 3.29}
    assert zeros(*linearise(model, parameters=moved)).max() > 0.0


def test_the_quadruple_tank_begins_near_the_published_point():
    """Johansson (2000), table II: 12.4, 12.7, 1.8, 1.4 cm, measured with the nominal voltages."""
    assert starts(model_of(quadruple_tank).states) == pytest.approx([12.4, 12.7, 1.8, 1.4], rel=0.1)


def test_the_reactor_has_three_equilibria_of_which_it_begins_at_the_cold_one():
    model = model_of(cstr)

    def imbalance(temperature, coolant=300.0):
        concentration = 1.0 / (1.0 + 7.2e10 * np.exp(-8750.0 / temperature))
        return cstr([concentration, temperature], [coolant])[1]

    grid = np.linspace(300.0, 450.0, 301)
    signs = np.sign([imbalance(temperature) for temperature in grid])
    brackets = [(grid[i], grid[i + 1]) for i in np.flatnonzero(np.diff(signs))]
    cold, middle, _ = (brentq(imbalance, *bracket) for bracket in brackets)
    assert cold == pytest.approx(model.states[1].start, abs=1e-6)
    assert middle == pytest.approx(350.0, abs=0.1)
    assert starts(model.inputs)[0] == pytest.approx(300.0, abs=1e-6)
    assert eigvals(linearise(model).A).real.max() < 0.0
    at_the_middle = [1.0 / (1.0 + 7.2e10 * np.exp(-8750.0 / middle)), middle]
    assert eigvals(linearise(model, at_the_middle, [300.0]).A).real.max() > 0.0
    below_hot = np.arange(300.0, 360.0, 0.1)
    assert min(imbalance(temperature, 303.22) for temperature in below_hot) < 0.0
    assert min(imbalance(temperature, 303.24) for temperature in below_hot) > 0.0  # only the hot one is left


def test_the_drive_resonates_lightly_damped_at_nine_hertz():
    poles = eigvals(linearise(model_of(two_mass_drive)).A)
    resonance = poles[poles.imag > 0][0]
    assert abs(resonance) / (2 * np.pi) == pytest.approx(9.2, abs=0.1)
    assert -resonance.real / abs(resonance) == pytest.approx(0.05, abs=0.02)


def test_the_cart_is_unstable_upright():
    poles = eigvals(linearise(model_of(cart_pendulum)).A).real
    assert sorted(np.sign(np.round(poles, 9))) == [-1.0, -1.0, 0.0, 1.0]
    # "Inverted Pendulum: System Modeling" has these elements, for g = 9.8 m/s2.
    a, b, *_ = linearise(model_of(cart_pendulum), parameters={"gravity": 9.8})
    assert a[[1, 1, 3, 3], [1, 2, 1, 2]] == pytest.approx([-0.1818, 2.6727, -0.4545, 31.1818], abs=1e-4)
    assert b[[1, 3], 0] == pytest.approx([1.8182, 4.5455], abs=1e-4)


def settled(model, u):
    """Return the outputs at the end of a long time at constant inputs, of a linear plant."""
    a, b, c, _ = linearise(model)
    change = -c @ np.linalg.solve(a, b @ (np.asarray(u) - starts(model.inputs)))
    return np.array(OUTPUTS[distillation_column](starts(model.states), u)) + change


def test_the_column_has_the_published_dead_times():
    """Step responses as those of the exact dead times, within 5 % of the gain."""
    model = model_of(distillation_column)
    a, b, c, _ = linearise(model)
    times = np.arange(0.0, 3600.0, 5.0)
    step = expm(5.0 * np.block([[a, np.eye(24)], [np.zeros((24, 48))]]))
    for flow, composition, gain, lag, delay in COLUMN:
        x, rows = np.zeros(24), []
        for _ in times:
            rows.append(c[composition] @ x)
            x = step[:24, :24] @ x + step[:24, 24:] @ b[:, flow]
        exact = gain * np.maximum(0.0, 1.0 - np.exp(-(times / 60.0 - delay) / lag))
        error = np.abs(rows - exact).max() / abs(gain)
        assert error <= min(0.05, 0.08 * delay / lag), (flow, composition)
    assert settled(model, [1.96, 1.72, 2.46]) == pytest.approx([96.227, 0.421], abs=1e-9)


def test_the_boiler_begins_at_the_published_point():
    """Bell and Astrom (1987), nominal operating point: valves at 0.34, 0.69, 0.436 and the level at zero."""
    model = model_of(boiler_turbine)
    u = starts(model.inputs)
    assert u == pytest.approx([0.34, 0.69, 0.436], abs=5e-4)
    assert level(starts(model.states), u) == pytest.approx(0.0, abs=0.01)
    poles = eigvals(linearise(model).A).real
    assert np.sort(poles) == pytest.approx([-0.1, -0.0025, 0.0], abs=1e-4)


def test_the_boiler_rests_at_the_published_levels():
    """Bell and Astrom (1987), typical operating points: of each pressure, power, density, valves, level."""
    points = (
        [86.4, 36.65, 342.4, 0.209, 0.552, 0.256, -0.65],
        [97.2, 50.52, 385.2, 0.271, 0.621, 0.340, -0.32],
        [108.0, 66.65, 428.0, 0.340, 0.690, 0.433, 0.0],
        [118.8, 85.06, 470.8, 0.418, 0.759, 0.543, 0.32],
        [129.6, 105.8, 513.6, 0.505, 0.828, 0.663, 0.64],
        [140.4, 128.9, 556.4, 0.600, 0.897, 0.793, 0.98],
    )
    for *point, published in points:
        x, u = point[:3], point[3:]
        assert boiler_turbine(x, u) == pytest.approx([0.0, 0.0, 0.0], abs=5e-3)
        assert level(x, u) == pytest.approx(published, abs=0.011)


def test_the_building_loses_heat_through_its_envelope_and_gains_the_sun():
    model = model_of(building)
    a, b, c, _ = linearise(model)
    gain = -c @ np.linalg.solve(a, b)
    assert gain[0] == pytest.approx([5.3e-3, 1.0, 6.0 * 5.3e-3])  # K/W, K/K, K/(W/m2)
    hours = -1.0 / eigvals(a).real / 3600.0
    assert max(hours) == pytest.approx(20.0, abs=1.0)


def rest_of_ph(base, acid=16.6, buffer=0.55):
    """Return the pH in the tank at rest: all flows mixed, the charges balanced."""
    flows = base + acid + buffer
    charge = (3e-3 * acid - 3e-2 * buffer - 3.05e-3 * base) / flows
    carbonate = (3e-2 * buffer + 5e-5 * base) / flows

    def unbalanced(ph):
        h, k1, k2 = 10.0**-ph, 10.0**-6.35, 10.0**-10.25
        bound = (k1 * h + 2 * k1 * k2) / (h**2 + k1 * h + k1 * k2)
        return charge + 1e-14 / h - h + carbonate * bound

    return brentq(unbalanced, 0.0, 14.0, xtol=1e-12)


def test_the_ph_begins_at_the_published_point_and_stays_the_solution_of_its_equation():
    """Henson and Seborg (1994), table I: pH 7, W_a = -0.432 and W_b = 0.528 mmol/L, level 14 cm."""
    model = model_of(ph_neutralisation)
    charge, carbonate, height, ph = starts(model.states)
    assert (charge, carbonate) == pytest.approx([-0.432, 0.528], abs=5e-3)
    assert (height, ph) == pytest.approx([14.0, 7.0], abs=0.03)
    assert ph == pytest.approx(rest_of_ph(15.6), abs=1e-9)
    moved = np.array([17.0, 16.6, 0.55])
    end = solve_ivp(
        lambda _, x: ph_neutralisation(x, moved), (0.0, 3000.0), starts(model.states), "Radau", rtol=1e-9
    ).y[:, -1]
    assert end[3] == pytest.approx(rest_of_ph(17.0), abs=1e-6)


def test_the_gain_of_the_base_varies_by_ten():
    gains = [(rest_of_ph(q + 0.01) - rest_of_ph(q - 0.01)) / 0.02 for q in np.arange(12.0, 18.6, 0.1)]
    assert max(gains) / min(gains) > 9.0
    assert min(gains) > 0.25


def test_the_servo_sticks_and_breaks_away():
    """Breakaway and sliding torque: the friction's maximum, and its least value beyond."""
    speed = np.linspace(0.0, 1.0, 100_001)
    friction = -0.05 * np.array(servo([0.0, speed], [0.0])[1])
    breakaway, sliding = friction[speed < 0.1].max(), friction[speed > 0.1].min()
    assert (breakaway, sliding) == pytest.approx((0.686, 0.567), abs=1e-3)

    def turned(torque):
        end = solve_ivp(lambda _, x: servo(x, [torque]), (0.0, 1.0), [0.0, 0.0], "Radau", rtol=1e-8).y
        return end[0, -1]

    assert turned(0.5) < 0.02
    assert turned(1.0) > 0.5


def test_an_empty_tank_stays_empty():
    """Without pumps the levels go to zero and not below what the tolerance allows."""
    model = model_of(quadruple_tank)
    result = fmpy.simulate_fmu(
        str(build_fmu(model)),
        stop_time=1000.0,
        output_interval=5.0,
        start_values={"pump_1": 0.0, "pump_2": 0.0},
        output=[state.name for state in model.states],
    )
    levels = np.column_stack([result[state.name] for state in model.states])
    assert np.abs(levels[-1]).max() <= 1e-6
    assert levels.min() >= -1e-6
