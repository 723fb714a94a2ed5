"""A study that is proposed from logs alone: what it takes from them, and what it refuses."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from ddpc_cosim import ConfigError, FloatArray
from ddpc_cosim.study.plants import PlantSpec
from ddpc_cosim.suggestion import Proposal, suggest_study

LOG = Path(__file__).parents[3] / "docs" / "examples" / "tanks-monday.csv"


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log in which a row is lost and another one is there twice."""
    lines = LOG.read_text(encoding="utf-8").splitlines()
    lines[60:61] = []
    lines[20:20] = [lines[20]]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


@pytest.mark.slow
def test_a_messy_log_is_mended_and_the_study_says_how(log: Path) -> None:
    proposal: Proposal = suggest_study(log, trial=False)
    identified, recording = proposal.study.plant.identified, proposal.study.recording
    assert identified is not None
    assert recording is not None
    assert proposal.study.plant.inputs == ["pump A", "pump B"]
    assert proposal.study.plant.outputs == ["level_1", "level_2"]
    for section in (identified, recording):
        assert (section.gaps, section.duplicates) == ("split", "first")
    assert (identified.part, recording.part) == ([0.5, 1.0], [0.0, 0.5])
    assert any("duplicate row dropped" in said for said in proposal.comments["plant"])
    about, meaning, *_ = proposal.comments["head"]
    assert about.startswith(
        "What the log says of the plant: Good enough for predictive control with a horizon"
    )
    assert "does not say that a controller settles. If none does below, look at setpoints" in meaning
    assert {*proposal.origins.values()} == {"the log's range"}


@pytest.mark.slow
def test_the_inputs_can_hold_all_setpoints_together_within_the_log(log: Path) -> None:
    """By the steady states of the identified model, with the inputs found by a bounded least-squares fit."""
    study = suggest_study(log, trial=False).study
    spec = PlantSpec.of(study.plant, Path()).built()
    assert spec.identified is not None
    assert spec.identified.ensemble is not None
    ensemble = spec.identified.ensemble
    model = ensemble.models[0]
    low, high = np.array([ensemble.ranges[name] for name in study.plant.inputs]).T
    limits = np.array([ensemble.ranges[name] for name in study.plant.outputs])
    references = [study.reference[name] for name in study.plant.outputs]
    times = sorted({time for reference in references for time in reference.times})
    assert len(times) > 2
    for time in times:
        wanted = np.array([float(reference.at(time)) for reference in references])
        assert (limits[:, 0] <= wanted).all()
        assert (wanted <= limits[:, 1]).all()

        def off(u: FloatArray, wanted: FloatArray = wanted) -> FloatArray:
            return (model.output(model.rest(u, np.empty(0))) - wanted) / np.ptp(limits, axis=1)

        held = least_squares(off, (low + high) / 2, bounds=(low, high))
        assert np.abs(held.fun).max() < 0.02, (time, wanted)


def test_a_log_beside_an_fmu_is_refused(log: Path) -> None:
    with pytest.raises(ConfigError, match=r"log\.csv: a log is a plant by itself"):
        suggest_study([log, log.with_suffix(".fmu")])


def test_disturbances_are_named_of_logs_only(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="disturbances are named of logs"):
        suggest_study(tmp_path / "plant.fmu", disturbances=["sun"])


def test_columns_that_are_not_there_are_told_together(log: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        suggest_study(log, inputs=["pump C"], outputs=["level_4"])
    assert ["no such column" in fault for fault in caught.value.faults] == [True, True]


@pytest.mark.slow
def test_a_log_that_says_too_little_is_the_likely_cause_where_no_controller_settles(tmp_path: Path) -> None:
    """Noise that is larger than what the input does to the output."""
    rng = np.random.default_rng(3)
    u = rng.choice([-1.0, 1.0], 300).cumsum() % 5.0
    y = np.zeros(300)
    for k in range(299):
        y[k + 1] = 0.8 * y[k] + 0.05 * u[k]
    rows = np.column_stack([np.arange(300.0), u, y + rng.normal(0.0, 2.0, 300)])
    path = tmp_path / "log.csv"
    np.savetxt(path, rows, delimiter=";", header="time;u;y", comments="", fmt="%.6g")
    about, meaning, *_ = suggest_study(path, inputs=["u"], outputs=["y"], trial=False).comments["head"]
    assert about.startswith("What the log says of the plant: Not good enough for predictive control: ")
    assert meaning.startswith("If no controller settles below, that is the likely cause")
