"""`inspect` on large FMUs: under a second for 6 000 variables, and linear in their number."""

import tempfile
import zipfile
from pathlib import Path
from time import perf_counter

from ddpc_cosim.inspection import inspect_fmu

VARIABLES = (1_500, 3_000, 6_000)
SECONDS_AT_MOST = 1.0
# Twice the variables in twice the time, and half as much again for a machine with other work to do.
RATIO_AT_MOST = 3.0
RUNS = 5


def main() -> bool:
    """Print the times and return whether they are within the bounds."""
    with tempfile.TemporaryDirectory() as folder:
        fmus = [large_fmu(Path(folder), count) for count in VARIABLES]
        inspect_fmu(fmus[0])  # imports
        times = [min(_time(fmu) for _ in range(RUNS)) for fmu in fmus]
    for count, seconds in zip(VARIABLES, times, strict=True):
        print(f"{count:6d} variables: {1e3 * seconds:7.1f} ms")
    ratio = times[-1] / times[-2]
    print(f"twice the variables take {ratio:.2f} times as long (at most {RATIO_AT_MOST})")
    return times[-1] <= SECONDS_AT_MOST and ratio <= RATIO_AT_MOST


def _time(fmu: Path) -> float:
    started = perf_counter()
    inspect_fmu(fmu)
    return perf_counter() - started


def large_fmu(folder: Path, count: int) -> Path:
    """Write an FMU for FMI 2.0 with structured names and many dependencies, without a binary."""
    path = folder / f"large_{count}.fmu"
    variables = "\n".join(_variable(i, count) for i in range(count))
    outputs = "\n".join(
        f'<Unknown index="{i + 1}" dependencies="{max(i - 3, 1)} {max(i - 2, 1)}"/>'
        for i in range(count)
        if i % 4 == 1
    )
    text = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="large" guid="0" variableNamingConvention="structured">
<CoSimulation modelIdentifier="large"/>
<UnitDefinitions>
<Unit name="K"><BaseUnit K="1"/><DisplayUnit name="degC" offset="-273.15"/></Unit>
</UnitDefinitions>
<ModelVariables>{variables}</ModelVariables>
<ModelStructure><Outputs>{outputs}</Outputs></ModelStructure>
</fmiModelDescription>"""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", text)
    return path


def _variable(i: int, count: int) -> str:
    causality = ("input", "output", "parameter", "local")[i % 4]
    variability = 'variability="fixed" ' if causality == "parameter" else ""
    start = 'start="300"' if causality in ("input", "parameter") else ""
    return (
        f'<ScalarVariable name="plant.zone[{i // 100}].wall[{i % 100}].T" valueReference="{i}" '
        f'causality="{causality}" {variability}description="Temperature {i} of {count}">'
        f'<Real unit="K" displayUnit="degC" min="200" max="400" nominal="300" {start}/></ScalarVariable>'
    )
