"""What stabilises the cart pendulum's angle, from 3 degrees off the upright: the FMU in the loop."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from ddpc_controllers.cascade import Cascade
from ddpc_controllers.ipid import IPID
from ddpc_controllers.mfac import MFAPC
from ddpc_controllers.spsa import SPSA
from ddpc_cosim import (
    Constant,
    Controller,
    FMUPlant,
    Outcome,
    Steps,
    Trace,
    UniformRandom,
    cosimulate,
    record,
)
from fmu_plants import build_fmu, cart_pendulum

from .loops import printed_deepc, printed_wkpc

OFF = np.radians(3.0)
# The angle follows theta'' = 31.2 theta + 4.5 F about the upright.
STABILISER = IPID(order=2, alpha=4.5, kp=36.0, kd=12.0, window=3)


@pytest.fixture(scope="module")
def plant() -> Iterator[FMUPlant]:
    """The cart pendulum, off its equilibrium."""
    model = cart_pendulum.MODEL
    tilted = replace(cart_pendulum.ANGLE, start=float(OFF))

    def off(variables: tuple[object, ...]) -> tuple[object, ...]:
        return tuple(tilted if variable is cart_pendulum.ANGLE else variable for variable in variables)

    fmu = build_fmu(replace(model, states=off(model.states), outputs=off(model.outputs)))
    with FMUPlant(fmu, inputs=["force"], outputs=["angle", "angular_velocity"]) as opened:
        yield opened


def run(plant: FMUPlant, controller: Controller, **settings: object) -> Trace:
    """Control the angle for 10 s."""
    arguments: dict[str, object] = {
        "reference": Constant(0.0),
        "bounds": {"force": (-10.0, 10.0), "angle": (-1.0, 1.0)},
        "outputs": ["angle"],
    } | settings
    return cosimulate(plant, controller, sampling_time=0.02, duration=10.0, **arguments)  # type: ignore[arg-type]


def test_without_control_it_falls(plant: FMUPlant) -> None:
    assert np.abs(run(plant, IPID(kp=0.0, alpha=1e9)).y).max() > 1.0


def test_intelligent_pid_stabilises_it(plant: FMUPlant) -> None:
    trace = run(plant, STABILISER)
    assert trace.outcome is Outcome.COMPLETED
    assert trace.failures == 0
    assert np.abs(trace.y).max() < 1.02 * OFF
    assert np.abs(trace.y[-100:]).max() < np.radians(0.01)


def test_mfapc_alone_does_not_but_behind_an_intelligent_pid_it_removes_the_offset(plant: FMUPlant) -> None:
    reference = Steps((0.0, 4.0), (0.0, float(OFF)))
    alone = run(plant, MFAPC(horizon=10, lambda_u=20.0), reference=reference)
    inner = run(plant, STABILISER, reference=reference)
    cascade = Cascade(inner=STABILISER, outer=MFAPC(horizon=10, lambda_u=20.0))
    outer = run(plant, cascade, reference=reference)
    assert np.abs(alone.y).max() > 1.0
    errors = [np.abs(trace.y[-1] - trace.reference[-1])[0] for trace in (inner, outer)]
    assert errors[0] > np.radians(0.01)
    assert errors[1] < np.radians(0.001)
    assert np.abs(outer.y).max() < 1.2 * OFF


@pytest.mark.parametrize("seed", range(4))
def test_spsa_finds_gains_that_stabilise_it(plant: FMUPlant, seed: int) -> None:
    # Below kp = 6.9 no gains do.
    start = {"kp": 6.0, "kd": 1.0, "integral_time": 5.0}
    held = run(plant, SPSA(**start, step_size=0.0, perturbation=1e-9), seed=seed)
    tuned = run(plant, SPSA(**start), seed=seed)
    assert np.abs(held.y).max() > 1.0
    assert np.abs(tuned.y).max() < 0.5
    assert np.abs(tuned.y[-100:]).max() < 0.1


PREDICTIVE = {
    "deepc": printed_deepc(
        initial_length=6,
        horizon=20,
        output_weight=1000.0,
        setpoint_weight=3000.0,
        input_weight=0.1,
        lambda_g=0.01,
        lambda_sigma=1e5,
    ),
    "wkpc": printed_wkpc(initial_length=2, horizon=20, output_weight=1000.0, input_weight=0.1, lambda_g=1e-3),
}


@pytest.mark.parametrize("method", PREDICTIVE)
def test_recorded_about_a_stabiliser_it_can_be_predicted_and_held(plant: FMUPlant, method: str) -> None:
    excitation = UniformRandom(-1.0, 1.0, samples=300, seed=1)
    trace = run(plant, PREDICTIVE[method], excitation=excitation, stabiliser=STABILISER)
    assert trace.outcome is Outcome.COMPLETED
    assert np.abs(trace.y).max() < 1.1 * OFF
    assert np.abs(trace.y[-100:]).max() < np.radians(0.1)
    assert np.abs(trace.u).max() <= 10.0


def test_recorded_in_open_loop_it_falls(plant: FMUPlant) -> None:
    excitation = UniformRandom(-1.0, 1.0, samples=300, seed=1)
    recording = record(plant, excitation, sampling_time=0.02, outputs=["angle"])
    assert np.abs(recording.y).max() > 1.0
    held = record(
        plant,
        excitation,
        sampling_time=0.02,
        outputs=["angle"],
        stabiliser=STABILISER,
        reference=Constant(0.0),
    )
    assert np.abs(held.y).max() < 2.0 * OFF
