"""Every built-in method with its defaults on every stable built-in plant: it tracks, or the reason is stated.

The problem of a plant is the same for all methods: a random recording about the plant's operating point, and
two steps that the recorded inputs reach.
"""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from ddpc_cosim import Controller, FloatArray, FMUPlant, Steps, UniformRandom, cosimulate
from ddpc_cosim.plugins import load_plugin, plugin_names
from fmu_plants import PlantModel, build_fmu
from fmu_plants.linear import linearise

# The FMUs are built once, in one process.
pytestmark = pytest.mark.xdist_group("defaults")

HOLD = 120
"""Samples of each step."""
SETTLED = 0.1
"""Of the step: the largest mean error over the last fifth of it."""

BY_HAND = "its gains are the user's, in the units of the plant"
REASONS: dict[str, str] = {
    "band-edge": "it is about another controller",
    "cascade": "its inner i-PID has to be told how strongly the inputs act: alpha, kp",
    "decentralised": "which signals belong together is the user's to say",
    "deepc-published": "it is what the authors' program does, whose ridge pulls every output to zero",
    "fmu": "it is whatever the file that it is told holds",
    "idle": "it does nothing, and is to",
    "ipid": "it has to be told how strongly the inputs act: alpha, kp",
    "nmpc": "it has to be told the plant, where it is not a study that tells it",
    "offset-free": "it is about another controller",
    "pid": f'{BY_HAND}; with tuning = "step-test" it takes them from the recording',
    "plant": "it is whatever control the plant has of its own",
    "policy": "it is whatever the file that it is told holds",
    "safety-filter": "it is about another controller",
    "scaled": "it is about another controller",
    "spsa": f"{BY_HAND}, and only their size is tuned",
    "wkpc-published": "it is what the authors' program does, whose ridge pulls every output to zero",
}
"""Methods that need to be told something, and what."""

EXCEPTIONS = {
    ("mfac", "distillation-column"): "dead times and gains of both signs: another initial_gradient",
    ("mfapc", "distillation-column"): "likewise",
    ("wkpc", "building"): "its thin plates leave a fifth of the step",
}
"""Where a method that needs to be told nothing does not settle all the same."""


class Problem(NamedTuple):
    """What is recorded and asked of a plant."""

    inputs: Sequence[str]
    outputs: Sequence[str]
    measurements: Sequence[str]
    sampling_time: float
    rest: Sequence[float]
    amplitude: Sequence[float]


WITHOUT_PROBLEM = {"two-zone-house": "it is held in a band, in weather: tests/e2e/test_buildings.py"}
"""Stable plants on which nothing steps."""

PROBLEMS = {
    "pendulum": Problem(["torque"], ["angle"], ["angle", "angular_velocity"], 0.1, [0.0], [3.5]),
    "cstr": Problem(
        ["coolant_temperature"], ["temperature"], ["temperature", "concentration"], 5.0, [300.0], [4.0]
    ),
    "quadruple-tank": Problem(
        ["pump_1", "pump_2"], ["level_1", "level_2"], ["level_1", "level_2"], 5.0, [3.0, 3.0], [0.5, 0.5]
    ),
    "ph-neutralisation": Problem(["base_flow"], ["pH"], ["pH", "level"], 15.0, [15.6], [0.3]),
    "two-mass-drive": Problem(
        ["motor_torque"], ["motor_speed"], ["motor_speed", "load_speed"], 0.2, [0.0], [1.0]
    ),
    "building": Problem(
        ["heating_power"], ["indoor_temperature"], ["indoor_temperature"], 3600.0, [3773.58], [3000.0]
    ),
    "distillation-column": Problem(
        ["reflux", "steam"],
        ["distillate", "bottoms"],
        ["distillate", "bottoms"],
        300.0,
        [1.95, 1.71],
        [0.1, 0.1],
    ),
}


def is_stable(model: PlantModel) -> bool:
    """Whether a plant is stable about where it starts."""
    a = np.asarray(linearise(model).A, dtype=float)
    return bool(np.linalg.eigvals(a).real.max() < -1e-9)


def test_every_stable_plant_has_a_problem_and_no_other() -> None:
    stable = {name for name in plugin_names("plants") if is_stable(load_plugin("plants", name))}
    assert stable - set(WITHOUT_PROBLEM) == set(PROBLEMS)
    assert set(WITHOUT_PROBLEM) <= stable


def test_every_reason_is_that_of_a_method() -> None:
    assert set(REASONS) < set(plugin_names("controllers"))
    page = (Path(__file__).parents[2] / "docs" / "methods" / "index.md").read_text(encoding="utf-8")
    assert not [name for name in REASONS if f"| `{name}` |" not in page.split("## Out of the box")[1]]


@cache
def built(plant: str) -> Path:
    return build_fmu(load_plugin("plants", plant))


def steps_of(plant: str) -> FloatArray:
    """Return how far each step goes, shape (2, p): what half of the recorded inputs holds, up and down."""
    model, problem = load_plugin("plants", plant), PROBLEMS[plant]
    a, b, c, _ = (np.asarray(matrix, dtype=float) for matrix in linearise(model))
    gain = -c @ np.linalg.solve(a, b)
    rows = [[v.name for v in model.outputs].index(name) for name in problem.outputs]
    columns = [[v.name for v in model.inputs].index(name) for name in problem.inputs]
    half = 0.5 * gain[np.ix_(rows, columns)] @ np.asarray(problem.amplitude)
    return np.array([half, -half])


def settled_error(controller: Controller, plant: str, seed: int) -> float:
    """Return the largest mean error over the last fifth of a step, in parts of the step."""
    problem, steps = PROBLEMS[plant], steps_of(plant)
    read = tuple(dict.fromkeys((*problem.outputs, *problem.measurements)))
    low, high = (np.asarray(problem.rest) + sign * np.asarray(problem.amplitude) for sign in (-1.0, 1.0))
    room = 3.0 * np.asarray(problem.amplitude)
    with FMUPlant(built(plant), inputs=tuple(problem.inputs), outputs=read) as driven:
        start = driven.reset(None, 0.0)[: len(problem.outputs)]
        values = (start + steps).T.tolist()
        trace = cosimulate(
            driven,
            controller,
            sampling_time=problem.sampling_time,
            duration=2 * HOLD * problem.sampling_time,
            reference={
                name: Steps([0.0, HOLD * problem.sampling_time], targets)
                for name, targets in zip(problem.outputs, values, strict=True)
            },
            excitation=UniformRandom(low.tolist(), high.tolist(), 200, seed=seed),
            bounds={
                name: (rest - there, rest + there)
                for name, rest, there in zip(problem.inputs, problem.rest, room.tolist(), strict=True)
            },
            outputs=problem.outputs,
            measurements=problem.measurements,
            seed=seed,
        )
    assert trace.completed, trace.reason
    assert not trace.warnings
    looked_ahead = max(controller.horizon, 1)
    errors = []
    for end, size in ((HOLD, steps[0]), (2 * HOLD, steps[1] - steps[0])):
        last = slice(end - HOLD // 5, end - looked_ahead)
        errors.append(np.abs((trace.y - trace.reference)[last].mean(axis=0) / size).max())
    return float(max(errors))


@pytest.mark.parametrize("plant", sorted(PROBLEMS))
@pytest.mark.parametrize("method", sorted(set(plugin_names("controllers")) - set(REASONS)))
def test_a_method_tracks_with_its_defaults(method: str, plant: str) -> None:
    settles = settled_error(load_plugin("controllers", method)(), plant, seed=1) < SETTLED
    assert settles == ((method, plant) not in EXCEPTIONS)


@pytest.mark.parametrize("plant", sorted(PROBLEMS))
def test_a_pid_that_is_tuned_on_the_recording_tracks(plant: str) -> None:
    assert settled_error(load_plugin("controllers", "pid")(tuning="step-test"), plant, seed=1) < SETTLED
