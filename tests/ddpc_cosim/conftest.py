"""FMUs that misbehave on purpose, and studies in files."""

import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import pytest

from fmu_plants.export.compiler import compile_library, find_compiler

# Signals to process groups and terminals in software are matters of POSIX.
collect_ignore = ["test_interrupt.py", "test_terminal.py"] if sys.platform == "win32" else []

DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="{version}" modelName="faulty" guid="{fault}" generationTool="by hand">
  {interface}
  <ModelVariables>
    <ScalarVariable name="u" valueReference="0" causality="input">
      <Real start="0" min="-10" max="10"/>
    </ScalarVariable>
    <ScalarVariable name="y" valueReference="1" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="speed" valueReference="2" causality="output"><Real/></ScalarVariable>
    <ScalarVariable name="hidden" valueReference="1" causality="local"><Real/></ScalarVariable>
    <ScalarVariable name="gain" valueReference="3" causality="parameter" variability="tunable">
      <Real start="1" min="0" max="5"/>
    </ScalarVariable>
    <ScalarVariable name="count" valueReference="0" causality="parameter" variability="fixed">
      <Integer start="2"/>
    </ScalarVariable>
    <ScalarVariable name="on" valueReference="0" causality="parameter" variability="fixed">
      <Boolean start="true"/>
    </ScalarVariable>
  </ModelVariables>
  <ModelStructure><Outputs><Unknown index="2"/><Unknown index="3"/></Outputs></ModelStructure>
</fmiModelDescription>
"""
CO_SIMULATION = '<CoSimulation modelIdentifier="faulty" canHandleVariableCommunicationStepSize="true"/>'

MakeFMU = Callable[..., Path]


@pytest.fixture(scope="session")
def faulty_library() -> bytes:
    """The library of all faulty FMUs: the GUID that it is instantiated with says what it does wrong."""
    headers = Path(fmpy.__file__).parent / "c-code"
    files = {
        name: (headers / name).read_text(encoding="utf-8")
        for name in ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h")
    }
    source = Path(__file__).with_name("faulty_fmu.c").read_text(encoding="utf-8")
    return compile_library(find_compiler(), {**files, "faulty.c": source}, ["fmi2DoStep"])


@pytest.fixture
def make_fmu(tmp_path: Path, faulty_library: bytes) -> MakeFMU:
    """Write an FMU: an integrator, y' = gain * u, with a fault from t = 0.5 s on."""

    def make(
        fault: str = "none",
        *,
        version: str = "2.0",
        interface: str = CO_SIMULATION,
        description: str | None = None,
        library: bytes = faulty_library,
        platform: str = fmpy.platform,
    ) -> Path:
        path = tmp_path / f"{fault}.fmu"
        text = description if description is not None else DESCRIPTION
        text = text.replace("{version}", version).replace("{fault}", fault).replace("{interface}", interface)
        with zipfile.ZipFile(path, "w") as archive:
            if text:
                archive.writestr("modelDescription.xml", text)
            archive.writestr(f"binaries/{platform}/faulty{fmpy.sharedLibraryExtension}", library)
        return path

    return make


@pytest.fixture
def paper_text() -> str:
    """The built-in study as its file says it."""
    from ddpc_cosim.studies import paper

    return paper.read_text(encoding="utf-8")


WriteStudy = Callable[..., Path]


@pytest.fixture
def write_study(tmp_path: Path, make_fmu: MakeFMU) -> WriteStudy:
    """Write ``study.toml`` beside an FMU: one second of an integrator under the given controllers."""

    def write(*controllers: str, seeds: str = "[0]", duration: float = 1.0, fault: str = "none") -> Path:
        make_fmu(fault)
        sections = "".join(
            f'[controllers.{name.rpartition(":")[2].lower()}]\ntype = "{name}"\n' for name in controllers
        )
        path = tmp_path / "study.toml"
        path.write_text(
            f"""
seeds = {seeds}
[plant]
fmu = "{fault}.fmu"
outputs = ["y"]
[loop]
sampling_time = 0.1
duration = {duration}
[reference]
y = {{ kind = "constant", value = 1.0 }}
{sections}""",
            encoding="utf-8",
        )
        return path

    return write
