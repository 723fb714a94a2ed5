"""Where overrides rest that start at 0: where the plant's own control holds what they override."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from ddpc_cosim.description import applied_output
from ddpc_cosim.errors import ConfigError, FMUStepError
from ddpc_cosim.plant import ParameterValue, Plant
from ddpc_cosim.suggestion.choice import Choice
from ddpc_cosim.suggestion.design import Bounds
from ddpc_cosim.suggestion.response_types import BLOCK
from ddpc_cosim.suggestion.step_test import Timing
from ddpc_cosim.variables import FloatArray, Variable

_STEPS = 200
_LATER_HALF = 0.5
_SAME = 1e-6  # of an input's range: levels that do not differ


@dataclass(frozen=True, slots=True)
class Embedded:
    """What the plant's own control does while all overrides are off.

    Parameters
    ----------
    overrides : tuple of str
        The overrides that start at 0, of which a level at rest is wanted.
    levels : mapping of str to float
        Those that an output tells, in their units.
    held : array, shape (p,)
        The outputs meanwhile, on average, perhaps others after them; empty if it does not run so.
    """

    overrides: tuple[str, ...] = ()
    levels: Mapping[str, float] = field(default_factory=dict)
    held: FloatArray = field(default_factory=lambda: np.zeros(0))

    def within(self, inputs: Iterable[Variable]) -> Self:
        """Return it with levels that inputs may have: a mean of what is at a limit may be just beyond."""
        limits = {variable.name: (variable.min, variable.max) for variable in inputs}
        levels = {name: float(np.clip(level, *limits[name])) for name, level in self.levels.items()}
        return replace(self, levels=levels)

    def holding(
        self,
        inputs: Sequence[Variable],
        rest: FloatArray,
        y: FloatArray,
        choice: Choice,
        bounds: Mapping[str, Bounds],
    ) -> dict[str, float]:
        """Return levels of overrides at which outputs are where the plant's own control has them.

        Parameters
        ----------
        inputs : sequence of Variable
            The inputs.
        rest : array, shape (m,)
            Where they rest in the step test.
        y : array, shape (p,)
            Where the outputs rest then.
        choice : Choice
            What is driven and controlled, and the gains.
        bounds : mapping of str to Bounds
            How far the inputs may go.
        """
        wanted = [(k, i) for k, i in enumerate(choice.inputs) if inputs[i].name in self.overrides]
        if not wanted or not self.held.size:
            return {}
        chosen = [*choice.outputs]
        gains = choice.gains[:, [k for k, _ in wanted]]
        moves = np.linalg.pinv(gains) @ (self.held[chosen] - y[chosen])
        levels = {}
        for move, (_, i) in zip(moves.tolist(), wanted, strict=True):
            limits = bounds[inputs[i].name]
            level = float(np.clip(rest[i] + move, limits.low, limits.high))
            if abs(level - rest[i]) > _SAME * (limits.high - limits.low):
                levels[inputs[i].name] = level
        return levels


def embedded_control(
    open_plant: Callable[..., Plant],
    switches: Mapping[str, str],
    parameters: Mapping[str, ParameterValue],
    timing: Timing,
    applied: Sequence[str] = (),
) -> Embedded:
    """Run a plant under its own control, and return what that does with what it leaves to overrides.

    Parameters
    ----------
    open_plant : callable
        Opens it; takes ``start``, and ``also``, further outputs to read.
    switches : mapping of str to str
        The switches of the overrides that start at 0, by override.
    parameters : mapping of str to number or str
        What differs from the plant's defaults.
    timing : Timing
        What is known about time: the run is as long as those of the step test.
    applied : sequence of str
        The outputs that tell what acts as overrides.
    """
    if not switches:
        return Embedded()
    h = timing.step if timing.fixed else timing.step * BLOCK * 2.0**timing.blocks / _STEPS
    try:
        with open_plant(start=dict.fromkeys(switches.values(), 0.0), also=applied) as plant:
            u = np.array([variable.start for variable in plant.inputs])
            plant.plan(h, _STEPS * h)
            plant.reset(parameters)
            rows = np.array([plant.step(u, h) for _ in range(_STEPS)])
            outputs = [variable.name for variable in plant.outputs]
    except (ConfigError, FMUStepError):
        return Embedded(tuple(switches))
    held = rows[int(_LATER_HALF * _STEPS) :].mean(axis=0)
    if not np.isfinite(held).all():
        return Embedded(tuple(switches))
    places = {name: outputs.index(y) for name in switches if (y := applied_output(name)) in outputs}
    levels = {name: float(held[place]) for name, place in places.items() if held[place]}
    return Embedded(tuple(switches), levels, held)
