"""What holds for all controllers with a model, and for the wrappers: runs repeat, nothing is shared."""

import pickle

import numpy as np
import pytest

from ddpc_controllers import LQR, MPC, PID, Delays, KoopmanMPC, OffsetFree, Scaled
from ddpc_cosim import Action, Controller, FloatArray, Loop, Recording, Sample, declared_settings

from .loops import ANGLE, close_loop, paper_reference, pendulum_loop, quick_pendulum

ALL: list[Controller] = [
    MPC(),
    LQR(),
    PID(tuning="step-test"),
    KoopmanMPC(),
    KoopmanMPC(state="delays", dictionary=Delays(samples=2)),
    Scaled(controller=KoopmanMPC()),
    OffsetFree(controller=MPC(disturbance="none")),
]
IDS = ["mpc", "lqr", "pid", "koopman", "koopman-delays", "scaled", "offset-free"]


@pytest.fixture
def loop(state_recording: Recording) -> Loop:
    """The paper's loop with a torque limit that is often reached."""
    return pendulum_loop(state_recording, torque=2.5, degrees=170.0)


def torques(controller: Controller, loop: Loop, steps: int = 120) -> FloatArray:
    """Return the torques of a closed loop."""
    return close_loop(controller, loop, quick_pendulum, ANGLE, paper_reference(), steps).u


def answer(controller: Controller, sample: Sample) -> FloatArray:
    """Return the inputs of a step."""
    given = controller.step(sample)
    return given.u if isinstance(given, Action) else given


@pytest.mark.parametrize("controller", ALL, ids=IDS)
def test_a_second_start_forgets_the_first_run_and_limits_hold(controller: Controller, loop: Loop) -> None:
    first = torques(controller, loop)
    assert np.array_equal(first, torques(controller, loop))
    assert np.abs(first).max() <= 2.5


@pytest.mark.parametrize("controller", ALL, ids=IDS)
def test_a_pickled_controller_goes_on_where_it_was(
    controller: Controller, state_recording: Recording
) -> None:
    controller.start(pendulum_loop(state_recording, torque=2.5, degrees=170.0))
    reference = np.full((controller.horizon, 1), 0.3)
    states = state_recording.measured[:8]
    samples = [Sample(k, 0.1 * k, x[:1], x, reference) for k, x in enumerate(states)]
    for sample in samples[:4]:
        answer(controller, sample)
    twin = pickle.loads(pickle.dumps(controller))
    for sample in samples[4:]:
        assert np.array_equal(answer(controller, sample), answer(twin, sample))


@pytest.mark.parametrize("controller", ALL, ids=IDS)
def test_an_answer_is_the_callers_to_keep(controller: Controller, loop: Loop) -> None:
    controller.start(loop)
    sample = Sample(0, 0.0, np.zeros(1), np.zeros(2), np.full((controller.horizon, 1), 0.3))
    first = answer(controller, sample)
    kept = first.copy()
    first[:] = 99.0
    second = answer(controller, sample._replace(k=1))
    controller.start(loop)
    assert np.array_equal(answer(controller, sample), kept)
    assert np.array_equal(answer(controller, sample._replace(k=1)), second)


@pytest.mark.parametrize("controller", ALL, ids=IDS)
def test_every_setting_says_what_it_is(controller: Controller) -> None:
    declared = declared_settings(type(controller))
    assert set(declared) == set(controller.settings())
    assert all(info.doc for info in declared.values())


@pytest.mark.parametrize("controller", [MPC(), KoopmanMPC()])
def test_a_reference_that_is_not_finite_holds_the_inputs(
    state_recording: Recording, controller: Controller
) -> None:
    controller.start(pendulum_loop(state_recording))
    y, measured = np.array([0.1]), np.array([0.1, 0.0])
    controller.step(Sample(0, 0.0, y, measured, np.full((5, 1), 0.3)))
    before = controller.step(Sample(1, 0.1, y, measured, np.full((5, 1), 0.3)))
    held = controller.step(Sample(2, 0.2, y, measured, np.full((5, 1), np.nan)))
    assert isinstance(held, Action)
    assert "not finite: inputs held" in held.status
    assert np.array_equal(held.u, before)
    assert np.abs(held.u).min() > 0.1
