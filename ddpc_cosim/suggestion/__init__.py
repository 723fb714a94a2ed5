"""A study for a supplied FMU: signals chosen, limits, sampling time and setpoints from a step test."""

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ddpc_cosim.description import PlantDescription, default_signals
from ddpc_cosim.errors import ConfigError, CosimError, FMUImportError
from ddpc_cosim.fmu.co_simulation import StepSizes
from ddpc_cosim.fmu.description import choose_interface, describe_plant
from ddpc_cosim.fmu.description.defects import Severity
from ddpc_cosim.fmu.library import compile_ahead
from ddpc_cosim.fmu.plant import FMUPlant
from ddpc_cosim.fmu.resources import Resources
from ddpc_cosim.inspection import inspect_fmu
from ddpc_cosim.inspection.words import listed
from ddpc_cosim.processes.sandbox import demanded
from ddpc_cosim.signals.signals import Reference
from ddpc_cosim.study.file_format.sections import (
    BoundsSection,
    ControllerSection,
    LoopSection,
    PlantSection,
    Study,
)
from ddpc_cosim.suggestion import design
from ddpc_cosim.suggestion.acting import Acting
from ddpc_cosim.suggestion.buildings import Building, as_proposed, in_use, shortened
from ddpc_cosim.suggestion.choice import MOST_OUTPUTS, Choice
from ddpc_cosim.suggestion.design import ScaledGains, recording_length, suggested_controllers
from ddpc_cosim.suggestion.joining import Joined, join
from ddpc_cosim.suggestion.logs import SUFFIXES, LoggedSystem
from ddpc_cosim.suggestion.operating_point import TestedPlant, TriedPoint, find, sampling_time_of
from ddpc_cosim.suggestion.pace import monotonic
from ddpc_cosim.suggestion.quantities import plausible_outputs
from ddpc_cosim.suggestion.request import Request
from ddpc_cosim.suggestion.response_types import ResponseType
from ddpc_cosim.suggestion.roles import (
    MOST_SUSPECTS,
    Roles,
    controller_words,
    order_of_inputs,
    order_of_outputs,
    roles_of,
)
from ddpc_cosim.suggestion.step_test import StepTest, Timing
from ddpc_cosim.suggestion.systems import System
from ddpc_cosim.suggestion.trial import Tell, tried_once, tried_out
from ddpc_cosim.suggestion.values import AskedRange, OperatingPoint, operating_point, with_own_units
from ddpc_cosim.suggestion.writing import Circumstances, Proposal, comments, hints, study_text
from ddpc_cosim.variables import FloatArray, Variable

_MOST_INPUT_CANDIDATES, _MOST_OUTPUT_CANDIDATES = 12, 50
_MOST_LISTED = 12
_STEP_TEST = 0.5  # of the time for all
_SAMPLES = 200
_SAMPLES_PER_LEVEL = 5  # of a disturbance in the experiment
# Blocks of 24 samples, each twice as long as the one before: twelve of them have about 10^5 first steps.
_BLOCKS, _BLOCKS_OF_FIXED_STEPS = 12, 8
_FIRST_STEPS = 24 * (2**_BLOCKS - 1)
# Where the FMU gives no stop time: from a tenth of a millisecond to a day [s].
_FIRST_STEP, _LONGEST = 1e-4, 1e5
_BEYOND = 1e6  # s: days, as a house needs them
# Where steps must be equal and the FMU does not say of what size.
_STEPS, _STEP = 500, 1e-2
_LONGEST_IN_STOP_TIMES = 10.0


def suggest_study(
    path: str | Path | Sequence[str | Path],
    *,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    disturbances: Sequence[str] = (),
    at: OperatingPoint | None = None,
    ranges: Mapping[str, AskedRange] | None = None,
    sampling_time: float | None = None,
    duration: float | None = None,
    step_timeout: float = 60.0,
    budget: float = 60.0,
    trial: bool = True,
    tell: Tell = lambda _: None,
    sandbox: bool = False,
    library_path: Sequence[str | Path] = (),
) -> Proposal:
    """Run a step test of an FMU in a process of its own, suggest a study, and try it out.

    Parameters
    ----------
    path : str or Path, or a sequence of them
        The FMU, or an SSP archive; several FMUs become a coupled plant, whose connections are proposed. Or
        logs, CSV or Parquet files, from which the plant is identified.
    inputs, outputs : sequence of str, optional
        Signals to use; default: those that the step test shows to be of use, of logs what they are called.
    disturbances : sequence of str
        Signals of logs that act on the plant and that no controller drives.
    at : mapping of str to number or str, path, or several of them, optional
        The operating point: levels of inputs, parameters and start values, by name, with or without a unit
        (``"20 degC"``), or a file of them; default: the FMU's own.
    ranges : mapping of str to (float, float) or str, optional
        Of inputs: how far they may go; of outputs: between what values their setpoints are; in another unit
        as a text, ``"20:24 degC"``.
    sampling_time, duration : float, optional
        Of the loop [s]; default: what the step test shows.
    step_timeout : float
        Seconds that one call of the FMU may take.
    budget : float
        Seconds of computing that all of it may take: up to half of them for the step test, the rest for the
        trial. On the wall it may be five times as long, where others have the processors.
    trial : bool
        Whether to run each proposed controller once, to leave out those that fail, and to move setpoints to
        what can be reached.
    tell : callable
        Called with what is being done.
    sandbox : bool
        Whether that process is in a sandbox.
    library_path : sequence of str or Path
        Libraries that the FMU needs, and folders of such, as of :class:`FMUPlant`; of one FMU alone.

    Raises
    ------
    ConfigError
        Signals asked for, or any to drive or to control, are missing, or what is asked for is not allowed.
    CosimError
        It cannot be loaded, or does not run.
    """
    paths = [Path(path)] if isinstance(path, str | Path) else [Path(each) for each in path]
    path, label = paths[0], " + ".join(file.name for file in paths)
    if library_path and (len(paths) > 1 or path.suffix.lower() == ".ssp"):
        raise ConfigError(f"{label}: library_path is of one FMU, and this is a system of several")
    libraries = [str(Path(library).resolve()) for library in library_path]
    logs = _are_logs(paths)
    if disturbances and not logs:
        raise ConfigError(f"{label}: disturbances are named of logs; an FMU's are found by trying")
    joined = _joined(paths) if len(paths) > 1 and not logs else None
    system: System | LoggedSystem | None
    with demanded(sandbox):
        if logs:
            system = LoggedSystem.of(paths, inputs, outputs, disturbances, sampling_time)
        else:
            system = System(joined.section, joined.experiment) if joined else _archive(path)
        for file in system.files if system else (path,):
            compile_ahead(file, tell)
    deadline = monotonic() + budget
    tell(f"reading {label}")
    title = joined.title if joined else path.stem
    steps, building, zones = None, None, list[str]()
    if system:
        description = system.description
    else:
        description, steps, title, resources = _runnable(path, libraries)
        building = Building.of(resources, description)
        zones = list(building.zones) if building else Building(resources, description).temperatures
    levels, spans, faults = with_own_units(description, operating_point(at or {}), ranges or {})
    request = Request(levels, spans, sampling_time, duration, inputs, outputs)
    request.check(description, label, steps, faults)
    if isinstance(system, LoggedSystem):
        request = system.request(request)
    roles = system.roles if isinstance(system, LoggedSystem) else _roles(description, request)
    driven, drives_too = _candidates(description, label, request, "input", roles)
    read, reads_too = _candidates(description, label, request, "output", roles)
    if zones and outputs is None:
        read, reads_too = zones, []
    share = _STEP_TEST / 2 if system else _STEP_TEST  # it may take a second one
    timing = replace(_timing(description, request), budget=share * budget)
    if building:
        timing = building.within_a_season(timing)
    tell(f"step test of {label}")
    overrides = {switch: 1.0 for name, switch in description.switches.items() if name in driven}

    def open_plant(start: Mapping[str, float], also: Sequence[str] = ()) -> TestedPlant:
        """Open the plant, whose inputs the study is to drive, at levels of its inputs; read others too."""
        return (system.open if system else partial(FMUPlant, path, isolated=True, library_path=libraries))(
            inputs=driven,
            outputs=[*dict.fromkeys([*read, *also])],
            start={**overrides, **start},
            step_timeout=min(step_timeout, timing.budget),
            sandbox=sandbox,
        )

    point = find(open_plant, description, request, timing, roles, try_reach=trial)
    if system and point.choice.inputs:
        sample = sampling_time_of(point.tested, point.choice, point.timing, point.request)
        if system.refine(open_plant, point, sample):
            tell(f"step test of {label}, whose parts exchange values every {system.exchange:g} s")
            point = find(open_plant, description, request, timing, roles, try_reach=trial)
    if not point.choice.inputs:
        ends = zip(point.inputs, point.rest, point.rest + point.tested.steps, strict=True)
        steps_tried = [f"{v.name} from {low:g} to {high:g}" for v, low, high in ends]
        # The others are named neither here nor elsewhere, as nothing is written.
        tried = listed([*steps_tried, *drives_too], len(steps_tried), "inputs")
        early = f"; a run ended early: {point.tested.fault}" if point.tested.fault else ""
        early += "; raise --budget" if point.tested.stopped else ""
        looks = "".join(f". {said}" for said in controller_words(title, (), (), point.tested))
        raise CosimError(
            f"{label}: no output responds to a step of an input (tried: {tried}); --range tries more, "
            f"--input other inputs, --at another operating point, --output other outputs{early}{looks}"
        )
    check_identified(label, point)
    if point.holds_nothing:
        outputs = ", ".join(point.outputs[j].name for j in point.choice.outputs)
        inputs = ", ".join(point.inputs[i].name for i in point.choice.inputs)
        raise CosimError(
            f"{label}: no setpoint can be proposed: held at other values, {inputs} took {outputs} nowhere "
            "else; --range or --at tries the inputs elsewhere, --input and --output other signals"
        )
    sample = sampling_time_of(point.tested, point.choice, point.timing, point.request)
    on_step = tuple[str, ...]()
    if building and sampling_time is None:
        sample, on_step = building.sampling_time(sample)
    plant = (
        system.section(sample) if system else PlantSection(fmu=str(path.resolve()), library_path=libraries)
    )
    plant = replace(plant, parameters={**request.parameters(description)})
    proposal = _propose(plant, point, sample, title, (drives_too, reads_too))
    if isinstance(system, LoggedSystem):
        proposal = system.learnt(proposal)
    if building:
        proposal = in_use(proposal, building, request, point.choice.time_scale)
    until = time.monotonic() + deadline - monotonic()
    if trial and building:
        proposal = as_proposed(tried_once(shortened(proposal), until, tell, sandboxed=sandbox), proposal)
    elif trial:
        proposal = tried_out(proposal, until, tell, sandboxed=sandbox)
    controller = controller_words(title, point.inputs, point.outputs, point.tested)
    of_system = (*(joined.remarks if joined else ()), *(system.remarks if system else ()))
    head = (
        *proposal.comments.get("head", ()),
        *on_step,
        *(() if system else controller),
        *point.remarks,
        *of_system,
    )
    reasons = joined.reasons if joined else ()
    return replace(proposal, comments={**proposal.comments, "head": head}, reasons=reasons)


def write_study(
    proposal: Proposal, fmu: str | Path | Sequence[str | Path], out: str | Path, *, replace: bool = False
) -> Path:
    """Write a suggested study, check it, and return its path.

    Parameters
    ----------
    proposal : Proposal
        The study.
    fmu : str or Path, or a sequence of them
        The FMU, or all of them; the file names them relative to its own folder where it can.
    out : str or Path
        The file.
    replace : bool
        Whether an existing file may be replaced.

    Raises
    ------
    ConfigError
        The file already exists.
    """
    from ddpc_cosim.study.reading import read_study

    out = Path(out)
    if out.exists() and not replace:
        raise ConfigError(f"{out}: already exists; choose another --out, or --force to replace it")
    out.parent.mkdir(parents=True, exist_ok=True)
    fmus = [fmu] if isinstance(fmu, str | Path) else fmu
    proposal = _beside(proposal, out.parent)
    text = study_text(proposal, *(_relative(Path(file), out.parent) for file in fmus))
    with out.open("w", encoding="utf-8", newline="\n") as file:
        file.write(text)
    read_study(str(out))
    return out


def _beside(proposal: Proposal, folder: Path) -> Proposal:
    """Return a proposal whose libraries are named relative to a folder."""
    plant = proposal.study.plant
    libraries = [_relative(Path(library), folder) for library in plant.library_path]
    return proposal.changed(plant=replace(plant, library_path=libraries))


def _relative(fmu: Path, folder: Path) -> str:
    try:
        return Path(os.path.relpath(fmu.resolve(), folder.resolve())).as_posix()
    except ValueError:  # another drive
        return fmu.resolve().as_posix()


def _archive(path: Path) -> System | None:
    is_archive = path.suffix.lower() == ".ssp"
    return System(PlantSection(ssp=str(path.resolve()))) if is_archive else None


def _are_logs(paths: Sequence[Path]) -> bool:
    """Whether files are logs; ConfigError: some are, others are not."""
    logs = [path.name for path in paths if path.suffix.lower() in SUFFIXES]
    if logs and len(logs) < len(paths):
        raise ConfigError(f"{', '.join(logs)}: a log is a plant by itself; give logs alone, or FMUs only")
    return bool(logs)


def _joined(paths: Sequence[Path]) -> Joined:
    """Return several FMUs as one plant."""
    if archives := [path.name for path in paths if path.suffix.lower() == ".ssp"]:
        raise ConfigError(f"{', '.join(archives)}: an SSP is a system by itself; give it alone, or FMUs only")
    runnable = [_runnable(path) for path in paths]
    titles = [one.title for one in runnable]
    return join(paths, [one.description for one in runnable], " and ".join(dict.fromkeys(titles)))


class _Runnable(NamedTuple):
    """An FMU that nothing is known to keep from running."""

    description: PlantDescription
    steps: StepSizes
    title: str
    resources: Resources


def _runnable(path: Path, libraries: Sequence[str] = ()) -> _Runnable:
    """Return what an FMU is; FMUImportError: why it cannot run."""
    inspection = inspect_fmu(path, library_path=libraries)
    if not inspection.can_run:
        errors = (str(defect) for defect in inspection.defects if defect.severity is Severity.ERROR)
        raise FMUImportError(f"{path.name}: {'; '.join(errors)}")
    declared = inspection.declared
    steps = StepSizes(declared, choose_interface(declared, "auto", path.name), path.name)
    title = declared.model_name.strip() or path.stem
    return _Runnable(describe_plant(declared, path.name, "auto"), steps, title, inspection.resources)


def _roles(description: PlantDescription, request: Request) -> Roles:
    """Return what inputs are for; what is asked for, by name or by a range, is driven."""
    roles = roles_of(description)
    wanted = {*(request.inputs or ()), *request.ranges}
    acting = {name: why for name, why in roles.disturbances.items() if name not in wanted}
    asked = [name for name in roles.disturbances if name in wanted]
    return replace(roles, driven=(*roles.driven, *asked), disturbances=acting)


def _candidates(
    description: PlantDescription, label: str, request: Request, causality: str, roles: Roles
) -> tuple[list[str], list[str]]:
    """Return the signals to try, and those that are left out because there are so many."""
    chosen = request.inputs if causality == "input" else request.outputs
    suspects = [name for name in roles.disturbances if causality == "input"]
    if chosen is not None:
        return [*chosen, *suspects[:MOST_SUSPECTS]], []
    signals = {signal.variable.name: signal.variable for signal in default_signals(description, causality)}
    if causality == "input":
        known = order_of_inputs(roles.driven, description.inputs)
    else:
        known = order_of_outputs([*signals.values()], [*description.switches])
    if not known:
        names = [signal.variable.name for signal in description.signals("local")]
        locals_ = listed(names, _MOST_LISTED, "local variables")
        hint = f"; local variables may serve, with --output: {locals_}" if locals_ else ""
        why = "drive; `simulate` runs it in open loop" if causality == "input" else f"control{hint}"
        what = "system" if label.lower().endswith(".ssp") else "FMU"
        raise ConfigError(
            f"{label}: the {what} has no {causality} that is a number: there is nothing to {why}"
        )
    known.sort(key=lambda name: name not in request.ranges)  # what is asked for comes first
    most = _MOST_INPUT_CANDIDATES if causality == "input" else _MOST_OUTPUT_CANDIDATES
    return known[:most] + suspects[:MOST_SUSPECTS], known[most:] + suspects[MOST_SUSPECTS:]


def _timing(description: PlantDescription, request: Request) -> Timing:
    experiment = description.default_experiment
    stop = (experiment.stop_time or 0.0) - (experiment.start_time or 0.0)
    longest = _LONGEST_IN_STOP_TIMES * stop if stop > 0.0 else _LONGEST
    if description.fixed_step or not description.variable_step:
        step = description.fixed_step or experiment.step_size or (stop / _STEPS if stop > 0.0 else _STEP)
        blocks, fixed = _BLOCKS_OF_FIXED_STEPS, True
    else:
        step, blocks, fixed = stop / _FIRST_STEPS if stop > 0.0 else _FIRST_STEP, _BLOCKS, False
    timing = Timing(step, fixed=fixed, blocks=blocks, longest=longest, beyond=_BEYOND)
    return replace(
        timing, guess=design.guessed_time_scale(request, stop, experiment.step_size) or timing.guess
    )


def _propose(
    plant: PlantSection,
    point: TriedPoint,
    sample: float,
    title: str,
    left_out: tuple[Sequence[str], Sequence[str]],
) -> Proposal:
    """Return a proposal for a plant, of which only the signals and their sizes are left open."""
    tested, choice, bounds, request = point.tested, point.choice, point.bounds, point.request
    inputs = tuple(point.inputs[i] for i in choice.inputs)
    outputs = tuple(point.outputs[j] for j in choice.outputs)
    measurements = outputs + _also_measured(point.outputs, outputs, tested)
    working = design.working_range(point.inputs, bounds).of(choice.inputs)
    unstable = any(response.is_unstable for row in tested.responses for response in row)
    limited, why = plausible_outputs(point.outputs, design.where_it_rests(tested), request.ranges)

    def steps_of(outputs: Sequence[Variable]) -> tuple[dict[str, Reference], float]:
        """Return the references within the limits of the outputs."""
        setpoints, duration = design.setpoints(tested, choice, outputs, working, sample, request, point.reach)
        # Of an unstable plant there is nothing else to ask for before it is stabilised.
        return design.near_rest(tested, choice, outputs, duration) if unstable else setpoints, duration

    references, duration = steps_of(limited)
    unlimited, _ = steps_of(point.outputs)
    implausible = [
        f"{name}: {why[name]}; --range {name}=LO:HI if it is meant to go further."
        for name in references
        if references[name] != unlimited[name]
    ]
    levels = zip(point.inputs, point.rest.tolist(), strict=True)
    moved = {variable.name: level for variable, level in levels if level != variable.start}
    nominal = _sizes(inputs, working.size) | _sizes(
        outputs, np.minimum(_output_sizes(choice, working), design.limits(tested, choice))
    )
    u_size = np.array([nominal[v.name] for v in inputs])
    y_size = np.array([nominal[v.name] for v in outputs])[:, np.newaxis]
    gains = ScaledGains(
        first=design.first_gains(tested, choice, sample) * u_size / y_size,
        lasting=choice.gains * u_size / y_size,
    )
    chosen = suggested_controllers(gains, may_record=not unstable)
    acting = Acting.of(point, design.clean(_SAMPLES_PER_LEVEL * sample))
    sizes = len(inputs) + len(acting.moving), len(outputs), len(measurements)
    needed = max(_recording_length(c, *sizes) for c in chosen.values())
    samples = design.whole_periods(max(_SAMPLES, 2 * needed), sample, tested.period.seconds)
    circumstances = Circumstances(
        point.inputs, point.outputs, tested, choice, sample, unstable, acting=frozenset(point.disturbances)
    )
    said = comments(circumstances, left_out, point.warnings)
    said["reference"] = (*said["reference"], *implausible, *_on_reach(point, working))
    plant = replace(
        plant,
        inputs=[v.name for v in inputs],
        outputs=[v.name for v in outputs],
        measurements=[v.name for v in measurements],
        start={**point.start, **moved},
        nominal=nominal,
    )
    excitation = {} if unstable else design.excitation(inputs, working, samples)
    study = Study(
        title=f"Control of {title}",
        plant=plant,
        loop=LoopSection(sampling_time=float(sample), duration=duration),
        reference=references,
        bounds={v.name: BoundsSection(min=bounds[v.name].low, max=bounds[v.name].high) for v in inputs},
        disturbances=acting.known,
        recording=acting.recorded(samples, excitation) if excitation else None,
        controllers=chosen,
    )
    return Proposal(
        study=study,
        inputs=inputs,
        outputs=outputs,
        measurements=measurements,
        origins={v.name: bounds[v.name].origin for v in inputs},
        comments=_both(said, acting.comments),
        hints=tuple(hints(circumstances, point.room)),
        gains=_settled_gains(tested, choice),
        rest=design.where_it_rests(tested)[list(choice.outputs)],
        asked=request,
    )


def _on_reach(point: TriedPoint, working: design.Range) -> Iterator[str]:
    """Tell which outputs went less far than gains say with inputs that were held."""
    if point.reach is None:
        return
    ways = design.reachable(point.choice.gains, working)
    for row, j in enumerate(point.choice.outputs):
        pairs = zip(ways, point.reach.less(ways), ("up", "down"), strict=True)
        sides = [
            f"{less[row]:.3g} {side} instead of {way[row]:.3g}"
            for way, less, side in pairs
            if less[row] < way[row]
        ]
        if sides:
            name = point.outputs[j].name
            yield f"{name}: held inputs take it less far than its gain says: {', '.join(sides)}."


def check_identified(label: str, point: TriedPoint) -> None:
    """Check that there is a gain for every output: controllers and setpoints are made from it.

    Raises
    ------
    CosimError
        An output that is asked for does not respond, or not in time.
    """
    rows = zip(point.choice.outputs, point.choice.gains, strict=True)
    unknown = [point.outputs[j].name for j, row in rows if not (row.any() and np.isfinite(row).all())]
    if unknown:
        what = f"{label}: no response of {', '.join(unknown)} to a step of an input"
        if point.tested.stopped or point.tested.fault:
            why = f" ({point.tested.fault})" if point.tested.fault else ""
            raise CosimError(f"{what} was identified in time{why}; raise --budget, or leave it out")
        raise CosimError(f"{what}; leave it out, or try more with --range or at another point with --at")


def _settled_gains(tested: StepTest, choice: Choice) -> FloatArray:
    """Return the gains, NaN of outputs that have responses that do not settle."""
    settles = {ResponseType.INSENSITIVE, ResponseType.SETTLED}
    known = [all(tested.responses[j][i].type in settles for i in choice.inputs) for j in choice.outputs]
    return np.where(np.array(known)[:, np.newaxis], choice.gains, np.nan)


def _both(
    comments: Mapping[str, tuple[str, ...]], more: Mapping[str, tuple[str, ...]]
) -> dict[str, tuple[str, ...]]:
    """Return comments by section, of two kinds."""
    return {**comments, **{section: (*comments.get(section, ()), *texts) for section, texts in more.items()}}


def _recording_length(controller: ControllerSection, *signals: int) -> int:
    try:
        return recording_length(controller, *signals)
    except ConfigError:  # the trial leaves it out, and says why
        return 0


def _also_measured(
    candidates: Sequence[Variable], outputs: Sequence[Variable], tested: StepTest
) -> tuple[Variable, ...]:
    """Return outputs that respond and are not controlled, as far as a controller may want to have them."""
    responding = (
        variable
        for variable, row in zip(candidates, tested.responses, strict=True)
        if variable not in outputs and any(r.type is not ResponseType.INSENSITIVE for r in row)
    )
    return tuple(responding)[:MOST_OUTPUTS]


def _output_sizes(choice: Choice, working: design.Range) -> FloatArray:
    up, down = design.reachable(choice.gains, working)
    sizes = np.maximum(up, down)
    # An output that the others leave no freedom is still as large as the inputs make it.
    spread: FloatArray = np.abs(choice.gains) @ working.size
    return np.where(sizes > 0.0, sizes, np.where(spread > 0.0, spread, 1.0))


def _sizes(variables: Sequence[Variable], sizes: FloatArray) -> dict[str, float]:
    return {
        v.name: design.rounded(size, size / 100) for v, size in zip(variables, sizes.tolist(), strict=True)
    }
