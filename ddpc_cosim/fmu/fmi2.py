"""FMI 2.0, Co-Simulation and Model Exchange."""

import ctypes
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import fmpy.fmi2

from ddpc_cosim.fmu.instance import (
    EventInfo,
    Instance,
    InstanceSource,
    Model,
    ModelFunctions,
    Slave,
    serialised,
    value_types,
)
from ddpc_cosim.fmu.status import DISCARD, SUCCESS, CallError, failed_call, fmi2_callbacks, termination

_LAST_SUCCESSFUL_TIME, _TERMINATED = 2, 3
_MOST_ITERATIONS = 1000


class _Fmi2(Instance):
    major = 2
    kind: int
    types = value_types(2)
    directional_derivative = "fmi2GetDirectionalDerivative"

    def _instantiate(self, *, logging: bool, **options: Any) -> None:
        fmu = self._fmu
        fmu.callbacks = fmi2_callbacks(self.log)  # kept as long as the instance
        fmu.component = self.function("fmi2Instantiate")(
            fmu.instanceName.encode("utf-8"),
            self.kind,
            fmu.guid.encode("utf-8"),
            _resource_location(fmu.unzipDirectory),
            ctypes.byref(fmu.callbacks),
            False,
            logging,
        )
        if not fmu.component:
            raise RuntimeError("Failed to instantiate model")

    def value_arguments(self, references: Any, count: int, memory: Any) -> tuple[Any, ...]:
        return references, len(references), memory

    def initialize(
        self,
        t0: float,
        stop_time: float | None,
        tolerance: float | None,
        set_start_values: Callable[[], None],
    ) -> None:
        self.call(
            "fmi2SetupExperiment",
            tolerance is not None,
            tolerance or 0.0,
            t0,
            stop_time is not None,
            stop_time or 0.0,
        )
        # Not before: in it, FMUs of 20-sim set all values to their own start values.
        set_start_values()
        self.call("fmi2EnterInitializationMode")

    def complete_initialization(self) -> None:
        self.call("fmi2ExitInitializationMode")

    def terminate(self) -> None:
        self.call("fmi2Terminate")

    def save_state(self) -> Any:
        state = ctypes.c_void_p()
        self.call("fmi2GetFMUstate", ctypes.byref(state))
        return state

    def restore_state(self, state: Any) -> None:
        self.call("fmi2SetFMUstate", state)

    def free_state(self, state: Any) -> None:
        self.call("fmi2FreeFMUstate", ctypes.byref(state))

    def serialise(self, state: Any) -> bytes:
        return serialised(
            partial(self.call, "fmi2SerializedFMUstateSize", state),
            lambda memory, size: self.call("fmi2SerializeFMUstate", state, _characters(memory), size),
        )

    def deserialise(self, content: bytes) -> Any:
        state = ctypes.c_void_p()
        memory = (ctypes.c_ubyte * len(content)).from_buffer_copy(content)
        arguments = _characters(memory), len(content), ctypes.byref(state)
        self.call("fmi2DeSerializeFMUstate", *arguments)
        return state

    def get_directional_derivative(self, unknowns: Any, known: Any, seed: Any, sensitivity: Any) -> None:
        references = (unknowns, len(unknowns), known, len(known))
        self.call(self.directional_derivative, *references, seed, sensitivity)


@lru_cache(maxsize=8)
def _resource_location(folder: str) -> bytes:
    """Return the URI of the resources of an FMU that is unpacked in a folder."""
    return Path(folder, "resources").as_uri().encode("utf-8")


def _characters(memory: Any) -> Any:
    """Return bytes as FMI 2.0 calls them."""
    return ctypes.cast(memory, ctypes.POINTER(ctypes.c_char))


class Fmi2Slave(_Fmi2, Slave):
    """An FMI 2.0 Co-Simulation instance."""

    kind = fmpy.fmi2.fmi2CoSimulation
    functions_of_a_step = ("fmi2SetReal", "fmi2DoStep", "fmi2GetReal")

    def __init__(self, source: InstanceSource) -> None:
        super().__init__(source)
        self._do_step = partial(self.function("fmi2DoStep"), self.component)

    def do_step(self, time: float, h: float) -> None:
        """Advance from ``time`` by ``h`` [s]."""
        status = self._do_step(time, h, 1)
        if status not in SUCCESS:
            if status == DISCARD and self._status("Boolean", _TERMINATED, ctypes.c_int()):
                raise termination(
                    "fmi2DoStep", self._status("Real", _LAST_SUCCESSFUL_TIME, ctypes.c_double())
                )
            raise failed_call("fmi2DoStep", status)

    def _status(self, kind: str, what: int, answer: Any) -> Any:
        """Return a status of a discarded step from the FMU; None where it gives none."""
        try:
            self.call(f"fmi2Get{kind}Status", what, ctypes.byref(answer))
        except CallError:
            return None
        return answer.value


class Fmi2Model(_Fmi2, Model):
    """An FMI 2.0 Model Exchange instance.

    Parameters
    ----------
    states, event_indicators : int
        Their numbers, from the model description.
    """

    kind = fmpy.fmi2.fmi2ModelExchange
    functions = ModelFunctions(
        "fmi2SetTime",
        "fmi2GetContinuousStates",
        "fmi2SetContinuousStates",
        "fmi2GetDerivatives",
        "fmi2GetNominalsOfContinuousStates",
        "fmi2GetEventIndicators",
    )

    def __init__(self, source: InstanceSource, *, states: int, event_indicators: int) -> None:
        super().__init__(source)
        self._sizes = (states, event_indicators)
        self._enter_event, self._terminate_flag = ctypes.c_int(), ctypes.c_int()
        self._step_flags = (1, ctypes.byref(self._enter_event), ctypes.byref(self._terminate_flag))

    def sizes(self) -> tuple[int, int]:
        """Return the numbers of continuous states and of event indicators."""
        return self._sizes

    def enter_event_mode(self) -> None:
        """Go from continuous-time mode to event mode."""
        self.call("fmi2EnterEventMode")

    def enter_continuous_time_mode(self) -> None:
        """Go from event mode to continuous-time mode."""
        self.call("fmi2EnterContinuousTimeMode")

    def update_discrete_states(self) -> EventInfo:
        """Iterate over events until the discrete states have settled."""
        info = fmpy.fmi2.fmi2EventInfo()
        nominals = states = False
        for _ in range(_MOST_ITERATIONS):
            self.call("fmi2NewDiscreteStates", ctypes.byref(info))
            nominals |= bool(info.nominalsOfContinuousStatesChanged)
            states |= bool(info.valuesOfContinuousStatesChanged)
            if info.terminateSimulation or not info.newDiscreteStatesNeeded:
                next_event = info.nextEventTime if info.nextEventTimeDefined else None
                return EventInfo(bool(info.terminateSimulation), nominals, states, next_event)
        raise CallError(f"the event iteration did not end after {_MOST_ITERATIONS} fmi2NewDiscreteStates")

    def completed_integrator_step(self) -> tuple[bool, bool]:
        """Tell the end of an integrator step; return whether it wants an event, and to terminate."""
        self.call("fmi2CompletedIntegratorStep", *self._step_flags)
        return bool(self._enter_event.value), bool(self._terminate_flag.value)
