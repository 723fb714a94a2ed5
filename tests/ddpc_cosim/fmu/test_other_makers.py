"""FMUs built by other makers' tools run behind the same session."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fmpy.template import create_fmu, generate_model_description

from ddpc_cosim.fmu.plant import FMUPlant

pytestmark = pytest.mark.filterwarnings("ignore::ddpc_cosim.CosimWarning")  # what is told, tests look at

PYTHONFMU = """
from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real

class Lag(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u, self.x, self.rate, self.steps = 0.0, 0.0, 2.0, 0
        self.register_variable(Real("u", causality=Fmi2Causality.input))
        self.register_variable(Real("x", causality=Fmi2Causality.output))
        self.register_variable(Integer("steps", causality=Fmi2Causality.output))
        self.register_variable(
            Real("rate", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable)
        )

    def do_step(self, t, h):
        self.x += h * self.rate * (self.u - self.x)
        self.steps += 1
        return True
"""
PYTHONFMU3 = """
from pythonfmu3 import Fmi3Causality, Fmi3Slave, Fmi3Variability, Float64, Int32

class Lag(Fmi3Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.time, self.u, self.x, self.rate, self.steps = 0.0, 0.0, 0.0, 2.0, 0
        independent = Fmi3Causality.independent
        self.register_variable(Float64("time", causality=independent, variability=Fmi3Variability.continuous))
        self.register_variable(Float64("u", causality=Fmi3Causality.input))
        self.register_variable(Float64("x", causality=Fmi3Causality.output))
        self.register_variable(Int32("steps", causality=Fmi3Causality.output))
        self.register_variable(
            Float64("rate", causality=Fmi3Causality.parameter, variability=Fmi3Variability.tunable)
        )

    def do_step(self, t, h):
        self.x += h * self.rate * (self.u - self.x)
        self.steps += 1
        return True
"""


@pytest.mark.parametrize(("tool", "code"), [("pythonfmu", PYTHONFMU), ("pythonfmu3", PYTHONFMU3)])
def test_fmus_written_in_python(tmp_path: Path, tool: str, code: str) -> None:
    # Both run in this process's interpreter, which knows modules by their names.
    script = tmp_path / f"{tool}_lag.py"
    script.write_text(code, encoding="utf-8")
    command = [sys.executable, "-m", tool, "build", "-f", str(script), "--dest", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True)
    session = FMUPlant(tmp_path / "Lag.fmu", inputs=["u"], outputs=["x", "steps"])
    session.reset({"rate": 3.0})
    x = 0.0
    for k, u in enumerate([1.0, -0.5, 0.25], start=1):
        x += 0.1 * 3.0 * (u - x)
        assert session.step(np.array([u]), 0.1).tolist() == pytest.approx([x, k])
    session.close()


def test_fmus_of_fmpys_template(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It writes C sources in which the equations are to be filled in: outputs stay what they are."""
    monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path / "cache"))
    description = generate_model_description(n_parameters=1, n_inputs=2, n_outputs=3, n_states=1)
    create_fmu(description, tmp_path / "template.fmu")
    session = FMUPlant(tmp_path / "template.fmu")
    assert "compiled from the FMU's C sources" in session.warnings[-1]
    y = session.reset({"p0": 2.0})
    assert session.step(np.array([1.0, -1.0]), 0.01).tolist() == y.tolist() == [0.0, 0.0, 0.0]
    session.close()
