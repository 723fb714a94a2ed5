"""Classes that no other process can import run in workers, and their source decides the id of their cases."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from studies import study_text, write

from ddpc_controllers import DeePC
from ddpc_cosim import Controller
from ddpc_cosim.plugins import code_version, name_of

SCRIPT = """
import json
from dataclasses import dataclass
import numpy as np
from ddpc_cosim import Controller, Plant, Study, Variable, setting
from ddpc_cosim.plugins import name_of

GAIN = 2.0
TABLE = np.linspace(0.0, 1.0, 5000)

def law(error):
    return GAIN * error + 0.0 * TABLE[0]

@dataclass(kw_only=True)
class Proportional(Controller):
    factor: float = setting(1.0, doc="factor")
    def start(self, loop):
        pass
    def step(self, sample):
        return law(self.factor * (sample.setpoint - sample.y))

class Lag(Plant):
    inputs, outputs = (Variable("u"),), (Variable("x"),)
    def reset(self, parameters=None, t0=0.0):
        self.x = np.zeros(1)
        return self.x.copy()
    def step(self, u, h):
        self.x = self.x + h * (u - self.x)
        return self.x.copy()

if __name__ == "__main__":
    assert name_of("controllers", Proportional) == "__main__:Proportional"
    assert name_of("plants", Lag) == "__main__:Lag"
    results = Study.read("study.toml").run("runs", jobs=2, progress=False)
    found = [[case.id, case.outcome, case.reason, case.trace().y[:, 0].tolist()] for case in results.cases]
    print(json.dumps(found))
"""
STUDY = study_text(
    plant={"name": "__main__:Lag"},
    reference={"x": 1.0},
    controllers={"p": {"type": "__main__:Proportional", "settings": {"factor": 1.5}}},
    loop={"duration": 0.3},
)


def run_script(folder: Path, script: str) -> list[list[object]]:
    write(folder, STUDY)
    (folder / "script.py").write_text(script, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=folder, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return list(json.loads(done.stdout))


def test_classes_of_a_script_run_in_workers(tmp_path: Path) -> None:
    """x' = u - x with u = 2 * 1.5 * (1 - x), in steps of Euler."""
    ((first, outcome, reason, y),) = run_script(tmp_path, SCRIPT)
    expected = [0.0]
    for _ in range(3):
        expected.append(expected[-1] + 0.1 * (3.0 * (1.0 - expected[-1]) - expected[-1]))
    assert (outcome, reason) == ("completed", "")
    assert y == pytest.approx(expected, rel=1e-12)
    # Blank lines and code that they do not use are not theirs; what they use, functions and values, is.
    ((same, *_),) = run_script(tmp_path, SCRIPT.replace("import json", "\n\nUNUSED = 3\nimport json"))
    assert same == first
    for change in (
        ("GAIN = 2.0", "GAIN = 2.5"),
        ("0.0, 1.0, 5000)", "0.0, 1.5, 5000)"),
        ("return GAIN *", "return 1.0 * GAIN *"),
        ("h * (u", "1 * h * (u"),
    ):
        ((other, *_),) = run_script(tmp_path, SCRIPT.replace(*change))
        assert other != first, change


def test_names_of_what_can_be_imported() -> None:
    assert name_of("controllers", DeePC) == "deepc"
    assert name_of("controllers", Controller) == "ddpc_cosim.controller:Controller"


def test_a_class_that_is_defined_again_is_another_one() -> None:
    def made(gain: float) -> tuple[str, str]:
        scope: dict[str, type] = {}
        exec(f"class Own:\n    gain = {gain}\n", {"__name__": "__main__"}, scope)
        name = name_of("controllers", scope["Own"])
        return name, code_version(name)

    first, again, other = made(1.0), made(1.0), made(2.0)
    assert first == again
    assert first[0] == other[0] == "__main__:Own"
    assert first[1] != other[1]
