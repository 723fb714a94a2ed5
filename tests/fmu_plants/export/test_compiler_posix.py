"""A compiler that hangs; it is a shell script here."""

import subprocess

import pytest

from fmu_plants import ExportError
from fmu_plants.export.compiler import Compiler


def test_a_compiler_that_hangs_is_ended_with_all_that_it_has_started(tmp_path, monkeypatch):
    started, program = tmp_path / "started", tmp_path / "cc"
    program.write_text(
        f"#!/bin/sh\nsleep 1000 &\necho $! $$ > {started}.part\nmv {started}.part {started}\nwait\n"
    )
    program.chmod(0o700)

    def hang(process, timeout):
        while not started.exists():
            assert process.poll() is None
        raise subprocess.TimeoutExpired(process.args, timeout)

    monkeypatch.setattr(subprocess.Popen, "communicate", hang)
    with pytest.raises(ExportError, match=r"cc did not end within 600 s and was ended, .* set CC to another"):
        Compiler((str(program),), "").run(["model.c"], tmp_path)
    monkeypatch.undo()
    assert not [pid for pid in started.read_text().split() if is_running(pid)]


def is_running(pid):
    """Whether a process is there that is not just waiting to be forgotten."""
    done = subprocess.run(["ps", "-o", "stat=", "-p", pid], stdout=subprocess.PIPE, text=True)
    return done.stdout.strip()[:1] not in ("", "Z")
