"""Where a plant is tried: at its start values, or elsewhere if it starts at 0 K or where products vanish."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from ddpc_cosim.description import Declarations, applied_output, switches_of
from ddpc_cosim.errors import CosimError
from ddpc_cosim.fmu.plant import FMUPlant
from ddpc_cosim.inspection.words import is_called_temperature, is_meter, is_reading
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.suggestion import design
from ddpc_cosim.suggestion.choice import Choice, choose
from ddpc_cosim.suggestion.design import Bounds, Range, Reach, reachable
from ddpc_cosim.suggestion.embedded import Embedded, embedded_control
from ddpc_cosim.suggestion.pace import monotonic
from ddpc_cosim.suggestion.periods import found_at_rest
from ddpc_cosim.suggestion.quantities import (
    in_kelvin,
    is_temperature,
    remarks_on,
    to_comfort,
    usual_levels,
)
from ddpc_cosim.suggestion.rates import with_rates
from ddpc_cosim.suggestion.request import Request
from ddpc_cosim.suggestion.response_types import Response, ResponseType
from ddpc_cosim.suggestion.roles import Roles, usual_range, without
from ddpc_cosim.suggestion.step_test import (
    Resting,
    StepTest,
    Timing,
    dependence_on_step_size,
    runs_with,
    step_test,
)
from ddpc_cosim.suggestion.systems import OpenSystem
from ddpc_cosim.variables import FloatArray, Variable

TestedPlant = FMUPlant | OpenSystem

_MATTERS = 1e-3  # of an output's level: what inputs that matter move it by
_BETTER = 9.0  # of ranges ten times as wide, whose ends stand on the first guess
_HALF = 0.5
_WIDER = (10.0, 100.0, 1000.0)  # than a range that is a guess
_INSIDE = 0.1  # of its range: how far from an end of it an input rests where a room is as it should be
_IMPLAUSIBLE = 1000.0
_DEPENDS = 0.05  # of what outputs move by: how far two step sizes may be apart
_BLOCKS = 8
_LEAST_TIME = 5.0  # s
_FOR_REACH = 0.2  # of the time for a step test
_TRUSTED = 0.5  # of what a step has moved an output by
_AT_AN_END = {ResponseType.SETTLED, ResponseType.INSENSITIVE}


@dataclass(frozen=True, slots=True)
class TriedPoint:
    """What has been found of a plant at an operating point."""

    inputs: tuple[Variable, ...]
    outputs: tuple[Variable, ...]
    warnings: tuple[str, ...]
    start: Mapping[str, float]
    bounds: dict[str, Bounds]
    rest: FloatArray
    room: FloatArray
    timing: Timing
    request: Request
    tested: StepTest
    choice: Choice
    remarks: tuple[str, ...] = ()
    reach: Reach | None = None
    disturbances: Mapping[str, str] = field(default_factory=dict)

    @property
    def lively(self) -> frozenset[str]:
        """The inputs that move an output, but for what looks like a disturbance."""
        columns = zip(self.inputs, zip(*self.tested.responses, strict=True), strict=True)
        return frozenset(
            variable.name
            for variable, column in columns
            if variable.name not in self.disturbances
            and any(r.type is not ResponseType.INSENSITIVE for r in column)
        )

    @property
    def influence(self) -> float:
        """How much the inputs matter: where only meters of power or cost answer, what is read does not."""
        if self.holds_nothing or (_reads_something(self.outputs) and _only_meters(self)):
            return 0.0
        shares = _influence(self.tested, self.choice, self.room, self.outputs)
        # What runs away from an input is not held, however far it is moved in parts of where it began.
        little = self.is_guessed and self.authority < 1.0
        return min(shares, _MATTERS) * self.authority if little else shares

    @property
    def is_guessed(self) -> bool:
        """Whether the ranges of all chosen inputs are guesses."""
        origins = (self.bounds[self.inputs[i].name].origin for i in self.choice.inputs)
        return all(origin.startswith("guessed") for origin in origins)

    @property
    def authority(self) -> float:
        """How far the inputs move the output over which they have least, in parts of its own motion."""
        moving = design.unsteady(self.tested)
        shares = (
            self.tested.authority(j, self.choice.inputs, self.room) / self.tested.drift(j)
            for j in self.choice.outputs
            if moving[j]
        )
        return min([*shares, 1.0])

    @property
    def holds_nothing(self) -> bool:
        """Whether every chosen output went back to where it rests, whatever the inputs were held at."""
        drifts = design.drifting(self.tested)
        if self.reach is None or any(drifts[j] for j in self.choice.outputs):
            return False
        peaks = [max(r.peak for r in self.tested.responses[j]) for j in self.choice.outputs]
        farthest = np.maximum(self.reach.up, self.reach.down)
        return bool(np.all(farthest <= _MATTERS * np.array(peaks)))


def find(
    open_plant: Callable[..., TestedPlant],
    description: Declarations,
    request: Request,
    timing: Timing,
    roles: Roles,
    *,
    try_reach: bool = False,
) -> TriedPoint:
    """Try the plant where it starts, and elsewhere if nothing happens there.

    Parameters
    ----------
    open_plant : callable
        Opens it; takes ``start``.
    description : Declarations
        What it says about itself.
    request, timing
        What is asked for, and what is known about time.
    roles : Roles
        What its inputs are for.
    try_reach : bool
        Whether to try how far the outputs go with the inputs that setpoints would need.

    Raises
    ------
    CosimError
        It does not run where it starts.
    """
    ends = monotonic() + timing.budget
    every = [signal.variable for signal in description.signals("input")]
    given = request.start(description)
    parameters = request.parameters(description)
    resting_at_0 = {v.name for v in every if v.start == 0.0}.difference(given).intersection(roles.driven)
    switches = {name: switch for name, switch in switches_of(description).items() if name in resting_at_0}
    applied = [output for name in switches if description.signal(output := applied_output(name)) is not None]
    embedded = embedded_control(open_plant, switches, parameters, timing, applied).within(every)
    usual = usual_levels(every, {**given, **embedded.levels}, request.ranges)
    remarks = [*remarks_on(usual, every), *_remarks_on_overrides(embedded.levels)]
    start = {**usual, **embedded.levels, **given}
    at_start = _at(open_plant, start, {}, parameters, request, timing, roles, try_reach)
    at_start = _held(at_start, embedded, open_plant, parameters, ends, roles, try_reach)
    at_start = _switched_on(at_start, open_plant, parameters, ends, roles, try_reach, given)
    best = replace(at_start, remarks=(*remarks, *at_start.remarks))
    warm = _comfortable(at_start, {*usual, *given})
    if warm and ends - monotonic() > _LEAST_TIME:
        listed = ", ".join(f"{name} = {level:g}" for name, level in warm.items())
        remark = f"At rest it is not as a room should be: tried at {listed}; --at moves it elsewhere"
        try:
            spared = replace(timing, budget=ends - monotonic())
            point = _at(
                open_plant,
                {**at_start.start, **warm},
                at_start.bounds,
                parameters,
                request,
                spared,
                roles,
                try_reach,
            )
        except CosimError:  # it does not run there
            point = at_start
        if point.choice.inputs and _uncomfortable(point) <= _HALF * _uncomfortable(at_start):
            return replace(point, remarks=(*remarks, remark, *point.remarks))
    half = _half_way(at_start.inputs, at_start.rest, at_start.room)
    # What rests elsewhere than at 0, or acts from outside, stays: it is what the plant's author had in mind.
    resting = zip((variable.name for variable in at_start.inputs), at_start.rest, strict=True)
    stays = {*usual, *given, *roles.disturbances, *(name for name, level in resting if level)}
    levels = {name: level for name, level in half.items() if name not in stays}
    attempts = [({**at_start.start, **levels}, at_start.bounds, _remark_on_levels(levels))]
    for factor in _WIDER:
        wider = _wider(at_start.inputs, at_start.bounds, factor)
        remark = _remark_on_ranges(at_start.bounds, wider, plausible=factor < _IMPLAUSIBLE)
        attempts.append((dict(at_start.start), wider, remark))
    for start, bounds, remark in attempts:
        left = ends - monotonic()
        is_wider = bounds is not at_start.bounds
        may_be_wider = not best.choice.inputs or _is_too_little_by_guess(best)
        if best.influence >= _MATTERS or left < _LEAST_TIME or (is_wider and not may_be_wider):
            break
        if not remark:
            continue
        try:
            point = _at(
                open_plant, start, bounds, parameters, request, replace(timing, budget=left), roles, try_reach
            )
        except CosimError:  # it does not run there
            continue
        if point.influence > min(_BETTER * best.influence, max(_MATTERS, best.influence)):
            best = replace(point, remarks=(*remarks, remark, *point.remarks))
    if best.choice.inputs or not roles.disturbances:
        return best
    return _driving_suspects(best, open_plant, parameters, ends, roles, try_reach)


def _held(
    point: TriedPoint,
    embedded: Embedded,
    open_plant: Callable[..., TestedPlant],
    parameters: Mapping[str, ParameterValue],
    ends: float,
    roles: Roles,
    try_reach: bool,
) -> TriedPoint:
    """Return the point with overrides where they hold what the plant's own control holds."""
    unknown = replace(embedded, overrides=tuple(n for n in embedded.overrides if n not in embedded.levels))
    y = design.where_it_rests(point.tested)
    levels = unknown.holding(point.inputs, point.rest, y, point.choice, point.bounds)
    left = max(ends - monotonic(), _LEAST_TIME)
    if not levels:
        return point
    start, timing = {**point.start, **levels}, replace(point.timing, budget=left)
    try:
        held = _at(open_plant, start, point.bounds, parameters, point.request, timing, roles, try_reach)
    except CosimError:  # it does not run there
        return point
    less_seen = held.tested.stopped and held.tested.time[-1] < point.tested.time[-1]
    if less_seen or len(held.lively) < len(point.lively):
        return point
    return replace(held, remarks=(*_remarks_on_overrides(levels), *held.remarks))


def _remarks_on_overrides(levels: Mapping[str, float]) -> list[str]:
    """Return what is said of overrides that rest where the plant's own control has them."""
    return [
        f"{name} starts at 0 and rests at {level:.4g} here, about what the plant's own control does; "
        f"--at {name}=LEVEL moves it"
        for name, level in levels.items()
    ]


def _driving_suspects(
    point: TriedPoint,
    open_plant: Callable[..., TestedPlant],
    parameters: Mapping[str, ParameterValue],
    ends: float,
    roles: Roles,
    try_reach: bool,
) -> TriedPoint:
    """Return the point with what looks like a disturbance driven, as nothing else does anything."""
    timing = replace(point.timing, budget=max(ends - monotonic(), _LEAST_TIME))
    everything = replace(roles, disturbances={})
    point = _at(
        open_plant, point.start, point.bounds, parameters, point.request, timing, everything, try_reach
    )
    driven = [point.inputs[i].name for i in point.choice.inputs if point.inputs[i].name in roles.disturbances]
    return replace(point, remarks=(*point.remarks, *_remark_on_suspects(driven, roles, "an output")))


def _switched_on(
    point: TriedPoint,
    open_plant: Callable[..., TestedPlant],
    parameters: Mapping[str, ParameterValue],
    ends: float,
    roles: Roles,
    try_reach: bool,
    given: Collection[str],
) -> TriedPoint:
    """Return the point with what switches the plant on at 1, if more inputs do something then."""
    levels = {name: level for name, level in roles.enabling.items() if name not in given}
    levels |= {name: 1.0 for name in roles.perhaps_enabling if name not in given}
    left = max(ends - monotonic(), _LEAST_TIME)
    driven = {variable.name for variable in point.inputs} - {*roles.disturbances, *levels}
    before = len(point.lively & driven)
    if not levels or before == len(driven):
        return point
    start, timing = {**point.start, **levels}, replace(point.timing, budget=left)
    switching = replace(roles, fixed=roles.perhaps_enabling)
    try:
        on = _at(open_plant, start, point.bounds, parameters, point.request, timing, switching, try_reach)
    except CosimError:  # it does not run so
        return point
    if len(on.lively & driven) <= before:
        return point
    said = ", ".join(f"{name} = {level:g}" for name, level in levels.items())
    remark = (
        f"{said}: switched on, as more of the inputs do something then; --at {next(iter(levels))}=0 if not"
    )
    return replace(on, remarks=(remark, *on.remarks))


def _at(
    open_plant: Callable[..., TestedPlant],
    start: Mapping[str, float],
    bounds: dict[str, Bounds],
    parameters: Mapping[str, ParameterValue],
    request: Request,
    timing: Timing,
    roles: Roles,
    try_reach: bool,
) -> TriedPoint:
    """Run a step test with inputs that start at these levels."""
    with open_plant(start=start) as plant:
        bounds = bounds or design.input_bounds(
            plant.inputs,
            _usual_ranges(plant.inputs, roles) | {**request.ranges},
            _parameters(plant.description, parameters),
        )
        rest, room = design.rest_and_room(plant.inputs, bounds)
        resting = Resting(rest, room, parameters)
        tested = step_test(plant, resting, timing)
        choice, remarks = _chosen(plant, tested, room, timing, request, roles)
        if choice.inputs:
            sample = sampling_time_of(tested, choice, timing, request)
            share = dependence_on_step_size(plant, resting, tested, sample)
            if share > _DEPENDS:
                remarks += (
                    f"The FMU's result depends on the communication step size: with {sample:g} s and with "
                    f"{sample / 2:g} s its outputs differ by {share:.0%} of what they move by. What is said "
                    f"here holds for steps of {sample:g} s; --sampling-time H for others",
                )
                request = replace(request, sampling_time=sample)
                timing = replace(timing, step=sample, fixed=True, blocks=_BLOCKS)
                tested = step_test(plant, resting, timing)
                choice, _ = _chosen(plant, tested, room, timing, request, roles)
        reach, fixed_step = None, timing.step if timing.fixed else None
        tested = with_rates(plant, resting, tested, fixed_step)
        if tested.rates:
            choice, _ = _chosen(plant, tested, room, timing, request, roles)
        driven = {plant.inputs[i].name for i in choice.inputs}
        if choice.inputs:
            unstable = any(response.is_unstable for row in tested.responses for response in row)
            swings = {} if unstable else design.swings(tested, choice.outputs)
            if swings:
                seconds = _FOR_REACH * timing.budget
                period = found_at_rest(plant, rest, parameters, swings, fixed_step, seconds)
                tested = replace(tested, period=period)
        if choice.inputs and try_reach:
            working = design.working_range(plant.inputs, bounds).of(choice.inputs)
            spared = replace(timing, budget=_FOR_REACH * timing.budget)
            reach = _tried_reach(plant, resting, tested, choice, working, spared)
        return TriedPoint(
            plant.inputs,
            plant.outputs,
            plant.warnings,
            start,
            bounds,
            rest,
            room,
            timing,
            request,
            tested,
            choice,
            remarks,
            reach,
            {name: why for name, why in roles.disturbances.items() if name not in driven},
        )


def _tried_reach(
    plant: Plant, resting: Resting, tested: StepTest, choice: Choice, working: Range, timing: Timing
) -> Reach:
    """Hold the inputs at what setpoints need, one run for each, and return how far the outputs go.

    Outputs that settle count where they end, others where they are after the time scale, less what they do by
    themselves. What the step test itself has reached counts where a run says less.

    Parameters
    ----------
    plant : Plant
        The plant; it is reset for every run.
    resting : Resting
        The inputs at rest.
    tested : StepTest
        What is known of the plant.
    choice : Choice
        The signals.
    working : Range
        Of the chosen inputs.
    timing : Timing
        How steps are, and for how long this may take.
    """
    reach = Reach.unknown(len(choice.outputs))
    if tested.stopped or any(response.is_unstable for row in tested.responses for response in row):
        return reach
    inverse, chosen = np.linalg.pinv(choice.gains), list(choice.inputs)
    ways = zip((1.0, -1.0), reachable(choice.gains, working), (reach.up, reach.down), strict=True)
    tries = [(row, sign, way[row], side) for sign, way, side in ways for row in range(len(way))]
    held = np.tile(resting.u, (len(tries), 1))
    for u, (row, sign, way, _) in zip(held, tries, strict=True):
        u[chosen] += sign * way * inverse[:, row]
    for y, (row, sign, _, side) in zip(runs_with(plant, resting, tested, held, timing), tries, strict=True):
        if y is None:
            continue
        j = choice.outputs[row]
        responses = [tested.responses[j][i] for i in chosen]
        settles = all(response.type in _AT_AN_END for response in responses)
        end = -1 if settles else min(int(np.searchsorted(tested.time, choice.time_scale)), len(y) - 1)
        change = sign * (y[end, j] - tested.rest[end, j]) if len(y) == len(tested.rest) else 0.0
        shown = [_TRUSTED * sign * response.effect for response in responses if settles]
        side[row] = max(change, *shown, 0.0)
    return reach


def _usual_ranges(inputs: Iterable[Variable], roles: Roles) -> dict[str, tuple[float, float]]:
    """Return between what values disturbances lie, as far as their units tell."""
    acting = (variable for variable in inputs if variable.name in roles.disturbances)
    return {v.name: limits for v in acting if (limits := usual_range(v)) is not None}


def _chosen(
    plant: TestedPlant,
    tested: StepTest,
    room: FloatArray,
    timing: Timing,
    request: Request,
    roles: Roles,
) -> tuple[Choice, tuple[str, ...]]:
    """Return the choice among inputs that are not suspects, or moves an output that nothing else moves.

    What is spent, and what only tells what an override is, has no setpoint as long as another output can be
    controlled, or may show only later that it can.
    """
    inputs, outputs, overridden = plant.inputs, plant.outputs, switches_of(plant.description)
    overrides = [i for i, variable in enumerate(inputs) if variable.name in overridden]
    echoes = {applied_output(name) for name in overridden}
    echoes |= {output.name for j, output in enumerate(outputs) if _is_echo(tested, j, overrides)}
    meters = [j for j, output in enumerate(outputs) if is_meter(output) or output.name in echoes]
    suspects = [i for i, variable in enumerate(inputs) if variable.name in roles.disturbances]
    handles = [i for i in range(len(inputs)) if i not in suspects]
    alone = [i for i in suspects if inputs[i].name in roles.doubtful and _moves_alone(tested, i, handles)]
    suspects = [i for i in suspects if i not in alone]
    fixed = [i for i, variable in enumerate(inputs) if variable.name in roles.fixed]
    responses, less_room = without(tested, room, [*suspects, *fixed])
    all_outputs = request.outputs is not None
    unmetered = tuple(
        tuple(Response(ResponseType.INSENSITIVE) for _ in row) if j in meters else row
        for j, row in enumerate(responses)
    )
    unseen = tested.stopped and _reads_something(outputs)  # what is read may answer later than meters
    for shown in (responses,) if all_outputs else (unmetered,) if unseen else (unmetered, responses):
        choice = choose(replace(tested, responses=shown), less_room, timing.guess, all_outputs=all_outputs)
        if choice.inputs:
            break
    driven = [inputs[i].name for i in alone if i in choice.inputs]
    return choice, _remark_on_suspects(driven, roles, "an output that it moves")


def _remark_on_suspects(driven: Sequence[str], roles: Roles, what: str) -> tuple[str, ...]:
    whys = ", ".join(f"{name} ({roles.disturbances[name]})" for name in driven)
    said = f"Driven though it may be a disturbance, as nothing else moves {what}: {whys}"
    return (said,) if driven else ()


def _is_echo(tested: StepTest, output: int, overrides: Sequence[int]) -> bool:
    """Whether an output follows an override at once and answers to nothing else: a command, or its power."""
    row = tested.responses[output]
    moving = [i for i, response in enumerate(row) if response.type is not ResponseType.INSENSITIVE]
    return len(moving) == 1 and moving[0] in overrides and tested.is_immediate(row[moving[0]])


def _moves_alone(tested: StepTest, suspect: int, handles: Sequence[int]) -> bool:
    """Whether an output takes its time to answer to an input, and to nothing that may be driven."""
    still = ResponseType.INSENSITIVE
    return any(
        row[suspect].type is not still
        and not tested.is_immediate(row[suspect])
        and all(row[i].type is still for i in handles)
        for row in tested.responses
    )


def _parameters(description: Declarations, given: Mapping[str, ParameterValue]) -> Iterator[Variable]:
    """Yield the real parameters, with the values that they have in the study."""
    for signal in description.signals("parameter"):
        variable = signal.variable
        if signal.source.values == "real" and signal.source.start_text is not None:
            value = given.get(variable.name, variable.start)
            yield variable if isinstance(value, str) else replace(variable, start=value)


def sampling_time_of(tested: StepTest, choice: Choice, timing: Timing, request: Request) -> float:
    """Return the sampling time that is asked for, else the one that fits the plant [s]."""
    fixed_step = timing.step if timing.fixed else None
    return request.sampling_time or design.sampling_time(tested, choice, fixed_step, request.duration)


def _remark_on_levels(levels: Mapping[str, float]) -> str:
    listed = ", ".join(f"{name} = {level:g}" for name, level in levels.items())
    what = "Where the plant starts its inputs do next to nothing: tried at"
    return f"{what} {listed}; --at moves it elsewhere" if listed else ""


def _wider(inputs: Iterable[Variable], bounds: Mapping[str, Bounds], factor: float) -> dict[str, Bounds]:
    """Return the bounds, those that are guesses so many times wider, within declared limits."""
    wider = dict(bounds)
    for variable in inputs:
        guess = bounds[variable.name]
        if guess.origin.startswith("guessed"):
            size = factor * (guess.high - guess.low) / 2
            low, high = max(variable.min, guess.low - size), min(variable.max, guess.high + size)
            wider[variable.name] = Bounds(low, high, "guessed: within less the inputs do too little")
    return wider


def _comfortable(point: TriedPoint, given: Collection[str]) -> dict[str, float]:
    """Return levels of inputs at which rooms that rest too cold or too hot should be as rooms are, if any."""
    choice, tested = point.choice, point.tested
    if not choice.inputs or {point.inputs[i].name for i in choice.inputs} & {*given}:
        return {}
    responses = [tested.responses[j][i] for j in choice.outputs for i in choice.inputs]
    if any(r.type not in (ResponseType.SETTLED, ResponseType.INSENSITIVE) for r in responses):
        return {}
    missing = _missing_to_comfort(point)
    if not missing.any():
        return {}
    u = point.rest[list(choice.inputs)] + np.linalg.pinv(choice.gains) @ missing
    levels = dict(zip([point.inputs[i].name for i in choice.inputs], u.tolist(), strict=True))
    ends = {name: point.bounds[name] for name in levels}
    margins = {name: _INSIDE * (end.high - end.low) for name, end in ends.items()}
    inside = {
        name: float(f"{np.clip(u, ends[name].low + margins[name], ends[name].high - margins[name]):.4g}")
        for name, u in levels.items()
    }
    return {name: level for name, level in inside.items() if level != point.rest[_position(point, name)]}


def _missing_to_comfort(point: TriedPoint) -> FloatArray:
    """Return how much each chosen output misses to be as a room should be, where it rests, shape (p,)."""
    rest, chosen = design.where_it_rests(point.tested), point.choice.outputs
    return np.array([to_comfort(point.outputs[j], float(rest[j])) for j in chosen])


def _uncomfortable(point: TriedPoint) -> float:
    """Return how far rooms are from how they should be, all of them together."""
    return float(np.abs(_missing_to_comfort(point)).sum())


def _position(point: TriedPoint, name: str) -> int:
    return [variable.name for variable in point.inputs].index(name)


def _is_too_little_by_guess(point: TriedPoint) -> bool:
    """Return whether a wider range may do where all that are driven are guesses.

    One watt heats no house, whatever a meter shows of it; what drifts by itself or returns is not held.
    """
    if not point.is_guessed:
        return False
    if point.authority < 1.0 or point.holds_nothing:
        return True
    outputs = [point.outputs[j] for j in point.choice.outputs]
    warm = all(is_temperature(output) or is_called_temperature(output) for output in outputs)
    return warm or (_reads_something(point.outputs) and _only_meters(point))


def _reads_something(outputs: Iterable[Variable]) -> bool:
    return any(is_reading(output) for output in outputs)


def _only_meters(point: TriedPoint) -> bool:
    return all(is_meter(point.outputs[j]) for j in point.choice.outputs)


def _remark_on_ranges(bounds: Mapping[str, Bounds], wider: Mapping[str, Bounds], *, plausible: bool) -> str:
    changed = [f"{name} {w.low:g}:{w.high:g}" for name, w in wider.items() if w != bounds[name]]
    what = "Within the ranges that were guessed first the inputs do too little: tried"
    doubt = "--range NAME=LO:HI if that is too far"
    if not plausible:
        doubt = f"that is not plausible, a thousand times the first guess: {doubt.replace('if', 'where')}"
    return f"{what} {', '.join(changed)}; {doubt}" if changed else ""


def _half_way(inputs: Iterable[Variable], rest: FloatArray, room: FloatArray) -> dict[str, float]:
    """Return levels of inputs that rest at 0, half way to the ends of their ranges, by name."""
    levels = zip(inputs, rest.tolist(), (rest + _HALF * room).tolist(), strict=True)
    return {variable.name: level for variable, at_rest, level in levels if at_rest == 0.0}


def _influence(tested: StepTest, choice: Choice, room: FloatArray, outputs: Sequence[Variable]) -> float:
    """Return what the inputs move the output by that they move most, in parts of its level (above 0 K)."""
    reach = np.abs(choice.gains) @ np.abs(room[list(choice.inputs)])
    rest = design.where_it_rests(tested)  # not where it drifts to
    levels = [abs(in_kelvin(outputs[j], float(rest[j]))) for j in choice.outputs]
    shares = [r / max(level, r) for r, level in zip(reach, levels, strict=True) if r > 0.0]
    return float(max(chain(shares, [0.0])))
