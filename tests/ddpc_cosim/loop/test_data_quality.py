"""What a recording cannot serve for is told before the loop is closed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ddpc_cosim import (
    Controller,
    DataError,
    FloatArray,
    Loop,
    Plant,
    Recording,
    Sample,
    Steps,
    Trace,
    UniformRandom,
    Variable,
    cosimulate,
    judge_prediction,
)
from ddpc_cosim.study.case_files import load_case, read_trace, write_case


class Lag(Plant):
    """y' = gain * u - y."""

    inputs = (Variable("u", min=-1.0, max=1.0),)
    outputs = (Variable("y", unit="m"),)

    def __init__(self, gain: float = 1.0) -> None:
        self.gain = gain

    def reset(self, parameters: Mapping[str, Any] | None = None, t0: float = 0.0) -> FloatArray:
        self.y = 0.0
        return np.array([self.y])

    def step(self, u: FloatArray, h: float) -> FloatArray:
        settled = self.gain * float(u[0])
        self.y = settled + (self.y - settled) * np.exp(-h)
        return np.array([self.y])


class Learner(Controller):
    """Learns nothing, and says so."""

    uses_recording = True

    def __init__(self, warnings: Sequence[str] = ()) -> None:
        self._warnings = warnings

    def start(self, loop: Loop) -> None:
        self.inputs = len(loop.inputs)

    def step(self, sample: Sample) -> FloatArray:
        return np.zeros(self.inputs)

    def warnings(self) -> Sequence[str]:
        return self._warnings


def run(amplitude: float, target: float, gain: float = 1.0, controller: Controller | None = None) -> Trace:
    return cosimulate(
        Lag(gain),
        controller or Learner(),
        sampling_time=0.1,
        duration=1.0,
        reference=Steps([0.0], [target]),
        excitation=UniformRandom(-amplitude, amplitude, 200, seed=1),
    )


@given(
    amplitude=st.floats(0.05, 1.0),
    gain=st.floats(1e-3, 1e3),
    share=st.floats(-0.9, 0.9),
)
def test_a_recording_over_the_range_that_is_asked_for_has_no_warning(
    amplitude: float, gain: float, share: float
) -> None:
    # What an input of this amplitude holds in steady state.
    assert run(amplitude, share * amplitude * gain, gain).warnings == ()


def test_a_recording_far_below_the_reference_and_the_limits_is_told() -> None:
    far, faint = run(amplitude=0.01, target=0.8).warnings
    assert far.startswith('the reference of "y" goes')
    assert "m (root mean square" in far
    assert faint.startswith('the recorded input "u" moves by 0.00')
    percent = float(faint.split("mean), ")[1].split(" %")[0])
    assert percent == pytest.approx(1.0 / np.sqrt(3), rel=0.1)  # of a range of 1 to each side


@pytest.mark.parametrize(
    ("amplitude", "gain", "words"),
    [(0.0, 1.0, '"u" stands still; the output "y" never moves'), (1.0, 0.0, '"y" never moves')],
)
def test_a_recording_in_which_nothing_moves_is_refused(amplitude: float, gain: float, words: str) -> None:
    u = np.random.default_rng(0).uniform(-amplitude, amplitude, (50, 1))
    y = gain * np.cumsum(u, axis=0)
    with pytest.raises(DataError, match="of 50 samples cannot serve") as error:
        cosimulate(
            Lag(),
            Learner(),
            sampling_time=0.1,
            duration=1.0,
            reference=Steps([0.0], [1.0]),
            recording=Recording(u, y, y, 0.1),
        )
    assert words.split(";")[0] in str(error.value)


def test_what_a_controller_says_of_its_data_follows_what_the_loop_knows_and_is_kept(tmp_path: Path) -> None:
    trace = run(0.01, 0.8, controller=Learner(["its own \ud800 doubt"]))
    assert [text.split(" ")[0] for text in trace.warnings] == ["the", "the", "its"]
    assert trace.warnings[-1] == "its own ? doubt"  # a text that no file could hold
    head = {"id": "a", "controller": "c", "label": "C", "scenario": "nominal", "seed": 0}
    write_case(tmp_path / "a", trace, head)
    assert read_trace(tmp_path / "a").warnings == load_case(tmp_path / "a").warnings == trace.warnings


def test_a_controller_that_learns_from_nothing_recorded_is_not_warned_of_the_recording() -> None:
    class Deaf(Learner):
        uses_recording = False

    assert run(0.01, 0.8, controller=Deaf()).warnings == ()


@pytest.mark.parametrize(
    ("error", "fitted", "words"),
    [
        (0.05, 0.04, "good"),
        (0.3, 0.01, "fair"),
        (
            0.9,
            0.8,
            "poor: what it was fitted to is not predicted either, for noise, for inputs or disturbances",
        ),
        (0.9, 0.1, "poor: what it was fitted to is predicted far better"),
        (float("inf"), float("inf"), "poor: what it was fitted to is not predicted either"),
    ],
)
def test_a_prediction_is_judged_by_its_error_on_what_it_was_not_fitted_to(
    error: float, fitted: float, words: str
) -> None:
    assert judge_prediction(error, fitted).startswith(words)


def test_predictions_of_an_unstable_plant_grow_whatever_the_recording() -> None:
    assert "or it is unstable" in judge_prediction(4.0, 0.1)
