"""From a study file to a checked study: every fault of the file in one error."""

import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ddpc_cosim.config import BoundsSection, ControllerSection, RecordingSection, Study
from ddpc_cosim.controller import Controller
from ddpc_cosim.errors import ConfigError, CosimError, PluginError
from ddpc_cosim.faults import validate_all
from ddpc_cosim.plants import PlantSignals, PlantSource
from ddpc_cosim.plugins import load_plugin
from ddpc_cosim.settings import declared_settings, from_plain
from ddpc_cosim.suggest import did_you_mean
from ddpc_cosim.variables import FloatArray, Variable


@dataclass(frozen=True, slots=True)
class CheckedStudy:
    """A study that fits its plant and its controllers.

    Parameters
    ----------
    study : Study
        The file's content.
    plant : PlantSource
        The plant it names.
    signals : PlantSignals
        The plant's variables.
    inputs, outputs, measurements : tuple of str
        The signals that take part, with the defaults filled in.
    """

    study: Study
    plant: PlantSource
    signals: PlantSignals
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    measurements: tuple[str, ...]


def read_study(name: str) -> CheckedStudy:
    """Read a study file, or a built-in or plug-in study by name, and check it.

    Raises
    ------
    ConfigError
        There is no such study, or it has faults: all of them, each with file, key and what to do.
    """
    path = find_study(name)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path.name}: not a TOML file: {error}") from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    data.setdefault("name", path.stem)
    study, faults = validate_all(Study, data)
    checked = None
    if study is not None:
        checked, more = _check(study, path.parent)
        faults.extend(more)
    if faults or checked is None:
        raise ConfigError([f"{path.name}: {fault}" for fault in faults])
    return checked


def find_study(name: str) -> Path:
    """Return the path of a study given as a file or by the name of a built-in or plug-in study."""
    path = Path(name)
    if path.is_file():
        return path
    if path.suffix == ".toml" or len(path.parts) > 1:
        raise ConfigError(f"{name}: no such study file")
    try:
        return Path(load_plugin("studies", name))
    except PluginError as error:
        raise ConfigError(f"{error}; or give the path of a study file") from error


def converter(variable: Variable, unit: str) -> Callable[[float], float]:
    """Return the conversion of a study's values from ``unit`` to the variable's own unit.

    Raises
    ------
    ConfigError
        The unit is neither the variable's unit nor its display unit.
    """
    if unit in ("", variable.unit):
        return float
    shown = variable.display_unit
    if shown is not None and unit == shown.name:
        return lambda value: (value - shown.offset) / shown.factor
    known = [variable.unit or "1", *([shown.name] if shown else [])]
    raise ConfigError(f'unit "{unit}" does not fit {variable.name}; allowed: {", ".join(known)}')


def limits(
    bounds: Mapping[str, BoundsSection], variables: Mapping[str, Variable], names: Iterable[str]
) -> dict[str, tuple[float, float]]:
    """Return the limits of the named variables in their own units: the study's, else the plant's."""
    table = {}
    for name in names:
        variable, section = variables[name], bounds.get(name, BoundsSection())
        convert = converter(variable, section.unit)
        low = variable.min if section.min is None else convert(section.min)
        high = variable.max if section.max is None else convert(section.max)
        table[name] = (low, high)
    return table


def make_controller(section: ControllerSection) -> Controller:
    """Construct the controller of a section.

    Raises
    ------
    ConfigError
        Unknown or impossible settings, all of them.
    PluginError
        There is no such controller, or it cannot be loaded.
    """
    plugin = load_plugin("controllers", section.type)
    known = declared_settings(plugin)
    unknown = [key for key in section.settings if known and key not in known]
    faults = [
        f"settings.{key}: unknown setting of {section.type}; {did_you_mean(key, known)}" for key in unknown
    ]
    sound = {key: value for key, value in section.settings.items() if key not in unknown}
    controller: Controller | None = None
    try:
        controller = plugin(**{key: from_plain(plugin, key, value) for key, value in sound.items()})
    except ConfigError as error:
        faults.extend(f"settings: {fault}" for fault in error.faults)
    except TypeError as error:
        faults.append(f"settings: {error}")
    if faults or controller is None:
        raise ConfigError(faults)
    return controller


def _check(study: Study, folder: Path) -> tuple[CheckedStudy | None, list[str]]:
    """Check a study against its plant and its controllers."""
    faults = _Faults()
    controllers = _check_controllers(study, faults)
    _check_report(study, faults)
    try:
        plant = PlantSource(study.plant, folder)
        signals = plant.signals()
    except CosimError as error:
        faults.add("plant", str(error))
        return None, faults.listed
    inputs = tuple(study.plant.inputs) or tuple(signals.inputs)
    outputs = tuple(study.plant.outputs) or tuple(signals.outputs)
    measurements = tuple(study.plant.measurements) or outputs
    checked = CheckedStudy(study, plant, signals, inputs, outputs, measurements)
    _check_signals(checked, faults)
    _check_scenarios(checked, faults)
    _check_recording(checked, controllers, faults)
    return checked, faults.listed


class _Faults:
    """The faults found so far, each under the key where it is."""

    def __init__(self) -> None:
        self.listed: list[str] = []

    def add(self, key: str, fault: str) -> None:
        self.listed.append(f"{key}: {fault}")

    def require_known(self, key: str, what: str, names: Iterable[str], known: Iterable[str]) -> None:
        """Report each name that is not known."""
        known = list(known)
        for name in names:
            if name not in known:
                self.add(
                    f"{key}.{name}" if what == "key" else key,
                    f'no {what} "{name}"; {did_you_mean(name, known)}',
                )


def _check_controllers(study: Study, faults: _Faults) -> dict[str, Controller]:
    controllers = {}
    for name, section in study.controllers.items():
        key = f"controllers.{name}"
        try:
            controllers[name] = make_controller(section)
        except ConfigError as error:
            for fault in error.faults:
                faults.add(key, fault)
        except PluginError as error:
            faults.add(f"{key}.type", str(error))
    return controllers


def _check_report(study: Study, faults: _Faults) -> None:
    known = list(study.controllers)
    for i, panel in enumerate(study.report.panels):
        faults.require_known(f"report.panels[{i}].controllers", "controller", panel.controllers, known)
    for i, method in enumerate(study.report.reproduction.methods if study.report.reproduction else ()):
        stand_ins = [name for name in (method.printed, method.published_code) if name]
        faults.require_known(f"report.reproduction.methods[{i}]", "controller", stand_ins, known)


def _check_signals(checked: CheckedStudy, faults: _Faults) -> None:
    study, signals = checked.study, checked.signals
    faults.require_known("plant.inputs", "input", checked.inputs, signals.inputs)
    faults.require_known("plant.outputs", "output", checked.outputs, signals.outputs)
    faults.require_known("plant.measurements", "output", study.plant.measurements, signals.outputs)
    faults.require_known("plant.parameters", "parameter", study.plant.parameters, signals.parameters)
    faults.require_known("reference", "controlled output", study.reference, checked.outputs)
    for name in checked.outputs:
        if name not in study.reference:
            faults.add("reference", f"none for the controlled output {name}")
    for name, reference in study.reference.items():
        _check_unit(f"reference.{name}", signals.outputs.get(name), reference.unit, faults)
    bounded = {**signals.inputs, **signals.outputs}
    sections = {"bounds": study.bounds}
    sections |= {f"controllers.{name}.bounds": section.bounds for name, section in study.controllers.items()}
    for key, bounds in sections.items():
        faults.require_known(key, "input or controlled output", bounds, (*checked.inputs, *checked.outputs))
        for name, section in bounds.items():
            _check_unit(f"{key}.{name}", bounded.get(name), section.unit, faults)
            if name in bounded and not faults.listed:
                low, high = limits(bounds, bounded, [name])[name]
                if not low < high:
                    faults.add(
                        f"{key}.{name}", f"leaves no room: [{low:g}, {high:g}] with the plant's own limits"
                    )


def _check_unit(key: str, variable: Variable | None, unit: str, faults: _Faults) -> None:
    if variable is not None:
        try:
            converter(variable, unit)
        except ConfigError as error:
            faults.add(f"{key}.unit", str(error))


def _check_scenarios(checked: CheckedStudy, faults: _Faults) -> None:
    signals = checked.signals
    for name, scenario in checked.study.scenarios.items():
        key = f"scenarios.{name}"
        faults.require_known(f"{key}.parameters", "parameter", scenario.parameters, signals.parameters)
        faults.require_known(f"{key}.noise", "measurement", scenario.noise, checked.measurements)
        for i, event in enumerate(scenario.events):
            faults.require_known(
                f"{key}.events[{i}].parameters", "tunable parameter", event.parameters, signals.tunable
            )


def _check_recording(checked: CheckedStudy, controllers: Mapping[str, Controller], faults: _Faults) -> None:
    study, recording = checked.study, checked.study.recording
    if recording is not None:
        _check_excitation(checked, recording, faults)
    elif study.loop.start == "recording-end":
        faults.add("loop.start", '"recording-end" needs a recording section')
    sizes = (len(checked.inputs), len(checked.outputs), len(checked.measurements))
    for name, controller in controllers.items():
        if controller.uses_recording and recording is None:
            faults.add(
                f"controllers.{name}", "learns from a recording, and the study has no recording section"
            )
        needed = controller.recording_length(*sizes) if recording is not None else 0
        if recording is not None and recording.samples < needed:
            faults.add(
                "recording.samples", f"{recording.samples} is too short for {name}, which needs {needed}"
            )


def _check_excitation(checked: CheckedStudy, recording: RecordingSection, faults: _Faults) -> None:
    faults.require_known("recording.excitation", "input", recording.excitation, checked.inputs)
    for name in checked.inputs:
        if name not in recording.excitation:
            faults.add("recording.excitation", f"none for the input {name}")
    for name, section in recording.excitation.items():
        _check_unit(f"recording.excitation.{name}", checked.signals.inputs.get(name), section.unit, faults)


def excitation_range(checked: CheckedStudy) -> tuple[FloatArray, FloatArray] | None:
    """Return low and high of the excitation of all inputs, each of shape (m,), in their units."""
    recording = checked.study.recording
    if recording is None:
        return None
    pairs = []
    for name in checked.inputs:
        section: Any = recording.excitation[name]
        convert = converter(checked.signals.inputs[name], section.unit)
        pairs.append((convert(section.low), convert(section.high)))
    low, high = np.array(pairs, dtype=float).T
    return low, high


def study_title(path: Path) -> str:
    """Return the title of a study file, for lists."""
    return str(tomllib.loads(path.read_text(encoding="utf-8")).get("title", ""))
