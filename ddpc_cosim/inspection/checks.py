"""Checks of what a model description says besides its variables."""

import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterable

from ddpc_cosim.fmu.archive import is_file_name
from ddpc_cosim.inspection.defects import Findings, Kind, Severity
from ddpc_cosim.inspection.raw_description import Declared, DeclaredVariable, StructureEntry

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


_REALS = frozenset({"Real", "Float32", "Float64"})
_WITHOUT_RANGE = frozenset({"String", "Binary", "Clock", "Boolean"})
_CAUSALITIES = {
    1: {"input", "output", "internal", "none"},
    2: {"parameter", "calculatedParameter", "input", "output", "local", "independent"},
}
_CAUSALITIES[3] = _CAUSALITIES[2] | {"structuralParameter", "dependent"}
_VARIABILITIES = {
    1: {"constant", "parameter", "discrete", "continuous"},
    2: {"constant", "fixed", "tunable", "discrete", "continuous"},
}
_VARIABILITIES[3] = _VARIABILITIES[2]
# FMI 2.0 and 3.0, section 2.2.7 and 2.4.7.4: the variabilities that the causalities of a control loop admit.
_ALL = _VARIABILITIES[2]
_ADMITTED = {
    "parameter": {"fixed", "tunable"},
    "calculatedParameter": {"fixed", "tunable"},
    "structuralParameter": {"fixed", "tunable"},
    "input": {"discrete", "continuous"},
    "output": {"constant", "discrete", "continuous"},
    "independent": {"continuous"},
}

_WARNING, _NOTE = Severity.WARNING, Severity.NOTE
NO_NAME = Kind("no-name", _WARNING, "variables without a name", "they cannot be used")
ILLEGAL_NAME = Kind(
    "illegal-name", _WARNING, "names with spaces around them or control characters", "quote them exactly so"
)
DUPLICATE_NAME = Kind(
    "duplicate-name", _WARNING, "several variables of one name", "only the last of each is used"
)
NO_TYPE = Kind("no-type", _WARNING, "variables without a type", "they cannot be used")
BAD_REFERENCE = Kind(
    "bad-reference", _WARNING, "value references that are no whole numbers", "these variables cannot be used"
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
UNKNOWN_CAUSALITY = Kind("unknown-causality", _WARNING, "causalities that the standard does not know")
UNKNOWN_VARIABILITY = Kind("unknown-variability", _WARNING, "variabilities that the standard does not know")
BAD_COMBINATION = Kind(
    "bad-combination", _WARNING, "causality and variability that do not go together (FMI 2.0, section 2.2.7)"
)
UNKNOWN_TYPE = Kind("unknown-type", _WARNING, "declared types that are not defined")
NO_UNIT = Kind("no-unit", _NOTE, "real inputs or outputs without a unit", "dimensionless, or forgotten?")
UNKNOWN_UNIT = Kind("unknown-unit", _NOTE, "units that the FMU does not define", "they are shown as they are")
UNKNOWN_DISPLAY_UNIT = Kind(
    "unknown-display-unit", _NOTE, "display units that the FMU does not define for the unit", "not used"
)
NOT_A_NUMBER = Kind("not-a-number", _WARNING, "attributes that should be numbers", "they are ignored")
EMPTY_RANGE = Kind("empty-range", _WARNING, "min above max", "give bounds in the study")
START_OUTSIDE = Kind("start-outside-range", _WARNING, "start values outside of min .. max")
ZERO_NOMINAL = Kind("zero-nominal", _WARNING, "nominal values of zero", "1 is used")
NO_START = Kind(
    "no-start",
    _WARNING,
    "inputs or parameters without a start value",
    "0 is shown; the FMU's own value holds",
)
NEEDLESS_START = Kind(
    "needless-start", _NOTE, "start values of variables that the FMU calculates", "they have no effect"
)


def check_variables(declared: Declared, findings: Findings) -> None:
    """Check all variables."""
    _check_names(declared.variables, findings)
    _check_references(declared, findings)
    for variable in declared.variables:
        _check_kind(variable, declared, findings)
        _check_units(variable, declared, findings)
        if variable.type and variable.type not in _WITHOUT_RANGE:
            _check_range(variable, findings)
        _check_start(variable, declared.major, findings)


def _check_names(variables: Iterable[DeclaredVariable], findings: Findings) -> None:
    count = Counter(variable.name for variable in variables)
    for name, times in count.items():
        if not name:
            findings.add(NO_NAME, f"{times} of them")
            continue
        if times > 1:
            findings.add(DUPLICATE_NAME, f"{name} ({times} times)")
        if name != name.strip() or not name.isprintable():
            findings.add(ILLEGAL_NAME, repr(name))


def _check_references(declared: Declared, findings: Findings) -> None:
    # References are per type in FMI 1.0 and 2.0 (enumerations are integers), and unique in FMI 3.0.
    groups: dict[tuple[str, str], list[DeclaredVariable]] = defaultdict(list)
    for variable in declared.variables:
        if not variable.reference.isdecimal():
            findings.add(BAD_REFERENCE, f'{variable.name}: "{variable.reference}"')
            continue
        kind = "" if declared.major >= 3 else variable.type.replace("Enumeration", "Integer")
        groups[kind, variable.reference].append(variable)
    for (_, reference), members in groups.items():
        if len(members) == 1:
            continue
        settable = [v.name for v in members if _is_set_from_outside(v)]
        if len(settable) > 1:
            findings.add(REFERENCE_CLASH, f"{' and '.join(settable)} ({reference})")
        units = {v.get("unit") for v in members} - {None}
        if len(units) > 1:
            findings.add(ALIAS_UNITS, " and ".join(f"{v.name} [{v.get('unit') or '1'}]" for v in members))


def _is_set_from_outside(variable: DeclaredVariable) -> bool:
    # FMI 1.0 has no causality for parameters.
    return (
        variable.causality in ("input", "parameter", "structuralParameter")
        or variable.get("variability") == "parameter"
    )


def _check_kind(variable: DeclaredVariable, declared: Declared, findings: Findings) -> None:
    name, causality, variability = variable.name, variable.own.get("causality"), variable.get("variability")
    if not variable.type:
        findings.add(NO_TYPE, name)
    if causality is not None and causality not in _CAUSALITIES.get(declared.major, {causality}):
        findings.add(UNKNOWN_CAUSALITY, f'{name}: "{causality}"')
    if variability is not None and variability not in _VARIABILITIES.get(declared.major, {variability}):
        findings.add(UNKNOWN_VARIABILITY, f'{name}: "{variability}"')
    elif declared.major >= 2 and (variability or "continuous") not in _ADMITTED.get(causality or "", _ALL):
        findings.add(BAD_COMBINATION, f"{name}: {causality}, {variability or 'continuous'}")
    named = variable.own.get("declaredType")
    if named is not None and named not in declared.types:
        findings.add(UNKNOWN_TYPE, f'{name}: "{named}"')


def _check_units(variable: DeclaredVariable, declared: Declared, findings: Findings) -> None:
    if variable.type not in _REALS:
        return
    unit, shown = variable.get("unit"), variable.get("displayUnit")
    if not unit and variable.causality in ("input", "output"):
        findings.add(NO_UNIT, variable.name)
    if unit and unit not in declared.units:
        findings.add(UNKNOWN_UNIT, f"{variable.name} [{unit}]")
    elif unit and shown and shown != unit and shown not in declared.units[unit]:
        findings.add(UNKNOWN_DISPLAY_UNIT, f"{variable.name}: {shown} for {unit}")


def _check_range(variable: DeclaredVariable, findings: Findings) -> None:
    numbers: dict[str, float] = {}
    for attribute in ("min", "max", "nominal", "start"):
        text = variable.get(attribute)
        if text is None or (attribute == "start" and len(text.split()) != 1):  # an array's values
            continue
        try:
            numbers[attribute] = float(text)
        except ValueError:
            findings.add(NOT_A_NUMBER, f'{variable.name}: {attribute} = "{text}"')
    low, high = numbers.get("min", -math.inf), numbers.get("max", math.inf)
    start = numbers.get("start")
    if low > high:
        findings.add(EMPTY_RANGE, f"{variable.name}: {low:g} > {high:g}")
    elif start is not None and not low <= start <= high:
        findings.add(START_OUTSIDE, f"{variable.name} = {start:g} not in [{low:g}, {high:g}]")
    if numbers.get("nominal") == 0.0:
        findings.add(ZERO_NOMINAL, variable.name)


def _check_start(variable: DeclaredVariable, major: int, findings: Findings) -> None:
    has_start, initial = "start" in variable.own, variable.get("initial")
    needed = variable.causality in ("input", "parameter", "structuralParameter")
    if variable.type in ("Binary", "Clock") or not variable.type:
        return
    if not has_start and (initial in ("exact", "approx") or (needed and initial != "calculated")):
        findings.add(NO_START, variable.name)
    if has_start and major >= 2 and (initial == "calculated" or variable.causality == "independent"):
        findings.add(NEEDLESS_START, variable.name)
