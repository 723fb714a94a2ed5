"""Reading a plant's variables must stay cheap."""

import subprocess
import sys

HEAVY = ["sympy", "fmpy", "pandas", "control", "matplotlib", "scipy", "numpy"]


def test_reading_variables_imports_nothing_heavy():
    program = f"""
import importlib.metadata, sys
plants = [entry.load() for entry in importlib.metadata.entry_points(group="ddpc_cosim.plants")]
assert len(plants) >= 10
from fmu_plants import pendulum
assert pendulum.MODEL.inputs[0].name == "torque"
print(sorted(set({HEAVY!r}) & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
