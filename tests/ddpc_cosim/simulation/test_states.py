"""States in files: a run that goes on from one is the rest of a run that was not divided."""

from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from ddpc_cosim import simulate

TORQUE = pd.DataFrame({"time": [0.0, 1.0, 2.0, 3.0], "torque": [0.0, 2.0, 0.0, 1.0]})


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
def test_a_divided_run_is_the_same_to_the_last_bit(
    pendulum_fmu: Path, pendulum_fmi3: Path, tmp_path: Path, version: str, kind: Any
) -> None:
    """The steps are no binary fractions, and the inputs change at every sample."""
    fmu, state = pendulum_fmi3 if version == "3.0" else pendulum_fmu, tmp_path / "mid.state"
    how: dict[str, Any] = {"inputs": TORQUE, "step": 0.1, "fmi_type": kind}
    whole = simulate(fmu, stop=3, parameters={"angle": 0.1, "radius": 0.3}, **how)
    first = simulate(fmu, stop=0.7, parameters={"angle": 0.1, "radius": 0.3}, save_state=state, **how)
    second = simulate(fmu, stop=1.9, load_state=state, save_state=state, **how)
    third = simulate(fmu, stop=3, load_state=state, **how)
    parts = pd.concat((first, second.iloc[1:], third.iloc[1:]), ignore_index=True)
    pd.testing.assert_frame_equal(parts, whole, check_exact=True)
    pd.testing.assert_frame_equal(second.iloc[:1], first.iloc[-1:].reset_index(drop=True), check_exact=True)
