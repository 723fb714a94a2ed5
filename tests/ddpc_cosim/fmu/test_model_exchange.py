"""Model Exchange behind the plant contract: states, and events of every kind, in three FMI versions."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmus.builder import Fault, model_fmu
from scipy.integrate import solve_ivp

from ddpc_cosim.errors import FMUStepError, StepStatus
from ddpc_cosim.fmu import integrators
from ddpc_cosim.fmu.fmi2 import Fmi2Model
from ddpc_cosim.fmu.plant import FMUPlant

VERSIONS = ("1.0", "2.0", "3.0")


@pytest.fixture(params=["cvode", "scipy"])
def integrator(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Run with CVode, and as on a platform for which FMPy ships none."""
    if request.param == "scipy":
        monkeypatch.setattr(integrators, "has_cvode", lambda: False)
    return str(request.param)


def session(
    folder: Path,
    version: str,
    model: str,
    outputs: list[str],
    tolerance: float = 1e-9,
    fault: Fault = Fault.NO_FAULT,
) -> FMUPlant:
    # FMI 2.0 wants to be told of integrator steps by default, FMI 3.0 does not.
    wants_steps = ' needsCompletedIntegratorStep="true"' if version == "3.0" else ""
    interfaces = f'<ModelExchange modelIdentifier="models"{wants_steps}/>'
    path = model_fmu(folder, version, model, fault, interfaces=interfaces)
    return FMUPlant(path, outputs=outputs, tolerance=tolerance)


def bounce_times(height: float, gravity: float, restitution: float, count: int) -> list[float]:
    """Return when a ball dropped from a height hits the ground."""
    times = [np.sqrt(2 * height / gravity)]
    speed = gravity * times[0]
    for _ in range(count - 1):
        speed *= restitution
        times.append(times[-1] + 2 * speed / gravity)
    return times


def height_of_ball(t: float, gravity: float = 9.81, restitution: float = 0.7) -> float:
    """Return the height of a ball dropped from 1 m."""
    last, speed = 0.0, 0.0
    hits = bounce_times(1.0, gravity, restitution, 30)
    if t < hits[0]:
        return 1.0 - 0.5 * gravity * t**2
    for i, hit in enumerate(hits):
        if hit <= t:
            last, speed = hit, gravity * hits[0] * restitution ** (i + 1)
    return speed * (t - last) - 0.5 * gravity * (t - last) ** 2


@pytest.mark.parametrize("version", VERSIONS)
def test_held_inputs_jump_at_samples(tmp_path: Path, version: str, integrator: str) -> None:
    inputs = np.random.default_rng(0).uniform(-1, 1, 30)
    lag = session(tmp_path, version, "lag", ["x"])
    lag.reset({"rate": 3.0})
    x = 0.0
    for u in inputs:
        x = u + (x - u) * np.exp(-3.0 * 0.1)
        assert lag.step(np.array([u]), 0.1) == pytest.approx([x], abs=1e-6 if integrator == "scipy" else 1e-7)
    lag.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_state_events_are_located(tmp_path: Path, version: str, integrator: str) -> None:
    ball = session(tmp_path, version, "ball", ["h", "bounces"])
    h, bounces = ball.reset()
    assert (h, bounces) == (1.0, 0.0)
    for k in range(1, 21):
        h, bounces = ball.step(np.array([0.0]), 0.1)
        assert h == pytest.approx(height_of_ball(0.1 * k), abs=1e-5)
        assert bounces == sum(hit <= 0.1 * k for hit in bounce_times(1.0, 9.81, 0.7, 30))
    ball.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_time_events_happen_on_time(tmp_path: Path, version: str) -> None:
    """Without any state; an event at a sample is handled before the outputs are read, the last one too."""
    stair = session(tmp_path, version, "stair", ["count"])
    assert stair.reset() == [0.0]
    counts = [float(stair.step(np.array([0.0]), 0.25)[0]) for _ in range(40)]
    assert counts == [(k + 1) // 4 for k in range(40)]
    for call in (lambda: stair.step(np.array([0.0]), 0.25), lambda: stair.set_parameters({})):
        with pytest.raises(FMUStepError, match="asks to terminate") as caught:
            call()
        assert caught.value.status is StepStatus.TERMINATED
        assert caught.value.time == stair.time == 10.0
    stair.close()


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("at", ["an event", "a completed integrator step"])
def test_a_model_that_ends_the_run(tmp_path: Path, version: str, at: str, integrator: str) -> None:
    """From t = 0.5 s on, at the next event or, but in FMI 1.0, after the next integrator step."""
    lag = session(tmp_path, version, "lag", ["x"], fault=Fault.ASK_TO_TERMINATE)
    lag.reset()
    for k in range(5):
        lag.step(np.array([float(k if at == "an event" else 1.0)]), 0.1)
    u = np.array([9.0 if at == "an event" else 1.0])
    if version[0] == "1" and at != "an event":
        lag.step(u, 0.1)
        return
    words = rf"{at} ended the simulation at t = 0\.5\d* s; the FMU asks to"
    with pytest.raises(FMUStepError, match=words) as caught:
        lag.step(u, 0.1)
    assert caught.value.status is StepStatus.TERMINATED
    assert caught.value.time == 0.5 if at == "an event" else 0.5 < caught.value.time < 0.6
    lag.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_step_events_are_asked_for_after_integrator_steps(
    tmp_path: Path, version: str, integrator: str
) -> None:
    """The relay takes 1 from its state after any integrator step that has passed 1."""
    relay = session(tmp_path, version, "relay", ["x", "count"])
    relay.reset()
    x = count = 0.0
    for k in range(1, 41):
        x, count = relay.step(np.array([0.0]), 0.1)
        assert x + count == pytest.approx(0.1 * k, abs=1e-6)
    assert count >= 2
    relay.close()


def test_an_interrupt_while_it_is_integrated_is_not_lost(
    tmp_path: Path, integrator: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exceptions do not cross C: CVode is told to give up, and what was raised is raised then."""

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    lag = session(tmp_path, "2.0", "lag", ["x"])
    lag.reset()
    monkeypatch.setattr(Fmi2Model, "get_derivatives", interrupted)
    with pytest.raises(KeyboardInterrupt):
        lag.step(np.ones(1), 0.1)
    lag.close()


def test_an_exported_plant_follows_its_equations(pendulum_fmu: Path, integrator: str) -> None:
    torques = np.random.default_rng(7).uniform(-3.5, 3.5, 40)
    plant = FMUPlant(pendulum_fmu, fmi_type="model-exchange", tolerance=1e-9)
    rows = [plant.reset({"mass": 1.5}), *(plant.step(np.array([torque]), 0.1) for torque in torques)]
    plant.close()
    x = np.zeros(2)
    for torque, row in zip(torques, rows[1:], strict=True):

        def slope(_: float, x: np.ndarray, torque: float = torque) -> list[float]:
            return [x[1], -9.81 / 0.2 * np.sin(x[0]) - 0.4 / (1.5 * 0.2) * x[1] + torque / (1.5 * 0.2)]

        x = solve_ivp(slope, (0.0, 0.1), x, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        assert row == pytest.approx(x, abs=2e-5)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_fmpy_gets_the_same_trajectory(exported: Callable[[str], Path], version: str) -> None:
    path = exported(version)
    plant = FMUPlant(path, fmi_type="model-exchange", tolerance=1e-9)
    plant.reset()
    rows = [plant.step(np.array([3.0]), 0.1) for _ in range(30)]
    plant.close()
    result = fmpy.simulate_fmu(
        str(path),
        fmi_type="ModelExchange",
        start_values={"torque": 3.0},
        output=["angle"],
        stop_time=3.0,
        output_interval=0.1,
        relative_tolerance=1e-9,
    )
    assert np.array(rows)[:, 0] == pytest.approx(result["angle"][1:], abs=1e-6)


def test_a_failing_evaluation_ends_the_step_with_its_reason(tmp_path: Path, integrator: str) -> None:
    lag = session(tmp_path, "2.0", "lag", ["x"])
    lag.reset()
    lag.step(np.array([1.0]), 0.1)
    with pytest.raises(FMUStepError, match=r"lag2.fmu: fmi2GetDerivatives returned error at t = 0.1 s"):
        lag.step(np.array([99.0]), 0.1)
    lag.close()


def test_tunable_parameters_and_free_inputs_change_between_samples(tmp_path: Path) -> None:
    path = model_fmu(tmp_path, "2.0", "lag", interfaces='<ModelExchange modelIdentifier="models"/>')
    lag = FMUPlant(path, inputs=[], outputs=["x"], tolerance=1e-9)
    lag.reset({"u": 1.0, "x": 0.5})
    nothing = np.empty(0)
    assert lag.step(nothing, 1.0) == pytest.approx([1 - 0.5 * np.exp(-1.0)], abs=1e-7)
    lag.set_parameters({"rate": 2.0, "u": 0.0})
    x = 1 - 0.5 * np.exp(-1.0)
    assert lag.step(nothing, 1.0) == pytest.approx([x * np.exp(-2.0)], abs=1e-7)
    lag.close()


def test_a_state_brings_back_time_inputs_and_events(pendulum_fmu: Path) -> None:
    plant = FMUPlant(pendulum_fmu, fmi_type="model-exchange", tolerance=1e-8)
    plant.reset()
    plant.step(np.array([1.0]), 0.1)
    state = plant.save_state()
    onwards = [plant.step(np.array([u]), 0.1) for u in (2.0, -1.0)]
    plant.restore_state(state)
    assert plant.time == 0.1
    again = [plant.step(np.array([u]), 0.1) for u in (2.0, -1.0)]
    plant.close()
    assert np.array(again) == pytest.approx(np.array(onwards), abs=1e-9)


def test_platforms_without_cvode_are_told_by_what_fmpy_ships() -> None:
    code = """
import sys
sys.modules["fmpy.sundials"] = None
from ddpc_cosim.fmu.integrators import has_cvode
print(has_cvode())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
