"""The pendulum FMU against other solutions of equation (22)."""

from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import fmi2OK
from hypothesis import HealthCheck, given, settings, strategies as st
from scipy.integrate import solve_ivp

SAMPLING_TIME = 0.1
NOMINAL = {"mass": 1.0, "radius": 0.2, "damping": 0.4, "torque_gain": 1.0, "gravity": 9.81}
STATES = ["angle", "angular_velocity"]
DATA = Path(__file__).parents[2] / "data"


def exact_step(state, torque, duration=SAMPLING_TIME, **changed):
    """Solve (22) with the torque held, to nearly the last digit."""
    p = NOMINAL | changed

    def slope(_, x):
        inertia = p["mass"] * p["radius"]
        return [
            x[1],
            -p["gravity"] / p["radius"] * np.sin(x[0])
            - p["damping"] / inertia * x[1]
            + p["torque_gain"] * torque / inertia,
        ]

    solution = solve_ivp(slope, (0.0, duration), state, method="DOP853", rtol=1e-12, atol=1e-14)
    return solution.y[:, -1]


def exact_run(torques, state=(0.0, 0.0), **changed):
    rows = []
    for torque in torques:
        state = exact_step(state, torque, **changed)
        rows.append(state)
    return np.array(rows)


def test_follows_the_exact_solution_over_40_s_of_random_torque(pendulum):
    torques = np.random.default_rng(1).uniform(-3.5, 3.5, 400)
    simulated = pendulum().start().run(torques[:, None], ["torque"])
    assert np.abs(simulated - exact_run(torques))[:, 0].max() <= 1e-8


def test_is_as_accurate_through_fmpy(pendulum_fmu):
    torques = np.random.default_rng(2).uniform(-3.5, 3.5, 400)
    times = SAMPLING_TIME * np.arange(400)
    held = np.zeros(800, [("time", "f8"), ("torque", "f8")])  # a doubled instant is a jump to FMPy
    held["time"] = np.repeat(np.append(times, 40.0), 2)[1:-1]
    held["torque"] = np.repeat(torques, 2)
    result = fmpy.simulate_fmu(
        str(pendulum_fmu), stop_time=40.0, output_interval=SAMPLING_TIME, input=held, output=STATES
    )
    assert np.abs(result["angle"][1:] - exact_run(torques)[:, 0]).max() <= 1e-8


def test_repeats_the_recorded_open_loop_experiment(pendulum):
    recorded = np.genfromtxt(DATA / "excitation_seed5489.csv", delimiter=",", names=True)
    simulated = pendulum().start().run(recorded["torque"][:-1, None], ["torque"])
    # The recording was made by a Runge-Kutta method at a relative tolerance of 1e-10.
    assert np.abs(simulated[:, 0] - recorded["angle_rad"][1:]).max() <= 1e-8


def test_starts_from_the_states_it_was_given(pendulum):
    instance = pendulum().start({"angle": 1.0, "angular_velocity": -2.0, "torque": 0.5})
    assert instance.get(*STATES) == pytest.approx([1.0, -2.0], abs=0)
    assert instance.step(0.0, 1.0) == fmi2OK
    assert instance.get(*STATES) == pytest.approx(exact_step([1.0, -2.0], 0.5, 1.0), abs=1e-8)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    angle=st.floats(-3.0, 3.0),
    velocity=st.floats(-10.0, 10.0),
    torque=st.floats(-3.5, 3.5),
    parts=st.lists(st.floats(0.01, 1.0), min_size=1, max_size=12),
)
def test_where_a_span_is_divided_does_not_matter(pendulum, angle, velocity, torque, parts):
    """Ten steps of 0.01 s, or any other division, end where one step of 0.1 s ends."""
    ends = SAMPLING_TIME * np.cumsum(parts) / np.sum(parts)
    instance = pendulum().start({"angle": angle, "angular_velocity": velocity, "torque": torque})
    for start, end in zip([0.0, *ends[:-1]], ends, strict=True):
        assert instance.step(start, end - start) == fmi2OK
    assert instance.get(*STATES) == pytest.approx(exact_step([angle, velocity], torque), abs=1e-8)


def test_huge_and_tiny_communication_steps(pendulum):
    instance = pendulum().start({"torque": 1.0})
    assert instance.step(0.0, 1e-12) == fmi2OK
    assert instance.get("angular_velocity")[0] == pytest.approx(5.0 * 1e-12, rel=1e-9)
    assert instance.step(1e-12, 1e4) == fmi2OK
    rest = np.arcsin(1.0 / 9.81)  # where gravity balances the torque: sin(angle) = torque / (m g)
    assert instance.get(*STATES) == pytest.approx([rest, 0.0], abs=1e-8)


def test_steps_far_from_time_zero_are_as_accurate(pendulum):
    instance = pendulum().start({"angle": 1.0}, start=1e9)
    assert instance.step(1e9, 0.1) == fmi2OK
    assert instance.get(*STATES) == pytest.approx(exact_step([1.0, 0.0], 0.0), abs=1e-9)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-7, 1e-12])
def test_error_is_what_the_experiment_asks_for(pendulum, tolerance):
    instance = pendulum().start({"angle": 2.0}, tolerance=tolerance)
    assert instance.step(0.0, 1.0) == fmi2OK
    error = np.abs(instance.get(*STATES) - exact_step([2.0, 0.0], 0.0, 1.0)).max()
    assert error <= 100 * tolerance
    assert error > 0.001 * tolerance  # and no more work is done than that


def test_a_tunable_parameter_counts_from_the_next_step_on(pendulum):
    torques = np.random.default_rng(3).uniform(-3.5, 3.5, 20)
    instance = pendulum().start()
    before = instance.run(torques[:10, None], ["torque"])
    changed = {"torque_gain": -1.0, "mass": 1.3, "radius": 0.25, "damping": 0.2}
    assert instance.set(changed) == fmi2OK
    after = instance.run(torques[10:, None], ["torque"], first=10)
    exact_before = exact_run(torques[:10])
    exact_after = exact_run(torques[10:], exact_before[-1], **changed)
    assert np.abs(np.vstack([before, after]) - np.vstack([exact_before, exact_after])).max() <= 1e-7


def test_derivatives_can_be_read(pendulum):
    instance = pendulum().start({"angle": 0.3, "angular_velocity": 2.0, "torque": 1.0})
    slope = -9.81 / 0.2 * np.sin(0.3) - 0.4 / 0.2 * 2.0 + 1.0 / 0.2
    assert instance.get("der(angle)", "der(angular_velocity)") == pytest.approx([2.0, slope], rel=1e-14)
