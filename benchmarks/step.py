"""Controller steps, as the co-simulation calls them, against what they replace; medians over one run."""

import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from time import perf_counter_ns

import numpy as np

from benchmarks.mfapc_transcription import Transcription
from benchmarks.pendulum import STEPS, Pendulum, experiment, loop
from ddpc_controllers import MFAPC, DeePC
from ddpc_controllers.full_problem import FullDeePC
from ddpc_cosim import Action, Controller, FloatArray, Recording, Sample

Stepper = Callable[[Sample], FloatArray]

_PIQP_DEFAULT_TOLERANCE = 1e-8
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
        return f"{self.what:<58}{figures}   {sign} {self.limit:<4g} {verdict}"


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


def measure(steppers: Mapping[str, Stepper], horizon: int) -> dict[str, FloatArray]:
    """Let every stepper close a loop of its own; microseconds, shape (steps,).

    They take turns of a few samples each, so that a machine that slows down slows all of them.
    """
    plants = {name: Pendulum(horizon) for name in steppers}
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
    full = FullStepper(DeePC(), recording, torque_limit)
    steppers: dict[str, Stepper] = {"condensed": started(DeePC(), recording, torque_limit), "full": full}
    times = measure(steppers, DeePC().horizon)
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
    steppers: dict[str, Stepper] = {f"T = {n}": started(DeePC(), experiment(n), 3.5) for n in (200, 5000)}
    times = measure(steppers, DeePC().horizon)
    short, long = np.median(times["T = 200"]), np.median(times["T = 5000"])
    return [
        Row(
            "DeePC: step at T = 5000 / step at T = 200",
            float(long),
            float(short),
            float(long / short),
            1.3,
            True,
        )
    ]


def against_transcription() -> list[Row]:
    """Measure MFAPC against its formulas in NumPy."""
    transcription = Transcription(STEPS, 3.5)
    steppers: dict[str, Stepper] = {
        "step": started(MFAPC(), experiment(10), 3.5),
        "transcription": lambda sample: transcription.step(sample.y, sample.reference),
    }
    times = measure(steppers, MFAPC().horizon)
    return [_ratio("MFAPC: (16)-(21) line by line / step", times["step"], times["transcription"], 2.0)]


def main() -> bool:
    """Print the table; return whether every bound was held."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "piqp"))
    print(f"{platform.platform()}, {platform.machine()}, Python {platform.python_version()}, {packages}")
    print(f"{'medians in microseconds':<58}{'step':>9} {'against':>11} {'ratio':>8}   bound")
    rows = [
        *against_full_problem(3.5),
        *against_full_problem(2.5),
        *against_length(),
        *against_transcription(),
    ]
    for row in rows:
        print(row)
    return all(row.held for row in rows)


def _ratio(what: str, step: FloatArray, against: FloatArray, limit: float) -> Row:
    own, other = float(np.median(step)), float(np.median(against))
    return Row(what, own, other, other / own, limit)
