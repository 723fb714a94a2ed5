"""What ``ddpc-cosim check`` checks: an FMU, a plant or a controller, in a form that a worker can be told."""

import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from ddpc_cosim.controller import Controller
from ddpc_cosim.diagnosis.controller_checks import CONTROLLER_CHECKS, ControllerTrial
from ddpc_cosim.diagnosis.plant_checks import PLANT_CHECKS, Trial
from ddpc_cosim.errors import ConfigError, PluginError
from ddpc_cosim.plant import Plant
from ddpc_cosim.plugins import load_plugin, load_target, plugin_names
from ddpc_cosim.suggest import did_you_mean


class Subject(Protocol):
    """What can be checked."""

    def check_names(self) -> Iterable[str]:
        """Return the names of its checks."""

    def check(self, name: str, sampling_time: float) -> None:
        """Run one check, at a step size in s."""


@dataclass(frozen=True, slots=True)
class FMUSubject:
    """An FMU as a plant: its path."""

    path: str

    def check_names(self) -> Iterable[str]:
        """Return the names of its checks."""
        return PLANT_CHECKS

    def check(self, name: str, sampling_time: float) -> None:
        """Run one check, at a step size in s."""
        from ddpc_cosim.fmu.plant import FMUPlant

        PLANT_CHECKS[name](Trial(lambda: FMUPlant(self.path), sampling_time))


@dataclass(frozen=True, slots=True)
class PlantSubject:
    """A plant in Python: its name, or ``module:Class``."""

    plugin: str

    def check_names(self) -> Iterable[str]:
        """Return the names of its checks."""
        return PLANT_CHECKS

    def check(self, name: str, sampling_time: float) -> None:
        """Run one check, at a step size in s."""
        make_plant: Callable[[], Plant] = load_plugin("plants", self.plugin)
        PLANT_CHECKS[name](Trial(make_plant, sampling_time))


@dataclass(frozen=True, slots=True)
class ControllerSubject:
    """A controller: its name or ``module:Class``, and its settings as a study file writes them."""

    plugin: str
    settings: dict[str, Any] = field(default_factory=dict)

    def check_names(self) -> Iterable[str]:
        """Return the names of its checks."""
        return CONTROLLER_CHECKS

    def check(self, name: str, sampling_time: float) -> None:
        """Run one check, at a step size in s."""
        CONTROLLER_CHECKS[name](ControllerTrial(self.make, sampling_time))

    def make(self) -> Controller:
        """Return a new controller."""
        from ddpc_cosim.config import ControllerSection
        from ddpc_cosim.study_controllers import make_controller

        return make_controller(ControllerSection(type=self.plugin, settings=self.settings))


def find_subject(name: str, settings: Sequence[str]) -> Subject:
    """Return what a command line names, with its settings, each of them a line of TOML.

    Raises
    ------
    ConfigError
        There is no such thing, it cannot be made, or a setting is no TOML.
    """
    if name.lower().endswith(".fmu"):
        if not Path(name).is_file():
            raise ConfigError(f"{name}: no such file")
        return FMUSubject(name)
    if not _is_controller(name):
        return _plant(name)
    subject = ControllerSubject(name, _parse(settings))
    try:
        subject.make()
    except PluginError as error:
        raise ConfigError(str(error)) from error
    except ConfigError as error:
        hint = "give what it needs with --setting 'NAME = VALUE'"
        raise ConfigError([f"{name}: {fault}; {hint}" for fault in error.faults]) from error
    return subject


def _is_controller(name: str) -> bool:
    if ":" in name:
        try:
            target = load_target(name, "plant or controller")
        except PluginError as error:
            raise ConfigError(str(error)) from error
        return isinstance(target, type) and issubclass(target, Controller)
    controllers, plants = plugin_names("controllers"), plugin_names("plants")
    if name not in controllers and name not in plants:
        hint = did_you_mean(name, [*controllers, *plants])
        raise ConfigError(f'no plant or controller "{name}"; {hint}; or give the path of an FMU')
    return name in controllers


def _plant(name: str) -> Subject:
    from ddpc_cosim.config import PlantSection
    from ddpc_cosim.plants import PlantSource

    target = PlantSource(PlantSection(name=name), Path()).prepare()
    return FMUSubject(target.fmu) if target.fmu else PlantSubject(target.python)


def _parse(settings: Sequence[str]) -> dict[str, Any]:
    try:
        return tomllib.loads("\n".join(settings))
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"--setting: not TOML: {error}; write text in quotes: 'name = \"text\"'") from error
