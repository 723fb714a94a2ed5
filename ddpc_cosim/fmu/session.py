"""One FMU in this process: what :class:`FMUPlant` and the isolated child process drive.

Call order: ``plan`` (optional), ``reset`` once per run, then ``step`` with ``set_parameters``, ``save_state``
and ``restore_state`` between two steps, and ``close`` at the end.
"""

import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from weakref import WeakValueDictionary

import numpy as np

from ddpc_cosim.errors import ConfigError, FMUImportError, FMUStepError
from ddpc_cosim.fmu.archive import UnpackLimits, unpack
from ddpc_cosim.fmu.buffers import Port, Shapes, StartValues
from ddpc_cosim.fmu.co_simulation import CoSimulationRun, StepSizes
from ddpc_cosim.fmu.description import FMUDescription, Interface, Signal, choose_interface, choose_signals
from ddpc_cosim.fmu.description.reader import read_description
from ddpc_cosim.fmu.fmi1 import Fmi1Model, Fmi1Slave
from ddpc_cosim.fmu.fmi2 import Fmi2Model, Fmi2Slave
from ddpc_cosim.fmu.fmi3 import Fmi3Model, Fmi3Slave
from ddpc_cosim.fmu.instance import Instance, Model, Origin, Slave
from ddpc_cosim.fmu.library import find_library
from ddpc_cosim.fmu.linearisation import (
    DERIVATIVES,
    Derivatives,
    LinearModel,
    has_directional_derivatives,
    linearisation_faults,
    linearise,
)
from ddpc_cosim.fmu.model_exchange import ModelExchangeRun
from ddpc_cosim.fmu.output import quiet, step_mute
from ddpc_cosim.fmu.run import Run
from ddpc_cosim.fmu.scratch import ScratchFolder
from ddpc_cosim.fmu.status import DISCARD, FATAL, CallError
from ddpc_cosim.plant import FMIType, ParameterValue
from ddpc_cosim.variables import FloatArray

_SLAVES: dict[int, type[Slave]] = {1: Fmi1Slave, 2: Fmi2Slave, 3: Fmi3Slave}
_MODELS: dict[int, type[Model]] = {1: Fmi1Model, 2: Fmi2Model, 3: Fmi3Model}
_DEFAULT_TOLERANCE = 1e-6
_TOLERANCES = (1e-12, 1e-2)

_only_ones: WeakValueDictionary[tuple[str, str], Instance] = WeakValueDictionary()
"""The instances of FMUs that allow only one in a process."""


def make_instance(
    origin: Origin, description: FMUDescription, interface: Interface, driven: Sequence[Signal]
) -> Instance:
    """Load and instantiate the FMU; raises whatever the loader or the FMU says."""
    key = (interface.model_identifier, description.guid)
    other = _only_ones.get(key)
    if interface.only_one_instance and other is not None and other.is_alive:
        raise RuntimeError(
            "it allows one instance per process (canBeInstantiatedOnlyOncePerProcess), and there is one; "
            "close that, or give each a process of its own (isolated=True)"
        )
    instance = _new_instance(origin, description, interface, driven)
    if interface.only_one_instance:
        _only_ones[key] = instance
    return instance


def _new_instance(
    origin: Origin, description: FMUDescription, interface: Interface, driven: Sequence[Signal]
) -> Instance:
    if interface.kind == "model-exchange":
        sizes = {"states": description.continuous_states, "event_indicators": description.event_indicators}
        return _MODELS[description.major](origin, **sizes)
    # Only inputs that are discrete need event mode; without it the FMU handles its events itself.
    discrete = any(signal.source.variability == "discrete" for signal in driven)
    event_mode = {"event_mode": interface.has_event_mode and discrete} if description.major == 3 else {}
    return _SLAVES[description.major](origin, **event_mode)


def start_run(
    instance: Instance,
    inputs: Port,
    outputs: Port,
    t0: float,
    *,
    description: FMUDescription,
    interface: Interface,
    tolerance: float | None,
    label: str,
) -> Run:
    """Return the run of an instance that has been initialised."""
    if isinstance(instance, Model):
        low, high = _TOLERANCES
        own = description.default_experiment.tolerance or _DEFAULT_TOLERANCE
        chosen = tolerance if tolerance is not None else min(max(own, low), high)
        needs_completed_step = interface.needs_completed_step or description.major == 1
        return ModelExchangeRun(
            instance, inputs, outputs, t0, tolerance=chosen, needs_completed_step=needs_completed_step
        )
    if isinstance(instance, Slave):
        steps = StepSizes(description, interface, label)
        return CoSimulationRun(instance, inputs, outputs, t0, steps.change)
    raise TypeError(f"{type(instance).__name__} is neither a slave nor a model")


_STOP_MARGIN = 1e-3


class FMUSession:
    """One unpacked FMU in this process.

    Parameters
    ----------
    path : Path
        The FMU.
    inputs, outputs : sequence of str, optional
        Names of the inputs to drive and of the outputs (or local variables) to read; default: all that are
        real numbers.
    fmi_type : str
        ``"co-simulation"``, ``"model-exchange"``, or ``"auto"``: the former if the FMU has it.
    tolerance : float, optional
        Relative tolerance of the integration; default: the FMU's own.
    unpack_limits : UnpackLimits
        How large the FMU may get when it is unpacked.

    Raises
    ------
    FMUImportError
        The FMU cannot be loaded, and why.
    ConfigError
        It has no such inputs or outputs; all faults at once.
    """

    def __init__(
        self,
        path: Path,
        *,
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
        fmi_type: FMIType = "auto",
        tolerance: float | None = None,
        unpack_limits: UnpackLimits | None = None,
    ) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise FMUImportError(f"{self.path}: no such file")
        self._label = self.path.name
        self._tolerance = tolerance
        self._instance: Instance | None = None
        self._run: Run | None = None
        self._scratch = ScratchFolder()
        folder = self._scratch.path
        try:
            unpack(self.path, folder, unpack_limits)
            self.description = read_description(folder, self._label)
            self.interface = choose_interface(self.description, fmi_type, self._label)
            library, remarks = find_library(folder, self.description, self.interface, self._label)
            self._inputs, self._outputs = choose_signals(self.description, self._label, inputs, outputs)
        except BaseException:
            self._scratch.remove()
            raise
        self.warnings: tuple[str, ...] = (*self.description.warnings, *remarks)
        if self.interface.needs_execution_tool:
            self._warn(f"the FMU needs the tool that made it: {self.description.generation_tool}")
        self._origin = Origin(
            folder=folder,
            library=library,
            kind=self.interface.kind,
            model_identifier=self.interface.model_identifier,
            guid=self.description.guid,
            model_name=self.description.model_name or self._label,
        )
        self.inputs = tuple(signal.variable for signal in self._inputs)
        self.outputs = tuple(signal.variable for signal in self._outputs)
        self._mute = step_mute(library.parent)
        self._shapes: Shapes = {}
        self._stop_time: float | None = None
        self._may_terminate = False
        self._time = 0.0

    def plan(self, sampling_time: float, stop_time: float) -> None:
        """Say what the coming run will ask: its sampling time and the time of its last sample [s].

        Raises
        ------
        ConfigError
            The FMU cannot run so.
        """
        substeps = StepSizes(self.description, self.interface, self._label).substeps(sampling_time)
        if substeps > 1:
            self._warn(
                f"the FMU's step size is fixed: {substeps} steps of {sampling_time / substeps:g} s per sample"
            )
        # A little later than the last sample: rounding must not make the last step an illegal one.
        self._stop_time = stop_time + _STOP_MARGIN * sampling_time

    @quiet()
    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        """Instantiate the FMU anew, initialise it at ``t0`` and return the outputs, shape (p,).

        Structural parameters are set first, then the other start values, in the state that the standard
        wants.

        Raises
        ------
        ConfigError
            A parameter is unknown or its value impossible; all faults at once.
        FMUImportError
            The FMU cannot be instantiated.
        FMUStepError
            It cannot be initialised, or refuses a value.
        """
        values = StartValues(self.description, self._label, parameters or {}, self._inputs)
        self._free()
        self._time = t0
        instance = self._instantiate()
        try:
            values.set_structural(instance)
            values.set_before_initialization(instance)
            instance.initialize(t0, self._stop_time, self._tolerance)
            instance.complete_initialization()
            self._may_terminate = True
            self._shapes = values.shapes
            inputs = Port(instance, self._inputs, values.shapes)
            outputs = Port(instance, self._outputs, values.shapes)
            inputs.fetch()
            self._run = start_run(
                instance,
                inputs,
                outputs,
                t0,
                description=self.description,
                interface=self.interface,
                tolerance=self._tolerance,
                label=self._label,
            )
            values.check_taken(instance)
            return self._run.outputs()
        except CallError as error:
            raise self._failure(error) from error

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold the inputs u, shape (m,), over h [s] and return the outputs at its end, shape (p,).

        Raises
        ------
        FMUStepError
            The FMU did not get there.
        """
        run = self._run
        if run is None:
            raise ConfigError(f"{self._label}: step before reset")
        mute = self._mute
        if mute is not None:
            mute.on()
        try:
            return run.step(u, h)
        except CallError as error:
            raise self._failure(error) from error
        finally:
            if mute is not None:
                mute.off()

    @quiet()
    def set_parameters(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Change tunable parameters, and inputs that are not driven, from the next step on.

        Raises
        ------
        ConfigError
            The FMU has no such variable, or it cannot change during a run.
        FMUStepError
            The FMU refuses a value.
        """
        run = self._started("set_parameters")
        values = StartValues(self.description, self._label, parameters, self._inputs, tunable_only=True)
        try:
            run.change(values.set_during_run)
        except CallError as error:
            raise self._failure(error) from error

    @quiet()
    def linearise(self, u: FloatArray | None = None, derivatives: Derivatives = "auto") -> LinearModel:
        """Return the linear model about where the run is, with the inputs u, shape (m,), held from now on.

        Raises
        ------
        ConfigError
            The FMU cannot be linearised, or not in this way; all faults at once.
        FMUStepError
            The FMU fails beside the point, or a derivative there is not finite.
        """
        run = self._started("linearise")
        faults = linearisation_faults(self.description, self._inputs, self._outputs)
        if not faults and not isinstance(run, ModelExchangeRun):
            faults = ['the FMU runs for Co-Simulation; open it with fmi_type = "model-exchange"']
        if derivatives not in DERIVATIVES:
            faults.append(f'derivatives = "{derivatives}" is not possible; allowed: {", ".join(DERIVATIVES)}')
        if u is not None and np.shape(u) != (len(self._inputs),):
            faults.append(f"u has shape {np.shape(u)}; needed: {len(self._inputs)} numbers")
        if faults or not isinstance(run, ModelExchangeRun):
            raise ConfigError([f"{self._label}: {fault}" for fault in faults])
        told = has_directional_derivatives(run.model, self.description, self._shapes)
        if derivatives == "directional" and not told:
            raise ConfigError(
                f"{self._label}: the FMU has no directional derivatives; differences do without"
            )
        try:
            if u is not None:
                run.hold(u)
            return linearise(
                run.model,
                self._inputs,
                self._outputs,
                self._shapes,
                self.description,
                directional=told and derivatives != "differences",
            )
        except CallError as error:
            raise self._failure(error) from error

    @property
    def can_save_state(self) -> bool:
        """Whether the FMU says that its state can be saved."""
        return self.interface.can_save_state

    @quiet()
    def save_state(self) -> object:
        """Return a copy of the FMU's state, for :meth:`restore_state` of the same run.

        Raises
        ------
        ConfigError
            The FMU cannot.
        FMUStepError
            It fails to.
        """
        run = self._started("save_state")
        if not self.can_save_state:
            raise ConfigError(f"{self._label}: the FMU cannot save its state (canGetAndSetFMUstate is false)")
        try:
            return run.save_state()
        except CallError as error:
            raise self._failure(error) from error

    @quiet()
    def restore_state(self, state: object) -> None:
        """Go back to a saved state of this run.

        Raises
        ------
        ConfigError
            The state is not of this run.
        FMUStepError
            The FMU fails to.
        """
        run = self._started("restore_state")
        try:
            run.restore_state(state)
        except CallError as error:
            raise self._failure(error) from error

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return self._run.time if self._run is not None else self._time

    @property
    def log(self) -> tuple[str, ...]:
        """What the FMU has said last."""
        return tuple(self._instance.log.lines) if self._instance is not None else ()

    @quiet()
    def close(self) -> None:
        """Terminate and free the FMU and remove its temporary folder."""
        self._free()
        self._scratch.remove()

    def _warn(self, warning: str) -> None:
        if warning not in self.warnings:
            self.warnings += (warning,)

    def _started(self, what: str) -> Run:
        if self._run is None:
            raise ConfigError(f"{self._label}: {what} before reset")
        return self._run

    def _instantiate(self) -> Instance:
        try:
            instance = make_instance(self._origin, self.description, self.interface, self._inputs)
        except Exception as error:  # FMPy raises plain exceptions for whatever the loader or the FMU says
            tool = self.description.generation_tool
            needs = f"; it needs {tool} on this machine" if self.interface.needs_execution_tool else ""
            raise FMUImportError(
                f"{self._label}: cannot be instantiated: {_one_line(error)}{needs}"
            ) from error
        self._instance = instance
        self._finalizer = weakref.finalize(self, instance.free)
        return instance

    def _failure(self, error: CallError) -> FMUStepError:
        details = "; the FMU asks to terminate" if error.asks_to_terminate else ""
        details += "".join(f"; {line}" for line in self.log[-3:])
        time = self.time
        if error.code == FATAL:
            self._abandon()
        elif error.code != DISCARD:
            self._may_terminate = False
        return FMUStepError(f"{self._label}: {error} at t = {time:g} s{details}", error.status, time)

    def _free(self) -> None:
        run, instance = self._run, self._instance
        self._run = self._instance = None
        if run is not None:
            run.end()
        if instance is not None:
            if self._may_terminate:  # not before the end of the initialisation, nor after an error
                _terminate(instance)
            self._finalizer()
        self._may_terminate = False

    def _abandon(self) -> None:
        """Let go of an instance that no function may be called on any more (FMI: status fatal)."""
        if self._instance is not None:
            self._time = self.time
            if self._run is not None:
                self._run.end(abandoned=True)
            self._instance.abandon()
            self._finalizer.detach()
        self._run = self._instance = None


def _terminate(instance: Instance) -> None:
    """Terminate; a failure has no consequences, as nothing but freeing follows."""
    try:
        instance.terminate()
    except CallError:
        return


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:300] or type(error).__name__
