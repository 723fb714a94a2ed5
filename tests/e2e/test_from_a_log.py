"""The whole way of somebody with a log and no model: inspect, identify, init, run, tune, and out as C."""

import csv
import json
import tomllib
import zipfile
from pathlib import Path

import pytest

from ddpc_cosim.simulation import simulate
from tests.conftest import Run

pytestmark = pytest.mark.slow

LOG = Path(__file__).parents[2] / "docs" / "examples" / "tanks-monday.csv"
SIGNALS = ("--input", "pump A", "--input", "pump B", "--output", "level_1", "--output", "level_2")


def test_from_a_log_to_a_controller_in_c(tmp_path: Path, run_program: Run) -> None:
    (tmp_path / "log.csv").write_bytes(LOG.read_bytes())

    def done(*arguments: str) -> str:
        ended = run_program(*arguments)
        assert ended.returncode == 0, ended.stderr
        return ended.stdout

    found = json.loads(done("inspect", "log.csv", *SIGNALS, "--json"))
    assert found["good"]
    assert not found["closed_loop"]  # the pumps were switched at random

    done("identify", "log.csv", *SIGNALS, "--method", "arx", "--members", "3", "--out", "plant.fmu")
    held = simulate(tmp_path / "plant.fmu", step=5.0, stop=500.0)
    assert held.notna().all(axis=None)

    done("init", "log.csv", *SIGNALS)
    study = tomllib.loads((tmp_path / "study.toml").read_text(encoding="utf-8"))
    assert study["plant"]["identified"]["part"] == [0.5, 1.0]
    assert study["recording"]["part"] == [0.0, 0.5]  # none learns from what it is judged by
    for name in ("pump A", "pump B"):
        limits = study["bounds"][name]
        assert 2.5 <= limits["min"] < limits["max"] <= 3.5  # as far as the log went

    done("run", "study.toml", "--seeds", "0:2", "--only", "mpc", "--out", "out")
    with (tmp_path / "out" / "metrics.csv").open(encoding="utf-8", newline="") as file:
        rows = [*csv.DictReader(file)]
    assert [row["outcome"] for row in rows] == ["completed"] * 2
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "another model" in page

    done("tune", "study.toml", "--only", "mpc", "--trials", "2", "--seeds", "20", "--out", "tuned")
    done("export-controller", "study.toml", "--controller", "mpc", "--out", "mpc.fmu")
    with zipfile.ZipFile(tmp_path / "mpc.fmu") as archive:
        assert any(name.endswith(".c") for name in archive.namelist())
