"""What a user asks of a suggested study: an operating point, ranges and times, checked against the FMU."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from numbers import Real
from typing import Any

from ddpc_cosim.description import Declarations, PlantSignal, choose_signals, elements_of
from ddpc_cosim.errors import ConfigError
from ddpc_cosim.fmu.buffers import StartValues
from ddpc_cosim.fmu.co_simulation import StepSizes
from ddpc_cosim.loop.setup import limits_error, whole_steps
from ddpc_cosim.plant import ParameterValue
from fmu_plants.spelling import did_you_mean


@dataclass(frozen=True, slots=True)
class Request:
    """What a study is to keep to; what is not given is found out.

    Parameters
    ----------
    at : mapping of str to number or str
        Operating point: levels of inputs, parameters and start values, by name.
    ranges : mapping of str to (float, float)
        Of inputs: how far they may go; of outputs: between what values setpoints are.
    sampling_time, duration : float, optional
        Of the loop [s].
    inputs, outputs : sequence of str, optional
        Signals to use.
    """

    at: Mapping[str, ParameterValue] = field(default_factory=dict)
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    sampling_time: float | None = None
    duration: float | None = None
    inputs: Sequence[str] | None = None
    outputs: Sequence[str] | None = None

    def check(
        self, description: Declarations, label: str, steps: StepSizes | None = None, known: Sequence[str] = ()
    ) -> None:
        """Raise ConfigError for everything that the plant, or an FMU with such steps, does not allow.

        Faults that are known already are told with the others.
        """
        every = (*known, *self._range_faults(description), *self._time_faults())
        faults = [f"{label}: {fault}" for fault in every]
        checks: list[Callable[[], object]] = [
            partial(choose_signals, description, label, self.inputs, self.outputs),
            partial(StartValues, description, label, self.at, ()),
        ]
        if not faults and self.sampling_time is not None and steps is not None:
            checks.append(partial(steps.substeps, self.sampling_time))
        for check in checks:
            try:
                check()
            except ConfigError as error:
                faults += error.faults
        if faults:
            raise ConfigError(faults)

    def start(self, description: Declarations) -> dict[str, float]:
        """Return the levels of inputs at the operating point."""
        given = {name: signal for name in self.at if (signal := description.signal(name)) is not None}
        return {
            name: _number(signal, self.at[name])
            for name, signal in given.items()
            if signal.source.causality == "input"
        }

    def parameters(self, description: Declarations) -> dict[str, ParameterValue]:
        """Return the rest of the operating point: parameters and start values."""
        inputs = self.start(description)
        return {name: value for name, value in self.at.items() if name not in inputs}

    def _range_faults(self, description: Declarations) -> Iterator[str]:
        for name, pair in self.ranges.items():
            signal = description.signal(name)
            if fault := _unfit(description, name, signal) or _not_a_range(pair):
                yield f"range of {name}: {fault}"
            elif signal is not None:
                yield from (f"range of {name}: {fault}" for fault in self._contradictions(name, signal))

    def _contradictions(self, name: str, signal: PlantSignal) -> Iterator[str]:
        """Yield why a range of a signal does not go with what else is declared or asked for."""
        (low, high), variable = self.ranges[name], signal.variable
        if low < variable.min or high > variable.max:
            declared = f"[{variable.min:g}, {variable.max:g}], the limits that the FMU declares"
            yield f"{low:g}:{high:g} is not within {declared}"
        level = self.at.get(name)
        if isinstance(level, Real) and not low <= float(level) <= high:
            yield f"{low:g}:{high:g} does not hold its operating point {level:g}"
        is_input = signal.source.causality == "input"
        chosen, option = (self.inputs, "input") if is_input else (self.outputs, "output")
        if chosen is not None and name not in chosen:
            yield f"it is not used; add --{option} {name}"

    def _time_faults(self) -> Iterator[str]:
        times = {"sampling time": self.sampling_time, "duration": self.duration}
        impossible = [
            f"{what} = {value} is not possible; allowed: a finite number of seconds > 0"
            for what, value in times.items()
            if value is not None and not 0.0 < value < math.inf
        ]
        yield from impossible
        if not impossible and self.sampling_time is not None and self.duration is not None:
            try:
                whole_steps(self.duration, self.sampling_time)
            except ConfigError as error:
                yield str(error)


def _unfit(description: Declarations, name: str, signal: PlantSignal | None) -> str:
    """Return why a name is not that of an input or output; empty if it is."""
    variable = description.variables.get(name)
    if signal is None and variable is not None:
        return f"it is an array; name its elements: {elements_of(variable)}"
    if signal is None:
        known = [s.variable.name for s in description.signals("input", "output")]
        return f"no input or output has this name; {did_you_mean(name, known)}"
    if not signal.source.is_numeric or signal.source.causality not in ("input", "output", "local"):
        return "it is neither an input nor an output that is a number"
    return ""


def _not_a_range(pair: Any) -> str:
    needed = "two finite numbers LO:HI with LO < HI, and the unit behind them if it is another one"
    if not isinstance(pair, Sequence) or isinstance(pair, str) or len(pair) != 2:
        return f"{pair!r} is not a range; needed: {needed}"
    fault = limits_error(pair)
    if fault or not all(math.isfinite(value) for value in pair):
        return f"{pair[0]}:{pair[1]} is not a range; needed: {needed}"
    return ""


def _number(signal: PlantSignal, value: ParameterValue) -> float:
    """Return a value that has been checked as a number: those of enumerations have names."""
    if isinstance(value, str) and value in signal.source.items:
        return float(signal.source.items[value])
    return float(value.lower() == "true") if isinstance(value, str) else float(value)
