"""FMUs that misbehave in a study: each case ends with the outcome of the fault, and the samples before it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmus.builder import Fault
from studies import cases_in, study_text, write

from ddpc_cosim import ConfigError, Outcome, Trace
from ddpc_cosim.codec import read
from ddpc_cosim.study.case_files import read_trace
from ddpc_cosim.study.file_format.sections import PlantSection
from ddpc_cosim.study.plants import PlantSpec
from ddpc_cosim.study.runner import Update, run_cases

from .loop import FAULT_SAMPLE, FAULT_TIME, SHORT

RECORDING = {"samples": 60, "excitation": {"u": {"low": -1.0, "high": 1.0}}}

Run = Callable[..., Trace]

pytestmark = pytest.mark.usefixtures("nothing_left")


@pytest.fixture
def run(tmp_path: Path, faulty_fmus: dict[int, Path]) -> Run:
    """Run the only case of a study of the misbehaving FMU."""

    def run_fault(fault: Fault, *, controller: str = "mfapc", timeout: float = 20.0, **tables: Any) -> Trace:
        text = study_text(
            plant={"fmu": str(faulty_fmus[2]), "parameters": {"fault": int(fault), "fault_time": FAULT_TIME}},
            reference={"y": 1.0},
            controllers={"it": controller},
            loop={"step_timeout": timeout},
            **tables,
        )
        cases = cases_in(write(tmp_path, text))

        def watch(update: Update) -> None:
            assert not (tmp_path / cases[0].id).exists(), "what is over runs no more"

        (case,) = run_cases(cases, tmp_path, 1, watch)
        return read_trace(tmp_path / case.id)

    return run_fault


def test_a_crash(run: Run) -> None:
    """A supplied FMU is isolated without being asked for it."""
    trace = run(Fault.SEGMENTATION_FAULT)
    assert trace.outcome is Outcome.CRASHED
    assert trace.reason.startswith("faulty2.fmu: crashed in step at t = 0.5 s: ")
    assert len(trace.time) == FAULT_SAMPLE + 1


def test_a_termination_that_does_not_return(run: Run) -> None:
    """All samples are there, and still it is not a success."""
    trace = run(Fault.HANG_IN_TERMINATE, timeout=SHORT)
    assert trace.outcome is Outcome.TIMED_OUT
    assert trace.reason.startswith("after the last sample: faulty2.fmu: no return within 0.5 s in terminate")
    assert len(trace.time) == trace.planned_samples


def test_an_initialisation_that_does_not_return(run: Run) -> None:
    trace = run(Fault.HANG_IN_INITIALIZATION, timeout=SHORT)
    assert trace.outcome is Outcome.TIMED_OUT
    assert trace.reason.startswith("before the first sample: faulty2.fmu: no return within 0.5 s")
    assert len(trace.time) == 0


def test_a_status_that_the_standard_does_not_know(run: Run) -> None:
    trace = run(Fault.MINUS_ONE_IN_STEP)
    assert trace.outcome is Outcome.FMU_ERROR
    assert "returned illegal status -1 at t = 0.5 s" in trace.reason
    assert len(trace.time) == FAULT_SAMPLE + 1


def test_a_plant_that_diverges_while_it_is_recorded(run: Run) -> None:
    trace = run(Fault.RETURN_NAN, controller="deepc", recording=RECORDING)
    assert trace.outcome is Outcome.DIVERGED
    assert "during the open-loop experiment" in trace.reason
    assert "output y is nan" in trace.reason


@pytest.mark.parametrize(
    ("fault", "outcome"),
    [(Fault.RETURN_ERROR, Outcome.FMU_ERROR), (Fault.ASK_TO_TERMINATE, Outcome.TERMINATED)],
)
def test_a_fault_while_the_plant_is_recorded(fault: Fault, outcome: Outcome, run: Run) -> None:
    trace = run(fault, controller="deepc", recording=RECORDING)
    assert trace.outcome is outcome
    assert trace.reason.startswith("before the first sample: ")
    assert trace.reason.endswith(", during the experiment")


def test_a_run_that_the_fmu_ends(run: Run) -> None:
    trace = run(Fault.ASK_TO_TERMINATE)
    assert trace.outcome is Outcome.TERMINATED
    assert trace.reason.endswith("at t = 0.6 s; the FMU asks to terminate")
    assert len(trace) == FAULT_SAMPLE + 2 < trace.planned_samples


class TestWhatIsIsolated:
    @pytest.mark.parametrize(("wanted", "isolated"), [("auto", True), (True, True), (False, False)])
    def test_supplied_fmus(
        self, wanted: bool | str, isolated: bool, faulty_fmus: dict[int, Path], tmp_path: Path
    ) -> None:
        section = read(PlantSection, {"fmu": str(faulty_fmus[2]), "isolated": wanted})
        target = PlantSpec.of(section, tmp_path).built()
        assert target.isolated is isolated
        plant = target.open(["u"], ["y"])
        np.testing.assert_allclose(plant.reset(), [0.0])
        plant.close()

    @pytest.mark.parametrize(("wanted", "isolated"), [("auto", False), (True, True), (False, False)])
    def test_equations(
        self, wanted: bool | str, isolated: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setenv("DDPC_COSIM_CACHE", str(tmp_path / "cache"))
        section = read(PlantSection, {"name": "pendulum", "isolated": wanted})
        assert PlantSpec.of(section, tmp_path).built().isolated is isolated

    def test_python_plants_cannot_be(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """The author of a class is at hand; who wrote an FMU may not be."""
        (tmp_path / "own.py").write_text(
            "from ddpc_cosim import Plant\n\n\nclass Own(Plant):\n    pass\n", encoding="utf-8"
        )
        monkeypatch.syspath_prepend(tmp_path)
        section = read(PlantSection, {"name": "own:Own", "isolated": True})
        with pytest.raises(ConfigError, match='plant "own:Own" is a Python class; only FMUs can be isolated'):
            PlantSpec.of(section, tmp_path)
