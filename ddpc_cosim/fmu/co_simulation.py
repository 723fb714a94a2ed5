"""One run of an FMU for Co-Simulation: hold the inputs, do the step, read the outputs."""

from collections.abc import Callable
from functools import partial
from typing import Any

from ddpc_cosim.fmu.calls import WARNING, failed_call
from ddpc_cosim.fmu.instance import BareStep, Slave
from ddpc_cosim.fmu.ports import Block, Port
from ddpc_cosim.fmu.run import Run
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
        if h != self._sample:
            self._change_step_size(h)
        self._write(u)
        self._do_step(self._base_time + self._steps * self._step_size, self._step_size)
        self._steps += 1
        if self._substeps > 1:
            self._do_other_substeps()
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


class BareRun(CoSimulationRun):
    """The same for the usual FMU, whose inputs and outputs are real numbers: without any detour.

    Parameters
    ----------
    slave, inputs, outputs, t0, substeps_of
        As of :class:`CoSimulationRun`.
    set_inputs, get_outputs : Block
        The calls that move all inputs and all outputs.
    step : BareStep
        The slave's step.
    """

    def __init__(
        self,
        slave: Slave,
        inputs: Port,
        outputs: Port,
        t0: float,
        substeps_of: Callable[[float], int],
        *,
        set_inputs: Block,
        get_outputs: Block,
        step: BareStep,
    ) -> None:
        super().__init__(slave, inputs, outputs, t0, substeps_of)
        self._u, self._set, self._inputs = set_inputs.values, set_inputs.set, set_inputs
        self._y, self._get, self._outputs = get_outputs.values, get_outputs.get, get_outputs
        self._call, self._last, self._check = step

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold u, shape (m,), over h [s] and return the outputs at its end, shape (p,)."""
        if h != self._sample:
            self._change_step_size(h)
        self._u[:] = u
        status = self._set()
        if status > WARNING:
            raise failed_call(self._inputs.names.set, status)
        status = self._call(self._base_time + self._steps * self._step_size, self._step_size, self._last)
        if status > WARNING:
            self._check(status)
        self._steps += 1
        if self._substeps > 1:
            self._do_other_substeps()
        status = self._get()
        if status > WARNING:
            raise failed_call(self._outputs.names.get, status)
        return self._y.copy()
