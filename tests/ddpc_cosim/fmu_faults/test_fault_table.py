"""Every fault of an FMU is reported with the FMU, the time and the status, and the samples before are kept.

The rows are those of the page "When an FMU misbehaves". A run ends as it does with the same words whether the
FMU is in this process or in one of its own, where faults that would end this process are survived.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from fmus.builder import Fault

from ddpc_cosim import FMUPlant, FMUStepError, Outcome
from ddpc_cosim.errors import StepStatus

from .loop import FAULT_SAMPLE, SHORT, H, close_loop, open_plant

FMUs = dict[int, Path]

SURVIVED_BY_ALL = {
    Fault.RETURN_ERROR: (Outcome.FMU_ERROR, r"fmi\dDoStep returned error at t = 0\.5 s"),
    Fault.RETURN_FATAL: (Outcome.FMU_FATAL, r"fmi\dDoStep returned fatal at t = 0\.5 s"),
    Fault.MINUS_ONE_IN_STEP: (
        Outcome.FMU_ERROR,
        r"fmi\dDoStep returned illegal status -1 at t = 0\.5 s",
    ),
    Fault.RETURN_DISCARD: (Outcome.FMU_DISCARDED, r"fmi\dDoStep returned discard at t = 0\.5 s"),
    Fault.DISCARD_AND_TERMINATE: (
        Outcome.TERMINATED,
        r"fmi\dDoStep ended the simulation at t = 0\.5 s; the FMU asks to terminate",
    ),
    Fault.ASK_TO_TERMINATE: (
        Outcome.TERMINATED,
        r"DoStep ended the simulation at t = 0\.6 s; the FMU asks to terminate",
    ),
    Fault.RETURN_NAN: (Outcome.DIVERGED, r"output y is nan at t = 0\.6 s"),
    Fault.RETURN_INFINITY: (Outcome.DIVERGED, r"output y is inf at t = 0\.6 s"),
}

SURVIVED_BY_ISOLATION = {
    Fault.SEGMENTATION_FAULT: r"SIGSEGV \(.+\)",
    Fault.CALL_ABORT: r"SIGABRT \(.+\)",
    Fault.OVERFLOW_STACK: r"SIGSEGV \(.+\)",
    Fault.CALL_EXIT: "its process ended with exit code 3",
}

FLOODS = [(Fault.FLOOD_LOG, False)] + [
    (fault, True)
    for fault in (Fault.FLOOD_LOG, Fault.FLOOD_STDOUT, Fault.FLOOD_STDERR, Fault.FLOOD_DESCRIPTOR)
]

pytestmark = pytest.mark.usefixtures("nothing_left")


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("isolated", [False, True], ids=["in-process", "isolated"])
@pytest.mark.parametrize("fault", SURVIVED_BY_ALL, ids=lambda fault: fault.name)
def test_a_fault_that_is_returned(fault: Fault, isolated: bool, version: int, faulty_fmus: FMUs) -> None:
    outcome, reason = SURVIVED_BY_ALL[fault]
    with open_plant(faulty_fmus[version], isolated) as plant:
        trace = close_loop(plant, fault)
    assert trace.outcome is outcome
    assert re.search(reason, trace.reason)
    assert outcome is Outcome.DIVERGED or trace.reason.startswith(f"faulty{version}.fmu: ")
    # An FMU that ends the run at the end of a step has done that step.
    rows = FAULT_SAMPLE + (2 if fault is Fault.ASK_TO_TERMINATE else 1)
    np.testing.assert_allclose(trace.time, np.arange(rows) * H)
    np.testing.assert_allclose(trace.y[:, 0], trace.time, atol=1e-12)
    assert len(trace.time) < trace.planned_samples


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("fault", SURVIVED_BY_ISOLATION, ids=lambda fault: fault.name)
def test_a_crash(fault: Fault, version: int, faulty_fmus: FMUs) -> None:
    """It costs the run and nothing else: the same plant can be used for another."""
    with open_plant(faulty_fmus[version], isolated=True) as plant:
        trace = close_loop(plant, fault)
        assert trace.outcome is Outcome.CRASHED
        where = rf"^faulty{version}\.fmu: crashed in step at t = 0\.5 s: "
        assert re.search(where + SURVIVED_BY_ISOLATION[fault], trace.reason)
        assert len(trace.time) == FAULT_SAMPLE + 1
        np.testing.assert_allclose(trace.y[:, 0], trace.time, atol=1e-12)
        assert close_loop(plant).outcome is Outcome.COMPLETED


@pytest.mark.parametrize("version", [2, 3])
def test_a_step_that_does_not_return(version: int, faulty_fmus: FMUs) -> None:
    with open_plant(faulty_fmus[version], isolated=True, step_timeout=SHORT) as plant:
        trace = close_loop(plant, Fault.HANG_IN_STEP)
        assert trace.outcome is Outcome.TIMED_OUT
        assert trace.reason.startswith(f"faulty{version}.fmu: no return within 0.5 s in step at t = 0.5 s; ")
        assert "raise step_timeout" in trace.reason
        assert len(trace.time) == FAULT_SAMPLE + 1
        assert close_loop(plant).outcome is Outcome.COMPLETED


class TestOutsideOfSteps:
    """Initialisation and termination are limited in time and survived as steps are."""

    CASES = (
        (
            Fault.HANG_IN_INITIALIZATION,
            StepStatus.TIMED_OUT,
            "no return within 0.5 s in initialisation",
        ),
        (Fault.CRASH_IN_INITIALIZATION, StepStatus.CRASHED, "crashed in initialisation at t = 0 s: SIGSEGV"),
    )

    @pytest.mark.parametrize("version", [2, 3])
    @pytest.mark.parametrize(("fault", "status", "words"), CASES)
    def test_initialisation(
        self, fault: Fault, status: StepStatus, words: str, version: int, faulty_fmus: FMUs
    ) -> None:
        with (
            open_plant(faulty_fmus[version], isolated=True, step_timeout=SHORT) as plant,
            pytest.raises(FMUStepError, match=words) as error,
        ):
            close_loop(plant, fault)
        assert (error.value.status, error.value.time) == (status, 0.0)

    @pytest.mark.parametrize("version", [2, 3])
    @pytest.mark.parametrize(
        ("fault", "status", "words"),
        [
            (Fault.HANG_IN_TERMINATE, StepStatus.TIMED_OUT, "no return within 0.5 s in terminate at t = 1 s"),
            (Fault.CRASH_IN_TERMINATE, StepStatus.CRASHED, "crashed in terminate at t = 1 s: SIGSEGV"),
        ],
    )
    def test_termination(
        self, fault: Fault, status: StepStatus, words: str, version: int, faulty_fmus: FMUs
    ) -> None:
        """The run is complete; closing the plant says that the FMU did not end well."""
        plant = open_plant(faulty_fmus[version], isolated=True, step_timeout=SHORT)
        trace = close_loop(plant, fault)
        assert trace.outcome is Outcome.COMPLETED
        with pytest.raises(FMUStepError, match=words) as error:
            plant.close()
        assert error.value.status is status
        plant.close()

    def test_the_next_run_after_a_termination_that_hangs(self, faulty_fmus: FMUs) -> None:
        with open_plant(faulty_fmus[2], isolated=True, step_timeout=SHORT) as plant:
            close_loop(plant, Fault.HANG_IN_TERMINATE)
            with pytest.raises(FMUStepError, match="no return within") as error:
                plant.reset()
            assert error.value.status is StepStatus.TIMED_OUT
            np.testing.assert_allclose(plant.reset(), [0.0])


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(("fault", "isolated"), FLOODS)
def test_a_hundred_megabytes(
    fault: Fault,
    isolated: bool,
    version: int,
    faulty_fmus: FMUs,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """What an FMU logs, or an isolated one prints, is kept out of the terminal, and does not stop the run."""
    with open_plant(faulty_fmus[version], isolated) as plant:
        plant.reset({"fault": int(fault), "fault_time": 0.0})
        np.testing.assert_allclose(plant.step(np.ones(1), H), [H])
    assert capfd.readouterr() == ("", "")


def test_last_words(faulty_fmus: FMUs, tmp_path: Path) -> None:
    """What an isolated FMU has printed before it crashed is in the reason; its end, if it is long."""
    with open_plant(faulty_fmus[2], isolated=True) as plant:
        plant.reset({"fault": int(Fault.PRINT_AND_ABORT)})
        with pytest.raises(FMUStepError, match=r"SIGABRT \(.+\); it printed: .*division by zero$") as error:
            plant.step(np.ones(1), H)
    assert len(str(error.value)) < 500


@pytest.mark.parametrize("isolated", [False, True], ids=["in-process", "isolated"])
def test_a_good_fmu_is_the_same_in_both(isolated: bool, faulty_fmus: FMUs) -> None:
    with FMUPlant(faulty_fmus[2], isolated=isolated) as plant:
        trace = close_loop(plant)
    assert trace.outcome is Outcome.COMPLETED
    np.testing.assert_allclose(trace.y[:, 0], trace.time, atol=1e-12)
