"""The regulariser about the equilibrium on a nonlinear plant that is unstable where it is held."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ddpc_cosim import Outcome
from ddpc_cosim.study.case_runs import run_case
from ddpc_cosim.study.cases import cases_of
from ddpc_cosim.study.reading import read_study


@pytest.mark.parametrize("seed", [0, 1])
def test_about_the_equilibrium_the_reactor_is_held_closer_than_with_the_ridge(seed: int) -> None:
    resolved = read_study("reactor").problem
    (case, *_) = cases_of(resolved, resolved.plant.built(), [seed], "deepc")

    def off(**settings: Any) -> float:
        """Return the mean error at 340 K before the last step [K]."""
        given = case.section["settings"] | {"initial_length": 4, "horizon": 10} | settings
        given |= {"artificial_setpoint": True, "terminal_equality": True, "use_current_output": False}
        trace = run_case(replace(case, preview=1, section={**case.section, "settings": given}))
        assert trace.outcome is Outcome.COMPLETED
        assert np.abs(trace.y[-1, 0] - 324.475443) < 0.5
        return float(np.abs(trace.y[150:178, 0].mean() - 340.0))

    ridge, equilibrium = (
        off(regulariser=name, lambda_g=1e-4, input_weight=1.0) for name in ("ridge", "equilibrium")
    )
    assert equilibrium < 0.5 * ridge
