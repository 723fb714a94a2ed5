"""A log in the place of a plant: what a controller would do at each of its samples, if it took over there.

The outputs are those of the log, whatever is decided. So that no answer rests on inputs that were never
applied, the controller begins anew at every sample, with the log up to there as :attr:`Loop.past`.
"""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any

from ddpc_cosim.controller import Action, Controller, Loop, Recording, Sample
from ddpc_cosim.loop.safe_calls import (
    ask_controller,
    controller_diagnostics,
    controller_knowledge,
    controller_settings,
    controller_warnings,
    horizon_of,
    learns_from_recording,
    restart_controller,
    start_controller,
)
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.variables import FloatArray, Variable

WITHOUT_PAST = "answers_without_past"
"""The diagnostic that is 1 where an answer is the same without any past, else 0."""


@dataclass(frozen=True, slots=True)
class LoggedSignals:
    """What was logged of a loop.

    Parameters
    ----------
    recording : Recording
        Inputs as they were applied, controlled outputs, measurements and known disturbances.
    outputs : tuple of Variable
        The n outputs of the plant that take part.
    values : array, shape (T, n)
        Them, in their units.
    """

    recording: Recording
    outputs: tuple[Variable, ...]
    values: FloatArray

    def before(self, k: int) -> Recording:
        """Return the samples before sample k, of which there are some."""
        log = self.recording
        return Recording(log.u[:k], log.y[:k], log.measured[:k], log.sampling_time, d=log.d[:k])


class LoggedPlant(Plant):
    """A plant whose outputs are those of a log.

    Parameters
    ----------
    signals : LoggedSignals
        What was logged.
    inputs : tuple of Variable
        What a controller drives, and known disturbances that are inputs; none of them acts.
    first : int
        The sample that a run begins at.
    """

    def __init__(self, signals: LoggedSignals, inputs: Sequence[Variable], first: int) -> None:
        self.inputs, self.outputs = tuple(inputs), signals.outputs
        self._values, self._first = signals.values, first

    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        """Go to the first sample and return the outputs there."""
        self._row = self._first
        return self._outputs()

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Go to the next sample and return the outputs there."""
        self._row += 1
        return self._outputs()

    def _outputs(self) -> FloatArray:
        y: FloatArray = self._values[self._row].copy()
        return y


class TakingOver(Controller):
    """Has another controller take over at every sample, and says what it decides there.

    Parameters
    ----------
    controller : Controller
        The other one.
    signals : LoggedSignals
        What was logged.
    first : int
        Which of its samples is the first of the run.

    Attributes
    ----------
    seconds : list of float
        How long each step of the other one took [s], without what begins it anew.
    """

    def __init__(self, controller: Controller, signals: LoggedSignals, first: int) -> None:
        self._controller, self._signals, self._first = controller, signals, first
        self.horizon = horizon_of(controller)
        self.seconds = list[float]()
        self._answers_without_past: bool | None = None

    @property
    def uses_recording(self) -> bool:
        """Whether the other one learns from a recording."""
        return learns_from_recording(self._controller)

    def start(self, loop: Loop) -> None:
        """Start the other one, as at a plant that rests."""
        self._loop = replace(loop, rng=deepcopy(loop.rng))
        self._compared = (self._first + len(self._signals.recording)) // 2
        start_controller(self._controller, loop)

    def step(self, sample: Sample) -> Action:
        """Return what the other one decides if it takes over at this sample."""
        k = self._first + sample.k
        sample = sample._replace(k=0)
        inputs = len(self._loop.inputs)
        without = None
        if k == self._compared:
            self._begin(None)
            without = ask_controller(self._controller, sample, inputs)
        if k:
            self._begin(self._signals.before(k))
        decision = ask_controller(self._controller, sample, inputs)
        if without is not None:
            self._answers_without_past = bool((without.u == decision.u).all())
        self.seconds.append(decision.seconds)
        return Action(decision.u, decision.status, decision.info)

    def _begin(self, past: Recording | None) -> None:
        loop = replace(self._loop, past=past, rng=deepcopy(self._loop.rng))
        restart_controller(self._controller, loop)

    def settings(self) -> dict[str, Any]:
        """Return the settings of the other one."""
        return controller_settings(self._controller)

    def knowledge(self, loop: Loop) -> Mapping[str, str]:
        """Return what the other one goes by."""
        return controller_knowledge(self._controller, loop)

    def warnings(self) -> Sequence[str]:
        """Return what the other one says against its data or model."""
        return controller_warnings(self._controller)

    def diagnostics(self) -> Mapping[str, float]:
        """Return what the other one says of its data, and whether an answer did not depend on the past."""
        same = self._answers_without_past
        without_past = {} if same is None else {WITHOUT_PAST: float(same)}
        return {**controller_diagnostics(self._controller), **without_past}
