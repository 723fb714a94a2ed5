"""Checks of a model description that was read: what it says is possible, but may not be what was meant."""

import re

from ddpc_cosim.description import DescribedVariable
from ddpc_cosim.fmu.archive import is_file_name
from ddpc_cosim.fmu.description import INTERFACES, FMUDescription
from ddpc_cosim.fmu.description.defects import BAD_EXPERIMENT, Findings, Kind, Severity
from ddpc_cosim.fmu.resources import Resources

_C_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")

_ERROR, _WARNING, _NOTE = Severity.ERROR, Severity.WARNING, Severity.NOTE
ILLEGAL_IDENTIFIER = Kind(
    "illegal-identifier",
    _WARNING,
    "a modelIdentifier that is not a C identifier",
    "other tools may refuse it",
)
NO_FILE_NAME = Kind("no-file-name", _ERROR, "a modelIdentifier that cannot be the name of a library")
NO_GUID = Kind("no-guid", _WARNING, "no GUID or instantiation token", "the FMU may refuse to start")
NEEDS_TOOL = Kind(
    "needs-tool", _WARNING, "the FMU needs the tool that made it", "it runs only where that is installed"
)
ONE_INSTANCE = Kind(
    "one-instance", _NOTE, "only one instance per process is allowed", "every case runs in its own process"
)
NO_INPUTS = Kind("no-inputs", _NOTE, "no inputs: there is nothing that a controller could drive")
NO_OUTPUTS = Kind("no-outputs", _NOTE, "no outputs", "name local variables as outputs of the study")
NOT_AN_OUTPUT = Kind(
    "not-an-output", _WARNING, "the model structure lists as outputs variables of another causality"
)
UNLISTED_OUTPUT = Kind("unlisted-output", _WARNING, "outputs that the model structure does not list")
ILLEGAL_NAME = Kind(
    "illegal-name", _WARNING, "names with spaces around them or control characters", "quote them exactly so"
)
REFERENCE_CLASH = Kind(
    "reference-clash",
    _WARNING,
    "inputs or parameters that share one value reference",
    "setting one sets the other; ask the maker of the FMU",
)
ALIAS_UNITS = Kind(
    "alias-units", _WARNING, "variables that are one value but have different units", "trust neither unit"
)
NO_UNIT = Kind("no-unit", _NOTE, "real inputs or outputs without a unit", "dimensionless, or forgotten?")
UNKNOWN_UNIT = Kind("unknown-unit", _NOTE, "units that the FMU does not define", "they are shown as they are")
EMPTY_RANGE = Kind("empty-range", _WARNING, "min above max", "give bounds in the study")
START_OUTSIDE = Kind("start-outside-range", _WARNING, "start values outside of min .. max")
ZERO_NOMINAL = Kind("zero-nominal", _WARNING, "nominal values of zero", "1 is used")
NEEDLESS_START = Kind(
    "needless-start", _NOTE, "start values of variables that the FMU calculates", "they have no effect"
)

NO_KEY_OUTPUT = Kind(
    "no-key-output",
    _WARNING,
    "key figures of kpis.json are made of outputs that do not exist",
    "these sources are left out",
)


def check_resources(resources: Resources, description: FMUDescription, findings: Findings) -> None:
    """Check that what the resources call outputs are some."""
    for source, outputs in resources.key_figures.items():
        for name in outputs:
            if name not in description.variables:
                findings.add(NO_KEY_OUTPUT, f'{source}: "{name}"')


def check_description(description: FMUDescription, findings: Findings) -> None:
    """Check a description for what makes no difference to its reading."""
    _check_interfaces(description, findings)
    if not description.guid:
        findings.add(NO_GUID)
    causalities = {variable.causality for variable in description.variables.values()}
    if "input" not in causalities:
        findings.add(NO_INPUTS)
    if "output" not in causalities:
        findings.add(NO_OUTPUTS)
    _check_experiment(description, findings)
    _check_references(description, findings)
    for variable in description.variables.values():
        if not variable.alias_of:
            _check_variable(variable, description, findings)
    if description.major >= 2:
        _check_outputs(description, findings)


def _check_interfaces(description: FMUDescription, findings: Findings) -> None:
    preferred = description.preferred
    for interface in description.interfaces.values():
        name, identifier = INTERFACES[interface.kind], interface.model_identifier
        if interface is preferred and not is_file_name(identifier):
            findings.add(NO_FILE_NAME, f'{name}: "{identifier}"')
        elif not _C_IDENTIFIER.fullmatch(identifier):
            findings.add(ILLEGAL_IDENTIFIER, f'{name}: "{identifier}"')
        if interface.needs_execution_tool:
            findings.add(NEEDS_TOOL, description.generation_tool)
        if interface.only_one_instance:
            findings.add(ONE_INSTANCE, name)


def _check_experiment(description: FMUDescription, findings: Findings) -> None:
    experiment = description.default_experiment
    if experiment.stop_time is not None and experiment.stop_time <= (experiment.start_time or 0.0):
        findings.add(BAD_EXPERIMENT, f"stopTime = {experiment.stop_time:g}")
    for name, value in (("stepSize", experiment.step_size), ("tolerance", experiment.tolerance)):
        if value is not None and value <= 0.0:
            findings.add(BAD_EXPERIMENT, f"{name} = {value:g}")


def _check_references(description: FMUDescription, findings: Findings) -> None:
    # References are per type in FMI 1.0 and 2.0 (enumerations are integers), and unique in FMI 3.0.
    groups: dict[tuple[str, int], DescribedVariable | list[DescribedVariable]] = {}
    for variable in description.variables.values():
        if variable.alias_of:
            continue
        key = ("" if description.major >= 3 else variable.values, variable.reference)
        known = groups.setdefault(key, variable)  # mostly the only one
        if isinstance(known, list):
            known.append(variable)
        elif known is not variable:
            groups[key] = [known, variable]
    for (_, reference), members in groups.items():
        if not isinstance(members, list):
            continue
        settable = [v.name for v in members if v.causality in ("input", "parameter", "structuralParameter")]
        if len(settable) > 1:
            findings.add(REFERENCE_CLASH, f"{' and '.join(settable)} ({reference})")
        if len({v.variable.unit for v in members if v.variable.unit}) > 1:
            units = [f"{v.name} [{v.variable.unit or '1'}]" for v in members]
            findings.add(ALIAS_UNITS, " and ".join(units))


def _check_variable(variable: DescribedVariable, description: FMUDescription, findings: Findings) -> None:
    name, unit = variable.name, variable.variable.unit
    if name != name.strip() or not name.isprintable():
        findings.add(ILLEGAL_NAME, repr(name))
    if variable.values == "real":
        if not unit and variable.causality in ("input", "output"):
            findings.add(NO_UNIT, name)
        if unit and unit not in description.display_units:
            findings.add(UNKNOWN_UNIT, f"{name} [{unit}]")
    if variable.values in ("real", "integer"):
        _check_range(variable, findings)
    is_calculated = variable.initial == "calculated" or variable.causality == "independent"
    if is_calculated and variable.start_text is not None and description.major >= 2:
        findings.add(NEEDLESS_START, name)


def _check_range(variable: DescribedVariable, findings: Findings) -> None:
    name, low, high = variable.name, variable.variable.min, variable.variable.max
    start = variable.variable.start
    has_start = len((variable.start_text or "").split()) == 1  # not the values of an array
    if low > high:
        findings.add(EMPTY_RANGE, f"{name}: {low:g} > {high:g}")
    elif has_start and not low <= start <= high:
        findings.add(START_OUTSIDE, f"{name} = {start:g} not in [{low:g}, {high:g}]")
    if variable.variable.nominal == 0.0:
        findings.add(ZERO_NOMINAL, name)


def _check_outputs(description: FMUDescription, findings: Findings) -> None:
    for name in description.dependencies:
        if description.variables[name].causality != "output":
            findings.add(NOT_AN_OUTPUT, name)
    for variable in description.variables.values():
        is_listed = variable.name in description.dependencies or variable.alias_of
        if variable.causality == "output" and not is_listed and variable.type != "Clock":
            findings.add(UNLISTED_OUTPUT, variable.name)
