"""What is exported for Windows computes there what it does on Linux: run by wine, where that is installed."""

import os
import shutil
import struct
import subprocess
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import fmpy
import numpy as np
import pytest
from click.testing import CliRunner
from studies import PENDULUM, study_text, write

from ddpc_cosim import FloatArray
from ddpc_cosim.cli.main import main
from fmu_plants.export.compiler import cross_compiler, find_compiler
from fmu_plants.export.platforms import LINUX_X86_64, WINDOWS_X86_64, host_platform

WINE = shutil.which("wine") or shutil.which("wine64")
needs = "libraries for Windows on x86-64 are run on Linux by wine: `apt-get install wine`"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.xdist_group("wine"),
    pytest.mark.skipif(not WINE or host_platform() != LINUX_X86_64, reason=needs),
]

STEP = 0.1
STEPS = 100
ROUNDINGS = 8 * 2.0**-52
STUDY = study_text(
    name="small",
    plant=PENDULUM | {"measurements": ["angle", "angular_velocity"]},
    reference={"angle": {"kind": "steps", "times": [0.0, 1.0], "values": [10.0, -20.0], "unit": "deg"}},
    loop={"duration": 3.0},
    bounds={"torque": {"min": -3.5, "max": 3.5}},
)

Host = Callable[[Path, FloatArray], dict[str, FloatArray]]
REQUEST = struct.Struct("@128s64sd4I64I64I")
"""What the program of fmi2_host.c reads first."""


@pytest.fixture(scope="module")
def host() -> Iterator[Host]:
    """Step an FMU with the same program on both systems; return the outputs on each."""
    with TemporaryDirectory() as name:  # where wine keeps 700 MB
        folder = Path(name)
        environment = {
            **os.environ,
            "WINEPREFIX": str(folder / "wine"),
            "WINEDEBUG": "-all",
            "WINEDLLOVERRIDES": "mscoree,mshtml=",  # it would offer to install what is not needed
        }
        source = str(Path(__file__).with_name("fmi2_host.c"))
        flags = ["-O2", "-Wall", "-Wextra", "-Werror", source, "-o"]
        find_compiler().run([*flags, "host", "-ldl"], folder)
        cross_compiler(WINDOWS_X86_64).run([*flags, "host.exe", "-nostdlib", "-lkernel32"], folder)
        assert WINE is not None
        runs = {"linux64": (".so", [str(folder / "host")]), "win64": (".dll", [WINE, "host.exe"])}

        def step(fmu: Path, u: FloatArray) -> dict[str, FloatArray]:
            description = fmpy.read_model_description(str(fmu))
            inputs, outputs = (
                [
                    v.valueReference
                    for v in description.modelVariables
                    if v.causality == kind and v.type == "Real"
                ]
                for kind in ("input", "output")
            )
            assert u.shape == (STEPS, len(inputs))
            by_platform = {}
            for platform, (suffix, command) in runs.items():
                library = description.coSimulation.modelIdentifier + suffix
                with zipfile.ZipFile(fmu) as archive:
                    (folder / library).write_bytes(archive.read(f"binaries/{platform}/{library}"))
                references = (
                    reference for some in (inputs, outputs) for reference in (*some, *(64 - len(some)) * [0])
                )
                counts = STEPS, len(inputs), len(outputs), 0
                names = f"./{library}".encode(), description.guid.encode()
                request = REQUEST.pack(*names, STEP, *counts, *references) + u.tobytes()
                done = subprocess.run(
                    command, cwd=folder, env=environment, input=request, capture_output=True, check=False
                )
                assert done.returncode == 0, (platform, done)
                by_platform[platform] = np.frombuffer(done.stdout).reshape(STEPS, len(outputs))
            return by_platform

        try:
            yield step
        finally:  # what wine has started outlives its programs
            subprocess.run(["wineserver", "--kill"], env=environment, check=False)
            subprocess.run(["wineserver", "--wait"], env=environment, check=False)


def exported(folder: Path, *arguments: str) -> Path:
    """Return what a command exports for both systems."""
    out = folder / "exported.fmu"
    platforms = f"{LINUX_X86_64.name},{WINDOWS_X86_64.name}"
    result = CliRunner().invoke(main, [*arguments, "--platforms", platforms, "--out", str(out)])
    assert result.exit_code == 0, result.output
    return out


def test_a_plant_is_the_same(host: Host, tmp_path: Path) -> None:
    """But for a few roundings, which do not grow: mathematical functions are the system's."""
    u = np.random.default_rng(0).uniform(-3.0, 3.0, (STEPS, 1))
    y = host(exported(tmp_path, "export", "pendulum"), u)
    assert y["linux64"].shape[0] == STEPS
    size = np.abs(y["linux64"]).max(axis=0)
    assert (size > 0.1).all()
    assert (np.abs(y["win64"] - y["linux64"]) <= ROUNDINGS * size).all()


def test_a_controller_is_the_same_to_the_last_bit(host: Host, tmp_path: Path) -> None:
    command = ["export-controller", str(write(tmp_path, STUDY)), "--controller", "mfapc"]
    fmu = exported(tmp_path, *command)
    description = fmpy.read_model_description(str(fmu))
    inputs = [v for v in description.modelVariables if v.causality == "input"]
    u = 0.1 * np.random.default_rng(0).standard_normal((STEPS, len(inputs))).cumsum(axis=0)
    # It follows what something else applies at first, and is switched on then.
    u[:, [v.name for v in inputs].index("active")] = np.arange(STEPS) >= STEPS // 4
    y = host(fmu, u)
    assert len(np.unique(y["linux64"])) > STEPS / 2
    assert (y["win64"] == y["linux64"]).all()
