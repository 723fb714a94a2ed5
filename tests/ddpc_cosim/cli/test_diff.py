"""``ddpc-cosim diff``: what differs, what does not count, and the exit codes."""

import math
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from hypothesis import given, strategies as st

from ddpc_cosim import load_results
from ddpc_cosim.cli.main import main
from ddpc_cosim.study.agreement import _excess
from ddpc_cosim.study.case_files import write_case

WriteStudy = Callable[..., Path]
Run = Callable[..., subprocess.CompletedProcess[str]]


def diff(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["diff", *map(str, arguments)])


@pytest.fixture
def folders(write_study: WriteStudy, run_program: Run, tmp_path: Path) -> tuple[Path, Path]:
    """The results of a study, and a copy."""
    write_study("mfapc", "pid", seeds="[0, 1]")
    done = run_program("run", "study.toml", "--jobs", "1", "--no-report", "--out", "a")
    assert done.returncode == 0, done.stderr
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    return tmp_path / "a", tmp_path / "b"


def test_two_runs_of_one_study_agree(folders: tuple[Path, Path], run_program: Run) -> None:
    """Computation times differ, and do not count; nor does the kind of file."""
    run_program("run", "study.toml", "--no-report", "--fresh", "--out", "b", "--storage", "parquet")
    assert len([*folders[1].glob("cases/*/signals.parquet")]) == 6
    done = diff(*folders, "--abs", "0", "--rel", "0")
    assert (done.exit_code, done.stdout) == (0, "4 of 4 cases agree within max(0, 0 of the larger value)\n")


def test_a_page_of_the_differences_is_written_and_changes_no_exit_code(folders: tuple[Path, Path]) -> None:
    page = folders[0].parent / "d.html"
    done = diff(*folders, "--html", page)
    assert (done.exit_code, done.stdout.splitlines()[-1]) == (0, str(page))
    assert "figures that controllers are ranked by are the same" in page.read_text(encoding="utf-8")
    shutil.rmtree(next((folders[1] / "cases").glob("pid_*")))
    assert diff(*folders, "--html", page).exit_code == 2
    assert diff(*folders, "--html", page.parent / "nowhere.txt" / "d.html").exit_code == 2


def test_what_differs_is_told(
    folders: tuple[Path, Path], write_study: WriteStudy, run_program: Run, tmp_path: Path
) -> None:
    text = (tmp_path / "study.toml").read_text(encoding="utf-8")
    changed = text.replace('type = "pid"', 'type = "pid"\nsettings = { proportional = 1.001 }')
    assert changed != text
    (tmp_path / "study.toml").write_text(changed, encoding="utf-8")
    done = run_program("run", "study.toml", "--jobs", "1", "--no-report", "--seeds", "0,1,2", "--out", "c")
    assert done.returncode == 0, done.stderr
    done = diff(folders[0], tmp_path / "c")
    assert done.exit_code == 1
    head, *lines = done.stdout.splitlines()
    assert head == "2 of 6 cases agree within max(1e-09, 1e-06 of the larger value)"
    assert [line.rpartition("_")[0] for line in (line.partition(":")[0] for line in lines)] == [
        "pid_seed0",
        "pid_seed1",
        "mfapc_seed2",
        "pid_seed2",
    ]
    assert all(line.endswith(f"only in {tmp_path / 'c'}") for line in lines[2:])
    assert " other " in lines[0]
    assert diff(folders[0], tmp_path / "c", "--abs", "1e9").stdout.startswith("4 of 6 cases agree")


def test_the_sample_that_differs_most_is_named(folders: tuple[Path, Path]) -> None:
    case = next((folders[1] / "cases").glob("mfapc_seed0*"))
    result = next(candidate for candidate in load_results(folders[1]).cases if candidate.id == case.name)
    trace = result.trace()
    before = trace.u[5, 0]
    trace.u[5, 0] = before + 100.0
    keys = ("id", "controller", "label", "scenario", "seed")
    write_case(case, trace, {key: getattr(result, key) for key in keys})
    output = diff(*folders, "--abs", "99", "--rel", "0").stdout
    assert output.startswith("3 of 4 cases agree")
    assert f"u [1] at t = 0.5 s is {before:.9g}, other {before + 100:.9g}" in output


NUMBERS = st.floats(-1e6, 1e6) | st.sampled_from([math.nan, math.inf, -math.inf, 0.0])


@given(st.lists(st.tuples(NUMBERS, NUMBERS), max_size=8), st.floats(0, 10), st.floats(0, 2))
def test_values_agree_within_the_larger_tolerance(
    pairs: list[tuple[float, float]], absolute: float, relative: float
) -> None:
    """Against the rule, value by value: what both lack agrees, what one lacks does not."""

    def agree(value: float, other: float) -> bool:
        if math.isnan(value) or math.isnan(other) or math.isinf(value) or math.isinf(other):
            return value == other or (math.isnan(value) and math.isnan(other))
        return value == other or abs(value - other) <= max(absolute, relative * max(abs(value), abs(other)))

    values, other = (np.array([pair[i] for pair in pairs], dtype=float) for i in (0, 1))
    excess, k = _excess(values, other, absolute, relative)
    wrong = [i for i, pair in enumerate(pairs) if not agree(*pair)]
    assert (excess > 1.0) == bool(wrong)
    assert not wrong or k in wrong


def test_folders_that_cannot_be_compared(folders: tuple[Path, Path], tmp_path: Path) -> None:
    assert diff(folders[0], tmp_path / "nowhere").exit_code == 2
    signals = next(folders[1].glob("cases/*/signals.csv"))
    signals.write_text(signals.read_text(encoding="utf-8")[:-20], encoding="utf-8")
    done = diff(*folders)
    assert done.exit_code == 2
    assert "damaged" in done.stderr
    shutil.rmtree(folders[1] / "cases")
    assert diff(*folders).stderr.count("error: ") == 6
    for value in ("nan", "-1"):
        assert diff(*folders, "--rel", value).exit_code == 2
