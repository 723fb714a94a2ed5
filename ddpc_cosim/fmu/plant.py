"""An FMU behind the plant contract."""

import ctypes
import hashlib
import shutil
import tempfile
import weakref
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from ddpc_cosim.errors import ConfigError, FMUImportError, FMUStepError, StepStatus
from ddpc_cosim.fmu import fmpy_api
from ddpc_cosim.fmu.description import FMUDescription, FMUVariable, read_description
from ddpc_cosim.plant import Plant
from ddpc_cosim.suggest import did_you_mean
from ddpc_cosim.variables import FloatArray

_STATUS = {fmpy_api.DISCARD: StepStatus.DISCARD, fmpy_api.FATAL: StepStatus.FATAL}
_SETTERS: dict[str, tuple[str, Any, Callable[[float], Any]]] = {
    "Real": ("fmi2SetReal", ctypes.c_double, float),
    "Integer": ("fmi2SetInteger", ctypes.c_int, int),
    "Enumeration": ("fmi2SetInteger", ctypes.c_int, int),
    "Boolean": ("fmi2SetBoolean", ctypes.c_int, bool),
}


class FMUPlant(Plant):
    """A plant that is an FMU for FMI 2.0 Co-Simulation.

    Parameters
    ----------
    path : str or Path
        The FMU.
    inputs, outputs : sequence of str, optional
        Names of the inputs to drive and of the outputs (or local variables) to read; default: all inputs and
        outputs that are real numbers.

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
        self, path: str | Path, *, inputs: Sequence[str] | None = None, outputs: Sequence[str] | None = None
    ) -> None:
        self.path = Path(path)
        self._folder = Path(tempfile.mkdtemp(prefix="ddpc-cosim-"))
        self._remove_folder = weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        self._slave: fmpy_api.Fmi2Slave | None = None
        self._may_terminate = False
        try:
            self._unpack()
            self._sha256 = hashlib.sha256(self.path.read_bytes()).hexdigest()
            self.description = read_description(self._folder, self.path.name)
            chosen = _choose(self.description, self.path.name, inputs, outputs)
            self._check_binary()
        except Exception:
            self._remove_folder()
            raise
        self.inputs = tuple(v.variable for v in chosen[0])
        self.outputs = tuple(v.variable for v in chosen[1])
        self._u = _Buffer([v.reference for v in chosen[0]])
        self._y = _Buffer([v.reference for v in chosen[1]])
        self._base_time, self._steps, self._step_size = 0.0, 0, 0.0

    def reset(self, parameters: Mapping[str, float] | None = None, t0: float = 0.0) -> FloatArray:
        """Instantiate the FMU anew, initialise it at ``t0`` and return the outputs, shape (p,)."""
        values = self._parameter_values(parameters or {}, tunable_only=False)
        self._free()
        self._base_time, self._steps, self._step_size = t0, 0, 0.0
        self._slave = slave = self._instantiate()
        self._set_real, self._do_step, self._get_real = (
            slave.function(name) for name in ("fmi2SetReal", "fmi2DoStep", "fmi2GetReal")
        )
        self._set(values)
        self._call("fmi2SetupExperiment", 0, 0.0, t0, 0, 0.0)
        self._call("fmi2EnterInitializationMode")
        self._call("fmi2ExitInitializationMode")
        self._may_terminate = True
        self._call("fmi2GetReal", *self._y.arguments)
        return self._y.values.copy()

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold the inputs u, shape (m,), over h [s] and return the outputs at its end, shape (p,)."""
        slave = self._slave
        if slave is None:
            raise ConfigError(f"{self.path.name}: step before reset")
        if h != self._step_size:
            self._base_time, self._steps, self._step_size = self.time, 0, h
        component = slave.component
        self._u.values[:] = u
        status = self._set_real(component, *self._u.arguments)
        if status > 1:
            raise self._failure("fmi2SetReal", status)
        status = self._do_step(component, self._base_time + self._steps * h, h, 1)
        if status > 1:
            raise self._failure("fmi2DoStep", status)
        self._steps += 1
        status = self._get_real(component, *self._y.arguments)
        if status > 1:
            raise self._failure("fmi2GetReal", status)
        return self._y.values.copy()

    def set_parameters(self, parameters: Mapping[str, float]) -> None:
        """Change tunable parameters from the next step on."""
        self._set(self._parameter_values(parameters, tunable_only=True))

    def close(self) -> None:
        """Terminate and free the FMU and remove its temporary folder."""
        self._free()
        self._remove_folder()

    @property
    def time(self) -> float:
        """Simulation time [s]."""
        return self._base_time + self._steps * self._step_size

    def provenance(self) -> Mapping[str, str]:
        """Return the FMU's file name, SHA-256, GUID, FMI version and exporting tool."""
        return {
            "fmu": self.path.name,
            "fmu_sha256": self._sha256,
            "fmu_guid": self.description.guid,
            "fmi_version": f"{self.description.fmi_version} Co-Simulation",
            "fmu_model": self.description.model_name,
            "fmu_tool": self.description.generation_tool,
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _unpack(self) -> None:
        if not self.path.is_file():
            raise FMUImportError(f"{self.path}: no such file")
        try:
            fmpy_api.extract(self.path, self._folder)
        except zipfile.BadZipFile as error:
            raise FMUImportError(f"{self.path.name}: not an FMU: {error}") from error
        except Exception as error:  # FMPy raises plain exceptions for illegal names
            raise FMUImportError(f"{self.path.name}: cannot be unpacked: {error}") from error

    def _check_binary(self) -> None:
        platform = fmpy_api.platform()
        binaries = self._folder / "binaries"
        name = self.description.model_identifier + fmpy_api.library_extension()
        if not (binaries / platform / name).is_file():
            present = sorted(p.name for p in binaries.iterdir() if p.is_dir()) if binaries.is_dir() else []
            raise FMUImportError(
                f"{self.path.name}: no binary for this platform (binaries/{platform}/{name}); "
                f"it has binaries for: {', '.join(present) or 'none'}. Export the FMU for {platform}."
            )

    def _instantiate(self) -> fmpy_api.Fmi2Slave:
        description = self.description
        try:
            slave = fmpy_api.Fmi2Slave(
                description.guid,
                description.model_identifier,
                self._folder,
                description.model_name,
            )
        except Exception as error:  # FMPy raises plain exceptions for whatever the loader or the FMU says
            raise FMUImportError(f"{self.path.name}: cannot be instantiated: {error}") from error
        self._finalizer = weakref.finalize(self, slave.free)
        return slave

    def _parameter_values(
        self, parameters: Mapping[str, float], *, tunable_only: bool
    ) -> list[tuple[FMUVariable, float]]:
        variables = self.description.variables
        known = [name for name, v in variables.items() if v.causality == "parameter"]
        faults = []
        for name, value in parameters.items():
            variable = variables.get(name)
            if variable is None or variable.causality != "parameter" or variable.type not in _SETTERS:
                faults.append(f'{self.path.name}: no parameter "{name}"; {did_you_mean(name, known)}')
            elif tunable_only and not variable.is_tunable:
                tunable = [n for n in known if variables[n].is_tunable]
                faults.append(
                    f'{self.path.name}: parameter "{name}" cannot change during a run; '
                    f"tunable: {', '.join(tunable) or 'none'}"
                )
            elif not variable.variable.min <= value <= variable.variable.max:
                low, high = variable.variable.min, variable.variable.max
                faults.append(
                    f"{self.path.name}: parameter {name} = {value:g} is outside [{low:g}, {high:g}]"
                )
            elif _SETTERS[variable.type][2](value) != value:
                kind = "a truth value (0 or 1)" if variable.type == "Boolean" else "a whole number"
                faults.append(f"{self.path.name}: parameter {name} = {value:g} must be {kind}")
        if faults:
            raise ConfigError(faults)
        return [(variables[name], value) for name, value in parameters.items()]

    def _set(self, values: list[tuple[FMUVariable, float]]) -> None:
        for variable, value in values:
            function, c_type, convert = _SETTERS[variable.type]
            reference = (ctypes.c_uint * 1)(variable.reference)
            self._call(function, reference, 1, (c_type * 1)(convert(value)))

    def _call(self, function: str, *arguments: Any) -> None:
        if self._slave is None:
            raise ConfigError(f"{self.path.name}: {function} before reset")
        status = self._slave.function(function)(self._slave.component, *arguments)
        if status > 1:
            raise self._failure(function, status)

    def _failure(self, function: str, status: int) -> FMUStepError:
        slave = self._slave
        details = "".join(f"; {line}" for line in list(slave.log)[-3:]) if slave else ""
        if status == fmpy_api.DISCARD and self._asks_to_terminate():
            details = f"; the FMU asks to terminate{details}"
        word = fmpy_api.status_word(status)
        message = f"{self.path.name}: {function} returned {word} at t = {self.time:g} s{details}"
        if status == fmpy_api.FATAL:
            self._abandon()
        if status != fmpy_api.DISCARD:
            self._may_terminate = False
        return FMUStepError(message, _STATUS.get(status, StepStatus.ERROR), self.time)

    def _asks_to_terminate(self) -> bool:
        if self._slave is None:
            return False
        terminated = ctypes.c_int(0)
        status = self._slave.function("fmi2GetBooleanStatus")(
            self._slave.component, fmpy_api.TERMINATED, ctypes.byref(terminated)
        )
        return status == 0 and bool(terminated.value)

    def _free(self) -> None:
        if self._slave is not None:
            if self._may_terminate:  # not before the end of initialisation, nor after an error
                self._slave.function("fmi2Terminate")(self._slave.component)
            self._slave, self._may_terminate = None, False
            self._finalizer()

    def _abandon(self) -> None:
        """Let go of an instance that no function may be called on any more (FMI 2.0, fmi2Fatal)."""
        self._slave = None
        self._finalizer.detach()


class _Buffer:
    """Preallocated memory for reading or writing real variables, seen by C and by NumPy."""

    def __init__(self, references: Sequence[int]) -> None:
        n = len(references)
        self._memory = (ctypes.c_double * n)()
        self.values: FloatArray = np.ctypeslib.as_array(self._memory)
        self.arguments = ((ctypes.c_uint * n)(*references), n, self._memory)


def _choose(
    description: FMUDescription, label: str, inputs: Sequence[str] | None, outputs: Sequence[str] | None
) -> tuple[list[FMUVariable], list[FMUVariable]]:
    """Return the variables to drive and to read; every name that does not fit is a fault."""
    faults: list[str] = []
    chosen = []
    for causality, others, wanted in (("input", (), inputs), ("output", ("local",), outputs)):
        default = description.named(causality, type="Real")
        available = [*default, *(name for other in others for name in description.named(other, type="Real"))]
        names = list(wanted) if wanted is not None else default
        for name in names:
            if name not in available:
                faults.append(f'{label}: no real {causality} "{name}"; {did_you_mean(name, available)}')
        if not names:
            faults.append(f"{label}: no {causality} chosen")
        chosen.append([description.variables[name] for name in names if name in available])
    if faults:
        raise ConfigError(faults)
    return chosen[0], chosen[1]
