"""The condition of the docs: said in a file and in Python, applied in workers, told in the report."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ddpc_cosim import CosimWarning, load_results

PAGE = (Path(__file__).parents[2] / "docs" / "extend" / "write-a-condition.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"^```\w+ (\S+)\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL))
MODULE = FILES["ddpc_dead_band.py"]
ENTRY_POINTS = tomllib.loads(FILES["pyproject.toml"])["project"]["entry-points"]
LOOP = """
from dataclasses import dataclass
import numpy as np
from ddpc_cosim import Controller, Plant, Variable, setting

class Lag(Plant):
    inputs, outputs = (Variable("u", unit="V"),), (Variable("x"),)

    def reset(self, parameters=None, t0=0.0):
        self.x = np.zeros(1)
        return self.x.copy()

    def step(self, u, h):
        self.x = self.x + h * (u - 0.5 * self.x)
        return self.x.copy()

@dataclass(kw_only=True)
class Proportional(Controller):
    gain: float = setting(1.0, doc="gain")

    def start(self, loop):
        pass

    def step(self, sample):
        return self.gain * (sample.setpoint - sample.y)
"""
STUDY = """
name = "sticky"
plant = { name = "lags:Lag" }
loop = { sampling_time = 0.1, duration = 3.0 }
reference.x = { kind = "constant", value = 1.0 }
controllers.p = { type = "lags:Proportional", settings = { gain = 1.5 } }
scenarios.free = {}
scenarios.sticky = { dead_band = { u = 2.5 }, delay = { u = 0.1 } }
"""
SCRIPT = """
import json
from ddpc_cosim import Conditions, Constant, Problem, Scenario, Study
from lags import Lag, Proportional

def made():
    conditions = Conditions(dead_band={"u": 2.5}, delay={"u": 0.1})
    scenarios = {"free": Scenario(), "sticky": Scenario(conditions=conditions)}
    loop = dict(sampling_time=0.1, duration=3.0, reference={"x": Constant(1.0)})
    problem = Problem(plant=Lag, scenarios=scenarios, **loop)
    return Study(problem, {"p": Proportional(gain=1.5)}, name="sticky")

if __name__ == "__main__":
    results = [study.run("out", progress=False) for study in (Study.read("study.toml"), made())]
    print(json.dumps([[[case.id, str(case.outcome)] for case in one.cases] for one in results]))
"""

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A folder with a third party's package, and studies that use it."""
    (tmp_path / "ddpc_dead_band.py").write_text(MODULE, encoding="utf-8")
    (tmp_path / "lags.py").write_text(LOOP, encoding="utf-8")
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    info = tmp_path / "dead_bands-1.0.dist-info"
    info.mkdir()
    metadata = "Metadata-Version: 2.1\nName: dead-bands\nVersion: 1.0\n"
    (info / "METADATA").write_text(metadata, encoding="utf-8")
    ((name, target),) = ENTRY_POINTS["ddpc_cosim.conditions"].items()
    entry = f"[ddpc_cosim.conditions]\n{name} = {target}\n"
    (info / "entry_points.txt").write_text(entry, encoding="utf-8")
    return tmp_path


def run_script(site: Path) -> list[list[list[str]]]:
    """Return ids and outcomes of the studies of the script, from a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(site)}
    command = [sys.executable, "script.py"]
    done = subprocess.run(command, cwd=site, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    tables: list[list[list[str]]] = json.loads(done.stdout)
    return tables


def test_it_is_applied_and_told_and_missed_where_it_is_not_installed_any_more(
    site: Path, run_program: Run
) -> None:
    read, made = run_script(site)
    assert [outcome for _, outcome in read] == ["completed"] * 2
    assert made == read  # what Python says is what the file says

    listed = run_program("list", "conditions").stdout
    assert "dead_band" in listed
    assert run_program("report", "out", "--format", "md", "--out", "report.md").returncode == 0
    assert "dead band of u, width 2.5 V" in (site / "report.md").read_text("utf-8").replace("\u00a0", " ")

    module = site / "ddpc_dead_band.py"
    module.write_text(MODULE.replace("/ 2, 0.0)", "/ 2, 0.1)"), encoding="utf-8")
    (free, _), (sticky, _) = run_script(site)[0]
    assert free == read[0][0]
    assert sticky != read[1][0], "what it does is part of what decides a result"

    shutil.rmtree(site / "dead_bands-1.0.dist-info")
    with pytest.warns(CosimWarning, match="scenario sticky: the condition dead_band is not installed here"):
        results = load_results(site / "out")
    trace = results.trace("p", scenario="sticky")
    assert results.study.scenarios["sticky"].effects == {"dead_band": {"u": 2.5}, "delay": {"u": 0.1}}
    commanded = np.concatenate([[0.0], trace.u[:-1, 0]])  # a sample late
    expected = np.sign(commanded) * np.maximum(np.abs(commanded) - 1.25, 0.1)
    np.testing.assert_allclose(trace.applied[:, 0], expected)
    assert (trace.applied[:, 0] == 0.1).any()

    done = run_program("report", "out", "--format", "md", "--out", "later.md")
    assert done.returncode == 0
    assert "the condition dead_band is not installed here" in done.stderr
    page = (site / "later.md").read_text("utf-8").replace("\u00a0", " ").replace("\\", "")
    assert "dead_band of u: 2.5 (not installed here)" in page
    done = run_program("run", "study.toml", "--out", "again")
    assert done.returncode == 2
    assert "scenarios.sticky.dead_band: unknown key" in done.stderr
