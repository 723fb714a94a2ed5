"""A controller that is an FMU among coupled parts: it answers to what is measured when a step begins."""

from pathlib import Path

import numpy as np
import pytest
from fmus.blocks import block_files

from ddpc_cosim import Connection, CoupledPlant, FMUPlant
from fmu_plants import Variable
from fmu_plants.export import FMI_VERSIONS, export_block
from fmu_plants.export.sampled_block import SampledBlock

STEP = """
state->memory[0] += 0.3 * (r[0] - y[0]);
u[0] = state->memory[0] + r[0] - y[0] - 0.2 * y[1];
"""
SIGNALS = ("angle", "angular_velocity", "setpoint.angle")
BLOCK = SampledBlock(
    "pid",
    "A PID controller",
    0.1,
    tuple(map(Variable, SIGNALS[:2])),
    (Variable(SIGNALS[2]),),
    (Variable("torque"),),
    block_files(STEP),
)


@pytest.mark.parametrize("fmi_version", FMI_VERSIONS)
def test_the_coupled_loop_is_the_sampled_loop(fmi_version: str, pendulum_fmu: Path, tmp_path: Path) -> None:
    """Whatever algorithm and extrapolation, and with exchanges between two samples."""
    controller_fmu = export_block(BLOCK, tmp_path / "pid.fmu", fmi_version)
    with (
        FMUPlant(pendulum_fmu, inputs=["torque"], outputs=SIGNALS[:2]) as plant,
        FMUPlant(controller_fmu, inputs=SIGNALS, outputs=["torque"]) as controller,
    ):
        y, expected = plant.reset(), list[float]()
        controller.reset()
        for _ in range(40):
            y = plant.step(controller.step(np.array([*y, 0.5]), 0.1), 0.1)
            expected.append(y[0])
    for how in (
        {"algorithm": "sequential"},
        {"algorithm": "parallel"},
        {"extrapolation": "linear"},
        {"algorithm": "parallel", "extrapolation": "linear"},
        {"communication_step": 0.05},
        {"communication_step": 0.05, "extrapolation": "linear"},
    ):
        parts = {
            "plant": FMUPlant(pendulum_fmu, inputs=["torque"], outputs=SIGNALS[:2]),
            "controller": FMUPlant(controller_fmu),
        }
        connections = [Connection(f"plant.{name}", f"controller.{name}") for name in SIGNALS[:2]]
        connections += [
            Connection("controller.torque", "plant.torque"),
            Connection("r", "controller.setpoint.angle"),
            Connection("plant.angle", "angle"),
        ]
        with CoupledPlant(parts, connections, outputs=["angle"], **how) as coupled:  # type: ignore[arg-type]
            assert coupled.order[0] == "controller"
            coupled.reset()
            outputs = [coupled.step(np.array([0.5]), 0.1)[0] for _ in range(40)]
        np.testing.assert_allclose(outputs, expected, atol=1e-7, err_msg=str(how))
