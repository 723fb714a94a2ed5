"""The study of the paper, from equations to report, against the recorded figures."""

import csv
import io
import json
import re
import shutil
import subprocess
from base64 import b64decode
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ddpc_cosim import StudyResults, load_results

from .recomputed import figures_of, verdict

# What its fixtures run or build is run and built in one process.
pytestmark = pytest.mark.xdist_group("paper")

DATA = Path(__file__).parents[1] / "data"
Run = Callable[..., subprocess.CompletedProcess[str]]

# Wall-clock times differ from run to run, and with them what is counted from them.
TIMED = ("solve_time", "deadline_misses")


@pytest.fixture(scope="module")
def first_run(program: str, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Run the study on the data of the paper's seed as a user would; return folder and printed text."""
    folder = tmp_path_factory.mktemp("empty")
    done = subprocess.run(
        [program, "run", "paper", "--seeds", "5489", "--jobs", "2"],
        cwd=folder,
        capture_output=True,
        text=True,
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stderr
    return folder / "runs" / "paper", done.stdout


@pytest.fixture(scope="module")
def results(first_run: tuple[Path, str]) -> StudyResults:
    return load_results(first_run[0])


def figures(results: StudyResults, controller: str, metric: str) -> list[float]:
    """Return a figure of all cases of a controller, in the order of the seeds."""
    cases = [case for case in results.cases if case.controller == controller]
    return [next(v for k, v in case.metrics.items() if k.startswith(f"{metric}.")) for case in cases]


def timeless(metrics: dict[str, float]) -> dict[str, float]:
    return {key: value for key, value in metrics.items() if not key.startswith(TIMED)}


def test_one_command_writes_everything(first_run: tuple[Path, str]) -> None:
    folder, printed = first_run
    for name in ("report.html", "metrics.csv", "study.toml", "provenance.json"):
        assert (folder / name).stat().st_size > 0
    assert Path(printed.splitlines()[-1]) == Path("runs/paper/report.html")
    for label in ("MFAPC-CFDL", "DeePC", "WKPC", "DeePC, published code", "WKPC, published code"):
        assert any(f" {label} " in line for line in printed.splitlines())
    assert "failed" not in printed
    with (folder / "metrics.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["outcome"] for row in rows] == ["completed"] * 7
    assert len(list((folder / "cases").iterdir())) == 8  # with that of doing nothing


@pytest.mark.parametrize(
    ("controller", "metric", "expected", "tolerance"),
    [
        ("deepc", "sum_abs_error", 456.08, 0.05),
        ("deepc-published-code", "sum_abs_error", 648.07, 0.05),
        ("mfapc", "max_abs_input", 3.3594, 0.0005),
        ("mfapc", "sum_abs_error", 711.15, 0.3),
    ],
)
def test_figures_of_the_paper_and_of_the_authors_programs(
    results: StudyResults, controller: str, metric: str, expected: float, tolerance: float
) -> None:
    (actual,) = figures(results, controller, metric)
    assert actual == pytest.approx(expected, abs=tolerance)


NAMES = {
    "mean_abs_error.angle [deg]": "mean absolute error of angle (°)",
    "rmse.angle [deg]": "RMSE of angle (°)",
    "settled_error.angle [deg]": "settled error of angle (°)",
    "overshoot.angle [%]": "overshoot of angle (%)",
    "rise_time.angle [s]": "rise time of angle (s)",
    "settling_time.angle [s]": "settling time of angle (s)",
}


def test_figures_in_files_and_report_are_those_of_the_samples(
    first_run: tuple[Path, str], results: StudyResults
) -> None:
    page = (first_run[0] / "report.html").read_text(encoding="utf-8")
    (packed,) = re.findall(r'download="cases.csv" href="data:text/csv[^,]*,([^"]+)"', page)
    shown = csv.DictReader(io.StringIO(b64decode(packed).decode()))
    assert results.provenance["largest preview"] == "5 samples"
    rows = {row["Controller"]: row for row in shown}
    for case in results.cases:
        row = rows[case.label]
        figures = figures_of(case.folder, 5)
        assert (case.failed, case.settles) == verdict(case.folder, 5)
        assert not case.failed
        assert {key: case.metrics[key] for key in figures} == pytest.approx(figures, abs=1e-9, nan_ok=True)
        actual = {key: float(row[name] or "nan") for key, name in NAMES.items()}
        assert actual == pytest.approx({key: figures[key] for key in NAMES}, abs=1e-9, nan_ok=True)


@pytest.mark.parametrize(
    ("controller", "settled", "overshoot", "rise", "settling"),
    [
        ("mfapc", 0.0050, 1.75, 1.9, 3.1),
        ("mfapc-lambda-025", 0.0306, 9.45, 1.1, 6.3),
        ("mfapc-lambda-070", 0.0841, 0.0, 3.1, 4.3),
        ("deepc", 0.688, 0.0, 0.35, 0.8),
        ("wkpc", 0.583, 17.8, 0.0, 1.2),
    ],
)
def test_figures_of_the_response_on_the_papers_seed(
    results: StudyResults, controller: str, settled: float, overshoot: float, rise: float, settling: float
) -> None:
    assert figures(results, controller, "settled_error") == [pytest.approx(settled, rel=2e-3, abs=5e-5)]
    assert figures(results, controller, "overshoot") == [pytest.approx(overshoot, rel=2e-3, abs=5e-3)]
    assert figures(results, controller, "rise_time") == [pytest.approx(rise)]
    assert figures(results, controller, "settling_time") == [pytest.approx(settling)]


@pytest.mark.parametrize(
    ("controller", "file", "rest_rows", "torque_tolerance"),
    [
        ("deepc-published-code", "deepc_published_code.csv", 0, 1e-6),
        ("mfapc", "mfapc_published_code.csv", 1, 1e-5),
    ],
)
def test_trajectories_of_the_authors_programs(
    results: StudyResults, controller: str, file: str, rest_rows: int, torque_tolerance: float
) -> None:
    """Through FMU, workers and files the loop is still the recorded one, row by row."""
    recorded = np.genfromtxt(DATA / file, delimiter=",", names=True)[rest_rows:]
    _, _, angle, torque = recorded.dtype.names or ()
    (case,) = (case for case in results.cases if case.controller == controller)
    trace = case.trace()
    rows = slice(0, len(recorded))
    assert len(trace) == 401
    assert np.abs(np.degrees(trace.y[rows, 0]) - recorded[angle]).max() < 1e-5
    assert np.abs(trace.u[rows, 0] - recorded[torque]).max() < torque_tolerance


def test_the_notes_on_the_authors_programs_are_recomputed(results: StudyResults) -> None:
    reproduction = results.study.report.reproduction
    assert reproduction is not None
    notes = " ".join(reproduction.notes)
    for file, column, printed in (("deepc", 0, "0.2464"), ("mfapc", 1, "0.00077326")):
        rows = np.loadtxt(DATA / f"{file}_published_code.csv", delimiter=",", skiprows=1)
        error = np.abs(rows[:, 1] - rows[:, 2])
        assert f"{error.min():.5g} " in notes
        assert f"{error.sum():.4f} " in notes
        assert printed in notes
        published = [method.values for method in reproduction.methods if method.rest_samples == column]
        assert float(printed) in [values["min_abs_error.angle [deg]"] for values in published]


def test_the_published_sum_compares_with_the_one_that_counts_the_sample_at_rest(
    first_run: tuple[Path, str], results: StudyResults
) -> None:
    page = (first_run[0] / "report.html").read_text(encoding="utf-8")
    row = page[page.index("1 sample at rest counted too, as published") :]
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", row[: row.index("</tr>")])
    (sum_here,) = figures(results, "mfapc", "sum_abs_error")
    assert cells[1] == "730.4181"
    assert cells[3] == f"{sum_here + 20.0:.4f}"
    assert cells[7] == f"+{100 * ((sum_here + 20.0) / 730.4181 - 1):.1f}\N{NO-BREAK SPACE}%"


def test_the_written_study_runs_again_to_the_same_cases(
    first_run: tuple[Path, str], results: StudyResults, run_program: Run, tmp_path: Path
) -> None:
    """With one worker in place of two: signals are the same to the last bit."""
    shutil.copy(first_run[0] / "study.toml", tmp_path / "again.toml")
    done = run_program("run", "again.toml", "--out", "out", "--jobs", "1", "--no-report")
    assert done.returncode == 0, done.stderr
    again = load_results(tmp_path / "out")
    assert [case.id for case in again.cases] == [case.id for case in results.cases]
    assert again.study == results.study
    for before, after in zip(results.cases, again.cases, strict=True):
        assert json.dumps(timeless(before.metrics)) == json.dumps(timeless(after.metrics))
        first, second = before.trace(), after.trace()
        for name in ("time", "reference", "y", "measured", "u"):
            assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


def test_the_report_can_be_rebuilt(first_run: tuple[Path, str], run_program: Run, tmp_path: Path) -> None:
    done = run_program("report", str(first_run[0]), "--out", "report.html")
    assert (done.returncode, done.stdout) == (0, "report.html\n")
    assert (tmp_path / "report.html").stat().st_size == (first_run[0] / "report.html").stat().st_size


@pytest.mark.slow
def test_one_seed_decides_nothing(run_program: Run, tmp_path: Path) -> None:
    """Over seeds 0..29 the published DeePC spans 256..1038, and WKPC's spans its published figure."""
    names = ("deepc-published-code", "wkpc-published-code", "mfapc")
    done = run_program("run", "paper", *(f"--only={name}" for name in names))
    assert done.returncode == 0, done.stderr
    results = load_results(tmp_path / "runs" / "paper")
    assert len(results.cases) == 3 * 31
    assert results.cases[0].seed == 5489
    deepc = figures(results, "deepc-published-code", "sum_abs_error")[1:]
    assert (min(deepc), max(deepc)) == pytest.approx((256.0, 1038.0), abs=1.0)
    wkpc = figures(results, "wkpc-published-code", "sum_abs_error")[1:]
    assert min(wkpc) < 456.3552 < max(wkpc)
    mfapc = figures(results, "mfapc", "sum_abs_error")
    assert len(set(mfapc)) == 1
