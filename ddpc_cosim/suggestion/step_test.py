"""Steps of a plant's inputs, one by one, from where it rests: for as long and as closely as it takes."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from ddpc_cosim.errors import ConfigError, CosimError, FMUStepError, StepStatus
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.suggestion.pace import monotonic
from ddpc_cosim.suggestion.periods import Period
from ddpc_cosim.suggestion.response_types import (
    BLOCK,
    FLOOR,
    Response,
    ResponseType,
    classify,
    escaping,
    limited_slope,
    sample_counts,
)
from ddpc_cosim.variables import FloatArray

_BLOCKS_MORE, _BLOCKS_MOST = 4, 40
# A response that is still on a line or a parabola may be the beginning of a slower one.
_UNCLEAR = {ResponseType.OSCILLATING, ResponseType.INTEGRATING, ResponseType.ACCELERATING}
_FASTER, _TIMES_FASTER = 2**10, 3
_MOST_STEPS = 100_000
SHARE = 0.1
"""Part of its room by which an input is stepped first."""
_LARGER_SHARES, _SMALLER_SHARE = (0.5, 1.0), 0.001
_NONLINEAR = 0.3
_OF_A_SOLVER = 1e-3  # of an output's level: what tolerances of solvers may leave
_LATER = 1.5
_ALIKE = 0.1  # of its peak: how far responses to a switch may be apart
_BEYOND = 1e30
_IMMEDIATE = 3  # samples
_ROUNDING = 1e-9
_STEPS_TIMED = 3
_STEPS_COMPARED = 40
_STOPPED = 2.0  # of what an output has reached: how far its slope would have taken it
_PART_FOR_LONGER = 0.5  # of the time that is left
_PART_BEYOND, _BLOCKS_BEYOND = 0.1, 14
_LONG_STEP = 0.1  # s of computing


@dataclass(frozen=True, slots=True)
class Resting:
    """Where the inputs rest, and how far they may go from there.

    Parameters
    ----------
    u : array, shape (m,)
        Inputs at rest.
    room : array, shape (m,)
        Signed: how far each may go in the direction in which there is more room.
    parameters : mapping of str to number or str
        What differs from the plant's defaults.
    """

    u: FloatArray
    room: FloatArray
    parameters: Mapping[str, ParameterValue] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Timing:
    """What is known beforehand about time.

    Parameters
    ----------
    step : float
        Communication step size of the first block [s].
    longest : float
        Where to stop looking for responses [s].
    beyond : float
        For how long what seems to integrate for as long as that is looked at once more [s]: a tool's default
        experiment of one second says nothing of a house.
    fixed : bool
        Whether all communication steps must have this size.
    blocks : int
        How many blocks the first runs have.
    budget : float
        Seconds of computing time after which no longer runs are tried.
    guess : float
        How long the plant takes to get where it goes, as far as its responses do not tell [s].
    """

    step: float
    longest: float
    fixed: bool = False
    blocks: int = 12
    budget: float = 30.0
    guess: float = 10.0
    beyond: float = 0.0


@dataclass(frozen=True)
class StepTest:
    """The result of a step test.

    The response of an output that leaves its equilibrium by itself is that to a very small step, scaled up.

    Parameters
    ----------
    time : array, shape (n,)
        Sample times after the steps [s].
    rest : array, shape (n, p)
        Outputs while all inputs rest.
    steps : array, shape (m,)
        Heights of the steps.
    responses : tuple of tuple of Response
        By output, then by input.
    fault : str
        Why a run ended early; empty if none did.
    fails_at_rest : bool
        Whether it is the plant that ended the run at rest.
    stopped : bool
        Whether computing time ran out before every response had shown its type.
    static : bool
        Whether the outputs follow the inputs at once, however closely one looks.
    unstable : frozenset of int
        Outputs whose response does not shrink with the step.
    switched : frozenset of (int, int)
        Outputs and inputs whose response is as soon there and as large after a thousandth of the step.
    resolution : float
        What happens within this time cannot be distinguished from what happens at once [s].
    period : Period
        In what outputs do while the inputs rest.
    rates : frozenset of int
        Unstable outputs that are the derivatives of others.
    """

    time: FloatArray
    rest: FloatArray
    steps: FloatArray
    responses: tuple[tuple[Response, ...], ...]
    fault: str = ""
    fails_at_rest: bool = False
    stopped: bool = False
    static: bool = False
    unstable: frozenset[int] = field(default_factory=frozenset)
    switched: frozenset[tuple[int, int]] = field(default_factory=frozenset)
    resolution: float = 0.0
    period: Period = field(default_factory=Period)
    rates: frozenset[int] = field(default_factory=frozenset)

    def is_immediate(self, response: Response) -> bool:
        """Whether a response is over within the first samples: direct feedthrough, as far as one sees."""
        return response.settling_time <= self.resolution

    def authority(self, output: int, inputs: Iterable[int], room: FloatArray) -> float:
        """Return by how much the inputs move an output within their room, going by its responses."""
        row = self.responses[output]
        return float(sum(abs(row[i].peak / self.steps[i] * room[i]) for i in inputs))

    def own_limit(self, output: int) -> float:
        """Return where an output stops that integrates until then; infinity if it does not stop."""
        integrating = [r for r in self.responses[output] if r.type is ResponseType.INTEGRATING]
        stopped = [r.peak for r in integrating if abs(r.slope) * self.time[-1] > _STOPPED * r.peak]
        return min(stopped, default=math.inf)

    def drift(self, output: int) -> float:
        """Return by how much an output moves while the inputs rest."""
        return float(np.ptp(self.rest[:, output]))


def step_test(plant: Plant, resting: Resting, timing: Timing) -> StepTest:
    """Step each input by a tenth of its room, by more of it where that does nothing.

    Parameters
    ----------
    plant : Plant
        The plant; it is reset for every run.
    resting : Resting
        The inputs at rest and their room.
    timing : Timing
        What is known about time.

    Raises
    ------
    CosimError
        The plant cannot be initialised, or does not survive its first steps at rest.
    """
    deadline = monotonic() + timing.budget
    paced = _Paced(plant, deadline)
    timing = _for_its_speed(paced, resting, timing)
    tested = _at_time_scale(paced, resting, SHARE * resting.room, timing)
    larger, fault = _with_larger_steps(paced, resting, tested, timing)
    if larger is not tested and not any(_responds(tested)) and paced.may_repeat:
        larger = _at_time_scale(paced, resting, larger.steps, timing)
    result = _with_instabilities(paced, resting, larger, timing)
    return replace(result, fault=result.fault or fault)


def dependence_on_step_size(plant: Plant, resting: Resting, tested: StepTest, step: float) -> float:
    """Return by what part of their movement outputs differ when communication steps are halved.

    Parameters
    ----------
    plant : Plant
        The plant; it is reset for every run.
    resting, tested
        Its operating point, and the steps that it responds to.
    step : float
        The longer one [s].

    Returns
    -------
    share : float
        Of the output that differs most; 0 where half the step size is not possible, or for an unstable plant.
    """
    unstable = any(response.is_unstable for row in tested.responses for response in row)
    if tested.fault or unstable or tested.unstable:
        return 0.0
    u = resting.u + tested.steps
    results = []
    for substeps in (1, 2):
        try:
            plant.plan(step / substeps, _STEPS_COMPARED * step)
            rows = [plant.reset(resting.parameters)]
            rows += [plant.step(u, step / substeps) for _ in range(_STEPS_COMPARED * substeps)]
        except (ConfigError, FMUStepError):
            return 0.0
        results.append(np.array(rows)[::substeps])
    whole, halves = results
    difference = np.max(np.abs(whole - halves), axis=0)
    movement = np.maximum(np.ptp(whole, axis=0), np.ptp(halves, axis=0))
    level = np.max(np.abs(halves), axis=0)
    counts = movement > FLOOR * level
    return float(np.max(difference[counts] / movement[counts], initial=0.0))


def runs_with(
    plant: Plant, resting: Resting, tested: StepTest, inputs: FloatArray, timing: Timing
) -> Iterator[FloatArray | None]:
    """Yield the outputs while inputs are held, one run for each row, at the times of a step test.

    Parameters
    ----------
    plant : Plant
        The plant; it is reset for every run.
    resting, tested
        Its operating point, and the step test.
    inputs : array, shape (runs, m)
        The inputs.
    timing : Timing
        How steps are, and for how long all runs may take.

    Yields
    ------
    y : array, shape (n, p), or None
        Fewer rows than the step test at rest has where the plant fails; None: there was no time for it.
    """
    paced = _Paced(plant, monotonic() + timing.budget)
    grid = _Grid(float(tested.time[0]), len(tested.time) // BLOCK, timing.fixed)
    for k, u in enumerate(inputs):
        paced.share(len(inputs) - k, 1.0)
        y, _ = grid.run(paced, u, resting.parameters)
        yield None if paced.ran_out else y[: len(tested.rest)]


class _NotInTimeError(CosimError):
    """A run was over before its first block of samples, for want of time."""


class _Paced(Plant):
    """A plant whose runs share the time that there is: a run that takes longer ends early, with a fault."""

    def __init__(self, plant: Plant, deadline: float) -> None:
        self._plant, self._deadline, self._until, self._took = plant, deadline, deadline, 0.0
        self.ran_out = False
        self.inputs, self.outputs = plant.inputs, plant.outputs

    @property
    def left(self) -> float:
        """Seconds that are left."""
        return self._deadline - monotonic()

    @property
    def may_repeat(self) -> bool:
        """Whether there is time for as many and as long runs as the last ones."""
        return self.left > self._took

    def extend(self, seconds: float) -> None:
        """Give all runs more time."""
        self._deadline += seconds

    def share(self, runs: int, part: float) -> None:
        """Give the next run its share of a part of the time that is left for it and those after it."""
        self._until = monotonic() + part * self.left / runs

    def note(self, seconds: float) -> None:
        """Take note of how long a set of runs has taken."""
        self._took = seconds

    def plan(self, sampling_time: float, stop_time: float) -> None:
        """Announce the next run."""
        self._plant.plan(sampling_time, stop_time)

    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        """Go to the initial state."""
        return self._plant.reset(parameters, t0)

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold the inputs over h."""
        self.ran_out = monotonic() > self._until
        if self.ran_out:
            raise FMUStepError("the time for it was over", StepStatus.TIMED_OUT, math.nan)
        return self._plant.step(u, h)


def _for_its_speed(plant: _Paced, resting: Resting, timing: Timing) -> Timing:
    """Return the timing with as many samples as there is time for; they cover the same time.

    Raises
    ------
    CosimError
        There is not even time for one block of samples.
    """
    end = timing.step * BLOCK * 2.0**timing.blocks
    plant.plan(timing.step, end)
    plant.reset(resting.parameters)
    times = []
    for _ in range(_STEPS_TIMED):  # the first one may take longer than the others
        began = monotonic()
        plant.step(resting.u, timing.step)
        times.append(monotonic() - began)
    runs = 1 + len(resting.u)
    block = BLOCK * min(times) * runs
    count = 2.0**timing.blocks - 1 if timing.fixed else timing.blocks
    if block * count <= plant.left:
        return timing
    if block > plant.left:  # better no time for a trial than no proposal
        plant.extend(timing.budget)
    if block > plant.left:
        raise CosimError(
            f"one step of the plant takes {min(times):.2g} s, so a step test of {runs - 1} inputs takes "
            f"{block:.0f} s: choose fewer with --input, or raise --budget to {3 * block:.0f} s"
        )
    fitting = plant.left / block
    blocks = math.floor(math.log2(fitting + 1)) if timing.fixed else math.floor(fitting)
    step = timing.step if timing.fixed else end / (BLOCK * 2.0**blocks)
    return replace(timing, blocks=blocks, step=step)


def _responds(tested: StepTest) -> list[bool]:
    """Return for each input whether an output responds to it."""
    columns = zip(*tested.responses, strict=True)
    return [any(r.type is not ResponseType.INSENSITIVE for r in column) for column in columns]


def _with_larger_steps(
    plant: _Paced, resting: Resting, tested: StepTest, timing: Timing
) -> tuple[StepTest, str]:
    """Step the inputs further that do nothing: a relay, an integer or a boolean needs more than a tenth.

    Return also what ended one of these runs early.
    """
    fault = ""
    for share in _LARGER_SHARES:
        idle = ~np.array(_responds(tested))
        if tested.fault or not idle.any() or not plant.may_repeat:
            break
        steps = np.where(idle, share * resting.room, 0.0)
        grid = _Grid(float(tested.time[0]), len(tested.time) // BLOCK, timing.fixed)
        try:
            larger, _ = _run_all(plant, resting, steps, grid)
        except _NotInTimeError as error:
            return tested, str(error)
        rows = zip(tested.responses, larger.responses, strict=True)
        merged = tuple(
            tuple(new if still else old for old, new, still in zip(before, after, idle, strict=True))
            for before, after in rows
        )
        tested = replace(tested, steps=np.where(idle, steps, tested.steps), responses=merged)
        fault = fault or larger.fault
    return tested, fault


def _at_time_scale(plant: _Paced, resting: Resting, steps: FloatArray, timing: Timing) -> StepTest:
    """Run, with shorter first steps too where everything has happened in the first of them.

    What is immediate however closely one looks is static.
    """
    step = timing.step
    coarse = closest = _until_clear(plant, resting, steps, timing)
    for _ in range(_TIMES_FASTER):
        shown = [r for row in closest.responses for r in row if r.type is not ResponseType.INSENSITIVE]
        if not shown or not all(map(closest.is_immediate, shown)):
            return closest
        if timing.fixed or not plant.may_repeat:
            break
        step /= _FASTER
        try:
            closest, _ = _run_all(plant, resting, steps, _Grid(step, timing.blocks, fixed=False))
        except _NotInTimeError:
            break
    return replace(coarse, static=True)


def _until_clear(plant: _Paced, resting: Resting, steps: FloatArray, timing: Timing) -> StepTest:
    """Make runs longer until every response has shown its type, or time is up."""
    blocks = timing.blocks
    tested, _ = _run_all(plant, resting, steps, _Grid(timing.step, blocks, timing.fixed))
    if not any(_responds(tested)):  # larger steps cost less time than longer runs
        larger, fault = _with_larger_steps(plant, resting, tested, timing)
        if any(_responds(larger)):
            tested, steps = replace(larger, fault=fault), larger.steps
    while not (tested.fault or _is_clear(tested)):
        if tested.time[-1] >= timing.longest or blocks >= _BLOCKS_MOST:
            return _beyond(plant, resting, steps, timing, tested)
        blocks += _BLOCKS_MORE
        grid = _Grid(timing.step, blocks, timing.fixed)
        if grid.communication_steps > _MOST_STEPS or not plant.may_repeat:
            return replace(tested, stopped=True)
        try:
            longer, _ = _run_all(plant, resting, steps, grid, _PART_FOR_LONGER)
        except _NotInTimeError:
            return replace(tested, stopped=True)
        if plant.ran_out:
            return replace(tested, stopped=True)
        tested = longer
    return tested


def _beyond(plant: _Paced, resting: Resting, steps: FloatArray, timing: Timing, tested: StepTest) -> StepTest:
    """Return a far longer test if in that what seems to integrate settles; else the one that there is."""
    is_underway = any(map(_is_underway, chain(*tested.responses)))
    if timing.fixed or timing.beyond <= tested.time[-1] or not is_underway or not plant.may_repeat:
        return tested
    step = timing.beyond / (BLOCK * 2.0**_BLOCKS_BEYOND)
    if not _is_quick(plant, resting, float(tested.time[-1]), timing.beyond):
        return tested
    try:
        far, _ = _run_all(plant, resting, steps, _Grid(step, _BLOCKS_BEYOND, fixed=False), _PART_BEYOND)
    except CosimError:  # it was not made to run so long
        return tested
    pairs = zip(chain(*tested.responses), chain(*far.responses), strict=True)
    settles = all(after.type is ResponseType.SETTLED for before, after in pairs if _is_underway(before))
    return far if settles and not far.fault and not plant.ran_out and _is_clear(far) else tested


def _is_quick(plant: _Paced, resting: Resting, step: float, end: float) -> bool:
    """Return whether steps that become longer take no longer, as they do where a solver chooses its own."""
    try:
        plant.plan(step, 2.0 * end)
        plant.reset(resting.parameters)
        while step < end / 4:
            began = monotonic()
            plant.step(resting.u, step)
            if monotonic() - began > _LONG_STEP:
                return False
            step *= 4
    except CosimError:
        return False
    return True


def _is_underway(response: Response) -> bool:
    """Return whether a response may be the beginning of a far slower one."""
    if response.type is ResponseType.OSCILLATING:
        return not response.rings
    return response.type is ResponseType.INTEGRATING and not response.rise_time > 0.0


def _is_clear(tested: StepTest) -> bool:
    """Return whether every response has shown what it is, and one of them something that takes time."""
    shown = [r for row in tested.responses for r in row if r.type is not ResponseType.INSENSITIVE]
    if any(r.type in _UNCLEAR or r.creeps for r in shown):
        return False
    return not all(tested.is_immediate(r) for r in shown)


class _Grid:
    """Sample times in blocks: intervals are whole numbers of the first steps."""

    def __init__(self, step: float, blocks: int, fixed: bool) -> None:
        self._step, self._fixed = step, fixed
        self._counts = sample_counts(blocks)
        self.time: FloatArray = np.cumsum(self._counts) * np.float64(step)
        self.end = float(self.time[-1])
        self.resolution = step * (1.0 + _ROUNDING if fixed else _IMMEDIATE)
        self.communication_steps = int(self._counts.sum()) if fixed else len(self._counts)

    def run(
        self, plant: Plant, u: FloatArray, parameters: Mapping[str, ParameterValue]
    ) -> tuple[FloatArray, str]:
        """Run the plant from its start with constant inputs; return outputs, shape (n, p), and a fault."""
        plant.plan(self._step, self.end)
        plant.reset(parameters)
        rows: list[FloatArray] = []
        try:
            for count in self._counts:
                for _ in range(count if self._fixed else 1):
                    y = plant.step(u, self._step if self._fixed else float(count * self._step))
                if not np.all(np.abs(y) < _BEYOND):  # nor is NaN
                    return _stacked(rows, plant), f"an output is not finite or beyond {_BEYOND:g}"
                rows.append(y)
        except FMUStepError as error:
            return _stacked(rows, plant), str(error)
        return _stacked(rows, plant), ""


def _stacked(rows: Sequence[FloatArray], plant: Plant) -> FloatArray:
    return np.array(rows).reshape(len(rows), len(plant.outputs))


def _run_all(
    plant: _Paced, resting: Resting, steps: FloatArray, grid: _Grid, part: float = 1.0
) -> tuple[StepTest, list[FloatArray]]:
    """Run at rest, then with a step of each input; return the responses and what they are taken from."""
    u, parameters = resting.u, resting.parameters
    began = monotonic()
    plant.share(1 + len(u), part)
    rest, fault = grid.run(plant, u, parameters)
    fails_at_rest = bool(fault) and not plant.ran_out
    if len(rest) < BLOCK and plant.ran_out:
        raise _NotInTimeError("not identified in time: the run with the inputs at rest; raise --budget")
    if len(rest) < BLOCK:
        sizes = "; --sampling-time H if it takes steps of one size only" if "discard" in fault else ""
        raise CosimError(f"the plant does not run with its inputs at rest: {fault}{sizes}")
    deviations = []
    for i, height in enumerate(steps):
        if not height:
            deviations.append(np.zeros_like(rest))
            continue
        plant.share(len(u) - i, part)
        stepped, failed = grid.run(plant, u + height * np.eye(len(u))[i], parameters)
        if len(stepped) < BLOCK and plant.ran_out:  # of a part of a block nothing can be said
            name = plant.inputs[i].name
            raise _NotInTimeError(f"not identified in time: the response to a step of {name}; raise --budget")
        n = _whole_blocks(min(len(rest), len(stepped)))
        fault = fault or failed
        deviations.append(stepped[:n] - rest[:n])
    plant.note(monotonic() - began)
    # What runs away is far beyond its responses where only the run at rest is that long.
    levels = [np.max(np.abs(rest[: len(d)]), axis=0, initial=0.0) for d in deviations]
    responses = tuple(
        tuple(
            classify(grid.time[: len(d)], d[:, j], float(level[j]))
            for d, level in zip(deviations, levels, strict=True)
        )
        for j in range(len(plant.outputs))
    )
    time = grid.time[: len(rest)]
    return StepTest(
        time, rest, steps, responses, fault, fails_at_rest, resolution=grid.resolution
    ), deviations


def _whole_blocks(samples: int) -> int:
    return samples - samples % BLOCK if samples >= BLOCK else samples


def _with_instabilities(plant: _Paced, resting: Resting, tested: StepTest, timing: Timing) -> StepTest:
    """Tell what moves away from its equilibrium by itself: its response does not shrink with the step."""
    if tested.fault or not plant.may_repeat:
        return tested
    grid = _Grid(float(tested.time[0]), len(tested.time) // BLOCK, timing.fixed)
    try:
        smaller, deviations = _run_all(plant, resting, _SMALLER_SHARE * tested.steps, grid)
    except _NotInTimeError:
        return tested
    responses = [list(row) for row in tested.responses]
    unstable, switched = set(), set()
    for j, row in enumerate(smaller.responses):
        for i, small in enumerate(row):
            large = responses[j][i]
            is_late = small.half_time > _LATER * large.half_time  # a switch acts as soon whatever the step is
            if not small.peak > _NONLINEAR * large.peak:
                continue
            if is_late and not small.peak > _OF_A_SOLVER * float(np.max(np.abs(tested.rest[:, j]))):
                responses[j][i] = Response(ResponseType.INSENSITIVE)  # of a thousandth as much: its noise
                continue
            scaled = deviations[i][:, j] / _SMALLER_SHARE
            if not is_late:
                if math.isclose(small.peak, large.peak, rel_tol=_ALIKE):  # else it may be the FMU's noise
                    switched.add((j, i))
            elif slope := limited_slope(grid.time[: len(scaled)], scaled):
                responses[j][i] = replace(
                    large, type=ResponseType.INTEGRATING, slope=slope, rise_time=0.0, settling_time=np.inf
                )
            else:
                unstable.add(j)
                responses[j][i] = escaping(grid.time[: len(scaled)], scaled, small.peak)
    return replace(
        tested,
        responses=tuple(map(tuple, responses)),
        unstable=frozenset(unstable),
        switched=frozenset(switched),
    )
