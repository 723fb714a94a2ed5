"""From a parsed study to a resolved one: plant, controllers, units and limits looked up and checked once."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from ddpc_cosim.errors import ConfigError, CosimError, Place
from ddpc_cosim.loop_setup import late_error, limits_error
from ddpc_cosim.plant import ParameterValue
from ddpc_cosim.settings import PLANT
from ddpc_cosim.signals import Excitation, Reference
from ddpc_cosim.study.controllers import ResolvedController, Variant, resolve_controller, variants_of
from ddpc_cosim.study.plants import PlantSpec, PlantVariables
from ddpc_cosim.study.sections import BoundsSection, DriftSection, EventSection, RecordingSection, Study
from ddpc_cosim.study.validation_errors import Section, ValidationErrors, independent
from ddpc_cosim.variables import Variable, conversions

Limits = dict[str, tuple[float, float]]

_INPUTS, _OUTPUTS, _MEASUREMENTS = (("plant", key) for key in ("inputs", "outputs", "measurements"))
_RECORDING: Place = ("recording",)
_EXCITATION: Place = ("recording", "excitation")
_STABILISER: Place = ("recording", "controller")


@dataclass(frozen=True, slots=True)
class ResolvedStudy:
    """A study that fits its plant and its controllers, ready to become cases.

    Parameters
    ----------
    study : Study
        The file's content with every default filled in, every sweep written out and every path absolute.
    plant : PlantSpec
        The plant.
    inputs, outputs, measurements : tuple of Variable
        The signals that take part.
    reference : dict of str to Reference
        Of each controlled output, in its own unit.
    bounds : dict of str to dict of str to (float, float)
        For each controller the limits of inputs and controlled outputs, in their own units.
    excitation : Excitation or None
        The experiment; each case draws it with its own seed.
    """

    study: Study
    plant: PlantSpec
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    measurements: tuple[Variable, ...]
    reference: dict[str, Reference]
    bounds: dict[str, Limits]
    excitation: Excitation | None


def resolve(study: Study, folder: Path, errors: ValidationErrors) -> ResolvedStudy | None:
    """Look up everything that a study names, and check that it fits together.

    Parameters
    ----------
    study : Study
        Its sections; what was invalid is left out.
    folder : Path
        Folder of the file: paths in it are relative to this.
    errors : ValidationErrors
        What was found before; what is found here is added.

    Returns
    -------
    resolved : ResolvedStudy or None
        None if there are errors.
    """
    variants = _variants(study, errors) or []
    controllers = _controllers(study, variants, folder, errors)
    stabiliser = _stabiliser(study, folder, errors)
    _check_report(study, variants, errors)
    _check_files(variants, controllers, errors)
    plant = _plant(study, folder, errors)
    if plant is None:
        return None
    spec, variables = plant
    signals = _signals(study, variables, errors)
    if not spec.is_fmu:
        _check_placeholders(variants, controllers, errors)
    _check_scenarios(study, signals, errors)
    _check_recording(study, signals, controllers, errors)
    references = _references(study, signals, errors)
    bounds = _bounds(study, signals, errors)
    excitation = _excitation(study, signals, errors)
    if errors.found or references is None or bounds is None:
        return None
    return ResolvedStudy(
        study=_written_out(study, spec, signals, variants, controllers, stabiliser),
        plant=spec,
        inputs=signals.inputs.variables,
        outputs=signals.outputs.variables,
        measurements=signals.measurements.variables,
        reference=references,
        bounds={variant.name: bounds[variant.of] for variant in variants},
        excitation=excitation,
    )


class Selection(NamedTuple):
    """The signals of one kind that take part.

    Where it is not known which, they are all that could, and ``size`` is the number of names given (0: none).
    """

    variables: tuple[Variable, ...]
    is_known: bool
    size: int

    @property
    def names(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(variable.name for variable in self.variables)


class Signals(NamedTuple):
    """The plant's variables, and those that take part."""

    variables: PlantVariables
    inputs: Selection
    outputs: Selection
    measurements: Selection


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
        units = ", ".join(name for name in allowed if name)
        raise ConfigError(f'unit "{unit}" does not fit {variable.name}; allowed: {units}')
    shown = known[unit]
    return lambda value: (value - shown.offset) / shown.factor


def _converter(
    place: Place, variable: Variable | None, unit: str, errors: ValidationErrors
) -> Callable[[float], float] | None:
    """Return the conversion of the values of a section; None if there is none, which is reported."""
    if variable is None:
        return None
    try:
        return converter(variable, unit)
    except ConfigError as error:
        errors.add((*place, "unit"), str(error))
        return None


@independent
def _variants(study: Study, errors: ValidationErrors) -> list[Variant]:
    variants: list[Variant] = []
    taken = set(study.controllers)
    for name, section in study.controllers.items():
        place: Place = ("controllers", name, "sweep")
        for variant in variants_of(name, section, with_sweeps=place not in errors.found):
            if variant.varied and variant.name in taken:
                errors.add(place, f'two controllers are called "{variant.name}"; change a value')
            taken.add(variant.name)
            variants.append(variant)
    return variants


def _controllers(
    study: Study, variants: Iterable[Variant], folder: Path, errors: ValidationErrors
) -> dict[str, ResolvedController]:
    """Return the controllers that could be built."""

    @independent
    def build(variant: Variant) -> ResolvedController | None:
        kind = study.controllers[variant.of].type
        return resolve_controller(kind, variant.settings, folder, errors, variant.place)

    built = {variant.name: build(variant) for variant in variants}
    return {name: controller for name, controller in built.items() if controller is not None}


@independent
def _stabiliser(study: Study, folder: Path, errors: ValidationErrors) -> ResolvedController | None:
    if study.recording is None or study.recording.controller is None:
        return None
    section = study.recording.controller
    resolved = resolve_controller(
        section.type, section.settings, folder, errors, lambda setting: (*_STABILISER, "settings", *setting)
    )
    if resolved is not None and resolved.controller.uses_recording:
        errors.add(_STABILISER, "learns from a recording itself; needed: one that controls without")
    return resolved


@independent
def _check_report(study: Study, variants: Iterable[Variant], errors: ValidationErrors) -> None:
    known = [*study.controllers, *(variant.name for variant in variants)]

    @independent
    def require(place: Place, section: Section, key: str) -> None:
        named = getattr(section, key)
        given = [named] if isinstance(named, str) else named
        # A controller whose section has errors is there all the same.
        doubtful = [name for name in given if errors.in_doubt(("controllers", name))]
        errors.require_known((*place, key), "controller", filter(None, given), [*known, *doubtful])

    for i, panel in enumerate(study.report.panels):
        require(("report", "panels", i), panel, "controllers")
    for i, method in enumerate(study.report.reproduction.methods if study.report.reproduction else ()):
        for key in ("printed", "published_code"):
            require(("report", "reproduction", "methods", i), method, key)


def _check_files(
    variants: Iterable[Variant], controllers: Mapping[str, ResolvedController], errors: ValidationErrors
) -> None:
    """Check that there are the files that controllers name."""
    for variant in variants:
        for path in controllers[variant.name].files if variant.name in controllers else ():
            if path != PLANT and not Path(path).is_file():
                errors.add(variant.place(()), f"{path}: no such file")


def _check_placeholders(
    variants: Iterable[Variant], controllers: Mapping[str, ResolvedController], errors: ValidationErrors
) -> None:
    """Check that no controller asks for the FMU of a plant that is none."""
    for variant in variants:
        if variant.name in controllers and PLANT in controllers[variant.name].files:
            what = f'"{PLANT}" stands for the FMU of the plant, which is a Python class'
            errors.add(variant.place(()), what)


@independent
def _plant(study: Study, folder: Path, errors: ValidationErrors) -> tuple[PlantSpec, PlantVariables] | None:
    """Return the plant and its variables; None if there is none to check the study against."""
    section, chosen = study.plant, (("plant", "name"), ("plant", "fmu"))
    if ("plant",) in errors.found or any(map(errors.in_doubt, chosen)):
        return None
    try:
        spec = PlantSpec.of(section, folder)
        variables = spec.variables()
    except CosimError as error:
        errors.add(("plant", "fmu" if section.fmu else "name"), str(error))
        return None
    known = (*variables.inputs, *variables.outputs)
    for key in ("display_units", "nominal"):
        errors.require_known(("plant", key), "input or output", getattr(section, key), known)
    try:
        variables = variables.shown(section.display_units, section.nominal)
    except ConfigError as error:
        for fault in error.faults:
            errors.add(("plant", "display_units"), fault)
    _check_parameters(("plant", "parameters"), section.parameters, variables.parameters, errors)
    return spec, variables


def _signals(study: Study, variables: PlantVariables, errors: ValidationErrors) -> Signals:
    plant = study.plant
    inputs = _select(_INPUTS, "input", plant.inputs, variables.inputs, variables.default_inputs, errors)
    outputs = _select(_OUTPUTS, "output", plant.outputs, variables.outputs, variables.default_outputs, errors)
    measurements = _select(_MEASUREMENTS, "output", plant.measurements, variables.outputs, (), errors)
    if not plant.measurements and not errors.in_doubt(_MEASUREMENTS):
        measurements = outputs
    return Signals(variables, inputs, outputs, measurements)


def _select(
    place: Place,
    what: str,
    given: list[str],
    known: Mapping[str, Variable],
    default: tuple[str, ...],
    errors: ValidationErrors,
) -> Selection:
    errors.require_known(place, what, given, known)
    for name in sorted({name for name in given if given.count(name) > 1}):
        errors.add(place, f'"{name}" is listed more than once')
    if errors.in_doubt(place):
        return Selection(tuple(known.values()), False, len(given))
    chosen = tuple(known[name] for name in given or default or known)
    return Selection(chosen, True, len(chosen))


def _check_parameters(
    place: Place,
    values: Mapping[str, ParameterValue],
    known: Mapping[str, Variable],
    errors: ValidationErrors,
    what: str = "parameter",
) -> None:
    errors.require_known(place, what, values, known)
    for name, value in values.items():
        if not isinstance(value, str):  # a string, or the name of an enumeration's value: the plant knows
            _check_value((*place, name), value, known.get(name), errors)


def _check_value(place: Place, value: float, parameter: Variable | None, errors: ValidationErrors) -> None:
    if parameter is not None and not parameter.min <= value <= parameter.max:
        errors.add(place, f"{value:g} is outside [{parameter.min:g}, {parameter.max:g}]")


@independent
def _references(study: Study, signals: Signals, errors: ValidationErrors) -> dict[str, Reference] | None:
    place: Place = ("reference",)
    errors.require_known(place, "controlled output", study.reference, signals.outputs.names)
    for name in signals.outputs.names if signals.outputs.is_known else ():
        if name not in study.reference:
            errors.add(place, f"none for the controlled output {name}", (*place, name))
    converters = {
        name: _converter((*place, name), signals.variables.outputs.get(name), section.unit, errors)
        for name, section in study.reference.items()
    }
    if errors.found:
        return None
    return {name: study.reference[name].build(convert) for name, convert in converters.items() if convert}


@independent
def _bounds(study: Study, signals: Signals, errors: ValidationErrors) -> dict[str, Limits]:
    """Return the limits of each controller section: its own, else the study's, else the plant's."""
    variables = (*signals.inputs.variables, *signals.outputs.variables)
    common = {v.name: (v.min, v.max) for v in variables} | _limits(("bounds",), study.bounds, signals, errors)
    return {
        name: common | _limits(("controllers", name, "bounds"), section.bounds, signals, errors)
        for name, section in study.controllers.items()
    }


def _limits(
    place: Place, bounds: Mapping[str, BoundsSection], signals: Signals, errors: ValidationErrors
) -> Limits:
    """Return the limits of a table in the variables' own units; a side left out is the plant's."""
    known = (*signals.inputs.names, *signals.outputs.names)
    errors.require_known(place, "input or controlled output", bounds, known)
    variables = {**signals.variables.outputs, **signals.variables.inputs}
    table = {}
    for name, section in bounds.items():
        at = (*place, name)
        convert = _converter(at, variables.get(name), section.unit, errors)
        if convert is None:
            continue
        low = variables[name].min if section.min is None else convert(section.min)
        high = variables[name].max if section.max is None else convert(section.max)
        if limits_error((low, high)) and at not in errors.found:
            errors.add(at, f"leaves no room: [{low:g}, {high:g}] with the plant's own limits", at)
        table[name] = (low, high)
    return table


def _check_scenarios(study: Study, signals: Signals, errors: ValidationErrors) -> None:
    parameters = signals.variables.parameters
    tunable = {name: v for name, v in parameters.items() if name in signals.variables.tunable}
    for name, scenario in study.scenarios.items():
        place = ("scenarios", name)
        _check_parameters((*place, "parameters"), scenario.parameters, parameters, errors)
        noisy = (*place, "noise")
        errors.require_known(noisy, "measurement", scenario.noise, signals.measurements.names)
        for i, event in enumerate(scenario.events):
            _check_in_run((*place, "events", i), event, "time", study, errors)
            _check_event((*place, "events", i), event, tunable, errors)
        for i, drift in enumerate(scenario.drifts):
            _check_in_run((*place, "drifts", i), drift, "from_time", study, errors)
            _check_drift_acts((*place, "drifts", i), drift, study, errors)
            _check_drift((*place, "drifts", i), drift, tunable, errors)


@independent
def _check_in_run(place: Place, change: Section, key: str, study: Study, errors: ValidationErrors) -> None:
    """Report a change that would never act on the plant; the scenario would not be what it says."""
    error = late_error(getattr(change, key), study.loop.start_time + study.loop.duration)
    if error:
        errors.add((*place, key), error, ("loop", "start_time"))


@independent
def _check_drift_acts(place: Place, drift: DriftSection, study: Study, errors: ValidationErrors) -> None:
    start = study.loop.start_time
    if drift.to_time <= start:
        over = f"it would be over when the run starts at t = {start:g} s; use the scenario's parameters"
        errors.add((*place, "to_time"), over, ("loop", "start_time"))


@independent
def _check_event(
    place: Place, event: EventSection, tunable: Mapping[str, Variable], errors: ValidationErrors
) -> None:
    _check_parameters((*place, "parameters"), event.parameters, tunable, errors, "tunable parameter")


@independent
def _check_drift(
    place: Place, drift: DriftSection, tunable: Mapping[str, Variable], errors: ValidationErrors
) -> None:
    errors.require_known((*place, "parameter"), "tunable parameter", [drift.parameter], tunable)
    parameter = tunable.get(drift.parameter)
    _check_value((*place, "from_value"), drift.from_value, parameter, errors)
    _check_value((*place, "to_value"), drift.to_value, parameter, errors)


def _check_recording(
    study: Study,
    signals: Signals,
    controllers: Mapping[str, ResolvedController],
    errors: ValidationErrors,
) -> None:
    """Check that there is a recording, and a long one, where something learns from it."""
    recording = study.recording
    if recording is None:
        _check_start(study, errors)
        for name, resolved in controllers.items():
            if resolved.controller.uses_recording:
                lacking = "learns from a recording, and the study has no recording section"
                errors.add(("controllers", name), lacking, _RECORDING)
        return
    sizes = [selection.size for selection in (signals.inputs, signals.outputs, signals.measurements)]
    for name, resolved in controllers.items() if all(sizes) else ():
        _check_length(recording, name, resolved.controller.recording_length(*sizes), errors)


@independent
def _check_start(study: Study, errors: ValidationErrors) -> None:
    if study.loop.start == "recording-end":
        errors.add(("loop", "start"), '"recording-end" needs a recording section', _RECORDING)


@independent
def _check_length(recording: RecordingSection, name: str, needed: int, errors: ValidationErrors) -> None:
    if recording.samples < needed:
        short = f"{recording.samples} is too short for {name}, which needs {needed}"
        errors.add((*_RECORDING, "samples"), short)


@independent
def _excitation(study: Study, signals: Signals, errors: ValidationErrors) -> Excitation | None:
    """Return the experiment on all inputs, in their units."""
    if study.recording is None:
        return None
    sections = study.recording.excitation
    errors.require_known(_EXCITATION, "input", sections, signals.inputs.names)
    for name in signals.inputs.names if signals.inputs.is_known else ():
        if name not in sections:
            errors.add(_EXCITATION, f"none for the input {name}", (*_EXCITATION, name))
    inputs = signals.variables.inputs
    converters = {
        name: _converter((*_EXCITATION, name), inputs.get(name), section.unit, errors)
        for name, section in sections.items()
    }
    if errors.found or not signals.inputs.names:
        return None
    return study.recording.build(
        {name: convert for name in signals.inputs.names if (convert := converters[name])}
    )


def _written_out(
    study: Study,
    spec: PlantSpec,
    signals: Signals,
    variants: Iterable[Variant],
    controllers: Mapping[str, ResolvedController],
    stabiliser: ResolvedController | None,
) -> Study:
    """Return the study with every default filled in, every sweep written out and every path absolute."""
    plant = {
        "fmu": spec.fmu,
        "inputs": list(signals.inputs.names),
        "outputs": list(signals.outputs.names),
        "measurements": list(signals.measurements.names),
    }
    sections = {
        variant.name: variant.section(study.controllers[variant.of], controllers[variant.name].settings)
        for variant in variants
    }
    recording = study.recording
    if recording is not None and recording.controller is not None and stabiliser is not None:
        settings = {"settings": stabiliser.settings}
        controller = recording.controller.model_copy(update=settings)
        recording = recording.model_copy(update={"controller": controller})
    return study.model_copy(
        update={
            "plant": study.plant.model_copy(update=plant),
            "controllers": sections,
            "recording": recording,
        }
    )
