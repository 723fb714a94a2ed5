"""One instance of an FMU: the functions of all FMI versions under common names.

The subclasses in :mod:`fmi1`, :mod:`fmi2` and :mod:`fmi3` say how each version calls them. Every call checks
the status that it returns.
"""

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from ddpc_cosim.fmu.call_trace import TracedFunction
from ddpc_cosim.fmu.description.variable_types import TYPES
from ddpc_cosim.fmu.library import CFunction, is_missing, load_library
from ddpc_cosim.fmu.status import FATAL, SUCCESS, CallError, Log, failed_call

DoubleArray = Any
"""A ctypes array of doubles."""


class ValueType(NamedTuple):
    """How the values of one FMI type are read and written."""

    get: str
    set: str
    c_type: Any


def value_types(major: int) -> Mapping[str, ValueType]:
    """Return how the values of each type of variables are read and written in an FMI version."""
    return {
        name: ValueType(f"fmi{major}Get{row.function}", f"fmi{major}Set{row.function}", row.c_type)
        for name, row in TYPES[major].items()
        if row.function
    }


@dataclass(frozen=True, slots=True)
class EventInfo:
    """What a discrete-state update left behind (Model Exchange).

    Parameters
    ----------
    terminate : bool
        Whether the FMU wants the simulation to end.
    nominals_changed, states_changed : bool
        Whether the integrator must start anew.
    next_event : float or None
        Time of the next time event [s].
    """

    terminate: bool
    nominals_changed: bool
    states_changed: bool
    next_event: float | None


@dataclass(frozen=True, slots=True)
class InstanceSource:
    """Where an instance comes from: the FMU's unpacked folder, its library, and the model's identifiers.

    ``trace_calls`` is the file that all calls are written to, if there is to be one; ``given`` are libraries
    that are loaded before.
    """

    folder: Path
    library: Path
    kind: str
    model_identifier: str
    guid: str
    model_name: str
    trace_calls: Path | None = None
    given: tuple[Path, ...] = ()


class Instance(ABC):
    """One instance of an FMU.

    Parameters
    ----------
    source : InstanceSource
        What to load.
    options : Any
        Settings of the FMI version's own.

    Raises
    ------
    Exception
        Whatever the loader, FMPy or the FMU says against it.
    """

    major: int
    types: Mapping[str, ValueType]
    directional_derivative = ""
    """Name of the function for directional derivatives."""

    def __init__(self, source: InstanceSource, **options: Any) -> None:
        self.log = Log(source.model_name)
        try:
            self._fmu = load_library(
                self.major,
                source.kind,
                library=source.library,
                folder=source.folder,
                model_identifier=source.model_identifier,
                guid=source.guid,
                name=self.log.instance_name,
                trace_calls=source.trace_calls,
                given=source.given,
            )
        except BaseException:
            self.log.close()
            raise
        try:
            self._instantiate_or_ask_why(options)
        except BaseException as error:
            self._fmu.freeLibrary()
            self.log.close()
            if self.log.lines:
                raise RuntimeError("; ".join([str(error), *self.log.lines])) from error
            raise
        self.component = self._fmu.component
        self.is_alive = True

    def _instantiate_or_ask_why(self, options: Mapping[str, Any]) -> None:
        """Instantiate; an FMU that refuses without a word is asked again with its log on."""
        try:
            self._instantiate(logging=False, **options)
        except CallError:
            raise
        except Exception:  # FMPy's own, for an FMU that returns no instance
            if self.log.lines:
                raise
        if not self._fmu.component and not self.log.lines:
            self._instantiate(logging=True, **options)
        if not self._fmu.component:
            raise RuntimeError("the FMU refuses to be instantiated")

    def function(self, name: str) -> CFunction:
        """Return a function of the library."""
        function: CFunction = self._fmu._functions[name]
        return function

    def address(self, name: str) -> int:
        """Return where a function of the library is; 0 where it is not there, or its calls are traced."""
        function: Any = self.function(name)
        if is_missing(function) or isinstance(function, TracedFunction):
            return 0
        return ctypes.c_void_p.from_buffer(function).value or 0

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function of this instance.

        Raises
        ------
        CallError
            It returned neither ok nor warning, or the library does not have it.
        """
        status = self.function(name)(self.component, *arguments)
        if status not in SUCCESS:
            raise failed_call(name, status)

    def free(self) -> None:
        """Free the instance and unload its library."""
        self.is_alive = False
        try:
            self._fmu.freeInstance()
        except CallError:  # the library has no such function
            self._fmu.freeLibrary()
        finally:
            self.log.close()

    def abandon(self) -> None:
        """Let go of an instance that no function may be called on any more."""
        self.is_alive = False
        self.log.close()

    @abstractmethod
    def _instantiate(self, *, logging: bool, **options: Any) -> None:
        """Instantiate through FMPy's object."""

    @abstractmethod
    def value_arguments(self, references: Any, count: int, memory: Any) -> tuple[Any, ...]:
        """Return the arguments after the component of this version's getters and setters."""

    @abstractmethod
    def initialize(
        self,
        t0: float,
        stop_time: float | None,
        tolerance: float | None,
        set_start_values: Callable[[], None],
    ) -> None:
        """Enter the initialisation; start values are set right before it.

        Parameters
        ----------
        t0, stop_time : float
            Start and end of the run [s]; None: open.
        tolerance : float or None
            Relative tolerance.
        set_start_values : callable
            Sets them. It is called last: some FMUs go back to their own start values in what comes before.
        """

    @abstractmethod
    def complete_initialization(self) -> None:
        """Leave the initialisation: outputs can be read and, in Co-Simulation, steps be done."""

    @abstractmethod
    def terminate(self) -> None:
        """End the simulation; the instance can only be freed afterwards."""

    def configure(self) -> None:
        """Enter the mode in which structural parameters are set."""
        raise CallError("FMI 1.0 and 2.0 have no structural parameters")

    def complete_configuration(self) -> None:
        """Leave the mode in which structural parameters are set."""
        raise CallError("FMI 1.0 and 2.0 have no structural parameters")

    def activate_clocks(self, references: Sequence[int]) -> None:
        """Let input clocks tick, in event mode."""
        raise CallError("FMI 1.0 and 2.0 have no clocks")

    def save_state(self) -> Any:
        """Return a copy of the FMU's state."""
        raise CallError("FMI 1.0 cannot save the state of an FMU")

    def restore_state(self, state: Any) -> None:
        """Go back to a state."""
        raise CallError("FMI 1.0 cannot restore the state of an FMU")

    def free_state(self, state: Any) -> None:
        """Free a state."""
        raise CallError("FMI 1.0 knows no states of FMUs")

    def serialise(self, state: Any) -> bytes:
        """Return a state as bytes."""
        raise CallError("FMI 1.0 cannot serialise the state of an FMU")

    def deserialise(self, content: bytes) -> Any:
        """Return the state that bytes stand for."""
        raise CallError("FMI 1.0 cannot deserialise the state of an FMU")

    @property
    def has_directional_derivatives(self) -> bool:
        """Whether the library has the function for them; whether it works, the model description says."""
        name = self.directional_derivative
        return bool(name) and not is_missing(self.function(name))

    def get_directional_derivative(
        self, unknowns: Any, known: Any, seed: DoubleArray, sensitivity: DoubleArray
    ) -> None:
        """Read by how much unknowns change per step ``seed`` of a known.

        Parameters
        ----------
        unknowns, known : ctypes array
            Value references of the variables that change, and of the one that is changed.
        seed, sensitivity : ctypes array
            A number for every element of ``known``, and for every element of ``unknowns``.
        """
        raise CallError("FMI 1.0 has no directional derivatives")


class Slave(Instance):
    """An instance for Co-Simulation."""

    uses_event_mode = False
    """Whether inputs are written within ``in_event_mode``."""
    functions_of_a_step: tuple[str, str, str] | None = None
    """What writes real inputs, does a step, and reads real outputs; None: it takes more than that."""

    def in_event_mode(self, change: Callable[[], None]) -> None:
        """Set inputs, parameters or clocks in event mode; only FMI 3.0 has one for Co-Simulation."""
        raise CallError("FMI 1.0 and 2.0 have no event mode for Co-Simulation")

    @abstractmethod
    def do_step(self, time: float, h: float) -> None:
        """Advance from ``time`` by ``h`` [s].

        Raises
        ------
        CallError
            The FMU did not get there.
        """


class ModelFunctions(NamedTuple):
    """Names of the functions that all FMI versions have in common for Model Exchange."""

    set_time: str
    get_states: str
    set_states: str
    get_derivatives: str
    get_nominals: str
    get_event_indicators: str


class Model(Instance):
    """An instance for Model Exchange. Vectors are ctypes arrays; every method may raise CallError."""

    functions: ModelFunctions

    @abstractmethod
    def sizes(self) -> tuple[int, int]:
        """Return the numbers of continuous states and of event indicators."""

    @abstractmethod
    def enter_event_mode(self) -> None:
        """Go from continuous-time mode to event mode."""

    @abstractmethod
    def update_discrete_states(self) -> EventInfo:
        """Iterate over events until the discrete states have settled."""

    @abstractmethod
    def enter_continuous_time_mode(self) -> None:
        """Go from event mode to continuous-time mode."""

    @abstractmethod
    def completed_integrator_step(self) -> tuple[bool, bool]:
        """Tell the end of an integrator step; return whether it wants an event, and to terminate."""

    def set_time(self, time: float) -> None:
        """Set the independent variable [s]."""
        self.call(self.functions.set_time, time)

    def get_states(self, x: DoubleArray, n: int) -> None:
        """Read the continuous states."""
        self.call(self.functions.get_states, x, n)

    def set_states(self, x: DoubleArray, n: int) -> None:
        """Write the continuous states."""
        self.call(self.functions.set_states, x, n)

    def get_derivatives(self, dx: DoubleArray, n: int) -> None:
        """Read the derivatives of the continuous states."""
        self.call(self.functions.get_derivatives, dx, n)

    def get_nominals(self, x: DoubleArray, n: int) -> None:
        """Read the nominal values of the continuous states; zeros where the FMU does not say."""
        try:
            self.call(self.functions.get_nominals, x, n)
        except CallError as error:
            if error.code == FATAL:
                raise
            ctypes.memset(x, 0, n * ctypes.sizeof(ctypes.c_double))

    def get_event_indicators(self, z: DoubleArray, n: int) -> None:
        """Read the event indicators."""
        self.call(self.functions.get_event_indicators, z, n)


_LARGEST_STATE = 1 << 28


def serialised(size_of: Callable[[Any], None], write: Callable[[Any, int], None]) -> bytes:
    """Return a state as bytes, by the functions that tell its size and that write it."""
    size = ctypes.c_size_t()
    size_of(ctypes.byref(size))
    if size.value > _LARGEST_STATE:
        raise CallError(f"the FMU's state has {size.value} bytes; allowed: {_LARGEST_STATE}")
    memory = (ctypes.c_ubyte * size.value)()
    write(memory, size.value)
    return bytes(memory)


def reference_array(references: Sequence[int]) -> Any:
    """Return value references as C wants them."""
    return (ctypes.c_uint * len(references))(*references)
