"""An inspection in plain values, for JSON: numbers that are not finite are null."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

from ddpc_cosim.fmu.model_description import FMUDescription, FMUVariable
from ddpc_cosim.inspection import Inspection
from ddpc_cosim.variables import Variable

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
        "inputs": _variables(inspection.inputs),
        "outputs": _variables(inspection.outputs),
        "parameters": [_parameter(variable) for variable in inspection.parameters],
        "states": _variables(inspection.states),
        "direct_feedthrough": {
            output: None if inputs is None else list(inputs)
            for output, inputs in inspection.feedthrough.items()
        },
        "defects": [
            {
                "kind": defect.kind.name,
                "severity": defect.severity.value,
                "message": defect.kind.message,
                "remedy": defect.kind.remedy or None,
                "places": list(defect.places),
            }
            for defect in inspection.defects
        ],
    }


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


def _variables(variables: Iterable[Variable]) -> list[dict[str, Any]]:
    return [_variable(variable) for variable in variables]


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


def _parameter(parameter: FMUVariable) -> dict[str, Any]:
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
