"""The public names and where they are defined; :mod:`lazy_loader` reads them from here too."""

from .export import build_fmu as build_fmu, export_fmu as export_fmu
from .model import (
    EmbeddedControl as EmbeddedControl,
    Equations as Equations,
    ExportError as ExportError,
    InputTable as InputTable,
    ModelError as ModelError,
    Parameter as Parameter,
    PlantModel as PlantModel,
    Rules as Rules,
    Symbols as Symbols,
    Variable as Variable,
    tunable as tunable,
)
from .units import DisplayUnit as DisplayUnit
