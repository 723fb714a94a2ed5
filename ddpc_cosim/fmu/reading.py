"""From modelDescription.xml to what co-simulation needs, read by FMPy."""

import math
from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any

import fmpy.model_description
from lxml import etree  # type: ignore[import-untyped]

from ddpc_cosim.errors import FMUImportError
from ddpc_cosim.fmu.model_description import (
    CAUSALITIES,
    INTEGER_TYPES,
    NUMERIC_TYPES,
    DefaultExperiment,
    FMUDescription,
    FMUVariable,
    Interface,
    Kind,
    number,
)
from ddpc_cosim.fmu.repairs import parse, repair
from ddpc_cosim.variables import DisplayUnit, Variable

_PROBLEMS_SHOWN = 3
_AS_GOOD_AS_INFINITE = 1e30
_MOST_ELEMENTS = 1_000_000
_TYPES_3 = {"Real": "Float64", "Integer": "Int32"}
_OLD_TYPES = frozenset({"Real", "Integer", "Boolean", "String", "Enumeration"})
_NEW_TYPES = (NUMERIC_TYPES - {"Real", "Integer"}) | {"String", "Binary", "Clock"}


def read_description(folder: Path, label: str) -> FMUDescription:
    """Read the model description of an unpacked FMU.

    Parameters
    ----------
    folder : Path
        The unpacked FMU.
    label : str
        The FMU's file name, for errors.

    Raises
    ------
    FMUImportError
        There is no description that can be understood.
    """
    if not (folder / "modelDescription.xml").is_file():
        raise FMUImportError(f"{label}: not an FMU: the archive has no modelDescription.xml")
    warnings: list[str] = []
    try:
        model = _read(folder, warnings)
        if model.coSimulation is None and model.modelExchange is None and model.scheduledExecution is None:
            raise FMUImportError(
                f"{label}: modelDescription.xml offers neither Co-Simulation nor Model Exchange"
            )
        _check_types(model, label)
        _check_sizes(model, label)
        if str(model.fmiVersion).startswith("3"):
            _add_directional_derivatives(folder / "modelDescription.xml", model)
        return _description(model, tuple(warnings), _negated(folder, model))
    except FMUImportError:
        raise
    except Exception as error:  # FMPy raises whatever the XML provokes
        raise FMUImportError(f"{label}: modelDescription.xml cannot be read: {one_line(error)}") from error


def _read(folder: Path, warnings: list[str]) -> Any:
    """Read with validation, without it, or after repairs, whichever succeeds first."""
    read = fmpy.model_description.read_model_description
    try:
        # Names and model structure are left out: checking them takes long, and nothing here needs them.
        return read(str(folder), validate=True, validate_variable_names=False, validate_model_structure=False)
    except Exception as error:
        problems = _problems(error).replace(str(folder / "modelDescription.xml"), "modelDescription.xml")
        warnings.append(f"modelDescription.xml fails validation: {problems}")
    try:
        return read(str(folder), validate=False)
    except Exception:
        warnings += repair(folder / "modelDescription.xml")
    return read(str(folder), validate=False)


def _add_directional_derivatives(path: Path, model: Any) -> None:
    """Add what FMPy leaves out of FMI 3.0's interfaces: it knows the attribute by FMI 2.0's name only."""
    interfaces = {"ModelExchange": model.modelExchange, "CoSimulation": model.coSimulation}
    with path.open("rb") as file:
        for _, element in etree.iterparse(file, events=("start",)):
            if element.tag == "ModelVariables":  # the interfaces come before
                return
            interface = interfaces.get(element.tag)
            if interface is not None:
                provided = element.get("providesDirectionalDerivatives") in ("true", "1")
                interface.providesDirectionalDerivative = provided


def _check_types(model: Any, label: str) -> None:
    """Refuse variables of types that the FMU's version has no functions for."""
    known = _OLD_TYPES if str(model.fmiVersion) < "3" else _NEW_TYPES
    foreign = [v for v in model.modelVariables if v.type not in known]
    if foreign:
        listed = ", ".join(f"{v.name} ({v.type})" for v in foreign[:_PROBLEMS_SHOWN])
        raise FMUImportError(f"{label}: FMI {model.fmiVersion} has no such type of variable: {listed}")


def _check_sizes(model: Any, label: str) -> None:
    """Refuse arrays whose elements, each a signal of its own, would not fit into memory."""
    for variable in model.modelVariables:
        count = math.prod(variable.shape or ())
        if count > _MOST_ELEMENTS:
            raise FMUImportError(
                f"{label}: the array {variable.name} has {count} elements; allowed: {_MOST_ELEMENTS}"
            )


def _problems(error: Exception) -> str:
    """Return the first problems that a validation found."""
    problems = [" ".join(str(problem).split()) for problem in getattr(error, "problems", [one_line(error)])]
    more = f"; and {len(problems) - _PROBLEMS_SHOWN} more" if len(problems) > _PROBLEMS_SHOWN else ""
    return "; ".join(problems[:_PROBLEMS_SHOWN])[:500] + more


def one_line(error: BaseException) -> str:
    """Return an error's text on one line."""
    return " ".join(str(error).split())[:300] or type(error).__name__


def _negated(folder: Path, model: Any) -> frozenset[str]:
    """Return the variables whose values have the opposite sign (FMI 1.0), of which FMPy knows nothing."""
    if not str(model.fmiVersion).startswith("1"):
        return frozenset()
    variables = parse(folder / "modelDescription.xml").iterfind("ModelVariables/ScalarVariable")
    return frozenset(v.get("name") for v in variables if v.get("alias") == "negatedAlias")


def _description(model: Any, warnings: tuple[str, ...], negated: frozenset[str]) -> FMUDescription:
    definitions = {
        str(unit.name): tuple(
            DisplayUnit(str(d.name), float(d.factor), float(d.offset)) for d in unit.displayUnits
        )
        for unit in model.unitDefinitions
    }
    return FMUDescription(
        fmi_version=str(model.fmiVersion),
        guid=str(model.guid or ""),
        model_name=str(model.modelName or ""),
        variables={
            str(v.name): _variable(v, definitions, int(str(model.fmiVersion)[0]), str(v.name) in negated)
            for v in model.modelVariables
        },
        interfaces=dict(_interfaces(model)),
        generation_tool=str(model.generationTool or "unknown"),
        generated_at=str(model.generationDateAndTime or ""),
        author=str(model.author or ""),
        version=str(model.version or ""),
        copyright=str(model.copyright or ""),
        license=str(model.license or ""),
        text=str(model.description or ""),
        continuous_states=int(model.numberOfContinuousStates or 0),
        event_indicators=int(model.numberOfEventIndicators or 0),
        derivatives=tuple(str(u.variable.name) for u in model.derivatives),
        default_experiment=_default_experiment(model.defaultExperiment),
        display_units=definitions,
        dependencies={str(u.variable.name): _dependencies(u) for u in model.outputs},
        warnings=warnings,
    )


def _interfaces(model: Any) -> Iterator[tuple[Kind, Interface]]:
    kinds: tuple[tuple[Kind, Any], ...] = (
        ("co-simulation", model.coSimulation),
        ("model-exchange", model.modelExchange),
    )
    for kind, interface in kinds:
        if interface is not None:
            yield kind, _interface(kind, interface, str(model.fmiVersion))


def _interface(kind: Kind, interface: Any, fmi_version: str) -> Interface:
    fixed_step = getattr(interface, "fixedInternalStepSize", None)
    is_fmi1 = fmi_version.startswith("1")
    return Interface(
        kind=kind,
        model_identifier=str(interface.modelIdentifier or ""),
        needs_execution_tool=bool(interface.needsExecutionTool),
        only_one_instance=bool(interface.canBeInstantiatedOnlyOncePerProcess),
        can_save_state=bool(interface.canGetAndSetFMUstate),
        can_serialize_state=bool(interface.canSerializeFMUstate),
        provides_directional_derivatives=bool(interface.providesDirectionalDerivative),
        variable_step=is_fmi1 or bool(getattr(interface, "canHandleVariableCommunicationStepSize", True)),
        fixed_step=number(fixed_step, 0.0) or None,
        has_event_mode=bool(getattr(interface, "hasEventMode", False)),
        needs_completed_step=bool(getattr(interface, "needsCompletedIntegratorStep", False)),
    )


def _default_experiment(experiment: Any) -> DefaultExperiment:
    def value(name: str) -> float | None:
        found = number(getattr(experiment, name, None), math.nan)
        return found if math.isfinite(found) else None

    return DefaultExperiment(value("startTime"), value("stopTime"), value("tolerance"), value("stepSize"))


def _dependencies(unknown: Any) -> tuple[str, ...] | None:
    return None if unknown.dependencies is None else tuple(str(v.name) for v in unknown.dependencies)


def _variable(
    variable: Any, definitions: Mapping[str, tuple[DisplayUnit, ...]], major: int, negated: bool
) -> FMUVariable:
    declared = variable.declaredType

    def attribute(name: str) -> Any:
        """Return an attribute of the variable, or of its declared type where it has none."""
        own = getattr(variable, name)
        return own if own is not None else getattr(declared, name, None)

    unit = str(attribute("unit") or "")
    # FMPy lets FMI 2.0's names of types pass in a description for FMI 3.0.
    fmi_type = _TYPES_3.get(str(variable.type), str(variable.type)) if major == 3 else str(variable.type)
    low, high = _range(fmi_type)
    return FMUVariable(
        variable=Variable(
            name=str(variable.name),
            unit=unit,
            min=_bound(attribute("min"), low),
            max=_bound(attribute("max"), high),
            nominal=number(attribute("nominal"), 1.0),
            start=_start(variable.start),
            description=str(variable.description or ""),
            display_unit=find_display_unit(definitions.get(unit, ()), str(attribute("displayUnit") or "")),
        ),
        reference=int(variable.valueReference),
        type=fmi_type,
        causality=variable.causality if variable.causality in CAUSALITIES else "local",
        variability=str(variable.variability or "continuous"),
        # FMI 1.0 has no such attribute: what has a start value can be given another one.
        initial=str(variable.initial or ("" if variable.start is None else "exact")),
        shape=tuple(variable.shape or ()),
        dimensions=tuple(
            d.start if d.variable is None else str(d.variable.name) for d in variable.dimensions
        ),
        start_text=variable.start,
        items={str(i.name): int(number(i.value, 0.0)) for i in getattr(declared, "items", ())},
        derivative_of=str(variable.derivative.name) if variable.derivative is not None else "",
        alias_of=str(variable.alias.name) if variable.alias is not None else "",
        negated=negated,
    )


def find_display_unit(candidates: tuple[DisplayUnit, ...], name: str) -> DisplayUnit | None:
    """Return the display unit of a name."""
    return next((unit for unit in candidates if unit.name == name), None)


def _bound(text: object, none: float) -> float:
    """Return a limit; many tools write the largest number that they know where there is none."""
    bound = number(text, none)
    return none if abs(bound) >= _AS_GOOD_AS_INFINITE else bound


def _range(fmi_type: str) -> tuple[float, float]:
    """Return the smallest and largest value that the type can hold."""
    if fmi_type == "Boolean":
        return 0.0, 1.0
    if fmi_type in INTEGER_TYPES and fmi_type != "Integer":
        bits = int(fmi_type.lstrip("UInt"))
        return (
            (0.0, 2.0**bits - 1)
            if fmi_type.startswith("U")
            else (-(2.0 ** (bits - 1)), 2.0 ** (bits - 1) - 1)
        )
    return -math.inf, math.inf


def _start(text: Any) -> float:
    """Return a start value; for an array that of its first element."""
    first = next(chain(str(text or "").split(), [""]))
    return number(first, 0.0)
