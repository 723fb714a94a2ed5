"""Every FMI call in a file: what was given, what came back, and the last one before a crash."""

import math
import re
from pathlib import Path

import pytest
from fmus.builder import Fault, model_fmu

from ddpc_cosim import ConfigError, FMUPlant, FMUStepError
from ddpc_cosim.plant import FMIType


@pytest.mark.parametrize(
    ("version", "prefix", "vr"),
    [("1.0", "fmi", "vr"), ("2.0", "fmi2", "vr"), ("3.0", "fmi3", "valueReferences")],
)
def test_calls_of_a_step_have_arguments_status_and_results(
    tmp_path: Path, version: str, prefix: str, vr: str
) -> None:
    file = tmp_path / "calls.txt"
    with FMUPlant(model_fmu(tmp_path, version, "lag"), outputs=["x"], trace_calls=file) as plant:
        plant.reset({"rate": 2.0})
        y = plant.step([1.5], 0.25)
    lines = file.read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith(f"{prefix}Instantiate")
    written, stepped, read = lines[-5:-2]
    assert re.match(rf"{prefix}Set(Real|Float64)\(\w+=0x[0-9a-f]+, {vr}=\[0\], .*\[1.5\].*\) -> ok$", written)
    assert re.match(rf"{prefix}DoStep\(.*=0.0, communicationStepSize=0.25, .*\) -> ok", stepped)
    assert re.match(rf"{prefix}Get(Real|Float64)\(.*\) -> ok; values?=\[{float(y[0])!r}\]$", read)
    assert "Free" in lines[-1]
    assert any("[2.0]" in line and "Set" in line for line in lines)


def test_vectors_of_model_exchange_are_told_by_their_values(tmp_path: Path) -> None:
    file = tmp_path / "calls.txt"
    path = model_fmu(tmp_path, "2.0", "lag")
    with FMUPlant(path, outputs=["x"], fmi_type="model-exchange", trace_calls=file) as plant:
        plant.reset({"x": 0.5})
        plant.step([1.0], 0.1)
    text = file.read_text(encoding="utf-8")
    assert re.search(r"fmi2GetContinuousStates\(c=\w+, nx=1\) -> ok; x=\[0.5\]\n", text)
    assert re.search(r"fmi2GetDerivatives\(c=\w+, nx=1\) -> ok; derivatives=\[0.5\]\n", text)
    assert re.search(r"fmi2NewDiscreteStates\(c=\w+\) -> ok; eventInfo={newDiscreteStatesNeeded=0, ", text)


def test_the_call_that_crashes_is_the_last_one(tmp_path: Path) -> None:
    file = tmp_path / "calls.txt"
    path = model_fmu(tmp_path, "2.0", "lag", Fault.SEGMENTATION_FAULT)
    with FMUPlant(path, outputs=["x"], isolated=True, trace_calls=file) as plant:
        plant.reset()
        plant.step([1.0], 0.5)
        with pytest.raises(FMUStepError, match="SIGSEGV"):
            plant.step([1.0], 0.1)
    last = file.read_text(encoding="utf-8").splitlines()[-1]
    assert re.match(r"fmi2DoStep\(.*currentCommunicationPoint=0\.5,.*\)$", last), "begun and not ended"


def test_a_status_that_is_not_ok_is_told_in_words(tmp_path: Path) -> None:
    file = tmp_path / "calls.txt"
    path = model_fmu(tmp_path, "2.0", "lag", Fault.RETURN_ERROR)
    with FMUPlant(path, outputs=["x"], trace_calls=file) as plant:
        plant.reset()
        plant.step([1.0], 0.5)
        with pytest.raises(FMUStepError):
            plant.step([1.0], 0.1)
    assert re.search(r"fmi2DoStep\(.*\) -> error\n", file.read_text(encoding="utf-8"))


@pytest.mark.parametrize("fmi_type", ["co-simulation", "model-exchange"])
@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize(
    ("declared", "given", "expected"),
    [("0.0003", None, 3e-4), ("0.0003", 2e-7, 2e-7), (None, None, None), ("0", None, None)],
)
def test_an_fmu_is_told_the_tolerance_that_it_declares_unless_another_is_given(
    tmp_path: Path,
    version: str,
    fmi_type: FMIType,
    declared: str | None,
    given: float | None,
    expected: float | None,
) -> None:
    file, head = tmp_path / "calls.txt", f'<DefaultExperiment tolerance="{declared}"/>' if declared else ""
    path = model_fmu(tmp_path, version, "lag", head=head)
    with FMUPlant(path, outputs=["x"], fmi_type=fmi_type, tolerance=given, trace_calls=file) as plant:
        plant.reset()
        assert plant.provenance().get("fmu_tolerance") == (repr(expected) if expected else None)
    calls = re.findall(r"toleranceDefined=(\w+), tolerance=([\d.e-]+)", file.read_text(encoding="utf-8"))
    assert [(defined in ("1", "True"), float(value)) for defined, value in calls] == [
        (expected is not None, expected or 0.0)
    ]
    with pytest.raises(ConfigError, match=r"tolerance = nan is not possible; allowed: a finite number > 0"):
        FMUPlant(path, tolerance=math.nan)
