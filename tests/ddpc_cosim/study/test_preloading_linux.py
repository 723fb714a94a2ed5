"""What takes long to import is there before workers are forked: where they are."""

from pathlib import Path

from studies import run_file, study_text, write

from ddpc_cosim import Outcome

SEEN = """
import sys
import numpy as np
from ddpc_cosim import Plant, Variable

class Seen(Plant):
    inputs, outputs = (Variable("u"),), (Variable("y"),)
    def reset(self, parameters=None, t0=0.0):
        if "control" not in sys.modules:
            raise RuntimeError("python-control is imported by each worker anew")
        self.y = np.zeros(1)
        return self.y.copy()
    def step(self, u, h):
        self.y = 0.9 * self.y + 0.1 * u
        return self.y.copy()
"""


def test_what_a_controller_inside_another_takes_long_to_import_is_there_before_workers_begin(
    tmp_path: Path,
) -> None:
    (tmp_path / "seen.py").write_text(SEEN, encoding="utf-8")
    inside = {"edge": "upper", "margin": 0.1, "controller": {"type": "lqr"}}
    text = study_text(
        {"name": "seen.py:Seen"},
        {"y": {"band": {"lower": 0.0, "upper": 0.5}}},
        {"inside": {"type": "band-edge", "settings": inside}},
        bounds={"u": {"min": -1.0, "max": 1.0}},
        recording={"samples": 40, "excitation": {"u": {"low": -1.0, "high": 1.0}}},
    )
    (case,) = run_file(write(tmp_path, text)).cases
    assert case.outcome is Outcome.COMPLETED, case.reason
