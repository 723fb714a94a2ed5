"""What an FMU is, what it can do, and what is wrong with it, without running it."""

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ddpc_cosim.description import DescribedVariable, switches_of
from ddpc_cosim.errors import ConfigError, FMUImportError
from ddpc_cosim.files.time_tables import TimeTable
from ddpc_cosim.fmu.archive import UnpackLimits, unpack
from ddpc_cosim.fmu.companions import say_nothing
from ddpc_cosim.fmu.description import INTERFACES, Clock, FMUDescription, Interface, is_sampled
from ddpc_cosim.fmu.description.defects import Defect, Findings, Kind, Severity
from ddpc_cosim.fmu.description.reader import read_tolerantly
from ddpc_cosim.fmu.resources import Resources, read_resources, unit_of
from ddpc_cosim.inspection.binaries import Binaries, check_binaries
from ddpc_cosim.inspection.checks import check_description, check_resources
from ddpc_cosim.plant import library_path_faults
from ddpc_cosim.processes.scratch import ScratchFolder
from ddpc_cosim.variables import Variable

REFUSED = Kind("refused", Severity.ERROR, "the file cannot be opened as an FMU")
UNREADABLE = Kind("unreadable", Severity.ERROR, "the model description cannot be understood")
INVALID = Kind("invalid", Severity.WARNING, "found by the full validation")

_NO_BINARIES = Binaries((), False, "")
_NOTHING = FMUDescription("", "", "", {}, {})  # declared by what cannot be read


@dataclass(frozen=True)
class Inspection:
    """What is known of an FMU before it runs.

    Parameters
    ----------
    path : Path
        The file.
    size : int
        Its bytes.
    sha256 : str
        Their hash.
    description : FMUDescription or None
        What it says about itself; None if that cannot be read.
    binaries : Binaries
        What it brings to run on.
    defects : tuple of Defect
        What is wrong, the worst first.
    resources : Resources
        What lies in its folder ``resources``: tables over time, and what its author says of its use.
    """

    path: Path
    size: int
    sha256: str
    description: FMUDescription | None
    binaries: Binaries
    defects: tuple[Defect, ...]
    resources: Resources

    @property
    def can_run(self) -> bool:
        """Whether it can run here, as far as is known."""
        return all(defect.severity is not Severity.ERROR for defect in self.defects)

    @property
    def declared(self) -> FMUDescription:
        """The description, empty if it cannot be read."""
        return self.description or _NOTHING

    @property
    def inputs(self) -> tuple[Variable, ...]:
        """The numbers that a controller can drive; arrays element by element."""
        return self._signals("input")

    @property
    def outputs(self) -> tuple[Variable, ...]:
        """The numbers that can be controlled or measured; arrays element by element."""
        return self._signals("output")

    @property
    def parameters(self) -> tuple[DescribedVariable, ...]:
        """The parameters that a study can set."""
        variables = self.declared.variables.values()
        return tuple(v for v in variables if v.causality in ("parameter", "structuralParameter"))

    @property
    def states(self) -> tuple[Variable, ...]:
        """The continuous states that the description names."""
        variables = self.declared.variables
        return tuple(variables[name].variable for name in self.declared.states if name in variables)

    @property
    def interfaces(self) -> tuple[Interface, ...]:
        """In which ways it can be run, the preferred one first."""
        interfaces = self.declared.interfaces
        return tuple(interfaces[kind] for kind in INTERFACES if kind in interfaces)

    @property
    def clocks(self) -> dict[Clock, bool]:
        """Its clocks, and whether they tick here."""
        preferred = self.declared.preferred
        ticking = self.declared.ticking_clocks(preferred) if preferred else ()
        return {clock: clock in ticking for clock in self.declared.clocks}

    @property
    def is_sampled(self) -> bool:
        """Whether it is a sampled block, such as an exported controller."""
        return is_sampled([*self.declared.signals("input")])

    @property
    def switches(self) -> dict[str, str]:
        """For each input that overrides a control of its own, the input that switches the override on."""
        return switches_of(self.declared)

    @property
    def feedthrough(self) -> dict[str, tuple[str, ...] | None]:
        """The inputs on which each output depends without delay; None where the FMU does not say."""
        inputs = {v.name for v in self.declared.variables.values() if v.causality == "input"}
        return {
            output: None if names is None else tuple(name for name in names if name in inputs)
            for output, names in self.declared.dependencies.items()
        }

    def _signals(self, causality: str) -> tuple[Variable, ...]:
        return tuple(s.variable for s in self.declared.signals(causality))


def inspect_fmu(
    path: str | Path,
    *,
    strict: bool = False,
    unpack_limits: UnpackLimits | None = None,
    library_path: Sequence[str | Path] = (),
    tell: Callable[[str], object] = say_nothing,
) -> Inspection:
    """Look at an FMU; the time it takes is linear in the number of variables, except with ``strict``.

    Of one that has C sources but no binary for this platform, these are compiled: in a sandbox, if this
    system has one. Nothing of it is run.

    Parameters
    ----------
    path : str or Path
        The file.
    strict : bool
        Run FMPy's full validation too, which takes seconds for thousands of variables.
    unpack_limits : UnpackLimits, optional
        How large the FMU may get when it is unpacked.
    library_path : sequence of str or Path
        Further libraries, as of :class:`ddpc_cosim.FMUPlant`.
    tell : callable, optional
        Called with a line before anything is compiled.

    Raises
    ------
    FMUImportError
        There is no such file. Everything else that is wrong with it is a defect.
    ConfigError
        There are no such libraries.

    Examples
    --------
    >>> inspection = inspect_fmu(pendulum_fmu)
    >>> inspection.can_run
    True
    >>> [variable.header for variable in inspection.inputs]
    ['torque [N.m]']
    """
    path = Path(path)
    if not path.is_file():
        raise FMUImportError(f"{path}: no such file")
    if faults := library_path_faults(library_path):
        raise ConfigError(faults)
    findings, resources = Findings(), Resources()
    scratch = ScratchFolder()
    scratch.remove_after_death()
    with scratch as folder:
        libraries = [Path(place).absolute() for place in library_path]

        def check(description: FMUDescription | None, unpacked: Path) -> Binaries:
            return check_binaries(unpacked, description, path.name, findings, libraries, tell)

        description, binaries = _look_inside(path, folder / "fmu", unpack_limits, findings, check)
    if binaries is not _NO_BINARIES:  # what cannot be unpacked is not looked into any further
        resources = read_resources(path, findings)
    if description is not None:
        check_resources(resources, description, findings)
    if strict and binaries is not _NO_BINARIES:
        _validate(path, findings)
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    size = path.stat().st_size
    return Inspection(path, size, digest, description, binaries, findings.defects(), resources)


def _look_inside(
    path: Path,
    folder: Path,
    limits: UnpackLimits | None,
    findings: Findings,
    check: Callable[[FMUDescription | None, Path], Binaries],
) -> tuple[FMUDescription | None, Binaries]:
    folder.mkdir()
    try:
        unpack(path, folder, limits)
    except FMUImportError as error:
        findings.add(REFUSED, str(error))
        return None, _NO_BINARIES
    try:
        description = read_tolerantly(folder, path.name, findings)
    except FMUImportError as error:
        findings.add(UNREADABLE, str(error))
        return None, _NO_BINARIES
    if description is not None:
        check_description(description, findings)
    return description, check(description, folder)


def _validate(path: Path, findings: Findings) -> None:
    from fmpy.validation import validate_fmu

    try:
        problems = validate_fmu(str(path))
    except Exception as error:  # FMPy's validation raises whatever the file provokes
        problems = [f"{type(error).__name__}: {error}"]
    for problem in problems:
        findings.add(INVALID, " ".join(str(problem).split()))


FORMAT = 1


def as_data(inspection: Inspection) -> dict[str, Any]:
    """Return an inspection in plain values; ``format`` rises when a key changes its meaning."""
    description = inspection.description
    return {
        "format": FORMAT,
        "file": inspection.path.name,
        "size": inspection.size,
        "sha256": inspection.sha256,
        "can_run": inspection.can_run,
        "runs_from": inspection.binaries.route or None,
        "platforms": list(inspection.binaries.platforms),
        "has_sources": inspection.binaries.has_sources,
        "model": _model(description) if description else None,
        "interfaces": {interface.kind: _interface(interface) for interface in inspection.interfaces},
        "inputs": inputs_as_data(inspection.inputs, inspection.switches),
        "outputs": variables_as_data(inspection.outputs),
        "parameters": [_parameter(variable) for variable in inspection.parameters],
        "states": variables_as_data(inspection.states),
        "clocks": [_clock(clock) for clock in inspection.clocks],
        "direct_feedthrough": {
            output: None if inputs is None else list(inputs)
            for output, inputs in inspection.feedthrough.items()
        },
        "resources": _resources(inspection.resources),
        "defects": defects_as_data(inspection.defects),
    }


def _resources(resources: Resources) -> dict[str, Any]:
    return {
        "files": list(resources.files),
        "name": resources.name or None,
        "area": resources.area,
        "step": resources.step,
        "warm_up": resources.warm_up,
        "start_time": resources.start_time,
        "days": dict(resources.days),
        "key_figures": {source: list(outputs) for source, outputs in resources.key_figures.items()},
        "tables": [_table(table) for table in resources.tables],
    }


def _table(table: TimeTable) -> dict[str, Any]:
    return {
        "file": table.file,
        "rows": len(table.time),
        "from": float(table.time[0]),
        "to": float(table.time[-1]),
        "period": table.period or None,
        "columns": [
            {
                "name": column,
                "unit": unit_of(table, column) or None,
                **{key: _finite(value) for key, value in table.statistics(column)._asdict().items()},
            }
            for column in table.columns
        ],
    }


def defects_as_data(defects: Iterable[Defect]) -> list[dict[str, Any]]:
    """Return defects in plain values."""
    return [
        {
            "kind": defect.kind.name,
            "severity": defect.severity.value,
            "message": defect.kind.message,
            "remedy": defect.kind.remedy or None,
            "places": list(defect.places),
        }
        for defect in defects
    ]


def _model(description: FMUDescription) -> dict[str, Any]:
    experiment = description.default_experiment
    return {
        "name": description.model_name,
        "description": description.text,
        "fmi_version": description.fmi_version,
        "guid": description.guid,
        "tool": description.generation_tool,
        "generated_at": description.generated_at,
        "author": description.author,
        "version": description.version,
        "copyright": description.copyright,
        "license": description.license,
        "variables": len(description.variables),
        "continuous_states": description.continuous_states,
        "default_experiment": {
            "start_time": experiment.start_time,
            "stop_time": experiment.stop_time,
            "step_size": experiment.step_size,
            "tolerance": experiment.tolerance,
        },
    }


def _interface(interface: Any) -> Mapping[str, Any]:
    return {name: getattr(interface, name) for name in interface.__dataclass_fields__ if name != "kind"}


def variables_as_data(variables: Iterable[Variable]) -> list[dict[str, Any]]:
    """Return variables in plain values."""
    return [_variable(variable) for variable in variables]


def inputs_as_data(variables: Iterable[Variable], switches: Mapping[str, str]) -> list[dict[str, Any]]:
    """Return inputs in plain values, each with the input that switches it."""
    return [{**_variable(variable), "switch": switches.get(variable.name)} for variable in variables]


def _variable(variable: Variable) -> dict[str, Any]:
    shown = variable.display_unit
    return {
        "name": variable.name,
        "unit": variable.unit,
        "display_unit": shown.name if shown else None,
        "min": _finite(variable.min),
        "max": _finite(variable.max),
        "nominal": _finite(variable.nominal),
        "start": _finite(variable.start),
        "description": variable.description,
    }


def _clock(clock: Clock) -> dict[str, Any]:
    return {
        "name": clock.name,
        "causality": clock.causality,
        "interval_variability": clock.variability,
        "interval": _finite(clock.interval),
        "shift": clock.shift,
    }


def _parameter(parameter: DescribedVariable) -> dict[str, Any]:
    return {
        **_variable(parameter.variable),
        "type": parameter.type,
        "tunable": parameter.is_tunable,
        "structural": parameter.is_structural,
        "shape": list(parameter.shape),
        "start_text": parameter.start_text,
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
