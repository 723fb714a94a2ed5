"""FMI 3.0, Co-Simulation and Model Exchange. Intermediate updates are not used."""

import ctypes
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from ddpc_cosim.fmu.instance import (
    EventInfo,
    Instance,
    InstanceSource,
    Model,
    ModelFunctions,
    Slave,
    reference_array,
    serialised,
    value_types,
)
from ddpc_cosim.fmu.status import DISCARD, SUCCESS, CallError, failed_call, fmi3_logger, termination

_MOST_ITERATIONS = 1000


class _Fmi3(Instance):
    major = 3
    types = value_types(3)
    directional_derivative = "fmi3GetDirectionalDerivative"

    def _instantiate(self, *, logging: bool, **options: Any) -> None:
        self._fmu.instantiate(logMessage=fmi3_logger(self.log), loggingOn=logging, **options)

    def value_arguments(self, references: Any, count: int, memory: Any) -> tuple[Any, ...]:
        return references, len(references), memory, count

    def configure(self) -> None:
        self.call("fmi3EnterConfigurationMode")

    def complete_configuration(self) -> None:
        self.call("fmi3ExitConfigurationMode")

    def initialize(
        self,
        t0: float,
        stop_time: float | None,
        tolerance: float | None,
        set_start_values: Callable[[], None],
    ) -> None:
        set_start_values()
        self.call(
            "fmi3EnterInitializationMode",
            tolerance is not None,
            tolerance or 0.0,
            t0,
            stop_time is not None,
            stop_time or 0.0,
        )

    def complete_initialization(self) -> None:
        self.call("fmi3ExitInitializationMode")

    def terminate(self) -> None:
        self.call("fmi3Terminate")

    def enter_event_mode(self) -> None:
        """Go to event mode."""
        self.call("fmi3EnterEventMode")

    def update_discrete_states(self) -> EventInfo:
        """Iterate over events until the discrete states have settled."""
        again, terminate, nominals, states, defined = (ctypes.c_bool() for _ in range(5))
        next_event = ctypes.c_double()
        flags = [ctypes.byref(flag) for flag in (again, terminate, nominals, states, defined, next_event)]
        nominals_changed = states_changed = False
        for _ in range(_MOST_ITERATIONS):
            self.call("fmi3UpdateDiscreteStates", *flags)
            nominals_changed |= nominals.value
            states_changed |= states.value
            if terminate.value or not again.value:
                time = next_event.value if defined.value else None
                return EventInfo(terminate.value, nominals_changed, states_changed, time)
        raise CallError(f"the event iteration did not end after {_MOST_ITERATIONS} fmi3UpdateDiscreteStates")

    def activate_clocks(self, references: Sequence[int]) -> None:
        """Let input clocks tick, in event mode."""
        count = len(references)
        self.call(
            "fmi3SetClock", reference_array(references), count, (ctypes.c_bool * count)(*[True] * count)
        )

    def save_state(self) -> Any:
        state = ctypes.c_void_p()
        self.call("fmi3GetFMUState", ctypes.byref(state))
        return state

    def restore_state(self, state: Any) -> None:
        self.call("fmi3SetFMUState", state)

    def free_state(self, state: Any) -> None:
        self.call("fmi3FreeFMUState", ctypes.byref(state))

    def serialise(self, state: Any) -> bytes:
        return serialised(
            partial(self.call, "fmi3SerializedFMUStateSize", state),
            partial(self.call, "fmi3SerializeFMUState", state),
        )

    def deserialise(self, content: bytes) -> Any:
        state = ctypes.c_void_p()
        memory = (ctypes.c_ubyte * len(content)).from_buffer_copy(content)
        self.call("fmi3DeserializeFMUState", memory, len(content), ctypes.byref(state))
        return state

    def get_directional_derivative(self, unknowns: Any, known: Any, seed: Any, sensitivity: Any) -> None:
        references = (unknowns, len(unknowns), known, len(known))
        numbers = (seed, len(seed), sensitivity, len(sensitivity))
        self.call(self.directional_derivative, *references, *numbers)


class Fmi3Slave(_Fmi3, Slave):
    """An FMI 3.0 Co-Simulation instance.

    Parameters
    ----------
    event_mode : bool
        Whether inputs are set in event mode, which discrete ones and clocks need where the FMU has it.
    """

    functions_of_a_step = ("fmi3SetFloat64", "fmi3DoStep", "fmi3GetFloat64")

    def __init__(self, source: InstanceSource, *, event_mode: bool) -> None:
        super().__init__(source, eventModeUsed=event_mode, earlyReturnAllowed=event_mode)
        self.uses_event_mode = event_mode
        self._do_step = self.function("fmi3DoStep")
        self._event, self._terminate, self._early = (ctypes.c_bool() for _ in range(3))
        self._reached = ctypes.c_double()
        results = (self._event, self._terminate, self._early, self._reached)
        self._results = tuple(ctypes.byref(result) for result in results)

    def complete_initialization(self) -> None:
        """Leave the initialisation, and the event mode that follows it where it is used."""
        super().complete_initialization()
        if self.uses_event_mode:
            self._handle_event()

    def in_event_mode(self, change: Callable[[], None]) -> None:
        """Set inputs, parameters or clocks in event mode and go back to step mode."""
        self.enter_event_mode()
        change()
        self._handle_event()

    def do_step(self, time: float, h: float) -> None:
        """Advance from ``time`` by ``h`` [s]; a step that returns early is continued."""
        status = self._do_step(self.component, time, h, True, *self._results)
        if status not in SUCCESS:
            if status == DISCARD and self._terminate.value:
                raise termination("fmi3DoStep", self._reached.value)
            raise failed_call("fmi3DoStep", status)
        if self._event.value or self._terminate.value or self._early.value:
            remaining = self._follow_up(time, h)
            if remaining > 0.0:
                self.do_step(time + h - remaining, remaining)

    def _follow_up(self, time: float, h: float) -> float:
        """Handle what the FMU asks for after a step; return how much of the step is left [s]."""
        early, reached = self._early.value, self._reached.value
        if self._terminate.value:
            raise termination("fmi3DoStep", reached if early else time + h)
        if self._event.value and self.uses_event_mode:
            self.in_event_mode(_nothing)
        if not early or reached >= time + h:
            return 0.0
        if not reached > time:
            raise CallError("fmi3DoStep returned early without any progress", DISCARD)
        return time + h - reached

    def _handle_event(self) -> None:
        if self.update_discrete_states().terminate:
            raise termination("fmi3UpdateDiscreteStates")
        self.call("fmi3EnterStepMode")


def _nothing() -> None:
    """Change nothing: the FMU itself asks for the event."""


class Fmi3Model(_Fmi3, Model):
    """An FMI 3.0 Model Exchange instance.

    Parameters
    ----------
    states, event_indicators : int
        Their numbers, from the model description; the FMU knows better where arrays have been resized.
    """

    functions = ModelFunctions(
        "fmi3SetTime",
        "fmi3GetContinuousStates",
        "fmi3SetContinuousStates",
        "fmi3GetContinuousStateDerivatives",
        "fmi3GetNominalsOfContinuousStates",
        "fmi3GetEventIndicators",
    )

    def __init__(self, source: InstanceSource, *, states: int, event_indicators: int) -> None:
        super().__init__(source)
        self._described = (states, event_indicators)
        self._wants_event, self._wants_end = ctypes.c_bool(), ctypes.c_bool()
        self._step_flags = (True, ctypes.byref(self._wants_event), ctypes.byref(self._wants_end))

    def sizes(self) -> tuple[int, int]:
        """Return the numbers of continuous states and of event indicators."""
        names = ("fmi3GetNumberOfContinuousStates", "fmi3GetNumberOfEventIndicators")
        states, event_indicators = (
            self._size(name, described) for name, described in zip(names, self._described, strict=True)
        )
        return states, event_indicators

    def _size(self, function: str, described: int) -> int:
        size = ctypes.c_size_t()
        try:
            self.call(function, ctypes.byref(size))
        except CallError:
            return described
        return size.value

    def enter_continuous_time_mode(self) -> None:
        """Go from event mode to continuous-time mode."""
        self.call("fmi3EnterContinuousTimeMode")

    def completed_integrator_step(self) -> tuple[bool, bool]:
        """Tell the end of an integrator step; return whether it wants an event, and to terminate."""
        self.call("fmi3CompletedIntegratorStep", *self._step_flags)
        return self._wants_event.value, self._wants_end.value
