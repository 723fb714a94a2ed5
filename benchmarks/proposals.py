"""`init` of small FMUs, their trial included: at most three seconds of computing time each.

What all processes have computed counts, of the program, of those that run the FMU and of those that try
controllers, however busy the machine is.
"""

import ctypes
import os
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from time import sleep

from fmu_plants import export_fmu
from fmu_plants.building import MODEL as BUILDING
from fmu_plants.cstr import MODEL as CSTR
from fmu_plants.quadruple_tank import MODEL as QUADRUPLE_TANK

SECONDS_AT_MOST = 3.0
_PR_SET_CHILD_SUBREAPER = 36


def main() -> bool:
    """Print the times and return whether they are within the bound."""
    with tempfile.TemporaryDirectory() as name:
        seconds = {}
        for model in (CSTR, BUILDING, QUADRUPLE_TANK):
            folder = Path(name) / model.name
            folder.mkdir()
            fmu = export_fmu(model, folder / f"{model.name}.fmu")
            if not seconds:
                _computing_time(fmu, "warm_up.toml")  # bytecode is written
            seconds[model.name] = _computing_time(fmu, "study.toml")
    for name, took in seconds.items():
        print(f"init {name}.fmu: {took:.2f} s of computing time (at most {SECONDS_AT_MOST:g})")
    return max(seconds.values()) <= SECONDS_AT_MOST


def _computing_time(fmu: Path, out: str) -> float:
    """Return what `init` and all processes that it starts compute [s]; Linux tells it of those it leaves."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    program = Path(sys.executable).parent / "ddpc-cosim"
    before = _computed()
    subprocess.run([program, "init", fmu.name, "--out", out], cwd=fmu.parent, check=True, capture_output=True)
    _wait_for_what_is_left()
    return _computed() - before


def _wait_for_what_is_left() -> None:
    """Wait until processes that `init` has left behind have ended, so that they count."""
    with suppress(ChildProcessError):
        while True:
            if os.waitpid(-1, os.WNOHANG)[0] == 0:
                sleep(0.01)


def _computed() -> float:
    times = os.times()
    return times.children_user + times.children_system


if __name__ == "__main__":
    sys.exit(not main())
