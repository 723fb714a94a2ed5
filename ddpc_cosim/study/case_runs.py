"""How one case is run."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from copy import deepcopy
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from ddpc_cosim.controller import Controller, Loop, Sample
from ddpc_cosim.errors import (
    ConfigError,
    CosimError,
    DivergenceError,
    FMUImportError,
    FMUStepError,
    is_of_the_machine,
)
from ddpc_cosim.files.durations import shown
from ddpc_cosim.loop import safe_calls
from ddpc_cosim.loop.logged import LoggedPlant, TakingOver
from ddpc_cosim.loop.master import (
    OUTCOME_OF,
    ClosedLoop,
    NeedsPythonError,
    OneRun,
    Steps,
    Stretch,
)
from ddpc_cosim.loop.outlook import Limits, intersample_signals, table_widths
from ddpc_cosim.loop.setup import communication_steps
from ddpc_cosim.loop.trace import Outcome, Trace
from ddpc_cosim.plant import Plant
from ddpc_cosim.processes.rows import RowStore
from ddpc_cosim.settings import PLANT, map_files, map_plants
from ddpc_cosim.signals.signals import Band, GaussianNoise, Reference
from ddpc_cosim.study.cases import Case, Replayed
from ddpc_cosim.study.controller_plugins import controller_class, make_controller
from ddpc_cosim.study.plants import PlantSpec
from ddpc_cosim.variables import FloatArray, names

if TYPE_CHECKING:  # a worker whose cases are not compiled does without
    from ddpc_cosim.compiled.engine import CompiledEngine

LOGGED_DATA = "logged data"
"""The provenance's name for what was done to logged data before anyone learned from them."""
_TRIED_AGAIN = "; the machine may be at fault: when this is run again, it is tried again"


def run_case(case: Case, store: RowStore | None = None) -> Trace:
    """Run one case; whatever goes wrong is in the trace's outcome and reason.

    Its rows, and what it is in, are written to a store, by default in memory.
    """
    return _with_remarks(case, _trace(case, store))


def run_alike(cases: Sequence[Case]) -> Iterator[Trace]:
    """Run cases of this project's controllers and plants that differ by these and seeds alone; yield traces.

    An FMU of theirs is unpacked and loaded once: no instance of it is known to another one. So is the loop of
    each controller made once: started again, it knows nothing of the run before. Where cases with the same
    seed follow each other, their experiment is made once.
    """
    kept, plant, prepared = ExitStack(), None, dict[str, _Prepared]()
    last: tuple[Any, Stretch | None] = None, None
    with kept:
        for case in cases:
            if plant is None and case.plant.fmu:
                with suppress(CosimError):  # which each case tells by itself
                    plant = _loaded(case, kept)
            if plant is None:
                yield run_case(case)
                continue
            store = row_store(case)
            safe_calls.announce_calls(store.announce)
            if case.controller not in prepared and case.engine == "compiled":
                with suppress(CosimError):  # as above
                    prepared[case.controller] = _Prepared.of(case, plant)
            of_case, experiment = prepared.get(case.controller), _decisive_in_experiment(case)
            if of_case is not None:
                of_case.engine.experiment = last[1] if experiment == last[0] else None
            trace = _run(case, plant, store, of_case)
            last = experiment, of_case and of_case.engine.experiment
            if trace.outcome is not Outcome.COMPLETED:
                kept.close()
                plant, last = None, (None, None)
                prepared.clear()
            yield _with_remarks(case, trace)


def _decisive_in_experiment(case: Case) -> tuple[Any, ...]:
    """Return by what experiments of cases differ that are of one problem and scenario.

    Controllers have limits of their own, of which those decide that do not move: where inputs rest.
    """
    limits = {
        name: [limit for limit in pair if not isinstance(limit, Reference)]
        for name, pair in case.bounds.items()
    }
    return case.seed, case.noise_mixture, case.parameters, limits


def _loaded(case: Case, kept: ExitStack) -> Plant:
    """Open a case's FMU, whose library stays loaded as long as it is kept."""
    from ddpc_cosim.fmu.library import kept_loaded
    from ddpc_cosim.fmu.plant import FMUPlant

    plant = open_plant(case)
    kept.callback(plant.close)
    assert isinstance(plant, FMUPlant)
    kept.enter_context(kept_loaded(plant.library))
    return plant


def _with_remarks(case: Case, trace: Trace) -> Trace:
    """Return a trace with what there is to say of it besides."""
    if case.plant.identified and case.plant.identified.ensemble:
        courses = {
            variable.name: course
            for signals, values in ((trace.inputs, trace.u), (trace.outputs, trace.y))
            for variable, course in zip(signals, values.T, strict=True)
        }
        trace = replace(trace, beyond_log=case.plant.identified.ensemble.beyond(courses))
    return replace(trace, reason=f"{trace.reason}{_TRIED_AGAIN}") if trace.transient else trace


def started(case: Case) -> tuple[Controller, Loop]:
    """Return the controller of a case as its loop starts, and the loop; experiments have been run.

    The random numbers of the loop are as they were before the controller started.

    Raises
    ------
    CosimError
        What keeps the loop from starting.
    """
    controller = controller_of(case)
    only_started = _OnlyStarted(controller)
    plant = open_plant(case)
    try:
        with suppress(_StartedError):
            _close_the_loop(case, plant, only_started, None)
    finally:
        with suppress(CosimError):  # the first error counts
            safe_calls.close_plant(plant)
    return controller, only_started.loop


def controller_of(case: Case) -> Controller:
    """Make the controller of a case.

    Raises
    ------
    CosimError
        It cannot be made, or there is none.
    """
    controller = _controller(case.section, case.plant)
    if controller is None:
        raise ConfigError(f'"{case.controller}" is not a controller: the plant runs in open loop')
    return controller


class _StartedError(CosimError):
    """The controller has been started, which is all that is wanted."""


class _OnlyStarted(Controller):
    """Starts another controller, keeps its loop, and ends the run there."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self.horizon = safe_calls.horizon_of(controller)

    @property
    def uses_recording(self) -> bool:
        return safe_calls.learns_from_recording(self._controller)

    def start(self, loop: Loop) -> None:
        self.loop = replace(loop, rng=deepcopy(loop.rng))
        safe_calls.start_controller(self._controller, loop)
        raise _StartedError

    def step(self, sample: Sample) -> FloatArray:
        raise AssertionError


def open_plant(case: Case) -> Plant:
    """Open the plant of a case, with the signals that take part.

    Raises
    ------
    CosimError
        It cannot be opened.
    """
    read = (*names(case.outputs), *names(case.measurements), *names(case.read))
    signals = names((*case.inputs, *case.undriven)), tuple(dict.fromkeys(read))
    return case.plant.open(*signals, case.seed, records=case.excitation is not None)


def _trace(case: Case, store: RowStore | None) -> Trace:
    store = store or row_store(case)
    safe_calls.announce_calls(store.announce)
    if case.replayed is not None:
        return _replay(case, case.replayed, store)
    try:
        plant = open_plant(case)
    except CosimError as error:
        return _not_begun(case, error)
    try:
        trace = _run(case, plant, store)
    except BaseException:
        with suppress(CosimError):  # the first error counts
            safe_calls.close_plant(plant)
        raise
    try:
        safe_calls.close_plant(plant)
    except FMUStepError as error:
        if trace.outcome is Outcome.COMPLETED:
            return replace(trace, outcome=_outcome_of(case, error), reason=f"after the last sample: {error}")
    return trace


class _Prepared(NamedTuple):
    """The loop of a case and the compiled engine, for all cases that differ by their seeds alone."""

    loop: ClosedLoop
    engine: "CompiledEngine"

    @classmethod
    def of(cls, case: Case, plant: Plant) -> Self:
        """Make them; raises what keeps the loop from being made."""
        from ddpc_cosim.compiled.engine import CompiledEngine

        return cls(_closed_loop(case, plant, _controller(case.section, case.plant)), CompiledEngine())


def _run(case: Case, plant: Plant, store: RowStore, prepared: _Prepared | None = None) -> Trace:
    """Close the loop of a case and an open plant; an error before its first sample is in the trace, too."""
    reason = ""
    try:
        if case.engine == "compiled":
            loop, engine = prepared or _Prepared.of(case, plant)
            try:
                trace = _with_data(case, loop.run(_one_run(case), store, engine))
            except NeedsPythonError as error:
                reason = f"python: {error}"
            else:
                return replace(trace, engine=engine.used)
        trace = _close_the_loop(case, plant, _controller(case.section, case.plant), store)
    except CosimError as error:
        return _not_begun(case, error)
    return replace(trace, engine=reason)


def _replay(case: Case, replayed: Replayed, store: RowStore) -> Trace:
    """Have the controller of a case take over at each sample of a log, when it has what it learns from."""
    signals, first, learned_in = replayed
    try:
        controller = controller_of(case)
        if learned_in.excitation is not None and safe_calls.learns_from_recording(controller):
            controller, loop = started(learned_in)
            case = replace(case, recording=loop.recording)
        acting = {v.name: v for v in learned_in.undriven}
        inputs = (*case.inputs, *(acting[name] for name in case.disturbances if name in acting))
        takes_over = TakingOver(controller, signals, first)
        trace = _close_the_loop(case, LoggedPlant(signals, inputs, first), takes_over, store)
    except CosimError as error:
        return _not_begun(case, error)
    return replace(trace, solve_time=np.array(takes_over.seconds[: len(trace)]))


def _close_the_loop(
    case: Case,
    plant: Plant,
    controller: Controller | None,
    store: RowStore | None,
) -> Trace:
    loop = _closed_loop(case, plant, controller)
    return _with_data(case, loop.run(_one_run(case), store))


def stepwise(case: Case, plant: Plant, controller: Controller, store: RowStore) -> Steps[Trace]:
    """Run a case with a plant and a controller that are made already, stopping at every sample."""
    trace = yield from _closed_loop(case, plant, controller).stepwise(_one_run(case), store)
    return _with_remarks(case, _with_data(case, trace))


def _closed_loop(case: Case, plant: Plant, controller: Controller | None) -> ClosedLoop:
    """Return what a case says of its loop, whatever its seed."""
    warm_up = case.warm_up_controller
    return ClosedLoop(
        plant,
        controller,
        sampling_time=case.sampling_time,
        duration=case.duration,
        reference=case.reference,
        stabiliser=_controller(case.stabiliser, case.plant) if case.stabiliser else None,
        bounds=case.bounds,
        outputs=names(case.outputs),
        measurements=names(case.measurements),
        noise=GaussianNoise(case.noise) if case.noise else None,
        conditions=case.conditions,
        events=case.events,
        preview=case.preview,
        start_time=case.start_time,
        continue_recording=case.continue_recording,
        disturbances=case.disturbances,
        recorded_disturbances=case.recorded_disturbances,
        recording_start=case.recording_start,
        forecast_horizon=case.forecast_horizon,
        prices=case.prices,
        monitors=case.monitors,
        communication_step=case.communication_step,
        warm_up=case.warm_up,
        warm_up_controller=None if warm_up is None else _controller(warm_up, case.plant),
        resumed=case.resumed,
        keeps_state=case.keeps_state,
    )


def _one_run(case: Case) -> OneRun:
    """Return what a case is among others of its loop."""
    excitation = case.excitation and case.excitation.with_seed(case.seed)
    return OneRun(case.seed, case.parameters, excitation, case.recording, case.noise_mixture)


def _with_data(case: Case, trace: Trace) -> Trace:
    """Return a trace with what its case says of the data and of its beginning."""
    more: dict[str, Any] = {}
    if case.recording is not None and case.recording.treatments:
        treatments = ", ".join(case.recording.treatments)
        more["provenance"] = trace.provenance | {LOGGED_DATA: treatments}
    if warnings := (*_before_time_0(case, trace),):
        more["warnings"] = (*trace.warnings, *warnings)
    return replace(trace, **more) if more else trace


def _before_time_0(case: Case, trace: Trace) -> Iterator[str]:
    """Yield what a supplied FMU did before time 0, where what it reads over time may not reach."""
    begins = {"warm-up": case.start_time - case.warm_up}
    if trace.recorded_samples and case.recording_start is not None:
        begins["experiment"] = case.recording_start
    for what, begin in begins.items():
        if begin < 0.0 <= case.start_time and not (case.plant.name or case.plant.identified):
            begun = f"the {what} began at t = {shown(begin)}, before 0"
            remedy = f"set loop.start_time to {shown(case.start_time - begin)} or later"
            yield f"{begun}, where the tables of an FMU, such as weather, commonly begin; {remedy}"


def _not_begun(case: Case, error: CosimError) -> Trace:
    trace = no_samples(case, _outcome_of(case, error), f"before the first sample: {error}")
    return replace(trace, transient=is_of_the_machine(error))


def _controller(section: Mapping[str, Any], plant: PlantSpec) -> Controller | None:
    """Return a controller whose settings have the plant, or its FMU, where they ask for it; None: no type."""
    kind = section["type"]
    if not kind:
        return None
    chosen = controller_class(kind)
    settings = map_files(chosen, section["settings"], lambda path: plant.fmu if path == PLANT else path)
    settings = map_plants(chosen, settings, lambda name: name or plant.name)
    return safe_calls.make_controller(partial(make_controller, kind, settings), kind)


def row_store(case: Case, path: Path | None = None, *, follow: bool = False) -> RowStore:
    """Return the store for a case's rows, in a file, perhaps of another process, or in memory."""
    return _store(case, _planned_samples(case), path, follow=follow)


def _store(case: Case, samples: int, path: Path | None = None, *, follow: bool = False) -> RowStore:
    sizes = len(case.inputs), len(case.outputs), (_substeps(case) - 1) * len(_intersample(case))
    return RowStore(
        samples,
        *(len(case.outputs), len(case.measurements), len(case.inputs)),
        path,
        changed_inputs=len(case.changed_inputs),
        more=table_widths(case.disturbances, case.reference, case.bounds, case.prices, case.monitors, *sizes),
        follow=follow,
    )


def _substeps(case: Case) -> int:
    return communication_steps(case.sampling_time, case.communication_step)


def _intersample(case: Case) -> tuple[str, ...]:
    """Return the outputs that are read between samples."""
    inputs = names((*case.inputs, *case.undriven))
    return intersample_signals(_substeps(case), names(case.outputs), case.prices, case.monitors, inputs)


def partial_trace(case: Case, store: RowStore, outcome: Outcome, reason: str) -> Trace:
    """Return the trace of a case whose process is gone, with the rows that it has left."""
    return replace(no_samples(case, outcome, reason), time=case.times(store.count), **store.written())


def _planned_samples(case: Case) -> int:
    return round(case.duration / case.sampling_time) + 1


def no_samples(case: Case, outcome: Outcome, reason: str) -> Trace:
    """Return the trace of a case that failed before its first sample."""
    signals, time = (*case.inputs, *case.outputs), case.times(_planned_samples(case))
    limits = Limits.over(signals, len(case.inputs), case.bounds, time)
    return Trace(
        time=np.empty(0),
        **_store(case, 1).written(),
        inputs=case.inputs,
        outputs=case.outputs,
        measurements=case.measurements,
        bounds=limits.bounds,
        sampling_time=case.sampling_time,
        planned_samples=_planned_samples(case),
        outcome=outcome,
        reason=reason,
        settings=dict(case.section["settings"]),
        changed_inputs=case.changed_inputs,
        disturbances=tuple(
            case.variable(name) for name, disturbance in case.disturbances.items() if disturbance.is_known
        ),
        bands=tuple(v.name for v in case.outputs if isinstance(case.reference[v.name], Band)),
        moving_limits=limits.moving,
        charges=tuple(price.charge(name, case.variable(price.signal)) for name, price in case.prices.items()),
        monitors=tuple(map(case.variable, case.monitors)),
        monitored_bands=tuple(name for name, band in case.monitors.items() if band is not None),
        substeps=_substeps(case),
        intersample_signals=tuple(map(case.variable, _intersample(case))),
    )


def _outcome_of(case: Case, error: CosimError) -> Outcome:
    if isinstance(error, FMUStepError):
        return OUTCOME_OF[error.status]
    if isinstance(error, DivergenceError):
        return Outcome.DIVERGED
    # In open loop there is no controller whose settings could be wrong.
    is_plants = isinstance(error, FMUImportError) or not case.section["type"]
    return Outcome.FMU_ERROR if is_plants else Outcome.CONTROLLER_ERROR
