"""On a plant of two parts that do not touch, a method for two inputs and outputs is two for one each."""

import numpy as np
import pytest
from scipy.linalg import block_diag

from ddpc_controllers.data.dictionaries import Identity
from ddpc_controllers.decentralised import Decentralised, Group
from ddpc_controllers.koopman_mpc import KoopmanMPC
from ddpc_controllers.lqr import LQR
from ddpc_controllers.models.identification import Identified
from ddpc_controllers.mpc import MPC
from ddpc_controllers.offset_free import OffsetFree
from ddpc_controllers.pid import PID
from ddpc_controllers.scaling import Scaled
from ddpc_cosim import Controller, FloatArray, Recording

from .loops import LinearPlant, close_loop, experiment, make_loop

RNG = np.random.default_rng(12)
PARTS = [LinearPlant.random(RNG, 2, 1, 1) for _ in range(2)]
WHOLE = LinearPlant(*(block_diag(*(getattr(part, name) for part in PARTS)) for name in "abc"))
REFERENCE = np.repeat(RNG.uniform(-1.0, 1.0, (6, 2)), 20, axis=0)
EXCITATION = RNG.uniform(-1.0, 1.0, (120, 2))
LIMIT = 0.4

METHODS: list[Controller] = [
    MPC(),
    MPC(model=Identified(lags=2), setpoint="input-output", terminal_length=2, disturbance="input"),
    LQR(model=Identified(lags=2)),
    PID(proportional=0.3, integral=0.5, derivative=0.01, filter_time=0.1),
    PID(tuning="step-test"),
    KoopmanMPC(dictionary=Identity(), ridge=0.0),
    KoopmanMPC(dictionary=Identity(), ridge=0.0, state="delays"),
    OffsetFree(controller=MPC(disturbance="none")),
    Scaled(controller=MPC()),
]


def recorded(part: LinearPlant, excitation: FloatArray) -> Recording:
    """An experiment with a plant whose states are measured."""
    return experiment(part.advance, excitation, len(part.a), part.c)


@pytest.mark.parametrize("method", METHODS, ids=repr)
def test_two_by_two_equals_two_loops(method: Controller) -> None:
    everything = recorded(WHOLE, EXCITATION)
    loop = make_loop(everything, np.full(2, LIMIT), np.full(2, 50.0))
    together = close_loop(method, loop, WHOLE.advance, WHOLE.c, REFERENCE, 100)
    for i, part in enumerate(PARTS):
        part_loop = make_loop(recorded(part, EXCITATION[:, [i]]), np.full(1, LIMIT), np.full(1, 50.0))
        alone = close_loop(method, part_loop, part.advance, part.c, REFERENCE[:, [i]], 100)
        assert np.abs(together.u[:, [i]] - alone.u).max() < 1e-6
        assert np.abs(alone.u).max() <= LIMIT


def test_decentralised_control_is_two_loops_bit_for_bit() -> None:
    everything = recorded(WHOLE, EXCITATION)
    groups = [
        Group(
            inputs=[f"u{i}"],
            outputs=[f"y{i}"],
            measurements=[f"x{2 * i}", f"x{2 * i + 1}"],
            controller=KoopmanMPC(dictionary=Identity()),
        )
        for i in range(2)
    ]
    loop = make_loop(everything, np.full(2, LIMIT), np.full(2, 50.0))
    together = close_loop(Decentralised(groups=groups), loop, WHOLE.advance, WHOLE.c, REFERENCE, 100)
    for i, part in enumerate(PARTS):
        part_loop = make_loop(recorded(part, EXCITATION[:, [i]]), np.full(1, LIMIT), np.full(1, 50.0))
        alone = close_loop(groups[i].controller, part_loop, part.advance, part.c, REFERENCE[:, [i]], 100)
        assert np.abs(together.u[:, [i]] - alone.u).max() < 1e-12
