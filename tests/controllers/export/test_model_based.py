"""Controllers on a linear model in C: the same inputs as in Python, sample by sample."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ddpc_controllers import LQR, MPC, StateSpace

from .loops import COUPLED, PENDULUM, PIPES, TANKS, Bench

MODELS = {
    1: StateSpace(a=[[0.0, 1.0], [-9.81 / 0.2, -2.0]], b=[[0.0], [5.0]], c=[[1.0, 0.0]]),
    2: StateSpace(a=TANKS.tolist(), b=PIPES.tolist(), c=np.eye(2, 3).tolist(), sampling_time=0.1),
}
"""Of the pendulum and of the coupled plant, by the number of outputs."""
HELD, EXPECTED, RELAXED = 1, 2, 4


@pytest.mark.parametrize(
    ("bench", "scaling", "continues"),
    [(PENDULUM, "nominal", False), (COUPLED, "nominal", True), (COUPLED, "none", False)],
)
def test_lqr_in_c_is_lqr(bench: Bench, scaling: Any, continues: bool) -> None:
    run = bench.close(LQR(scaling=scaling), reach=3.0, continues_recording=continues)
    assert run.difference < 1e-12
    assert not run.disagreements
    assert run.limited > 10
    assert run.statuses == HELD | EXPECTED


@pytest.mark.parametrize(
    ("bench", "settings", "changes"),
    [
        (PENDULUM, {}, {"preview": 2}),
        (PENDULUM, {"model": MODELS[1], "disturbance": "input", "setpoint": "none"}, {"recording": None}),
        (COUPLED, {"terminal_length": 2, "change_weight": 0.3}, {"continues_recording": True}),
        (COUPLED, {"rate_bounds": (0.5, 0.8), "scaling": "range", "disturbance": "none"}, {"preview": 0}),
        (COUPLED, {"model": MODELS[2], "soft_output_bounds": 1e3, "setpoint": "input-output"}, {}),
    ],
    ids=["preview", "given model", "terminal", "rates", "soft bounds"],
)
def test_mpc_in_c_is_mpc(bench: Bench, settings: dict[str, Any], changes: dict[str, Any]) -> None:
    loop, _ = bench.loop()
    bounds = replace(loop.bounds, y_max=bench.nominal[: bench.outputs] * 1.2)
    run = bench.close(MPC(horizon=8, **settings), reach=2.0, bounds=bounds, **changes)
    assert run.difference < 1e-10
    assert not run.disagreements
    assert run.limited > 10 or "rate_bounds" in settings
    assert run.active > 1
    assert run.statuses & ~RELAXED == HELD | EXPECTED
