"""One FMU: unpacked and described, and a session of it in this process.

Call order: ``reset`` once per run, then ``step`` with ``set_parameters``, ``save_state`` and
``restore_state`` between two steps, and ``close`` at the end.
"""

import warnings
import weakref
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar, TypeVarTuple
from weakref import WeakValueDictionary

import numpy as np

from ddpc_cosim.description import PlantSignal, choose_signals
from ddpc_cosim.errors import ConfigError, CosimWarning, FMUImportError, FMUStepError
from ddpc_cosim.files.durations import shown
from ddpc_cosim.files.plain_data import from_bytes, to_bytes, understood
from ddpc_cosim.fmu.archive import UnpackLimits, unpack
from ddpc_cosim.fmu.arithmetic import KeptArithmetic, is_usual, unusual_state
from ddpc_cosim.fmu.buffers import BlockLayout, Port, Shapes, StartValues, block_layouts
from ddpc_cosim.fmu.co_simulation import CoSimulationRun, StepInC, StepSizes
from ddpc_cosim.fmu.companions import Companions, find_companions
from ddpc_cosim.fmu.description import FMUDescription, Interface, choose_interface
from ddpc_cosim.fmu.description.reader import read_description
from ddpc_cosim.fmu.driven import DrivenRun
from ddpc_cosim.fmu.fmi1 import Fmi1Model, Fmi1Slave
from ddpc_cosim.fmu.fmi2 import Fmi2Model, Fmi2Slave
from ddpc_cosim.fmu.fmi3 import Fmi3Model, Fmi3Slave
from ddpc_cosim.fmu.instance import Instance, InstanceSource, Model, Slave
from ddpc_cosim.fmu.library import find_library
from ddpc_cosim.fmu.linearisation import (
    DERIVATIVES,
    Derivatives,
    LinearModel,
    directional_derivatives,
    has_directional_derivatives,
    linearisation_faults,
    linearise,
)
from ddpc_cosim.fmu.model_exchange import ModelExchangeRun
from ddpc_cosim.fmu.run import FMURun
from ddpc_cosim.fmu.status import DISCARD, FATAL, CallError
from ddpc_cosim.plant import FMIType, ParameterValue
from ddpc_cosim.variables import FloatArray

T = TypeVar("T")
Arguments = TypeVarTuple("Arguments")
_SLAVES: dict[int, type[Slave]] = {1: Fmi1Slave, 2: Fmi2Slave, 3: Fmi3Slave}
_MODELS: dict[int, type[Model]] = {1: Fmi1Model, 2: Fmi2Model, 3: Fmi3Model}
_DEFAULT_TOLERANCE = 1e-6
_ONE_INSTANT = 1e-6  # of a step: where an FMU says that it ended, rounded in its own way

_only_ones: WeakValueDictionary[tuple[str, str], Instance] = WeakValueDictionary()
"""The instances of FMUs that allow only one in a process."""


@dataclass(frozen=True, slots=True)
class UnpackedFMU:
    """An FMU in a folder, described; its library has not run.

    Parameters
    ----------
    label : str
        The FMU's file name, for errors.
    description : FMUDescription
        What it says about itself.
    interface : Interface
        How it is run.
    inputs, outputs : tuple of PlantSignal
        What is driven and what is read.
    source : InstanceSource
        What to load.
    warnings : tuple of str
        What is wrong with the FMU but does not keep it from running.
    tolerance : float or None
        Relative tolerance that the FMU is told, the one of its default experiment unless another is given;
        None: none.
    companions : Companions
        What is loaded with its library.
    start : mapping of str to float
        Start values of inputs, driven or not, in place of the FMU's own.
    is_driven : bool
        Whether its runs are integrated together with those of other FMUs.
    """

    label: str
    description: FMUDescription
    interface: Interface
    inputs: tuple[PlantSignal, ...]
    outputs: tuple[PlantSignal, ...]
    source: InstanceSource
    warnings: tuple[str, ...]
    tolerance: float | None
    companions: Companions = field(default_factory=Companions)
    start: Mapping[str, float] = field(default_factory=dict)
    is_driven: bool = False

    @property
    def is_for_both(self) -> bool:
        """Whether it can be run for Co-Simulation and for Model Exchange."""
        return len(self.description.interfaces) > 1

    def remark_on_steps(self, sampling_time: float) -> str:
        """Return a warning about a sampling time [s]; empty for none.

        Raises
        ------
        ConfigError
            The FMU's clocks do not allow it.
        """
        return StepSizes(self.description, self.interface, self.label).remark(sampling_time)


def unpack_fmu(
    path: Path,
    folder: Path,
    *,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    fmi_type: FMIType = "auto",
    start: Mapping[str, float] | None = None,
    tolerance: float | None = None,
    limits: UnpackLimits | None = None,
    trace_calls: Path | None = None,
    library_path: Sequence[Path] = (),
) -> UnpackedFMU:
    """Unpack and describe an FMU; parameters as of :class:`FMUPlant`.

    Raises
    ------
    FMUImportError
        The FMU cannot be loaded, and why.
    ConfigError
        It has no such inputs or outputs; all faults at once.
    """
    label = path.name
    unpack(path, folder, limits)
    description = read_description(folder, label)
    interface = choose_interface(description, fmi_type, label)
    library, library_warnings = find_library(folder, description, interface, label)
    companions = find_companions(library, folder / "resources", library_path)
    driven, read = choose_signals(description, label, inputs, outputs)
    start = start or {}
    StartValues(description, label, start, ())  # so that an impossible one is told now, and not at a reset
    declared = description.default_experiment.tolerance
    if tolerance is None and declared is not None and declared > 0.0:
        tolerance = declared
    tool = f"the FMU needs the tool that made it: {description.generation_tool}"
    source = InstanceSource(
        folder=folder,
        library=library,
        kind=interface.kind,
        model_identifier=interface.model_identifier,
        guid=description.guid,
        model_name=description.model_name or label,
        trace_calls=trace_calls,
        given=companions.given,
    )
    warnings = dict.fromkeys(
        (
            *description.warnings,
            *library_warnings,
            *companions.warnings,
            *([tool] if interface.needs_execution_tool else []),
        )
    )
    return UnpackedFMU(
        label,
        description,
        interface,
        tuple(_starting_at(start, signal) for signal in driven),
        read,
        source,
        tuple(warnings),
        tolerance,
        companions,
        start,
    )


def for_model_exchange(fmu: UnpackedFMU) -> UnpackedFMU:
    """Return an FMU that is for both, run for Model Exchange.

    Raises
    ------
    FMUImportError
        It has no library for it.
    """
    interface = fmu.description.interfaces["model-exchange"]
    library, _ = find_library(fmu.source.folder, fmu.description, interface, fmu.label)
    find_companions(library, fmu.source.folder / "resources", fmu.source.given)
    identifier = interface.model_identifier
    source = replace(fmu.source, library=library, kind=interface.kind, model_identifier=identifier)
    return replace(fmu, interface=interface, source=source)


def _starting_at(start: Mapping[str, float], signal: PlantSignal) -> PlantSignal:
    variable = signal.variable
    return replace(signal, variable=replace(variable, start=start.get(variable.name, variable.start)))


class FMUSession:
    """One FMU in this process: what is behind the methods of :class:`FMUPlant`, which say what they raise.

    Each but :meth:`step` is called by :meth:`call`, here or in another process.

    Parameters
    ----------
    fmu : UnpackedFMU
        The FMU.

    Attributes
    ----------
    remark : str
        What is to be said of how the FMU has run so far; empty for nothing. It is a warning, given once.
    """

    def __init__(self, fmu: UnpackedFMU) -> None:
        self.fmu = fmu
        self._instance: Instance | None = None
        self._run: FMURun | None = None
        self._shapes: Shapes = {}
        self._layouts: list[list[BlockLayout]] = []
        self._may_terminate = False
        self._time = 0.0
        self._end_error: CallError | None = None
        self._arithmetic, self.remark = KeptArithmetic(), ""

    def call(self, method: Callable[["FMUSession", *Arguments], T], *arguments: *Arguments) -> T:
        """Call a method; a call of the FMU's that failed is raised as an error of the contract.

        This process computes afterwards as it did before, whatever the FMU does to that.
        """
        try:
            with self._arithmetic:
                return method(self, *arguments)
        except CallError as error:
            raise self._failure(error) from error
        finally:
            self._tell_change()

    def reset(
        self, parameters: Mapping[str, ParameterValue], t0: float, stop_time: float | None
    ) -> FloatArray:
        """Instantiate the FMU anew, initialise it at ``t0`` and return the outputs, shape (p,).

        Structural parameters are set first, then the other start values, in the state that the standard
        wants.
        """
        fmu = self.fmu
        driven = [signal for signal in fmu.inputs if signal.variable.name not in fmu.start]
        values = StartValues(fmu.description, fmu.label, {**fmu.start, **parameters}, driven)
        self.end()
        self._time, self._end_error = t0, None
        instance = self._instantiate()
        values.set_structural(instance)
        instance.initialize(t0, stop_time, fmu.tolerance, lambda: values.set_before_initialization(instance))
        instance.complete_initialization()
        self._may_terminate = True
        if not self._layouts or values.shapes != self._shapes:
            self._layouts = [block_layouts(signals, values.shapes) for signals in (fmu.inputs, fmu.outputs)]
            self._shapes = values.shapes
        inputs, outputs = (Port(instance, layouts) for layouts in self._layouts)
        inputs.fetch()
        self._run = _start_run(fmu, instance, inputs, outputs, values.shapes, t0)
        values.check_taken(instance)
        return self._run.outputs()

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold the inputs u, shape (m,), over h [s] and return the outputs at its end, shape (p,).

        Where the FMU ends the simulation at the end of a step, the outputs there are returned, and the next
        call tells.
        """
        run = self._run
        if run is None or self._end_error is not None:
            run = self._started("step")
        before = unusual_state()  # as by `call`, with two calls less
        try:
            return run.step(u, h)
        except CallError as error:
            return self._last_outputs(run, h, error)
        finally:
            if before is not None or not is_usual():
                self._arithmetic.put_back(before)
                self._tell_change()

    def in_c(self, h: float, loop: Callable[[StepInC], tuple[T, int]]) -> T | None:
        """Let C code step the FMU by h [s] at a time: a function that returns its result and the steps done.

        None: this FMU takes more than that.
        """
        run = self._started("in_c")
        if not isinstance(run, CoSimulationRun) or (step := run.in_c(h)) is None:
            return None
        result, steps = loop(step)
        run.advanced(steps)
        return result

    def _last_outputs(self, run: FMURun, h: float, error: CallError) -> FloatArray:
        """Return the outputs where the FMU ended at the end of a step; raise the error if it did not."""
        if error.reached is None or error.reached < run.end_of_sample - _ONE_INSTANT * h:
            raise self._failure(error) from error
        try:
            last = run.outputs()
        except CallError as fault:
            raise self._failure(fault) from fault
        self._time, self._end_error = run.end_of_sample, error
        return last

    def set_parameters(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Change tunable parameters, and inputs that are not driven, from the next step on."""
        run, fmu = self._started("set_parameters"), self.fmu
        values = StartValues(fmu.description, fmu.label, parameters, fmu.inputs, tunable_only=True)
        run.change(values.set_during_run)

    def linearise(self, u: FloatArray | None, derivatives: Derivatives) -> LinearModel:
        """Return the linear model about where the run is, with the inputs u, shape (m,), held from now on."""
        run, fmu, model = self._started("linearise"), self.fmu, self._instance
        faults = linearisation_faults(fmu.description, fmu.inputs, fmu.outputs)
        if not faults and not isinstance(run, ModelExchangeRun):
            faults = ['the FMU runs for Co-Simulation; open it with fmi_type = "model-exchange"']
        if derivatives not in DERIVATIVES:
            faults.append(f'derivatives = "{derivatives}" is not possible; allowed: {", ".join(DERIVATIVES)}')
        if u is not None and np.shape(u) != (len(fmu.inputs),):
            faults.append(f"u has shape {np.shape(u)}; needed: {len(fmu.inputs)} numbers")
        if faults or not isinstance(run, ModelExchangeRun) or not isinstance(model, Model):
            raise ConfigError([f"{fmu.label}: {fault}" for fault in faults])
        has_derivatives = has_directional_derivatives(model, fmu.description, self._shapes)
        if derivatives == "directional" and not has_derivatives:
            raise ConfigError(f"{fmu.label}: the FMU has no directional derivatives; differences do without")
        if u is not None:
            run.hold(u)
        return linearise(
            model,
            fmu.inputs,
            fmu.outputs,
            self._shapes,
            fmu.description,
            directional=has_derivatives and derivatives != "differences",
        )

    def outputs_at(self, u: FloatArray) -> FloatArray:
        """Return the outputs now with other inputs u, shape (m,)."""
        run = self._started("outputs_at")
        return run.at_inputs(u, run.outputs)

    def feedthrough(self, u: FloatArray) -> FloatArray | None:
        """Return the derivatives of the outputs by the inputs, shape (p, m), at u; None: not known."""
        run, fmu, instance = self._started("feedthrough"), self.fmu, self._instance
        declared = all(s.source.causality == "output" and s.source.values == "real" for s in fmu.outputs)
        continuous = all(signal.source.variability == "continuous" for signal in fmu.inputs)
        tells = fmu.interface.provides_directional_derivatives
        if instance is None or not (
            declared and continuous and tells and instance.has_directional_derivatives
        ):
            return None
        arguments = instance, fmu.outputs, fmu.inputs, self._shapes
        try:
            return run.at_inputs(u, lambda: directional_derivatives(*arguments))
        except CallError as error:
            if error.code == FATAL:
                raise
            return None

    def drive(self, method: Callable[[DrivenRun, *Arguments], T], *arguments: *Arguments) -> T:
        """Call a method of the run of an FMU that is driven."""
        run = self._started("drive")
        if not isinstance(run, DrivenRun):
            raise ConfigError(f"{self.fmu.label}: it is not integrated together with others")
        return method(run, *arguments)

    def save_state(self) -> object:
        """Return a copy of the FMU's state, for :meth:`restore_state` of the same run."""
        run = self._started("save_state")
        if not self.fmu.interface.can_save_state:
            reason = "the FMU cannot save its state (canGetAndSetFMUstate is false)"
            raise ConfigError(f"{self.fmu.label}: {reason}")
        return run.save_state()

    def restore_state(self, state: object) -> None:
        """Go back to a saved state of this run."""
        self._end_error = None  # back to before it
        self._started("restore_state").restore_state(state)

    def serialise_state(self) -> bytes:
        """Return the state as bytes, from which another run of the FMU can go on."""
        run, fmu = self._started("serialise_state"), self.fmu
        driven = [signal.variable.name for signal in fmu.inputs]
        return to_bytes({"type": fmu.interface.kind, "inputs": driven, **run.serialise_state()})

    def deserialise_state(self, content: bytes) -> FloatArray:
        """Go on from the state of another run of the FMU; return the outputs there, shape (p,)."""
        run, fmu = self._started("deserialise_state"), self.fmu
        driven = [signal.variable.name for signal in fmu.inputs]
        with understood(f"{fmu.label}: the state"):
            state = from_bytes(content)
            if state["type"] != fmu.interface.kind:
                raise ConfigError(
                    f"{fmu.label}: the state was saved of the FMU run for {state['type']}, and this runs for "
                    f"{fmu.interface.kind}; choose that by fmi_type"
                )
            run.deserialise_state(state, same_inputs=state["inputs"] == driven)
        return run.outputs()

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return self._run.time if self._run is not None and self._end_error is None else self._time

    @property
    def log(self) -> tuple[str, ...]:
        """What the FMU has logged last."""
        return tuple(self._instance.log.lines) if self._instance is not None else ()

    def end(self) -> None:
        """Call :meth:`close`."""
        self.call(FMUSession.close)

    def close(self) -> None:
        """Terminate and free the FMU."""
        run, instance = self._run, self._instance
        self._run = self._instance = None
        if run is not None:
            run.end()
        if instance is not None:
            if self._may_terminate:  # not before the end of the initialisation, nor after an error
                with suppress(CallError):  # without consequences: nothing but freeing follows
                    instance.terminate()
            self._finalizer()
        self._may_terminate = False

    def _tell_change(self) -> None:
        """Warn, once, of an FMU that changes how this process computes."""
        if self._arithmetic.change and not self.remark:
            self.remark = self._arithmetic.change
            self._warn()

    def _warn(self) -> None:
        warnings.warn(f"{self.fmu.label}: {self.remark}", CosimWarning, stacklevel=5)

    def _started(self, what: str) -> FMURun:
        if self._end_error is not None:
            raise self._failure(self._end_error) from self._end_error
        if self._run is None:
            raise ConfigError(f"{self.fmu.label}: {what} before reset")
        return self._run

    def _instantiate(self) -> Instance:
        """Load and instantiate the FMU."""
        fmu = self.fmu
        try:
            instance = _make_instance(fmu)
        except Exception as error:  # FMPy raises plain exceptions for whatever the loader or the FMU says
            tool = fmu.description.generation_tool
            needs = f"; it needs {tool} on this machine" if fmu.interface.needs_execution_tool else ""
            raise FMUImportError(f"{fmu.label}: cannot be instantiated: {_one_line(error)}{needs}") from error
        self._instance = instance
        self._finalizer = weakref.finalize(self, _free, instance)
        return instance

    def _failure(self, error: CallError) -> FMUStepError:
        details = "; the FMU asks to terminate" if error.asks_to_terminate else ""
        details += "".join(f"; {line}" for line in self.log[-3:])
        time = self.time if error.reached is None else max(error.reached, self.time)
        if error.code == FATAL:
            self._abandon()
        elif error.code != DISCARD:
            self._may_terminate = False
        return FMUStepError(f"{self.fmu.label}: {error} at t = {shown(time)}{details}", error.status, time)

    def _abandon(self) -> None:
        """Let go of an instance that no function may be called on any more (FMI: status fatal)."""
        if self._instance is not None:
            self._time = self.time
            if self._run is not None:
                self._run.end(abandoned=True)
            self._instance.abandon()
            self._finalizer.detach()
        self._run = self._instance = None


def _free(instance: Instance) -> None:
    """Free an instance, whenever that is."""
    with KeptArithmetic():
        instance.free()


def _make_instance(fmu: UnpackedFMU) -> Instance:
    """Load and instantiate an FMU; raises whatever the loader or the FMU says."""
    description, interface = fmu.description, fmu.interface
    key = (interface.model_identifier, description.guid)
    if interface.only_one_instance and (other := _only_ones.get(key)) is not None and other.is_alive:
        raise RuntimeError(
            "it allows one instance per process (canBeInstantiatedOnlyOncePerProcess), and there is one; "
            "close that, or give each a process of its own (isolated=True)"
        )
    instance: Instance
    if interface.kind == "model-exchange":
        sizes = {"states": description.continuous_states, "event_indicators": description.event_indicators}
        instance = _MODELS[description.major](fmu.source, **sizes)
    else:
        instance = _make_slave(fmu)
    if interface.only_one_instance:
        _only_ones[key] = instance
    return instance


def _make_slave(fmu: UnpackedFMU) -> Slave:
    """Instantiate an FMU for Co-Simulation, with the event mode of FMI 3.0 where that is needed."""
    description = fmu.description
    make = _SLAVES[description.major]
    if not fmu.interface.has_event_mode:
        return make(fmu.source, **({"event_mode": False} if description.major == 3 else {}))
    # Without clocks and discrete inputs the FMU handles its events itself, unless it refuses to.
    is_discrete = any(signal.source.variability == "discrete" for signal in fmu.inputs)
    if is_discrete or description.clocks:
        return make(fmu.source, event_mode=True)
    try:
        return make(fmu.source, event_mode=False)
    except Exception:  # FMPy's own, for an FMU that returns no instance
        return make(fmu.source, event_mode=True)


def _start_run(
    fmu: UnpackedFMU, instance: Instance, inputs: Port, outputs: Port, shapes: Shapes, t0: float
) -> FMURun:
    """Return the run of an instance that has been initialised."""
    clocks = fmu.description.ticking_clocks(fmu.interface)
    if isinstance(instance, Slave):
        steps = StepSizes(fmu.description, fmu.interface, fmu.label)
        return CoSimulationRun(instance, inputs, outputs, t0, steps.change, clocks)
    if not isinstance(instance, Model):
        raise TypeError(f"{type(instance).__name__} is neither a slave nor a model")
    needs_completed_step = fmu.interface.needs_completed_step or fmu.description.major == 1
    if fmu.is_driven:
        places = [i for i, signal in enumerate(fmu.inputs) if signal.source.variability != "discrete"]
        continuous = Port(instance, block_layouts([fmu.inputs[i] for i in places], shapes))
        continuous.fetch()
        return DrivenRun(
            instance, inputs, outputs, (continuous, places), t0, needs_completed_step=needs_completed_step
        )
    return ModelExchangeRun(
        instance,
        inputs,
        outputs,
        t0,
        tolerance=fmu.tolerance or _DEFAULT_TOLERANCE,
        needs_completed_step=needs_completed_step,
        has_discrete_inputs=any(signal.source.variability == "discrete" for signal in fmu.inputs),
        clocks=clocks,
    )


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__
