"""FMI 1.0, Co-Simulation and Model Exchange."""

import ctypes
from collections.abc import Callable
from functools import partial
from typing import Any

import fmpy.fmi1

from ddpc_cosim.fmu.instance import (
    EventInfo,
    Instance,
    InstanceSource,
    Model,
    ModelFunctions,
    Slave,
    value_types,
)
from ddpc_cosim.fmu.status import FMI1_CALLBACKS, SUCCESS, CallError, failed_call

# fmiBoolean is a char; numbers are wanted here, and bytes there.
_BOOLEAN = ctypes.c_int8
_TRUE, _FALSE = fmpy.fmi1.fmi1True, fmpy.fmi1.fmi1False
_MOST_ITERATIONS = 1000


class _Fmi1(Instance):
    major = 1
    types = value_types(1)

    def _instantiate(self, *, logging: bool, **options: Any) -> None:
        self._fmu.instantiate(functions=FMI1_CALLBACKS, loggingOn=logging)

    def value_arguments(self, references: Any, count: int, memory: Any) -> tuple[Any, ...]:
        if isinstance(memory, ctypes.Array) and memory._type_ is _BOOLEAN:
            return references, count, ctypes.cast(memory, ctypes.POINTER(ctypes.c_char))
        return references, count, memory


class Fmi1Slave(_Fmi1, Slave):
    """An FMI 1.0 Co-Simulation instance."""

    def __init__(self, source: InstanceSource) -> None:
        super().__init__(source)
        self._do_step = partial(self.function("fmi1DoStep"), self.component)

    def initialize(
        self,
        t0: float,
        stop_time: float | None,
        tolerance: float | None,
        set_start_values: Callable[[], None],
    ) -> None:
        """Initialise; FMI 1.0 takes no tolerance."""
        set_start_values()
        stop = (_FALSE, 0.0) if stop_time is None else (_TRUE, stop_time)
        self.call("fmi1InitializeSlave", t0, *stop)

    def complete_initialization(self) -> None:
        """Nothing is left to do."""

    def terminate(self) -> None:
        """End the simulation."""
        self.call("fmi1TerminateSlave")

    def do_step(self, time: float, h: float) -> None:
        """Advance from ``time`` by ``h`` [s]."""
        status = self._do_step(time, h, _TRUE)
        if status not in SUCCESS:
            raise failed_call("fmiDoStep", status)


class Fmi1Model(_Fmi1, Model):
    """An FMI 1.0 Model Exchange instance.

    FMI 1.0 has no modes: entering them does nothing.

    Parameters
    ----------
    states, event_indicators : int
        Their numbers, from the model description.
    """

    functions = ModelFunctions(
        "fmi1SetTime",
        "fmi1GetContinuousStates",
        "fmi1SetContinuousStates",
        "fmi1GetDerivatives",
        "fmi1GetNominalContinuousStates",
        "fmi1GetEventIndicators",
    )

    def __init__(self, source: InstanceSource, *, states: int, event_indicators: int) -> None:
        super().__init__(source)
        self._sizes = (states, event_indicators)
        self._wants_event = ctypes.c_char()

    def initialize(
        self,
        t0: float,
        stop_time: float | None,
        tolerance: float | None,
        set_start_values: Callable[[], None],
    ) -> None:
        """Initialise; the first events are handled by the first update."""
        self.set_time(t0)
        set_start_values()
        tolerances = (_FALSE, 0.0) if tolerance is None else (_TRUE, tolerance)
        self._info = fmpy.fmi1.fmi1EventInfo()
        self.call("fmi1Initialize", *tolerances, ctypes.byref(self._info))
        self._initial = True

    def complete_initialization(self) -> None:
        """Nothing is left to do."""

    def terminate(self) -> None:
        """End the simulation."""
        self.call("fmi1Terminate")

    def sizes(self) -> tuple[int, int]:
        """Return the numbers of continuous states and of event indicators."""
        return self._sizes

    def enter_event_mode(self) -> None:
        """Nothing is to be done."""

    def enter_continuous_time_mode(self) -> None:
        """Nothing is to be done."""

    def update_discrete_states(self) -> EventInfo:
        """Iterate over events until the discrete states have settled."""
        nominals = states = False
        for _ in range(_MOST_ITERATIONS):
            if self._initial:  # fmiInitialize has done the first update
                self._initial = False
            else:
                self.call("fmi1EventUpdate", _FALSE, ctypes.byref(self._info))
            info = self._info
            nominals |= info.stateValueReferencesChanged != _FALSE
            states |= info.stateValuesChanged != _FALSE
            terminate = info.terminateSimulation != _FALSE
            if terminate or info.iterationConverged != _FALSE:
                next_event = info.nextEventTime if info.upcomingTimeEvent != _FALSE else None
                return EventInfo(terminate, nominals, states, next_event)
        raise CallError(f"the event iteration did not end after {_MOST_ITERATIONS} fmiEventUpdate")

    def completed_integrator_step(self) -> tuple[bool, bool]:
        """Tell the end of an integrator step; return whether it wants an event, and to terminate."""
        self.call("fmi1CompletedIntegratorStep", ctypes.byref(self._wants_event))
        return self._wants_event.value != _FALSE, False
