"""Who is perfect never fails and always settles, whatever acts on the plant; who is clearly bad fails.

The perfect controllers know the plant: what they leave is what cannot be known one sample ahead.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from studies import run_file, study_text, write

from ddpc_controllers import PID, Idle
from ddpc_cosim import (
    CaseResult,
    Conditions,
    Constant,
    Controller,
    FloatArray,
    Loop,
    Outcome,
    ParameterChange,
    Plant,
    Problem,
    Ramp,
    Reference,
    Sample,
    Scenario,
    Sine,
    Steps,
    Study,
    StudyResults,
    Variable,
    WhiteNoise,
    cosimulate,
)
from ddpc_cosim.codec import read
from ddpc_cosim.signals.signals import GaussianNoise
from ddpc_cosim.study.file_format.sections import ScenarioSection
from ddpc_cosim.study.verdicts.judgement import judged, run_of, scenario_remarks
from ddpc_cosim.study.verdicts.standings import standings


def over_seeds(few: int, seeds: int) -> pytest.MarkDecorator:
    """All of them together are half a minute; the first say whether it is so at all."""
    more = pytest.param(range(few, seeds), id="more", marks=pytest.mark.slow)
    return pytest.mark.parametrize("seeds", [pytest.param(range(few), id="few"), more])


DOWN = Steps((0.0, 50.0), (1.0, 0.0))


class Linear(Plant):
    """x+ = A x + gain B u, y = scale x + level, from rest or from a state."""

    def __init__(
        self,
        a: Sequence[Sequence[float]] = ((0.0,),),
        b: Sequence[Sequence[float]] = ((1.0,),),
        *,
        scale: float = 1.0,
        level: float = 0.0,
        first: float = 0.0,
        names: str = "yzvw",
        limits: tuple[float, float] = (-math.inf, math.inf),
        nominal: float = 1.0,
    ) -> None:
        self.a, self.b = np.array(a), np.array(b)
        self.scale, self.level, self.first = scale, level, first
        self.inputs = tuple(Variable(f"u{n}") for n in range(self.b.shape[1]))
        self.outputs = tuple(
            Variable(name, min=limits[0], max=limits[1], nominal=nominal) for name in names[: len(self.a)]
        )

    def reset(self, parameters: Mapping[str, Any] | None = None, t0: float = 0.0) -> FloatArray:
        self.x, self.gain = np.full(len(self.a), self.first), 1.0
        return self.scale * self.x + self.level

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.x = self.a @ self.x + self.gain * (self.b @ u)
        return self.scale * self.x + self.level

    def set_parameters(self, parameters: Mapping[str, Any]) -> None:
        self.gain = float(parameters["gain"])


class Drifting(Linear):
    """It moves by itself, by as much at every sample."""

    def step(self, u: FloatArray, h: float) -> FloatArray:
        return super().step(u + 0.05, h)


class Relay(Linear):
    """Left alone, it goes round a limit cycle of its own."""

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.up = (self.x[0] < 1.0) if getattr(self, "up", True) else (self.x[0] < -1.0)
        return super().step(u + (0.4 if self.up else -0.4), h)


class Perfect(Controller):
    """It inverts the plant it knows, from what is measured or, blind, from what it has done itself."""

    horizon = 1

    def __init__(self, plant: Linear | None = None, *, blind: bool = False) -> None:
        self.plant, self.blind = plant or Linear(), blind

    def start(self, loop: Loop) -> None:
        self.x = np.full(len(self.plant.a), self.plant.first)

    def step(self, sample: Sample) -> FloatArray:
        if not self.blind:
            self.x = (sample.y - self.plant.level) / self.plant.scale
        to = (sample.reference[0] - self.plant.level) / self.plant.scale
        u: FloatArray = np.linalg.solve(self.plant.b, to - self.plant.a @ self.x)
        self.x = to
        return u


class Predicting(Controller):
    """The perfect one of y = u, which knows how what was added to the output goes on: constant, or a sine."""

    horizon = 1

    def __init__(self, frequency: float = 0.0) -> None:
        self.turn = 2.0 * math.cos(2.0 * math.pi * frequency) if frequency else 0.0

    def start(self, loop: Loop) -> None:
        self.x, self.before = np.zeros(1), np.zeros(1)

    def step(self, sample: Sample) -> FloatArray:
        added = sample.y - self.x
        self.x = sample.reference[0] - (self.turn * added - self.before if self.turn else added)
        self.before = added
        return self.x.copy()


@dataclass(frozen=True)
class Otherwise(Controller):
    """A perfect controller that is wrong in a way: a share of what it is asked for, and signals of time."""

    factor: tuple[float, ...] = (1.0,)
    wave: float = 0.0
    drift: float = 0.0
    growth: float = 0.0
    horizon = 1

    def start(self, loop: Loop) -> None: ...

    def step(self, sample: Sample) -> FloatArray:
        k = sample.k
        extra = self.wave * math.sin(0.7 * k) + self.drift * k + (self.growth**k if self.growth else 0.0)
        return np.asarray(np.array(self.factor) * sample.reference[0] + extra)


def run(plant: Plant, controller: Controller, seed: int, reference: Any, **loop: Any) -> CaseResult:
    """Return a run as a study would, without its files."""
    quantum, noise = loop.pop("quantum", {}), loop.pop("noise", {})
    conditions = Conditions(disturbances=loop.pop("disturbances", {}), quantum=quantum)
    trace = cosimulate(
        plant,
        controller,
        sampling_time=1.0,
        duration=100.0,
        reference=reference,
        conditions=conditions,
        noise=GaussianNoise(noise) if noise else None,
        seed=seed,
        **loop,
    )
    name = type(controller).__name__
    head = (name, name, name, "s", seed, trace.outcome, trace.reason, trace.tracking())
    return CaseResult(*head, trace.metrics(), {}, {}, (), Path())


def scenario(**given: Any) -> ScenarioSection:
    """Return a scenario with such noise and quantisation; of disturbances it counts that there are some."""
    some = [{"kind": "constant", "value": 1.0}]
    disturbances = dict.fromkeys(given.pop("disturbances", ()), some)
    return read(ScenarioSection, {**given, "disturbances": disturbances})


def judge(plant: Plant, controller: Controller, seed: int, reference: Any, **loop: Any) -> CaseResult:
    """Return a run as it is judged beside doing nothing."""
    case, idle = (run(plant, driver, seed, reference, **loop) for driver in (controller, Idle()))
    section = scenario(**{key: loop[key] for key in ("noise", "quantum", "disturbances") if key in loop})
    result, resting = judged({"s": section}, [case, idle], {run_of(idle): idle})
    assert not resting.failure.startswith("worse")
    if isinstance(controller, Perfect | Predicting):
        # Their metrics, too: doing nothing is never ahead by more than the noise in the comparison.
        errors = [sum(tracking.mean_abs_error for tracking in it.tracking) for it in (result, resting)]
        allowed = sum(tracking.scatter for tracking in result.tracking) + sum(
            loop.get("quantum", {}).values()
        )
        assert errors[0] <= errors[1] + allowed
    return result


def assert_perfect(case: CaseResult) -> None:
    assert (case.failed, case.failure, case.outcome) == (False, "", Outcome.COMPLETED), case.seed
    assert case.settles, (case.seed, case.left)


DISTURBED: dict[str, tuple[Controller, dict[str, Any]]] = {
    "output noise": (Perfect(), {"disturbances": {"y": [WhiteNoise(0.2)]}}),
    "loud output noise": (Perfect(), {"disturbances": {"y": [WhiteNoise(3.0)]}}),
    "output noise, predicted in vain": (Predicting(), {"disturbances": {"y": [WhiteNoise(0.2)]}}),
    "input noise": (Perfect(), {"disturbances": {"u0": [WhiteNoise(0.2)]}}),
    "noise of input and output": (
        Perfect(),
        {"disturbances": {"u0": [WhiteNoise(0.3)], "y": [WhiteNoise(0.2), Sine(0.05, 0.01)]}},
    ),
    "measurement noise": (Perfect(), {"noise": {"y": 0.5}}),
    "measurement noise, fed back": (Predicting(), {"noise": {"y": 0.5}}),
    "sine": (Predicting(0.04), {"disturbances": {"y": [Sine(0.3, 0.04)]}}),
    "step": (Predicting(), {"disturbances": {"y": [Steps((20.0, 73.0), (0.4, -0.7))]}}),
    "step and noise": (
        Predicting(),
        {"disturbances": {"y": [Steps((33.0,), (2.0,)), WhiteNoise(0.1)]}, "noise": {"y": 0.05}},
    ),
    "quantised": (Predicting(), {"quantum": {"y": 0.1}}),
    "quantised coarsely": (Predicting(), {"quantum": {"y": 1.0}, "disturbances": {"y": [Constant(0.3)]}}),
}
REFERENCES: dict[str, Reference] = {
    "steps": DOWN,
    "many steps": Steps(tuple(range(0, 100, 8)), tuple((1.0, -1.0) * 7)[:13]),
    "constant": Constant(0.0),
    "constant, far away": Constant(5.0),
    "sine": Sine(1.0, 0.02),
    "ramp": Ramp(0.0, 3.0, 10.0, 60.0),
}


@over_seeds(4, 30)
@pytest.mark.parametrize("reference", REFERENCES)
@pytest.mark.parametrize("disturbed", DISTURBED)
def test_a_perfect_controller_of_a_static_plant(disturbed: str, reference: str, seeds: range) -> None:
    """With limits, which noise leaves, and without."""
    controller, loop = DISTURBED[disturbed]
    for seed in seeds if "noise" in disturbed else seeds[:2]:
        limits = (0.0, 1.0) if seed % 2 else (-math.inf, math.inf)
        case = judge(Linear(limits=limits), controller, seed, REFERENCES[reference], **loop)
        moves = reference == "sine"
        assert_perfect(replace(case, settles=True) if moves else case)
        assert (case.settles is None) == moves


@over_seeds(4, 30)
@pytest.mark.parametrize("reference", ["steps", "constant", "ramp"])
@pytest.mark.parametrize("noise", [{"u0": 3.0}, {"y": 0.2}], ids=str)
def test_a_perfect_controller_of_a_slow_plant(noise: dict[str, float], reference: str, seeds: range) -> None:
    """Noise of the input makes a plant that is left alone wander; noise of the output is not fed back."""
    plant = Linear([[0.95]], [[0.05]])
    disturbances = {name: [WhiteNoise(deviation)] for name, deviation in noise.items()}
    for seed in seeds:
        controller = Perfect(plant, blind="y" in noise)
        assert_perfect(judge(plant, controller, seed, REFERENCES[reference], disturbances=disturbances))


COUPLED = Linear([[0.6, 0.2], [0.1, 0.7]], [[1.0, 0.4], [-0.3, 0.8]])
ONE_STAYS = {"y": DOWN, "z": Constant(0.0)}


@over_seeds(4, 30)
@pytest.mark.parametrize("noise", [{"y": 0.2}, {"z": 0.2}, {"u0": 0.2, "u1": 0.1}, {}], ids=str)
def test_a_perfect_controller_of_two_outputs_one_of_which_stays(
    noise: dict[str, float], seeds: range
) -> None:
    disturbances = {name: [WhiteNoise(deviation)] for name, deviation in noise.items()}
    for seed in seeds if noise else seeds[:1]:
        controller = Perfect(COUPLED, blind="u0" not in noise)
        assert_perfect(judge(COUPLED, controller, seed, ONE_STAYS, disturbances=disturbances))


@pytest.mark.parametrize("reference", ["steps", "constant", "constant, far away", "ramp", "sine"])
@pytest.mark.parametrize(
    "loop",
    [
        {},
        {"disturbances": {"u0": [WhiteNoise(1.0)]}},
        {"disturbances": {"y": [WhiteNoise(0.1)]}},
        {"disturbances": {"u0": [Sine(0.5, 0.01)]}},
        {"disturbances": {"u0": [Steps((20.0,), (1.0,))]}},
        {"noise": {"y": 0.1}},
        {"quantum": {"y": 0.05}},
    ],
    ids=str,
)
@over_seeds(2, 10)
def test_a_sane_controller_does_not_fail(reference: str, loop: dict[str, Any], seeds: range) -> None:
    plant = Linear([[0.9]], [[0.1]])
    for seed in seeds:
        case = judge(plant, PID(proportional=2.0, integral=0.3), seed, REFERENCES[reference], **loop)
        assert not case.failed, (seed, case.failure)


@pytest.mark.parametrize(
    ("controller", "why"),
    [
        (Otherwise((0.4,)), r"y ends 60 % of its task away from its reference"),
        (Otherwise((1.0,), wave=1.0), r"y ends 6\d % of its task away from its reference"),
        (Otherwise((1.0,), drift=0.02), r"y ends 1\d\d % of its task away from its reference"),
        (Otherwise((1.0,), growth=1.5), r"y ends more than 100 times its task away from its reference"),
        (Otherwise((-1.0,)), r"y ends 200 % of its task away from its reference"),
    ],
    ids=["stays behind", "oscillates", "drifts", "diverges", "the other way round"],
)
@over_seeds(4, 30)
def test_a_bad_controller_fails(controller: Controller, why: str, seeds: range) -> None:
    case = judge(Linear(), controller, 0, DOWN)
    assert case.failed
    assert re.fullmatch(why, case.failure), case.failure
    assert case.outcome is Outcome.COMPLETED
    for seed in seeds:
        assert judge(Linear(), controller, seed, DOWN, noise={"y": 0.02}).failed


def test_one_output_that_fails_is_enough() -> None:
    """The other is perfect, and doing nothing worse over both."""
    plant = Linear([[0.0, 0.0], [0.0, 0.0]], [[1.0, 0.0], [0.0, 1.0]])
    both = {"y": DOWN, "z": Steps((0.0, 50.0), (10.0, 0.0))}
    assert not judge(plant, Otherwise((1.0, 0.6)), 0, both).failed
    assert judge(plant, Otherwise((1.0, 0.4)), 0, both).failure.startswith("z ends 60 % of its task away")
    # Of the size of its disturbance, which it makes thrice as large for a while.
    disturbed = {"z": [Steps((10.0, 40.0), (1.0, 0.0))]}
    case = judge(plant, Worsening(), 0, {"y": DOWN, "z": Constant(0.0)}, disturbances=disturbed)
    means = "mean error 90 % of the task, doing nothing 30 % of it"
    assert case.failure == f"z is worse than doing nothing: {means}"


class Worsening(Controller):
    """The perfect one of two outputs, but for the second, whose error it triples."""

    horizon = 1

    def start(self, loop: Loop) -> None:
        self.u = 0.0

    def step(self, sample: Sample) -> FloatArray:
        self.u = 2.0 * (sample.y[1] - self.u)
        return np.array([sample.reference[0, 0], self.u])


def test_where_doing_nothing_does_not_complete_that_clause_is_left_out() -> None:
    plant = Linear([[1.6]], [[1.0]], first=0.1)
    disturbances = {"u0": [WhiteNoise(0.05)]}
    falls = run(plant, Idle(), 0, Constant(0.0), disturbances=disturbances)
    holds = run(plant, Perfect(plant), 0, Constant(0.0), disturbances=disturbances)
    lost = replace(falls, outcome=Outcome.DIVERGED)
    case, idle = judged({"s": scenario(disturbances=disturbances)}, [holds, lost], {run_of(lost): lost})
    assert (case.failed, case.settles, idle.failed, idle.left) == (False, True, True, math.inf)


class Igniting(Linear):
    """Left alone it runs away from where it is begun, as far as there is room; nothing acts on it."""

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.x = np.clip(1.3 * self.x + u, -1000.0, 1000.0)
        return self.x.copy()


@pytest.mark.parametrize("acts", [{}, {"disturbances": {"u0": [WhiteNoise(0.01)]}}])
def test_a_plant_that_runs_away_when_left_alone_does_not_make_its_task_larger(acts: dict[str, Any]) -> None:
    """Its reference travels by 1: who ends four away, or goes round it as far, failed and does not settle."""
    plant = Igniting(first=0.01)
    for wrong in (Otherwise((5.0,)), Otherwise((1.0,), wave=6.0)):
        case = judge(Linear(), wrong, 0, DOWN)
        theirs = run(plant, Idle(), 0, DOWN, **acts)
        result, resting = judged({"s": scenario(**acts)}, [case, theirs], {run_of(theirs): theirs})
        assert (result.failed, result.settles, resting.failed) == (True, False, True)


class Chaotic(Linear):
    """x+ = 3.9 x (1 - x) + u where nothing is done: what comes next, two samples do not tell."""

    def step(self, u: FloatArray, h: float) -> FloatArray:
        self.x = np.clip(3.9 * self.x * (1.0 - self.x) + u, -10.0, 10.0)
        return self.x.copy()


class Tamed(Controller):
    """The inverse of a chaotic plant, which goes nine tenths of the way."""

    horizon = 1

    def start(self, loop: Loop) -> None: ...

    def step(self, sample: Sample) -> FloatArray:
        return np.asarray(0.9 * sample.reference[0] - 3.9 * sample.y * (1.0 - sample.y))


def test_without_a_run_of_doing_nothing_a_perfect_controller_under_disturbances_settles() -> None:
    """It would be a run of another shard: what cannot be known ahead is read off the run itself."""
    acts = {"disturbances": {"y": [WhiteNoise(0.2)]}}
    for seed in range(20):
        (case,) = judged({"s": scenario(**acts)}, [run(Linear(), Perfect(), seed, DOWN, **acts)], {})
        assert_perfect(case)


def test_what_is_wild_while_nothing_is_done_is_no_noise() -> None:
    """A controller that leaves a fifth of a step does not settle, however wild its plant is."""
    assert run(Chaotic(first=0.3), Idle(), 0, DOWN).tracking[0].scatter > 0.2
    case = judge(Chaotic(first=0.3), Tamed(), 0, Steps((0.0, 50.0), (0.5, 1.0)))
    assert (case.failed, case.settles) == (False, False)
    assert case.left == pytest.approx(20.0, rel=0.1)


def test_a_plant_that_drifts_or_oscillates_by_itself() -> None:
    for plant in (Drifting([[1.0]], [[1.0]]), Relay([[0.9]], [[1.0]])):
        assert not judge(plant, PID(proportional=0.5, integral=0.2), 0, Constant(0.0)).failed
        assert judge(plant, Idle(), 0, Constant(0.0)).failed
        assert judge(plant, Otherwise((1.0,), wave=3.0), 0, Constant(0.0)).failed


@pytest.mark.parametrize("reference", ["sine", "ramp"])
def test_a_moving_reference(reference: str) -> None:
    """A sine is never constant: whether a run settles there cannot be said; a ramp comes to an end."""
    plant = Linear([[0.9]], [[0.1]])
    perfect = judge(plant, Perfect(plant), 0, REFERENCES[reference])
    assert (perfect.failed, perfect.settles) == (False, None if reference == "sine" else True)
    opposite = judge(Linear(), Otherwise((-1.0,)), 0, REFERENCES[reference])
    assert opposite.failed
    assert not opposite.settles
    if reference == "ramp":
        assert judge(plant, Idle(), 0, REFERENCES[reference]).failed


def test_doing_nothing_fails_where_a_reference_goes_up_and_down_by_as_much() -> None:
    """It is always half of the way between the two values, and so at half of the task."""
    case = judge(Linear(), Idle(), 0, Steps((0.0, 50.0), (1.0, -1.0)))
    assert case.failure == "y ends 50 % of its task away from its reference"


def test_a_reference_that_begins_far_from_the_output() -> None:
    plant = Linear([[0.9]], [[0.1]], first=20.0)
    for reference in (Constant(0.0), DOWN):
        assert_perfect(judge(plant, Perfect(plant), 0, reference))
    stays = judge(Linear([[1.0]], [[1.0]], first=20.0), Otherwise((0.0,)), 0, Constant(0.0))
    assert (stays.failure, stays.left) == ("y ends 100 % of its task away from its reference", 100.0)


@pytest.mark.parametrize("preview", [0, 5, 20])
def test_windows_end_before_anybody_sees_the_next_step(preview: int) -> None:
    plant = Linear([[0.5]], [[0.5]])
    case = judge(plant, Perfect(plant), 0, DOWN, preview=max(preview, 1))
    assert_perfect(case)
    assert judge(Linear(), Otherwise((0.4,)), 0, DOWN, preview=preview).failed


def test_a_plant_that_changes() -> None:
    """A controller that knows the old plant leaves what the change of its gain does: 30 %, then 60 %."""
    for gain, failed in ((0.7, False), (0.4, True), (1.7, True)):
        events = [ParameterChange(20.0, {"gain": gain})]
        case = judge(Linear(), Perfect(), 0, Constant(1.0), events=events)
        assert (case.failed, case.settles) == (failed, False)
        assert case.left == pytest.approx(100.0 * abs(1.0 - gain))


WRONG = [(1.0, 0.0), (0.97, 0.0), (0.8, 0.0), (0.4, 0.0), (1.0, 0.3), (1.0, 1.0)]
"""The share of what they are asked for, and the amplitude of a wave, of controllers more or less wrong."""


def noisy(scale: float) -> dict[str, Any]:
    return {"disturbances": {"y": [WhiteNoise(0.05 * scale)]}, "noise": {"y": 0.02 * scale}}


@dataclass(frozen=True)
class Scaled(Reference):
    """A signal in another unit."""

    signal: Reference
    scale: float
    level: float

    def at(self, time: FloatArray) -> FloatArray:
        return self.scale * self.signal.at(time) + self.level


@dataclass(frozen=True)
class In(Controller):
    """A controller that is told another unit's values in its own."""

    inner: Controller
    scale: float
    level: float
    horizon = 1

    def start(self, loop: Loop) -> None:
        self.inner.start(loop)

    def step(self, sample: Sample) -> FloatArray:
        reference = (sample.reference - self.level) / self.scale
        return np.asarray(self.inner.step(sample._replace(reference=reference)))


@settings(max_examples=25)
@given(
    st.sampled_from(WRONG),
    st.sampled_from([Constant(0.0), Constant(2.0), DOWN, Sine(1.0, 0.03)]),
    st.sampled_from([1e-5, 0.1, 1.8, 1e5]),
    st.sampled_from([0.0, 32.0, -273.15]),
    st.integers(0, 1000),
)
def test_units_decide_nothing(
    wrong: tuple[float, float], reference: Reference, scale: float, level: float, seed: int
) -> None:
    """Neither the size of a unit nor where its zero is."""
    first = judge(Linear(), Otherwise((wrong[0],), wave=wrong[1]), seed, reference, **noisy(1.0))
    plant = Linear(scale=scale, level=level * scale, nominal=scale)
    other = In(Otherwise((wrong[0],), wave=wrong[1]), scale, level * scale)
    second = judge(plant, other, seed, Scaled(reference, scale, level * scale), **noisy(scale))
    assert (first.failed, first.settles, first.failure) == (second.failed, second.settles, second.failure)
    assert first.left == pytest.approx(second.left, rel=1e-6, abs=1e-6, nan_ok=True)


@settings(max_examples=25)
@given(st.sampled_from(WRONG), st.sampled_from(WRONG), st.integers(0, 1000))
def test_the_order_of_outputs_decides_nothing(
    first: tuple[float, float], other: tuple[float, float], seed: int
) -> None:
    results = []
    for names in ("yz", "zy"):
        plant = Linear([[0.0, 0.0], [0.0, 0.0]], [[1.0, 0.0], [0.0, 1.0]], names=names)
        factors = {"y": first[0], "z": other[0]}
        controller = Otherwise(tuple(factors[name] for name in names), wave=first[1])
        references = {"y": DOWN, "z": Steps((0.0, 20.0), (0.0, 3.0))}
        results.append(judge(plant, controller, seed, references, disturbances={"y": [Sine(0.3, 0.01)]}))
    assert results[0].failed == results[1].failed
    assert results[0].left == results[1].left


OWN = """
from ddpc_cosim import Controller, Plant, Variable

class Static(Plant):
    inputs, outputs = (Variable("u"),), (Variable("y"),)
    def reset(self, parameters=None, t0=0.0):
        import numpy as np
        return np.zeros(1)
    def step(self, u, h):
        return u.copy()

class Following(Controller):
    horizon = 1
    def start(self, loop):
        pass
    def step(self, sample):
        return sample.reference[0]
"""


def order_of(results: StudyResults) -> dict[str, int]:
    assert not any(case.failed and case.controller != "idle" for case in results.cases), results
    return {standing.controller: standing.rank for standing in standings(results.study, results.cases).order}


def test_a_pendulum_at_the_edge_of_its_band(tmp_path: Path) -> None:
    """Both leave the band; who leaves it by half as much is better, and no failure."""
    problem = Problem(
        plant="pendulum",
        inputs=["torque"],
        outputs=["angle"],
        sampling_time=0.1,
        duration=20.0,
        reference=Constant(0.0),
        bounds={"angle": (0.0, 1.0), "torque": (-3.5, 3.5)},
        conditions=Conditions(disturbances={"torque": [Sine(0.3, 0.2)]}),
    )
    study = Study(problem, {"idle": Idle(), "pid": PID(proportional=10.0, integral=10.0, derivative=2.0)})
    results = study.run(tmp_path, progress=False)
    errors = {case.controller: case.metrics["mean_abs_error.angle [deg]"] for case in results.cases}
    assert errors["pid"] < 0.5 * errors["idle"]
    assert order_of(results) == {"pid": 1, "idle": 2}
    assert not any(remark.is_failure for remark in scenario_remarks(results.study, results.cases))


def test_white_noise_does_not_keep_who_follows_from_settling(tmp_path: Path) -> None:
    """A mean over ten samples of noise of 20 % of the step is off by 6 % of it, and by more at times."""
    (tmp_path / "static_plant.py").write_text(OWN)
    text = study_text(
        seeds=[0, 1, 2, 3, 4, 5],
        plant={"name": "static_plant:Static"},
        loop={"sampling_time": 1.0, "duration": 100.0},
        reference={"y": {"kind": "steps", "times": [0.0, 50.0], "values": [1.0, 0.0]}},
        scenarios={"noisy": {"disturbances": {"y": {"kind": "noise", "standard_deviation": 0.2}}}},
        controllers=["idle", "static_plant:Following"],
    )
    results = run_file(write(tmp_path, text))
    assert {case.reason for case in results.cases} == {""}
    cases = [case for case in results.cases if case.controller == "following"]
    assert max(end.error for case in cases for end in case.tracking[0].ends) > 0.06
    assert all(case.settles for case in cases)
    assert order_of(results) == {"following": 1, "idle": 2}
    assert scenario_remarks(results.study, results.cases) == []


def test_a_building_in_the_weather(tmp_path: Path) -> None:
    weather = {
        "outdoor_temperature": Sine(4.0, 1.0 / 86400.0, offset=273.15, phase=-2.356),
        "solar_irradiance": Steps((0.0, 36000.0, 57600.0), (0.0, 400.0, 0.0)),
    }
    problem = Problem(
        plant="building",
        inputs=["heating_power"],
        outputs=["indoor_temperature"],
        sampling_time=900.0,
        duration=86400.0,
        reference=Constant(294.15),
        bounds={"heating_power": (0.0, 8000.0), "indoor_temperature": (294.15, 296.15)},
        nominal={"indoor_temperature": 1.0},
        scenarios={"weather": Scenario(conditions=Conditions(inputs=weather))},
    )
    study = Study(problem, {"idle": Idle(), "pid": PID(proportional=3000.0, integral=0.5)})
    results = study.run(tmp_path, progress=False)
    assert order_of(results) == {"pid": 1, "idle": 2}
