"""Co-simulate FMU plants with plug-in controllers and compare them.

Public names are imported when they are first used, so that the command line answers at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ddpc_cosim.controller import Action, Bounds, Controller, Loop, Recording, Sample
    from ddpc_cosim.errors import (
        ConfigError,
        ControllerError,
        CosimError,
        CosimWarning,
        DataError,
        DivergenceError,
        FMUImportError,
        FMUStepError,
        PluginError,
        StepStatus,
    )
    from ddpc_cosim.fmu.linear_model import LinearModel
    from ddpc_cosim.fmu.plant import FMUPlant
    from ddpc_cosim.master import cosimulate, record
    from ddpc_cosim.plant import ParameterValue, Plant
    from ddpc_cosim.results import CaseResult, StudyResults, load_results
    from ddpc_cosim.settings import (
        SettingInfo,
        Weight,
        check_settings,
        declared_settings,
        setting,
        weight_matrix,
    )
    from ddpc_cosim.signals import (
        Constant,
        GaussianNoise,
        ParameterChange,
        Ramp,
        Reference,
        Sine,
        Steps,
        UniformRandom,
    )
    from ddpc_cosim.trace import Outcome, Trace
    from ddpc_cosim.variables import DisplayUnit, FloatArray, Variable

_HOME = {
    "controller": ("Action", "Bounds", "Controller", "Loop", "Recording", "Sample"),
    "errors": (
        "ConfigError",
        "ControllerError",
        "CosimError",
        "CosimWarning",
        "DataError",
        "DivergenceError",
        "FMUImportError",
        "FMUStepError",
        "PluginError",
        "StepStatus",
    ),
    "fmu.linear_model": ("LinearModel",),
    "fmu.plant": ("FMUPlant",),
    "master": ("cosimulate", "record"),
    "plant": ("ParameterValue", "Plant"),
    "results": ("CaseResult", "StudyResults", "load_results"),
    "settings": ("SettingInfo", "Weight", "check_settings", "declared_settings", "setting", "weight_matrix"),
    "signals": (
        "Constant",
        "GaussianNoise",
        "ParameterChange",
        "Ramp",
        "Reference",
        "Sine",
        "Steps",
        "UniformRandom",
    ),
    "trace": ("Outcome", "Trace"),
    "variables": ("DisplayUnit", "FloatArray", "Variable"),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}

__all__ = [
    "Action",
    "Bounds",
    "CaseResult",
    "ConfigError",
    "Constant",
    "Controller",
    "ControllerError",
    "CosimError",
    "CosimWarning",
    "DataError",
    "DisplayUnit",
    "DivergenceError",
    "FMUImportError",
    "FMUPlant",
    "FMUStepError",
    "FloatArray",
    "GaussianNoise",
    "LinearModel",
    "Loop",
    "Outcome",
    "ParameterChange",
    "ParameterValue",
    "Plant",
    "PluginError",
    "Ramp",
    "Recording",
    "Reference",
    "Sample",
    "SettingInfo",
    "Sine",
    "StepStatus",
    "Steps",
    "StudyResults",
    "Trace",
    "UniformRandom",
    "Variable",
    "Weight",
    "check_settings",
    "cosimulate",
    "declared_settings",
    "load_results",
    "record",
    "setting",
    "weight_matrix",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)


def __dir__() -> list[str]:
    return __all__
