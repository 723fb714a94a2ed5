"""The test vector of an exported controller, replayed through its compiled C code."""

import csv
import ctypes
import io
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from ddpc_cosim import FloatArray
from ddpc_cosim.cli.main import main

DRIVER = """
#include "controller.h"
unsigned size_of_state(void) { return sizeof(ControllerState); }
"""


def exported(study: str, controller: str, folder: Path) -> tuple[list[str], FloatArray, ctypes.CDLL]:
    """Return header and rows of the vector, and the FMU's code of the controller as a library."""
    fmu = folder / "c.fmu"
    done = CliRunner().invoke(
        main, ["export-controller", study, "--controller", controller, "--out", str(fmu)]
    )
    assert done.exit_code == 0, done.output
    with zipfile.ZipFile(fmu) as archive:
        header, *rows = csv.reader(io.StringIO(archive.read("resources/test_vector.csv").decode()))
        archive.extractall(folder)
    sources = folder / "sources"
    (sources / "driver.c").write_text(DRIVER, encoding="utf-8")
    runtime = {path.stem for path in (Path(__file__).parents[3] / "fmu_plants/runtime").glob("*.c")} | {
        "model"
    }
    files = [path.name for path in sources.glob("*.c") if path.stem not in runtime]
    compiler = ["cc", "-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC", *files, "-o", "c.so", "-lm"]
    subprocess.run(compiler, cwd=sources, check=True)
    return header, np.array(rows, dtype=float), ctypes.CDLL(str(sources / "c.so"))


def replayed(
    library: ctypes.CDLL, rows: FloatArray, y_size: int, r_size: int, u_size: int
) -> tuple[FloatArray, list[int]]:
    """Return what the code answers to the rows, as the documentation says that they are replayed."""
    state = ctypes.create_string_buffer(library.size_of_state())
    answers, fallbacks = [], []
    for row in rows:
        if row[0]:
            library.controller_start(state)
        parts = row[1 : 1 + y_size], row[1 + y_size :][:r_size], np.empty(u_size)
        y, r, u = (np.ascontiguousarray(part) for part in parts)
        status = library.controller_step(state, *(part.ctypes.data_as(ctypes.c_void_p) for part in (y, r, u)))
        answers.append(u)
        fallbacks.append(int(status != 0))
    return np.array(answers), fallbacks


@pytest.mark.parametrize(
    ("study", "controller"),
    [("paper", "deepc"), ("paper", "wkpc"), ("unstable", "deepc"), ("unstable", "mfapc"), ("mimo", "pid")],
)
def test_compiled_code_answers_each_recorded_sample_as_python_does(
    study: str, controller: str, tmp_path: Path
) -> None:
    header, rows, library = exported(study, controller, tmp_path)
    first = next(i for i, name in enumerate(header) if name.startswith("setpoint."))
    last = 1 + max(i for i, name in enumerate(header) if name.startswith(("setpoint.", "reference.")))
    sizes = first - 1, last - first, len(header) - last - 1  # of y, r and u
    assert (header[0], header[-1]) == ("start", "fallback")
    assert len(rows) == 100
    assert np.flatnonzero(rows[:, 0]).tolist() == list(range(0, 100, 10))
    expected = rows[:, last:-1]
    answers, fallbacks = replayed(library, rows, *sizes)
    size = np.ptp(expected, axis=0)
    assert (size > 0).all()
    assert (np.abs(answers - expected) <= 1e-8 * size).all()
    assert fallbacks == rows[:, -1].tolist()
