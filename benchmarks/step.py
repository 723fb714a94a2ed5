"""Controller steps, as the co-simulation calls them, against what they replace; medians over one run."""

import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from time import perf_counter_ns
from typing import Protocol

import numpy as np

from benchmarks.pendulum import PRINTED, STEPS, Pendulum, experiment, loop
from ddpc_controllers import DeePC
from ddpc_controllers.optimisation.backends import BackendName
from ddpc_cosim import Action, Controller, FloatArray, Recording, Sample
from tests.controllers.full_problem import FullDeePC

Stepper = Callable[[Sample], FloatArray]


class BenchmarkPlant(Protocol):
    """The plant of a loop: gives samples, takes inputs."""

    def sample(self) -> Sample: ...

    def apply(self, torque: FloatArray, /) -> None: ...


_PIQP_DEFAULT_TOLERANCE = 1e-8
LONG_HORIZON_TORQUE = 1.8
"""Torque limit [N m] that the loop with N = 20 reaches in about half of its steps."""

_ACTIVE = 1e-6
_TURN = 20


@dataclass(frozen=True)
class Row:
    """One bound: a ratio of two medians, to be at least or at most a limit."""

    what: str
    microseconds: float
    against: float
    ratio: float
    limit: float
    at_most: bool = False

    @property
    def held(self) -> bool:
        return self.ratio <= self.limit if self.at_most else self.ratio >= self.limit

    def __str__(self) -> str:
        sign = "<=" if self.at_most else ">="
        verdict = "held" if self.held else "MISSED"
        figures = f"{self.microseconds:9.1f} {self.against:11.1f} {self.ratio:8.2f}"
        return f"{self.what:<80}{figures}   {sign} {self.limit:<4g} {verdict}"


class FullStepper:
    """Problem (8) over all entries of g at every sample, updating only what changes."""

    def __init__(self, settings: DeePC, recording: Recording, torque_limit: float) -> None:
        bounds = loop(recording, torque_limit).bounds
        self._full = FullDeePC(settings, recording, bounds, tolerance=_PIQP_DEFAULT_TOLERANCE)
        self._u, self._y = np.zeros((settings.initial_length, 1)), np.zeros((settings.initial_length, 1))
        self._margin = settings.setpoint_margin * torque_limit
        self.active: list[bool] = []

    def __call__(self, sample: Sample) -> FloatArray:
        solution = self._full.solve(self._u, self._y, sample.reference)
        self._u[:-1], self._u[-1] = self._u[1:], solution.u[0]
        self._y[:-1], self._y[-1] = self._y[1:], sample.y
        self.active.append(bool((np.abs(solution.u) >= self._margin - _ACTIVE).any()))
        u: FloatArray = solution.u[0]
        return u


def started(controller: Controller, recording: Recording, torque_limit: float) -> Stepper:
    """Return a controller's step after its start."""
    controller.start(loop(recording, torque_limit))

    def step(sample: Sample) -> FloatArray:
        answer = controller.step(sample)
        return answer.u if isinstance(answer, Action) else answer

    return step


def measure(
    steppers: Mapping[str, Stepper], horizon: int, plant: Callable[[int], BenchmarkPlant] = Pendulum
) -> dict[str, FloatArray]:
    """Let every stepper close a loop of its own; microseconds, shape (steps,).

    They take turns of a few samples each, so that a machine that slows down slows all of them.
    """
    plants = {name: plant(horizon) for name in steppers}
    times = {name: np.empty(STEPS) for name in steppers}
    for _ in range(STEPS // _TURN):
        for name, step in steppers.items():
            for _ in range(_TURN):
                sample = plants[name].sample()
                start = perf_counter_ns()
                torque = step(sample)
                times[name][sample.k] = (perf_counter_ns() - start) / 1e3
                plants[name].apply(torque)
    return times


def against_full_problem(torque_limit: float) -> list[Row]:
    """Measure DeePC against the full problem, over all steps and over those with an active bound."""
    recording = experiment(200)
    full = FullStepper(DeePC(**PRINTED), recording, torque_limit)
    steppers: dict[str, Stepper] = {
        "condensed": started(DeePC(**PRINTED), recording, torque_limit),
        "full": full,
    }
    times = measure(steppers, DeePC(**PRINTED).horizon)
    active = np.array(full.active)
    limit = 20.0 if active.any() else 50.0
    label = f"DeePC, torque within {torque_limit}: full problem / step"
    rows = [_ratio(f"{label}, all {STEPS} steps", times["condensed"], times["full"], limit)]
    if active.any():
        name = f"{label}, {active.sum()} with a bound"
        rows.append(_ratio(name, times["condensed"][active], times["full"][active], limit))
    return rows


def against_length() -> list[Row]:
    """Measure DeePC on a long recording against a short one."""
    steppers: dict[str, Stepper] = {
        f"T = {n}": started(DeePC(**PRINTED), experiment(n), 3.5) for n in (200, 5000)
    }
    times = measure(steppers, DeePC(**PRINTED).horizon)
    short, long = np.median(times["T = 200"]), np.median(times["T = 5000"])
    return [
        Row(
            "DeePC: step at T = 5000 / step at T = 200",
            float(long),
            float(short),
            float(long / short),
            1.2,
            True,
        )
    ]


def against_long_horizon(backend: BackendName, limit: float) -> list[Row]:
    """Measure DeePC with N = 20 and a torque limit that is reached in half of the steps."""
    recording, torque_limit = experiment(200), LONG_HORIZON_TORQUE
    settings = DeePC(**PRINTED, horizon=20, backend=backend)
    full = FullStepper(settings, recording, torque_limit)
    steppers: dict[str, Stepper] = {"condensed": started(settings, recording, torque_limit), "full": full}
    times = measure(steppers, 20)
    active = np.array(full.active)
    label = f"DeePC, N = 20, {backend}: full problem / step"
    return [
        _ratio(f"{label}, {active.sum()} of {STEPS} with a bound", times["condensed"], times["full"], limit),
        _ratio(f"{label}, those alone", times["condensed"][active], times["full"][active], limit),
    ]


def main() -> bool:
    """Print the table; return whether every bound was held."""
    print_header()
    if not find_spec("daqp"):
        print("daqp is not installed: its rows are left out")
    rows = [
        *against_full_problem(3.5),
        *against_full_problem(2.5),
        *against_long_horizon("piqp", 20.0),
        *(against_long_horizon("daqp", 100.0) if find_spec("daqp") else ()),
        *against_length(),
    ]
    return print_rows(rows)


def print_header() -> None:
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "piqp"))
    print(f"{platform.platform()}, {platform.machine()}, Python {platform.python_version()}, {packages}")
    print(f"{'medians in microseconds':<80}{'step':>9} {'against':>11} {'ratio':>8}   bound")


def print_rows(rows: Sequence[Row]) -> bool:
    """Print rows; return whether every bound was held."""
    for row in rows:
        print(row)
    return all(row.held for row in rows)


def _ratio(what: str, step: FloatArray, against: FloatArray, limit: float) -> Row:
    ours, other = float(np.median(step)), float(np.median(against))
    return Row(what, ours, other, other / ours, limit)
