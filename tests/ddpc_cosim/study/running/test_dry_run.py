"""What a run would take: cases, time by those already run, bytes."""

import io
import re
from pathlib import Path

import pytest
from studies import cases_in, run_file, study_text, write

from ddpc_cosim.cli.progress import LineProgress
from ddpc_cosim.study.case_files import load_case, write_case
from ddpc_cosim.study.reading import read_study
from ddpc_cosim.study.runner import Selection
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


def test_without_any_case_the_time_is_not_known_and_nothing_is_written(study: str, tmp_path: Path) -> None:
    cases, time, _ = lines_of(study, tmp_path / "out", Selection())
    assert cases.startswith("10 cases and 2 runs of doing nothing: 12 to run, 0 already there")
    assert time == "time: not known, as none of them has been run"
    assert not (tmp_path / "out").exists()


def test_the_time_is_that_of_the_same_controller_with_whatever_settings(study: str, tmp_path: Path) -> None:
    cases = cases_in(study)
    run_file(study, seeds=[0], only="mfapc")
    # As if it had taken 60 s: the seven others of MFAPC take as long, and of PID nothing is known but that.
    first = load_case(tmp_path / "out" / "cases" / cases[0].id)
    write_case(first.folder, first.trace(), cases[0].head() | {"wall_time": 60.0})
    kept, time, _ = lines_of(study, tmp_path / "out", Selection(jobs=2))
    assert kept.startswith("10 cases and 2 runs of doing nothing: 10 to run, 2 already there")
    assert (
        time == "time: about 5 min with 2 workers, by the cases already run"
    )  # 9 x 60 s / 2, and next to nothing
    assert lines_of(study, tmp_path / "out", Selection(seeds=[0], only="mfapc"))[1:] == []


@pytest.mark.parametrize("storage", ["csv", "parquet"])
def test_the_size_is_about_that_of_the_files(study: str, tmp_path: Path, storage: str) -> None:
    *_, size = lines_of(study, tmp_path / "out", Selection(storage=storage, seeds=[0]))
    run_file(study, storage=storage, seeds=[0])
    match = re.fullmatch(r"size: about ([0-9.]+) kB", size)
    assert match
    written = sum(file.stat().st_size for file in (tmp_path / "out" / "cases").glob("*/*"))
    assert float(match[1]) * 1e3 == pytest.approx(written, rel=0.5)
