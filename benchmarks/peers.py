"""DeePC's step against pip-installable peers on the same recording and the same pasts.

Each peer solves the nearest problem that it can express. Its environment is made on the fly in a temporary
folder, with the package installer's own client, and is gone afterwards.
"""

import json
import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

import numpy as np

from benchmarks.pendulum import PRINTED, STEPS, experiment, loop
from benchmarks.step import Row, Stepper, measure, print_header, print_rows, started
from ddpc_controllers import DeePC
from ddpc_cosim import FloatArray, Recording, Sample

PEERS = ("deepctools==1.1.5", "direct-data-driven-mpc==1.3.1")
_WORKER = Path(__file__).with_name("peers_worker.py")
_SOLVES = 60
_SAME_INPUT = 1e-8
_TORQUE = 3.5


class Listener:
    """A step that keeps the pasts it was asked with and the answers it gave."""

    def __init__(self, settings: DeePC, recording: Recording) -> None:
        self._step = started(settings, recording, _TORQUE)
        self._past = settings.initial_length
        self.u = [np.zeros(1)] * self._past
        self.y: list[FloatArray] = []
        self.reference: list[FloatArray] = []

    def __call__(self, sample: Sample) -> FloatArray:
        self.y = self.y or [sample.y] * self._past
        self.reference.append(sample.reference[:, 0].copy())
        u = self._step(sample)
        self.u.append(u)
        self.y.append(sample.y)
        return u


def regulation() -> DeePC:
    """Return DeePC on the problem that deepctools can express: no setpoint, no terminal condition."""
    return DeePC(regulariser="ridge", artificial_setpoint=False)


def peer_environment(folder: Path) -> Path:
    """Make an environment with the peers; return its Python."""
    venv.create(folder, with_pip=True)
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    subprocess.run([python, "-m", "pip", "install", "--quiet", *PEERS], check=True)
    return python


def ask_peers(
    python: Path, folder: Path, recording: Recording, listener: Listener
) -> dict[str, dict[str, list[float]]]:
    """Let the peers solve what the listener was asked; return times [us] and inputs of each."""
    settings = regulation()
    question = {
        "u": recording.u.tolist(),
        "y": recording.y.tolist(),
        "past_u": np.array(listener.u)[:, 0].tolist(),
        "past_y": np.array(listener.y)[:, 0].tolist(),
        "reference": np.array(listener.reference).tolist(),
        "solves": _SOLVES,
        "torque": _TORQUE,
        "angle": float(loop(recording, _TORQUE).bounds.y_max[0]),
        "initial_length": settings.initial_length,
        "horizon": settings.horizon,
        "q": settings.output_weight,
        "r": settings.input_weight,
        "s": settings.setpoint_weight,
        "lambda_g": settings.lambda_g,
        "lambda_sigma": settings.lambda_sigma,
    }
    (folder / "question.json").write_text(json.dumps(question), encoding="utf-8")
    environment = {**os.environ, "MPLBACKEND": "Agg", "QT_QPA_PLATFORM": "offscreen"}
    subprocess.run(
        [python, str(_WORKER), str(folder)], check=True, env=environment, stdout=subprocess.DEVNULL
    )
    answers: dict[str, dict[str, list[float]]] = json.loads(
        (folder / "answer.json").read_text(encoding="utf-8")
    )
    return answers


def main() -> bool:
    """Print the table; return whether every bound was held."""
    print_header()
    recording = experiment(200)
    listener = Listener(regulation(), recording)
    steppers: dict[str, Stepper] = {
        "printed": started(DeePC(**PRINTED), recording, _TORQUE),
        "regulation": listener,
    }
    times = measure(steppers, DeePC(**PRINTED).horizon)
    printed = float(np.median(times["printed"]))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print(f"installing {', '.join(PEERS)} ...", file=sys.stderr)
        answers = ask_peers(peer_environment(folder / "environment"), folder, recording, listener)
    rows = []
    for peer, answer in answers.items():
        median = float(np.median(answer["microseconds"]))
        rows.append(
            Row(f"{peer} / DeePC step on the paper's problem", printed, median, median / printed, 200.0)
        )
    held = print_rows(rows)
    every = STEPS // _SOLVES
    ours = np.array(listener.u)[DeePC(**PRINTED).initial_length :: every, 0][:_SOLVES]
    difference = float(np.abs(np.array(answers["deepctools"]["u"]) - ours).max())
    same = difference <= _SAME_INPUT
    verdict = "held" if same else "MISSED"
    print(
        f"largest difference in u from deepctools, on its own problem: {difference:.1e}   "
        f"<= {_SAME_INPUT:g} {verdict}"
    )
    return held and same
