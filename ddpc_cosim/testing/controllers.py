"""What the controller contract demands, as checks of controllers of which nothing else is known."""

import math
import pickle
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from ddpc_cosim.controller import OK, Controller
from ddpc_cosim.errors import ConfigError, DataError
from ddpc_cosim.settings import SettingInfo, declared_settings, from_plain
from ddpc_cosim.testing.check_results import CheckFailedError, NotApplicableError
from ddpc_cosim.testing.reference_plant import LoopResult, ReferencePlant, TestLoop
from ddpc_cosim.variables import FloatArray

_UNKNOWN = "no_such_setting"
_SAME_LAW = 1e-3  # what a method that is not exact may make of the order of its data


def stores_its_settings(controller: Controller) -> None:
    """Require that what ``settings`` returns makes an equal controller: a study file is all that is kept."""
    kind = type(controller)
    if not declared_settings(kind):
        raise NotApplicableError("it declares no settings")
    plain = controller.settings()
    undeclared = sorted(set(plain) - set(declared_settings(kind)))
    if undeclared:
        raise CheckFailedError(f"{', '.join(undeclared)} is not declared with ddpc_cosim.setting")
    given = {name: from_plain(kind, name, value) for name, value in plain.items() if value is not None}
    again = kind(**given).settings()
    changed = [name for name in plain if again.get(name) != plain[name]]
    if changed:
        what = f"{changed[0]} = {plain[changed[0]]!r} comes back as {again.get(changed[0])!r}"
        raise CheckFailedError(f"settings() does not make an equal controller: {what}")


def refuses_unknown_settings(controller: Controller) -> None:
    """Require an error for an argument that is not a setting."""
    try:
        type(controller)(**_given(controller), **{_UNKNOWN: 1.0})
    except (TypeError, ConfigError):
        return
    raise CheckFailedError(f"the constructor accepts {_UNKNOWN} = 1.0; it has to raise TypeError")


def refuses_impossible_settings(controller: Controller) -> None:
    """Require a ConfigError that names the setting, for every value outside a declared range."""
    kind = type(controller)
    ranges = {name: info for name, info in declared_settings(kind).items() if list(_outside(info))}
    if not ranges:
        raise NotApplicableError("it declares no ranges")
    for name, info in ranges.items():
        for value in _outside(info):
            try:
                kind(**{**_given(controller), name: value})
            except ConfigError as error:
                if not any(name in fault for fault in error.faults):
                    raise CheckFailedError(f"the error for {name} = {value!r} does not name it") from error
            else:
                raise CheckFailedError(
                    f"{name} = {value!r} is accepted although only {info.allowed} is allowed; if the class "
                    "has a __post_init__, it has to call super().__post_init__()"
                )


def _given(controller: Controller) -> dict[str, Any]:
    if not is_dataclass(controller):
        return {}
    return {field.name: getattr(controller, field.name) for field in fields(controller) if field.init}


def _outside(info: SettingInfo) -> Iterator[Any]:
    """Yield values that a setting does not take."""
    if info.choices:
        yield "no such choice"
        return
    if math.isfinite(info.low):
        yield info.low - 1
    if math.isfinite(info.above):
        yield info.above
    if math.isfinite(info.high):
        yield info.high + 1


_OTHER_SEED = 1
_TIGHT_LIMIT = 0.2
_OUT_OF_REACH = 20.0


@dataclass(frozen=True, slots=True)
class ControllerUnderTest:
    """A controller that is checked, and how.

    Parameters
    ----------
    make_controller : callable
        Returns a new controller at every call.
    sampling_time : float
        Time between samples [s].
    steps : int
        Samples of one run.
    """

    make_controller: Callable[[], Controller]
    sampling_time: float = 0.1
    steps: int = 60

    def plant(self, input_limit: float = 1.0) -> ReferencePlant:
        """Return the smallest reference plant whose size suits the controller.

        Raises
        ------
        CheckFailedError
            Neither size does.
        """
        refusals = []
        for size in (1, 2):
            plant, controller = ReferencePlant(size, self.sampling_time, input_limit), self.make_controller()
            try:
                controller.start(plant.loop_for(controller, 0))
            except ConfigError as error:
                refusals.append(f"{size} x {size}: {error.faults[0]}")
            else:
                return plant
        raise CheckFailedError("it starts in no loop; " + "; ".join(refusals))

    def started(self, plant: ReferencePlant, seed: int = 0) -> Controller:
        """Return a new controller, started."""
        controller = self.make_controller()
        controller.start(plant.loop_for(controller, seed))
        return controller

    def run(self, plant: ReferencePlant, controller: Controller, scale: float = 1.0) -> LoopResult:
        """Run a started controller in the loop."""
        test_loop = TestLoop(plant, controller, scale=scale)
        for _ in range(self.steps):
            test_loop.step()
        return test_loop.result()


def returns_one_input_for_one_output(subject: ControllerUnderTest) -> None:
    """Require new float64 arrays of shape (1,) and a status."""
    _require_shapes(subject, 1)


def returns_two_inputs_for_two_outputs(subject: ControllerUnderTest) -> None:
    """Require new float64 arrays of shape (2,) and a status."""
    _require_shapes(subject, 2)


def _require_shapes(subject: ControllerUnderTest, size: int) -> None:
    plant, controller = ReferencePlant(size, subject.sampling_time), subject.make_controller()
    if not isinstance(controller, Controller):
        raise CheckFailedError(f"{type(controller).__name__} is not derived from ddpc_cosim.Controller")
    try:
        controller.start(plant.loop_for(controller, 0))
    except ConfigError as error:
        reason = "; ".join(error.faults)
        raise NotApplicableError(f"it does not start in a loop of {size} x {size}: {reason}") from error
    subject.run(plant, controller)


def starts_with_the_recording_it_asks_for(subject: ControllerUnderTest) -> None:
    """Require that a recording as short as ``recording_length`` says will do."""
    plant, controller = subject.plant(), subject.make_controller()
    if not controller.uses_recording:
        raise NotApplicableError("it does not use a recording")
    needed = controller.recording_length(plant.size, plant.size, plant.size)
    controller.start(plant.loop(max(needed, 1), 0))


def is_deterministic_under_its_seed(subject: ControllerUnderTest) -> None:
    """Require that two controllers of the same seed do the same."""
    plant = subject.plant()
    first, second = (subject.run(plant, subject.started(plant)) for _ in range(2))
    _require_equal(first.u, second.u, "between two controllers of the same seed; use loop.rng only")


def forgets_a_run_when_started_again(subject: ControllerUnderTest) -> None:
    """Require that a second ``start`` repeats the first run to the last bit, with the same Loop too."""
    plant, controller = subject.plant(), subject.make_controller()
    loop = plant.loop_for(controller, 0)
    controller.start(loop)
    first = subject.run(plant, controller)
    controller.start(plant.loop_for(controller, _OTHER_SEED))
    subject.run(plant, controller, scale=-1.0)
    controller.start(loop)
    _require_equal(first.u, subject.run(plant, controller).u, "after a second start; copy loop.rng to use it")


def can_be_pickled(subject: ControllerUnderTest) -> None:
    """Require that a pickled controller starts, and goes on where it was."""
    plant = subject.plant()
    fresh = pickle.loads(pickle.dumps(subject.make_controller()))
    fresh.start(plant.loop_for(fresh, 0))
    expected = subject.run(plant, subject.started(plant)).u
    _require_equal(expected, subject.run(plant, fresh).u, "when pickled before its start")
    test_loop = TestLoop(plant, subject.started(plant))
    for k in range(subject.steps):
        test_loop.step()
        if k == subject.steps // 2:
            test_loop.controller = pickle.loads(pickle.dumps(test_loop.controller))
    _require_equal(expected, test_loop.result().u, "when pickled during a run")


def two_instances_are_independent(subject: ControllerUnderTest) -> None:
    """Require that what one instance does changes nothing for another."""
    plant = subject.plant()
    alone = subject.run(plant, subject.started(plant)).u
    test_loop = TestLoop(plant, subject.started(plant))
    other = TestLoop(plant, subject.started(plant, _OTHER_SEED), scale=-2.0)
    for _ in range(subject.steps):
        test_loop.step()
        other.step()
    _require_equal(alone, test_loop.result().u, "beside another instance")


def keeps_no_array_that_it_is_given(subject: ControllerUnderTest) -> None:
    """Require that the arrays of a sample may be overwritten when ``step`` has returned."""
    plant = subject.plant()
    test_loop = TestLoop(plant, subject.started(plant), reuse=True)
    for _ in range(subject.steps):
        test_loop.step()
    expected = subject.run(plant, subject.started(plant)).u
    _require_equal(
        expected, test_loop.result().u, "when the arrays of a sample are used again; copy what you keep"
    )


def respects_the_input_limits(subject: ControllerUnderTest) -> None:
    """Require inputs within their limits, exactly, where the reference is out of reach."""
    plant = subject.plant(_TIGHT_LIMIT)
    _require_within(plant, subject.run(plant, subject.started(plant), scale=_OUT_OF_REACH))


def reports_a_failure_as_a_status(subject: ControllerUnderTest) -> None:
    """Require finite inputs within their limits where no inputs keep the outputs in theirs."""
    plant = subject.plant()
    test_loop = TestLoop(plant, subject.started(plant), start=_OUT_OF_REACH)
    for _ in range(subject.steps):
        _attempt(test_loop, None, "with outputs far outside their limits")
    _require_within(plant, test_loop.result())


def handles_a_missing_measurement_as_declared(subject: ControllerUnderTest) -> None:
    """Require that a NaN is answered as ``accepts_missing`` says, and that a new start forgets it."""
    plant, controller = subject.plant(), subject.make_controller()
    loop = plant.loop_for(controller, 0)
    controller.start(loop)
    expected = subject.run(plant, controller).u
    controller.start(loop)
    test_loop, missing = TestLoop(plant, controller), np.full(plant.size, np.nan)
    if controller.accepts_missing:
        for k in range(subject.steps):
            lost = missing if k == subject.steps // 2 else None
            _attempt(test_loop, lost, "although it declares accepts_missing")
        _require_within(plant, test_loop.result())
        _require_reported(test_loop.result(), subject.steps // 2)
    else:
        _require_not_silent(test_loop, missing, subject.steps // 2)
    controller.start(loop)
    _require_equal(expected, subject.run(plant, controller).u, "in the run after one with NaN in it")


def knows_its_horizon_before_its_start(subject: ControllerUnderTest) -> None:
    """Require a horizon that ``start`` does not change: what a controller may see is decided before."""
    plant, controller = subject.plant(), subject.make_controller()
    before = controller.horizon
    controller.start(plant.loop_for(controller, 0))
    if controller.horizon != before:
        raise CheckFailedError(f"start changes horizon from {before} to {controller.horizon}; set it before")


def stabilises_the_reference_plant(subject: ControllerUnderTest) -> None:
    """Require that the outputs end nearer to a reference within reach than they began."""
    plant = subject.plant()
    _require_approach(subject, plant, subject.started(plant))


def stabilises_it_without_preview(subject: ControllerUnderTest) -> None:
    """Require the same where a study shows no future references: all of them are the setpoint."""
    plant, controller = subject.plant(), subject.make_controller()
    controller.start(plant.loop_for(controller, 0, preview=0))
    _require_approach(subject, plant, controller)


def learns_from_no_window_across_a_seam(subject: ControllerUnderTest) -> None:
    """Require that the order of two recordings does not decide the first inputs, or a DataError."""
    plant = subject.plant()
    if not subject.make_controller().uses_recording:
        raise NotApplicableError("it does not use a recording")
    first = []
    for turned in (False, True):
        controller = subject.make_controller()
        try:
            controller.start(plant.mosaic(plant.loop_for(controller, 0), turned=turned))
        except DataError as error:
            raise NotApplicableError(f"it refuses several recordings: {error}") from error
        test_loop = TestLoop(plant, controller)
        test_loop.step()
        first.append(test_loop.result().u)
    if not np.abs(first[0] - first[1]).max() <= _SAME_LAW * plant.input_limit:
        raise CheckFailedError(
            f"the first inputs are {first[0][0].tolist()} with two recordings, {first[1][0].tolist()} with "
            "the second one first; no window may cross one of recording.seams: see recording.pieces"
        )


def _require_approach(subject: ControllerUnderTest, plant: ReferencePlant, controller: Controller) -> None:
    run = subject.run(plant, controller)
    target = plant.target()
    final = np.abs(run.y[-subject.steps // 4 :] - target).max(axis=0)
    if not (final < np.abs(target)).all():
        raise CheckFailedError(
            f"the outputs of x' = u - x begin {np.abs(target).tolist()} off their references and end "
            f"{final.round(4).tolist()} off"
        )


def _attempt(test_loop: TestLoop, seen: FloatArray | None, when: str) -> None:
    try:
        test_loop.step(seen)
    except CheckFailedError:
        raise
    except Exception as error:  # a third party's controller can fail in any way
        raise CheckFailedError(
            f"step raised {type(error).__name__} {when}: {error}; return an Action with a status instead"
        ) from error


def _require_not_silent(test_loop: TestLoop, missing: FloatArray, steps: int) -> None:
    """Require an error, inputs that are not finite, or a status, soon after NaN."""
    for _ in range(steps):
        test_loop.step()
    try:
        for seen in (missing, *[None] * (steps - 1)):
            test_loop.step(seen)
    except CheckFailedError:
        raise
    except Exception:  # an error is one of the ways to say so
        return
    run = test_loop.result()
    if np.isfinite(run.u).all():
        _require_reported(run, steps)


def _require_reported(run: LoopResult, since: int) -> None:
    if all(status == OK for status in run.status[since:]):
        raise CheckFailedError("a measurement of NaN passes without a status other than 'ok'")


def _require_within(plant: ReferencePlant, run: LoopResult) -> None:
    if not np.isfinite(run.u).all():
        k = int(np.argwhere(~np.isfinite(run.u))[0, 0])
        raise CheckFailedError(f"the inputs at sample {k} are {run.u[k].tolist()}")
    largest = np.abs(run.u).max()
    if largest > plant.input_limit:
        excess = f"an input is {largest!r} where {plant.input_limit!r} is allowed"
        raise CheckFailedError(f"{excess}; clip what is returned to loop.bounds")


def _require_equal(first: FloatArray, second: FloatArray, when: str) -> None:
    if not np.array_equal(first, second, equal_nan=True):
        k, i = (int(index) for index in np.argwhere(~(first == second))[0])
        raise CheckFailedError(
            f"the inputs differ {when}: {float(first[k, i])!r} and {float(second[k, i])!r} at sample {k}"
        )


def _settings_check(check: Callable[[Controller], None]) -> Callable[[ControllerUnderTest], None]:
    def run(subject: ControllerUnderTest) -> None:
        check(subject.make_controller())

    run.__name__ = check.__name__
    return run


CONTROLLER_CHECKS: Mapping[str, Callable[[ControllerUnderTest], None]] = {
    check.__name__.replace("_", " "): check
    for check in (
        _settings_check(stores_its_settings),
        _settings_check(refuses_unknown_settings),
        _settings_check(refuses_impossible_settings),
        returns_one_input_for_one_output,
        returns_two_inputs_for_two_outputs,
        starts_with_the_recording_it_asks_for,
        is_deterministic_under_its_seed,
        forgets_a_run_when_started_again,
        can_be_pickled,
        two_instances_are_independent,
        keeps_no_array_that_it_is_given,
        respects_the_input_limits,
        reports_a_failure_as_a_status,
        handles_a_missing_measurement_as_declared,
        knows_its_horizon_before_its_start,
        stabilises_the_reference_plant,
        stabilises_it_without_preview,
        learns_from_no_window_across_a_seam,
    )
}
