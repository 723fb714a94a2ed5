"""From the plant section of a study to a plant: a plug-in's equations, an FMU file, or a Python class."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ddpc_cosim.config import PlantSection
from ddpc_cosim.errors import ConfigError, CosimError
from ddpc_cosim.plant import Plant
from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.variables import DisplayUnit, Variable
from ddpc_cosim.version import source_hash


@dataclass(frozen=True, slots=True)
class PlantSignals:
    """The variables of a plant by name, as a study may use them."""

    inputs: Mapping[str, Variable]
    outputs: Mapping[str, Variable]
    parameters: Mapping[str, Variable]
    tunable: frozenset[str] = field(default_factory=frozenset)


@dataclass(frozen=True, slots=True)
class PlantTarget:
    """What a worker needs to open the plant: an FMU's path, or ``module:Class``.

    Parameters
    ----------
    fmu : str
        Path of the FMU; empty for a Python plant.
    python : str
        The Python plant's name or ``module:Class``; empty for an FMU.
    content : str
        SHA-256 of the FMU, or the Python class with a hash of its source: what decides the behaviour.
    """

    fmu: str
    python: str
    content: str

    def open(self, inputs: Sequence[str], outputs: Sequence[str]) -> Plant:
        """Open the plant with the chosen inputs and outputs."""
        if self.fmu:
            from ddpc_cosim.fmu.plant import FMUPlant

            return FMUPlant(self.fmu, inputs=list(inputs), outputs=list(outputs))
        plant: Plant = load_plugin("plants", self.python)()
        return plant


class PlantSource:
    """A plant that a study names, before any run.

    Parameters
    ----------
    section : PlantSection
        The plant section.
    folder : Path
        Folder of the study file: FMU paths are relative to it.

    Raises
    ------
    CosimError
        There is no such plant, or it cannot be loaded.
    """

    def __init__(self, section: PlantSection, folder: Path) -> None:
        self._fmu = folder / section.fmu if section.fmu else None
        self._name = section.name
        self._plugin: Any = load_plugin("plants", section.name) if section.name else None
        if self._plugin is not None and not (_is_model(self._plugin) or _is_plant_class(self._plugin)):
            raise ConfigError(
                f'plant "{section.name}" is neither a PlantModel nor a Plant class: {self._plugin!r}'
            )

    @property
    def fmu_path(self) -> str:
        """Absolute path of the FMU that the study supplies; empty for a plug-in."""
        return str(self._fmu.resolve()) if self._fmu else ""

    def signals(self) -> PlantSignals:
        """Return the plant's variables without building or running it."""
        if self._fmu is not None:
            return _fmu_signals(self._fmu)
        if _is_model(self._plugin):
            return _model_signals(self._plugin)
        try:
            plant: Plant = self._plugin()
        except Exception as error:  # a third party's constructor can fail in any way
            raise ConfigError(f'plant "{self._name}": {type(error).__name__}: {error}') from error
        try:
            return PlantSignals({v.name: v for v in plant.inputs}, {v.name: v for v in plant.outputs}, {})
        finally:
            plant.close()

    def prepare(self) -> PlantTarget:
        """Make the plant ready to run: equations are exported to an FMU, which is compiled if it is new."""
        fmu = self._fmu
        if _is_model(self._plugin):
            fmu = _build(self._plugin)
        if fmu is None:
            plugin = self._plugin
            content = f"{plugin.__module__}:{plugin.__qualname__} {source_hash(plugin.__module__)}"
            return PlantTarget("", self._name, content)
        return PlantTarget(str(fmu.resolve()), "", hashlib.sha256(fmu.read_bytes()).hexdigest())


def _build(model: Any) -> Path:
    from fmu_plants import ExportError, ModelError, build_fmu

    try:
        return build_fmu(model)
    except (ExportError, ModelError) as error:
        raise CosimError(str(error)) from error


def _is_model(plugin: Any) -> bool:
    from fmu_plants import PlantModel

    return isinstance(plugin, PlantModel)


def _is_plant_class(plugin: Any) -> bool:
    return isinstance(plugin, type) and issubclass(plugin, Plant)


def _fmu_signals(path: Path) -> PlantSignals:
    from ddpc_cosim.fmu.plant import FMUPlant

    with FMUPlant(path) as plant:
        description = plant.description
        local = description.named("local", type="Real")
        parameters = {n: v.variable for n, v in description.variables.items() if v.causality == "parameter"}
        return PlantSignals(
            {v.name: v for v in plant.inputs},
            {v.name: v for v in plant.outputs}
            | {name: description.variables[name].variable for name in local},
            parameters,
            frozenset(name for name, v in description.variables.items() if v.is_tunable),
        )


def _model_signals(model: Any) -> PlantSignals:
    return PlantSignals(
        {v.name: _variable(v) for v in model.inputs},
        {v.name: _variable(v) for v in model.outputs},
        {v.name: _variable(v) for v in model.parameters},
        frozenset(v.name for v in model.parameters if v.variability == "tunable"),
    )


def _variable(variable: Any) -> Variable:
    """Return a variable of a plant model as a variable of the contracts."""
    shown = variable.display_unit
    return Variable(
        name=variable.name,
        unit=variable.unit,
        min=variable.min,
        max=variable.max,
        nominal=variable.nominal,
        start=variable.start,
        description=variable.description,
        display_unit=DisplayUnit(shown.name, shown.factor, shown.offset) if shown else None,
    )
