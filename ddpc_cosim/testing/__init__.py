"""The conformance kit for authors of plants and of controllers: one call, or one class in their own tests.

>>> from ddpc_cosim import FMUPlant
>>> results = check_plant(lambda: FMUPlant(pendulum_fmu))
>>> {result.status.value for result in results}
{'passed'}

>>> from ddpc_controllers import MFAPC
>>> failed = [result for result in check_controller(MFAPC) if result.status is CheckStatus.FAILED]
>>> failed
[]
"""

from collections.abc import Callable
from functools import partial

from ddpc_cosim.controller import Controller
from ddpc_cosim.plant import Plant
from ddpc_cosim.testing.check_results import CheckResult, CheckStatus, run_check
from ddpc_cosim.testing.controllers import CONTROLLER_CHECKS, ControllerTrial
from ddpc_cosim.testing.plants import PLANT_CHECKS, Trial

__all__ = [
    "CONTROLLER_CHECKS",
    "PLANT_CHECKS",
    "CheckResult",
    "CheckStatus",
    "ControllerConformance",
    "PlantConformance",
    "check_controller",
    "check_plant",
]

MakePlant = Callable[[], Plant]
MakeController = Callable[[], Controller]


def check_plant(
    make_plant: MakePlant, *, sampling_time: float = 0.1, steps: int = 20, tolerance: float = 1e-3
) -> list[CheckResult]:
    """Check a plant against the contract; nothing that it raises comes out.

    Parameters
    ----------
    make_plant : callable
        Returns a new plant at every call; a plant class will do.
    sampling_time : float
        Communication step size of the runs [s].
    steps : int
        Steps of one run.
    tolerance : float
        How far outputs may differ where they need not agree to the last bit (other step size, restored
        state), in shares of their span.

    Returns
    -------
    results : list of CheckResult
        One for each check.
    """
    trial = Trial(make_plant, sampling_time, steps, tolerance)
    return [run_check(name, partial(check, trial)) for name, check in PLANT_CHECKS.items()]


def check_controller(
    make_controller: MakeController, *, sampling_time: float = 0.1, steps: int = 60
) -> list[CheckResult]:
    """Check a controller against the contract; nothing that it raises comes out.

    The plant of the checks is x' = u - x, with input ``u1`` and output ``y1``, or two of these that act a
    little on each other, for controllers that refuse one; inputs are limited to 1, outputs to 2.

    Parameters
    ----------
    make_controller : callable
        Returns a new controller at every call; a controller class will do if all its settings have defaults.
    sampling_time : float
        Time between samples [s].
    steps : int
        Samples of one run.

    Returns
    -------
    results : list of CheckResult
        One for each check.
    """
    trial = ControllerTrial(make_controller, sampling_time, steps)
    return [run_check(name, partial(check, trial)) for name, check in CONTROLLER_CHECKS.items()]


class PlantConformance:
    """The checks of :func:`check_plant` as tests: subclass it, and define the fixture ``make_plant``.

    A check that does not apply passes.

    Examples
    --------
    >>> import pytest
    >>> class TestTank(PlantConformance):
    ...     @pytest.fixture
    ...     def make_plant(self):
    ...         return Tank
    """

    sampling_time: float = 0.1
    steps: int = 20
    tolerance: float = 1e-3

    def test_declares_its_signals(self, make_plant: MakePlant) -> None:
        """Run the check of this name."""
        self._require("declares its signals", make_plant)

    def test_returns_arrays_of_the_right_shape(self, make_plant: MakePlant) -> None:
        """Run the check of this name."""
        self._require("returns arrays of the right shape", make_plant)

    def test_returns_finite_numbers(self, make_plant: MakePlant) -> None:
        """Run the check of this name."""
        self._require("returns finite numbers", make_plant)

    def test_resets_to_the_same_trajectory(self, make_plant: MakePlant) -> None:
        """Run the check of this name."""
        self._require("resets to the same trajectory", make_plant)

    def test_holds_its_inputs(self, make_plant: MakePlant) -> None:
        """Run the check of this name."""
        self._require("holds its inputs", make_plant)

    def test_does_not_depend_on_the_step_size(self, make_plant: MakePlant) -> None:
        """Run the check of this name."""
        self._require("does not depend on the step size", make_plant)

    def test_two_instances_are_independent(self, make_plant: MakePlant) -> None:
        """Run the check of this name."""
        self._require("two instances are independent", make_plant)

    def test_restores_a_saved_state(self, make_plant: MakePlant) -> None:
        """Run the check of this name."""
        self._require("restores a saved state", make_plant)

    def test_refuses_unknown_parameters(self, make_plant: MakePlant) -> None:
        """Run the check of this name."""
        self._require("refuses unknown parameters", make_plant)

    def test_can_be_closed_twice(self, make_plant: MakePlant) -> None:
        """Run the check of this name."""
        self._require("can be closed twice", make_plant)

    def _require(self, name: str, make_plant: MakePlant) -> None:
        trial = Trial(make_plant, self.sampling_time, self.steps, self.tolerance)
        result = run_check(name, partial(PLANT_CHECKS[name], trial))
        assert result.status is not CheckStatus.FAILED, f"{name}: {result.reason}"


class ControllerConformance:
    """The checks of :func:`check_controller` as tests: subclass it, define the fixture ``make_controller``.

    A check that does not apply passes.

    Examples
    --------
    >>> import pytest
    >>> class TestMine(ControllerConformance):
    ...     @pytest.fixture
    ...     def make_controller(self):
    ...         return Mine
    """

    sampling_time: float = 0.1
    steps: int = 60

    def test_stores_its_settings(self, make_controller: MakeController) -> None:
        """Run the check of this name."""
        self._require("stores its settings", make_controller)

    def test_refuses_unknown_settings(self, make_controller: MakeController) -> None:
        """Run the check of this name."""
        self._require("refuses unknown settings", make_controller)

    def test_refuses_impossible_settings(self, make_controller: MakeController) -> None:
        """Run the check of this name."""
        self._require("refuses impossible settings", make_controller)

    def test_returns_one_input_for_one_output(self, make_controller: MakeController) -> None:
        """Run the check of this name."""
        self._require("returns one input for one output", make_controller)

    def test_returns_two_inputs_for_two_outputs(self, make_controller: MakeController) -> None:
        """Run the check of this name."""
        self._require("returns two inputs for two outputs", make_controller)

    def test_starts_with_the_recording_it_asks_for(self, make_controller: MakeController) -> None:
        """Run the check of this name."""
        self._require("starts with the recording it asks for", make_controller)

    def test_is_deterministic_under_its_seed(self, make_controller: MakeController) -> None:
        """Run the check of this name."""
        self._require("is deterministic under its seed", make_controller)

    def test_forgets_a_run_when_started_again(self, make_controller: MakeController) -> None:
        """Run the check of this name."""
        self._require("forgets a run when started again", make_controller)

    def test_can_be_pickled(self, make_controller: MakeController) -> None:
        """Run the check of this name."""
        self._require("can be pickled", make_controller)

    def test_two_instances_are_independent(self, make_controller: MakeController) -> None:
        """Run the check of this name."""
        self._require("two instances are independent", make_controller)

    def test_keeps_no_array_that_it_is_given(self, make_controller: MakeController) -> None:
        """Run the check of this name."""
        self._require("keeps no array that it is given", make_controller)

    def test_respects_the_input_limits(self, make_controller: MakeController) -> None:
        """Run the check of this name."""
        self._require("respects the input limits", make_controller)

    def test_reports_a_failure_as_a_status(self, make_controller: MakeController) -> None:
        """Run the check of this name."""
        self._require("reports a failure as a status", make_controller)

    def test_handles_a_missing_measurement_as_declared(self, make_controller: MakeController) -> None:
        """Run the check of this name."""
        self._require("handles a missing measurement as declared", make_controller)

    def test_stabilises_a_benign_plant(self, make_controller: MakeController) -> None:
        """Run the check of this name."""
        self._require("stabilises a benign plant", make_controller)

    def _require(self, name: str, make_controller: MakeController) -> None:
        trial = ControllerTrial(make_controller, self.sampling_time, self.steps)
        result = run_check(name, partial(CONTROLLER_CHECKS[name], trial))
        assert result.status is not CheckStatus.FAILED, f"{name}: {result.reason}"
