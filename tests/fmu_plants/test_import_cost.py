"""Reading a plant's variables must stay cheap."""

import subprocess
import sys

HEAVY = ["sympy", "fmpy", "pandas", "control", "matplotlib", "scipy", "numpy"]


def test_reading_variables_imports_nothing_heavy():
    program = f"""
import sys
import fmu_plants, fmu_plants.pendulum
assert fmu_plants.pendulum.MODEL.inputs[0].name == "torque"
print(sorted(set({HEAVY!r}) & set(sys.modules)))
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
