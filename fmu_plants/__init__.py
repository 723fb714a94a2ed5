"""Plants written once as equations, exported as FMUs.

>>> from fmu_plants import export_fmu
>>> from fmu_plants.pendulum import MODEL
>>> export_fmu(MODEL, "pendulum.fmu")  # doctest: +SKIP
PosixPath('pendulum.fmu')
"""

from fmu_plants.export import build_fmu, export_fmu
from fmu_plants.model import (
    DisplayUnit,
    Equations,
    ExportError,
    ModelError,
    Parameter,
    PlantModel,
    Symbols,
    Variable,
)

__all__ = [
    "DisplayUnit",
    "Equations",
    "ExportError",
    "ModelError",
    "Parameter",
    "PlantModel",
    "Symbols",
    "Variable",
    "build_fmu",
    "export_fmu",
]
