"""Checks of what a model description says besides its variables."""

import math
import re

from ddpc_cosim.diagnosis.declared import Declared, StructureEntry
from ddpc_cosim.diagnosis.defects import Findings, Kind, Severity
from ddpc_cosim.fmu.archive import is_file_name

_C_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")

_ERROR, _WARNING, _NOTE = Severity.ERROR, Severity.WARNING, Severity.NOTE
UNKNOWN_VERSION = Kind(
    "unknown-version", _ERROR, "the FMI version is not one that can run here", "1.0, 2.0 and 3.0 can"
)
NO_INTERFACE = Kind(
    "no-interface",
    _ERROR,
    "neither Co-Simulation nor Model Exchange",
    "export the FMU again with one of them",
)
ILLEGAL_IDENTIFIER = Kind(
    "illegal-identifier", _WARNING, "a modelIdentifier that is no C identifier", "other tools may refuse it"
)
NO_FILE_NAME = Kind("no-file-name", _ERROR, "a modelIdentifier that cannot be the name of a library")
NO_GUID = Kind("no-guid", _WARNING, "no GUID or instantiation token", "the FMU may refuse to start")
NEEDS_TOOL = Kind(
    "needs-tool", _WARNING, "the FMU needs the tool that made it", "it runs only where that is installed"
)
ONE_INSTANCE = Kind(
    "one-instance", _NOTE, "only one instance per process is allowed", "every case runs in its own process"
)
BAD_STRUCTURE = Kind(
    "bad-structure", _WARNING, "the model structure refers to variables that do not exist", "that is ignored"
)
BAD_DEPENDENCY = Kind(
    "bad-dependency", _WARNING, "dependencies in the model structure on variables that do not exist"
)
NOT_AN_OUTPUT = Kind(
    "not-an-output", _WARNING, "the model structure lists as outputs what is none of causality output"
)
UNLISTED_OUTPUT = Kind("unlisted-output", _WARNING, "outputs that the model structure does not list")
BAD_DERIVATIVE = Kind(
    "bad-derivative", _WARNING, "derivatives of variables that do not exist", "the states are not known"
)
BAD_EXPERIMENT = Kind("bad-experiment", _NOTE, "a default experiment that cannot be", "it is ignored")
NO_INPUTS = Kind("no-inputs", _NOTE, "no inputs: there is nothing that a controller could drive")
NO_OUTPUTS = Kind("no-outputs", _NOTE, "no outputs", "name local variables as outputs of the study")

_OUTPUT_LISTS = ("Outputs", "Output")
_STATE_LISTS = ("Derivatives", "ContinuousStateDerivative")


def check_model(declared: Declared, findings: Findings) -> None:
    """Check root element, interfaces and default experiment."""
    if declared.major == 0:
        findings.add(UNKNOWN_VERSION, f'fmiVersion = "{declared.root.get("fmiVersion", "")}"')
    if not declared.preferred:
        findings.add(NO_INTERFACE, ", ".join(declared.interfaces) or "no interface at all")
    _check_identifiers(declared, findings)
    for name, attributes in declared.interfaces.items():
        if attributes.get("needsExecutionTool") in ("true", "1"):
            findings.add(NEEDS_TOOL, declared.root.get("generationTool", name))
        if attributes.get("canBeInstantiatedOnlyOncePerProcess") in ("true", "1"):
            findings.add(ONE_INSTANCE, name)
    if not declared.root.get("guid" if declared.major < 3 else "instantiationToken"):
        findings.add(NO_GUID)
    causalities = {variable.causality for variable in declared.variables}
    if "input" not in causalities:
        findings.add(NO_INPUTS)
    if "output" not in causalities:
        findings.add(NO_OUTPUTS)
    _check_experiment(declared, findings)


def _check_identifiers(declared: Declared, findings: Findings) -> None:
    for name, attributes in declared.interfaces.items():
        identifier = attributes.get("modelIdentifier", "")
        if name == declared.preferred and not is_file_name(identifier):
            findings.add(NO_FILE_NAME, f'{name}: "{identifier}"')
        elif not _C_IDENTIFIER.fullmatch(identifier):
            findings.add(ILLEGAL_IDENTIFIER, f'{name}: "{identifier}"')


def _check_experiment(declared: Declared, findings: Findings) -> None:
    numbers = {}
    for name in ("startTime", "stopTime", "stepSize", "tolerance"):
        text = declared.experiment.get(name)
        try:
            numbers[name] = float(text) if text is not None else math.nan
        except ValueError:
            findings.add(BAD_EXPERIMENT, f'{name} = "{text}"')
    start = numbers.get("startTime", math.nan)
    # Comparisons with what is not given are false.
    if numbers.get("stopTime", math.nan) <= (0.0 if math.isnan(start) else start):
        findings.add(BAD_EXPERIMENT, f"stopTime = {numbers['stopTime']:g}")
    for name in ("stepSize", "tolerance"):
        if numbers.get(name, math.nan) <= 0.0:
            findings.add(BAD_EXPERIMENT, f"{name} = {numbers[name]:g}")


def check_structure(declared: Declared, findings: Findings) -> None:
    """Check the model structure: FMI 2.0 counts variables from 1, FMI 3.0 refers to value references."""
    known = _targets(declared)
    listed = set()
    for entry in declared.structure:
        variable = known.get(entry.target)
        if variable is None:
            findings.add(BAD_STRUCTURE, f'{entry.element}: "{entry.target}"')
        elif entry.element in _OUTPUT_LISTS:
            listed.add(entry.target)
            if declared.variables[variable].causality != "output":
                findings.add(NOT_AN_OUTPUT, declared.variables[variable].name)
        _check_dependencies(entry, known, findings)
    if declared.major >= 2:
        _check_outputs_listed(declared, known, listed, findings)
        _check_derivatives(declared, known, findings)


def _targets(declared: Declared) -> dict[str, int]:
    """Return the position of each variable by what refers to it."""
    if declared.major == 2:
        return {str(i + 1): i for i in range(len(declared.variables))}
    return {variable.reference: i for i, variable in enumerate(declared.variables)}


def _check_dependencies(entry: StructureEntry, known: dict[str, int], findings: Findings) -> None:
    wrong = [name for name in entry.dependencies if name not in known]
    if wrong:
        findings.add(BAD_DEPENDENCY, f"{entry.element} {entry.target}: {', '.join(wrong)}")


def _check_outputs_listed(
    declared: Declared, known: dict[str, int], listed: set[str], findings: Findings
) -> None:
    positions = {known[target] for target in listed}
    for i, variable in enumerate(declared.variables):
        if variable.causality == "output" and i not in positions and variable.type != "Clock":
            findings.add(UNLISTED_OUTPUT, variable.name)


def _check_derivatives(declared: Declared, known: dict[str, int], findings: Findings) -> None:
    for variable in declared.variables:
        state = variable.own.get("derivative")
        if state is not None and state not in known:
            findings.add(BAD_DERIVATIVE, f'{variable.name}: "{state}"')
