"""Where a case runs: in a temporary folder of its own, whose files are told, and kept on request."""

from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner
from fmus.builder import Fault
from studies import run_file

from ddpc_cosim import ConfigError, StudyResults
from ddpc_cosim.cli.main import main
from ddpc_cosim.study.case_files import LEFT_FOLDER, left_in, read_run
from ddpc_cosim.study.runner import Selection

pytestmark = pytest.mark.xdist_group("working directory")

WRITER = """
import os
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from ddpc_cosim import Controller, setting, study_folder

GAIN = float((study_folder() / "gain.txt").read_text())

@dataclass(kw_only=True)
class Writes(Controller):
    crashes: bool = setting(False, doc="crashes")
    def start(self, loop):
        assert os.environ["DDPC_COSIM_STUDY_FOLDER"] == str(study_folder())
        assert not any(Path().iterdir())
        Path("notes").mkdir()
        Path("notes", "log.txt").write_text("x" * int(loop.rng.integers(100, 10**6)))
        if os.name == "posix":
            Path("notes", "elsewhere").symlink_to("/etc/passwd")
    def step(self, sample):
        if self.crashes and sample.k == 3:
            os.abort()
        return GAIN * np.ones(1)
"""


@pytest.fixture
def study(
    write_study: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Path]:
    """Write a study into a folder that is not the current one, whose FMU writes a file by a relative path."""
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setenv("FAULT_FILE", "written.dat")

    def write(*controllers: str, **settings: str) -> Path:
        path = write_study(*controllers, seeds="[0, 1]", fault=Fault.WRITE_A_FILE)
        (tmp_path / "writing.py").write_text(WRITER, encoding="utf-8")
        (tmp_path / "gain.txt").write_text("0.5", encoding="utf-8")
        more = "".join(f"[controllers.{name}.settings]\n{text}\n" for name, text in settings.items())
        path.write_text(path.read_text() + more, encoding="utf-8")
        return path

    return write


def run(path: Path, **selection: bool) -> StudyResults:
    return run_file(path, jobs=2, **selection)


def test_files_of_a_case_are_its_own(study: Callable[..., Path], tmp_path: Path) -> None:
    """An FMU's and a controller's: none of them lies beside the user's, and a case finds no other's."""
    results = run(study("writing:Writes"))
    assert [case.outcome for case in results.cases] == ["completed"] * 2
    assert [*Path.cwd().iterdir()] == []
    assert {path.name for path in tmp_path.rglob("*.dat")} == set()
    sizes = []
    for case in results.cases:
        left = read_run(case.folder)["left"]
        sizes.append(left.pop("notes/log.txt"))
        assert left.pop("written.dat") == 0
        assert set(left) <= {"notes/elsewhere"}
        assert not (case.folder / LEFT_FOLDER).exists()
    assert sizes[0] != sizes[1]


def test_they_are_kept_on_request(study: Callable[..., Path]) -> None:
    """Also of a case that crashes; links are not."""
    path = study("mfapc", "writing:Writes", writes="crashes = true")
    results = run(path, keep_files=True)
    assert [case.outcome for case in results.cases] == ["completed"] * 2 + ["crashed"] * 2
    for case in results.cases:
        left = read_run(case.folder)["left"]
        kept = case.folder / LEFT_FOLDER
        sizes = {p.relative_to(kept).as_posix(): p.stat().st_size for p in kept.rglob("*") if p.is_file()}
        assert sizes == {name: size for name, size in left.items() if name != "notes/elsewhere"}
        expected = {"notes/log.txt"} if case.outcome == "crashed" else {"written.dat"}
        assert set(sizes) == expected
    again = run(path)  # which keeps the cases that are there, with all that is in their folders
    assert all((case.folder / LEFT_FOLDER).is_dir() for case in again.cases[:2])


def test_by_the_command(study: Callable[..., Path], tmp_path: Path) -> None:
    arguments = [str(study("mfapc")), "--out", str(tmp_path / "out"), "--no-report", "--keep-files"]
    done = CliRunner().invoke(main, ["run", *arguments, "--seeds", "0"])
    assert done.exit_code == 0, done.output
    assert [path.parent.name for path in (tmp_path / "out").rglob("written.dat")] == [LEFT_FOLDER] * 2
    assert [*Path.cwd().iterdir()] == []


def test_not_from_a_cluster() -> None:
    with pytest.raises(ConfigError, match="--keep-files: not with --executor dask"):
        Selection(executor="dask", scheduler="tcp://host:1", keep_files=True)


def test_of_many_files_some_are_named(tmp_path: Path) -> None:
    for number in range(150):
        (tmp_path / f"{number:03}").write_bytes(b"xy")
    left = left_in(tmp_path)
    assert len(left) == 101
    assert left["099"] == 2
    assert left["and 50 more"] == 100
