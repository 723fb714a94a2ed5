"""One run of an initialised FMU, sample by sample: what Co-Simulation and Model Exchange have in common."""

import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.fmu.buffers import Port
from ddpc_cosim.fmu.instance import Instance
from ddpc_cosim.fmu.status import CallError
from ddpc_cosim.variables import FloatArray


class SavedState:
    """The state of a run at a sample; freed with the object, or with the run.

    Parameters
    ----------
    run : Run
        The run that it belongs to.
    handle : Any
        The FMU's own state.
    bookkeeping : tuple
        What the run itself must remember.
    """

    def __init__(self, run: "Run", handle: Any, bookkeeping: tuple[Any, ...]) -> None:
        self.run = weakref.ref(run)
        self.handle = handle
        self.bookkeeping = bookkeeping
        self.free = weakref.finalize(self, run.instance.free_state, handle)


class Run(ABC):
    """An initialised FMU between two samples.

    Time is computed from whole numbers of steps and never accumulated.

    Parameters
    ----------
    instance : Instance
        The instance, after its initialisation.
    inputs, outputs : Port
        What is written before and read after every step.
    t0 : float
        Start time [s].
    """

    def __init__(self, instance: Instance, inputs: Port, outputs: Port, t0: float) -> None:
        self.instance = instance
        self._write, self._read = inputs.write, outputs.read
        self._base_time, self._steps, self._step_size = t0, 0, 0.0
        self._states: weakref.WeakSet[SavedState] = weakref.WeakSet()
        self._ending: CallError | None = None

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return self._base_time + self._steps * self._step_size

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

    def require_going(self) -> None:
        """Raise what has ended the simulation at the last sample, if something has.

        A plant that asks to terminate where a step ends has reached that sample: it is kept, and the run ends
        with the next step.
        """
        if self._ending is not None:
            raise self._ending

    def outputs(self) -> FloatArray:
        """Return the outputs now, shape (p,)."""
        return self._read()

    def change(self, set_values: Callable[[Instance], None]) -> None:
        """Set parameters or inputs between two samples."""
        set_values(self.instance)

    def save_state(self) -> SavedState:
        """Return a copy of the state."""
        state = SavedState(self, self.instance.save_state(), self._bookkeeping())
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

    def _bookkeeping(self) -> tuple[Any, ...]:
        """Return what the run must remember besides the FMU's state."""
        return self._base_time, self._steps, self._step_size, self._ending

    def _go_back(self, *bookkeeping: Any) -> None:
        """Restore what :meth:`_bookkeeping` returned."""
        self._base_time, self._steps, self._step_size, self._ending = bookkeeping

    def end(self, *, abandoned: bool = False) -> None:
        """Free all saved states; of an abandoned instance, forget them without touching it."""
        for state in list(self._states):
            if abandoned:
                state.free.detach()
            else:
                state.free()
