"""Every installed controller keeps the contract that is asked of anyone's."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from onnx_files import write_linear_law

from ddpc_controllers import (
    MFAPC,
    NMPC,
    PID,
    SPC,
    WKPC,
    BandEdge,
    Decentralised,
    DeePC,
    FMUController,
    Group,
    OffsetFree,
    Policy,
    SafetyFilter,
    Scaled,
)
from ddpc_cosim import Controller, export_controller
from ddpc_cosim.plugins import installed
from ddpc_cosim.testing import ControllerConformance
from ddpc_cosim.testing.reference_plant import ReferencePlant
from fmu_plants.files import cache_dir

from . import plant_models

# Those that control nothing answer nothing that is asked of them: they have tests of their own.
CONTROLLERS = {
    plugin.name: plugin.value for plugin in installed("controllers") if plugin.name not in ("idle", "plant")
}


def two_loops() -> Controller:
    """Return one MFAPC for each pair of signals."""
    return Decentralised(
        groups=[Group(inputs=[f"u{i}"], outputs=[f"y{i}"], controller=MFAPC()) for i in (1, 2)]
    )


@cache
def exported() -> str:
    """Return the FMU of a PID controller for the plant that all are tried on."""
    plant, controller = ReferencePlant(1, 0.1), PID(proportional=1.0, integral=1.0)
    loop = plant.loop_for(controller, 0)
    controller.start(loop)
    return str(export_controller(controller, loop, cache_dir() / "pid.fmu"))


@cache
def proportional() -> str:
    """Return the file of a proportional law for the plant that all are tried on."""
    return str(write_linear_law(cache_dir() / "proportional.onnx", np.array([[-1.0, 1.0]])))


WRAPPERS: dict[str, Callable[[], Controller]] = {
    "band-edge": lambda: BandEdge(controller=SPC()),
    "decentralised": two_loops,
    "fmu": lambda: FMUController(file=exported()),
    "nmpc": lambda: NMPC(model=f"{plant_models.__name__}:REFERENCE", horizon=5),
    "offset-free": lambda: OffsetFree(controller=WKPC()),
    "policy": lambda: Policy(file=proportional(), horizon=0),
    "safety-filter": lambda: SafetyFilter(controller=PID(proportional=1.0, integral=1.0)),
    "scaled": lambda: Scaled(controller=DeePC()),
}


@pytest.mark.parametrize("name", CONTROLLERS)
class TestInstalledControllers(ControllerConformance):
    steps = 40

    @pytest.fixture
    def make_controller(self, name: str) -> Any:
        return WRAPPERS.get(name, CONTROLLERS[name])


@pytest.mark.parametrize("mode", ["sliding-window", "forgetting"])
@pytest.mark.parametrize("kind", [DeePC, WKPC])
class TestOnlineData(ControllerConformance):
    steps = 40

    @pytest.fixture
    def make_controller(self, kind: Any, mode: str) -> Any:
        return lambda: kind(online_data=mode, dither=0.02)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_installed_controller_survives_a_missing_measurement(name: str) -> None:
    assert WRAPPERS.get(name, CONTROLLERS[name])().accepts_missing
