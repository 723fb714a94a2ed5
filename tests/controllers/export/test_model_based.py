"""Controllers on a linear model in C: the same inputs as in Python, sample by sample."""

from typing import Any

import pytest

from ddpc_controllers import LQR

from .loops import COUPLED, PENDULUM, Bench


@pytest.mark.parametrize("continues", [False, True], ids=["from rest", "continues"])
@pytest.mark.parametrize("scaling", ["nominal", "none"])
@pytest.mark.parametrize("bench", [PENDULUM, COUPLED], ids=["pendulum", "coupled"])
def test_lqr_in_c_is_lqr(bench: Bench, scaling: Any, continues: bool) -> None:
    beside = bench.close(LQR(scaling=scaling), reach=3.0, continues_recording=continues)
    assert beside.difference < 1e-12
    assert not beside.disagreements
    assert beside.fallbacks >= 4
