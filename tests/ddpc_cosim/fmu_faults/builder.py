"""FMUs that misbehave, and archives that nobody should trust, made at test time."""

import zipfile
from collections.abc import Mapping
from enum import IntEnum, auto
from pathlib import Path

import fmpy

from fmu_plants.export.compiler import compile_library, find_compiler

HERE = Path(__file__).parent
MODEL = "integrator"


class Fault(IntEnum):
    """The faults of faults.h, in its order."""

    NO_FAULT = 0
    RETURN_ERROR = auto()
    RETURN_FATAL = auto()
    RETURN_DISCARD = auto()
    DISCARD_AND_TERMINATE = auto()
    RETURN_NAN = auto()
    RETURN_INFINITY = auto()
    SEGMENTATION_FAULT = auto()
    CALL_ABORT = auto()
    CALL_EXIT = auto()
    OVERFLOW_STACK = auto()
    HANG_IN_STEP = auto()
    HANG_IN_INITIALIZATION = auto()
    HANG_IN_TERMINATE = auto()
    CRASH_IN_INITIALIZATION = auto()
    CRASH_IN_TERMINATE = auto()
    FLOOD_LOG = auto()
    FLOOD_STDOUT = auto()
    FLOOD_STDERR = auto()
    FLOOD_DESCRIPTOR = auto()
    LEAVE_A_FILE = auto()
    PRINT_AND_ABORT = auto()


DESCRIPTION_2 = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="{MODEL}" guid="{{1}}" numberOfEventIndicators="0">
  <CoSimulation modelIdentifier="{MODEL}" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <ScalarVariable name="u" valueReference="0" causality="input" variability="continuous">
      <Real start="0" min="-10" max="10"/>
    </ScalarVariable>
    <ScalarVariable name="y" valueReference="1" causality="output" variability="continuous">
      <Real min="-100" max="100"/>
    </ScalarVariable>
    <ScalarVariable name="fault" valueReference="2" causality="parameter" variability="fixed">
      <Integer start="0"/>
    </ScalarVariable>
    <ScalarVariable name="fault_time" valueReference="3" causality="parameter" variability="fixed">
      <Real start="0"/>
    </ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="2"/></Outputs>
    <InitialUnknowns><Unknown index="2"/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""

DESCRIPTION_3 = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="{MODEL}" instantiationToken="{{1}}">
  <CoSimulation modelIdentifier="{MODEL}" canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Float64 name="u" valueReference="1" causality="input" start="0" min="-10" max="10"/>
    <Float64 name="y" valueReference="2" causality="output" min="-100" max="100"/>
    <Int32 name="fault" valueReference="3" causality="parameter" variability="fixed" start="0"/>
    <Float64 name="fault_time" valueReference="4" causality="parameter" variability="fixed" start="0"/>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="2"/>
    <InitialUnknown valueReference="2"/>
  </ModelStructure>
</fmiModelDescription>
"""

_FLAVOURS = {2: (DESCRIPTION_2, fmpy.platform), 3: (DESCRIPTION_3, fmpy.platform_tuple)}


def library_name(version: int) -> str:
    """Return the path of the library in an archive."""
    return f"binaries/{_FLAVOURS[version][1]}/{MODEL}{fmpy.sharedLibraryExtension}"


def build(version: int) -> dict[str, bytes]:
    """Compile the misbehaving FMU for an FMI version; return the archive's files."""
    headers = (Path(fmpy.__file__).parent / "c-code").glob(f"fmi{version}*.h")
    sources = [HERE / name for name in ("faults.h", "faults.c", f"front{version}.c")]
    files = {path.name: path.read_text(encoding="utf-8") for path in (*headers, *sources)}
    library = compile_library(find_compiler(), files, [f"fmi{version}DoStep"], ["-D_GNU_SOURCE"])
    return {"modelDescription.xml": _FLAVOURS[version][0].encode(), library_name(version): library}


def write_archive(path: Path, files: Mapping[str, bytes]) -> Path:
    """Write files into an archive."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path
