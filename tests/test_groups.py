"""Tests of one group share a process, and with it what their fixtures have run and built."""

import os

import pytest


@pytest.mark.xdist_group("one process")
@pytest.mark.parametrize("number", range(8))
def test_tests_of_one_group_run_in_one_process(number: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent
    processes = shared / "processes-of-a-group"
    (processes / str(os.getpid())).mkdir(parents=True, exist_ok=True)
    assert len([*processes.iterdir()]) == 1
