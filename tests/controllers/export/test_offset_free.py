"""The offset-free wrapper in C, also where inputs are at limits and the reference is cut off."""

from dataclasses import replace

import numpy as np
import pytest

from ddpc_controllers import LQR, Idle, OffsetFree
from ddpc_cosim import Bounds, ConfigError

from .loops import COUPLED, PENDULUM, Bench
from .test_model_based import MODELS


@pytest.mark.parametrize("bench", [PENDULUM, COUPLED], ids=["pendulum", "coupled"])
@pytest.mark.parametrize("recorded", [True, False], ids=["recorded", "no recording"])
def test_offset_free_in_c_is_offset_free(bench: Bench, recorded: bool) -> None:
    loop, _ = bench.loop()
    bounds = replace(loop.bounds, y_max=bench.nominal[: bench.outputs] * 0.8)
    inside = LQR() if recorded else LQR(model=MODELS[bench.outputs])
    run = bench.close(
        OffsetFree(controller=inside, gain=0.3, response_time=0.5),
        reach=2.0,
        bounds=bounds,
        recording=loop.recording if recorded else None,
    )
    assert run.difference < 1e-12
    assert not run.disagreements
    assert run.limited > 10


def test_directions_of_too_many_inputs_are_refused_with_the_remedy() -> None:
    loop, _ = COUPLED.loop()
    many, none = tuple(replace(loop.inputs[0], name=f"u{i}") for i in range(12)), np.full(2, np.inf)
    bounds = Bounds(np.full(12, -1.0), np.ones(12), -none, none)
    controller = OffsetFree(controller=Idle())
    loop = replace(loop, inputs=many, bounds=bounds, recording=None)
    controller.start(loop)
    with pytest.raises(
        ConfigError, match=r"OffsetFree cannot be exported for 12 inputs and 2 outputs.* Decentralised"
    ):
        controller.c_code(loop)
