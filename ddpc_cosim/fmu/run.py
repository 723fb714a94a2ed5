"""One run of an initialised FMU, sample by sample: what Co-Simulation and Model Exchange have in common."""

import math
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from math import inf
from typing import Any, Protocol, TypeVar

import numpy as np

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.fmu.description import Clock
from ddpc_cosim.variables import FloatArray

T = TypeVar("T")


class Restorable(Protocol):
    """What runs: an instance of an FMU, or several as one."""

    def save_state(self) -> Any:
        """Return a copy of its state."""

    def restore_state(self, state: Any) -> None:
        """Go back to a state."""

    def free_state(self, state: Any) -> None:
        """Free a state."""

    def serialise(self, state: Any) -> bytes:
        """Return a state as bytes."""

    def deserialise(self, content: bytes) -> Any:
        """Return a state of bytes."""


class Written(Protocol):
    """Numbers that are written together."""

    def write(self, u: FloatArray) -> None:
        """Write the numbers u, shape (m,)."""


class Readable(Protocol):
    """Numbers that are read together."""

    def read(self) -> FloatArray:
        """Read the numbers into a new array, shape (p,)."""


class SavedState:
    """The state of a run at a sample; freed with the object, or with the run.

    Parameters
    ----------
    run : FMURun
        The run that it belongs to.
    handle : Any
        The FMU's own state.
    bookkeeping : tuple
        What the run itself must remember.
    """

    def __init__(self, run: "FMURun", handle: Any, bookkeeping: tuple[Any, ...]) -> None:
        self.run = weakref.ref(run)
        self.handle = handle
        self.bookkeeping = bookkeeping
        self.free = weakref.finalize(self, run.instance.free_state, handle)


# Of an interval: two times that are as near are one, however they were computed.
_ONE_INSTANT = 1e-9


class Ticks:
    """The ticks of periodic clocks: at integer multiples of the interval, computed and never accumulated.

    A tick at the instant of a sample comes after the outputs of that sample have been read, together with its
    inputs: the FMU then takes these up at once.

    Parameters
    ----------
    clocks : sequence of Clock
        The clocks that tick.
    t0 : float
        Start time of the run [s].
    """

    def __init__(self, clocks: Sequence[Clock], t0: float) -> None:
        self._clocks, self._start = clocks, t0
        self._near = _ONE_INSTANT * min((clock.interval for clock in clocks), default=0.0)
        self.counts = [0] * len(clocks)

    def before(self, end: float) -> float:
        """Return when the next clock ticks before a time [s]; infinity for none."""
        next_tick = min(map(self._time, range(len(self._clocks))), default=inf)
        return next_tick if next_tick < end - self._near else inf

    def take(self, time: float) -> list[int]:
        """Return the value references of the clocks that tick at a time [s], each tick once."""
        due = [i for i in range(len(self._clocks)) if self._time(i) <= time + self._near]
        for i in due:
            self.counts[i] += 1
        return [self._clocks[i].reference for i in due]

    def _time(self, i: int) -> float:
        return self._start + self._clocks[i].shift + self.counts[i] * self._clocks[i].interval


def _is_alike(given: Any, present: Any) -> bool:
    """Whether something is of the kind of what is there: a number, inputs or none, a tuple of these."""
    if isinstance(present, tuple):
        is_tuple = isinstance(given, tuple) and len(given) == len(present)
        return is_tuple and all(map(_is_alike, given, present))
    if isinstance(present, int | float):
        return isinstance(given, int | float) and not math.isnan(given)
    return given is None or (isinstance(given, np.ndarray) and given.ndim == 1)


class FMURun(ABC):
    """An initialised FMU between two samples.

    Time is computed as an integer multiple of the step and never accumulated.

    Parameters
    ----------
    instance : Restorable
        What runs, after its initialisation.
    inputs, outputs : Written and Readable
        What is written before and read after every step.
    t0 : float
        Start time [s].
    clocks : sequence of Clock
        The input clocks that tick periodically.
    """

    def __init__(
        self,
        instance: Restorable,
        inputs: Written,
        outputs: Readable,
        t0: float,
        clocks: Sequence[Clock] = (),
    ) -> None:
        self.instance = instance
        self._ticks = Ticks(clocks, t0)
        self._write, self._read = inputs.write, outputs.read
        self._base_time, self._steps, self._step_size = t0, 0, 0.0
        self._states: weakref.WeakSet[SavedState] | None = None  # as for most runs, which save none

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return self._base_time + self._steps * self._step_size

    @property
    def end_of_sample(self) -> float:
        """When the sample ends that is being done [s]."""
        return self._base_time + (self._steps + 1) * self._step_size

    def _count_in(self, step_size: float) -> None:
        """Count time in steps of another size [s]; where they lead here, from the same start."""
        steps = self._steps * self._step_size / step_size
        if steps.is_integer():  # halves of steps, and steps of halves
            self._steps = int(steps)
        else:
            self._base_time, self._steps = self.time, 0
        self._step_size = step_size

    @abstractmethod
    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold u, shape (m,), over h [s] and return the outputs at its end, shape (p,).

        Raises
        ------
        CallError
            The FMU did not get there.
        ConfigError
            The FMU does not allow this step size.
        """

    def outputs(self) -> FloatArray:
        """Return the outputs now, shape (p,)."""
        return self._read()

    def at_inputs(self, u: FloatArray, read: Callable[[], T]) -> T:
        """Return what is read with other inputs u, shape (m,), before the next step sets its own."""
        self._write(u)
        return read()

    def change(self, set_values: Callable[[Any], None]) -> None:
        """Set parameters or inputs of what runs between two samples."""
        set_values(self.instance)

    def save_state(self) -> SavedState:
        """Return a copy of the state."""
        state = SavedState(self, self.instance.save_state(), self._bookkeeping())
        if self._states is None:
            self._states = weakref.WeakSet()
        self._states.add(state)
        return state

    def restore_state(self, state: object) -> None:
        """Go back to a state.

        Raises
        ------
        ConfigError
            It is not one of this run.
        """
        if not isinstance(state, SavedState) or state.run() is not self:
            raise ConfigError("the state is not one of this run: states do not outlive a reset")
        self.instance.restore_state(state.handle)
        self._go_back(*state.bookkeeping)

    def serialise_state(self) -> dict[str, Any]:
        """Return the state as plain data."""
        state = self.save_state()
        try:
            return {"run": self._bookkeeping(), "fmu": self.instance.serialise(state.handle)}
        finally:
            state.free()

    def deserialise_state(self, content: Mapping[str, Any], *, same_inputs: bool) -> None:
        """Go on from the state of another run, which may have driven other inputs.

        Raises
        ------
        ConfigError
            It is not one of this FMU.
        """
        bookkeeping, handle = content["run"], content["fmu"]
        if not (_is_alike(bookkeeping, self._bookkeeping()) and isinstance(handle, bytes)):
            raise ConfigError("the state is not one of this FMU")
        state = self.instance.deserialise(handle)
        try:
            self.instance.restore_state(state)
        finally:
            self.instance.free_state(state)
        self._go_back(*bookkeeping)
        if not same_inputs:
            self._forget_inputs()

    def _forget_inputs(self) -> None:  # noqa: B027 - few runs remember them
        """Write the inputs of the next step, whatever they were."""

    def _bookkeeping(self) -> tuple[Any, ...]:
        """Return what the run must remember besides the FMU's state."""
        return self._base_time, self._steps, self._step_size, tuple(self._ticks.counts)

    def _go_back(self, *bookkeeping: Any) -> None:
        """Restore what :meth:`_bookkeeping` returned."""
        self._base_time, self._steps, self._step_size, counts = bookkeeping
        self._ticks.counts[:] = counts

    def end(self, *, abandoned: bool = False) -> None:
        """Free all saved states; of an abandoned instance, forget them without touching it."""
        for state in list(self._states or ()):
            if abandoned:
                state.free.detach()
            else:
                state.free()
