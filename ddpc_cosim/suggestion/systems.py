"""An SSP archive for a step test: described as if it were one FMU, and opened as one plant."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np

from ddpc_cosim.codec import read
from ddpc_cosim.coupling.specification import CoupledSpec
from ddpc_cosim.coupling.ssp import read_ssp
from ddpc_cosim.errors import ConfigError, FMUStepError
from ddpc_cosim.fmu.description import DefaultExperiment, FMUDescription, FMUVariable, Interface
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.study.file_format.sections import PlantSection
from ddpc_cosim.study.plants import PlantSpec, read_fmu
from ddpc_cosim.suggestion.request import Request
from ddpc_cosim.suggestion.step_test import StepTest
from ddpc_cosim.variables import FloatArray, Variable

_WHOLE = 1e-9
_FINEST = 256
_SAMPLES, _DIFFER = 60, 0.02
_COUPLING = {"extrapolation": "linear"}


class Found(Protocol):
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


class System:
    """A system of FMUs whose parts exchange values as often as it turns out to be needed.

    Parameters
    ----------
    path : Path
        The archive.

    Attributes
    ----------
    description : FMUDescription
        Its signals and parameters, as one FMU would declare them.
    exchange : float
        Longest time between two exchanges [s]; what the archive's maker suggests, or any.
    remarks : tuple of str
        What is to be said of it.

    Raises
    ------
    CosimError
        It cannot be run, and why.
    """

    def __init__(self, path: Path) -> None:
        system = read_ssp(path)
        self.warnings = system.warnings
        self._spec = PlantSpec.of(
            read(PlantSection, {"ssp": str(path.resolve()), "coupling": _COUPLING}), Path()
        )
        self.files = tuple(Path(file) for file in self._spec.files)
        self._spec = self._spec.built()
        parts = {part.name: read_fmu(Path(part.fmu)) for part in system.parts}
        self.description = _described(path.stem, self._spec, parts)
        self.exchange = system.step_size or math.inf
        self.remarks: tuple[str, ...] = ()

    def refine(self, open_plant: Callable[..., Any], found: Found, sampling_time: float) -> bool:
        """Have values exchanged so often that twice as often makes no difference; return whether that is new.

        Too seldom, a stable system can look like one that is not: how it responds is no guide.

        Parameters
        ----------
        open_plant : callable
            Opens the system; takes ``start``.
        found : Found
            Where it rests, and the steps of its inputs.
        sampling_time : float
            Time between samples [s].
        """
        before, wanted = self.exchange, min(self.exchange, sampling_time)
        finest = sampling_time / _FINEST
        with open_plant(start=found.start) as plant:
            rows = self._rows(plant, wanted, found, sampling_time)
            while wanted > finest:
                finer = self._rows(plant, wanted / 2, found, sampling_time)
                movement = np.ptp(finer, axis=0)
                if (np.abs(finer - rows).max(axis=0) <= _DIFFER * movement).all():
                    break
                wanted, rows = wanted / 2, finer
            else:
                self.remarks = (
                    "The outputs still depend on how often the parts exchange values, here every "
                    f"{wanted:g} s: try a smaller plant.coupling.communication_step",
                )
        self.exchange = wanted if wanted < sampling_time else before
        return self.exchange != before

    def _rows(self, plant: "OpenSystem", exchange: float, found: Found, h: float) -> FloatArray:
        """Return the outputs after a step of all inputs, shape (samples, p); NaN where it does not run."""
        self.exchange = exchange
        u = found.rest + found.tested.steps
        try:
            plant.plan(h, _SAMPLES * h)
            rows = [plant.reset(found.request.parameters(self.description))]
            return np.array(rows + [plant.step(u, h) for _ in range(_SAMPLES)])
        except (ConfigError, FMUStepError):
            return np.full((_SAMPLES + 1, len(plant.outputs)), np.nan)

    def coupling(self, sampling_time: float) -> dict[str, float | str]:
        """Return the coupling section of a study with a sampling time [s]."""
        count = self._count(sampling_time)
        return {**_COUPLING, **({"communication_step": sampling_time / count} if count > 1 else {})}

    def _count(self, h: float) -> int:
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
        return OpenSystem(plant, self)


class OpenSystem(Plant):
    """A coupled plant whose steps are divided so that its parts exchange values often enough."""

    def __init__(self, plant: Plant, system: System) -> None:
        self.inputs, self.outputs, self._plant = plant.inputs, plant.outputs, plant
        self.description, self.warnings = system.description, system.warnings
        self._count = system._count

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

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _described(name: str, spec: PlantSpec, parts: Mapping[str, FMUDescription]) -> FMUDescription:
    known, coupled = spec.variables(), spec.coupled
    assert coupled is not None
    connectors = {v.name: v for v in (*known.inputs.values(), *known.outputs.values()) if "." not in v.name}
    variables = {name: _connector(v, is_input=name in known.inputs) for name, v in connectors.items()}
    usual = {*known.default_inputs, *known.default_outputs}
    for part, description in parts.items():
        for one in _of_part(part, description, coupled):
            is_signal = one.causality in ("input", "output") and one.name not in usual
            variables[one.name] = replace(one, causality="local") if is_signal else one
    interfaces = [interface for part in parts.values() if (interface := part.preferred) is not None]
    fixed = [interface.fixed_step for interface in interfaces if interface.fixed_step]
    start, stop, step = coupled.experiment
    return FMUDescription(
        fmi_version="2.0",
        guid="",
        model_name=name,
        variables=variables,
        interfaces={
            "co-simulation": Interface(
                "co-simulation",
                "",
                variable_step=all(interface.variable_step for interface in interfaces),
                fixed_step=max(fixed, default=None),
            )
        },
        default_experiment=DefaultExperiment(start, stop, None, step),
        display_units=known.display_units,
    )


def _connector(variable: Variable, *, is_input: bool) -> FMUVariable:
    causality = "input" if is_input else "output"
    return FMUVariable(variable, 0, "Real", causality, "continuous", start_text=repr(variable.start))


def _of_part(part: str, description: FMUDescription, coupled: CoupledSpec) -> Iterator[FMUVariable]:
    """Yield the variables of a part by their full names, with the values that the system gives them."""
    for one in description.variables.values():
        full = f"{part}.{one.name}"
        given = coupled.parameters.get(full)
        variable = replace(one.variable, name=full)
        text = one.start_text
        if isinstance(given, int | float):
            variable, text = replace(variable, start=float(given)), repr(given)
        alias, derivative = (f"{part}.{name}" if name else "" for name in (one.alias_of, one.derivative_of))
        yield replace(one, variable=variable, start_text=text, alias_of=alias, derivative_of=derivative)
