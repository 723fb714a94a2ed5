"""An FMU behind the plant contract."""

import hashlib
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from numbers import Real
from pathlib import Path
from typing import TypeVar, TypeVarTuple

import numpy as np

from ddpc_cosim.description import switches_in
from ddpc_cosim.errors import ConfigError, CosimWarning, FMUImportError
from ddpc_cosim.files.tables import plain_table
from ddpc_cosim.files.texts import printable
from ddpc_cosim.fmu.archive import UnpackLimits
from ddpc_cosim.fmu.co_simulation import StepInC
from ddpc_cosim.fmu.companions import Companions
from ddpc_cosim.fmu.description import Clock, FMUDescription, direct_dependencies, is_sampled
from ddpc_cosim.fmu.driven import DrivenRun
from ddpc_cosim.fmu.isolation import IsolatedSession
from ddpc_cosim.fmu.linearisation import Derivatives, LinearModel, linearisation_faults
from ddpc_cosim.fmu.session import FMUSession, UnpackedFMU, for_model_exchange, unpack_fmu
from ddpc_cosim.plant import FMIType, ParameterValue, Plant, library_path_faults
from ddpc_cosim.processes.limits import limits_warning
from ddpc_cosim.processes.sandbox import demanded, entered, require
from ddpc_cosim.processes.scratch import ScratchFolder
from ddpc_cosim.variables import FloatArray, Variable, names, with_display_units
from fmu_plants.spelling import did_you_mean

T = TypeVar("T")
Arguments = TypeVarTuple("Arguments")
_KIND = {"co-simulation": "Co-Simulation", "model-exchange": "Model Exchange"}
_DEFAULTS = UnpackLimits()
_STOP_MARGIN = 1e-3


class FMUPlant(Plant):
    """A plant that is an FMU for FMI 1.0, 2.0 or 3.0, Co-Simulation or Model Exchange.

    Parameters
    ----------
    path : str or Path
        The FMU.
    inputs, outputs : sequence of str, optional
        Names of the inputs to drive and of the outputs (or local variables) to read, elements of arrays as
        ``x[2]``; default: all inputs and outputs that are real numbers. Integers are rounded from what is
        driven, booleans are true from 0.5 on.
    fmi_type : str
        ``"co-simulation"``, ``"model-exchange"``, or ``"auto"``: the former if the FMU has it.
    display_units : mapping of str to str, optional
        Units to show inputs and outputs in, by name: one that the FMU defines, or another one of the same
        quantity (``"deg"`` for ``"rad"``, ``"degC"`` for ``"K"``, ...); default: as the FMU says.
    start : mapping of str to float, optional
        Values of inputs at the start and at rest, driven or not; default: the FMU's own.
    switches : mapping of str to str, optional
        For inputs that the FMU has a control of its own for, the input that switches it off, which is 1 while
        something drives them in a closed loop; empty: none. Default: ``NAME_activate`` for ``NAME_u``, where
        types and descriptions say so.
    isolated : bool
        Whether the FMU lives in a process of its own: then a crash, or a call that never returns, ends the
        run and not the caller.
    step_timeout : float
        Longest time for any call of an isolated FMU [s].
    memory_limit : float, optional
        Memory that the process of an isolated FMU may have [GB], on Linux; default: half of the machine's.
    sandbox : bool
        Whether that process is in a sandbox, in which it writes into its temporary folder only, reads what is
        installed but not your files, and has no network: see ``docs/whom-you-trust.md``.
    tolerance : float, optional
        Relative tolerance that the FMU is told, and that Model Exchange is integrated with (there 1e-12 to
        1e-2); default: the one of its default experiment. Where that has none, the FMU is told none, and
        Model Exchange is integrated with 1e-6.
    max_unpacked_size, max_files : int
        How large the FMU may get when it is unpacked: bytes, and number of files.
    max_ratio : float
        How many times its own size it may get; 10 MB are always allowed.
    trace_calls : str or Path, optional
        File that every FMI call is written to, with arguments, status and results, up to a crash.
    library_path : sequence of str or Path
        Libraries that are loaded before the FMU's, and folders that have those which it needs, on Linux. They
        come before those of the FMU and of the system.

    Attributes
    ----------
    dependencies : mapping of str to frozenset of str
        For each output the inputs that it depends on directly; all, where the FMU does not say.

    Raises
    ------
    FMUImportError
        The FMU cannot be loaded, and why.
    ConfigError
        It has no such inputs or outputs; all faults at once.

    Examples
    --------
    >>> plant = FMUPlant(pendulum_fmu, inputs=["torque"], outputs=["angle"])
    >>> plant.reset()
    array([0.])
    >>> plant.step([1.0], 0.1).shape
    (1,)
    >>> plant.close()
    """

    def __init__(
        self,
        path: str | Path,
        *,
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
        fmi_type: FMIType = "auto",
        display_units: Mapping[str, str] | None = None,
        start: Mapping[str, float] | None = None,
        switches: Mapping[str, str] | None = None,
        isolated: bool = False,
        step_timeout: float = 60.0,
        memory_limit: float | None = None,
        sandbox: bool = False,
        tolerance: float | None = None,
        max_unpacked_size: int = _DEFAULTS.max_unpacked_size,
        max_files: int = _DEFAULTS.max_files,
        max_ratio: float = _DEFAULTS.max_ratio,
        trace_calls: str | Path | None = None,
        library_path: Sequence[str | Path] = (),
    ) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise FMUImportError(f"{self.path}: no such file")
        optional = {"memory_limit": memory_limit, "tolerance": tolerance}
        given = {name: value for name, value in optional.items() if value is not None}
        faults = [
            f"{name} = {value!r} is not possible; allowed: a finite number > 0"
            for name, value in {"step_timeout": step_timeout, **given}.items()
            if not (isinstance(value, Real) and 0 < value < math.inf)
        ]
        libraries = [Path(place).absolute() for place in library_path]
        faults += library_path_faults(libraries)
        if sandbox and not isolated:
            faults.append("sandbox = True needs isolated = True: a process of its own enters it")
        if faults:
            raise ConfigError(faults)
        if isolated and (warning := limits_warning([] if memory_limit is None else [memory_limit])):
            warnings.warn(f"{self.path.name}: {warning}", CosimWarning, stacklevel=2)
        self._sandbox = require() if sandbox else entered()
        self._sha256 = hashlib.sha256(self.path.read_bytes()).hexdigest()
        self._scratch = ScratchFolder()
        self._sandboxed = sandbox
        try:
            with demanded(sandbox):
                self._fmu = unpack_fmu(
                    self.path,
                    self._scratch.path,
                    inputs=inputs,
                    outputs=outputs,
                    fmi_type=fmi_type,
                    start=start,
                    tolerance=tolerance,
                    limits=UnpackLimits(max_unpacked_size, max_files, max_ratio),
                    trace_calls=Path(trace_calls).absolute() if trace_calls else None,
                    library_path=libraries,
                )
            self.inputs, self.outputs = self._shown_in(display_units or {})
            self.dependencies = direct_dependencies(self.description, self._fmu.inputs, self._fmu.outputs)
            self.is_sampled = is_sampled(self._fmu.inputs)
            self.switches = switches_in(self.description, self.path.name, self.inputs, switches)
            self._warnings = self._fmu.warnings
            for warning in self._warnings:  # where warnings are errors, they end it here
                warnings.warn(f"{self.path.name}: {warning}", CosimWarning, stacklevel=2)
        except BaseException:
            self._scratch.remove()
            raise
        self._may_fall_back = fmi_type == "auto"
        self._open: Callable[[UnpackedFMU], FMUSession | IsolatedSession] = FMUSession
        if isolated:
            self._open = partial(
                IsolatedSession,
                folder=self._scratch.path,
                step_timeout=step_timeout,
                memory_limit=memory_limit,
                sandboxed=sandbox,
            )
        self._session = self._open(self._fmu)
        self._stop_time: float | None = None
        self._step = self._session.step

    def __repr__(self) -> str:
        how = f"FMI {self.description.fmi_version} {_KIND[self._fmu.interface.kind]}"
        signals = f"{len(self.inputs)} inputs, {len(self.outputs)} outputs"
        return printable(f"FMUPlant({self.path.name}, {how}, {signals})")

    def _repr_html_(self) -> str:
        kinds = (("input", self.inputs), ("output", self.outputs))
        rows = [
            (kind, v.name, v.unit or "1", v.start, v.min, v.max, v.description)
            for kind, variables in kinds
            for v in variables
        ]
        header = ("", "name", "unit", "start", "min", "max", "description")
        return plain_table(repr(self), header, rows).html

    def _shown_in(self, units: Mapping[str, str]) -> tuple[tuple[Variable, ...], tuple[Variable, ...]]:
        """Return inputs and outputs with the display units that are asked for."""
        inputs, outputs = ([s.variable for s in group] for group in (self._fmu.inputs, self._fmu.outputs))
        unknown = [name for name in units if name not in names((*inputs, *outputs))]
        if unknown:
            known = did_you_mean(unknown[0], names((*inputs, *outputs)))
            raise ConfigError(f'{self.path.name}: display_units: no signal "{unknown[0]}"; {known}')
        defined = self.description.display_units
        return with_display_units(inputs, units, defined), with_display_units(outputs, units, defined)

    def plan(self, sampling_time: float, stop_time: float) -> None:
        """Tell the FMU's stop time, and warn of a sampling time that does not suit its step size."""
        remark = self._fmu.remark_on_steps(sampling_time)
        if remark and remark not in self.warnings:
            self._warnings += (remark,)
        # A little later than the last sample: rounding must not make the last step an illegal one.
        stop = stop_time + _STOP_MARGIN * sampling_time
        self._stop_time = stop if math.isfinite(stop) else None

    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        """Instantiate the FMU anew, initialise it at ``t0`` and return the outputs, shape (p,).

        Besides parameters, start values (initial states) and inputs that are not driven can be given. An FMU
        that refuses to be instantiated for Co-Simulation runs for Model Exchange where it is for both and
        ``fmi_type`` is ``"auto"``; a warning tells.
        """
        arguments = parameters or {}, t0, self._stop_time
        try:
            return self._session.call(FMUSession.reset, *arguments)
        except FMUImportError as error:
            fmu = self._fmu
            if not self._may_fall_back or fmu.interface.kind == "model-exchange" or not fmu.is_for_both:
                raise
            with demanded(self._sandboxed):
                self._reopen(for_model_exchange(fmu))
            reason = str(error).removeprefix(f"{fmu.label}: ")
            self._warnings = (*self.warnings, f"runs for Model Exchange: {reason}")
            return self._session.call(FMUSession.reset, *arguments)

    def _reopen(self, fmu: UnpackedFMU) -> None:
        """Go over to the FMU as it is to run from the next reset on."""
        self._session.end()
        self._fmu = fmu
        self._session = self._open(fmu)
        self._step = self._session.step

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold the inputs u, shape (m,), over h [s] and return the outputs at its end, shape (p,)."""
        return self._step(u, h)

    def in_c(self, h: float, loop: Callable[[StepInC], tuple[T, int]]) -> T | None:
        """Let C code step the FMU by h [s] at a time: a function that returns its result and the steps done.

        None: it lives in another process, or takes more than a call each for inputs, step and outputs.
        """
        session = self._session
        return session.call(FMUSession.in_c, h, loop) if isinstance(session, FMUSession) else None

    def set_parameters(self, parameters: Mapping[str, ParameterValue]) -> None:
        """Change tunable parameters, and inputs that are not driven, from the next step on."""
        self._session.call(FMUSession.set_parameters, parameters)

    def outputs_at(self, u: FloatArray) -> FloatArray:
        """Return the outputs now, shape (p,), at other inputs u, shape (m,)."""
        return self._session.call(FMUSession.outputs_at, np.array(u, dtype=np.float64))

    def feedthrough(self, u: FloatArray) -> FloatArray | None:
        """Return the FMU's derivatives of outputs by inputs at u, shape (p, m); None if it tells none."""
        return self._session.call(FMUSession.feedthrough, np.array(u, dtype=np.float64))

    def become_driven(self) -> None:
        """Run for Model Exchange from the next reset on, integrated together with other FMUs.

        Steps are not its own then: what follows from time, states and inputs is asked for by :meth:`drive`.

        Raises
        ------
        ConfigError
            The FMU is not for Model Exchange, or opened for Co-Simulation.
        FMUImportError
            It has no library for Model Exchange.
        """
        fmu = self._fmu
        if fmu.interface.kind != "model-exchange":
            if not fmu.is_for_both:
                raise ConfigError(f"{fmu.label} is for Co-Simulation only")
            if not self._may_fall_back:
                raise ConfigError(f'{fmu.label} is opened with fmi_type = "co-simulation"')
            with demanded(self._sandboxed):
                fmu = for_model_exchange(fmu)
        self._reopen(replace(fmu, is_driven=True))

    def drive(self, method: Callable[[DrivenRun, *Arguments], T], *arguments: *Arguments) -> T:
        """Call a method of the run, where the FMU is integrated together with others."""
        return self._session.call(FMUSession.drive, method, *arguments)

    @property
    def clocks(self) -> tuple[Clock, ...]:
        """The clocks that tick as the FMU is run."""
        return self.description.ticking_clocks(self._fmu.interface)

    @property
    def discrete_inputs(self) -> frozenset[str]:
        """Names of the inputs that change at events only."""
        discrete = (s for s in self._fmu.inputs if s.source.variability == "discrete")
        return frozenset(signal.variable.name for signal in discrete)

    @property
    def can_linearise(self) -> bool:
        """Whether :meth:`linearise` works if the FMU is opened for Model Exchange."""
        return not linearisation_faults(self.description, self._fmu.inputs, self._fmu.outputs)

    def linearise(
        self, u: FloatArray | Sequence[float] | None = None, *, derivatives: Derivatives = "auto"
    ) -> LinearModel:
        """Return the continuous-time linear model about where the run is; the run goes on from there.

        Only an FMU for Model Exchange, opened for it, tells the derivatives of its states.

        Parameters
        ----------
        u : array, shape (m,), optional
            Inputs at the operating point, held from now on; default: as they are.
        derivatives : str
            ``"directional"``: the FMU's own; ``"differences"``: central differences, whose steps follow the
            nominal values; ``"auto"``: the former if the FMU has them.

        Returns
        -------
        model : LinearModel
            Matrices from the plant's inputs to its outputs, and the operating point.

        Raises
        ------
        ConfigError
            The FMU cannot be linearised, or not in this way; all faults at once.
        FMUStepError
            The FMU fails beside the point, or a derivative there is not finite.

        Examples
        --------
        >>> plant = FMUPlant(pendulum_fmu, inputs=["torque"], outputs=["angle"], fmi_type="model-exchange")
        >>> _ = plant.reset()
        >>> plant.linearise().b
        array([[0.],
               [5.]])
        >>> plant.close()
        """
        held = None if u is None else np.array(u, dtype=np.float64)
        model = self._session.call(FMUSession.linearise, held, derivatives)
        for warning in model.warnings:
            if warning not in self.warnings:
                self._warnings += (warning,)
                warnings.warn(f"{self.path.name}: {warning}", CosimWarning, stacklevel=2)
        return model

    @property
    def can_save_state(self) -> bool:
        """Whether the FMU says that its state can be saved."""
        return self._fmu.interface.can_save_state

    def save_state(self) -> object:
        """Return a copy of the FMU's state, for :meth:`restore_state` until the next reset."""
        return self._session.call(FMUSession.save_state)

    def restore_state(self, state: object) -> None:
        """Go back to a saved state."""
        self._session.call(FMUSession.restore_state, state)

    @property
    def can_serialise_state(self) -> bool:
        """Whether the FMU says that its state can be saved, and serialised."""
        return self.can_save_state and self._fmu.interface.can_serialize_state

    def serialise_state(self) -> bytes:
        """Return the FMU's state as bytes, from which another run of the same FMU can go on."""
        if not self.can_serialise_state:
            lacking = "canSerializeFMUstate" if self.can_save_state else "canGetAndSetFMUstate"
            reason = f"the FMU cannot save its state as bytes ({lacking} is false)"
            raise ConfigError(f"{self.path.name}: {reason}")
        return self._session.call(FMUSession.serialise_state)

    def deserialise_state(self, content: bytes) -> FloatArray:
        """Go on from the state of another run of the same FMU; return the outputs there, shape (p,)."""
        return self._session.call(FMUSession.deserialise_state, content)

    def close(self) -> None:
        """Terminate and free the FMU and remove its temporary folder."""
        try:
            self._session.end()
        finally:
            self._scratch.remove()

    @property
    def description(self) -> FMUDescription:
        """What the FMU says about itself."""
        return self._fmu.description

    @property
    def library(self) -> Path:
        """Its shared library, until it is closed."""
        return self._fmu.source.library

    @property
    def companions(self) -> Companions:
        """What is loaded with the FMU's library besides what is in the FMU and in the system."""
        return self._fmu.companions

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is wrong with the FMU but does not keep it from running, as far as that is known by now."""
        return tuple(filter(None, dict.fromkeys((*self._warnings, self._session.remark))))

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return self._session.time

    def provenance(self) -> Mapping[str, str]:
        """Return the FMU's file name, SHA-256, GUID, FMI version and type, tool, tolerance, and warnings.

        Of libraries of the study, and of stand-ins, it has hashes.
        """
        description = self.description
        identifiers = {"fmu_warnings": "; ".join(self.warnings)} if self.warnings else {}
        if self._fmu.tolerance is not None:
            identifiers["fmu_tolerance"] = repr(self._fmu.tolerance)
        if self._sandbox:
            identifiers["sandbox"] = self._sandbox
        if libraries := self.companions.identity:
            identifiers["fmu_libraries"] = "; ".join(f"{name}: {what}" for name, what in libraries.items())
        return {
            "fmu": self.path.name,
            "fmu_sha256": self._sha256,
            "fmu_guid": description.guid,
            "fmi_version": f"{description.fmi_version} {_KIND[self._fmu.interface.kind]}",
            "fmu_model": description.model_name,
            "fmu_tool": description.generation_tool,
            **identifiers,
        }
