"""What is measured against the obvious alternatives: ``python -m benchmarks NAME``."""

import os

# One thread for everybody, set before NumPy starts its own: on problems this small threads only disturb.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
