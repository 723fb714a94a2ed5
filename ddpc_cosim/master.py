"""The co-simulation master: one closed loop, sample by sample.

Time is counted in samples: sample k is at ``t0 + k * sampling_time``, computed and never accumulated.
At every sample the plant is measured, the controller decides, the row is written, and the plant holds the
inputs until the next sample.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from numbers import Integral, Real
from typing import Any, NamedTuple

import numpy as np

from ddpc_cosim.controller import OK, Bounds, Controller, Loop, Recording, Sample
from ddpc_cosim.errors import (
    ConfigError,
    ControllerError,
    DataError,
    DivergenceError,
    FMUStepError,
    StepStatus,
)
from ddpc_cosim.loop_setup import Sensors, Wiring, check_names, loop_bounds, reference_table, wire
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.safe_calls import (
    NotFiniteError,
    ask_controller,
    controller_diagnostics,
    controller_settings,
    plant_provenance,
    require_finite,
    reset_plant,
    set_plant_parameters,
    start_controller,
    step_plant,
)
from ddpc_cosim.signals import GaussianNoise, ParameterChange, Reference, UniformRandom
from ddpc_cosim.trace import Outcome, Trace
from ddpc_cosim.variables import FloatArray

MOST_STEPS = 100_000_000


def check_sampling_time(sampling_time: float) -> None:
    """Raise ConfigError if there cannot be so much time between samples [s]."""
    if not (_is_finite(sampling_time) and sampling_time > 0):
        raise ConfigError(f"sampling_time = {sampling_time} is not possible; allowed: a number > 0")


def whole_steps(duration: float, sampling_time: float) -> int:
    """Return the number of sampling intervals in a duration.

    Raises
    ------
    ConfigError
        There is no whole number of them, or too many.
    """
    check_sampling_time(sampling_time)
    if not _is_finite(duration):
        raise ConfigError(f"duration = {duration} is not possible; allowed: a number > 0")
    steps = duration / sampling_time
    if not steps < MOST_STEPS:
        raise ConfigError(f"duration / sampling_time = {steps:g} samples; allowed: 1 to {MOST_STEPS:.0e}")
    if round(steps) < 1 or abs(round(steps) * sampling_time - duration) > 1e-9 * max(duration, sampling_time):
        raise ConfigError(
            f"duration = {duration:g} must be a whole multiple of sampling_time = {sampling_time:g}"
        )
    return round(steps)


def end_time(start_time: float, steps: int, sampling_time: float) -> float:
    """Return the time of the last sample [s].

    Raises
    ------
    ConfigError
        The start time is no number, or so large that one sample cannot be told from the next.
    """
    if not _is_finite(start_time):
        raise ConfigError(f"start_time = {start_time} is not possible; allowed: a finite number")
    end = start_time + steps * sampling_time
    if np.spacing(max(abs(start_time), abs(end))) > 1e-3 * sampling_time:
        raise ConfigError(
            f"start_time = {start_time:g} is too large: samples {sampling_time:g} s apart coincide there"
        )
    return end


def check_seed(seed: int) -> None:
    """Raise ConfigError if this is no seed."""
    if not isinstance(seed, Integral) or seed < 0:
        raise ConfigError(f"seed = {seed!r} is not possible; allowed: a whole number >= 0")


def check_events(events: Sequence[ParameterChange], end: float) -> None:
    """Raise ConfigError for every event that would never act on the plant, as the run ends before."""
    late = [event.time for event in events if not event.time < end]
    if late:
        advice = f"the run ends at t = {end:g} s; choose an earlier time or a longer duration"
        raise ConfigError([f"events: the one at t = {time:g} s would not happen: {advice}" for time in late])


def check_recording(recording: Recording, loop: Loop) -> None:
    """Raise DataError if a recording was not made in a loop like this."""
    expected: dict[str, Any] = {
        "inputs": (recording.u.shape[1], len(loop.inputs)),
        "controlled outputs": (recording.y.shape[1], len(loop.outputs)),
        "measurements": (recording.measured.shape[1], len(loop.measurements)),
    }
    faults = [f"{there} {what}, the loop {here}" for what, (there, here) in expected.items() if there != here]
    if not np.isclose(recording.sampling_time, loop.sampling_time, rtol=1e-9, atol=0.0):
        faults.append(f"sampling time {recording.sampling_time:g} s, the loop {loop.sampling_time:g} s")
    if faults:
        raise DataError(f"recording: it does not fit the loop: it has {'; '.join(faults)}")


def _is_finite(value: Any) -> bool:
    return isinstance(value, Real) and math.isfinite(value)


class Experiment(NamedTuple):
    """What an experiment leaves behind.

    Parameters
    ----------
    recording : Recording
        Measurements, and the inputs as they were applied.
    y_plant : array, shape (p,)
        The plant's outputs at its end.
    fallbacks : int
        At how many samples the stabilising controller returned a fallback.
    """

    recording: Recording
    y_plant: FloatArray
    fallbacks: int


class Stabiliser:
    """A controller that keeps an unstable plant while an excitation is added to its inputs.

    Parameters
    ----------
    controller : Controller
        Started already.
    loop : Loop
        The loop that it was started with.
    reference : array, shape (T + horizon, p)
        References r_0, r_1, ... on the experiment's own time.
    """

    def __init__(self, controller: Controller, loop: Loop, reference: FloatArray) -> None:
        self._controller, self._loop, self._reference = controller, loop, reference
        self.fallbacks = 0

    def inputs(self, k: int, y: FloatArray, measured: FloatArray, excitation: FloatArray) -> FloatArray:
        """Return the excited inputs of sample k within their limits, shape (m,)."""
        time = k * self._loop.sampling_time
        reference = self._reference[k + 1 : k + 1 + self._controller.horizon]
        sample = Sample(k, time, y, measured, reference)
        try:
            decided, status, _ = ask_controller(self._controller, sample, len(excitation))
        except ControllerError as error:
            raise ControllerError(f"{error}, during the experiment, at t = {time:g} s") from error
        self.fallbacks += status != OK
        bounds = self._loop.bounds
        return np.asarray(np.clip(decided + excitation, bounds.u_min, bounds.u_max))


def run_experiment(
    plant: Plant,
    sensors: Sensors,
    excitation: UniformRandom,
    sampling_time: float,
    parameters: Mapping[str, ParameterValue] | None,
    *,
    stabiliser: Stabiliser | None = None,
    onwards: float = 0.0,
) -> Experiment:
    """Excite a plant from its initial state and record it.

    The plant is told that ``onwards`` [s] are to follow.

    Raises
    ------
    DivergenceError
        The plant diverged.
    ControllerError
        The stabilising controller failed.
    FMUStepError
        The plant failed.
    """
    inputs = excitation.draw(len(plant.inputs))
    plant.plan(sampling_time, len(inputs) * sampling_time + onwards)
    y_plant = reset_plant(plant, parameters, 0.0)
    rows = []
    for k, u in enumerate(inputs):
        seen = sensors.measure(y_plant)
        rows.append(seen)
        if stabiliser is not None:
            u[:] = stabiliser.inputs(k, *seen, excitation=u)  # a row of what is recorded
        y_plant = step_plant(plant, u.copy(), sampling_time, k * sampling_time)
        try:
            require_finite(y_plant, plant.outputs)
        except NotFiniteError as error:
            kind = "open-loop" if stabiliser is None else "closed-loop"
            time = (k + 1) * sampling_time
            raise DivergenceError(
                f"the plant diverged during the {kind} experiment, at t = {time:g} s: {error}"
            ) from error
    y, measured = (np.array(column) for column in zip(*rows, strict=True))
    fallbacks = stabiliser.fallbacks if stabiliser else 0
    return Experiment(Recording(inputs, y, measured, sampling_time), y_plant, fallbacks)


OUTCOME_OF = {
    StepStatus.ERROR: Outcome.FMU_ERROR,
    StepStatus.DISCARD: Outcome.FMU_DISCARDED,
    StepStatus.FATAL: Outcome.FMU_FATAL,
    StepStatus.CRASHED: Outcome.CRASHED,
    StepStatus.TIMED_OUT: Outcome.TIMED_OUT,
}

# A sample time can lie a rounding error before the instant it stands for; in sampling times.
_EARLY = 1e-6

ProgressReport = Callable[[int, int], None]
"""Called now and then with the samples done and the samples planned."""


def cosimulate(
    plant: Plant,
    controller: Controller,
    *,
    sampling_time: float,
    duration: float,
    reference: Reference | Mapping[str, Reference],
    excitation: UniformRandom | None = None,
    stabiliser: Controller | None = None,
    recording: Recording | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    outputs: Sequence[str] | None = None,
    measurements: Sequence[str] | None = None,
    parameters: Mapping[str, ParameterValue] | None = None,
    noise: GaussianNoise | None = None,
    events: Sequence[ParameterChange] = (),
    seed: int = 0,
    start_time: float = 0.0,
    continue_recording: bool = False,
    progress: ProgressReport | None = None,
) -> Trace:
    """Run one closed loop of a plant and a controller.

    Parameters
    ----------
    plant : Plant
        The plant; it is reset here, and stays open.
    controller : Controller
        The controller; it is started here.
    sampling_time, duration : float
        Time between samples and simulated time [s]; the duration is a whole number of samples.
    reference : Reference or mapping of str to Reference
        Reference of the controlled output, or of each by name, in their units.
    excitation : UniformRandom, optional
        The experiment to record before the loop is closed.
    stabiliser : Controller, optional
        Controls the plant during the experiment, on the same references from its start; the excitation is
        added to its inputs. Without one the experiment is in open loop.
    recording : Recording, optional
        A recording made before, in place of ``excitation``.
    bounds : mapping of str to (float, float), optional
        Limits of inputs and controlled outputs by name; default: the plant's own min and max.
    outputs, measurements : sequence of str, optional
        Which of the plant's outputs are controlled and which are measured; default: all.
    parameters : mapping of str to float, int, bool or str, optional
        Plant parameters of this run.
    noise : GaussianNoise, optional
        Noise of the measurements.
    events : sequence of ParameterChange, optional
        Tunable parameters that change during the run, before its end.
    seed : int
        Seed of the noise and of the controller's random numbers.
    start_time : float
        Time of the first sample [s].
    continue_recording : bool
        Close the loop where the experiment ended instead of starting from rest.
    progress : callable, optional
        Called now and then with the samples done and planned.

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
    wiring = wire(plant, outputs, measurements)
    steps = whole_steps(duration, sampling_time)
    end = end_time(start_time, steps, sampling_time)
    check_seed(seed)
    check_events(events, end)
    limits = loop_bounds(plant, wiring, bounds or {})
    check_names("noise", noise.standard_deviation if noise else (), wiring.measurements)
    sensors = Sensors(wiring, noise, np.random.default_rng([seed, 1]))
    if excitation is not None and recording is not None:
        raise ConfigError("give an excitation or a recording, not both")
    if excitation is not None:
        onwards = duration if continue_recording else 0.0
        helper = _helper(stabiliser, plant, wiring, limits, reference, excitation, sampling_time, seed)
        recording, last, fallbacks = run_experiment(
            plant, sensors, excitation, sampling_time, parameters, stabiliser=helper, onwards=onwards
        )
    elif stabiliser is not None:
        raise ConfigError("stabiliser needs an excitation, which is added to its inputs")
    if continue_recording and excitation is None:
        raise ConfigError(
            "continue_recording needs an excitation: the experiment whose end the loop starts from"
        )
    if continue_recording:
        y_plant = last
    else:
        plant.plan(sampling_time, end)
        y_plant = reset_plant(plant, parameters, start_time)
    if controller.uses_recording and recording is None:
        raise DataError(
            f"{type(controller).__name__} learns from a recording; give an excitation or a recording"
        )
    loop = Loop(
        sampling_time=sampling_time,
        inputs=plant.inputs,
        outputs=wiring.outputs,
        measurements=wiring.measurements,
        bounds=limits,
        recording=_protected(recording),
        rng=np.random.default_rng([seed, 0]),
        continues_recording=continue_recording,
    )
    if recording is not None:
        check_recording(recording, loop)
    start_controller(controller, loop)
    settings, provenance = controller_settings(controller), plant_provenance(plant)
    time = start_time + np.arange(steps + 1 + controller.horizon, dtype=np.float64) * sampling_time
    rows = _Rows(time, reference_table(reference, wiring.outputs, time), loop, steps, controller.horizon)
    outcome, reason = _run(
        plant, controller, sensors, rows, sorted(events, key=lambda e: e.time), y_plant, progress
    )
    try:
        diagnostics = controller_diagnostics(controller)
    except ControllerError as error:
        diagnostics = {}
        if outcome is Outcome.COMPLETED:
            outcome, reason = Outcome.CONTROLLER_ERROR, f"after the last sample: {error}"
    if stabiliser is not None:
        diagnostics["stabiliser_fallbacks"] = fallbacks
    return Trace(
        **rows.written(),
        inputs=plant.inputs,
        outputs=wiring.outputs,
        measurements=wiring.measurements,
        bounds=limits,
        sampling_time=sampling_time,
        planned_samples=steps + 1,
        outcome=outcome,
        reason=reason,
        settings=settings,
        diagnostics=diagnostics,
        provenance=provenance,
    )


def record(
    plant: Plant,
    excitation: UniformRandom,
    *,
    sampling_time: float,
    stabiliser: Controller | None = None,
    reference: Reference | Mapping[str, Reference] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    outputs: Sequence[str] | None = None,
    measurements: Sequence[str] | None = None,
    parameters: Mapping[str, ParameterValue] | None = None,
    noise: GaussianNoise | None = None,
    seed: int = 0,
) -> Recording:
    """Run an experiment from the plant's initial state; parameters as in :func:`cosimulate`.

    Only a stabiliser follows ``reference``, which it needs, and keeps ``bounds``.
    """
    check_sampling_time(sampling_time)
    check_seed(seed)
    wiring = wire(plant, outputs, measurements)
    check_names("noise", noise.standard_deviation if noise else (), wiring.measurements)
    sensors = Sensors(wiring, noise, np.random.default_rng([seed, 1]))
    limits = loop_bounds(plant, wiring, bounds or {})
    helper = _helper(stabiliser, plant, wiring, limits, reference or {}, excitation, sampling_time, seed)
    return run_experiment(plant, sensors, excitation, sampling_time, parameters, stabiliser=helper).recording


class _Rows:
    """The rows of a run, allocated before it."""

    def __init__(self, time: FloatArray, reference: FloatArray, loop: Loop, steps: int, horizon: int) -> None:
        rows, self.horizon, self.loop = steps + 1, horizon, loop
        self.time = time[:rows]
        self.reference = reference
        self.reference.setflags(write=False)  # controllers are handed views of it
        self.y = np.empty((rows, len(loop.outputs)))
        self.measured = np.empty((rows, len(loop.measurements)))
        self.u = np.full((rows, len(loop.inputs)), np.nan)
        self.solve_time = np.full(rows, np.nan)
        self.status = [OK] * rows
        self.count = 0

    def written(self) -> dict[str, Any]:
        """Return the rows up to the last one that was written."""
        n = self.count
        return {
            "time": self.time[:n],
            "reference": self.reference[:n],
            "y": self.y[:n],
            "measured": self.measured[:n],
            "u": self.u[:n],
            "status": tuple(self.status[:n]),
            "solve_time": self.solve_time[:n],
        }


def _run(
    plant: Plant,
    controller: Controller,
    sensors: Sensors,
    rows: _Rows,
    events: Sequence[ParameterChange],
    y_plant: FloatArray,
    progress: ProgressReport | None,
) -> tuple[Outcome, str]:
    """Run sample by sample and return how it ended; faults during the run are outcomes, not exceptions."""
    k, planned = 0, len(rows.time)
    pending = list(events)
    h, bounds = rows.loop.sampling_time, rows.loop.bounds
    try:
        while True:
            require_finite(y_plant, plant.outputs)
            while pending and pending[0].time <= rows.time[k] + _EARLY * h:
                set_plant_parameters(plant, pending.pop(0).parameters, rows.time[k])
            u = _decide(controller, sensors, rows, k, y_plant)
            np.maximum(u, bounds.u_min, out=u)
            np.minimum(u, bounds.u_max, out=u)
            if progress is not None:
                progress(k, planned - 1)
            if k + 1 == planned:
                return Outcome.COMPLETED, ""
            y_plant = step_plant(plant, u.copy(), h, rows.time[k])  # a plant may use its inputs up
            k += 1
    except ConfigError as error:
        if k == 0:
            raise
        return Outcome.FMU_ERROR, f"{error} at t = {rows.time[k]:g} s"
    except FMUStepError as error:
        return OUTCOME_OF[error.status], str(error)
    except NotFiniteError as error:
        return Outcome.DIVERGED, f"{error} at t = {rows.time[k]:g} s"
    except ControllerError as error:
        return Outcome.CONTROLLER_ERROR, f"{error} at t = {rows.time[k]:g} s"


def _decide(controller: Controller, sensors: Sensors, rows: _Rows, k: int, y_plant: FloatArray) -> FloatArray:
    """Let the controller decide at sample k, write the row, and return its inputs (a view of the row)."""
    y, measured = sensors.measure(y_plant)
    rows.y[k] = sensors.controlled(y_plant)
    rows.measured[k] = measured
    rows.count = k + 1
    sample = Sample(k, float(rows.time[k]), y, measured, rows.reference[k + 1 : k + 1 + rows.horizon])
    try:
        rows.u[k], rows.status[k], rows.solve_time[k] = ask_controller(controller, sample, rows.u.shape[1])
    except ControllerError:
        rows.status[k] = "error"
        raise
    row: FloatArray = rows.u[k]
    return row


def _helper(
    stabiliser: Controller | None,
    plant: Plant,
    wiring: Wiring,
    limits: Bounds,
    reference: Reference | Mapping[str, Reference],
    excitation: UniformRandom,
    sampling_time: float,
    seed: int,
) -> Stabiliser | None:
    """Start the controller of the experiment, if there is one."""
    if stabiliser is None:
        return None
    if stabiliser.uses_recording:
        raise ConfigError(f"stabiliser: {type(stabiliser).__name__} learns from a recording itself")
    loop = Loop(
        sampling_time=sampling_time,
        inputs=plant.inputs,
        outputs=wiring.outputs,
        measurements=wiring.measurements,
        bounds=limits,
        recording=None,
        rng=np.random.default_rng([seed, 2]),
    )
    start_controller(stabiliser, loop)
    time = np.arange(excitation.samples + 1 + stabiliser.horizon, dtype=np.float64) * sampling_time
    return Stabiliser(stabiliser, loop, reference_table(reference, wiring.outputs, time))


def _protected(recording: Recording | None) -> Recording | None:
    """Return a recording that a controller can only read: others may learn from the same one."""
    if recording is None:
        return None
    u, y, measured = (array.view() for array in (recording.u, recording.y, recording.measured))
    for view in (u, y, measured):
        view.setflags(write=False)
    return Recording(u, y, measured, recording.sampling_time)
