"""The experiment about a stabilising controller: what is applied, recorded, refused."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studies import cases_in, run_file, study_text, write

from ddpc_cosim import (
    Action,
    ConfigError,
    Constant,
    Controller,
    ControllerError,
    DataError,
    Excitation,
    FloatArray,
    Loop,
    Plant,
    Ramp,
    Recording,
    Sample,
    UniformRandom,
    Variable,
    cosimulate,
    record,
    setting,
)
from ddpc_cosim.study.case_files import read_run
from ddpc_cosim.study.reading import read_study

EXCITATION = UniformRandom(-0.1, 0.1, samples=45, seed=3)


class Unstable(Plant):
    """x+ = 1.5 x + u, from x = 0.1."""

    def __init__(self) -> None:
        self.inputs = (Variable("u", min=-1.0, max=1.0),)
        self.outputs = (Variable("x"),)

    def reset(self, parameters: Mapping[str, object] | None = None, t0: float = 0.0) -> FloatArray:
        self.x = np.array([0.1])
        return self.x.copy()

    def step(self, u: FloatArray, h: float) -> FloatArray:
        # Beyond recognition is as far as anybody needs to compute.
        self.x = 1.5 * self.x + u if np.abs(self.x) < 1e9 else np.array([np.inf])
        return self.x.copy()


@dataclass(kw_only=True)
class Proportional(Controller):
    """u = r_k+1 - gain x; a status every tenth sample."""

    gain: float = setting(1.4, doc="feedback gain")
    seen: list[Sample] = field(default_factory=list, init=False)

    def start(self, loop: Loop) -> None:
        self.seen.clear()
        self.loop = loop

    def step(self, sample: Sample) -> Action:
        self.seen.append(sample)
        u = sample.reference[0] - self.gain * sample.y
        return Action(u, "tenth") if sample.k % 10 == 0 else Action(u)


class Learning(Proportional):
    """One that would need a recording."""

    uses_recording = True


@dataclass(kw_only=True)
class Reader(Controller):
    """Keeps the recording that it is given."""

    uses_recording = True

    def start(self, loop: Loop) -> None:
        self.loop = loop

    def step(self, sample: Sample) -> FloatArray:
        return -1.4 * sample.y


def experiment(stabiliser: Controller, **changes: object) -> Recording:
    """Record the unstable plant."""
    arguments = {"sampling_time": 0.5, "stabiliser": stabiliser, "reference": Constant(0.0)} | changes
    return record(Unstable(), EXCITATION, **arguments)  # type: ignore[arg-type]


def test_without_a_stabiliser_the_plant_runs_away() -> None:
    open_loop = record(Unstable(), EXCITATION, sampling_time=0.5)
    assert np.abs(open_loop.y).max() > 1e6


def test_the_excitation_is_added_and_what_is_recorded_was_applied() -> None:
    recording = experiment(Proportional())
    expected = EXCITATION.draw(1) - 1.4 * recording.y
    assert recording.u == pytest.approx(expected)
    assert np.array_equal(recording.excitation, EXCITATION.draw(1))
    assert recording.y[1:] == pytest.approx(1.5 * recording.y[:-1] + recording.u[:-1])
    assert np.abs(recording.y).max() < 0.3


def test_an_excitation_alone_is_applied_beyond_the_limits_of_the_loop_too() -> None:
    recording = record(Unstable(), UniformRandom(-9.0, 9.0, samples=5), sampling_time=0.5)
    assert np.array_equal(recording.u, UniformRandom(-9.0, 9.0, samples=5).draw(1))
    assert np.abs(recording.u).max() > 1.0


@dataclass
class Given(Excitation):
    """An excitation of anyone's."""

    table: object

    def draw(self, inputs: int) -> FloatArray:
        return self.table  # type: ignore[return-value]


def test_an_excitation_can_be_of_any_class() -> None:
    table = np.array([[0.1], [-0.2], [0.3]])
    recording = record(Unstable(), Given(table), sampling_time=0.5)
    assert np.array_equal(recording.u, table)
    assert recording.y[:, 0] == pytest.approx([0.1, 0.25, 0.175])


@pytest.mark.parametrize(
    ("table", "shape"),
    [(np.ones(3), "(3,)"), (np.ones((3, 2)), "(3, 2)"), (np.full((3, 1), np.nan), "(3, 1)")],
)
def test_an_excitation_that_cannot_be_applied_is_refused(table: FloatArray, shape: str) -> None:
    with pytest.raises(
        ConfigError, match=re.escape(f"excitation: Given.draw: shape {shape}; needed: finite")
    ):
        record(Unstable(), Given(table), sampling_time=0.5)


def test_a_stabiliser_can_do_with_its_sample_what_it_likes() -> None:
    class Careless(Proportional):
        def step(self, sample: Sample) -> Action:
            action = super().step(sample)
            sample.y[:] = sample.measured[:] = 7.0
            return action

    careful, careless = experiment(Proportional()), experiment(Careless())
    assert careless.y.tobytes() == careful.y.tobytes()
    assert careless.measured.tobytes() == careful.measured.tobytes()


def test_limits_that_the_excitation_meets_are_not_the_stabilisers_fault() -> None:
    reader = Reader()
    trace = cosimulate(
        Unstable(),
        reader,
        sampling_time=0.5,
        duration=1.0,
        reference=Constant(0.0),
        excitation=EXCITATION,
        stabiliser=Proportional(),
        bounds={"u": (-0.15, 0.2)},
    )
    assert reader.loop.recording is not None
    assert reader.loop.recording.u.min() == -0.15
    assert trace.diagnostics["stabiliser_fallbacks"] == 5


def test_the_applied_inputs_keep_their_limits() -> None:
    recording = experiment(Proportional(), bounds={"u": (-0.15, 0.2)})
    assert (recording.u.min(), recording.u.max()) == (-0.15, pytest.approx(0.2, abs=0.1))
    assert recording.y[1:] == pytest.approx(1.5 * recording.y[:-1] + recording.u[:-1])


def test_the_stabiliser_follows_the_reference_from_its_start() -> None:
    stabiliser = Proportional()
    experiment(stabiliser, reference=Ramp(0.0, 1.0, 0.0, 10.0))
    assert [sample.k for sample in stabiliser.seen] == list(range(45))
    assert stabiliser.seen[3].time == 1.5
    assert stabiliser.seen[3].reference == pytest.approx(np.array([[0.2]]))
    assert stabiliser.loop.recording is None


def test_a_loop_learns_from_the_experiment_and_may_go_on_from_its_end() -> None:
    reader = Reader()
    trace = cosimulate(
        Unstable(),
        reader,
        sampling_time=0.5,
        duration=5.0,
        reference=Constant(0.0),
        excitation=EXCITATION,
        stabiliser=Proportional(),
        continue_recording=True,
    )
    recording = reader.loop.recording
    assert recording is not None
    assert np.array_equal(recording.u, experiment(Proportional()).u)
    assert trace.y[0] == pytest.approx(1.5 * recording.y[-1] + recording.u[-1])
    assert trace.diagnostics["stabiliser_fallbacks"] == 5


def test_a_stabiliser_that_lets_go_is_told_apart_from_an_open_loop() -> None:
    with pytest.raises(DataError, match="during the closed-loop experiment"):
        record(
            Unstable(),
            UniformRandom(-0.1, 0.1, samples=3000),
            sampling_time=0.5,
            stabiliser=Proportional(gain=0.0),
            reference=Constant(0.0),
        )


def test_a_stabiliser_that_fails_is_named_with_the_time() -> None:
    class Failing(Proportional):
        def step(self, sample: Sample) -> Action:
            if sample.k == 4:
                raise ZeroDivisionError("no gain")
            return super().step(sample)

    with pytest.raises(ControllerError, match=r"Failing.step raised ZeroDivisionError: .* at t = 2 s"):
        experiment(Failing())


def test_a_stabiliser_that_answers_with_another_shape_is_named() -> None:
    class Wrong(Proportional):
        def step(self, sample: Sample) -> Action:
            return Action(np.full(2, np.nan))

    with pytest.raises(ControllerError, match=r"Wrong.step returned \[nan, nan\], .*, during the exp"):
        experiment(Wrong())


def test_a_stabiliser_cannot_learn_from_what_it_is_to_record() -> None:
    with pytest.raises(ConfigError, match="Learning learns from a recording itself"):
        experiment(Learning())


def test_a_stabiliser_needs_a_reference() -> None:
    with pytest.raises(ConfigError, match="reference: none for x"):
        experiment(Proportional(), reference=None)


def test_a_stabiliser_without_an_excitation_is_refused() -> None:
    with pytest.raises(ConfigError, match="stabiliser needs an excitation"):
        cosimulate(
            Unstable(),
            Proportional(),
            sampling_time=0.5,
            duration=1.0,
            reference=Constant(0.0),
            stabiliser=Proportional(),
        )


def write_about(folder: Path, stabiliser: dict[str, Any]) -> Path:
    """Write a study whose experiment is about a stabilising controller."""
    excitation = {"torque": {"low": -1.0, "high": 1.0}}
    text = study_text(
        reference={"angle": 0.2},
        controllers=["deepc"],
        loop={"duration": 2.0},
        bounds={"torque": {"min": -3.5, "max": 3.5}},
        recording={"samples": 80, "excitation": excitation, "controller": stabiliser},
    )
    return write(folder, text)


def test_a_study_records_about_its_stabiliser(tmp_path: Path) -> None:
    study = write_about(tmp_path, {"type": "mfapc", "settings": {"lambda_u": 0.5}})
    (case,) = run_file(study).cases
    assert case.outcome == "completed"
    assert read_run(case.folder)["diagnostics"]["stabiliser_fallbacks"] == 0.0
    # The resolved study has every default of the stabiliser too, and can be run again.
    again = read_study(str(tmp_path / "out" / "study.toml")).problem.study
    assert again.recording is not None
    assert again.recording.controller is not None
    assert again.recording.controller.settings["lambda_u"] == 0.5
    assert again.recording.controller.settings["horizon"] == 5


def test_other_settings_of_the_stabiliser_are_another_case(tmp_path: Path) -> None:
    ids = set()
    for weight in (0.5, 0.6):
        study = write_about(tmp_path, {"type": "mfapc", "settings": {"lambda_u": weight}})
        ids |= {case.id for case in cases_in(study)}
    assert len(ids) == 2


@pytest.mark.parametrize(
    ("stabiliser", "message"),
    [
        (
            {"type": "mfapc", "settings": {"eta": 7.0}},
            "recording.controller.settings.eta: 7.0 is not possible",
        ),
        (
            {"type": "mfapc", "settings": {"etta": 1.0}},
            "recording.controller.settings.etta: unknown setting",
        ),
        ({"type": "mfapcc"}, "recording.controller.type: .*mfapc"),
        ({"type": "deepc"}, "recording.controller: learns from a recording itself"),
    ],
)
def test_faults_of_the_stabiliser_are_told_with_their_key(
    tmp_path: Path, stabiliser: dict[str, Any], message: str
) -> None:
    study = write_about(tmp_path, stabiliser)
    with pytest.raises(ConfigError, match=message):
        read_study(str(study))
