"""From a parsed study to a resolved one: plant, controllers, units and limits looked up and checked once."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ddpc_cosim.codec import Section, ValidationErrors, independent, write
from ddpc_cosim.conditions import Conditions
from ddpc_cosim.controller import Controller, Recording
from ddpc_cosim.description import PlantDescription, switch_faults
from ddpc_cosim.distributions import Distribution
from ddpc_cosim.errors import ConfigError, ControllerError, CosimError, DataError, Place
from ddpc_cosim.files.csv_files import forget_cells
from ddpc_cosim.files.durations import in_words
from ddpc_cosim.identification.plant import sampling_fault
from ddpc_cosim.identification.specification import IdentifiedSpec
from ddpc_cosim.loop.outlook import Limit
from ddpc_cosim.loop.plant_control import PlantControl
from ddpc_cosim.loop.safe_calls import CallsInTime, recording_length
from ddpc_cosim.loop.setup import limits_error
from ddpc_cosim.metrics import MetricSettings, all_metrics, installed_versions
from ddpc_cosim.plant import ParameterValue
from ddpc_cosim.responses import Actuation, Response
from ddpc_cosim.settings import PLANT, files_of
from ddpc_cosim.signals.disturbances import KnownDisturbance
from ddpc_cosim.signals.excitations import Excitation
from ddpc_cosim.signals.prices import Price
from ddpc_cosim.signals.signals import Band, Reference
from ddpc_cosim.study.controllers import (
    StudyController,
    late_call,
    resolve_controllers,
    resolve_stabiliser,
    resolve_warm_up,
    time_limit,
)
from ddpc_cosim.study.disturbances import Disturbances, check_reach
from ddpc_cosim.study.file_format.requirements import REQUIREMENTS
from ddpc_cosim.study.file_format.sections import (
    BandSection,
    BoundsSection,
    RecordingSection,
    StabiliserSection,
    Study,
    StudyHead,
)
from ddpc_cosim.study.file_format.study_files import StudyFile
from ddpc_cosim.study.key_figures import StudyKeyFigures
from ddpc_cosim.study.plants import PlantSpec, PlantTables
from ddpc_cosim.study.prices import Prices
from ddpc_cosim.study.problems import WholeStudy
from ddpc_cosim.study.requirements import RequirementsCheck
from ddpc_cosim.study.scenarios import Scenarios
from ddpc_cosim.study.selection import SelectedSignals, check_parameters
from ddpc_cosim.study.verdicts.judgement import set_aside
from ddpc_cosim.study.verdicts.shares import end_of
from ddpc_cosim.variables import DisplayUnit, FloatArray, Variable, unit_shown

_MOST_LISTED = 8
Limits = dict[str, tuple[Limit, Limit]]

_PLANT: Place = ("plant",)
_RECORDING: Place = ("recording",)


@dataclass(frozen=True, slots=True)
class ResolvedStudy:
    """A study of one problem that fits its plant and its controllers, ready to become cases.

    Parameters
    ----------
    study : Study
        The file's content with every default filled in, every sweep written out and every path absolute.
    plant : PlantSpec
        The plant.
    inputs, outputs, measurements : tuple of Variable
        The signals that take part.
    reference : dict of str to (Reference or Band)
        Of each controlled output, in its own unit.
    bounds : dict of str to dict of str to pairs of (float or Reference)
        For each controller the limits of inputs and controlled outputs, in their own units.
    shared_bounds : dict of str to pairs of (float or Reference)
        The same for who has none of its own.
    scenario_bounds : dict of str to dict of str to pairs of (float or Reference)
        What each scenario puts in place of them.
    excitations : dict of str to (Excitation or None)
        The experiment of each scenario; each case draws it with its own seed.
    conditions : dict of str to Conditions
        Of each scenario, in the variables' own units.
    undriven : dict of str to tuple of Variable
        The inputs that have a signal in each scenario.
    disturbances : dict of str to dict of str to KnownDisturbance
        Those of each scenario, in the variables' own units; the signals of inputs are among the conditions.
    recorded_disturbances : dict of str to Reference
        Those that have a signal of their own in the experiment.
    prices : dict of str to dict of str to Price
        Those of each scenario, all of which are signals.
    monitors : dict of str to (Band or None)
        Outputs that key figures are of and that are not kept otherwise, with their bands.
    read : tuple of Variable
        Outputs that are known disturbances or monitored, and neither controlled nor measured.
    forecast_horizon : int
        The longest horizon of the controllers.
    warm_up_controller : StabiliserSection or None
        The controller that warms up the plant, with all its settings.
    metrics : MetricSettings
        What all runs are judged by alike.
    recording : Recording or None
        Logged data, in place of an experiment.
    late : dict of str to str
        Why a controller cannot be run: one of its calls has not returned within the time limit.
    lacking : dict of str to str
        What a controller needs that is not installed: its cases fail.
    spread : tuple of Variable
        The parameters that seeds draw, in any scenario; their values differ from case to case.
    """

    study: Study
    plant: PlantSpec
    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    measurements: tuple[Variable, ...]
    reference: dict[str, Reference | Band]
    bounds: dict[str, Limits]
    shared_bounds: Limits
    scenario_bounds: dict[str, Limits]
    excitations: dict[str, Excitation | None]
    conditions: dict[str, Conditions]
    undriven: dict[str, tuple[Variable, ...]]
    disturbances: dict[str, dict[str, KnownDisturbance]]
    recorded_disturbances: dict[str, Reference]
    prices: dict[str, dict[str, Price]]
    monitors: dict[str, Band | None]
    read: tuple[Variable, ...]
    forecast_horizon: int
    warm_up_controller: StabiliserSection | None
    metrics: MetricSettings
    recording: Recording | None
    late: dict[str, str]
    lacking: dict[str, str]
    spread: tuple[Variable, ...] = ()


@dataclass(frozen=True, slots=True)
class ResolvedProblems:
    """All problems of a study, each ready to become cases.

    Parameters
    ----------
    head : StudyHead
        What the study says of itself; of a flat study that study.
    problems : dict of str to ResolvedStudy
        Each problem as a study of its own.
    file : StudyFile
        What it was read from; it makes no difference to what it is.
    """

    head: StudyHead
    problems: dict[str, ResolvedStudy]
    file: StudyFile = field(compare=False)

    @property
    def whole(self) -> WholeStudy:
        """The study as it is written."""
        return WholeStudy(self.head, {name: problem.study for name, problem in self.problems.items()})

    @property
    def problem(self) -> ResolvedStudy:
        """The only problem; ValueError where there are several."""
        (only,) = self.problems.values()
        return only


class StudyCache:
    """What has been found out about plants and controllers, for all problems of a study."""

    def __init__(self) -> None:
        self._variables: list[tuple[PlantSpec, PlantDescription]] = []
        self._tables = dict[tuple[str, str], PlantTables]()
        self._in_time: dict[float, CallsInTime] = {}
        self.late: dict[str, str] = {}  # by type of controller, the call that has not returned in time

    def in_time(self, seconds: float) -> CallsInTime:
        """Return what makes calls that have to return within so many seconds."""
        return self._in_time.setdefault(seconds, CallsInTime(seconds))

    def variables(self, spec: PlantSpec) -> PlantDescription:
        """Return the variables of a plant, which is asked once."""
        description = next((variables for known, variables in self._variables if known == spec), None)
        if description is None:
            description = spec.variables()
            self._variables.append((spec, description))
        return description

    def tables(self, spec: PlantSpec) -> PlantTables:
        """Return the tables in the resources of a plant, each of which is read once."""
        if spec.coupled:
            return spec.tables()
        return self._tables.setdefault((spec.name, spec.fmu), spec.tables())

    def forget(self) -> None:
        """Let go of threads and files."""
        for in_time in self._in_time.values():
            in_time.__exit__()
        forget_cells()


def resolve(study: Study, folder: Path, errors: ValidationErrors, cache: StudyCache) -> ResolvedStudy | None:
    """Look up everything that a study names, and check that it fits together.

    Parameters
    ----------
    study : Study
        Its sections; what was invalid is left out.
    folder : Path
        Folder of the file: paths in it are relative to this.
    errors : ValidationErrors
        What was found before; what is found here is added.
    cache : StudyCache
        What is known from other problems of the study; what is found out here is added.

    Returns
    -------
    resolved : ResolvedStudy or None
        None if there are errors.
    """
    return _Resolution(study, folder, errors, cache).result()


def _dotted_names(settings: Mapping[str, Any], before: str = "") -> Iterator[str]:
    """Yield the names of settings and of the entries of those that are tables: ``inner.kp``."""
    for name, value in settings.items():
        yield before + name
        if isinstance(value, Mapping):
            yield from _dotted_names(value, f"{before}{name}.")


def _no_switch(name: str) -> str:
    """Return how a study says that an input has no switch."""
    return f'or say that it is not one: plant.switches = {{ {name} = "" }}'


class _Resolution:
    """The way of one study; what does not fit is reported, and what depends on it is left out."""

    def __init__(self, study: Study, folder: Path, errors: ValidationErrors, cache: StudyCache) -> None:
        self.study, self.errors, self.cache = study, errors, cache
        self.in_time = cache.in_time(time_limit(study))
        self.controllers = resolve_controllers(study, folder, errors, self.in_time, cache.late) or []
        self.stabiliser = resolve_stabiliser(study, folder, errors, self.in_time)
        self.warm_up = resolve_warm_up(study, folder, errors, self.in_time)
        self.horizon = max((controller.horizon for controller in self.controllers), default=0)
        self.is_free = self._is_free()
        self._check_report()
        for controller in self.controllers:
            self._check_search(controller)
            self._check_tuned(controller)
        plant = self._plant(folder)
        self.is_complete = plant is not None
        if plant is None:
            return
        self.plant, self.variables = plant
        self._check_plant()
        self._check_switches()
        self.signals = SelectedSignals(study, self.variables, errors, cache.tables(self.plant), self.is_free)
        self.inputs, self.outputs = self.signals.inputs, self.signals.outputs
        self.measurements = self.signals.measurements
        self.disturbances = Disturbances(self.signals, self.horizon)
        self.prices = Prices(self.signals, self.horizon)
        self.scenarios = Scenarios(self.signals, self.disturbances)
        self.scenarios.check()
        self.recording = self._read_recording()
        self._check_recording()
        self._check_cost()
        self._check_ranking()
        self._check_relevant()
        self._check_claims()
        self.key_figures = StudyKeyFigures(self.signals, self.prices.of_study, self._band)
        RequirementsCheck(self.signals, self.prices.of_study, self.key_figures.tags).check()
        self.references = self._references()
        self.shared_bounds = self._shared_bounds()
        self.own_bounds = self._own_bounds() or {}
        self.scenario_bounds = {name: self._scenario_bounds(name) or {} for name in study.scenarios}
        self.excitation = self._excitation()
        self.excitations = {
            name: self.scenarios.excitation(name, self.excitation) for name in study.scenarios
        }
        self.conditions = {name: self.scenarios.conditions(name) for name in study.scenarios}

    def result(self) -> ResolvedStudy | None:
        """Return the resolved study, None if there are errors."""
        if self.errors.found or not self.is_complete or self.references is None or self.shared_bounds is None:
            return None
        return ResolvedStudy(
            study=self._written_out(),
            plant=self.plant,
            inputs=self.inputs.variables,
            outputs=self.outputs.variables,
            measurements=self.measurements.variables,
            reference=self.references,
            bounds={
                controller.name: self.shared_bounds | self.own_bounds[controller.of]
                for controller in self.controllers
            },
            shared_bounds=self.shared_bounds,
            scenario_bounds=self.scenario_bounds,
            excitations=self.excitations,
            conditions={name: conditions or Conditions() for name, conditions in self.conditions.items()},
            undriven={name: self.scenarios.undriven(name) for name in self.study.scenarios},
            disturbances={name: self.disturbances.of(name) for name in self.study.scenarios},
            recorded_disturbances=self.disturbances.recorded or {},
            prices={name: self.prices.of(name) for name in self.study.scenarios},
            monitors=self.key_figures.monitors,
            read=self._read_besides(),
            forecast_horizon=self.horizon,
            warm_up_controller=self._with_settings(self.study.loop.warm_up_controller, self.warm_up),
            metrics=self._metrics(),
            recording=self.recording,
            late={
                controller.name: late_call(
                    self.study.controllers[controller.of].type, controller.late, self.in_time.seconds
                )
                for controller in self.controllers
                if controller.late
            },
            lacking={
                controller.name: controller.lacking for controller in self.controllers if controller.lacking
            },
            spread=tuple(self.variables.parameters[name] for name in sorted(self._spread())),
        )

    def _metrics(self) -> MetricSettings:
        cost, loop = self.study.metrics.cost, self.study.loop
        limits = map(loop.preview_of, self.study.scenarios.values())
        preview = max(self.horizon if limit is None else min(limit, self.horizon) for limit in limits)
        weights = write(cost) if cost else {}
        return MetricSettings(preview, weights, installed_versions(), self.key_figures.tags)

    def _read_besides(self) -> tuple[Variable, ...]:
        """Return the outputs that are disturbances or monitored, and neither controlled nor measured."""
        outputs = self.variables.outputs
        known = {**self.disturbances.variables, **{name: outputs[name] for name in self.key_figures.monitors}}
        others = known.keys() - {*self.outputs.names, *self.measurements.names}
        return tuple(v for name, v in known.items() if name in others & outputs.keys())

    @staticmethod
    def _with_settings(
        section: StabiliserSection | None, built: StudyController | None
    ) -> StabiliserSection | None:
        """Return the section of a controller with all its settings."""
        return section if section is None or built is None else replace(section, settings=built.settings)

    def _written_out(self) -> Study:
        """Return the study with every default filled in, every sweep written out and every path absolute."""
        study, recording = self.study, self.study.recording
        plant: dict[str, Any] = {
            "fmu": self.plant.fmu,
            "identified": self.plant.identified and self.plant.identified.identification,
            "inputs": list(self.inputs.names),
            "outputs": list(self.outputs.names),
            "measurements": list(self.measurements.names),
        }
        if recording is not None:
            controller = self._with_settings(recording.controller, self.stabiliser)
            recording = replace(recording, controller=controller)
        warm_up_controller = self._with_settings(study.loop.warm_up_controller, self.warm_up)
        return replace(
            study,
            plant=replace(study.plant, **plant),
            loop=replace(study.loop, warm_up_controller=warm_up_controller),
            controllers={c.name: c.section(study.controllers[c.of]) for c in self.controllers},
            recording=recording,
        )

    @independent
    def _check_report(self) -> None:
        report = self.study.report
        if report.scenario:
            place = ("report", "scenario")
            self.errors.require_known(place, "scenario", [report.scenario], self.study.scenarios)
        for i, panel in enumerate(report.panels):
            self._require_controllers(("report", "panels", i), panel, "controllers")
        for i, method in enumerate(report.reproduction.methods if report.reproduction else ()):
            for key in ("printed", "published_code"):
                self._require_controllers(("report", "reproduction", "methods", i), method, key)
        for i, claim in enumerate(report.claims):
            for key in ("lowest", "highest", "order", "alike"):
                self._require_controllers(("report", "claims", i), claim, key)
        self._require_controllers(("report",), report, "baseline")
        if self.study.requirements:
            self._require_controllers((REQUIREMENTS,), self.study.requirements, "controllers")
        if report.reference_points:
            for key in ("zero", "full"):
                self._require_controllers(("report", "reference_points"), report.reference_points, key)
        for name, section in self.study.controllers.items():
            if section.seeds == "first" and end_of(name, report.reference_points) is None:
                what = (
                    '"first" is for a reference point, with which no other is compared in pairs of seeds; '
                    "leave it out, or name the controller in report.reference_points"
                )
                self.errors.add(("controllers", name, "seeds"), what, ("report", "reference_points"))

    @independent
    def _check_claims(self) -> None:
        """Check that claims are of metrics that there are, with their signals."""
        signals = {Response: self.outputs.names, Actuation: self.inputs.names}
        known = [
            ".".join(filter(None, (name, signal)))
            for name, metric in all_metrics().items()
            for signal in signals.get(metric.of, ("",))
        ]
        aside = set_aside(self.study)
        for i, claim in enumerate(self.study.report.claims):
            self.errors.require_known(("report", "claims", i, "metric"), "metric", [claim.metric], known)
            for key in ("lowest", "highest"):
                if (name := getattr(claim, key)) in aside:
                    what = "does not compete: it is a reference point, or a setting of a sweep"
                    self.errors.add(("report", "claims", i, key), f"{name} {what}")

    @independent
    def _require_controllers(self, place: Place, section: Section, key: str) -> None:
        named = getattr(section, key) or []
        given = [named] if isinstance(named, str) else named
        known = [*self.study.controllers, *(controller.name for controller in self.controllers)]
        # A controller whose section has errors is there all the same.
        known += [name for name in given if self.errors.in_doubt(("controllers", name))]
        self.errors.require_known((*place, key), "controller", filter(None, given), known)

    @independent
    def _check_search(self, controller: StudyController) -> None:
        section = self.study.controllers[controller.of]
        if controller.controller is not None and not controller.varied:
            known = list(_dotted_names(controller.settings))
            place = ("controllers", controller.name, "search")
            self.errors.require_known(place, "setting", section.search, known)
            for i, settings in enumerate(section.first_trials):
                at = ("controllers", controller.name, "first_trials", i)
                self.errors.require_known(at, "setting", settings, known)

    @independent
    def _check_tuned(self, controller: StudyController) -> None:
        """Check that what was tuned is a setting, and on other seeds than those reported."""
        tuned = self.study.controllers[controller.name].tuned if not controller.varied else None
        if tuned is None:
            return
        place = ("controllers", controller.name, "tuned")
        if controller.controller is not None:
            known = list(_dotted_names(controller.settings))
            self.errors.require_known((*place, "settings"), "setting", tuned.settings or (), known)
        if shared := sorted(set(tuned.seeds or ()) & set(self.study.seeds)):
            listed = ", ".join(map(str, shared[:_MOST_LISTED])) + (", ..." if shared[_MOST_LISTED:] else "")
            what = f"{listed}: a seed of the study; needed: seeds on which no result is reported"
            self.errors.add((*place, "seeds"), what, ("seeds",))

    @independent
    def _plant(self, folder: Path) -> tuple[PlantSpec, PlantDescription] | None:
        """Return the plant and its variables; None if there is none to check the study against."""
        section = self.study.plant
        what = ("name", "fmu", "ssp", "parts", "connections", "coupling", "identified")
        doubtful = any(self.errors.in_doubt((*_PLANT, key)) for key in what)
        is_wrong = any(place[:1] == _PLANT and place[1] in what for place in self.errors.found if place[1:])
        if doubtful or is_wrong or _PLANT in self.errors.found:
            return None
        try:
            spec = PlantSpec.of(section, folder)
            return spec, self.cache.variables(spec)
        except CosimError as error:
            for fault in getattr(error, "faults", (str(error),)):
                self.errors.add((*_PLANT, *self._of_plant(fault)), fault)
            return None

    def _of_plant(self, fault: str) -> Place:
        """Return the keys below the plant's that a fault is of."""
        section = self.study.plant
        for i, connection in enumerate(section.connections):
            if fault.startswith(str(connection)):
                return "connections", i
        for i, part in enumerate(section.parts):
            if fault.startswith(f'part "{part.name}"'):
                return "parts", i
        return (
            next((key for key in ("fmu", "ssp", "parts", "identified") if getattr(section, key)), "name"),
        )

    def _check_plant(self) -> None:
        section, errors = self.study.plant, self.errors
        if self.plant.identified:
            self._check_sampling(self.plant.identified)
        known = (*self.variables.inputs, *self.variables.outputs)
        for key in ("display_units", "nominal"):
            errors.require_known((*_PLANT, key), "input or output", getattr(section, key), known)
        try:
            self.variables = self.variables.shown(section.display_units, section.nominal, section.start)
        except ConfigError as error:
            for fault in error.faults:
                errors.add((*_PLANT, "display_units"), fault)
        check_parameters(errors, (*_PLANT, "start"), "input", section.start, self.variables.inputs)
        parameters = self.variables.parameters
        check_parameters(errors, (*_PLANT, "parameters"), "parameter", section.parameters, parameters)
        self._check_spread()
        for controller in self.controllers if not self.plant.is_fmu else ():
            if PLANT in files_of(type(controller.controller), controller.settings):
                kind = "consists of parts" if self.plant.coupled else "is a Python class"
                kind = "is identified from data" if self.plant.identified else kind
                what = f'"{PLANT}" stands for the FMU of the plant, which {kind}'
                errors.add(controller.place, what)

    def _spread(self) -> dict[str, list[Place]]:
        """Return the parameters that seeds draw, and where the study says it."""
        study, spread = self.study, dict[str, list[Place]]()
        said: list[tuple[Place, Mapping[str, Any]]] = [((*_PLANT, "parameters"), study.plant.parameters)]
        said += [(("scenarios", n, "parameters"), s.parameters) for n, s in study.scenarios.items()]
        for place, values in said:
            for name, value in values.items():
                if isinstance(value, Distribution):
                    spread.setdefault(name, []).append((*place, name))
        return spread

    @independent
    def _check_spread(self) -> None:
        """Check that what seeds draw are real numbers of the plant, and that there are such."""
        spread = self._spread()
        for name, places in spread.items():
            signal = self.variables.signal(name)
            if signal is None or signal.source.values == "real":
                continue
            what = f"{name} is of type {signal.source.type}, and a distribution draws real numbers"
            for place in places:
                self.errors.add(place, f"{what}; give it one value")
        if not spread and self.study.plant.sampling != "independent":
            what = "no parameter has a distribution, so that seeds draw nothing; leave it out"
            self.errors.add((*_PLANT, "sampling"), what, (*_PLANT, "parameters"), ("scenarios",))

    @independent
    def _check_sampling(self, identified: IdentifiedSpec) -> None:
        """Check that the loop can be sampled so with the models of a plant."""
        log_sampling_time = identified.logged().recording.sampling_time
        if fault := sampling_fault(self.study.loop.sampling_time, log_sampling_time):
            self.errors.add(("loop", "sampling_time"), fault, (*_PLANT, "identified"))

    @independent
    def _check_switches(self) -> None:
        """Find the switches of inputs, and check what the study says of them."""
        section, errors, at = self.study.plant, self.errors, (*_PLANT, "switches")
        faults = dict(switch_faults(section.switches, self.variables.inputs))
        for name, fault in faults.items():
            errors.add((*at, name), fault)
        if not faults:
            self.variables = self.variables.switched_by(section.switches)
        switches = self.variables.switches
        self.plant = replace(self.plant, switches=switches)
        switched = {switch: name for name, switch in switches.items()}
        driven = section.inputs or self.variables.default_inputs or self.variables.inputs
        for switch in filter(switched.__contains__, driven):
            name = switched[switch]
            instead = f"who drives {name} switches it on; drive that, {_no_switch(name)}"
            errors.add((*_PLANT, "inputs"), f'"{switch}" is the switch of {name}: {instead}')
        self._check_not_switched_off((*_PLANT, "start"), section.start, driven)
        self._check_not_switched_off((*_PLANT, "parameters"), section.parameters, driven)
        for scenario, changes in self.study.scenarios.items():
            self._check_not_switched_off(("scenarios", scenario, "parameters"), changes.parameters, driven)
        for controller in self.controllers:
            if isinstance(controller.controller, PlantControl) and not switches.keys() & set(driven):
                what = "the plant has no control of its own: no input that is driven has a switch"
                hint = 'name it in plant.switches, e.g. { NAME_u = "NAME_activate" }'
                errors.add((*controller.place[:-1], "type"), f"{what}; {hint}")

    def _check_not_switched_off(
        self, place: Place, values: Mapping[str, ParameterValue | Distribution], driven: Collection[str]
    ) -> None:
        """Report values that leave an input to the plant which controllers drive."""
        for name, switch in self.variables.switches.items():
            if name in driven and values.get(switch) in (0, "false"):
                what = f"switches the override {name} off, which the controllers drive"
                self.errors.add((*place, switch), f"{what}; leave it out, {_no_switch(name)}")

    @independent
    def _check_recording(self) -> None:
        """Check that there is a recording, and a long one, where something learns from it."""
        recording = self.study.recording
        sizes = [selection.size for selection in (self.inputs, self.outputs, self.measurements)]
        known = {scenario: self.disturbances.count(scenario) for scenario in self.study.scenarios}
        for i, controller in enumerate(self.controllers):
            if recording is None and controller.uses_recording:
                lacking = "learns from a recording, and the study has no recording section"
                self.errors.add(("controllers", controller.name), lacking, _RECORDING)
            elif recording is not None and controller.controller is not None and all(sizes):
                needed = {
                    count: self._length_needed(i, controller.controller, (*sizes, count))
                    for count in sorted(set(known.values()))
                }
                self._check_length(recording, controller.name, max(needed.values()))
                for scenario, count in known.items():
                    self._check_changed_length(scenario, controller.name, needed[count])
        if self.study.loop.start == "recording-end" and (recording is None or recording.file):
            lacking = "a recording section" if recording is None else "an experiment to go on from, not files"
            self.errors.add(("loop", "start"), f'"recording-end" needs {lacking}', _RECORDING)

    def _length_needed(self, i: int, controller: Controller, sizes: Sequence[int]) -> int:
        """Return how long a recording a controller needs; none where it does not tell, which is noted."""
        try:
            return self.in_time(partial(recording_length, controller, *sizes))
        except TimeoutError:
            self.controllers[i] = self.controllers[i]._replace(late="recording_length")
        except ControllerError as error:
            self.errors.add(("controllers", self.controllers[i].name), str(error))
        return 0

    @independent
    def _check_length(self, recording: RecordingSection, name: str, needed: int) -> None:
        key, samples = "samples", recording.samples
        if self.recording is not None:
            key, samples = "file", len(self.recording)
        if samples is not None and samples < needed:
            short = f"{samples} is too short for {name}, which needs {needed}"
            self.errors.add((*_RECORDING, key), short if key == "samples" else f"the number of rows, {short}")

    @independent
    def _check_changed_length(self, scenario: str, name: str, needed: int) -> None:
        changes, place = self.study.scenarios[scenario].recording, ("scenarios", scenario, "recording")
        if changes is not None and changes.samples is not None and changes.samples < needed:
            short = f"{changes.samples} is too short for {name}, which needs {needed}"
            self.errors.add((*place, "samples"), short)

    @independent
    def _read_recording(self) -> Recording | None:
        """Return what the study's files hold of the signals that take part."""
        section, chosen = self.study.recording, (self.inputs, self.outputs, self.measurements)
        if section is None or not section.file or not all(selection.is_known for selection in chosen):
            return None
        known = self.disturbances.variables
        signals = list(dict.fromkeys((*(name for selection in chosen for name in selection.names), *known)))
        what = "input, output or measurement that takes part"
        self.errors.require_known((*_RECORDING, "columns"), what, section.columns, signals)
        inputs, outputs, measurements = (selection.variables for selection in chosen)
        try:
            return Recording.read_csv(
                *section.file,
                sampling_time=self.study.loop.sampling_time,
                inputs=inputs,
                outputs=outputs,
                measurements=measurements,
                disturbances=tuple(known.values()),
                excitation=section.excitation_columns,
                columns={name: header for name, header in section.columns.items() if name in signals},
                **section.format,
            )
        except DataError as error:
            for fault in error.faults:
                self.errors.add((*_RECORDING, "file"), fault)
            return None

    @independent
    def _check_cost(self) -> None:
        cost, place = self.study.metrics.cost, ("metrics", "cost")
        if cost is not None:
            self.errors.require_known(
                (*place, "outputs"), "controlled output", cost.outputs, self.outputs.names
            )
            for key in ("inputs", "changes"):
                self.errors.require_known((*place, key), "input", getattr(cost, key), self.inputs.names)

    @independent
    def _check_ranking(self) -> None:
        ranking = self.study.metrics.ranking
        if ranking in ("money", "pareto") and not self.study.prices:
            self.errors.add(("metrics", "ranking"), f'"{ranking}" needs prices', ("prices",))

    @independent
    def _check_relevant(self) -> None:
        relevant, place = self.study.metrics.relevant, ("metrics", "relevant", "absolute")
        absolute = relevant.absolute if relevant else None
        ranking, cost = self.study.metrics.ranking, self.study.metrics.cost
        paid = bool(self.study.prices) and ranking != "error" and not cost
        if isinstance(absolute, Mapping):
            if cost:
                self.errors.add(place, "must be a number, as controllers are ranked by metrics.cost")
            else:
                what = "controlled output, or money," if paid else "controlled output"
                self.errors.require_known(place, what, absolute, [*self.outputs.names, *["money"] * paid])
        elif absolute is not None and not cost and ranking != "money" and self.outputs.is_known:
            names = dict.fromkeys(self.outputs.names)  # one that is listed twice is one
            if len(names) > 1 or paid:
                of_money = f"money = {absolute:g}, " if paid else ""
                needed = f"needed: one for each, e.g. {{ {of_money}{self.outputs.names[0]} = {absolute:g} }}"
                ranked_by = "money and discomfort" if paid else f"{len(names)} controlled outputs"
                self.errors.add(place, f"one number for {ranked_by}; {needed}")

    def _is_free(self) -> bool:
        """Return whether there is no reference and none is needed; report it where one is."""
        place: Place = ("reference",)
        if self.study.reference is not None or place in self.errors.found or self.errors.in_doubt(place):
            return False
        built = [controller.controller for controller in self.controllers]
        if built and all(isinstance(controller, PlantControl) for controller in built):
            return True
        self.errors.add(place, "required key is missing")
        self.errors.doubt(place)
        return False

    @independent
    def _references(self) -> dict[str, Reference | Band] | None:
        sections, variables = self.study.reference or {}, self.variables.outputs
        self.signals.require_each(("reference",), "controlled output", sections, self.outputs)
        lines = {name: section for name, section in sections.items() if not isinstance(section, BandSection)}
        references: dict[str, Reference | Band] = {**self.signals.build(("reference",), lines, variables)}
        for name, section in sections.items():
            if isinstance(section, BandSection) and name in variables:
                band = self._band(("reference", name), section, variables[name])
                references |= {} if band is None else {name: band}
        return None if self.errors.found else {name: references[name] for name in sections}

    @independent
    def _band(self, place: Place, section: BandSection, variable: Variable) -> Band | None:
        """Return a band in a variable's own unit, whose edges never cross in the run."""
        edges = {"lower": section.band.lower, "upper": section.band.upper}
        sides = {
            key: self.signals.level((*place, "band", key), edge, variable, section.unit, (*place, "unit"))
            for key, edge in edges.items()
        }
        lower, upper = sides["lower"], sides["upper"]
        if lower is None or upper is None:
            return None
        time = self._times()
        shown = unit_shown(variable, section.unit)
        self._check_order((*place, "band"), ("lower", "upper"), (lower.at(time), upper.at(time)), shown)
        return Band(lower, upper)

    def _check_order(
        self, place: Place, names: tuple[str, str], sides: tuple[FloatArray, FloatArray], shown: DisplayUnit
    ) -> None:
        """Report where the first of two courses, in a variable's unit, is above the second."""
        crossed = np.flatnonzero(sides[0] > sides[1])
        if crossed.size:
            k = crossed[0]
            unit = f" {shown.name}" if shown.name else ""
            low, high = (
                f"{name} ({float(shown.from_unit(side[k : k + 1])[0]):g}{unit})"
                for name, side in zip(names, sides, strict=True)
            )
            when = f"at t = {in_words(float(self._times()[k]))}"
            needed = f"needed: {names[0]} up to {names[1]} at all times"
            self.errors.add(place, f"{low} is above {high} {when}; {needed}")

    def _times(self) -> FloatArray:
        """Return the times of all runs' samples [s], and of those as far ahead as any controller looks."""
        loop = self.study.loop
        samples = np.arange(loop.steps + 1 + self.horizon, dtype=np.float64) * loop.sampling_time
        return np.concatenate([each.start_time + samples for each in self.study.loops])

    @independent
    def _shared_bounds(self) -> Limits:
        """Return the limits of who has none of its own: the study's, else the plant's."""
        variables = (*self.inputs.variables, *self.outputs.variables)
        return {v.name: (v.min, v.max) for v in variables} | self._limits(("bounds",), self.study.bounds)

    @independent
    def _own_bounds(self) -> dict[str, Limits]:
        return {
            name: self._limits(("controllers", name, "bounds"), section.bounds)
            for name, section in self.study.controllers.items()
        }

    @independent
    def _scenario_bounds(self, name: str) -> Limits:
        return self._limits(("scenarios", name, "bounds"), self.study.scenarios[name].bounds)

    def _limits(self, place: Place, bounds: Mapping[str, BoundsSection]) -> Limits:
        """Return the limits of a table in the variables' own units; a side left out is the plant's."""
        known = (*self.inputs.names, *self.outputs.names)
        self.errors.require_known(place, "input or controlled output", bounds, known)
        variables = {**self.variables.outputs, **self.variables.inputs}
        limits = Limits()
        for name in self.signals.converters(place, bounds, variables):
            pair = self._limits_of((*place, name), bounds[name], variables[name])
            limits |= {} if pair is None else {name: pair}
        return limits

    @independent
    def _limits_of(
        self, place: Place, section: BoundsSection, variable: Variable
    ) -> tuple[Limit, Limit] | None:
        """Return the limits of one signal in its own unit, of which the lower is always below the upper."""
        sides = {"min": (section.min, variable.min), "max": (section.max, variable.max)}
        limits = list[Limit]()
        for key, (level, of_plant) in sides.items():
            signal = level
            if level is not None:
                signal = self.signals.level((*place, key), level, variable, section.unit, (*place, "unit"))
                if signal is None:
                    return None
                check_reach(self.signals, (*place, key), level, *self.signals.span_at(place))
                signal = signal if isinstance(level, Reference) else float(signal.at(np.zeros(1))[0])
            limits.append(of_plant if signal is None else signal)
        low, high = limits
        if not (isinstance(low, Reference) or isinstance(high, Reference)):
            if limits_error((low, high)) and place not in self.errors.found:
                room = f"leaves no room: [{low:g}, {high:g}] with the plant's own limits"
                self.errors.add(place, room, place)
            return low, high
        time = self._times()
        below, above = (
            limit.at(time) if isinstance(limit, Reference) else np.full(len(time), limit)
            for limit in (low, high)
        )
        self._check_order(place, ("min", "max"), (below, above), unit_shown(variable, section.unit))
        return low, high

    @independent
    def _excitation(self) -> Excitation | None:
        """Return the experiment on all inputs, in their units."""
        recording, place = self.study.recording, (*_RECORDING, "excitation")
        if recording is None or recording.file:
            return None
        self.signals.require_each(place, "input", recording.excitation, self.inputs)
        return self.signals.experiment(recording, place)
