"""What measuring and forecasting a disturbance is worth: errors with it over the best without it.

Every method is tuned anew for what is known, by the same random trials on two seeds, and judged by the median
of its mean absolute error over twenty others. Without the disturbance it is the better of two: recorded with
the disturbance at rest, and recorded with it moving. It is random, in the recording and in the run.
Trials differ in whether what is measured is held, or goes on as it did in the recording; where there are
errors, in whether the forecast is used at all.

    python -m benchmarks.knowing building column drive steps --trials 24
    python -m benchmarks.knowing building column steps --shuffled

With ``--shuffled`` a perfect forecast is set against one whose rows are in a random order, another one at
every sample: were the errors with that not larger, the gain would not come from the forecast.
"""

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from ddpc_controllers import MPC, SPC, DeePC
from ddpc_controllers.wrapper import SingleWrapper
from ddpc_cosim import (
    Action,
    Constant,
    Controller,
    Interpolated,
    KnownDisturbance,
    Loop,
    Problem,
    Product,
    RandomLevels,
    Reference,
    Sample,
    Sine,
    Steps,
    Study,
    Sum,
    UniformRandom,
)
from ddpc_cosim.study.verdicts.statistics import LEVEL, compare

HOUR, DAY = 3600.0, 86400.0
METHODS = ("DeePC", "SPC", "MPC")
MODES = ("at rest", "moving", "measured", "medium", "perfect")
WITHOUT = MODES[:2]
CONSTANT = {"measured": 0.70, "medium": 0.75, "perfect": 0.70}
"""What may be left at a constant reference."""
OF_STEPS = {"building": 0.90, "column": 0.75, "drive": 0.75}
"""What may be left at the references of the benchmark, whatever is known."""
AHEAD: dict[str, Sequence[Any]] = {"measured": (False, "identified"), "medium": (True, False, "identified")}
"""What trials do with forecasts, by turns, where these are not without errors."""
FORESEEN, ELSEWHERE = 0.90, 1.10
"""A perfect forecast over what is measured: of a load that comes in steps, and of others."""
TUNED_ON, JUDGED_ON = range(100, 102), range(20)


@dataclass(kw_only=True)
class Shuffled(SingleWrapper):
    """Another controller, which is shown the rows of its forecasts in a random order."""

    def start(self, loop: Loop) -> None:
        """Start the controller."""
        self._order = np.random.default_rng(loop.rng.integers(2**32))
        self._start_inside(loop)

    def step(self, sample: Sample) -> Action:
        """Return the controller's inputs for the shuffled forecast."""
        return self._inner.step(sample._replace(forecast=self._order.permutation(sample.forecast)))


class Task(NamedTuple):
    """A plant at a constant reference, the references of the benchmark, and what disturbs it."""

    keywords: Mapping[str, Any]
    steps: Mapping[str, Reference]
    samples: int
    disturbances: Mapping[str, Reference]
    rest: Mapping[str, Reference]


def _from(start: float, times: Sequence[float], values: Sequence[float], unit: str = "") -> Steps:
    return Steps([start + time for time in times], values, unit=unit)


def _weather() -> dict[str, Reference]:
    clear = [0.0, 0.0, 90.0, 200.0, 290.0, 340.0, 340.0, 290.0, 200.0, 90.0, 0.0]
    hours = [0.0, *(HOUR * hour for hour in range(8, 18))]
    swing = Sine(4.0, 1 / DAY, phase=-2.356)
    slow = RandomLevels(-3.0, 3.0, DAY / 2, interpolation="linear")
    clouds = RandomLevels(0.2, 1.0, 0.75 * HOUR, interpolation="linear")
    return {
        "outdoor_temperature": Sum([swing, slow], unit="degC"),
        "solar_irradiance": Product([Interpolated(hours, clear, period=DAY), clouds]),
    }


def _building() -> Task:
    keywords = {
        "plant": "building",
        "inputs": ["heating_power"],
        "outputs": ["indoor_temperature"],
        "nominal": {"indoor_temperature": 1.0, "outdoor_temperature": 5.0},
        "sampling_time": 900.0,
        "start_time": 7 * DAY,
        "reference": {"indoor_temperature": Constant(20.0, unit="degC")},
        "bounds": {"heating_power": (0.0, 8000.0)},
        "excitation": UniformRandom(1500.0, 6000.0, 288),
    }
    steps = _from(7 * DAY, (0.0, 6 * HOUR, 20 * HOUR), (19.0, 21.0, 19.0), "degC")
    rest = {
        "outdoor_temperature": Constant(0.0, unit="degC"),
        "solar_irradiance": Constant(0.0),
    }
    return Task(keywords, {"indoor_temperature": steps}, 288, _weather(), rest)


def _column() -> Task:
    keywords = {
        "plant": "distillation-column",
        "inputs": ["reflux", "steam"],
        "outputs": ["distillate", "bottoms"],
        "sampling_time": 120.0,
        "start_time": 36000.0,
        "reference": {"distillate": Constant(96.25), "bottoms": Constant(0.5)},
        "bounds": {"reflux": (1.6, 2.3), "steam": (1.4, 2.0)},
        "excitation": UniformRandom([1.85, 1.61], [2.05, 1.81], 150),
    }
    steps = {
        "distillate": _from(36000.0, (0.0, 600.0), (96.25, 97.0)),
        "bottoms": _from(36000.0, (0.0, 6000.0), (0.5, 1.0)),
    }
    feed = RandomLevels(2.25, 2.65, 120.0)
    return Task(keywords, steps, 150, {"feed": feed}, {"feed": Constant(2.45)})


def _drive(load: Reference) -> Task:
    keywords = {
        "plant": "two-mass-drive",
        "inputs": ["motor_torque"],
        "outputs": ["load_speed"],
        "sampling_time": 0.02,
        "start_time": 10.0,
        "reference": {"load_speed": Constant(0.0)},
        "bounds": {"motor_torque": (-5.0, 5.0)},
        "excitation": UniformRandom(-2.0, 2.0, 120),
    }
    steps = _from(10.0, (0.0, 0.2, 0.8, 1.4), (0.0, 10.0, 5.0, 15.0))
    return Task(keywords, {"load_speed": steps}, 120, {"load_torque": load}, {"load_torque": Constant(0.0)})


TASKS = {
    "building": _building(),
    "column": _column(),
    "drive": _drive(RandomLevels(-0.5, 0.5, 0.02)),
    "steps": _drive(RandomLevels(-2.0, 2.0, 0.4)),
}


def trials(count: int, task: Task) -> dict[str, list[Controller]]:
    """Return the settings that every method is tried with, the same for all that is known.

    A window that is too long for the recording is drawn again.
    """
    sizes = len(task.keywords["inputs"]), len(task.keywords["outputs"]), len(task.keywords["outputs"])
    recorded = task.keywords["excitation"].samples
    rng = np.random.default_rng(1)

    def log(low: float, high: float) -> float:
        return float(10 ** rng.uniform(np.log10(low), np.log10(high)))

    drawn: dict[str, list[Controller]] = {"DeePC": [], "SPC": [], "MPC": []}
    while len(drawn["MPC"]) < count:
        windows: dict[str, Any] = {
            "horizon": int(rng.integers(3, 25)),
            "initial_length": int(rng.integers(1, 13)),
            "input_weight": log(1e-7, 10.0),
            "artificial_setpoint": bool(rng.integers(2)),
        }
        if SPC(**windows).recording_length(*sizes) > recorded:
            continue
        regulariser: Any = str(rng.choice(["ridge", "projection"]))
        more = {"lambda_g": log(1e-4, 1e5), "affine_sum": "all", "use_current_output": True}
        drawn["DeePC"].append(DeePC(regulariser=regulariser, **more, **windows))
        drawn["SPC"].append(SPC(**windows))
        drawn["MPC"].append(
            MPC(
                horizon=int(rng.integers(3, 30)),
                input_weight=log(1e-7, 10.0),
                measurement_noise=log(1e-4, 1e3),
                disturbance_noise=log(1e-3, 1e3),
                disturbance="output" if rng.integers(2) else "input",
            )
        )
    return drawn


def errors(
    task: Task,
    mode: str,
    of_steps: bool,
    controllers: Mapping[str, Controller],
    seeds: Sequence[int],
    jobs: int,
) -> dict[str, list[float]]:
    """Return each controller's mean absolute error by seed, added up over outputs; infinite if it fails."""
    known: Any = "unknown" if mode in WITHOUT else mode
    keywords = dict(task.keywords)
    if of_steps:
        keywords["reference"] = task.steps
    problem = Problem(
        **keywords,
        duration=task.samples * keywords["sampling_time"],
        disturbances={
            name: KnownDisturbance(signal=signal, known=known) for name, signal in task.disturbances.items()
        },
        recorded_disturbances=task.rest if mode == "at rest" else {},
    )
    study = Study(problem, dict(controllers), seeds=seeds, name="knowing")
    with tempfile.TemporaryDirectory() as folder:
        results = study.run(Path(folder), jobs=jobs, progress=False)
        mean_errors: dict[str, list[float]] = {}
        for case in results.cases:
            figures = [value for key, value in case.metrics.items() if key.startswith("mean_abs_error")]
            complete = case.outcome == "completed" and np.isfinite(figures).all()
            mean_errors.setdefault(case.label, []).append(float(np.sum(figures)) if complete else np.inf)
    return mean_errors


def tuned(task: Task, mode: str, of_steps: bool, count: int, jobs: int) -> dict[str, Any]:
    """Return each method with the best of the settings that it is tried with."""
    tried: dict[str, Any] = {
        f"{method} {number}": controller
        for method, controllers in trials(count, task).items()
        for number, controller in enumerate(controllers)
    }
    ahead = AHEAD.get(mode, (True,))
    for number, (label, controller) in enumerate(tried.items()):
        tried[label] = replace(controller, use_forecast=ahead[number % len(ahead)])
    figures = errors(task, mode, of_steps, tried, TUNED_ON, jobs)
    best = {
        method: min(
            (label for label in tried if label.startswith(f"{method} ")), key=lambda of: median(figures[of])
        )
        for method in METHODS
    }
    return {method: tried[label] for method, label in best.items()}


def judged(task: Task, mode: str, of_steps: bool, count: int, jobs: int) -> dict[str, float]:
    """Return the median error of each method with its best settings, in units of the outputs."""
    chosen = tuned(task, mode, of_steps, count, jobs)
    return {
        method: median(values)
        for method, values in errors(task, mode, of_steps, chosen, JUDGED_ON, jobs).items()
    }


def leaking(name: str, count: int, jobs: int) -> int:
    """Print what shuffling a perfect forecast costs; return how many methods lose nothing significant."""
    task, leaks = TASKS[name], 0
    chosen = tuned(task, "perfect", False, count, jobs)
    both = chosen | {f"{method}, shuffled": Shuffled(controller=c) for method, c in chosen.items()}
    by_label = errors(task, "perfect", False, both, JUDGED_ON, jobs)
    for method in chosen:
        right, wrong = (dict(enumerate(by_label[label])) for label in (method, f"{method}, shuffled"))
        loss = compare(*({("", seed): value for seed, value in runs.items()} for runs in (wrong, right)))
        significant = loss.p <= LEVEL and loss.mean > 0.0
        leaks += not significant
        ratio = median([*wrong.values()]) / median([*right.values()])
        words = "significantly worse" if significant else "NOT significantly worse"
        print(
            f"{name}, {method}, forecast shuffled: {ratio:.3f} of the error, p = {loss.p:.4f}, {words}",
            flush=True,
        )
    return leaks


def limits_of(name: str, of_steps: bool) -> dict[str, float]:
    """Return what may be left in each mode, and how much of what is left when measuring a forecast leaves."""
    left = dict.fromkeys(CONSTANT, OF_STEPS.get(name, 1.0)) if of_steps else CONSTANT
    return {**left, "perfect over measured": FORESEEN if name == "steps" else ELSEWHERE}


def main() -> int:
    """Print errors with the disturbance over the best without it; return how many are beyond their bound."""
    parser = argparse.ArgumentParser()
    parser.add_argument("tasks", nargs="*", default=[*TASKS])
    parser.add_argument("--trials", type=int, default=24)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--references", action="store_true", help="those of the benchmark, not constant ones")
    parser.add_argument("--shuffled", action="store_true", help="what shuffling a perfect forecast costs")
    given = parser.parse_args()
    if given.shuffled:
        return sum(leaking(name, given.trials, given.jobs) for name in given.tasks)
    beyond = 0
    for name in given.tasks:
        by_mode = {
            mode: judged(TASKS[name], mode, given.references, given.trials, given.jobs) for mode in MODES
        }
        limits = limits_of(name, given.references)
        for method, measured in by_mode["measured"].items():
            without = min(by_mode[mode][method] for mode in WITHOUT)
            ratios = {mode: by_mode[mode][method] / without for mode in MODES}
            ratios["perfect over measured"] = by_mode["perfect"][method] / measured
            too_much = [mode for mode, limit in limits.items() if not ratios[mode] <= limit]
            beyond += len(too_much)
            words = ", ".join(f"{mode} {ratio:.3f}" for mode, ratio in ratios.items())
            print(
                f"{name}, {method}: {words}; without {without:.4g}; beyond: {too_much or 'none'}", flush=True
            )
    return beyond


if __name__ == "__main__":
    from benchmarks import knowing  # by its name, under which workers find its controller

    raise SystemExit(knowing.main() > 0)
