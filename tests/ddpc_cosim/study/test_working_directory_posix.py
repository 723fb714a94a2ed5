"""What a case may leave in its working directory on POSIX: folders of any depth, links, and pipes."""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
from studies import run_file

from ddpc_cosim.processes.scratch import remove
from ddpc_cosim.study.case_files import LEFT_FOLDER, keep_left, left_in, read_run

DIGGER = """
import os
from dataclasses import dataclass
import numpy as np
from ddpc_cosim import Controller

@dataclass(kw_only=True)
class Digs(Controller):
    def start(self, loop):
        here = os.getcwd()
        for depth in range(3000):
            os.mkdir("d")
            os.chdir("d")
            if depth % 40 == 0:
                open("file", "w").close()
        os.chdir(here)
        for _ in range(30):
            os.mkdir("b" * 200)
            os.chdir("b" * 200)
            open("c" * 200, "w").close()
        os.chdir(here)
    def step(self, sample):
        return np.ones(1)
"""


@pytest.mark.parametrize("keep_files", [False, True])
def test_folders_that_are_too_deep(
    write_study: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    keep_files: bool,
) -> None:
    """They cost neither their case nor another, are told as far as one goes, and do not stay."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    (tmp_path / "digging.py").write_text(DIGGER, encoding="utf-8")
    path = write_study("digging:Digs", "mfapc")
    try:
        results = run_file(path, jobs=2, keep_files=keep_files)
        assert [case.outcome for case in results.cases] == ["completed", "completed"]
        folder = results.cases[0].folder
        left, nested = read_run(folder)["left"], "d/" * 50
        assert left["d/file"] == left["d/" * 41 + "file"] == 0
        assert f"{nested}d/" in left
        assert ("b" * 200 + "/") * 2 + "c" * 200 in left
        assert (folder / LEFT_FOLDER).exists() is keep_files
        assert not any(temporary.glob("*/**/d"))
        assert not keep_files or (folder / LEFT_FOLDER / ("d/" * 41) / "file").exists()
    finally:
        remove(tmp_path)


def test_what_cannot_be_kept_is_listed(tmp_path: Path) -> None:
    (tmp_path / "work").mkdir()
    os.mkfifo(tmp_path / "work" / "pipe")
    (tmp_path / "work" / "link").symlink_to("/etc/passwd")
    (tmp_path / "work" / "file").write_bytes(b"xy")
    assert set(left_in(tmp_path / "work")) == {"pipe", "link", "file"}
    keep_left(tmp_path / "work", tmp_path / "case")
    assert [path.name for path in (tmp_path / "case" / LEFT_FOLDER).iterdir()] == ["file"]
