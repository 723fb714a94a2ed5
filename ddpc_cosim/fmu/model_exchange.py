"""One run of an FMU for Model Exchange, sample by sample, with all its events.

The inputs jump at samples, so every change of an input is an event (FMI 2.0 section 3.2.3). Between samples
the integrator goes from event to event: state events (a sign change of an event indicator), time events
(known in advance), and step events (asked for by the FMU after an integrator step).
"""

from collections.abc import Callable, Sequence
from math import inf
from typing import Any, Protocol

import numpy as np

from ddpc_cosim.fmu.description import Clock
from ddpc_cosim.fmu.instance import EventInfo
from ddpc_cosim.fmu.integrators import ContinuousModel, make_integrator
from ddpc_cosim.fmu.run import FMURun, Readable, Restorable, T, Written
from ddpc_cosim.fmu.status import CallError, termination
from ddpc_cosim.variables import FloatArray

_MOST_EVENTS_AT_ONCE = 1000


class HybridModel(ContinuousModel, Restorable, Protocol):
    """What is integrated from event to event: an FMU, or several as one."""

    def sizes(self) -> tuple[int, int]:
        """Return the numbers of continuous states and of event indicators."""

    def enter_event_mode(self) -> None:
        """Go from continuous-time mode to event mode."""

    def activate_clocks(self, references: Sequence[int]) -> None:
        """Let input clocks tick, in event mode."""

    def update_discrete_states(self) -> EventInfo:
        """Iterate over events until the discrete states have settled."""

    def enter_continuous_time_mode(self) -> None:
        """Go from event mode to continuous-time mode."""

    def completed_integrator_step(self) -> tuple[bool, bool]:
        """Tell the end of an integrator step; return whether it wants an event, and to terminate."""


class ModelExchangeRun(FMURun):
    """An initialised model between two samples.

    Parameters
    ----------
    model : HybridModel
        The model, after its initialisation: in event mode.
    inputs, outputs : Written and Readable
        What is written before and read after every sample.
    t0 : float
        Start time [s].
    tolerance : float
        Relative tolerance of the integration; the absolute one is this times the states' nominal values.
    needs_completed_step : bool
        Whether the model wants to know of every integrator step.
    has_discrete_inputs : bool
        Whether inputs can change at events only.
    clocks : sequence of Clock
        The input clocks that tick periodically.
    """

    def __init__(
        self,
        model: HybridModel,
        inputs: Written,
        outputs: Readable,
        t0: float,
        *,
        tolerance: float,
        needs_completed_step: bool,
        has_discrete_inputs: bool,
        clocks: Sequence[Clock] = (),
    ) -> None:
        super().__init__(model, inputs, outputs, t0, clocks)
        self._model = model
        self._needs_completed_step = needs_completed_step
        self._has_discrete_inputs = has_discrete_inputs
        self._held: FloatArray | None = None
        self._next_event = inf
        self._settle(t0)
        self._integrator = make_integrator(model, *model.sizes(), tolerance)
        self._integrator.restart(t0)

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold u, shape (m,), over h [s] and return the outputs at its end, shape (p,)."""
        if h != self._step_size:
            self._count_in(h)
        self.hold(u)
        self._integrate(self.time, self._base_time + (self._steps + 1) * h)
        self._steps += 1
        return self._read()

    def hold(self, u: FloatArray) -> None:
        """Hold u, shape (m,), from now on: an event, if it is another than before or a clock ticks."""
        due = self._ticks.take(self.time)
        if due or self._held is None or not np.array_equal(u, self._held):
            self._held = np.array(u, dtype=np.float64)
            self._event(self.time, lambda: self._write(u), due)

    def at_inputs(self, u: FloatArray, read: Callable[[], T]) -> T:
        """Return what is read with other inputs u, shape (m,), then be as before.

        It is not an event, which could change discrete states, unless inputs can change in nothing else.
        """
        if self._has_discrete_inputs:
            self.hold(u)
            return read()
        try:
            return super().at_inputs(u, read)
        finally:
            if self._held is not None:
                self._write(self._held)

    def change(self, set_values: Callable[[Any], None]) -> None:
        """Set parameters or inputs between two samples: an event."""
        self._event(self.time, lambda: set_values(self._model))

    def end(self, *, abandoned: bool = False) -> None:
        """Free all saved states and the integrator."""
        super().end(abandoned=abandoned)
        self._integrator.close()

    def _bookkeeping(self) -> tuple[Any, ...]:
        return *super()._bookkeeping(), self._held, self._next_event

    def _go_back(self, *bookkeeping: Any) -> None:
        *clock, self._held, self._next_event = bookkeeping
        super()._go_back(*clock)
        self._integrator.restart(self.time, nominals_changed=True)

    def _forget_inputs(self) -> None:
        self._held = None

    def _integrate(self, t: float, t_end: float) -> None:
        at_once = 0
        while t < t_end or self._next_event <= t:
            before = t
            tick = self._ticks.before(t_end)
            due = min(self._next_event, tick)
            event = due <= t
            if not event:
                t, wanted = self._advance(min(t_end, due))
                event = wanted or due <= t
            if event:
                self._event(t, clocks=self._ticks.take(t) if tick <= t else ())
            at_once = at_once + 1 if t == before else 0
            if at_once > _MOST_EVENTS_AT_ONCE:
                what = "events" if event else "steps of the integrator"
                raise CallError(f"more than {_MOST_EVENTS_AT_ONCE} {what} at one instant")

    def _advance(self, target: float) -> tuple[float, bool]:
        """Do one integrator step towards a time; return where it ended, and whether an event is due there."""
        t, event = self._integrator.advance(target)
        if self._needs_completed_step:
            wanted, end = self._model.completed_integrator_step()
            if end:
                raise termination("a completed integrator step", t)
            event = event or wanted
        return t, event

    def _event(self, t: float, change: Callable[[], None] | None = None, clocks: Sequence[int] = ()) -> None:
        """Handle an event at a time, at which inputs or parameters may change and clocks tick."""
        self._model.set_time(t)
        self._model.enter_event_mode()
        if change is not None:
            change()
        if clocks:
            self._model.activate_clocks(clocks)
        info = self._settle(t)
        self._integrator.restart(t, nominals_changed=info.nominals_changed)

    def _settle(self, t: float) -> EventInfo:
        """Let the discrete states settle and go on to continuous time."""
        info = self._model.update_discrete_states()
        if info.terminate:
            raise termination("an event", t)
        self._next_event = inf if info.next_event is None else info.next_event
        self._model.enter_continuous_time_mode()
        return info
