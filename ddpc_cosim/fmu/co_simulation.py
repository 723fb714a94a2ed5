"""One run of an FMU for Co-Simulation: hold the inputs, do the step, read the outputs."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ddpc_cosim.errors import ConfigError
from ddpc_cosim.fmu.buffers import Port
from ddpc_cosim.fmu.description import Clock, FMUDescription, Interface
from ddpc_cosim.fmu.instance import Slave
from ddpc_cosim.fmu.run import FMURun, T
from ddpc_cosim.variables import FloatArray


class StepInC(NamedTuple):
    """What C code needs to advance an initialised slave as :meth:`CoSimulationRun.step` does.

    Parameters
    ----------
    version : int
        Of FMI: 2 or 3.
    set_values, do_step, get_values : int
        Addresses of the functions.
    instance : int
        That of the slave.
    inputs, outputs : array of uint32
        Value references of what is written before and read after every step.
    base_time, step_size : float
        Step i begins at ``base_time + i * step_size`` [s].
    steps : int
        How many have been done.
    steps_per_sample : int
        How many make a sample.
    """

    version: int
    set_values: int
    do_step: int
    get_values: int
    instance: int
    inputs: NDArray[np.uint32]
    outputs: NDArray[np.uint32]
    base_time: float
    step_size: float
    steps: int
    steps_per_sample: int


class CoSimulationRun(FMURun):
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
    clocks : sequence of Clock
        The input clocks that tick periodically, which the slave's event mode is for.
    """

    def __init__(
        self,
        slave: Slave,
        inputs: Port,
        outputs: Port,
        t0: float,
        substeps_of: Callable[[float], int],
        clocks: Sequence[Clock] = (),
    ) -> None:
        super().__init__(slave, inputs, outputs, t0, clocks)
        self._slave, self._do_step = slave, slave.do_step
        self._write_inputs = self._write
        if slave.uses_event_mode:
            self._write = lambda u: self._event(self.time, u)
        if clocks:
            self._do_step = self._step_between_ticks
        self._substeps_of = substeps_of
        self._sample, self._substeps = 0.0, 1
        self._ports, self._has_clocks = (inputs, outputs), bool(clocks)

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

    def in_c(self, h: float) -> StepInC | None:
        """Return what C code needs to step by h [s]; None: there is more to a step than its three calls.

        What it has done then is to be told by :meth:`advanced`.
        """
        slave = self._slave
        if slave.uses_event_mode or self._has_clocks or slave.functions_of_a_step is None:
            return None
        if h != self._sample:
            self._change_step_size(h)
        set_values, _, get_values = slave.functions_of_a_step
        inputs, outputs = self._ports[0].references(set_values), self._ports[1].references(get_values)
        set_address, step_address, get_address = map(slave.address, slave.functions_of_a_step)
        if inputs is None or outputs is None or not (set_address and step_address and get_address):
            return None
        return StepInC(
            slave.major,
            set_address,
            step_address,
            get_address,
            slave.component,
            inputs,
            outputs,
            self._base_time,
            self._step_size,
            self._steps,
            self._substeps,
        )

    def advanced(self, steps: int) -> None:
        """Take note of how many steps have been done in all."""
        self._steps = steps

    @property
    def end_of_sample(self) -> float:
        """When the sample ends that is being done [s]."""
        samples = self._steps // self._substeps + 1
        return self._base_time + samples * self._substeps * self._step_size

    def at_inputs(self, u: FloatArray, read: Callable[[], T]) -> T:
        """Return what is read with other inputs u, shape (m,); clocks tick with the next step's own."""
        if self._slave.uses_event_mode:
            self._slave.in_event_mode(lambda: self._write_inputs(u))
        else:
            self._write_inputs(u)
        return read()

    def change(self, set_values: Callable[[Any], None]) -> None:
        """Set parameters or inputs between two samples, in event mode where it is used."""
        if self._slave.uses_event_mode:
            self._slave.in_event_mode(lambda: set_values(self._slave))
        else:
            super().change(set_values)

    def _event(self, time: float, u: FloatArray | None = None) -> None:
        """Handle an event, at which inputs may change and the clocks tick that are due."""

        def change() -> None:
            if u is not None:
                self._write_inputs(u)
            if due := self._ticks.take(time):
                self._slave.activate_clocks(due)

        self._slave.in_event_mode(change)

    def _step_between_ticks(self, time: float, h: float) -> None:
        """Advance from ``time`` by ``h`` [s], with an event wherever a clock ticks on the way."""
        end = time + h
        while (tick := self._ticks.before(end)) < end:
            if tick > time:
                self._slave.do_step(time, tick - time)
                time = tick
            self._event(time)
        self._slave.do_step(time, end - time)

    def _bookkeeping(self) -> tuple[Any, ...]:
        return *super()._bookkeeping(), self._sample, self._substeps

    def _go_back(self, *bookkeeping: Any) -> None:
        *clock, self._sample, self._substeps = bookkeeping
        super()._go_back(*clock)

    def deserialise_state(self, content: Mapping[str, Any], *, same_inputs: bool) -> None:
        """Go on from the state of another run, in steps of the same size where that is fixed."""
        super().deserialise_state(content, same_inputs=same_inputs)
        if self._sample:
            self._substeps_of(self._sample)

    def _do_other_substeps(self) -> None:
        for _ in range(self._substeps - 1):
            self._do_step(self._base_time + self._steps * self._step_size, self._step_size)
            self._steps += 1

    def _change_step_size(self, h: float) -> None:
        substeps = self._substeps_of(h)
        self._count_in(h / substeps)
        self._sample, self._substeps = h, substeps


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
        self._clocks = description.ticking_clocks(interface)
        self._label = label
        self._current: float | None = None

    def substeps(self, h: float) -> int:
        """Return how many communication steps make a sample of length h [s].

        Raises
        ------
        ConfigError
            They would miss the ticks of a clock.
        """
        if self._interface.kind == "model-exchange":
            return 1
        if self._interface.variable_step:
            return 1
        is_free = self._preferred and self._interface.fixed_step is None
        whole = _whole(h, self._preferred) if self._preferred and is_free else 1
        steps = whole if whole is not None and whole <= _MOST_SUBSTEPS else 1
        for clock in self._clocks:
            if any(time and _whole(time, h / steps) is None for time in (clock.interval, clock.shift)):
                raise ConfigError(
                    f"{self._label}: a sampling time of {h:g} s is not possible: the FMU's steps of "
                    f'{h / steps:g} s miss the ticks of its clock "{clock.name}", every {clock.interval:g} s '
                    f"from {clock.shift:g} s on; choose a sampling time of which these are multiples"
                )
        return steps

    def remark(self, h: float) -> str:
        """Return a warning about a sampling time [s]; empty for none.

        Steps *should* be multiples of a fixed internal step (FMI 3.0 section 4.4.1): whether others are
        possible, the FMU decides.
        """
        fixed, substeps = self._interface.fixed_step, self.substeps(h)
        if fixed is not None and _whole(h, fixed) is None:
            return (
                f"a sampling time of {h:g} s is not a whole multiple of the FMU's internal step, which is "
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
