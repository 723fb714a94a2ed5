"""FMUs that misbehave in the step test: what was seen before is used, and the reason is told."""

import zipfile
from pathlib import Path

import fmpy
import pytest

from ddpc_cosim.suggestion import suggest_study, write_study
from fmu_plants.export.compiler import compile_library, find_compiler

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="fragile" guid="{fault}">
  <CoSimulation modelIdentifier="fragile" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="0" causality="input"><Real start="0" min="-10" max="10"/>
    </ScalarVariable>
    <ScalarVariable name="y" valueReference="1" causality="output"><Real/></ScalarVariable>
  </ModelVariables>
  <ModelStructure><Outputs><Unknown index="2"/></Outputs></ModelStructure>
</fmiModelDescription>
"""


@pytest.fixture(scope="module")
def library() -> bytes:
    headers = Path(fmpy.__file__).parent / "c-code"
    names = ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
    files = {name: (headers / name).read_text(encoding="utf-8") for name in names}
    files["fragile.c"] = Path(__file__).with_name("fragile_fmu.c").read_text(encoding="utf-8")
    return compile_library(find_compiler(), files, ["fmi2DoStep"])


@pytest.mark.filterwarnings(
    "ignore::ddpc_cosim.CosimWarning"
)  # functions that a run does not need are missing
@pytest.mark.parametrize(("fault", "word"), [("abort", "SIGABRT"), ("hang", "0.5 s")])
def test_a_crash_or_a_hang_is_told_in_the_study(fault, word, library, tmp_path) -> None:
    """The FMU, y' = u, works until t = 0.5 s; this process survives it."""
    fmu = tmp_path / "fragile.fmu"
    with zipfile.ZipFile(fmu, "w") as archive:
        archive.writestr("modelDescription.xml", DESCRIPTION.replace("{fault}", fault))
        archive.writestr(f"binaries/{fmpy.platform}/fragile{fmpy.sharedLibraryExtension}", library)
    path = write_study(suggest_study(fmu, step_timeout=0.5), fmu, tmp_path / "study.toml")
    text = path.read_text(encoding="utf-8").replace("\n# ", " ")
    assert "y goes on changing by +1 per second (it integrates)" in text
    assert "A run of the step test ended early: fragile.fmu" in text
    assert word in text
