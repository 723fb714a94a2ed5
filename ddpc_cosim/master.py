"""The co-simulation master: one closed loop, sample by sample.

Time is counted in samples: sample k is at ``t0 + k * sampling_time``, computed and never accumulated.
At every sample the plant is measured, the controller decides, the row is written, and the plant holds the
inputs until the next sample. The experiment that records data is the same loop with an exciting controller.
"""

import os
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import wraps
from typing import Any, NamedTuple, ParamSpec, TypeVar

import numpy as np

from ddpc_cosim.conditions import Conditions
from ddpc_cosim.controller import OK, Action, Bounds, Controller, Loop, Recording, Sample
from ddpc_cosim.data_quality import recording_warnings
from ddpc_cosim.errors import (
    ConfigError,
    ControllerError,
    DataError,
    DivergenceError,
    FMUStepError,
    StepStatus,
    is_of_the_machine,
)
from ddpc_cosim.excitations import Excitation, sampling_faults
from ddpc_cosim.loop_setup import (
    CONTROLLER_STREAM,
    STABILISER_STREAM,
    LoopSetup,
    check_events,
    end_time,
    excitation_table,
    whole_steps,
)
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.plant_control import PlantControl
from ddpc_cosim.processes.fork_server import ONE_THREAD
from ddpc_cosim.processes.rows import RowStore
from ddpc_cosim.safe_calls import (
    NotFiniteError,
    ask_controller,
    clip_inputs,
    controller_diagnostics,
    controller_knowledge,
    controller_settings,
    controller_warnings,
    does_accept_missing,
    horizon_of,
    learns_from_recording,
    plant_provenance,
    require_finite,
    reset_plant,
    set_plant_parameters,
    start_controller,
    step_plant,
)
from ddpc_cosim.signals import GaussianNoise, ParameterChange, Reference
from ddpc_cosim.trace import Outcome, Trace
from ddpc_cosim.variables import FloatArray

OUTCOME_OF = {
    StepStatus.ERROR: Outcome.FMU_ERROR,
    StepStatus.DISCARD: Outcome.FMU_DISCARDED,
    StepStatus.FATAL: Outcome.FMU_FATAL,
    StepStatus.CRASHED: Outcome.CRASHED,
    StepStatus.TIMED_OUT: Outcome.TIMED_OUT,
    StepStatus.TERMINATED: Outcome.TERMINATED,
}

EARLY = 1e-6
"""How far a sample time can lie before the instant it stands for, in sampling times."""


P = ParamSpec("P")
T = TypeVar("T")


def _on_one_thread(function: Callable[P, T]) -> Callable[P, T]:
    """Have linear algebra done on one thread, in any process as in a worker, whose environment says it."""

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> T:
        if os.environ.items() >= ONE_THREAD.items():
            return function(*args, **kwargs)
        from threadpoolctl import threadpool_limits  # a worker does without

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


@_on_one_thread
def cosimulate(
    plant: Plant,
    controller: Controller | None,
    *,
    sampling_time: float,
    duration: float,
    reference: Reference | Mapping[str, Reference],
    excitation: Excitation | None = None,
    stabiliser: Controller | None = None,
    recording: Recording | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    outputs: Sequence[str] | None = None,
    measurements: Sequence[str] | None = None,
    parameters: Mapping[str, ParameterValue] | None = None,
    noise: GaussianNoise | None = None,
    conditions: Conditions | None = None,
    events: Sequence[ParameterChange] = (),
    preview: int | None = None,
    seed: int = 0,
    start_time: float = 0.0,
    continue_recording: bool = False,
    store: RowStore | None = None,
) -> Trace:
    """Run one closed loop of a plant and a controller.

    Parameters
    ----------
    plant : Plant
        The plant; it is reset here, and stays open.
    controller : Controller or None
        The controller; it is started here. None: the plant runs in open loop, on the signals of its inputs
        (``conditions``), the others at rest; outputs are measured and none is controlled.
    sampling_time, duration : float
        Time between samples and simulated time [s]; the duration is an integer multiple of the sampling time.
    reference : Reference or mapping of str to Reference
        Reference of the controlled output, or of each by name, in their units.
    excitation : Excitation, optional
        The experiment to record before the loop is closed.
    stabiliser : Controller, optional
        Controls the plant during the experiment, on the same references from its start; the excitation is
        added to its inputs. Without one the experiment is in open loop.
    recording : Recording, optional
        A recording made before, in place of ``excitation``.
    bounds : mapping of str to (float, float), optional
        Limits of inputs and controlled outputs by name; default: the plant's own min and max. Inputs beyond
        them are clipped, which counts as a fallback of the controller.
    outputs, measurements : sequence of str, optional
        Which of the plant's outputs are controlled and which are measured; default: all.
    parameters : mapping of str to float, int, bool or str, optional
        Plant parameters of this run.
    noise : GaussianNoise, optional
        Noise of the measurements.
    conditions : Conditions, optional
        Disturbances, signals of inputs that the controller does not drive, and what actuators and sensors do.
    events : sequence of ParameterChange, optional
        Tunable parameters that change during the run, before its end.
    preview : int, optional
        How many future references a controller may see, whatever its horizon; it is handed the last of them
        in place of those that follow. Default: no limit.
    seed : int
        Seed of noise and conditions and of the controller's random numbers.
    start_time : float
        Time of the first sample [s].
    continue_recording : bool
        Close the loop where the experiment ended instead of starting from rest.
    store : RowStore, optional
        Where the rows are written, one per sample of this loop; default: in memory.

    Returns
    -------
    trace : Trace
        The samples of the run, n + 1 rows for n sampling intervals if it completed. A fault of the plant or
        of the controller during the run ends it, and so does a parameter change that the plant refuses: the
        outcome says how, the reason why and when.

    Raises
    ------
    CosimError
        What can be known before the first sample: settings, signals and data that do not fit, a parameter
        change after the end of the run, a plant that cannot be initialised.
    """
    signals = (outputs, measurements, bounds, noise, conditions)
    setup = LoopSetup(plant, sampling_time, *signals, seed, preview, open_loop=controller is None)
    controller = controller or _NoController()
    steps = whole_steps(duration, sampling_time)
    end = end_time(start_time, steps, sampling_time)
    check_events(events, end)
    if excitation is not None and recording is not None:
        raise ConfigError("give an excitation or a recording, not both")
    if excitation is None and stabiliser is not None:
        raise ConfigError("stabiliser needs an excitation, which is added to its inputs")
    if excitation is None and continue_recording:
        raise ConfigError(
            "continue_recording needs an excitation: the experiment whose end the loop starts from"
        )
    learns = learns_from_recording(controller)
    if learns and excitation is None and recording is None:
        raise DataError(
            f"{type(controller).__name__} learns from a recording; give an excitation or a recording"
        )
    diagnostics: dict[str, float] = {}
    if excitation is not None:
        onwards = duration if continue_recording else 0.0
        experiment = _experiment(setup, excitation, stabiliser, reference, parameters, onwards)
        recording, y_plant = experiment.recording, experiment.y_plant
        if stabiliser is not None:
            diagnostics["stabiliser_fallbacks"] = experiment.fallbacks
    switched = setup.switched(controller)
    if not continue_recording:
        plant.plan(sampling_time, end)
        y_plant = reset_plant(plant, {**(parameters or {}), **switched} or parameters, start_time)
    elif isinstance(controller, PlantControl):  # it takes over from who drove the experiment
        set_plant_parameters(plant, switched, start_time)
    horizon = horizon_of(controller)
    loop = setup.loop(CONTROLLER_STREAM, horizon, recording, continues=continue_recording)
    start_controller(controller, loop)
    settings = controller_settings(controller)
    knowledge = controller_knowledge(controller, loop)
    time = start_time + np.arange(steps + 1 + loop.preview, dtype=np.float64) * sampling_time
    table = setup.references(reference, time)
    warnings = recording_warnings(loop, table) if learns else ()
    warnings += controller_warnings(controller)
    rows = _Rows(setup, loop, time, table, steps + 1, horizon, store)
    accepts_missing = conditions is None or not conditions.loses or does_accept_missing(controller)
    setup.start(rows.time, continues=continue_recording, accepts_missing=accepts_missing)
    outcome, reason, transient = _closed_loop(setup, controller, rows, y_plant, events)
    try:
        diagnostics = controller_diagnostics(controller) | diagnostics
    except ControllerError as error:
        if outcome is Outcome.COMPLETED:
            outcome, reason = Outcome.CONTROLLER_ERROR, f"after the last sample: {error}"
    return Trace(
        **rows.written(),
        inputs=setup.inputs,
        changed_inputs=setup.changed_inputs,
        outputs=setup.outputs,
        measurements=setup.measurements,
        bounds=setup.bounds,
        sampling_time=sampling_time,
        planned_samples=steps + 1,
        preview=loop.preview,
        outcome=outcome,
        reason=reason,
        transient=transient,
        settings=settings,
        diagnostics=diagnostics,
        recorded_samples=len(recording) if recording is not None and learns else 0,
        knowledge=knowledge,
        provenance=plant_provenance(plant),  # after the run, of which it may have something to say
        warnings=warnings,
    )


@_on_one_thread
def record(
    plant: Plant,
    excitation: Excitation,
    *,
    sampling_time: float,
    stabiliser: Controller | None = None,
    reference: Reference | Mapping[str, Reference] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    outputs: Sequence[str] | None = None,
    measurements: Sequence[str] | None = None,
    parameters: Mapping[str, ParameterValue] | None = None,
    noise: GaussianNoise | None = None,
    conditions: Conditions | None = None,
    preview: int | None = None,
    seed: int = 0,
) -> Recording:
    """Run an experiment from the plant's initial state; parameters as in :func:`cosimulate`.

    Only a stabiliser follows ``reference``, which it needs, and keeps ``bounds``.
    """
    setup = LoopSetup(plant, sampling_time, outputs, measurements, bounds, noise, conditions, seed, preview)
    return _experiment(setup, excitation, stabiliser, reference or {}, parameters).recording


class ExcitingController(Controller):
    """The controller of an experiment: an excitation, alone or added to a stabilising controller's inputs.

    Parameters
    ----------
    excitation : array, shape (T, m)
        What is applied or added at each sample.
    stabiliser : Controller or None
        Keeps the plant meanwhile.
    """

    def __init__(self, excitation: FloatArray, stabiliser: Controller | None) -> None:
        self._excitation, self._stabiliser = excitation, stabiliser
        self.horizon = 0 if stabiliser is None else horizon_of(stabiliser)
        self.seen: list[FloatArray] = []
        self.fallbacks = 0

    def start(self, loop: Loop) -> None:
        """Start the stabilising controller."""
        if self._stabiliser is not None:
            if learns_from_recording(self._stabiliser):
                name = type(self._stabiliser).__name__
                raise ConfigError(f"stabiliser: {name} learns from a recording itself")
            start_controller(self._stabiliser, loop)

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the excited inputs, shape (m,), and keep the controlled outputs as they were measured."""
        self.seen.append(sample.y.copy())
        excitation: FloatArray = self._excitation[sample.k]
        if self._stabiliser is None:
            return excitation
        u, status, *_ = ask_controller(self._stabiliser, sample, len(excitation))
        self.fallbacks += status != OK
        return Action(u + excitation, status)


class _NoController(Controller):
    """What stands in the loop where the plant runs in open loop: it drives nothing."""

    def start(self, loop: Loop) -> None:
        """Prepare nothing."""

    def step(self, sample: Sample) -> FloatArray:
        """Return no inputs, shape (0,)."""
        return np.empty(0)


class _Experiment(NamedTuple):
    """A recording, the plant's outputs at its end, and how often the stabilising controller fell back."""

    recording: Recording
    y_plant: FloatArray
    fallbacks: int


def _experiment(
    setup: LoopSetup,
    excitation: Excitation,
    stabiliser: Controller | None,
    reference: Reference | Mapping[str, Reference],
    parameters: Mapping[str, ParameterValue] | None,
    onwards: float = 0.0,
) -> _Experiment:
    """Excite a plant from its initial state and record it; ``onwards`` [s] are to follow."""
    plant, sampling_time = setup.plant, setup.sampling_time
    if faults := sampling_faults(excitation, sampling_time):
        raise ConfigError(faults)
    inputs = excitation_table(excitation, len(setup.inputs))
    exciting = ExcitingController(inputs, stabiliser)
    loop = setup.loop(STABILISER_STREAM, exciting.horizon)
    start_controller(exciting, loop)
    time = np.arange(len(inputs) + loop.preview, dtype=np.float64) * sampling_time
    if stabiliser is not None:
        table = setup.references(reference, time)
    else:  # an excitation alone follows no reference, and is applied beyond the limits of the loop too
        table = np.zeros((len(time), len(setup.outputs)))
        loop = replace(loop, bounds=_no_bounds(loop))
    plant.plan(sampling_time, len(inputs) * sampling_time + onwards)
    y_plant = reset_plant(plant, {**(parameters or {}), **setup.switched(exciting)} or parameters, 0.0)
    rows = _Rows(setup, loop, time, table, len(inputs), exciting.horizon)
    setup.start(rows.time, in_experiment=True)
    try:
        y_plant = _run(setup, exciting, rows, y_plant, hold_last=True)
    except NotFiniteError as error:
        kind = "open-loop" if stabiliser is None else "closed-loop"
        when = f"at t = {rows.next_time:g} s"
        raise DivergenceError(f"the plant diverged during the {kind} experiment, {when}: {error}") from error
    except FMUStepError as error:
        raise FMUStepError(f"{error.message}, during the experiment", error.status, error.time) from error
    except ControllerError as error:
        raise ControllerError(f"{error}, during the experiment, at t = {rows.last_time:g} s") from error
    recording = Recording(rows.store.u, np.array(exciting.seen), rows.store.measured, sampling_time)
    return _Experiment(recording, y_plant, exciting.fallbacks)


def _no_bounds(loop: Loop) -> Bounds:
    u_max, y_max = np.full(len(loop.inputs), np.inf), np.full(len(loop.outputs), np.inf)
    return Bounds(-u_max, u_max, -y_max, y_max)


class _Rows:
    """The rows of a run, with the time and the references that controllers may look at."""

    def __init__(
        self,
        setup: LoopSetup,
        loop: Loop,
        time: FloatArray,
        reference: FloatArray,
        rows: int,
        horizon: int,
        store: RowStore | None = None,
    ) -> None:
        self.time, self.reference = time[:rows], reference
        self.horizon, self._sees_all = horizon, loop.preview >= horizon
        self._ahead = np.minimum(np.arange(1, horizon + 1), loop.preview)
        self.start, self.sampling_time, self.bounds = float(time[0]), loop.sampling_time, loop.bounds
        columns = len(loop.outputs), len(loop.measurements), len(loop.inputs)
        self.store = store or RowStore(rows, *columns, changed_inputs=len(setup.changed_inputs))
        self.store.reference[:] = reference[:rows]

    @property
    def count(self) -> int:
        """How many rows have been begun."""
        return self.store.count

    @property
    def last_time(self) -> float:
        """Time of the last row written [s]."""
        return float(self.time[self.count - 1])

    @property
    def next_time(self) -> float:
        """Time of the row to be written next [s], which may be one after the last."""
        return self.start + self.count * self.sampling_time

    def future(self, k: int) -> FloatArray:
        """Return the references after sample k, shape (horizon, p), as far as they may be seen."""
        if self._sees_all:
            return self.reference[k + 1 : k + 1 + self.horizon]
        visible: FloatArray = self.reference[k + self._ahead]
        visible.setflags(write=False)
        return visible

    def written(self) -> dict[str, Any]:
        """Return the rows up to the last one that was written."""
        return {"time": self.time[: self.count], **self.store.written()}


def _closed_loop(
    setup: LoopSetup,
    controller: Controller,
    rows: _Rows,
    y_plant: FloatArray,
    events: Sequence[ParameterChange],
) -> tuple[Outcome, str, bool]:
    """Run to the end and return how it ended, why, and whether that is the machine's fault.

    Faults during the run are outcomes, not exceptions.
    """
    try:
        _run(setup, controller, rows, y_plant, events=events)
    except ConfigError as error:  # the plant refuses an event
        if rows.count == 0:
            raise
        return Outcome.FMU_ERROR, f"{error} at t = {rows.next_time:g} s", is_of_the_machine(error)
    except FMUStepError as error:
        return OUTCOME_OF[error.status], str(error), is_of_the_machine(error)
    except NotFiniteError as error:
        return Outcome.DIVERGED, f"{error} at t = {rows.next_time:g} s", False
    except ControllerError as error:
        return Outcome.CONTROLLER_ERROR, f"{error} at t = {rows.last_time:g} s", is_of_the_machine(error)
    return Outcome.COMPLETED, "", False


def _run(
    setup: LoopSetup,
    controller: Controller,
    rows: _Rows,
    y_plant: FloatArray,
    *,
    events: Sequence[ParameterChange] = (),
    hold_last: bool = False,
) -> FloatArray:
    """Run sample by sample and return the plant's last outputs: those of the last row, or after it."""
    plant, h, last = setup.plant, setup.sampling_time, len(rows.time) - 1
    pending = deque(sorted(events, key=lambda event: event.time))
    require_finite(y_plant, plant)
    for k, time in enumerate(rows.time):
        while pending and pending[0].time <= time + EARLY * h:
            set_plant_parameters(plant, pending.popleft().parameters, time)
        applied = _write_row(setup, controller, rows, k, y_plant)
        if k < last or hold_last:
            y_plant = step_plant(plant, applied, h, time)
            require_finite(y_plant, plant)
    return y_plant


def _write_row(
    setup: LoopSetup, controller: Controller, rows: _Rows, k: int, y_plant: FloatArray
) -> FloatArray:
    """Measure the plant at sample k, let the controller decide, and keep both in row k.

    Returns what the plant is to hold until the next sample, a value for each of its inputs.
    """
    y, seen, measured, status = setup.measure(k, y_plant)
    rows.store.begin(k, y, measured)
    sample = Sample(k, float(rows.time[k]), seen, measured, rows.future(k), rows.reference[k])
    decision = ask_controller(controller, sample, rows.store.u.shape[1]).with_status(status)
    held = clip_inputs(decision, rows.bounds)
    applied = setup.actuators.apply(k, held.u)
    given = setup.actuators.changed(applied)
    rows.store.complete(k, setup.commanded(controller, held.u), held.status, held.seconds, given, held.info)
    return applied
