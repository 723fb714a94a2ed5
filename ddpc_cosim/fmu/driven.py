"""One run of an FMU for Model Exchange that somebody else integrates, together with other FMUs.

Time, states and inputs are given, and what follows from them is asked for: outputs, derivatives, event
indicators, and what an event leaves behind.
"""

from collections.abc import Callable, Sequence
from ctypes import c_double
from math import inf

import numpy as np

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.fmu.buffers import Port
from ddpc_cosim.fmu.instance import Model
from ddpc_cosim.fmu.run import FMURun, T
from ddpc_cosim.variables import FloatArray


class DrivenRun(FMURun):
    """An initialised model whose time, states and events are in another hand.

    It begins in event mode. Then events are ``begin_event``, ``update`` until nothing changes, and
    ``end_event``; between them are ``place``, ``derivatives``, ``event_indicators`` and ``complete_step``.

    Parameters
    ----------
    model : Model
        The instance, after its initialisation: in event mode.
    inputs, outputs : Port
        What is written and read.
    continuous : tuple of (Port, list of int)
        Those of the inputs that can change between events too, and their places among the inputs.
    t0 : float
        Start time [s].
    needs_completed_step : bool
        Whether the model wants to know of every integrator step.
    """

    def __init__(
        self,
        model: Model,
        inputs: Port,
        outputs: Port,
        continuous: tuple[Port, list[int]],
        t0: float,
        *,
        needs_completed_step: bool,
    ) -> None:
        super().__init__(model, inputs, outputs, t0)
        self._model, self._needs_completed_step = model, needs_completed_step
        self._continuous, self._places = continuous
        self._in_event_mode = True
        states, event_indicators = model.sizes()
        self._x, self._z = (c_double * states)(), (c_double * event_indicators)()

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Refuse a step of its own."""
        raise ConfigError("an FMU that is integrated together with others cannot be stepped by itself")

    def at_inputs(self, u: FloatArray, read: Callable[[], T]) -> T:
        """Return what is read with the inputs u, shape (m,); discrete ones only change at an event."""
        self._take(u)
        return read()

    def sizes(self) -> FloatArray:
        """Return the numbers of states and of event indicators, and whether it counts steps, shape (3,)."""
        return np.array([len(self._x), len(self._z), self._needs_completed_step], dtype=np.float64)

    def states(self) -> FloatArray:
        """Return the continuous states, shape (n,)."""
        if len(self._x):
            self._model.get_states(self._x, len(self._x))
        return np.array(self._x, dtype=np.float64)

    def nominals(self) -> FloatArray:
        """Return the nominal values of the states, shape (n,); zeros where the FMU does not say."""
        memory = (c_double * len(self._x))()
        if len(memory):
            self._model.get_nominals(memory, len(memory))
        return np.array(memory, dtype=np.float64)

    def place(self, t: float, x: FloatArray) -> FloatArray:
        """Go to a time [s] and states, shape (n,); return the outputs with the inputs as they are."""
        self._base_time = t
        self._model.set_time(t)
        if len(self._x):
            self._x[:] = x.tolist()
            self._model.set_states(self._x, len(self._x))
        return self._read()

    def derivatives(self, u: FloatArray) -> FloatArray:
        """Return the derivatives of the states, shape (n,), with the inputs u, shape (m,)."""
        self._take(u)
        if len(self._x):
            self._model.get_derivatives(self._x, len(self._x))
        return np.array(self._x, dtype=np.float64)

    def event_indicators(self, u: FloatArray) -> FloatArray:
        """Return the event indicators with the inputs u, shape (m,)."""
        self._take(u)
        if len(self._z):
            self._model.get_event_indicators(self._z, len(self._z))
        return np.array(self._z, dtype=np.float64)

    def complete_step(self, u: FloatArray) -> FloatArray:
        """Tell the end of an integrator step; return whether it wants an event, and to terminate."""
        self._take(u)
        return np.array(self._model.completed_integrator_step(), dtype=np.float64)

    def begin_event(self) -> None:
        """Enter event mode."""
        self._model.enter_event_mode()
        self._in_event_mode = True

    def update(self, u: FloatArray, clocks: Sequence[int]) -> FloatArray:
        """Let clocks tick, and discrete states settle, with the inputs u, shape (m,).

        Returns
        -------
        info : array, shape (4,)
            Whether the FMU wants to terminate, whether nominal values and states have changed; time of the
            next time event [s], infinite for none.
        """
        self._take(u)
        if clocks:
            self._model.activate_clocks(clocks)
        info = self._model.update_discrete_states()
        next_event = inf if info.next_event is None else info.next_event
        return np.array([info.terminate, info.nominals_changed, info.states_changed, next_event])

    def end_event(self) -> None:
        """Go on to continuous time."""
        self._model.enter_continuous_time_mode()
        self._in_event_mode = False

    def _take(self, u: FloatArray) -> None:
        """Write the inputs that may change now."""
        if self._in_event_mode:
            self._write(u)
        elif self._places:
            self._continuous.write(u[self._places])
