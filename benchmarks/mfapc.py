"""MFAPC's step in its three forms against the formulas line by line in NumPy; medians over one run."""

from collections.abc import Callable, Mapping

import numpy as np

from benchmarks.mfapc_transcription import FullFormTranscription, Transcription
from benchmarks.pendulum import STEPS, experiment
from benchmarks.step import Row, Stepper, measure, print_header, print_rows, started
from ddpc_controllers import MFAPC

LIMIT = 3.5
OUTPUT_LENGTH, INPUT_LENGTH = 1, 3

TRANSCRIPTIONS: Mapping[str, Callable[[], Transcription | FullFormTranscription]] = {
    "cfdl": lambda: Transcription(STEPS, LIMIT),
    "pfdl": lambda: FullFormTranscription(STEPS, LIMIT, 0, INPUT_LENGTH),
    "ffdl": lambda: FullFormTranscription(STEPS, LIMIT, OUTPUT_LENGTH, INPUT_LENGTH),
}


def against_transcription(form: str, limits: str) -> Row:
    """Measure one form; with ``clip`` both do the same, ``qp`` also looks at the whole plan."""
    transcription = TRANSCRIPTIONS[form]()
    controller = MFAPC(form=form, input_length=INPUT_LENGTH, output_length=OUTPUT_LENGTH, limits=limits)
    steppers: dict[str, Stepper] = {
        "step": started(controller, experiment(10), LIMIT),
        "transcription": lambda sample: transcription.step(sample.y, sample.reference),
    }
    times = measure(steppers, controller.horizon)
    step, other = float(np.median(times["step"])), float(np.median(times["transcription"]))
    what = f"MFAPC-{form.upper()}, limits by {limits}: line by line / step"
    return Row(what, step, other, other / step, 2.0)


def main() -> bool:
    """Print the table; return whether every bound was held."""
    print_header()
    return print_rows(
        [against_transcription(form, limits) for form in TRANSCRIPTIONS for limits in ("clip", "qp")]
    )
