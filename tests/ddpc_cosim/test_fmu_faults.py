"""FMUs that cannot be loaded, and FMUs that misbehave during a run."""

import re
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from fmus.builder import Fault

from ddpc_cosim import (
    ConfigError,
    Constant,
    Controller,
    FMUImportError,
    FMUPlant,
    FMUStepError,
    Loop,
    Outcome,
    Sample,
    Trace,
    cosimulate,
)

MakeFMU = Callable[..., Path]
H = 0.1


@dataclass(kw_only=True)
class One(Controller):
    """Always 1."""

    def start(self, loop: Loop) -> None:
        pass

    def step(self, sample: Sample) -> np.ndarray:
        return np.ones(1)


def close_loop(path: Path) -> Trace:
    with FMUPlant(path, outputs=["y"]) as plant:
        return cosimulate(plant, One(), sampling_time=H, duration=1.0, reference=Constant(0.0))


@pytest.fixture
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that takes all temporary files."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def empty_zip(path: Path) -> Path:
    zipfile.ZipFile(path, "w").close()
    return path


CANNOT_BE_LOADED: dict[str, tuple[Callable[[Path, MakeFMU], Path], str]] = {
    "no file": (lambda p, _: p / "x.fmu", r"x\.fmu: no such file"),
    "a folder": (lambda p, _: p, r"no such file"),
    "no archive": (lambda p, _: write(p / "x.fmu", b"text"), r"x\.fmu: not an FMU: File is not a zip file"),
    "empty archive": (lambda p, _: empty_zip(p / "x.fmu"), r"x\.fmu: .*no modelDescription\.xml"),
    "no description": (lambda _, make: make(description=""), r"no_fault\.fmu: .*no modelDescription\.xml"),
    "broken XML": (
        lambda _, make: make(description="<fmiModelDescription"),
        r"no_fault\.fmu: modelDescription\.xml cannot be read",
    ),
    "another XML": (
        lambda _, make: make(description="<a/>"),
        r"no_fault\.fmu: modelDescription\.xml cannot be read",
    ),
    "FMI 1": (lambda _, make: make(version="1.0"), r"no_fault\.fmu: modelDescription"),
    "FMI 3": (
        lambda _, make: make(version="3.0"),
        r"no_fault\.fmu: modelDescription",
    ),
    "neither type": (
        lambda _, make: make(interfaces=""),
        r"no_fault\.fmu: modelDescription\.xml: neither Co-Simulation nor Model Exchange",
    ),
    "another platform": (
        lambda _, make: make(platform="amiga"),
        r"no_fault\.fmu: no binary for this platform \(binaries/.*\); it has binaries for: amiga\. Export",
    ),
    "no library": (lambda _, make: make(library=b"text"), r"no_fault\.fmu: cannot be instantiated: "),
    "no instance": (
        lambda _, make: make(Fault.NO_INSTANCE),
        r"no_instance\.fmu: cannot be instantiated: .*licence 42 has expired",
    ),
}


@pytest.mark.parametrize("case", CANNOT_BE_LOADED)
def test_an_fmu_that_cannot_be_loaded(
    case: str, tmp_path: Path, make_fmu: MakeFMU, scratch: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The error names file and reason, and neither files nor a changed folder stay behind."""
    make, words = CANNOT_BE_LOADED[case]
    path, here = make(tmp_path, make_fmu), Path.cwd()

    def load() -> None:
        with FMUPlant(path) as plant:
            plant.reset()

    with pytest.raises(FMUImportError) as caught:
        load()
    assert re.search(words, str(caught.value)), str(caught.value)
    assert Path.cwd() == here
    assert list(scratch.iterdir()) == []
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize(
    ("fault", "outcome", "reason"),
    [
        (
            Fault.RETURN_ERROR,
            Outcome.FMU_ERROR,
            "return_error.fmu: fmi2DoStep returned error at t = 0.5 s; [error] division by zero",
        ),
        (
            Fault.ERROR_WHEN_READ,
            Outcome.FMU_ERROR,
            "error_when_read.fmu: fmi2GetReal returned error at t = 0.5 s",
        ),
        (
            Fault.RETURN_ILLEGAL,
            Outcome.FMU_ERROR,
            "return_illegal.fmu: fmi2DoStep returned illegal status 17 at t = 0.5 s",
        ),
        (
            Fault.RETURN_DISCARD,
            Outcome.FMU_DISCARDED,
            "return_discard.fmu: fmi2DoStep returned discard at t = 0.5 s",
        ),
        (
            Fault.DISCARD_AND_TERMINATE,
            Outcome.TERMINATED,
            "discard_and_terminate.fmu: fmi2DoStep ended the simulation at t = 0.5 s; "
            "the FMU asks to terminate",
        ),
        (Fault.RETURN_FATAL, Outcome.FMU_FATAL, "return_fatal.fmu: fmi2DoStep returned fatal at t = 0.5 s"),
        (Fault.RETURN_NAN, Outcome.DIVERGED, "output y is nan at t = 0.6 s"),
    ],
)
def test_a_fault_ends_the_run_and_keeps_its_samples(
    make_fmu: MakeFMU, fault: Fault, outcome: Outcome, reason: str
) -> None:
    trace = close_loop(make_fmu(fault))
    rows = 5 if fault is Fault.ERROR_WHEN_READ else 6
    assert (trace.outcome, trace.reason) == (outcome, reason)
    assert not trace.completed
    assert np.allclose(trace.y[:, 0], np.arange(rows) * H)
    assert trace.planned_samples == 11
    assert trace.metrics()["samples [1]"] == rows


@pytest.mark.parametrize(
    "fault", [Fault.NO_FAULT, Fault.RETURN_WARNING, Fault.WARNING_WHEN_SET, Fault.LOG_AT_EVERY_STEP]
)
def test_warnings_and_messages_do_not_end_a_run(
    make_fmu: MakeFMU, fault: Fault, capfd: pytest.CaptureFixture[str]
) -> None:
    trace = close_loop(make_fmu(fault))
    assert trace.completed
    assert np.allclose(trace.y[:, 0], np.arange(11) * H)
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize(
    ("fault", "last_calls"),
    [
        (Fault.NO_FAULT, ["step", "terminate", "free"]),
        (Fault.RETURN_DISCARD, ["step", "terminate", "free"]),
        (Fault.RETURN_ERROR, ["step", "free"]),
        (Fault.RETURN_FATAL, ["step"]),
    ],
)
def test_only_what_the_standard_allows_is_called_after_a_fault(
    make_fmu: MakeFMU, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: Fault, last_calls: list[str]
) -> None:
    """FMI 2.0, section 4.2.4: no fmi2Terminate after an error, nothing at all after fmi2Fatal."""
    calls = tmp_path / "calls"
    monkeypatch.setenv("FAULTY_FMU_CALLS", str(calls))
    close_loop(make_fmu(fault))
    noted = calls.read_text(encoding="utf-8").split()
    assert noted[len(noted) - 1 - noted[::-1].index("step") :] == last_calls


def test_an_error_of_the_initialisation_is_the_callers_to_see(
    make_fmu: MakeFMU, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = tmp_path / "calls"
    monkeypatch.setenv("FAULTY_FMU_CALLS", str(calls))
    with (
        FMUPlant(make_fmu(Fault.ERROR_IN_INITIALIZATION)) as plant,
        pytest.raises(FMUStepError, match=r"fmi2EnterInitializationMode returned error at t = 0 s"),
    ):
        plant.reset()
    assert calls.read_text(encoding="utf-8").split() == ["instantiate", "free"]


def test_an_fmu_can_be_used_again_after_any_fault(make_fmu: MakeFMU) -> None:
    with FMUPlant(make_fmu(Fault.RETURN_FATAL)) as plant:
        for _ in range(2):
            plant.reset()
            for _ in range(5):
                plant.step(np.ones(1), H)
            with pytest.raises(FMUStepError):
                plant.step(np.ones(1), H)


def test_whole_numbers_and_truth_values_are_parameters_too(make_fmu: MakeFMU) -> None:
    with FMUPlant(make_fmu(), outputs=["speed"]) as plant:
        plant.reset({"count": 3, "gain": 2.0})
        assert plant.step(np.ones(1), H) == pytest.approx([6.0])
        plant.reset({"on": 0.0})
        assert plant.step(np.ones(1), H) == pytest.approx([0.0])


@pytest.mark.parametrize(("name", "value"), [("count", 2.5), ("on", 0.5)])
def test_a_parameter_is_not_rounded_in_silence(make_fmu: MakeFMU, name: str, value: float) -> None:
    with FMUPlant(make_fmu()) as plant, pytest.raises(ConfigError, match=f"{name} = {value}"):
        plant.reset({name: value})


def test_local_variables_can_be_outputs(make_fmu: MakeFMU) -> None:
    with FMUPlant(make_fmu(), outputs=["hidden"]) as plant:
        plant.reset()
        assert plant.step(np.ones(1), H) == pytest.approx([H])
