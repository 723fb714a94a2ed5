"""Defects that show in ELF files and in mount flags, and the peak of memory in the units of Linux."""

import os
import subprocess
import sys
import zipfile
from collections.abc import Callable

import pytest

from ddpc_cosim.inspection import Inspection, inspect_fmu


def test_a_library_for_another_processor_or_cut_off(pendulum_fmu, tmp_path) -> None:
    """The fields of the ELF header: e_machine at 18, 243 is RISC-V; what is cut off are its last segments."""

    def changed(change: Callable[[bytes], bytes]) -> Inspection:
        fmu = tmp_path / "changed.fmu"
        with zipfile.ZipFile(pendulum_fmu) as source, zipfile.ZipFile(fmu, "w") as target:
            for name in source.namelist():
                content = source.read(name)
                target.writestr(name, change(content) if name.startswith("binaries/") else content)
        return inspect_fmu(fmu)

    foreign = changed(lambda library: library[:18] + (243).to_bytes(2, "little") + library[20:])
    (defect,) = foreign.defects
    assert (defect.kind.name, foreign.can_run) == ("foreign-library", False)
    assert "is for RISC-V, not " in str(defect.places)
    for part in (0.001, 0.3, 0.6):
        cut_off = changed(lambda library, part=part: library[: int(part * len(library))])
        assert [cut.kind.name for cut in cut_off.defects] == ["cut-off-library"]
        assert not cut_off.can_run


def test_a_temporary_folder_that_forbids_execution(
    pendulum_fmu, tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    statvfs = os.statvfs

    class Mounted:
        f_flag = statvfs(tmp_path).f_flag | os.ST_NOEXEC

    monkeypatch.setattr(os, "statvfs", lambda path: Mounted)
    (defect,) = (inspection := inspect_fmu(pendulum_fmu)).defects
    assert (defect.kind.name, inspection.can_run) == ("no-execution", False)


MEMORY = """
import resource, sys
from pathlib import Path
from ddpc_cosim.inspection import inspect_fmu
def peak(fmu):
    inspect_fmu(Path(fmu))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(*map(peak, sys.argv[1:]))
"""


def test_a_million_variables_take_less_than_a_gigabyte(pendulum_fmu, mutate) -> None:
    """Between a small and a large FMU, the memory that is used grows by less than 1 kB per variable."""
    end = "</ModelVariables>"
    variable = (
        '<ScalarVariable name="wall[{0}].T" valueReference="{1}" causality="local" variability="continuous" '
        'initial="exact" description="Temperature {0}"><Real start="{0}" unit="K"/></ScalarVariable>'
    )
    text = "".join(variable.format(i, i + 1000) for i in range(50_000))
    many = mutate(pendulum_fmu, (end, text + end))
    process = subprocess.run(
        [sys.executable, "-c", MEMORY, pendulum_fmu, many], capture_output=True, text=True, check=True
    )
    small, large = map(int, process.stdout.split())
    assert large - small < 50_000  # kB
