"""Controllers on a linear model in C: the same inputs as in Python, sample by sample."""

from typing import Any

import numpy as np
import pytest

from ddpc_controllers import LQR, StateSpace

from .loops import COUPLED, PENDULUM, PIPES, TANKS, Bench

MODELS = {
    1: StateSpace(a=[[0.0, 1.0], [-9.81 / 0.2, -2.0]], b=[[0.0], [5.0]], c=[[1.0, 0.0]]),
    2: StateSpace(a=TANKS.tolist(), b=PIPES.tolist(), c=np.eye(2, 3).tolist(), sampling_time=0.1),
}
"""Of the pendulum and of the coupled plant, by the number of outputs."""
HELD, EXPECTED = 1, 2


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
