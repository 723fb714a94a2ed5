"""The sandbox: what an FMU may not do in it; all else is as without. Where there is none, that is told."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fmus.builder import Fault

from ddpc_cosim import ConfigError, FMUPlant, FMUStepError, load_results
from ddpc_cosim.processes.sandbox import missing
from ddpc_cosim.study.case_files import read_run

MakeFMU = Callable[..., Path]
WriteStudy = Callable[..., Path]
Run = Callable[..., subprocess.CompletedProcess[str]]

IS_HERE = not missing()
FORBIDDEN = {
    Fault.WRITE_A_FILE: "the file cannot be opened",
    Fault.READ_A_FILE: "the file cannot be opened",
    Fault.OPEN_A_SOCKET: "there is no network",
}


@pytest.fixture
def secret(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of the user's, which the FMU knows."""
    folder = tmp_path / "home/.ssh"
    folder.mkdir(parents=True)
    path = folder / "id_ed25519"
    path.write_text("secret", encoding="utf-8")
    monkeypatch.setenv("FAULT_FILE", str(path))
    return path


@pytest.mark.parametrize("fault", FORBIDDEN)
def test_what_an_fmu_may_not_do(fault: Fault, secret: Path, make_fmu: MakeFMU) -> None:
    """It may without a sandbox; where the system has none, no process is started without."""
    path = make_fmu(fault)
    with FMUPlant(path, isolated=True) as plant:
        plant.reset()
        plant.step(np.ones(1), 1.0)
        plant.step(np.ones(1), 1.0)
    secret.write_text("secret", encoding="utf-8")
    if not IS_HERE:
        with pytest.raises(ConfigError, match="the sandbox is not possible on this system: it needs "):
            FMUPlant(path, isolated=True, sandbox=True)
        return
    with FMUPlant(path, isolated=True, sandbox=True) as plant:
        plant.reset()
        plant.step(np.ones(1), 0.5)
        with pytest.raises(FMUStepError, match=FORBIDDEN[fault]):
            plant.step(np.ones(1), 1.0)
        assert plant.provenance()["sandbox"].startswith("no_new_privs; Landlock ")
    assert secret.read_text(encoding="utf-8") == "secret"


def test_a_study_in_the_sandbox(
    secret: Path, write_study: WriteStudy, tmp_path: Path, run_program: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Signals are the same bit for bit, and each case says where it ran; the id does not."""
    write_study("mfapc", "pid", seeds="[0, 1]")
    free = run_program("run", "study.toml", "--jobs", "1", "--no-report", "--out", "free")
    held = run_program("run", "study.toml", "--jobs", "2", "--no-report", "--out", "held", "--sandbox")
    if not IS_HERE:
        assert held.returncode == 2
        assert held.stderr.splitlines()[-1].startswith(
            "error: the sandbox is not possible on this system: it needs "
        )
        assert not (tmp_path / "held").exists()
        return
    assert (free.returncode, held.returncode) == (0, 0), free.stderr + held.stderr
    without, within = (load_results(tmp_path / name) for name in ("free", "held"))
    for case, other in zip(without.cases, within.cases, strict=True):
        assert case.id == other.id
        assert case.sandbox == ""
        assert other.sandbox.startswith("no_new_privs; Landlock ")
        for name in ("time", "reference", "y", "u", "status"):
            np.testing.assert_array_equal(getattr(case.trace(), name), getattr(other.trace(), name))
    assert without.provenance["sandbox"] == "none"
    assert within.provenance["sandbox"] == f"4 of 4 cases: {within.cases[0].sandbox}"
    assert read_run(within.cases[0].folder)["sandbox"] == within.cases[0].sandbox
    again = run_program("run", "study.toml", "--no-report", "--out", "free", "--sandbox")
    assert "0 cases to run, 6 kept" in again.stderr


@pytest.mark.parametrize("command", ["check", "init", "simulate"])
def test_commands_that_run_an_fmu(command: str, secret: Path, make_fmu: MakeFMU, run_program: Run) -> None:
    path = make_fmu(Fault.WRITE_A_FILE)
    done = run_program(command, path.name, "--sandbox")
    if not IS_HERE:
        assert (done.returncode, done.stdout) == (2, "")
        assert "the sandbox is not possible on this system: it needs " in done.stderr
        return
    assert done.returncode == 1
    assert "the file cannot be opened" in done.stdout + done.stderr
    assert secret.read_text(encoding="utf-8") == "secret"


def test_one_in_this_process_cannot_be_put_into_it(make_fmu: MakeFMU) -> None:
    with pytest.raises(ConfigError, match="sandbox = True needs isolated = True"):
        FMUPlant(make_fmu(), sandbox=True)


def test_a_system_without_it_says_what_is_missing(make_fmu: MakeFMU, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("platform.machine", lambda: "riscv64")
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(ConfigError, match="it needs the processor riscv64; known: x86_64, aarch64"):
        FMUPlant(make_fmu(), isolated=True, sandbox=True)
