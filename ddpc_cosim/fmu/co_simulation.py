"""One run of an FMU for Co-Simulation: hold the inputs, do the step, read the outputs."""

from collections.abc import Callable
from functools import partial
from typing import Any

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.fmu.buffers import Port
from ddpc_cosim.fmu.description import FMUDescription, Interface
from ddpc_cosim.fmu.instance import Slave
from ddpc_cosim.fmu.run import Run
from ddpc_cosim.fmu.status import CallError
from ddpc_cosim.variables import FloatArray


class CoSimulationRun(Run):
    """An initialised slave between two samples.

    Parameters
    ----------
    slave : Slave
        The instance, after its initialisation.
    inputs, outputs : Port
        What is written before and read after every step.
    t0 : float
        Start time [s].
    substeps_of : callable
        Returns how many communication steps make a sample of a length; may raise ConfigError.
    """

    def __init__(
        self, slave: Slave, inputs: Port, outputs: Port, t0: float, substeps_of: Callable[[float], int]
    ) -> None:
        super().__init__(slave, inputs, outputs, t0)
        self._do_step = slave.do_step
        if slave.uses_event_mode:
            self._write = partial(slave.in_event_mode, self._write)
        self._substeps_of = substeps_of
        self._sample, self._substeps = 0.0, 1

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold u, shape (m,), over h [s] and return the outputs at its end, shape (p,)."""
        self.require_going()
        if h != self._sample:
            self._change_step_size(h)
        self._write(u)
        try:
            self._do_step(self._base_time + self._steps * self._step_size, self._step_size)
            self._steps += 1
            if self._substeps > 1:
                self._do_other_substeps()
        except CallError as error:
            last = self._base_time + (self._steps + 1) * self._step_size
            if (self._steps + 1) % self._substeps or error.reached is None:
                raise
            if error.reached < last - _WHOLE * h:
                raise
            self._ending = error
            self._steps += 1
        return self._read()

    def _bookkeeping(self) -> tuple[Any, ...]:
        return *super()._bookkeeping(), self._sample, self._substeps

    def _go_back(self, *bookkeeping: Any) -> None:
        *clock, self._sample, self._substeps = bookkeeping
        super()._go_back(*clock)

    def _do_other_substeps(self) -> None:
        for _ in range(self._substeps - 1):
            self._do_step(self._base_time + self._steps * self._step_size, self._step_size)
            self._steps += 1

    def _change_step_size(self, h: float) -> None:
        substeps = self._substeps_of(h)
        self._base_time, self._steps = self.time, 0
        self._sample, self._substeps, self._step_size = h, substeps, h / substeps


# Beyond that, an FMU's preferred step is not meant for communication.
_MOST_SUBSTEPS = 10_000
_WHOLE = 1e-6


class StepSizes:
    """The step sizes of one FMU in one run.

    An FMU whose step size is fixed is stepped with the step size that its default experiment prefers if that
    divides the sampling time; inputs are held meanwhile.

    Parameters
    ----------
    description : FMUDescription
        The FMU.
    interface : Interface
        How it is run.
    label : str
        The FMU's file name, for errors.
    """

    def __init__(self, description: FMUDescription, interface: Interface, label: str) -> None:
        self._interface = interface
        self._preferred = description.default_experiment.step_size
        self._label = label
        self._current: float | None = None

    def substeps(self, h: float) -> int:
        """Return how many communication steps make a sample of length h [s]."""
        if self._interface.kind == "model-exchange":
            return 1
        if self._interface.variable_step:
            return 1
        is_free = self._preferred and self._interface.fixed_step is None
        steps = _whole(h, self._preferred) if self._preferred and is_free else 1
        return steps if steps is not None and steps <= _MOST_SUBSTEPS else 1

    def remark(self, h: float) -> str:
        """Return what is to be said of a sampling time [s]; empty for nothing.

        Steps *should* be multiples of a fixed internal step (FMI 3.0 section 4.4.1): whether others are
        possible, the FMU decides.
        """
        fixed, substeps = self._interface.fixed_step, self.substeps(h)
        if fixed is not None and _whole(h, fixed) is None:
            return (
                f"a sampling time of {h:g} s is no whole multiple of the FMU's internal step, which is "
                f"fixed at {fixed:g} s: outputs may lag behind by up to one such step, or the FMU may refuse"
            )
        if substeps > 1:
            return f"the FMU's step size is fixed: {substeps} steps of {h / substeps:g} s per sample"
        return ""

    def change(self, h: float) -> int:
        """Return the same during a run, in which a fixed step size cannot change.

        Raises
        ------
        ConfigError
            It would.
        """
        if not self._interface.variable_step and self._current is not None:
            raise ConfigError(
                f"{self._label}: the step size cannot change from {self._current:g} s to {h:g} s: "
                "the FMU's is fixed during a run (canHandleVariableCommunicationStepSize is false)"
            )
        substeps = self.substeps(h)
        self._current = h
        return substeps


def _whole(h: float, step: float) -> int | None:
    """Return how many steps make h, None if that is not an integer."""
    ratio = h / step
    steps = round(ratio)
    return steps if steps >= 1 and abs(ratio - steps) <= _WHOLE * steps else None
