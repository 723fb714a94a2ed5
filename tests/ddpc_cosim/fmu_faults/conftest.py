"""The misbehaving FMU, built once, and a folder that takes all temporary files."""

import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from fmus.builder import integrator_files, write_archive

# Signals and permissions are matters of POSIX.
collect_ignore = ["test_posix.py", "test_leftovers.py"] if sys.platform == "win32" else []

Files = Mapping[str, bytes]


@pytest.fixture(scope="session")
def files() -> Files:
    """The files of the misbehaving FMU for FMI 2.0."""
    return integrator_files("2.0")


@pytest.fixture(scope="session")
def faulty_fmus(files: Files, tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """The misbehaving FMU by FMI version."""
    folder = tmp_path_factory.mktemp("faulty")
    return {
        2: write_archive(folder / "faulty2.fmu", files),
        3: write_archive(folder / "faulty3.fmu", integrator_files("3.0")),
    }


@pytest.fixture
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that takes all temporary files, of child processes too."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    for name in ("TMPDIR", "TEMP", "TMP"):
        monkeypatch.setenv(name, str(folder))
    return folder


@pytest.fixture
def nothing_left(scratch: Path) -> Iterator[None]:
    """Check that the test leaves no temporary files and no changed working directory behind."""
    here = Path.cwd()
    yield
    assert Path.cwd() == here
    assert list(scratch.iterdir()) == []
