"""Checks of the variables of a model description, each in time linear in their number."""

import math
from collections import Counter, defaultdict
from collections.abc import Iterable

from ddpc_cosim.diagnosis.declared import Declared, DeclaredVariable
from ddpc_cosim.diagnosis.defects import Findings, Kind, Severity

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
