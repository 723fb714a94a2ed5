"""A system of FMUs for a step test: opened as one plant, whose parts exchange values often enough."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ddpc_cosim.coupling.plant import CoupledPlant
from ddpc_cosim.description import DefaultExperiment, PlantDescription
from ddpc_cosim.errors import ConfigError, FMUStepError
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.study.file_format.sections import CouplingSection, PlantSection
from ddpc_cosim.study.plants import PlantSpec
from ddpc_cosim.suggestion.request import Request
from ddpc_cosim.suggestion.step_test import StepTest
from ddpc_cosim.variables import FloatArray

_WHOLE = 1e-9
_FINEST = 256
_SAMPLES, _DIFFER = 60, 0.02
_COUPLING = CouplingSection(extrapolation="linear")


class TriedPoint(Protocol):
    """What a step test has found that matters here."""

    @property
    def start(self) -> Mapping[str, float]:
        """Levels that inputs start from."""

    @property
    def rest(self) -> FloatArray:
        """Where inputs rest, shape (m,)."""

    @property
    def tested(self) -> StepTest:
        """The steps that they take."""

    @property
    def request(self) -> Request:
        """What is asked for."""


class OpenedSystem(Protocol):
    """What a system is that is opened as one plant."""

    @property
    def description(self) -> PlantDescription:
        """What it says about itself."""

    def count(self, h: float) -> int:
        """Return in how many steps one of h [s] is done."""


class System:
    """A system of FMUs whose parts exchange values as often as it turns out to be needed.

    Parameters
    ----------
    section : PlantSection
        The plant of a study that has it: an SSP archive, or parts and their connections.
    experiment : DefaultExperiment, optional
        What its authors had in mind, if it does not say so itself.

    Attributes
    ----------
    description : PlantDescription
        What it says about itself.
    exchange : float
        Longest time between two exchanges [s]; what the archive's maker suggests, or any.

    Raises
    ------
    CosimError
        It cannot be run, and why.
    """

    def __init__(self, section: PlantSection, experiment: DefaultExperiment | None = None) -> None:
        self._section = replace(section, coupling=_COUPLING)
        self._spec = PlantSpec.of(self._section, Path())
        self.files = tuple(Path(file) for file in self._spec.files)
        self._spec = self._spec.built()
        described = self._spec.variables()
        self.description = replace(described, default_experiment=experiment or described.default_experiment)
        self.exchange = self.description.default_experiment.step_size or math.inf
        self._remarks: tuple[str, ...] = ()
        self._loops: tuple[tuple[str, ...], ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is to be said of it, after it has been opened."""
        loops = (
            f"Algebraic loop: {', '.join(loop)} depend on each other without delay: solved at each exchange"
            for loop in self._loops
        )
        return (*loops, *self._remarks)

    def refine(self, open_plant: Callable[..., Any], point: TriedPoint, sampling_time: float) -> bool:
        """Have values exchanged so often that twice as often makes no difference; return whether that is new.

        Where values are exchanged too seldom, a stable system can look unstable: its responses say nothing.

        Parameters
        ----------
        open_plant : callable
            Opens the system; takes ``start``.
        point : TriedPoint
            Where it rests, and the steps of its inputs.
        sampling_time : float
            Time between samples [s].
        """
        before, wanted = self.exchange, min(self.exchange, sampling_time)
        finest = sampling_time / _FINEST
        with open_plant(start=point.start) as plant:
            rows = self._rows(plant, wanted, point, sampling_time)
            while wanted > finest:
                finer = self._rows(plant, wanted / 2, point, sampling_time)
                movement = np.ptp(finer, axis=0)
                if (np.abs(finer - rows).max(axis=0) <= _DIFFER * movement).all():
                    break
                wanted, rows = wanted / 2, finer
            else:
                self._remarks = (
                    "The outputs still depend on how often the parts exchange values, here every "
                    f"{wanted:g} s: try a smaller plant.coupling.communication_step",
                )
        self.exchange = wanted if wanted < sampling_time else before
        return self.exchange != before

    def _rows(self, plant: "OpenSystem", exchange: float, point: TriedPoint, h: float) -> FloatArray:
        """Return the outputs after a step of all inputs, shape (samples, p); NaN where it does not run."""
        self.exchange = exchange
        u = point.rest + point.tested.steps
        try:
            plant.plan(h, _SAMPLES * h)
            rows = [plant.reset(point.request.parameters(self.description))]
            return np.array(rows + [plant.step(u, h) for _ in range(_SAMPLES)])
        except (ConfigError, FMUStepError):
            return np.full((_SAMPLES + 1, len(plant.outputs)), np.nan)

    def section(self, sampling_time: float) -> PlantSection:
        """Return the plant of a study with a sampling time [s]."""
        count = self.count(sampling_time)
        step = sampling_time / count if count > 1 else None
        return replace(self._section, coupling=replace(_COUPLING, communication_step=step))

    def count(self, h: float) -> int:
        """Return in how many steps one of h [s] is done."""
        return max(1, math.ceil(h / self.exchange - _WHOLE))

    def open(
        self,
        *,
        start: Mapping[str, float],
        inputs: Sequence[str],
        outputs: Sequence[str],
        step_timeout: float,
        sandbox: bool,
    ) -> "OpenSystem":
        """Open it, each FMU in a process of its own."""
        isolation = {"isolated": True, "step_timeout": step_timeout, "sandbox": sandbox}
        plant = self._spec.starting_at(start).isolating(isolation).open(inputs, outputs)
        if isinstance(plant, CoupledPlant):
            self._loops = plant.loops
        return OpenSystem(plant, self)


class OpenSystem(Plant):
    """A coupled plant whose steps are divided so that its parts exchange values often enough."""

    def __init__(self, plant: Plant, system: OpenedSystem) -> None:
        self.inputs, self.outputs, self._plant = plant.inputs, plant.outputs, plant
        self.description, self.warnings = system.description, system.description.warnings
        self._count = system.count

    def plan(self, sampling_time: float, stop_time: float) -> None:
        """Tell all parts their steps and the stop time."""
        self._plant.plan(sampling_time / self._count(sampling_time), stop_time)

    def reset(self, parameters: Mapping[str, ParameterValue] | None = None, t0: float = 0.0) -> FloatArray:
        """Reset all parts and return the outputs, shape (p,)."""
        return self._plant.reset(parameters, t0)

    def step(self, u: FloatArray, h: float) -> FloatArray:
        """Hold the inputs u, shape (m,), over h [s] and return the outputs at its end, shape (p,)."""
        count = self._count(h)
        with np.errstate(over="ignore", invalid="ignore"):  # values that are exchanged too seldom may diverge
            for _ in range(count):
                y = self._plant.step(u, h / count)
        return y

    def close(self) -> None:
        """Close all parts."""
        self._plant.close()
