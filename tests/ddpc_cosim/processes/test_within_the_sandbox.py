"""What a process in the sandbox may and may not do, asked of it."""

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ddpc_cosim.processes.sandbox import Sandbox
from ddpc_cosim.processes.worker import LONGEST_REPLY, UnexpectedError, Worker, ask, result_of, serve_calls


def test_limits_of_another_process_are_its_own(tmp_path: Path) -> None:
    """One of CPU time would end it, which is a signal by another name."""
    import resource

    def called(function: Callable[..., Any], *arguments: Any) -> Any:
        ask(worker.channel, function, *arguments)
        return result_of(worker.channel.receive(LONGEST_REPLY))

    limits = resource.getrlimit(resource.RLIMIT_CPU)
    worker = Worker(serve_calls, folder=tmp_path, sandbox=Sandbox((tmp_path,)))
    try:
        with pytest.raises(UnexpectedError, match="PermissionError"):
            called(resource.prlimit, os.getpid(), resource.RLIMIT_CPU, limits)
        called(resource.setrlimit, resource.RLIMIT_CPU, (600, limits[1]))
        assert called(resource.getrlimit, resource.RLIMIT_CPU) == [600, limits[1]]
    finally:
        worker.end()


@pytest.mark.parametrize("holds_temporary_files", [True, False])
def test_the_import_path_opens_no_temporary_files(
    holds_temporary_files: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where a script lies beside them, whose folder is on the import path."""
    module, own = tmp_path / "module.py", tmp_path / "own"
    module.write_text("", encoding="utf-8")
    own.mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    if not holds_temporary_files:
        own = Path(tempfile.mkdtemp())
    worker = Worker(serve_calls, folder=own, sandbox=Sandbox((own,)))
    try:
        ask(worker.channel, os.listdir, str(tmp_path))
        answer = worker.channel.receive(LONGEST_REPLY)
        if not holds_temporary_files:
            assert "module.py" in result_of(answer)
        else:
            with pytest.raises(UnexpectedError, match="PermissionError"):
                result_of(answer)
    finally:
        worker.end()
        shutil.rmtree(own)
