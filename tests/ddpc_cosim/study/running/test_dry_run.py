"""What a run would take: cases, time by those already run, bytes."""

import io
import re
import tempfile
from pathlib import Path
from types import SimpleNamespace

import pytest
from studies import cases_in, run_file, study_text, write

from ddpc_cosim.cli.progress import LineProgress
from ddpc_cosim.study.case_files import load_case, write_case
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.runner import Selection
from ddpc_cosim.study.running import dry_run
from ddpc_cosim.study.running.dry_run import expected

SWEPT = study_text(
    seeds=["0:2"],
    loop={"duration": 20.0},
    controllers={
        "mfapc": {"type": "mfapc", "sweep": {"lambda_u": [0.1, 0.2, 0.3]}},
        "pid": {"type": "pid", "settings": {"proportional": 1.0}},
    },
)


@pytest.fixture
def study(tmp_path: Path) -> str:
    return str(write(tmp_path, SWEPT))


def lines_of(study: str, folder: Path, selection: Selection) -> list[str]:
    return expected(read_study(study), folder, selection, LineProgress(io.StringIO())).splitlines()


def test_without_any_case_the_time_is_that_of_a_trial_and_nothing_is_written(
    study: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dry_run, "_TRIAL_SECONDS", 600.0)
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))  # others run beside this one
    cases, time, _ = lines_of(study, tmp_path / "out", Selection())
    assert cases.startswith("10 cases and 2 runs of doing nothing: 12 to run, 0 already there")
    # One of MFAPC, whatever its settings, one of PID and one of doing nothing.
    assert re.fullmatch(r"time: about [0-9.]+ m?s with 1 worker, by a trial of 3 cases", time), time
    assert not (tmp_path / "out").exists()
    assert not [*(tmp_path / "temporary").glob("ddpc-cosim-*")]


def test_a_trial_without_time_tells_nothing(study: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(dry_run, "_TRIAL_SECONDS", -1.0)
    time = lines_of(study, tmp_path / "out", Selection())[1]
    assert time == "time: not known, as none of them has been run"


def test_a_case_that_is_not_done_in_a_trial_is_extrapolated_from_its_samples(monkeypatch) -> None:
    clock = iter([0.0, 0.0, 1.0, 3.0, 20.0])
    monkeypatch.setattr(dry_run, "monotonic", lambda: next(clock))
    trial = dry_run._Trial(LineProgress(io.StringIO()))
    trial.start(2, 0)
    trial.update(SimpleNamespace(case="a", samples=0, planned=100))
    trial.update(SimpleNamespace(case="a", samples=20, planned=100))
    assert trial.seconds == {"a": 10.0}, "a fifth of the samples in 2 s"
    with pytest.raises(dry_run._TimeIsUpError):
        trial.update(SimpleNamespace(case="a", samples=95, planned=100))
    assert trial.seconds == {"a": 20.0}, "19 s for 95 of 100 samples"


def test_the_time_is_that_of_the_same_controller_with_whatever_settings(study: str, tmp_path: Path) -> None:
    cases = cases_in(study)
    run_file(study, seeds=[0], only="mfapc")
    # As if it had taken 60 s: the seven others of MFAPC take as long; PID is tried.
    first = load_case(tmp_path / "out" / "cases" / cases[0].id)
    write_case(first.folder, first.trace(), cases[0].head() | {"wall_time": 60.0})
    kept, time, _ = lines_of(study, tmp_path / "out", Selection(jobs=2))
    assert kept.startswith("10 cases and 2 runs of doing nothing: 10 to run, 2 already there")
    assert (
        time == "time: about 4 min with 2 workers, by the cases already run and a trial of 1 case"
    )  # 7 x 60 s / 2
    assert lines_of(study, tmp_path / "out", Selection(seeds=[0], only="mfapc"))[1:] == []


@pytest.mark.parametrize("storage", ["csv", "parquet"])
def test_the_size_is_about_that_of_the_files(study: str, tmp_path: Path, storage: str) -> None:
    *_, size = lines_of(study, tmp_path / "out", Selection(storage=storage, seeds=[0]))
    run_file(study, storage=storage, seeds=[0])
    match = re.fullmatch(r"size: about ([0-9.]+) kB", size)
    assert match
    written = sum(file.stat().st_size for file in (tmp_path / "out" / "cases").glob("*/*"))
    assert float(match[1]) * 1e3 == pytest.approx(written, rel=0.5)
