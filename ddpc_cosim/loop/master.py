"""The co-simulation master: one closed loop, sample by sample.

Time is counted in samples: sample k is at ``t0 + k * sampling_time``, computed and never accumulated.
At every sample the plant is measured, the controller decides, the row is written, and the plant holds the
inputs until the next sample. The experiment that records data is the same loop with an exciting controller.
"""

import os
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property, wraps
from math import inf
from types import MappingProxyType
from typing import Any, NamedTuple, ParamSpec, Protocol, TypeVar, cast

import numpy as np

from ddpc_cosim.conditions import Conditions
from ddpc_cosim.controller import OK, Action, Controller, Loop, Recording, Sample
from ddpc_cosim.errors import (
    ConfigError,
    ControllerError,
    DataError,
    DivergenceError,
    FMUStepError,
    StepStatus,
    is_of_the_machine,
)
from ddpc_cosim.files.durations import shown
from ddpc_cosim.loop.data_quality import recording_warnings
from ddpc_cosim.loop.outlook import Limit, Limits, Outlook, Wanted, Wish
from ddpc_cosim.loop.plant_control import PlantControl
from ddpc_cosim.loop.safe_calls import (
    Decision,
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
    resume_plant,
    serialise_plant,
    set_plant_parameters,
    start_controller,
    step_plant,
)
from ddpc_cosim.loop.setup import (
    CONTROLLER_STREAM,
    STABILISER_STREAM,
    WARM_UP_STREAM,
    LoopSetup,
    Measured,
    check_events,
    check_kinds,
    end_time,
    excitation_table,
    whole_steps,
)
from ddpc_cosim.loop.trace import OWN_NOISE, Outcome, Trace
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.processes.fork_server import ONE_THREAD
from ddpc_cosim.processes.rows import RowStore
from ddpc_cosim.signals.disturbances import KnownDisturbance
from ddpc_cosim.signals.excitations import Excitation, sampling_faults
from ddpc_cosim.signals.prices import Price
from ddpc_cosim.signals.signals import Band, GaussianNoise, ParameterChange, Reference
from ddpc_cosim.variables import FloatArray

OUTCOME_OF = {
    StepStatus.ERROR: Outcome.FMU_ERROR,
    StepStatus.DISCARD: Outcome.FMU_DISCARDED,
    StepStatus.FATAL: Outcome.FMU_FATAL,
    StepStatus.CRASHED: Outcome.CRASHED,
    StepStatus.TIMED_OUT: Outcome.TIMED_OUT,
    StepStatus.TERMINATED: Outcome.TERMINATED,
}


class Resumption(NamedTuple):
    """The state of another run of a plant, which a run goes on from.

    Parameters
    ----------
    state : bytes
        What ``serialise_state`` of the plant returned.
    reset_time : float
        When the plant was reset in the run that it was saved in [s]; it is reset so before it goes on.
    samples : int
        The number of the first sample, counted from the start time of the run that goes on.
    changed : mapping of str to float, int, bool or str
        Tunable parameters that differ from there on.
    """

    state: bytes
    reset_time: float
    samples: int = 0
    changed: Mapping[str, ParameterValue] = MappingProxyType({})


class Run(NamedTuple):
    """A run that is about to begin: what an engine other than this module's own loop has to know of it.

    Parameters
    ----------
    setup : LoopSetup
        The loop, whose actuators and sensors have been started.
    controller : Controller
        The controller, which has been started.
    loop : Loop
        What it was started with.
    outlook : Outlook
        What it may look at.
    store : RowStore
        Where the rows go.
    seen : array, shape (K, p), or None
        Where controlled outputs go as they are seen, if these are wanted.
    d : array, shape (K, disturbances)
        Where known disturbances go as they are measured.
    y_plant : array
        The plant's outputs.
    first : int
        The number of its first sample since the plant was set up.
    """

    setup: LoopSetup
    controller: Controller
    loop: Loop
    outlook: Outlook
    store: RowStore
    seen: FloatArray | None
    d: FloatArray
    y_plant: FloatArray
    first: int


class RunOfEngine(Protocol):
    """A run in another engine."""

    def advance(self, begin: int, end: int, *, hold_last: bool) -> FloatArray:
        """Run rows from ``begin`` up to and without ``end``; return the plant's outputs then.

        After the last of them the plant is advanced too where it is to hold the inputs.
        """


class Engine(Protocol):
    """Takes up runs in place of this module's own loop.

    Attributes
    ----------
    experiment : Stretch or None
        The last experiment without a stabilising controller, all of which it has taken up. It stands for that
        of the next run too, unless it is taken away: by whoever has a run with another experiment.
    used : str
        ``"compiled"`` if the last run was taken up.
    """

    experiment: "Stretch | None"
    used: str

    def start(self, controller: Controller, loop: Loop) -> None:
        """Start a controller, as :func:`ddpc_cosim.loop.safe_calls.start_controller` does."""

    def __call__(self, run: Run) -> RunOfEngine | None:
        """Take up a run, or return None, and it is made here."""


class NeedsPythonError(Exception):
    """An engine gives up a loop that it has taken up, which is to be run without one, from its beginning."""


_NOTHING: FloatArray = np.empty(0)
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


Question = tuple[Controller, Sample, int]
"""Who is asked what at a sample, and for how many inputs."""
Steps = Generator[Question, Decision, T]
"""A run that stops at every sample until it is told what was decided there."""


def answer(run: Steps[Any], question: Question) -> Question:
    """Ask the controller, let the run go on with what it decides, and return what that asks next.

    Raises
    ------
    StopIteration
        The run has ended, with its result.
    """
    try:
        decision = ask_controller(*question)
    except ControllerError as error:
        return run.throw(error)
    return run.send(decision)


def _driven(run: Steps[T]) -> T:
    """Run to the end, by what controllers decide, and return the result."""
    try:
        question = next(run)
        while True:
            question = answer(run, question)
    except StopIteration as end:
        return cast("T", end.value)


def cosimulate(
    plant: Plant,
    controller: Controller | None,
    *,
    sampling_time: float,
    duration: float,
    reference: Reference | Band | Wanted,
    excitation: Excitation | None = None,
    stabiliser: Controller | None = None,
    recording: Recording | None = None,
    bounds: Mapping[str, tuple[Limit, Limit]] | None = None,
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
    disturbances: Mapping[str, KnownDisturbance] | None = None,
    recorded_disturbances: Mapping[str, Reference] | None = None,
    recording_start: float | None = None,
    forecast_horizon: int | None = None,
    prices: Mapping[str, Price] | None = None,
    monitors: Mapping[str, Band | None] | None = None,
    communication_step: float | None = None,
    warm_up: float = 0.0,
    warm_up_controller: Controller | None = None,
    resumed: Resumption | None = None,
    keeps_state: bool = False,
    store: RowStore | None = None,
    engine: Engine | None = None,
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
    reference : Reference, Band, or mapping of str to these
        Reference of the controlled output, or of each by name, in their units; a band in place of a line.
        None at all, ``{}``, under :class:`PlantControl`: outputs are measured only.
    excitation : Excitation, optional
        The experiment to record before the loop is closed.
    stabiliser : Controller, optional
        Controls the plant during the experiment, on the same references from its start; the excitation is
        added to its inputs. Without one the experiment is in open loop.
    recording : Recording, optional
        A recording made before, in place of ``excitation``.
    bounds : mapping of str to (float or Reference, float or Reference), optional
        Limits of inputs and controlled outputs by name, signals where they change with time; default: the
        plant's own min and max. Inputs beyond them are clipped, which counts as a fallback of the controller.
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
    disturbances : mapping of str to KnownDisturbance, optional
        Inputs that no controller drives, or measured outputs, of which controllers know, by name.
    recorded_disturbances : mapping of str to Reference, optional
        Signals of some of these inputs in the experiment, in place of their own course.
    recording_start : float, optional
        When the experiment begins [s]; default: at 0, with disturbances so that it ends where the loop
        begins.
    forecast_horizon : int, optional
        The longest horizon of all controllers that are compared, on which the size of errors of forecasts
        depends; default: that of this controller.
    prices : mapping of str to Price, optional
        What signals cost, by name.
    monitors : mapping of str to (Band or None), optional
        Outputs that are kept in the trace, as they are, whether or not a controller sees them; each with the
        band that it is wanted within, or None.
    communication_step : float, optional
        How far the plant is advanced at once [s], of which the sampling time is an integer multiple; default:
        the sampling time. Inputs are held over the sampling interval all the same; what is paid, and key
        figures, then come from what controlled, charged and monitored outputs are at each of these steps.
    warm_up : float
        How long the plant runs before the first sample [s], which is not part of the trace.
    warm_up_controller : Controller, optional
        Controls it meanwhile; default: inputs rest, and the plant's own control acts where it has one.
    resumed : Resumption, optional
        The state of another run that the plant goes on from, on the samples of that run if ``start_time`` is
        that run's; default: the plant starts anew.
    keeps_state : bool
        Whether another run may go on from this one: its trace has the plant's state at the last sample, and
        the plant is told no stop time.
    store : RowStore, optional
        Where the rows are written, one per sample of this loop; default: in memory.
    engine : callable, optional
        What computes the samples where it can, such as the compiled engine, with the
        same results but for times of steps and what controllers tell of them; default: this loop.

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
    check_kinds(
        reference=reference,
        excitation=excitation,
        stabiliser=stabiliser,
        recording=recording,
        bounds=bounds,
        noise=noise,
        conditions=conditions,
        events=events,
        disturbances=disturbances,
        recorded_disturbances=recorded_disturbances,
        recording_start=recording_start,
        forecast_horizon=forecast_horizon,
        prices=prices,
        monitors=monitors,
        warm_up=warm_up,
        warm_up_controller=warm_up_controller,
    )
    loop = ClosedLoop(
        plant,
        controller,
        sampling_time=sampling_time,
        duration=duration,
        reference=reference,
        stabiliser=stabiliser,
        bounds=bounds,
        outputs=outputs,
        measurements=measurements,
        noise=noise,
        conditions=conditions,
        events=events,
        preview=preview,
        start_time=start_time,
        continue_recording=continue_recording,
        disturbances=disturbances,
        recorded_disturbances=recorded_disturbances,
        recording_start=recording_start,
        forecast_horizon=forecast_horizon,
        prices=prices,
        monitors=monitors,
        communication_step=communication_step,
        warm_up=warm_up,
        warm_up_controller=warm_up_controller,
        resumed=resumed,
        keeps_state=keeps_state,
    )
    mixture = noise.mixture if noise else ()
    return loop.run(OneRun(seed, parameters, excitation, recording, mixture), store, engine)


class OneRun(NamedTuple):
    """What runs of a closed loop differ by; all as of :func:`cosimulate`, ``mixture`` as of its noise."""

    seed: int
    parameters: Mapping[str, ParameterValue] | None = None
    excitation: Excitation | None = None
    recording: Recording | None = None
    mixture: Sequence[tuple[int, float]] = ()


@dataclass(eq=False)
class ClosedLoop:
    """A plant and a controller in a loop, for runs that differ by their seeds and what these decide.

    Parameters
    ----------
    plant, controller, ...
        As of :func:`cosimulate`; of the noise only its deviations.

    Raises
    ------
    ConfigError
        They do not fit, whatever the seed.
    """

    plant: Plant
    controller: Controller | None
    _: KW_ONLY
    sampling_time: float
    duration: float
    reference: Reference | Band | Wanted
    stabiliser: Controller | None = None
    bounds: Mapping[str, tuple[Limit, Limit]] | None = None
    outputs: Sequence[str] | None = None
    measurements: Sequence[str] | None = None
    noise: GaussianNoise | None = None
    conditions: Conditions | None = None
    events: Sequence[ParameterChange] = ()
    preview: int | None = None
    start_time: float = 0.0
    continue_recording: bool = False
    disturbances: Mapping[str, KnownDisturbance] | None = None
    recorded_disturbances: Mapping[str, Reference] | None = None
    recording_start: float | None = None
    forecast_horizon: int | None = None
    prices: Mapping[str, Price] | None = None
    monitors: Mapping[str, Band | None] | None = None
    communication_step: float | None = None
    warm_up: float = 0.0
    warm_up_controller: Controller | None = None
    resumed: Resumption | None = None
    keeps_state: bool = False

    def __post_init__(self) -> None:
        is_open_loop = self.controller is None
        self._driver = self.controller or _NoController(_NOTHING)
        self._setup = LoopSetup(
            self.plant,
            self.sampling_time,
            self.outputs,
            self.measurements,
            self.bounds,
            self.noise,
            self.conditions,
            self.preview,
            open_loop=is_open_loop,
            is_free=isinstance(self.controller, PlantControl) and self.reference == {},
            disturbances=self.disturbances,
            recorded_disturbances=self.recorded_disturbances,
            prices=self.prices,
            forecast_horizon=self.forecast_horizon,
            monitors=self.monitors,
            communication_step=self.communication_step,
        )
        reference = {} if self.reference is None else self.reference
        self._wanted = {} if is_open_loop else self._setup.wanted(reference)
        self._steps = whole_steps(self.duration, self.sampling_time)
        self._begun = 0 if self.resumed is None else self.resumed.samples
        self._end = end_time(self.start_time, self._begun + self._steps, self.sampling_time)
        check_events(self.events, self._end)

    @cached_property
    def _warm_up_steps(self) -> int:
        """How many sampling intervals there are before the first sample."""
        steps = whole_steps(self.warm_up, self.sampling_time) if self.warm_up else 0
        if steps > self._steps:
            lengths = f"warm_up = {self.warm_up:g} s is longer than the run, {self.duration:g} s"
            raise ConfigError(f"{lengths}; choose a shorter one")
        return steps

    @cached_property
    def _horizon(self) -> int:
        return horizon_of(self._driver)

    @cached_property
    def _time(self) -> FloatArray:
        """The times of all samples and of as many after them as the controller may look ahead [s]."""
        count = self._steps + 1 + self._horizon
        return self.start_time + (self._begun + np.arange(count, dtype=np.float64)) * self.sampling_time

    @cached_property
    def _ahead(self) -> tuple[Wish, Limits]:
        """What is wanted, and the limits, at all times that the controller sees."""
        visible = self._time[: self._steps + 1 + self._setup.preview_of(self._horizon)]
        return self._setup.wish(self._wanted, visible), self._setup.limits(visible)

    @_on_one_thread
    def run(self, this: OneRun, store: RowStore | None = None, engine: Engine | None = None) -> Trace:
        """Run once, by what the controller decides; all else as of :func:`cosimulate`."""
        return _driven(self.stepwise(this, store, engine))

    def stepwise(
        self, this: OneRun, store: RowStore | None = None, engine: Engine | None = None
    ) -> Steps[Trace]:
        """Run once, and leave it to the caller to ask the controller at every sample."""
        plant, controller, setup, parameters = self.plant, self._driver, self._setup, this.parameters
        excitation, recording, sampling_time = this.excitation, this.recording, self.sampling_time
        setup.draw_from(this.seed, this.mixture)
        self._check_choices(excitation, recording)
        first, samples = self._warm_up_steps, self._steps + 1
        learns = learns_from_recording(controller)
        if learns and excitation is None and recording is None:
            raise DataError(
                f"{type(controller).__name__} learns from a recording; give an excitation or a recording"
            )
        diagnostics: dict[str, float] = {}
        if excitation is not None:
            experiment = self._recorded(excitation, parameters, None if self.continue_recording else engine)
            recording, y_plant = experiment.recording, experiment.y_plant
            if self.stabiliser is not None:
                diagnostics["stabiliser_fallbacks"] = experiment.fallbacks
        begin = self.start_time - first * sampling_time
        own = PlantControl() if setup.has_switches else _NoController(setup.rest)
        warmer = self.warm_up_controller or own
        switched = setup.switched(controller)
        before = setup.switched(warmer) if first else switched
        if not self.continue_recording:
            plant.plan(setup.communication_step, inf if self.keeps_state else self._end)
            reset_at = begin if self.resumed is None else self.resumed.reset_time
            y_plant = reset_plant(plant, {**(parameters or {}), **before} or parameters, reset_at)
            if self.resumed is not None:
                y_plant = _resume(plant, self.resumed, begin + self._begun * sampling_time)
            if self.keeps_state:  # a plant that cannot is not to tell so after the run
                serialise_plant(plant, begin)
        elif isinstance(controller, PlantControl):  # it takes over from who drove the experiment
            set_plant_parameters(plant, switched, self.start_time)
        horizon = self._horizon
        later = max(horizon, horizon_of(warmer)) if setup.disturbances.looks_ahead else 0
        whole = begin + (self._begun + np.arange(first + samples + later, dtype=np.float64)) * sampling_time
        past, unknown = recording if self.continue_recording else None, tuple[str, ...]()
        if first:
            setup.start(whole, ahead=later)
            warm = _warm_up(setup, warmer, self._wanted, whole, first, y_plant)
            (past, unknown), y_plant = setup.taken_over(warmer, warm.recording), warm.y_plant
            if switched != before:
                set_plant_parameters(plant, switched, self.start_time)
        time, (wish, limits) = self._time, self._ahead
        loop = setup.loop(
            CONTROLLER_STREAM,
            horizon,
            limits,
            recording,
            is_band=wish.is_band,
            continues=self.continue_recording,
            past=past,
        )
        start = engine.start if engine else start_controller
        start(controller, loop)
        settings = controller_settings(controller)
        knowledge = controller_knowledge(controller, loop)
        warnings = recording_warnings(loop, wish.reference) if learns else ()
        warnings += controller_warnings(controller)
        warnings += () if isinstance(controller, PlantControl) else unknown
        rows = _Rows(setup, time[:samples], self._wanted, store)
        if not first:
            setup.start(whole, ahead=later, continues=self.continue_recording)
        if self.conditions is not None and self.conditions.loses:
            setup.hand_over(accepts_missing=does_accept_missing(controller))
        rows.look(setup.outlook(wish, limits, time, first, samples, horizon, loop.preview))
        outcome, reason, transient = yield from _closed_loop(
            setup, controller, loop, rows, y_plant, self.events, first, engine
        )
        try:
            diagnostics = controller_diagnostics(controller) | diagnostics
        except ControllerError as error:
            if outcome is Outcome.COMPLETED:
                outcome, reason = Outcome.CONTROLLER_ERROR, f"after the last sample: {error}"
        state = b""
        if self.keeps_state and outcome is Outcome.COMPLETED:
            try:
                state = serialise_plant(plant, self._end)
            except (ConfigError, FMUStepError) as error:
                outcome = OUTCOME_OF[error.status] if isinstance(error, FMUStepError) else Outcome.FMU_ERROR
                reason = f"after the last sample: {error}"
        return Trace(
            **rows.written(),
            state=state,
            inputs=setup.inputs,
            changed_inputs=setup.changed_inputs,
            outputs=setup.outputs,
            measurements=setup.measurements,
            bounds=limits.bounds,
            sampling_time=sampling_time,
            planned_samples=samples,
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
            disturbances=setup.disturbances.told,
            acting=(*setup.disturbances.declared, *([OWN_NOISE] if plant.is_noisy else [])),
            bands=loop.bands,
            moving_limits=limits.moving,
            charges=setup.charged.charges,
            monitors=setup.monitors,
            monitored_bands=setup.monitored_bands,
            substeps=setup.substeps,
            intersample_signals=tuple(plant.outputs[i] for i in setup.intersample),
        )

    def _check_choices(self, excitation: Excitation | None, recording: Recording | None) -> None:
        """Raise ConfigError for keywords that contradict each other."""
        faults = []
        if self.resumed is not None and (self.continue_recording or self.warm_up):
            faults.append("resumed goes with neither continue_recording nor warm_up: the plant has one start")
        if excitation is not None and recording is not None:
            faults.append("give an excitation or a recording, not both")
        if excitation is None and self.stabiliser is not None:
            faults.append("stabiliser needs an excitation, which is added to its inputs")
        if excitation is None and self.continue_recording:
            faults.append(
                "continue_recording needs an excitation: the experiment whose end the loop starts from"
            )
        if self.continue_recording and self.warm_up:
            faults.append(
                "warm_up does not go with continue_recording, where the loop goes on from the experiment"
            )
        if faults:
            raise ConfigError(faults)

    def _recorded(
        self,
        excitation: Excitation,
        parameters: Mapping[str, ParameterValue] | None,
        engine: Engine | None,
    ) -> "Stretch":
        """Return the experiment of a run, which the engine may have from another one."""
        if engine and engine.experiment:
            self._setup.pass_over(len(engine.experiment.recording))
            return engine.experiment
        onwards = self.duration if self.continue_recording else 0.0
        run = (self.start_time, self._end)
        experiment = _experiment(
            self._setup,
            excitation,
            self.stabiliser,
            self._wanted,
            parameters,
            self.recording_start,
            onwards,
            run,
            engine,
        )
        if engine and self.stabiliser is None and engine.used == "compiled":
            engine.experiment = experiment
        return experiment


def _resume(plant: Plant, resumed: Resumption, time: float) -> FloatArray:
    """Have a plant that has been reset go on from a state; return its outputs there, shape (p,)."""
    y_plant = resume_plant(plant, resumed.state, time)
    if resumed.changed:
        set_plant_parameters(plant, resumed.changed, time)
    return y_plant


@_on_one_thread
def record(
    plant: Plant,
    excitation: Excitation,
    *,
    sampling_time: float,
    stabiliser: Controller | None = None,
    reference: Reference | Band | Wanted | None = None,
    bounds: Mapping[str, tuple[Limit, Limit]] | None = None,
    outputs: Sequence[str] | None = None,
    measurements: Sequence[str] | None = None,
    parameters: Mapping[str, ParameterValue] | None = None,
    noise: GaussianNoise | None = None,
    conditions: Conditions | None = None,
    preview: int | None = None,
    seed: int = 0,
    disturbances: Mapping[str, KnownDisturbance] | None = None,
    recorded_disturbances: Mapping[str, Reference] | None = None,
    recording_start: float = 0.0,
) -> Recording:
    """Run an experiment from the plant's initial state; parameters as in :func:`cosimulate`.

    Only a stabiliser follows ``reference``, which it needs, and keeps ``bounds``.
    """
    check_kinds(
        excitation=excitation,
        stabiliser=stabiliser,
        reference=reference,
        bounds=bounds,
        noise=noise,
        conditions=conditions,
        disturbances=disturbances,
        recorded_disturbances=recorded_disturbances,
        recording_start=recording_start,
    )
    signals = (outputs, measurements, bounds, noise, conditions, preview)
    setup = LoopSetup(
        plant,
        sampling_time,
        *signals,
        disturbances=disturbances,
        recorded_disturbances=recorded_disturbances,
    )
    setup.draw_from(seed, noise.mixture if noise else ())
    wanted = {} if stabiliser is None else setup.wanted(reference or {})
    return _experiment(setup, excitation, stabiliser, wanted, parameters, recording_start).recording


class ExcitingController(Controller):
    """The controller of an experiment: an excitation, alone or added to a stabilising controller's inputs.

    Parameters
    ----------
    excitation : array, shape (T, m)
        What is applied or added at each sample.
    stabiliser : Controller or None
        Keeps the plant meanwhile.

    Attributes
    ----------
    fallbacks : int
        At how many samples that could not do what it is to.
    """

    def __init__(self, excitation: FloatArray, stabiliser: Controller | None) -> None:
        self.excitation, self.stabiliser = excitation, stabiliser
        self.horizon = 0 if stabiliser is None else horizon_of(stabiliser)
        self.fallbacks = 0

    def start(self, loop: Loop) -> None:
        """Start the stabilising controller."""
        if self.stabiliser is not None:
            if learns_from_recording(self.stabiliser):
                name = type(self.stabiliser).__name__
                raise ConfigError(f"stabiliser: {name} learns from a recording itself")
            start_controller(self.stabiliser, loop)

    def step(self, sample: Sample) -> FloatArray | Action:
        """Return the excited inputs, shape (m,)."""
        excitation: FloatArray = self.excitation[sample.k]
        if self.stabiliser is None:
            return excitation
        u, status, *_ = ask_controller(self.stabiliser, sample, len(excitation))
        self.fallbacks += status != OK
        return Action(u + excitation, status)


class _NoController(Controller):
    """What stands in the loop where nothing controls the plant: inputs rest.

    Parameters
    ----------
    rest : array, shape (m,)
        Where they do; in open loop there are none.
    """

    def __init__(self, rest: FloatArray) -> None:
        self._rest = rest

    def start(self, loop: Loop) -> None:
        """Prepare nothing."""

    def step(self, sample: Sample) -> FloatArray:
        """Return the inputs at rest, shape (m,)."""
        return self._rest.copy()


class Stretch(NamedTuple):
    """What comes before a closed loop: its recording, the plant's outputs at its end, and fallbacks in it."""

    recording: Recording
    y_plant: FloatArray
    fallbacks: int = 0


def _warm_up(
    setup: LoopSetup,
    controller: Controller,
    wanted: Wanted,
    time: FloatArray,
    samples: int,
    y_plant: FloatArray,
) -> Stretch:
    """Run the first samples of a run that has been started under another controller."""
    horizon = horizon_of(controller)
    time = time[: samples + horizon]
    visible = time[: samples + setup.preview_of(horizon)]
    wish, limits = setup.wish(wanted, visible), setup.limits(visible)
    loop = setup.loop(WARM_UP_STREAM, horizon, limits, is_band=wish.is_band)
    if learns_from_recording(controller):
        raise ConfigError(f"warm_up_controller: {type(controller).__name__} learns from a recording itself")
    start_controller(controller, loop)
    rows = _Rows(setup, time[:samples], wanted, keeps_seen=True)
    preview = loop.preview
    rows.look(setup.outlook(wish, limits, time, 0, samples, horizon, preview, is_before=True))
    y_plant = _run_before(setup, controller, loop, rows, y_plant, "warm-up")
    return Stretch(rows.recording(holds=True), y_plant)


def _experiment(
    setup: LoopSetup,
    excitation: Excitation,
    stabiliser: Controller | None,
    wanted: Wanted,
    parameters: Mapping[str, ParameterValue] | None,
    begin: float | None,
    onwards: float = 0.0,
    run: tuple[float, float] | None = None,
    engine: Engine | None = None,
) -> Stretch:
    """Excite a plant from its initial state and record it.

    Parameters
    ----------
    begin : float or None
        When [s]; none: at 0, or, where there are disturbances, so that it ends where the run begins.
    onwards : float
        How long the plant is used afterwards [s].
    run : (float, float), optional
        When the run is that learns from it [s], whose own disturbances it must not have.
    engine : callable, optional
        As of :func:`cosimulate`.
    """
    plant, sampling_time = setup.plant, setup.sampling_time
    if faults := sampling_faults(excitation, sampling_time):
        raise ConfigError(faults)
    inputs = excitation_table(excitation, len(setup.inputs))
    samples = len(inputs)
    if begin is None:
        begin = run[0] - samples * sampling_time if run and setup.disturbances.declared else 0.0
    if run:
        setup.disturbances.check_unseen((begin, begin + samples * sampling_time), run)
    exciting = ExcitingController(inputs, stabiliser)
    horizon = exciting.horizon
    later = horizon if setup.disturbances.looks_ahead else 0
    time = begin + np.arange(samples + horizon, dtype=np.float64) * sampling_time
    visible = time[: samples + setup.preview_of(horizon)]
    if stabiliser is not None:
        wish, limits, stream = setup.wish(wanted, visible), setup.limits(visible), STABILISER_STREAM
    else:  # an excitation alone follows no reference, and is applied beyond the limits of the loop too
        wish, limits, stream, wanted = setup.no_wish(visible), setup.no_limits(visible), None, {}
    loop = setup.loop(stream, horizon, limits, is_band=wish.is_band)
    start_controller(exciting, loop)
    plant.plan(setup.communication_step, begin + samples * sampling_time + onwards)
    y_plant = reset_plant(plant, {**(parameters or {}), **setup.switched(exciting)} or parameters, begin)
    rows = _Rows(setup, time[:samples], wanted, keeps_seen=True)
    setup.start(time[: samples + later], ahead=later, in_experiment=True)
    preview = loop.preview
    rows.look(setup.outlook(wish, limits, time, 0, samples, horizon, preview, is_before=True))
    kind = "open-loop" if stabiliser is None else "closed-loop"
    what = "experiment", f"{kind} experiment"
    y_plant = _run_before(setup, exciting, loop, rows, y_plant, *what, engine=engine)
    recording = rows.recording()
    if stabiliser is not None:  # an excitation alone is the recorded inputs
        recording = replace(recording, excitation=inputs)
    return Stretch(recording, y_plant, exciting.fallbacks)


def _run_before(
    setup: LoopSetup,
    controller: Controller,
    loop: Loop,
    rows: "_Rows",
    y_plant: FloatArray,
    what: str,
    kind: str = "",
    engine: Engine | None = None,
) -> FloatArray:
    """Run what comes before the closed loop, whose faults are errors; return the plant's outputs after it."""
    try:
        return _driven(_run(setup, controller, loop, rows, y_plant, hold_last=True, engine=engine))
    except NotFiniteError as error:
        when = f"at t = {shown(rows.next_time)}"
        raise DivergenceError(f"the plant diverged during the {kind or what}, {when}: {error}") from error
    except FMUStepError as error:
        raise FMUStepError(f"{error.message}, during the {what}", error.status, error.time) from error
    except ControllerError as error:
        raise ControllerError(f"{error}, during the {what}, at t = {shown(rows.last_time)}") from error


class _Rows:
    """The rows of a run, and what controllers may look at from each of them.

    Parameters
    ----------
    setup : LoopSetup
        The loop.
    time : array, shape (K,)
        The times of its samples [s].
    wanted : mapping of str to (Reference or Band)
        What is wanted of the controlled outputs.
    store : RowStore, optional
        Where they are written; default: in memory.
    keeps_seen : bool
        Keep controlled outputs and disturbances as they were measured, for a recording.
    """

    def __init__(
        self,
        setup: LoopSetup,
        time: FloatArray,
        wanted: Wanted,
        store: RowStore | None = None,
        *,
        keeps_seen: bool = False,
    ) -> None:
        self.time, self._setup = time, setup
        if store is None:
            columns = len(setup.outputs), len(setup.measurements), len(setup.inputs)
            more, changed = setup.table_widths(wanted), len(setup.changed_inputs)
            store = RowStore(len(time), *columns, changed_inputs=changed, more=more)
        self.store = store
        self._seen: list[tuple[FloatArray, FloatArray]] | None = [] if keeps_seen else None
        self._elsewhere: tuple[FloatArray | None, FloatArray] = None, np.empty((0, 0))
        # Before the run there is nothing to monitor.
        self._monitored = None if keeps_seen else self.store.more.get("monitored")
        self._shift: FloatArray | None = None
        between = None if keeps_seen else self.store.more.get("intersample")
        self._intersample = (
            None if between is None else between.reshape(len(time), -1, len(setup.intersample))
        )

    def look(self, outlook: Outlook) -> None:
        """Take what controllers may look at, and keep what is known before the run."""
        self.outlook, count = outlook, len(self.time)
        self.store.clear()
        self.store.reference[:] = outlook.wish.reference[:count]
        price, emission = self._setup.charged.prices_at(self.time)
        inputs = len(self._setup.inputs)
        tables = {
            "band": outlook.wish.band,
            "input_limits": outlook.limits.table[:, :inputs],
            "output_limits": outlook.limits.table[:, inputs:],
            "price": price,
            "emission": emission,
        }
        if self._monitored is not None and "monitored_band" in self.store.more:
            tables["monitored_band"] = self._setup.monitored_band(self.time)
        for name in tables.keys() & self.store.more.keys():
            self.store.more[name][:] = tables[name][:count]
        if "charged" in self.store.more:  # what is not known yet
            self.store.more["charged"][:] = np.nan
        self._issues = range(0)
        if "forecast" in self.store.more:
            self._issues = self._setup.disturbances.issues(outlook.horizon, count)
            self.store.more["forecast"][:] = np.nan

    def run(self, controller: Controller, loop: Loop, y_plant: FloatArray, first: int) -> Run:
        """Return the run that is about to begin, for another engine."""
        seen = None if self._seen is None else np.empty_like(self.store.y)
        d = np.empty((len(self.time), len(self._setup.disturbances.declared)))
        self._elsewhere = seen, d
        return Run(self._setup, controller, loop, self.outlook, self.store, seen, d, y_plant, first)

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
        return float(self.time[0]) + self.count * self._setup.sampling_time

    def begin(self, k: int, first: int, y_plant: FloatArray) -> tuple[Sample, Measured]:
        """Measure the plant at sample k, keep that in row k, and return what a controller sees of it.

        The sample is that of number ``first`` + k since the plant was set up.
        """
        measured = self._setup.measure(first + k, y_plant)
        time = self.time.item(k)
        sample = self.outlook.sample(k, time, measured.seen, measured.measured, measured.told)
        if self.store.more:
            self._begin_further(k, measured, sample, y_plant)
        self.store.begin(k, measured.y, measured.measured)
        if self._seen is not None:
            self._seen.append((measured.seen.copy(), measured.d))
        if k in self._issues:
            self._keep_forecast(k, sample.forecast)
        return sample, measured

    def _begin_further(self, k: int, measured: Measured, sample: Sample, y_plant: FloatArray) -> None:
        """Keep in row k of the further tables what was measured."""
        setup, more = self._setup, self.store.more
        if self.outlook.has_bands:  # of what a controller sees, or of what is
            is_seen = measured.seen is measured.y
            self.store.reference[k] = sample.setpoint if is_seen else self.outlook.nearest(k, measured.y)
        if measured.told.size:
            more["d"][k] = measured.told
        if setup.charged.charges:
            setup.charged.keep_outputs(more["charged"][k], measured.all_outputs)
        if self._monitored is not None:
            self._monitored[k] = measured.all_outputs[setup.monitored]
        if self._intersample is not None:
            self._intersample[k] = np.nan
            # A disturbance of an output is held over the sampling interval.
            self._shift = None
            if measured.all_outputs is not y_plant:
                self._shift = measured.all_outputs[setup.intersample] - y_plant[setup.intersample]

    def complete(
        self, k: int, first: int, measured: Measured, decision: Decision, *, controls_itself: bool
    ) -> FloatArray:
        """Complete row k with what was decided, and return what the plant is to hold until the next sample.

        That is a value for each of its inputs; some are left to a plant that controls itself.
        """
        setup, store = self._setup, self.store
        if measured.status:
            decision = decision.with_status(measured.status)
        held = clip_inputs(decision, *self.outlook.input_limits(k))
        applied = setup.actuators.apply(first + k, held.u)
        if setup.charged.charges:
            setup.charged.keep_inputs(store.more["charged"][k], applied, controls_itself=controls_itself)
        given = setup.actuators.changed(applied)
        u = setup.commanded(held.u) if controls_itself and self._seen is None else held.u
        store.complete(k, u, held.status, held.seconds, given, held.info)
        return applied

    def write_between(self, k: int, i: int, y_plant: FloatArray) -> None:
        """Keep the plant's outputs at the end of communication step i < n - 1 of those after sample k."""
        if self._intersample is not None:
            y = y_plant[self._setup.intersample]
            self._intersample[k, i] = y if self._shift is None else y + self._shift

    def _keep_forecast(self, k: int, expected: FloatArray) -> None:
        """Keep what is expected of the samples after k in their rows."""
        rows = self.store.more["forecast"][k + 1 : k + 1 + len(expected)]
        rows[:] = expected[: len(rows)]

    def recording(self, *, holds: bool = False) -> Recording:
        """Return the rows as a recording, of all disturbances; ``holds``: the last value for what is lost."""
        seen, d = self._elsewhere
        if self._seen or seen is None:
            seen, d = map(np.array, zip(*self._seen or (), strict=True))
        measured: FloatArray = self.store.measured
        if holds:
            seen, measured = _held(seen), _held(measured)
        return Recording(self.store.u, seen, measured, self._setup.sampling_time, d=d)

    def written(self) -> dict[str, Any]:
        """Return the rows up to the last one that was written."""
        return {"time": self.time[: self.count], **self.store.written()}


def _held(values: FloatArray) -> FloatArray:
    """Return values, shape (T, n), the last one for each that is lost; before any has arrived, the first."""
    arrived = np.isfinite(values)
    if arrived.all():
        return values
    rows = np.maximum.accumulate(np.where(arrived, np.arange(len(values))[:, np.newaxis], -1), axis=0)
    return np.take_along_axis(values, np.where(rows < 0, arrived.argmax(axis=0), rows), axis=0)


def _closed_loop(
    setup: LoopSetup,
    controller: Controller,
    loop: Loop,
    rows: _Rows,
    y_plant: FloatArray,
    events: Sequence[ParameterChange],
    first: int,
    engine: Engine | None,
) -> Steps[tuple[Outcome, str, bool]]:
    """Run to the end and return how it ended, why, and whether that is the machine's fault.

    Faults during the run are outcomes, not exceptions.
    """
    try:
        yield from _run(setup, controller, loop, rows, y_plant, events=events, first=first, engine=engine)
    except ConfigError as error:  # the plant refuses an event
        if rows.count == 0:
            raise
        return Outcome.FMU_ERROR, f"{error} at t = {shown(rows.next_time)}", is_of_the_machine(error)
    except FMUStepError as error:
        return OUTCOME_OF[error.status], str(error), is_of_the_machine(error)
    except NotFiniteError as error:
        return Outcome.DIVERGED, f"{error} at t = {shown(rows.next_time)}", False
    except ControllerError as error:
        return Outcome.CONTROLLER_ERROR, f"{error} at t = {shown(rows.last_time)}", is_of_the_machine(error)
    return Outcome.COMPLETED, "", False


def _run(
    setup: LoopSetup,
    controller: Controller,
    loop: Loop,
    rows: _Rows,
    y_plant: FloatArray,
    *,
    events: Sequence[ParameterChange] = (),
    hold_last: bool = False,
    first: int = 0,
    engine: Engine | None = None,
) -> Steps[FloatArray]:
    """Run sample by sample and return the plant's last outputs: those of the last row, or after it.

    ``first`` is the number of its first sample since the plant was set up.
    """
    plant, h, last = setup.plant, setup.communication_step, len(rows.time) - 1
    pending, inputs = deque(sorted(events, key=lambda event: event.time)), len(setup.inputs)
    require_finite(y_plant, plant)
    elsewhere = engine(rows.run(controller, loop, y_plant, first)) if engine else None
    steps, controls_itself = setup.substeps, isinstance(controller, PlantControl)
    times, k = rows.time.tolist(), 0
    while k <= last:
        time = times[k]
        while pending and pending[0].time <= time + EARLY * setup.sampling_time:
            set_plant_parameters(plant, pending.popleft().parameters, time)
        if elsewhere is not None:
            end = _rows_before(pending[0].time, k, rows, setup.sampling_time) if pending else last + 1
            y_plant = elsewhere.advance(k, end, hold_last=hold_last or end <= last)
            k = end
            continue
        sample, measured = rows.begin(k, first, y_plant)
        decision = yield controller, sample, inputs
        applied = rows.complete(k, first, measured, decision, controls_itself=controls_itself)
        if k < last or hold_last:
            for i in range(steps):
                y_plant = step_plant(plant, applied, h, time + i * h)
                require_finite(y_plant, plant)
                if i + 1 < steps:
                    rows.write_between(k, i, y_plant)
        k += 1
    return y_plant


def _rows_before(time: float, k: int, rows: _Rows, sampling_time: float) -> int:
    """Return the number of the first row after k at which a change of this time [s] is due."""
    due = np.flatnonzero(rows.time[k + 1 :] + EARLY * sampling_time >= time)
    return k + 1 + int(due[0]) if due.size else len(rows.time)
