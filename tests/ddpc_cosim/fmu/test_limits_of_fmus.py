"""What FMUs do not allow is respected, or refused with the reason before the run."""

import gc
import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
from fmus.builder import LAG, V, describe, model_fmu, model_library, write_fmu

from ddpc_cosim.errors import ConfigError, FMUImportError, FMUStepError
from ddpc_cosim.fmu.plant import FMUPlant

pytestmark = pytest.mark.filterwarnings("ignore::ddpc_cosim.CosimWarning")  # what is told, tests look at

ONE = np.array([1.0])


def lag(folder: Path, attributes: str = "", head: str = "", version: str = "2.0") -> FMUPlant:
    interfaces = f'<CoSimulation modelIdentifier="models"{attributes}/>'
    independent = [V("time", 15, causality="independent")] if version == "3.0" else []
    text = describe(version, "lag", [*independent, *LAG], interfaces=interfaces, head=head)
    return FMUPlant(write_fmu(folder / "lag.fmu", text, model_library(version)), outputs=["x"])


def test_a_fixed_step_size_stays_what_it_was(tmp_path: Path) -> None:
    session = lag(tmp_path)
    session.reset()
    session.step(ONE, 0.1)
    with pytest.raises(ConfigError, match=r"the step size cannot change from 0.1 s to 0.2 s"):
        session.step(ONE, 0.2)
    session.reset()
    session.step(ONE, 0.2)
    session.close()


def test_a_fixed_step_size_is_the_preferred_one_where_that_divides_the_sampling_time(tmp_path: Path) -> None:
    session = lag(tmp_path, head='<DefaultExperiment stepSize="0.01"/>')
    session.plan(0.1, 1.0)
    assert "the FMU's step size is fixed: 10 steps of 0.01 s per sample" in session.warnings
    session.reset()
    assert session.step(ONE, 0.1) == pytest.approx([1 - np.exp(-0.1)])
    assert session.time == pytest.approx(0.1)
    session.close()


def test_a_sampling_time_that_the_internal_step_does_not_divide_is_warned_of(tmp_path: Path) -> None:
    attributes = ' canHandleVariableCommunicationStepSize="true" fixedInternalStepSize="0.03"'
    session = lag(tmp_path, attributes, version="3.0")
    session.plan(0.09, 1.0)
    assert not [text for text in session.warnings if "fixed at" in text]
    session.plan(0.1, 1.0)
    assert [text for text in session.warnings if "fixed at 0.03 s" in text]
    session.reset()
    assert session.step(ONE, 0.1) == pytest.approx([1 - np.exp(-0.1)])
    session.close()


def test_an_integer_that_its_type_cannot_hold_is_an_error(tmp_path: Path) -> None:
    session = FMUPlant(model_fmu(tmp_path, "2.0", "integrator"), inputs=["u"])
    with pytest.raises(ConfigError, match=r"fault = 3e\+09 is outside what an integer of type Integer"):
        session.reset({"fault": 3e9})
    session.close()


def test_the_stop_time_is_told_and_the_last_step_stays_within(tmp_path: Path) -> None:
    """The FMU fails beyond its stop time, to the last bit."""
    session = FMUPlant(model_fmu(tmp_path, "2.0", "lag"))
    session.plan(0.1, 0.7)
    session.reset()
    for _ in range(7):
        session.step(ONE, 0.1)
    with pytest.raises(FMUStepError, match=r"fmi2DoStep returned error at t = 0\.7 s"):
        session.step(ONE, 0.1)
    session.close()


def test_only_one_instance_per_process_where_the_fmu_wants_it(tmp_path: Path) -> None:
    attributes = ' canBeInstantiatedOnlyOncePerProcess="true" canHandleVariableCommunicationStepSize="true"'
    first, second = lag(tmp_path, attributes), lag(tmp_path, attributes)
    first.reset()
    with pytest.raises(FMUImportError, match=r"allows one instance per process .*isolated=True"):
        second.reset()
    first.reset()
    first.close()
    second.reset()
    second.close()


def test_instances_of_one_fmu_do_not_disturb_each_other(tmp_path: Path) -> None:
    path = model_fmu(tmp_path, "2.0", "lag")
    sessions = [FMUPlant(path, outputs=["x"]) for _ in range(3)]
    for i, session in enumerate(sessions):
        session.reset({"rate": 1.0 + i})
    rows = [[float(session.step(ONE, 0.5)[0]) for session in sessions] for _ in range(2)]
    for k, row in enumerate(rows, start=1):
        assert row == pytest.approx([1 - np.exp(-(1.0 + i) * 0.5 * k) for i in range(3)])
    for session in sessions:
        session.close()


def test_the_tool_that_an_fmu_needs_is_named(tmp_path: Path) -> None:
    session = lag(tmp_path, ' needsExecutionTool="true"')
    assert "the FMU needs the tool that made it: unknown" in session.warnings
    session.close()


@pytest.mark.parametrize(
    ("fmi_type", "words"),
    [
        ("model-exchange", "cannot be run for model-exchange: the FMU is for co-simulation"),
        ("cosimulation", 'fmi_type = "cosimulation" is not possible; allowed: auto, co-simulation'),
    ],
)
def test_a_type_that_the_fmu_does_not_have_is_refused(tmp_path: Path, fmi_type: str, words: str) -> None:
    interfaces = '<CoSimulation modelIdentifier="models"/>'
    path = model_fmu(tmp_path, "2.0", "lag", interfaces=interfaces)
    with pytest.raises((FMUImportError, ConfigError), match=words):
        FMUPlant(path, fmi_type=fmi_type)  # type: ignore[arg-type]


def test_numbers_that_are_none_are_refused_all_at_once(tmp_path: Path) -> None:
    path = model_fmu(tmp_path, "2.0", "lag")
    with pytest.raises(ConfigError) as caught:
        FMUPlant(path, tolerance="x", step_timeout=None, memory_limit=-1, sandbox=True)  # type: ignore[arg-type]
    assert list(caught.value.faults) == [
        "step_timeout = None is not possible; allowed: a finite number > 0",
        "memory_limit = -1 is not possible; allowed: a finite number > 0",
        "tolerance = 'x' is not possible; allowed: a finite number > 0",
        "sandbox = True needs isolated = True: a process of its own enters it",
    ]


def test_co_simulation_comes_first(tmp_path: Path) -> None:
    session = FMUPlant(model_fmu(tmp_path, "3.0", "lag"))
    assert session.provenance()["fmi_version"] == "3.0 Co-Simulation"
    session.close()


def _open_files() -> int:
    folder = Path("/proc/self/fd") if sys.platform == "linux" else Path("/dev/fd")
    return len(list(folder.iterdir())) if os.name == "posix" else 0


def _peak_memory() -> int:
    """Return the most memory that this process ever had [bytes]; where that is not known, 0."""
    if sys.platform == "win32":
        return 0
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


@pytest.mark.parametrize("kind", ["co-simulation", "model-exchange"])
def test_instantiating_and_freeing_2000_times_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    session = FMUPlant(model_fmu(tmp_path, "2.0", "lag"), fmi_type=kind)  # type: ignore[arg-type]

    def run(times: int) -> None:
        for _ in range(times):
            session.reset({"rate": 2.0})
            session.step(ONE, 0.1)

    run(200)
    gc.collect()
    files, folders = _open_files(), len(list(scratch.iterdir()))
    peak = _peak_memory()
    run(2000)
    gc.collect()
    assert _open_files() == files
    assert len(list(scratch.iterdir())) == folders
    assert _peak_memory() - peak < 2 * 1024**2
    session.close()
    assert list(scratch.iterdir()) == []
