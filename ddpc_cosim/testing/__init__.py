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

from collections.abc import Callable, Iterable
from functools import partial

from ddpc_cosim.controller import Controller
from ddpc_cosim.plant import Plant
from ddpc_cosim.testing.check_results import CheckResult, CheckStatus, run_check
from ddpc_cosim.testing.controllers import CONTROLLER_CHECKS, ControllerUnderTest
from ddpc_cosim.testing.plants import PLANT_CHECKS, PlantUnderTest

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
    """Check a plant against the contract; its errors do not propagate.

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
    subject = PlantUnderTest(make_plant, sampling_time, steps, tolerance)
    return [run_check(name, partial(check, subject)) for name, check in PLANT_CHECKS.items()]


def check_controller(
    make_controller: MakeController, *, sampling_time: float = 0.1, steps: int = 60
) -> list[CheckResult]:
    """Check a controller against the contract; its errors do not propagate.

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
    subject = ControllerUnderTest(make_controller, sampling_time, steps)
    return [run_check(name, partial(check, subject)) for name, check in CONTROLLER_CHECKS.items()]


def _as_tests(kind: type, checks: Iterable[str], test: Callable[[str], Callable[..., None]]) -> None:
    """Give a class a test for each check, named after it."""
    for name in checks:
        method = test(name)
        method.__name__ = f"test_{name.replace(' ', '_')}"
        method.__doc__ = f"Require that the subject {name}."
        setattr(kind, method.__name__, method)


def _require(result: CheckResult) -> None:
    assert result.status is not CheckStatus.FAILED, f"{result.name}: {result.reason}"


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


def _plant_test(name: str) -> Callable[..., None]:
    def test(self: PlantConformance, make_plant: MakePlant) -> None:
        subject = PlantUnderTest(make_plant, self.sampling_time, self.steps, self.tolerance)
        _require(run_check(name, partial(PLANT_CHECKS[name], subject)))

    return test


def _controller_test(name: str) -> Callable[..., None]:
    def test(self: ControllerConformance, make_controller: MakeController) -> None:
        subject = ControllerUnderTest(make_controller, self.sampling_time, self.steps)
        _require(run_check(name, partial(CONTROLLER_CHECKS[name], subject)))

    return test


_as_tests(PlantConformance, PLANT_CHECKS, _plant_test)
_as_tests(ControllerConformance, CONTROLLER_CHECKS, _controller_test)
