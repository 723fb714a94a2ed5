"""Whether a study on a plant identified from a log ranks controllers as one on the true plant does.

Eight systems with noise are recorded; controllers learn from the first half of the log, and the plant is
identified from the second, as `ddpc-cosim init` proposes it. The same study, of ten controllers with the same
settings, references and limits, is run on the system and on what was identified, and who is ahead of whom is
asked where a report asks it. Pairs of which the system's study says no controller is ahead do not count.

A row has Kendall's tau-b of what both studies say of who is ahead, and of what the first says with the order
of the second's medians; the pairs that count, and of how many the second study says the opposite; whether its
report says that the models disagree on who is ahead, of the first and the next; the pair that says the
opposite and is farthest apart on the system; and the model.
"""

import math
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from ddpc_controllers import LQR, MFAPC, MPC, PID, SPC, WKPC, DeePC, GammaDDPC, KoopmanMPC
from ddpc_cosim import (
    Conditions,
    Constant,
    Controller,
    FloatArray,
    FMUPlant,
    GaussianNoise,
    Identification,
    KnownDisturbance,
    Outcome,
    Plant,
    Problem,
    RandomLevels,
    Reference,
    SignalExcitation,
    Steps,
    Study,
    StudyResults,
    Variable,
    record,
)
from ddpc_cosim.study.verdicts.standings import Standings
from fmu_plants import PlantModel, export_fmu
from fmu_plants.building import MODEL as BUILDING
from fmu_plants.pendulum import MODEL as PENDULUM
from fmu_plants.quadruple_tank import MODEL as TANKS
from fmu_plants.two_mass_drive import MODEL as DRIVE

BOUND = 0.8
ROWS = 1200
SEEDS = range(8)
HORIZON, PAST = 15, 5
PLANT = "plant.fmu"


class Polynomials(Plant):
    """``A y = B (valve(u) + load)`` with polynomials in the delay, at rest first; a subclass says which."""

    b: tuple[float, ...]
    poles: tuple[float, ...]
    dead_time = 0
    inputs = (Variable("u", "", -1.0, 1.0), Variable("load", "", -1.0, 1.0))
    outputs = (Variable("y", ""),)

    def valve(self, u: float) -> float:
        """Return the flow through a valve."""
        return u

    def reset(self, parameters: Mapping[str, Any] | None = None, t0: float = 0.0) -> FloatArray:
        """Rest with the inputs at their start values."""
        a = np.poly(self.poles)
        self._a, self._b = a[1:], np.array([*np.zeros(self.dead_time), *self.b])
        flow = self.valve(self.inputs[0].start)
        rest = flow * self._b.sum() / a.sum() if flow else 0.0
        self._flow, self._y = np.full(len(self._b), flow), np.full(len(self._a), rest)
        return self._y[:1].copy()

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold the inputs over a sample."""
        self._flow = np.array([self.valve(float(u[0])) + u[1], *self._flow[:-1]])
        self._y = np.array([self._b @ self._flow - self._a @ self._y, *self._y[:-1]])
        return self._y[:1].copy()


class DeadTime(Polynomials):
    b, poles, dead_time = (0.3,), (0.85,), 6


class InverseResponse(Polynomials):
    b, poles = (-0.04, 0.09), (0.9, 0.75)


class Integrating(Polynomials):
    b, poles = (0.02, 0.015), (1.0, 0.7)


class EqualPercentage(Polynomials):
    """A valve that lets through larger flows in proportion, not by addition, for equal steps."""

    b, poles = (0.15, 0.1), (0.9, 0.75)
    inputs = (Variable("u", "", 0.0, 1.0, start=0.5), Variable("load", "", -1.0, 1.0))

    def valve(self, u: float) -> float:
        return float(20.0 ** (u - 1.0))


@dataclass(frozen=True, kw_only=True)
class System:
    """A plant as controllers meet it, and how it was recorded."""

    plant: PlantModel | type[Plant]
    sampling_time: float = 1.0
    steps: int = 160
    inputs: Mapping[str, tuple[float, float]]
    """Between what values each was moved in the log."""
    hold: int
    """Samples between one random level of the inputs and the next."""
    outputs: Mapping[str, Reference]
    noise: Mapping[str, float]
    """Standard deviation of what measurements have on top."""
    nominal: Mapping[str, float]
    gradient: Sequence[Sequence[float]]
    """What outputs change in the first sample after a step of an input, in parts of nominal values."""
    unknown: Mapping[str, Reference] = field(default_factory=dict)
    """What acts on the plant and nobody measures."""
    known: Mapping[str, Reference] = field(default_factory=dict)
    """What acts on it and is measured."""
    kept_by: Controller | None = None
    """What kept it near its rest while it was recorded."""

    @property
    def disturbances(self) -> dict[str, KnownDisturbance]:
        """What acts on it and is known."""
        return {name: KnownDisturbance(signal=signal) for name, signal in self.known.items()}

    def controllers(self) -> dict[str, Controller]:
        """Return those that an engineer would try, with the weights and windows that `init` writes."""
        windows: dict[str, Any] = {"initial_length": PAST, "horizon": HORIZON, "input_weight": 0.1}
        weights: dict[str, Any] = {"output_weight": 10.0, "setpoint_weight": 30.0}
        ridge: dict[str, Any] = {
            "regulariser": "ridge",
            "lambda_g": 1.0,
            "affine_sum": "all",
            "lambda_sigma": 1e5,
        }
        strength = float(np.square(self.gradient).sum(axis=0).mean())
        return {
            "PID, SIMC": PID(tuning="step-test"),
            "PID, virtual reference": PID(tuning="virtual-reference"),
            "MFAPC": MFAPC(
                horizon=HORIZON,
                lambda_u=5.0 * HORIZON * strength,
                mu=0.25,
                epsilon=1e-6,
                initial_gradient=[[*row] for row in self.gradient],
            ),
            "SPC": SPC(**windows, **weights),
            "DeePC": DeePC(**windows, **weights, **ridge),
            "Gamma-DDPC": GammaDDPC(**windows, **weights),
            "WKPC": WKPC(initial_length=PAST, horizon=HORIZON),
            "Koopman MPC": KoopmanMPC(horizon=HORIZON, delays=PAST, output_weight=10.0, input_weight=0.1),
            "MPC": MPC(horizon=HORIZON, output_weight=10.0, input_weight=0.1),
            "LQR": LQR(),
        }

    def log(self, folder: Path) -> Path:
        """Record the plant while its inputs are moved, and return the file."""
        levels = [
            RandomLevels(*limits, self.hold * self.sampling_time, seed=number)
            for number, limits in enumerate(self.inputs.values())
        ]
        with self.opened(folder) as plant:
            recording = record(
                plant,
                SignalExcitation(levels, ROWS, self.sampling_time),
                sampling_time=self.sampling_time,
                stabiliser=self.kept_by,
                reference={name: Constant(0.0) for name in self.outputs if self.kept_by},
                outputs=[*self.outputs],
                measurements=[*self.outputs],
                noise=GaussianNoise(self.noise),
                conditions=Conditions(inputs=dict(self.unknown)),
                disturbances=self.disturbances,
                seed=1000,
            )
            variables = {variable.name: variable for variable in (*plant.inputs, *plant.outputs)}
        signals = [
            [variables[name] for name in kind]
            for kind in (self.inputs, self.outputs, self.outputs, self.known)
        ]
        replace(recording, y=recording.measured).write_csv(folder / "log.csv", *signals)
        return folder / "log.csv"

    def opened(self, folder: Path) -> Plant:
        if isinstance(self.plant, PlantModel):
            return FMUPlant(export_fmu(self.plant, folder / PLANT))
        return self.plant()

    def problem(self, log: Path, plant: Any, **more: Any) -> Problem:
        """Return what is asked of controllers, on the system or on what is identified in its place."""
        return Problem(
            plant=plant,
            inputs=[*self.inputs],
            outputs=[*self.outputs],
            measurements=[*self.outputs],
            sampling_time=self.sampling_time,
            duration=self.steps * self.sampling_time,
            reference=self.outputs,
            bounds=self.inputs,
            nominal=self.nominal,
            recording={"file": str(log), "part": [0.0, 0.5]},
            disturbances=self.disturbances,
            **more,
        )


def _steps(system_time: float, *values: float, unit: str = "") -> Steps:
    """Return steps that come in equal parts of a time, the first at its start."""
    return Steps([number * system_time / len(values) for number in range(len(values))], values, unit=unit)


_LINEAR: dict[str, Any] = {
    "inputs": {"u": (-1.0, 1.0)},
    "outputs": {"y": _steps(160.0, 0.0, 1.0, -0.5, 0.5)},
    "noise": {"y": 0.05},
    "nominal": {"u": 1.0, "y": 1.0},
    "unknown": {"load": RandomLevels(-0.1, 0.1, 20.0)},
}
"""What is asked of linear plants with signals of size 1."""
SYSTEMS = {
    "dead time": System(plant=DeadTime, hold=8, gradient=[[0.3]], **_LINEAR),
    "inverse response": System(plant=InverseResponse, hold=6, gradient=[[0.1]], **_LINEAR),
    "integrating": System(
        plant=Integrating, hold=6, gradient=[[0.1]], kept_by=PID(proportional=0.3), **_LINEAR
    ),
    "valve": System(
        plant=EqualPercentage,
        inputs={"u": (0.0, 1.0)},
        hold=6,
        outputs={"y": _steps(160.0, 2.2, 4.0, 1.5, 3.0)},
        noise={"y": 0.1},
        nominal={"u": 0.5, "y": 2.0},
        gradient=[[0.05]],
        unknown={"load": RandomLevels(-0.03, 0.03, 20.0)},
    ),
    "two-mass drive": System(
        plant=DRIVE,
        sampling_time=0.02,
        inputs={"motor_torque": (-2.0, 2.0)},
        hold=4,
        outputs={"load_speed": _steps(3.2, 0.0, 10.0, 5.0, -5.0)},
        noise={"load_speed": 0.3},
        nominal={"motor_torque": 2.0, "load_speed": 10.0},
        gradient=[[0.05]],
        unknown={"load_torque": RandomLevels(-0.2, 0.2, 0.4)},
    ),
    "pendulum": System(
        plant=PENDULUM,
        sampling_time=0.1,
        inputs={"torque": (-3.5, 3.5)},
        hold=4,
        outputs={"angle": _steps(16.0, 0.0, 20.0, -10.0, 10.0, unit="deg")},
        noise={"angle": 0.02},
        nominal={"torque": 3.5, "angle": 0.3},
        gradient=[[0.2]],
    ),
    "tanks": System(
        plant=TANKS,
        sampling_time=5.0,
        inputs={"pump_1": (2.5, 3.5), "pump_2": (2.5, 3.5)},
        hold=10,
        outputs={
            "level_1": _steps(800.0, 12.4, 13.4, 13.4, 12.4),
            "level_2": _steps(800.0, 12.7, 12.7, 12.0, 12.0),
        },
        noise={"level_1": 0.05, "level_2": 0.05},
        nominal={"pump_1": 0.5, "pump_2": 0.5, "level_1": 1.0, "level_2": 1.0},
        gradient=[[0.2, 0.02], [0.02, 0.16]],
    ),
    "building": System(
        plant=BUILDING,
        sampling_time=900.0,
        inputs={"heating_power": (1500.0, 6500.0)},
        hold=8,
        outputs={"indoor_temperature": _steps(160 * 900.0, 20.0, 22.0, 19.0, 21.0, unit="degC")},
        noise={"indoor_temperature": 0.1},
        nominal={"heating_power": 2500.0, "indoor_temperature": 2.0, "outdoor_temperature": 5.0},
        gradient=[[0.2]],
        known={"outdoor_temperature": RandomLevels(268.15, 278.15, 12 * 3600.0, interpolation="linear")},
        unknown={"solar_irradiance": RandomLevels(0.0, 100.0, 3 * 3600.0)},
    ),
}


class Order(NamedTuple):
    """How a study orders its controllers."""

    standings: Standings

    def verdict(self, name: str, other: str) -> int:
        """Return 1 where a controller is ahead of another, -1 where it is behind, 0 where neither is said."""
        failed = [self.standings.failed[of] for of in (name, other)]
        if any(failed):
            return int(np.sign(failed[1] - failed[0]))
        worse = {self.standings.worse_in(key, name, other) for key in self.standings.keys} - {""}
        return (1 if worse == {other} else -1) if len(worse) == 1 else 0

    def place(self, name: str) -> tuple[int, float]:
        """Return what it stands by where nothing is tested: failed runs, mean place of its medians."""
        places = list[int]()
        for samples in map(self.standings.samples.__getitem__, self.standings.keys):
            medians = [sample.median for sample in samples.values()]
            places.append(sum(median < samples[name].median for median in medians))
        return self.standings.failed[name], float(np.mean(places))


def tau_b(pairs: Iterable[tuple[int, int]]) -> float:
    """Return Kendall's tau-b of two orders, -1, 0 (a tie) or 1 of every pair; NaN where nothing counts.

    Pairs that are tied in the first order do not count at all.
    """
    counted = [(first, second) for first, second in pairs if first]
    untied = math.sqrt(len(counted) * sum(second != 0 for _, second in counted))
    return sum(first * second for first, second in counted) / untied if untied else math.nan


def run(system: System, log: Path, plant: Any, folder: Path, jobs: int, **more: Any) -> StudyResults:
    """Return the results of the study on a plant."""
    study = Study(system.problem(log, plant, **more), system.controllers(), seeds=SEEDS, name="identified")
    return study.run(folder, jobs=jobs, progress=False)


def both(system: System, folder: Path, jobs: int) -> tuple[StudyResults, StudyResults]:
    """Return the results on a system, and those on what is identified from its log."""
    log = system.log(folder)
    plant = folder / PLANT if isinstance(system.plant, PlantModel) else system.plant
    real = {"noise": system.noise, "conditions": Conditions(inputs=dict(system.unknown))}
    from_log = Identification(
        file=[str(log)], part=[0.5, 1.0], members=len(SEEDS), disturbances=[*system.known]
    )
    return (
        run(system, log, plant, folder / "true", jobs, **real),
        run(system, log, from_log, folder / "identified", jobs),
    )


def compared(name: str, on_system: StudyResults, on_model: StudyResults) -> tuple[float, float]:
    """Print a row of the table; return tau-b of the verdicts, and of verdicts with the order of medians.

    Controllers that never complete a run on the system, such as one that its recording cannot tune, are left
    out: they are last in both.
    """
    true, estimated = (
        Order(findings.standings)
        for results in (on_system, on_model)
        for findings in results.findings().values()
    )
    names = {case.controller for case in on_system.cases if case.outcome is Outcome.COMPLETED}
    in_order = sorted(names, key=lambda of: (*true.place(of), of))
    verdicts = {pair: (true.verdict(*pair), estimated.verdict(*pair)) for pair in combinations(in_order, 2)}
    places = {of: estimated.place(of) for of in names}
    medians = [
        (first, (places[behind] > places[ahead]) - (places[behind] < places[ahead]))
        for (ahead, behind), (first, _) in verdicts.items()
    ]
    inverted = [pair for pair, (first, second) in verdicts.items() if first * second < 0]
    worst = max(inverted, key=lambda pair: np.diff([*map(in_order.index, pair)]).item(), default=None)
    page = on_model.report().read_text(encoding="utf-8")
    taus = tau_b(verdicts.values()), tau_b(medians)
    counted = sum(first != 0 for first, _ in verdicts.values())
    print(
        f"{name:<17}{taus[0]:6.2f}{taus[1]:9.2f}{counted:6d} of {len(verdicts):<4d}{len(inverted):3d}   "
        f"{'yes' if 'They disagree' in page else 'no':<5}"
        f"{' and '.join(worst) if worst else '-':<32}{on_model.provenance['identified by']}",
        flush=True,
    )
    return taus


HEADING = f"{'system':<17}{'tau-b':>6}{'medians':>9}{'pairs':>10}{'wrong':>7}   {'said':<5}{'worst':<32}model"


def main() -> bool:
    """Print the table; return whether the bound is held."""
    print(HEADING)
    with tempfile.TemporaryDirectory() as temporary:
        taus = list[tuple[float, float]]()
        for name, system in SYSTEMS.items():
            folder = Path(temporary) / name.replace(" ", "-")
            folder.mkdir()
            taus.append(compared(name, *both(system, folder, jobs=2)))
    of_verdicts, of_medians = median(tau for tau, _ in taus), median(tau for _, tau in taus)
    held = of_verdicts >= BOUND
    print(f"{'median':<17}{of_verdicts:6.2f}{of_medians:9.2f}   >= {BOUND:g} {'held' if held else 'MISSED'}")
    return held


if __name__ == "__main__":
    from benchmarks import identified  # by its name, under which workers find its plants

    sys.exit(not identified.main())
