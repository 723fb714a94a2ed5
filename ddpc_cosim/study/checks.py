"""A study that fits its plant, and its values in the units of the plant's variables."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ddpc_cosim.controller import Controller
from ddpc_cosim.errors import ConfigError, CosimError, PluginError
from ddpc_cosim.plant import ParameterValue
from ddpc_cosim.settings import PLANT, files_of
from ddpc_cosim.study.controllers import all_settings, make_controller
from ddpc_cosim.study.plants import PlantSignals, PlantSource
from ddpc_cosim.study.sections import (
    BoundsSection,
    ControllerSection,
    LoopSection,
    RecordingSection,
    StabiliserSection,
    Study,
)
from ddpc_cosim.study.validation_errors import Faults, Location
from ddpc_cosim.variables import FloatArray, Variable, conversions


@dataclass(frozen=True, slots=True)
class CheckedStudy:
    """A study that fits its plant and its controllers.

    Parameters
    ----------
    study : Study
        The file's content.
    folder : Path
        The file's folder.
    plant : PlantSource
        The plant it names.
    signals : PlantSignals
        The plant's variables.
    inputs, outputs, measurements : tuple of str
        The signals that take part, with the defaults filled in.
    """

    study: Study
    folder: Path
    plant: PlantSource
    signals: PlantSignals
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    measurements: tuple[str, ...]


def converter(variable: Variable, unit: str) -> Callable[[float], float]:
    """Return the conversion of a study's values from ``unit`` to the variable's own unit.

    Raises
    ------
    ConfigError
        The unit is neither the variable's unit nor its display unit, and there is no usual conversion.
    """
    if unit in ("", variable.unit):
        return float
    declared = () if variable.display_unit is None else (variable.display_unit,)
    known = conversions(variable.unit, declared)
    if unit not in known:
        allowed = dict.fromkeys((variable.unit or "1", *(shown.name for shown in declared), *known))
        names = ", ".join(name for name in allowed if name)
        raise ConfigError(f'unit "{unit}" does not fit {variable.name}; allowed: {names}')
    shown = known[unit]
    return lambda value: (value - shown.offset) / shown.factor


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


_INPUTS, _OUTPUTS, _MEASUREMENTS = (("plant", key) for key in ("inputs", "outputs", "measurements"))


def check_study(study: Study, folder: Path, faults: Faults) -> CheckedStudy | None:
    """Check a study against its plant and its controllers.

    Parameters
    ----------
    study : Study
        Its content.
    folder : Path
        Folder of the file: paths in it are relative to this.
    faults : Faults
        What was found before; what is found here is added.

    Returns
    -------
    checked : CheckedStudy or None
        The study with its plant; None if there is no plant to check it against.
    """
    controllers = _check_controllers(study, faults)
    _check_report(study, faults)
    if study.plant.contradictions() or faults.touches(("plant", "name")) or faults.touches(("plant", "fmu")):
        return None
    try:
        plant = PlantSource(study.plant, folder)
        signals = plant.signals()
    except CosimError as error:
        faults.add(("plant", "fmu" if study.plant.fmu else "name"), str(error))
        return None
    inputs = tuple(study.plant.inputs) or signals.default_inputs or tuple(signals.inputs)
    outputs = tuple(study.plant.outputs) or signals.default_outputs or tuple(signals.outputs)
    measurements = tuple(study.plant.measurements) or outputs
    checked = CheckedStudy(study, folder, plant, signals, inputs, outputs, measurements)
    _check_plant(checked, faults)
    _check_references(checked, faults)
    _check_bounds(checked, faults)
    _check_scenarios(checked, faults)
    _check_recording(checked, controllers, faults)
    _check_files(checked, controllers, faults)
    return checked


def _check_controllers(study: Study, faults: Faults) -> dict[str, Controller]:
    controllers = {}
    for name, section in study.controllers.items():
        controller = _make(("controllers", name), section, faults)
        if controller is not None:
            controllers[name] = controller
    if study.recording is not None and study.recording.controller is not None:
        place = ("recording", "controller")
        stabiliser = _make(place, study.recording.controller, faults)
        if stabiliser is not None and stabiliser.uses_recording:
            faults.add(place, "learns from a recording itself; needed: one that controls without", place)
    return controllers


def _make(
    place: Location, section: ControllerSection | StabiliserSection, faults: Faults
) -> Controller | None:
    """Return the controller of a section, None if it has faults."""
    try:
        return make_controller(section)
    except ConfigError as error:
        for fault in error.faults:
            faults.add(place, fault, (*place, "settings"), (*place, "type"))
    except PluginError as error:
        faults.add((*place, "type"), str(error))
    return None


def _check_files(checked: CheckedStudy, controllers: Mapping[str, Controller], faults: Faults) -> None:
    """Check that there are the files that controllers name."""
    for name in controllers:
        section = checked.study.controllers[name]
        for path in files_of(section.type, all_settings(section, checked.folder)):
            place = ("controllers", name, "settings")
            if path == PLANT and not checked.plant.is_fmu:
                faults.add(place, f'"{PLANT}" stands for the FMU of the plant, which is a Python class')
            elif path != PLANT and not Path(path).is_file():
                faults.add(place, f"{path}: no such file")


def _check_report(study: Study, faults: Faults) -> None:
    def require_controllers(place: Location, names: Iterable[str]) -> None:
        # A controller whose section is at fault is there all the same.
        doubtful = [name for name in names if faults.touches(("controllers", name))]
        faults.require_known(place, "controller", names, [*study.controllers, *doubtful])

    for i, panel in enumerate(study.report.panels):
        require_controllers(("report", "panels", i, "controllers"), panel.controllers)
    for i, method in enumerate(study.report.reproduction.methods if study.report.reproduction else ()):
        place = ("report", "reproduction", "methods", i)
        require_controllers((*place, "printed"), [method.printed])
        if method.published_code:
            require_controllers((*place, "published_code"), [method.published_code])


def _check_plant(checked: CheckedStudy, faults: Faults) -> None:
    plant, signals = checked.study.plant, checked.signals
    for place, what, given, known in (
        (_INPUTS, "input", plant.inputs, signals.inputs),
        (_OUTPUTS, "output", plant.outputs, signals.outputs),
        (_MEASUREMENTS, "output", plant.measurements, signals.outputs),
    ):
        faults.require_known(place, what, given, known)
        for name in sorted({name for name in given if given.count(name) > 1}):
            faults.add(place, f'"{name}" is listed more than once')
    shown = ("plant", "display_units")
    faults.require_known(shown, "input or output", plant.display_units, (*signals.inputs, *signals.outputs))
    nominal = ("plant", "nominal")
    faults.require_known(nominal, "input or output", plant.nominal, (*signals.inputs, *signals.outputs))
    _check_parameters(("plant", "parameters"), "parameter", plant.parameters, signals.parameters, faults)


def _check_parameters(
    place: Location,
    what: str,
    values: Mapping[str, ParameterValue],
    known: Mapping[str, Variable],
    faults: Faults,
) -> None:
    faults.require_known(place, what, values, known)
    for name, value in values.items():
        if not isinstance(value, str):  # a text, or the name of an enumeration's value: the plant knows
            _check_value((*place, name), value, known.get(name), faults)


def _check_value(place: Location, value: float, parameter: Variable | None, faults: Faults) -> None:
    if parameter is not None and not parameter.min <= value <= parameter.max:
        faults.add(place, f"{value:g} is outside [{parameter.min:g}, {parameter.max:g}]")


def _check_references(checked: CheckedStudy, faults: Faults) -> None:
    references, signals = checked.study.reference, checked.signals
    known = _choice(checked.outputs, signals.outputs, _OUTPUTS, faults)
    faults.require_known(("reference",), "controlled output", references, known)
    for name in checked.outputs:
        if name not in references:
            faults.add(
                ("reference",), f"none for the controlled output {name}", ("reference", name), _OUTPUTS
            )
    for name, reference in references.items():
        _check_unit(("reference", name, "unit"), signals.outputs.get(name), reference.unit, faults)


def _choice(chosen: Iterable[str], every: Iterable[str], place: Location, faults: Faults) -> list[str]:
    """Return the signals that take part; all that there are, where the choice itself is at fault."""
    return list(every) if faults.touches(place) else list(chosen)


def _check_bounds(checked: CheckedStudy, faults: Faults) -> None:
    study, signals = checked.study, checked.signals
    known = _choice(checked.inputs, signals.inputs, _INPUTS, faults)
    known += _choice(checked.outputs, signals.outputs, _OUTPUTS, faults)
    variables = {**signals.outputs, **signals.inputs}
    tables = {("bounds",): study.bounds} | {
        ("controllers", name, "bounds"): section.bounds for name, section in study.controllers.items()
    }
    for place, bounds in tables.items():
        faults.require_known(place, "input or controlled output", bounds, known)
        for name, section in bounds.items():
            if not _check_unit((*place, name, "unit"), variables.get(name), section.unit, faults):
                continue
            low, high = limits(bounds, variables, [name])[name]
            if not low < high and not section.contradictions():
                room = f"leaves no room: [{low:g}, {high:g}] with the plant's own limits"
                faults.add((*place, name), room, (*place, name))


def _check_unit(place: Location, variable: Variable | None, unit: str, faults: Faults) -> bool:
    """Return whether values in a unit can be converted to the variable's own."""
    if variable is None:
        return False
    try:
        converter(variable, unit)
    except ConfigError as error:
        faults.add(place, str(error))
        return False
    return True


def _check_scenarios(checked: CheckedStudy, faults: Faults) -> None:
    signals = checked.signals
    tunable = {name: signals.parameters[name] for name in signals.parameters if name in signals.tunable}
    for name, scenario in checked.study.scenarios.items():
        place = ("scenarios", name)
        _check_parameters(
            (*place, "parameters"), "parameter", scenario.parameters, signals.parameters, faults
        )
        known = checked.measurements
        faults.require_known((*place, "noise"), "measurement", scenario.noise, known, _OUTPUTS, _MEASUREMENTS)
        for i, event in enumerate(scenario.events):
            at_event = (*place, "events", i, "parameters")
            _check_parameters(at_event, "tunable parameter", event.parameters, tunable, faults)
            _check_in_run((*place, "events", i, "time"), event.time, checked.study.loop, faults)
        for i, drift in enumerate(scenario.drifts):
            _check_in_run((*place, "drifts", i, "from_time"), drift.from_time, checked.study.loop, faults)
            start = checked.study.loop.start_time
            if drift.to_time <= start:
                over = f"it would be over when the run starts at {start:g} s; use the scenario's parameters"
                faults.add((*place, "drifts", i, "to_time"), over, ("loop",))
            faults.require_known(
                (*place, "drifts", i, "parameter"), "tunable parameter", [drift.parameter], tunable
            )
            for key in ("from_value", "to_value"):
                _check_value(
                    (*place, "drifts", i, key), getattr(drift, key), tunable.get(drift.parameter), faults
                )


def _check_in_run(place: Location, time: float, loop: LoopSection, faults: Faults) -> None:
    """Report a change that would never act on the plant; the scenario would not be what it says."""
    end = loop.start_time + loop.duration
    if time >= end:
        advice = "choose an earlier time or a longer loop.duration"
        faults.add(
            place, f"the run ends at {end:g} s: it would not happen at {time:g} s; {advice}", ("loop",)
        )


def _check_recording(checked: CheckedStudy, controllers: Mapping[str, Controller], faults: Faults) -> None:
    study, recording = checked.study, checked.study.recording
    place = ("recording",)
    if recording is not None:
        _check_excitation(checked, recording, faults)
    elif study.loop.start == "recording-end":
        faults.add(("loop", "start"), '"recording-end" needs a recording section', place)
    sized = not any(map(faults.is_doubtful, (_INPUTS, _OUTPUTS, _MEASUREMENTS)))
    sizes = (len(checked.inputs), len(checked.outputs), len(checked.measurements))
    for name, controller in controllers.items():
        if controller.uses_recording and recording is None:
            lacking = "learns from a recording, and the study has no recording section"
            faults.add(("controllers", name), lacking, place)
        needed = controller.recording_length(*sizes) if recording is not None and sized else 0
        if recording is not None and recording.samples < needed:
            short = f"{recording.samples} is too short for {name}, which needs {needed}"
            faults.add((*place, "samples"), short)


def _check_excitation(checked: CheckedStudy, recording: RecordingSection, faults: Faults) -> None:
    place = ("recording", "excitation")
    known = _choice(checked.inputs, checked.signals.inputs, _INPUTS, faults)
    faults.require_known(place, "input", recording.excitation, known)
    for name in checked.inputs:
        if name not in recording.excitation:
            faults.add(place, f"none for the input {name}", (*place, name), _INPUTS)
    for name, section in recording.excitation.items():
        _check_unit((*place, name, "unit"), checked.signals.inputs.get(name), section.unit, faults)
