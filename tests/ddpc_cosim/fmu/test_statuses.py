"""A status that the standard does not know is a failure, wherever a call returns it, also a negative one."""

from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from fmus.builder import Fault, model_fmu

from ddpc_cosim import CosimWarning, FMUPlant, FMUStepError
from ddpc_cosim.errors import StepStatus
from ddpc_cosim.fmu.status import SUCCESS, status_word
from ddpc_cosim.simulation import simulate

H = 0.1
VERSIONS = ("1.0", "2.0", "3.0")
Kind = Literal["co-simulation", "model-exchange"]
KINDS: tuple[Kind, ...] = ("co-simulation", "model-exchange")
FROM_HALF_A_SECOND_ON = {
    (Fault.MINUS_ONE_IN_STEP, "co-simulation"): "DoStep",
    (Fault.MINUS_ONE_IN_STEP, "model-exchange"): r"Get\w*Derivatives",
    **{(Fault.MINUS_ONE_WHEN_READ, kind): r"Get(Real|Float64)" for kind in KINDS},
    **{(Fault.MINUS_ONE_WHEN_SET, kind): r"Set(Real|Float64)" for kind in KINDS},
}


def run_for_a_second(plant: FMUPlant) -> None:
    """With an input that is another one at every sample."""
    plant.reset()
    for k in range(10):
        plant.step(np.array([float(k)]), H)


def lag(folder: Path, version: str, kind: Kind, fault: Fault) -> Path:
    settings = {} if version != "1.0" else {"interfaces": "CoSimulation" if kind == "co-simulation" else ""}
    return model_fmu(folder, version, "lag", fault, **settings)


def test_two_statuses_are_a_success_and_five_have_names() -> None:
    assert {status for status in range(-300, 300) if status in SUCCESS} == {0, 1}
    words = [status_word(status) for status in (2, 3, 4, 5, -1, 6)]
    assert words == ["discard", "error", "fatal", "pending", "illegal status -1", "illegal status 6"]


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(("fault", "kind"), FROM_HALF_A_SECOND_ON)
@pytest.mark.parametrize("isolated", [False, True], ids=["in-process", "isolated"])
def test_minus_one_during_a_run(
    tmp_path: Path, version: str, fault: Fault, kind: Kind, isolated: bool
) -> None:
    fmu = lag(tmp_path, version, kind, fault)
    with FMUPlant(fmu, outputs=["x"], fmi_type=kind, isolated=isolated) as plant:
        words = f"fmi[123]?{FROM_HALF_A_SECOND_ON[fault, kind]} returned illegal status -1 at t = "
        with pytest.raises(FMUStepError, match=words) as error:
            run_for_a_second(plant)
    assert error.value.status is StepStatus.ERROR
    assert error.value.time == pytest.approx(0.5, abs=H + 1e-9)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_minus_one_in_the_initialisation(tmp_path: Path, version: str, kind: Kind) -> None:
    fmu = lag(tmp_path, version, kind, Fault.MINUS_ONE_IN_INITIALIZATION)
    with (
        FMUPlant(fmu, outputs=["x"], fmi_type=kind) as plant,
        pytest.raises(FMUStepError, match=r"Initializ\w+ returned illegal status -1 at t = 0 s"),
    ):
        plant.reset()


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("kind", KINDS)
def test_minus_one_in_open_loop(tmp_path: Path, version: str, kind: Kind) -> None:
    fmu = lag(tmp_path, version, kind, Fault.MINUS_ONE_IN_STEP)
    with pytest.warns(CosimWarning, match="returned illegal status -1"):
        frame = simulate(fmu, stop=1.0, step=H, outputs=["x"], fmi_type=kind)
    assert frame.attrs["outcome"] == "fmu-error"
    assert len(frame) < 11
